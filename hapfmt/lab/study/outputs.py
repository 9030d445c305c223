"""Outputs of a study: device, sound card, WAV file, or none. They do not know the condition.

A sound card gets one channel of a recording as numbers in [-1, 1]. It passes no constant and has no
physical unit. So the mean of the reference is subtracted, and its largest deviation is scaled to
half of full scale. All conditions of a session use this offset and scale. A condition that is
weaker in its file is therefore weaker at the skin.
"""

from __future__ import annotations

import hashlib
from fractions import Fraction
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import DeviceError, MissingExtraError, ParameterError
from ...recording import Calibration, Channel, Recording
from .description import Study
from .prepare import Prepared

if TYPE_CHECKING:
    from ...replay.process.loop import ReplayReport
    from ...replay.profile.model import Profile
    from ...replay.render import Renderer

RATE_HZ = 48_000
HEADROOM = 0.5
"""Level of the reference's largest value: a condition may overshoot to twice that value."""
RAMP_S = 0.02
"""Raised cosine at both ends, against clicks."""
PCM_24 = Calibration(1, 0, 1 << 23)
LONGEST_RATIO = 10_000
"""Rates are made of whole numbers up to this; 10 000 / 9 999 is 0.01 % off, less than any card."""


class Scaling(NamedTuple):
    """Played is (x - offset) * scale."""

    offset: float
    scale: float


def level_of(reference: Channel) -> Scaling:
    x = reference.samples()
    if not x.size or not np.isfinite(x).all():
        raise ParameterError(f"channel {reference.label!r} has nothing that can be played")
    offset = float(np.mean(x))
    largest = float(np.max(np.abs(x - offset)))
    return Scaling(offset, HEADROOM / largest if largest > 0 else 0.0)


def signal(channel: Channel, level: Scaling) -> NDArray[np.float64]:
    """[samples] at RATE_HZ in [-1, 1]. Gaps are silent; each stretch between two gaps is resampled
    by itself."""
    try:
        from scipy.signal import resample_poly
    except ImportError:
        raise MissingExtraError("scipy", "sound") from None
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


class FeltStimulus(NamedTuple):
    fault: str = ""
    """What kept it from being felt whole."""
    skipped: int = 0
    """Frames that came too late for a device, and were left out."""


class StudyOutput(Protocol):
    @property
    def description(self) -> dict[str, Any]:
        """Stored with the answers; must be equal when a session is resumed."""

    def play(self, path: Path, label: str) -> FeltStimulus:
        """Until it has been felt; ``label`` is what a subject may know of it."""


class ChannelMap(NamedTuple):
    """Which channels drive which actuators, as hapfmt replay takes it."""

    given: tuple[str, ...] = ()
    """Texts "CHANNEL=ACTUATOR"."""
    ignored: tuple[str, ...] = ()
    by_order: bool = False

    @property
    def description(self) -> dict[str, Any]:
        by_order = self.by_order
        found = {"channels": list(self.given), "ignored": list(self.ignored), "by_order": by_order}
        return {name: value for name, value in found.items() if value}


NO_MAP = ChannelMap()


class SignalError(KeyboardInterrupt):
    """A signal ended a replay, by a ramp to rest."""

    def __init__(self, number: int) -> None:
        super().__init__(f"signal {number}")
        self.number = number


class Nowhere:
    """A dry run: nothing is felt. With a profile all is rendered as the device would get it, so
    what cannot be played is found."""

    def __init__(
        self,
        profile: Profile | None = None,
        gain: float | None = None,
        mapping: ChannelMap = NO_MAP,
    ) -> None:
        self.profile, self.gain, self.mapping = profile, gain, mapping

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "dry-run", **(told_of(self.profile) if self.profile else {})}

    def play(self, path: Path, label: str) -> FeltStimulus:  # noqa: ARG002
        if self.profile is None:
            return FeltStimulus()
        from ...reading.reader import Reader
        from ...replay.process.loop import rehearse

        with Reader(str(path)) as reader:
            renderer = render(reader, self.profile, self.mapping)
            return end_of(rehearse(renderer, self.profile, [], gain=self.gain))


