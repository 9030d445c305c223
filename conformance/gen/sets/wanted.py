"""Facts that no other case held fast: each lets one of the mutants live that is otherwise right."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from case import Case
from facts import Track, case_of
from lpcr import Coding, packet, track
from page_knots import LINEAR
from page_numbers import rdiv

from sets import valid_knots

valid = partial(case_of, "valid")
WIDE = (-(2**23), 2**23 - 1)


def lines(rise: int, run: int, *, id: int) -> Track:
    """Up, and as far down."""
    rows = [rdiv(rise * tick, run) for tick in range(run)]
    rows += [rise + rdiv(-rise * tick, run) for tick in range(run + 1)]
    knots = [(0, 0), (run, rise), (2 * run, 0)]
    body = valid_knots.packet(knots, rows, LINEAR)
    return valid_knots.track(body, interpolation=LINEAR, id=id, channel=id)


def cases() -> Iterator[Case]:
    yield valid(
        "knot-linear-no-slope",
        "Halves that a slope in binary64 misses: 15 / 22 * 11 is less than 7.5 there.",
        ["CNV-001"],
        lines(15, 22, id=0), lines(1, 98, id=1), lines(29, 58, id=2),
    )  # fmt: skip
    unlike = [tick % 2 for tick in range(900)]
    yield valid(
        "lpcr-repeats-never",
        "900 ticks without a repeat, then one, with the least probability.",
        ["RNG-001"],
        track(packet([*unlike, 1, 1, 0], coding=Coding(repeats=(1, 255, 7, 128)))),
    )  # fmt: skip
    lengths = [44, 2**14 + 42, 2**14 + 43, 2**15 + 42, 2**15 + 43, 2**16 + 43]
    packets = [
        packet([size, 0, -3], coding=Coding(), start=3 * place, clamped=WIDE)
        for place, size in enumerate(lengths)
    ]
    yield valid(
        "lpcr-escape-lengths",
        "Escapes of 14, 15 and more bits.",
        ["RNG-003"],
        track(*packets, clamped=WIDE),
    )  # fmt: skip
