"""Two recordings on one page: both signals, what lies between them, how often."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import TYPE_CHECKING

from ..survey.compare import Comparison
from ..survey.views import View
from . import panels
from .pages import LINE, head, shared_legend
from .panels import TimeUnit
from .style import BLUE, GREY, ORANGE, new_figure, plain, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROWS = 8
"""Channels of one page."""


def pages(
    found: Sequence[Comparison], views: Sequence[View], *, title: str, footnotes: Sequence[str]
) -> list[Figure]:
    """views: of B, with A as their original. Those that differ come first."""
    verdicts = {row.number: row for row in found if not row.reason}
    order = sorted(views, key=lambda view: verdicts[view.channel.number].identical)
    count = ceil(len(order) / ROWS)
    share = ceil(len(order) / count)
    return [
        page(order[at : at + share], verdicts, title, footnotes)
        for at in range(0, len(order), share)
    ]


def page(
    views: Sequence[View],
    verdicts: dict[int, Comparison],
    title: str,
    footnotes: Sequence[str],
) -> Figure:
    height = 3.4 if len(views) < 4 else 2.5
    lines = LINE * len(footnotes)
    total = 1.2 + lines + height * len(views)
    figure = new_figure(13, total)
    grid = figure.add_gridspec(
        len(views), 2, width_ratios=[3.2, 1.2], left=0.07, right=0.985,
        top=1 - 0.7 / total, bottom=(0.5 + lines) / total, hspace=0.32, wspace=0.18,
    )  # fmt: skip
    for place, view in enumerate(views):
        unit = TimeUnit.of(view.stop - view.start)
        last = place == len(views) - 1
        inner = grid[place, 0].subgridspec(2, 1, height_ratios=[1.7, 1.0], hspace=0.1)
        above = figure.add_subplot(inner[0])
        assert view.original is not None and view.errors is not None
        panels.curve(above, view.original, unit, GREY, 3.0, "A")
        panels.curve(above, view.full, unit, BLUE, 1.0, "B")
        above.margins(y=0.08)
        above.set_xlim(view.start / unit.seconds, view.stop / unit.seconds)
        panels.missing(above, view, unit)
        style(
            above,
            headline(view, verdicts[view.channel.number]),
            "",
            panels.axis_label(view, short=True),
        )
        above.tick_params(labelbottom=False)
        below = figure.add_subplot(inner[1], sharex=above)
        panels.error(below, view, unit, colour=ORANGE, name="B − A", bound=False)
        style(below, "", f"time in {unit.name}" if last else "", panels.error_label(view, "B − A"))
        below.tick_params(labelbottom=last)
        axes = figure.add_subplot(grid[place, 1])
        panels.histogram(axes, view.errors, None, "")
        style(axes, "", panels.error_label(view, "B − A"), "samples")
    shared_legend(figure)
    head(figure, title, footnotes)
    return figure


def headline(view: View, row: Comparison) -> str:
    name = plain(view.channel.name)
    if row.identical:
        return f"{name}: identical"
    unit = "" if view.channel.unit in ("", "1") else f" {plain(view.channel.unit)}"
    said = f"largest {row.largest:.4g}{unit}, rms {row.rms:.3g}{unit}"
    missing = row.only_a + row.only_b
    return f"{name}: {said}" + (f", {missing} samples in one only" if missing else "")
