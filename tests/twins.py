"""Compiled loops beside their readable twins."""

from __future__ import annotations

import re
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from hapfmt.errors import FormatError
from hapfmt.kernels import compiled

built = pytest.mark.skipif(compiled is None, reason="the extension is not built, or HAPFMT_PURE=1")


def changed(arguments: dict[str, Any]) -> str:
    """An id without addresses of memory: processes that share the tests must agree on it."""
    return re.sub(r" at 0x\w+", "", str(arguments))


def by_the_twin(module: ModuleType, call: Callable[..., Any], *given: Any) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "compiled", None)
        return call(*given)


def same(module: ModuleType, call: Callable[..., Any], *given: Any) -> Any:
    """What the call gives, with the extension and without."""
    fast = call(*given)
    assert fast == by_the_twin(module, call, *given)
    return fast


def clamped(decode: Callable[..., Any], *given: Any) -> Any:
    """Counts, or all that an error tells."""
    try:
        counts = decode(*given)
    except FormatError as error:
        return type(error).__name__, error.requirement, error.offset, error.message
    assert counts.dtype == np.int32
    return counts.shape, counts.tobytes()


def packed(encode: Callable[..., Any], *given: Any) -> Any:
    """A packet, or why there is none."""
    try:
        return encode(*given)
    except ValueError as error:
        return str(error)
