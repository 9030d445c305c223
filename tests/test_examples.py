"""Annex B and conformance/examples: the same bytes, and what they decode to."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest
from judge import rule
from spec import ROOT, TEXT

from hapfmt.reading.reader import Reader

EXAMPLES = ROOT / "conformance" / "examples"
LISTING = re.compile(r"`(\w+)\.hapf`:.*?```\n(.*?)\n```", re.S)
ANNEX = dict(LISTING.findall(TEXT[TEXT.index("<!-- examples -->") :]))


def bytes_of(listing: str) -> bytes:
    out = b""
    for line in listing.splitlines():
        offset, row = int(line[:6], 16), bytes.fromhex(line[8:55])
        assert offset == len(out)
        out += row
    return out


@pytest.mark.parametrize("name", ANNEX)
def test_listings_are_the_files(name):
    data = (EXAMPLES / f"{name}.hapf").read_bytes()
    assert bytes_of(ANNEX[name]) == data
    assert rule(data) == ("intact", None)


@pytest.mark.parametrize("name", ANNEX)
def test_files_decode_to_what_stands_beside_them(name):
    expected = json.loads((EXAMPLES / f"{name}.json").read_text())
    with Reader(EXAMPLES / f"{name}.hapf") as reader:
        (channel,) = reader.read().channels
        layers = [piece.events for piece in reader.pieces(reader.catalogue.layers)]
        clock = [[seen.tick, seen.time_ns, seen.uncertainty_ns] for seen in reader.clocks]
    found = [
        {"start": start, "counts": [[value] for value in values.tolist()]}
        for start, values in channel.segments()
    ]
    beside = {"events": [list(event) for events in layers for event in events], "clock": clock}
    assert expected == {"0": found, **{key: rows for key, rows in beside.items() if rows}}


def test_every_example_is_listed():
    assert {path.stem for path in EXAMPLES.glob("*.hapf")} == set(ANNEX)


def test_the_generator_makes_what_is_committed():
    done = subprocess.run(
        [sys.executable, "conformance/gen/examples.py"], cwd=ROOT, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert (done.stdout, done.returncode) == ("all as committed\n", 0)
