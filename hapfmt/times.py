"""Time stamps, as decimal texts -> a regular grid of ticks: rate, start, and the tick of each row.

Stamps are usually rounded: 3 kHz written in us is 0, 333, 667, 1000. So the rate is the simplest
fraction under which every stamp lies within its rounding. A clock that jitters may have no such
fraction. Then the nearest grid is taken, if every stamp lies within half a tick of it.

Stamps of messages jitter more: they come late, in bursts, by a clock that drifts, and some are
lost. :func:`settle` counts the ticks of such rows.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from decimal import Context, Decimal
from fractions import Fraction
from functools import cached_property
from math import ceil, floor, ulp
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from .errors import ParameterError
from .limits import TICK_LIMIT
from .numbers import checked_rate
from .units import split_name

_EXACT = Context(prec=160)
"""Holds the sum of any two stamps without rounding."""
_FINEST, _LARGEST = -60, 40
"""Powers of ten, s: the decimals of a stamp and its size, far beyond any clock."""
_SCATTERED = 0.3
"""Variance of the rows in a time, by their mean: 1 of random rows, 0 of regular ones."""
_AT_ONCE = 0.1
"""Share of the mean step below which rows came in one burst."""
_FEW_GAPS = 3
"""Up to this many missing rows are accepted, although rounding could explain them as well. More of
them, evenly spread, are due to rounding: 875 Hz in whole ms looks like 1 kHz with every eighth row
missing."""
_FINE = 0.1
"""Share of a tick below which the resolution of the stamps cannot feign a missing row."""
_CLOCK = 100_000_000
"""Seconds, three years: times from here on count from 1970, not from the recording's zero."""
_CLOCK_END = 10_000_000_000
"""Seconds since 1970, the year 2286: later times count in another unit, or from another day."""
_JITTER_TICKS = 2
"""Times that lie no further from rows one tick apart only jitter."""
_MOVED_TICKS, _MOVED_SHARE = 32, 0.01
"""Rows that came in bursts, or by a clock a little too fast, move less, in ticks or by their share
of all rows; more is another rate."""
_JITTERS = 0.25
"""Ticks: up to here the nearest tick of a row is not in doubt."""
_NOMINAL = Fraction(200, 1_000_000)
"""Share by which a device's clock may differ from its nominal rate."""
_GIVEN = 500e-6
"""The same for a rate that the caller gives."""
_UNSETTLED = 0.3
"""Ticks: where the median row lies further from its tick, the rows have no common rate."""
_DISAGREEING = 1e-3
"""Share by which the period of all rows may differ from that of short pieces. More shows that rows
were lost in such numbers that their ticks were not counted rightly."""
_UNCOUNTED = 0.2
"""Ticks: the same for rows that may come late, from the least delay of the rows that follow."""
_BURST_ROWS, _NUMBERED_BURST_ROWS = 24, 512
"""Rows that may come together, twice those of a usual burst; and where their numbers are known."""
_WANDERING = 0.25
"""Ticks by which a clock may leave a straight line before its course is followed."""
_PIECE_ROWS, _PIECES = 2048, 7
"""Rows of a piece, and as many pieces from which the first period is taken."""
_SURE = 15
"""The power of a period in units of that of random rows, beyond its mean: they reach it in one of
30 recordings, and less often where there are less pieces."""
_FINE_BINS, _PADDING = 8, 4
"""Bins of a period, and how much finer than the resolution of a piece its periodogram is."""
_FIRST_ROWS = 256
"""Rows from which the period is measured first, and over which a clock is followed."""
_SOURCES = 4
"""More sources of rows are not recognised."""
_SETTLED_ROWS = 64
"""Fewer rows are not enough to count ticks by :func:`settle`."""
_PIECE = 1 << 16
"""Rows whose medians are taken at once, so that memory stays bounded."""
STEADY = 1e-6
"""Share of a tick that is not worth a note: sums of a rounded period drift as much."""


class CountedRows(NamedTuple):
    """Row i is at ``ticks[i]`` (whole float64, increasing from 0), at about ``offset_s + ticks[i] *
    period_s`` seconds after the first time.

    ``rate`` is the round one: 1 / period_s, or what a device may name whose clock runs like that.
    ``tolerance_s``: how exactly the position is known; None where the rate was given.
    """

    ticks: NDArray[np.float64]
    rate: Fraction
    offset_s: float
    period_s: float
    tolerance_s: float | None
    is_exact: bool
    notes: tuple[str, ...]


