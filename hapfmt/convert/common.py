"""What the formats share: rates, exact doubles, gaps as NaN, and notes on what is left out."""

from __future__ import annotations

import re
import warnings
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from fnmatch import fnmatchcase
from fractions import Fraction
from itertools import accumulate
from math import isfinite
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataWarning, HapfmtError, LimitError, ParameterError
from ..numbers import checked_rate, hertz
from ..recording import CHANNEL_LIMIT, Channel, Recording, extent
from ..spool import release
from ..units import to_ucum, unknown_unit

SLICE = 1 << 18
"""Values that are written at a time."""

BLOCK_SIZE = 1 << 20
"""Bytes read at a time, so that a wrong size field costs no memory."""

_RATE = re.compile(r"\d{1,40}/\d{1,40}|(?:\d{1,40}\.?\d{0,40}|\.\d{1,40})(?:e[+-]?\d{1,2})?", re.A)
"""Bounded, since Fraction("1e999999999") would compute all of its digits."""

_GRAVITIES = {"g": "[g]", "mg": "m[g]"}
_ACCELERATION = re.compile(r"(?i:acc(?=el|[xyz]?(?:[^a-z]|$))|beschl)|acc(?=[A-Z])|Acc(?=[A-Z])")


def rate_from(value: Fraction | float | str) -> Fraction:
    """Ticks per second, exactly: 35.618 (the shortest decimal of the float) is 17809/500."""
    if isinstance(value, float) and isfinite(value):
        value = hertz(value)
    given = str(value).strip()
    text = given.lower()
    if _RATE.fullmatch(text) is None or re.search("/0+$", text):
        raise ParameterError(f"{given[:40]!r} is not a rate in Hz, such as 1000, 35.618 or 44100/7")
    return checked_rate(Fraction(text))


def choose_rate(given: Fraction | None, found: Fraction | None, notes: list[str]) -> Fraction:
    """The caller's rate if there is one, otherwise the file's."""
    if given is not None:
        if found not in (None, given):
            notes.append(f"the rate of the file, {found} Hz, was overridden by {given} Hz")
        return given
    if found is None:
        raise ParameterError("the file holds no rate; give one (rate=)")
    return found


def filled_rates(
    given: Fraction | None,
    tables: Sequence[tuple[str, Fraction | None, str | None]],
    notes: list[str],
) -> tuple[list[Fraction | None], bool]:
    """The rates of tables, of which the name, the stated rate and the name of the times are known;
    and whether the rate is also that of their times.

    The caller's rate is for tables without a rate and without times. Where all tables have one
    rate, or share their times, it replaces that. Otherwise times take it that tell none.
    """
    stated = [rate for _, rate, _ in tables]
    if given is None or not tables:
        return stated, False
    lacking = [rate is None and times is None for _, rate, times in tables]
    if any(lacking):
        names = list(
            dict.fromkeys(name for (name, *_), lacks in zip(tables, lacking, strict=True) if lacks)
        )
        if not all(lacking):
            more = f" and {len(names) - 5} more" if len(names) > 5 else ""
            listed = ", ".join(names[:5]) + more
            notes.append(f"the rate {given} Hz is only for {listed}; the file tells the others")
        return [
            given if lacks else rate for rate, lacks in zip(stated, lacking, strict=True)
        ], False
    if len({(rate, times) for _, rate, times in tables}) == 1:
        return [choose_rate(given, stated[0], notes)] * len(tables), True
    if all(times is None for *_, times in tables):
        raise several_rates()
    return stated, False


def several_rates() -> ParameterError:
    """No table took the rate of the caller."""
    return ParameterError(
        "the channels have several rates, and all of them have one; to replace a rate (rate=), "
        "select channels of one (select=)"
    )


def selected(names: Sequence[str], patterns: Sequence[str], what: str) -> list[int]:
    """Places of the names that a pattern fits, or of all where there are no patterns.
    ParameterError for a pattern that fits none."""
    if not patterns:
        return list(range(len(names)))
    for pattern in patterns:
        if not any(fits(name, pattern) for name in names):
            known = ", ".join(map(repr, dict.fromkeys(names[:20]))) or "none"
            raise ParameterError(f"no {what} is called {pattern!r}; there are: {known}")
    return [i for i, name in enumerate(names) if any(fits(name, p) for p in patterns)]


def fits(name: str, pattern: str) -> bool:
    """Itself, since a name may hold brackets, or as a pattern of the shell."""
    return name == pattern or fnmatchcase(name, pattern)


