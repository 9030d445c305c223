"""Every parser: a value or one of our errors, and what is parsed can be built again."""

from __future__ import annotations

from collections.abc import Iterable

import forge as f

from hapfmt.clocks import ClockMap, ClockObservation
from hapfmt.codecs.events import build_events, parse_events
from hapfmt.codecs.knots import build_varints, parse_varints
from hapfmt.format.cluster import Packet, build_cluster, parse_cluster, salvage_cluster
from hapfmt.format.extras import (
    build_attachment,
    build_clocks,
    build_foot,
    build_index,
    build_map,
    build_metadata,
    parse_attachment,
    parse_clock,
    parse_foot,
    parse_index,
    parse_map,
    parse_metadata,
)
from hapfmt.format.source import BytesSource
from hapfmt.format.track import TrackTable, build_description, parse_description
from hapfmt.format.walk import Finding, walk
from hapfmt.format.wire import (
    build_strings,
    build_tlvs,
    cluster_seed,
    parse_head,
    parse_header,
    parse_strings,
    parse_tlvs,
)
from hapfmt.limits import LEVELS
from hapfmt.numbers import parse_varint

from .mend import mend_cluster, mend_header
from .target import Target, outcome, settled

AT = 100
SEED = cluster_seed(f.FILE_ID, 2)
OWN_OFFSET = 1 << 40
"""Where an index stands, so that any offset may come before it."""

TABLE = TrackTable()
TABLE.add(parse_description(f.trak(), LEVELS[1], 0))
TABLE.add(parse_description(f.trak(component_count=200, first_channel=1, first=1), LEVELS[1], 0))
TABLE.add(parse_description(f.trak(track_count=9, first_channel=300, first=2), LEVELS[1], 0))


def header(data: bytes) -> None:
    found = settled(parse_header, data, AT)
    if found is not None:
        assert found.build() == data[: f.HEADER]


def head(data: bytes) -> None:
    found = settled(parse_head, data, AT)
    if found is not None:
        assert parse_head(found.build(), AT) == found


def tlvs(data: bytes) -> None:
    found = settled(parse_tlvs, data, 0, AT)
    if found is not None:
        assert build_tlvs({type_: value for type_, (_, value) in found.items()}) == data


def texts(data: bytes) -> None:
    """First how many there are."""
    count = data[0] if data else 1
    found = settled(parse_strings, data[1:], count, AT)
    if found:
        assert parse_strings(build_strings(found), count, AT) == found


def tracks(data: bytes) -> None:
    """First the level."""
    if not data:
        return
    level = LEVELS[1 + data[0] % 2]
    found = settled(parse_description, data[1:], level, 0)
    if found is None:
        return
    settled(TrackTable().add, found)
    settled(TrackTable().add, found, damaged=True)
    if all(track.unsupported is None for track in found):
        built = build_description(found)
        assert parse_description(built, level, 0) == found
        assert build_description(parse_description(built, level, 0)) == built


def cluster(data: bytes) -> None:
    for level in LEVELS.values():
        found = settled(parse_cluster, data, TABLE.tracks, level, AT, SEED)
        saved = list(salvage_cluster(data, TABLE.tracks, level, AT, SEED))
        packets = [item for item in saved if isinstance(item, Packet)]
        assert all(packet.track in TABLE.tracks for packet in packets)
        if found is not None:
            assert parse_cluster(build_cluster(found, SEED), TABLE.tracks, level, 0, SEED)
            assert saved == found


def index(data: bytes) -> None:
    found = settled(parse_index, data, OWN_OFFSET, AT)
    if found is not None:
        assert build_index(found) == data
        offsets = [entry.offset for entry in found.entries]
        assert offsets == sorted(set(offsets))


def foot(data: bytes) -> None:
    found = settled(parse_foot, data, AT)
    if found is not None:
        assert build_foot(found) == data


def metadata(data: bytes) -> None:
    found = settled(parse_metadata, data, AT)
    if found is not None:
        built = build_metadata(found)
        assert build_metadata(parse_metadata(built, AT)) == built


