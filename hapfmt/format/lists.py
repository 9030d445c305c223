"""Values of a track's TLVs that are not texts (SPEC 6.2, clauses 8 and 11)."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from typing import TypeVar

from ..errors import FormatError, ParameterError, TruncatedError
from ..limits import AFFINE_LIMIT, FRACTION_LIMIT, SINGLE_MAX, ZERO_LIMIT
from ..numbers import build_svarint, build_varint, parse_svarint, parse_varint
from .layout import DEVIATION
from .track import Affine, Contract

T = TypeVar("T")
FLOOR_LIMIT = 1 << 32
VECTOR, GUARANTEED = 1, 2


class Cursor:
    """Reads a value from its first byte on; ``place`` is the offset in the file."""

    def __init__(self, value: bytes, offset: int) -> None:
        self.value = value
        self.offset = offset
        self.position = 0

    @property
    def place(self) -> int:
        return self.offset + self.position

    @property
    def left(self) -> int:
        return len(self.value) - self.position

    def varint(self) -> int:
        number, self.position = parse_varint(self.value, self.position, self.offset)
        return number

    def svarint(self) -> int:
        number, self.position = parse_svarint(self.value, self.position, self.offset)
        return number

    def take(self, size: int) -> bytes:
        if size > self.left:
            raise TruncatedError(
                "a list ends within an entry", requirement="TLV-004", offset=self.place
            )
        self.position += size
        return self.value[self.position - size : self.position]

    def end(self) -> None:
        if self.left:
            raise FormatError(
                "bytes left over after a list", requirement="TLV-004", offset=self.place
            )


def entries_of(value: bytes, offset: int, parse: Callable[[Cursor], T]) -> Iterator[T]:
    """Entries to the end of the value."""
    cursor = Cursor(value, offset)
    while cursor.left:
        yield parse(cursor)


# TLV 3


def build_calibration(affine: Affine) -> bytes:
    return build_svarint(affine.a) + build_svarint(affine.b) + build_varint(affine.d)


def parse_calibration(cursor: Cursor) -> Affine:
    at = cursor.place
    affine = Affine(cursor.svarint(), cursor.svarint(), cursor.varint())
    if not affine.d or not affine.a or max(abs(affine.a), abs(affine.b)) >= AFFINE_LIMIT:
        raise FormatError("calibration out of its bounds", requirement="VAL-001", offset=at)
    return affine


# TLV 16


def build_contract(contract: Contract) -> bytes:
    flags = contract.vector * VECTOR | contract.guaranteed * GUARANTEED
    out = build_varint(contract.kd) + build_varint(contract.kn) + bytes([flags])
    for floor, zero in zip(contract.floor, contract.zero, strict=True):
        out += build_varint(floor) + build_svarint(zero)
    return out


def parse_contract(value: bytes, offset: int, size: int) -> Contract:
    """Of a track with ``size`` components."""
    cursor = Cursor(value, offset)
    kd, kn, flags = cursor.varint(), cursor.varint(), cursor.take(1)[0]
    pairs = [(cursor.varint(), cursor.svarint()) for _ in range(size)]
    cursor.end()
    fits = kd and max(kn, kd) < FRACTION_LIMIT and flags <= VECTOR | GUARANTEED
    fits = fits and all(1 <= floor < FLOOR_LIMIT for floor, _ in pairs)
    if not fits or any(not -ZERO_LIMIT <= zero < ZERO_LIMIT for _, zero in pairs):
        raise FormatError(
            "a deadband that is out of its bounds", requirement="DBC-001", offset=offset
        )
    return Contract(
        kn,
        kd,
        bool(flags & VECTOR),
        bool(flags & GUARANTEED),
        tuple(floor for floor, _ in pairs),
        tuple(zero for _, zero in pairs),
    )


# TLV 18


def round_up(x: float) -> float:
    """The smallest binary32 that is at least x."""
    if not 0 <= x <= SINGLE_MAX:
        raise ParameterError(f"a deviation lies between 0 and {SINGLE_MAX:.4g}, unlike {x}")
    bits = struct.pack("<f", x)
    if struct.unpack("<f", bits)[0] < x:
        bits = (int.from_bytes(bits, "little") + 1).to_bytes(4, "little")
    found: float = struct.unpack("<f", bits)[0]
    return found


def build_deviation(deviation: tuple[float, float] | None) -> bytes:
    declared, largest = deviation or (0.0, 0.0)
    return DEVIATION.build(declared=round_up(declared), largest=round_up(largest))


def parse_deviation(cursor: Cursor) -> tuple[float, float] | None:
    at = cursor.place
    raw = DEVIATION.read(cursor.take(DEVIATION.size))
    if not (math.isfinite(raw.declared) and 0 <= raw.largest <= raw.declared):
        raise FormatError("deviation above the declared one", requirement="TLV-005", offset=at)
    return (raw.declared, raw.largest) if raw.declared else None
