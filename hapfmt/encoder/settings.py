"""What the caller asks of the encoder: a preset, and the options that change it.

Amounts as the caller gives them: 0.01, 10mN, 2lsb, 0.1%.

The psychophysical constants behind the encoder's defaults: what people can feel. They are choices
of this encoder, never part of the format. A file states its own deadband, and a reader checks that
one. Preset perceptual applies Weber's law to quantities whose zero means that nothing is felt.
Other zeros depend on the frame, the scale or the amplifier. There a fraction of the value means
nothing, and only the absolute threshold applies.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, inf, isfinite
from numbers import Real
from typing import Any, Literal

from ..codecs.knots import INTERPOLATIONS, Interpolation
from ..errors import ParameterError, similar
from ..numbers import exact
from ..recording import Calibration, Recording
from ..split import LF_CUTOFF_HZ
from ..units import conversion, to_ucum
from ..version import __version__
from .effort import EFFORTS, Effort, EffortName

# ASCII digits only: \d would take every digit of Unicode. Four digits of exponent are more than
# float64 can use, and keep the text of the exponent short.
_NUMBER = r"([0-9]+\.?[0-9]*|\.[0-9]+)(?:e([+-]?[0-9]{1,4}))?"
_AMOUNT = re.compile(rf"\+?{_NUMBER}\s*(\S.{{0,99}})?", re.IGNORECASE | re.DOTALL)


@dataclass(frozen=True)
class Tolerance:
    """An amount, positive and finite: a largest error, a threshold, a step.

    ``value`` is absolute, in ``unit`` (a UCUM code; "" for the channel's own); in steps of the
    sensor ("lsb"); or a fraction of the channel's range ("range": 0.0001 for 0.01 %). The range is
    the largest minus the smallest value, without single samples far beyond all others.
    """

    value: float
    kind: Literal["absolute", "lsb", "range"] = "absolute"
    unit: str = ""

    def __post_init__(self) -> None:
        if self.kind not in ("absolute", "lsb", "range"):
            raise ParameterError(f"{self.kind!r} is not a kind of tolerance: absolute, lsb, range")
        if not (isfinite(self.value) and self.value > 0):
            raise ParameterError(
                f"an amount is above 0 and finite, {self.value} is not; "
                "to keep every bit, use preset lossless"
            )

    @classmethod
    def parse(cls, text: str) -> Tolerance:
        """ "1e-6" in the channel's unit, "10mN", "0.5lsb" in steps, "0.01%" of the channel's own
        range."""
        match = _AMOUNT.fullmatch(text.strip())
        digits, exponent, suffix = match.groups() if match else ("", "", "")
        suffix = (suffix or "").strip()
        if match is None or not is_unit(suffix):
            raise ParameterError(
                f"{text!r} is not an amount: write a positive number in the channel's unit (1e-6), "
                "with a unit (10mN), in steps of the sensor (0.5lsb), or in percent of the "
                "channel's range (0.01%)"
            )
        if suffix == "%":
            # Moved into the exponent, 0.07% is the double nearest to 0.0007; 0.07 / 100 is not.
            return cls(float(f"{digits}e{int(exponent or 0) - 2}"), "range")
        value = float(f"{digits}e{exponent or 0}")
        if suffix.lower() == "lsb":
            return cls(value, "lsb")
        return cls(value, unit=to_ucum(suffix) if suffix else "")

    @property
    def is_plain(self) -> bool:
        """Whether it is a bare number, in the unit of whatever channel it is for."""
        return self.kind == "absolute" and not self.unit

    def in_unit(self, unit: str) -> float:
        """The value of an absolute amount in the unit of a channel."""
        if not self.unit or self.unit == unit:
            return self.value
        factor = conversion(self.unit, unit)
        if factor is None:
            raise ParameterError(
                f"an amount in {self.unit} does not fit a channel in {unit}; give a share of the "
                "range (0.1%), or the amount in the channel's unit"
            )
        return float(Fraction(repr(self.value)) * factor)

    def absolute(self, extent: float, step: float | None, unit: str = "") -> float | None:
        """The tolerance in the channel's unit; None in lsb where no step is known.

        extent: the channel's largest minus its smallest value. unit: the channel's.
        """
        if self.kind == "range":
            return self.value * extent
        if self.kind == "lsb":
            return None if step is None else self.value * step
        return self.in_unit(unit)


def is_unit(text: str) -> bool:
    """Whether a text behind a number is a unit or one of the two other suffixes, or empty."""
    if text in ("", "%") or text.lower() == "lsb":
        return True
    return not to_ucum(text).startswith("{")


FORCE_WEBER = Fraction(1, 10)
"""Just noticeable difference of a force, relative to that force.

About 7 % for active fingers between 2.5 and 10 N: X. D. Pang, H. Z. Tan, N. I. Durlach, "Manual
discrimination of force using active finger motion", Perception & Psychophysics 49, 1991. The
deadband literature works with 7-10 %, and the fraction rises below 0.5 N; 10 % is the value of
F. Brandi, R. Chaudhari, E. Steinbach, "Texture compensation for haptic feedback signal
compression", VECIMS 2011, https://doi.org/10.1109/VECIMS.2011.6053837."""

FORCE_FLOOR_N = Fraction(1, 100)
"""Absolute threshold of the force deadband in newtons: below what people feel, which is tens of
millinewtons. Measured on a force that decays to zero: 25 knots instead of 4667."""

Quality = Literal["low", "medium", "high"]
QUALITIES: dict[Quality, float] = {"low": 10.0, "medium": 20.0, "high": 30.0}
"""Quality of a texture in dB: the power above the split frequency over the power of the error. On
recorded textures 20 dB take more bits than an ST-SIM of 0.95 does."""

TEXTURE_DB = QUALITIES["medium"]

CLOSE = 0.02
"""The quality that is reached exceeds the target by this share of it at most, unless the deadband
or a lossless form asks for more."""


TextureCodec = Literal["LPCR", "MDCT"]
TEXTURE_CODECS: tuple[TextureCodec, ...] = ("LPCR", "MDCT")


@dataclass(frozen=True)
class TextureQuality:
    """The quality of a texture: a signal-to-noise ratio in dB, or an ST-SIM.

    drops_silence: textures below the absolute threshold are left out, in whole channels and in
    stretches. threshold_is_enough: errors below it are allowed, although the quality asks for less.
    """

    snr: float | None = TEXTURE_DB
    st_sim: float | None = None
    drops_silence: bool = True
    threshold_is_enough: bool = True
    synthetic: bool = False
    """Whether a model takes the place of the samples."""
    codec: TextureCodec | None = None
    """The only codec of textures; None: whichever is smaller."""
    weighting: float = 0.0
    """Exponent of the threshold of vibration in the steps of MDCT."""


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
"""Quantities whose zero means that nothing is felt, and the largest Weber fraction for each (None:
the caller's). People distinguish amplitudes of vibration from about 20 % on, above the 10 % of a
force."""

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


Preset = Literal["lossless", "near-lossless", "perceptual", "paper"]
PRESETS: tuple[Preset, ...] = ("lossless", "near-lossless", "perceptual", "paper")

ALL = ("all",)
"""``felt``: Weber's law for every channel."""

ALIASES: dict[str, tuple[Preset, dict[str, Any]]] = {
    "archive": ("lossless", {}),
    "deadband": ("perceptual", {"texture": False, "felt": ALL}),
    "auto": ("perceptual", {"texture": False}),
    "default": ("perceptual", {}),
}
"""Old names of presets, for one version."""

BITS = range(2, 17)
"""Quantiser of the paper: 2**b - 1 levels; one bit would leave level 0 only."""

ARCHIVE_CLUSTER = Fraction(10)
"""Seconds (SPEC clause 15)."""

LONG, LONGEST_CLUSTER = 1 << 16, Fraction(120)
"""Samples of the longest packet, which the encoder cuts where pieces are smaller; and the seconds
that a slow channel may wait for them. Shorter clusters cost 1 to 3 % (da Vinci torques, 16 s for
20), and a glove at 100 Hz 4 % (32 s for 120)."""

LEAST_TICKS = 256
"""Samples of the fastest channel in a cluster. With one in each, as ten seconds give it, 1000
samples of 1/3600 Hz took 49 kB; this way they take 1.3 kB."""

LONG_FAST = 1 << 15
"""Samples of a packet of --fast: as long as one predictor does for."""

RANGE_FLOOR = Tolerance(0.002, "range")
"""0.2 % of the channel's own range: an absolute threshold for any quantity, not only for forces."""

RANGE_ERROR = Tolerance(0.001, "range")
"""The largest error of preset near-lossless, where none is given."""

PAPER_BITS = 5

NO_TEXTURE = "no texture above the threshold"
EXACT_DB = 150.0
"""A texture with a higher signal-to-noise ratio differs by rounding to double precision alone."""

REACHED = " (texture "
"""In the encoder's text, before the quality of textures."""

INPUT = "; input: "
"""In the encoder's text, before the encoder of a lossy input."""

INPUT_SIZE = 300
"""Characters that are kept of it."""


@dataclass(frozen=True)
class Settings:
    """Choices of the encoder. A decoder needs none of them.

    An option that the preset does not use raises ParameterError. Amounts may be texts ("0.2%",
    "1lsb", "10mN"). Numbers may have any type of number.

    preset
        "lossless", "near-lossless", "perceptual" or "paper".
    max_error
        near-lossless: the largest error of a sample [0.1 % of the channel's range].
    force_error
        allow a largest error above 10 % of a channel's range.
    k
        perceptual, paper: the Weber fraction, from 0 to 1.
    floor
        perceptual, paper: the absolute threshold of the deadband. None, paper: 10 mN for forces, a
        share of the range for other units.
    felt
        perceptual: labels or numbers of the channels that Weber's law holds for, or ("all",).
        None: the quantity of each channel decides.
    texture
        perceptual: whether to keep the part above the split frequency.
    quality
        perceptual: "low", "medium" [default] or "high" texture: 10, 20 or 30 dB. Errors below the
        absolute threshold are enough, but not for "high".
    snr
        perceptual, in place of quality: signal-to-noise ratio of each texture in dB, also where
        errors are below the absolute threshold.
    st_sim
        perceptual, in place of quality: similarity ST-SIM of each texture, above 0 and below 1.
    bitrate
        perceptual, in place of quality: kbit/s of the whole file. All textures get the same
        signal-to-noise ratio.
    synthetic_texture
        perceptual, in place of quality: store a model of each texture, not its samples. What is
        decoded has the spectrum and the loudness of the texture, and other samples.
    texture_codec
        perceptual: "LPCR" or "MDCT", the only codec of textures, to compare both. None: the
        smaller.
    weighting
        perceptual: 0 to 1; MDCT's steps grow with this power of the threshold of vibration, for
        positions, velocities, accelerations, forces and torques.
    bits
        paper: bits of its quantiser, whose range comes from the signal; 0: no HF track.
    step
        paper: step of the residual, in place of ``bits``.
    cutoff_hz
        the split frequency in Hz.
    cluster
        length of clusters and packets in seconds; None: chosen by preset, rate and size.
    tolerance
        for experts: largest distance of the grid from floating point values.
    interpolation
        paper: how knots are joined.
    digest
        write SHA-256 of the decoded tracks.
    vectors
        "required" raises ParameterError where the channels of one group cannot be coded as one
        vector. "possible" codes them separately.
    references
        channels that resemble each other may share a track, each predicted from those before it.
        Then a lost packet affects all of them, and reading one decodes all.
    effort
        "fast", "default" or "best": how much is searched for the smallest form. ``fast=True`` is
        an older word for "fast".
    smallest
        keep the lossless form of a channel where it is smaller. False keeps the lossy form, for
        measurements of a method.
    """

    preset: Preset = "lossless"
    k: Fraction = FORCE_WEBER
    floor: Tolerance | None = None
    bits: int | None = None
    step: Tolerance | None = None
    cutoff_hz: float = LF_CUTOFF_HZ
    cluster: Fraction | None = None
    tolerance: Tolerance | None = None
    interpolation: Interpolation = "linear"
    digest: bool = False
    max_error: Tolerance = RANGE_ERROR
    force_error: bool = False
    vectors: Literal["possible", "required"] = "possible"
    references: bool = True
    effort: EffortName = "default"
    felt: tuple[str, ...] | None = None
    texture: bool = True
    smallest: bool = True
    quality: Quality | None = None
    snr: float | None = None
    st_sim: float | None = None
    bitrate: float | None = None
    synthetic_texture: bool = False
    texture_codec: TextureCodec | None = None
    weighting: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "k", share(self.k))
        if self.cluster is not None:
            object.__setattr__(self, "cluster", exact(self.cluster))
        for name in ("floor", "step", "tolerance", "max_error"):
            object.__setattr__(self, name, amount(getattr(self, name)))
        if isinstance(self.felt, str):
            object.__setattr__(self, "felt", (self.felt,))
        if self.preset not in PRESETS:
            meant = similar(str(self.preset), PRESETS)
            hint = f"; did you mean {meant!r}?" if meant else ""
            raise ParameterError(
                f"a preset is one of {', '.join(PRESETS)}, not {self.preset!r}{hint}"
            )
        if self.effort not in EFFORTS:
            raise ParameterError(f"the effort is one of {', '.join(EFFORTS)}, not {self.effort!r}")
        for name in USED_BY:
            if getattr(self, name) != _DEFAULTS[name]:
                refuse_unused(self.preset, name)
        if self.preset == "perceptual" and self.texture and self.vectors == "required":
            raise ParameterError("vectors requires texture=False: texture is coded axis by axis")
        if self.interpolation not in INTERPOLATIONS:
            raise ParameterError(f"knots are joined by one of {', '.join(INTERPOLATIONS)}")
        if not 0 <= self.k <= 1:
            raise ParameterError(
                f"the Weber fraction k is a share from 0 to 1, such as 0.1 or 10%, "
                f"not {float(self.k):g}"
            )
        if self.bits is not None and self.bits and self.bits not in BITS:
            raise ParameterError("bits are 0 (no residual) or 2 to 16")
        if self.bits is not None and self.step is not None:
            raise ParameterError("give the bits or the step of the residual, not both")
        if self.force_error and self.max_error.kind == "range":
            raise ParameterError(
                "force_error=True would do nothing: give a max_error in a unit or in lsb"
            )
        if not (isinstance(self.cutoff_hz, Real) and 0 < self.cutoff_hz < inf):
            raise ParameterError("the cutoff is a positive frequency")
        if self.preset == "perceptual":
            self._check_quality()
        if self.cluster is not None and self.cluster <= 0:
            raise ParameterError("the cluster length must be positive")

    def _check_quality(self) -> None:
        given = [name for name in TARGETS if getattr(self, name) is not None]
        if len(given) > 1:
            raise ParameterError(f"give one of {', '.join(TARGETS)}")
        if given and not self.texture:
            raise ParameterError("texture=False leaves no texture, so give no quality for it")
        if not self.texture and self.cutoff_hz != LF_CUTOFF_HZ:
            raise ParameterError("texture=False leaves no texture, so give no cutoff_hz for it")
        if self.synthetic_texture and not self.texture:
            raise ParameterError("give texture=False or synthetic_texture, not both")
        if self.synthetic_texture and given:
            raise ParameterError(f"a synthetic texture has no {given[0]}: give one of both")
        if self.texture_codec is not None:
            if self.synthetic_texture or not self.texture:
                raise ParameterError("texture_codec needs a texture that is coded")
            if self.texture_codec not in TEXTURE_CODECS:
                raise ParameterError(f"the codec of textures is one of {', '.join(TEXTURE_CODECS)}")
        if not (isinstance(self.weighting, Real) and 0 <= self.weighting <= 1):
            raise ParameterError("the weighting is an exponent from 0 to 1, such as 0.25")
        if self.weighting and (self.synthetic_texture or self.texture_codec == "LPCR"):
            raise ParameterError("only MDCT weights frequencies: leave the weighting out")
        if self.quality is not None and self.quality not in QUALITIES:
            raise ParameterError(f"the quality is one of {', '.join(QUALITIES)}")
        if self.snr is not None and not (isinstance(self.snr, Real) and 0 < self.snr < inf):
            raise ParameterError("the quality of the texture is a positive number of dB")
        if self.st_sim is not None and not (isinstance(self.st_sim, Real) and 0 < self.st_sim < 1):
            raise ParameterError("the ST-SIM of a texture is above 0 and below 1")
        if self.bitrate is not None and not (
            isinstance(self.bitrate, Real) and 0 < self.bitrate < inf
        ):
            raise ParameterError("the bit rate is a positive number of kbit/s")

    @property
    def target(self) -> TextureQuality:
        """The quality of textures. With a bit rate, the one that the search starts from."""
        return replace(self._quality, codec=self.texture_codec, weighting=float(self.weighting))

    @property
    def _quality(self) -> TextureQuality:
        if self.synthetic_texture:
            return TextureQuality(threshold_is_enough=False, synthetic=True)
        if self.snr is not None:
            return TextureQuality(self.snr, None, False, False)
        if self.st_sim is not None:
            return TextureQuality(None, self.st_sim, False, False)
        if self.bitrate is not None:
            return TextureQuality(threshold_is_enough=False)
        db = QUALITIES[self.quality or "medium"]
        enough = self.quality != "high"
        return TextureQuality(db, threshold_is_enough=enough)

    @classmethod
    def of(cls, preset: str = "lossless", **given: Any) -> Settings:
        """Settings of a preset. Options that are given and not None replace its defaults.

        Old names of presets still work, with a DeprecationWarning: see ALIASES.
        """
        if preset in ALIASES:
            warnings.warn(alias_note(preset), DeprecationWarning, stacklevel=2)
        preset, chosen = renamed(preset, given)
        if chosen.pop("fast", False) and chosen.setdefault("effort", "fast") != "fast":
            raise ParameterError(f"give fast=True or effort={chosen['effort']!r}, not both")
        for option, value in chosen.items():
            if value != _DEFAULTS.get(option) or not isinstance(value, (bool, str)):
                refuse_unused(preset, option)
        if chosen.get("effort") == "fast" and chosen.get("references"):
            raise ParameterError("effort='fast' looks for no references: leave references out")
        return cls(preset, **chosen)  # type: ignore[arg-type]

    def departures(self, names: Sequence[str]) -> list[str]:
        """Those of the fields ``names`` that are not at their default."""
        return [name for name in names if getattr(self, name) != _DEFAULTS[name]]

    @property
    def searches(self) -> Effort:
        """What the effort searches."""
        return EFFORTS[self.effort]

    @property
    def fast(self) -> bool:
        """Whether the effort is ``fast``."""
        return self.effort == "fast"

    @property
    def allows_any_error(self) -> bool:
        """Whether the largest error may be any share of a channel's range."""
        return self.force_error or self.max_error.kind == "range"

    @property
    def keeps_vectors(self) -> bool:
        """Whether the axes of a vector share a deadband, and so a track."""
        whole = self.preset == "perceptual" and self.felt == ALL and not self.texture
        return whole or self.preset == "paper" or self.vectors == "required"

    @property
    def deadband_floor(self) -> Tolerance:
        """The absolute threshold of preset perceptual."""
        return self.floor or RANGE_FLOOR

    def cluster_of(self, recording: Recording) -> Fraction:
        """Seconds of a cluster: as asked for; else as many as a long packet of the fastest channel
        has, from ten on; and never few ticks."""
        if self.cluster is not None:
            return self.cluster
        fastest = fastest_of(recording)
        longest = min(Fraction(ceil((LONG_FAST if self.fast else LONG) / fastest)), LONGEST_CLUSTER)
        seconds = longest if self.fast else max(ARCHIVE_CLUSTER, longest)
        return max(seconds, Fraction(ceil(LEAST_TICKS / fastest)))

    def describe(self) -> str:
        """The preset and the options that differ from it, in the words of the command line. Not
        the effort: it loses nothing, and a file of more effort is not larger for its name.

        The file's HEAD contains this text.
        """
        departs = [
            f"--{option} {written(getattr(self, name))}"
            for name, option in OPTIONS.items()
            if getattr(self, name) != _DEFAULTS[name]
            or (name == "max_error" and self.preset == "near-lossless")
        ]
        departs += [f"--felt {name}" for name in self.felt or ()]
        flags = {
            "--force-error": self.force_error,
            "--no-texture": not self.texture,
            "--synthetic-texture": self.synthetic_texture,
            "--no-references": not self.references,
        }
        return " ".join([self.preset, *departs, *(flag for flag, on in flags.items() if on)])


