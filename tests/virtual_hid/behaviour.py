"""A hidraw node as drivers/hid/hidraw.c and usbhid behave, without any kernel: calls in, answers out.

* Output reports of a USB device go to its interrupt endpoint, feature reports to the control
  endpoint; each serves one at a time, in order, whichever handle they come from. ``write`` waits
  until the device took the report, at most 5 s (USB_CTRL_SET_TIMEOUT): ETIMEDOUT, not delivered.
  The wait cannot be interrupted, not by SIGKILL either. So a device that stalls keeps *every*
  handle waiting for that endpoint, the watchdog's too; opening and reading go on.
* Output reports of a Bluetooth device are queued: ``write`` returns at once, whatever becomes of them.
* Length and id are not checked, but for a length of 2 to 16384 bytes.
* Gone: write, ioctl and open end with ENODEV, read with EIO, poll says POLLERR | POLLHUP. What
  waits ends with ENODEV.
* Each handle has its own queue of 64 input reports.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from .model import Device, Event, Fault

POLLIN, POLLOUT, POLLERR, POLLHUP = 1, 4, 8, 16
TIMEOUT_NS = 5_000_000_000
MOST = 16384
INPUTS = 64
MS = 1_000_000


class Answer(NamedTuple):
    """To the call ``ticket``: an errno, or a result and bytes."""

    ticket: int
    error: int = 0
    result: int = 0
    data: bytes = b""


@dataclass
class Handle:
    number: int
    inputs: deque[bytes] = field(default_factory=lambda: deque(maxlen=INPUTS))
    readers: deque[tuple[int, int]] = field(default_factory=deque)
    """Calls of read that wait, with their sizes."""
    poller: int | None = None


@dataclass
class Waiting:
    """A report on its way. ``ticket`` 0: the caller does not wait for it."""

    ticket: int
    op: str
    handle: int
    pid: int
    data: bytes
    asked_ns: int
    due_ns: int = 0


@dataclass
class Endpoint:
    queue: deque[Waiting] = field(default_factory=deque)
    free_ns: int = 0
    """When it can take the next report."""


class Node:
    """One device. Answers gather in ``answers``, pollers to be woken in ``woken``."""

    def __init__(self, device: Device, log: Callable[[Event], None], slow_ms: float = 0.0) -> None:
        self.device = device
        self.log = log
        self.slow_ns = round(slow_ms * MS)
        self.gone = False
        self.handles: dict[int, Handle] = {}
        self.features: dict[int, bytes] = {}
        self.answers: list[Answer] = []
        self.woken: list[int] = []
        self.faults: list[Fault] = []
        self.report_count = 0
        self.endpoints = {"output": Endpoint(), "feature": Endpoint()}
        self.apart: list[Waiting] = []
        """Writes that stall by themselves."""

    # -- faults, from the test

    def befall(self, fault: Fault, now: int) -> None:
        if fault.at is None and fault.kind == "unplug":
            self.unplug(now)
        elif fault.at is None and fault.kind == "stall":
            self.stall(fault.ms, now)
        else:
            self.faults.append(fault)

    def unplug(self, now: int) -> None:
        self.gone = True
        for end in self.endpoints.values():
            for each in end.queue:
                self.done(each, now, errno.ENODEV)
            end.queue.clear()
        for each in self.apart:
            self.done(each, now, errno.ENODEV)
        self.apart.clear()
        for handle in self.handles.values():
            for ticket, _ in handle.readers:
                self.answers.append(Answer(ticket, errno.EIO))
            handle.readers.clear()
            self.wake(handle)

    def stall(self, ms: float, now: int) -> None:
        for end in self.endpoints.values():
            end.free_ns = max(end.free_ns, now) + round(ms * MS)
            self.arrange(end)

    def fault_of(self, number: int) -> Fault | None:
        """The first that holds for the report of this number."""
        for place, fault in enumerate(self.faults):
            first = number if fault.at is None else fault.at
            if fault.at is None:
                self.faults[place] = Fault(**{**fault.to_json(), "at": first})
            if first <= number and (fault.count is None or number < first + fault.count):
                if fault.kind in ("stall", "handle-stall"):  # once
                    del self.faults[place]
                return fault
        return None

    # -- calls, from the kernel

    def open(self, ticket: int, number: int, pid: int, program: str, now: int) -> None:
        error = errno.ENODEV if self.gone else 0
        if not error:
            self.handles[number] = Handle(number)
        self.log(Event("open", number, pid, b"", now, now, error, program))
        self.answers.append(Answer(ticket, error, number))

    def close(self, ticket: int, number: int, pid: int, now: int) -> None:
        self.handles.pop(number, None)
        self.log(Event("close", number, pid, b"", now, now))
        self.answers.append(Answer(ticket))

    def write(self, ticket: int, op: str, number: int, pid: int, data: bytes, now: int) -> None:
        """A report for the device; ``op``: output or feature."""
        each = Waiting(ticket, op, number, pid, data, now)
        if self.gone:
            return self.done(each, now, errno.ENODEV)
        if not 2 <= len(data) <= MOST:
            return self.done(each, now, errno.EINVAL)
        fault = self.fault_of(self.report_count)
        self.report_count += 1
        if fault is not None and fault.kind == "unplug":
            self.unplug(now)
            return self.done(each, now, errno.ENODEV)
        if fault is not None and fault.kind == "error":
            return self.done(each, now, getattr(errno, fault.errno_name))
        if fault is not None and fault.kind == "handle-stall":
            each.due_ns = now + round(fault.ms * MS)
            return self.apart.append(each)
        if fault is not None:
            self.stall(fault.ms, now)
        if op == "output" and self.device.bus == "bluetooth":
            self.answers.append(Answer(ticket, result=len(data)))
            each.ticket = 0
        end = self.endpoints[op]
        end.queue.append(each)
        self.arrange(end)
        return self.advance(now)

    def get_feature(self, ticket: int, number: int, pid: int, data: bytes, now: int) -> None:
        held = self.features.get(data[0]) if data else None
        error = errno.ENODEV if self.gone else errno.EPIPE if held is None else 0
        self.log(Event("get", number, pid, held or data, now, now, error))
        held = (held or b"")[: len(data)]
        self.answers.append(Answer(ticket, error, len(held), held))

    def read(self, ticket: int, number: int, size: int, may_wait: bool) -> None:
        handle = self.handles[number]
        if self.gone:
            self.answers.append(Answer(ticket, errno.EIO))
        elif handle.inputs:
            self.answers.append(Answer(ticket, data=handle.inputs.popleft()[:size]))
        elif may_wait:
            handle.readers.append((ticket, size))
        else:
            self.answers.append(Answer(ticket, errno.EAGAIN))

    def interrupt(self, ticket: int) -> None:
        """Of what waits only a read can be."""
        for handle in self.handles.values():
            for each in handle.readers:
                if each[0] == ticket:
                    handle.readers.remove(each)
                    self.answers.append(Answer(ticket, errno.EINTR))
                    return

    def poll(self, number: int, poller: int | None) -> int:
        """What is ready; ``poller`` is woken when that changes."""
        handle = self.handles[number]
        ready = POLLOUT | (POLLIN if handle.inputs else 0)
        if self.gone:
            ready |= POLLERR | POLLHUP
        elif poller is not None:
            handle.poller = poller
        return ready

    # -- the device

    def say(self, data: bytes) -> None:
        """An input report."""
        for handle in self.handles.values():
            if handle.readers:
                ticket, size = handle.readers.popleft()
                self.answers.append(Answer(ticket, data=data[:size]))
            else:
                handle.inputs.append(data)
                self.wake(handle)

    def wake(self, handle: Handle) -> None:
        if handle.poller is not None:
            self.woken.append(handle.poller)
            handle.poller = None

    def arrange(self, end: Endpoint) -> None:
        """When the reports that wait will be taken."""
        at = end.free_ns
        for each in end.queue:
            at = max(at, each.asked_ns) + self.slow_ns
            each.due_ns = at

    def advance(self, now: int) -> None:
        """All that is due until ``now``."""
        for end in self.endpoints.values():
            while end.queue:
                each = end.queue[0]
                late = each.due_ns > each.asked_ns + TIMEOUT_NS and each.ticket != 0
                due = each.asked_ns + TIMEOUT_NS if late else each.due_ns
                if due > now:
                    break
                end.queue.popleft()
                if not late:
                    end.free_ns = due
                self.done(each, now, errno.ETIMEDOUT if late else 0)
                self.arrange(end)
        for each in [x for x in self.apart if x.due_ns <= now]:
            self.apart.remove(each)
            self.done(each, now, 0)

    def next_ns(self) -> int | None:
        """When ``advance`` has something to do."""
        heads = [end.queue[0] for end in self.endpoints.values() if end.queue]
        times = [
            min(x.due_ns, x.asked_ns + TIMEOUT_NS) if x.ticket else x.due_ns for x in heads
        ] + [x.due_ns for x in self.apart]
        return min(times, default=None)

    def done(self, each: Waiting, now: int, error: int) -> None:
        if not error and each.op == "feature":
            self.features[each.data[0]] = each.data
        self.log(Event(each.op, each.handle, each.pid, each.data, each.asked_ns, now, error))
        if each.ticket:
            self.answers.append(Answer(each.ticket, error, len(each.data)))
