"""Clause 6.3: TRAK; what of a track is unknown, and what a series shares."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import forge as f
import numpy as np
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st
from judge import rule, samples

from hapfmt.container.lists import round_up
from hapfmt.container.series import build_series, parse_series
from hapfmt.container.track import Component, Contract, series_of
from hapfmt.errors import HapfmtError, ParameterError, UnsupportedError
from hapfmt.limits import LEVELS
from hapfmt.reading.reader import Reader
from hapfmt.verifier import verify

pytestmark = pytest.mark.capped

HEAD = ("HEAD", f.head())
LF = ("TRAK", f.trak(kind=1), {"track": 0})


def hf(tlvs=f.HOLD, **fields):
    return ("TRAK", f.trak(tlvs, **({"kind": 2, "base": 0} | fields)), {"track": 1})


@given(strategies.series())
def test_comes_back(tracks):
    """
    TRK-002: `track_count`, `component_count`, `rate_num`, `rate_den` MUST be at least 1, and `track_count * component_count` at most 255.
    TRK-005: `count_min` MUST be at most `count_max`, and both MUST fit the width that the level allows for the kind (clause 15).
    VAL-001: D MUST be at least 1, A MUST NOT be 0, and `|A|` and `|B|` are less than 2^52.
    VAL-002: `|count * A|` and `|count * A + B|` MUST be at most 2^53 for every count of the declared range of the track, and `|count * A|` also for that of its HF track.
    TRK-013: Setups MUST stand only where TLV 1 does not, with at least one codec, at least one setup for each, no more setups than tracks, and the place of one of them for each track; the codec of the first track is `codec`.
    TRK-014: There MUST be one range for each track, each w of this table, and `count_min` and `count_max` the lowest and the highest of all ranges.
    TRK-015: There MUST be one number for each track, the first of them `first_channel`.
    TLV-005: Both numbers of a deviation MUST be finite and not negative, and `largest` at most `declared`.
    DBC-001: `kn` and `kd` MUST be less than 2^16, every `floor` at least 1 and less than 2^32, every `zero` a signed number of 32 bits, and undefined flag bits 0.
    """
    back = parse_series(build_series(tracks), tracks[0].id, LEVELS[2], 0)
    assert back == tracks


@given(strategies.series(LEVELS[1]))
def test_series_are_cut_and_joined(tracks):
    """One series for all that share a rate, whatever else they have of their own."""
    other = replace(tracks[-1], id=tracks[-1].id + 1, provenance=tracks[-1].provenance + "!")
    series = list(series_of([*tracks, other]))
    assert series == [tracks, [other]]
    assert [track for part in series for track in part] == [*tracks, other]
    for part in series:
        assert parse_series(build_series(part), part[0].id, LEVELS[1], 0) == part


def test_a_series_is_at_most_255_components():
    track = parse_series(f.trak(component_count=100), 0, LEVELS[1], 0)[0]
    tracks = [replace(track, id=i, first_channel=100 * i) for i in range(5)]
    assert [len(series) for series in series_of(tracks)] == [2, 2, 1]


def test_a_series_is_cut_where_its_setups_grow_too_long():
    track = parse_series(f.trak(codec=b"QUAN"), 0, LEVELS[1], 0)[0]
    tracks = [
        replace(track, id=i, first_channel=i, parameters=bytes([i]) * 2000) for i in range(70)
    ]
    cut = list(series_of(tracks))
    assert [len(part) for part in cut] == [32, 32, 6]
    for part in cut:
        assert parse_series(build_series(part), part[0].id, LEVELS[1], 0) == part


class TestOfTheirOwn:
    """What the tracks of one series need not share, byte by byte."""

    def test_setups(self):
        book = f.setups([(b"QUAN", [b"ab"]), (b"KNOT", [b"", b"c"])], [0, 2, 1, 2])
        payload = f.trak(f.tlv(5, book), codec=b"QUAN", track_count=4)
        tracks = parse_series(payload, 0, LEVELS[1], 0)
        assert [(t.codec, t.parameters) for t in tracks] == [
            ("QUAN", b"ab"), ("KNOT", b"c"), ("KNOT", b""), ("KNOT", b"c"),
        ]  # fmt: skip
        first_come = f.setups([(b"QUAN", [b"ab"]), (b"KNOT", [b"c", b""])], [0, 1, 2, 1])
        again = f.trak(f.tlv(5, first_come), codec=b"QUAN", track_count=4)
        assert build_series(tracks) == again

    def test_an_unknown_setup_is_that_track_s_alone(self):
        book = f.setups([(b"KNOT", [f.knot_parameters()]), (b"MDCT", [b""])], [0, 1])
        tracks = parse_series(f.trak(f.tlv(5, book), track_count=2), 0, LEVELS[1], 0)
        assert [track.unsupported is None for track in tracks] == [True, False]

    def test_ranges(self):
        listed = bytes([8, 64 + 7, 255]) + f.svarint(-5) + f.varint(6)
        payload = f.trak(f.HOLD + f.tlv(7, listed), track_count=3, count_min=-128, count_max=255)
        tracks = parse_series(payload, 0, LEVELS[1], 0)
        assert [(t.count_min, t.count_max) for t in tracks] == [(0, 255), (-128, 127), (-5, 1)]
        assert build_series(tracks) == payload

    def test_channels(self):
        payload = f.trak(f.HOLD + f.tlv(9, bytes([4, 0, 2])), track_count=3, component_count=2,
                         first_channel=4)  # fmt: skip
        tracks = parse_series(payload, 0, LEVELS[1], 0)
        assert [list(track.channels) for track in tracks] == [[4, 5], [0, 1], [2, 3]]
        assert build_series(tracks) == payload

    def test_contracts(self):
        listed = f.deadband(1, 10, 2, [(20, -3), (1, 0)]) + b"\0"
        payload = f.trak(f.HOLD + f.tlv(16, listed), track_count=2, component_count=2)
        tracks = parse_series(payload, 0, LEVELS[1], 0)
        assert [t.contract for t in tracks] == [
            Contract(1, 10, False, True, (20, 1), (-3, 0)), None,
        ]  # fmt: skip
        assert build_series(tracks) == payload

    def test_deviations(self):
        listed = f.deviation(0.5, 0.25) + f.deviation(0, 0)
        payload = f.trak(f.HOLD + f.tlv(18, listed), track_count=2)
        tracks = parse_series(payload, 0, LEVELS[1], 0)
        assert [t.components[0].deviation for t in tracks] == [(0.5, 0.25), None]
        assert build_series(tracks) == payload


@given(st.floats(0, 2.0**128 - 2.0**104) | st.floats(0, 1e-40))
def test_deviations_are_rounded_up(x):
    up = np.float32(round_up(x))
    assert float(up) == round_up(x) >= x
    assert up == 0 or float(np.nextafter(up, np.float32(-1))) < x


@pytest.mark.parametrize("x", [-1.0, 2.0**128, float("inf"), float("nan")])
def test_deviations_that_no_file_holds(x):
    with pytest.raises(ParameterError):
        round_up(x)


@given(strategies.series(), st.data())
def test_mutated(tracks, data):
    payload = bytearray(build_series(tracks))
    at = data.draw(st.integers(0, len(payload) - 1))
    payload[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
    with contextlib.suppress(HapfmtError):
        parse_series(bytes(payload), 0, LEVELS[1], 0)


@given(st.binary(max_size=60))
def test_any_bytes(data):
    for payload in (data, f.trak(data)):
        with contextlib.suppress(HapfmtError):
            parse_series(payload, 0, LEVELS[1], 0)


class TestUnknownParts:
    """
    TRK-004: `kind` and `number_format` MUST be among those defined; a reader treats a track of another kind or format as *unsupported*.
    TRK-011: A reader MUST treat a track with an unknown codec as *unsupported* and still decode the others on request.
    TLV-003: A reader MUST treat a track with an unknown critical TLV as *unsupported*, a file with one in `HEAD` too, and skip unknown ancillary TLVs.
    """

    @pytest.mark.parametrize(
        "fields",
        [{"kind": 4}, {"kind": 255}, {"number_format": 6}, {"codec": b"MDCT"}, {"codec": b"\xff\0x "},
         {"tlvs": f.HOLD + f.tlv(0x8001, b"")}],
    )  # fmt: skip
    def test_the_other_tracks_are_read(self, fields):
        strange = ("TRAK", f.trak(first_channel=1, **fields), {"track": 1})
        data = f.closed(HEAD, f.TRACK_0, strange, f.DATA_0)
        assert verify(data).verdict == "unsupported"
        assert samples(data) is None
        assert samples(data, channels=[0]) == {(0, tick): 5 for tick in range(4)}
        with pytest.raises(UnsupportedError):
            Reader(data).read([1])

    @pytest.mark.parametrize("fields", [{"codec": b"MDCT"}, {"tlvs": f.tlv(0x8001, b"")}])
    def test_the_base_of_an_unknown_residual(self, fields):
        data = f.closed(HEAD, LF, hf(**fields), f.DATA_0)
        assert verify(data).verdict == "unsupported"
        assert samples(data, band="lf") == {(0, tick): 5 for tick in range(4)}
        assert samples(data) is None


class TestResiduals:
    """
    TRK-007: An HF track MUST name a base track that is described before it, is of kind LF, and has the same component count, rate (as a ratio) and first channel; no two HF tracks have the same base.
    TRK-008: `base` MUST be 0xFFFF in tracks of other kinds.
    TRK-009: An HF track MUST carry no TLV of types 2, 3, 4, 6, 8, 10, 12, 14 and 18: it has those of its base.
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
        second = ("TRAK", hf()[1], {"track": 2})
        assert rule(f.closed(HEAD, LF, hf(), second, f.DATA_0)) == ("nonconforming", "TRK-007")

    @pytest.mark.parametrize("type_", [2, 3, 4, 6, 8, 10, 12, 14, 18])
    def test_descriptions_are_those_of_the_base(self, type_):
        value = {3: f.calibration(), 18: f.deviation(1, 1)}.get(type_, f.strings("x"))
        tlvs = f.HOLD + f.tlv(type_, value)
        assert rule(f.closed(HEAD, LF, hf(tlvs), f.DATA_0)) == ("nonconforming", "TRK-009")


