"""What people can feel: the psychophysical constants behind the encoder's defaults.

They are opinions of this encoder, never part of the format: a file states the deadband that it was
written with, and a reader checks that one. Preset perceptual takes Weber's law for quantities whose
zero is nothing felt; where a zero is a matter of the frame, the scale or the amplifier, a fraction
of the value means nothing, and only the absolute floor stays.
"""

from __future__ import annotations

from fractions import Fraction

FORCE_WEBER = Fraction(1, 10)
"""Just noticeable difference of a force, relative to that force.

About 7 % for active fingers between 2.5 and 10 N: X. D. Pang, H. Z. Tan, N. I. Durlach, "Manual
discrimination of force using active finger motion", Perception & Psychophysics 49, 1991. The
deadband literature works with 7-10 %, and the fraction rises below 0.5 N; 10 % is the value of
F. Brandi, R. Chaudhari, E. Steinbach, "Texture compensation for haptic feedback signal
compression", VECIMS 2011, https://doi.org/10.1109/VECIMS.2011.6053837."""

FORCE_FLOOR_N = Fraction(1, 100)
"""Absolute floor of the force deadband in newtons: below the absolute threshold, which is tens of
millinewtons. Measured on a force that decays to zero: 25 knots instead of 4667."""

LF_CUTOFF_HZ = 20.0
"""Where the quasi-static force ends and texture begins: the split of Brandi et al. 2011 (above).

The rate of an encoded texture is flat within 5 % for cutoffs of 10-30 Hz (measured), so the value
is not critical."""

TEXTURE_DB = 20.0
"""Quality of a texture: the power of what lies above the split frequency over that of the error.
On recorded textures 20 dB take more bits than an ST-SIM of 0.95 does."""

VELOCITY_WEBER = Fraction(8, 100)
"""Just noticeable difference of limb movement, 8 %: L. A. Jones, I. W. Hunter, "Differential
thresholds for limb movement measured using adaptive techniques", Perception & Psychophysics 52,
1992, https://doi.org/10.3758/BF03206714. (A position has a fraction of 9 % there too, but of the
movement made, not of a coordinate.)"""

WEBER_LIMITS: dict[str, Fraction | None] = {
    "force": None,
    "torque": None,
    "pressure": None,
    "acceleration": None,
    "velocity": VELOCITY_WEBER,
}
"""Quantities with a zero that is felt, and the largest Weber fraction each may be given (None: the
caller's). Amplitudes of vibration are told apart from about 20 % on, above the 10 % of a force."""

QUANTITY_OF_UNIT = {
    **dict.fromkeys(("N", "mN", "uN", "kN", "gf", "kgf", "[lbf_av]"), "force"),
    **dict.fromkeys(("N.m", "mN.m", "N.mm", "N.cm", "uN.m", "kN.m"), "torque"),
    **dict.fromkeys(("Pa", "hPa", "kPa", "MPa", "bar", "mbar", "[psi]", "mm[Hg]"), "pressure"),
    **dict.fromkeys(("m/s2", "mm/s2", "[g]", "m[g]", "rad/s2", "deg/s2"), "acceleration"),
    **dict.fromkeys(("m/s", "mm/s", "cm/s", "rad/s", "deg/s", "{rev}/min"), "velocity"),
    **dict.fromkeys(("m", "cm", "mm", "um", "rad", "mrad", "deg", "{rev}"), "position"),
    **dict.fromkeys(("Cel", "K", "[degF]"), "temperature"),
    **dict.fromkeys(("V", "mV", "uV"), "voltage"),
    **dict.fromkeys(("A", "mA", "uA"), "current"),
    **dict.fromkeys(("s", "ms", "us", "ns", "min", "h", "d"), "time"),
}
"""By UCUM code, where a channel does not name its quantity."""

FORCE_FLOORS = {"N": FORCE_FLOOR_N, "mN": 1000 * FORCE_FLOOR_N, "kN": FORCE_FLOOR_N / 1000}
"""FORCE_FLOOR_N in the units that forces are given in."""
