"""KNOT: knots on a grid, joined by steps or lines.

The knots are stored as varints (SPEC 9.1), or as entropy coded gaps and differences (SPEC 9.6).
Rows of varints are NumPy arrays here; hapfmt.numbers gives the same numbers one by one.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..kernels import compiled
from ..limits import Level
from ..numbers import VARINT_SIZE, build_svarint, build_varint, parse_varint
from .entropy import ByBits, Decoder, Encoder
from .grids import UNIT_GRID, LpcParameters, levels_of
from .predicted import INDEX_LIMIT, NO_ROOM, check_index


def parse_varints(data: bytes, offset: int) -> NDArray[np.int64]:
    """All varints in ``data``, which is at ``offset``; CNV-002 checked."""
    raw = np.frombuffer(data, np.uint8)
    last = raw < 0x80
    if raw.size and not last[-1]:
        raise TruncatedError(
            "the bytes end within a varint", requirement="CNV-002", offset=offset + raw.size
        )
    stops = np.flatnonzero(last) + 1
    starts = np.concatenate(([0], stops[:-1])) if stops.size else stops
    sizes = stops - starts
    check(sizes > VARINT_SIZE, starts, offset, "varint of more than 8 bytes", "CNV-002")
    check(
        (sizes > 1) & (raw[stops - 1] == 0), starts, offset, "varint longer than needed", "CNV-002"
    )
    values = np.zeros(stops.size, np.int64)
    for group in range(int(sizes.max(initial=0))):
        has = sizes > group
        values[has] |= (raw[starts[has] + group].astype(np.int64) & 0x7F) << (7 * group)
    check(values >= 1 << 53, starts, offset, "varint of 2^53 or more", "CNV-002")
    return values


def check(
    wrong: NDArray[np.bool_], starts: NDArray[np.int64], offset: int, message: str, rule: str
) -> None:
    if wrong.any():
        at = int(starts[int(np.argmax(wrong))])
        raise FormatError(message, requirement=rule, offset=offset + at)


def build_varints(values: NDArray[np.int64]) -> bytes:
    """Non-negative numbers below 2**53, in order."""
    if compiled is not None:
        room = np.empty(VARINT_SIZE * values.size, np.uint8)
        return room[: compiled.build_varints(np.ascontiguousarray(values), room)].tobytes()
    sizes = np.ones(values.size, np.int64)
    for group in range(1, VARINT_SIZE):
        sizes += values >= 1 << (7 * group)
    starts = np.cumsum(sizes) - sizes
    out = np.zeros(int(sizes.sum()), np.uint8)
    for group in range(int(sizes.max(initial=0))):
        has = sizes > group
        more = (sizes[has] > group + 1).astype(np.int64) << 7
        out[starts[has] + group] = (values[has] >> (7 * group)) & 0x7F | more
    return out.tobytes()


def to_signed(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """svarint numbers from varint numbers: 0, 1, 2, 3 are 0, -1, 1, -2."""
    return (values >> 1) ^ -(values & 1)


def from_signed(values: NDArray[np.int64]) -> NDArray[np.int64]:
    return (values << 1) ^ (values >> 63)


Interpolation = Literal["hold", "linear"]
FAR = 1 << 36
INTERPOLATIONS: tuple[Interpolation, ...] = ("hold", "linear")


@dataclass(frozen=True)
class KnotParameters:
    """How knots are joined, which count each index stands for, and whether they are
    entropy coded or stored in varints."""

    interpolation: Interpolation
    grid: LpcParameters = UNIT_GRID
    coded: bool = False

    def build(self) -> bytes:
        way = INTERPOLATIONS.index(self.interpolation)
        return bytes([way, self.coded]) + self.grid.build()

    @classmethod
    def parse(cls, data: bytes, level: Level, offset: int) -> KnotParameters:
        if len(data) < 2:
            raise TruncatedError("KNOT parameters cut short", requirement="COD-002", offset=offset)
        if data[0] >= len(INTERPOLATIONS) or data[1] > 1:
            raise FormatError(
                "unknown interpolation or coding", requirement="KNT-001", offset=offset
            )
        grid = LpcParameters.parse(data[2:], level, offset + 2)
        return cls(INTERPOLATIONS[data[0]], grid, bool(data[1]))


def parse_knots(
    data: bytes, components: int, offset: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Ticks [knots] counted from the packet's start, and indices [knots, components]."""
    numbers = parse_varints(data, offset)
    width = components + 1
    # The tick of the first knot is 0 and not stored: put it in, and all rows are alike.
    if (numbers.size + 1) % width or numbers.size < components:
        raise FormatError("a knot is not whole", requirement="KNT-002", offset=offset)
    table = np.concatenate((np.zeros(1, np.int64), numbers)).reshape(-1, width)
    if (table[1:, 0] < 1).any():
        raise FormatError("knot ticks not increasing", requirement="KNT-003", offset=offset)
    # Sums of 64-bit numbers could wrap: no index that keeps LPC-003 is that far from the next, and
    # a gap cut to this size still lies beyond any packet.
    if table[:, 1:].max() >= FAR:
        raise FormatError("index far beyond the grid", requirement="LPC-003", offset=offset)
    return np.cumsum(np.minimum(table[:, 0], FAR)), np.cumsum(to_signed(table[:, 1:]), axis=0)


