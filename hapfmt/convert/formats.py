"""The formats of other programs: how one is described, found and chosen.

Ours are a table below. A format of another package registers itself under the entry-point group
``hapfmt.formats``; the entry point names a :class:`Format`. Its module is imported only when a file
needs it. The module has one function, or both:

``read(source: Source, options: ReadOptions) -> Recording | Import``
    An :class:`Import` (see tables.py) describes the contents first and yields the values later,
    so that long files need little memory.
``write(recording: Recording, target: Destination, options: WriteOptions) -> Sequence[str]``
    Returns notes on what the format cannot hold.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, BinaryIO, cast

from ..errors import DataWarning, LimitError, ParameterError, unknown
from ..files import Closing
from ..spool import MEMORY, Memory

if TYPE_CHECKING:
    from fractions import Fraction

GROUP = "hapfmt.formats"
HAPF = ".hapf"
RESERVED = ("hapf",)
SNIFFED = 512
"""Bytes from the start of a file that its format is recognised by."""
TEXT_SUFFIXES = ("", ".txt", ".tsv", ".dat", ".asc")
"""A text under one of these names, or without one, is read as CSV."""

Advance = Callable[[int, int], None]
"""Called with what is done and the total, in any unit."""


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of another program.

    name
        as in ``--input-format``: "csv".
    title
        as people write it: "CSV".
    suffixes
        of its files, with the dot, in lower case.
    module
        the module with ``read``, ``write`` or both.
    reads, writes
        which of them it has.
    magic
        (offset, bytes): any of them at the start of a file makes it one of this format.
    folder
        name of a file, such as "meta/info.json", that makes the folder around it one of this
        format. Its recordings are folders then.
    options
        names of the :class:`ReadOptions` and :class:`WriteOptions` that it uses; all readers take
        ``rate``.
    """

    name: str
    title: str
    suffixes: tuple[str, ...] = ()
    module: str
    reads: bool = True
    writes: bool = False
    magic: tuple[tuple[int, bytes], ...] = ()
    folder: str = ""
    options: frozenset[str] = field(default_factory=frozenset)

    def __post_init__(self) -> None:
        texts = (self.name, self.title, self.module)
        if not all(isinstance(text, str) and text for text in texts) or self.name in RESERVED:
            raise ParameterError("a format has a name of its own, a title and a module")
        if isinstance(self.suffixes, str) or not all(
            re.fullmatch(r"(\.[^\s./\\A-Z]+)+", suffix) for suffix in self.suffixes
        ):
            raise ParameterError('suffixes are a tuple such as (".lab",), in lower case')
        if HAPF in self.suffixes:
            raise ParameterError(f"the suffix {HAPF} belongs to hapfmt")
        for at, start in self.magic:
            if not (isinstance(start, bytes) and start and 0 <= at <= SNIFFED - len(start)):
                raise ParameterError(
                    f"magic is ((offset, bytes), ...) within the first {SNIFFED} bytes"
                )
        known = {each.name for kind in (ReadOptions, WriteOptions) for each in fields(kind)}
        if odd := [name for name in self.options if name not in known]:
            raise ParameterError(unknown("option", odd[0], sorted(known)))

    @property
    def code(self) -> Any:
        """The module, imported."""
        return import_module(self.module)

    def matches(self, head: bytes) -> bool:
        return any(head[at : at + len(bytes_)] == bytes_ for at, bytes_ in self.magic)


@dataclass(frozen=True)
class ReadOptions:
    """What the caller wants of a file; None and () where nothing was said.

    rate
        ticks per second, for channels without a rate and without times. If all channels have one
        rate or share their times, it replaces that rate.
    transpose
        arrays are [samples, channels].
    select
        names or patterns of what is read: topics, data sets, streams, columns.
    clock
        the stamps that count: "header" or "log" for messages, or the name of a time array.
    episode
        number or name of one episode of several.
    map
        path of a TOML file that says where channels, times and units are.
    keep_stamps
        keep the original time stamps, as a channel of integers for each table.
    max_memory
        bytes that the values may take.
    progress
        called as the file is read.
    store
        where the samples of a whole recording are kept.
    """

    rate: Fraction | None = None
    transpose: bool | None = None
    select: tuple[str, ...] = ()
    clock: str | None = None
    episode: str | None = None
    map: str | None = None
    keep_stamps: bool = False
    max_memory: int = 4 << 30
    progress: Advance | None = None
    store: Memory = MEMORY


