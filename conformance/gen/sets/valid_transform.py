"""MDCT (SPEC 9.8)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from case import Case
from facts import Track, case_of
from luck import Luck, walk
from mdct import Shape, component, packet, signal, some, track
from page_transform import LARGEST

from sets.valid_knots import packet as knots

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

WIDE = (-(2**23), 2**23 - 1)
WIDEST = (-(2**31), 2**31 - 1)


def cases() -> Iterator[Case]:
    yield from blocks()
    yield from integers()
    yield from parameters()
    yield from ends()


def blocks() -> Iterator[Case]:
    yield valid(
        "mdct-constant", "Packets without coefficients: every count is the base.",
        ["MDC-002", "CNV-001"],
        track(packet(component([], base=-6), span=3),
              packet(component([], base=100), span=70, start=3)),
    )  # fmt: skip
    packets = []
    for k in range(32):
        row = [0] * k + [40 if k % 2 else -40]
        packets.append(packet(component([row], base=k - 16), span=32, start=32 * k))
    yield valid(
        "mdct-one-coefficient",
        "Packets of one block: in each another coefficient is not 0.",
        ["CNV-001", "MDC-002"],
        track(*packets),
    )  # fmt: skip
    for m in range(5, 10):
        shape, size = Shape(m, 512 >> m - 5), 2**m
        noise = walk(2 * size + 9, 300, m)
        yield valid(
            f"mdct-blocks-of-{size}",
            f"A signal in three blocks of {size} coefficients, the last one cut.",
            ["CNV-001", "MDC-001"],
            track(packet(signal(noise, shape, near=60), span=len(noise), shape=shape, clamped=WIDE),
                  shape=shape, clamped=WIDE),
        )  # fmt: skip
    packets, start = [], 0
    for span in (1, 2, 15, 16, 17, 31, 32, 33, 47, 48, 49, 63, 64, 65, 96):
        packets.append(
            packet(component(some(span, 6, -(-span // 32), 0, 5, 60)), span=span, start=start,
                   clamped=WIDE)
        )  # fmt: skip
        start += span
    yield valid(
        "mdct-spans",
        "Packets of less than a block, of whole blocks, of a tick more and of a tick less.",
        ["CNV-001", "DAT-007"],
        track(*packets, clamped=WIDE),
    )  # fmt: skip
    still = [[90, -70, 5], [0, 0, 0], [0, 0, 0], [-90, 1, 1], [0, 0, 0]]
    yield valid(
        "mdct-silent-blocks",
        "Blocks of zeros between others: where they meet the samples are mixed all the same.",
        ["CNV-001"],
        track(packet(component(still), span=150, clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    fine = Shape(5, 1)
    small = packet(component(some(12, 32, 6, 0, 9, 99), fine), span=192, shape=fine)
    yield valid(
        "mdct-small", "Coefficients of less than a count: both roundings decide.",
        ["CNV-001"],
        track(small, shape=fine),
    )  # fmt: skip


def integers() -> Iterator[Case]:
    yield valid(
        "mdct-states",
        "Even and odd integers in turn, so that every state occurs, and goes on to the next block.",
        ["CNV-001", "MDC-003"],
        track(packet(component(some(21, 19, 9, 1, 2, 3)), span=9 * 32, clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    packets = []
    for number in range(16):
        row = some(number, 24, 3, 0, 1, 2, 9, 40)
        body = component(row, classes=(number, 15 - number), start=4 * number)
        packets.append(packet(body, span=96, start=96 * number, clamped=WIDE))
    yield valid(
        "mdct-classes", "Each class for each quantiser.", ["RNG-001", "RNG-004"],
        track(*packets, clamped=WIDE),
    )  # fmt: skip
    least = Shape(5, 1)
    spread = some(31, 32, 8, 0, 3, 60, 9000, 2**20, 2**24)
    yield valid(
        "mdct-every-bucket",
        "Integers of all sizes side by side: every bucket, escapes, and large shifts.",
        ["RNG-001", "RNG-003"],
        track(packet(component(spread, least), span=256, shape=least, clamped=WIDE),
              shape=least, clamped=WIDE),
    )  # fmt: skip
    luck = Luck(8)
    loud = [[luck.between(-(2**22), 2**22) for _ in range(12)] for _ in range(3)]
    rows = [*loud, *[[0] * 12] * 20, loud[0], *[[0] * 12] * 3]
    yield valid(
        "mdct-loud-and-silent",
        "Loud blocks, silence until all averages are at rest, a loud block.",
        ["RNG-001", "RNG-003"],
        track(packet(component(rows, least), span=27 * 32, shape=least, clamped=WIDE),
              shape=least, clamped=WIDE),
    )  # fmt: skip
    rest = [[3, -2, 1], *[[0] * 3] * 24, [1, 0, -2], *[[0] * 3] * 9]
    yield valid(
        "mdct-to-rest",
        "Averages come down to 0: what they move by is rounded towards minus infinity.",
        ["RNG-001", "CNV-001"],
        track(packet(component(rest, start=30), span=35 * 32, clamped=WIDE), clamped=WIDE),
    )  # fmt: skip
    tilted = [[luck.between(-(4000 >> k // 3), 4000 >> k // 3) for k in range(32)]
              for _ in range(12)]  # fmt: skip
    yield valid(
        "mdct-spectrum",
        "The coefficients fall with k: each has an average of its own.",
        ["RNG-001"],
        track(packet(component(tilted, least), span=12 * 32, shape=least, clamped=WIDE),
              shape=least, clamped=WIDE),
    )  # fmt: skip
    bodies = [component(some(kept, kept, 5, 0, 2, 7)) for kept in (1, 2, 3, 31, 32)]
    packets = [packet(body, span=130, start=130 * i, clamped=WIDE) for i, body in enumerate(bodies)]
    yield valid(
        "mdct-few-coefficients",
        "One, two, three, 31 and all 32 coefficients: neighbours end with the last one.",
        ["MDC-002", "RNG-001"],
        track(*packets, clamped=WIDE),
    )  # fmt: skip


def parameters() -> Iterator[Case]:
    noise = walk(200, 200, 41)
    weighted = Shape(5, 300, (8, 32, 100, 255))
    yield valid(
        "mdct-weights", "Four weights: bands of eight coefficients.", ["MDC-001", "CNV-001"],
        track(packet(signal(noise, weighted, near=99), span=200, shape=weighted, clamped=WIDE),
              shape=weighted, clamped=WIDE),
    )  # fmt: skip
    each = Shape(5, 16, tuple(range(32)))
    yield valid(
        "mdct-weight-for-each",
        "As many weights as coefficients: halves are rounded up, and no step is 0.",
        ["MDC-001", "CNV-001"],
        track(packet(component(some(2, 32, 4, 0, 999), each), span=128, shape=each, clamped=WIDE),
              shape=each, clamped=WIDE),
    )  # fmt: skip
    most = Shape(9, 800, tuple(20 + i for i in range(128)))
    yield valid(
        "mdct-weights-128", "128 weights for 512 coefficients.", ["MDC-001"],
        track(packet(component(some(3, 512, 2, 0, 0, 30), most), span=700, shape=most,
                     clamped=WIDE), shape=most, clamped=WIDE),
    )  # fmt: skip
    two = [walk(130, 100, 42), walk(130, 40, 43)]
    parts = [signal(two[0], near=9), component([], base=5), signal(two[1], kept=9, classes=(2, 4))]
    yield valid(
        "mdct-components",
        "Three components: with a base of their own, classes, and one without coefficients.",
        ["LPC-001", "MDC-002"],
        track(packet(*parts, span=130, clamped=WIDE), width=3, clamped=WIDE),
    )  # fmt: skip
    yield valid(
        "mdct-clamped", "Counts beyond the declared range are clamped, both ways.", ["DEC-001"],
        track(packet(component([[60, 40], [-90, 3]], base=20), span=64, clamped=(-90, 95)),
              clamped=(-90, 95)),
    )  # fmt: skip
    slow = knots([(0, 50), (40, -30), (90, 10)], [50] * 40 + [-30] * 50 + [10] * 38)
    fast = packet(signal(walk(128, 60, 44), base=0), span=128, clamped=(-60, 60))
    yield valid(
        "mdct-residual", "The texture of an LF track.", ["DEC-001", "TRK-007"],
        Track(kind="lf", packets=[slow]), track(fast, kind="hf", base=0, id=1, clamped=(-60, 60)),
    )  # fmt: skip


def ends() -> Iterator[Case]:
    coarse = Shape(5, 2**32)
    yield uncommon(
        "mdct-largest-step", "A step of 2^32, and the largest sum of coefficients.",
        ["MDC-001", "MDC-003"],
        track(packet(component([[4, -4], [0, 8]], coarse), span=64, shape=coarse, clamped=WIDE),
              shape=coarse, clamped=WIDE),
    )  # fmt: skip
    fine = Shape(9, 4)
    half = LARGEST // 16
    rows = [[half, -half], [-2 * half], [half + 1, 0, half - 2]]
    yield uncommon(
        "mdct-largest-sum",
        "Blocks whose coefficients add up to 2^36, where they meet too.",
        ["MDC-003", "RNG-003", "DEC-001"],
        track(packet(component([row + [0] * (3 - len(row)) for row in rows], fine), span=1400,
                     shape=fine, clamped=WIDE), shape=fine, clamped=WIDE),
    )  # fmt: skip
    yield uncommon(
        "mdct-bases", "Bases at the count bound, beyond the declared range.",
        ["MDC-002", "DEC-001"],
        track(packet(component([], base=2**24), span=2, clamped=WIDE),
              packet(component([[-3]], base=-(2**24)), span=2, start=2, clamped=WIDE),
              clamped=WIDE),
    )  # fmt: skip
    far = {"clamped": WIDEST, "bound": 2**32}
    level_2 = Shape(6, 2**20)
    yield uncommon(
        "mdct-level-2", "Bases of level 2, with the largest coefficients.",
        ["MDC-002", "LIM-001", "DEC-001"],
        track(packet(component([], level_2, base=2**32), span=2, shape=level_2, **far),
              packet(component([[2**15, 0]], level_2, base=-(2**32)), span=64, start=2,
                     shape=level_2, **far),
              packet(component(some(5, 40, 3, 0, 600), level_2, base=2**31), span=190, start=66,
                     shape=level_2, **far),
              shape=level_2, clamped=WIDEST),
        level=2,
    )  # fmt: skip
    yield uncommon(
        "mdct-start-bytes", "The least and the largest start byte.", ["RNG-004"],
        track(packet(component(some(6, 9, 3, 1), start=0), span=96, clamped=WIDE),
              packet(component(some(6, 9, 3, 1), start=163), span=96, start=96, clamped=WIDE),
              clamped=WIDE),
    )  # fmt: skip
