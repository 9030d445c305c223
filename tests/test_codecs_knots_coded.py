"""Clause 9.6: coded knots, against the page."""

from __future__ import annotations

import contextlib
import re

import numpy as np
import page
import pytest
import strategies
from conftest import memory_cap
from hypothesis import given
from hypothesis import strategies as st
from spec import EXAMPLES

from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.knots import (
    KnotParameters,
    build_knots,
    decode_coded_knots,
    decode_indices,
    decode_knots,
    encode_knots,
)
from hapfmt.errors import FormatError, HapfmtError
from hapfmt.format.cluster import Packet
from hapfmt.limits import LEVELS
from hapfmt.reading.decoder import TrackDecoder

pytestmark = pytest.mark.capped

ONE, TWO = LEVELS[1], LEVELS[2]
FAR = 2**32


def decoded(data, interpolation, span, width, limit=FAR):
    """(tick, indices) of each knot, or the id of the rule that was broken."""
    try:
        ticks, indices = decode_indices(data, interpolation, span, width, limit, 0)
        return list(zip(ticks.tolist(), indices.tolist(), strict=True))
    except HapfmtError as error:
        return error.requirement


def decoded_as_the_page_says(data, interpolation, span, width, limit=FAR):
    try:
        return page.decode_knots(data, interpolation == "linear", span, width, limit)
    except page.BrokenRule as rule:
        return str(rule)


class TestParameters:
    @given(strategies.levels.flatmap(lambda v: st.tuples(st.just(v), strategies.coded_knots(v))))
    def test_come_back(self, case):
        """KNT-001: `interpolation` and `coding` MUST be 0 or 1."""
        level, parameters = case
        data = parameters.build()
        assert KnotParameters.parse(data, level, 0) == parameters
        for other in (data[:-1], data + b"\0", b"", data[:1] + b"\2" + data[2:], b"\2" + data[1:],
                      data[:2] + b"\2" + data[3:]):  # fmt: skip
            with pytest.raises(FormatError):
                KnotParameters.parse(other, level, 0)

    @given(st.binary(max_size=16))
    def test_any_bytes(self, data):
        with contextlib.suppress(FormatError):
            assert KnotParameters.parse(data, TWO, 0).build() == data


