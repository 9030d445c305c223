"""Views of channels -> pages: one channel in detail, a few in rows, many as small multiples."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from math import ceil
from typing import TYPE_CHECKING, Any

from ..events import Event
from ..survey.views import View
from . import panels
from .panels import TimeUnit
from .style import GREY, INK, new_figure, plain, style

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROWS = 6
"""Up to this many channels, each has a row of its own with all that is known of it."""
DETAILED = 12
LINE = 0.16
"""Inches of a footnote's line."""
SMALL = 64
"""Small multiples of one page."""


def pages(
    views: Sequence[View],
    *,
    zoom: View | None = None,
    events: Sequence[Event] = (),
    title: str = "",
    footnotes: Sequence[str] = (),
    details: bool = False,
) -> list[Figure]:
    """One page for one channel (``zoom``: the same, a stretch of it) or a few, else one for each
    ``SMALL`` of them; details: then a page for each channel, if there are at most ``DETAILED``."""
    if len(views) == 1:
        return [detail(views[0], zoom, events, title, footnotes)]
    each: list[Figure] = []
    if details and len(views) <= DETAILED:
        each = [detail(view, None, events, title, footnotes) for view in views]
    if len(views) <= ROWS:
        return [rows(views, events, title, footnotes), *each]
    count = ceil(len(views) / SMALL)
    share = ceil(len(views) / count)
    found = []
    for first in range(0, len(views), share):
        part = views[first : first + share]
        which = f"channels {first + 1} to {first + len(part)} of {len(views)}"
        name = f"{title}: {which if count > 1 else f'{len(views)} channels'}"
        found.append(multiples(part, events, name, footnotes))
    return [*found, *each]


def detail(
    view: View, zoom: View | None, events: Sequence[Event], title: str, footnotes: Sequence[str]
) -> Figure:
    """Whole, a stretch of it, and below: texture or error, spectrum, histograms."""
    compared = view.error is not None
    strips = [view.residual is not None, compared]
    heights = [3.0] + ([2.6] if zoom else []) + [1.4 for shown in strips if shown] + [2.3]
    figure = new_figure(11, 1.6 + 0.92 * sum(heights), layout="constrained")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    unit = TimeUnit.of(view.stop - view.start)
    time = f"time in {unit.name}"

    whole = figure.add_subplot(grid[0])
    panels.signal(whole, view, unit)
    panels.absences(whole, view, unit)
    panels.marks(whole, view, unit, events, named=True)
    style(whole, span_name(view), time, panels.axis_label(view))
    if zoom:
        whole.axvspan(
            zoom.start / unit.seconds, zoom.stop / unit.seconds, color=GREY, alpha=0.3, lw=0
        )
    legend(whole)
    row = 1
    if zoom:
        near = figure.add_subplot(grid[row])
        panels.signal(near, zoom, TimeUnit(1.0, "s"))
        panels.absences(near, zoom, TimeUnit(1.0, "s"))
        panels.marks(near, zoom, TimeUnit(1.0, "s"), events, named=False)
        newly = view.knots is None and zoom.knots is not None and zoom.knots.ticks.size
        knots = ", with its knots" if newly else ""
        length = f"{zoom.stop - zoom.start:.3g} s of it, where most happens{knots}"
        style(near, length, "time in s", panels.axis_label(view))
        if newly:
            legend(near)
        row += 1
    if view.residual is not None:
        axes = figure.add_subplot(grid[row], sharex=whole)
        panels.residual(axes, view, unit)
        panels.absences(axes, view, unit, named=False)
        style(axes, "texture (HF): decoded minus slow part", time, panels.axis_label(view))
        row += 1
    if compared:
        axes = figure.add_subplot(grid[row], sharex=whole)
        panels.error(axes, view, unit)
        name = "error: decoded minus original"
        if view.bound:
            name += " (dashed: half a step)"
        style(axes, name, time, panels.error_label(view))
        row += 1
    lowest(figure, grid[row], view)
    head(figure, title, footnotes)
    return figure


