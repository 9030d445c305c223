"""What a sound card gets: one channel of a recording as numbers in [-1, 1].

A sound card passes no constant, and knows no newtons. So the mean of the reference is taken away
and its largest deviation becomes half of full scale, and the same numbers serve every condition of
the session: what is weaker in the file is weaker at the skin.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import MissingExtraError, ParameterError
from ...recording import Calibration, Channel, Recording

RATE_HZ = 48_000
HEADROOM = 0.5
"""Of the reference's largest value: a condition may overshoot by as much again."""
RAMP_S = 0.02
"""Raised cosine at both ends, against clicks."""
PCM_24 = Calibration(1, 0, 1 << 23)
LONGEST_RATIO = 10_000
"""Rates are made of whole numbers up to this; 10 000 / 9 999 is 0.01 % off, less than any card."""


class Level(NamedTuple):
    """Played is (x - offset) * scale."""

    offset: float
    scale: float


def level_of(reference: Channel) -> Level:
    x = reference.samples()
    if not x.size or not np.isfinite(x).all():
        raise ParameterError(f"channel {reference.label!r} has nothing that can be played")
    offset = float(np.mean(x))
    largest = float(np.max(np.abs(x - offset)))
    return Level(offset, HEADROOM / largest if largest > 0 else 0.0)


def signal(channel: Channel, level: Level) -> NDArray[np.float64]:
    """[samples] at RATE_HZ in [-1, 1]. Gaps are silent; each stretch between two gaps is resampled
    by itself."""
    from scipy.signal import resample_poly

    ratio = (RATE_HZ / channel.rate_exact).limit_denominator(LONGEST_RATIO)
    if not ratio:
        raise ParameterError(f"{channel.rate_exact} Hz is too slow for a sound")
    x = (channel.filled() - level.offset) * level.scale
    y = np.zeros(ceil(x.size * ratio))
    for span in channel.coverage:
        # From a tick that falls on a sample of the sound, so that all stretches keep their times.
        origin = span.start // ratio.denominator * ratio.denominator
        part = np.zeros(span.stop - origin)
        part[span.start - origin :] = np.nan_to_num(x[span.start : span.stop])
        first, stop = ceil(span.start * ratio), ceil(span.stop * ratio)
        made = resample_poly(part, ratio.numerator, ratio.denominator)
        y[first:stop] = made[first - int(origin * ratio) :][: stop - first]
    count = min(round(RAMP_S * RATE_HZ), y.size // 2)
    if count:
        ramp = (1 - np.cos(np.pi * (np.arange(count) + 0.5) / count)) / 2
        y[:count] *= ramp
        y[-count:] *= ramp[::-1]
    return np.clip(y, -1.0, 1.0)


def chosen(recording: Recording, label: str) -> Channel:
    """The channel of that label, or the first."""
    if not recording.channels:
        raise ParameterError("a recording without channels")
    return recording.channel(label) if label else recording.channels[0]


def wav(y: NDArray[np.float64]) -> Recording:
    """24 bits."""
    counts = np.clip(np.floor(y * (1 << 23) + 0.5), -(1 << 23), (1 << 23) - 1).astype(np.int32)
    channel = Channel(counts, Fraction(RATE_HZ), calibration=PCM_24, label="ch1")
    return Recording((channel,))


def sounddevice() -> Any:
    try:
        import sounddevice
    except (ImportError, OSError):  # OSError: the package without its library
        raise MissingExtraError("sounddevice", "sound") from None
    return sounddevice


def parse_card(text: str) -> tuple[int, str | int | None]:
    """CHANNEL or CHANNEL/DEVICE: the channel from 1, and a device by number or part of its name."""
    number, slash, device = text.partition("/")
    if not number.isdecimal() or not 1 <= int(number) <= 256 or (slash and not device):
        raise ParameterError(
            f"{text!r} is not an output of a sound card: CHANNEL or CHANNEL/DEVICE, such as 1 or "
            "2/USB Audio"
        )
    return int(number), int(device) if device.isdecimal() else device or None


class Card:
    """One output channel of one device."""

    def __init__(self, channel: int, device: str | int | None) -> None:
        self.channel, self.device = channel, device
        self.package = sounddevice()
        try:
            self.package.check_output_settings(
                device=device, channels=channel, samplerate=RATE_HZ, dtype="float32"
            )
        except (ValueError, self.package.PortAudioError) as error:
            raise ParameterError(
                f"no sound card plays channel {channel} of {device or 'the default device'} at "
                f"{RATE_HZ} Hz: {error}"
            ) from None

    def play(self, y: NDArray[np.float64]) -> None:
        """Until it has been played; silent at once where that is broken off."""
        try:
            self.package.play(
                y.astype(np.float32)[:, None],
                RATE_HZ,
                device=self.device,
                mapping=[self.channel],
                blocking=True,
            )
        finally:
            self.package.stop()