def attachment(data: bytes) -> None:
    found = settled(parse_attachment, data, AT)
    if found is not None:
        if max(len(found.name.encode()), len(found.media_type.encode())) < 255:
            assert build_attachment(found) == data
        assert found.safe_name and not set(found.safe_name) & set("/\\:\0")


def events(data: bytes) -> None:
    """First two bytes for the start, and two for the span."""
    start, span = int.from_bytes(data[:2], "little"), 1 + int.from_bytes(data[2:4], "little")
    found = settled(parse_events, data[4:], start, span, AT)
    if found is not None:
        assert all(start <= event.tick < start + span for event in found)
        assert build_events(found, start) == data[4:]


def clock(data: bytes) -> None:
    found = settled(parse_clock, data, AT)
    if found is not None:
        parts = list(build_clocks(*found))
        assert [row for part in parts for row in parse_clock(part, AT).rows] == found.rows
        assert parts == [data] or len(parts) > 1
        for row in found.rows:
            ClockObservation(found.clock, 0, *row)


def clock_map(data: bytes) -> None:
    found = settled(parse_map, data, AT)
    if found is None:
        return
    assert build_map(*found) == data
    whole = ClockMap(found.clock, 0, found.points)
    for tick, time_ns in found.points:
        assert whole.time_ns(tick) == time_ns
        assert whole.tick(time_ns) == tick


def varints(data: bytes) -> None:
    """A row at once says what one number after the other says."""

    def one_by_one() -> list[int]:
        numbers, position = [], 0
        while position < len(data):
            number, position = parse_varint(data, position, AT)
            numbers.append(number)
        return numbers

    found = outcome(lambda: parse_varints(data, AT).tolist())
    if isinstance(found, list):
        assert found == one_by_one()
        assert build_varints(parse_varints(data, AT)) == data
    else:
        assert settled(one_by_one) is None


def chunks(data: bytes) -> None:
    """Every byte is in a chunk or in what is reported, and the walk ends."""
    findings: list[Finding] = []
    stops = [0]
    offsets = []
    for chunk in walk(BytesSource(data), findings):
        offsets.append(chunk.offset)
        stops.append(chunk.stop)
        reported = {f.code for f in findings if f.offset == chunk.offset}
        assert chunk.intact == reported.isdisjoint({"bad-payload", "truncated"})
    assert offsets == sorted(set(offsets))
    if not findings and len(data) > 8:
        assert stops[-1] == len(data)


def mend_chunks(data: bytes) -> bytes:
    """Each header that stands behind a sync word; payload CRCs too, where the payload fits."""
    out, at = bytearray(data), data.find(f.SYNC)
    while 0 <= at <= len(out) - f.HEADER:
        size = int.from_bytes(out[at + 20 : at + 24], "little")
        body = bytes(out[at + f.HEADER : at + f.HEADER + size])
        if len(body) == size and size < 1 << 16 and out[at + 8] & 1 == 0:
            file_id = int.from_bytes(out[at + 8 : at + 16], "little")
            out[at + 24 : at + 28] = f.file_crc(body, file_id).to_bytes(4, "little")
        out[at : at + f.HEADER] = mend_header(bytes(out[at : at + f.HEADER]))
        at = bytes(out).find(f.SYNC, at + 1)
    return bytes(out)


def of_head() -> Iterable[bytes]:
    yield f.head()
    yield f.head(f.tlv(2, bytes(range(16))) + f.epoch(-1, 5) + f.tlv(6, b"x"), level=2)


def of_tracks() -> Iterable[bytes]:
    texts_ = f.tlv(2, f.strings("force_x", "y", "z")) + f.tlv(3, f.calibration(1, -5, 1000) * 3)
    rest = f.tlv(4, f.strings("N")) + f.tlv(6, f.strings("force") + b"\xff\xff")
    more = f.tlv(8, f.strings("x", "y", "z")) + f.tlv(10, f.strings("hand"))
    more += f.tlv(16, f.deadband(flags=3, entries=[(1, 0)] * 3)) + f.tlv(18, f.deviation(1.0, 0.5))
    more += f.tlv(22, b"measured")
    plain = [
        f.trak(),
        f.trak(f.HOLD + texts_ + rest, component_count=3),
        f.trak(f.HOLD + texts_ + rest + more, component_count=3, track_count=2),
        f.squeezed(f.trak(f.HOLD + texts_ + rest + more, component_count=3, track_count=2)),
        f.squeezed(f.trak(), 1),
        f.tracks(f.track(), f.track(continues=0), f.track(kind=1), f.track(kind=2, base=2)),
        f.trak(kind=2, base=0),
        f.trak(kind=1, component_count=2),
        f.trak(f.tlv(1, f.raw_parameters(8)), number_format=5, codec=b"RAWB", count_min=0, count_max=0),
    ]  # fmt: skip
    for payload in plain:
        yield b"\0" + payload
        yield b"\1\5" + payload[1:]


