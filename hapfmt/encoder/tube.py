"""The fewest knots whose decoded counts stay inside a tube, tick by tick: one channel, or a vector.

A deadband defines the tube: ``lower = x - tolerance``, ``upper = x + tolerance``. A decoded count
is a real line rounded to the nearest integer, halves up. So it lies in [lower, upper] where the
line lies in [lower - 1/2, upper + 1/2). Everything is computed in half counts: these bounds are odd
integers, and a knot's value is even.

Lines. All lines of one link start anywhere in an interval of values. They are swept along the tube
until it leaves the last one behind, the *extreme* line. Every path with as few links crosses it (S.
Suri, "A linear time algorithm for minimum link paths inside a simple polygon", Computer Vision,
Graphics, and Image Processing 35, 1986). So the next link is swept for all lines that cross it.
Knots are tried on whole ticks around the crossing of the line that reaches furthest. All values are
kept until the end is reached. Then one is chosen at each knot, backwards.

Where the extension is built, kernels/tube.c, links.c, sweep.c and vectors.c take the same steps.

Widths, with |count| <= 2**32 and at most 2**24 ticks: half counts stay below 2**33 + 2, their
differences below 2**34 + 4, products with ticks (2**59). At most two of these are added, which an
int64 holds.

The sweep keeps the steepest and the flattest of the lines that pass each tick so far. A tick that
cuts one of them off turns it around a point that bounded the lines before. A convex hull keeps the
points that still can: J. O'Rourke, "An on-line algorithm for fitting straight lines between data
ranges", Communications of the ACM 24, 1981. All numbers are integers.

Knots of a vector within its deadband have one clock for all axes; the norms are Euclidean.

Held vectors: a piece goes on while one point lies within the balls of all its samples. The search
moves the point to the ball that is furthest away, again and again. Where a common point exists,
this comes ever closer to it (S. Agmon, "The relaxation method for linear inequalities", Canadian
Journal of Mathematics 6, 1954, and its followers).

Lines of a vector: each axis has a tube of its own. Its half width is that of the ball over the root
of the number of axes, so that the axes are independent. A link ends where the first axis must end.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from math import isqrt, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..deadband import norm_sq
from ..errors import ParameterError
from ..kernels import compiled
from ..limits import LEVELS
from .gridded import Indices, Levels, levels_of, places
from .unit import STEP_LIMIT, Bound

Line = tuple[int, int, int, int]
"""Through (tick, half counts) with direction (ticks >= 0, half counts)."""

Point = tuple[int, int]
"""Tick and half counts."""


class Sweep(NamedTuple):
    """What the lines of one link can do.

    stop
        the first tick that none of them passes; the tube's length where there is none.
    side
        1: there the tube is below all lines; -1: above; 0: its end.
    highest, lowest
        (from tick, line): the bounds of where the lines are, at this and later ticks before the
        next entry.
    """

    stop: int
    side: int
    highest: list[tuple[int, Line]]
    lowest: list[tuple[int, Line]]


def round_at(line: Line, tick: int) -> int:
    """Half counts of a line that is not upright, rounded down."""
    x, y, dx, dy = line
    return y + dy * (tick - x) // dx


def line_at(log: list[tuple[int, Line]], tick: int) -> Line:
    """The entry that is valid at ``tick``; mostly one of the last."""
    i = len(log) - 1
    while log[i][0] > tick:
        i -= 1
    return log[i][1]


def append(hull: list[Point], tick: int, y: int) -> None:
    """Add a point to the upper side of a convex hull."""
    while len(hull) > 1:
        (x0, y0), (x1, y1) = hull[-2], hull[-1]
        if (y1 - y0) * (tick - x1) > (y - y1) * (x1 - x0):
            break
        hull.pop()
    hull.append((tick, y))


def tangent(hull: list[Point], pivot: int, tick: int, y: int, sign: int) -> int:
    """The point of a hull, from ``pivot`` on, that bounds lines through (tick, y): from the lower
    bounds the flattest (sign 1), from the upper ones the steepest (-1)."""
    while pivot + 1 < len(hull):
        (x0, y0), (x1, y1) = hull[pivot], hull[pivot + 1]
        if sign * ((y - y1) * (tick - x0) - (y - y0) * (tick - x1)) > 0:
            break
        pivot += 1
    return pivot


def sweep_lines(
    floor: list[int], ceiling: list[int], first: int, below: list[Point], above: list[Point]
) -> Sweep:
    """Lines over ``below`` and under ``above``, and inside the tube from tick ``first`` on.

    floor, ceiling
        half counts [ticks]; lines may touch the floor, and stay below the ceiling.
    below, above
        points before ``first``: a convex hull, and one point at the last tick of it. Used up.

    Each tick is put on each hull once and taken off at most once.
    """
    i = j = 0
    (hx, hy), hdx, hdy = below[0], 0, 1
    (lx, ly), ldx, ldy = above[0], 0, -1
    if hx < lx:
        i = tangent(below, 0, lx, ly, 1)
        hx, hy = below[i]
        hdx, hdy = lx - hx, ly - hy
    highest: list[tuple[int, Line]] = [(first - 1, (hx, hy, hdx, hdy))]
    lowest: list[tuple[int, Line]] = [(first - 1, (lx, ly, ldx, ldy))]
    # The last point of each hull, and its last edge; upright where that point is the pivot.
    (bx, by), bdx, bdy = below[-1], 0, 1
    (ax, ay), adx, ady = above[-1], 0, -1
    if len(below) > i + 1:
        bdx, bdy = bx - below[-2][0], by - below[-2][1]
    for t in range(first, len(floor)):
        low, high = floor[t], ceiling[t]
        rise, fall = hdy * (t - hx), ldy * (t - lx)
        if (low - hy) * hdx >= rise:
            return Sweep(t, -1, highest, lowest)
        if (high - ly) * ldx <= fall:
            return Sweep(t, 1, highest, lowest)
        if (high - hy) * hdx < rise:
            i = tangent(below, i, t, high, 1)
            hx, hy = below[i]
            hdx, hdy = t - hx, high - hy
            highest.append((t, (hx, hy, hdx, hdy)))
            if hx == bx:
                bdx, bdy = 0, 1
        if (low - ly) * ldx > fall:
            j = tangent(above, j, t, low, -1)
            lx, ly = above[j]
            ldx, ldy = t - lx, low - ly
            lowest.append((t, (lx, ly, ldx, ldy)))
            if lx == ax:
                adx, ady = 0, -1
        if bdy * (t - bx) <= (low - by) * bdx:
            below.pop()
            while len(below) > i + 1:
                (x0, y0), (bx, by) = below[-2], below[-1]
                if (by - y0) * (t - bx) > (low - by) * (bx - x0):
                    break
                below.pop()
            bx, by = below[-1]
        bdx, bdy = t - bx, low - by
        bx, by = t, low
        below.append((t, low))
        if ady * (t - ax) >= (high - ay) * adx:
            above.pop()
            while len(above) > j + 1:
                (x0, y0), (ax, ay) = above[-2], above[-1]
                if (ay - y0) * (t - ax) < (high - ay) * (ax - x0):
                    break
                above.pop()
            ax, ay = above[-1]
        adx, ady = t - ax, high - ay
        ax, ay = t, high
        above.append((t, high))
    return Sweep(len(floor), 0, highest, lowest)


COUNT_BOUND = max(level.count_bound for level in LEVELS.values())
"""No knot may lie further from 0 (LPC-003); a wider tube is cut to it."""

SPAN_BOUND = max(level.span_ticks for level in LEVELS.values())
"""Ticks of one packet."""

NO_VALUE = "a tube has a value of the grid at every tick"

TRIES = 2
"""Fewest ticks at which the next knot is tried, although the first one may reach as far as any real
line. On random and recorded tubes this gives 0.5 % more knots than needed instead of 1.4 %."""

SHORT = 16
"""Links of fewer ticks are tried at one tick more (0.3 %): where knots are dense the whole ticks
and counts matter most."""

BEFORE = 2
"""Ticks before the extreme line's last touch that are tried too: half a count above or below the
line may gain length there."""

SAMPLES = 4
"""Ticks spread over the rest, tried where those at the crossing fall short."""

SLACK = 32
"""A next link is long enough if it lacks less than this part of the longest."""

SCAN = 64
"""Where whole values allow no candidate, this many ticks before are tried one by one: a reachable
tick may have no reachable neighbour. Further back steps double, and the time stays linear."""

NARROW = 4
"""Intervals of up to this many values are verified value by value, others at their ends."""

VERIFIED = 17
"""... and as many in the middle, where at the ends a line fits no two values of its start."""


class Knot(NamedTuple):
    """A tick where a knot is possible, and the interval of its values, all of which are reached."""

    tick: int
    low: int
    high: int
    parts: tuple[tuple[int, int, Knot], ...] = ()
    """Which of them are reached from where."""


Part = tuple[int, int, Knot]
"""The least and the largest place, and the knot before."""


Way = tuple[Knot, Sweep]
"""A knot, and the lines that begin there."""


def fewest_hold(
    lower: NDArray[np.int64], upper: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Knots for held values: ticks int64 [knots], beginning with 0, and values int64 [knots].

    lower, upper
        counts, integers [ticks], lower <= upper; at least one tick.

    No choice of knots has fewer: each piece goes on as long as one value fits. It takes
    the fitting value closest to the piece before, so that differences stay small.
    """
    low_row, high_row = bounds(lower, upper)
    if compiled is not None:
        room = np.empty_like(low_row), np.empty_like(low_row)
        return _filled(compiled.fewest_hold(low_row, high_row, *room), *room)
    lows, highs = low_row.tolist(), high_row.tolist()
    ticks, pieces = [0], []
    low, high = -COUNT_BOUND, COUNT_BOUND
    for tick, (least, most) in enumerate(zip(lows, highs, strict=True)):
        if least > high or most < low:
            pieces.append((low, high))
            ticks.append(tick)
            low, high = least, most
            continue
        low = max(low, least)
        high = min(high, most)
    pieces.append((low, high))
    value = sum(pieces[min(1, len(pieces) - 1)]) // 2
    values = []
    for low, high in pieces:
        value = min(max(value, low), high)
        values.append(value)
    return np.array(ticks, dtype=np.int64), np.array(values, dtype=np.int64)


