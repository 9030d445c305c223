"""An existing file -> a writer that goes on at its end, however that was left (SPEC clause 15)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import Any

from ..format.cluster import Packet, parse_rows, parse_table_head
from ..format.description import parse_description
from .filewriter import FileWriter
from ..format.salvage import salvage_cluster
from ..format.source import Source
from ..format.track import TrackTable, paired
from ..format.walk import Finding, read_chunk
from ..format.wire import HEADER_SIZE
from ..errors import HapfmtError, ParameterError
from .file import LiveFile, SyncPolicy, open_live
from ..reading.catalogue import Catalogue, ChunkRef
from ..reading.opening import open_catalogue
from ..verdict import HARMLESS

TAIL = frozenset({"truncated", "bad-payload", "garbage", "other-file"})
"""What is found where the writing stopped."""

NOTHING_IN = frozenset({"HEAD", "TRAK", "iNDX", "fOOT"})
"""What is written anew, or said nothing yet."""

RECOVER = "run: hapfmt recover"
PIECE = 1 << 16
"""Bytes looked at in one go."""


class Appending:
    """A file open for appending: ``file, writer, catalogue = appending``.

    ``findings`` is what was cut off its end, ``note`` the same for people, where it held anything.
    As a context manager it closes both at the end of the block: also after an error, since what
    was written until then stands.
    """

    def __init__(
        self,
        file: LiveFile,
        writer: FileWriter,
        catalogue: Catalogue,
        findings: list[Finding],
        note: str | None,
    ) -> None:
        self.file = file
        self.writer = writer
        self.catalogue = catalogue
        self.findings = findings
        self.note = note

    def __iter__(self) -> Iterator[Any]:
        yield from (self.file, self.writer, self.catalogue)

    def __enter__(self) -> Appending:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            # Whoever interrupts may have done so between a chunk and its entry in the index.
            if kind is None or issubclass(kind, Exception):
                self.writer.close()
        except OSError:
            if kind is None:
                raise
        finally:
            self.file.close()

    def ends(self) -> dict[int, int]:
        """For each track that had packets when the file was opened, the tick after the last."""
        return track_ends(self.catalogue)


def open_append(
    path: str | os.PathLike[str],
    *,
    repair: bool = True,
    sync: SyncPolicy | None = None,
    clock: Callable[[], float] | None = None,
) -> Appending:
    """Lock a file and go on at its end, whether it was closed or not.

    Where writing stopped within a chunk, or left bytes that are no chunk, the end is mended first
    (SPEC WRT-007): whole packets are kept, the rest is cut off and told. A closed file is taken by
    its index: what its payloads lost shows when they are read. ``clock``: as for a FileWriter.

    Raises ParameterError where another program writes the file, where it is damaged elsewhere, or
    anywhere and ``repair`` is False; FormatError and UnsupportedError as a Reader does.
    """
    file = open_live(path, sync=sync)
    try:
        catalogue = open_catalogue(file)
        if not catalogue.closed:
            # What stands before its last index has not been looked at yet.
            catalogue = open_catalogue(file, scan=True)
        if catalogue.unsupported:
            raise catalogue.unsupported
        findings = [found for found in catalogue.findings if found.code not in HARMLESS]
        if catalogue.head is None:
            raise ParameterError("its HEAD is incomplete, so nothing can be appended")
        end = min((found.offset for found in findings), default=file.size)
        if findings:
            check_tail(catalogue, findings, end)
        rescued = salvage(catalogue, end)
        kept = drop_incomplete(catalogue, end)
        if kept < end:
            message = "incomplete track descriptions"
            findings.insert(0, Finding("truncated", kept, end - kept, message, "TRK-012"))
        if findings and not repair:
            raise ParameterError("its end is damaged and cannot be mended", offset=kept)
        note = note_of(catalogue, findings, rescued)
        file.size = kept
        catalogue.findings = [found for found in catalogue.findings if found.code in HARMLESS]
        catalogue.chunks = [ref for ref in catalogue.chunks if ref.offset < kept]
        writer = FileWriter.resume(file, catalogue, clock=clock)
        write_again(writer, catalogue, rescued, note)
        file.trim()
        return Appending(file, writer, catalogue, findings, note)
    except HapfmtError as error:
        file.close()
        raise error.at(path=file.path) from None
    except BaseException:
        file.close()
        raise


def check_tail(catalogue: Catalogue, findings: Sequence[Finding], end: int) -> None:
    """Whether all damage begins at ``end``, and is what a writer or a disk leaves that stops."""
    source = catalogue.source
    known = [ref for ref in catalogue.chunks if ref.offset >= end]
    other = [found for found in findings if found.code not in TAIL]
    if other or len(known) > 1 or (known and known[0].offset > end):
        place = other[0] if other else findings[0]
        raise ParameterError(
            f"damaged before its end ({place.code}); {RECOVER}", offset=place.offset
        )
    for found in findings:
        if found.code == "garbage" and (
            found.size > catalogue.level.payload_size + HEADER_SIZE
            and not zeros(source, found.offset)
        ):
            raise ParameterError(
                f"{found.size} bytes at its end belong to no chunk; {RECOVER}",
                offset=found.offset,
            )
        if found.code == "other-file":
            raise ParameterError("another file follows its end", offset=found.offset)


def zeros(source: Source, start: int) -> bool:
    """Whether nothing but zeros follows."""
    return not any(
        any(source.read_at(position, PIECE)) for position in range(start, source.size, PIECE)
    )


def salvage(catalogue: Catalogue, end: int) -> list[Packet | None]:
    """The packets of the cluster at ``end`` that was cut; None for each that is lost."""
    ref = next((ref for ref in catalogue.chunks if ref.offset >= end), None)
    chunk = read_chunk(catalogue.source, end) if ref and ref.type == "DATA" else None
    if chunk is None or not chunk.header.known:
        return []
    sizes = (chunk.header.payload_size, len(chunk.payload))
    tracks, level, at = catalogue.tracks, catalogue.level, chunk.payload_offset
    items = salvage_cluster(chunk.payload, tracks, level, at, chunk.header.cluster_seed, sizes)
    return [item if isinstance(item, Packet) else None for item in items]


def drop_incomplete(catalogue: Catalogue, end: int) -> int:
    """Where to cut: at ``end``, or before descriptions at the end that are of no use without those
    that were to follow (TRK-012)."""
    refs = [ref for ref in catalogue.chunks if ref.offset < end]
    cut = not any(ref.offset >= end for ref in catalogue.chunks if ref.type == "DATA")
    while cut and not catalogue.closed and refs and refs[-1].type == "TRAK":
        if paired(list(catalogue.tracks.values())):
            break
        end = refs.pop().offset
        catalogue.table = described(catalogue, refs)
    if not paired(list(catalogue.tracks.values())):
        raise ParameterError(f"some tracks lack the tracks they depend on; {RECOVER}")
    return end


def described(catalogue: Catalogue, refs: Sequence[ChunkRef]) -> TrackTable:
    """What the TRAK chunks among ``refs`` say."""
    table = TrackTable()
    for ref in refs:
        chunk = read_chunk(catalogue.source, ref.offset) if ref.type == "TRAK" else None
        if chunk is None:
            continue
        first, at = chunk.header.track, chunk.payload_offset
        if table.is_new(first, chunk.payload, at):
            table.add(parse_description(chunk.payload, first, catalogue.level, at))
    return table


def note_of(
    catalogue: Catalogue, findings: Sequence[Finding], packets: Sequence[Packet | None]
) -> str | None:
    """What people should know of the end that was cut off; None where nothing was in it."""
    if not findings:
        return None
    first = findings[0]
    cut = [ref for ref in catalogue.chunks if ref.offset >= first.offset]
    size = catalogue.source.size - first.offset
    if (cut and cut[0].type in NOTHING_IN) or zeros(catalogue.source, first.offset):
        return None
    where = f"appending: {size} bytes at {first.offset} were cut off"
    if not cut:
        return f"{where}, no whole chunk"
    if cut[0].type != "DATA":
        return f"{where}, from a chunk {cut[0].type}"
    kept = sum(packet is not None for packet in packets)
    return f"{where}, from a cluster, and {kept} of its packets written again"


def write_again(
    writer: FileWriter, catalogue: Catalogue, packets: Sequence[Packet | None], note: str | None
) -> None:
    """The packets that were saved, and the note, over what is cut off: they need no room."""
    offset = writer.offset
    writer.cluster([packet for packet in packets if packet is not None])
    notes = catalogue.metadata.get("notes", [])
    if note and isinstance(notes, list):
        writer.metadata({"notes": [*notes, note]})
    while offset < writer.offset:
        chunk = read_chunk(catalogue.source, offset)
        assert chunk is not None
        ref = ChunkRef(
            chunk.header.type,
            offset,
            sequence=chunk.header.sequence,
            size=chunk.header.payload_size,
        )
        catalogue.chunks.append(catalogue.learn(chunk) or ref)
        offset = chunk.stop


def track_ends(catalogue: Catalogue) -> dict[int, int]:
    """The tick after the last packet of each track that has any; of a file without damage."""
    ends: dict[int, int] = {}
    for ref in reversed(catalogue.data):
        if len(ends) == len(catalogue.tracks):
            break
        chunk = read_chunk(catalogue.source, ref.offset)
        if chunk is None or not chunk.intact:
            continue
        head = parse_table_head(chunk.payload, catalogue.level, chunk.payload_offset)
        found: dict[int, int] = {}
        for row in parse_rows(chunk.payload, head):
            found[row.track] = max(row.stop, found.get(row.track, 0))
        ends = found | ends
    return ends
