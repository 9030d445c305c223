"""Clause 9.4: frequencies of classes and lengths, and the coder with its states."""

from __future__ import annotations

from collections.abc import Iterator
from hashlib import sha256

import page_coding as coding
from luck import Luck
from page import BrokenRule, Coder, class_ends

from .component import Case, Component


def classes() -> Component:
    cases: list[Case] = [
        {
            "name": f"class {number}",
            "class": number,
            "ends": [class_ends(number, c) for c in range(36)],
        }
        for number in range(16)
    ]
    whole = b"".join(
        end.to_bytes(2, "little") for case in cases for row in case["ends"] for end in row
    )
    digest = sha256(whole).hexdigest()
    assert digest == coding.DIGEST
    cases.append({"name": "all of them", "sha256": digest})
    return Component(
        "classes",
        "9.4",
        ("RNG-001",),
        "The ends of the 16 symbols of each class in contexts 0 to 35; and the SHA-256 of all of "
        "them as u16.",
        cases,
    )


def lengths() -> Component:
    rows = ([1], [255], [1, 1], [0, 0, 7], [3, 0, 200, 1], [255] * 64, list(range(64)))
    cases: list[Case] = [
        {
            "name": f"{len(row)} weights, {sum(row)} in all",
            "weights": row,
            "ends": coding.length_ends(row),
        }
        for row in rows
    ]
    return Component(
        "lengths", "9.4", ("RNG-004",), "Weights of lengths, and the ends of their symbols.", cases
    )


FOUR_STATES = 5
"""Sections of kinds that may have four states; those by bits have one."""


