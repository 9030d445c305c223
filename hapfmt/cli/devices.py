"""hapfmt devices: lists the connected HID devices."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

import click

from .common import echo_json, json_option
from .screen import Column, Verb, document, say, table

if TYPE_CHECKING:
    from ..replay.profile.matching import SystemDevice
    from ..replay.profile.model import Profile

RULES_FILE = "/etc/udev/rules.d/70-hapfmt.rules"
"""Before 73-seat-late.rules, which gives devices tagged uaccess to the user at the seat."""


@click.command(cls=Verb)
@click.option(
    "--profile",
    "own",
    multiple=True,
    metavar="FILE.toml",
    help="Try this profile as well as the built-in ones; repeatable.",
)
@json_option
def devices(own: tuple[str, ...], as_json: bool) -> int:
    """List the connected HID devices: paths, names, matching profiles, and missing permissions.

    hapfmt opens a device only to read its report descriptor, and only if a profile has its ids.
    Nothing is sent to it.

    \b
    hapfmt devices
    hapfmt devices --profile mine.toml
    """
    from ..replay.profile.matching import by_path
    from ..replay.profile.parse import builtin_names, load_profile
    from ..replay.sinks.hid import connected

    profiles = [load_profile(name) for name in (*builtin_names(), *own)]
    found = connected()
    rows = [
        describe_device(device, [each for each in found if each.path == device.path], profiles)
        for device in by_path(found)
    ]
    if as_json:
        echo_json({"devices": rows, "exit_code": 0})
    elif rows:
        show(rows)
    else:
        say("no HID device is connected")
    return 0


def describe_device(
    device: SystemDevice, collections: list[SystemDevice], profiles: list[Profile]
) -> dict[str, Any]:
    """One device, with all of its collections."""
    from ..replay.profile.matching import profiles_for

    matching = {
        profile.name: profile for each in collections for profile in profiles_for(each, profiles)
    }
    permitted = may_open(device)
    checked = judge(device, list(matching.values())) if permitted else None
    row: dict[str, Any] = {
        "path": device.place,
        "vendor_id": device.vendor_id,
        "product_id": device.product_id,
        "bus": device.bus or None,
        "name": device.name,
        "manufacturer": device.manufacturer,
        "serial": device.serial,
        "interface": device.interface,
        "usages": [
            [each.usage_page, each.usage] for each in collections if each.usage_page or each.usage
        ],
        "profiles": checked
        or [{"name": name, "fits": None, "differences": []} for name in matching],
        "permitted": permitted,
    }
    row["missing"] = missing(row)
    if permitted is False:
        row["udev_rule"] = udev_rule(device)
    return row


def may_open(device: SystemDevice) -> bool:
    """Whether this user may write to it, as far as the file system tells."""
    if sys.platform.startswith("linux") and device.path.startswith(b"/"):
        return os.access(device.path, os.R_OK | os.W_OK)
    return True


def judge(device: SystemDevice, profiles: list[Profile]) -> list[dict[str, Any]] | None:
    """Each profile against the descriptor of the device; None if that cannot be read."""
    from ..errors import DeviceError
    from ..replay.profile.matching import differences
    from ..replay.sinks.hid import read_descriptor

    if not profiles:
        return None
    try:
        descriptor = read_descriptor(device.path)
    except DeviceError as error:
        text = str(error)
        return [{"name": each.name, "fits": None, "differences": [text]} for each in profiles]
    judged = []
    for profile in profiles:
        found = differences(profile, descriptor)
        judged.append({"name": profile.name, "fits": not found, "differences": found})
    return judged


def missing(row: dict[str, Any]) -> list[str]:
    """What keeps a replay on this device from starting."""
    found = []
    if not row["profiles"]:
        found.append("profile")
    elif all(each["fits"] is False for each in row["profiles"]):
        found.append("profile that fits its reports")
    elif row["permitted"] and all(each["fits"] is None for each in row["profiles"]):
        found.append("report descriptor")
    if not row["permitted"]:
        found.append("permission")
    return found


def udev_rule(device: SystemDevice) -> str:
    """The kernel names a HID device BUS:VENDOR:PRODUCT.NUMBER, on every bus alike."""
    name = f"*:{device.vendor_id:04X}:{device.product_id:04X}.*"
    return f'SUBSYSTEM=="hidraw", KERNELS=="{name}", TAG+="uaccess"'


def show(rows: list[dict[str, Any]]) -> None:
    headers = [
        Column("path"), Column("ids", 3), Column("bus", 4), Column("usage", 5), Column("name", 1),
        Column("profile", 2), Column("missing"),
    ]  # fmt: skip
    cells = [
        [
            row["path"],
            f"{row['vendor_id']:04x}:{row['product_id']:04x}",
            row["bus"] or "-",
            " ".join(f"{page:04x}/{usage:04x}" for page, usage in row["usages"]) or "-",
            row["name"] or "-",
            " ".join(profile_text(each) for each in row["profiles"]) or "-",
            ", ".join(row["missing"]) or "-",
        ]
        for row in rows
    ]
    table(headers, cells)
    for row in rows:
        for each in row["profiles"]:
            for difference in each["differences"]:
                say(f"{row['path']}: {each['name']}: {difference}")
    rules = list(dict.fromkeys(row["udev_rule"] for row in rows if "udev_rule" in row))
    if rules:
        say(f"To let the person at this machine use the device, put into {RULES_FILE}:")
        document("".join(f"  {rule}\n" for rule in rules))
        say("and run: sudo udevadm control --reload && sudo udevadm trigger")
        say('(over a network: MODE="0660", GROUP="your group" instead of TAG)')
    if any("profile" in row["missing"] for row in rows):
        say("A device without a profile needs one: hapfmt profile show glove5 is a start.")


def profile_text(judged: dict[str, Any]) -> str:
    """A profile that was not held against the device's reports has a question mark."""
    return f"{judged['name']}{ {True: '', None: '?', False: ' (no)'}[judged['fits']] }"
