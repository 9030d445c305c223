"""The one limits table (SPEC clause 15) and the caller's own caps."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import FormatError, LimitError


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
    """Largest step and quantum."""
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


@dataclass(frozen=True)
class Limits:
    """What the caller is ready to spend on a file; more is *unsupported*, not damage (LIM-003).

    ``samples``: decoded samples held at once, 12 bytes each at most. ``packet_samples``: samples of
    one packet, which takes about 80 bytes each while it is decoded. ``work_samples``: samples
    decoded in one pass, held or not (108 hours of 22 channels at 1 kHz). ``events``: events held at
    once, about half a kilobyte each.
    """

    samples: int = 1 << 28
    packet_samples: int = 1 << 24
    work_samples: int = 1 << 33
    events: int = 1 << 18

    def check_work(self, value: int) -> None:
        if value > self.work_samples:
            raise LimitError(
                f"more than {self.work_samples} samples in one pass: "
                "raise Limits(work_samples=...)",
                requirement="LIM-003",
            )

    def check_events(self, value: int) -> None:
        if value > self.events:
            raise LimitError(
                f"more than {self.events} events at once: read a shorter time range, or raise "
                "Limits(events=...)",
                requirement="LIM-003",
            )

    def check_packet(self, value: int) -> None:
        if value > self.packet_samples:
            raise LimitError(
                f"{value} samples in one packet are above the limit of {self.packet_samples}: "
                "raise Limits(packet_samples=...)",
                requirement="LIM-003",
            )

    def check_samples(self, value: int) -> None:
        if value > self.samples:
            raise LimitError(
                f"{value} samples at once are above the limit of {self.samples}: "
                "read fewer channels, a shorter time range, or raise Limits(samples=...)",
                requirement="LIM-003",
            )


LAST_TRACK_ID = 65_533
"""65 534 tracks; 0xFFFF means "none" (SPEC TRK-003)."""

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
