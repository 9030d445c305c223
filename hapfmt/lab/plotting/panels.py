"""Panels of a page: each draws one view of a channel in one pair of axes.

Also shared by all pictures: colours, axes and output files.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from math import ceil, inf, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from ...errors import MissingExtraError, ParameterError
from ...files import refuse, target
from ...recording import Event
from ..views import SHOWN, ChannelView, Histogram, Outline

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
    """An empty page; sizes in inches. MissingExtraError without matplotlib."""
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
    # A given height spares matplotlib the search for one, a third of the time of drawing.
    axes.set_title(name, loc="left", y=1, fontsize=size, color=INK, fontweight="bold", pad=4)
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


DIM = "#57606a"
NAME = 24
"""Characters of a label that fit next to an axis."""
GAPS_HATCHED = 100
STRIP = 0.04
"""Height of the strip of more gaps than these, relative to the panel."""
EVENTS_NAMED = 10
"""Texts of more events would hide the signal and each other."""
POINTS = 60
"""Up to this number of samples, each gets a marker."""
MARGIN = 0.08
"""Space above and below the signal, as a share of its range."""
BESIDE = 0.5
"""The axis extends to the slow part by up to this share of the signal's range."""


class TimeUnit(NamedTuple):
    seconds: float
    name: str

    @classmethod
    def of(cls, seconds: float) -> TimeUnit:
        if seconds >= 3 * 3600:
            return cls(3600.0, "h")
        if seconds >= 600:
            return cls(60.0, "min")
        return cls(1.0, "s") if seconds >= 0.1 else cls(1e-3, "ms")


def unit_of(view: ChannelView) -> str:
    """The unit as it is drawn; blank if there is none."""
    unit = view.channel.unit.strip("{}")
    return "" if unit in ("", "1") else plain(unit)


def named(what: str, unit: str) -> str:
    return f"{what} in {unit}" if what and unit else what or unit


def axis_label(view: ChannelView) -> str:
    """Quantity and unit of a channel, or its label and unit."""
    channel = view.channel
    quantity = plain(channel.quantity.replace("_", " "))
    if not quantity:
        quantity = plain(channel.name) if len(channel.name) <= NAME else "value"
    return named(quantity, unit_of(view))


def name_of(view: ChannelView) -> str:
    """Name of the whole band: 'signal' as recorded, 'decoded' from a lossy file."""
    return "decoded" if view.original is not None or view.is_lossy else "signal"


def signal(axes: Axes, view: ChannelView, unit: TimeUnit, *, width: float = 1.0) -> None:
    """Draws the channel over time with deadband, slow part and knots. width: of lines, below 1 in a
    small panel. The signal sets the limits: those of a wide deadband would flatten it."""
    seconds = unit.seconds
    if view.low is not None and view.high is not None:
        axes.fill_between(
            view.low.seconds() / seconds, view.low.least, view.high.most,
            color=PALETTE["deadband"], alpha=0.5, lw=0, label="deadband", zorder=1,
        )  # fmt: skip
    if view.original is not None:
        curve(axes, view.original, unit, 3.4 * width, "original")
    curve(axes, view.full, unit, 0.8 * width, name_of(view))
    if view.lf is not None:
        curve(axes, view.lf, unit, 1.8 * width, "slow part (LF)")
    most = SHOWN if width >= 1 else SHOWN // 10
    if view.knots is not None and 0 < view.knots.ticks.size <= most:
        axes.plot(
            view.knots.seconds / seconds, view.knots.values, "o",
            color=PALETTE["knots"], ms=3.6 * width + 1.2, mec=INK, mew=0.6, label="knots",
        )  # fmt: skip
    axes.set_ylim(*limits(view))
    axes.set_xlim(view.start / seconds, view.stop / seconds)
    if not np.isfinite(view.full.most).any():
        instead(axes, "no samples here" if not view.full.sample_count else "no finite value here")


def limits(view: ChannelView) -> tuple[float, float]:
    """Limits of the axis: the range of the signal, and of its slow part where that is close."""
    low, high = extremes([view.full, view.original])
    if low > high:
        return 0.0, 1.0
    if is_constant(view):
        # A constant in the middle of a range in which a small change would be seen.
        reach = max(0.05 * abs(low), 10 * (view.channel.lsb or 0.0)) or 1.0
        return low - reach, high + reach
    reach = high - low
    slow = extremes([view.lf])
    low = min(low, max(slow[0], low - BESIDE * reach))
    high = max(high, min(slow[1], high + BESIDE * reach))
    return low - MARGIN * reach, high + MARGIN * reach


def is_constant(view: ChannelView) -> bool:
    low, high = extremes([view.full, view.original])
    return high - low <= 1e-12 * max(abs(low), abs(high))


def extremes(outlines: Sequence[Outline | None]) -> tuple[float, float]:
    """Smallest and largest value of all outlines; (inf, -inf) if there is none."""
    low, high = np.inf, -np.inf
    for outline in outlines:
        known = None if outline is None else np.isfinite(outline.most)
        if outline is not None and known is not None and known.any():
            low = min(low, float(outline.least[known].min()))
            high = max(high, float(outline.most[known].max()))
    return low, high


