"""TOML -> Profile, with all checks. A profile that passes may be played.

The rules for single values are declared here; schema.json repeats them for editors
(tools/schemas.py writes it). The rules for combinations of values follow as functions.
"""

from __future__ import annotations

from fractions import Fraction
from math import isfinite
from typing import Annotated, Any, Literal, NoReturn

from ...descriptions import DescriptionError, Library, above, parse_toml, read, what, within
from ...errors import HapfmtError
from ...structs import Meta, OneOf, Struct, named
from ...units import to_ucum
from .model import (
    Actuator,
    Const,
    Counter,
    Crc32,
    Field,
    HidReport,
    Integer,
    Mapped,
    Match,
    One,
    Path,
    Profile,
    ReportLayout,
    Samples,
    Timing,
    exact,
)
from .packing import MAPS, MOST_COUNTS, Packer

LIMITS = "PLY-001"


def check(profile: Profile) -> None:
    """ParameterError, naming the key path, for the first rule that is broken."""
    _check_timing(profile)
    _unique(profile)
    for n in range(len(profile.actuators)):
        _limits(profile, n)
    used: set[str] = set()
    for n, layout in enumerate(profile.reports):
        used |= _check_layout(profile, layout, f"report[{n}]")
    for n, actuator in enumerate(profile.actuators):
        if actuator.name not in used:
            fail(f"actuator[{n}]", f"{actuator.name!r} is in no report; add a field, or remove it")
    _payloads(profile)


def fail(at: str, text: str, requirement: str | None = None) -> NoReturn:
    raise DescriptionError(at, text, requirement)


def _check_timing(profile: Profile) -> None:
    timing = profile.timing
    if timing.rate <= 0:
        fail("timing.rate", "must be above 0", LIMITS)
    if not 0 < profile.gain <= 1:
        fail("gain", "must be above 0 and at most 1")
    if not (0 < timing.hold_s <= 1 and 0 < timing.ramp_s <= 10):
        fail("timing", "hold must be above 0 and at most 1 s, a ramp above 0 and at most 10 s")
    if not (timing.frame_samples >= 1 and 1 <= timing.neutral_count <= 100):
        fail("timing", "frame_samples must be 1 or more, neutral_count 1 to 100")
    if timing.period > 1:
        text = f"makes a frame each {float(timing.period):g} s; at least one a second must come"
        fail("timing.rate", f"{text}, raise it")
    timeout = timing.device_timeout_s
    if timeout is not None and exact(timeout) <= timing.period:
        fail(
            "timing.device_timeout_ms",
            f"the device would rest between two frames, {float(timing.period) * 1000:g} ms apart; "
            "raise it, or the rate of frames",
        )


def _unique(profile: Profile) -> None:
    if not profile.actuators:
        fail("actuator", "is missing; add at least one [[actuator]]", LIMITS)
    names: set[str] = set()
    for n, actuator in enumerate(profile.actuators):
        if actuator.name in names:
            fail(f"actuator[{n}].name", f"{actuator.name!r} is taken; give each its own")
        names.add(actuator.name)


def _limits(profile: Profile, n: int) -> None:
    actuator = profile.actuators[n]
    at = f"actuator[{n}]"
    for key in ("minimum", "maximum", "rest", "slew", "step", "gain", "offset"):
        if not isfinite(getattr(actuator, key)):
            fail(f"{at}.{key}", "is not finite; write a number", LIMITS)
    if actuator.step <= 0:
        fail(f"{at}.step", "must be above 0", LIMITS)
    if not actuator.minimum < actuator.maximum:
        fail(f"{at}.maximum", f"must be above minimum, {actuator.minimum:g}", LIMITS)
    if not actuator.minimum <= actuator.rest <= actuator.maximum:
        text = f"must lie within minimum and maximum, {actuator.minimum:g} to {actuator.maximum:g}"
        fail(f"{at}.rest", text, LIMITS)
    low, high, rest, change = profile.limits(actuator)
    if not low <= rest <= high:
        fail(
            f"{at}.rest",
            f"the nearest count, {rest}, lies outside minimum and maximum; "
            "write a whole number of steps, or a smaller step",
            LIMITS,
        )
    if change < 1:
        least = actuator.step * float(profile.timing.rate)
        fail(
            f"{at}.slew",
            f"gives less than one count per sample, so the actuator would never move; "
            f"write {least:g} or more, or a smaller step",
            LIMITS,
        )


