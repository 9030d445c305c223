"""The deadband's error bound: whether a reconstruction differs by less than a person can feel.

x is the input, y the reconstruction, z the count of the physical value 0. Each tick keeps

    scalar   |x - y| * kd <= max(kn * |x - z|, floor * kd)            per component
    vector   |x - y|^2 * kd^2 <= max(kn^2 * |x - z|^2, floor^2 * kd^2)   Euclidean norms

All numbers are integers, so two programs never disagree about a sample. kn / kd is the Weber
fraction. The floor (absolute threshold) is mandatory: Weber's law alone allows no error at 0 N, so
most of a file would be spent there. A force that decays to zero takes 4667 knots of 14000 samples
without a floor, and 25 with a floor of 10 mN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import isqrt
from operator import index
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import ParameterError
from .limits import FRACTION_LIMIT, ZERO_LIMIT
from .numbers import clamp
from .recording import Calibration

COUNT_LIMIT = 1 << 32
"""|count| stays below: 32 bits, and one more for a sum of two tracks that is not clamped yet."""

MARGIN = 2.0**-35
"""Two float64 estimates further apart than this, relatively, are in a certain order: a sum of n
exact squares is off by n * 2**-53 at most, on both sides, and n < 2**16 components. What lies
closer is decided in Python integers."""

_RATIO_BITS = 20
"""Ratios of vector norms are irrational; they are rounded up to a multiple of 2**-20."""


@dataclass(frozen=True)
class Deadband:
    """The error bound of one track.

    kn, kd
        Weber fraction kn / kd; 0 <= kn < 2**16 (0: only the floor counts), 1 <= kd < 2**16.
    floor
        counts >= 1, one per component; in vector mode the first one counts, and may be the only
        one.
    zero
        the count nearest to the physical value 0, one per component.
    vector
        False: each component keeps its own deadband. True: the components are one vector in one
        unit and scale, and the Euclidean norm of the difference keeps it.
    """

    kn: int
    kd: int
    floor: tuple[int, ...]
    zero: tuple[int, ...]
    vector: bool = False

    def __post_init__(self) -> None:
        # NumPy integers would overflow in the exact decisions.
        for name in ("kn", "kd"):
            object.__setattr__(self, name, index(getattr(self, name)))
        for name in ("floor", "zero"):
            object.__setattr__(self, name, tuple(index(count) for count in getattr(self, name)))
        if not (0 <= self.kn < FRACTION_LIMIT and 1 <= self.kd < FRACTION_LIMIT):
            raise ParameterError("a Weber fraction kn/kd needs 0 <= kn < 65536 and 1 <= kd < 65536")
        if not self.zero:
            raise ParameterError("a deadband has at least one component")
        if len(self.floor) != len(self.zero) and not (self.vector and len(self.floor) == 1):
            raise ParameterError("a deadband needs one floor for each component")
        if min(self.floor) < 1:
            raise ParameterError("a deadband needs an absolute floor of at least 1 count")
        if max(self.floor) >= COUNT_LIMIT:
            raise ParameterError("a deadband's floor stays below 2^32 counts")
        if not -ZERO_LIMIT <= min(self.zero) <= max(self.zero) < ZERO_LIMIT:
            raise ParameterError("the count of the physical value 0 has 32 bits")

    @classmethod
    def from_physical(
        cls,
        weber: Fraction | float | str,
        floor: Fraction | float | str,
        calibrations: Sequence[Calibration],
        *,
        vector: bool = False,
    ) -> Deadband:
        """The physical contract in counts.

        weber is rounded to the nearest kn / kd with 16-bit terms (0.1 becomes 1/10); floor, in the
        unit of the channels, down to whole counts; and where the physical 0 lies beyond 32 bits,
        the nearest count that does not takes its place, which only makes the deadband narrower.
        """
        try:
            ratio = Fraction(weber).limit_denominator(FRACTION_LIMIT - 1)
            if ratio >= 1:
                # Terms of 16 bits: above 1 it is the numerator that must fit.
                ratio = 1 / Fraction(1 / Fraction(weber)).limit_denominator(FRACTION_LIMIT - 1)
            absolute = Fraction(floor)
        except (ValueError, ArithmeticError) as error:
            raise ParameterError(f"a deadband needs finite numbers: {error}") from error
        steps = [abs(calibration.step) for calibration in calibrations]
        if vector and len(set(steps)) != 1:
            raise ParameterError("a vector deadband needs components of one scale")
        return cls(
            ratio.numerator,
            ratio.denominator,
            tuple(min(int(absolute // step), COUNT_LIMIT - 1) for step in steps),
            tuple(clamp(each.zero, -ZERO_LIMIT, ZERO_LIMIT - 1) for each in calibrations),
            vector,
        )

    @property
    def component_count(self) -> int:
        return len(self.zero)

    def columns(self, x: NDArray[Any]) -> NDArray[np.int64]:
        """[ticks] or [ticks, components] counts as int64 [ticks, components]; ParameterError where
        the shape does not fit, or a count is not an integer below 2**32 in magnitude."""
        if x.dtype.kind not in "iu" or x.ndim not in (1, 2):
            raise ParameterError(
                "a deadband compares integer counts, [ticks] or [ticks, components]"
            )
        table = x if x.ndim == 2 else x[:, np.newaxis]
        if table.shape[1] != self.component_count:
            raise ParameterError(
                f"{table.shape[1]} components do not fit a deadband of {self.component_count}"
            )
        if table.size and not -COUNT_LIMIT < int(table.min()) <= int(table.max()) < COUNT_LIMIT:
            raise ParameterError("a deadband compares counts below 2^32 in magnitude")
        return table.astype(np.int64, copy=False)

    def tolerance(self, x: NDArray[Any]) -> NDArray[np.int64]:
        """The largest ``|x - y|`` in whole counts that keeps the scalar contract; shape of x."""
        if self.vector:
            raise ParameterError("a vector deadband has no tolerance per component")
        table = self.columns(x)
        weber = np.abs(table - np.array(self.zero)) * self.kn // self.kd
        return np.asarray(np.maximum(weber, np.array(self.floor))).reshape(x.shape)

    def outside(self, x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.bool_]:
        """Where the contract is broken: the shape of x, or [ticks] in vector mode.

        x, y: integers, [ticks] or [ticks, components], the input and its reconstruction in counts.
        """
        a, b = self._pair(x, y)
        if not self.vector:
            return np.asarray(np.abs(a - b) * self.kd > self._allowed(a)).reshape(x.shape)
        error, allowed = norm_sq(a - b), self.allowed_sq(norm_sq(a - np.array(self.zero)))
        broken = error > allowed
        for i in np.flatnonzero(np.abs(error - allowed) <= allowed * MARGIN).tolist():
            broken[i] = self.norm_breaks(*self._squares(a[i].tolist(), b[i].tolist()))
        return broken

    def worst_ratio(self, x: NDArray[Any], y: NDArray[Any]) -> Fraction:
        """The largest error over all ticks in units of the deadband there; 0 without ticks.

        Above 1 exactly where :meth:`outside` is true somewhere. Scalar: exact. Vector: norms are
        irrational, so the ratio is rounded up to a multiple of 2**-20.
        """
        a, b = self._pair(x, y)
        if np.array_equal(a, b):
            return Fraction(0)
        if not self.vector:
            error, allowed = (np.abs(a - b) * self.kd).ravel(), self._allowed(a).ravel()
            near = _near_largest(error / allowed)
            pairs = set(zip(error[near].tolist(), allowed[near].tolist(), strict=True))
            return max(Fraction(*pair) for pair in pairs)
        allowed_sq = self.allowed_sq(norm_sq(a - np.array(self.zero)))
        near = _near_largest(norm_sq(a - b) / allowed_sq)
        rows = zip(a[near].tolist(), b[near].tolist(), strict=True)
        floor_sq = (self.floor[0] * self.kd) ** 2
        worst = max(
            Fraction(error_sq * self.kd**2, max(reference_sq * self.kn**2, floor_sq))
            for error_sq, reference_sq in {self._squares(p, q) for p, q in rows}
        )
        square = -((-worst.numerator << 2 * _RATIO_BITS) // worst.denominator)
        root = isqrt(square)
        return Fraction(root + (root * root < square), 1 << _RATIO_BITS)

    def norm_breaks(self, error_sq: int, reference_sq: int) -> bool:
        """The vector contract on one tick, exact: |x - y|^2 and |x - zero|^2 in counts squared."""
        floor_sq = (self.floor[0] * self.kd) ** 2
        return error_sq * self.kd**2 > max(reference_sq * self.kn**2, floor_sq)

    def allowed_sq(self, reference_sq: NDArray[np.float64]) -> NDArray[np.float64]:
        """The largest ``|x - y|^2`` that keeps the vector contract, within MARGIN / 2."""
        return np.maximum(reference_sq * (self.kn / self.kd) ** 2, float(self.floor[0]) ** 2)

    def _allowed(self, a: NDArray[np.int64]) -> NDArray[np.int64]:
        """Right side of the scalar contract; below 2**63 by ZERO_LIMIT."""
        weber = np.abs(a - np.array(self.zero)) * self.kn
        return np.asarray(np.maximum(weber, np.array(self.floor) * self.kd))

    def _pair(
        self, x: NDArray[Any], y: NDArray[Any]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        if x.shape != y.shape:
            raise ParameterError(f"a deadband compares equal shapes, not {x.shape} and {y.shape}")
        return self.columns(x), self.columns(y)

    def _squares(self, p: Sequence[int], q: Sequence[int]) -> tuple[int, int]:
        error_sq = sum((u - v) ** 2 for u, v in zip(p, q, strict=True))
        return error_sq, sum((u - zero) ** 2 for u, zero in zip(p, self.zero, strict=True))


def norm_sq(difference: NDArray[np.int64]) -> NDArray[np.float64]:
    """Squared Euclidean norms of [ticks, components], as float64 [ticks], within MARGIN / 4."""
    d = difference.astype(np.float64)
    return np.asarray(np.einsum("ij,ij->i", d, d))


def _near_largest(estimate: NDArray[np.float64]) -> NDArray[np.intp]:
    return np.flatnonzero(estimate >= estimate.max() * (1 - MARGIN))
