"""Blocks of samples, as they arrive, to packets of tracks that never change (SPEC clause 15).

Each block is coded as :mod:`encode` codes one packet of one channel. The first block of a channel
makes its track, which is described before its first packet. Where a later block does not fit, a new
track continues the old one. A block is at most as long as one cluster, so that a crash loses no
more.

This module also has the classes in which a caller declares a channel before its first sample. The
whole recording is not available. So only the grid of floating point values comes from the samples,
and a bound relative to their range is one relative to the range so far.

Without loss, floating point channels are stored block by block and bit for bit: as counts and
corrections, or as words. The grid is searched in the first block and then kept. Values off the grid
take longer corrections. Any binary64 number has one, since places are counted modulo 2^64 (SPEC
9.7). Within a bound, the bound gives the grid.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from itertools import chain, groupby
from math import inf, isfinite
from operator import attrgetter
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..codecs.exact import Counts, Doubles, ExactParameters, Lacking, ordered
from ..codecs.grids import LpcParameters
from ..codecs.raw import DTYPES, RawParameters, encode_raw
from ..deadband import Deadband
from ..errors import DataWarning, ParameterError
from ..format.cluster import Packet
from ..format.track import Affine, Component, Contract, Track
from ..format.wire import encode_text
from ..limits import AFFINE_LIMIT, EXACT_LIMIT, LAST_TRACK_ID, LEVELS, TICK_LIMIT, Level
from ..numbers import exact
from ..reading.decoder import TrackDecoder
from ..reading.verifier import nearest_counts
from ..recording import Calibration, Channel, Deviation, Span
from ..threads import in_order
from ..units import unknown_unit
from .bounded import contract_for, scalar_ways
from .effort import EFFORTS
from .exact import beside_counts, natural_candidate
from .gridded import grid_within, nearest
from .knots import Coded
from .lattice import FOUR_DIGITS_DOWN, LatticeSearch, sparse
from .plan import (
    CLOCK_LABEL,
    NOT_FELT,
    Promise,
    absolute_threshold,
    amount_text,
    bound_promise,
    exact_kind,
    felt_channels,
    idle_options,
    quantity_of,
    without_glitches,
)
from .predict import encode_best
from .rational import shortest_fraction
from .settings import ALL, WEBER_LIMITS, Settings, Tolerance
from .source import PACKET_SAMPLES, InputBlock, component_of
from .unit import ENCODE_LEVEL, Bound, bound_of

COUNT_BITS = range(2, 33)


@dataclass(frozen=True)
class Input:
    """One channel to be recorded.

    ``rate``: ticks per second, a positive Fraction. With a ``calibration`` the samples are
    integers of ``bits`` signed bits. Without one they are floats in ``unit``. An ``lsb`` is a step
    in ``unit``: floats are rounded to its multiples, and the file declares half of it as deviation.
    Without ``lsb`` floats are kept bit for bit, or on a grid that suits a lossy preset.
    """

    label: str
    rate: Fraction
    unit: str = "1"
    quantity: str = ""
    axis: str = ""
    group: str = ""
    body_site: str = ""
    device: str = ""
    calibration: Calibration | None = None
    bits: int = 24
    lsb: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", exact(self.rate))
        for text in (self.label, self.unit, self.quantity, self.axis, self.group, self.body_site):
            encode_text(text)
        encode_text(self.device)
        if (note := unknown_unit(self.unit, kept=self.unit)) is not None:
            warnings.warn(note, DataWarning, stacklevel=3)
        if self.rate <= 0:
            raise ParameterError(f"the rate of {self.label!r} is positive")
        if self.bits not in COUNT_BITS:
            raise ParameterError(f"the counts of {self.label!r} have 2 to 32 bits")
        if self.calibration is not None and self.lsb is not None:
            raise ParameterError(f"{self.label!r} has a calibration or an lsb, not both")
        if self.lsb is not None and not (isfinite(self.lsb) and self.lsb > 0):
            raise ParameterError(f"the lsb of {self.label!r} is a positive number")

    @property
    def takes_counts(self) -> bool:
        """True if the samples are integer counts, False if they are floats."""
        return self.calibration is not None


NEEDS_WHOLE = (
    "{} needs the whole recording: its low-pass filter reaches into the future. Record with preset "
    "lossless, near-lossless, or perceptual with texture=False"
)

ROUNDING = Fraction(1, 1 << 17)
"""A value's count is computed in binary64: 32-bit counts may be off their middle by that part."""

