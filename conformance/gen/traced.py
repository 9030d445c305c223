"""The decoder of entropy coding at work, step by step, for conformance/EXAMPLES.md."""

from __future__ import annotations

from page_coding import Coder, class_ends, code_integers, code_rest, context_of


def trace(integers: list[int], number: int, a: int) -> str:
    """A section of integers of the class ``number`` that begins with ``a``, as Markdown."""
    coder = Coder()
    code_integers(coder, len(integers), number, a, True, integers)
    coded = coder.finish()
    coder = Coder(coded)
    coder.section()
    f = s = (4 + a % 4) * 2 ** (a // 4)
    rows, found, size = [], [], min(8, len(integers))
    c, h = context_of((f + s) // 2)
    ends, front = class_ends(number, c), coder.front
    ks = []
    for _ in range(size):
        before = coder.x[0]
        k = coder.symbol(ends)
        read = coded[front : coder.front].hex(" ").upper() or "-"
        first, front = ends[k - 1] if k else 0, coder.front
        rows.append(f"| {before} | {before % 4096} | {first} to {ends[k] - 1} | {k} | {read} ")
        rows[-1] += f"| {coder.x[0]} "
        ks.append(k)
    for i, k in enumerate(ks):
        start = len(coder.raw)
        found.append(code_rest(coder, k, h, True))
        bits = " ".join(map(str, coder.raw[start:])) or "-"
        rows[i] += f"| {bits} | {found[-1]} |"
    assert found == integers
    assert coder.finish() == coded
    head = ["x", "slot", "symbol k has the slots", "k", "word", "x then", "raw bits", "integer"]
    lines = [
        f"The integers {', '.join(map(str, integers))} of class {number} with start byte {a} are "
        f"the coded bytes `{coded.hex(' ').upper()}`. The averages begin with {f}, so that c is "
        f"{c} and h is {h}. The ends of the class are then {', '.join(map(str, ends))}. The first "
        f"32 bits are the state x; raw bits come from the last byte, its lowest bit first. In the "
        f"end x is 65536.",
        "",
        f"| {' | '.join(head)} |",
        "|---" * len(head) + "|",
        *rows,
    ]
    return "\n".join(lines)
