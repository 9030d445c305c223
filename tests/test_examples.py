"""conformance/EXAMPLES.md and conformance/examples: the same bytes, and what they decode to."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
from judge import rule
from spec import EXAMPLES as TEXT_OF_EXAMPLES
from spec import ROOT, TEXT

from hapfmt.format.cluster import Packet
from hapfmt.format.track import Component, Track
from hapfmt.limits import LEVELS
from hapfmt.reading.decoder import TrackDecoder
from hapfmt.reading.reader import Reader

EXAMPLES = ROOT / "conformance" / "examples"
LISTING = re.compile(r"^## (\w+)\n.*?```\n(.*?)\n```", re.S | re.M)
PAGE = dict(LISTING.findall((ROOT / "conformance" / "EXAMPLES.md").read_text("utf-8")))
DAMAGED = {"salvaged": 0x9E, "table": 0x90}
"""Examples that were damaged, and the offset of the byte that was changed."""


def bytes_of(name: str, data: bytes) -> bytes:
    """What is listed of the file, between its first and its last bytes."""
    rows = [(int(row[:6], 16), bytes.fromhex(row[8:55])) for row in PAGE[name].splitlines()]
    first = rows[0][0]
    out = data[:first]
    for offset, row in rows:
        assert offset == len(out)
        out += row
    left_out = (0, 0) if name == "hold" else (0 if name == "described" else 43, 44)
    assert (first, len(data) - len(out)) == left_out
    return out + data[len(out) :]


@pytest.mark.parametrize("name", PAGE)
def test_listings_are_the_files(name):
    data = (EXAMPLES / f"{name}.hapf").read_bytes()
    listed = bytes_of(name, data)
    changed = [at for at, (a, b) in enumerate(zip(data, listed, strict=True)) if a != b]
    assert changed == ([DAMAGED[name]] if name in DAMAGED else [])
    assert rule(listed) == ("intact", None)
    assert rule(data)[0] == ("damaged" if name in DAMAGED else "intact")


def bits_of(values: np.ndarray) -> np.ndarray:
    return values.view("u8") if values.dtype == np.float64 else values


@pytest.mark.parametrize("name", PAGE)
def test_files_decode_to_what_their_json_says(name):
    expected = json.loads((EXAMPLES / f"{name}.json").read_text())
    with Reader(EXAMPLES / f"{name}.hapf") as reader:
        channels = reader.read().channels
        layers = [piece.events for piece in reader.pieces(reader.catalogue.layers)]
        clock = [[seen.tick, seen.time_ns, seen.uncertainty_ns] for seen in reader.clocks]
    found = {
        str(number): [
            {"start": start, "counts": [[value] for value in bits_of(values).tolist()]}
            for start, values in channel.segments()
        ]
        for number, channel in enumerate(channels)
    }
    exact = [
        {"start": 0, "exact": [f"{word:016x}" for word in bits_of(channel.exact).tolist()]}
        for channel in channels
        if channel.exact is not None
    ]
    rest = {"events": [list(event) for events in layers for event in events], "clock": clock}
    rest["exact"] = exact
    assert expected == found | {key: rows for key, rows in rest.items() if rows}


def test_the_file_of_clause_9_is_an_example():
    rows = re.search(r"<!-- example: hold -->\n```\n(.*?)\n```", TEXT, re.S)[1].splitlines()
    data = b"".join(bytes.fromhex(row.partition("  ")[0]) for row in rows)
    assert data == (EXAMPLES / "hold.hapf").read_bytes()


ROW = re.compile(
    r"^\| `(QUAN|MDCT|NOIS)` \| `([0-9A-F ]+)` \| `([0-9A-F ]+)` \| ([-0-9, ]+) \|$", re.M
)


def test_packets_of_other_codecs_decode_to_their_counts():
    rows = ROW.findall(TEXT_OF_EXAMPLES)
    assert {row[0] for row in rows} == {"QUAN", "MDCT", "NOIS"}
    for codec, parameters, packet, told in rows:
        counts = [int(count) for count in told.split(", ")]
        track = Track(
            0, "full", codec, Fraction(1000), 0, (Component(),), bytes.fromhex(parameters),
            count_min=-1000, count_max=1000,
        )  # fmt: skip
        data = Packet(0, 0, len(counts), bytes.fromhex(packet), 0)
        assert TrackDecoder(track, LEVELS[1]).decode(data)[:, 0].tolist() == counts


def test_every_example_is_listed_and_named_in_the_spec():
    assert {path.stem for path in EXAMPLES.glob("*.hapf")} == set(PAGE)
    annex = TEXT[TEXT.index("## Annex B") : TEXT.index("## Annex C")]
    assert {*PAGE, "packets"} <= set(re.findall(r"`(\w+)`", annex))


def test_the_generator_makes_what_is_committed():
    done = subprocess.run(
        [sys.executable, "conformance/gen/examples.py"], cwd=ROOT, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert (done.stdout, done.returncode) == ("all as committed\n", 0)
