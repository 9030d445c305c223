"""Draw the pictures of docs/getting-started.md, with the commands that the page shows.

    .venv/bin/python tools/tutorial.py              # into docs/pictures
    .venv/bin/python tools/tutorial.py -o FOLDER

It runs every command of the page, and keeps the pictures that the page shows, with fewer colours.
Run it again when a preset or the drawing changes.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import installed

PAGE = installed.ROOT / "docs" / "getting-started.md"
FOLDER = PAGE.parent / "pictures"
COLOURS = 32
LARGEST = 80_000
"""Bytes of a picture."""


def commands(page: str) -> list[str]:
    """Those of the blocks ``console``."""
    blocks = re.findall(r"^```console\n(.*?)^```$", page, re.S | re.M)
    return [line for block in blocks for line in re.findall(r"^\$ (.*)$", block, re.M)]


def pictures(page: str) -> list[str]:
    return re.findall(r"^!\[[^\]]+\]\(pictures/([\w-]+\.png)\)$", page, re.M)


def draw(folder: Path) -> dict[str, int]:
    """Writes all pictures; returns their sizes in bytes."""
    from PIL import Image

    page = PAGE.read_text("utf-8")
    folder.mkdir(parents=True, exist_ok=True)
    scripts = Path(sys.executable).parent
    environment = {**os.environ, "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}"}
    sizes = {}
    with tempfile.TemporaryDirectory() as room:
        for line in commands(page):
            done = subprocess.run(
                ["sh", "-c", line], cwd=room, env=environment, capture_output=True, check=False
            )
            if done.returncode:
                sys.exit(f"$ {line}\n{done.stderr.decode()}")
        for name in pictures(page):
            with Image.open(Path(room, name)) as drawn:
                # Without dithering, which would make the file larger.
                reduced = drawn.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
            reduced.save(Path(room, "reduced.png"), optimize=True)
            sizes[name] = Path(room, "reduced.png").stat().st_size
            (folder / name).write_bytes(Path(room, "reduced.png").read_bytes())
    return sizes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=FOLDER, metavar="FOLDER")
    sizes = draw(parser.parse_args().output)
    for name, size in sizes.items():
        print(f"{name}: {size} bytes{'' if size <= LARGEST else ', too large'}")
    return 0 if max(sizes.values()) <= LARGEST else 1


if __name__ == "__main__":
    sys.exit(main())
