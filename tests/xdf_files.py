"""XDF: pyxdf has no writer, so a few lines here write chunks after the public specification of XDF
1.0 (https://github.com/sccn/xdf/wiki/Specifications)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

DTYPES = {"int8": "i1", "int16": "<i2", "int32": "<i4", "int64": "<i8", "float32": "<f4", "double64": "<f8"}  # fmt: skip


def chunk(tag: int, content: bytes) -> bytes:
    size = len(content) + 2
    head = struct.pack("<BB", 1, size) if size < 256 else struct.pack("<BI", 4, size)
    return head + struct.pack("<H", tag) + content


def count_of(number: int) -> bytes:
    return struct.pack("<BB", 1, number) if number < 256 else struct.pack("<BI", 4, number)


def header(
    number: int, name: str, format: str, channels: int, rate: float, desc: str = ""
) -> bytes:
    xml = (
        f'<?xml version="1.0"?><info><name>{name}</name><type>Force</type>'
        f"<channel_count>{channels}</channel_count><nominal_srate>{rate}</nominal_srate>"
        f"<channel_format>{format}</channel_format><hostname>{name}-pc</hostname>"
        f"<desc>{desc}</desc></info>"
    )
    return chunk(2, struct.pack("<I", number) + xml.encode())


def samples(number: int, format: str, x: Any, stamps: Sequence[float | None]) -> bytes:
    """One chunk of rows; a stamp None is left out."""
    content = struct.pack("<I", number) + count_of(len(stamps))
    for row, stamp in zip(x, stamps, strict=True):
        content += b"\0" if stamp is None else b"\x08" + struct.pack("<d", stamp)
        if format == "string":
            for text in row:
                content += count_of(len(text.encode())) + text.encode()
        else:
            content += np.asarray(row, DTYPES[format]).tobytes()
    return chunk(3, content)


def offset(number: int, time: float, value: float) -> bytes:
    return chunk(4, struct.pack("<Idd", number, time, value))


def channels(*described: tuple[str, str]) -> str:
    inner = "".join(
        f"<channel><label>{label}</label><unit>{unit}</unit></channel>" for label, unit in described
    )
    return f"<channels>{inner}</channels>"


START = chunk(1, b'<?xml version="1.0"?><info><version>1.0</version></info>')
BOUNDARY = chunk(5, bytes(16))
