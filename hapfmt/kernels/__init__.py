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


class Errors(Protocol):
    """(coefficients int32, difference, base, limit, indices int64, errors int64); the last is
    filled.
    """

    def __call__(
        self,
        coefficients: Buffer,
        difference: int,
        base: int,
        limit: int,
        indices: Buffer,
        errors: Buffer,
        /,
    ) -> None: ...


class Kernels(Protocol):
    """What the extension module has."""

    @property
    def lpcr_decode(self) -> Loop: ...
    @property
    def lpcr_encode(self) -> Loop: ...
    @property
    def lpcr_errors(self) -> Errors: ...


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
