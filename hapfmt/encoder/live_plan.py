"""What is known of a channel before its first sample, and what the preset makes of it.

The whole recording is not at hand: nothing here is relative to a range, and nothing is found in the
samples but the grid of doubles (live_exact.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..format.cluster import Packet
from ..format.track import Component, Contract, Track
from ..reading.contract import nearest_counts
from ..errors import ParameterError
from ..limits import AFFINE_LIMIT, EXACT_LIMIT, LEVELS, Level
from .inputs import Input
from ..recording import Calibration, Channel, Deviation, Span
from .bounded import contract_for
from .grids import grid_within
from .perception import WEBER_LIMITS
from .plan import CLOCK_LABEL, Promise, absolute_threshold, bound_promise, quantity_of
from .rational import shortest_fraction
from .settings import ALL, Settings
from .source import Source, component_of
from .tolerance import Tolerance
from .unit import Bound, bound_of

NEEDS_WHOLE = (
    "{} needs the whole recording: its low-pass filter reaches into the future. Record with preset "
    "lossless, near-lossless, or perceptual with --no-texture"
)

ROUNDING = Fraction(1, 1 << 17)
"""A value's count is found in binary64: 32-bit counts may be off their middle by that part."""

ONE_COUNT = Tolerance(1, "lsb")


class Made(NamedTuple):
    """Packets of a block, the track that they are for, its id open, and its least and its largest
    count."""

    track: Track
    packets: list[Packet]
    low: int = 0
    high: int = 0


@dataclass(frozen=True)
class Plan:
    """How one input is coded.

    ``channel``: its description, without samples; ``low`` ... ``high``: the counts it may have;
    ``bound``: what the promise allows, None where every bit is kept.
    """

    input: Input
    channel: Channel
    low: int
    high: int
    settings: Settings
    promise: Promise
    bound: Bound | None

    @property
    def calibration(self) -> Calibration:
        assert self.channel.calibration is not None
        return self.channel.calibration

    @property
    def component(self) -> Component:
        return component_of(self.channel)

    @property
    def is_one_grid(self) -> bool:
        """Whether there is one way to code it, whatever the samples are."""
        felt = self.settings.preset == "perceptual" and self.bound is not None
        return self.channel.calibration is not None and not felt

    @property
    def contract(self) -> Contract | None:
        return contract_for(self.bound.band) if self.bound else None

    @cached_property
    def grid(self) -> LpcParameters:
        """The grid that keeps the bound."""
        return grid_within(self.bound) if self.bound else LpcParameters()

    @property
    def level(self) -> Level:
        """The lowest level that holds any samples of the input."""
        one = LEVELS[1]
        wide = max(-self.low - 1, self.high) >> (one.count_bits - 1)
        zero = self.grid.zero if self.grid.kn else 0
        far = max(zero - self.low, self.high - zero) > one.count_bound
        return LEVELS[2 if wide or far else 1]

    def track(self, number: int, **given: Any) -> Track:
        """A track of channel ``number``; its id is open."""
        given = {"count_min": self.low, "count_max": self.high} | given
        return Track(
            id=-1,
            kind="full",
            rate=self.input.rate,
            first_channel=number,
            components=(self.component,),
            **given,
        )

    def counts(self, values: NDArray[Any], channel: int, start: int) -> NDArray[np.int64]:
        """What came in as counts within the declared range; nothing is clamped."""
        given = self.input
        if given.takes_counts:
            if values.dtype.kind not in "iu":
                raise ParameterError(
                    f"channel {channel} ({given.label!r}) takes integer counts, not {values.dtype}"
                )
            outside = (values < self.low) | (values > self.high)
            if outside.any():
                raise self.outside_range(values, outside, channel, start)
            return np.ascontiguousarray(values, np.int64)
        x = floats(values, f"channel {channel} ({given.label!r})").astype(np.float64, copy=False)
        low, high = (float(self.calibration.step) * end for end in (self.low, self.high))
        outside = ~((x >= low) & (x <= high))
        if outside.any():
            raise self.outside_range(values, outside, channel, start)
        return np.clip(nearest_counts(x, self.calibration), self.low, self.high)

    def outside_range(
        self, values: NDArray[Any], outside: NDArray[np.bool_], channel: int, start: int
    ) -> ParameterError:
        given, at = self.input, int(np.argmax(outside))
        bits = f"the {given.bits} bits ({self.low} to {self.high})"
        if given.takes_counts:
            limits = f"the count {values[at]} is outside {bits} of the input: declare more of them"
        else:
            limits = f"{values[at]} is outside {bits} of steps of {given.lsb:g}: give a larger lsb"
        return ParameterError(f"channel {channel} ({given.label!r}), tick {start + at}: {limits}")


