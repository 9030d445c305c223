"""LPCR: indices of a grid, linear prediction, entropy coding (SPEC 9.5)."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..integers import build_svarint, parse_svarint, rdiv
from ..kernels import compiled
from .entropy import OUT_OF_RANGE, START_MOST, Decoder, Encoder, Signs, put_bits, put_integers
from .references import Reference, build_references, parse_references
from .sine import SINES

ORDER_LIMIT, DIFFERENCE_LIMIT = 32, 4
REPEATS, CONSTANT, REFERENCES, UNUSED = 8, 16, 64, 160
FOUR_STATES, SIGNS, UNUSED_CODING = 16, 32, 192
"""Of the byte before the coded bytes, whose lowest four bits are the class."""

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
    if compiled is not None:
        return predictor.build() + encode_compiled(indices, predictor, c, cross)
    return predictor.build() + encode_coded(indices, predictor, c, cross)


def encode_compiled(
    indices: NDArray[np.int64],
    predictor: Predictor,
    c: list[int],
    cross: NDArray[np.int64] | None,
) -> bytes:
    """``encode_coded``, in C; a packet that does not fit its buffer is written once more."""
    assert compiled is not None
    size, status = 2 * indices.size + 64, NO_ROOM
    plain = np.ascontiguousarray(indices, np.int64)
    beside = b"" if cross is None else cross
    while status == NO_ROOM:
        out = bytearray(size)
        taps = np.array(c, np.int32)
        status, size = compiled.lpcr_encode(
            out, taps, predictor.difference, predictor.repeats,
            predictor.base, INDEX_LIMIT, beside, plain,
        )  # fmt: skip
    if status:
        raise ValueError(OUT_OF_RANGE)
    return bytes(out[:size])


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
    if compiled is not None:
        return decode_compiled(coded, predictor, c, span, limit, at, cross)
    return np.frombuffer(decode_coded(coded, predictor, c, span, limit, at, cross), np.int64)


def decode_compiled(
    data: bytes,
    predictor: Predictor,
    c: list[int],
    span: int,
    limit: int,
    offset: int,
    cross: NDArray[np.int64] | None,
) -> NDArray[np.int64]:
    """``decode_coded``, in C."""
    assert compiled is not None
    out = np.empty(span, np.int64)
    taps = np.array(c, np.int32)
    status, taken = compiled.lpcr_decode(
        data, taps, predictor.difference, predictor.repeats, predictor.base, limit,
        b"" if cross is None else cross, out,
    )  # fmt: skip
    if status:
        requirement, message = STATUS[status]
        place = offset + min(taken, len(data))
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
    middle = 2 + REPEAT_CONTEXTS * predictor.repeats
    stop = middle + (SIGN_CONTEXTS if coding & SIGNS else 0)
    wrong = coding & UNUSED_CODING or len(data) < stop or data[1] > START_MOST
    if wrong or not all(data[2:stop]):
        raise FormatError("a coding that is not defined", requirement="RNG-004", offset=offset)
    return coding, data[2:middle], data[middle:stop], stop


def check_index(index: int, limit: int, offset: int) -> None:
    if abs(index) > limit:
        raise FormatError("index beyond the grid", requirement="LPC-003", offset=offset)
