"""Knots of the slow part: the perceptual deadband, tick by tick, and the packets of knots.

The first sample is a knot. Then each sample that leaves the deadband around the last knot is one
(P. Hinterseer et al., "Perception-based data reduction and transmission of haptic data in
telepresence and teleaction systems", IEEE Transactions on Signal Processing 56, 2008; offline and
joined by lines in Brandi et al., see settings.py). Knots joined by lines leave the deadband in 4-17
% of the samples. Held knots, and knots with reference "sample", leave it in none.

The file also builds the track and its packets of knots: varints, or entropy coded where that is
smaller.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from math import dist
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..codecs.knots import Interpolation, KnotParameters, build_knots, encode_knots
from ..deadband import MARGIN, Deadband, norm_sq
from ..errors import ParameterError
from ..format.cluster import Packet
from ..format.track import Track
from ..kernels import compiled
from ..recording import Span

Reference = Literal["last", "sample"]

_DENSE = 128
"""Counts a knot (ticks times components). Below it a Python loop finds the next knot faster than a
NumPy block (measured: 0.1 us a count in the loop, 12 us for a block)."""

_CHUNK = 4096
"""Samples between two decisions for the loop or for the blocks."""

_BLOCK_LIMIT = 1 << 16
"""Blocks grow to this size where knots are rare, so that little is computed for nothing."""


def select_knots_plain(
    slow: NDArray[Any], deadband: Deadband, *, reference: Reference = "last", keep_last: bool
) -> NDArray[np.int64]:
    """What :func:`select_knots` does, to be read; one tick after the other, in Python integers."""
    kn, kd, floor, zero = deadband.kn, deadband.kd, deadband.floor, deadband.zero
    rows = deadband.columns(slow).tolist()
    ticks = [0] if rows else []
    for i, row in enumerate(rows):
        last = rows[ticks[-1]]
        e = [a - b for a, b in zip(row, last, strict=True)]
        r = [a - z for a, z in zip(last if reference == "last" else row, zero, strict=True)]
        if deadband.vector:
            leaves = deadband.norm_breaks(sum(a * a for a in e), sum(a * a for a in r))
        else:
            leaves = any(
                abs(a) * kd > max(kn * abs(b), c * kd) for a, b, c in zip(e, r, floor, strict=True)
            )
        if leaves:
            ticks.append(i)
    if keep_last and rows and ticks[-1] != len(rows) - 1:
        ticks.append(len(rows) - 1)
    return np.array(ticks, dtype=np.int64)


def select_knots(
    slow: NDArray[Any], deadband: Deadband, *, reference: Reference = "last", keep_last: bool
) -> NDArray[np.int64]:
    """Tick indices of the knots, int64 [knots], increasing, beginning with 0; none without ticks.

    slow
        integer counts, [ticks] or [ticks, components]: the low-passed signal. All components
        share one knot clock: a knot where the norm leaves (vector), or where any component does.
    reference
        what the Weber fraction refers to: "last", the last knot; or "sample", the sample itself,
        and then each sample is within the deadband of the knot before it, by construction.
    keep_last
        the last sample is a knot too, as lines need it.

    Linear in the ticks, whatever the signal.
    """
    if reference not in ("last", "sample"):
        raise ParameterError(f"the reference is 'last' or 'sample', not {reference!r}")
    table = deadband.columns(slow)
    n = table.shape[0]
    if not n:
        return np.zeros(0, dtype=np.int64)
    if compiled is not None:
        found = np.empty(n + 1, np.int64)
        floor = deadband.floor[: 1 if deadband.vector else None]
        count = compiled.select_knots(
            np.ascontiguousarray(table), np.array(deadband.zero, np.int64),
            np.array(floor, np.int64), deadband.kn,
            deadband.kd, deadband.vector, reference == "sample", found[:n],
        )  # fmt: skip
        if keep_last and found[count - 1] != n - 1:
            found[count] = n - 1
            count += 1
        return found[:count].copy()
    search: _Search = (_Ball if deadband.vector else _Box)(table, deadband, reference)
    ticks = [0]
    sparse = max(_DENSE // table.shape[1], 4)
    i, dense = 1, True
    while i < n:
        stop, before = min(i + _CHUNK, n), len(ticks)
        if dense:
            search.walk(ticks, i, stop)
            i = stop
        else:
            block = sparse
            while i < stop and len(ticks) - before <= _CHUNK // sparse:
                end = min(i + block, n)
                at = search.first(ticks[-1], i, end)
                if at < end:
                    ticks.append(at)
                i, block = (at + 1, sparse) if at < end else (end, min(2 * block, _BLOCK_LIMIT))
        dense = len(ticks) - before > _CHUNK // sparse
    if keep_last and ticks[-1] != n - 1:
        ticks.append(n - 1)
    return np.array(ticks, dtype=np.int64)


def knot_values(slow: NDArray[Any], ticks: NDArray[np.int64], step: int) -> NDArray[np.int64]:
    """What is stored at each knot: v = rdiv(slow, step), the decoder's count is v * step.

    slow: integer counts, [ticks] or [ticks, components]; v: int64, [knots] or [knots, components].
    rdiv rounds to the nearest, halves up: a count moves by step / 2 at most.
    """
    if step < 1:
        raise ParameterError("a knot's step is at least 1 count")
    return (2 * slow[ticks].astype(np.int64) + step) // (2 * step)


class _Search(Protocol):
    """Two ways to find the ticks of [start, stop) that leave the deadband around the last knot."""

    def __init__(
        self, table: NDArray[np.int64], deadband: Deadband, reference: Reference
    ) -> None: ...

    def first(self, last: int, start: int, stop: int) -> int:
        """The first one, or stop. The last knot is at tick ``last``."""

    def walk(self, ticks: list[int], start: int, stop: int) -> None:
        """Append each to ``ticks``, whose last one is the last knot, as it is found."""


class _Box:
    """Components with a deadband each: an interval around every count."""

    def __init__(self, table: NDArray[np.int64], deadband: Deadband, reference: Reference) -> None:
        self.table, self.by_sample = table, reference == "sample"
        self.kn, self.kd = deadband.kn, deadband.kd
        self.floor, self.zero = np.array(deadband.floor), np.array(deadband.zero)

    def _bounds(self, start: int, stop: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        rows = self.table[start:stop]
        tolerance = np.maximum(np.abs(rows - self.zero) * self.kn // self.kd, self.floor)
        return rows - tolerance, rows + tolerance

    def first(self, last: int, start: int, stop: int) -> int:
        knot, rows = slice(last, last + 1), slice(start, stop)
        probe, around = (knot, rows) if self.by_sample else (rows, knot)
        low, high = self._bounds(around.start, around.stop)
        counts = self.table[probe]
        outside = np.any((counts < low) | (counts > high), axis=1)
        at = int(outside.argmax())
        return start + at if outside[at] else stop

    def walk(self, ticks: list[int], start: int, stop: int) -> None:
        if self.table.shape[1] == 1:
            self._walk_one(ticks, start, stop)
            return
        bounds = self._bounds(start, stop)
        rows, lows, highs = (part.tolist() for part in (self.table[start:stop], *bounds))
        knot = self.table[ticks[-1]].tolist()
        low, high = (part[0].tolist() for part in self._bounds(ticks[-1], ticks[-1] + 1))
        for tick, row, row_low, row_high in zip(range(start, stop), rows, lows, highs, strict=True):
            probe = (knot, row_low, row_high) if self.by_sample else (row, low, high)
            for count, least, most in zip(*probe, strict=True):
                if not least <= count <= most:
                    ticks.append(tick)
                    knot, low, high = row, row_low, row_high
                    break

    def _walk_one(self, ticks: list[int], start: int, stop: int) -> None:
        """The same for one component, without the inner loop (three times as fast)."""
        bounds = self._bounds(start, stop)
        parts = (part[:, 0].tolist() for part in (self.table[start:stop], *bounds))
        each = zip(range(start, stop), *parts, strict=True)
        last = ticks[-1]
        if self.by_sample:
            knot = int(self.table[last, 0])
            for tick, count, low, high in each:
                if not low <= knot <= high:
                    ticks.append(tick)
                    knot = count
        else:
            low, high = (int(part[0, 0]) for part in self._bounds(last, last + 1))
            for tick, count, next_low, next_high in each:
                if not low <= count <= high:
                    ticks.append(tick)
                    low, high = next_low, next_high


class _Ball:
    """Components that are one vector: distances in float64, and exactly where they are close."""

    def __init__(self, table: NDArray[np.int64], deadband: Deadband, reference: Reference) -> None:
        self.table, self.deadband, self.by_sample = table, deadband, reference == "sample"
        self.zero = np.array(deadband.zero)

    def _allowed_sq(self, start: int, stop: int) -> NDArray[np.float64]:
        return self.deadband.allowed_sq(norm_sq(self.table[start:stop] - self.zero))

    def _leaves(self, tick: int, last: int) -> bool:
        row, knot = self.table[tick].tolist(), self.table[last].tolist()
        reference = row if self.by_sample else knot
        return self.deadband.norm_breaks(
            sum((a - b) ** 2 for a, b in zip(row, knot, strict=True)),
            sum((a - b) ** 2 for a, b in zip(reference, self.deadband.zero, strict=True)),
        )

    def first(self, last: int, start: int, stop: int) -> int:
        error_sq = norm_sq(self.table[start:stop] - self.table[last])
        around = (start, stop) if self.by_sample else (last, last + 1)
        allowed_sq = self._allowed_sq(*around)
        certain = error_sq > allowed_sq * (1 + MARGIN)
        for at in np.flatnonzero(error_sq > allowed_sq * (1 - MARGIN)).tolist():
            if certain[at] or self._leaves(start + at, last):
                return start + int(at)
        return stop

    def walk(self, ticks: list[int], start: int, stop: int) -> None:
        last = ticks[-1]
        rows = self.table[start:stop].astype(np.float64).tolist()
        allowed = np.sqrt(self._allowed_sq(start, stop))
        lows, highs = (allowed * (1 - MARGIN)).tolist(), (allowed * (1 + MARGIN)).tolist()
        knot = self.table[last].astype(np.float64).tolist()
        around = float(np.sqrt(self._allowed_sq(last, last + 1))[0])
        low, high = around * (1 - MARGIN), around * (1 + MARGIN)
        for tick, row, row_low, row_high in zip(range(start, stop), rows, lows, highs, strict=True):
            error = dist(row, knot)
            if self.by_sample:
                low, high = row_low, row_high
            if error > low and (error > high or self._leaves(tick, last)):
                ticks.append(tick)
                last, knot, low, high = tick, row, row_low, row_high


Knots = tuple[Span, NDArray[np.int64], NDArray[np.int64]]
"""Ticks [knots] from the start of a span, and values [knots, components]."""


@dataclass
class Coded:
    """One track, its id still open, and its packets."""

    track: Track
    packets: list[Packet] = field(default_factory=list)
    decoded: NDArray[np.int64] | None = None
    """What the decoder made of all packets, where it was asked for and is not large."""

    @property
    def size(self) -> int:
        return len(self.track.parameters) + sum(len(packet.data) for packet in self.packets)


Packing = Callable[[Track, Interpolation, int, list[Knots]], Coded]
"""(track, interpolation, step, knots of its packets)."""


def plain_knots(
    track: Track, interpolation: Interpolation, step: int, pieces: Iterable[Knots]
) -> Coded:
    """In varints, values in multiples of the step."""
    parameters = KnotParameters(interpolation, LpcParameters(step))
    coded = Coded(replace(track, codec="KNOT", parameters=parameters.build()))
    for span, ticks, values in pieces:
        coded.packets.append(Packet(0, span.start, span.ticks, build_knots(ticks, values)))
    return coded


def coded_knots(track: Track, parameters: KnotParameters, pieces: Iterable[Knots]) -> Coded:
    """With entropy coding, values are indices of the grid."""
    coded = Coded(replace(track, codec="KNOT", parameters=parameters.build()))
    for span, ticks, indices in pieces:
        data = encode_knots(ticks, indices, parameters.interpolation)
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return coded


def smaller_knots(
    track: Track, interpolation: Interpolation, step: int, pieces: list[Knots]
) -> Coded:
    """In varints or with entropy coding; the counts are the same."""
    plain = plain_knots(track, interpolation, step, pieces)
    parameters = KnotParameters(interpolation, LpcParameters(step), coded=True)
    coded = coded_knots(track, parameters, pieces)
    return coded if coded.size < plain.size else plain


def fill_below(
    coded: Coded, packets: Iterable[tuple[Span, bytes]], smallest: int | None
) -> Coded | None:
    """The track with these packets; None, and no more of them are made, once it is not below
    ``smallest``."""
    size = coded.size
    for span, data in packets:
        coded.packets.append(Packet(0, span.start, span.ticks, data))
        size += len(data)
        if smallest is not None and size >= smallest:
            return None
    return coded
