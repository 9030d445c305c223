"""Any bytes opened for appending: refused, or a file that is whole afterwards and lost nothing that
a reader would have delivered."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from hapfmt.appending import open_append
from hapfmt.reader import Reader
from hapfmt.verifier import verify

from .files import LIMITS, of_file
from .mend import mend_file
from .target import Target, settled


def delivered(data: bytes) -> set[tuple[int, int, bytes]]:
    """Packets that are intact: track, first tick, bytes."""
    reader = settled(Reader, data, limits=LIMITS, scan=True)
    if reader is None:
        return set()
    ranges = dict.fromkeys(reader.catalogue.tracks, (0, 1 << 62))
    found = settled(lambda: list(reader.packets(ranges)))
    return {(packet.track, packet.start, packet.data) for packet in found or ()}


def append(data: bytes) -> None:
    handle, name = tempfile.mkstemp(suffix=".hapf")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
        opened = settled(open_append, name, sync=None)
        if opened is None:
            # Refused: then nothing was touched.
            assert Path(name).read_bytes() == data
            return
        with opened:
            assert opened.writer is not None
        after = Path(name).read_bytes()
        assert delivered(data) <= delivered(after)
        # A rule may be broken by what stood there before, but nothing is damaged.
        assert verify(after, limits=LIMITS).exit_code != 3
    finally:
        Path(name).unlink()


def of_append() -> Iterable[bytes]:
    for data in of_file():
        yield data
    yield data[: len(data) // 2]
    yield data[:-64]
    yield data + bytes(100)


APPENDED = [Target("append", append, of_append, mend_file, 1 << 12)]
