"""Clause 9.10: noise, gains, the lattice filter, and packets of NOIS."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator

import page_noise as page
from luck import Luck

from .component import Case, Component, tried


def equal(seed: int, density: int) -> int:
    """The first tick with a lowest byte of ``density``, where <= would give a pulse."""
    return next(t for t in range(9999) if page.word_of(seed, t) % 256 == density)


def noise() -> Component:
    rows = [
        ("seed 1", 1, 0, 0),
        ("seed 0: the first word is 0", 0, 0, 0),
        ("the largest seed", 2**32 - 1, 0, 0),
        ("late ticks, whose products pass 2^53", 77, 2**24 - 20, 0),
        ("a pulse at half of the ticks", 5, 0, 128),
        ("hardly any pulses", 6, 150, 1),
        ("pulses at nearly all ticks", 7, 0, 255),
        ("a lowest byte that is the density: no pulse", 8, equal(8, 100), 100),
    ]
    cases: list[Case] = []
    for name, seed, first, density in rows:
        ticks = range(first, first + 20)
        n = [page.noise_of(seed, t, density) for t in ticks]
        cases.append({"name": name, "seed": seed, "density": density, "first": first, "n": n})
    return Component(
        "noise",
        "9.10",
        ("CNV-001",),
        "n[t] from tick `first` on.",
        cases,
    )


def gains() -> Component:
    values = [page.gain_of(q) for q in range(113)]
    digest = hashlib.sha256(struct.pack("<113q", *values)).hexdigest()
    return Component(
        "noise-gains",
        "9.10",
        ("CNV-001", "NOI-006"),
        "G(0) to G(112), and the SHA-256 of these as i64.",
        [{"name": "all gain indices", "values": values, "sha256": digest}],
    )


def lattice() -> Component:
    luck = Luck(910)
    pulse = [2**20, *([0] * 30)]
    loud = [luck.between(-(2**28), 2**28) for _ in range(40)]
    rows = [
        ("no coefficient", [], [5, -5, 2**30]),
        ("one coefficient", [64], pulse),
        ("one negative coefficient", [-64], pulse),
        ("roundings of negative halves", [1, -1], [-3, -1, 1, 3] * 6),
        ("two coefficients", [113, -110], pulse),
        ("nearly an oscillator", [127, -127], pulse),
        ("eight coefficients", [100, -80, 50, -40, 30, -20, 10, -5], loud),
        ("32 coefficients", [luck.between(-50, 50) for _ in range(32)], loud),
        ("the state is clamped", [127, -127, 127, -127], loud),
        ("the state is clamped, 32 coefficients", [127, -127] * 16, loud),
    ]
    cases: list[Case] = []
    for name, ks, excitation in rows:
        g, states, counts = [0] * len(ks), [], []
        for e in excitation:
            counts.append(page.rdiv(page.filtered(e, ks, g), 64))
            states.append(list(g))
        cases.append(
            {
                "name": name,
                "k": ks,
                "e": excitation,
                "counts": counts,
                "g": states[:4] + states[-1:],
            }
        )
    return Component(
        "lattice",
        "9.10",
        ("CNV-001",),
        "The filter with coefficients `k`, from a state of zeros: counts for excitations `e`, and "
        "g behind each of the first four ticks and the last.",
        cases,
    )


def packet(name: str, data: bytes, span: int, width: int = 1, shift: int = 3,
           intervals: int = 8) -> Case:  # fmt: skip
    case: Case = {
        "name": name, "shift": shift, "intervals": intervals, "span": span, "components": width,
        "packet": data,
    }  # fmt: skip
    return tried(case, lambda: {"counts": page.decode_packet(data, shift, intervals, span, width)})


def packets() -> Component:
    luck = Luck(10)
    e, p = page.encode, page.encode_packet
    steps = [30, 34, 38, 0, 0, 0, 41, 41, 20, 20, 20, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 30]
    four = [[110, -90, 40, -10], [90, -100, 20, 5], [1, 2, 3, 4], [-127, 127, 0, 1]]
    rows: list[tuple] = [
        ("silence", b"", 20),
        ("gain alone", e([40, 44, 36], [], 8), 24),
        ("the last interval is shorter", e([40, 44, 36], [], 8), 17),
        ("a falling gain, rounded down", e([1, 6, 1], [[120, -120]], 8, seed=12), 300, 1, 7),
        ("one tick", e([50], [[60]], 8), 1),
        ("to silence and back", e([40, 0, 0, 40], [[120, -100]], 8), 32),
        ("silence from the first tick", e([0, 40, 0, 0], [[120, -100]], 8), 32),
        ("blocks, one of them silent", e(steps, four, 8), 200),
        ("blocks of more ticks", e([40, 41], [[50, 50]], 255, seed=9), 4200, 1, 12, 255),
        ("every gain", e([*range(113)], [[9]] * 15, 8), 904),
        ("pulses", e([60] * 8, [[100, -60, 20]], 8, density=40), 64),
        ("four states", e(steps, four, 8, states=4), 200),
        ("other classes", e(steps, four, 8, ways=((7, 30), (15, 0))), 200),
        ("two components, one silent", p([b"", e([40], [[5]], 8)]), 8, 2),
        ("two components, the second silent", p([e([40], [[5]], 8), b""]), 8, 2),
    ]
    ks = [[luck.between(-60, 60) for _ in range(32)]]
    rows.append(("32 coefficients", e([44] * 8, ks, 8), 64))
    good = e([40, 44, 36], [[50, -20]], 8)
    rows += [
        ("sizes beyond the packet", b"\1", 8, 2),
        ("33 coefficients", bytes([33]) + good[1:], 24),
        ("head cut short", good[:10], 24),
        ("head without coefficients cut short", e([40], [], 8)[:8], 8),
        ("the first gain is 113", good[:6] + b"\x71" + good[7:], 24),
        ("a gain of 113", e([112, 113], [], 8), 16),
        ("a gain below 0", e([5, -1], [], 8), 16),
        ("a coefficient of 128", e([40], [[128]], 8), 8),
        ("a coefficient of -128", e([40], [[-128]], 8), 8),
        ("bit 5 of a coding", good[:7] + b"\x20" + good[8:], 24),
        ("four states of the coefficients", good[:9] + b"\x10" + good[10:], 24),
        ("a start byte of 164", good[:8] + b"\xa4" + good[9:], 24),
        ("a start byte of 164, of coefficients", good[:10] + b"\xa4" + good[11:], 24),
        ("a byte left over", good + b"\0", 24),
        ("a byte is missing", good[:-1], 24),
        ("no coded bytes", e([40], [], 8)[:9], 8),
    ]
    return Component(
        "nois",
        "9.10",
        ("LPC-001", "NOI-005", "NOI-006", "RNG-001", "RNG-004", "CNV-001"),
        "Packets of NOIS: the counts of each component.",
        [packet(*row) for row in rows],
    )


def components() -> Iterator[Component]:
    yield noise()
    yield gains()
    yield lattice()
    yield packets()
