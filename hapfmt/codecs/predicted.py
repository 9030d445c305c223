"""LPCR: indices of a grid, linear prediction, entropy coding (SPEC 9.5).

A packet has one component packet per component. A component may also be predicted from earlier
components of the packet, its references. The table of SPEC Annex C holds the reflection
coefficients: 32768 * sin(pi * k / 256), rounded to nearest.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..kernels import compiled
from ..limits import Level
from ..numbers import build_svarint, build_varint, parse_svarint, parse_varint, rdiv
from .entropy import (
    OUT_OF_RANGE,
    START_MOST,
    Decoder,
    Encoder,
    Signs,
    put_bits,
    put_integers,
    quiet_section,
)
from .grids import LpcParameters, levels_of

SINES = (
    0, 402, 804, 1206, 1608, 2009, 2411, 2811,
    3212, 3612, 4011, 4410, 4808, 5205, 5602, 5998,
    6393, 6787, 7180, 7571, 7962, 8351, 8740, 9127,
    9512, 9896, 10279, 10660, 11039, 11417, 11793, 12167,
    12540, 12910, 13279, 13646, 14010, 14373, 14733, 15091,
    15447, 15800, 16151, 16500, 16846, 17190, 17531, 17869,
    18205, 18538, 18868, 19195, 19520, 19841, 20160, 20475,
    20788, 21097, 21403, 21706, 22006, 22302, 22595, 22884,
    23170, 23453, 23732, 24008, 24279, 24548, 24812, 25073,
    25330, 25583, 25833, 26078, 26320, 26557, 26791, 27020,
    27246, 27467, 27684, 27897, 28106, 28311, 28511, 28707,
    28899, 29086, 29269, 29448, 29622, 29792, 29957, 30118,
    30274, 30425, 30572, 30715, 30853, 30986, 31114, 31238,
    31357, 31471, 31581, 31686, 31786, 31881, 31972, 32058,
    32138, 32214, 32286, 32352, 32413, 32470, 32522, 32568,
    32610, 32647, 32679, 32706, 32729, 32746, 32758, 32766,
)  # fmt: skip
"""K(k) for k = 0 ... 127; K(-k) = -K(k)."""


REFERENCE_LIMIT = 8
REFERENCE_SIZE = 4
TAPS = (-1, 0, 1)
"""Ticks of a reference, relative to the tick that is decoded."""


class Reference(NamedTuple):
    """A component before this one, and 64 times what each of its ``TAPS`` counts for."""

    component: int
    weights: tuple[int, int, int]

    def build(self) -> bytes:
        return bytes([self.component, *(weight & 0xFF for weight in self.weights)])


def build_references(references: tuple[Reference, ...]) -> bytes:
    return bytes([len(references)]) + b"".join(each.build() for each in references)


def parse_references(
    data: bytes, position: int, place: int, offset: int
) -> tuple[tuple[Reference, ...], int]:
    """The references of the component at ``place``, and the position after them."""
    count = data[position] if position < len(data) else 0
    end = position + 1 + REFERENCE_SIZE * count
    if end > len(data):
        raise TruncatedError(
            "the packet ends within its references", requirement="LPC-006", offset=offset + position
        )
    references = []
    for at in range(position + 1, end, REFERENCE_SIZE):
        weights = tuple(byte - 256 if byte > 127 else byte for byte in data[at + 1 : at + 4])
        references.append(Reference(data[at], weights))  # type: ignore[arg-type]
    components = [each.component for each in references]
    rising = all(a < b for a, b in zip(components, [*components[1:], place], strict=False))
    if not 1 <= count <= REFERENCE_LIMIT or not rising:
        raise FormatError(
            "references that are not defined", requirement="LPC-007", offset=offset + position
        )
    return tuple(references), end


ORDER_LIMIT, DIFFERENCE_LIMIT = 32, 4
REPEATS, CONSTANT, REFERENCES, UNUSED = 8, 16, 64, 160
FOUR_STATES, SIGNS, BY_BITS, UNUSED_CODING = 16, 32, 64, 192
"""Bits of the byte before the coded bytes; its lowest four bits are the class. With BY_BITS
no other bit is set."""

REPEAT_CONTEXTS, SIGN_CONTEXTS = 4, 3
STEP_UP_LIMIT = 1 << 36
COEFFICIENT_LIMIT = 1 << 21
SHIFT = 13
"""Coefficients are multiples of 2**-13."""

TABLE = np.array(SINES, np.int32)

INDEX_LIMIT = 1 << 32
"""Largest magnitude of an index at any level."""

STATUS = {
    2: ("RNG-003", "a magnitude of 2^34 or more"),
    3: ("LPC-003", "index beyond the grid"),
    4: ("RNG-001", "the coded bytes do not end with their packet"),
    6: ("RNG-004", "a coding that is not defined"),
}
"""What the compiled loop returns, as the readable one says it."""

NO_ROOM = 5
"""The encoder's buffer was too small; the size it takes is returned."""


