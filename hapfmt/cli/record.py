"""hapfmt record: records a stream from standard input."""

from __future__ import annotations

import os
import select
import signal
import stat
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from fractions import Fraction
from types import FrameType
from typing import TYPE_CHECKING, Any, BinaryIO

import click

from ..errors import ParameterError
from ..numbers import counted
from . import screen
from .common import (
    AmountType,
    FileIdType,
    FractionType,
    PresetType,
    ShareType,
    echo_json,
    force_option,
    json_option,
    labels_option,
    standard_input,
    tell_no_report,
    unit_option,
)
from .screen import Verb, complain, note, say

if TYPE_CHECKING:
    from ..writing.recorder import Recorder, Status
    from ..writing.streams import Header, OnBadLine

PIECE = 1 << 16
"""Most bytes taken from the stream at once."""

SHOWN_S = 0.5
"""Seconds between two lines of status."""

NAMED = 10
"""Most channels that a line names."""

LOST = 3
"""Exit code: done with loss (SPEC clause 13)."""


@click.command(cls=Verb)
@click.argument("target", metavar="OUT")
@click.option(
    "-i",
    "--input",
    "source",
    default="-",
    metavar="FILE",
    help="File to read [-, standard input].",
)
@click.option("--rate", type=FractionType(), help="Ticks per second of a bare table.")
@labels_option
@unit_option
@click.option("--lsb", type=float, help="Round a bare table to multiples of this step.")
@click.option(
    "--preset",
    type=PresetType(["lossless", "near-lossless", "perceptual"]),
    default="lossless",
    show_default=True,
    help="As of encode; texture needs the whole recording, so perceptual needs --no-texture.",
)
@click.option("--fast", is_flag=True, default=None, help="lossless: faster, 7 % larger.")
@click.option(
    "--max-error",
    type=AmountType(),
    help="near-lossless: 0.01, 2lsb [0.1% of the range so far].",
)
@click.option(
    "--force-error", is_flag=True, default=None, help="Allow a --max-error above 10 % of a range."
)
@click.option("--k", "k", type=ShareType(), help="perceptual: Weber fraction [10%].")
@click.option("--floor", type=AmountType(), help="perceptual: absolute threshold: 10mN, 2lsb.")
@click.option(
    "--felt", multiple=True, metavar="CHANNEL|all", help="perceptual: a channel that is felt too."
)
@click.option(
    "--no-texture", "texture", flag_value=False, default=None, help="perceptual: no texture."
)
@click.option(
    "--cluster",
    type=FractionType(),
    help="Seconds in a cluster; a crash loses at most one cluster [1].",
)
@click.option(
    "--fsync",
    default="cluster",
    show_default=True,
    help="When to wait for the disk: cluster, close, never, or a number of seconds.",
)
@click.option(
    "--on-full",
    type=click.Choice(["block", "drop", "raise"]),
    default="block",
    show_default=True,
    help="If the encoder is too slow: block the stream, drop samples, or stop.",
)
@click.option(
    "--on-bad-line",
    type=click.Choice(["gap", "stop"]),
    help="If a line cannot be used: leave a gap, or stop [stop for a file, gap for a device].",
)
@click.option("--append", is_flag=True, help="Append to OUT.")
@click.option(
    "--at",
    help="With --append: time of the first sample, in seconds, or now (by the epoch of OUT).",
)
@click.option("--clock-maps", is_flag=True, help="Fit a map to each clock at the end.")
@click.option(
    "--canonical",
    type=FileIdType(),
    metavar="FILE_ID",
    help="The same input gives the same bytes; FILE_ID replaces the random file id.",
)
@force_option
@json_option
def record(
    target: str,
    source: str,
    rate: Fraction | None,
    labels: str | None,
    unit: str | None,
    lsb: float | None,
    preset: str,
    fsync: str,
    on_bad_line: OnBadLine | None,
    append: bool,
    force: bool,
    as_json: bool,
    **given: Any,
) -> int:
    """Record the stream on standard input into OUT, cluster by cluster, until it ends or Ctrl-C.

    \b
    sensor | hapfmt record touch.hapf --rate 1000 --labels x,y,z --unit N
    sensor | hapfmt record touch.hapf --append --rate 1000 --labels x,y,z --unit N

    Two kinds of streams, lines of text and binary frames, are described in docs/streams.md.
    """
    from ..encoder.settings import Settings, renamed
    from ..writing.recorder import Recorder
    from ..writing.start import sampled
    from ..writing.streams import BareTable, InputStream

    given["felt"] = given["felt"] or None
    chosen = ("fast", "max_error", "force_error", "k", "floor", "felt", "texture")
    preset, asked = renamed(preset, {name: given.pop(name) for name in chosen})
    settings = Settings.of(preset, **asked)
    tell_no_report(target, {"--json": as_json})
    options = {**given, "append": append, "force": force, "fsync": fsync_of(fsync)}

    def begin(header: Header) -> Recorder:
        for each in header.notes:
            note(each)
        file: str | BinaryIO = sys.stdout.buffer if target == "-" else target
        more = header.given if not append else {}
        recorder = Recorder(
            file, header.inputs, settings, metadata=header.metadata, **options, **more
        )
        new = [member.input for member in recorder.lanes.members if append and member.is_new]
        if new:
            told = [f"{each.label} ({sampled(each.rate, each.unit)})" for each in new[:NAMED]]
            rest = ["..."] if len(new) > NAMED else []
            note(f"adds {counted(len(new), 'channel')} to the file: {', '.join(told + rest)}")
        return recorder

    table = BareTable(rate, labels.split(",") if labels else (), unit, lsb)
    began = time.monotonic()
    with warnings.catch_warnings(), ExitSignals() as stopping, opened(source) as descriptor:
        warnings.simplefilter("ignore", RuntimeWarning)
        is_file = stat.S_ISREG(os.fstat(descriptor).st_mode)
        stream = InputStream(begin, table, on_bad_line, usual="stop" if is_file else "gap")
        failed = True
        try:
            with RecordStatus(stream) as line:
                for data in pieces(descriptor, stopping, line):
                    stream.feed(data)
            if not stopping.asked:
                stream.finish()
            failed = False
        finally:
            with ExitStack() as last:
                if failed and stream.recorder is not None:
                    last.callback(tell_kept, target, stream.recorder)
                stream.close()
    recorder = stream.recorder
    if recorder is None:
        raise ParameterError("stopped before the stream named a channel; nothing was written")
    status, (bad_count, first_bad) = recorder.status(), stream.bad_lines
    if as_json and target != "-":
        labels_ = [given.label for given in recorder.inputs]
        more = {"wall_s": time.monotonic() - began, "channels": labels_, "bad_lines": bad_count}
        echo_json({**status.as_json(), **more})
    else:
        say(f"{target}: {summary(status)}", err=target == "-")
    if bad_count:
        complain(f"{counted(bad_count, 'line')} could not be used; the first: {first_bad}")
    if status.dropped:
        complain(dropped(status))
    return LOST if status.dropped or bad_count else 0


