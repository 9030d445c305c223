"""Clause 9.5: grids, sine table, predictor, Rice codes, packets of LPCR."""

from __future__ import annotations

import hashlib
import random
import struct
from collections.abc import Iterator

import page
from page import BrokenRule, K, Rice, grid_levels, rdiv, step_up, tops_by_search

from .component import Case, Component, tried

BOUND = 2**24
"""The count bound of level 1."""


def sine() -> Component:
    digest = hashlib.sha256(struct.pack("<128H", *K)).hexdigest()
    assert digest == page.DIGEST
    cases: list[Case] = [
        {"name": "the table", "sha256": digest, "entries": list(K)},
        {"name": "both signs", "pairs": [[k, K[k] if k >= 0 else -K[-k]] for k in
                                         (-127, -126, -64, -1, 0, 1, 64, 126, 127)]},
    ]  # fmt: skip
    return Component(
        "sine", "9.5, Annex D", ("LPC-005", "CNV-001"),
        "The table K(0) to K(127) with the SHA-256 of its entries as u16; pairs of k and K(k).", cases,
    )  # fmt: skip


def steps(ks: list[int]) -> list[list[int]]:
    """p after each n; the last may break LPC-005."""
    p: list[int] = []
    out = []
    for k in ks:
        sin = K[k] if k >= 0 else -K[-k]
        n = len(p) + 1
        p = [p[j - 1] - rdiv(sin * p[n - j - 1], 32768) for j in range(1, n)] + [sin * 32]
        out.append(p)
        if max(map(abs, p)) > 2**36:
            break
    return out


def predictors() -> Component:
    rng = random.Random(4)
    rows = [
        ("order 0", []), ("order 1", [64]), ("order 1, negative", [-64]), ("order 1, 0", [0]),
        ("order 1, largest", [127]), ("order 1, least", [-127]), ("order 2 of the examples", [113, -110]),
        ("rounding of negative halves", [1, -1, 1, -1]), ("zeros between", [50, 0, 0, -50]),
        ("order 8", [120, -100, 60, -40, 30, -20, 10, -5]),
        ("order 32", [rng.randrange(-40, 41) for _ in range(32)]),
        ("order 32, all 1", [1] * 32), ("order 32, in turn", [20, -20] * 16),
        ("order 12", [rng.randrange(-90, 91) for _ in range(12)]),
        ("all 127", [127] * 32), ("127 and -127 in turn", [127, -127] * 16),
        ("nine of -127", [-127] * 9), ("eight of 126", [126, -126] * 4),
    ]  # fmt: skip
    cases = [
        tried({"name": name, "k": ks, "p": steps(ks)}, lambda ks=ks: {"c": step_up(ks)})
        for name, ks in rows
    ]
    ks = largest_that_fits()
    cases.append({"name": "the largest of its kind", "k": ks, "p": steps(ks), "c": step_up(ks)})
    ks = [*ks, 127 if ks[-1] < 0 else -127]
    cases.append(tried({"name": "one more than fits", "k": ks, "p": steps(ks)},
                       lambda: {"c": step_up(ks)}))  # fmt: skip
    return Component(
        "predictor", "9.5", ("LPC-005", "CNV-001"),
        "Reflection coefficients `k`; `p`: p[1] to p[n] after each n (up to the first that breaks "
        "LPC-005); the predictor `c`.", cases,
    )  # fmt: skip


def largest_that_fits() -> list[int]:
    """127 and -127 in turn, as many as LPC-005 lets pass."""
    ks: list[int] = []
    while True:
        more = [*ks, 127 if len(ks) % 2 == 0 else -127]
        try:
            step_up(more)
        except BrokenRule:
            return ks
        ks = more


