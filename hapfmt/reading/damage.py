"""The damage report: findings in a file and the spans that are lost (docs/spec/recovery.md).

The lost spans of each track follow from the packets around the damage and from the index. The
indexes also show which DATA chunks a damaged file has lost, and their times.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

from ..errors import HARMLESS, FormatError
from ..format.extras import MS_LIMIT, NS_LIMIT, Foot, IndexEntry, parse_index
from ..format.track import Track
from ..format.walk import Finding, read_chunk
from ..numbers import counted
from .catalogue import Catalogue, ChannelRef

ANYWHERE = 1 << 63
"""Bytes may have been inserted or removed: an index may have moved."""


class Times(NamedTuple):
    """Milliseconds that contain lost packets; ``stop`` None: the end is unknown."""

    start: int = 0
    stop: int | None = None


UNKNOWN = Times()
NOTHING = Times(0, 0)


class Timeline:
    """What the intact indexes say of chunks, by their sequence numbers."""

    def __init__(self, catalogue: Catalogue) -> None:
        self.listed: dict[int, IndexEntry] = {}
        for ref in catalogue.chunks:
            chunk = read_chunk(catalogue.source, ref.offset) if ref.type == "iNDX" else None
            if chunk is None or not chunk.intact:
                continue
            try:
                index = parse_index(chunk.payload, ANYWHERE, chunk.payload_offset)
            except FormatError as error:
                message, rule = f"iNDX chunk: {error.message}", error.requirement or "IDX-002"
                catalogue.lose("bad-chunk", ref.offset, chunk.stop - chunk.offset, message, rule)
                continue
            self.listed |= dict(enumerate(index.entries, index.first_sequence))
        self.found = sorted({ref.sequence for ref in catalogue.chunks if ref.sequence is not None})
        self.gone = sorted(self.listed.keys() - set(self.found))
        """Sequence numbers of chunks that are listed and were not found."""

    def of(self, sequence: int) -> Times:
        """When the packets of the DATA chunk with this number are."""
        entry = self.listed.get(sequence)
        return UNKNOWN if entry is None or entry.type != "DATA" else times_of([entry])

    def missing(self, low: int, high: int) -> Times:
        """The same for the chunks between two numbers that were not found."""
        if high <= low + 1:
            return NOTHING
        count = high - low - 1
        count -= bisect_left(self.found, high) - bisect_right(self.found, low)
        gone = self.gone[bisect_right(self.gone, low) : bisect_left(self.gone, high)]
        if len(gone) < count:
            return UNKNOWN
        return times_of([entry for n in gone if (entry := self.listed[n]).type == "DATA"])


def times_of(entries: list[IndexEntry]) -> Times:
    if not entries:
        return NOTHING
    stop = max(entry.stop_ms for entry in entries)
    return Times(min(entry.start_ms for entry in entries), stop if stop < MS_LIMIT else None)


class LostSpan(NamedTuple):
    """Ticks of a track that damage took: start <= t < stop; stop None: their number is not
    known.
    ``offset``: where the damage is, None where that is not known."""

    track: int
    start: int
    stop: int | None
    offset: int | None = None


@dataclass
class OpenLoss:
    """Ticks that may be lost of one track; the next packet of it tells more."""

    start: int
    stop: int | None
    offset: int


class Losses:
    """Grows while packets go by in order; ``spans`` are the result."""

    def __init__(self, tracks: Mapping[int, Track], foot: Foot | None) -> None:
        self.tracks = tracks
        known = foot is not None and foot.duration_ns < NS_LIMIT
        self.duration_ns = foot.duration_ns if foot and known else None
        self.spans: list[LostSpan] = []
        self.open: dict[int, OpenLoss] = {}

    def suspect(self, tracks: Iterable[int], times: Times, offset: int) -> None:
        """Packets of these tracks within these times may be lost."""
        if times.stop == 0:
            return
        for id_ in tracks:
            rate = self.tracks[id_].rate
            start, stop = ticks(times, rate)
            if stop is None and self.duration_ns is not None:
                stop = int(self.duration_ns * rate // 10**9)
            self.widen(id_, start, stop, offset)

    def widen(self, track: int, start: int, stop: int | None, offset: int) -> None:
        """These ticks of the track may be lost, but for those that other packets have."""
        hole = self.open.setdefault(track, OpenLoss(start, stop, offset))
        hole.start = min(hole.start, start)
        hole.stop = None if None in (hole.stop, stop) else max(hole.stop or 0, stop or 0)

    def settle(self, track: int, last: int, start: int) -> None:
        """The track's next packet starts at ``start``, the one before ended at ``last``."""
        hole = self.open.pop(track, None)
        if hole is not None:
            low = max(last, hole.start)
            high = start if hole.stop is None else min(start, hole.stop)
            if low < high:
                self.spans.append(LostSpan(track, low, high, hole.offset))

    def end(self, track: int, last: int) -> None:
        """No packet of the track follows."""
        hole = self.open.pop(track, None)
        if hole is not None:
            low = max(last, hole.start)
            if hole.stop is None or low < hole.stop:
                self.spans.append(LostSpan(track, low, hole.stop, hole.offset))

    def lose(self, track: int, start: int, stop: int, offset: int) -> None:
        """Exactly these ticks; what follows on the last loss of the track is one with it."""
        last = self.spans[-1] if self.spans else None
        if last and (last.track, last.stop) == (track, start) and last.offset == offset:
            self.spans[-1] = last._replace(stop=stop)
        else:
            self.spans.append(LostSpan(track, start, stop, offset))