class DeviceOutput:
    """A haptic device; ``config`` is what open_sink takes. Read docs/safety.md first."""

    def __init__(
        self,
        profile: Profile,
        config: dict[str, Any],
        gain: float | None = None,
        mapping: ChannelMap = NO_MAP,
        watchdog: bool = True,
    ) -> None:
        self.profile, self.config, self.mapping = profile, config, mapping
        self.gain = profile.gain if gain is None else gain
        self.watchdog = watchdog

    @property
    def description(self) -> dict[str, Any]:
        profile = told_of(self.profile)
        return {"kind": "device", **profile, "gain": self.gain, **self.mapping.description}

    def play(self, path: Path, label: str) -> FeltStimulus:  # noqa: ARG002
        from ...reading.reader import Reader
        from ...replay.process.player import play

        with Reader(str(path)) as reader:
            renderer = render(reader, self.profile, self.mapping)
            return end_of(
                play(renderer, self.profile, self.config, gain=self.gain, watchdog=self.watchdog)
            )


def told_of(profile: Profile) -> dict[str, Any]:
    """A profile that was changed is another one."""
    digest = hashlib.sha256(profile.text.encode()).hexdigest()
    return {"profile": profile.name, "profile_sha256": digest}


def render(reader: Any, profile: Profile, mapping: ChannelMap) -> Renderer:
    from ...replay.render import Renderer, assign

    given, ignored, by_order = mapping
    assignment = assign(reader, profile, given, by_order=by_order, ignore=ignored)
    return Renderer(reader, profile, assignment)


def plan(path: Path, profile: Profile, mapping: ChannelMap) -> list[str]:
    """What drives which actuator, in words. An error where the file cannot be played."""
    from ...reading.reader import Reader

    with Reader(str(path)) as reader:
        return render(reader, profile, mapping).plan


def find_device(profile: Profile, path: str | None) -> dict[str, Any]:
    """The device that is connected, for open_sink."""
    from ...replay.sinks.hid import find

    return {"kind": "hid", "path": find(profile, path).place}


def end_of(report: ReplayReport) -> FeltStimulus:
    if report.outcome == "interrupted":
        raise SignalError(report.signal or 2)
    if report.outcome == "device-lost":
        raise DeviceError(report.reason or "the device has gone")
    if report.outcome == "clean":
        return FeltStimulus(skipped=report.skipped)
    return FeltStimulus(report.reason or report.outcome, report.skipped)


class Sound:
    """One channel of a sound card, or files for another player: the same signals."""

    def __init__(self, study: Study, prepared: Prepared) -> None:

        self.labels: dict[Path, str] = {}
        self.levels: dict[Path, Scaling] = {}
        """By the files of their sessions."""
        for session in study.sessions:
            reference = prepared.file(session.name, study.reference.name)
            level = level_of(chosen(read(reference), session.channel))
            for each in study.conditions:
                path = prepared.file(session.name, each.name)
                self.levels[path], self.labels[path] = level, session.channel

    def signal(self, path: Path) -> Any:

        return signal(chosen(read(path), self.labels[path]), self.levels[path])


class SoundCard(Sound):
    def __init__(self, study: Study, prepared: Prepared, card: Card) -> None:
        super().__init__(study, prepared)
        self.card = card

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "sound", "channel": self.card.channel, "device": self.card.device}

    def play(self, path: Path, label: str) -> FeltStimulus:  # noqa: ARG002
        self.card.play(self.signal(path))
        return FeltStimulus()


class WavFiles(Sound):
    """reference.wav and trial 3.wav in a folder, for whatever plays them."""

    def __init__(self, study: Study, prepared: Prepared, folder: Path) -> None:
        super().__init__(study, prepared)
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    description = {"kind": "wav"}  # noqa: RUF012

    def play(self, path: Path, label: str) -> FeltStimulus:
        from ...convert import save

        save(wav(self.signal(path)), str(self.folder / f"{label}.wav"), force=True)
        return FeltStimulus()


def read(path: Path) -> Any:
    from ...reading.reader import Reader

    with Reader(str(path)) as reader:
        return reader.read()
