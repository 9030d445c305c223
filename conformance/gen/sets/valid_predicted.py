"""LPCR (SPEC 9.5) and the entropy coding below it (9.4)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import page
from case import Case
from facts import case_of
from lpcr import EVEN, Coding, Grid, coded, constant, packet, track, walk
from luck import Luck

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

WIDE = (-(2**23), 2**23 - 1)
WIDEST = (-(2**31), 2**31 - 1)


def cases() -> Iterator[Case]:
    yield from examples()
    yield from predictors()
    yield from coder()
    yield from grids()


def examples() -> Iterator[Case]:
    squares = [0, 1, 4, 9, 16, 25, 36, 49]
    wave = [0, 38, 71, 92, 100, 92, 71, 38, 0, -38, -71, -92, -100]
    small = [5, 24, 40, 51, 55, 51, 41, 24, 5]
    rows = [
        ("10 00 0A", [5, 5, 5, 5]),
        ("00 00 00 03 18 00 01 C7 5F 02", [1, -1]),
        ("02 00 00 04 1A 9E AB E0 64 00", squares),
        ("08 00 0E 00 20 FF FF FF 55 22 4D 29 7B 04", [7, 7, 7, 9, 9, 9, 9, -3, -3]),
        (
            "00 00 00 40 00 72 9A A0 D8 F0 80 00 00",
            [0, 0, 0, 1, 0, 0, -2, 0, 0, 0, 0, 1, 9, 0, 0, 0],
        ),
        ("08 00 0E 40 20 FF FF FF 00 01 1F 1B BB CA A4 F0 01", [7, 7, 7, 9, 9, 9, 9, -3, -3]),
        ("00 02 78 92 00 01 25 C8 30 30 B7 CB 09 51 35 00 9F 5D CC", wave),
    ]
    packets, start = [], 0
    for body, indices in rows:
        packets.append(coded(bytes.fromhex(body), indices, start=start))
        start += len(indices)
    both = "12 00 00 00 0E 2E 00 02 60 9C C5 02 4C 78 03 3B 04 63 B0 40 00 01 00 00 20"
    both += " 00 00 00 08 00 23 FF F5 FF F5 5F F4 FF F5 FF F5 5F F5 9F 75 00 00"
    pair = coded(bytes.fromhex(both), wave[:9], small)
    yield valid(
        "lpcr-examples", "The packets that the page of LPCR shows.", ["RNG-001"],
        track(*packets), track(pair, id=1, channel=1, width=2),
    )  # fmt: skip


def predictors() -> Iterator[Case]:
    yield valid(
        "lpcr-constant", "Constant component packets, one with the base beyond 63.", ["LPC-004"],
        track(coded(constant(-6), [-6] * 3), coded(constant(100), [100] * 2, start=3)),
    )  # fmt: skip
    cubic = [tick**3 // 40 - 6 * tick for tick in range(40)]
    for g in range(5):
        yield valid(
            f"lpcr-difference-{g}",
            f"Differences of order {g}: what lies before the packet is 0, whatever the base.",
            ["LPC-004", "CNV-001"],
            track(packet(cubic, coding=Coding(g, base=-3), clamped=WIDE), clamped=WIDE),
        )  # fmt: skip
    yield valid(
        "lpcr-predictor-1",
        "One coefficient: predictions of negative numbers are rounded towards minus infinity.",
        ["CNV-001", "LPC-006"],
        track(packet([-90, -81, -70, -64, -55, -50, -44, 40, 38, 33], coding=Coding(ks=(90,)))),
    )  # fmt: skip
    packets = []
    for k in (sign * k for k in range(1, 128) for sign in (1, -1)):
        two = [2**22 - 1, (k * 32749) % 4001 - 2000]
        coding = Coding(ks=(k,))
        packets.append(packet(two, coding=coding, start=2 * len(packets), clamped=WIDE))
    yield valid(
        "lpcr-sine-table", "Packets of one coefficient: every entry of the sine table, + and -.",
        ["CNV-001"],
        track(*packets, clamped=WIDE),
    )  # fmt: skip
    yield valid(
        "lpcr-predictor-2",
        "Two coefficients, the second negative, and a base.", ["CNV-001", "LPC-005"],
        track(packet(walk(1, 60, 8), coding=Coding(ks=(120, -100), base=17))),
    )  # fmt: skip
    yield valid(
        "lpcr-predictor-difference", "Four coefficients on first differences.", ["LPC-004"],
        track(packet(walk(2, 60, 9), coding=Coding(1, ks=(40, -30, 20, -10)))),
    )  # fmt: skip
    ends = (127, -127, 126, -126, 1, -1, 0, 64)
    yield valid(
        "lpcr-predictor-8", "Coefficients from one end of the sine table to the other.",
        ["LPC-004", "LPC-005", "CNV-001"],
        track(packet(walk(3, 80, 30), coding=Coding(ks=ends), clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    luck = Luck(32)
    ks = tuple(luck.between(-60, 60) for _ in range(32))
    yield valid(
        "lpcr-predictor-32", "32 coefficients, the most there may be.", ["LPC-004", "LPC-005"],
        track(packet(walk(4, 90, 30), coding=Coding(ks=ks))),
    )  # fmt: skip
    yield valid(
        "lpcr-predictor-longer", "More coefficients than ticks.", ["LPC-004"],
        track(packet([3, 9, 4], coding=Coding(ks=ks))),
    )  # fmt: skip
    steps = [5] * 9 + [9] * 4 + [-9] + [0] * 12 + [1, 1, 2, 2]
    yield valid(
        "lpcr-repeats", "Repeats are bits whose probability goes by the two bits before.",
        ["RNG-001"],
        track(packet(steps * 3, coding=Coding(base=5, repeats=EVEN))),
    )  # fmt: skip
    luck = Luck(88)
    patterns, at = [], 0
    for _ in range(900):
        at = at if luck.below(5) < 3 else luck.between(-9, 9)
        patterns.append(at)
    still = [*patterns, *[17] * 800, *patterns[:20]]
    yield valid(
        "lpcr-repeats-long",
        "Repeats in every pattern, then 800 at a stretch.",
        ["RNG-001"],
        track(packet(still, coding=Coding(repeats=EVEN))),
    )  # fmt: skip
    yield valid(
        "lpcr-repeats-differences",
        "After a repeat the difference is what follows from the indices, not 0.",
        ["RNG-001"],
        track(
            packet(steps * 2, coding=Coding(2, repeats=EVEN)),
            packet(steps * 2, coding=Coding(1, ks=(70, -20), repeats=EVEN), start=100),
        ),
    )  # fmt: skip


def coder() -> Iterator[Case]:
    luck = Luck(4)
    sizes = [luck.choice((0, 1, 2, 3, 60, 600, 9000, 80000)) for _ in range(260)]
    spread = [luck.between(-size, size) for size in sizes]
    yield valid(
        "lpcr-every-bucket",
        "Errors of all sizes side by side: every bucket, and those beyond the last edge.",
        ["RNG-001", "RNG-003"],
        track(packet(spread, clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    loud = [luck.between(-(2**22), 2**22) for _ in range(40)]
    yield valid(
        "lpcr-loud",
        "Errors of 22 bits one after the other: low bits are raw, a sudden silence has big shifts.",
        ["RNG-001", "RNG-003"],
        track(packet([*loud, *[0] * 30, *loud[:5]], clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    yield valid(
        "lpcr-silence-first", "Zeros until both averages are at rest, then one loud error.",
        ["RNG-001"],
        track(packet([0] * 90 + [8_000_000, 0, 0, -8_000_000, 1], clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    yield valid(
        "lpcr-long", "1500 samples, in blocks of eight and one of four.",
        ["RNG-001"],
        track(packet([luck.bell(8) for _ in range(1500)])),
    )  # fmt: skip
    scales = [luck.bell(1 + 400 * (tick // 160 % 2)) for tick in range(800)]
    yield valid(
        "lpcr-scale-changes", "Every 160 samples loud becomes quiet, or quiet loud.",
        ["RNG-001"],
        track(packet(scales, clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    packets, start = [], 0
    for span in [1] * 24 + [2] * 16 + [3] * 12:
        indices = [luck.choice((0, 0, 1, -1, 5, -60)) for _ in range(span)]
        packets.append(packet(indices, start=start))
        start += span
    yield valid(
        "lpcr-short-packets", "52 packets of one to three ticks: blocks that are short.",
        ["RNG-001", "DAT-007"],
        track(*packets),
    )  # fmt: skip
    first, second = walk(6, 50, 3), walk(7, 50, 40)
    yield valid(
        "lpcr-two-components", "Two component packets, each with a coder of its own.", ["LPC-001"],
        track(packet(first, second, coding=[Coding(1), Coding(0, (20,))]), width=2),
    )  # fmt: skip
    parts = [page.encode(first), constant(4), page.encode(second, 1)]
    yield valid(
        "lpcr-constant-component", "A constant component between two that are not.", ["LPC-001"],
        track(
            coded(page.encode_packet(parts), first, [4] * len(first), second), width=3,
        ),
    )  # fmt: skip
    edge = [2**24, -(2**24), 2**24, 0]
    yield uncommon(
        "lpcr-bounds", "Indices from one count bound to the other: errors of 26 bits.",
        ["LPC-003", "RNG-003", "DEC-001"],
        track(packet(edge, coding=Coding(base=2**24), clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    far = Grid(bound=2**32)
    yield uncommon(
        "lpcr-level-2", "Indices from one bound of level 2 to the other: errors just below 2^34.",
        ["LPC-003", "RNG-003", "LIM-001"],
        track(
            packet([2**32, -(2**32), 2**32 - 1, 5, -5], grid=far, clamped=WIDEST),
            packet([2**31, 2**31 - 5, 2**32, 9, 2**31], grid=far, clamped=WIDEST, start=5,
                   coding=Coding(2)),
            packet([-(2**31) + 7 * t for t in range(9)], grid=far, clamped=WIDEST, start=10,
                   coding=Coding(ks=(127, -127))),
            clamped=WIDEST,
        ),
        level=2,
    )  # fmt: skip


def grids() -> Iterator[Case]:
    grid = Grid(step=7, zero=-3)
    yield valid(
        "lpcr-uniform-grid", "Counts are zero plus index times step.", ["LPC-002"],
        track(packet(walk(8, 40, 4, -13, 14), grid=grid), grid=grid),
    )  # fmt: skip
    yield valid(
        "lpcr-clamped", "Grid points beyond the declared range are clamped, both ways.",
        ["DEC-001"],
        track(
            packet([-15, 15, -14, 14, 0], grid=grid, clamped=(-90, 95)),
            grid=grid, clamped=(-90, 95),
        ),
    )  # fmt: skip
    band = Grid(step=20, kn=1, kd=10)
    far = (-600, 600)
    yield valid(
        "lpcr-deadband-grid",
        "The grid of a deadband: uniform near zero, then wider and wider, the same below zero.",
        ["LPC-002", "LPC-003"],
        track(
            packet([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 0, -1, -2, -6, -9], grid=band, clamped=far),
            grid=band, clamped=far,
        ),
    )  # fmt: skip
    moved = Grid(step=3, zero=-50, kn=3, kd=7)
    yield valid(
        "lpcr-deadband-zero", "A deadband's grid around another zero, of a fraction of 3/7.",
        ["LPC-002"],
        track(
            packet([-4, -3, -2, -1, 0, 1, 2, 3, 4], grid=moved, clamped=WIDE),
            grid=moved, clamped=WIDE,
        ),
    )  # fmt: skip
    last = Grid(step=1, kn=1, kd=10)
    yield uncommon(
        "lpcr-deadband-last", "The last points of a deadband's grid, beyond the declared range.",
        ["LPC-003", "DEC-001"],
        track(
            packet([last.last, -last.last, last.last - 1, 70, -70], grid=last, clamped=WIDE),
            grid=last, clamped=WIDE,
        ),
    )  # fmt: skip
    steps = Grid(step=2**24, zero=-(2**23))
    yield uncommon(
        "lpcr-largest-step", "A step of 2^24 from the lowest count of 24 bits.",
        ["LPC-002", "LPC-003", "DEC-001"],
        track(packet([0, 1, -1, 1], grid=steps, clamped=WIDE), grid=steps, clamped=WIDE),
    )  # fmt: skip
    high = Grid(step=2**31, zero=2**31 - 1, bound=2**32)
    low = Grid(step=3, zero=-(2**31), kn=1, kd=50, bound=2**32)
    yield uncommon(
        "lpcr-grids-level-2", "Grids of level 2, uniform and of a deadband, to their last points.",
        ["LPC-002", "LPC-003", "LIM-001"],
        track(packet([0, -1, -2, 2, 1], grid=high, clamped=WIDEST), grid=high, clamped=WIDEST),
        track(
            packet([0, 1, 300, low.last, -low.last], grid=low, clamped=WIDEST),
            grid=low, clamped=WIDEST, id=1, channel=1,
        ),
        level=2,
    )  # fmt: skip
    whole = Grid(step=5, kn=9, kd=7)
    yield uncommon(
        "lpcr-deadband-whole", "A fraction above 1: zero is the only point of the grid.",
        ["LPC-002", "LPC-003"],
        track(packet([0, 0, 0], grid=whole), grid=whole),
    )  # fmt: skip
    fine = Grid(step=0, kn=1, kd=1024)
    yield uncommon(
        "lpcr-deadband-no-floor", "A deadband's grid without a floor, of the least fraction.",
        ["LPC-002"],
        track(packet([*range(-20, 21), 2000, -2000], grid=fine, clamped=WIDE), grid=fine,
              clamped=WIDE),
    )  # fmt: skip
