"""MDCT: a lapped transform, two quantisers in turn, entropy coding (SPEC 9.8).

kernels/transform.c implements the same in C. All sums stay below 2**53. So float64 is exact in any
order, and the transform of all blocks is one product of matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..kernels import compiled
from ..limits import Level
from ..numbers import build_svarint, build_varint, clamp, parse_svarint, parse_varint, rdiv
from .entropy import (
    ERROR_BITS,
    START_MOST,
    Averages,
    Decoder,
    Encoder,
    context_of,
    ends_of,
    put_rest,
    share_of,
    symbol_of,
)
from .predicted import split_components

Doubles = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCKS = (32, 64, 128, 256, 512)
"""Coefficients of a block."""

UNIT = 256
"""Steps and coefficients are counted in 256ths of a count."""

STEP_LIMIT = 1 << 32
WEIGHTS_LIMIT = 128
WEIGHT_ONE = 32
SUM_LIMIT = 1 << 36
"""The magnitudes of a block's coefficients together."""

QUARTER = 1024
"""Steps of the table of cosines from 1 to 0."""

COSINE_BITS = 15
"""A cosine of 1 is 2**15."""

NEXT = ((0, 2), (5, 7), (1, 3), (4, 6), (2, 0), (7, 5), (3, 1), (6, 4))
"""The state after an even and after an odd magnitude. The quantiser is the lowest bit of a state.
No linear table of eight states has a smaller error at high rates."""

STATUS = {
    2: ("RNG-003", "a magnitude of 2^34 or more"),
    4: ("RNG-001", "the coded bytes do not end with their packet"),
    8: ("MDC-003", "a block of too large coefficients"),
}
"""What the compiled loop returns, as the readable one says it."""


@lru_cache(1)
def cosines() -> Integers:
    """C(i) of SPEC 9.8 for i = 0 ... 4095, one period."""
    angles = np.arange(QUARTER + 1) * (np.pi / (2 * QUARTER))
    quarter = np.floor(np.cos(angles) * (1 << COSINE_BITS) + 0.5).astype(np.int64)
    half = np.concatenate((quarter, -quarter[-2::-1]))
    return np.concatenate((half[:-1], half[:0:-1]))


