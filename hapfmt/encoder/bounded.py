"""Channels that keep a bound on every sample, by construction; lossless is the bound 0.

A uniform grid keeps the bound, and so do knots inside the tube of the deadband. The encoder takes
the smaller of the two for each track.

A coarse grid of knots costs few bits a value and a few knots more. Cells of half the deadband were
best for lines: single counts take 8 to 15 % more on recorded forces and positions. Cells of the
whole deadband were best for held levels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..codecs.knots import KnotParameters, encode_knots
from ..deadband import Deadband
from ..format.track import Contract, Track
from ..recording import Channel, Span
from .effort import EFFORTS, Effort
from .gridded import Indices, grid_within, levels_of, nearest_level, nearest_uniform, places
from .knots import Coded, fill_below, plain_knots, select_knots
from .plan import Promise, without_glitches
from .predict import encode_best, fitting_packets, quick_estimate
from .settings import counts_of
from .source import InputBlock
from .tube import (
    COUNT_BOUND,
    fewest_hold,
    fewest_linear,
    held_grid,
    held_vectors,
    joined_grid,
    joined_vectors,
)
from .unit import STEP_LIMIT, Bound, Unit, bound_of, code_steps

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


HOPE = 0.5
"""Skip coding when this share of the quick estimate already exceeds the best size. LPCR packets
take 0.46 to 1.5 times the bits of their quick estimate. Packets that won never fell below 0.72
(measured; from 0 to 0.7 no recording changed by a byte)."""


KNOT_WAYS = 3
"""The first of :func:`scalar_ways`."""


def encode_lossless(source: InputBlock, base: Track, effort: Effort | None = None) -> Unit:
    coded = code_grid(source, base, LpcParameters(), nearest_uniform, effort=effort)
    assert coded
    return Unit(coded, None, "predicted", "lossless", exact=True)


def error_of(channel: Channel, promise: Promise) -> int:
    """Counts that each sample may be off, whatever its value; 0 where every count is kept."""
    calibration = channel.calibration
    if promise.floor is None or calibration is None or not channel.stored.size:
        return 0
    calm = without_glitches(channel.stored)
    extent = int(calm.max()) - int(calm.min())
    allowed = counts_of(promise.floor, calibration, extent, channel.unit)
    if channel.deviation is not None:
        allowed -= Fraction(channel.deviation.largest) / abs(calibration.step)
    return min(max(int(allowed), 0), STEP_LIMIT // 2 - 1)


def encode_bounded(
    source: InputBlock,
    base: Track,
    promise: Promise,
    smallest: int | None = None,
    *,
    knots_alone: bool = False,
    effort: Effort | None = None,
) -> Unit | None:
    """Each sample within max(k * |x|, floor): the smallest of grids and knots, or of ``knots
    alone``; None where none of them is below ``smallest`` bytes."""
    bound = bound_of(source, promise)
    if len(source.channels) == 1 and not bound.slack and not promise.k:
        return encode_lossless(source, base, effort)
    if len(source.channels) > 1:
        ways = vector_ways(source, bound)
    elif effort and effort.every_form:
        ways = scalar_ways(source, bound, effort)[: KNOT_WAYS if knots_alone else None]
    else:
        ways = likely_ways(source, base, bound, knots_alone=knots_alone)
    best: tuple[Coded, str] | None = None
    for why, code in ways:
        if (coded := code(base, smallest)) and (smallest is None or coded.size < smallest):
            best, smallest = (coded, why), coded.size
    if best is None:
        return None
    coded, why = best
    coded.track = replace(coded.track, contract=contract_for(bound.band))
    chosen = "predicted" if coded.track.codec == "LPCR" else "knots"
    return Unit(coded, None, chosen, why)


def contract_for(band: Deadband) -> Contract:
    """Kept by construction, and checked again before the file is written."""
    return Contract(band.kn, band.kd, band.vector, True, band.floor, band.zero)


def scalar_ways(source: InputBlock, bound: Bound, effort: Effort | None = None) -> list[Way]:
    """The ways to code one channel; quick ones come first."""
    even, grid = even_grid(bound), grid_within(bound)
    ways: list[Way] = [
        ("fewest held steps", lambda base, _: code_held(source, base, bound)),
        (LEVELS, lambda base, smallest: code_held_levels(source, base, bound, smallest)),
        (LINES, lambda base, smallest: code_lines(source, base, bound, smallest)),
    ]
    if grid.kn:
        growing = "each sample from those before, in steps that grow with the value"
        ways.append((growing, lambda base, smallest: code_grid(
            source, base, grid, nearest_level, smallest, effort=effort)))  # fmt: skip
    ways.append(("each sample from those before, in equal steps", lambda base, smallest: code_grid(
        source, base, even, nearest_uniform, smallest, effort=effort)))  # fmt: skip
    return ways


SAMPLED, WINDOWS = 8, 8
"""One sample of SAMPLED is looked at, in as many WINDOWS, to compare ways."""

SLICE = 1 << 15
"""Samples that are looked at together."""

LEAST = 16
"""Held pieces of a window; channels that have fewer are looked at as a whole."""

LEVELS, LINES = "fewest held levels", "fewest lines"
JOINS, GRID_JOINS = {LEVELS: 0, LINES: 4}, 3
"""Bytes that a stretch more takes than the same samples in a whole channel."""

NEAR, NEAR_GRID = {LEVELS: 1.06, LINES: 1.0}, 1.75
"""Ways that are at most this many times as large as the best of the sampled part are all coded.
Lines take long to find. Grids are quick to code, and predict a whole channel better than stretches
of it."""

FEW, DENSE, DENSER, CHEAP = 64, 0.35, 0.7, 4
"""Held pieces up to which varints may be smaller; held pieces a sample from which lines never are;
bytes of the quick estimate for each held piece from which on the grid never is. Where the
grid does not grow with the value, lines are tried up to DENSER (measured)."""


def likely_ways(source: InputBlock, base: Track, bound: Bound, *, knots_alone: bool) -> list[Way]:
    """The ways that may be the smallest, the likeliest first.

    How many pieces are held tells which ways never are. Where there are many pieces, stretches with
    as many pieces each are coded in all other ways.
    """
    plain, levels, lines, *grids = scalar_ways(source, bound)
    x, grid = source.counts[:, 0], grid_within(bound)
    ticks = np.concatenate([at + fewest_hold(*tube_of(part, bound))[0] for at, part in slices(x)])
    held, few = ticks.size, ticks.size // (SAMPLED * WINDOWS)
    sampled = few >= LEAST
    looked: Iterable[Indices] = (part for _, part in slices(x))
    if sampled:
        firsts = held * np.arange(1, 2 * WINDOWS, 2) // (2 * WINDOWS) - few // 2
        windows = np.concatenate([x[ticks[k] : ticks[k + few]] for k in firsts]).astype(np.int64)
        looked = [windows]
    # The first of equal ones stays: on single counts, held values are near the middle.
    ways = [plain, levels] if held <= FEW else [levels]
    if sampled or held <= (DENSE if grid.kn else DENSER) * x.size:
        ways.append(lines)
    if not knots_alone:
        bits = [0.0, 0.0] if grid.kn else [0.0]
        for part in looked:
            bits[-1] += quick_estimate(nearest_uniform(part, even_grid(bound)))
            if grid.kn:
                bits[0] += quick_estimate(nearest_level(part, grid))
        if sampled or min(bits) < 8 * CHEAP * held:
            ways.append(grids[bits.index(min(bits))])
    if not sampled or len(ways) == 1:
        return ways
    block = InputBlock(source.channels, windows[:, None], (Span(0, windows.size),))
    allowed = {why for why, _ in ways}
    sizes: dict[str, int] = {}
    for why, code in scalar_ways(block, bound):
        if why in allowed and (coded := code(base, None)):
            sizes[why] = coded.size - WINDOWS * JOINS.get(why, GRID_JOINS)
    least = min(sizes.values())
    near = [
        (size, why) for why, size in sizes.items() if size <= least * NEAR.get(why, NEAR_GRID) + 4
    ]
    return [way for _, why in sorted(near) for way in ways if way[0] == why]


def slices(x: NDArray[Any]) -> Iterator[tuple[int, Indices]]:
    """Places and counts of parts, so that no second recording is in memory."""
    for at in range(0, x.size, SLICE):
        yield at, x[at : at + SLICE].astype(np.int64)


def even_grid(bound: Bound) -> LpcParameters:
    return LpcParameters(2 * min(bound.slack, STEP_LIMIT // 2 - 1) + 1)


def code_grid(
    source: InputBlock,
    base: Track,
    grid: LpcParameters,
    to_indices: Callable[[Indices, LpcParameters], Indices],
    smallest: int | None = None,
    *,
    effort: Effort | None = None,
) -> Coded | None:
    """None where it is sure not to be below ``smallest``."""

    def pieces() -> Iterator[tuple[Span, Indices]]:
        # Quantised again each time: a stored result would be a second recording in memory.
        for span, rows in source.pieces(source.counts):
            yield span, to_indices(rows[:, 0], grid)

    if smallest is not None and hopeless((indices for _, indices in pieces()), smallest):
        return None
    coded = Coded(replace(base, codec="LPCR", parameters=grid.build()))
    effort = effort or EFFORTS["default"]

    def packets() -> Iterator[tuple[Span, bytes]]:
        for span, indices in pieces():
            code = partial(code_part, indices)
            yield from fitting_packets(span, indices, code, cuts=effort.cuts)

    def code_part(indices: Indices, part: slice) -> bytes:
        return encode_best(indices[part], effort)

    return fill_below(coded, packets(), smallest)


def hopeless(pieces: Iterable[Indices], size: int) -> bool:
    """Whether packets of these indices are far larger than ``size`` bytes, by a quick estimate."""
    estimate = 0.0
    for indices in pieces:
        estimate += quick_estimate(indices)
        if HOPE * estimate > 8 * size:
            return True
    return False


LOOKED, ONE_IN = 512, 4
"""Samples in a row that tell about the size without loss, one such row in ONE_IN."""


def lossless_bits(x: NDArray[Any]) -> float:
    """A quick estimate of the bits of one channel [ticks] without loss."""
    rows = [x[at : at + LOOKED].astype(np.int64) for at in range(0, x.size, LOOKED * ONE_IN)]
    return sum(map(quick_estimate, rows)) * x.size / max(sum(row.size for row in rows), 1)
