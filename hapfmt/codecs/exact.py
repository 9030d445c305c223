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
from ..integers import parse_varint
from ..kernels import compiled
from ..limits import Level
from .adaptive import BitModel, RangeDecoder, RangeEncoder
from .components import decode_predicted
from .grids import LpcParameters
from .values import (
    COEFFICIENT_LIMIT,
    COEFFICIENTS,
    CUBIC,
    Counts,
    Doubles,
    digits_fit,
    ordered,
    unordered,
    values_of,
)

RECALL = 1
LENGTHS = 64
"""A correction has 0 to 63 bits."""

HIGH_BITS = 10
"""Bits of a correction that can stand above those of a mantissa and below the leading 1."""

REMEMBERED = 32
"""Corrections that are remembered of a count."""

FRESH, SAME, KNOWN = range(3)
"""A count that was not met before in the packet, that of the sample before, another one."""

BAD_ERROR, NO_ROOM = 2, 5
WHOLE = 1 << 62
"""More bytes than anything takes."""


@dataclass(frozen=True)
class ExactParameters:
    """How a count becomes a double, before the correction."""

    rule: int = 0
    digits: int = 0
    coefficients: tuple[float, ...] = ()
    """c0 to c3 of the cubic rule."""

    def build(self) -> bytes:
        fields = {"rule": self.rule, "digits": self.digits, "reserved": bytes(2)}
        return bytes(LPCX_PARAMETERS.build(fields)) + np.array(self.coefficients, "<f8").tobytes()

    @classmethod
    def parse(cls, data: bytes, offset: int) -> ExactParameters:
        raw = parse_fixed(LPCX_PARAMETERS, data, 0, "COD-002", offset)
        rest, count = data[LPCX_PARAMETERS.sizeof() :], COEFFICIENTS * (raw.rule == CUBIC)
        if raw.rule <= CUBIC and len(rest) != 8 * count:
            raise FormatError(
                "LPCX parameters of another length", requirement="COD-002", offset=offset
            )
        if any(raw.reserved):
            raise FormatError("reserved bytes are not 0", requirement="HED-005", offset=offset + 2)
        if not digits_fit(raw.rule, raw.digits):
            raise FormatError(
                f"rule {raw.rule} with {raw.digits} digits", requirement="EXA-002", offset=offset
            )
        coefficients = np.frombuffer(rest, "<f8")
        # So is what is no number refused.
        if not (np.abs(coefficients) < COEFFICIENT_LIMIT).all():
            raise FormatError(
                "a coefficient of 2^900 or more", requirement="EXA-008", offset=offset + 4
            )
        return cls(raw.rule, raw.digits, tuple(coefficients.tolist()))

    def values(self, counts: Counts, affine: Affine) -> Doubles:
        return values_of(counts, affine, self.rule, self.digits, self.coefficients)


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
    if len(rest) < 2 or rest[0] & ~RECALL or rest[1] >= LENGTHS:
        raise FormatError("corrections that are not defined", requirement="EXA-004", offset=at)
    ids = ids_of(counts) if rest[0] & RECALL else None
    loop = decode_loop if compiled is None else decode_compiled
    corrections = loop(rest[2:], ids, counts.size, rest[1], at + 2)
    with np.errstate(over="ignore"):
        return unordered(ordered(doubles) + (corrections << rest[1]))


def encode_exact(
    source: Doubles,
    parameters: ExactParameters,
    affine: Affine,
    counts: Counts,
    *,
    recall: bool,
) -> bytes:
    """What follows the counts in their packet. ValueError where a correction needs 64 bits."""
    data = lacking_of(source, parameters, affine, counts).build(recall=recall)
    assert data is not None
    return data


@dataclass(frozen=True)
class Lacking:
    """What the counts of a packet lack of their doubles, to be coded one way or another."""

    counts: Counts
    corrections: Counts
    """With ``shift`` zeros below each taken away."""

    shift: int

    @cached_property
    def ids(self) -> NDArray[np.int32]:
        return ids_of(self.counts)

    def build(self, *, recall: bool, below: int = WHOLE) -> bytes | None:
        """None where that is found to take ``below`` bytes or more before it is finished."""
        if not self.corrections.any():
            return b""
        ids = self.ids if recall else None
        if compiled is not None:
            coded: bytes | None = encode_compiled(self.corrections, ids, self.shift)
        else:
            coded = encode_loop(self.corrections, ids, self.shift, below)
        return None if coded is None else bytes([RECALL * recall, self.shift]) + coded


