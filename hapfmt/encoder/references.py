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
from contextlib import suppress
from dataclasses import dataclass, replace
from math import log2

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..codecs.predicted import (
    ORDER_LIMIT,
    REFERENCE_LIMIT,
    REFERENCE_SIZE,
    TABLE,
    TAPS,
    Predictor,
    Reference,
    encode_indices,
    join_components,
    prediction_errors,
    step_up,
)
from ..deadband import Deadband
from ..format.cluster import Packet
from ..kernels import compiled
from ..limits import ZERO_LIMIT
from ..numbers import clamp
from ..recording import Channel, Span
from ..spool import release
from ..threads import check_stopped
from .bounded import contract_for, error_of
from .effort import Effort
from .gridded import nearest_uniform
from .knots import Coded
from .plan import Promise
from .predict import LIMITS, autocorrelations, best_order, encode_best, levinson, logs
from .settings import Settings
from .source import declared_range, make_track
from .unit import Unit

Indices = NDArray[np.int64]
Moments = NDArray[np.float64]

SETTLING = 33
"""Samples at the start of a packet or piece, whose prediction errors are not used."""

LIKELY = 0.005
"""Squared correlation of two channels' prediction errors from which on a reference is tried."""

CHANCE = 16
"""The same times the samples: chance alone gives 1."""

NORMAL_BITS, LOUDEST, BLOCK = 7, 4095, 32
"""Prediction errors are brought to a mean of 7 bits in each block, and clipped: a tap does not
outweigh all the rest, and sums of products are quick."""

AWAY = 2
"""Ticks between two taps."""

FIRST_ORDERS = 8
"""Coefficients of the predictors with which channels are compared."""

ENOUGH, PIECE = 4096, 256
"""In packets of more than ENOUGH samples, only every nth piece is used."""

WORTH = 0.004
"""Bits a sample that a further reference has to save."""

PAYS = 0.01
"""Share of the bits that the references of a packet have to save, besides their own."""


def predictor_of(y: Indices, orders: int | None = None) -> tuple[int, ...]:
    """Reflection coefficients for first differences: as many as repay themselves, or ``orders``."""
    most = min(orders or ORDER_LIMIT, y.size - 1)
    reflections, energies = levinson(autocorrelations(y, 0, 0), y.size, most)
    found = tuple(reflections[: orders or best_order(energies, y.size)])
    return () if step_up(found) is None else found


def shifts_of(errors: Indices) -> Indices:
    """By how many bits the numbers of each block are shifted to the left, for each sample."""
    starts = np.arange(0, errors.size, BLOCK)
    means = np.add.reduceat(np.abs(errors), starts) // np.diff(np.append(starts, errors.size))
    bits = np.frexp(means.astype(np.float64))[1].astype(np.int64)
    return np.repeat(NORMAL_BITS - np.maximum(bits, 1), BLOCK)[: errors.size]


def scaled(x: Indices, shifts: Indices) -> Indices:
    """Clipped as well."""
    quiet = x.clip(-LOUDEST, LOUDEST) << np.maximum(shifts, 0)
    return np.where(shifts < 0, x >> np.maximum(-shifts, 0), quiet).clip(-LOUDEST, LOUDEST)


def moments(rows: Sequence[Indices], places: Sequence[int], target: int) -> Moments:
    """Sums of products of all taps of the rows at these places and, last, the target."""
    size = rows[target].size

    def product(a: int, p: int, b: int, q: int) -> int:
        if a < b:
            a, p, b, q = b, q, a, p
        now = rows[a][AWAY : size - AWAY]
        then = rows[b][AWAY + q - p : size - AWAY + q - p]
        return int((now * then).sum()) if size > 2 * AWAY else 0

    taps = [*((a, tap) for a in places for tap in TAPS), (target, 0)]
    m = np.array([[product(*one, *other) for other in taps] for one in taps], np.float64)
    # Roundings: without them, taps that are the same have no inverse.
    m[np.diag_indices(len(taps) - 1)] += size
    return m


def sweep(m: Moments, source: int) -> Moments:
    """The moments with all taps of a source taken out of everything else (Gauss and Jordan)."""
    for k in range(len(TAPS) * source, len(TAPS) * (source + 1)):
        row = m[k] / m[k, k]
        m = m - np.multiply.outer(m[:, k], row)
        m[k] = row
    return m


def energy_of(m: Moments) -> float:
    return max(float(m[-1, -1]), 1.0)


