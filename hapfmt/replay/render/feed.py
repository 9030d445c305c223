"""File -> values of one channel at the samples of the device.

Packets are read ahead, in the memory of one cluster. Tracks share one pass over the file while they
advance together. A track gets its own pass if it has no packets for long while packets of the
others accumulate. Examples are a track with one tick an hour, and a file that stores one track
after the other.

Device samples are mapped to places on a channel's grid of ticks in exact rational arithmetic.
Resampling kernels give the value of a channel between its ticks (docs/spec/players.md).

``ratio`` is the rate of the channel times the speed, divided by the rate of the device. p = max(1,
ratio) is the width of a kernel in ticks: it removes frequencies that the device would alias. x is
the distance of a tick from the requested place, in ticks.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import accumulate
from math import ceil, lcm, nextafter
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...format.track import Track
from ...reading.catalogue import Catalogue, ChunkRef
from ...reading.damage import LostSpan
from ...reading.decoder import DecodedPiece, sum_of
from ...reading.packets import overlapping
from ...reading.reader import Reader
from ...recording import Calibration, Span, spans_of

AHEAD = 1 << 19
"""Samples that tracks may hold at the end of a cluster, while one of them still has nothing."""
NS = 10**9
NEVER = 1 << 80
"""Nanoseconds; means that no packet follows."""


class NewCatalogueError(Exception):
    """The index proved false: the file was walked through, and may hold other tracks."""


@dataclass(eq=False)
class PacketQueue:
    """Decoded packets of tracks that continue one another, in order of time: ticks [start, end)."""

    tracks: dict[int, Track]
    rate: Fraction
    end: int
    stop: int
    """Ticks before it came, or never come."""
    pieces: deque[DecodedPiece] = field(default_factory=deque)
    held: int = 0
    """Ticks of the pieces."""

    def put(self, piece: DecodedPiece) -> None:
        late = self.stop - piece.start
        if late >= len(piece.numbers):
            return
        if late > 0:
            exact = None if piece.exact is None else piece.exact[late:]
            piece = piece._replace(start=self.stop, numbers=piece.numbers[late:], exact=exact)
        self.pieces.append(piece)
        self.held += len(piece.numbers)
        self.stop = piece.start + len(piece.numbers)

    def pop(self) -> DecodedPiece:
        piece = self.pieces.popleft()
        self.held -= len(piece.numbers)
        return piece


class DecodingPass:
    """One pass over the file for some queues, from what they have to the end of their range."""

    def __init__(self, reader: Reader, queues: Sequence[PacketQueue]) -> None:
        self.queues = list(queues)
        # A reader of its own: which spans are lost is known by pass. In one thread, the pass is
        # where its pieces are.
        self.reader = copy(reader)
        self.reader.threads = 1
        self.reader.lost = []
        self.catalogue: Catalogue = self.reader.catalogue
        self.clusters = 0
        """Passed so far."""
        self.frontier_ns = 0
        """Packets that are still to come start then or later."""
        self.pieces: Iterator[DecodedPiece] | None = None
        self.ended = False

    def complete(self, queue: PacketQueue, tick: int) -> bool:
        """True if the queue holds everything that the file has before this tick."""
        if self.ended or queue.stop >= min(tick, queue.end):
            return True
        rate = queue.rate
        return self.frontier_ns * rate.numerator >= tick * rate.denominator * NS

    def pull(self) -> None:
        """The next packet goes to its queues."""
        if self.pieces is None:
            self.pieces = self.open()
        try:
            piece = next(self.pieces, None)
        except FormatError:
            if self.reader.catalogue is self.catalogue:
                raise
            raise NewCatalogueError from None
        if self.reader.catalogue is not self.catalogue:
            raise NewCatalogueError
        if piece is None:
            self.ended = True
            return
        for queue in self.queues:
            if piece.track.id in queue.tracks:
                queue.put(piece)

    def open(self) -> Iterator[DecodedPiece]:
        live = [queue for queue in self.queues if queue.stop < queue.end and queue.tracks]
        tracks = {id_: track for queue in live for id_, track in queue.tracks.items()}
        if not tracks:
            return iter(())
        start = min(queue.stop / queue.rate for queue in live)
        stop = max(queue.end / queue.rate for queue in live)
        starts = starts_of(overlapping(self.catalogue.data, start, stop))
        self.frontier_ns = starts[0]

        def passed(done: int, count: int) -> None:
            self.clusters += 1
            self.frontier_ns = starts[done] if count == len(starts) - 1 else 0

        return self.reader.pieces(list(tracks.values()), start, stop, exact=True, progress=passed)

    def close(self) -> None:
        if self.pieces is not None:
            self.pieces.close()  # type: ignore[attr-defined]
        self.pieces = None


def starts_of(refs: Sequence[ChunkRef]) -> list[int]:
    """The earliest packet, in nanoseconds, of each cluster and all after it, NEVER behind the last.

    Where damage hides the times of one, they are taken to be in order.
    """
    known = accumulate(
        (ref.start_ns for ref in refs), lambda a, b: a if b is None else b, initial=0
    )
    times = [0 if time is None else time for time in list(known)[1:]]
    return list(accumulate([NEVER, *reversed(times)], min))[::-1]


class PacketSource:
    """All passes that feed the given queues; each group starts with one pass.

    If the index proves false, ``rebind`` gets the corrected catalogue and reassigns the tracks of
    the queues.
    """

    def __init__(
        self,
        reader: Reader,
        groups: Sequence[Sequence[PacketQueue]],
        rebind: Callable[[Catalogue], None],
    ) -> None:
        self.reader = reader
        self.rebind = rebind
        self.streams: dict[PacketQueue, DecodingPass] = {}
        self.lists: list[list[LostSpan]] = []
        for queues in groups:
            self.start(queues)

    def start(self, queues: Sequence[PacketQueue]) -> None:
        if queues:
            self.streams |= dict.fromkeys(queues, DecodingPass(self.reader, queues))

    def fill(self, queue: PacketQueue, tick: int) -> None:
        """All of the queue that the file has before this tick."""
        before = self.streams[queue].clusters
        while not (stream := self.streams[queue]).complete(queue, tick):
            others = [other for other in stream.queues if other is not queue]
            if stream.clusters > before and sum(other.held for other in others) > AHEAD:
                stream.close()
                self.start(others)
                self.start([queue])
                before = 0
                continue
            try:
                stream.pull()
            except NewCatalogueError:
                self.renew(stream.reader.catalogue)
                before = 0
            self.keep_lost(stream)

    def keep_lost(self, stream: DecodingPass) -> None:
        """Each pass over packets has a list of its own."""
        if all(stream.reader.lost is not known for known in self.lists):
            self.lists.append(stream.reader.lost)

    def renew(self, catalogue: Catalogue) -> None:
        """The same queues from what they have on, from the file as it turned out to be."""
        self.reader.catalogue = catalogue
        self.rebind(catalogue)
        for stream in dict.fromkeys(self.streams.values()):
            stream.close()
            self.start(stream.queues)

    @property
    def lost(self) -> list[LostSpan]:
        return list(dict.fromkeys(span for spans in self.lists for span in spans))

    @property
    def groups(self) -> list[list[PacketQueue]]:
        """Queues that share a pass."""
        return [stream.queues for stream in dict.fromkeys(self.streams.values())]

    def close(self) -> None:
        for stream in dict.fromkeys(self.streams.values()):
            stream.close()


WIDE = 1 << 62
"""Sums below are taken in 64 bits."""
NOWHERE = 1 << 60
"""A tick that nothing covers: ticks end at 2^48."""
BELOW_ONE = nextafter(1.0, 0.0)


class Places(NamedTuple):
    """Sample i lies ``phases[i]`` (0 <= phase < 1) of a tick behind tick ``ticks[i]``."""

    ticks: NDArray[np.int64]
    phases: NDArray[np.float64]


class DeviceGrid:
    """Device sample n lies at ``start + n * step`` seconds, which is that times ``rate`` in ticks.

    Each sample is computed from its number, by integers, so that nothing adds up: ten hours in,
    the tick is the right one and the phase is rounded once.
    """

    def __init__(self, start: Fraction, step: Fraction, rate: Fraction) -> None:
        first, stride = start * rate, step * rate
        self.unit = lcm(first.denominator, stride.denominator)
        self.first = int(first * self.unit)
        self.stride = int(stride * self.unit)

    def tick(self, number: int) -> int:
        """The last tick that is not behind this sample."""
        return (self.first + number * self.stride) // self.unit

    def places(self, number: int, count: int) -> Places:
        """The places of ``count`` samples from sample ``number`` on."""
        tick, rest = divmod(self.first + number * self.stride, self.unit)
        if max(rest + count * self.stride, self.unit) < WIDE and tick < NOWHERE // 2:
            parts = rest + np.arange(count, dtype=np.int64) * self.stride
            ticks, rests = np.divmod(parts, self.unit)
            if self.unit <= 1 << 53:
                return Places(tick + ticks, rests / float(self.unit))
            return Places(tick + ticks, self.divided(rests.tolist()))
        pairs = [divmod(rest + i * self.stride, self.unit) for i in range(count)]
        far = [min(tick + ticks, NOWHERE) for ticks, _ in pairs]
        return Places(np.array(far, np.int64), self.divided([rest for _, rest in pairs]))

    def divided(self, rests: list[int]) -> NDArray[np.float64]:
        return np.array([min(rest / self.unit, BELOW_ONE) for rest in rests], np.float64)


def samples_in(seconds: Fraction, step: Fraction) -> int:
    """Device samples n with ``0 <= n * step < seconds``."""
    return max(ceil(seconds / step), 0)


Shape = Literal["linear", "band-limited", "bounded"]

LOBES = 16
"""Zeros of the sinc on each side."""
BETA = 8.0
"""Shape parameter of the Kaiser window."""
AT_ONCE = 1 << 15
"""Products that are held at a time: as a cache of the processor does."""
LARGE = 2.0**8
"""Sums of the largest doubles may not be finite on the way to a result that is; of these they
are."""
TABLES = 32
"""Tables of weights that a kernel keeps: places come again and again."""

Values = NDArray[np.float64]


@dataclass(eq=False)
class Kernel:
    """Weights of ``2 * half`` ticks: of tick k, the last that is not behind the place, with the
    ``half - 1`` before it and the ``half`` after it."""

    shape: Shape
    ratio: Fraction
    half: int
    tables: OrderedDict[bytes, Values] = field(default_factory=OrderedDict, repr=False)

    @property
    def width(self) -> Fraction:
        return max(self.ratio, Fraction(1))

    @property
    def name(self) -> str:
        """As reports call it: with its width in ticks, where that is not 1."""
        return self.shape if self.ratio <= 1 else f"{self.shape} ({float(self.ratio):.6g} ticks)"

    def weights(self, phases: Values) -> Values:
        """[places, 2 * half]; each row adds up to 1."""
        x = np.arange(1 - self.half, self.half + 1) - phases[:, None]
        if self.shape == "linear":
            return np.asarray(np.maximum(self.half - np.abs(x), 0.0) / self.half**2)
        u = x / float(self.width)
        inside = np.maximum(1.0 - (u / LOBES) ** 2, 0.0)
        w = np.sinc(u) * np.where(inside > 0, np.i0(BETA * np.sqrt(inside)), 0.0)
        return np.asarray(w / w.sum(axis=1, keepdims=True))

    def table(self, phases: Values) -> tuple[Values, NDArray[np.intp]]:
        """Weights of the different phases, and which of them each place has."""
        distinct, which = np.unique(phases, return_inverse=True)
        key = distinct.tobytes()
        found = self.tables.get(key)
        if found is None:
            found = self.tables[key] = self.weights(distinct)
            if len(self.tables) > TABLES:
                self.tables.popitem(last=False)
        else:
            self.tables.move_to_end(key)
        return found, which

    def apply(self, around: Values, first: int, ticks: NDArray[np.int64], phases: Values) -> Values:
        """Values at places [m]; ``around``: of all ticks from ``first`` on that they need."""
        if self.width == 1 and not phases.any():
            # On a tick the value is that of the tick, bit for bit.
            return around[ticks - first]
        out = np.empty(len(ticks))
        starts = ticks - first - (self.half - 1)
        windows = np.lib.stride_tricks.sliding_window_view(around, 2 * self.half)
        for rows in parts(len(ticks), max(AT_ONCE // (2 * self.half), 1)):
            out[rows] = self.blend(windows[starts[rows]], phases[rows])
        if self.width == 1:
            on = phases == 0
            out[on] = around[(ticks - first)[on]]
        return out

    def blend(self, near: Values, phases: Values) -> Values:
        """near [places, 2 * half]"""
        table, which = self.table(phases)
        weights = table[which] if len(table) > 1 else table
        with np.errstate(over="ignore", invalid="ignore"):
            out = (weights * near).sum(axis=1)
            large = ~np.isfinite(out)
            if large.any():
                some = weights[large] if len(weights) > 1 else weights
                out[large] = (some * (near[large] / LARGE)).sum(axis=1) * LARGE
        if self.shape == "band-limited":
            largest = np.finfo(np.float64).max
            return np.asarray(np.clip(out, -largest, largest))
        low, high = self.bounds(near, phases)
        return np.asarray(np.clip(out, low, high))

    def bounds(self, near: Values, phases: Values) -> tuple[Values, Values]:
        """The lowest and the highest of the ticks less than a width away."""
        reach = min(ceil(self.width), self.half)
        columns = slice(self.half - reach, self.half + reach)
        x = np.arange(1 - reach, reach + 1) - phases[:, None]
        close = np.abs(x) < float(self.half if self.shape == "linear" else self.width)
        values = near[:, columns]
        low = np.where(close, values, np.inf).min(axis=1)
        high = np.where(close, values, -np.inf).max(axis=1)
        return low, high


def parts(count: int, size: int) -> Iterator[slice]:
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


def kernel(shape: Shape, ratio: Fraction) -> Kernel:
    width = max(ratio, Fraction(1))
    lobes = 1 if shape == "linear" else LOBES
    return Kernel(shape, ratio, ceil(lobes * width))


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


class ChannelResampler:
    """``base``: LF or full band, ``residual``: HF; each where the band needs it."""

    def __init__(
        self,
        base: PacketQueue | None,
        residual: PacketQueue | None,
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
    def queues(self) -> list[PacketQueue]:
        return [queue for queue in (self.base, self.residual) if queue is not None]

    def take(self, tick: int) -> None:
        """Turns received packets into runs. No packet before this tick will follow."""
        if self.band == "full" and self.base is not None:
            for start, numbers, piece in self.sums(self.base, self.residual, tick):
                self.add(start, numbers, piece)
            return
        for queue in self.queues:
            while queue.pieces:
                piece = queue.pop()
                self.add(piece.start, piece.numbers[:, self.meaning.index], piece)

    def sums(
        self, base: PacketQueue, residual: PacketQueue | None, tick: int
    ) -> Iterator[tuple[int, NDArray[np.generic], DecodedPiece]]:
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

    def add(self, start: int, numbers: NDArray[np.generic], piece: DecodedPiece) -> None:
        exact = None if piece.exact is None else piece.exact[:, self.meaning.index]
        values = self.meaning.values(numbers, exact, piece.track.number_format)
        if self.runs and self.runs[-1].stop == start:
            last = self.runs.pop()
            start, values = last.start, np.concatenate([last.values, values])
        self.runs.append(Run(start, values))

    def drop(self, tick: int) -> None:
        """Drops values before this tick; they are no longer needed."""
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
        """Runs of finite values within [first, stop); other values count as missing."""
        for run in self.runs:
            if run.start >= stop:
                return
            a, b = max(first, run.start), min(stop, run.stop)
            if a < b:
                part = run.values[a - run.start : b - run.start]
                finite = np.isfinite(part)
                for span in [Span(a, b)] if finite.all() else spans_of(finite, a):
                    yield Run(span.start, part[span.start - a : span.stop - a])
