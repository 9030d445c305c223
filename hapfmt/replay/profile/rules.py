"""What the values of a profile must be together; a profile that passes may be played."""

from __future__ import annotations

from math import isfinite
from typing import NoReturn

from ...descriptions import DescriptionError
from .layout import Const, Counter, Crc32, Field, Integer, Layout, Mapped, One, Samples
from .maps import MAPS, MOST_COUNTS
from .model import Actuator, Profile, exact
from .packing import Packer

LIMITS = "PLY-001"


def check(profile: Profile) -> None:
    """ParameterError, naming the key path, for the first rule that is broken."""
    _timing(profile)
    _unique(profile)
    for n in range(len(profile.actuators)):
        _limits(profile, n)
    used: set[str] = set()
    for n, layout in enumerate(profile.reports):
        used |= _layout(profile, layout, f"report[{n}]")
    for n, actuator in enumerate(profile.actuators):
        if actuator.name not in used:
            fail(f"actuator[{n}]", f"{actuator.name!r} is in no report; add a field, or remove it")
    _payloads(profile)


def fail(at: str, text: str, requirement: str | None = None) -> NoReturn:
    raise DescriptionError(at, text, requirement)


def _timing(profile: Profile) -> None:
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


def _layout(profile: Profile, layout: Layout, at: str) -> set[str]:
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
        _field(profile, [profile.actuators[index[name]] for name in names(field)], field, where)
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
            _crc32(field, layout, f"{where}.crc32")
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


def _field(profile: Profile, actuators: list[Actuator], field: Field, at: str) -> None:
    if isinstance(field, Counter) and field.mask << field.shift > field.type.high:
        fail(f"{at}.shift", f"moves bits of the mask out of {field.type.name}; lower one of them")
    if isinstance(field, One | Mapped) and profile.timing.frame_samples > 1:
        count = profile.timing.frame_samples
        fail(at, f"holds one of the {count} samples of a frame; use samples = [...] instead")
    if isinstance(field, One | Samples):
        for actuator in actuators:
            _holds(profile, actuator, field.type, at)
    if isinstance(field, Mapped):
        _mapped(profile, actuators, field, at)


def _holds(profile: Profile, actuator: Actuator, integer: Integer, at: str) -> None:
    low, high, _, _ = profile.limits(actuator)
    if low < integer.low or high > integer.high:
        fail(
            f"{at}.type",
            f"{integer.name} holds {integer.low} to {integer.high}, but {actuator.name!r} has "
            f"counts from {low} to {high}; use a wider type, or a larger step",
        )


def _mapped(profile: Profile, actuators: list[Actuator], field: Mapped, at: str) -> None:
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


def _crc32(field: Crc32, layout: Layout, at: str) -> None:
    if not field.start < field.stop <= layout.length:
        fail(f"{at}.to", f"must be above from, {field.start}, and at most {layout.length}")
    if field.start < field.at + 4 and field.at < field.stop:
        fail(f"{at}.to", f"covers the CRC itself, at {field.at}; end there or before")
    for other in layout.fields:
        if isinstance(other, Crc32) and other is not field and _later(other, field, layout):
            fail(f"{at}.to", "covers a CRC that comes later in fields; list that one first")


def _later(other: Crc32, field: Crc32, layout: Layout) -> bool:
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


def _rests(profile: Profile, layout: Layout, rest: bytes, data: bytes, at: str) -> None:
    if len(data) != layout.length:
        text = f"has {len(data)} bytes, but report {layout.id} has {layout.length}; write as many"
        fail(at, text)
    for field in layout.fields:
        if names(field):
            part = slice(field.at, field.at + size(field, profile.timing.frame_samples))
            if data[part] != rest[part]:
                text = f"moves {', '.join(names(field))} from rest; write {rest[part].hex(' ')!r}"
                fail(at, f"{text} at byte {field.at}", "PLY-002")
