"""Clause 9.5, packets of several components: against the page, and each loop against its twin."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import page
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st
from spec import EXAMPLES
from twins import built, changed, same

from hapfmt.codecs import predicted
from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.predicted import (
    INDEX_LIMIT,
    Predictor,
    Reference,
    cross_terms,
    decode_predicted,
    differences,
    encode_component,
    errors_of,
    join_components,
    prediction_errors,
)
from hapfmt.errors import FormatError
from hapfmt.kernels import compiled
from hapfmt.limits import LEVELS

pytestmark = pytest.mark.capped

ONE, TWO = LEVELS[1], LEVELS[2]


def packet_of(rows):
    """None where a prediction error cannot be coded."""
    try:
        made = [
            encode_component(indices, predictor, [other for other, _ in rows[:place]])
            for place, (indices, predictor) in enumerate(rows)
        ]
    except ValueError:
        return None
    return join_components(made)


def decoded(data, span, count, level=TWO):
    """[components][ticks], or the id of the rule that was broken."""
    try:
        return decode_predicted(data, LpcParameters(), span, count, level, 0).T.tolist()
    except FormatError as error:
        return error.requirement


def decoded_as_the_page_says(data, span, count, level=TWO):
    try:
        return page.decode_packet(data, span, level.count_bound, count)
    except page.BrokenRule as rule:
        return str(rule)


def read_without(data, span, count, level=TWO):
    """By the readable loops."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(predicted, "compiled", None)
        patch.setattr(predicted, "compiled", None)
        try:
            return decode_predicted(data, LpcParameters(), span, count, level, 0).T.tolist()
        except FormatError as error:
            return error.requirement, error.offset, error.message


GRIDS = [
    LpcParameters(),
    LpcParameters(3, -40),
    LpcParameters(0, 9, 1, 10),
    LpcParameters(7, 0, 3, 2),
]


def moved(*given):
    """Counts and whether any was moved into the range, or all that an error tells."""
    try:
        counts, any_moved = predicted.decode_moved(*given)
    except FormatError as error:
        return type(error).__name__, error.requirement, error.offset, error.message
    return counts.dtype.name, counts.tolist(), any_moved


def short(rows, size=30):
    return [(indices[:size], predictor) for indices, predictor in rows]


