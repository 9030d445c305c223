"""Channels whose texture is kept to a stated quality, and whose slow part keeps the deadband.

Ways to code a texture are tried: the whole signal on one uniform grid, or lines for the slow part
and the rest on a uniform grid. Each way is a function of the step. For each way the encoder looks
for the widest step whose decoded samples have the quality. The smallest result wins. So all ways
are compared at one quality, as a decoder hears it.

Weber's fraction is a law of slow forces: people feel a vibration far below it. So only the absolute
threshold decides whether there is a texture, and whether an error needs to be smaller.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import ceil, exp, log, sqrt

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
from .bounded import code_grid, code_lines, encode_bounded
from .gridded import nearest_uniform
from .knots import Coded
from .lattice import LatticeSearch, on_uniform_grid
from .plan import Promise, without_glitches
from .predict import encode_best
from .quality import Measure, measure_of
from .source import InputBlock, declared_range
from .synthetic import with_synthetic
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

FINER = 128
"""Counts of a step: rounding it to whole counts then changes the quality by less than 0.1 dB."""

FINEST = 4 * FINER
"""Counts that one count of the source is divided into at most."""

RESOLVED = 1e-12
"""Share of the largest value that rounding leaves where the slow part is the signal itself."""

NARROWER, TRIES, HALVINGS = 0.8, 16, 4
"""Where the slow part leaves its deadband, each try multiplies the step by NARROWER. The interval
between the step that keeps it and the one before is then halved."""

NEAR = 0.99
"""The search for a step ends where the error is at least this share of the largest allowed one."""

NATIVE = 4
"""A step of fewer counts of the source is tried in whole counts too: a source with few distinct
values, such as the difference of encoder counts, loses nothing on its own grid."""

SEARCHED, FACTOR = 24, 4.0
"""Most steps that a search tries, and the largest factor from one to the next."""

SILENT_S = 0.5
"""A stretch without texture lasts this long at least, in seconds."""


@dataclass(frozen=True)
class CodedTrial:
    """What a step gives: the step that was used, decoded samples in the channel's unit, and a
    function that codes them.

    The function takes the smallest size so far, and gives None where it is sure not to be below.
    """

    step: float
    samples: Doubles
    code: Callable[[int | None], Unit | None]
    limited: bool = False
    """Whether wider steps have the quality too, but leave the deadband."""


Way = Callable[[float], CodedTrial | None]
"""A way to code a texture: from a step in the channel's unit. None: there is no such step."""


@dataclass(frozen=True)
class FeltChannel:
    """One channel in its unit: samples, their slow part, and what the promise allows there."""

    x: Doubles
    slow: Doubles
    allowed: Doubles
    floor: float
    textured: NDArray[np.bool_] | None
    """Samples that are not in a silent stretch; None: all."""

    power: float
    """Power of the part above the split frequency where there is texture."""

    whole_power: float
    """The same, with silent stretches."""

    measure: Measure
    source: InputBlock
    cutoff_hz: float

    @classmethod
    def of(cls, x: Doubles, source: InputBlock, promise: Promise, cutoff_hz: float) -> FeltChannel:
        assert promise.floor is not None and promise.texture is not None
        calm = without_glitches(x)  # one glitch of 1 kN would hide a texture of 30 mN
        slow = slow_of(calm, source, cutoff_hz)
        extent = float(np.ptp(calm))
        channel = source.channels[0]
        step = float(abs(channel.calibration.step)) if channel.calibration else None
        floor = promise.floor.absolute(extent, step, channel.unit) or 0.0
        allowed = np.maximum(float(promise.k) * np.abs(slow), floor)
        textured = None
        if promise.texture.drops_silence:
            textured = textured_samples(x - slow, floor, source)
        fast = calm - slow
        power = float((fast if textured is None else fast[textured]).var())
        measure = measure_of(promise.texture, x, power, textured, source)
        return cls(
            x, slow, allowed, floor, textured, power, float(fast.var()), measure, source, cutoff_hz
        )

    @property
    def silent(self) -> bool:
        """Whether what lies above the split frequency is below the absolute threshold, as root
        mean square: the onsets of smooth contact, which the deadband keeps, are no texture."""
        return self.whole_power <= self.floor**2

    @property
    def smooth(self) -> bool:
        """Whether what lies above the split frequency is only rounding of float64."""
        return sqrt(self.power) <= RESOLVED * float(np.abs(self.x).max(initial=0.0))

    @property
    def fine(self) -> bool:
        """Whether the quality asks for errors below the absolute threshold: those of a uniform
        grid are spread evenly, so their mean square is a third of the largest one's."""
        return self.first_step <= 2 * self.floor

    @property
    def first_step(self) -> float:
        """The step of a uniform grid that about has the quality."""
        return sqrt(12 * self.power * self.measure.noise)

    @cached_property
    def wanted(self) -> Doubles:
        """What is coded: in silent stretches the slow part."""
        return self.x if self.textured is None else np.where(self.textured, self.x, self.slow)

    def holds(self, y: Doubles) -> bool:
        """Whether decoded samples keep the quality, and their slow part the deadband."""
        return self.measure.error(y) <= self.measure.allowed and self.slow_holds(y)

    def slow_holds(self, y: Doubles) -> bool:
        error = slow_of(y - self.x, self.source, self.cutoff_hz)
        return bool((np.abs(error) <= self.allowed).all())


