"""References: which channels predict which others, and the tracks of several components that
result.

The search looks in a part of each channel for prediction errors that rise and fall together. Each
packet then has weights of its own.

Least squares give the share of a channel's prediction errors that other channels explain. Each
sample is divided by the prediction errors around it, since the ratio of errors decides the bits
saved. Sums are of integers, exact in any order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import log2

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..codecs.predicted import (
    INDEX_LIMIT,
    REFERENCE_LIMIT,
    REFERENCE_SIZE,
    TAPS,
    Predictor,
    Reference,
    encode_component,
    join_components,
    parse_header,
    prediction_errors,
    taps_of,
)
from ..deadband import Deadband
from ..format.cluster import Packet
from ..limits import ZERO_LIMIT
from ..numbers import clamp, rdiv
from ..recording import Channel, Span
from .bounded import contract_for, error_of
from .gridded import nearest_uniform
from .knots import Coded
from .plan import Promise
from .predict import encode_best, linear_predictor
from .settings import Settings
from .source import InputBlock, declared_range, make_track
from .unit import Unit

Indices = NDArray[np.int64]
Moments = NDArray[np.float64]

SETTLING = 33
"""Samples at the start of a packet or piece, whose prediction errors are not used."""

LIKELY = 0.005
"""Squared correlation of two channels' prediction errors from which on a reference is tried."""

CHANCE = 16
"""The same times the samples: chance alone gives 1."""

NORMAL_BITS, CLIPPED_BITS, BLOCK = 8, 16, 32
"""Prediction errors are brought to a mean of 8 bits in each block, and clipped to 16: products of
32 bits, and no packet has 2**20 of them."""

ENOUGH, PIECE = 4096, 256
"""In packets of more than ENOUGH samples, only every nth piece is used."""

LOUD = 1 << 12
"""Prediction errors are limited to 16 times the mean, so that a tap does not outweigh all the
rest."""

MOST_TOLD = 0.999
"""Largest share of a channel's energy that other channels may explain."""

WORTH = 0.004
"""Bits a sample that a further reference has to save."""


def quick_predictor(indices: Indices) -> Predictor:
    first = int(indices[0])
    if (indices == first).all():
        return Predictor(1, (), first)
    predictor, _ = linear_predictor(indices, 1, first)
    return predictor if predictor.coefficients is not None else Predictor(1, (), first)


def likely_sources(errors: NDArray[np.float64]) -> tuple[list[list[int]], float]:
    """For each channel the earlier ones whose errors correlate with its own at one of the taps. The
    second value is the bits that this saves if no two of them explain the same errors."""
    size = errors.shape[1]
    energies = np.einsum("it,it->i", errors, errors) + 1
    scores = np.zeros((len(errors),) * 2)
    for tap in TAPS:
        now = errors[:, max(0, -tap) : size - max(0, tap)]
        then = errors[:, max(0, tap) : size + min(0, tap)]
        products = np.einsum("it,jt->ij", now, then)
        scores += products * products / np.multiply.outer(energies, energies)
    enough = max(LIKELY, CHANCE / size)
    found, saved = [], 0.0
    for place in range(len(errors)):
        likely = [(-score, a) for a, score in enumerate(scores[place, :place]) if score > enough]
        best = sorted(likely)[:REFERENCE_LIMIT]
        found.append(sorted(a for _, a in best))
        told = min(-sum(score for score, _ in best), MOST_TOLD)
        saved -= size / 2 * log2(1 - told)
    return found, saved


def choose_sources(
    left: Moments, likely: Sequence[int], size: int
) -> tuple[tuple[int, ...], float]:
    """One after the other while it is worth its bits; and the bits that all of them save."""
    before = first = energy_of(left)
    chosen: list[int] = []
    while len(chosen) < len(likely):
        tried = [
            (energy_of(swept), place, swept)
            for place in range(len(likely))
            if place not in chosen
            for swept in [sweep(left, place)]
        ]
        least, place, swept = min(tried, key=lambda each: each[:2])
        if size / 2 * log2(before / least) < max(8 * REFERENCE_SIZE, WORTH * size):
            break
        before, left = least, swept
        chosen.append(place)
    return tuple(likely[place] for place in sorted(chosen)), size / 2 * log2(first / before)


def moments(
    indices: Indices,
    predictor: Predictor,
    earlier: Sequence[Indices],
    sources: Sequence[int],
    settled: NDArray[np.bool_],
) -> Moments:
    """Sums of products of all taps of the sources and, last, the prediction errors."""
    c, difference = predictor.coefficients or [], predictor.difference
    errors = prediction_errors(indices, difference, c, predictor.base)[settled]
    scales = scales_of(errors) - 4
    rows = [tap[settled] for a in sources for tap in taps_of(earlier[a], difference, c)]
    x = scaled(centred(np.stack([*rows, errors])), scales)
    x[-1].clip(-LOUD, LOUD, out=x[-1])
    found: Moments = np.einsum("it,jt->ij", x, x)
    # Roundings of the scaled numbers: without them, taps that are the same have no inverse.
    found[np.diag_indices(len(rows))] += x.shape[1]
    return found


