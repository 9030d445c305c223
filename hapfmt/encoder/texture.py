"""Channels whose texture is kept to a stated quality, and whose slow part keeps the deadband.

The quality in dB is a ratio (:func:`hapfmt.metrics.snr_hf_db`). It divides the variance of the
recorded signal above the split frequency by the mean squared error of all that is decoded. Two ways
are tried: the whole signal predicted on one uniform grid, and lines for the slow part with the rest
predicted.

Weber's fraction is a law of slow forces: people feel a vibration far below it. So only the absolute
threshold decides whether there is a texture, and whether an error needs to be smaller.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..errors import ParameterError
from ..format.cluster import Packet
from ..format.track import Component, Contract, Track
from ..limits import EXACT_LIMIT, ZERO_LIMIT
from ..numbers import clamp
from ..recording import Calibration, Channel
from ..split import PADDING_PERIODS, slow_for_telling
from .bounded import code_grid, code_lines, encode_bounded, encode_lossless
from .gridded import nearest_uniform
from .knots import Coded
from .lattice import on_uniform_grid
from .plan import Promise, without_glitches
from .predict import encode_best
from .source import InputBlock, declared_range
from .unit import (
    ENCODE_LEVEL,
    STEP_LIMIT,
    Unit,
    bound_of,
    decode_all,
    in_finer_counts,
    whole_range,
)

Doubles = NDArray[np.float64]

STRETCH = 1 << 18
"""Samples that are filtered at a time."""

HALVINGS = 12
"""How often the interval of the widest step with the wanted quality is halved."""

FINER = 32
"""The fewest counts of a step: rounding it to whole counts then costs little quality."""

RESOLVED = 1e-12
"""Share of the largest value that rounding leaves where the slow part is the signal itself."""

NARROWER, TRIES = 0.8, 16
"""Each try multiplies the step by NARROWER, until the slow part keeps its deadband."""


@dataclass(frozen=True)
class FeltChannel:
    """One channel in its unit: samples, their slow part, and what the promise allows there."""

    x: Doubles
    slow: Doubles
    allowed: Doubles
    floor: float
    power: float
    """Power of the part above the split frequency."""

    mse: float
    """The largest mean squared error."""

    source: InputBlock
    cutoff_hz: float

    @classmethod
    def of(cls, x: Doubles, source: InputBlock, promise: Promise, cutoff_hz: float) -> FeltChannel:
        assert promise.floor is not None and promise.snr is not None
        calm = without_glitches(x)  # one glitch of 1 kN would hide a texture of 30 mN
        slow = slow_of(calm, source, cutoff_hz)
        extent = float(np.ptp(calm))
        channel = source.channels[0]
        step = float(abs(channel.calibration.step)) if channel.calibration else None
        floor = promise.floor.absolute(extent, step, channel.unit) or 0.0
        allowed = np.maximum(float(promise.k) * np.abs(slow), floor)
        power = float((calm - slow).var())
        mse = power / 10 ** (promise.snr / 10)
        return cls(x, slow, allowed, floor, power, mse, source, cutoff_hz)

    @property
    def silent(self) -> bool:
        """Whether what lies above the split frequency is below the absolute threshold, as root
        mean square: the onsets of smooth contact, which the deadband keeps, are no texture."""
        return self.power <= self.floor**2

    @property
    def beyond_doubles(self) -> bool:
        """Whether the quality asks for errors near the resolution of float64 at these values."""
        return self.mse <= (RESOLVED * float(np.abs(self.x).max(initial=0.0))) ** 2

    @property
    def fine(self) -> bool:
        """Whether the quality asks for errors below the absolute threshold: those of a uniform
        grid are spread evenly, so their mean square is a third of the largest one's."""
        return self.mse <= self.floor**2 / 3

    def holds(self, y: Doubles) -> bool:
        """Whether decoded samples keep the quality, and their slow part the deadband."""
        e = y - self.x
        return float((e * e).mean()) <= self.mse and self.slow_holds(e)

    def slow_holds(self, e: Doubles) -> bool:
        return bool((np.abs(slow_of(e, self.source, self.cutoff_hz)) <= self.allowed).all())

    def widest_step(self, x: NDArray[Any]) -> float:
        """The widest uniform grid on which x has the quality."""
        low, high = sqrt(12 * self.mse) / 2, 4 * sqrt(12 * self.mse)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            e = x - np.rint(x / middle) * middle
            low, high = (middle, high) if float((e * e).mean()) <= self.mse else (low, middle)
        return low


