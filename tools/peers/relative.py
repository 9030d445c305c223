"""Recipes for the deadband |x - y| <= max(k |x|, floor), which of all peers only SZ2 has built in.

The others get a companding that turns it into an absolute bound: linear near zero, where the floor
rules, and logarithmic beyond x0 = floor / k. With u the companded value a coder may be ``error``
off. Two of them:

- "log": a round trip through the inverse. ln(1 + k) / k is what it allows, since upwards of x
  there is a factor of 1 + k, and downwards more.
- "cells": the value of a cell [a, b] of u is not its middle, but a + max(k a, floor), the largest
  that is near enough to a. So b / a may be (1 + k) / (1 - k), which no fixed companding exceeds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .exact import Coder, Doubles, integer_coders
from .packages import installed, module

SAFE = 1 - 1e-9
"""Share of the error bound that a peer gets: one that rounds at its bound must keep ours."""

ROUNDING = 1 + 1e-9
"""A bound counts as kept within this factor, for all coders alike."""


class Compander(NamedTuple):
    """A bound and one of the two ways; ``slope`` is du / d ln x, ``error`` what u may be off."""

    k: float
    floor: float
    slope: float
    error: float
    cells: bool

    def compand(self, x: Doubles) -> Doubles:
        a, knee = np.abs(x), self.floor / self.k
        with np.errstate(divide="ignore"):
            far = 1 / self.k + self.slope * np.log(np.maximum(a, knee) / knee)
        return np.sign(x) * np.where(a <= knee, a / self.floor, far)

    def inverse(self, u: Doubles) -> Doubles:
        a = np.abs(u)
        far = self.floor / self.k * np.exp(np.maximum(a - 1 / self.k, 0) / self.slope)
        return np.sign(u) * np.where(a <= 1 / self.k, a * self.floor, far)

    def value(self, u: Doubles) -> Doubles:
        """The value that stands for all within ``error`` of u."""
        if not self.cells:
            return self.inverse(u)
        low = self.inverse(np.maximum(np.abs(u) - 1, 0))
        beyond = low + np.maximum(self.k * low, self.floor)
        return np.sign(u) * np.where(np.abs(u) < 1, np.abs(u) * self.floor, beyond)


def companders(k: float, floor: float) -> dict[str, Compander]:
    """By name, for 0 < k < 1 and floor > 0."""
    cell = 2 / np.log((1 + k) / (1 - k))
    return {
        "log": Compander(k, floor, 1 / k, np.log1p(k) / k * SAFE, False),
        "cells": Compander(k, floor, cell, SAFE, True),
    }


class Recipe(NamedTuple):
    """``encode(x, rate)`` gives a blob or None, ``decode(blob, size)`` the values."""

    name: str
    family: str
    encode: Callable[[Doubles, float], bytes | None]
    decode: Callable[[bytes, int], Doubles]


def recipes(k: float, floor: float) -> list[Recipe]:
    """All of them for one channel's bound, where the packages are here."""
    found = []
    for family, compander in companders(k, floor).items():
        found += [quantised(family, compander, coder) for coder in integer_coders()]
        if installed("pysz"):
            found += [sz3(family, compander, name) for name in ("LORENZO_REG", "INTERP")]
    if installed("h5py", "hdf5plugin"):
        found.append(Recipe("sz2, no floor", "native", lambda x, _rate: sz2(x, k),
                            lambda blob, size: unsz2(blob, size, k)))  # fmt: skip
    return found


def quantised(family: str, compander: Compander, coder: Coder) -> Recipe:
    """Companding, uniform quantisation, and a coder of integers."""
    step = 2 * compander.error

    def encode(x: Doubles, rate: float) -> bytes | None:
        return coder.encode(np.rint(compander.compand(x) / step).astype(np.int64), rate)

    def decode(blob: bytes, size: int) -> Doubles:
        return compander.value(coder.decode(blob, size) * step)

    return Recipe(f"{family} + {coder.name}", family, encode, decode)


def sz3(family: str, compander: Compander, algorithm: str) -> Recipe:
    """Companding, and SZ3 with an absolute bound."""

    def encode(x: Doubles, _rate: float) -> bytes:
        return sz3_encode(compander.compand(x), float(compander.error), algorithm)

    def decode(blob: bytes, size: int) -> Doubles:
        return compander.value(sz3_decode(blob, size))

    return Recipe(f"{family} + sz3 {algorithm}", family, encode, decode)


def sz3_encode(x: Doubles, error: float, algorithm: str = "LORENZO_REG") -> bytes:
    """SZ3 with an absolute bound."""
    p = module("pysz")
    config = p.szConfig()
    config.errorBoundMode = p.szErrorBoundMode.ABS
    config.absErrorBound = error
    config.cmprAlgo = getattr(p.szAlgorithm, algorithm)
    blob: NDArray[np.uint8] = p.sz.compress(np.ascontiguousarray(x), config)[0]
    return blob.tobytes()


def sz3_decode(blob: bytes, size: int) -> Doubles:
    return module("pysz").sz.decompress(np.frombuffer(blob, np.uint8).copy(), np.float64, (size,))[
        0
    ]


def sz2(x: Doubles, k: float) -> bytes:
    """The chunk that SZ2 makes under HDF5; it has a pointwise relative bound, and no floor."""
    with memory_file() as file:
        data = file.create_dataset("x", data=x, chunks=x.shape, **sz2_filter(k))
        return data.id.read_direct_chunk((0,))[1]


def unsz2(blob: bytes, size: int, k: float) -> Doubles:
    with memory_file() as file:
        data = file.create_dataset("x", (size,), np.float64, chunks=(size,), **sz2_filter(k))
        data.id.write_direct_chunk((0,), blob)
        return data[:]


def sz2_filter(k: float) -> dict[str, object]:
    return dict(module("hdf5plugin").SZ(pointwise_relative=k))


def memory_file() -> Any:
    return module("h5py").File("sz2", "w", driver="core", backing_store=False)


def outside(x: Doubles, y: Doubles, k: float, floor: float) -> tuple[int, float]:
    """Samples that break the bound, and the largest error in deadbands, in float64."""
    if x.shape != y.shape:
        return x.size, float("inf")
    ratio = np.abs(x - y) / np.maximum(k * np.abs(x), floor)
    return int((~(ratio <= ROUNDING)).sum()), float(ratio.max(initial=0.0))
