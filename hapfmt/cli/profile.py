"""hapfmt profile check, list, show: checks and prints device profiles."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import DeviceError, ParameterError
from .common import echo_json, json_option
from .screen import Column, Verb, complain, document, say, table

if TYPE_CHECKING:
    from ..replay.profile.matching import Descriptor
    from ..replay.profile.model import Actuator, Profile

HEX_LIMIT = 1 << 20
"""Bytes of a file with a descriptor; the longest descriptor as commented hex is far shorter."""


@click.group()
def profile() -> None:
    """Profiles say what a device takes, and what it must never be given.

    \b
    hapfmt profile list
    hapfmt profile show glove5 > mine.toml
    hapfmt profile check mine.toml --path /dev/hidraw3
    """


@profile.command("list", cls=Verb, short_help="The profiles that are built in.")
@json_option
def list_profiles(as_json: bool) -> int:
    """The profiles that are built in, and the devices that they are for."""
    from ..replay.profile.parse import builtin_names, load_profile

    found = [load_profile(name) for name in builtin_names()]
    if as_json:
        echo_json({"profiles": [summary(each) for each in found], "exit_code": 0})
        return 0
    table(
        [
            Column("name"),
            Column("devices", 3),
            Column("actuators", 1),
            Column("frames/s", 2),
            Column("description"),
        ],
        [
            [
                each.name,
                ", ".join(devices_of(each)) or "-",
                str(len(each.actuators)),
                f"{float(1 / each.timing.period):g}",
                each.description,
            ]
            for each in found
        ],
    )
    return 0


@profile.command("show", cls=Verb, short_help="The TOML of a profile.")
@click.argument("name", metavar="NAME")
def show_profile(name: str) -> int:
    """Print the TOML of the built-in profile NAME (or of a file), to start one of your own."""
    from ..replay.profile.parse import load_profile

    document(load_profile(name).text)
    return 0


@profile.command("check", cls=Verb, short_help="Whether a profile is one, and fits a device.")
@click.argument("file", metavar="FILE.toml")
@click.option(
    "--path",
    metavar="DEVICE_PATH",
    help="Hold its reports against this device (hapfmt devices lists paths); nothing is sent.",
)
@click.option(
    "--descriptor",
    metavar="HEXFILE",
    help="Hold its reports against a report descriptor: hex bytes as text, or the bytes.",
)
@json_option
def check_profile(file: str, path: str | None, descriptor: str | None, as_json: bool) -> int:
    """Check the profile FILE.toml (or a built-in one) and say what it makes of a device.

    With --path or --descriptor, each report of the profile must be one of the device's, with
    its kind, id and length. Exit code 1 where it is not.
    """
    from ..replay.profile.matching import differences
    from ..replay.profile.parse import load_profile

    if path is not None and descriptor is not None:
        raise ParameterError("Give --path or --descriptor, not both")
    chosen = load_profile(file)
    against: Descriptor | None = None
    found: list[str] = []
    if path is not None:
        from ..replay.sinks.hid import find, read_descriptor

        against = read_descriptor(find(chosen, path).path)
    elif descriptor is not None:
        against = descriptor_in(descriptor)
    if against is not None:
        found = differences(chosen, against)
    code = 1 if found else 0
    if as_json:
        result = summary(chosen)
        result |= {"differences": found, "device": against and device_summary(against)}
        echo_json(result | {"exit_code": code})
    else:
        show(file, chosen)
        if against is not None and not found:
            say(f"each of its reports is one of {path or descriptor or ''}")
        for text in found:
            complain(text)
    return code


def descriptor_in(name: str) -> Descriptor:
    """From hex as text, or from the bytes themselves (as in Linux' report_descriptor)."""
    from ..replay.profile.matching import DESCRIPTOR_LIMIT, of_hex, parse_descriptor

    path = Path(name)
    with path.open("rb") as stream:
        data = stream.read(HEX_LIMIT + 1)
    if len(data) > HEX_LIMIT:
        raise ParameterError(f"longer than any descriptor ({DESCRIPTOR_LIMIT} bytes)", path=name)
    try:
        data = of_hex(data.decode("ascii"))
    except UnicodeDecodeError:
        pass  # bytes
    except ValueError:
        raise ParameterError("neither hex bytes nor a report descriptor", path=name) from None
    try:
        return parse_descriptor(data)
    except DeviceError as error:
        raise ParameterError(error.message, offset=error.offset, path=name) from error


def devices_of(chosen: Profile) -> list[str]:
    from ..replay.profile.matching import match_text

    return [match_text(match) for match in chosen.matches]


def summary(chosen: Profile) -> dict[str, Any]:
    from ..replay.profile.matching import wanted_of

    timing = chosen.timing
    return {
        "name": chosen.name,
        "description": chosen.description,
        "source": chosen.source,
        "devices": devices_of(chosen),
        "gain": chosen.gain,
        "rate": str(timing.rate),
        "frame_samples": timing.frame_samples,
        "device_timeout_s": timing.device_timeout_s,
        "reports": [each._asdict() for each in wanted_of(chosen)],
        "actuators": [
            {
                "name": each.name,
                "body_site": each.body_site,
                "band": each.band,
                "unit": each.unit,
                "minimum": each.minimum,
                "maximum": each.maximum,
                "rest": each.rest,
                "slew": each.slew,
                "step": each.step,
                "accepts": each.accepts,
            }
            for each in chosen.actuators
        ],
    }


def device_summary(device: Descriptor) -> dict[str, Any]:
    reports = [
        {"path": kind, "id": number, "length": length}
        for (kind, number), length in sorted(device.lengths.items())
    ]
    return {"reports": reports, "uses_ids": device.uses_ids, "usages": device.usages}


def show(file: str, chosen: Profile) -> None:
    from ..replay.profile.matching import wanted_of

    timing = chosen.timing
    say(f"{file}: {chosen.name}, {chosen.description}")
    say(f"for {', '.join(devices_of(chosen)) or 'no device in particular: name its path'}")
    say(
        f"{float(1 / timing.period):g} frames/s of {timing.frame_samples} for each actuator; "
        f"gain {chosen.gain:g}; stops when {timing.hold_s * 1e3:g} ms late; "
        f"ramps of {timing.ramp_s * 1e3:g} ms"
    )
    rests = timing.device_timeout_s
    say(
        "not known to go to rest by itself when nothing comes any more"
        if rests is None
        else f"goes to rest by itself {rests * 1e3:g} ms after the last report"
    )
    for each in wanted_of(chosen):
        say(f"{each.path} report 0x{each.id:02x}, {each.length} bytes")
    table(
        ["actuator", "unit", "lowest", "highest", "rest", "change/s", "step", "band", "takes"],
        [row_of(each) for each in chosen.actuators],
    )


def row_of(actuator: Actuator) -> list[str]:
    numbers = (actuator.minimum, actuator.maximum, actuator.rest, actuator.slew, actuator.step)
    return [
        actuator.name,
        actuator.unit,
        *(f"{each:g}" for each in numbers),
        actuator.band,
        " ".join(actuator.accepts) or "-",
    ]
