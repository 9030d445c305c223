"""Clause 9.3: words byte plane by byte plane, stored or DEFLATE."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import deflate
from luck import Luck
from page import BrokenRule
from page_raw import planes

from .component import Case, Component, tried


def parse(data: bytes, span: int, count: int, size: int, signed: bool) -> list[list[int]]:
    if not data:
        raise BrokenRule("COD-001", "RAW-003")
    if data[0] > 1:
        raise BrokenRule("RAW-003")
    whole = inflated(data[1:], span * count * size) if data[0] else data[1:]
    if len(whole) != span * count * size:
        raise BrokenRule("RAW-003")
    out = []
    for i in range(count):
        part = whole[i * span * size : (i + 1) * span * size]
        row = [sum(part[j * span + t] * 256**j for j in range(size)) for t in range(span)]
        half = 256**size // 2
        out.append([n - 2 * half if signed and n >= half else n for n in row])
    return out


def inflated(data: bytes, size: int) -> bytes:
    stream = zlib.decompressobj(-15)
    try:
        out = stream.decompress(data, size + 1)
    except zlib.error:
        raise BrokenRule("RAW-003") from None
    if len(out) > size:
        raise BrokenRule("RAW-003")
    if len(out) < size and not stream.eof:
        raise BrokenRule("RAW-003")
    if not stream.eof or stream.unused_data:
        raise BrokenRule("RAW-003")
    return out


def in_blocks(data: bytes, *sizes: int) -> bytes:
    """Stored blocks of DEFLATE."""
    out, at = b"", 0
    for i, size in enumerate(sizes):
        part = data[at : at + size]
        at += size
        out += bytes([i == len(sizes) - 1]) + len(part).to_bytes(2, "little")
        out += (65535 - len(part)).to_bytes(2, "little") + part
    assert at == len(data)
    return out


def fixed(*tokens: deflate.Token, last: bool = True) -> str:
    """A block with the fixed codes."""
    return deflate.block(tokens, last=last, kind=deflate.FIXED)


def packets() -> Component:
    rng = Luck(21)
    two = [[1, -1, 300, -300], [0, 5, -32768, 32767]]
    whole = planes(two, 2)
    rows: list[tuple] = [
        ("one byte", 1, 4, 1, b"\0" + planes([[0, 1, -1, -128]], 1)),
        ("two bytes", 2, 4, 1, b"\0" + planes([[0, 256, -1, -32768]], 2)),
        ("three bytes", 3, 4, 1, b"\0" + planes([[0, 65536, -1, -(2**23)]], 3)),
        ("four bytes", 4, 4, 1, b"\0" + planes([[0, 2**24, -1, -(2**31)]], 4)),
        ("two components", 2, 4, 2, b"\0" + whole),
        ("DEFLATE, one stored block", 2, 4, 2, b"\1" + in_blocks(whole, 16)),
        ("DEFLATE, stored blocks, one of them empty", 2, 4, 2, b"\1" + in_blocks(whole, 5, 0, 11)),
        ("DEFLATE, fixed codes", 2, 4, 2, b"\1" + deflate.packed(fixed(*whole))),
        ("DEFLATE, fixed codes with copies", 1, 9, 1, b"\1" + deflate.packed(fixed(7, (8, 1)))),
        ("DEFLATE, a copy over its own end", 1, 9, 1, b"\1" + deflate.packed(fixed(7, 8, (7, 2)))),
        (
            "DEFLATE, two blocks, a copy from one to the other",
            1,
            8,
            1,
            b"\1" + deflate.packed(fixed(1, 2, 3, last=False) + fixed((5, 3))),
        ),
        (
            "DEFLATE, codes of its own",
            1,
            8,
            1,
            b"\1" + deflate.deflate(bytes([0, 1, 0, 2, 0, 0, 1, 0])),
        ),
    ]
    words = [rng.word() for _ in range(5)]
    cases = [packet(*row) for row in rows]
    cases.append(packet("words of eight bytes", 8, 5, 1, b"\0" + planes([words], 8), signed=False))
    cases.append(packet("words of two bytes", 2, 2, 1, bytes.fromhex("0000ff003c"), signed=False))
    fixed_block = b"\1" + deflate.packed(fixed(*whole))
    cases += [
        packet("no bytes", 1, 1, 1, b""),
        packet("method 2", 1, 1, 1, b"\2\0"),
        packet("a byte is missing", 2, 4, 2, b"\0" + whole[:-1]),
        packet("a byte left over", 2, 4, 2, b"\0" + whole + b"\0"),
        packet("DEFLATE, a byte too few", 2, 4, 2, b"\1" + in_blocks(whole[:-1], 15)),
        packet("DEFLATE, a byte too many", 2, 4, 2, b"\1" + in_blocks(whole + b"\0", 17)),
        packet(
            "DEFLATE, no last block", 2, 4, 2, b"\1" + deflate.packed(fixed(*whole, last=False))
        ),
        packet("DEFLATE, cut", 2, 4, 2, fixed_block[:-2]),
        packet("DEFLATE, a byte behind it", 2, 4, 2, fixed_block + b"\0"),
        packet("DEFLATE, a reserved kind of block", 1, 1, 1, b"\1\7"),
        packet(
            "DEFLATE, a copy from before the start",
            1,
            9,
            1,
            b"\1" + deflate.packed(fixed(7, (8, 2))),
        ),
    ]
    return Component(
        "rawb",
        "9.3",
        ("RAW-003", "COD-001"),
        "Packets of RAWB: the numbers of each component, counts where `signed`, else words.",
        cases,
    )


def packet(name, size, span, count, data, *, signed=True) -> Case:
    case: Case = {
        "name": name,
        "word_size": size,
        "span": span,
        "components": count,
        "signed": signed,
        "packet": data,
    }
    return tried(case, lambda: {"numbers": parse(data, span, count, size, signed)})


def components() -> Iterator[Component]:
    yield packets()
