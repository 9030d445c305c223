"""hapfmt view on one hour of 22 channels at 1 kHz, in Chromium: first picture, frames, memory.

    .venv/bin/python tools/viewing.py [--seconds 3600]

Needs Playwright, Chromium and hapfmt[view]. The window is so high that all channels are drawn.
The first picture counts from the request of the page to the frame after its first data. A frame
of a zoom counts from the turn of the wheel to the end of its painting.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any

import installed  # noqa: F401

import numpy as np
import overview
from measured import print_origin, print_table

import hapfmt
from hapfmt.viewer.server import ServedFile, ViewServer

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
WINDOW = {"width": 1280, "height": 2400}
TURNS = 60
PAINTED = """new Promise((done) => requestAnimationFrame(() => {
  const { port1, port2 } = new MessageChannel();
  port1.onmessage = () => done(performance.now());
  port2.postMessage(0);
}))"""
ZOOM = f"""async ([turns, delta]) => {{
  const panels = document.getElementById('panels'), times = [];
  const {{ left, top, width }} = panels.getBoundingClientRect();
  for (let i = 0; i < turns; i++) {{
    const began = performance.now();
    panels.dispatchEvent(new WheelEvent('wheel', {{
      deltaY: delta, clientX: left + width * 0.6, clientY: top + 100, cancelable: true,
    }}));
    times.push(await {PAINTED} - began);
    await new Promise((done) => setTimeout(done, 20));
  }}
  return times;
}}"""


def renderer_bytes(browser: Any) -> int:
    """Resident memory of the largest process that draws pages: its heap, arrays and code."""
    told = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")
    sizes = []
    for process in told["processInfo"]:
        status = Path(f"/proc/{process['id']}/status")
        if process["type"] == "renderer" and status.exists():
            row = next(r for r in status.read_text().splitlines() if r.startswith("RssAnon"))
            sizes.append(1024 * int(row.split()[1]))
    return max(sizes)


def stats(page: Any) -> dict[str, float]:
    return page.evaluate("window.hapf.stats()")[0]


def settle(page: Any) -> None:
    quiet = 0
    while quiet < 5:
        page.wait_for_timeout(100)
        quiet = quiet + 1 if page.evaluate("window.hapf.idle") else 0


def measure(browser: Any, path: Path) -> list[str]:
    with ServedFile(str(path), path.name) as file, ViewServer([file]) as server:
        page = browser.new_page(viewport=WINDOW)
        page.goto(server.url)
        page.evaluate("window.hapf.ready")
        first = page.evaluate(f"{PAINTED}")
        at_first = stats(page)
        settle(page)
        settled = page.evaluate("performance.now()") / 1000
        inward = page.evaluate(ZOOM, [TURNS, -100])
        settle(page)
        span = page.evaluate("window.hapf.view.t1 - window.hapf.view.t0")
        outward = page.evaluate(ZOOM, [TURNS, 100])
        settle(page)
        last, heap = stats(page), renderer_bytes(browser)
        page.close()
    frames = np.array(inward + outward)
    speed = last["samplesDecoded"] / max(last["decodeMs"], 1e-9) / 1000
    return [
        path.stem,
        f"{first / 1000:.2f} s",
        f"{at_first['bytesFetched'] / 1e3:.0f} kB",
        f"{at_first['requests']:.0f}",
        f"{settled:.1f} s",
        f"{np.median(frames):.0f} ms",
        f"{np.quantile(frames, 0.95):.0f} ms",
        f"{span:.3f} s",
        f"{heap / 1e6:.0f} MB",
        f"{speed:.1f} M/s",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=int, default=3600)
    given = parser.parse_args()
    from playwright.sync_api import sync_playwright

    print_origin()
    recording = overview.make(given.seconds)
    with tempfile.TemporaryDirectory() as room, sync_playwright() as playwright:
        files = {name: Path(room) / f"{name}.hapf" for name in ("overview", "plain")}
        for name, path in files.items():
            hapfmt.write(recording, path, fast=True, cluster=1, overview=name == "overview")
        del recording
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        print(f"Chromium {browser.version}; window of {WINDOW['width']} x {WINDOW['height']}\n")
        print_table(
            ["file", "first picture", "fetched", "requests", "whole picture", "frame, median",
             "frame, 95 %", "zoomed to", "memory of the page", "decoded"],
            [measure(browser, path) for path in files.values()],
        )  # fmt: skip
        browser.close()


if __name__ == "__main__":
    main()
