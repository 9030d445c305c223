"""Tracks of LPCR from the indices of their packets."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import forge as f
import page
from facts import Packet, Track
from luck import Luck


class Coding(NamedTuple):
    """How one component of a packet is coded: the arguments of page.encode."""

    g: int = 0
    ks: tuple[int, ...] = ()
    base: int = 0
    repeats: tuple[int, ...] = ()
    references: tuple[tuple[int, int, int, int], ...] = ()
    number: int = 0
    start: int = 12
    signs: tuple[int, ...] = ()
    states: int = 1


EVEN = (128,) * 4
"""Probabilities of repeats of which nothing is known."""


class Grid(NamedTuple):
    """``kn`` 0: uniform."""

    step: int = 1
    zero: int = 0
    kn: int = 0
    kd: int = 1
    bound: int = 2**24

    @property
    def parameters(self) -> bytes:
        return f.lpcr_parameters(
            int(self.kn > 0), step=self.step, zero=self.zero, kn=self.kn, kd=self.kd
        )

    @property
    def last(self) -> int:
        """The largest index."""
        return len(levels(self)) - 1 if self.kn else self.bound // self.step

    def count(self, index: int) -> int:
        if self.kn == 0:
            return self.zero + index * self.step
        y = levels(self)[abs(index)]
        return self.zero + (y if index >= 0 else -y)


@cache
def levels(grid: Grid) -> list[int]:
    return page.grid_levels(grid.kn, grid.kd, grid.step, grid.bound)


Range = tuple[int, int]

COMMON = (-100, 100)
PLAIN = Grid()
SIMPLE = Coding()


def constant(index: int) -> bytes:
    return bytes([0x10, 0]) + page.svarint_bytes(index)


def packet(*components: Sequence[int], coding: Coding | Sequence[Coding] = SIMPLE,
           start: int = 0, grid: Grid = PLAIN, clamped: Range = COMMON) -> Packet:  # fmt: skip
    """Of the indices of each component; ``coding`` of all of them or of each."""
    each = [coding] * len(components) if isinstance(coding, Coding) else list(coding)
    parts: list[bytes] = []
    for number, (indices, how) in enumerate(zip(components, each, strict=True)):
        before = components[:number] if how.references else ()
        parts.append(page.encode(list(indices), **how._asdict(), components=before))
    return coded(page.encode_packet(parts), *components, start=start, grid=grid, clamped=clamped)


def coded(body: bytes, *components: Sequence[int], start: int = 0, grid: Grid = PLAIN,
          clamped: Range = COMMON) -> Packet:  # fmt: skip
    """Bytes that decode to these indices, with the page decoder too."""
    rows = [list(indices) for indices in components]
    assert page.decode_packet(body, len(rows[0]), grid.last, len(rows)) == rows
    low, high = clamped
    counts = [[max(low, min(high, grid.count(index))) for index in row] for row in rows]
    return Packet(start, list(zip(*counts, strict=True)), body)


def track(*packets: Packet, grid: Grid = PLAIN, clamped: Range = COMMON,
          **fields: Any) -> Track:  # fmt: skip
    low, high = clamped
    return Track(
        codec="LPCR", parameters=grid.parameters, packets=packets, low=low, high=high, **fields
    )  # fmt: skip


def walk(seed: int, size: int, steps: int, low: int = -100, high: int = 100) -> list[int]:
    """A signal that wanders."""
    luck, at, out = Luck(seed), 0, []
    for _ in range(size):
        at = max(low, min(high, at + luck.between(-steps, steps)))
        out.append(at)
    return out
