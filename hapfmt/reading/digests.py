"""Stored checksums of tracks (dGST, SPEC 6.9), and whether the decoded numbers match them."""

from __future__ import annotations

from collections.abc import Collection

from ..format.walk import Chunk, read_chunk
from ..errors import FormatError
from ..verdict import HARMLESS
from .catalogue import Catalogue
from .decoder import TrackDigest
from .opening import lose_chunk
from .pieces import Piece


class DigestCheck:
    """Takes the pieces of whole tracks in the order of the file, then compares."""

    def __init__(self, catalogue: Catalogue, tracks: Collection[int] | None = None) -> None:
        self.catalogue = catalogue
        found = stored_digests(catalogue)
        self.stored = {id_: found[id_] for id_ in found if tracks is None or id_ in tracks}
        self.running = {id_: TrackDigest() for id_ in self.stored}

    def add(self, piece: Piece) -> None:
        offset, _ = self.stored.get(piece.track.id, (0, b""))
        if piece.offset < offset:
            self.running[piece.track.id].update(piece.start, piece.digested)

    def compare(self, lossy: Collection[int]) -> None:
        """Report each checksum that differs; tracks with losses are not compared (DGS-002)."""
        for id_, (offset, digest) in self.stored.items():
            if id_ in lossy or self.catalogue.tracks[id_].unsupported:
                continue
            if self.running[id_].digest() != digest:
                message = f"the decoded numbers of track {id_} do not match their checksum"
                self.catalogue.lose("bad-digest", offset, 32, message, "DGS-002")


def stored_digests(catalogue: Catalogue) -> dict[int, tuple[int, bytes]]:
    """The last digest of each track and its offset (SPEC 6.9)."""
    found: dict[int, tuple[int, bytes]] = {}
    # In a damaged file the description of a track may be lost; a recoverer of an undamaged one
    # reports a digest of no track, since it leaves it out.
    harmed = any(finding.code not in HARMLESS for finding in catalogue.findings)
    for ref in catalogue.chunks:
        chunk = read_chunk(catalogue.source, ref.offset) if ref.type == "dGST" else None
        if chunk is None or not chunk.intact or not chunk.header.known:
            continue
        try:
            ids = digested_tracks(catalogue, chunk, harmed=harmed)
        except FormatError as error:
            if not catalogue.damaged:
                raise
            lose_chunk(catalogue, chunk, error)
            continue
        for id_ in ids:
            place = 32 * (id_ - chunk.header.track)
            if id_ in catalogue.tracks:
                digest = chunk.payload[place : place + 32]
                found[id_] = chunk.payload_offset + place, digest
    return found


def digested_tracks(catalogue: Catalogue, chunk: Chunk, *, harmed: bool) -> range:
    """The tracks that a dGST chunk has checksums of; in a damaged file some may not be known."""
    tracks, at, size = catalogue.tracks, chunk.payload_offset, len(chunk.payload)
    ids = range(chunk.header.track, chunk.header.track + size // 32)
    unknown = [
        i for i in ids if i not in tracks or (tracks[i].offset > at and not catalogue.damaged)
    ]
    if not size or size % 32 or (unknown and not harmed):
        raise FormatError(
            "The chunk does not hold a whole number of checksums of known tracks",
            requirement="DGS-001",
            offset=at,
        )
    if any(i in tracks and tracks[i].kind == "events" for i in ids):
        raise FormatError("Tracks of events have no checksum", requirement="DGS-001", offset=at)
    return ids
