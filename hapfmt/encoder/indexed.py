"""Presets archive, near-lossless and deadband: every sample within its bound, by construction.

A guarantee, not an aim: the grid of LPCR, and knots inside the tube, leave no sample outside. Which
of them a track gets is a matter of size alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..codecs.knots import Interpolation, KnotParameters, build_knots
from ..codecs.predicted import LpcParameters, deadband_levels
from ..container.cluster import Packet
from ..container.track import Contract, Track
from ..deadband import ZERO_LIMIT, Deadband
from ..integers import clamp
from ..limits import LEVELS
from ..recording import Channel
from .knots import select_knots
from .predict import encode_best
from .settings import Settings, counts_of
from .source import Source
from .tube import fewest_hold, fewest_linear
from .unit import Bound, Coded, Unit, bound_of, code_steps, decode_all

Indices = NDArray[np.int64]
STEP_LIMIT = LEVELS[1].step
"""Steps that every level allows; larger tolerances are seldom asked for, and knots keep them."""


def encode_within(source: Source, base: Track, settings: Settings) -> Unit:
    """One unit by the preset of the settings, smallest first."""
    if settings.preset == "archive":
        coded = code_grid(source, base, LpcParameters(), nearest_uniform, thorough=False)
        return Unit(coded, None, "predicted", "lossless", exact=True)
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
        settings.max_error, calibration, int(np.ptp(channel.values.astype(np.int64)))
    )
    if channel.deviation is not None:
        allowed -= Fraction(channel.deviation.largest) / abs(calibration.step)
    return min(max(int(allowed), 0), STEP_LIMIT // 2 - 1)


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


Way = tuple[str, Callable[[Track], Coded]]


def vector_ways(source: Source, bound: Bound) -> Iterable[Way]:
    def held(base: Track) -> Coded:
        if not bound.slack:
            # A floor below one count allows no error at all.
            return code_steps(source, bound, base)
        return code_knots_by(source, base, "hold", lambda rows: vector_steps(rows, bound.band))

    return [("held steps of the vector", held)]


def vector_steps(rows: Indices, band: Deadband) -> tuple[Indices, Indices]:
    ticks = select_knots(rows, band, reference="sample", keep_last=False)
    return ticks, rows[ticks]


def scalar_ways(source: Source, bound: Bound) -> list[Way]:
    """(why it is smaller, how to code it) of one channel."""
    step = min(bound.slack, STEP_LIMIT // 2 - 1)
    grid = LpcParameters(step, bound.band.zero[0], bound.band.kn, bound.band.kd)
    even = LpcParameters(2 * step + 1)

    def tube(rows: Indices) -> tuple[Indices, Indices]:
        width = tolerances(rows[:, 0], bound)
        return rows[:, 0] - width, rows[:, 0] + width

    ways: list[Way] = [
        (
            f"prediction within {step} counts",
            lambda base: code_grid(source, base, even, nearest_uniform),
        ),
        ("fewest held steps", lambda base: code_knots_by(
            source, base, "hold", lambda rows: column(fewest_hold(*tube(rows))))),
        ("fewest lines", lambda base: code_knots_by(
            source, base, "linear", lambda rows: column(fewest_linear(*tube(rows))))),
    ]  # fmt: skip
    if grid.kn:
        ways += [
            ("prediction on the deadband's grid", lambda base: code_grid(
                source, base, grid, nearest_level)),
            ("held levels of the deadband's grid", lambda base: code_grid(
                source, base, grid, lambda x, g: held_levels(x, g, bound))),
        ]  # fmt: skip
    return ways


def column(knots: tuple[Indices, Indices]) -> tuple[Indices, Indices]:
    return knots[0], knots[1][:, None]


def tolerances(x: Indices, bound: Bound) -> Indices:
    """Largest error of each count that keeps the deadband, the slack being the floor."""
    weber = np.abs(x - bound.band.zero[0]) * bound.band.kn // bound.band.kd
    return np.asarray(np.maximum(weber, bound.slack))


def code_grid(
    source: Source,
    base: Track,
    grid: LpcParameters,
    to_indices: Callable[[Indices, LpcParameters], Indices],
    *,
    thorough: bool = True,
) -> Coded:
    coded = Coded(replace(base, codec="LPCR", parameters=grid.build()))
    for span, rows in source.pieces(source.counts):
        data = encode_best(to_indices(rows[:, 0], grid), thorough=thorough)
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return coded


def code_knots_by(
    source: Source,
    base: Track,
    interpolation: Interpolation,
    find: Callable[[Indices], tuple[Indices, Indices]],
) -> Coded:
    parameters = KnotParameters(interpolation).build()
    coded = Coded(replace(base, codec="KNOT", parameters=parameters))
    for span, rows in source.pieces(source.counts):
        ticks, values = find(rows)
        coded.packets.append(Packet(0, span.start, span.ticks, build_knots(ticks, values)))
    return coded


def nearest_uniform(x: Indices, grid: LpcParameters) -> Indices:
    return (2 * (x - grid.zero) + grid.step) // (2 * grid.step)


def nearest_level(x: Indices, grid: LpcParameters) -> Indices:
    """The index whose cell holds each count: cells end at top(y) of SPEC 9.5."""
    c = x - grid.zero
    _, tops = deadband_levels(grid, int(np.abs(c).max()))
    cells: Indices = np.searchsorted(tops, np.abs(c)).astype(np.int64)
    return np.asarray(np.sign(c) * cells)


def held_levels(x: Indices, grid: LpcParameters, bound: Bound) -> Indices:
    """Indices that change as rarely as they can: any level within the deadband will do."""
    width = tolerances(x, bound)
    levels, _ = deadband_levels(grid, int(np.abs(x - grid.zero).max()))
    signed = np.concatenate((-levels[:0:-1], levels)) + grid.zero
    low = np.searchsorted(signed, x - width) - (levels.size - 1)
    high = np.searchsorted(signed, x + width, side="right") - levels.size
    ticks, values = fewest_hold(low, high)
    return np.repeat(values, np.diff(np.append(ticks, x.size)))
