"""The compiled loops, where they were built; every one has a readable twin that runs instead.

``HAPFMT_PURE=1`` in the environment leaves them out.
"""

from __future__ import annotations

import os
from types import ModuleType


def load() -> ModuleType | None:
    if os.environ.get("HAPFMT_PURE"):
        return None
    try:
        from . import _kernels  # type: ignore[attr-defined]
    except ImportError:
        return None
    module: ModuleType = _kernels
    return module


compiled = load()
"""The extension module, or None."""
