"""QUAN (SPEC 9.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import forge as f
from case import Case
from facts import Packet, Track, case_of
from luck import Luck
from page_quantised import Escape, Run, codebook, decode, encode, lengths_of, levels_of

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")


class Quantiser:
    """A codebook, and the tracks coded with it."""

    def __init__(self, lengths: list[int], *, m: int, r: int = 0, c: int = 0, step: int = 1,
                 book: bytes | None = None) -> None:  # fmt: skip
        self.book = codebook(lengths) if book is None else book
        assert lengths_of(self.book, 2 * m + r + c + 1) == lengths
        self.lengths, self.m, self.r, self.c, self.step = lengths, m, r, c, step

    def packet(self, tokens: Sequence[Any], start: int = 0, *, width: int = 1,
               low: int = -100, high: int = 100) -> Packet:  # fmt: skip
        """First all levels of component 0, then those of component 1, and so on."""
        tokens = list(tokens)
        body, levels = encode(tokens, self.m, self.r, self.lengths), levels_of(tokens)
        assert decode(body, len(levels), self.m, self.r, self.lengths) == levels
        counts = [max(low, min(high, level * self.step)) for level in levels]
        span = len(counts) // width
        parts = [counts[i * span : (i + 1) * span] for i in range(width)]
        return Packet(start, list(zip(*parts, strict=True)), body)

    def track(self, *packets: Packet, **fields: Any) -> Track:
        parameters = f.quan_parameters(
            self.book, step=self.step, m=self.m, r=self.r, c=self.c
        )  # fmt: skip
        return Track(codec="QUAN", parameters=parameters, packets=packets, **fields)


def cases() -> Iterator[Case]:
    yield from symbols()
    yield from codebooks()
    yield from rest()


def symbols() -> Iterator[Case]:
    plain = Quantiser([1, 3, 3, 3, 3], m=2, step=7)
    yield valid(
        "quan-direct", "Levels -2 to 2 by symbols of their own, times the step.", ["QNT-003"],
        plain.track(plain.packet([0, 1, -1, 2, -2, 0, 0, 1])),
    )  # fmt: skip
    runs = Quantiser([3, 3, 3, 2, 3, 3, 3], m=1, r=4)
    yield valid(
        "quan-runs", "Runs of every length from 2 to 31, between levels.", ["QNT-004"],
        runs.track(
            runs.packet([each for n in range(2, 32) for each in (Run(n), 1 if n % 2 else -1)])
        ),
    )  # fmt: skip
    escapes = Quantiser([2, 3, 3, 3, 3, 3, 3], m=1, c=4)
    yield valid(
        "quan-escapes", "Escapes of every magnitude from 2 to 16, both signs.", ["QNT-006"],
        escapes.track(
            escapes.packet([Escape(sign * n) for n in range(2, 17) for sign in (1, -1)] + [0, 1])
        ),
    )  # fmt: skip
    mixed = Quantiser([2, 3, 4, 3, 4, 5, 5, 4, 2], m=2, r=2, c=2, step=5)
    yield valid(
        "quan-two-components",
        "First all ticks of component 0, then those of component 1; a run passes from one to the "
        "other.",
        ["QNT-004"],
        mixed.track(
            mixed.packet([1, -2, 2, Run(4), -1, Escape(3), 0], width=2), width=2
        ),
    )  # fmt: skip
    yield valid(
        "quan-run-over-a-component",
        "A run begins in component 0, takes all of component 1 and ends in component 2.",
        ["QNT-004"],
        mixed.track(mixed.packet([1, Run(4), -1], width=3), width=3),
    )  # fmt: skip
    yield valid(
        "quan-clamped", "Level times step beyond the declared range is clamped to it, both ways.",
        ["DEC-001"],
        mixed.track(
            mixed.packet([2, -2, 1, -1, Escape(3), Escape(-5)], low=-9, high=6), low=-9, high=6
        ),
    )  # fmt: skip
    yield valid(
        "quan-run-to-the-end", "A run that ends with the packet, and the byte is full.",
        ["QNT-004"],
        runs.track(runs.packet([1, Run(4)]), runs.packet([Run(31)], 5)),
    )  # fmt: skip
    yield valid(
        "quan-one-tick", "A packet of one level.", ["QNT-004"],
        plain.track(plain.packet([-2]), plain.packet([0], 1), plain.packet([2], 2)),
    )  # fmt: skip


def codebooks() -> Iterator[Case]:
    silent = Quantiser([1, 0, 0], m=1)
    yield valid(
        "quan-one-symbol", "Where one symbol alone has a code word a packet has no bytes.",
        ["QNT-003", "QNT-004", "DAT-004"],
        silent.track(silent.packet([0] * 5), silent.packet([0] * 3, 5)),
    )  # fmt: skip
    always = Quantiser([0, 0, 1], m=1, step=9)
    yield uncommon(
        "quan-one-symbol-not-zero", "The one symbol with a code word is level -1.", ["QNT-003"],
        always.track(always.packet([-1] * 4)),
    )  # fmt: skip
    long = Quantiser([0, 0, 0, 0, 0, 1], m=1, r=3)
    yield uncommon(
        "quan-one-symbol-run", "One symbol alone, a run: its extra bits are written all the same.",
        ["QNT-003", "QNT-004"],
        long.track(long.packet([Run(13), Run(8), Run(15)])),
    )  # fmt: skip
    far = Quantiser([0, 0, 0, 1], m=0, r=0, c=3)
    yield uncommon(
        "quan-one-symbol-escape", "One symbol alone, an escape: extra bits and sign are written.",
        ["QNT-003"],
        far.track(far.packet([Escape(4), Escape(-7), Escape(5), Escape(-4)])),
    )  # fmt: skip
    lengths = [2, 15, 0, 0, 0, 0, 3, 4, 0, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 1]
    deep = Quantiser(lengths, m=8, r=2, c=2)
    used = [(symbol + 1) // 2 * (1 if symbol % 2 else -1) for symbol in range(1, 17)]
    every = [level for level, length in zip(used, lengths[1:17], strict=True) if length > 0]
    yield valid(
        "quan-long-code-words", "Code words of every length from 1 to 15 bits.", ["QNT-003"],
        deep.track(
            deep.packet([*every, 0, Run(2), Run(5), Escape(9), Escape(-9), Escape(10), Escape(-11)])
        ),
    )  # fmt: skip
    gaps = Quantiser([1] + [0] * 38 + [2, 2] + [0] * 24, m=20, c=24)
    yield valid(
        "quan-unused-symbols", "Nibbles of 0 leave out symbols; those at the end need none.",
        ["QNT-003"],
        gaps.track(gaps.packet([0, 20, -20, 0, 20])),
    )  # fmt: skip
    filled = Quantiser([1, 2, 2], m=1, book=bytes([0x12, 0x20]))
    yield valid(
        "quan-last-nibble", "A 0 as the last nibble only fills the byte.", ["QNT-003"],
        filled.track(filled.packet([0, 1, -1, -1])),
    )  # fmt: skip
    split = Quantiser([1, 0, 0, 0, 0, 2, 2], m=3, book=bytes([0x10, 0x10, 0x12, 0x20]))
    yield uncommon(
        "quan-split-zeros", "Symbols without a code word in two stretches that follow each other.",
        ["QNT-003"],
        split.track(split.packet([0, 3, -3, 0])),
    )  # fmt: skip
    told = Quantiser([1, 1, 0], m=1, book=bytes([0x11, 0x00]))
    yield uncommon(
        "quan-zeros-told", "The last symbols are said to have no code word, rather than left out.",
        ["QNT-003"],
        told.track(told.packet([0, 1, 1, 0])),
    )  # fmt: skip


def rest() -> Iterator[Case]:
    steps = Quantiser([1, 2, 3, 3], m=1, c=1, step=2**23)
    fine = Quantiser([1, *[0] * 24, 2, 2], m=0, c=26)
    yield uncommon(
        "quan-largest-levels",
        "Levels of twice the count bound, before they are clamped.",
        ["QNT-001", "QNT-006", "DEC-001"],
        steps.track(
            steps.packet([0, 1, -1, Escape(2), Escape(-2)], low=-(2**23), high=2**23 - 1),
            low=-(2**23), high=2**23 - 1,
        ),
        fine.track(
            fine.packet([0, Escape(2**25), Escape(-(2**25))], low=-(2**23), high=2**23 - 1),
            id=1, channel=1, low=-(2**23), high=2**23 - 1,
        ),
    )  # fmt: skip
    most = Quantiser([1, *[0] * 11, 2, *[0] * 12, 3, 3, *[0] * 30], m=0, r=24, c=32)
    yield uncommon(
        "quan-most-classes", "24 run symbols and 32 escape symbols, few of which have code words.",
        ["QNT-001"],
        most.track(most.packet([0, Run(4096 + 5), Escape(1), Escape(2), Escape(-3), Run(8191)])),
    )  # fmt: skip
    luck = Luck(9)
    levels = [luck.bell(1) for _ in range(400)]
    rich = Quantiser([2, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5], m=3, r=2, c=2, step=3)
    tokens = [level if abs(level) <= 3 else Escape(level) for level in levels]
    yield valid(
        "quan-noise", "400 levels of noise.", ["QNT-003", "QNT-004"],
        rich.track(rich.packet(tokens)),
    )  # fmt: skip
    wide = Quantiser([1, 3, 3, 2], m=1, c=1, step=2**31)
    yield uncommon(
        "quan-level-2", "A step of 2^31 at level 2, clamped to 32 bits.",
        ["QNT-001", "LIM-001", "DEC-001"],
        wide.track(
            wide.packet([1, -1, Escape(2), Escape(-2)], low=-(2**31), high=2**31 - 1),
            low=-(2**31), high=2**31 - 1,
        ),
        level=2,
    )  # fmt: skip
