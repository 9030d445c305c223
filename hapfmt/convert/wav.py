""".wav <-> Recording, through soundfile: PCM is counts, float is doubles, the unit is "1"."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from io import SEEK_END, BytesIO
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import LimitError, MissingExtraError, ParameterError
from ..limits import TICK_LIMIT
from ..recording import Calibration, Channel, Recording
from .common import Dense, choose_rate, extent, not_carried, one_rate, refusing, selected
from .formats import Destination, ReadOptions, Source, WriteOptions
from .tables import Import, ImportBlock, ImportColumn, ImportTable

PCM: dict[str, tuple[int, np.dtype[Any], int]] = {
    "PCM_U8": (8, np.dtype(np.int16), 8),
    "PCM_16": (16, np.dtype(np.int16), 0),
    "PCM_24": (24, np.dtype(np.int32), 8),
    "PCM_32": (32, np.dtype(np.int32), 0),
    "PCM_S8": (8, np.dtype(np.int16), 8),
}
"""Bits of a count; the dtype that soundfile hands over, and how far up it is shifted there."""
_FLOAT = ("FLOAT", "DOUBLE")
_STARTS = (b"RIFF", b"RF64", b"RIFX")
_VALUES_AT_ONCE = 1 << 20
_SIZE_LIMIT = (1 << 32) - (1 << 16)
"""Bytes of samples: the sizes in the header have 32 bits, the rest is left to the header."""
_UNKNOWN_SIZE = 0xFFFFFFFF
"""The size in the header of a file that was written to a pipe."""
_CHUNKS_LIMIT = 1000
"""Most chunks that are skipped in search of the samples; real files have a handful."""


def _soundfile() -> Any:
    try:
        import soundfile
    except (ImportError, OSError):  # OSError: the package without its library
        raise MissingExtraError("soundfile", "audio") from None
    return soundfile


class _Guarded:
    """A stream whose exceptions are kept: from a callback out of C they would only be printed."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.error: BaseException | None = None

    def _kept(self, call: Callable[..., Any], *arguments: Any, otherwise: Any) -> Any:
        if self.error is None:
            try:
                return call(*arguments)
            except BaseException as error:
                self.error = error
        return otherwise

    def readinto(self, buffer: Any) -> Any:
        return self._kept(self._stream.readinto, buffer, otherwise=0)  # type: ignore[attr-defined]

    def read(self, size: int = -1) -> Any:
        return self._kept(self._stream.read, size, otherwise=b"")

    def write(self, data: Any) -> Any:
        return self._kept(self._stream.write, data, otherwise=0)

    def seek(self, offset: int, whence: int = 0) -> Any:
        return self._kept(self._stream.seek, offset, whence, otherwise=0)

    def tell(self) -> Any:
        return self._kept(self._stream.tell, otherwise=0)


def read(source: Source, options: ReadOptions) -> Import:
    """PCM of b bits -> counts with the calibration 1 / 2**(b - 1); float -> doubles, NaN is a gap.

    Channels are labelled ch1, ch2 ...
    """
    stream = source.stream
    _check_chunks(stream)
    return sound_of(stream, ".wav", options)


