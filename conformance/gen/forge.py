"""Payloads, chunks and files byte by byte, right and wrong ones; imports nothing from hapfmt."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

import deflate

SIGNATURE = bytes.fromhex("8F4841500D0A1A0A")
SYNC = bytes.fromhex("F9488B1C")
FILE_ID = 7
HEADER = 32
"""Bytes of a chunk header."""
FOOT = HEADER + 12
"""Bytes of a fOOT chunk."""
DURATION_NS = 4_000_000
"""Of files whose last packet ends at tick 4 of 1 kHz, as DATA_0 does."""

LATE_MS = 10**9
"""Where an index says that a cluster ends: not earlier than it does."""

Chunk = tuple[str, bytes] | tuple[str, bytes, dict]


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def svarint(value: int) -> bytes:
    return varint(2 * value if value >= 0 else -2 * value - 1)


def file_crc(data: bytes, file_id: int = FILE_ID) -> int:
    return zlib.crc32(file_id.to_bytes(8, "little") + data)


def chunk(type_: str, payload: bytes, sequence: int, *, size=None, crc=None, header_crc=None,
          file_id=FILE_ID, sync=SYNC) -> bytes:  # fmt: skip
    if isinstance(payload, Cluster):
        payload = payload.at(sequence, file_id)
    size = len(payload) if size is None else size
    crc = file_crc(payload, file_id) if crc is None else crc
    header = struct.pack("<4s4sQIII", sync, type_.encode(), file_id, sequence, size, crc)
    header_crc = zlib.crc32(header) if header_crc is None else header_crc
    return header + header_crc.to_bytes(4, "little") + payload


def head(tlvs: bytes = b"", *, major: int = 1, minor: int = 0, level: int = 1) -> bytes:
    return bytes([major, minor, level]) + tlvs


def tlv(type_: int, value: bytes) -> bytes:
    return varint(type_) + varint(len(value)) + value


def epoch(time_ns: int, uncertainty_ns: int) -> bytes:
    """TLV 4 of HEAD."""
    return tlv(4, struct.pack("<qQ", time_ns, uncertainty_ns))


def strings(*items: str) -> bytes:
    return b"".join(bytes([len(item.encode())]) + item.encode() for item in items)


def calibration(a: int = 1, b: int = 0, d: int = 1) -> bytes:
    return svarint(a) + svarint(b) + varint(d)


def deviation(declared: float, largest: float) -> bytes:
    return struct.pack("<ff", declared, largest)


def deadband(kn: int = 1, kd: int = 10, flags: int = 0, entries=((1, 0),)) -> bytes:
    pairs = (varint(floor) + svarint(zero) for floor, zero in entries)
    return varint(kn) + varint(kd) + bytes([flags]) + b"".join(pairs)


def knot_parameters(interpolation: int = 0, step: int = 1, *, coding: int = 0, grid: int = 0,
                    zero: int = 0, kn: int = 0, kd: int = 1) -> bytes:  # fmt: skip
    lines = bytes([interpolation, coding])
    return lines + lpcr_parameters(grid, step=step, zero=zero, kn=kn, kd=kd)


def quan_parameters(codebook: bytes, *, step: int = 1, m: int = 0, r: int = 0, c: int = 0) -> bytes:
    return struct.pack("<IHBB", step, m, r, c) + codebook


def raw_parameters(word_size: int, reserved: bytes = bytes(3)) -> bytes:
    return struct.pack("<B3s", word_size, reserved)


def lpcr_parameters(grid: int = 0, *, step: int = 1, zero: int = 0, kn: int = 0,
                    kd: int = 1) -> bytes:  # fmt: skip
    out = bytes([grid]) + varint(step) + svarint(zero)
    return out + varint(kn) + varint(kd) if grid else out


def coded_knot_parameters(interpolation: int = 0, **grid: int) -> bytes:
    return knot_parameters(interpolation, coding=1, **grid)


def nois_parameters(shift: int = 3, intervals: int = 8) -> bytes:
    return bytes([shift, intervals])


def lpcx_parameters(rule: int = 0, digits: int = 0, reserved: bytes = bytes(2),
                    coefficients: Sequence[float] = (),
                    terms: Sequence[tuple[int, int, float]] = ()) -> bytes:  # fmt: skip
    """``reserved``: the number of terms, where it is not theirs, and the reserved byte."""
    numbers = struct.pack(f"<{len(coefficients)}d", *coefficients)
    rows = b"".join(struct.pack("<BBd", *term) for term in terms)
    count = bytes([len(terms) or reserved[0], reserved[1]])
    return struct.pack("<BB2s", rule, digits, count) + numbers + rows


def mdct_parameters(m: int = 5, step: int = 256, weights: Sequence[int] = (),
                    count: int | None = None) -> bytes:  # fmt: skip
    """``count``: of the weights, where it is not theirs."""
    n = len(weights) if count is None else count
    return bytes([m]) + varint(step) + bytes([n, *weights])


HOLD = tlv(1, knot_parameters())


def track(tlvs: bytes = HOLD, **given) -> bytes:
    """A track within TRAK; ``base`` or ``continues`` is the track that it is linked to. Bytes take
    the place of a number as they are."""
    fields = {
        "kind": 0, "number_format": 0, "codec": b"KNOT", "component_count": 1, "rate_num": 1000,
        "rate_den": 1, "count_min": -100, "count_max": 100, "first_channel": 0, "linked": 0,
        "tlv_count": tlvs_in(tlvs),
    }  # fmt: skip
    for name in ("base", "continues"):
        if name in given:
            given["linked"] = 1 + given.pop(name)
    assert given.keys() <= fields.keys()
    fields |= given
    both = fields.pop("kind") | fields.pop("number_format") << 4
    single = {"component_count", "tlv_count"}
    out = bytes([both])
    for name, value in fields.items():
        if not isinstance(value, int):
            out += value
        elif name in single:
            out += bytes([value])
        else:
            out += svarint(value) if name.startswith("count_") else varint(value)
    return out + tlvs


def number_at(data: bytes, at: int) -> tuple[int, int]:
    """The varint there, and where it ends."""
    value = shift = 0
    while at < len(data):
        value, shift, at = value | (data[at] & 127) << shift, shift + 7, at + 1
        if data[at - 1] < 128:
            break
    return value, at


def tlvs_in(tlvs: bytes) -> int:
    """How many begin there."""
    at = count = 0
    while at < len(tlvs):
        size, at = number_at(tlvs, number_at(tlvs, at)[1])
        at += size
        count += 1
    return count


def trak(tlvs: bytes = HOLD, *, first: int = 0, track_count: int = 1, **given) -> bytes:
    """The payload of several tracks that are alike but for their channels and bases."""
    rows, wide = [], given.get("component_count", 1)
    for i in range(track_count):
        own = dict(given)
        if i and given.get("kind") != 3:
            own["first_channel"] = given.get("first_channel", 0) + i * wide
        if "base" in given:
            own["base"] = given["base"] + i
        rows.append(track(tlvs, **own))
    return tracks(*rows, first=first)


def tracks(*records: bytes, first: int = 0) -> bytes:
    """The payload of TRAK, as it is."""
    return varint(first) + b"\0" + b"".join(records)


def squeezed(payload: bytes, kind: int = deflate.DYNAMIC) -> bytes:
    """The same, as a DEFLATE stream."""
    first, at = number_at(payload, 0)
    plain = payload[at + 1 :]
    return varint(first) + varint(len(plain)) + deflate.deflate(plain, kind)


def layer(tlvs: bytes = b"", **given) -> bytes:
    """A track of kind events."""
    fields = {"kind": 3, "codec": b"EVNT", "count_min": 0, "count_max": 0}
    return trak(tlvs, **(fields | given))


def event(step: int, text: str | bytes = "", duration: int = 0, channel: int = 0, *,
          size: int | None = None) -> bytes:  # fmt: skip
    raw = text if isinstance(text, bytes) else text.encode()
    size = len(raw) if size is None else size
    return varint(step) + varint(duration) + varint(channel) + varint(size) + raw


def digests(*values: bytes, first: int = 0) -> bytes:
    """dGST payload."""
    return varint(first) + b"".join(values)


def clock(observations, name: str = "pc", count: int | None = None,
          track: int | None = None) -> bytes:  # fmt: skip
    """cLOk payload of (tick, time ns, uncertainty ns)."""
    out = clock_of(track) + strings(name)
    out += varint(len(observations) if count is None else count)
    before = None
    for tick, time, uncertainty in observations:
        if before is None:
            out += svarint(tick) + struct.pack("<q", time)
        else:
            out += svarint(tick - before[0]) + svarint(time - before[1])
        out += varint(uncertainty)
        before = tick, time
    return out


def clock_of(track: int | None) -> bytes:
    """The first field of cLOk and cMAp."""
    return varint(0 if track is None else 1 + track)


def clock_map(points, name: str = "pc", count: int | None = None,
              track: int | None = None) -> bytes:  # fmt: skip
    """cMAp payload of (tick, time ns)."""
    out = clock_of(track) + strings(name)
    out += varint(len(points) if count is None else count)
    for i, (tick, time) in enumerate(points):
        if i == 0:
            out += svarint(tick) + struct.pack("<q", time)
        else:
            out += varint(tick - points[i - 1][0]) + varint(time - points[i - 1][1])
    return out


class Cluster(bytes):
    """A DATA payload; its CRCs are those of the chunk with number ``sequence``."""

    packets: tuple
    given: dict

    def at(self, sequence: int, file_id: int = FILE_ID) -> bytes:
        """The same as the payload of another chunk."""
        return cluster(*self.packets, **{"sequence": sequence, "file_id": file_id} | self.given)


def cluster_crc(data: bytes, sequence: int = 2, file_id: int = FILE_ID) -> int:
    return file_crc(struct.pack("<Q", sequence) + data, file_id)


def packet_crc(count: int, track: int, start: int, span: int, body: bytes, sequence: int = 2,
               file_id: int = FILE_ID) -> int:  # fmt: skip
    fields = struct.pack("<5Q", count, track, len(body), start, span)
    return cluster_crc(fields + body, sequence, file_id)


def bytes_of(value: int) -> int:
    return (value.bit_length() + 7) // 8


def table(rows, *, count=None, widths=None, least=None, crc=None, sequence: int = 2,
          file_id: int = FILE_ID) -> bytes:  # fmt: skip
    """The table of (track, size, start, span, packet CRC)."""
    columns = list(zip(*rows, strict=True))[:4] or [(0,)] * 4
    least = [min(column) for column in columns] if least is None else least
    if widths is None:
        widths = [bytes_of(max(c) - low) for c, low in zip(columns, least, strict=True)]
    out = varint(len(rows) if count is None else count)
    out += struct.pack("<H", sum(width << 4 * i for i, width in enumerate(widths)))
    out += b"".join(map(varint, least))
    for *fields, packet_crc_ in rows:
        for value, low, width in zip(fields, least, widths, strict=True):
            out += (value - low).to_bytes(width, "little")
        out += packet_crc_.to_bytes(4, "little")
    crc = cluster_crc(out, sequence, file_id) if crc is None else crc
    return out + crc.to_bytes(4, "little")


def cluster(*packets: tuple[int, int, int, bytes], **given) -> Cluster:
    """DATA payload of (track, start, span, bytes). Of DATA_0's place where ``sequence`` is not
    given; ``file`` and ``closed`` put in the right one. ``crcs``: wrong ones, by packet; the rest
    of ``given`` goes to ``table``."""
    changes = dict(given)
    crcs = changes.pop("crcs", {})
    place = {name: changes[name] for name in ("sequence", "file_id") if name in changes}
    count = changes.get("count", len(packets))
    rows = [
        (track, len(body), start, span, packet_crc(count, track, start, span, body, **place))
        for track, start, span, body in packets
    ]
    rows = [(*row[:4], crcs.get(i, row[4])) for i, row in enumerate(rows)]
    out = Cluster(table(rows, **changes) + b"".join(body for *_, body in packets))
    out.packets, out.given = packets, given
    return out


def index(entries, *, previous: int = 0, first: int = 0, count=None) -> bytes:
    """iNDX payload of (type, offset, start ms, stop ms)."""
    count = len(entries) if count is None else count
    out, before = bytearray(struct.pack("<QII", previous, first, count)), previous
    for type_, offset, start, stop in entries:
        out += type_.encode() + varint(offset - before)
        out += varint(start) + varint(stop - start) if type_ == "DATA" else b""
        before = offset
    return bytes(out)


def foot(index_distance: int, duration_ns: int = 0) -> bytes:
    return struct.pack("<IQ", index_distance, duration_ns)


def file(*chunks: Chunk, file_id: int = FILE_ID) -> bytes:
    """The signature, then (type, payload, changes to the header) one after the other."""
    out = [SIGNATURE]
    for sequence, (type_, payload, *changes) in enumerate(chunks):
        given = {"sequence": sequence, "file_id": file_id} | (changes[0] if changes else {})
        out.append(chunk(type_, payload, **given))
    return b"".join(out)


def closed(*chunks: Chunk, ahead: dict | None = None, indexed: bool = True,
           file_id: int = FILE_ID, **changes) -> bytes:  # fmt: skip
    """``file`` with a true index and footer; ``changes`` to the footer, ``ahead`` to the index."""
    rows, at = [], len(SIGNATURE)
    for type_, payload, *_ in chunks:
        rows.append((type_, at, 0, LATE_MS if type_ == "DATA" else 0))
        at += HEADER + len(payload)
    body = file(*chunks, file_id=file_id)
    if indexed:
        payload = index(**{"entries": rows} | (ahead or {}))
        body += chunk("iNDX", payload, len(chunks), file_id=file_id)
    duration_ns = DURATION_NS if any(type_ == "DATA" for type_, *_ in chunks) else 0
    fields = {"index_distance": len(body) - at, "duration_ns": duration_ns}
    payload = foot(**(fields | changes))
    return body + chunk("fOOT", payload, len(chunks) + indexed, file_id=file_id)


KNOT_DATA = svarint(5)
"""A constant 5, whatever the span."""

TRACK_0 = ("TRAK", trak())
DATA_0 = ("DATA", cluster((0, 0, 4, KNOT_DATA)))


def minimal(*more: Chunk, **changes) -> bytes:
    """HEAD, one track, four samples of 5, then ``more``; closed."""
    return closed(("HEAD", head()), TRACK_0, DATA_0, *more, **changes)