def _check_layout(profile: Profile, layout: ReportLayout, at: str) -> set[str]:
    """Names of the actuators that the report sends."""
    index = {actuator.name: n for n, actuator in enumerate(profile.actuators)}
    owner: list[int | None] = [None] * layout.length
    owner[0] = -1
    used: set[str] = set()
    for n, field in enumerate(layout.fields):
        where = f"{at}.fields[{n}]"
        for name in names(field):
            if name not in index:
                fail(where, f"there is no actuator {name!r}; use one of {', '.join(index)}")
            used.add(name)
        _check_field(
            profile, [profile.actuators[index[name]] for name in names(field)], field, where
        )
        stop = field.at + size(field, profile.timing.frame_samples)
        if field.at < 1:
            fail(f"{where}.at", "byte 0 is the report id; write 1 or more")
        if stop > layout.length:
            text = f"ends at byte {stop}, the report at {layout.length}; move it, or raise length"
            fail(where, text)
        for place in range(field.at, stop):
            if owner[place] is not None:
                text = f"byte {place} belongs to fields[{owner[place]}] already; move one of them"
                fail(where, text)
            owner[place] = n
        if isinstance(field, Crc32):
            _check_crc32(field, layout, f"{where}.crc32")
    return used


def names(field: Field) -> tuple[str, ...]:
    match field:
        case One():
            return (field.actuator,)
        case Samples() | Mapped():
            return field.actuators
    return ()


def size(field: Field, frame_samples: int) -> int:
    """In bytes."""
    match field:
        case Const():
            return len(field.data)
        case Counter() | One():
            return field.type.size
        case Samples():
            return len(field.actuators) * frame_samples * field.type.size
        case Mapped():
            return MAPS[field.function].size
    return 4


def _check_field(profile: Profile, actuators: list[Actuator], field: Field, at: str) -> None:
    if isinstance(field, Counter) and field.mask << field.shift > field.type.high:
        fail(f"{at}.shift", f"moves bits of the mask out of {field.type.name}; lower one of them")
    if isinstance(field, One | Mapped) and profile.timing.frame_samples > 1:
        count = profile.timing.frame_samples
        fail(at, f"holds one of the {count} samples of a frame; use samples = [...] instead")
    if isinstance(field, One | Samples):
        for actuator in actuators:
            _holds(profile, actuator, field.type, at)
    if isinstance(field, Mapped):
        _check_mapped(profile, actuators, field, at)


def _holds(profile: Profile, actuator: Actuator, integer: Integer, at: str) -> None:
    low, high, _, _ = profile.limits(actuator)
    if low < integer.low or high > integer.high:
        fail(
            f"{at}.type",
            f"{integer.name} holds {integer.low} to {integer.high}, but {actuator.name!r} has "
            f"counts from {low} to {high}; use a wider type, or a larger step",
        )


def _check_mapped(profile: Profile, actuators: list[Actuator], field: Mapped, at: str) -> None:
    function = MAPS[field.function]
    if len(actuators) != len(function.actuators):
        listed = ", then ".join(function.actuators)
        fail(f"{at}.actuators", f"{field.function} takes {len(function.actuators)}: {listed}")
    for actuator in actuators:
        if actuator.minimum < function.low or actuator.maximum > function.high:
            text = f"takes {function.low:g} to {function.high:g}; lower the limits of"
            fail(f"{at}.map", f"{field.function} {text} {actuator.name!r}")
        low, high, _, _ = profile.limits(actuator)
        if high - low >= MOST_COUNTS:
            text = f"takes at most {MOST_COUNTS} counts of an actuator; raise the step of"
            fail(f"{at}.map", f"{field.function} {text} {actuator.name!r}")


def _check_crc32(field: Crc32, layout: ReportLayout, at: str) -> None:
    if not field.start < field.stop <= layout.length:
        fail(f"{at}.to", f"must be above from, {field.start}, and at most {layout.length}")
    if field.start < field.at + 4 and field.at < field.stop:
        fail(f"{at}.to", f"covers the CRC itself, at {field.at}; end there or before")
    for other in layout.fields:
        if isinstance(other, Crc32) and other is not field and _later(other, field, layout):
            fail(f"{at}.to", "covers a CRC that comes later in fields; list that one first")


