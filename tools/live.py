"""Blocks of a second as they arrive: how many channels one core keeps up with, and what it costs
in bytes that the whole recording is not at hand.

python tools/live.py [channels] [folder of recordings (.npz)]
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from bench import load_all
from measured import print_origin, print_table
from simulated import glove, recordings

import hapfmt
from hapfmt import Settings
from hapfmt.encoder.encode import encode
from hapfmt.encoder.lattice import to_counts
from hapfmt.encoder.live import Block, LiveEncoder
from hapfmt.live.inputs import Input

SECOND, SECONDS, RUNS = 1000, 6, 3
SHARE = 0.002
"""Of a channel's range: its floor, as encode() takes it by itself."""

PRESETS = {
    "archive": Settings("archive"),
    "archive, fast": Settings.of("archive", fast=True),
    "near-lossless, 2 counts": Settings.of("near-lossless", max_error="2lsb"),
    "deadband 10 %, 10 counts": Settings.of("deadband", floor="10lsb"),
}


def signals(channels: int, kind: str) -> list[np.ndarray]:
    """Counts at 1 kHz: joints of a glove at rest and in motion, or textures that never rest."""
    rows = [c.stored for c in glove(SECONDS, SECOND, channels).channels]
    if kind == "glove":
        return rows
    t = np.arange(SECONDS * SECOND) / SECOND
    shake = []
    for number, row in enumerate(rows):
        g = np.random.Generator(np.random.PCG64([3, number]))
        texture = 40 * np.sin(t * g.uniform(300, 900)) + g.normal(0, 12, t.size)
        shake.append((row + np.round(texture)).astype(np.int16))
    return shake


def speed(rows: list[np.ndarray], settings: Settings) -> list[object]:
    """Of the blocks after the first, which tracks are made of."""
    given = Input("channel", SECOND, unit="deg", calibration=hapfmt.Calibration(1, 0, 20))
    best = [float("inf")] * SECONDS
    for _ in range(RUNS):
        encoder, size = LiveEncoder(settings), 0
        for second in range(SECONDS):
            at = second * SECOND
            blocks = [Block(c, given, at, x[at : at + SECOND]) for c, x in enumerate(rows)]
            began = time.process_time()
            _, packets = encoder.encode(blocks)
            best[second] = min(best[second], time.process_time() - began)
            size += sum(len(packet.data) for packet in packets)
    each = sum(best[1:]) / (SECONDS - 1) / len(rows)
    return [
        f"{1e6 * best[0] / len(rows):.0f}",
        f"{1e6 * each:.1f}",
        f"{SECOND / each / 1e6:.1f}",
        f"{1 / each:,.0f}",
        f"{8 * size / len(rows) / SECONDS / SECOND:.3f}",
    ]


def sizes(recording: hapfmt.Recording, preset: str) -> tuple[int, int, int, int] | None:
    """Bytes block by block and of the whole, each channel alone; packets; and tracks in all."""
    live = whole = count = tracks = 0
    for channel in recording.channels:
        given, _ = to_counts(channel)
        if given.calibration is None or not given.stored.size:
            continue
        settings = Settings.of(preset.removesuffix(", fast"), fast=preset.endswith("fast") or None,
                               max_error="1lsb" if preset == "near-lossless" else None)  # fmt: skip
        extent = float(abs(given.calibration.step)) * float(np.ptp(given.stored))
        if preset == "deadband":
            settings = replace(settings, floor=max(SHARE * extent, 1e-12))
        settings = replace(settings, cluster=Fraction(1), references=False)
        bits = max(24, int(np.abs(given.stored.astype(np.int64)).max()).bit_length() + 1)
        source = Input(
            channel.label, given.rate_exact, channel.unit, calibration=given.calibration, bits=bits
        )
        encoder = LiveEncoder(settings)
        coded = encode(hapfmt.Recording((given,)), settings, threads=1)
        whole += sum(len(packet.data) for packet in coded.packets)
        count += len(coded.packets)
        at = 0
        for span in given.coverage:
            for tick in range(span.start, span.stop, round(given.rate_exact)):
                stop = min(tick + round(given.rate_exact), span.stop)
                block = Block(0, source, tick, given.stored[at : at + stop - tick])
                at += stop - tick
                new, packets = encoder.encode([block])
                tracks += len(new)
                live += sum(len(packet.data) for packet in packets)
    return (live, whole, count, tracks) if count else None


def main() -> None:
    channels = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    print_origin()
    print(f"{channels} channels at 1 kHz, blocks of a second, one thread; microseconds a packet:\n")
    rows = []
    for kind in ("glove", "texture"):
        given = signals(channels, kind)
        rows += [[kind, name, *speed(given, settings)] for name, settings in PRESETS.items()]
    print_table(
        ["signal", "preset", "first", "later", "Ms/s", "channels a core", "bit/sample"], rows
    )
    found = recordings(20)
    if len(sys.argv) > 2:
        found |= dict(load_all(Path(sys.argv[2]), "", None))
    print("Packets of a second, each channel alone: bytes block by block, and of encode():\n")
    rows = []
    for preset in ("archive", "archive, fast", "near-lossless", "deadband"):
        for name, recording in found.items():
            sized = sizes(recording, preset)
            if sized:
                live, whole, count, tracks = sized
                more = f"{100 * (live / whole - 1):+.2f} %"
                rows.append([preset, name, count, tracks, live, whole, more])
    print_table(["preset", "recording", "packets", "tracks", "live", "whole", "more"], rows)


if __name__ == "__main__":
    main()
