"""Clause 11.6: observations of other clocks as they were made, and maps where they are asked for."""

from __future__ import annotations

import contextlib
import io
import json
import re
from dataclasses import replace
from fractions import Fraction

import forge as f
import numpy as np
import pytest
import strategies
from click.testing import CliRunner
from depth import deep, either
from hypothesis import given
from hypothesis import strategies as st
from judge import rule, samples

import hapfmt
from hapfmt.cli import cli
from hapfmt.clocks import ClockMap, ClockObservation
from hapfmt.errors import HapfmtError, ParameterError
from hapfmt.format.cluster import Packet
from hapfmt.format.extras import (
    build_clocks,
    build_map,
    parse_clock,
    parse_map,
)
from hapfmt.format.source import BytesSource
from hapfmt.numbers import rdiv
from hapfmt.reading.clocks import fit_clock, summarise
from hapfmt.reading.dump import dump, measure
from hapfmt.reading.reader import Reader
from hapfmt.recording import Recording
from hapfmt.writing.filewriter import FileWriter

SEEN = [(0, 10**18, 5000), (1000, 10**18 + 10**9 + 40_000, 0), (900, 10**18 + 9 * 10**8, 7)]
POINTS = [(0, 10**18), (1000, 10**18 + 10**9 + 40_000)]
FILE = f.minimal(
    ("cLOk", f.clock(SEEN, track=0)),
    ("cMAp", f.clock_map(POINTS, "old", track=0)),
    ("cLOk", f.clock(SEEN[:1], "other")),
    ("cMAp", f.clock_map(POINTS, track=0)),
)


@given(st.lists(strategies.observations, max_size=8))
def test_observations_come_back(observations):
    """
    CLK-001: The name MUST lie within the payload and not be empty. At least one observation, or two points, follow, and fill the payload.
    CLK-003: Each tick MUST have a magnitude below 2^52, and each time fit an i64. From point to point of a map both grow.
    """
    rows = [(seen.tick, seen.time_ns, seen.uncertainty_ns) for seen in observations]
    payloads = list(build_clocks("pc", None, rows))
    assert [row for each in payloads for row in parse_clock(each, 0).rows] == rows
    if len(payloads) == 1:
        assert payloads[0] == f.clock(rows)


@given(strategies.clock_maps())
def test_maps_come_back(clock_map):
    payload = build_map(clock_map.clock, None, clock_map.points)
    assert parse_map(payload, 0) == (clock_map.clock, None, clock_map.points)
    assert payload == f.clock_map(clock_map.points, clock_map.clock)


@given(strategies.clock_maps(), st.integers(-(2**52), 2**52))
def test_times_as_the_page_says(clock_map, tick):
    """
    CLK-003: Each tick MUST have a magnitude below 2^52, and each time fit an i64. From point to point of a map both grow.
    """
    points = clock_map.points
    place = max((i for i, (k, _) in enumerate(points) if k <= tick), default=0)
    place = min(place, len(points) - 2)
    (k0, t0), (k1, t1) = points[place], points[place + 1]
    assert clock_map.time_ns(tick) == t0 + rdiv((t1 - t0) * (tick - k0), k1 - k0)
    for k, t in points:
        assert (clock_map.time_ns(k), clock_map.tick(t)) == (t, k)


@given(strategies.clock_maps(), st.integers(0, 10**6), st.integers(2, 10**5))
def test_there_and_back(clock_map, tick, slope):
    """Where a tick takes 2 ns at least, its time leads back to it."""
    first, time = clock_map.points[0]
    steep = [(k, time + slope * (k - first)) for k, _ in clock_map.points]
    one = replace(clock_map, points=tuple(steep))
    assert one.tick(one.time_ns(first + tick)) == first + tick


@given(st.binary(max_size=40) | st.binary(max_size=20).map(lambda tail: b"\4\1a" + tail))
def test_any_bytes(data):
    for parse in (parse_clock, parse_map):
        with contextlib.suppress(HapfmtError):
            clock, track, found = parse(data, 0)
            assert parse is parse_clock or build_map(clock, track, found) == data
            ClockMap(clock, None, found) if parse is parse_map else [
                ClockObservation(clock, None, *row) for row in found
            ]


