"""hapfmt replay: sends a recording to the actuators of a haptic device."""

from __future__ import annotations

import hashlib
import json
import shlex
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import click

from ..errors import HapfmtError, MissingExtraError, ParameterError
from . import screen
from .common import (
    SHOWN_LINES,
    FractionType,
    echo_json,
    force_option,
    input_of,
    json_option,
    memory_option,
    progress,
    refuse_idle,
    start_option,
    stop_option,
    tell_some,
)
from .screen import Verb, complain, printable, say, table

if TYPE_CHECKING:
    from ..limits import Limits
    from ..reading.reader import Reader
    from ..replay.process.loop import ReplayReport
    from ..replay.process.player import PlayerStatus
    from ..replay.profile.model import Frame, FrameSink, HidReport, Profile
    from ..replay.render import Renderer
    from ..replay.sinks.record import RecordSink

ENDLESS = 0
"""Value of --loop without a number."""

METERED = 1000
"""Frames from one step of the progress bar to the next."""

MAPPING = ("--map", "--ignore", "--map-by-order")

ERROR, LOST = 1, 3
"""Exit codes: an error, done with loss (SPEC clause 13)."""


@click.command(cls=Verb)
@click.argument("file", metavar="FILE")
@click.option(
    "--device",
    "device",
    required=True,
    metavar="PROFILE",
    help="The profile of the device, with its limits: a built-in one (hapfmt profile list) or a "
    "TOML file (docs/profiles.md).",
)
@click.option(
    "--path",
    metavar="DEVICE_PATH",
    help="The device to use if several fit the profile; hapfmt devices lists them.",
)
@click.option(
    "--dry-run", is_flag=True, help="Send nothing: print the packets, or --record the values."
)
@start_option
@stop_option
@click.option(
    "--loop",
    "loops",
    is_flag=False,
    flag_value=str(ENDLESS),
    default=1,
    type=click.IntRange(ENDLESS),
    metavar="[N]",
    help="Play N times. Without N, as the last option, play until Ctrl-C.",
)
@click.option(
    "--speed", type=FractionType(), default="1", metavar="X", help="Factor on the speed [1]."
)
@click.option(
    "--gain",
    type=click.FloatRange(0, 1, min_open=True),
    metavar="GAIN",
    help="Scale all outputs, above 0 and at most 1 [default: of the profile, mostly 0.5].",
)
@click.option(
    "--map",
    "channels",
    multiple=True,
    metavar="A=1,B=2",
    help="Play these channels alone: CHANNEL=ACTUATOR, each by its name or number. Without it the "
    "words of label, body site or axis must name one actuator for each channel.",
)
@click.option(
    "--ignore",
    multiple=True,
    metavar="A,B",
    help="Leave these channels out, by label or number.",
)
@click.option(
    "--map-by-order",
    is_flag=True,
    help="Assign channels to actuators by unit and order, whatever their names.",
)
@click.option(
    "--record",
    "target",
    metavar="OUT",
    help="Write the values that are sent to OUT, .hapf or .csv.",
)
@click.option(
    "--no-watchdog", is_flag=True, help="Run without the watchdog, for devices that open only once."
)
@force_option
@memory_option
@json_option
def replay(
    file: str,
    device: str,
    path: str | None,
    dry_run: bool,
    start: Fraction | None,
    stop: Fraction | None,
    loops: int,
    speed: Fraction,
    gain: float | None,
    channels: tuple[str, ...],
    ignore: tuple[str, ...],
    map_by_order: bool,
    target: str | None,
    no_watchdog: bool,
    force: bool,
    as_json: bool,
    max_memory: Limits,
) -> int:
    """Send what FILE recorded to the actuators of a haptic device, within the limits of its
    profile. It moves a machine that touches a person: read docs/safety.md first.

    \b
    hapfmt replay touch.hapf --device glove5 --map 'normal force=thumb' --dry-run
    hapfmt replay hand.hapf --device glove5 --start 2 --stop 5 --gain 0.2

    Replay does not guess: the words of a channel's label, body site or axis must name one actuator.
    Otherwise nothing is played, and the message lists command lines that would play. The assignment
    and its reasons are printed before anything moves.

    In a terminal: space pauses and goes on, left and right seek by five seconds, q ends; Ctrl-C
    ends too, by a ramp to rest. Exit codes beyond those of all verbs: 5 stopped since it was late,
    6 device lost, 128 + n ended by signal n.
    """
    from ..reading.reader import Reader
    from ..replay.profile.parse import load_profile
    from ..replay.render import Renderer, assign

    if dry_run:
        reason = "is for a device, and --dry-run opens none"
        refuse_idle(reason, path=path, no_watchdog=no_watchdog)
    if target is None:
        refuse_idle("requires --record", force=force)
    profile = load_profile(device)
    sink_config = {} if dry_run else config_of(profile, path)
    with Reader(input_of(file), limits=max_memory) as reader:
        labels = [ref.label for ref in reader.channels]
        assignment = assign(
            reader,
            profile,
            parts(channels, labels),
            by_order=map_by_order,
            ignore=parts(ignore, labels),
            command=command_line(),
        )
        renderer = Renderer(reader, profile, assignment, start, stop, speed, loops)
        refuse_empty(renderer)
        given = profile.gain if gain is None else gain
        played = {
            "gain": given,
            "speed": str(speed),
            "channels": assigned(renderer),
            "reasons": reasons_of(renderer),
            "at_rest": renderer.resting,
            "kernels": renderer.kernels,
        }
        tell_plan(renderer, given)
        report, failure = None, None
        try:
            with recording(target, profile, played, reader, force, dry_run) as record:
                if dry_run:
                    report = rehearsed(renderer, given, record, as_json)
                else:
                    report = performed(renderer, sink_config, given, record, not no_watchdog)
        except (HapfmtError, OSError) as error:
            # The device has moved: report the replay first, then the error of its recording.
            if report is None:
                raise
            failure = error
        findings = [f"{reader.source.path or 'input'}: {each}" for each in reader.findings]
    if report.outcome != "clean":
        complain(report.reason or why(report, profile))
    tell_some([*findings, *report.lost, *report.said])
    code = report.exit_code or (LOST if findings else 0)
    if failure is not None:
        code = report.exit_code or ERROR
    if as_json:
        more = {"profile": profile.name, **played, "record": target, "exit_code": code}
        echo_json({**report.to_json(), **more, "notes": renderer.notes, "findings": findings})
    else:
        # A dry run prints only packets on standard output.
        tell_report(report, err=dry_run and target is None)
    if failure is not None:
        complain(f"the record of what was sent is lost: {failure}")
    return code


