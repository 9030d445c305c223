"""RAWB: byte planes, stored or deflated; keeps any number bit for bit (SPEC 9.3)."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..format.deflate import inflate
from ..format.layout import RAWB_PARAMETERS
from ..format.track import WORD_SIZES

STORED, DEFLATE = 0, 1
COUNT_SIZES = (1, 2, 3, 4)
DTYPES: dict[str, np.dtype[Any]] = {
    "int64": np.dtype("<i8"),
    "uint64": np.dtype("<u8"),
    "binary16": np.dtype("<f2"),
    "binary32": np.dtype("<f4"),
    "binary64": np.dtype("<f8"),
}

LEVEL, APART, PROBED, PROBE_WINDOW, NOISY, LOOKED_UP = 6, 8192, 8, 13, 0.99, 8
"""From 8192 ticks on each byte plane is deflated in its own way. A probe of an eighth tells which;
what does not become smaller by 1 % is noise. Words of 8 ticks tell whether words repeat."""


@dataclass(frozen=True)
class RawParameters:
    """Bytes per word."""

    word_size: int

    def build(self) -> bytes:
        return RAWB_PARAMETERS.build(word_size=self.word_size, reserved=bytes(3))

    @classmethod
    def parse(cls, data: bytes, number_format: str, offset: int) -> RawParameters:
        raw = RAWB_PARAMETERS.parse(data, 0, "COD-002", offset)
        if len(data) != RAWB_PARAMETERS.size:
            raise FormatError("RAWB parameters too long", requirement="COD-002", offset=offset)
        if any(raw.reserved):
            raise FormatError(
                "reserved bytes are not 0",
                requirement="HED-005",
                offset=offset + RAWB_PARAMETERS.offsets["reserved"],
            )
        allowed = COUNT_SIZES if number_format == "counts" else (WORD_SIZES[number_format],)
        if raw.word_size not in allowed:
            raise FormatError(
                f"word size {raw.word_size} for {number_format}",
                requirement="RAW-001",
                offset=offset,
            )
        return cls(raw.word_size)


def encode_raw(numbers: NDArray[Any], word_size: int) -> bytes:
    """The packet of numbers [ticks, components], counts or words; the smaller method."""
    wide = numbers.astype("<i8") if numbers.dtype.kind == "i" else numbers
    columns = np.ascontiguousarray(wide.T)
    octets = columns.view(np.uint8).reshape(*columns.shape, -1)
    planes = np.ascontiguousarray(octets[:, :, :word_size].transpose(0, 2, 1))
    if len(numbers) < APART:
        deflated = pack(planes.tobytes(), LEVEL, zlib.Z_DEFAULT_STRATEGY)
    else:
        deflated = pack_apart(planes, [repeats(column) for column in columns])
    if len(deflated) < planes.size:
        return bytes([DEFLATE]) + deflated
    return bytes([STORED]) + planes.tobytes()


def pack(data: bytes, level: int, strategy: int, *, last: bool = True, window: int = 15) -> bytes:
    """Blocks of DEFLATE that end with a whole byte, so that others may follow."""
    packer = zlib.compressobj(level, zlib.DEFLATED, -window, 8, strategy)
    return packer.compress(data) + packer.flush(zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH)


def pack_apart(planes: NDArray[np.uint8], repeating: list[bool]) -> bytes:
    """One stream of byte planes [components, word size, ticks], each plane in its own way: where
    bytes are noise, looking for repeated strings takes long and finds nothing."""
    count, word_size, _ = planes.shape
    parts = []
    for place in range(count * word_size):
        plane = planes[place // word_size, place % word_size].tobytes()
        way = LEVEL, zlib.Z_DEFAULT_STRATEGY
        if not repeating[place // word_size]:
            way = way_of(plane)
        parts.append(pack(plane, *way, last=place == count * word_size - 1))
    return b"".join(parts)


def way_of(plane: bytes) -> tuple[int, int]:
    """Level and strategy by some bytes: stored, code words alone, or with repeated strings."""
    size = min(len(plane) // PROBED, 1 << PROBE_WINDOW)
    start = (len(plane) - size) // 2
    some = plane[start : start + size]
    sizes = [
        len(pack(some, LEVEL, strategy, window=PROBE_WINDOW))
        for strategy in (zlib.Z_HUFFMAN_ONLY, zlib.Z_DEFAULT_STRATEGY)
    ]
    if min(sizes) >= NOISY * len(some):
        return 0, zlib.Z_DEFAULT_STRATEGY
    return LEVEL, zlib.Z_HUFFMAN_ONLY if NOISY * sizes[0] <= sizes[1] else zlib.Z_DEFAULT_STRATEGY


def repeats(column: NDArray[Any]) -> bool:
    """Whether most of some words occur twice: then long strings may repeat."""
    looked = column[:: -(-column.size // LOOKED_UP)]
    again = sum(int(np.count_nonzero(column == word) > 1) for word in looked)
    return 2 * again > looked.size


def decode_raw(
    data: bytes,
    parameters: RawParameters,
    number_format: str,
    span: int,
    components: int,
    offset: int,
) -> NDArray[Any]:
    """The packet ``data`` at ``offset``: int32 counts or words [span, components]."""
    size = parameters.word_size
    expected = span * components * size
    planes = unpack(data, expected, offset)
    raw = np.frombuffer(planes, np.uint8).reshape(components, size, span)
    counts = number_format == "counts"
    out = np.zeros((span, components), np.dtype("<i4") if counts else DTYPES[number_format])
    octets = out.view(np.uint8).reshape(span, components, -1)
    octets[:, :, -size:] = raw.transpose(2, 0, 1)
    if counts:
        # The bytes are in the upper end of each number: the shift down extends the sign.
        out >>= 8 * (4 - size)
    return out


def unpack(data: bytes, expected: int, offset: int) -> bytes:
    """The byte planes, exactly ``expected`` bytes; inflating stops there (RAW-003)."""
    if not data:
        raise TruncatedError("a raw packet without a method", requirement="COD-001", offset=offset)
    if data[0] == STORED:
        if len(data) - 1 != expected:
            raise FormatError(
                f"{len(data) - 1} bytes of words instead of {expected}",
                requirement="RAW-003",
                offset=offset,
            )
        return data[1:]
    if data[0] != DEFLATE:
        raise FormatError(f"raw method {data[0]}", requirement="RAW-003", offset=offset)
    return inflate(data[1:], expected, "RAW-003", offset + 1)
