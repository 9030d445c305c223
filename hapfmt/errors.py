"""Every error that leaves the package, whatever the bytes (OSError apart).

A message names the place and the rule: ``file.hapf:0x1f3: knot ticks not increasing [KNT-003]``.
"""

from __future__ import annotations

from collections.abc import Sequence


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
    """Conforming as far as understood, but needs a feature, codec or level unknown here."""

    exit_code = 4


class LimitError(HapfmtError):
    """More than the level, or the caller's own limits, allow; raised before memory is taken."""

    exit_code = 4


class ParameterError(HapfmtError):
    """The caller asked for something that cannot be done; nothing was read or written."""


class UnknownChannelError(ParameterError, KeyError):
    """A recording has no such channel; also a KeyError, for code that expects one."""


class MovedTimesWarning(UserWarning):
    """The times of a table were moved onto a regular grid of ticks, or to another zero."""


class LateError(HapfmtError):
    """A replay stopped itself, since it or the device could not keep up."""

    exit_code = 5


class DeviceError(HapfmtError):
    """A device did not take what it was sent, or has gone."""

    exit_code = 6


class MissingExtraError(ParameterError):
    """An optional package is not installed; the message gives the command that brings it."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(
            f"this needs the package {package!r}; install it with: pip install 'hapfmt[{extra}]'"
        )
