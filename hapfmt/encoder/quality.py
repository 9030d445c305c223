"""How good a decoded texture is, as a number that a search can aim at.

A measure gives the error of decoded samples: a number that grows with the step of a quantiser. The
search compares it with the largest error that the target allows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import inf, isfinite, log10
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..metrics import (
    TEXTURE_BLOCK,
    TEXTURE_EDGE,
    TEXTURE_HIGH_PASS_HZ,
    Similarity,
    resampling_8khz,
    snr_db,
)
from .settings import CLOSE, TEXTURE_DB, TextureQuality
from .source import InputBlock

Doubles = NDArray[np.float64]

FIRST_DB = 12.0
"""The search for an ST-SIM begins at this signal-to-noise ratio; 0.95 takes 8 to 16 dB."""

SIMILARITY_S = 30
"""ST-SIM is measured on at most this many seconds, from the middle of the longest run."""


NEAR_ENOUGH = 0.965
"""A search ends this near to the largest allowed error: 0.15 dB."""

SHARE_OF_DB = 0.75 * CLOSE
"""... or at this share of a target in dB, where that is less."""

PEAK = 4.2
"""The largest of some ten thousand errors that are distributed normally, over their deviation."""


class Measure(Protocol):
    @property
    def allowed(self) -> float:
        """The largest error that has the quality."""

    @property
    def noise(self) -> float:
        """A guess: the mean squared error that has the quality, over the power of the texture."""

    @property
    def note(self) -> str:
        """Why another measure than the one that was asked for is used; mostly empty."""

    @property
    def near(self) -> float:
        """Share of the largest allowed error from which on a search ends, where tries take long."""

    @property
    def costly(self) -> bool:
        """Whether measuring takes long."""

    def error(self, y: Doubles) -> float:
        """The error of decoded samples."""

    def error_of(self, noise: float) -> float | None:
        """The same for a mean squared error; None where it does not decide."""

    def known(self, y: Doubles) -> Measure:
        """The same, with the noise of samples that have the quality."""

    def value(self, y: Doubles) -> dict[str, float]:
        """The quality of decoded samples, for the user."""

    def close(self, reached: dict[str, float]) -> bool:
        """Whether this quality is the one that was asked for, within a share of CLOSE."""


@dataclass(frozen=True)
class NoiseMeasure:
    """The mean squared error over the power of the texture, where there is texture."""

    x: Doubles
    power: float
    textured: NDArray[np.bool_] | None
    db: float
    note: str = ""

    @property
    def allowed(self) -> float:
        return float(10 ** (-self.db / 10))

    noise = allowed
    costly = False

    @property
    def near(self) -> float:
        return float(max(NEAR_ENOUGH, self.allowed**SHARE_OF_DB))

    def error(self, y: Doubles) -> float:
        e = y - self.x
        if self.textured is not None:
            e = e[self.textured]
        # No product of vectors: BLAS wakes threads for it, which takes longer.
        mse = float(np.square(e).sum()) / max(e.size, 1)
        return mse / self.power if self.power else inf

    def error_of(self, noise: float) -> float | None:
        return noise / self.power if self.power and self.textured is None else None

    def known(self, y: Doubles) -> NoiseMeasure:  # noqa: ARG002
        return self

    def value(self, y: Doubles) -> dict[str, float]:
        error, whole = self.error(y), snr_db(self.x, y)
        found = {"snr_hf_db": -10 * log10(error)} if 0 < error < inf else {}
        return {**found, "snr_db": whole} if isfinite(whole) else found

    def close(self, reached: dict[str, float]) -> bool:
        db = reached.get("snr_hf_db")
        return db is not None and abs(db - self.db) <= CLOSE * self.db


@dataclass(frozen=True)
class ThresholdMeasure:
    """A measure that errors within the absolute threshold satisfy too."""

    of_all: NoiseMeasure
    x: Doubles
    floor: float

    near, costly = NEAR_ENOUGH, False

    @property
    def allowed(self) -> float:
        return self.of_all.allowed

    @property
    def noise(self) -> float:
        """Errors of a transform are spread like those of a normal distribution."""
        within = (self.floor / PEAK) ** 2 / self.of_all.power
        return max(self.of_all.noise, within)

    @property
    def note(self) -> str:
        return self.of_all.note

    def error(self, y: Doubles) -> float:
        largest = float(np.abs(y - self.x).max(initial=0.0))
        return min(self.of_all.error(y), self.allowed * (largest / self.floor) ** 2)

    def error_of(self, noise: float) -> float | None:  # noqa: ARG002
        return None

    def known(self, y: Doubles) -> ThresholdMeasure:  # noqa: ARG002
        return self

    def value(self, y: Doubles) -> dict[str, float]:
        return self.of_all.value(y)

    def close(self, reached: dict[str, float]) -> bool:
        return self.of_all.close(reached)


@dataclass(frozen=True)
class SimilarityMeasure:
    """What ST-SIM lacks of 1, on the longest run."""

    x: Doubles
    rows: slice
    rate: Fraction
    wanted: float
    snr: NoiseMeasure
    noise: float = 10 ** (-FIRST_DB / 10)

    note = ""
    near, costly = NEAR_ENOUGH, True

    @property
    def allowed(self) -> float:
        return 1 - self.wanted

    @cached_property
    def of_original(self) -> Similarity:
        return Similarity(self.x[self.rows], self.rate)

    def similarity(self, y: Doubles) -> float:
        return self.of_original.of(y[self.rows])

    def error(self, y: Doubles) -> float:
        return max(1 - self.similarity(y), 0.0)

    def error_of(self, noise: float) -> float | None:  # noqa: ARG002
        return None

    def known(self, y: Doubles) -> SimilarityMeasure:
        error = self.snr.error(y)
        return replace(self, noise=error) if 0 < error < 1 else self

    def value(self, y: Doubles) -> dict[str, float]:
        return {"st_sim": self.similarity(y), **self.snr.value(y)}

    def close(self, reached: dict[str, float]) -> bool:
        return abs(reached["st_sim"] - self.wanted) <= CLOSE * self.wanted


def measure_of(
    target: TextureQuality,
    x: Doubles,
    power: float,
    textured: NDArray[np.bool_] | None,
    source: InputBlock,
) -> Measure:
    """The measure of a target. Runs that are too short for ST-SIM keep the usual ratio."""
    db = TEXTURE_DB if target.snr is None else target.snr
    snr = NoiseMeasure(x, power, textured, db)
    if target.st_sim is None:
        return snr
    longest = max(source.segments(), key=lambda rows: rows.stop - rows.start)
    over = max(longest.stop - longest.start - round(SIMILARITY_S * source.rate), 0)
    rows = slice(longest.start + over // 2, longest.stop - (over - over // 2))
    if not has_similarity(rows.stop - rows.start, source.rate):
        return replace(snr, note=f"too short for ST-SIM: {db:g} dB")
    return SimilarityMeasure(x, rows, source.rate, target.st_sim, snr)


def has_similarity(size: int, rate: Fraction) -> bool:
    """Whether as many samples are long enough for ST-SIM: one block and both edges."""
    least = TEXTURE_BLOCK + 2 * TEXTURE_EDGE
    return rate > 2 * TEXTURE_HIGH_PASS_HZ and size * resampling_8khz(rate) >= least
