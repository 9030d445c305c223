"""Assigns channels to actuators and gives the reasons (SPEC PLY-012, PLY-013).

Also converts recorded units to an actuator's unit: those that a profile accepts, with any prefix.
"""

from __future__ import annotations

import re
import shlex
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from ...errors import ParameterError
from ...numbers import exact
from ...reading.catalogue import ChannelRef
from ...reading.reader import Reader
from ...units import to_ucum
from ..profile.model import Actuator, Profile

_POWERS = {
    "Y": 24, "Z": 21, "E": 18, "P": 15, "T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "da": 1, "d": -1,
    "c": -2, "m": -3, "u": -6, "n": -9, "p": -12, "f": -15, "a": -18, "z": -21, "y": -24,
}  # fmt: skip
"""UCUM's metric prefixes."""
_ATOMS = (
    "m", "s", "g", "rad", "K", "C", "cd", "mol", "sr", "N", "Pa", "J", "W", "A", "V", "F", "Ohm",
    "S", "Wb", "Cel", "T", "H", "Hz", "bar", "[g]", "m[H2O]", "m[Hg]", "L", "l", "eV", "lm", "lx",
)  # fmt: skip
"""Units that take a prefix."""
_FACTOR = re.compile(r"(.*?)([+-]?[0-9]{1,2})?", re.DOTALL)


class UnitTerm(NamedTuple):
    """``scale`` times a product of atoms, each with its exponent."""

    scale: Fraction
    atoms: tuple[tuple[str, int], ...]


def parse_term(unit: str) -> UnitTerm:
    """Parses a UCUM term without parentheses and annotations; any other text is one atom."""
    if re.search(r"[(){}]", unit):
        return UnitTerm(Fraction(1), ((unit, 1),))
    scale, atoms = Fraction(1), dict[str, int]()
    for sign, text in re.findall(r"(^|[./])([^./]+)", unit):
        matched = _FACTOR.fullmatch(text)
        assert matched is not None
        body, power = matched[1] or text, int(matched[2] or 1) if matched[1] else 1
        power = -power if sign == "/" else power
        prefix, atom = split_prefix(body)
        scale *= Fraction(10) ** (prefix * power)
        if atom == "%":
            scale, atom = scale / Fraction(100) ** power, "1"
        if atom != "1":
            atoms[atom] = atoms.get(atom, 0) + power
    return UnitTerm(scale, tuple(sorted((atom, n) for atom, n in atoms.items() if n)))


def split_prefix(body: str) -> tuple[int, str]:
    """mN -> (-3, N); m -> (0, m)."""
    if body in _ATOMS:
        return 0, body
    for size in (2, 1):
        if body[:size] in _POWERS and body[size:] in _ATOMS:
            return _POWERS[body[:size]], body[size:]
    return 0, body


def factor_for(unit: str, accepts: Mapping[str, float]) -> Fraction | None:
    """What one recorded unit is in the actuator's; None where it does not accept that unit.

    >>> factor_for("cN", {"N": 1000.0})
    Fraction(10, 1)
    """
    known = {to_ucum(name): exact(factor) for name, factor in accepts.items()}
    unit = to_ucum(unit)
    if unit in known:
        return known[unit]
    term = parse_term(unit)
    for name, factor in known.items():
        other = parse_term(name)
        if other.atoms == term.atoms:
            return factor * term.scale / other.scale
    return None


APART = (
    {"left", "right"},
    {"thumb", "index", "middle", "ring", "little", "palm", "wrist", "arm", "elbow", "shoulder"},
    {"x", "y", "z"},
)
"""Words of one group name different things: a channel of the left hand never drives the right."""
NEUTRAL = {
    "acceleration", "channel", "contact", "finger", "fingertip", "force", "hand", "normal", "on",
    "the", "tip", "vibration",
}  # fmt: skip
"""Words that a text may have next to the name of an actuator. Alone they name none."""
SHOWN = 12
"""Channels that a refusal lists."""
ALIKE = 0.75
"""How alike two spellings must be (difflib) for a hint."""


