"""Events as people have them: markers and annotations, in seconds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

from .errors import ParameterError
from .numbers import exact


@dataclass(frozen=True)
class Event:
    """A text at ``time``, seconds from the zero of the recording, that holds for ``duration``.

    A float means its shortest decimal. A file keeps times exactly where their common
    denominator is below 2^32, else to the microsecond. An event that is read names its channel by
    the number. channel: the place of a channel in the
    recording, or its label; None: the event speaks of all. layer: events that belong together.
    """

    time: Fraction
    text: str = ""
    duration: Fraction = Fraction(0)
    channel: int | str | None = None
    layer: str = ""

    def __post_init__(self) -> None:
        for name in ("time", "duration"):
            seconds = exact(getattr(self, name))
            if seconds < 0:
                raise ParameterError(f"the {name} of an event must not be negative")
            object.__setattr__(self, name, seconds)
        if not (isinstance(self.text, str) and isinstance(self.layer, str)):
            raise ParameterError("the text and the layer of an event must be strings")
        if self.channel is not None and not isinstance(self.channel, (int, str)):
            raise ParameterError("the channel of an event must be a number, a label or None")


def in_order(events: Iterable[Event]) -> list[Event]:
    """By time; those of one time as they come."""
    return sorted(events, key=lambda event: event.time)


def by_layer(events: Iterable[Event]) -> dict[str, list[Event]]:
    """In order of time, the layers as they come first."""
    found: dict[str, list[Event]] = {}
    for event in events:
        found.setdefault(event.layer, []).append(event)
    return {layer: in_order(own) for layer, own in found.items()}


def channel_of(event: Event, labels: Sequence[str]) -> int | None:
    """The number of the channel that an event speaks of."""
    if isinstance(event.channel, str):
        if event.channel not in labels:
            raise ParameterError(f"an event names channel {event.channel!r}, which does not exist")
        return labels.index(event.channel)
    if event.channel is not None and not 0 <= event.channel < len(labels):
        raise ParameterError(f"an event names channel {event.channel} of {len(labels)}")
    return event.channel
