"""Where a study is felt; nothing here knows which condition it plays."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from ...errors import DeviceError
from .description import Study
from .prepare import Prepared

if TYPE_CHECKING:
    from ...replay.process.report import ReplayReport
    from ...replay.profile.model import Profile
    from ...replay.render import Renderer
    from .sound import Card, Level


class Felt(NamedTuple):
    fault: str = ""
    """What kept it from being felt whole."""
    skipped: int = 0
    """Frames that came too late for a device, and were left out."""


class Output(Protocol):
    @property
    def told(self) -> dict[str, Any]:
        """For the answers: what must be the same when they are gone on with."""

    def play(self, path: Path, label: str) -> Felt:
        """Until it has been felt; ``label`` is what a subject may know of it."""


class ChannelMap(NamedTuple):
    """Which channels drive which actuators, as hapfmt replay takes it."""

    given: tuple[str, ...] = ()
    """Texts "CHANNEL=ACTUATOR"."""
    ignored: tuple[str, ...] = ()
    by_order: bool = False

    @property
    def told(self) -> dict[str, Any]:
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
    def told(self) -> dict[str, Any]:
        return {"kind": "dry-run", **(told_of(self.profile) if self.profile else {})}

    def play(self, path: Path, label: str) -> Felt:  # noqa: ARG002
        if self.profile is None:
            return Felt()
        from ...reading.reader import Reader
        from ...replay.process.virtual import rehearse

        with Reader(str(path)) as reader:
            renderer = render(reader, self.profile, self.mapping)
            return end_of(rehearse(renderer, self.profile, [], gain=self.gain))


class Device:
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
    def told(self) -> dict[str, Any]:
        profile = told_of(self.profile)
        return {"kind": "device", **profile, "gain": self.gain, **self.mapping.told}

    def play(self, path: Path, label: str) -> Felt:  # noqa: ARG002
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


def end_of(report: ReplayReport) -> Felt:
    if report.outcome == "interrupted":
        raise SignalError(report.signal or 2)
    if report.outcome == "device-lost":
        raise DeviceError(report.reason or "the device has gone")
    if report.outcome == "clean":
        return Felt(skipped=report.skipped)
    return Felt(report.reason or report.outcome, report.skipped)


class Sound:
    """One channel of a sound card, or files for another player: the same signals."""

    def __init__(self, study: Study, prepared: Prepared) -> None:
        from .sound import chosen, level_of

        self.labels: dict[Path, str] = {}
        self.levels: dict[Path, Level] = {}
        """By the files of their sessions."""
        for session in study.sessions:
            reference = prepared.file(session.name, study.reference.name)
            level = level_of(chosen(read(reference), session.channel))
            for each in study.conditions:
                path = prepared.file(session.name, each.name)
                self.levels[path], self.labels[path] = level, session.channel

    def signal(self, path: Path) -> Any:
        from .sound import chosen, signal

        return signal(chosen(read(path), self.labels[path]), self.levels[path])


class SoundCard(Sound):
    def __init__(self, study: Study, prepared: Prepared, card: Card) -> None:
        super().__init__(study, prepared)
        self.card = card

    @property
    def told(self) -> dict[str, Any]:
        return {"kind": "sound", "channel": self.card.channel, "device": self.card.device}

    def play(self, path: Path, label: str) -> Felt:  # noqa: ARG002
        self.card.play(self.signal(path))
        return Felt()


class WavFiles(Sound):
    """reference.wav and trial 3.wav in a folder, for whatever plays them."""

    def __init__(self, study: Study, prepared: Prepared, folder: Path) -> None:
        super().__init__(study, prepared)
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    told = {"kind": "wav"}  # noqa: RUF012

    def play(self, path: Path, label: str) -> Felt:
        from ...convert import save
        from .sound import wav

        save(wav(self.signal(path)), str(self.folder / f"{label}.wav"), force=True)
        return Felt()


def read(path: Path) -> Any:
    from ...reading.reader import Reader

    with Reader(str(path)) as reader:
        return reader.read()
