"""Any bytes opened for appending: refused, or a file without new damage that lost nothing that a
reader would have delivered."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import Report, verify
from hapfmt.writing.start import open_append

from .files import LIMITS, of_file
from .mend import SIZE, mend_file
from .target import Target, settled


def delivered(data: bytes) -> set[tuple[int, int, bytes]]:
    """Packets that are intact: track, first tick, bytes."""
    reader = settled(Reader, data, limits=LIMITS, scan=True)
    if reader is None:
        return set()
    ranges = dict.fromkeys(reader.catalogue.tracks, (0, 1 << 62))
    found = settled(lambda: list(reader.packets(ranges)))
    return {(packet.track, packet.start, packet.data) for packet in found or ()}


def codes_of(report: Report) -> set[str]:
    return {finding["code"] for finding in report.findings}


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
        report = verify(after, limits=LIMITS)
        # What opening does not look at, the packets by an index and the digests, stays as it is.
        assert codes_of(report) <= codes_of(verify(data, limits=LIMITS))
        if report.error is None:
            # In a file without damage a broken rule is an error; with damage it was one more.
            assert delivered(data) <= delivered(after)
    finally:
        Path(name).unlink()


def of_append() -> Iterable[bytes]:
    for data in of_file():
        yield data
    yield data[: len(data) // 2]
    yield data[: -SIZE - 32]
    yield data + bytes(100)


APPENDED = [Target("append", append, of_append, mend_file, 1 << 12)]
