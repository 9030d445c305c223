"""What the decoder makes of an encoder's packets, beside the counts they were made from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..reading.decoder import TrackDecoder
from .packed import Coded
from .source import Source
from .unit import ENCODE_LEVEL


def decoded_pieces(
    source: Source, coded: Coded
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Packet by packet the counts [ticks, components], and what a decoder makes of them."""
    decoder = TrackDecoder(coded.track, ENCODE_LEVEL)
    pieces = source.pieces(source.counts)
    for packet, (_, rows) in zip(coded.packets, pieces, strict=True):
        yield rows, decoder.decode(packet).astype(np.int64)
