"""Which channel plays on which actuator, and in words what is left out (SPEC PLY-008)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

from ...errors import ParameterError
from ...reading.catalogue import ChannelRef
from ...reading.reader import Reader
from ..profile.model import Actuator, Profile
from .units import factor_for


@dataclass(frozen=True)
class Route:
    """A channel, by its number, plays on an actuator, by its place in the profile."""

    channel: int
    actuator: int
    factor: Fraction
    """The actuator's unit in one of the channel's."""


@dataclass(frozen=True)
class Assignment:
    routes: tuple[Route, ...]
    left_out: tuple[str, ...] = ()
    """Channels and actuators that nothing is assigned to, and why."""
    notes: tuple[str, ...] = ()
    """What is played otherwise than the file has it."""


def assign(reader: Reader, profile: Profile, given: Sequence[str] = ()) -> Assignment:
    """By ``given`` texts "A=1": channel, by label or number, = actuator, by name or number from 1.

    Without them: the same label or body site first, then by unit in order. What was asked for and
    cannot be is a ParameterError; what nobody asked for is left out.
    """
    if given:
        routes = [route_of(text, reader, profile) for text in given]
        refuse_twice(routes, profile)
    else:
        routes = defaults(reader.channels, profile)
    routes.sort(key=lambda route: route.actuator)
    by_number = {ref.number: ref for ref in reader.channels}
    notes = [
        f"channel {name_of(by_number[route.channel])}: {what}"
        for route in routes
        for what in parts_left(by_number[route.channel], profile.actuators[route.actuator])
    ]
    return Assignment(
        tuple(routes),
        tuple(left_out(reader.channels, routes, profile, chosen=bool(given))),
        tuple(notes),
    )


def route_of(text: str, reader: Reader, profile: Profile) -> Route:
    channel, equals, actuator = text.rpartition("=")
    if not equals or not channel.strip() or not actuator.strip():
        raise ParameterError(
            f"{text!r} is not an assignment: CHANNEL=ACTUATOR, such as 0={names(profile)}"
        )
    ref = reader.select(channel.strip())[0]
    place = actuator_called(actuator.strip(), profile)
    factor, fault = fit(ref, profile.actuators[place])
    if factor is None:
        raise ParameterError(
            f"channel {name_of(ref)} cannot play on actuator {profile.actuators[place].name!r}: "
            f"{fault}"
        )
    return Route(ref.number, place, factor)


def actuator_called(name: str, profile: Profile) -> int:
    for place, actuator in enumerate(profile.actuators):
        if actuator.name == name:
            return place
    if name.isascii() and name.isdecimal() and 1 <= int(name) <= len(profile.actuators):
        return int(name) - 1
    raise ParameterError(
        f"profile {profile.name} has no actuator {name!r}; it has {names(profile)}"
    )


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


def defaults(channels: Sequence[ChannelRef], profile: Profile) -> list[Route]:
    """Each channel once: where the names say so, then where the body sites do, then in order."""
    routes: list[Route] = []
    free = dict(enumerate(profile.actuators))
    waiting = list(channels)
    for same in (same_name, same_site, lambda *_: True):
        for place, actuator in list(free.items()):
            for ref in waiting:
                factor, _ = fit(ref, actuator)
                if factor is not None and same(ref, actuator):
                    routes.append(Route(ref.number, place, factor))
                    waiting.remove(ref)
                    del free[place]
                    break
    return routes


def same_name(ref: ChannelRef, actuator: Actuator) -> bool:
    return ref.label.strip().casefold() == actuator.name.strip().casefold()


def same_site(ref: ChannelRef, actuator: Actuator) -> bool:
    site = ref.track.components[ref.index].body_site.strip().casefold()
    return bool(site) and site == actuator.body_site.strip().casefold()


def fit(ref: ChannelRef, actuator: Actuator) -> tuple[Fraction | None, str]:
    """The factor of the unit, or why it does not go."""
    unsupported = [track.unsupported for track in ref.tracks if track.unsupported]
    if unsupported:
        return None, f"it cannot be decoded ({unsupported[0]})"
    unit = ref.track.components[ref.index].unit
    factor = factor_for(unit, actuator.accepts)
    if factor is None:
        accepted = ", ".join(actuator.accepts) or "no unit"
        return None, f"its unit is {unit}, the actuator takes {accepted}"
    if actuator.band == "hf" and not any(part.residual for part in ref.parts):
        return None, "it has no HF track, and the actuator renders nothing else"
    return factor, ""


def parts_left(ref: ChannelRef, actuator: Actuator) -> Iterable[str]:
    """What of a channel the actuator does not render."""
    if actuator.band == "lf" and any(part.residual for part in ref.parts):
        yield f"its HF is left out, since {actuator.name!r} renders LF only"
    if actuator.band == "hf":
        yield f"its LF is left out, since {actuator.name!r} renders HF only"
        if not all(part.residual for part in ref.parts):
            yield "a part of it has no HF track, and is left out"


def left_out(
    channels: Sequence[ChannelRef], routes: Sequence[Route], profile: Profile, *, chosen: bool
) -> Iterable[str]:
    played = {route.channel for route in routes}
    served = {route.actuator for route in routes}
    for ref in channels:
        if ref.number not in played:
            yield f"channel {name_of(ref)}: {'not chosen' if chosen else why_not(ref, profile)}"
    for place, actuator in enumerate(profile.actuators):
        if place not in served:
            yield f"actuator {actuator.name!r} stays at rest: no channel for it"


def why_not(ref: ChannelRef, profile: Profile) -> str:
    faults = {fit(ref, actuator) for actuator in profile.actuators}
    if any(factor is not None for factor, _ in faults):
        return "every actuator that it could play on has another channel"
    return sorted(fault for _, fault in faults)[0] if faults else "the profile has no actuators"


def name_of(ref: ChannelRef) -> str:
    return f"{ref.number} {ref.label!r}" if ref.label else str(ref.number)
