"""Presets archive, near-lossless and deadband: every sample within its bound, by construction.

A guarantee, not an aim: grids, and knots inside the tube, leave no sample outside. Which
of them a track gets is a matter of size alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import partial

from ..codecs.grids import LpcParameters
from ..container.track import Contract, Track
from ..deadband import Deadband
from ..integers import clamp
from ..limits import ZERO_LIMIT
from ..recording import Channel, Span
from .check import decoded_pieces
from .grids import Indices, grid_within, nearest_level, nearest_uniform
from .packed import Coded, fill_below
from .predict import encode_best, quick_estimate
from .quick import encode_quick
from .settings import Settings, counts_of
from .source import Source
from .tubed import Way, code_held, code_held_levels, code_lines, vector_ways
from .unit import STEP_LIMIT, Bound, Unit, bound_of

HOPE = 0.5
"""Packets of LPCR take 0.46 to 1.5 times the bits of their quick estimate, and those that won 0.72
and more (measured; from 0 to 0.7 no recording changed by a byte)."""


def encode_within(source: Source, base: Track, settings: Settings) -> Unit:
    """One unit by the preset of the settings, smallest first."""
    if settings.preset == "archive":
        code = encode_quick if settings.fast else partial(encode_best, thorough=False)
        coded = code_grid(source, base, LpcParameters(), nearest_uniform, code=code)
        assert coded
        reason = "lossless, fast" if settings.fast else "lossless"
        return Unit(coded, None, "predicted", reason, exact=True)
    if settings.preset == "near-lossless":
        return encode_near(source, base, settings)
    return encode_deadband(source, base, settings)


def encode_near(source: Source, base: Track, settings: Settings) -> Unit:
    """No sample of the source further than ``max_error`` away, its lattice's deviation included."""
    channel = source.channels[0]
    calibration = channel.calibration
    assert calibration is not None
    error = error_of(channel, settings)
    grid = LpcParameters(step=2 * error + 1)
    coded = code_grid(source, base, grid, nearest_uniform)
    assert coded
    if not error:
        return Unit(coded, None, "predicted", "the error is below one count: lossless", exact=True)
    band = Deadband(0, 1, (error,), (clamp(calibration.zero, -ZERO_LIMIT, ZERO_LIMIT - 1),))
    coded.track = replace(coded.track, contract=kept(source, coded, band))
    return Unit(coded, None, "predicted", f"within {error} counts")


def error_of(channel: Channel, settings: Settings) -> int:
    """Counts that a sample of it may be off, 0 where preset archive allows none."""
    calibration = channel.calibration
    if settings.max_error is None or calibration is None:
        return 0
    allowed = counts_of(
        settings.max_error, calibration, int(channel.stored.max()) - int(channel.stored.min())
    )
    if channel.deviation is not None:
        allowed -= Fraction(channel.deviation.largest) / abs(calibration.step)
    return min(max(int(allowed), 0), STEP_LIMIT // 2 - 1)


def encode_deadband(source: Source, base: Track, settings: Settings) -> Unit:
    """Each sample within max(k * |x|, floor): the smallest of grids and knots."""
    bound = bound_of(source, settings)
    ways = vector_ways(source, bound) if len(source.channels) > 1 else scalar_ways(source, bound)
    tried: list[tuple[Coded, str]] = []
    for why, code in ways:
        smallest = min((coded.size for coded, _ in tried), default=None)
        if coded := code(base, smallest):
            tried.append((coded, why))
    coded, why = min(tried, key=lambda pair: pair[0].size)
    coded.track = replace(coded.track, contract=kept(source, coded, bound.band))
    chosen = "predicted" if coded.track.codec == "LPCR" else "knots"
    return Unit(coded, None, chosen, why)


def kept(source: Source, coded: Coded, band: Deadband) -> Contract:
    """The contract, guaranteed: checked against what the decoder makes of it."""
    if any(band.outside(x, y).any() for x, y in decoded_pieces(source, coded)):
        raise AssertionError("an encoder that guarantees a deadband left it")
    return Contract(band.kn, band.kd, band.vector, True, band.floor, band.zero)


def scalar_ways(source: Source, bound: Bound) -> list[Way]:
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
        ways.append(("prediction on the deadband's grid", lambda base, smallest: code_grid(
            source, base, grid, nearest_level, smallest)))  # fmt: skip
    ways.append((f"prediction within {step} counts", lambda base, smallest: code_grid(
        source, base, even, nearest_uniform, smallest)))  # fmt: skip
    return ways


def code_grid(
    source: Source,
    base: Track,
    grid: LpcParameters,
    to_indices: Callable[[Indices, LpcParameters], Indices],
    smallest: int | None = None,
    *,
    code: Callable[[Indices], bytes] = encode_best,
) -> Coded | None:
    """None where it is sure not to be below ``smallest``."""

    def pieces() -> Iterator[tuple[Span, Indices]]:
        # Put on the grid anew each time: kept, they would be a second recording in memory.
        for span, rows in source.pieces(source.counts):
            yield span, to_indices(rows[:, 0], grid)

    if smallest is not None and hopeless((indices for _, indices in pieces()), smallest):
        return None
    coded = Coded(replace(base, codec="LPCR", parameters=grid.build()))
    return fill_below(
        coded,
        ((span, code(indices)) for span, indices in pieces()),
        smallest,
    )


def hopeless(pieces: Iterable[Indices], size: int) -> bool:
    """Whether packets of these indices are far larger than ``size`` bytes, by a quick estimate."""
    estimate = 0.0
    for indices in pieces:
        estimate += quick_estimate(indices)
        if HOPE * estimate > 8 * size:
            return True
    return False
