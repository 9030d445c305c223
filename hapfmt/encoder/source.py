"""What the encoder works on: channels side by side, cut into packets, and their description."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..format.lists import round_up
from ..format.track import Affine, Component, Track
from ..recording import Channel, Span
from ..threads import check_stopped
from .glitches import without_glitches

HELD, HELD_SHARE = 8, 0.001
"""Samples at an end of the range, of all of them, that are no accident."""

PACKET_SAMPLES = 1 << 16
"""Longer packets are cut: eight bytes each then still fit a payload of level 1."""


@dataclass(frozen=True)
class Source:
    """Channels of one unit side by side: counts [ticks, components], and the spans they are for.

    Counts are as narrow as the channel holds them; packet by packet they are int64.
    """

    channels: tuple[Channel, ...]
    counts: NDArray[Any]
    spans: tuple[Span, ...]
    """Coverage, cut into packets."""

    @property
    def rate(self) -> Fraction:
        return self.channels[0].rate_exact

    @cached_property
    def calm(self) -> NDArray[Any]:
        """Counts without single samples that are far beyond all others; mostly ``counts``."""
        columns = [without_glitches(column) for column in self.counts.T]
        if all(np.shares_memory(column, self.counts) for column in columns):
            return self.counts
        return np.column_stack(columns)

    @property
    def extents(self) -> list[int]:
        """The largest count minus the smallest, of each component, glitches left out."""
        low, high = self.calm.min(axis=0).tolist(), self.calm.max(axis=0).tolist()
        return [b - a for a, b in zip(low, high, strict=True)]

    def pieces(self, rows: NDArray[Any]) -> Iterator[tuple[Span, NDArray[np.int64]]]:
        """Rows [ticks, components], for the same ticks as ``counts``, packet by packet."""
        at = 0
        for span in self.spans:
            check_stopped()
            yield span, rows[at : at + span.ticks].astype(np.int64, copy=False)
            at += span.ticks

    def segments(self) -> list[slice]:
        """Rows of ``counts`` that no gap interrupts."""
        out, at = [], 0
        for span in self.channels[0].coverage:
            out.append(slice(at, at + span.ticks))
            at += span.ticks
        return out


def side_by_side(channels: Sequence[Channel]) -> NDArray[Any]:
    """Counts [ticks, components]; of one channel a view of its own values."""
    values = channels[0].stored
    if len(channels) == 1 and values.dtype.kind == "i":
        return values[:, None]
    return np.column_stack([channel.stored.astype(np.int64) for channel in channels])


def cut(coverage: Sequence[Span], rate: Fraction, cluster: Fraction, components: int) -> list[Span]:
    """Coverage cut where clusters begin, and where a packet would grow too long."""
    longest = max(PACKET_SAMPLES // components, 1)
    n, d = (cluster * rate).as_integer_ratio()
    out = []
    for span in coverage:
        at = span.start
        while at < span.stop:
            number = at * d // n + 1
            stop = min(span.stop, -(-number * n // d), at + longest)
            out.append(Span(at, stop))
            at = stop
    return out


def component_of(channel: Channel) -> Component:
    """A channel's description as it goes into the file."""
    calibration = channel.calibration
    affine = Affine(calibration.a, calibration.b, calibration.d) if calibration else Affine()
    return Component(
        affine,
        channel.label,
        channel.unit,
        channel.quantity,
        channel.axis,
        channel.group,
        channel.body_site,
        channel.device,
        (round_up(channel.deviation.declared), round_up(channel.deviation.largest))
        if channel.deviation
        else None,
    )


def declared_range(counts: NDArray[Any]) -> tuple[int, int]:
    """The smallest range of whole bits that holds all counts, without a sign where none occurs.

    Whole bits, so that channels of a kind share one description.
    """
    low, high = int(counts.min(initial=0)), int(counts.max(initial=0))
    if low >= 0:
        return 0, (1 << high.bit_length()) - 1
    bits = max((-low - 1).bit_length(), high.bit_length())
    return -(1 << bits), (1 << bits) - 1


def held_range(counts: NDArray[Any]) -> tuple[int, int]:
    """The declared range, but where many samples lie at one end of all, that is the end: a sensor
    that saturates has it there, and what a decoder makes of the samples is clamped to it."""
    low, high = declared_range(counts)
    least, largest = int(counts.min(initial=0)), int(counts.max(initial=0))
    enough = max(HELD, HELD_SHARE * len(counts))
    if np.count_nonzero(counts == least) >= enough:
        low = least
    if np.count_nonzero(counts == largest) >= enough:
        high = largest
    return low, high


def make_track(channels: Sequence[Channel], first_channel: int, **given: Any) -> Track:
    """A track that holds whole channels."""
    return Track(
        id=0,
        kind="full",
        rate=channels[0].rate_exact,
        first_channel=first_channel,
        components=tuple(component_of(channel) for channel in channels),
        **given,
    )