@dataclass(frozen=True)
class Predictor:
    """The header of a component packet: difference order, reflection coefficients, base, whether
    unchanged samples are marked, and the components that it refers to."""

    difference: int = 0
    reflections: tuple[int, ...] = ()
    base: int = 0
    repeats: bool = False
    references: tuple[Reference, ...] = ()

    def build(self) -> bytes:
        flags = self.difference | self.repeats * REPEATS
        ks = bytes(k & 0xFF for k in self.reflections)
        if self.references:
            flags, ks = flags | REFERENCES, ks + build_references(self.references)
        return bytes([flags, len(self.reflections)]) + ks + build_svarint(self.base)

    @cached_property
    def coefficients(self) -> list[int] | None:
        """c[1..m], or None where LPC-005 is broken."""
        return step_up(self.reflections)


def step_up(reflections: Sequence[int]) -> list[int] | None:
    """Reflection coefficients to predictor coefficients, in integers; None: out of range."""
    if compiled is not None:
        out = np.zeros(len(reflections), np.int32)
        fits = compiled.step_up(np.array(reflections, np.int8), TABLE, out)
        return out.tolist() if fits else None
    p: list[int] = []
    for index in reflections:
        k = SINES[index] if index >= 0 else -SINES[-index]
        p = [x - rdiv(k * y, 1 << 15) for x, y in zip(p, reversed(p), strict=True)] + [k << 5]
        if max(map(abs, p)) > STEP_UP_LIMIT:
            return None
    c = [rdiv(x, 1 << 7) for x in p]
    return c if max(map(abs, c), default=0) <= COEFFICIENT_LIMIT else None


def parse_header(data: bytes, offset: int, place: int = 0) -> tuple[Predictor, bool, int]:
    """The header of the component at ``place``, whether it is constant, and where the coded bits
    begin."""
    if len(data) < 2 or len(data) < 2 + data[1]:
        raise TruncatedError(
            "the packet ends within its header", requirement="LPC-006", offset=offset
        )
    flags, order = data[0], data[1]
    difference, constant = flags & 7, bool(flags & CONSTANT)
    ks = tuple(byte - 256 if byte > 127 else byte for byte in data[2 : 2 + order])
    wrong = (
        difference > (1 if order else DIFFERENCE_LIMIT)
        or order > ORDER_LIMIT
        or flags & UNUSED
        or -128 in ks
        or (constant and (order or flags != CONSTANT))
    )
    if wrong:
        raise FormatError("a predictor that is not defined", requirement="LPC-004", offset=offset)
    references: tuple[Reference, ...] = ()
    position = 2 + order
    if flags & REFERENCES:
        references, position = parse_references(data, position, place, offset)
    base, position = parse_svarint(data, position, offset)
    predictor = Predictor(difference, ks, base, bool(flags & REPEATS), references)
    return predictor, constant, position


def encode_indices(
    indices: NDArray[np.int64], predictor: Predictor, cross: NDArray[np.int64] | None = None
) -> bytes:
    """The packet; a constant one where all indices are the same. ``cross``: x of SPEC 9.5.

    ValueError where an index is beyond 2**32, or a prediction error needs 34 bits and more.
    """
    if max(-int(indices.min()), int(indices.max()), abs(predictor.base)) > INDEX_LIMIT:
        raise ValueError(OUT_OF_RANGE)
    if (indices == indices[0]).all():
        return bytes([CONSTANT, 0]) + build_svarint(int(indices[0]))
    return encode_predicted(indices, predictor, cross)


