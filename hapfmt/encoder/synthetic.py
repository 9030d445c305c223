"""Texture from a model: what is above the slow part as noise with its spectrum and its gain.

The model of a block is all-pole, by Burg's method. It predicts each sample from those before it;
the noise has the power of the prediction errors. Textures of single impulses have errors of a high
kurtosis. Their noise is a pulse at few ticks.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log2

import numpy as np
from numpy.typing import NDArray

from ..codecs.noise import COEFFICIENT_LIMIT, GAIN_LIMIT, NoiseParameters, encode_component
from ..codecs.predicted import SINES
from ..format.cluster import Packet
from ..format.track import Component, Track
from ..limits import EXACT_LIMIT
from ..recording import Span
from .knots import Coded
from .source import InputBlock, declared_range
from .unit import ENCODE_LEVEL, Bound, Unit, contract_of, decode_all

Doubles = NDArray[np.float64]

INTERVAL_S, BLOCK_S = 0.064, 1.0
"""Seconds between gains, and between spectra. The spectrum of a stroke changes slowly. Its loudness
follows the hand: half as many gains raise the error of the band energies by 0.3 dB."""

ORDERS = (8, 10, 12, 16, 20, 24, 32)
ENOUGH_DB = 0.5
"""The smallest order is taken whose prediction error is at most this much above that of the
largest. Below 8 the error of the band energies grows, and few bits are saved."""

SILENCE = 0.5
"""Share of the absolute threshold below which an interval is silent. A texture at the threshold
itself would come and go."""

LARGEST_REFLECTION = 0.9998
"""A filter that rings for longer would follow a change of the gain late."""

DENSE_KURTOSIS = 6.0
"""Prediction errors below this kurtosis are like noise at every tick; a recorded texture has 3 to
4."""

NOISE_KURTOSIS = 2.6
"""The kurtosis of noise at every tick. Pulses at a share p of ticks have 1 / p times as much."""

FRACTION = 64
"""Gain index 1 is the spread of one 64th of a count."""


@dataclass(frozen=True)
class Intervals:
    """Ticks of an interval and of a block, by the rate of the track."""

    parameters: NoiseParameters

    @classmethod
    def of(cls, rate: float) -> Intervals:
        shift = min(max(round(log2(max(rate * INTERVAL_S, 1))), 3), 12)
        intervals = min(max(round(BLOCK_S * rate / 2**shift), 64 >> shift, 1), 255)
        return cls(NoiseParameters(shift, intervals))

    @property
    def ticks(self) -> int:
        return 1 << self.parameters.shift

    @property
    def block_ticks(self) -> int:
        return self.parameters.intervals << self.parameters.shift

    def starts(self, size: int) -> range:
        """First ticks of the blocks."""
        return range(0, size, self.block_ticks)


def burg(x: Doubles, order: int) -> Doubles:
    """Reflection coefficients [order] of an all-pole model of x, in the sign of SPEC 9.5.

    J. P. Burg, "Maximum entropy spectral analysis", 37th meeting of the Society of Exploration
    Geophysicists, 1967.
    """
    ks = np.zeros(order)
    forward, backward = x[1:], x[:-1]
    for n in range(min(order, x.size - 1)):
        power = float(forward @ forward + backward @ backward)
        if power <= 0:
            break
        k = min(max(2 * float(forward @ backward) / power, -LARGEST_REFLECTION), LARGEST_REFLECTION)
        ks[n] = k
        forward, backward = (forward - k * backward)[1:], (backward - k * forward)[:-1]
    return ks


def quantised(ks: Doubles) -> list[int]:
    """The nearest entries of the sine table, by their angles."""
    most = COEFFICIENT_LIMIT
    found = np.clip(np.rint(np.arcsin(ks) * (256 / np.pi)), -most, most)
    return found.astype(np.int64).tolist()  # type: ignore[no-any-return]


def errors_of(x: Doubles, start: int, stop: int, ks: Sequence[int]) -> Doubles:
    """Prediction errors of x[start:stop], from the samples before each."""
    c = np.zeros(0)
    for index in ks:
        k = (SINES[index] if index >= 0 else -SINES[-index]) / 32768
        c = np.append(c - k * c[::-1], k)
    before = np.zeros(len(ks))
    known = x[max(start - len(ks), 0) : start]
    before[len(ks) - known.size :] = known
    whole = np.concatenate([before, x[start:stop]])
    return np.convolve(whole, np.concatenate([[1.0], -c]))[len(ks) : whole.size]


def reflections(x: Doubles, intervals: Intervals, order: int) -> list[Doubles]:
    """Reflection coefficients of each block, with a quarter of a block of its neighbours."""
    margin = intervals.block_ticks // 4
    found = []
    for start in intervals.starts(x.size):
        first, last = max(start - margin, 0), min(start + intervals.block_ticks + margin, x.size)
        if last - first < 4 * order:
            first = max(last - intervals.block_ticks, 0)
        found.append(burg(x[first:last], order))
    return found


def best_order(pieces: Sequence[list[Doubles]]) -> int:
    """By the mean over all blocks of the prediction error in dB; ``pieces``: reflection
    coefficients of the largest order."""
    ks = np.concatenate([np.array(piece).reshape(-1, ORDERS[-1]) for piece in pieces])
    loud = ks[np.abs(ks).any(axis=1)]
    if not loud.size:
        return 0
    decibels = 10 * np.log10(1 - loud**2).cumsum(axis=1).mean(axis=0)
    return next(order for order in ORDERS if decibels[order - 1] <= decibels[-1] + ENOUGH_DB)


def ends_of(x: Doubles, intervals: Intervals) -> Doubles:
    """Root mean squares [intervals] of x around the end of each interval."""
    half = intervals.ticks // 2
    sums = np.concatenate([[0.0], np.cumsum(x * x)])
    ends = np.arange(intervals.ticks, x.size + intervals.ticks, intervals.ticks)
    low = np.minimum(ends - half, max(x.size - half, 0))
    low[0] = 0
    high = np.minimum(ends + half, x.size)
    return np.asarray(np.sqrt(np.maximum(sums[high] - sums[low], 0) / np.maximum(high - low, 1)))


def envelope(ends: Doubles, intervals: Intervals, size: int) -> Doubles:
    """The gain of each tick, in a line from the end of an interval to the next (SPEC 9.10)."""
    before = np.concatenate([ends[:1], ends[:-1]])
    share = np.arange(intervals.ticks) / intervals.ticks
    lines = before[:, None] + (ends - before)[:, None] * share
    return np.asarray(lines.reshape(-1)[:size])


def gain_indices(spread: Doubles, loud: NDArray[np.bool_], density: int) -> list[int]:
    """Nearest to spreads in counts; 0 where it is not loud."""
    factor = FRACTION * (256 / density if density else 1) ** 0.5
    found = np.rint(4 * np.log2(np.maximum(spread * factor, 1e-9))).astype(np.int64) + 1
    return np.where(loud, np.clip(found, 1, GAIN_LIMIT), 0).tolist()  # type: ignore[no-any-return]


@dataclass(frozen=True)
class TextureModel:
    """A piece [ticks] in counts, its model, and the prediction errors of that."""

    x: Doubles
    blocks: list[list[int]]
    errors: Doubles
    intervals: Intervals

    @classmethod
    def of(
        cls, x: Doubles, ks: Sequence[Doubles], order: int, intervals: Intervals
    ) -> TextureModel:
        blocks = [quantised(each[:order]) for each in ks]
        parts = [
            errors_of(x, start, start + intervals.block_ticks, block)
            for start, block in zip(intervals.starts(x.size), blocks, strict=True)
        ]
        return cls(x, blocks, np.concatenate(parts), intervals)

    def normalised(self) -> Doubles:
        """Errors of spread 1, where there are any."""
        gain = envelope(ends_of(self.errors, self.intervals), self.intervals, self.x.size)
        return self.errors[gain > 0] / gain[gain > 0]

    def packet(self, floor: float, density: int, seed: int) -> bytes:
        """``floor``: the spread of a texture that is silence."""
        loud = ends_of(self.x, self.intervals) > floor
        gains = gain_indices(ends_of(self.errors, self.intervals), loud, density)
        given = self.intervals.parameters
        return encode_component(gains, self.blocks, given, seed=seed, density=density)


def density_of(errors: Doubles) -> int:
    """256ths of the ticks that have a pulse; 0: every tick has noise."""
    power = float((errors**2).mean()) if errors.size else 0.0
    kurtosis = float((errors**4).mean()) / power**2 if power else 0.0
    if kurtosis < DENSE_KURTOSIS:
        return 0
    return min(max(round(256 * NOISE_KURTOSIS / kurtosis), 1), 255)


def seed_of(channel: int, span: Span) -> int:
    """The same each time, and another one in each packet."""
    return zlib.crc32(f"{channel} {span.start}".encode())


def code_texture(
    source: InputBlock,
    texture: NDArray[np.int64],
    floor: float,
    track: Track,
    order: int | None = None,
) -> Coded:
    """Packets of NOIS for a texture [ticks] in counts. order: None, the best one."""
    intervals = Intervals.of(float(source.rate))
    pieces = [(span, rows.astype(np.float64)) for span, rows in source.pieces(texture)]
    most = ORDERS[-1] if order is None else order
    models = [reflections(x, intervals, most) for _, x in pieces]
    chosen = best_order(models) if order is None else order
    textures = [
        TextureModel.of(x, ks, chosen, intervals) for (_, x), ks in zip(pieces, models, strict=True)
    ]
    density = density_of(np.concatenate([each.normalised() for each in textures]))
    coded = Coded(replace(track, codec="NOIS", parameters=intervals.parameters.build()))
    for (span, _), each in zip(pieces, textures, strict=True):
        data = each.packet(floor, density, seed_of(track.first_channel, span))
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return coded


def with_synthetic(
    source: InputBlock,
    texture: NDArray[np.int64],
    lines: Coded,
    bound: Bound,
    *,
    order: int | None = None,
) -> Unit | None:
    """The LF track of lines, with an HF track of NOIS for the texture [ticks] above the slow part;
    None where its counts do not fit.

    The contract of the LF track is that of the slow part. It is an aim, unless every sample of the
    recording keeps it.
    """
    channel = source.channels[0]
    assert channel.calibration is not None
    x = source.counts.astype(np.int64)
    widest = 1 << (ENCODE_LEVEL.residual_bits - 1)
    template = replace(
        lines.track, kind="hf", count_min=-widest, count_max=widest - 1, base=0,
        components=(Component(),),
    )  # fmt: skip
    fast = code_texture(source, texture, SILENCE * bound.slack, template, order)
    low, high = declared_range(decode_all(fast, 1))
    if max(-low, high) * abs(channel.calibration.a) > EXACT_LIMIT:
        return None
    fast.track = replace(fast.track, count_min=low, count_max=high)
    contract = contract_of(bound.band, x, decode_all(lines, 1))
    lines.track = replace(lines.track, kind="lf", contract=contract)
    reason = "lines, and noise with the spectrum of the rest"
    return Unit(lines, fast, "lines + synthetic", reason, channels=source.channels)
