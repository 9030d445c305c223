"""Bits that a texture needs at equal quality, for each codec. Prints Markdown.

python tools/texture_rates.py [DATA]        a folder of recordings; without: ../shared/data
python tools/texture_rates.py --quick       two seconds of a simulated texture

Each codec runs alone; other codecs that the encoder would try are left out. A search among steps of
2^(1/8) finds the two whose qualities enclose the wanted one, and the bits are interpolated between
them. The bits are those of all packets and tables of one channel, without chunks. Every quality is
that of decoded samples. A dash means that a codec does not reach the quality.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from math import exp, inf, log, log10, sqrt
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from installed import ROOT

import click
import numpy as np
from measured import DATA, files_in, print_origin, print_table
from numpy.typing import NDArray

import hapfmt
from hapfmt import metrics
from hapfmt.codecs.predicted import decode_indices
from hapfmt.codecs.transform import UNIT, TransformParameters, decode_component
from hapfmt.deadband import COUNT_LIMIT
from hapfmt.encoder.bounded import code_lines
from hapfmt.encoder.plan import Promise
from hapfmt.encoder.predict import encode_best, fitting_packets
from hapfmt.encoder.settings import FORCE_WEBER, Tolerance
from hapfmt.encoder.source import InputBlock
from hapfmt.encoder.synthetic import code_texture
from hapfmt.encoder.transform import encode_row
from hapfmt.encoder.unit import ENCODE_LEVEL, bound_of, decode_all, whole_range
from hapfmt.format.track import Component
from hapfmt.lab.scenes import load_scene, simulate
from hapfmt.limits import LEVELS
from hapfmt.recording import Span
from hapfmt.split import low_pass

Samples = NDArray[np.float64]
Counts = NDArray[np.int64]

RECORDED = (
    ("biotac_slide/mat1_3_pac", "pac"),
    ("biotac_slide/mat17_3_pac", "pac"),
    ("texture_touch1k/T1_acc", "acc"),
    ("tum_vibro/1spike_polyesterPad_slow", "az"),
    ("teleop1dof/question1b_foam", "tau_human"),
    ("dropbear/set0_test0", "accel_lowg"),
    ("smartwheel/smartwheel", "Fx"),
)
"""Recordings and channels, of which the first SAMPLES count."""

SAMPLES = 24_000

SIGNALS = ROOT.parent / "shared" / "tools" / "mpeg_signals.py"
"""Writes three signals, 8 kHz and 11 s, on which MPEG's reference software was measured."""

MPEG: dict[str, dict[float, float | None]] = {
    "a_texture": {13.2: 5.8, 25.1: 11.7, 40.2: 24.8},
    "b_kinesthetic": {33.5: 2.3, 69.3: None},
    "c_mix": {23.6: 3.1, 30.9: 5.2, 43.8: 11.3},
}
"""SNR in dB of the whole signal, and the kbit/s of that software: its wavelet codec alone, with its
renderer repaired. At 69.3 dB it was not measured."""

SNR_DB = (10.0, 20.0, 30.0)
STEEP_DB = 20.0
ST_SIM, SPQI = 0.95, 0.5

PER_OCTAVE = 8
FINEST, COARSEST = -12 * PER_OCTAVE, 6 * PER_OCTAVE
"""The search for a step: around the standard deviation above 20 Hz."""

FINE = 32
"""Counts of a step: the slow part of the signal is stored that much finer."""

LONGEST = 1 << 16
"""Samples of a packet of prediction, as in a file."""

THRESHOLDS = ("0.2%", "1%", "2%", "5%", "10%", "20%")
"""Absolute thresholds of the deadband of the paper's slow part: shares of the range."""

LINES = ("0.2%", "2%", "20%")
"""The same for lines."""

BLOCKS = (32, 64, 128, 256, 512)
"""Coefficients of a block of MDCT."""

BANDS = 64
"""Bands of MDCT with a weight of their own."""

COUNT = 1 << 31
"""Counts have 32 bits."""