@pytest.mark.parametrize(
    ("given", "why"),
    [
        (("", None, 0, 0), "1 to 255 bytes"),
        (("a\0", None, 0, 0), "1 to 255 bytes"),
        (("\ud800", None, 0, 0), "1 to 255 bytes"),
        (("\N{OHM SIGN}" * 86, None, 0, 0), "1 to 255 bytes"),
        ((5, None, 0, 0), "1 to 255 bytes"),
        (("a", 1.5, 0, 0), "number, a label or None"),
        (("a", None, 2**52, 0), "between -2^52 and 2^52"),
        (("a", None, 0, 2**63), "within 2^63 ns"),
        (("a", None, 0.5, 0), "tick of a clock is an integer, not float"),
        (("a", None, 0, "now"), "time_ns of a clock is an integer, not str"),
        (("a", None, 0, 0, -1), "uncertainty"),
        (("a", None, 0, 0, 2**53), "uncertainty"),
    ],
)
def test_what_no_chunk_holds(given, why):
    with pytest.raises(ParameterError, match=re.escape(why)):
        ClockObservation(*given)


@pytest.mark.parametrize(
    "points",
    [
        (), ((0, 0),), ((0, 0), (0, 1)), ((0, 0), (1, 0)), ((1, 1), (0, 0)),
        5, (1, 2), ((0, 0, 0), (1, 1, 1)), ((0, 0), (0.5, 1)), ((0, 0), (1, "1")),
        ((0, 0), (2**52, 1)), ((0, 0), (1, 2**63)),
    ],
)  # fmt: skip
def test_maps_that_are_none(points):
    with pytest.raises(ParameterError):
        ClockMap("a", None, points)


def test_points_too_far_from_each_other():
    with pytest.raises(ParameterError):
        Recording(clock_maps=[ClockMap("a", None, ((0, -(2**62)), (1, 2**62)))])


