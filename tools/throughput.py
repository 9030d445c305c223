"""Speed of each codec alone, compared with FLAC in the same run; and start-up times.

python tools/throughput.py [--quick]      whole files: tools/bench.py

--quick: few samples and one start of each program, to see that it runs.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import installed  # noqa: F401

import numpy as np
from measured import best_of, print_origin, print_table
from peers.exact import flac_decode, flac_encode

import hapfmt
from hapfmt.codecs import exact, knots, noise, predicted, quantised
from hapfmt.codecs.knots import KnotParameters, build_knots
from hapfmt.codecs.predicted import decode_indices
from hapfmt.codecs.quantised import encode_quantised, quantise
from hapfmt.codecs.raw import RawParameters, decode_raw, encode_raw
from hapfmt.deadband import Deadband
from hapfmt.encoder import predict
from hapfmt.encoder.knots import select_knots
from hapfmt.encoder.predict import encode_best
from hapfmt.encoder.source import InputBlock
from hapfmt.encoder.synthetic import code_texture
from hapfmt.encoder.unit import choose_codebook, whole_range
from hapfmt.format.track import Affine
from hapfmt.lab.scenes.stylus import simulate
from hapfmt.limits import LEVELS
from hapfmt.recording import Calibration, Channel, Span
from hapfmt.split import low_pass

LEVEL = LEVELS[2]
RANGE = -(2**31), 2**31 - 1
SAMPLES = 480_000
DOUBLES = 1 << 16
TWIN_SAMPLES = 20_000
"""Samples for the loops that take microseconds a sample."""
QUICK = 64
"""--quick: a share of the samples."""


def codecs(counts: np.ndarray, rate: float) -> list[list[object]]:
    """Each codec alone on one packet of counts [samples, 1]."""
    n = len(counts)
    slow = np.floor(low_pass(counts.astype(float), rate) + 0.5).astype(np.int64)
    band = Deadband(1, 10, (20,), (0,))
    rows = []
    for mode in ("hold", "linear"):
        parameters = KnotParameters(mode)
        ticks = select_knots(slow, band, keep_last=True)
        data = build_knots(ticks, slow[ticks])
        rows.append(
            [f"knots, {mode}", f"{8 * len(data) / n:.3f}",
             speed(n, lambda: build_knots(t := select_knots(slow, band, keep_last=True), slow[t])),
             speed(n, lambda d=data, p=parameters: knots.decode_within(
                 d, p, n, 1, LEVEL, 0, *RANGE))]
        )  # fmt: skip
    for step in (2, 31):
        levels = quantise(counts - slow, step)
        book = choose_codebook([levels], step)
        data = encode_quantised(levels, book)
        rows.append(
            [f"quantised, step {step}", f"{8 * len(data) / n:.3f}",
             speed(n, lambda v=levels, b=book: encode_quantised(v, b)),
             speed(n, lambda d=data, b=book: quantised.decode_within(d, b, n, 1, LEVEL, 0, *RANGE))]
        )  # fmt: skip
    for size in (2,):
        data = encode_raw(counts, size)
        rows.append(
            [f"raw, {size} bytes", f"{8 * len(data) / n:.3f}",
             speed(n, lambda s=size: encode_raw(counts, s)),
             speed(n, lambda d=data, s=size: decode_raw(d, RawParameters(s), "counts", n, 1, 0))]
        )  # fmt: skip
    return rows


def predictions(counts: np.ndarray, twin_samples: int) -> list[list[object]]:
    """LPCR, lossless: the compiled loops, where they are built, and their readable twins."""
    rows = []
    built = predicted.compiled
    for name, kernel, n in (("compiled", built, len(counts)), ("readable", None, twin_samples)):
        if name == "compiled" and not built:
            continue
        predicted.compiled = predict.compiled = kernel
        x = np.ascontiguousarray(counts[:n, 0])
        data = encode_best(x)
        predictor, _, _ = predicted.parse_header(data, 0)
        rows.append(
            [f"predicted, {name}", f"{8 * len(data) / n:.3f}",
             speed(n, lambda v=x, p=predictor: predicted.encode_indices(v, p), 3),
             speed(n, lambda d=data, m=n: decode_indices(d, m, LEVEL.count_bound, 0), 3)]
        )  # fmt: skip
    predicted.compiled = predict.compiled = built
    return rows


def doubles(samples: int, twin_samples: int) -> list[list[object]]:
    """LPCX: the exact values of noise in addition to its counts, both loops as above."""
    rows = []
    built = exact.compiled
    for name, kernel, n in (("compiled", built, samples), ("readable", None, twin_samples)):
        if name == "compiled" and not built:
            continue
        exact.compiled = kernel
        x = np.random.default_rng(1).normal(size=n)
        counts, affine = np.rint(x * 2**20).astype(np.int64), Affine(1, 0, 1 << 20)
        for recall in (False, True):

            def encode(x=x, counts=counts, affine=affine, recall=recall) -> bytes:
                return exact.encode_exact(x, exact.ExactParameters(), affine, counts, recall=recall)

            data = b"\0" + encode()
            rows.append(
                [f"exact values, {'recall, ' if recall else ''}{name}", f"{8 * len(data) / n:.3f}",
                 speed(n, encode, 3),
                 speed(n, lambda d=data, c=counts, a=affine: exact.decode_exact(
                     d, [exact.ExactParameters()], [a], c[:, None], 0), 3)]
            )  # fmt: skip
    exact.compiled = built
    return rows


def models(counts: np.ndarray, rate: float, twin_samples: int) -> list[list[object]]:
    """NOIS with some orders, both loops as above. Encoding finds the model of the texture."""
    texture = counts[:, 0] - np.rint(low_pass(counts.astype(float), rate)[:, 0]).astype(np.int64)
    rows = []
    built = noise.compiled
    for order, kernel in ((8, built), (16, built), (32, built), (8, None)):
        if kernel is None and built is None and rows:
            continue
        noise.compiled = kernel
        n = twin_samples if kernel is None else len(texture)
        channel = Channel(texture[:n], int(rate), calibration=Calibration(1, 0, 1))
        source = InputBlock((channel,), texture[:n, None], (Span(0, n),))
        given = source, texture[:n], 0.0, whole_range(source, 0), order
        coded = code_texture(*given)
        parameters = noise.NoiseParameters.parse(coded.track.parameters, 0)
        data = coded.packets[0].data
        rows.append(
            [f"model of order {order}, {'compiled' if kernel else 'readable'}",
             f"{8 * len(data) / n:.3f}", speed(n, lambda g=given: code_texture(*g), 3),
             speed(n, lambda d=data, m=n, p=parameters: noise.decode_within(
                 d, p, m, 1, 0, *RANGE), 3)]
        )  # fmt: skip
    noise.compiled = built
    return rows


def flac(counts: np.ndarray, rate: int) -> list[object]:
    """flac at its highest level through soundfile."""
    data, n = flac_encode(counts[:, 0], rate), len(counts)
    encode = speed(n, lambda: flac_encode(counts[:, 0], rate))
    decode = speed(n, lambda: flac_decode(data, n))
    return ["flac -8 (lossless)", f"{8 * len(data) / n:.3f}", encode, decode]


def speed(samples: int, work: object, repeats: int = 5) -> str:
    rate = samples / 1e6 / best_of(work, repeats)
    return f"{rate:.1f}" if rate >= 1 else f"{rate:.3f}"


def starts(path: str, repeats: int) -> list[list[object]]:
    """Wall time of whole processes, as the median of the repeats."""
    commands = {
        "python -c pass": ["-c", "pass"],
        "import numpy": ["-c", "import numpy"],
        "import hapfmt": ["-c", "import hapfmt"],
        "hapfmt --help": ["-m", "hapfmt", "--help"],
        "hapfmt info": ["-m", "hapfmt", "info", path],
        "hapfmt verify": ["-m", "hapfmt", "verify", path],
    }
    rows = []
    for name, arguments in commands.items():
        times = []
        for _ in range(repeats):
            began = time.perf_counter()
            subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
            times.append(time.perf_counter() - began)
        rows.append([name, f"{1000 * statistics.median(times):.0f}"])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true")
    share = QUICK if parser.parse_args().quick else 1
    samples, twin_samples = SAMPLES // share, TWIN_SAMPLES // share
    print_origin()
    recording = simulate("sand", samples / 8000, 1, 8000)
    counts = recording.channels[0].stored.astype(np.int64)[:, None]
    print(f"one channel, {samples} samples of a simulated texture at 8 kHz; million samples a "
          "second of CPU time\n")  # fmt: skip
    rows = [*codecs(counts, 8000.0), *predictions(counts, twin_samples),
            *doubles(DOUBLES // share, twin_samples), *models(counts, 8000.0, twin_samples),
            flac(counts, 8000)]  # fmt: skip
    print_table(["codec", "b/sample", "encode Ms/s", "decode Ms/s"], rows)
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "one.hapf")
        hapfmt.write(recording, path)
        print_table(["start", "ms"], starts(path, 7 if share == 1 else 1))


if __name__ == "__main__":
    main()
