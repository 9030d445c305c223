"""One channel for one actuator: decoded packets -> values at the samples of the device."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...reading.pieces import Piece
from ...reading.reconstruct import sum_of
from ...recording import Calibration, Span, spans_of
from .grid import Places
from .kernels import Kernel, Values
from .stream import Queue

Band = Literal["full", "lf", "hf"]


class Run(NamedTuple):
    """Values of ticks from ``start`` on, without a gap."""

    start: int
    values: Values

    @property
    def stop(self) -> int:
        return self.start + len(self.values)

    def around(self, first: int, stop: int) -> Values:
        """Ticks [first, stop). Beyond its ends a run goes on as its own mirror image, the last
        tick twice: nothing comes in from the other side of a gap."""
        if self.start <= first and stop <= self.stop:
            return self.values[first - self.start : stop - self.start]
        count = len(self.values)
        places = np.arange(first - self.start, stop - self.start) % (2 * count)
        return self.values[np.where(places < count, places, 2 * count - 1 - places)]


@dataclass(frozen=True)
class Meaning:
    """Counts or words -> values in the actuator's unit: component ``index`` of its tracks."""

    index: int
    calibration: Calibration
    factor: float
    offset: float

    def values(
        self, numbers: NDArray[np.generic], exact: Values | None, number_format: str
    ) -> Values:
        """Values that are too large for a double become infinite, and with them unknown."""
        with np.errstate(over="ignore", invalid="ignore"):
            if exact is not None:
                out = exact
            elif number_format == "counts":
                out = self.calibration.physical(numbers)
            else:
                out = numbers.astype(np.float64)
            out = out * self.factor if self.factor != 1 else out
            return out + self.offset if self.offset else out


class Feed:
    """``base``: LF or full band, ``residual``: HF; each where the band needs it."""

    def __init__(
        self,
        base: Queue | None,
        residual: Queue | None,
        band: Band,
        meaning: Meaning,
        kernel: Kernel,
    ) -> None:
        self.base = base
        self.residual = residual
        self.band = band
        self.meaning = meaning
        self.kernel = kernel
        self.runs: list[Run] = []

    @property
    def queues(self) -> list[Queue]:
        return [queue for queue in (self.base, self.residual) if queue is not None]

    def take(self, tick: int) -> None:
        """Turn what came into runs; nothing before this tick is still to come."""
        if self.band == "full" and self.base is not None:
            for start, numbers, piece in self.sums(self.base, self.residual, tick):
                self.add(start, numbers, piece)
            return
        for queue in self.queues:
            while queue.pieces:
                piece = queue.pop()
                self.add(piece.start, piece.numbers[:, self.meaning.index], piece)

    def sums(
        self, base: Queue, residual: Queue | None, tick: int
    ) -> Iterator[tuple[int, NDArray[np.generic], Piece]]:
        """Full band: a track of its own, or d + e^ where both are there (DEC-001, DEC-003)."""
        index = self.meaning.index
        while base.pieces:
            d = base.pieces[0]
            if d.track.kind != "lf":
                yield d.start, d.numbers[:, index], base.pop()
                continue
            d_stop = d.start + len(d.numbers)
            if residual is None or not residual.pieces:
                if residual is not None and d_stop > tick:
                    return
                base.pop()
                continue
            e = residual.pieces[0]
            e_stop = e.start + len(e.numbers)
            start, stop = max(d.start, e.start), min(d_stop, e_stop)
            if start < stop and e.track.base == d.track.id:
                slow = d.numbers[start - d.start : stop - d.start, index]
                rest = e.numbers[start - e.start : stop - e.start, index]
                yield start, sum_of(d.track, slow, rest), d
            # What ends first has no part in what follows.
            if d_stop <= stop or (stop <= start and d_stop <= e_stop):
                base.pop()
            if e_stop <= stop or (stop <= start and e_stop <= d_stop):
                residual.pop()

    def add(self, start: int, numbers: NDArray[np.generic], piece: Piece) -> None:
        exact = None if piece.exact is None else piece.exact[:, self.meaning.index]
        values = self.meaning.values(numbers, exact, piece.track.number_format)
        if self.runs and self.runs[-1].stop == start:
            last = self.runs.pop()
            start, values = last.start, np.concatenate([last.values, values])
        self.runs.append(Run(start, values))

    def drop(self, tick: int) -> None:
        """What lies before this tick is not asked for any more."""
        kept = 0
        while kept < len(self.runs) and self.runs[kept].stop <= tick:
            kept += 1
        del self.runs[:kept]
        if self.runs and self.runs[0].start < tick:
            first = self.runs[0]
            self.runs[0] = Run(tick, first.values[tick - first.start :])
        for queue in self.queues:
            while queue.pieces and queue.pieces[0].start + len(queue.pieces[0].numbers) <= tick:
                queue.pop()

    def render(self, places: Places, rest: float) -> tuple[Values, NDArray[np.bool_]]:
        """Values and whether they are known; a tick covers the time up to the next one."""
        ticks, phases = places
        values = np.full(len(ticks), rest)
        known = np.zeros(len(ticks), np.bool_)
        half = self.kernel.half
        for run in self.finite(int(ticks[0]) - half + 1, int(ticks[-1]) + half + 1):
            a, b = np.searchsorted(ticks, (run.start, run.stop)).tolist()
            if a < b:
                first = int(ticks[a]) - half + 1
                around = run.around(first, int(ticks[b - 1]) + half + 1)
                values[a:b] = self.kernel.apply(around, first, ticks[a:b], phases[a:b])
                known[a:b] = True
        return values, known

    def finite(self, first: int, stop: int) -> Iterator[Run]:
        """Runs of finite values within [first, stop): a value that is not is no value."""
        for run in self.runs:
            if run.start >= stop:
                return
            a, b = max(first, run.start), min(stop, run.stop)
            if a < b:
                part = run.values[a - run.start : b - run.start]
                finite = np.isfinite(part)
                for span in [Span(a, b)] if finite.all() else spans_of(finite, a):
                    yield Run(span.start, part[span.start - a : span.stop - a])