ONE_COUNT = Tolerance(1, "lsb")


NO_COUNTS = np.zeros(1, np.int64)


class Made(NamedTuple):
    """Packets of a block, the track that they are for, its id open, and the counts in them."""

    track: Track
    packets: list[Packet]
    counts: NDArray[np.int64] = NO_COUNTS


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
            if values.size and not self.low <= values.min() <= values.max() <= self.high:
                outside = (values < self.low) | (values > self.high)
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
    if settings.vectors == "required":
        raise ParameterError("vectors would do nothing: while recording, each axis has its track")
    if settings.tolerance is not None:
        raise ParameterError("while recording, an input states its lsb in place of a tolerance")


def check_amount(given: Input, promise: Promise) -> None:
    """ParameterError where the amount of a promise has no meaning for the input.

    Only floats take a grid from their first samples. Counts are described before the first one.
    """
    amount, has_step = promise.floor, given.calibration is not None or given.lsb is not None
    if amount is None:
        return
    if amount.kind == "range" and has_step:
        raise ParameterError(
            f"{amount_text(amount)} of {given.label!r} is not known before the end: give an amount "
            "in the channel's unit or in steps, such as 2lsb"
        )
    if amount.kind == "lsb" and not has_step:
        raise ParameterError(
            f"{given.label!r} has no known step, so an amount in lsb does not apply: add lsb="
        )
    if amount.kind == "absolute":
        amount.in_unit(given.unit)


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
    check_amount(given, promise)
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
    """Preset perceptual, by what is known beforehand: felt quantities get their deadband, all else
    a largest error. Where these are shares of a range, counts are kept without loss, and felt ones
    get a floor of one count."""
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
        relative = settings.max_error.kind == "range" and channel.calibration is not None
        return Promise() if clock or relative else bound_promise(settings)
    limit = WEBER_LIMITS.get(quantity)
    k = settings.k if limit is None else min(settings.k, limit)
    floor = absolute_threshold(channel, settings) or floor
    one_count = floor.kind == "range" and channel.calibration is not None
    return Promise(ONE_COUNT if one_count else floor, k)


def by_label(settings: Settings, inputs: Sequence[Input]) -> Settings:
    """Return the settings with labels in the place of numbers of felt channels."""
    labels = {str(number): given.label for number, given in enumerate(inputs)}
    if settings.felt is None or settings.felt == ALL:
        return settings
    names = [name if name in labels.values() else labels.get(name, name) for name in settings.felt]
    return replace(settings, felt=tuple(names))


def check_inputs(inputs: Sequence[Input], settings: Settings) -> None:
    """Refuse options of preset perceptual that no input uses; warn of those that do nothing."""
    if settings.preset != "perceptual" or not inputs:
        return
    channels = [plan_input(given, settings).channel for given in inputs]
    felt = felt_channels(channels, settings)
    promises = [live_promise(channel, settings) for channel in channels]
    if not any(felt) and (unused := settings.departures(["k", "floor"])):
        raise ParameterError(f"{unused[0]} would do nothing: {NOT_FELT}")
    for text in idle_options(channels, settings, felt, promises):
        warnings.warn(text, DataWarning, stacklevel=5)


def bound_for(channel: Channel, promise: Promise, settings: Settings) -> Bound | None:
    """None where nothing may be lost."""
    if promise.floor is None:
        return None
    nothing = np.zeros((1, 1), np.int64)
    bound = bound_of(InputBlock((channel,), nothing, (Span(0, 1),)), promise)
    return None if settings.preset == "near-lossless" and not bound.slack else bound


LEVEL_1_BITS = LEVELS[1].count_bits
LOW, HIGH = -(1 << (LEVEL_1_BITS - 1)), (1 << (LEVEL_1_BITS - 1)) - 1

HEADROOM, AT_REST = 32, Fraction(2)
"""How many times the range of the first block the counts hold; and the range of a block of
zeros."""

POWERS, MIDDLE = range(15, -10, -1), 1 << 51
"""Decimals of a step, and the numerator of the middle count: what calibrations hold (VAL-001)."""

SEEN = 16
"""This many distinct values show a grid; fewer show only one of plain decimals or binary
fractions."""

PLAIN = 10**7
"""A denominator of plain decimals, at most."""

