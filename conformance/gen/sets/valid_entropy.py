"""Classes, starts, states, signs and models of the entropy coder (SPEC 9.4)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from case import Case
from facts import case_of
from lpcr import EVEN, Coding, Grid, packet, track, walk
from luck import Luck
from page import BY_BITS

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

WIDE = (-(2**23), 2**23 - 1)
WIDEST = (-(2**31), 2**31 - 1)
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
    long = walk(11, 4500, 5)
    yield valid(
        "entropy-long", "4500 ticks in four states.", ["RNG-001"],
        track(packet(long, coding=Coding(1, number=9, states=4))),
    )  # fmt: skip
    yield from by_bits(both, runs)


def by_bits(both: list[int], runs: list[int]) -> Iterator[Case]:
    quiet = Coding(number=BY_BITS)
    yield valid(
        "by-bits-contexts", "Errors that swell and fade, by bits: every context of the models.",
        ["RNG-001", "RNG-003"],
        track(packet(both, coding=quiet, clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    luck = Luck(41)
    rows = [[luck.bell(size) for _ in range(150)] for size in (1, 2, 3, 5, 9, 17, 40)]
    yield valid(
        "by-bits-sizes", "Errors of one size in each component, one or a few at most in the first.",
        ["RNG-001"],
        track(packet(*rows, coding=quiet), width=len(rows)),
    )  # fmt: skip
    still = [*[0] * 3000, 1, *[0] * 9, -1, 2, *[-1] * 900, 1, 1, 0]
    yield valid(
        "by-bits-silence",
        "Zeros and negative ones until models have learnt all they can, then others.",
        ["RNG-001"],
        track(packet(still, coding=quiet)),
    )  # fmt: skip
    turns = [0, 3, -3, 3, 0, 0, -7, -7, 7, 0, 1, -1]
    yield valid(
        "by-bits-signs", "Signs by the last one before: zeros between them do not count.",
        ["RNG-001"],
        track(packet(turns * 5, coding=quiet)),
        track(packet([-4] * 90 + [0] * 5 + [-4, 4, -4], coding=quiet), id=1, channel=1),
    )  # fmt: skip
    held = [x for x in walk(42, 40, 2) for _ in range(1 + x % 5)]
    yield valid(
        "by-bits-repeats", "A section of repeats, and one of integers by bits, on one state.",
        ["RNG-001", "RNG-004"],
        track(packet(runs, coding=quiet._replace(repeats=(70, 90, 150, 200)))),
        track(packet(held, coding=quiet._replace(g=2, repeats=EVEN)), id=1, channel=1),
        track(packet([7] * 30, coding=quiet._replace(base=7, repeats=(255,) * 4)), id=2, channel=2),
    )  # fmt: skip
    first = walk(43, 90, 2)
    second = [x // 2 + luck.between(-1, 1) for x in first]
    yield valid(
        "by-bits-predicted",
        "Differences, coefficients and a reference by bits, beside a class with four states.",
        ["RNG-001", "LPC-007"],
        track(
            packet(
                first, second, second,
                coding=[
                    quiet._replace(ks=(90, -20)),
                    quiet._replace(g=1, references=((0, 0, 32, 0),)),
                    Coding(states=4),
                ],
            ),
            width=3,
        ),
    )  # fmt: skip
    alone = enumerate((0, 1, -1, 2, -2, 3, 4, 5, -6, 8, 9, 16, -17, 2**22))
    yield valid(
        "by-bits-one-sample", "Packets of one tick: the first flag has an even chance.",
        ["RNG-001"],
        track(
            *(packet([index], coding=quiet, start=t, clamped=WIDE) for t, index in alone),
            clamped=WIDE,
        ),
    )  # fmt: skip
    loud = [luck.between(-(2**22), 2**22) for _ in range(40)]
    yield uncommon(
        "by-bits-loud", "Errors of 22 bits, which a class codes shorter.", ["RNG-003"],
        track(packet([*loud, *[0] * 30, *loud[:5]], coding=quiet, clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    ends = [2**32, 1 - 2**32, 2**32, 0, -(2**32), -(2**32), 5]
    yield uncommon(
        "by-bits-level-2", "Second differences just below 2^34: k is 35, and 32 bits are raw.",
        ["RNG-003", "LIM-001"],
        track(
            packet(ends, coding=quiet._replace(g=2), grid=Grid(bound=2**32), clamped=WIDEST),
            clamped=WIDEST,
        ),
        level=2,
    )  # fmt: skip
