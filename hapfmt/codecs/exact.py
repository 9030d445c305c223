"""LPCX: counts coded by LPCR, and corrections that restore the source's doubles exactly (SPEC 9.7).

A rule gives the double of a count, before correction. Each rule repeats the arithmetic of some
logger, in correctly rounded steps that are the same on every machine. Bit patterns of doubles are
also handled as integers, in the order of the values.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from ..format.layout import LPCX_PARAMETERS, LPCX_TERM
from ..format.track import Affine
from ..kernels import compiled
from ..limits import Level
from ..numbers import parse_varint
from .entropy import Decoder, Encoder, Lengths, bit_ends, probability, put_by_length, share_of
from .grids import UNIT_GRID
from .predicted import decode_moved, parts_of

QUOTIENT, PRODUCT, SIGNIFICANT, CUBIC, LINEAR = range(5)
PLACES_LIMIT, DIGITS_LIMIT = 22, 15
"""10^22 is the last power of ten that is a double, 10^15 the last below 2^53."""

DECIMALS, LAST_DIGITS = DIGITS_LIMIT + 1, 31
"""From here on the digits are counted behind the point."""

SAFE = 1 << 53

COEFFICIENTS, COEFFICIENT_LIMIT = 4, 2.0**900
"""Polynomials of 32-bit counts stay finite below this limit."""

TERMS_LIMIT = 16
"""Most terms of a linear rule."""

DOUBLE, BITS = struct.Struct("<d"), struct.Struct("<q")
LAST_PLACE, HALF = (1 << 63) - 1, 1 << 63

WIDE = 1 << 62
"""Products below are taken in 64 bits."""

Counts = NDArray[np.int64]
Doubles = NDArray[np.float64]


class LinearTerm(NamedTuple):
    """A term of a linear rule: the weight of a component's exact value some ticks before."""

    component: int
    lag: int
    weight: float


def values_of(
    counts: Counts, affine: Affine, rule: int, digits: int, coefficients: Sequence[float] = ()
) -> Doubles:
    """The double of each count [samples] by the rule; counts as VAL-001 allows them."""
    a, b, d = affine
    if rule == CUBIC:
        # NumPy has no fused multiply-add. The last sum turns -0.0 into 0.0.
        x, v = counts.astype(np.float64), np.full(counts.size, coefficients[-1])
        for each in coefficients[-2::-1]:
            v = v * x + each
        return np.asarray(v + 0.0)
    if rule == PRODUCT:
        product = counts.astype(np.float64) * (float(a) / float(d))
        return np.asarray(product + float(b) / float(d))
    quotients = (counts * a + b).astype(np.float64) / float(d)
    if rule == QUOTIENT:
        return np.asarray(quotients)
    distinct, places = np.unique(counts, return_inverse=True)
    if digits >= DECIMALS:
        given = distinct * a + b
        return many_in_decimals(given, d, digits - DECIMALS)[places]
    return many_in_digits(distinct * a + b, d, digits)[places]


def predictions(
    quotients: Doubles, c0: float, terms: Sequence[LinearTerm], columns: Sequence[Doubles]
) -> Doubles:
    """What a linear rule gives where all exact values are known; ``quotients``: what the counts of
    its component stand for."""
    size = quotients.size
    reach = min(max(term.lag for term in terms), size)
    total = np.full(size - reach, c0)
    with np.errstate(all="ignore"):
        for component, lag, weight in terms:
            total += weight * columns[component][reach - lag : size - lag]
    return np.concatenate(
        (quotients[:reach], np.where(np.isfinite(total), total + 0.0, quotients[reach:]))
    )