MODEL_LINES = "5%"
"""The same below a texture from a model."""

APART_S = 0.5
"""A texture is compared with itself, this much later."""

HAS_PACKAGE = find_spec("vibromaf") is not None
"""It computes ST-SIM and SPQI."""

RANGE_BITS = 24
"""A slow part is stored on a grid of this many bits for the range."""


class Texture(NamedTuple):
    name: str
    x: Samples
    rate_hz: float

    @property
    def level(self) -> float:
        return float((self.x - low_pass(self.x, self.rate_hz)).std())


class Coded(NamedTuple):
    """Bits a sample, and the decoded samples."""

    bits: float
    y: Samples


Way = Callable[[Texture, float], Coded]
"""Codes a texture with one step."""

Measure = Callable[[Texture, Samples], float]


def paper(threshold: str, texture: Texture, step: float) -> Coded:
    """Knots joined by lines, and a quantised residual with Huffman codes: preset paper with a step
    of its own. A step from the range of the residual costs more."""
    counts = counts_of(texture, step / FINE)
    channel = hapfmt.Channel(
        counts, texture.rate_hz, calibration=hapfmt.Calibration(1, 0, 1), unit="{count}"
    )
    settings = hapfmt.Settings.of("paper", step=FINE, floor=threshold, smallest=False)
    stream = io.BytesIO()
    recording = hapfmt.Recording((channel,))
    summary = hapfmt.write(recording, stream, settings, canonical=1, threads=1)
    (back,) = hapfmt.read(stream.getvalue()).channels
    return Coded(8 * summary.payload_size / counts.size, back.samples() * (step / FINE))


def lpcr(texture: Texture, step: float) -> Coded:
    """Prediction of the whole signal on a uniform grid."""
    indices = counts_of(texture, step)
    size, parts = 0, []
    for start in range(0, indices.size, LONGEST):
        part = indices[start : start + LONGEST]
        for span, data in fitting_packets(Span(0, part.size), part, partial(coded_part, part)):
            size += len(data)
            parts.append(decode_indices(data, span.ticks, COUNT_LIMIT, 0))
    return Coded(8 * size / indices.size, np.concatenate(parts) * step)


def coded_part(indices: Counts, rows: slice) -> bytes:
    return encode_best(indices[rows])


def mdct(size: int, gamma: float, texture: Texture, step: float) -> Coded:
    """The transform of the whole signal in blocks of this size. With gamma, the step of a band is
    multiplied by the threshold of vibration (of a displacement), relative to its minimum, to that
    power."""
    # Each quantiser has every other level; a coefficient adds to size samples by a cosine.
    own = round(UNIT * FINE / 2 * sqrt(2 / size))
    parameters = TransformParameters(size, own, weights_of(size, gamma, texture.rate_hz))
    x = texture.x / (step / FINE)
    packet_size, parts = 0, []
    for start in range(0, x.size, LONGEST):
        rows = np.rint(x[start : start + LONGEST])
        try:
            data = encode_row(rows, parameters)
        except ValueError:
            # The step is too fine for the codec.
            return Coded(inf, texture.x)
        packet_size += len(data)
        y = np.empty(rows.size, np.int32)
        decode_component(data, parameters, LEVELS[2], 0, -COUNT, COUNT - 1, y)
        parts.append(y)
    return Coded(8 * packet_size / x.size, np.concatenate(parts) * (step / FINE))


def weights_of(size: int, gamma: float, rate_hz: float) -> bytes:
    """32 times the factor on the step of each band; at most BANDS of them."""
    if not gamma:
        return b""
    bands = min(size, BANDS)
    hz = (np.arange(bands) + 0.5) * (rate_hz / (2 * bands))
    factors = (metrics.vibrotactile_threshold(hz) / metrics.LEAST_M) ** gamma
    return bytes(np.clip(np.rint(32 * factors), 1, 255).astype(np.uint8))


