"""Entropy coding of knots (SPEC 9.6)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import page
from case import Case
from facts import Packet, Track, case_of
from lpcr import COMMON, PLAIN, Grid, Range
from luck import Luck
from page_knots import HOLD, LINEAR, between

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

WIDE = (-(2**23), 2**23 - 1)
WIDEST = (-(2**31), 2**31 - 1)


def packet(knots: Any, span: int, interpolation: int = HOLD, *, start: int = 0, grid: Grid = PLAIN,
           clamped: Range = COMMON) -> Packet:  # fmt: skip
    """``knots``: (tick, index, or indices of the components)."""
    knots = [(tick, list(v) if isinstance(v, tuple) else [v]) for tick, v in knots]
    body = page.encode_knots(knots, interpolation == LINEAR)
    return coded(body, knots, span, interpolation, start=start, grid=grid, clamped=clamped)


def coded(body: bytes, knots: Any, span: int, interpolation: int = HOLD, *, start: int = 0,
          grid: Grid = PLAIN, clamped: Range = COMMON) -> Packet:  # fmt: skip
    width = len(knots[0][1])
    found = page.decode_knots(body, interpolation == LINEAR, span, width, grid.last)
    assert [(tick, list(row)) for tick, row in found] == knots
    low, high = clamped
    rows = []
    for i in range(width):
        counts = [(tick, grid.count(row[i])) for tick, row in knots]
        rows.append([max(low, min(high, c)) for c in between(counts, span, interpolation)])
    return Packet(start, list(zip(*rows, strict=True)), body)


def track(*packets: Packet, interpolation: int = HOLD, grid: Grid = PLAIN,
          clamped: Range = COMMON, **fields: Any) -> Track:  # fmt: skip
    low, high = clamped
    parameters = bytes([interpolation, 1]) + grid.parameters
    return Track(
        codec="KNOT", parameters=parameters, packets=packets, low=low, high=high, **fields
    )  # fmt: skip


def cases() -> Iterator[Case]:
    yield from examples()
    yield from magnitudes()
    yield from grids()


def examples() -> Iterator[Case]:
    held = [
        coded(
            bytes.fromhex("0E 03 02 92 60 BC 21 00 01"),
            [(0, [7]), (3, [9]), (12, [2]), (13, [3])],
            40,
        )
    ]
    lines = [
        coded(bytes.fromhex("09"), [(0, [-5])], 7, LINEAR),
        coded(bytes.fromhex("02 01 00 40 C0 00"), [(0, [1]), (8, [5])], 9,
              LINEAR, start=7),
        coded(
            bytes.fromhex("00 03 39 35 03 08 21 00 CC"),
            [(0, [0]), (10, [20]), (12, [-3]), (30, [1])], 31, LINEAR, start=16,
        ),
    ]  # fmt: skip
    wide = [
        coded(bytes.fromhex("02 04 01 00 10 C2 5F 69 05 2D"),
              [(0, [1, 2]), (5, [1, -300])], 20, clamped=(-400, 400)),
    ]  # fmt: skip
    yield valid(
        "coded-knots-examples", "The packets that the page shows.", ["RNG-001", "KTE-002"],
        track(*held),
        track(*lines, interpolation=LINEAR, id=1, channel=1),
        track(*wide, id=2, channel=2, width=2, clamped=(-400, 400)),
    )  # fmt: skip
    yield valid(
        "coded-knots-constant", "The first indices alone, hold and linear.", ["KTE-002"],
        track(packet([(0, (3, -70))], 5), width=2),
        track(packet([(0, 99)], 5, LINEAR), interpolation=LINEAR, id=1, channel=2),
    )  # fmt: skip
    yield valid(
        "coded-knots-linear-two",
        "Linear with one more knot: its tick is the last one, and is not coded.", ["KTE-004"],
        track(
            packet([(0, -9), (1, 30)], 2, LINEAR),
            packet([(0, -9), (99, 30)], 100, LINEAR, start=2),
            interpolation=LINEAR,
        ),
    )  # fmt: skip


def magnitudes() -> Iterator[Case]:
    luck = Luck(96)
    ticks = sorted({luck.between(1, 399) for _ in range(70)})
    held = [(0, 0)] + [(tick, luck.between(-90, 90)) for tick in ticks]
    yield valid(
        "coded-knots-hold", "Some 60 held knots.", ["KTE-004", "RNG-001"],
        track(packet(held, 400)),
    )  # fmt: skip
    yield valid(
        "coded-knots-linear",
        "Some 60 knots joined by lines, the last one on the last tick.", ["KTE-004"],
        track(packet(held, ticks[-1] + 1, LINEAR), interpolation=LINEAR),
    )  # fmt: skip
    yield valid(
        "coded-knots-three-components",
        "Three components in one section, one after the other; gaps are shared.",
        ["KTE-004"],
        track(
            packet(
                [(0, (0, 50, -50))]
                + [(tick, (tick % 7, luck.between(-60, 60), -tick // 5)) for tick in ticks], 401,
            ),
            width=3,
        ),
    )  # fmt: skip
    rows = [(tick, tuple(i * luck.between(-1, 1) for i in range(20))) for tick in ticks]
    yield valid(
        "coded-knots-twenty-components",
        "What a section has learnt of one component holds for the next one.", ["KTE-004"],
        track(packet([(0, (0,) * 20), *rows], 400), width=20),
    )  # fmt: skip
    yield valid(
        "coded-knots-every-tick", "A knot on every tick, some with a difference of 0.", ["KTE-004"],
        track(packet([(tick, tick // 3 % 5) for tick in range(40)], 40)),
    )  # fmt: skip
    doubling = [2**b - 1 for b in range(14)] + [2**13]
    gaps = [(sum(doubling[: i + 1]) + i, (-1) ** i * i) for i in range(len(doubling))]
    yield valid(
        "coded-knots-long-gaps", "Gaps of every bit length from 0 to 14.", ["RNG-003"],
        track(packet(gaps, gaps[-1][0] + 5)),
    )  # fmt: skip
    far = [(0, 0), *((i + 1, (-1) ** i * (2**i)) for i in range(23)), (30, 2**24), (31, -(2**24))]
    yield valid(
        "coded-knots-large-differences",
        "Differences of every bit length, up to 26 bits.", ["RNG-003"],
        track(packet(far, 40, clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    yield uncommon(
        "coded-knots-level-2", "Differences of 34 bits between the bounds of level 2.",
        ["RNG-003", "LIM-001"],
        track(
            packet(
                [(0, -(2**32)), (3, 2**32 - 1), (4, -(2**32)), (9, 7)], 10, LINEAR,
                grid=Grid(bound=2**32), clamped=WIDEST,
            ),
            interpolation=LINEAR, clamped=WIDEST,
        ),
        level=2,
    )  # fmt: skip
    yield uncommon(
        "coded-knots-longest-gap",
        "One gap of nearly 2^16 ticks after many short ones.", ["RNG-003"],
        track(packet([*((t, t % 2) for t in range(20)), (65_000, 3)], 65_001)),
    )  # fmt: skip


def grids() -> Iterator[Case]:
    grid = Grid(step=5, zero=3)
    yield valid(
        "coded-knots-uniform-grid",
        "Counts of the grid are joined by lines, not indices.", ["CNV-001"],
        track(
            packet([(0, -4), (7, 9), (9, 9), (12, -10)], 13, LINEAR, grid=grid),
            interpolation=LINEAR, grid=grid,
        ),
    )  # fmt: skip
    band = Grid(step=20, zero=-10, kn=1, kd=10)
    yield valid(
        "coded-knots-deadband-grid",
        "Knots on the grid of a deadband, held and with lines.", ["LPC-003"],
        track(
            packet([(0, 9), (2, -9), (5, 6), (6, 0)], 9, grid=band, clamped=WIDE),
            grid=band, clamped=WIDE,
        ),
        track(
            packet([(0, 9), (4, -8), (11, 1)], 12, LINEAR, grid=band, clamped=WIDE),
            interpolation=LINEAR, grid=band, clamped=WIDE, id=1, channel=1,
        ),
    )  # fmt: skip
    yield valid(
        "coded-knots-clamped",
        "Lines through knots beyond the declared range are clamped, not the knots.",
        ["DEC-001"],
        track(
            packet([(0, -50), (10, 50)], 11, LINEAR, clamped=(-30, 20)),
            interpolation=LINEAR, clamped=(-30, 20),
        ),
    )  # fmt: skip