def linear_values(
    quotients: Doubles,
    c0: float,
    terms: Sequence[LinearTerm],
    columns: Sequence[Doubles],
    moves: Counts,
    own: int,
) -> Doubles:
    """The exact values of component ``own`` by its linear rule. ``quotients``: what its counts
    stand for; ``columns``: the exact values of those that are decoded before it; ``moves``: the
    places by which each value is corrected."""
    if all(term.component != own for term in terms):
        return by_places(predictions(quotients, c0, terms, columns), moves)
    # Views give Python's numbers one by one; lists would hold an object for each sample.
    found = np.empty(quotients.size)
    out: Any = found.data
    bits: Any = found.view(np.int64).data
    known: list[Any] = [out if place == own else x.data for place, x in enumerate(columns)]
    rows = [(known[term.component], term.lag, term.weight) for term in terms]
    reach = max(term.lag for term in terms)
    given: Any = zip(quotients.data, moves.data, strict=True)
    for t, (quotient, move) in enumerate(given):
        v = quotient
        if t >= reach:
            v = c0
            for x, lag, weight in rows:
                v += weight * x[t - lag]
        v = v + 0.0 if isfinite(v) else quotient
        out[t] = v
        if move:
            # NaN with its bits.
            bits[t] = bits_at(place_of(v) + move)
    return found


def place_of(double: float) -> int:
    """Its place in the order of doubles."""
    (bits,) = BITS.unpack(DOUBLE.pack(double))
    return int(bits if bits >= 0 else ~(bits & LAST_PLACE))


def bits_at(place: int) -> int:
    """The bits of the double at a place modulo 2^64."""
    place = (place + HALF) % (2 * HALF) - HALF
    return place if place >= 0 else ~place - HALF


def many_in_places(numerators: Counts, d: int, places: int) -> Doubles:
    """``in_places`` of each numerator at once where 64 bits hold it."""
    power, largest = 10**places, int(np.abs(numerators).max())
    if largest * power >= WIDE or 2 * d >= WIDE:
        slowly = (in_places(n, d, places) for n in numerators.data)
        return np.fromiter(slowly, np.float64, numerators.size)
    whole, rest = np.divmod(np.abs(numerators) * power, d)
    whole += (2 * rest > d) | ((2 * rest == d) & (whole % 2 == 1))
    # A quotient of two doubles is correctly rounded, these being integers below 2^53 and powers
    # of ten up to 10^22.
    return np.asarray(np.sign(numerators) * whole / float(power))


