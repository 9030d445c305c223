"""Clause 9.4: bit models, range coder and integer model, against the page."""

from __future__ import annotations

import random
from itertools import pairwise

import page
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.codecs.adaptive import (
    CONFIDENCE,
    EVEN,
    HALF,
    TABLES,
    BitModel,
    IntegerModel,
    RangeDecoder,
    RangeEncoder,
    SymbolModel,
)
from hapfmt.codecs.adaptive_many import encode_integers
from hapfmt.errors import FormatError

bits = st.lists(st.integers(0, 1), max_size=300) | st.tuples(
    st.integers(0, 1), st.integers(1, 600)
).map(lambda run: [run[0]] * run[1])
magnitudes = st.sampled_from([0, 1, 11, 12, 13, 2**10, 2**31, 2**34 - 1]) | st.integers(0, 300)
integers = st.builds(lambda u, sign: sign * u, magnitudes, st.sampled_from([1, -1]))
rows = st.lists(integers, max_size=40) | st.tuples(st.lists(integers, max_size=4), integers).map(
    lambda pair: [pair[1]] * 60 + pair[0]
)


def coded(row):
    coder, model = RangeEncoder(), IntegerModel()
    for e in row:
        model.encode(coder, e)
    return coder.finish()


def coded_at_once(row, repeated=None):
    coder = RangeEncoder()
    encode_integers(coder, row, repeated=repeated)
    return coder.finish()


def coded_with_marks(row, repeated):
    coder, model = RangeEncoder(), IntegerModel()
    marks, recent = [BitModel() for _ in range(4)], 0
    for place, (e, same) in enumerate(zip(row, repeated, strict=True)):
        if place:
            coder.bit(same, marks[recent])
            recent = 2 * same + (recent >> 1)
        if not (place and same):
            model.encode(coder, e)
    return coder.finish()


def coded_as_the_page_says(row):
    coder, model = page.Range(), page.Integers()
    for e in row:
        model.code(coder, e)
    return coder.finish()


def decoded(data, count):
    """Integers, or the id of the rule that was broken."""
    coder, model = RangeDecoder(data), IntegerModel()
    try:
        row = [model.decode(coder) for _ in range(count)]
        coder.finish()
        return row
    except FormatError as error:
        return error.requirement


def decoded_as_the_page_says(data, count):
    coder, model = page.Range(data), page.Integers()
    try:
        row = [model.code(coder) for _ in range(count)]
        coder.finish()
        return row
    except page.BrokenRule as rule:
        return str(rule)


class TestBitModel:
    @given(bits)
    def test_as_the_page_says(self, row):
        ours, other = BitModel(), page.Bit()
        for bit in row:
            assert ours.probability() == other.chance()
            ours.update(bit)
            other.learn(bit)
            assert (ours.p, ours.q, ours.n) == (other.p, other.q, other.n)
            assert 0 <= ours.p <= 65535 and 0 <= ours.q <= 65535

    def test_is_never_certain(self):
        for bit in (0, 1):
            model = BitModel()
            for _ in range(5000):
                model.update(bit)
            assert 64 <= model.probability() <= 65472
            model.p = model.q = 65535 * bit
            assert model.probability() == (65472 if bit else 64)


class TestSymbolModel:
    @given(st.integers(0, 35), st.lists(st.integers(0, 15), max_size=200), st.booleans())
    def test_as_the_page_says(self, context, row, again):
        """Every symbol keeps a chance, however often the others come."""
        ours, other = (
            SymbolModel(TABLES[context], CONFIDENCE),
            page.Symbols(page.first(context), 10),
        )
        for symbol in row * (20 if again else 1):
            ours.update(symbol)
            other.learn(symbol)
        assert (ours.z, ours.n) == (other.z, other.n)
        for width in (HALF, 65535):
            bounds = [width, *(ours.bound(width, i) for i in range(15)), 0]
            assert all(a > b for a, b in pairwise(bounds))


def step(coder, kind, value, bits, symbols):
    """One of what a coder takes; ``value`` None: it decodes."""
    given = [] if value is None else [value]
    if kind == "bit":
        return coder.bit(*given, bits)
    if kind == "symbol":
        return coder.symbol(*given, symbols)
    return coder.raw(*given, kind)


steps = st.one_of(
    st.tuples(st.just("bit"), st.integers(0, 1)),
    st.tuples(st.just("symbol"), st.integers(0, 15)),
    st.integers(0, 20).flatmap(lambda n: st.tuples(st.just(n), st.integers(0, 2**n - 1))),
)