@dataclass(frozen=True)
class Route:
    """A channel, by its number, drives an actuator, by its place in the profile."""

    channel: int
    actuator: int
    factor: Fraction
    """The actuator's unit in one of the channel's."""
    reason: str = ""
    """Why this channel drives this actuator, for the user."""


@dataclass(frozen=True)
class Assignment:
    routes: tuple[Route, ...]
    left_out: tuple[str, ...] = ()
    """Channels that the user left out."""
    notes: tuple[str, ...] = ()
    """Parts of channels that their actuators do not render."""


@dataclass
class Found:
    """What the words of the channels say."""

    routes: list[Route] = field(default_factory=list)
    faults: dict[int, str] = field(default_factory=dict)
    """Channel without an actuator -> why."""
    near: dict[int, list[str]] = field(default_factory=dict)
    """Channel without an actuator -> actuators that the user may have meant."""


def assign(
    reader: Reader,
    profile: Profile,
    given: Sequence[str] = (),
    *,
    by_order: bool = False,
    ignore: Sequence[str] = (),
    command: str = "",
) -> Assignment:
    """The actuator of each channel.

    ``given``: texts "A=1" (channel, by label or number, = actuator, by name or number from 1);
    other channels are left out. ``by_order``: by unit and order. Otherwise the words of label, body
    site and axis decide, and nothing is guessed. ``ignore``: channels to leave out. ParameterError
    if a channel remains without an actuator; ``command`` is the command line that its advice
    continues.
    """
    if given and (by_order or ignore):
        option = "--map-by-order" if by_order else "--ignore"
        raise ParameterError(f"--map names every channel to play; do not add {option}")
    ignored = {channel_called(text, reader).number for text in ignore}
    channels = [ref for ref in reader.channels if ref.number not in ignored]
    if given:
        routes = [route_of(text, reader, profile) for text in given]
        refuse_twice(routes, profile)
    else:
        found = in_order(channels, profile) if by_order else by_words(channels, profile)
        if found.faults or not found.routes:
            first, *more = refusal(
                found, reader.channels, profile, ignored, command, by_order=by_order
            )
            raise ParameterError(first, more=more)
        routes = found.routes
    routes.sort(key=lambda route: route.actuator)
    by_number = {ref.number: ref for ref in reader.channels}
    notes = [
        f"channel {name_of(by_number[route.channel])}: {what}"
        for route in routes
        for what in parts_left(by_number[route.channel], profile.actuators[route.actuator])
    ]
    played = {route.channel for route in routes}
    left_out = [
        f"channel {name_of(ref)}: {'ignored' if ref.number in ignored else 'not chosen'}"
        for ref in reader.channels
        if ref.number not in played
    ]
    return Assignment(tuple(routes), tuple(left_out), tuple(notes))


# -- by words


@lru_cache(maxsize=4096)
def words_of(text: str) -> tuple[str, ...]:
    """Words in lower case; they end at anything but letters and digits, and at capitals.

    >>> words_of("thumbTip_force 2")
    ('thumb', 'tip', 'force', '2')
    """
    found = []
    for part in re.findall(r"[^\W\d_]+|\d+", unicodedata.normalize("NFKC", text)):
        start = 0
        for at in range(1, len(part)):
            before, here, after = part[at - 1], part[at], part[at + 1 : at + 2]
            if here.isupper() and (before.islower() or after.islower()):
                found.append(part[start:at].casefold())
                start = at
        found.append(part[start:].casefold())
    return tuple(found)


def within(few: Sequence[str], many: Sequence[str]) -> bool:
    """True if each of the words is among the others; numbers alone do not count."""
    return any(not word.isdigit() for word in few) and not Counter(few) - Counter(many)


def apart(one: Sequence[str], other: Sequence[str]) -> bool:
    """True if the words name different hands, fingers or axes."""
    return any(
        group.intersection(one) and group.intersection(other) and not group.intersection(one, other)
        for group in APART
    )


def texts_of(ref: ChannelRef) -> dict[str, str]:
    part = ref.track.components[ref.index]
    return {"label": part.label, "body site": part.body_site, "axis": part.axis}


def names_of(actuator: Actuator) -> list[tuple[str, ...]]:
    return [words for text in (actuator.name, actuator.body_site) if (words := words_of(text))]