class TestFile:
    """
    CLK-001: The name MUST lie within the payload and not be empty. At least one observation, or two points, follow, and fill the payload.
    CLK-005: The track MUST be one described before, not of kind events.
    CLK-006: A reader MUST give samples the times of clause 7 unless its caller asks for a map.
    """

    def test_read(self):
        assert rule(FILE) == ("intact", None)
        reader = Reader(FILE)
        assert reader.clocks == [
            *(ClockObservation("pc", 0, *row) for row in SEEN),
            ClockObservation("other", None, *SEEN[0]),
        ]
        assert [(each.clock, each.points) for each in reader.clock_maps] == [
            ("old", tuple(POINTS)), ("pc", tuple(POINTS)),
        ]  # fmt: skip

    def test_samples_keep_their_times(self):
        assert samples(FILE) == samples(f.minimal())
        assert Reader(FILE).read().channels[0].rate_exact == 1000

    def test_the_last_map_counts(self):
        later = [(0, 0), (5, 7)]
        data = f.minimal(
            ("cMAp", f.clock_map(POINTS)),
            ("cMAp", f.clock_map(later)),
            ("cMAp", f.clock_map(later, track=0)),
        )
        found = {(each.clock, each.channel): each.points for each in Reader(data).clock_maps}
        assert found == {("pc", None): ((0, 0), (5, 7)), ("pc", 0): ((0, 0), (5, 7))}

    def test_write(self):
        out = io.BytesIO()
        writer = FileWriter(out, file_id=f.FILE_ID)
        track = Reader(f.minimal()).catalogue.tracks[0]
        writer.describe([track])
        writer.cluster([Packet(0, 0, 4, f.KNOT_DATA)])
        rows = [(i, 10**18 * (i > 7) + i, 1) for i in range(20000)]
        seen = [ClockObservation("pc", 0, *row) for row in rows]
        seen += [ClockObservation("pc", None, 0, 0), ClockObservation("b", None, 0, 0)]
        writer.clock("pc", 0, rows)
        writer.clock("pc", None, [(0, 0, 0)])
        writer.clock("b", None, [(0, 0, 0)])
        writer.clock_map("pc", 0, POINTS)
        writer.close()
        assert rule(out.getvalue()) == ("intact", None)
        reader = Reader(out.getvalue())
        assert reader.clocks == seen
        assert reader.clock_maps == [ClockMap("pc", 0, tuple(POINTS))]
        types = [ref.type for ref in reader.catalogue.chunks]
        assert types.count("cLOk") == 5

    @either("every", 5, deep=2, nightly=1)
    def test_damage(self, every):
        for at in range(0, len(FILE), every):
            data = bytearray(FILE)
            data[at] ^= 0x20
            assert hapfmt.verify(bytes(data)).verdict != "intact"
            assert (samples(bytes(data)) or {}).items() <= samples(FILE).items()
            with contextlib.suppress(HapfmtError):
                assert set(Reader(bytes(data)).clocks) <= set(Reader(FILE).clocks)

    def test_an_index_that_names_another_chunk(self):
        """
        IDX-003: A reader MUST check an entry against the header that it points to before it uses it. It reads the file in order where they differ, or where the sequence number of an index is not that after its last entry.
        """
        chunks = [("HEAD", f.head()), f.TRACK_0, f.DATA_0, ("mETa", b"{}"), ("cLOk", f.clock(SEEN))]
        rows, at = [], 8
        for type_, payload, *_ in chunks:
            wrong = {"mETa": "cLOk", "cLOk": "aaaa"}.get(type_, type_)
            rows.append((wrong, at, 0, f.LATE_MS if type_ == "DATA" else 0))
            at += f.HEADER + len(payload)
        assert len(Reader(f.closed(*chunks, ahead={"entries": rows})).clocks) == len(SEEN)

    def test_broken_rules_are_part_of_the_damage(self):
        broken = f.file(
            ("HEAD", f.head()), ("aaaa", b"x", {"crc": 0}), f.TRACK_0, f.DATA_0,
            ("cLOk", f.clock(SEEN, count=9)), ("cLOk", f.clock(SEEN[:1])),
        )  # fmt: skip
        reader = Reader(broken)
        assert len(reader.clocks) == 1
        assert ("bad-chunk", "CNV-002") in [(x.code, x.requirement) for x in reader.findings]

    def test_a_lost_track(self):
        """Nobody knows what its ticks were."""
        data = bytearray(FILE)
        data[FILE.index(f.trak()) + 9] ^= 1
        reader = Reader(bytes(data), scan=True)
        assert [seen.clock for seen in reader.clocks] == ["other"]

    def test_told(self, tmp_path):
        path = tmp_path / "a.hapf"
        path.write_bytes(FILE)
        told = CliRunner().invoke(cli, ["info", str(path)]).output
        assert "clock: pc (3 observations by ticks of track 0, mapped by 2 points)" in told
        assert "clock: other (1 observation by ns)" in told
        rows = [row for row in dump(BytesSource(FILE)) if row.get("type") in ("cLOk", "cMAp")]
        assert rows[0]["observations"] == [list(row) for row in SEEN]
        assert rows[1]["points"] == [list(point) for point in POINTS]
        usage = measure(BytesSource(FILE))
        assert usage.causes["cMAp"] > usage.causes["cLOk"] // 3 > 0
        assert sum(usage.causes.values()) == len(FILE)


RATE = 1000
BASE = 1_700_000_000 * 10**9


