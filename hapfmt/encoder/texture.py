"""Channels whose texture is kept to a stated quality, and whose slow part keeps the deadband.

Ways to code a texture are tried: the whole signal on one uniform grid, or lines for the slow part
and the rest on a uniform grid. Each way is a function of the step. For each way the encoder looks
for the widest step whose decoded samples have the quality. The smallest result wins. So all ways
are compared at one quality, as a decoder hears it.

Weber's fraction is a law of slow forces: people feel a vibration far below it. So only the absolute
threshold decides whether there is a texture, and whether an error needs to be smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from math import exp, inf, log, log2, sqrt

import numpy as np

from ..metrics import texture_levels_db
from ..recording import Calibration, Channel
from .bounded import code_lines, encode_bounded
from .effort import Effort
from .felt import Doubles, FeltChannel, counts_nearest, slow_of
from .plan import Promise
from .predict import quick_estimate
from .quality import NoiseMeasure, ThresholdMeasure
from .settings import NO_TEXTURE
from .source import InputBlock
from .synthetic import with_synthetic
from .unit import Unit, bound_of, decode_all, in_coarser_counts, whole_range
from .ways import CodedTrial, Way, other_ways, predicted_ways

NARROWER, JUMPS, TRIES = 0.8, 5.0, 16
"""Where the slow part leaves its deadband, the step becomes NARROWER, or where that is far off as
narrow as leaves it JUMPS times. The interval to a step that leaves it is halved once."""

NEAR = 0.99
"""The search for a step ends where the error is at least this share of the largest allowed one."""

QUIETER = (Fraction(1), Fraction(1, 4), Fraction(1, 16), Fraction(1, 64))
"""Shares of the deadband that lines below a synthetic texture keep: the first one whose lines are
6 dB quieter than the texture above the split frequency. Lines of a wide deadband have kinks."""

MODEL_COUNTS = 1 << 20
"""Largest texture in counts that a model is made of. Its gain ends at 3.5 million counts, and its
filter at 33 million (SPEC 9.10)."""

HOPE = 1.1
"""A transform is left out where its estimated size is this many times the best one's. Transforms
take 0.92 of the estimate and more (50 recorded channels, measured)."""

ALIKE = 1.15
"""Grids are tried whose estimated sizes are at most this many times the smallest one's."""

PAYS, PAYS_MORE = 0.25, 0.15
"""Bits a sample, and share of those of the grid, that a transform may save at one mean error."""

NARROWER_ESTIMATE = 0.97

LEAST_POWER, MOST_POWER = 0.3, 6.0

SEARCHED, FACTOR = 24, 4.0
"""Most steps that a search tries, and the largest factor from one to the next."""


def encode_textured(
    source: InputBlock,
    original: Channel,
    first_channel: int,
    promise: Promise,
    cutoff_hz: float,
    searches: Effort,
) -> Unit | None:
    """The smallest way found. source: one channel on a fine grid. None: no grid has the quality."""
    base = whole_range(source, first_channel)
    felt = FeltChannel.of(original.samples(), source, promise, cutoff_hz)
    target = promise.texture
    assert target is not None
    if felt.silent if target.drops_silence else felt.smooth:
        alone = encode_bounded(source, base, promise, effort=searches)
        assert alone
        return replace(alone, missed=NO_TEXTURE)
    if target.synthetic:
        return encode_synthetic(felt, first_channel, promise)
    best = fallback = None
    if felt.fine and target.threshold_is_enough:
        promise = replace(promise, k=Fraction(0))
        measure = felt.measure
        assert isinstance(measure, NoiseMeasure)  # an ST-SIM is kept whatever the threshold is
        felt = replace(felt, measure=ThresholdMeasure(measure, measure.x, felt.floor))
    of_threshold = felt.threshold_decides
    if of_threshold or felt.deadband_may_do:
        alone = encode_bounded(source, base, promise, effort=searches)
        assert alone
        samples = decoded(alone)
        if felt.holds(samples):
            fallback = reported(alone, felt, samples, THRESHOLD if of_threshold else DEADBAND)
        if target.codec != "MDCT" or alone.base.track.codec != "LPCR":
            best = fallback
        if of_threshold and not pays(felt, alone.size) and not target.codec:
            return best
    ways = predicted_ways(felt, original, first_channel, promise)
    trials = [trial for way in ways if (trial := widest(way, felt))]
    best = smallest_of(trials, felt, best)
    if trials and not trials[0].limited:
        felt = replace(felt, measure=felt.measure.known(trials[0].samples))
    for way in other_ways(felt, original, first_channel, promise, searches):
        hopeless = best and way.bits is not None and way.bits > HOPE * 8 * best.cost
        if not (hopeless and target.codec is None) and (trial := widest(way, felt)):
            best = coded(trial, felt, best)
    return best or fallback


