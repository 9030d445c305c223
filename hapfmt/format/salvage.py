"""What a damaged DATA payload still holds (SPEC clause 14, ``salvage``)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ..errors import FormatError
from ..limits import LEVELS, Level
from .cluster import Packet, Row, TableHead, check_times, packet_crc, parse_rows, parse_table_head
from .track import Track


@dataclass(frozen=True)
class Hole:
    """A place in a cluster where packets are missing; ``after`` and ``before`` are the rows around
    it that are kept, None where there is none; ``row`` where it is known what is missing: a packet
    that holds but is not delivered."""

    after: Row | None
    before: Row | None
    offset: int
    size: int
    row: Row | None = None

    def tracks(self, known: Sequence[int]) -> list[int]:
        """Of the ``known`` tracks those whose packets stood here (DAT-002)."""
        low = self.after.track if self.after else 0
        high = self.before.track if self.before else 1 << 16
        return [track for track in known if low <= track <= high]


class Salvage:
    """The rows of one damaged payload, and where the packets of those that are kept stand."""

    def __init__(self, payload: bytes, level: Level, seed: int) -> None:
        self.payload, self.level, self.seed = payload, level, seed
        self.head: TableHead | None = None
        self.rows: list[Row] = []
        self.kept: dict[int, int] = {}
        """Offset of the packet, by the number of its row."""
        try:
            self.head = parse_table_head(payload, level, 0)
        except FormatError:
            return
        self.rows = list(parse_rows(payload, self.head))

    def place_forwards(self) -> None:
        """One after the other from the end of the table on."""
        position = self.head.table_size if self.head else 0
        for number, row in enumerate(self.rows):
            self.keep(number, position)
            position += row.size

    def place_backwards(self, stop: int) -> None:
        """The last one ends at ``stop``, and so on; without the last row nothing tells where."""
        if self.head is None or len(self.rows) < self.head.packet_count:
            return
        for number, row in reversed(list(enumerate(self.rows))):
            stop -= row.size
            self.keep(number, stop)

    def keep(self, number: int, offset: int) -> None:
        if number not in self.kept and self.holds(self.rows[number], offset):
            self.kept[number] = offset

    def holds(self, row: Row, offset: int) -> bool:
        """Whether this is the packet of the row, by its CRC; it is so for no row if packet_count is
        wrong."""
        assert self.head is not None
        if offset < 0 or offset + row.size > len(self.payload):
            return False
        try:
            check_times(row, self.level, 0)
        except FormatError:
            return False
        data = self.payload[offset : offset + row.size]
        return packet_crc(self.seed, self.head.packet_count, row, data) == row.crc


def held_size(payload: bytes, seed: int) -> int:
    """Bytes of the packets that hold, placed forwards, and of their rows."""
    salvage = Salvage(payload, LEVELS[2], seed)
    salvage.place_forwards()
    row_size = salvage.head.row_size if salvage.head else 0
    return sum(row_size + salvage.rows[number].size for number in salvage.kept)


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
    salvage = Salvage(payload, level, seed)
    salvage.place_forwards()
    sizes = sizes or (len(payload),)
    for size in sizes:
        salvage.place_backwards(size)
    if salvage.head is None or not salvage.kept:
        yield Hole(None, None, base, len(payload))
        return
    after: Row | None = None
    number, stop, samples = -1, 0, 0
    for each in sorted(salvage.kept):
        row, offset = salvage.rows[each], salvage.kept[each]
        if each > number + 1:
            yield Hole(after, row, base + stop, max(offset - stop, 0))
        after, number, stop = row, each, offset + row.size
        track = tracks.get(row.track)
        samples += track.weight(row.span, row.size) if track else 0
        if track is None or samples > level.cluster_samples:
            yield Hole(None, None, base + offset, row.size, row)
        else:
            yield Packet(row.track, row.start, row.span, payload[offset:stop], base + offset)
    if number + 1 < salvage.head.packet_count:
        end = min(sizes[0], len(payload))
        yield Hole(after, None, base + stop, max(end - stop, 0))
