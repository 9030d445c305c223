"""A recording carries its clocks: reading, writing, parts, edits, other formats."""

from __future__ import annotations

import io
import json
import warnings
from dataclasses import replace
from fractions import Fraction
from uuid import UUID

import forge as f
import numpy as np
import pytest
import strategies
from click.testing import CliRunner
from hypothesis import assume, given
from hypothesis import strategies as st

import hapfmt
from hapfmt import Channel, ClockMap, ClockObservation, Recording, edit
from hapfmt.cli import cli
from hapfmt.convert import save
from hapfmt.errors import FormatError, ParameterError

RNG = np.random.default_rng(5)
NOISE = RNG.normal(0, 1, 3000).round(3)


def recording(**given):
    """Three channels, two of one rate and one slower; the second is four times the first."""
    force = Channel.from_physical(NOISE, 1000, label="force", unit="N")
    twin = Channel.from_physical(4 * NOISE, 1000, label="twin", unit="N")
    slow = Channel.from_physical(NOISE[:300], 100, label="slow", unit="m")
    return Recording((force, twin, slow), **given)


SEEN = (
    ClockObservation("pc", 1, 0, 10**18),
    ClockObservation("pc", 1, 1500, 10**18 + 15 * 10**8, 7),
    ClockObservation("pc", 1, 2999, 10**18 + 2999 * 10**6, 7),
    ClockObservation("camera", 2, 150, 5),
    ClockObservation("camera", None, 2 * 10**9, 6),
    ClockObservation("before", 0, -5, -(2**63)),
)
MAPS = (
    ClockMap("pc", 1, ((0, 10**18), (3000, 10**18 + 3 * 10**9))),
    ClockMap("pc", None, ((-(2**52) + 1, -1), (0, 0), (2**52 - 1, 2**52))),
)
CLOCKED = recording(clocks=SEEN, clock_maps=MAPS, uuid=UUID(int=1))


def clocks_of(found):
    return found.clocks, found.clock_maps


def encoded(found, **settings):
    out = io.BytesIO()
    hapfmt.write(found, out, canonical=7, **settings)
    return out.getvalue()


