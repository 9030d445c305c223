"""Which channels are predicted from which, and the tracks of several components that they become.

Prediction errors that rise and fall together are looked for in a stretch of each channel. Weights
are those of least squares, every sample measured by the prediction errors around it, since bits are
saved by the ratio of errors. Sums are of integers, exact in any order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from math import log2

import numpy as np
from numpy.typing import NDArray

from ..codecs.components import encode_component, join_components, prediction_errors, taps_of
from ..codecs.predicted import LpcParameters, Predictor, parse_header
from ..codecs.references import REFERENCE_LIMIT, REFERENCE_SIZE, TAPS, Reference
from ..container.cluster import Packet
from ..deadband import ZERO_LIMIT, Deadband
from ..integers import clamp
from ..recording import Channel, Span
from .indexed import error_of, kept, nearest_uniform
from .predict import encode_best, linear_predictor
from .settings import Settings
from .source import Source, cut, declared_range, make_track
from .unit import Coded, Unit

Indices = NDArray[np.int64]
Moments = NDArray[np.float64]
Links = list[tuple[int, ...]]
"""For each channel of a run the earlier ones that it is predicted from."""

RUN_LIMIT = 32
"""Components of a track: one lost packet takes all of them along."""

SHORTEST, LONGEST = 4096, 16384
"""A quarter of a channel is looked at, within these samples."""

SETTLING = 33
"""Samples at the start of a packet whose prediction errors tell nothing."""

LIKELY = 0.005
"""Squared correlation of two channels' prediction errors from which on a reference is tried."""

CHANCE = 16
"""The same times the samples: chance alone gives 1."""

SAVED, HOPED = 0.03, 0.02
"""Share of the bits that a track of several components has to save; and of estimated bits, from
which on it is tried."""

NORMAL_BITS, CLIPPED_BITS, BLOCK = 8, 16, 32
"""Prediction errors are brought to a mean of 8 bits in each block, and clipped to 16: products of
32 bits, and no packet has 2**20 of them."""

WORTH = 0.004
"""Bits a sample that a further reference has to save."""


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
            and alike(first, groups[stop][0])
        ):
            stop += 1
        run = [group[0] for group in groups[at:stop]]
        tied: list[tuple[int, int]] = []
        if step is not None and len(run) > 1:
            links = find_links([stretch_of(channel, step) for channel in run])
            tied = intervals(links)
        done = 0
        for start, end in [*tied, (len(run), len(run))]:
            yield from ((group, []) for group in groups[at + done : at + start])
            if start < end:
                yield run[start:end], [tuple(a - start for a in each) for each in links[start:end]]
            done = end
        at = stop


def alike(one: Channel, other: Channel) -> bool:
    return one.rate == other.rate and one.coverage == other.coverage


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


