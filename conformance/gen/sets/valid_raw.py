"""RAWB (SPEC 9.3): counts and words, stored and as DEFLATE streams of every kind."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import deflate
import forge as f
import page_raw
from case import Case
from deflate import DYNAMIC, FIXED, block, packed
from facts import Packet, Track, case_of
from luck import Luck
from page_raw import DEFLATE, STORED

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")


def columns(rows: Sequence[Any]) -> list[list[int]]:
    told = (row if isinstance(row, tuple) else (row,) for row in rows)
    return [list(each) for each in zip(*told, strict=True)]


def packet(rows: Sequence[Any], size: int, method: int = STORED, start: int = 0,
           kind: int = DYNAMIC) -> Packet:  # fmt: skip
    body = page_raw.encode(columns(rows), size, method, kind)
    if method == DEFLATE:
        assert zlib.decompress(body[1:], -15) == page_raw.planes(columns(rows), size)
    return Packet(start, rows, body)


def track(size: int, *packets: Packet, **fields: Any) -> Track:
    return Track(codec="RAWB", parameters=f.raw_parameters(size), packets=packets, **fields)


def words(number_format: str, size: int, *packets: Packet, **fields: Any) -> Track:
    return track(size, *packets, number_format=number_format, **fields)


def bits(layout: str, numbers: Sequence[float]) -> list[int]:
    size = struct.calcsize(layout)
    return [int.from_bytes(struct.pack("<" + layout, x), "little") for x in numbers if size]


def cases() -> Iterator[Case]:
    yield from counts()
    yield from formats()
    yield from streams()


def counts() -> Iterator[Case]:
    for size, low, high in (
        (1, -128, 127),
        (2, -(2**15), 2**15 - 1),
        (3, -(2**23), 2**23 - 1),
        (4, -(2**23), 2**23 - 1),
    ):
        yield valid(
            f"raw-counts-{size}", f"Counts in words of {size} bytes, two's complement.",
            ["RAW-001", "RAW-003", "RAW-005"],
            track(size, packet([0, 1, -1, low, high, low + 1, -100], size), low=low, high=high),
        )  # fmt: skip
    yield valid(
        "raw-three-components",
        "All bytes of component 0, plane by plane, then those of component 1, and so on.",
        ["RAW-003"],
        track(
            2, packet([(1, -2, 300), (2, -300, -301), (3, 0, 302), (-4, 5, 303)], 2),
            width=3, low=-400, high=400,
        ),
    )  # fmt: skip
    yield uncommon(
        "raw-counts-32-bits", "Counts of 32 bits at level 2.", ["RAW-005", "LIM-001"],
        track(4, packet([2**31 - 1, -(2**31), 0, -1], 4), low=-(2**31), high=2**31 - 1),
        level=2,
    )  # fmt: skip
    yield uncommon(
        "raw-narrow-range", "A range of one count, in words of four bytes.", ["RAW-005"],
        track(4, packet([-7] * 5, 4), low=-7, high=-7),
    )  # fmt: skip


def formats() -> Iterator[Case]:
    extremes = [-(2**63), 2**63 - 1, -1, 0, 2**53 + 1]
    yield valid(
        "words-int64", "64-bit integers with a sign, as bit patterns.", ["TRK-006", "RAW-001"],
        words("int64", 8, packet([x % 2**64 for x in extremes], 8)),
    )  # fmt: skip
    yield valid(
        "words-uint64", "64-bit integers without a sign.", ["TRK-006", "RAW-001"],
        words("uint64", 8, packet([0, 2**64 - 1, 2**63, 2**53 + 1], 8)),
    )  # fmt: skip
    odd = [0.0, -0.0, 1.5, -2.25, float("inf"), float("-inf")]
    yield valid(
        "words-binary16", "Half precision: both zeros, infinities, a subnormal, and two NaN.",
        ["TRK-006", "RAW-001"],
        words("binary16", 2, packet([*bits("e", odd), 0x0001, 0x7E00, 0xFC01], 2)),
    )  # fmt: skip
    yield valid(
        "words-binary32", "Single precision: both zeros, infinities, a subnormal, and two NaN.",
        ["TRK-006", "RAW-001"],
        words("binary32", 4, packet([*bits("f", odd), 1, 0x7FC00000, 0xFF800001], 4)),
    )  # fmt: skip
    yield valid(
        "words-binary64",
        "Double precision: both zeros, infinities, a subnormal, and NaN with payloads, every bit "
        "kept.",
        ["TRK-006", "RAW-001"],
        words(
            "binary64", 8,
            packet(
                [*bits("d", [*odd, 0.1, 1 / 3]), 1, 0x7FF8000000000000, 0x7FF0000000000001,
                 0xFFF8DEADBEEF0001], 8,
            ),
        ),
    )  # fmt: skip
    pairs = [(x, 2**64 - 1 - x) for x in range(5)]
    yield valid(
        "words-two-components", "Words of two components, with a gap.", ["TRK-006", "DEC-003"],
        words("uint64", 8, packet(pairs, 8), packet(pairs[::-1], 8, DEFLATE, 9), width=2),
    )  # fmt: skip


def streams() -> Iterator[Case]:
    luck = Luck(3)
    noise = [luck.between(-128, 127) for _ in range(500)]
    yield valid(
        "raw-deflate", "A DEFLATE stream with codes of its own.", ["RAW-003"],
        track(2, packet([noise[i % 40] * 3 for i in range(400)], 2, DEFLATE),
              low=-400, high=400),
    )  # fmt: skip
    yield valid(
        "raw-deflate-fixed", "A DEFLATE stream with the fixed codes.", ["RAW-003"],
        track(1, packet([tick % 11 for tick in range(60)], 1, DEFLATE, kind=FIXED)),
    )  # fmt: skip
    yield valid(
        "raw-deflate-stored", "A DEFLATE stream that stores its bytes.", ["RAW-003"],
        track(1, packet(noise, 1, DEFLATE, kind=deflate.STORED), low=-128, high=127),
    )  # fmt: skip
    rows = [1, 2, 3]
    three = (
        block(rows[:2], last=False, kind=FIXED)
        + block([], last=False, kind=DYNAMIC)
        + block(rows[2:], last=True, kind=FIXED)
    )
    yield uncommon(
        "raw-deflate-blocks", "A stream of three blocks, the second one empty.", ["RAW-003"],
        track(1, Packet(0, rows, b"\1" + packed(three))),
    )  # fmt: skip
    far = [*noise, *[0] * 31_800, *noise]
    yield uncommon(
        "raw-deflate-far", "Matches of 258 bytes, and such that reach back nearly 32 KiB.",
        ["RAW-003"],
        track(1, packet(far, 1, DEFLATE), low=-128, high=127),
    )  # fmt: skip
    yield uncommon(
        "raw-deflate-larger", "A stream that is larger than what it holds.", ["RAW-003"],
        track(1, packet([-5], 1, DEFLATE), packet([4, -4], 1, DEFLATE, 1)),
    )  # fmt: skip
