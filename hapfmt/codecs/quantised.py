"""QUAN: a mid-tread quantiser with canonical Huffman code words and zero runs (SPEC 9.2).

Code words have extra bits; the codebook stores their lengths in nibbles. Bit fields are written
most significant bit first. Decoding looks up the symbol that *would* start at every bit of a block,
all at once. Then it walks from each code word to the next; only this walk is sequential.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..format.layout import QUAN_PARAMETERS
from ..kernels import compiled
from ..limits import Level

LENGTH_LIMIT = 15
"""A nibble holds the length."""

LENGTH_MASK = (1 << LENGTH_LIMIT) - 1
SHIFTS = np.arange(24 - LENGTH_LIMIT, 24 - LENGTH_LIMIT - 8, -1, dtype=np.int32)
"""What moves the 15 bits from bit 0 to 7 of a byte to the right end of three bytes."""

BLOCK_SIZE = 1 << 14
"""Bytes looked up at once: 2**17 bit positions, about 4 MB of tables."""


def code_lengths(frequencies: NDArray[np.int64]) -> NDArray[np.int64]:
    """Lengths [symbols] of a minimum-redundancy prefix code of at most 15 bits; 0 where the
    frequency is 0. One used symbol has length 1. (Huffman 1952, doi:10.1109/JRPROC.1952.273898)"""
    used = np.flatnonzero(frequencies)
    lengths = np.zeros(frequencies.size, np.int64)
    if used.size <= 1:
        lengths[used] = 1
        return lengths
    weights = frequencies[used]
    while True:
        depths = tree_depths([int(w) for w in weights])
        if max(depths) <= LENGTH_LIMIT:
            lengths[used] = depths
            return lengths
        # Flattening the frequencies shortens the longest word, and costs next to nothing.
        weights = (weights + 1) // 2


def tree_depths(weights: list[int]) -> list[int]:
    """Depth of each leaf of a Huffman tree; ties go to the earlier node, so it is one tree."""
    size = len(weights)
    parent = [0] * (2 * size - 1)
    # Leaves by weight, and inner nodes, which are made in the order of theirs: the lightest node
    # is always the first of one of the two.
    order = sorted(range(size), key=weights.__getitem__)
    leaves: list[float] = [*(weights[leaf] for leaf in order), inf]
    sums: list[float] = []
    leaf = inner = 0
    for node in range(size, len(parent)):
        total = 0.0
        for _ in range(2):
            if inner < len(sums) and sums[inner] < leaves[leaf]:
                total += sums[inner]
                parent[size + inner] = node
                inner += 1
            else:
                total += leaves[leaf]
                parent[order[leaf]] = node
                leaf += 1
        sums.append(total)
    depth = [0] * len(parent)
    for node in range(len(parent) - 2, -1, -1):
        depth[node] = depth[parent[node]] + 1
    return depth[: len(weights)]


def build_codebook(lengths: NDArray[np.int64]) -> bytes:
    """Lengths as nibbles; a run of n + 1 symbols without a code word is 0, n."""
    nibbles: list[int] = []
    skipped = 0
    for length in lengths.tolist():
        if length == 0:
            skipped += 1
            continue
        while skipped:
            run = min(skipped, 16)
            nibbles += [0, run - 1]
            skipped -= run
        nibbles.append(length)
    if len(nibbles) % 2:
        nibbles.append(0)
    return bytes(16 * a + b for a, b in zip(nibbles[::2], nibbles[1::2], strict=True))


def parse_codebook(data: bytes, symbols: int, offset: int) -> NDArray[np.int64]:
    """Lengths [symbols] from nibbles; QNT-003 checked."""
    nibbles = [nibble for byte in data for nibble in (byte >> 4, byte & 15)]
    lengths: list[int] = []
    position = 0
    while position < len(nibbles):
        nibble = nibbles[position]
        position += 1
        if nibble:
            lengths.append(nibble)
        elif position < len(nibbles):
            lengths += [0] * (nibbles[position] + 1)
            position += 1
        if len(lengths) > symbols:
            raise FormatError(
                "more code words than symbols", requirement="QNT-003", offset=offset + position // 2
            )
    out = np.zeros(symbols, np.int64)
    out[: len(lengths)] = lengths
    used = out[out > 0]
    complete = int((1 << (LENGTH_LIMIT - used)).sum()) == 1 << LENGTH_LIMIT
    if not complete and used.tolist() != [1]:
        raise FormatError("code words are not complete", requirement="QNT-003", offset=offset)
    return out


@dataclass(frozen=True)
class Codebook:
    """Code word length and number of extra bits of each symbol, both [symbols]."""

    lengths: NDArray[np.int64]
    extra_bits: NDArray[np.int64]

    @cached_property
    def only(self) -> int | None:
        """The symbol, where there is one only; it takes no bits."""
        used = np.flatnonzero(self.lengths)
        return int(used[0]) if used.size == 1 else None

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """Symbols with a code word, in canonical order."""
        used = np.flatnonzero(self.lengths)
        return used[np.argsort(self.lengths[used], kind="stable")]

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """Code word of each symbol in canonical order, shifted up to 15 bits."""
        widths = np.int64(1) << (LENGTH_LIMIT - self.lengths[self.order])
        starts: NDArray[np.int64] = np.cumsum(widths) - widths
        return starts

    @cached_property
    def codes(self) -> NDArray[np.int64]:
        """Code word [symbols], right-aligned."""
        codes = np.zeros(self.lengths.size, np.int64)
        codes[self.order] = self.starts >> (LENGTH_LIMIT - self.lengths[self.order])
        return codes

    @cached_property
    def widths(self) -> NDArray[np.int64]:
        """Bits that each symbol's code word takes in a packet [symbols]."""
        return self.lengths if self.only is None else np.zeros_like(self.lengths)

    @cached_property
    def lookup(self) -> NDArray[np.int16]:
        """Symbol for each value of the next 15 bits."""
        if self.only is not None:
            return np.full(1 << LENGTH_LIMIT, self.only, np.int16)
        runs = np.int64(1) << (LENGTH_LIMIT - self.lengths[self.order])
        return np.repeat(self.order, runs).astype(np.int16)

    @cached_property
    def totals(self) -> NDArray[np.int64]:
        """Bits of each symbol with its extra bits [symbols]."""
        return self.widths + self.extra_bits


