"""Frames -> lines of text: what a device would be sent."""

from __future__ import annotations

import json
from typing import TextIO

from ..frames import Frame
from ..profile.model import Report

PATH_WIDTH = len("feature")


class DryRunSink:
    """A line for each report: seconds since the start, path, bytes in hex; or JSON, with
    nanoseconds."""

    def __init__(self, stream: TextIO, *, as_json: bool = False) -> None:
        self.stream = stream
        self.line = json_line if as_json else text_line

    def open(self) -> None:
        """Nothing is kept open."""

    def send(self, frame: Frame, reports: tuple[Report, ...]) -> None:
        for report in reports:
            self.stream.write(self.line(frame.due_ns, report))

    def close(self) -> None:
        self.stream.flush()


def text_line(due_ns: int, report: Report) -> str:
    seconds, rest = divmod(due_ns, 10**9)
    return f"{seconds}.{rest // 1000:06} {report.path:<{PATH_WIDTH}} {report.data.hex(' ')}\n"


def json_line(due_ns: int, report: Report) -> str:
    told = {"data": report.data.hex(), "due_ns": due_ns, "path": report.path}
    return json.dumps(told) + "\n"
