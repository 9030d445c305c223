"""What damage took of each track, as far as packets around it and the index tell (SPEC 14.2)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

from ..format.track import Track
from .timeline import Times


class LostSpan(NamedTuple):
    """Ticks of a track that damage took: start <= t < stop; stop None: their number is not
    known.
    ``offset``: where the damage is, None where that is not known."""

    track: int
    start: int
    stop: int | None
    offset: int | None = None


@dataclass
class Hole:
    """Ticks that may be lost of one track; the next packet of it tells more."""

    start: int
    stop: int | None
    offset: int


class Losses:
    """Grows while packets go by in order; ``spans`` are the result."""

    def __init__(self, tracks: Mapping[int, Track]) -> None:
        self.tracks = tracks
        self.spans: list[LostSpan] = []
        self.open: dict[int, Hole] = {}

    def suspect(self, tracks: Iterable[int], times: Times, offset: int) -> None:
        """Packets of these tracks within these times may be lost."""
        if times.stop == 0:
            return
        for id_ in tracks:
            start, stop = ticks(times, self.tracks[id_].rate)
            self.widen(id_, start, stop, offset)

    def widen(self, track: int, start: int, stop: int | None, offset: int) -> None:
        """These ticks of the track may be lost, but for those that other packets have."""
        hole = self.open.setdefault(track, Hole(start, stop, offset))
        hole.start = min(hole.start, start)
        hole.stop = None if None in (hole.stop, stop) else max(hole.stop or 0, stop or 0)

    def settle(self, track: int, last: int, start: int) -> None:
        """The track's next packet starts at ``start``, the one before ended at ``last``."""
        hole = self.open.pop(track, None)
        if hole is not None:
            low = max(last, hole.start)
            high = start if hole.stop is None else min(start, hole.stop)
            if low < high:
                self.spans.append(LostSpan(track, low, high, hole.offset))

    def end(self, track: int, last: int) -> None:
        """No packet of the track follows."""
        hole = self.open.pop(track, None)
        if hole is not None:
            low = max(last, hole.start)
            if hole.stop is None or low < hole.stop:
                self.spans.append(LostSpan(track, low, hole.stop, hole.offset))

    def lose(self, track: int, start: int, stop: int, offset: int) -> None:
        """Exactly these ticks; what follows on the last loss of the track is one with it."""
        last = self.spans[-1] if self.spans else None
        if last and (last.track, last.stop) == (track, start) and last.offset == offset:
            self.spans[-1] = last._replace(stop=stop)
        else:
            self.spans.append(LostSpan(track, start, stop, offset))


def ticks(times: Times, rate: Fraction) -> tuple[int, int | None]:
    """First tick, and the one after the last, of a track that lie within some milliseconds."""
    n, d = rate.numerator, rate.denominator * 1000
    return times.start * n // d, None if times.stop is None else -(-times.stop * n // d)