class TickGrid(NamedTuple):
    """Row i is at tick ``ticks[i]`` (int64, increasing); time = tick / rate seconds.

    ``epoch_ns``: UTC of tick 0 where the times count from 1970, else None.
    """

    rate: Fraction
    ticks: NDArray[np.int64]
    notes: tuple[str, ...]
    epoch_ns: int | None = None


TIME_UNITS = {"s": 0, "sec": 0, "ms": -3, "us": -6, "\u00b5s": -6, "\u03bcs": -6, "ns": -9}
"""Powers of ten, s."""
_TIME_UNIT = "|".join(TIME_UNITS)
_TIME = re.compile(
    r"(?:t|(?i:times?|time ?stamps?|date ?time))"
    rf"(?: ?\[({_TIME_UNIT})\]| ?\(({_TIME_UNIT})\)|[ _]({_TIME_UNIT}))?"
)


class TimeName(NamedTuple):
    """The name of a column of times. ``exponent``: power of ten of its unit, s."""

    unit: str | None
    exponent: int


def time_name(name: str) -> TimeName | None:
    """What a name such as "t [ms]" says of a column; None where it does not name times."""
    match = _TIME.fullmatch(name)
    if match is None:
        return None
    unit = match[match.lastindex] if match.lastindex else None
    return TimeName(unit, TIME_UNITS[unit or "s"])


def may_be_times(name: str) -> bool:
    """Whether a first column of this name may hold the times of the rows."""
    return time_name(name) is not None or split_name(name)[1] in TIME_UNITS


