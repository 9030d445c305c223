"""KNOT with adaptive coding: gaps and differences of knots, entropy coded (SPEC 9.6)."""

from __future__ import annotations

from array import array

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from ..integers import build_svarint, build_varint, parse_varint
from ..kernels import compiled
from ..limits import Level
from .adaptive import BitModel, RangeDecoder, RangeEncoder
from .grids import levels_of
from .knots import Interpolation, KnotParameters, interpolate
from .predicted import INDEX_LIMIT, NO_ROOM, check_index

GAP_BITS = 24
"""A gap of 2^24 ticks is the longest within a packet of any level."""

VALUE_BITS = 34
"""Two indices of at most 2^32 differ by no more."""

NO_KNOTS = "ticks that do not ascend, or a gap beyond 2^24, or an index beyond 2^32"
"""What an encoder must not ask for."""

STATUS = {
    3: ("LPC-003", "index beyond the grid"),
    4: ("RNG-001", "the coded bits do not end with their packet"),
    7: ("KTE-003", "a gap or a difference too long"),
    8: ("KTE-004", "more knots than the ticks left"),
}
"""What the compiled loop returns, as the readable one says it."""


class Magnitude:
    """Non-negative integers: how many bits they have, in unary, then the bits below the highest."""

    def __init__(self, most: int) -> None:
        self.lengths = [BitModel() for _ in range(most + 1)]
        self.seconds = [BitModel() for _ in range(most + 1)]

    def encode(self, coder: RangeEncoder, u: int) -> None:
        size = u.bit_length()
        for i in range(size):
            coder.bit(1, self.lengths[i])
        coder.bit(0, self.lengths[size])
        if size > 1:
            coder.bit(u >> (size - 2) & 1, self.seconds[size])
            coder.raw(u & ((1 << (size - 2)) - 1), size - 2)

    def decode(self, coder: RangeDecoder) -> int:
        size = 0
        while coder.bit(self.lengths[size]):
            size += 1
            if size == len(self.lengths):
                raise FormatError(
                    "a gap or a difference too long", requirement="KTE-003", offset=coder.place
                )
        if size < 2:
            return size
        second = coder.bit(self.seconds[size])
        return (2 | second) << (size - 2) | coder.raw(size - 2)


class KnotModel:
    """All bit models of a packet: gaps, magnitudes of differences, and their signs."""

    def __init__(self, components: int) -> None:
        self.gaps, self.magnitudes = Magnitude(GAP_BITS), Magnitude(VALUE_BITS)
        self.signs = [BitModel() for _ in range(3)]
        self.last = [0] * components
        """The sign of the last difference of each component."""

    def encode(self, coder: RangeEncoder, component: int, e: int) -> None:
        self.magnitudes.encode(coder, abs(e))
        if e:
            coder.bit(int(e < 0), self.signs[self.last[component] + 1])
        self.last[component] = (e > 0) - (e < 0)

    def decode(self, coder: RangeDecoder, component: int) -> int:
        u = self.magnitudes.decode(coder)
        e = -u if u and coder.bit(self.signs[self.last[component] + 1]) else u
        self.last[component] = (e > 0) - (e < 0)
        return e


def encode_knots(
    ticks: NDArray[np.int64], indices: NDArray[np.int64], interpolation: Interpolation
) -> bytes:
    """The packet: ticks [knots] with ticks[0] = 0, indices [knots, components].

    Linear with more than one knot: the last tick is that of the packet.
    """
    head = b"".join(build_svarint(index) for index in indices[0].tolist())
    further = ticks.size - 1
    if not further:
        return head
    gaps = np.diff(ticks)
    far = max(-int(indices.min()), int(indices.max())) > INDEX_LIMIT
    if gaps.min() < 1 or gaps.max() > 1 << GAP_BITS or far:
        raise ValueError(NO_KNOTS)
    loop = encode_loop if compiled is None else encode_compiled
    return head + build_varint(further) + loop(ticks, indices, interpolation)


def encode_loop(
    ticks: NDArray[np.int64], indices: NDArray[np.int64], interpolation: Interpolation
) -> bytes:
    """The coded bytes; kernels/ has the same in C."""
    coder, model = RangeEncoder(), KnotModel(indices.shape[1])
    gaps, steps = np.diff(ticks).tolist(), np.diff(indices, axis=0).tolist()
    for number, (gap, row) in enumerate(zip(gaps, steps, strict=True), 1):
        if interpolation == "hold" or number < len(gaps):
            model.gaps.encode(coder, gap - 1)
        for component, e in enumerate(row):
            model.encode(coder, component, e)
    return coder.finish()


