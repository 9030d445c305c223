"""Clause 9.7: values of counts, corrections and packets, against the page."""

from __future__ import annotations

import contextlib
import re
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

import numpy as np
import page
import page_exact
import pytest
import strategies
from forge import lpcx_parameters, varint
from hypothesis import given
from hypothesis import strategies as st
from singles import decode_counts, decode_exact
from spec import EXAMPLES
from twins import changed

from hapfmt.codecs import exact
from hapfmt.codecs.entropy import SCALE, Encoder
from hapfmt.codecs.exact import (
    CUBIC,
    SIGNIFICANT,
    ExactParameters,
    corrections_of,
    encode_exact,
    in_digits,
    in_places,
    many_in_digits,
    many_in_places,
    ordered,
    unordered,
    values_of,
)
from hapfmt.codecs.predicted import Predictor, encode_indices
from hapfmt.errors import FormatError
from hapfmt.format.cluster import Packet
from hapfmt.format.track import Affine, Component, Track
from hapfmt.limits import LEVELS
from hapfmt.reading.decoder import PieceDecoder, TrackDecoder

pytestmark = pytest.mark.capped

ONE = LEVELS[1]
EXTREMES = [0.0, -0.0, 5e-324, -5e-324, 1.7976931348623157e308, -1.7976931348623157e308, 1 / 3,
            float("inf"), float("-inf"), float("nan")]  # fmt: skip


def packet(counts, beside=b""):
    coded = encode_indices(np.asarray(counts), Predictor())
    return varint(len(coded)) + coded + beside


@st.composite
def rules(draw):
    rule = draw(st.integers(0, 3))
    if rule == CUBIC:
        numbers = st.sampled_from([0.0, -0.0, 1.0, -1e-7, 1e240, 5e-324]) | st.floats(-9, 9)
        return ExactParameters(rule, 0, tuple(draw(st.tuples(*[numbers] * 4))))
    return ExactParameters(rule, draw(st.integers(1, 15)) if rule == SIGNIFICANT else 0)


@st.composite
def cases(draw):
    """(rule, calibration, counts, doubles): near their counts, or anywhere."""
    parameters = draw(rules())
    affine = draw(strategies.affines((-(2**20), 2**20)))
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    size = draw(st.sampled_from([1, 2, 30, 90]))
    reach = draw(st.sampled_from([1, 3, 40, 2**20]))
    counts = generator.integers(-reach, reach + 1, size)
    values = parameters.values(counts, affine)
    far = draw(st.sampled_from([0, 1, 9, 2**20, 2**50, 2**61]))
    step = draw(st.sampled_from([1, 2, 2**29]))
    away = generator.integers(-far, far + 1, size) // step * step
    if draw(st.booleans()):
        away = np.where(generator.random(size) < 0.2, away, 0)
    x = unordered(ordered(values) + away)
    if draw(st.booleans()):
        x[generator.integers(0, size)] = draw(st.sampled_from(EXTREMES))
    return parameters, affine, counts, x


flags = st.fixed_dictionaries({"recall": st.booleans()})


def words(x):
    return np.ascontiguousarray(x).view(np.uint64).tolist()


def decoded(data, parameters, affine, counts):
    """Words, or the id of the rule that was broken."""
    try:
        return words(decode_exact(data, parameters, affine, np.asarray(counts), 0))
    except FormatError as error:
        return error.requirement


def told(parameters):
    return parameters.rule, parameters.digits, parameters.coefficients


def as_the_page_says(rest, parameters, affine, counts):
    try:
        return page_exact.decode_exact(rest, counts, affine, *told(parameters))
    except page.BrokenRule as rule:
        return str(rule)


@pytest.mark.parametrize("digits", range(1, 16))
def test_nothing_has_any_number_of_digits(digits):
    assert many_in_digits(np.zeros(2, np.int64), 10**15, digits).tolist() == [0.0, 0.0]