def choose_sources(
    rows: Sequence[Indices], target: int, enough: float, factor: float
) -> tuple[tuple[int, ...], float, float]:
    """Earlier rows one after the other, while each lowers the energy by the ``factor``; and the
    energy before and after."""
    energies = [float((row[AWAY:-AWAY] ** 2).sum()) + 1 for row in rows]
    scores = []
    for a in range(target):
        products = moments(rows, [a], target)[:-1, -1].tolist()
        score = 0.0
        for product in products:
            score += product * product / (energies[target] * energies[a])
        if score > enough:
            scores.append((-score, a))
    likely = sorted(a for _, a in sorted(scores)[:REFERENCE_LIMIT])
    left = moments(rows, likely, target)
    before = first = energy_of(left)
    chosen: list[int] = []
    while len(chosen) < len(likely):
        tried = [
            (energy_of(sweep(left, place)), place)
            for place in range(len(likely))
            if place not in chosen
        ]
        least, place = min(tried)
        if before < least * factor:
            break
        before, left = least, sweep(left, place)
        chosen.append(place)
    return tuple(likely[place] for place in sorted(chosen)), first, before


@dataclass(frozen=True)
class Fitted:
    """The predictor of a component with references, and what these add to its prediction errors.

    ``without``, ``bits``: 256 times about the bits of the samples looked at, alone and with them.
    """

    reflections: tuple[int, ...]
    weights: list[int]
    cross: Indices
    without: int
    bits: int
    used: int