def stretch_of(channel: Channel, step: int) -> Indices:
    """Indices from the middle of the longest span without a gap."""
    at = longest = place = 0
    for span in channel.coverage:
        if span.ticks > longest:
            place, longest = at, span.ticks
        at += span.ticks
    size = min(longest, max(SHORTEST, min(longest // 4, LONGEST)))
    start = place + (longest - size) // 2
    counts = channel.values[start : start + size].astype(np.int64)
    return nearest_uniform(counts, LpcParameters(step))


def find_links(stretches: Sequence[Indices]) -> Links:
    """Empty tuples all, where too little would be saved."""
    count, size = len(stretches), stretches[0].size - SETTLING
    nothing: Links = [()] * count
    if size < 2 * SETTLING:
        return nothing
    predictors = [quick_predictor(x) for x in stretches]
    errors = [
        prediction_errors(x, p.difference, p.coefficients or [], p.base)[SETTLING:]
        for x, p in zip(stretches, predictors, strict=True)
    ]
    likely = likely_sources(np.stack([scaled(e, scales_of(e)) for e in errors]))
    if not any(likely):
        return nothing
    links: Links = []
    saved = bits = 0.0
    for place, sources in enumerate(likely):
        used: tuple[int, ...] = ()
        gain = 0.0
        if sources:
            predictor = predictors[place]
            used, gain = choose_sources(stretches, predictor, errors[place], sources)
        links.append(used)
        saved += gain
        bits += size * log2(1 + 5.4 * float(np.abs(errors[place]).mean()))
    return links if saved > HOPED * bits else nothing


def quick_predictor(indices: Indices) -> Predictor:
    first = int(indices[0])
    if (indices == first).all():
        return Predictor(1, (), first)
    predictor, _ = linear_predictor(indices, 1, first)
    return predictor if predictor.coefficients is not None else Predictor(1, (), first)


def likely_sources(errors: NDArray[np.float64]) -> list[list[int]]:
    """For each channel the earlier ones whose errors go with its own, at one of the taps."""
    size = errors.shape[1]
    energies = np.einsum("it,it->i", errors, errors) + 1
    scores = np.zeros((len(errors),) * 2)
    for tap in TAPS:
        now = errors[:, max(0, -tap) : size - max(0, tap)]
        then = errors[:, max(0, tap) : size + min(0, tap)]
        products = np.einsum("it,jt->ij", now, then)
        scores += products * products / np.multiply.outer(energies, energies)
    enough = max(LIKELY, CHANCE / size)
    found = []
    for place in range(len(errors)):
        likely = [(-score, a) for a, score in enumerate(scores[place, :place]) if score > enough]
        found.append(sorted(a for _, a in sorted(likely)[:REFERENCE_LIMIT]))
    return found


def choose_sources(
    stretches: Sequence[Indices], predictor: Predictor, errors: Indices, likely: list[int]
) -> tuple[tuple[int, ...], float]:
    """One after the other while it is worth its bits; and the bits that all of them save."""
    left = moments(errors, [stretches[a] for a in likely], predictor, SETTLING)
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
        saved = errors.size / 2 * log2(before / least)
        if saved < max(8 * REFERENCE_SIZE, WORTH * errors.size):
            break
        before, left = least, swept
        chosen.append(place)
    links = tuple(likely[place] for place in sorted(chosen))
    return links, errors.size / 2 * log2(first / before)


def moments(
    errors: Indices, sources: Sequence[Indices], predictor: Predictor, start: int
) -> Moments:
    """Sums of products of all taps of the sources and, last, the errors."""
    scales = scales_of(errors)
    c = predictor.coefficients or []
    rows = [
        scaled(tap[start:], scales)
        for source in sources
        for tap in taps_of(source, predictor.difference, c)
    ]
    x = np.stack([*rows, scaled(errors, scales)])
    found: Moments = np.einsum("it,jt->ij", x, x)
    # Roundings of the scaled numbers: without them, taps that are the same have no inverse.
    found[np.diag_indices(len(rows))] += x.shape[1]
    return found


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
    start = SETTLING if indices.size > 2 * SETTLING else 0
    c = predictor.coefficients or []
    errors = prediction_errors(indices, predictor.difference, c, predictor.base)[start:]
    left = moments(errors, [earlier[a] for a in links], predictor, start)
    for place in range(len(links)):
        left = sweep(left, place)
    weights = np.floor(64 * left[:-1, -1] + 0.5).clip(-128, 127).astype(int)
    rows = weights.reshape(-1, len(TAPS)).tolist()
    return tuple(
        Reference(a, (row[0], row[1], row[2]))
        for a, row in zip(links, rows, strict=True)
        if any(row)
    )


def encode_referring(
    indices: Indices, alone: bytes, earlier: Sequence[Indices], links: tuple[int, ...]
) -> bytes:
    """The smaller of the component packets with references and ``alone``."""
    predictor, constant, _ = parse_header(alone, 0)
    references = () if constant or not links else fit(indices, predictor, earlier, links)
    if not references:
        return alone
    base = predictor.base
    if not predictor.difference:
        # What references add is counted from their first indices, not from their means.
        away = [float(earlier[a].mean()) - int(earlier[a][0]) for a, _ in references]
        added = sum(sum(w) * far for (_, w), far in zip(references, away, strict=True))
        base += int(np.floor(added / 64 + 0.5))
    try:
        referring = encode_component(
            indices, replace(predictor, base=base, references=references), earlier
        )
    except ValueError:
        return alone
    return min(alone, referring, key=len)


def encode_run(
    channels: Sequence[Channel],
    first_channel: int,
    settings: Settings,
    cluster: Fraction,
    links: Links,
    apart: Sequence[Unit],
) -> Unit | None:
    """One track of several components, which alone are the units ``apart``; None where they have
    no common range of counts."""
    counts = np.column_stack([channel.values.astype(np.int64) for channel in channels])
    low, high = declared_range(counts)
    if not all(c.calibration and c.calibration.covers(low, high) for c in channels):
        return None
    # Half of the components: packets of LPCR take less than five bytes a sample.
    spans = cut(channels[0].coverage, channels[0].rate, cluster, (len(channels) + 1) // 2)
    source = Source(tuple(channels), counts, tuple(spans))
    error = error_of(channels[0], settings)
    grid = LpcParameters(step=2 * error + 1)
    base = make_track(
        source, first_channel, kind="full", codec="LPCR", count_min=low, count_max=high
    )
    coded = Coded(replace(base, parameters=grid.build()))
    sizes = [0] * len(channels)
    for span, rows in source.pieces(source.counts):
        columns = [
            np.ascontiguousarray(nearest_uniform(rows[:, place], grid))
            for place in range(len(channels))
        ]
        packets = [
            encode_referring(indices, packet_alone(unit, span, indices), columns[:place], sources)
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
        coded.track = replace(coded.track, contract=kept(source, coded, band))
    last = first_channel + len(channels) - 1
    kind = f"within {error} counts" if error else "lossless"
    parts = tuple(
        (f"{kind}, track of {first_channel}-{last}" + told(sources, first_channel), size)
        for sources, size in zip(links, sizes, strict=True)
    )
    return Unit(coded, None, "predicted", kind, exact=not error, parts=parts)


def told(sources: tuple[int, ...], first_channel: int) -> str:
    numbers = ", ".join(str(first_channel + a) for a in sources)
    return f", beside {numbers}" if numbers else ""


def packet_alone(unit: Unit, span: Span, indices: Indices) -> bytes:
    """Without references: as the unit has it, where that is cut in the same way."""
    if unit.base.track.codec == "LPCR":
        for packet in unit.base.packets:
            if (packet.start, packet.span) == (span.start, span.ticks):
                return packet.data
    return encode_best(indices, thorough=False)


def step_of(members: Sequence[Channel], settings: Settings) -> int | None:
    """The step of the grid that a channel alone is put on; None where it is to stay alone."""
    channel = members[0]
    if not settings.references or settings.preset not in ("archive", "near-lossless"):
        return None
    if len(members) > 1 or channel.calibration is None or not channel.values.size:
        return None
    counts = channel.values
    if not -(1 << 31) <= int(counts.min()) <= int(counts.max()) < 1 << 31:
        return None
    return 2 * error_of(channel, settings) + 1
