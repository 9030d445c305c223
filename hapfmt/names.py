"""Names that a person mistyped."""

from __future__ import annotations

from collections.abc import Iterable

SHOWN = 12
"""Names that a message lists."""


def similar(name: str, known: Iterable[str]) -> str | None:
    """The known name that a mistyped one most resembles."""
    from difflib import get_close_matches

    names = {each.lower(): each for each in known if each}
    found = get_close_matches(name.lower(), names, n=1, cutoff=0.6)
    return names[found[0]] if found else None


def unknown(kind: str, name: object, known: Iterable[str]) -> str:
    """The message for a name that is not known: the one that was meant, or those that there are."""
    names = list(known)
    meant = similar(name, names) if isinstance(name, str) else None
    if meant is not None:
        return f"no {kind} {name!r}; did you mean {meant!r}?"
    return f"no {kind} {name!r}; there are: {listed(names)}"


def listed(names: Iterable[str]) -> str:
    every = list(names)
    more = f" and {len(every) - SHOWN} more" if len(every) > SHOWN else ""
    return (", ".join(map(repr, every[:SHOWN])) or "none") + more
