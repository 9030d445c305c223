"""The exponential of a small matrix, without the 200 modules and 0.2 s that importing SciPy's linear
algebra takes."""

from __future__ import annotations

from math import ceil, log2

import numpy as np
from numpy.typing import NDArray

TERMS = 20
"""Of the series, at a norm of at most 1/2: what follows is below 2^-21 / 21!, far below 2^-53."""


def exponential(a: NDArray[np.float64]) -> NDArray[np.float64]:
    """exp(a), [n, n]: the series of a / 2^s, squared s times."""
    norm = float(np.abs(a).sum(axis=1).max())
    halvings = max(ceil(log2(norm)) + 1, 0) if norm > 0 else 0
    a = a / 2.0**halvings
    out = term = np.eye(len(a))
    for n in range(1, TERMS + 1):
        term = term @ a / n
        out = out + term
    for _ in range(halvings):
        out = out @ out
    return np.asarray(out)