def build_knots(ticks: NDArray[np.int64], indices: NDArray[np.int64]) -> bytes:
    """The packet of knots: ticks [knots] with ticks[0] = 0, indices [knots, components]."""
    differences = np.diff(indices, axis=0, prepend=0)
    table = np.column_stack((np.diff(ticks, prepend=0), from_signed(differences)))
    return build_varints(table.reshape(-1)[1:])


def interpolate(
    ticks: NDArray[np.int64], counts: NDArray[np.int64], span: int, interpolation: Interpolation
) -> NDArray[np.int64]:
    """Counts [span, components] from knots that keep KNT-003."""
    if interpolation == "hold" or ticks.size == 1:
        return np.repeat(counts, np.diff(np.append(ticks, span)), axis=0)
    lengths = np.diff(ticks)
    lengths[-1] += 1
    rise, run = np.diff(counts, axis=0), np.diff(ticks)
    row = np.repeat(np.arange(lengths.size), lengths)
    along = np.arange(span) - ticks[row]
    divisor = run[row][:, None]
    numerator = 2 * rise[row] * along[:, None] + divisor
    line: NDArray[np.int64] = counts[row] + numerator // (2 * divisor)
    return line


def decode_knots(
    data: bytes, parameters: KnotParameters, span: int, components: int, level: Level, offset: int
) -> NDArray[np.int64]:
    """The packet ``data`` at ``offset``, as counts [span, components]."""
    ticks, indices = parse_knots(data, components, offset)
    grid, bound = parameters.grid, level.count_bound
    if np.abs(indices).max() > grid.index_limit(bound):
        raise FormatError("index beyond the grid", requirement="LPC-003", offset=offset)
    check_ticks(ticks, span, parameters.interpolation, offset)
    return interpolate(ticks, grid.counts(indices, bound), span, parameters.interpolation)


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
    """``decode_knots``, each count clamped to low ... high (DEC-001)."""
    if compiled is not None:
        grid, out = parameters.grid, np.empty((span, components), np.int32)
        if compiled.knots_decode(
            data, components, parameters.interpolation == "linear",
            grid.index_limit(level.count_bound), grid.step, grid.zero,
            levels_of(grid, level.count_bound), low, high,
            np.zeros(2 * components, np.int64), out,
        ):  # fmt: skip
            return out
    # Python decodes the rest, and reports which rule is broken.
    counts = decode_knots(data, parameters, span, components, level, offset)
    return np.clip(counts, low, high).astype(np.int32)


def check_ticks(
    ticks: NDArray[np.int64], span: int, interpolation: Interpolation, offset: int
) -> None:
    last = int(ticks[-1])
    if last >= span:
        raise FormatError("knot beyond its packet", requirement="KNT-003", offset=offset)
    if interpolation == "linear" and 0 < last < span - 1:
        raise FormatError(
            "the last line does not end at the packet's end", requirement="KNT-003", offset=offset
        )


