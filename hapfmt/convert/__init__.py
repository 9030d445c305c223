"""Other files <-> Recording, by suffix; a format's module is imported only when it is used.

Each direction reports its omissions in plain sentences: :func:`save` returns what a format cannot
hold, and ``Recording.metadata["notes"]`` lists what :func:`read` left out.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from contextlib import contextmanager
from importlib import import_module
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol, cast

from ..errors import HapfmtError, LimitError, ParameterError
from ..files import atomic_write

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction

    from ..limits import Limits
    from ..reading.reader import Band
    from ..recording import Rate, Recording, Seconds, Units


HAPF = ".hapf"
FORMATS = {".npz": "npz", ".npy": "npy", ".csv": "csv", ".wav": "wav"}
"""Suffixes, and the modules here that read and write such files."""

MAX_MEMORY = 1 << 30
"""Bytes that the gaps of an output may take, and that a file that is read may take at least, unless
the caller says otherwise."""

READ_MEMORY = 4 << 30
"""Bytes of sample values that a file that is read may take, unless the caller says otherwise."""

_OTHERS = """
7z aac ahap aif aiff arrow au avi bag bdf bz2 c c3d csv db3 dll edf exe feather flac gdf gif gz h
h5 haps hdf hdf5 hjif hmpg htm html ivs jpeg jpg json jsonl m4a mat mcap md mkv mov mp3 mp4 nc npy
npz ods ogg opus parquet pdf pickle pkl png pt pth py so svg tar tdms tgz toml tsv txt wav xdf xls
xlsx xml xz yaml yml zarr zip zst
"""
FOREIGN = frozenset(f".{suffix}" for suffix in _OTHERS.split())
"""Suffixes of other formats: no .hapf file is written under them."""


def refuse_foreign(path: str | os.PathLike[str]) -> None:
    """ParameterError where the suffix of a .hapf file to be written is that of another format."""
    suffix = Path(path).suffix.lower()
    if suffix in FORMATS:
        way = f"hapfmt convert and hapfmt.save write {suffix}"
        raise ParameterError(f"hapf files end in .hapf; {way}", path=os.fspath(path))
    if suffix in FOREIGN:
        raise ParameterError(
            f"hapf files end in .hapf; {suffix} is another format's", path=os.fspath(path)
        )


class _Converter(Protocol):
    """What each format's module offers; ``write`` returns notes on what it left out."""

    def read(
        self, stream: BinaryIO, *, rate: Fraction | None, max_memory: int, transpose: bool | None
    ) -> Recording: ...

    def write(
        self, recording: Recording, stream: BinaryIO, *, max_memory: int
    ) -> Sequence[str]: ...


def read(
    file: str | os.PathLike[str] | bytes | BinaryIO,
    channels: Sequence[str | int] | str | int | None = None,
    start: Seconds | None = None,
    stop: Seconds | None = None,
    *,
    format: str | None = None,
    rate: Rate | None = None,
    transpose: bool | None = None,
    band: Band = "full",
    exact: bool = True,
    limits: Limits | None = None,
    threads: int | None = None,
    max_memory: int | None = None,
) -> Recording:
    """The recording in a file of any format: .hapf .npz .npy .csv .wav.

    ``file`` is a path, a URL (extra "remote"), bytes, or a binary stream. ``format`` names its
    format. Without it the first bytes decide, and then the suffix. ``channels`` are labels or
    numbers, ``start`` and ``stop`` seconds: samples with start <= time < stop are read.

    Other formats than .hapf: ``rate`` in Hz (1000, 35.618 or "44100/7") is for files that hold
    none, and overrides the one of a file that does. ``transpose`` is for arrays that are [samples,
    channels]. ``metadata["notes"]`` lists everything that was not converted.

    .hapf: ``band`` is "full", "lf" or "hf"; ``exact`` False leaves the float64 corrections out; any
    damage raises (:class:`hapfmt.Reader` goes on).

    Raises ParameterError for other formats that are malformed, FormatError for .hapf;
    UnknownChannelError; LimitError above ``max_memory`` bytes or the ``limits``; MissingExtraError;
    OSError.
    """
    from ..limits import Limits

    if not isinstance(file, (str, os.PathLike, bytes, bytearray, memoryview)) and not hasattr(
        file, "read"
    ):
        raise ParameterError(
            f"hapfmt.read takes a path, a URL, bytes or a binary stream, not "
            f"{type(file).__name__}; hapfmt.write writes an array or a table to a file, "
            "hapfmt.Recording.from_array makes a recording of it"
        )
    if start is not None or stop is not None:
        from ..recording import check_seconds

        check_seconds(start, stop)
    if max_memory is not None and limits is None:
        limits = Limits(memory=max_memory)
    room = max_memory or (limits.memory if limits else None) or READ_MEMORY
    with _named(file), _opened(file) as opened:
        suffix, stream = _format_of(file, opened, format, room)
        if suffix == HAPF:
            from ..reading.reader import read as read_hapf

            if rate is not None or transpose is not None:
                raise ParameterError(
                    "a .hapf file holds its own rate; rate and transpose are for other formats"
                )
            source = stream if stream is not None and stream is not opened else file
            return read_hapf(
                source, channels, start, stop, band=band, exact=exact, limits=limits,
                threads=threads,
            )  # fmt: skip
        if band != "full":
            raise ParameterError(f"a {suffix} file has no bands")
        from .common import rate_from

        assert stream is not None
        hertz = None if rate is None else rate_from(rate)
        recording = _converter(suffix).read(
            stream, rate=hertz, max_memory=room, transpose=transpose
        )
        if channels is None and start is None and stop is None:
            return recording
        return recording.sel(channels, start, stop)


