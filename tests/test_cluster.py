"""Clause 6.4: DATA."""

from __future__ import annotations

import tracemalloc
from fractions import Fraction

import forge as f
import pytest
import strategies
from components import salvage
from hypothesis import given
from hypothesis import strategies as st
from judge import rule
from page import BrokenRule

from hapfmt.errors import FormatError
from hapfmt.format.cluster import (
    HEAD_ROOM,
    ROW_ROOM,
    MissingPackets,
    Packet,
    alone_size,
    build_cluster,
    parse_cluster,
    parse_table_head,
    salvage_cluster,
)
from hapfmt.format.track import Component, Track
from hapfmt.format.wire import cluster_seed
from hapfmt.limits import LEVELS
from hapfmt.reading.decoder import TrackDecoder

pytestmark = pytest.mark.capped

ONE = LEVELS[1]
SEED = cluster_seed(f.FILE_ID, 2)
TRACKS = {id_: Track(id_, "full", "KNOT", Fraction(1000), id_, (Component(),)) for id_ in range(3)}


@st.composite
def clusters(draw):
    """Packets in order of (track, start), of any bytes."""
    out = []
    for track in draw(st.sets(st.integers(0, 2), min_size=1)):
        start = draw(st.sampled_from([0, 5, 2**47]))
        for _ in range(draw(st.integers(1, 3))):
            span = draw(st.sampled_from([1, 7, 2**16]))
            out.append(Packet(track, start, span, draw(st.binary(max_size=20))))
            start += span + draw(st.integers(0, 3))
    return sorted(out, key=lambda p: (p.track, p.start))


def fields(packets):
    return [(p.track, p.start, p.span, p.data) for p in packets]


@given(clusters())
def test_comes_back(packets):
    """
    DAT-002: Rows MUST be in strictly increasing order of (track, start), those of events too.
    DAT-005: The packets MUST fill the rest of the payload to its last byte.
    """
    payload = build_cluster(packets, SEED)
    assert payload == f.cluster(*fields(packets))
    back = parse_cluster(payload, TRACKS, ONE, 1000, SEED)
    assert fields(back) == fields(packets)
    assert all(payload[p.offset - 1000 :].startswith(p.data) for p in back)
    sizes = sum(ROW_ROOM + len(p.data) for p in packets)
    assert len(payload) <= HEAD_ROOM + sizes
    assert all(alone_size(p) == len(build_cluster([p], SEED)) for p in packets)


