"""How often intervals of 95 % hold the true mean: Student's t, and a percentile bootstrap.

python tools/intervals.py [--write]       simulated ratings from 0 to 100
"""

from __future__ import annotations

import installed  # noqa: F401

import click
import numpy as np
from measured import print_table, write_rows

from hapfmt.lab.study.summary import mean_of

SHAPES = {"around 90 (beta 9, 1)": (9.0, 1.0), "around 50 (beta 4, 4)": (4.0, 4.0)}
SUBJECTS = (5, 11, 20)
TESTS, RESAMPLED = 4000, 1000


def shares(a: float, b: float, n: int, tests: int) -> tuple[float, float]:
    """Shares of the tests with n subjects whose interval holds the true mean."""
    rng, truth = np.random.default_rng(n), 100 * a / (a + b)
    held = np.zeros(2)
    for values in 100 * rng.beta(a, b, (tests, n)):
        found = mean_of(values.tolist())
        again = rng.choice(values, (RESAMPLED, n)).mean(axis=1)
        for place, (low, high) in enumerate(
            ((found.low, found.high), np.percentile(again, (2.5, 97.5)))
        ):
            assert low is not None and high is not None
            held[place] += low <= truth <= high
    return float(held[0]) / tests, float(held[1]) / tests


def rows(tests: int) -> list[list[str]]:
    return [
        [name if n == SUBJECTS[0] else "", f"{n}", *(f"{x:.1%}" for x in shares(*shape, n, tests))]
        for name, shape in SHAPES.items()
        for n in SUBJECTS
    ]


@click.command(help=__doc__)
@click.option("--tests", default=TESTS)
@click.option("--write", is_flag=True, help="Put the table into docs/studies.md.")
def main(tests: int, write: bool) -> None:
    found = rows(tests)
    print_table(["ratings", "n", "t, 95 %", "bootstrap, 95 %"], found)
    if write:
        write_rows("intervals", found)


if __name__ == "__main__":
    main()
