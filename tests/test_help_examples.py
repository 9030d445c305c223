"""Every example of a help text runs, but for those that need a device or a network."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
import ros_files
from pages import Command, environment, printed

import hapfmt
from hapfmt.cli import VERBS, cli
from hapfmt.cli.screen import Verb

pytestmark = [
    pytest.mark.deep,
    pytest.mark.skipif(os.name == "nt", reason="some examples are for a POSIX shell"),
]
NOT_RUN = {
    "hapfmt archive catalogue s3://bucket/archive -o archive.parquet --jobs 4": "a store of S3",
    "hapfmt plot touch.npz --window": "a screen",
    "hapfmt profile check mine.toml --path /dev/hidraw3": "a device",
    "hapfmt study study.toml --subject S07 --device glove5": "a device and a subject",
    "hapfmt replay hand.hapf --device glove5 --start 2 --stop 5 --gain 0.2": "a device",
    "hapfmt view left.hapf right.hapf --no-browser": "a browser",
    "hapfmt view touch.hapf": "a browser",
}
"""Examples that no test runs -> what they need."""
MAKERS = {"encode", "decode", "convert", "subset", "merge", "concat", "recover", "record"}
FIRST = {
    "hapfmt archive catalogue": ["hapfmt archive encode recordings/ archive/"],
    "hapfmt archive bag": ["hapfmt archive encode recordings/ archive/"],
    "hapfmt archive convert": ["hapfmt archive encode recordings/ archive/"],
    "hapfmt archive recover": ["hapfmt archive encode recordings/ archive/"],
    "hapfmt archive verify": ["hapfmt archive encode recordings/ archive/"],
    "hapfmt archive find": [
        "hapfmt archive encode recordings/ archive/",
        "hapfmt archive catalogue archive/",
    ],
    "hapfmt study study": ["hapfmt study --new study.toml sand.hapf cork.hapf"],
    "hapfmt study --summary": [
        "hapfmt study --new study.toml sand.hapf cork.hapf",
        "hapfmt study study.toml --prepare",
        r"printf 'p\n50\n%.0s' $(seq 30) | hapfmt study study.toml --subject S07 --dry-run",
    ],
    "hapfmt clocks": ["cp clocks.hapf touch.hapf"],
    "hapfmt convert lab.hapf": ["cp joints.hapf lab.hapf"],
    "hapfmt attach touch.hapf --": ["hapfmt attach touch.hapf photo.png"],
    "hapfmt annotate touch.hapf --list": ["hapfmt annotate touch.hapf --at 1 contact"],
    "sensor | hapfmt record touch.hapf --append": [
        "rm touch.hapf",
        "sensor | hapfmt record touch.hapf --rate 1000 --labels x,y,z --unit N",
    ],
}
"""What comes before the examples that begin so."""
LOSSES = {"hapfmt recover broken.hapf whole.hapf", "hapfmt recover --in-place crashed.hapf"}
"""Examples that end with exit code 3."""


def examples() -> Iterator[str]:
    contexts = [click.Context(cli, info_name="hapfmt")]
    for context in contexts:
        command = context.command
        yield from (re.sub(r" {3,}.*", "", line) for line in Verb.parts(command)[1])  # type: ignore[arg-type]
        if isinstance(command, click.Group):
            for name in command.list_commands(context):
                found = command.get_command(context, name)
                assert found is not None
                contexts.append(click.Context(found, parent=context, info_name=name))


EXAMPLES = list(dict.fromkeys(examples()))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every file that an example reads."""
    for module in ("matplotlib", "rosbags", "soundfile", "pyarrow", "polars", "bagit", "vibromaf"):
        pytest.importorskip(module)
    folder = tmp_path_factory.mktemp("store")
    touch = recording(["normal force", "force_z", "fx"])
    hapfmt.save(touch, folder / "original.npz")
    hapfmt.save(touch, folder / "touch.npz")
    hapfmt.save(touch, folder / "touch.csv")
    np.save(folder / "f.npy", touch["fx"].to_numpy())
    for name in ("touch", "a", "b", "monday", "tuesday", "part-1", "part-2", "l", "r", "left"):
        hapfmt.write(touch, folder / f"{name}.hapf")
    hapfmt.write(touch, folder / "right.hapf")
    hapfmt.write(recording(["force_z"], seconds=40), folder / "long.hapf", preset="paper")
    hapfmt.write(recording(["joint 1", "joint 2"]), folder / "joints.hapf")
    epoch = 1_700_000_000 * 10**9
    for name in ("force", "skin"):
        hapfmt.write(replace(recording([name]), epoch_ns=epoch), folder / f"{name}.hapf")
    hapfmt.write(clocks(touch), folder / "clocks.hapf")
    for scene in ("sand", "cork"):
        run(f"hapfmt scene {scene} {scene}.hapf --seconds 0.3", folder)
    run("hapfmt scene grasp hand.hapf --seconds 6", folder)
    ros_files.wrenches(folder, "bag", 300, "lab")
    run("hapfmt encode lab.bag lab.hapf --keep-stamps", folder)
    messages = [("/wrench", epoch + 10**6 * n, {"force": {"x": 0.1 * n}}) for n in range(300)]
    (folder / "session.mcap").write_bytes(ros_files.json_mcap(messages))
    whole = (folder / "long.hapf").read_bytes()
    (folder / "broken.hapf").write_bytes(whole[: len(whole) // 2])
    (folder / "crashed.hapf").write_bytes(whole[:-20])
    (folder / "photo.png").write_bytes(b"\x89PNG")
    (folder / "calibration.pdf").write_bytes(b"%PDF")
    (folder / "events.csv").write_text("time,text\n0.5,contact\n")
    for name in ("photos", "recordings", "day1"):
        (folder / name).mkdir()
    shutil.copy(folder / "touch.npz", folder / "recordings")
    shutil.copy(folder / "session.mcap", folder / "day1")
    run("hapfmt profile show glove5 > mine.toml", folder)
    sensor = Path(environment(folder)["PATH"].split(os.pathsep)[0]) / "sensor"
    sensor.write_text("#!/bin/sh\nfor i in 1 2 3; do echo $i,0.5,-$i; done\n")
    sensor.chmod(0o755)
    return folder


def recording(labels: list[str], seconds: int = 3) -> hapfmt.Recording:
    time = np.arange(1000 * seconds) / 1000
    signals = [
        np.round(
            2 + np.sin((3 + n) * time) + np.random.default_rng(n).normal(0, 0.05, len(time)), 3
        )
        for n in range(len(labels))
    ]
    return hapfmt.Recording(
        tuple(
            hapfmt.Channel.from_physical(signal, 1000, label=label, unit="N")
            for label, signal in zip(labels, signals, strict=True)
        )
    )


def clocks(rec: hapfmt.Recording) -> hapfmt.Recording:
    seen = tuple(
        hapfmt.ClockObservation("pc", 0, 100 * n, 10**12 + n * 100_004_000) for n in range(30)
    )
    return replace(rec, clocks=seen)


def run(line: str, room: Path, code: int = 0) -> None:
    found, out, err = printed(Command(line, ""), room)
    assert found == code, f"$ {line}\n{out}{err}"


def made(line: str) -> list[str]:
    """Files that the example writes."""
    words = shlex.split(re.search(r"hapfmt [^|]*", line)[0])  # type: ignore[index]
    places = [
        n + 1
        for n, word in enumerate(words)
        if word in {"-o", "--output", "--plot", "--export", ">"}
    ]
    if words[1] in MAKERS and "--in-place" not in words and "--append" not in words:
        plain = words[2:]
        end = next((n for n, word in enumerate(plain) if word.startswith("--")), len(plain))
        places.append(1 + end)
    if words[1] == "scene":
        places.append(3)
    return [words[n] for n in places if n < len(words)]


@pytest.mark.parametrize("line", [line for line in EXAMPLES if line not in NOT_RUN])
def test_example(line: str, store: Path, tmp_path: Path) -> None:
    room = tmp_path / "room"
    shutil.copytree(store, room)
    for name in made(line):
        if (room / name).is_file():
            (room / name).unlink()
    for start, lines in FIRST.items():
        if line.startswith(start):
            for each in lines:
                run(each, room)
    run(line, room, code=3 if line in LOSSES else 0)


def test_only_examples_are_left_out() -> None:
    assert set(NOT_RUN) <= set(EXAMPLES)
    assert len(EXAMPLES) > 2 * len(VERBS)