def textured_samples(fast: Doubles, floor: float, source: InputBlock) -> NDArray[np.bool_] | None:
    """Samples outside of stretches that stay below the threshold; None where there is no such
    stretch."""
    loud = np.abs(fast) > floor
    least = max(round(SILENT_S * float(source.rate)), 1)
    found = np.ones(loud.size, np.bool_)
    for rows in source.segments():
        marks = np.flatnonzero(loud[rows]) + rows.start
        edges = np.concatenate(([rows.start - 1], marks, [rows.stop]))
        for place in np.flatnonzero(np.diff(edges) > least).tolist():
            found[edges[place] + 1 : edges[place + 1]] = False
    return None if found.all() or not found.any() else found


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
) -> Unit | None:
    """The smallest way found. source: one channel on a fine grid. None: no grid has the quality."""
    base = whole_range(source, first_channel)
    felt = FeltChannel.of(original.samples(), source, promise, cutoff_hz)
    target = promise.texture
    assert target is not None
    alone = encode_bounded(source, base, promise)
    assert alone
    if felt.silent if target.drops_silence else felt.smooth:
        kept_as = promise.kept_as.replace(target.text, NO_TEXTURE)
        return replace(alone, kept_as=kept_as, missed=NO_TEXTURE)
    if target.synthetic:
        return encode_synthetic(felt, base, promise)
    if felt.fine and target.threshold_is_enough:
        unit = encode_bounded(source, base, replace(promise, k=Fraction(0)))
        assert unit
        return reported(replace(unit, kept_as=promise.enough), felt, decoded(unit), THRESHOLD)
    best: Unit | None = None
    samples = decoded(alone)
    if felt.holds(samples):
        best = reported(alone, felt, samples, DEADBAND)
    for way in ways_of(felt, original, first_channel, promise):
        trial = widest(way, felt)
        if trial is None:
            continue
        smallest = best.size if best else None
        unit = trial.code(smallest)
        if unit and (smallest is None or unit.size < smallest):
            best = reported(unit, felt, trial.samples, DEADBAND if trial.limited else FINER_WINS)
    return best and replace(best, kept_as=promise.kept_as)


def encode_synthetic(felt: FeltChannel, base: Track, promise: Promise) -> Unit | None:
    """Lines for the slow part, and a model of the texture.

    The texture does not include what the lines lose of the slow part: noise in its place would
    leave the deadband.
    """
    source, calibration = felt.source, felt.source.channels[0].calibration
    assert calibration is not None
    slow, bound = counts_nearest(felt.slow, calibration), bound_of(source, promise)
    lines = code_lines(replace(source, counts=slow[:, None]), base, bound, None)
    if lines is None:
        return None
    texture = counts_nearest(felt.wanted, calibration) - slow
    unit = with_synthetic(source, texture, lines, bound)
    return unit and replace(unit, kept_as=promise.kept_as)


def ways_of(
    felt: FeltChannel, original: Channel, first_channel: int, promise: Promise
) -> Iterator[Way]:
    """All ways to code a texture."""
    step, source = felt.first_step, felt.source.channels[0]
    yield way_of_whole(felt, original, first_channel)
    finer = finer_for(source, step)
    yield way_of_lines(felt, finer, first_channel, promise)
    if felt.textured is not None:
        yield way_of_lines(felt, finer, first_channel, promise, everywhere=True)
    assert source.calibration is not None
    if step < NATIVE * float(abs(source.calibration.step)):
        yield way_of_counts(felt, source, first_channel)
        yield way_of_lines(felt, source, first_channel, promise)


NO_TEXTURE = "no texture above the threshold"
DEADBAND = "the deadband of the slow part asks for more"
FINER_WINS = "no coarser step is smaller"
THRESHOLD = "errors stay below the threshold"


