"""Channels within a deadband, block by block: knots, or prediction on a grid, whichever is smaller.

Every way keeps the deadband by construction. The first block decides; where another way would have
been much smaller for long, a track of that one continues the channel, and each time it takes more
to do so again: descriptions stay few.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..codecs.knots import INTERPOLATIONS, Interpolation, KnotParameters
from ..container.track import Track
from .grids import grid_within
from .live_counts import Way, alike, counts_of_block, fits, grid_way
from .live_many import Shelf, Task
from .live_plan import Plan
from .tube import COUNT_BOUND
from .tubed import HALF, tube_of
from .unit import STEP_LIMIT, Bound

FIRST, AGAIN = 2, 16
"""After so many packets all ways are tried once more; each time twice as many, up to the last."""

TELLING, DESCRIPTION = 16, 150.0
"""Samples that tell one way from another, and about the bytes of a description."""

MUCH = 0.93
"""Another way takes over when it would have saved more than its description takes, with packets
smaller than this part of the others; each time twice as much is asked for."""


Coded = tuple[Track, Way]
"""A track whose id is open, and how its packets are made."""


def knot_way(
    plan: Plan, bound: Bound, number: int, interpolation: Interpolation, shelf: Shelf
) -> Coded | None:
    """Knots with entropy coding; None where the deadband, and with it knots, may reach beyond the
    largest count."""
    grid = grid_within(bound, HALF if interpolation == "linear" else Fraction(1))
    ends = tube_of(np.array([plan.low, plan.high], np.int64), bound)
    if max(int(np.abs(end - grid.zero).max()) for end in ends) > COUNT_BOUND:
        return None
    parameters = KnotParameters(interpolation, grid, coded=True).build()
    track = plan.track(number, codec="KNOT", parameters=parameters, contract=plan.contract)
    task = Task(plan.low, plan.high, grid, bound.band, interpolation, bound.slack)
    return track, Way(task, shelf)


def ways_of(plan: Plan, bound: Bound, number: int, shelf: Shelf) -> list[Coded]:
    """As encode() has them, but for held steps in varints: entropy coding is hardly larger."""
    grid, step = grid_within(bound), min(bound.slack, STEP_LIMIT // 2 - 1)
    knots = [knot_way(plan, bound, number, joined, shelf) for joined in INTERPOLATIONS]
    ways = [way for way in knots if way is not None]
    if grid.kn:
        ways.append(grid_way(plan, number, grid, shelf))
    ways.append(grid_way(plan, number, LpcParameters(2 * step + 1), shelf))
    return ways


class DeadbandLane:
    """A channel within its deadband, by one of several ways at a time."""

    def __init__(self, plan: Plan, bound: Bound, number: int, shelf: Shelf) -> None:
        self.plan, self.number = plan, number
        self.coded = ways_of(plan, bound, number, shelf)
        self.now = 0
        self.track = self.coded[0][0]
        self.before: Track | None = None
        self.narrow = self.decided = False
        self.saved = [0.0] * len(self.coded)
        self.left, self.wait, self.needed = 0, FIRST, DESCRIPTION

    @property
    def ways(self) -> Sequence[Way]:
        """What packs the next block together with others: all, after a while."""
        if self.narrow:
            return ()
        return [way for _, way in self.coded[self.now : self.now + 1] if self.left] or [
            way for _, way in self.coded
        ]

    def adopt(self, track: Track) -> None:
        """Goes on with a track of the file where it differs from one of the ways in its range
        alone."""
        self.before = track
        for place, (wanted, _) in enumerate(self.coded):
            if alike(track, wanted):
                self.now, self.track, self.left = place, track, self.wait
                self.narrow = self.decided = True
                return

    def begin(self, values: NDArray[Any], start: int) -> None:
        """The first block decides; where it tells nothing, the next one may, at the price of a
        description."""
        if self.decided:
            return
        self.decided = True
        if values.size < TELLING:
            self.turn(min(1, len(self.coded) - 1))
            return
        x = counts_of_block(self.plan, values, self.number, start)
        sizes = [len(way.pack(x)) for _, way in self.coded]
        self.turn(sizes.index(min(sizes)))
        self.left = self.wait

    def turn(self, place: int) -> None:
        """From now on by this way, in a track of its own."""
        continues = self.before.id if self.before else None
        self.now, self.narrow = place, False
        self.track = replace(self.coded[place][0], continues=continues)

    def take(self, packets: Sequence[bytes]) -> bytes:
        if self.left:
            self.left -= 1
            return packets[0]
        self.left = self.wait
        self.wait = min(2 * self.wait, AGAIN)
        return packets[self.weigh([len(packet) for packet in packets])]

    def code(self, values: NDArray[Any], start: int) -> bytes:
        x = counts_of_block(self.plan, values, self.number, start)
        if self.narrow and not fits(self.track, x):
            self.before = self.track
            self.turn(self.now)
        ways = self.ways or [self.coded[self.now][1]]
        return self.take([way.pack(x) for way in ways])

    def weigh(self, sizes: list[int]) -> int:
        """Which packet is taken, of those that all ways made of a block."""
        now = self.now
        for place, size in enumerate(sizes):
            more = size < MUCH * sizes[now]
            evidence = self.saved[place] + (sizes[now] - size) * self.left
            self.saved[place] = evidence if more else self.saved[place] / 2
        best = self.saved.index(max(self.saved))
        if self.saved[best] < self.needed:
            return now
        self.needed *= 2
        self.saved = [0.0] * len(self.coded)
        self.before = self.track
        self.turn(best)
        return best
