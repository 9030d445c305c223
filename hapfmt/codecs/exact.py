"""LPCX: counts by LPCR, and beside them what each lacks of the source's double (SPEC 9.7)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..container.layout import LPCX_PARAMETERS
from ..container.track import Affine
from ..container.wire import parse_fixed
from ..errors import FormatError
from ..integers import build_varint, parse_varint
from ..kernels import compiled
from ..limits import Level
from .adaptive import BitModel, RangeDecoder, RangeEncoder
from .components import decode_predicted
from .grids import LpcParameters
from .values import Counts, Doubles, digits_fit, ordered, spread_of, unordered, values_of

RECALL, RELATIVE = 1, 2
LENGTHS = 64
"""A correction has 0 to 63 bits."""

ABSOLUTE = 255
"""In place of a width: the length is coded as it is."""

HIGH_BITS = 10
"""Bits of a correction that can stand above those of a mantissa and below the leading 1."""

REMEMBERED = 32
"""Corrections that are remembered of a count."""

FRESH, SAME, KNOWN = range(3)
"""A count that was not met before in the packet, that of the sample before, another one."""

BAD_END, BAD_BITS = 4, 6
WHOLE = 1 << 62
"""More bytes than anything takes."""


@dataclass(frozen=True)
class ExactParameters:
    """How a count becomes a double, before the correction."""

    rule: int = 0
    digits: int = 0

    def build(self) -> bytes:
        fields = {"rule": self.rule, "digits": self.digits, "reserved": bytes(2)}
        return bytes(LPCX_PARAMETERS.build(fields))

    @classmethod
    def parse(cls, data: bytes, offset: int) -> ExactParameters:
        raw = parse_fixed(LPCX_PARAMETERS, data, 0, "COD-002", offset)
        if len(data) != LPCX_PARAMETERS.sizeof():
            raise FormatError("LPCX parameters too long", requirement="COD-002", offset=offset)
        if any(raw.reserved):
            raise FormatError("reserved bytes are not 0", requirement="HED-005", offset=offset + 2)
        if not digits_fit(raw.rule, raw.digits):
            raise FormatError(
                f"rule {raw.rule} with {raw.digits} digits", requirement="EXA-002", offset=offset
            )
        return cls(raw.rule, raw.digits)

    def values(self, counts: Counts, affine: Affine) -> Doubles:
        return values_of(counts, affine, self.rule, self.digits)


def split_packet(data: bytes, offset: int) -> tuple[bytes, bytes, int]:
    """The packet of LPCR, the bytes of the exact values, and the offset of these."""
    size, start = parse_varint(data, 0, offset)
    if size > len(data) - start:
        raise FormatError("the counts run past their packet", requirement="EXA-003", offset=offset)
    return data[start : start + size], data[start + size :], offset + start + size


def decode_counts(data: bytes, span: int, level: Level, offset: int) -> Counts:
    """The counts [span] alone: the exact values are not looked at."""
    coded, _, stop = split_packet(data, offset)
    return decode_predicted(coded, LpcParameters(), span, 1, level, stop - len(coded))[:, 0]


def decode_exact(
    data: bytes, parameters: ExactParameters, affine: Affine, counts: Counts, offset: int
) -> Doubles:
    """The source's doubles [span], given the counts of the same packet."""
    _, rest, at = split_packet(data, offset)
    doubles = parameters.values(counts, affine)
    if not rest:
        return doubles
    if len(rest) < 2 or rest[0] & ~(RECALL | RELATIVE) or rest[1] >= LENGTHS:
        raise FormatError("corrections that are not defined", requirement="EXA-004", offset=at)
    size, start = parse_varint(rest, 2, at)
    if size > len(rest) - start:
        raise FormatError(
            "the coded bits run past their packet", requirement="EXA-004", offset=at + 2
        )
    widths = widths_of(doubles, affine, rest[0], rest[1])
    ids = ids_of(counts) if rest[0] & RECALL else None
    coded, bits = rest[start : start + size], rest[start + size :]
    loop = decode_loop if compiled is None else decode_compiled
    corrections = loop(coded, bits, ids, widths, rest[1], at + start)
    with np.errstate(over="ignore"):
        return unordered(ordered(doubles) + (corrections << rest[1]))


def encode_exact(
    source: Doubles,
    parameters: ExactParameters,
    affine: Affine,
    counts: Counts,
    *,
    recall: bool,
    relative: bool,
) -> bytes:
    """What follows the counts in their packet. ValueError where a correction needs 64 bits."""
    data = lacking_of(source, parameters, affine, counts).build(recall=recall, relative=relative)
    assert data is not None
    return data


