"""MDCT: coefficients, the trellis that quantises them, and packets at a given step (SPEC 9.8).

The trellis finds for each block the magnitudes of the least error plus weighted bits. The bits are
those of the real contexts, so each of the eight states carries the two magnitudes before it. Errors
and costs are integers: kernels/trellis.c finds the same magnitudes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..codecs.entropy import (
    CLASSES,
    CONTEXTS,
    EDGES,
    ESCAPE,
    EXTRA,
    SYMBOLS,
    context_of,
    costs_of,
    symbol_of,
)
from ..codecs.predicted import join_components
from ..codecs.transform import (
    NEXT,
    SUM_LIMIT,
    UNIT,
    Neighbours,
    TransformParameters,
    encode_component,
    level_of,
)
from ..format.cluster import Packet
from ..format.track import Track
from ..kernels import compiled
from ..recording import Span
from .knots import Coded

Doubles = NDArray[np.float64]
Integers = NDArray[np.int64]

SCALE = 256
"""Coefficients of the trellis are in 256ths of their steps."""

LAMBDA = 128
"""256 times what a bit counts for, in squares of the step. The rate at equal quality is flat within
1 % from 110 to 150."""

STARTS = (0xD2, 0xD0, 0xE2, 0x24, 0xD8)
"""Classes of both quantisers that the trellis is tried with: what it finds in one pair suits that
pair, so that other pairs are not found from there. The best of these costs 0.2 % more than the best
of all 256 pairs (seven recordings at 10 to 30 dB)."""

SAMPLE, SAMPLE_SHARE, RUN = 1024, 16, 4
"""The classes are chosen by about as many coefficients, or one in 16, in runs of four blocks: 0.3 %
larger than by all (451 packets)."""

KEPT = SCALE
"""A column is coded where a coefficient is as large."""

ROUNDS = 2
"""Most often that the classes are chosen again by what the trellis found."""

FARTHEST = 1 << 42
"""Targets of the trellis lie below."""


def forward(x: Doubles, size: int) -> Doubles:
    """Coefficients [blocks, size] of samples in counts, in 256ths of a count: what ``inverse`` of
    codecs/transform.py makes the samples of. Where the last block is not full, the last sample
    fades to 0."""
    lacking = -x.size % size
    fade = 0.5 + 0.5 * np.cos(np.pi * (np.arange(lacking) + 1) / max(lacking, 1))
    rows = np.concatenate((x, x[-1] * fade)).reshape(-1, size)
    half = size // 2
    angle = (np.arange(half) + half + 0.5) * (np.pi / (2 * size))
    w, z = np.sin(angle), np.cos(angle)
    right, left = rows[1:, :half].copy(), rows[:-1, : half - 1 : -1].copy()
    rows[1:, :half] = w * right + z * left
    rows[:-1, : half - 1 : -1] = w * left - z * right
    # The inverse of the sum is itself times 2 / size.
    return cosine_sums(rows) * (2 * UNIT / size)


def cosine_sums(rows: Doubles) -> Doubles:
    """The cosine transform of type 4 of each row, by a Fourier transform of half the length."""
    size = rows.shape[1]
    turn = np.exp(-1j * np.pi / size * np.arange(size // 2))
    quarter = np.exp(-0.25j * np.pi / size)
    found = np.fft.fft((rows[:, ::2] + 1j * rows[:, ::-2]) * (turn * quarter), axis=1) * turn
    out = np.empty_like(rows)
    out[:, ::2], out[:, ::-2] = found.real, -found.imag
    return out


class Quantised(NamedTuple):
    """What the trellis chose: magnitudes [blocks, coefficients], how often each symbol came [2,
    contexts, symbols], the squares of all errors, and 256 times the bits."""

    magnitudes: Integers
    seen: Integers
    errors: int
    bits: int

    def cost(self, weight: int) -> int:
        return self.errors + weight * self.bits


def trellis(scaled: Integers, classes: int, start: int, weight: int = LAMBDA) -> Quantised:
    """scaled [blocks, coefficients]: magnitudes in 256ths of their steps, below 2**40."""
    magnitudes = np.zeros(scaled.shape, np.int64)
    seen = np.zeros((2, CONTEXTS, SYMBOLS), np.int64)
    if compiled is not None:
        plain = np.ascontiguousarray(scaled, np.int64)
        spent = compiled.mdct_trellis(
            plain, scaled.shape[1], classes, start, weight, magnitudes, seen
        )
        return Quantised(magnitudes, seen, *spent)
    near, state, errors, bits = Neighbours.start(start, scaled.shape[1]), 0, 0, 0
    for t, row in enumerate(scaled.tolist()):
        chosen, state, error, more = quantise_block(row, near, state, classes, weight, seen)
        magnitudes[t] = chosen
        errors += error
        bits += more
        near.learn(chosen)
    return Quantised(magnitudes, seen, errors, bits)


Path = tuple[int, "Path"] | tuple[()]
"""The last magnitude, and those before it."""


class Survivor(NamedTuple):
    """The best way into a state: its cost, the two magnitudes before times 256, and all of them."""

    cost: int
    a1: int
    a2: int
    path: Path = ()


def quantise_block(
    row: Sequence[int],
    near: Neighbours,
    state: int,
    classes: int,
    weight: int,
    seen: Integers,
) -> tuple[list[int], int, int, int]:
    """Magnitudes of a block, the state after it, squared errors, and 256 times the bits."""
    around, mean = near.around(), near.mean[0]
    chosen = [0] * len(row)
    if max(row) >= SCALE // 2:
        ways: list[Survivor | None] = [None] * len(NEXT)
        ways[state] = Survivor(0, mean, mean)
        for target, beside in zip(row, around, strict=True):
            after: list[Survivor | None] = [None] * len(NEXT)
            tried = [
                [(u, (target - SCALE * level_of(u, q)) ** 2) for u in candidates(target, q)]
                for q in (0, 1)
            ]
            for s, way in enumerate(ways):
                if way is None:
                    continue
                before, a1, a2, path = way
                context, h = context_at((8 * a1 + 4 * a2 + beside) // 32)
                quantiser = classes >> 4 * (s & 1) & 15
                for u, error in tried[s & 1]:
                    cost = before + error + weight * bits_of(quantiser, context, h, u)
                    to = NEXT[s][u & 1]
                    best = after[to]
                    if best is None or cost < best[0]:
                        after[to] = Survivor(cost, 256 * u, a1, (u, path))
            ways = after
        path = min((way for way in ways if way), key=lambda way: way.cost).path
        for place in reversed(range(len(row))):
            chosen[place], path = path  # type: ignore[misc]
    a1 = a2 = mean
    errors = total = 0
    for target, u, beside in zip(row, chosen, around, strict=True):
        context, h = context_at((8 * a1 + 4 * a2 + beside) // 32)
        seen[state & 1, context, symbol_of(u, h)] += 1
        total += bits_of(classes >> 4 * (state & 1) & 15, context, h, u)
        errors += (target - SCALE * level_of(u, state & 1)) ** 2
        state = NEXT[state][u & 1]
        a1, a2 = 256 * u, a1
    return chosen, state, errors, total


context_at = lru_cache(1 << 16)(context_of)


def candidates(target: int, quantiser: int) -> list[int]:
    """Magnitudes worth trying: on both sides, one less, and 0 if that is not far."""
    low = (target + SCALE * quantiser) // (2 * SCALE)
    out = [low, low + 1]
    if low > 0:
        out.append(low - 1)
    if low == 2:
        out.append(0)
    return out


@lru_cache(1 << 16)
def bits_of(quantiser: int, context: int, h: int, u: int) -> int:
    """256 times the bits of a magnitude in a context: its symbol, raw bits, and sign."""
    k = symbol_of(u, h)
    escape = 5 + ((u >> h) - EDGES[ESCAPE] + 1).bit_length()
    rest = h + (EXTRA[k] if k < ESCAPE else escape) + (u > 0)
    return costs_of(quantiser)[SYMBOLS * context + k] + 256 * rest


@lru_cache(1)
def class_costs() -> Integers:
    """[class, contexts * symbols]: 256 times the bits."""
    return np.array([costs_of(n) for n in range(CLASSES)], np.int64)


def best_classes(seen: Integers) -> int:
    """The class of each quantiser that codes these symbols in the fewest bits."""
    costs = (class_costs() * seen.reshape(2, 1, -1)).sum(axis=2)
    first, second = costs.argmin(axis=1).tolist()
    return int(first | second << 4)


def start_byte(scaled: Integers) -> int:
    """For an average that is half of the first block's."""
    mean = min(int(scaled[0].mean()) // 4, 1 << 42)
    lg = mean.bit_length() - 1
    return 4 * (lg - 2) + (mean >> (lg - 2)) % 4 if mean >= 4 else 0


def encode_row(x: Doubles, parameters: TransformParameters, weight: int = LAMBDA) -> bytes:
    """The component packet of samples in counts. ValueError where a coefficient is too large."""
    base = int(np.floor(np.median(x) + 0.5))
    return encode_coefficients(base, forward(x - base, parameters.size), parameters, weight)


def encode_coefficients(
    base: int, coefficients: Doubles, parameters: TransformParameters, weight: int = LAMBDA
) -> bytes:
    """The same for samples whose coefficients are known."""
    classes = sampled(coefficients, parameters.steps, weight).classes
    found = quantise(coefficients, parameters.steps, classes, weight)
    return encode_component(base, found.levels, found.classes, found.start)


class Levels(NamedTuple):
    """Magnitudes [blocks, coded coefficients] with their signs, and how they are coded. errors: the
    squares of all errors, in squares of the step."""

    levels: Integers
    classes: int
    start: int
    errors: float


def targets_of(coefficients: Doubles, steps: Integers) -> Integers:
    """Magnitudes in 256ths of their steps."""
    exact = np.abs(coefficients) * (SCALE / steps)
    if not float(exact.max(initial=0.0)) < FARTHEST:
        raise ValueError(TOO_LARGE)
    return np.rint(exact).astype(np.int64)


def quantise(coefficients: Doubles, steps: Integers, classes: int, weight: int = LAMBDA) -> Levels:
    """What the trellis finds with these classes; and the classes that suit it."""
    whole = targets_of(coefficients, steps)
    scaled = kept_part(whole, KEPT)
    if not scaled.size:
        return Levels(scaled, 0, 0, float(np.square(whole / SCALE).sum()))
    start = start_byte(scaled)
    found = trellis(scaled, classes, start, weight)
    magnitudes = kept_part(found.magnitudes, 1)
    while 0 < magnitudes.shape[1] < scaled.shape[1]:
        # A coefficient of 0 changes the state too: without the last ones, the states are others.
        scaled = scaled[:, : magnitudes.shape[1]]
        found = trellis(scaled, classes, start, weight)
        magnitudes = kept_part(found.magnitudes, 1)
    kept = magnitudes.shape[1]
    if float((2.0 * magnitudes * steps[:kept]).sum(axis=1).max()) > SUM_LIMIT:
        raise ValueError(TOO_LARGE)
    signed = np.where(coefficients[:, :kept] < 0, -magnitudes, magnitudes)
    dropped = float(np.square(whole[:, scaled.shape[1] :] / SCALE).sum())
    errors = found.errors / SCALE**2 + dropped
    return Levels(signed, best_classes(found.seen), start, errors)


class Sampled(NamedTuple):
    """Some of the blocks, the best classes for them, their squared errors in squares of the step,
    and their bits."""

    rows: Doubles
    classes: int
    errors: float
    bits: float


def sampled(coefficients: Doubles, steps: Integers, weight: int = LAMBDA) -> Sampled:
    """What the trellis finds in some of the blocks."""
    size = max(SAMPLE, coefficients.size // SAMPLE_SHARE)
    count = max(size // coefficients.shape[1], RUN)
    bits = np.log2(1 + np.abs(coefficients) / steps).sum(axis=1)
    rows = coefficients[sample_of(bits, count)]
    whole = targets_of(rows, steps)
    scaled = kept_part(whole, KEPT)
    dropped = float(np.square(whole[:, scaled.shape[1] :] / SCALE).sum())
    if not scaled.size:
        return Sampled(rows, STARTS[0], dropped, 0.0)
    start = start_byte(scaled)
    tried = {classes: trellis(scaled, classes, start, weight) for classes in STARTS}
    classes = min(tried, key=lambda each: tried[each].cost(weight))
    for _ in range(ROUNDS):
        other = best_classes(tried[classes].seen)
        if other not in tried:
            tried[other] = trellis(scaled, other, start, weight)
        if tried[other].cost(weight) >= tried[classes].cost(weight):
            break
        classes = other
    found = tried[classes]
    return Sampled(rows, classes, dropped + found.errors / SCALE**2, found.bits / 256)


def sample_of(bits: Doubles, count: int) -> NDArray[np.intp]:
    """Places of at most ``count`` blocks, in runs of neighbours that take as many bits each."""
    if bits.size <= count:
        return np.arange(bits.size)
    starts = np.arange(0, bits.size, RUN)
    sums = np.add.reduceat(bits, starts).cumsum()
    runs = count // RUN
    found = np.unique(np.searchsorted(sums, (np.arange(runs) + 0.5) / runs * sums[-1]))
    places = starts[np.minimum(found, starts.size - 1), None] + np.arange(RUN)
    return np.asarray(places[places < bits.size])


def kept_part(rows: Integers, least: int) -> Integers:
    """The columns up to the last one in which a number is as large as ``least``."""
    columns = np.flatnonzero((rows >= least).any(axis=0))
    return rows[:, : int(columns[-1]) + 1 if columns.size else 0]


TOO_LARGE = "coefficients beyond 2^36"


def code_transform(
    track: Track,
    parameters: TransformParameters,
    pieces: Iterable[tuple[Span, NDArray[np.int64]]],
    weight: int = LAMBDA,
) -> Coded | None:
    """The track by MDCT. pieces: counts [ticks, components] of each packet. None where they are too
    large for the codec."""
    coded = Coded(replace(track, codec="MDCT", parameters=parameters.build()))
    for span, rows in pieces:
        try:
            parts = [encode_row(row, parameters, weight) for row in rows.T.astype(np.float64)]
        except ValueError:
            return None
        coded.packets.append(Packet(0, span.start, span.ticks, join_components(parts)))
    return coded
