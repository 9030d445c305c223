"""Channels that are on no lattice: one RAWB track of words."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

from ..codecs.raw import RawParameters, encode_raw
from ..format.cluster import Packet
from ..recording import Channel, Span
from .packed import Coded
from .source import make_track
from .unit import Unit

WORDS_REASON = "bit for bit: no common step"

PROBES, PROBED = 4, 2048
"""Packets, and samples in the middle of each, that tell how large words become: DEFLATE takes 70 %
of the time of a channel whose values repeat."""

LARGER = 1.25
"""How much larger a probe is than the whole at most (1.12 measured)."""


def encode_words(
    channel: Channel, spans: Sequence[Span], first_channel: int, number_format: str, reason: str
) -> Unit:
    """RAWB words, bit for bit."""
    track = make_track(
        [channel],
        first_channel,
        codec="RAWB",
        parameters=RawParameters(channel.stored.dtype.itemsize).build(),
        number_format=number_format,
    )
    coded = Coded(track)
    at = 0
    for span in spans:
        rows = channel.stored[at : at + span.ticks, None]
        coded.packets.append(
            Packet(0, span.start, span.ticks, encode_raw(rows, channel.stored.dtype.itemsize))
        )
        at += span.ticks
    return Unit(coded, None, "raw", reason, exact=True)


def words_size(channel: Channel, spans: Sequence[Span]) -> float:
    """Bytes that RAWB words hardly stay below."""
    size, samples, stride = 0, 0, -(-len(spans) // PROBES)
    firsts = list(accumulate((span.ticks for span in spans), initial=0))
    for place in range(stride // 2, len(spans), stride):
        first, span = firsts[place], spans[place]
        ticks = min(span.ticks, PROBED)
        start = first + (span.ticks - ticks) // 2
        rows = channel.stored[start : start + ticks, None]
        size += len(encode_raw(rows, channel.stored.dtype.itemsize))
        samples += ticks
    return size / LARGER * channel.stored.size / samples
