"""Stamps of messages or rows, in ns -> ticks at a round rate, and back.

:mod:`hapfmt.times` counts the ticks. Here are the numbers of messages, clocks that are set, and
what a recording keeps of the stamps: observations of their clock, or a channel of them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ParameterError
from ..limits import TICK_LIMIT
from ..numbers import rdiv
from ..recording import Channel, spans_at
from ..times import STEADY, CountedRows, TickGrid, TimeStamps, in_words, is_scattered
from .common import refusing

_FEWEST_ROWS, _FEW_ROWS, _MANY_ROWS = 3, 8, 64
"""Rows that have a rate: if they are exactly regular, if they jitter a little, and if their ticks
need to be counted."""
_SMALL_JITTER = 0.25
"""Ticks: less than 64 rows are regular if all of them are nearer to their ticks."""
_SET_BACK_ROWS, _AROUND = 32, 7
"""A clock was set where its stamps go back by more than 32 periods, for 7 rows and longer."""
_DATES = 10**17
"""ns, three years: times from here on count from 1970."""
_RESTART_NUMBERS = 32
"""Numbers that go back by more, or to 0 or 1, begin again. Others came in another order."""
_IN_TURN = 0.05
"""Share of rows that go back, in time or number, where two publishers send in turn."""
_NUMBER_LIMIT = 1 << 32
_OBSERVED_S = 1
"""Time between two observations of a clock."""


class Placed(NamedTuple):
    """Rows on a grid of ticks. ``rate``: ticks per second, round. ``ticks``: of each row, [rows],
    increasing from 0. ``start_ns``: what the clock of the stamps shows at tick 0, on average.

    ``jitter_ns``: from a stamp to its tick, median. ``drift_ppm``: how much faster the ticks come
    than ``rate``, by the clock of the stamps.
    """

    rate: Fraction
    ticks: NDArray[np.int64]
    start_ns: int
    notes: tuple[str, ...]
    jitter_ns: int
    drift_ppm: float


class Observation(NamedTuple):
    """At ``tick`` of a channel, the clock showed ``time_ns``."""

    clock: str
    channel: int | str | None
    tick: int
    time_ns: int


def place(
    stamps_ns: ArrayLike,
    *,
    name: str,
    rate: Fraction | None = None,
    sequence: ArrayLike | None = None,
) -> Placed | None:
    """The ticks of rows in order of arrival, with their stamps in ns (int64) and, if they have
    some, their sequence numbers. ``name``: of the rows, for errors.

    None: the rows are not periodic, or too few for a rate; store them as events. ParameterError
    where they have a rate that the stamps do not tell, or come from two publishers.
    """
    try:
        return _placed(np.asarray(stamps_ns, np.int64), rate, sequence, name)
    except ParameterError as error:
        raise ParameterError(f"{name}: {error}") from error


def place_at_need(
    stamps_ns: NDArray[np.int64],
    given: Fraction | None,
    *,
    name: str,
    sequence: ArrayLike | None = None,
) -> tuple[Placed | None, bool]:
    """As :func:`place`; at the rate that the caller gives, only where the stamps tell none. And
    whether that was so."""
    try:
        found = place(stamps_ns, name=name, sequence=sequence)
    except ParameterError:
        if given is None:
            raise
        found = None
    if found is not None or given is None:
        return found, False
    return place(stamps_ns, name=name, rate=given, sequence=sequence), True


def _placed(
    stamps: NDArray[np.int64], rate: Fraction | None, sequence: ArrayLike | None, name: str
) -> Placed | None:
    if not stamps.size:
        return None
    notes: list[str] = []
    numbers = None if sequence is None else _unwrapped(np.asarray(sequence), stamps, rate, notes)
    steady = _steady(stamps, notes)
    try:
        found = TimeStamps.of_ns(steady).find(rate, numbers=numbers, nominal=True)
    except ParameterError:
        if rate is None and (
            stamps.size < _MANY_ROWS or is_scattered((steady - steady[0]) / 1e9, numbers)
        ):
            return None
        raise
    numbered = rate is None and not found.is_exact and numbers is not None
    if numbered and is_scattered((steady - steady[0]) / 1e9, numbers):
        return None
    late = (steady - steady[0]) / 1e9 - found.ticks * found.period_s
    start = found.offset_s if rate is None else float(np.median(late))
    late -= start
    jitter = np.abs(late)
    if rate is None and not (
        stamps.size >= _MANY_ROWS
        or (stamps.size >= _FEWEST_ROWS and found.is_exact)
        or (stamps.size >= _FEW_ROWS and float(jitter.max()) < _SMALL_JITTER * found.period_s)
    ):
        return None
    drift_ppm = (1 / (found.period_s * float(found.rate)) - 1) * 1e6
    notes += _notes(found, float(jitter.max()), drift_ppm)
    return Placed(
        found.rate,
        found.ticks.astype(np.int64),
        int(stamps[0]) + round(start * 1e9),
        tuple(f"{name}: {note}" for note in notes),
        round(float(np.median(jitter)) * 1e9),
        drift_ppm,
    )


def _unwrapped(
    sequence: NDArray[Any], stamps: NDArray[np.int64], rate: Fraction | None, notes: list[str]
) -> NDArray[np.float64] | None:
    """Sequence numbers from 0 that never begin again; None where they do not count the rows.

    Numbers begin again where the publisher did; the row then follows the one before it.
    """
    if sequence.shape != stamps.shape or sequence.dtype.kind not in "iu":
        raise ParameterError("sequence numbers are one integer for each row")
    if (sequence == sequence[0]).all():
        return None  # ROS 2 gives none
    size = 8 * sequence.dtype.itemsize
    limit = 1 << size if sequence.dtype.kind == "u" and size < 32 else _NUMBER_LIMIT
    numbers = sequence.astype(np.int64)
    steps = np.diff(numbers) % limit
    back = np.where(steps >= limit // 2, limit - steps, 0)
    many = _IN_TURN * stamps.size + 1
    often = np.count_nonzero(back) > many
    twice = np.count_nonzero((steps == 0) & (np.diff(stamps) != 0)) > many
    if (often or twice) and rate is None:
        how = "go back and forth" if often else "come twice"
        raise ParameterError(
            f"the sequence numbers {how}, so two publishers seem to send in turn; "
            "store each as a file of its own, or give a rate (rate=)"
        )
    again = (back > _RESTART_NUMBERS) | ((back > 0) & (numbers[1:] <= 1))
    if often or (steps == 0).any() or ((back > 0) & ~again).any():
        notes.append("the sequence numbers repeat or go back, so only the stamps give the ticks")
        return None
    passed = np.diff(stamps)
    period = float(np.median(passed[~again] / steps[~again]))
    again |= (steps > _RESTART_NUMBERS) & (passed < steps * period / 2)
    if again.any():
        times = np.count_nonzero(again)
        notes.append(
            f"the sequence numbers begin again {times} times; there the stamps give the ticks"
        )
    return np.concatenate(([0.0], np.cumsum(np.where(again, 1, steps))))


def _steady(stamps: NDArray[np.int64], notes: list[str]) -> NDArray[np.int64]:
    """The stamps without the steps of a clock that was set back."""
    if (row := restart(stamps)) is not None:
        raise ParameterError(
            f"the times start again after row {row + 1}, so the rows are of several recordings; "
            "store each as a file of its own"
        )
    steps = np.diff(stamps)
    period = int(np.median(steps)) if steps.size else 0
    limit = -_SET_BACK_ROWS * max(period, 1)
    places = np.flatnonzero(steps < limit)
    if places.size > _IN_TURN * stamps.size + 1:
        raise ParameterError(
            "the stamps go back and forth; sort the rows if they are shuffled, or store each as a "
            "file of its own if two clocks or publishers take turns"
        )
    for row in places.tolist():
        before = np.median(stamps[max(row + 1 - _AROUND, 0) : row + 1] - stamps[0])
        after = np.median(stamps[row + 1 : row + 1 + _AROUND] - stamps[0])
        if after - before < limit:
            back = int(steps[row])
            notes.append(
                f"the clock of the stamps went back by {-back / 1e9:.6g} s after row {row + 1}; "
                "the ticks go on without a gap"
            )
            steps[row] = period
    return np.concatenate((stamps[:1], stamps[0] + np.cumsum(steps)))


def restart(stamps: NDArray[np.int64]) -> int | None:
    """The last row before times that count from no date start again; None where they do not.

    Dates that go back are those of a clock that was set.
    """
    if stamps.size < 2 or stamps[0] >= _DATES:
        return None
    steps = np.diff(stamps)
    period = max(int(np.median(steps)), 1)
    places = np.flatnonzero(steps < 0)
    if places.size > _IN_TURN * stamps.size + 1:
        return None
    for row in places.tolist():
        before = np.median(stamps[max(row + 1 - _AROUND, 0) : row + 1] - stamps[0])
        after = np.median(stamps[row + 1 : row + 1 + _AROUND] - stamps[0])
        is_first = stamps[row + 1] <= stamps[0] + period
        if after < before and (is_first or after - before < -_SET_BACK_ROWS * period):
            return int(row)
    return None


def _notes(found: CountedRows, moved: float, drift_ppm: float) -> list[str]:
    notes = []
    rate, last = float(found.rate), float(found.ticks[-1])
    if moved > STEADY / rate:
        notes.append(f"rows moved by up to {in_words(moved)} to the ticks of {rate:.6g} Hz")
    if abs(drift_ppm) * 1e-6 * last > 0.5:
        notes.append(
            f"by the clock of the stamps, the rows come at {rate * (1 + drift_ppm / 1e6):.9g} Hz"
        )
    steps = np.diff(found.ticks)
    gaps = steps[steps > 1] - 1
    if gaps.size:
        notes.append(
            f"missing rows: {gaps.sum():.0f}, gaps: {gaps.size}, longest gap: {gaps.max():.0f} rows"
        )
    return notes


def align(placed: Sequence[Placed]) -> tuple[int, list[int]]:
    """What the clock shows at tick 0 of a recording of all these, in ns; the start tick of each.

    Each start is the nearest tick of its rate, so rows move by at most half a tick. Observations
    of the clock keep the difference.
    """
    epoch_ns = min((each.start_ns for each in placed), default=0)
    starts = [
        rdiv((each.start_ns - epoch_ns) * each.rate.numerator, each.rate.denominator * 10**9)
        for each in placed
    ]
    for each, start in zip(placed, starts, strict=True):
        if start + int(each.ticks[-1]) >= TICK_LIMIT:
            raise ParameterError(
                f"stamps lie {(each.start_ns - epoch_ns) / 1e9:.6g} s apart, which is more than "
                f"2^48 ticks of {float(each.rate):.6g} Hz; they seem to be of several clocks"
            )
    return epoch_ns, starts


def observations(
    placed: Placed,
    stamps_ns: ArrayLike,
    clock: str,
    start_tick: int,
    channel: int | str | None,
) -> tuple[Observation, ...]:
    """What a clock showed: in the first row, about once a second, on both sides of each gap, and in
    the last row. ``stamps_ns``: of this clock, which need not be the one that gave the ticks."""
    stamps = np.asarray(stamps_ns, np.int64)
    seconds = placed.ticks * placed.rate.denominator // (placed.rate.numerator * _OBSERVED_S)
    steps = np.diff(placed.ticks)
    kept = np.concatenate(([True], (steps > 1) | (np.diff(seconds) > 0)))
    kept[:-1] |= steps > 1
    kept[-1] = True
    return tuple(
        Observation(clock, channel, tick, time_ns)
        for tick, time_ns in zip(
            (placed.ticks[kept] + start_tick).tolist(), stamps[kept].tolist(), strict=True
        )
    )


def stamp_channel(
    placed: Placed, stamps_ns: ArrayLike, epoch_ns: int, start_tick: int
) -> NDArray[np.int64]:
    """How much later than the time of its tick each stamp is, in ns: a channel that keeps them.

    ``epoch_ns``: that of the recording, or 0 where it has none. Stamps of another clock: what it
    shows at second 0, which observations of it keep.
    """
    ticks = placed.ticks + start_tick
    return np.asarray(stamps_ns, np.int64) - _tick_times(ticks, placed.rate, epoch_ns)


def stamp_label(table: str, count: int) -> str:
    """The label of the channel that keeps the stamps of a table. ``count``: of such tables."""
    return f"{table.strip('/')}.stamp" if count > 1 else "stamp"


def kept_stamps(stamps_ns: Sequence[int], grid: TickGrid) -> Channel:
    """The channel "stamp" of the rows of a table, see :func:`stamp_channel`."""
    placed = Placed(grid.rate, grid.ticks, 0, (), 0, 0.0)
    with refusing("the time stamps cannot be kept"):
        values = stamp_channel(placed, np.array(stamps_ns, np.int64), grid.epoch_ns or 0, 0)
    return Channel(values, grid.rate, spans_at(grid.ticks), label="stamp", unit="ns")


def stamps_of(
    values: NDArray[np.int64], ticks: NDArray[np.int64], rate: Fraction, epoch_ns: int
) -> NDArray[np.int64]:
    """The stamps that :func:`stamp_channel` keeps, from its values and their ticks."""
    return values + _tick_times(ticks, rate, epoch_ns)


def _tick_times(ticks: NDArray[np.int64], rate: Fraction, epoch_ns: int) -> NDArray[np.int64]:
    """In ns, rounded down."""
    up, down = rate.denominator * 10**9, rate.numerator
    wide = int(np.abs(ticks).max(initial=0)) * up >= 1 << 63 or down >= 1 << 63
    times = ticks.astype(object) * up // down if wide else ticks * up // down
    return (times + epoch_ns).astype(np.int64)
