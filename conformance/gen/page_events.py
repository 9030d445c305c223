"""SPEC 9.9 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

from page import BrokenRule, varint, varint_bytes


def decode(data: bytes, start: int, span: int) -> list[tuple[int, int, int, str]]:
    """(tick, duration, channel as it is stored, text)"""
    out = []
    at, tick = 0, start
    while at < len(data):
        if len(out) == 65536:
            raise BrokenRule("EVT-001")
        numbers = []
        for _ in range(4):
            number, at = varint(data, at)
            numbers.append(number)
        step, duration, channel, size = numbers
        tick += step
        if tick >= start + span or tick + duration > 2**48:
            raise BrokenRule("EVT-001")
        if size > 65535 or channel > 65535:
            raise BrokenRule("EVT-003")
        if at + size > len(data):
            raise BrokenRule("EVT-001")
        try:
            text = data[at : at + size].decode("utf-8", "strict")
        except UnicodeDecodeError:
            raise BrokenRule("CNV-004") from None
        if "\0" in text:
            raise BrokenRule("CNV-004")
        at += size
        out.append((tick, duration, channel, text))
    if not out:
        raise BrokenRule("EVT-001")
    return out


def encode(events: list[tuple[int, int, int, str]], start: int) -> bytes:
    out, before = b"", start
    for tick, duration, channel, text in events:
        raw = text.encode()
        for number in (tick - before, duration, channel, len(raw)):
            out += varint_bytes(number)
        out, before = out + raw, tick
    return out
