"""The tools of the viewer that work on a selection: their numbers, run by node; their tabs, in Chromium."""

from __future__ import annotations

import atexit
import base64
import io
import json
import re
import shutil
import subprocess
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import exported, served
from depth import deep
from edited import PRESETS, made, packets_of, tracks_of
from numpy.typing import NDArray
from spec import ROOT

import hapfmt
from hapfmt.format.source import BytesSource
from hapfmt.reading.opening import open_catalogue
from hapfmt.reading.reader import stored_digests

EXAMPLES = sorted((ROOT / "conformance" / "examples").glob("*.hapf"))
NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="needs node")


@cache
def program() -> subprocess.Popen[str]:
    """Of all tests here: to start it takes longer than most of them."""
    assert NODE
    made = subprocess.Popen(
        [NODE, str(ROOT / "tests" / "viewer" / "pure.mjs")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    atexit.register(made.communicate)
    return made


def node(module: str, code: str, given: Any) -> Any:
    """What ``code`` returns, with the module as ``m`` and the value as ``input``."""
    text = json.dumps({"module": module, "code": code, "input": given}, default=np.ndarray.tolist)
    text = re.sub(r"(?<![\w\"])-?(?:NaN|Infinity)", r'"\g<0>"', text)
    process = program()
    assert process.stdin and process.stdout
    process.stdin.write(f"{text}\n")
    process.stdin.flush()
    told = json.loads(process.stdout.readline())
    assert "error" not in told, told["error"]
    return told["value"]


def noisy(count: int, seed: int = 1) -> NDArray[np.float64]:
    t = np.arange(count)
    return np.random.default_rng(seed).normal(3, 1, count) + 5 * np.sin(t / 7)


WELCH = """
  const welch = new m.Welch(input.length, input.rate);
  for (let at = 0; at < input.x.length; at += 1000) welch.push(Float64Array.from(input.x.slice(at, at + 1000)));
  return welch.result();
"""


@needs_node
@pytest.mark.parametrize("length", [256, *deep([16, 4096])])
def test_the_spectrum_is_that_of_scipy(length: int) -> None:
    signal = pytest.importorskip("scipy.signal", reason="scipy is not installed")
    x = noisy(20_000)
    found = node("page/welch.js", WELCH, {"length": length, "rate": 1250.5, "x": x})
    frequency, density = signal.welch(x, 1250.5, "hann", length)
    np.testing.assert_allclose(found["frequency"], frequency, rtol=1e-12)
    np.testing.assert_allclose(found["density"], density, rtol=1e-9)


@needs_node
def test_the_spectrum_has_no_segment_with_a_gap() -> None:
    signal = pytest.importorskip("scipy.signal", reason="scipy is not installed")
    x = noisy(9000)
    x[2500] = x[5000:5100] = x[8990] = np.nan
    x[7000] = np.inf
    runs = [x[:2500], x[2501:5000], x[5100:7000], x[7001:8990]]
    found = node(
        "page/welch.js", WELCH,
        {"length": 512, "rate": 1000, "x": x},
    )  # fmt: skip
    counts = [(run.size - 512) // 256 + 1 for run in runs]
    parts = [signal.welch(run, 1000, "hann", 512)[1] for run in runs]
    assert found["segments"] == sum(counts)
    np.testing.assert_allclose(found["density"], np.average(parts, 0, counts), rtol=1e-9)


@needs_node
def test_the_spectrogram_is_that_of_scipy() -> None:
    signal = pytest.importorskip("scipy.signal", reason="scipy is not installed")
    x = noisy(64 + 9 * 32)
    code = """
      const grid = new m.Spectrogram(64, 500, input.length, 10);
      grid.push(Float64Array.from(input));
      return Array.from({ length: 10 }, (_, c) => Array.from({ length: 33 }, (_, k) => grid.level(c, k)));
    """
    found = np.array(node("page/spectrogram.js", code, x))
    _, _, density = signal.spectrogram(x, 500, "hann", 64, 32)
    np.testing.assert_allclose(found, 10 * np.log10(density.T), atol=1e-5)
    x[150:] = np.nan
    found = np.array(node("page/spectrogram.js", code, x), dtype=float)
    assert np.isnan(found[3:]).all() and np.isfinite(found[:3]).all()


@needs_node
def test_colours_get_lighter() -> None:
    code = "return Array.from({ length: 201 }, (_, i) => m.colorAt(i / 200));"
    colors = np.array(node("page/spectrogram.js", code, None)) / 255
    luminance = (colors**2.2) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) >= 0).all() and luminance[-1] - luminance[0] > 0.8


SUMMARY = """
  const summary = new m.Summary();
  for (let at = 0; at < input.length; at += 7001) summary.push(Float64Array.from(input.slice(at, at + 7001)));
  return summary.result();
"""


@needs_node
@pytest.mark.parametrize("offset", [1e7, *deep([0.0, -1e-9])])
def test_statistics_are_those_of_numpy(offset: float) -> None:
    x = noisy(100_000) + offset
    x[::17] = np.nan
    found = node("page/summary.js", SUMMARY, x)
    known = x[~np.isnan(x)]
    assert (found["count"], found["missing"]) == (known.size, x.size - known.size)
    assert (found["min"], found["max"], found["peakToPeak"]) == (
        known.min(), known.max(), np.ptp(known),
    )  # fmt: skip
    assert found["mean"] == pytest.approx(known.mean(), rel=1e-13)
    assert found["sd"] == pytest.approx(known.std(), rel=1e-12)
    assert found["rms"] == pytest.approx(np.sqrt((known**2).mean()), rel=1e-13)


@needs_node
def test_statistics_of_no_value() -> None:
    found = node("page/summary.js", SUMMARY, [float("nan")] * 3)
    assert (found["count"], found["missing"], found["mean"]) == (0, 3, "NaN")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three channels with a gap, of 12 s."""
    rng = np.random.default_rng(2)
    t = np.arange(12_000) / 1000
    x = np.round(np.stack([
        3 * np.sin(2 * np.pi * 2 * t) + 0.3 * np.sin(2 * np.pi * 180 * t),
        np.sin(2 * np.pi * 5 * t) + rng.normal(0, 0.1, t.size),
        rng.normal(0, 1, t.size).cumsum() / 30,
    ]), 3)  # fmt: skip
    x[:, 4000:4500] = np.nan
    path = tmp_path_factory.mktemp("selection") / "touch.hapf"
    hapfmt.write(x, path, rate=1000, units="N", labels=["thumb", "index", "palm"])
    return path


@pytest.mark.deep
def test_the_tabs_of_spectrum_and_statistics(chromium: Any, recorded: Path) -> None:
    with served(chromium, [recorded], "#sel=1,9&tab=statistics") as seen:
        page = seen.page
        page.locator(".statistics [role=status]", has_text="Missing").wait_for()
        cells = page.locator(".statistics .rows .row").nth(1).locator("[data-fact]")
        found = {
            cells.nth(i).get_attribute("data-fact"): float(cells.nth(i).get_attribute("data-value"))
            for i in range(cells.count())
        }
        x = hapfmt.read(recorded).sel("index", 1, 9)[0].to_numpy(1, 9)
        assert found["count"] == 7500 and found["missing"] == 500
        assert found["mean"] == pytest.approx(np.nanmean(x)) and found["min"] == np.nanmin(x)
        page.click("#tab-spectrum")
        page.locator(".spectrum [role=status]", has_text="overlap").wait_for()
        assert "at 180" not in page.inner_text(".legend")
        lines = page.locator(".legend p")
        assert lines.count() == 3 and "peak" in lines.nth(0).inner_text()
        assert "at 1.95" in lines.nth(0).inner_text()
        page.focus(".plot canvas")
        page.keyboard.press("ArrowRight")
        assert "peak" not in lines.nth(0).inner_text()


EVENTS = (
    hapfmt.Event(Fraction(1, 2), "tap", Fraction(1, 4), channel=1, layer="touch"),
    hapfmt.Event(Fraction(1), "slip ∆", channel=0, layer="touch"),
    hapfmt.Event(Fraction(2), "pause", layer="notes"),
)
CLOCKS = (
    hapfmt.ClockObservation("ptp", None, 10**9, 5 * 10**12, 40),
    hapfmt.ClockObservation("adc", 1, 50, 5 * 10**12 + 7, 0),
)
MAPS = (hapfmt.ClockMap("adc", 0, ((0, 7 * 10**12), (1000, 9 * 10**12))),)

SUBSET = """
  const bytes = Uint8Array.from(atob(input.data), (letter) => letter.charCodeAt(0));
  try {
    const found = m.subsetOf(bytes, input.asked);
    let text = '';
    for (const byte of found.bytes) text += String.fromCharCode(byte);
    return { ...found, bytes: btoa(text) };
  } catch (error) {
    if (error.name !== 'HapfError') throw error;
    return { message: error.message };
  }
"""


def subset(data: bytes, channels: list[int], *span: float) -> Any:
    asked: dict[str, Any] = {"channels": channels, "name": "x"}
    if span:
        asked |= {"t0": span[0], "t1": span[1]}
    given = {"data": base64.b64encode(data).decode(), "asked": asked}
    return node("data/subset.js", SUBSET, given)


def check_subset(data: bytes, channels: list[int], *span: float) -> None:
    """It is intact, and what Python's editor writes for the same channels and times."""
    found = base64.b64decode(subset(data, channels, *span)["bytes"])
    report = hapfmt.verify(found)
    assert report.verdict == "intact", report
    stream = io.BytesIO()
    hapfmt.edit.subset(data, stream, channels, *span)
    wanted = stream.getvalue()
    ours, theirs = hapfmt.read(found), hapfmt.read(wanted)
    same_recordings(replace(ours, metadata={}), replace(theirs, metadata={}))
    metadata = dict(theirs.metadata)
    assert len(metadata.pop("notes")) == len(ours.metadata["notes"])
    assert metadata == {name: one for name, one in ours.metadata.items() if name != "notes"}
    packets = [(p.track, p.start, p.span, p.data) for p in packets_of(found)]
    assert sorted(packets) == sorted((p.track, p.start, p.span, p.data) for p in packets_of(wanted))
    assert tracks_of(found).keys() == tracks_of(wanted).keys()
    if not span:
        assert digests_of(found) == digests_of(wanted)


def digests_of(data: bytes) -> dict[int, bytes]:
    found = stored_digests(open_catalogue(BytesSource(data), scan=True))
    return {track: digest for track, (_, digest) in found.items()}


def same_recordings(ours: hapfmt.Recording, theirs: hapfmt.Recording) -> None:
    assert len(ours) == len(theirs)
    for a, b in zip(ours, theirs, strict=True):
        assert a.coverage == b.coverage and a.rate_exact == b.rate_exact
        assert (a.label, a.unit, a.calibration) == (b.label, b.unit, b.calibration)
        assert a.to_numpy().tobytes() == b.to_numpy().tobytes()
    for name in ("uuid", "epoch_ns", "events", "clocks", "clock_maps", "attachments"):
        assert getattr(ours, name) == getattr(theirs, name), name


@needs_node
@pytest.mark.parametrize("name", [*deep([*PRESETS][:-1]), [*PRESETS][-1]])
def test_a_subset_is_that_of_the_editor(name: str) -> None:
    data = made(name, events=EVENTS, clocks=CLOCKS, clock_maps=MAPS)
    check_subset(data, [1], 0.7, 1.9)
    check_subset(data, [0, 2])
    check_subset(data, [*range(len(hapfmt.read(data)))], 0.001, 0.002)


@needs_node
@pytest.mark.parametrize("path", deep(EXAMPLES), ids=lambda path: path.stem)
def test_a_subset_of_each_example(path: Path) -> None:
    data = path.read_bytes()
    if hapfmt.verify(data).verdict != "intact":
        assert "not intact" in subset(data, [0])["message"]
        return
    recording = hapfmt.read(data)
    if recording.channels:
        check_subset(data, [0])
        check_subset(data, [len(recording) - 1], 0, float(recording.duration) / 2)


@needs_node
def test_no_subset_of_a_damaged_file() -> None:
    data = bytearray(made("lossless"))
    assert "message" in subset(bytes(data[:-40]), [0])
    assert "none of these channels" in subset(bytes(data), [9])["message"]
    data[len(data) // 2] ^= 1
    assert "not intact" in subset(bytes(data), [0])["message"]
    assert "message" in subset(b"nothing", [0])


@needs_node
def test_floats_are_those_of_python() -> None:
    rng = np.random.default_rng(5)
    bits = rng.integers(0, 1 << 64, 2000, dtype=np.uint64).view(np.float64)
    x = [*bits[np.isfinite(bits)], 0.0, 1.0, -2.5, 1e16, 1e15, 123456789012345680.0, 1e-4, 9e-5]
    x += [5e-324, 1e22, 0.1, 100.0, float("inf"), -float("inf"), *np.round(rng.normal(size=99), 4)]
    given = [float(value) for value in x]
    found = node("page/csv.js", "return input.map(m.floatText);", given)
    assert found == [repr(value) for value in given]
    assert node("page/csv.js", "return m.floatText(-0);", None) == "-0.0"


TABLES = """
  const recording = await open(input.path);
  const tables = [];
  const channels = recording.channels.filter(({ index }) => input.channels.includes(index));
  for (const group of m.byRate(channels)) {
    const { parts, rows, leftOut } = await m.tableOf(recording, group, input.span);
    tables.push({ text: parts.join(''), channels: group.channels.map(({ index }) => index), rows, leftOut });
  }
  return tables;
"""


def check_tables(path: Path, channels: list[int], start: float, stop: float, count: int) -> None:
    """They are the bytes that ``hapfmt decode`` writes."""
    given = {"path": str(path), "channels": channels, "span": [start, stop]}
    tables = node("page/csv.js", TABLES, given)
    assert len(tables) == count
    for table in tables:
        out = path.with_name("out.csv")
        recording = hapfmt.read(path).sel(table["channels"], start, stop)
        hapfmt.save(recording, out, force=True)
        assert table["text"] == out.read_text("utf-8")


@needs_node
@pytest.mark.parametrize("name", ["lossless doubles", *deep(["paper", "perceptual"])])
def test_tables_are_those_of_decode(name: str, tmp_path: Path) -> None:
    path = tmp_path / "touch.hapf"
    path.write_bytes(made(name))
    count = 2 if name == "lossless doubles" else 1
    doubles = [n for n, one in enumerate(hapfmt.read(path)) if one.label != "words"]
    check_tables(path, doubles, 0, 4, count)
    check_tables(path, [1], 0.7, 1.9, 1)


@needs_node
def test_no_table_rounds(tmp_path: Path) -> None:
    path = tmp_path / "words.hapf"
    channel = hapfmt.Channel(np.array([3, 2**60 + 1], np.int64), Fraction(10), label="steps")
    hapfmt.write(hapfmt.Recording((channel,)), path)
    code = f"""
      const table = (...args) => m.tableOf(...args).catch((error) => ({{ parts: [error.message] }}));
      {TABLES.replace("m.tableOf", "table")}
    """
    given = {"path": str(path), "channels": [0], "span": [0, 1]}
    assert "would round" in node("page/csv.js", code, given)[0]["text"]


@needs_node
def test_a_table_of_a_long_gap(tmp_path: Path) -> None:
    path = tmp_path / "gap.hapf"
    spans = (hapfmt.Span(7, 17), hapfmt.Span(2_000_000, 2_000_010))
    values = np.arange(20, dtype=np.int32)
    channel = hapfmt.Channel(values, Fraction(30000, 1001), spans, label='a "b"', unit="mm")
    hapfmt.write(hapfmt.Recording((channel,)), path)
    check_tables(path, [0], 0, 1e6, 1)
    check_tables(path, [0], 0.4, 20000.0, 1)


@pytest.mark.deep
def test_saving(chromium: Any, recorded: Path, tmp_path: Path) -> None:
    """From a page with the data inside: offline."""
    with exported(chromium, [recorded], tmp_path / "page.html", offline=True) as seen:
        page = seen.page
        page.evaluate("() => { location.hash = 'sel=1,3.5&ch=0,2&tab=save'; }")
        page.locator(".save p", has_text="2 channels").wait_for()
        saved = {}
        for name in ("picture", "table", "part"):
            with page.expect_download() as found:
                page.get_by_role("button", name=f"Save {name}").click()
            saved[name] = tmp_path / found.value.suggested_filename
            found.value.save_as(saved[name])
    assert saved["picture"].read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    out = tmp_path / "wanted.csv"
    hapfmt.save(hapfmt.read(recorded).sel([0, 2], 1, 3.5), out)
    assert saved["table"].read_bytes() == out.read_bytes()
    part = hapfmt.read(saved["part"])
    assert hapfmt.verify(saved["part"]).verdict == "intact"
    assert [channel.label for channel in part] == ["thumb", "palm"]


@pytest.mark.deep
def test_what_cannot_be_saved_is_said(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "it's broken.hapf"
    data = bytearray(made("lossless"))
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with served(chromium, [path], "#tab=save") as seen:
        page = seen.page
        page.get_by_role("button", name="Save part").click()
        said = page.locator(".save [role=status]", has_text="Not saved")
        assert "hapfmt subset 'it'\\''s broken.hapf'" in said.inner_text()


SOUND = """
  const { samples, rate, factor } = m.soundOf(Float64Array.from(input.x), input.rate);
  return { samples, rate, factor };
"""


@needs_node
def test_a_slow_signal_as_sound_is_interpolated() -> None:
    t = np.arange(2000) / 1000
    x = 7 + 2 * np.sin(2 * np.pi * 120 * t)
    found = node("page/sound.js", SOUND, {"x": x, "rate": 1000})
    assert (found["rate"], found["factor"], len(found["samples"])) == (8000, 8, 16000)
    middle = slice(4000, 12000)
    wanted = np.sin(2 * np.pi * 120 * np.arange(16000) / 8000)[middle]
    np.testing.assert_allclose(np.array(found["samples"])[middle], wanted, atol=5e-3)


@needs_node
def test_sound_is_silent_in_gaps_and_never_louder_than_one() -> None:
    x = noisy(9000)
    x[3000:4000] = np.nan
    found = node("page/sound.js", SOUND, {"x": x, "rate": 4000})
    samples = np.array(found["samples"])
    assert found["rate"] == 4000 and not samples[3000:4000].any()
    assert np.abs(samples).max() == 1 and np.isfinite(samples).all()
    for constant in ([5.0] * 100, [np.nan] * 100, []):
        silent = node("page/sound.js", SOUND, {"x": constant, "rate": 8000})["samples"]
        assert not np.any(silent)
    huge = node("page/sound.js", SOUND, {"x": [1e308, -1e308] * 50, "rate": 8000})["samples"]
    assert np.abs(huge).max() == 1


RUMBLE = """
  const frames = m.framesOf(Float64Array.from(input.slow), input.fast && Float64Array.from(input.fast), 1000);
  const sent = [];
  const ended = [];
  let time = 0;
  let act = () => {};
  const actuator = {
    playEffect(kind, { duration, strongMagnitude: strong, weakMagnitude: weak }) {
      sent.push({ kind, duration, strong, weak });
      return input.refuses && sent.length > 3 ? Promise.reject(new Error('no')) : Promise.resolve('complete');
    },
    reset() { sent.push('reset'); return Promise.resolve('complete'); },
  };
  const rumble = new m.Rumble(actuator, frames, {
    strength: () => input.strength, now: () => time, ended: (why) => ended.push(why),
    every: (seconds, action) => { act = action; return () => { act = () => {}; }; },
  });
  for (let n = 0; n < input.ticks; n++) {
    time += n === input.late ? 1 : 0.05;
    await null;
    await null;
    act();
  }
  return { frames, sent, ended, running: rumble.running };
"""


def rumbled(**given: Any) -> Any:
    t = np.arange(2000) / 1000
    slow = np.where(t < 1, 3.0, np.nan)
    given = {"slow": slow, "fast": np.sin(400 * t) * t, "strength": 1, "ticks": 50, **given}
    return node("page/rumble.js", RUMBLE, given)


@needs_node
@pytest.mark.parametrize("strength", [1, *deep([0.2, 50, -1])])
def test_rumble_is_limited_and_ends_at_rest(strength: float) -> None:
    found = rumbled(strength=strength)
    *effects, reset = found["sent"]
    strong, weak = (np.array([one[name] for one in effects]) for name in ("strong", "weak"))
    limit = 0.5 * min(max(strength, 0), 1)
    assert reset == "reset" and found["ended"] == ["It is at the end."]
    assert {one["kind"] for one in effects} == {"dual-rumble"}
    assert max(one["duration"] for one in effects) <= 100
    for motor in (strong, weak):
        assert motor.min() >= 0 and motor.max() == pytest.approx(limit) and motor[-1] == 0
        assert np.diff(motor[:-1], prepend=0).max() <= 0.25 + 1e-12
    assert not strong[24:].any() and (limit == 0 or weak[30] < weak[38])


@needs_node
def test_rumble_stops_when_late_or_refused() -> None:
    late = rumbled(late=10)
    assert late["ended"] == ["The page was late."] and not late["running"]
    assert late["sent"][-1] == "reset" and late["sent"][-2]["strong"] == 0
    refused = rumbled(refuses=True)
    assert refused["ended"] == ["The gamepad refused: no"] and not refused["running"]


FAKES = """() => {
  window.heard = [];
  window.felt = [];
  const parameter = () => ({ value: 1, setTargetAtTime(value) { heard.push(['gain', value]); } });
  window.AudioContext = class {
    get currentTime() { return (performance.now() - this.began) / 1000; }
    constructor() { this.began = performance.now(); this.destination = {}; }
    createGain() { this.gain = { gain: parameter(), connect() {} }; return this.gain; }
    createBuffer(channels, length, rate) {
      return { copyToChannel: (samples) => heard.push(['buffer', samples.length, length, rate]) };
    }
    createBufferSource() {
      return { connect() {}, start: () => heard.push(['start', this.gain.gain.value]), stop() { heard.push(['stop']); } };
    }
    async resume() {}
    close() { heard.push(['close']); }
  };
  const actuator = {
    async playEffect(kind, { strongMagnitude, weakMagnitude }) { felt.push([strongMagnitude, weakMagnitude]); },
    async reset() { felt.push('reset'); },
  };
  window.pads = [];
  navigator.getGamepads = () => window.pads;
  window.plug = (vibrationActuator) => {
    window.pads = [null, { id: 'Pad', vibrationActuator }];
    window.dispatchEvent(new Event('gamepadconnected'));
  };
  window.actuator = actuator;
}"""


@pytest.mark.deep
def test_sound_and_rumble(chromium: Any, recorded: Path) -> None:
    with served(chromium, [recorded], "#sel=1,3&tab=play") as seen:
        page = seen.page
        page.evaluate(FAKES)
        said = page.locator(".play p[role=status]")
        page.get_by_role("button", name="Play sound").click()
        said.filter(has_text="thumb sounds").wait_for()
        assert page.evaluate("heard") == [["buffer", 16000, 16000, 8000], ["start", 0.1]]
        assert page.locator(".line.playing").is_visible()
        page.keyboard.press("Escape")
        said.filter(has_text="Stopped").wait_for()
        page.wait_for_timeout(100)
        assert page.evaluate("heard.slice(2)") == [["gain", 0], ["stop"], ["close"]]
        assert page.evaluate("hapf.app.selection.range") == [1, 3]

        play = page.get_by_role("button", name="Play rumble")
        assert not play.is_visible()
        page.get_by_role("button", name="allow rumble").click()
        assert play.is_disabled() and "No gamepad" in page.inner_text(".play")
        page.evaluate("plug(null)")
        assert play.is_disabled() and "cannot drive its motors" in page.inner_text(".play")
        page.evaluate("plug(actuator)")
        play.click()
        said.filter(has_text="thumb moves Pad").wait_for()
        page.wait_for_timeout(300)
        page.evaluate("window.dispatchEvent(new Event('blur'))")
        said.filter(has_text="the page was left").wait_for()
        felt = page.evaluate("felt")
        assert felt[-2:] == [[0, 0], "reset"] and 0 < max(strong for strong, _ in felt[:-1]) <= 0.1
        page.wait_for_timeout(150)
        assert page.evaluate("felt.length") == len(felt)
        page.reload()
        page.get_by_role("button", name="allow rumble").wait_for()
