"""Measures of the error between an original f and its reconstruction y.

The measures disagree, so report them together. Noise that is shaped like the texture has a poor
signal-to-noise ratio but matching band energies; a shifted click is the opposite case. All
functions take finite arrays, [ticks] or [ticks, components], of equal shape and unit. They compute
in float64 and return one number over all components. A recording with gaps is compared span by
span.

    from hapfmt import metrics
    metrics.snr_hf_db(f, y, 1000)
"""

from __future__ import annotations

from fractions import Fraction
from importlib import import_module
from types import ModuleType
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import MissingExtraError, ParameterError
from .split import low_pass

Quantity = Literal["displacement", "velocity", "acceleration"]

SPLIT_HZ = 20.0
"""The HF part, whose variance is the signal of :func:`snr_hf_db`, begins here."""

WEBER = 0.1
"""Weber fraction of the deadband that errors are held against: that of forces."""

AT_THE_BOUND = 1e-9
"""Share by which an error on the bound may exceed it: the rounding of float64."""

FLAT_TO_HZ, LEAST_FROM_HZ, LEAST_TO_HZ = 40.0, 250.0, 300.0
"""Corners of :func:`vibrotactile_threshold`."""

LEAST_M = 0.1e-6
"""Amplitude of the weakest sine that is felt at 250 Hz, to the order of magnitude: the curves for
large contactors have their minimum at about -20 dB re 1 um."""

BAND_BLOCK_S = 0.128
BAND_COUNT = 10
"""Blocks and bands of :func:`band_energy_error_db`. 0.128 s resolve 7.8 Hz, so that ten bands from
20 Hz to 500 Hz hold a line each; at this length the band energies of a recorded texture itself vary
by 1.7 dB over 0.5 s."""

BAND_FLOOR = 1e-6
"""Added to each band energy, relative to the largest in f: -60 dB, so that silence compares."""

TEXTURE_HIGH_PASS_HZ = 15.0
TEXTURE_RATE_HZ = 8000
TEXTURE_EDGE = 4096
TEXTURE_BLOCK = 512
"""Protocol of :func:`st_sim` and :func:`spqi`: the perceptual curve of both measures is defined for
8 kHz; the edges hold the transients of both filters."""

ST_SIM_DB = 12.0
"""Spread of the normal distribution that weighs a spectrum."""

_EPS = float(np.finfo(float).eps)

TEXTURE_MOST = 1 << 15
"""Largest up- or downsampling factor to 8 kHz. The filter of the polyphase resampling has 20 taps
per unit of the larger factor: 655 381 taps, 5 MB. The rate is off by 3e-5 at most."""

ST_SIM_EXPONENT = 2 / 3
"""Weight of the temporal part; the spectral part has the rest. The value of the package."""

SPQI_SLOPE, SPQI_OFFSET = 0.3, -2.0
"""The hyperbolic tangent that maps an error in dB to a score. The values of the package."""

_SILENT = 1e-9
"""A high-passed part below this share of the signal is rounding, not texture."""


def max_error(f: NDArray[Any], y: NDArray[Any]) -> float:
    """Largest ``|f - y|``, in the unit of f; 0 without samples, infinity beyond float64."""
    a, b = _pair(f, y)
    with np.errstate(over="ignore"):
        return float(np.max(np.abs(a - b), initial=0.0))


def rmse(f: NDArray[Any], y: NDArray[Any]) -> float:
    """Root of the mean squared error, in the unit of f; 0 without samples, infinity where an error
    is infinite."""
    a, b = _pair(f, y)
    with np.errstate(over="ignore"):
        return _rms(a - b)


def snr_db(f: NDArray[Any], y: NDArray[Any]) -> float:
    """10 log10 of the variance of f over the mean squared error of y, in dB.

    A constant offset of f does not count as signal; one of y counts as noise. Infinity where y
    equals f, also without samples; minus infinity where f is constant and y differs.
    """
    a, b = _scaled(f, y)
    return _ratio_db(_rms(a - a.mean(axis=0)) if a.size else 0.0, _rms(a - b))