def split(threshold: str, rest: Way, texture: Texture, step: float) -> Coded:
    """The fewest lines within the deadband for the slow part, and another way for the rest."""
    bits, slow = slow_track(texture, threshold)
    fast = rest(texture._replace(x=texture.x - slow), step)
    return Coded(bits + fast.bits, slow + fast.y)


def nois(texture: Texture, order: int | None = None) -> tuple[Coded, int]:
    """The part above 20 Hz from a model, and the order of the model. Any loud interval is coded.

    order: None, the one that the encoder takes.
    """
    step = texture.level / FINE
    fast = texture.x - low_pass(texture.x, texture.rate_hz)
    counts = counts_of(texture._replace(x=fast), step)
    channel = hapfmt.Channel(counts, texture.rate_hz, calibration=hapfmt.Calibration(1, 0, 1))
    source = InputBlock((channel,), counts[:, None], (Span(0, counts.size),))
    widest = 1 << (ENCODE_LEVEL.residual_bits - 1)
    track = replace(
        whole_range(source, 0), kind="hf", base=0, components=(Component(),), count_min=-widest,
        count_max=widest - 1,
    )  # fmt: skip
    coded = code_texture(source, counts, 0.0, track, order)
    first = coded.packets[0].data
    y = decode_all(coded, 1)[:, 0] * step
    return Coded(8 * coded.size / counts.size, y), first[0] if first else 0


SLOW: dict[tuple[str, str], tuple[float, Samples]] = {}


def slow_track(texture: Texture, threshold: str) -> tuple[float, Samples]:
    """Bits a sample of the lines, and the decoded slow part."""
    key = texture.name, threshold
    if key not in SLOW:
        count = float(np.ptp(texture.x)) / (1 << RANGE_BITS)
        slow = np.rint(low_pass(texture.x, texture.rate_hz) / count).astype(np.int64)
        channel = hapfmt.Channel(slow, texture.rate_hz, calibration=hapfmt.Calibration(1, 0, 1))
        source = InputBlock((channel,), slow[:, None], (Span(0, slow.size),))
        promise = Promise(Tolerance.parse(threshold), FORCE_WEBER)
        track = whole_range(source, 0)
        lines = code_lines(source, track, bound_of(source, promise), None)
        assert lines is not None
        SLOW[key] = 8 * lines.size / slow.size, decode_all(lines, 1)[:, 0] * count
    return SLOW[key]


def counts_of(texture: Texture, step: float) -> Counts:
    return np.rint(texture.x / step).astype(np.int64)


PAPER = tuple(partial(paper, threshold) for threshold in THRESHOLDS)
MDCT, QUARTER, HALF = (
    tuple(partial(mdct, size, gamma) for size in BLOCKS) for gamma in (0.0, 0.25, 0.5)
)
CODECS: dict[str, tuple[Way, ...]] = {
    "paper": PAPER,
    "LPCR": (lpcr,),
    "MDCT": MDCT,
    "LPCR or MDCT": (lpcr, *MDCT),
    "lines + LPCR": tuple(partial(split, threshold, lpcr) for threshold in LINES),
    "lines + MDCT": tuple(partial(split, threshold, way) for threshold in LINES for way in MDCT),
    "MDCT, 1/4": QUARTER,
    "MDCT, 1/2": HALF,
}
"""The ways of each codec. The one with the fewest bits counts, at each quality. The last two weigh
the bands of the transform by a power of the threshold of vibration."""


def snr_hf(texture: Texture, y: Samples) -> float:
    return metrics.snr_hf_db(texture.x, y, texture.rate_hz)


def snr_steep(texture: Texture, y: Samples) -> float:
    """The part above 20 Hz by a Butterworth filter of order 2, forward and backward: it holds more
    of what is just above 20 Hz."""
    from scipy import signal

    sections = signal.butter(2, metrics.SPLIT_HZ, fs=texture.rate_hz, output="sos")
    fast = texture.x - signal.sosfiltfilt(sections, texture.x)
    return 10 * log10(fast.var() / ((texture.x - y) ** 2).mean())


def snr(texture: Texture, y: Samples) -> float:
    return metrics.snr_db(texture.x, y)


