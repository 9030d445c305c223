"""What the caller asks of the encoder: a preset, and what departs from it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, inf
from numbers import Real
from typing import Any, Literal

import numpy as np

from ..codecs.knots import INTERPOLATIONS, Interpolation
from ..errors import ParameterError
from ..numbers import exact
from ..recording import Calibration, Channel, Recording
from .glitches import without_glitches
from .perception import FORCE_FLOOR_N, FORCE_WEBER, LF_CUTOFF_HZ
from .tolerance import Tolerance

Preset = Literal["default", "auto", "paper", "deadband", "archive", "near-lossless"]
PRESETS: tuple[Preset, ...] = (
    "default", "auto", "paper", "deadband", "archive", "near-lossless"
)  # fmt: skip

WITHIN = frozenset({"auto", "deadband", "archive", "near-lossless"})
"""Presets that keep every sample within a bound by construction."""

BITS = range(2, 17)
"""Quantiser of the paper: 2**b - 1 levels; one bit would leave level 0 only."""

PAPER_TOLERANCE = Fraction(1, 32)
"""Presets paper and auto put true doubles on a lattice this fine against their floor: the error
that the lattice adds is a 32nd of what the floor already allows."""

ARCHIVE_CLUSTER = Fraction(10)
"""Seconds (SPEC clause 13)."""

LEARNING, LONGEST_CLUSTER = 1 << 14, Fraction(120)
"""Samples after which adaptive models have learned most and the rows of a packet table cost little
(a glove at 100 Hz: clusters of 120 s take 36 % less than those of 41 s, measured), and the seconds
that a slow channel may wait for them."""

LEAST_TICKS = 256
"""Of the fastest channel in a cluster. With one in each, as ten seconds give it, 1000 samples of
1/3600 Hz took 49 kB; so they take 1.3 kB."""

LONG_PACKET = 1 << 15
"""Samples of a packet of Rice codes, which learn nothing: as long as one predictor does for."""

RANGE_FLOOR = Tolerance(0.002, "range")
"""0.2 % of the channel's own range: a floor for any quantity, not only for forces."""


