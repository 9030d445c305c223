"""Opens HDF5 files through h5py, and lists the arrays, texts and attributes in them.

Only what lies in the file itself is read: no external link, external file or virtual data set. A
data set is refused where its chunks or its compression could take more memory than it declares.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import isfinite, prod
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import HapfmtError, LimitError, MissingExtraError, ParameterError
from ..numbers import counted
from .formats import Source
from .layouts import LONGEST_NAME, Path, SourceArray, SourceTree

MOST_OBJECTS = 20_000
"""Groups and data sets of a file."""
DEEPEST = 32
MOST_TEXTS = 4096
"""Entries of an attribute or a data set of texts."""
TEXTS_SIZE = 64 << 20
"""Bytes of the texts that are read at once."""
ALL_TEXTS_SIZE = 256 << 20
"""Characters of all texts, but for those of our own layout."""
LONGEST_TEXT = 1 << 20
"""Bytes of a text that is kept, but for those of our own layout."""
HEAP = b"GCOL\x01"
SMALLEST_HEAP = 4096
MOST_HEAP_ENTRIES = 4_000_000
CHUNK_SIZE = 256 << 20
"""Bytes of the largest chunk: it is read whole."""
CACHE_SIZE = 32 << 20
DEFLATE_RATIO = 1032
"""Bytes that a byte of deflate can become."""
FILLED_RATIO = 4096
"""Largest ratio of the declared size of a data set to its stored size. Above it, most values are
fill values."""
SMALL = 64 << 20
_FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 4: "szip", 32000: "lzf"}


def h5py_of() -> Any:
    try:
        import h5py
    except ImportError:
        raise MissingExtraError("h5py", "hdf5") from None
    return h5py


@contextmanager
def refusing_hdf5(what: str) -> Iterator[None]:
    """Turn the exceptions of h5py into ParameterError; those of the system stay."""
    try:
        yield
    except HapfmtError:
        raise
    except OSError as error:
        if error.errno is not None and not str(error).startswith(("Can't", "Unable")):
            raise
        raise ParameterError(f"{what}: {_reason(error)}") from error
    except (
        ValueError, TypeError, ArithmeticError, LookupError, RuntimeError, EOFError, MemoryError,
        SystemError, AttributeError,
    ) as error:  # fmt: skip
        raise ParameterError(f"{what}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    if cut := re.search(r"truncated file: eof = (\d+), .*stored_eof = (\d+)", str(error)):
        return f"it is cut off: {cut[1]} of {cut[2]} bytes are there; copy it once more"
    return (str(error).partition("\n")[0] or type(error).__name__)[:300]


def opened(source: Source) -> Any:
    """The h5py.File, open as long as the source."""
    h5py = h5py_of()
    stream = source.stream  # raises what the system says
    where: Any = source.path if source.is_local else stream
    with refusing_hdf5("this HDF5 file cannot be opened"):
        file = h5py.File(where, "r", locking="best-effort", rdcc_nbytes=CACHE_SIZE)

    def close() -> None:
        with refusing_hdf5("this HDF5 file cannot be closed"):
            file.close()

    source.on_close(close)
    return file


class Texts:
    """Reads texts of any length in bounded memory and time.

    h5py reads all texts of an attribute at once. Several may be one long text in the file, so the
    longest text in the file bounds each. Texts lie in heaps, which are found by their signature.
    The heaps are checked first: HDF5 never leaves an entry of size 0.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._longest: int | None = None
        self._left = ALL_TEXTS_SIZE

    def fit(self, count: int, size: int | None = None) -> bool:
        """Whether texts may be read. ``size``: bytes of each, if that is known."""
        if size is None:
            try:
                size = self.longest
            except ParameterError:
                return False
        return self._left > 0 and count <= MOST_TEXTS and count * size <= TEXTS_SIZE

    def took(self, value: Any) -> Any:
        """Count the bytes that were read: a text may be in memory often, and in the file once."""
        self._left -= sum(map(len, value)) if isinstance(value, list) else len(value)
        return value

    @property
    def longest(self) -> int:
        """Bytes of the longest text. ParameterError where a heap is damaged."""
        if self._longest is None:
            self._longest = self._longest_of(self._heaps())
            self._stream.seek(0)
        if self._longest < 0:
            raise ParameterError("the texts of the file are damaged, or too many")
        return self._longest

    def _heaps(self) -> list[tuple[int, int]]:
        """Place and size of each heap; without those that HDF5 refuses by their size."""
        end = self._stream.seek(0, 2)
        self._stream.seek(0)
        found: list[tuple[int, int]] = []
        start, tail = 0, b""
        while block := self._stream.read(1 << 20):
            data = tail + block
            at = data.find(HEAP)
            while at >= 0 and len(data) >= at + 16 and len(found) < MOST_HEAP_ENTRIES:
                size = int.from_bytes(data[at + 8 : at + 16], "little")
                if SMALLEST_HEAP <= size <= end - start - at:
                    found.append((start + at, size))
                at = data.find(HEAP, at + 1)
            tail = data[-15:]
            start += len(data) - len(tail)
        return sorted(set(found))

    def _longest_of(self, heaps: list[tuple[int, int]]) -> int:
        """-1 where a heap is damaged."""
        longest, entries = 0, 0
        for place, size in heaps:
            at = 16
            while at + 16 <= size:
                entries += 1
                self._stream.seek(place + at)
                head = self._stream.read(16)
                length = int.from_bytes(head[8:], "little")
                if head[:2] != b"\0\0":
                    longest = max(longest, length)
                    length = 16 + -(-length // 8) * 8
                if length < 8 or at + length > size or entries > MOST_HEAP_ENTRIES:
                    return -1
                at += length
        return longest


def tree_of(
    file: Any,
    texts: Texts,
    special: Callable[[Any, Path, SourceTree, Walk], bool] | None = None,
) -> SourceTree:
    """All arrays, and what the groups say of themselves.

    ``special(object, path, tree, walk)``: whether it took the data set or group itself.
    """
    walk = Walk(texts, special)
    with refusing_hdf5("this HDF5 file cannot be read"):
        walk.is_new(file)
        walk.group(file, (), 0)
    return walk.tree


class Walk:
    def __init__(
        self,
        texts: Texts,
        special: Callable[[Any, Path, SourceTree, Walk], bool] | None = None,
    ) -> None:
        self.tree = SourceTree()
        self.texts = texts
        self._special = special
        self._seen: set[tuple[int, int]] = set()
        self._count = 0

    def note(self, text: str) -> None:
        self.tree.note(text)

    def group(self, group: Any, path: Path, depth: int) -> None:
        h5py = h5py_of()
        if depth > DEEPEST:
            raise LimitError(f"groups lie more than {DEEPEST} deep in one another")
        self.tree.groups[path] = self.attributes(group, path)
        if len(group) > MOST_OBJECTS:
            raise LimitError(f"a group has {len(group)} members, more than {MOST_OBJECTS}")
        for name in group:
            self.count()
            inner = (*path, _name(name))
            if len(inner[-1]) > LONGEST_NAME:
                raise LimitError(
                    f"a name has {len(inner[-1])} characters, more than {LONGEST_NAME}"
                )
            shown = "/" + "/".join(inner)
            link = group.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                self.note(f"{shown} is a link to another file, which is not read")
            elif isinstance(link, h5py.SoftLink):
                self.note(f"{shown} is a link to {str(link.path)[:200]}, which is read there")
            else:
                self.member(group[name], inner, depth)

    def count(self) -> None:
        self._count += 1
        if self._count > MOST_OBJECTS:
            raise LimitError(f"the file has more than {MOST_OBJECTS} groups and data sets")

    def is_new(self, item: Any) -> bool:
        """False the second time that an object is met: hard links may form a circle."""
        info = h5py_of().h5o.get_info(item.id)
        key = (info.fileno, info.addr)
        known = key in self._seen
        self._seen.add(key)
        return not known

    def member(self, item: Any, path: Path, depth: int) -> None:
        h5py = h5py_of()
        shown = "/" + "/".join(path)
        if not isinstance(item, (h5py.Group, h5py.Dataset)):
            return
        if not self.is_new(item):
            self.note(f"{shown} is another name of an object, which is read once")
        elif self._special is not None and self._special(item, path, self.tree, self):
            return
        elif isinstance(item, h5py.Group):
            self.group(item, path, depth + 1)
        else:
            self.dataset(item, path)

    def dataset(self, item: Any, path: Path) -> None:
        shown = "/" + "/".join(path)
        try:
            dtype, shape = item.dtype, item.shape
        except (TypeError, ValueError, KeyError, RuntimeError) as error:
            self.note(f"{shown} has a type that is not read ({_reason(error)})")
            return
        if shape is None or prod(shape) == 0:
            self.note(f"{shown} is empty")
            return
        if (text := self.text(item, path, dtype, shape)) is not None:
            if text != "":
                self.tree.groups.setdefault(path[:-1], {})[path[-1]] = text
            return
        attributes = self.attributes(item, path)
        if dtype.names is None:
            if dtype.kind not in "biuf":
                self.note(f"{shown} is not read: it holds {_kind_of(dtype)}")
                return
            array = SourceArray(path, shape, dtype, reader(item), attributes, rows_of(item))
            if prod(shape) == 1:
                self.scalar(item, path, dtype)
            elif self.is_readable(item, shown):
                self.tree.arrays.append(array)
            return
        if not self.is_readable(item, shown):
            return
        self.tree.groups[path] = attributes
        for names, inner in fields_of_dtype(dtype):
            base, sub = (inner.base, inner.shape) if inner.subdtype else (inner, ())
            place = (*path, *map(_name, names))
            if base.kind not in "biuf":
                self.note(f"{'/' + '/'.join(place)} is not read: it holds {_kind_of(base)}")
                continue
            self.count()
            self.tree.arrays.append(
                SourceArray(
                    place,
                    (*shape, *sub),
                    base,
                    reader(item, names),
                    {},
                    rows_of(item, len(sub)),
                    ".".join(place[len(path) :]),
                )
            )

    def scalar(self, item: Any, path: Path, dtype: np.dtype[Any]) -> None:
        """A single number describes its group."""
        if not self.is_readable(item, "/" + "/".join(path)) or dtype.itemsize > 8:
            return
        value = np.asarray(item[()]).reshape(-1)[0].item()
        self.tree.groups.setdefault(path[:-1], {})[path[-1]] = value

    def text(self, item: Any, path: Path, dtype: np.dtype[Any], shape: tuple[int, ...]) -> Any:
        """A text or a list of texts; "" where they are too long, None for other types."""
        h5py = h5py_of()
        is_vlen = h5py.check_string_dtype(dtype) is not None and dtype.kind == "O"
        if not is_vlen and dtype.kind != "S":
            return None
        shown = "/" + "/".join(path)
        count = prod(shape)
        fits = self.texts.fit(count, None if is_vlen else dtype.itemsize)
        if not fits or not self.is_readable(item, shown):
            self.note(f"the texts of {shown} are not read: they are too many or too long")
            return ""
        return self.texts.took(texts_of(item[()]))

    def is_readable(self, item: Any, shown: str) -> bool:
        """Whether reading takes no more memory than the data set declares; a note where not."""
        reason = refusal_of(item)
        if reason is not None:
            self.note(f"{shown} is not read: {reason}")
        return reason is None

    def attributes(self, item: Any, path: Path) -> dict[str, Any]:
        h5py = h5py_of()
        found: dict[str, Any] = {}
        if len(item.attrs) > MOST_TEXTS:
            self.note(f"the attributes of {'/' + '/'.join(path)} are too many, and are not read")
            return found
        for name in item.attrs:
            try:
                low = item.attrs.get_id(name)
                dtype, shape = low.dtype, low.shape
                if shape is None or prod(shape) == 0 or prod(shape) > MOST_TEXTS:
                    continue
                if dtype.kind == "O":
                    is_text = h5py.check_string_dtype(dtype) is not None
                    if not is_text:
                        continue
                    if not self.texts.fit(prod(shape)):
                        self.note(
                            f"attribute {name!r} of /{'/'.join(path)} is not read: its texts are "
                            "damaged or too long"
                        )
                        continue
                elif dtype.kind not in "biufS" or dtype.itemsize > LONGEST_TEXT:
                    continue
                value = plain_of(item.attrs[name])
                if dtype.kind == "O":
                    self.texts.took(value)
            except (OSError, TypeError, ValueError, KeyError, RuntimeError, UnicodeError):
                self.note(f"attribute {name!r} of /{'/'.join(path)} cannot be read")
                continue
            if value is not None:
                found[_name(name)] = value
        return found


def refusal_of(item: Any, *, sparse: bool = False) -> str | None:
    """Why a data set is not read; None where it can be. ``sparse``: most of it may be gaps."""
    h5py = h5py_of()
    properties = item.id.get_create_plist()
    size = prod(item.shape) * item.dtype.itemsize
    if item.is_virtual:
        return "it is a virtual data set, whose values lie elsewhere"
    if properties.get_external_count():
        return "its values lie in another file"
    filters = [properties.get_filter(place) for place in range(properties.get_nfilters())]
    codes = [code for code, *_ in filters]
    for code, *_, name in filters:
        if code not in _FILTERS:
            called = name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
            return (
                f"it is compressed by {called or 'a filter'} (HDF5 filter {code}), which h5py does "
                "not have; h5repack -f GZIP=4 rewrites the file"
            )
        if not h5py.h5z.filter_avail(code):
            return f"it is compressed by {_FILTERS[code]}, which this h5py does not have"
    if len(set(codes)) < len(codes):
        return "it is compressed twice"
    stored = item.id.get_storage_size()
    if not sparse and size > SMALL + FILLED_RATIO * stored:
        return f"{counted(size, 'byte')} are declared, {stored} are stored: the rest is fill values"
    if item.chunks is not None:
        chunk = prod(item.chunks) * item.dtype.itemsize
        if chunk > CHUNK_SIZE:
            return f"its chunks have {chunk} bytes, more than {CHUNK_SIZE}"
        if codes and _may_burst(item, chunk, is_gzip=1 in codes):
            return "a chunk is longer than it declares"
    return None


def _may_burst(item: Any, chunk: int, *, is_gzip: bool) -> bool:
    """Whether a chunk is longer than it declares, or unpacks to more. HDF5 would take any memory
    for it.

    Only chunks of gzip that could take much are unpacked here, piece by piece.
    """
    found = False

    def look(info: Any) -> bool | None:
        nonlocal found
        if info.size > chunk + chunk // 8 + 1024:  # as no filter leaves it
            found = True
            return True
        if is_gzip and info.size * DEFLATE_RATIO > max(SMALL, 2 * chunk) and info.filter_mask == 0:
            _, data = item.id.read_direct_chunk(info.chunk_offset)
            limit = chunk + 64
            unpack = zlib.decompressobj()
            done = 0
            try:
                while data and not unpack.eof:
                    done += len(unpack.decompress(data, 1 << 20))
                    data = unpack.unconsumed_tail
                    if done > limit:
                        found = True
                        return True
            except zlib.error:
                pass  # HDF5 says so when it reads the chunk
        return None

    item.id.chunk_iter(look)
    return found


def rows_of(item: Any, more: int = 0) -> tuple[int, ...]:
    return () if item.chunks is None else (*item.chunks, *([1] * more))


def reader(
    item: Any, names: Sequence[str] = (), *, transposed: bool = False
) -> Callable[[int, int, int], NDArray[Any]]:
    """A function that reads a part of a data set along one axis."""

    def part(axis: int, first: int, last: int) -> NDArray[Any]:
        shown = item.name
        with refusing_hdf5(f"{shown} cannot be read"):
            if transposed:
                axis = item.ndim - 1 - axis
            cut = slice(first, last)
            if axis >= item.ndim:  # within the field of a compound
                whole = item.fields(names[0])[()]
                for name in names[1:]:
                    whole = whole[name]
                return np.asarray(whole[(*[slice(None)] * axis, cut)])
            where = tuple([slice(None)] * axis + [cut])
            if not names:
                found = np.asarray(item[where])
                return found.T if transposed else found
            found = item.fields(names[0])[where]
            for name in names[1:]:
                found = found[name]
            return np.asarray(found)

    return part


def fields_of_dtype(
    dtype: np.dtype[Any], before: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], np.dtype[Any]]]:
    """The plain fields of a compound type, those of compounds within it too."""
    if len(before) >= 4:
        return
    for name in dtype.names or ():
        inner = dtype[name]
        if inner.names is not None:
            yield from fields_of_dtype(inner, (*before, name))
        else:
            yield (*before, name), inner