def fastest_of(recording: Recording) -> Fraction:
    """The highest rate, 1 without channels; equal fractions are not compared."""
    rates = {channel.rate_exact.as_integer_ratio() for channel in recording.channels}
    return max((Fraction(*rate) for rate in rates), default=Fraction(1))


def made_with(settings: Settings) -> str:
    """This program and the settings: hapfmt 0.1.0, where they are those of preset lossless."""
    text, own = settings.describe(), f"hapfmt {__version__}"
    return own if text == "lossless" else f"{own}: {text}"


def preset_of(encoder: object) -> str:
    """The preset in the text that hapfmt writes: hapfmt 0.1.0: near-lossless."""
    if not isinstance(encoder, str) or not encoder.startswith("hapfmt "):
        return ""
    return encoder.partition(INPUT)[0].partition(": ")[2].partition(REACHED)[0] or "lossless"


def lossy_preset(encoder: object) -> str:
    """The last lossy preset in the encoder's text; empty where there is none."""
    texts = encoder.split(INPUT) if isinstance(encoder, str) else []
    for preset in map(preset_of, texts):
        name, _ = renamed(preset.partition(" ")[0], {})
        if name in PRESETS and name != "lossless":
            return preset[:INPUT_SIZE]
    return ""


OPTIONS = {
    "k": "k",
    "floor": "floor",
    "quality": "quality",
    "snr": "snr",
    "st_sim": "st-sim",
    "bitrate": "bitrate",
    "texture_codec": "texture-codec",
    "weighting": "weighting",
    "bits": "bits",
    "step": "step",
    "max_error": "max-error",
    "cutoff_hz": "cutoff",
    "cluster": "cluster",
    "tolerance": "tolerance",
    "interpolation": "interpolation",
}