def encode_predicted(
    indices: NDArray[np.int64], predictor: Predictor, cross: NDArray[np.int64] | None = None
) -> bytes:
    """``encode_indices`` where it is known that they differ."""
    c = predictor.coefficients
    if c is None:
        raise ValueError("a predictor out of range")
    if compiled is None:
        return predictor.build() + encode_coded(indices, predictor, c, cross)
    size, status = 2 * indices.size + 64, NO_ROOM
    plain = np.ascontiguousarray(indices, np.int64)
    beside = b"" if cross is None else cross
    # A packet that does not fit its buffer is written again.
    while status == NO_ROOM:
        out = bytearray(size)
        taps = np.array(c, np.int32)
        status, size = compiled.lpcr_encode(
            out, taps, predictor.difference, predictor.repeats,
            predictor.base, INDEX_LIMIT, beside, plain,
        )  # fmt: skip
    if status:
        raise ValueError(OUT_OF_RANGE)
    return predictor.build() + bytes(out[:size])


def encode_coded(
    indices: NDArray[np.int64],
    predictor: Predictor,
    c: list[int],
    cross: NDArray[np.int64] | None,
) -> bytes:
    """From the coding to the end, in the order of the SPEC; kernels/ has the same in C."""
    errors = errors_of(differences(indices - predictor.base, predictor.difference), c)
    if cross is not None:
        errors = errors - cross
    coder, repeats, marks = Encoder(), b"", b""
    if predictor.repeats:
        same = (np.diff(indices) == 0).astype(np.int64)
        repeats = put_bits(coder, same.tolist())
        errors = errors[np.concatenate(([0], same)) == 0]
    numbers = errors.tolist()
    if quiet := quiet_section(numbers):
        coder.many_pay = False
        quiet.put(coder)
        return bytes([BY_BITS]) + repeats + coder.finish()
    signs = Signs.of(numbers)
    number, start = put_integers(coder, numbers, signs=not signs.pay)
    if signs.pay:
        signs.put(coder)
        marks = signs.probabilities
    coding = number | coder.many * FOUR_STATES | signs.pay * SIGNS
    return bytes([coding, start]) + repeats + marks + coder.finish()


def errors_of(y: NDArray[np.int64], c: list[int]) -> NDArray[np.int64]:
    """What is left of y; float64 sums are exact below 2**53, in any order."""
    if not c or y.size == 1:
        return y
    exact = int(np.abs(y).max()) * sum(map(abs, c)) < 1 << 52
    dtype = np.float64 if exact else np.int64
    sums = np.convolve(y[:-1].astype(dtype), np.array(c, dtype))[: y.size - 1]
    predictions = np.zeros(y.size, np.int64)
    predictions[1:] = (sums.astype(np.int64) + (1 << (SHIFT - 1))) >> SHIFT
    return y - predictions


def differences(z: NDArray[np.int64], order: int) -> NDArray[np.int64]:
    """D^g z, with zeros before the first."""
    for _ in range(order):
        z = np.diff(z, prepend=0)
    return z


def predict(c: list[int], history: list[int]) -> int:
    return (sum(a * b for a, b in zip(c, history, strict=True)) + (1 << (SHIFT - 1))) >> SHIFT


def decode_indices(data: bytes, span: int, limit: int, offset: int) -> NDArray[np.int64]:
    """Indices [span], each of a magnitude of at most ``limit``."""
    predictor, constant, position = parse_header(data, offset)
    return decode_body(data, predictor, constant, position, span, limit, offset, None)


def decode_body(
    data: bytes,
    predictor: Predictor,
    constant: bool,
    position: int,
    span: int,
    limit: int,
    offset: int,
    cross: NDArray[np.int64] | None,
) -> NDArray[np.int64]:
    """What follows the header, from ``position`` on; ``cross``: x of SPEC 9.5."""
    check_index(predictor.base, limit, offset)
    if constant:
        if position != len(data):
            raise FormatError(
                "bytes left over after a constant", requirement="COD-001", offset=offset + position
            )
        return np.full(span, predictor.base, np.int64)
    c = predictor.coefficients
    if c is None:
        raise FormatError("predictor out of range", requirement="LPC-005", offset=offset + 2)
    coded, at = data[position:], offset + position
    if compiled is None:
        return np.frombuffer(decode_coded(coded, predictor, c, span, limit, at, cross), np.int64)
    out = np.empty(span, np.int64)
    taps = np.array(c, np.int32)
    status, taken = compiled.lpcr_decode(
        coded, taps, predictor.difference, predictor.repeats, predictor.base, limit,
        b"" if cross is None else cross, out,
    )  # fmt: skip
    if status:
        requirement, message = STATUS[status]
        place = at + min(taken, len(coded))
        raise FormatError(message, requirement=requirement, offset=place)
    return out


