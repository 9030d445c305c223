"""Linear prediction: rows 10, 11."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import pi, sin

import numpy as np
from numpy.typing import NDArray

from hapfmt import Calibration, Channel
from hapfmt.encoder.predict import ORDER_LIMIT, autocorrelations, levinson

from .row import Row, at_least, at_most, compared, exactly
from .signals import Samples, back, texture

ORDER = 32
BITS = 10


def plain_levinson(r: Sequence[float], order: int) -> tuple[Samples, Samples]:
    """Levinson and Durbin without a floor: reflection and direct-form coefficients."""
    a, error, found = np.zeros(0), float(r[0]), []
    for m in range(order):
        k = (r[m + 1] - a @ np.array(r[m:0:-1])) / error if error else np.inf
        found.append(k)
        a = np.concatenate([a - k * a[::-1], [k]])
        error *= 1 - k * k
    return np.array(found), a


def sums(x: NDArray[np.generic], order: int) -> list[float]:
    """As it is written down first: float32 samples, sums of products."""
    y = x.astype(np.float32)
    return [float(np.sum(y[k:] * y[: y.size - k])) for k in range(order + 1)]


def smooth(n: int) -> Samples:
    return np.floor(texture(n, 1e6, band=(2, 8), rate=10_000) + 0.5)


def near_singular() -> Iterator[Row]:
    sine = np.floor(20_000 * np.sin(2 * pi * 20 * np.arange(10_000) / 10_000) + 0.5)
    for case, x in (("content below 8 Hz at 10 kHz", smooth(10_000)), ("a pure sine", sine)):
        with np.errstate(all="ignore"):
            naive = np.abs(plain_levinson(sums(x, ORDER), ORDER)[0])
        indices = x.astype(np.int64)
        reflections, energies = levinson(autocorrelations(indices, 0, 0), x.size, ORDER_LIMIT)
        ours = max(sin(pi * abs(index) / 256) for index in reflections)
        kept = back(Channel(indices, 10_000, calibration=Calibration()), "lossless").stored
        yield compared(
            10, f"autocorrelation of {case}, order {ORDER}",
            (float(np.nan_to_num(naive, nan=np.inf).max()), at_least(1)), (ours, at_most(0.99999)),
            "largest |k|", "beyond 1 a predictor diverges; comes back from a file without loss",
            held=min(energies) > 0 and np.array_equal(kept, x),
        )  # fmt: skip


def radius(a: Samples) -> float:
    """The largest root of 1 - a1/z - a2/z^2 ...: above 1 a synthesis grows."""
    return float(np.abs(np.roots(np.concatenate([[1.0], -a]))).max())


def direct_form(reflections: Sequence[float]) -> Samples:
    a = np.zeros(0)
    for k in reflections:
        a = np.concatenate([a - k * a[::-1], [k]])
    return a


def quantised() -> Row:
    """Blocks of one second, their coefficients in 10 bits, against 7 bits of reflections."""
    blocks, order = 40, 8
    x = smooth(blocks * 2000).reshape(blocks, 2000).astype(np.int64)
    naive, ours = [], []
    for block in x:
        r = autocorrelations(block, 0, 0)
        floored = [r[0] * (1 + 1e-9) + block.size / 12, *map(float, r[1:])]
        a = plain_levinson(floored, order)[1]
        step = np.abs(a).max() / (2 ** (BITS - 1) - 1)
        naive.append(radius(np.round(a / step) * step))
        indices = levinson(r, block.size, ORDER_LIMIT)[0][:order]
        ours.append(radius(direct_form([sin(pi * index / 256) for index in indices])))
    return compared(
        11, f"direct form in {BITS} bits, order {order}",
        (100 * np.mean(np.array(naive) >= 1), at_least(20)),
        (100 * np.mean(np.array(ours) >= 1), exactly(0)), "% of blocks unstable",
        f"largest root {max(naive):.6f} and {max(ours):.6f}; ours: reflections in 7 bits",
    )  # fmt: skip


ROWS = (near_singular, quantised)
