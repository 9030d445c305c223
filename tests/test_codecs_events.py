"""Clause 9.9: packets of events."""

from __future__ import annotations

import contextlib
import tracemalloc

import forge as f
import page
import page_events
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.codecs.events import CodedEvent, build_events, parse_events
from hapfmt.errors import FormatError, HapfmtError, ParameterError


def as_the_page_has_it(events):
    return [(e.tick, e.duration, 0 if e.channel is None else e.channel + 1, e.text) for e in events]


@given(strategies.coded_events())
def test_come_back(made):
    """
    EVT-001: A packet MUST contain 1 to 65536 events, each whole. The tick of each is less than `start + span`; its end, tick plus duration, is at most 2^48.
    """
    start, span, events = made
    data = build_events(events, start)
    assert parse_events(data, start, span, 0) == events
    rows = as_the_page_has_it(events)
    assert page_events.decode(data, start, span) == rows
    assert page_events.encode(rows, start) == data


@given(
    st.binary(max_size=30)
    | st.lists(st.sampled_from([0, 1, 2, 0x80, 0xFF]), max_size=20).map(bytes)
)
def test_any_bytes(data):
    try:
        found = as_the_page_has_it(parse_events(data, 3, 9, 0))
    except FormatError as error:
        with pytest.raises(page.BrokenRule) as broken:
            page_events.decode(data, 3, 9)
        assert str(broken.value) == error.requirement
    else:
        assert page_events.decode(data, 3, 9) == found
        assert page_events.encode(found, 3) == data


@given(strategies.coded_events(), st.data())
def test_mutated(made, data):
    start, span, events = made
    packet = bytearray(build_events(events, start))
    at = data.draw(st.integers(0, len(packet) - 1))
    packet[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
    with contextlib.suppress(HapfmtError):
        parse_events(bytes(packet), start, span, 0)


@pytest.mark.deep
def test_as_many_as_there_may_be():
    data = f.event(0) * 65536
    tracemalloc.start()
    assert len(parse_events(data, 0, 1, 0)) == 65536
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 << 20


@pytest.mark.parametrize(
    "event",
    [
        CodedEvent(0, 0, None, "\0"),
        CodedEvent(0, 0, None, "\ud800"),
        CodedEvent(0, 0, None, "a" * 65536),
        CodedEvent(0, 0, 65535, ""),
        CodedEvent(0, 0, -1, ""),
        CodedEvent(0, -1, None, ""),
        CodedEvent(-1, 0, None, ""),
        CodedEvent(0, 2**48 + 1, None, ""),
    ],
)
def test_what_no_packet_holds(event):
    with pytest.raises(ParameterError):
        build_events([event], 0)


def test_how_many_no_packet_holds():
    with pytest.raises(ParameterError):
        build_events([], 0)
    with pytest.raises(ParameterError):
        build_events([CodedEvent(0, 0, None, "")] * 65537, 0)
    with pytest.raises(ParameterError, match="out of order"):
        build_events([CodedEvent(1, 0, None, ""), CodedEvent(0, 0, None, "")], 0)
