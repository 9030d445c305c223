"""Clause 2: integers, checksums, texts."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import forge as f
from page import (
    BrokenRule,
    clamp,
    rdiv,
    signed,
    svarint_bytes,
    varint,
    varint_bytes,
)

from .component import Case, Component, also, tried

EDGES = (
    0,
    1,
    2,
    63,
    64,
    127,
    128,
    129,
    300,
    16383,
    16384,
    2**21 - 1,
    2**21,
    2**31,
    2**32 - 1,
    2**32,
    2**42 + 7,
    2**49 - 1,
    2**49,
    2**52 - 1,
    2**53 - 1,
)

BAD = (
    ("no bytes", b"", 0),
    ("the bytes end within it", bytes.fromhex("80"), 0),
    ("the bytes end within it, after seven", b"\xff" * 7, 0),
    ("0 in two bytes", bytes.fromhex("8000"), 0),
    ("1 in two bytes", bytes.fromhex("8100"), 0),
    ("1 in eight bytes", bytes.fromhex("8180808080808000"), 0),
    ("2^53", bytes.fromhex("8080808080808010"), 0),
    ("2^53 + 1", bytes.fromhex("8180808080808010"), 0),
    ("2^56 - 1", b"\xff" * 7 + b"\x7f", 0),
    ("2^56, nine bytes", b"\x80" * 8 + b"\x01", 0),
    ("2^64, ten bytes", b"\x80" * 9 + b"\x02", 0),
)


def read(data: bytes, at: int) -> Case:
    value, stop = varint(data, at)
    return {"value": value, "stop": stop}


def read_signed(data: bytes, at: int) -> Case:
    value, stop = varint(data, at)
    return {"value": signed(value), "stop": stop}


def row(name: str, data: bytes, at: int, run) -> Case:
    return tried({"name": name, "bytes": data, "at": at}, lambda: run(data, at))


def varints() -> Component:
    cases = [row(str(v), varint_bytes(v), 0, read) for v in EDGES]
    cases += [
        row("a byte follows", bytes.fromhex("ac0200"), 0, read),
        row("the last byte is 0 where it is the only one", bytes.fromhex("ff0001"), 2, read),
        row("0 between others", bytes.fromhex("050007"), 1, read),
        row("the second of two", bytes.fromhex("ac02ac02"), 2, read),
    ]
    cases += [row(name, data, at, read) for name, data, at in BAD]
    return Component(
        "varint",
        "2",
        ("CNV-001", "CNV-002"),
        "The varint at offset `at` of `bytes`: its value, and `stop`, the offset behind it.",
        cases,
    )


def svarints() -> Component:
    values = sorted({0, 1, 2, 63, 64, 300, 8191, 8192, 2**31, 2**52 - 1} | {-1, -2, -64, -65, -300})
    values += [-(2**31), -(2**31) - 1, -(2**52) + 1, -(2**52)]
    cases = [row(str(v), svarint_bytes(v), 0, read_signed) for v in values]
    cases += [row(name, data, at, read_signed) for name, data, at in BAD[:5]]
    return Component(
        "svarint",
        "2",
        ("CNV-001", "CNV-002"),
        "As varint, signed.",
        cases,
    )


def divisions() -> Component:
    pairs = [
        (n, d)
        for d in (1, 2, 3, 4, 5, 64, 32768)
        for n in (
            -2 * d,
            -d - 1,
            -d,
            -d + 1,
            -(d // 2) - 1,
            -(d // 2),
            -1,
            0,
            1,
            d // 2,
            d // 2 + 1,
            d,
            d + d // 2,
        )
    ]
    pairs += [(-1, 7), (-3, 7), (-4, 7), (2**49, 2**24 - 1), (-(2**49) - 1, 2**24)]
    pairs += [(-(2**49) + 2**23, 2**24), (2**51 + 2**14, 2**15), (-(2**51) - 2**14, 2**15)]
    pairs += [(2**57 + 2**23, 2**24), (-(2**57) - 2**23 - 1, 2**24), (2**105, 2**52 + 1)]
    cases = [
        {"name": f"{n} and {d}", "n": n, "d": d, "floor": n // d, "rdiv": rdiv(n, d)}
        for n, d in dict.fromkeys(pairs)
    ]
    return Component(
        "division",
        "2",
        ("CNV-001",),
        "`floor`: n // d, rounded towards minus infinity; `rdiv`: rounded to nearest, ties towards "
        "plus infinity.",
        cases,
    )


def clamps() -> Component:
    rows = [
        ("within", 5, -10, 10),
        ("below", -11, -10, 10),
        ("above", 11, -10, 10),
        ("at the lower end", -10, -10, 10),
        ("at the upper end", 10, -10, 10),
        ("one value only", 3, 7, 7),
        ("24 bits", 2**24, -(2**23), 2**23 - 1),
        ("32 bits, below", -(2**33), -(2**31), 2**31 - 1),
        ("32 bits, above", 2**33, -(2**31), 2**31 - 1),
        ("all positive", 0, 1, 9),
    ]
    cases: list[Case] = [
        {"name": name, "x": x, "low": low, "high": high, "result": clamp(x, low, high)}
        for name, x, low, high in rows
    ]
    for name, lf, hf, d, e in (
        ("a sum", (-100, 100), (-50, 50), 30, -12),
        ("a sum above the LF track's range", (-100, 100), (-50, 50), 90, 20),
        ("a sum below the LF track's range", (0, 255), (-50, 50), 10, -40),
        ("LF clamped before it is added", (0, 255), (-50, 50), 300, -40),
        ("HF clamped before it is added", (-100, 100), (-5, 5), 20, 40),
        ("level 2", (-(2**31), 2**31 - 1), (-(2**31), 2**31 - 1), 2**31 - 1, 2**31 - 1),
    ):
        total = clamp(clamp(d, *lf) + clamp(e, *hf), *lf)
        cases.append({"name": name, "lf": d, "lf_range": lf, "hf": e, "hf_range": hf, "sum": total})
    return Component(
        "clamp",
        "2, 10",
        ("CNV-001", "DEC-001"),
        "clamp(x, low, high); and the count of a channel of two tracks: both clamped to their "
        "declared ranges, added, and clamped to that of LF.",
        cases,
    )


def checksums() -> Component:
    texts = (
        ("no bytes", b""),
        ("the check of clause 2", b"123456789"),
        ("one 0", b"\0"),
        ("one FF", b"\xff"),
        ("32 times 0", bytes(32)),
        ("32 times FF", b"\xff" * 32),
        ("sync word", bytes.fromhex("f9488b1c")),
        ("all bytes", bytes(range(256))),
        ("all bytes, backwards", bytes(reversed(range(256)))),
        ("1000 bytes", bytes(i * i % 251 for i in range(1000))),
    )
    return Component(
        "crc32",
        "2",
        ("CHK-002", "CHK-003", "DAT-004"),
        "`crc`: the CRC-32 of `bytes`.",
        [{"name": name, "bytes": data, "crc": zlib.crc32(data)} for name, data in texts],
    )


def file_checksums() -> Component:
    nine = b"123456789"
    rows = (
        ("the check of clause 2", 7, nine),
        ("no bytes", 7, b""),
        ("file id 0", 0, nine),
        ("the largest file id", 2**64 - 1, nine),
        ("a file id of 33 bits", 2**32 + 7, nine),
        ("a file id of 64 bits", 0x0123456789ABCDEF, bytes(range(256))),
    )
    return Component(
        "file-crc",
        "2",
        ("CHK-003", "DAT-004"),
        "`crc`: the file CRC of `bytes` under `file_id`.",
        [
            {"name": name, "file_id": f"0x{id_:016x}", "bytes": data, "crc": f.file_crc(data, id_)}
            for name, id_, data in rows
        ],
    )


def parse_strings(data: bytes, count: int) -> list[str]:
    """The texts of ``count`` components."""
    out: list[str] = []
    at = 0
    while at < len(data):
        size = data[at]
        at += 1
        if size == 255:
            if not out:
                raise BrokenRule("TLV-004")
            out.append(out[-1])
            continue
        if at + size > len(data):
            raise BrokenRule("TLV-004")
        try:
            out.append(data[at : at + size].decode("utf-8", "strict"))
        except UnicodeDecodeError:
            raise BrokenRule("CNV-004") from None
        if "\0" in out[-1]:
            raise BrokenRule("CNV-004")
        at += size
    if len(out) not in (1, count):
        raise BrokenRule("TLV-004")
    return out * count if len(out) == 1 else out


def strings() -> Component:
    def entry(text: str | bytes) -> bytes:
        raw = text.encode() if isinstance(text, str) else text
        return bytes([len(raw)]) + raw

    rows = (
        ("one for all", entry("N"), 3),
        ("one each", entry("x") + entry("y") + entry("z"), 3),
        ("empty", entry(""), 2),
        ("one component", entry("force"), 1),
        ("255 repeats", entry("a") + b"\xff" + entry("b") + b"\xff", 4),
        ("255 after 255", entry("ab") + b"\xff\xff", 3),
        ("255 repeats an empty text", b"\0\xff", 2),
        ("254 bytes", entry("m" * 254), 1),
        ("letters of two to four bytes", entry("°µ€𝄞"), 1),
        ("spaces are kept", entry(" a "), 1),
        ("255 first", b"\xff", 1),
        ("255 first, a text behind it", b"\xff" + entry("a"), 2),
        ("two for three", entry("a") + entry("b"), 3),
        ("four for three", entry("a") * 4, 3),
        ("none", b"", 1),
        ("ends within an entry", b"\x05abc", 1),
        ("ends after the length", b"\x01", 1),
        ("U+0000", entry("a\0b"), 1),
        ("a byte that begins nothing", entry(b"\x80"), 1),
        ("a letter cut short", entry(b"\xc2"), 1),
        ("too long a form of /", entry(b"\xc0\xaf"), 1),
        ("half a surrogate pair", entry(b"\xed\xa0\x80"), 1),
        ("beyond U+10FFFF", entry(b"\xf4\x90\x80\x80"), 1),
        ("the sync word", entry(bytes.fromhex("f9488b1c")), 1),
    )
    cases = [
        tried(
            {"name": name, "bytes": data, "components": count},
            lambda data=data, count=count: {"texts": parse_strings(data, count)},
        )
        for name, data, count in rows
    ]
    return Component(
        "strings",
        "2, 6.2",
        ("CNV-004", "TLV-004"),
        "String lists for so many components; `texts` has one for each.",
        also(cases, {"four for three": ["TLV-004"]}),
    )


def components() -> Iterator[Component]:
    yield varints()
    yield svarints()
    yield divisions()
    yield clamps()
    yield checksums()
    yield file_checksums()
    yield strings()