class TimeStamps:
    """The stamps of the rows, one after the other; ``unit_exponent`` -3 for milliseconds.

    ``keep``: keep them all in ``ns`` too, [rows], rounded to whole nanoseconds.
    """

    def __init__(self, unit_exponent: int = 0, *, keep: bool = False) -> None:
        self._unit_exponent = unit_exponent
        self.ns = array("q") if keep else None
        self._first = self._last = Decimal(0)
        self._relative = array("d")
        # Kept in addition to the times, since a double of 50 000 000.001 s is 7 ns coarse.
        self._steps = array("d")
        self._finest = _LARGEST
        self._from_floats = True

    @classmethod
    def of_ns(cls, stamps: NDArray[np.int64]) -> TimeStamps:
        """Integer nanoseconds, at least one, in any order. Zeros at their ends tell the
        resolution of the clock."""
        relative = stamps - stamps[0]
        zeros = next(digits for digits in (6, 3, 0) if not (relative % 10**digits).any())
        made = cls(-9)
        made._first, made._last = Decimal(int(stamps[0])), Decimal(int(stamps[-1]))
        made._relative = array("d", (relative / 1e9).tobytes())
        made._steps = array("d", (np.diff(stamps) / 1e9).tobytes())
        made._finest = zeros
        made._from_floats = False
        return made

    def __len__(self) -> int:
        return len(self._relative)

    def add(self, text: str) -> None:
        """Take the next stamp, a decimal number; ValueError, with the reason, if it is unusable."""
        try:
            stamp = Decimal(text)
        except ArithmeticError:
            stamp = Decimal("nan")
        exponent = stamp.as_tuple().exponent
        if not isinstance(exponent, int) or exponent < _FINEST or stamp.adjusted() > _LARGEST:
            raise ValueError("is not a usable time")
        if not self._relative:
            self._first = stamp
        elif stamp <= self._last:
            raise ValueError("is not later than the time before it")
        if self.ns is not None:
            self.ns.append(whole_ns(stamp, self._unit_exponent))
        if self._relative:
            self._steps.append(float(self._seconds(self._last, stamp)))
        self._relative.append(float(self._seconds(self._first, stamp)))
        self._last = stamp
        self._finest = min(self._finest, exponent)

    def _seconds(self, start: Decimal, stop: Decimal) -> Decimal:
        return _EXACT.scaleb(_EXACT.subtract(stop, start), self._unit_exponent)

    @property
    def first(self) -> Fraction:
        """Seconds."""
        return Fraction(self._seconds(Decimal(0), self._first))

    @property
    def resolution(self) -> float:
        """Seconds: the last decimal place of the finest stamp."""
        return float(Decimal(1).scaleb(self._finest + self._unit_exponent))

    @property
    def noise(self) -> float:
        """Seconds: error that float64 arithmetic may add, here and in stamps printed from it.

        The shortest text that identifies a float64 may be coarser than the float64 itself.
        """
        if not self._from_floats:
            return 4 * ulp(float(self.span)) + 0.5e-9  # rounded to whole ns
        largest = ulp(float(max(abs(self.first), abs(self.first + self.span))))
        return 4 * ulp(float(self.span)) + (largest if self.resolution < 10 * largest else 0)

    @property
    def span(self) -> Fraction:
        """Seconds from the first stamp to the last."""
        return Fraction(self._seconds(self._first, self._last))

    def grid(self, rate: Fraction | None = None) -> TickGrid:
        """The grid of a given rate, or of the rate that the stamps tell (two rows at least).

        Raises ParameterError, with the worst deviation, where the stamps are not regular.
        """
        found = self.find(rate)
        return self._started(found)

    def find(
        self,
        rate: Fraction | None = None,
        *,
        numbers: NDArray[np.float64] | None = None,
        nominal: bool = False,
    ) -> CountedRows:
        """The ticks of the rows.

        ``numbers`` increase and count the rows with those that were lost before they were stamped.
        ``nominal``: round the rate of times that jitter within 200 ppm, where observations of the
        clock keep the measured one.
        """
        times = np.frombuffer(self._relative) if self._relative else np.empty(0)
        if rate is not None:
            return self._on_given(times, rate, numbers)
        if len(self) < 2:
            raise ParameterError("fewer than two times give no rate; give one (rate=)")
        if self.span <= 0:
            raise ParameterError("the last time is not after the first; give a rate (rate=)")
        exact, rounded = self.noise, self.noise + self.resolution / 2
        lines = _hypotheses(times, np.frombuffer(self._steps), numbers)
        whole = next(lines)
        # Regular times need no other lines, which take memory.
        if (simple := whole.rate_within(self.span, exact)) is not None:
            return self._on_line(whole, checked_rate(simple), exact, is_exact=True)
        gappy = list(lines)
        likely = [line for line in gappy if self._is_likely(line)]
        full = [line for line in gappy if line.is_mostly_full]
        for line, tolerance in (
            *((line, exact) for line in likely),
            (whole, rounded),
            *((line, rounded) for line in likely),
            *((line, exact) for line in full),
            *((line, rounded) for line in full),
        ):
            round_rate = line.rate_within(self.span, tolerance)
            if round_rate is not None:
                return self._on_line(line, checked_rate(round_rate), tolerance, is_exact=True)
        return self._nearest([whole, *full], numbers, nominal)

    def _is_likely(self, line: _Line) -> bool:
        """Whether rows are missing indeed, rather than seem so because stamps are rounded."""
        return self.resolution <= _FINE * line.period or line.missing <= _FEW_GAPS

    def _nearest(
        self, lines: list[_Line], numbers: NDArray[np.float64] | None, nominal: bool
    ) -> CountedRows:
        """The grid of stamps that jitter."""
        line = min(lines, key=lambda line: line.spread)
        if line.spread > line.period / 2:
            counted = settle(lines[0].times, numbers)
            if counted is not None and (
                counted.is_regular or (numbers is not None and counted.is_numbered)
            ):
                rate = _roundest_near(1 / Fraction(counted.period_s))
                return self._on_counted(counted, checked_rate(rate))
            if counted is not None and counted.sources > 1:
                raise _several(counted.sources)
            raise ParameterError(
                f"the times are not regular: they deviate by up to {line.spread:.3g} s from a "
                f"grid of {1 / line.period:.6g} Hz; {self._advice()}"
            )
        if nominal and numbers is None and self.resolution <= _FINE * line.period:
            sources = count_sources(lines[0].times, line.period)
            if sources > 1:
                raise _several(sources)
        # Two standard errors of the slope, were the deviations independent and uniform.
        slack = Fraction(4 * line.spread / len(self) ** 0.5)
        span = Fraction(line.period) * line.last
        if nominal:
            slack = max(slack, span * _NOMINAL)
        rate = checked_rate(_roundest(span, slack, line.last))
        deviation = max(line.spread, _half_range(line.residual(rate)))
        return self._on_line(line, rate, deviation, is_exact=False)

    def _on_line(
        self, line: _Line, rate: Fraction, tolerance: float, *, is_exact: bool
    ) -> CountedRows:
        period = float(1 / rate) if is_exact else line.period
        residual = line.residual(rate) if is_exact else line.times - line.ticks * period
        offset = float(residual.max() + residual.min()) / 2
        notes: tuple[str, ...] = ()
        if not is_exact and tolerance > STEADY * line.period:
            notes = (self._deviation_note(tolerance, rate),)
        return CountedRows(line.ticks, rate, offset, period, tolerance, is_exact, notes)

    def _on_given(
        self, times: NDArray[np.float64], rate: Fraction, numbers: NDArray[np.float64] | None
    ) -> CountedRows:
        """Every row at the tick nearest to its time, later where rows before it need the room.

        Times that only jitter leave no tick out. ParameterError where rows come much faster than
        the rate.
        """
        wanted = times * float(rate)
        ticks, notes = np.rint(wanted), list[str]()
        if float(np.abs(wanted - ticks).max(initial=0)) > _JITTERS or (np.diff(ticks) < 1).any():
            counted = settle(times, numbers)
            if counted is not None and counted.fits(rate):
                return self._on_counted(counted, rate)
        if (np.diff(ticks) < 1).any():
            order = np.arange(len(times), dtype=np.float64)
            ticks = order + np.maximum.accumulate(ticks - order)
            moved = float(np.abs(ticks - wanted).max())
            unfit = (
                f"the times do not fit a rate of {float(rate):.6g} Hz: rows would move by up to "
                f"{in_words(moved / float(rate))}"
            )
            if moved > _JITTER_TICKS and is_scattered(times, numbers):
                raise ParameterError(f"{unfit}, to free ticks; {self._advice()}")
            if moved > max(_MOVED_TICKS, _MOVED_SHARE * len(times)):
                raise ParameterError(
                    f"{unfit}; they come at about {self._usual_rate:.6g} Hz. Give that rate, or "
                    "remove the column of times"
                )
            if float(np.abs(order - wanted).max()) <= _JITTER_TICKS:
                ticks = order
            notes.append("some times are less than a tick apart; their rows moved to free ticks")
        elif 2 * np.count_nonzero(np.diff(ticks) == 1) < len(times) - 1:
            notes.append(
                f"the rows come at about {self._usual_rate:.6g} Hz, so most ticks of "
                f"{float(rate):.6g} Hz are gaps"
            )
        if ticks.max(initial=0) >= TICK_LIMIT:
            raise ParameterError(f"the times are longer than 2^48 ticks of {float(rate):.6g} Hz")
        residual = _Line(ticks, times).residual(rate)
        largest = float(np.abs(residual).max(initial=0))
        if largest > max(self.noise + self.resolution / 2, STEADY / float(rate)):
            notes.append(self._deviation_note(largest, rate))
        return CountedRows(ticks, rate, 0.0, float(1 / rate), None, False, tuple(notes))

    def _on_counted(self, counted: Settled, rate: Fraction) -> CountedRows:
        """Rows at the ticks that were counted, from the first row on."""
        line = _Line(counted.ticks, np.frombuffer(self._relative))
        largest = float(np.abs(line.residual(rate)).max())
        notes = (self._deviation_note(largest, rate),)
        offset, period = counted.offset_s, counted.period_s
        return CountedRows(counted.ticks, rate, offset, period, None, False, notes)

    def _deviation_note(self, largest: float, rate: Fraction) -> str:
        return deviation_note(largest, rate, kept=self.ns is not None)

    def _advice(self) -> str:
        """The least round rate at which rows move by two ticks at most."""
        times = np.frombuffer(self._relative)
        order = np.arange(len(times), dtype=np.float64)
        for rate in (digit * 10.0**power for power in range(-3, 10) for digit in (1, 2, 5)):
            ticks = order + np.maximum.accumulate(np.rint(times * rate) - order)
            moved = float(np.abs(ticks - times * rate).max())
            if moved <= _JITTER_TICKS:
                return (
                    f"give a high rate (rate=): at {rate:.6g} Hz, no row moves by more than "
                    f"{in_words((moved + 0.5) / rate)}"
                )
        return "give a rate (rate=) to move each row to a free tick"

    @property
    def _usual_rate(self) -> float:
        return 1 / max(float(np.median(np.frombuffer(self._steps))), 1e-9)

    def _started(self, found: CountedRows) -> TickGrid:
        ticks, rate, notes = found.ticks.astype(np.int64), found.rate, found.notes
        last = int(ticks[-1]) if ticks.size else 0
        offset = self.first + Fraction(found.offset_s)
        start = round(offset * rate)
        if start < 0 <= self.first:
            start = 0
        if 0 <= start < _CLOCK * rate and start < TICK_LIMIT - last:
            shift = abs(float(offset - start / rate))
            rounding = found.tolerance_s or self.noise + self.resolution / 2
            told = found.tolerance_s is None and bool(notes)
            if not told and shift > max(2 * rounding, STEADY / float(rate)):
                notes += (
                    f"the times begin between two ticks of {float(rate):.6g} Hz, so all rows "
                    f"moved by {in_words(shift)}",
                )
            return TickGrid(rate, ticks + start, notes)
        if _CLOCK <= offset < _CLOCK_END:
            # Stamps of an exact rate are rounded to themselves: the first one is a tick.
            zero = self.first if found.is_exact else offset
            epoch_ns = round(zero * 10**9)
            what = "the first time" if zero == self.first else "the time of the first tick"
            notes += (f"{what}, {utc(epoch_ns)}, became the epoch of the recording",)
            return TickGrid(rate, ticks, notes, epoch_ns)
        notes += (f"the times begin at {float(self.first)} s, which became tick 0",)
        return TickGrid(rate, ticks, notes)