@dataclass(frozen=True)
class Lacking:
    """What the counts of a packet lack of their doubles, to be coded one way or another."""

    counts: Counts
    corrections: Counts
    """With ``shift`` zeros below each taken away."""

    shift: int
    spread: NDArray[np.uint8]

    @cached_property
    def ids(self) -> NDArray[np.int32]:
        return ids_of(self.counts)

    def build(self, *, recall: bool, relative: bool, below: int = WHOLE) -> bytes | None:
        """None where that is found to take ``below`` bytes or more before it is finished."""
        if not self.corrections.any():
            return b""
        flags = RECALL * recall | RELATIVE * relative
        widths = relative_to(self.spread, flags, self.shift)
        ids = self.ids if recall else None
        if compiled is not None:
            coded, bits = encode_compiled(self.corrections, ids, widths, self.shift)
        else:
            found = encode_loop(self.corrections, ids, widths, self.shift, below)
            if found is None:
                return None
            coded, bits = found
        return bytes([flags, self.shift]) + build_varint(len(coded)) + coded + bits


def lacking_of(
    source: Doubles, parameters: ExactParameters, affine: Affine, counts: Counts
) -> Lacking:
    doubles = parameters.values(counts, affine)
    corrections = corrections_of(source, doubles)
    together = int(np.bitwise_or.reduce(corrections))
    shift = max((together & -together).bit_length() - 1, 0)
    return Lacking(counts, corrections >> shift, shift, spread_of(doubles, affine))


def corrections_of(source: Doubles, doubles: Doubles) -> Counts:
    """Steps from each double to that of the source; ValueError from 2^63 on."""
    x, y = ordered(source), ordered(doubles)
    corrections = x - y
    # Wrapped around, or the one number without a positive twin.
    far = ((x ^ y) & (x ^ corrections)) < 0
    if far.any() or (corrections == np.iinfo(np.int64).min).any():
        raise ValueError("a correction of 2^63 or more")
    return corrections


def widths_of(doubles: Doubles, affine: Affine, flags: int, shift: int) -> NDArray[np.uint8]:
    """What lengths are coded relative to."""
    return relative_to(spread_of(doubles, affine), flags, shift)


def relative_to(spread: NDArray[np.uint8], flags: int, shift: int) -> NDArray[np.uint8]:
    if not flags & RELATIVE:
        return np.full(spread.size, ABSOLUTE, np.uint8)
    return np.maximum(spread, shift) - np.uint8(shift)


def high_bits(length: int, shift: int) -> int:
    """e of SPEC 9.7: bits of a correction that belong to the exponent."""
    return max(min(length - 1, length + shift - 53, HIGH_BITS), 0)


def ids_of(counts: Counts) -> NDArray[np.int32]:
    """The place of each count among the distinct ones of its packet."""
    return np.unique(counts, return_inverse=True)[1].astype(np.int32)


class CorrectionModel:
    """Bit models, and the corrections remembered of each count, the last one first."""

    def __init__(self) -> None:
        self.lengths = [BitModel() for _ in range(LENGTHS - 1)]
        self.highs = [BitModel() for _ in range(1 << HIGH_BITS)]
        self.recalls = [[BitModel() for _ in range(REMEMBERED)] for _ in range(3)]
        self.remembered: dict[int, list[int]] = {}
        self.last = -1

    def meet(self, id_: int) -> tuple[list[int], list[BitModel]]:
        """What was remembered of a count, and the models of its recall."""
        known = self.remembered.get(id_)
        context = FRESH if known is None else SAME if id_ == self.last else KNOWN
        self.last = id_
        return [0] if known is None else known, self.recalls[context]

    def learn(self, id_: int, correction: int, rank: int | None) -> None:
        """``rank`` on the list of its count, None where it was coded in full."""
        known = self.remembered.setdefault(id_, [])
        if known and rank is not None:
            del known[rank]
        known.insert(0, correction)
        del known[REMEMBERED:]


def tree_encode(coder: RangeEncoder, models: list[BitModel], value: int, bits: int) -> None:
    """``bits`` bits of ``value``, highest first, each with the model of those before it."""
    node = 1
    for at in range(bits - 1, -1, -1):
        bit = value >> at & 1
        coder.bit(bit, models[node])
        node = 2 * node + bit


def tree_decode(coder: RangeDecoder, models: list[BitModel], bits: int) -> int:
    node = 1
    for _ in range(bits):
        node = 2 * node + coder.bit(models[node])
    return node - (1 << bits)


