"""Sends reports to a real device through hidapi.

This file relies on, or guards against, these properties of hidapi:

- ``write`` returns -1 and never raises.
- No platform checks the id or length of a report.
- Two writers at once, or a close during a call, crash the process.
- An object cannot be reopened.
"""

from __future__ import annotations

import errno
import os
import sys
import threading
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import DeviceError, DeviceGoneError, MissingExtraError, ParameterError
from ..profile.matching import Descriptor, SystemDevice, check_fit, choose, parse_descriptor

if TYPE_CHECKING:
    from ..profile.model import Frame, HidReport, Profile

BUSES = {1: "usb", 2: "bluetooth", 3: "i2c", 4: "spi"}
CLOSE_WAIT_S = 6.0
"""A write to a device that hangs comes back after 5.2 s (Linux hidraw), and no close may fall
into it."""
INTERRUPTED = os.strerror(errno.EINTR)
"""A signal interrupted a wait for the device (a feature report by Bluetooth LE). Only this text
says so. The device is not lost, and the same report may be sent again."""
GONE = ("no such device", "not connected")
"""What Linux and macOS, and Windows, say of a device that was unplugged."""
NO_ANSWER = "hidapi gives no reason; the device has gone, or does not answer"


def hid_module() -> Any:
    """The module of the package hidapi. On Linux ``hidraw`` comes before ``hid``: that goes by
    libusb, takes the device from its kernel driver, and knows neither usages nor reasons."""
    names = ("hidraw", "hid") if sys.platform.startswith("linux") else ("hid",)
    for name in names:
        try:
            module = import_module(name)
        except ModuleNotFoundError as error:
            if error.name == name:
                continue
            raise unusable(name, str(error)) from error
        except ImportError as error:
            raise unusable(name, str(error)) from error
        if not hasattr(module, "device") or not hasattr(module, "enumerate"):
            raise unusable(name, "it has no 'device'")
        return module
    raise MissingExtraError("hidapi", "replay")


def unusable(name: str, why: str) -> ParameterError:
    """Two packages on PyPI install a module ``hid``, and one hides the other."""
    if name != "hid":
        return ParameterError(f"the module {name!r} of hidapi does not load: {why}")
    return ParameterError(
        f"the module 'hid' that is installed is not that of hidapi ({why}); probably the package "
        "'hid' has taken its place: pip uninstall hid, then "
        "pip install --force-reinstall 'hapfmt[replay]'"
    )


def last_error(handle: Any) -> str:
    """Why the last call failed; empty where hidapi does not say."""
    try:
        text = str(handle.error() or "")
    except (OSError, ValueError):
        return ""
    return "" if text.lower() == "success" or "not implemented" in text else text


def connected() -> list[SystemDevice]:
    """Every HID device, one entry for each of its top-level collections; none is opened."""
    try:
        found = hid_module().enumerate()
    except OSError as error:
        raise DeviceError(f"the HID devices cannot be listed: {error}") from error
    return [device_of(each) for each in found]


def device_of(entry: dict[str, Any]) -> SystemDevice:
    return SystemDevice(
        path=entry["path"],
        vendor_id=entry["vendor_id"],
        product_id=entry["product_id"],
        bus=BUSES.get(entry.get("bus_type", 0), ""),
        usage_page=entry.get("usage_page") or 0,
        usage=entry.get("usage") or 0,
        name=entry.get("product_string") or "",
        manufacturer=entry.get("manufacturer_string") or "",
        serial=entry.get("serial_number") or "",
        interface=entry.get("interface_number", -1),
    )


def find(profile: Profile, path: str | bytes | None = None) -> SystemDevice:
    """Returns the connected device at ``path``, or the only one that fits."""
    return choose(profile, connected(), path)


def read_descriptor(path: bytes) -> Descriptor:
    """Opens the device at this path, reads its report descriptor and closes it."""
    sink = HidSink(path)
    sink.open()
    try:
        return sink.descriptor()
    finally:
        sink.close()