def parts(given: tuple[str, ...], labels: list[str]) -> list[str]:
    """The parts of A=1,B=2; a label may contain a comma."""
    return [
        part
        for text in given
        for part in (
            [text] if text in labels or text.rpartition("=")[0] in labels else text.split(",")
        )
    ]


def why(report: ReplayReport, profile: Profile) -> str:
    """The reason of an end without a message of its own."""
    if report.outcome == "late":
        held = 1000 * profile.timing.hold_s
        return f"stopped: a frame was later than the {held:g} ms that the profile allows"
    return report.outcome


def refuse_empty(renderer: Renderer) -> None:
    if renderer.start >= renderer.stop:
        raise ParameterError(
            f"no samples between {float(renderer.start):.6g} s and {float(renderer.stop):.6g} s; "
            f"the recording ends at {float(renderer.end):.6g} s"
        )


def assigned(renderer: Renderer) -> dict[str, str]:
    """Actuator -> channel."""
    actuators, refs = renderer.profile.actuators, renderer.refs
    return {
        actuators[route.actuator].name: refs[route.channel].label or f"channel {route.channel}"
        for route in renderer.routes
    }


def reasons_of(renderer: Renderer) -> dict[str, str]:
    """Actuator -> why its channel drives it."""
    actuators = renderer.profile.actuators
    return {actuators[route.actuator].name: route.reason for route in renderer.routes}


def command_line() -> str:
    """As typed but for the mapping, which the advice adds."""
    words, drop = ["hapfmt", "replay"], False
    for word in click.get_current_context().meta[screen.AS_TYPED]:
        if not drop and word.partition("=")[0] not in MAPPING:
            words.append(word)
        drop = not drop and word in ("--map", "--ignore")
    return shlex.join(map(printable, words))


def config_of(profile: Profile, path: str | None) -> dict[str, Any]:
    """The device to send to."""
    from ..replay.sinks.hid import find

    try:
        found = find(profile, path)
    except ParameterError as error:
        if isinstance(error, MissingExtraError):
            raise
        raise ParameterError(
            f"{error.message} (--path chooses one; --dry-run shows what would be sent, with none)"
        ) from error
    return {"kind": "hid", "path": found.place}


