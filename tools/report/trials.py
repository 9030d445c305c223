"""One recording through one coder at one setting: bytes, errors, and times with their spread."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from peers.exact import Coder, double_coders, integer_coders
from peers.packages import installed
from peers.relative import ROUNDING, SAFE, Recipe, outside, quantised, recipes, sz3
from peers.zipped import coded_size

import hapfmt
from hapfmt.encoder.plan import felt_channels
from hapfmt.encoder.settings import ALL, Tolerance
from hapfmt.metrics import band_energy_error_db, max_error, rmse, snr_hf_db, st_sim
from report.section import Spread, timed
from report.subjects import Subject

FLOOR = 0.002
"""Absolute threshold as a share of each channel's range, as in the presets."""

REPEATS = 3

PEER_K, PEER_ERROR = 0.1, 1e-3
"""Where peers are measured: the Weber fraction, and the share of the range."""

PAPER_BITS = (0, 2, 5, 8)

SIMILAR_HZ, SIMILAR_CHANNELS, SIMILAR_S = 400, 4, 10
"""ST-SIM takes a second of CPU time for ten seconds of signal. So it is computed for channels of at
least this rate, of which the first four of a recording, and for the first ten seconds."""
Bound = Callable[[Sequence[NDArray[Any]], Sequence[NDArray[Any]]], int]


class Setting(NamedTuple):
    """family: the preset, or "peer"; "deadband" is preset perceptual with --no-texture and --felt
    all. task: the promise, by which settings are compared."""

    family: str
    name: str
    task: str
    settings: hapfmt.Settings


class Trial(NamedTuple):
    """Bits a sample of packets and of the whole file (a peer: of its blobs and 4 bytes a channel).
    Errors in % of each channel's range: rms, and the largest of all channels; SNR of the texture
    and error of band energies in dB, ST-SIM. Medians of the channels, but for the largest. outside:
    samples beyond the promise, None where there is none. failed: why there are no figures."""

    subject: str
    simulated: bool
    family: str
    setting: str
    task: str
    channels: int
    samples: int
    coded_bits: float | None = None
    file_bits: float | None = None
    rms_percent: float | None = None
    largest_percent: float | None = None
    snr_hf_db: float | None = None
    band_db: float | None = None
    st_sim: float | None = None
    outside: int | None = None
    encode: Spread | None = None
    decode: Spread | None = None
    failed: str = ""

    @property
    def label(self) -> str:
        return f"{self.family} {self.setting}".strip()

    @property
    def ours(self) -> bool:
        return self.family != "peer"

    def microseconds(self, spread: Spread | None) -> float | None:
        """A sample."""
        return spread and 1e6 * spread.median / self.samples


def settings(quick: bool) -> list[Setting]:
    """Every preset, at settings that a user would try."""
    of, percent = hapfmt.Settings.of, lambda share: Tolerance(share, "range")
    found = [
        Setting("lossless", "", "lossless", of("lossless")),
        Setting("lossless", "fast", "lossless", of("lossless", fast=True)),
    ]
    for share in (1e-3,) if quick else (1e-4, 1e-3, 1e-2):
        asked = of("near-lossless", max_error=percent(share))
        found.append(Setting("near-lossless", f"{share:.2%}", f"within {share:.2%}", asked))
    for k in (0.1,) if quick else (0.02, 0.1, 0.3):
        asked = of("perceptual", texture=False, felt="all", k=k, floor=percent(FLOOR))
        found.append(Setting("deadband", f"k={k:g}", f"deadband k={k:g}", asked))
    found.append(Setting("perceptual", "", "", of("perceptual")))
    qualities = () if quick else (10, 30)
    found += [Setting("perceptual", f"{db} dB", "", of("perceptual", snr=db)) for db in qualities]
    found.append(Setting("perceptual", "no texture", "", of("perceptual", texture=False)))
    for bits in (0, 5) if quick else PAPER_BITS:
        asked = of("paper", k=0.1, bits=bits, floor=percent(FLOOR))
        found.append(Setting("paper", f"b={bits or 'none'}", "", asked))
    return found


