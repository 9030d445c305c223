"""Raw files and JSON of the conformance suite."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapfmt.errors import ParameterError


def wide(numbers: NDArray[Any]) -> NDArray[Any]:
    """Counts and integers as i64 or u64, binary words as their bits in a u64."""
    if numbers.dtype.kind == "f":
        return numbers.view(f"u{numbers.dtype.itemsize}").astype("<u8")
    return numbers.astype("<u8" if numbers.dtype.kind == "u" else "<i8")


def write_numbers(folder: Path, name: str, numbers: NDArray[Any]) -> str:
    """Numbers [ticks, ...] as 8 bytes each; the name that stands for them in the JSON."""
    (folder / name).write_bytes(np.ascontiguousarray(wide(numbers)).tobytes())
    return name


def write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, ensure_ascii=False) + "\n", encoding="utf-8")


def read_numbers(path: Path, number_format: str) -> NDArray[Any]:
    """What ``write_numbers`` wrote of counts or words."""
    raw = path.read_bytes()
    if len(raw) % 8:
        raise ParameterError("a raw file holds 8 bytes for each number", path=str(path))
    words = np.frombuffer(raw, "<u8")
    if number_format in ("counts", "int64"):
        return words.view("<i8").astype(np.int64)
    if number_format == "uint64":
        return words.astype(np.uint64)
    size = {"binary16": 2, "binary32": 4, "binary64": 8}.get(number_format)
    if size is None:
        raise ParameterError(f"no number format is called {number_format!r}")
    return words.astype(f"u{size}").view(f"f{size}")
