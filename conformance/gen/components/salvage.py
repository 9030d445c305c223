"""Clause 12.1, salvage: what is kept of a damaged DATA chunk, read from the page alone."""

from __future__ import annotations

from collections.abc import Iterator

import forge as f
from page import BrokenRule

from .clusters import table
from .component import Case, Component

REACH = 65536


class Salvage:
    """``payload``: all bytes from the payload on."""

    def __init__(self, payload: bytes, size: int, following: int | None):
        self.ends = [size]
        if following is not None and following != size and following - size <= REACH:
            self.ends.append(following)
        self.payload = payload[: max(self.ends)]
        self.kept: dict[int, int] = {}
        try:
            self.count, self.rows, self.at = read(self.payload)
        except BrokenRule:
            self.count, self.rows, self.at = 0, [], 0

    def holds(self, row: tuple[int, ...], at: int) -> bool:
        track, size, start, span, crc = row
        body = self.payload[at : at + size]
        if at < 0 or at + size > len(self.payload):
            return False
        good = 1 <= span <= 2**24 and start + span <= 2**48
        return good and f.packet_crc(self.count, track, start, span, body) == crc

    def run(self) -> list[tuple[tuple[int, ...], int]]:
        """(row, offset of its packet) of those kept, in order of the rows."""
        at = self.at
        for number, row in enumerate(self.rows):
            if self.holds(row, at):
                self.kept[number] = at
            at += row[1]
        for end in self.ends if len(self.rows) == self.count else ():
            at = end
            for number, row in reversed(list(enumerate(self.rows))):
                at -= row[1]
                if number not in self.kept and self.holds(row, at):
                    self.kept[number] = at
        return [(self.rows[number], self.kept[number]) for number in sorted(self.kept)]


def read(payload: bytes) -> tuple[int, list[tuple[int, ...]], int]:
    """packet_count, the rows that are whole, and where the first packet should begin."""
    count, rows, stop = table(payload + bytes(4 + 32 * 2**14))
    size = (stop - head_size(payload)) // count
    whole = max(len(payload) - head_size(payload), 0) // size
    return count, rows[:whole], stop + 4


def head_size(payload: bytes) -> int:
    """Of packet_count, widths and the four least values."""
    at = passed = 0
    while passed < 5:
        passed += payload[at] < 128
        at += 1
        if passed == 1 and payload[at - 1] < 128:
            at += 2
    return at


FIVE = [
    (0, 0, 4, bytes.fromhex("0a0b0c0d")), (1, 0, 40, bytes.fromhex("1a1b1c1d1e1f")),
    (2, 100, 300, bytes.fromhex("2a2b2c")), (3, 0, 4, bytes.fromhex("3a3b3c3d3e")),
    (4, 7, 9, bytes.fromhex("4a4b4c4d4e4f50")),
]  # fmt: skip
WHOLE = bytes(f.cluster(*FIVE))
EMPTY = bytes(f.cluster((0, 0, 4, b""), (1, 0, 4, b"\1\2")))
TABLE = len(WHOLE) - sum(len(body) for *_, body in FIVE)
BEHIND = bytes.fromhex("f9488b1c6f7468657220")
"""What follows in the file."""


def flip(at: int, bit: int = 0) -> bytes:
    return WHOLE[:at] + bytes([WHOLE[at] ^ 1 << bit]) + WHOLE[at + 1 :]


def salvage_case(name: str, payload: bytes, size: int, following: int | None) -> Case:
    kept = Salvage(payload, size, following).run()
    rows = [[at, *row[:4]] for row, at in kept]
    return {"name": name, "bytes": payload, "payload_size": size, "next_header": following,
            "kept": rows}  # fmt: skip


def choices() -> Component:
    n = len(WHOLE)
    packets = TABLE
    rows: list[tuple[str, bytes, int, int | None]] = [
        (f"a bit of packet {i} is flipped", flip(at) + BEHIND, n, n)
        for i, at in enumerate((packets, packets + 4, packets + 10, packets + 13, packets + 18))
    ]
    starts = row_starts()
    rows += [
        (f"a bit of the {field} in row {i} is flipped", flip(at + place) + BEHIND, n, n)
        for i, at in enumerate(starts)
        for field, place in (("track", 0), ("size", 1), ("start", 2), ("span", 3))
    ]
    rows += [
        ("the count differs: 4 of 5", bytes([4]) + WHOLE[1:] + BEHIND, n, n),
        ("the count differs: 7 of 5", bytes([7]) + WHOLE[1:] + BEHIND, n, n),
        ("the count is no varint", b"\xff" * 8 + WHOLE[8:] + BEHIND, n, n),
        ("the width of the start ticks differs", flip(2) + BEHIND, n, n),
        ("a field of seven bytes", WHOLE[:2] + b"\x77" + WHOLE[3:] + BEHIND, n, n),
        ("the least track differs", flip(3) + BEHIND, n, n),
        ("the least start differs", flip(5) + BEHIND, n, n),
        ("the CRC of the table differs", flip(packets - 1) + BEHIND, n, n),
        ("the size in two rows differs", flip_two(starts[1] + 1, starts[3] + 1) + BEHIND, n, n),
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
        ("the first three rows are zeros",
         WHOLE[: starts[0]] + bytes(starts[3] - starts[0]) + WHOLE[starts[3] :] + BEHIND, n, n),
        ("the whole table is zeros", bytes(packets) + WHOLE[packets:] + BEHIND, n, n),
        ("the payload of another chunk", f.cluster(*FIVE, sequence=3) + BEHIND, n, n),
        ("a packet without bytes is left", EMPTY[:-1] + b"\0", len(EMPTY), None),
        ("no bytes", b"", n, None),
    ]  # fmt: skip
    cases = [salvage_case(*row) for row in rows]
    return Component(
        "salvage", "12.1", ("REC-001", "REC-002", "DAT-003", "DAT-004"),
        "Damaged payloads of DATA chunks, with all the bytes from the payload on, the "
        "`payload_size` of "
        "the header, and the offset where the walk finds the next header, all counted from the "
        "payload. "
        "The level is 1, the file id 7, the sequence number 2. `kept`: the packets, as "
        "[offset of the packet, track, size, start, span], in order of their rows.", cases,
    )  # fmt: skip


def row_starts() -> list[int]:
    begin = head_size(WHOLE)
    size = (TABLE - 4 - begin) // len(FIVE)
    return [begin + size * number for number in range(len(FIVE))]


def flip_two(first: int, second: int) -> bytes:
    once = flip(first)
    return once[:second] + bytes([once[second] ^ 1]) + once[second + 1 :]


def cut(at: int, size: int) -> bytes:
    return WHOLE[:at] + WHOLE[at + size :]


def put(at: int, data: bytes) -> bytes:
    return WHOLE[:at] + data + WHOLE[at:]


def components() -> Iterator[Component]:
    yield choices()
