"""Whole files through everything that reads them."""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import forge as f
import numpy as np

import hapfmt
from hapfmt import Calibration, Channel, Event, Limits, Recording, Settings
from hapfmt.cli.info import describe
from hapfmt.format.source import BytesSource
from hapfmt.kernels import compiled
from hapfmt.reading.dump import dump, measure
from hapfmt.reading.opening import open_catalogue
from hapfmt.reading.reader import BANDS, Reader
from hapfmt.reading.verifier import verify

from .decoders import readable
from .mend import mend_file
from .target import Target, settled

LIMITS = Limits(samples=1 << 14, packet_samples=1 << 13, work_samples=1 << 14)
"""What is larger differs in nothing but the time it takes."""

Samples = dict[tuple[str, int], tuple[Any, ...]]


def samples(data: bytes, *, scan: bool) -> Samples:
    """All that a reader delivers, by band and channel; each read by itself."""
    found: Samples = {}
    for band in BANDS:
        reader = settled(Reader, data, limits=LIMITS, scan=scan)
        if reader is None:
            return {}
        recording = settled(reader.read, band=band)
        if recording is None:
            continue
        for ref, channel in zip(reader.channels, recording.channels, strict=True):
            exact = b"" if channel.exact is None else channel.exact.tobytes()
            found[band, ref.number] = (channel.stored.tobytes(), exact, channel.coverage)
        found[band, -1] = recording.events
        json.dumps([finding.as_json() for finding in reader.findings])
    return found


def file(data: bytes) -> None:
    report = verify(data, limits=LIMITS)
    assert report.exit_code in (0, 2, 3, 4)
    json.dumps(report.as_json(), allow_nan=False)
    walked = samples(data, scan=True)
    if report.verdict == "intact":
        assert report.error is None
        assert not report.findings
        # Bands that are lossless alone may be above the limits together.
        assert walked == samples(data, scan=False)
    else:
        samples(data, scan=False)
    if compiled is not None:
        with readable():
            assert verify(data, limits=LIMITS) == report or report.error
            assert walked == samples(data, scan=True)
    part = settled(Reader, data, limits=LIMITS)
    if part is not None:
        settled(part.read, start=Fraction(1, 1000), stop=Fraction(3, 1000))
        settled(part.events, start=Fraction(1, 1000))
        settled(lambda: (part.clocks, part.clock_maps))
    told = settled(lambda: list(dump(BytesSource(data), counts=True)))
    json.dumps(told, allow_nan=False)
    usage = settled(measure, BytesSource(data))
    if usage is not None:
        assert sum(usage.causes.values()) == len(data)
        assert min(usage.causes.values()) >= 0
        json.dumps(usage.as_json(), allow_nan=False)
    catalogue = settled(open_catalogue, BytesSource(data))
    if catalogue is not None:
        json.dumps(settled(describe, catalogue), allow_nan=False)


def wave(ticks: int, scale: float = 90.0) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(ticks)
    x = scale * np.sin(np.arange(ticks) / 7) + rng.normal(0, scale / 40, ticks)
    return np.round(x).astype(np.int32)


def recording() -> Recording:
    """Counts of a vector, doubles that miss a lattice, words, a gap; one rate is slow."""
    newtons = {
        "unit": "N",
        "quantity": "force",
        "group": "hand",
        "calibration": Calibration(1, 0, 100),
    }
    t = np.arange(60)
    gap = (hapfmt.Span(0, 20), hapfmt.Span(30, 60))
    return Recording(
        (
            Channel(wave(60), Fraction(1000), label="x", axis="x", **newtons),
            Channel(wave(60, 50), Fraction(1000), label="y", axis="y", **newtons),
            Channel(wave(50), Fraction(1000), coverage=gap, calibration=Calibration()),
            Channel(np.round(np.sin(t) * 30) * (1 / 30), Fraction(1000), unit="m"),
            Channel(np.arange(4, dtype=np.float32), Fraction(50)),
        ),
        events=(Event(Fraction(1, 100), "contact", Fraction(1, 50), 1, "by hand"), Event(0, "go")),
        metadata={"subject": "none", "notes": ["made"]},
        attachments={"a.txt": ("text/plain", b"hello")},
    )  # fmt: skip


WAYS = (
    {"preset": "lossless"},
    {"preset": "near-lossless", "max_error": "1lsb", "force_error": True},
    {"preset": "perceptual", "k": 0.1, "floor": "2lsb"},
    {"preset": "perceptual", "k": 0.1, "floor": "2lsb", "texture": False, "felt": "all"},
    {"preset": "paper", "k": 0.1, "floor": "2lsb", "bits": 4},
    {"preset": "paper", "k": 0.1, "floor": "2lsb", "step": "3lsb"},
)


def written(what: Recording, settings: Settings) -> bytes:
    out = io.BytesIO()
    with warnings.catch_warnings():  # some settings do nothing for some of these channels
        warnings.simplefilter("ignore", hapfmt.errors.DataWarning)
        hapfmt.write(what, out, settings, canonical=f.FILE_ID)
    return out.getvalue()


def of_file() -> Iterable[bytes]:
    yield f.minimal()
    yield f.minimal(("mETa", b'{"a":1}'), ("xXXx", b"?"), ("XXXX", b"!"))
    lf_hf = [
        ("HEAD", f.head(level=2)),
        ("TRAK", f.trak(kind=1)),
        ("TRAK", f.trak(f.tlv(1, f.quan_parameters(bytes([0x22, 0x22]), m=1, r=1)), kind=2,
                        base=0, codec=b"QUAN", first=1)),
        ("DATA", f.cluster((0, 0, 4, f.KNOT_DATA), (1, 0, 4, b"\x1b"))),
        ("dGST", f.digests(bytes(64))),
    ]  # fmt: skip
    yield f.closed(*lf_hf)
    yield f.file(*lf_hf)
    yield f.closed(
        ("HEAD", f.head()),
        f.TRACK_0,
        ("TRAK", f.layer(f.tlv(2, f.strings("by hand")), first=1)),
        ("TRAK", f.trak(continues=0, first=2)),
        ("cLOk", f.clock([(0, 10**18, 5), (9, 10**18 + 10**7, 0)], track=0)),
        ("DATA", f.cluster((0, 0, 4, f.KNOT_DATA), (1, 0, 4, f.event(1, "a", 2, 1) + f.event(2)))),
        ("DATA", f.cluster((1, 0, 2, f.event(0, "later")), (2, 4, 4, f.KNOT_DATA))),
        ("cMAp", f.clock_map([(0, 0), (1000, 10**9)])),
        duration_ns=8_000_000,
    )
    for given in WAYS:
        settings = Settings.of(cluster=Fraction(3, 100), smallest=False, **given)
        yield written(recording(), settings)
    alone = recording().channels
    for number in (0, 3, 4):
        yield written(Recording(alone[number : number + 1]), Settings(effort="fast"))


FILES = [Target("file", file, of_file, mend_file, 1 << 12)]
