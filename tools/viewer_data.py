"""An hour of 22 channels at 1 kHz in the data layer of the viewer, behind a URL: time and bytes.

python tools/viewer_data.py [--seconds 3600] [FILE ...]

It needs node. The server is on the same machine. Without FILE it makes a glove's file in three
ways: at once, with an overview, and by a recorder in clusters of a second.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

import installed

import click
import numpy as np
from measured import print_origin, print_table
from simulated import STEP, glove

import hapfmt


def make(folder: Path, seconds: float) -> dict[str, Path]:
    recording = glove(seconds)
    paths = {name: folder / f"{name}.hapf" for name in ("written", "overview", "recorded")}
    hapfmt.write(recording, paths["written"], fast=True)
    hapfmt.write(recording, paths["overview"], fast=True, overview=True)
    inputs = [hapfmt.Input(one.label, 1000, "deg", calibration=STEP) for one in recording]
    rows = np.column_stack([one.stored for one in recording])
    settings = hapfmt.Settings(effort="fast")
    with hapfmt.Recorder(paths["recorded"], inputs, settings, cluster=1, fsync="close") as recorder:
        for at in range(0, len(rows), 10_000):
            recorder.write_rows(rows[at : at + 10_000])
    return paths


def measure(node: str, path: Path) -> dict[str, object]:
    script = str(installed.ROOT / "tools" / "viewer_data.mjs")
    done = subprocess.run([node, script, str(path)], check=True, capture_output=True, text=True)
    found: dict[str, object] = json.loads(done.stdout)
    return found


@click.command(help=__doc__)
@click.argument("files", nargs=-1, type=click.Path(exists=True, path_type=Path))
@click.option("--seconds", default=3600.0, show_default=True, help="Length of the recording.")
def main(files: tuple[Path, ...], seconds: float) -> None:
    node = shutil.which("node")
    if node is None:
        raise click.ClickException("node is not there")
    version = subprocess.run([node, "--version"], check=True, capture_output=True, text=True)
    with tempfile.TemporaryDirectory() as folder:
        paths = {path.name: path for path in files} or make(Path(folder), seconds)
        print_origin()
        print(f"node {version.stdout.strip()}\n")
        for name, path in paths.items():
            found = measure(node, path)
            steps = found["steps"]
            assert isinstance(steps, list)
            print(f"{name}: {found['size']} bytes, memory {found['memory'] / 1e6:.0f} MB\n")  # type: ignore[operator]
            rows = [
                [
                    step["name"],
                    f"{step['ms']:.0f}",
                    step["requests"],
                    f"{step['bytesFetched'] / 1000:.0f}",
                    f"{step['samplesDecoded'] / 1e6:.2f}",
                    f"{step['decodeMs']:.0f}",
                ]
                for step in steps
            ]
            print_table(["", "ms", "requests", "kB", "Msamples decoded", "ms decoding"], rows)


if __name__ == "__main__":
    main()
