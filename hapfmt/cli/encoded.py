"""What hapfmt encode prints: what became of each channel, and what the choice cost or saved."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from dataclasses import replace as changed
from itertools import groupby
from typing import TYPE_CHECKING

from ..numbers import counted
from .bounds import amount
from .screen import JOINED, say
from .tables import Column, table

if TYPE_CHECKING:
    from ..encoder.encode import Decision
    from ..recording import Recording
    from ..writing.writer import Summary

GROUPED = 16
"""Of more channels than this, neighbours that were kept alike share a line."""
TRIED_TICKS = 1 << 13
"""Of each channel, for the estimate of another preset."""
FLOATING = ("stored as float", "kept as doubles")
MAX_ERROR = "0.1%"


@dataclass(frozen=True)
class Row:
    """One channel, or neighbours that were kept alike."""

    label: str
    kept_as: str
    unit: str
    sample_count: int
    size: int
    largest_error: float

    def cells(self) -> list[str]:
        error = amount(self.largest_error, self.unit) if self.largest_error else "0"
        return [
            self.label,
            self.kept_as,
            f"{8 * self.size / self.sample_count:.2f}" if self.sample_count else "-",
            str(self.size),
            error,
        ]


def show(
    summary: Summary, target: str, seconds: float, recording: Recording, *, verbose: bool
) -> None:
    rows = [row_of(each) for each in summary.decisions]
    if len(rows) > GROUPED and not verbose:
        rows = list(grouped(rows))
    headers = [
        Column("label"), Column("kept as"), Column("bits/sample"), Column("bytes", 1),
        Column("largest error"),
    ]  # fmt: skip
    table(headers, [row.cells() for row in rows])
    if verbose:
        for each in summary.decisions:
            axes = f", {each.axis_count} axes" if each.axis_count > 1 else ""
            say(f"{name_of(each)}: {each.chosen}{axes}: {each.reason}; {each.lattice}")
    took = f", in {seconds:.1f}{JOINED}s" if seconds >= 1 else ""
    say(f"{target}: {summary.file_size} bytes, {compared(summary)}{took}")
    hint = advice(summary, recording)
    if hint:
        say(hint)


def row_of(each: Decision) -> Row:
    kept_as = each.kept_as or ("lossless" if each.exact else each.chosen)
    return Row(name_of(each), kept_as, each.unit, each.sample_count, each.size, each.largest_error)


def name_of(each: Decision) -> str:
    return each.label or f"channel {each.channel}"


def grouped(rows: Sequence[Row]) -> Iterable[Row]:
    for _, run in groupby(rows, lambda row: (row.kept_as, row.unit)):
        members = list(run)
        if len(members) < 3:
            yield from members
            continue
        yield changed(
            members[0],
            label=f"{members[0].label} and {len(members) - 1} more",
            sample_count=sum(row.sample_count for row in members),
            size=sum(row.size for row in members),
            largest_error=max(row.largest_error for row in members),
        )


def compared(summary: Summary) -> str:
    """Against the samples as they came."""
    original = sum(each.original_bits * each.sample_count for each in summary.decisions)
    if not original or not summary.file_size:
        return counted(summary.sample_count, "sample")
    bits = 8 * summary.file_size / summary.sample_count
    came = "float64" if all(d.original_bits == 64 for d in summary.decisions) else "the input"
    ratio = original / (8 * summary.file_size)
    words = f"{ratio:.1f} times smaller" if ratio >= 1 else f"{1 / ratio:.1f} times LARGER"
    return f"{words} than {came} ({bits:.2f}{JOINED}bits/sample)"


def advice(summary: Summary, recording: Recording) -> str:
    """What another preset would make of floating-point channels that were kept to the last bit."""
    every = summary.decisions
    floating = [each for each in every if each.exact and each.lattice.startswith(FLOATING)]
    if not floating or 2 * sum(each.size for each in floating) < sum(each.size for each in every):
        return ""
    ratio = near_lossless_ratio(recording)
    if ratio <= 1.5 * 8 * summary.sample_count / summary.file_size:
        return ""
    those = counted(len(every), "channel") + (" is" if len(floating) == 1 else " are")
    now = sum(each.original_bits * each.sample_count for each in every) / (8 * summary.file_size)
    instead = f", not {now:.1f} times" if now >= 1 else ""
    return (
        f"{len(floating)} of {those} floating point. With --preset near-lossless "
        f"--max-error {MAX_ERROR} this file would be about {ratio:.0f} times smaller than "
        f"float64{instead}."
    )


def near_lossless_ratio(recording: Recording) -> float:
    """Float64 against the near-lossless packets, measured on the middle of every channel."""
    from ..encoder.encode import encode as encode_recording
    from ..encoder.settings import Settings

    parts = []
    for channel in recording.channels:
        middle = (channel.start_tick + channel.stop_tick) // 2
        first = max(middle - TRIED_TICKS // 2, channel.start_tick)
        parts.append(channel.slice_ticks(first, first + TRIED_TICKS))
    settings = Settings.of("near-lossless", max_error=MAX_ERROR)
    tried = encode_recording(changed(recording, channels=tuple(parts)), settings, threads=1)
    size = sum(len(packet.data) for packet in tried.packets)
    return 8 * sum(part.stored.size for part in parts) / max(size, 1)