def reported(unit: Unit, felt: FeltChannel, samples: Doubles, why: str) -> Unit:
    """With the quality that was reached, and why that is another one than was asked for."""
    missed = felt.measure.note or ("" if felt.measure.close(samples) else why)
    return replace(unit, reached=felt.measure.value(samples), missed=missed)


def decoded(unit: Unit) -> Doubles:
    """What the decoder makes of a unit of one channel, in its unit."""
    affine = unit.base.track.components[0].calibration
    counts = decode_all(unit.base, 1)
    return Calibration(affine.a, affine.b, affine.d).physical(counts[:, 0])


def widest(way: Way, felt: FeltChannel) -> CodedTrial | None:
    """The trial of the widest step that keeps the promise, by bisection on decoded samples.

    The error grows about as a power of the step, so that each try interpolates the logarithms.
    None where the way has no step that is fine enough.
    """
    allowed = felt.measure.allowed
    step, most = felt.first_step, float(np.ptp(felt.x))
    low = high = best = None
    for _ in range(SEARCHED):
        trial = way(step)
        if trial is None:
            break
        if trial.step in (low and low[0], high and high[0]):
            break
        step = trial.step
        error = felt.measure.error(trial.samples)
        if error <= allowed:
            low, best = (step, error), trial
            if error >= NEAR * allowed or step >= most:
                break
        else:
            high = (step, error)
        if low and high and high[0] <= low[0] * 1.0005:
            break
        step = min(next_step(low, high, allowed * (1 + NEAR) / 2), max(most, step))
    if best is None or felt.slow_holds(best.samples):
        return best
    assert low
    return narrower(way, felt, low[0])


def narrower(way: Way, felt: FeltChannel, wide: float) -> CodedTrial | None:
    """The trial of the widest step below ``wide`` whose slow part keeps the deadband."""
    found = None
    for _ in range(TRIES):
        trial = way(wide * NARROWER)
        if trial is None:
            return None
        if felt.slow_holds(trial.samples):
            found = replace(trial, limited=True)
            break
        wide *= NARROWER
    low = wide * NARROWER
    for _ in range(HALVINGS if found else 0):
        trial = way(middle := sqrt(low * wide))
        if trial is not None and felt.slow_holds(trial.samples):
            low, found = middle, replace(trial, limited=True)
        else:
            wide = middle
    return found


def next_step(
    low: tuple[float, float] | None, high: tuple[float, float] | None, wanted: float
) -> float:
    """The step that about has the error that is wanted. low, high: a step that is too narrow or
    right, one that is too wide, and their errors."""
    if low and high:
        (a, error_a), (b, error_b) = low, high
        share = 0.5
        if 0 < error_a < error_b:
            share = min(max(log(wanted / error_a) / log(error_b / error_a), 0.1), 0.9)
        return a * exp(share * log(b / a))
    step, error = low or high or (1.0, wanted)
    factor = sqrt(wanted / error) if error else FACTOR
    return step * (min(max(factor, 1.003), FACTOR) if low else max(min(factor, 0.997), 1 / FACTOR))


def way_of_whole(felt: FeltChannel, original: Channel, first_channel: int) -> Way:
    """The whole signal, predicted on a uniform grid."""
    if original.is_counts or felt.textured is not None:
        channel = felt.source.channels[0]
        return way_of_counts(felt, finer_for(channel, felt.first_step), first_channel)
    search = LatticeSearch(original.stored)

    def way(step: float) -> CodedTrial | None:
        own = on_uniform_grid(original, step / 2, search)
        if own is None:
            return None
        channel = own[0]
        assert channel.calibration is not None
        text = f"prediction on a uniform grid of {float(channel.calibration.step):.4g} "

        def code(smallest: int | None) -> Unit | None:
            source = InputBlock((channel,), channel.stored[:, None], felt.source.spans)
            track = whole_range(source, first_channel)
            coded = code_grid(source, track, LpcParameters(), nearest_uniform, smallest)
            if coded is None:
                return None
            reason = text + original.unit
            return Unit(coded, None, "predicted", reason, exact=True, channels=source.channels)

        samples = channel.calibration.physical(channel.stored)
        return CodedTrial(float(channel.calibration.step), samples, code)

    return way


def finer_for(channel: Channel, step: float) -> Channel:
    """The channel in counts of which the step has many; as it is where they do not fit."""
    calibration = channel.calibration
    assert calibration is not None
    times = min(ceil(FINER * float(abs(calibration.step)) / step), FINEST)
    while times > 1:
        with suppress(ParameterError):  # a large offset leaves no room for finer counts
            finer = in_finer_counts(channel, times)
            low, high = declared_range(finer.stored)
            fits = finer.calibration and finer.calibration.covers(low, high)
            if fits and low >= -(1 << 31) and high < 1 << 31:
                return finer
        times //= 2
    return channel