def grids() -> Component:
    shown = (0, 1, -1, 2, -2, 5, -7, 100)
    cases: list[Case] = []
    for name, step, zero in (("step 1", 1, 0), ("step 25", 25, 0), ("zero moved", 10, -3),
                             ("largest step", 2**24, 0)):  # fmt: skip
        last = BOUND // step
        indices = [i for i in shown if abs(i) <= last] + [last, -last]
        cases.append({
            "name": f"uniform, {name}", "grid": 0, "step": step, "zero": zero, "last": last,
            "indices": indices, "counts": [zero + i * step for i in indices],
        })  # fmt: skip
    for kn, kd, step, zero in (
        (1, 10, 20, 0), (1, 10, 1, 0), (1, 20, 5, 1000), (1, 1024, 0, 0), (1, 3, 7, -11), (9, 10, 4, 0),
        (1, 10, 0, 0), (64, 65535, 100, 0), (1, 2, 1, 0), (3, 3, 50, 8), (5, 4, 2, 0),
        (1, 10, 2**24, 0), (1, 10, 2**23, 0),
    ):  # fmt: skip
        y = grid_levels(kn, kd, step, BOUND)
        last = len(y) - 1
        indices = [*dict.fromkeys([i for i in shown if abs(i) <= last] + [last, -last])]
        counts = [zero + (y[i] if i >= 0 else -y[-i]) for i in indices]
        digest = hashlib.sha256(struct.pack(f"<{len(y)}q", *y)).hexdigest()
        cases.append({
            "name": f"deadband, {kn}/{kd}, floor {step}, zero {zero}", "grid": 1, "step": step,
            "zero": zero, "kn": kn, "kd": kd, "last": last, "indices": indices, "counts": counts,
            "first_levels": y[:24], "sha256": digest,
        })  # fmt: skip
    kn, kd, step, bound = 1, 7, 3, 2000
    tops = tops_by_search(kn, kd, step, bound)
    cases.append({"name": "cells up to 2000, found count by count", "grid": 1, "step": step,
                  "kn": kn, "kd": kd, "zero": 0, "bound": bound, "tops": tops,
                  "levels": grid_levels(kn, kd, step, bound)})  # fmt: skip
    return Component(
        "grid", "9.5", ("LPC-002", "LPC-003", "CNV-001"),
        "Grids at level 1 (count bound 2^24): the largest index `last`, and the counts of some "
        "indices; deadband grids with y(0), y(1), ... and the SHA-256 of y(0) to y(N) as i64. The last "
        "case has a bound of its own, and the top of each cell up to it.", cases,
    )  # fmt: skip


RICE = (
    ("zeros", [0] * 40, (0,)), ("one", [1], (1,)), ("minus one", [-1], (1,)),
    ("width 5", [0, 1, -1, 5, -5, 100, -100], (5,)), ("a whole block", [*range(-16, 16)], (3,)),
    ("33 ticks", [*range(-16, 17)], (3,)), ("widths from block to block", [3, -3] * 64, (5, 1, 9, 2)),
    ("a block of zeros between", [9] * 32 + [0] * 32 + [-9] * 32, (5, 0, 5)),
    ("23 zeros", [-12, 11], (1,)), ("24 zeros: 35 bits", [12, -13, 2**33], (1,)),
    ("largest", [2**34 - 1, -(2**34)], (31,)), ("width 31", [2**30, -1], (31,)),
)  # fmt: skip


def rice_codes() -> Component:
    cases = []
    for name, row, widths in RICE:
        coder = Rice(widths=widths)
        for e in row:
            coder.code(None, e)
        cases.append(rice_case(name, coder.finish(), len(row)))
        got = [e for block in cases[-1]["blocks"] for e in block["errors"]]
        assert got == row, name
    whole = cases[3]["bits"]
    cases += [
        rice_case("a byte left over", whole + b"\0", 7),
        rice_case("a bit that fills is 1", bytes([*whole[:-1], whole[-1] | 1]), 7),
        rice_case("cut", whole[:-1], 7), rice_case("no bytes", b"", 4),
        rice_case("no bytes are one block at most", b"", 40),
        rice_case("w below 0", bits("01 0"), 4),
        rice_case("w = 32", bits("0" * 24 + f"{64:035b}"), 4),
    ]  # fmt: skip
    return Component(
        "rice", "9.5", ("LPC-010", "LPC-011", "LPC-012"),
        "Rice codes of so many ticks. `blocks`: the width w of each block of 32 ticks, its prediction "
        "errors, and `bits_read` behind it.", cases,
    )  # fmt: skip


