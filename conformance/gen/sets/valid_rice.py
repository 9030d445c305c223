"""Rice codes of LPCR (SPEC 9.5)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from case import Case
from facts import case_of
from lpcr import Coding, Grid, packet, track, walk
from luck import Luck

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

WIDE = (-(2**23), 2**23 - 1)
WIDEST = (-(2**31), 2**31 - 1)


def rice(*widths: int, g: int = 0, ks: tuple[int, ...] = (), base: int = 0) -> Coding:
    return Coding(g, ks, base, rice=True, widths=widths)


def cases() -> Iterator[Case]:
    luck = Luck(12)
    noise = [luck.bell(10) for _ in range(70)]
    yield valid(
        "rice-blocks", "Blocks of 32 ticks, the last one shorter, all of one width.",
        ["LPC-011", "LPC-012"],
        track(packet(noise, coding=rice(4))),
    )  # fmt: skip
    yield valid(
        "rice-width-changes", "From block to block the width grows and shrinks.", ["LPC-011"],
        track(packet(noise * 4, coding=rice(4, 6, 2, 5, 1, 8, 3, 3))),
    )  # fmt: skip
    quiet = [*[0] * 32, *noise[:32], *[0] * 64, *noise[:40]]
    yield valid(
        "rice-width-0", "Blocks of zeros have width 0: no bit for any of their ticks.",
        ["LPC-011"],
        track(packet(quiet, coding=rice(0, 5, 0, 0, 6, 4))),
    )  # fmt: skip
    yield valid(
        "rice-width-0-only", "Width 0 throughout: all indices are the base, in one code.",
        ["LPC-011", "LPC-012"],
        track(packet([-42] * 90, coding=rice(0, base=-42))),
    )  # fmt: skip
    yield valid(
        "rice-differences", "Second differences, whose first two errors are large.", ["LPC-004"],
        track(packet([100 - t * t // 9 for t in range(40)], coding=rice(3, g=2))),
    )  # fmt: skip
    yield valid(
        "rice-predictor", "Errors of a predictor of three coefficients, and a base.", ["CNV-001"],
        track(packet(walk(21, 64, 7), coding=rice(4, ks=(110, -60, 20), base=9))),
    )  # fmt: skip
    unary = [0, -12, 11, -11, 12, 13, -13, 5]
    yield valid(
        "rice-escape",
        "With width 1, 24 zeros are an escape: 35 bits follow, and no 1 before them.",
        ["LPC-012"],
        track(packet(unary, coding=rice(1))),
    )  # fmt: skip
    yield valid(
        "rice-whole-byte", "The last bit fills the last byte: nothing is left to be 0.",
        ["LPC-012"],
        *whole_bytes(),
    )  # fmt: skip
    parts = [walk(22, 50, 4), walk(23, 50, 30)]
    yield valid(
        "rice-and-adaptive", "One component with Rice codes, one with adaptive coding.",
        ["LPC-010", "LPC-001"],
        track(packet(*parts, coding=[rice(4), Coding(1)]), width=2),
    )  # fmt: skip
    yield uncommon(
        "rice-width-31", "Width 31, the largest: codes of 30 low bits.", ["LPC-011"],
        track(
            packet([2**24, -(2**24), 0, 1, -1], coding=rice(31), clamped=WIDE), clamped=WIDE
        ),
    )  # fmt: skip
    up = list(range(1, 32))
    yield uncommon(
        "rice-every-width", "From one block to the next the width grows by one, up to 31.",
        ["LPC-011"],
        track(packet(noise[:32] * 31, coding=rice(*up))),
    )  # fmt: skip
    yield uncommon(
        "rice-width-jump", "The width jumps from 31 to 0 and back, each step one code.",
        ["LPC-011"],
        track(packet([*noise[:32], *[0] * 32, *noise[:10]], coding=rice(31, 0, 31))),
    )  # fmt: skip
    far = Grid(bound=2**32)
    yield uncommon(
        "rice-level-2", "Escapes of 35 bits at level 2, the largest magnitudes there are.",
        ["LPC-003", "LIM-001"],
        track(
            packet([2**32, -(2**32), 2**32, 0], grid=far, coding=rice(5), clamped=WIDEST),
            packet([2**32, -(2**32), 2**32, 0], grid=far, coding=rice(5, g=1), clamped=WIDEST,
                   start=4),
            clamped=WIDEST,
        ),
        level=2,
    )  # fmt: skip


def whole_bytes():
    """Indices whose packet, header aside, is a multiple of 8 bits: code(0) of width 1 takes 3
    bits, each index 1 or 2."""
    for number, (indices, bits) in enumerate((([-1, 0, 0, 0], 8), ([1, 0, -1] + [0] * 7, 16))):
        sizes = [1 + (2 * i if i >= 0 else -2 * i - 1) for i in indices]
        assert 3 + sum(sizes) == bits, sizes
        yield track(packet(indices, coding=rice(1)), id=number, channel=number)
