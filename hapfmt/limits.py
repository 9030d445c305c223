"""The one limits table (SPEC clause 12) and the caller's own caps."""

from __future__ import annotations

import re
from dataclasses import dataclass

from .errors import FormatError, LimitError, ParameterError


@dataclass(frozen=True)
class Level:
    """Upper bounds of one level; each is checked before memory is taken."""

    number: int
    count_bits: int
    """Signed bits of the declared range of full-band and LF tracks."""
    residual_bits: int
    """Signed bits of the declared range of HF tracks."""
    count_bound: int
    """Largest magnitude of a knot's count; twice it bounds level times step."""
    step: int
    """Largest step."""
    payload_size: int
    """Largest payload of a chunk in bytes."""
    cluster_samples: int
    """Decoded samples (ticks times components) in one cluster."""
    packets: int
    """Packets in one cluster."""
    span_ticks: int = 1 << 24
    """Ticks of a packet, and the largest tick of a knot within it."""

    def check(self, name: str, value: int, requirement: str, offset: int | None = None) -> None:
        """Raise FormatError where ``value`` is above the bound called ``name``."""
        bound = getattr(self, name)
        if value > bound:
            raise FormatError(
                f"{name.replace('_', ' ')} {value} is above {bound} (level {self.number})",
                requirement=requirement,
                offset=offset,
            )


LEVELS: dict[int, Level] = {
    1: Level(1, 24, 25, 1 << 24, 1 << 24, 1 << 20, 1 << 22, 1 << 14),
    2: Level(2, 32, 32, 1 << 32, 1 << 31, 1 << 24, 1 << 28, 1 << 17),
}
"""Level 1 keeps every step of decoding below 2**53, so it is exact in a float64 or a JavaScript
Number; level 2 needs 64-bit integers."""


ROOM_FOR = {
    "packet_samples": 160,
    "samples": 48,
    "records": 1 << 12,
    "components": 1 << 14,
    "metadata": 1 << 9,
    "attachments": 8,
    "events": 1 << 12,
}
"""Bytes of memory per unit of each limit: the memory divided by them bounds that limit. They leave
room for the other limits at the same time. A sample of the packet being decoded takes up to 70
bytes. A sample that is held and converted takes 38, a chunk or a finding 700, an event 1000. A
component that is described and printed takes 8000, a byte of metadata 60."""

COUNTED = {
    "packet_samples": "samples in one packet",
    "work_samples": "samples in one pass",
    "samples": "samples at once (of all channels that are read)",
    "records": "chunks and findings",
    "components": "components described",
    "metadata": "bytes of metadata and clocks",
    "attachments": "bytes of attachments",
    "events": "events at once",
}
"""What each limit counts, for messages."""

_SHIFTS = {"": 0, "k": 10, "m": 20, "g": 30, "t": 40}
_SIZE = re.compile(r"(\d{1,15})\s*([kmgt]?)(i?b)?", re.ASCII)


def parse_size(text: str | int) -> int:
    """Bytes of 268435456, "256M", "2 GiB"; K, M, G and T are powers of 1024."""
    match = _SIZE.fullmatch(str(text).strip().lower())
    if match is None or not int(match[1]):
        raise ParameterError(f"{str(text)[:40]!r} is not a size, such as 500000000, 256M or 2G")
    return int(match[1]) << _SHIFTS[match[2]]


@dataclass(frozen=True)
class Limits:
    """What a caller allows a file to use; more makes it unsupported, not damaged (LIM-003).

    memory
        bytes for reading, checking or converting, without the program itself. The other limits
        are reduced to what fits.
    samples
        decoded samples in memory at once.
    packet_samples
        samples of one packet.
    work_samples
        samples decoded in one pass, kept or not (108 hours of 22 channels at 1 kHz).
    records
        chunks of the file, and findings of damage.
    components
        components of all described tracks.
    metadata, attachments
        bytes of the metadata with the clocks, and of the attachments.
    events
        events in memory at once.
    """

    samples: int = 1 << 28
    packet_samples: int = 1 << 24
    work_samples: int = 1 << 33
    memory: int | None = None
    records: int = 1 << 20
    components: int = 1 << 17
    metadata: int = 1 << 26
    attachments: int = 1 << 30
    events: int = 1 << 18

    def __post_init__(self) -> None:
        if self.memory is None:
            return
        for name, size in ROOM_FOR.items():
            bound = min(getattr(self, name), max(self.memory // size, 1))
            object.__setattr__(self, name, bound)

    @classmethod
    def of_memory(cls, size: str | int) -> Limits:
        """Limits for this much memory, in bytes or as a text: "256M". Raises ParameterError."""
        return cls(memory=parse_size(size))

    def check(self, name: str, value: int, offset: int | None = None) -> None:
        """Raise LimitError if ``value`` is above the limit ``name``."""
        bound = getattr(self, name)
        if value > bound:
            way = f"raise Limits({name}=...)"
            if self.memory is not None and name in ROOM_FOR:
                way = f"allow more than {self.memory} bytes of memory (max_memory=)"
            raise LimitError(
                f"{value} {COUNTED[name]} are above the limit of {bound}: {way}",
                requirement="LIM-003",
                offset=offset,
            )


LAST_TRACK_ID = 65_533
"""SPEC TRK-003."""

LAST_CHANNEL = 65_534
"""SPEC TRK-010."""

TICK_LIMIT = 1 << 48
"""Ticks end at 2**48: 8900 years at 1 kHz, and exact in a float64."""

EXACT_LIMIT = 1 << 53
"""Integers up to here are exact in IEEE 754 binary64."""

FRACTION_LIMIT = 1 << 16
"""kn and kd of a Weber fraction stay below (SPEC DBC-001, LPC-002)."""

ZERO_LIMIT = 1 << 31
"""-2**31 <= zero < 2**31 (SPEC DBC-001, LPC-002); then kn * |x - zero| < 2**16 * 2**33 fits an
int64."""

AFFINE_LIMIT = 1 << 52
"""A and B of a calibration stay below, so that a svarint holds them (SPEC VAL-001)."""

SINGLE_MAX = 2.0**128 - 2.0**104
"""Largest binary32."""
