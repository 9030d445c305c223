"""Layers of events, and other clocks (SPEC 9.9, 11.6)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import forge as f
from case import Case
from facts import Event, Layer, Packet, Track, case_of, digest

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

FIVES = Track(packets=[Packet(0, [5] * 4, f.KNOT_DATA)])


def cases() -> Iterator[Case]:
    yield from events()
    yield from clocks()


def events() -> Iterator[Case]:
    yield valid(
        "events", "Moments and stretches of time, of a channel and of the whole recording.",
        ["EVT-001", "EVT-003"],
        FIVES,
        layers=[
            Layer(
                label="marks",
                packets=[
                    (1000, 3000, [
                        Event(1000, 0, None, "first"), Event(1500, 700, 0, "touch"),
                        Event(1500, 0, 0, ""), Event(3999, 1, None, "µ\n"),
                    ])
                ],
            )
        ],
    )  # fmt: skip
    yield valid(
        "events-out-of-order",
        "Packets of one layer overlap and come in any order; events of one tick stay in order of "
        "the file.",
        ["EVT-004", "DAT-006"],
        FIVES,
        layers=[
            Layer(
                packets=[
                    (100, 900, [Event(100, 0, None, "c"), Event(500, 0, None, "d")], 0),
                    (0, 600, [Event(50, 0, None, "a"), Event(500, 9, None, "e")], 1),
                    (100, 1, [Event(100, 0, 0, "b")], 1),
                ],
            )
        ],
    )  # fmt: skip
    yield valid(
        "events-two-layers", "Two layers of two observers, at rates of their own.",
        ["TRK-019", "EVT-004"],
        FIVES,
        layers=[
            Layer(id=2, label="left", rate=(3, 1), packets=[(0, 9, [Event(8, 2, None, "x")])]),
            Layer(
                id=1, label="", rate=(1000, 1),
                tlvs=f.tlv(14, f.strings("pen")) + f.tlv(22, b"by hand"),
                packets=[(0, 9, [Event(8, 0, None, "y")])],
            ),
        ],
    )  # fmt: skip
    yield uncommon(
        "events-without-packets", "A layer without events.", ["TRK-019"],
        FIVES, layers=[Layer(label="none")],
    )  # fmt: skip
    yield uncommon(
        "events-alone", "A file of events alone: no channel, and a duration all the same.",
        ["TRK-010", "FOT-002"],
        layers=[
            Layer(id=0, label="notes", packets=[(0, 5_000_001, [Event(5_000_000, 0, None, "!")])])
        ],
    )  # fmt: skip
    text = "漢字🙂" * 20
    yield uncommon(
        "events-far",
        "An event that ends at tick 2^48, in a packet of one tick, with a text of 200 bytes.",
        ["EVT-001", "EVT-003", "DAT-003"],
        FIVES,
        layers=[Layer(packets=[(2**40, 1, [Event(2**40, 2**48 - 2**40, 0, text)])])],
    )  # fmt: skip
    many = [Event(tick // 3, tick % 5, None, chr(97 + tick % 26)) for tick in range(1000)]
    yield uncommon(
        "events-many", "1000 events in one packet, three to a tick.", ["EVT-001"],
        FIVES, layers=[Layer(packets=[(0, 334, many)])],
    )  # fmt: skip


def told(rows: Sequence[tuple[int, int, int]], name: str = "pc", track: int | None = 0) -> dict:
    """An entry of ``clocks``."""
    return {
        "track": track,
        "name": name,
        "observations": [[t, str(ns), str(u)] for t, ns, u in rows],
    }


def mapped(rows: Sequence[tuple[int, int]], name: str = "pc", track: int | None = 0) -> dict:
    return {"track": track, "name": name, "points": [[t, str(ns)] for t, ns in rows]}


def clock(rows: Sequence[tuple[int, int, int]], name: str = "pc",
          track: int | None = 0) -> f.Chunk:  # fmt: skip
    return "cLOk", f.clock(rows, name, track=track)


def clock_map(rows: Sequence[tuple[int, int]], name: str = "pc",
              track: int | None = 0) -> f.Chunk:  # fmt: skip
    return "cMAp", f.clock_map(rows, name, track=track)


def with_chunks(*chunks: Any) -> dict[str, Any]:
    return {"more": chunks}


def clocks() -> Iterator[Case]:
    one = [(0, 5_000_000_000, 1000), (4, 5_004_000_160, 0)]
    yield valid(
        "clock", "Two observations of another clock, in ticks of a track.", ["CLK-001", "CLK-005"],
        FIVES, file=with_chunks(clock(one)), clocks=[told(one)],
    )  # fmt: skip
    back = [(100, 9, 1), (-7, 1 - 2**51, 2**53 - 1), (-7, 2**51 - 1, 0), (2**40, 0, 5)]
    yield valid(
        "clock-any-order", "Observations in any order, of ticks and times below zero too.",
        ["CLK-003"],
        FIVES, file=with_chunks(clock(back)), clocks=[told(back)],
    )  # fmt: skip
    nanoseconds = [(3_000_000, 1_700_000_000_123_456_789, 50)]
    yield valid(
        "clock-of-recording", "A clock without a track: ticks are nanoseconds of the recording.",
        ["CLK-005"],
        FIVES, file=with_chunks(clock(nanoseconds, "UTC", None)),
        clocks=[told(nanoseconds, "UTC", None)],
    )  # fmt: skip
    yield valid(
        "clocks", "Several chunks of one clock and of others, in order of the file.", ["CLK-001"],
        FIVES,
        file=with_chunks(clock(one), clock(nanoseconds, "ø", None), clock(back)),
        clocks=[told(one), told(nanoseconds, "ø", None), told(back)],
    )  # fmt: skip
    line = [(-5, -1_000_000_000), (0, 0), (4, 4_000_160)]
    yield valid(
        "clock-map", "A map of three points from ticks to another clock.", ["CLK-003", "CLK-001"],
        FIVES, file=with_chunks(clock_map(line)), maps=[mapped(line)],
    )  # fmt: skip
    later = [(0, 7), (10**9, 10**9 + 8)]
    yield valid(
        "clock-maps", "A later map of the same clock, one of another, and one without a track.",
        ["CLK-005"],
        FIVES,
        file=with_chunks(
            clock_map(line), clock_map(later), clock_map(line, "x"), clock_map(later, "pc", None)
        ),
        maps=[mapped(line), mapped(later), mapped(line, "x"), mapped(later, "pc", None)],
    )  # fmt: skip
    other = Track(id=300, packets=[Packet(0, [5] * 4, f.KNOT_DATA)])
    yield valid(
        "clocks-of-track-300", "A clock, a map and a digest of track 300: ids of two bytes.",
        ["CLK-005", "DGS-001", "DGS-002"],
        other,
        file=with_chunks(
            clock(one, "pc", 300), clock_map(line, "pc", 300),
            ("dGST", f.digests(digest(other), first=300)),
        ),
        clocks=[told(one, "pc", 300)], maps=[mapped(line, "pc", 300)],
    )  # fmt: skip
    name = "é" * 127
    yield uncommon(
        "clock-long-name", "A clock's name of 254 bytes.", ["CLK-001"],
        FIVES, file=with_chunks(clock(one, name)), clocks=[told(one, name)],
    )  # fmt: skip
    edge = [(-(2**52) + 1, -(2**63), 0)]
    last = [(2**52 - 1, 2**63 - 1, 2**53 - 1)]
    ends = [(-(2**51), -(2**51)), (2**51 - 1, 2**52)]
    yield uncommon(
        "clock-extremes", "The largest ticks, times and uncertainties.", ["CLK-003"],
        FIVES, file=with_chunks(clock(edge), clock(last), clock_map(ends)),
        clocks=[told(edge), told(last)], maps=[mapped(ends)],
    )  # fmt: skip