FAR = 1 << 53
UNCODED = np.iinfo(np.int64).min
"""The one correction without a code."""

NUMBERS = ("binary32", "binary64")
"""Words that floats become."""


@dataclass(frozen=True)
class LiveLattice:
    """Counts of doubles from ``low`` to ``high``, and the rule that makes doubles of counts."""

    calibration: Calibration
    parameters: ExactParameters
    low: int = LOW
    high: int = HIGH

    def nearest(self, x: Doubles) -> Counts:
        """Counts of any size; 0 for NaN and infinities."""
        c = self.calibration
        with np.errstate(all="ignore"):
            guess = np.rint((x * float(c.d) - float(c.b)) / float(c.a))
        return np.clip(np.where(np.isnan(guess), 0.0, guess), -FAR, FAR).astype(np.int64)

    def lacking(self, x: Doubles) -> Lacking:
        """Counts and corrections."""
        affine = Affine(self.calibration.a, self.calibration.b, self.calibration.d)
        counts = nearest = np.clip(self.nearest(x), self.low, self.high)
        places = ordered(x)
        for bit in range(LEVEL_1_BITS):
            doubles = self.parameters.values(counts, affine)
            with np.errstate(over="ignore"):
                corrections = places - ordered(doubles)
            uncoded = corrections == UNCODED
            if not uncoded.any():
                break
            # Another count will do, whichever has a value of its own.
            other = np.where(nearest + (1 << bit) <= self.high, nearest + (1 << bit), self.low)
            counts = np.where(uncoded, other, counts)
        else:
            raise ParameterError("a double that no count of the track can be corrected to")
        together = int(np.bitwise_or.reduce(corrections))
        shift = max((together & -together).bit_length() - 1, 0)
        return Lacking(counts, corrections >> shift, shift)


def lattices(x: Doubles) -> list[LiveLattice]:
    """Grids for the channel that begins with x: a natural grid where x shows one, and a grid of
    decimals."""
    finite = x[np.isfinite(x)]
    found = [decimal_grid(finite)]
    distinct = np.unique(finite).size
    if finite.size < x.size or distinct < 2:
        return found
    search = LatticeSearch(x)
    exact = None if isinstance(search.exact, str) else search.exact
    if exact and (distinct >= SEEN or exact.calibration.d <= PLAIN):
        found.append(LiveLattice(exact.calibration, ExactParameters()))
        if not sparse(exact.counts):
            # Nothing coarser lies under it.
            return covering(found)
    if distinct >= SEEN and (near := natural_candidate(search, exact, EFFORTS["default"])):
        found.append(LiveLattice(near.calibration, near.parameters))
    return covering(found)


def covering(found: Sequence[LiveLattice]) -> list[LiveLattice]:
    """Those that allow all counts."""
    return [lattice for lattice in found if lattice.calibration.covers(LOW, HIGH)]


def decimal_grid(x: Doubles) -> LiveLattice:
    """Multiples of a power of ten, a range of many times that of x about its middle: no worse than
    those of a power of two, and what turns out to be plain decimals later has no corrections."""
    low, high = (float(x.min()), float(x.max())) if x.size else (0.0, 0.0)
    half, middle = Fraction(high) / 2 - Fraction(low) / 2, Fraction(high) / 2 + Fraction(low) / 2
    if not half:
        half, middle = abs(middle), Fraction(0)
    if abs(middle) < HEADROOM * half:
        middle = Fraction(0)
    reach = HEADROOM * (half or AT_REST)
    for places in POWERS:
        a, d = 10 ** max(-places, 0), 10 ** max(places, 0)
        offset = round(middle * d / a) * a
        if HIGH * a >= reach * d and abs(offset) < MIDDLE:
            return LiveLattice(Calibration(a, offset, d), ExactParameters())
    return LiveLattice(Calibration(a, 0, d), ExactParameters())


