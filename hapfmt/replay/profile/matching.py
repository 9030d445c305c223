"""Finds the device that a profile fits: by the system's data, then by the report descriptor.

A HID report descriptor says which reports a device has, and how long they are. Format: USB Device
Class Definition for Human Interface Devices 1.11, clauses 5.3 to 6.2.2. It is a sequence of items.
Each has one byte of size, type and tag, then 0, 1, 2 or 4 bytes of data. *Global* items (size of a
field, number of fields, report id ...) hold until they are changed. *Local* items (usages) hold
until the next *main* item, which is a run of fields or the border of a collection.

The bytes come from a device and are not trusted. Any input gives a value or a DeviceError with its
offset.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, NoReturn

from ...errors import DeviceError, ParameterError
from .model import Match, Path, Profile

Kind = Literal["input", "output", "feature"]

DESCRIPTOR_LIMIT = 4096
"""Bytes; as in Linux (HID_MAX_DESCRIPTOR_SIZE)."""
REPORT_LIMIT = 16384
"""Bytes of a report; as in Linux (HID_MAX_BUFFER_SIZE)."""
DEPTH_LIMIT = 64
"""Deepest nesting of collections, and of pushed states."""

DATA_SIZES = (0, 1, 2, 4)
LONG_ITEM = 0xFE
MAIN, GLOBAL, LOCAL = 0, 1, 2
FIELDS: dict[int, Kind] = {0x8: "input", 0x9: "output", 0xB: "feature"}
COLLECTION, END_COLLECTION = 0xA, 0xC
USAGE_PAGE, REPORT_SIZE, REPORT_ID, REPORT_COUNT, PUSH, POP = 0x0, 0x7, 0x8, 0x9, 0xA, 0xB
USAGE, USAGE_MINIMUM = 0x0, 0x1


class Item(NamedTuple):
    offset: int
    type: int
    tag: int
    value: int
    size: int
    """Size of the value, in bytes."""


class Globals(NamedTuple):
    usage_page: int = 0
    report_size: int = 0
    report_count: int = 0
    report_id: int = 0


@dataclass(frozen=True)
class Descriptor:
    """``lengths`` in bytes by kind and report id, as hidapi takes and gives them: with a first
    byte for the id, which is 0 where the device uses none. ``usages``: page and usage of each
    top-level collection, in their order; a collection may have several."""

    lengths: dict[tuple[Kind, int], int]
    uses_ids: bool
    usages: tuple[tuple[int, int], ...]

    def of_kind(self, kind: Kind) -> dict[int, int]:
        """Report id -> length."""
        found = {number: size for (each, number), size in self.lengths.items() if each == kind}
        return dict(sorted(found.items()))


def fail(message: str, offset: int) -> NoReturn:
    raise DeviceError(f"report descriptor: {message}", offset=offset)


def items_of(data: bytes) -> list[Item]:
    """The items; long ones, which no standard gives a meaning to, are left out."""
    if len(data) > DESCRIPTOR_LIMIT:
        fail(f"{len(data)} bytes, but {DESCRIPTOR_LIMIT} are the most", 0)
    found = []
    at = 0
    while at < len(data):
        prefix = data[at]
        if prefix == LONG_ITEM:
            if at + 1 == len(data):
                fail("it ends within an item", at)
            size, data_at = data[at + 1], at + 3
        else:
            size, data_at = DATA_SIZES[prefix & 3], at + 1
        stop = data_at + size
        if stop > len(data):
            fail("it ends within an item", at)
        if prefix != LONG_ITEM:
            value = int.from_bytes(data[data_at:stop], "little")
            found.append(Item(at, prefix >> 2 & 3, prefix >> 4, value, size))
        at = stop
    return found


def parse_descriptor(data: bytes) -> Descriptor:
    """Parses a report descriptor; DeviceError if it is malformed.

    Malformed means: an item is cut off; a collection or a pushed state is not closed or was not
    open; a report id is invalid; a report is longer than any that can be sent.
    """
    state = Globals()
    pushed: list[Globals] = []
    local: list[Item] = []
    depth = 0
    bits: dict[tuple[Kind, int], int] = {}
    uses_ids = False
    usages: list[tuple[int, int]] = []
    for item in items_of(data):
        if item.type == MAIN:
            if kind := FIELDS.get(item.tag):
                add_fields(bits, kind, state, item.offset)
            elif item.tag == COLLECTION:
                if depth == DEPTH_LIMIT:
                    fail(f"more than {DEPTH_LIMIT} collections within one another", item.offset)
                if not depth:
                    page = state.usage_page
                    usages += [full_usage(page, each) for each in local] or [(page, 0)]
                depth += 1
            elif item.tag == END_COLLECTION:
                if not depth:
                    fail("a collection ends that did not begin", item.offset)
                depth -= 1
            local.clear()
        elif item.type == GLOBAL:
            if item.tag == PUSH:
                if len(pushed) == DEPTH_LIMIT:
                    fail(f"more than {DEPTH_LIMIT} pushed states", item.offset)
                pushed.append(state)
            elif item.tag == POP:
                if not pushed:
                    fail("a pop without a push", item.offset)
                state = pushed.pop()
            else:
                state = changed(state, item)
                uses_ids = uses_ids or item.tag == REPORT_ID
        elif item.type == LOCAL and item.tag in (USAGE, USAGE_MINIMUM):
            # Linux takes the first of several before a collection, hidapi the last: all count.
            local.append(item)
    if depth:
        fail("it ends within a collection", len(data))
    lengths = {key: 1 + -(-size // 8) for key, size in bits.items()}
    return Descriptor(lengths, uses_ids, tuple(usages))


def changed(state: Globals, item: Item) -> Globals:
    """The state after a global item other than push and pop."""
    if item.tag == USAGE_PAGE:
        return state._replace(usage_page=item.value & 0xFFFF)
    if item.tag == REPORT_SIZE:
        return state._replace(report_size=item.value)
    if item.tag == REPORT_COUNT:
        return state._replace(report_count=item.value)
    if item.tag == REPORT_ID:
        if not 1 <= item.value <= 255:
            fail(f"report id {item.value} is not 1 to 255", item.offset)
        return state._replace(report_id=item.value)
    return state  # ranges and units: nothing that bears on lengths


def add_fields(bits: dict[tuple[Kind, int], int], kind: Kind, state: Globals, offset: int) -> None:
    key = (kind, state.report_id)
    size = bits.get(key, 0) + state.report_size * state.report_count
    if size > 8 * REPORT_LIMIT:
        fail(f"{kind} report 0x{state.report_id:02x} has more than {REPORT_LIMIT} bytes", offset)
    bits[key] = size


def full_usage(page: int, usage: Item) -> tuple[int, int]:
    """A usage of four bytes brings its own page in the upper two."""
    if usage.size == 4:
        return usage.value >> 16, usage.value & 0xFFFF
    return page, usage.value


def of_hex(text: str) -> bytes:
    """Bytes as people write them: ``05 01``, ``0x05, 0x01``, one run, ``//`` and ``#`` comments."""
    lines = [line.split("//")[0].split("#")[0] for line in text.splitlines()]
    words = " ".join(lines).replace(",", " ").replace(";", " ").split()
    return bytes.fromhex("".join(word.lower().removeprefix("0x") for word in words))


