"""BDF is EDF with counts of 24 bits; one reader takes both."""

from __future__ import annotations

from ..recording import Recording
from .edf import read, write_records
from .formats import Destination, WriteOptions


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """BDF+ with counts of 24 bits."""
    return write_records(recording, target, options, 3)


__all__ = ["read", "write"]
