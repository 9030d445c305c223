"""What other clocks said: stored as it was observed, with the cluster that comes next."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from dataclasses import replace
from fractions import Fraction

from ..reading.clocks import fit_clock
from ..format.clocks import ClockMap, ClockObservation, build_clocks
from .filewriter import FileWriter
from ..format.track import Track
from ..errors import ParameterError

NANOSECONDS = Fraction(10**9)
"""Ticks per second where an observation speaks of no track."""


class Observed:
    """Observations on their way. Their ``track`` is a channel number until they are written: a
    channel may have no track yet."""

    def __init__(self, *, maps: bool, before: Iterable[ClockObservation] = ()) -> None:
        self.maps = maps
        """Whether maps are fitted at the end."""
        self.waiting: list[ClockObservation] = []
        self.kept: dict[tuple[str, int | None], array[int]] = {}
        """Tick, time and uncertainty of each, by clock and track: 24 bytes."""
        self.keep(before)

    def add(self, seen: ClockObservation) -> None:
        self.waiting.append(seen)

    def keep(self, found: Iterable[ClockObservation]) -> None:
        for seen in found:
            place = self.kept.setdefault((seen.clock, seen.track), array("q"))
            place.extend((seen.tick, seen.time_ns, seen.uncertainty_ns))

    def write(self, writer: FileWriter, tracks: Mapping[int, int]) -> None:
        """``tracks``: the first track of each channel that has one."""
        if not self.waiting:
            return
        ready = []
        for seen in self.waiting:
            if seen.track is None:
                ready.append(seen)
            elif seen.track in tracks:
                ready.append(replace(seen, track=tracks[seen.track]))
        self.waiting = [s for s in self.waiting if s.track is not None and s.track not in tracks]
        ready.sort(key=lambda seen: (seen.clock, -1 if seen.track is None else seen.track))
        writer.clock(ready)
        self.keep(ready)

    def fitted(self, tracks: Mapping[int, Track]) -> tuple[list[ClockMap], list[str]]:
        """A map for each clock and track where maps are asked for, and a note where there is
        none."""
        if not self.maps:
            return [], []
        maps: list[ClockMap] = []
        notes = []
        for (clock, track), flat in self.kept.items():
            rows = zip(flat[::3], flat[1::3], flat[2::3], strict=True)
            rate = NANOSECONDS if track is None else tracks[track].rate
            try:
                maps.append(fit_clock([ClockObservation(clock, track, *r) for r in rows], rate))
            except ParameterError as error:
                notes.append(f"no map of clock {clock!r}: {error.message}")
        return maps, notes


def observation(
    clock: str, number: int | None, tick: int, time_ns: int, uncertainty_ns: int
) -> ClockObservation:
    """Checked; ParameterError where it cannot be written."""
    numbers = (tick, time_ns, uncertainty_ns)
    if not isinstance(clock, str) or not all(isinstance(n, int) for n in numbers):
        raise ParameterError("a clock observation needs a name, an integer tick and integer times")
    found = ClockObservation(clock, number, tick, time_ns, uncertainty_ns)
    list(build_clocks([found]))
    return found
