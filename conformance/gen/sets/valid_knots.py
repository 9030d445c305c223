"""KNOT (SPEC 9.1)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import forge as f
import page_knots
from case import Case
from facts import Packet, Track, case_of
from lpcr import Grid
from page_knots import HOLD, LINEAR
from page_numbers import rdiv

WIDE = (-(2**23), 2**23 - 1)

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")


def packet(knots: Any, rows: list, interpolation: int = HOLD, *, start: int = 0, step: int = 1,
           clamped: tuple[int, int] = (-100, 100), bound: int = 2**24) -> Packet:  # fmt: skip
    """``knots``: (tick, value, or values of the components). The page must say ``rows`` too."""
    knots = [(tick, list(v) if isinstance(v, tuple) else [v]) for tick, v in knots]
    body, width = page_knots.encode(knots), len(knots[0][1])
    found = page_knots.decode(body, width, len(rows), interpolation, step, bound)
    low, high = clamped
    held = [tuple(max(low, min(high, each)) for each in row) for row in zip(*found, strict=True)]
    assert held == [row if isinstance(row, tuple) else (row,) for row in rows], (held, rows)
    return Packet(start, rows, body)


def track(*packets: Packet, interpolation: int = HOLD, step: int = 1, **fields: Any) -> Track:
    return Track(
        parameters=f.knot_parameters(interpolation, step), packets=packets, **fields
    )  # fmt: skip


def on_grid(knots: list[tuple[int, int]], span: int, grid: Grid, interpolation: int, *,
            low: int, high: int, id: int = 0) -> Track:  # fmt: skip
    """Knots in varints whose values are indices of any grid."""
    body = page_knots.encode([(tick, [index]) for tick, index in knots])
    assert page_knots.parse(body, 1, span, interpolation, grid.last)
    found = page_knots.between(
        [(tick, grid.count(index)) for tick, index in knots], span, interpolation
    )
    return Track(
        parameters=f.knot_parameters(
            interpolation, grid.step, grid=int(grid.kn > 0), zero=grid.zero, kn=grid.kn, kd=grid.kd
        ),
        packets=[Packet(0, [max(low, min(high, count)) for count in found], body)],
        low=low, high=high, id=id, channel=id,
    )  # fmt: skip


def cases() -> Iterator[Case]:
    yield valid(
        "knot-constant", "A single knot holds for the whole span.", ["KNT-002"],
        track(packet([(0, -3)], [-3] * 6)),
    )  # fmt: skip
    yield valid(
        "knot-hold", "Held values change at their knots, the last one holds to the end.",
        ["KNT-001", "KNT-003"],
        track(packet([(0, 4), (2, -7), (3, 60), (7, 0)], [4, 4, -7, 60, 60, 60, 60, 0, 0])),
    )  # fmt: skip
    yield valid(
        "knot-hold-last-tick", "A held knot on the last tick of the span.", ["KNT-003"],
        track(packet([(0, 1), (4, 2)], [1, 1, 1, 1, 2])),
    )  # fmt: skip
    yield valid(
        "knot-linear", "A rising and a falling line that meet every tick exactly.", ["KNT-003"],
        track(
            packet([(0, 0), (4, 8), (6, -8)], [0, 2, 4, 6, 8, 0, -8], LINEAR),
            interpolation=LINEAR,
        ),
    )  # fmt: skip
    yield valid(
        "knot-linear-ties",
        "Halves between knots are rounded towards plus infinity, above zero and below.",
        ["CNV-001"],
        track(
            packet(
                [(0, 0), (2, 1), (4, 0), (6, -1), (8, -4), (10, -1)],
                [0, 1, 1, 1, 0, 0, -1, -2, -4, -2, -1], LINEAR,
            ),
            interpolation=LINEAR,
        ),
    )  # fmt: skip
    yield valid(
        "knot-linear-rounding",
        "Thirds and sevenths of falling lines are rounded to nearest, not towards zero.",
        ["CNV-001"],
        track(
            packet(
                [(0, 10), (3, 5), (10, -5)],
                [10, 8, 7, 5, 4, 2, 1, -1, -2, -4, -5], LINEAR,
            ),
            interpolation=LINEAR,
        ),
    )  # fmt: skip
    yield valid(
        "knot-linear-shallow",
        "One count up in 98 ticks: half of it at tick 49 is a tie, which no slope may blur.",
        ["CNV-001"],
        track(
            packet([(0, 0), (98, 1)], [0] * 49 + [1] * 50, LINEAR), interpolation=LINEAR
        ),
    )  # fmt: skip
    steep = [-(2**23) + rdiv((2**24 - 1) * tick, 999) for tick in range(1000)]
    yield valid(
        "knot-linear-steep", "A line through all 24 bits in 1000 ticks: binary32 would blur it.",
        ["CNV-001"],
        track(
            packet([(0, -(2**23)), (999, 2**23 - 1)], steep, LINEAR, clamped=WIDE),
            interpolation=LINEAR, low=WIDE[0], high=WIDE[1],
        ),
    )  # fmt: skip
    yield valid(
        "knot-grids",
        "Knots in varints on a uniform grid with a zero, and on the grid of a deadband.",
        ["KNT-001", "LPC-003", "CNV-001"],
        on_grid([(0, -4), (7, 9), (9, 9), (12, -10)], 13, Grid(5, 3), LINEAR, low=-60, high=60),
        on_grid([(0, 9), (2, -9), (5, 6), (6, 0)], 9, Grid(20, -10, 1, 10), HOLD,
                low=-1000, high=1000, id=1),
        on_grid([(0, 9), (4, -8), (11, 1)], 12, Grid(20, -10, 1, 10), LINEAR,
                low=-1000, high=1000, id=2),
    )  # fmt: skip
    yield valid(
        "knot-linear-single", "With linear interpolation too a single knot is a constant.",
        ["KNT-003"],
        track(packet([(0, 9)], [9] * 5, LINEAR), interpolation=LINEAR),
    )  # fmt: skip
    yield valid(
        "knot-step", "Counts are interpolated, not indices.", ["CNV-001"],
        track(
            packet([(0, 1), (4, 2)], [25, 31, 38, 44, 50], LINEAR, step=25),
            interpolation=LINEAR, step=25,
        ),
    )  # fmt: skip
    yield valid(
        "knot-three-components", "Components share the ticks of the knots, each has its values.",
        ["KNT-002"],
        track(
            packet(
                [(0, (1, -1, 50)), (3, (4, -4, 50)), (4, (0, 0, -50))],
                [(1, -1, 50), (2, -2, 50), (3, -3, 50), (4, -4, 50), (0, 0, -50)], LINEAR,
            ),
            width=3, interpolation=LINEAR,
        ),
    )  # fmt: skip
    yield valid(
        "knot-clamped", "Decoded counts beyond the declared range are clamped to it, both ways.",
        ["DEC-001"],
        track(
            packet(
                [(0, -20), (8, 20)], [-8, -8, -8, -5, 0, 5, 7, 7, 7], LINEAR, clamped=(-8, 7),
            ),
            low=-8, high=7, interpolation=LINEAR,
        ),
    )  # fmt: skip
    yield valid(
        "knot-one-tick", "A packet of one tick.", ["DAT-003", "KNT-003"],
        track(packet([(0, 42)], [42], LINEAR), interpolation=LINEAR),
    )  # fmt: skip
    yield valid(
        "knot-two-packets", "Each packet decodes alone: its first knot is no difference.",
        ["DAT-007"],
        track(
            packet([(0, 50), (1, 52)], [50, 52, 52]), packet([(0, 50)], [50] * 2, start=3),
            packet([(0, -50)], [-50] * 3, start=5),
        ),
    )  # fmt: skip
    far = [-(2**24) + rdiv(2**25 * tick, 1000) for tick in range(1001)]
    yield uncommon(
        "knot-linear-far",
        "A line from one count bound to the other, beyond the declared range on both sides.",
        ["LPC-003", "CNV-001", "DEC-001"],
        track(
            packet(
                [(0, -(2**24)), (1000, 2**24)],
                [max(-(2**23), min(2**23 - 1, count)) for count in far], LINEAR,
                clamped=(-(2**23), 2**23 - 1),
            ),
            low=-(2**23), high=2**23 - 1, interpolation=LINEAR,
        ),
    )  # fmt: skip
    wide = {"low": -(2**31), "high": 2**31 - 1}
    yield uncommon(
        "knot-level-2",
        "Lines between the count bounds of level 2, whose differences have 34 bits.",
        ["LIM-001", "CNV-001"],
        track(
            packet(
                [(0, -(2**31)), (3, 2**31 - 1)],
                [-(2**31), -715827883, 715827882, 2**31 - 1], LINEAR,
                clamped=(-(2**31), 2**31 - 1), bound=2**32,
            ),
            packet(
                [(0, 2**32), (3, -(2**32))], [2**31 - 1, 1431655765, -1431655765, -(2**31)],
                LINEAR, start=4, clamped=(-(2**31), 2**31 - 1), bound=2**32,
            ),
            interpolation=LINEAR, **wide,
        ),
        level=2,
    )  # fmt: skip
    # The last points, y(2) and y(-2), lie almost twice as far as the count bound.
    ends = [(0, 2), (7, -2), (8, 1), (13, 2)]
    yield uncommon(
        "knot-deadband-past-the-bound",
        "Lines between the ends of a deadband's grid, which lie beyond the count bound.",
        ["LPC-003", "DEC-001", "CNV-001"],
        on_grid(ends, 14, Grid(127, 0, 65534, 65535), LINEAR, low=WIDE[0], high=WIDE[1]),
        on_grid(ends, 14, Grid(127, -5, 65534, 65535), HOLD, low=WIDE[0], high=WIDE[1], id=1),
    )  # fmt: skip
    yield uncommon(
        "knot-deadband-past-the-bound-of-level-2",
        "The same at level 2: points near 2^33, which differ by nearly 2^34.",
        ["LPC-003", "DEC-001", "CNV-001"],
        on_grid(ends, 14, Grid(32767, 0, 65534, 65535, 2**32), LINEAR, **wide),
        level=2,
    )  # fmt: skip
    rows = [7 if tick % 2 else -9 for tick in range(300)]
    yield uncommon(
        "knot-every-tick", "Hold with a knot on every tick.", ["KNT-003"],
        track(packet(list(enumerate(rows)), rows)),
    )  # fmt: skip
    yield uncommon(
        "knot-largest-step", "A step of 2^24 at level 1, and indices of 1 and -1.",
        ["LPC-002", "LPC-003", "DEC-001"],
        track(
            packet(
                [(0, 1), (1, -1), (2, 0)], [2**23 - 1, -(2**23), 0], step=2**24,
                clamped=(-(2**23), 2**23 - 1),
            ),
            step=2**24, low=-(2**23), high=2**23 - 1,
        ),
    )  # fmt: skip
    yield uncommon(
        "knot-long-constant", "100000 ticks in one byte.", ["KNT-002"],
        track(Packet(0, [5] * 100_000, f.KNOT_DATA)),
    )  # fmt: skip
    counts = tuple(range(-100, 155))
    yield uncommon(
        "components-255", "A track of 255 components.", ["TRK-002"],
        track(
            packet([(0, counts), (1, counts[::-1])], [counts, counts[::-1]], clamped=(-128, 255)),
            width=255, low=-128, high=255,
        ),
    )  # fmt: skip
