"""TDMS files: written by npTDMS, and DAQmx segments, which it only reads."""

from __future__ import annotations

import io
import struct
from typing import Any

from numpy.typing import NDArray

DAQMX = {"u1": 0, "i1": 1, "<u2": 2, "<i2": 3, "<u4": 4, "<i4": 5}
"""Numbers of the types of a scaler."""


def written(*segments: list[Any]) -> bytes:
    from nptdms import TdmsWriter

    stream = io.BytesIO()
    with TdmsWriter(stream) as writer:
        for each in segments:
            writer.write_segment(each)
    return stream.getvalue()


def channel(group: str, name: str, x: Any, **properties: Any) -> Any:
    from nptdms import ChannelObject

    return ChannelObject(group, name, x, properties)


def linear(slope: float, intercept: float) -> dict[str, Any]:
    return {
        "NI_Number_Of_Scales": 1,
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": slope,
        "NI_Scale[0]_Linear_Y_Intercept": intercept,
    }


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def said(key: str, value: Any) -> bytes:
    if isinstance(value, str):
        return text(key) + struct.pack("<I", 0x20) + text(value)
    if isinstance(value, int):
        return text(key) + struct.pack("<II", 7, value)
    return text(key) + struct.pack("<Id", 10, value)


def interleaved(x: NDArray[Any], *, big_endian: bool = False) -> bytes:
    """[rows, channels] of int16 at 1 kHz, row by row, as LabVIEW may write them."""
    order = ">" if big_endian else "<"
    rows, width = x.shape

    def packed(value: str) -> bytes:
        return struct.pack(f"{order}I", len(value)) + value.encode()

    metadata = struct.pack(f"{order}I", width)
    for number in range(width):
        metadata += packed(f"/'card'/'ai{number}'") + struct.pack(f"{order}I", 20)
        metadata += struct.pack(f"{order}IIQ", 2, 1, rows)
        metadata += struct.pack(f"{order}I", 1) + packed("wf_increment")
        metadata += struct.pack(f"{order}Id", 10, 0.001)
    mask = 1 << 1 | 1 << 2 | 1 << 3 | 1 << 5 | big_endian << 6
    raw = x.astype(f"{order}i2").tobytes()
    sizes = struct.pack(f"{order}IQQ", 4713, len(metadata) + len(raw), len(metadata))
    return b"TDSm" + struct.pack("<I", mask) + sizes + metadata + raw


def daqmx(x: NDArray[Any], properties: dict[str, Any]) -> bytes:
    """[rows, channels] interleaved integers, as DAQmx logs them: scaler 0, then the scales."""
    rows, width = x.shape
    size = x.dtype.itemsize
    metadata = struct.pack("<I", width)
    for number in range(width):
        metadata += text(f"/'card'/'ai{number}'") + struct.pack("<I", 0x1269)
        metadata += struct.pack("<IIQI", 0xFFFFFFFF, 1, rows, 1)
        metadata += struct.pack("<5I", DAQMX[x.dtype.str.lstrip("|")], 0, number * size, 0, 0)
        metadata += struct.pack("<II", 1, width * size)
        metadata += struct.pack("<I", len(properties))
        metadata += b"".join(said(key, value) for key, value in properties.items())
    mask = 1 << 1 | 1 << 2 | 1 << 3 | 1 << 7
    raw = x.tobytes()
    lead = struct.pack("<4sIIQQ", b"TDSm", mask, 4713, len(metadata) + len(raw), len(metadata))
    return lead + metadata + raw