class ExactEncoder:
    """Counts and corrections: LPCX."""

    def __init__(self, plan: Plan, number: int, lattice: LiveLattice) -> None:
        self.named, self.lattice = f"channel {number} ({plan.input.label!r})", lattice
        self.pack = partial(encode_best, effort=plan.settings.searches)
        channel = replace(plan.channel, calibration=lattice.calibration)
        self.track = replace(plan, channel=channel).track(
            number,
            codec="LPCX",
            parameters=lattice.parameters.build(),
            count_min=lattice.low,
            count_max=lattice.high,
        )

    def take(self, values: NDArray[Any], _start: int) -> Doubles:
        return floats(values, self.named).astype(np.float64, copy=False)

    def code(self, x: Doubles, start: int) -> Made:
        lacking = self.lattice.lacking(x)
        data = beside_counts(self.pack(lacking.counts), lacking)
        return Made(self.track, [Packet(0, start, x.size, data)], lacking.counts)


class WordsEncoder:
    """Words as they are: RAWB."""

    def __init__(self, plan: Plan, number: int, number_format: str) -> None:
        self.named = f"channel {number} ({plan.input.label!r})"
        self.dtype = DTYPES[number_format]
        self.track = plan.track(
            number,
            codec="RAWB",
            parameters=RawParameters(self.dtype.itemsize).build(),
            number_format=number_format,
            count_min=0,
            count_max=0,
        )

    def take(self, values: NDArray[Any], start: int) -> NDArray[Any]:
        if values.dtype == self.dtype:
            return np.ascontiguousarray(values)
        x = floats(values, self.named)
        words = x.astype(self.dtype, copy=False)
        if words.dtype != x.dtype and words.dtype == np.float32:
            same = words.astype(np.float64).view(np.int64) == x.view(np.int64)
            if not same.all():
                at = int(np.argmin(same))
                raise ParameterError(
                    f"{self.named}, tick {start + at}: {float(x[at])!r} is not a binary32 number, "
                    "but the first values were"
                )
        return words

    def code(self, words: NDArray[Any], start: int) -> Made:
        data = encode_raw(words[:, None], self.dtype.itemsize)
        return Made(self.track, [Packet(0, start, words.size, data)])


def choose_exact(
    plan: Plan, number: int, first: NDArray[Any], before: Track | None, *, counts: bool = False
) -> ExactEncoder | WordsEncoder:
    """The encoder whose packet of the first block is the smallest; ``before``: the track that it
    continues, which leaves no choice; ``counts``: not as words, which no bound can follow."""
    if before is not None:
        return encoder_after(plan, number, before)
    x = floats(first, f"channel {number} ({plan.input.label!r})")
    words = WordsEncoder(plan, number, "binary32" if x.dtype == np.float32 else "binary64")
    doubles = x.astype(np.float64, copy=False)
    found: list[ExactEncoder | WordsEncoder] = [
        ExactEncoder(plan, number, lattice) for lattice in lattices(doubles)
    ]
    if found and np.unique(doubles).size < SEEN:
        # Little is known of the signal yet: counts can become small later, words cannot.
        return found[-1]
    if not (found and counts):
        found.append(words)
    return min(found, key=lambda each: len(each.code(each.take(first, 0), 0).packets[0].data))


def encoder_after(plan: Plan, number: int, before: Track) -> ExactEncoder | WordsEncoder:
    if before.number_format in NUMBERS:
        return WordsEncoder(plan, number, before.number_format)
    if before.number_format != "counts":
        raise ParameterError(
            f"channel {number} ({plan.input.label!r}) cannot be continued by floats: the file has "
            f"{before.number_format}"
        )
    parameters = ExactParameters()
    if before.codec == "LPCX":
        parameters = ExactParameters.parse(before.parameters, 0)
    calibration = Calibration(*before.components[0].calibration)
    if calibration.covers(LOW, HIGH):
        return ExactEncoder(plan, number, LiveLattice(calibration, parameters))
    lattice = LiveLattice(calibration, parameters, before.count_min, before.count_max)
    return ExactEncoder(plan, number, lattice)


FIRST, LAST = 2, 16
"""After 2 blocks all forms are tried again; then after twice as many each time, up to 16."""

DESCRIPTION = 150.0
"""About the bytes of the description of a track."""

MUCH = 0.93
"""Another form takes over if its packets are below this part of the size, and save more than a
description takes. Each time twice as much must be saved, so that there are few descriptions."""

SHORT = 128
"""Samples of a cluster: in shorter ones held steps without entropy coding, the first form of
:func:`scalar_ways`, may be the smallest. In longer ones they take over too soon after a rest."""

Way = Callable[[Track, int | None], Coded | None]
"""One form: (track, smallest size so far) -> packets, None where they are not smaller."""

NOTHING = np.zeros(1, np.int32)
"""In place of the first block of a channel without samples."""


