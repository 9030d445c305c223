"""What each channel keeps: a preset is a function from a channel to a promise.

The range and the slow part leave out single samples far beyond all others. A cable makes such
samples, a hand does not. One sample of 1 kN in a texture of 30 mN would make a threshold relative
to the range a thousand times too wide. It would also draw the slow part by 50 N. Such samples are
coded like any other. The encoder leaves them out only of what it takes from the signal as a whole:
its range and its slow part.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from math import inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataWarning, ParameterError
from ..metrics import MOVES
from ..recording import Channel, Recording
from ..split import LF_CUTOFF_HZ
from ..units import unit_text
from .settings import (
    ALL,
    FELT_OPTIONS,
    FORCE_FLOORS,
    QUANTITY_OF_UNIT,
    RANGE_FLOOR,
    TEXTURE_OPTIONS,
    USED_BY,
    WEBER_LIMITS,
    Settings,
    TextureQuality,
    Tolerance,
)

STATES = 4
"""A channel with at most four distinct values holds states (a button, a phase), no signal."""

CLOCK_SAMPLES = 16
"""Channels with fewer samples that only rise do not show whether they go on rising."""

CLOCK_SHARE = 0.5
"""A counter or clock advances on at least this share of its samples; a position that is only pushed
forward rests in between."""

CLOCK_LABEL = re.compile(
    r"(^|[\W_])(time(stamps?)?|clock|counter|seq(uence)?|frame|index)($|[\W_])", re.IGNORECASE
)

KNOWN_QUANTITIES = frozenset(QUANTITY_OF_UNIT.values())


@dataclass(frozen=True)
class Promise:
    """What a channel keeps.

    floor: every sample is within max(k * |x|, floor) of the recorded one; None: every bit is kept.
    texture: quality of the texture; max(k * |x|, floor) then holds for the slow part. None: it
    holds for every sample. paper: the method of the paper, which promises nothing. why: for the
    user.
    """

    floor: Tolerance | None = None
    k: Fraction = Fraction(0)
    texture: TextureQuality | None = None
    paper: bool = False
    why: str = ""

    @property
    def lossless(self) -> bool:
        return self.floor is None


def promises_of(recording: Recording, settings: Settings) -> list[Promise]:
    """Return one promise for each channel. The caller says which are felt, or their quantities do.

    Raises ParameterError where an option of preset perceptual has nothing to act on; a DataWarning
    tells of options that do nothing here, and of a recording in which no channel is felt.
    """
    channels = recording.channels
    felt = felt_channels(channels, settings)
    promises = [
        promise_of(channel, settings, felt=None if settings.felt is None else is_felt)
        for channel, is_felt in zip(channels, felt, strict=True)
    ]
    if not recording.sample_count:
        return promises
    check_kinds(channels, settings, promises)
    if settings.preset == "perceptual":
        check_effects(channels, settings, felt, promises)
        for text in idle_options(channels, settings, felt, promises):
            # The caller of hapfmt.write is five calls away.
            warnings.warn(text, DataWarning, stacklevel=5)
    return promises


def felt_channels(channels: Sequence[Channel], settings: Settings) -> list[bool]:
    """Return whether each channel is felt: by its quantity, or because the caller says so."""
    if settings.felt == ALL:
        return [True] * len(channels)
    felt = [quantity_of(channel) in WEBER_LIMITS for channel in channels]
    for name in settings.felt or ():
        for number in called_felt(name, channels):
            felt[number] = True
    return felt


def called_felt(name: str, channels: Sequence[Channel]) -> list[int]:
    """Return the numbers of the channels that ``felt`` names by a label or a number."""
    labels = [channel.label for channel in channels]
    if name in labels:
        return [number for number, label in enumerate(labels) if label == name]
    if name.isdecimal() and int(name) < len(labels):
        return [int(name)]
    raise ParameterError(f"no channel is called {name!r}; there are: {', '.join(labels)}")


def check_kinds(channels: Sequence[Channel], settings: Settings, promises: list[Promise]) -> None:
    """Refuse options for floating point channels, or for vectors, where there are none."""
    if settings.tolerance is not None and not any(
        channel.calibration is None and not promise.lossless
        for channel, promise in zip(channels, promises, strict=True)
    ):
        raise ParameterError(
            "tolerance would do nothing: no floating point channel may have an error; "
            "integer channels have a grid already"
        )
    if settings.vectors == "required" and not any(
        one.group and one.group == other.group for one, other in pairwise(channels)
    ):
        raise ParameterError(
            "vectors would do nothing: no neighbours share a group; give the axes of a vector "
            "the same group"
        )


NOT_FELT = "no channel is known to be felt: add unit='N' or felt='all'"


def check_effects(
    channels: Sequence[Channel], settings: Settings, felt: list[bool], promises: list[Promise]
) -> None:
    """Refuse options of preset perceptual that no channel of this recording uses."""
    if not any(felt):
        if unused := settings.departures(FELT_OPTIONS):
            raise ParameterError(f"{USED_BY[unused[0]][0]} would do nothing: {NOT_FELT}")
    elif unused := settings.departures(TEXTURE_OPTIONS):
        textured = [channels[n] for n, promise in enumerate(promises) if promise.texture]
        if not textured:
            slowest = 2 * settings.cutoff_hz
            raise ParameterError(
                f"{USED_BY[unused[0]][0]} would do nothing: no felt channel has a texture. "
                f"Each is constant, silent, or has at most {slowest:g} samples/s"
            )
        if settings.weighting and not any(quantity_of(each) in MOVES for each in textured):
            raise ParameterError(
                "weighting would do nothing: no threshold of vibration is known for "
                f"{called(textured[0])}; leave it out"
            )


def idle_options(
    channels: Sequence[Channel], settings: Settings, felt: list[bool], promises: list[Promise]
) -> Iterator[str]:
    """Yield a sentence for each choice of preset perceptual that does nothing here."""
    if not any(felt):
        # A clock, a constant or states are lossless for a reason of their own.
        kept = {
            f"within {amount_text(each.floor)}" if each.floor else "lossless"
            for each in promises
            if not (each.lossless and each.why)
        }
        if kept:
            yield f"{NOT_FELT}; until then channels are kept {' or '.join(sorted(kept))}"
        return
    bounded = any(promise.floor is settings.max_error for promise in promises)
    if settings.departures(["max_error"]) and not bounded:
        yield (
            "max_error does nothing here: every channel is felt or lossless; "
            "the threshold of felt channels is floor"
        )
    slowest = 2 * min(settings.cutoff_hz, LF_CUTOFF_HZ)
    if settings.departures(["cutoff_hz"]) and not any(
        is_felt and channel.rate_exact > slowest
        for is_felt, channel in zip(felt, channels, strict=True)
    ):
        yield f"cutoff_hz does nothing here: no felt channel has over {slowest:g} samples/s"
    if settings.departures(["k"]):
        fractions = {promise.k for promise in promises if promise.k}
        if fractions and settings.k not in fractions:
            most = float(100 * max(fractions))
            yield f"k does nothing here: it is at most {most:g} % for velocities"
    for name in settings.felt or () if settings.felt != ALL else ():
        for number in called_felt(name, channels):
            channel = channels[number]
            if promises[number].lossless:
                yield f"felt does nothing for {name!r}: it is lossless ({promises[number].why})"
            elif WEBER_LIMITS.get(quantity_of(channel), 0) is None:
                yield f"felt does nothing for {name!r}: its unit or quantity says that it is felt"


LARGEST_SHARE = 0.1
"""Share of a channel's range that a largest error may be. A larger one is probably a mistake."""