class TestCopies:
    """
    TRK-003: Track ids MUST be at most 65533, and a track MUST be described once; a repeated `TRAK` chunk is equal to the first in every byte of its payload.
    """

    def test_equal(self):
        assert rule(f.minimal(f.TRACK_0)) == ("intact", None)

    def test_different(self):
        other = ("TRAK", f.trak(count_max=99), {"track": 0})
        assert rule(f.minimal(other)) == ("nonconforming", "TRK-003")

    @pytest.mark.parametrize(
        "payload",
        [f.trak(rate_num=2000, rate_den=2), f.trak(f.HOLD + f.tlv(0x8000, b""))],
        ids=["a rate", "a TLV"],
    )
    def test_equal_in_every_byte(self, payload):
        assert rule(f.minimal(("TRAK", payload, {"track": 0}))) == ("nonconforming", "TRK-003")

    def test_last_id(self):
        data = f.closed(HEAD, ("TRAK", f.trak(), {"track": 65533}))
        assert rule(data) == ("intact", None)


class TestChannelNumbers:
    """
    TRK-010: Channel numbers MUST be different for different components, but for those of tracks that continue one another, and those of all tracks that are not HF together are 0, 1, 2 ... without a hole once the file is closed; the highest is 65534, and tracks of kind events have none.
    """

    def test_a_hole(self):
        track = ("TRAK", f.trak(first_channel=1), {"track": 0})
        assert rule(f.closed(HEAD, track, f.DATA_0)) == ("nonconforming", "TRK-010")
        assert rule(f.file(HEAD, track, f.DATA_0)) == ("damaged", "FIL-003")

    def test_any_order_of_tracks(self):
        high = ("TRAK", f.trak(first_channel=1), {"track": 0})
        low = ("TRAK", f.trak(), {"track": 1})
        data = f.closed(HEAD, high, low, f.DATA_0)
        assert rule(data) == ("intact", None)
        assert samples(data) == {(1, tick): 5 for tick in range(4)}

    def test_within_a_series(self):
        tracks = parse_series(
            f.trak(track_count=3, component_count=2, kind=2, base=7, first_channel=4),
            9,
            LEVELS[1],
            0,
        )
        assert [(t.id, list(t.channels), t.base) for t in tracks] == [
            (9, [4, 5], 7), (10, [6, 7], 8), (11, [8, 9], 9),
        ]  # fmt: skip


class TestWords:
    """
    TRK-006: A track whose number format is not counts MUST be of kind full band, with codec `RAWB`, count_min and count_max 0, no calibration and no deadband contract.
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
        good = f.closed(HEAD, ("TRAK", f.trak(**given_), {"track": 0}))
        bad = f.closed(HEAD, ("TRAK", f.trak(**(given_ | changes)), {"track": 0}))
        assert rule(good) == ("intact", None)
        assert rule(bad) == ("nonconforming", "TRK-006")


def test_an_absent_unit_is_1():
    (track,) = parse_series(f.trak(), 0, LEVELS[1], 0)
    assert track.components == (Component(unit="1"),)
