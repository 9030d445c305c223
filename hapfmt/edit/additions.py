"""Additions to an existing file, in place or in a copy; everything already in it stays unchanged.

* Events (SPEC 9.9).
* Attached files, and their extraction (SPEC 11.4).
* Members of the metadata (SPEC 11.3).
"""

from __future__ import annotations

import mimetypes
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ..codecs.events import coded, event_packets, layer_track, rate_of
from ..errors import ParameterError, unknown
from ..files import atomic_write, refuse
from ..format.cluster import Packet
from ..format.extras import MEDIA_TYPE, Attachment, build_attachment, build_metadata
from ..format.track import Track
from ..limits import LAST_TRACK_ID
from ..numbers import counted
from ..reading.catalogue import Catalogue
from ..recording import Event, by_layer
from ..writing.filewriter import FileWriter
from ..writing.start import open_append
from .making import Input, Original, Output, open_original, opened, refuse_output

PIECE = 1 << 20
"""Bytes copied in one go."""


class OpenEnd(NamedTuple):
    """A writer at the end of the part that ``catalogue`` knows; ``note``: what has been cut off the
    end of the file first."""

    writer: FileWriter
    catalogue: Catalogue
    note: str | None


@contextmanager
def appended(file: Input, out: Output | None, *, force: bool) -> Iterator[OpenEnd]:
    """A file that is appended to at the end of the block; ``out`` None: in place, under its lock.

    Raises ParameterError where another program writes the file, or it is damaged before its end.
    """
    if out is None:
        if not isinstance(file, (str, os.PathLike)):
            raise ParameterError("a pipe cannot be changed in place: give an output file")
        with open_append(file) as appending:
            yield OpenEnd(appending.writer, appending.catalogue, appending.note)
        return
    refuse_output(out, force)
    with Original(file) as original, opened(out, force) as stream:
        source = original.source
        for offset in range(0, source.size, PIECE):
            stream.write(source.read_at(offset, PIECE))
        writer = FileWriter.resume(stream, original.catalogue)
        yield OpenEnd(writer, original.catalogue, None)
        writer.close()


def annotate(
    file: Input, events: Sequence[Event], out: Output | None = None, *, force: bool = False
) -> list[str]:
    """Append events to a file, or to a copy of it at ``out``; returns notes.

    Events join the layer of their name, at its rate, or make a new layer. ``Event.channel`` is a
    label or a number of the file. The file's other contents do not change.
    """
    if not events:
        raise ParameterError("nothing to annotate")
    with appended(file, out, force=force) as (writer, catalogue, note):
        notes = [note] if note else []
        end = catalogue.duration
        late = [event for event in events if event.time > end]
        if late:
            notes.append(
                f"{len(late)} of {len(events)} events begin after the end of the recording "
                f"({float(end):g} s)"
            )
        labels = [ref.label for ref in catalogue.channels]
        known = known_layers(catalogue)
        made: list[Track] = []
        packets: list[Packet] = []
        for layer, own in by_layer(with_channel_number(event, labels) for event in events).items():
            track = known.get(layer)
            if track is None:
                id_ = max([*catalogue.tracks, -1]) + 1 + len(made)
                if id_ > LAST_TRACK_ID:
                    raise ParameterError("no room for another layer: 65 534 tracks")
                track = layer_track(id_, layer, rate_of(own))
                made.append(track)
            packets += event_packets(track.id, [coded(event, track.rate, labels) for event in own])
            between = [
                event
                for event in own
                if {(x * track.rate).denominator for x in (event.time, event.duration)} != {1}
            ]
            if between:
                notes.append(
                    f"{counted(len(between), 'event')} of layer {layer!r} moved to the nearest of "
                    f"its {track.rate} ticks a second"
                )
        writer.describe(made)
        writer.cluster(packets)
    return notes


def with_channel_number(event: Event, labels: Sequence[str]) -> Event:
    """A text that is a number and not a label is taken as a channel number."""
    channel = event.channel
    if isinstance(channel, str) and channel not in labels and channel.isascii():
        return replace(event, channel=int(channel)) if channel.isdecimal() else event
    return event


