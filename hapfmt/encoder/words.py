"""Channels that are on no lattice: one RAWB track of words."""

from __future__ import annotations

from collections.abc import Sequence

from ..codecs.raw import RawParameters, encode_raw
from ..container.cluster import Packet
from ..container.track import Track
from ..recording import Channel, Span
from .packed import Coded
from .source import component_of
from .unit import Unit

WORDS_REASON = "no lattice, kept bit for bit"


def encode_words(
    channel: Channel, spans: Sequence[Span], first_channel: int, number_format: str, reason: str
) -> Unit:
    """RAWB words, bit for bit."""
    track = Track(
        id=0,
        kind="full",
        codec="RAWB",
        rate=channel.rate,
        first_channel=first_channel,
        components=(component_of(channel),),
        parameters=RawParameters(channel.values.dtype.itemsize).build(),
        number_format=number_format,
    )
    coded = Coded(track)
    at = 0
    for span in spans:
        rows = channel.values[at : at + span.ticks, None]
        coded.packets.append(
            Packet(0, span.start, span.ticks, encode_raw(rows, channel.values.dtype.itemsize))
        )
        at += span.ticks
    return Unit(coded, None, "raw", reason, exact=True)
