"""Files of every kind that presets make, and what must be the same after an edit."""

from __future__ import annotations

import io
import uuid
import zlib
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any

import forge
import numpy as np

import hapfmt
from hapfmt.format.cluster import Packet, parse_cluster
from hapfmt.format.source import BytesSource
from hapfmt.format.track import Track
from hapfmt.format.walk import read_chunk
from hapfmt.reading.opening import open_catalogue

TICKS, RATE = 1500, 500
UUID = uuid.UUID(int=7)
EPOCH_NS = 1_700_000_000_000_000_001


def waves(count: int, seed: int) -> np.ndarray:
    """[count, TICKS] counts that resemble each other, slow with some texture."""
    generator = np.random.default_rng(seed)
    t = np.arange(TICKS) / RATE
    slow = 3000 * np.sin(2 * np.pi * t) + 8000
    rows = [slow * (1 + i / 10) + generator.normal(0, 40, TICKS) for i in range(count)]
    return np.round(np.array(rows)).astype(np.int32)


def counts(label: str, values: np.ndarray, rate: int = RATE, **described: Any) -> hapfmt.Channel:
    """With a gap in the middle."""
    half = len(values) // 2
    given: dict[str, Any] = {
        "coverage": (hapfmt.Span(0, half), hapfmt.Span(half + 20, len(values) + 20)),
        "calibration": hapfmt.Calibration(1, 0, 1000),
        "unit": "N",
    }
    return hapfmt.Channel(values, Fraction(rate), label=label, **(given | described))


def recording(*channels: hapfmt.Channel) -> hapfmt.Recording:
    return hapfmt.Recording(
        channels,
        uuid=UUID,
        epoch_ns=EPOCH_NS,
        epoch_uncertainty_ns=50,
        metadata={"subject": "S1", "n": [1, 2.5, None], "notes": ["recorded on a Monday"]},
        attachments={"sheet.txt": ("text/plain", b"as it was")},
    )


def plain(seed: int) -> hapfmt.Recording:
    return recording(*(counts(x, row) for x, row in zip("abc", waves(3, seed), strict=True)))


def alike(seed: int) -> hapfmt.Recording:
    """What references between channels are for."""
    noise = waves(1, seed)[0] - waves(1, seed + 1)[0]
    return recording(*(counts(x, row + i * noise) for i, (x, row) in
                       enumerate(zip("abcd", waves(4, 5), strict=True))))  # fmt: skip


def vectors(seed: int) -> hapfmt.Recording:
    rows = zip("xyz", waves(3, seed), strict=True)
    axes = [counts(f"f{x}", row, axis=x, group="f") for x, row in rows]
    return recording(*axes, counts("alone", waves(1, seed + 9)[0]))


def doubles(seed: int) -> hapfmt.Recording:
    """True doubles, doubles off their lattice, words, slow counts."""
    generator = np.random.default_rng(seed)
    words = generator.integers(0, 1 << 63, 300).astype(np.uint64)
    return recording(
        hapfmt.Channel.from_physical(generator.normal(size=700), RATE, label="true"),
        hapfmt.Channel.from_physical(waves(1, seed)[0] * 0.1 * 3, RATE, label="near", start_tick=9),
        hapfmt.Channel(words, Fraction(100), (hapfmt.Span(7, 307),), label="words"),
        counts("slow", np.arange(31, dtype=np.int32), 10),
    )


PRESETS: dict[str, tuple[Any, dict[str, Any]]] = {
    "paper step": (plain, {"preset": "paper", "step": "0.2%", "smallest": False}),
    "paper 1lsb": (plain, {"preset": "paper", "step": "1lsb", "smallest": False}),
    "paper vectors": (vectors, {"preset": "paper", "smallest": False}),
    "paper": (plain, {"preset": "paper", "bits": 5}),
    "perceptual": (vectors, {"preset": "perceptual", "texture": False, "felt": "all"}),
    "lossless": (plain, {"preset": "lossless"}),
    "lossless alike": (alike, {"preset": "lossless"}),
    "lossless fast": (plain, {"preset": "lossless", "fast": True}),
    "lossless doubles": (doubles, {"preset": "lossless"}),
    "near-lossless doubles": (doubles, {"preset": "near-lossless"}),
    "perceptual doubles": (doubles, {"preset": "perceptual", "texture": False}),
}


