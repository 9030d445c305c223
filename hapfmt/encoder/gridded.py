"""Floating point channels to counts, as their promise allows: which grid, and its cost in bits.

It chooses the grid (SPEC 9.1) that keeps a bound, and the index for each count.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from math import inf

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import FINEST, LpcParameters, deadband_levels
from ..recording import Channel
from ..spool import Memory, release
from .lattice import LatticeSearch, on_uniform_grid, to_counts
from .plan import Promise, extent_of
from .settings import Settings, Tolerance
from .unit import STEP_LIMIT, Bound, at_most

FINE = (1 / 200, 1 / 20, 1 / 2)
"""Shares of the allowed error that a fine grid may take, the first whose counts fit."""

PAPER_SHARE = 1 / 32
"""Preset paper puts floating point channels on a grid this fine against its threshold."""

WIDER = 1.03
"""A grid of its own pays for its description if its step is at least this many times wider."""

INFINITE = "infinite samples"
KEPT = "channel {!r} is stored without loss: it has infinite samples; as NaN they would be gaps"
NO_STEP = "no step is known, so an amount in lsb does not apply"


@dataclass(frozen=True)
class Gridded:
    """A channel as it is coded, one line on its grid, and what it promises there: of a floating
    point channel the amounts are absolute."""

    channel: Channel
    text: str
    promise: Promise
    fine: bool = True
    """Whether the grid is far finer than the promise; otherwise the grid is the quantiser."""
    finer: Gridded | None = None
    """Where the grid is the quantiser, a finer one that was found."""

    def kept(self, store: Memory) -> Gridded:
        """The same, with its samples in ``store``."""
        release()
        values = store.kept(self.channel.stored) if self.channel.deviation else self.channel.stored
        finer = self.finer and self.finer.kept(store)
        if values is self.channel.stored and finer is self.finer:
            return self
        return replace(self, channel=replace(self.channel, stored=values), finer=finer)


def on_grid(
    channel: Channel, promise: Promise, settings: Settings, search: LatticeSearch
) -> Gridded:
    """The channel in counts, or as it is where every bit is kept and there is no common step."""
    if promise.lossless or channel.calibration is not None:
        changed, text = to_counts(channel, search=search)
        return Gridded(changed, text, promise)
    absolute, why = in_unit(channel, promise, search)
    if absolute is None:
        changed, text = to_counts(channel, search=search)
        return Gridded(changed, text, Promise(why=why))
    if settings.tolerance is not None or absolute.paper:
        given = settings.tolerance or share_of(absolute, PAPER_SHARE)
        changed, text = to_counts(channel, given, search)
        kept = absolute if changed.is_counts else Promise(why=text)
        return Gridded(changed, text, kept)
    found = fine_grid(channel, absolute, search)
    if absolute.k or absolute.texture is not None:
        return found
    assert absolute.floor is not None
    own = on_uniform_grid(channel, absolute.floor.value, search)
    if own and wider(own[0], found):
        finer = found if found.fine and found.channel.calibration is not None else None
        return Gridded(*own, absolute, fine=False, finer=finer)
    return found


def in_unit(
    channel: Channel, promise: Promise, search: LatticeSearch
) -> tuple[Promise | None, str]:
    """The promise with an absolute amount; None and the reason where there is none."""
    floor = promise.floor
    assert floor is not None
    if channel.stored.dtype.kind not in "fiu" or not np.isfinite(x := channel.samples()).all():
        return None, INFINITE
    if not x.size:
        return None, "no samples"
    if floor.kind == "lsb":
        step = channel.lsb
        if not step:
            counted, _ = to_counts(channel, search=search)
            step = float(abs(counted.calibration.step)) if counted.calibration else None
        if step is None:
            return None, NO_STEP
        value: float | None = floor.absolute(0.0, step)
    else:
        value = floor.absolute(extent_of(x), None, channel.unit)
    if value is None or not 0.0 < value < inf:
        return None, "constant" if (x == x[0]).all() else "the range leaves no room for an error"
    return replace(promise, floor=Tolerance(value)), ""


def fine_grid(channel: Channel, promise: Promise, search: LatticeSearch) -> Gridded:
    """A grid that takes a small share of the error; without one the channel is stored as it is."""
    text = ""
    for part in FINE:
        changed, text = to_counts(channel, share_of(promise, part), search)
        if changed.is_counts:
            return Gridded(changed, text, promise)
    assert promise.floor is not None
    own = on_uniform_grid(channel, promise.floor.value, search)
    if own and not promise.k and promise.texture is None:
        return Gridded(*own, promise, fine=False)
    return Gridded(channel, text, Promise(why=text))


def share_of(promise: Promise, part: float) -> Tolerance | None:
    assert promise.floor is not None
    value = promise.floor.value * part
    return Tolerance(value) if value > 0 else None


def wider(own: Channel, found: Gridded) -> bool:
    """Whether the quantiser's own grid is wider than what whole counts of the other one allow."""
    if found.channel.calibration is None or own.calibration is None:
        return True
    step = abs(found.channel.calibration.step)
    error = allowed_counts(found.channel, found.promise)
    return float(own.calibration.step) > WIDER * float((2 * error + 1) * step)