def _later(other: Crc32, field: Crc32, layout: ReportLayout) -> bool:
    after = layout.fields.index(other) > layout.fields.index(field)
    return after and field.start < other.at + 4 and other.at < field.stop


def _payloads(profile: Profile) -> None:
    """Fixed bytes go round the limits; so those of a report that moves actuators must rest them."""
    resting = Packer(profile).at_rest()
    for key in ("neutral", "init", "exit"):
        for n, payload in enumerate(getattr(profile, key)):
            for layout, rest in zip(profile.reports, resting, strict=True):
                if (payload.path, payload.data[0]) == (layout.path, layout.id):
                    _rests(profile, layout, rest.data, payload.data, f"{key}[{n}].data")


def _rests(profile: Profile, layout: ReportLayout, rest: bytes, data: bytes, at: str) -> None:
    if len(data) != layout.length:
        text = f"has {len(data)} bytes, but report {layout.id} has {layout.length}; write as many"
        fail(at, text)
    for field in layout.fields:
        if names(field):
            part = slice(field.at, field.at + size(field, profile.timing.frame_samples))
            if data[part] != rest[part]:
                text = f"moves {', '.join(names(field))} from rest; write {rest[part].hex(' ')!r}"
                fail(at, f"{text} at byte {field.at}", "PLY-002")


LIBRARY = Library(__package__, "profile")
LONGEST_REPORT = 4096
"""Bytes; a HID report may have 16 KiB in Linux, far more than any endpoint takes in a frame."""
END = r"(?![\s\S])"
"""End of a pattern, in Python and in JSON schemas; $ matches before a newline in Python."""

Name = Annotated[
    str,
    Meta(
        pattern=r"^[A-Za-z][A-Za-z0-9_.-]{0,63}" + END,
        examples=["left-hand"],
        description="a name of letters, digits, '-', '_' and '.', a letter first",
    ),
]
"""Name of a profile or an actuator. It begins with a letter, since a number is a place. It has
no character that separates names on a command line."""
Text = Annotated[str, Meta(max_length=4000)]
Label = Annotated[str, Meta(max_length=255)]
Unit = Annotated[
    str, Meta(max_length=255, description="a UCUM code", extra_json_schema={"minLength": 1})
]
Value = Annotated[float, Meta(ge=-1e9, le=1e9)]
Factor = Annotated[Value, Meta(extra_json_schema={"not": {"const": 0}})]
Id16 = Annotated[int, Meta(ge=0, le=0xFFFF)]
Byte = Annotated[int, Meta(ge=0, le=0xFF)]
Word = Annotated[int, Meta(ge=0, le=0xFFFF_FFFF)]
Place = Annotated[
    int, within(1, LONGEST_REPORT - 1, "the byte where it begins; byte 0 is the report id")
]
Actuators = Annotated[tuple[str, ...], Meta(min_length=1, max_length=256)]
IntegerName = Literal["u8", "i8", "u16", "i16", "u32", "i32", "u16be", "i16be", "u32be", "i32be"]
"""Little-endian but for those that end in ``be``."""
CounterName = Literal["u8", "u16", "u32", "u16be", "u32be"]


def tables(low: int, high: int, what: str) -> Meta:
    return Meta(min_length=low, max_length=high, description=what)


class Table(Struct):
    """A table of a profile."""


class MatchKeys(Table):
    """What a device must be for the profile to fit."""

    vendor_id: Id16
    product_id: Id16 | None = None
    bus: Literal["usb", "bluetooth"] | None = None
    usage_page: Id16 | None = None
    usage: Id16 | None = None


class TimingKeys(Table):
    """When frames are sent."""

    rate: Annotated[
        Annotated[float, Meta(ge=1, le=1e6)]
        | Annotated[
            str, Meta(pattern="^[1-9][0-9]{0,8}/[1-9][0-9]{0,8}" + END, examples=["3000/32"])
        ],
        Meta(description="the samples of an actuator per second", requirement=LIMITS),
    ]
    frame_samples: Annotated[int, within(1, 4096, "samples of each actuator in a frame")] = 1
    hold_ms: Annotated[float, above(0, 1000, "how late a frame may be")] = 20.0
    ramp_ms: Annotated[float, above(0, 10_000, "how long the ramp to rest takes")] = 50.0
    neutral_count: Annotated[int, within(1, 100, "how often rest is sent at the end")] = 5
    device_timeout_ms: (
        Annotated[float, above(0, 3_600_000, "after which the device rests by itself")] | None
    ) = None

    def made(self) -> Timing:
        rate = Fraction(str(self.rate))
        if not 1 <= rate <= 1_000_000:
            raise DescriptionError(
                "timing.rate", f"{float(rate):g} Hz is out of range; write 1 to 1000000"
            )
        timeout = self.device_timeout_ms
        return Timing(
            rate=rate,
            frame_samples=self.frame_samples,
            hold_s=self.hold_ms / 1000,
            ramp_s=self.ramp_ms / 1000,
            neutral_count=self.neutral_count,
            device_timeout_s=None if timeout is None else timeout / 1000,
        )