@dataclass(frozen=True, eq=False)
class Block:
    """Samples of one channel without a gap, all of one cluster, from tick ``start`` on.

    ``channel``: its number in the file. ``values``: [samples], as the input says.
    """

    channel: int
    input: Input
    start: int
    values: NDArray[Any]


class ChannelEncoder(Protocol):
    """One channel: ``take`` checks and converts the samples of a block, ``code`` makes packets."""

    def take(self, values: NDArray[Any], start: int, /) -> NDArray[Any]: ...

    def code(self, values: NDArray[Any], start: int, /) -> Made: ...


class LiveEncoder:
    """Packets of many channels, block by block; the same blocks give the same bytes.

    ``first_track``: the first id that is free in the file.
    """

    def __init__(self, settings: Settings | None = None, *, first_track: int = 0) -> None:
        self.settings = settings or Settings()
        check_settings(self.settings)
        self.next_track = first_track
        self.encoders: dict[int, ChannelEncoder] = {}
        self.tracks: dict[int, Track] = {}
        """By channel: the last track in the file."""
        self.forms: dict[int, Track] = {}
        """By channel: that track as the channel's encoder made it."""

    def level(self, inputs: Iterable[Input]) -> Level:
        """The level of a file that any samples of these inputs fit; ParameterError where one of
        them cannot be coded with the settings."""
        needed = [plan_input(given, self.settings).level for given in inputs]
        return max(needed, key=lambda level: level.number, default=LEVELS[1])

    def known(self, channel: int, track: Track) -> None:
        """``track`` is the last of the channel in the file: it receives the packets that fit it.
        Before the channel's first block."""
        if channel in self.encoders:
            raise ParameterError(f"channel {channel} is being recorded already")
        if track.kind != "full" or len(track.components) != 1 or track.first_channel != channel:
            raise ParameterError(
                f"channel {channel} cannot be continued: its track {track.id} has two bands, or "
                "other channels in it"
            )
        self.tracks[channel] = track

    def begin(self, inputs: Mapping[int, Input]) -> list[Track]:
        """Tracks of new channels that do not depend on their samples; by channel number."""
        tracks: list[Track] = []
        for channel, given in inputs.items():
            plan = plan_input(given, self.settings)
            if plan.is_one_grid and channel not in self.tracks:
                grid = self.encoders[channel] = GridEncoder(plan, channel)
                tracks.append(self.number(channel, grid.track))
        return tracks

    def silent(self, inputs: Mapping[int, Input]) -> list[Track]:
        """Tracks of channels without a sample, at the end; by channel number."""
        tracks = []
        for channel, given in inputs.items():
            block = Block(channel, given, 0, np.zeros(1, np.int32))
            encoder = self.encoder_of(block)
            tracks.append(
                self.number(channel, encoder.code(encoder.take(block.values, 0), 0).track)
            )
        return tracks

    def notes(self) -> list[str]:
        """What people should know of the channels at the end."""
        encoders = [each for each in self.encoders.values() if isinstance(each, WithinEncoder)]
        return [each.note for each in encoders if each.note]

    def use(self, channel: int, encoder: ChannelEncoder) -> None:
        """``encoder`` codes the channel. Before the channel's first block."""
        self.encoders[channel] = encoder

    def encode(
        self, blocks: Sequence[Block], *, threads: int = 1
    ) -> tuple[list[Track], list[Packet]]:
        """New tracks in order of their ids, to be described first; and the packets, in order of
        (track, start). ``threads`` is how many code channels at a time.

        Where a block is refused, nothing was made; the others may be given again.
        """
        for block in blocks:
            check_block(block)
        taken = [self.encoder_of(block).take(block.values, block.start) for block in blocks]
        tracks: list[Track] = []
        packets = []
        pairs = zip(blocks, taken, strict=True)
        runs = [list(run) for _, run in groupby(pairs, key=lambda pair: pair[0].channel)]
        for block, made in chain.from_iterable(in_order(self.code, runs, threads)):
            track = self.fitting(block.channel, made)
            if track is None:
                track = self.number(block.channel, made.track)
                tracks.append(track)
            packets += [Packet(track.id, p.start, p.span, p.data) for p in made.packets]
        return tracks, sorted(packets, key=attrgetter("track", "start"))

    def code(self, run: Sequence[tuple[Block, NDArray[Any]]]) -> list[tuple[Block, Made]]:
        """The packets of blocks of one channel."""
        encoder = self.encoders[run[0][0].channel]
        return [(block, encoder.code(values, block.start)) for block, values in run]

    def encoder_of(self, block: Block) -> ChannelEncoder:
        """The encoder of a channel; the first block of a channel makes it."""
        found = self.encoders.get(block.channel)
        if found is None:
            plan = plan_input(block.input, self.settings)
            if plan.channel.calibration is None:
                before = self.tracks.get(block.channel)
                found = (
                    choose_exact(plan, block.channel, block.values, before)
                    if plan.promise.lossless
                    else WithinEncoder(plan, block.channel, before)
                )
            elif plan.is_one_grid:
                found = GridEncoder(plan, block.channel)
            else:
                assert plan.bound
                found = BoundedEncoder(plan, plan.bound, block.channel)
            self.encoders[block.channel] = found
        return found

    def fitting(self, channel: int, made: Made) -> Track | None:
        """The channel's last track, where the packets fit it."""
        track = self.tracks.get(channel)
        if track is None or self.forms.get(channel) is made.track:
            return track
        check_continued(made.track, track)
        same = ("codec", "parameters", "contract", "number_format")
        fits = (
            all(getattr(track, name) == getattr(made.track, name) for name in same)
            and track.components[0].deviation == made.track.components[0].deviation
            and track.count_min <= made.counts.min()
            and made.counts.max() <= track.count_max
        )
        return track if fits else None

    def number(self, channel: int, made: Track) -> Track:
        """A new track, which continues the channel's last one."""
        if self.next_track > LAST_TRACK_ID:
            raise ParameterError(f"a file has at most {LAST_TRACK_ID + 1} tracks")
        before = self.tracks.get(channel)
        track = replace(made, id=self.next_track, continues=before.id if before else None)
        self.next_track += 1
        self.tracks[channel], self.forms[channel] = track, made
        return track


