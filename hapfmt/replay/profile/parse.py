"""TOML -> Profile. What single values must be is checked here, what they must be together in
rules.py; schema.json says the former once more, for editors."""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from typing import Any

from ...errors import HapfmtError
from ...toml import Library, parse_toml
from ...units import to_ucum
from .keys import REQUIRED, ProfileError, Table, real, whole
from .layout import (
    COUNTERS,
    INTEGERS,
    Const,
    Counter,
    Crc32,
    Field,
    Integer,
    Layout,
    Mapped,
    One,
    Samples,
)
from .maps import MAPS
from .model import Actuator, Match, Profile, Report, Timing
from .rules import check

LIBRARY = Library(__package__, "profile")
NAME = r"[A-Za-z][A-Za-z0-9_.-]{0,63}"
"""Of a profile or an actuator. It begins with a letter, since a number stands for a place, and
leaves out what separates names on a command line."""
MOST_ACTUATORS = 256
MOST_SAMPLES = 4096
MOST_REPORTS = 16
MOST_FIELDS = 1024
LONGEST_REPORT = 4096
"""Bytes; a HID report may have 16 KiB in Linux, far more than any endpoint takes in a frame."""


def load_profile(name_or_path: str) -> Profile:
    """The built-in profile of this name, or else the one in this TOML file."""
    return parse_profile(LIBRARY.text(name_or_path), name_or_path)


def builtin_names() -> tuple[str, ...]:
    """Names of the profiles that come with the package, sorted."""
    return LIBRARY.names()


def parse_profile(text: str, path: str | None = None) -> Profile:
    """TOML -> a profile that may be played; ``path`` is named in errors."""
    try:
        return profile_of(parse_toml(text), text)
    except HapfmtError as error:
        raise error.at(path=path) from None


def profile_of(values: Any, text: str) -> Profile:
    """Of what the TOML says."""
    table = Table(values)
    profile = Profile(
        name=table.text("name", pattern=NAME),
        description=table.text("description", ""),
        source=table.text("source", ""),
        gain=table.number("gain", 0.5, above=0, high=1),
        matches=tuple(map(_match, table.tables("match", 0, 64))),
        timing=_timing(Table(table.take("timing", REQUIRED, "[timing]", "PLY-001"), "timing")),
        actuators=tuple(map(_actuator, table.tables("actuator", 1, MOST_ACTUATORS))),
        reports=tuple(map(_layout, table.tables("report", 1, MOST_REPORTS))),
        neutral=tuple(map(_payload, table.tables("neutral", 0, MOST_REPORTS))),
        init=tuple(map(_payload, table.tables("init", 0, 64))),
        exit=tuple(map(_payload, table.tables("exit", 0, 64))),
        text=text,
    )
    table.done()
    check(profile)
    return profile


def _match(table: Table) -> Match:
    match = Match(
        vendor_id=table.integer("vendor_id", 0, 0xFFFF),
        product_id=table.integer("product_id", 0, 0xFFFF, None),
        bus=table.choice("bus", ("usb", "bluetooth"), None),
        usage_page=table.integer("usage_page", 0, 0xFFFF, None),
        usage=table.integer("usage", 0, 0xFFFF, None),
    )
    table.done()
    return match


def _timing(table: Table) -> Timing:
    timeout = table.number("device_timeout_ms", None, above=0, high=3_600_000)
    timing = Timing(
        rate=_rate(table),
        frame_samples=table.integer("frame_samples", 1, MOST_SAMPLES, 1),
        hold_s=table.number("hold_ms", 20.0, above=0, high=1000) / 1000,
        ramp_s=table.number("ramp_ms", 50.0, above=0, high=10_000) / 1000,
        neutral_count=table.integer("neutral_count", 1, 100, 5),
        device_timeout_s=None if timeout is None else timeout / 1000,
    )
    table.done()
    return timing


def _rate(table: Table) -> Fraction:
    """A number, or a text like "3000/32"."""
    what = "the samples of an actuator per second"
    value = table.take("rate", REQUIRED, what, "PLY-001")
    if isinstance(value, str):
        if re.fullmatch(r"[1-9][0-9]{0,8}/[1-9][0-9]{0,8}", value) is None:
            table.fail("rate", f"{value!r} is not a rate; write {what}, such as 1000 or '3000/32'")
        rate = Fraction(value)
    else:
        rate = Fraction(str(real(value, table.path("rate"), -1e9, 0, 1e9)))
    if not 1 <= rate <= 1_000_000:
        table.fail("rate", f"{float(rate):g} Hz is out of range; write 1 to 1000000")
    return rate