class TestRangeCoder:
    @given(st.lists(steps, max_size=300))
    def test_all_of_it_comes_back(self, row):
        coder, bits, symbols = RangeEncoder(), BitModel(), SymbolModel(EVEN, 2)
        slow, bit, table = (
            page.Range(),
            page.Bit(),
            page.Symbols([4096 * (15 - i) for i in range(15)], 2),
        )
        for kind, value in row:
            step(coder, kind, value, bits, symbols)
            if kind == "bit":
                slow.code(bit, value)
            elif kind == "symbol":
                slow.symbol(table, value)
            else:
                slow.number(kind, value)
        data = coder.finish()
        assert data == slow.finish()
        decoder, bits, symbols = RangeDecoder(data), BitModel(), SymbolModel(EVEN, 2)
        assert [step(decoder, kind, None, bits, symbols) for kind, _ in row] == [v for _, v in row]
        decoder.finish()

    def test_a_carry_through_many_bytes(self):
        """The number 0.0111... of the least likely way up to it, then one more."""
        for size in range(0, 90, 3):
            coder, slow = RangeEncoder(), page.Range()
            for _ in range(size):
                coder.symbol(0, SymbolModel((0,) * 15, 250))
                slow.symbol(page.Symbols([0] * 15, 250), 0)
            for _ in range(40):
                coder.symbol(0, SymbolModel(EVEN, 2))
                slow.symbol(page.Symbols([4096 * (15 - i) for i in range(15)], 2), 0)
            assert coder.finish() == slow.finish()

    def test_nothing_is_no_bytes(self):
        assert RangeEncoder().finish() == b""
        RangeDecoder(b"").finish()

    @given(rows.filter(bool), st.data())
    def test_one_end(self, row, data):
        """RNG-001: The coded bytes MUST end as this rule says: with that many bytes, that front, and zeros between front and back. A decoder checks it after the last symbol, and stops earlier, as soon as N - 15 + W, W so far, is more than 8 times the number of coded bytes: they cannot end so any more."""
        whole = coded(row)
        extra = data.draw(st.binary(min_size=1, max_size=2))
        assert decoded(whole + extra, len(row)) != row
        if whole:
            assert decoded(whole[:-1], len(row)) != row


class TestIntegerModel:
    @given(rows)
    def test_integers_come_back(self, row):
        data = coded(row)
        assert decoded(data, len(row)) == row
        assert data == coded_as_the_page_says(row) == coded_at_once(row)
        assert decoded_as_the_page_says(data, len(row)) == row

    @given(st.binary(max_size=30), st.integers(0, 30))
    def test_any_bytes(self, data, count):
        """RNG-003: The magnitude u MUST be less than 2^34: a decoder stops after step 2 or 3 where it is not."""
        expected = decoded_as_the_page_says(data, count)
        assert decoded(data, count) == expected

    @given(
        st.lists(st.tuples(integers, st.integers(0, 1)), max_size=80),
        st.integers(1, 12),
    )
    def test_at_once_with_repeats(self, pairs, times):
        row, repeated = [e for e, _ in pairs] * times, [same for _, same in pairs] * times
        once = coded_at_once(row, repeated)
        assert once == coded_with_marks(row, repeated)

    @pytest.mark.parametrize("scale", [1, 40, 3000, 2**20, 2**33])
    def test_long_ones_at_once(self, scale):
        draw = random.Random(scale)
        row = [int(draw.gauss(0, scale / 4)) for _ in range(3000)]
        assert coded_at_once(row) == coded(row)

    @pytest.mark.parametrize("before", [[], [2**34 - 1] * 200])
    @pytest.mark.parametrize("code", [coded, coded_at_once])
    @pytest.mark.parametrize("e", [2**34, -(2**34), 2**63])
    def test_larger_ones_are_not_coded(self, e, code, before):
        with pytest.raises(ValueError, match="2\\^34"):
            code([*before, e])

    def test_contexts_stay_in_their_tables(self):
        """f + s over all scales that magnitudes below 2^34 can reach."""
        model = IntegerModel()
        for lg in range(43):
            for extra in (0, 1, 2, 3):
                model.f = model.s = (1 << lg) + (extra << lg >> 2)
                h, c = model.scale()
                assert 0 <= c < len(TABLES) == 36 and 0 <= h <= 32
                assert (h == 0) or (c >= 32)
