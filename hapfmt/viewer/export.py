"""One page with its files inside: it opens from any place and loads nothing."""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Sequence
from typing import BinaryIO

from ..errors import LimitError
from ..files import target
from ..format.extras import MEDIA_TYPE
from ..numbers import counted
from .bundle import page
from .server import ServedFile

PART = 3 << 18
"""Bytes that are encoded at once; a multiple of 3, so that the texts of base64 join."""
LARGEST = 380 << 20
"""Bytes of one file. Its text must fit a string of Chromium: 2^29 - 24 characters
(v8/include/v8-primitive.h)."""


def export(
    files: Sequence[ServedFile],
    place: str | os.PathLike[str] | BinaryIO,
    *,
    force: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Writes the page to a path, complete or not at all, or to a binary stream. Returns its bytes.

    Raises LimitError where a file is too large for a page, ParameterError where ``place`` exists
    and ``force`` is not given.
    """
    listed = [{"name": file.name, "inline": f"data-{i}"} for i, file in enumerate(files)]
    found = page(listed, connect=False)
    done = 0
    sizes = [size_of(file) for file in files]
    with target(place, force) as out:
        size = out.write(found.before.encode("utf-8"))
        for i, (file, length) in enumerate(zip(files, sizes, strict=True)):
            size += out.write(f'<script type="{MEDIA_TYPE};base64" id="data-{i}">'.encode("ascii"))
            with file.opened() as source:
                for start in range(0, length, PART):
                    data = source.read_at(start, min(PART, length - start))
                    size += out.write(base64.b64encode(data))
                    done += len(data)
                    if progress is not None:
                        progress(done, sum(sizes))
            size += out.write(b"</script>\n")
        size += out.write(found.after.encode("utf-8"))
    return size


def size_of(file: ServedFile) -> int:
    with file.opened() as source:
        if source.size > LARGEST:
            raise LimitError(
                f"{counted(source.size, 'byte')} are too many for one page; "
                "show the file without --export, or export a part of it (hapfmt subset)",
                path=file.name,
            )
        return source.size