def centred(x: Indices) -> Indices:
    """16 times what is left without the mean: a base takes what is the same everywhere."""
    size = x.shape[1]
    means = [rdiv(16 * total, size) for total in x.sum(axis=1).tolist()]
    return np.asarray(16 * x - np.array(means, np.int64)[:, None])


def scales_of(errors: Indices) -> Indices:
    """By how many bits the numbers of each block are shifted to the left, for each sample."""
    starts = np.arange(0, errors.size, BLOCK)
    sums = np.add.reduceat(np.abs(errors), starts)
    means = sums // np.diff(np.append(starts, errors.size))
    bits = np.frexp(means.astype(np.float64))[1].astype(np.int64)
    return np.repeat(NORMAL_BITS - np.maximum(bits, 1), BLOCK)[: errors.size]


def scaled(x: Indices, scales: Indices) -> NDArray[np.float64]:
    """Clipped as well: integers, as doubles."""
    most = 1 << CLIPPED_BITS
    rough = x.clip(-most << NORMAL_BITS, most << NORMAL_BITS) << np.maximum(scales, 0)
    wide = np.where(scales < 0, x >> np.maximum(-scales, 0), rough)
    return wide.clip(-most, most).astype(np.float64)


def sweep(m: Moments, source: int) -> Moments:
    """The moments with all taps of a source taken out of everything else (Gauss and Jordan)."""
    for k in range(len(TAPS) * source, len(TAPS) * (source + 1)):
        row = m[k] / m[k, k]
        m = m - np.multiply.outer(m[:, k], row)
        m[k] = row
    return m


def energy_of(m: Moments) -> float:
    return max(float(m[-1, -1]), 1.0)


