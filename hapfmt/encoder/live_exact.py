"""Channels of doubles, block by block and bit for bit: counts and corrections, or words.

A lattice is looked for in the first block, and stays. What leaves it takes longer corrections, and
any binary64 number has one, since places are counted modulo 2^64 (SPEC 9.7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.exact import ExactParameters, Lacking
from ..codecs.grids import LpcParameters
from ..codecs.raw import RawParameters, encode_raw
from ..codecs.values import Counts, Doubles, ordered
from ..container.track import Affine, Track
from ..errors import ParameterError
from ..integers import build_varint
from ..limits import EXACT_LIMIT, LEVELS
from ..recording import Calibration
from .exact import natural_candidate
from .lattice import find_lattice, sparse
from .live_counts import Way
from .live_many import Shelf, Task
from .live_plan import Plan

COUNT_BITS = LEVELS[1].count_bits
LOW, HIGH = -(1 << (COUNT_BITS - 1)), (1 << (COUNT_BITS - 1)) - 1

HEADROOM, AT_REST = 32, Fraction(2)
"""How many times the range of the first block the counts hold; and the range of nothing but 0."""

POWERS, MIDDLE = range(15, -10, -1), 1 << 51
"""Decimals of a step, and the numerator of the middle count: what calibrations hold (VAL-001)."""

SEEN = 16
"""So many distinct values tell a lattice; fewer only one of plain decimals or binary fractions."""

PLAIN = 10**7
"""A denominator of plain decimals, at most."""

ALL_WAYS, AGAIN = (False, True), 16
"""Ways to code corrections, with recall or without; after so many packets both are tried again."""

FAR = 1 << 53
UNCODED = np.iinfo(np.int64).min
"""The one correction that there is no code for."""

NUMBERS: dict[str, np.dtype[Any]] = {
    "binary32": np.dtype(np.float32),
    "binary64": np.dtype(np.float64),
}


def numbers_of_block(plan: Plan, values: NDArray[Any], channel: int) -> NDArray[Any]:
    """float32 as it is, all else as the float64 that is the same number."""
    if values.dtype == np.float32:
        return np.ascontiguousarray(values)
    named = f"channel {channel} ({plan.input.label!r})"
    if values.dtype.kind not in "iuf" or values.dtype.itemsize > 8:
        raise ParameterError(f"{named} takes numbers of up to 64 bits, not {values.dtype}")
    x = np.ascontiguousarray(values, np.float64)
    if values.dtype.kind in "iu" and values.size and (np.abs(x) >= EXACT_LIMIT).any():
        raise ParameterError(f"{named} has integers beyond 2^53: give it a calibration")
    return x


@dataclass(frozen=True)
class Lattice:
    """Counts of doubles from ``low`` to ``high``, and the rule that makes doubles of counts."""

    calibration: Calibration
    parameters: ExactParameters
    low: int = LOW
    high: int = HIGH

    @property
    def wide(self) -> Lattice:
        """With all counts of level 1, where the calibration allows them."""
        wider = replace(self, low=LOW, high=HIGH)
        return wider if self.calibration.covers(LOW, HIGH) else self

    def nearest(self, x: Doubles) -> Counts:
        """Counts of any size; 0 of what is no number."""
        c = self.calibration
        with np.errstate(all="ignore"):
            guess = np.rint((x * float(c.d) - float(c.b)) / float(c.a))
        return np.clip(np.where(np.isnan(guess), 0.0, guess), -FAR, FAR).astype(np.int64)

    def lacking(self, x: Doubles) -> Lacking:
        """Counts and corrections."""
        affine = Affine(self.calibration.a, self.calibration.b, self.calibration.d)
        counts = nearest = np.clip(self.nearest(x), self.low, self.high)
        places = ordered(x)
        for bit in range(COUNT_BITS):
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


def lattices(x: Doubles) -> list[Lattice]:
    """What may serve the channel that begins with x: a natural lattice where x tells one, and a
    grid of decimals."""
    finite = x[np.isfinite(x)]
    found = [decimal_grid(finite)]
    distinct = np.unique(finite).size
    if finite.size < x.size or distinct < 2:
        return found
    exact = find_lattice(x + 0.0)
    if exact and (distinct >= SEEN or exact.calibration.d <= PLAIN):
        found.append(Lattice(exact.calibration, ExactParameters()))
        if not sparse(exact.counts):
            # Nothing coarser lies under it.
            return covering(found)
    if distinct >= SEEN and (near := natural_candidate(x, exact)):
        found.append(Lattice(near.calibration, near.parameters))
    return covering(found)


def covering(found: Sequence[Lattice]) -> list[Lattice]:
    """Those that allow all counts."""
    return [lattice for lattice in found if lattice.calibration.covers(LOW, HIGH)]


def decimal_grid(x: Doubles) -> Lattice:
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
            return Lattice(Calibration(a, offset, d), ExactParameters())
    return Lattice(Calibration(a, 0, d), ExactParameters())


class ExactLane:
    """Counts and corrections: LPCX."""

    ways: tuple[Way, ...] = ()

    def __init__(self, plan: Plan, number: int, lattice: Lattice) -> None:
        self.plan, self.number, self.lattice = plan, number, lattice
        channel = replace(plan.channel, calibration=lattice.calibration)
        self.track = replace(plan, channel=channel).track(
            number,
            codec="LPCX",
            parameters=lattice.parameters.build(),
            count_min=lattice.low,
            count_max=lattice.high,
        )
        self.wider: Track | None = None
        self.packer = self.packer_of(lattice)
        self.beside_way, self.left = ALL_WAYS[0], 0

    def packer_of(self, lattice: Lattice) -> Way:
        """How its counts are packed."""
        task = Task(lattice.low, lattice.high, LpcParameters(), None)
        return Way(task, Shelf(), fast=self.plan.settings.fast)

    def take(self, packets: Sequence[bytes]) -> bytes:
        return packets[0]

    def adopt(self, track: Track) -> None:
        """Goes on with a track of the same lattice while its range holds the counts."""
        following = replace(self.track, continues=track.id)
        if track.codec != "LPCX":
            self.track = following
            return
        self.track = track
        self.lattice = replace(self.lattice, low=track.count_min, high=track.count_max)
        if self.lattice.wide != self.lattice:
            self.wider = following

    def code(self, values: NDArray[Any], _start: int) -> bytes:
        x = numbers_of_block(self.plan, values, self.number).astype(np.float64, copy=False)
        if self.wider and not within(self.lattice.nearest(x), self.lattice):
            self.track, self.lattice, self.wider = self.wider, self.lattice.wide, None
            self.packer = self.packer_of(self.lattice)
        lacking = self.lattice.lacking(x)
        coded = self.packer.pack(lacking.counts)
        return build_varint(len(coded)) + coded + self.beside(lacking)

    def beside(self, lacking: Lacking) -> bytes:
        """The corrections, the way that was smallest when both were tried last."""
        ways = [self.beside_way] if self.left else ALL_WAYS
        self.left = (self.left or AGAIN) - 1
        _, self.beside_way, data = min(
            (len(data), recall, data) for recall in ways for data in (lacking.build(recall=recall),)
        )
        return data


def within(counts: Counts, lattice: Lattice) -> bool:
    return lattice.low <= int(counts.min()) and int(counts.max()) <= lattice.high


class WordsLane:
    """Words as they are: RAWB."""

    ways: tuple[Way, ...] = ()

    def __init__(self, plan: Plan, number: int, number_format: str) -> None:
        self.plan, self.number = plan, number
        self.dtype = NUMBERS[number_format]
        self.track = plan.track(
            number,
            codec="RAWB",
            parameters=RawParameters(self.dtype.itemsize).build(),
            number_format=number_format,
            count_min=0,
            count_max=0,
        )

    def take(self, packets: Sequence[bytes]) -> bytes:
        return packets[0]

    def adopt(self, track: Track) -> None:
        self.track = track

    def code(self, values: NDArray[Any], start: int) -> bytes:
        x = numbers_of_block(self.plan, values, self.number)
        words = x.astype(self.dtype, copy=False)
        if words.dtype != x.dtype and words.dtype == np.float32:
            same = words.astype(np.float64).view(np.int64) == x.view(np.int64)
            if not same.all():
                at = int(np.argmin(same))
                raise ParameterError(
                    f"channel {self.number} ({self.plan.input.label!r}), tick {start + at}: "
                    f"{float(x[at])!r} is not a binary32 number, but the first values were"
                )
        return encode_raw(words[:, None], self.dtype.itemsize)


def choose_exact(
    plan: Plan, number: int, first: NDArray[Any], before: Track | None
) -> ExactLane | WordsLane:
    """The lane whose packet of the first block is the smallest; ``before``: the track that it goes
    on with, which leaves no choice."""
    if before is not None:
        return lane_after(plan, number, before)
    x = numbers_of_block(plan, first, number)
    words = WordsLane(plan, number, "binary32" if x.dtype == np.float32 else "binary64")
    doubles = x.astype(np.float64, copy=False)
    lanes: list[ExactLane | WordsLane] = [
        ExactLane(plan, number, lattice) for lattice in lattices(doubles)
    ]
    if lanes and np.unique(doubles).size < SEEN:
        # Next to nothing is known of the signal: counts can become small later, words cannot.
        lanes = lanes[-1:]
    else:
        lanes.append(words)
    return min(lanes, key=lambda lane: len(lane.code(first, 0)))


def lane_after(plan: Plan, number: int, before: Track) -> ExactLane | WordsLane:
    if before.number_format in NUMBERS:
        return WordsLane(plan, number, before.number_format)
    if before.number_format != "counts":
        raise ParameterError(
            f"channel {number} ({plan.input.label!r}) cannot be continued by floats: the file has "
            f"{before.number_format}"
        )
    parameters = ExactParameters()
    if before.codec == "LPCX":
        parameters = ExactParameters.parse(before.parameters, 0)
    calibration = Calibration(*before.components[0].calibration)
    lattice = Lattice(calibration, parameters, before.count_min, before.count_max)
    return ExactLane(plan, number, lattice.wide)
