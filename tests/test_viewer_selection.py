"""The tools of the viewer that work on a selection: their numbers, run by node; their tabs, in Chromium."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import served
from numpy.typing import NDArray
from spec import ROOT

import hapfmt

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