def elsewhere(ref: ChannelRef, actuator: Actuator) -> bool:
    """True if the channel is of another hand, finger or axis than the actuator."""
    own = map(words_of, texts_of(ref).values())
    return any(apart(words, others) for words in own for others in names_of(actuator))


def evidence(ref: ChannelRef, actuator: Actuator) -> tuple[str, list[str]]:
    """Return why the words of a channel name an actuator, empty where they do not, and its other
    words that are not known, or name another hand, finger or axis."""
    if elsewhere(ref, actuator):
        return "", []
    own, theirs = texts_of(ref), names_of(actuator)
    spoken = {what: words for what, text in own.items() if (words := words_of(text))}
    its_words = set().union(*theirs)
    known = its_words.union(NEUTRAL, *(group for group in APART if not group & its_words))
    if "label" in spoken and spoken["label"] == words_of(actuator.name):
        return SAME, []
    found = [
        (f"by the words of its {what}, {own[what]!r}", [w for w in words if w not in known])
        for what, words in spoken.items()
        if any(
            within(others, words) or (within(words, others) and not NEUTRAL.issuperset(words))
            for others in theirs
        )
    ]
    return min(found, key=lambda each: len(each[1]), default=("", []))


SAME = "by its label"
"""The same words in the same order: this comes before all other evidence."""


def by_words(channels: Sequence[ChannelRef], profile: Profile) -> Found:
    """Routes where a channel names one actuator and no other channel names it."""
    found = Found()
    named: dict[int, dict[int, str]] = {}
    unknown: dict[int, list[str]] = {}
    for ref in channels:
        reasons = {}
        for place, actuator in enumerate(profile.actuators):
            reason, odd = evidence(ref, actuator)
            if reason and fit(ref, actuator)[0] is not None:
                reasons[place], unknown[ref.number] = reason, odd
        same = {place: reason for place, reason in reasons.items() if reason == SAME}
        named[ref.number] = same or reasons
    by_actuator: dict[int, list[ChannelRef]] = {}
    for ref in channels:
        for place in named[ref.number]:
            by_actuator.setdefault(place, []).append(ref)
    for ref in channels:
        reasons = named[ref.number]
        names_found = [profile.actuators[place].name for place in reasons]
        if len(reasons) != 1:
            found.near[ref.number] = names_found or nearest(ref, profile)
            found.faults[ref.number] = (
                f"its words name {len(reasons)} actuators: {listed(names_found)}"
                if reasons
                else why_not(ref, profile)
            )
            continue
        ((place, reason),) = reasons.items()
        if reason != SAME and unknown[ref.number]:
            found.near[ref.number] = names_found
            found.faults[ref.number] = (
                f"it names {names_found[0]!r}, and has words that are not known: "
                f"{listed(unknown[ref.number])}"
            )
            continue
        rivals = by_actuator[place]
        exact = [each for each in rivals if named[each.number][place] == SAME]
        if (exact or rivals) == [ref]:
            factor, _ = fit(ref, profile.actuators[place])
            assert factor is not None
            found.routes.append(Route(ref.number, place, factor, reason))
            continue
        others = [name_of(each) for each in (exact or rivals) if each is not ref]
        found.near[ref.number] = names_found
        found.faults[ref.number] = (
            f"actuator {names_found[0]!r} is named by another channel too: {listed(others)}"
        )
    return found


def nearest(ref: ChannelRef, profile: Profile) -> list[str]:
    """Actuators whose names are spelt almost as the label, or as a word of it."""
    able = {
        " ".join(words_of(actuator.name)): actuator.name
        for actuator in profile.actuators
        if fit(ref, actuator)[0] is not None
    }
    words = words_of(ref.label)
    near = [
        name
        for text in (" ".join(words), *words)
        for name in get_close_matches(text, able, 1, ALIKE)
    ]
    return [able[name] for name in dict.fromkeys(near)]


def why_not(ref: ChannelRef, profile: Profile) -> str:
    faults = {fit(ref, actuator) for actuator in profile.actuators}
    if any(factor is not None for factor, _ in faults):
        return "its words name no actuator"
    return sorted(fault for _, fault in faults)[0] if faults else "the profile has no actuators"


