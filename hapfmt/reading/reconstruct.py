"""Decoded tracks -> channels (SPEC clause 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.raw import DTYPES
from ..format.track import Component, Track
from ..recording import Calibration, Channel, Deviation, Span, append_span


class Growing:
    """Rows that come piece by piece and end as one array, without both in memory at once: a
    bytearray grows by an eighth, and large ones are moved by the operating system, not copied."""

    def __init__(self) -> None:
        self.room = bytearray()
        self.like: NDArray[Any] | None = None

    def append(self, rows: NDArray[Any]) -> None:
        """rows [ticks, ...], of one dtype and width throughout."""
        if self.like is None:
            self.like = rows[:0].copy()
        self.room += np.ascontiguousarray(rows).data.cast("B")

    def joined(self) -> NDArray[Any] | None:
        """All rows; None where there were none. Nothing is appended after that."""
        if self.like is None:
            return None
        return np.frombuffer(self.room, self.like.dtype).reshape(-1, *self.like.shape[1:])


@dataclass
class Decoded:
    """Decoded packets of one track in order of time."""

    track: Track
    pieces: Growing = field(default_factory=Growing)
    spans: list[Span] = field(default_factory=list)
    doubles: Growing = field(default_factory=Growing)
    """Exact values, beside each of the pieces or none."""

    def add(
        self, start: int, numbers: NDArray[Any], exact: NDArray[np.float64] | None = None
    ) -> None:
        """numbers [ticks, components] from tick ``start`` on; exact: the same"""
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
        """[samples, components], or None where the counts are all there is."""
        return self.doubles.joined()


def sum_of(lf: Track, d: NDArray[Any], e: NDArray[Any]) -> NDArray[np.int32]:
    """d + e^, clamped to the range of the LF track (DEC-001)."""
    both: NDArray[np.int64] = d.astype(np.int64) + e
    return np.clip(both, lf.count_min, lf.count_max).astype(np.int32)


def add_residual(lf: Decoded, hf: Decoded) -> Decoded:
    """Their sum where both are covered (DEC-003)."""
    d, e = lf.numbers(), hf.numbers()
    out = Decoded(lf.track)
    for (i, j), span in intersect(lf.spans, hf.spans):
        out.add(span.start, sum_of(lf.track, d[i : i + span.ticks], e[j : j + span.ticks]))
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
    counts, exact = decoded.track.number_format == "counts", decoded.exact()
    a, b, d = component.calibration
    deviation = Deviation(*component.deviation) if component.deviation else None
    return Channel(
        stored=np.ascontiguousarray(decoded.numbers()[:, index]),
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
        exact=None if exact is None else np.ascontiguousarray(exact[:, index]),
    )
