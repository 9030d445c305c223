"""Bits a sample and error of every recording beside the repository, through encode, verify, decode.

python tools/recordings.py [PART_OF_NAME]
"""

from __future__ import annotations

import io
import sys

import numpy as np
from measured import DATA, print_origin, print_table, recordings

import hapfmt
from hapfmt.encoder.tolerance import Tolerance

TOLERANCE = Tolerance(1e-4, "range")
LOSSLESS = Tolerance(1.0, "lsb")


def encode(recording: hapfmt.Recording, **given: object) -> tuple[bytes, tuple[object, ...]]:
    stream = io.BytesIO()
    summary = hapfmt.write(recording, stream, hapfmt.Settings.of("default", **given), canonical=1)
    return stream.getvalue(), summary.decisions


def main() -> None:
    part = sys.argv[1] if len(sys.argv) > 1 else ""
    print_origin()
    print(
        "default: --preset default. tolerant: with --tolerance 0.01%. step 1: --step 1lsb. b/s: "
        "bits a sample\nof the whole file. outside: samples beyond the deadband. largest: error in "
        "% of the channel's range.\n"
    )
    rows = []
    for path in recordings():
        if part not in str(path):
            continue
        recording = hapfmt.load(path)
        samples = recording.sample_count
        plain, decisions = encode(recording)
        report = hapfmt.verify(plain, against=recording)
        loose, _ = encode(recording, tolerance=TOLERANCE)
        loose_report = hapfmt.verify(loose, against=recording)
        ones, _ = encode(recording, step=LOSSLESS)
        back = hapfmt.read(ones)
        same = [
            np.array_equal(a.physical().view(np.int64), b.physical().view(np.int64))
            for a, b in zip(recording.channels, back.channels, strict=True)
        ]
        raw = sum(not d.lattice.startswith(("exact", "already")) for d in decisions)
        rows.append(
            [
                str(path.relative_to(DATA))[:44],
                len(recording),
                len(recording) - raw,
                f"{8 * len(plain) / samples:.3f}",
                report.verdict,
                sum(c.outside for c in report.contracts),
                f"{largest(recording, report):.3f}",
                f"{8 * len(loose) / samples:.3f}",
                sum(c.outside for c in loose_report.contracts),
                f"{largest(recording, loose_report):.3f}",
                f"{8 * len(ones) / samples:.3f}",
                "identical" if all(same) else f"{len(same) - sum(same)} differ",
            ]
        )
    headers = ["recording", "channels", "counts", "default b/s", "verdict", "outside", "largest %",
               "tolerant b/s", "outside", "largest %", "step 1 b/s", "array"]  # fmt: skip
    print_table(headers, rows)


def largest(recording: hapfmt.Recording, report: object) -> float:
    """Largest error of any channel in % of that channel's range."""
    worst = 0.0
    for channel, check in zip(recording.channels, report.contracts, strict=True):
        x = channel.physical()
        extent = float(x.max() - x.min()) if x.size else 0.0
        if extent:
            worst = max(worst, 100 * check.largest_error / extent)
    return worst


if __name__ == "__main__":
    main()
