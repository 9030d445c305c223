"""Clause 11: samples outside a deadband, and how far; clause 8: deviations rounded up."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from fractions import Fraction

from luck import Luck

from .component import Case, Component


def judged(x, y, kn: int, kd: int, floor, zero, vector: bool) -> Case:
    """``x``, ``y``: one row for each component."""
    if vector:
        groups = [(x, y, floor[0], zero)]
    else:
        groups = [([a], [b], f, [z]) for a, b, f, z in zip(x, y, floor, zero, strict=True)]
    outside, worst = [], []
    for xs, ys, least, zs in groups:
        ratios = []
        for tick in zip(zip(*xs, strict=True), zip(*ys, strict=True), strict=True):
            left = sum((a - b) ** 2 for a, b in zip(*tick, strict=True)) * kd**2
            size = sum((a - z) ** 2 for a, z in zip(tick[0], zs, strict=True))
            ratios.append(Fraction(left, max(kn**2 * size, least**2 * kd**2)))
        outside.append([t for t, ratio in enumerate(ratios) if ratio > 1])
        worst.append([max(ratios).numerator, max(ratios).denominator])
    return {"outside": outside, "worst_squared": worst}


def contracts() -> Component:
    rng = Luck(16)
    far = [rng.between(-9000, 9000) for _ in range(40)]
    near = [a + rng.between(-abs(a) // 9 - 21, abs(a) // 9 + 21) for a in far]
    rows: list[tuple] = [
        ("nothing differs", [[5, 0, -5]], [[5, 0, -5]], 1, 10, [3], [0], False),
        ("at the floor", [[0, 0, 0, 0]], [[3, -3, 4, -4]], 1, 10, [3], [0], False),
        ("at a tenth", [[100, 100, -100, -100]], [[110, 111, -90, -89]], 1, 10, [1], [0], False),
        ("a zero that is not 0", [[100, 100, 60]], [[105, 106, 61]], 1, 10, [1], [50], False),
        ("a fraction that does not divide", [[100, 100]], [[114, 115]], 1, 7, [1], [0], False),
        ("k = 0: the floor alone", [[1000, 1000]], [[1004, 1005]], 0, 1, [4], [0], False),
        ("k above 1", [[10, 10]], [[25, 26]], 3, 2, [1], [0], False),
        ("two components", [[0, 100], [0, 100]], [[2, 90], [3, 89]], 1, 10, [2, 3], [0, 0], False),
        ("a vector, at its floor", [[0, 0], [0, 0]], [[3, 3], [4, 5]], 1, 10, [5, 1], [0, 0], True),
        ("a vector, at a tenth of its length", [[300, 300], [400, 400]], [[330, 331], [440, 440]],
         1, 10, [1, 1], [0, 0], True),
        ("noise", [far], [near], 1, 9, [20], [0], False),
        ("noise as a vector", [far, far[::-1]], [near, near[::-1]], 1, 12, [9, 9], [3, -8], True),
        ("32 bits", [[2**31 - 1, -(2**31)]], [[-(2**31), 2**31 - 1]], 65535, 65534, [1],
         [-(2**31)], False),
        ("a large floor", [[0, 0]], [[2**32 - 2, 2**32 - 1]], 1, 65535, [2**32 - 2], [0], False),
    ]  # fmt: skip
    cases = [
        {"name": name, "x": x, "y": y, "kn": kn, "kd": kd, "floor": floor, "zero": zero,
         "vector": vector} | judged(x, y, kn, kd, floor, zero, vector)
        for name, x, y, kn, kd, floor, zero, vector in rows
    ]  # fmt: skip
    return Component(
        "contract", "11", ("DBC-002",),
        "Counts x of the source and y of the reconstruction, a row for each component. "
        "`outside`: the "
        "ticks that break the contract, and `worst_squared` the largest ratio of the left side "
        "to the "
        "right, squared, as a fraction; for each component, or one for the vector.", cases,
    )  # fmt: skip


def rounded_up(x: float) -> bytes:
    """The least binary32 that is not below x, found by its bits."""
    low, high = 0, 0x7F800000
    while low < high:
        middle = (low + high) // 2
        if struct.unpack("<f", struct.pack("<I", middle))[0] >= x:
            high = middle
        else:
            low = middle + 1
    return struct.pack("<I", low)


def deviations() -> Component:
    numbers = (0.0, 1.0, 0.1, 0.1 + 2**-30, 1 / 3, 5e-324, 1.4e-45, 2.0**-126, 1e-40, 16777217.0,
               3e38, 0.5 + 2**-24, 0.5 + 2**-25)  # fmt: skip
    cases = [
        {"name": repr(x), "distance": struct.pack(">d", x).hex(), "stored": rounded_up(x)}
        for x in numbers
    ]
    return Component(
        "deviation", "6.2", ("TLV-005", "TLV-006"),
        "`distance`, the bits of binary64, highest first, and how a deviation stores it: rounded "
        "up to "
        "the next binary32, four bytes as in the file.", cases,
    )  # fmt: skip


def components() -> Iterator[Component]:
    yield contracts()
    yield deviations()