class GridEncoder:
    """Counts on one grid: of step 1, or of a largest error."""

    def __init__(self, plan: Plan, number: int) -> None:
        self.plan, self.number = plan, number
        self.track = plan.track(
            number, codec="LPCR", parameters=plan.grid.build(), contract=plan.contract
        )
        self.pack = partial(encode_best, effort=plan.settings.searches)

    def take(self, values: NDArray[Any], start: int) -> NDArray[np.int64]:
        return self.plan.counts(values, self.number, start)

    def code(self, x: NDArray[np.int64], start: int) -> Made:
        packet = Packet(0, start, x.size, self.pack(nearest(x, self.plan.grid)))
        return checked(Made(self.track, [packet], x))


class BoundedEncoder(GridEncoder):
    """Counts within a deadband: knots or a grid, whichever is smaller (see :mod:`bounded`).

    The first block decides. Another form takes over where it has been much smaller for long.
    """

    def __init__(self, plan: Plan, bound: Bound, number: int) -> None:
        super().__init__(plan, number)
        self.bound = bound
        self.ways = slice(0 if plan.input.rate * (plan.settings.cluster or 1) < SHORT else 1, None)
        self.now = self.left = 0
        self.wait, self.needed = FIRST, DESCRIPTION
        self.saved: list[float] = []

    def code(self, x: NDArray[np.int64], start: int) -> Made:
        span = Span(start, start + x.size)
        source = InputBlock((self.plan.channel,), x[:, None], (span,))
        ways = [code for _, code in scalar_ways(source, self.bound)[self.ways]]
        found: Coded | None = None
        if self.left:
            self.left -= 1
            found = ways[self.now](self.track, None)
        if found is None:
            tried = self.try_all(ways)
            self.choose([size_of(each) if each else inf for each in tried])
            found = tried[self.now]
        assert found
        return checked(Made(found.track, found.packets, x))

    def try_all(self, ways: Sequence[Way]) -> list[Coded | None]:
        """The present form, and all that are smaller than those before them."""
        tried: list[Coded | None] = [None] * len(ways)
        smallest: int | None = None
        for place in sorted(range(len(ways)), key=lambda place: place != self.now):
            coded = tried[place] = ways[place](self.track, smallest)
            if coded and (smallest is None or coded.size < smallest):
                smallest = coded.size
        return tried

    def choose(self, sizes: list[float]) -> None:
        """The form of the next blocks, by the sizes of all of one block."""
        if not self.saved or sizes[self.now] == inf:
            self.now = sizes.index(min(sizes))
            self.saved = [0.0] * len(sizes)
        self.left = self.wait
        self.wait = min(2 * self.wait, LAST)
        size = sizes[self.now]
        for place, other in enumerate(sizes):
            more = (size - other) * self.left
            self.saved[place] = (
                self.saved[place] + more if other < MUCH * size else self.saved[place] / 2
            )
        best = self.saved.index(max(self.saved))
        if self.saved[best] > self.needed and sizes[best] < inf:
            self.now = best
            self.needed *= 2
            self.saved = [0.0] * len(sizes)


