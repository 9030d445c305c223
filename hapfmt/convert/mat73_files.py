"""Reads MAT files of version 7.3: HDF5 files with attributes that say what MATLAB stored."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import LimitError
from .formats import Source
from .hdf5_files import Texts, Walk, h5py_of, opened, reader, refusal_of, rows_of, texts_of, tree_of
from .layouts import LONGEST_NAME, Path, SourceArray, SourceTree
from .mat5_files import (
    DEEPEST,
    LONGEST_TEXT,
    MOST_MATRICES,
    MOST_TEXTS,
    fold_texts,
    name_of,
    object_note,
)

_NUMBERS = {
    "double", "single", "logical", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64",
}  # fmt: skip


def tree_of_mat73(source: Source) -> SourceTree:
    """All arrays, texts and numbers of a file."""
    tree = tree_of(opened(source), Texts(source.stream), _special)
    for values in tree.groups.values():
        for key in [key for key in values if key.startswith(("MATLAB_", "H5PATH"))]:
            del values[key]
    return tree


def _special(item: Any, path: Path, tree: SourceTree, walk: Walk) -> bool:
    """Whether an object is one that MATLAB describes; it is in the tree then."""
    if path[0].startswith("#"):
        return True  # what the cells and objects refer to
    if len(path) > DEEPEST:
        raise LimitError(f"structures lie more than {DEEPEST} deep in one another")
    h5py = h5py_of()
    kind = _class_of(item)
    if "MATLAB_empty" in item.attrs:
        return True
    if "MATLAB_sparse" in item.attrs:
        walk.note(
            f"{name_of(path)} is a sparse matrix, which is not read; in MATLAB, full makes an "
            "array of it"
        )
        return True
    if kind == "function_handle":
        walk.note(f"{name_of(path)} is a function, which is not read")
        return True
    if "MATLAB_object_decode" in item.attrs:
        walk.note(object_note(name_of(path), str(kind)))
        return True
    if isinstance(item, h5py.Group):
        return False
    is_reference = h5py.check_ref_dtype(item.dtype) is h5py.Reference
    if kind == "cell" and is_reference:
        tree.groups[path] = {}
        count = _follow(item, walk, path, ())
        fold_texts(tree, path, count)
        return True
    if kind is None and is_reference:  # a field of an array of structures
        _follow(item, walk, path[:-1], path[-1:])
        return True
    if kind == "char" and item.dtype.kind == "u":
        _text(item, path, tree, walk)
        return True
    if kind in _NUMBERS and item.dtype.kind in "iuf":
        _numbers(item, path, tree, walk, is_logical=kind == "logical")
        return True
    return False


def _class_of(item: Any) -> str | None:
    """The class that MATLAB states: a text of fixed size."""
    if "MATLAB_class" not in item.attrs:
        return None
    low = item.attrs.get_id("MATLAB_class")
    if low.dtype.kind != "S" or low.shape != () or low.dtype.itemsize > LONGEST_NAME:
        return None
    return str(texts_of(item.attrs["MATLAB_class"]))


def _follow(item: Any, walk: Walk, before: Path, after: Path) -> int:
    """Read what the references of a data set lead to; returns their number."""
    count: int = prod(item.shape)
    if count > MOST_MATRICES:
        raise LimitError(f"{name_of((*before, *after))} has {count} cells")
    if not walk.is_readable(item, name_of((*before, *after))):
        return 0
    for number, reference in enumerate(np.asarray(item[()]).T.reshape(-1, order="F").tolist()):
        walk.count()
        if reference:
            path = (*before, str(number + 1), *after)
            walk.member(item.file[reference], path, len(path))
    return count


def _text(item: Any, path: Path, tree: SourceTree, walk: Walk) -> None:
    """A text, or one for each row of a matrix of characters."""
    size = prod(item.shape)
    is_short = size <= LONGEST_TEXT and walk.texts.fit(1, size * item.dtype.itemsize)
    if not is_short or item.ndim != 2 or item.shape[1] > MOST_TEXTS:
        walk.note(f"the text {name_of(path)} is too long, and is not read")
    elif walk.is_readable(item, name_of(path)):
        codec = {1: "latin-1", 2: "utf-16-le", 4: "utf-32-le"}[min(item.dtype.itemsize, 4)]
        rows = np.asarray(item[()]).T.astype(f"<u{min(item.dtype.itemsize, 4)}")
        texts = [row.tobytes().decode(codec, "replace") for row in rows]
        value = texts[0] if len(texts) == 1 else [text.rstrip() for text in texts]
        tree.groups.setdefault(path[:-1], {})[path[-1]] = walk.texts.took(value)


def _numbers(item: Any, path: Path, tree: SourceTree, walk: Walk, *, is_logical: bool) -> None:
    if prod(item.shape) == 0 or (reason := refusal_of(item)) is not None:
        if prod(item.shape):
            walk.note(f"{name_of(path)} is not read: {reason}")
        return
    # MATLAB stores the sides of its arrays in the other order.
    part = reader(item, transposed=True)

    def logical(axis: int, first: int, last: int) -> NDArray[Any]:
        return np.asarray(part(axis, first, last) != 0)

    read = logical if is_logical else part
    shape = item.shape[::-1]
    dtype = np.dtype(bool) if is_logical else item.dtype
    if prod(shape) == 1:
        value = np.asarray(read(0, 0, 1)).reshape(-1)[0].item() if shape else None
        if value is not None:
            tree.groups.setdefault(path[:-1], {})[path[-1]] = value
        return
    tree.arrays.append(SourceArray(path, shape, dtype, read, {}, rows_of(item)[::-1]))
