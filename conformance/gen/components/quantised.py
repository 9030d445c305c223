"""Clause 9.2: codebooks, zero runs, escapes; the page's QUAN, one bit after the other."""

from __future__ import annotations

from collections.abc import Iterator

import page_quantised
from luck import Luck
from page import BrokenRule
from page_quantised import code_words, codebook, lengths_of

from .component import Case, Component, tried


def extra_bits(symbol: int, m: int, r: int) -> int:
    if symbol <= 2 * m:
        return 0
    return symbol - 2 * m if symbol <= 2 * m + r else symbol - 2 * m - r


def meaning(symbol: int, x: int, m: int, r: int) -> list[int]:
    """The levels of a symbol with its extra bits."""
    if symbol <= 2 * m:
        return [(symbol + 1) // 2 * (1 if symbol % 2 else -1)]
    if symbol <= 2 * m + r:
        return [0] * (2 ** (symbol - 2 * m) + x)
    j = symbol - 2 * m - r - 1
    return [(m + 2**j + x // 2) * (-1 if x % 2 else 1)]


def read(words: dict[int, str], data: bytes, m: int, r: int, total: int):
    """(symbol, extra bits) to the last level, and the levels."""
    bits = "".join(f"{byte:08b}" for byte in data)
    symbols, levels, at = [], [], 0
    while len(levels) < total:
        found = [symbol for symbol, word in words.items() if bits.startswith(word, at)]
        if not found:
            raise BrokenRule("COD-001")
        symbol = found[0]
        at += len(words[symbol])
        size = extra_bits(symbol, m, r)
        if at + size > len(bits):
            raise BrokenRule("COD-001")
        x = int("0" + bits[at : at + size], 2)
        at += size
        symbols.append([symbol, x])
        levels += meaning(symbol, x, m, r)
    if len(levels) > total:
        raise BrokenRule("QNT-004")
    if "1" in bits[at:] or len(bits) - at >= 8:
        raise BrokenRule("QNT-004") if at else BrokenRule("QNT-004", "COD-001")
    return symbols, levels


def packed(words: dict[int, str], symbols, m: int, r: int) -> bytes:
    bits = ""
    for symbol, x in symbols:
        size = extra_bits(symbol, m, r)
        bits += words[symbol] + (f"{x:0{size}b}" if size else "")
    bits += "0" * (-len(bits) % 8)
    return bytes(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))


def codebooks() -> Component:
    rows = (
        ("two of one bit", 1, 0, 0, "11"),
        ("three lengths", 1, 0, 0, "122 0"),
        ("a gap of one: 0 and 0", 1, 0, 0, "1 00 1"),
        ("a gap of two", 2, 0, 0, "1 01 22 0"),
        ("symbols without a nibble have none", 9, 3, 3, "11"),
        ("order by length, then symbol", 2, 0, 0, "23 23 2 0"),
        ("the longest first", 2, 0, 0, "4 4 3 2 1 0"),
        ("a gap of 16", 9, 0, 0, "1 0F 1"),
        ("a gap of 17 is two", 9, 0, 0, "1 0F 00 1"),
        ("a gap at the beginning", 3, 1, 1, "02 11"),
        ("one symbol only", 3, 1, 1, "04 10"),
        ("the first symbol only", 3, 0, 0, "10"),
        ("length 15", 8, 0, 0, "123456789ABCDEFF"),
        ("runs and escapes", 1, 2, 3, "22 33 40 04 30"),
        ("a gap to the last symbol", 8, 0, 0, "11 0E"),
        ("more than there are", 1, 0, 0, "2222"),
        ("a gap beyond the last symbol", 8, 0, 0, "11 0F"),
        ("none at all", 1, 0, 0, ""),
        ("too few", 1, 0, 0, "12"),
        ("too many", 1, 0, 0, "1110"),
        ("one symbol of two bits", 1, 0, 0, "20"),
        ("gaps alone", 1, 0, 0, "02"),
    )

    def run(m: int, r: int, c: int, data: bytes) -> Case:
        lengths = lengths_of(data, 2 * m + r + c + 1)
        words = code_words(lengths)
        return {"lengths": lengths, "words": {str(s): words[s] for s in sorted(words)}}

    cases = [
        tried(
            {
                "name": name,
                "direct_levels": m,
                "run_classes": r,
                "escape_classes": c,
                "codebook": data,
            },
            lambda m=m, r=r, c=c, data=data: run(m, r, c, data),
        )
        for name, m, r, c, nibbles in rows
        for data in [bytes.fromhex(nibbles.replace(" ", ""))]
    ]
    return Component(
        "codebook",
        "9.2",
        ("QNT-003",),
        "Codebooks: the code word length of every symbol (0: none), and the code words. An empty "
        "word "
        "takes no bits.",
        cases,
    )


FLAT = [3, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4]
"""Of M = 1, R = 4, C = 5: 0, 1, -1, runs of 2 to 31, levels of 2 to 33."""


def packets() -> Component:
    flat = {"step": 1, "m": 1, "r": 4, "c": 5, "lengths": FLAT}
    rng = Luck(3)
    noise = []
    for _ in range(60):
        symbol = rng.below(12)
        noise.append((symbol, rng.below(2 ** extra_bits(symbol, 1, 4))))
    rows: list[tuple] = [
        ("one level", flat, 1, [(1, 0)]),
        ("direct levels", flat, 4, [(0, 0), (1, 0), (2, 0), (0, 0)]),
        ("shortest run", flat, 2, [(3, 0)]),
        ("a run of 3", flat, 3, [(3, 1)]),
        ("runs of each class, shortest", flat, 30, [(3, 0), (4, 0), (5, 0), (6, 0)]),
        ("runs of each class, longest", flat, 56, [(3, 1), (4, 3), (5, 7), (6, 15)]),
        ("escapes of each class", flat, 5, [(7, 0), (8, 1), (9, 6), (10, 9), (11, 30)]),
        ("escapes of each class, longest", flat, 5, [(7, 1), (8, 3), (9, 7), (10, 15), (11, 31)]),
        ("noise", flat, sum(len(meaning(s, x, 1, 4)) for s, x in noise), noise),
        ("a step", flat | {"step": 25}, 3, [(1, 0), (8, 3), (2, 0)]),
        ("the last bit ends a byte", flat, 2, [(11, 1), (2, 0)]),
        (
            "one symbol: no bits at all",
            {"step": 1, "m": 1, "r": 0, "c": 0, "lengths": [0, 1, 0]},
            9,
            [(1, 0)] * 9,
        ),
        (
            "one symbol, an escape: its extra bits alone",
            {"step": 3, "m": 0, "r": 0, "c": 3, "lengths": [0, 0, 0, 1]},
            3,
            [(3, 5), (3, 0), (3, 7)],
        ),
        (
            "one symbol, a run",
            {"step": 1, "m": 0, "r": 3, "c": 0, "lengths": [0, 0, 0, 1]},
            22,
            [(3, 0), (3, 6)],
        ),
        ("level 0 alone", {"step": 7, "m": 0, "r": 0, "c": 0, "lengths": [1]}, 100, [(0, 0)] * 100),
        (
            "M = 0",
            {"step": 1, "m": 0, "r": 1, "c": 2, "lengths": [2, 2, 2, 2]},
            6,
            [(2, 0), (2, 1), (3, 2), (3, 1), (1, 0)],
        ),
        (
            "the largest count",
            {"step": 2**24, "m": 2, "r": 0, "c": 0, "lengths": [0, 0, 0, 1, 1]},
            2,
            [(3, 0), (4, 0)],
        ),
        (
            "a code word of 15 bits",
            {"step": 1, "m": 8, "r": 0, "c": 0, "lengths": [*range(1, 16), 15, 0]},
            5,
            [(0, 0), (14, 0), (15, 0), (13, 0), (1, 0)],
        ),
    ]
    cases = [packet(*row) for row in rows]
    whole = packed(code_words(FLAT), noise, 1, 4)
    total = sum(len(meaning(s, x, 1, 4)) for s, x in noise)
    cases += [
        packet("the run passes the end", flat, 20, [(6, 5)]),
        packet("a byte is missing", flat, total, data=whole[:-1]),
        packet("a byte left over", flat, total, data=whole + b"\0"),
        packet("a bit that fills is 1", flat, 1, data=bytes.fromhex("21")),
        packet("no bytes", flat, 1, data=b""),
        packet(
            "bytes where one symbol takes none",
            {"step": 1, "m": 1, "r": 0, "c": 0, "lengths": [0, 1, 0]},
            9,
            data=b"\0",
        ),
        packet(
            "level times step too large",
            {"step": 2**24, "m": 3, "r": 0, "c": 0, "lengths": [0, 0, 0, 0, 0, 1, 1]},
            1,
            [(5, 0)],
        ),
    ]
    return Component(
        "quan",
        "9.2",
        ("QNT-004", "QNT-006", "COD-001"),
        "Packets of QUAN with `total` levels, at level 1: the symbols with the number of their "
        "extra "
        "bits, the levels, and the counts before they are clamped.",
        cases,
    )


def packet(name: str, given: dict, total: int, symbols=None, data: bytes | None = None) -> Case:
    m, r, c = given["m"], given["r"], given["c"]
    words = code_words(given["lengths"])
    data = packed(words, symbols, m, r) if data is None else data
    case: Case = {
        "name": name,
        "step": given["step"],
        "direct_levels": m,
        "run_classes": r,
        "escape_classes": c,
        "codebook": codebook(given["lengths"]),
        "packet": data,
        "total": total,
    }

    def run() -> Case:
        found, levels = read(words, data, m, r, total)
        assert levels == page_quantised.decode(data, total, m, r, given["lengths"])
        if max(map(abs, levels)) * given["step"] > 2 * 2**24:
            raise BrokenRule("QNT-006")
        counts = [level * given["step"] for level in levels]
        return {"symbols": found, "levels": levels, "counts": counts}

    return tried(case, run)


def components() -> Iterator[Component]:
    yield codebooks()
    yield packets()
