"""The quality of textures that makes a file of a given size."""

from __future__ import annotations

from collections.abc import Callable
from math import log2, log10
from typing import TypeVar

from .settings import CLOSE, TEXTURE_DB

Result = TypeVar("Result")

LEAST_DB, MOST_DB = 0.0, 120.0
"""At 0 dB the error is as large as the texture; at 120 dB any lossless form is smaller."""

TRIALS = 16

NARROW_DB = 0.02
"""Sizes jump where another way to code becomes the smaller one."""

FLATTEST, STEEPEST = 8.0, 4.0
"""Bounds of what two results tell: how much flatter than a line through 0 the sizes are, and how
few of the bits the next guess has."""

BEYOND = 1.05
"""By how much farther a guess goes that no result encloses, each time more."""


def bits_at(db: float) -> float:
    """About twice the bits a sample of a texture of this quality; sizes go about along it."""
    return log2(1 + 10 ** (db / 10))


MOST_BITS = bits_at(MOST_DB)


def db_of(bits: float) -> float:
    return 10 * log10(max(2 ** min(bits, MOST_BITS) - 1, 1e-9))


def fill(
    encode: Callable[[float], Result], size_of: Callable[[Result], int], budget: float
) -> Result:
    """The largest result of at most ``budget`` bytes, within CLOSE where sizes allow; else the
    smallest result. ``encode`` takes a quality in dB.

    Interpolates between a result that fits and one that does not. Until there are both, the last
    two results tell where the other one is.
    """
    low = high = last = None
    db, best, beyond = TEXTURE_DB, None, 1.0
    for _ in range(TRIALS):
        result = encode(db)
        here = bits_at(db), size_of(result)
        if here[1] <= budget:
            low, best = here, result
            if here[1] >= (1 - CLOSE) * budget or db >= MOST_DB:
                break
        else:
            high = here
            if db <= LEAST_DB:
                return result
        wanted = (1 - CLOSE / 2) * budget
        if low and high:
            if db_of(high[0]) - db_of(low[0]) < NARROW_DB:
                break
            share = (wanted - low[1]) / (high[1] - low[1])
            bits = low[0] + min(max(share, 0.1), 0.9) * (high[0] - low[0])
        else:
            size = here[1] - (last[1] if last else 0)
            slope = size / (here[0] - (last[0] if last else 0.0))
            away = beyond * (wanted - here[1]) / max(slope, here[1] / here[0] / FLATTEST)
            bits = max(here[0] + away, here[0] / STEEPEST)
            beyond *= BEYOND
        last = here
        db = min(max(db_of(bits), LEAST_DB), MOST_DB)
    return result if best is None else best