class SystemDevice(NamedTuple):
    """What the system says of a device, or of one of its collections, without opening it.

    ``bus`` is usb, bluetooth, i2c, spi, or empty where it does not say; ``usage_page`` and
    ``usage`` are 0 where it does not say.
    """

    path: bytes
    vendor_id: int
    product_id: int
    bus: str = ""
    usage_page: int = 0
    usage: int = 0
    name: str = ""
    manufacturer: str = ""
    serial: str = ""
    interface: int = -1

    @property
    def ids(self) -> str:
        return f"{self.vendor_id:04x}:{self.product_id:04x}"

    @property
    def place(self) -> str:
        """The path as text."""
        return os.fsdecode(self.path)


class SentReport(NamedTuple):
    """A report that a profile sends."""

    path: Path
    id: int
    length: int
    """In bytes, with that of the id."""
    short: bool = False
    """The device takes it shorter than its descriptor says."""


def fits(match: Match, device: SystemDevice) -> bool:
    """Where the system does not tell a usage (libusb), only the descriptor can deny it."""
    has_usage = device.usage_page or device.usage
    return (
        match.vendor_id == device.vendor_id
        and match.product_id in (None, device.product_id)
        and match.bus in (None, device.bus)
        and (not has_usage or match.usage_page in (None, device.usage_page))
        and (not has_usage or match.usage in (None, device.usage))
    )


def profiles_for(device: SystemDevice, profiles: Iterable[Profile]) -> list[Profile]:
    """Those that fit, the most particular ones first."""

    def detail(profile: Profile) -> int:
        fields = (
            (match.vendor_id, match.product_id, match.bus, match.usage_page, match.usage)
            for match in profile.matches
            if fits(match, device)
        )
        return max(sum(each is not None for each in some) for some in fields)

    found = [each for each in profiles if any(fits(match, device) for match in each.matches)]
    return sorted(found, key=lambda profile: (-detail(profile), profile.name))


def by_path(devices: Iterable[SystemDevice]) -> list[SystemDevice]:
    """One for each path: a device with several collections is listed several times."""
    found: dict[bytes, SystemDevice] = {}
    for device in devices:
        found.setdefault(device.path, device)
    return list(found.values())


