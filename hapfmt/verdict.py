"""The verdict on a file: the table of SPEC clause 14, in the one place where it is applied."""

from __future__ import annotations

from collections.abc import Iterable

from .errors import FormatError, HapfmtError, LimitError, UnsupportedError

INTACT, NONCONFORMING, DAMAGED, UNSUPPORTED = 0, 2, 3, 4
VERDICTS = {
    INTACT: "intact",
    NONCONFORMING: "nonconforming",
    DAMAGED: "damaged",
    UNSUPPORTED: "unsupported",
}
HARMLESS = frozenset({"not-closed"})
"""Codes of findings that take nothing away from what the file holds."""


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