def sound_of(
    stream: BinaryIO,
    suffix: str,
    options: ReadOptions,
    described: Callable[[str, int], tuple[Fraction, list[ImportColumn]] | None] | None = None,
) -> Import:
    """The channels of a sound file, one table. ``described`` gives the rate and the columns
    that a comment of ours tells, of a number of channels."""
    notes: list[str] = []
    with opened(stream, "r", suffix) as file:
        subtype, count, frames = file.subtype, file.channels, file.frames
        comment = file.comment
        if subtype not in PCM and subtype not in _FLOAT:
            raise ParameterError(f"{subtype} samples are not read; PCM and float are")
        found = Fraction(file.samplerate)
    if frames > TICK_LIMIT:
        raise ParameterError(f"the header counts no samples; write the {suffix} file again")
    bits, dtype, shift = PCM.get(subtype, (0, np.dtype(np.float64), 0))
    calibration = Calibration(1, 0, 1 << (bits - 1)) if bits else None
    labelled = [
        ImportColumn(f"ch{number}", calibration=calibration) for number in range(1, count + 1)
    ]
    rate, columns = (described and described(comment, count)) or (found, labelled)
    kept = selected([column.label for column in columns], options.select, "channel")

    def blocks() -> Iterator[ImportBlock]:
        stream.seek(0)
        done = 0
        at_once = max(1, _VALUES_AT_ONCE // count)
        with opened(stream, "r", suffix) as file:
            while done < frames and len(x := file.read(at_once, dtype=dtype.name, always_2d=True)):
                x = x[: frames - done]
                yield ImportBlock(
                    0, done, [x[:, place] >> shift if bits else x[:, place] for place in kept]
                )
                done += len(x)

    chosen = tuple(replace(columns[place], dtype=dtype) for place in kept)
    rate = choose_rate(options.rate, rate, notes)
    table = ImportTable("sound", chosen, rate, frames, kind=subtype)
    return Import((table,), blocks, notes=tuple(notes))


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """Counts that PCM can hold as PCM, bit for bit; everything else as DOUBLE, NaN in gaps."""
    stream, max_memory = target.stream, options.max_memory
    rate = one_rate(recording, ".wav")
    if rate.denominator != 1 or rate >= 1 << 31:
        raise ParameterError(f".wav holds whole rates below 2^31 Hz, not {rate} Hz; use .npz")
    subtype = subtype_of(recording.channels)
    count = len(recording.channels)
    if subtype == "DOUBLE":
        dense = Dense(recording.channels, ".wav", max_memory)
        frames, size = dense.frames(), 8 * count * dense.ticks
    else:
        check_pcm(recording.channels, subtype)
        frames = pcm_frames(recording.channels, subtype)
        size = PCM[subtype][1].itemsize * recording.sample_count
    if size > _SIZE_LIMIT:
        raise ParameterError(f".wav holds at most {_SIZE_LIMIT} bytes of samples; use .npz")
    write_sound(
        stream,
        frames,
        size,
        max_memory,
        ".wav",
        samplerate=int(rate),
        channels=count,
        format="WAV",
        subtype=subtype,
    )
    return _notes(recording, subtype)


def write_sound(
    stream: BinaryIO,
    frames: Iterator[NDArray[Any]],
    size: int,
    max_memory: int,
    suffix: str,
    comment: str = "",
    **described: Any,
) -> None:
    """A sound file of ``size`` bytes at most; a stream that cannot seek takes them at once."""
    out = stream if stream.seekable() and stream.tell() == 0 else BytesIO()
    if out is not stream and size > max_memory:
        raise LimitError(
            f"the samples take {size} bytes, and a pipe takes them at once; allow more than "
            f"{max_memory} (max_memory=) or write to a file"
        )
    with opened(out, "w", suffix, **described) as file:
        if comment:
            file.comment = comment
        for block in frames:
            file.write(np.ascontiguousarray(block))
    if out is not stream and isinstance(out, BytesIO):
        stream.write(out.getbuffer())


def _notes(recording: Recording, subtype: str) -> list[str]:
    carried = set() if subtype == "DOUBLE" else {"calibration"}
    if all(c.label == f"ch{number}" for number, c in enumerate(recording.channels, start=1)):
        carried.add("label")
    start, _ = extent(recording.channels)
    notes = [f"the start, tick {start}, is not carried over to .wav"] if start else []
    return notes + not_carried(recording, ".wav", *carried)


def subtype_of(channels: Sequence[Channel]) -> str:
    """The PCM whose scaling is the calibration of every channel, or DOUBLE."""
    if any(channel.exact is not None for channel in channels):
        return "DOUBLE"
    calibrations = {channel.calibration for channel in channels}
    for subtype, (bits, _, _) in PCM.items():
        if calibrations == {Calibration(1, 0, 1 << (bits - 1))}:
            return subtype
    return "DOUBLE"


def check_pcm(channels: Sequence[Channel], subtype: str) -> None:
    """Refuse what PCM cannot hold."""
    bits, _, _ = PCM[subtype]
    first = channels[0]
    for channel in channels:
        if len(channel.coverage) > 1 or channel.coverage != first.coverage:
            raise ParameterError(
                f"channel {channel.label!r} has gaps, which PCM cannot hold; use .npz"
            )
        x = channel.stored
        if x.size and not -(1 << (bits - 1)) <= int(x.min()) <= int(x.max()) < 1 << (bits - 1):
            raise ParameterError(
                f"channel {channel.label!r} has counts beyond {bits} bits; use .npz"
            )


def pcm_frames(channels: Sequence[Channel], subtype: str) -> Iterator[NDArray[Any]]:
    """[ticks, channels] counts, slice by slice, shifted to the top of the dtype that soundfile
    takes."""
    _, dtype, shift = PCM[subtype]
    at_once = max(1, _VALUES_AT_ONCE // len(channels))
    for at in range(0, channels[0].stored.size, at_once):
        parts = [channel.stored[at : at + at_once].astype(dtype) << shift for channel in channels]
        yield np.stack(parts, axis=1)


@contextmanager
def opened(stream: BinaryIO, mode: str, suffix: str, **described: Any) -> Iterator[Any]:
    """A soundfile on a stream; what goes wrong in it, or below it, is raised here."""
    soundfile = _soundfile()
    guarded = _Guarded(stream)
    what = f"this is no {suffix} file" if mode == "r" else f"this cannot be written as {suffix}"
    try:
        with (
            refusing(what, soundfile.SoundFileError, TypeError),
            soundfile.SoundFile(guarded, mode, **described) as file,
        ):
            yield file
    finally:
        if guarded.error is not None:
            raise guarded.error


def _check_chunks(stream: BinaryIO) -> None:
    """Refuse what libsndfile takes without a word: other formats, a file cut short or left open."""
    end = stream.seek(0, SEEK_END)
    stream.seek(0)
    position = 12
    start = stream.read(position)
    if start[:4] not in _STARTS or start[8:] != b"WAVE":
        raise ParameterError("this is not a .wav file: it does not begin with RIFF and WAVE")
    for _ in range(_CHUNKS_LIMIT if start[:4] == b"RIFF" else 0):
        stream.seek(position)
        head = stream.read(8)
        if len(head) < 8:
            break
        name, size = struct.unpack("<4sI", head)
        position += 8 + size
        if name == b"data":
            if position > end and size != _UNKNOWN_SIZE:
                raise ParameterError(
                    f"truncated: {position - end} of {size} bytes of samples are missing"
                )
            if not size and 8 + int.from_bytes(start[4:8], "little") < end:
                raise ParameterError(
                    f"never closed: the header counts no samples, {end - position} bytes follow"
                )
            break
        position += size % 2
    stream.seek(0)