def lowest(figure: Figure, place: object, view: View) -> None:
    """Spectrum, and the histograms that there are, side by side."""
    histograms = [h for h in (view.errors, view.relative) if h is not None]
    inner = place.subgridspec(1, 1 + len(histograms))  # type: ignore[attr-defined]
    axes = figure.add_subplot(inner[0])
    panels.spectrum(axes, view)
    style(axes, spectrum_name(view), "frequency in Hz", panels.density_label(view))
    if view.errors is not None:
        axes = figure.add_subplot(inner[1])
        panels.histogram(axes, view.errors, view.bound, "half a step")
        style(axes, "errors", panels.error_label(view), "samples")
    if view.relative is not None:
        axes = figure.add_subplot(inner[2])
        panels.histogram(axes, view.relative, 1.0, "deadband")
        style(axes, "the same in deadbands", "error / half width", "samples")


def rows(
    views: Sequence[View], events: Sequence[Event], title: str, footnotes: Sequence[str]
) -> Figure:
    """A row for each channel: signal, its texture below where there is one; spectrum; errors."""
    compared = any(view.errors is not None for view in views)
    height = max(1.9, min(3.0, 12 / len(views)))
    ratios = [3.2, 1.3, 1.3] if compared else [3.2, 1.3]
    lines = LINE * len(footnotes)
    total = 1.2 + lines + height * len(views)
    figure = new_figure(13, total)
    grid = figure.add_gridspec(
        len(views), len(ratios), width_ratios=ratios, left=0.065, right=0.985,
        top=1 - 0.65 / total, bottom=(0.5 + lines) / total, hspace=0.3, wspace=0.22,
    )  # fmt: skip
    first: Axes | None = None
    for place, view in enumerate(views):
        unit = TimeUnit.of(view.stop - view.start)
        last = place == len(views) - 1
        split = [2.4, 1.0] if view.residual is not None else [1.0]
        inner = grid[place, 0].subgridspec(len(split), 1, height_ratios=split, hspace=0.08)
        axes = figure.add_subplot(inner[0], sharex=first)
        first = first or axes
        panels.signal(axes, view, unit)
        panels.absences(axes, view, unit)
        panels.marks(axes, view, unit, events, named=place == 0)
        time = f"time in {unit.name}" if last else ""
        style(axes, plain(view.channel.name), "" if len(split) > 1 else time,
              panels.axis_label(view, short=True))  # fmt: skip
        axes.tick_params(labelbottom=last and len(split) == 1)
        if len(split) > 1:
            below = figure.add_subplot(inner[1], sharex=first)
            panels.residual(below, view, unit)
            panels.absences(below, view, unit, named=False)
            style(below, "", time, "HF")
            below.tick_params(labelbottom=last)
            below.set_ylabel(f"HF in {plain(view.channel.unit.strip('{}'))}", fontsize=8)
        axes = figure.add_subplot(grid[place, 1])
        panels.spectrum(axes, view, legend=place == 0)
        style(axes, "spectrum" if place == 0 else "", "frequency in Hz" if last else "",
              panels.density_label(view))  # fmt: skip
        if view.errors is not None:
            axes = figure.add_subplot(grid[place, 2])
            in_deadbands = view.bound is None and view.relative is not None
            if in_deadbands and view.relative is not None:
                panels.histogram(axes, view.relative, 1.0, "deadband")
            else:
                panels.histogram(axes, view.errors, view.bound, "half a step")
            label = "error / half width" if in_deadbands else panels.error_label(view)
            style(axes, "errors" if place == 0 else "", label, "samples")
    shared_legend(figure)
    head(figure, title, footnotes)
    return figure