def encode_compiled(
    ticks: NDArray[np.int64], indices: NDArray[np.int64], interpolation: Interpolation
) -> bytes:
    """``encode_loop``, in C; a packet that does not fit its buffer is written once more."""
    assert compiled is not None
    plain = np.ascontiguousarray(ticks), np.ascontiguousarray(indices)
    size, status = 2 * (ticks.size + indices.size) + 64, NO_ROOM
    while status == NO_ROOM:
        out = bytearray(size)
        status, size = compiled.coded_knots_encode(*plain, interpolation == "linear", out)
    if status:
        raise ValueError(NO_KNOTS)
    return bytes(out[:size])


def parse_start(
    data: bytes, span: int, components: int, limit: int, offset: int
) -> tuple[list[int], int, int]:
    """Indices of the first knot, how many knots follow it, and where the coded bytes begin."""
    position, row = 0, []
    for _ in range(components):
        number, position = parse_varint(data, position, offset)
        row.append(number >> 1 if number % 2 == 0 else -(number >> 1) - 1)
        check_index(row[-1], limit, offset)
    if position == len(data):
        return row, 0, position
    further, coded = parse_varint(data, position, offset)
    if not 0 < further < span:
        raise FormatError(
            "more knots than ticks, or none", requirement="KTE-002", offset=offset + position
        )
    return row, further, coded


def decode_indices(
    data: bytes, interpolation: Interpolation, span: int, components: int, limit: int, offset: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Ticks [knots], and indices [knots, components] of a magnitude of at most ``limit``."""
    row, further, coded = parse_start(data, span, components, limit, offset)
    # Eight bytes a number, taken as knots are found: a hostile packet may promise many.
    ticks, rows = array("q", [0]), array("q", row)
    if not further:
        return knot_table(ticks, rows)
    coder, model = RangeDecoder(data[coded:], offset + coded), KnotModel(components)
    linear = interpolation == "linear"
    for left in range(further - 1, -1, -1):
        if linear and not left:
            tick = span - 1
        else:
            tick = ticks[-1] + model.gaps.decode(coder) + 1
            # Each of those that follow needs a tick too.
            if tick >= span - left:
                raise FormatError(
                    "more knots than the ticks left", requirement="KTE-004", offset=coder.place
                )
        row = [index + model.decode(coder, i) for i, index in enumerate(row)]
        for index in row:
            check_index(index, limit, coder.place)
        ticks.append(tick)
        rows.extend(row)
        coder.check()
    coder.finish()
    return knot_table(ticks, rows)


def knot_table(ticks: array[int], rows: array[int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Both as NumPy has them."""
    return np.array(ticks, np.int64), np.array(rows, np.int64).reshape(len(ticks), -1)


def decode_coded_knots(
    data: bytes,
    parameters: KnotParameters,
    span: int,
    components: int,
    level: Level,
    offset: int,
) -> NDArray[np.int64]:
    """The packet ``data``, which stands at ``offset``, as counts [span, components]."""
    grid, bound = parameters.grid, level.count_bound
    limit = grid.index_limit(bound)
    ticks, rows = decode_indices(data, parameters.interpolation, span, components, limit, offset)
    return interpolate(ticks, grid.counts(rows, bound), span, parameters.interpolation)


def decode_within(
    data: bytes,
    parameters: KnotParameters,
    span: int,
    components: int,
    level: Level,
    offset: int,
    low: int,
    high: int,
) -> NDArray[np.int32]:
    """``decode_coded_knots``, each count clamped to low ... high (DEC-001)."""
    if compiled is None:
        counts = decode_coded_knots(data, parameters, span, components, level, offset)
        return np.clip(counts, low, high).astype(np.int32)
    grid, bound = parameters.grid, level.count_bound
    limit = grid.index_limit(bound)
    row, further, coded = parse_start(data, span, components, limit, offset)
    out = np.empty((span, components), np.int32)
    status, taken = compiled.coded_knots_decode(
        data[coded:], parameters.interpolation == "linear", further, limit, grid.step, grid.zero,
        levels_of(grid, bound), low, high, np.array(row, np.int64),
        np.zeros(2 * components, np.int64), out,
    )  # fmt: skip
    if status:
        requirement, message = STATUS[status]
        place = offset + coded + min(taken, len(data) - coded)
        raise FormatError(message, requirement=requirement, offset=place)
    return out