def instead(axes: Axes, text: str) -> None:
    """Writes why a panel is empty."""
    axes.text(
        0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=8.5,
        color=DIM, zorder=6,
        bbox={"facecolor": "white", "alpha": 0.9, "edgecolor": "none", "pad": 1.5},
    )  # fmt: skip
    axes.set_yticks([])


def curve(
    axes: Axes, outline: Outline, unit: TimeUnit, width: float, name: str, factor: float = 1.0
) -> None:
    """Draws an outline as a line; ``name`` selects its colour from the palette."""
    at, y = outline.line()
    axes.plot(
        at / unit.seconds, factor * y, color=PALETTE[name], lw=width, solid_capstyle="round",
        # A sample between two gaps has no line; few samples are points.
        label=name, marker="." if lonely(outline.most) or at.size <= POINTS else "", ms=2 + width,
    )  # fmt: skip


def lonely(y: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    known = np.isfinite(y)
    beside = np.zeros(known.size + 2, np.bool_)
    beside[1:-1] = known
    return bool((known & ~beside[:-2] & ~beside[2:]).any())


def absences(axes: Axes, view: ChannelView, unit: TimeUnit, *, named: bool = True) -> None:
    """Hatches gaps, and frames and crosses damage. Many gaps are a strip at the bottom: hatches
    would cover the signal."""
    smallest = (view.stop - view.start) / 600
    partly = view.full.missing() & (view.full.counts > 0)
    is_sparse = len(view.gaps) + np.count_nonzero(partly) > GAPS_HATCHED
    height = STRIP if is_sparse else 1
    gaps = [wide(a, b, smallest) for a, b in view.gaps]
    spans(axes, gaps, unit, "gap", "" if is_sparse else "///", height)
    losses = [(*wide(loss.start, loss.stop, smallest), loss.what) for loss in view.losses]
    spans(axes, [loss[:2] for loss in losses], unit, "lost to damage", "xxx")
    if named and len(losses) <= EVENTS_NAMED:
        for a, b, what in losses:
            # If everything was lost, the legend says enough.
            if what != "all":
                note(axes, (a + b) / 2 / unit.seconds, 0.5, f"{what} lost", rotation=90)


def spans(
    axes: Axes,
    seconds: Sequence[tuple[float, float]],
    unit: TimeUnit,
    name: str,
    hatch: str,
    height: float = 1,
) -> None:
    """Hatches spans over this share of the height; ``name`` selects the colour from the
    palette."""
    if not seconds:
        return
    colour = PALETTE[name]
    axes.broken_barh(
        [(a / unit.seconds, (b - a) / unit.seconds) for a, b in seconds], (0, height),
        transform=axes.get_xaxis_transform(), facecolor=f"{colour}40", edgecolor=colour,
        hatch=hatch, lw=0 if colour == GAP else 0.8, zorder=0.5, label=name,
    )  # fmt: skip


def wide(start: float, stop: float, smallest: float) -> tuple[float, float]:
    """Widens a span that is too short to be seen."""
    more = max(smallest - (stop - start), 0.0) / 2
    return start - more, stop + more


def note(axes: Axes, x: float, y: float, text: str, **more: Any) -> None:
    """Writes a word on a white ground; y: share of the height."""
    axes.text(
        x, y, text, transform=axes.get_xaxis_transform(), color=INK, fontsize=8,
        ha="center", va="center", clip_on=True, zorder=6,
        bbox={"facecolor": "white", "alpha": 0.9, "edgecolor": "none", "pad": 1.2}, **more,
    )  # fmt: skip


def marks(
    axes: Axes, view: ChannelView, unit: TimeUnit, events: Sequence[Event], named: bool
) -> None:
    """Draws events of this channel and of all channels as lines, with texts if they are few."""
    own = [
        e
        for e in events
        if e.channel in (None, view.channel.number, view.channel.label)
        and float(e.time + e.duration) >= view.start
        and float(e.time) < view.stop
    ]
    for number, event in enumerate(own[:200]):
        start, stop = float(event.time), float(event.time + event.duration)
        if stop > start:
            axes.axvspan(start / unit.seconds, stop / unit.seconds, color=INK, alpha=0.07, lw=0)
        axes.axvline(
            max(start, view.start) / unit.seconds, color=PALETTE["event"], lw=0.9, ls=(0, (2, 2)),
            label="" if number else "event",
        )  # fmt: skip
        if named and len(own) <= EVENTS_NAMED and event.text:
            axes.annotate(
                plain(event.text), (max(start, view.start) / unit.seconds, 1.0),
                xycoords=("data", "axes fraction"), xytext=(3, -3), textcoords="offset points",
                ha="left", va="top", fontsize=8, color=INK, clip_on=True,
                bbox={"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 1},
            )  # fmt: skip


def residual(axes: Axes, view: ChannelView, unit: TimeUnit) -> None:
    """Draws the residual with a suitable prefix of the unit, which the label names."""
    assert view.residual is not None
    scale = scale_of(view, view.residual)
    curve(axes, view.residual, unit, 0.9, "residual (HF)", scale.factor)
    axes.set_ylabel(named("residual", scale.unit))
    axes.set_xlim(view.start / unit.seconds, view.stop / unit.seconds)


def error(axes: Axes, view: ChannelView, unit: TimeUnit, *, name: str = "error") -> None:
    """Draws decoded minus original over time, and the error bound if there is one."""
    assert view.error is not None
    scale = error_scale(view)
    curve(axes, view.error, unit, 0.7, name, scale.factor)
    if name == "error":
        bounds(axes, view.bound, scale, horizontal=True)
    axes.set_ylabel(named("error" if name == "error" else "B − A", scale.unit))
    axes.set_xlim(view.start / unit.seconds, view.stop / unit.seconds)
    low, high = extremes([view.error])
    if low == high == 0:
        instead(axes, "no difference")


def bounds(axes: Axes, bound: float | None, scale: Scale, *, horizontal: bool) -> None:
    """Draws the error bound on both sides of zero."""
    draw = axes.axhline if horizontal else axes.axvline
    for sign in (-1, 1):
        if bound:
            draw(
                sign * bound * scale.factor, color=PALETTE["error bound"], lw=1.1, ls=DASHES,
                label="error bound" if sign > 0 else "",
            )  # fmt: skip


def scale_of(view: ChannelView, outline: Outline) -> Scale:
    low, high = extremes([outline])
    return Scale.of(view.channel.unit, max(high, -low, 0.0))


def error_scale(view: ChannelView) -> Scale:
    """Scale of all panels that show the errors of a channel."""
    largest = view.errors.largest if view.errors is not None else 0.0
    return Scale.of(view.channel.unit, max(largest, view.bound or 0.0))


def missing(axes: Axes, view: ChannelView, unit: TimeUnit) -> None:
    """Hatches the gaps that only one of two recordings has."""
    assert view.original is not None
    smallest = (view.stop - view.start) / 600
    rows = (
        (view.full, view.original, "\\\\\\", "gap in A"),
        (view.original, view.full, "///", "gap in B"),
    )
    for other, own, hatch, name in rows:
        lacking = (own.counts < other.counts) if own.counts.size == other.counts.size else None
        runs = [] if lacking is None else [wide(*run, smallest) for run in own.runs(lacking)]
        spans(axes, runs, unit, name, hatch)


def spectrum(axes: Axes, view: ChannelView) -> None:
    """Draws power densities over frequency, both logarithmic."""
    tops = []
    looks: dict[str, tuple[str, str, float, Any]] = {
        "full": (name_of(view), DECODED if name_of(view) == "decoded" else SIGNAL, 1.0, "-"),
        "LF": ("slow part (LF)", LF, 1.4, "-"),
        "HF": ("residual (HF)", HF, 1.4, (0, (5, 1.5))),
    }
    for name, (label, colour, width, dashes) in looks.items():
        if is_constant(view):
            break  # Its density would be that of rounding.
        density = view.spectra[name].density() if name in view.spectra else None
        if density is None:
            continue
        hertz, power = density
        if (power > 0).any() and np.isfinite(power).all():
            tops.append(power.max())
            drawn = np.where(power > 0, power, np.nan)
            axes.plot(hertz, drawn, label=label, color=colour, lw=width, ls=dashes)
    if not tops:
        instead(axes, "no spectrum: constant, not finite,\nor no run of samples long enough")
        axes.set_xticks([])
        return
    axes.set_xscale("log")
    axes.set_yscale("log")
    # What a smooth LF track leaves at high frequencies is rounding; it would flatten the rest.
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, 1e-9 * max(tops)), top)