def floats(values: NDArray[Any], named: str) -> NDArray[Any]:
    """float32 as it is, all else as the float64 that is the same number."""
    if values.dtype == np.float32:
        return np.ascontiguousarray(values)
    if values.dtype.kind not in "iuf" or values.dtype.itemsize > 8:
        raise ParameterError(f"{named} takes numbers of up to 64 bits, not {values.dtype}")
    x = np.ascontiguousarray(values, np.float64)
    if values.dtype.kind in "iu" and values.size and (np.abs(x) >= EXACT_LIMIT).any():
        raise ParameterError(f"{named} has integers beyond 2^53: give it a calibration")
    return x


def check_settings(settings: Settings) -> None:
    """ParameterError where a recording cannot be coded so while it grows."""
    if settings.preset == "paper":
        raise ParameterError(NEEDS_WHOLE.format("preset paper"))
    if settings.preset == "perceptual" and settings.texture:
        raise ParameterError(NEEDS_WHOLE.format("texture in preset perceptual"))
    if settings.tolerance is not None:
        raise ParameterError("while recording, an input states its lsb in place of a tolerance")
    if settings.preset == "near-lossless" and settings.max_error.kind == "range":
        raise ParameterError(relative("the largest error", "1lsb"))
    if settings.felt == ALL and settings.deadband_floor.kind == "range":
        raise ParameterError(relative("the floor", "0.01 (N) or 2lsb"))


def relative(what: str, example: str) -> str:
    return (
        f"{what} is relative to the range of the samples, which is not known before the end: "
        f"give an amount in the channel's unit or in steps, {example}"
    )


def plan_input(given: Input, settings: Settings) -> Plan:
    """ParameterError where the input cannot be coded with the settings."""
    if given.rate.numerator >> 32 or given.rate.denominator >> 32:
        raise ParameterError(f"rate {given.rate} of channel {given.label!r} needs over 32 bits")
    low, high = -(1 << (given.bits - 1)), (1 << (given.bits - 1)) - 1
    calibration, deviation = given.calibration, None
    if given.lsb is not None:
        calibration = calibration_of(given, given.lsb)
        half = float(abs(calibration.step) / 2 * (1 + ROUNDING))
        deviation = Deviation(half, half)
    if calibration is not None and not calibration.covers(low, high):
        raise ParameterError(
            f"{given.bits}-bit counts of channel {given.label!r} times A are above 2^53: "
            "declare fewer bits, or a smaller A and B"
        )
    channel = Channel(
        np.zeros(0, np.int64),
        given.rate,
        calibration=calibration,
        label=given.label,
        unit=given.unit,
        quantity=given.quantity,
        axis=given.axis,
        group=given.group,
        body_site=given.body_site,
        device=given.device,
        deviation=deviation,
        lsb=given.lsb,
    )
    promise = live_promise(channel, settings)
    bound = None if calibration is None else bound_for(channel, promise, settings)
    return Plan(given, channel, low, high, settings, promise, bound)


def calibration_of(given: Input, lsb: float) -> Calibration:
    """The lsb as the simplest fraction that is the same double."""
    step = shortest_fraction(lsb) if isfinite(lsb) else Fraction(0)
    if not 0 < step.numerator < AFFINE_LIMIT or step.denominator >= EXACT_LIMIT:
        raise ParameterError(
            f"the lsb {lsb:g} of channel {given.label!r} is not a fraction of integers below 2^52: "
            "use another unit"
        )
    return Calibration(step.numerator, 0, step.denominator)


def live_promise(channel: Channel, settings: Settings) -> Promise:
    """Preset perceptual, by what is known beforehand: felt quantities get their deadband, with a
    floor of one count where none is given; all else is kept without loss, but for an absolute
    error that the caller gave."""
    if settings.preset == "lossless":
        return Promise()
    if settings.preset == "near-lossless":
        return bound_promise(settings)
    floor = settings.deadband_floor
    if settings.felt == ALL:
        return Promise(floor, settings.k)
    quantity = quantity_of(channel)
    named = channel.label in (settings.felt or ())
    if quantity not in WEBER_LIMITS and not named:
        clock = quantity == "time" or (not quantity and CLOCK_LABEL.search(channel.label))
        if clock or settings.max_error.kind == "range":
            return Promise()
        return bound_promise(settings)
    limit = WEBER_LIMITS.get(quantity)
    k = settings.k if limit is None else min(settings.k, limit)
    floor = absolute_threshold(channel, settings) or floor
    return Promise(ONE_COUNT if floor.kind == "range" else floor, k)


def bound_for(channel: Channel, promise: Promise, settings: Settings) -> Bound | None:
    """None where nothing may be lost."""
    if promise.floor is None:
        return None
    nothing = np.zeros((1, 1), np.int64)
    bound = bound_of(Source((channel,), nothing, (Span(0, 1),)), promise)
    return None if settings.preset == "near-lossless" and not bound.slack else bound