def snr_hf_db(
    f: NDArray[Any], y: NDArray[Any], rate_hz: float, split_hz: float = SPLIT_HZ
) -> float:
    """10 log10 of the variance of f above ``split_hz`` over the mean squared error of y, in dB.

    The error is that of the full band: what the LF part loses counts as noise. Infinity where y
    equals f, also without samples; minus infinity where f has no HF part and y differs.
    """
    a, b = _scaled(f, y)
    noise = _rms(a - b)
    if noise == 0:
        return float("inf")
    texture = _drop_rounding(a - low_pass(a, rate_hz, split_hz), a)
    return _ratio_db(_rms(texture - texture.mean(axis=0)), noise)


def snr_weighted_db(
    f: NDArray[Any], y: NDArray[Any], rate_hz: float, quantity: Quantity = "acceleration"
) -> float:
    """Signal-to-noise ratio above 20 Hz, each frequency weighed by how well a person feels it; dB.

    The energies of f and of y - f are summed over the lines of a cosine transform (type 2, over all
    ticks), each divided by the square of :func:`vibrotactile_threshold` at its frequency. quantity
    says what f is. The force on a held tool accelerates it, so give "acceleration" for a force.
    That holds above the resonance of hand and tool, some 10 Hz. Do not use the measure for a
    pressure or a voltage, whose relation to the vibration is not known.

    Infinity where y equals f above 20 Hz, also without samples and at rates up to 40 Hz; minus
    infinity where f has nothing there and y has.
    """
    a, b = _scaled(f, y)
    n = a.shape[0]
    hz = np.arange(n) * (_positive(rate_hz) / (2 * max(n, 1)))
    above = hz >= SPLIT_HZ
    if not above.any():
        return float("inf")
    weight = 1 / vibrotactile_threshold(hz[above], quantity)
    weight = (weight / weight.max()).reshape((-1,) + (1,) * (a.ndim - 1))

    def level(x: NDArray[np.float64]) -> float:
        return _rms(_cosines(x)[above] * weight)

    whole = float(np.max(np.abs(a), initial=0.0))
    signal, noise = level(a), level(b - a)
    return _ratio_db(signal if signal > _SILENT * whole else 0.0, noise)