def st_sim(texture: Texture, y: Samples) -> float:
    return metrics.st_sim(texture.x, y, texture.rate_hz)


def spqi(texture: Texture, y: Samples) -> float:
    return metrics.spqi(texture.x, y, texture.rate_hz)


class Curve:
    """Bits and qualities of one way, by step; each step is coded once."""

    def __init__(self, way: Way, texture: Texture) -> None:
        self.way, self.texture, self.level = way, texture, texture.level
        self.coded: dict[int, Coded] = {}
        self.measured: dict[tuple[Measure, int], float] = {}

    def at(self, place: int) -> Coded:
        if place not in self.coded:
            step = self.level * 2 ** (place / PER_OCTAVE)
            self.coded[place] = self.way(self.texture, step)
        return self.coded[place]

    def quality(self, measure: Measure, place: int) -> float:
        key = measure, place
        if key not in self.measured:
            self.measured[key] = measure(self.texture, self.at(place).y)
        return self.measured[key]

    def bits(self, measure: Measure, wanted: float) -> float:
        """Bits a sample at a quality; infinity where no step reaches it."""
        low, high = FINEST, COARSEST
        while high - low > 1:
            middle = (low + high) // 2
            if self.quality(measure, middle) >= wanted:
                low = middle
            else:
                high = middle
        if low == FINEST:
            return inf
        if high == COARSEST:
            return self.at(low).bits
        above, below = (self.quality(measure, place) for place in (low, high))
        share = (above - wanted) / (above - below) if above < inf else 1.0
        return self.at(low).bits + share * (self.at(high).bits - self.at(low).bits)


class Curves(NamedTuple):
    """All ways of all codecs, for one texture."""

    texture: Texture
    of: dict[str, list[Curve]]

    def bits(self, codec: str, measure: Measure, wanted: float) -> float:
        return min(curve.bits(measure, wanted) for curve in self.of[codec])


def curves_of(texture: Texture, codecs: Sequence[str]) -> Curves:
    """A way that several codecs try is coded once."""
    ways = {way: Curve(way, texture) for name in codecs for way in CODECS[name]}
    return Curves(texture, {name: [ways[way] for way in CODECS[name]] for name in codecs})


def recorded(data: Path, samples: int) -> Iterator[Texture]:
    paths = {path.relative_to(data).with_suffix("").as_posix(): path for path in files_in(data)}
    for place, label in RECORDED:
        found = next((path for name, path in paths.items() if name.endswith(place)), None)
        if found is None:
            print(f"Not there: {place}\n")
            continue
        channel = hapfmt.read(found)[label]
        x = channel.samples()[:samples]
        yield Texture(f"{place.partition('/')[2]} {label}", x, channel.rate)


def simulated(seconds: float) -> Iterator[Texture]:
    recording, _ = simulate(load_scene("sand").changed(seconds=seconds))
    channel = recording.channels[0]
    yield Texture("simulated sand", channel.samples(), channel.rate)


def generated() -> Iterator[Texture]:
    if not SIGNALS.exists():
        print(f"Not there: {SIGNALS.name}\n")
        return
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, str(SIGNALS), folder]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
        for name in MPEG:
            (channel,) = hapfmt.read(Path(folder) / f"{name}.npz").channels
            yield Texture(name, channel.samples(), channel.rate)


def geometric_mean(values: Sequence[float]) -> float:
    return exp(fmean(map(log, values)))


def shown(bits: float, digits: int = 2) -> str:
    return f"{bits:.{digits}f}" if 0 < bits < inf else "-"


def print_qualities(title: str, every: Sequence[Curves], measure: Measure, wanted: float) -> None:
    """One row for each texture; below, the geometric mean and its ratio to that of the first."""
    if not every:
        return
    codecs = list(every[0].of)
    table = [[curves.bits(codec, measure, wanted) for codec in codecs] for curves in every]
    means = [geometric_mean(column) for column in zip(*table, strict=True)]
    names = [curves.texture.name for curves in every]
    rows = [[name, *map(shown, row)] for name, row in zip(names, table, strict=True)]
    rows.append(["geometric mean", *map(shown, means)])
    rows.append([f"ratio to {codecs[0]}", *(shown(mean / means[0]) for mean in means)])
    print(f"## {title}\n")
    print_table(["bits a sample", *codecs], rows)


