"""Clause 9.3: words byte plane by byte plane, stored or DEFLATE."""

from __future__ import annotations

import random
import zlib
from collections.abc import Iterator

from page import BrokenRule

from .component import Case, Component, tried


def planes(numbers: list[list[int]], size: int) -> bytes:
    """``numbers``: one row for each component."""
    return bytes(
        number % 256**size // 256**i % 256 for row in numbers for i in range(size) for number in row
    )


def parse(data: bytes, span: int, count: int, size: int, signed: bool) -> list[list[int]]:
    if not data:
        raise BrokenRule("COD-001", "RAW-002")
    if data[0] > 1:
        raise BrokenRule("RAW-002")
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
        raise BrokenRule("RAW-004") from None
    if len(out) > size:
        raise BrokenRule("RAW-003")
    if len(out) < size and not stream.eof:
        raise BrokenRule("RAW-003", "RAW-004")
    if not stream.eof or stream.unused_data:
        raise BrokenRule("RAW-004")
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


def packed(text: str) -> bytes:
    """Bits of DEFLATE: bytes are filled from bit 0 upwards."""
    text += "0" * (-len(text) % 8)
    return bytes(int(text[i : i + 8][::-1], 2) for i in range(0, len(text), 8))


def fixed(*parts: int | tuple[int, int], last: bool = True) -> str:
    """A block with the fixed codes: literals, and (length 3 ... 10, distance 1 ... 4)."""
    out = ("1" if last else "0") + number(1, 2)
    for part in parts:
        if isinstance(part, tuple):
            length, distance = part
            out += f"{length - 2:07b}{distance - 1:05b}"
        else:
            out += f"{part + 48:08b}" if part < 144 else f"{part + 256:09b}"
    return out + "0" * 7


def dynamic() -> bytes:
    """A block with codes of its own: literals 0, 1, 2 and the end; no distances."""
    order = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1]
    sizes = {1: 2, 3: 2, 18: 2, 0: 3, 2: 3}
    codes = {1: "00", 3: "01", 18: "10", 0: "110", 2: "111"}
    words = {0: "0", 1: "10", 2: "110", 256: "111"}
    out = "1" + number(2, 2) + number(0, 5) + number(0, 5) + number(len(order) - 4, 4)
    out += "".join(number(sizes.get(symbol, 0), 3) for symbol in order)
    out += codes[1] + codes[2] + codes[3]  # lengths of the words for 0, 1, 2
    out += codes[18] + number(138 - 11, 7) + codes[18] + number(115 - 11, 7)  # none for 3 to 255
    out += codes[3] + codes[0]  # that of the end; none of the one distance code
    return packed(out + "".join(words[b] for b in (0, 1, 0, 2, 0, 0, 1, 0, 256)))


def number(value: int, size: int) -> str:
    """Lowest bit first, as DEFLATE has all numbers but code words."""
    return f"{value:0{size}b}"[::-1]


def packets() -> Component:
    rng = random.Random(21)
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
        ("DEFLATE, fixed codes", 2, 4, 2, b"\1" + packed(fixed(*whole))),
        ("DEFLATE, fixed codes with copies", 1, 9, 1, b"\1" + packed(fixed(7, (8, 1)))),
        ("DEFLATE, a copy over its own end", 1, 9, 1, b"\1" + packed(fixed(7, 8, (7, 2)))),
        (
            "DEFLATE, two blocks, a copy from one to the other",
            1,
            8,
            1,
            b"\1" + packed(fixed(1, 2, 3, last=False) + fixed((5, 3))),
        ),
        ("DEFLATE, codes of its own", 1, 8, 1, b"\1" + dynamic()),
    ]
    words = [rng.randrange(2**64) for _ in range(5)]
    cases = [packet(*row) for row in rows]
    cases.append(packet("words of eight bytes", 8, 5, 1, b"\0" + planes([words], 8), signed=False))
    cases.append(packet("words of two bytes", 2, 2, 1, bytes.fromhex("0000ff003c"), signed=False))
    fixed_block = b"\1" + packed(fixed(*whole))
    cases += [
        packet("no bytes", 1, 1, 1, b""),
        packet("method 2", 1, 1, 1, b"\2\0"),
        packet("a byte is missing", 2, 4, 2, b"\0" + whole[:-1]),
        packet("a byte left over", 2, 4, 2, b"\0" + whole + b"\0"),
        packet("DEFLATE, a byte too few", 2, 4, 2, b"\1" + in_blocks(whole[:-1], 15)),
        packet("DEFLATE, a byte too many", 2, 4, 2, b"\1" + in_blocks(whole + b"\0", 17)),
        packet("DEFLATE, no last block", 2, 4, 2, b"\1" + packed(fixed(*whole, last=False))),
        packet("DEFLATE, cut", 2, 4, 2, fixed_block[:-2]),
        packet("DEFLATE, a byte behind it", 2, 4, 2, fixed_block + b"\0"),
        packet("DEFLATE, a reserved kind of block", 1, 1, 1, b"\1\7"),
        packet("DEFLATE, a copy from before the start", 1, 9, 1, b"\1" + packed(fixed(7, (8, 2)))),
    ]
    return Component(
        "rawb",
        "9.3",
        ("RAW-002", "RAW-003", "RAW-004", "COD-001"),
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
