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
        return coding.code_lengths(coder, count, table, True, given)
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
        cases += [
            coder_case(f"five sections, {seed}, {states} states", rows, states) for states in (1, 4)
        ]
    for row in sections(3, 20):
        cases += [coder_case(f"{row['kind']}, {states} states", [row], states) for states in (1, 4)]
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


def components() -> Iterator[Component]:
    yield classes()
    yield lengths()
    yield coders()