USED_BY: dict[str, tuple[str, tuple[Preset, ...]]] = {
    "max_error": ("max_error", ("near-lossless", "perceptual")),
    "force_error": ("force_error=True", ("near-lossless", "perceptual")),
    "k": ("k", ("perceptual", "paper")),
    "floor": ("floor", ("perceptual", "paper")),
    "felt": ("felt", ("perceptual",)),
    "texture": ("texture=False", ("perceptual",)),
    "quality": ("quality", ("perceptual",)),
    "snr": ("snr", ("perceptual",)),
    "st_sim": ("st_sim", ("perceptual",)),
    "bitrate": ("bitrate", ("perceptual",)),
    "synthetic_texture": ("synthetic_texture=True", ("perceptual",)),
    "texture_codec": ("texture_codec", ("perceptual",)),
    "weighting": ("weighting", ("perceptual",)),
    "bits": ("bits", ("paper",)),
    "step": ("step", ("paper",)),
    "cutoff_hz": ("cutoff_hz", ("perceptual", "paper")),
    "interpolation": ("interpolation", ("paper",)),
    "tolerance": ("tolerance", ("near-lossless", "perceptual", "paper")),
    "vectors": ("vectors", ("perceptual", "paper")),
    "references": ("references=False", ("lossless", "near-lossless", "perceptual")),
    "effort": ("effort", ("lossless", "near-lossless", "perceptual")),
}
"""Fields that not every preset uses: the option and those presets."""

