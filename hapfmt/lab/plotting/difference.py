"""Two recordings on one page: both signals and their differences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ...numbers import counted
from ..survey.compare import Comparison
from ..survey.views import View
from . import panels
from .pages import Sheet, Words, amount, grid_shape, one_unit, parts_of, placed
from .panels import TimeUnit, named
from .style import plain, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

ROWS = 4
"""Up to this many channels, each has a row with a histogram."""
SMALL = 32
"""Largest number of channels on one page."""
NAMES = 8
"""Largest number of identical channels that are named."""


def pages(found: Sequence[Comparison], views: Sequence[View], words: Words) -> list[Figure]:
    """views: of B, with A as the original. Identical channels are named; they are drawn only if no
    channel differs."""
    verdicts = {row.number: row for row in found if not row.reason}
    differing = [view for view in views if not verdicts[view.channel.number].identical]
    same = [view for view in views if verdicts[view.channel.number].identical]
    facts = list(words.facts)
    if same:
        names = ", ".join(view.channel.name for view in same[:NAMES])
        more = f" and {len(same) - NAMES} more" if len(same) > NAMES else ""
        aside = " (not drawn)" if differing else ""
        facts.append(f"identical{aside}: {names}{more}")
    words = Words(words.title, facts, words.footnotes)
    drawn = differing or same
    if len(drawn) <= ROWS:
        return [rows(drawn, verdicts, words)]
    return [multiples(part, verdicts, words) for _, part in parts_of(drawn, SMALL)]


def rows(views: Sequence[View], verdicts: dict[int, Comparison], words: Words) -> Figure:
    sheet = Sheet(13, 2.9 * len(views), words, left=0.95)
    grid = sheet.grid(len(views), 2, 0.5, 0.75, width_ratios=[3.2, 1.2])
    shared = one_unit(views)
    for place, view in enumerate(views):
        last = place == len(views) - 1
        pair(sheet.figure, grid[place, 0], view, verdicts, last=last, unit=not shared)
        axes = sheet.figure.add_subplot(grid[place, 1])
        assert view.errors is not None
        scale = panels.error_scale(view)
        panels.histogram(axes, view.errors, None, scale, "difference B − A")
        style(axes, "How often each difference occurs" if place == 0 else "",
              named("B − A", scale.unit), "samples")  # fmt: skip
    return sheet.finish(shared)


def multiples(views: Sequence[View], verdicts: dict[int, Comparison], words: Words) -> Figure:
    columns, count = grid_shape(len(views))
    sheet = Sheet(max(4.6 * columns, 9), max(1.9, min(2.4, 9 / count)) * count, words, left=0.95)
    grid = sheet.grid(count, columns, 0.45, 0.85)
    shared = one_unit(views)
    for view, row, column, last in placed(views, columns):
        pair(sheet.figure, grid[row, column], view, verdicts, last=last, unit=not shared)
    return sheet.finish(shared)


def pair(
    figure: Figure, place: SubplotSpec, view: View, verdicts: dict[int, Comparison], *,
    last: bool, unit: bool,
) -> tuple[Axes, Axes]:  # fmt: skip
    """A and B, and their difference below."""
    time = TimeUnit.of(view.stop - view.start)
    inner = place.subgridspec(2, 1, height_ratios=[1.7, 1.0], hspace=0.12)
    above = figure.add_subplot(inner[0])
    assert view.original is not None and view.errors is not None
    panels.curve(above, view.original, time, 3.0, "A")
    panels.curve(above, view.full, time, 0.9, "B")
    above.set_ylim(*panels.limits(view))
    above.set_xlim(view.start / time.seconds, view.stop / time.seconds)
    panels.missing(above, view, time)
    style(above, headline(view, verdicts[view.channel.number]), "",
          panels.unit_of(view) if unit else "", size=9)  # fmt: skip
    above.tick_params(labelbottom=False, labelsize=7.5)
    below = figure.add_subplot(inner[1], sharex=above)
    panels.error(below, view, time, name="difference B − A")
    style(below, "", f"time in {time.name}" if last else "", below.get_ylabel())
    below.tick_params(labelbottom=last, labelsize=7.5)
    below.yaxis.label.set_fontsize(8)
    for axes in (above, below):
        if axes.get_yticks().size:
            axes.locator_params(axis="y", nbins=4)
    return above, below


def headline(view: View, row: Comparison) -> str:
    name = plain(view.channel.name)
    if row.identical:
        return f"{name}: identical"
    said = f"largest {amount(view, row.largest)}, rms {amount(view, row.rms)}"
    missing = row.only_a + row.only_b
    return f"{name}: {said}" + (f", {counted(missing, 'sample')} in one only" if missing else "")
