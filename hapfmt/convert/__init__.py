"""Other files <-> Recording, by suffix; a format's module is imported only when it is used.

What a format cannot hold, and what a file holds that a Recording cannot, is told in plain
sentences: ``Recording.metadata["notes"]`` after :func:`load`, the return value of :func:`save`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Protocol, cast

from ..atomic import atomic_write
from ..errors import HapfmtError, ParameterError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction

    from ..recording import Channel, Recording


FORMATS = {".npz": "npz", ".npy": "npy", ".csv": "csv", ".wav": "wav"}
"""Suffixes, and the modules here that read and write such files."""

MAX_MEMORY = 4 << 30
"""Bytes of sample values that a conversion may hold, unless the caller says otherwise."""


class _Converter(Protocol):
    """What each format's module offers; ``write`` returns notes on what it left out."""

    def read(self, stream: BinaryIO, *, rate: Fraction | None, max_memory: int) -> Recording: ...

    def write(
        self, recording: Recording, stream: BinaryIO, *, max_memory: int
    ) -> Sequence[str]: ...


def load(
    source: str | os.PathLike[str] | BinaryIO,
    *,
    format: str | None = None,
    rate: Fraction | float | str | None = None,
    max_memory: int = MAX_MEMORY,
) -> Recording:
    """The recording in a file, or in a binary stream (which need not be seekable).

    ``format`` is a suffix of :data:`FORMATS`, with or without its dot; a stream needs one.
    ``rate`` in Hz (a text may be "44100/7"; a float means its shortest decimal) is for files that
    do not hold one, and overrides the one of a file that does. ``metadata["notes"]`` lists what
    was not carried over.

    Raises ParameterError, with the file's name, for malformed input and for arrays whose declared
    size is above ``max_memory`` bytes; MissingExtraError; OSError.
    """
    from .common import rate_from

    path = _path_of(source)
    with _named(source):
        converter = _converter(_suffix(path, format))
        hertz = None if rate is None else rate_from(rate)
        if path is None:
            return converter.read(cast(BinaryIO, source), rate=hertz, max_memory=max_memory)
        with path.open("rb") as stream:
            return converter.read(stream, rate=hertz, max_memory=max_memory)


def save(
    recording: Recording,
    target: str | os.PathLike[str] | BinaryIO,
    *,
    format: str | None = None,
    force: bool = False,
    max_memory: int = MAX_MEMORY,
) -> tuple[str, ...]:
    """Write a recording to a file (whole or not at all) or to a binary stream.

    Returns notes on what the format could not hold. Raises ParameterError where the file exists
    (unless ``force``) or the format cannot hold the samples; MissingExtraError; OSError.
    """
    path = _path_of(target)
    with _named(target):
        converter = _converter(_suffix(path, format))
        if path is None:
            stream = cast(BinaryIO, target)
            notes = converter.write(recording, stream, max_memory=max_memory)
        else:
            with atomic_write(path, force=force) as stream:
                notes = converter.write(recording, stream, max_memory=max_memory)
    nans = [c.label or str(i) for i, c in enumerate(recording.channels) if _holds_nan(c)]
    more = [f"NaN values of {', '.join(nans)} cannot be told from gaps there"] if nans else []
    return (*notes, *more)


def _holds_nan(channel: Channel) -> bool:
    return channel.stored.dtype.kind == "f" and bool((channel.stored != channel.stored).any())


def _path_of(place: str | os.PathLike[str] | BinaryIO) -> Path | None:
    return Path(place) if isinstance(place, str | os.PathLike) else None


def _suffix(path: Path | None, format: str | None) -> str:
    """The key in FORMATS."""
    known = " ".join(FORMATS)
    if format is not None:
        suffix = "." + format.lower().removeprefix(".")
        if suffix not in FORMATS:
            raise ParameterError(f"no format is called {format!r}; there are: {known}")
        return suffix
    if path is None:
        raise ParameterError(f"a stream has no suffix; give its format: {known}")
    if path.suffix.lower() not in FORMATS:
        raise ParameterError(f"the suffix {path.suffix!r} is not one of: {known}")
    return path.suffix.lower()


def _converter(suffix: str) -> _Converter:
    return cast(_Converter, import_module(f"{__name__}.{FORMATS[suffix]}"))


@contextmanager
def _named(place: str | os.PathLike[str] | BinaryIO) -> Iterator[None]:
    """Put the name of the file, where it has one, into our errors."""
    path = _path_of(place)
    name = getattr(place, "name", None) if path is None else str(path)
    try:
        yield
    except HapfmtError as error:
        raise error.at(path=name if isinstance(name, str) else None) from error.__cause__
