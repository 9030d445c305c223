"""The exceptions of the package, verdicts on files, and suggestions for mistyped names.

Input of any kind raises only these exceptions and OSError. A message names the place and the rule:
``file.hapf:0x1f3: knot ticks not increasing [KNT-003]``. Only this module applies the table of
SPEC clause 13, which gives the verdict on a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any


class HapfmtError(Exception):
    """Root of our errors.

    ``offset`` is the position in the file in bytes, ``requirement`` the id of the SPEC sentence
    that the input breaks, ``path`` the file; each is None where it does not apply. ``more``:
    further lines, such as the commands that would work.
    """

    exit_code = 1

    def __init__(
        self,
        message: str,
        *,
        requirement: str | None = None,
        offset: int | None = None,
        path: str | None = None,
        more: Sequence[str] = (),
    ) -> None:
        super().__init__(message)
        self.message = message
        self.more = tuple(more)
        self.requirement = requirement
        self.offset = offset
        self.path = path

    def at(self, *, offset: int | None = None, path: str | None = None) -> HapfmtError:
        """Fill in the place, where it is not known yet, and return the same error."""
        if self.offset is None:
            self.offset = offset
        if self.path is None:
            self.path = path
        return self

    def __str__(self) -> str:
        return "\n".join([self.line(), *self.more])

    def line(self) -> str:
        """The first line: place, message and rule."""
        place = ":".join(
            part
            for part in (
                self.path or "",
                f"0x{self.offset:x}" if self.offset is not None else "",
            )
            if part
        )
        rule = f" [{self.requirement}]" if self.requirement else ""
        return f"{place}: {self.message}{rule}" if place else f"{self.message}{rule}"


class FormatError(HapfmtError):
    """The bytes break a rule of the SPEC."""

    exit_code = 2


class TruncatedError(FormatError):
    """The bytes end before the structure does."""


class ChecksumError(FormatError):
    """A CRC-32 or a digest differs from the bytes that it covers."""


class UnsupportedError(HapfmtError):
    """The file needs a feature, codec or level that this version does not know."""

    exit_code = 4


class LimitError(HapfmtError):
    """More than the level or the caller's limits allow; raised before memory is allocated."""

    exit_code = 4


class ParameterError(HapfmtError):
    """The arguments are wrong or cannot be fulfilled; nothing was read or written."""


class UnknownChannelError(ParameterError, KeyError):
    """A recording has no such channel; also a KeyError, for code that expects one."""


class MovedTimesWarning(UserWarning):
    """The times of a table were moved onto a regular grid of ticks, or to another zero."""


class DataWarning(UserWarning):
    """hapfmt kept the data, but they may not be as the caller meant: an unknown unit, say."""


class DeviceError(HapfmtError):
    """A device did not take what it was sent, or has gone."""

    exit_code = 6


class DeviceGoneError(DeviceError):
    """The device was unplugged or switched off: no further write can reach it."""


class MissingExtraError(ParameterError):
    """An optional package is not installed; the message gives the command that brings it."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(
            f"this needs the package {package!r}; install it with: pip install 'hapfmt[{extra}]'"
        )


INTACT, NONCONFORMING, DAMAGED, UNSUPPORTED = 0, 2, 3, 4
VERDICTS = {
    INTACT: "intact",
    NONCONFORMING: "nonconforming",
    DAMAGED: "damaged",
    UNSUPPORTED: "unsupported",
}
HARMLESS = frozenset({"not-closed"})
"""Codes of findings that do not affect the contents of the file."""


def verdict_of(
    codes: Iterable[str] = (),
    *,
    error: HapfmtError | None = None,
    unknown: bool = False,
    lost: bool = False,
) -> int:
    """The first row of the table that applies, as an exit code.

    ``codes`` are those of the findings, ``error`` ended the work, ``unknown`` says that
    a critical part is not understood, ``lost`` that samples are missing.
    """
    found = set(codes)
    broken = isinstance(error, FormatError)
    if isinstance(error, LimitError):
        return UNSUPPORTED
    if lost or found - HARMLESS:
        return DAMAGED
    if found and not broken:
        return DAMAGED
    if unknown or isinstance(error, UnsupportedError):
        return UNSUPPORTED
    return NONCONFORMING if broken else INTACT


SHOWN = 30
"""Most names that a message lists."""


RATES = frozenset({"fs", "sr", "hz", "samplerate", "sample_rate", "sampling_rate"})
"""What other packages call a rate."""


def similar(name: str, known: Iterable[str], cutoff: float | None = None) -> str | None:
    """The known name that a mistyped one most resembles; ``cutoff``: least similarity, 0 to 1."""
    from difflib import get_close_matches

    names = {each.lower(): each for each in known if each}
    if name.lower().replace("-", "_") in RATES and "rate" in names:
        return names["rate"]
    cutoff = cutoff or (0.6 if len(name) > 3 else 0.5)
    found = get_close_matches(name.lower(), names, n=1, cutoff=cutoff)
    return names[found[0]] if found else None


def matching(pattern: str, names: Sequence[str]) -> list[int]:
    """The places of the names that a pattern such as "pos_*" fits; none where the text is itself a
    name, or has no wildcard."""
    from fnmatch import fnmatchcase

    if pattern in names or not any(sign in pattern for sign in "*?["):
        return []
    return [place for place, name in enumerate(names) if fnmatchcase(name, pattern)]


def channels_called(names: Any, labels: Mapping[int, str]) -> list[int]:
    """Numbers of channels by label or number, in the order asked for; ``labels`` by number.

    A number that is not a label selects by number; other texts may be patterns such as "pos_*".
    Negative numbers count from the end. If several channels share a label, it selects the first.
    """
    if isinstance(names, (slice, set, frozenset, dict)) or not isinstance(
        names, (str, int, Iterable)
    ):
        raise ParameterError(
            f"channels are a label, a number or a list of them, not a {type(names).__name__}"
        )
    numbers = [*labels]
    by_label = {labels[number]: number for number in reversed(numbers)}
    by_number = {str(number): number for number in numbers}
    by_number |= {str(i - len(numbers)): number for i, number in enumerate(numbers)}
    chosen = []
    for name in [names] if isinstance(names, (str, int)) else names:
        found = by_label.get(name) if isinstance(name, str) else None
        found = by_number.get(str(name)) if found is None else found
        if found is not None:
            chosen.append(found)
            continue
        several = matching(name, [*labels.values()]) if isinstance(name, str) else []
        if not several:
            raise UnknownChannelError(unknown("channel", name, labels))
        chosen += [numbers[place] for place in several]
    return chosen


def refuse_keywords(given: Mapping[str, object], function: Callable[..., object]) -> None:
    """ParameterError for the first keyword that a function lacks; it names the one meant."""
    for name in given:
        from inspect import signature

        raise ParameterError(unknown("keyword", name, list(signature(function).parameters)[:-1]))


def unknown(kind: str, name: object, known: Iterable[str] | Mapping[int, str]) -> str:
    """The message for a name that is not known: the one that was meant, or those that there are,
    with their numbers where it has them."""
    names = list(known.values()) if isinstance(known, Mapping) else list(known)
    meant = similar(name, names) if isinstance(name, str) else None
    if meant is not None:
        return f"no {kind} {name!r}; did you mean {meant!r}?"
    listed = list(map(repr, names))
    if isinstance(known, Mapping):
        listed = [f"{number}={text}" for number, text in zip(known, listed, strict=True)]
    more = f" and {len(listed) - SHOWN} more" if len(listed) > SHOWN else ""
    return f"no {kind} {name!r}; there are: {', '.join(listed[:SHOWN]) or 'none'}{more}"