def way_of_counts(felt: FeltChannel, channel: Channel, first_channel: int) -> Way:
    """The whole signal, in steps of whole counts."""
    calibration = channel.calibration
    assert calibration is not None
    count = float(abs(calibration.step))
    stored = channel.stored.astype(np.int64)
    wanted = stored if felt.textured is None else counts_nearest(felt.wanted, calibration)
    whole = InputBlock((channel,), wanted[:, None], felt.source.spans)
    track = whole_range(replace(whole, counts=stored[:, None]), first_channel)
    low, high = track.count_min, track.count_max

    def way(step: float) -> CodedTrial | None:
        grid = LpcParameters(clamp(round(step / count), 1, STEP_LIMIT))
        y = np.clip(nearest_uniform(wanted, grid) * grid.step, low, high)

        def code(smallest: int | None) -> Unit | None:
            coded = code_grid(whole, track, grid, nearest_uniform, smallest)
            if coded is None:
                return None
            error = int(np.abs(y - stored).max(initial=0))
            if error:
                coded.track = replace(coded.track, contract=uniform(error, calibration))
            reason = f"prediction on a uniform grid of {count * grid.step:.4g} {channel.unit}"
            return Unit(coded, None, "predicted", reason, exact=not error, channels=(channel,))

        return CodedTrial(count * grid.step, calibration.physical(y), code)

    return way


def way_of_lines(
    felt: FeltChannel,
    channel: Channel,
    first_channel: int,
    promise: Promise,
    *,
    everywhere: bool = False,
) -> Way:
    """Lines for the slow part, and what they leave predicted on a uniform grid; ``everywhere``:
    also in silent stretches, where lines alone may leave the deadband at the ends."""
    calibration = channel.calibration
    assert calibration is not None
    stored = channel.stored.astype(np.int64)
    source = replace(felt.source, channels=(channel,), counts=stored[:, None])
    base = whole_range(source, first_channel)
    calm = replace(source, counts=counts_nearest(felt.slow, calibration)[:, None])
    lines = code_lines(calm, base, bound_of(source, promise), None)
    if lines is None:
        return lambda _step: None
    d = decode_all(lines, 1)[:, 0]
    wanted = stored if felt.textured is None else counts_nearest(felt.wanted, calibration)
    residual = wanted - d
    if felt.textured is not None and not everywhere:
        residual[~felt.textured] = 0
    count = float(abs(calibration.step))

    def way(step: float) -> CodedTrial | None:
        grid = LpcParameters(clamp(round(step / count), 1, STEP_LIMIT))
        levels = nearest_uniform(residual, grid) * grid.step
        y = np.clip(d + levels, base.count_min, base.count_max)
        return CodedTrial(
            count * grid.step,
            calibration.physical(y),
            lambda smallest: with_predicted(source, lines, levels, grid, y, smallest),
        )

    return way


def uniform(error: int, calibration: Calibration) -> Contract:
    """The contract that no sample is further off than ``error`` counts."""
    zero = clamp(calibration.zero, -ZERO_LIMIT, ZERO_LIMIT - 1)
    return Contract(0, 1, False, True, (error,), (zero,))


def counts_nearest(x: Doubles, calibration: Calibration) -> NDArray[np.int64]:
    exact = (x * calibration.d - calibration.b) / calibration.a
    return np.floor(exact + 0.5).astype(np.int64)


def with_predicted(
    source: InputBlock,
    lines: Coded,
    levels: NDArray[np.int64],
    grid: LpcParameters,
    y: NDArray[np.int64],
    smallest: int | None,
) -> Unit | None:
    """The LF track of lines with an HF track of LPCR; None where it is not the smaller."""
    channel = source.channels[0]
    assert channel.calibration is not None
    low, high = declared_range(levels)
    widest = 1 << (ENCODE_LEVEL.residual_bits - 1)
    if low < -widest or high >= widest:
        return None
    if max(-low, high) * abs(channel.calibration.a) > EXACT_LIMIT:
        return None
    slow = replace(lines, track=replace(lines.track, kind="lf"))
    track = replace(
        slow.track, kind="hf", codec="LPCR", parameters=grid.build(), count_min=low,
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
    error = int(np.abs(source.counts[:, 0] - y).max(initial=0))  # "exact" is of one track alone
    fast.track = replace(fast.track, contract=uniform(max(error, 1), channel.calibration))
    step = float(abs(channel.calibration.step)) * grid.step
    reason = f"lines, and prediction of the rest on a uniform grid of {step:.4g} {channel.unit}"
    return Unit(slow, fast, "lines + predicted", reason, channels=source.channels)
