"""Figures on one page, drawn from plain arrays, without any reader or writer.

There are three: how the format works (slow part, residual, error, file sizes), two recordings with
their differences, and the ratings of a study. The last follows Fig. 5 of Brandi, Chaudhari and
Steinbach (2011): mean opinion over the deadband k, one line for each number of bits. Conditions
that form no such grid are drawn side by side.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import ParameterError
from ...numbers import counted
from ..compare import Comparison
from ..views import ChannelView
from . import panels
from .pages import Sheet, Words, amount, grid_shape, one_unit, parts_of, placed
from .panels import (
    DIM,
    GREY,
    INK,
    LINES,
    PALETTE,
    SERIES,
    SIGNAL,
    Scale,
    TimeUnit,
    instead,
    kind_of,
    named,
    new_figure,
    plain,
    save,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

SHOWN_S = 1.0
"""Seconds that are drawn. In a longer part the texture would not be visible."""


@dataclass(frozen=True)
class Demonstrated:
    """The recorded and the decoded signal, [ticks] each, in ``unit``; NaN where there is a gap.

    lf: the decoded slow part; half: half the width of the deadband around it; knots: ticks of its
    support points; sizes: name and bytes of files that hold the same recording, and of the
    recording itself, which comes first.
    """

    original: NDArray[Any]
    lf: NDArray[Any]
    decoded: NDArray[Any]
    half: NDArray[Any]
    knots: NDArray[Any]
    rate_hz: float
    sizes: Sequence[tuple[str, int]]
    unit: str = "N"
    quantity: str = "force"
    title: str = ""

    def check(self) -> None:
        parts = (self.original, self.lf, self.decoded, self.half)
        size = self.original.size
        if not size or any(part.shape != (size,) for part in parts):
            raise ParameterError("A picture needs arrays of one length with at least one sample")
        if not self.rate_hz > 0:
            raise ParameterError("A picture needs a positive rate")


def plot_demo(
    path: str | Path, shown: Demonstrated, *, start_s: float | None = None, force: bool = False
) -> None:
    """Draw the page into ``path`` (.png, .svg, .pdf). start_s: where the part of SHOWN_S begins;
    None: shortly before the signal first moves."""
    kind = kind_of(path)
    shown.check()
    ticks = shown.original.size
    length = min(ticks, max(round(SHOWN_S * shown.rate_hz), 2))
    if start_s is None:
        start = max(first_move(shown.original) - length // 8, 0)
    else:
        start = round(start_s * shown.rate_hz)
    start = min(start, ticks - length)
    if start < 0:
        raise ParameterError("The part to draw lies outside the recording")
    view = slice(start, start + length)

    figure = new_figure(8.6, 4.9)
    grid = figure.add_gridspec(
        3, 2, height_ratios=(3.2, 1.3, 1.3), width_ratios=(1.8, 1), left=0.075, right=0.985,
        top=0.815, bottom=0.105, hspace=0.42, wspace=0.12,
    )  # fmt: skip
    whole, below, lowest = (figure.add_subplot(grid[row, 0]) for row in range(3))
    signals(whole, shown, view)
    residual, error = shown.decoded - shown.lf, shown.decoded - shown.original
    reach = 1.1 * max(largest(residual[view]), largest(error[view])) or 1.0
    seconds = np.arange(view.start, view.stop) / shown.rate_hz
    for axes, values, label in ((below, residual, "residual (HF)"), (lowest, error, "error")):
        axes.plot(seconds, values[view], color=PALETTE[label], lw=1.1, label=label)
        axes.set_ylim(-reach, reach)
    unit = plain(shown.unit)
    scale = Scale.of(shown.unit, largest(error))
    if not residual.any():
        instead(below, "no residual")
    style(below, "2  Residual: the texture, quantised", "", unit, size=9.5)
    worst = scale.amount(largest(error))
    style(lowest, f"3  Error of what comes back, same scale: at most {worst}", "time in s", unit,
          size=9.5)  # fmt: skip
    for axes in (whole, below, lowest):
        axes.set_xlim(seconds[0], seconds[-1] + 1 / shown.rate_hz)
        axes.tick_params(labelbottom=axes is lowest, labelsize=8.5)
        axes.locator_params(axis="y", nbins=5 if axes is whole else 3)
    figure.align_ylabels((whole, below, lowest))
    bars(figure.add_subplot(grid[:, 1]), shown.sizes)
    handles, labels = whole.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="upper left", bbox_to_anchor=(0.01, 0.935), ncols=len(labels),
        frameon=False, fontsize=9, handlelength=1.6, columnspacing=1.3,
    )  # fmt: skip
    if shown.title:
        figure.text(
            0.02, 0.985, plain(shown.title), va="top", fontsize=12, color=INK, fontweight="bold"
        )
    save([figure], path, kind, force=force)


def signals(axes: Axes, shown: Demonstrated, view: slice) -> None:
    seconds = np.arange(view.start, view.stop) / shown.rate_hz
    f, d, half = shown.original[view], shown.lf[view], shown.half[view]
    axes.fill_between(
        seconds, d - half, d + half, color=PALETTE["deadband"], alpha=0.6, lw=0, label="deadband"
    )
    axes.plot(seconds, f, color=SIGNAL, lw=1.3, label="signal")
    axes.plot(seconds, d, color=PALETTE["slow part (LF)"], lw=1.8, label="slow part (LF)")
    knots = np.asarray(shown.knots, dtype=np.int64)
    near = knots[(knots >= view.start) & (knots < view.stop)]
    axes.plot(
        near / shown.rate_hz, shown.lf[near], "o", color=PALETTE["knots"], ms=4.5, mec=INK,
        mew=0.7, label="knots",
    )  # fmt: skip
    known = np.concatenate([f[np.isfinite(f)], d[np.isfinite(d)]])
    if known.size:
        low, high = float(known.min()), float(known.max())
        margin = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
        axes.set_ylim(low - margin, high + margin)
    style(axes, f"1  Slow part: {near.size} knots instead of {f.size} samples", "",
          named(plain(shown.quantity), plain(shown.unit)), size=9.5)  # fmt: skip


def bars(axes: Axes, sizes: Sequence[tuple[str, int]]) -> None:
    """Bytes of files, the name above each bar, and how much smaller than the first."""
    most = max((size for _, size in sizes), default=1)
    for place, (name, size) in enumerate(sizes):
        axes.barh(place, size, height=0.42, color=GREY if place == 0 else DIM)
        text = f"{size / 1000:.3g} kB"
        if place:
            text += f" · {most / size:.1f} times smaller"
        inside = size > 0.5 * most
        axes.annotate(
            text, (size, place), xytext=(-5 if inside else 5, 0), textcoords="offset points",
            ha="right" if inside else "left", va="center", fontsize=8.5,
            color="white" if inside else INK,
        )  # fmt: skip
        axes.annotate(
            plain(name), (0, place - 0.25), xytext=(0, 2), textcoords="offset points", ha="left",
            va="bottom", fontsize=9, color=INK,
        )  # fmt: skip
    axes.set_ylim(len(sizes) - 0.5, -0.75)
    axes.set_xlim(0, most)
    axes.set_xticks([])
    axes.set_yticks([])
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.spines["left"].set_color(LINES)
    axes.set_title("4  Size of the file", loc="left", fontsize=9.5, color=INK, fontweight="bold")


def first_move(x: NDArray[Any]) -> int:
    """Tick at which the signal first leaves its beginning by a twentieth of its range."""
    known = x[np.isfinite(x)]
    if not known.size:
        return 0
    reach = float(known.max() - known.min())
    moved = np.abs(x - known[0]) > 0.05 * reach
    return int(np.argmax(moved)) if moved.any() else 0


def largest(x: NDArray[Any]) -> float:
    known = x[np.isfinite(x)]
    return float(np.max(np.abs(known), initial=0.0))


ROWS = 4
"""Up to this many channels, each has a row with a histogram."""
SMALL = 32
"""Largest number of channels on one page."""
NAMES = 8
"""Largest number of identical channels that are named."""


def pages(found: Sequence[Comparison], views: Sequence[ChannelView], words: Words) -> list[Figure]:
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


def rows(views: Sequence[ChannelView], verdicts: dict[int, Comparison], words: Words) -> Figure:
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


def multiples(
    views: Sequence[ChannelView], verdicts: dict[int, Comparison], words: Words
) -> Figure:
    columns, count = grid_shape(len(views))
    sheet = Sheet(max(4.6 * columns, 9), max(1.9, min(2.4, 9 / count)) * count, words, left=0.95)
    grid = sheet.grid(count, columns, 0.45, 0.85)
    shared = one_unit(views)
    for view, row, column, last in placed(views, columns):
        pair(sheet.figure, grid[row, column], view, verdicts, last=last, unit=not shared)
    return sheet.finish(shared)


def pair(
    figure: Figure, place: SubplotSpec, view: ChannelView, verdicts: dict[int, Comparison], *,
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


def headline(view: ChannelView, row: Comparison) -> str:
    name = plain(view.channel.name)
    if row.identical:
        return f"{name}: identical"
    said = f"largest {amount(view, row.largest)}, rms {amount(view, row.rms)}"
    missing = row.only_a + row.only_b
    return f"{name}: {said}" + (f", {counted(missing, 'sample')} in one only" if missing else "")


LOOKS = tuple(zip(SERIES, "os^Dv", strict=True))
"""Colours and marks of the lines; the marks distinguish them without colour."""
ASIDE = 0.012
"""Distance of neighbouring lines as a share of the width, so that error bars do not overlap."""
BAR = {"capsize": 3, "elinewidth": 1.1, "ms": 6, "lw": 1.4, "mec": "white", "mew": 0.7}


class PlottedMean(Protocol):
    @property
    def mean(self) -> float: ...

    @property
    def half(self) -> float | None:
        """Half the confidence interval; None for a single rating."""


class Opinion(Protocol):
    """A condition and its ratings, from 0 to 100."""

    @property
    def condition(self) -> str: ...

    @property
    def role(self) -> str:
        """test, reference or anchor."""

    @property
    def k(self) -> Any: ...

    @property
    def bits(self) -> int | None: ...

    @property
    def rating(self) -> PlottedMean: ...


def plot_opinions(
    path: str | os.PathLike[str],
    rows: Sequence[Opinion],
    *,
    scale: Sequence[str],
    title: str = "",
    force: bool = False,
) -> None:
    """Draw the rows into ``path`` (.png, .svg, .pdf); ``scale``: words for its fifths, lowest
    first."""
    kind = kind_of(path)
    if not rows:
        raise ParameterError("No opinions to draw")
    grid = is_grid(rows)
    figure = new_figure(8.5 if grid else min(3 + 0.8 * len(rows), 16), 5.2, layout="constrained")
    axes = figure.add_subplot()
    if grid:
        draw_grid(axes, rows)
    else:
        draw_side_by_side(axes, rows)
    style(axes, plain(title), "deadband k in %" if grid else "", "mean opinion, 0 to 100")
    axes.set_ylim(-2, 102)
    axes.set_yticks([100 * n / len(scale) for n in range(len(scale) + 1)])
    for n, word in enumerate(scale):
        axes.annotate(
            plain(word),
            (1, 100 * (n + 0.5) / len(scale)),
            xycoords=("axes fraction", "data"),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            color=INK,
        )
    save([figure], path, kind, force=force)


def is_grid(rows: Sequence[Opinion]) -> bool:
    """Whether every tested condition has its k and bits, and there is a k to compare with."""
    tests = [row for row in rows if row.role == "test"]
    return (
        all(isinstance(row.k, (int, float)) and row.bits is not None for row in tests)
        and len({row.k for row in tests}) > 1
        and len({(row.k, row.bits) for row in tests}) == len(tests)
    )


def draw_grid(axes: Axes, rows: Sequence[Opinion]) -> None:
    tests = [row for row in rows if row.role == "test"]
    numbers = sorted({row.bits for row in tests if row.bits is not None}, reverse=True)
    places = sorted({100 * float(row.k) for row in tests})
    width = places[-1] - places[0]
    for n, bits in enumerate(numbers):
        line = sorted((row for row in tests if row.bits == bits), key=lambda row: float(row.k))
        colour, mark = LOOKS[n % len(LOOKS)]
        axes.errorbar(
            [100 * float(r.k) + ASIDE * width * (n - (len(numbers) - 1) / 2) for r in line],
            [r.rating.mean for r in line],
            [r.rating.half or 0 for r in line],
            color=colour,
            marker=mark,
            label=f"{bits} bits" if bits else "no residual",
            **BAR,  # type: ignore[arg-type]
        )
    for row in rows:
        if row.role != "test":
            draw_level(axes, row)
    axes.set_xticks(places, [f"{place:g}" for place in places])
    axes.set_xlim(places[0] - 0.2 * width, places[-1] + 0.12 * width)
    axes.legend(
        loc="lower right", bbox_to_anchor=(1, 1), ncols=6, frameon=False, fontsize=9, borderpad=0
    )


def draw_level(axes: Axes, row: Opinion) -> None:
    """A line across for the reference or an anchor, and its interval."""
    mean, half = row.rating.mean, row.rating.half or 0
    axes.axhspan(mean - half, mean + half, color=GREY, alpha=0.2, lw=0, zorder=0)
    axes.axhline(mean, color=GREY, lw=1.2, ls=(0, (5, 3)), zorder=1)
    axes.annotate(
        plain(row.condition),
        (0, mean),
        xycoords=("axes fraction", "data"),
        xytext=(4, 3),
        textcoords="offset points",
        fontsize=8.5,
        color=INK,
    )


def draw_side_by_side(axes: Axes, rows: Sequence[Opinion]) -> None:
    colours = {"reference": INK, "anchor": GREY}
    for n, row in enumerate(rows):
        axes.errorbar(
            [n],
            [row.rating.mean],
            [row.rating.half or 0],
            color=colours.get(row.role, SERIES[0]),
            marker="s" if row.role in colours else "o",
            **BAR,  # type: ignore[arg-type]
        )
    axes.set_xticks(range(len(rows)), [plain(row.condition) for row in rows])
    axes.tick_params(axis="x", rotation=30 if len(rows) > 4 else 0)
    for label in axes.get_xticklabels():
        label.set_horizontalalignment("right" if len(rows) > 4 else "center")
    axes.set_xlim(-0.6, len(rows) - 0.4)