def choose(
    profile: Profile, devices: Sequence[SystemDevice], path: str | bytes | None = None
) -> SystemDevice:
    """The device that a profile is to play on: the one at ``path``, or the only one that fits.
    Raises ParameterError if none fits, or several do."""
    fitting = by_path(
        each for each in devices if any(fits(match, each) for match in profile.matches)
    )
    if path is not None:
        wanted = os.fsencode(path)
        here = [each for each in fitting if each.path == wanted]
        if here:
            return here[0]
        return at_path(profile, wanted, devices)
    if not fitting:
        raise ParameterError(
            f"no device that the profile {profile.name} fits is connected ({matches_of(profile)}); "
            "hapfmt devices lists what is connected"
        )
    if len(fitting) > 1:
        places = ", ".join(each.place for each in fitting)
        raise ParameterError(
            f"the profile {profile.name} fits {len(fitting)} devices: choose one of {places}"
        )
    return fitting[0]


def at_path(profile: Profile, path: bytes, devices: Sequence[SystemDevice]) -> SystemDevice:
    """Why the device there is none for this profile."""
    place = os.fsdecode(path)
    there = [each for each in devices if each.path == path]
    if not there:
        raise ParameterError(f"no HID device has the path {place}; hapfmt devices lists them")
    if profile.matches:
        raise ParameterError(
            f"the profile {profile.name} does not fit {place}: it is for {matches_of(profile)}, "
            f"and this is {described(there[0])}"
        )
    return there[0]


def matches_of(profile: Profile) -> str:
    """What a profile matches, in words."""
    return " or ".join(match_text(match) for match in profile.matches) or "no device in particular"


def match_text(match: Match) -> str:
    def part(value: int | None) -> str:
        return "*" if value is None else f"{value:04x}"

    text = f"{part(match.vendor_id)}:{part(match.product_id)}"
    if match.bus:
        text += f" by {match.bus}"
    if match.usage_page is not None or match.usage is not None:
        text += f" usage {part(match.usage_page)}/{part(match.usage)}"
    return text


def described(device: SystemDevice) -> str:
    text = device.ids + (f" by {device.bus}" if device.bus else "")
    if device.usage_page or device.usage:
        text += f" usage {device.usage_page:04x}/{device.usage:04x}"
    return text


def wanted_of(profile: Profile) -> list[SentReport]:
    """Every report that the profile ever sends, each once."""
    found = [
        SentReport(layout.path, layout.id, layout.length, layout.short)
        for layout in profile.reports
    ]
    short = {(each.path, each.id) for each in found if each.short}
    for path, data in (*profile.init, *profile.neutral, *profile.exit):
        found.append(SentReport(path, data[0], len(data), (path, data[0]) in short))
    return list(dict.fromkeys(found))


def differences(profile: Profile, descriptor: Descriptor) -> list[str]:
    """What of a profile a device does not have, in words; none: it fits."""
    found = [text for each in wanted_of(profile) if (text := difference(each, descriptor))]
    usages = descriptor.usages or ((0, 0),)
    if profile.matches and not any(
        match.usage_page in (None, page) and match.usage in (None, usage)
        for match in profile.matches
        for page, usage in usages
    ):
        has = ", ".join(f"{page:04x}/{usage:04x}" for page, usage in descriptor.usages) or "none"
        found.append(
            f"the profile is for {matches_of(profile)}, but the device has the usages {has}"
        )
    return found


def difference(wanted: SentReport, descriptor: Descriptor) -> str | None:
    length = descriptor.lengths.get((wanted.path, wanted.id))
    name = f"{wanted.path} report 0x{wanted.id:02x}"
    if length is None:
        return f"{name}: the device has none; {instead(wanted, descriptor)}"
    if wanted.length == length or (wanted.short and wanted.length < length):
        return None
    return f"{name}: the profile sends {wanted.length} bytes, the device takes {length}"


def instead(wanted: SentReport, descriptor: Descriptor) -> str:
    """What it has where a report was looked for."""
    if bool(wanted.id) != descriptor.uses_ids:
        return "it uses report ids" if descriptor.uses_ids else "it uses no report ids"
    kinds: tuple[Kind, ...] = ("output", "feature", "input")
    others = [kind for kind in kinds if (kind, wanted.id) in descriptor.lengths]
    if others:
        return f"there 0x{wanted.id:02x} is of kind {others[0]}"
    has = [f"0x{each:02x} ({size} bytes)" for each, size in descriptor.of_kind(wanted.path).items()]
    return (
        f"its {wanted.path} reports: {', '.join(has)}" if has else f"nor any {wanted.path} report"
    )


def check_fit(profile: Profile, descriptor: Descriptor, place: str) -> None:
    """Before the first write: raises ParameterError that says all that differs."""
    found = differences(profile, descriptor)
    if found:
        raise ParameterError(
            f"the profile {profile.name} does not fit {place}, nothing was sent: "
            + "; ".join(found)
        )
