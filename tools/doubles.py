"""The original doubles of every recording beside the repository: preset archive, and pcodec.

python tools/doubles.py [PART_OF_NAME]

pcodec, where it is installed, at level 12 on each whole channel, 4 bytes added for each.
"""

from __future__ import annotations

import io
import sys
from math import exp, log

import numpy as np
from measured import DATA, best_of, print_origin, print_table, recordings

import hapfmt
from hapfmt.container.source import BytesSource
from hapfmt.usage import measure


def pcodec_size(recording: hapfmt.Recording) -> int | None:
    try:
        from pcodec import ChunkConfig, standalone
    except ImportError:
        return None
    best = ChunkConfig(compression_level=12)
    columns = (np.ascontiguousarray(c.samples()) for c in recording.channels)
    return sum(4 + len(standalone.simple_compress(x, best)) for x in columns)


def written(recording: hapfmt.Recording) -> bytes:
    stream = io.BytesIO()
    hapfmt.write(recording, stream, hapfmt.Settings.of("archive"), canonical=1)
    return stream.getvalue()


def main() -> None:
    part = sys.argv[1] if len(sys.argv) > 1 else ""
    print_origin()
    print("b/s: bits a sample. speeds in Ms/s of CPU time.\n")
    rows, ratios = [], []
    for path in recordings():
        if part not in str(path):
            continue
        recording = hapfmt.load(path)
        n = recording.sample_count
        data = written(recording)
        back = hapfmt.read(data)
        same = [
            np.array_equal(a.samples().view(np.int64), b.samples().view(np.int64))
            for a, b in zip(recording.channels, back.channels, strict=True)
        ]
        usage, peer = measure(BytesSource(data)), pcodec_size(recording)
        exact = usage.causes["exact values"]
        sizes = (peer, usage.payload - exact, exact, usage.payload, usage.file)
        shown = ["-" if size is None else f"{8 * size / n:.3f}" for size in sizes]
        if peer:
            ratios.append((usage.payload / peer, usage.file / peer))
            shown += [f"{ratio:.3f}" for ratio in ratios[-1]]
        rows.append([
            str(path.relative_to(DATA))[:44], *shown,
            f"{n / best_of(lambda r=recording: written(r), 1) / 1e6:.2f}",
            f"{n / best_of(lambda d=data: hapfmt.read(d), 3) / 1e6:.1f}",
            "identical" if all(same) else f"{len(same) - sum(same)} differ",
        ])  # fmt: skip
    headers = ["recording", "pcodec 12 b/s", "counts b/s", "exact values b/s", "payload b/s",
               "file b/s", *(["payload / pcodec", "file / pcodec"] if ratios else []),
               "encode", "decode", "doubles"]  # fmt: skip
    print_table(headers, rows)
    if ratios:
        means = [exp(sum(map(log, column)) / len(column)) for column in zip(*ratios, strict=True)]
        print(f"\ngeometric means: payload {means[0]:.3f}, file {means[1]:.3f}")


if __name__ == "__main__":
    main()
