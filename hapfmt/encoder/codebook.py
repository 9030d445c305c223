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
)

DIRECT_LEVELS = (0, 1, 2, 3, 5, 7, 11, 15, 23, 31, 47, 63, 127, 255, 511, 1023)
"""Values of M that are tried: between them the size of a packet hardly changes (below 0.3 %)."""


def choose_codebook(pieces: list[NDArray[np.int64]], step: int) -> QuanParameters:
    """One table for all packets of a track: ``pieces`` are the levels [ticks, components] of each.

    Tries several numbers M of direct levels and keeps the one with the fewest bits, table included.
    """
    columns = [piece.T.reshape(-1) for piece in pieces]
    longest = max((longest_run(column) for column in columns), default=0)
    run_classes = min(max(longest.bit_length() - 1, 0), RUN_LIMIT)
    largest = max((int(np.abs(column).max()) for column in columns if column.size), default=0)
    best: tuple[int, QuanParameters] | None = None
    for direct in (*(m for m in DIRECT_LEVELS if m < largest), largest):
        escape_classes = max(largest - direct, 0).bit_length()
        alphabet = Alphabet(direct, run_classes, escape_classes)
        if escape_classes > ESCAPE_LIMIT or alphabet.size > SYMBOL_LIMIT:
            continue
        frequencies = np.zeros(alphabet.size, np.int64)
        for column in columns:
            frequencies += np.bincount(alphabet.tokenise(column)[0], minlength=alphabet.size)
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


def longest_run(levels: NDArray[np.int64]) -> int:
    edges = np.flatnonzero(np.diff((levels == 0).astype(np.int8), prepend=0, append=0))
    return int((edges[1::2] - edges[::2]).max(initial=0))
