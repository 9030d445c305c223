"""Simulated stamps of messages: how many of their rows hapfmt puts on a wrong tick.

python tools/stamps.py [--write]

Prints the table in docs/files-and-formats.md: the largest share of several runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import installed  # noqa: F401

import click
import numpy as np
from measured import print_table, write_rows
from numpy.typing import NDArray

from hapfmt.convert.timestamps import place
from hapfmt.errors import ParameterError


class Publisher(NamedTuple):
    """A device of nominally ``rate`` Hz, and what happens to the times of its messages.

    ``jitter``: standard deviation in periods; ``late``: messages come late only. ``lost``: ticks
    from, to. ``lost_share``: of single rows anywhere. ``bursts``: share of rows at which 12 rows
    begin that come together.
    """

    rows: int = 20_000
    rate: float = 1000.0
    drift_ppm: float = 40.0
    jitter: float = 0.08
    late: bool = True
    lost: tuple[tuple[int, int], ...] = ((7000, 7030),)
    lost_share: float = 0.0
    bursts: float = 0.002
    seed: int = 0

    @property
    def period(self) -> float:
        return 1 / (self.rate * (1 - self.drift_ppm * 1e-6))

    def messages(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The true ticks, from 0, and the times in s."""
        generator = np.random.default_rng(self.seed)
        ticks = np.arange(self.rows)
        for start, stop in self.lost:
            ticks = ticks[(ticks < start) | (ticks >= stop)]
        if self.lost_share:
            ticks = ticks[generator.random(len(ticks)) >= self.lost_share]
        delay = generator.normal(0, self.jitter, len(ticks))
        times = (ticks + (np.abs(delay) if self.late else delay)) * self.period
        for first in np.flatnonzero(generator.random(len(ticks)) < self.bursts):
            last = min(first + 12, len(ticks)) - 1
            times[first : last + 1] = np.maximum(times[first : last + 1], times[last])
        times = np.maximum.accumulate(times) + 1e-12 * np.arange(len(ticks))
        return ticks - ticks[0], times


DELAYS = ((0.1, True), (0.3, True), (0.6, True), (0.2, False), (0.3, False), (0.4, False))
BURSTS = (0.0, 0.01)
LOSSES = {
    "no loss": Publisher(lost=()),
    "30 rows": Publisher(),
    "0.1 %": Publisher(lost=(), lost_share=0.001),
    "0.3 %": Publisher(lost=(), lost_share=0.003),
    "1 %": Publisher(lost=(), lost_share=0.01),
}
NUMBERED = "1 %, numbered"
DRIFTS = (-150.0, 40.0, 150.0)
SEEDS = range(2)


def wrong_share(publisher: Publisher, *, numbered: bool = False) -> float | None:
    """Share of the rows that are on a wrong tick; None where the stamps are refused."""
    ticks, times = publisher.messages()
    stamps = np.round(times * 1e9).astype(np.int64)
    try:
        placed = place(stamps, name="rows", sequence=ticks if numbered else None)
    except ParameterError:
        return None
    return 1.0 if placed is None else float(np.mean(placed.ticks != ticks))


def cell(publisher: Publisher, *, numbered: bool = False) -> str:
    """Percent of the worst run, and how many runs were refused."""
    shares = [
        wrong_share(publisher._replace(drift_ppm=drift, seed=seed), numbered=numbered)
        for drift in DRIFTS
        for seed in SEEDS
    ]
    kept = [share for share in shares if share is not None]
    refused = len(shares) - len(kept)
    words = [f"{100 * max(kept):.2f}"] if kept else []
    if refused:
        words.append(f"{refused} of {len(shares)} refused" if kept else "refused")
    return ", ".join(words)


def rows(delays: tuple[tuple[float, bool], ...] = DELAYS) -> Iterator[list[str]]:
    for jitter, late in delays:
        for bursts in BURSTS:
            changed = {"jitter": jitter, "late": late, "bursts": bursts}
            cells = [cell(each._replace(**changed)) for each in LOSSES.values()]
            cells.append(cell(LOSSES["1 %"]._replace(**changed), numbered=True))
            how = f"{jitter:g} {'late' if late else 'early or late'}"
            yield [how, f"{1200 * bursts:.1f} %", *cells]


@click.command(help=__doc__)
@click.option("--write", is_flag=True, help="Put the table into docs/files-and-formats.md.")
def main(write: bool) -> None:
    found = list(rows())
    print_table(["jitter, periods", "rows in bursts", *LOSSES, NUMBERED], found)
    if write:
        write_rows("stamps", found)


if __name__ == "__main__":
    main()
