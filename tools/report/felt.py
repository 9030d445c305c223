"""What of an error a hand would feel, from published thresholds: a measure, and no rating.

A force f on a stylus in the hand moves it by f / |K - m w^2 + i C w| (the hand and the stylus of
``hapfmt.lab.scenes``). That displacement is compared with the vibrotactile threshold: flat to 40
Hz, then falling by 12 dB an octave to its minimum at 250-300 Hz (R. T. Verrillo, "Effect of
contactor area on the vibrotactile threshold", J. Acoust. Soc. Am. 35, 1963, as G. A. Gescheider
and R. T. Verrillo sum it up in "Sensory functions of the skin of humans", 1979,
https://doi.org/10.1007/978-1-4613-3039-4_10). Above 300 Hz the same slope upwards is assumed here:
at 1 kHz it concerns less than an octave. The sum of (displacement / threshold)^2 over frequency is
the power as the Pacinian channel weighs it, which roughness follows (S. J. Bensmaia, M. Hollins,
"The vibrations of texture", Somatosensory & Motor Research 20, 2003,
https://doi.org/10.1080/0899022031000083825).

An error counts as felt where it is above threshold by itself and changes the vibration by more
than a just noticeable difference: M. A. Forta, M. J. Griffin, M. Morioka, "Vibrotactile difference
thresholds", Somatosensory & Motor Research 29, 2012, found Weber fractions of amplitude of 0.20 to
0.58. The least of them is taken, and the error as if it were in phase with the texture, so that
rather too much counts as felt.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapfmt.lab.scenes import Tool
from hapfmt.metrics import BAND_BLOCK_S, SPLIT_HZ, vibrotactile_threshold
from hapfmt.split import low_pass

GRASPED_DB = 20.0
"""The threshold is known to an order of magnitude. For a cylinder in the grasp A. J. Brisben, S. S.
Hsiao, K. O. Johnson, "Detection of vibration transmitted through an object grasped in the hand",
J. Neurophysiology 81, 1999, found less than 0.01 um in some subjects. Both are shown."""

VIBRATION_WEBER = 0.20


class Felt(NamedTuple):
    """Levels in dB over the threshold, mean power over the blocks in which the texture is felt;
    share of these blocks in which the error is felt, and the same for a threshold GRASPED_DB
    lower."""

    texture_db: float
    error_db: float
    share: float
    share_grasped: float


def displacement_m_per_n(hz: NDArray[np.float64], tool: Tool) -> NDArray[np.float64]:
    """What a force moves the held tool by."""
    w = 2 * np.pi * hz
    spring = tool.hand_n_per_m - tool.mass_kg * w**2 + 1j * tool.hand_ns_per_m * w
    return np.asarray(1 / np.abs(spring))


def weighted_power(x: NDArray[np.float64], rate_hz: float, tool: Tool) -> NDArray[np.float64]:
    """[blocks]: of a force in newtons its part above 20 Hz, in squares of the threshold.

    Blocks of 128 ms with a Hann window, half over each other. A sine at threshold has power 1.
    """
    fast = x - low_pass(x, rate_hz, SPLIT_HZ)
    size = round(BAND_BLOCK_S * rate_hz)
    blocks = np.lib.stride_tricks.sliding_window_view(fast, size)[:: size // 2]
    window = np.hanning(size + 1)[:size]
    spectrum = np.abs(np.fft.rfft(blocks * window, axis=1)) ** 2
    hz = np.fft.rfftfreq(size, 1 / rate_hz)
    weight = displacement_m_per_n(hz, tool) / vibrotactile_threshold(hz)
    weight[hz < SPLIT_HZ] = 0
    # A sine of amplitude a has the power a^2 / 2; at threshold that shall be 1.
    power = 2 * spectrum / (size * np.sum(window**2))
    return np.asarray(2 * power @ weight**2)


def felt(f: NDArray[np.float64], y: NDArray[np.float64], rate_hz: float, tool: Tool) -> Felt:
    """Figures of a reconstruction y of the force f, [ticks] in newtons."""
    texture, error = (weighted_power(x, rate_hz, tool) for x in (f, y - f))

    def share(lower: float) -> float:
        there = texture * lower > 1
        noticed = (error * lower > 1) & (error > VIBRATION_WEBER**2 * texture)
        return float(np.mean(noticed[there])) if there.any() else 0.0

    there = texture > 1
    levels = (
        10 * math.log10(max(float(np.mean(x[there])), 1e-12)) if there.any() else -120.0
        for x in (texture, error)
    )
    return Felt(*levels, share(1.0), share(10 ** (GRASPED_DB / 10)))