def fit(
    indices: Indices, predictor: Predictor, earlier: Sequence[Indices], links: tuple[int, ...]
) -> tuple[Reference, ...]:
    """The references of a packet, weights and all; those that would weigh nothing are left out."""
    at = np.arange(indices.size)
    settled = at >= min(SETTLING, indices.size // 2)
    if indices.size > ENOUGH:
        settled &= at // PIECE % (indices.size // ENOUGH + 1) == 0
    left = moments(indices, predictor, earlier, links, settled)
    for place in range(len(links)):
        left = sweep(left, place)
    weights = np.floor(64 * left[:-1, -1] + 0.5).clip(-128, 127).astype(int)
    rows = weights.reshape(-1, len(TAPS)).tolist()
    return tuple(
        Reference(a, (row[0], row[1], row[2]))
        for a, row in zip(links, rows, strict=True)
        if any(row)
    )


Links = list[tuple[int, ...]]
"""For each channel of a run the earlier ones that it is predicted from."""

RUN_LIMIT = 32
"""Components of a track: one lost packet takes all of them along."""

SHORTEST, LONGEST = 4096, 16384
"""A quarter of a channel is looked at, within these samples."""

PIECES = 4
"""Spread over the channel, where it is not looked at as a whole."""

SAVED, HOPED = 0.03, 0.02
"""Share of the bits that a track of several components has to save; and of estimated bits, from
which on it is tried."""


ROOM = 2
"""References save at most this many times what pairwise correlations promise (measured: 0.1 to 1.9
times)."""


DIFFERENCES, ROUNDS = (0, 1), 2
"""Weights and predictor are fitted in turn: once for both differences, then ROUNDS times more for
the better one. The second round takes 2 % off a glove, further ones 1 % each."""


def find_runs(
    groups: Sequence[list[Channel]], steps: Sequence[int | None]
) -> Iterator[tuple[list[Channel], Links]]:
    """All channels in their order, side by side those that one track might hold, with their links.

    ``steps``: of the uniform grids the groups are put on, None where a group stays as it is.
    """
    at = 0
    while at < len(groups):
        first, step = groups[at][0], steps[at]
        stop = at + 1
        while (
            step is not None
            and stop < min(len(groups), at + RUN_LIMIT)
            and steps[stop] == step
            and same_ticks(first, groups[stop][0])
        ):
            stop += 1
        run = [group[0] for group in groups[at:stop]]
        tied: list[tuple[int, int]] = []
        if step is not None and len(run) > 1:
            view = SampleView.of(first.coverage)
            links = find_links([view.indices(channel, step) for channel in run], view.settled)
            tied = intervals(links)
        done = 0
        for start, end in [*tied, (len(run), len(run))]:
            yield from ((group, []) for group in groups[at + done : at + start])
            if start < end:
                yield run[start:end], [tuple(a - start for a in each) for each in links[start:end]]
            done = end
        at = stop


def same_ticks(one: Channel, other: Channel) -> bool:
    return one.rate_exact == other.rate_exact and one.coverage == other.coverage


def intervals(links: Links) -> list[tuple[int, int]]:
    """The shortest runs of neighbours that no link leaves."""
    found: list[tuple[int, int]] = []
    for place, sources in enumerate(links):
        if sources:
            start = sources[0]
            while found and found[-1][1] > start:
                start = min(start, found.pop()[0])
            found.append((start, place + 1))
    return found


@dataclass(frozen=True)
class SampleView:
    """Samples of a channel that are looked at: where they are, and which of them follow a gap or
    the end of a piece."""

    places: Indices
    torn: NDArray[np.bool_]

    @classmethod
    def of(cls, coverage: Sequence[Span]) -> SampleView:
        ends = np.cumsum([span.ticks for span in coverage])
        total = int(ends[-1])
        size = min(total, max(SHORTEST, min(total // 4, LONGEST)))
        count = PIECES if size < total else 1
        starts = [(total * (2 * k + 1) - size) // (2 * count) for k in range(count)]
        places = np.concatenate([start + np.arange(size // count) for start in starts])
        return cls(places, (np.diff(places, prepend=-2) != 1) | np.isin(places, ends))

    @property
    def settled(self) -> NDArray[np.bool_]:
        """The places whose prediction errors are known well enough."""
        at = np.arange(self.places.size)
        since = at - np.maximum.accumulate(np.where(self.torn, at, 0))
        return np.asarray((since >= SETTLING) & ~np.append(self.torn[1:], True))

    def indices(self, channel: Channel, step: int) -> Indices:
        """Put together without jumps, where that keeps them within what an index may be."""
        counts = channel.stored[self.places].astype(np.int64)
        x = nearest_uniform(counts, LpcParameters(step))
        moves = np.diff(x, prepend=x[0])
        moves[self.torn] = 0
        joined = x[0] + np.cumsum(moves)
        return joined if int(np.abs(joined).max()) <= INDEX_LIMIT else x


def find_links(stretches: Sequence[Indices], settled: NDArray[np.bool_]) -> Links:
    """Empty tuples all, where too little would be saved."""
    size = int(np.count_nonzero(settled))
    nothing: Links = [()] * len(stretches)
    if size < SETTLING:
        return nothing
    predictors = [quick_predictor(x) for x in stretches]
    errors = [
        prediction_errors(x, p.difference, p.coefficients or [], p.base)[settled]
        for x, p in zip(stretches, predictors, strict=True)
    ]
    bits = sum(size * log2(1 + 5.4 * float(np.abs(e).mean())) for e in errors)
    likely, most = likely_sources(np.stack([scaled(e, scales_of(e)) for e in errors]))
    if ROOM * most < HOPED * bits:
        return nothing
    links: Links = []
    saved = 0.0
    for place, sources in enumerate(likely):
        used: tuple[int, ...] = ()
        gain = 0.0
        if sources:
            left = moments(stretches[place], predictors[place], stretches, sources, settled)
            used, gain = choose_sources(left, sources, size)
        links.append(used)
        saved += gain
    return links if saved > HOPED * bits else nothing


def encode_referring(
    indices: Indices, alone: bytes, earlier: Sequence[Indices], links: tuple[int, ...]
) -> bytes:
    """The smallest found of the component packets with references, and ``alone``."""
    predictor, constant, _ = parse_header(alone, 0)
    if constant or not links:
        return alone

    def packet_of(found: Predictor) -> bytes:
        try:
            return encode_component(indices, found, earlier) if found.references else alone
        except ValueError:
            return alone

    first = refer(indices, predictor, earlier, links)
    ways = [first, *(refit(indices, first, d, earlier, links) for d in DIFFERENCES)]
    best, predictor = min(((packet_of(way), way) for way in ways), key=lambda each: len(each[0]))
    # Higher differences have no coefficients (LPC-004).
    for _ in range(ROUNDS if predictor.difference in DIFFERENCES else 0):
        found = refit(indices, predictor, predictor.difference, earlier, links)
        packet = packet_of(found)
        if len(packet) >= len(best):
            break
        best, predictor = packet, found
    return min(alone, best, key=len)


def refer(
    indices: Indices, predictor: Predictor, earlier: Sequence[Indices], links: tuple[int, ...]
) -> Predictor:
    """With the references that go with it, and a base that goes with them."""
    references = fit(indices, predictor, earlier, links)
    base = predictor.base
    if not predictor.difference:
        # What references add is counted from their first indices, not from their means.
        size = indices.size
        far = [int(earlier[a].sum()) - size * int(earlier[a][0]) for a, _ in references]
        base -= rdiv(sum(sum(w) * n for (_, w), n in zip(references, far, strict=True)), 64 * size)
        extent = max(-int(indices.min()), int(indices.max()))
        base = clamp(base, -extent, extent)
    return replace(predictor, base=base, references=references)


def refit(
    indices: Indices,
    predictor: Predictor,
    difference: int,
    earlier: Sequence[Indices],
    links: tuple[int, ...],
) -> Predictor:
    """The predictor of what the references leave, and new references. Errors of predictors are
    linear: those of index and references are the errors of 64 * index - sum of w * index."""
    left = 64 * (indices - indices[0])
    for a, weights in predictor.references:
        around = np.concatenate(([0], earlier[a] - earlier[a][0], [0]))
        for tap, weight in zip(TAPS, weights, strict=True):
            left -= weight * around[1 + tap : 1 + tap + left.size]
    if int(np.abs(left).max()) > INDEX_LIMIT:
        return predictor
    start = int(left[0]) if difference else rdiv(int(left.sum()), left.size)
    found, _ = linear_predictor(left, difference, start)
    if found.coefficients is None:
        return predictor
    base = int(indices[0]) if difference else rdiv(int(indices.sum()), indices.size)
    found = replace(
        predictor, difference=difference, reflections=found.reflections, base=base, references=()
    )
    return refer(indices, found, earlier, links)


def encode_run(
    channels: Sequence[Channel],
    first_channel: int,
    error: int,
    spans: Sequence[Span],
    links: Links,
    apart: Sequence[Unit],
) -> Unit | None:
    """One track of several components, which alone are the units ``apart``; None where they have
    no common range of counts."""
    counts = np.column_stack([channel.stored.astype(np.int64) for channel in channels])
    low, high = declared_range(counts)
    if not all(c.calibration and c.calibration.covers(low, high) for c in channels):
        return None
    source = InputBlock(tuple(channels), counts, tuple(spans))
    grid = LpcParameters(step=2 * error + 1)
    base = make_track(channels, first_channel, codec="LPCR", count_min=low, count_max=high)
    coded = Coded(replace(base, parameters=grid.build()))
    sizes = [0] * len(channels)
    for span, rows in source.pieces(source.counts):
        columns = [
            np.ascontiguousarray(nearest_uniform(rows[:, place], grid))
            for place in range(len(channels))
        ]
        packets = [
            encode_referring(
                indices, packet_alone(unit, grid, span, indices), columns[:place], sources
            )
            for place, (indices, unit, sources) in enumerate(
                zip(columns, apart, links, strict=True)
            )
        ]
        sizes = [size + len(packet) for size, packet in zip(sizes, packets, strict=True)]
        coded.packets.append(Packet(0, span.start, span.ticks, join_components(packets)))
    if error:
        zeros = tuple(
            clamp(c.calibration.zero, -ZERO_LIMIT, ZERO_LIMIT - 1)
            for c in channels
            if c.calibration
        )
        band = Deadband(0, 1, (error,) * len(zeros), zeros)
        coded.track = replace(coded.track, contract=contract_for(band))
    last = first_channel + len(channels) - 1
    kind = "each sample from those before, in equal steps" if error else "lossless"
    parts = tuple(
        (f"{kind}, track of {first_channel}-{last}" + told(sources, first_channel), size)
        for sources, size in zip(links, sizes, strict=True)
    )
    return Unit(coded, None, "predicted", kind, exact=not error, parts=parts)


def told(sources: tuple[int, ...], first_channel: int) -> str:
    numbers = ", ".join(str(first_channel + a) for a in sources)
    return f", from {numbers}" if numbers else ""


def packet_alone(unit: Unit, grid: LpcParameters, span: Span, indices: Indices) -> bytes:
    """Without references: as the unit has it, where that has this grid and is cut in this way."""
    track = unit.base.track
    if track.codec == "LPCR" and track.parameters == grid.build() and not unit.grid:
        for packet in unit.base.packets:
            if (packet.start, packet.span) == (span.start, span.ticks):
                return packet.data
    return encode_best(indices)


def step_of(members: Sequence[Channel], promise: Promise, settings: Settings) -> int | None:
    """The step of the grid that a channel alone is put on; None where it is to stay alone."""
    channel = members[0]
    if not (settings.references and settings.searches.references):
        return None
    if promise.k or promise.texture is not None or promise.paper:
        return None
    if len(members) > 1 or channel.calibration is None or not channel.stored.size:
        return None
    counts = channel.stored
    if not -(1 << 31) <= int(counts.min()) <= int(counts.max()) < 1 << 31:
        return None
    return 2 * error_of(channel, promise) + 1
