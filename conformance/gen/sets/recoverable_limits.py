"""Headers within the payloads of one another: the work on them is bounded (SPEC 14.1)."""

from __future__ import annotations

from collections.abc import Iterator

import forge as f
from case import Case

COUNT = 12_000


def nested() -> bytes:
    """Each promises all that follows, and its payload CRC differs."""
    row = [
        f.chunk("aaaa", b"", number, size=f.HEADER * (COUNT - number), crc=1)
        for number in range(1, COUNT + 1)
    ]  # fmt: skip
    return f.file(("HEAD", f.head())) + b"".join(row)


def cases() -> Iterator[Case]:
    expect = {
        "needs": {"codecs": [], "level": 1},
        "exit": {"decode": [3, 4], "verify": [3, 4], "recover": [3, 4]},
    }  # fmt: skip
    yield Case(
        "limits", "nested-headers",
        f"{COUNT} headers that each promise the rest of the file: 2 GB of checksums, if nothing "
        "stops.",
        ["REC-005"], nested, expect, "framing/nested",
    )  # fmt: skip
