"""For conformance/EXAMPLES.md: packets of codecs that packets.md does not have, values of LPCX, and
the decoder of entropy coding step by step."""

from __future__ import annotations

import textwrap

import page_exact
import page_noise
import page_quantised
import page_transform
from page_coding import Coder, class_ends, code_integers, code_rest, context_of
from page_quantised import Escape, Run


def hexed(data: bytes) -> str:
    return f"`{data.hex(' ').upper()}`"


def text() -> str:
    parts = [
        "Packets of other codecs, with their codec parameters:",
        table(
            ["codec", "parameters", "packet", "counts"], [quantised(), transformed(), synthetic()]
        ),
        "Values of counts by rules 2 and 3 of `LPCX`, with A = 1 and B = 0:",
        table(["rule", "count", "D", "on the way", "v"], values()),
        "## trace",
        trace([1, -1, 12, 0, 3, -2, 0, 5], 0, 24),
    ]
    return "\n\n".join(["", *parts, ""])


def table(head: list[str], rows: list[list[object]]) -> str:
    lines = [f"| {' | '.join(map(str, row))} |" for row in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])


def shown(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers))


def quantised() -> list[object]:
    lengths = [1, 3, 3, 2]
    tokens: list[int | Run | Escape] = [1, Run(3), -1, 0]
    levels = page_quantised.levels_of(tokens)
    packet = page_quantised.encode(tokens, 1, 1, lengths)
    assert page_quantised.decode(packet, len(levels), 1, 1, lengths) == levels
    parameters = bytes([2, 0, 0, 0, 1, 0, 1, 0]) + page_quantised.codebook(lengths)
    return ["`QUAN`", hexed(parameters), hexed(packet), shown([2 * each for each in levels])]


def transformed() -> list[object]:
    steps = page_transform.steps(5, 256)
    packet = page_transform.encode([[7, -2, 1]], steps, 10)
    counts = page_transform.decode(packet, 16, 5, steps)
    return ["`MDCT`", hexed(bytes([5, 128, 2, 0])), hexed(packet), shown(counts)]


def synthetic() -> list[object]:
    packet = page_noise.encode([30, 34], [[100]], 8, seed=7)
    counts = page_noise.decode(packet, 3, 8, 12)
    return ["`NOIS`", hexed(bytes([3, 8])), hexed(packet), shown(counts)]


def values() -> list[list[object]]:
    """Decimals by rule 2, and one value by rule 3."""
    rows: list[list[object]] = []
    for count, d, digits, way in (
        (2, 3, 4, "p = -1, k = 4, s = 6667"),
        (123456, 1, 3, "p = 5, k = -3, s = 123"),
        (-25, 1000, 1, "p = -2, k = 2, s = -2 (a tie)"),
    ):
        v = page_exact.value(count, 1, 0, d, 2, digits)
        rows.append([f"2, `digits` {digits}", count, d, way, repr(float(v))])
    c = (0.5, 0.1, 0.01, 0.001)
    v = page_exact.value(3, 1, 0, 1, 3, 0, c)
    assert float(v) == ((c[3] * 3 + c[2]) * 3 + c[1]) * 3 + c[0]
    rows.append(["3, `c0` to `c3` 0.5, 0.1, 0.01, 0.001", 3, 1, "-", repr(float(v))])
    return rows


def trace(integers: list[int], number: int, a: int) -> str:
    """One batch of the class ``number`` with raw signs, whose averages begin as ``a`` says."""
    coder = Coder()
    code_integers(coder, len(integers), number, a, True, integers)
    coded = coder.finish()
    coder = Coder(coded)
    coder.section()
    f = (4 + a % 4) * 2 ** (a // 4)
    c, h = context_of(f)
    ends, front = class_ends(number, c), coder.front
    rows: list[list[object]] = []
    for _ in integers:
        x = coder.x[0]
        k = coder.symbol(ends)
        word, front = coded[front : coder.front].hex(" ").upper() or "-", coder.front
        rows.append(
            [x, x % 4096, f"{ends[k - 1] if k else 0} to {ends[k] - 1}", k, word, coder.x[0]]
        )
    found = []
    for row in rows:
        start = len(coder.raw)
        found.append(code_rest(coder, row[3], h, True))
        row += [" ".join(map(str, coder.raw[start:])) or "-", found[-1]]
    assert found == integers
    assert coder.finish() == coded
    head = ["x", "slot", "symbol k has the slots", "k", "word", "x then", "raw bits", "integer"]
    note = f"""The integers {shown(integers)}, of class {number} with start byte {a} and raw signs,
are the coded bytes {hexed(coded)}. The averages begin with {f}, so c is {c} and h is {h}. The ends
of the class are then {shown(ends)}. The first 32 bits are the state x.
Raw bits come from the last byte, its lowest bit first. In the end x is 65536."""
    note = textwrap.fill(note, 110, break_long_words=False, break_on_hyphens=False)
    return f"{note}\n\n{table(head, rows)}"