def load(
    source: str | os.PathLike[str] | BinaryIO,
    *,
    format: str | None = None,
    rate: Rate | None = None,
    max_memory: int | None = None,
) -> Recording:
    """Deprecated: :func:`hapfmt.read` reads every format."""
    warnings.warn("hapfmt.load is deprecated; use hapfmt.read", DeprecationWarning, stacklevel=2)
    return read(source, format=format, rate=rate, max_memory=max_memory)


@contextmanager
def _opened(file: str | os.PathLike[str] | bytes | BinaryIO) -> Iterator[BinaryIO | None]:
    """A binary stream, closed again where it is ours; None: a URL that the reader opens itself."""
    if isinstance(file, (bytes, bytearray, memoryview)):
        yield BytesIO(bytes(file))
        return
    if not isinstance(file, (str, os.PathLike)):
        yield file
        return
    if isinstance(file, str) and ("://" in file or "::" in file):
        from ..format.source import is_url, spooled_url

        if is_url(file):
            if PurePosixPath(file).suffix.lower() not in FORMATS:
                yield None
                return
            with spooled_url(file) as stream:
                stream.seek(0)
                yield stream
            return
    with Path(file).open("rb") as stream:
        yield stream


def _format_of(
    file: str | os.PathLike[str] | bytes | BinaryIO,
    stream: BinaryIO | None,
    format: str | None,
    room: int,
) -> tuple[str, BinaryIO | None]:
    """The suffix of the format, and a stream of the same bytes."""
    if stream is None:
        return HAPF, None
    if format is not None:
        return _suffix(None, format, HAPF), stream
    if not stream.seekable():
        from .common import read_bytes

        data = read_bytes(stream, room + 1)
        if len(data) > room:
            raise LimitError(
                f"the stream is longer than the {room} bytes allowed; give its format, or more "
                "memory (max_memory=)"
            )
        stream = BytesIO(data)
    begun = stream.tell()
    head = stream.read(_SNIFFED)
    stream.seek(begun)
    for magic, suffix in _MAGIC.items():
        if head.startswith(magic):
            return suffix, stream
    suffix = Path(file).suffix.lower() if isinstance(file, (str, os.PathLike)) else ""
    if suffix in (*FORMATS, HAPF):
        return suffix, stream
    if suffix in _TEXT and head and _is_text(head):
        return ".csv", stream
    if suffix in FOREIGN:
        known = " ".join([HAPF, *FORMATS])
        way = _LOADERS.get(suffix)
        hint = f"; load its arrays with {way}, then call hapfmt.write(array, ...)" if way else ""
        raise ParameterError(f"the suffix {suffix!r} is not one of: {known}{hint}")
    return HAPF, stream  # its reader says what is wrong


