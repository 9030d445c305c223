"""LPCR packets of several components, each of which may be predicted from those before it
(SPEC 9.5)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from ..integers import build_varint, parse_varint
from ..kernels import compiled
from ..limits import Level
from .grids import UNIFORM, LpcParameters
from .predicted import (
    Predictor,
    decode_body,
    decode_indices,
    differences,
    encode_indices,
    errors_of,
    parse_header,
)
from .references import TAPS

Indices = NDArray[np.int64]

BLOCK = 1 << 16
"""Ticks whose counts are worked out at once: what that takes is little beside the counts."""

WEIGHT_SHIFT = 6
"""Weights are multiples of 2**-6."""


def prediction_errors(indices: Indices, difference: int, c: list[int], base: int) -> Indices:
    """What a predictor leaves of indices, whatever is coded of them."""
    if compiled is not None:
        plain, out = np.ascontiguousarray(indices), np.empty(indices.size, np.int64)
        limit = max(abs(base), -int(plain.min()), int(plain.max()))
        compiled.lpcr_errors(np.array(c, np.int32), difference, base, limit, plain, out)
        return out
    return errors_of(differences(indices - base, difference), c)


def taps_of(indices: Indices, difference: int, c: list[int]) -> list[Indices]:
    """d of SPEC 9.5 at each of the ``TAPS``, 0 outside the packet."""
    d = prediction_errors(indices, difference, c, int(indices[0]))
    around = np.concatenate(([0], d, [0]))
    return [around[1 + tap : 1 + tap + d.size] for tap in TAPS]


def cross_terms(predictor: Predictor, earlier: Sequence[Indices]) -> Indices | None:
    """x of SPEC 9.5; None where nothing is referred to."""
    if not predictor.references:
        return None
    c = predictor.coefficients or []
    total = np.zeros(earlier[0].size, np.int64)
    for component, weights in predictor.references:
        taps = taps_of(earlier[component], predictor.difference, c)
        for weight, tap in zip(weights, taps, strict=True):
            if weight:
                total += weight * tap
    return (total + (1 << (WEIGHT_SHIFT - 1))) >> WEIGHT_SHIFT


def split_components(data: bytes, count: int, offset: int) -> list[tuple[int, int]]:
    """Where each component packet begins and ends."""
    found = parts_of(data, count, offset)
    if found is None:
        raise FormatError(
            "component packets larger than their packet", requirement="LPC-001", offset=offset
        )
    return found


def parts_of(data: bytes, count: int, offset: int) -> list[tuple[int, int]] | None:
    """Where parts begin and end whose sizes, but that of the last, stand before them; None where
    they do not fit."""
    sizes, position = [], 0
    for _ in range(count - 1):
        size, position = parse_varint(data, position, offset)
        sizes.append(size)
    if sum(sizes) > len(data) - position:
        return None
    ends = [position + sum(sizes[: place + 1]) for place in range(count - 1)] + [len(data)]
    return list(zip([position, *ends], ends, strict=False))


def join_components(packets: Sequence[bytes]) -> bytes:
    return b"".join([*(build_varint(len(packet)) for packet in packets[:-1]), *packets])


def encode_component(indices: Indices, predictor: Predictor, earlier: Sequence[Indices]) -> bytes:
    """A component packet; ValueError as in ``encode_indices``."""
    return encode_indices(indices, predictor, cross_terms(predictor, earlier))


def decode_predicted(
    data: bytes, parameters: LpcParameters, span: int, count: int, level: Level, offset: int
) -> Indices:
    """The packet ``data``, which stands at ``offset``, as counts [span, components]."""
    limit = parameters.index_limit(level.count_bound)
    out = np.empty((span, count), np.int64)
    for place, indices in enumerate(decode_components(data, span, count, limit, offset)):
        out[:, place] = parameters.counts(indices, level.count_bound)
    return out


def decode_components(data: bytes, span: int, count: int, limit: int, offset: int) -> list[Indices]:
    """The indices of each component."""
    if count == 1:
        return [decode_indices(data, span, limit, offset)]
    earlier: list[Indices] = []
    for start, end in split_components(data, count, offset):
        part, at = data[start:end], offset + start
        predictor, constant, position = parse_header(part, at, len(earlier))
        c = None if constant else predictor.coefficients
        cross = None if c is None else cross_terms(predictor, earlier)
        earlier.append(decode_body(part, predictor, constant, position, span, limit, at, cross))
    return earlier


def decode_within(
    data: bytes,
    parameters: LpcParameters,
    span: int,
    count: int,
    level: Level,
    offset: int,
    low: int,
    high: int,
) -> NDArray[np.int32]:
    """``decode_predicted``, clamped to the declared range (DEC-001)."""
    bound = level.count_bound
    rows = decode_components(data, span, count, parameters.index_limit(bound), offset)
    out = np.empty((span, count), np.int32)
    if compiled is not None and parameters.grid == UNIFORM and count == 1:
        compiled.clamp_counts(rows[0], parameters.step, parameters.zero, low, high, out)
        return out
    for place, indices in enumerate(rows):
        for first in range(0, span, BLOCK):
            counts = parameters.counts(indices[first : first + BLOCK], bound)
            out[first : first + BLOCK, place] = np.clip(counts, low, high)
    return out