@given(st.integers(1, 53), st.integers(1, 53), st.integers(1, 15), st.data())
def test_many_at_once_are_each_alone(numerator_bits, d_bits, digits, data):
    d = data.draw(st.integers(1, (1 << d_bits) - 1) | st.sampled_from([10**i for i in range(16)]))
    edges = [n + i for p in range(16) if (n := d * 10**p) < 1 << 53 for i in (-1, 0, 1)]
    edges += [-(-d // 10**p) for p in range(1, 16)]
    drawn = st.integers(-(1 << numerator_bits), 1 << numerator_bits)
    ns = [*edges, 0, *data.draw(st.lists(drawn, max_size=30))]
    many, each = many_in_digits(np.array(ns), d, digits), [in_digits(n, d, digits) for n in ns]
    assert many.tobytes() == np.array(each).tobytes()


class TestValues:
    @given(cases())
    def test_as_the_page_says(self, case):
        parameters, affine, counts, _ = case
        expected = [page_exact.value(n, *affine, *told(parameters)) for n in counts.tolist()]
        found = parameters.values(counts, affine)
        assert [Fraction(v) for v in found.tolist()] == expected
        assert not (np.signbit(found) & (found == 0)).any()

    @given(st.lists(st.integers(-(2**24), 2**24), min_size=1), st.integers(1, 15))
    def test_digits_are_those_that_printf_keeps(self, counts, digits):
        """A sensor of 20 / 16384 V, as text."""
        affine = Affine(20, 0, 16384)
        printed = [float(f"{n * 20 / 16384:.{digits - 1}e}") for n in counts]
        found = values_of(np.array(counts), affine, SIGNIFICANT, digits)
        # Where printf has -0, or rounds a tie, they are equal numbers.
        assert found.tolist() == printed

    @pytest.mark.parametrize(
        ("numerator", "d", "digits", "text"),
        [(5, 2, 1, "2"), (7, 2, 1, "4"), (-5, 2, 1, "-2"), (-7, 2, 1, "-4"), (1, 8, 2, "0.12"),
         (3, 8, 2, "0.38"), (1, 3, 5, "0.33333"), (2**53, 1, 1, "9000000000000000"),
         (1, 2**53, 15, "1.110223e-16")],
    )  # fmt: skip
    def test_ties_and_ends(self, numerator, d, digits, text):
        (found,) = values_of(np.array([1]), Affine(numerator, 0, d), SIGNIFICANT, digits).tolist()
        assert Decimal(repr(found)) == Decimal(text)
        assert str(found) != "-0.0"

    def test_large_numbers_lose_digits_before_the_point(self):
        found = values_of(np.array([123456789, 999999, -1500]), Affine(1, 0, 1), SIGNIFICANT, 3)
        assert found.tolist() == [123000000.0, 1000000.0, -1500.0]


class TestOrder:
    @given(st.lists(st.integers(0, 2**64 - 1), min_size=2, max_size=2))
    def test_grows_with_the_value(self, pair):
        x = np.array(pair, np.uint64).view(np.float64)
        places = ordered(x)
        assert words(unordered(places)) == pair
        assert [page_exact.word_at(p) for p in places.tolist()] == pair
        if not np.isnan(x).any() and x[0] != x[1]:
            assert (x[0] < x[1]) == (places[0] < places[1])

    def test_zeros(self):
        assert ordered(np.array([0.0, -0.0, 5e-324, -5e-324])).tolist() == [0, -1, 1, -2]

    @given(st.integers(0, 2**64 - 1), st.integers(0, 2**64 - 1))
    def test_corrections_fit_64_bits_or_are_refused(self, one, other):
        x, y = np.array([one, other], np.uint64).view(np.float64)[:, None]
        places = [page_exact.place(int(v.view(np.int64)[0])) for v in (x, y)]
        away = places[0] - places[1]
        if abs(away) < 2**63:
            assert corrections_of(x, y).tolist() == [away]
        else:
            with pytest.raises(ValueError, match=re.escape("2^63")):
                corrections_of(x, y)


class TestParameters:
    @given(rules())
    def test_come_back(self, parameters):
        """
        EXA-002: `rule` MUST be at most 4. `digits` is 1 to 31 with rule 2, else 0, `terms` 1 to 16 with rule 4, else 0. Coefficients and weights are finite and of a magnitude below 2^900. `a` is a component that is decoded before, or the component itself with a `lag` of at least 1.
        """
        data = parameters.build()
        assert ExactParameters.parse(data, 0) == parameters
        rule, digits, coefficients = told(parameters)
        assert data == lpcx_parameters(rule, digits, bytes(2), coefficients)
        for other in (
            data[:-1],
            data + b"\0",
            b"",
            b"\5" + data[1:],
            data[:2] + b"\0\1" + data[4:],
        ):
            with pytest.raises(FormatError):
                ExactParameters.parse(other, 0)

    @given(st.binary(min_size=4, max_size=4))
    def test_any_bytes(self, data):
        with contextlib.suppress(FormatError):
            assert ExactParameters.parse(data, 0).build() == data


class TestPackets:
    @given(cases(), flags)
    def test_doubles_come_back(self, case, given):
        """EXA-007: The exact values MUST be the numbers of the source, every bit of them."""
        parameters, affine, counts, x = case
        try:
            beside = encode_exact(x, parameters, affine, counts, **given)
        except ValueError:
            return
        data = packet(counts, beside)
        assert decoded(data, parameters, affine, counts) == words(x)
        assert decode_counts(data, counts.size, ONE, 0).tolist() == counts.tolist()

    @given(cases(), flags)
    def test_as_the_page_says(self, case, given):
        parameters, affine, counts, x = case
        counts, x = counts[:40], x[:40]
        rule, digits = parameters.rule, parameters.digits
        row, signed = counts.tolist(), x.view(np.int64).tolist()
        try:
            beside = encode_exact(x, parameters, affine, counts, **given)
        except ValueError:
            return
        if beside:
            p, table, states = page_exact.heading_of(beside)
            ways = {"p": p, "table": table, "states": states, "c": parameters.coefficients}
            assert beside == page_exact.encode_exact(signed, row, affine, rule, digits, **ways)
        found = page_exact.decode(
            packet(counts, beside), len(row), affine, rule, digits, c=parameters.coefficients
        )
        assert found == (row, words(x))

    @given(cases(), flags, st.data())
    def test_mutated(self, case, given, data):
        """EXA-003: The counts MUST end within the packet and lie within the declared range of their track: lossless counts are never clamped. The parts fit the packet: their sizes are together at most what follows them. Undefined flags are 0, and z at most 63."""
        parameters, affine, counts, x = case
        counts, x = counts[:30], x[:30]
        try:
            rest = bytearray(encode_exact(x, parameters, affine, counts, **given))
        except ValueError:
            return
        for _ in range(data.draw(st.integers(1, 3))):
            at = data.draw(st.integers(0, len(rest)))
            rest[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
        row = counts.tolist()
        expected = as_the_page_says(bytes(rest), parameters, affine, row)
        assert decoded(packet(counts, bytes(rest)), parameters, affine, counts) == expected

    @given(st.binary(max_size=40), st.integers(1, 50), rules())
    def test_any_bytes(self, data, span, parameters):
        """EXA-003: The counts MUST end within the packet and lie within the declared range of their track: lossless counts are never clamped. The parts fit the packet: their sizes are together at most what follows them. Undefined flags are 0, and z at most 63."""
        affine = Affine(1, 0, 10)
        try:
            expected = page_exact.decode(
                data, span, affine, parameters.rule, parameters.digits, c=parameters.coefficients
            )
        except page.BrokenRule as rule:
            expected = str(rule)
        try:
            counts = decode_counts(data, span, ONE, 0)
            found = counts.tolist(), words(decode_exact(data, parameters, affine, counts, 0))
        except FormatError as error:
            found = error.requirement
        assert found == expected

    def test_shift_leaves_out_what_is_always_0(self):
        """Numbers of binary32 beside counts of a binary grid."""
        x = np.random.default_rng(1).normal(size=500).astype(np.float32).astype(np.float64)
        counts = np.rint(x * 2**20).astype(np.int64)
        beside = encode_exact(x, ExactParameters(), Affine(1, 0, 2**20), counts, recall=False)
        assert beside[1] >= 20
        assert len(beside) < 500 * 2

    def test_remembers_32_corrections_of_a_count(self):
        for size, cheaper in ((32, True), (33, False)):
            away = np.tile(np.arange(size, dtype=np.int64) + 2**40, 20)
            x = unordered(ordered(np.ones(away.size)) + away)
            counts = np.ones(away.size, np.int64)
            beside = encode_exact(x, ExactParameters(), Affine(1, 0, 1), counts, recall=True)
            assert (len(beside) < 40 * 6 + 700) == cheaper


class TestTracks:
    TRACK = Track(id=0, kind="full", codec="LPCX", rate=Fraction(1), first_channel=0,
                  components=(Component(Affine(1, 0, 10)),), parameters=lpcx_parameters(),
                  count_min=-9, count_max=9)  # fmt: skip

    def test_counts_need_no_exact_values(self):
        """EXA-006: A decoder that is not asked for exact values MUST give the counts, whatever follows the n bytes. Where that breaks a rule, the packet does not decode for a verifier, nor for a decoder that is asked for exact values."""
        decoder = TrackDecoder(self.TRACK, ONE)
        for beside, rule in ((b"", None), (b"\4\0\0", "EXA-003"), (b"\0\0\0\1\1", "RNG-001")):
            broken = Packet(0, 0, 3, packet([1, 2, 3], beside))
            counts = decoder.decode(broken)
            assert counts.tolist() == [[1], [2], [3]]
            if rule is None:
                assert decoder.decode_exact(broken, counts).tolist() == [[0.1], [0.2], [0.3]]
                continue
            with pytest.raises(FormatError, match=rule):
                decoder.decode_exact(broken, counts)

    def test_broken_exact_values_do_not_decode(self):
        broken = Packet(0, 0, 3, packet([1, 2, 3], b"\4\0\0"))
        decoders, ranges = {0: TrackDecoder(self.TRACK, ONE)}, {0: (0, 9)}
        counts = PieceDecoder(decoders, ranges, exact=False).decode(broken)
        assert counts.numbers.tolist() == [[1], [2], [3]]
        with pytest.raises(FormatError, match="EXA-003"):
            PieceDecoder(decoders, ranges, exact=True).decode(broken)

    @pytest.mark.parametrize("wrong", [{"kind": "lf"}, {"kind": "hf"}], ids=str)
    def test_no_loss(self, wrong):
        """EXA-001: A track of codec `LPCX` MUST be of kind full band, without contract and without deviation."""
        assert TrackDecoder(self.TRACK, ONE).parameters == (ExactParameters(),)
        with pytest.raises(FormatError, match="EXA-001"):
            TrackDecoder(replace(self.TRACK, **wrong), ONE)

    def test_range_is_no_clamp(self):
        with pytest.raises(FormatError, match="EXA-003"):
            TrackDecoder(self.TRACK, ONE).decode(Packet(0, 0, 2, packet([1, 10])))

    def test_other_tracks_have_none(self):
        from hapfmt.codecs.grids import LpcParameters

        track = Track(id=0, kind="full", codec="LPCR", rate=Fraction(1), first_channel=0,
                      components=(Component(),), parameters=LpcParameters().build())  # fmt: skip
        decoder = TrackDecoder(track, ONE)
        assert decoder.decode_exact(Packet(0, 0, 1, b""), np.zeros((1, 1), np.int32)) is None


def test_examples_of_the_page():
    rows = re.findall(r"^\| (\d) \| `([0-9A-F ]+)` \| (.+) \|$", EXAMPLES, re.M)
    assert len(rows) == 4
    counts, before = [1, 2, 3, 3, 7, 3], ""
    for rule, code, numbers in rows:
        text = before if numbers == "the same" else numbers
        expected = [eval(number) for number in text.split(", ")]
        before = text
        data = bytes.fromhex(code)
        parameters = ExactParameters(int(rule))
        assert decode_counts(data, 6, ONE, 0).tolist() == counts
        found = decoded(data, parameters, Affine(1, 0, 10), counts)
        assert found == words(np.array(expected))


@pytest.mark.skipif(exact.compiled is None, reason="the extension is not built, or HAPFMT_PURE=1")
class TestTwins:
    @given(cases(), flags)
    def test_encode(self, case, given):
        parameters, affine, counts, x = case

        def made():
            try:
                return encode_exact(x, parameters, affine, counts, **given)
            except ValueError as error:
                return str(error)

        assert twice(made)

    @given(cases(), flags, st.data())
    def test_decode(self, case, given, data):
        """Doubles, or rule, offset and words of the error."""
        parameters, affine, counts, x = case
        try:
            rest = bytearray(encode_exact(x, parameters, affine, counts, **given))
        except ValueError:
            rest = bytearray(b"\1\0\1\0")
        for _ in range(data.draw(st.integers(0, 3))):
            at = data.draw(st.integers(0, len(rest)))
            rest[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
        whole = packet(counts, bytes(rest))

        def found():
            try:
                return words(decode_exact(whole, parameters, affine, counts, 1000))
            except FormatError as error:
                return error.requirement, error.offset, error.message

        assert twice(found)

    @pytest.mark.parametrize(
        "wrong",
        [{"ids": bytes(3)}, {"ids": np.array([0, 1, 2, 3], np.int32)},
         {"ids": np.array([0, -1, 0], np.int32)}, {"ids": np.zeros(2, np.int32)},
         {"corrections": np.zeros(2, np.int64)}, {"corrections": bytearray(25)},
         {"shift": 64}, {"shift": -1},
         {"work": np.zeros(5, np.int64)}, {"work": memoryview(bytearray(49))[1:]}],
        ids=changed,
    )  # fmt: skip
    def test_what_would_overflow_is_refused(self, wrong):
        given = {"coded": bytearray(8), "ids": np.zeros(3, np.int32),
                 "corrections": np.zeros(3, np.int64), "work": np.zeros(6, np.int64),
                 "shift": 0} | wrong  # fmt: skip
        for call in (exact.compiled.exact_decode, exact.compiled.exact_encode):
            with pytest.raises(ValueError, match="not arrays of corrections"):
                call(*given.values())

    def test_wrong_types(self):
        with pytest.raises((TypeError, BufferError)):
            exact.compiled.exact_decode("text", b"", np.zeros(0), np.zeros(0), 0)
        with pytest.raises(TypeError):
            exact.compiled.exact_encode(b"")

    def test_the_one_magnitude_that_has_no_code(self):
        x = np.array([-(2**63)])
        given = (bytearray(128), b"", x, np.zeros(0, np.int64), 0)
        assert exact.compiled.exact_encode(*given)[0] == 2

    def test_packets_larger_than_their_first_buffer(self):
        away = np.random.default_rng(1).integers(-(2**62), 2**62, 300)
        for shift in (0, 40, 63):
            ids = np.arange(300, dtype=np.int32)
            coded = exact.encode_compiled(away, ids, shift)
            assert coded == exact.encode_loop(away, ids, shift)
            assert exact.decode_compiled(coded, ids, 300, 0).tolist() == away.tolist()


def twice(call):
    """Whether the compiled and the readable loop say the same."""
    fast = call()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exact, "compiled", None)
        return fast == call()


class TestMemory:
    """Few bytes may ask for many samples: the readable loops take some bytes each, no objects."""

    SPAN = 1 << 18

    @pytest.mark.capped(24 << 20)
    def test_of_lists(self):
        """A list for each count, in the bytes of one bit in hundreds."""
        coder = Encoder()
        coder.section([(16, SCALE)] * self.SPAN)
        rest = b"\3\0" + b"\1\xff\0\0" + b"\0\1\1" + coder.finish()
        ids = np.arange(self.SPAN, dtype=np.int32)
        assert not exact.decode_loop(rest, ids, self.SPAN, 0).any()

    @pytest.mark.capped(8 << 20)
    def test_of_significant_digits(self):
        """By integers of any length."""
        numerators = np.arange(1, self.SPAN + 1) + (1 << 40)
        got = many_in_places(numerators, 3, 20)
        for at in (0, 1, self.SPAN - 1):
            assert got[at] == in_places(int(numerators[at]), 3, 20)
