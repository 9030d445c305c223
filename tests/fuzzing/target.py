"""What a fuzzer is given, and how a call is judged."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar

from hapfmt.errors import DataWarning, HapfmtError, MovedTimesWarning

T = TypeVar("T")


class Target(NamedTuple):
    """Something that takes bytes. ``run`` raises AssertionError where a property does not hold, and
    anything but our errors where bytes do what they must not. ``mend`` makes checksums right."""

    name: str
    run: Callable[[bytes], None]
    seeds: Callable[[], Iterable[bytes]]
    mend: Callable[[bytes], bytes] = bytes
    size: int = 1 << 10
    """Bytes of an input, at most."""


def settled(call: Callable[..., T], *given: Any, **named: Any) -> T | None:
    """The value, or None where one of our errors says why there is none. Our warnings are allowed."""
    with warnings.catch_warnings():
        for ours in (DataWarning, MovedTimesWarning):
            warnings.simplefilter("ignore", ours)
        try:
            return call(*given, **named)
        except HapfmtError as error:
            assert str(error)
            return None


def outcome(call: Callable[[], T]) -> T | tuple[str, str | None, int | None, str]:
    """The value, or all that the error tells."""
    try:
        return call()
    except HapfmtError as error:
        return type(error).__name__, error.requirement, error.offset, error.message
