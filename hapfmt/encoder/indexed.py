"""Presets archive, near-lossless and deadband: every sample within its bound, by construction.

A guarantee, not an aim: grids, and knots inside the tube, leave no sample outside. Which
of them a track gets is a matter of size alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np

from ..codecs.predicted import LpcParameters
from ..container.cluster import Packet
from ..container.track import Contract, Track
from ..deadband import ZERO_LIMIT, Deadband
from ..integers import clamp
from .grids import STEP_LIMIT, Indices, grid_within, nearest_level, nearest_uniform
from .packed import Coded
from .predict import encode_best
from .settings import Settings, counts_of
from .source import Source
from .tubed import Way, code_held, code_held_levels, code_lines, vector_ways
from .unit import Bound, Unit, bound_of, decode_all


def encode_within(source: Source, base: Track, settings: Settings) -> Unit:
    """One unit by the preset of the settings, smallest first."""
    if settings.preset == "archive":
        coded = code_grid(source, base, LpcParameters(), nearest_uniform)
        return Unit(coded, None, "predicted", "lossless", exact=True)
    if settings.preset == "near-lossless":
        return encode_near(source, base, settings)
    return encode_deadband(source, base, settings)


def encode_near(source: Source, base: Track, settings: Settings) -> Unit:
    """No sample of the source further than ``max_error`` away, its lattice's deviation included."""
    channel = source.channels[0]
    calibration = channel.calibration
    assert settings.max_error is not None and calibration is not None
    allowed = counts_of(settings.max_error, calibration, int(np.ptp(source.counts)))
    if channel.deviation is not None:
        allowed -= Fraction(channel.deviation.largest) / abs(calibration.step)
    error = min(max(int(allowed), 0), STEP_LIMIT // 2 - 1)
    grid = LpcParameters(step=2 * error + 1)
    coded = code_grid(source, base, grid, nearest_uniform)
    if not error:
        return Unit(coded, None, "predicted", "the error is below one count: lossless", exact=True)
    band = Deadband(0, 1, (error,), (clamp(calibration.zero, -ZERO_LIMIT, ZERO_LIMIT - 1),))
    coded.track = replace(coded.track, contract=kept(source, coded, band))
    return Unit(coded, None, "predicted", f"within {error} counts")


def encode_deadband(source: Source, base: Track, settings: Settings) -> Unit:
    """Each sample within max(k * |x|, floor): the smallest of grids and knots."""
    bound = bound_of(source, settings)
    ways = vector_ways(source, bound) if len(source.channels) > 1 else scalar_ways(source, bound)
    tried = [(code(base), why) for why, code in ways]
    coded, why = min(tried, key=lambda pair: pair[0].size)
    coded.track = replace(coded.track, contract=kept(source, coded, bound.band))
    chosen = "predicted" if coded.track.codec == "LPCR" else "knots"
    return Unit(coded, None, chosen, why)


def kept(source: Source, coded: Coded, band: Deadband) -> Contract:
    """The contract, guaranteed: checked against what the decoder makes of it."""
    y = decode_all(coded, len(source.channels))
    if band.outside(source.counts, y).any():
        raise AssertionError("an encoder that guarantees a deadband left it")
    return Contract(band.kn, band.kd, band.vector, True, band.floor, band.zero)


def scalar_ways(source: Source, bound: Bound) -> list[Way]:
    """(why it is smaller, how to code it) of one channel."""
    step = min(bound.slack, STEP_LIMIT // 2 - 1)
    even, grid = LpcParameters(2 * step + 1), grid_within(bound)
    ways: list[Way] = [
        (
            f"prediction within {step} counts",
            lambda base: code_grid(source, base, even, nearest_uniform),
        ),
        ("fewest held steps", lambda base: code_held(source, base, bound)),
        ("fewest held levels", lambda base: code_held_levels(source, base, bound)),
        ("fewest lines", lambda base: code_lines(source, base, bound)),
    ]
    if grid.kn:
        why = "prediction on the deadband's grid"
        ways.append((why, lambda base: code_grid(source, base, grid, nearest_level)))
    return ways


def code_grid(
    source: Source,
    base: Track,
    grid: LpcParameters,
    to_indices: Callable[[Indices, LpcParameters], Indices],
) -> Coded:
    coded = Coded(replace(base, codec="LPCR", parameters=grid.build()))
    for span, rows in source.pieces(source.counts):
        data = encode_best(to_indices(rows[:, 0], grid))
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return coded