def simulated(
    seed, *, late=False, jitter=100e3, ppm=40.0, wander=2.0, steps=(), far=0.01, seconds=3600
):
    """(observations, what the clock told in truth at their ticks): a stamp a second."""
    rng = np.random.default_rng(seed)
    ticks = np.unique(rng.integers(0, seconds * RATE, seconds))
    t = ticks / RATE
    truth = ppm * 1e3 * t + wander * 1e3 * 600 / (2 * np.pi) * np.sin(2 * np.pi * t / 600)
    for at, height in steps:
        truth = truth + (t >= at) * height
    noise = rng.exponential(jitter, t.size) if late else rng.normal(0, jitter, t.size)
    noise = noise + (rng.random(t.size) < far) * rng.exponential(50 * jitter, t.size)
    true = [BASE + int(k) * 10**6 + round(x) for k, x in zip(ticks, truth, strict=True)]
    told = [x + round(n) for x, n in zip(true, noise, strict=True)]
    seen = [ClockObservation("pc", 0, int(k), x) for k, x in zip(ticks, told, strict=True)]
    return seen, true


def errors(seen, true, **asked):
    """Nanoseconds."""
    found = fit_clock(seen, RATE, **asked)
    return np.array(
        [found.time_ns(each.tick) - x for each, x in zip(seen, true, strict=True)], dtype=float
    )


class TestFit:
    @pytest.mark.parametrize("jitter", [1e3, 100e3, 5e6])
    @pytest.mark.parametrize("late", [False, True])
    @pytest.mark.parametrize("seed", [0, *deep(range(1, 4))])
    def test_drifting(self, late, jitter, seed):
        away = errors(*simulated(seed, late=late, jitter=jitter), delays="late" if late else "both")
        share = 0.15 if late else 0.25
        assert np.sqrt((away**2).mean()) < share * jitter + 500
        assert np.abs(away).max() < jitter + 4000

    @pytest.mark.parametrize("late", [False, True])
    @pytest.mark.parametrize("steps", [((1000, 50e6), (2000, -30e6)), ((1500, 5e6),)])
    @pytest.mark.parametrize("seed", [0, *deep(range(1, 4))])
    def test_set(self, late, steps, seed):
        seen, true = simulated(seed, late=late, steps=steps)
        away = errors(seen, true, delays="late" if late else "both")
        assert np.sqrt((away**2).mean()) < (15e3 if late else 25e3)
        assert np.abs(away).max() < 150e3

    def test_set_to_the_time_of_day(self):
        """From zero to 54 years."""
        seen, true = simulated(1)
        cut = len(seen) // 2
        leap = 10**18
        seen = seen[:cut] + [replace(each, time_ns=each.time_ns + leap) for each in seen[cut:]]
        away = errors(seen, true[:cut] + [x + leap for x in true[cut:]])
        assert np.sqrt((away**2).mean()) < 25e3

    def test_set_back(self):
        seen, _ = simulated(1, steps=((1000, -5e9),))
        with pytest.raises(ParameterError, match="set back"):
            fit_clock(seen, RATE)

    def test_without_noise(self):
        seen, true = simulated(1, jitter=0, wander=0, far=0)
        assert np.abs(errors(seen, true)).max() <= 2
        assert np.abs(errors(seen, true, delays="late")).max() <= 2

    def test_a_stamp_that_is_far_too_early(self):
        seen, true = simulated(2, late=True)
        seen[1800] = replace(seen[1800], time_ns=seen[1800].time_ns - 10**9)
        away = errors(seen, true, delays="late")
        assert np.sqrt((away**2).mean()) < 10e3

    def test_stated_uncertainties(self):
        """Stamps that are known better count more."""
        seen, true = simulated(3, jitter=1e6, far=0)
        sharp = [
            replace(each, time_ns=x + 1000, uncertainty_ns=1000)
            if i % 7 == 0
            else replace(each, uncertainty_ns=10**6)
            for i, (each, x) in enumerate(zip(seen, true, strict=True))
        ]
        plain = [replace(each, uncertainty_ns=0) for each in sharp]
        with_them, without = errors(sharp, true), errors(plain, true)
        assert np.abs(with_them).mean() < np.abs(without).mean() / 10

    def test_few(self):
        two = [ClockObservation("a", None, 0, 5), ClockObservation("a", None, 10**9, 10**9 + 7)]
        found = fit_clock(two, 10**9)
        assert found.points == ((0, 5), (10**9, 10**9 + 7))
        assert found.tick(found.time_ns(12345)) == 12345

    @given(
        st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 10**12)), min_size=1, max_size=40)
    )
    def test_anything(self, rows):
        seen = [ClockObservation("a", 3, *row) for row in rows]
        for delays in ("both", "late"):
            with contextlib.suppress(ParameterError):
                found = fit_clock(seen, Fraction(1000), delays=delays, window=7)
                assert found.channel == 3
                assert found == fit_clock(seen[::-1], Fraction(1000), delays=delays, window=7)

    def test_what_cannot_be(self):
        one = ClockObservation("a", None, 0, 5)
        for seen in ([], [one], [one, replace(one, clock="b", tick=5)]):
            with pytest.raises(ParameterError):
                fit_clock(seen, 1000)
        for asked in ({"delays": "early"}, {"window": 0}):
            with pytest.raises(ParameterError):
                fit_clock(simulated(0)[0], 1000, **asked)

    def test_summary(self):
        seen, true = simulated(0, wander=0)
        told = summarise(seen, Fraction(RATE))
        assert told.count == len(seen)
        assert abs(told.drift_ppm - 40) < 0.01
        assert abs(told.offset_ns - (true[0] - seen[0].tick * 10**6)) < 20e3
        assert 60e3 < told.jitter_ns < 75e3


