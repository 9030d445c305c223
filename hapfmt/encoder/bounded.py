"""Channels that keep a bound on every sample, by construction; lossless is the bound 0.

A uniform grid keeps the bound, and so do knots inside the tube. The encoder takes the smaller of
the two for each track.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import partial

from ..codecs.grids import LpcParameters
from ..deadband import Deadband
from ..format.track import Contract, Track
from ..recording import Channel, Span
from .gridded import Indices, grid_within, nearest_level, nearest_uniform
from .knots import Coded, fill_below
from .lengths import fitting_packets
from .plan import Promise, without_glitches
from .predict import encode_best, encode_quick, quick_estimate
from .settings import counts_of
from .source import InputBlock
from .tubed import Way, code_held, code_held_levels, code_lines, vector_ways
from .unit import STEP_LIMIT, Bound, Unit, bound_of

HOPE = 0.5
"""Skip coding when this share of the quick estimate already exceeds the best size. LPCR packets
take 0.46 to 1.5 times the bits of their quick estimate. Packets that won never fell below 0.72
(measured; from 0 to 0.7 no recording changed by a byte)."""


KNOT_WAYS = 3
"""The first of :func:`scalar_ways`."""


def encode_lossless(source: InputBlock, base: Track, *, fast: bool = False) -> Unit:
    code = encode_quick if fast else partial(encode_best, thorough=False)
    coded = code_grid(source, base, LpcParameters(), nearest_uniform, code=code)
    assert coded
    return Unit(coded, None, "predicted", "lossless, fast" if fast else "lossless", exact=True)


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
) -> Unit | None:
    """Each sample within max(k * |x|, floor): the smallest of grids and knots, or of ``knots
    alone``; None where none of them is below ``smallest`` bytes."""
    bound = bound_of(source, promise)
    if len(source.channels) == 1 and not bound.slack and not promise.k:
        return encode_lossless(source, base)
    ways = vector_ways(source, bound) if len(source.channels) > 1 else scalar_ways(source, bound)
    best: tuple[Coded, str] | None = None
    for why, code in ways[:KNOT_WAYS] if knots_alone else ways:
        if (coded := code(base, smallest)) and (smallest is None or coded.size < smallest):
            best, smallest = (coded, why), coded.size
    if best is None:
        return None
    coded, why = best
    coded.track = replace(coded.track, contract=contract_for(bound.band))
    chosen = "predicted" if coded.track.codec == "LPCR" else "knots"
    return Unit(coded, None, chosen, why)


def contract_for(band: Deadband) -> Contract:
    """Kept by construction, and checked once more before the file is written."""
    return Contract(band.kn, band.kd, band.vector, True, band.floor, band.zero)


def scalar_ways(source: InputBlock, bound: Bound) -> list[Way]:
    """Of one channel; what is soon tried comes first."""
    step = min(bound.slack, STEP_LIMIT // 2 - 1)
    even, grid = LpcParameters(2 * step + 1), grid_within(bound)
    ways: list[Way] = [
        ("fewest held steps", lambda base, _: code_held(source, base, bound)),
        (
            "fewest held levels",
            lambda base, smallest: code_held_levels(source, base, bound, smallest),
        ),
        ("fewest lines", lambda base, smallest: code_lines(source, base, bound, smallest)),
    ]
    if grid.kn:
        growing = "each sample from those before, in steps that grow with the value"
        ways.append((growing, lambda base, smallest: code_grid(
            source, base, grid, nearest_level, smallest)))  # fmt: skip
    ways.append(("each sample from those before, in equal steps", lambda base, smallest: code_grid(
        source, base, even, nearest_uniform, smallest)))  # fmt: skip
    return ways


def code_grid(
    source: InputBlock,
    base: Track,
    grid: LpcParameters,
    to_indices: Callable[[Indices, LpcParameters], Indices],
    smallest: int | None = None,
    *,
    code: Callable[[Indices], bytes] = encode_best,
) -> Coded | None:
    """None where it is sure not to be below ``smallest``."""

    def pieces() -> Iterator[tuple[Span, Indices]]:
        # Quantised again each time: a stored result would be a second recording in memory.
        for span, rows in source.pieces(source.counts):
            yield span, to_indices(rows[:, 0], grid)

    if smallest is not None and hopeless((indices for _, indices in pieces()), smallest):
        return None
    coded = Coded(replace(base, codec="LPCR", parameters=grid.build()))

    def packets() -> Iterator[tuple[Span, bytes]]:
        for span, indices in pieces():
            yield from fitting_packets(span, indices, partial(code_part, indices))

    def code_part(indices: Indices, part: slice) -> bytes:
        return code(indices[part])

    return fill_below(coded, packets(), smallest)


def hopeless(pieces: Iterable[Indices], size: int) -> bool:
    """Whether packets of these indices are far larger than ``size`` bytes, by a quick estimate."""
    estimate = 0.0
    for indices in pieces:
        estimate += quick_estimate(indices)
        if HOPE * estimate > 8 * size:
            return True
    return False


def lossless_bits(source: InputBlock) -> float:
    """Bits that the counts of one channel hardly stay below without loss."""
    return HOPE * sum(quick_estimate(rows[:, 0]) for _, rows in source.pieces(source.counts))
