"""Names that a person mistyped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from .errors import ParameterError, UnknownChannelError

SHOWN = 30
"""Names that a message lists."""


def similar(name: str, known: Iterable[str], cutoff: float | None = None) -> str | None:
    """The known name that a mistyped one most resembles; ``cutoff``: least similarity, 0 to 1."""
    from difflib import get_close_matches

    names = {each.lower(): each for each in known if each}
    cutoff = cutoff or (0.6 if len(name) > 3 else 0.5)
    found = get_close_matches(name.lower(), names, n=1, cutoff=cutoff)
    return names[found[0]] if found else None


def matching(pattern: str, names: Sequence[str]) -> list[int]:
    """The places of the names that a pattern such as "pos_*" fits; none where the text is itself a
    name, or has no wildcard."""
    from fnmatch import fnmatchcase

    if pattern in names or not any(sign in pattern for sign in "*?["):
        return []
    return [place for place, name in enumerate(names) if fnmatchcase(name, pattern)]


def channels_called(names: Any, labels: Mapping[int, str]) -> list[int]:
    """Numbers of channels by label or number, in the order asked for; ``labels`` by number.

    A text that is no label but a number is taken as one; others may be patterns such as "pos_*".
    Negative numbers count from the end. Of several channels of one label the first is meant.
    """
    if isinstance(names, (slice, set, frozenset, dict)) or not isinstance(
        names, (str, int, Iterable)
    ):
        raise ParameterError(
            f"channels are a label, a number or a list of them, not a {type(names).__name__}"
        )
    numbers = [*labels]
    by_label = {labels[number]: number for number in reversed(numbers)}
    by_number = {str(number): number for number in numbers}
    by_number |= {str(i - len(numbers)): number for i, number in enumerate(numbers)}
    chosen = []
    for name in [names] if isinstance(names, (str, int)) else names:
        found = by_label.get(name) if isinstance(name, str) else None
        found = by_number.get(str(name)) if found is None else found
        if found is not None:
            chosen.append(found)
            continue
        several = matching(name, [*labels.values()]) if isinstance(name, str) else []
        if not several:
            raise UnknownChannelError(unknown("channel", name, labels))
        chosen += [numbers[place] for place in several]
    return chosen


def unknown(kind: str, name: object, known: Iterable[str] | Mapping[int, str]) -> str:
    """The message for a name that is not known: the one that was meant, or those that there are,
    with their numbers where it has them."""
    names = list(known.values()) if isinstance(known, Mapping) else list(known)
    meant = similar(name, names) if isinstance(name, str) else None
    if meant is not None:
        return f"no {kind} {name!r}; did you mean {meant!r}?"
    listed = list(map(repr, names))
    if isinstance(known, Mapping):
        listed = [f"{number}={text}" for number, text in zip(known, listed, strict=True)]
    more = f" and {len(listed) - SHOWN} more" if len(listed) > SHOWN else ""
    return f"no {kind} {name!r}; there are: {', '.join(listed[:SHOWN]) or 'none'}{more}"
