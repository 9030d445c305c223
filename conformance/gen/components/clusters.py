"""Clauses 6.4 and 11.5: tables of packets, digests of tracks."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from itertools import pairwise

import forge as f
from page import BrokenRule, varint

from .component import Case, Component, also, tried


def parse(data: bytes) -> Case:
    """At level 1, with each track described and of one component."""
    count, rows, at = table(data)
    crc = int.from_bytes(data[at : at + 4], "little")
    if f.cluster_crc(data[:at]) != crc:
        raise BrokenRule("DAT-011")
    at += 4
    for _, _, start, span, *_ in rows:
        if not 1 <= span <= 2**24 or start + span > 2**48:
            raise BrokenRule("DAT-003")
    places = [(row[0], row[2]) for row in rows]
    if any(a >= b for a, b in pairwise(places)):
        raise BrokenRule("DAT-002")
    if sum(size for _, size, *_ in rows) != len(data) - at:
        raise BrokenRule("DAT-005")
    entries = []
    for track, size, start, span, crc in rows:
        if f.packet_crc(count, track, start, span, data[at : at + size]) != crc:
            raise BrokenRule("DAT-004")
        entries.append(
            {"track": track, "size": size, "start": start, "span": span, "crc": crc, "offset": at}
        )
        at += size
    if sum(row[3] for row in rows) > 2**22:
        raise BrokenRule("DAT-009")
    return {"entries": entries}


def table(data: bytes) -> tuple[int, list[tuple[int, ...]], int]:
    """packet_count, the rows, and where they end."""
    count, at = number(data, 0)
    if not 1 <= count <= 2**14:
        raise BrokenRule("DAT-001")
    widths = [int.from_bytes(data[at : at + 2], "little") >> 4 * i & 15 for i in range(4)]
    if at + 2 > len(data):
        raise BrokenRule("DAT-005")
    if max(widths) > 6:
        raise BrokenRule("DAT-001")
    at += 2
    least = []
    for _ in range(4):
        value, at = number(data, at)
        least.append(value)
    if at + count * (sum(widths) + 4) + 4 > len(data):
        raise BrokenRule("DAT-005")
    rows = []
    for _ in range(count):
        row = []
        for low, width in zip((*least, 0), (*widths, 4), strict=True):
            row.append(low + int.from_bytes(data[at : at + width], "little"))
            at += width
        rows.append(tuple(row))
    return count, rows, at


def number(data: bytes, at: int) -> tuple[int, int]:
    if len(data) - at < 8 and all(byte >= 128 for byte in data[at:]):
        raise BrokenRule("DAT-005", "CNV-002")
    return varint(data, at)


def tables() -> Component:
    five = f.svarint(5)
    pair = f.cluster((0, 0, 4, five), (3, 2, 2, f.svarint(-5)))
    late = f.cluster((0, 2**48 - 4, 4, five))
    one = (0, 0, 4, five)
    rows: list[tuple[str, bytes]] = [
        ("one packet", f.cluster((0, 0, 4, five))),
        ("two tracks", pair),
        ("two packets of one track", f.cluster((0, 0, 4, five), (0, 9, 4, five))),
        ("an empty packet", f.cluster((0, 0, 4, five), (1, 0, 4, b""), (2, 0, 4, five))),
        ("the last tick", late),
        ("a track id of two bytes", f.cluster((300, 1000, 200, five))),
        ("as many samples as level 1 has", f.cluster((0, 0, 2**22, five))),
        ("no bytes", b""),
        ("no packet", f.varint(0)),
        ("more packets than level 1 has", f.varint(2**14 + 1) + bytes(8)),
        ("ends within the table", pair[:9]),
        ("a packet is missing", pair[:-1]),
        ("a byte left over", pair + b"\0"),
        ("wrong order of tracks", f.cluster((1, 0, 4, five), (0, 0, 4, five))),
        ("wrong order of starts", f.cluster((0, 9, 4, five), (0, 0, 4, five))),
        ("the same row twice", f.cluster((0, 0, 4, five), (0, 0, 4, five))),
        ("no tick", f.cluster((0, 0, 0, five))),
        ("one tick too far", f.cluster((0, 2**48 - 3, 4, five))),
        ("a span of 2^24 + 1", f.cluster((0, 0, 2**24 + 1, five))),
        ("too many samples in all", f.cluster((0, 0, 2**21, five), (1, 0, 2**21 + 1, five))),
        (
            "another start than its checksum says",
            f.cluster((0, 1, 4, five), crcs={0: f.packet_crc(1, *one)}),
        ),
        ("another packet than its checksum says", f.cluster((0, 0, 4, five))[:-1] + f.svarint(6)),
        ("a packet of another chunk", f.cluster(one, sequence=3)),
        ("another table than its checksum says", f.cluster(one, crc=0)),
        ("fields of six bytes", f.cluster(one, (0, 8, 4, five), widths=(6, 6, 6, 6))),
        ("the least values are 0", f.cluster(one, (1, 8, 5, five), least=(0, 0, 0, 0))),
        ("a field of seven bytes", f.cluster(one, widths=(0, 0, 7, 0))),
        ("a number that is not minimal", bytes(f.cluster(one))[:3] + b"\x80\0" + bytes(12)),
    ]
    cases = [
        tried({"name": name, "payload": data}, lambda data=data: parse(data)) for name, data in rows
    ]
    return Component(
        "cluster",
        "6.4",
        ("DAT-001", "DAT-002", "DAT-003", "DAT-004", "DAT-005", "DAT-009", "DAT-011"),
        "Payloads of DATA at level 1, of chunk 2 under the file id 7. Every track is described, "
        "with one component. Expected: the rows of the table, with the offset of each packet in "
        "the payload.",
        also(cases, {"no bytes": ["DAT-001"], "more packets than level 1 has": ["DAT-005"]}),
    )


FORMATS = {
    "counts": "i",
    "int64": "Q",
    "uint64": "Q",
    "binary16": "H",
    "binary32": "I",
    "binary64": "Q",
}


def digest(kind: str, pieces: list[tuple[int, list[list[int]]]]) -> Case:
    """``pieces``: start, and the row of each tick."""
    raw = b"".join(
        struct.pack("<" + FORMATS[kind], number)
        for _, rows in pieces
        for row in rows
        for number in row
    )
    spans: list[list[int]] = []
    for start, rows in pieces:
        if spans and spans[-1][1] == start:
            spans[-1][1] += len(rows)
        else:
            spans.append([start, start + len(rows)])
    numbers = hashlib.sha256(raw).digest()
    coverage = b"".join(struct.pack("<QQ", start, stop - start) for start, stop in spans)
    return {
        "spans": spans,
        "of_numbers": numbers,
        "digest": hashlib.sha256(numbers + coverage).digest(),
    }


def digests() -> Component:
    one = struct.unpack("<Q", struct.pack("<d", 1.0))[0]
    rows: list[tuple] = [
        ("no packet", "counts", []),
        ("four counts", "counts", [(0, [[5]] * 4)]),
        ("negative counts", "counts", [(0, [[-1], [-(2**23)], [2**23 - 1], [-(2**31)]])]),
        ("three components", "counts", [(2, [[1, 2, 3], [4, 5, 6]])]),
        ("a gap", "counts", [(0, [[1], [2]]), (5, [[3]])]),
        ("packets that follow on are one span", "counts", [(0, [[1], [2]]), (2, [[3]])]),
        ("a late start", "counts", [(2**48 - 1, [[7]])]),
        ("int64", "int64", [(0, [[0], [2**64 - 1], [2**63]])]),
        ("uint64", "uint64", [(0, [[2**64 - 1]])]),
        ("binary16", "binary16", [(0, [[0x3C00], [0x7E01]])]),
        ("binary32", "binary32", [(0, [[0x3F800000]])]),
        ("binary64, or the exact values of LPCX", "binary64", [(0, [[one], [2**63]])]),
    ]
    cases = [
        {
            "name": name,
            "number_format": kind,
            "packets": [{"start": start, "rows": rows} for start, rows in pieces],
        }
        | digest(kind, pieces)
        for name, kind, pieces in rows
    ]
    return Component(
        "digest",
        "11.5",
        ("DGS-002", "DGS-003"),
        "Digests of a track from its packets: `rows` has the numbers of each tick (words as "
        "unsigned "
        "integers), `spans` the coverage, `of_numbers` the SHA-256 of the numbers.",
        cases,
    )


def components() -> Iterator[Component]:
    yield tables()
    yield digests()
