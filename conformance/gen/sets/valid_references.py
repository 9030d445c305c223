"""Components that are predicted from others (SPEC 9.5)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import page
from case import Case
from facts import case_of
from lpcr import EVEN, Coding, coded, constant, packet, track, walk
from luck import Luck
from page_numbers import rdiv

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

ALONE = Coding()


def near(rows: list[int], seed: int, *, gain: int = 8, late: int = 0) -> list[int]:
    luck = Luck(seed)
    shifted = [rows[0]] * late + rows[: len(rows) - late]
    return [gain * each // 10 + luck.between(-2, 2) for each in shifted]


def cases() -> Iterator[Case]:
    first = walk(31, 60, 9)
    yield valid(
        "references-same-tick", "One reference, weight 3/4 of its own tick.",
        ["LPC-007", "LPC-006", "CNV-001"],
        track(
            packet(first, near(first, 1), coding=[ALONE, Coding(references=((0, 0, 48, 0),))]),
            width=2,
        ),
    )  # fmt: skip
    yield valid(
        "references-before-and-after",
        "Weights of the tick before and the tick after; outside the packet errors are 0.",
        ["LPC-007", "CNV-001"],
        track(
            packet(
                first, near(first, 2, late=1), near(first, 3),
                coding=[
                    ALONE, Coding(references=((0, 60, 3, 0),)), Coding(references=((1, 0, 5, 50),)),
                ],
            ),
            width=3,
        ),
    )  # fmt: skip
    yield valid(
        "references-negative-weights",
        "Negative weights, -128 and -1: halves are rounded towards plus infinity.",
        ["CNV-001", "LPC-007"],
        track(
            packet(
                first, [-2 * each // 3 for each in first],
                coding=[ALONE, Coding(references=((0, -1, -128, 127),))],
            ),
            width=2,
        ),
    )  # fmt: skip
    odd = [1, -1, 3, -3, 5, -5, 7, -7, 1, 1, -1, -1]
    yield valid(
        "references-ties", "Sums of 32 and of -32 in 64: ties, which go up.", ["CNV-001"],
        track(
            packet(
                odd, [rdiv(each, 2) for each in odd], [rdiv(-each, 2) for each in odd],
                coding=[ALONE, *(Coding(references=((0, 0, w, 0),)) for w in (32, -32))],
            ),
            width=3,
        ),
    )  # fmt: skip
    yield valid(
        "references-predictor",
        "The referring component's predictor and differences are taken for the reference too.",
        ["LPC-007"],
        track(
            packet(
                first, near(first, 4),
                coding=[
                    Coding(2), Coding(1, (90, -40), base=3, references=((0, 4, 40, -4),)),
                ],
            ),
            width=2,
        ),
    )  # fmt: skip
    yield valid(
        "references-difference-4",
        "Fourth differences of the reference too; it is itself coded with first ones.",
        ["LPC-007"],
        track(
            packet(
                first, near(first, 9),
                coding=[Coding(1), Coding(4, base=2, references=((0, -6, 50, 9),))],
            ),
            width=2,
        ),
    )  # fmt: skip
    yield valid(
        "references-base",
        "A reference counts from its own first index, not from its base nor from 0.",
        ["LPC-007"],
        track(
            packet(
                [each + 40 for each in near(first, 5, gain=4)], near(first, 6, gain=5),
                coding=[Coding(base=-30), Coding(base=2, references=((0, 0, 64, 0),))],
            ),
            width=2,
        ),
    )  # fmt: skip
    second = near(first, 7)
    yield valid(
        "references-chain", "A reference that itself has one, and one component with both.",
        ["LPC-007"],
        track(
            packet(
                first, second, near(second, 8),
                coding=[
                    ALONE, Coding(references=((0, 0, 50, 0),)),
                    Coding(1, references=((0, 1, 20, 2), (1, -3, 30, 7))),
                ],
            ),
            width=3,
        ),
    )  # fmt: skip
    third = near(first, 9)
    parts = [
        constant(8),
        page.encode(first, states=4),
        page.encode(third, references=((0, 9, 9, 9), (1, 0, 45, 0)), components=([8] * 60, first)),
    ]
    yield valid(
        "references-constant-and-four-states",
        "References to a constant component, and to one of four states.",
        ["LPC-007"],
        track(coded(page.encode_packet(parts), [8] * 60, first, third), width=3),
    )  # fmt: skip
    yield valid(
        "references-repeats", "Repeats in a component with a reference.",
        ["LPC-007", "RNG-001"],
        track(
            packet(
                [5, 5, 9, 9, 9, 1, 1, -4, -4, -4, 0, 3], [5, 5, 8, 8, 8, 8, 2, -4, -4, -3, 0, 3],
                coding=[
                    ALONE,
                    Coding(repeats=EVEN, references=((0, 0, 64, 0),)),
                ],
            ),
            width=2,
        ),
    )  # fmt: skip
    yield valid(
        "references-one-tick", "A reference within a packet of one tick.", ["LPC-007"],
        track(
            packet([9], [-7], coding=[ALONE, Coding(references=((0, 64, 64, 64),))]), width=2
        ),
    )  # fmt: skip
    rows = [near(first[:30], seed, gain=7) for seed in range(10, 20)]
    eight = tuple((a, 3 - a, 9 + a, a - 5) for a in (0, 1, 2, 4, 5, 6, 7, 8))
    yield uncommon(
        "references-eight", "Eight references of ten components, the most there may be.",
        ["LPC-007"],
        track(
            packet(*rows, coding=[*[ALONE] * 9, Coding(1, (60,), references=eight)]), width=10
        ),
    )  # fmt: skip
    edge = (-(2**23), 2**23 - 1)
    loud = [2**24 if tick % 2 else -(2**24) for tick in range(24)]
    weights = (127, 127, 127, 127, -128, -128, -128, -60)
    heavy = tuple((a, 0, w, 0) for a, w in enumerate(weights))
    yield uncommon(
        "references-loud",
        "Errors of 34 bits that cancel: eight weights that are together 64, tenth differences.",
        ["CNV-001", "LPC-007", "LPC-005"],
        track(
            packet(
                *[loud] * 9, clamped=edge,
                coding=[*[ALONE] * 8, Coding(ks=(127, -127) * 5, references=heavy)],
            ),
            width=9, clamped=edge,
        ),
    )  # fmt: skip