def _actuator(table: Table) -> Actuator:
    def limit(key: str, what: str) -> float:
        return table.number(key, what=f"{what}, in its unit", requirement="PLY-001")

    name = table.text("name", pattern=NAME)
    unit = _unit(table, "unit", table.text("unit", most=255))
    actuator = Actuator(
        name=name,
        unit=unit,
        minimum=limit("minimum", "the lowest value that may be sent"),
        maximum=limit("maximum", "the highest value that may be sent"),
        rest=limit("rest", "the value at rest"),
        slew=table.number(
            "slew",
            above=0,
            high=1e12,
            what="the largest change per second, in its unit",
            requirement="PLY-001",
        ),
        step=table.number("step", low=1e-9, what="the value of one count, in its unit"),
        band=table.choice("band", ("full", "lf", "hf"), "full"),
        accepts=_accepts(table, unit),
        gain=table.number("gain", 1.0),
        offset=table.number("offset", 0.0),
        rectify=table.flag("rectify"),
        quantity=table.text("quantity", "", most=255),
        body_site=table.text("body_site", "", most=255),
    )
    table.done()
    return actuator


def _unit(table: Table, key: str, text: str) -> str:
    code = to_ucum(text)
    if code != text:
        table.fail(key, f"{text!r} is not a UCUM code; write {code!r}")
    return text


def _accepts(table: Table, unit: str) -> dict[str, float]:
    """Without the key, its own unit alone."""
    values = Table(table.take("accepts", {unit: 1.0}, ""), table.path("accepts"))
    if not values.values:
        table.fail("accepts", "is empty, so nothing could be played; add a unit, as { N = 1.0 }")
    accepted = {}
    for key in values.values:
        accepted[_unit(values, key, key)] = factor = values.number(key)
        if factor == 0:
            values.fail(key, "is 0; write its value in the actuator's unit")
    return accepted


def _layout(table: Table) -> Layout:
    layout = Layout(
        path=table.choice("path", ("output", "feature")),
        id=table.integer("id", 0, 255),
        length=table.integer("length", 2, LONGEST_REPORT),
        fields=tuple(map(_field, table.tables("fields", 1, MOST_FIELDS))),
        short=table.flag("short"),
    )
    table.done()
    return layout


def _field(table: Table) -> Field:
    kinds = [key for key in FIELDS if table.has(key)]
    if len(kinds) != 1:
        given = " and ".join(kinds) or "none"
        raise ProfileError(
            table.at, f"has {given} of {', '.join(FIELDS)}; give exactly one of them"
        )
    field = FIELDS[kinds[0]](table, table.integer("at", 1, LONGEST_REPORT - 1))
    table.done()
    return field


def _const(table: Table, at: int) -> Const:
    values = table.rows("const", 1, LONGEST_REPORT)
    place = table.path("const")
    return Const(at, bytes(whole(x, 0, 255, f"{place}[{n}]") for n, x in enumerate(values)))


def _counter(table: Table, at: int) -> Counter:
    integer = Integer(table.choice("counter", COUNTERS))
    return Counter(
        at,
        integer,
        mask=table.integer("mask", 1, integer.high, integer.high),
        shift=table.integer("shift", 0, 31, 0),
        start=table.integer("start", 0, integer.high, 0),
        shared=table.text("shared", "", pattern=NAME),
    )


def _one(table: Table, at: int) -> One:
    return One(at, table.text("actuator"), Integer(table.choice("type", INTEGERS)))


def _samples(table: Table, at: int) -> Samples:
    names = table.names("samples", MOST_ACTUATORS)
    return Samples(at, names, Integer(table.choice("type", INTEGERS)))


def _mapped(table: Table, at: int) -> Mapped:
    function = table.choice("map", tuple(MAPS))
    names = table.names("actuators", MOST_ACTUATORS)
    options = {
        key: table.number(key, option.default, low=option.low, high=option.high)
        for key, option in MAPS[function].options.items()
    }
    return Mapped(at, function, names, options)


def _crc32(table: Table, at: int) -> Crc32:
    values = Table(table.take("crc32", REQUIRED, ""), table.path("crc32"))
    crc = Crc32(
        at,
        seed=values.integer("seed", 0, 255, None),
        start=values.integer("from", 0, LONGEST_REPORT, 0),
        stop=values.integer("to", 1, LONGEST_REPORT, at),
    )
    values.done()
    return crc


FIELDS: dict[str, Callable[[Table, int], Field]] = {
    "const": _const,
    "counter": _counter,
    "actuator": _one,
    "samples": _samples,
    "map": _mapped,
    "crc32": _crc32,
}


def _payload(table: Table) -> Report:
    path: Any = table.choice("path", ("output", "feature"))
    text = table.text("data", most=3 * LONGEST_REPORT)
    table.done()
    try:
        data = bytes.fromhex(text)
    except ValueError:
        table.fail("data", "is not a text of hexadecimal bytes; write it as '01 00 FF'")
    if not 2 <= len(data) <= LONGEST_REPORT:
        table.fail("data", f"has {len(data)} bytes; write the report id and 1 to 4095 bytes more")
    return Report(path, data)
