"""The encoder's input: channels in one block, cut into packets, and their description.

It also groups the channels that are axes of one vector, and puts them on one common grid.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import gcd, lcm
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ParameterError
from ..format.track import COMPONENTS, Affine, Component, Track, round_up
from ..limits import AFFINE_LIMIT, EXACT_LIMIT
from ..reading.verifier import nearest_counts
from ..recording import Calibration, Channel, Deviation, Span
from ..threads import check_stopped
from .plan import without_glitches

HELD, HELD_SHARE = 8, 0.001
"""Fewest samples at the smallest or largest value, as a number and as a share of all samples, that
make it an end of the range."""

PACKET_SAMPLES = 1 << 16
"""Longer packets are cut: eight bytes each then still fit a payload of level 1."""

FEW = 32
"""Packets that this many of make a whole one join their neighbours: a packet of a tick takes about
40 bytes, and one that is a 32nd longer keeps what damage may take (tools/faults.py --law)."""


@dataclass(frozen=True)
class InputBlock:
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
    """Coverage cut where clusters begin, and where a packet would grow too long. Either end joins
    its neighbour where it is much shorter than a cluster."""
    longest = max(PACKET_SAMPLES // components, 1)
    n, d = (cluster * rate).as_integer_ratio()
    few = n // (FEW * d)
    out = []
    for span in coverage:
        at = span.start
        while at < span.stop:
            number = (at + few) * d // n + 1
            stop = min(-(-number * n // d), at + longest)
            if span.stop - stop <= few and span.stop - at <= longest:
                stop = span.stop
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


COUNT_LIMIT = 1 << 31


def group_units(
    channels: Sequence[Channel],
    originals: Sequence[Channel],
    *,
    required: bool,
    apart: bool = False,
) -> Iterator[list[Channel]]:
    """The channels in their order, neighbours of one group together where they can be one vector.

    Channels with one step can. Where it is ``required``, others go on a grid that all of them
    share; an "lsb" is then a step of that grid. ParameterError says why they cannot. ``originals``
    are the channels before they were put on grids; ``apart``: none are grouped.
    """
    at = 0
    while at < len(channels):
        size = 1
        while (
            channels[at].group
            and not apart
            and at + size < len(channels)
            and channels[at + size].group == channels[at].group
        ):
            size += 1
        members = list(channels[at : at + size])
        why = why_apart(members) if size > 1 else None
        if why is None and size > 1:
            if required:
                members = share_lattice(members, originals[at : at + size])
            elif len({abs(c.calibration.step) for c in members if c.calibration}) > 1:
                why = "they differ in step"
        if why is None:
            yield members
        elif required:
            raise no_vector(members, why)
        else:
            yield from ([channel] for channel in members)
        at += size


def no_vector(members: Sequence[Channel], why: str) -> ParameterError:
    labels = ", ".join(repr(channel.label) for channel in members)
    return ParameterError(f"{labels} cannot be one vector: {why}")


def why_apart(members: Sequence[Channel]) -> str | None:
    """What keeps channels from being the axes of one vector, whatever their steps."""
    first = members[0]
    if len({channel.axis for channel in members}) != len(members):
        return "two have the same axis"
    if len(members) > COMPONENTS:
        return f"more than {COMPONENTS} axes"
    for name, field in (("rate", "rate_exact"), ("coverage", "coverage"), ("unit", "unit")):
        if any(getattr(channel, field) != getattr(first, field) for channel in members):
            return f"they differ in {name}"
    if any(channel.calibration is None for channel in members):
        return "one is kept as doubles (a tolerance would put it on a lattice)"
    return None


def share_lattice(members: Sequence[Channel], originals: Sequence[Channel]) -> list[Channel]:
    """The same samples as counts of one step; ParameterError where that is impossible.

    D is the least common multiple of all denominators, and A then divides all steps. Every count
    grows by a whole factor; physical values stay the same rational numbers. Samples that were
    rounded to their own grid are rounded again, to this one.
    """
    calibrations = [c.calibration for c in members if c.calibration is not None]
    d = lcm(*(c.d for c in calibrations))
    steps = [c.a * (d // c.d) for c in calibrations]
    a = gcd(*steps)
    shared = []
    for channel, source, old, step in zip(members, originals, calibrations, steps, strict=True):
        factor = abs(step) // a
        b = old.b * (d // old.d)
        reach = (int(np.abs(channel.stored.astype(np.int64)).max(initial=0)) + 1) * factor
        if reach >= COUNT_LIMIT or max(a, abs(b)) >= AFFINE_LIMIT or d >= EXACT_LIMIT:
            raise no_vector(members, "their steps have no common measure in 32-bit counts")
        calibration = Calibration(a if step > 0 else -a, b, d)
        if not calibration.covers(-reach, reach):
            raise no_vector(members, "their steps have no common measure that stays exact")
        counts, deviation = channel.stored.astype(np.int64) * factor, channel.deviation
        if deviation is not None:
            counts = nearest_counts(source.samples(), calibration)
            away = float(np.abs(source.samples() - calibration.physical(counts)).max(initial=0))
            deviation = Deviation(deviation.declared, min(away, deviation.declared))
        shared.append(replace(channel, stored=counts, calibration=calibration, deviation=deviation))
    return shared
