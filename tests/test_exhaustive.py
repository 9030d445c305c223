"""Every bit flipped, every prefix, every byte missing, a byte more at every place, of small files:
none passes as intact, no sample is wrong, and what ``recover`` makes of it is intact.

All of it in the profile ``nightly``, every 11th case in ``ci``, every 97th otherwise.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from depth import either
from judge import samples
from spec import ROOT

import hapfmt
from hapfmt.errors import FormatError
from hapfmt.reading.verifier import verify

EXAMPLES = ROOT / "conformance" / "examples"
PRESETS: dict[str, dict] = {
    "lossless": {"digest": True},
    "perceptual": {},
    "perceptual, no texture": {"texture": False, "felt": "all"},
}
FILES = ("hold", "residual", "events", *PRESETS)
KINDS = ("flipped", "deleted", "cut", "zero inserted", "ones inserted")


@cache
def small(name: str) -> bytes:
    """Two clusters; a worked example, or two channels by an encoder."""
    if name == "events":
        marks = tuple(hapfmt.Event(time=i / 100, text=f"mark {i}", channel=i % 2) for i in range(3))
        out = io.BytesIO()
        channel = hapfmt.Channel(np.arange(9), 100, label="f")
        recording = hapfmt.Recording((channel, channel), events=marks)
        hapfmt.write(recording, out, hapfmt.Settings.of("lossless", cluster="0.04"), canonical=7)
        return out.getvalue()
    if name not in PRESETS:
        return (EXAMPLES / f"{name}.hapf").read_bytes()
    x = np.random.default_rng(5).integers(-3, 4, (24, 2)).cumsum(axis=0)
    calibration = hapfmt.Calibration(1, 0, 100)
    channels = tuple(
        hapfmt.Channel(x[:, i], 1000, calibration=calibration, unit="N") for i in range(2)
    )
    out = io.BytesIO()
    settings = hapfmt.Settings.of(name.partition(",")[0], cluster="0.012", **PRESETS[name])
    hapfmt.write(hapfmt.Recording(channels), out, settings, canonical=7)
    return out.getvalue()


@cache
def clean(name: str, band: str) -> dict:
    return samples(small(name), band=band)


def events(data: bytes) -> list[hapfmt.Event]:
    try:
        with hapfmt.Reader(data, scan=True) as reader:
            return reader.events()
    except hapfmt.HapfmtError:
        return []


def cases(data: bytes, kind: str) -> Iterator[bytes]:
    for at in range(len(data)):
        before, byte, after = data[:at], data[at], data[at + 1 :]
        if kind == "flipped":
            for bit in range(8):
                yield before + bytes([byte ^ 1 << bit]) + after
        elif kind == "deleted":
            yield before + after
        elif kind == "cut":
            yield before
        else:
            yield before + (b"\0" if kind[0] == "z" else b"\xff") + data[at:]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", FILES)
@either("step", 197, 23, 1)
def test_every_single_fault(name, kind, step):
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
    REC-001: A reader MUST NOT deliver a sample from a packet whose CRC differs, nor from a chunk whose header CRC or file id differs.
    REC-006: A recovered file MUST contain exactly the packets that a reader delivers through damage and that decode, exact values too. Track id, start, span and bytes stay the same.
    """
    bands = ("full", "lf") if name in ("residual", "perceptual") else ("full",)
    for number, bad in enumerate(cases(small(name), kind)):
        if number % step:
            continue
        assert verify(bad, threads=1).verdict != "intact", number
        out = io.BytesIO()
        try:
            hapfmt.recover(bad, out, canonical=9)
        except FormatError:
            assert not samples(bad), number
            continue
        report = verify(out.getvalue(), threads=1)
        assert report.verdict == "intact", (number, report.error, report.findings)
        if name == "events":
            told = events(bad)
            assert set(told) <= set(events(small(name))), number
            assert events(out.getvalue()) == told, number
        for band in bands:
            found = samples(bad, band=band)
            assert found.items() <= clean(name, band).items(), number
            assert samples(out.getvalue(), band=band) == found, number