# -- by order


def in_order(channels: Sequence[ChannelRef], profile: Profile) -> Found:
    """Each channel drives the first free actuator that takes its unit."""
    found = Found()
    free = dict(enumerate(profile.actuators))
    for ref in channels:
        for place, actuator in free.items():
            factor, _ = fit(ref, actuator)
            if factor is not None:
                found.routes.append(Route(ref.number, place, factor, "by unit and order"))
                del free[place]
                break
        else:
            fault = why_not(ref, profile)
            able = any(fit(ref, actuator)[0] is not None for actuator in profile.actuators)
            found.faults[ref.number] = "no actuator is free" if able else fault
    return found


# -- as the user says


def channel_called(name: str, reader: Reader) -> ChannelRef:
    """By label or number; refused where several channels have this label."""
    same = [ref for ref in reader.channels if ref.label == name]
    if len(same) > 1:
        numbers = listed([str(ref.number) for ref in same])
        raise ParameterError(
            f"{len(same)} channels have the label {name!r}; use their numbers: {numbers}"
        )
    return reader.select(name)[0]


def route_of(text: str, reader: Reader, profile: Profile) -> Route:
    channel, equals, actuator = text.rpartition("=")
    if not equals or not channel.strip() or not actuator.strip():
        raise ParameterError(
            f"expected CHANNEL=ACTUATOR, got {text!r}; actuators: {names(profile)}"
        )
    ref = channel_called(channel.strip(), reader)
    place = actuator_called(actuator.strip(), profile)
    factor, fault = fit(ref, profile.actuators[place])
    if factor is None:
        raise ParameterError(
            f"channel {name_of(ref)} cannot drive actuator {profile.actuators[place].name!r}: "
            f"{fault}"
        )
    return Route(ref.number, place, factor, "as --map says")


def actuator_called(name: str, profile: Profile) -> int:
    known = [actuator.name for actuator in profile.actuators]
    if name in known:
        return known.index(name)
    if name.isascii() and name.isdecimal() and 1 <= int(name[:9]) <= len(known):
        return int(name) - 1
    near = get_close_matches(name, known, 1)
    hint = f"did you mean {near[0]!r}? All: " if near else "its actuators: "
    raise ParameterError(f"profile {profile.name} has no actuator {name!r}; {hint}{names(profile)}")


def names(profile: Profile) -> str:
    return ", ".join(f"{i}={actuator.name}" for i, actuator in enumerate(profile.actuators, 1))


def refuse_twice(routes: Iterable[Route], profile: Profile) -> None:
    seen: set[int] = set()
    for route in routes:
        if route.actuator in seen:
            raise ParameterError(
                f"two channels for the actuator {profile.actuators[route.actuator].name!r}"
            )
        seen.add(route.actuator)


# -- refusals


def refusal(
    found: Found,
    channels: Sequence[ChannelRef],
    profile: Profile,
    ignored: set[int],
    command: str,
    *,
    by_order: bool,
) -> list[str]:
    """Lists the missing assignments and the commands that would play, one per line."""
    refs = {ref.number: ref for ref in channels}
    if not found.faults:
        return ["nothing to play: no channel is left"]
    count = len(found.routes) + len(found.faults)
    lines = [f"replay does not guess: {len(found.faults)} of {count} channels have no actuator"]
    lines += [
        f"  {name_of(refs[number])} ({unit_of(refs[number])}): {fault}"
        for number, fault in list(found.faults.items())[:SHOWN]
    ]
    if len(found.faults) > SHOWN:
        lines.append(f"  and {len(found.faults) - SHOWN} more")
    lines += [
        f"  {name_of(refs[route.channel])} drives {profile.actuators[route.actuator].name!r} "
        f"({route.reason})"
        for route in found.routes[:SHOWN]
    ]
    lines.append(f"actuators of {profile.name}: {names(profile)}")
    called = {number: short_name(ref, channels) for number, ref in refs.items()}
    asked = [ref for ref in channels if ref.number not in ignored]
    for what, options in advice(found, asked, profile, ignored, called, by_order=by_order):
        lines += [f"{what}:", "  " + " ".join(filter(None, [command, options]))]
    return lines


