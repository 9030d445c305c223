"""A block of counts as the fewest knots within its deadband, on a grid: a packet of KNOT.

kernels/live_knots.c has the same in C. All is counted from the zero of the grid.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..codecs.knots import Interpolation, interpolate
from ..codecs.knots_coded import encode_knots
from ..deadband import Deadband
from .grids import Levels, places
from .tube import fewest_hold, fewest_linear

Counts = NDArray[np.int64]


def pack_knots(
    x: Counts,
    interpolation: Interpolation,
    grid: LpcParameters,
    levels: Counts | None,
    band: Deadband,
    slack: int,
    limits: tuple[int, int],
) -> bytes | None:
    """``levels``: magnitudes and tops of a deadband's grid; ``slack``: the error that is allowed
    whatever the count; ``limits``: what a decoder clamps to. None where the deadband does not
    hold."""
    weber = np.abs(x - band.zero[0]) * band.kn // band.kd
    width, at = np.maximum(weber, slack), x - grid.zero
    first, window = window_of([int(at.min()), int(at.max())], grid, levels)
    if interpolation == "hold":
        ticks, place = fewest_hold(*places(at - width, at + width, window))
        values = np.asarray(window)[place] if levels is not None else window[0] + place * grid.step
    else:
        ticks, values = fewest_linear(at - width, at + width, window)
        place = places(values, values, window)[0]
    y = interpolate(ticks, values[:, None], x.size, interpolation)[:, 0] + grid.zero
    if band.outside(x, np.clip(y, *limits)).any():
        return None
    return encode_knots(ticks, (place + first)[:, None], interpolation)


def window_of(
    ends: Sequence[int], grid: LpcParameters, levels: Counts | None
) -> tuple[int, Levels]:
    """The counts of the grid that the nearest ones of two ends lie between, and the first's
    index."""
    if levels is None:
        first, last = ((2 * end + grid.step) // (2 * grid.step) for end in ends)
        return first, range(first * grid.step, last * grid.step + 1, grid.step)
    sizes, tops = levels
    cells = [int(np.searchsorted(tops, abs(end))) for end in ends]
    first, last = (cell if end >= 0 else -cell for cell, end in zip(cells, ends, strict=True))
    every = np.concatenate((-sizes[:0:-1], sizes))
    middle = sizes.size - 1
    return first, every[middle + first : middle + last + 1]
