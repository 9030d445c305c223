"""Which device a profile fits: by what the system says of it, then by its own descriptor."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ...errors import ParameterError
from .descriptor import Descriptor, Kind
from .model import Match, Path, Profile


class Device(NamedTuple):
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


class Wanted(NamedTuple):
    """A report that a profile sends."""

    path: Path
    id: int
    length: int
    """In bytes, with that of the id."""
    short: bool = False
    """The device takes it shorter than its descriptor says."""


def fits(match: Match, device: Device) -> bool:
    """Where the system does not tell a usage (libusb), only the descriptor can deny it."""
    told = device.usage_page or device.usage
    return (
        match.vendor_id == device.vendor_id
        and match.product_id in (None, device.product_id)
        and match.bus in (None, device.bus)
        and (not told or match.usage_page in (None, device.usage_page))
        and (not told or match.usage in (None, device.usage))
    )


def profiles_for(device: Device, profiles: Iterable[Profile]) -> list[Profile]:
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


def by_path(devices: Iterable[Device]) -> list[Device]:
    """One for each path: a device with several collections is listed several times."""
    found: dict[bytes, Device] = {}
    for device in devices:
        found.setdefault(device.path, device)
    return list(found.values())


def choose(profile: Profile, devices: Sequence[Device], path: str | bytes | None = None) -> Device:
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
            f"no device that the profile {profile.name} fits is connected ({asked(profile)}); "
            "hapfmt devices lists what is connected"
        )
    if len(fitting) > 1:
        places = ", ".join(each.place for each in fitting)
        raise ParameterError(
            f"the profile {profile.name} fits {len(fitting)} devices: choose one of {places}"
        )
    return fitting[0]


def at_path(profile: Profile, path: bytes, devices: Sequence[Device]) -> Device:
    """Why the device there is none for this profile."""
    place = os.fsdecode(path)
    there = [each for each in devices if each.path == path]
    if not there:
        raise ParameterError(f"no HID device has the path {place}; hapfmt devices lists them")
    if profile.matches:
        raise ParameterError(
            f"the profile {profile.name} does not fit {place}: it is for {asked(profile)}, and "
            f"this is {described(there[0])}"
        )
    return there[0]


def asked(profile: Profile) -> str:
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


def described(device: Device) -> str:
    text = device.ids + (f" by {device.bus}" if device.bus else "")
    if device.usage_page or device.usage:
        text += f" usage {device.usage_page:04x}/{device.usage:04x}"
    return text


def wanted_of(profile: Profile) -> list[Wanted]:
    """Every report that the profile ever sends, each once."""
    found = [
        Wanted(layout.path, layout.id, layout.length, layout.short) for layout in profile.reports
    ]
    short = {(each.path, each.id) for each in found if each.short}
    for path, data in (*profile.init, *profile.neutral, *profile.exit):
        found.append(Wanted(path, data[0], len(data), (path, data[0]) in short))
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
        found.append(f"the profile is for {asked(profile)}, but the device has the usages {has}")
    return found


def difference(wanted: Wanted, descriptor: Descriptor) -> str | None:
    length = descriptor.lengths.get((wanted.path, wanted.id))
    name = f"{wanted.path} report 0x{wanted.id:02x}"
    if length is None:
        return f"{name}: the device has none; {instead(wanted, descriptor)}"
    if wanted.length == length or (wanted.short and wanted.length < length):
        return None
    return f"{name}: the profile sends {wanted.length} bytes, the device takes {length}"


def instead(wanted: Wanted, descriptor: Descriptor) -> str:
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