@dataclass(frozen=True)
class WriteOptions:
    """What the caller wants of a written file.

    schema
        "ros2" or "json" for MCAP.
    fps
        frames per second of a table that holds windows of samples.
    max_memory
        bytes that the gaps of the output may take.
    progress
        called as the file is written.
    """

    schema: str | None = None
    fps: Fraction | None = None
    max_memory: int = 1 << 30
    progress: Advance | None = None


class Source(Closing):
    """A file to be read: a path, a folder, a URL, bytes, or a binary stream.

    ``stream`` and ``path`` give the same bytes. Each is made when it is asked for, so a reader uses
    the one that its library needs.
    """

    def __init__(
        self, file: str | os.PathLike[str] | bytes | BinaryIO, max_memory: int = 4 << 30
    ) -> None:
        self._file = file
        self._max_memory = max_memory
        self._opened = ExitStack()
        self.name: str | None = getattr(file, "name", None)
        """For messages; None where there is none."""
        if isinstance(file, (str, os.PathLike)):
            self.name = os.fspath(file)
        if not isinstance(self.name, str):
            self.name = None
        self.is_url = False
        if isinstance(file, str) and ("://" in file or "::" in file):
            from ..format.source import is_url

            self.is_url = is_url(file)
        self.is_local = isinstance(file, (str, os.PathLike)) and not self.is_url
        self.is_folder = self.is_local and Path(cast(str, file)).is_dir()

    def close(self) -> None:
        self._opened.close()

    def on_close(self, call: Callable[[], object]) -> None:
        """Call this at the end, when the values have been read."""
        self._opened.callback(call)

    @property
    def suffix(self) -> str:
        """In lower case, with the dot; "" where there is none."""
        return PurePosixPath(self.name).suffix.lower() if self.name else ""

    @cached_property
    def stream(self) -> BinaryIO:
        """The bytes, seekable, at their beginning."""
        file = self._file
        if isinstance(file, (bytes, bytearray, memoryview)):
            return BytesIO(bytes(file))
        if self.is_folder:
            raise ParameterError(f"{self.name} is a folder")
        if self.is_local:
            return self._opened.enter_context(Path(cast(str, file)).open("rb"))
        if self.is_url:
            from ..format.source import spooled_url

            spooled = self._opened.enter_context(spooled_url(cast(str, file)))
            spooled.seek(0)
            return spooled
        stream = cast(BinaryIO, file)
        if stream.seekable() and stream.tell() == 0:
            return stream
        from .common import read_bytes

        data = read_bytes(stream, self._max_memory + 1)
        if len(data) > self._max_memory:
            raise LimitError(
                f"the stream is longer than the {self._max_memory} bytes allowed; allow more "
                "(max_memory=)"
            )
        return BytesIO(data)

    @cached_property
    def path(self) -> Path:
        """A file or folder with these bytes, for libraries that open files by name."""
        if self.is_local:
            return Path(cast(str, self._file))
        folder = Path(self._opened.enter_context(tempfile.TemporaryDirectory(prefix="hapfmt-")))
        path = folder / (PurePosixPath(self.name or "").name or "input")
        stream, at = self.stream, self.stream.tell()
        stream.seek(0)
        with path.open("wb") as copy:
            shutil.copyfileobj(stream, copy)
        stream.seek(at)
        return path

    @cached_property
    def head(self) -> bytes:
        """The first bytes."""
        if self.is_folder:
            return b""
        head = self.stream.read(SNIFFED)
        self.stream.seek(0)
        return head


class Destination:
    """What a writer fills: ``stream``, a binary stream, or ``path``, an empty folder for formats
    that are folders."""

    def __init__(self, stream: BinaryIO | None = None, path: Path | None = None) -> None:
        self._stream = stream
        self._path = path

    @property
    def stream(self) -> BinaryIO:
        assert self._stream is not None
        return self._stream

    @property
    def path(self) -> Path:
        assert self._path is not None
        return self._path


