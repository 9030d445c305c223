"""Tracks of MDCT, from the integers of their packets or from signals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import forge as f
import page_transform as page
from facts import Packet, Track
from luck import Luck
from page_numbers import clamp

Blocks = Sequence[Sequence[int]]


class Shape(NamedTuple):
    """The parameters."""

    m: int = 5
    step: int = 256
    weights: tuple[int, ...] = ()

    @property
    def parameters(self) -> bytes:
        return f.mdct_parameters(*self)

    @property
    def steps(self) -> list[int]:
        return page.steps(*self)


PLAIN = Shape()
COMMON = (-100, 100)


def component(integers: Blocks, shape: Shape = PLAIN, base: int = 0, **given: Any) -> bytes:
    """The component packet of these integers of each block."""
    return page.encode(integers, shape.steps, base, **given)


def signal(counts: Sequence[int], shape: Shape = PLAIN, base: int = 0, kept: int | None = None,
           near: int | None = None, **given: Any) -> bytes:  # fmt: skip
    """The component packet of a signal, of which as far as ``near`` nothing is lost."""
    s = shape.steps[: 2**shape.m if kept is None else kept]
    blocks = [row[: len(s)] for row in page.analyse([c - base for c in counts], shape.m)]
    body = page.encode(page.quantise(blocks, s), s, base, **given)
    if near is not None:
        found = page.decode(body, len(counts), shape.m, shape.steps)
        assert max(abs(a - b) for a, b in zip(found, counts, strict=True)) <= near
    return body


def packet(*components: bytes, span: int, start: int = 0, shape: Shape = PLAIN,
           clamped: tuple[int, int] = COMMON, bound: int = 2**24) -> Packet:  # fmt: skip
    body = page.encode_packet(list(components))
    rows = page.decode_packet(body, span, shape.m, shape.steps, len(components), bound)
    counts = [[clamp(count, *clamped) for count in row] for row in rows]
    return Packet(start, list(zip(*counts, strict=True)), body)


def track(*packets: Packet, shape: Shape = PLAIN, clamped: tuple[int, int] = COMMON,
          **fields: Any) -> Track:  # fmt: skip
    low, high = clamped
    return Track(
        codec="MDCT", parameters=shape.parameters, packets=packets, low=low, high=high, **fields
    )  # fmt: skip


def some(seed: int, kept: int, blocks: int, *sizes: int) -> list[list[int]]:
    """Integers of any size up to those given."""
    luck = Luck(seed)
    return [
        [luck.between(-size, size) for size in [luck.choice(sizes) for _ in range(kept)]]
        for _ in range(blocks)
    ]
