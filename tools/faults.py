"""Faults in one file: wrong samples delivered without a report, and how many come back.

python tools/faults.py [TRIALS]     default 200 of each kind
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from fractions import Fraction

import numpy as np
from measured import print_origin, print_table

import hapfmt
from hapfmt.scenes.stylus import simulate

SECONDS, RATE = 60.0, 8000
CLUSTER = Fraction(1, 2)
Rng = np.random.Generator
Fault = Callable[[bytes, Rng], bytes]


def change(data: bytes, rng: Rng) -> bytes:
    out = bytearray(data)
    out[rng.integers(len(out))] ^= int(rng.integers(1, 256))
    return bytes(out)


def truncate(data: bytes, rng: Rng) -> bytes:
    return data[: rng.integers(len(data))]


def delete(data: bytes, rng: Rng) -> bytes:
    at = int(rng.integers(len(data)))
    return data[:at] + data[at + 1 :]


def insert(data: bytes, rng: Rng) -> bytes:
    at = int(rng.integers(len(data)))
    return data[:at] + rng.bytes(1) + data[at:]


def burst(data: bytes, rng: Rng) -> bytes:
    at = int(rng.integers(len(data)))
    return data[:at] + rng.bytes(min(512, len(data) - at)) + data[at + 512 :]


def zero_block(data: bytes, rng: Rng) -> bytes:
    at = 4096 * int(rng.integers(len(data) // 4096))
    return data[:at] + bytes(4096) + data[at + 4096 :]


def swap_blocks(data: bytes, rng: Rng) -> bytes:
    a, b = sorted(int(x) for x in 4096 * rng.choice(len(data) // 4096, 2, replace=False))
    return (
        data[:a] + data[b : b + 4096] + data[a + 4096 : b] + data[a : a + 4096] + data[b + 4096 :]
    )


def tail(data: bytes, rng: Rng) -> bytes:
    return data + rng.bytes(int(rng.integers(1, 5000)))


FAULTS: dict[str, Fault] = {
    "one byte changed": change,
    "truncated": truncate,
    "one byte deleted": delete,
    "512 bytes overwritten": burst,
    "one byte inserted": insert,
    "4 KiB zeroed": zero_block,
    "two 4 KiB blocks swapped": swap_blocks,
    "bytes after the end": tail,
}


def recording() -> hapfmt.Recording:
    """Two channels at 8 kHz for a minute, on different textures."""
    parts = [simulate(t, SECONDS, seed, RATE).channels[0] for t, seed in (("sand", 1), ("cork", 2))]
    return hapfmt.Recording(tuple(parts))


def compare(clean: hapfmt.Recording, data: bytes) -> tuple[int, int, bool]:
    """Samples delivered right, delivered wrong, and whether anything was reported."""
    try:
        with hapfmt.Reader(data) as reader:
            back = reader.read()
            reported = bool(reader.findings)
    except hapfmt.HapfmtError:
        return 0, 0, True
    right = wrong = 0
    clean_by_label = {channel.label: channel for channel in clean.channels}
    for place, channel in enumerate(back.channels):
        original = clean_by_label.get(channel.label, clean.channels[place])
        for start, values in channel.segments():
            truth = original.values[start : start + values.size]
            same = int((values[: truth.size] == truth).sum())
            right += same
            wrong += values.size - same
    return right, wrong, reported


def main() -> None:
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    print_origin()
    original = recording()
    labelled = hapfmt.Recording(
        tuple(
            hapfmt.Channel(c.values, c.rate, c.coverage, c.calibration, f"force {i}", c.unit)
            for i, c in enumerate(original.channels)
        )
    )
    stream = io.BytesIO()
    hapfmt.write(labelled, stream, hapfmt.Settings.of("default", cluster=CLUSTER), canonical=1)
    data = stream.getvalue()
    clean = hapfmt.read(data)
    total = clean.sample_count
    print(f"{SECONDS:.0f} s, 2 channels at {RATE} Hz, clusters of {float(CLUSTER)} s, "
          f"{len(data)} bytes, {trials} trials of each kind\n")  # fmt: skip
    rows = []
    for name, fault in FAULTS.items():
        rng = np.random.default_rng(7)
        shares, wrong, silent, unreported = [], 0, 0, 0
        for _ in range(trials):
            broken = fault(data, rng)
            if broken == data:
                continue
            good, bad, reported = compare(clean, broken)
            shares.append(good / total)
            wrong += bad
            silent += bad if not reported else 0
            unreported += not reported
        rows.append(
            [name, len(shares), wrong, silent, unreported, f"{100 * np.mean(shares):.2f}",
             f"{100 * np.min(shares):.2f}"]
        )  # fmt: skip
    headers = ["fault", "trials", "wrong samples", "of them silent", "faults not reported",
               "recovered %", "worst %"]  # fmt: skip
    print_table(headers, rows)


if __name__ == "__main__":
    main()