def size_of(coded: Coded) -> int:
    """Bytes of its packets."""
    return sum(len(packet.data) for packet in coded.packets)


def checked(made: Made) -> Made:
    """The same, where the decoded counts keep the contract."""
    contract = made.track.contract
    if contract is not None:
        band = Deadband(contract.kn, contract.kd, contract.floor, contract.zero)
        decoder = TrackDecoder(made.track, ENCODE_LEVEL)
        y = np.concatenate([decoder.decode(packet)[:, 0] for packet in made.packets])
        if band.outside(made.counts, y.astype(np.int64)).any():
            raise AssertionError("an encoder that guarantees a bound left it")
    return made


ROOM = 1000
"""How many times the largest value of its first block a channel within a bound may reach."""

SHARES = (Fraction(1, 200), Fraction(1, 20), Fraction(1, 6), Fraction(1))
"""Shares of the bound that a grid may take, the first that has the room; the last may have less."""

CHANGES = 16
"""So often a channel leaves its grid; then it keeps exact values."""

ROUND_OFF = 2**-12
"""Share of a bound that is left for rounding."""

FAR_OFF = 1 << 32
"""Steps from zero at which the rounding of float64 is below that of a count."""


class WithinEncoder:
    """Floats without a known step, within a bound: on a grid that suits the bound.

    The first block gives the grid. A bound relative to the range is one to the range so far: it
    holds for the whole range too, and grows when it can be twice as wide. A block with a value that
    the grid does not hold is kept bit for bit.
    """

    def __init__(self, plan: Plan, number: int, before: Track | None) -> None:
        self.plan, self.number, self.before = plan, number, before
        self.named = f"channel {number} ({plan.input.label!r})"
        self.low, self.high = inf, -inf
        self.allowed = 0.0
        self.exact: ExactEncoder | WordsEncoder | None = None
        self.within: GridEncoder | None = None
        self.changes, self.odd_count, self.is_exact = 0, 0, False

    def take(self, values: NDArray[Any], _start: int) -> Doubles:
        return floats(values, self.named).astype(np.float64, copy=False)

    def code(self, x: Doubles, start: int) -> Made:
        self.widen(x)
        counts = self.counts(x) if self.within and self.changes < CHANGES else None
        self.changes += bool(self.within) and counts is None and not self.is_exact
        self.is_exact = counts is None
        if counts is not None and self.within:
            return self.within.code(counts, start)
        if self.exact is None:
            self.exact = choose_exact(self.plan, self.number, x, self.before, counts=True)
        self.odd_count += x.size if self.within or not np.isfinite(x).all() else 0
        return self.exact.code(self.exact.take(x, start), start)

    @property
    def note(self) -> str | None:
        """What people should know at the end."""
        if not self.odd_count:
            return None
        return (
            f"{self.odd_count} samples of {self.plan.input.label!r} are kept bit for bit, with "
            "their clusters: infinite values, or too large for the grid of the bound"
        )

    def widen(self, x: Doubles) -> None:
        """Take a wider bound from this block on, where there is one."""
        finite, allowed = x[np.isfinite(x)], self.bound(x)
        if not allowed or allowed < 2 * self.allowed or (not self.within and self.is_kept(x)):
            return
        if self.exact is None:
            if self.before is not None:
                self.exact = encoder_after(self.plan, self.number, self.before)
            elif lattice := bounded_grid(finite, allowed, offset=not self.plan.promise.k):
                self.exact = ExactEncoder(self.plan, self.number, lattice)
        if isinstance(self.exact, ExactEncoder):
            plan = self.plan_within(self.exact.lattice, allowed)
            if plan:
                coder = BoundedEncoder(plan, plan.bound, self.number) if plan.bound else None
                self.within, self.allowed = coder or GridEncoder(plan, self.number), allowed

    def bound(self, x: Doubles) -> float:
        """The largest error, or the floor, by the samples up to this block; 0 for none."""
        amount = self.plan.promise.floor
        assert amount is not None
        calm = without_glitches(x[np.isfinite(x)])
        if calm.size:
            self.low, self.high = min(self.low, calm.min()), max(self.high, calm.max())
        with np.errstate(over="ignore"):
            extent = float(self.high - self.low) if self.low < self.high else 0.0
        value = amount.absolute(extent, None, self.plan.input.unit)
        return value if value is not None and value < inf else 0.0

    def is_kept(self, x: Doubles) -> bool:
        """Whether the preset keeps such samples without loss."""
        felt = self.plan.settings.preset != "perceptual" or self.plan.promise.k
        return not felt and bool(exact_kind(self.plan.channel, x))

    def plan_within(self, lattice: LiveLattice, allowed: float) -> Plan | None:
        """The plan for counts of this grid; None where it is too coarse, or its zero too far."""
        c = lattice.calibration
        half = float(abs(c.step) / 2 * (1 + ROUNDING))
        if half > allowed or abs(c.b) > FAR_OFF * abs(c.a):
            return None
        channel = replace(self.plan.channel, calibration=c, deviation=Deviation(half, half))
        promise = replace(self.plan.promise, floor=Tolerance(allowed))
        bound = bound_for(channel, promise, self.plan.settings)
        if bound and not bound.slack and not promise.k:
            bound = None
        plan = replace(
            self.plan, channel=channel, low=lattice.low, high=lattice.high, promise=promise,
            bound=bound,
        )  # fmt: skip
        return plan if plan.level.number == 1 else None

    def counts(self, x: Doubles) -> NDArray[np.int64] | None:
        """The counts of a block; None where the grid does not hold one of them."""
        assert self.within
        plan = self.within.plan
        c = plan.calibration
        with np.errstate(over="ignore", invalid="ignore"):
            guess = (x * c.d - c.b) / c.a
        if not ((guess >= plan.low) & (guess <= plan.high)).all():
            return None
        return np.clip(nearest_counts(x, c), plan.low, plan.high)


