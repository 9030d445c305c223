"""The quality of textures that makes a file of a given size."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from .settings import CLOSE, TEXTURE_DB

Result = TypeVar("Result")

LEAST_DB, MOST_DB = 0.0, 120.0
"""At 0 dB the error is as large as the texture; at 120 dB any lossless form is smaller."""

DB_PER_BIT = 6.02
"""What one more bit for each sample of a texture gains, at high rates."""

TRIALS = 16

NARROW_DB = 0.02
"""Sizes jump where another way to code becomes the smaller one."""


def fill(
    encode: Callable[[float], Result],
    size_of: Callable[[Result], int],
    budget: float,
    samples: int,
) -> Result:
    """The largest result of at most ``budget`` bytes, within CLOSE where sizes allow; else the
    smallest result. ``encode`` takes a quality in dB; ``samples``: of textures.

    Interpolates between a result that fits and one that does not.
    """
    low = high = None
    db, away = TEXTURE_DB, 1.0
    best: Result | None = None
    for _ in range(TRIALS):
        result = encode(db)
        size = size_of(result)
        if size <= budget:
            low, best = (db, size), result
            if size >= (1 - CLOSE) * budget or db >= MOST_DB:
                break
        else:
            high = (db, size)
            if db <= LEAST_DB:
                return result
        if low and high:
            if high[0] - low[0] < NARROW_DB:
                break
            share = ((1 - CLOSE / 2) * budget - low[1]) / (high[1] - low[1])
            db = low[0] + min(max(share, 0.1), 0.9) * (high[0] - low[0])
        else:
            slope = DB_PER_BIT * 8 * ((1 - CLOSE / 2) * budget - size) / max(samples, 1)
            away = max(1.2 * abs(slope), away)
            db = min(max(db + (away if low else -away), LEAST_DB), MOST_DB)
            away *= 2
    return result if best is None else best
