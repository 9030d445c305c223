"""Deadbands and measures: rows 1, 2, 21."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from importlib import import_module
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from hapfmt import Channel
from hapfmt.deadband import Deadband
from hapfmt.encoder.knots import select_knots
from hapfmt.encoder.lattice import Tolerance, to_counts
from hapfmt.errors import ParameterError
from hapfmt.metrics import ST_SIM_EXPONENT, st_sim

from .row import Row, at_least, at_most, compared, exactly
from .signals import MILLI, RATE, Samples, counts, generator, texture

FLOOR_N = Fraction(1, 100)


def weber_knots(x: Samples, k: float = 0.1) -> NDArray[np.int64]:
    """Weber's law alone: a knot where a sample differs from the last knot by more than k of it."""
    found, last = [0], float(x[0])
    for i, value in enumerate(x.tolist()):
        if abs(value - last) > k * abs(last):
            found.append(i)
            last = value
    return np.array(found)


def deadband(count: int = 1, *, vector: bool = False) -> Deadband:
    return Deadband.from_physical("0.1", FLOOR_N, [MILLI] * count, vector=vector)


def our_knots(x: Samples) -> NDArray[np.int64]:
    return select_knots(counts(x), deadband(), keep_last=True)


def decay() -> Row:
    n = 14_000
    x = 3 * np.exp(-np.arange(n) / 700) + np.round(generator(1).normal(0, 1.0, n)) * 1e-3
    refused = False
    try:
        Deadband.from_physical("0.1", 0, [MILLI])
    except ParameterError:
        refused = True
    return compared(
        1, "force that decays to zero, 14 s",
        (weber_knots(x).size, at_least(3000)), (our_knots(x).size, at_most(60)), "knots",
        "Weber's law alone follows the sensor's noise; floor of 10 mN, a floor of 0 is refused",
        held=refused,
    )  # fmt: skip


def denormal_decay() -> Row:
    n = 12_000
    noise = generator(2).integers(1, 100, n) * 5e-324
    x = np.where(np.arange(n) < 8000, np.exp(-np.arange(n) / 250), noise)
    tolerance = Tolerance(float(FLOOR_N) / 32)
    channel, _ = to_counts(Channel.from_physical(x, RATE, unit="N"), tolerance)
    assert channel.calibration is not None
    band = Deadband.from_physical("0.1", FLOOR_N, [channel.calibration])
    ours = select_knots(channel.stored, band, keep_last=True)
    return compared(
        1, "decay that ends in 4 s of denormal noise",
        (int((weber_knots(x) >= 8000).sum()), at_least(3000)),
        (int((ours >= 8000).sum()), at_most(1)), "knots", "below the floor nothing is followed",
    )  # fmt: skip


def sign_change() -> Row:
    t = np.arange(10 * RATE) / RATE
    x = 0.5 * np.sin(0.4 * np.pi * t) + np.round(generator(3).normal(0, 1.0, t.size)) * 1e-3
    naive, ours = weber_knots(x), our_knots(x)
    near = np.abs(x) < 0.05
    return compared(
        2, "force that changes sign, slowly",
        (100 * near[naive].mean(), at_least(50)), (100 * near[ours].mean(), at_most(25)),
        "% of knots below 50 mN", f"{naive.size} and {ours.size} knots in 10 s",
    )  # fmt: skip


def rotating() -> Row:
    t = np.arange(10 * RATE) / RATE
    axes = np.stack([np.sin(2 * np.pi * (1.3 * t + a)) for a in (0, 1 / 3, 2 / 3)], axis=1)
    table = counts(axes + texture(3 * t.size, 0.002).reshape(-1, 3))
    alone = sum(select_knots(column, deadband(), keep_last=True).size for column in table.T)
    ours = select_knots(table, deadband(3, vector=True), keep_last=True).size
    return compared(
        2, "force of constant size that turns, 3 axes",
        (alone / 10, at_least(150)), (ours / 10, at_most(100)), "knots/s",
        "a deadband for each axis against one for the norm",
    )  # fmt: skip


@contextmanager
def measured_by() -> Iterator[str]:
    """The package vibromaf, or its last formula in its place: power of a mean correlation."""
    with suppress(ImportError):
        import_module("vibromaf.metrics.stsim")
        yield "vibromaf"
        return
    names = ("vibromaf", "vibromaf.metrics", "vibromaf.metrics.stsim")
    modules = [ModuleType(name) for name in names]
    modules[2].st_sim = power_of_correlation  # type: ignore[attr-defined]
    sys.modules.update(zip(names, modules, strict=True))
    try:
        yield "the formula alone, vibromaf is not installed"
    finally:
        for name in names:
            del sys.modules[name]


def power_of_correlation(distorted: Samples, reference: Samples, eta: float) -> complex | float:
    blocks = distorted.size // 512
    a, b = (x[: blocks * 512].reshape(blocks, 512) for x in (distorted, reference))
    similarity = float(np.mean((a * b).sum(1) / np.sqrt((a * a).sum(1) * (b * b).sum(1))))
    return similarity**eta  # type: ignore[no-any-return]


def anti_correlated() -> Row:
    f = 1 + texture(3000, 0.03)
    with measured_by() as how:
        measure = sys.modules["vibromaf.metrics.stsim"].st_sim
        quiet = f - 1
        naive = complex(measure(1 - f, quiet, eta=ST_SIM_EXPONENT))
        ours = st_sim(f, 2 - f, RATE)
        alike = st_sim(f, f + 0.001 * generator(2).normal(size=f.size), RATE)
    return compared(
        21, "ST-SIM of a texture and its opposite",
        (abs(naive.imag), at_least(0.01)), (ours, exactly(0)), "imaginary part",
        f"{naive.real:.2g} + {naive.imag:.2g}i by {how}; ours {ours:g}, of its like {alike:.3g}",
        held=0.9 < alike < 1.01,
    )  # fmt: skip


ROWS = (decay, denormal_decay, sign_change, rotating, anti_correlated)