class TestPackets:
    @given(strategies.knot_rows(), st.data())
    def test_as_the_page_says(self, case, data):
        """
        KTE-004: Every tick MUST be less than `span` minus the number of knots that follow it. Where it is present, f is at least 1 and less than `span`.
        """
        interpolation, ticks, indices, span = case
        rows = list(zip(ticks.tolist(), indices.tolist(), strict=True))
        packet = encode_knots(ticks, indices, interpolation)
        assert packet == page.encode_knots(rows, interpolation == "linear")
        width = indices.shape[1]
        assert decoded(packet, interpolation, span, width) == rows
        wrong = bytearray(packet)
        at = data.draw(st.integers(0, len(packet) - 1))
        wrong[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
        limit = data.draw(st.sampled_from([0, 7, 2**24, FAR]))
        for given_, span_ in ((bytes(wrong), span), (packet, span + 1), (packet[:-1], span)):
            expected = decoded_as_the_page_says(given_, interpolation, span_, width, limit)
            assert decoded(given_, interpolation, span_, width, limit) == expected

    @given(
        st.lists(st.sampled_from([0, 1, 2, 3, 9, 0x7F, 0x80, 0xFF]), max_size=14).map(bytes),
        st.sampled_from(["hold", "linear"]),
        st.integers(1, 30),
        st.integers(1, 3),
        st.sampled_from([0, 7, FAR]),
    )
    def test_any_bytes(self, data, interpolation, span, width, limit):
        expected = decoded_as_the_page_says(data, interpolation, span, width, limit)
        assert decoded(data, interpolation, span, width, limit) == expected

    @given(strategies.knot_rows(), strategies.coded_knots(ONE))
    def test_counts_are_those_of_knots(self, case, parameters):
        """The same knots in varints, on the grid."""
        interpolation, ticks, indices, span = case
        parameters = KnotParameters(interpolation, parameters.grid, coded=True)
        limit = parameters.grid.index_limit(ONE.count_bound)
        indices = indices.clip(-limit, limit)
        packet = encode_knots(ticks, indices, interpolation)
        got = decode_coded_knots(packet, parameters, span, indices.shape[1], ONE, 0)
        plain = build_knots(ticks, indices)
        parameters = KnotParameters(interpolation, parameters.grid)
        expected = decode_knots(plain, parameters, span, indices.shape[1], ONE, 0)
        assert got.tolist() == expected.tolist()


EXAMPLE = re.compile(
    r"^\| `([0-9A-F ]+)` \| (hold|linear), (\d+) \| ((?:\d+: [-0-9 ]+(?:, )?)+) \|$", re.M
)


def test_examples_of_the_page():
    examples = EXAMPLE.findall(EXAMPLES)
    assert len(examples) == 5
    for text, interpolation, span, knots in examples:
        data = bytes.fromhex(text)
        rows = []
        for knot in knots.split(", "):
            tick, indices = knot.split(": ")
            rows.append((int(tick), [int(index) for index in indices.split()]))
        assert decoded(data, interpolation, int(span), len(rows[0][1])) == rows
        ticks, indices = (np.array(part) for part in zip(*rows, strict=True))
        assert encode_knots(ticks, indices, interpolation) == data


@pytest.mark.parametrize("level", [ONE, TWO])
@pytest.mark.parametrize("grid", [LpcParameters(), LpcParameters(1, 0, 1, 3)])
def test_extremes_of_each_level_are_exact(level, grid):
    last = grid.index_limit(level.count_bound)
    span = 1 << 20
    packet = encode_knots(np.array([0, span - 1]), np.array([[-last], [last]]), "linear")
    parameters = KnotParameters("linear", grid, coded=True)
    counts = decode_coded_knots(packet, parameters, span, 1, level, 0)[:, 0].tolist()
    low, high = counts[0], counts[-1]
    for t in (1, 2, 9999, span - 2):
        n, d = (high - low) * t, span - 1
        assert counts[t] == low + (2 * n + d) // (2 * d)


def test_a_few_bytes_ask_for_little():
    """After its bytes a packet is over at once, whatever its span and its count of knots."""
    for tail in (b"", b"\0", b"\xff" * 4, b"\x80\0\0\0", bytes(40), b"\xff" * 40):
        data = b"\0\xff\xff\xff\x07" + tail
        expected = ("KTE-004", "LPC-003", "RNG-001", "RNG-003")
        assert decoded(data, "hold", 1 << 24, 1) in expected


@pytest.mark.capped(False)
def test_knots_of_few_bits_take_bytes_each():
    """The least that a flag takes is 0.001 bits: some 8 bytes of memory a number, no object."""
    span = 1 << 16
    ticks = np.arange(span)
    data = encode_knots(ticks, np.zeros((span, 1), np.int64), "hold")
    assert len(data) < span // 1000
    with memory_cap(8 << 20):
        got, rows = decode_indices(data, "hold", span, 1, 7, 0)
    assert (got == ticks).all()
    assert not rows.any()


def test_the_first_broken_rule_is_told():
    """A knot beyond the grid before one beyond the packet, the other way round, and both in one."""
    for ticks, indices, expected in (
        ([0, 1, 9, 12], [0, 9, 0, 0], "LPC-003"),
        ([0, 9, 10, 12], [0, 0, 9, 0], "KTE-004"),
        ([0, 1, 9, 12], [0, 0, 9, 0], "KTE-004"),
    ):
        packet = encode_knots(np.array(ticks), np.array(indices)[:, None], "hold")
        assert decoded(packet, "hold", 10, 1, 7) == expected
        assert decoded_as_the_page_says(packet, "hold", 10, 1, 7) == expected


@given(strategies.packets().filter(lambda case: case[0].codec == "KNOT"), st.binary(max_size=9))
def test_a_track_decodes_or_says_why(case, other):
    track, packets, numbers = case
    decoder = TrackDecoder(track, ONE)
    for packet, counts in zip(packets, numbers, strict=True):
        got = decoder.decode(packet)
        assert got.shape == (packet.span, counts.shape[1])
        assert (got[0] == counts[0].clip(track.count_min, track.count_max)).all()
    with contextlib.suppress(HapfmtError):
        decoder.decode(Packet(0, 0, 3, other))