def multiples(
    views: Sequence[View], events: Sequence[Event], title: str, footnotes: Sequence[str]
) -> Figure:
    """Small panels, each with its own scale, one time line for all."""
    columns = 2 if len(views) <= 16 else 3 if len(views) <= 30 else 4
    count = ceil(len(views) / columns)
    height = 1.25 if columns == 2 else 1.1
    lines = LINE * len(footnotes)
    total = 1.2 + lines + height * count
    figure = new_figure(4.2 * columns if columns < 4 else 16, total)
    grid = figure.add_gridspec(
        count, columns, left=0.055 if columns > 2 else 0.075, right=0.99,
        top=1 - 0.65 / total, bottom=(0.5 + lines) / total,
        hspace=0.42, wspace=0.22 if columns > 2 else 0.16,
    )  # fmt: skip
    unit = TimeUnit.of(max(view.stop - view.start for view in views))
    for place, view in enumerate(views):
        row, column = place % count, place // count
        axes = figure.add_subplot(grid[row, column])
        panels.signal(axes, view, unit, width=0.7)
        panels.absences(axes, view, unit, named=False)
        panels.marks(axes, view, unit, events, named=False)
        last = row == count - 1 or place == len(views) - 1
        style(axes, "", f"time in {unit.name}" if last else "", panels.axis_label(view, short=True))
        name = plain(view.channel.name)
        if view.errors is not None and view.errors.total:
            name += f": largest error {view.errors.largest:.2g}"
        axes.set_title(name, loc="left", fontsize=8, color=INK, pad=2)
        axes.tick_params(labelsize=7, labelbottom=last)
        axes.yaxis.label.set_fontsize(7)
        axes.locator_params(axis="y", nbins=4)
    shared_legend(figure)
    head(figure, title, footnotes)
    return figure


def span_name(view: View) -> str:
    channel = view.channel
    rate = f"{float(channel.rate):.6g} Hz"
    return f"{plain(channel.name)}: {view.full.sample_count} samples at {rate}"


def spectrum_name(view: View) -> str:
    segments = max((s.segments for s in view.spectra.values()), default=0)
    size = max((s.size / s.rate_hz for s in view.spectra.values()), default=0.0)
    return f"spectrum ({segments} segments of {size:.2g} s)" if segments else "spectrum"


def legend(axes: Axes) -> None:
    """Above the panel, at its right, so that it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        handles, labels, loc="lower right", bbox_to_anchor=(1, 1), ncols=len(labels),
        frameon=False, fontsize=8.5, borderpad=0, handlelength=1.6, columnspacing=1.2,
    )  # fmt: skip


def shared_legend(figure: Figure) -> None:
    """What any of the panels shows, once."""
    pairs = [axes.get_legend_handles_labels() for axes in figure.axes]
    known: dict[str, Artist] = {}
    for handle, label in chain.from_iterable(zip(*pair, strict=True) for pair in pairs):
        if label != "all":
            known.setdefault(label, handle)
    if len(known) > 1:
        top = 1 - 0.02 / figure.get_size_inches()[1]
        figure.legend(
            list(known.values()), list(known), loc="upper right", bbox_to_anchor=(0.99, top),
            ncols=len(known), frameon=False, fontsize=8.5, handlelength=1.6, columnspacing=1.2,
        )  # fmt: skip


def head(figure: Figure, title: str, footnotes: Sequence[str]) -> None:
    if title:
        look: dict[str, Any] = {"fontsize": 12, "color": INK, "x": 0.01, "ha": "left"}
        if figure.get_layout_engine() is None:
            # Else it is moved out of the way of the rest.
            look |= {"y": 1 - 0.08 / figure.get_size_inches()[1], "va": "top"}
        figure.suptitle(plain(title), **look)
    if footnotes:
        figure.supxlabel(
            "\n".join(plain(line) for line in footnotes), fontsize=8.5, color=panels.DAMAGE,
            x=0.01, ha="left", va="bottom",
        )  # fmt: skip