@given(clusters(), st.data())
def test_any_flip_is_reported(packets, data):
    """
    DAT-004: `packet_crc` MUST be the cluster CRC of `packet_count`, `track`, `size`, `start` and `span`, each as u64, followed by the bytes of the packet.
    DAT-011: `table_crc` MUST be the cluster CRC of all bytes of the payload before it.
    """
    payload = bytearray(build_cluster(packets, SEED))
    bit = data.draw(st.integers(0, 8 * len(payload) - 1))
    payload[bit // 8] ^= 1 << bit % 8
    with pytest.raises(FormatError):
        parse_cluster(bytes(payload), TRACKS, ONE, 0, SEED)
    kept = [
        p for p in salvage_cluster(bytes(payload), TRACKS, ONE, 0, SEED) if isinstance(p, Packet)
    ]
    assert all(row in fields(packets) for row in fields(kept))
    table = len(payload) - sum(len(p.data) for p in packets)
    head = parse_table_head(build_cluster(packets, SEED), ONE, 0)
    if bit // 8 >= table or head.size <= bit // 8 < head.rows_stop:
        assert len(kept) == len(packets) - 1
    elif bit // 8 >= head.rows_stop:
        assert len(kept) == len(packets)
    else:
        assert not kept


@given(clusters(), st.data())
def test_salvage_never_invents(packets, data):
    """
    REC-001: A reader MUST NOT deliver a sample from a packet whose CRC differs, nor from a chunk whose header CRC or file id differs.
    """
    payload = bytearray(build_cluster(packets, SEED))
    at = data.draw(st.integers(0, len(payload) - 1))
    payload[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    for item in salvage_cluster(bytes(payload), TRACKS, ONE, 0, SEED):
        if isinstance(item, Packet):
            assert fields([item])[0] in fields(packets)


def test_one_wrong_size_costs_one_packet():
    """Packets behind it are placed from the end of the payload."""
    packets = [(0, 4 * i, 4, bytes([i] * 5)) for i in range(4)]
    payload = bytearray(f.cluster(*packets, widths=(1, 1, 1, 1)))
    payload[parse_table_head(payload, ONE, 0).size + 8 + 1] ^= 1
    kept = [
        p for p in salvage_cluster(bytes(payload), TRACKS, ONE, 0, SEED) if isinstance(p, Packet)
    ]
    assert fields(kept) == packets[:1] + packets[2:]


def test_salvage_keeps_the_limit_of_samples():
    """
    DAT-009: Over a `DATA` chunk, `span` times the component count of the track MUST add up to at most what the level allows. A packet of events counts its size in bytes. A decoder checks this before it takes memory.
    """
    payload = f.cluster(*[(0, i << 22, 1 << 22, b"") for i in range(2)])
    kept = [p for p in salvage_cluster(payload, TRACKS, ONE, 0, SEED) if isinstance(p, Packet)]
    assert fields(kept) == [(0, 0, 1 << 22, b"")]


@given(st.binary(max_size=40))
def test_any_bytes(data):
    try:
        found = parse_cluster(data, TRACKS, ONE, 0, SEED)
        assert parse_cluster(build_cluster(found, SEED), TRACKS, ONE, 0, SEED)
    except FormatError:
        list(salvage_cluster(data, TRACKS, ONE, 0, SEED))


@pytest.mark.parametrize(
    "payload",
    [
        f.varint(2**32),
        f.varint(2**14) + b"\0" * 100,
        f.table([(0, 2**32, 0, 1, 0)]),
        f.table([(0, 0, 0, 2**32, 0)]),
        f.cluster(*[(0, i << 24, 1 << 24, b"") for i in range(2)]),
    ],
)
def test_promises_take_no_memory(payload):
    """
    DAT-001: `packet_count` MUST be at least 1 and at most what the level allows, and each of the four widths at most 6.
    DAT-003: `span` MUST be at least 1 and at most what the level allows, and `start + span` at most 2^48.
    DAT-009: Over a `DATA` chunk, `span` times the component count of the track MUST add up to at most what the level allows. A packet of events counts its size in bytes. A decoder checks this before it takes memory.
    """
    tracemalloc.start()
    with pytest.raises(FormatError):
        parse_cluster(payload, TRACKS, ONE, 0, SEED)
    list(salvage_cluster(payload, TRACKS, ONE, 0, SEED))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 18


@given(strategies.packets())
def test_every_packet_decodes_alone(case):
    """
    DAT-007: Every packet MUST decode alone, from its own bytes and the description of its track.
    """
    track, packets, arrays = case
    for packet, array in zip(packets, arrays, strict=True):
        got = TrackDecoder(track, ONE).decode(packet)
        assert got.shape == (packet.span, array.shape[1])
        if track.codec != "KNOT" and track.number_format == "counts":
            bound = 1 << 23
            assert got.tolist() == array.clip(-bound, bound - 1).tolist()


class TestOrder:
    """
    DAT-006: Packets of one track MUST NOT overlap in time and MUST come in order of time within the file. Tracks of kind events are exempt.
    """

    def verdict(self, *packets):
        chunks = [("DATA", f.cluster(packet)) for packet in packets]
        return rule(f.closed(("HEAD", f.head()), f.TRACK_0, *chunks, duration_ns=8_000_000))

    def test_of_time(self):
        early, late = (0, 0, 4, f.KNOT_DATA), (0, 4, 4, f.KNOT_DATA)
        assert self.verdict(early, late) == ("intact", None)
        assert self.verdict(late, early) == ("nonconforming", "DAT-006")

    def test_overlap(self):
        assert self.verdict((0, 0, 5, b"\0"), (0, 4, 4, b"\0")) == ("nonconforming", "DAT-006")


def test_descriptions_come_first():
    """
    DAT-008: A packet MUST belong to a track that is described.
    TRK-001: `TRAK` MUST come before the first `DATA` chunk that contains a packet of its tracks.
    """
    head = ("HEAD", f.head())
    assert rule(f.closed(head, f.TRACK_0, f.DATA_0)) == ("intact", None)
    assert rule(f.closed(head, f.DATA_0, f.TRACK_0)) == ("nonconforming", "DAT-008")


def placed_by_size(payload: bytes) -> set[tuple[int, int, int, bytes]]:
    """Clause 14's ``salvage``, taken at its word."""
    found = set()
    try:
        count, rows, at = salvage.read(payload)
    except BrokenRule:
        return found
    forwards, backwards = [], []
    for row in rows:
        forwards.append((row, at))
        at += row[1]
    stop = len(payload)
    for row in reversed(rows) if len(rows) == count else ():
        stop -= row[1]
        backwards.append((row, stop))
    for (track, size, start, span, crc), at in forwards + backwards:
        data = payload[at : at + size]
        if at < 0 or len(data) < size or track not in TRACKS or not 1 <= span <= 1 << 24:
            continue
        if f.packet_crc(count, track, start, span, data) == crc:
            found.add((track, start, span, data))
    return found


@given(clusters(), st.data())
def test_salvage_finds_what_the_page_finds(packets, data):
    """
    REC-002: A recovering reader MUST find at least the chunks and packets that the procedures below find.
    """
    payload = bytearray(build_cluster(packets, SEED))
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(payload) - 1))
        payload[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
        if not payload:
            return
    kept = {
        (item.track, item.start, item.span, item.data)
        for item in salvage_cluster(bytes(payload), TRACKS, ONE, 0, SEED)
        if isinstance(item, Packet)
    }
    assert kept == placed_by_size(bytes(payload))
    assert kept <= {(p.track, p.start, p.span, p.data) for p in packets}


@given(clusters(), st.integers(0, 1 << 30), st.sampled_from(["flip", "delete", "insert"]))
def test_one_wrong_byte_costs_one_packet(packets, place, kind):
    """Wherever it is behind the head of the table; in the table if no byte moves."""
    payload = bytearray(build_cluster(packets, SEED))
    head = parse_table_head(payload, ONE, 0)
    first = head.size if kind == "flip" else head.table_size
    if first == len(payload):
        return
    size, place = len(payload), first + place % (len(payload) - first)
    if kind == "flip":
        payload[place] ^= 0x80
    elif kind == "delete":
        del payload[place]
    else:
        payload.insert(place, 0x81)
    region = bytes(payload) + f.SYNC
    sizes = [size, len(payload)] if len(payload) != size else [size]
    found = salvage_cluster(region[: max(sizes)], TRACKS, ONE, 0, SEED, sizes)
    kept = [item for item in found if isinstance(item, Packet)]
    assert len(kept) >= len(packets) - 1


@given(clusters(), st.integers(3, 9))
def test_a_packet_of_another_chunk_does_not_hold(packets, sequence):
    """
    DAT-004: `packet_crc` MUST be the cluster CRC of `packet_count`, `track`, `size`, `start` and `span`, each as u64, followed by the bytes of the packet.
    """
    payload = build_cluster(packets, cluster_seed(f.FILE_ID, sequence))
    found = list(salvage_cluster(payload, TRACKS, ONE, 0, SEED))
    assert [type(item) for item in found] == [MissingPackets]
    with pytest.raises(FormatError):
        parse_cluster(payload, TRACKS, ONE, 0, SEED)
