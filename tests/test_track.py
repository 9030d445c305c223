"""Clause 6.3: TRAK; what of a track is unknown, and what tracks of one chunk share."""

from __future__ import annotations

import contextlib
import hashlib
import zlib
from dataclasses import replace

import forge as f
import numpy as np
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st
from judge import rule, samples

from hapfmt.errors import HapfmtError, LimitError, ParameterError, UnsupportedError
from hapfmt.format.deflate import deflate, inflate
from hapfmt.format.track import (
    CHUNK_SIZE,
    Component,
    Contract,
    build_description,
    build_track,
    chunks_of,
    parse_description,
    round_up,
    split,
)
from hapfmt.limits import LEVELS, Limits
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

pytestmark = pytest.mark.capped

HEAD = ("HEAD", f.head())
DIGEST = "ad9ce24fbbf4ca140b18e9faf798014f14d3ca2f6b656f7155f302c5b1b9ecef"
LF = ("TRAK", f.trak(kind=1))


def hf(tlvs=f.HOLD, **fields):
    return ("TRAK", f.trak(tlvs, **({"kind": 2, "base": 0, "first": 1} | fields)))


@given(strategies.described())
def test_comes_back(tracks):
    """
    TRK-002: A chunk MUST describe at least one track, and `component_count`, `rate_num`, `rate_den` be at least 1; both numbers of the rate are less than 2^32. All tracks of a chunk together have at most 255 components.
    TRK-005: `count_min` MUST be at most `count_max`, and both MUST fit the width that the level allows for the kind (clause 12).
    VAL-001: D MUST be at least 1, A MUST NOT be 0, and `|A|` and `|B|` are less than 2^52. For every count of the declared range of the track `|count * A|` and `|count * A + B|` are at most 2^53; for those of its HF track `|count * A|` is.
    TLV-005: Both numbers of a deviation MUST be finite and not negative, and `largest` at most `declared`.
    DBC-001: `kn` MUST be less than 2^16, `kd` at least 1 and less than 2^16. Every `floor` is at least 1 and less than 2^32, every `zero` a signed number of 32 bits, and undefined flag bits are 0.
    """
    back = parse_description(build_description(tracks), LEVELS[2], 0)
    assert back == tracks


def parts_of(tracks):
    return list(chunks_of((track, build_track(track)) for track in tracks))


@given(strategies.described(LEVELS[1]))
def test_tracks_of_one_chunk(tracks):
    """Ids that follow on make one chunk, whatever else differs; a hole in them begins another."""
    far = replace(tracks[-1], id=tracks[-1].id + 2)
    found = parts_of([*tracks, far])
    assert [part for _, part in found] == [tracks, [far]]
    for payload, part in found:
        assert parse_description(payload, LEVELS[1], 0) == part
        assert split(payload, LEVELS[1], 0) == [build_track(track) for track in part]


def test_a_chunk_is_at_most_255_components():
    track = parse_description(f.trak(component_count=100), LEVELS[1], 0)[0]
    tracks = [replace(track, id=i, first_channel=100 * i) for i in range(5)]
    assert [len(part) for _, part in parts_of(tracks)] == [2, 2, 1]


def test_a_chunk_is_cut_where_its_tracks_grow_too_long():
    track = parse_description(f.trak(codec=b"QUAN"), LEVELS[1], 0)[0]
    tracks = [
        replace(track, id=i, first_channel=i, parameters=bytes([i]) * 2000) for i in range(70)
    ]
    cut = parts_of(tracks)
    assert [len(part) for _, part in cut] == [32, 32, 6]
    assert sum(len(build_track(track)) for track in cut[0][1]) <= CHUNK_SIZE
    for payload, part in cut:
        assert parse_description(payload, LEVELS[1], 0) == part


