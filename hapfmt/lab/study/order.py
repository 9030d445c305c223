"""What one subject feels, in which order: random, the same each time, and the same in every
version of Python, since it sorts by digests of what it orders."""

from __future__ import annotations

import hashlib
import re
from typing import NamedTuple

from ...errors import ParameterError
from .description import Study

SUBJECT = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


class Trial(NamedTuple):
    """One question: a condition beside the reference of its session."""

    session: str
    condition: str
    repeat: int = 0
    training: bool = False


def order(study: Study, subject: str) -> list[Trial]:
    """Training first; then session after session, in each of them repeat after repeat."""
    refuse_subject(subject)

    def drawn(*what: object) -> bytes:
        words = (study.head.seed, subject, *what)
        return hashlib.sha256("\0".join(map(str, words)).encode()).digest()

    sessions = sorted((each.name for each in study.sessions), key=drawn)
    found = [
        Trial(sessions[0], name, training=True)
        for name in sorted(study.head.training, key=lambda name: drawn("training", name))
    ]
    for session in sessions:
        for repeat in range(study.head.repeats):
            names = (each.name for each in study.conditions)
            found += [
                Trial(session, name, repeat)
                for name in sorted(names, key=lambda name: drawn(session, repeat, name))
            ]
    return found


def refuse_subject(subject: str) -> None:
    if not SUBJECT.fullmatch(subject):
        raise ParameterError(
            f"{subject[:80]!r} cannot be a subject: letters without accents, digits, '.', '_' and "
            "'-', at most 64 (a code such as S07; no names, which answers should not hold)"
        )