def check_error(settings: Settings, extent: float, error: float, label: str, unit: str) -> None:
    """Refuse a largest error that flattens the channel, unless it is a share of the range.

    extent: the channel's largest minus its smallest value, in ``unit``; error: in ``unit`` too.
    """
    if text := too_wide(settings, extent, error, label, unit):
        amount = settings.max_error
        meant = amount.is_plain and amount.value <= 100 * LARGEST_SHARE
        guess = f"; did you mean {amount.value:g}%?" if meant else "."
        raise ParameterError(f"{text}{guess} To allow it, add force_error=True")


def too_wide(settings: Settings, extent: float, error: float, label: str, unit: str) -> str:
    """Return the share that the largest error has of a range; "" where it is small enough."""
    if settings.allows_any_error or not error > LARGEST_SHARE * extent > 0:
        return ""
    amount = settings.max_error
    share = f"{100 * error / extent:.3g} % of the range" if error < extent else "the whole range"
    shown = replace(amount, unit=amount.unit or unit_text(unit))
    return f"{amount_text(shown)} is {share} of channel {label!r}"


def range_of(channel: Channel) -> float:
    """Return the range of a channel in its unit, without glitches, NaN and infinities."""
    if channel.calibration is None:
        return extent_of(channel.stored)
    return extent_of(channel.stored) * float(abs(channel.calibration.step))


