"""Counters of the work that a scene took. Each is updated where the work is done, so a part that
did not run shows 0.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass
class Work:
    """Counters of the computed parts.

    step_count: steps of tool and fingers, all axes. contact_step_count: those of them that a
    contact solver took; the others are exact steps of linear parts, one a tick. unstable_count:
    those that were longer than their integrator is stable up to. height_count: points of a height
    field. finger_count, tremor_count (points), channel_count, sample_count; of the samples,
    saturated_count lie at the end of their sensor's range.
    """

    step_count: int = 0
    contact_step_count: int = 0
    unstable_count: int = 0
    height_count: int = 0
    finger_count: int = 0
    tremor_count: int = 0
    channel_count: int = 0
    sample_count: int = 0
    saturated_count: int = 0

    def as_json(self) -> dict[str, int]:
        return asdict(self)
