"""Classes, starts, states and signs of the entropy coder (SPEC 9.4)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from case import Case
from facts import case_of
from lpcr import EVEN, Coding, packet, track, walk
from luck import Luck

from sets import valid_knots_coded as knots

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

WIDE = (-(2**23), 2**23 - 1)
SIGNS = (30, 128, 220)


def cases() -> Iterator[Case]:
    luck = Luck(12)
    sizes = [1 + 3 ** (tick // 12) // 2 ** (tick // 12) for tick in range(300)]
    swelling = [luck.bell(min(size, 60_000)) for size in sizes]
    both = swelling + swelling[::-1]
    yield valid(
        "entropy-classes", "Errors that swell and fade, in each class: every context of it.",
        ["RNG-001"],
        *(
            track(packet(both, coding=Coding(number=number, start=0), clamped=WIDE), id=number,
                  channel=number, clamped=WIDE)
            for number in range(16)
        ),
    )  # fmt: skip
    packets, start = [], 0
    for byte in (0, 1, 2, 3, 4, 11, 12, 13, 47, 48, 99, 100, 143, 163):
        row = [luck.between(-300, 300) for _ in range(11)]
        packets.append(packet(row, coding=Coding(start=byte), start=start, clamped=WIDE))
        start += 11
    yield valid(
        "entropy-starts", "Averages that begin with the least, the largest and between.",
        ["RNG-004"],
        track(*packets, clamped=WIDE),
    )  # fmt: skip
    noise = [luck.bell(10) for _ in range(61)]
    yield valid(
        "entropy-four-states", "Four states, and blocks that end with each of them.", ["RNG-001"],
        *(
            track(packet(noise[:size], coding=Coding(states=4)), id=place, channel=place)
            for place, size in enumerate((1, 2, 3, 4, 8, 59, 60, 61))
        ),
    )  # fmt: skip
    runs = [5, 5, 5, -4, -4, 9, 9, 9, 9, 0, 0, 1, -1, 1, 1] * 5
    yield valid(
        "entropy-sections", "Repeats, errors and signs of their own, with one state and with four.",
        ["RNG-001", "RNG-004"],
        *(
            track(
                packet(runs, coding=Coding(1, repeats=(70, 90, 150, 200), signs=signs,
                                           states=states)),
                id=place, channel=place,
            )
            for place, (signs, states) in enumerate((((), 4), (SIGNS, 1), (SIGNS, 4)))
        ),
    )  # fmt: skip
    turns = [0, 3, -3, 3, 0, 0, -7, -7, 7, 0, 1, -1]
    yield valid(
        "entropy-signs", "Signs by the sign before: after a negative, a zero, a positive one.",
        ["RNG-004"],
        track(packet(turns * 3, coding=Coding(signs=(255, 1, 128)))),
        track(packet([0] * 20 + [1], coding=Coding(signs=(1, 2, 3))), id=1, channel=1),
        track(packet(runs, coding=Coding(repeats=EVEN, signs=(9, 9, 9))), id=2, channel=2),
    )  # fmt: skip
    luck = Luck(97)
    ticks = sorted({luck.between(1, 599) for _ in range(90)})
    held = [(0, (0, 3))] + [(t, (luck.between(-90, 90), luck.between(0, 9))) for t in ticks]
    by_class, by_length = (9, 20), (64, (0, [9, 5, 0, 3, 1, 1, 1, 255, 2]))
    rows = [
        (by_class, by_length, (), 1), (by_length, by_class, (), 4),
        (by_length, by_length, SIGNS, 1),
        (by_length, by_length, (), 4), (by_class, by_class, SIGNS, 4),
    ]  # fmt: skip
    yield valid(
        "entropy-knots", "Gaps and differences, each by class or by length.", ["RNG-004"],
        *(
            knots.track(
                knots.packet(held, 600, gaps=gaps, differences=differences, signs=signs,
                             states=states),
                id=place, channel=2 * place, width=2,
            )
            for place, (gaps, differences, signs, states) in enumerate(rows)
        ),
    )  # fmt: skip
    long = walk(11, 4500, 5)
    yield valid(
        "entropy-long", "4500 ticks in four states.", ["RNG-001"],
        track(packet(long, coding=Coding(1, number=9, states=4))),
    )  # fmt: skip
    far = [(0, 0), (3, 2**24), (9, -(2**24))]
    yield uncommon(
        "entropy-lengths-of-34", "A table of 35 lengths, 0 to 34, the most that knots have.",
        ["RNG-004"],
        knots.track(
            knots.packet(far, 20, gaps=(64, (0, [1] * 35)), differences=(64, (0, [1] * 35)),
                         clamped=WIDE),
            clamped=WIDE,
        ),
    )  # fmt: skip