_ISO = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d)(?::(\d\d)(?:[.,](\d{1,18}))?)?"
    r" ?(Z|[+-]\d\d(?::?\d\d)?)?",
    re.A,
)


def seconds_of_date(text: str) -> str | None:
    """Decimal seconds since 1970 of an ISO 8601 time such as 2026-11-22T17:05:00.25Z; None for any
    other text. A time without its zone is UTC."""
    match = _ISO.fullmatch(text)
    if match is None:
        return None
    year, month, day, hour, minute = (int(group) for group in match.groups()[:5])
    try:
        date = datetime(year, month, day, hour, minute, int(match[6] or 0), tzinfo=UTC)
    except ValueError:
        return None
    seconds = (date - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1)
    zone = match[8] or "Z"
    if zone != "Z":
        digits = zone[1:].replace(":", "").ljust(4, "0")
        offset = 3600 * int(digits[:2]) + 60 * int(digits[2:])
        seconds -= offset if zone[0] == "+" else -offset
    if seconds < 0:
        return None
    return f"{seconds}.{match[7] or '0'}"


def utc(epoch_ns: int) -> str:
    """A time in nanoseconds since 1970, in words."""
    seconds, ns = divmod(epoch_ns, 10**9)
    date = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    part = f".{ns:09d}".rstrip("0") if ns else ""
    return f"{date:%Y-%m-%dT%H:%M:%S}{part}Z"


