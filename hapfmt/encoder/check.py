"""What the decoder makes of an encoder's packets, beside the counts they were made from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..decoder import TrackDecoder
from .source import Source
from .unit import ENCODE_LEVEL, Coded


def decoded_pieces(
    source: Source, *tracks: Coded
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Packet by packet the counts [ticks, components], and what a decoder makes of the tracks."""
    first = tracks[0].track
    decoders = [TrackDecoder(coded.track, ENCODE_LEVEL) for coded in tracks]
    packets = zip(*(coded.packets for coded in tracks), strict=True)
    for (_, rows), same_span in zip(source.pieces(source.counts), packets, strict=True):
        y = np.zeros_like(rows)
        for decoder, packet in zip(decoders, same_span, strict=True):
            y += decoder.decode(packet)
        yield rows, np.clip(y, first.count_min, first.count_max) if len(tracks) > 1 else y
