"""How a recording is doing."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Status:
    """A moment of a recording.

    ``seconds``: its length so far. Samples: ``taken`` from the caller, of which ``missing`` were
    NaN and ``written`` are in the file; ``dropped``, by channel, were not taken. ``queued_size``:
    bytes of samples in memory. ``cluster_count`` and ``file_size``: as written. ``flushed_s``: the
    length that a crash leaves. ``blocked_s``: what the caller waited for room. ``busy_s``: CPU time
    of the encoding thread, ``factor``: seconds that it recorded in each of them.
    """

    seconds: float = 0.0
    taken: int = 0
    missing: int = 0
    written: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    queued_size: int = 0
    cluster_count: int = 0
    file_size: int = 0
    flushed_s: float = 0.0
    blocked_s: float = 0.0
    busy_s: float = 0.0
    factor: float = 0.0

    @property
    def dropped_count(self) -> int:
        return sum(self.dropped.values())

    def as_json(self) -> dict[str, Any]:
        return asdict(self)