class _Line:
    """The hypothesis that row i is ``ticks[i]`` ticks (whole float64) after the first row."""

    def __init__(self, ticks: NDArray[np.float64], times: NDArray[np.float64]) -> None:
        self.ticks = ticks
        self.times = times
        self.last = int(ticks[-1]) if len(ticks) else 0

    @property
    def missing(self) -> int:
        return self.last + 1 - len(self.ticks)

    @property
    def is_mostly_full(self) -> bool:
        """Any times at all lie on a grid that is fine enough, with most of its rows missing."""
        return bool(2 * np.count_nonzero(np.diff(self.ticks) == 1) >= len(self.ticks) - 1)

    @cached_property
    def period(self) -> float:
        """Seconds per tick, by least squares."""
        return _slope(self.ticks, self.times)

    @cached_property
    def spread(self) -> float:
        """Seconds: largest deviation from the grid of that period, in its best position."""
        return _half_range(self.times - self.ticks * self.period)

    def residual(self, rate: Fraction) -> NDArray[np.float64]:
        return self.times - _at(self.ticks, rate)

    @cached_property
    def narrowest(self) -> float:
        """The period of the smallest possible spread: its extremes then pull both ways."""
        steps = np.diff(self.times) / np.diff(self.ticks)
        low, high = float(steps.min()), float(steps.max())
        while low < (middle := (low + high) / 2) < high:
            residual = self.times - self.ticks * middle
            if residual.argmax() > residual.argmin():
                low = middle
            else:
                high = middle
        return low

    def rate_within(self, span: Fraction, tolerance: float) -> Fraction | None:
        """The simplest rate found that leaves each stamp within ``tolerance`` s of its tick."""
        # The residuals of least squares are at most about three times the smallest possible ones.
        if self.spread > 4 * tolerance:
            return None
        found = self._rate_near(span, tolerance)
        if found is None and _half_range(self.times - self.ticks * self.narrowest) <= tolerance:
            found = self._rate_near(Fraction(self.narrowest) * self.last, tolerance)
        return found

    def _rate_near(self, span: Fraction, tolerance: float) -> Fraction | None:
        slack = Fraction(2 * tolerance)
        for _ in range(40):
            rate = _roundest(span, slack, self.last)
            if _half_range(self.residual(rate)) <= tolerance:
                return rate
            slack /= 2
        return None


