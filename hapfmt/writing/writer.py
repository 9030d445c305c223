"""Recording -> file (SPEC clause 15)."""

from __future__ import annotations

import hashlib
import io
import os
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from itertools import groupby
from typing import Any, BinaryIO, Literal

from ..codecs.events import coded, event_packets, layer_track, rate_of
from ..convert import refuse_foreign
from ..encoder.encode import Decision, Encoded, encode
from ..encoder.settings import (
    EXACT_DB,
    INPUT,
    INPUT_SIZE,
    REACHED,
    Settings,
    alias_note,
    lossy_preset,
    made_with,
    renamed,
)
from ..errors import DataWarning, ParameterError, unknown
from ..files import refuse, target
from ..format.cluster import Packet
from ..format.extras import (
    Attachment,
    build_attachment,
    build_clocks,
    build_map,
    build_metadata,
)
from ..format.track import Track, build_track
from ..format.wire import check_file_id
from ..limits import LEVELS
from ..numbers import counted
from ..reading.decoder import TrackDecoder, TrackDigest
from ..recording import (
    SHOWN_LINES,
    Event,
    Rates,
    Recording,
    Units,
    aligned,
    by_layer,
    html_table,
    recording_of,
)
from ..units import unit_text, unknown_unit
from .filewriter import FileWriter
from .overview import attach_overview, readable

SHOWN_ROWS = 100
"""Channels that a summary shows in a notebook."""

NAMED = (
    "rate",
    "labels",
    "units",
    "transpose",
    "events",
    "canonical",
    "force",
    "overview",
    "progress",
    "threads",
)
"""Options of :func:`write` that are no settings."""


@dataclass(frozen=True)
class Summary:
    """Result of a write: bytes of the file and of the packets, samples, encoder's decisions.

    ``overview_size``: bytes of the overview in the file.
    """

    file_size: int
    payload_size: int
    sample_count: int
    decisions: tuple[Decision, ...]
    overview_size: int = 0

    def __repr__(self) -> str:
        """One line for the file and one for each of the first channels."""
        rows = [
            (repr(label), kept_as, size, f"largest error {error}")
            for label, kept_as, size, error in self._rows(SHOWN_LINES)
        ]
        lines = [self._headline(), *aligned(rows)]
        if len(self.decisions) > len(rows):
            more = counted(len(self.decisions) - len(rows), "more channel")
            lines.append(f"  ... and {more} (summary.decisions lists all)")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """A table for notebooks."""
        rows = self._rows(SHOWN_ROWS)
        head = ("label", "kept as", "size", "largest error")
        return html_table(self._headline(), head, rows, len(self.decisions) - len(rows))

    def _headline(self) -> str:
        samples = counted(self.sample_count, "sample")
        return f"Summary: {self.file_size} bytes, {samples}"

    def _rows(self, count: int) -> list[tuple[str, str, str, str]]:
        """Label, form, size and largest error of the first channels."""
        return [
            (
                each.label or f"channel {each.channel}",
                each.kept_as,
                f"{each.size} bytes",
                f"{each.largest_error:.3g} {unit_text(each.unit)}".rstrip(),
            )
            for each in self.decisions[:count]
        ]


