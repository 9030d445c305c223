"""Procedure `lost`: which samples damage took, and no more than that."""

from __future__ import annotations

import forge as f
import pytest
from test_damage import TWO
from test_recover import flipped, payload_of, recovered

from hapfmt.reading.damage import LostSpan
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

THREE = f.trak(track_count=3)


def lost(data: bytes) -> list[tuple[int, int, int | None]]:
    with Reader(data, scan=True) as reader:
        reader.read()
        return sorted(tuple(span)[:3] for span in reader.lost)


def file_of(*clusters, **changes) -> bytes:
    """Three channels; the index says when each cluster is."""
    data = [("DATA", f.cluster(*rows)) for rows in clusters]
    starts = [min(row[1] for row in rows) for rows in clusters]
    stops = [max(row[1] + row[2] for row in rows) for rows in clusters]
    chunks = [("HEAD", f.head()), ("TRAK", THREE), *data]
    entries, at = [], 8
    for number, (type_, payload, *_) in enumerate(chunks):
        times = (starts[number - 2], stops[number - 2]) if type_ == "DATA" else (0, 0)
        entries.append((type_, at, *times))
        at += f.HEADER + len(payload)
    duration = max(stops) * 10**6
    return f.closed(*chunks, ahead={"entries": entries}, duration_ns=duration, **changes)


def row(track: int, start: int, span: int = 4) -> tuple[int, int, int, bytes]:
    """Of 5 bytes."""
    return track, start, span, f.svarint(track + 1) + b"\1\0\1\0"


TABLE_HEAD, ROW = 7, 5
TABLE = TABLE_HEAD + 3 * ROW + 4
"""Bytes of the table of three packets that differ in their tracks alone."""

STEADY = file_of(*[[row(track, start) for track in range(3)] for start in (0, 4, 8)])


@pytest.mark.parametrize("track", range(3))
@pytest.mark.parametrize("cluster", range(3))
def test_a_damaged_packet_costs_its_own_track(cluster, track):
    """
    REC-003: A reader that goes on after damage MUST report every stretch of bytes that was lost, and every span that `lost` names.
    REC-012: A damage report MUST name every missing sample, by a span of its track or of one that its channel needs.
    """
    body = payload_of(STEADY, "DATA", cluster) + TABLE + 5 * track
    in_table = payload_of(STEADY, "DATA", cluster) + TABLE_HEAD + ROW * track + 3
    for at in (body, in_table):
        assert lost(flipped(STEADY, at)) == [(track, 4 * cluster, 4 * cluster + 4)]


@pytest.mark.parametrize("cluster", range(3))
def test_a_missing_cluster_costs_its_own_time(cluster):
    at = payload_of(STEADY, "DATA", cluster)
    want = [(track, 4 * cluster, 4 * cluster + 4) for track in range(3)]
    assert lost(flipped(STEADY, at - 10)) == want
    assert lost(STEADY[: at - 32] + STEADY[at - 31 :]) == want


GAPS = file_of([row(0, 0), row(1, 0)], [row(1, 100)], [row(2, 200)], [row(0, 300), row(2, 300)])


def test_clusters_of_equal_times():
    """An entry of an index speaks of the chunk with its sequence number, whatever its times."""
    data = file_of([row(0, 0)], [row(1, 0)], [row(2, 0)])
    for cluster in range(3):
        at = payload_of(data, "DATA", cluster)
        assert lost(flipped(data, at + 1)) == [(cluster, 0, 4)]
        assert lost(flipped(data, at - 10)) == [(cluster, 0, 4)]


def test_the_index_says_when():
    """A gap that stands in no cluster is not lost."""
    second = payload_of(GAPS, "DATA", 1)
    assert lost(flipped(GAPS, second - 10)) == [(0, 100, 104), (1, 100, 104), (2, 100, 104)]
    assert lost(flipped(GAPS, second + 9)) == [(0, 100, 104), (1, 100, 104), (2, 100, 104)]


def test_a_chunk_that_was_no_cluster_costs_no_samples():
    chunks = (("HEAD", f.head()), f.TRACK_0, f.DATA_0, ("aTTc", f.strings("a", "b")))
    entries = [("HEAD", 8, 0, 0), ("TRAK", 88, 0, 0), ("DATA", 154, 0, 4), ("aTTc", 200, 0, 0)]
    places = [("HEAD", 8), *[(type_, None) for type_, *_ in chunks[1:]]]
    at = 8
    for number, (type_, payload, *_) in enumerate(chunks):
        entries[number] = (type_, at, *entries[number][2:])
        at += f.HEADER + len(payload)
    assert len(places) == len(entries)
    data = f.closed(*chunks, ahead={"entries": entries})
    bad = flipped(data, payload_of(data, "aTTc") - 10)
    assert lost(bad) == []
    assert recovered(bad)[1].exit_code == 3


