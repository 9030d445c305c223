"""SPEC 9.2 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

from typing import NamedTuple

from page_numbers import BrokenRule, bits_of


class Run(NamedTuple):
    """So many times level 0, written as one symbol."""

    length: int


class Escape(NamedTuple):
    """A level written with an escape symbol."""

    level: int


def codebook(lengths: list[int]) -> bytes:
    """Nibbles of the code word lengths; 0 for a symbol without one."""
    nibbles: list[int] = []
    rest = list(lengths)
    while rest and rest[-1] == 0:
        rest.pop()
    at = 0
    while at < len(rest):
        if rest[at] > 0:
            nibbles.append(rest[at])
            at += 1
            continue
        size = 0
        while rest[at + size] == 0 and size < 16:
            size += 1
        nibbles += [0, size - 1]
        at += size
    nibbles += [0] * (len(nibbles) % 2)
    return bytes(16 * nibbles[i] + nibbles[i + 1] for i in range(0, len(nibbles), 2))


def lengths_of(book: bytes, symbols: int) -> list[int]:
    nibbles = [nibble for byte in book for nibble in (byte // 16, byte % 16)]
    out: list[int] = []
    at = 0
    while at < len(nibbles):
        if nibbles[at] > 0:
            out.append(nibbles[at])
            at += 1
        elif at == len(nibbles) - 1:
            break
        else:
            out += [0] * (nibbles[at + 1] + 1)
            at += 2
    if len(out) > symbols:
        raise BrokenRule("QNT-003")
    used = [length for length in out if length > 0]
    if used != [1] and sum(2 ** (15 - length) for length in used) != 2**15:
        raise BrokenRule("QNT-003")
    return out + [0] * (symbols - len(out))


def code_words(lengths: list[int]) -> dict[int, str]:
    """Symbol -> its bits; one symbol alone has none."""
    order = sorted((length, symbol) for symbol, length in enumerate(lengths) if length > 0)
    if len(order) == 1:
        return {order[0][1]: ""}
    out, code, before = {}, 0, order[0][0]
    for number, (length, symbol) in enumerate(order):
        if number > 0:
            code = (code + 1) << (length - before)
        out[symbol], before = f"{code:0{length}b}", length
    return out


def extra(value: int, size: int) -> str:
    return f"{value:0{size}b}" if size else ""


def symbol_of(token: int | Run | Escape, m: int, r: int) -> tuple[int, str]:
    """The symbol and its extra bits."""
    if isinstance(token, Run):
        j = bits_of(token.length) - 1
        return 2 * m + j, extra(token.length - 2**j, j)
    if isinstance(token, Escape):
        over = abs(token.level) - m
        j = bits_of(over) - 1
        return 2 * m + r + 1 + j, extra(over - 2**j, j) + str(int(token.level < 0))
    return (0 if token == 0 else 2 * abs(token) - int(token > 0)), ""


def encode(tokens: list[int | Run | Escape], m: int, r: int, lengths: list[int]) -> bytes:
    words, bits = code_words(lengths), ""
    for token in tokens:
        symbol, more = symbol_of(token, m, r)
        bits += words[symbol] + more
    bits += "0" * (-len(bits) % 8)
    return bytes(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))


def levels_of(tokens: list[int | Run | Escape]) -> list[int]:
    out: list[int] = []
    for token in tokens:
        if isinstance(token, Run):
            out += [0] * token.length
        else:
            out.append(token.level if isinstance(token, Escape) else token)
    return out


def decode(data: bytes, count: int, m: int, r: int, lengths: list[int]) -> list[int]:
    """The levels of ``count`` samples."""
    symbols = {word: symbol for symbol, word in code_words(lengths).items()}
    bits, at = "".join(f"{byte:08b}" for byte in data), 0

    def take(size: int) -> str:
        nonlocal at
        if at + size > len(bits):
            raise BrokenRule("COD-001")
        at += size
        return bits[at - size : at]

    out: list[int] = []
    while len(out) < count:
        word = ""
        while word not in symbols:
            word += take(1)
        symbol = symbols[word]
        if symbol <= 2 * m:
            out.append((symbol + 1) // 2 * (1 if symbol % 2 else -1))
        elif symbol <= 2 * m + r:
            j = symbol - 2 * m
            out += [0] * (2**j + int("0" + take(j), 2))
        else:
            j = symbol - 2 * m - r - 1
            level = m + 2**j + int("0" + take(j), 2)
            out.append(-level if take(1) == "1" else level)
    if len(out) > count:
        raise BrokenRule("QNT-004")
    if len(bits) - at >= 8 or "1" in bits[at:]:
        raise BrokenRule("QNT-004")
    return out
