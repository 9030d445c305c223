"""Pages of channel views: one channel in detail, a few in rows, or many as small panels.

Pages can be saved or shown in a window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import chain
from math import ceil, log2
from typing import TYPE_CHECKING, Any

from ...errors import ParameterError
from ...numbers import exact
from ...recording import Event, Recording, Seconds, check_seconds
from ..views import ChannelView
from . import panels
from .panels import (
    DAMAGE,
    DIM,
    GREY,
    INK,
    Scale,
    TimeUnit,
    named,
    new_figure,
    plain,
    printable,
    style,
    unformatted,
)

if TYPE_CHECKING:
    import tkinter

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

ROWS = 6
"""Up to this number of channels, each gets a row with its spectrum and errors."""
DETAILED = 12
SMALL = 64
"""Largest number of small panels on one page."""
ASPECT = 1.5
"""Preferred width over height of a page of small panels."""
CHARACTERS = 14.2
"""Characters of a line of facts that fit one inch."""


@dataclass(frozen=True)
class Words:
    """Texts around the panels: ``facts`` below the title, ``footnotes`` about damage."""

    title: str = ""
    facts: Sequence[str] = ()
    footnotes: Sequence[str] = ()


class Sheet:
    """A page with space for its header (title, facts, legend) and its footnotes, so that no text
    overlaps a panel."""

    LINE = 0.19

    def __init__(self, width: float, body: float, words: Words, *, left: float = 0.8) -> None:
        self.lines = folded(words.facts, int(CHARACTERS * width))
        self.words = words
        self.top = 0.42 + self.LINE * len(self.lines) + 0.58
        self.bottom = 0.55 + self.LINE * len(words.footnotes)
        self.width, self.height, self.left = width, self.top + body + self.bottom, left
        self.figure = new_figure(width, self.height)

    def grid(self, rows: int, columns: int, hspace: float, wspace: float, **more: Any) -> GridSpec:
        """hspace and wspace in inches."""
        body = self.height - self.top - self.bottom
        inner = self.width - self.left - 0.25
        return self.figure.add_gridspec(
            rows, columns, left=self.left / self.width, right=1 - 0.25 / self.width,
            top=1 - self.top / self.height, bottom=self.bottom / self.height,
            hspace=share(hspace, body, rows), wspace=share(wspace, inner, columns), **more,
        )  # fmt: skip

    def finish(self, unit: str = "") -> Figure:
        """Adds the header. unit: shared by all panels, written at the left."""
        figure, height = self.figure, self.height
        y = 0.12
        if self.words.title:
            self.say(y, plain(self.words.title), fontsize=13, color=INK, fontweight="bold")
            y += 0.3
        for line in self.lines:
            self.say(y, line, fontsize=9.5, color=DIM)
            y += self.LINE
        found = legend_of(figure)
        if found:
            figure.legend(
                list(found.values()), list(found), loc="upper left",
                bbox_to_anchor=(0.06 / self.width, 1 - (y + 0.02) / height),
                ncols=len(found), frameon=False, fontsize=9, handlelength=1.6, columnspacing=1.4,
            )  # fmt: skip
        if unit:
            figure.supylabel(unit, fontsize=9.5, color=INK, x=0.12 / self.width, ha="left")
        y = height - 0.08 - self.LINE * len(self.words.footnotes)
        for line in self.words.footnotes:
            self.say(y, plain_line(line, int(CHARACTERS * self.width)), fontsize=9, color=DAMAGE)
            y += self.LINE
        return figure

    def say(self, y: float, text: str, **look: Any) -> None:
        """y: inches from the top."""
        self.figure.text(0.16 / self.width, 1 - y / self.height, text, va="top", ha="left", **look)


def share(inches: float, whole: float, count: int) -> float:
    """Converts inches to a share of the mean panel, as matplotlib measures space."""
    size = (whole - inches * (count - 1)) / count
    return max(inches / size, 0.0) if size > 0 else 0.2


def folded(facts: Sequence[str], room: int) -> list[str]:
    """Joins facts to lines, without breaking a fact."""
    lines: list[str] = []
    for fact in facts:
        text = plain_line(fact, room)
        if lines and len(lines[-1]) + len(text) + 5 <= room:
            lines[-1] += f"  ·  {text}"
        else:
            lines.append(text)
    return lines


def plain_line(text: str, room: int) -> str:
    shown = printable(text)
    if len(shown) > room:
        shown = shown[: room - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return unformatted(shown)


ZOOM_TICKS = 400
"""Samples of a stretch that is drawn one by one."""


def plot(recording: Recording, start: Seconds | None = None, stop: Seconds | None = None) -> Figure:
    """The matplotlib figure that ``hapfmt plot`` draws of a recording, or of some seconds of it.

    ``figure.savefig`` writes it to a file. It shows the first page if many channels need several:
    ``recording.sel(...)`` selects others. Needs the extra "plot".

    Raises ParameterError, MissingExtraError.
    """
    from ..parts import RecordingParts
    from ..views import facts, liveliest, survey, within

    new_figure(1, 1)
    check_seconds(start, stop)
    parts = RecordingParts(recording)
    first, last = within(
        parts, None if start is None else exact(start), None if stop is None else exact(stop)
    )
    views = survey(parts, first, last, spectra=len(parts.channels) <= ROWS)
    near = liveliest(views[0], ZOOM_TICKS) if len(views) == 1 else None
    zoom = None if near is None else survey(parts, *near, spectra=False)[0]
    words = Words(facts=facts(parts, views, whole=start is None and stop is None))
    return pages(views, words, zoom=zoom, events=parts.events(first, last))[0]


def pages(
    views: Sequence[ChannelView],
    words: Words | None = None,
    *,
    zoom: ChannelView | None = None,
    events: Sequence[Event] = (),
    details: bool = False,
) -> list[Figure]:
    """One page for one channel (``zoom``: the same, a stretch of it) or a few, else one for each
    ``SMALL`` of them; details: then a page for each channel, if there are at most ``DETAILED``."""
    words = words or Words()
    if len(views) == 1:
        return [detail(views[0], zoom, events, words)]
    each: list[Figure] = []
    if details and len(views) <= DETAILED:
        each = [detail(view, None, events, words) for view in views]
    if len(views) <= ROWS:
        return [rows(views, events, words), *each]
    found = []
    for first, part in parts_of(views, SMALL):
        title = words.title
        if len(part) < len(views):
            title += f": channels {first + 1} to {first + len(part)} of {len(views)}"
        found.append(multiples(part, events, Words(title, words.facts, words.footnotes)))
    return [*found, *each]


def parts_of(views: Sequence[ChannelView], most: int) -> list[tuple[int, Sequence[ChannelView]]]:
    """Splits views into shares of about one size, each with its first place."""
    size = ceil(len(views) / ceil(len(views) / most))
    return [(first, views[first : first + size]) for first in range(0, len(views), size)]


def detail(
    view: ChannelView, zoom: ChannelView | None, events: Sequence[Event], words: Words
) -> Figure:
    """Whole, residual and error over one time; a stretch of it; spectrum, histograms."""
    strips = [view.residual is not None, view.error is not None]
    upper = [2.7] + [1.15 for shown in strips if shown]
    between, apart = 0.32, 0.75
    top = sum(upper) + between * (len(upper) - 1)
    heights = [top, *([2.3] if zoom else []), *([1.9] if has_lowest(view) else [])]
    sheet = Sheet(11, sum(heights) + apart * (len(heights) - 1), words)
    grid = sheet.grid(len(heights), 1, apart, 0, height_ratios=heights)
    inner = grid[0].subgridspec(
        len(upper), 1, height_ratios=upper, hspace=share(between, top, len(upper))
    )
    figure = sheet.figure
    unit = TimeUnit.of(view.stop - view.start)

    whole = figure.add_subplot(inner[0])
    panels.signal(whole, view, unit)
    panels.absences(whole, view, unit)
    panels.marks(whole, view, unit, events, named=True)
    style(whole, channel_name(view), "", panels.axis_label(view))
    if zoom:
        whole.axvspan(
            zoom.start / unit.seconds, zoom.stop / unit.seconds, color=GREY, alpha=0.3, lw=0
        )
    stack = [whole]
    if view.residual is not None:
        axes = figure.add_subplot(inner[len(stack)], sharex=whole)
        panels.residual(axes, view, unit)
        panels.absences(axes, view, unit, named=False)
        style(axes, "Residual (HF): decoded minus slow part", "", axes.get_ylabel())
        stack.append(axes)
    if view.error is not None:
        axes = figure.add_subplot(inner[len(stack)], sharex=whole)
        panels.error(axes, view, unit)
        style(axes, "Error: decoded minus original", "", axes.get_ylabel())
        stack.append(axes)
    for axes in stack[:-1]:
        axes.tick_params(labelbottom=False)
    stack[-1].set_xlabel(f"time in {unit.name}")
    if zoom:
        near = figure.add_subplot(grid[1])
        seconds = TimeUnit(1.0, "s")
        panels.signal(near, zoom, seconds)
        panels.absences(near, zoom, seconds)
        panels.marks(near, zoom, seconds, events, named=False)
        length = f"{zoom.stop - zoom.start:.3g} s"
        style(near, f"The {length} in which the signal moves most (grey above)", "time in s",
              panels.axis_label(view))  # fmt: skip
    if has_lowest(view):
        lowest(figure, grid[len(heights) - 1], view)
    figure.align_ylabels()
    return sheet.finish()


def has_lowest(view: ChannelView) -> bool:
    """True if the view has a spectrum or a histogram."""
    segments = any(spectrum.segments for spectrum in view.spectra.values())
    return view.errors is not None or (segments and not panels.is_constant(view))


def lowest(figure: Figure, place: object, view: ChannelView) -> None:
    """Draws the spectrum and the histograms side by side."""
    histograms = [h for h in (view.errors, view.relative) if h is not None]
    inner = place.subgridspec(1, 1 + len(histograms), wspace=0.28)  # type: ignore[attr-defined]
    axes = figure.add_subplot(inner[0])
    panels.spectrum(axes, view)
    style(axes, "Spectrum", "frequency in Hz", panels.density_label(view))
    if view.errors is not None:
        axes = figure.add_subplot(inner[1])
        scale = panels.error_scale(view)
        panels.histogram(axes, view.errors, view.bound, scale)
        style(axes, "How often each error occurs", named("error", scale.unit), "samples")
    if view.relative is not None:
        axes = figure.add_subplot(inner[2])
        panels.histogram(axes, view.relative, 1.0, Scale(1.0, ""))
        style(axes, "The same, relative to the deadband", "error / half the deadband", "samples")


def rows(views: Sequence[ChannelView], events: Sequence[Event], words: Words) -> Figure:
    """A row for each channel: signal, its residual below where there is one; spectrum; errors."""
    compared = any(view.errors is not None for view in views)
    height = max(1.9, min(2.8, 12 / len(views)))
    ratios = [3.2, 1.3, 1.3] if compared else [3.2, 1.3]
    sheet = Sheet(13, height * len(views), words, left=0.95)
    grid = sheet.grid(len(views), len(ratios), 0.5, 0.75, width_ratios=ratios)
    figure = sheet.figure
    shared = one_unit(views)
    first: Axes | None = None
    for place, view in enumerate(views):
        unit = TimeUnit.of(view.stop - view.start)
        last = place == len(views) - 1
        split = [2.4, 1.0] if view.residual is not None else [1.0]
        inner = grid[place, 0].subgridspec(len(split), 1, height_ratios=split, hspace=0.1)
        axes = figure.add_subplot(inner[0], sharex=first)
        first = first or axes
        panels.signal(axes, view, unit)
        panels.absences(axes, view, unit)
        panels.marks(axes, view, unit, events, named=place == 0)
        time = f"time in {unit.name}" if last else ""
        style(axes, channel_name(view), "" if len(split) > 1 else time,
              "" if shared else panels.unit_of(view))  # fmt: skip
        axes.tick_params(labelbottom=last and len(split) == 1)
        if len(split) > 1:
            below = figure.add_subplot(inner[1], sharex=first)
            panels.residual(below, view, unit)
            panels.absences(below, view, unit, named=False)
            style(below, "", time, below.get_ylabel().removeprefix("residual in "))
            below.tick_params(labelbottom=last)
        axes = figure.add_subplot(grid[place, 1])
        panels.spectrum(axes, view)
        style(axes, "Spectrum" if place == 0 else "", "frequency in Hz" if last else "",
              panels.density_label(view) if place == 0 or not shared else "")  # fmt: skip
        if view.errors is not None:
            axes = figure.add_subplot(grid[place, 2])
            scale = panels.error_scale(view)
            if view.bound is None and view.relative is not None:
                panels.histogram(axes, view.relative, 1.0, Scale(1.0, ""))
                label = "error / half the deadband"
            else:
                panels.histogram(axes, view.errors, view.bound, scale)
                label = named("error", scale.unit)
            style(axes, "How often each error occurs" if place == 0 else "", label,
                  "samples" if place == 0 else "")  # fmt: skip
    figure.align_ylabels()
    return sheet.finish(shared)


def multiples(views: Sequence[ChannelView], events: Sequence[Event], words: Words) -> Figure:
    """Small panels, each with its own scale, one time line for all."""
    columns, count = grid_shape(len(views))
    height = max(1.2, min(2.0, 9 / count))
    sheet = Sheet(max(4.2 * min(columns, 4), 9), height * count, words)
    grid = sheet.grid(count, columns, 0.34, 0.55)
    figure = sheet.figure
    unit = TimeUnit.of(max(view.stop - view.start for view in views))
    shared = one_unit(views)
    for view, row, column, last in placed(views, columns):
        axes = figure.add_subplot(grid[row, column])
        panels.signal(axes, view, unit, width=0.7)
        panels.absences(axes, view, unit, named=False)
        panels.marks(axes, view, unit, events, named=False)
        style(axes, channel_name(view, unit="" if shared else panels.unit_of(view)),
              f"time in {unit.name}" if last else "", "", size=9)  # fmt: skip
        axes.tick_params(labelsize=7.5, labelbottom=last)
        axes.locator_params(axis="y", nbins=4)
        axes.locator_params(axis="x", nbins=6)
    return sheet.finish(shared)


def grid_shape(count: int) -> tuple[int, int]:
    """Columns and rows that leave few places empty and give the page a good aspect."""

    def cost(columns: int) -> float:
        rows = ceil(count / columns)
        aspect = 4.0 * columns / (1.5 * rows)
        return (rows * columns - count) / (rows * columns) + 0.35 * abs(log2(aspect / ASPECT))

    columns = min(range(1, min(count, 4) + 1), key=cost)
    return columns, ceil(count / columns)


def placed(views: Sequence[ChannelView], columns: int) -> list[tuple[ChannelView, int, int, bool]]:
    """Each view with its row and column, and whether it is the last of its column. The views fill
    one column after the other, and the columns differ by one view at most."""
    each, more = divmod(len(views), columns)
    found = []
    views = list(views)
    for column in range(columns):
        size = each + (column < more)
        own, views = views[:size], views[size:]
        found += [(view, row, column, row == size - 1) for row, view in enumerate(own)]
    return found


def one_unit(views: Sequence[ChannelView]) -> str:
    """Quantity and unit if all views share them, else blank."""
    units = {panels.unit_of(view) for view in views}
    if len(units) != 1:
        return ""
    quantities = {view.channel.quantity for view in views}
    quantity = quantities.pop() if len(quantities) == 1 else ""
    return named(plain(quantity.replace("_", " ")), units.pop())


def channel_name(view: ChannelView, *, unit: str = "") -> str:
    """Label, unit, and the largest error if there is an original, else what the file states."""
    name = plain(view.channel.name) + (f" in {unit}" if unit else "")
    if view.errors is not None and view.errors.total:
        largest = view.errors.largest
        return f"{name}: " + (f"largest error {amount(view, largest)}" if largest else "no error")
    return f"{name}: {plain(view.channel.kept_as)}" if view.channel.is_lossy else name


def amount(view: ChannelView, value: float) -> str:
    return Scale.of(view.channel.unit, value).amount(value)


def legend_of(figure: Figure) -> dict[str, Artist]:
    """Handles of all panels by label, each label once."""
    pairs = [axes.get_legend_handles_labels() for axes in figure.axes]
    known: dict[str, Artist] = {}
    for handle, label in chain.from_iterable(zip(*pair, strict=True) for pair in pairs):
        known.setdefault(label, handle)
    return known


INSTEAD = "use --output picture.png"


def show(figures: Sequence[Figure], title: str) -> None:
    """Show the pages, each in a tab of its own, until the window is closed."""
    root = open_window(title)
    from tkinter import ttk

    tk: Any = import_module("matplotlib.backends.backend_tkagg")
    book = ttk.Notebook(root)
    book.pack(fill="both", expand=True)
    for number, figure in enumerate(figures, 1):
        frame = ttk.Frame(book)
        book.add(frame, text=f"page {number}")
        canvas = tk.FigureCanvasTkAgg(figure, master=frame)
        tk.NavigationToolbar2Tk(canvas, frame).update()
        canvas.get_tk_widget().pack(fill="both", expand=True)
    root.mainloop()


def open_window(title: str) -> tkinter.Tk:
    """An empty window, or ParameterError that says what to do instead."""
    try:
        import tkinter
    except ImportError:
        raise ParameterError(
            f"A window needs tkinter, which this Python lacks; {INSTEAD}"
        ) from None
    try:
        root = tkinter.Tk()
    except tkinter.TclError:
        raise ParameterError(f"No display for a window; {INSTEAD}") from None
    root.title(title)
    return root