class TestDeflate:
    """
    TRK-020: `plain_size` MUST be less than the largest payload of the level (clause 12). A DEFLATE stream gives that many bytes, is whole, and ends with the payload. A decoder stops at `plain_size`.
    """

    @given(st.binary(max_size=300), st.integers(0, 400))
    def test_any_bytes_come_back(self, data, gap):
        for plain in (data, data * 40, data + bytes(gap) + data):
            stream = deflate(plain)
            assert zlib.decompress(stream, -15) == plain
            assert inflate(stream, len(plain), "TRK-020", 0) == plain

    def test_long_and_far_repeats(self):
        noise = np.random.default_rng(1).integers(0, 256, 40_000, np.uint8).tobytes()
        for plain in (bytes(70_000), noise + noise[:500], noise[:32_768] * 2, noise * 2):
            assert zlib.decompress(deflate(plain), -15) == plain

    def test_the_stream_is_the_same_everywhere(self):
        """A digest of what was written here once: no library has a say in it."""
        plain = f.trak(track_count=40)[2:]
        digest = hashlib.sha256(deflate(plain)).hexdigest()
        assert digest == DIGEST

    def test_the_shorter_form_is_written(self):
        noise = f.tlv(1, hashlib.sha256(b"").digest())
        (alone,) = parse_description(f.trak(noise, codec=b"QUAN"), LEVELS[1], 0)
        many = [replace(alone, id=i, first_channel=i) for i in range(200)]
        assert build_description([alone]) == f.trak(noise, codec=b"QUAN")
        assert len(build_description(many)) < 2000 < 12 * 200

    @pytest.mark.parametrize("kind", [0, 1, 2])
    def test_each_kind_of_block(self, kind):
        payload = f.trak(track_count=9)
        squeezed = f.squeezed(payload, kind)
        assert [
            replace(track, offset=0) for track in parse_description(squeezed, LEVELS[1], 0)
        ] == (parse_description(payload, LEVELS[1], 0))


class TestOfTheirOwn:
    """What tracks and components have, byte by byte."""

    def test_an_unknown_codec_is_that_track_s_alone(self):
        payload = f.tracks(f.track(), f.track(codec=b"NEWC", first_channel=1))
        tracks = parse_description(payload, LEVELS[1], 0)
        assert [track.unsupported is None for track in tracks] == [True, False]

    def test_an_unknown_tlv_is_kept(self):
        payload = f.trak(f.HOLD + f.tlv(20, b"weights") + f.tlv(0x8000, b""))
        (track,) = parse_description(payload, LEVELS[1], 0)
        assert track.unknown == ((20, b"weights"), (0x8000, b""))
        assert build_track(track) == payload[2:]

    def test_contracts(self):
        contract = f.deadband(1, 10, 2, [(20, -3), (1, 0)])
        payload = f.trak(f.HOLD + f.tlv(16, contract), component_count=2)
        (track,) = parse_description(payload, LEVELS[1], 0)
        assert track.contract == Contract(1, 10, False, True, (20, 1), (-3, 0))
        assert build_track(track) == payload[2:]

    def test_deviations(self):
        listed = f.deviation(0.5, 0.25) + f.deviation(0, 0)
        payload = f.trak(f.HOLD + f.tlv(18, listed), component_count=2)
        (track,) = parse_description(payload, LEVELS[1], 0)
        assert [each.deviation for each in track.components] == [(0.5, 0.25), None]
        assert build_track(track) == payload[2:]


@given(st.floats(0, 2.0**128 - 2.0**104) | st.floats(0, 1e-40))
def test_deviations_are_rounded_up(x):
    up = np.float32(round_up(x))
    assert float(up) == round_up(x) >= x
    assert up == 0 or float(np.nextafter(up, np.float32(-1))) < x


@pytest.mark.parametrize("x", [-1.0, 2.0**128, float("inf"), float("nan")])
def test_deviations_that_no_file_holds(x):
    with pytest.raises(ParameterError):
        round_up(x)


