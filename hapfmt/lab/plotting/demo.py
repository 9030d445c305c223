"""One page that shows what the format does: slow part, residual, error, file sizes.

Takes plain arrays, so that it depends on no reader and no writer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ParameterError
from .panels import DIM, instead, named
from .style import GREY, INK, LINES, PALETTE, SIGNAL, Scale, kind_of, new_figure, plain, save, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