def pays(felt: FeltChannel, size: int) -> bool:
    """Whether a transform may take fewer bytes than a grid on which each error is below the
    threshold, although its errors have larger peaks."""
    more = log2(felt.floor**2 / 3 / (felt.power * felt.measure.noise)) / 2
    return more < PAYS + PAYS_MORE * 8 * size / max(felt.x.size, 1)


def smallest_of(trials: Sequence[CodedTrial], felt: FeltChannel, best: Unit | None) -> Unit | None:
    """The best so far, or one of these trials that about take the fewest bits."""
    bits = [bits_of(trial, felt) if len(trials) > 1 else 0.0 for trial in trials]
    for trial, each in zip(trials, bits, strict=True):
        if each <= ALIKE * min(bits):
            best = coded(trial, felt, best)
    return best


def bits_of(trial: CodedTrial, felt: FeltChannel) -> float:
    assert trial.indices is not None
    return sum(quick_estimate(rows) for _, rows in felt.source.pieces(trial.indices))


def coded(trial: CodedTrial, felt: FeltChannel, best: Unit | None) -> Unit | None:
    """The best so far, or this trial where it is smaller."""
    unit = trial.code(best.cost if best else None)
    if unit is None or (best and unit.cost >= best.cost):
        return best
    why = DEADBAND if trial.limited else FINER_WINS
    return reported(unit, felt, trial.samples, THRESHOLD if felt.threshold_decides else why)


def encode_synthetic(felt: FeltChannel, first_channel: int, promise: Promise) -> Unit | None:
    """Lines for the slow part, and a model of the texture. None: no grid holds both.

    The texture does not include what the lines lose of the slow part: noise in its place would
    leave the deadband.
    """
    source = for_a_model(felt)
    calibration = source.channels[0].calibration
    assert calibration is not None and promise.floor is not None
    base = whole_range(source, first_channel)
    slow, lines = counts_nearest(felt.slow, calibration), None
    for part in QUIETER:
        floor = replace(promise.floor, value=promise.floor.value * float(part))
        bound = bound_of(source, replace(promise, k=promise.k * part, floor=floor))
        narrower = code_lines(replace(source, counts=slow[:, None]), base, bound, None)
        if narrower is None:
            break
        lines = narrower
        error = calibration.physical(decode_all(lines, 1)[:, 0]) - felt.slow
        if (error - slow_of(error, source, felt.cutoff_hz)).var() <= felt.power / 4:
            break
    if lines is None:
        return None
    texture = counts_nearest(felt.wanted, calibration) - slow
    unit = with_synthetic(source, texture, lines, bound_of(source, promise))
    if unit is None:
        return None
    assert unit.residual
    y = calibration.physical(decode_all(unit.base, 1)[:, 0] + decode_all(unit.residual, 1)[:, 0])
    return replace(unit, reached=levels_of(felt, y))


def for_a_model(felt: FeltChannel) -> InputBlock:
    """The channel on a grid whose counts a model of the texture can reach."""
    source, times = felt.source, 1
    calibration = source.channels[0].calibration
    assert calibration is not None
    largest = float(np.abs(felt.wanted - felt.slow).max()) / float(abs(calibration.step))
    while largest > MODEL_COUNTS * times:
        times *= 2
    if times == 1:
        return source
    channel = in_coarser_counts(source.channels[0], times)
    return replace(source, channels=(channel,), counts=channel.stored[:, None])


