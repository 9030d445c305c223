"""A channel that is felt: its slow part, its texture, and what a promise allows there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, nextafter, sqrt

import numpy as np
from numpy.typing import NDArray

from ..metrics import MOVES, Quantity
from ..recording import Calibration, Channel
from ..split import PADDING_PERIODS, SECTIONS_RATIO, low_pass, slow_for_telling
from .plan import Promise, quantity_of, without_glitches
from .quality import Measure, ThresholdMeasure, measure_of
from .source import InputBlock

Doubles = NDArray[np.float64]

STRETCH = 1 << 18
"""Samples that are filtered at a time."""

ALIKE_RATIO = 0.2
"""Up to this cutoff / rate the filter by sections gives the same, in half the time."""

RESOLVED = 1e-12
"""Share of the largest value that rounding leaves where the slow part is the signal itself."""

DEADBAND_SHARE = 3.0
"""Where evenly spread errors would be this many times too large, those of lines are too."""

SMALLEST = 1e-300

SILENT_S = 0.5
"""A stretch without texture lasts this long at least, in seconds."""


@dataclass(frozen=True)
class FeltChannel:
    """One channel in its unit: samples, their slow part, and what the promise allows there."""

    x: Doubles
    slow: Doubles
    allowed: Doubles
    floor: float
    textured: NDArray[np.bool_] | None
    """Samples that are not in a silent stretch; None: all."""

    power: float
    """Power of the part above the split frequency where there is texture."""

    whole_power: float
    """The same, with silent stretches."""

    measure: Measure
    source: InputBlock
    cutoff_hz: float
    weighting: float = 0.0
    """Exponent of the threshold of vibration; 0 where that of the quantity is not known."""

    moves: Quantity = "displacement"

    @classmethod
    def of(cls, x: Doubles, source: InputBlock, promise: Promise, cutoff_hz: float) -> FeltChannel:
        assert promise.floor is not None and promise.texture is not None
        calm = without_glitches(x)  # one glitch of 1 kN would hide a texture of 30 mN
        slow = slow_of(calm, source, cutoff_hz)
        extent = float(np.ptp(calm))
        channel = source.channels[0]
        step = float(abs(channel.calibration.step)) if channel.calibration else None
        floor = promise.floor.absolute(extent, step, channel.unit) or 0.0
        allowed = np.maximum(float(promise.k) * np.abs(slow), floor)
        textured = None
        if promise.texture.drops_silence:
            textured = textured_samples(x - slow, floor, source)
        fast = calm - slow
        power = float((fast if textured is None else fast[textured]).var())
        measure = measure_of(promise.texture, x, power, textured, source)
        moves = MOVES.get(quantity_of(channel))
        return cls(
            x, slow, allowed, floor, textured, power, float(fast.var()), measure, source, cutoff_hz,
            promise.texture.weighting if moves else 0.0, moves or "displacement",
        )  # fmt: skip

    @property
    def silent(self) -> bool:
        """Whether what lies above the split frequency is below the absolute threshold, as root
        mean square: the onsets of smooth contact, which the deadband keeps, are no texture."""
        return self.whole_power <= self.floor**2

    @property
    def smooth(self) -> bool:
        """Whether what lies above the split frequency is only rounding of float64."""
        return sqrt(self.power) <= RESOLVED * float(np.abs(self.x).max(initial=0.0))

    @property
    def fine(self) -> bool:
        """Whether the quality asks for errors below the absolute threshold: those of a uniform
        grid are spread evenly, so their mean square is a third of the largest one's."""
        return self.first_step <= 2 * self.floor

    @property
    def threshold_decides(self) -> bool:
        return isinstance(self.measure, ThresholdMeasure)

    @property
    def deadband_may_do(self) -> bool:
        """Whether the deadband of the slow part may be as narrow as the quality asks for: errors
        of lines are about spread evenly."""
        noise = float(np.square(self.allowed).mean()) / 3
        return noise <= DEADBAND_SHARE * self.power * self.measure.noise

    @property
    def first_step(self) -> float:
        """The step of a uniform grid that about has the quality."""
        return sqrt(12 * self.power * self.measure.noise)

    @cached_property
    def wanted(self) -> Doubles:
        """What is coded: in silent stretches the slow part."""
        return self.x if self.textured is None else np.where(self.textured, self.x, self.slow)

    def wanted_counts(self, channel: Channel) -> NDArray[np.int64]:
        """The same in counts of this channel, or of its finer form."""
        assert channel.calibration is not None
        if self.textured is None:
            return channel.stored.astype(np.int64)
        return counts_nearest(self.wanted, channel.calibration)

    def holds(self, y: Doubles) -> bool:
        """Whether decoded samples keep the quality, and their slow part the deadband."""
        return self.measure.error(y) <= self.measure.allowed and self.slow_holds(y)

    def slow_holds(self, y: Doubles) -> bool:
        return self.slow_excess(y) <= 1

    def slow_excess(self, y: Doubles) -> float:
        """The largest error of the slow part, in deadbands; or a larger number up to 1, where no
        sample leaves the narrowest deadband. The slow part of an error is within its range."""
        error = y - self.x
        largest = max(float(error.max(initial=0.0)), -float(error.min(initial=0.0)))
        if largest <= self.floor and self.floor > 0:
            return largest / self.floor
        error = np.abs(slow_of(error, self.source, self.cutoff_hz))
        beyond = error > self.allowed
        if not beyond.any():
            return float((error / np.maximum(self.allowed, SMALLEST)).max(initial=0.0))
        # Also where the quotient rounds to 1.
        return max(float((error / np.maximum(self.allowed, SMALLEST)).max()), nextafter(1, 2))


def counts_nearest(x: Doubles, calibration: Calibration) -> NDArray[np.int64]:
    exact = (x * calibration.d - calibration.b) / calibration.a
    return np.floor(exact + 0.5).astype(np.int64)


def textured_samples(fast: Doubles, floor: float, source: InputBlock) -> NDArray[np.bool_] | None:
    """Samples outside of stretches that stay below the threshold; None where there is no such
    stretch."""
    loud = np.abs(fast) > floor
    least = max(round(SILENT_S * float(source.rate)), 1)
    found = np.ones(loud.size, np.bool_)
    for rows in source.segments():
        marks = np.flatnonzero(loud[rows]) + rows.start
        edges = np.concatenate(([rows.start - 1], marks, [rows.stop]))
        for place in np.flatnonzero(np.diff(edges) > least).tolist():
            found[edges[place] + 1 : edges[place + 1]] = False
    return None if found.all() or not found.any() else found


def slow_of(x: Doubles, source: InputBlock, cutoff_hz: float) -> Doubles:
    """The slow part; no filter reaches over a gap. Stretch by stretch, with what the filter needs
    to settle on both sides."""
    rate, out = float(source.rate), np.empty_like(x)
    margin = ceil(PADDING_PERIODS * rate / cutoff_hz)
    for rows in source.segments():
        for start in range(rows.start, rows.stop, STRETCH):
            stop = min(start + STRETCH, rows.stop)
            first, last = max(start - margin, rows.start), min(stop + margin, rows.stop)
            if SECTIONS_RATIO <= cutoff_hz / rate <= ALIKE_RATIO:
                slow = low_pass(x[first:last], rate, cutoff_hz)
            else:
                slow = slow_for_telling(x[first:last, None], rate, cutoff_hz)[:, 0]
            out[start:stop] = slow[start - first : stop - first]
    return out