def lost_within(
    lost: Iterable[LostSpan], ranges: Mapping[int, tuple[int, int]], tracks: Mapping[int, Track]
) -> list[LostSpan]:
    """The losses of these tracks cut to these ticks, with those of tracks without a description.
    A loss up to an unknown end stays one, from its beginning."""
    found = []
    for span in lost:
        first, last = ranges.get(span.track, (0, 0) if span.track in tracks else (0, 1 << 63))
        if span.stop is None and span.start < last:
            found.append(span)
        elif span.stop is not None and max(first, span.start) < min(last, span.stop):
            cut = max(first, span.start), min(last, span.stop)
            found.append(span._replace(start=cut[0], stop=cut[1]))
    return found


def ticks(times: Times, rate: Fraction) -> tuple[int, int | None]:
    """First tick, and the one after the last, of a track that lie within some milliseconds."""
    n, d = rate.numerator, rate.denominator * 1000
    return times.start * n // d, None if times.stop is None else -(-times.stop * n // d)


SHOWN = 4
"""Channels named in a line."""
OF_PAYLOADS = ("bad-table", "bad-packet", "overlap")
"""Findings within a chunk."""
SHORTEST = Fraction(1, 10**9)
"""Seconds."""
WORDS = {
    "bad-signature": "wrong first bytes",
    "garbage": "foreign bytes",
    "other-file": "parts of another file",
    "duplicate-chunk": "a chunk twice",
    "missing-chunk": "missing chunks",
    "out-of-order": "chunks in the wrong order",
    "truncated": "a chunk cut short",
    "bad-payload": "wrong checksum",
    "bad-table": "a damaged table of packets",
    "bad-packet": "damaged packets",
    "overlap": "packets that overlap",
    "bad-chunk": "a chunk that breaks a rule",
    "missing-head": "no header chunk",
    "lost-base": "an HF track without its LF track",
    "bad-digest": "wrong SHA-256 checksum",
}
"""Codes of findings, for people."""


class LostPart(NamedTuple):
    """A part of channels that damage took, in seconds; ``stop`` None: up to an unknown end, both
    None: of an unknown rate."""

    labels: tuple[str, ...]
    start: float | None
    stop: float | None