def recording(
    target: str | None,
    profile: Profile,
    played: dict[str, Any],
    reader: Reader,
    force: bool,
    dry_run: bool,
) -> AbstractContextManager[RecordSink | None]:
    """The recording of sent frames, if requested. A dry run gives the same bytes each time."""
    if target is None:
        return nullcontext()
    from ..replay.sinks.record import RecordSink

    source = reader.catalogue.uuid
    metadata = {**played, "source_uuid": source.hex if source else None}
    content = json.dumps([metadata, profile.text]).encode()
    canonical = int.from_bytes(hashlib.sha256(content).digest()[:8], "little") if dry_run else None
    return RecordSink(target, profile, metadata=metadata, force=force, canonical=canonical)


def rehearsed(
    renderer: Renderer, gain: float, record: FrameSink | None, as_json: bool
) -> ReplayReport:
    from ..replay.process.loop import rehearse
    from ..replay.sinks.dry import DryRunSink

    if record is None:
        sink = DryRunSink(sys.stdout, as_json=as_json)
        return rehearse(renderer, renderer.profile, [sink], gain=gain)
    with progress("rendering") as advance:
        meter = Meter(renderer, advance)
        return rehearse(renderer, renderer.profile, [record, meter], gain=gain)


class Meter:
    """A sink that shows the progress of a dry run."""

    def __init__(self, renderer: Renderer, advance: Callable[[int, int], None]) -> None:
        self.advance = advance
        seconds = (renderer.stop - renderer.start) / renderer.speed * max(renderer.loops, 1)
        self.total = int(seconds / renderer.profile.timing.period)

    def open(self) -> None:
        """Nothing is kept open."""

    def send(self, frame: Frame, reports: tuple[HidReport, ...]) -> None:  # noqa: ARG002
        if frame.number % METERED == 0:
            self.advance(min(frame.number, self.total), self.total)

    def close(self) -> None:
        """The caller that opened the meter closes it."""


def performed(
    renderer: Renderer,
    sink_config: dict[str, Any],
    gain: float,
    record: FrameSink | None,
    watchdog: bool,
) -> ReplayReport:
    from ..replay.process.player import TerminalKeys, play

    with ReplayStatus() as line, TerminalKeys() as keys:
        return play(
            renderer,
            renderer.profile,
            sink_config,
            gain=gain,
            record=record,
            on_status=line.tell,
            keys=keys,
            watchdog=watchdog,
        )


class ReplayStatus(screen.StatusLine):
    def tell(self, status: PlayerStatus) -> None:
        self.show(
            f"{status.state} {status.position_s:.1f} s, {status.sent} frames, "
            f"{status.skipped} skipped, at most {status.max_late_us:.0f} us late"
        )


def tell_plan(renderer: Renderer, gain: float) -> None:
    """Prints the plan before anything moves: assignments, limits, and unused channels."""
    profile = renderer.profile
    lines = [f"{profile.name}: gain {gain:g}, {float(1 / profile.timing.period):g} frames a second"]
    lines += [f"  {each}" for each in renderer.plan]
    lines += [f"note: {each}" for each in renderer.notes]
    lines += [f"left out: {each}" for each in renderer.left_out[:SHOWN_LINES]]
    for line in lines:
        say(line, err=True)


def tell_report(report: ReplayReport, err: bool) -> None:
    times = {"late": report.late, "writes": report.call}
    rows = [
        ["ended", report.outcome],
        ["frames", f"{report.sent} sent, {report.skipped} skipped, {report.neutral} neutral"],
        *([what, micros(found)] for what, found in times.items() if found),
        ["limited", f"{report.clamped} clamped, {report.slew_limited} slew-limited"],
        ["missing", f"{report.gap_samples} in gaps or between loops, {report.refused} not finite"],
        ["under-runs", str(report.under_runs)],
        *(["kernel", f"{kernel}: {names}"] for kernel, names in by_kernel(report).items()),
        *([what, got] for what, got in report.realtime.items()),
        *([["watchdog", report.watchdog]] if report.realtime else []),
        *(["left out", each] for each in report.left_out[:SHOWN_LINES]),
    ]
    table(["replay", ""], rows, err=err)


def by_kernel(report: ReplayReport) -> dict[str, str]:
    """Kernel -> the actuators that it served."""
    found: dict[str, list[str]] = {}
    for name, kernel in report.kernels.items():
        found.setdefault(kernel, []).append(name)
    return {kernel: ", ".join(names) for kernel, names in found.items()}


def micros(times: dict[str, float]) -> str:
    names = {"p50": "p50", "p99": "p99", "p999": "p99.9", "max": "max"}
    return ", ".join(f"{shown} {times[name]:.0f} us" for name, shown in names.items())
