"""Channels of an LF and an HF track (SPEC 10)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import forge as f
import page_raw
from case import Case
from facts import Packet, Track, case_of
from lpcr import Coding
from lpcr import packet as predicted
from page_quantised import Escape, codebook, encode, levels_of

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")


def stored(start: int, rows: Sequence[Any], size: int = 1, cluster: int = 0) -> Packet:
    """Counts stored, in words of ``size`` bytes."""
    columns = zip(*(row if isinstance(row, tuple) else (row,) for row in rows), strict=True)
    return Packet(start, rows, page_raw.encode([list(each) for each in columns], size), cluster)


def raw(*packets: Packet, size: int = 1, **fields: Any) -> Track:
    return Track(codec="RAWB", parameters=f.raw_parameters(size), packets=packets, **fields)


def lf(*packets: Packet, **fields: Any) -> Track:
    return raw(*packets, kind="lf", **fields)


def hf(*packets: Packet, id: int = 1, base: int = 0, **fields: Any) -> Track:
    return raw(*packets, kind="hf", id=id, base=base, **fields)


SLOW = [10, 20, 30, 40, 50, 60]
FAST = [1, -2, 3, -4, 5, -6]


def cases() -> Iterator[Case]:
    yield from sums()
    yield from coverage()
    yield from descriptions()


def sums() -> Iterator[Case]:
    yield valid(
        "bands-sum", "A channel of an LF and an HF track is their sum.", ["DEC-003", "DEC-005"],
        lf(stored(0, SLOW)), hf(stored(0, FAST)),
    )  # fmt: skip
    yield valid(
        "bands-clamped", "The sum is clamped to the range of the LF track, both ways.",
        ["DEC-001"],
        lf(stored(0, [90, 90, 0, -90, -90]), low=-91, high=95),
        hf(stored(0, [5, 6, 7, -1, -2])),
    )  # fmt: skip
    fast = [1, -1, 2, -2, 3, -3]
    tokens = [level if abs(level) < 3 else Escape(level) for level in fast]
    book = [2, 3, 3, 3, 3, 2]
    assert levels_of(tokens) == fast
    yield valid(
        "bands-hf-clamped", "The HF track is clamped to its own range before it is added.",
        ["DEC-001"],
        lf(stored(0, SLOW)),
        Track(
            id=1, base=0, kind="hf", codec="QUAN", low=-20, high=14,
            parameters=f.quan_parameters(codebook(book), step=10, m=2, c=1),
            packets=[Packet(0, [10, -10, 14, -20, 14, -20], encode(tokens, 2, 0, book))],
        ),
    )  # fmt: skip
    yield valid(
        "bands-two-components", "LF and HF of two components, each with its own sums.",
        ["DEC-003", "TRK-007"],
        lf(stored(0, [(1, -1), (2, -2), (3, -3)]), width=2),
        hf(stored(0, [(10, 20), (30, 40), (-50, -60)]), width=2),
    )  # fmt: skip
    yield valid(
        "bands-predicted", "An LF track of knots, and a residual by LPCR on a grid.",
        ["DEC-003", "WRT-003"],
        Track(
            kind="lf", parameters=f.knot_parameters(1),
            packets=[Packet(0, [0, 8, 17, 25, 33, 42, 50], f.svarint(0) + b"\6" + f.svarint(50))],
        ),
        Track(
            id=1, kind="hf", base=0, codec="LPCR", parameters=f.lpcr_parameters(step=1),
            packets=[predicted([3, -9, 2, 2, 0, 7, -4], coding=Coding(1))],
        ),
    )  # fmt: skip
    wide = {"low": -(2**23), "high": 2**23 - 1}
    yield uncommon(
        "bands-wide", "An HF track of 25 bits takes an LF track from one end to the other.",
        ["TRK-005", "DEC-001"],
        lf(stored(0, [-(2**23), 2**23 - 1, 5], 3), size=3, **wide),
        hf(stored(0, [2**24 - 1, -(2**24), -(2**23) - 5], 4), size=4, low=-(2**24), high=2**24 - 1),
    )  # fmt: skip
    widest = {"low": -(2**31), "high": 2**31 - 1}
    yield uncommon(
        "bands-level-2", "Sums of two counts of 32 bits: none of them wraps around.",
        ["DEC-001", "LIM-001"],
        lf(stored(0, [-(2**31), 2**31 - 1, 2**31 - 1, -1], 4), size=4, **widest),
        hf(stored(0, [-(2**31), 2**31 - 1, -(2**31), 1], 4), size=4, **widest),
        level=2,
    )  # fmt: skip


def coverage() -> Iterator[Case]:
    yield valid(
        "bands-partial-overlap",
        "In full band there are only the ticks that both tracks cover; each band has its own.",
        ["DEC-003", "DEC-005"],
        lf(stored(0, SLOW), stored(6, [70, 80, 90]), stored(12, [7])),
        hf(stored(4, FAST[:3]), stored(8, [1, 2, 3, 4]), stored(20, [9])),
    )  # fmt: skip
    yield valid(
        "bands-packets-unaligned", "Packets of LF and HF end at different ticks.", ["DEC-003"],
        lf(stored(0, SLOW[:2]), stored(2, SLOW[2:5]), stored(5, SLOW[5:])),
        hf(stored(0, FAST[:1]), stored(1, FAST[1:4]), stored(4, FAST[4:])),
    )  # fmt: skip
    yield valid(
        "bands-hf-without-packets", "An HF track without packets: in full band all is a gap.",
        ["DEC-003", "TRK-012"],
        lf(stored(0, SLOW)), hf(),
    )  # fmt: skip
    yield uncommon(
        "bands-lf-without-packets", "An LF track without packets: only HF delivers something.",
        ["DEC-003", "DEC-005"],
        lf(), hf(stored(0, FAST)),
    )  # fmt: skip
    yield valid(
        "bands-beside-full",
        "Asked for LF a full-band channel is delivered too, asked for HF nothing of it.",
        ["DEC-005"],
        raw(stored(0, [1, 2, 3])), lf(stored(0, SLOW), id=1, channel=1),
        hf(stored(0, FAST), id=2, base=1, channel=1),
    )  # fmt: skip
    yield uncommon(
        "bands-hf-first", "The HF packets are in an earlier cluster than those of LF.",
        ["DEC-003", "DAT-006"],
        lf(stored(0, SLOW, cluster=1)), hf(stored(0, FAST)),
    )  # fmt: skip


def descriptions() -> Iterator[Case]:
    yield valid(
        "bands-calibrated", "Sum first, then the calibration of the LF track, B counted once.",
        ["VAL-003", "TRK-009"],
        lf(stored(0, SLOW), tlvs=f.tlv(3, f.calibration(3, -50, 7)), calibration=(3, -50, 7)),
        hf(stored(0, FAST)),
    )  # fmt: skip
    yield valid(
        "bands-together", "One chunk describes three LF tracks and three HF tracks.",
        ["TRK-007", "TRK-010"],
        *together(),
    )  # fmt: skip
    yield uncommon(
        "bands-rate-as-ratio", "The rate of an HF track is equal as a ratio, not in its numbers.",
        ["TRK-007"],
        lf(stored(0, SLOW), rate=(1000, 3)), hf(stored(0, FAST), rate=(2000, 6)),
    )  # fmt: skip
    yield uncommon(
        "bands-hf-described-late", "The HF track is described after LF packets were written.",
        ["TRK-001", "DEC-003"],
        lf(stored(0, SLOW)), hf(stored(0, FAST, cluster=1)),
        file={"late": [1]},
    )  # fmt: skip


def together() -> list[Track]:
    """Three LF tracks and three of HF, in one chunk."""
    out = [
        lf(stored(0, [each + i for each in SLOW]), id=i, channel=i, joined=i > 0) for i in range(3)
    ]  # fmt: skip
    for i in range(3):
        rows = [each + i for each in FAST][: 6 - i]
        out.append(hf(stored(0, rows), id=3 + i, channel=i, base=i, joined=True))
    return out