@cache
def formats() -> dict[str, Format]:
    """Our formats by name, then those of other packages. What cannot be used is left out with a
    warning."""
    found = {one.name: one for one in OURS}
    for point in entry_points(group=GROUP):
        if point.value.startswith("hapfmt."):
            continue  # in the metadata of an earlier version of this package
        try:
            one = point.load()
            if not isinstance(one, Format):
                raise TypeError(f"{point.value} is not a hapfmt.convert.formats.Format")
        except (Exception, SystemExit) as error:
            _warn(point, f"cannot be used: {str(error) or type(error).__name__}")
            continue
        if one.name in found:
            if one != found[one.name]:
                _warn(point, f"is not used: another format is called {one.name!r} too")
            continue
        if one not in OURS and not one.magic:
            for other in found.values():
                if both := set(one.suffixes).intersection(other.suffixes):
                    _warn(
                        point,
                        f"is used only with --input-format or --output-format {one.name}: "
                        f"{' '.join(sorted(both))} is {other.title}",
                    )
        found[one.name] = one
    return found


def _warn(point: EntryPoint, what: str) -> None:
    by = f" of {point.dist.name}" if point.dist else ""
    warnings.warn(f"the format {point.name!r}{by} {what}", DataWarning, stacklevel=3)


def read_suffixes() -> list[str]:
    """Suffixes of all formats that are read, without our own .hapf."""
    return [s for one in formats().values() if one.reads for s in one.suffixes]


def written_suffixes() -> list[str]:
    return [s for one in formats().values() if one.writes for s in one.suffixes]


def named(text: str) -> Format:
    """The format of a name or a suffix, with or without the dot."""
    name = text.lower().removeprefix(".")
    if name in formats():
        return formats()[name]
    found = with_suffix(f".{name}")
    if found is None:
        known = ", ".join(["hapf", *formats()])
        raise ParameterError(f"no format is called {text!r}; there are: {known}")
    return found


def with_suffix(suffix: str, *, written: bool = False) -> Format | None:
    """The first format with a suffix; of several that share it, one that is read, or written."""
    found = [one for one in formats().values() if suffix in one.suffixes]
    able = [one for one in found if (one.writes if written else one.reads)]
    return next(iter([*able, *found]), None)


def of_source(source: Source) -> Format | None:
    """By content, then by suffix; None: nothing that is known, or a .hapf file."""
    if source.is_folder:
        for one in formats().values():
            if one.folder and (source.path / one.folder).exists():
                return one
        markers = ", ".join(one.folder for one in formats().values() if one.folder)
        raise ParameterError(
            f"this is a folder, and holds none of the files that a recording needs: {markers}"
        )
    head = source.head
    by_content = [one for one in formats().values() if one.matches(head)]
    # Several formats share a container: the suffix decides among them.
    for one in by_content:
        if source.suffix in one.suffixes:
            return one
    if by_content:
        return by_content[0]
    found = with_suffix(source.suffix)
    if found is None and source.suffix in TEXT_SUFFIXES and head and is_text(head):
        return named("csv")
    return found


def is_text(head: bytes) -> bool:
    text = head.decode("utf-8-sig", errors="replace").rstrip("\N{REPLACEMENT CHARACTER}")
    return "\N{REPLACEMENT CHARACTER}" not in text and all(
        c.isprintable() or c in "\t\r\n" for c in text
    )


