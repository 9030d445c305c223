""".npy <-> Recording, and the one place that reads NumPy's array format."""

from __future__ import annotations

import struct
import sys
import tokenize
import warnings
from collections.abc import Sequence
from math import prod
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from ..errors import LimitError, ParameterError
from ..recording import Channel, Recording, known_samples, refuse_transpose, spans_of, upright
from ..spool import MEMORY, Memory, release
from .common import (
    BLOCK_SIZE,
    CHANNEL_LIMIT,
    SLICE,
    Dense,
    choose_rate,
    exact_doubles,
    not_carried,
    one_rate,
    read_bytes,
    refusing,
)
from .formats import Destination, ReadOptions, Source, WriteOptions

_HEADERS = {
    (1, 0): npy_format.read_array_header_1_0,
    (2, 0): npy_format.read_array_header_2_0,
}
"""Version 3 differs in the field names of structured arrays only, which hold no samples."""

READ = 16 << 20
"""Bytes that are there before the disk is asked for more."""

_HEADER_ERRORS = (struct.error, SyntaxError, TypeError, RecursionError, tokenize.TokenError)


def read(source: Source, options: ReadOptions) -> Recording:
    """[channels, samples] or [samples] of real numbers -> channels ch1, ch2 ...; NaN is a gap."""
    store = options.store
    array = read_array(source.stream, "the array", max_memory=options.max_memory, store=store)
    x = doubles_2d(array, "the array", transpose=options.transpose, store=store)
    rate = choose_rate(options.rate, None, [])
    channels = []
    for number, row in enumerate(x, start=1):
        values, known = stored_samples(row, store)
        channels.append(Channel(values, rate, tuple(spans_of(known)), label=f"ch{number}"))
    return Recording(tuple(channels))


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """Physical values as float64 [channels, ticks], NaN in gaps; all channels start together."""
    rate = one_rate(recording, ".npy")
    dense = Dense(recording.channels, ".npy", options.max_memory)
    if any(channel.start_tick != dense.start for channel in recording.channels):
        raise ParameterError(".npy holds one start, the channels begin at several; use .npz")
    write_dense(target.stream, dense)
    notes = [f"the rate, {rate} Hz, is not carried over to .npy"]
    if dense.start:
        notes.append(f"the start, tick {dense.start}, is not carried over to .npy")
    return notes + not_carried(recording, ".npy")


def write_dense(stream: IO[bytes], dense: Dense) -> None:
    """The float64 array [channels, ticks], slice by slice."""
    shape = (len(dense.channels), dense.ticks)
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    npy_format.write_array_header_1_0(stream, header)
    for number in range(len(dense.channels)):
        for part in dense.rows(number):
            stream.write(part.astype("<f8", copy=False).data)


def read_array(
    stream: IO[bytes], what: str, *, max_memory: int, store: Memory = MEMORY
) -> NDArray[Any]:
    """The one array of at most 2 dimensions, numbers or text, that the stream consists of.

    Its declared size is compared with ``max_memory`` before any memory is taken, which then grows
    only with the bytes that are there.
    """
    shape, by_column, dtype = read_header(stream, what)
    if dtype.kind not in "biufUS" or not dtype.itemsize:
        raise ParameterError(f"{what} has the dtype {dtype}; only real numbers and text are read")
    if len(shape) > 2 or min(shape, default=0) < 0:
        raise ParameterError(f"{what} has the shape {shape}; at most 2 dimensions are read")
    size = dtype.itemsize * prod(shape)
    if memory_of(shape, dtype) > max_memory:
        raise LimitError(
            f"{what} takes {memory_of(shape, dtype)} bytes, more than the {max_memory} allowed; "
            "allow more (max_memory=)"
        )
    data = _read(stream, size, store)
    if len(data) < size:
        raise ParameterError(f"{what} ends after {len(data)} of {size} bytes")
    # In an archive this also reaches the end of the member, where its CRC-32 is compared.
    if stream.read(1):
        raise ParameterError(f"{what} is followed by further bytes")
    # NumPy checks no code point, and Python fails on a wrong one with a SystemError.
    if dtype.kind == "U" and size:
        points = np.frombuffer(data, np.dtype(np.uint32).newbyteorder(dtype.byteorder))
        if points.max() > sys.maxunicode:
            raise ParameterError(
                f"{what} holds {points.max():#x}, which is not a Unicode character"
            )
    with refusing(f"{what} has the shape {shape}"):
        flat = np.frombuffer(data, dtype) if size else np.empty(0, dtype)
        return flat.reshape(shape, order="F" if by_column else "C")