def _cosines(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """The orthonormal cosine transform of type 2 of x [ticks, ...], ticks above 0."""
    n = x.shape[0]
    turns = np.exp(-0.5j * np.pi * np.arange(n) / n).reshape((n,) + (1,) * (x.ndim - 1))
    lines = (np.fft.rfft(np.concatenate([x, x[::-1]]), axis=0)[:n] * turns).real / np.sqrt(2 * n)
    lines[0] /= np.sqrt(2)
    return np.asarray(lines)


def vibrotactile_threshold(
    hz: NDArray[Any] | float, quantity: Quantity = "displacement"
) -> NDArray[np.float64]:
    """Amplitude of the weakest sine that is felt at each frequency: m, m/s or m/s^2; shape of hz.

    In displacement it is flat up to 40 Hz, then falls by 12 dB an octave to its minimum, 0.1 um at
    250-300 Hz, and is assumed to rise by the same slope above. Times 2 pi f it is a velocity, times
    its square an acceleration. In acceleration it is flat from 40 to 250 Hz.

    R. T. Verrillo, "Effect of contactor area on the vibrotactile threshold", J. Acoust. Soc. Am.
    35, 1963, for a large contactor, as G. A. Gescheider and R. T. Verrillo sum it up in "Sensory
    functions of the skin of humans", 1979, https://doi.org/10.1007/978-1-4613-3039-4_10. Thresholds
    differ between people, places and grips by up to 20 dB; a ratio needs only the shape.
    """
    if quantity not in _POWER:
        raise ParameterError(
            f"the threshold is known for {', '.join(_POWER)}, not for {quantity!r}"
        )
    f = np.asarray(hz, dtype=np.float64)
    below = (LEAST_FROM_HZ / np.clip(f, FLAT_TO_HZ, LEAST_FROM_HZ)) ** 2
    above = (np.maximum(f, LEAST_TO_HZ) / LEAST_TO_HZ) ** 2
    return np.asarray(LEAST_M * below * above * (2 * np.pi * f) ** _POWER[quantity])


MOVES: dict[str, Quantity] = {
    "position": "displacement",
    "velocity": "velocity",
    "acceleration": "acceleration",
    "force": "acceleration",
    "torque": "acceleration",
}
"""Quantities of channels, and as what :func:`vibrotactile_threshold` knows them. A force
accelerates what is held."""

_POWER: dict[str, int] = {"displacement": 0, "velocity": 1, "acceleration": 2}


def max_in_deadbands(
    f: NDArray[Any],
    y: NDArray[Any],
    floor: float,
    k: float = WEBER,
    *,
    vector: bool = False,
) -> float:
    """Largest ``|f - y| / max(k |f|, floor)``: the error in just noticeable differences.

    floor: absolute threshold, in the unit of f, above 0. k: Weber fraction, 0 or more; 0 for a
    quantity whose zero has no meaning. vector: Euclidean norms over the components. 0 without
    samples.

    The deadband of F. Brandi, R. Chaudhari, E. Steinbach, "Texture compensation for haptic feedback
    signal compression", VECIMS 2011, https://doi.org/10.1109/VECIMS.2011.6053837.
    :mod:`hapfmt.deadband` checks the bound that a file states, on integers.
    """
    return float(np.max(_in_deadbands(f, y, floor, k, vector), initial=0.0))


def share_outside(
    f: NDArray[Any],
    y: NDArray[Any],
    floor: float,
    k: float = WEBER,
    *,
    vector: bool = False,
) -> float:
    """Share of the samples (vector: of the ticks) outside the deadband, in [0, 1]; 0 of none.

    The deadband is that of :func:`max_in_deadbands`. A sample on its edge is inside.
    """
    found = _in_deadbands(f, y, floor, k, vector)
    return float(np.mean(found > 1 + AT_THE_BOUND)) if found.size else 0.0


def band_energy_error_db(f: NDArray[Any], y: NDArray[Any], rate_hz: float) -> float:
    """Mean ``|10 log10(energy of y / energy of f)|`` over blocks and bands, in dB.

    Blocks of 128 ms with a Hann window, end to end, each without its mean; what does not fill a
    block at the end is left out, unless it is all there is. Ten bands of equal ratio from 20 Hz (at
    rates below 400 Hz from a twentieth of the rate) to the Nyquist rate; a band that no
    line of the spectrum falls into is left out. 0 without samples and where y equals f. A measure
    of this project: it accepts noise with the spectrum of the texture, which the others reject.
    """
    rate_hz = _positive(rate_hz)
    a, b = _scaled(f, y)
    n = a.shape[0]
    size = min(max(round(BAND_BLOCK_S * rate_hz), 4), n)
    if size < 4 or np.array_equal(a, b):
        return 0.0
    _, of_f = _band_energies(a, rate_hz, size)
    _, of_y = _band_energies(b, rate_hz, size)
    floor = BAND_FLOOR * of_f.max() or BAND_FLOOR * of_y.max() or 1.0
    return float(np.mean(np.abs(10 * np.log10((of_y + floor) / (of_f + floor)))))


class BandLevel(NamedTuple):
    """How much louder a band of frequencies is in y than in f."""

    low_hz: float
    high_hz: float
    db: float


def texture_levels_db(
    f: NDArray[Any], y: NDArray[Any], rate_hz: float
) -> tuple[float, list[BandLevel]]:
    """How much louder y is than f above 40 Hz, in dB: as a whole, and in each band.

    The bands and blocks are those of :func:`band_energy_error_db`, and their energies are summed
    over the blocks. Both signals pass the low-pass of :mod:`hapfmt.split` at 20 Hz, and what it
    leaves is compared. Bands that begin an octave above that filter are used: below, it
    divides the signal. 0 and no bands where there is none; -60 dB counts as silence.
    """
    rate_hz = _positive(rate_hz)
    a, b = (x - low_pass(x, rate_hz, SPLIT_HZ) for x in _scaled(f, y))
    size = min(max(round(BAND_BLOCK_S * rate_hz), 4), a.shape[0])
    if size < 4:
        return 0.0, []
    edges, of_f = _band_energies(a, rate_hz, size)
    above = edges[:, 0] >= 2 * SPLIT_HZ
    e, d = (x.sum(axis=(0, 2))[above] for x in (of_f, _band_energies(b, rate_hz, size)[1]))
    floor = BAND_FLOOR * float(e.max(initial=0.0))
    if not floor:
        return 0.0, []
    found = 10 * np.log10((d + floor) / (e + floor))
    rows = zip(edges[above].tolist(), found.tolist(), strict=True)
    bands = [BandLevel(low, high, db) for (low, high), db in rows]
    return float(10 * np.log10((d.sum() + floor) / (e.sum() + floor))), bands


def _band_energies(
    x: NDArray[np.float64], rate_hz: float, size: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The edges [bands, 2] in Hz, and the energies [blocks, bands, components] of x."""
    lines = np.fft.rfftfreq(size, 1 / rate_hz)
    edges = np.geomspace(min(SPLIT_HZ, rate_hz / 20), rate_hz / 2, BAND_COUNT + 1)
    band = np.searchsorted(edges, lines, side="right") - 1
    band[-1] = min(band[-1], BAND_COUNT - 1)
    present = np.unique(band[band >= 0])
    members = np.stack([band == k for k in present]).astype(np.float64)
    blocks = x[: len(x) // size * size].reshape(len(x) // size, size, -1)
    window = np.hanning(size + 1)[:size, np.newaxis]
    spectrum = np.fft.rfft((blocks - blocks.mean(axis=1, keepdims=True)) * window, axis=1)
    found = np.einsum("kf,bfc->bkc", members, np.abs(spectrum) ** 2)
    return np.stack([edges[present], edges[present + 1]], axis=1), np.asarray(found)


def st_sim(f: NDArray[Any], y: NDArray[Any], rate_hz: float | Fraction) -> float:
    """Spectral-temporal similarity ST-SIM of two [ticks] signals, 0 or more; 1 where y equals f.

    The package vibromaf (extra "metrics") computes it. Before that, the signals pass a zero-phase
    high-pass (15 Hz, Butterworth of order 2). They are resampled to 8 kHz by a polyphase filter
    (within 0.003 %, see :func:`resampling_8khz`). The first and last 4096 samples are dropped.

    If the mean correlation is negative, the package gives a complex number; it counts as 0. Two
    signals without texture give 1; a signal without texture and one with texture give 0. The unit
    matters: the measure weighs each spectrum with its own perceptual threshold. Both terms are
    projections on f, divided by the energy of f alone. So a y with slightly more energy gives more
    than 1 (1.014 was observed).
    ParameterError if fewer than 512 samples (the block of the measure) are left: below 1.088 s.

    R. Hassen, E. Steinbach, "Subjective evaluation of the spectral temporal similarity (ST-SIM)
    measure for vibrotactile quality assessment", IEEE Transactions on Haptics 13, 2020,
    https://doi.org/10.1109/TOH.2019.2962446.
    """
    return _by_package("stsim", "st_sim", f, y, rate_hz, eta=ST_SIM_EXPONENT)


def texture_threshold_db() -> NDArray[np.float64]:
    """The threshold of ST-SIM and SPQI at the lines of a block at 8 kHz: a parabola over log f with
    its minimum of -77 dB at 250 Hz, which ends where it is above 0."""
    hz = np.linspace(0, TEXTURE_RATE_HZ, 2 * TEXTURE_BLOCK)[:TEXTURE_BLOCK]
    offset = 1 - 250 / 550
    threshold = 62 * (np.log10(hz / 550 + offset) / np.log10(offset)) ** 2 - 77
    first = int(np.argmax(threshold > 0))
    threshold[first:] = threshold[first]
    return np.asarray(threshold)


class Similarity:
    """ST-SIM of many signals to one f, for a search: :func:`st_sim` within rounding, all blocks at
    once."""

    def __init__(self, f: NDArray[Any], rate_hz: float | Fraction) -> None:
        self.threshold = texture_threshold_db()
        self.rate_hz = rate_hz
        self.f = np.asarray(f, np.float64)
        self.silent, self.normal, self.support = self._parts(self.f)

    def of(self, y: NDArray[Any]) -> float:
        _, y = _pair(self.f, y)
        if np.array_equal(self.f, y):
            return 1.0
        silent, normal, support = self._parts(y)
        if silent or self.silent:
            return float(silent and self.silent)
        temporal, spectral = (
            float(((a * b).sum(axis=1) / ((a * a).sum(axis=1) + _EPS)).mean())
            for a, b in ((self.normal, normal), (self.support, support))
        )
        eta = ST_SIM_EXPONENT
        return temporal**eta * spectral ** (1 - eta) if temporal > 0 else 0.0

    def _parts(
        self, x: NDArray[np.float64]
    ) -> tuple[bool, NDArray[np.float64], NDArray[np.float64]]:
        """Whether there is no texture; the blocks with mean 0 and spread 1; and how far their
        spectra are above the threshold, by the normal distribution."""
        from scipy import fft, special

        texture = _texture_8khz(x, self.rate_hz, NAMES["st_sim"])
        size = texture.size // TEXTURE_BLOCK * TEXTURE_BLOCK
        blocks = texture[:size].reshape(-1, TEXTURE_BLOCK)
        away = blocks - blocks.mean(axis=1, keepdims=True)
        normal = away / (away.std(axis=1, keepdims=True) + _EPS)
        with np.errstate(divide="ignore"):
            level = 20 * np.log10(np.abs(fft.dct(blocks, norm="ortho")))
        support = special.ndtr((level - self.threshold) / ST_SIM_DB)
        return not np.any(texture), normal, np.asarray(support)


def spqi(f: NDArray[Any], y: NDArray[Any], rate_hz: float | Fraction) -> float:
    """Spectral perceptual quality index SPQI of two [ticks] signals, in [0, 1]; 1 where y equals f.

    The package vibromaf (extra "metrics") computes it, after the steps of :func:`st_sim`. In each
    block of 512 samples, the difference of the two power spectra, divided by the perceptual
    threshold, is compared with the spectrum of f. The index is 0.5 where the sum of the differences
    is 6.7 dB below that of the spectrum. Phases do not count, but a block of 64 ms fixes the time.

    Two signals without texture give 1; a signal without texture and one with texture give 0.
    ParameterError below 1.088 s, as for :func:`st_sim`.

    A. Noll, M. Hofbauer, E. Muschter, S.-C. Li, E. Steinbach, "Automated quality assessment for
    compressed vibrotactile signals using multi-method assessment fusion", IEEE Haptics Symposium
    2022, https://doi.org/10.1109/HAPTICS52432.2022.9765599.
    """
    return _by_package("spqi", "spqi", f, y, rate_hz, eta=SPQI_SLOPE, threshold=SPQI_OFFSET)


def resampling_8khz(rate_hz: float | Fraction) -> Fraction:
    """The ratio by which :func:`st_sim` and :func:`spqi` resample: 8 kHz / ``rate_hz``.

    Neither its numerator nor its denominator is above :data:`TEXTURE_MOST`, and it is within a
    share of 1 / ``TEXTURE_MOST`` of exact.
    """
    exact = TEXTURE_RATE_HZ / Fraction(rate_hz)
    return exact.limit_denominator(max(int(TEXTURE_MOST / max(exact, Fraction(1))), 1))


def require_package(module: str = "stsim", part: str = "metrics") -> ModuleType:
    """A module of the package vibromaf; MissingExtraError with the command that installs it."""
    try:
        return import_module(f"vibromaf.{part}.{module}")
    except ImportError as error:
        raise MissingExtraError("vibromaf", "metrics") from error


def _by_package(
    module: str,
    name: str,
    f: NDArray[Any],
    y: NDArray[Any],
    rate_hz: float | Fraction,
    **parameters: float,
) -> float:
    """A measure of the package vibromaf, which brings SciPy, by the protocol of :func:`st_sim`."""
    a, b = _pair(f, y)
    if a.ndim != 1:
        raise ParameterError(f"{NAMES[name]} compares single channels, [ticks]")
    if np.array_equal(a, b):
        return 1.0
    measure = getattr(require_package(module), name)
    reference, distorted = (_texture_8khz(x, rate_hz, NAMES[name]) for x in (a, b))
    if not (np.any(reference) and np.any(distorted)):
        return float(np.any(reference) == np.any(distorted))
    # A silent block has the spectrum -inf dB, which both measures allow.
    with np.errstate(divide="ignore"):
        found = measure(distorted, reference, **parameters)
    return 0.0 if isinstance(found, complex) else float(found)


NAMES = {"st_sim": "ST-SIM", "spqi": "SPQI"}


def _texture_8khz(
    x: NDArray[np.float64], rate_hz: float | Fraction, name: str
) -> NDArray[np.float64]:
    from scipy import signal

    ratio = resampling_8khz(rate_hz)
    left = x.size * ratio - 2 * TEXTURE_EDGE
    if rate_hz <= 2 * TEXTURE_HIGH_PASS_HZ or left < TEXTURE_BLOCK:
        raise ParameterError(f"{name} needs at least 1.088 s, at more than 30 Hz")
    sections = signal.butter(2, TEXTURE_HIGH_PASS_HZ, "highpass", fs=float(rate_hz), output="sos")
    texture = _drop_rounding(np.asarray(signal.sosfiltfilt(sections, x)), x)
    resampled = signal.resample_poly(texture, ratio.numerator, ratio.denominator)
    return np.asarray(resampled[TEXTURE_EDGE:-TEXTURE_EDGE])


def _in_deadbands(
    f: NDArray[Any], y: NDArray[Any], floor: float, k: float, vector: bool
) -> NDArray[np.float64]:
    a, b = _pair(f, y)
    if not (0 < floor < np.inf and 0 <= k < np.inf):
        raise ParameterError("a deadband has a threshold above 0 and a Weber fraction of 0 or more")
    with np.errstate(over="ignore"):
        error, value = np.abs(a - b), np.abs(a)
        if vector and a.ndim > 1:
            error, value = (np.linalg.norm(x, axis=1) for x in (error, value))
        return np.asarray(error / np.maximum(k * value, floor))


def _positive(rate_hz: float) -> float:
    if not 0 < rate_hz < np.inf:
        raise ParameterError("a metric needs a positive rate")
    return float(rate_hz)


def _ratio_db(signal: float, noise: float) -> float:
    """20 log10 of two levels; infinity without noise, minus infinity without signal."""
    if noise == 0:
        return float("inf")
    return float(20 * (np.log10(signal) - np.log10(noise))) if signal else float("-inf")


def _pair(f: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    a, b = np.asarray(f, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if a.shape != b.shape:
        raise ParameterError(f"a metric compares equal shapes, not {a.shape} and {b.shape}")
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
        raise ParameterError("a metric needs finite samples; compare span by span")
    return a, b


def _scaled(f: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Both times one power of two, at most 1/2 in magnitude, for measures of ratios."""
    a, b = _pair(f, y)
    largest = max(float(np.max(np.abs(x), initial=0.0)) for x in (a, b))
    exponent = -int(np.frexp(largest)[1]) - 1
    return np.ldexp(a, exponent), np.ldexp(b, exponent)


def _rms(x: NDArray[np.float64]) -> float:
    """Root mean square of all elements of any size; 0 without elements."""
    largest = float(np.max(np.abs(x), initial=0.0))
    return (
        largest * float(np.sqrt(np.mean((x / largest) ** 2))) if 0 < largest < np.inf else largest
    )


def _drop_rounding(texture: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.float64]:
    silent = np.max(np.abs(texture), axis=0) <= _SILENT * np.max(np.abs(whole), axis=0)
    return np.where(silent, 0.0, texture)
