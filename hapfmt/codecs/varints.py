"""Rows of varints as NumPy arrays: the same numbers as hapfmt.integers gives one by one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..integers import VARINT_SIZE
from ..kernels import compiled


def parse_varints(data: bytes, offset: int) -> NDArray[np.int64]:
    """All varints in ``data``, which stands at ``offset``; CNV-002 checked."""
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
