"""Types, lengths, values, and the lists within them (SPEC 6.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from ..errors import FormatError, ParameterError
from .layout import TLV

T = TypeVar("T")
VALUE_SIZE = 0xFFFF
STRING_SIZE, SAME = 0xFE, 0xFF
"""Texts are at most 254 bytes; a length of 255 stands for the text before."""


Tlvs = dict[int, tuple[int, bytes]]
"""{type: (file offset of the value, value)}"""


def parse_tlvs(payload: bytes, position: int, base: int) -> Tlvs:
    """All from ``position`` to the end of the payload."""
    found: Tlvs = {}
    while position < len(payload):
        position = parse_tlv(payload, position, base, found)
    return found


def parse_tlv(payload: bytes, position: int, base: int, found: Tlvs) -> int:
    """Adds the next one; returns where it ends."""
    at = base + position
    start = position + TLV.size
    if start > len(payload):
        raise FormatError("bytes left over after the last TLV", requirement="TLV-001", offset=at)
    head = TLV.read(payload, position)
    if found and head.type <= next(reversed(found)):
        raise FormatError("TLV types not increasing", requirement="TLV-001", offset=at)
    if head.size > len(payload) - start:
        raise FormatError("a TLV runs past the end of its chunk", requirement="TLV-001", offset=at)
    found[head.type] = (base + start, payload[start : start + head.size])
    return start + int(head.size)


def build_tlvs(values: dict[int, bytes]) -> bytes:
    out = bytearray()
    for type_ in sorted(values):
        value = values[type_]
        if len(value) > VALUE_SIZE:
            raise ParameterError(f"a description of {len(value)} bytes is above the limit of 65535")
        out += TLV.pack(type=type_, size=len(value)) + value
    return bytes(out)


def parse_text(raw: bytes, offset: int) -> str:
    """SPEC CNV-004."""
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError:
        raise FormatError("text is not UTF-8", requirement="CNV-004", offset=offset) from None
    if "\0" in text:
        raise FormatError("text holds U+0000", requirement="CNV-004", offset=offset)
    return text


def parse_strings(value: bytes, count: int, offset: int) -> tuple[str, ...]:
    """A string list for ``count`` components."""
    items: list[str] = []
    position = 0
    while position < len(value):
        if value[position] == SAME:
            if not items:
                raise FormatError(
                    "no text before the first", requirement="TLV-004", offset=offset + position
                )
            items.append(items[-1])
            position += 1
            continue
        stop = position + 1 + value[position]
        if stop > len(value):
            raise FormatError(
                "a string runs past its list", requirement="TLV-004", offset=offset + position
            )
        items.append(parse_text(value[position + 1 : stop], offset + position + 1))
        position = stop
    return spread(items, count, offset)


def build_strings(items: Sequence[str]) -> bytes:
    out = bytearray()
    before = None
    for item in share(items):
        raw = encode_text(item)
        out += bytes([SAME]) if raw and raw == before else bytes([len(raw)]) + raw
        before = raw
    return bytes(out)


def encode_text(text: str) -> bytes:
    """UTF-8, ParameterError where the format cannot hold it (CNV-004)."""
    try:
        raw = text.encode("utf-8")
    except (UnicodeEncodeError, AttributeError):
        raw = b"\0"
    if len(raw) > STRING_SIZE or 0 in raw:
        raise ParameterError(
            f"texts are at most 254 bytes of UTF-8 without U+0000, unlike {str(text)[:40]!r}"
        )
    return raw


def spread(items: Sequence[T], count: int, offset: int) -> tuple[T, ...]:
    """One entry for all, or one each (SPEC TLV-004)."""
    if len(items) == count:
        return tuple(items)
    if len(items) == 1:
        return tuple(items) * count
    raise FormatError(
        f"a list of {len(items)} entries for {count} components",
        requirement="TLV-004",
        offset=offset,
    )


def share(items: Sequence[T]) -> Sequence[T]:
    """The shortest list that means the same."""
    return items[:1] if all(item == items[0] for item in items) else items
