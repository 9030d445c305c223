"""The tools of the viewer that work on a selection: their numbers, run by node; their tabs, in Chromium."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import served
from depth import deep
from edited import PRESETS, made, packets_of, tracks_of
from numpy.typing import NDArray
from spec import ROOT

import hapfmt

EXAMPLES = sorted((ROOT / "conformance" / "examples").glob("*.hapf"))
NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="needs node")


def node(module: str, code: str, given: Any) -> Any:
    """What ``code`` returns, with the module as ``m`` and the value as ``input``."""
    assert NODE
    text = json.dumps({"module": module, "code": code, "input": given}, default=np.ndarray.tolist)
    text = re.sub(r"(?<![\w\"])-?(?:NaN|Infinity)", r'"\g<0>"', text)
    done = subprocess.run(
        [NODE, str(ROOT / "tests" / "viewer" / "pure.mjs")],
        input=text, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)["value"]


def noisy(count: int, seed: int = 1) -> NDArray[np.float64]:
    t = np.arange(count)
    return np.random.default_rng(seed).normal(3, 1, count) + 5 * np.sin(t / 7)


WELCH = """
  const welch = new m.Welch(input.length, input.rate);
  for (let at = 0; at < input.x.length; at += 1000) welch.push(Float64Array.from(input.x.slice(at, at + 1000)));
  return welch.result();
"""


@needs_node
@pytest.mark.parametrize("length", [16, 256, 4096])
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


SUMMARY = """
  const summary = new m.Summary();
  for (let at = 0; at < input.length; at += 7001) summary.push(Float64Array.from(input.slice(at, at + 7001)));
  return summary.result();
"""


@needs_node
@pytest.mark.parametrize("offset", [0.0, 1e7, -1e-9])
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
        page.locator(".spectrum [role=status]", has_text="Hann").wait_for()
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


def same_recordings(ours: hapfmt.Recording, theirs: hapfmt.Recording) -> None:
    assert len(ours) == len(theirs)
    for a, b in zip(ours, theirs, strict=True):
        assert a.coverage == b.coverage and a.rate_exact == b.rate_exact
        assert (a.label, a.unit, a.calibration) == (b.label, b.unit, b.calibration)
        assert a.to_numpy().tobytes() == b.to_numpy().tobytes()
    for name in ("uuid", "epoch_ns", "events", "clocks", "clock_maps", "attachments"):
        assert getattr(ours, name) == getattr(theirs, name), name


@needs_node
@pytest.mark.parametrize("name", [*deep([*PRESETS][:-2]), *[*PRESETS][-2:]])
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
