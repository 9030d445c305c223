"""Any bytes recovered: refused, or an intact file with every packet that a reader delivers and that
decodes."""

from __future__ import annotations

import io

from hapfmt.edit.recover import recover
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

from .files import LIMITS, of_file
from .mend import mend_file
from .target import Target, settled


def kept(data: bytes) -> set[bytes]:
    """Numbers that are delivered: track, first tick, bits."""
    reader = settled(Reader, data, limits=LIMITS, scan=True)
    if reader is None:
        return set()
    known = reader.catalogue.tracks
    # A residual without its base has no channel.
    tracks = [
        t for t in known.values() if t.kind != "events" and (t.base is None or t.base in known)
    ]
    found = set()
    pieces = settled(lambda: list(reader.pieces(tracks, exact=True))) or []
    for piece in pieces:
        found.add(f"{piece.start} {len(piece.numbers)} ".encode() + piece.numbers.tobytes())
    return found


def recovered(data: bytes) -> None:
    out = io.BytesIO()
    done = settled(recover, data, out, canonical=7, limits=LIMITS)
    if done is None:
        return
    report = verify(out.getvalue(), limits=LIMITS)
    assert report.verdict in ("intact", "unsupported"), report
    if report.verdict == "intact":
        assert kept(data) <= kept(out.getvalue())


RECOVERED = [Target("recovered", recovered, of_file, mend_file, 1 << 12)]
