"""Other files <-> Recording, by content, suffix or name; a format's module is imported only when it
is used (formats.py).

Each direction reports its omissions in plain sentences: :func:`save` returns what a format cannot
hold, and ``Recording.metadata["notes"]`` lists what :func:`read` left out.
"""

from __future__ import annotations

import errno
import os
import warnings
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import numpy as np

from ..errors import HapfmtError, ParameterError, refuse_keywords
from ..files import atomic_folder, atomic_write
from ..spool import MEMORY, Memory, release
from .formats import (
    HAPF,
    OURS,
    Advance,
    Destination,
    Format,
    ReadOptions,
    Source,
    WriteOptions,
    formats,
    named,
    of_source,
    read_suffixes,
    with_suffix,
    written_suffixes,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from ..limits import Limits
    from ..reading.reader import Band
    from ..recording import Rate, Recording, Seconds, Units
    from .tables import Import, ImportBlock


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
_MALFORMED = {None, errno.EINVAL, errno.EOVERFLOW}
"""Numbers of an OSError that a library raises, or a position that no file can have."""
_ABSENT = {errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG}
FOREIGN = frozenset(f".{suffix}" for suffix in _OTHERS.split())
"""Suffixes of other formats: no .hapf file is written under them."""


def refuse_foreign(path: str | os.PathLike[str]) -> None:
    """ParameterError where the suffix of a .hapf file to be written is that of another format."""
    suffix = Path(path).suffix.lower()
    if suffix in written_suffixes():
        way = f"hapfmt convert and hapfmt.save write {suffix}"
        raise ParameterError(f"hapf files end in .hapf; {way}", path=os.fspath(path))
    if suffix in FOREIGN:
        raise ParameterError(
            f"hapf files end in .hapf; {suffix} is another format's", path=os.fspath(path)
        )


def read(
    file: str | os.PathLike[str] | bytes | BinaryIO,
    channels: Sequence[str | int] | str | int | None = None,
    start: Seconds | None = None,
    stop: Seconds | None = None,
    *,
    format: str | None = None,
    rate: Rate | None = None,
    transpose: bool | None = None,
    select: str | Sequence[str] | None = None,
    clock: str | None = None,
    episode: int | str | None = None,
    map: str | os.PathLike[str] | None = None,
    keep_stamps: bool = False,
    band: Band = "full",
    exact: bool = True,
    limits: Limits | None = None,
    threads: int | None = None,
    max_memory: int | None = None,
    progress: Advance | None = None,
    **others: Any,
) -> Recording:
    """The recording in a file of any format: .hapf, and those that ``hapfmt info --formats``
    lists.

    ``file`` is a path, a URL (extra "remote"), bytes, or a binary stream. ``format`` names its
    format. Without it the first bytes decide, and then the suffix. ``channels`` are labels or
    numbers, ``start`` and ``stop`` seconds: samples with start <= time < stop are read.

    Other formats than .hapf: ``rate`` in Hz (1000, 35.618 or "44100/7") is for channels without a
    rate and without times. If all channels have one rate or share their times, it replaces that
    rate, and a note says so. ``transpose`` is for arrays that are [samples, channels].
    ``metadata["notes"]`` lists everything that was not converted. ``select`` names topics, data
    sets, streams or columns, or patterns of them; only these are read. ``clock`` chooses among
    several times, such as "header" or "log" for messages. ``episode`` is the number of one episode
    of several. ``map`` is a TOML file that says where channels and times are. ``keep_stamps`` keeps
    the original time stamps as channels, in ns from their ticks.

    .hapf: ``band`` is "full", "lf" or "hf"; ``exact`` False leaves the float64 corrections out; any
    damage raises (:class:`hapfmt.Reader` goes on).

    Raises ParameterError for other formats that are malformed, FormatError for .hapf;
    UnknownChannelError; LimitError above ``max_memory`` bytes or the ``limits``; MissingExtraError;
    OSError.
    """
    from ..limits import Limits
    from .tables import Import

    refuse_keywords(others, read)
    if start is not None or stop is not None:
        from ..recording import check_seconds

        check_seconds(start, stop)
    if max_memory is not None:
        if limits is not None:
            raise ParameterError("give limits or max_memory, not both")
        limits = Limits(memory=max_memory)
    given = {
        "rate": rate, "transpose": transpose, "select": select, "clock": clock,
        "episode": episode, "map": map, "keep_stamps": keep_stamps or None,
    }  # fmt: skip
    with _named(file), _source(file, limits) as source:
        chosen = _format_of(source, format)
        if chosen is None:
            return _hapf(
                file, source, given, channels, start, stop, band=band, exact=exact, limits=limits,
                threads=threads,
            )  # fmt: skip
        if band != "full":
            raise ParameterError(f"a {chosen.title} file has no bands")
        if not exact:
            raise ParameterError(f"exact is for .hapf files; {chosen.title} has no corrections")
        options = _options(chosen, given, limits, progress)
        found = _found(chosen, source, options)
        recording = (
            found.recording(options.max_memory, progress) if isinstance(found, Import) else found
        )
        if channels is None and start is None and stop is None:
            return recording
        return recording.sel(channels, start, stop)


@contextmanager
def imported(
    file: str | os.PathLike[str] | bytes | BinaryIO,
    *,
    format: str | None = None,
    limits: Limits | None = None,
    progress: Advance | None = None,
    **given: Any,
) -> Iterator[tuple[Format, Import]]:
    """What :func:`read` would read of a file of another format, before its values are read: its
    tables, and their values in blocks. ``given`` are the arguments of :func:`read`."""
    from .tables import Import, import_of

    with opened(file, format=format, limits=limits, progress=progress, **given) as (
        chosen,
        found,
        _,
    ):
        if chosen is None:
            raise ParameterError("this is a .hapf file: hapfmt info shows what it holds")
        yield chosen, found if isinstance(found, Import) else import_of(found)


@contextmanager
def opened(
    file: str | os.PathLike[str] | bytes | BinaryIO,
    *,
    format: str | None = None,
    limits: Limits | None = None,
    progress: Advance | None = None,
    store: Memory = MEMORY,
    **given: Any,
) -> Iterator[tuple[Format | None, Recording | Import, ReadOptions]]:
    """The same as its reader gives it, which may be a Recording, and the options for it. A .hapf
    file is read whole, and its format is None. ``store``: where the samples are kept."""
    with _named(file), _source(file, limits) as source:
        chosen = _format_of(source, format)
        if chosen is None:
            yield None, _hapf(file, source, given, limits=limits), ReadOptions()
            return
        options = replace(_options(chosen, given, limits, progress), store=store)
        yield chosen, _found(chosen, source, options), options


def _hapf(file: Any, source: Source, given: dict[str, Any], *parts: Any, **more: Any) -> Recording:
    """A .hapf file, which takes none of the options ``given``."""
    from ..format.source import source_of
    from ..reading.reader import read as read_hapf

    if named_options := [name for name, value in given.items() if value is not None]:
        raise ParameterError(
            "a .hapf file holds its own rate; rate and transpose are for other formats"
            if named_options[0] in ("rate", "transpose")
            else f"{named_options[0]} is for other formats than .hapf"
        )
    if source.is_local and not source.is_folder:
        # It was opened to look at its first bytes.
        return read_hapf(source_of(source.stream, source.name, owned=False), *parts, **more)
    return read_hapf(file if source.is_folder or source.is_url else source.stream, *parts, **more)


def _found(chosen: Format, source: Source, options: ReadOptions) -> Recording | Import:
    """What the format's reader says of the file."""
    from ..recording import Recording
    from .tables import Import

    with _plug_in(chosen), _reading(chosen, source):
        found = _code(chosen, "read").read(source, options)
        if isinstance(found, Import):
            return replace(found, blocks=_guarded(chosen, found, source))
        if not isinstance(found, Recording):
            raise TypeError(f"read returned {type(found).__name__}, not a Recording or an Import")
    if options.select and "select" not in chosen.options:
        from .common import without_units

        kept = found.sel(list(options.select))  # there is nothing else to choose from
        return without_units(kept, {*found.labels} - {*kept.labels})
    return found


def _guarded(chosen: Format, found: Import, source: Source) -> Callable[[], Iterator[ImportBlock]]:
    """The blocks of a file; those of a plug-in are checked against its tables."""

    def blocks() -> Iterator[ImportBlock]:
        from .tables import ImportBlock

        with _plug_in(chosen), _reading(chosen, source):
            if chosen in OURS:
                yield from found.blocks()
                return
            for number, first, values in found.blocks():
                table = found.tables[number]
                rows = {len(each) for each in values}
                if len(values) != len(table.columns) or len(rows) > 1:
                    raise ValueError(f"a block of table {table.name!r} does not fit its columns")
                if first + max(rows, default=0) > table.row_count:
                    raise ValueError(f"table {table.name!r} has more than {table.row_count} rows")
                dtypes = [column.dtype for column in table.columns]
                yield ImportBlock(number, first, list(map(_as_stated, values, dtypes)))

    return blocks


def _as_stated(values: Any, dtype: Any) -> Any:
    if values.dtype != dtype:
        raise TypeError(f"a block holds {values.dtype}, its column says {dtype}")
    return values


@contextmanager
def _reading(chosen: Format, source: Source) -> Iterator[None]:
    """An OSError that a malformed file causes is a ParameterError; one of the system names the
    file."""
    try:
        yield
    except OSError as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        if error.errno in _MALFORMED:
            raise ParameterError(f"this {chosen.title} file is malformed: {reason}") from error
        if source.is_folder and error.errno in _ABSENT and source.path.exists():
            raise ParameterError(f"this {chosen.title} folder lacks a file: {reason}") from error
        if error.filename is None and source.name is not None:
            error.filename = source.name
        raise


@contextmanager
def _plug_in(chosen: Format) -> Iterator[None]:
    """What fails in a plug-in is one of our errors."""
    if chosen in OURS:
        yield
        return
    try:
        yield
    except (HapfmtError, OSError):
        raise
    except Exception as error:
        reason = str(error).partition("\n")[0]
        raise ParameterError(
            f"the plug-in for {chosen.title} files failed: {type(error).__name__}: {reason}"
        ) from error


def _source(file: Any, limits: Limits | None) -> Source:
    if not isinstance(file, (str, os.PathLike, bytes, bytearray, memoryview)) and not hasattr(
        file, "read"
    ):
        raise ParameterError(
            f"hapfmt.read takes a path, a URL, bytes or a binary stream, not "
            f"{type(file).__name__}; hapfmt.write writes an array or a table to a file, "
            "hapfmt.Recording.from_array makes a recording of it"
        )
    return Source(file, (limits.memory if limits else None) or READ_MEMORY)


def _options(
    chosen: Format, given: dict[str, Any], limits: Limits | None, progress: Advance | None
) -> ReadOptions:
    """The options of a reader; ParameterError for one that it does not use."""
    from .common import rate_from

    known = {name: value for name, value in given.items() if value is not None}
    for name in known:
        if name not in ("rate", "select", *chosen.options):
            users = ", ".join(one.title for one in formats().values() if name in one.options)
            raise ParameterError(
                f"{chosen.title} files do not use {name}; it is for: {users or 'no format'}"
            )
    if "rate" in known:
        known["rate"] = rate_from(known["rate"])
    if isinstance(known.get("select"), str):
        known["select"] = [known["select"]]
    if "select" in known:
        known["select"] = tuple(known["select"])
    for name in ("episode", "map"):
        if name in known:
            known[name] = str(known[name])
    room = (limits.memory if limits else None) or READ_MEMORY
    return ReadOptions(**known, max_memory=room, progress=progress)


def _code(chosen: Format, way: str) -> Any:
    """The module of a format that reads, or writes."""
    if not (chosen.reads if way == "read" else chosen.writes):
        raise ParameterError(f"hapfmt does not {way} {chosen.title} files")
    return chosen.code


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


def _format_of(source: Source, format: str | None) -> Format | None:
    """None: a .hapf file."""
    if format is not None:
        return None if format.lower().removeprefix(".") == "hapf" else named(format)
    if source.is_url and source.suffix not in read_suffixes():
        return None  # it is read in parts, not fetched
    if not source.is_folder and source.head.startswith(MAGIC):
        return None
    found = of_source(source)
    if found is None and source.suffix in FOREIGN:
        known = " ".join([HAPF, *read_suffixes()])
        way = _LOADERS.get(source.suffix)
        hint = f"; load its arrays with {way}, then call hapfmt.write(array, ...)" if way else ""
        raise ParameterError(f"the suffix {source.suffix!r} is not one of: {known}{hint}")
    return found  # where it is None, the reader of .hapf says what is wrong


def format_of(file: str, format: str | None = None) -> Format | None:
    """Return the format of a file by its content and suffix; None: a .hapf file."""
    with _named(file), _source(file, None) as source:
        return _format_of(source, format)


MAGIC = b"\x8fHAP"
_LOADERS = {
    ".xls": "pandas.read_excel",
    ".xlsx": "pandas.read_excel",
}
"""Suffixes of formats that hapfmt does not read, and what reads them."""


def save(
    recording: Any,
    target: str | os.PathLike[str] | BinaryIO,
    *,
    rate: Rate | None = None,
    labels: str | Sequence[str] | None = None,
    units: Units | None = None,
    transpose: bool | None = None,
    format: str | None = None,
    schema: str | None = None,
    fps: Rate | None = None,
    force: bool = False,
    max_memory: int | None = None,
    progress: Advance | None = None,
) -> tuple[str, ...]:
    """Write a recording in another format to a file (whole or not at all) or a stream.

    ``recording`` is a Recording, or an array or a table with ``rate``, ``labels``, ``units`` and
    ``transpose``, as for :func:`hapfmt.write`.

    ``schema`` is "ros2" or "json", for MCAP. ``fps`` is for LeRobot: frames per second, each with a
    window of the samples.

    These formats store gaps as NaN or empty cells, which may take ``max_memory`` bytes (1 GiB by
    default). Returns notes on everything that the format could not hold. Raises ParameterError if
    the file exists (unless ``force``) or the format cannot hold the samples; LimitError for larger
    gaps; MissingExtraError; OSError.
    """
    from ..recording import recording_of

    max_memory = MAX_MEMORY if max_memory is None else max_memory
    path = Path(target) if isinstance(target, str | os.PathLike) else None
    recording = recording_of(recording, rate, labels=labels, units=units, transpose=transpose)
    given: dict[str, Any] = {"schema": schema, "fps": fps}
    with _named(target):
        chosen = _written(path, format)
        known = {name: value for name, value in given.items() if value is not None}
        for name in known:
            if name not in chosen.options:
                raise ParameterError(f"{chosen.title} files do not use {name}")
        if "fps" in known:
            from .common import rate_from

            known["fps"] = rate_from(known["fps"])
        options = WriteOptions(**known, max_memory=max_memory, progress=progress)
        with _plug_in(chosen):
            write = _code(chosen, "write").write
            if chosen.folder:
                if path is None:
                    raise ParameterError(f"{chosen.title} is a folder, and needs a path")
                if path.is_dir() and any(path.iterdir()) and not (path / chosen.folder).exists():
                    raise ParameterError(
                        f"the folder holds other files than {chosen.title}, and is not replaced"
                    )
                with atomic_folder(path, force=force) as folder:
                    notes = write(recording, Destination(path=folder), options)
            elif path is None:
                notes = write(recording, Destination(cast(BinaryIO, target)), options)
            else:
                with atomic_write(path, force=force) as stream:
                    notes = write(recording, Destination(stream), options)
    nans = [c.label or str(i) for i, c in enumerate(recording.channels) if _has_nan(c.stored)]
    more = [f"NaN values of {', '.join(nans)} cannot be told from gaps there"] if nans else []
    made = [c.label or str(i) for i, c in enumerate(recording.channels) if c.synthetic]
    if made:
        more.append(f"the texture of {', '.join(made)} is synthetic, which the file does not tell")
    return (*notes, *more)


def _has_nan(x: NDArray[Any]) -> bool:
    found = x.dtype.kind == "f" and bool(np.isnan(x).any())
    release()
    return found


def _written(path: Path | None, format: str | None) -> Format:
    """The format of a file to be written."""
    if format is not None:
        return named(format)
    if path is None:
        known = " ".join(written_suffixes())
        raise ParameterError(f"a stream has no suffix; give its format: {known}")
    if path.suffix.lower() == HAPF:
        call = f"hapfmt.write(recording, {str(path)!r})"
        raise ParameterError(f"hapfmt encode writes .hapf files; in Python, {call} does")
    found = with_suffix(path.suffix.lower(), written=True)
    if found is None:
        known = " ".join(written_suffixes())
        raise ParameterError(f"the suffix {path.suffix!r} is not one of: {known}")
    return found


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