@dataclass(frozen=True)
class Settings:
    """Choices of the encoder; none of them is needed to decode.

    k: the Weber fraction. floor: absolute floor of the deadband. bits: the paper's
    range-derived quantiser (0: no HF track, None: use ``step``). step: explicit step of the
    residual. cutoff_hz of the split. cluster: seconds (None: as the preset needs). tolerance:
    allows true doubles to be put on a lattice. interpolation of the knots. digest: write SHA-256
    of the decoded tracks. max_error: of preset near-lossless. vectors: "required" raises where
    channels of one group cannot be coded as one vector, "possible" codes them apart. references:
    presets archive and near-lossless may put channels that resemble each other in one track, each
    predicted from those before it; one lost packet then takes all of them along, and to read one
    all are decoded. fast: of preset archive, a fraction of the time for a few percent of size.
    Amounts may be given as their texts ("0.2%", "1lsb"), numbers as any number.
    """

    preset: Preset = "default"
    k: Fraction = FORCE_WEBER
    floor: Tolerance = RANGE_FLOOR
    bits: int | None = None
    step: Tolerance | None = None
    cutoff_hz: float = LF_CUTOFF_HZ
    cluster: Fraction | None = None
    tolerance: Tolerance | None = None
    interpolation: Interpolation = "linear"
    digest: bool = False
    max_error: Tolerance | None = None
    vectors: Literal["possible", "required"] = "possible"
    references: bool = True
    fast: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "k", exact(self.k))
        if self.cluster is not None:
            object.__setattr__(self, "cluster", exact(self.cluster))
        for name in ("floor", "step", "tolerance", "max_error"):
            object.__setattr__(self, name, amount(getattr(self, name)))
        if self.interpolation not in INTERPOLATIONS:
            raise ParameterError(f"knots are joined by one of {', '.join(INTERPOLATIONS)}")
        if self.preset not in PRESETS:
            raise ParameterError(f"a preset is one of {', '.join(PRESETS)}")
        if (self.preset == "near-lossless") != (self.max_error is not None):
            raise ParameterError("the largest error goes with preset near-lossless: 2lsb, 0.1%")
        if self.preset in WITHIN and (self.bits is not None or self.step is not None):
            raise ParameterError(f"preset {self.preset} has no bits and no step to choose")
        if self.fast and self.preset != "archive":
            raise ParameterError("fast goes with preset archive")
        if not 0 <= self.k <= 65535:
            raise ParameterError("the Weber fraction k lies between 0 and 65535")
        if self.bits is not None and self.bits and self.bits not in BITS:
            raise ParameterError("bits are 0 (no residual) or 2 to 16")
        if self.bits is not None and self.step is not None:
            raise ParameterError("give the bits or the step of the residual, not both")
        if not (isinstance(self.cutoff_hz, Real) and 0 < self.cutoff_hz < inf):
            raise ParameterError("the cutoff is a positive frequency")
        if self.cluster is not None and self.cluster <= 0:
            raise ParameterError("clusters have a positive length")

    @classmethod
    def of(cls, preset: str = "default", **given: Any) -> Settings:
        """The preset's settings with those that are given and not None in their place."""
        chosen = {name: value for name, value in given.items() if value is not None}
        if preset == "near-lossless":
            # It cannot be without the error that is allowed.
            return cls("near-lossless", **chosen)
        if preset == "paper":
            # The paper's floor is that of a force in newtons, its step comes from the range.
            base = cls("paper", floor=Tolerance(float(FORCE_FLOOR_N)))
            if "step" not in chosen and "bits" not in chosen:
                chosen["bits"] = 5
        else:
            base = cls(preset)  # type: ignore[arg-type]
        return replace(base, **chosen)

    def cluster_of(self, recording: Recording) -> Fraction:
        """Seconds of a cluster: as asked for; else ten, and where packets learn as they go, as many
        as give the fastest channel enough to learn from; and never few ticks."""
        if self.cluster is not None:
            return self.cluster
        fastest = max((channel.rate_exact for channel in recording.channels), default=Fraction(1))
        seconds = ARCHIVE_CLUSTER
        if self.fast:
            seconds = min(Fraction(ceil(LONG_PACKET / fastest)), LONGEST_CLUSTER)
        elif self.preset in WITHIN:
            learning = Fraction(ceil(LEARNING / fastest))
            seconds = min(max(ARCHIVE_CLUSTER, learning), LONGEST_CLUSTER)
        return max(seconds, Fraction(ceil(LEAST_TICKS / fastest)))

    def tolerance_for(self, channel: Channel) -> Tolerance | None:
        """What may be lost by putting true doubles on a lattice; None: nothing."""
        if self.tolerance is not None or self.preset != "paper":
            return self.tolerance
        return self.share_of_floor(channel)

    def share_of_floor(self, channel: Channel) -> Tolerance | None:
        """The tolerance that the floor itself leaves room for."""
        if channel.is_counts:
            return None
        finite = channel.samples()
        finite = finite[np.isfinite(finite)]
        finite = without_glitches(finite)
        extent = float(finite.max()) - float(finite.min()) if finite.size else 0.0
        allowed = (self.floor.absolute(extent, channel.lsb) or 0.0) * float(PAPER_TOLERANCE)
        # Nothing is left of a floor below the denormals, and values of 1e308 have no lattice.
        return Tolerance(allowed) if 0.0 < allowed < inf else None

    def describe(self) -> str:
        """For the file's metadata: the preset and what departs from it, as the command line says
        it."""
        usual = Settings.of(self.preset, max_error=self.max_error)
        departs = [
            f"--{option} {written(getattr(self, name))}"
            for name, option in OPTIONS.items()
            if getattr(self, name) != getattr(usual, name)
            or (name == "max_error" and self.max_error)
        ]
        if not self.references:
            departs.append("--no-references")
        return " ".join([self.preset, *departs, *(["--fast"] if self.fast else [])])


OPTIONS = {
    "k": "k",
    "floor": "floor",
    "bits": "bits",
    "step": "step",
    "max_error": "max-error",
    "cutoff_hz": "cutoff",
    "cluster": "cluster",
    "tolerance": "tolerance",
    "interpolation": "interpolation",
}


def written(value: object) -> str:
    return text_of(value) or "" if isinstance(value, Tolerance) else str(value)


def amount(value: Any) -> Tolerance | None:
    """An amount as the caller gives it: None, a Tolerance, its text, or a number in the unit."""
    if value is None or isinstance(value, Tolerance):
        return value
    return Tolerance.parse(value) if isinstance(value, str) else Tolerance(float(exact(value)))


def text_of(amount: Tolerance | None) -> str | None:
    """What Tolerance.parse reads back."""
    if amount is None:
        return None
    if amount.kind == "range":
        return f"{float(Fraction(repr(amount.value)) * 100)!r}%"
    return f"{amount.value!r}{'lsb' if amount.kind == 'lsb' else ''}"


def counts_of(amount: Tolerance, calibration: Calibration, extent: int) -> Fraction:
    """An amount in counts; ``extent`` is the largest count minus the smallest, glitches left
    out."""
    value = Fraction(amount.value)
    if amount.kind == "lsb":
        return value
    if amount.kind == "range":
        return value * extent
    return value / abs(calibration.step)


def whole_counts(amount: Fraction, limit: int) -> int:
    """Rounded down, at least 1, at most ``limit``."""
    return min(max(int(amount), 1), limit)


__all__ = ["PRESETS", "Settings", "counts_of", "text_of", "whole_counts"]