def _is_text(head: bytes) -> bool:
    text = head.decode("utf-8-sig", errors="replace").rstrip("\N{REPLACEMENT CHARACTER}")
    return "\N{REPLACEMENT CHARACTER}" not in text and all(
        c.isprintable() or c in "\t\r\n" for c in text
    )


_LOADERS = {
    **dict.fromkeys((".h5", ".hdf", ".hdf5"), "h5py.File"),
    ".mat": "scipy.io.loadmat (h5py.File for version 7.3)",
    ".parquet": "pandas.read_parquet",
    ".xls": "pandas.read_excel",
    ".xlsx": "pandas.read_excel",
}
"""Suffixes of formats that hapfmt does not read, and what reads them."""
_SNIFFED = 512
_TEXT = ("", ".txt", ".tsv", ".dat", ".asc")
_MAGIC = {
    b"\x8fHAP": HAPF,
    b"PK": ".npz",
    b"\x93NUMPY": ".npy",
    b"RIFF": ".wav",
    b"RF64": ".wav",
    b"RIFX": ".wav",
}


def save(
    recording: Any,
    target: str | os.PathLike[str] | BinaryIO,
    *,
    rate: Rate | None = None,
    labels: str | Sequence[str] | None = None,
    units: Units | None = None,
    transpose: bool | None = None,
    format: str | None = None,
    force: bool = False,
    max_memory: int | None = None,
) -> tuple[str, ...]:
    """Write a recording as .npz, .npy, .csv or .wav to a file (whole or not at all) or a stream.

    ``recording`` is a Recording, or an array or a table with ``rate``, ``labels``, ``units`` and
    ``transpose``, as for :func:`hapfmt.write`.

    These formats store gaps as NaN or empty cells, which may take ``max_memory`` bytes (1 GiB by
    default). Returns notes on everything that the format could not hold. Raises ParameterError if
    the file exists (unless ``force``) or the format cannot hold the samples; LimitError for larger
    gaps; MissingExtraError; OSError.
    """
    from ..recording import recording_of

    max_memory = MAX_MEMORY if max_memory is None else max_memory
    path = Path(target) if isinstance(target, str | os.PathLike) else None
    recording = recording_of(recording, rate, labels=labels, units=units, transpose=transpose)
    with _named(target):
        converter = _converter(_suffix(path, format))
        if path is None:
            stream = cast(BinaryIO, target)
            notes = converter.write(recording, stream, max_memory=max_memory)
        else:
            with atomic_write(path, force=force) as stream:
                notes = converter.write(recording, stream, max_memory=max_memory)
    nans = [
        c.label or str(i)
        for i, c in enumerate(recording.channels)
        if c.stored.dtype.kind == "f" and (c.stored != c.stored).any()
    ]
    more = [f"NaN values of {', '.join(nans)} cannot be told from gaps there"] if nans else []
    return (*notes, *more)


def _suffix(path: Path | None, format: str | None, *more: str) -> str:
    """The key in FORMATS, or one of ``more``."""
    known = " ".join([*FORMATS, *more])
    if format is not None:
        suffix = "." + format.lower().removeprefix(".")
        if suffix not in (*FORMATS, *more):
            raise ParameterError(f"no format is called {format!r}; there are: {known}")
        return suffix
    if path is None:
        raise ParameterError(f"a stream has no suffix; give its format: {known}")
    if path.suffix.lower() == HAPF and not more:
        call = f"hapfmt.write(recording, {str(path)!r})"
        raise ParameterError(f"hapfmt encode writes .hapf files; in Python, {call} does")
    if path.suffix.lower() not in (*FORMATS, *more):
        raise ParameterError(f"the suffix {path.suffix!r} is not one of: {known}")
    return path.suffix.lower()


def _converter(suffix: str) -> _Converter:
    return cast(_Converter, import_module(f"{__name__}.{FORMATS[suffix]}"))


@contextmanager
def _named(place: str | os.PathLike[str] | bytes | BinaryIO) -> Iterator[None]:
    """Put the name of the file, where it has one, into our errors."""
    if isinstance(place, str) and "://" in place:  # the reader names a URL without its password
        yield
        return
    name = getattr(place, "name", None)
    if isinstance(place, str | os.PathLike):
        name = str(Path(place))
    try:
        yield
    except HapfmtError as error:
        raise error.at(path=name if isinstance(name, str) else None) from error.__cause__
