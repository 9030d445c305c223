"""Clause 9.8: cosines, steps, lapped transforms, packets of MDCT."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator

import page_transform as mdct
from luck import Luck, walk
from page_transform import LARGEST, TABLE, wave

from .component import Case, Component, also, tried


def cosines() -> Component:
    digest = hashlib.sha256(struct.pack("<1025H", *TABLE)).hexdigest()
    assert digest == mdct.DIGEST
    shown = (0, 1, -1, 512, 1023, 1024, 1025, 2047, 2048, 2049, -2048, 3072, 4095, 4096, 4097,
             1023 * 1023, 1023 * 1021)  # fmt: skip
    cases: list[Case] = [
        {"name": "the table", "sha256": digest, "entries": TABLE},
        {"name": "any i", "pairs": [[i, wave(i)] for i in shown]},
    ]
    return Component(
        "cosine",
        "9.8",
        ("CNV-001",),
        "C(0) to C(1024) with the SHA-256 of these entries as u16; pairs of i and C(i).",
        cases,
    )


def steps() -> Component:
    rows = [
        ("no weights", 5, 4096, []),
        ("the least step", 9, 1, []),
        ("the largest step", 9, 2**32, []),
        ("one weight, rounded", 5, 100, [25]),
        ("weights below 1 are 1", 5, 3, [0, 1, 5, 6]),
        ("half a step is rounded up", 5, 16, [1, 2, 3, 4]),
        ("as many weights as coefficients", 5, 1000, list(range(20, 52))),
        ("the largest weight of the largest step", 6, 2**32, [255, 0]),
        ("128 weights for 512 coefficients", 9, 777, [255 - i for i in range(128)]),
        ("blocks of 16", 4, 1, []),
        ("blocks of 1024", 10, 1, []),
        ("a step of 0", 5, 0, []),
        ("a step above 2^32", 5, 2**32 + 1, []),
        ("three weights", 5, 1, [32] * 3),
        ("more weights than coefficients", 5, 1, [32] * 64),
    ]
    cases = [
        tried(
            {"name": name, "m": m, "step": step, "weights": weights},
            lambda row=(m, step, weights): {"steps": mdct.steps(*row)},
        )
        for name, m, step, weights in rows
    ]
    return Component(
        "mdct-steps",
        "9.8",
        ("MDC-001", "CNV-001"),
        "Parameters, and s[0] to s[M - 1].",
        cases,
    )


def transform(name: str, m: int, blocks: list[list[int]]) -> Case:
    """``blocks``: the first coefficients of each; the others are 0."""
    v = [mdct.unfold(block, m) for block in blocks] if m == 5 else None
    case: Case = {"name": name, "m": m, "coefficients": blocks}
    if v is not None:
        case["v"] = v
    return case | {"x": mdct.transform(blocks, m)}


def transforms() -> Component:
    luck = Luck(98)
    cases = [
        transform("a constant, nearly", 5, [[5215 * 256]]),
        transform("one coefficient in the middle", 5, [[0] * 11 + [-70000]]),
        transform("the last coefficient", 5, [[0] * 31 + [70000]]),
        transform("all coefficients", 5, [[luck.between(-9999, 9999) for _ in range(32)]]),
        transform("two blocks", 5, [[300000, 4000], [300000, -4000, 77]]),
        transform("a block of zeros between", 5, [[99999] * 5, [], [-99999] * 5]),
        transform("small numbers, whose rounding counts", 5,
                  [[luck.between(-400, 400) for _ in range(32)] for _ in range(4)]),
        transform("the largest sum", 5, [[LARGEST], [0, -LARGEST]]),
        transform("the largest sum, of all coefficients", 5,
                  [[2**31 * (-1) ** (k // 3) for k in range(32)]] * 2),
    ]  # fmt: skip
    for m in range(6, 10):
        rows = [[luck.bell(40000) for _ in range(40)], [luck.bell(9000) for _ in range(2**m)]]
        cases.append(transform(f"blocks of {2**m}", m, rows))
    return Component(
        "transform",
        "9.8",
        ("CNV-001",),
        "Coefficients X of each block, those left out being 0; v of each block, where M is 32; x "
        "of all blocks.",
        cases,
    )


def packet(name: str, data: bytes, span: int, m: int = 5, step: int = 256, width: int = 1,
           weights: tuple[int, ...] = ()) -> Case:  # fmt: skip
    case: Case = {"name": name, "packet": data, "span": span, "components": width, "m": m}
    case |= {"step": step, "weights": list(weights)}
    s = mdct.steps(m, step, weights)

    def run() -> Case:
        counts = mdct.decode_packet(data, span, m, s, width)
        if width > 1:
            return {"counts": counts}
        seen: list = []
        mdct.decode(data, span, m, s, seen=seen)
        if not seen or span * m > 700:
            return {"counts": counts}
        integers, blocks, contexts = seen
        if name == "every state":
            assert {state for *_, state in contexts} == {*range(8)}
        return {"integers": integers, "contexts": contexts, "blocks": blocks, "counts": counts}

    return tried(case, run)


def of_signal(counts, m: int, step: int, base: int = 0, kept: int | None = None, weights=(),
              **given) -> bytes:  # fmt: skip
    """The component packet of an encoder that takes the next integer each time."""
    s = mdct.steps(m, step, weights)[: kept or 2**m]
    blocks = [row[: len(s)] for row in mdct.analyse([c - base for c in counts], m)]
    return mdct.encode(mdct.quantise(blocks, s), s, base, **given)


def some(seed: int, kept: int, blocks: int, *sizes: int) -> list[list[int]]:
    luck = Luck(seed)
    return [
        [luck.between(-size, size) for size in [luck.choice(sizes) for _ in range(kept)]]
        for _ in range(blocks)
    ]


def packets() -> Component:
    slow = walk(100, 100, 6)
    e, p, s = mdct.encode, mdct.encode_packet, mdct.steps(5, 256)
    huge, least = some(1, 5, 9, 0, 9, 4000, 2**20), mdct.steps(5, 1)
    rows: list[tuple] = [
        ("no coefficients", e([], s, -7), 4),
        ("one coefficient, one tick", e([[3]], s), 1),
        ("one coefficient, one block", e([[3]], s), 32),
        ("one coefficient, two blocks", e([[3], [-2]], s, 100), 33),
        ("every state", e(some(3, 20, 3, 1, 2), s), 96),
        ("even integers: state 0 remains", e([[2, -4, 0, 6], [0, 0, 8, -2]], s), 64),
        ("odd integers", e([[1, -1, 3, 1], [5, 1, -1, 1], [1, 1, 1, 1]], s), 96),
        ("all classes of quantiser 0 and 1", e(some(4, 32, 2, 0, 1, 5), s, classes=(13, 2)), 64),
        ("large integers", e(huge, least, classes=(6, 14)), 288, 5, 1),
        ("escapes of all sizes", e([[2**k for k in range(30)]], least), 32, 5, 1),
        ("a start byte of 0", e(some(5, 9, 4, 0, 1), s, start=0), 128),
        ("the largest start byte", e([[1, 0], [0, 0], [7, -9]], s, start=163), 96),
        ("silence after noise", e([*some(6, 12, 2, 900), *[[0] * 12] * 7], s, start=40), 288),
        ("a signal", of_signal(slow, 5, 300), 100, 5, 300),
        ("a signal, some coefficients", of_signal(slow, 5, 300, kept=9), 100, 5, 300),
        ("a signal, with a base", of_signal([x - 5000 for x in slow], 5, 99, -5000), 100, 5, 99),
        ("a signal, with weights", of_signal(slow, 5, 300, weights=(16, 32, 64, 128)), 100, 5, 300,
         1, (16, 32, 64, 128)),
        ("as many ticks as two blocks", of_signal(slow[:64], 5, 60), 64, 5, 60),
        ("two components", p([of_signal(slow, 5, 256), e(some(7, 3, 4, 9), s)]), 100, 5, 256, 2),
        ("a component without coefficients", p([e([], s, 4), of_signal(slow, 5, 256), e([], s)]),
         100, 5, 256, 3),
    ]  # fmt: skip
    rows += [
        (f"a signal, blocks of {2**m}", of_signal(slow, m, 100), 100, m, 100) for m in range(6, 10)
    ]
    rows += broken()
    return Component(
        "mdct",
        "9.8",
        ("MDC-002", "MDC-003", "LPC-001", "RNG-001", "RNG-003", "RNG-004", "COD-001"),
        "Packets of MDCT, and the counts of each component. Of some of one component also the "
        "integers of each block, the context, shift and state of each, and the coefficients X.",
        also(
            [packet(*row) for row in rows],
            {
                "empty": ["COD-001"],
                "no K": ["COD-001"],
                "no start byte": ["COD-001"],
                "no classes": ["COD-001"],
            },
        ),
    )


def broken() -> Iterator[tuple]:
    e, s = mdct.encode, mdct.steps(5, 256)
    good = e([[3, -1], [5, 0]], s)
    yield "sizes beyond the packet", b"\5\x0a\0", 4, 5, 256, 2
    yield "empty", b"", 4
    yield "no K", b"\0", 4
    yield "a base above 2^24", e([], s, 2**24 + 1), 4
    yield "a base below -2^24", e([], s, -(2**24) - 1), 4
    yield "the largest base", e([], s, 2**24), 4
    yield "33 coefficients of 32", b"\0\x21" + good[2:], 64
    yield "no coefficients, and a byte", b"\0\0\0", 4
    yield "no classes", good[:2], 64
    yield "no start byte", good[:3], 64
    yield "a start byte of 164", good[:3] + b"\xa4" + good[4:], 64
    yield "a byte left over", good + b"\0", 64
    yield "a byte is missing", good[:-1], 64
    yield "a block fewer", good, 32
    big, largest = 2**32, mdct.steps(5, 2**32)
    yield "the largest sum", e([[4, -4]], largest), 4, 5, big
    yield "above the largest sum", e([[4, -4, 1, 1]], largest, loud=True), 4, 5, big
    yield "an integer of 2^34", e([[2**34]], s, loud=True), 4
    yield "far above the largest sum", e([[2**33]], largest, loud=True), 4, 5, big


def components() -> Iterator[Component]:
    yield cosines()
    yield steps()
    yield transforms()
    yield packets()
