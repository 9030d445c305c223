"""Random numbers that are the same on every machine and with every version of everything."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

Item = TypeVar("Item")


class Luck:
    """Steele and others, "Fast splittable pseudorandom number generators" (SplitMix64),
    doi:10.1145/2660193.2660195."""

    def __init__(self, seed: int) -> None:
        self.state = seed

    def word(self) -> int:
        self.state = (self.state + 0x9E3779B97F4A7C15) % 2**64
        z = self.state
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 % 2**64
        z = (z ^ z >> 27) * 0x94D049BB133111EB % 2**64
        return z ^ z >> 31

    def below(self, n: int) -> int:
        return self.word() * n >> 64

    def between(self, low: int, high: int) -> int:
        """Both may come."""
        return low + self.below(high - low + 1)

    def choice(self, items: Sequence[Item]) -> Item:
        return items[self.below(len(items))]

    def bell(self, spread: int) -> int:
        """About normal: the sum of four, each up to ``spread`` either way."""
        return sum(self.between(-spread, spread) for _ in range(4))

    def bytes(self, size: int) -> bytes:
        return bytes(self.below(256) for _ in range(size))


def walk(n: int, size: int, seed: int) -> list[int]:
    """A walk of random steps that returns."""
    luck = Luck(seed)
    x = v = 0
    out = []
    for _ in range(n):
        v = 19 * v // 20 - x // 50 + 5 * luck.bell(size) // 2
        x += v
        out.append(x // 50)
    return out