def decode_blocks(
    data: bytes, book: Codebook
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Symbols and the bit position of each, block by block, to the end of ``data``.

    The bits that fill the last byte come out as symbols too, and the last symbol may reach beyond
    the data: the caller, who knows how many levels there are, cuts them off.
    """
    totals = book.totals.astype(np.uint8)
    if book.only is not None and not totals[book.only]:
        return
    raw = np.frombuffer(data + bytes(2), np.uint8)
    bits = 8 * len(data)
    position = 0
    for first in range(0, len(data), BLOCK_SIZE):
        block = raw[first : first + BLOCK_SIZE + 2].astype(np.int32)
        three = block[:-2] << 16 | block[1:-1] << 8 | block[2:]
        windows = (three[:, None] >> SHIFTS) & LENGTH_MASK
        symbols = book.lookup[windows.reshape(-1)]
        jumps = totals[symbols].tobytes()
        at = position - 8 * first
        stop = min(8 * BLOCK_SIZE, bits - 8 * first)
        positions: list[int] = []
        add = positions.append
        while at < stop:
            add(at)
            at += jumps[at]
        position = 8 * first + at
        here = np.array(positions, np.int64)
        yield symbols[here].astype(np.int64), here + 8 * first


def read_bits(
    data: bytes, positions: NDArray[np.int64], widths: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Bit fields of 0 to 33 bits at any bit positions; bits beyond the data read as 0."""
    raw = np.frombuffer(data + bytes(8), np.uint8)
    at = np.minimum(positions >> 3, len(data))
    value = np.zeros(positions.size, np.int64)
    for index in range(5):
        value = value << 8 | raw[at + index]
    return (value >> (40 - (positions & 7) - widths)) & ((np.int64(1) << widths) - 1)


BLOCK_FIELDS = 1 << 16
"""Fields expanded to single bits at a time: bounds memory, whatever the packet."""


def pack_bits(values: NDArray[np.int64], widths: NDArray[np.int64]) -> bytes:
    """Each value in its width of bits, 0 to 62, one after the other, zero bits to fill the byte."""
    parts: list[NDArray[np.uint8]] = []
    for at in range(0, values.size, BLOCK_FIELDS):
        value, width = values[at : at + BLOCK_FIELDS], widths[at : at + BLOCK_FIELDS]
        stops = np.cumsum(width)
        total = int(stops[-1])
        below = np.repeat(stops, width) - 1 - np.arange(total)
        parts.append(((np.repeat(value, width) >> below) & 1).astype(np.uint8))
    return np.packbits(np.concatenate(parts)).tobytes() if parts else b""


SYMBOL_LIMIT = 4096
RUN_LIMIT = 24
ESCAPE_LIMIT = 32
NO_WORD = "a level has no code word in this codebook"


def quantise(e: NDArray[np.int64], step: int) -> NDArray[np.int64]:
    """Levels: rdiv(e, step), so the level times the step is within step / 2 of e."""
    return (2 * e + step) // (2 * step)


def bit_length(x: NDArray[np.int64]) -> NDArray[np.int64]:
    """Bits of positive integers below 2**53; frexp of an exact float64 is exact."""
    return np.frexp(x.astype(np.float64))[1].astype(np.int64)


@dataclass(frozen=True)
class Alphabet:
    """The numbering of symbols: M direct levels each way, R zero runs, C escapes."""

    direct_levels: int
    run_classes: int
    escape_classes: int

    @property
    def size(self) -> int:
        return 2 * self.direct_levels + self.run_classes + self.escape_classes + 1

    @property
    def first_run(self) -> int:
        """Symbol 2M + 1, which is run class 1."""
        return 2 * self.direct_levels + 1

    @property
    def first_escape(self) -> int:
        return self.first_run + self.run_classes

    @cached_property
    def extra_bits(self) -> NDArray[np.int64]:
        return np.concatenate(
            (
                np.zeros(self.first_run, np.int64),
                np.arange(1, self.run_classes + 1),
                np.arange(1, self.escape_classes + 1),
            )
        )

    def tokenise(self, levels: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Symbols and their extra bits for levels in the order of the packet."""
        zero = levels == 0
        edges = np.flatnonzero(np.diff(zero.astype(np.int8), prepend=0, append=0))
        starts, lengths = edges[::2], edges[1::2] - edges[::2]
        longest = (2 << self.run_classes) - 1
        pieces = -(-lengths // longest)
        # Runs longer than the longest symbol: whole pieces, then the rest.
        run = np.repeat(lengths, pieces)
        first = np.repeat(np.cumsum(pieces) - pieces, pieces)
        nth = np.arange(run.size) - first
        run = np.minimum(run - nth * longest, longest)
        at = np.concatenate((np.flatnonzero(~zero), np.repeat(starts, pieces) + nth * longest))
        run_class = bit_length(run) - 1
        run_symbol = np.where(run_class > 0, self.first_run + run_class - 1, 0)
        level_symbol, level_extra = self.level_symbols(levels[~zero])
        symbols = np.concatenate((level_symbol, run_symbol))
        extra = np.concatenate((level_extra, run - (np.int64(1) << run_class)))
        order = np.argsort(at, kind="stable")
        return symbols[order], extra[order]

    def level_symbols(
        self, levels: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Symbols and extra bits of levels that are not 0."""
        magnitude = np.abs(levels)
        beyond = np.maximum(magnitude - self.direct_levels, 1)
        escape = bit_length(beyond) - 1
        rest = beyond - (np.int64(1) << escape)
        direct = magnitude <= self.direct_levels
        symbols = np.where(direct, 2 * magnitude - (levels > 0), self.first_escape + escape)
        return symbols, np.where(direct, 0, rest << 1 | (levels < 0))

    def expand(
        self, symbols: NDArray[np.int64], extra: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The level that each symbol stands for, and how often."""
        half = (symbols + 1) >> 1
        levels = np.where(symbols & 1, half, -half)
        counts = np.ones_like(symbols)
        run = symbols >= self.first_run
        levels[run] = 0
        run &= symbols < self.first_escape
        counts[run] = (np.int64(1) << (symbols[run] - self.first_run + 1)) + extra[run]
        escape = symbols >= self.first_escape
        base = np.int64(1) << (symbols[escape] - self.first_escape)
        magnitude = self.direct_levels + base + (extra[escape] >> 1)
        levels[escape] = np.where(extra[escape] & 1, -magnitude, magnitude)
        return levels, counts


@dataclass(frozen=True)
class QuanParameters:
    """Counts per level, the alphabet, and the code word length of each symbol."""

    step: int
    alphabet: Alphabet
    lengths: NDArray[np.int64]

    @cached_property
    def book(self) -> Codebook:
        return Codebook(self.lengths, self.alphabet.extra_bits)

    @cached_property
    def given(self) -> tuple[NDArray[np.uint8], int, int, int]:
        """Lengths and alphabet, as the compiled loops take them."""
        alphabet = self.alphabet
        return (
            self.lengths.astype(np.uint8),
            alphabet.direct_levels,
            alphabet.run_classes,
            alphabet.escape_classes,
        )

    def build(self) -> bytes:
        fixed = QUAN_PARAMETERS.build(
            step=self.step,
            direct_levels=self.alphabet.direct_levels,
            run_classes=self.alphabet.run_classes,
            escape_classes=self.alphabet.escape_classes,
        )
        return fixed + build_codebook(self.lengths)

    @classmethod
    def parse(cls, data: bytes, level: Level, offset: int) -> QuanParameters:
        raw = QUAN_PARAMETERS.parse(data, 0, "COD-002", offset)
        alphabet = Alphabet(raw.direct_levels, raw.run_classes, raw.escape_classes)
        if raw.step < 1:
            raise FormatError("step of 0", requirement="QNT-001", offset=offset)
        level.check("step", raw.step, "QNT-001", offset)
        if (
            alphabet.size > SYMBOL_LIMIT
            or raw.run_classes > RUN_LIMIT
            or raw.escape_classes > ESCAPE_LIMIT
        ):
            raise FormatError(
                "alphabet too large",
                requirement="QNT-001",
                offset=offset + QUAN_PARAMETERS.offsets["direct_levels"],
            )
        start = QUAN_PARAMETERS.size
        return cls(raw.step, alphabet, parse_codebook(data[start:], alphabet.size, offset + start))


def encode_quantised(levels: NDArray[np.int64], parameters: QuanParameters) -> bytes:
    """The packet of levels [ticks, components]; each must have a symbol with a code word."""
    row = np.ascontiguousarray(levels.T).reshape(-1)
    if compiled is not None:
        return encode_compiled(row, parameters)
    symbols, extra = parameters.alphabet.tokenise(row)
    book = parameters.book
    if (symbols.size and symbols.max() >= parameters.alphabet.size) or not parameters.lengths[
        symbols
    ].all():
        raise ValueError(NO_WORD)
    values = np.column_stack((book.codes[symbols], extra)).reshape(-1)
    widths = np.column_stack((book.widths[symbols], book.extra_bits[symbols])).reshape(-1)
    return pack_bits(values, widths)


def encode_compiled(row: NDArray[np.int64], parameters: QuanParameters) -> bytes:
    """The same in C; a packet that does not fit its buffer is written again."""
    assert compiled is not None
    room, size = 0, row.size + 64
    while size > room:
        room = size
        out = bytearray(room)
        size = compiled.quan_encode(row, *parameters.given, out)
    if size < 0:
        raise ValueError(NO_WORD)
    return bytes(out[:size])


def decode_levels(
    data: bytes, parameters: QuanParameters, total: int, offset: int
) -> NDArray[np.int64]:
    """Exactly ``total`` levels in the order of the packet."""
    book, alphabet = parameters.book, parameters.alphabet
    if book.only is not None and not book.totals[book.only]:
        if data:
            raise FormatError(
                "bytes left over after a packet", requirement="COD-001", offset=offset
            )
        levels, _ = alphabet.expand(np.array([book.only]), np.zeros(1, np.int64))
        return np.repeat(levels, total)
    parts: list[NDArray[np.int64]] = []
    missing = total
    stop = 0
    for symbols, positions in decode_blocks(data, book):
        if not symbols.size:
            continue
        extra = read_bits(data, positions + book.widths[symbols], book.extra_bits[symbols])
        levels, counts = alphabet.expand(symbols, extra)
        sums = np.cumsum(counts)
        if sums[-1] >= missing:
            last = int(np.searchsorted(sums, missing))
            stop = int(positions[last] + book.totals[symbols[last]])
            if stop > 8 * len(data):
                break
            if sums[last] > missing:
                raise FormatError(
                    "a zero run passes the end of the packet",
                    requirement="QNT-004",
                    offset=offset + int(positions[last]) // 8,
                )
            parts.append(np.repeat(levels[: last + 1], counts[: last + 1]))
            missing = 0
            break
        parts.append(np.repeat(levels, counts))
        missing -= int(sums[-1])
    if missing:
        raise TruncatedError(
            "the packet ends before its last level",
            requirement="COD-001",
            offset=offset + len(data),
        )
    check_end(data, stop, offset)
    return np.concatenate(parts)


def check_end(data: bytes, stop: int, offset: int) -> None:
    """QNT-004: the packet ends with the byte that holds bit ``stop - 1``, filled with zeros."""
    if len(data) != (stop + 7) // 8:
        raise FormatError(
            "bytes left over after the last level",
            requirement="QNT-004",
            offset=offset + (stop + 7) // 8,
        )
    if stop % 8 and data[-1] & ((1 << (8 - stop % 8)) - 1):
        raise FormatError(
            "bits after the last level are not 0",
            requirement="QNT-004",
            offset=offset + len(data) - 1,
        )


def decode_quantised(
    data: bytes, parameters: QuanParameters, span: int, components: int, level: Level, offset: int
) -> NDArray[np.int64]:
    """The packet ``data`` at ``offset``, as counts [span, components]."""
    levels = decode_levels(data, parameters, span * components, offset)
    bound = 2 * level.count_bound // parameters.step
    if max(int(levels.max()), -int(levels.min())) > bound:
        raise FormatError("level times step out of range", requirement="QNT-006", offset=offset)
    return (levels * parameters.step).reshape(components, span).T


def decode_within(
    data: bytes,
    parameters: QuanParameters,
    span: int,
    components: int,
    level: Level,
    offset: int,
    low: int,
    high: int,
) -> NDArray[np.int32]:
    """``decode_quantised``, each count clamped to low ... high (DEC-001)."""
    if compiled is not None:
        out = np.empty((components, span), np.int32)
        bound = 2 * level.count_bound // parameters.step
        if compiled.quan_decode(
            data, *parameters.given, parameters.step, bound, low, high, out
        ):  # fmt: skip
            return out.T
    # Python decodes the rest, and reports which rule is broken.
    counts = decode_quantised(data, parameters, span, components, level, offset)
    return np.clip(counts, low, high).astype(np.int32)
