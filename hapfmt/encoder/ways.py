"""Ways to code a texture: each gives, for a step, the decoded samples and how to code them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from math import ceil, log, log2, sqrt
from typing import NamedTuple

import numpy as np

from ..codecs.grids import LpcParameters
from ..codecs.predicted import join_components
from ..codecs.transform import STEP_LIMIT as STEP_MOST
from ..codecs.transform import (
    UNIT,
    WEIGHT_ONE,
    WEIGHTS_LIMIT,
    TransformParameters,
    encode_component,
)
from ..errors import ParameterError
from ..format.cluster import Packet
from ..format.track import Component, Contract, Track
from ..limits import EXACT_LIMIT, ZERO_LIMIT
from ..metrics import vibrotactile_threshold
from ..numbers import clamp
from ..recording import Calibration, Channel, Span
from .bounded import code_grid, code_lines
from .effort import Effort
from .felt import Doubles, FeltChannel, counts_nearest
from .gridded import Indices, nearest_uniform
from .knots import Coded
from .lattice import LatticeSearch, on_uniform_grid
from .plan import Promise
from .predict import encode_best
from .source import InputBlock, declared_range
from .transform import LAMBDA, STARTS, Levels, forward, quantise, sampled
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

FIRST_SIZE = 128
"""The search for the size of blocks begins with it. By all of the samples: one in four chose sizes
that took 4 % more."""

ERROR_WEIGHT = LAMBDA / 256
"""What a bit counts for, in squares of the step."""

EDGE_SHIFT = 21
"""Bits of a binary32 below its exponent and two bits of its mantissa."""

TRELLIS_NOISE, TRELLIS_ZERO = 0.24, 1.3
"""Mean squared error of a coefficient in squares of the step, which is 1/3 without a trellis. And
how many steps a coefficient is smaller than that becomes 0. Both are measured."""

ZERO_POWER = TRELLIS_ZERO**2

SLOW_BAND = 2
"""Coefficients up to this many times the split frequency decide whether the slow part keeps its
deadband."""

FREE_TRIALS = 2

BELOW = 0.96
"""Share of the noise that the first step aims at: all blocks have some more than those seen."""

STEADIER, FURTHER = 0.7, 1.4
"""Smaller weights also move the errors of other coefficients."""

NATIVE = 4
"""A step of fewer counts of the source is tried in whole counts too: a source with few distinct
values, such as the difference of encoder counts, loses nothing on its own grid."""


@dataclass(frozen=True)
class CodedTrial:
    """What a step gives: the step that was used, a function that gives decoded samples in the
    channel's unit, and one that codes them.

    The latter takes the smallest size so far, and gives None where it is sure not to be below.
    ``noise``: the mean squared error, where it is known without decoding. ``indices``: what is
    predicted; None: nothing is.
    """

    step: float
    decode: Callable[[], Doubles]
    code: Callable[[int | None], Unit | None]
    noise: float | None = None
    indices: Indices | None = None
    limited: bool = False
    """Whether wider steps have the quality too, but leave the deadband."""

    @cached_property
    def samples(self) -> Doubles:
        return self.decode()


@dataclass(frozen=True)
class Way:
    """A way to code a texture: a function of the step of a uniform grid, in the channel's unit.

    ``bits``: about what it takes at the first step; None: a trial tells.

    The function gives None where there is no such step. ``first``: the step to begin with.
    ``costly``: each trial takes long. ``steadier``: a way with smaller errors of the slow part,
    from the step to begin with and how much too large they are; None: there is none.
    """

    at: Callable[[float], CodedTrial | None]
    first: float
    costly: bool = False
    steadier: Callable[[float, float], Way | None] | None = None
    bits: float | None = None


def ways_of(
    felt: FeltChannel, original: Channel, first_channel: int, promise: Promise, searches: Effort
) -> Iterator[Way]:
    """The ways to code a texture, or those of the only codec that was asked for."""
    yield from predicted_ways(felt, original, first_channel, promise)
    yield from other_ways(felt, original, first_channel, promise, searches)


def is_native(felt: FeltChannel) -> bool:
    """Whether a step may suit that is few counts of the source."""
    calibration = felt.source.channels[0].calibration
    assert calibration is not None
    return felt.first_step < NATIVE * float(abs(calibration.step))


def is_predicted(felt: FeltChannel, promise: Promise) -> bool:
    assert promise.texture is not None
    return promise.texture.codec != "MDCT" and not felt.threshold_decides


def predicted_ways(
    felt: FeltChannel, original: Channel, first_channel: int, promise: Promise
) -> Iterator[Way]:
    """The whole signal predicted, on each grid that may suit."""
    if is_predicted(felt, promise):
        yield way_of_whole(felt, original, first_channel)
        if is_native(felt):
            yield way_of_counts(felt, felt.source.channels[0], first_channel)


def other_ways(
    felt: FeltChannel, original: Channel, first_channel: int, promise: Promise, searches: Effort
) -> Iterator[Way]:
    """By MDCT, and after lines for the slow part."""
    texture, source = promise.texture, felt.source.channels[0]
    assert texture is not None
    asked = texture.codec == "MDCT" or texture.weighting > 0
    predicted = is_predicted(felt, promise)
    transformed = asked or (texture.codec is None and searches.transform)
    finer = coarser_for(original, source, felt.first_step) or finer_for(source, felt.first_step)
    if transformed:
        yield way_of_transform(felt, finer, first_channel)
    if not (searches.lines or felt.textured is not None):
        return
    split = split_of(felt, finer, first_channel, promise)
    if split and predicted:
        yield way_of_lines(felt, split)
    after = None
    if split and transformed and searches.lines:
        after = way_of_lines_and_transform(felt, split)
    if after:
        yield after
    if searches.lines and is_native(felt) and predicted:
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
        step = float(channel.calibration.step)
        return CodedTrial(step, lambda: samples, code, indices=channel.stored)

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
        indices = nearest_uniform(wanted, grid)
        y = np.clip(indices * grid.step, low, high)

        def code(smallest: int | None) -> Unit | None:
            coded = code_grid(whole, track, grid, nearest_uniform, smallest)
            if coded is None:
                return None
            error = furthest(y, stored, felt.x, calibration) if (y != stored).any() else 0
            if error:
                coded.track = replace(coded.track, contract=uniform(error, calibration))
            reason = f"prediction on a uniform grid of {count * grid.step:.4g} {channel.unit}"
            return Unit(coded, None, "predicted", reason, exact=not error, channels=(channel,))

        return CodedTrial(count * grid.step, lambda: calibration.physical(y), code, indices=indices)

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

        return CodedTrial(count * grid.step, lambda: calibration.physical(y), code)

    return Way(way, felt.first_step)


def way_of_transform(felt: FeltChannel, channel: Channel, first_channel: int) -> Way:
    """The whole signal by MDCT."""
    calibration = channel.calibration
    assert calibration is not None
    stored = channel.stored.astype(np.int64)
    whole = InputBlock((channel,), felt.wanted_counts(channel)[:, None], felt.source.spans)
    track = whole_range(replace(whole, counts=stored[:, None]), first_channel)
    lapped = Lapped(felt, whole, float(abs(calibration.step)))

    def unit_of(fast: Coded, step: float) -> tuple[Indices, Callable[[], Unit]]:
        y = decode_all(fast, 1)[:, 0]

        def unit() -> Unit:
            error = max(furthest(y, stored, felt.x, calibration), 1)
            fast.track = replace(fast.track, contract=uniform(error, calibration))
            return Unit(fast, None, "transformed", lapped.text(step, channel), channels=(channel,))

        return y, unit

    return lapped.way(track, calibration, unit_of)


def way_of_lines_and_transform(felt: FeltChannel, split: Split) -> Way | None:
    """Lines for the slow part, and what they leave by MDCT."""
    calibration = split.calibration
    rest = replace(split.source, counts=split.residual[:, None])
    track = split.residual_track("MDCT", b"", split.residual)
    if track is None:
        return None
    lapped = Lapped(felt, rest, float(abs(calibration.step)))

    def unit_of(fast: Coded, step: float) -> tuple[Indices, Callable[[], Unit]]:
        y = split.with_residual(decode_all(fast, 1)[:, 0])
        reason = f"lines, and {lapped.text(step, split.source.channels[0])} for the rest"
        return y, lambda: split.unit(fast, y, "lines + transformed", reason)

    return lapped.way(track, calibration, unit_of)


class Slow(NamedTuple):
    """A weight for the bands of the slow part, and how many times the split frequency they reach
    to."""

    weight: int = WEIGHT_ONE
    reach: float = SLOW_BAND


def weighted(
    way: Callable[[Slow, float], CodedTrial | None],
    first: float,
    slow: Slow = Slow(),  # noqa: B008
    bits: float | None = None,
) -> Way:
    """A way by MDCT, and after it those with smaller weights of slow coefficients, and of more."""

    def steadier(step: float, excess: float) -> Way | None:
        less = min(int(STEADIER * slow.weight / excess), slow.weight // 2)
        return weighted(way, step, Slow(less, FURTHER * slow.reach)) if less > 0 else None

    return Way(partial(way, slow), first, True, steadier, bits)


class Lapped:
    """Counts to be coded by MDCT: the block that suits them, and their coefficients."""

    def __init__(self, felt: FeltChannel, source: InputBlock, count: float) -> None:
        """The block whose coefficients take the fewest bits, about. count: in the unit."""
        self.felt, self.count, self.rate = felt, count, float(source.rate)
        noise = (felt.first_step / count) ** 2 / 12
        self.size, self.blocks = best_blocks(source, noise)
        self.coefficient_sizes = CoefficientSizes.of(sizes_of(self.blocks))
        step = self.coefficient_sizes.step_for(2 * noise / self.size)
        self.classes, factor = [STARTS[0]] * len(self.blocks), 1.0
        self.bits = 0.0
        """About what the coefficients take."""
        rows = max(self.blocks, key=lambda block: block.coefficients.size).coefficients
        parameters = self.parameters(step * sqrt(2 * self.size) * count)
        with suppress(ValueError):
            some = sampled(rows, parameters.steps)
            self.classes = [some.classes] * len(self.blocks)
            expected = CoefficientSizes.of(np.abs(some.rows).reshape(-1) / UNIT)
            known = expected.noise(step)
            found = some.errors * step**2 / some.rows.size
            if found:
                factor = (BELOW * known / found) ** (1 / self.coefficient_sizes.power(step))
            self.bits = some.bits * self.coefficient_sizes.bits(step) / max(expected.bits(step), 1)
        self.first = step * factor * sqrt(2 * self.size) * count
        """The step of a uniform grid with about the same error, in the unit."""
        self.trials = 0

    def way(
        self,
        track: Track,
        calibration: Calibration,
        unit_of: Callable[[Coded, float], tuple[Indices, Callable[[], Unit]]],
    ) -> Way:
        """unit_of: decoded counts and a function that gives the unit, of a track and its step."""

        def at(slow: Slow, step: float) -> CodedTrial | None:
            parameters = self.parameters(step, slow)
            found = self.quantised(parameters)
            if found is None:
                return None

            @lru_cache(1)
            def coded() -> tuple[Indices, Callable[[], Unit]]:
                own = Coded(replace(track, codec="MDCT", parameters=parameters.build()))
                for block, each in zip(self.blocks, found, strict=True):
                    data = encode_component(block.base, each.levels, each.classes, each.start)
                    packet = Packet(0, block.span.start, block.span.ticks, join_components([data]))
                    own.packets.append(packet)
                return unit_of(own, step)

            noise = None
            if not parameters.weights:
                exact = sum(each.errors for each in found) * (parameters.step / UNIT) ** 2
                # The last block of a packet has the same error where there is no sample any more.
                ticks = sum(block.coefficients.size for block in self.blocks)
                noise = (exact * self.size / 2 / ticks + 1 / 12) * self.count**2
            return CodedTrial(
                step,
                lambda: calibration.physical(coded()[0]),
                lambda _smallest: coded()[1](),
                noise,
            )

        return weighted(at, self.first, bits=self.bits)

    def quantised(self, parameters: TransformParameters) -> list[Levels] | None:
        """None where coefficients are too large for the codec.

        The classes of the entropy coder follow the step for a few trials. Then they stay: where
        they jump, the trellis finds another error.
        """
        self.trials += 1
        found = []
        for place, block in enumerate(self.blocks):
            try:
                each = quantise(block.coefficients, parameters.steps, self.classes[place])
            except ValueError:
                return None
            found.append(each)
            if each.levels.size and self.trials <= FREE_TRIALS:
                self.classes[place] = each.classes
        return found

    def parameters(self, step: float, slow: Slow = Slow()) -> TransformParameters:  # noqa: B008
        counts = step / self.count / sqrt(2 * self.size)
        even = slow.weight == WEIGHT_ONE and not self.felt.weighting
        weights = b"" if even else self.weights(slow)
        return TransformParameters(self.size, clamp(round(UNIT * counts), 1, STEP_MOST), weights)

    def weights(self, slow: Slow) -> bytes:
        """Weights of bands: the steps that a person feels alike, times the weight of slow ones."""
        hz = slow.reach * self.felt.cutoff_hz
        bands = min(self.size, WEIGHTS_LIMIT)
        if not self.felt.weighting:
            bands = min(1 << ceil(log2(max(self.rate / SLOW_BAND / self.felt.cutoff_hz, 2))), bands)
        width = self.rate / 2 / bands
        factors = self.thresholds(np.arange(0.5, bands) * width) ** self.felt.weighting
        factors[: min(ceil(hz / width), bands)] *= slow.weight / WEIGHT_ONE
        return bytes(np.clip(np.rint(WEIGHT_ONE * factors), 0, 255).astype(np.uint8))

    def thresholds(self, hz: Doubles) -> Doubles:
        """Thresholds of vibration, as multiples of the least one. Frequencies below the split
        frequency take its threshold, because the curve holds for vibrations only."""
        found = vibrotactile_threshold(np.maximum(hz, self.felt.cutoff_hz), self.felt.moves)
        return np.asarray(found / found.min())

    def text(self, step: float, channel: Channel) -> str:
        amount = self.parameters(step).step / UNIT * self.count
        return f"a transform with blocks of {self.size} and steps of {amount:.4g} {channel.unit}"


class Transformed(NamedTuple):
    """A packet's samples: a count near most of them, and the coefficients [blocks, size] of what
    they are away from it, in 256ths of a count."""

    span: Span
    base: int
    coefficients: Doubles


def best_blocks(source: InputBlock, noise: float) -> tuple[int, list[Transformed]]:
    """The size of blocks whose coefficients take the fewest bits, and these. Sizes twice as large
    are tried while they are better, or sizes half as large."""
    pieces = []
    for span, rows in source.pieces(source.counts):
        base = int(np.floor(np.median(rows) + 0.5))
        pieces.append((span, base, rows[:, 0].astype(np.float64) - base))

    def blocks_of(size: int) -> list[Transformed]:
        return [Transformed(span, base, forward(x, size)) for span, base, x in pieces]

    found = {FIRST_SIZE: blocks_of(FIRST_SIZE)}
    step = max(
        CoefficientSizes.of(sizes_of(found[FIRST_SIZE])).step_for(2 * noise / FIRST_SIZE), 1e-9
    )

    def cost(size: int) -> float:
        if size not in found:
            found[size] = blocks_of(size)
        per_step = size / FIRST_SIZE / (step * UNIT) ** 2
        # In squares of the step.
        power = [np.square(block.coefficients) * per_step for block in found[size]]
        errors = sum(np.where(p < ZERO_POWER, p, TRELLIS_NOISE).sum() for p in power)
        bits = sum(np.log2(1 + 2 * p).sum() for p in power) / 2
        ticks = sum(p.size for p in power)
        return float(errors / ERROR_WEIGHT + bits) / ticks

    best = FIRST_SIZE
    fewest = cost(best)
    for sizes in (range(1, 3), range(-1, -3, -1)):
        for size in (FIRST_SIZE << k if k > 0 else FIRST_SIZE >> -k for k in sizes):
            other = cost(size)
            if other >= fewest:
                break
            best, fewest = size, other
        if best != FIRST_SIZE:
            break
    return best, found[best]


def sizes_of(blocks: Sequence[Transformed]) -> Doubles:
    """Magnitudes of coefficients in counts."""
    return np.concatenate([np.abs(block.coefficients).reshape(-1) / UNIT for block in blocks])


@dataclass(frozen=True)
class CoefficientSizes:
    """How large coefficients are: those up to each edge, a quarter of an octave apart.

    ``counts`` and ``energy`` of those below an edge.
    """

    edges: Doubles
    counts: Doubles
    energy: Doubles

    @classmethod
    def of(cls, sizes: Doubles) -> CoefficientSizes:
        # The exponent and two bits of the mantissa of a binary32.
        places = sizes.astype(np.float32).view(np.int32) >> EDGE_SHIFT
        first, last = int(places.min(initial=0)), int(places.max(initial=0)) + 1
        edges = (np.arange(first, last + 1, dtype=np.int32) << EDGE_SHIFT).view(np.float32)
        places -= first
        counts = np.bincount(places, minlength=last - first).cumsum()
        energy = np.bincount(places, sizes * sizes, last - first).cumsum()
        zero = np.zeros(1)
        return cls(
            edges.astype(np.float64), np.concatenate((zero, counts)),
            np.concatenate((zero, energy)),
        )  # fmt: skip

    def noises(self) -> Doubles:
        """Mean squared errors with a step whose zeros reach to each edge: those of a quantiser, or
        all of a coefficient that becomes 0."""
        steps = self.edges / TRELLIS_ZERO
        left = self.counts[-1] - self.counts
        found = (self.energy + TRELLIS_NOISE * left * steps**2) / max(self.counts[-1], 1)
        return np.asarray(np.maximum.accumulate(found))

    def noise(self, step: float) -> float:
        if step * TRELLIS_ZERO <= self.edges[0]:
            return float(TRELLIS_NOISE * step**2)
        return float(np.interp(step * TRELLIS_ZERO, self.edges, self.noises()))

    def step_for(self, noise: float) -> float:
        """The step with about this mean squared error."""
        found = self.noises()
        if noise <= found[0] or found[-1] <= 0:
            return sqrt(noise / TRELLIS_NOISE)
        return float(np.interp(sqrt(noise), np.sqrt(found), self.edges)) / TRELLIS_ZERO

    def power(self, step: float) -> float:
        """By which power of the step the error grows."""
        wider, error = self.noise(1.1 * step), self.noise(step)
        return min(max(log(wider / error) / log(1.1), 0.5), 2.0) if wider > error > 0 else 1.0

    def bits(self, step: float) -> float:
        """About the bits with a step, in some unit."""
        inner = np.diff(self.counts)
        middle = np.sqrt(self.edges[1:] * np.maximum(self.edges[:-1], 1e-30))
        return float((inner * np.log2(1 + middle / step)).sum())


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