def slow_of(x: Doubles, source: InputBlock, cutoff_hz: float) -> Doubles:
    """The slow part; no filter reaches over a gap. Stretch by stretch, with what the filter needs
    to settle on both sides."""
    rate, out = float(source.rate), np.empty_like(x)
    margin = ceil(PADDING_PERIODS * rate / cutoff_hz)
    for rows in source.segments():
        for start in range(rows.start, rows.stop, STRETCH):
            stop = min(start + STRETCH, rows.stop)
            first, last = max(start - margin, rows.start), min(stop + margin, rows.stop)
            slow = slow_for_telling(x[first:last, None], rate, cutoff_hz)[:, 0]
            out[start:stop] = slow[start - first : stop - first]
    return out


def encode_textured(
    source: InputBlock, original: Channel, first_channel: int, promise: Promise, cutoff_hz: float
) -> tuple[Unit, str]:
    """The smallest way found, and what is kept. source: one channel on a fine grid."""
    base = whole_range(source, first_channel)
    felt = FeltChannel.of(original.samples(), source, promise, cutoff_hz)
    quality = f"texture {promise.snr:g} dB"
    alone = encode_bounded(source, base, promise)
    assert alone
    if felt.silent if promise.enough else felt.beyond_doubles:
        return alone, promise.kept_as.replace(quality, "no texture above the threshold")
    if felt.fine and promise.enough:
        unit = encode_bounded(source, base, replace(promise, k=Fraction(0)))
        assert unit
        return unit, promise.enough
    found = [alone] if felt.holds(decoded(alone)) else []
    smallest = min((unit.size for unit in found), default=None)
    ways: tuple[Callable[[int | None], Unit | None], ...] = (
        lambda size: encode_whole(felt, original, first_channel, size),
        lambda size: encode_split(felt, base, promise, size),
    )
    for way in ways:
        unit = way(smallest)
        if unit and (smallest is None or unit.size < smallest):
            found.append(unit)
            smallest = unit.size
    if not found:
        return encode_lossless(source, base), "lossless"
    return min(found, key=lambda unit: unit.size), promise.kept_as


def decoded(unit: Unit) -> Doubles:
    """What the decoder makes of a unit of one channel, in its unit."""
    affine = unit.base.track.components[0].calibration
    counts = decode_all(unit.base, 1)
    return Calibration(affine.a, affine.b, affine.d).physical(counts[:, 0])


def steps_down(step: float) -> Iterator[float]:
    for _ in range(TRIES):
        yield step
        step *= NARROWER


def encode_whole(
    felt: FeltChannel, original: Channel, first_channel: int, smallest: int | None
) -> Unit | None:
    """The whole signal, predicted on the widest uniform grid that keeps the promise."""
    for step in steps_down(felt.widest_step(felt.x)):
        y = np.rint(felt.x / step) * step
        if not felt.slow_holds(y - felt.x):
            continue
        if original.is_counts:
            return whole_counts(felt, original, first_channel, step, smallest)
        own = on_uniform_grid(original, step / 2)
        if own is None:
            return None
        source = InputBlock((own[0],), own[0].stored[:, None], felt.source.spans)
        calibration = own[0].calibration
        assert calibration is not None
        if not felt.holds(calibration.physical(own[0].stored)):
            continue
        track = whole_range(source, first_channel)
        coded = code_grid(source, track, LpcParameters(), nearest_uniform, smallest)
        if coded is None:
            return None
        reason = f"prediction on a uniform grid of {float(calibration.step):.4g} {original.unit}"
        return Unit(coded, None, "predicted", reason, exact=True, channels=source.channels)
    return None


