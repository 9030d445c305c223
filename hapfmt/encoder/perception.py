"""What people can feel: the psychophysical constants behind the encoder's defaults.

They are opinions of this encoder, never part of the format: a file states the deadband that it was
written with, and a reader checks that one. Other quantities have no default yet, on purpose.
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
