"""What the tests of all foreign formats share."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np

from hapfmt.convert import read, save
from hapfmt.errors import HapfmtError
from hapfmt.recording import Channel, Recording


def written(recording: Recording, format: str, **options: Any) -> tuple[bytes, tuple[str, ...]]:
    """The file, and the notes."""
    stream = io.BytesIO()
    notes = save(recording, stream, format=format, **options)
    return stream.getvalue(), notes


def facts(channel: Channel) -> tuple[Any, ...]:
    """All that is recorded: ticks, bits, rate."""
    bits = channel.samples().view(np.uint64).tolist()
    return channel.coverage, bits, channel.rate_exact


def damaged(whole: bytes, cuts: int = 60, changes: int = 150) -> Iterator[bytes]:
    """The file cut off, and with a byte changed, left out or inserted."""
    for size in range(0, len(whole), max(1, len(whole) // cuts)):
        yield whole[:size]
    rng = np.random.default_rng(3)
    for _ in range(changes):
        # most of the structure is at the front
        at = int(len(whole) * rng.random() ** 3)
        changed = bytes(rng.integers(0, 256, int(rng.integers(0, 3)), dtype=np.uint8))
        yield whole[:at] + changed + whole[at + 1 :]


def survives(data: bytes, format: str, max_memory: int = 1 << 22) -> Recording | None:
    """A recording, or our error with a text; anything else is raised."""
    try:
        return read(io.BytesIO(data), format=format, max_memory=max_memory)
    except HapfmtError as error:
        assert str(error)
        return None