def many_in_decimals(numerators: Counts, d: int, places: int) -> Doubles:
    """Each numerator / d to ``places`` decimals; the quotient itself where these are 2^53 units
    and more."""
    found = numerators.astype(np.float64) / float(d)
    # |n| * 10^places / d rounds to less than 2^53.
    end = -(-((2 * SAFE - 1) * d) // (2 * 10**places))
    fits = np.abs(numerators) < min(end, WIDE)
    if fits.any():
        found[fits] = many_in_places(numerators[fits], d, places)
    return found


def many_in_digits(numerators: Counts, d: int, digits: int) -> Doubles:
    """``in_digits`` of each numerator, those with the same number of places at once."""
    n = np.abs(numerators)
    table = np.zeros(n.size)
    # n / d >= 10^power where n >= d * 10^power: powers at which another digit begins.
    powers = range(-len(str(d)), 18)
    starts = [-(-d // 10**-power) if power < 0 else d * 10**power for power in powers]
    starts = [min(start, WIDE) for start in starts]
    classes = np.searchsorted(np.array(starts, np.int64), n, side="right") - 1
    for at in np.unique(classes[n > 0]).tolist():
        places = min(digits - 1 - powers[at], PLACES_LIMIT)
        here = (classes == at) & (n > 0)
        if places >= 0:
            table[here] = many_in_places(numerators[here], d, places)
        else:
            unit = 10**-places
            table[here] = many_in_places(numerators[here], d * unit, 0) * float(unit)
    return table


def in_places(numerator: int, d: int, places: int) -> float:
    """numerator / d to ``places`` decimals, ties to even, below 2^53 units; as a double."""
    whole, rest = divmod(abs(numerator) * 10**places, d)
    whole += 2 * rest > d or (2 * rest == d and whole % 2)
    # A quotient of integers is correctly rounded in Python, whatever their size.
    return float((whole if numerator > 0 else -whole) / 10**places)


def in_digits(numerator: int, d: int, digits: int) -> float:
    """numerator / d to ``digits`` significant digits, ties to even; as a double."""
    if not numerator:
        return 0.0
    n = abs(numerator)
    # 10^power <= n / d < 10^(power + 1)
    power = len(str(n)) - len(str(d))
    if n * 10 ** max(-power, 0) < d * 10 ** max(power, 0):
        power -= 1
    places = min(digits - 1 - power, PLACES_LIMIT)
    if places >= 0:
        return in_places(numerator, d, places)
    unit = 10**-places
    return float(in_places(numerator, d * unit, 0) * unit)


LARGEST = np.int64((1 << 63) - 1)


def ordered(doubles: Doubles) -> Counts:
    """Bit patterns as signed integers that grow with the value; -0.0 is -1, 0.0 is 0."""
    bits = np.ascontiguousarray(doubles, "<f8").view(np.int64)
    return np.asarray(bits ^ (bits >> 63 & LARGEST))


def unordered(places: Counts) -> Doubles:
    """The doubles at these positions (SPEC 9.7, order)."""
    bits: NDArray[Any] = np.where(places < 0, ~places | ~LARGEST, places)
    return np.ascontiguousarray(bits, np.int64).view(np.float64)


def by_places(doubles: Doubles, moves: Counts) -> Doubles:
    """The doubles at the positions of ``doubles`` plus ``moves``, modulo 2^64."""
    if not moves.any():
        return doubles
    with np.errstate(over="ignore"):
        return unordered(ordered(doubles) + moves)


RECALL, FOUR_STATES = 1, 2
LENGTHS = 64
"""A correction has 0 to 63 bits."""

REMEMBERED = 32
"""Corrections that are remembered of a count."""

RANKS = 6
"""This many places on a list have a probability of their own: this encoder's choice."""

FRESH, SAME, KNOWN = range(3)
"""A count that was not met before in the packet, that of the sample before, another one."""

TABLED = 8
"""Counts whose range is at most so many times their number are ranked by a table."""

WORK = 2
"""Numbers of 64 bits for each sample, in which the compiled loops remember: a value, a link, and a
head for each count."""

NO_ROOM = 5
STATUS = {
    4: ("RNG-001", "the coded bytes do not end with their packet"),
    6: ("RNG-004", "the frequencies of corrections are not defined"),
}
"""What the compiled loop returns, as the readable one says it."""


@dataclass(frozen=True)
class ExactParameters:
    """How a count becomes a double, before the correction."""

    rule: int = 0
    digits: int = 0
    coefficients: tuple[float, ...] = ()
    """c0 to c3 of the cubic rule, c0 of the linear one."""

    terms: tuple[LinearTerm, ...] = ()

    def build(self) -> bytes:
        fixed = LPCX_PARAMETERS.build(
            rule=self.rule, digits=self.digits, terms=len(self.terms), reserved=0
        )
        numbers = np.array(self.coefficients, "<f8").tobytes()
        rows = (LPCX_TERM.build(a=a, lag=lag, w=w) for a, lag, w in self.terms)
        return fixed + numbers + b"".join(rows)

    @classmethod
    def parse(cls, data: bytes, offset: int) -> ExactParameters:
        (found,) = parse_parameters(data, 1, offset)
        return found

    @classmethod
    def parse_next(cls, data: bytes, at: int, base: int) -> tuple[ExactParameters, int]:
        """The parameters at ``at`` of the data, and their end; ``base``: offset of the data."""
        raw, offset = LPCX_PARAMETERS.parse(data, at, "COD-002", base), base + at
        if raw.reserved:
            place = offset + LPCX_PARAMETERS.offsets["reserved"]
            raise FormatError("reserved bytes are not 0", requirement="HED-005", offset=place)
        least, most = (1, LAST_DIGITS) if raw.rule == SIGNIFICANT else (0, 0)
        fewest, many = (1, TERMS_LIMIT) if raw.rule == LINEAR else (0, 0)
        fits = raw.rule <= LINEAR and least <= raw.digits <= most and fewest <= raw.terms <= many
        if not fits:
            raise FormatError(
                f"rule {raw.rule} with {raw.digits} digits and {raw.terms} terms",
                requirement="EXA-002",
                offset=offset,
            )
        at += LPCX_PARAMETERS.size
        count = COEFFICIENTS if raw.rule == CUBIC else int(raw.rule == LINEAR)
        stop = at + 8 * count + LPCX_TERM.size * raw.terms
        if stop > len(data):
            raise FormatError(
                "LPCX parameters end within a component", requirement="COD-002", offset=base
            )
        coefficients = np.frombuffer(data, "<f8", count, at).tolist()
        terms = [
            LinearTerm(*row) for row in LPCX_TERM.fixed.iter_unpack(data[at + 8 * count : stop])
        ]
        # The comparison also refuses NaN.
        if not all(abs(w) < COEFFICIENT_LIMIT for w in [*coefficients, *(t.weight for t in terms)]):
            raise FormatError(
                "a coefficient of 2^900 or more", requirement="EXA-002", offset=base + at
            )
        return cls(raw.rule, raw.digits, tuple(coefficients), tuple(terms)), stop

    def values(self, counts: Counts, affine: Affine) -> Doubles:
        """What counts stand for, of the linear rule by its rule 0."""
        rule = QUOTIENT if self.rule == LINEAR else self.rule
        return values_of(counts, affine, rule, self.digits, self.coefficients)


def parse_parameters(data: bytes, count: int, offset: int) -> tuple[ExactParameters, ...]:
    """The parameters of each component."""
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
                    requirement="EXA-002",
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


def decode_counts(
    data: bytes, span: int, count: int, level: Level, offset: int, low: int, high: int
) -> NDArray[np.int32]:
    """The counts [span, components] alone, which lie within their range: the exact values are not
    looked at."""
    coded, _, stop = split_packet(data, offset)
    at = stop - len(coded)
    counts, moved = decode_moved(coded, UNIT_GRID, span, count, level, at, low, high)
    if moved:
        raise FormatError(
            "a count with exact values outside the declared range",
            requirement="EXA-003",
            offset=offset,
        )
    return counts


def decode_exact(
    data: bytes,
    parameters: Sequence[ExactParameters],
    affines: Sequence[Affine],
    counts: NDArray[Any],
    offset: int,
    described: bytes = b"",
) -> Doubles:
    """The source's doubles [span, components], given the counts of the same packet. ``described``:
    the bytes of the parameters."""
    _, rest, at = split_packet(data, offset)
    if compiled is not None:
        out = np.empty(counts.T.shape)
        rows = np.ascontiguousarray(counts.T, np.int32)
        for place, each in enumerate(parameters):
            if each.rule == SIGNIFICANT:
                out[place] = each.values(rows[place].astype(np.int64), affines[place])
        described = described or b"".join(each.build() for each in parameters)
        if compiled.exact_packet(rest, described, np.array(affines, np.int64), rows, out):
            return out.T
    # Python decodes the rest, and reports which rule is broken.
    ends = parts_of(rest, len(parameters), at) if rest else [(0, 0)] * len(parameters)
    if ends is None:
        raise FormatError("parts larger than their packet", requirement="EXA-003", offset=at)
    out = np.empty((len(parameters), len(counts)))
    for place in in_order(parameters):
        start, stop = ends[place]
        column = counts[:, place].astype(np.int64)
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
    if len(rest) < 2 or rest[0] & ~(RECALL | FOUR_STATES) or rest[1] >= LENGTHS:
        raise FormatError("corrections that are not defined", requirement="EXA-003", offset=at)
    ids = ids_of(counts) if rest[0] & RECALL else None
    loop = decode_loop if compiled is None else decode_compiled
    return loop(rest, ids, counts.size, at) << rest[1]


def encode_exact(
    source: Doubles,
    parameters: ExactParameters,
    affine: Affine,
    counts: Counts,
    *,
    recall: bool,
) -> bytes:
    """What follows the counts in their packet. ValueError where a correction needs 64 bits."""
    return lacking_of(source, parameters, affine, counts).build(recall=recall)


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

    def build(self, *, recall: bool) -> bytes:
        if not self.corrections.any():
            return b""
        loop = encode_loop if compiled is None else encode_compiled
        return loop(self.corrections, self.ids if recall else None, self.shift)


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
    apart = x ^ y
    if int(apart.min(initial=0)) < 0:
        # Wrapped around, or the one number without a positive twin.
        far = (apart & (x ^ corrections)) < 0
        if far.any() or (corrections == np.iinfo(np.int64).min).any():
            raise ValueError("a correction of 2^63 or more")
    return corrections


def ids_of(counts: Counts) -> NDArray[np.int32]:
    """The place of each count among the distinct ones of its packet."""
    low = int(counts.min(initial=0))
    extent = int(counts.max(initial=0)) - low
    if extent < TABLED * counts.size:
        # As below, without sorting.
        seen = np.zeros(extent + 1, np.int32)
        seen[counts - low] = 1
        return np.asarray(np.cumsum(seen, dtype=np.int32)[counts - low] - 1, np.int32)
    return np.unique(counts, return_inverse=True)[1].astype(np.int32)


class Lists:
    """The corrections remembered of each count, the last one first: 16 bytes a sample, as in C."""

    def __init__(self, ids: NDArray[np.int32]) -> None:
        self.heads = array("i", [-1]) * (int(ids.max()) + 1)
        """For each count, where its first correction is."""
        self.corrections = array("q")
        self.links = array("i")
        """For each correction, where the next one of its count is."""
        self.last = -1

    def places(self, id_: int) -> list[int]:
        found, at = [], self.heads[id_]
        while at >= 0:
            found.append(at)
            at = self.links[at]
        return found

    def meet(self, id_: int) -> tuple[list[int], int]:
        """The corrections remembered for a count, and the context of its ranks."""
        known = [self.corrections[at] for at in self.places(id_)]
        context = FRESH if not known else SAME if id_ == self.last else KNOWN
        self.last = id_
        return known or [0], context

    def learn(self, id_: int, correction: int, rank: int) -> None:
        """``rank`` on the list of its count, -1 where it was coded in full."""
        places = self.places(id_)
        if places and rank >= 0:
            first = places.pop(rank)
        else:
            first = len(self.corrections)
            self.corrections.append(correction)
            self.links.append(-1)
        places = [first, *places][:REMEMBERED]
        self.heads[id_] = first
        for at, following in zip(places, [*places[1:], -1], strict=True):
            self.links[at] = following


@dataclass(frozen=True)
class Heading:
    """How probable the places on lists and the lengths of corrections are."""

    recalls: tuple[bytes, ...]
    """For a count without a list, for that of the tick before, for any other; or none."""

    lengths: Lengths

    def build(self) -> bytes:
        rows = b"".join(bytes([len(row)]) + row for row in self.recalls)
        return rows + self.lengths.build()

    @classmethod
    def parse(cls, data: bytes, *, recall: bool, offset: int) -> tuple[Heading, int]:
        """From its third byte on; and where the coded bytes begin."""
        position, rows = 2, []
        for _ in range(3 * recall):
            count = data[position] if position < len(data) else REMEMBERED + 1
            rows.append(data[position + 1 : position + 1 + count])
            if count > REMEMBERED or len(rows[-1]) < count or not all(rows[-1]):
                raise cls.undefined(offset)
            position += 1 + count
        lengths = Lengths.parse(data[position:])
        if lengths is None:
            raise cls.undefined(offset)
        return cls(tuple(rows), lengths), position + len(lengths.build())

    @staticmethod
    def undefined(offset: int) -> FormatError:
        requirement, message = STATUS[6]
        return FormatError(message, requirement=requirement, offset=offset)

    def probability(self, context: int, i: int) -> int:
        row = self.recalls[context]
        return row[min(i, len(row) - 1)] if row else 128


def encode_loop(corrections: Counts, ids: NDArray[np.int32] | None, shift: int) -> bytes:
    """What follows the counts; kernels/ has the same in C."""
    coder, full, marks = Encoder(), corrections.tolist(), []
    if ids is not None:
        lists, given, full = Lists(ids), full, []
        for c, id_ in zip(given, ids.tolist(), strict=True):
            known, context = lists.meet(id_)
            rank = known.index(c) if c in known else -1
            marks += [
                (context, min(i, RANKS - 1), int(i == rank))
                for i in range(len(known) if rank < 0 else rank + 1)
            ]
            lists.learn(id_, c, rank)
            if rank < 0:
                full.append(c)
    rows = [recall_row(marks, context) for context in range(3)]
    if ids is not None:
        coder.section(share_of(bit_ends(rows[context][i]), bit) for context, i, bit in marks)
    lengths = Lengths.of(full)
    put_by_length(coder, full, lengths)
    heading = Heading(() if ids is None else tuple(rows), lengths)
    flags = RECALL * (ids is not None) | FOUR_STATES * coder.many
    return bytes([flags, shift]) + heading.build() + coder.finish()


def recall_row(marks: list[tuple[int, int, int]], context: int) -> bytes:
    """Probabilities of the places on a list in one context, as far as they were used."""
    counts = [[0, 0] for _ in range(RANKS)]
    for at, i, bit in marks:
        if at == context:
            counts[i][bit] += 1
    used = max((i + 1 for i in range(RANKS) if any(counts[i])), default=0)
    return bytes(probability(*pair) for pair in counts[:used])


def decode_loop(rest: bytes, ids: NDArray[np.int32] | None, span: int, offset: int) -> Counts:
    """The corrections [span]."""
    heading, start = Heading.parse(rest, recall=ids is not None, offset=offset)
    coder = Decoder(rest[start:], offset + start, 4 if rest[0] & FOUR_STATES else 1)
    ranks = None if ids is None else decode_ranks(coder, heading, ids)
    coder.section()
    out = array("q")
    if ids is None or ranks is None:
        out.extend(coder.by_length(heading.lengths) for _ in range(span))
    else:
        lists = Lists(ids)
        for id_, rank in zip(ids.data, ranks, strict=True):
            known, _ = lists.meet(id_)
            c = coder.by_length(heading.lengths) if rank < 0 else known[rank]
            lists.learn(id_, c, rank)
            out.append(c)
    coder.finish()
    return np.frombuffer(out, np.int64)


def decode_ranks(coder: Decoder, heading: Heading, ids: NDArray[np.int32]) -> array[int]:
    """The place on the list of its count for each correction; -1 for those coded in full."""
    coder.section()
    sizes = bytearray(int(ids.max()) + 1)
    ranks = array("b")
    last = -1
    for id_ in ids.data:
        size = sizes[id_]
        context = FRESH if not size else SAME if id_ == last else KNOWN
        rank = -1
        for i in range(max(size, 1)):
            found = coder.symbol(bit_ends(heading.probability(context, i)))
            coder.check()
            if found:
                rank = i
                break
        ranks.append(rank)
        sizes[id_] = max(size, 1) if rank >= 0 else min(size + 1, REMEMBERED)
        last = id_
    return ranks


def encode_compiled(corrections: Counts, ids: NDArray[np.int32] | None, shift: int) -> bytes:
    """``encode_loop``, in C; what does not fit its buffer is written again."""
    assert compiled is not None
    plain = np.ascontiguousarray(corrections)
    names = np.zeros(0, np.int32) if ids is None else ids
    size, status = 7 * plain.size + 128, NO_ROOM
    while status == NO_ROOM:
        out, work = bytearray(size), np.zeros(WORK * names.size, np.int64)
        status, size = compiled.exact_encode(out, names, plain, work, shift)
    assert not status
    return bytes(out[:size])


def decode_compiled(rest: bytes, ids: NDArray[np.int32] | None, span: int, offset: int) -> Counts:
    """``decode_loop``, in C."""
    assert compiled is not None
    out = np.empty(span, np.int64)
    names = np.zeros(0, np.int32) if ids is None else ids
    work = np.zeros(WORK * names.size, np.int64)
    status, taken = compiled.exact_decode(rest, names, out, work, rest[1])
    if status:
        requirement, message = STATUS[status]
        place = offset + min(taken, len(rest))
        raise FormatError(message, requirement=requirement, offset=place)
    return out
