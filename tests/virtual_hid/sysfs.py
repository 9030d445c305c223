"""The few files of /sys that libudev and hidapi read of a hidraw device."""

from __future__ import annotations

import os
from pathlib import Path

from .model import BUSES, Device

MAJOR = 240  # for local use: LANANA's list of devices


def build(root: Path, devices: list[Device], folder: str) -> None:
    """A tree for devices whose nodes are ``/dev/FOLDER/hidraw0`` and so on; "": in /dev itself."""
    for name in ("bus/usb/devices", "bus/hid/devices", "class/hidraw", "dev/char"):
        (root / name).mkdir(parents=True)
    for number, device in enumerate(devices):
        add(root, number, device, folder)


def add(root: Path, number: int, device: Device, folder: str) -> None:
    bus = BUSES[device.bus]
    ids = f"{bus:04X}:{device.vendor_id:04X}:{device.product_id:04X}.{number + 1:04X}"
    if device.bus == "usb":
        plug = root / f"devices/pci0000:00/0000:00:14.0/usb1/1-{number + 1}"
        above = plug / f"1-{number + 1}:1.0"
        usb(plug, above, device)
        link(plug / "subsystem", root / "bus/usb")
        link(above / "subsystem", root / "bus/usb")
    else:  # as BlueZ has it today, by uhid
        above = root / "devices/virtual/misc/uhid"
    hid = above / ids
    raw = hid / f"hidraw/hidraw{number}"
    write(
        hid / "uevent",
        "DRIVER=hid-generic",
        f"HID_ID={bus:04X}:{device.vendor_id:08X}:{device.product_id:08X}",
        f"HID_NAME={device.manufacturer} {device.name}",
        "HID_PHYS=virtual/input0",
        f"HID_UNIQ={device.serial}",
    )
    (hid / "report_descriptor").write_bytes(device.descriptor)
    write(
        raw / "uevent",
        f"MAJOR={MAJOR}",
        f"MINOR={number}",
        f"DEVNAME={Path(folder) / f'hidraw{number}'}",
    )
    write(raw / "dev", f"{MAJOR}:{number}")
    link(hid / "subsystem", root / "bus/hid")
    link(raw / "subsystem", root / "class/hidraw")
    link(raw / "device", hid)
    link(root / f"class/hidraw/hidraw{number}", raw)
    link(root / f"dev/char/{MAJOR}:{number}", raw)


def remove(root: Path, number: int) -> None:
    """As the kernel does when the device goes."""
    (root / f"class/hidraw/hidraw{number}").unlink(missing_ok=True)
    (root / f"dev/char/{MAJOR}:{number}").unlink(missing_ok=True)


def usb(plug: Path, interface: Path, device: Device) -> None:
    write(
        plug / "uevent",
        "DEVTYPE=usb_device",
        f"PRODUCT={device.vendor_id:x}/{device.product_id:x}/100",
    )
    write(plug / "idVendor", f"{device.vendor_id:04x}")
    write(plug / "idProduct", f"{device.product_id:04x}")
    write(plug / "manufacturer", device.manufacturer)
    write(plug / "product", device.name)
    write(plug / "serial", device.serial)
    write(plug / "bcdDevice", "0100")
    write(interface / "uevent", "DEVTYPE=usb_interface")
    write(interface / "bInterfaceNumber", "00")


def write(path: Path, *lines: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def link(path: Path, target: Path) -> None:
    path.symlink_to(os.path.relpath(target, path.parent))
