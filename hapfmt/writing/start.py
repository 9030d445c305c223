"""Starts a recording: in a new file, or at the end of an existing one.

An existing file becomes a writer that appends at its end, even where it was not closed (SPEC clause
15).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import ceil
from types import TracebackType
from typing import Any, BinaryIO, Literal

from ..clocks import ClockObservation
from ..encoder.live import Input, LiveEncoder, by_label, check_inputs
from ..encoder.settings import Settings, made_with
from ..errors import HARMLESS, HapfmtError, ParameterError
from ..format.cluster import MissingPackets, Packet, parse_rows, parse_table_head, salvage_cluster
from ..format.extras import build_metadata
from ..format.source import ByteSource
from ..format.track import Track, TrackTable, missing_channels, paired, parse_description
from ..format.walk import Finding, read_chunk
from ..format.wire import HEADER_SIZE, check_file_id
from ..limits import LAST_TRACK_ID
from ..numbers import exact
from ..reading.catalogue import Catalogue, ChunkRef
from ..reading.damage import DamageReport, LostSpan
from ..reading.opening import open_catalogue
from ..recording import Recording
from ..units import unit_text
from ..version import __version__
from .clusters import Clusters, Layers, Observed
from .file import LiveFile, Pipe, RecordingOutput, SyncPolicy, create_live, open_live
from .filewriter import FileWriter
from .worker import FileChannel, Item, SampleQueue, Worker

TAIL = frozenset({"truncated", "bad-payload", "garbage", "other-file"})
"""Findings at the place where the writing stopped."""

NOTHING_IN = frozenset({"HEAD", "TRAK", "iNDX", "fOOT"})
"""Chunks that are written again, or held no data yet."""

RECOVER = "first run: hapfmt recover FILE OUT"
PIECE = 1 << 16
"""Bytes looked at in one go."""

SHOWN = 4
"""Losses named in a note."""


class Appending:
    """A file open for appending: ``file, writer, catalogue = appending``.

    ``findings`` describes the bytes cut off its end; ``note`` says the same for people, where they
    held anything. As a context manager it closes both at the end of the block, also after an error:
    the data written until then stays in the file.
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
            # An interrupt may have come between a chunk and its entry in the index.
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
    """Lock a file and append at its end, whether it was closed or not.

    Where writing stopped within a chunk, or left bytes that are no chunk, the end is repaired first
    (SPEC WRT-006): whole packets are kept, the rest is cut off and reported. A closed file is read
    by its index: damage to its payloads shows when they are read. ``clock``: as for a FileWriter.

    Raises ParameterError where another program writes the file, where it is damaged elsewhere, or
    anywhere and ``repair`` is False; FormatError and UnsupportedError as a Reader does.
    """
    file = open_live(path, sync=sync)
    try:
        catalogue = open_catalogue(file)
        if not catalogue.closed:
            # The part before its last index has not been examined yet.
            catalogue = open_catalogue(file, scan=True)
        if catalogue.unsupported:
            raise catalogue.unsupported
        findings = [found for found in catalogue.findings if found.code not in HARMLESS]
        if catalogue.head is None:
            raise ParameterError("its HEAD is incomplete, so nothing can be appended")
        end = min((found.offset for found in findings), default=file.size)
        if findings:
            check_tail(catalogue, findings, end)
        rescued, lost = salvage(catalogue, end)
        kept = drop_incomplete(catalogue, end)
        if kept < end:
            message = "incomplete track descriptions"
            findings.insert(0, Finding("truncated", kept, end - kept, message, "TRK-012"))
        if findings and not repair:
            raise ParameterError("its end is damaged and cannot be mended", offset=kept)
        note = note_of(catalogue, findings, rescued, lost)
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


def zeros(source: ByteSource, start: int) -> bool:
    """Whether only zeros follow."""
    return not any(
        any(source.read_at(position, PIECE)) for position in range(start, source.size, PIECE)
    )


def salvage(catalogue: Catalogue, end: int) -> tuple[list[Packet], list[LostSpan] | None]:
    """The packets of the cluster at ``end`` that was cut, and the spans of those that are lost;
    None where some of these are not known."""
    ref = next((ref for ref in catalogue.chunks if ref.offset >= end), None)
    chunk = read_chunk(catalogue.source, end) if ref and ref.type == "DATA" else None
    if chunk is None:
        return [], []
    sizes = (chunk.header.payload_size, len(chunk.payload))
    tracks, level, at = catalogue.tracks, catalogue.level, chunk.payload_offset
    items = list(
        salvage_cluster(chunk.payload, tracks, level, at, chunk.header.cluster_seed, sizes)
    )
    gaps = [item for item in items if isinstance(item, MissingPackets)]
    rows = [row for gap in gaps for row in gap.missing]
    spans = [LostSpan(row.track, row.start, row.stop) for row in rows]
    known = all(gap.missing for gap in gaps)
    return [item for item in items if isinstance(item, Packet)], spans if known else None


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
        at = chunk.payload_offset
        if table.is_new(chunk.payload, at):
            table.add(parse_description(chunk.payload, catalogue.level, at))
    return table


