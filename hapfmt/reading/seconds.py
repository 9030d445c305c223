"""Seconds asked for -> ticks and clusters (SPEC clause 7)."""

from __future__ import annotations

from fractions import Fraction
from math import ceil, floor

from ..numbers import exact, tick_range
from .catalogue import ChunkRef

Seconds = Fraction | float | int


def tick_after(time_ns: int, rate: Fraction) -> int:
    """The first tick at ``time_ns`` or later."""
    return -(-time_ns * rate.numerator // (rate.denominator * 10**9))


def overlapping(
    refs: list[ChunkRef], start: Seconds | None, stop: Seconds | None
) -> list[ChunkRef]:
    """DATA chunks that may hold something of the seconds [start, stop)."""
    first = 0 if start is None else floor(exact(start) * 10**9)
    last = None if stop is None else ceil(exact(stop) * 10**9)
    return [
        ref
        for ref in refs
        if ref.start_ns is None
        or ref.stop_ns is None
        or ((start is None or first < ref.stop_ns) and (last is None or ref.start_ns < last))
    ]


__all__ = ["Seconds", "overlapping", "tick_after", "tick_range"]