def allowed_counts(channel: Channel, promise: Promise) -> int:
    """Whole counts that a sample may be off, where the amount is absolute."""
    assert channel.calibration is not None and promise.floor is not None
    room = Fraction(promise.floor.value)
    if channel.deviation is not None:
        room -= Fraction(channel.deviation.largest)
    return max(int(room / abs(channel.calibration.step)), 0)


Indices = NDArray[np.int64]

Levels = range | NDArray[np.int64]
"""Counts in ascending order."""


@lru_cache(maxsize=256)
def grid_within(bound: Bound, part: Fraction = Fraction(1)) -> LpcParameters:
    """The grid that has a value within that part of the deadband of every count."""
    step = min(int(bound.slack * part), STEP_LIMIT // 2 - 1)
    ratio = at_most(Fraction(bound.band.kn, bound.band.kd) * part)
    if ratio * FINEST < 1:
        return LpcParameters(2 * step + 1)
    return LpcParameters(step, bound.band.zero[0], ratio.numerator, ratio.denominator)


def nearest(x: Indices, grid: LpcParameters) -> Indices:
    return nearest_level(x, grid) if grid.kn else nearest_uniform(x, grid)


def nearest_uniform(x: Indices, grid: LpcParameters) -> Indices:
    if grid.step == 1:
        return x - grid.zero if grid.zero else x
    return (2 * (x - grid.zero) + grid.step) // (2 * grid.step)


def nearest_level(x: Indices, grid: LpcParameters) -> Indices:
    """The index whose cell holds each count: cells end at top(y) of SPEC 9.1."""
    c = x - grid.zero
    _, tops = deadband_levels(grid, int(np.abs(c).max()))
    cells: Indices = np.searchsorted(tops, np.abs(c)).astype(np.int64)
    return np.asarray(np.sign(c) * cells)


def levels_of(x: Indices, grid: LpcParameters) -> tuple[int, Levels]:
    """The counts that the nearest indices of x lie between, and the index of the first."""
    first, last = nearest(np.array([x.min(), x.max()]), grid).tolist()
    if not grid.kn:
        step, zero = grid.step, grid.zero
        return first, range(first * step + zero, last * step + zero + 1, step)
    return first, grid.counts(np.arange(first, last + 1), int(np.abs(x - grid.zero).max()))


def places(lower: Indices, upper: Indices, levels: Levels) -> tuple[Indices, Indices]:
    """The first and the last of ascending ``levels`` within [lower, upper]."""
    if isinstance(levels, range):
        low = -((levels.start - lower) // levels.step)
        high = (upper - levels.start) // levels.step
        return np.maximum(low, 0), np.minimum(high, len(levels) - 1)
    return np.searchsorted(levels, lower), np.searchsorted(levels, upper, side="right") - 1
