"""Frames -> lines of text: the reports that a device would get.

Also a simulated device: it writes one JSON line per frame and can inject faults, for tests and
timing.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any, TextIO

from ...errors import DeviceError, DeviceGoneError, ParameterError
from ..profile.model import Frame, HidReport

PATH_WIDTH = len("feature")


class DryRunSink:
    """A line for each report: seconds since the start, path, bytes in hex; or JSON, with
    nanoseconds."""

    def __init__(self, stream: TextIO, *, as_json: bool = False) -> None:
        self.stream = stream
        self.line = json_line if as_json else text_line

    def open(self) -> None:
        """Nothing is kept open."""

    def send(self, frame: Frame, reports: tuple[HidReport, ...]) -> None:
        for report in reports:
            self.stream.write(self.line(frame.due_ns, report))

    def close(self) -> None:
        self.stream.flush()


def text_line(due_ns: int, report: HidReport) -> str:
    seconds, rest = divmod(due_ns, 10**9)
    return f"{seconds}.{rest // 1000:06} {report.path:<{PATH_WIDTH}} {report.data.hex(' ')}\n"


def json_line(due_ns: int, report: HidReport) -> str:
    row = {"data": report.data.hex(), "due_ns": due_ns, "path": report.path}
    return json.dumps(row) + "\n"


FAULTS = frozenset({"stall", "fail", "gone", "error", "open"})


class LoopbackSink:
    """Each process that opens the file appends whole lines to it.

    A line: ``by`` (process id), ``at_ns`` (monotonic clock), ``number`` and ``due_ns`` of the
    frame, ``reports`` [[path, hex]].

    ``faults``, by the number of frames that this sink sent before:
    {"stall": {"frame": 10, "ms": 50, "before": true}}: the call takes so long, before or after
    the device has the frame; {"fail": {"frame": 10, "times": 1}}: write errors;
    {"gone": 10}: unplugged, for every process, from then on; {"error": 10}: an exception that
    is none of ours; {"open": true}: it cannot be opened; {"open": 2}: but once.
    """

    def __init__(self, file: str, faults: dict[str, Any] | None = None) -> None:
        self.path, self.faults = Path(file), faults or {}
        self.gone = self.path.with_name(self.path.name + ".gone")
        self.opened = self.path.with_name(self.path.name + ".opened")
        self.descriptor: int | None = None
        self.sent = 0
        if not self.faults.keys() <= FAULTS:
            raise ParameterError(f"the faults of a loopback are {', '.join(sorted(FAULTS))}")

    def open(self) -> None:
        refused = self.faults.get("open")
        if refused is True or (refused == 2 and self.opened.exists()):
            raise DeviceError("cannot be opened", path=str(self.path))
        if refused == 2:
            self.opened.touch()
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)
        self.descriptor = os.open(self.path, flags, 0o666)

    def send(self, frame: Frame, reports: tuple[HidReport, ...]) -> None:
        at_ns = time.monotonic_ns()
        if self.descriptor is None:
            raise DeviceError("not open", path=str(self.path))
        number, self.sent = self.sent, self.sent + 1
        if self.faults:
            self.before(number)
        line = {
            "by": os.getpid(),
            "at_ns": at_ns,
            "number": frame.number,
            "due_ns": frame.due_ns,
            "reports": [[report.path, report.data.hex()] for report in reports],
        }
        os.write(self.descriptor, json.dumps(line).encode() + b"\n")
        if self.faults:
            self.stall(number, before=False)

    def before(self, number: int) -> None:
        self.stall(number, before=True)
        fail = self.faults.get("fail")
        if fail and fail["frame"] <= number < fail["frame"] + fail.get("times", 1):
            raise DeviceError("did not take a report", path=str(self.path))
        if self.faults.get("gone") == number:
            self.gone.touch()
        if "gone" in self.faults and self.gone.exists():
            raise DeviceGoneError("has gone", path=str(self.path))
        if self.faults.get("error") == number:
            raise ZeroDivisionError("a fault that was asked for")

    def stall(self, number: int, *, before: bool) -> None:
        stall = self.faults.get("stall")
        if stall and stall["frame"] == number and stall.get("before", False) is before:
            time.sleep(stall["ms"] / 1000)

    def close(self) -> None:
        if self.descriptor is not None:
            os.close(self.descriptor)
            self.descriptor = None