def _hypotheses(
    times: NDArray[np.float64], steps: NDArray[np.float64], numbers: NDArray[np.float64] | None
) -> Iterator[_Line]:
    """No row missing but by the numbers; then rows missing from the grid of the short steps, of the
    median step."""
    yield _Line(np.arange(len(times), dtype=np.float64) if numbers is None else numbers, times)
    if steps.min() <= 0:
        return
    for period in (steps[steps < 1.5 * steps.min()].mean(), np.median(steps)):
        counts = np.ones(len(steps))
        guess = float(period)
        for _ in range(20):
            before = counts
            counts = np.maximum(1, np.rint(steps / guess))
            ticks = np.concatenate(([0.0], np.cumsum(counts)))
            if ticks[-1] >= TICK_LIMIT or np.array_equal(counts, before):
                break
            guess = _slope(ticks, times)
        if len(times) <= ticks[-1] < TICK_LIMIT:
            yield _Line(ticks, times)


def _several(sources: int) -> ParameterError:
    return ParameterError(
        f"the times are not regular: the rows seem to come from {sources} sources in turn; store "
        "each as a file of its own, or give a rate (rate=)"
    )


class Settled(NamedTuple):
    """Rows whose times jitter: row i is at ``ticks[i]`` (whole float64), at about ``offset_s +
    ticks[i] * period_s`` seconds.

    ``residual``: ticks from there to the median row. ``least_residual``: the same without the delay
    of rows that came late. ``disagreement``: share by which the period differs from that of short
    pieces. ``sources``: how many devices sent the rows in turn, each with a clock of its own.
    """

    ticks: NDArray[np.float64]
    period_s: float
    offset_s: float
    residual: float
    least_residual: float
    disagreement: float
    sources: int

    @property
    def is_regular(self) -> bool:
        return (
            self.residual <= _UNSETTLED and self.disagreement <= _DISAGREEING and self.sources == 1
        )

    @property
    def is_numbered(self) -> bool:
        """Whether rows with numbers are regular, but for rows that come late."""
        return self.least_residual <= _UNCOUNTED and self.disagreement <= _DISAGREEING

    def fits(self, rate: Fraction) -> bool:
        """Whether the rows have a given rate, but for the drift of a clock."""
        drift = abs(self.period_s * float(rate) - 1)
        return drift <= _GIVEN and self.least_residual <= _UNCOUNTED