def encode_loop(
    corrections: Counts,
    ids: NDArray[np.int32] | None,
    widths: NDArray[np.uint8],
    shift: int,
    below: int = WHOLE,
) -> tuple[bytes, bytes] | None:
    """Coded bytes, and the bits; None as soon as the first are not ``below``. kernels/ has the same
    in C, which does not stop."""
    coder, model = RangeEncoder(), CorrectionModel()
    fields: list[str] = []
    names = [0] * corrections.size if ids is None else ids.tolist()
    for c, id_, width in zip(corrections.tolist(), names, widths.tolist(), strict=True):
        if len(coder.out) >= below:
            return None
        if ids is not None:
            known, models = model.meet(id_)
            found = known.index(c) if c in known else None
            for i in range(len(known) if found is None else found + 1):
                coder.bit(int(i == found), models[i])
            model.learn(id_, c, found)
            if found is not None:
                continue
        length = abs(c).bit_length()
        symbol = length if width == ABSOLUTE else (width - length) % LENGTHS
        for i in range(min(symbol + 1, LENGTHS - 1)):
            coder.bit(int(i < symbol), model.lengths[i])
        if length:
            size = length - high_bits(length, shift)
            rest = abs(c) ^ 1 << (length - 1)
            tree_encode(coder, model.highs, rest >> (size - 1), length - size)
            sign = (c < 0) << (size - 1)
            fields.append(f"{sign | rest & ((1 << (size - 1)) - 1):0{size}b}")
    bits = "".join(fields)
    size = -(-len(bits) // 8)
    return coder.finish(), int(bits.ljust(8 * size, "0") or "0", 2).to_bytes(size, "big")


def decode_loop(
    coded: bytes,
    bits: bytes,
    ids: NDArray[np.int32] | None,
    widths: NDArray[np.uint8],
    shift: int,
    offset: int,
) -> Counts:
    """The corrections [span]; ``coded`` stands at ``offset`` and ``bits`` after it."""
    coder, model = RangeDecoder(coded, offset), CorrectionModel()
    out: list[int] = []
    position = 0
    names = [0] * widths.size if ids is None else ids.tolist()
    for id_, width in zip(names, widths.tolist(), strict=True):
        rank: int | None = None
        if ids is not None:
            known, models = model.meet(id_)
            rank = next((i for i in range(len(known)) if coder.bit(models[i])), None)
        if rank is not None:
            c = known[rank]
        else:
            length = 0
            while length < LENGTHS - 1 and coder.bit(model.lengths[length]):
                length += 1
            length = length if width == ABSOLUTE else (width - length) % LENGTHS
            c = 0
            if length:
                size = length - high_bits(length, shift)
                high = 1 << (length - size) | tree_decode(coder, model.highs, length - size)
                field = field_at(bits, position, size, offset + len(coded))
                position += size
                top = 1 << (size - 1)
                magnitude = high * top | field & (top - 1)
                c = -magnitude if field & top else magnitude
        if ids is not None:
            model.learn(id_, c, rank)
        out.append(c)
        coder.check()
    coder.finish()
    check_bits(bits, position, offset + len(coded))
    return np.array(out, np.int64)


def field_at(bits: bytes, position: int, size: int, offset: int) -> int:
    """The ``size`` bits from bit ``position`` on."""
    stop = position + size
    if stop > 8 * len(bits):
        raise bad_bits(offset, min(position // 8, len(bits)))
    field = int.from_bytes(bits[position // 8 : -(-stop // 8)], "big") >> (-stop % 8)
    return field & ((1 << size) - 1)


def check_bits(bits: bytes, used: int, offset: int) -> None:
    """EXA-005."""
    if len(bits) != -(-used // 8) or (bits and bits[-1] & ((1 << (-used % 8)) - 1)):
        raise bad_bits(offset, min(used // 8, len(bits)))


def bad_bits(offset: int, place: int) -> FormatError:
    return FormatError(
        "the bits of the corrections do not end with their packet",
        requirement="EXA-005",
        offset=offset + place,
    )


def work_of(ids: NDArray[np.int32] | None) -> Counts:
    """What the compiled loops remember in, 16 bytes a sample: a value, a link, and a head for each
    count."""
    return np.zeros(0 if ids is None else 2 * ids.size, np.int64)


def encode_compiled(
    corrections: Counts, ids: NDArray[np.int32] | None, widths: NDArray[np.uint8], shift: int
) -> tuple[bytes, bytes]:
    """``encode_loop``, in C; what does not fit its buffers is written once more."""
    assert compiled is not None
    plain = np.ascontiguousarray(corrections)
    names = np.zeros(0, np.int32) if ids is None else ids
    coded, bits = bytearray(2 * plain.size + 64), bytearray(5 * plain.size + 8)
    while True:
        status, size, used = compiled.exact_encode(
            coded, bits, names, widths, plain, work_of(ids), shift
        )
        if status == 0:
            return bytes(coded[:size]), bytes(bits[: -(-used // 8)])
        coded, bits = bytearray(size), bytearray(-(-used // 8))


def decode_compiled(
    coded: bytes,
    bits: bytes,
    ids: NDArray[np.int32] | None,
    widths: NDArray[np.uint8],
    shift: int,
    offset: int,
) -> Counts:
    """``decode_loop``, in C."""
    assert compiled is not None
    out = np.empty(widths.size, np.int64)
    names = np.zeros(0, np.int32) if ids is None else ids
    status, shifts, used = compiled.exact_decode(
        coded, bits, names, widths, out, work_of(ids), shift
    )
    if status == BAD_END:
        raise FormatError(
            "the coded bits do not end with their packet",
            requirement="RNG-001",
            offset=offset + min(shifts, len(coded)),
        )
    if status:
        raise bad_bits(offset + len(coded), min(used // 8, len(bits)))
    return out
