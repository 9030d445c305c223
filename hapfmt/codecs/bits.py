"""Rows of bit fields, most significant bit first, to bytes (SPEC 9.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BLOCK_FIELDS = 1 << 16
"""Fields expanded to single bits at a time: bounds memory, whatever the packet."""


def pack_bits(values: NDArray[np.int64], widths: NDArray[np.int64]) -> bytes:
    """Each value in its width of bits, 0 to 62, one after the other, zero bits to fill the byte."""
    parts: list[NDArray[np.uint8]] = []
    for at in range(0, values.size, BLOCK_FIELDS):
        value, width = values[at : at + BLOCK_FIELDS], widths[at : at + BLOCK_FIELDS]
        stops = np.cumsum(width)
        total = int(stops[-1])
        below = np.repeat(stops, width) - 1 - np.arange(total)
        parts.append(((np.repeat(value, width) >> below) & 1).astype(np.uint8))
    return np.packbits(np.concatenate(parts)).tobytes() if parts else b""