def fewest_linear(
    lower: NDArray[np.int64], upper: NDArray[np.int64], grid: Levels | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Knots for lines: ticks int64 [knots], from 0 to the last tick, and values int64 [knots].

    lower, upper
        counts, integers [ticks], lower <= upper; at least one tick.
    grid
        the values that a knot may have, one of them at least within the tube at every tick;
        without it every count.

    One knot where a constant fits. Every decoded count is inside the tube. The number of knots is
    the minimum or close to it: 0.3 % more on random and recorded tubes, against dynamic programming
    over all ticks and values. The links are as long as real lines could be. But knots are on whole
    ticks and counts, and the choice between them looks only one link ahead. A tube of no width at
    all may take many more (a ramp of one count per 100 ticks: 200 knots for 4): there only few
    ticks are reached exactly. A deadband's floor is a count or more, and leaves three.
    """
    lows, highs = bounds(lower, upper)
    if grid is None:
        grid = range(int(lows.min()), int(highs.max()) + 1)
    if len(grid) == 0:
        raise ParameterError(NO_VALUE)
    if compiled is not None:
        line = grid if isinstance(grid, range) else range(len(grid))
        levels = b"" if isinstance(grid, range) else np.ascontiguousarray(grid, np.int64)
        room = np.empty_like(lows), np.empty_like(lows)
        shape = line.start, line.step, len(line), levels
        return _filled(compiled.fewest_linear(lows, highs, *shape, *room), *room)
    tube = Tube(lows, highs, grid)
    low, high = max(tube.lows), min(tube.highs)
    if low <= high:
        middle = tube.grid[(low + high) // 2]
        return np.zeros(1, dtype=np.int64), np.array([middle], dtype=np.int64)
    knot = tube.last_knot()
    place = (knot.low + knot.high) // 2
    ticks, values = [knot.tick], [tube.grid[place]]
    while knot.parts:
        before = next(part[2] for part in knot.parts if part[0] <= place <= part[1])
        low, high = tube.origins(before, knot.tick, place)
        # The place nearest to that of the next knot: small differences are coded in few bits.
        knot, place = before, min(max(place, low), high)
        ticks.append(knot.tick)
        values.append(tube.grid[place])
    return np.array(ticks[::-1], dtype=np.int64), np.array(values[::-1], dtype=np.int64)


def bounds(
    lower: NDArray[np.int64], upper: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The tube, no wider than a knot may lie; ParameterError where it is none."""
    integers = lower.dtype.kind in "iu" and upper.dtype.kind in "iu"
    if not integers or lower.ndim != 1 or lower.shape != upper.shape:
        raise ParameterError("a tube is two rows of integer counts, equally long")
    if not 0 < lower.size <= SPAN_BOUND:
        raise ParameterError(f"a tube has 1 to {SPAN_BOUND} ticks")
    low, high = np.maximum(lower, -COUNT_BOUND), np.minimum(upper, COUNT_BOUND)
    if (low > high).any():
        raise ParameterError(f"a tube has lower <= upper, and counts of at most {COUNT_BOUND}")
    return np.ascontiguousarray(low, np.int64), np.ascontiguousarray(high, np.int64)


def _filled(
    count: int, ticks: NDArray[np.int64], values: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    if not count:
        raise ParameterError(NO_VALUE)
    return ticks[:count].copy(), values[:count].copy()


class Tube:
    """A tube in places on the grid of values, and in half counts upright and upside down."""

    def __init__(self, lower: NDArray[np.int64], upper: NDArray[np.int64], grid: Levels) -> None:
        self.grid: Sequence[int] = grid if isinstance(grid, range) else grid.tolist()
        self.size = len(lower)
        low, high = places(lower, upper, grid)
        if (low > high).any():
            raise ParameterError(NO_VALUE)
        self.lows, self.highs = low.tolist(), high.tolist()
        floor, ceiling = (2 * lower - 1).tolist(), (2 * upper + 1).tolist()
        self.upright = floor, ceiling
        self.mirrored = [-v for v in ceiling], [-v for v in floor]

    def last_knot(self) -> Knot:
        """The knot at the tube's end, and through its parts all knots before it."""
        ways = [self.way(Knot(0, self.lows[0], self.highs[0]))]
        while ways[0][0].tick < self.size - 1:
            ways = self.next_ways(ways)
        return ways[0][0]

    def way(self, knot: Knot) -> Way:
        """All lines that begin at ``knot``."""
        floor, ceiling = self.upright
        least, most = self.grid[knot.low], self.grid[knot.high]
        below, above = [(knot.tick, 2 * least)], [(knot.tick, 2 * most)]
        return knot, sweep_lines(floor, ceiling, knot.tick + 1, below, above)

    def next_ways(self, ways: list[Way]) -> list[Way]:
        """The knots that ``ways`` reach and that the next ones should start at, with their lines;
        one knot where that is the tube's end."""
        furthest, sweep = max(ways, key=lambda way: way[1].stop)
        last = sweep.stop - 1
        if not sweep.side and (end := self.meet(ways, last)):
            return [(end, sweep)]
        found: list[Way] = []
        tries = TRIES + (last - furthest.tick < SHORT)
        longest = 0
        candidates, enough = self.candidates(furthest, sweep)
        for tick in candidates:
            if knot := self.meet(ways, tick):
                found.append(self.way(knot))
                longest = max(longest, found[-1][1].stop)
                if len(found) >= tries and longest >= enough:
                    break
        return found or [self.way(self.retreat(ways, last))]

    def retreat(self, ways: list[Way], last: int) -> Knot:
        """A knot about as late as whole values allow, where none of the candidates is reached."""
        # A tick after a knot can always be reached.
        early = max(knot.tick for knot, _ in ways) + 1
        late = tick = last
        found = None
        while not found:
            step = 1 if last - late < SCAN else last - late
            late, tick = max(late - step, early), late
            found = self.meet(ways, late)
        while tick - late > 1:
            middle = (late + tick) // 2
            if knot := self.meet(ways, middle):
                late, found = middle, knot
            else:
                tick = middle
        return found

    def candidates(self, knot: Knot, sweep: Sweep) -> tuple[list[int], int]:
        """Ticks for the knot after ``knot``, best first, and the stop that satisfies."""
        last = sweep.stop - 1
        x, _, dx, _ = (sweep.lowest if sweep.side > 0 else sweep.highest)[-1][1]
        touch = min(max(x + dx, knot.tick + 1), last)
        at, stop = self.crossing(sweep, touch)
        near = at, at + 1, at - 1, at + 2, at - 2, last
        before = range(touch - 1, touch - BEFORE - 1, -1)
        spread = range(touch, last, max((last - touch) // SAMPLES, 1))
        least = max(touch - BEFORE, knot.tick + 1)
        ticks = [t for t in dict.fromkeys((*near, *before, *spread)) if least <= t <= last]
        return ticks, stop - (stop - last) // SLACK

    def crossing(self, sweep: Sweep, touch: int) -> tuple[int, int]:
        """Where the furthest of the lines crosses that cross the extreme one from tick ``touch``
        on, its last touch: the tick before that, and the tick where it stops."""
        last = sweep.stop - 1
        floor, ceiling = self.upright if sweep.side > 0 else self.mirrored
        if sweep.side > 0:
            extreme = sweep.lowest[-1][1]
        else:
            x, y, dx, dy = sweep.highest[-1][1]
            extreme = x, -y, dx, -dy
        # A line comes from above the extreme one: the ceiling does not matter before it is below.
        below: list[Point] = []
        for tick in range(touch, last + 1):
            append(below, tick, floor[tick])
        ahead = sweep_lines(floor, ceiling, last + 1, below, [(last, round_at(extreme, last) + 1)])
        line = (ahead.lowest if ahead.side > 0 else ahead.highest)[-1][1]
        low, high = touch, last
        while low < high:
            middle = (low + high + 1) // 2
            if round_at(line, middle) >= round_at(extreme, middle):
                low = middle
            else:
                high = middle - 1
        return low, ahead.stop

    def meet(self, ways: list[Way], tick: int) -> Knot | None:
        """A knot at ``tick``: the most places without a gap that lines reach."""
        parts = [
            part
            for knot, sweep in ways
            if knot.tick < tick < sweep.stop and (part := self.arrive(knot, sweep, tick))
        ]
        parts.sort(key=lambda part: part[:2])
        best: Knot | None = None
        begin = high = 0
        for i, part in enumerate(parts):
            if not i or part[0] > high + 1:
                begin, high = i, part[1]
            low, high = parts[begin][0], max(high, part[1])
            if best is None or high - low >= best.high - best.low:
                best = Knot(tick, low, high, tuple(parts[begin : i + 1]))
        return best

    def arrive(self, knot: Knot, sweep: Sweep, tick: int) -> Part | None:
        """The places at ``tick`` that those of ``knot`` reach; None where there is none."""
        low, high = self.lows[tick], self.highs[tick]
        if tick == knot.tick + 1:
            return low, high, knot
        # The lines before this tick, for its own bound is that of whole values. Steep ones touch
        # a ceiling and stay below it.
        x, y, dx, dy = line_at(sweep.highest, tick - 1)
        most = (y - 1 - (-dy * (tick - x) // dx)) // 2
        high = min(high, bisect_right(self.grid, most) - 1)
        x, y, dx, dy = line_at(sweep.lowest, tick - 1)
        least = -((-dy * (tick - x) // dx - y) // 2)
        low = max(low, bisect_left(self.grid, least))
        if low > high:
            return None
        if knot.low == knot.high:
            return low, high, knot
        return self.verified(knot, tick, low, high)

    def verified(self, knot: Knot, tick: int, low: int, high: int) -> Part | None:
        """The part of the places [low, high] that lines from places of ``knot`` reach without a
        gap.

        The pairs of real values that lines join are a convex polygon: where at ``knot`` as much
        goes with each end as its places are apart at most, one at least goes with every value in
        between.
        """
        ends: list[int] = []
        grid, apart = self.grid, self.apart(knot)
        if high - low >= NARROW:
            middle = (low + high) // 2
            for end, step in (low, 1), (high, -1):
                value, wider = end, step
                while (middle - value) * step >= 0:
                    least, most = self.origins(knot, tick, value)
                    if least <= most and grid[most] - grid[least] >= apart:
                        ends.append(value)
                        break
                    value, wider = end + wider, 2 * wider
        if len(ends) == 2:
            return ends[0], ends[1], knot
        cut = max(high - low + 1 - VERIFIED, 0) // 2
        best = run = end = 0
        for value in range(low + cut, high - cut + 1):
            least, most = self.origins(knot, tick, value)
            run = run + 1 if least <= most else 0
            if run > best:
                best, end = run, value
        return (end - best + 1, end, knot) if best else None

    def apart(self, knot: Knot) -> int:
        """The widest step between places of ``knot``, grids being finest at one place."""
        grid = self.grid
        low, high = knot.low, knot.high
        return max(grid[low + 1] - grid[low], grid[high] - grid[high - 1])

    def origins(self, knot: Knot, tick: int, place: int) -> tuple[int, int]:
        """The least and the largest place of ``knot`` from which the line to ``place`` at ``tick``
        decodes inside the tube; least > largest where there is none."""
        floor, ceiling = self.upright
        low, high = self.grid[knot.low], self.grid[knot.high]
        value = 2 * self.grid[place]
        run = rest = tick - knot.tick
        along = 0
        for t in range(knot.tick + 1, tick):
            rest -= 1
            along += value
            # With v0 the value sought, run * floor[t] <= 2 * rest * v0 + along < run * ceiling[t].
            least = -((along - run * floor[t]) // (2 * rest))
            low = least if least > low else low
            most = (run * ceiling[t] - along - 1) // (2 * rest)
            high = most if most < high else high
        return bisect_left(self.grid, low), bisect_right(self.grid, high) - 1


MOVES = 40
"""Balls that are moved to before a piece is given up (100 find 1 % fewer pieces at most)."""

AHEAD = 64
"""Ticks looked at in one go; doubled while a point holds."""

TINY = 1e-9
"""Room, relatively, for what float64 arithmetic may be off."""


def held_grid(bound: Bound) -> LpcParameters:
    """Even steps, as large as lets rounding move a point by half of the floor's radius at most:
    smaller ones cost 5 to 25 % more."""
    return LpcParameters(max(bound.step // 2, 1))


def held_vectors(rows: Indices, grid: LpcParameters, bound: Bound) -> tuple[Indices, Indices]:
    """Ticks [knots] and indices [knots, axes]; every sample within the deadband of its knot."""
    search = Pieces(rows, grid, bound)
    ticks, indices = [], []
    at = 0
    while at < len(rows):
        stop, index = search.longest(at)
        ticks.append(at)
        indices.append(index)
        at = stop
    return np.array(ticks, np.int64), np.array(indices, np.int64)


class Pieces:
    """Balls around the samples, narrower by what rounding to the grid may move a point."""

    def __init__(self, rows: Indices, grid: LpcParameters, bound: Bound) -> None:
        self.rows, self.step, self.band = rows, grid.step, bound.band
        self.points = rows.astype(np.float64)
        allowed = bound.band.allowed_sq(norm_sq(rows - np.array(bound.band.zero)))
        moved = grid.step * sqrt(rows.shape[1]) / 2
        self.radii = np.sqrt(allowed) * (1 - TINY) - moved

    def longest(self, start: int) -> tuple[int, Indices]:
        """Where the piece from ``start`` ends, and the index of its value."""
        point = self.points[start]
        stop, known = start + 1, self.nearest(point)
        ahead = AHEAD
        while stop < len(self.rows):
            end = min(stop + ahead, len(self.rows))
            beyond = self.distances(point, stop, end) > 0
            at = int(beyond.argmax())
            if not beyond[at]:
                stop, ahead = end, 2 * ahead
                continue
            moved = self.common(point, start, stop + at + 1)
            stop += at
            if moved is None:
                break
            point, stop = moved, stop + 1
        index = self.nearest(point)
        return (stop, index) if self.holds(index, start, stop) else (start + 1, known)

    def distances(self, point: NDArray[np.float64], start: int, stop: int) -> NDArray[np.float64]:
        """How far outside each ball the point is."""
        # Axis by axis: the same sum on any machine.
        square = np.zeros(stop - start)
        for axis, at in zip(self.points[start:stop].T, point.tolist(), strict=True):
            square += (axis - at) * (axis - at)
        return np.asarray(np.sqrt(square) - self.radii[start:stop])

    def common(
        self, point: NDArray[np.float64], start: int, stop: int
    ) -> NDArray[np.float64] | None:
        """A point within all balls, from ``point`` on; None where none was found."""
        for _ in range(MOVES):
            outside = self.distances(point, start, stop)
            at = int(outside.argmax())
            if outside[at] <= 0:
                return point
            centre = self.points[start + at]
            length = float(outside[at] + self.radii[start + at])
            if length <= 0:
                # Rounding to the grid may take all of the ball.
                return None
            # A little further than its border, or the border is approached without end.
            part = min(1.0, 1.05 * float(outside[at]) / length)
            point = point + (centre - point) * part
        return None

    def nearest(self, point: NDArray[np.float64]) -> Indices:
        return np.floor(point / self.step + 0.5).astype(np.int64)

    def holds(self, index: Indices, start: int, stop: int) -> bool:
        """Exactly."""
        rows = self.rows[start:stop]
        return not self.band.outside(rows, np.broadcast_to(index * self.step, rows.shape)).any()


def box_of(rows: Indices, bound: Bound) -> Indices:
    """Half width [ticks] of the largest cube within each ball, in whole counts."""
    axes = rows.shape[1]
    band = bound.band
    reference = norm_sq(rows - np.array(band.zero))
    weber = np.sqrt(reference / axes) * (band.kn / band.kd) * (1 - TINY) - TINY
    whole = np.minimum(np.floor(weber), COUNT_BOUND).astype(np.int64)
    return np.asarray(np.maximum(whole, isqrt(bound.slack**2 // axes)))


def joined_grid(bound: Bound) -> LpcParameters:
    """Even steps, as wide as the cube of the floor: half of that costs 0 to 20 % more."""
    inner = isqrt(bound.slack**2 // len(bound.band.zero))
    return LpcParameters(2 * min(inner, STEP_LIMIT // 2 - 1) + 1)


class Front(NamedTuple):
    """The knot of each axis at one tick, and the lines that begin there."""

    ways: tuple[Way, ...]

    @property
    def tick(self) -> int:
        return self.ways[0][0].tick

    @property
    def stop(self) -> int:
        """The first tick that the lines of one axis cannot pass."""
        return min(sweep.stop for _, sweep in self.ways)


def joined_vectors(rows: Indices, grid: LpcParameters, bound: Bound) -> tuple[Indices, Indices]:
    """Ticks [knots] and indices [knots, axes], joined by lines; the last tick is that of rows."""
    width = box_of(rows, bound)
    shapes = [levels_of(x, grid) for x in rows.T]
    ticks, at = joined_places(
        [bounds(x - width, x + width) for x in rows.T], [levels for _, levels in shapes]
    )
    return ticks, at + np.array([first for first, _ in shapes])


def joined_places(
    axes: Sequence[tuple[Indices, Indices]], grids: Sequence[Levels]
) -> tuple[Indices, Indices]:
    """Ticks [knots] and places [knots, axes] on even grids, within the tubes (lower, upper)."""
    shared = [
        places(lower.max(keepdims=True), upper.min(keepdims=True), grid)
        for (lower, upper), grid in zip(axes, grids, strict=True)
    ]
    if all(low[0] <= high[0] for low, high in shared):
        row = [int(low[0] + high[0]) // 2 for low, high in shared]
        return np.zeros(1, np.int64), np.array([row], np.int64)
    if compiled is not None and all(isinstance(grid, range) for grid in grids):
        lower, upper = (np.array(side) for side in zip(*axes, strict=True))
        shape = [(grid.start, grid.step, len(grid)) for grid in grids if isinstance(grid, range)]
        ticks, at = np.empty(lower.shape[1], np.int64), np.empty(lower.shape[::-1], np.int64)
        count = compiled.fewest_joined(lower, upper, np.array(shape, np.int64), ticks, at)
        if not count:
            raise ParameterError(NO_VALUE)
        return ticks[-count:].copy(), at[-count:].copy()
    tubes = [Tube(*sides, grid) for sides, grid in zip(axes, grids, strict=True)]
    knots = last_front(tubes)
    clock = [knots[0].tick]
    found = [[(knot.low + knot.high) // 2 for knot in knots]]
    while knots[0].parts:
        row = []
        for tube, knot, place in zip(tubes, knots, found[-1], strict=True):
            low, high = tube.origins(knot.parts[0][2], knot.tick, place)
            row.append(min(max(place, low), high))
        knots = [knot.parts[0][2] for knot in knots]
        clock.append(knots[0].tick)
        found.append(row)
    return np.array(clock[::-1], np.int64), np.array(found[::-1], np.int64)


def last_front(tubes: list[Tube]) -> list[Knot]:
    """The knots at the tubes' end, and through their parts all knots before them."""
    size = tubes[0].size
    front = Front(tuple(tube.way(Knot(0, tube.lows[0], tube.highs[0])) for tube in tubes))
    while True:
        if front.stop >= size and (knots := meet(tubes, front, size - 1)):
            return knots
        found: list[Front] = []
        for tick in candidates(tubes, front):
            if knots := meet(tubes, front, tick):
                ways = [tube.way(knot) for tube, knot in zip(tubes, knots, strict=True)]
                found.append(Front(tuple(ways)))
                if len(found) > TRIES + (tick - front.tick < SHORT):
                    break
        front = max(found, key=lambda each: (each.stop, each.tick))


def candidates(tubes: list[Tube], front: Front) -> list[int]:
    """Ticks for the next knots, best first; the last of them can always be reached."""
    last = front.stop - 1
    slow = min(range(len(tubes)), key=lambda i: front.ways[i][1].stop)
    knot, sweep = front.ways[slow]
    ticks = tubes[slow].candidates(knot, sweep)[0] if sweep.side else []
    near = [min(tick, last) for tick in ticks]
    back = range(last, front.tick, -max((last - front.tick) // SLACK, 1))
    return list(dict.fromkeys((*near, *back, front.tick + 1)))


def meet(tubes: list[Tube], front: Front, tick: int) -> list[Knot] | None:
    """The knots of all axes at ``tick``; None where one of them has none."""
    knots = []
    for tube, (knot, sweep) in zip(tubes, front.ways, strict=True):
        if not knot.tick < tick < sweep.stop or (part := tube.arrive(knot, sweep, tick)) is None:
            return None
        knots.append(Knot(tick, part[0], part[1], (part,)))
    return knots