def limit(what: str) -> Meta:
    return Meta(description=what, requirement=LIMITS)


class ActuatorKeys(Table):
    """What an actuator takes."""

    name: Name
    unit: Unit
    minimum: Annotated[Value, limit("the lowest value that may be sent, in its unit")]
    maximum: Annotated[Value, limit("the highest value that may be sent, in its unit")]
    rest: Annotated[Value, limit("the value at rest, in its unit")]
    slew: Annotated[
        float,
        Meta(
            gt=0,
            le=1e12,
            description="the largest change per second, in its unit",
            requirement=LIMITS,
        ),
    ]
    step: Annotated[float, within(1e-9, 1e9, "the value of one count, in its unit")]
    band: Literal["full", "lf", "hf"] = "full"
    accepts: (
        Annotated[
            dict[Unit, Factor],
            Meta(
                description="how much of its unit one of a recorded unit is",
                extra_json_schema={"minProperties": 1},
            ),
        ]
        | None
    ) = None
    gain: Value = 1.0
    offset: Value = 0.0
    rectify: bool = False
    quantity: Label = ""
    body_site: Label = ""

    def __post_init__(self) -> None:
        if self.accepts == {}:
            text = "is empty, so nothing could be played; add a unit, as { N = 1.0 }"
            raise DescriptionError("accepts", text)
        accepts = self.accepts or {}
        for key, text in (("unit", self.unit), *((f"accepts.{unit}", unit) for unit in accepts)):
            code = to_ucum(text)
            if code != text:
                raise DescriptionError(key, f"{text!r} is not a UCUM code; write {code!r}")
        for unit, factor in accepts.items():
            if factor == 0:
                raise DescriptionError(
                    f"accepts.{unit}", "is 0; write its value in the actuator's unit"
                )

    def made(self) -> Actuator:
        """Without ``accepts``, its own unit alone."""
        return Actuator(**vars(self) | {"accepts": self.accepts or {self.unit: 1.0}})


class FieldKeys(OneOf):
    """A part of a report."""

    __slots__ = ()

    def made(self) -> Field:
        raise NotImplementedError


class ConstKeys(Table, FieldKeys):
    """Bytes that never change."""

    at: Place
    const: Annotated[tuple[Byte, ...], Meta(min_length=1, max_length=LONGEST_REPORT)]

    def made(self) -> Const:
        return Const(self.at, bytes(self.const))


class CounterKeys(Table, FieldKeys):
    """A number that goes up with each report."""

    at: Place
    counter: CounterName
    mask: Annotated[int, Meta(ge=1, le=0xFFFF_FFFF)] | None = None
    shift: Annotated[int, Meta(ge=0, le=31)] = 0
    start: Word = 0
    shared: Name | None = None

    def __post_init__(self) -> None:
        high = Integer(self.counter).high
        for key, value in (("mask", self.mask), ("start", self.start)):
            if value is not None and value > high:
                raise DescriptionError(key, f"{value} is out of range; write at most {high}")

    def made(self) -> Counter:
        integer = Integer(self.counter)
        mask = integer.high if self.mask is None else self.mask
        return Counter(self.at, integer, mask, self.shift, self.start, self.shared or "")


class OneKeys(Table, FieldKeys):
    """The count of an actuator."""

    at: Place
    actuator: str
    type: IntegerName

    def made(self) -> One:
        return One(self.at, self.actuator, Integer(self.type))


class SamplesKeys(Table, FieldKeys):
    """All samples of a frame, interleaved."""

    at: Place
    samples: Actuators
    type: IntegerName

    def made(self) -> Samples:
        return Samples(self.at, self.samples, Integer(self.type))


