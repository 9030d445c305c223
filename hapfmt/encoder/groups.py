"""Which channels are the axes of one vector, and one lattice for all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import gcd, lcm

import numpy as np

from ..container.track import SERIES_SIZE
from ..errors import ParameterError
from ..limits import EXACT_LIMIT
from ..recording import Calibration, Channel

COUNT_LIMIT = 1 << 31


def group_units(
    channels: Sequence[Channel], *, required: bool, apart: bool = False
) -> Iterator[list[Channel]]:
    """The channels in their order, neighbours of one group together where they can be one vector.

    ``apart``: never. ``required``: ParameterError, with the reason, where a group cannot.
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
        vector = share_lattice(members) if size > 1 else members
        if isinstance(vector, str):
            if required:
                labels = ", ".join(repr(channel.label) for channel in members)
                raise ParameterError(f"{labels} cannot be one vector: {vector}")
            yield from ([channel] for channel in members)
        else:
            yield vector
        at += size


def share_lattice(members: list[Channel]) -> list[Channel] | str:
    """The same samples as counts of one step, or why that cannot be.

    With D the least common multiple of all denominators, and A what divides all steps then, every
    count grows by a whole factor; physical values stay the same rational numbers.
    """
    first = members[0]
    if len({channel.axis for channel in members}) != len(members):
        return "two have the same axis"
    if len(members) > SERIES_SIZE:
        return f"more than {SERIES_SIZE} axes"
    for name in ("rate", "coverage", "unit"):
        if any(getattr(channel, name) != getattr(first, name) for channel in members):
            return f"they differ in {name}"
    calibrations = [c.calibration for c in members if c.calibration is not None]
    if len(calibrations) != len(members):
        return "one is kept as doubles (a tolerance would put it on a lattice)"
    d = lcm(*(c.d for c in calibrations))
    steps = [c.a * (d // c.d) for c in calibrations]
    a = gcd(*steps)
    shared = []
    for channel, old, step in zip(members, calibrations, steps, strict=True):
        factor = abs(step) // a
        sign = 1 if step > 0 else -1
        reach = int(np.abs(channel.values.astype(np.int64)).max(initial=0)) * factor
        b = old.b * (d // old.d)
        if reach >= COUNT_LIMIT or max(a, abs(b), d) > EXACT_LIMIT:
            return "their steps have no common measure in 32-bit counts"
        calibration = Calibration(sign * a, b, d)
        if not calibration.covers(-reach, reach):
            return "their steps have no common measure that stays exact"
        counts = channel.values.astype(np.int64) * factor
        shared.append(replace(channel, values=counts, calibration=calibration))
    return shared
