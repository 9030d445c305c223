"""The panels that pages are made of: one view of a channel in one pair of axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..events import Event
from ..survey.histogram import Histogram
from ..survey.knots import SHOWN
from ..survey.outline import Outline
from ..survey.views import View
from .style import BLUE, GREY, INK, ORANGE, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DAMAGE, DIM = "#8f1d1d", "#57606a"
NAME = 24
"""Characters of a label that fit beside an axis."""
EVENTS_NAMED = 10
"""Above this many events in view their texts would hide the signal, and each other."""


class TimeUnit(NamedTuple):
    seconds: float
    name: str

    @classmethod
    def of(cls, seconds: float) -> TimeUnit:
        if seconds >= 3 * 3600:
            return cls(3600.0, "h")
        return cls(60.0, "min") if seconds >= 600 else cls(1.0, "s")


def axis_label(view: View, *, short: bool = False) -> str:
    """Quantity and unit of a channel, as far as they are known."""
    channel = view.channel
    unit = channel.unit.strip("{}")
    quantity = plain(channel.quantity.replace("_", " "))
    if not quantity and not short:
        quantity = plain(channel.name) if len(channel.name) <= NAME else "value"
    if unit in ("", "1"):
        return quantity
    return f"{quantity} in {plain(unit)}" if quantity else plain(unit)


def signal(axes: Axes, view: View, unit: TimeUnit, *, width: float = 1.0) -> None:
    """The channel over time with all that belongs to it; ``width``: of lines, below 1 in a
    small picture."""
    seconds = unit.seconds
    if view.low is not None and view.high is not None:
        axes.fill_between(
            view.low.seconds() / seconds, view.low.least, view.high.most,
            color=BLUE, alpha=0.16, lw=0, label="deadband",
        )  # fmt: skip
    if view.original is not None:
        curve(axes, view.original, unit, GREY, 3 * width, "original")
    name = "signal" if view.lf is None else "decoded"
    colour = ORANGE if view.lf is not None or view.original is not None else BLUE
    if view.lf is None and view.original is not None:
        name = "decoded"
    curve(axes, view.full, unit, colour, 0.9 * width, name)
    if view.lf is not None:
        curve(axes, view.lf, unit, BLUE, 1.4 * width, "slow part (LF)")
    most = SHOWN if width >= 1 else SHOWN // 10
    if view.knots is not None and 0 < view.knots.ticks.size <= most:
        axes.plot(
            view.knots.seconds / seconds, view.knots.values, "o",
            color=BLUE, ms=3.6 * width + 0.6, mec="white", mew=0.6, label="knots",
        )  # fmt: skip
    axes.margins(y=0.08)
    axes.set_xlim(view.start / seconds, view.stop / seconds)
    if not np.isfinite(view.full.most).any():
        instead(axes, "no sample here" if not view.full.sample_count else "no finite value here")


def instead(axes: Axes, text: str) -> None:
    """Why there is nothing to see."""
    axes.text(
        0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=8.5,
        color=DIM,
    )  # fmt: skip
    axes.set_yticks([])


def curve(
    axes: Axes, outline: Outline, unit: TimeUnit, colour: str, width: float, name: str
) -> None:
    at, y = outline.line()
    axes.plot(
        at / unit.seconds, y, color=colour, lw=width, solid_capstyle="round", label=name,
        # A sample between two gaps has no line.
        marker="." if lonely(y) else "", ms=2 + width,
    )  # fmt: skip


def lonely(y: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    known = np.isfinite(y)
    beside = np.zeros(known.size + 2, np.bool_)
    beside[1:-1] = known
    return bool((known & ~beside[:-2] & ~beside[2:]).any())


def absences(axes: Axes, view: View, unit: TimeUnit, *, named: bool = True) -> None:
    """Gaps hatched, damage framed and crossed, with what was lost."""
    smallest = (view.stop - view.start) / 600
    gaps = [wide(a, b, smallest) for a, b in view.gaps]
    if gaps:
        axes.broken_barh(
            [((a) / unit.seconds, (b - a) / unit.seconds) for a, b in gaps], (0, 1),
            transform=axes.get_xaxis_transform(), facecolor="#eef0f2", edgecolor=GREY,
            hatch="///", lw=0, zorder=0.5, label="gap",
        )  # fmt: skip
    if not view.losses:
        return
    losses = [(*wide(loss.start, loss.stop, smallest), loss.what) for loss in view.losses]
    axes.broken_barh(
        [(a / unit.seconds, (b - a) / unit.seconds) for a, b, _ in losses], (0, 1),
        transform=axes.get_xaxis_transform(), facecolor="#f7dcdc", edgecolor=DAMAGE,
        hatch="xxx", lw=0.8, zorder=0.6, label="lost to damage",
    )  # fmt: skip
    if named and len(losses) <= EVENTS_NAMED:
        for a, b, what in losses:
            note(axes, (a + b) / 2 / unit.seconds, 0.5, f"{what} lost", DAMAGE, rotation=90)


def wide(start: float, stop: float, smallest: float) -> tuple[float, float]:
    """As long as it is, or long enough to be seen."""
    more = max(smallest - (stop - start), 0.0) / 2
    return start - more, stop + more


def note(axes: Axes, x: float, y: float, text: str, colour: str, **more: Any) -> None:
    """A word on a white ground; y: share of the height."""
    axes.text(
        x, y, text, transform=axes.get_xaxis_transform(), color=colour, fontsize=8,
        ha="center", va="center", clip_on=True, zorder=6,
        bbox={"facecolor": "white", "alpha": 0.9, "edgecolor": "none", "pad": 1.2}, **more,
    )  # fmt: skip


def marks(axes: Axes, view: View, unit: TimeUnit, events: Sequence[Event], named: bool) -> None:
    """Events of this channel, or of all, as lines; their texts where they are few."""
    own = [
        e
        for e in events
        if e.channel in (None, view.channel.number, view.channel.label)
        and float(e.time + e.duration) >= view.start
        and float(e.time) < view.stop
    ]
    for event in own[:200]:
        start, stop = float(event.time), float(event.time + event.duration)
        if stop > start:
            axes.axvspan(start / unit.seconds, stop / unit.seconds, color=INK, alpha=0.07, lw=0)
        axes.axvline(max(start, view.start) / unit.seconds, color=INK, lw=0.9, ls=(0, (2, 2)))
        if named and len(own) <= EVENTS_NAMED and event.text:
            axes.annotate(
                plain(event.text), (max(start, view.start) / unit.seconds, 1.0),
                xycoords=("data", "axes fraction"), xytext=(3, -3), textcoords="offset points",
                ha="left", va="top", fontsize=8, color=INK, clip_on=True,
            )  # fmt: skip


def residual(axes: Axes, view: View, unit: TimeUnit) -> None:
    assert view.residual is not None
    curve(axes, view.residual, unit, ORANGE, 0.9, "texture (HF)")
    axes.set_xlim(view.start / unit.seconds, view.stop / unit.seconds)


def error(
    axes: Axes, view: View, unit: TimeUnit, *, colour: str = DIM, name: str = "error",
    bound: bool = True,
) -> None:  # fmt: skip
    """Decoded minus original over time, and half a step where there is one."""
    assert view.error is not None
    curve(axes, view.error, unit, colour, 0.6, name)
    for sign in (-1, 1):
        if bound and view.bound:
            axes.axhline(sign * view.bound, color=ORANGE, lw=1.1, ls=(0, (4, 3)))
    axes.set_xlim(view.start / unit.seconds, view.stop / unit.seconds)


def missing(axes: Axes, view: View, unit: TimeUnit) -> None:
    """What one of two recordings lacks: of B hatched one way, of A the other."""
    assert view.original is not None
    smallest = (view.stop - view.start) / 600
    rows = (view.original, view.full, "///", "B has a gap"), (
        view.full, view.original, "\\\\\\", "A has a gap"
    )  # fmt: skip
    for other, own, hatch, name in (rows[1], rows[0]):
        lacking = (own.counts < other.counts) if own.counts.size == other.counts.size else None
        runs = [] if lacking is None else [wide(*run, smallest) for run in own.runs(lacking)]
        if runs:
            axes.broken_barh(
                [(a / unit.seconds, (b - a) / unit.seconds) for a, b in runs], (0, 1),
                transform=axes.get_xaxis_transform(), facecolor="#eef0f2", edgecolor=GREY,
                hatch=hatch, lw=0, zorder=0.5, label=name,
            )  # fmt: skip


LOOKS = {
    "full": (GREY, 2.6, "-", "all"),
    "LF": (BLUE, 1.3, "-", "slow part (LF)"),
    "HF": (ORANGE, 1.1, (0, (5, 1.5)), "texture (HF)"),
}


def spectrum(axes: Axes, view: View, *, legend: bool = True) -> None:
    """Densities over hertz, both logarithmic; where nothing is long enough, it says so."""
    tops = []
    alone = len(view.spectra) == 1
    for name, (colour, width, dashes, label) in LOOKS.items():
        density = view.spectra[name].density() if name in view.spectra else None
        if density is None:
            continue
        hertz, power = density
        if (power > 0).any() and np.isfinite(power).all():
            tops.append(power.max())
            drawn = np.where(power > 0, power, np.nan)
            look: dict[str, Any] = {"color": colour, "lw": width, "ls": dashes}
            if alone:
                look = {"color": BLUE, "lw": 1.2}
            axes.plot(hertz, drawn, label=label, **look)
    if not tops:
        instead(axes, "no spectrum: silent, not finite,\nor no run of samples long enough")
        axes.set_xticks([])
        return
    axes.set_xscale("log")
    axes.set_yscale("log")
    # What a smooth LF track leaves at high frequencies is rounding; it would flatten the rest.
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, 1e-9 * max(tops)), top)
    if legend and len(tops) > 1:
        axes.legend(frameon=False, fontsize=8, loc="best")


def density_label(view: View) -> str:
    unit = plain(view.channel.unit.strip("{}"))
    if unit in ("", "1"):
        return "density in 1/Hz"
    return f"density in {unit if unit.isalnum() else f'({unit})'}²/Hz"


def histogram(axes: Axes, errors: Histogram, bound: float | None, name: str) -> None:
    """Errors as bars, how often on a logarithmic scale, since outliers matter; bound: marked."""
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
    axes.bar(centres, counts, width=0.9 * width, color=ORANGE, alpha=0.85)
    reach = 1.15 * max(float(np.abs(centres).max(initial=0)) + width / 2, bound or 0.0) or 1.0
    axes.set_xlim(-reach, reach)
    axes.locator_params(axis="x", nbins=5)
    axes.set_yscale("log")
    axes.set_ylim(0.5, 3 * max(int(counts.max(initial=0)), 1))
    if bound:
        for sign in (-1, 1):
            axes.axvline(sign * bound, color=INK, lw=1.1, ls=(0, (4, 3)))
        axes.annotate(
            name, (bound, 0.93), xycoords=("data", "axes fraction"), xytext=(-5, 0),
            textcoords="offset points", ha="right", fontsize=8.5, color=INK,
            bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1},
        )  # fmt: skip


def error_label(view: View, name: str = "error") -> str:
    unit = plain(view.channel.unit.strip("{}"))
    return name if unit in ("", "1") else f"{name} in {unit}"