def write(
    recording: Any,
    file: str | os.PathLike[str] | BinaryIO,
    settings: Settings | None = None,
    *,
    rate: Rates | None = None,
    labels: str | Sequence[str] | None = None,
    units: Units | None = None,
    transpose: bool | None = None,
    events: Iterable[Event] | None = None,
    preset: str | None = None,
    canonical: int | Literal["content"] | None = None,
    force: bool = False,
    overview: bool = False,
    progress: Callable[[int, int], None] | None = None,
    threads: int | None = None,
    **options: Any,
) -> Summary:
    """Encode a recording or an array into a path or a binary stream.

    recording
        a Recording, Channels, or numbers: an array [samples] or [channels, samples],
        {label: array [samples]}, or a table of pandas or xarray with a column for each channel.
        NaN and masked values are gaps. Integers of up to 32 bits are kept as counts. An array with
        more rows than columns is refused unless each row has a label: pass ``array.T`` or
        ``transpose``.
    rate
        samples per second (1000, 35.618 or "44100/7"); arrays need it. {label: rate} gives each
        array of a dict its own. A table may have times as its index. A MovedTimesWarning reports
        times that the regular grid moved.
    labels, units
        one text for each channel; one unit may be for all, or {label: unit}. Without them, names
        of columns such as "fx [N]" or "fx (N)" give both.
    events
        hapfmt.Event to add to those of the recording.
    settings, preset, options
        choose the encoding: a :class:`hapfmt.Settings`, or a preset and any of its fields, such as
        ``preset="near-lossless", max_error="0.1%"``.
    canonical
        file id of canonical mode: the same input gives the same bytes. Give each file an id of its
        own, which keeps parts of other files out; "content" computes one from the content.
        None: the id is random.
    force
        replace an existing file.
    overview
        attach the lowest and highest values of each channel, bin by bin, so that a viewer shows a
        long recording at once. It takes at most a 25th of the file or
        16 KiB, whichever is larger.
    progress
        is called with (channels done, channels in all).
    threads
        number of threads that encode; the bytes do not depend on it. None: HAPFMT_THREADS, else
        the number of CPUs; one thread for small recordings.

    Raises ParameterError if the recording does not fit the format or the file exists; OSError.
    """
    if settings is not None and (preset is not None or options):
        raise ParameterError("give settings, or a preset with options, not both")
    if isinstance(settings, str):
        raise ParameterError(f"settings are no text; to name a preset, write preset={settings!r}")
    if settings is None:
        if preset is not None and (old := alias_note(preset)):
            warnings.warn(old, DeprecationWarning, stacklevel=2)
        name, given = renamed("lossless" if preset is None else preset, options)
        try:
            settings = Settings.of(name, **given)
        except TypeError:
            known = [field.name for field in fields(Settings)]
            odd = next((option for option in options if option not in known), None)
            if odd is None:
                raise
            raise ParameterError(unknown("option", odd, [*known, *NAMED])) from None
    if isinstance(file, (str, os.PathLike)):
        refuse_foreign(file)
    recording = recording_of(recording, rate, labels=labels, units=units, transpose=transpose)
    if events is not None:
        recording = replace(recording, events=(*recording.events, *events))
    for note in doubts_of(recording):
        warnings.warn(note, DataWarning, stacklevel=2)
    check_file_id(None if canonical == "content" else canonical)
    if isinstance(file, (str, os.PathLike)):
        refuse(os.fspath(file), force)

    def size_of(encoded: Encoded) -> int:
        return put(recording, encoded, canonical, io.BytesIO()).file_size

    encoded = encode(recording, settings, progress=progress, threads=threads, size_of=size_of)
    with target(file, force) as stream:
        if not overview:
            return put(recording, encoded, canonical, stream)
        with readable(stream) as own:
            return put(recording, encoded, canonical, own, overview=True, threads=threads)


def put(
    recording: Recording,
    encoded: Encoded,
    canonical: int | Literal["content"] | None,
    stream: BinaryIO,
    *,
    overview: bool = False,
    threads: int | None = None,
) -> Summary:
    """Write an encoded recording into a stream, which can be read if it gets an overview."""
    extras = extras_of(recording)
    level = encoded.level
    observed = clock_chunks(recording, encoded.tracks)
    sizes = [len(payload) for _, payload in [*extras, *observed]]
    if max(sizes, default=0) > level.payload_size:
        level = LEVELS[2]
    layers, marks = layers_of(recording, len(encoded.tracks), encoded.cluster)
    tracks = [*encoded.tracks, *layers]
    made_by = encoder_of(recording, encoded.settings, encoded.decisions)
    if canonical == "content":
        more = [made_by.encode(), *(payload for _, payload in [*extras, *observed])]
        canonical = content_id(tracks, encoded.packets + marks, more)
    out = FileWriter(
        stream,
        level=level,
        file_id=canonical,
        recording_uuid=recording.uuid,
        epoch_ns=recording.epoch_ns,
        epoch_uncertainty_ns=recording.epoch_uncertainty_ns,
        encoder=made_by,
    )
    out.describe(tracks)
    for type_, payload in extras:
        out.chunk(type_, payload)
    for packets in clusters(tracks, encoded.packets + marks, encoded.cluster):
        out.cluster(packets, encoded.cluster_samples)
    for chunk in observed:
        out.chunk(*chunk)
    if encoded.settings.digest:
        out.digest(digests_of(encoded))
    overview_size = attach_overview(stream, out, threads) if overview else 0
    out.close()
    return Summary(
        out.offset,
        sum(len(packet.data) for packet in encoded.packets + marks),
        recording.sample_count,
        tuple(encoded.decisions),
        overview_size,
    )


def encoder_of(recording: Recording, settings: Settings, decisions: Sequence[Decision] = ()) -> str:
    """The text of HEAD on this program and its settings (SPEC 6.1)."""
    made_by = made_with(settings)
    if settings.preset == "perceptual":
        made_by += reached(decisions)
    earlier = recording.metadata.get("encoder")
    if earlier and lossy_preset(earlier):
        made_by += f"{INPUT}{earlier}"[:INPUT_SIZE]
    return made_by


def extras_of(recording: Recording) -> list[tuple[str, bytes]]:
    """Types and payloads of the chunks for metadata and attachments."""
    if not isinstance(recording.metadata, dict):
        raise ParameterError("metadata must be a JSON object, a dict in Python")
    # Its own encoder is in HEAD.
    metadata = {name: recording.metadata[name] for name in recording.metadata if name != "encoder"}
    described = [("mETa", build_metadata(metadata))] if metadata else []
    try:
        attached = [Attachment(name, *rest) for name, rest in recording.attachments.items()]
        return described + [("aTTc", build_attachment(each)) for each in attached]
    except (TypeError, AttributeError):
        raise ParameterError("attachments are {name: (media type, bytes)}") from None