def sections(seed: int, count: int) -> list[dict]:
    """Of every kind, with what they are coded by."""
    rng = Luck(seed)
    sizes = [rng.choice((0, 1, 4, 90, 3000, 10**6, 2**33)) for _ in range(count)]
    numbers = [rng.between(-size, size) for size in sizes]
    calm = [rng.bell(12) for _ in range(count)]
    return [
        {"kind": "bits", "p": [9, 99, 199, 250], "values": [rng.below(2) for _ in range(count)]},
        {"kind": "class", "class": seed % 16, "start": seed * 7 % 164, "values": numbers},
        {"kind": "class, unsigned", "class": 15, "start": 20, "values": [abs(e) for e in calm]},
        {"kind": "lengths", "first": 0, "weights": [5, 9, 1, 0, 3, 200, 1], "values": calm},
        {"kind": "signs", "p": [200, 128, 3], "values": calm},
        {"kind": "by bits", "values": [e // 8 for e in calm]},
        {"kind": "by bits, unsigned", "values": [abs(e) for e in numbers]},
    ]


def code(coder: Coder, section: dict, *, told: bool) -> list[int]:
    kind, values = section["kind"], section["values"]
    given = values if told else None
    count = len(values)
    if kind == "bits":
        return coding.code_bits(coder, count, section["p"], given)
    if kind == "signs":
        return coding.code_signs(coder, [abs(e) for e in values], section["p"], given)
    if kind == "lengths":
        table = section["first"], section["weights"]
        return coding.code_lengths(coder, count, table, given)
    if kind.startswith("by bits"):
        return coding.code_by_bits(coder, count, kind == "by bits", given)
    signed = kind == "class"
    return coding.code_integers(coder, count, section["class"], section["start"], signed, given)


def coded(rows: list[dict], states: int) -> bytes:
    coder = Coder(states=states)
    for row in rows:
        code(coder, row, told=True)
    return coder.finish()


def coder_case(name: str, rows: list[dict], states: int, data: bytes | None = None) -> Case:
    data = coded(rows, states) if data is None else data
    case: Case = {"name": name, "states": states, "coded": data, "sections": rows}
    try:
        coder = Coder(data, states)
        after = []
        for row in rows:
            assert code(coder, row, told=False) == row["values"]
            after.append([*coder.x, coder.front, len(coder.raw)])
        coder.finish()
    except BrokenRule as broken:
        return {**case, "error": broken.args[0]}
    return {**case, "after": after}


def coders() -> Component:
    cases = []
    for seed in range(1, 9):
        rows = sections(seed, seed * seed + 3)
        cases.append(coder_case(f"seven sections, {seed}", rows, 1))
        cases.append(coder_case(f"five sections, {seed}, 4 states", rows[:FOUR_STATES], 4))
    for place, row in enumerate(sections(3, 20)):
        cases += [
            coder_case(f"{row['kind']}, {states} states", [row], states)
            for states in ((1, 4) if place < FOUR_STATES else (1,))
        ]
    cases.append(coder_case("nothing", [], 1))
    three = [{"kind": "class", "class": 8, "start": 8, "values": [5, -9, 30]}]
    spare = coded(three, 1)
    coder = Coder(spare, 1)
    code(coder, three[0], told=False)
    assert len(coder.raw) % 8 > 0
    first = len(spare) - -(-len(coder.raw) // 8)
    spare = spare[:first] + bytes([spare[first] | 128]) + spare[first + 1 :]
    cases.append(coder_case("a bit left over that is not 0", three, 1, spare))
    large = [2**34 - 1] * 16
    for name, last in (("the largest magnitude", 2**34 - 1), ("a magnitude of 2^34", 2**34)):
        values = [{"kind": "class", "class": 8, "start": 150, "values": [*large, last]}]
        cases.append(coder_case(f"{name}, by a symbol below 15", values, 1))
    one = [sections(2, 9)[1]]
    whole = coded(one, 1)
    for name, data in (
        ("a byte too many in front", b"\0" + whole),
        ("a byte too many behind", whole + b"\0"),
        ("no bytes", b""),
        ("a state of three bytes", whole[:3]),
    ):
        try:
            cases.append(coder_case(name, one, 1, data))
        except AssertionError:
            # Other numbers come out first: what counts is that the end does not fit.
            case: Case = {"name": name, "states": 1, "coded": data, "sections": one}
            cases.append({**case, "error": ["RNG-001", "RNG-003"]})
    for name, last in (
        ("the largest magnitude", 2**34 - 1),
        ("a magnitude of 2^34", 2**34),
        ("k = 36", 2**34 + 1),
    ):
        values = [{"kind": "by bits", "values": [0, -last]}]
        cases.append(coder_case(f"{name}, by bits", values, 1))
    return Component(
        "entropy-coder",
        "9.4",
        ("RNG-001", "RNG-003"),
        "Coded bytes, and the sections decoded of them. `after` each section: the states, bytes "
        "taken at the front, and raw bits. Signs follow the integers whose magnitudes are those of "
        "`values`. A bit of the kind `bits` is 1 with the probability p[2 * r1 + r2], r1 and r2 "
        "being the two bits before it (9.5, Repeats).",
        cases,
    )


def models() -> Component:
    """Single flags, and whole sections integer by integer."""
    luck = Luck(7)
    rows = {
        "ones": [1] * 700,
        "zeros": [0] * 700,
        "in turn": [0, 1] * 100,
        "ones after zeros": [0] * 300 + [1] * 40,
        "one in ten": [int(luck.below(10) == 0) for _ in range(300)],
    }
    cases: list[Case] = []
    for name, bits in rows.items():
        for letter, limit in (("A", 5), ("B", 7)):
            model, p = coding.Model(letter, 0, 0), []
            for bit in bits:
                model.learn(bit)
                p.append(model.p)
            cases.append({"name": f"{name}, limit {limit}", "bits": bits, "limit": limit, "p": p})
    for name, signs, values in traced():
        case: Case = {"name": name, "signs": signs}
        coder = Coder()
        coding.code_by_bits(coder, len(values), signs, values)
        data, kept = coder.finish(), {}
        decoder = Coder(data)
        after = [[decoder.x[0], decoder.front, len(decoder.raw)]]
        for count in range(1, len(values) + 1):
            decoder, kept = Coder(data), {}
            assert coding.code_by_bits(decoder, count, signs, kept=kept) == values[:count]
            after.append([decoder.x[0], decoder.front, len(decoder.raw)])
        learnt: dict[str, list] = {letter: [] for letter in "ABCD"}
        for (letter, *place), model in sorted(kept.items()):
            learnt[letter].append([*place, model.p, model.n])
        cases.append({**case, "coded": data, "values": values, "after": after, "models": learnt})
    return Component(
        "models",
        "9.4",
        ("RNG-001", "RNG-003"),
        "Models: `p` after each bit, from 32768 on. Sections of integers by bits: `after` each "
        "integer, and before the first: the state, bytes taken at the front, and raw bits. "
        "`models` that the section has used, at its end: contexts (A: i, k; B: j, k; C: k; D: d), "
        "p and n.",
        cases,
    )


def traced() -> Iterator[tuple[str, bool, list[int]]]:
    luck = Luck(8)
    yield "zeros and ones", True, [luck.choice((0, 0, 0, 1, -1)) for _ in range(60)]
    yield "without signs", False, [luck.choice((0, 0, 1, 2, 3, 4, 9)) for _ in range(60)]
    yield "signs", True, [luck.choice((0, 3, 3, 3, -3)) for _ in range(60)]
    yield "every size", True, [(-1) ** n * (2 ** (n // 2) + n % 2) for n in range(68)]
    yield "loud, then silence", True, [2**20, -(2**20), *[0] * 50, 1]
    yield "one", True, [-1]


def components() -> Iterator[Component]:
    yield classes()
    yield models()
    yield lengths()
    yield coders()