def _read(stream: IO[bytes], size: int, store: Memory) -> bytearray | NDArray[np.uint8]:
    """Up to ``size`` bytes, in ``store`` where there are many."""
    begun = read_bytes(stream, min(size, READ) if store.on_disk else size)
    if not READ <= len(begun) < size:
        return begun
    data, at = store.empty(size, np.uint8), len(begun)
    data[:at] = np.frombuffer(begun, np.uint8)
    while block := stream.read(min(BLOCK_SIZE, size - at)):
        data[at : at + len(block)] = np.frombuffer(block, np.uint8)
        at += len(block)
        release()
    return data[:at]


def stored_samples(x: NDArray[Any], store: Memory) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """[samples] where ``store`` has room, and which of [ticks] they are; NaN is a gap."""
    row, known = known_samples(x)
    values = store.kept(np.ascontiguousarray(row) if known.all() else row[known])
    release()
    return values, known


def read_header(stream: IO[bytes], what: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether columns come first, and dtype of the array that follows in the stream."""
    with (
        refusing(f"{what} is not a NumPy array", *_HEADER_ERRORS),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # on headers that Python 2 wrote
        version = npy_format.read_magic(stream)
        if version not in _HEADERS:
            raise ParameterError(f"{what} has NumPy's array format {version}, not (1, 0) or (2, 0)")
        shape, by_column, dtype = _HEADERS[version](stream)
    if any(type(size) is not int for size in shape):  # NumPy takes (True, 10)
        raise ParameterError(f"{what} has the shape {shape}, not one of integers")
    return shape, by_column, dtype


def memory_of(shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
    """Bytes of an array once its numbers are doubles."""
    return max(dtype.itemsize, 8) * prod(shape)


def write_array(stream: IO[bytes], array: NDArray[Any]) -> None:
    npy_format.write_array(stream, np.ascontiguousarray(array), version=(1, 0), allow_pickle=False)


def doubles_2d(
    x: NDArray[Any],
    what: str,
    *,
    labelled: int | None = None,
    transpose: bool | None = None,
    store: Memory = MEMORY,
) -> Sequence[NDArray[np.float64]]:
    """[channels][samples] float64 of an array in that shape or [samples], each channel in one
    piece; ``labelled`` channels have a name of their own."""
    if x.ndim not in (1, 2):
        raise ParameterError(f"{what} is a single number, not [channels, samples]")
    if x.ndim == 1:
        refuse_transpose(transpose)
        x = x.reshape(1, -1)
    else:
        x = upright(x, labelled, transpose, what, "use transpose=True")
    if len(x) > CHANNEL_LIMIT:
        raise ParameterError(
            f"{what} has {len(x)} channels, more than {CHANNEL_LIMIT}; it is [channels, samples]"
        )
    return rows_in(x, what, store)


def rows_in(x: NDArray[Any], what: str, store: Memory) -> Sequence[NDArray[np.float64]]:
    """The rows of [channels, samples] as doubles of the same values, each in one piece."""
    if x.flags.c_contiguous and x.dtype == np.float64:
        return list(x)
    rows = [store.empty(x.shape[1], np.float64) for _ in x]
    at_once = max(SLICE // max(len(x), 1), 1)
    for at in range(0, x.shape[1], at_once):
        for row, part in zip(rows, exact_doubles(x[:, at : at + at_once], what), strict=True):
            row[at : at + at_once] = part
        release()
    return rows
