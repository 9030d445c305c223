"""Decoding speed of the two implementations side by side: hapfmt with its compiled loops, with the
readable ones, and the second implementation in JavaScript.

python tools/decoders.py [--seconds 2]

Packets alone are decoded, one thread, from memory, exact values too; opening and checksums do not
count. Recordings are simulated. Without node the last column is empty.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from installed import ROOT, environment

import click
from measured import print_origin, print_table
from simulated import drift, glove

import hapfmt
from hapfmt.reading.decoder import TrackDecoder
from hapfmt.reading.pieces import PieceDecoder
from hapfmt.recovery.descriptions import EVERYTHING
from hapfmt.scenes.stylus import simulate

BENCH = ROOT / "conformance" / "adapters" / "js" / "bench.js"
CASES = [
    ("glove, 22 channels", "lossless", {}),
    ("glove, 22 channels", "lossless, fast", {"fast": True}),
    ("glove, 22 channels", "perceptual, no texture", {"texture": False, "felt": "all"}),
    ("texture", "lossless", {}),
    ("texture", "perceptual", {}),
    ("doubles", "lossless", {}),
]


def recordings() -> dict[str, hapfmt.Recording]:
    return {
        "glove, 22 channels": glove(20.0),
        "texture": simulate("sand", 60.0),
        "doubles": drift(20.0),
    }


def rate_of(path: Path, seconds: float) -> float:
    """Million samples per second, here."""
    with hapfmt.Reader(path) as reader:
        tracks = reader.catalogue.tracks
        everything = dict.fromkeys(tracks, EVERYTHING)
        decoders = {
            id_: TrackDecoder(track, reader.catalogue.level) for id_, track in tracks.items()
        }
        packets = list(reader.packets(everything))
        best = 0.0
        end = time.process_time() + seconds
        while time.process_time() < end:
            pieces = PieceDecoder(decoders, everything, exact=True)
            began = time.process_time()
            samples = sum(pieces.decode(packet).numbers.size for packet in packets)
            best = max(best, samples / (time.process_time() - began) / 1e6)
    return best


def elsewhere(path: Path, seconds: float) -> float:
    """With the readable loops, in a process of its own."""
    code = "import decoders, pathlib, sys; "
    code += "print(decoders.rate_of(pathlib.Path(sys.argv[1]), float(sys.argv[2])))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(path), str(seconds)], env=environment(HAPFMT_PURE="1"),
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return float(done.stdout)


def in_javascript(path: Path, seconds: float) -> float | None:
    node = shutil.which("node")
    if node is None:
        return None
    done = subprocess.run(
        [node, str(BENCH), str(path), str(seconds)], capture_output=True, text=True, check=True
    )
    return float(re.findall(r"([0-9.]+) million", done.stdout)[-1])


@click.command(help=__doc__)
@click.option("--seconds", default=2.0, help="For each figure.")
@click.option("--json", "as_json", is_flag=True)
def main(seconds: float, as_json: bool) -> None:
    known = recordings()
    rows: list[list[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.hapf"
        for name, preset, given in CASES:
            settings = hapfmt.Settings.of(preset.split(",")[0], **given)
            hapfmt.write(known[name], path, settings, canonical=1, force=True)
            with hapfmt.Reader(path) as reader:
                codecs = sorted({track.codec for track in reader.catalogue.tracks.values()})
            other = in_javascript(path, seconds)
            rows.append([
                name, preset, " ".join(codecs), f"{rate_of(path, seconds):.1f}",
                f"{elsewhere(path, seconds):.2f}", "" if other is None else f"{other:.1f}",
            ])  # fmt: skip
    head = ["recording", "preset", "codecs", "compiled", "readable", "JavaScript"]
    if as_json:
        print(json.dumps([dict(zip(head, row, strict=True)) for row in rows]))
        return
    print_origin()
    print("million samples per second")
    print_table(head, rows)


if __name__ == "__main__":
    main()