def decode_coded(
    data: bytes,
    predictor: Predictor,
    c: list[int],
    span: int,
    limit: int,
    offset: int,
    cross: NDArray[np.int64] | None,
) -> array[int]:
    """The readable loop; kernels/ has the same in C."""
    coding, repeats, signs, start = parse_coding(data, predictor, offset)
    coder = Decoder(data[start:], offset + start, 4 if coding & FOUR_STATES else 1)
    same = b"\0" + coder.bits(span - 1, repeats) if predictor.repeats else bytes(span)
    if coding == BY_BITS:
        errors = coder.by_bits(same.count(0), signs=True)
    else:
        errors = coder.integers(same.count(0), coding & 15, data[1], signs=not signs)
    if signs:
        errors = coder.signed(errors, signs)
    coder.finish()
    # sums[i] is D^i z at the tick before.
    sums = [0] * (predictor.difference + 1)
    history = [0] * len(c)
    indices = array("q")
    beside = bytes(span) if cross is None else cross.data
    following = iter(errors)
    for t in range(span):
        if same[t]:
            new = [sums[0]]
            for before in sums[:-1]:
                new.append(new[-1] - before)
        else:
            y = predict(c, history) + beside[t] + next(following)
            new = [0] * len(sums)
            new[-1] = y
            for i in range(len(sums) - 2, -1, -1):
                new[i] = new[i + 1] + sums[i]
        sums = new
        check_index(sums[0] + predictor.base, limit, coder.place)
        if c:
            history = [sums[-1], *history[:-1]]
        indices.append(sums[0] + predictor.base)
    return indices


def parse_coding(data: bytes, predictor: Predictor, offset: int) -> tuple[int, bytes, bytes, int]:
    """The byte that says how symbols are coded, the probabilities of repeats and of signs, and
    where the coded bytes begin."""
    coding = data[0] if data else UNUSED_CODING
    first = 1 if coding == BY_BITS else 2
    middle = first + REPEAT_CONTEXTS * predictor.repeats
    stop = middle + (SIGN_CONTEXTS if coding & SIGNS else 0)
    wrong = first == 2 and (coding & UNUSED_CODING or data[1:2] > bytes([START_MOST]))
    if wrong or len(data) < stop or not all(data[first:stop]):
        raise FormatError("a coding that is not defined", requirement="RNG-004", offset=offset)
    return coding, data[first:middle], data[middle:stop], stop


def check_index(index: int, limit: int, offset: int) -> None:
    if abs(index) > limit:
        raise FormatError("index beyond the grid", requirement="LPC-003", offset=offset)


Indices = NDArray[np.int64]

BLOCK = 1 << 16
"""Ticks whose counts are computed at once: this takes little memory compared with the counts."""

WEIGHT_SHIFT = 6
"""Weights are multiples of 2**-6."""


def prediction_errors(indices: Indices, difference: int, c: list[int], base: int) -> Indices:
    """Prediction errors of all indices, no matter which of them are coded."""
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
    """Start and end of each part. The sizes of all parts but the last come first; None if they
    exceed the data."""
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
    """The packet ``data`` at ``offset``, as counts [span, components]."""
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
    counts, _ = decode_moved(data, parameters, span, count, level, offset, low, high)
    return counts


def decode_moved(
    data: bytes,
    parameters: LpcParameters,
    span: int,
    count: int,
    level: Level,
    offset: int,
    low: int,
    high: int,
) -> tuple[NDArray[np.int32], bool]:
    """``decode_predicted``, clamped; and whether a count lay outside."""
    bound = level.count_bound
    limit = parameters.index_limit(bound)
    if compiled is not None:
        out = np.empty((count, span), np.int32)
        found = compiled.lpcr_packet(
            data, count, limit, parameters.step or 1, parameters.zero,
            levels_of(parameters, bound), low, high, TABLE, out,
        )  # fmt: skip
        if found:
            return out.T, found > 1
    # Python decodes the rest, and reports which rule is broken.
    counts = np.empty((span, count), np.int32)
    moved = False
    for place, indices in enumerate(decode_components(data, span, count, limit, offset)):
        for first in range(0, span, BLOCK):
            part = parameters.counts(indices[first : first + BLOCK], bound)
            counts[first : first + BLOCK, place] = within = np.clip(part, low, high)
            moved = moved or bool((within != part).any())
    return counts, moved