GAP_BITS = 24
"""A gap of 2^24 ticks is the longest within a packet of any level."""

NO_KNOTS = "ticks that do not ascend, or a gap beyond 2^24, or an index beyond 2^32"
"""What an encoder must not ask for."""

STATUS = {
    2: ("RNG-003", "a magnitude of 2^34 or more"),
    3: ("LPC-003", "index beyond the grid"),
    4: ("RNG-001", "the coded bytes do not end with their packet"),
    8: ("KTE-004", "more knots than the ticks left"),
}
"""What the compiled loop returns, as the readable one says it."""


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
    coder = Encoder(many_pay=False)
    gaps = (np.diff(ticks) - 1).tolist()
    differences = np.diff(indices, axis=0).T.ravel().tolist()
    ByBits.of(gaps[:-1] if interpolation == "linear" else gaps, signs=False).put(coder)
    ByBits.of(differences, signs=True).put(coder)
    return coder.finish()


def encode_compiled(
    ticks: NDArray[np.int64], indices: NDArray[np.int64], interpolation: Interpolation
) -> bytes:
    """``encode_loop``, in C; a packet that does not fit its buffer is written again."""
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
            "more knots than ticks, or none", requirement="KTE-004", offset=offset + position
        )
    return row, further, coded


def decode_indices(
    data: bytes, interpolation: Interpolation, span: int, components: int, limit: int, offset: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Ticks [knots], and indices [knots, components] of a magnitude of at most ``limit``."""
    row, further, coded = parse_start(data, span, components, limit, offset)
    if not further:
        return np.zeros(1, np.int64), np.array([row], np.int64)
    linear = interpolation == "linear"
    gaps, differences, place = decode_numbers(
        data[coded:], further, components, offset + coded, linear=linear
    )
    # 2^24 numbers below 2^34: their sums fit 64 bits.
    ticks = np.zeros(further + 1, np.int64)
    ticks[1 : 1 + len(gaps)] = gaps
    ticks[1 : 1 + len(gaps)] += 1
    np.cumsum(ticks, out=ticks)
    if linear:
        ticks[-1] = span - 1
    rows = np.empty((further + 1, components), np.int64)
    rows[0] = row
    rows[1:] = np.frombuffer(differences, np.int64).reshape(components, further).T
    np.cumsum(rows, axis=0, out=rows)
    # Each of the knots that follow needs a tick too.
    late = first_of(ticks >= np.arange(span - further, span + 1))
    far = first_of(np.maximum(rows.max(axis=1), -rows.min(axis=1)) > limit)
    if late <= min(far, further):
        raise FormatError("more knots than the ticks left", requirement="KTE-004", offset=place)
    if far <= further:
        raise FormatError("index beyond the grid", requirement="LPC-003", offset=place)
    return ticks, rows


def first_of(wrong: NDArray[np.bool_]) -> int:
    """The first place that is wrong; their number where none is."""
    return int(wrong.argmax()) if wrong.any() else wrong.size


def decode_numbers(
    data: bytes, further: int, components: int, offset: int, *, linear: bool
) -> tuple[array[int], array[int], int]:
    """Gaps less 1, differences component by component, and where the coder ended."""
    coder = Decoder(data, offset, 1)
    gaps = coder.by_bits(further - linear, signs=False)
    differences = coder.by_bits(further * components, signs=True)
    coder.finish()
    return gaps, differences, coder.place


def decode_coded_knots(
    data: bytes,
    parameters: KnotParameters,
    span: int,
    components: int,
    level: Level,
    offset: int,
) -> NDArray[np.int64]:
    """The packet ``data`` at ``offset``, as counts [span, components]."""
    grid, bound = parameters.grid, level.count_bound
    limit = grid.index_limit(bound)
    ticks, rows = decode_indices(data, parameters.interpolation, span, components, limit, offset)
    return interpolate(ticks, grid.counts(rows, bound), span, parameters.interpolation)


def decode_coded_within(
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
