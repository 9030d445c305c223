"""The alphabet and the codebook of a QUAN track: the smallest that all its levels fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..codecs.huffman import build_codebook, code_lengths
from ..codecs.quantised import (
    ESCAPE_LIMIT,
    RUN_LIMIT,
    SYMBOL_LIMIT,
    Alphabet,
    QuanParameters,
    bit_length,
)

NONE = np.zeros(0, np.int64)
WIDE = 4
"""Levels further apart than so many times their number are sorted, not counted in a table."""

DIRECT_LEVELS = (0, 1, 2, 3, 5, 7, 11, 15, 23, 31, 47, 63, 127, 255, 511, 1023)
"""Values of M that are tried: between them the size of a packet hardly changes (below 0.3 %)."""


def choose_codebook(pieces: list[NDArray[np.int64]], step: int) -> QuanParameters:
    """One table for all packets of a track: ``pieces`` are the levels [ticks, components] of each.

    Tries several numbers M of direct levels and keeps the one with the fewest bits, table included.
    """
    columns = [piece.T.reshape(-1) for piece in pieces]
    runs = zero_runs(columns)
    run_classes = min(max(int(runs.max(initial=0)).bit_length() - 1, 0), RUN_LIMIT)
    levels, counts = histogram(np.concatenate([NONE, *columns]))
    levels, counts = levels[levels != 0], counts[levels != 0]
    singles, run_counts = run_symbols(runs, run_classes)
    largest = int(np.abs(levels).max(initial=0))
    best: tuple[int, QuanParameters] | None = None
    for direct in (*(m for m in DIRECT_LEVELS if m < largest), largest):
        escape_classes = max(largest - direct, 0).bit_length()
        alphabet = Alphabet(direct, run_classes, escape_classes)
        if escape_classes > ESCAPE_LIMIT or alphabet.size > SYMBOL_LIMIT:
            continue
        frequencies = np.zeros(alphabet.size, np.int64)
        np.add.at(frequencies, alphabet.level_symbols(levels)[0], counts)
        frequencies[0] += singles
        frequencies[alphabet.first_run : alphabet.first_escape] += run_counts
        if not frequencies.any():
            frequencies[0] = 1
        lengths = code_lengths(frequencies)
        bits = int((frequencies * (lengths + alphabet.extra_bits)).sum())
        total = bits + 8 * len(build_codebook(lengths))
        if best is None or total < best[0]:
            best = total, QuanParameters(step, alphabet, lengths)
        elif total > best[0] + best[0] // 8:
            break
    assert best is not None
    return best[1]


def histogram(levels: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The levels that occur, sorted, and how often."""
    low, high = int(levels.min(initial=0)), int(levels.max(initial=0))
    if high - low > WIDE * levels.size:
        found, counts = np.unique(levels, return_counts=True)
        return found, counts.astype(np.int64)
    counts = np.bincount(levels - low, minlength=1).astype(np.int64)
    present = np.flatnonzero(counts)
    return present + low, counts[present]


def zero_runs(columns: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Lengths of all runs of level 0; a run ends with its packet."""
    fence = np.ones(1, np.int64)
    joined = np.concatenate([fence, *(part for column in columns for part in (column, fence))])
    edges = np.flatnonzero(np.diff((joined == 0).astype(np.int8)))
    return edges[1::2] - edges[::2]


def run_symbols(runs: NDArray[np.int64], classes: int) -> tuple[int, NDArray[np.int64]]:
    """How many single zeros, and how many symbols of each run class, Alphabet.tokenise makes."""
    longest = (2 << classes) - 1
    whole, rest = runs // longest, runs % longest
    by_class = np.bincount(bit_length(rest[rest > 0]) - 1, minlength=classes + 1)
    by_class[classes] += whole.sum()
    return int(by_class[0]), by_class[1:]