def fit(rows: Indices, target: int, links: tuple[int, ...]) -> Fitted:
    """What is left of the differences of a row by those of its links, twice: at first with the
    predictor that it has alone."""
    size = rows.shape[1]
    if compiled is not None:
        ks, w = np.zeros(ORDER_LIMIT, np.int8), np.zeros(len(links) * len(TAPS), np.int8)
        cross = np.zeros(size, np.int64)
        order, without, bits, used = compiled.refer(
            np.ascontiguousarray(rows), target, bytes(links), TABLE, LIMITS, ks, w, cross
        )
        return Fitted(tuple(ks[:order].tolist()), w.tolist(), cross, without, bits, used)
    table = rows[[*links, target]]
    y = list(np.diff(table, prepend=table[:, :1], axis=1))
    at = np.arange(size)
    looked = at >= min(SETTLING, size // 2)
    if size > ENOUGH:
        looked &= at // PIECE % (size // ENOUGH + 1) == 0
    reflections, costs = predictor_of(y[-1]), []
    for last in (False, True):
        c = step_up(reflections) or []
        errors = [prediction_errors(row, 0, c, 0) for row in y]
        seen = [row[looked] for row in errors]
        shifts = shifts_of(seen[-1])
        m = moments([scaled(row, shifts) for row in seen], range(len(links)), len(links))
        for place in range(len(links)):
            m = sweep(m, place)
        weights = np.floor(64 * m[:-1, -1] + 0.5).clip(-128, 127).astype(int).tolist()
        if not last:
            costs.append(cost_of(seen[-1]))
            reflections = predictor_of(64 * y[-1] - summed(weights, y[:-1]))
    rest = seen[-1] - ((summed(weights, seen[:-1]) + 32) >> 6)
    cross = (summed(weights, errors[:-1]) + 32) >> 6
    return Fitted(reflections, weights, cross, costs[0], cost_of(rest), rest.size)


def summed(weights: Sequence[int], rows: Sequence[Indices]) -> Indices:
    """Weights times the taps of each row, nothing beyond the ends."""
    total = np.zeros(rows[0].size, np.int64)
    for place, row in enumerate(rows):
        around = np.concatenate(([0], row, [0]))
        for k, tap in enumerate(TAPS):
            total += weights[len(TAPS) * place + k] * around[1 + tap : 1 + tap + row.size]
    return total


def cost_of(errors: Indices) -> int:
    """256 times about their bits, by the mean of each block."""
    starts = np.arange(0, errors.size, BLOCK)
    sums, sizes = np.add.reduceat(np.abs(errors), starts), np.diff(np.append(starts, errors.size))
    return int((sizes * (logs(32 * sizes + 87 * sums) - logs(32 * sizes))).sum())


Links = list[tuple[int, ...]]
"""For each channel of a run the earlier ones that it is predicted from."""

RUN_LIMIT = 32
"""Components of a track: one lost packet takes all of them along."""

LOOKED_AT, PIECES = 4096, 4
"""Most samples of a channel that are compared, and in how many pieces."""

SAVED = 0.02
"""Share of the bits, by an estimate, that a track of several components has to save."""

REPEATED = 4
"""Repeats are marked where more than one sample in four repeats the one before."""


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
            places, torn = places_in(first.coverage)
            rows = np.stack([channel.stored[places] for channel in run]).astype(np.int64)
            links = find_links(nearest_uniform(rows, LpcParameters(step)), torn)
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


def places_in(coverage: Sequence[Span]) -> tuple[slice | Indices, NDArray[np.bool_]]:
    """The samples of a channel that are looked at, and which of them follow a gap or the end of a
    piece."""
    ends = np.cumsum([span.ticks for span in coverage])
    total = int(ends[-1])
    if total <= LOOKED_AT:
        torn = np.zeros(total, np.bool_)
        torn[ends[:-1]] = True
        return slice(None), torn
    size = LOOKED_AT // PIECES
    starts = [(total * (2 * k + 1) - LOOKED_AT) // (2 * PIECES) for k in range(PIECES)]
    places = np.concatenate([start + np.arange(size) for start in starts])
    return places, (np.diff(places, prepend=-2) != 1) | np.isin(places, ends)


def find_links(rows: Indices, torn: NDArray[np.bool_]) -> Links:
    """Empty tuples all, where too little would be saved."""
    count, size = rows.shape
    at = np.arange(size)
    since = at - np.maximum.accumulate(np.where(torn, at, 0))
    settled = (since >= SETTLING) & ~np.append(torn[1:], True)
    used = int(np.count_nonzero(settled))
    links: Links = [()] * count
    if used < SETTLING:
        return links
    enough, factor = max(LIKELY, CHANCE / used), 2.0 ** (2 * max(8 * REFERENCE_SIZE / used, WORTH))
    chosen: list[tuple[tuple[int, ...], float, float]] = []
    if compiled is not None:
        found, energies = np.zeros((count, REFERENCE_LIMIT + 1), np.int64), np.zeros((count, 2))
        totals = np.zeros(count, np.int64)
        compiled.find_links(
            np.ascontiguousarray(rows), torn.astype(np.uint8), TABLE, LIMITS, enough, factor,
            found, energies, totals,
        )  # fmt: skip
        sums = totals.tolist()
        for (number, *sources), (before, after) in zip(
            found.tolist(), energies.tolist(), strict=True
        ):
            chosen.append((tuple(sources[:number]), before, after))
    else:
        looked, sums = [], []
        for y in np.diff(rows, prepend=rows[:, :1], axis=1):
            y[torn] = 0
            c = step_up(predictor_of(y, FIRST_ORDERS)) or []
            errors = prediction_errors(y, 0, c, 0)[settled]
            looked.append(scaled(errors, shifts_of(errors)))
            sums.append(int(np.abs(errors).sum()))
        chosen = [choose_sources(looked, place, enough, factor) for place in range(count)]
    bits = sum(used * log2(1 + 5.4 * total / used) for total in sums)
    saved = sum(used / 2 * log2(before / after) for _, before, after in chosen)
    return [sources for sources, _, _ in chosen] if saved > SAVED * bits else links


def encode_referring(rows: Indices, place: int, links: tuple[int, ...], effort: Effort) -> bytes:
    """The component packet of a row, with references if these save their bits."""
    indices = rows[place]
    if not links or indices.size < 2 or (indices == indices[0]).all():
        return encode_best(indices, effort)
    found = fit(rows, place, links)
    around = zip(found.weights[::3], found.weights[1::3], found.weights[2::3], strict=True)
    references = tuple(Reference(a, w) for a, w in zip(links, around, strict=True) if any(w))
    saved = (found.without - found.bits) * indices.size // found.used
    own = 256 * 8 * (1 + REFERENCE_SIZE * len(references))
    if references and saved > own + PAYS * found.without * indices.size / found.used:
        repeated = np.count_nonzero(indices[1:] == indices[:-1]) * REPEATED > indices.size
        # References may tell of the repeats as well.
        written = []
        for marks in (False, True)[: 1 + repeated]:
            predictor = Predictor(1, found.reflections, int(indices[0]), marks, references)
            with suppress(ValueError):
                written.append(encode_indices(indices, predictor, found.cross))
        if written:
            return min(written, key=len)
    return encode_best(indices, effort)


def encode_run(
    channels: Sequence[Channel],
    first_channel: int,
    error: int,
    spans: Sequence[Span],
    links: Links,
    effort: Effort,
) -> Unit | None:
    """One track of several components; None where they have no common range of counts."""
    ends = [end for c in channels for end in (c.stored.min(), c.stored.max())]
    low, high = declared_range(np.array(ends, np.int64))
    if not all(c.calibration and c.calibration.covers(low, high) for c in channels):
        return None
    grid = LpcParameters(step=2 * error + 1)
    base = make_track(channels, first_channel, codec="LPCR", count_min=low, count_max=high)
    coded = Coded(replace(base, parameters=grid.build()))
    sizes = [0] * len(channels)
    at = 0
    for span in spans:
        check_stopped()
        counts = [channel.stored[at : at + span.ticks].astype(np.int64) for channel in channels]
        rows = np.stack([nearest_uniform(row, grid) for row in counts])
        at += span.ticks
        release()
        packets = [
            encode_referring(rows, place, sources, effort) for place, sources in enumerate(links)
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