def density_label(view: ChannelView) -> str:
    unit = unit_of(view)
    if not unit:
        return "density in 1/Hz"
    return f"density in {unit if unit.isalnum() else f'({unit})'}²/Hz"


def histogram(
    axes: Axes, errors: Histogram, bound: float | None, scale: Scale, name: str = "error"
) -> None:
    """Draws how often each error occurs, on a logarithmic scale that shows outliers too."""
    if not errors.total or (not errors.largest and not bound):
        same = f"no difference in {errors.total} samples"
        instead(axes, same if errors.total else "no sample in common")
        axes.set_xticks([])
        return
    centres, counts, width = errors.bars()
    found = centres[counts > 0]
    if found.size == 1:
        width = width or (bound or 1.0) / 20
    elif found.size > 1:
        # Errors that are whole counts, or whole steps, lie apart.
        width = float(np.diff(found).min())
    factor = scale.factor
    axes.bar(
        factor * centres, counts, width=0.9 * factor * width, color=ERROR, label=name,
    )  # fmt: skip
    reach = 1.15 * max(float(np.abs(centres).max(initial=0)) + width / 2, bound or 0.0) or 1.0
    axes.set_xlim(-factor * reach, factor * reach)
    axes.locator_params(axis="x", nbins=5)
    axes.set_yscale("log")
    axes.set_ylim(0.5, 3 * max(int(counts.max(initial=0)), 1))
    bounds(axes, bound, scale, horizontal=False)
