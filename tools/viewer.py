"""Draw docs/viewer-*.png: the page of `hapfmt view` in Chromium, with simulated recordings.

    .venv/bin/python tools/viewer.py
    .venv/bin/python tools/viewer.py --folder /tmp/pictures bands

Run it again when the page changes what it shows. It needs playwright and Chromium.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import installed  # noqa: F401

import numpy as np

from hapfmt import write
from hapfmt.cli import cli
from hapfmt.viewer.server import ServedFile, ViewServer

DOCS = Path(__file__).resolve().parent.parent / "docs"
LARGEST = 150_000
"""Bytes of a picture that a page loads at once."""
SIZE = {"width": 1280, "height": 760}
SETTLE = """async () => {
  for (let quiet = 0; quiet < 5;) {
    await new Promise((done) => setTimeout(done, 60));
    quiet = window.hapf.idle ? quiet + 1 : 0;
  }
}"""


def hapfmt(*words: str) -> None:
    cli.main(list(words), standalone_mode=False)


def hand(folder: Path) -> tuple[Path, str]:
    """Forces and joints that grasp, with events."""
    path = folder / "hand.hapf"
    hapfmt("scene", "grasp", str(path), "--preset", "perceptual")
    for time, text in (("0.7", "contact"), ("2.9", "release")):
        hapfmt("annotate", str(path), "--at", time, text)
    return path, "#ch=0,3,22-23&a=0.75&b=1.5&deadband=1&theme=light"


def bands(folder: Path) -> tuple[Path, str]:
    """Both bands of a stylus on sand, the support points and the deadband."""
    path = folder / "sand.hapf"
    hapfmt("scene", "sand", str(path), "--preset", "paper")
    return path, "#t=1.2,2.2&band=sum,lf,hf&knots=1&deadband=1&a=1.4&b=1.8&theme=dark"


def damage(folder: Path) -> tuple[Path, str]:
    """A wall of which some packets are damaged."""
    path = folder / "wall.hapf"
    hapfmt("scene", "wall", str(path), "--seconds", "60")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes(data)
    return path, "#tab=damage&theme=light"


def map_(folder: Path) -> tuple[Path, str]:
    """A touch that moves over 12 x 12 taxels."""
    path = folder / "skin.hapf"
    times = np.arange(1000) / 200
    rows, columns = np.mgrid[0:12, 0:12]
    center = 6 + 4 * np.sin(0.7 * times), 6 + 4 * np.cos(0.9 * times)
    far = (rows.ravel()[:, None] - center[0]) ** 2 + (columns.ravel()[:, None] - center[1]) ** 2
    labels = [f"taxel {r + 1}.{c + 1}" for r, c in zip(rows.flat, columns.flat, strict=True)]
    counts = np.round(400 * np.exp(-far / 12)).astype(np.int32)
    write(counts, path, rate=200, labels=labels, units=["kPa"] * 144)
    return path, "#mode=map&theme=dark"


def compare(folder: Path) -> tuple[tuple[Path, Path], str]:
    """Forces that grasp, lossless and perceptual."""
    paths = folder / "grasp.hapf", folder / "grasp-perceptual.hapf"
    for path, preset in zip(paths, ("lossless", "perceptual"), strict=True):
        hapfmt("scene", "grasp", str(path), "--preset", preset)
    return paths, "#ch=22;22&a=1.1&dock=0&theme=light"


PICTURES = {each.__name__.strip("_"): each for each in (hand, bands, damage, map_, compare)}


@contextmanager
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = shutil.which("chromium") or shutil.which("google-chrome")
        opened = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield opened
        opened.close()


def draw(chromium: Any, paths: Path | Sequence[Path], address: str, picture: Path) -> int:
    """Bytes of the picture."""
    files = [paths] if isinstance(paths, Path) else paths
    with ViewServer([ServedFile(str(path), path.name) for path in files]) as server:
        page = chromium.new_page(viewport=SIZE)
        page.goto(server.url + address)
        page.evaluate("window.hapf.ready")
        page.evaluate(SETTLE)
        page.screenshot(path=picture)
        page.close()
    return picture.stat().st_size


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(PICTURES)}")
    parser.add_argument("--folder", type=Path, default=DOCS)
    options = parser.parse_args()
    if unknown := set(options.names) - PICTURES.keys():
        parser.error(f"no picture {', '.join(sorted(unknown))}; there are {', '.join(PICTURES)}")
    largest = 0
    with tempfile.TemporaryDirectory() as folder, browser() as chromium:
        for name in options.names or PICTURES:
            picture = options.folder / f"viewer-{name}.png"
            size = draw(chromium, *PICTURES[name](Path(folder)), picture)
            print(f"{picture.name}: {size} bytes, {SIZE['width']} x {SIZE['height']} pixels")
            largest = max(largest, size)
    return 0 if largest < LARGEST else 1


if __name__ == "__main__":
    sys.exit(main())
