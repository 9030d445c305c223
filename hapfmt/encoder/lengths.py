"""How long packets and clusters are, decided before anything is coded.

Long packets are small, short ones lose little where a byte changes. A few samples of each channel
tell about how many bytes it takes. From these the loss that one changed byte causes on average
follows, for any number of packets. Each channel gets as many as lose least at the same size: the
root of its bytes times its samples, by what a packet costs there. In a small file packets may cost
a share of the size, and the loss follows from that.

Packets begin where clusters do, or divide them. So a file that was cut keeps some seconds of all
channels, and not some channels.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import ceil, floor, log, sqrt

import numpy as np
from numpy.typing import NDArray

from ..kernels import compiled
from ..recording import Channel, Recording
from .bounded import error_of
from .gridded import Gridded
from .lattice import Lattice, LatticeSearch, sparse
from .predict import log_2
from .settings import Settings, fastest_of

SHARES, TRIED, GUESSED = 35, (38, 42, 46, 50, 54, 58), 50
"""One changed byte should take at most one of SHARES of the samples, as the mean of all bytes.
Numbers of packets are rounded, so several numbers of shares are TRIED; from GUESSED on where some
channels may turn out to follow from others."""

LARGE, PRICE, LARGE_PRICE = 95_000, 0.006, 0.025
"""Bytes of a large file, by an estimate; and the share of the size that short packets may cost, in
small files and in large ones."""

PACKET = 40
"""Bytes that a packet costs: its row, its predictor, its first states."""

DISTINCT = 1.25
"""Bytes for each double that shares its count with others: each packet repeats its correction."""

WORST, SEEN = 10.5, 0.005
"""A packet has at most this share of all samples, where its track has SEEN of the bytes; and a
chunk of a large file."""

SHORTEST = 128
"""Ticks of a packet."""

CLUSTERS, ENOUGH = (12, 6, 4, 3, 2), 6
"""Clusters of a short recording: as many as a third of SHARES allows. A recording that has ENOUGH
of the longest keeps these."""

PIECES, PIECE = 16, 256
"""Samples of a channel that are looked at."""

SPREAD = 5.4
"""Errors of a Laplacian distribution take log2(1 + 5.4 times their mean) bits."""

WORD_SHARE = 0.8
"""The share of its bits that a number without a grid takes."""

FELT_SHARE = 1 / 3
"""The share of the bits of a bounded channel that one with a texture or a relative bound takes."""


@dataclass(frozen=True)
class Load:
    """Estimated bytes of a channel, its samples, and the bytes that one packet more costs."""

    size: float = 0.0
    samples: int = 0
    cost: float = PACKET
    guessed: bool = False
    """Whether it is of doubles without a grid."""

    @classmethod
    def of(cls, loads: Iterable[Load]) -> Load:
        """Several channels in one track."""
        every = list(loads)
        return cls(
            sum(each.size for each in every), sum(each.samples for each in every),
            sum(each.cost for each in every),
        )  # fmt: skip

    @property
    def root(self) -> float:
        return sqrt(self.size * self.samples * self.cost)


def load_of(member: Gridded, search: LatticeSearch) -> Load:
    """The estimate for one channel; ``search``: of its values as they were recorded."""
    channel, promise = member.channel, member.promise
    size = channel.stored.size
    if not size:
        return Load()
    looked, cost = pieces_of(channel.stored).astype(np.float64), float(PACKET)
    step = natural_step(member, search)
    if step is not None:
        near = np.rint(looked / step)
        shared = np.unique(looked).size - np.unique(near).size
        bits = bits_of(near)
        cost += DISTINCT * max(shared, 0)
    elif channel.calibration is None:
        bits = WORD_SHARE * 8 * channel.stored.itemsize
    else:
        room = error_of(channel, promise)
        if promise.k:
            away = np.abs(looked - channel.calibration.zero)
            room = max(room, int(promise.k * Fraction(float(np.median(away)))))
        bits = bits_of(np.rint(looked / (2 * room + 1)) if room else looked)
        if promise.k or promise.texture is not None:
            bits *= FELT_SHARE
    guessed = step is None and channel.calibration is None
    return Load(bits * size / 8, size, cost, guessed)


def natural_step(member: Gridded, search: LatticeSearch) -> float | None:
    """The step of doubles that are near to a grid, in the unit of the channel or in its counts."""
    calibration = member.channel.calibration
    if not member.promise.lossless or search.given.dtype != np.float64 or search.refusal:
        return None
    if calibration is None:
        if isinstance(search.exact, Lattice):  # Only -0.0 is off the grid.
            return float(abs(search.exact.calibration.step))
        steps = search.steps(None)
        return steps.low if steps else None
    counts = member.channel.stored
    if member.channel.deviation is not None or not sparse(pieces_of(counts)):
        return None
    steps = search.steps(Lattice(calibration, counts, True, 0.0, ""))
    return steps.low / float(abs(calibration.step)) if steps else None


def pieces_of(x: NDArray[np.generic]) -> NDArray[np.generic]:
    """[pieces, samples]: spread over the channel, or all of it."""
    if x.size <= PIECES * PIECE:
        return x[None]
    starts = (x.size - PIECE) * np.arange(PIECES) // (PIECES - 1)
    return np.asarray(x[starts[:, None] + np.arange(PIECE)])


def bits_of(looked: NDArray[np.float64]) -> float:
    """Bits a sample, each piece of whole numbers by the best of the first three differences."""
    pieces, size = len(looked), looked[0].size
    if compiled is not None:
        bits: float = compiled.piece_bits(np.ascontiguousarray(looked), pieces)
        return bits / pieces
    total: float = 0.0
    for x in looked:
        row, found = x - np.floor(np.cumsum(x)[-1] / size), []
        for _ in range(min(size, 3)):
            found.append(log_2(1 + SPREAD * (float(np.cumsum(np.abs(row))[-1]) / row.size)))
            row = np.diff(row)
        total += float(min(found))
    return total / pieces


@dataclass(frozen=True)
class PacketLengths:
    """Seconds of a cluster, and of the packets of each track."""

    cluster: Fraction
    longest: Fraction
    """Seconds of the longest packet."""

    whole: Load = Load()
    root: float = 0.0
    """The sum over all tracks."""

    shares: float = 0.0
    """The samples over those that one changed byte takes. 0: packets are as long as a cluster."""

    @classmethod
    def of(cls, recording: Recording, settings: Settings, loads: Sequence[Load]) -> PacketLengths:
        longest = settings.cluster_of(recording)
        whole, root = Load.of(loads), sum(load.root for load in loads)
        if settings.cluster is not None or settings.preset == "paper" or not root:
            return cls(longest, longest)
        price = LARGE_PRICE if whole.size >= LARGE else PRICE
        most = price * whole.size**2 * whole.samples / root**2
        guessed = settings.references and sum(load.guessed for load in loads) > 1
        tried = sorted({min(most, n) for n in TRIED if n >= GUESSED or not guessed})
        some = [channel for channel in recording.channels if channel.coverage]
        fastest = fastest_of(recording)
        ends: dict[tuple[int, int], tuple[int, int]] = {}
        for channel in some:
            rate, (first, *_), last = channel.rate_exact, channel.coverage, channel.coverage[-1]
            low, high = ends.get(key := rate.as_integer_ratio(), (first.start, last.stop))
            ends[key] = min(low, first.start), max(high, last.stop)
        begin = min(Fraction(low * d, n) for (n, d), (low, _) in ends.items())
        end = max(Fraction(high * d, n) for (n, d), (_, high) in ends.items())
        count = next((n for n in CLUSTERS if 3 * n <= tried[0]), 1)
        cluster = longest
        if count > 1 and end - begin < ENOUGH * longest:
            ticks = ceil((end - begin) * fastest / count)
            cluster = min(longest, Fraction(max(ticks, SHORTEST)) / fastest)
        for shares in tried:
            found = cls(cluster, longest, whole, root, shares)
            if shares == tried[-1] or found.loss(recording.channels, loads) * SHARES <= 1:
                break
        return found

    @property
    def cluster_samples(self) -> int | None:
        """Most samples of a chunk of a large file: all are lost where its header is damaged."""
        return int(self.whole.samples / WORST) if self.shares >= SHARES else None

    def loss(self, channels: Sequence[Channel], loads: Sequence[Load]) -> float:
        """The mean share of all samples that one changed byte takes."""
        lost = 0.0
        for channel, load in zip(channels, loads, strict=True):
            ticks = float(self.seconds([channel], [load]) * channel.rate_exact)
            lost += load.size * min(ticks, load.samples)
        return lost / (self.whole.size * self.whole.samples)

    def changed(self, before: Sequence[Load], after: Sequence[Load]) -> PacketLengths:
        """The same, where some tracks take the place of others with the same samples."""
        size, root = self.whole.size, self.root
        for sign, tracks in ((-1, before), (1, after)):
            size += sign * sum(load.size for load in tracks)
            root += sign * sum(load.root for load in tracks)
        return replace(self, whole=replace(self.whole, size=size), root=root)

    @cached_property
    def together(self) -> list[Fraction]:
        """How many clusters a packet may be as long as."""
        return [Fraction(n) for n in (1, *CLUSTERS) if n * self.cluster <= self.longest]

    def seconds(self, channels: Sequence[Channel], loads: Sequence[Load]) -> Fraction:
        """How long the packets of a track with these channels are."""
        load, rate = Load.of(loads), channels[0].rate_exact
        if not self.shares or not load.samples:
            return self.cluster
        ticks = load.samples // len(loads)
        least = 0.0
        if load.size > SEEN * self.whole.size:
            least = WORST * min(self.shares / SHARES, 1) * load.samples / self.whole.samples
        density = self.shares * self.root / (self.whole.size * self.whole.samples)
        parts = max(density * load.root / load.cost, least, 1.0)
        most = max(ticks / SHORTEST, 1.0)
        n, d = rate.as_integer_ratio()
        cn, cd = self.cluster.as_integer_ratio()
        clusters = ticks * d * cd / (n * cn)
        if ticks * d * cd <= n * cn:
            pieces = round(min(parts, most))
            return Fraction(ticks * d, n * pieces) if pieces > 1 else self.cluster
        ways = [*self.together]
        most_near = min(max(parts, least), most) / clusters
        ways += [Fraction(1, n) for n in {floor(most_near), ceil(most_near)} if n > 1]
        # Where two ways are as near, the longer packets win.
        found = [
            (abs(log(max(count, 1.0) / parts)), count, way)
            for way in ways
            if least <= (count := clusters / float(way)) <= most
        ]
        return self.cluster * (min(found)[2] if found else 1)
