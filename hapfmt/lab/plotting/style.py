"""What all pictures share: colours, axes, files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from math import ceil, inf, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from ...atomic import refuse, target
from ...errors import MissingExtraError, ParameterError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

INK, GREY, LINES = "#22272e", "#8b949e", "#d8dee4"
"""Text and limits; frames; grid lines."""

SIGNAL, DECODED, LF, HF = "#0072b2", "#000000", "#e69f00", "#009e73"
ERROR, DEADBAND, DAMAGE, GAP = "#cc79a7", "#f0e442", "#a50021", "#c3c9d0"
"""One meaning for each colour, in every panel of every picture. The palette stays distinct for
colour-blind readers: M. Okabe, K. Ito, "Color Universal Design", 2008. Its vermilion resembles the
orange of knots, so damage is dark red."""

PALETTE = {
    "signal": SIGNAL,
    "original": SIGNAL,
    "A": SIGNAL,
    "decoded": DECODED,
    "B": DECODED,
    "slow part (LF)": LF,
    "knots": LF,
    "residual (HF)": HF,
    "error": ERROR,
    "difference B − A": ERROR,
    "deadband": DEADBAND,
    "gap": GAP,
    "gap in A": GAP,
    "gap in B": GAP,
    "lost to damage": DAMAGE,
    "event": INK,
    "error bound": INK,
}
"""Colours by the words of the legend."""

SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9")
"""Colours of compared lines in pictures without a signal."""

DASHES = (0, (4, 3))
"""Line style of bounds."""

KINDS: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}
"""Metadata left out, since it would make two pictures of the same data differ (in an SVG ids still
do)."""

LONGEST = 60
"""Longest label; a longer one would overlap its neighbour."""

PREFIXED = frozenset({"N", "m", "m/s", "m/s2", "m/s^2", "m/s²", "V", "A", "Pa", "N.m", "N·m", "Nm"})
"""Units that may get a prefix such as m; with other units it could be misread."""


class Scale(NamedTuple):
    """Factor from the unit of a channel to the unit shown, and its name."""

    factor: float
    unit: str

    @classmethod
    def of(cls, unit: str, largest: float) -> Scale:
        """Chooses a prefix that makes ``largest`` readable: 0.002 N is 2 mN."""
        name = plain(unit.strip("{}"))
        name = "" if name == "1" else name
        if name in PREFIXED:
            for factor, prefix in ((1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n")):
                if largest * factor >= 0.1 or not largest:
                    return cls(factor, prefix + name)
        return cls(1.0, name)

    def amount(self, value: float) -> str:
        return f"{value * self.factor:.3g} {self.unit}".rstrip()


def kind_of(path: str | os.PathLike[str]) -> str:
    """png, svg or pdf, by the suffix."""
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in KINDS:
        known = ", ".join(f".{kind}" for kind in KINDS)
        raise ParameterError(f"Pictures are {known}, not {Path(path).name!r}")
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
) -> list[str]:
    """Write all pages; returns the paths. A PDF takes any number, else each page gets a file of its
    own: x-1.png, x-2.png. A path appears whole or not at all."""
    with warnings.catch_warnings():
        # A label in a script that the font has not is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        if kind == "pdf":
            from matplotlib.backends.backend_pdf import PdfPages

            with (
                target(file, force) as stream,
                PdfPages(stream, metadata=KINDS[kind]) as pages,
            ):
                for figure in figures:
                    pages.savefig(figure)
            return names_of(file)
        if len(figures) == 1:
            with target(file, force) as stream:
                figures[0].savefig(stream, format=kind, metadata=KINDS[kind])
            return names_of(file)
        if not isinstance(file, (str, os.PathLike)):
            raise ParameterError(
                f"The picture has {len(figures)} pages, and a pipe takes one of {kind}. "
                "Use --output-format pdf, or select fewer channels with --channels."
            )
        path = Path(file)
        names = [
            str(path.with_name(f"{path.stem}-{number}{path.suffix}"))
            for number in range(1, len(figures) + 1)
        ]
        for name in names:
            refuse(name, force)
        with ExitStack() as stack:
            for name, figure in zip(names, figures, strict=True):
                stream = stack.enter_context(target(name, force))
                figure.savefig(stream, format=kind, metadata=KINDS[kind])
        return names


def names_of(file: str | os.PathLike[str] | BinaryIO) -> list[str]:
    return [os.fspath(file)] if isinstance(file, (str, os.PathLike)) else []


def plain(text: str) -> str:
    """A text from a file as it is drawn: no formulas, nothing that cannot be printed, not long."""
    shown = printable(text)
    if len(shown) > LONGEST:
        shown = shown[: LONGEST - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return unformatted(shown)


def printable(text: str) -> str:
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def unformatted(text: str) -> str:
    """matplotlib reads what is between two $ as a formula."""
    return text.replace("\\", "\\\\").replace("$", r"\$") if "$" in text else text


def style(axes: Axes, name: str, x_label: str, y_label: str, *, size: float = 10) -> None:
    axes.set_title(name, loc="left", fontsize=size, color=INK, fontweight="bold", pad=4)
    axes.set_xlabel(x_label, fontsize=9, color=INK)
    axes.set_ylabel(y_label, fontsize=9, color=INK)
    axes.tick_params(labelsize=8.5, colors=INK, length=3)
    whole_ticks(axes.xaxis)
    whole_ticks(axes.yaxis)
    axes.grid(color=LINES, lw=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GREY)


def whole_ticks(axis: Axis) -> None:
    """Writes very small, very large and close values in full at each tick. matplotlib would put
    their common factor or offset above the axis, where it overlaps the panel next to it."""
    low, high = axis.get_view_interval()
    largest, extent = max(abs(low), abs(high)), abs(high - low)
    if axis.get_scale() != "linear" or not 0 < extent < inf:
        return
    if 1e-3 <= largest < 1e6 and extent > 1e-3 * largest:
        return
    digits = ceil(log10(largest / extent)) + 3

    def text(value: float, _: float) -> str:
        return "0" if abs(value) < 1e-6 * extent else f"{value:.{digits}g}".replace("-", "\u2212")

    axis.set_major_formatter(text)
