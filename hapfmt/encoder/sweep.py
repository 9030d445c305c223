"""All lines through a stretch of an integer tube at once: the kernel of tube.py.

Of the lines that pass each tick so far the steepest and the flattest are kept. A tick that cuts one
of them off turns it around a point that has bounded the lines before, and those that still can are
kept on a convex hull: J. O'Rourke, "An on-line algorithm for fitting straight lines between data
ranges", Communications of the ACM 24, 1981. Integers only; widths in tube.py.
"""

from __future__ import annotations

from typing import NamedTuple

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