@cache
def made(name: str, seed: int = 0, cluster: Fraction = Fraction(1, 2), **changes: Any) -> bytes:
    """The bytes of a file with digests; ``changes`` to the recording."""
    scene, given = PRESETS[name]
    return write(replace(scene(seed), **changes), canonical=seed + 1, cluster=cluster, **given)


def write(recording: hapfmt.Recording, *, canonical: int = 1, **given: Any) -> bytes:
    stream = io.BytesIO()
    settings = hapfmt.Settings.of(**{"digest": True, **given})
    hapfmt.write(recording, stream, settings, canonical=canonical)
    return stream.getvalue()


def tracks_of(data: bytes) -> dict[int, Track]:
    return open_catalogue(BytesSource(data), scan=True).tracks


def packets_of(data: bytes) -> list[Packet]:
    """All of them in the order of the file."""
    source = BytesSource(data)
    catalogue = open_catalogue(source, scan=True)
    found: list[Packet] = []
    for ref in catalogue.data:
        chunk = read_chunk(source, ref.offset)
        assert chunk is not None
        found += parse_cluster(
            chunk.payload, catalogue.tracks, catalogue.level, 0, chunk.header.cluster_seed
        )
    return found


def chunks_of(data: bytes, type_: str) -> list[bytes]:
    source = BytesSource(data)
    refs = open_catalogue(source, scan=True).chunks
    chunks = [read_chunk(source, ref.offset) for ref in refs if ref.type == type_]
    return [chunk.payload for chunk in chunks if chunk]


def described(data: bytes) -> list[bytes]:
    """The payloads of TRAK, their tracks as they are."""
    found = []
    for payload in chunks_of(data, "TRAK"):
        first, at = forge.number_at(payload, 0)
        size, at = forge.number_at(payload, at)
        plain = zlib.decompress(payload[at:], -15) if size else payload[at:]
        found.append(forge.tracks(plain, first=first))
    return found


def by_label(data: bytes) -> dict[tuple[tuple[str, ...], bool], list[tuple[int, int, bytes]]]:
    """(start, span, bytes) of the packets of each track, in order of time, by its labels, and
    whether it is an HF track."""
    tracks = tracks_of(data)
    found: dict[Any, list[tuple[int, int, bytes]]] = {}
    for track in tracks.values():
        found[labels(track, tracks), track.kind == "hf"] = []
    for packet in packets_of(data):
        track = tracks[packet.track]
        row = found[labels(track, tracks), track.kind == "hf"]
        row.append((packet.start, packet.span, packet.data))
    return found


def labels(track: Track, tracks: dict[int, Track]) -> tuple[str, ...]:
    described = track if track.base is None else tracks[track.base]
    return tuple(component.label for component in described.components)


def assert_intact(data: bytes, *, digests: int | None = None) -> None:
    report = hapfmt.verify(data)
    assert report.exit_code == 0, (report.error, report.findings)
    assert digests is None or report.digests == digests


def assert_same_channel(a: hapfmt.Channel, b: hapfmt.Channel) -> None:
    for name in ("rate", "calibration", "coverage", "label", "unit", "quantity", "axis", "group",
                 "body_site", "device", "deviation"):  # fmt: skip
        assert getattr(a, name) == getattr(b, name), name
    assert a.stored.dtype == b.stored.dtype
    assert a.stored.tobytes() == b.stored.tobytes()
    if a.stored.size:
        assert (a.exact is None) == (b.exact is None)
    if a.exact is not None and b.exact is not None:
        assert a.exact.tobytes() == b.exact.tobytes()


def assert_same(a: hapfmt.Recording, b: hapfmt.Recording) -> None:
    """All but the UUID and what the notes say."""
    assert len(a) == len(b)
    for one, other in zip(a.channels, b.channels, strict=True):
        assert_same_channel(one, other)
    assert (a.epoch_ns, a.epoch_uncertainty_ns) == (b.epoch_ns, b.epoch_uncertainty_ns)
    assert a.attachments == b.attachments
    assert without_notes(a.metadata) == without_notes(b.metadata)


def without_notes(metadata: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in metadata.items() if name != "notes"}
