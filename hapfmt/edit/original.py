"""A file that is edited: its descriptions, clusters and other chunks. A damaged one is refused."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from fractions import Fraction
from math import gcd, lcm
from pathlib import Path
from typing import BinaryIO

from ..errors import (
    DAMAGED,
    ChecksumError,
    FormatError,
    HapfmtError,
    ParameterError,
    UnsupportedError,
)
from ..files import Closing
from ..format.cluster import Packet, parse_cluster
from ..format.extras import Attachment
from ..format.source import open_source
from ..format.track import Track, lone_lf
from ..format.walk import Chunk, header_at, read_chunk
from ..format.wire import Head
from ..limits import Limits
from ..reading.catalogue import Catalogue, ChunkRef, FalseIndexError
from ..reading.opening import open_catalogue
from ..reading.packets import Seconds, overlapping

Input = str | os.PathLike[str] | bytes | BinaryIO
Advance = Callable[[int, int], None]

NS = 10**9
DESCRIBED = frozenset({"HEAD", "TRAK", "DATA", "iNDX", "fOOT", "mETa", "dGST"})
"""Chunk types that an editor writes by itself; the others it copies or leaves out."""


class Original(Closing):
    """Opens a path, bytes, or a binary stream for editing; ``scan`` checks all of it at once;
    ``limits`` bound what of it is kept in memory.

    Raises an error that says to recover the file first, where anything about it is damaged.
    """

    def __init__(self, file: Input, *, scan: bool = True, limits: Limits | None = None) -> None:
        self.limits = limits
        self.source = open_source(file)
        try:
            self.open(scan=scan)
        except BaseException:
            self.source.close()
            raise

    def open(self, *, scan: bool) -> None:
        self.catalogue: Catalogue = open_catalogue(self.source, scan=scan, limits=self.limits)
        self.refuse()

    def close(self) -> None:
        self.source.close()

    @property
    def name(self) -> str:
        """To speak of it; pipes and bytes have none."""
        return self.source.path or "the input"

    @property
    def stem(self) -> str:
        return Path(self.source.path).stem if self.source.path else ""

    @property
    def head(self) -> Head:
        assert self.catalogue.head is not None
        return self.catalogue.head

    @property
    def tracks(self) -> dict[int, Track]:
        return self.catalogue.tracks

    @property
    def attachments(self) -> dict[str, Attachment]:
        """By name; where the index is wrong, the whole file is read."""
        try:
            return self.catalogue.attachments
        except FalseIndexError:
            self.open(scan=True)
            return self.catalogue.attachments

    @property
    def labels(self) -> dict[int, str]:
        """By channel number."""
        return labels_of(self.tracks)

    def refuse(self) -> None:
        catalogue = self.catalogue
        if catalogue.unsupported:
            raise catalogue.unsupported
        if catalogue.findings:
            first = catalogue.findings[0]
            raise self.damaged(first.error, f"{first.code}: {first.message}", first.offset)
        bare = [
            track
            for track in self.tracks.values()
            if track.kind == "lf" and track.id not in catalogue.table.bases
        ]
        if bare:
            raise lone_lf(bare[0]).at(path=self.source.path)

    def damaged(self, kind: type[FormatError], message: str, offset: int) -> HapfmtError:
        error = kind(
            f"{message}; nothing was written: run hapfmt recover first",
            requirement="EDT-001",
            offset=offset,
            path=self.source.path,
        )
        error.exit_code = DAMAGED
        return error

    def check_known(self, tracks: Sequence[Track]) -> None:
        """Packets are copied whatever their codec; of another kind of track nobody knows what its
        description refers to."""
        for track in tracks:
            if track.unsupported and not track.unsupported.startswith("codec "):
                raise UnsupportedError(
                    f"track {track.id} needs {track.unsupported}; leave its channels out",
                    offset=track.offset,
                    path=self.source.path,
                )

    def refs(self, start: Seconds | None, stop: Seconds | None) -> list[ChunkRef]:
        """DATA chunks that overlap these seconds, in order of time."""
        refs = overlapping(self.catalogue.data, start, stop)
        try:
            for ref in refs:
                if ref.limit is not None:
                    ref.checked(header_at(self.source, ref.offset, self.catalogue.file_id))
        except FalseIndexError:
            # An index that points elsewhere (IDX-003).
            self.open(scan=True)
            refs = overlapping(self.catalogue.data, start, stop)
        return refs

    def clusters(
        self,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        progress: Advance | None = None,
    ) -> Iterator[list[Packet]]:
        """The packets of one DATA chunk after the other, every CRC checked."""
        refs = self.refs(start, stop)
        last: dict[int, int] = {}
        for done, ref in enumerate(refs):
            packets = self.cluster(ref)
            for packet in packets:
                track = self.tracks[packet.track]
                if track.kind != "events" and packet.start < last.get(track.id, 0):
                    raise FormatError(
                        f"packets of track {track.id} overlap",
                        requirement="DAT-006",
                        offset=packet.offset,
                        path=self.source.path,
                    )
                last[track.id] = packet.stop
            yield packets
            if progress:
                progress(done + 1, len(refs))

    def cluster(self, ref: ChunkRef) -> list[Packet]:
        chunk = read_chunk(self.source, ref.offset, self.catalogue.file_id)
        if chunk is None or not chunk.intact or chunk.header.type != "DATA":
            message = "checksum error in the payload of a DATA chunk"
            raise self.damaged(ChecksumError, message, ref.offset)
        try:
            level, at = self.catalogue.level, chunk.payload_offset
            return parse_cluster(chunk.payload, self.tracks, level, at, chunk.header.cluster_seed)
        except FormatError as error:
            raise error.at(path=self.source.path) from None

    def others(self, *, behind: bool) -> Iterator[Chunk]:
        """Chunks that are none of ``DESCRIBED``, before the first DATA chunk or behind it."""
        first = min((ref.offset for ref in self.catalogue.data), default=self.source.size)
        for ref in self.catalogue.chunks:
            if (ref.type in DESCRIBED and ref.known) or (ref.offset > first) != behind:
                continue
            chunk = read_chunk(self.source, ref.offset, self.catalogue.file_id)
            if chunk is None or not chunk.intact or chunk.header.type != ref.type:
                message = f"checksum error in the payload of a {ref.type} chunk"
                raise self.damaged(ChecksumError, message, ref.offset)
            yield chunk


def open_original(file: Input | Original, *, scan: bool = True) -> AbstractContextManager[Original]:
    """One that is open already stays so."""
    return nullcontext(file) if isinstance(file, Original) else Original(file, scan=scan)


def has_channels(track: Track) -> bool:
    return track.kind not in ("hf", "events")


def labels_of(tracks: Mapping[int, Track]) -> dict[int, str]:
    """By channel number."""
    found: dict[int, str] = {}
    for track in tracks.values():
        if has_channels(track):
            for number, component in zip(track.channels, track.components, strict=True):
                found.setdefault(number, component.label)
    return found


def common_period(rates: Sequence[Fraction]) -> Fraction:
    """The shortest time, in seconds, that is a whole number of ticks at each rate."""
    if not rates:
        return Fraction(1, 10**9)
    return Fraction(lcm(*(r.denominator for r in rates)), gcd(*(r.numerator for r in rates)))


def ticks_of(seconds: Fraction, rate: Fraction) -> int:
    """Exactly; ParameterError unless the result is a whole number."""
    ticks = seconds * rate
    if ticks.denominator != 1:
        raise ParameterError(f"{seconds} s is not a whole number of ticks at {rate} Hz")
    return ticks.numerator