@dataclass(frozen=True)
class DamageReport:
    """What is wrong with a file, and what that took: every verb shows this report and no other.

    ``spans`` are the lost spans of the tracks that were read; ``numbers`` the channels that were
    read, None: all. ``partial``: only a part of the file was read.
    """

    catalogue: Catalogue
    spans: Sequence[LostSpan]
    numbers: Collection[int] | None = None
    partial: bool = False

    def __repr__(self) -> str:
        """What the command line prints."""
        return "\n  ".join([f"Damage: {self.headline() or 'none'}", *self.lines()])

    def as_json(self) -> dict[str, Any]:
        """The JSON object of docs/spec/recovery.md."""
        catalogue = self.catalogue
        damages: list[dict[str, Any]] = [
            {**finding.as_json(), "lost": []} for finding in catalogue.findings
        ]
        by_offset: dict[int | None, list[dict[str, Any]]] = {}
        for damage in damages:
            by_offset.setdefault(damage["offset"], damage["lost"])
        apart: list[dict[str, Any]] = []
        channels = by_track(catalogue)
        for span in self.spans:
            numbers = [ref.number for ref in channels.get(span.track, [])]
            by_offset.get(span.offset, apart).append(span_json(catalogue, span, numbers))
        return {
            "damages": damages,
            "lost": apart,
            "byte_count": damaged_bytes(catalogue.findings, catalogue.source.size),
            "channels": self.channels(),
        }

    def channels(self) -> list[dict[str, Any]]:
        """At most how many ticks of each channel are lost in full band."""
        channels = by_track(self.catalogue)
        spans: dict[int, list[tuple[int, int]]] = {}
        open_ended: set[int] = set()
        for span in self.spans:
            for ref in channels.get(span.track, []):
                if span.stop is None:
                    open_ended.add(ref.number)
                else:
                    spans.setdefault(ref.number, []).append((span.start, span.stop))
        out = []
        for ref in self.catalogue.channels:
            if self.numbers is not None and ref.number not in self.numbers:
                continue
            lost = joined(sorted(spans.get(ref.number, [])))
            count = sum(stop - start for start, stop in lost)
            known = ref.number not in open_ended
            out.append(
                {
                    "channel": ref.number,
                    "label": ref.label,
                    "lost_ticks": count if known else None,
                    "lost_s": float(count / ref.track.rate) if known else None,
                }
            )
        return out

    def headline(self) -> str:
        """How many channels lost samples; empty where nothing is damaged."""
        numbers = {row["channel"] for row in self.channels()}
        channels = by_track(self.catalogue)
        lossy = {
            ref.number
            for track, *_ in seconds_lost(self.catalogue, self.spans, set())
            for ref in channels.get(track.id, [])
        }
        if lossy & numbers:
            count = len(lossy & numbers)
            return f"{count} of {counted(len(numbers), 'channel')} lost samples to damage"
        damaged = self.catalogue.harmed
        return f"damaged, {self.nothing_known()}" if damaged else ""

    def nothing_known(self) -> str:
        """Say that damage took no sample, as far as is known."""
        if not self.catalogue.tracks:
            return "nothing can be read; what was in it is not known"
        return f"no sample {'of this part ' * self.partial}is known to be lost"

    def parts(self) -> list[LostPart]:
        """The spans by label and seconds."""
        channels, found = by_track(self.catalogue), []
        for span in self.spans:
            track = self.catalogue.tracks.get(span.track)
            names = [ref.label or f"channel {ref.number}" for ref in channels.get(span.track, [])]
            names = names or [name_of(track) if track else f"track {span.track}"]
            known = span_json(self.catalogue, span, [])
            found.append(LostPart(tuple(names), known["start_s"], known["stop_s"]))
        return found

    def lines(self) -> list[str]:
        """For people: the damage in one line, what it took, and what is unknown."""
        catalogue, lines = self.catalogue, []
        found = [finding for finding in catalogue.findings if finding.code not in HARMLESS]
        if found:
            kinds = dict.fromkeys(WORDS.get(finding.code, finding.code) for finding in found)
            areas = damaged_areas(found)
            places = "1 place" if len(areas) == 1 else f"{len(areas)} places"
            end = catalogue.source.size
            size = sum(min(stop, end) - min(start, end) for start, stop in areas)
            lines.append(f"damage in {places}, {size} bytes: {', '.join(kinds)}")
        way = "hapfmt decode --file-id reads the other"
        lines += [f"{each.message}; {way}" for each in found if each.code == "other-file"]
        losses = self.losses()
        lines += losses
        if found and not losses:
            lines.append(self.nothing_known())
        if found and self.partial:
            lines.append("this is about the part that was read; hapfmt verify checks all")
        if not catalogue.closed:
            last = float(last_known(catalogue, self.spans))
            lines.append(f"the file was not closed; what came after {last:.6g} s is unknown")
        return lines

    def losses(self) -> list[str]:
        """For people: equal losses in one line, with channels and seconds.

        An index gives times in milliseconds, and the end of a track is unknown. So a span may begin
        where the recording ends, as far as the file tells: it is left out here.
        """
        channels = by_track(self.catalogue)
        undescribed: set[int] = set()
        groups: dict[tuple[Fraction, Fraction | None], dict[str, set[str]]] = {}
        for track, start, stop in seconds_lost(self.catalogue, self.spans, undescribed):
            refs = channels.get(track.id, [])
            names = [ref.label or f"channel {ref.number}" for ref in refs] or [name_of(track)]
            group = groups.setdefault((start, stop), {})
            for name in names:
                group.setdefault(name, set()).add(track.kind)
        lines = []
        for (start, stop), group in groups.items():
            end = "the end" if stop is None else f"{float(stop):.6g} s"
            for kinds, suffix in ((["lf"], " (LF)"), (["hf"], " (HF)"), (None, "")):
                names = [
                    name for name, own in group.items()
                    if (list(own) == kinds if kinds else list(own) not in (["lf"], ["hf"]))
                ]  # fmt: skip
                if len(names) > SHOWN:
                    few = f"{len(names)} channels ({', '.join(names[:SHOWN])} ...)"
                    lines.append(f"lost in {few}{suffix}: {float(start):.6g} s to {end}")
                elif names:
                    few = ", ".join(names)
                    lines.append(f"lost: {few}{suffix} from {float(start):.6g} s to {end}")
        if undescribed:
            ids = sorted(undescribed)
            shown = ", ".join(map(str, ids[:SHOWN])) + (" ..." if len(ids) > SHOWN else "")
            what = f"track {shown}" if len(ids) == 1 else f"{len(ids)} tracks ({shown})"
            lines.append(f"lost: {what}, whose description is lost")
        return lines