def settle(
    times: NDArray[np.float64], numbers: NDArray[np.float64] | None = None
) -> Settled | None:
    """Counts the ticks of rows whose times, in s, jitter; None for fewer than 64 rows.

    The phase of a row is its time in periods, less its number. It rises for good where rows are
    lost, and for some rows only where they came late. A median of 5 removes single outliers. The
    least phase of the next 24 rows removes bursts: a row may come late, never early. A median of
    15 removes what is left. The phase is then rounded, and never falls.

    The period is the median slope, over 256 rows first, then over twice as many until all rows are
    in. Where the clock wanders from that line, the rows are counted a second time from its mean
    course. tests/test_timestamps.py has the limits.

    ``numbers`` increase, and count the rows together with those that were lost. The phase then
    rises only where they did not count, so rows may come in longer bursts.
    """
    count = len(times)
    if count < _SETTLED_ROWS:
        return None
    if numbers is None:
        numbers, ahead = np.arange(count, dtype=np.float64), _BURST_ROWS
    elif (found := _by_numbers(times, numbers)) is not None:
        return found
    else:
        ahead = _NUMBERED_BURST_ROWS

    def refined(rows: slice, period: float) -> float:
        for _ in range(2):
            ticks = _counted(times[rows] / period - numbers[rows], ahead)[0] + numbers[rows]
            period = _median_slope(ticks, times[rows])
        return period

    lag = min(_SETTLED_ROWS, count // 4)
    guess = float(np.median((times[lag:] - times[:-lag]) / (numbers[lag:] - numbers[:-lag])))
    if guess <= 0:
        return None
    guess = _common_period(times, guess)
    starts = range(0, count, max(_FIRST_ROWS, count // _PIECES))
    pieces = [
        refined(slice(start, start + _FIRST_ROWS), guess)
        for start in starts
        if start == 0 or start + _FIRST_ROWS <= count
    ]
    period = nearby = float(np.median(pieces))
    stop = min(_FIRST_ROWS, count)
    while stop < count:
        period = refined(slice(stop), period)
        stop = min(2 * stop, count)
    period = refined(slice(count), period)
    if period <= 0:
        return None
    phase = times / period - numbers
    steps, left = _counted(phase, ahead)
    wander = _wander(left)
    first = count
    if float(np.ptp(wander)) > _WANDERING:
        phase -= wander
        steps, left = _counted(phase, ahead)
        first = _FIRST_ROWS
    ticks = numbers + steps
    if ticks[-1] >= TICK_LIMIT:
        return None
    late = phase - steps
    residual = float(np.median(np.abs(late - np.median(late))))
    if first < count:
        period = _median_slope(ticks, times)
    offset = float(np.median((times - ticks * period)[:first]))
    return Settled(
        ticks,
        period,
        offset,
        residual,
        float(np.median(np.abs(left))),
        abs(period / nearby - 1),
        count_sources(times, period),
    )


def is_scattered(times: NDArray[np.float64], numbers: NDArray[np.float64] | None) -> bool:
    """Whether rows come like random ones, in bursts or alone, rather than at a rate."""
    steps = np.diff(times)
    alone = np.flatnonzero(steps > _AT_ONCE * steps.mean())
    lag = min(max(alone.size // 16, 1), 16)
    if alone.size <= lag:
        return False
    later = times[1:][alone]
    counts = np.arange(alone.size) if numbers is None else numbers[1:][alone]
    rows = counts[lag:] - counts[:-lag]
    low, middle, high = np.quantile((later[lag:] - later[:-lag]) / rows, (0.25, 0.5, 0.75))
    # The quartiles of a normal distribution are 1.349 standard deviations apart.
    return float(((high - low) / 1.349 / middle) ** 2 * np.median(rows)) > _SCATTERED


def _common_period(times: NDArray[np.float64], guess: float) -> float:
    """The period near a guess at which the phases of rows agree best, whatever rows are lost.

    It has the largest sum of the periodograms of some pieces. Where random rows could have one as
    large, the guess.
    """
    rows = min(len(times), _PIECE_ROWS)
    starts = np.linspace(0, len(times) - rows, min(_PIECES, len(times) // rows)).astype(int)
    bins = _FINE_BINS * rows
    power = np.zeros(_PADDING * bins // 2 + 1)
    for start in starts.tolist():
        piece = (times[start : start + rows] - times[start]) * (_FINE_BINS / guess)
        counts = np.bincount(piece[(piece >= 0) & (piece < bins)].astype(np.int64))
        power += np.abs(np.fft.rfft(counts, _PADDING * bins)) ** 2
    low, high = (int(share * _PADDING * rows) for share in (0.99, 1.1))
    best = low + int(power[low:high].argmax())
    is_sure = power[best] > (len(starts) + _SURE) * rows
    return guess * _PADDING * rows / best if is_sure else guess


def _by_numbers(times: NDArray[np.float64], numbers: NDArray[np.float64]) -> Settled | None:
    """Rows whose numbers count all that were lost; None where rows come later for good."""
    period = _median_slope(numbers, times)
    if period <= 0:
        return None
    phase = times / period - numbers
    middle = float(np.median(phase))
    residual = float(np.median(np.abs(phase - middle)))
    if _counted(phase, _NUMBERED_BURST_ROWS)[0][-1] > residual:
        return None
    # The delay of the last rows of either half turns the line.
    turned = 2 * residual / len(times) if residual > _UNSETTLED else 0.0
    return Settled(numbers, period, middle * period, residual, 0.0, turned, 1)


def _wander(left: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ticks by which the clock is off its mean rate at each row, by medians of 256 rows.

    Whole ticks between two of these are rows that were lost, or counted too often.
    """
    pieces = len(left) // _FIRST_ROWS
    if pieces < 2:
        return np.zeros(len(left))
    medians = np.median(left[: pieces * _FIRST_ROWS].reshape(pieces, -1), axis=1)
    middles = (np.arange(pieces) + 0.5) * _FIRST_ROWS
    return np.interp(np.arange(len(left)), middles, np.unwrap(medians, period=1))


def count_sources(times: NDArray[np.float64], period: float) -> int:
    """How many sources take turns: steps over as many rows vary less than single steps do.

    Delays that are independent of each other vary steps of any length alike.
    """
    if len(times) < _SETTLED_ROWS:
        return 1
    single = _variation(times, 1)
    if single < 0.05 * period:
        return 1
    several = {count: _variation(times, count) for count in range(2, _SOURCES + 1)}
    best = min(several, key=several.__getitem__)
    return best if several[best] < single / 3 else 1


def _variation(times: NDArray[np.float64], rows: int) -> float:
    steps = times[rows:] - times[:-rows]
    return float(np.median(np.abs(steps - np.median(steps))))


def _counted(
    phase: NDArray[np.float64], ahead: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ticks that were lost before each row, and what is left of the phases without late rows."""
    phase = _least_of_next(_median_of(phase, 5), ahead)
    if ahead > _BURST_ROWS:
        phase[-_BURST_ROWS:] = phase[-_BURST_ROWS]  # too few rows follow
    phase = _median_of(phase, 15)
    phase -= np.median(phase - np.rint(phase))
    late = np.maximum.accumulate(np.rint(phase))
    return late - late[0], phase - late


def _median_of(x: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """The median of the ``width`` values around each; the ends repeat."""
    half = width // 2
    padded = np.concatenate((np.full(half, x[0]), x, np.full(half, x[-1])))
    around = sliding_window_view(padded, width)
    out = np.empty_like(x)
    for start in range(0, len(x), _PIECE):
        out[start : start + _PIECE] = np.median(around[start : start + _PIECE], axis=1)
    return out


def _least_of_next(x: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    out, covered, width = x.copy(), 1, min(width, len(x))
    while covered < width:
        ahead = min(covered, width - covered)
        out[:-ahead] = np.minimum(out[:-ahead], out[ahead:])
        covered += ahead
    return out


def _median_slope(ticks: NDArray[np.float64], times: NDArray[np.float64]) -> float:
    """The median of the lines through rows that are half of all rows apart."""
    half = len(ticks) // 2
    return float(np.median((times[half:] - times[:-half]) / (ticks[half:] - ticks[:-half])))


def _slope(ticks: NDArray[np.float64], times: NDArray[np.float64]) -> float:
    centred = ticks - ticks.mean()
    return float(centred @ (times - times.mean()) / (centred @ centred))


def _half_range(residual: NDArray[np.float64]) -> float:
    return float(residual.max() - residual.min()) / 2


def whole_ns(stamp: Decimal, unit_exponent: int = 0) -> int:
    """Rounded; ValueError, with the reason, beyond 64 bits."""
    ns = int(_EXACT.to_integral_value(_EXACT.scaleb(stamp, 9 + unit_exponent)))
    if not -(1 << 63) <= ns < 1 << 63:
        raise ValueError("is more than 292 years from zero, too far to be kept in ns")
    return ns


def _at(ticks: NDArray[np.float64], rate: Fraction) -> NDArray[np.float64]:
    return ticks * float(rate.denominator) / float(rate.numerator)


def _roundest(span: Fraction, slack: Fraction, ticks: int) -> Fraction:
    """The simplest rate that fits ``ticks`` ticks into span +- slack seconds.

    Among the fractions with the smallest denominator it prefers those with most zeros at the
    end of their numerator, then the one nearest to the middle.
    """
    low = ticks / (span + slack)
    high = ticks / (span - slack) if slack < span else 2 * ticks / span
    denominator = _simplest(low, high).denominator
    middle = (low + high) * denominator / 2
    zeros = 10 ** len(str(floor(high * denominator)))
    while True:
        multiples = range(ceil(low * denominator / zeros), floor(high * denominator / zeros) + 1)
        if multiples:
            best = min(max(round(middle / zeros), multiples[0]), multiples[-1])
            return Fraction(best * zeros, denominator)
        zeros //= 10


def _roundest_near(rate: Fraction) -> Fraction:
    """The roundest rate that a device may name whose clock runs at ``rate``."""
    ticks = 1 << 20
    return _roundest(ticks / rate, ticks / rate * _NOMINAL, ticks)


def _simplest(low: Fraction, high: Fraction) -> Fraction:
    """The fraction of the smallest denominator in [low, high], 0 < low: by continued fractions."""
    h0, k0, h1, k1 = 0, 1, 1, 0
    while True:
        whole = ceil(low)
        if whole > high:
            whole = floor(low)
        h0, k0, h1, k1 = h1, k1, whole * h1 + h0, whole * k1 + k0
        if low <= whole:
            return Fraction(h1, k1)
        low, high = 1 / (high - whole), 1 / (low - whole)


def in_words(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1000 * seconds:.3g} ms"


def deviation_note(largest: float, rate: Fraction, key: str = "", *, kept: bool = False) -> str:
    """How far the times of the samples, in s, lie from the regular ones that replace them."""
    others = "a channel keeps the others" if kept else "only the regular times are stored"
    return (
        f"the sample times{key} differ from a regular {float(rate):.6g} Hz by up to "
        f"{in_words(largest)}; {others}"
    )
