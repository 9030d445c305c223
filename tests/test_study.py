"""hapfmt.lab.study: descriptions, order, answers, summary."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import hapfmt
from hapfmt.errors import HapfmtError, MissingExtraError, ParameterError
from hapfmt.lab.scenes.stylus import simulate
from hapfmt.lab.study import outputs
from hapfmt.lab.study.description import Study, fifth, load_study, new_study, parse_study
from hapfmt.lab.study.outputs import ChannelMap, DeviceOutput, FeltStimulus, Nowhere, WavFiles, plan
from hapfmt.lab.study.prepare import MANIFEST, prepare
from hapfmt.lab.study.rating import (
    AnswerFile,
    NotYetError,
    Rating,
    Trial,
    heading,
    load_answers,
    order,
    parse_answers,
)
from hapfmt.lab.study.summary import mean_of, summarise, summary_json, table_rows

TEXT = """
name = "textures"
training = ["anchor"]
[[session]]
name = "sand"
recording = "sand.hapf"
[[session]]
name = "cork"
recording = "cork.npz"
from_s = 0.1
to_s = 0.3
[[condition]]
name = "same"
role = "reference"
[[condition]]
name = "b5"
preset = "paper"
k = 0.1
bits = 5
[[condition]]
name = "slow"
role = "test"
low_pass_hz = 10
[[condition]]
name = "anchor"
role = "anchor"
preset = "paper"
bits = 0
"""
PLACE = Path("study.toml")


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Study:
    folder = tmp_path_factory.mktemp("study")
    hapfmt.write(simulate("sand", 0.4), folder / "sand.hapf", canonical=1)
    hapfmt.save(simulate("cork", 0.4, 2), folder / "cork.npz")
    (folder / "study.toml").write_text(TEXT)
    return load_study(folder / "study.toml")


@pytest.fixture(scope="module")
def prepared(study):
    return prepare(study, study.folder("conditions"))


def test_a_study(study):
    assert [each.name for each in study.sessions] == ["sand", "cork"]
    assert study.reference.name == "same" and study.condition("b5").coding["bits"] == 5
    assert study.head.scale[0] == "Bad" and study.head.screen_below == 90


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('role = "reference"', "bits = 3", r"condition: 0 have role = \"reference\""),
        ("bits = 5", "bits = 1", r"condition\[1\].bits: there is no 1; choose one of 0, 2, 3,"),
        ("bits = 5", 'bit = "5"', r"condition\[1\].bit: is not a known key; did you mean bits"),
        ("bits = 5", 'files = { sand = "a.hapf" }', r"condition\[1\].preset: does not go with"),
        ("low_pass_hz = 10", "", r"condition\[2\]: says nothing of how it is made"),
        ("low_pass_hz = 10", 'files = { sand = "a" }', r"condition\[2\].files: names the sessions"),
        (
            "low_pass_hz = 10",
            "low_pass_hz = -1",
            r"condition\[2\].low_pass_hz: -1 is out of range; write a number above 0",
        ),
        (
            "low_pass_hz = 10",
            "k = true",
            r"condition\[2\].k: is true; write a number or a text such as '2lsb'",
        ),
        ('name = "slow"', 'name = "b5"', r"condition\[2\].name: 'b5' is there twice"),
        ('name = "slow"', 'name = " "', r"condition\[2\].name: ' ' is empty"),
        ("to_s = 0.3", "to_s = 0.1", r"session\[1\].to_s: ends before it begins"),
        ('"sand.hapf"', '""', r"session\[0\].recording: has 0 characters; write a text of 1 to"),
        ('["anchor"]', '["anker"]', r"training\[0\]: there is no condition 'anker'"),
        ('["anchor"]', "[1]", r"training\[0\]: is a number; write a text"),
        (
            'name = "textures"',
            'scale = ["a", "b"]',
            r"scale: has 2 values; write a list of 5 values",
        ),
        ('name = "textures"', "session = 1", r"Invalid TOML: "),
        ('name = "textures"', 'name = "\x00', r"Invalid TOML: "),
        ('name = "textures"', "seed = " + "9" * 5000, r"Invalid TOML: "),
    ],
)
def test_errors_name_the_key(old, new, told):
    assert TEXT.count(old) == 1
    with pytest.raises(ParameterError, match=told):
        parse_study(TEXT.replace(old, new).encode(), PLACE)


@pytest.mark.parametrize("text", ["", "session = 1", "[[session]]", "a = 1\n" * 2, "\xff"])
def test_what_is_no_study(text):
    with pytest.raises(ParameterError):
        parse_study(text.encode("latin-1"), PLACE)


@given(st.binary(max_size=300))
def test_any_bytes_are_a_study_or_refused(data):
    with pytest.raises(HapfmtError):
        parse_study(data, PLACE)


@given(st.text(min_size=1, max_size=20) | st.sampled_from([" ", "\x7f", '"', "\\", "\u200b"]))
def test_a_new_study_can_be_read(name):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, f"{name}.hapf")
        try:
            file.touch()
        except (OSError, ValueError):
            return
        path = Path(folder, "s.toml")
        again = parse_study(new_study(path, [str(file), str(file)]).encode(), PLACE)
        assert len(again.conditions) == 11
        assert again.sessions[0].recording == os.path.relpath(file, folder)


@pytest.mark.skipif(os.name == "nt", reason="names of bytes")
def test_a_name_that_is_no_text(tmp_path):
    file = os.fsdecode(os.fsencode(tmp_path / "a") + b"\xff.hapf")
    Path(file).touch()
    with pytest.raises(ParameterError, match="must be a text"):
        new_study(tmp_path / "s.toml", [file])


def test_orders(study):
    one, two = order(study, "S1"), order(study, "S2")
    assert one == order(study, "S1") != two
    assert sorted(one[1:]) == sorted(two[1:])
    assert one[0].training and [each.condition for each in one].count("b5") == 2
    for trials in (one, two):
        sessions = [each.session for each in trials[1:]]
        assert sessions in (["sand"] * 4 + ["cork"] * 4, ["cork"] * 4 + ["sand"] * 4)
    firsts = [order(study, f"S{n}")[1].condition for n in range(400)]
    counts = [firsts.count(each.name) for each in study.conditions]
    assert stats.chisquare(counts).pvalue > 1e-3
    for bad in ("", "../x", "Müller", "a b", "x" * 65):
        with pytest.raises(ParameterError, match="cannot be a subject"):
            order(study, bad)


class TestPreparing:
    def test_once(self, study, prepared):
        times = [each.path.stat().st_mtime_ns for each in prepared.stimuli]
        again = prepare(study, prepared.folder)
        assert again == prepared and len(times) == 8
        assert times == [each.path.stat().st_mtime_ns for each in again.stimuli]

    def test_the_same_bytes_after_damage(self, study, prepared, tmp_path):
        first = prepare(study, tmp_path / "a")
        first.stimuli[3].path.write_bytes(b"?")
        assert prepare(study, tmp_path / "a").digest == first.digest == prepared.digest
        assert first.stimuli[3].path.stat().st_size > 1
        (tmp_path / "a" / MANIFEST).write_text("[]")
        assert prepare(study, tmp_path / "a").digest == first.digest

    def test_signals(self, study, prepared):
        original = hapfmt.read(study.path.parent / "cork.npz").channels[0].samples()[100:300]
        back = {
            name: hapfmt.read(prepared.file("cork", name)).channels[0]
            for name in ("same", "b5", "slow", "anchor")
        }
        assert all(each.start_tick == 0 and each.stop_tick == 200 for each in back.values())
        assert np.array_equal(back["same"].samples(), original)
        errors = {name: np.std(each.samples() - original) for name, each in back.items()}
        assert 0 < errors["b5"] < errors["anchor"] and 0 < errors["b5"] < errors["slow"]
        bends = [np.std(np.diff(x, 2)) for x in (back["slow"].samples(), original)]
        assert bends[0] < bends[1] / 5

    def test_qualities_of_a_texture(self, tmp_path):
        """Side by side: a coded texture, and one from a model."""
        hapfmt.write(simulate("cork", 3.0), tmp_path / "cork.hapf", canonical=1)
        rows = "".join(
            f'[[condition]]\nname = "{name}"\npreset = "perceptual"\n{row}\n'
            for name, row in (("high", 'quality = "high"'), ("10 dB", "snr = 10"),
                              ("LPCR", 'snr = 10\ntexture_codec = "LPCR"'),
                              ("MDCT", 'snr = 10\ntexture_codec = "MDCT"'),
                              ("model", "synthetic_texture = true"))
        )  # fmt: skip
        text = '[[session]]\nname = "cork"\nrecording = "cork.hapf"\n'
        text += f'[[condition]]\nname = "same"\nrole = "reference"\n{rows}'
        (tmp_path / "study.toml").write_text(text)
        study = load_study(tmp_path / "study.toml")
        made = prepare(study, tmp_path / "conditions")
        x = {name: hapfmt.read(made.file("cork", name)).channels[0]
             for name in ("same", "high", "10 dB", "LPCR", "MDCT", "model")}  # fmt: skip
        assert [each.synthetic for each in x.values()] == [False] * 5 + [True]
        size = {name: made.file("cork", name).stat().st_size for name in x}
        assert size["model"] < size["10 dB"] < size["high"] < size["same"]
        assert size["10 dB"] <= min(size["LPCR"], size["MDCT"])
        for name in ("LPCR", "MDCT"):
            with hapfmt.Reader(made.file("cork", name)) as reader:
                assert name in {track.codec for track in reader.catalogue.tracks.values()}

    def test_files_of_ones_own(self, study, tmp_path):
        for name in ("sand.hapf", "cork.npz"):
            (tmp_path / name).write_bytes(study.beside(name).read_bytes())
        hapfmt.write(hapfmt.read(tmp_path / "cork.npz"), tmp_path / "c.hapf")
        files = 'files = { sand = "sand.hapf", cork = "c.hapf" }'
        path = tmp_path / "own.toml"
        path.write_text(TEXT.replace("low_pass_hz = 10", files))
        with pytest.raises(ParameterError, match=r"lasts 0\.4 s, and the reference 0\.2 s"):
            prepare(load_study(path), tmp_path / "f")
        path.write_text(TEXT.replace("low_pass_hz = 10", files).replace("to_s = 0.3", "")
                        .replace("from_s = 0.1", ""))  # fmt: skip
        made = prepare(load_study(path), tmp_path / "f")
        assert made.file("sand", "slow").read_bytes() == (tmp_path / "sand.hapf").read_bytes()
        (tmp_path / "c.hapf").write_bytes((tmp_path / "c.hapf").read_bytes()[:-200])
        with pytest.raises(ParameterError, match="is damaged; hapfmt recover it first"):
            prepare(load_study(path), tmp_path / "f")


def opened(study, prepared, path, subject="S1", output=None) -> AnswerFile:
    output = output or Nowhere()
    return AnswerFile(path, heading(study, prepared, subject, output.description), told.append)


told: list[str] = []


@pytest.fixture(autouse=True)
def nothing_told():
    told.clear()


def rate_all(study, prepared, path, subject, rating_of) -> None:
    with opened(study, prepared, path, subject) as file:
        rating = Rating(study, prepared, file, Nowhere())
        while rating.trial is not None:
            rating.play("this")
            rating.rate(rating_of(rating.trial))


def always(rating: float):
    return lambda _trial: rating


class TestAnswers:
    def test_every_cut_resumes(self, study, prepared, tmp_path):
        whole = tmp_path / "whole"
        rate_all(study, prepared, whole, "S1", always(50))
        data = whole.read_bytes()
        lines = data.split(b"\n")
        for cut in (0, 5, len(lines[0]), len(lines[0]) + 1, len(lines[0]) + 9, len(data) - 1):
            path = tmp_path / "cut"
            path.write_bytes(data[:cut])
            told.clear()
            with opened(study, prepared, path) as file:
                done = len(file.answers.lines)
                assert done == max(data[:cut].count(b"\n") - 1, 0)
                assert bool(told) == (cut > 0 and data[cut - 1 : cut] != b"\n")
                assert Rating(study, prepared, file, Nowhere()).number == done
            assert path.read_bytes().count(b"\n") == done + 1
            path.unlink()

    def test_refused(self, study, prepared, tmp_path):
        path = tmp_path / "a"
        rate_all(study, prepared, path, "S1", always(50))
        with pytest.raises(ParameterError, match="holds the answers of 'S1', not of 'S2'"):
            opened(study, prepared, path, "S2")
        with pytest.raises(ParameterError, match="felt in another way"):
            opened(study, prepared, path, output=WavFiles(study, prepared, tmp_path / "w"))
        changed = parse_study((TEXT + "# more").encode(), study.path)
        with pytest.raises(ParameterError, match="another study, or to this one before"):
            opened(changed, prepared, path)
        with pytest.raises(ParameterError, match="to other files"):
            opened(study, prepared._replace(stimuli=prepared.stimuli[1:] * 2), path)
        with opened(study, prepared, path), pytest.raises(ParameterError, match="another program"):
            opened(study, prepared, path)

    def test_a_full_disk_keeps_what_was_there(self, study, prepared, tmp_path, monkeypatch):
        path = tmp_path / "a"
        with opened(study, prepared, path) as file:
            before = path.read_bytes()
            with monkeypatch.context() as patch:
                patch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(OSError(28, "full")))
                with pytest.raises(OSError, match="full"):
                    file.add({"trial": 0})
            assert path.read_bytes() == before and not file.answers.lines

    @pytest.mark.parametrize(
        ("line", "fault"),
        [
            ("?", "line 2: this is not JSON"),
            ("[]", "line 2: this is not a JSON object"),
            ('{"trial": 99, "rating": 1}', "line 2: there is no trial 99"),
            ('{"trial": true, "rating": 1}', "line 2: trial: is true; write a whole number"),
            (
                '{"trial": 0, "rating": 101}',
                "rating: 101 is out of range; write a number from 0 to 100",
            ),
            ('{"trial": 0, "rating": NaN}', "rating: nan is out of range"),
            ('{"trial": 0}', "rating: is missing; add a number from 0 to 100"),
            ('{"trial": 0, "rating": 1}', "not what trial 0 asked"),
        ],
    )
    def test_broken_lines(self, study, prepared, line, fault):
        head = json.dumps(heading(study, prepared, "S1", {}))
        with pytest.raises(ParameterError, match=fault):
            parse_answers(f"{head}\n{line}\n".encode())

    def test_broken_heads(self, study, prepared):
        head = heading(study, prepared, "S1", {})
        for name in head.keys() - {"hapfmt", "at"}:
            less = json.dumps({key: value for key, value in head.items() if key != name})
            with pytest.raises(ParameterError, match="line 1"):
                parse_answers(less.encode() + b"\n")
        for order_ in (
            [[1]],
            [["sand", "b5", 0, 0]],
            [["sand", "x", 0, False]],
            head["order"][:-1],
        ):
            with pytest.raises(ParameterError, match="line 1"):
                parse_answers(json.dumps({**head, "order": order_}).encode() + b"\n")

    @given(st.data())
    def test_whatever_stands_in_a_head(self, study, prepared, data):
        """A head that is taken makes a summary."""
        head = json.loads(json.dumps(heading(study, prepared, "S1", {"kind": "x"})))
        node, path = head, []
        while isinstance(node, (dict, list)) and node and (not path or data.draw(st.booleans())):
            parent = node
            keys = list(node) if isinstance(node, dict) else range(len(node))
            path.append(data.draw(st.sampled_from(keys)))
            node = node[path[-1]]
        junk = st.sampled_from([None, True, -1, 0, 1, 1e300, "", "b5", "\0", [], [1], {}, {"a": 1}])
        parent[path[-1]] = data.draw(junk)
        lines = [
            {"trial": n, **Trial(*each)._asdict(), "rating": 50}
            for n, each in enumerate(head["order"] if isinstance(head["order"], list) else [])
            if isinstance(each, list) and len(each) == 4
        ]
        text = "\n".join(json.dumps(line) for line in [head, *lines]) + "\n"
        with suppress(ParameterError):
            found = summarise([parse_answers(text.encode())])
            assert len(table_rows(found)) in (12, 24)
            json.dumps(summary_json(found), allow_nan=False)

    @given(st.binary(max_size=200))
    def test_any_bytes(self, data):
        with suppress(ParameterError):
            parse_answers(data)


class TestRating:
    def test_course(self, study, prepared, tmp_path):
        with opened(study, prepared, tmp_path / "a") as file:
            rating = Rating(study, prepared, file, Nowhere())
            assert rating.place == (rating.place[0], 2, 1, 1) and rating.trial.training
            with pytest.raises(NotYetError, match="play this one first"):
                rating.rate(50)
            rating.play("reference")
            rating.again()
            assert rating.plays == {"this": 0, "reference": 2}
            with pytest.raises(NotYetError, match="no question before"):
                rating.back()
            for value in (10, 20):
                rating.play("this")
                rating.rate(value)
            assert rating.place == (1, 2, 2, 4) and rating.done == 2
            rating.back()
            assert rating.number == 1
            with pytest.raises(NotYetError, match="another session"):
                rating.back()
            rating.play("this")
            with pytest.raises(NotYetError, match="between 0 and 100"):
                rating.rate(float("nan"))
            rating.rate(30)
            assert rating.number == 2 and file.answers.ratings == {0: 10, 1: 30}
        assert load_answers(tmp_path / "a").ratings == {0: 10, 1: 30}

    def test_what_was_not_felt_does_not_count(self, study, prepared, tmp_path):
        class Late(Nowhere):
            def play(self, _path, _label):
                return FeltStimulus("late")

        with opened(study, prepared, tmp_path / "a") as file:
            rating = Rating(study, prepared, file, Late())
            assert rating.play("this") == "late"
            with pytest.raises(NotYetError):
                rating.rate(1)


class TestOutputs:
    def test_a_device(self, prepared, tmp_path):
        """What it gets for a condition, in a file of its frames."""
        from replaying import glove, lines

        profile = glove()
        frames = tmp_path / "frames"
        mapping = ChannelMap(("0=1",))
        device = DeviceOutput(
            profile, {"kind": "loopback", "file": str(frames)}, 0.25, mapping, watchdog=False
        )
        path = prepared.file("cork", "b5")
        assert plan(path, profile, mapping)[-1] == "at rest: index, middle, ring, little"
        assert device.description == {
            "kind": "device", "profile": profile.name, "gain": 0.25, "channels": ["0=1"],
            "profile_sha256": hashlib.sha256(profile.text.encode()).hexdigest(),
        }  # fmt: skip
        device.play(path, "trial 1")
        sent = {line.number: line.counts[0] for line in lines(frames)}  # some may be skipped
        force = 250 * hapfmt.read(path).channels[0].samples()  # counts of 1 mN, at this gain
        later = sorted(set(range(80, 190)) & sent.keys())  # the ramp of the start is over
        assert len(later) > 20
        assert max(abs(sent[number] - force[number]) for number in later) < 5
        assert Nowhere(profile, 0.25, mapping).play(path, "trial 1") == FeltStimulus()

    def test_what_no_actuator_takes(self, tmp_path):
        from replaying import glove

        metres = hapfmt.Channel.from_physical(np.ones(50), 1000, unit="m")
        hapfmt.write(hapfmt.Recording((metres,)), tmp_path / "m.hapf")
        with pytest.raises(ParameterError, match="its unit is m, the actuator takes N"):
            plan(tmp_path / "m.hapf", glove(), ChannelMap())

    def test_no_channel_is_guessed(self, prepared):
        """One force and five fingers: the study says which, and its answers keep it."""
        from replaying import glove

        path, profile = prepared.file("cork", "b5"), glove()
        with pytest.raises(ParameterError, match="replay does not guess"):
            plan(path, profile, ChannelMap())
        assert plan(path, profile, ChannelMap(by_order=True))[0].startswith("thumb <- 0 ")
        told = DeviceOutput(
            profile, {}, None, ChannelMap(("0=1",), ("x",), by_order=True)
        ).description
        assert told.items() >= {"channels": ["0=1"], "ignored": ["x"], "by_order": True}.items()

    def test_wav_is_level(self, study, prepared, tmp_path):
        pytest.importorskip("soundfile")
        output = WavFiles(study, prepared, tmp_path / "w")
        found = {}
        for name in ("same", "anchor"):
            output.play(prepared.file("sand", name), name)
            found[name] = hapfmt.read(tmp_path / "w" / f"{name}.wav").channels[0]
        y = found["same"].samples()
        assert found["same"].rate_exact == 48_000 and y.size == 0.4 * 48_000
        assert 0.4 < np.abs(y).max() < 0.6 and abs(y[0]) < 1e-3 and abs(y[-1]) < 1e-3
        x = hapfmt.read(prepared.file("sand", "anchor")).channels[0].samples()
        level = output.levels[prepared.file("sand", "same")]
        there = (x - level.offset) * level.scale
        middle = found["anchor"].samples()[4800:-4800:48]
        assert np.abs(middle - there[100:-100]).max() < 0.02

    def test_without_scipy(self, monkeypatch):
        channel = hapfmt.Channel(np.sin(np.arange(99.0)), 1000)
        monkeypatch.setitem(sys.modules, "scipy.signal", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[sound\]"):
            outputs.signal(channel, outputs.level_of(channel))

    def test_a_card(self, study, prepared, monkeypatch):
        played = []

        class Fake:
            PortAudioError = OSError

            @staticmethod
            def check_output_settings(channels, **_):
                if channels > 2:
                    raise ValueError("too many channels")

            play = staticmethod(lambda y, rate, **how: played.append((y, rate, how)))
            stop = staticmethod(lambda: played.append("stop"))

        monkeypatch.setitem(sys.modules, "sounddevice", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[sound\]"):
            outputs.Card(1, None)
        monkeypatch.setitem(sys.modules, "sounddevice", Fake)
        with pytest.raises(ParameterError, match="no sound card plays channel 3"):
            outputs.Card(3, None)
        from hapfmt.lab.study.outputs import SoundCard

        card = SoundCard(study, prepared, outputs.Card(*outputs.parse_card("2/USB Audio")))
        assert card.description == {"kind": "sound", "channel": 2, "device": "USB Audio"}
        card.play(prepared.file("sand", "b5"), "trial 1")
        (y, rate, how), end = played
        assert y.shape == (19_200, 1) and y.dtype == np.float32 and rate == 48_000
        assert how["mapping"] == [2] and how["blocking"] and end == "stop"
        for bad in ("0", "x", "1/", "", "-1", "999"):
            with pytest.raises(ParameterError, match="not an output of a sound card"):
                outputs.parse_card(bad)
        assert outputs.parse_card("1/3") == (1, 3)


class TestSummary:
    @given(st.lists(st.floats(0, 100), min_size=2, max_size=30))
    def test_interval_is_that_of_scipy(self, values):
        found = mean_of(values)
        if np.ptp(values) < 1e-6:
            return
        low, high = stats.t.interval(
            0.95, len(values) - 1, loc=np.mean(values), scale=stats.sem(values)
        )
        assert found.low == pytest.approx(low) and found.high == pytest.approx(high)
        assert found.n == len(values)

    def test_one_number_has_no_interval(self):
        assert mean_of([7]) == (1, 7, None, None, None)

    def test_with_and_without_those_who_missed(self, study, prepared, tmp_path):
        rng = np.random.default_rng(1)
        given_: dict[tuple[str, str, str], float] = {}

        def rating_of(subject):
            def one(trial):
                base = {"same": 97, "b5": 80, "slow": 40, "anchor": 20}[trial.condition]
                if subject == "S3" and trial.condition == "same":
                    base = 60
                value = round(float(np.clip(base + rng.normal(0, 2), 0, 100)), 1)
                if not trial.training:
                    given_[subject, trial.session, trial.condition] = value
                return value

            return one

        paths = [tmp_path / f"{name}.jsonl" for name in ("S1", "S2", "S3", "S4")]
        for path in paths[:3]:
            rate_all(study, prepared, path, path.stem, rating_of(path.stem))
        with opened(study, prepared, paths[3], "S4"):
            pass
        found = summarise([load_answers(path) for path in paths])
        assert found.screened_out == ("S3",) and [s.name for s in found.unfinished] == ["S4"]
        assert [(s.misses, s.items) for s in found.subjects] == [(0, 2), (0, 2), (2, 2)]
        for rows, names in ((found.rows, "S1 S2 S3"), (found.kept, "S1 S2")):
            for row in rows:
                sessions = [row.session] if row.session else ["sand", "cork"]
                means, base = (
                    np.array([np.mean([given_[s, where, what] for where in sessions])
                              for s in names.split()])
                    for what in (row.condition, "same")
                )  # fmt: skip
                assert row.rating.mean == pytest.approx(means.mean())
                expected = stats.ttest_rel(means, base).confidence_interval() if (
                    row.condition != "same"
                ) else (0, 0)  # fmt: skip
                assert (row.difference.low, row.difference.high) == pytest.approx(tuple(expected))
                half = stats.t.ppf(0.975, len(means) - 1) * stats.sem(means)
                assert row.rating.half == pytest.approx(half)
        assert len(found.rows) == 12 and "a dry run" in found.notes[0]
        told = json.loads(json.dumps(summary_json(found), allow_nan=False))
        assert told["subjects"][2]["screened_out"] and len(told["screened"]) == 12
        assert len(table_rows(found)) == 24

    def test_refused(self, study, prepared, tmp_path):
        rate_all(study, prepared, tmp_path / "a", "S1", always(90))
        one = load_answers(tmp_path / "a")
        with pytest.raises(ParameterError, match="two files hold answers of 'S1'"):
            summarise([one, one])
        changed = parse_study((TEXT + "# more").encode(), study.path)
        rate_all(changed, prepared, tmp_path / "b", "S2", always(90))
        with pytest.raises(ParameterError, match="cannot be put together"):
            summarise([one, load_answers(tmp_path / "b")])
        with opened(study, prepared, tmp_path / "c", "S3"):
            pass
        with pytest.raises(
            ParameterError, match="no subject has answered every question: S3 has 8"
        ):
            summarise([load_answers(tmp_path / "c")])
        (tmp_path / "d").write_bytes(b"{")
        with pytest.raises(ParameterError, match="not even their first line"):
            load_answers(tmp_path / "d")


def test_fifths():
    words = [fifth(value) for value in (0, 19.9, 20, 59.9, 80, 100)]
    assert words == ["Bad", "Bad", "Poor", "Fair", "Excellent", "Excellent"]