def bounded_grid(x: Doubles, allowed: float, *, offset: bool) -> LiveLattice | None:
    """The finest grid for a bound that has room for many times the finite values x; ``offset``:
    its zero may lie in the middle of them."""
    low, high = Fraction(float(x.min())), Fraction(float(x.max()))
    largest = max(abs(low), abs(high))
    error = Fraction(FOUR_DIGITS_DOWN.create_decimal_from_float(allowed * (1 - ROUND_OFF)))
    for part in SHARES:
        step = 2 * part * error
        reach = HIGH * step
        moved = offset and max(ROOM * (high - low), 2 * largest) <= reach < ROOM * largest
        if reach < ROOM * largest and not moved and part < 1:
            continue
        if step.numerator < AFFINE_LIMIT and step.denominator < EXACT_LIMIT:
            middle = round((low + high) / 2 / step) if moved else 0
            found = Calibration(step.numerator, middle * step.numerator, step.denominator)
            if abs(found.b) < AFFINE_LIMIT and found.covers(LOW, HIGH):
                return LiveLattice(found, ExactParameters())
    return None


def check_block(block: Block) -> None:
    named = f"channel {block.channel} ({block.input.label!r})"
    if block.values.ndim != 1 or not 1 <= block.values.size <= PACKET_SAMPLES:
        raise ParameterError(f"{named}: a block is a row of 1 to {PACKET_SAMPLES} samples")
    if not 0 <= block.start <= TICK_LIMIT - block.values.size:
        raise ParameterError(f"{named}: ticks lie in [0, 2^48)")


def check_continued(track: Track, before: Track) -> None:
    """What the tracks of one channel have in common (SPEC 6.3)."""
    one, other = track.components[0].calibration, before.components[0].calibration
    for name, same in (
        ("rate", track.rate == before.rate),
        ("number format", track.number_format == before.number_format),
        ("calibration", one == other),
    ):
        if not same:
            raise ParameterError(
                f"channel {before.first_channel} ({before.components[0].label!r}) cannot be "
                f"continued: its {name} is another in the file"
            )
