"""What a damaged DATA payload still holds (SPEC clause 12, ``use``)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..errors import FormatError
from ..integers import build_varint
from ..limits import LEVELS, Level
from .cluster import (
    Entry,
    Packet,
    check_entry,
    packet_crc,
    parse_cluster,
    parse_count,
    parse_entry,
)
from .track import Track

PLACES = 1 << 16
"""Offsets at which the last entry is looked for."""
CHECKED_FACTOR, CHECKED_BASE = 8, 1 << 16
"""Checksums are taken of at most so many times the payload, and so many bytes, in that search."""
EVIDENCE = 4
"""Bytes of packets that hold which are as many bits as their CRC."""
TRIED = 4
"""Entries by which the first packet is looked for, the shortest packets first."""
ENTRY_SIZES = range(8, 23)
"""Bytes of an entry that keeps the limits of its fields."""
COUNT_SIZE = 3
"""Bytes of packet_count, at most."""


@dataclass(frozen=True)
class Hole:
    """A place in a cluster where packets are missing; ``after`` and ``before`` are the entries
    around it that hold, None where there is none; ``entry`` where it is known what is missing: a
    packet that holds but is not delivered."""

    after: Entry | None
    before: Entry | None
    offset: int
    size: int
    entry: Entry | None = None

    def tracks(self, known: Sequence[int]) -> list[int]:
        """Of the ``known`` tracks those whose packets stood here (DAT-002)."""
        low = self.after.track if self.after else 0
        high = self.before.track if self.before else 1 << 16
        return [track for track in known if low <= track <= high]


@dataclass(frozen=True)
class Placed:
    """An entry at ``place`` whose packet stands at ``at``: its CRC holds."""

    place: int
    entry: Entry
    at: int

    @property
    def row_stop(self) -> int:
        return self.place + len(self.entry.fields) + 4

    @property
    def stop(self) -> int:
        return self.at + self.entry.size

    def joins(self, after: Placed) -> bool:
        """Whether no bytes lie between this and the one after it."""
        return (self.row_stop, self.stop) == (after.place, after.at)


class Salvage:
    """The entries of one damaged payload that have a packet."""

    def __init__(
        self,
        payload: bytes,
        tracks: Mapping[int, Track],
        level: Level,
        seed: int,
        stops: Sequence[int],
    ) -> None:
        self.payload = payload
        self.seed = seed
        self.tracks = tracks
        self.level = level
        self.stops = stops
        self.found: dict[int, Placed] = {}
        """By the place of the entry."""
        self.rows: list[tuple[Entry, int]] = []
        """Entries from the front with their ends."""
        self.table_stop: int | None = self.read_rows()
        """None where the table cannot be read to its end."""
        self.whole = self.table_stop is not None

    def read_rows(self) -> int | None:
        try:
            count, position = parse_count(self.payload, self.level, 0)
            for _ in range(count):
                entry, position = parse_entry(self.payload, position, 0)
                self.rows.append((entry, position))
        except FormatError:
            return None
        return position

    def run(self) -> list[Placed]:
        """Every entry that can be placed, in order of the table."""
        if self.table_stop is not None:
            self.forwards(self.table_stop)
            for stop in self.stops:
                self.backwards(stop, self.table_stop)
        if not self.sure() or self.rows[-1][0].offset not in self.found:
            before = dict(self.found), self.table_stop, self.whole
            self.found.clear()
            self.search()
            if len(self.found) <= len(before[0]):
                self.found, self.table_stop, self.whole = before
        for place in sorted(self.found):
            self.entries_before(self.found[place])
        return [self.found[place] for place in sorted(self.found)]

    def sure(self) -> bool:
        """Whether the table ends where it seems to: a packet of a byte or two is found anywhere."""
        everything = self.whole and len(self.found) == len(self.rows)
        return everything or sum(placed.entry.size for placed in self.found.values()) >= EVIDENCE

    def search(self) -> None:
        last = self.last_entry()
        if last is not None:
            self.table_ends(last)
        else:
            self.table_stop = self.packets_begin()
        self.whole = False
        if self.table_stop is not None:
            self.forwards(self.table_stop)

    def begins(self, first: Placed) -> bool:
        """Whether no packet is missing before the first one that was found."""
        return first.at == self.table_stop and first.place <= COUNT_SIZE

    def ends(self, last: Placed) -> bool:
        """Whether no packet is missing after the last one that was found."""
        return last.row_stop == self.table_stop and last.stop in self.stops

    def holds(self, entry: Entry, at: int) -> bool:
        data = self.payload[at : at + entry.size]
        if len(data) != entry.size or packet_crc(self.seed, entry.fields, data) != entry.crc:
            return False
        try:
            check_entry(entry, self.level)
        except FormatError:
            return False
        return True

    def put(self, entry: Entry, at: int) -> bool:
        if self.holds(entry, at):
            self.found[entry.offset] = Placed(entry.offset, entry, at)
            return True
        return False

    def forwards(self, position: int) -> None:
        """One after the other from the end of the table."""
        for entry, row_stop in self.rows:
            if row_stop > position or entry.offset in self.found:
                return
            self.put(entry, position)
            position += entry.size

    def backwards(self, stop: int, table_stop: int) -> None:
        """From the last one on, up to one that is placed."""
        for entry, _ in reversed(self.rows):
            stop -= entry.size
            if stop < table_stop or (entry.size and entry.offset in self.found):
                return
            self.put(entry, stop)

    def table_ends(self, last: Placed) -> None:
        """The last entry is known, but for those of packets without bytes behind it."""
        self.found[last.place] = last
        self.table_stop = last.row_stop
        entry = self.entry_at(self.table_stop)
        while entry is not None and not entry.size and self.put(entry, last.stop):
            self.table_stop = self.found[entry.offset].row_stop
            entry = self.entry_at(self.table_stop)

    def entries_before(self, first: Placed) -> None:
        """Those before an entry that could not be read from the front, one after the other."""
        found = self.entry_before(first)
        while found is not None and found.place not in self.found:
            self.found[found.place] = found
            found = self.entry_before(found)

    def last_entry(self) -> Placed | None:
        """The last place with an entry whose packet ends where the payload may end."""
        found: Placed | None = None
        budget = CHECKED_FACTOR * len(self.payload) + CHECKED_BASE
        begins = {build_varint(track)[0] for track in self.tracks}
        end = min(len(self.payload), PLACES)
        place = 0
        while (place := place + 1) < end:
            entry = self.entry_at(place) if self.payload[place] in begins else None
            if entry is None or not entry.size:
                continue
            for stop in self.stops:
                at = stop - entry.size
                if at < place + len(entry.fields) + 4:
                    continue
                budget -= entry.size
                if budget < 0:
                    return found
                if self.holds(entry, at):
                    # All entries stand before all packets.
                    found, end = Placed(place, entry, at), min(end, at)
        return found

    def packets_begin(self) -> int | None:
        """Where the first packet stands: the last entry is damaged, but not those in front."""
        budget = CHECKED_FACTOR * len(self.payload) + CHECKED_BASE
        ahead, rows = 0, []
        for entry, row_stop in self.rows:
            if entry.track in self.tracks and entry.size:
                rows.append((entry.size, row_stop, ahead, entry))
            ahead += entry.size
        best: int | None = None
        most = 0
        for size, row_stop, ahead, entry in sorted(rows, key=lambda row: row[:3])[:TRIED]:
            for place in range(row_stop, min(len(self.payload) - size - ahead + 1, PLACES)):
                budget -= size
                if budget < 0:
                    return best
                if self.holds(entry, place + ahead):
                    budget -= min(sum(row.size for row, _ in self.rows), len(self.payload))
                    held = self.count_from(place)
                    if held > most:
                        best, most = place, held
            if most > 1:
                break
        return best

    def count_from(self, position: int) -> int:
        """How many packets hold one after the other from here."""
        held = 0
        for entry, _ in self.rows:
            held += self.holds(entry, position)
            position += entry.size
        return held

    def entry_before(self, after: Placed) -> Placed | None:
        """The one whose entry and whose packet end where those of ``after`` begin."""
        for size in ENTRY_SIZES:
            place = after.place - size
            entry = self.entry_at(place) if place > 0 else None
            if entry is None or len(entry.fields) + 4 != size:
                continue
            if after.at - entry.size >= after.row_stop and self.holds(entry, after.at - entry.size):
                return Placed(place, entry, after.at - entry.size)
        return None

    def entry_at(self, place: int) -> Entry | None:
        try:
            entry, _ = parse_entry(self.payload, place, 0)
        except FormatError:
            return None
        return entry if entry.track in self.tracks else None


def held_size(payload: bytes, seed: int) -> int:
    """Bytes of the packets that hold, and of their entries; they are placed one after the other
    from the end of the table on."""
    salvage = Salvage(payload, {}, LEVELS[2], seed, ())
    if salvage.table_stop is not None:
        salvage.forwards(salvage.table_stop)
    return sum(
        placed.row_stop - placed.place + placed.entry.size for placed in salvage.found.values()
    )


def is_cluster(payload: bytes, tracks: Mapping[int, Track], level: Level, seed: int) -> bool:
    """Whether every packet holds, to the last byte."""
    try:
        for _ in parse_cluster(payload, tracks, level, 0, seed):
            pass
    except FormatError:
        return False
    return True


def salvage_cluster(
    payload: bytes,
    tracks: Mapping[int, Track],
    level: Level,
    base: int,
    seed: int,
    sizes: Sequence[int] = (),
) -> Iterator[Packet | Hole]:
    """Packets whose CRC holds, in order of the table, and where others are missing.

    ``sizes`` are those that the payload may have: by its header, and up to the next one.
    """
    salvage = Salvage(payload, tracks, level, seed, sizes or (len(payload),))
    found = salvage.run()
    before: Placed | None = None
    samples = 0
    sure, anywhere = salvage.sure(), Hole(None, None, base, len(payload))
    for placed in found:
        entry, known = placed.entry, tracks.get(placed.entry.track)
        joined = before.joins(placed) if before else salvage.begins(placed)
        if not sure:
            # So few bytes may stand anywhere: they do not tell what is missing around them.
            yield anywhere
        elif not joined:
            yield hole_between(before, placed, base, salvage.stops[0])
        before = placed
        samples += known.weight(entry.span, entry.size) if known else 0
        if known is None or samples > level.cluster_samples:
            yield Hole(None, None, base + placed.at, entry.size, entry)
        else:
            data = payload[placed.at : placed.stop]
            yield Packet(entry.track, entry.start, entry.span, data, base + placed.at)
    if before is None or not sure:
        yield anywhere
    elif not salvage.ends(before):
        yield hole_between(before, None, base, min(salvage.stops[0], len(payload)))


def hole_between(before: Placed | None, after: Placed | None, base: int, end: int) -> Hole:
    start = before.stop if before else 0
    stop = after.at if after else end
    return Hole(
        before.entry if before else None,
        after.entry if after else None,
        base + start,
        max(stop - start, 0),
    )
