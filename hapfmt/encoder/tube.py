"""The fewest knots whose decoded counts stay inside an integer tube, tick by tick.

The tube is what a deadband leaves: ``lower = x - tolerance``, ``upper = x + tolerance``. A decoded
count is a real line rounded to the nearest integer, halves up, so it lies in [lower, upper] where
the line lies in [lower - 1/2, upper + 1/2). Everything is computed in half counts, in which these
bounds are odd integers and a knot's value is even.

Lines. One link starts anywhere in an interval of values. The steepest and the flattest line that
pass all ticks so far are kept as the tube goes on, each on a convex hull (J. O'Rourke, "An on-line
algorithm for fitting straight lines between data ranges", Communications of the ACM 24, 1981),
until the tube leaves both behind. The last line to be left is the *extreme* one: every path with
as few links crosses it (S. Suri, "A linear time algorithm for minimum link paths inside a simple
polygon", Computer Vision, Graphics, and Image Processing 35, 1986). So the next link is swept for
all lines that cross it, and the knot is set where the furthest of them does.

Widths, with \\|count\\| <= 2**32 and ticks <= 2**24: half counts 2**33 + 1, differences of two of them
2**34 + 2, times ticks 2**58, and no more than two such products are added: int64 is enough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import ParameterError
from ..limits import LEVELS

COUNT_BOUND = max(level.count_bound for level in LEVELS.values())
"""No knot may lie further from 0 (KNT-004); a wider tube is cut to it."""

SPAN_BOUND = max(level.span_ticks for level in LEVELS.values())
"""Ticks of one packet."""

FEW = 6
"""So many candidate ticks for a knot are all tried; of more, those where the extreme lines cross.
Short links are where whole ticks matter (measured on random tubes: 3 % too many knots without)."""

NEAR = 1
BEFORE = 2
SAMPLES = 4
SHORT = 0
KEEP = 2
NARROW = 4
SLACK = 64
"""..."""

VERIFIED = 17
"""Values tried one by one where the pairs of values that a line may join are few and scattered."""

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


class Knot(NamedTuple):
    """A tick where a knot may stand, and the interval of its values, all of which are reached."""

    tick: int
    low: int
    high: int
    parts: tuple[tuple[int, int, Knot], ...] = ()
    """(low, high, the knot before) in order: which of the values are reached from where."""


Way = tuple[Knot, Sweep]


def fewest_hold(
    lower: NDArray[np.int64], upper: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Knots for held values: ticks int64 [knots], beginning with 0, and values int64 [knots].

    lower, upper
        counts, integers [ticks], lower <= upper; at least one tick.

    No choice of knots has fewer: each piece goes on as long as one value fits. Of the values that
    fit the one closest to the piece before is taken, and differences stay small.
    """
    lows, highs = _bounds(lower, upper)
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
    lower: NDArray[np.int64], upper: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Knots for lines: ticks int64 [knots], from 0 to the last tick, and values int64 [knots].

    lower, upper
        counts, integers [ticks], lower <= upper; at least one tick.

    One knot where a constant fits. Every decoded count is inside the tube. The number of knots is
    the minimum or close to it: the links are as long as real lines could be, but knots stand on
    whole ticks and counts, and which of them is best is seen one link ahead only.
    """
    lows, highs = _bounds(lower, upper)
    low, high = max(lows), min(highs)
    if low <= high:
        return np.zeros(1, dtype=np.int64), np.array([(low + high) // 2], dtype=np.int64)
    tube = _Tube(lows, highs)
    knot = tube.last_knot()
    value = (knot.low + knot.high) // 2
    ticks, values = [knot.tick], [value]
    while knot.parts:
        before = next(part[2] for part in knot.parts if part[0] <= value <= part[1])
        low, high = tube.origins(before, knot.tick, value)
        knot, value = before, (low + high) // 2
        ticks.append(knot.tick)
        values.append(value)
    return np.array(ticks[::-1], dtype=np.int64), np.array(values[::-1], dtype=np.int64)


def _bounds(lower: NDArray[np.int64], upper: NDArray[np.int64]) -> tuple[list[int], list[int]]:
    if lower.ndim != 1 or lower.shape != upper.shape or not 0 < lower.size <= SPAN_BOUND:
        raise ParameterError(f"a tube is two rows of 1 to {SPAN_BOUND} counts")
    low, high = np.maximum(lower, -COUNT_BOUND), np.minimum(upper, COUNT_BOUND)
    if (low > high).any():
        raise ParameterError(f"a tube has lower <= upper, and counts of at most {COUNT_BOUND}")
    return low.tolist(), high.tolist()


def _at(line: Line, tick: int) -> int:
    """Half counts of a line that is not upright, rounded down."""
    x, y, dx, dy = line
    return y + dy * (tick - x) // dx


def _line_at(log: list[tuple[int, Line]], tick: int) -> Line:
    """The entry that is valid at ``tick``; mostly one of the last."""
    i = len(log) - 1
    while log[i][0] > tick:
        i -= 1
    return log[i][1]


class _Tube:
    """A tube in counts, and in half counts upright and upside down."""

    def __init__(self, lows: list[int], highs: list[int]) -> None:
        self.lows, self.highs, self.size = lows, highs, len(lows)
        floor, ceiling = [2 * v - 1 for v in lows], [2 * v + 1 for v in highs]
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
        below, above = [(knot.tick, 2 * knot.low)], [(knot.tick, 2 * knot.high)]
        return knot, _sweep(floor, ceiling, knot.tick + 1, below, above)

    def next_ways(self, ways: list[Way]) -> list[Way]:
        """The knots that ``ways`` reach and that the next ones should start at, with their lines;
        one knot where that is the tube's end."""
        furthest, sweep = max(ways, key=lambda way: way[1].stop)
        last = sweep.stop - 1
        if not sweep.side:
            end = self.meet(ways, last)
            if end:
                return [(end, sweep)]
        first = max(furthest.tick + 1, min(self.touch(sweep), last))
        early = max(furthest.tick + 1, first - BEFORE)
        goal = self.size
        goal, at = self.crossing(sweep, first)
        goal -= (goal - last) // SLACK
        step = max((last - first) // SAMPLES, 1)
        order = [
            at,
            at + 1,
            at - 1,
            at + 2,
            at - 2,
            last,
            *range(first - 1, early - 1, -1),
            *range(first, last, step),
        ]
        order = [t for t in dict.fromkeys(order) if early <= t <= last]
        found = []
        for tick in order:
            knot = self.meet(ways, tick)
            if knot:
                found.append(self.way(knot))
                if (
                    len(found) >= (KEEP if last - furthest.tick >= SHORT else KEEP + 1)
                    and max(w[1].stop for w in found) >= goal
                ):
                    break
        tick = early
        while not found:
            tick -= 1
            knot = self.meet(ways, tick)
            found = [self.way(knot)] if knot else []
        return found

    def meet(self, ways: list[Way], tick: int) -> Knot | None:
        """A knot at ``tick``: the most values without a gap that lines reach."""
        parts = [
            part
            for knot, sweep in ways
            if knot.tick < tick < sweep.stop and (part := self.arrive(knot, sweep, tick))
        ]
        parts.sort(key=lambda part: part[0])
        best: Knot | None = None
        begin = 0
        high = 0
        for i, part in enumerate(parts):
            if i and part[0] > high + 1:
                begin = i
            high = part[1] if i == begin else max(high, part[1])
            low = parts[begin][0]
            if best is None or high - low > best.high - best.low:
                best = Knot(tick, low, high, tuple(parts[begin : i + 1]))
        return best

    def touch(self, sweep: Sweep) -> int:
        """Where the extreme line touches the tube last."""
        x, _, dx, _ = (sweep.lowest if sweep.side > 0 else sweep.highest)[-1][1]
        return x + dx

    def crossing(self, sweep: Sweep, first: int) -> tuple[int, int]:
        """How far a line gets that crosses the extreme one at or after ``first``, and where the
        furthest does: the last tick before it."""
        last = sweep.stop - 1
        floor, ceiling = self.upright if sweep.side > 0 else self.mirrored
        if sweep.side > 0:
            extreme = sweep.lowest[-1][1]
        else:
            x, y, dx, dy = sweep.highest[-1][1]
            extreme = x, -y, dx, -dy
        below: list[Point] = []
        for tick in range(first, last + 1):
            _append(below, 0, tick, floor[tick])
        ahead = _sweep(floor, ceiling, last + 1, below, [(last, _at(extreme, last) + 1)])
        line = (ahead.lowest if ahead.side > 0 else ahead.highest)[-1][1]
        if not line[2]:
            line = ahead.highest[-1][1]
        low, high = first, last
        while low < high:
            middle = (low + high + 1) // 2
            if _at(line, middle) >= _at(extreme, middle):
                low = middle
            else:
                high = middle - 1
        return ahead.stop, low

    def arrive(self, knot: Knot, sweep: Sweep, tick: int) -> tuple[int, int, Knot] | None:
        """The values at ``tick`` that whole values of ``knot`` reach; None where there is none."""
        low, high = self.lows[tick], self.highs[tick]
        if tick == knot.tick + 1:
            return low, high, knot
        # Before this tick only, for its own bound is that of whole values.
        x, y, dx, dy = _line_at(sweep.highest, tick - 1)
        high = min(high, (y - 1 - (-dy * (tick - x) // dx)) // 2)
        x, y, dx, dy = _line_at(sweep.lowest, tick - 1)
        low = max(low, -((-dy * (tick - x) // dx - y) // 2))
        if knot.low == knot.high:
            return (low, high, knot) if low <= high else None
        if low > high:
            return None
        # Where lines start at two whole values or more at both ends they start at one at least in
        # between, for the pairs of values are convex.
        middle = (low + high) // 2
        ends: list[int] = []
        for end, step in ((low, 1), (high, -1)) if high - low >= NARROW else ():
            value = end
            while (middle - value) * step >= 0:
                a, b = self.origins(knot, tick, value)
                if b > a:
                    ends.append(value)
                    break
                value = end + step
                step *= 2
            if not ends:
                break
        if len(ends) == 2:
            return ends[0], ends[1], knot
        cut = max(high - low - VERIFIED, 0) // 2
        best = run = end = 0
        for value in range(low + cut, high - cut + 1):
            a, b = self.origins(knot, tick, value)
            run = run + 1 if a <= b else 0
            if run > best:
                best, end = run, value
        return (end - best + 1, end, knot) if best else None

    def origins(self, knot: Knot, tick: int, value: int) -> tuple[int, int]:
        """The least and the largest value of ``knot`` from which the line to ``value`` at
        ``tick`` decodes inside the tube; least > largest where there is none."""
        floor, ceiling = self.upright
        run, low, high = tick - knot.tick, knot.low, knot.high
        rest = run
        along = 0
        for t in range(knot.tick + 1, tick):
            rest -= 1
            along += 2 * value
            # 2 * (v0 * rest + value * (run - rest)) >= run * floor, and < run * ceiling
            least = -((along - run * floor[t]) // (2 * rest))
            low = least if least > low else low
            most = (run * ceiling[t] - along - 1) // (2 * rest)
            high = most if most < high else high
        return low, high


def _append(hull: list[Point], pivot: int, tick: int, y: int) -> None:
    """Add a point to the upper side of a hull that nobody needs before ``pivot``."""
    while len(hull) > pivot + 1:
        (x0, y0), (x1, y1) = hull[-2], hull[-1]
        if (y1 - y0) * (tick - x1) > (y - y1) * (x1 - x0):
            break
        hull.pop()
    hull.append((tick, y))


def _tangent(hull: list[Point], pivot: int, tick: int, y: int, sign: int) -> int:
    """The point of a hull, from ``pivot`` on, that bounds lines through (tick, y): from the lower
    bounds the flattest (sign 1), from the upper ones the steepest (-1)."""
    while pivot + 1 < len(hull):
        (x0, y0), (x1, y1) = hull[pivot], hull[pivot + 1]
        if sign * ((y - y1) * (tick - x0) - (y - y0) * (tick - x1)) > 0:
            break
        pivot += 1
    return pivot


def _sweep(
    floor: list[int], ceiling: list[int], first: int, below: list[Point], above: list[Point]
) -> Sweep:
    """Lines over ``below`` and under ``above``, and inside the tube from tick ``first`` on.

    floor, ceiling in half counts. ``below`` is convex; ``above`` is one point, at its last tick.
    Each tick is put on each hull once and taken off at most once.
    """
    i = j = 0
    (lx, ly), ldx, ldy = above[0], 0, -1
    (hx, hy), hdx, hdy = below[0], 0, 1
    if hx < lx:
        i = _tangent(below, 0, lx, ly, 1)
        hx, hy = below[i]
        hdx, hdy = lx - hx, ly - hy
    highest: list[tuple[int, Line]] = [(first - 1, (hx, hy, hdx, hdy))]
    lowest: list[tuple[int, Line]] = [(first - 1, (lx, ly, ldx, ldy))]
    size = len(floor)
    for t in range(first, size):
        low, high = floor[t], ceiling[t]
        rise, fall = hdy * (t - hx), ldy * (t - lx)
        if (low - hy) * hdx >= rise:
            return Sweep(t, -1, highest, lowest)
        if (high - ly) * ldx <= fall:
            return Sweep(t, 1, highest, lowest)
        if (high - hy) * hdx < rise:
            i = _tangent(below, i, t, high, 1)
            hx, hy = below[i]
            hdx, hdy = t - hx, high - hy
            highest.append((t, (hx, hy, hdx, hdy)))
        if (low - ly) * ldx > fall:
            j = _tangent(above, j, t, low, -1)
            lx, ly = above[j]
            ldx, ldy = t - lx, low - ly
            lowest.append((t, (lx, ly, ldx, ldy)))
        while len(below) > i + 1:
            (x0, y0), (x1, y1) = below[-2], below[-1]
            if (y1 - y0) * (t - x1) > (low - y1) * (x1 - x0):
                break
            below.pop()
        below.append((t, low))
        while len(above) > j + 1:
            (x0, y0), (x1, y1) = above[-2], above[-1]
            if (y1 - y0) * (t - x1) < (high - y1) * (x1 - x0):
                break
            above.pop()
        above.append((t, high))
    return Sweep(size, 0, highest, lowest)