NPZ = Format(
    name="npz",
    title="NumPy archive",
    suffixes=(".npz",),
    module="hapfmt.convert.npz",
    writes=True,
    magic=((0, b"PK"),),
    options=frozenset({"transpose", "keep_stamps"}),
)
NPY = Format(
    name="npy",
    title="NumPy array",
    suffixes=(".npy",),
    module="hapfmt.convert.npy",
    writes=True,
    magic=((0, b"\x93NUMPY"),),
    options=frozenset({"transpose"}),
)
CSV = Format(
    name="csv",
    title="CSV",
    suffixes=(".csv",),
    module="hapfmt.convert.csv",
    writes=True,
    options=frozenset({"keep_stamps"}),
)
WAV = Format(
    name="wav",
    title="WAV",
    suffixes=(".wav",),
    module="hapfmt.convert.wav",
    writes=True,
    magic=((0, b"RIFF"), (0, b"RF64"), (0, b"RIFX")),
    options=frozenset({"select"}),
)
HDF5 = Format(
    name="hdf5",
    title="HDF5",
    suffixes=(".h5", ".hdf5", ".hdf"),
    module="hapfmt.convert.hdf5",
    writes=True,
    magic=((0, b"\x89HDF\r\n\x1a\n"),),
    options=frozenset({"transpose", "select", "clock", "episode", "map", "keep_stamps"}),
)
_TOPICS = frozenset({"select", "clock", "keep_stamps"})
MCAP = Format(
    name="mcap",
    title="MCAP",
    suffixes=(".mcap",),
    module="hapfmt.convert.mcap",
    writes=True,
    magic=((0, b"\x89MCAP0\r\n"),),
    options=_TOPICS | {"schema"},
)
ROSBAG = Format(
    name="rosbag",
    title="ROS 1 bag",
    suffixes=(".bag",),
    module="hapfmt.convert.rosbag",
    magic=((0, b"#ROSBAG V"),),
    options=_TOPICS,
)
ROS2 = Format(
    name="ros2",
    title="ROS 2 bag",
    suffixes=(".db3",),
    module="hapfmt.convert.rosbag",
    folder="metadata.yaml",
    options=_TOPICS,
)
FLAC = Format(
    name="flac",
    title="FLAC",
    suffixes=(".flac",),
    module="hapfmt.convert.flac",
    writes=True,
    magic=((0, b"fLaC"),),
    options=frozenset({"select"}),
)
XDF = Format(
    name="xdf",
    title="XDF",
    suffixes=(".xdf", ".xdfz"),
    module="hapfmt.convert.xdf",
    magic=((0, b"XDF:"),),
    options=frozenset({"select", "episode", "keep_stamps"}),
)
TDMS = Format(
    name="tdms",
    title="TDMS",
    suffixes=(".tdms",),
    module="hapfmt.convert.tdms",
    magic=((0, b"TDSm"),),
    options=frozenset({"select", "keep_stamps"}),
)
HJIF = Format(
    name="hjif",
    title="HJIF",
    suffixes=(".hjif",),
    module="hapfmt.convert.hjif",
    writes=True,
    options=frozenset({"select"}),
)
AHAP = Format(
    name="ahap",
    title="AHAP",
    suffixes=(".ahap",),
    module="hapfmt.convert.ahap",
    writes=True,
    options=frozenset({"select"}),
)
EDF = Format(
    name="edf",
    title="EDF",
    suffixes=(".edf",),
    module="hapfmt.convert.edf",
    writes=True,
    magic=((0, b"0       "),),
    options=frozenset({"select"}),
)
BDF = Format(
    name="bdf",
    title="BDF",
    suffixes=(".bdf",),
    module="hapfmt.convert.bdf",
    writes=True,
    magic=((0, b"\xffBIOSEMI"),),
    options=frozenset({"select"}),
)
PARQUET = Format(
    name="parquet",
    title="Parquet",
    suffixes=(".parquet", ".pq"),
    module="hapfmt.convert.parquet",
    writes=True,
    magic=((0, b"PAR1"),),
    options=frozenset({"select", "clock", "keep_stamps"}),
)
FEATHER = Format(
    name="feather",
    title="Feather",
    suffixes=(".feather", ".arrow"),
    module="hapfmt.convert.feather",
    writes=True,
    magic=((0, b"ARROW1"), (0, b"FEA1")),
    options=frozenset({"select", "clock", "keep_stamps"}),
)
MAT = Format(
    name="mat",
    title="MAT",
    suffixes=(".mat",),
    module="hapfmt.convert.mat",
    writes=True,
    magic=((124, b"\x00\x01IM"), (124, b"\x01\x00MI"), (124, b"\x00\x02IM"), (124, b"\x02\x00MI")),
    options=HDF5.options,
)
LEROBOT = Format(
    name="lerobot",
    title="LeRobot",
    module="hapfmt.convert.lerobot",
    writes=True,
    folder="meta/info.json",
    options=frozenset({"select", "clock", "episode", "keep_stamps", "fps"}),
)
OURS = (
    NPZ,
    NPY,
    CSV,
    WAV,
    MCAP,
    ROSBAG,
    ROS2,
    FLAC,
    EDF,
    BDF,
    XDF,
    TDMS,
    HJIF,
    AHAP,
    PARQUET,
    FEATHER,
    HDF5,
    MAT,
    LEROBOT,
)
"""In the order in which messages list them. They need no metadata of an installed package."""