def lacking_of(
    source: Doubles, parameters: ExactParameters, affine: Affine, counts: Counts
) -> Lacking:
    doubles = parameters.values(counts, affine)
    corrections = corrections_of(source, doubles)
    together = int(np.bitwise_or.reduce(corrections))
    shift = max((together & -together).bit_length() - 1, 0)
    return Lacking(counts, corrections >> shift, shift)


def corrections_of(source: Doubles, doubles: Doubles) -> Counts:
    """Steps from each double to that of the source; ValueError from 2^63 on."""
    x, y = ordered(source), ordered(doubles)
    corrections = x - y
    # Wrapped around, or the one number without a positive twin.
    far = ((x ^ y) & (x ^ corrections)) < 0
    if far.any() or (corrections == np.iinfo(np.int64).min).any():
        raise ValueError("a correction of 2^63 or more")
    return corrections


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
    shift: int,
    below: int = WHOLE,
) -> bytes | None:
    """Coded bytes; None as soon as they are not ``below``. kernels/ has the same in C, which does
    not stop."""
    coder, model = RangeEncoder(), CorrectionModel()
    names = [0] * corrections.size if ids is None else ids.tolist()
    for c, id_ in zip(corrections.tolist(), names, strict=True):
        if len(coder.out) + len(coder.back) >= below:
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
        for i in range(min(length + 1, LENGTHS - 1)):
            coder.bit(int(i < length), model.lengths[i])
        if length:
            low = length - high_bits(length, shift) - 1
            rest = abs(c) ^ 1 << (length - 1)
            tree_encode(coder, model.highs, rest >> low, length - 1 - low)
            coder.raw(rest, low)
            coder.raw(int(c < 0), 1)
    return coder.finish()


def decode_loop(
    coded: bytes, ids: NDArray[np.int32] | None, span: int, shift: int, offset: int
) -> Counts:
    """The corrections [span]."""
    coder, model = RangeDecoder(coded, offset), CorrectionModel()
    out: list[int] = []
    for id_ in [0] * span if ids is None else ids.tolist():
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
            c = 0
            if length:
                low = length - high_bits(length, shift) - 1
                high = 1 << (length - 1 - low) | tree_decode(coder, model.highs, length - 1 - low)
                magnitude = high << low | coder.raw(low)
                c = -magnitude if coder.raw(1) else magnitude
        if ids is not None:
            model.learn(id_, c, rank)
        out.append(c)
        coder.check()
    coder.finish()
    return np.array(out, np.int64)


def work_of(ids: NDArray[np.int32] | None) -> Counts:
    """What the compiled loops remember in, 16 bytes a sample: a value, a link, and a head for each
    count."""
    return np.zeros(0 if ids is None else 2 * ids.size, np.int64)


def encode_compiled(corrections: Counts, ids: NDArray[np.int32] | None, shift: int) -> bytes:
    """``encode_loop``, in C; what does not fit its buffer is written once more."""
    assert compiled is not None
    plain = np.ascontiguousarray(corrections)
    names = np.zeros(0, np.int32) if ids is None else ids
    size, status = 7 * plain.size + 64, NO_ROOM
    while status == NO_ROOM:
        out = bytearray(size)
        status, size = compiled.exact_encode(out, names, plain, work_of(ids), shift)
    assert not status
    return bytes(out[:size])


def decode_compiled(
    coded: bytes, ids: NDArray[np.int32] | None, span: int, shift: int, offset: int
) -> Counts:
    """``decode_loop``, in C."""
    assert compiled is not None
    out = np.empty(span, np.int64)
    names = np.zeros(0, np.int32) if ids is None else ids
    status, taken = compiled.exact_decode(coded, names, out, work_of(ids), shift)
    if status:
        raise FormatError(
            "the coded bits do not end with their packet",
            requirement="RNG-001",
            offset=offset + min(taken, len(coded)),
        )
    return out