@contextmanager
def refusing(what: str, *errors: type[Exception]) -> Iterator[None]:
    """Turn the exceptions of a foreign parser into a ParameterError that begins with ``what``."""
    usual = (ValueError, TypeError, ArithmeticError, LookupError, EOFError, MemoryError)
    foreign: tuple[type[Exception], ...] = (*usual, *errors)
    try:
        yield
    except (HapfmtError, OSError):
        raise
    except foreign as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise ParameterError(f"{what}: {reason}") from error


def read_bytes(stream: IO[bytes], size: int) -> bytearray:
    """Up to ``size`` bytes, fewer only at the end of the stream."""
    data = bytearray()
    while len(data) < size:
        block = stream.read(min(BLOCK_SIZE, size - len(data)))
        if not block:
            break
        data += block
    return data


def exact_doubles(x: NDArray[Any], what: str) -> NDArray[np.float64]:
    """Real numbers of any dtype and shape as float64 of the same value, or a ParameterError."""
    if x.dtype.kind not in "biuf":
        raise ParameterError(f"{what} holds {x.dtype} values, not real numbers")
    with np.errstate(over="ignore", invalid="ignore"):  # of a wider float, of a signalling NaN
        doubles = x.astype(np.float64, copy=False)
    if x.dtype.kind in "iu" and x.dtype.itemsize == 8:
        inexact = ~_fits_53_bits(x)
    elif x.dtype.itemsize > 8:
        inexact = (doubles.astype(x.dtype) != x) & ~np.isnan(x)
    else:
        return doubles
    if inexact.any():
        raise ParameterError(f"{what} holds {x[inexact][0]}, which no double is equal to")
    return doubles


def are_doubles(x: NDArray[Any]) -> bool:
    """Whether a double is equal to each of these 64-bit integers."""
    return bool(_fits_53_bits(x).all())


