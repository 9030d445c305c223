"""Decoded tracks -> channels (SPEC clause 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .codecs.raw import DTYPES
from .container.track import Component, Track
from .recording import Calibration, Channel, Deviation, Span, append_span

SMALL_ROOM = 1 << 22
"""Bytes."""


class Growing:
    """Rows that come piece by piece and end as one array, without both in memory at once.

    Small room is doubled; large room grows by an eighth, and is moved by the operating system, not
    copied.
    """

    def __init__(self, likely: int = 0) -> None:
        """``likely``: how many rows there will be."""
        self.likely = likely
        self.room: NDArray[Any] | None = None
        self.used = 0

    def append(self, rows: NDArray[Any]) -> None:
        """rows [ticks, components], of one dtype and width throughout."""
        stop = self.used + len(rows)
        if self.room is None:
            self.room = np.empty((max(stop, self.likely), *rows.shape[1:]), rows.dtype)
        elif stop > len(self.room) and self.room.nbytes < SMALL_ROOM:
            # What numpy adds to an array that is resized it fills with zeros first.
            room = np.empty((max(stop, 2 * len(self.room)), *rows.shape[1:]), rows.dtype)
            room[: self.used] = self.room[: self.used]
            self.room = room
        elif stop > len(self.room):
            size = max(stop, len(self.room) * 9 // 8)
            self.room.resize((size, rows.shape[1]), refcheck=False)
        self.room[self.used : stop] = rows
        self.used = stop

    def joined(self) -> NDArray[Any] | None:
        """All rows; None where there were none. Nothing is appended after that."""
        if self.room is not None and len(self.room) > self.used:
            self.room.resize((self.used, self.room.shape[1]), refcheck=False)
        return self.room


@dataclass
class Decoded:
    """Decoded packets of one track in order of time."""

    track: Track
    pieces: Growing = field(default_factory=Growing)
    spans: list[Span] = field(default_factory=list)
    doubles: list[NDArray[np.float64]] = field(default_factory=list)
    """Exact values, beside each of the pieces or none."""

    def add(
        self, start: int, numbers: NDArray[Any], exact: NDArray[np.float64] | None = None
    ) -> None:
        """numbers [ticks, components] from tick ``start`` on; exact: [ticks]"""
        if not len(numbers):
            return
        append_span(self.spans, Span(start, start + len(numbers)))
        self.pieces.append(numbers)
        if exact is not None:
            self.doubles.append(exact)

    def numbers(self) -> NDArray[Any]:
        """[samples, components]"""
        joined = self.pieces.joined()
        if joined is None:
            dtype = DTYPES.get(self.track.number_format, np.dtype(np.int32))
            return np.zeros((0, len(self.track.components)), dtype)
        return joined

    def exact(self) -> NDArray[np.float64] | None:
        """[samples], or None where the counts are all there is."""
        return np.concatenate(self.doubles) if self.doubles else None


def add_residual(lf: Decoded, hf: Decoded) -> Decoded:
    """d + e^, clamped to the LF track's range, where both are covered (DEC-002, DEC-003)."""
    low, high = lf.track.count_min, lf.track.count_max
    d, e = lf.numbers(), hf.numbers()
    out = Decoded(lf.track)
    for (i, j), span in intersect(lf.spans, hf.spans):
        both = d[i : i + span.ticks].astype(np.int64) + e[j : j + span.ticks]
        out.add(span.start, np.clip(both, low, high).astype(np.int32))
    return out


def intersect(a: Sequence[Span], b: Sequence[Span]) -> list[tuple[tuple[int, int], Span]]:
    """Common spans, and at which sample of a and of b each starts."""
    out = []
    i = j = at = bt = 0
    while i < len(a) and j < len(b):
        start, stop = max(a[i].start, b[j].start), min(a[i].stop, b[j].stop)
        if start < stop:
            out.append(((at + start - a[i].start, bt + start - b[j].start), Span(start, stop)))
        if a[i].stop <= b[j].stop:
            at += a[i].ticks
            i += 1
        else:
            bt += b[j].ticks
            j += 1
    return out


def build_channel(
    decoded: Decoded, index: int, component: Component, *, hf_only: bool = False
) -> Channel:
    """The channel of component ``index``; ``component`` is its description in the base track."""
    counts = decoded.track.number_format == "counts"
    a, b, d = component.calibration
    deviation = Deviation(*component.deviation) if component.deviation else None
    return Channel(
        values=np.ascontiguousarray(decoded.numbers()[:, index]),
        rate=decoded.track.rate,
        coverage=tuple(decoded.spans),
        calibration=Calibration(a, 0 if hf_only else b, d) if counts else None,
        label=component.label,
        unit=component.unit,
        quantity=component.quantity,
        axis=component.axis,
        group=component.group,
        body_site=component.body_site,
        device=component.device,
        deviation=deviation,
        exact=decoded.exact(),
    )
