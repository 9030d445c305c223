"""What a virtual device is, what befalls it, and what it saw. Plain data, as JSON between processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, NamedTuple

USB, BLUETOOTH = 3, 5
BUSES = {"usb": USB, "bluetooth": BLUETOOTH}


@dataclass(frozen=True)
class Device:
    """What hidapi is told of it."""

    name: str = "Virtual Glove"
    manufacturer: str = "Nobody"
    serial: str = "SN0001"
    vendor_id: int = 0x1209
    product_id: int = 0xC0DE
    bus: Literal["usb", "bluetooth"] = "usb"
    descriptor: bytes = b""

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "descriptor": self.descriptor.hex()}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Device:
        return cls(**{**values, "descriptor": bytes.fromhex(values["descriptor"])})


@dataclass(frozen=True)
class Fault:
    """From the report with this number on (0: the first; None: from now), for ``count`` reports
    (None: for good). Reports of all handles and both paths count.

    ``error``: they end with ``errno_name``. ``unplug``: the device is gone, for good.
    ``stall``: the device answers nothing for ``ms``; whatever is written waits in the order of
    its endpoint. ``handle-stall``: only the one write waits, other handles are served (as if its
    process had been stopped within the call).
    """

    kind: Literal["error", "unplug", "stall", "handle-stall"]
    at: int | None = None
    count: int | None = None
    ms: float = 0.0
    errno_name: str = "EIO"

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


class Event(NamedTuple):
    """``op``: open, close, output, feature (a feature report for the device), get (one from it).

    ``asked_ns`` is when the call came, ``time_ns`` when the device took it or refused, both of
    CLOCK_MONOTONIC. ``data`` has the report id first. ``error`` is the errno that the caller saw,
    0 for none. ``program``: command line of the process, with ``open``.
    """

    op: str
    handle: int
    pid: int
    data: bytes
    asked_ns: int
    time_ns: int
    error: int = 0
    program: str = ""

    @property
    def taken(self) -> bool:
        """A report that the device has."""
        return self.op in ("output", "feature") and not self.error

    def to_json(self) -> list[Any]:
        return [*self[:3], self.data.hex(), *self[4:]]

    @classmethod
    def from_json(cls, values: Sequence[Any]) -> Event:
        op, handle, pid, data, *others = values
        return cls(op, handle, pid, bytes.fromhex(data), *others)


@dataclass(frozen=True)
class Setup:
    """All that a world begins with."""

    devices: tuple[Device, ...]
    slow_ms: tuple[float, ...] = ()
    """Time that each device takes for a report."""
    tier: str = "fuse"
    fuse: str = "/dev/fuse"
    python: str = ""
    """With the bindings of umockdev."""
    folder: str = ""
    """For its files."""
