"""Sample values to counts: finds the step and offset of a quantisation grid.

Most sensors deliver integers, scaled to float64. Each grid found is checked against
``Calibration.physical`` sample by sample. A grid called exact must match bit for bit, any other
within the tolerance that the caller gives.

A natural grid fits the values only up to small deviations. The file measures these deviations and
returns the first grid that is near enough.

Grids are searched in some hundred of the values. One pass over all samples confirms each. A sample
that is off the grid joins those that are searched.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from fractions import Fraction
from functools import cached_property
from itertools import chain
from math import inf, nextafter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import ParameterError
from ..kernels import compiled
from ..limits import EXACT_LIMIT, SINGLE_MAX
from ..reading.verifier import nearest_counts, physical_of
from ..recording import Calibration, Channel, Deviation
from ..spool import MEMORY, Memory
from .plan import without_glitches
from .rational import (
    SMALL,
    Ratio,
    Steps,
    constant,
    decimal,
    dyadic,
    fitted_all,
    near_all,
    near_steps,
    on_grid,
    place,
    shortest_fraction,
    small_denominator,
    stepped,
)
from .settings import Tolerance


class Near(NamedTuple):
    """A calibration, the counts of some values, and the most that one of them misses its count."""

    calibration: Calibration
    counts: NDArray[np.int64]
    largest_deviation: float
    how: str


def first_near(
    u: NDArray[np.float64], ratios: Iterator[Ratio | None], allowed: float, bits: int
) -> Near | None:
    """The first that keeps all of u within ``allowed``."""
    for ratio in ratios:
        placed = None if ratio is None else place(ratio, bits)
        if placed is None:
            continue
        largest = largest_deviation(u, placed.calibration.physical(placed.counts))
        if largest <= allowed:
            return Near(placed.calibration, placed.counts, largest, placed.how)
    return None


def nearest_within(
    x: NDArray[np.float64], calibration: Calibration, allowed: float
) -> tuple[NDArray[np.int32], float, int]:
    """The nearest counts of x, the most that one of them is missed by, and the first sample that is
    missed by more than ``allowed``: its place, or the size of x. The counts after it are not
    found."""
    if compiled is not None:
        counts = np.zeros(x.size, np.int32)
        missed, worst, more = compiled.nearest_within(
            calibration.a, calibration.b, calibration.d, allowed, x, counts
        )
        return counts, nextafter(worst, inf) if more else worst, missed
    found = nearest_counts(x, calibration)
    given = physical_of(found, calibration)
    size, above = deviations(x, given)
    beyond = np.flatnonzero((size > allowed) | (above & (size == allowed)))
    missed = int(beyond[0]) if beyond.size else x.size
    return found.astype(np.int32), largest_deviation(x[:missed], given[:missed]), missed


def largest_deviation(u: NDArray[np.float64], given: NDArray[np.float64]) -> float:
    """max |u - given|, rounded up to float64; both finite.

    The difference as an unevaluated sum of two float64: D. E. Knuth, The Art of Computer
    Programming 2, section 4.2.2, theorem B.
    """
    size, above = deviations(u, given)
    worst = float(size.max(initial=0.0))
    return nextafter(worst, inf) if above[size == worst].any() else worst


def deviations(
    u: NDArray[np.float64], given: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """|u - given| in float64, and where more is missing."""
    difference = u - given
    back = difference - u
    rest = (u - (difference - back)) - (given + back)
    return np.abs(difference), rest * np.sign(difference) > 0


__all__ = ["Lattice", "Tolerance", "find_lattice", "snap_to_lattice", "to_counts"]

COUNT_BITS = 32
"""Level 2. Counts use 24 bits, level 1, where an offset can bring them there."""

PLAIN_DENOMINATOR = 10**10
"""If a denominator up to this one fits, no common step is searched. Two values without a common
grid share a denominator only from about 2**36 on."""

SLICE = 1 << 16
"""Samples that are looked at together: they stay in the cache."""

SPARSE = 16
"""An exact grid with this many times the range of a natural one comes from the text format of the
values (six digits). It costs 4 bits a sample and more in a lossless codec: 17 measured on
dropbear."""

FEW, PIECES, PIECE, SPREAD = 1024, 4, 64, 256
"""Up to this many values all of them are searched. Else four pieces of 64 samples are, and 256
samples of the whole channel."""

ROUNDS = 16
"""After so many samples off the grid all values are searched."""

GRID_STEPS = 3
"""How many 1-2-5 steps to try, from the largest on. Only the rounding of float64 makes one fail. If
a quarter of the step fails too, the tolerance is below an ulp of the values."""

SHARES = (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
"""Shares of the noise, which is rounded up to a power of two. One of them gives the simplest
step."""

_ONE_DIGIT_UP = Context(prec=1, rounding=ROUND_CEILING)
FOUR_DIGITS_DOWN = Context(prec=4, rounding=ROUND_FLOOR)


@dataclass(frozen=True)
class Lattice:
    """Counts, and the calibration that gives the values back.

    counts: [sample_count], below 2**31 in magnitude. exact: every float64 comes back bit for
    bit. largest_deviation: of all samples, in the values' unit, rounded up; 0.0 where exact.
    reason: one line for the user.
    """

    calibration: Calibration
    counts: NDArray[np.signedinteger[Any]]
    exact: bool
    largest_deviation: float
    reason: str


def find_lattice(x: NDArray[np.float64], *, count_bits: int = COUNT_BITS) -> Lattice | None:
    """The grid that gives x back bit for bit, or None.

    x: float64 [sample_count], any values. Counts fit ``count_bits`` signed, 2 to 32 (ParameterError
    otherwise). -0.0, infinities and NaN are on no grid.
    """
    found = LatticeSearch(x, count_bits).bit_for_bit
    return wide(found) if isinstance(found, Lattice) else None


def snap_to_lattice(
    x: NDArray[np.float64],
    tolerance: Tolerance,
    *,
    lsb: float | None = None,
    count_bits: int = COUNT_BITS,
) -> Lattice | None:
    """A grid with every value of x within the tolerance, or None.

    In this order: the exact grid; the natural one, which has deviations from rounding or noise;
    steps of ``lsb``; the coarsest 1-2-5 grid. A natural grid replaces an exact one if it is SPARSE
    times coarser. x and count_bits: as in :func:`find_lattice`. lsb: the sensor's step in the unit
    of x, where the caller knows it. Without it a tolerance in lsb needs a natural grid.
    """
    found = _snap(LatticeSearch(x, count_bits), tolerance, lsb)
    return None if isinstance(found, str) else wide(found[0])


def wide(found: Lattice) -> Lattice:
    """With int64 counts, for those who go on computing."""
    return replace(found, counts=found.counts.astype(np.int64))


def to_counts(
    channel: Channel, tolerance: Tolerance | None = None, search: LatticeSearch | None = None
) -> tuple[Channel, str]:
    """The channel in int32 counts, exactly or within the tolerance, and one line for the user.

    Otherwise unchanged, as is a channel that holds counts already; the line then says why. Where
    values were rounded, ``deviation`` holds the declared tolerance in the channel's unit and the
    largest deviation found. ``search``: that of the channel's values, where there is one.
    """
    if channel.calibration is not None:
        return channel, "already in counts"
    values = channel.stored
    fits = values.dtype.kind == "f" and values.dtype.itemsize <= 8
    if values.dtype.kind in "iu":
        fits = not values.size or max(-int(values.min()), int(values.max())) <= EXACT_LIMIT
    if not fits:
        return channel, f"stored as {values.dtype}: float64 does not hold the values"
    search = search or LatticeSearch(values)
    deviation = channel.deviation
    if tolerance is None:
        found = search.bit_for_bit
        if isinstance(found, str):
            return channel, f"stored as {values.dtype}: {found}{search.hint()}"
        found = replace(found, reason=found.reason + search.hint())
    else:
        snapped = _snap(search, tolerance, channel.lsb, channel.unit)
        if isinstance(snapped, str):
            return channel, f"stored as {values.dtype}: {snapped}"
        found, declared = snapped
        if not found.exact:
            deviation = Deviation(declared, found.largest_deviation)
    counts, calibration = found.counts, found.calibration
    changed = replace(channel, stored=counts, calibration=calibration, deviation=deviation)
    return changed, found.reason


class Facts(NamedTuple):
    """What one pass tells of doubles: whether all are finite, whether one is -0.0, the smallest and
    the largest, and the size of that which is nearest to 0 without being 0."""

    finite: bool
    negative_zero: bool
    low: float
    high: float
    nearest: float

    @classmethod
    def of(cls, x: NDArray[np.float64]) -> Facts:
        if compiled is not None:
            return cls(*compiled.double_facts(x))
        away = np.abs(x[x != 0])
        return cls(
            bool(np.isfinite(x).all()),
            bool((np.signbit(x) & (x == 0)).any()),
            float(np.fmin.reduce(x, initial=inf)),
            float(np.fmax.reduce(x, initial=-inf)),
            float(np.fmin.reduce(away, initial=inf)),
        )


class LatticeSearch:
    """The grids of some values. Each search runs once; its result is kept.

    ``given``: [sample_count], any numbers. Counts have at most ``bits`` bits. The exact grid, with
    its counts in ``store``, the natural step and the few values that are searched are kept.
    ``values`` are kept until ``forget``.
    """

    def __init__(
        self, values: NDArray[np.generic], bits: int = COUNT_BITS, store: Memory = MEMORY
    ) -> None:
        if not 2 <= bits <= COUNT_BITS:
            raise ParameterError(f"counts have 2 to {COUNT_BITS} bits, not {bits}")
        self.given = values
        self.bits = bits
        self.store = store
        self._steps: dict[bool, Steps | None] = {}

    @cached_property
    def values(self) -> NDArray[np.float64]:
        return np.ascontiguousarray(self.given, dtype=np.float64)

    @cached_property
    def facts(self) -> Facts:
        return Facts.of(self.values)

    @cached_property
    def refusal(self) -> str:
        """Why the values are on no grid, not even nearly; or empty."""
        if not self.facts.finite:
            return "infinities or NaN among the values"
        if self.values.size and max(-self.facts.low, self.facts.high) > EXACT_LIMIT:
            return "a value beyond 2^53; a larger unit would help"
        return ""

    @cached_property
    def few(self) -> NDArray[np.float64]:
        """Some distinct values, or all: sorted, 0.0 in the place of -0.0. The smallest and the
        largest are among them."""
        x = self.values
        if x.size <= FEW:
            return np.unique(x + 0.0)
        # Neighbours for short differences, and what the whole channel has.
        starts = (x.size - PIECE) * np.arange(PIECES) // (PIECES - 1)
        near, far = x[starts[:, None] + np.arange(PIECE)].ravel(), x[:: x.size // SPREAD]
        return np.unique(np.concatenate((near, far, (self.facts.low, self.facts.high))) + 0.0)

    def look_at(self, more: NDArray[np.float64]) -> None:
        """Search in these values too."""
        self.few = np.unique(np.concatenate((self.few, more + 0.0)))
        self._steps.clear()

    def confirmed(
        self, find: Callable[[NDArray[np.float64]], Near | None], allowed: float
    ) -> tuple[Near, NDArray[np.int32]] | None:
        """The grid that ``find`` has for few values and that keeps all within ``allowed``, with all
        counts; the deviation is that of all values."""
        x = self.values
        for rounds in range(ROUNDS + 1):
            if rounds == ROUNDS:
                self.look_at(x)
            near = find(self.few)
            if near is None:
                return None
            counts, largest, missed = nearest_within(x, near.calibration, allowed)
            if missed == x.size:
                return near._replace(largest_deviation=largest), counts
            self.look_at(x[missed : missed + PIECE])
        return None

    def forget(self) -> None:
        """Give back the memory of what is quickly made again."""
        self.__dict__.pop("values", None)

    @property
    def has_negative_zero(self) -> bool:
        return self.facts.negative_zero

    @property
    def bit_for_bit(self) -> Lattice | str:
        """The grid that gives all values back, or why there is none."""
        if self.has_negative_zero and not self.refusal:
            return "negative zero, which no count represents; a tolerance would turn it into 0"
        return self.exact

    @cached_property
    def exact(self) -> Lattice | str:
        """The exact grid with the smallest denominator, or why there is none; 0.0 for -0.0."""
        if self.refusal:
            return self.refusal
        if self.values.size == 0:
            return Lattice(Calibration(), np.zeros(0, np.int32), True, 0.0, "exact: no samples")
        if self.facts.nearest < 1 / EXACT_LIMIT:
            return "a value nearer to 0 than 2^-53"
        found = self.confirmed(self.exact_among, 0.0)
        if found is None:
            return "no common step"
        near, counts = found
        return lattice_of(near, self.store.kept(counts), f"exact: {near.how}", exact=True)

    def exact_among(self, u: NDArray[np.float64]) -> Near | None:
        """The same for sorted distinct values."""
        best = place(constant(u), self.bits) if u.size == 1 else None
        least = float(u[-1] - u[0]) / (1 << self.bits)
        for enough, search in (
            (0, dyadic),
            (SMALL, small_denominator),
            (SMALL, decimal),
            (PLAIN_DENOMINATOR, lambda u: stepped(u, least)),
        ):
            if u.size == 1 or (best and best.calibration.d <= enough):
                break
            ratio = search(u)
            placed = None if ratio is None else place(ratio, self.bits)
            if placed and (best is None or placed.calibration.d < best.calibration.d):
                best = placed
        return None if best is None else Near(best.calibration, best.counts, 0.0, best.how)

    def steps(self, exact: Lattice | None) -> Steps | None:
        """The natural step: any step where no grid is exact, else one SPARSE times coarser.

        With an exact grid each value needs a count of its own on the natural grid. A text format
        rounds equal counts to equal digits, so values that share a count come from the signal.
        """
        known = exact is None
        if known in self._steps:
            return self._steps[known]
        u = self.few
        least = float(u[-1] - u[0]) / (1 << self.bits)
        found: Steps | None = None
        if exact is None:
            found = near_steps(u, least)
        elif sparse(exact.counts):
            found = near_steps(u, max(least, SPARSE * float(exact.calibration.step)))
            found = found if found and np.diff(found.indices).all() else None
        self._steps[known] = found
        return found

    def hint(self) -> str:
        """The gain from a tolerance, where the values deviate from a natural grid; or empty."""
        if self.values.size == 0 or self.refusal:
            return ""
        exact = self.exact
        steps = self.steps(exact if isinstance(exact, Lattice) else None)
        u = self.few
        found = first_near(u, _natural(u, steps, inf), inf, COUNT_BITS) if steps else None
        if not found:
            return ""
        step = float(found.calibration.step)
        _, largest, _ = nearest_within(self.values, found.calibration, inf)
        if not largest:
            return ""
        enough = float(_ONE_DIGIT_UP.create_decimal(largest))
        return (
            f"; the values lie close to steps of {step:.6g}: a tolerance of {enough:g} "
            f"({enough / step:.1g} steps) would store them as counts of that step"
        )

    def natural_lattices(self, exact: Lattice | None) -> Iterator[Near]:
        """Grids with small deviations from the few values, the simplest first; none where there are
        none. exact: the grid without deviations, which a natural grid must be SPARSE times coarser
        than."""
        if not self.values.size or self.refusal:
            return
        u, steps = self.few, self.steps(exact)
        if steps is None:
            return
        noises = [steps.noise * share for share in SHARES]
        for ratio in chain(near_all(u, steps, noises), fitted_all(u, steps, noises)):
            found = first_near(u, iter([ratio]), inf, COUNT_BITS)
            if found:
                yield found


def on_uniform_grid(
    channel: Channel, error: float, search: LatticeSearch | None = None
) -> tuple[Channel, str] | None:
    """The channel in counts of the widest grid that has a value within ``error`` of each sample;
    None where no calibration holds it. The grid is the quantiser: counts cost what they are."""
    search = search or LatticeSearch(channel.stored)
    x = search.values
    if not x.size or search.refusal:
        return None
    low, high = search.facts.low, search.facts.high
    room = error - float(np.spacing(max(-low, high)))
    if room <= 0:
        return None
    step = Fraction(FOUR_DIGITS_DOWN.create_decimal_from_float(2 * room))
    found = search.confirmed(
        lambda u: first_near(u, iter([on_grid(u, step, "a uniform grid")]), error, COUNT_BITS),
        error,
    )
    if found is None:
        return None
    near, counts = found
    largest = near.largest_deviation
    lattice = lattice_of(near, counts, f"rounded by {largest:.3g} at most to {near.how}")
    deviation = Deviation(error, largest)
    changed = replace(channel, stored=counts, calibration=near.calibration, deviation=deviation)
    return changed, lattice.reason


def sparse(counts: NDArray[Any]) -> bool:
    """Whether counts [samples] are spread so thinly that a coarser grid may hold them."""
    if not counts.size:
        return False
    # In Python: the range of 32-bit counts takes 33.
    low = int(counts.min())
    extent = int(counts.max()) - low
    if extent < SPARSE or extent >= SPARSE * counts.size:
        return extent >= SPARSE
    seen = np.zeros(extent + 1, np.bool_)
    for at in range(0, counts.size, SLICE):
        seen[np.subtract(counts[at : at + SLICE], low, dtype=np.int64)] = True
    return extent >= SPARSE * int(np.count_nonzero(seen))


def _snap(
    search: LatticeSearch, tolerance: Tolerance, lsb: float | None, unit: str = ""
) -> tuple[Lattice, float] | str:
    """The grid within the tolerance and the tolerance in the unit of x, or why there is none."""
    if search.refusal:
        return search.refusal
    x, bits, exact = search.values, search.bits, search.exact
    if x.size == 0:
        assert isinstance(exact, Lattice)
        return exact, tolerance.value
    known = exact if isinstance(exact, Lattice) else None
    steps = search.steps(known)
    if lsb is not None and not 0 < lsb <= EXACT_LIMIT:
        lsb = None  # nothing that a channel with finite counts has
    step = lsb
    if step is None and steps:
        step = steps.low
    elif step is None and isinstance(exact, Lattice):
        step = float(exact.calibration.step)
    calm = without_glitches(x)
    allowed = tolerance.absolute(float(calm.max() - calm.min()), step, unit)
    if allowed is None:
        return "no step was found to measure the tolerance with; declare it in the channel's unit"
    if allowed == inf:
        return "the tolerance is beyond float64 in the channel's unit"
    allowed = min(allowed, SINGLE_MAX)
    if steps:
        found = _within(search, lambda u: _natural(u, search.steps(known), allowed), allowed)
        if found:
            return found, allowed
    if isinstance(exact, Lattice):
        if search.has_negative_zero:
            exact = replace(exact, exact=False, reason=f"-0.0 became 0; otherwise {exact.reason}")
        return exact, allowed
    found = _within(search, lambda u: _grids(u, allowed, lsb), allowed)
    if found:
        return found, allowed
    return f"no grid with {bits}-bit counts keeps every value within {allowed:.3g}"


def _natural(u: NDArray[np.float64], steps: Steps | None, allowed: float) -> Iterator[Ratio | None]:
    if steps is None:
        return
    # The simplest first: the noise was found with any offset, and a plain one may need a little
    # more. Then as near as the tolerance asks for.
    noises = 2 * steps.noise, steps.noise, min(allowed, steps.noise / 2)
    yield from near_all(u, steps, noises)
    yield from fitted_all(u, steps, noises)


def _grids(u: NDArray[np.float64], allowed: float, lsb: float | None) -> Iterator[Ratio | None]:
    if lsb is not None:
        yield on_grid(u, shortest_fraction(lsb), "steps of the given lsb")
    for step in _one_two_five(2 * Fraction(min(allowed, EXACT_LIMIT))):
        yield on_grid(u, step, "a grid of round steps")


def _one_two_five(largest: Fraction) -> Iterator[Fraction]:
    """The GRID_STEPS largest of 1, 2, 5, 10, 20 ... and their tenths that are not above."""
    power = Fraction(10) ** 15  # the last one below 2**53
    left = GRID_STEPS
    while left and power * EXACT_LIMIT >= 1:
        for digit in (5, 2, 1):
            if left and digit * power <= largest:
                yield digit * power
                left -= 1
        power /= 10


def _within(
    search: LatticeSearch,
    ratios: Callable[[NDArray[np.float64]], Iterator[Ratio | None]],
    allowed: float,
) -> Lattice | None:
    """The first that keeps all values within ``allowed``."""
    found = search.confirmed(lambda u: first_near(u, ratios(u), allowed, search.bits), allowed)
    if found is None:
        return None
    near, counts = found
    reason = f"each value is rounded by at most {near.largest_deviation:.3g}, to {near.how}"
    return lattice_of(near, counts, reason)


def lattice_of(
    near: Near, counts: NDArray[np.int32], reason: str, *, exact: bool = False
) -> Lattice:
    """The grid with all counts [samples], and what is said of it."""
    calibration = near.calibration
    bits = max(-int(counts.min()), int(counts.max())).bit_length() + 1
    step = f"step {float(calibration.step):.10g} = {calibration.a}/{calibration.d}"
    text = f"{reason}, {step}, {bits}-bit counts"
    return Lattice(calibration, counts, exact, near.largest_deviation, text)
