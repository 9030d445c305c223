"""Files that break one rule, every checksum right and every other rule kept; and their cases."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from math import ceil
from typing import Any, NamedTuple

import forge as f
from case import DAMAGED, NONCONFORMING, Case, numbers

EITHER = [0, NONCONFORMING]
"""Exit codes of ``decode`` where a decoder need not look."""

RECOVERED = [0, DAMAGED]
"""Of ``recover``, for which broken rules are damage: whether something is lost is not said here."""

NOTHING = "framing/nothing"
"""No chunk, so nothing to recover."""

REFUSED = {"COD", "DAT-009", "EVT", "EXA", "KNT", "KTE", "LIM", "LPC", "MDC", "NOI", "QNT", "RAW",
           "RNG"}  # fmt: skip
"""Rules that a decoder keeps (SPEC 16): it refuses what breaks one."""

HEAD, TRACK, DATA = ("HEAD", f.head()), f.TRACK_0, f.DATA_0
TRACK_AT = 8 + f.HEADER + len(HEAD[1])
DATA_AT = TRACK_AT + f.HEADER + len(TRACK[1])
END = DATA_AT + f.HEADER + len(DATA[1])
"""Offset of the chunk after HEAD, TRACK, DATA."""


CODECS = ("EVNT", "KNOT", "LPCR", "LPCX", "MDCT", "NOIS", "QUAN", "RAWB")


ENDS = ("alone", "and-a-byte", "cut-short", "missing", "none", "of-no-bytes", "past-the-packet",
        "too-long", "too-short", "without")  # fmt: skip
"""Names of packets that end too early or too late: COD-001 is right of all, and CNV-002."""


def needs(data: bytes) -> dict[str, Any]:
    """Codecs and level, found in the bytes."""
    found = [codec for codec in CODECS if codec.encode() in data]
    at = data.find(b"HEAD")
    return {"codecs": found, "level": 2 if data[at + 30 : at + 31] == b"\2" else 1}


def track(values: Sequence[int], number: int = 0, start: int = 0) -> dict[str, Any]:
    """One component, one span."""
    spans = [[start, start + len(values)]] if values else []
    return {"track": number, "spans": spans, "numbers": numbers(values)}


FIVES = track([5] * 4)
"""What TRACK and DATA decode to."""


class Row(NamedTuple):
    """``rule``: the id that is broken, or several where the page leaves it open which one is said;
    ``tracks``: what those deliver who do not look; ``decode``: exit codes, where they are others
    than the rule tells; ``also``: another id that a wrong reader breaks here."""

    name: str
    rule: str | tuple[str, ...]
    about: str
    data: bytes
    tracks: Sequence[dict[str, Any]] | None = None
    decode: int | list[int] | None = None
    also: str = ""


def cases(fault: str, rows: Iterable[Row | tuple]) -> Iterable[Case]:
    """Cases of the set invalid."""
    for name, rule, about, data, tracks, told, also in (Row(*row) for row in rows):
        rules = [rule] if isinstance(rule, str) else list(rule)
        if fault.startswith("entropy/") and any(word in name for word in ENDS):
            rules = list(dict.fromkeys([*rules, "COD-001", "CNV-002"]))
        refused = rules[0] in REFUSED or rules[0][:3] in REFUSED
        decode = NONCONFORMING if refused and tracks is None else EITHER
        expect: dict[str, Any] = {
            "needs": needs(data),
            "exit": {"decode": decode if told is None else told, "verify": NONCONFORMING}
            | {"recover": NONCONFORMING if fault == NOTHING else RECOVERED},
            "verdict": "nonconforming",
            "verify": {"requirement": rules[0] if len(rules) == 1 else rules},
            "recover": {"verdict": "intact", "decode": {}},
        }
        if tracks is not None:
            expect["decode"] = {"tracks": list(tracks)}
        touched = [rules[0], *([also] if also else [])]
        yield Case("invalid", name, about, touched, data, expect, fault)


def lasting(span: int, rate: Fraction = Fraction(1000)) -> int:
    """Nanoseconds, as a footer says them."""
    return min(ceil(span * 10**9 / rate), 2**63 - 1)


def described(tlvs: bytes = f.HOLD, *more: Any, packet: bytes = f.KNOT_DATA, span: int = 4,
              start: int = 0, first: int = 0, level: int = 1, **fields: Any) -> bytes:  # fmt: skip
    """A closed file of one series, whose first track has one packet."""
    return f.closed(
        ("HEAD", f.head(level=level)),
        ("TRAK", f.trak(tlvs, **fields, first=first)),
        ("DATA", f.cluster((first, start, span, packet))),
        *more,
        duration_ns=lasting(start + span, rate_of(fields)),
    )


def rate_of(fields: dict[str, Any]) -> Fraction:
    return Fraction(fields.get("rate_num", 1000), fields.get("rate_den", 1) or 1) or Fraction(1)


def packed(codec: bytes, parameters: bytes, packet: bytes, span: int = 4, **given: Any) -> bytes:
    """The same, by a codec and its parameters."""
    tlvs = f.tlv(1, parameters) + given.pop("tlvs", b"")
    return described(tlvs, packet=packet, span=span, codec=codec, **given)


def series(*chunks: Any, data: Any = DATA, **changes: Any) -> bytes:
    """HEAD, then TRAK payloads of track 0 that get their first ids, then DATA; closed."""
    rows = [("TRAK", f.varint(number) + payload[1:]) for payload, number in chunks]
    return f.closed(HEAD, *rows, data, **changes)
