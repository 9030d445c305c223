"""NOIS (SPEC 9.10): synthetic textures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import forge as f
import page_noise as page
from case import Case
from facts import Packet, Track, case_of
from luck import Luck

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

COMMON = (-(2**15), 2**15)
WIDE = (-(2**23), 2**23 - 1)
WIDEST = (-(2**31), 2**31 - 1)


def packet(*parts: bytes, span: int, start: int = 0, shift: int = 3, intervals: int = 8,
           clamped: tuple[int, int] = COMMON) -> Packet:  # fmt: skip
    body = page.encode_packet(list(parts))
    columns = page.decode_packet(body, shift, intervals, span, len(parts))
    low, high = clamped
    rows = [[max(low, min(high, count)) for count in row] for row in zip(*columns, strict=True)]
    return Packet(start, rows, body)


def track(*packets: Packet, shift: int = 3, intervals: int = 8,
          clamped: tuple[int, int] = COMMON, **fields: Any) -> Track:  # fmt: skip
    low, high = clamped
    return Track(
        codec="NOIS", parameters=f.nois_parameters(shift, intervals), packets=packets, low=low,
        high=high, **fields,
    )  # fmt: skip


def one(part: bytes, span: int, **given: Any) -> Track:
    """A track of one packet."""
    of_track = {name: given[name] for name in ("shift", "intervals", "clamped") if name in given}
    return track(packet(part, span=span, **given), **of_track)


def cases() -> Iterator[Case]:
    yield from gains()
    yield from filters()
    yield from layouts()
    yield from edges()


def gains() -> Iterator[Case]:
    e = page.encode
    yield valid(
        "nois-silence", "An empty packet: every count is 0.", ["NOI-005"],
        track(packet(b"", span=30), packet(b"", span=1, start=30)),
    )  # fmt: skip
    yield valid(
        "nois-gain",
        "No filter: the gain goes in a line from interval to interval, up and down.",
        ["CNV-001"],
        one(e([60, 60, 64, 50, 49, 70], [], 8), 48),
    )  # fmt: skip
    yield valid(
        "nois-gain-to-silence",
        "A gain that falls to 0 in an interval, and rises from 0; no noise in between.",
        ["CNV-001"],
        one(e([64, 0, 0, 64, 0], [], 8), 40),
    )  # fmt: skip
    yield valid(
        "nois-all-gains", "Every gain index but the largest ones, one interval each.", ["CNV-001"],
        one(e([*range(100)], [], 8), 800, clamped=WIDE),
    )  # fmt: skip
    yield valid(
        "nois-pulses", "Pulses at some of the ticks, by the lowest byte of the noise.",
        ["CNV-001"],
        track(*(
            packet(e([70] * 64, [], 8, density=density), span=512, start=512 * i)
            for i, density in enumerate((1, 2, 128, 255))
        )),
    )  # fmt: skip
    yield valid(
        "nois-seeds", "Packets of one model with other seeds.", ["CNV-001", "DAT-007"],
        track(*(
            packet(e([64] * 2, [[70, -20]], 8, seed=seed), span=16, start=16 * i)
            for i, seed in enumerate((0, 1, 2, 2**31, 2**32 - 1, 2654435769))
        )),
    )  # fmt: skip


def filters() -> Iterator[Case]:
    e = page.encode
    for m in (1, 2, 3, 8):
        ks = [100, -80, 40, -30, 20, -15, 10, -5][:m]
        yield valid(
            f"nois-order-{m}", f"A filter of order {m}.", ["NOI-005", "CNV-001"],
            one(e([60] * 8, [ks], 8), 64),
        )  # fmt: skip
    luck = Luck(33)
    ks = [luck.between(-50, 50) for _ in range(32)]
    yield valid(
        "nois-order-32", "32 coefficients, the most there may be.", ["NOI-005"],
        one(e([60] * 12, [ks, ks[::-1]], 8), 96),
    )  # fmt: skip
    every = [[sign * k] for k in range(1, 128) for sign in (1, -1)]
    yield valid(
        "nois-sine-table", "A block for each coefficient from -127 to 127.", ["CNV-001"],
        one(e([56] * (8 * 254), every, 8), 64 * 254),
    )  # fmt: skip
    yield valid(
        "nois-ties",
        "K(54) is a multiple of 64: one product of 512 is halfway between two integers.",
        ["CNV-001"],
        one(e([60] * 256, [[54, -54, 54]] * 32, 8), 2048),
    )
    yield valid(
        "nois-small", "Counts of -1, 0 and 1: what is rounded are 64ths.", ["CNV-001"],
        one(e([25, 27, 29, 31], [[110, -70]], 8), 32),
    )  # fmt: skip
    yield valid(
        "nois-rings-out", "The filter rings while the gain falls to 0, and stops then.",
        ["CNV-001"],
        one(e([70, 70, 0, 0, 0, 70], [[120, -125]], 8), 48),
    )  # fmt: skip


def layouts() -> Iterator[Case]:
    e, luck = page.encode, Luck(8)
    blocks = [[luck.between(-90, 90) for _ in range(4)] for _ in range(4)]
    quiet = [60] * 8 + [0] * 8 + [50] * 8 + [52] * 3
    yield valid(
        "nois-blocks",
        "Coefficients change from block to block; a silent block has those of the block before.",
        ["NOI-006"],
        one(e(quiet, blocks, 8), 8 * 27 - 5),
    )  # fmt: skip
    late = [0] * 8 + [60] * 8
    yield valid(
        "nois-silent-first", "The first block is silent: the second one differs from zeros.",
        ["NOI-006"],
        one(e(late, blocks[:2], 8), 128),
    )  # fmt: skip
    yield valid(
        "nois-four-states", "Four states for both sections.", ["RNG-001", "RNG-004"],
        one(e(quiet, blocks, 8, states=4), 210),
    )  # fmt: skip
    yield valid(
        "nois-long", "3000 ticks in intervals of 32, blocks of 96.", ["NOI-003"],
        one(e([luck.between(50, 66) for _ in range(94)], [blocks[i % 4] for i in range(32)], 3),
            3000, shift=5, intervals=3),
    )  # fmt: skip
    pair = [e([60] * 4, [[70, -30]], 8, seed=3), e([50] * 4, [[-70, -30, 9]], 8, seed=4)]
    yield valid(
        "nois-components", "Two components, each with a model and a seed of its own.",
        ["LPC-001"],
        track(packet(*pair, span=32), width=2),
    )  # fmt: skip
    yield valid(
        "nois-component-silent", "Of three components the second is silent.", ["LPC-001"],
        track(packet(pair[0], b"", pair[1], span=32), width=3),
    )  # fmt: skip
    slow = Track(kind="lf", low=-100, high=100, packets=[Packet(0, [7] * 64, f.svarint(7))])
    yield valid(
        "nois-hf", "An HF track of NOIS above held knots: their sum is clamped.",
        ["NOI-001", "DEC-001"],
        slow,
        track(packet(e([52] * 8, [[100, -40]], 8), span=64), id=1, kind="hf", base=0),
    )  # fmt: skip


def edges() -> Iterator[Case]:
    e = page.encode
    ringing: Sequence[int] = [127, -127] * 2
    yield uncommon(
        "nois-state-clamped", "A filter so near to an oscillator that its state is clamped.",
        ["CNV-001", "DEC-001"],
        one(e([108] * 16, [ringing] * 2, 8), 128, clamped=WIDE),
    )  # fmt: skip
    yield uncommon(
        "nois-state-clamped-32", "The same with 32 coefficients, at level 2.",
        ["CNV-001", "LIM-001"],
        one(e([112] * 12, [[127, -127] * 16] * 2, 8), 96, clamped=WIDEST),
        level=2,
    )  # fmt: skip
    yield uncommon(
        "nois-longest-intervals", "Intervals of 4096 ticks, 255 of them in a block.", ["NOI-003"],
        one(e([60, 66], [[90]], 255), 4500, shift=12, intervals=255),
    )  # fmt: skip
    yield uncommon(
        "nois-clamped", "Counts beyond the declared range are clamped, silence too.", ["DEC-001"],
        one(e([70, 70, 0, 0], [], 8), 32, clamped=(3, 40)),
    )  # fmt: skip
    yield uncommon(
        "nois-zero-coded", "Every gain is 0, yet the packet is not empty.", ["NOI-006"],
        one(e([0, 0], [[5]], 8), 16),
    )  # fmt: skip