def whole_counts(
    felt: FeltChannel, original: Channel, first_channel: int, step: float, smallest: int | None
) -> Unit | None:
    """The form of a channel of counts: a step of whole counts, or a finer one if it is a few."""
    calibration = original.calibration
    assert calibration is not None
    counts = step / float(abs(calibration.step))
    if counts < 2:
        return None
    channel = original
    if counts < FINER:
        times = ceil(FINER / counts)
        with suppress(ParameterError):  # a large offset leaves no room for finer counts
            finer = in_finer_counts(original, times)
            low, high = declared_range(finer.stored)
            if finer.calibration and finer.calibration.covers(low, high) and high < 1 << 31:
                channel, counts = finer, counts * times
    source = InputBlock((channel,), channel.stored[:, None], felt.source.spans)
    track = whole_range(source, first_channel)
    whole = min(int(counts), STEP_LIMIT)
    while whole > 1:
        grid = LpcParameters(whole)
        assert channel.calibration is not None
        y = nearest_uniform(channel.stored.astype(np.int64), grid) * whole
        if felt.holds(channel.calibration.physical(y)):
            coded = code_grid(source, track, grid, nearest_uniform, smallest)
            if coded is None:
                return None
            coded.track = replace(coded.track, contract=uniform(whole // 2, channel.calibration))
            unit = float(abs(channel.calibration.step)) * whole
            reason = f"prediction on a uniform grid of {unit:.4g} {original.unit}"
            return Unit(coded, None, "predicted", reason, channels=source.channels)
        whole = min(int(whole * 0.95), whole - 1)
    return None


def encode_split(
    felt: FeltChannel, base: Track, promise: Promise, smallest: int | None
) -> Unit | None:
    """Lines for the slow part, and what they leave predicted on a uniform grid."""
    source, channel = felt.source, felt.source.channels[0]
    calibration = channel.calibration
    assert calibration is not None
    slow = counts_nearest(felt.slow, calibration)
    calm = replace(source, counts=slow[:, None])
    low, high = base.count_min, base.count_max
    lines = code_lines(calm, base, bound_of(source, promise), smallest)
    if lines is None:
        return None
    d = decode_all(lines, 1)[:, 0]
    residual = source.counts[:, 0].astype(np.int64) - d
    count = float(abs(calibration.step))
    for step in steps_down(felt.widest_step(residual * count) / count):
        grid = LpcParameters(max(min(int(step), STEP_LIMIT), 1))
        indices = nearest_uniform(residual, grid)
        y = np.clip(d + indices * grid.step, low, high)
        if not felt.holds(calibration.physical(y)):
            continue
        return with_predicted(felt, lines, indices * grid.step, grid, y, smallest)
    return None


def uniform(error: int, calibration: Calibration) -> Contract:
    """The contract that no sample is further off than ``error`` counts."""
    zero = clamp(calibration.zero, -ZERO_LIMIT, ZERO_LIMIT - 1)
    return Contract(0, 1, False, True, (error,), (zero,))


def counts_nearest(x: Doubles, calibration: Calibration) -> NDArray[np.int64]:
    exact = (x * calibration.d - calibration.b) / calibration.a
    return np.floor(exact + 0.5).astype(np.int64)


def with_predicted(
    felt: FeltChannel,
    lines: Coded,
    levels: NDArray[np.int64],
    grid: LpcParameters,
    y: NDArray[np.int64],
    smallest: int | None,
) -> Unit | None:
    """The LF track of lines with an HF track of LPCR; None where it is not the smaller."""
    source, channel = felt.source, felt.source.channels[0]
    assert channel.calibration is not None
    low, high = declared_range(levels)
    widest = 1 << (ENCODE_LEVEL.residual_bits - 1)
    if low < -widest or high >= widest:
        return None
    if max(-low, high) * abs(channel.calibration.a) > EXACT_LIMIT:
        return None
    lines.track = replace(lines.track, kind="lf")
    track = replace(
        lines.track, kind="hf", codec="LPCR", parameters=grid.build(), count_min=low,
        count_max=high, base=0, components=(Component(),),
    )  # fmt: skip
    fast = Coded(track)
    size = lines.size + fast.size
    for span, rows in source.pieces(levels):
        data = encode_best(nearest_uniform(rows, grid))
        size += len(data)
        if smallest is not None and size >= smallest:
            return None
        fast.packets.append(Packet(0, span.start, span.ticks, data))
    error = int(np.abs(source.counts[:, 0] - y).max(initial=0))
    fast.track = replace(fast.track, contract=uniform(max(error, 1), channel.calibration))
    step = float(abs(channel.calibration.step)) * grid.step
    reason = f"lines, and prediction of the rest on a uniform grid of {step:.4g} {channel.unit}"
    return Unit(lines, fast, "lines + predicted", reason, channels=source.channels)
