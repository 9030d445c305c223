"""Ways to code a texture: each gives, for a step, the decoded samples and how to code them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, log2, sqrt
from typing import NamedTuple

import numpy as np

from ..codecs.grids import LpcParameters
from ..codecs.predicted import join_components
from ..codecs.transform import (
    BLOCKS,
    UNIT,
    WEIGHT_ONE,
    WEIGHTS_LIMIT,
    TransformParameters,
    parse_header,
)
from ..codecs.transform import STEP_LIMIT as STEP_MOST
from ..errors import ParameterError
from ..format.cluster import Packet
from ..format.track import Component, Contract, Track
from ..limits import EXACT_LIMIT, ZERO_LIMIT
from ..metrics import vibrotactile_threshold
from ..numbers import clamp
from ..recording import Calibration, Channel, Span
from .bounded import code_grid, code_lines
from .felt import Doubles, FeltChannel, counts_nearest
from .gridded import Indices, nearest_uniform
from .knots import Coded
from .lattice import LatticeSearch, on_uniform_grid
from .plan import Promise
from .predict import encode_best
from .source import InputBlock, declared_range
from .transform import encode_coefficients, forward
from .unit import (
    ENCODE_LEVEL,
    STEP_LIMIT,
    Unit,
    bound_of,
    decode_all,
    in_finer_counts,
    whole_range,
)

FINER = 128
"""Counts of a step: rounding it to whole counts then changes the quality by less than 0.1 dB."""

FINEST = 4 * FINER
"""Counts that one count of the source is divided into at most."""

TRELLIS_NOISE, TRELLIS_ZERO = 0.24, 1.3
"""Mean squared error of a coefficient in squares of the step, which is 1/3 without a trellis. And
how many steps a coefficient is smaller than that becomes 0. Both are measured."""

SLOW_BAND = 2
"""Coefficients up to this many times the split frequency decide whether the slow part keeps its
deadband."""

STEP_HALVINGS = 12

FREE_TRIALS = 2

NATIVE = 4
"""A step of fewer counts of the source is tried in whole counts too: a source with few distinct
values, such as the difference of encoder counts, loses nothing on its own grid."""


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


@dataclass(frozen=True)
class Way:
    """A way to code a texture: a function of the step of a uniform grid, in the channel's unit.

    The function gives None where there is no such step. ``first``: the step to begin with.
    ``costly``: each trial codes the channel. ``steadier``: a way with smaller errors of the slow
    part, from the step to begin with; None: there is none.
    """

    at: Callable[[float], CodedTrial | None]
    first: float
    costly: bool = False
    steadier: Callable[[float], Way] | None = None


def ways_of(
    felt: FeltChannel, original: Channel, first_channel: int, promise: Promise
) -> Iterator[Way]:
    """All ways to code a texture, or those of the only codec that was asked for."""
    assert promise.texture is not None
    codec = promise.texture.codec
    asked = codec == "MDCT" or promise.texture.weighting > 0
    predicted, transformed = codec != "MDCT", asked or codec is None
    step, source = felt.first_step, felt.source.channels[0]
    finer = coarser_for(original, source, step) or finer_for(source, step)
    if predicted:
        yield way_of_whole(felt, original, first_channel)
    if transformed:
        yield way_of_transform(felt, finer, first_channel)
    for everywhere in (False, True) if felt.textured is not None else (False,):
        split = split_of(felt, finer, first_channel, promise, everywhere=everywhere)
        if split and predicted:
            yield way_of_lines(felt, split)
        if split and transformed:
            yield way_of_lines_and_transform(felt, split)
    assert source.calibration is not None
    if predicted and step < NATIVE * float(abs(source.calibration.step)):
        yield way_of_counts(felt, source, first_channel)
        split = split_of(felt, source, first_channel, promise)
        if split:
            yield way_of_lines(felt, split)


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

    return Way(way, felt.first_step)


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


def coarser_for(original: Channel, channel: Channel, step: float) -> Channel | None:
    """Floating-point values on a coarser grid, where theirs is far finer than the step: counts of
    29 bits are too large for MDCT. None: the grid suits."""
    assert channel.calibration is not None
    if original.is_counts or step < FINEST * float(abs(channel.calibration.step)):
        return None
    found = on_uniform_grid(original, step / FINER / 2)
    return found and found[0]


def way_of_counts(felt: FeltChannel, channel: Channel, first_channel: int) -> Way:
    """The whole signal, in steps of whole counts."""
    calibration = channel.calibration
    assert calibration is not None
    count = float(abs(calibration.step))
    stored = channel.stored.astype(np.int64)
    wanted = felt.wanted_counts(channel)
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
            error = furthest(y, stored, felt.x, calibration) if (y != stored).any() else 0
            if error:
                coded.track = replace(coded.track, contract=uniform(error, calibration))
            reason = f"prediction on a uniform grid of {count * grid.step:.4g} {channel.unit}"
            return Unit(coded, None, "predicted", reason, exact=not error, channels=(channel,))

        return CodedTrial(count * grid.step, calibration.physical(y), code)

    return Way(way, felt.first_step)


@dataclass(frozen=True)
class Split:
    """Lines for the slow part of a channel, and what they leave."""

    source: InputBlock
    lines: Coded
    decoded: Indices
    """Counts of the lines."""
    residual: Indices

    @property
    def calibration(self) -> Calibration:
        calibration = self.source.channels[0].calibration
        assert calibration is not None
        return calibration

    def with_residual(self, levels: Indices) -> Indices:
        """Counts of the channel, of a decoded residual."""
        track = self.lines.track
        counts: Indices = np.clip(self.decoded + levels, track.count_min, track.count_max)
        return counts

    def residual_track(self, codec: str, parameters: bytes, values: Indices) -> Track | None:
        """The track of the residual; None where its range is too wide."""
        low, high = declared_range(values)
        widest = 1 << (ENCODE_LEVEL.residual_bits - 1)
        if low < -widest or high >= widest:
            return None
        if max(-low, high) * abs(self.calibration.a) > EXACT_LIMIT:
            return None
        return replace(
            self.lines.track, kind="hf", codec=codec, parameters=parameters, count_min=low,
            count_max=high, base=0, components=(Component(),),
        )  # fmt: skip

    def unit(self, fast: Coded, y: Indices, chosen: str, reason: str) -> Unit:
        """Both tracks. y: counts of the channel as decoded."""
        # Only a single track is called exact, so that an error of 0 has a contract too.
        error = max(int(np.abs(self.source.counts[:, 0] - y).max(initial=0)), 1)
        fast.track = replace(fast.track, contract=uniform(error, self.calibration))
        slow = replace(self.lines, track=replace(self.lines.track, kind="lf"))
        return Unit(slow, fast, chosen, reason, channels=self.source.channels)


def split_of(
    felt: FeltChannel,
    channel: Channel,
    first_channel: int,
    promise: Promise,
    *,
    everywhere: bool = False,
) -> Split | None:
    """None where the deadband reaches beyond the largest count. ``everywhere``: a residual also in
    silent stretches, where lines alone may leave the deadband at the ends."""
    calibration = channel.calibration
    assert calibration is not None
    stored = channel.stored.astype(np.int64)
    source = replace(felt.source, channels=(channel,), counts=stored[:, None])
    base = whole_range(source, first_channel)
    calm = replace(source, counts=counts_nearest(felt.slow, calibration)[:, None])
    lines = code_lines(calm, base, bound_of(source, promise), None)
    if lines is None:
        return None
    d = decode_all(lines, 1)[:, 0]
    residual = felt.wanted_counts(channel) - d
    if felt.textured is not None and not everywhere:
        residual[~felt.textured] = 0
    return Split(source, lines, d, residual)


def way_of_lines(felt: FeltChannel, split: Split) -> Way:
    """Lines for the slow part, and what they leave predicted on a uniform grid."""
    calibration = split.calibration
    count = float(abs(calibration.step))

    def way(step: float) -> CodedTrial | None:
        grid = LpcParameters(clamp(round(step / count), 1, STEP_LIMIT))
        levels = nearest_uniform(split.residual, grid) * grid.step
        y = split.with_residual(levels)

        def code(smallest: int | None) -> Unit | None:
            track = split.residual_track("LPCR", grid.build(), levels)
            if track is None:
                return None
            fast = Coded(track)
            size = split.lines.size + fast.size
            for span, rows in split.source.pieces(levels):
                data = encode_best(nearest_uniform(rows, grid))
                size += len(data)
                if smallest is not None and size >= smallest:
                    return None
                fast.packets.append(Packet(0, span.start, span.ticks, data))
            text = f"{count * grid.step:.4g} {split.source.channels[0].unit}"
            reason = f"lines, and prediction of the rest on a uniform grid of {text}"
            return split.unit(fast, y, "lines + predicted", reason)

        return CodedTrial(count * grid.step, calibration.physical(y), code)

    return Way(way, felt.first_step)


def way_of_transform(felt: FeltChannel, channel: Channel, first_channel: int) -> Way:
    """The whole signal by MDCT."""
    calibration = channel.calibration
    assert calibration is not None
    count = float(abs(calibration.step))
    stored = channel.stored.astype(np.int64)
    whole = InputBlock((channel,), felt.wanted_counts(channel)[:, None], felt.source.spans)
    track = whole_range(replace(whole, counts=stored[:, None]), first_channel)
    lapped = Lapped(felt, whole, count)

    def way(weight: int, step: float) -> CodedTrial | None:
        coded = lapped.code(track, step, weight)
        if coded is None:
            return None
        y = decode_all(coded, 1)[:, 0]
        error = max(furthest(y, stored, felt.x, calibration), 1)
        coded.track = replace(coded.track, contract=uniform(error, calibration))
        unit = Unit(coded, None, "transformed", lapped.text(step, channel), channels=(channel,))
        return CodedTrial(step, calibration.physical(y), lambda _smallest: unit)

    return weighted(way, lapped.first)


def way_of_lines_and_transform(felt: FeltChannel, split: Split) -> Way:
    """Lines for the slow part, and what they leave by MDCT."""
    calibration = split.calibration
    rest = replace(split.source, counts=split.residual[:, None])
    lapped = Lapped(felt, rest, float(abs(calibration.step)))
    track = split.residual_track("MDCT", b"", split.residual)

    def way(weight: int, step: float) -> CodedTrial | None:
        fast = lapped.code(track, step, weight) if track else None
        if fast is None:
            return None
        y = split.with_residual(decode_all(fast, 1)[:, 0])
        reason = f"lines, and {lapped.text(step, split.source.channels[0])} for the rest"
        unit = split.unit(fast, y, "lines + transformed", reason)
        return CodedTrial(step, calibration.physical(y), lambda _smallest: unit)

    return weighted(way, lapped.first)


def weighted(
    way: Callable[[int, float], CodedTrial | None], first: float, weight: int = WEIGHT_ONE
) -> Way:
    """A way by MDCT, and after it those with smaller weights of slow coefficients."""

    def steadier(step: float) -> Way:
        return weighted(way, step, weight // 4)

    return Way(partial(way, weight), first, True, steadier if weight >= 4 else None)


class Lapped:
    """Counts to be coded by MDCT: the block that suits them, and their coefficients."""

    def __init__(self, felt: FeltChannel, source: InputBlock, count: float) -> None:
        """The block whose coefficients take the fewest bits, about. count: in the unit."""
        self.felt, self.count, self.rate = felt, count, float(source.rate)
        noise = (felt.first_step / count) ** 2 / 12
        found = []
        for size in BLOCKS:
            blocks = list(blocks_of(source, size))
            sizes = np.abs(np.concatenate([block.coefficients for block in blocks])) / UNIT
            step = step_for(sizes, noise)
            found.append((float(np.log2(1 + sizes / step).sum()), size, step, blocks))
        _, self.size, step, self.blocks = min(found, key=lambda each: each[0])
        self.first = step * sqrt(2 * self.size) * count
        """The step of a uniform grid with about the same error, in the unit."""
        self.classes: list[int | None] = [None] * len(self.blocks)
        self.trials = 0

    def parameters(self, step: float, weight: int = WEIGHT_ONE) -> TransformParameters:
        counts = step / self.count / sqrt(2 * self.size)
        even = weight == WEIGHT_ONE and not self.felt.weighting
        weights = b"" if even else self.weights(weight)
        return TransformParameters(self.size, clamp(round(UNIT * counts), 1, STEP_MOST), weights)

    def weights(self, weight: int) -> bytes:
        """Weights of bands: the steps that a person feels alike, times the weight for bands that
        begin below SLOW_BAND times the split frequency."""
        slow = SLOW_BAND * self.felt.cutoff_hz
        bands = min(self.size, WEIGHTS_LIMIT)
        if not self.felt.weighting:
            bands = min(1 << ceil(log2(max(self.rate / slow, 2))), bands)
        width = self.rate / 2 / bands
        factors = self.thresholds(np.arange(0.5, bands) * width) ** self.felt.weighting
        factors[: min(ceil(slow / width), bands)] *= weight / WEIGHT_ONE
        return bytes(np.clip(np.rint(WEIGHT_ONE * factors), 0, 255).astype(np.uint8))

    def thresholds(self, hz: Doubles) -> Doubles:
        """Thresholds of vibration, as multiples of the least one. Frequencies below the split
        frequency take its threshold, because the curve holds for vibrations only."""
        found = vibrotactile_threshold(np.maximum(hz, self.felt.cutoff_hz), self.felt.moves)
        return np.asarray(found / found.min())

    def code(self, track: Track, step: float, weight: int) -> Coded | None:
        """None where coefficients are too large for the codec.

        The classes of the entropy coder follow the step for a few trials. Then they stay: where
        they jump, the trellis finds another error.
        """
        parameters = self.parameters(step, weight)
        coded = Coded(replace(track, codec="MDCT", parameters=parameters.build()))
        classes = self.classes if self.trials >= FREE_TRIALS else [None] * len(self.blocks)
        self.trials += 1
        for place, (block, known) in enumerate(zip(self.blocks, classes, strict=True)):
            try:
                data = encode_coefficients(
                    block.base, block.coefficients, parameters, classes=known
                )
            except ValueError:
                return None
            header, _ = parse_header(data, self.size, ENCODE_LEVEL, 0)
            self.classes[place] = header.classes if header.kept else known
            packet = join_components([data])
            coded.packets.append(Packet(0, block.span.start, block.span.ticks, packet))
        return coded

    def text(self, step: float, channel: Channel) -> str:
        amount = self.parameters(step).step / UNIT * self.count
        return f"a transform with blocks of {self.size} and steps of {amount:.4g} {channel.unit}"


class Transformed(NamedTuple):
    """A packet's samples: a count near most of them, and the coefficients [blocks, size] of what
    they are away from it, in 256ths of a count."""

    span: Span
    base: int
    coefficients: Doubles


def blocks_of(source: InputBlock, size: int) -> Iterator[Transformed]:
    for span, rows in source.pieces(source.counts):
        x = rows[:, 0].astype(np.float64)
        base = int(np.floor(np.median(x) + 0.5))
        yield Transformed(span, base, forward(x - base, size))


def step_for(sizes: Doubles, noise: float) -> float:
    """The step in counts with about this mean squared error: that of a quantiser, or all of a
    coefficient that becomes 0."""
    middle = sqrt(6 * noise / sizes.shape[1])
    low, high = middle / 4, middle * 16
    for _ in range(STEP_HALVINGS):
        middle = sqrt(low * high)
        zero = sizes < TRELLIS_ZERO * middle
        error = np.where(zero, sizes * sizes, TRELLIS_NOISE * middle**2)
        low, high = (middle, high) if error.sum(axis=1).mean() / 2 < noise else (low, middle)
    return low


def furthest(y: Indices, stored: Indices, x: Doubles, calibration: Calibration) -> int:
    """Return the largest error in counts, of the prepared counts and of those nearest to x.

    On a finer grid than that of the prepared counts, the two differ by the deviation.
    """
    nearest = counts_nearest(x, calibration)
    return max(int(np.abs(y - counts).max(initial=0)) for counts in (stored, nearest))


def uniform(error: int, calibration: Calibration) -> Contract:
    """The contract that no sample is further off than ``error`` counts."""
    zero = clamp(calibration.zero, -ZERO_LIMIT, ZERO_LIMIT - 1)
    return Contract(0, 1, False, True, (error,), (zero,))
