"""The compiled loops, where they were built; every one has a readable twin that runs instead.

``HAPFMT_PURE=1`` in the environment leaves them out.
"""

from __future__ import annotations

import os
from typing import Any, Protocol

from numpy.typing import NDArray

Buffer = bytes | bytearray | NDArray[Any]


class Loop(Protocol):
    """(packet, coefficients int32, difference, repeats, raw signs, base, limit, cross int64 or
    none, indices int64) -> (status, bytes of the packet read or written); the last argument, or for
    encoding the first, is filled.
    """

    def __call__(
        self,
        packet: Buffer,
        coefficients: Buffer,
        difference: int,
        repeats: bool,
        raw_signs: bool,
        base: int,
        limit: int,
        cross: Buffer,
        indices: Buffer,
        /,
    ) -> tuple[int, int]: ...


class Estimate(Protocol):
    """(coefficients int32, difference, repeats, counted, stride, base, limit, indices int64, counts
    int64 [15]) -> 256 times the bits, or -1; the counts are filled. encoder/predict.py says more.
    """

    def __call__(
        self,
        coefficients: Buffer,
        difference: int,
        repeats: bool,
        counted: bool,
        stride: int,
        base: int,
        limit: int,
        indices: Buffer,
        counts: Buffer,
        /,
    ) -> int: ...


class Kernels(Protocol):
    """What the extension module has."""

    @property
    def lpcr_decode(self) -> Loop: ...
    @property
    def lpcr_encode(self) -> Loop: ...

    def lpcr_errors(
        self,
        coefficients: Buffer,
        difference: int,
        base: int,
        limit: int,
        indices: Buffer,
        errors: Buffer,
        /,
    ) -> None: ...

    @property
    def estimate(self) -> Estimate: ...

    def step_up(self, reflections: Buffer, sines: Buffer, coefficients: Buffer, /) -> bool: ...

    def autocorrelate(
        self, indices: Buffer, difference: int, base: int, sums: Buffer, /
    ) -> None: ...

    def levinson(
        self, sums: Buffer, orders: int, limits: Buffer, reflections: Buffer, energies: Buffer, /
    ) -> int: ...


def load() -> Kernels | None:
    if os.environ.get("HAPFMT_PURE"):
        return None
    try:
        from . import _kernels
    except ImportError:
        return None
    return _kernels


compiled = load()
"""The extension module, or None."""
