"""The lists within TRAK's TLVs, but for texts (SPEC 6.2, 6.3, clauses 8 and 11)."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from ..errors import FormatError, ParameterError, TruncatedError
from ..integers import build_svarint, build_varint, parse_svarint, parse_varint
from ..limits import AFFINE_LIMIT, FRACTION_LIMIT, SINGLE_MAX, ZERO_LIMIT
from .layout import DEVIATION
from .tlv import share
from .track import Affine, Contract, Track

T = TypeVar("T")
Range = tuple[int, int]
Setup = tuple[bytes, bytes]
"""A codec and its parameters."""

SIGNED, WIDTHS, LISTED = 64, 32, 255
"""Codes of TLV 7: b and 64 + b for whole bits, b < 32; 255: the ends follow."""
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
                "a list ends within an entry", requirement="TLV-007", offset=self.place
            )
        self.position += size
        return self.value[self.position - size : self.position]

    def end(self) -> None:
        if self.left:
            raise FormatError(
                "bytes left over after a list", requirement="TLV-007", offset=self.place
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


# TLV 5


def build_setups(tracks: Sequence[Track]) -> bytes:
    """Setups codec by codec, both in the order in which they come first."""
    codecs: dict[str, dict[bytes, int]] = {}
    for track in tracks:
        codecs.setdefault(track.codec, {}).setdefault(track.parameters, 0)
    out = bytearray(build_varint(len(codecs)))
    number = 0
    for codec, setups in codecs.items():
        out += codec.encode("latin-1") + build_varint(len(setups))
        for parameters in setups:
            out += build_varint(len(parameters)) + parameters
            setups[parameters] = number
            number += 1
    for track in tracks:
        out += build_varint(codecs[track.codec][track.parameters])
    return bytes(out)


def parse_setups(value: bytes, offset: int, count: int) -> list[Setup]:
    """The setup of each of ``count`` tracks."""
    cursor = Cursor(value, offset)
    setups: list[Setup] = []
    for _ in range(some(cursor, count)):
        codec = cursor.take(4)
        number = some(cursor, count - len(setups))
        setups += [(codec, cursor.take(cursor.varint())) for _ in range(number)]
    chosen = []
    for _ in range(count):
        at, index = cursor.place, cursor.varint()
        if index >= len(setups):
            raise FormatError(f"no setup {index}", requirement="TRK-013", offset=at)
        chosen.append(setups[index])
    cursor.end()
    return chosen


def some(cursor: Cursor, most: int) -> int:
    """A number of codecs or setups."""
    at, number = cursor.place, cursor.varint()
    if not 1 <= number <= most:
        raise FormatError(
            "no codec, no setup, or more of them than tracks", requirement="TRK-013", offset=at
        )
    return number


# TLV 7


def build_range(low: int, high: int) -> bytes:
    bits = high.bit_length()
    if bits < WIDTHS and (low, high) == (0, (1 << bits) - 1):
        return bytes([bits])
    if bits < WIDTHS and (low, high) == (-(1 << bits), (1 << bits) - 1):
        return bytes([SIGNED + bits])
    return bytes([LISTED]) + build_svarint(low) + build_varint(high - low)


def parse_ranges(value: bytes, offset: int, count: int) -> list[Range]:
    cursor = Cursor(value, offset)
    ranges = [parse_range(cursor) for _ in range(count)]
    cursor.end()
    return ranges


def parse_range(cursor: Cursor) -> Range:
    at, code = cursor.place, cursor.take(1)[0]
    if code == LISTED:
        low = cursor.svarint()
        return low, low + cursor.varint()
    signed, bits = divmod(code, SIGNED)
    if signed > 1 or bits >= WIDTHS:
        raise FormatError(f"range code {code}", requirement="TRK-014", offset=at)
    return -(1 << bits) if signed else 0, (1 << bits) - 1


# TLV 9


def build_channels(firsts: Sequence[int]) -> bytes:
    return b"".join(map(build_varint, firsts))


def parse_channels(value: bytes, offset: int, count: int) -> list[int]:
    return parse_numbers(value, offset, count)


def parse_numbers(value: bytes, offset: int, count: int) -> list[int]:
    cursor = Cursor(value, offset)
    numbers = [cursor.varint() for _ in range(count)]
    cursor.end()
    return numbers


# TLV 11


def build_continued(continued: Sequence[int | None]) -> bytes:
    return b"".join(build_varint(0 if id_ is None else id_ + 1) for id_ in continued)


def parse_continued(value: bytes, offset: int, count: int) -> list[int | None]:
    """For each track the id of the one that it continues."""
    return [number - 1 if number else None for number in parse_numbers(value, offset, count)]


# TLV 16


def build_contracts(contracts: Sequence[Contract | None]) -> bytes:
    return b"".join(build_contract(contract) for contract in share(contracts))


def build_contract(contract: Contract | None) -> bytes:
    if contract is None:
        return bytes(1)
    flags = contract.vector * VECTOR | contract.guaranteed * GUARANTEED
    out = build_varint(contract.kd) + build_varint(contract.kn) + bytes([flags])
    for floor, zero in zip(contract.floor, contract.zero, strict=True):
        out += build_varint(floor) + build_svarint(zero)
    return out


def parse_contract(cursor: Cursor, size: int) -> Contract | None:
    """Of a track with ``size`` components."""
    at, kd = cursor.place, cursor.varint()
    if kd == 0:
        return None
    kn, flags = cursor.varint(), cursor.take(1)[0]
    pairs = [(cursor.varint(), cursor.svarint()) for _ in range(size)]
    fits = max(kn, kd) < FRACTION_LIMIT and flags <= VECTOR | GUARANTEED
    fits = fits and all(1 <= floor < FLOOR_LIMIT for floor, _ in pairs)
    if not fits or any(not -ZERO_LIMIT <= zero < ZERO_LIMIT for _, zero in pairs):
        raise FormatError("a deadband that is out of its bounds", requirement="DBC-001", offset=at)
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
    return bytes(DEVIATION.build({"declared": round_up(declared), "largest": round_up(largest)}))


def parse_deviation(cursor: Cursor) -> tuple[float, float] | None:
    at = cursor.place
    raw = DEVIATION.parse(cursor.take(DEVIATION.sizeof()))
    if not (math.isfinite(raw.declared) and 0 <= raw.largest <= raw.declared):
        raise FormatError("deviation above the declared one", requirement="TLV-005", offset=at)
    return (raw.declared, raw.largest) if raw.declared else None
