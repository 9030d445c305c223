"""A case: one file, one fact, and what a program must make of it.

Imports nothing from hapfmt; what is expected comes from the facts of the case and from the page.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

SETS = ("valid", "uncommon", "recoverable", "invalid", "future", "limits", "render", "encode")

FAULTS = (
    "transmission", "crash", "framing", "structure", "semantics", "entropy", "limits", "version",
)  # fmt: skip
"""The first words of faults: conformance/FAULTS.md says what belongs where."""

SHOWN = 256
"""So many numbers are written out in an expectation; of more it holds the SHA-256 alone."""

INTACT, ERROR, NONCONFORMING, DAMAGED, UNSUPPORTED = range(5)
"""Exit codes (SPEC 13)."""


@dataclass(frozen=True)
class Case:
    """``data`` is the file, or makes it on demand (set limits), or the files of a job by their
    names (set encode). ``expect``: members as in conformance/README.md; what is not there is not
    compared."""

    set: str
    name: str
    about: str
    requirements: Sequence[str]
    data: bytes | Callable[[], bytes] | dict[str, bytes]
    expect: dict[str, Any] = field(default_factory=dict)
    fault: str | None = None

    def __post_init__(self) -> None:
        assert self.set in SETS and self.about.endswith(".") and self.requirements, self.name
        assert self.fault is None or self.fault.split("/")[0] in FAULTS, self.fault


def numbers(values: Sequence[int], *, words: bool = False) -> dict[str, Any]:
    """What stands for a row of numbers in an expectation: how many, the SHA-256 of the numbers as
    i64 (words: u64), little-endian, one after the other, and where they are few the numbers, words
    as text since many readers of JSON hold no more than 53 bits."""
    values = list(values)
    raw = struct.pack(f"<{len(values)}{'Q' if words else 'q'}", *values)
    out: dict[str, Any] = {"count": len(values), "sha256": hashlib.sha256(raw).hexdigest()}
    if len(values) <= SHOWN:
        out["numbers"] = [str(value) if words else value for value in values]
    return out
