"""Clause 12.1, salvage: what is kept of a damaged DATA chunk, read from the page alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import forge as f
from page import BrokenRule, varint

from .component import Case, Component

REACH = 65536
TRACKS = frozenset(range(8))
"""Described, of one component each."""


@dataclass(frozen=True)
class Entry:
    at: int
    stop: int
    track: int
    size: int
    start: int
    span: int
    crc: int


def entry_at(payload: bytes, at: int) -> Entry | None:
    fields, stop = [], at
    try:
        for _ in range(4):
            value, stop = varint(payload, stop)
            fields.append(value)
    except BrokenRule:
        return None
    if stop + 4 > len(payload):
        return None
    crc = int.from_bytes(payload[stop : stop + 4], "little")
    return Entry(at, stop + 4, *fields, crc)


class Salvage:
    """``payload``: all bytes from the payload on; ``ends``: where it may end."""

    def __init__(self, payload: bytes, size: int, following: int | None, tracks=TRACKS):
        self.tracks = tracks
        self.ends = [size]
        if following is not None and following != size and following - size <= REACH:
            self.ends.append(following)
        self.payload = payload[: max(self.ends)]
        self.front: list[Entry] = []
        self.kept: dict[Entry, int] = {}

    def holds(self, entry: Entry, at: int) -> bool:
        data = self.payload[at : at + entry.size]
        if at < 0 or len(data) < entry.size:
            return False
        fields = self.payload[entry.at : entry.stop - 4]
        good = 1 <= entry.span <= 2**24 and entry.start + entry.span <= 2**48
        return good and f.file_crc(fields + data) == entry.crc

    def run(self) -> list[tuple[Entry, int]]:
        """(entry, offset of its packet) of those kept, in order of the entries."""
        whole = self.by_table()
        sizes = sum(entry.size for entry in self.kept)
        last = bool(self.front) and self.front[-1] in self.kept
        sure = whole and (len(self.kept) == len(self.front) or (last and sizes >= 4))
        if not sure:
            first, self.kept = self.kept, {}
            self.search()
            if len(self.kept) <= len(first):
                self.kept = first
        self.before()
        return sorted(self.kept.items(), key=lambda pair: pair[0].at)

    def by_table(self) -> bool:
        """1; whether all entries were read."""
        try:
            count, at = varint(self.payload, 0)
        except BrokenRule:
            return False
        if not 1 <= count <= 2**14:
            return False
        while len(self.front) < count:
            entry = entry_at(self.payload, at)
            if entry is None:
                return False
            self.front.append(entry)
            at = entry.stop
        table = at
        for entry in self.front:
            if self.holds(entry, at):
                self.kept[entry] = at
            at += entry.size
        for end in self.ends:
            at = end
            for entry in reversed(self.front):
                at -= entry.size
                if at < table or (self.kept.get(entry) is not None and entry.size > 0):
                    break
                if self.holds(entry, at):
                    self.kept[entry] = at
        return True

    def useful(self, entry: Entry | None) -> bool:
        return entry is not None and entry.track in self.tracks and entry.size > 0

    def empty(self, entry: Entry) -> bool:
        return entry.track in self.tracks and entry.size == 0

    def search(self) -> None:
        """2"""
        last = self.last_entry()
        if last is not None:
            entry, at = last
            self.kept[entry] = at
            table = entry.stop
            while (behind := entry_at(self.payload, table)) and self.empty(behind):
                if not self.holds(behind, at + entry.size):
                    break
                self.kept[behind] = at + entry.size
                table = behind.stop
        else:
            found = self.first_packet()
            if found is None:
                return
            table = found
        at = table
        for entry in self.front:
            if entry.stop > at or entry in self.kept:
                break
            if self.holds(entry, at):
                self.kept[entry] = at
            at += entry.size

    def last_entry(self) -> tuple[Entry, int] | None:
        """2a"""
        found: list[tuple[Entry, int]] = []
        for offset in range(1, min(REACH, len(self.payload))):
            entry = entry_at(self.payload, offset)
            if self.useful(entry):
                found += [
                    (entry, end - entry.size)
                    for end in self.ends
                    if self.holds(entry, end - entry.size)
                ]
        barrier = min((at for _, at in found), default=0)
        before = [pair for pair in found if pair[0].at < barrier]
        return before[-1] if before else None

    def first_packet(self) -> int | None:
        """2b"""
        useful = [(place, e) for place, e in enumerate(self.front) if self.useful(e)]
        best, most = None, 0
        for place, entry in sorted(useful, key=lambda pair: pair[1].size)[:4]:
            before = sum(e.size for e in self.front[:place])
            for table in range(entry.stop, min(REACH, len(self.payload))):
                if not self.holds(entry, table + before):
                    continue
                count, at = 0, table
                for e in self.front:
                    count += self.holds(e, at)
                    at += e.size
                if count > most:
                    best, most = table, count
            if most > 1:
                break
        return best

    def before(self) -> None:
        """3"""
        waiting = list(self.kept)
        while waiting:
            after = waiting.pop()
            for offset in range(max(after.at - 36, 1), after.at):
                entry = entry_at(self.payload, offset)
                if entry is None or entry.stop != after.at or entry in self.kept:
                    continue
                at = self.kept[after] - entry.size
                if entry.track in self.tracks and self.holds(entry, at):
                    self.kept[entry] = at
                    waiting.append(entry)
                    break


FIVE = [
    (0, 0, 4, bytes.fromhex("0a0b0c0d")), (1, 0, 40, bytes.fromhex("1a1b1c1d1e1f")),
    (2, 100, 300, bytes.fromhex("2a2b2c")), (3, 0, 4, bytes.fromhex("3a3b3c3d3e")),
    (4, 7, 9, bytes.fromhex("4a4b4c4d4e4f50")),
]  # fmt: skip
WHOLE = f.cluster(*FIVE)
TABLE = len(WHOLE) - sum(len(body) for *_, body in FIVE)
BEHIND = bytes.fromhex("f9488b1c6f7468657220")
"""What follows in the file."""


def flip(at: int, bit: int = 0) -> bytes:
    return WHOLE[:at] + bytes([WHOLE[at] ^ 1 << bit]) + WHOLE[at + 1 :]


def salvage_case(name: str, payload: bytes, size: int, following: int | None) -> Case:
    kept = Salvage(payload, size, following).run()
    rows = [[e.at, at, e.track, e.size, e.start, e.span] for e, at in kept]
    return {"name": name, "bytes": payload, "payload_size": size, "next_header": following,
            "kept": rows}  # fmt: skip


def choices() -> Component:
    n = len(WHOLE)
    packets = TABLE
    rows: list[tuple[str, bytes, int, int | None]] = [
        (f"a bit of packet {i} is flipped", flip(at) + BEHIND, n, n)
        for i, at in enumerate((packets, packets + 4, packets + 10, packets + 13, packets + 18))
    ]
    starts = entry_starts()
    rows += [
        (f"a bit of the start tick of row {i} is flipped", flip(at + 2) + BEHIND, n, n)
        for i, at in enumerate(starts)
    ]
    rows += [
        (f"row {i} is longer by a byte: bit 7 of its track", flip(at, 7) + BEHIND, n, n)
        for i, at in enumerate(starts)
    ]
    rows += [
        (f"the size in row {i} differs", flip(at + 1, 1) + BEHIND, n, n)
        for i, at in enumerate(starts)
    ]
    rows += [
        ("the count differs: 4 of 5", bytes([4]) + WHOLE[1:] + BEHIND, n, n),
        ("the count differs: 7 of 5", bytes([7]) + WHOLE[1:] + BEHIND, n, n),
        ("the count is no varint", b"\xff" * 8 + WHOLE[8:] + BEHIND, n, n),
        ("a byte of packet 1 is missing", cut(packets + 5, 1) + BEHIND, n, n - 1),
        ("packet 1 is missing", cut(packets + 4, 6) + BEHIND, n, n - 6),
        ("a byte of the table is missing", cut(starts[2] + 1, 1) + BEHIND, n, n - 1),
        ("a row is missing", cut(starts[2], starts[3] - starts[2]) + BEHIND, n,
         n - starts[3] + starts[2]),
        ("a byte too many in packet 3", put(packets + 14, b"\x77") + BEHIND, n, n + 1),
        ("bytes too many between table and packets", put(packets, bytes(40)) + BEHIND, n, n + 40),
        ("bytes too many in the table", put(starts[3], b"\xee" * 5) + BEHIND, n, n + 5),
        ("the next header is too far away", put(packets + 14, b"\x77"), n, n + 1 + REACH),
        ("no next header", WHOLE[:-3], n, None),
        ("cut in the second packet", WHOLE[: packets + 6], n, None),
        ("cut within the table", WHOLE[: starts[3] + 2], n, None),
        ("the size in the header is too large", WHOLE + BEHIND, n + 30, n),
        ("the size in the header is too small", WHOLE + BEHIND, n - 9, n),
        ("the first three rows are zeros", bytes(starts[3]) + WHOLE[starts[3] :] + BEHIND, n, n),
        ("the whole table is zeros", bytes(packets) + WHOLE[packets:] + BEHIND, n, n),
        ("no bytes", b"", n, None),
    ]  # fmt: skip
    cases = [salvage_case(*row) for row in rows]
    body = bytes.fromhex("6a6b6c")
    like_an_entry = (0, 0, 4, bytes.fromhex("0affff7f0b0c0d0e0f10"))
    anywhere = (1, 0, 40, b"\4")
    six = f.cluster(like_an_entry, anywhere, *FIVE[2:], (8, 0, 4, body))
    n, last = len(six), len(six) - len(body)
    for name, data in (
        ("the last track is not described", six[:last] + b"\0" + six[last + 1 :]),
        ("the last track is not described, and the count differs", b"\x26" + six[1:]),
    ):
        cases.append(salvage_case(name, data + BEHIND, n, n))
    return Component(
        "salvage", "12.1", ("REC-001", "REC-002", "DAT-003", "DAT-004"),
        "Damaged payloads of DATA chunks, with all the bytes from the payload on, the "
        "`payload_size` of "
        "the header, and the offset where the walk finds the next header, all counted from the "
        "payload. "
        "Tracks 0 to 7 are described, the level is 1, the file id 7. `kept`: the packets, as "
        "[offset of the entry, of "
        "the packet, track, size, start, span], in order of their entries.", cases,
    )  # fmt: skip


def entry_starts() -> list[int]:
    out, at = [], 1
    for _ in FIVE:
        out.append(at)
        at = entry_at(WHOLE, at).stop
    return out


def cut(at: int, size: int) -> bytes:
    return WHOLE[:at] + WHOLE[at + size :]


def put(at: int, data: bytes) -> bytes:
    return WHOLE[:at] + data + WHOLE[at:]


def components() -> Iterator[Component]:
    yield choices()
