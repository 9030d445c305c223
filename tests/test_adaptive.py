"""Clause 9.4: bit models, range coder and integer model, against the page."""

from __future__ import annotations

import page
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.codecs.adaptive import BitModel, IntegerModel, RangeDecoder, RangeEncoder
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


class TestRangeCoder:
    @given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 3)), max_size=300))
    def test_bits_come_back(self, row):
        """Bits with one of three models, or raw."""
        coder, models = RangeEncoder(), [BitModel() for _ in range(3)]
        slow, others = page.Range(), [page.Bit() for _ in range(3)]
        for bit, model in row:
            slow.code(others[model] if model < 3 else None, bit)
            if model < 3:
                coder.bit(bit, models[model])
            else:
                coder.raw(bit, 1)
        data = coder.finish()
        assert data == slow.finish()
        decoder, models = RangeDecoder(data), [BitModel() for _ in range(3)]
        back = [decoder.bit(models[m]) if m < 3 else decoder.raw(1) for _, m in row]
        assert back == [bit for bit, _ in row]
        decoder.finish()

    @given(st.lists(st.tuples(st.integers(0, 1), st.sampled_from([64, 1 << 15, 65472]))))
    def test_the_interval_never_closes(self, row):
        coder = RangeEncoder()
        for bit, probability in row:
            coder.split(bit, probability)
            assert 0 <= coder.x1 < coder.x2 < 1 << 32

    def test_nothing_is_no_bytes(self):
        assert RangeEncoder().finish() == b""
        RangeDecoder(b"").finish()

    @given(rows.filter(bool), st.data())
    def test_one_end(self, row, data):
        """RNG-001: A packet MUST end as this rule says: with that many bytes, and those last bytes. A decoder checks it after the last bit."""
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
        assert data == coded_as_the_page_says(row)
        assert decoded_as_the_page_says(data, len(row)) == row

    @given(st.binary(max_size=30), st.integers(0, 30))
    def test_any_bytes(self, data, count):
        """
        RNG-002: A bucket MUST be less than 80: a decoder stops at the 80th 1.
        RNG-003: The magnitude u MUST be less than 2^34: a decoder stops after step 2 where w is 2^(34 - h) or more.
        """
        assert decoded(data, count) == decoded_as_the_page_says(data, count)

    @pytest.mark.parametrize("e", [2**34, -(2**34), 2**63])
    def test_larger_ones_are_not_coded(self, e):
        with pytest.raises(ValueError, match="2\\^34"):
            coded([e])

    def test_contexts_and_buckets_stay_in_their_tables(self):
        """f + s over all scales that magnitudes below 2^34 can reach."""
        model = IntegerModel()
        for lg in range(43):
            for extra in (0, 1, 2, 3):
                model.f = model.s = (1 << lg) + (extra << lg >> 2)
                h, c = model.scale()
                assert 0 <= c < 40 and 0 <= h <= 32
                assert (h > 0) == (c >= 36)