def of_cluster() -> Iterable[bytes]:
    yield f.DATA_0[1]
    yield f.cluster((0, 0, 4, b"\1\2\3"), (0, 4, 9, b""), (1, 7, 1, b"abc"), (2, 1 << 30, 300, b""))
    yield f.cluster(*[(2 + i, i, 1, bytes([i])) for i in range(9)])


def of_index() -> Iterable[bytes]:
    rows = [
        ("HEAD", 8, 0, 0),
        ("TRAK", 88, 0, 0),
        ("DATA", 177, 5, 1005),
        ("DATA", 900, 1000, 2000),
    ]
    yield f.index(rows)
    yield f.index(rows[2:], previous=177, first=2)


def of_metadata() -> Iterable[bytes]:
    yield b"{}"
    yield b'{"a":[1,-2.5e3,true,null,"\\u00e9\\n"],"b":{"c":{}},"notes":["x"]}'
    yield b'{"n":123456789012345678901234567890,"x":1e308}'


def of_events() -> Iterable[bytes]:
    yield bytes(2) + b"\xe8\3" + f.event(5, "contact", 20, 1) + f.event(0) + f.event(7, "\u00e9nd")
    yield b"\1\0\0\0" + f.event(0, "x")


def of_clock() -> Iterable[bytes]:
    yield f.clock([(0, 10**18, 5), (1000, 10**18 + 10**9, 0), (900, 0, 7)])
    yield f.clock([(-5, -(2**63), 2**53 - 1)], "gps")


def of_map() -> Iterable[bytes]:
    yield f.clock_map([(0, 0), (1000, 10**9 + 40_000), (5000, 5 * 10**9)])
    yield f.clock_map([(-(2**51), -(2**62)), (2**51, 2**52 - 2**62)])


def of_chunks() -> Iterable[bytes]:
    yield f.minimal()
    yield f.minimal(("mETa", b"{}"), ("aTTc", f.strings("a", "b") + f.minimal()))
    whole = f.minimal()
    yield whole[:100] + whole[130:]
    yield f.SIGNATURE + f.chunk("mETa", f.chunk("mETa", b"{}", 1), 0, crc=1)


PARSERS = [
    Target("header", header, lambda: [f.chunk("DATA", b"abc", 5), f.chunk("HEAD", b"", 0)], mend_header, 40),
    Target("head", head, of_head, size=200),
    Target("tlvs", tlvs, lambda: [f.tlv(1, b"abc") + f.tlv(2, b""), f.tlv(4, bytes(9))], size=300),
    Target("texts", texts, lambda: [b"\1" + f.strings("ab"), b"\3\1a\xff\2bc"], size=300),
    Target("tracks", tracks, of_tracks, size=700),
    Target("cluster", cluster, of_cluster, mend_cluster, 400),
    Target("index", index, of_index, size=300),
    Target("foot", foot, lambda: [f.foot(1, 4), f.foot(2**32 - 1, 2**64 - 1)], size=40),
    Target("metadata", metadata, of_metadata, size=600),
    Target("attachment", attachment, lambda: [f.strings("a.txt", "text/plain") + b"hi", b"\1a\0"], size=300),
    Target("events", events, of_events, size=300),
    Target("clock", clock, of_clock, size=200),
    Target("clock_map", clock_map, of_map, size=200),
    Target("varints", varints, lambda: [f.varint(300) + f.varint(2**53 - 1) + b"\0"], size=64),
    Target("chunks", chunks, of_chunks, mend_chunks, 2000),
]  # fmt: skip
