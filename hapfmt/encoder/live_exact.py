"""Channels of doubles, block by block and bit for bit: counts and corrections, or words.

A lattice is looked for in the first block, and stays. What leaves it takes longer corrections, and
any binary64 number has one, since places are counted modulo 2^64 (SPEC 9.7).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.exact import ExactParameters, Lacking
from ..codecs.raw import RawParameters, encode_raw
from ..codecs.values import Counts, Doubles, ordered
from ..format.cluster import Packet
from ..format.track import Affine, Track
from ..errors import ParameterError
from ..limits import LEVELS
from ..recording import Calibration
from .exact import beside_counts, natural_candidate
from .lattice import find_lattice, sparse
from .live_plan import Made, Plan, floats
from .predict import encode_best
from .quick import encode_quick

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

FAR = 1 << 53
UNCODED = np.iinfo(np.int64).min
"""The one correction that there is no code for."""

NUMBERS: dict[str, np.dtype[Any]] = {
    "binary32": np.dtype(np.float32),
    "binary64": np.dtype(np.float64),
}


@dataclass(frozen=True)
class Lattice:
    """Counts of doubles from ``low`` to ``high``, and the rule that makes doubles of counts."""

    calibration: Calibration
    parameters: ExactParameters
    low: int = LOW
    high: int = HIGH

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


class ExactEncoder:
    """Counts and corrections: LPCX."""

    def __init__(self, plan: Plan, number: int, lattice: Lattice) -> None:
        self.named, self.lattice = f"channel {number} ({plan.input.label!r})", lattice
        self.pack = encode_quick if plan.settings.fast else partial(encode_best, thorough=False)
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
        low, high = int(lacking.counts.min()), int(lacking.counts.max())
        return Made(self.track, [Packet(0, start, x.size, data)], low, high)


class WordsEncoder:
    """Words as they are: RAWB."""

    def __init__(self, plan: Plan, number: int, number_format: str) -> None:
        self.named = f"channel {number} ({plan.input.label!r})"
        self.dtype = NUMBERS[number_format]
        self.track = plan.track(
            number,
            codec="RAWB",
            parameters=RawParameters(self.dtype.itemsize).build(),
            number_format=number_format,
            count_min=0,
            count_max=0,
        )

    def take(self, values: NDArray[Any], start: int) -> NDArray[Any]:
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
    plan: Plan, number: int, first: NDArray[Any], before: Track | None
) -> ExactEncoder | WordsEncoder:
    """The encoder whose packet of the first block is the smallest; ``before``: the track that it
    continues, which leaves no choice."""
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
        return ExactEncoder(plan, number, Lattice(calibration, parameters))
    lattice = Lattice(calibration, parameters, before.count_min, before.count_max)
    return ExactEncoder(plan, number, lattice)