class HidSink:
    """A device at ``path``; with a profile, nothing is sent unless its reports are the device's.

    One object may be used from several threads and from handlers of signals: calls of hidapi never
    overlap. After ``close`` it can be opened again.
    """

    def __init__(self, path: bytes, profile: Profile | None = None) -> None:
        self.path = path
        self.profile = profile
        self.place = os.fsdecode(path)
        self.handle: Any = None
        # Not a plain lock: a handler of a signal may close between two calls of its own thread.
        self.lock = threading.RLock()

    def open(self) -> None:
        with self.lock:
            if self.handle is not None:
                return
            handle = hid_module().device()
            try:
                handle.open_path(self.path)
            except OSError as error:
                raise DeviceError(self.unopened(handle, error)) from error
            self.handle = handle
            try:
                if self.profile is not None:
                    check_fit(self.profile, self.descriptor(), self.place)
            except BaseException:
                self.close()
                raise

    def unopened(self, handle: Any, error: OSError) -> str:
        """The exception says only that it failed: the file system may know more, or hidapi."""
        if sys.platform.startswith("linux") and self.place.startswith("/"):
            if not Path(self.place).exists():
                return f"{self.place}: there is no such device (any more)"
            if not os.access(self.path, os.R_OK | os.W_OK):
                return (
                    f"{self.place}: this user may not open it; hapfmt devices says how a udev "
                    "rule gives the permission"
                )
        return f"{self.place}: the device cannot be opened: {last_error(handle) or error}"

    def descriptor(self) -> Descriptor:
        """The report descriptor of the open device."""
        with self.lock:
            handle = self.opened()
            if not hasattr(handle, "get_report_descriptor"):
                raise ParameterError(
                    "this hidapi cannot read report descriptors; "
                    "pip install --upgrade 'hidapi>=0.14'"
                )
            try:
                data = bytes(handle.get_report_descriptor())
            except (OSError, ValueError) as error:
                raise DeviceError(
                    f"{self.place}: the report descriptor cannot be read: {error}"
                ) from error
        try:
            return parse_descriptor(data)
        except DeviceError as error:
            error.path = self.place
            raise

    def opened(self) -> Any:
        if self.handle is None:
            raise DeviceError(f"{self.place}: the device is not open")
        return self.handle

    def send(self, frame: Frame, reports: tuple[HidReport, ...]) -> None:  # noqa: ARG002
        self.write(reports)

    def write(self, reports: tuple[HidReport, ...]) -> None:
        """Sends the reports in order; stops at the first that fails. Raises DeviceError, and
        DeviceGoneError where no other write can succeed."""
        for path, data in reports:
            with self.lock:
                taken, why = self.taken(path, data)
                if INTERRUPTED in why:
                    taken, why = self.taken(path, data)
            if taken < 0:
                kind = DeviceGoneError if self.is_gone(why) else DeviceError
                raise kind(self.failed(path, data, why or NO_ANSWER))
            if taken < len(data):
                raise DeviceError(self.failed(path, data, f"it took {taken} of {len(data)} bytes"))

    def taken(self, path: str, data: bytes) -> tuple[int, str]:
        """How many bytes of a report the device took; or -1, and why."""
        handle = self.opened()
        call = handle.write if path == "output" else handle.send_feature_report
        try:
            count = call(data)
        except (OSError, ValueError) as error:
            return -1, str(error)
        return count, last_error(handle) if count < 0 else ""

    def is_gone(self, why: str) -> bool:
        """True if the error's text says so, or the device's file is no longer there."""
        return any(text in why.casefold() for text in GONE) or (
            self.place.startswith("/") and not Path(self.place).exists()
        )

    def failed(self, path: str, data: bytes, why: str) -> str:
        return f"{self.place}: {path} report 0x{data[0]:02x} was not taken: {why}"

    def close(self) -> None:
        """Nothing more is written from now on; waits for a call under way, and leaves the device
        open rather than close into one."""
        handle, self.handle = self.handle, None
        if handle is None or not self.lock.acquire(timeout=CLOSE_WAIT_S):
            return
        try:
            handle.close()
        except (OSError, ValueError):
            pass
        finally:
            self.lock.release()