def _kind_of(dtype: np.dtype[Any]) -> str:
    h5py = h5py_of()
    if h5py.check_ref_dtype(dtype) is not None:
        return "references"
    if h5py.check_vlen_dtype(dtype) is not None:
        return "rows of different lengths"
    if dtype.kind == "c":
        return "complex numbers"
    return f"{dtype} values" if dtype.kind != "V" else "opaque bytes"


def _name(name: Any) -> str:
    text = name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
    return text.encode("utf-8", "replace").decode("utf-8")


def plain_of(value: Any) -> Any:
    """A number, a text or a list of them; None for anything else."""
    if isinstance(value, (bytes, str)) or (
        isinstance(value, np.ndarray) and value.dtype.kind in "OSU"
    ):
        return texts_of(value)
    array = np.asarray(value)
    if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8:
        return None
    if array.size == 1:
        number = array.reshape(-1)[0].item()
        if array.dtype.kind == "f" and array.dtype.itemsize < 8 and isfinite(number):
            return float(str(array.reshape(-1)[0]))  # its shortest decimal
        return number
    return array.reshape(-1).tolist() if array.size <= MOST_TEXTS else None


def texts_of(value: Any) -> Any:
    if isinstance(value, bytes):
        return _name(value.rstrip(b"\0"))
    if isinstance(value, str):
        return _name(value)
    if isinstance(value, np.ndarray):
        found = [texts_of(each) for each in value.reshape(-1).tolist()]
        return found[0] if value.ndim == 0 else found
    return None