def levels_of(felt: FeltChannel, y: Doubles) -> dict[str, float]:
    """How loud the decoded texture is, of the longest run."""
    rows = max(felt.source.segments(), key=lambda rows: rows.stop - rows.start)
    whole, bands = texture_levels_db(felt.x[rows], y[rows], float(felt.source.rate))
    if not bands:
        return {}
    low, high, db = max(bands, key=lambda each: abs(each.db))
    return {"level_db": whole, "band_db": db, "band_low_hz": low, "band_high_hz": high}


DEADBAND = "the deadband of the slow part asks for more"
FINER_WINS = "no coarser step is smaller"
THRESHOLD = "errors stay below the threshold"


def reported(unit: Unit, felt: FeltChannel, samples: Doubles, why: str) -> Unit:
    """With the quality that was reached, and why that is another one than was asked for."""
    reached = felt.measure.value(samples)
    missed = felt.measure.note or ("" if felt.measure.close(reached) else why)
    return replace(unit, reached=reached, missed=missed)


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
    step, most = way.first, float(np.ptp(felt.x))
    costly = way.costly or felt.measure.costly
    near = felt.measure.near if costly else NEAR
    low = high = best = before = None
    bias, power = 1.0, 2.0
    for _ in range(SEARCHED // 2 if costly else SEARCHED):
        trial = way.at(step)
        if trial is None:
            break
        if trial.step in (low and low[0], high and high[0]):
            break
        step = trial.step
        known = None if trial.noise is None else felt.measure.error_of(trial.noise)
        error = inf if known is None else bias * known
        if known is None or near * allowed <= error <= allowed:
            error = felt.measure.error(trial.samples)
            bias = error / known if known else 1.0
        if error <= allowed:
            low, best = (step, error), trial
            if error >= near * allowed or step >= most:
                break
        else:
            high = (step, error)
        if low and high and high[0] <= low[0] * 1.0005:
            break
        if way.costly and low and high and not is_plausible(power_of(low, high)):
            # Other classes of the entropy coder have another error.
            low, high = (low, None) if error <= allowed else (None, high)
        grown = power_of(before, (step, error)) if before else power
        power = grown if is_plausible(grown) else power
        before = step, error
        step = min(next_step(low, high, allowed * (1 + near) / 2, power), max(most, step))
    for _ in range(TRIES):
        if best is None or felt.measure.error(best.samples) <= allowed:
            break
        # An estimate was too low.
        best = way.at(NARROWER_ESTIMATE * best.step)
    else:
        return None
    if best is None:
        return None
    excess = felt.slow_excess(best.samples)
    if excess <= 1:
        return best
    steadier = way.steadier(best.step, excess) if way.steadier else None
    return widest(steadier, felt) if steadier else narrower(way, felt, best.step, excess)


def narrower(way: Way, felt: FeltChannel, wide: float, excess: float) -> CodedTrial | None:
    """The trial of about the widest step below ``wide`` whose slow part keeps the deadband.

    excess: by how much it leaves it at ``wide``. It grows about as the step, but jumps.
    """
    found, low = None, 0.0
    for _ in range(TRIES):
        step = sqrt(low * wide) if low else wide * min(NARROWER, JUMPS / excess)
        trial = way.at(step)
        if trial is None or trial.step in (low, wide):
            break
        excess = felt.slow_excess(trial.samples)
        if excess > 1:
            wide = trial.step
        else:
            halved, low, found = bool(low), trial.step, replace(trial, limited=True)
            if halved or excess >= NEAR:
                break
    return found


def power_of(one: tuple[float, float], other: tuple[float, float]) -> float:
    """The power of the step by which the error grows; 0 where it does not."""
    if min(one[1], other[1]) <= 0 or one[0] == other[0]:
        return 0.0
    return log(one[1] / other[1]) / log(one[0] / other[0])


def is_plausible(power: float) -> bool:
    """Whether the error of one quantiser may grow so."""
    return LEAST_POWER < power < MOST_POWER


def next_step(
    low: tuple[float, float] | None,
    high: tuple[float, float] | None,
    wanted: float,
    power: float = 2.0,
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
    factor = (wanted / error) ** (1 / power) if error else 2.0
    return step * (min(max(factor, 1.003), FACTOR) if low else max(min(factor, 0.997), 1 / FACTOR))