def bits(text: str) -> bytes:
    text = text.replace(" ", "")
    text += "0" * (-len(text) % 8)
    return bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))


def rice_case(name: str, data: bytes, ticks: int) -> Case:
    coder = Rice(data)
    blocks: list[Case] = []

    def run() -> Case:
        for t in range(ticks):
            e = coder.code(None)
            if t % 32 == 0:
                blocks.append({"w": coder.w, "errors": []})
            blocks[-1]["errors"].append(e)
            blocks[-1]["bits_read"] = coder.at
        coder.finish()
        return {"blocks": blocks}

    return tried({"name": name, "bits": data, "ticks": ticks}, run)


def whole_packet(name: str, data: bytes, span: int, width: int = 1, last: int = BOUND) -> Case:
    case: Case = {"name": name, "packet": data, "span": span, "components": width, "last": last}
    return tried(case, lambda: {"indices": page.decode_packet(data, span, last, width)})


def wave(n: int, size: float, seed: int) -> list[int]:
    """A walk of random steps that return."""
    rng = random.Random(seed)
    x = v = 0.0
    out = []
    for _ in range(n):
        v = 0.95 * v - 0.02 * x + rng.gauss(0, size / 20)
        x += v
        out.append(round(x))
    return out


def packets() -> Component:
    slow = wave(60, 100, 6)
    other = [(3 * x) // 4 + t % 3 for t, x in enumerate(slow)]
    ks = [113, -110]
    held = [x for x in slow[:12] for _ in range(5)]
    e, p = page.encode, page.encode_packet
    rows: list[tuple] = [
        ("constant", bytes.fromhex("10000a"), 4), ("constant, one tick", bytes.fromhex("10000a"), 1),
        ("two ticks", bytes.fromhex("00000016"), 2),
        ("second differences", bytes.fromhex("0200002f581520"), 8),
        ("repeats", bytes.fromhex("08000e3f27c2e600"), 9),
        ("Rice", bytes.fromhex("8200000c88888880"), 8),
        ("two coefficients, raw signs", 
         bytes.fromhex("20 02 78 92 00 23 71 8C 90 6D B7 20 01 3E BC EA"), 13),
        ("two components with a reference",
         bytes.fromhex("0C 01 00 00 23 71 82 7B 45 40 7C 51 5A 41 00 01 00 00 20 00 0A 3E 20"), 9, 2),
    ]  # fmt: skip
    rows += [(f"difference order {g}", e(slow, g=g), 60) for g in range(5)]
    rows += [
        ("coefficients on first differences", e(slow, g=1, ks=ks), 60),
        ("32 coefficients", e(slow, ks=[*ks, *([7, -6] * 15)]), 60),
        ("a base", e([x + 5000 for x in slow], base=5000), 60),
        ("a negative base", e([x - 5000 for x in slow], base=-5000), 60),
        ("repeats, held", e(held, repeats=True), 60),
        ("repeats with coefficients", e(held, ks=ks, repeats=True, raw_signs=True), 60),
        ("repeats with differences", e(held, g=3, repeats=True), 60),
        ("raw signs", e(slow, g=1, raw_signs=True), 60),
        ("equal, and not constant", e([4] * 9, base=4), 9),
        ("Rice with coefficients", e(slow, g=1, ks=ks, rice=True, widths=(5, 3)), 60),
        ("Rice, zero blocks", e([0] * 64 + [1, -1], rice=True, widths=(0, 0, 1)), 66),
        ("largest index", e([2**24, -(2**24)], last=BOUND), 2),
        ("two components, no references", p([e(slow, g=1), e(other, g=2)]), 60, 2),
        ("constant beside Rice", p([bytes.fromhex("10000a"), e(slow, g=2, rice=True)]), 60, 2),
    ]  # fmt: skip
    for name, w, g, coefficients in (
        ("tick before", (64, 0, 0), 1, []), ("same tick", (0, 48, 0), 1, []),
        ("next tick", (0, 0, 127), 0, ks), ("negative weights", (-128, 77, -3), 1, ks),
        ("fourth differences", (5, 40, -9), 4, []),
    ):  # fmt: skip
        second = e(other, g=g, ks=coefficients, references=[(0, *w)], components=[slow])
        rows.append((f"a reference, {name}", p([e(slow, g=2), second]), 60, 2))
    third = [a - b for a, b in zip(slow, other, strict=True)]
    parts = [
        e(slow, g=1), e(other, g=1, references=[(0, 0, 48, 0)], components=[slow]),
        e(third, references=[(0, 1, 60, -2), (1, -3, -61, 4)], components=[slow, other]),
    ]  # fmt: skip
    rows.append(("two references, one of them refers itself", p(parts), 60, 3))
    rows.append(("a reference to a constant",
                 p([bytes.fromhex("10000a"),
                    e(slow, g=1, references=[(0, 9, 64, 9)], components=[[5] * 60])]), 60, 2))  # fmt: skip
    rows.append(("a reference to Rice",
                 p([e(slow, g=2, rice=True),
                    e(other, ks=ks, repeats=True, references=[(0, 1, 47, 0)], components=[slow])]),
                 60, 2))  # fmt: skip
    rows += [(name, data, span, *rest) for name, data, span, *rest in broken(slow)]
    return Component(
        "lpcr", "9.5", ("LPC-001", "LPC-003", "LPC-004", "LPC-005", "LPC-006", "LPC-007", "LPC-008",
                        "LPC-010", "LPC-011", "LPC-012", "RNG-001", "COD-001"),
        "Packets of LPCR: the indices of each component, `last` being the largest magnitude.",
        [whole_packet(*row) for row in rows],
    )  # fmt: skip


def broken(slow: list[int]) -> Iterator[tuple]:
    e, p = page.encode, page.encode_packet
    good = e(slow, g=1)
    yield "sizes beyond the packet", bytes.fromhex("0510000a"), 4, 2
    yield "empty", b"", 4
    yield "one byte", b"\0", 4
    yield "coefficients are missing", bytes.fromhex("000300"), 4
    yield "difference order 5", bytes.fromhex("050000"), 4
    yield "difference order 2 with a coefficient", bytes.fromhex("02010100"), 4
    yield "33 coefficients", bytes([0, 33, *bytes(33), 0]), 4
    yield "k = -128", bytes.fromhex("00018000"), 4
    for name, flags in (("differences", 0x11), ("repeats", 0x18), ("raw signs", 0x30),
                        ("references", 0x50), ("Rice", 0x90)):  # fmt: skip
        yield f"constant with {name}", bytes([flags, 0, 10]), 4
    yield "constant with a coefficient", bytes.fromhex("1001010a"), 4
    yield "constant, bytes left over", bytes.fromhex("10000a00"), 4
    yield "Rice with repeats", bytes.fromhex("88000c88"), 8
    yield "Rice with raw signs", bytes.fromhex("a0000c88"), 8
    yield "the predictor is too large", bytes([0, 32, *([127] * 32), 0]), 4
    yield "the base is not on the grid", bytes.fromhex("10008208"), 4, 1, 512
    yield "an index is not on the grid", e([0, 600], last=2**24), 2, 1, 512
    yield "a byte left over", good + b"\0", 60
    yield "a byte is missing", good[:-1], 60
    yield "one tick fewer", good, 59
    yield "no references", bytes.fromhex("4000000a"), 4, 1
    yield "refers to itself", p([bytes.fromhex("10000a"), bytes.fromhex("400001010020000a")]), 4, 2
    twice = bytes([0x40, 0, 2, 0, 0, 32, 0, 0, 0, 32, 0, 10])
    yield "refers twice", p([bytes.fromhex("10000a"), twice]), 4, 2
    yield "nine references", p([bytes.fromhex("10000a"), bytes([0x40, 0, 9, *bytes(36), 0])]), 4, 2
    yield "references are missing", p([bytes.fromhex("10000a"), bytes.fromhex("40000100")]), 4, 2


def components() -> Iterator[Component]:
    yield sine()
    yield predictors()
    yield grids()
    yield rice_codes()
    yield packets()
