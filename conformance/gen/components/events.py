"""Clause 9.9: packets of events."""

from __future__ import annotations

from collections.abc import Iterator

import page_events
from forge import event

from .component import Case, Component, also, tried


def packets() -> Component:
    some = [(10, 0, 0, "go"), (10, 5, 1, ""), (17, 2**40, 3, "°µ€𝄞")]
    rows: list[tuple] = [
        ("one", 0, 9, page_events.encode([(3, 0, 0, "")], 0)),
        ("three, two at one tick", 10, 9, page_events.encode(some, 10)),
        ("in the last tick", 10, 9, page_events.encode([(18, 0, 0, "x")], 10)),
        ("as long as may be", 5, 9, page_events.encode([(5, 2**48 - 5, 0, "x")], 5)),
        ("a channel of the largest number", 0, 1, event(0, "x", channel=65535)),
        ("65535 bytes of text", 0, 1, event(0, "m" * 65535)),
        ("none", 0, 9, b""),
        ("behind the span", 10, 9, event(9, "x")),
        ("the second one behind the span", 10, 9, event(8, "x") + event(1, "y")),
        ("ends too late", 5, 9, event(0, "x", duration=2**48 - 4)),
        ("ends within a text", 0, 9, event(0, "abc")[:-1]),
        ("ends within its numbers", 0, 9, bytes.fromhex("0000")),
        ("65536 bytes of text", 0, 1, event(0, "m" * 65536)),
        ("a channel of 65536", 0, 1, event(0, "x", channel=65536)),
        ("no UTF-8", 0, 1, event(0, b"\xff")),
        ("U+0000", 0, 1, event(0, b"a\0")),
        ("a number that is not minimal", 0, 9, bytes.fromhex("8000000000")),
    ]
    cases = []
    for name, start, span, data in rows:
        case: Case = {"name": name, "start": start, "span": span, "packet": data}
        if len(data) > 1000:
            case |= {"packet": data[:8], "then": [data[8:9], len(data) - 8]}

        def run(data=data, start=start, span=span) -> Case:
            found = page_events.decode(data, start, span)
            if len(data) > 1000:
                return {"count": len(found), "text_size": len(found[0][3])}
            return {"events": [[t, d, c - 1 if c else None, text] for t, d, c, text in found]}

        cases.append(tried(case, run))
    return Component(
        "evnt",
        "9.9",
        ("EVT-001", "EVT-003", "CNV-004", "COD-001"),
        "Packets of EVNT: events as [tick, duration, channel or null, text]. `then`: the packet "
        "goes on "
        "with this byte, that many times.",
        also(
            cases,
            {"ends within its numbers": ["EVT-001", "COD-001"], "ends within a text": ["COD-001"]},
        ),
    )


def components() -> Iterator[Component]:
    yield packets()
