"""Clause 9.5: grids, sine table, predictor."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator

import page
from luck import Luck
from page import BrokenRule, K, grid_levels, rdiv, step_up, tops_by_search

from .component import Case, Component, tried

BOUND = 2**24
"""The count bound of level 1."""


def sine() -> Component:
    digest = hashlib.sha256(struct.pack("<128H", *K)).hexdigest()
    assert digest == page.DIGEST
    cases: list[Case] = [
        {"name": "the table", "sha256": digest, "entries": list(K)},
        {
            "name": "both signs",
            "pairs": [
                [k, K[k] if k >= 0 else -K[-k]] for k in (-127, -126, -64, -1, 0, 1, 64, 126, 127)
            ],
        },
    ]
    return Component(
        "sine",
        "9.5, Annex D",
        ("LPC-005", "CNV-001"),
        "The table K(0) to K(127) with the SHA-256 of its entries as u16; pairs of k and K(k).",
        cases,
    )


def steps(ks: list[int]) -> list[list[int]]:
    """p after each n; the last may break LPC-005."""
    p: list[int] = []
    out = []
    for k in ks:
        sin = K[k] if k >= 0 else -K[-k]
        n = len(p) + 1
        p = [p[j - 1] - rdiv(sin * p[n - j - 1], 32768) for j in range(1, n)] + [sin * 32]
        out.append(p)
        if max(map(abs, p)) > 2**36:
            break
    return out


def predictors() -> Component:
    rng = Luck(4)
    rows = [
        ("order 0", []),
        ("order 1", [64]),
        ("order 1, negative", [-64]),
        ("order 1, 0", [0]),
        ("order 1, largest", [127]),
        ("order 1, least", [-127]),
        ("order 2 of the examples", [113, -110]),
        ("rounding of negative halves", [1, -1, 1, -1]),
        ("zeros between", [50, 0, 0, -50]),
        ("order 8", [120, -100, 60, -40, 30, -20, 10, -5]),
        ("order 32", [rng.between(-40, 40) for _ in range(32)]),
        ("order 32, all 1", [1] * 32),
        ("order 32, in turn", [20, -20] * 16),
        ("order 12", [rng.between(-90, 90) for _ in range(12)]),
        ("all 127", [127] * 32),
        ("127 and -127 in turn", [127, -127] * 16),
        ("nine of -127", [-127] * 9),
        ("eight of 126", [126, -126] * 4),
    ]
    cases = [
        tried({"name": name, "k": ks, "p": steps(ks)}, lambda ks=ks: {"c": step_up(ks)})
        for name, ks in rows
    ]
    ks = largest_that_fits()
    cases.append({"name": "the largest of its kind", "k": ks, "p": steps(ks), "c": step_up(ks)})
    ks = [*ks, 127 if ks[-1] < 0 else -127]
    cases.append(
        tried({"name": "one more than fits", "k": ks, "p": steps(ks)}, lambda: {"c": step_up(ks)})
    )
    return Component(
        "predictor",
        "9.5",
        ("LPC-005", "CNV-001"),
        "Reflection coefficients `k`; `p`: p[1] to p[n] after each n (up to the first that breaks "
        "LPC-005); the predictor `c`.",
        cases,
    )


def largest_that_fits() -> list[int]:
    """127 and -127 in turn, as many as LPC-005 lets pass."""
    ks: list[int] = []
    while True:
        more = [*ks, 127 if len(ks) % 2 == 0 else -127]
        try:
            step_up(more)
        except BrokenRule:
            return ks
        ks = more


def grids() -> Component:
    shown = (0, 1, -1, 2, -2, 5, -7, 100)
    cases: list[Case] = []
    for name, step, zero in (
        ("step 1", 1, 0),
        ("step 25", 25, 0),
        ("zero moved", 10, -3),
        ("largest step", 2**24, 0),
    ):
        last = BOUND // step
        indices = [i for i in shown if abs(i) <= last] + [last, -last]
        cases.append(
            {
                "name": f"uniform, {name}",
                "grid": 0,
                "step": step,
                "zero": zero,
                "last": last,
                "indices": indices,
                "counts": [zero + i * step for i in indices],
            }
        )
    for kn, kd, step, zero in (
        (1, 10, 20, 0),
        (1, 10, 1, 0),
        (1, 20, 5, 1000),
        (1, 1024, 0, 0),
        (1, 3, 7, -11),
        (9, 10, 4, 0),
        (1, 10, 0, 0),
        (64, 65535, 100, 0),
        (1, 2, 1, 0),
        (3, 3, 50, 8),
        (5, 4, 2, 0),
        (1, 10, 2**24, 0),
        (1, 10, 2**23, 0),
    ):
        y = grid_levels(kn, kd, step, BOUND)
        last = len(y) - 1
        indices = [*dict.fromkeys([i for i in shown if abs(i) <= last] + [last, -last])]
        counts = [zero + (y[i] if i >= 0 else -y[-i]) for i in indices]
        digest = hashlib.sha256(struct.pack(f"<{len(y)}q", *y)).hexdigest()
        cases.append(
            {
                "name": f"deadband, {kn}/{kd}, floor {step}, zero {zero}",
                "grid": 1,
                "step": step,
                "zero": zero,
                "kn": kn,
                "kd": kd,
                "last": last,
                "indices": indices,
                "counts": counts,
                "first_levels": y[:24],
                "sha256": digest,
            }
        )
    kn, kd, step, bound = 1, 7, 3, 2000
    tops = tops_by_search(kn, kd, step, bound)
    cases.append(
        {
            "name": "cells up to 2000, found count by count",
            "grid": 1,
            "step": step,
            "kn": kn,
            "kd": kd,
            "zero": 0,
            "bound": bound,
            "tops": tops,
            "levels": grid_levels(kn, kd, step, bound),
        }
    )
    return Component(
        "grid",
        "9.5",
        ("LPC-002", "LPC-003", "CNV-001"),
        "Grids at level 1 (count bound 2^24): the largest index `last`, and the counts of some "
        "indices; deadband grids with y(0), y(1), ... and the SHA-256 of y(0) to y(N) as i64. "
        "The last "
        "case has a bound of its own, and the top of each cell up to it.",
        cases,
    )


def components() -> Iterator[Component]:
    yield sine()
    yield predictors()
    yield grids()
