"""LPCX: counts by LPCR, and beside them what each lacks of the source's double (SPEC 9.7)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
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
from .components import decode_predicted, parts_of
from .grids import LpcParameters
from .values import (
    COEFFICIENT_LIMIT,
    COEFFICIENTS,
    CUBIC,
    LINEAR,
    QUOTIENT,
    Counts,
    Doubles,
    Term,
    by_places,
    linear_values,
    ordered,
    predictions,
    rule_fits,
    values_of,
)

TERM = struct.Struct("<BBd")

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
    """c0 to c3 of the cubic rule, c0 of the linear one."""

    terms: tuple[Term, ...] = ()

    def build(self) -> bytes:
        fields = {"rule": self.rule, "digits": self.digits, "terms": len(self.terms), "reserved": 0}
        numbers = np.array(self.coefficients, "<f8").tobytes()
        rows = b"".join(struct.pack("<BBd", *term) for term in self.terms)
        return bytes(LPCX_PARAMETERS.build(fields)) + numbers + rows

    @classmethod
    def parse(cls, data: bytes, offset: int) -> ExactParameters:
        (found,) = parse_parameters(data, 1, offset)
        return found

    @classmethod
    def parse_next(cls, data: bytes, at: int, base: int) -> tuple[ExactParameters, int]:
        """Those that stand at ``at`` of the data, and where they end; ``base``: of the data."""
        raw, offset = parse_fixed(LPCX_PARAMETERS, data, at, "COD-002", base), base + at
        if raw.reserved:
            raise FormatError("reserved bytes are not 0", requirement="HED-005", offset=offset + 3)
        if not rule_fits(raw.rule, raw.digits, raw.terms):
            raise FormatError(
                f"rule {raw.rule} with {raw.digits} digits and {raw.terms} terms",
                requirement="EXA-002",
                offset=offset,
            )
        at += LPCX_PARAMETERS.sizeof()
        count = COEFFICIENTS if raw.rule == CUBIC else int(raw.rule == LINEAR)
        stop = at + 8 * count + TERM.size * raw.terms
        if stop > len(data):
            raise FormatError(
                "LPCX parameters end within a component", requirement="COD-002", offset=base
            )
        coefficients = np.frombuffer(data, "<f8", count, at).tolist()
        terms = [Term(*row) for row in TERM.iter_unpack(data[at + 8 * count : stop])]
        # So is what is no number refused.
        if not all(abs(w) < COEFFICIENT_LIMIT for w in [*coefficients, *(t.weight for t in terms)]):
            raise FormatError(
                "a coefficient of 2^900 or more", requirement="EXA-008", offset=base + at
            )
        return cls(raw.rule, raw.digits, tuple(coefficients), tuple(terms)), stop

    def values(self, counts: Counts, affine: Affine) -> Doubles:
        """What counts stand for, of the linear rule by its rule 0."""
        rule = QUOTIENT if self.rule == LINEAR else self.rule
        return values_of(counts, affine, rule, self.digits, self.coefficients)


def parse_parameters(data: bytes, count: int, offset: int) -> tuple[ExactParameters, ...]:
    """Of each component."""
    found: list[ExactParameters] = []
    at = 0
    for _ in range(count):
        parameters, at = ExactParameters.parse_next(data, at, offset)
        found.append(parameters)
    if at < len(data):
        raise FormatError("bytes follow the LPCX parameters", requirement="COD-002", offset=offset)
    known: set[int] = set()
    for place in in_order(found):
        for term in found[place].terms:
            if term.component not in known and (term.component != place or not term.lag):
                raise FormatError(
                    f"component {place} from {term.component}, {term.lag} ticks before",
                    requirement="EXA-009",
                    offset=offset,
                )
        known.add(place)
    return tuple(found)


def in_order(parameters: Sequence[ExactParameters]) -> list[int]:
    """The components as they are decoded: linear ones last."""
    return sorted(range(len(parameters)), key=lambda place: parameters[place].rule == LINEAR)


def split_packet(data: bytes, offset: int) -> tuple[bytes, bytes, int]:
    """The packet of LPCR, the bytes of the exact values, and the offset of these."""
    size, start = parse_varint(data, 0, offset)
    if size > len(data) - start:
        raise FormatError("the counts run past their packet", requirement="EXA-003", offset=offset)
    return data[start : start + size], data[start + size :], offset + start + size


def decode_counts(data: bytes, span: int, count: int, level: Level, offset: int) -> Counts:
    """The counts [span, components] alone: the exact values are not looked at."""
    coded, _, stop = split_packet(data, offset)
    return decode_predicted(coded, LpcParameters(), span, count, level, stop - len(coded))


def decode_exact(
    data: bytes,
    parameters: Sequence[ExactParameters],
    affines: Sequence[Affine],
    counts: Counts,
    offset: int,
) -> Doubles:
    """The source's doubles [span, components], given the counts of the same packet."""
    _, rest, at = split_packet(data, offset)
    ends = parts_of(rest, len(parameters), at) if rest else [(0, 0)] * len(parameters)
    if ends is None:
        raise FormatError("parts larger than their packet", requirement="EXA-010", offset=at)
    out = np.empty((len(parameters), len(counts)))
    for place in in_order(parameters):
        start, stop = ends[place]
        column = np.ascontiguousarray(counts[:, place])
        moves = decode_moves(rest[start:stop], column, at + start)
        values = parameters[place].values(column, affines[place])
        if parameters[place].rule == LINEAR:
            c0, terms = parameters[place].coefficients[0], parameters[place].terms
            out[place] = linear_values(values, c0, terms, list(out), moves, place)
        else:
            out[place] = by_places(values, moves)
    return np.ascontiguousarray(out.T)


def decode_moves(rest: bytes, counts: Counts, at: int) -> Counts:
    """By how many places the values of a component are corrected, modulo 2^64."""
    if not rest:
        return np.zeros(counts.size, np.int64)
    if len(rest) < 2 or rest[0] & ~RECALL or rest[1] >= LENGTHS:
        raise FormatError("corrections that are not defined", requirement="EXA-004", offset=at)
    ids = ids_of(counts) if rest[0] & RECALL else None
    loop = decode_loop if compiled is None else decode_compiled
    corrections = loop(rest[2:], ids, counts.size, rest[1], at + 2)
    return corrections << rest[1]


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
    source: Doubles,
    parameters: ExactParameters,
    affine: Affine,
    counts: Counts,
    sources: Sequence[Doubles] = (),
) -> Lacking:
    """``sources``: of all components, where the rule is linear."""
    doubles = parameters.values(counts, affine)
    if parameters.rule == LINEAR:
        doubles = predictions(doubles, parameters.coefficients[0], parameters.terms, sources)
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