def _fits_53_bits(x: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether each 64-bit integer has at most 53 bits between its first and its last 1."""
    magnitude = x.astype(np.uint64)
    magnitude = np.where(x < 0, ~magnitude + np.uint64(1), magnitude)
    lowest = magnitude & (~magnitude + np.uint64(1))
    odd = magnitude // np.maximum(lowest, np.uint64(1))
    return np.asarray(odd <= np.uint64(1 << 53))


class Dense:
    """Physical values of channels of one rate, from the first sample of any to the last of any,
    NaN in gaps; made slice by slice, so that a gap takes no memory.

    Raises LimitError where the gaps alone take more than ``max_memory`` bytes as float64.
    """

    def __init__(self, channels: Sequence[Channel], suffix: str, max_memory: int) -> None:
        self.channels = channels
        self.start, self.stop = extent(channels)
        self.ticks = self.stop - self.start
        self.gap_size = 8 * (
            len(channels) * self.ticks - sum(channel.stored.size for channel in channels)
        )
        if self.gap_size > max_memory:
            raise LimitError(
                f"the gaps take {self.gap_size} bytes as NaN in {suffix}, more than the "
                f"{max_memory} allowed; allow more (max_memory=) or write a part"
            )
        self._starts = [[span.start for span in channel.coverage] for channel in channels]
        self._places = [
            [0, *accumulate(span.ticks for span in channel.coverage)] for channel in channels
        ]
        for channel in channels:
            if channel.stored.dtype.itemsize == 8 and not channel.is_counts:
                for at in range(0, channel.stored.size, SLICE):
                    self._doubles(channel, at, at + SLICE)
                    release()

    def row(self, number: int, first: int, last: int) -> NDArray[np.float64]:
        """[last - first] values of one channel at the ticks first <= tick < last."""
        channel, starts = self.channels[number], self._starts[number]
        out = np.full(last - first, np.nan)
        for place in range(max(bisect_right(starts, first) - 1, 0), len(starts)):
            span = channel.coverage[place]
            if span.start >= last:
                break
            a, b = max(span.start, first), min(span.stop, last)
            if a < b:
                at = self._places[number][place] + a - span.start
                out[a - first : b - first] = self._doubles(channel, at, at + b - a)
        release()
        return out

    def rows(self, number: int) -> Iterator[NDArray[np.float64]]:
        """The values of one channel, slice by slice."""
        for first in range(self.start, self.stop, SLICE):
            yield self.row(number, first, min(first + SLICE, self.stop))

    def frames(self) -> Iterator[NDArray[np.float64]]:
        """[ticks of a slice, channels] of all channels, slice by slice."""
        at_once = max(SLICE // max(len(self.channels), 1), 1)
        for first in range(self.start, self.stop, at_once):
            yield self.block(first, min(first + at_once, self.stop)).T

    def block(self, first: int, last: int) -> NDArray[np.float64]:
        """[channels, last - first]."""
        return np.stack([self.row(i, first, last) for i in range(len(self.channels))])

    @staticmethod
    def _doubles(channel: Channel, start: int, stop: int) -> NDArray[np.float64]:
        if channel.exact is not None:
            return channel.exact[start:stop]
        if channel.calibration is not None:
            return channel.calibration.physical(channel.stored[start:stop])
        return exact_doubles(channel.stored[start:stop], f"channel {channel.label!r}")


def one_rate(recording: Recording, suffix: str) -> Fraction:
    """The rate that all channels share, or a ParameterError with the way out."""
    rates = {checked_rate(channel.rate_exact) for channel in recording.channels}
    if not rates:
        raise ParameterError(f"a recording without channels cannot be written as {suffix}")
    if len(rates) > 1:
        listed = ", ".join(f"{rate} Hz" for rate in sorted(rates)[:5])
        raise ParameterError(
            f"{suffix} holds one rate, the channels have {listed}; choose those of one "
            "rate (sel), or use .npz"
        )
    return rates.pop()


def unit_of(text: str, label: str, notes: list[str], *, about: str = "") -> str:
    """UCUM code of a unit text, with a note where the code lost characters of it.

    "g" is [g] where the label, or ``about``, says acceleration. Otherwise a note says what it is.
    """
    code = to_ucum(text)
    if code in _GRAVITIES and "gram" not in text.casefold():
        if _ACCELERATION.search(f"{label} {about}") is not None:
            code = _GRAVITIES[code]
            notes.append(
                f"the unit of channel {label!r} is read as {code}, since its name says acceleration"
            )
        else:
            notes.append(f"the unit {code} of channel {label!r} is mass; [g] is acceleration")
    if (typo := unknown_unit(text, typos_only=True)) is not None:
        warnings.warn(typo, DataWarning, stacklevel=2)
    if not text.isascii() and (code == "1" or code.startswith("{")):
        notes.append(f"the unit {text!r} of channel {label!r} is kept as {code}")
    return code


def with_notes(metadata: dict[str, Any], notes: Sequence[str]) -> dict[str, Any]:
    return {**metadata, "notes": list(notes)} if notes else metadata


def without_units(recording: Recording, labels: Iterable[str], *more: str) -> Recording:
    """The recording without its notes on the units of channels that are not used, but with
    ``more`` notes."""
    named = tuple(f"of channel {label!r} " for label in labels)
    notes = recording.metadata.get("notes", [])
    if not isinstance(notes, list):
        return recording
    kept = [
        note for note in notes
        if not (str(note).startswith("the unit ") and any(name in note for name in named))
    ]  # fmt: skip
    rest = {key: value for key, value in recording.metadata.items() if key != "notes"}
    return replace(recording, metadata=with_notes(rest, [*kept, *more]))


def not_carried(recording: Recording, suffix: str, *carried: str) -> list[str]:
    """A note on what is set in a recording and is not among the names that ``suffix`` holds.

    The notes of an earlier conversion are none of it.
    """
    plain = Recording(), Channel(np.empty(0), Fraction(1))
    lost = [
        *(
            name
            for name in _RECORDING_FIELDS
            if name not in carried and getattr(recording, name) != getattr(plain[0], name)
        ),
        *(f"metadata {key!r}" for key in recording.metadata if key not in (*carried, "notes")),
        *(
            name
            for name in _CHANNEL_FIELDS
            if name not in carried
            and any(getattr(c, name) != getattr(plain[1], name) for c in recording.channels)
        ),
    ]
    has_clocks = "clocks" in lost or "clock_maps" in lost
    advice = "; .npz holds clocks" if has_clocks else ""
    return [f"not carried over to {suffix}: {', '.join(lost)}{advice}"] if lost else []


_RECORDING_FIELDS = [f.name for f in fields(Recording) if f.name not in ("channels", "metadata")]
_SAMPLES = ("stored", "exact", "rate_exact", "coverage")
_CHANNEL_FIELDS = [f.name for f in fields(Channel) if f.name not in _SAMPLES]

__all__ = [
    "CHANNEL_LIMIT",
    "SLICE",
    "Dense",
    "choose_rate",
    "exact_doubles",
    "extent",
    "filled_rates",
    "fits",
    "not_carried",
    "one_rate",
    "rate_from",
    "read_bytes",
    "refusing",
    "selected",
    "several_rates",
    "unit_of",
    "with_notes",
]
