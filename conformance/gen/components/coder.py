"""Clause 9.4: bit and symbol models, range coder with its state, raw bits, integer model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from luck import Luck
from page import Bit, BrokenRule, Integers, Range, Symbols, first

from .component import Case, Component

BIT_ROWS = (
    ("eight zeros, then ones", [0] * 8 + [1] * 8),
    ("ones", [1] * 40),
    ("zeros", [0] * 40),
    ("in turn", [0, 1] * 20),
    ("as page and packet may fall", [1, 1, 0, 1, 0, 0, 0, 1, 0, 1] * 4),
)


def bit_models() -> Component:
    cases = []
    for name, row in BIT_ROWS:
        model, steps = Bit(), []
        for b in row:
            chance = model.chance()
            model.learn(b)
            steps.append([chance, b, model.p, model.q, model.n])
        cases.append({"name": name, "steps": steps})
    model = Bit()
    for b in [1] * 300 + [0] * 20:
        model.learn(b)
    state = {"P": model.chance(), "p": model.p, "q": model.q, "n": model.n}
    cases.append({"name": "300 ones, then 20 zeros", "bits": [[1, 300], [0, 20]], "after": state})
    model = Bit()
    for _ in range(2000):
        model.learn(1)
    state = {"P": model.chance(), "p": model.p, "q": model.q, "n": model.n}
    cases.append({"name": "2000 ones", "bits": [[1, 2000]], "after": state})
    model = Bit()
    for _ in range(2000):
        model.learn(0)
    state = {"P": model.chance(), "p": model.p, "q": model.q, "n": model.n}
    cases.append({"name": "2000 zeros", "bits": [[0, 2000]], "after": state})
    return Component(
        "bit-model",
        "9.4",
        ("RNG-001",),
        "A bit model from its start. `steps`: [P, bit coded, p, q, n after it]; or `bits`: runs of "
        "[bit, how many], and `after`, the state with the P that comes next.",
        cases,
    )


def symbol_models() -> Component:
    y = [4096 * (15 - i) for i in range(15)]
    rng = Luck(9)
    rows = (
        ("Y, each symbol once", y, 2, list(range(16))),
        ("Y, always 0", y, 2, [0] * 24),
        ("Y, always 15", y, 2, [15] * 24),
        ("Z[0]", first(0), 10, [0, 0, 1, 0, 2, 0, 0, 3]),
        ("Z[35]", first(35), 10, [rng.below(16) for _ in range(24)]),
        ("Z[12], always 15", first(12), 10, [15] * 12),
    )
    cases = []
    for name, z, n, row in rows:
        model, steps = Symbols(z, n), []
        for s in row:
            model.learn(s)
            steps.append([s, model.n, *model.z])
        cases.append({"name": name, "z": z, "n": n, "steps": steps})
    model = Symbols(y, 2)
    for i in range(400):
        model.learn(i * 7 % 16)
    after = {"n": model.n, "z": list(model.z)}
    cases.append(
        {
            "name": "400 symbols, 7 i modulo 16",
            "z": y,
            "n": 2,
            "count": 400,
            "times": 7,
            "after": after,
        }
    )
    return Component(
        "symbol-model",
        "9.4",
        ("RNG-001",),
        "A symbol model with the start `z`, `n`. `steps`: [symbol coded, n after it, z[0] ... "
        "z[14] after it]; or the symbols `times` * i modulo 16 for i from 0 to `count` - 1, and "
        "the state `after` them.",
        cases,
    )


def first_probabilities() -> Component:
    cases: list[Case] = [
        {"name": f"Z[{c}]", "context": c, "n": 10, "z": first(c)} for c in range(36)
    ]
    cases.append({"name": "Y", "n": 2, "z": [4096 * (15 - i) for i in range(15)]})
    return Component(
        "first-probabilities",
        "9.4",
        ("RNG-001",),
        "Where the symbol models of the integer model start.",
        cases,
    )


class Traced:
    """Codes operations, then reads them again and notes the state after each."""

    def __init__(self, operations: list[tuple], coded: bytes | None = None):
        """("bit", model, b), ("symbol", model, s) or ("raw", bits, number)"""
        self.operations = operations
        if coded is None:
            coder = Range()
            self.pass_through(coder)
            coded = coder.finish()
        self.coded = coded
        self.steps: list[list[Any]] = []
        self.error = None
        try:
            coder = Range(coded)
            self.start = {"width": coder.width, "x": coder.x}
            self.pass_through(coder, trace=True)
            coder.finish()
        except BrokenRule as broken:
            self.error = broken.args[0]

    def pass_through(self, coder: Range, *, trace: bool = False) -> None:
        reading = coder.coded is not None
        bits = [Bit() for _ in range(4)]
        symbols = [Symbols(first(4 * i), 10) for i in range(3)]
        for kind, which, value in self.operations:
            given = None if reading else value
            if kind == "bit":
                got = coder.code(bits[which], given)
            elif kind == "symbol":
                got = coder.symbol(symbols[which], given)
            else:
                got = coder.number(which, given)
            if trace:
                self.steps.append([kind, which, got, coder.width, coder.x, coder.n, len(coder.raw)])
            coder.check()

    def case(self, name: str) -> Case:
        out: Case = {"name": name, "coded": self.coded, "start": self.start, "steps": self.steps}
        if self.error:
            out["error"] = self.error
        else:
            assert [step[2] for step in self.steps] == [op[2] for op in self.operations], name
        return out


def mixed(seed: int, count: int, skew: int) -> list[tuple]:
    rng = Luck(seed)
    out: list[tuple] = []
    for _ in range(count):
        kind = rng.choice(["bit", "bit", "symbol", "symbol", "raw"])
        if kind == "bit":
            out.append((kind, rng.below(4), int(rng.below(100) < skew)))
        elif kind == "symbol":
            s = 0
            while s < 15 and rng.below(100) < skew:
                s += 1
            out.append((kind, rng.below(3), s))
        else:
            size = rng.choice([0, 1, 2, 3, 5, 8, 13, 34])
            out.append((kind, size, rng.below(2**size)))
    return out


def range_coder() -> Component:
    rows = [
        ("nothing coded", []),
        ("a bit 0", [("bit", 0, 0)]),
        ("a bit 1", [("bit", 0, 1)]),
        ("a symbol 0", [("symbol", 0, 0)]),
        ("a symbol 15", [("symbol", 0, 15)]),
        ("a raw bit", [("raw", 1, 1)]),
        ("nine raw bits", [("raw", 9, 0b100000001)]),
        ("raw bits 0 take bytes too", [("raw", 24, 0)]),
        ("34 raw bits", [("raw", 34, 2**34 - 2)]),
        ("64 ones", [("bit", 0, 1)] * 64),
        ("64 zeros", [("bit", 0, 0)] * 64),
        ("bits in turn", [("bit", 0, i % 2) for i in range(40)]),
        ("models are apart", [("bit", i % 4, int(i % 4 == 1)) for i in range(40)]),
        ("all symbols", [("symbol", 0, s) for s in range(16)]),
        ("all symbols, three models", [("symbol", s % 3, s) for s in range(15, -1, -1)]),
        ("carries", [("symbol", 0, 0), ("bit", 0, 1)] * 12),
        ("mixed, few ones", mixed(1, 60, 10)),
        ("mixed", mixed(2, 60, 50)),
        ("mixed, many ones", mixed(3, 60, 80)),
        ("mixed, long", mixed(4, 200, 30)),
        ("front and raw bits share a byte", [("bit", 0, 0)] * 3 + [("raw", 5, 21)]),
    ]
    cases = [Traced(operations).case(name) for name, operations in rows]
    operations = mixed(2, 30, 50)
    whole = Traced(operations).coded
    for name, coded in (
        ("a byte too many in front", b"\0" + whole),
        ("a byte too many behind", whole + b"\0"),
        ("the last byte is missing", whole[:-1]),
        ("no bytes", b""),
    ):
        traced = Traced(operations, coded)
        cases.append(traced.case(name))
    # An end that reads the same, but is not the one of the rule.
    bits = [("bit", 0, 1)] * 3
    for name, coded in (
        ("another end that reads the same", b"\x01"),
        ("an empty end for a bit 0", b""),
    ):
        cases.append(Traced(bits if coded else [("bit", 0, 0)], coded).case(name))
    return Component(
        "range-coder",
        "9.4",
        ("RNG-001",),
        "Coded bytes and what is decoded of them, with four bit models, and three symbol models "
        "that "
        'start as Z[0], Z[4], Z[8]. `steps`: ["bit", model, bit], ["symbol", model, symbol] or '
        '["raw", bits, number], and after each width, x, N (bits of the number read) and W (raw '
        "bits "
        "read). With `error` the end breaks the rule, after the last of the steps.",
        cases,
    )


ROWS = (
    ("zeros", [0] * 12),
    ("one", [1]),
    ("minus one", [-1]),
    ("small", [0, 1, -1, 2, -2, 3, -3, 0, 0]),
    ("each bucket", [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15, 16, 19, 20, 27, 28, 43, 44, 45]),
    ("each bucket, negative", [-1, -5, -9, -10, -11, -13, -17, -21, -30, -43, -44, -60]),
    ("bucket 15: lengths", [43 + 2**i for i in range(14)]),
    ("bucket 15: lengths of 15 and more", [43 + 2**i for i in (14, 15, 16, 20, 31, 33)]),
    ("largest", [2**34 - 1, -(2**34) + 1, 0]),
    ("contexts upwards", [2**i for i in range(34)]),
    ("contexts downwards", [-(2**i) for i in range(33, -1, -1)] + [0] * 12),
    ("h grows", [5000] * 30 + [2**20 + 77] * 12),
    ("signs in turn", [7, -7] * 16),
    ("the sign of 0 between", [3, 0, -3, 0, 3, 3, -3, -3, 0, 0, 1]),
)


def integer_case(name: str, row: list[int]) -> Case:
    coder, model = Range(), Integers()
    for e in row:
        model.code(coder, e)
    coded = coder.finish()
    coder, model, steps = Range(coded), Integers(), []
    for e in row:
        c, h = place(model)
        assert model.code(coder, None) == e
        coder.check()
        steps.append(
            [e, c, h, model.f, model.s, model.t, coder.width, coder.x, coder.n, len(coder.raw)]
        )
    coder.finish()
    return {"name": name, "coded": coded, "steps": steps}


def place(model: Integers) -> tuple[int, int]:
    """Context c and shift h of the next integer."""
    mean = (model.f + model.s) // 2
    lg = mean.bit_length() - 1 if mean else 0
    fr = ((mean * 4) // 2**lg) % 4
    return max(0, 4 * min(lg, 10) + fr - 8), max(0, lg - 10)


def integer_model() -> Component:
    rng = Luck(5)
    rows = [*ROWS, ("noise", [rng.bell(25) for _ in range(60)])]
    rows.append(("noise of growing size", [rng.bell(3**i // 2**i) for i in range(50)]))
    rows.append(("noise, then rest", [rng.bell(400) for _ in range(20)] + [0] * 20))
    cases = [integer_case(name, list(row)) for name, row in rows]
    cases.append(too_large())
    return Component(
        "integer-model",
        "9.4",
        ("RNG-001", "RNG-003"),
        "Coded bytes and the integers decoded of them. `steps`: [integer, its context c, h, then "
        "f, "
        "s, t, width, x, N, W after it]. With `error` the integer after the last step breaks the "
        "rule.",
        cases,
    )


def too_large() -> Case:
    """2^34, coded by hand: the encoder of the page would refuse it."""
    coder, model = Range(), Integers()
    try:
        model.code(coder, 2**34)
    except BrokenRule as broken:
        return {
            "name": "2^34",
            "coded": coder.finish(),
            "steps": [],
            "error": broken.args[0],
        }
    raise AssertionError


def components() -> Iterator[Component]:
    yield bit_models()
    yield symbol_models()
    yield first_probabilities()
    yield range_coder()
    yield integer_model()