def note_of(
    catalogue: Catalogue,
    findings: Sequence[Finding],
    packets: Sequence[Packet],
    lost: Sequence[LostSpan] | None,
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
    spans = ["which samples were lost is unknown"]
    if lost is not None:
        spans = DamageReport(catalogue, lost).losses() or ["no sample was lost"]
    more = [f"{len(spans) - SHOWN} more such losses"] if len(spans) > SHOWN else []
    told = "; ".join([*spans[:SHOWN], *more])
    return f"{where}, from a cluster, and {len(packets)} of its packets written again; {told}"


def write_again(
    writer: FileWriter, catalogue: Catalogue, packets: Sequence[Packet], note: str | None
) -> None:
    """The packets that were saved, and the note, over what is cut off: they need no room."""
    offset = writer.offset
    writer.cluster(packets)
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
    """The tick after the last packet of each track that has any.

    Raises ParameterError where damage to a cluster hides the end of a track.
    """
    ends: dict[int, int] = {}
    for ref in reversed(catalogue.data):
        if len(ends) == len(catalogue.tracks):
            break
        chunk = read_chunk(catalogue.source, ref.offset)
        if chunk is None or not chunk.intact:
            raise ParameterError(
                f"damaged before its end (bad-payload); {RECOVER}", offset=ref.offset
            )
        head = parse_table_head(chunk.payload, catalogue.level, chunk.payload_offset)
        found: dict[int, int] = {}
        for row in parse_rows(chunk.payload, head):
            found[row.track] = max(row.stop, found.get(row.track, 0))
        ends = found | ends
    return ends


CLUSTER_S = Fraction(1)
"""SPEC clause 15: for a live recording, where the last one may be lost."""

NOTED = 100
"""Channels whose dropped samples get a note each: metadata have to fit a chunk."""


@dataclass
class Options:
    """What the caller asked for, as :class:`Recorder` says."""

    settings: Settings | None = None
    cluster: Any = None
    patience: Any = 1
    hold: Any = None
    fsync: str | float = "cluster"
    append: bool = False
    at: Any = None
    force: bool = False
    metadata: dict[str, Any] = field(default_factory=dict)
    epoch_ns: int | Literal["now"] | None = "now"
    epoch_uncertainty_ns: int = 0
    clock_maps: bool = False
    canonical: int | None = None

    def __post_init__(self) -> None:
        settings = self.settings or Settings()
        asked = settings.cluster if self.cluster is None else self.cluster
        self.cluster = CLUSTER_S if asked is None else exact(asked)
        self.patience = exact(self.patience)
        self.settings = replace(settings, cluster=self.cluster)
        if settings.cluster not in (None, self.cluster):
            raise ParameterError("give the cluster or the settings its length, not both")
        if self.append and (self.epoch_ns != "now" or self.epoch_uncertainty_ns):
            raise ParameterError("epoch_ns is for a new file: the file that grows has its own")
        if self.cluster <= 0 or self.patience < 0:
            raise ParameterError("the cluster length must be positive, and patience not negative")
        if self.hold is None and self.canonical is None:
            self.hold = self.cluster + 2 * self.patience
        self.hold = None if self.hold is None else exact(self.hold)
        if self.canonical is not None:
            check_file_id(self.canonical)
            if self.hold is not None or self.append:
                raise ParameterError(
                    "canonical mode cannot use the time of day or append to a file"
                )
            if self.epoch_ns == "now":
                self.epoch_ns = None
        if settings.digest:
            raise ParameterError(
                "checksums cover whole tracks and cannot be written while recording"
            )
        if self.append and self.force:
            raise ParameterError("use either force or append, not both")
        if self.epoch_ns is None and self.epoch_uncertainty_ns:
            raise ParameterError("epoch_uncertainty_ns requires epoch_ns")
        if self.at is not None and not self.append:
            raise ParameterError("at requires append")


class Start:
    """A recorder's parts, made and joined; ``members`` are the inputs in their order."""

    def __init__(
        self,
        file: str | os.PathLike[str] | BinaryIO,
        inputs: Sequence[Input],
        options: Options,
        queue: SampleQueue[Item],
    ) -> None:
        assert options.settings is not None
        self.options, self.settings = options, by_label(options.settings, inputs)
        self.policy = SyncPolicy(options.fsync)
        self.ends: list[int] = []
        self.notes: list[str] = []
        self.cut: str | None = None
        """The note of bytes cut off the end of the file that is appended to."""
        self.metadata = dict(options.metadata)
        self.written: dict[str, Any] = {}
        """The metadata in the file."""
        self.start_s = Fraction(0)
        self.holes: list[int] = []
        """Channel numbers below the highest without a channel."""
        self.observed: list[ClockObservation] = []
        """Observations of the file that is appended to, where maps are asked for."""
        self.observed_on: dict[int | str | None, int] = {}
        """The first tracks of its channels."""
        if options.append:
            if not isinstance(file, (str, os.PathLike)):
                raise ParameterError("a stream that is only written cannot be appended to")
            self.append(open_append(file, sync=self.policy, clock=time.monotonic), inputs)
        else:
            self.create(file, inputs)
        layers = Layers(self.output.writer.tracks.values())
        observed = Observed(maps=options.clock_maps, before=self.observed, tracks=self.observed_on)
        clusters = Clusters(options.cluster, options.patience)
        hold_s = None if options.hold is None else float(options.hold)
        self.worker = Worker(
            queue, self.output, self.encoder, clusters, layers, observed, hold_s=hold_s
        )
        self.worker.add(self.members, self.ends)

    def create(self, file: str | os.PathLike[str] | BinaryIO, inputs: Sequence[Input]) -> None:
        options = self.options
        self.encoder = LiveEncoder(self.settings)
        level = self.encoder.level(inputs)
        check_inputs(inputs, self.settings)
        epoch_ns = time.time_ns() if options.epoch_ns == "now" else options.epoch_ns
        known = Recording(epoch_ns=epoch_ns, epoch_uncertainty_ns=options.epoch_uncertainty_ns)
        # Its own encoder is in HEAD.
        self.metadata.pop("encoder", None)
        build_metadata(self.metadata)
        clock: Callable[[], float] = time.monotonic
        if options.canonical is not None:
            clock = self.recorded
        self.members = [FileChannel(given, number) for number, given in enumerate(inputs)]
        self.ends = [0] * len(inputs)
        self.next_number = len(inputs)
        if isinstance(file, (str, os.PathLike)):
            self.output = RecordingOutput(
                create_live(file, force=options.force, sync=self.policy), self.policy
            )
        else:
            if not isinstance(options.fsync, str):
                raise ParameterError("fsync is for files: a stream has no disk to wait for")
            self.output = RecordingOutput(Pipe(file), self.policy)
        try:
            self.output.writer = FileWriter(
                self.output.target,
                level=level,
                file_id=options.canonical,
                epoch_ns=known.epoch_ns,
                epoch_uncertainty_ns=known.epoch_uncertainty_ns,
                encoder=made_with(self.settings),
                clock=clock,
            )
            if self.metadata:
                self.output.writer.metadata(self.metadata)
            self.written = dict(self.metadata)
        except BaseException:
            self.output.target.close()
            raise

    def recorded(self) -> float:
        """Seconds of the recording, as a clock for what depends on nothing else."""
        writer: FileWriter | None = getattr(self.output, "writer", None)
        return float(writer.stop) if writer else 0.0

    def append(self, found: Appending, inputs: Sequence[Input]) -> None:
        try:
            catalogue, options = found.catalogue, self.options
            self.output = RecordingOutput(found.file, self.policy)
            self.output.writer = found.writer
            self.encoder = LiveEncoder(
                self.settings, first_track=max(catalogue.tracks, default=-1) + 1
            )
            self.next_number = max((c.number for c in catalogue.channels), default=-1) + 1
            self.holes = missing_channels(catalogue.tracks.values())
            end_s = end_of(found)
            epoch_ns = catalogue.head.epoch_ns if catalogue.head else None
            self.start_s = start_of(options.at, end_s, epoch_ns)
            self.members = self.match(catalogue.channels, inputs)
            needed = self.encoder.level(m.input for m in self.members).number
            check_inputs(inputs, self.settings)
            if needed > catalogue.level.number:
                raise ParameterError(
                    "the file is of level 1, and these inputs need level 2 (more than 24 bits)"
                )
            self.ends = [ceil(self.start_s * m.input.rate) for m in self.members]
            self.written = dict(catalogue.metadata)
            if options.clock_maps:
                self.observed = catalogue.clocks
                self.observed_on = {ref.number: ref.track.id for ref in catalogue.channels}
            self.cut = found.note
            notes = catalogue.metadata.get("notes", [])
            self.notes = [note for note in notes if isinstance(note, str)]
            if found.note and found.note not in self.notes:
                self.notes.append(found.note)
            self.notes.append(
                f"appended from {float(self.start_s):.9g} s on by hapfmt {__version__}"
            )
        except BaseException as error:
            found.__exit__(None, None, None)
            if isinstance(error, HapfmtError):
                error.at(path=found.file.path)
            raise

    def closing(self, metadata: dict[str, Any]) -> dict[str, Any]:
        """Metadata at the end: the changes, and notes of losses."""
        progress = self.worker.progress
        own = metadata.get("notes", [])
        notes = [*self.notes, *(own if isinstance(own, list) else [])]
        members = self.worker.members
        dropped = [(members[p].input.label, n) for p, n in sorted(progress.dropped.items())]
        lost = [
            f"dropped: {count} samples of {label!r}, for which the encoder was too slow"
            for label, count in dropped[:NOTED]
        ]
        if len(dropped) > NOTED:
            more = sum(count for _, count in dropped[NOTED:])
            lost.append(f"dropped: {more} samples of {len(dropped) - NOTED} more channels")
        lost += self.worker.notes
        if self.notes or lost:
            metadata = {**metadata, "notes": [*notes, *lost]}
        return {k: v for k, v in metadata.items() if k not in self.written or self.written[k] != v}

    def number(self) -> int:
        """Number of a new channel: one that a crash left without a channel, else the next."""
        if self.holes:
            return self.holes.pop(0)
        self.next_number += 1
        return self.next_number - 1

    def match(self, channels: Sequence[Any], inputs: Sequence[Input]) -> list[FileChannel]:
        """Inputs and their channels in the file: those of the same label, rate and unit, each
        once; else new ones.

        Raises ParameterError for a new one with the label of a channel that no input continues.
        """
        free = list(channels)
        members: list[FileChannel] = []
        for given in inputs:
            same = (given.label, given.rate, given.unit)
            for ref in free:
                component = ref.track.components[ref.index]
                if same == (component.label, ref.track.rate, component.unit):
                    free.remove(ref)
                    members.append(FileChannel(given, ref.number, is_new=False))
                    self.encoder.known(ref.number, last_track(ref))
                    break
            else:
                members.append(FileChannel(given, self.number()))
        for given in (member.input for member in members if member.is_new):
            held = " and ".join(
                sampled(ref.track.rate, ref.track.components[ref.index].unit)
                for ref in free
                if given.label and ref.label == given.label
            )
            if held:
                raise ParameterError(
                    f"{given.label!r} is {held} in the file, not "
                    f"{sampled(given.rate, given.unit)}: give it that rate and unit, or another "
                    "label"
                )
        if self.next_number > LAST_TRACK_ID:
            raise ParameterError(f"a recording has at most {LAST_TRACK_ID} channels")
        return members


def sampled(rate: Fraction, unit: str) -> str:
    """Say the rate and unit of a channel."""
    return f"{float(rate):g} Hz in {unit_text(unit) or 'no unit'}"


def last_track(ref: Any) -> Track:
    """The track that continues the channel."""
    track: Track = ref.parts[-1].track
    return track


def end_of(found: Appending) -> Fraction:
    """Seconds to the end of the last sample; events are no samples."""
    tracks = found.catalogue.tracks
    ends = ((tracks[id_], tick) for id_, tick in found.ends().items())
    samples = (tick / track.rate for track, tick in ends if track.kind != "events")
    return max(samples, default=Fraction(0))


def start_of(at: Any, end_s: Fraction, epoch_ns: int | None) -> Fraction:
    """Seconds where an appended part begins."""
    if at is None:
        return end_s
    if at == "now":
        if epoch_ns is None:
            raise ParameterError("the file has no epoch, so the time now has no place in it")
        start_s = Fraction(time.time_ns() - epoch_ns, 10**9)
    else:
        start_s = exact(at)
    if start_s < end_s:
        raise ParameterError(
            f"the recording ends at {float(end_s):.9g} s: nothing is appended at "
            f"{float(start_s):.9g} s"
        )
    return start_s


__all__ = ["Options", "Start"]
