"""The paper's method with one thing changed at a time, on one session: what each choice costs."""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import hapfmt
from hapfmt.codecs.knots import parse_knots
from hapfmt.codecs.quantised import QuanParameters
from hapfmt.encoder.settings import Tolerance
from hapfmt.lab.scenes import load_scene, simulate
from hapfmt.limits import LEVELS
from hapfmt.metrics import snr_hf_db
from hapfmt.reading.reader import Reader
from hapfmt.split import low_pass
from report.ratio import SAMPLE_SIZE, Source, measure, settings

HEADERS = (
    "change", "payload, % of doubles", "residual, bits per sample", "HF SNR, dB",
    "outside of the deadband, %", "largest error, deadbands", "remark",
)  # fmt: skip


class Parts(NamedTuple):
    """A coded channel taken apart: physical values [ticks], ticks of the knots, the step of the
    residual in its unit (0 without one), and bytes of the packets of each track."""

    slow: NDArray[np.float64]
    whole: NDArray[np.float64]
    knots: NDArray[np.int64]
    step: float
    slow_size: int
    fast_size: int


class Changed(NamedTuple):
    name: str
    payload_percent: float
    fast_bits: float | None
    snr_db: float
    outside_percent: float
    largest: float
    note: str


def parts_of(file: bytes) -> Parts:
    """Parts of the first channel of a file of preset paper."""
    with Reader(file) as reader:
        whole = reader.read().channels[0]
        slow = reader.read(band="lf").channels[0]
        base = reader.channels[0]
        sizes, knots = [0, 0], []
        for packet in reader.packets({base.track.id: (0, 1 << 62)}):
            knots.append(parse_knots(packet.data, 1, packet.offset)[0] + packet.start)
            sizes[0] += len(packet.data)
        step = 0.0
        if base.residual is not None and whole.calibration is not None:
            given = QuanParameters.parse(base.residual.parameters, LEVELS[2], 0)
            step = given.step * float(abs(whole.calibration.step))
            packets = reader.packets({base.residual.id: (0, 1 << 62)})
            sizes[1] = sum(len(packet.data) for packet in packets)
        return Parts(slow.samples(), whole.samples(), np.concatenate(knots), step, *sizes)


def plain_huffman_bits(levels: NDArray[np.int64]) -> int:
    """Bits of the levels with one code word each, the best such code; no runs, no table."""
    heap = list(Counter(levels.tolist()).values())
    if len(heap) == 1:
        return heap[0]
    heapq.heapify(heap)
    bits = 0
    while len(heap) > 1:
        both = heapq.heappop(heap) + heapq.heappop(heap)
        bits += both
        heapq.heappush(heap, both)
    return bits


def leaves(
    f: NDArray[np.float64], y: NDArray[np.float64], k: float, floor: float
) -> tuple[float, float]:
    """Share of the samples outside of the deadband in %, and the largest error in deadbands."""
    error = np.abs(y - f) / np.maximum(k * np.abs(f), floor)
    return 100 * float(np.mean(error > 1 + 1e-9)), float(error.max())


def with_tap(source: Source) -> Source:
    """The same session, after one tap on wood of the scene "taps"."""
    (channel,) = source.recording.channels
    (tap,) = simulate(load_scene("taps").changed(seconds=0.5))[0].channels
    if tap.calibration != channel.calibration:
        raise ValueError("the tap and the session are read by different sensors")
    longer = replace(channel, stored=np.concatenate([tap.stored, channel.stored]), coverage=())
    recording = replace(source.recording, channels=(longer,))
    return source._replace(name=f"{source.name}, after a tap", recording=recording)


def variants(source: Source, percent: float, bits: int) -> list[Changed]:
    """The first is the paper's own way. source: of one channel, in newtons; bits: 2 or more."""
    k, floor = percent / 100, float(source.floor)
    (channel,) = source.recording.channels
    f, rate = channel.samples(), channel.rate
    found: list[Changed] = []

    def add(
        name: str, payload: float, fast: float | None, y: NDArray[np.float64], note: str,
    ) -> None:  # fmt: skip
        """payload in bytes, fast in bits. Only the end of y is compared: the start is not f."""
        doubles = SAMPLE_SIZE * y.size
        bits_each = None if fast is None else fast / y.size
        session = y[y.size - f.size :]
        measured = snr_hf_db(f, session, rate), *leaves(f, session, k, floor)
        found.append(Changed(name, 100 * payload / doubles, bits_each, *measured, note))

    def by(name: str, chosen: hapfmt.Settings, note: str, of: Source = source) -> Parts:
        point = measure(of, chosen)
        parts = parts_of(point.file)
        add(name, point.payload_size, 8 * parts.fast_size, parts.whole, note)
        return parts

    usual = settings(percent, bits, source.floor)
    paper = by("none: preset `paper`", usual, "residual f - d, d as decoded; step from the range")

    levels = np.floor((f - paper.slow) / paper.step + 0.5).astype(np.int64)
    plain = plain_huffman_bits(levels)
    add("no runs of zeros", paper.slow_size + plain / 8, plain, paper.whole,
        "one code word a sample costs a bit at least")  # fmt: skip
    fixed = bits * f.size
    add(f"no entropy coding: {bits} bits a sample", paper.slow_size + fixed / 8, fixed,
        paper.whole, f"{bits}/64 of the doubles, whatever the signal")  # fmt: skip

    fast = f - low_pass(f, rate)
    step = float(np.max(np.abs(fast))) / (2 ** (bits - 1) - 1)
    opened = np.floor(fast / step + 0.5)
    cost = plain_huffman_bits(opened.astype(np.int64))
    add("open loop: residual f - l, no zero runs", paper.slow_size + cost / 8, cost,
        paper.slow + opened * step, "the error of the slow part remains")  # fmt: skip

    by("no floor: Weber's law down to 0", replace(usual, floor=Tolerance.parse("1lsb")),
       "as the force fades every count becomes a knot")  # fmt: skip
    by("one tap before the session", usual,
       "one large residual sets the step of all", with_tap(source))  # fmt: skip

    for name, chosen, note in (
        ("this format's preset `perceptual`, same deadband",
         hapfmt.Settings.of("perceptual", k=usual.k, floor=usual.floor),
         "the texture to 20 dB, coded for size"),
        ("this format's preset `near-lossless`, half that step",
         hapfmt.Settings.of(
             "near-lossless", max_error=Tolerance(paper.step / 2), force_error=True
         ),
         "prediction instead of split and knots"),
    ):  # fmt: skip
        point = measure(source, chosen)
        y = hapfmt.read(point.file).channels[0].samples()
        add(name, point.payload_size, None, y, note)
    return found
