"""Draw docs/picture.png: what the format does with a simulated stylus, at one look.

    .venv/bin/python tools/picture.py

It is the picture of ``hapfmt demo --plot``, from simulated data alone. Run it again when a preset
changes what it writes: the picture shows the sizes of files.
"""

from __future__ import annotations

import argparse
import struct
import sys
from pathlib import Path

import installed  # noqa: F401

from hapfmt.cli import cli

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "picture.png"
LARGEST = 150_000
"""Bytes of a picture that a page loads at once."""


def draw(path: Path) -> tuple[int, int, int]:
    """Bytes, width and height in pixels of the picture."""
    words = ["demo", "--texture", "sand", "--seconds", "4", "--seed", "1", "--plot", str(path)]
    cli.main([*words, "--force"], standalone_mode=False)
    return measured(path)


def measured(path: Path) -> tuple[int, int, int]:
    data = path.read_bytes()
    width, height = struct.unpack(">II", data[16:24])
    return len(data), width, height


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("path", nargs="?", type=Path, default=PICTURE)
    size, width, height = draw(parser.parse_args().path)
    print(f"{size} bytes, {width} x {height} pixels")
    return 0 if size < LARGEST else 1


if __name__ == "__main__":
    sys.exit(main())
