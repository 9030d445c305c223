"""Channels within a deadband, block by block: knots, or prediction on a grid, whichever is smaller.

Every way keeps the deadband by construction. The first block decides; where another way would have
been much smaller for long, a track of that one continues the channel, and each time it takes more
to do so again: descriptions stay few.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters, deadband_levels
from ..codecs.knots import Interpolation, interpolate
from ..codecs.knots_coded import CodedKnotParameters, encode_knots
from ..container.track import Track
from .grids import Levels, grid_within, nearest_uniform, places
from .live_counts import BROKEN, Counts, GridWay, alike, counts_of_block, fits, grid_way
from .live_many import Shelf
from .live_plan import Plan
from .tube import COUNT_BOUND, fewest_hold, fewest_linear
from .tubed import HALF, tube_of
from .unit import STEP_LIMIT, Bound

AGAIN = 16
"""After so many packets all ways are tried once more."""

EVIDENCE, MUCH = 600, 0.85
"""Another way takes over when it would have saved so many bytes, a few times what its description
takes, and its packets are smaller than this part of the others."""


class KnotWay:
    """Knots on a grid, held or joined by lines: packets of KNTE."""

    def __init__(self, plan: Plan, bound: Bound, interpolation: Interpolation) -> None:
        self.plan, self.bound, self.interpolation = plan, bound, interpolation
        self.grid = grid_within(bound, HALF) if interpolation == "linear" else grid_within(bound)
        if self.grid.kn:
            zero = self.grid.zero
            reach = max(abs(plan.low - zero), abs(plan.high - zero))
            self.sizes, self.tops = deadband_levels(self.grid, reach)
            self.counts = zero + np.concatenate((-self.sizes[:0:-1], self.sizes))

    def pack(self, x: Counts) -> bytes:
        first, levels = self.window(x)
        lower, upper = tube_of(x, self.bound)
        if self.interpolation == "hold":
            ticks, at = fewest_hold(*places(lower, upper, levels))
            values = np.asarray(levels)[at] if self.grid.kn else levels[0] + at * self.grid.step
        else:
            ticks, values = fewest_linear(lower, upper, levels)
            at = places(values, values, levels)[0]
        y = interpolate(ticks, values[:, None], x.size, self.interpolation)[:, 0]
        y = np.clip(y, self.plan.low, self.plan.high)
        if self.bound.band.outside(x, y).any():
            raise AssertionError(BROKEN)
        return encode_knots(ticks, (at + first)[:, None], self.interpolation)

    def window(self, x: Counts) -> tuple[int, Levels]:
        """The counts of the grid that the nearest ones of x lie between, and the first's index."""
        ends = np.array([x.min(), x.max()], np.int64)
        if not self.grid.kn:
            first, last = nearest_uniform(ends, self.grid).tolist()
            step, zero = self.grid.step, self.grid.zero
            return first, range(first * step + zero, last * step + zero + 1, step)
        beside = ends - self.grid.zero
        cells = np.sign(beside) * np.searchsorted(self.tops, np.abs(beside))
        first, last = cells.tolist()
        middle = self.sizes.size - 1
        return first, self.counts[middle + first : middle + last + 1]


Way = tuple[Track, KnotWay | GridWay]
"""A track whose id is open, and how its packets are made."""


def knot_way(plan: Plan, bound: Bound, number: int, interpolation: Interpolation) -> Way:
    way = KnotWay(plan, bound, interpolation)
    parameters = CodedKnotParameters(interpolation, way.grid).build()
    track = plan.track(number, codec="KNTE", parameters=parameters, contract=plan.contract)
    return track, way


def ways_of(plan: Plan, bound: Bound, number: int, shelf: Shelf) -> list[Way]:
    """As encode() has them, but for held steps in varints, which KNTE is hardly larger than."""
    grid, step = grid_within(bound), min(bound.slack, STEP_LIMIT // 2 - 1)
    ways: list[Way] = [knot_way(plan, bound, number, "hold")]
    ends = tube_of(np.array([plan.low, plan.high], np.int64), bound)
    if max(int(np.abs(end).max()) for end in ends) <= COUNT_BOUND:
        ways.append(knot_way(plan, bound, number, "linear"))
    if grid.kn:
        ways.append(grid_way(plan, number, grid, shelf))
    ways.append(grid_way(plan, number, LpcParameters(2 * step + 1), shelf))
    return ways


class DeadbandLane:
    """A channel within its deadband, by one of several ways at a time."""

    def __init__(self, plan: Plan, bound: Bound, number: int, shelf: Shelf) -> None:
        self.plan, self.number = plan, number
        self.ways = ways_of(plan, bound, number, shelf)
        self.now = 0
        self.track = self.ways[0][0]
        self.before: Track | None = None
        self.narrow = False
        self.saved = [0.0] * len(self.ways)
        self.left, self.needed = 0, float(EVIDENCE)

    @property
    def way(self) -> GridWay | None:
        """What packs the next block together with others."""
        way = self.ways[self.now][1]
        return way if self.left and not self.narrow and isinstance(way, GridWay) else None

    def adopt(self, track: Track) -> None:
        """Goes on with a track of the file where it differs from one of the ways in its range
        alone."""
        self.before = track
        for place, (wanted, _) in enumerate(self.ways):
            if alike(track, wanted):
                self.now, self.track, self.narrow, self.left = place, track, True, AGAIN
                return

    def begin(self, values: NDArray[Any], start: int) -> None:
        """The first block decides."""
        if not self.left:
            x = counts_of_block(self.plan, values, self.number, start)
            sizes = [len(way.pack(x)) for _, way in self.ways]
            self.turn(sizes.index(min(sizes)))
            self.left = AGAIN

    def turn(self, place: int) -> None:
        """From now on by this way, in a track of its own."""
        continues = self.before.id if self.before else None
        self.now, self.narrow = place, False
        self.track = replace(self.ways[place][0], continues=continues)

    def code(self, values: NDArray[Any], start: int) -> bytes:
        x = counts_of_block(self.plan, values, self.number, start)
        if self.narrow and not fits(self.track, x):
            self.before = self.track
            self.turn(self.now)
        if self.left:
            self.left -= 1
            return self.ways[self.now][1].pack(x)
        self.left = AGAIN
        packets = [way.pack(x) for _, way in self.ways]
        return packets[self.weigh([len(packet) for packet in packets])]

    def packed(self) -> None:
        """A block was packed together with others."""
        self.left -= 1

    def weigh(self, sizes: list[int]) -> int:
        """Which packet is taken, of those that all ways made of a block."""
        now = self.now
        for place, size in enumerate(sizes):
            more = size < MUCH * sizes[now]
            evidence = self.saved[place] + (sizes[now] - size) * AGAIN
            self.saved[place] = evidence if more else self.saved[place] / 2
        best = self.saved.index(max(self.saved))
        if self.saved[best] < self.needed:
            return now
        self.needed *= 2
        self.saved = [0.0] * len(self.ways)
        self.before = self.track
        self.turn(best)
        return best
