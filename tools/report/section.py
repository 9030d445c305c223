"""What a section of the report is. A module X.py here with ``section(options) -> Section`` is one.

Modules of this folder are imported as ``report.X``, tools as ``measured``, ``results`` ... Figures
need matplotlib: where it is missing ``drawn`` gives a figure without a picture, and says so.
"""

from __future__ import annotations

import io
import re
import statistics
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

Result = TypeVar("Result")
Cell = str | int | float | bool | None

INK = "#123456"
"""Drawn in this colour, a line or a letter has the colour of the page's text, light or dark."""

PALE = "#654321"
"""The same, for axes, grids and limits, which should be less visible."""

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8b6fd6", "#7f7f7f")
"""Colours that most people can distinguish, on white and on black.

M. Okabe, K. Ito, "Color universal design", 2008,
without its black and its yellow; then a violet and a grey."""

MARKERS = "osD^vPX*"
"""One for each colour, so that print without colour tells them apart."""


class Table(NamedTuple):
    """rows: numbers as numbers, since the page sorts by them and CSV keeps all digits; the page and
    the Markdown show four. None is an empty cell."""

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[Cell]]


class Figure(NamedTuple):
    """svg: an ``<svg>`` element, or "" where it could not be drawn. By ``drawn``, or own; its ids
    need be unique only within it."""

    title: str
    caption: str
    svg: str


class Section(NamedTuple):
    """text: Markdown (paragraphs, "* " lists, **bold**, `code`); its first sentence is the
    result, made from the data. data: JSON, whatever a program would want."""

    title: str
    text: str
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    data: Any = None


class Options(NamedTuple):
    """data: a folder of recordings, or None. quick: seconds in place of minutes. progress: a line
    for the one who waits. write: tables of the pages are renewed."""

    data: Path | None = None
    quick: bool = False
    out: Path = Path("report")
    progress: Callable[[str], None] = lambda _line: None
    write: bool = False


class CannotRunError(Exception):
    """Raised by a section that cannot run; the page shows its text instead."""


class Spread(NamedTuple):
    """Times of repeated runs, in seconds."""

    median: float
    low: float
    high: float
    runs: int

    def __str__(self) -> str:
        return f"{self.median:.3g} ({self.low:.3g}-{self.high:.3g})"


def spread(seconds: Sequence[float]) -> Spread:
    """Median and quartiles, of fewer than three runs all there is."""
    middle = statistics.median(seconds)
    if len(seconds) < 3:
        return Spread(middle, min(seconds), max(seconds), len(seconds))
    low, _, high = statistics.quantiles(seconds, n=4, method="inclusive")
    return Spread(middle, low, high, len(seconds))


def timed(work: Callable[[], Result], repeats: int = 5) -> tuple[Result, Spread]:
    """The result of the work, and the CPU times of the runs."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        result = work()
        times.append(time.process_time() - began)
    return result, spread(times)


def drawn(
    title: str, caption: str, draw: Callable[[Any], None],
    *, width: float = 7.5, height: float = 4.2, panels: tuple[int, int] = (1, 1), **shared: Any,
) -> Figure:  # fmt: skip
    """A figure by matplotlib: ``draw`` gets the axes, of more panels than one their array.

    Sizes in inches of 72 points. shared: of ``subplots``, sharex and sharey.
    """
    try:
        figures, matplotlib = import_module("matplotlib.figure"), import_module("matplotlib")
    except ImportError:
        return Figure(title, f"{caption} (No picture: pip install 'hapfmt[plot]'.)", "")
    with matplotlib.rc_context(style()):
        figure = figures.Figure(figsize=(width, height), layout="constrained")
        draw(figure.subplots(*panels, **shared))
        stream = io.StringIO()
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    return Figure(title, caption, inline(stream.getvalue()))


def style() -> dict[str, Any]:
    """Ink of the page's own colour, letters that stay letters."""
    cycler = import_module("cycler").cycler
    inked = ("text.color", "axes.labelcolor", "axes.titlecolor")
    pale = ("axes.edgecolor", "xtick.color", "ytick.color", "grid.color")
    return {
        **dict.fromkeys(inked, INK),
        **dict.fromkeys(pale, PALE),
        "xtick.labelcolor": INK,
        "ytick.labelcolor": INK,
        "legend.labelcolor": INK,
        "legend.frameon": False,
        "legend.fontsize": 9,
        "axes.grid": True,
        "grid.alpha": 0.35,
        "grid.linewidth": 0.6,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlesize": 10,
        "axes.titlelocation": "left",
        "axes.prop_cycle": cycler(color=COLOURS) + cycler(marker=list(MARKERS)),
        "font.size": 10,
        "lines.markersize": 5,
        "lines.linewidth": 1.4,
        "svg.fonttype": "none",
        "svg.hashsalt": "hapfmt",
    }


def inline(text: str) -> str:
    """The ``<svg>`` element alone, its ink the page's, as wide as the page lets it be."""
    element = text[text.index("<svg") :]
    element = re.sub(r"<metadata>.*?</metadata>", "", element, count=1, flags=re.DOTALL)
    element = re.sub(r'<svg([^>]*?) width="[^"]*"', r"<svg\1", element, count=1)
    element = re.sub(r'<svg([^>]*?) height="[^"]*"', r"<svg\1", element, count=1)
    element = re.sub(r"<style.*?</style>", "", element, count=1, flags=re.DOTALL)  # page.py has it
    element = re.sub(r"(font-family: |font: [^;\"']*?)'[^;\"]*", r"\1sans-serif", element)
    return element.replace(INK, "currentColor").replace(PALE, "var(--pale, #888)").strip()
