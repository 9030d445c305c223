"""What is added to a file without touching what stands in it: in place, or in a copy."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from ..writing.appending import open_append
from ..writing.filewriter import FileWriter
from ..errors import ParameterError
from ..reading.catalogue import Catalogue
from .making import Output, opened, refuse_output
from .original import Input, Original

PIECE = 1 << 20
"""Bytes copied in one go."""


class Growing(NamedTuple):
    """A writer that stands at the end of what ``catalogue`` knows; ``note``: what was cut off the
    end of the file before."""

    writer: FileWriter
    catalogue: Catalogue
    note: str | None


@contextmanager
def appended(file: Input, out: Output | None, *, force: bool) -> Iterator[Growing]:
    """A file that is appended to at the end of the block; ``out`` None: in place, under its lock.

    Raises ParameterError where another program writes the file, or it is damaged before its end.
    """
    if out is None:
        if not isinstance(file, (str, os.PathLike)):
            raise ParameterError("a pipe cannot be changed in place: give an output file")
        with open_append(file) as appending:
            yield Growing(appending.writer, appending.catalogue, appending.note)
        return
    refuse_output(out, force)
    with Original(file) as original, opened(out, force) as stream:
        source = original.source
        for offset in range(0, source.size, PIECE):
            stream.write(source.read_at(offset, PIECE))
        writer = FileWriter.resume(stream, original.catalogue)
        yield Growing(writer, original.catalogue, None)
        writer.close()
