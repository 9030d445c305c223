"""What the cases are made of: contacts, textures, noise; and a recording there and back."""

from __future__ import annotations

import io
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

import hapfmt
from hapfmt import Calibration, Channel, Recording, Settings

Samples = NDArray[np.float64]
RATE = 1000
MILLI = Calibration(1, 0, 1000)
"""Newtons in counts of 1 mN."""


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def texture(
    n: int, rms: float, seed: int = 1, band: tuple[float, float] = (60, 400), rate: float = RATE
) -> Samples:
    """[n] noise within ``band`` Hz."""
    sections = signal.butter(4, band, "bandpass", fs=rate, output="sos")
    noise = signal.sosfilt(sections, generator(seed).normal(size=n + 1000))[1000:]
    return np.asarray(noise * (rms / noise.std()))


def contact(n: int, at: int, force: float = 3.3) -> Samples:
    """[n] 0 N, and from one sample to the next the whole force."""
    return np.where(np.arange(n) < at, 0.0, force)


def counts(newtons: Samples) -> NDArray[np.int32]:
    """[n] in counts of 1 mN."""
    return np.floor(newtons * 1000 + 0.5).astype(np.int32)


def force(newtons: Samples, rate: Fraction | int = RATE) -> Channel:
    """As a sensor of 1 mN records it."""
    return Channel(counts(newtons), Fraction(rate), calibration=MILLI, unit="N", quantity="force")


def file_of(*channels: Channel, settings: Settings | None = None) -> bytes:
    out = io.BytesIO()
    hapfmt.write(Recording(channels), out, settings, canonical=1, threads=1)
    return out.getvalue()


def back(channel: Channel, preset: str = "perceptual", band: str = "full", **given: Any) -> Channel:
    """The channel from a file with these settings."""
    data = file_of(channel, settings=Settings.of(preset, **given))
    with hapfmt.Reader(data, strict=True) as reader:
        return reader.read(band=band).channels[0]  # type: ignore[arg-type]


def same_bits(x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.bool_]:
    """Where two [n] float64 are the same words."""
    return np.asarray(x.view(np.int64) == y.view(np.int64))


def snr_db(wanted: Samples, error: Samples) -> float:
    """10 log10 of the powers; of large and small numbers alike."""
    return float(20 * np.log10(np.std(wanted) / np.sqrt(np.mean(error**2))))