def advice(
    found: Found,
    asked: Sequence[ChannelRef],
    profile: Profile,
    ignored: set[int],
    called: Mapping[int, str],
    *,
    by_order: bool,
) -> Iterator[tuple[str, str]]:
    """Yield what the user can do, and the options for it, which play as they are."""
    chosen = {route.channel: profile.actuators[route.actuator].name for route in found.routes}
    lacking = [ref for ref in asked if ref.number in found.faults]
    for near_only in (True, False):  # the actuators that were meant go first
        for ref in lacking:
            near = found.near.get(ref.number, ())
            free = [
                actuator.name
                for actuator in profile.actuators
                if actuator.name not in chosen.values()
                and (actuator.name in near if near_only else not elsewhere(ref, actuator))
                and fit(ref, actuator)[0] is not None
            ]
            if free and ref.number not in chosen:
                chosen[ref.number] = min(free, key=near.index) if near_only else free[0]
    if len(chosen) > len(found.routes):
        yield "to choose actuators, for example", f"--map {pairs(chosen, called)}"
    elif not found.routes:
        return
    if len(found.faults) > SHOWN:
        return
    if found.routes:
        gone = [called[number] for number in sorted({*ignored, *found.faults})]
        order = "--map-by-order " if by_order else ""
        yield "to leave channels out", f"{order}--ignore {shlex.quote(','.join(gone))}"
    ordered = in_order(asked, profile)
    if not ordered.faults:
        effect = ", ".join(
            f"{called[route.channel]} to {profile.actuators[route.actuator].name}"
            for route in ordered.routes
        )
        left = ",".join(called[number] for number in sorted(ignored))
        more = f" --ignore {shlex.quote(left)}" if ignored else ""
        yield f"by unit and order, {effect}", f"--map-by-order{more}"


def pairs(chosen: Mapping[int, str], called: Mapping[int, str]) -> str:
    return shlex.quote(",".join(f"{called[n]}={name}" for n, name in sorted(chosen.items())))


def short_name(ref: ChannelRef, channels: Sequence[ChannelRef]) -> str:
    """The label where it names this channel alone on a command line, else the number."""
    label = ref.label
    plain = label == label.strip() and label.isprintable() and not set(label) & set(",=")
    alone = sum(each.label == label for each in channels) == 1 and not label.isdecimal()
    return label if label and plain and alone else str(ref.number)


def listed(texts: Sequence[str]) -> str:
    more = f" and {len(texts) - SHOWN} more" if len(texts) > SHOWN else ""
    return ", ".join(texts[:SHOWN]) + more


def fit(ref: ChannelRef, actuator: Actuator) -> tuple[Fraction | None, str]:
    """The factor of the unit, or why it does not go."""
    unsupported = [track.unsupported for track in ref.tracks if track.unsupported]
    if unsupported:
        return None, f"it cannot be decoded ({unsupported[0]})"
    unit = unit_of(ref)
    factor = factor_for(unit, actuator.accepts)
    if factor is None:
        accepted = ", ".join(actuator.accepts) or "no unit"
        return None, f"its unit is {unit}, the actuator takes {accepted}"
    if actuator.band == "hf" and not any(part.residual for part in ref.parts):
        return None, "it has no HF track, and the actuator renders nothing else"
    return factor, ""


def unit_of(ref: ChannelRef) -> str:
    return ref.track.components[ref.index].unit


def parts_left(ref: ChannelRef, actuator: Actuator) -> Iterable[str]:
    """What of a channel the actuator does not render, or takes on trust."""
    if unit_of(ref) == "1":
        yield f"it has no unit, so its values are fractions of the full output of {actuator.name!r}"
    if actuator.band == "lf" and any(part.residual for part in ref.parts):
        yield f"its HF is left out, since {actuator.name!r} renders LF only"
    if actuator.band == "hf":
        yield f"its LF is left out, since {actuator.name!r} renders HF only"
        if not all(part.residual for part in ref.parts):
            yield "a part of it has no HF track, and is left out"


def name_of(ref: ChannelRef) -> str:
    return f"{ref.number} {ref.label!r}" if ref.label else str(ref.number)
