"""Files of other formats: a recording or one of our errors."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable

import numpy as np

from hapfmt.convert import read, save
from hapfmt.recording import Channel, Recording

from .target import Target, settled

MEMORY = 1 << 22
"""Bytes that a conversion may take."""


def reads(suffix: str) -> Callable[[bytes], None]:
    def run(data: bytes) -> None:
        for rate in (None, "1000"):
            found = settled(read, io.BytesIO(data), format=suffix, rate=rate, max_memory=MEMORY)
            if found is None:
                continue
            out = io.BytesIO()
            notes = settled(save, found, out, format=suffix, max_memory=MEMORY)
            if notes is not None:
                again = io.BytesIO(out.getvalue())
                assert settled(read, again, format=suffix, rate="1000") is not None

    return run


def saved(suffix: str) -> bytes:
    out = io.BytesIO()
    save(Recording((Channel(np.arange(6) / 8, 1000, label="x", unit="N"),)), out, format=suffix)
    return out.getvalue()


def of_csv() -> Iterable[bytes]:
    yield saved("csv")
    yield b"# made by hand\ntime [ms];a [N];b\n0;1,5;\n1;nan;-2e3\n"
    yield b'"x, y",z\n1,2\n,4\n'


def of_npy() -> Iterable[bytes]:
    for x in (np.arange(5.0), np.arange(6, dtype=np.int16).reshape(2, 3), np.array([1, np.nan])):
        out = io.BytesIO()
        np.save(out, x)
        yield out.getvalue()


def of_npz() -> Iterable[bytes]:
    yield saved("npz")


def of_wav() -> Iterable[bytes]:
    yield saved("wav")


FOREIGN = [
    Target("csv", reads("csv"), of_csv, size=400),
    Target("npy", reads("npy"), of_npy, size=400),
    Target("npz", reads("npz"), of_npz, size=3000),
    Target("wav", reads("wav"), of_wav, size=400),
]
