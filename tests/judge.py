"""What the package says of a file, in short."""

from __future__ import annotations

from typing import Any

from hapfmt.errors import HapfmtError
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify


def rule(data: bytes) -> tuple[str, str | None]:
    """The verdict on a file, and the rule that it breaks first."""
    report = verify(data)
    if report.error:
        return report.verdict, report.error.requirement
    return report.verdict, report.findings[0]["requirement"] if report.findings else None


def samples(data: bytes, **asked: Any) -> dict[tuple[int, int], Any] | None:
    """{(channel, tick): count, or bits of a word}; None where reading is refused."""
    try:
        with Reader(data) as reader:
            found = reader.read(**asked)
            numbers = [ref.number for ref in reader.select(asked.get("channels"))]
    except HapfmtError:
        return None
    return {
        (number, start + i): value
        for number, channel in zip(numbers, found.channels, strict=True)
        for start, values in channel.segments()
        for i, value in enumerate(values.view(f"i{values.itemsize}").tolist())
    }
