"""Knots within the deadband, and the grids of their values.

A coarse grid costs few bits a value and a few knots more. Cells of half the deadband were best for
lines: single counts take 8 to 15 % more on recorded forces and positions. Cells of the whole
deadband were best for held levels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np

from ..codecs.grids import LpcParameters
from ..codecs.knots import KnotParameters, encode_knots
from ..deadband import Deadband
from ..format.track import Track
from .gridded import Indices, grid_within, levels_of, places
from .knots import Coded, fill_below, plain_knots, select_knots
from .source import InputBlock
from .tube import COUNT_BOUND, fewest_hold, fewest_linear
from .unit import Bound, code_steps
from .vectors import held_grid, held_vectors, joined_grid, joined_vectors

Way = tuple[str, Callable[[Track, int | None], Coded | None]]
"""Why it is smaller, and how to code; given the smallest size so far, None where it will not be."""

HALF = Fraction(1, 2)


def tolerances(x: Indices, bound: Bound) -> Indices:
    """Largest error of each count that keeps the deadband, the slack being the floor."""
    weber = np.abs(x - bound.band.zero[0]) * bound.band.kn // bound.band.kd
    return np.asarray(np.maximum(weber, bound.slack))


def tube_of(x: Indices, bound: Bound) -> tuple[Indices, Indices]:
    width = tolerances(x, bound)
    return x - width, x + width


def fewest_held(x: Indices, grid: LpcParameters, bound: Bound) -> tuple[Indices, Indices]:
    """Knots of indices that change as rarely as they can."""
    first, levels = levels_of(x, grid)
    ticks, at = fewest_hold(*places(*tube_of(x, bound), levels))
    return ticks, at + first


def fewest_joined(x: Indices, grid: LpcParameters, bound: Bound) -> tuple[Indices, Indices]:
    """Knots of indices, joined by as few lines as can be."""
    first, levels = levels_of(x, grid)
    ticks, values = fewest_linear(*tube_of(x, bound), levels)
    return ticks, places(values, values, levels)[0] + first


def code_held_levels(
    source: InputBlock, base: Track, bound: Bound, smallest: int | None
) -> Coded | None:
    grid = grid_within(bound)
    parameters = KnotParameters("hold", grid, coded=True)
    return code_with(
        source, base, parameters, lambda x: column(fewest_held(x[:, 0], grid, bound)), smallest
    )


def code_lines(source: InputBlock, base: Track, bound: Bound, smallest: int | None) -> Coded | None:
    """None also where the deadband reaches beyond the largest count, and with it the grid may."""
    ends = np.array([source.counts.min(), source.counts.max()], np.int64)
    if max(np.abs(end).max() for end in tube_of(ends, bound)) > COUNT_BOUND:
        return None
    grid = grid_within(bound, HALF)
    parameters = KnotParameters("linear", grid, coded=True)
    return code_with(
        source, base, parameters, lambda x: column(fewest_joined(x[:, 0], grid, bound)), smallest
    )


def column(knots: tuple[Indices, Indices]) -> tuple[Indices, Indices]:
    return knots[0], knots[1][:, None]


def code_with(
    source: InputBlock,
    base: Track,
    parameters: KnotParameters,
    find: Callable[[Indices], tuple[Indices, Indices]],
    smallest: int | None,
) -> Coded | None:
    """Packets with entropy coding; ``find`` gives ticks [knots] and indices [knots, components].
    None as soon as they are not below ``smallest``."""
    coded = Coded(replace(base, codec="KNOT", parameters=parameters.build()))
    found = ((span, *find(rows)) for span, rows in source.pieces(source.counts))
    packets = (
        (span, encode_knots(ticks, indices, parameters.interpolation))
        for span, ticks, indices in found
    )
    return fill_below(coded, packets, smallest)


def code_held(source: InputBlock, base: Track, bound: Bound) -> Coded:
    """Packets of one channel in varints: where there are few knots, these are as short."""

    def find(rows: Indices) -> tuple[Indices, Indices]:
        return column(fewest_hold(*tube_of(rows[:, 0], bound)))

    return code_plain(source, base, find)


def vector_ways(source: InputBlock, bound: Bound) -> list[Way]:
    def held(base: Track, _: int | None) -> Coded:
        if not bound.slack:
            # A floor below one count allows no error at all.
            return code_steps(source, bound, base)
        return code_plain(source, base, lambda rows: vector_steps(rows, bound.band))

    ways: list[Way] = [("held steps of the vector", held)]
    if bound.slack:
        ways += [
            (
                "fewest held points",
                lambda base, smallest: code_points(source, base, bound, smallest),
            ),
            (
                "fewest lines of the vector",
                lambda base, smallest: code_joined(source, base, bound, smallest),
            ),
        ]
    return ways


def code_points(
    source: InputBlock, base: Track, bound: Bound, smallest: int | None
) -> Coded | None:
    grid = held_grid(bound)
    parameters = KnotParameters("hold", grid, coded=True)
    return code_with(
        source, base, parameters, lambda rows: held_vectors(rows, grid, bound), smallest
    )


def code_joined(
    source: InputBlock, base: Track, bound: Bound, smallest: int | None
) -> Coded | None:
    grid = joined_grid(bound)
    parameters = KnotParameters("linear", grid, coded=True)
    return code_with(
        source, base, parameters, lambda rows: joined_vectors(rows, grid, bound), smallest
    )


def vector_steps(rows: Indices, band: Deadband) -> tuple[Indices, Indices]:
    ticks = select_knots(rows, band, reference="sample", keep_last=False)
    return ticks, rows[ticks]


def code_plain(
    source: InputBlock, base: Track, find: Callable[[Indices], tuple[Indices, Indices]]
) -> Coded:
    """Packets in varints, held."""
    return plain_knots(
        base, "hold", 1, ((span, *find(rows)) for span, rows in source.pieces(source.counts))
    )