def tell_kept(target: str, recorder: Recorder) -> None:
    """What is in the file although the recording ended with an error."""
    say(f"kept in {target}: {summary(recorder.status())}", err=True)


def fsync_of(text: str) -> str | float:
    with suppress(ValueError):
        return float(text)
    return text


def summary(status: Status) -> str:
    return (
        f"{status.seconds:.6g} s, {counted(status.written, 'sample')}, "
        f"{counted(status.cluster_count, 'cluster')}, {status.file_size} bytes"
    )


def dropped(status: Status) -> str:
    """The dropped samples of the first few channels."""
    parts = [f"{label} {count}" for label, count in list(status.dropped.items())[:NAMED]]
    return f"dropped {counted(status.dropped_count, 'sample')}: {', '.join(parts)}"


class ExitSignals:
    """SIGINT, SIGTERM and SIGHUP close the file and end the recording; a second one ends at once.

    SIGHUP comes when the terminal or the connection goes. It stays ignored under nohup.
    """

    def __init__(self) -> None:
        self.asked = False
        self.before: dict[int, Any] = {}

    def __enter__(self) -> ExitSignals:
        self.reader, self.writer = os.pipe()
        for number in exit_signals():
            with suppress(ValueError):  # not in the main thread
                self.before[number] = signal.signal(number, self.ask)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self.before.items():
            signal.signal(number, handler)
        os.close(self.reader)
        os.close(self.writer)

    def ask(self, _number: int, _frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        os.write(self.writer, b"!")
        if os.name == "nt":
            raise KeyboardInterrupt


def exit_signals() -> list[int]:
    numbers: list[int] = [signal.SIGINT, signal.SIGTERM]
    hangup = getattr(signal, "SIGHUP", None)
    if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
        numbers.append(hangup)
    return numbers


@contextmanager
def opened(source: str) -> Iterator[int]:
    """A descriptor to read from."""
    if source == "-":
        yield standard_input().fileno()
        return
    descriptor = os.open(source, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def pieces(descriptor: int, stopping: ExitSignals, line: RecordStatus) -> Iterator[bytes]:
    """Pieces of the input as they arrive, until its end or a signal."""
    while not stopping.asked:
        if os.name != "nt":
            ready = select.select([descriptor, stopping.reader], [], [], line.wait_s)[0]
            line.tell()
            if descriptor not in ready:
                continue
            data = os.read(descriptor, PIECE)
        else:
            # There nothing waits for a pipe and a signal together.
            try:
                data = os.read(descriptor, PIECE)
            except KeyboardInterrupt:
                return
            line.tell()
        if not data:
            return
        yield data


class RecordStatus(screen.StatusLine):
    def __init__(self, stream: Any) -> None:
        super().__init__()
        self.stream = stream
        self.wait_s = SHOWN_S if self.shown else None
        self.next = time.monotonic() + SHOWN_S

    def tell(self) -> None:
        recorder = self.stream.recorder
        if not self.shown or recorder is None or time.monotonic() < self.next:
            return
        self.next = time.monotonic() + SHOWN_S
        status = recorder.status()
        text = f"{summary(status)}, {status.queued_size >> 10} KiB waiting"
        if status.dropped:
            text += f", {counted(status.dropped_count, 'sample')} dropped"
        self.show(text)
