"""What all pictures share: colours, axes, files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from ..atomic import target
from ..errors import MissingExtraError, ParameterError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GREY, BLUE, ORANGE = "#22272e", "#8b949e", "#1f5fa8", "#d9570d"
"""Blue and orange stay apart for colour-blind readers, and in grey print."""
LINES = "#d0d7de"

KINDS: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}
"""Metadata left out, since it would make two pictures of the same data differ (in an SVG ids still
do)."""

LONGEST = 60
"""Characters of a label; what is longer would run into its neighbour."""


def kind_of(path: str | os.PathLike[str]) -> str:
    """png, svg or pdf, by the suffix."""
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in KINDS:
        known = ", ".join(f".{kind}" for kind in KINDS)
        raise ParameterError(f"pictures are written as {known}, not {Path(path).name!r}")
    return kind


def new_figure(width: float, height: float, *, layout: Any = None) -> Figure:
    """An empty page of so many inches, or MissingExtraError."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("matplotlib", "plot") from error
    return Figure(figsize=(width, height), dpi=120, layout=layout, facecolor="white")


def save(
    figures: Sequence[Figure],
    file: str | os.PathLike[str] | BinaryIO,
    kind: str,
    *,
    force: bool = False,
) -> None:
    """Write the pages: a PDF takes any number. A path appears whole or not at all."""
    if len(figures) != 1 and kind != "pdf":
        raise ParameterError("only a PDF has pages")
    with target(file, force) as stream, warnings.catch_warnings():
        # A label in a script that the font has not is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        if kind != "pdf":
            figures[0].savefig(stream, format=kind, metadata=KINDS[kind])
            return
        from matplotlib.backends.backend_pdf import PdfPages

        with PdfPages(stream, metadata=KINDS[kind]) as pages:
            for figure in figures:
                pages.savefig(figure)


def plain(text: str) -> str:
    """A text from a file as it is drawn: no formulas, nothing that cannot be printed, not long."""
    shown = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    if len(shown) > LONGEST:
        shown = shown[: LONGEST - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return shown.replace("\\", "\\\\").replace("$", r"\$") if "$" in shown else shown


def style(axes: Axes, name: str, x_label: str, y_label: str) -> None:
    axes.set_title(name, loc="left", fontsize=10, color=INK, fontweight="bold")
    axes.set_xlabel(x_label, fontsize=9, color=INK)
    axes.set_ylabel(y_label, fontsize=9, color=INK)
    axes.tick_params(labelsize=8.5, colors=INK, length=3)
    axes.grid(color=LINES, lw=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GREY)