class TestVerb:
    @pytest.fixture
    def path(self, tmp_path):
        out = io.BytesIO()
        writer = FileWriter(out, file_id=f.FILE_ID)
        writer.describe([Reader(f.minimal()).catalogue.tracks[0]])
        writer.cluster([Packet(0, 0, 4, f.KNOT_DATA)])
        rows = [(seen.tick, seen.time_ns, seen.uncertainty_ns) for seen in simulated(0)[0]]
        writer.clock("pc", 0, rows)
        writer.clock("once", None, [(5, 6, 0)])
        writer.close()
        path = tmp_path / "a.hapf"
        path.write_bytes(out.getvalue())
        return str(path)

    def run(self, *args):
        done = CliRunner().invoke(cli, ["clocks", *args], standalone_mode=False)
        assert done.exception is None
        return done.output

    def test_observed(self, path):
        assert "track 0" in self.run(path)
        rows = json.loads(self.run(path, "--json"))["clocks"]
        assert [(row["clock"], row["points"]) for row in rows] == [("pc", None), ("once", None)]
        assert abs(rows[0]["drift_ppm"] - 40) < 1

    def test_fitted(self, path):
        rows = json.loads(self.run(path, "--fit", "--delays", "both", "--json"))["clocks"]
        assert len(rows[0]["points"]) > 2
        assert rows[0]["beside_map_ns"] < rows[0]["jitter_ns"]
        assert rows[1]["points"] is None
        assert "nanoseconds" in self.run(path, "--fit", "--segment", "600")

    def test_a_channel_that_goes_on_in_another_track(self, tmp_path):
        path = tmp_path / "d.hapf"
        path.write_bytes(
            f.minimal(
                ("TRAK", f.trak(continues=0, first=1)),
                ("cLOk", f.clock([(0, 0, 0)], track=0)),
                ("cLOk", f.clock([(1000, 10**9, 0)], track=1)),
            )
        )
        (row,) = json.loads(self.run(str(path), "--fit", "--json"))["clocks"]
        assert (row["track"], row["points"]) == (0, [[0, 0], [1000, 10**9]])

    def test_stored_maps(self, tmp_path):
        path = tmp_path / "b.hapf"
        path.write_bytes(FILE)
        rows = json.loads(self.run(str(path), "--json"))["clocks"]
        assert rows[0]["points"] == [list(point) for point in POINTS]

    def test_none(self, tmp_path):
        path = tmp_path / "c.hapf"
        path.write_bytes(f.minimal())
        assert self.run(str(path)) == "this file has no observations of other clocks\n"
