"""Ways to code a texture: each gives, for a step, the decoded samples and how to code them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..errors import ParameterError
from ..format.cluster import Packet
from ..format.track import Component, Contract
from ..limits import EXACT_LIMIT, ZERO_LIMIT
from ..numbers import clamp
from ..recording import Calibration, Channel
from .bounded import code_grid, code_lines
from .felt import Doubles, FeltChannel
from .gridded import nearest_uniform
from .knots import Coded
from .lattice import LatticeSearch, on_uniform_grid
from .plan import Promise
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

FINER = 128
"""Counts of a step: rounding it to whole counts then changes the quality by less than 0.1 dB."""

FINEST = 4 * FINER
"""Counts that one count of the source is divided into at most."""

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


Way = Callable[[float], CodedTrial | None]
"""A way to code a texture: from a step in the channel's unit. None: there is no such step."""


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
