"""One recording, its slow part and what comes back, on one page (PNG, SVG or PDF).

Takes plain arrays, so that it depends on no reader and no writer. matplotlib is imported when a
picture is drawn, through its object interface only: no window, no global state.
"""

from __future__ import annotations

from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ParameterError
from .style import DAMAGE as ORANGE
from .style import GREY, INK, kind_of, new_figure, save, style
from .style import SIGNAL as BLUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OUTLINE_POINTS = 4000
"""Points a line is thinned to, in pairs of least and greatest: one pair for half a pixel."""

KNOT_MARKS = 600
"""Above this many knots in view dots would hide the line, and only their number is shown."""

ZOOM_S = 0.2
BIN_COUNT = 81
"""Bins of a histogram, or fewer: one for each count where the errors are whole counts."""


def plot_demo(
    path: str | Path,
    *,
    original: NDArray[Any],
    lf: NDArray[Any],
    reconstruction: NDArray[Any],
    lower: NDArray[Any],
    upper: NDArray[Any],
    rate_hz: float,
    knots: NDArray[Any],
    error_bound: float | None = None,
    zoom_start_s: float | None = None,
    start_s: float = 0.0,
    unit: str = "N",
    quantity: str = "force",
    title: str = "",
    force: bool = False,
) -> None:
    """Draw the page into ``path``; its suffix (.png, .svg, .pdf) says the kind.

    original, lf, reconstruction
        [ticks] each, in ``unit``: f, the decoded slow part d, and what comes back. NaN where there
        is a gap.
    lower, upper
        [ticks], in ``unit``: the deadband around d. Half its width is the unit of one histogram.
    knots
        ticks of the knots, integers, counted from the first sample.
    error_bound
        in ``unit``, what no error may pass: half a step of the residual's quantiser. None: no mark.
    zoom_start_s
        where the 0.2 s of the second panel begin; None: around the knot nearest to the middle.
    start_s
        time of the first sample.
    """
    kind = kind_of(path)
    parts = (original, lf, reconstruction, lower, upper)
    f, d, y, low, high = (np.asarray(part, dtype=np.float64) for part in parts)
    if f.ndim != 1 or not f.size or any(part.shape != f.shape for part in (d, y, low, high)):
        raise ParameterError("a picture needs five arrays [ticks] of one length, not empty")
    if not rate_hz > 0:
        raise ParameterError("a picture needs a positive rate")
    time = start_s + np.arange(f.size, dtype=np.float64) / rate_hz
    ticks = np.asarray(knots, dtype=np.int64)
    figure = new_figure(11, 8.5, layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(3, 3, 2.2))
    whole = figure.add_subplot(grid[0, :])
    zoom = figure.add_subplot(grid[1, :])
    error_axes = figure.add_subplot(grid[2, 0]), figure.add_subplot(grid[2, 1])

    end = time[-1] + 1 / rate_hz
    width = min(ZOOM_S, end - start_s)
    if zoom_start_s is None:
        middle = ticks[np.argmin(np.abs(ticks - f.size // 2))] if ticks.size else f.size // 2
        begin = float(np.clip(time[middle] - width / 2, start_s, end - width))
    else:
        begin = zoom_start_s
    view = slice(*np.searchsorted(time, [begin, begin + width]).tolist())
    if view.stop - view.start < 1:
        raise ParameterError("the zoomed part lies outside of the recording")

    _signals(whole, (time, f, d, y, low, high), ticks)
    whole.set_xlim(start_s, end)
    whole.axvspan(begin, begin + width, color=GREY, alpha=0.25, lw=0, zorder=0)
    near = ticks[(ticks >= view.start) & (ticks < view.stop)] - view.start
    _signals(zoom, tuple(part[view] for part in (time, f, d, y, low, high)), near)
    zoom.set_xlim(begin, begin + width)
    for axes, name in ((whole, "recording"), (zoom, f"{1000 * width:.0f} ms of it")):
        style(axes, name, "time in s", f"{quantity} in {unit}")
    whole.legend(
        loc="lower right", bbox_to_anchor=(1, 1), ncols=5, frameon=False, fontsize=9, borderpad=0
    )

    known = np.isfinite(y - f)
    missed, half = (y - f)[known], (high - low)[known] / 2
    relative = np.divide(missed, half, out=np.zeros(half.size), where=half > 0)
    _histogram(error_axes[0], missed, error_bound, "half a step", unit)
    style(error_axes[0], "error of the reconstruction", error_axes[0].get_xlabel(), "samples")
    _histogram(error_axes[1], relative, 1.0, "deadband", "")
    style(error_axes[1], "the same in deadbands", "error / half width", "samples")

    if title:
        figure.suptitle(title, fontsize=13, color=INK, x=0.01, ha="left")
    save([figure], path, kind, force=force)


def _signals(axes: Axes, parts: tuple[NDArray[np.float64], ...], ticks: NDArray[np.int64]) -> None:
    time, f, d, y, low, high = parts
    at, bottom, _ = _outline(time, low)
    _, _, top = _outline(time, high)
    axes.fill_between(at, bottom, top, color=BLUE, alpha=0.16, lw=0, label="deadband")
    axes.plot(*_line(time, f), color=GREY, lw=3, solid_capstyle="round", label="original")
    axes.plot(*_line(time, y), color=ORANGE, lw=0.9, label="reconstruction")
    axes.plot(*_line(time, d), color=BLUE, lw=1.5, label="slow part, decoded")
    if ticks.size <= KNOT_MARKS:
        axes.plot(
            time[ticks], d[ticks], "o", color=BLUE, ms=4.5, mec="white", mew=0.7, label="knots"
        )
    else:
        axes.plot([], [], "o", color=BLUE, ms=4.5, label=f"{ticks.size} knots")
    axes.margins(y=0.08)


def _histogram(
    axes: Axes, error: NDArray[np.float64], bound: float | None, name: str, unit: str
) -> None:
    largest = max(float(np.max(np.abs(error), initial=0.0)), bound or 0.0)
    milli = bool(unit) and 0 < largest < 0.1
    factor = 1000 if milli else 1
    reach = 1.15 * factor * largest or 1.0
    values = np.unique(np.round(factor * error / reach, 9)) * reach
    width = 2 * reach / BIN_COUNT
    if 2 <= values.size <= BIN_COUNT:
        width = max(width, float(np.diff(values).min()))
    side = ceil(reach / width)
    edges = (np.arange(2 * side + 2) - side - 0.5) * width
    heights, _, _ = axes.hist(
        factor * error, bins=edges.tolist(), color=ORANGE, alpha=0.85, rwidth=0.9
    )
    if bound:
        for sign in (-1, 1):
            axes.axvline(sign * factor * bound, color=INK, lw=1.1, ls=(0, (4, 3)))
        axes.annotate(
            name,
            (factor * bound, 0.93),
            xycoords=("data", "axes fraction"),
            xytext=(-5, 0),
            textcoords="offset points",
            ha="right",
            fontsize=8.5,
            color=INK,
            bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1},
        )
    axes.set_xlim(-reach, reach)
    axes.set_ylim(0, 1.2 * float(np.max(heights)) or 1)
    axes.set_xlabel(f"error in {'m' if milli else ''}{unit}")


def _outline(
    time: NDArray[np.float64], x: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Time, least and greatest of x in at most OUTLINE_POINTS / 2 equal pieces of [ticks]."""
    size = -(-2 * x.size // OUTLINE_POINTS)
    if size < 3:
        return time, x, x
    starts = np.arange(0, x.size, size)
    return time[starts], np.minimum.reduceat(x, starts), np.maximum.reduceat(x, starts)


def _line(
    time: NDArray[np.float64], x: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x as a line that looks the same in print, with at most OUTLINE_POINTS points."""
    at, least, most = _outline(time, x)
    if at.size == x.size:
        return at, x
    return np.repeat(at, 2), np.stack([least, most], axis=1).ravel()