def test_without_an_index_the_packets_around_it_say():
    data = f.file(
        ("HEAD", f.head()), ("TRAK", THREE),
        *[("DATA", f.cluster(*[row(t, s) for t in range(3)])) for s in (0, 40, 80)],
    )  # fmt: skip
    second, third = payload_of(data, "DATA", 1), payload_of(data, "DATA", 2)
    assert lost(flipped(data, second - 10)) == [(track, 4, 80) for track in range(3)]
    assert lost(flipped(data, third - 10)) == [(track, 44, None) for track in range(3)]
    # The damaged entry may have been one of a neighbour, in the gaps next to it.
    spans = [(0, 44, 80), (1, 4, 80), (2, 4, 40)]
    assert lost(flipped(data, second + TABLE + 5)) == spans


def test_a_lost_description_costs_its_own_track():
    data = f.closed(
        ("HEAD", f.head()), f.TRACK_0, ("TRAK", f.trak(first_channel=1, first=1)),
        *[("DATA", f.cluster(row(0, s), row(1, s))) for s in (0, 4)],
        duration_ns=8_000_000,
    )  # fmt: skip
    bad = flipped(data, payload_of(data, "TRAK", 1))
    report = verify(bad)
    assert report.lost == [(("track 1",), None, None)] * 2
    spans = [span for damage in report.damage["damages"] for span in damage["lost"]]
    spans += report.damage["lost"]
    assert [tuple(span.values())[::2][:2] for span in spans] == [(1, 0), (1, 4)]
    assert any("whose description is lost" in line for line in report.summary)


@pytest.mark.parametrize("at", range(TABLE_HEAD))
def test_a_damaged_head_of_a_table_costs_the_cluster(at):
    place = payload_of(STEADY, "DATA", 1) + at
    for wrong in {0, 1, 2, 5, 0x80, 0xFF} - {STEADY[place]}:
        bad = STEADY[:place] + bytes([wrong]) + STEADY[place + 1 :]
        assert lost(bad) == [(track, 4, 8) for track in range(3)]
        assert recovered(bad)[1].packets == 6


@pytest.mark.parametrize("at", range(TABLE_HEAD, TABLE))
def test_a_byte_of_a_row_costs_one_packet(at):
    """One that is missing, or there twice, costs the packets of a cluster at most."""
    place = payload_of(STEADY, "DATA", 1) + at
    bad = STEADY[:place] + bytes([STEADY[place] ^ 0x80]) + STEADY[place + 1 :]
    done = recovered(bad)[1]
    in_row = at < TABLE - 4
    assert (done.packets, done.exit_code) == ((8, 3) if in_row else (9, 0))
    for bad in (
        STEADY[:place] + STEADY[place + 1 :],
        STEADY[:place] + STEADY[place : place + 1] + STEADY[place:],
    ):
        assert recovered(bad)[1].packets >= 6
        assert set(lost(bad)) <= {(track, 4, 8) for track in range(3)}


@pytest.mark.parametrize(
    ("wrong", "named"), [([0], "0"), ([1], "1"), ([2], "2"), ([0, 1], "0 to 1")]
)
def test_a_finding_names_the_tracks_of_the_table(wrong, named):
    bad = STEADY
    for track in wrong:
        bad = flipped(bad, payload_of(STEADY, "DATA", 1) + TABLE + 5 * track)
    (said,) = [one["message"] for one in verify(bad).findings if one["code"] == "bad-packet"]
    assert said == f"packets of track {named} are damaged"


def test_report():
    """
    REC-012: A damage report MUST name every missing sample, by a span of its track or of one that its channel needs.
    """
    at = payload_of(STEADY, "DATA", 1) + TABLE + 5
    report = verify(flipped(STEADY, at)).damage
    codes = [damage["code"] for damage in report["damages"]]
    assert codes == ["bad-payload", "bad-packet"]
    assert report["damages"][1]["lost"] == [
        {"track": 1, "channels": [1], "start": 4, "stop": 8, "start_s": 0.004, "stop_s": 0.008}
    ]
    assert (report["lost"], report["byte_count"]) == ([], f.HEADER + TABLE + 3 * 5)
    assert report["channels"] == [
        {"channel": n, "label": "", "lost_ticks": 4 * (n == 1), "lost_s": 0.004 * (n == 1)}
        for n in range(3)
    ]
    assert verify(STEADY).damage["damages"] == []


def test_report_of_what_nobody_knows():
    report = verify(TWO[: payload_of(TWO, "DATA", 1)]).damage
    spans = [span for damage in report["damages"] for span in damage["lost"]]
    assert {span["stop"] for span in spans} == {None}
    assert {channel["lost_ticks"] for channel in report["channels"]} == {None}


def test_spans():
    assert LostSpan(0, 1, 2) == (0, 1, 2, None)