def known_layers(catalogue: Catalogue) -> dict[str, Track]:
    """Event tracks by name, the first of each."""
    return {
        track.components[0].label: track
        for track in reversed(catalogue.layers)
        if track.unsupported is None
    }


def attach(
    file: Input,
    attachments: Sequence[Attachment],
    out: Output | None = None,
    *,
    force: bool = False,
) -> list[str]:
    """Append attachments to a file, or to a copy of it at ``out``; returns notes.

    The file's other contents do not change. Raises ParameterError if an attachment is too large for
    the file's level, or another program writes the file; then no attachment is appended.
    """
    payloads = [build_attachment(attachment) for attachment in attachments]
    if not payloads:
        raise ParameterError("nothing to attach")
    with appended(file, out, force=force) as (writer, catalogue, note):
        limit = writer.level.payload_size
        for attachment, payload in zip(attachments, payloads, strict=True):
            if len(payload) > limit:
                raise ParameterError(
                    f"{attachment.name}: {len(payload)} bytes with its name are above {limit}, the "
                    f"limit of level {writer.level.number}"
                    + ("; subset with level 2 writes a file with more room" * (limit < 1 << 24))
                )
        notes = [note] if note else []
        taken = Counter(each.name for each in catalogue.attachments.values())
        for attachment in attachments:
            writer.attach(attachment)
            taken[attachment.name] += 1
            number = taken[attachment.name]
            if number > 1:
                notes.append(
                    f"the file already has an attachment {attachment.name!r}; the new one is "
                    f"listed as '{attachment.name} ({number})'"
                )
    return notes


def attachment_of(
    path: str | os.PathLike[str], *, name: str | None = None, media_type: str | None = None
) -> Attachment:
    """Read the file at ``path`` as an attachment, by default under its own name.

    Without ``media_type`` the name gives the media type.
    """
    known = Path(path).name if name is None else name
    guessed = MEDIA_TYPE if known.endswith(".hapf") else mimetypes.guess_type(known)[0] or ""
    return Attachment(known, guessed if media_type is None else media_type, Path(path).read_bytes())


def extract(
    file: Input | Original,
    names: Sequence[str] | None = None,
    folder: str | os.PathLike[str] = ".",
    *,
    force: bool = False,
) -> list[Path]:
    """Write attachments, all or some by name, into a folder; returns their paths.

    A name from a file is never used as a path (SPEC ATT-002): only its last part is used, with a
    number if two are alike.
    """
    with open_original(file, scan=False) as original:
        known = original.attachments
        for name in names or ():
            if name not in known:
                raise ParameterError(unknown("attachment", name, known.keys()))
        chosen = [known[name] for name in (known if names is None else dict.fromkeys(names))]
    taken: set[str] = set()
    paths = []
    for attachment in chosen:
        path = Path(folder) / free_name(attachment.safe_name, taken)
        taken.add(path.name.casefold())
        refuse(os.fspath(path), force)
        paths.append(path)
    for path, attachment in zip(paths, chosen, strict=True):
        with atomic_write(path, force=force) as stream:
            stream.write(attachment.content)
    return paths


def free_name(name: str, taken: set[str]) -> str:
    """The name, with a number before its suffix if it exists in any case of its letters."""
    candidate, number = name, 1
    while candidate.casefold() in taken:
        number += 1
        candidate = f"{Path(name).stem} ({number}){Path(name).suffix}"
    return candidate


def set_metadata(
    file: Input, members: Mapping[str, Any], out: Output | None = None, *, force: bool = False
) -> list[str]:
    """Append members, JSON values, to the metadata of a file, or of a copy of it at ``out``.

    They replace members of the same name; the earlier values stay in the file. Returns notes.
    """
    if not members:
        raise ParameterError("nothing to set")
    payload = build_metadata(dict(members))
    with appended(file, out, force=force) as (writer, _, note):
        writer.chunk("mETa", payload)
    return [note] if note else []