def by_track(catalogue: Catalogue) -> dict[int, list[ChannelRef]]:
    """The channels that each track is a part of."""
    found: dict[int, list[ChannelRef]] = {}
    for ref in catalogue.channels:
        for track in ref.tracks:
            found.setdefault(track.id, []).append(ref)
    return found


def span_json(catalogue: Catalogue, span: LostSpan, channels: list[int]) -> dict[str, Any]:
    track = catalogue.tracks.get(span.track)
    rate = track.rate if track else None
    return {
        "track": span.track,
        "channels": channels,
        "start": span.start,
        "stop": span.stop,
        "start_s": float(span.start / rate) if rate else None,
        "stop_s": float(span.stop / rate) if rate and span.stop is not None else None,
    }


def damaged_areas(findings: Iterable[Finding]) -> list[tuple[int, int]]:
    """The bytes that damage took; areas that touch become one. A chunk with a wrong checksum counts
    with its damaged packets alone, since the others can be read."""
    found = [f for f in findings if f.code not in HARMLESS]
    inner = sorted(f.offset for f in found if f.code in OF_PAYLOADS)
    areas = []
    for each in found:
        stop = each.offset + each.size
        within = bisect_left(inner, stop) - bisect_right(inner, each.offset)
        if each.code != "bad-payload" or not within:
            areas.append((each.offset, stop))
    return [*joined(sorted(areas))]


def damaged_bytes(findings: Iterable[Finding], size: int) -> int:
    places = sorted((f.offset, min(f.offset + f.size, size)) for f in findings if f.size)
    return sum(stop - start for start, stop in joined(places))


def joined(spans: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Ordered spans, those that overlap or touch as one."""
    current: tuple[int, int] | None = None
    for start, stop in spans:
        if current is not None and start <= current[1]:
            current = current[0], max(current[1], stop)
            continue
        if current is not None:
            yield current
        current = start, stop
    if current is not None:
        yield current


def open_starts(catalogue: Catalogue, lost: Iterable[LostSpan]) -> list[Fraction]:
    """Where what is left of a track ends, in seconds. How much follows is unknown."""
    return [
        span.start / catalogue.tracks[span.track].rate
        for span in lost
        if span.stop is None and span.track in catalogue.tracks
    ]


def last_known(catalogue: Catalogue, lost: Iterable[LostSpan]) -> Fraction:
    """Seconds to the end of what is left; a chunk that is cut short has no times of its own."""
    return max([catalogue.duration, *open_starts(catalogue, lost)])


def seconds_lost(
    catalogue: Catalogue, lost: Sequence[LostSpan], undescribed: set[int]
) -> Iterator[tuple[Track, Fraction, Fraction | None]]:
    """Spans in seconds within the recording, those that touch as one, in order of time; to
    ``undescribed`` go the tracks that have no rate."""
    end = Fraction(catalogue.foot.duration_ns, 10**9) if catalogue.foot else None
    starts = open_starts(catalogue, lost)
    # Where all of them end there, something was lost all the same.
    furthest = last_known(catalogue, lost) if len(set(starts)) > 1 else None
    spans: dict[int, list[tuple[int, int | None]]] = {}
    for span in lost:
        if span.track in catalogue.tracks:
            spans.setdefault(span.track, []).append((span.start, span.stop))
        else:
            undescribed.add(span.track)
    found = []
    for id_, own in spans.items():
        track = catalogue.tracks[id_]
        far = 1 << 63
        for first, last in joined(sorted((a, far if b is None else b) for a, b in own)):
            start, stop = first / track.rate, None if last >= far else last / track.rate
            known = furthest if end is None and stop is None else end
            # The footer rounds up to a nanosecond.
            if known is not None and start > 0 and start + SHORTEST >= known:
                continue
            if end is not None and stop is not None:
                stop = min(stop, end)
            found.append((track, start, stop))
    yield from sorted(found, key=lambda each: each[1])


def name_of(track: Track) -> str:
    """The name of a track that is part of no channel."""
    if track.kind == "events" and track.components and track.components[0].label:
        return f"events {track.components[0].label}"
    return "events" if track.kind == "events" else f"track {track.id}"
