"""Which channels are the axes of one vector, and one lattice for all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import gcd, lcm

import numpy as np

from ..format.track import COMPONENTS
from ..reading.contract import nearest_counts
from ..errors import ParameterError
from ..limits import AFFINE_LIMIT, EXACT_LIMIT
from ..recording import Calibration, Channel, Deviation

COUNT_LIMIT = 1 << 31


def group_units(
    channels: Sequence[Channel],
    originals: Sequence[Channel],
    *,
    required: bool,
    apart: bool = False,
) -> Iterator[list[Channel]]:
    """The channels in their order, neighbours of one group together where they can be one vector.

    Channels of one step are; others too where it is ``required``, on a lattice that all of them
    share (an "lsb" is then a step of that one), or ParameterError says why they cannot.
    ``originals`` are the channels before they were put on lattices; ``apart``: none are grouped.
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
    """The same samples as counts of one step; ParameterError where that cannot be.

    With D the least common multiple of all denominators, and A what divides all steps then, every
    count grows by a whole factor; physical values stay the same rational numbers. What was rounded
    to its own lattice is rounded anew, to this one.
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
