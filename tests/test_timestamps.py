"""Times of messages: they jitter, drift, come in bursts, and some are lost. Their ticks are counted."""

from __future__ import annotations

import io
import sys
from itertools import islice

import numpy as np
import pytest
from depth import PROFILE, deep
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

import stamps
from stamps import Publisher

from hapfmt.convert import read
from hapfmt.errors import MovedTimesWarning, ParameterError
from hapfmt.recording import Recording, Span
from hapfmt.times import settle

CASES = {
    "as it comes": Publisher(),
    "another run": Publisher(seed=1),
    "jitter both ways": Publisher(jitter=0.15, late=False),
    "much jitter": Publisher(jitter=0.3, late=False),
    "many bursts": Publisher(bursts=0.01),
    "a fast clock": Publisher(drift_ppm=-200),
    "no loss": Publisher(lost=()),
    "single losses": Publisher(lost=((50, 52), (3000, 3001), (15_000, 15_100))),
    "slow": Publisher(rows=600, rate=30, lost=((300, 310),)),
    "few rows": Publisher(rows=100, lost=((50, 53),), bursts=0),
    "long": Publisher(rows=200_000),
}


@pytest.mark.parametrize("case", CASES)
def test_ticks_are_counted(case):
    """At most 0.5 % of the rows are on a wrong tick. The rate of many rows is right within 1 ppm."""
    publisher = CASES[case]
    ticks, times = publisher.messages()
    found = settle(times)
    assert np.count_nonzero(found.ticks != ticks) <= 0.005 * len(ticks)
    assert found.ticks[-1] == ticks[-1]
    share = abs(found.period_s / publisher.period - 1)
    assert share <= max(1e-6, publisher.jitter / len(ticks))
    assert found.residual < 0.3


def scattered(share: float, seed: int) -> tuple[tuple[int, int], ...]:
    generator = np.random.default_rng(seed)
    return tuple((n, n + 1) for n in np.flatnonzero(generator.random(20_000) < share).tolist())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("jitter", "late", "lost", "wrong"),
    [
        (0.1, True, 0.003, 0.0005),
        (0.2, False, 0.003, 0.001),
        (0.3, False, 0.003, 0.004),
        (0.4, False, 0.001, 0.003),
        (0.6, True, 0.001, 0.003),
    ],
)
def test_scattered_losses(jitter, late, lost, wrong, seed):
    """The limits: the share of rows on a wrong tick, and each of those is one tick off."""
    publisher = Publisher(jitter=jitter, late=late, lost=scattered(lost, seed), bursts=0, seed=seed)
    ticks, times = publisher.messages()
    found = settle(times)
    assert found.is_regular and np.abs(found.ticks - ticks).max() <= 1
    assert np.count_nonzero(found.ticks != ticks) <= wrong * len(ticks)


@pytest.mark.parametrize("seed", range(6))
def test_many_losses(seed):
    """One row in a hundred; the period of all rows is not that of the rows that came."""
    lost = scattered(0.01, seed)
    ticks, times = Publisher(jitter=0.3, late=False, lost=lost, bursts=0, seed=seed).messages()
    found = settle(times)
    assert found.is_regular and np.count_nonzero(found.ticks != ticks) <= 0.02 * len(ticks)


def test_the_loss_is_where_it_was():
    _, times = Publisher().messages()
    found = settle(times).ticks
    [gap] = np.flatnonzero(np.diff(found) > 1)
    assert (found[gap], found[gap + 1]) == (6999, 7030)


@given(st.integers(0, 2**32), st.floats(-200, 200), st.floats(0.1, 10_000))
def test_without_jitter_nearly_every_tick_is_exact(seed, drift, rate):
    """One row in twenty is lost."""
    generator = np.random.default_rng(seed)
    ticks = np.delete(np.arange(400), generator.integers(30, 370, 20))
    times = 50 + ticks / (rate * (1 + drift * 1e-6))
    found = settle(times)
    assert not found.is_regular or np.abs(found.ticks - ticks).max() <= 3


def table(times: np.ndarray, rate: float | None = None) -> Recording:
    rows = "".join(f"{time:.12f},{row}\n" for row, time in enumerate(times))
    return read(io.BytesIO(f"t [s],x [N]\n{rows}".encode()), format="csv", rate=rate)


@pytest.mark.parametrize("rate", [None, 1000])
def test_a_table_of_such_times(rate):
    _, times = Publisher().messages()
    with pytest.warns(MovedTimesWarning, match="only the regular times are stored"):
        [channel] = table(times, rate).channels
    assert channel.rate == 1000
    assert channel.gaps == (Span(7000, 7030),)


@pytest.mark.parametrize("rates", [(1000, 1000.05), *deep([(1000, 999), (1000, 1000, 1000.02)])])
def test_publishers_in_turn_are_refused(rates):
    """Each has a clock of its own, and all come in one column."""
    times = [
        Publisher(rate=rate, jitter=0.02, bursts=0, lost=(), seed=n).messages()[1] + n * 0.0003
        for n, rate in enumerate(rates)
    ]
    together = np.unique(np.round(np.concatenate(times), 9))
    assert settle(together).sources == len(rates)
    with pytest.raises(ParameterError, match=f"from {len(rates)} sources in turn"):
        table(together)


def is_on_the_page(rows: list[list[str]]) -> bool:
    page = (ROOT / "docs" / "files-and-formats.md").read_text("utf-8")
    return "".join(f"| {' | '.join(row)} |\n" for row in rows) in page


@pytest.mark.deep
def test_the_table_of_wrong_ticks():
    assert is_on_the_page([*islice(stamps.rows(), 1)])


@pytest.mark.deep
@pytest.mark.skipif(PROFILE != "nightly", reason="takes half a minute: in the profile nightly")
def test_the_whole_table_of_wrong_ticks():
    assert is_on_the_page([*stamps.rows()])
