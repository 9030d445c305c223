"""Tests that play in real time, on a machine that may stand still for a second.

A profile holds a force for a second at most, so a player whose machine stands still for longer ends
as ``late``, as it should. Such a run proves nothing. A test with the mark ``realtime`` that fails is
therefore run again, but only if a thread that does nothing else than sleep was held up meanwhile.
"""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest
from _pytest.runner import call_and_report

STALL_S = 0.05
"""Sleeps end less than 0.01 s late on a machine that has time."""
TURN_S = 0.01
TRIES = 6
LOOP_S = 0.01
"""Processor time of the loop in ``slowness`` on the machine where the bounds were set."""


def slowness() -> float:
    """How much slower this machine is than the one where bounds of processor time were set, if it is."""
    began, total = time.process_time(), 0
    for number in range(100_000):
        total += number * number % 7
    return max(1.0, (time.process_time() - began) / LOOP_S)


class Stalls:
    """How late the sleeps of a thread ended: the longest, within the block."""

    def __init__(self) -> None:
        self.longest_s = 0.0
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)

    def __enter__(self) -> Stalls:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()
        self.thread.join()

    def run(self) -> None:
        while not self.ended.is_set():
            began = time.monotonic()
            time.sleep(TURN_S)
            self.longest_s = max(self.longest_s, time.monotonic() - began - TURN_S)


def run(item: Any, nextitem: pytest.Item | None) -> None:
    """The test, again where it failed on a machine that stood still: with new fixtures of any scope."""
    for turn in range(TRIES):
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        with Stalls() as stalls:
            reports = [call_and_report(item, "setup", log=False)]
            if reports[0].passed:
                reports.append(call_and_report(item, "call", log=False))
        failed = any(report.failed for report in reports)
        again = failed and stalls.longest_s >= STALL_S and turn + 1 < TRIES
        reports.append(
            call_and_report(item, "teardown", log=False, nextitem=None if again else nextitem)
        )
        if not again:
            break
        item._initrequest()
    for report in reports:
        if failed and turn:
            report.sections.append(("stalls", f"try {turn + 1}, {stalls.longest_s:.3f} s"))
        report.user_properties.append(("tries", turn + 1))
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