TARGETS = ("quality", "snr", "st_sim", "bitrate")
"""Options that choose the quality of textures, each in place of the others."""

TEXTURE_OPTIONS = (*TARGETS, "synthetic_texture", "texture_codec", "weighting")
"""Options that only a channel with a texture uses."""

FELT_OPTIONS = ("k", "floor", "texture", "cutoff_hz", *TEXTURE_OPTIONS)
"""Options of preset perceptual that only a felt channel uses."""

_DEFAULTS: dict[str, Any] = {
    name: given.default for name, given in Settings.__dataclass_fields__.items()
}


def refuse_unused(preset: str, name: str) -> None:
    option, presets = USED_BY.get(name, ("", ()))
    if presets and preset in PRESETS and preset not in presets:
        raise ParameterError(f"{option} requires preset {' or '.join(presets)}, not {preset}")


def renamed(preset: str, given: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """The present name of a preset; the options that are given and not None, and those that an old
    name implies."""
    name, implied = ALIASES.get(preset, (preset, {}))
    return name, {**implied, **{key: value for key, value in given.items() if value is not None}}


def alias_note(preset: str) -> str:
    """One line on an old name of a preset; empty where the name is not old."""
    if preset not in ALIASES:
        return ""
    name, implied = ALIASES[preset]
    options = "".join(
        [
            " with texture=False" * (not implied.get("texture", True)),
            " and felt='all'" * ("felt" in implied),
        ]
    )
    return f"preset {preset} is now called {name}{options}"


def share(value: Any) -> Fraction:
    """A Weber fraction: a number, or a text such as "10%" or "0.1"."""
    if isinstance(value, str) and value.strip().endswith("%"):
        return exact(value.strip()[:-1].strip()) / 100
    return exact(value)


def written(value: object) -> str:
    return text_of(value) or "" if isinstance(value, Tolerance) else str(value)


def amount(value: Any) -> Tolerance | None:
    """An amount as the caller gives it: None, a Tolerance, its text, or a number in the unit."""
    if value is None or isinstance(value, Tolerance):
        return value
    return Tolerance.parse(value) if isinstance(value, str) else Tolerance(float(exact(value)))


def text_of(amount: Tolerance | None) -> str | None:
    """What Tolerance.parse reads back."""
    if amount is None:
        return None
    if amount.kind == "range":
        return f"{float(Fraction(repr(amount.value)) * 100)!r}%"
    return f"{amount.value!r}{'lsb' if amount.kind == 'lsb' else amount.unit}"


def counts_of(amount: Tolerance, calibration: Calibration, extent: int, unit: str = "") -> Fraction:
    """An amount in counts; ``extent`` is the largest count minus the smallest, glitches left
    out; ``unit`` is the channel's."""
    if amount.kind == "lsb":
        return Fraction(amount.value)
    if amount.kind == "range":
        return Fraction(amount.value) * extent
    return Fraction(amount.in_unit(unit)) / abs(calibration.step)


def whole_counts(amount: Fraction, limit: int) -> int:
    """Rounded down, at least 1, at most ``limit``."""
    return min(max(int(amount), 1), limit)


__all__ = ["PRESETS", "Settings", "counts_of", "text_of", "whole_counts"]
