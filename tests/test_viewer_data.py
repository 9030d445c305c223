"""The data layer of the viewer, run by node: its numbers are those of hapfmt.read, whatever it fetches."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from server import serving
from spec import ROOT

import hapfmt

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="needs node")

DTYPES = {"Float64Array": np.float64, "Uint8Array": np.uint8}


class ViewerError(Exception):
    """What the data layer says of a file that it cannot read."""


def unpacked(value: Any) -> Any:
    """With arrays in place of their base64."""
    if isinstance(value, dict):
        if value.keys() == {"base64", "type"}:
            return np.frombuffer(base64.b64decode(value["base64"]), DTYPES[value["type"]])
        return {key: unpacked(one) for key, one in value.items()}
    return [unpacked(one) for one in value] if isinstance(value, list) else value


class Viewer:
    """One process of node that answers requests."""

    def __init__(self) -> None:
        assert NODE
        self.process = subprocess.Popen(
            [NODE, str(ROOT / "tests" / "viewer" / "reads.mjs")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, call: str, args: Any = ()) -> Any:
        assert self.process.stdin and self.process.stdout
        self.process.stdin.write(json.dumps({"call": call, "args": args}) + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        if "error" in answer:
            error = answer["error"]
            assert error["kind"] != "internal", error["stack"]
            raise ViewerError(error["message"])
        return unpacked(answer["value"])

    def open(self, place: str | Path, kind: str = "bytes") -> Any:
        return self.ask("open", {"kind": kind, "place": str(place)})


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    one = Viewer()
    with one.process:
        yield one
    assert one.process.returncode == 0


def same(found: NDArray[np.float64], wanted: NDArray[np.float64]) -> None:
    """Bit for bit, any NaN like another."""
    assert found.dtype == wanted.dtype and found.shape == wanted.shape
    both = np.isnan(found) & np.isnan(wanted)
    assert np.array_equal(found.view(np.uint64)[~both], wanted.view(np.uint64)[~both])


BANDS = {"sum": "full", "lf": "lf", "hf": "hf"}


def check_file(viewer: Viewer, path: Path, facts: Any) -> None:
    for channel in facts["channels"]:
        for band in channel["bands"]:
            wanted = hapfmt.read(path, band=BANDS[band])[channel["index"]]
            first, stop = channel["firstTick"], channel["stopTick"]
            rate = wanted.rate_exact
            found = viewer.ask("samples", [channel["index"], 0, 1e9, band])
            same(found["value"], wanted.filled(first, stop))
            same(
                found["time"],
                np.arange(first, stop) * float(rate.denominator) / float(rate.numerator),
            )


def signals(seconds: float, rate: int, channels: int) -> NDArray[np.float64]:
    t = np.arange(int(seconds * rate)) / rate
    rng = np.random.default_rng(3)
    rows = [
        np.round(np.sin((c + 1) * t) * 900 + rng.normal(0, 4, t.size)) / 100
        for c in range(channels)
    ]
    return np.stack(rows)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "plain.hapf"
    hapfmt.write(signals(30, 1000, 4), path, rate=1000, units="N")
    return path


@pytest.mark.parametrize("kind", ["bytes", "blob"])
def test_values_and_times_are_those_of_read(viewer: Viewer, plain: Path, kind: str) -> None:
    check_file(viewer, plain, viewer.open(plain, kind))


def test_a_part_of_a_remote_file_takes_few_requests(viewer: Viewer, plain: Path) -> None:
    with serving({"plain.hapf": plain.read_bytes()}) as server:
        facts = viewer.open(server.url("plain.hapf"), "url")
        assert facts["verdict"] == "intact so far" and len(facts["channels"]) == 4
        found = viewer.ask("samples", [1, 10, 11, "sum"])
        same(found["value"], hapfmt.read(plain, start=10, stop=11)[1].to_numpy(10, 11))
        assert len(server.asked) <= 4
        assert viewer.ask("stats")["requests"] == len(server.asked)


def test_an_envelope_holds_every_sample(viewer: Viewer, plain: Path) -> None:
    facts = viewer.open(plain)
    wanted = hapfmt.read(plain)[2]
    found = viewer.ask("settled", [[2], facts["start"], facts["stop"], 100, "sum"])["2"]
    assert found["kind"] == "envelope" and found["complete"] and 50 <= found["time"].size <= 101
    width = found["time"][1] - found["time"][0]
    bins = np.floor((wanted.times() - found["time"][0]) / width + 0.5).astype(int)
    values = wanted.to_numpy()
    for place in range(found["time"].size):
        within = values[bins == place]
        assert found["min"][place] == within.min() and found["max"][place] == within.max()
