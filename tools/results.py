"""What a benchmark found: one row for each coder, tables of them, and CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from math import exp, log
from pathlib import Path
from typing import NamedTuple

from measured import print_table

OURS = "ours"
NAME = 40
"""Characters of a recording's name in a table."""


@dataclass
class Row:
    """One coder on one recording and task.

    ``coded_size``: bytes of packets, of a peer blobs and 4 a channel. ``file_size``: with
    everything, a peer's in a zip. ``outside``: samples beyond the bound, or that differ where there
    is none; ``worst``: largest error in deadbands, or in % of the range where there is none. Both
    in float64; ``outside_counts`` and ``worst_counts`` in integers, by ``verify``. Seconds are the
    best of ``runs``.
    """

    recording: str
    task: str
    coder: str
    family: str
    channels: int
    samples: int
    coded_size: int
    file_size: int
    outside: int
    worst: float
    encode_s: float
    decode_s: float
    runs: int
    outside_counts: int | None = None
    worst_counts: float | None = None

    @property
    def held(self) -> bool:
        return not (self.outside or self.outside_counts)

    @property
    def coded(self) -> float:
        """Bits a sample."""
        return 8 * self.coded_size / self.samples

    @property
    def file(self) -> float:
        """Bits a sample."""
        return 8 * self.file_size / self.samples

    def speed(self, seconds: float) -> str:
        rate = self.samples / 1e6 / seconds if seconds else float("inf")
        return f"{rate:.1f}" if rate >= 1 else f"{rate:.3f}"


class Cell(NamedTuple):
    """One recording and task: our row, and the peers that keep the bound."""

    ours: Row
    peers: list[Row]

    @property
    def what(self) -> str:
        """Task, and our coder where its name says more."""
        known = self.ours.task.startswith(self.ours.coder)
        return self.ours.task if known else f"{self.ours.task}: {self.ours.coder}"

    @property
    def best(self) -> Row:
        return min(self.peers, key=lambda row: row.coded_size)

    @property
    def best_file(self) -> Row:
        return min(self.peers, key=lambda row: row.file_size)

    def ratio(self, family: str | None = None) -> float | None:
        """Our coded bytes over those of the best peer, of one family or of all."""
        sizes = [row.coded_size for row in self.peers if family in (None, row.family)]
        return self.ours.coded_size / min(sizes) if sizes else None


def cells(rows: Iterable[Row]) -> list[Cell]:
    """Each of our coders and its peers on the same recording and task, where there are any."""
    by_place: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        by_place.setdefault((row.recording, row.task), []).append(row)
    found = []
    for members in by_place.values():
        peers = [row for row in members if row.family != OURS and row.held]
        if peers:
            found += [Cell(row, peers) for row in members if row.family == OURS]
    return found


def mean(ratios: Sequence[float]) -> float:
    """Geometric."""
    return exp(sum(map(log, ratios)) / len(ratios))


def print_sizes(table: Sequence[Cell]) -> None:
    """Bits a sample of ours and of the best peer, packets alone and whole files."""
    rows = [
        [
            cell.ours.recording[:NAME], cell.what, cell.ours.channels,
            f"{cell.ours.coded:.4f}", f"{cell.ours.file:.4f}", cell.best.coder,
            f"{cell.best.coded:.4f}", f"{cell.best_file.file:.4f}",
            f"{cell.ours.coded_size / cell.best.coded_size:.3f}",
            f"{cell.ours.file_size / cell.best_file.file_size:.3f}",
            f"{cell.ours.outside_counts or 0} / {cell.ours.outside}",
            f"{cell.ours.worst_counts or 0:.4f} / {cell.ours.worst:.4f}",
        ]
        for cell in table
    ]  # fmt: skip
    headers = ["recording", "task", "channels", "b/s", "file b/s", "best peer", "peer b/s",
               "peer file b/s", "ratio", "file ratio", "outside", "largest"]  # fmt: skip
    print_table(headers, rows)


def print_speeds(table: Sequence[Cell], beside: str) -> None:
    """Ms/s of CPU time: ours, the best peer, and one that is always shown."""
    rows = []
    for cell in table:
        fixed = [row for row in cell.peers if row.coder.endswith(beside)]
        row: list[object] = [cell.ours.recording[:NAME], cell.what]
        for shown in (cell.ours, cell.best, *fixed[:1]):
            row += [shown.speed(shown.encode_s), shown.speed(shown.decode_s)]
        rows.append([*row, *["-"] * (8 - len(row)), cell.best.coder, cell.ours.runs])
    print_table(
        ["recording", "task", "encode", "decode", "peer enc", "peer dec", f"{beside} enc", "dec",
         "best peer", "n"],
        rows,
    )  # fmt: skip


def print_summary(groups: dict[str, Sequence[Cell]]) -> None:
    """Geometric means over the cells of each group, and how many of them are won."""
    rows = []
    for name, table in groups.items():
        if not table:
            continue
        whole = [cell.ours.file_size / cell.best_file.file_size for cell in table]
        coded = [cell.ours.coded_size / cell.best.coded_size for cell in table]
        row: list[object] = [name, len(table), f"{mean(coded):.3f}", sum(r < 1 for r in coded),
                             f"{mean(whole):.3f}", sum(r < 1 for r in whole)]  # fmt: skip
        for family in ("log", "cells"):
            ratios = [ratio for cell in table if (ratio := cell.ratio(family)) is not None]
            row.append(f"{mean(ratios):.3f}" if ratios else "-")
        samples = sum(cell.ours.samples for cell in table) / 1e6
        encoding = sum(cell.ours.encode_s for cell in table)
        decoding = sum(cell.ours.decode_s for cell in table)
        row += [f"{samples / encoding:.2f}", f"{samples / decoding:.2f}"]
        rows.append(row)
    print_table(
        ["geometric means", "cells", "ratio", "won", "file ratio", "won", "to log", "to cells",
         "encode Ms/s", "decode Ms/s"],
        rows,
    )  # fmt: skip


def print_broken(rows: Iterable[Row]) -> None:
    """Every coder that left its bound."""
    broken = [row for row in rows if not row.held]
    for row in broken:
        print(
            f"bound broken: {row.coder} on {row.recording}, {row.task}: {row.outside} of "
            f"{row.samples} samples in float64, {row.outside_counts or 0} in counts, up to "
            f"{row.worst:.3f} deadbands"
        )
    if broken:
        print()


def write_csv(rows: Sequence[Row], path: Path, origin: str) -> None:
    """One line a row, bits a sample and where it was measured included."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        out = csv.writer(stream)
        names = [*Row.__dataclass_fields__, "coded_bits", "file_bits", "held", "measured_on"]
        out.writerow(names)
        for row in rows:
            values = [
                f"{value:.6g}" if isinstance(value, float) else value
                for value in asdict(row).values()
            ]
            out.writerow([*values, f"{row.coded:.6f}", f"{row.file:.6f}", row.held, origin])
