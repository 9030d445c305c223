"""Differences between two recordings, channel by channel and part by part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from math import ceil, hypot, inf, isfinite, log10, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..encoder.plan import quantity_of
from ..encoder.settings import FORCE_WEBER, RANGE_FLOOR, WEBER_LIMITS
from ..errors import ParameterError
from ..metrics import (
    MOVES,
    Similarity,
    band_energy_error_db,
    max_in_deadbands,
    require_package,
    rmse,
    share_outside,
    snr_hf_db,
    snr_weighted_db,
    spqi,
)
from ..reading.decoder import intersect
from ..recording import Calibration, Channel
from .parts import Described, FileParts, Parts
from .views import Builder, ChannelView, empty_view

if TYPE_CHECKING:
    from ..encoder.settings import Tolerance

SNR_SAMPLES = 1 << 22
"""The SNR of the texture uses the longest common runs, up to this number of samples of all channels
together."""

MEASURED_S = 60
"""Perceptual measures use at most this many seconds of that run: 0.3 s of work and 60 MB a channel.
"""


@dataclass
class Spread:
    """Mean and standard deviation of numbers that come in batches, each of any size.

    T. F. Chan, G. H. Golub, R. J. LeVeque, "Updating formulae and a pairwise algorithm for
    computing sample variances", COMPSTAT 1982, 10.1007/978-3-642-51461-6_3.
    """

    count: int = 0
    mean: float = 0.0
    deviation: float = 0.0
    low: float = inf
    high: float = -inf

    def add(self, x: NDArray[np.float64]) -> None:
        finite = x[np.isfinite(x)]
        if not finite.size:
            return
        self.low, self.high = (
            min(self.low, float(finite.min())),
            max(self.high, float(finite.max())),
        )
        scale = max(float(np.abs(finite).max()), np.finfo(np.float64).tiny)
        scaled = finite / scale
        mean, deviation = float(scaled.mean()) * scale, float(scaled.std()) * scale
        total = self.count + finite.size
        apart = (mean - self.mean) * sqrt(self.count) / total * sqrt(finite.size)
        self.deviation = hypot(
            self.deviation * sqrt(self.count / total), deviation * sqrt(finite.size / total), apart
        )
        self.mean += (mean - self.mean) * (finite.size / total)
        self.count = total

    @property
    def extent(self) -> float:
        return self.high - self.low if self.count else 0.0


@dataclass(frozen=True)
class Measures:
    """Perceptual measures of one channel (hapfmt.metrics), None where one is not defined.

    They use the first ``seconds`` of the longest run without a gap. ``k`` and ``floor``, in the
    unit, are the deadband that preset perceptual gives such a channel by default. It decides
    ``largest_deadbands`` and ``outside_share``. ``missing``: why ST-SIM and SPQI are not defined.
    """

    seconds: float
    k: float
    floor: float
    snr_weighted_db: float | None = None
    largest_deadbands: float | None = None
    outside_share: float | None = None
    st_sim: float | None = None
    spqi: float | None = None
    band_energy_error_db: float | None = None
    missing: str = ""

    @classmethod
    def of(
        cls,
        f: NDArray[np.float64],
        y: NDArray[np.float64],
        rate: Fraction,
        quantity: str,
        extent: float,
    ) -> Measures:
        """f, y: a run of A and of B, finite. extent: range of A."""
        hz = float(rate)
        rows = slice(0, max(ceil(MEASURED_S * rate), 1))
        f, y = f[rows], y[rows]
        limit = WEBER_LIMITS.get(quantity) or FORCE_WEBER
        k = float(min(FORCE_WEBER, limit)) if quantity in WEBER_LIMITS else 0.0
        floor = RANGE_FLOOR.value * extent
        moves = MOVES.get(quantity)
        weighted = snr_weighted_db(f, y, hz, moves) if moves else None
        in_deadbands = 0 < floor < inf
        similar, index, missing = None, None, ""
        try:
            index = spqi(f, y, rate)
            similar = index if np.array_equal(f, y) else Similarity(f, rate).of(y)
        except ParameterError as error:
            missing = str(error).replace("SPQI", "ST-SIM and SPQI").replace("needs", "need")
        return cls(
            f.size / hz,
            k,
            floor,
            finite(weighted),
            finite(max_in_deadbands(f, y, floor, k)) if in_deadbands else None,
            share_outside(f, y, floor, k) if in_deadbands else None,
            similar,
            index,
            band_energy_error_db(f, y, hz),
            missing,
        )


def finite(x: float | None) -> float | None:
    return x if x is not None and isfinite(x) else None


@dataclass
class Comparison:
    """One channel of both recordings. Samples: in both, ``only_a``, ``only_b``; ``largest`` and
    ``rms`` of the difference b - a, in the unit, ``largest_counts`` in steps of the
    sensor where one is known; ``at_s``: where the largest is; SNR: of a over the difference;
    ``snr_hf_db``: of its texture above 20 Hz (hapfmt.metrics), over the longest run.
    ``reason``: why there is nothing to compare."""

    number: int
    label: str
    unit: str
    other: str = ""
    samples: int = 0
    only_a: int = 0
    only_b: int = 0
    differing: int = 0
    largest: float = 0.0
    largest_counts: float | None = None
    at_s: float | None = None
    rms: float = 0.0
    snr_db: float | None = None
    snr_hf_db: float | None = None
    allowed: float = 0.0
    rounding: float = 0.0
    """Rounding error of the difference of two such floating-point values."""
    reason: str = ""
    notes: tuple[str, ...] = ()
    measures: Measures | None = None

    @property
    def identical(self) -> bool:
        """True if both have the same samples, bit for bit."""
        return not (self.reason or self.only_a or self.only_b or self.differing)

    @property
    def within(self) -> bool:
        """True if no sample is missing and no difference exceeds the tolerance."""
        missing = self.reason or self.only_a or self.only_b
        return not missing and (not self.differing or self.largest <= self.allowed + self.rounding)

    @property
    def verdict(self) -> str:
        if self.reason:
            return self.reason
        if self.identical:
            return "identical"
        if self.within:
            return "within tolerance"
        return "differs"

    def as_json(self) -> dict[str, Any]:
        """``metrics`` only where perceptual measures were asked for."""
        measures = self.measures
        more = {} if measures is None else {"metrics": asdict(measures)}
        return {
            "channel": self.number,
            "label": self.label,
            "other_label": self.other,
            "unit": self.unit,
            "sample_count": self.samples,
            "only_a_count": self.only_a,
            "only_b_count": self.only_b,
            "differing_count": self.differing,
            "largest": self.largest,
            "largest_counts": self.largest_counts,
            "at_s": self.at_s,
            "rms": self.rms,
            "snr_db": self.snr_db,
            "snr_hf_db": self.snr_hf_db,
            "tolerance": self.allowed,
            "identical": self.identical,
            "within": self.within,
            "verdict": self.verdict,
            "notes": list(self.notes),
            **more,
        }


class ChannelPair:
    """Compares one channel of both recordings, part by part."""

    def __init__(
        self, a: Described, b: Described, view: ChannelView | None, room: int, measured: bool
    ) -> None:
        self.a, self.b, self.room, self.measured = a, b, room, measured
        self.quantity = ""
        self.found = Comparison(a.number, a.name, a.unit, b.name)
        if a.label != b.label:
            self.found.notes += (f"compared with {b.name} of B, which has the same place",)
        if a.unit != b.unit:
            self.found.notes += (f"units {a.unit!r} and {b.unit!r}",)
        self.signal = Spread()
        self.calibrations: tuple[Calibration | None, Calibration | None] | None = None
        self.builder = None if view is None else Builder(a, view, spectra=False)
        self.runs: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        self.last = -1
        self.best: tuple[int, list[tuple[NDArray[np.float64], NDArray[np.float64]]]] = 0, []

    def add(self, a: Channel, b: Channel) -> None:
        if self.builder is not None:
            # A is the original of the view of B.
            self.builder.add_pair(b, a)
        x, y = a.samples(), b.samples()
        self.signal.add(x)
        self.quantity = quantity_of(a)
        found = self.found
        found.only_a += x.size
        found.only_b += y.size
        counts = None
        if a.calibration is not None and a.calibration == b.calibration and a.exact is b.exact:
            counts = a.stored, b.stored
        for (i, j), span in intersect(a.coverage, b.coverage):
            p, q = x[i : i + span.ticks], y[j : j + span.ticks]
            found.only_a -= span.ticks
            found.only_b -= span.ticks
            apart = None
            if counts is not None:
                apart = counts[1][j : j + span.ticks].astype(np.int64)
                apart -= counts[0][i : i + span.ticks]
            self.add_run(span.start, p, q, apart)

    def add_run(
        self,
        start: int,
        p: NDArray[np.float64],
        q: NDArray[np.float64],
        apart: NDArray[np.int64] | None,
    ) -> None:
        found = self.found
        differs = p.view(np.int64) != q.view(np.int64) if apart is None else apart != 0
        with np.errstate(all="ignore"):
            size = np.abs(q - p)
        # Equal infinities differ by 0; the distance to a NaN is infinite.
        size = np.where(differs, np.where(np.isnan(size), inf, size), 0.0)
        found.differing += int(differs.sum())
        top = int(np.argmax(size))
        if size[top] > found.largest or (differs.any() and found.at_s is None):
            found.largest = float(size[top])
            found.at_s = (start + top) / float(self.a.rate)
        if apart is not None:
            largest = int(np.abs(apart).max(initial=0))
            found.largest_counts = max(found.largest_counts or 0.0, float(largest))
        part = rmse(size, np.zeros(size.size)) if np.isfinite(size).all() else inf
        total = found.samples + size.size
        found.rms = hypot(found.rms * sqrt(found.samples / total), part * sqrt(size.size / total))
        found.samples = total
        self.keep(start, p, q)

    def keep(self, start: int, p: NDArray[np.float64], q: NDArray[np.float64]) -> None:
        """The longest run without a gap, up to a size."""
        if start != self.last:
            self.runs = []
        self.last = start + p.size
        held = sum(run[0].size for run in self.runs)
        if held < self.room:
            # Copies, else the whole part would stay in memory.
            rest = self.room - held
            self.runs = [*self.runs, (p[:rest].copy(), q[:rest].copy())]
            held = sum(run[0].size for run in self.runs)
        if held > self.best[0]:
            self.best = held, self.runs

    def finish(self, tolerance: Tolerance | None) -> Comparison:
        found = self.found
        if found.samples and 0 < found.rms < inf and self.signal.deviation > 0:
            found.snr_db = 20 * (log10(self.signal.deviation) - log10(found.rms))
        if self.best[0] and (found.differing or self.measured):
            f, y = (np.concatenate(rows) for rows in zip(*self.best[1], strict=True))
            if np.isfinite(f).all() and np.isfinite(y).all():
                found.snr_hf_db = finite(snr_hf_db(f, y, float(self.a.rate)))
                if self.measured:
                    extent = self.signal.extent
                    found.measures = Measures.of(f, y, self.a.rate, self.quantity, extent)
        step = self.a.lsb or self.b.lsb
        if found.largest_counts is None and step and found.samples:
            found.largest_counts = found.largest / step
        if tolerance is not None:
            allowed = tolerance.absolute(self.signal.extent, step)
            if allowed is None:
                found.notes += ("no step is known, so a tolerance in lsb allows nothing",)
            found.allowed = allowed or 0.0
            found.rounding = 2.0**-51 * max(abs(self.signal.low), abs(self.signal.high), 0.0)
            if not isfinite(found.rounding):
                found.rounding = 0.0
        return found


def compare(
    a: Parts,
    b: Parts,
    pairs: Sequence[tuple[int | None, int | None]],
    start: Fraction | None = None,
    stop: Fraction | None = None,
    *,
    tolerance: Tolerance | None = None,
    views: bool = False,
    measured: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[Comparison], list[ChannelView]]:
    """Each pair of places of channels, within the seconds [start, stop) (None: all that either
    has); with ``views``, those of B against A too, of the channels that can be compared.
    ``measured``: perceptual measures too, which need the extra "metrics"."""
    if measured:
        require_package()
    for parts in (a, b):
        if isinstance(parts, FileParts):
            parts.find_lost()
    extents = [a.extent(), b.extent()]
    first = min(e[0] for e in extents) if start is None else start
    last = max(e[1] for e in extents) if stop is None else stop
    if start is not None and start >= max(e[1] for e in extents):
        raise ParameterError(f"Neither recording has samples at {float(start):g} s or later")
    rows: list[Comparison | ChannelPair] = []
    at: list[tuple[int, int, ChannelPair]] = []
    drawn: list[ChannelView] = []
    for i, j in pairs:
        if i is None or j is None:
            rows.append(alone(a, i, b, j))
            continue
        mine, other = a.channels[i], b.channels[j]
        if mine.rate != other.rate:
            reason = f"rates {float(mine.rate):g} and {float(other.rate):g} Hz"
            rows.append(Comparison(mine.number, mine.name, mine.unit, other.name, reason=reason))
            continue
        view = None
        if views and first < last:
            # Drawn as B: its step, its contract.
            view = empty_view(replace(other, number=mine.number), first, last)
            drawn.append(view)
        pair = ChannelPair(mine, other, view, max(SNR_SAMPLES // len(pairs), 1 << 12), measured)
        rows.append(pair)
        at.append((i, j, pair))
    edges = a.edges(first, last) if first < last else []
    for done, (low, high) in enumerate(zip(edges, edges[1:], strict=False), 1):
        of_a, of_b = a.part(low, high), b.part(low, high)
        for i, j, pair in at:
            pair.add(of_a[i].full, of_b[j].full)
        if progress:
            progress(done, len(edges) - 1)
    return [row.finish(tolerance) if isinstance(row, ChannelPair) else row for row in rows], drawn


def alone(a: Parts, i: int | None, b: Parts, j: int | None) -> Comparison:
    only, place, name = (a, i, "A") if j is None else (b, j, "B")
    channel = only.channels[place or 0]
    return Comparison(channel.number, channel.name, channel.unit, reason=f"only in {name}")


def alike(one: str, two: str) -> bool:
    """True if two units are equal, or one is unknown."""
    return one == two or not {one, two}.isdisjoint(("", "1"))


def pair_up(a: Parts, b: Parts) -> list[tuple[int | None, int | None]]:
    """Channels of one label belong together, where labels tell them apart. Where no label matches,
    those of one place and one unit do."""
    mine, others = [c.label for c in a.channels], [c.label for c in b.channels]
    distinct = all(
        labels and all(labels) and len(set(labels)) == len(labels) for labels in (mine, others)
    )
    if distinct and set(mine) & set(others):
        pairs = [(i, others.index(label)) for i, label in enumerate(mine) if label in others]
    else:
        units = zip(a.channels, b.channels, strict=False)
        pairs = [(i, i) for i, (one, two) in enumerate(units) if alike(one.unit, two.unit)]
    partner = dict(pairs)
    paired = set(partner.values())
    return [
        *((i, partner.get(i)) for i in range(len(mine))),
        *((None, j) for j in range(len(others)) if j not in paired),
    ]