def quietly(*args, **given):
    """A part that begins after the end warns; here that is no matter."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", hapfmt.errors.DataWarning)
        return hapfmt.read(*args, **given)


class TestRoundTrip:
    @given(strategies.recordings().flatmap(strategies.clocked), st.booleans())
    def test_there_and_back(self, given, references):
        data = encoded(given, references=references)
        assert hapfmt.verify(data).verdict == "intact"
        found = hapfmt.read(data)
        assert clocks_of(found) == clocks_of(given)
        again = encoded(found, references=references)
        assert clocks_of(hapfmt.read(again)) == clocks_of(given)

    @strategies.idle_settings
    @given(strategies.recordings(), strategies.encoder_settings(), st.data())
    def test_by_every_preset(self, given, settings, data):
        """A vector has one track, and so its clocks; here they are on its first axis."""
        given = data.draw(strategies.clocked(given))
        inner = {i for i, channel in enumerate(given) if channel.axis in ("y", "z")}
        given = replace(
            given,
            clocks=[seen for seen in given.clocks if seen.channel not in inner],
            clock_maps=[one for one in given.clock_maps if one.channel not in inner],
        )
        out = io.BytesIO()
        hapfmt.write(given, out, settings, canonical=7)
        assert clocks_of(hapfmt.read(out.getvalue())) == clocks_of(given)

    def test_a_channel_with_clocks_begins_a_track(self):
        """Without them the three channels of one rate share a track."""
        trio = replace(CLOCKED, channels=(*CLOCKED.channels[:2], CLOCKED["twin"]))
        plain = replace(trio, clocks=(), clock_maps=())
        with hapfmt.Reader(encoded(plain)) as reader:
            assert [len(track.components) for track in reader.catalogue.tracks.values()] == [3]
        trio = replace(trio, clocks=[s for s in SEEN if s.channel in (0, 1, None)])
        with hapfmt.Reader(encoded(trio)) as reader:
            assert [len(track.components) for track in reader.catalogue.tracks.values()] == [1, 2]
            assert clocks_of(reader.read()) == clocks_of(trio)

    def test_the_axes_of_a_vector_stay_together(self):
        axes = [
            Channel(np.arange(50, dtype=np.int32), 1000, (), hapfmt.Calibration(1, 0, 9), axis=axis,
                    label=axis, group="f", unit="N")
            for axis in "xyz"
        ]  # fmt: skip
        seen = [ClockObservation("pc", "x", 1, 1), ClockObservation("pc", "z", 2, 2)]
        one = ClockMap("pc", "x", ((0, 0), (1, 1)))
        given = Recording(tuple(axes), clocks=seen, clock_maps=[one, replace(one, channel="y")])
        asked = {"preset": "paper", "floor": "1lsb", "smallest": False}
        with hapfmt.Reader(encoded(given, **asked)) as reader:
            assert {len(track.components) for track in reader.catalogue.tracks.values()} == {3}
            found = reader.read()
            assert [(each.channel, each.tick) for each in found.clocks] == [(0, 1), (0, 2)]
            assert found.clock_maps == (replace(one, channel=0),)
            assert [seen.channel for seen in reader.read("z").clocks] == [0, 0]
        other = replace(one, channel="y", points=((0, 0), (1, 2)))
        with pytest.raises(ParameterError, match="different maps of clock 'pc'; keep one"):
            encoded(replace(given, clock_maps=[one, other]), **asked)

    def test_many(self):
        """More than a chunk holds, and leaps."""
        seen = [ClockObservation("pc", 0, i, 10**18 * (i > 7) + i, 1) for i in range(20_000)]
        given = replace(recording(), clocks=seen)
        assert hapfmt.read(encoded(given)).clocks == tuple(seen)

    def test_a_map_too_long_for_level_1(self):
        points = tuple((i, 10**15 * i) for i in range(9000))
        given = replace(recording(), clock_maps=[ClockMap("pc", 0, points)])
        assert hapfmt.read(encoded(given)).clock_maps[0].points == points
        wide = tuple((k * 10**9, k * 10**13) for k in range(100_000))
        given = replace(recording(), clock_maps=[ClockMap("pc", 0, wide)])
        with hapfmt.Reader(encoded(given)) as reader:
            assert reader.catalogue.level.number == 2
            assert reader.read().clock_maps[0].points == wide

    def test_ids_from_the_content_tell_clocks_apart(self):
        made = []
        for one in (
            recording(), CLOCKED, replace(CLOCKED, clocks=SEEN[1:]),
            replace(CLOCKED, clocks=[*SEEN[:3], replace(SEEN[3], channel=0), *SEEN[4:]]),
        ):  # fmt: skip
            out = io.BytesIO()
            hapfmt.write(one, out, canonical="content")
            made.append(hapfmt.Reader(out.getvalue()).catalogue.file_id)
        assert len(set(made)) == 4

    def test_the_recorder(self, tmp_path):
        with hapfmt.Recorder(tmp_path / "a.hapf", [hapfmt.Input("force", 1000)]) as recorder:
            for second in range(3):
                recorder.write("force", NOISE[:1000])
                recorder.clock("pc", "force", 1000 * second, 10**18 + second, 9)
                recorder.clock("gps", None, second, second)
        assert hapfmt.read(tmp_path / "a.hapf").clocks == tuple(
            [ClockObservation("gps", None, i, i) for i in range(3)]
            + [ClockObservation("pc", 0, 1000 * i, 10**18 + i, 9) for i in range(3)]
        )


class TestParts:
    DATA = encoded(CLOCKED, references=False)

    @given(
        strategies.recordings().flatmap(strategies.clocked),
        st.none() | st.integers(0, 3),
        st.integers(1, 4),
        st.data(),
    )
    def test_a_file_and_a_recording_give_the_same(self, given, start, size, data):
        file = encoded(given, references=False)
        stop = data.draw(st.sampled_from([None, Fraction((start or 0) + size)]))
        places = data.draw(st.none() | st.permutations(range(len(given))).map(lambda x: x[:2]))
        whole = hapfmt.read(file)
        assume(not start or start < whole.duration)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", hapfmt.errors.DataWarning)
            part = whole.sel(places, start, stop)
        assert clocks_of(quietly(file, places, start, stop)) == clocks_of(part)

    @pytest.mark.parametrize("of", ["file", "recording"])
    def test_which_are_kept(self, of):
        def part(*args):
            return quietly(self.DATA, *args) if of == "file" else CLOCKED.sel(*args)

        assert clocks_of(part()) == (SEEN, MAPS)
        assert clocks_of(part("twin")) == (
            (*(replace(seen, channel=0) for seen in SEEN[:3]), SEEN[4]),
            (replace(MAPS[0], channel=0), MAPS[1]),
        )
        assert clocks_of(part(None, Fraction(3, 2), Fraction(2999, 1000))) == (
            (SEEN[1], SEEN[3], SEEN[4]), MAPS,
        )  # fmt: skip
        assert clocks_of(part(None, None, 1)) == ((SEEN[0], SEEN[5]), MAPS)
        assert [each.channel for each in part(["slow", "twin"]).clocks] == [1, 1, 1, 0, None]

    def test_without_them_their_chunks_are_not_read(self, monkeypatch):
        read = {}
        for clocks in (True, False):
            with hapfmt.Reader(self.DATA) as reader:
                chunks = [ref.offset for ref in reader.catalogue.chunks if ref.type == "cLOk"]
                places = []
                kept = reader.source.read_at

                def noted(at, size, kept=kept, places=places):
                    places.append(range(at, at + size))
                    return kept(at, size)

                monkeypatch.setattr(reader.source, "read_at", noted)
                found = reader.read("twin", 1, 2, clocks=clocks)
                assert bool(found.clocks) is bool(found.clock_maps) is clocks
                read[clocks] = [at for at in chunks if any(at in place for place in places)]
        assert read == {True: chunks, False: []}

    def test_a_track_of_several_channels(self):
        """The ticks are those of the first of its channels that are read."""
        trio = replace(CLOCKED, channels=CLOCKED.channels[:2], clocks=SEEN[5:], clock_maps=())
        data = encoded(trio)
        with hapfmt.Reader(data) as reader:
            assert [len(track.components) for track in reader.catalogue.tracks.values()] == [2]
            assert reader.read(["twin"]).clocks == (SEEN[5],)
            assert reader.read(["twin", "force"]).clocks == (SEEN[5],)


class TestChecks:
    @pytest.mark.parametrize(
        ("given", "why"),
        [
            ({"clocks": 5}, "the clocks of a recording are a list of hapfmt.ClockObservation"),
            ({"clocks": [("pc", 0, 0, 0)]}, "are a list of hapfmt.ClockObservation"),
            ({"clocks": MAPS}, "are a list of hapfmt.ClockObservation"),
            ({"clock_maps": SEEN}, "the clock maps of a recording are a list of hapfmt.ClockMap"),
            ({"clocks": [ClockObservation("pc", 3, 0, 0)]}, "a clock names channel 3 of 3"),
            (
                {"clocks": [ClockObservation("pc", -1, 0, 0)]},
                "of 3; rec.sel([...]) drops events and clocks",
            ),
            ({"clock_maps": [replace(MAPS[0], channel="no")]}, "'no', which does not exist"),
            ({"clock_maps": [MAPS[0], replace(MAPS[0], channel="twin")]}, "2 maps of clock 'pc'"),
            (
                {"clock_maps": [ClockMap("pc", 0, ((0, 0), (1, 2**60)))]},
                "2^53 ns or more apart; a file holds the observations",
            ),
        ],
    )
    def test_what_is_refused(self, given, why):
        with pytest.raises(ParameterError) as error:
            recording(**given)
        assert why in str(error.value)

    def test_labels_become_numbers_and_clocks_are_put_together(self):
        a, b = ClockObservation("a", "twin", 0, 0), ClockObservation("b", 1, 0, 0)
        found = recording(clocks=iter([a, b, replace(a, tick=1)]))
        assert [(x.clock, x.channel, x.tick) for x in found.clocks] == [
            ("a", 1, 0), ("a", 1, 1), ("b", 1, 0),
        ]  # fmt: skip

    def test_numbers_of_numpy(self):
        seen = ClockObservation("pc", 0, np.int64(5), np.int64(6), np.uint8(7))
        assert seen == ClockObservation("pc", 0, 5, 6, 7)
        assert ClockMap("pc", 0, np.array([[0, 1], [2, 3]])).points == ((0, 1), (2, 3))
        assert json.dumps(seen.tick) == "5"

    def test_repr(self):
        first = repr(CLOCKED).split("\n")[0]
        assert first.endswith("3 s, 3 clocks")
        assert "clock" not in repr(recording()).split("\n")[0]


class TestFiles:
    @pytest.fixture
    def path(self, tmp_path):
        path = tmp_path / "a.hapf"
        path.write_bytes(encoded(CLOCKED, cluster=1))
        return path

    def run(self, *args, code=0):
        done = CliRunner().invoke(cli, [*map(str, args)])
        assert done.exit_code == code, done.output
        return done

    @pytest.mark.parametrize("verb", ["encode", "convert", "decode"])
    def test_into_another_file(self, path, tmp_path, verb):
        into = tmp_path / ("b.hapf" if verb == "encode" else "b.npz")
        done = self.run(verb, path, into)
        assert "clock" not in done.stderr
        assert clocks_of(hapfmt.read(into)) == clocks_of(CLOCKED)

    def test_npz(self, tmp_path):
        path = tmp_path / "a.npz"
        notes = save(CLOCKED, path)
        assert not any("clock" in note for note in notes)
        assert clocks_of(hapfmt.read(path)) == clocks_of(CLOCKED)
        with np.load(path) as arrays:
            assert json.loads(arrays["clocks"].item())[3] == {
                "clock": "camera", "channel": 2, "tick": 150, "time_ns": 5, "uncertainty_ns": 0,
            }  # fmt: skip
            assert json.loads(arrays["clock_maps"].item())[0]["points"][0] == [0, 10**18]
        save(recording(), tmp_path / "b.npz")
        with np.load(tmp_path / "b.npz") as arrays:
            assert not {"clocks", "clock_maps"} & set(arrays)

    @pytest.mark.parametrize(
        "text",
        ["5", "[5]", "[{}]", "{", '[{"clock": "", "channel": 0, "tick": 0, "time_ns": 0}]',
         '[{"clock": "pc", "channel": 9, "tick": 0, "time_ns": 0}]', "[" * 100_000],
    )  # fmt: skip
    @pytest.mark.parametrize("key", ["clocks", "clock_maps"])
    def test_an_npz_with_wrong_clocks(self, tmp_path, key, text):
        np.savez(tmp_path / "a.npz", x=np.zeros((1, 3)), rate_hz=1000, **{key: text})
        with pytest.raises(ParameterError):
            hapfmt.read(tmp_path / "a.npz")

    def test_an_npz_of_another_program_with_a_channel_of_this_name(self, tmp_path):
        np.savez(tmp_path / "a.npz", force=np.arange(5.0), clocks=np.arange(5.0), rate_hz=1000)
        found = hapfmt.read(tmp_path / "a.npz")
        assert found.labels == ["force", "clocks"] and found.clocks == ()

    @pytest.mark.parametrize("suffix", ["csv", "wav", "npy"])
    def test_formats_that_hold_none_say_so(self, suffix):
        alone = CLOCKED.sel("twin")
        notes = save(alone, io.BytesIO(), format=suffix)
        [lost] = [note for note in notes if note.startswith("not carried over")]
        assert "clocks, clock_maps" in lost and lost.endswith("; .npz holds clocks")

    def test_edits(self, path, tmp_path):
        def result(verb, *args, **given):
            into = tmp_path / f"{verb.__name__}.hapf"
            verb(*args, into, **given)
            return hapfmt.read(into)

        for verb, arguments in (
            (edit.annotate, ([hapfmt.Event(1, "mark")],)),
            (edit.attach, ([edit.attachment_of(path, name="a")],)),
            (edit.set_metadata, ({"a": 1},)),
        ):
            assert clocks_of(result(verb, path, *arguments)) == clocks_of(CLOCKED)
        part = result(edit.subset, path, channels=["twin", "slow"])
        assert set(part.clocks) == {
            *(replace(seen, channel=0) for seen in SEEN[:3]), replace(SEEN[3], channel=1), SEEN[4],
        }  # fmt: skip
        assert part.clock_maps == (replace(MAPS[0], channel=0), MAPS[1])
        pieces = tmp_path / "{:d}.hapf"
        edit.split(path, str(pieces), at=[1])
        parts = sorted(tmp_path.glob("[0-9]*.hapf"))
        assert len(parts) == 2
        whole = result(edit.concat, parts)
        assert clocks_of(whole) == clocks_of(CLOCKED)
        other = tmp_path / "other.hapf"
        hapfmt.write(Recording((replace(CLOCKED["slow"], label="more"),), clocks=[
            ClockObservation("other", 0, 1, 2)]), other)  # fmt: skip
        both = result(edit.merge, [path, other], times="same")
        assert set(both.clocks) == {*SEEN, ClockObservation("other", 3, 1, 2)}
        assert both.clock_maps == MAPS

    def test_recover(self, path, tmp_path):
        data = bytearray(path.read_bytes())
        data[-3] ^= 1
        path.write_bytes(data)
        hapfmt.recover(path, tmp_path / "b.hapf")
        assert clocks_of(hapfmt.read(tmp_path / "b.hapf")) == clocks_of(CLOCKED)

    def test_a_damaged_chunk(self, path):
        """What is intact is read, and the rest is reported."""
        data = bytearray(path.read_bytes())
        data[data.index(b"\6camera") + 3] ^= 1
        with hapfmt.Reader(bytes(data)) as reader:
            found = reader.read()
            assert [f.code for f in reader.findings] == ["bad-payload"]
        assert set(found.clocks) < set(SEEN) and found.clock_maps == MAPS
        with pytest.raises(hapfmt.ChecksumError):
            hapfmt.read(bytes(data))

    def test_a_broken_rule(self):
        broken = f.minimal(("cLOk", f.clock([(0, 0, 0)], count=9, track=0)))
        with pytest.raises(FormatError):
            hapfmt.read(broken)
        harmed = f.file(
            ("HEAD", f.head()), ("aaaa", b"x", {"crc": 0}), f.TRACK_0, f.DATA_0,
            ("cLOk", f.clock([(0, 0, 0)], count=9)), ("cLOk", f.clock([(1, 2, 3)])),
        )  # fmt: skip
        reader = hapfmt.Reader(harmed)
        assert reader.read().clocks == (ClockObservation("pc", None, 1, 2, 3),)
        assert "bad-chunk" in [finding.code for finding in reader.findings]

    def test_what_the_verbs_print(self, path):
        shown = json.loads(self.run("info", path, "--json").stdout)["clocks"]
        assert [(row["clock"], row["track"], row["observation_count"]) for row in shown] == [
            ("pc", 1, 3), ("camera", 2, 1), ("camera", None, 1), ("before", 0, 1), ("pc", None, 0),
        ]  # fmt: skip
        assert [row["point_count"] for row in shown] == [2, 0, 0, 0, 3]
        rows = json.loads(self.run("clocks", path, "--json").stdout)["clocks"]
        assert [(row["clock"], row["track"]) for row in rows] == [
            ("pc", 1), ("camera", 2), ("camera", None), ("before", 0),
        ]  # fmt: skip
        assert rows[0]["points"] == [list(point) for point in MAPS[0].points]
