"""What a file holds beside descriptions and packets: which of it a recovered file keeps."""

from __future__ import annotations

import json
from collections.abc import Callable, Container
from dataclasses import dataclass, field

from ..format.clocks import parse_clock, parse_map
from ..format.extras import build_metadata, parse_attachment, parse_metadata
from ..writing.filewriter import FileWriter
from ..format.walk import Chunk, read_chunk
from ..format.wire import NO_TRACK
from ..errors import FormatError, ParameterError
from ..reading.catalogue import Catalogue, ChunkRef
from ..reading.opening import lose_chunk
from ..verdict import HARMLESS

WRITTEN_ANEW = frozenset({"HEAD", "TRAK", "DATA", "iNDX", "fOOT", "dGST"})
CLOCKS: dict[str, Callable[[bytes, int | None, int], object]] = {
    "cLOk": parse_clock,
    "cMAp": parse_map,
}


@dataclass
class Extras:
    """Copies chunks other than those that are written anew; names the unknown ones."""

    catalogue: Catalogue
    writer: FileWriter
    tracks: Container[int]
    """Ids of the tracks that are kept."""
    kept: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)

    def copy(self, ref: ChunkRef) -> None:
        """One chunk as it stands, where it holds and still has a meaning."""
        if ref.known and ref.type in WRITTEN_ANEW:
            return
        chunk = read_chunk(self.catalogue.source, ref.offset)
        if chunk is None or not chunk.intact:
            return
        header = chunk.header
        keep = self.wanted(chunk) if header.known else self.may_be_copied(chunk)
        if not header.known:
            (self.kept if keep else self.dropped).append(header.type)
        if keep:
            self.writer.chunk(header.type, chunk.payload, header.track, flags=header.flags)

    def wanted(self, chunk: Chunk) -> bool:
        header, offset = chunk.header, chunk.payload_offset
        try:
            self.catalogue.level.check("payload_size", header.payload_size, "LIM-001", offset)
            if header.type == "mETa":
                parse_metadata(chunk.payload, offset)
            elif header.type == "aTTc":
                parse_attachment(chunk.payload, offset)
            elif header.type in CLOCKS:
                track = self.catalogue.observed_track(chunk)
                CLOCKS[header.type](chunk.payload, track, offset)
        except FormatError as error:
            lose_chunk(self.catalogue, chunk, error)
            return False
        return header.track == NO_TRACK or header.track in self.tracks

    def may_be_copied(self, chunk: Chunk) -> bool:
        """Of an unknown type: always where nothing else changes; a critical one always, since
        without it the file would seem to be understood."""
        if chunk.header.payload_size > self.catalogue.level.payload_size:
            return False
        safe = chunk.header.type[3].islower()
        whole = all(finding.code in HARMLESS for finding in self.catalogue.findings)
        return chunk.header.critical or safe or whole


def write_note(catalogue: Catalogue, writer: FileWriter, note: str) -> None:
    """The member ``notes`` of the metadata, with one more text (SPEC 6.7)."""
    found = catalogue.metadata.get("notes", [])
    before = found if isinstance(found, list) else [found]
    notes = [text if isinstance(text, str) else json.dumps(text) for text in before]
    try:
        payload = build_metadata({"notes": [*notes, note]})
    except ParameterError:
        return
    if len(payload) <= writer.level.payload_size:
        writer.chunk("mETa", payload)