def extent_of(x: NDArray[Any]) -> float:
    """Return the largest minus the smallest of [ticks] numbers, without glitches, NaN and
    infinities."""
    if x.dtype.kind == "f" and not np.isfinite(x).all():
        x = x[np.isfinite(x)]
    if not x.size:
        return 0.0
    calm = without_glitches(x)
    with np.errstate(over="ignore"):
        return float(calm.max()) - float(calm.min())


def promise_of(channel: Channel, settings: Settings, *, felt: bool | None = None) -> Promise:
    """What the preset promises for a channel. felt: as the caller says; None: by the quantity."""
    if settings.preset == "lossless":
        return Promise()
    if settings.preset == "paper":
        return paper_promise(channel, settings)
    if settings.preset == "near-lossless":
        return bound_promise(settings)
    if settings.felt == ALL:
        return felt_promise(channel, settings)
    x = channel.samples()
    kept = exact_kind(channel, x)
    if kept:
        return Promise(why=kept)
    quantity = quantity_of(channel)
    by_nature = quantity in WEBER_LIMITS
    if not (by_nature if felt is None else felt):
        return replace(bound_promise(settings), why=f"{called(channel)}: absolute error bound only")
    threshold = absolute_threshold(channel, settings)
    if threshold is not None and x.size and float(np.abs(x).max()) <= threshold.value:
        text = f"{threshold.value:g} {channel.unit}"
        return Promise(threshold, why=f"silent: nothing above {text}")
    return felt_promise(channel, settings)


def bound_promise(settings: Settings) -> Promise:
    return Promise(settings.max_error)


def felt_promise(channel: Channel, settings: Settings) -> Promise:
    quantity = quantity_of(channel)
    limit = WEBER_LIMITS.get(quantity) if settings.felt is None else None
    k = settings.k if limit is None else min(settings.k, limit)
    floor = settings.deadband_floor
    textured = settings.texture and channel.rate_exact > 2 * settings.cutoff_hz
    why = f"{quantity}: " if quantity else ""
    return Promise(
        floor,
        k,
        settings.target if textured else None,
        why=f"{why}threshold {amount_text(floor)}",
    )


def vector_promise(settings: Settings) -> Promise:
    """One deadband on the norm, for axes that the caller asked for as one vector."""
    floor = settings.deadband_floor
    return Promise(
        floor,
        settings.k,
        why=f"vector: threshold {amount_text(floor)}",
    )


def paper_promise(channel: Channel, settings: Settings) -> Promise:
    """The paper's absolute threshold is 10 mN, of a force; other units have none."""
    floor, why = settings.floor, ""
    if floor is None:
        newtons = FORCE_FLOORS.get(channel.unit)
        floor = RANGE_FLOOR if newtons is None else Tolerance(float(newtons))
        if newtons is None:
            why = f"threshold {amount_text(floor)}: the paper's 10 mN is for forces only"
    return Promise(floor, settings.k, paper=True, why=why)


def called(channel: Channel) -> str:
    """What a channel without a felt zero is, for the user."""
    quantity = quantity_of(channel)
    if quantity:
        return quantity
    return "raw counts" if channel.unit in ("1", "{count}", "{lsb}") else f"unit {channel.unit}"


def exact_kind(channel: Channel, x: NDArray[np.float64]) -> str:
    """Why a channel is kept without loss; empty where it need not be."""
    if not x.size:
        return "no samples"
    if (x == x[0]).all():
        return "constant"
    quantity = quantity_of(channel)
    if quantity == "time":
        return "a clock"
    if quantity in WEBER_LIMITS:
        return ""
    if quantity == "" and CLOCK_LABEL.search(channel.label):
        return "a clock or counter by its name"
    if is_clock(x):
        return "only rises or only falls: a clock or counter"
    if few_values(x):
        return f"at most {STATES} distinct values: states"
    return ""


def is_clock(x: NDArray[np.float64]) -> bool:
    """Whether values only rise, or only fall, and seldom rest."""
    if x.size < CLOCK_SAMPLES:
        return False
    before, after = x[:-1], x[1:]
    one_way = bool((after >= before).all() or (after <= before).all())
    return one_way and int(np.count_nonzero(after != before)) >= CLOCK_SHARE * before.size


