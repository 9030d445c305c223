"""Packets handed to threads, some together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from ..format.cluster import Packet

BATCH = 1 << 15
"""Samples that are worth handing to another thread."""


class Batch(NamedTuple):
    """Packets that one thread decodes, and how many samples they have."""

    packets: list[Packet]
    weight: int


def batches(packets: Iterable[tuple[Packet, int]], size: int) -> Iterator[Batch]:
    """Packets in their order, as few together as hold ``size`` samples; what an error leaves of a
    batch comes before it."""
    batch, weight = [], 0
    try:
        for packet, samples in packets:
            batch.append(packet)
            weight += samples
            if weight >= size:
                yield Batch(batch, weight)
                batch, weight = [], 0
    except Exception:
        if batch:
            yield Batch(batch, weight)
        raise
    if batch:
        yield Batch(batch, weight)
