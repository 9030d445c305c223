"""Coders without loss, one channel at a time: integers, and doubles."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .packages import installed, module

Integers = NDArray[np.int64]
Doubles = NDArray[np.float64]

ZSTD_LEVEL = 19
BLOSC_LEVEL = 9
FLAC_BITS = 24


class Coder(NamedTuple):
    """``encode(x, rate)`` gives a file or blob of its own, or None where x does not fit the format;
    ``decode(blob, size)`` gives x back."""

    name: str
    encode: Callable[[NDArray, float], bytes | None]
    decode: Callable[[bytes, int], NDArray]


def narrow(x: Integers, *widths: int) -> NDArray:
    """x in the fewest bytes of ``widths`` that hold it."""
    reach = max(-int(x.min()) - 1, int(x.max())).bit_length() + 1
    return x.astype(f"i{next((w for w in widths if 8 * w >= reach), 8)}")


def flac_encode(x: Integers, rate: float, level: int = 8) -> bytes | None:
    """One channel; 16 bits where they hold it, else 24."""
    bits = max(-int(x.min()) - 1, int(x.max())).bit_length() + 1
    if bits > FLAC_BITS:
        return None
    stream = io.BytesIO()
    subtype, data = (
        ("PCM_16", x.astype(np.int16)) if bits <= 16 else ("PCM_24", x.astype(np.int32) << 8)
    )
    module("soundfile").write(
        stream, data, max(int(rate), 1), subtype, format="FLAC", compression_level=level / 8
    )
    return stream.getvalue()


def flac_decode(blob: bytes, _size: int) -> Integers:
    stream = io.BytesIO(blob)
    if module("soundfile").info(io.BytesIO(blob)).subtype == "PCM_16":
        return module("soundfile").read(stream, dtype="int16")[0].astype(np.int64)
    return module("soundfile").read(stream, dtype="int32")[0].astype(np.int64) >> 8


def pcodec_encode(x: NDArray, level: int) -> bytes:
    from pcodec import ChunkConfig, standalone

    return bytes(standalone.simple_compress(x, ChunkConfig(compression_level=level)))


def pcodec_decode(blob: bytes, _size: int) -> NDArray:
    from pcodec import standalone

    return standalone.simple_decompress(blob)


def pcodec(level: int) -> Coder:
    return Coder(
        f"pcodec -{level}",
        lambda x, _rate: pcodec_encode(narrow(x, 2, 4), level),
        lambda blob, size: pcodec_decode(blob, size).astype(np.int64),
    )


def zstd(data: bytes) -> bytes:
    return module("zstandard").ZstdCompressor(level=ZSTD_LEVEL).compress(data)


def unzstd(blob: bytes) -> bytes:
    return module("zstandard").ZstdDecompressor().decompress(blob)


def blosc(data: NDArray, bitwise: bool) -> bytes:
    b = module("blosc2")
    return b.compress2(
        data,
        typesize=data.itemsize,
        clevel=BLOSC_LEVEL,
        codec=b.Codec.ZSTD,
        filters=[b.Filter.BITSHUFFLE if bitwise else b.Filter.SHUFFLE],
        filters_meta=[0],
        nthreads=1,
    )


def unblosc(blob: bytes) -> bytes:
    return module("blosc2").decompress2(blob, nthreads=1)


def on_differences(
    name: str, pack: Callable[[NDArray], bytes], unpack: Callable[[bytes], bytes]
) -> Coder:
    """Differences modulo the width of the integers, then a coder of bytes."""

    def encode(x: Integers, _rate: float) -> bytes:
        q = narrow(x, 1, 2, 4)
        return pack(np.diff(q, prepend=q.dtype.type(0)))

    def decode(blob: bytes, size: int) -> Integers:
        data = unpack(blob)
        kind = np.dtype(f"i{len(data) // size}")
        return np.cumsum(np.frombuffer(data, kind), dtype=kind).astype(np.int64)

    return Coder(name, encode, decode)


def planes_encode(x: Doubles, _rate: float) -> bytes:
    """Byte planes, as HDF5's shuffle does, then zstd."""
    return zstd(np.ascontiguousarray(x.view(np.uint8).reshape(-1, 8).T).tobytes())


def planes_decode(blob: bytes, size: int) -> Doubles:
    planes = np.frombuffer(unzstd(blob), np.uint8).reshape(8, size)
    return np.ascontiguousarray(planes.T).view(np.float64).ravel()


def integer_coders() -> list[Coder]:
    """Every coder of integers whose package is here."""
    found = []
    if installed("soundfile"):
        found.append(Coder("flac -8", flac_encode, flac_decode))
    if installed("pcodec"):
        found += [pcodec(8), pcodec(12)]
    if installed("zstandard"):
        found.append(on_differences("delta + zstd -19", lambda d: zstd(d.tobytes()), unzstd))
    if installed("blosc2"):
        found += [
            on_differences("delta + blosc2 shuffle", lambda d: blosc(d, False), unblosc),
            on_differences("delta + blosc2 bitshuffle", lambda d: blosc(d, True), unblosc),
        ]
    return found


def double_coders() -> list[Coder]:
    """Every coder of doubles whose package is here."""
    found = []
    if installed("pcodec"):
        found.append(Coder("pcodec -12", lambda x, _rate: pcodec_encode(x, 12), pcodec_decode))
    if installed("zstandard"):
        found.append(Coder("shuffle + zstd -19", planes_encode, planes_decode))
    if installed("blosc2"):
        found += [
            Coder(
                f"blosc2 {name}",
                lambda x, _rate, bitwise=bitwise: blosc(x, bitwise),
                lambda blob, _size: np.frombuffer(unblosc(blob), np.float64),
            )
            for name, bitwise in (("shuffle", False), ("bitshuffle", True))
        ]
    return found
