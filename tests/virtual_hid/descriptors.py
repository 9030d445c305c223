"""Report descriptors, and devices as those of real makers look to hidapi."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from .model import Device

MAIN = {"input": 0x81, "output": 0x91, "feature": 0xB1}


def item(tag: int, value: int) -> bytes:
    """A short item of HID 1.11, 6.2.2.2; ``tag`` with its size bits clear."""
    if value < 0x100:
        return bytes([tag | 1, value])
    if value < 0x10000:
        return bytes([tag | 2]) + value.to_bytes(2, "little")
    return bytes([tag | 3]) + value.to_bytes(4, "little")


def descriptor(
    reports: Iterable[tuple[str, int, int]], usage_page: int = 0xFF00, usage: int = 1
) -> bytes:
    """Of reports as (kind, id, bytes without the id), all of vendor-defined bytes."""
    parts = [item(0x04, usage_page), item(0x08, usage), item(0xA0, 1)]
    parts += [item(0x14, 0), b"\x26\xff\x00", item(0x74, 8), item(0x08, 2)]  # 0 to 255
    for kind, number, size in reports:
        if number:
            parts.append(item(0x84, number))
        parts += [item(0x94, size), item(MAIN[kind] & 0xFC, 2), item(0x08, 2)]
    return b"".join(parts[:-1]) + b"\xc0"


def glove(
    size: int = 12,
    number: int = 1,
    path: Literal["output", "feature"] = "output",
    serial: str = "SN0001",
) -> Device:
    """Five actuators of 16 bits; ``size`` has the id in it."""
    reports = [(path, number, size - 1), ("input", 1, 3)]
    if path == "output":
        reports.append(("feature", 3, 4))
    return Device(serial=serial, descriptor=descriptor(reports))


def dualsense(bus: Literal["usb", "bluetooth"] = "usb") -> Device:
    """Usage: game pad. Its output reports only, which is what matters here."""
    if bus == "usb":
        reports = [("input", 0x01, 63), ("output", 0x02, 47)]
    else:
        reports = [("input", 0x31, 77), ("output", 0x31, 77), ("output", 0x32, 141)]
    return Device(
        "DualSense Wireless Controller", "Sony Interactive Entertainment", "00:11:22:33:44:55",
        0x054C, 0x0CE6, bus, descriptor(reports, 0x01, 0x05),
    )  # fmt: skip


def pro_controller() -> Device:
    reports = [("input", 0x30, 48), ("output", 0x01, 48), ("output", 0x10, 48)]
    return Device(
        "Pro Controller", "Nintendo", "00:11:22:33:44:66", 0x057E, 0x2009, "bluetooth",
        descriptor(reports, 0x01, 0x05),
    )  # fmt: skip


def xbox() -> Device:
    reports = [("input", 0x01, 15), ("output", 0x03, 8)]
    return Device(
        "Xbox Wireless Controller", "Microsoft", "00:11:22:33:44:77", 0x045E, 0x0B13, "bluetooth",
        descriptor(reports, 0x01, 0x05),
    )  # fmt: skip
