"""Floating point channels that are linear in others, sample by sample (LPCX, rule 4 of SPEC 9.7).

Such channels are equal to another one, scaled, or filtered by a logger. Loggers often store a
signal and its filtered form. The second takes 53 new bits a sample, which no predictor of integers
finds. It takes almost none where its filter is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from math import inf
from typing import NamedTuple

import numpy as np

from ..codecs.exact import (
    COEFFICIENT_LIMIT,
    LINEAR,
    Counts,
    Doubles,
    ExactParameters,
    LinearTerm,
    lacking_of,
    ordered,
    predictions,
)
from ..codecs.predicted import join_components
from ..format.cluster import Packet
from ..limits import EXACT_LIMIT
from ..numbers import build_varint
from ..recording import Calibration, Channel
from .exact import Candidate, binary_grid, smallest_exact
from .knots import Coded
from .predict import encode_best
from .source import cut, declared_range, make_track
from .unit import Unit, decode_all

RUN_LIMIT = 32
"""Components of a track: one lost packet takes all of them along."""

COSTLY = 20
"""Bits a sample from which on a channel is tried as a linear one."""

HOPED = 8
"""Bits a sample that a relation has to save."""

LOOKED_AT, SETTLING = 400, 4
"""Samples in which relations are searched, and those at their start that serve as lags."""

PROBED = 40
"""Samples that rule most channels out as sources."""

NEAR = 2.0**-36
"""Of the largest value: what a relation may leave there."""

FORMS = ((0, 0), (1, 0), (1, 1), (2, 2))
"""Lags of the channel itself and of the other one, the fewest first."""

GRID_BITS = 12
"""Bits of the range of the counts of a linear channel, as many as many converters have. They serve
readers that do not need exact values. The exact values do not depend on them."""

REFINED, ROUNDS = 2048, 3

DEPENDENT = 1e-14
"""A row is a sum of the rows before it if they leave this share of it or less."""


class Relation(NamedTuple):
    """Of channel ``target``, by its place among those that were looked at, to channel ``source``;
    ``bits`` a sample of its corrections."""

    target: int
    source: int
    c0: float
    terms: tuple[LinearTerm, ...]
    bits: float


def find_relations(columns: Sequence[Doubles], costly: Sequence[bool]) -> list[Relation]:
    """The best of each costly channel, where one saves enough. ``columns``: of equal length, no
    number of them infinite or NaN."""
    size = columns[0].size
    found: list[Relation] = []
    if size < 2 * LOOKED_AT:
        return found
    part = slice(size // 2, size // 2 + LOOKED_AT)
    looked = [x[part] for x in columns]
    left = [place for place, each in enumerate(costly) if each]
    near = {target: sources_of(target, looked) for target in left}
    known = {place for place, each in enumerate(costly) if not each}

    def usable(target: int, linear: set[int]) -> list[int]:
        return [a for a in near[target] if a in known and (a not in linear or a < target)]

    while left:
        # Linear ones are decoded in their order.
        linear = {each.target for each in found}
        new = [
            best
            for target in left
            if (best := best_relation(target, usable(target, linear), columns)) is not None
        ]
        found += new
        # Where nothing follows from what is known, one that most others may follow from.
        root = max(left, key=lambda place: sum(place in near[each] for each in left))
        done = {each.target for each in new} or {root}
        known |= done
        left = [target for target in left if target not in done]
    return found


def sources_of(target: int, looked: Sequence[Doubles]) -> list[int]:
    """The channels that a channel is nearly linear in."""
    y = looked[target]
    if not np.ptp(y):
        return []
    limit = NEAR * float(np.abs(y).max())
    others = [source for source, x in enumerate(looked) if source != target and np.ptp(x)]
    likely = within_reach(y, [looked[source] for source in others], limit)
    return [
        source for source, possible in zip(others, likely, strict=True)
        if possible and left_by(FORMS[-1], y, looked[source]) < limit
    ]  # fmt: skip


def within_reach(y: Doubles, sources: Sequence[Doubles], limit: float) -> list[bool]:
    """Of each source whether a few samples leave it possible that all are within the limit."""
    if not sources:
        return []
    few = slice(0, PROBED + SETTLING)
    rows = np.stack([rows_of(FORMS[-1], y[few], x[few], SETTLING) for x in sources])
    scales = np.abs(rows).max(axis=2, keepdims=True)
    scales[scales == 0] = 1
    basis = np.linalg.svd((rows / scales).transpose(0, 2, 1), full_matrices=False)[0]
    scale = float(np.abs(y).max())
    wanted = y[few][SETTLING:] / scale
    shares = np.einsum("smt,m->st", basis, wanted)
    left = wanted - np.einsum("smt,st->sm", basis, shares)
    within: list[bool] = (np.abs(left).max(axis=1) < limit / scale * PROBED**0.5).tolist()
    return within


def best_relation(
    target: int, sources: Sequence[int], columns: Sequence[Doubles]
) -> Relation | None:
    size = columns[target].size
    part = slice(size // 2, size // 2 + LOOKED_AT)
    y = columns[target][part]
    limit = NEAR * float(np.abs(y).max())
    tried = [
        relation
        for source in sources
        for form in FORMS
        if left_by(form, y, columns[source][part]) < limit
        for relation in relations(form, target, source, columns)
    ]
    best = min(tried, key=lambda each: each.bits, default=None)
    return best if best and best.bits < COSTLY - HOPED else None


def rows_of(form: tuple[int, int], y: Doubles, x: Doubles, start: int) -> Doubles:
    """[terms, samples from ``start`` on]: those that are weighed, and ones."""
    size = y.size
    rows = [y[start - lag : size - lag] for lag in range(1, form[0] + 1)]
    rows += [x[start - lag : size - lag] for lag in range(form[1] + 1)]
    return np.stack([*rows, np.ones(size - start)])


def left_by(form: tuple[int, int], y: Doubles, x: Doubles) -> float:
    """The largest error of the best weights; infinite where no file has room for these."""
    rows = rows_of(form, y, x, SETTLING)
    weights = Weigher(rows)(y[SETTLING:])
    if not (np.abs(weights) < COEFFICIENT_LIMIT).all():
        return inf
    return float(np.abs(y[SETTLING:] - weights @ rows).max())


class Weigher:
    """Least squares by some rows, which are made orthogonal once (modified Gram-Schmidt): threads
    of a BLAS wait longer for each other than this takes."""

    def __init__(self, rows: Doubles) -> None:
        self.scales = np.abs(rows).max(axis=1)
        self.scales[self.scales == 0] = 1
        self.basis = rows / self.scales[:, None]
        self.shares = np.eye(len(rows))
        whole = np.einsum("ij,ij->i", self.basis, self.basis)
        self.energies = np.zeros(len(rows))
        for place, row in enumerate(self.basis):
            energy = float(np.einsum("i,i->", row, row))
            if energy <= DEPENDENT**2 * whole[place]:
                row[:] = 0
                continue
            self.energies[place] = energy
            later = self.basis[place + 1 :]
            shares = np.einsum("ij,j->i", later, row) / energy
            later -= shares[:, None] * row
            self.shares[place, place + 1 :] = shares

    def __call__(self, y: Doubles) -> Doubles:
        """Rows that depend on those before get no weight."""
        scale = float(np.abs(y).max()) or 1.0
        left, weights = y / scale, np.zeros(len(self.basis))
        for place, (row, energy) in enumerate(zip(self.basis, self.energies, strict=True)):
            if energy:
                weights[place] = np.einsum("i,i->", row, left) / energy
                left -= weights[place] * row
        for place in range(len(weights) - 1, -1, -1):
            if self.energies[place]:
                weights[place] -= np.einsum(
                    "i,i->", self.shares[place, place + 1 :], weights[place + 1 :]
                )
        with np.errstate(over="ignore"):
            return np.asarray(weights / self.scales * scale)


def relations(
    form: tuple[int, int], target: int, source: int, columns: Sequence[Doubles]
) -> Iterator[Relation]:
    """With a constant and without."""
    y, x = columns[target], columns[source]
    some = slice(0, REFINED)
    rows, exact = rows_of(form, y[some], x[some], SETTLING), y[some][SETTLING:]
    keys = [(target, lag) for lag in range(1, form[0] + 1)]
    keys += [(source, lag) for lag in range(form[1] + 1)]
    for used in (rows[:-1], rows):
        wide = used.astype(np.longdouble)
        weights = np.zeros(len(used), np.longdouble)
        weigh = Weigher(used)
        for _ in range(ROUNDS):
            left = exact - weights @ wide
            weights = weights + weigh(left.astype(np.float64))
            if not (np.abs(weights) < COEFFICIENT_LIMIT).all():
                break
        numbers = weights.astype(np.float64).tolist()
        if not all(abs(w) < COEFFICIENT_LIMIT for w in numbers):
            continue
        c0 = numbers[-1] if len(numbers) > len(keys) else 0.0
        terms = tuple(LinearTerm(a, lag, w) for (a, lag), w in zip(keys, numbers, strict=False))
        v = predictions(y, c0, terms, columns)
        away = np.abs((ordered(y) - ordered(v)).astype(np.float64))
        yield Relation(target, source, c0, terms, float(np.log2(1 + 2 * away).mean()))


def stretches(relations: Sequence[Relation]) -> list[tuple[int, int]]:
    """The shortest runs of neighbours that no relation leaves."""
    found: list[tuple[int, int]] = []
    for relation in sorted(relations, key=lambda each: min(each.target, each.source)):
        start, stop = sorted((relation.target, relation.source))
        if found and start < found[-1][1]:
            start, stop = found[-1][0], max(found.pop()[1], stop + 1) - 1
        found.append((start, stop + 1))
    return found


def encode_linear(
    channels: Sequence[Channel],
    columns: Sequence[Doubles],
    units: Sequence[Unit],
    relations: Sequence[Relation],
    first_channel: int,
    cluster: Fraction,
) -> Unit | None:
    """One track of neighbouring channels; None where they have no common range of counts."""
    related = {relation.target: relation for relation in relations}
    candidates: list[Candidate] = []
    for place, x in enumerate(columns):
        relation = related.get(place)
        if relation is not None:
            grid = binary_grid(x, GRID_BITS)
            rule = ExactParameters(LINEAR, 0, (relation.c0,), relation.terms)
            candidate = grid and replace(grid, parameters=rule)
        else:
            candidate = candidate_of(units[place], x)
        if candidate is None:
            return None
        candidates.append(candidate)
    counts = np.stack([each.counts for each in candidates], axis=1)
    low, high = declared_range(counts)
    if not all(each.calibration.covers(low, high) for each in candidates):
        low, high = int(counts.min()), int(counts.max())
        if not all(each.calibration.covers(low, high) for each in candidates):
            return None
    described = [
        replace(channel, stored=each.counts, calibration=each.calibration, deviation=None)
        for channel, each in zip(channels, candidates, strict=True)
    ]
    first = channels[0]
    track = make_track(
        described,
        first_channel,
        codec="LPCX",
        parameters=b"".join(each.parameters.build() for each in candidates),
        count_min=low,
        count_max=high,
    )
    coded = Coded(track)
    sizes = np.zeros(len(channels), np.int64)
    at = 0
    for span in cut(first.coverage, first.rate_exact, cluster, (len(channels) + 1) // 2):
        part = slice(at, at + span.ticks)
        at += span.ticks
        try:
            exact = [x[part] for x in columns]
            data, each_size = packet_of(candidates, exact, counts[part])
        except ValueError:
            return None
        coded.packets.append(Packet(0, span.start, span.ticks, data))
        coded.doubles.append(exact)
        sizes += each_size
    last = first_channel + len(channels) - 1
    parts = []
    for place, size in enumerate(sizes.tolist()):
        relation = related.get(place)
        how = f"track of {first_channel}-{last}"
        if relation is not None:
            how += f", linear in {first_channel + relation.source}"
        parts.append((f"bit for bit, {how}", size))
    return Unit(coded, None, "predicted + exact", "bit for bit", exact=True, parts=tuple(parts))


def may_have_counts(unit: Unit, x: Doubles) -> bool:
    """Whether a channel may be in a track of doubles: words of which one is larger than those of a
    binary grid may not. Others do not come near the largest double, where sums overflow."""
    small = float(np.abs(x).max(initial=0.0)) <= EXACT_LIMIT
    return small or unit.base.track.number_format == "counts"


def candidate_of(unit: Unit, x: Doubles) -> Candidate | None:
    """The counts and the rule of a channel alone, as its unit has them. Words have no counts: a
    binary grid gives some, where they are small enough."""
    track = unit.base.track
    if track.number_format != "counts":
        return binary_grid(x)
    affine, counts = track.components[0].calibration, decode_all(unit.base, 1)[:, 0]
    rule = ExactParameters()
    if track.codec == "LPCX":
        rule = ExactParameters.parse(track.parameters, 0)
    return Candidate(Calibration(*affine), counts, rule, "as it is alone")


def packet_of(
    candidates: Sequence[Candidate], columns: Sequence[Doubles], counts: Counts
) -> tuple[bytes, list[int]]:
    """One packet, and how many of its bytes each component takes."""
    indices = [np.ascontiguousarray(counts[:, place]) for place in range(len(candidates))]
    packets = [encode_best(row, thorough=False) for row in indices]
    parts = [
        smallest_exact(lacking_of(x, each.parameters, each.affine, row, columns))
        for x, each, row in zip(columns, candidates, indices, strict=True)
    ]
    coded = join_components(packets)
    sizes = [len(a) + len(b) for a, b in zip(packets, parts, strict=True)]
    rest = join_components(parts) if any(parts) else b""
    return build_varint(len(coded)) + coded + rest, sizes