class TestPackets:
    @given(strategies.component_rows(TWO.count_bound))
    def test_indices_come_back(self, rows):
        data = packet_of(rows)
        if data is not None:
            back = decoded(data, rows[0][0].size, len(rows))
            assert back == [indices.tolist() for indices, _ in rows]

    @given(strategies.component_rows(TWO.count_bound))
    def test_as_the_page_says(self, rows):
        """
        LPC-007: With flag *references* r MUST be 1 to 8. Each number a is less than that of the component itself, and greater than the one before.
        LPC-006: A component packet MUST contain at least `flags`, `m` and m coefficients, and with flag *references* r and r references.
        """
        rows = short(rows)
        lists = [indices.tolist() for indices, _ in rows]
        data = packet_of(rows)
        if data is None:
            return
        assert decoded(data, len(lists[0]), len(rows)) == lists
        assert decoded_as_the_page_says(data, len(lists[0]), len(rows)) == lists

    @given(strategies.component_rows(ONE.count_bound), st.data())
    def test_mutated(self, rows, data):
        """LPC-001: The component packets MUST fit the packet: their sizes are together at most what follows them."""
        rows = short(rows, 20)
        packet = bytearray(packet_of(rows) or b"\3\x10\0\0\x10\0\0")
        for _ in range(data.draw(st.integers(1, 2))):
            at = data.draw(st.integers(0, len(packet)))
            packet[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
        span = data.draw(st.sampled_from([rows[0][0].size, 1, 21]))
        expected = decoded_as_the_page_says(bytes(packet), span, len(rows), ONE)
        assert decoded(bytes(packet), span, len(rows), ONE) == expected

    @given(
        st.lists(st.sampled_from([0, 1, 2, 4, 6, 0x10, 0x40, 0x41, 0x48, 0x7F, 0x80]), max_size=20),
        st.integers(1, 9),
        st.sampled_from([1, 2, 3]),
    )
    def test_any_bytes(self, listed, span, count):
        data = bytes(listed)
        assert decoded(data, span, count) == decoded_as_the_page_says(data, span, count)

    def test_the_widest_numbers_of_level_2(self):
        """Weights, coefficients and indices at their ends: 64 bits hold every sum."""
        ks = (127, -127) * 5
        c = Predictor(reflections=ks).coefficients
        assert c and max(map(abs, c)) > 1 << 20
        far = TWO.count_bound
        ends = [np.array([far, -far] * 20)] * 8
        for weights in ((-128, -128, -128), (127, -128, 127)):
            predictor = Predictor(1, ks, far, references=tuple(
                Reference(a, weights) for a in range(8)))  # fmt: skip
            lists = [row.tolist() for row in ends]
            flat = [(a, *weights) for a in range(8)]
            expected = page.cross_terms(flat, lists, 40, 1, c)
            assert max(map(abs, expected)) > 1 << 46
            assert cross_terms(predictor, ends).tolist() == expected

    def test_what_a_reference_is_worth(self):
        """The second channel is the first, a tick later and halved."""
        x = np.random.default_rng(4).integers(-500, 500, 2000).cumsum()
        y = np.concatenate(([0], x[:-1])) // 2
        plain = encode_component(y, Predictor(1), [x])
        referring = Predictor(1, references=(Reference(0, (32, 0, 0)),))
        assert len(encode_component(y, referring, [x])) < len(plain) / 5


@built
class TestTwins:
    @given(strategies.component_rows(TWO.count_bound), st.data())
    def test_decode(self, rows, data):
        whole = packet_of(rows)
        packet = bytearray(whole or b"\3\x10\0\0\x10\0\0")
        if data.draw(st.booleans()):
            packet[data.draw(st.integers(0, len(packet) - 1))] ^= 1 << data.draw(st.integers(0, 7))
        span, count = rows[0][0].size, len(rows)
        slow = read_without(bytes(packet), span, count)
        try:
            counts = decode_predicted(bytes(packet), LpcParameters(), span, count, TWO, 0)
            assert counts.T.tolist() == slow
        except FormatError as error:
            assert (error.requirement, error.offset, error.message) == slow

    @given(strategies.component_rows(TWO.count_bound), st.data())
    def test_counts_within_a_range(self, rows, data):
        """A whole packet by one call, on any grid; what is wrong with it is said by the twin."""
        packet = bytearray(packet_of(rows) or b"\3\x10\0\0\x10\0\0")
        if data.draw(st.booleans()):
            packet[data.draw(st.integers(0, len(packet) - 1))] ^= 1 << data.draw(st.integers(0, 7))
        grid = data.draw(st.sampled_from(GRIDS))
        low, high = data.draw(st.sampled_from([(-(2**31), 2**31 - 1), (-90, 70), (5, 5)]))
        span, count = rows[0][0].size, len(rows)
        same(predicted, moved, bytes(packet), grid, span, count, TWO, 7, low, high)

    @pytest.mark.parametrize("repeats", [False, True])
    @pytest.mark.parametrize("order", [*range(12, 18), 24, 25, 32])
    @pytest.mark.parametrize("span", [1, 7, 8, 9, 16, 1023, 1025, 1033])
    def test_steps_of_a_synthesis(self, order, span, repeats):
        rng = np.random.default_rng(order + span)
        ks = tuple(rng.integers(-30, 31, order).tolist())
        for g in (0, 1):
            x = np.repeat(rng.integers(-900, 900, span), 1 + 2 * repeats)[:span].cumsum()
            x = np.clip(x, -TWO.count_bound, TWO.count_bound)
            packet = encode_component(x, Predictor(g, ks, 5, repeats), [])
            assert decode_predicted(packet, LpcParameters(), span, 1, TWO, 0)[:, 0].tolist() == (
                x.tolist()
            )
            # An index beyond the limit, somewhere in a step.
            for limit in (int(abs(x).max()), int(abs(x).max()) - 1):
                bound = replace(TWO, count_bound=max(limit, 5))
                given = (packet, LpcParameters(), span, 1, bound, 0, -(2**31), 2**31 - 1)
                same(predicted, moved, *given)

    @pytest.mark.parametrize("wrong", [
        {1: 0}, {1: 256}, {2: -1}, {2: 2**32 + 1}, {3: 0}, {3: 2**33}, {4: 2**31}, {5: bytes(7)},
        {5: np.zeros(9, np.int64)}, {6: 8}, {6: -(2**31) - 1}, {7: 2**31}, {8: bytes(512)[:508]},
        {8: np.full(128, 32768, np.int32)}, {9: bytearray(6)}, {9: bytearray(0)}, {1: 3},
    ], ids=changed)  # fmt: skip
    def test_what_is_no_grid(self, wrong):
        given = {0: b"\x10\0\0", 1: 1, 2: 9, 3: 1, 4: 0, 5: b"", 6: -7, 7: 7,
                 8: np.zeros(128, np.int32), 9: np.zeros(2, np.int32)}  # fmt: skip
        assert compiled.lpcr_packet(*given.values()) == 1
        with pytest.raises(ValueError, match="not a grid"):
            compiled.lpcr_packet(*(given | wrong).values())
        with pytest.raises(TypeError):
            compiled.lpcr_packet(b"")

    @given(strategies.component_rows())
    def test_encode(self, rows):
        fast = packet_of(rows)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(predicted, "compiled", None)
            patch.setattr(predicted, "compiled", None)
            assert packet_of(rows) == fast

    @given(strategies.index_arrays(), strategies.predictors())
    def test_prediction_errors(self, indices, predictor):
        c, g = predictor.coefficients, predictor.difference
        y = differences(indices - predictor.base, g)
        fast = prediction_errors(indices, g, c, predictor.base)
        assert fast.tolist() == errors_of(y, c).tolist()

    @pytest.mark.parametrize("size", [1023, 1024, 1025, 3000])
    def test_prediction_errors_of_long_packets(self, size):
        x = np.random.default_rng(size).integers(-300, 300, size).cumsum()
        c = Predictor(reflections=tuple(range(-16, 16))).coefficients
        fast = prediction_errors(x, 1, c, 7)
        assert fast.tolist() == errors_of(differences(x - 7, 1), c).tolist()

    @pytest.mark.parametrize("wrong", [
        {2: 2}, {3: 10}, {4: 2**32 + 1}, {4: -1}, {0: bytes(3)}, {5: np.array([0, 10])},
        {5: bytes(7)}, {6: bytearray(8)},
    ], ids=str)  # fmt: skip
    def test_errors_of_what_is_no_predictor(self, wrong):
        given = {0: np.array([8192], np.int32), 2: 1, 3: 0, 4: 9, 5: np.zeros(2, np.int64),
                 6: np.zeros(2, np.int64)} | wrong  # fmt: skip
        with pytest.raises(ValueError, match="not a predictor"):
            compiled.lpcr_errors(*given.values())

    @pytest.mark.parametrize("cross", [
        bytes(8), np.array([2**54 + 1, 0]), np.array([0, -(2**63)]), memoryview(bytes(17))[1:]
    ])  # fmt: skip
    def test_cross_terms_that_would_overflow(self, cross):
        given = [np.array([8192], np.int32), 1, False, 0, 9, cross]
        for call, packet in (
            (compiled.lpcr_decode, bytes(8)),
            (compiled.lpcr_encode, bytearray(8)),
        ):
            with pytest.raises(ValueError, match="not a predictor"):
                call(packet, *given, np.zeros(2, np.int64))


def test_the_sum_of_a_cross_term_is_rounded_half_up():
    steps = np.array([0, 1, 1, 1, 1])
    for weight, expected in ((31, 0), (32, 1), (-32, 0), (-33, -1), (-96, -1), (-97, -2)):
        predictor = Predictor(1, references=(Reference(0, (0, weight, 0)),))
        assert cross_terms(predictor, [steps]).tolist() == [0, expected, 0, 0, 0]


EXAMPLE = re.compile(r"^\| `([0-9A-F ]+)` \| ([-0-9, ]+); ([-0-9, ]+?)(?: \(.*)? \|$", re.M)


def test_example_of_the_page():
    ((text, *columns),) = EXAMPLE.findall(EXAMPLES)
    rows = [[int(number) for number in column.split(", ")] for column in columns]
    data = bytes.fromhex(text)
    assert decoded(data, len(rows[0]), 2) == decoded_as_the_page_says(data, len(rows[0]), 2) == rows


def test_an_index_beyond_the_format():
    with pytest.raises(ValueError, match="2\\^32"):
        encode_component(np.array([0, INDEX_LIMIT + 1]), Predictor(), [])
