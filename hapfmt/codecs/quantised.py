"""QUAN: a mid-tread quantiser with canonical Huffman code words and zero runs (SPEC 9.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..format.layout import QUAN_PARAMETERS
from ..errors import FormatError, TruncatedError
from ..kernels import compiled
from ..limits import Level
from .bits import pack_bits
from .huffman import Codebook, build_codebook, decode_blocks, parse_codebook, read_bits

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
    """The same in C; a packet that does not fit its buffer is written once more."""
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
    """The packet ``data``, which stands at ``offset``, as counts [span, components]."""
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
    # In Python, and so is a broken rule told.
    counts = decode_quantised(data, parameters, span, components, level, offset)
    return np.clip(counts, low, high).astype(np.int32)