_REACHED = (("snr_hf_db", "", " dB"), ("st_sim", "ST-SIM ", ""), ("level_db", "level ", " dB"))
"""Members of a decision on the quality of a texture, and what is printed around them."""


def reached(decisions: Sequence[Decision]) -> str:
    """The quality of textures, for the encoder's text: " (texture 20.1 to 20.3 dB, 1 exact)"."""
    exact = sum((each.snr_hf_db or 0) > EXACT_DB for each in decisions)
    decisions = [each for each in decisions if (each.snr_hf_db or 0) <= EXACT_DB]
    texts = []
    for name, before, after in _REACHED:
        found = [value for each in decisions if (value := getattr(each, name)) is not None]
        if found:
            ends = dict.fromkeys((f"{min(found):.4g}", f"{max(found):.4g}"))
            texts.append(before + " to ".join(ends) + after)
    if exact:
        texts.append(f"{exact} exact" if texts else "exact")
    return f"{REACHED}{', '.join(texts)})" if texts else ""


def doubts_of(recording: Recording) -> Iterator[str]:
    """Units that are not known, and labels that several channels have."""
    for unit in dict.fromkeys(channel.unit for channel in recording):
        if (note := unknown_unit(unit, kept=unit)) is not None:
            yield note
    for label, count in Counter(recording.labels).items():
        if count > 1 and label:
            yield f"{count} channels are called {label!r}; rec[{label!r}] will find none of them"


def content_id(tracks: Sequence[Track], packets: Sequence[Packet], extras: Sequence[bytes]) -> int:
    """A file id from all that a file says."""
    digest = hashlib.sha256()
    parts = [build_track(track) for track in tracks] + list(extras)
    for packet in packets:
        fields = b"%d %d %d" % (packet.track, packet.start, packet.span)
        parts += [fields, packet.data]
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return int.from_bytes(digest.digest()[:8], "little")


def layers_of(
    recording: Recording, first_id: int, seconds: Fraction
) -> tuple[list[Track], list[Packet]]:
    """A track for each layer of events, and their packets."""
    labels = [channel.label for channel in recording.channels]
    tracks: list[Track] = []
    packets: list[Packet] = []
    for layer, events in by_layer(recording.events).items():
        track = layer_track(first_id + len(tracks), layer, rate_of(events))
        rows = [coded(event, track.rate, labels) for event in events]
        packets += event_packets(track.id, rows, seconds * track.rate)
        tracks.append(track)
    return tracks, packets


def clock_chunks(recording: Recording, tracks: Sequence[Track]) -> list[tuple[str, bytes]]:
    """Types and payloads of cLOk and cMAp chunks, in the ticks of the first track of a channel."""
    first: dict[int | str | None, int | None] = {None: None}
    for track in tracks:
        for number in track.channels:
            first.setdefault(number, track.id)
    chunks = [
        ("cLOk", payload)
        for (clock, channel), seen in groupby(recording.clocks, lambda s: (s.clock, s.channel))
        for payload in build_clocks(
            clock, first[channel], ((s.tick, s.time_ns, s.uncertainty_ns) for s in seen)
        )
    ]
    maps: dict[tuple[str, int | None], bytes] = {}
    for one in recording.clock_maps:
        id_ = first[one.channel]
        payload = build_map(one.clock, id_, one.points)
        if maps.setdefault((one.clock, id_), payload) != payload:
            raise ParameterError(
                f"two channels of one vector have different maps of clock {one.clock!r}; keep one"
            )
    return chunks + [("cMAp", payload) for payload in maps.values()]


def clusters(
    tracks: Sequence[Track], packets: Sequence[Packet], seconds: Fraction
) -> Iterator[list[Packet]]:
    """Packets of one stretch of time after the other."""
    ticks = {track.id: (seconds * track.rate).as_integer_ratio() for track in tracks}
    by_time: dict[int, list[Packet]] = {}
    for packet in packets:
        n, d = ticks[packet.track]
        number = packet.start * d // n
        by_time.setdefault(number, []).append(packet)
    for number in sorted(by_time):
        yield by_time[number]


def digests_of(encoded: Encoded) -> dict[int, bytes]:
    """SHA-256 of what the decoder makes of each track (SPEC 11.5)."""
    decoders = {track.id: TrackDecoder(track, encoded.level) for track in encoded.tracks}
    found = {track.id: TrackDigest() for track in encoded.tracks}
    for packet in encoded.packets:
        decoder = decoders[packet.track]
        numbers = decoder.decode(packet)
        exact = decoder.decode_exact(packet, numbers)
        found[packet.track].update(packet.start, numbers if exact is None else exact)
    return {track: digest.digest() for track, digest in found.items()}
