"""Channels of counts, block by block, on one grid: of step 1, of a largest error, of a deadband."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..container.track import Track
from ..contract import nearest_counts
from ..errors import ParameterError
from .grids import nearest
from .live_plan import Plan
from .predict import encode_best
from .quick import encode_quick

Counts = NDArray[np.int64]


def counts_of_block(plan: Plan, values: NDArray[Any], channel: int, start: int) -> Counts:
    """What came in as counts within the declared range; nothing is clamped."""
    given = plan.input
    if given.takes_counts:
        if values.dtype.kind not in "iu":
            raise ParameterError(
                f"channel {channel} ({given.label!r}) takes integer counts, not {values.dtype}"
            )
        outside = (values < plan.low) | (values > plan.high)
        if outside.any():
            raise outside_range(plan, values, outside, channel, start)
        return np.ascontiguousarray(values, np.int64)
    if values.dtype.kind not in "iuf" or values.dtype.itemsize > 8:
        raise ParameterError(
            f"channel {channel} ({given.label!r}) takes numbers of up to 64 bits, "
            f"not {values.dtype}"
        )
    x = np.ascontiguousarray(values, np.float64)
    low, high = (float(plan.calibration.step) * end for end in (plan.low, plan.high))
    outside = ~((x >= low) & (x <= high))
    if outside.any():
        raise outside_range(plan, values, outside, channel, start)
    return np.clip(nearest_counts(x, plan.calibration), plan.low, plan.high)


def outside_range(
    plan: Plan, values: NDArray[Any], outside: NDArray[np.bool_], channel: int, start: int
) -> ParameterError:
    given = plan.input
    at = int(np.argmax(outside))
    bits = f"the {given.bits} bits ({plan.low} to {plan.high})"
    if given.takes_counts:
        limits = f"the count {values[at]} is outside {bits} of the input: declare more of them"
    else:
        limits = f"{values[at]} is outside {bits} of steps of {given.lsb:g}: give a larger lsb"
    return ParameterError(f"channel {channel} ({given.label!r}), tick {start + at}: {limits}")


def fits(track: Track, counts: Counts) -> bool:
    """Whether the declared range holds all of them."""
    return track.count_min <= int(counts.min()) and int(counts.max()) <= track.count_max


class GridLane:
    """A channel as indices of one grid, in packets of LPCR."""

    def __init__(self, plan: Plan, number: int) -> None:
        self.plan, self.number = plan, number
        self.grid = plan.grid
        self.whole = plan.track(
            number, codec="LPCR", parameters=self.grid.build(), contract=plan.contract
        )
        self.track, self.narrow = self.whole, False

    def adopt(self, track: Track) -> None:
        """Goes on with a track of the file where it differs in its range alone."""
        self.whole = replace(self.whole, continues=track.id)
        self.narrow = alike(track, self.whole)
        self.track = track if self.narrow else self.whole

    def code(self, values: NDArray[Any], start: int) -> bytes:
        counts = counts_of_block(self.plan, values, self.number, start)
        if self.narrow and not fits(self.track, counts):
            self.track, self.narrow = self.whole, False
        indices = nearest(counts, self.grid)
        if self.plan.settings.fast:
            return encode_quick(indices)
        return encode_best(indices, thorough=False)


def alike(track: Track, wanted: Track) -> bool:
    """Whether packets for the one are packets for the other, but for the declared range."""
    same = ("codec", "parameters", "contract", "number_format")
    return all(getattr(track, name) == getattr(wanted, name) for name in same) and (
        track.components[0].deviation == wanted.components[0].deviation
    )
