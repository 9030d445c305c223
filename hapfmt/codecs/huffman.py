"""Canonical Huffman code words with extra bits (SPEC 9.2): lengths, codebook nibbles, decoding.

Decoding looks up the symbol that *would* start at every bit of a block, all at once, then walks
from each code word to the next. The walk alone is sequential.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError

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
