"""Packages of the peers: the one that is installed, or the command that would install it."""

from __future__ import annotations

import os
from functools import cache
from importlib import import_module
from importlib.metadata import version
from typing import Any

# One thread each, as CPU time counts all of them; read when a library is loaded.
for _name in ("OMP_NUM_THREADS", "RAYON_NUM_THREADS", "BLOSC_NTHREADS", "NUMEXPR_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

PACKAGES = {
    "soundfile": "soundfile",
    "pcodec": "pcodec",
    "pysz": "pysz",
    "zstandard": "zstandard",
    "blosc2": "blosc2",
    "h5py": "h5py",
    "hdf5plugin": "hdf5plugin",
    "mcap": "mcap",
    "pyarrow": "pyarrow",
}
"""Module: the name that pip knows."""


@cache
def module(name: str) -> Any:
    """The imported package, or None. A broken installation is one that is not there."""
    try:
        return import_module(name)
    except Exception:
        return None


def installed(*names: str) -> bool:
    return all(module(name) is not None for name in names)


def versions() -> dict[str, str]:
    return {PACKAGES[name]: version(PACKAGES[name]) for name in PACKAGES if installed(name)}


def left_out() -> list[str]:
    """The missing packages, by their names for pip."""
    return [package for name, package in PACKAGES.items() if not installed(name)]
