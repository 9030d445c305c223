"""HJIF and AHAP. No Python package reads them: the files follow MPEG's reference software (its JSON
reader, and how it evaluates a curve) and Apple's description of AHAP."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from formats import damaged, survives, written
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

from hapfmt.convert import patterns, read
from hapfmt.errors import LimitError, ParameterError
from hapfmt.recording import Calibration, Channel, Event, Recording, Span

PAGE = ROOT / "docs" / "haptic-patterns.md"


def frame(at: int, amplitude: float | None = None, frequency: int | None = None) -> dict[str, Any]:
    said = {"amplitude_modulation": amplitude, "frequency_modulation": frequency}
    return {"relative_position": at, **{k: v for k, v in said.items() if v is not None}}


def basis(position: int, *frames: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {
        "effect_type": "Basis", "position": position, "phase": 0, "base_signal": "Sine",
        "keyframes": list(frames), **more,
    }  # fmt: skip


def band(kind: str, *effects: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {
        "band_type": kind, "curve_type": "Linear", "lower_frequency_limit": 0,
        "upper_frequency_limit": 100, "effects": list(effects), **more,
    }  # fmt: skip


def hjif(*bands: dict[str, Any], library: Any = (), **root: Any) -> bytes:
    channel = {
        "id": 0, "description": "palm", "gain": 1, "mixing_coefficient": 1, "body_part_mask": 0,
        "bands": list(bands),
    }  # fmt: skip
    perception = {
        "id": 0, "avatar_id": 0, "description": "grip", "perception_modality": "Force",
        "effect_library": list(library), "channels": [channel],
    }  # fmt: skip
    return json.dumps({
        "version": "2023", "profile": "Main", "level": 1, "date": "2026", "description": "squeeze",
        "timescale": 1000, "avatars": [], "perceptions": [perception], "syncs": [], **root,
    }).encode()  # fmt: skip


def evaluated(data: bytes, channel: int, position: float) -> float:
    """How MPEG's reference software evaluates a linear curve band: the last effect that has begun
    counts, and 0 is played before and after."""
    found = json.loads(data)
    own = found["perceptions"][0]["channels"][channel]
    [curve] = own["bands"]
    begun = [effect for effect in curve["effects"] if effect["position"] <= position]
    if not begun:
        return 0.0
    effect = begun[-1]
    frames = [(f["relative_position"], f["amplitude_modulation"]) for f in effect["keyframes"]]
    at = position - effect["position"]
    if at > frames[-1][0]:
        return 0.0
    return float(own["gain"] * np.interp(at, *zip(*frames, strict=True)))


def notes(data: bytes, format: str) -> list[str]:
    return read(data, format=format).metadata.get("notes", [])


class TestHjif:
    def test_a_curve(self) -> None:
        data = hjif(
            band("Curve", basis(10, frame(0, 0.0), frame(4, 1.0)), basis(30, frame(0, 0.5)))
        )
        [palm] = read(data, format="hjif")
        assert (palm.label, palm.group, palm.rate_exact) == ("palm", "grip", 1000)
        assert palm.coverage == (Span(10, 15), Span(30, 31))
        assert palm.samples().tolist() == [0, 0.25, 0.5, 0.75, 1, 0.5]
        assert read(data, format="hjif").metadata["hjif"]["description"] == "squeeze"

    def test_the_next_effect_takes_over(self) -> None:
        data = hjif(band("Curve", basis(0, frame(0, 0.0), frame(8, 8.0)), basis(4, frame(0, 1.0),
                         frame(1, 1.0))))  # fmt: skip
        assert read(data, format="hjif")[0].samples().tolist() == [0, 1, 2, 3, 1, 1]

    def test_an_effect_begins_at_its_position(self) -> None:
        [palm] = read(hjif(band("Curve", basis(5, frame(2, 1.0), frame(4, 3.0)))), format="hjif")
        assert palm.coverage == (Span(5, 10),)
        assert palm.samples().tolist() == [1, 1, 1, 2, 3]

    def test_waves_have_two_curves(self) -> None:
        data = hjif(
            band("Curve", basis(0, frame(0, 1.0))),
            band("VectorialWave", basis(0, frame(0, 0.5, 60), frame(2, 1.0), frame(4, None, 100))),
        )
        back = read(data, format="hjif")
        assert back.labels == ["palm.0", "palm.1.amplitude", "palm.1.frequency"]
        assert back["palm.1.amplitude"].samples().tolist() == [0.5, 0.75, 1]
        assert back["palm.1.frequency"].samples().tolist() == [60, 70, 80, 90, 100]
        assert back["palm.1.frequency"].unit == "Hz"

    def test_transients_are_events(self) -> None:
        data = hjif(band("Transient", basis(100, frame(0, 1.0, 80), frame(250, 0.5))))
        assert read(data, format="hjif").events == (
            Event(Fraction(1, 10), '{"amplitude": 1.0, "frequency": 80.0}', layer="palm"),
            Event(Fraction(35, 100), '{"amplitude": 0.5}', layer="palm"),
        )

    def test_references_gain_and_unit(self) -> None:
        library = [{**basis(0, frame(0, 0.5), frame(1, 0.25)), "id": 7}]
        effects = [{"effect_type": "Reference", "id": 7, "position": at} for at in (0, 4)]
        effects.append({"effect_type": "Reference", "id": 8, "position": 9})
        data = hjif(band("Curve", *effects), library=library)
        data = data.replace(b'"gain": 1', b'"gain": 8').replace(b'"palm"', b'"palm [N]"')
        [palm] = read(data, format="hjif")
        assert (palm.label, palm.unit) == ("palm", "N")
        assert palm.coverage == (Span(0, 2), Span(4, 6))
        assert palm.samples().tolist() == [4, 2, 4, 2]
        assert notes(data, "hjif") == ["a reference of 'palm' to no basis effect is not read"]

    def test_what_is_approximated_or_left_out(self) -> None:
        data = hjif(
            band("Curve", basis(0, frame(0, 1.0)), curve_type="Cubic"),
            band("WaveletWave", basis(0), block_length=64),
            band("VectorialWave", basis(0, frame(0, 1.0), base_signal="Square")),
            band("Curve", {"effect_type": "Timeline", "position": 0}),
        )
        assert notes(data, "hjif") == [
            "the curve of 'palm.0' is Cubic; straight lines join its keyframes here",
            "the band 'palm.1' holds WaveletWave, which is not read",
            "the phases and wave shapes of 'palm.2' are not kept",
            "effects of 'palm.3' that are neither Basis nor Reference are not read",
        ]

    def test_rate_and_select(self) -> None:
        data = hjif(band("Curve", basis(0, frame(0, 0.0), frame(40, 4.0))), timescale=8000)
        [palm] = read(data, format="hjif", rate=1000)
        assert palm.samples().tolist() == [0, 0.8, 1.6, pytest.approx(2.4), 3.2, 4]
        assert read(data, format="hjif")[0].rate_exact == 8000
        with pytest.raises(ParameterError, match="no curve is called 'x'; there are: 'palm'"):
            read(data, format="hjif", select="x")


PATTERN = {
    "Version": 1.0,
    "Pattern": [
        {"Event": {"Time": 0.25, "EventType": "HapticTransient", "EventParameters": [
            {"ParameterID": "HapticIntensity", "ParameterValue": 0.8}]}},
        {"Event": {"Time": 0.5, "EventType": "HapticContinuous", "EventDuration": 0.125,
                   "EventParameters": []}},
        {"Event": {"Time": 1, "EventType": "AudioCustom", "EventWaveformPath": "a.wav"}},
        {"Parameter": {"ParameterID": "HapticSharpnessControl", "ParameterValue": 0.5, "Time": 2}},
        {"ParameterCurve": {"ParameterID": "HapticIntensityControl", "Time": 0.01,
            "ParameterCurveControlPoints": [{"Time": 0, "ParameterValue": 1},
                                            {"Time": 0.004, "ParameterValue": 0}]}},
        {"ParameterCurve": {"ParameterID": "HapticIntensityControl", "Time": 0.1,
            "ParameterCurveControlPoints": [{"Time": 0.0005, "ParameterValue": 1}]}},
        {"Other": 5},
    ],
}  # fmt: skip


def ahap(*entries: Any) -> bytes:
    return json.dumps({"Version": 1, "Pattern": list(entries)}).encode()


class TestAhap:
    def test_events_and_curves(self) -> None:
        back = read(json.dumps(PATTERN).encode(), format="ahap")
        assert back.events == (
            Event(Fraction(1, 4), '{"HapticIntensity": 0.8}', layer="HapticTransient"),
            Event(Fraction(1, 2), "{}", Fraction(1, 8), layer="HapticContinuous"),
            Event(Fraction(1), '{"EventWaveformPath": "a.wav"}', layer="AudioCustom"),
            Event(Fraction(2), "0.5", layer="HapticSharpnessControl"),
        )
        [curve] = back.channels
        assert (curve.label, curve.rate_exact) == ("HapticIntensityControl", 1000)
        assert curve.coverage == (Span(10, 15),)
        assert curve.samples().tolist() == [1, 0.75, 0.5, 0.25, 0]
        assert back.metadata["notes"] == [
            "the sound 'a.wav' is not read",
            "points of 'HapticIntensityControl' lie between two ticks of 1000 Hz",
            "entries 'Other' of the pattern are not read",
        ]


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    found = []
    for number in range(draw(st.integers(1, 3))):
        spans, at = [], draw(st.integers(0, 5))
        for _ in range(draw(st.integers(1, 3))):
            size = draw(st.integers(1, 9))
            spans.append(Span(at, at + size))
            at += size + draw(st.integers(1, 30))
        count = sum(span.ticks for span in spans)
        label = draw(st.sampled_from(["fx", "fy [raw]", "grip (left)"])) + str(number) * number
        described: dict[str, Any] = {
            "label": label,
            "unit": draw(st.sampled_from(["1", "N", "[g]", "m/s2"])),
            "coverage": tuple(spans),
        }
        rate = draw(st.sampled_from([1000, 500, 100]))
        if draw(st.booleans()):
            x = draw(st.lists(st.integers(-3000, 3000), min_size=count, max_size=count))
            scale = Calibration(draw(st.integers(1, 9)), draw(st.integers(-9, 9)), 100)
            found.append(Channel(np.array(x, np.int32), rate, calibration=scale, **described))
        else:
            y = draw(st.lists(st.floats(-1e6, 1e6, width=32), min_size=count, max_size=count))
            found.append(Channel(np.array(y), rate, **described))
    return Recording(tuple(found))


class TestThereAndBack:
    @given(recordings())
    def test_within_the_bound_of_the_note(self, given: Recording) -> None:
        out, told = written(given, "hjif")
        back = read(out, format="hjif")
        scale = json.loads(out)["timescale"]
        for place, (one, other) in enumerate(zip(given, back, strict=True)):
            assert (other.label, other.unit) == (one.label, one.unit)
            own = [note for note in told if f"channel {one.label!r} are rounded" in note]
            bound = float(own[0].split("at most ")[1].split()[0]) if own else 0.0
            step = scale // int(one.rate_exact)
            ticks = np.concatenate([np.arange(*span) for span in one.coverage])
            for tick, value in zip(ticks.tolist(), one.samples().tolist(), strict=True):
                assert abs(evaluated(out, place, tick * step) - value) <= bound
            [again] = read(out, format="hjif", rate=one.rate_exact, select=one.label)
            if step == 1:
                assert other.coverage == one.coverage
            assert again.start_tick == one.start_tick
            assert np.abs(again.samples() - one.samples()).max() <= bound

    def test_few_keyframes_for_a_curve_of_straight_lines(self) -> None:
        x = np.interp(np.arange(10_001), [0, 2000, 2500, 10_000], [0, 3, -1, 2])
        given = Channel(np.rint(x * 1000).astype(np.int32), 1000, calibration=Calibration(1, 0, 1000),
                        label="fx", unit="N")  # fmt: skip
        out, told = written(Recording((given,)), "hjif")
        assert out.count(b"relative_position") < 20
        assert told[0] == (
            "the values of channel 'fx' are rounded to straight lines, at most 0.00101 N off"
        )
        assert np.abs(read(out, format="hjif")[0].samples() - given.samples()).max() <= 0.00101

    def test_it_is_what_the_reference_software_asks_for(self) -> None:
        """The members that its reader requires, and their types."""
        out, _ = written(Recording((Channel(np.zeros(3), 100, label="fx"),)), "hjif")
        found = json.loads(out)
        assert [*map(type, (found[k] for k in ("version", "profile", "level", "date")))] == [
            str, str, int, str
        ]  # fmt: skip
        assert re.fullmatch(r"\d{4}", found["version"]) and found["profile"] == "Main"
        assert found["avatars"] == found["syncs"] == []
        [perception] = found["perceptions"]
        assert {"id", "avatar_id", "description", "perception_modality", "effect_library"} <= set(
            perception
        )
        [channel] = perception["channels"]
        assert {"id", "description", "gain", "mixing_coefficient", "body_part_mask"} <= set(channel)
        [only] = channel["bands"]
        assert type(only["lower_frequency_limit"]) is type(only["upper_frequency_limit"]) is int
        [effect] = only["effects"]
        assert {"effect_type", "position", "phase", "base_signal", "keyframes"} <= set(effect)

    def test_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        with pytest.raises(ParameterError, match="whole ticks of up to 48000 Hz"):
            written(Recording((Channel(np.zeros(3), "1/3"),)), "hjif")
        with pytest.raises(ParameterError, match=r"'fx' holds infinities or NaN; use .npz"):
            written(Recording((Channel(np.array([np.inf]), 10, label="fx"),)), "hjif")
        noise = np.random.default_rng(1).normal(size=300)
        monkeypatch.setattr(patterns, "FRAMES_LIMIT", 200)
        with pytest.raises(LimitError, match="need more than 200 keyframes"):
            written(Recording((Channel(noise, 1000, label="fx"),)), "hjif")


def played(data: bytes, name: str, time: float) -> float | None:
    """The value of a parameter curve, as Apple describes it: lines between the control points."""
    for entry in json.loads(data)["Pattern"]:
        curve = entry.get("ParameterCurve", {})
        if curve.get("ParameterID") == name:
            assert set(curve) == {"ParameterID", "Time", "ParameterCurveControlPoints"}
            points = [(curve["Time"] + p["Time"], p["ParameterValue"])
                      for p in curve["ParameterCurveControlPoints"]]  # fmt: skip
            assert 0 < len(points) <= 16
            if points[0][0] - 1e-9 <= time <= points[-1][0] + 1e-9:
                return float(np.interp(time, *zip(*points, strict=True)))
    return None


class TestAhapThereAndBack:
    def test_a_pattern(self) -> None:
        given = read(json.dumps(PATTERN).encode(), format="ahap")
        out, told = written(given, "ahap")
        back = read(out, format="ahap")
        assert back.events == given.events
        assert [c.label for c in back] == [c.label for c in given]
        assert [c.coverage for c in back] == [c.coverage for c in given]
        assert np.abs(back[0].samples() - given[0].samples()).max() <= 1e-7
        assert "not carried over to .ahap: metadata 'ahap'" in told

    @given(st.lists(st.integers(0, 1000), min_size=1, max_size=80), st.sampled_from([100, 1000]))
    def test_curves(self, x: list[int], rate: int) -> None:
        size = len(x)
        coverage = (Span(5, 5 + size), Span(size + 9, size * 2 + 9))
        given = Channel(np.array(x * 2, np.int32), rate, coverage, Calibration(1, 0, 1000),
                        label="HapticIntensityControl")  # fmt: skip
        out, told = written(Recording((given,)), "ahap")
        assert "the pattern has no HapticContinuous event, so a device plays nothing" in told
        ticks = [*range(5, 5 + size), *range(size + 9, size * 2 + 9)]
        for tick, value in zip(ticks, given.samples().tolist(), strict=True):
            found = played(out, given.label, tick / rate)
            assert found is not None and abs(found - value) <= 0.00101
        back = read(out, format="ahap", rate=rate)
        assert back[0].coverage == given.coverage
        assert np.abs(back[0].samples() - given.samples()).max() <= 0.00101

    def test_refused(self) -> None:
        with pytest.raises(ParameterError, match="channel 'fx' is not called after a parameter"):
            written(Recording((Channel(np.zeros(3), 100, label="fx"),)), "ahap")
        high = Channel(np.array([0, 1.5]), 100, label="HapticIntensityControl")
        with pytest.raises(ParameterError, match=r"holds values from 0 to 1.5, not from 0 to 1"):
            written(Recording((high,)), "ahap")

    def test_other_events(self) -> None:
        events = (
            Event(Fraction(0), "slip"),
            Event(Fraction(1), "[1]", layer="HapticTransient"),
            Event(Fraction(2), "x", layer="HapticSharpnessControl"),
        )
        out, told = written(Recording((), events=events), "ahap")
        assert json.loads(out)["Pattern"] == []
        assert "3 events that are not of Apple's kinds are not carried over" in told


BAD = {
    "hjif": {
        "this is not an? HJIF file: Expecting": b"{",
        "it is not an object": b"[]",
        "nested too deeply": b"[" * 60_000,
        "perceptions are missing": b"{}",
        "perceptions is not a list of objects": b'{"perceptions": [5]}',
        "the timescale is 0, not a whole number": hjif(timescale=0),
        "the position of an effect is -1": hjif(band("Curve", basis(-1))),
        "the position of a keyframe is 1.5": hjif(band("Curve", basis(0, frame(1.5, 1.0)))),  # type: ignore[arg-type]
        "an amplitude_modulation is not finite": hjif(band("Curve", basis(0, frame(0, float("nan"))))),
        "an amplitude_modulation is 'x'": hjif(band("Curve", basis(0, frame(0, "x")))),  # type: ignore[arg-type]
        "a band_type is a list": hjif(band([])),  # type: ignore[arg-type]
        "the description of a channel: ": hjif().replace(b'"palm"', b'"\\ud800"'),
    },
    "ahap": {
        "Pattern is missing": b"{}",
        "Event in Pattern is not a list of objects": ahap({"Event": 5}),
        "an EventType is None": ahap({"Event": {}}),
        "a Time is -1 s": ahap({"Event": {"EventType": "x", "Time": -1}}),
        "a ParameterValue is True": ahap({"Parameter": {"ParameterID": "x", "ParameterValue": True}}),
        "is 1e\\+15|is 1000000000000000": ahap({"Parameter": {"ParameterID": "x", "ParameterValue": 10**16}}),
    },
}  # fmt: skip


class TestHostile:
    @pytest.mark.parametrize(
        ("format", "message"), [(format, each) for format in BAD for each in BAD[format]]
    )
    def test_refused(self, format: str, message: str) -> None:
        with pytest.raises(ParameterError, match=message):
            read(BAD[format][message], format=format)

    def test_long_curves(self) -> None:
        data = hjif(band("Curve", basis(0, frame(0, 1.0), frame(2**31 - 1, 1.0))))
        with pytest.raises(LimitError, match="more samples than allowed"):
            read(data, format="hjif", max_memory=1 << 24)

    def test_references_that_multiply(self, monkeypatch: pytest.MonkeyPatch) -> None:
        library = [{**basis(0, *[frame(i, 1.0) for i in range(30)]), "id": 1}]
        effects = [{"effect_type": "Reference", "id": 1, "position": i} for i in range(30)]
        monkeypatch.setattr(patterns, "FRAMES_LIMIT", 800)
        with pytest.raises(LimitError, match="more than 800 effects and keyframes"):
            read(hjif(band("Curve", *effects), library=library), format="hjif")

    def test_long_files(self) -> None:
        with pytest.raises(LimitError, match="the AHAP file is longer than 16384 bytes"):
            read(ahap(*[{}] * 9000), format="ahap", max_memory=1 << 20)

    def test_damage(self) -> None:
        curve = band("Curve", basis(10, frame(0, 0.5), frame(4, 1.0)))
        for each in damaged(hjif(curve, band("VectorialWave", basis(0, frame(0, 1.0, 60))))):
            survives(each, "hjif")
        for each in damaged(json.dumps(PATTERN).encode()):
            survives(each, "ahap")


def table(section: str) -> dict[str, dict[str, str]]:
    part = PAGE.read_text("utf-8").split(f"## {section}")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (.+?) \| (.+?) \| (.+?) \|$", part, re.M)
    return {name: {"hjif": first, "ahap": second} for name, first, second in rows}


def back_of(format: str, **described: Any) -> tuple[Recording, Recording, str]:
    """A recording of one channel, what comes back of it, and the notes."""
    known = {
        "stored": np.arange(100, dtype=np.int16), "rate": 1000, "calibration": Calibration(1, 0, 100),
        "label": "fx" if format == "hjif" else "HapticIntensityControl", **described,
    }  # fmt: skip
    own = {key: known.pop(key) for key in ("events", "epoch_ns") if key in known}
    given = Recording((Channel(known.pop("stored"), **known),), **own)
    out, told = written(given, format)
    return given, read(out, format=format), " ".join(told)


def rounded(format: str, **described: Any) -> str:
    given, back, told = back_of(format, **described)
    assert "rounded" in told
    assert np.abs(given[0].samples() - back[0].samples()).max() <= 0.0101
    return "rounded"


def same(format: str, member: str, **described: Any) -> str:
    try:
        given, back, told = back_of(format, **described)
    except ParameterError as error:
        assert "use ." in str(error)
        return "refused"
    if getattr(given[0], member) == getattr(back[0], member):
        return "exact"
    assert "is not kept" in told or f"not carried over to .{format}: {member}" in told
    return "no"


def carried(format: str, member: str, value: Any) -> str:
    given, back, told = back_of(format, **{member: value})
    if getattr(given, member) == getattr(back, member):
        return "exact"
    assert "not carried over" in told and member.rstrip("s") in told
    return "no"


GAP = (Span(0, 50), Span(70, 120))
APPLE = (Event(Fraction(1, 50), '{"HapticIntensity": 0.5}', layer="HapticTransient"),)
WRITTEN: dict[str, Callable[[str], str]] = {
    "integers": rounded,
    "floating point": lambda f: rounded(f, stored=np.arange(100) / 100, calibration=None),
    "a rate of 1000 Hz": lambda f: same(f, "rate_exact"),
    "a rate of 44100/7 Hz": lambda f: same(f, "rate_exact", rate=Fraction(44_100, 7)),
    "a rate of 1/3 Hz": lambda f: same(f, "rate_exact", rate=Fraction(1, 3)),
    "gaps": lambda f: same(f, "coverage", coverage=GAP),
    "labels": lambda f: same(f, "label", label="thumb, force [x]"),
    "units": lambda f: same(f, "unit", unit="m/s2"),
    "groups": lambda f: same(f, "group", group="hand"),
    "events": lambda f: carried(f, "events", (Event(Fraction(1, 50), "slip"),)),
    "events of Apple's kinds": lambda f: carried(f, "events", APPLE),
    "the start time": lambda f: carried(f, "epoch_ns", 10**18),
}


class TestPage:
    @pytest.mark.parametrize("format", ["hjif", "ahap"])
    @pytest.mark.parametrize("row", WRITTEN)
    def test_cells(self, row: str, format: str) -> None:
        assert WRITTEN[row](format) == table("What comes back")[row][format]

    def test_the_table_has_no_other_row(self) -> None:
        assert [*table("What comes back")] == [*WRITTEN]


def test_command_line(tmp_path: Path) -> None:
    (tmp_path / "a.hjif").write_bytes(hjif(band("Curve", basis(0, frame(0, 0.0), frame(9, 1.0)))))
    shown = run("info", "a.hjif", cwd=tmp_path).stdout.decode()
    assert "HJIF: 1 channel" in shown
    assert run("convert", "a.hjif", "b.hjif", cwd=tmp_path).returncode == 0
    back, found = read(tmp_path / "b.hjif"), read(tmp_path / "a.hjif")
    assert np.abs(back["palm"].samples() - found["palm"].samples()).max() < 1e-6