class Uniform(NamedTuple):
    """The recipes' companding for an error that is the same everywhere: none."""

    bound: float
    error: float = SAFE

    def compand(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        return x / self.bound

    def value(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        return u * self.bound


def peer_tasks(subject: Subject) -> Iterator[tuple[str, list[list[Coder | Recipe]]]]:
    """(task, the peers for it, of each channel)."""
    exact = integer_coders() if subject.integers else double_coders()
    yield "lossless", [list(exact) for _ in subject.recording.channels]
    ranges = [float(np.ptp(x)) or 1.0 for x in subject.truth]
    within: list[list[Coder | Recipe]] = []
    for extent in ranges:
        uniform: Any = Uniform(PEER_ERROR * extent)
        found = [quantised("uniform", uniform, coder) for coder in integer_coders()]
        if installed("pysz"):
            found += [sz3("uniform", uniform, name) for name in ("LORENZO_REG", "INTERP")]
        within.append([each._replace(name=each.name.removeprefix("uniform + ")) for each in found])
    yield f"within {PEER_ERROR:.2%}", within
    yield f"deadband k={PEER_K:g}", [list(recipes(PEER_K, FLOOR * extent)) for extent in ranges]


def errors(subject: Subject, found: Sequence[NDArray[np.float64]]) -> dict[str, float | None]:
    """Errors of the decoded channels, with the names of Trial."""
    rms, largest, snr, band = [], [0.0], [], []
    similar: list[float | None] = []
    for channel, x, y in zip(subject.recording.channels, subject.truth, found, strict=True):
        extent, rate = float(np.ptp(x)), channel.rate
        if not extent:
            continue
        rms.append(100 * rmse(x, y) / extent)
        largest.append(max_error(x, y) / extent)
        snr.append(snr_hf_db(x, y, rate) if rate > 50 else None)
        band.append(band_energy_error_db(x, y, rate))
        if rate >= SIMILAR_HZ and len(similar) < SIMILAR_CHANNELS:
            first = slice(0, round(SIMILAR_S * rate))
            similar.append(similarity(x[first], y[first], channel.rate_exact))
    return {
        "rms_percent": middle(rms) or 0.0,
        "largest_percent": 100 * max(largest),
        "snr_hf_db": middle(snr),
        "band_db": middle(band),
        "st_sim": middle(similar),
    }


def middle(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(median(known)) if known else None


def similarity(x: NDArray[np.float64], y: NDArray[np.float64], rate: Any) -> float | None:
    """ST-SIM, where its package is installed and the channel is long and fast enough."""
    try:
        return st_sim(x, y, rate)
    except hapfmt.HapfmtError:
        return None


def beyond(task: str, truth: Sequence[NDArray[Any]], found: Sequence[NDArray[Any]]) -> int | None:
    """Samples that break the promise of a task, each channel by its own range."""
    kind, _, amount = task.partition(" ")
    total = 0
    for x, y in zip(truth, found, strict=True):
        extent = float(np.ptp(x))
        if kind == "lossless" or not extent:
            total += int((x != y).sum())
        elif kind == "within":
            allowed = float(amount.rstrip("%")) / 100 * extent
            total += int((~(np.abs(x - y) <= allowed * ROUNDING)).sum())
        elif kind == "deadband":
            total += outside(x, y, float(amount.removeprefix("k=")), FLOOR * extent)[0]
        else:
            return None
    return total


def about(subject: Subject, family: str, setting: str, task: str) -> Trial:
    recording = subject.recording
    return Trial(subject.name, subject.simulated, family, setting, task, len(recording.channels),
                 recording.sample_count)  # fmt: skip


def try_ours(subject: Subject, setting: Setting, repeats: int) -> Trial | None:
    """Through the whole package: choice, file, and back. None where it would do nothing."""
    empty = about(subject, setting.family, setting.name, setting.task)
    recording = subject.recording
    if setting.family == "deadband":  # the peers' bound is each channel's own, so ours is
        apart = tuple(replace(channel, group="") for channel in recording.channels)
        recording = replace(recording, channels=apart)

    def encode() -> tuple[bytes, int]:
        stream = io.BytesIO()
        written = hapfmt.write(recording, stream, chosen, canonical=1, threads=1)
        return stream.getvalue(), written.payload_size

    chosen = setting.settings
    if setting.family == "perceptual" and not any(felt_channels(recording.channels, chosen)):
        chosen = replace(chosen, felt=ALL)  # its units are not known, and some texture is measured

    try:
        (data, payload), encoding = timed(encode, repeats)
        back, decoding = timed(lambda: hapfmt.read(data), repeats)
    except hapfmt.HapfmtError as error:
        if "would do nothing" in str(error):  # no channel has a texture
            return None
        return empty._replace(failed=str(error))
    found = [channel.samples() for channel in back.channels]
    return empty._replace(
        coded_bits=8 * payload / empty.samples, file_bits=8 * len(data) / empty.samples,
        outside=beyond(setting.task, subject.truth, found), encode=encoding, decode=decoding,
        **errors(subject, found),
    )  # fmt: skip


def try_peer(
    subject: Subject, task: str, coders: Sequence[Coder | Recipe], repeats: int
) -> Trial | None:
    """One peer on all channels, constant ones as their value; None where they do not fit it."""
    empty = about(subject, "peer", coders[0].name, task)
    truth, rates = subject.truth, [c.rate for c in subject.recording.channels]
    counts = subject.integers if task == "lossless" else None
    given = counts or truth
    flat = [bool((x == x[0]).all()) for x in given]
    work = list(zip(coders, given, rates, flat, strict=True))

    def encode() -> list[bytes | None]:
        return [b"" if same else coder.encode(x, rate) for coder, x, rate, same in work]

    def decode() -> list[NDArray[Any]]:
        return [
            x.copy() if same else coder.decode(blob, x.size)
            for (coder, x, _, same), blob in zip(work, whole, strict=True)
        ]

    try:
        blobs, encoding = timed(encode, repeats)
        whole = [blob for blob in blobs if blob is not None]
        if len(whole) < len(blobs):
            return None
        found, decoding = timed(decode, repeats)
    except Exception as error:  # of any package
        return empty._replace(failed=f"{type(error).__name__}: {error}")
    if counts:
        calibrations = [channel.calibration for channel in subject.recording.channels]
        back = [c.physical(y) for c, y in zip(calibrations, found, strict=True)]
    else:
        back = [np.asarray(y, np.float64) for y in found]
    bits = 8 * coded_size(whole) / empty.samples
    return empty._replace(
        coded_bits=bits, file_bits=bits, outside=beyond(task, truth, back), encode=encoding,
        decode=decoding, **errors(subject, back),
    )  # fmt: skip


def trials(subject: Subject, quick: bool, progress: Callable[[str], None]) -> Iterator[Trial]:
    """All of one recording."""
    repeats = 1 if quick else REPEATS
    for setting in settings(quick):
        progress(f"{subject.name}: {setting.family} {setting.name}")
        trial = try_ours(subject, setting, repeats)
        if trial is not None:
            yield trial
    for task, by_channel in peer_tasks(subject):
        for coders in zip(*by_channel, strict=True):
            progress(f"{subject.name}: {coders[0].name}, {task}")
            trial = try_peer(subject, task, coders, repeats)
            if trial is not None:
                yield trial