@given(strategies.described(), st.data())
def test_mutated(tracks, data):
    payload = bytearray(build_description(tracks))
    at = data.draw(st.integers(0, len(payload) - 1))
    payload[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
    with contextlib.suppress(HapfmtError):
        parse_description(bytes(payload), LEVELS[1], 0)


@given(st.binary(max_size=60))
def test_any_bytes(data):
    for payload in (data, f.trak(data), b"\0\x30" + data):
        with contextlib.suppress(HapfmtError):
            parse_description(payload, LEVELS[1], 0)


class TestUnknownParts:
    """
    TRK-011: A reader MUST treat a track of an unknown kind, number format or codec as *unsupported*, and still decode the others on request.
    TLV-003: A reader MUST treat a track with an unknown critical TLV as *unsupported*, and a file with one in `HEAD` too. It skips unknown ancillary TLVs.
    """

    @pytest.mark.parametrize(
        "fields",
        [{"kind": 4}, {"kind": 15}, {"number_format": 6}, {"number_format": 15}, {"codec": b"NEWC"}, {"codec": b"\xff\0x "},
         {"tlvs": f.HOLD + f.tlv(0x8001, b"")}],
    )  # fmt: skip
    def test_the_other_tracks_are_read(self, fields):
        strange = ("TRAK", f.trak(first_channel=1, **fields, first=1))
        data = f.closed(HEAD, f.TRACK_0, strange, f.DATA_0)
        assert verify(data).verdict == "unsupported"
        assert samples(data) is None
        assert samples(data, channels=[0]) == {(0, tick): 5 for tick in range(4)}
        with pytest.raises(UnsupportedError):
            Reader(data).read([1])

    @pytest.mark.parametrize("fields", [{"codec": b"NEWC"}, {"tlvs": f.tlv(0x8001, b"")}])
    def test_the_base_of_an_unknown_residual(self, fields):
        data = f.closed(HEAD, LF, hf(**fields), f.DATA_0)
        assert verify(data).verdict == "unsupported"
        assert samples(data, band="lf") == {(0, tick): 5 for tick in range(4)}
        assert samples(data) is None

    @pytest.mark.parametrize(
        ("base", "residual"), [({}, {"codec": b"NEWC"}), ({"codec": b"NEWC"}, {})]
    )
    def test_a_residual_of_unknown_parts_takes_no_channel(self, base, residual):
        """Its numbers, whatever they are, are left to other tracks."""
        pair = ("TRAK", f.trak(kind=1, **base)), hf(first_channel=1, **residual)
        other = ("TRAK", f.trak(first=2, first_channel=1))
        data = f.closed(HEAD, *pair, other, ("DATA", f.cluster((2, 0, 4, f.KNOT_DATA))))
        assert verify(data).verdict == "unsupported"
        assert samples(data, channels=[1]) == {(1, tick): 5 for tick in range(4)}


class TestResiduals:
    """
    TRK-007: `linked` of an HF track MUST name its base track, an LF track described before it. Both have the same component count, rate (as a ratio) and first channel; no two HF tracks have the same base.
    TRK-009: An HF track MUST have no TLV of types 2, 3, 4, 6, 8, 10, 12, 14 and 18: it has those of its base. Only tracks of kind full band have TLV 5.
    """

    def test_that_fits(self):
        assert rule(f.closed(HEAD, LF, hf(), f.DATA_0)) == ("intact", None)

    @pytest.mark.parametrize(
        "fields",
        [{"base": 5}, {"base": 1}, {"rate_num": 999}, {"component_count": 2}, {"first_channel": 1}],
    )
    def test_that_does_not(self, fields):
        assert rule(f.closed(HEAD, LF, hf(**fields), f.DATA_0)) == ("nonconforming", "TRK-007")

    def test_the_rate_is_a_ratio(self):
        data = f.closed(HEAD, LF, hf(rate_num=2000, rate_den=2), f.DATA_0)
        assert rule(data) == ("intact", None)

    def test_two_of_one_base(self):
        second = hf(first=2)
        assert rule(f.closed(HEAD, LF, hf(), second, f.DATA_0)) == ("nonconforming", "TRK-007")

    @pytest.mark.parametrize("type_", [2, 3, 4, 6, 8, 10, 12, 14, 18])
    def test_descriptions_are_those_of_the_base(self, type_):
        value = {3: f.calibration(), 18: f.deviation(1, 1)}.get(type_, f.strings("x"))
        tlvs = f.HOLD + f.tlv(type_, value)
        assert rule(f.closed(HEAD, LF, hf(tlvs), f.DATA_0)) == ("nonconforming", "TRK-009")


class TestCopies:
    """
    TRK-003: Track ids MUST be at most 65533, and a track MUST be described once. A further `TRAK` chunk with the same first track has the same payload, byte for byte.
    """

    def test_equal(self):
        assert rule(f.minimal(f.TRACK_0)) == ("intact", None)

    def test_different(self):
        other = ("TRAK", f.trak(count_max=99))
        assert rule(f.minimal(other)) == ("nonconforming", "TRK-003")

    @pytest.mark.parametrize(
        "payload",
        [f.trak(rate_num=2000, rate_den=2), f.trak(f.HOLD + f.tlv(0x8000, b""))],
        ids=["a rate", "a TLV"],
    )
    def test_equal_in_every_byte(self, payload):
        assert rule(f.minimal(("TRAK", payload))) == ("nonconforming", "TRK-003")

    def test_last_id(self):
        data = f.closed(HEAD, ("TRAK", f.trak(first=65533)))
        assert rule(data) == ("intact", None)


class TestChannelNumbers:
    """
    TRK-010: Channel numbers MUST be at most 65534, and different for different components; only HF tracks and continued tracks share them. In a closed file they are 0, 1, 2 ... without a hole.
    """

    def test_a_hole(self):
        track = ("TRAK", f.trak(first_channel=1))
        assert rule(f.closed(HEAD, track, f.DATA_0)) == ("nonconforming", "TRK-010")
        assert rule(f.file(HEAD, track, f.DATA_0)) == ("damaged", "FIL-003")

    def test_any_order_of_tracks(self):
        high = ("TRAK", f.trak(first_channel=1))
        low = ("TRAK", f.trak(first=1))
        data = f.closed(HEAD, high, low, f.DATA_0)
        assert rule(data) == ("intact", None)
        assert samples(data) == {(1, tick): 5 for tick in range(4)}

    def test_within_a_chunk(self):
        tracks = parse_description(
            f.trak(track_count=3, component_count=2, kind=2, base=7, first_channel=4, first=9),
            LEVELS[1],
            0,
        )
        assert [(t.id, list(t.channels), t.base) for t in tracks] == [
            (9, [4, 5], 7), (10, [6, 7], 8), (11, [8, 9], 9),
        ]  # fmt: skip


class TestWords:
    """
    TRK-006: A track whose number format is not counts MUST be of kind full band, with codec `RAWB`. Its count_min and count_max are 0, and it has no calibration and no contract.
    """

    @pytest.mark.parametrize(
        "changes",
        [
            {"kind": 1}, {"codec": b"QUAN"}, {"count_min": -1}, {"count_max": 1},
            {"tlvs": f.tlv(1, f.raw_parameters(8)) + f.tlv(3, f.calibration())},
            {"tlvs": f.tlv(1, f.raw_parameters(8)) + f.tlv(16, f.deadband())},
        ],
    )  # fmt: skip
    def test_what_they_cannot_have(self, changes):
        given_ = {"tlvs": f.tlv(1, f.raw_parameters(8)), "number_format": 1, "codec": b"RAWB",
                  "count_min": 0, "count_max": 0}  # fmt: skip
        good = f.closed(HEAD, ("TRAK", f.trak(**given_)))
        bad = f.closed(HEAD, ("TRAK", f.trak(**(given_ | changes))))
        assert rule(good) == ("intact", None)
        assert rule(bad) == ("nonconforming", "TRK-006")


def test_an_absent_unit_is_1():
    (track,) = parse_description(f.trak(), LEVELS[1], 0)
    assert track.components == (Component(unit="1"),)


def test_a_long_description_counts_as_many_components():
    """LIM-003: A reader MAY have lower limits of its own, and MUST then report *unsupported*, not damage."""
    long = f.squeezed(f.trak(f.HOLD + f.tlv(0x8000, bytes(60_000))))
    data = f.closed(HEAD, ("TRAK", long), f.DATA_0)
    assert len(data) < 1000
    assert Reader(data, limits=Limits(components=58)).read().channels
    with pytest.raises(LimitError, match="58 components described"):
        Reader(data, limits=Limits(components=57))
