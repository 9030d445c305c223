"""Clauses 11.6 and 7: chunks of clocks, maps in both directions, ticks of a time range."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from fractions import Fraction

import forge as f
from page import BrokenRule, rdiv, signed, varint

from .component import Case, Component, tried


def name_of(data: bytes, at: int) -> tuple[str, int]:
    if at == len(data) or not data[at] or at + 1 + data[at] > len(data):
        raise BrokenRule("CLK-001")
    try:
        name = data[at + 1 : at + 1 + data[at]].decode("utf-8", "strict")
    except UnicodeDecodeError:
        raise BrokenRule("CNV-004") from None
    if "\0" in name:
        raise BrokenRule("CNV-004")
    return name, at + 1 + data[at]


def number(data: bytes, at: int) -> tuple[int, int]:
    if all(byte >= 128 for byte in data[at : at + 8]) and len(data) - at < 8:
        raise BrokenRule("CLK-001", "CNV-002")
    return varint(data, at)


def parse(data: bytes, *, is_map: bool) -> Case:
    """Track, name, and the rows of either."""
    track, at = number(data, 0)
    name, at = name_of(data, at)
    count, at = number(data, at)
    if count < 1 + is_map:
        raise BrokenRule("CLK-001")
    rows: list[list[int]] = []
    for _ in range(count):
        u, at = number(data, at)
        if not rows:
            tick = signed(u)
            if at + 8 > len(data):
                raise BrokenRule("CLK-001")
            (time,) = struct.unpack_from("<q", data, at)
            at += 8
        else:
            v, at = number(data, at)
            if is_map and (u < 1 or v < 1):
                raise BrokenRule("CLK-003")
            tick = rows[-1][0] + (u if is_map else signed(u))
            time = rows[-1][1] + (v if is_map else signed(v))
        if abs(tick) >= 2**52 or not -(2**63) <= time < 2**63:
            raise BrokenRule("CLK-003")
        row = [tick, time]
        if not is_map:
            uncertainty, at = number(data, at)
            row.append(uncertainty)
        rows.append(row)
    if at != len(data):
        raise BrokenRule("CLK-001")
    told = {"track": track - 1 if track else None, "clock": name}
    return told | {("points" if is_map else "observations"): rows}


def chunks() -> Component:
    seen = [(0, 5_000_000_000, 1000), (4, 5_004_000_160, 1000), (2, 4_999_000_000, 0)]
    far = [(-(2**52) + 1, -(2**63), 0), (-1, -(2**63) + 2**52 - 1, 2**53 - 1)]
    rows: list[tuple] = [
        ("one observation", False, f.clock(seen[:1])),
        ("three, the last one earlier", False, f.clock(seen)),
        ("far away", False, f.clock(far)),
        ("a name of three bytes a letter", False, f.clock(seen[:1], name="€uro")),
        ("two points", True, f.clock_map([(0, -5), (7, 2)])),
        ("three points", True, f.clock_map([(-9, 2**62), (0, 2**62 + 3), (2**40, 2**62 + 2**41)])),
        ("of track 300", False, f.clock(seen[:1], track=300)),
        ("of track 0", True, f.clock_map([(0, -5), (7, 2)], track=0)),
        ("a track that is not minimal", False, b"\x80" + f.clock(seen)),
        ("a track alone", False, b"\0"),
        ("no name", False, f.clock(seen, name="")),
        ("no bytes", False, b""),
        ("the name ends behind the payload", False, b"\0\x09pc"),
        ("no UTF-8", False, b"\0\1\xff" + f.clock(seen)[4:]),
        ("no observations", False, f.clock([])),
        ("one point", True, f.clock_map([(0, 0)])),
        ("fewer than said", False, f.clock(seen, count=4)),
        ("more than said", False, f.clock(seen, count=2)),
        ("a point more than said", True, f.clock_map([(0, 0), (1, 1), (2, 2)], count=2)),
        ("ends within a time", False, f.clock(seen[:1])[:-3]),
        ("a tick of 2^52", False, f.clock([(2**52 - 2, 0, 0), (2**52, 0, 0)])),
        ("a time of 2^63", False, f.clock([(0, 2**63 - 1, 0), (1, 2**63, 0)])),
        ("a time of 2^63 on a map", True, f.clock_map([(0, 2**63 - 1), (1, 2**63)])),
        ("equal ticks", True, f.clock_map([(3, 0), (3, 5)])),
        ("equal times", True, f.clock_map([(3, 5), (4, 5)])),
    ]
    cases = [
        tried(
            {"name": name, "chunk": "cMAp" if is_map else "cLOk", "payload": data},
            lambda data=data, is_map=is_map: parse(data, is_map=is_map),
        )
        for name, is_map, data in rows
    ]
    return Component(
        "clock-chunks",
        "11.6",
        ("CLK-001", "CLK-003", "CNV-004"),
        "Payloads of cLOk and their tracks (null: none), observations as [tick, time_ns, "
        "uncertainty_ns], and of cMAp, points as [tick, time_ns].",
        cases,
    )


def line(points, key: int, at: int):
    """The two points of the line for ``at``."""
    place = max([i for i, point in enumerate(points) if point[key] <= at], default=0)
    place = min(place, len(points) - 2)
    return points[place], points[place + 1]


def maps() -> Component:
    shapes = (
        ("two points", [(0, 1000), (10, 1007)]),
        ("slower, then faster", [(-5, -100), (5, 3), (8, 1000), (100, 1001)]),
        ("40 ppm", [(0, 1_700_000_000_000_000_000), (3_600_000, 1_700_003_600_144_000_000)]),
        ("far away", [(-(2**52) + 1, -(2**63)), (2**52 - 1, 2**63 - 1)]),
    )
    cases = []
    for name, points in shapes:
        (k0, t0), (k1, t1) = points[0], points[-1]
        ticks = [
            *dict.fromkeys(
                [
                    k0 - 1000,
                    k0 - 1,
                    k0,
                    k0 + 1,
                    (k0 + k1) // 2,
                    k1 - 1,
                    k1,
                    k1 + 1,
                    k1 + 999,
                    *(k for k, _ in points),
                ]
            )
        ]
        times = [
            *dict.fromkeys(
                [
                    t0 - 12345,
                    t0 - 1,
                    t0,
                    t0 + 1,
                    (t0 + t1) // 2,
                    t1 - 1,
                    t1,
                    t1 + 1,
                    *(t for _, t in points),
                ]
            )
        ]
        there, back = [], []
        for k in ticks:
            (a, b), (c, d) = line(points, 0, k)
            there.append([k, b + rdiv((d - b) * (k - a), c - a)])
        for t in times:
            (a, b), (c, d) = line(points, 1, t)
            back.append([t, a + rdiv((c - a) * (t - b), d - b)])
        cases.append(
            {"name": name, "points": points, "times_of_ticks": there, "ticks_of_times": back}
        )
    return Component(
        "clock-maps",
        "11.6",
        ("CLK-006", "CNV-001"),
        "Maps as points [tick, time_ns]: `times_of_ticks` as [tick, time], `ticks_of_times` as "
        "[time, "
        "tick], before the first point and behind the last too.",
        cases,
    )


def times() -> Component:
    rows = (
        ("whole seconds", 1000, 1, "0", "2"),
        ("a tenth, exactly", 1000, 1, "1/10", "2/10"),
        ("one nanosecond later", 1000, 1, "100000001/1000000000", "200000001/1000000000"),
        ("within one tick", 1000, 1, "1/10000", "9/10000"),
        ("nothing", 1000, 1, "1", "1"),
        ("a third of a rate", 44100, 3, "1/3", "2/3"),
        ("a slow rate", 1, 60, "59", "61"),
        ("before the start", 1000, 1, "-1", "1/1000"),
        ("a rate of 2^32", 2**32 - 1, 1, "1/7", "1/3"),
        ("a rate as it is in the file", 2000, 2, "1/1000", "7/2000"),
    )
    cases = []
    for name, num, den, t0, t1 in rows:
        rate = Fraction(num, den)
        first, stop = (-(-(Fraction(t) * rate) // 1) for t in (t0, t1))
        cases.append(
            {"name": name, "rate": [num, den], "from": t0, "to": t1, "start": first, "stop": stop}
        )
    for name, num, den, tick in (
        ("seconds of a tick", 1000, 1, 1234),
        ("of a tick, thirds", 3, 1, 1),
        ("of no whole rate", 44100, 1001, 77),
    ):
        at = Fraction(tick * den, num)
        cases.append(
            {
                "name": name,
                "rate": [num, den],
                "tick": tick,
                "seconds": [at.numerator, at.denominator],
            }
        )
    return Component(
        "times",
        "7",
        ("TIM-001",),
        "Ticks `start` <= t < `stop` that the time range `from` <= t < `to` selects, in exact "
        "seconds "
        "(also below 0: no file has those); and the seconds of a tick as a "
        "fraction.",
        cases,
    )


def components() -> Iterator[Component]:
    yield chunks()
    yield maps()
    yield times()