def print_signals(every: Sequence[Curves]) -> None:
    if not every:
        return
    codecs = list(every[0].of)
    rows = []
    for curves in every:
        for wanted, theirs in MPEG[curves.texture.name].items():
            kbit = curves.texture.rate_hz / 1000
            ours = [shown(kbit * curves.bits(codec, snr, wanted), 1) for codec in codecs]
            peer = f"{theirs:.1f}" if theirs else "-"
            rows.append([curves.texture.name, f"{wanted:.1f}", peer, *ours])
    print("## Three signals of 8 kHz, kbit/s at the SNR of the whole signal\n")
    print_table(["signal", "SNR dB", "MPEG", *codecs], rows)


def print_models(every: Sequence[Curves]) -> None:
    """Lines and NOIS. A model has no step, and its noise is another one than the recorded one."""
    if not every:
        return
    rows = []
    for curves in every:
        texture = curves.texture
        lines, slow = slow_track(texture, MODEL_LINES)
        fast, order = nois(texture)
        y = slow + fast.y
        later = round(APART_S * texture.rate_hz)
        own = metrics.band_energy_error_db(texture.x[:-later], texture.x[later:], texture.rate_hz)
        error = metrics.band_energy_error_db(texture.x, y, texture.rate_hz)
        similar = [f"{each(texture, y):.3f}" for each in (st_sim, spqi)] if HAS_PACKAGE else []
        rate = fast.bits * texture.rate_hz
        rows.append(
            [
                *(texture.name, order, shown(lines + fast.bits), shown(fast.bits, 3)),
                *(f"{rate:.0f}", f"{error:.2f}", f"{own:.2f}", f"{snr_hf(texture, y):.1f}"),
                *similar,
            ]
        )
    print(f"## Texture from a model, over lines of {MODEL_LINES}\n")
    headers = ["texture", "order", "bits a sample", "of it NOIS", "NOIS bit/s", "band error dB"]
    headers += [f"itself {APART_S:g} s later", "SNR dB", *["ST-SIM", "SPQI"] * HAS_PACKAGE]
    print_table(headers, rows)


@click.command(help=__doc__)
@click.argument("data", type=click.Path(exists=True, path_type=Path), required=False)
@click.option("--quick", is_flag=True, help="Two seconds of a simulated texture.")
@click.option(
    "--codec", "codecs", multiple=True, type=click.Choice(list(CODECS)), help="Only these. [all]"
)
@click.option("--samples", type=click.IntRange(1000), default=SAMPLES, show_default=True)
def main(data: Path | None, quick: bool, codecs: tuple[str, ...], samples: int) -> None:
    chosen = codecs or tuple(CODECS)
    print("# Rate of textures\n")
    print_origin()
    if data is None and DATA.exists():
        data = DATA
    textures = simulated(2.0) if quick or data is None else recorded(data, samples)
    every = [curves_of(texture, chosen) for texture in textures]
    for wanted in SNR_DB:
        print_qualities(f"SNR above 20 Hz: {wanted:g} dB", every, snr_hf, wanted)
    steep = f"SNR above 20 Hz by a steeper filter: {STEEP_DB:g} dB"
    print_qualities(steep, every, snr_steep, STEEP_DB)
    if HAS_PACKAGE:
        print_qualities(f"ST-SIM {ST_SIM:g}", every, st_sim, ST_SIM)
        print_qualities(f"SPQI {SPQI:g}", every, spqi, SPQI)
    else:
        print("ST-SIM and SPQI need: pip install 'hapfmt[metrics]'\n")
    print_models(every)
    if not quick:
        print_signals([curves_of(texture, chosen) for texture in generated()])


if __name__ == "__main__":
    main()