def few_values(x: NDArray[np.float64]) -> bool:
    left = x
    for _ in range(STATES):
        left = left[left != left[0]]
        if not left.size:
            return True
    return False


def quantity_of(channel: Channel) -> str:
    """The quantity as the channel names it, else by its unit; empty where neither tells.

    A name that is not known here ("normal force") gives way to a unit that is.
    """
    named = channel.quantity.strip().lower()
    by_unit = QUANTITY_OF_UNIT.get(channel.unit, "")
    return named if named in KNOWN_QUANTITIES else by_unit or named


def absolute_threshold(channel: Channel, settings: Settings) -> Tolerance | None:
    """Below it nothing is felt: the caller's floor where it is absolute, else that of a force; in
    the channel's unit."""
    quantity = quantity_of(channel)
    if quantity not in WEBER_LIMITS:
        return None
    if settings.floor is not None:
        absolute = settings.floor.kind == "absolute"
        return Tolerance(settings.floor.in_unit(channel.unit)) if absolute else None
    newtons = FORCE_FLOORS.get(channel.unit) if quantity == "force" else None
    return None if newtons is None else Tolerance(float(newtons))


def amount_text(amount: Tolerance) -> str:
    if amount.kind == "range":
        return f"{100 * amount.value:g} % of range"
    steps = "step" if amount.value == 1 else "steps"
    return f"{amount.value:g} {steps if amount.kind == 'lsb' else amount.unit}".rstrip()


LEAST = 64
"""Samples of a channel; with fewer, no sample can be called rare."""

RARE = 1000
"""At most one sample in this many is rare; more frequent values are the signal."""

BLOCK, FEW = 1 << 16, 8
"""Medians that are looked at in one go, and of how many samples one is looked at first."""


def median3(x: NDArray[Any], every: int = 1) -> NDArray[Any]:
    """[n] -> [n - 2]: the median of each sample and its neighbours; or of one in ``every``."""
    a, b, c = x[:-2:every], x[1:-1:every], x[2::every]
    return np.asarray(np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c)))


def find_glitches(x: NDArray[Any]) -> NDArray[np.intp]:
    """Places in [ticks] finite numbers: beyond the range of the medians of three by more than that
    range, where such samples are rare; otherwise none."""
    none = np.zeros(0, np.intp)
    if x.size < LEAST:
        return none
    least, most = x.min().item(), x.max().item()
    # The medians of some samples have no wider a range than all of them, and mostly tell.
    for every in (FEW, 1):
        ends = [
            (part.min().item(), part.max().item())
            for start in range(0, x.size - 2, BLOCK * every)
            for part in (median3(x[start : start + BLOCK * every + 2], every),)
        ]
        low, high = min(a for a, _ in ends), max(b for _, b in ends)
        # In Python: the range of 32-bit counts takes 33, and of doubles it may be infinite.
        below, above = low - (high - low), high + (high - low)
        if below <= least and most <= above:
            return none
    found = np.flatnonzero((x < below) | (x > above))
    return found if found.size <= max(x.size // RARE, 1) else none


def without_glitches(x: NDArray[Any]) -> NDArray[Any]:
    """[ticks] with the median of three in the place of each; x itself where there is none."""
    found = find_glitches(x)
    if not found.size:
        return x
    calm = x.copy()
    calm[found] = median3(np.pad(x, 1, mode="reflect"))[found]
    return calm


@dataclass
class Range:
    """The range of samples that come in pieces, and of the medians of each three neighbours."""

    low: float = inf
    high: float = -inf
    calm_low: float = inf
    calm_high: float = -inf
    last: NDArray[Any] | None = None

    def add(self, x: NDArray[Any]) -> None:
        if not x.size:
            return
        self.low, self.high = min(self.low, x.min().item()), max(self.high, x.max().item())
        x = x if self.last is None else np.concatenate([self.last, x])
        if x.size > 2:
            calm = median3(x)
            self.calm_low = min(self.calm_low, calm.min().item())
            self.calm_high = max(self.calm_high, calm.max().item())
        self.last = x[-2:].copy()

    @property
    def extent(self) -> float:
        """Without single samples far beyond all others: never more than the range of the rest."""
        low, high = self.calm_low, self.calm_high
        return high - low if low <= high and isfinite(high - low) else 0