@lru_cache(len(BLOCKS))
def waves(size: int) -> Doubles:
    """[coefficient, sample]: what a coefficient of 1 adds to each sample, times 2**15."""
    odd = 2 * np.arange(size) + 1
    places = np.outer(odd, odd) * (QUARTER // 2 // size) % (4 * QUARTER)
    return cosines()[places].astype(np.float64)


@lru_cache(len(BLOCKS))
def tiles(size: int) -> Doubles:
    """The same [sample / 16, coefficient, sample % 16], as the compiled loop goes through it."""
    return np.ascontiguousarray(waves(size).reshape(size, size // 16, 16).transpose(1, 0, 2))


@lru_cache(len(BLOCKS))
def pairs(size: int) -> NDArray[np.int16]:
    """The same [sample / 16, coefficient / 2, sample % 16, coefficient % 2], at most 32767, for
    products of 16 bits."""
    small = np.minimum(waves(size), 32767).astype(np.int16)
    return np.ascontiguousarray(small.reshape(size // 2, 2, size // 16, 16).transpose(2, 0, 3, 1))


@lru_cache(len(BLOCKS))
def window(size: int) -> Integers:
    """[2, size / 2]: w and z of the samples on one side of a boundary."""
    odd = (2 * np.arange(size // 2) + 1) * (QUARTER // 2 // size)
    half = QUARTER // 2
    return np.ascontiguousarray(cosines()[np.stack((half - odd, half + odd))])


def inverse(coefficients: Doubles) -> Integers:
    """Samples [blocks * size] of coefficients [blocks, size], which are whole numbers."""
    blocks, size = coefficients.shape
    v = (coefficients @ waves(size)).astype(np.int64)
    v += 1 << (COSINE_BITS - 1)
    v >>= COSINE_BITS
    w, z = window(size)
    right, left = v[1:, : size // 2], v[:-1, : size // 2 - 1 : -1]
    x = (v + UNIT // 2) // UNIT
    x[1:, : size // 2] = (w * right - z * left + (1 << 22)) >> 23
    x[:-1, : size // 2 - 1 : -1] = (w * left + z * right + (1 << 22)) >> 23
    return x.reshape(blocks * size)


@dataclass(frozen=True)
class TransformParameters:
    """Size of a block, step in 256ths of a count, and 32 times the factor on it in each band."""

    size: int
    step: int
    weights: bytes = b""

    def build(self) -> bytes:
        head = bytes([self.size.bit_length() - 1]) + build_varint(self.step)
        return head + bytes([len(self.weights)]) + self.weights

    @classmethod
    def parse(cls, data: bytes, offset: int) -> TransformParameters:
        if not data:
            raise TruncatedError("no size of blocks", requirement="COD-002", offset=offset)
        step, position = parse_varint(data, 1, offset)
        count = data[position] if position < len(data) else 0
        weights = data[position + 1 : position + 1 + count]
        size = 1 << data[0] if data[0] < 16 else 0
        fits = size in BLOCKS and 0 < step <= STEP_LIMIT
        if not fits or count & (count - 1) or count > min(size, WEIGHTS_LIMIT):
            raise FormatError(
                "a transform that is not defined", requirement="MDC-001", offset=offset
            )
        if position + 1 + count != len(data):
            raise FormatError(
                "weights missing, or bytes after them", requirement="COD-002", offset=offset
            )
        return cls(size, step, weights)

    @cached_property
    def steps(self) -> Integers:
        """The step of each coefficient."""
        count = len(self.weights) or 1
        weights = self.weights or bytes([WEIGHT_ONE])
        each = [max(1, rdiv(self.step * weight, WEIGHT_ONE)) for weight in weights]
        return np.repeat(np.array(each, np.int64), self.size // count)


@dataclass
class Neighbours:
    """Magnitudes around the coefficient that is next, times 256 (SPEC 9.8)."""

    before: list[int]
    """Those of the block before."""

    mean: list[int]
    """Their averages over all blocks before."""

    @classmethod
    def start(cls, start: int, count: int) -> Neighbours:
        mean = Averages.start(start).f
        return cls([mean] * count, [mean] * count)

    def around(self) -> list[int]:
        """What the blocks before say of each coefficient, times 32."""
        p, last = self.before, len(self.before) - 1
        return [
            4 * p[k] + 3 * (p[max(k - 1, 0)] + p[min(k + 1, last)]) + 10 * mean
            for k, mean in enumerate(self.mean)
        ]

    def learn(self, magnitudes: Sequence[int]) -> None:
        self.before = [256 * u for u in magnitudes]
        self.mean = [e + (p - e) // 4 for e, p in zip(self.mean, self.before, strict=True)]


def level_of(magnitude: int, quantiser: int) -> int:
    """The magnitude of a coefficient in steps."""
    return max(2 * magnitude - quantiser, 0)


def decode_coefficients(
    data: bytes, steps: Sequence[int], classes: int, start: int, out: Doubles, offset: int
) -> None:
    """Fills ``out`` [blocks, size] as far as there are steps. The readable loop: kernels/ has the
    same in C, with the transform."""
    coder = Decoder(data, offset, 1)
    near, state = Neighbours.start(start, len(steps)), 0
    for row in out:
        a1 = a2 = near.mean[0]
        magnitudes: list[int] = []
        total = 0
        for k, around in enumerate(near.around()):
            context, h = context_of((8 * a1 + 4 * a2 + around) // 32)
            quantiser = state & 1
            symbol = coder.symbol(ends_of(classes >> 4 * quantiser & 15, context))
            u = coder.magnitude(symbol, h)
            negative = u and coder.raw(1)
            coder.check()
            x = level_of(u, quantiser) * steps[k]
            total += x
            if total > SUM_LIMIT:
                raise FormatError(
                    "a block of too large coefficients", requirement="MDC-003", offset=coder.place
                )
            row[k] = -x if negative else x
            state = NEXT[state][u & 1]
            a1, a2 = 256 * u, a1
            magnitudes.append(u)
        near.learn(magnitudes)
    coder.finish()


class TransformHeader(NamedTuple):
    """The head of a component packet: base, coded coefficients of each block, the class of each
    quantiser (four bits each), and the start byte."""

    base: int
    kept: int
    classes: int = 0
    start: int = 0

    def build(self) -> bytes:
        head = build_svarint(self.base) + build_varint(self.kept)
        return head + bytes([self.classes, self.start]) if self.kept else head


def parse_header(data: bytes, size: int, level: Level, offset: int) -> tuple[TransformHeader, int]:
    """The header, and where the coded bytes begin."""
    base, position = parse_svarint(data, 0, offset)
    count, position = parse_varint(data, position, offset)
    if abs(base) > level.count_bound or count > size:
        raise FormatError(
            "a base or a number of coefficients beyond its bound",
            requirement="MDC-002",
            offset=offset,
        )
    if not count:
        if position != len(data):
            raise FormatError(
                "bytes left over after a constant", requirement="COD-001", offset=offset + position
            )
        return TransformHeader(base, 0), position
    if len(data) < position + 2 or data[position + 1] > START_MOST:
        raise FormatError(
            "a coding that is not defined", requirement="RNG-004", offset=offset + position
        )
    return TransformHeader(base, count, data[position], data[position + 1]), position + 2


def decode_component(
    data: bytes,
    parameters: TransformParameters,
    level: Level,
    offset: int,
    low: int,
    high: int,
    out: NDArray[np.int32],
) -> None:
    """Fills ``out`` [span] with counts, clamped to the declared range."""
    size = parameters.size
    (base, count, classes, start), position = parse_header(data, size, level, offset)
    if not count:
        out[:] = clamp(base, low, high)
        return
    coded, at, steps = data[position:], offset + position, parameters.steps[:count]
    if compiled is not None:
        status, taken = compiled.mdct_decode(
            coded, tiles(size), pairs(size), window(size), steps, classes, start,
            base, low, high, out,
        )  # fmt: skip
        if status:
            requirement, message = STATUS[status]
            place = at + min(taken, len(coded))
            raise FormatError(message, requirement=requirement, offset=place)
        return
    coefficients = np.zeros((-(-out.size // size), size))
    decode_coefficients(coded, steps.tolist(), classes, start, coefficients, at)
    out[:] = np.clip(base + inverse(coefficients)[: out.size], low, high)


def decode_within(
    data: bytes,
    parameters: TransformParameters,
    span: int,
    count: int,
    level: Level,
    offset: int,
    low: int,
    high: int,
) -> NDArray[np.int32]:
    """The packet ``data`` at ``offset``, as counts [span, components] in the declared range."""
    rows = np.empty((count, span), np.int32)
    for row, (start, end) in zip(rows, split_components(data, count, offset), strict=True):
        decode_component(data[start:end], parameters, level, offset + start, low, high, row)
    return np.ascontiguousarray(rows.T)


def encode_component(base: int, levels: Integers, classes: int, start: int) -> bytes:
    """A component packet. levels [blocks, coded coefficients]: the magnitude of each coefficient,
    as its quantiser has it, with its sign."""
    head = TransformHeader(base, levels.shape[1], classes, start).build()
    return head + encode_levels(levels, classes, start) if levels.shape[1] else head


def encode_levels(levels: Integers, classes: int, start: int) -> bytes:
    """The coded bytes; ValueError where a magnitude has 34 bits and more."""
    if np.abs(levels).max(initial=0) >> ERROR_BITS:
        raise ValueError("a magnitude of 2^34 or more")
    if compiled is not None:
        plain, count = np.ascontiguousarray(levels, np.int64), levels.shape[1]
        out = bytearray(2 * levels.size + 64)
        size = compiled.mdct_encode(plain, count, classes, start, out)
        if size > len(out):
            out = bytearray(size)
            compiled.mdct_encode(plain, count, classes, start, out)
        return bytes(out[:size])
    coder = Encoder(many_pay=False)
    shares: list[tuple[int, int]] = []
    near, state = Neighbours.start(start, levels.shape[1]), 0
    for row in levels.tolist():
        a1 = a2 = near.mean[0]
        for value, around in zip(row, near.around(), strict=True):
            context, h = context_of((8 * a1 + 4 * a2 + around) // 32)
            u = abs(value)
            symbol = symbol_of(u, h)
            shares.append(share_of(ends_of(classes >> 4 * (state & 1) & 15, context), symbol))
            put_rest(coder, u, symbol, h)
            if u:
                coder.raw(int(value < 0), 1)
            state = NEXT[state][u & 1]
            a1, a2 = 256 * u, a1
        near.learn([abs(value) for value in row])
    coder.section(shares)
    return coder.finish()
