"""What subjects said of conditions, as in Fig. 5 of Brandi, Chaudhari and Steinbach (2011): mean
opinion over the deadband k, one line for each number of bits; or side by side, where the conditions
are no such grid."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from ...errors import ParameterError
from .style import GREY, INK, SERIES, kind_of, new_figure, plain, save, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOOKS = tuple(zip(SERIES, "os^Dv", strict=True))
"""Colours and marks of the lines; the marks distinguish them without colour."""
ASIDE = 0.012
"""Distance of neighbouring lines as a share of the width, so that error bars do not overlap."""
BAR = {"capsize": 3, "elinewidth": 1.1, "ms": 6, "lw": 1.4, "mec": "white", "mew": 0.7}


class Mean(Protocol):
    @property
    def mean(self) -> float: ...

    @property
    def half(self) -> float | None:
        """Half the confidence interval; None for a single rating."""


class Opinion(Protocol):
    """A condition and what was said of it, from 0 to 100."""

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
    def rating(self) -> Mean: ...


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
    """Of the reference or an anchor: a line across, and its interval."""
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