class MappedKeys(Table, FieldKeys):
    """HD rumble: the amplitudes of two bands in four bytes."""

    at: Place
    map: Literal["hd-rumble"]
    actuators: Actuators
    high_hz: Annotated[float, Meta(ge=81.75177, le=1252.572266)] = 320.0
    low_hz: Annotated[float, Meta(ge=40.875885, le=626.286133)] = 160.0

    def made(self) -> Mapped:
        options = {"high_hz": self.high_hz, "low_hz": self.low_hz}
        return Mapped(self.at, self.map, self.actuators, options)


class CoveredKeys(Table):
    """The bytes that a CRC-32 covers."""

    seed: Byte | None = None
    start: Annotated[int, Meta(ge=0, le=LONGEST_REPORT)] = named("from", default=0)
    stop: Annotated[int, Meta(ge=1, le=LONGEST_REPORT)] | None = named("to", default=None)


class Crc32Keys(Table, FieldKeys):
    """CRC-32, little-endian."""

    at: Place
    crc32: CoveredKeys

    def made(self) -> Crc32:
        of = self.crc32
        return Crc32(self.at, of.seed, of.start, self.at if of.stop is None else of.stop)


FieldKeys.kinds = {
    "const": ConstKeys,
    "counter": CounterKeys,
    "actuator": OneKeys,
    "samples": SamplesKeys,
    "map": MappedKeys,
    "crc32": Crc32Keys,
}


class ReportKeys(Table):
    """The bytes of a report of a frame."""

    path: Path
    id: Byte
    length: Annotated[int, within(2, LONGEST_REPORT, "in bytes, with the id")]
    fields: Annotated[tuple[FieldKeys, ...], Meta(min_length=1, max_length=1024)]
    short: bool = False

    def made(self) -> ReportLayout:
        fields: tuple[Field, ...] = tuple(each.made() for each in self.fields)
        return ReportLayout(self.path, self.id, self.length, fields, self.short)


class PayloadKeys(Table):
    """A report that never changes."""

    path: Path
    data: Annotated[
        str,
        Meta(
            max_length=3 * LONGEST_REPORT,
            pattern=r"^[ \t-\r]*([0-9A-Fa-f]{2}[ \t-\r]*){2,4096}" + END,
            examples=["01 00 FF"],
            description="the report id and 1 to 4095 bytes more, in hexadecimal digits",
        ),
    ]

    def made(self) -> HidReport:
        return HidReport(self.path, bytes.fromhex(self.data))


class ProfileKeys(Table, kw_only=True):
    """What a device takes, and what it must never be given: docs/profiles.md. A profile that fits
    this schema may still break a rule that needs several values at once; hapfmt profile check knows
    all rules."""

    name: Name
    description: Text = ""
    source: Annotated[Text, what("where the layout of the reports and the limits come from")] = ""
    gain: Annotated[float, above(0, 1, "of everything, unless the caller says otherwise")] = 0.5
    match: Annotated[tuple[MatchKeys, ...], tables(0, 64, "[[match]]: which devices it fits")] = ()
    timing: Annotated[TimingKeys, limit("[timing]")]
    actuator: Annotated[tuple[ActuatorKeys, ...], tables(1, 256, "[[actuator]] for each one")]
    report: Annotated[tuple[ReportKeys, ...], tables(1, 16, "[[report]] for each one of a frame")]
    neutral: Annotated[
        tuple[PayloadKeys, ...], tables(0, 16, "sent for rest instead of a frame at rest")
    ] = ()
    init: Annotated[tuple[PayloadKeys, ...], tables(0, 64, "sent before the first frame")] = ()
    exit: Annotated[tuple[PayloadKeys, ...], tables(0, 64, "sent at the end")] = ()


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
    """The profile that the values of a TOML file describe."""
    keys = read(ProfileKeys, values)
    profile = Profile(
        name=keys.name,
        description=keys.description,
        source=keys.source,
        gain=keys.gain,
        matches=tuple(Match(**vars(each)) for each in keys.match),
        timing=keys.timing.made(),
        actuators=tuple(each.made() for each in keys.actuator),
        reports=tuple(each.made() for each in keys.report),
        neutral=tuple(each.made() for each in keys.neutral),
        init=tuple(each.made() for each in keys.init),
        exit=tuple(each.made() for each in keys.exit),
        text=text,
    )
    check(profile)
    return profile
