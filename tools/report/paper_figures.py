"""The paper's figures 2, 4 and 5, drawn: names are next to the lines, or above the panels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapfmt.split import low_pass
from report.ratio import Point, Source, measure, settings
from report.section import COLOURS, INK, PALE, Figure, drawn
from report.variants import parts_of

PERCENT = 10
"""Weber fraction of figures 2 and 5, in %: the paper's value for forces."""

FIG2_BITS, FIG2_LONG_S, FIG2_ZOOM_S = 5, 1.5, 0.2

BITS_COLOUR = {0: COLOURS[7], 2: COLOURS[4], 5: COLOURS[0], 8: COLOURS[2]}
ORIGINAL, SLOW, WHOLE = COLOURS[0], COLOURS[4], INK
"""As in the pictures of hapfmt plot."""
LINE_COLOURS = (COLOURS[1], COLOURS[0], COLOURS[2])

LINE_GAP = 0.085
"""Between two names at the end of lines, as a share of the height."""


class Stretch(NamedTuple):
    """One channel, [ticks]: seconds; f, d and reconstruction in newtons; the knots, as indices;
    the deadband around f, half its width."""

    t: NDArray[np.float64]
    f: NDArray[np.float64]
    d: NDArray[np.float64]
    y: NDArray[np.float64]
    knots: NDArray[np.int64]
    half: NDArray[np.float64]


def most_textured(source: Source) -> Source:
    """The channel with the strongest part above 20 Hz."""

    def rms(channel: Any) -> float:
        f = channel.samples()
        return float(np.std(f - low_pass(f, channel.rate)))

    channel = max(source.recording.channels, key=rms)
    return source._replace(recording=replace(source.recording, channels=(channel,)))


def picture2(source: Source) -> Figure:
    """1.5 s of the most textured channel, about its middle, and a knot of them closer."""
    source = most_textured(source)
    point = measure(source, settings(PERCENT, FIG2_BITS, source.floor))
    (channel,) = source.recording.channels
    parts, f, rate = parts_of(point.file), channel.samples(), channel.rate
    half = np.maximum(PERCENT / 100 * np.abs(f), float(source.floor))
    largest = float(np.max(np.abs(parts.whole - f) / half))

    def stretch(middle_s: float, seconds: float) -> Stretch:
        first = max(round((middle_s - seconds / 2) * rate), 0)
        rows = slice(first, min(first + round(seconds * rate), f.size))
        t = np.arange(rows.start, rows.stop) / rate
        knots = parts.knots[(parts.knots >= rows.start) & (parts.knots < rows.stop)] - rows.start
        return Stretch(t, f[rows], parts.slow[rows], parts.whole[rows], knots, half[rows])

    middle = f.size / 2 / rate
    knot = float(parts.knots[np.argmin(np.abs(parts.knots - middle * rate))]) / rate
    quantity = f"{channel.quantity or channel.label} in {channel.unit}"
    return fig2(
        stretch(middle, FIG2_LONG_S),
        stretch(knot, FIG2_ZOOM_S),
        quantity,
        f"Fig. 2: {source.name}, k = {PERCENT} %, b = {FIG2_BITS}",
        "The slow part d joins its knots by lines, and follows the original f without its texture. "
        "With the residual e the texture is back. The largest error of the session is "
        f"{largest:.2f} deadbands.",
    )


def fig2(long: Stretch, zoom: Stretch, quantity: str, title: str, caption: str) -> Figure:
    def draw(axes: Any) -> None:
        signals(axes[0], long._replace(half=np.zeros_like(long.f)))
        axes[0].axvspan(zoom.t[0], zoom.t[-1], color=PALE, alpha=0.18, linewidth=0)
        axes[0].set_title(f"{long.t.size * (long.t[1] - long.t[0]):.1f} s of contact")
        signals(axes[1], zoom)
        axes[1].set_title(f"the shaded {zoom.t.size * (zoom.t[1] - zoom.t[0]) * 1000:.0f} ms")
        for panel, part in zip(axes, (long, zoom), strict=True):
            size = 6 if part is zoom else 3.5
            panel.plot(part.t[part.knots], part.d[part.knots], "o", color=SLOW, markersize=size)
            panel.set_ylabel(quantity)
            panel.set_xlim(part.t[0], part.t[-1])
        axes[1].set_xlabel("seconds")
        name_lines(
            axes[1],
            [
                (zoom.f[-1], "original f", ORIGINAL),
                (zoom.d[-1], "d: knots (dots)\njoined by lines", SLOW),
                (zoom.y[-1], "reconstruction\nd + e", WHOLE),
                (zoom.f[-1] - zoom.half[-1], "deadband of f\n(shaded)", PALE),
            ],
            gap=0.16,
        )

    return drawn(title, caption, draw, height=6.0, panels=(2, 1))


def signals(axes: Any, part: Stretch) -> None:
    low, high = part.f - part.half, part.f + part.half
    axes.fill_between(part.t, low, high, color=PALE, alpha=0.22, linewidth=0)
    axes.plot(part.t, part.f, color=ORIGINAL, linewidth=3.4, marker="", alpha=0.75)
    axes.plot(part.t, part.y, color=WHOLE, linewidth=1.0, marker="")
    axes.plot(part.t, part.d, color=SLOW, linewidth=1.6, marker="")


def fig4(points: dict[str, list[Point]], title: str, caption: str) -> Figure:
    """Panels side by side; whole lines are packets, dashed lines files."""

    def draw(axes: Any) -> None:
        panels = list(np.atleast_1d(axes))
        top = max(point.file_percent for found in points.values() for point in found)
        for panel, (name, found) in zip(panels, points.items(), strict=True):
            ends = []
            for bits in sorted({point.bits for point in found}):
                line = [point for point in found if point.bits == bits]
                k = [point.percent for point in line]
                colour = BITS_COLOUR.get(bits, INK)
                panel.plot(k, [p.payload_percent for p in line], color=colour,
                           marker="os^D"[bits % 4], markersize=4)  # fmt: skip
                panel.plot(k, [p.file_percent for p in line], color=colour, marker="",
                           linestyle=(0, (4, 3)), linewidth=0.9)  # fmt: skip
                ends.append((line[-1].payload_percent, f"b = {bits}" if bits else "none", colour))
            panel.set_title(name)
            panel.set_xlabel("Weber fraction k in %")
            panel.set_xlim(0, None)
            panel.set_ylim(0, 1.05 * top)
            panel.set_xticks(range(0, round(max(point.percent for point in found)) + 1, 10))
            name_lines(panel, ends)
        panels[0].set_ylabel("compression ratio: coded size\nin % of 64-bit samples")

    return drawn(title, caption, draw, width=8.5, height=3.8, panels=(1, len(points)), sharey=True)


class Curve(NamedTuple):
    """One panel of Fig. 5: a measure of each texture against b. lines: [textures][settings], None
    where it was not measured. limits: (value, name) of what is drawn across. others: the same by
    another rule, dashed, and its name."""

    title: str
    unit: str
    lines: Sequence[Sequence[float | None]]
    limits: Sequence[tuple[float, str]] = ()
    others: Sequence[Sequence[float | None]] = ()
    other: str = ""


def fig5(
    textures: Sequence[str], bits: Sequence[int], curves: Sequence[Curve], title: str, caption: str
) -> Figure:
    places = np.array([i if b else i - 0.5 for i, b in enumerate(bits)])

    def draw(axes: Any) -> None:
        for panel, curve in zip(np.atleast_1d(axes), curves, strict=True):
            for name, line, colour, mark in zip(
                textures, curve.lines, LINE_COLOURS, "os^", strict=False
            ):
                panel.plot(*known(places, line), color=colour, marker=mark, label=name)
            for other, colour in zip(curve.others, LINE_COLOURS, strict=False):
                panel.plot(*known(places, other), color=colour, marker="", linestyle=(0, (4, 3)))
            panel.annotate(curve.other, (0.98, 0.94), xycoords="axes fraction", ha="right",
                           va="top", fontsize=8)  # fmt: skip
            for value, name in curve.limits:
                panel.axhline(value, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
                panel.annotate(name, (0.99, value), xycoords=("axes fraction", "data"),
                               xytext=(0, 3), textcoords="offset points", ha="right",
                               fontsize=8.5)  # fmt: skip
            panel.set_xticks(places, [str(b) if b else "none" for b in bits])
            panel.set_xlabel("bits b of the residual")
            panel.set_ylabel(curve.unit)
            panel.set_title(curve.title)
        first = np.atleast_1d(axes)[0]
        first.figure.legend(
            *first.get_legend_handles_labels(), loc="outside upper center", ncols=len(textures)
        )

    return drawn(title, caption, draw, width=9.0, height=3.6, panels=(1, len(curves)))


def known(
    places: NDArray[np.float64], line: Sequence[float | None]
) -> tuple[list[float], list[float]]:
    """x and y of the measured points."""
    pairs = [(x, y) for x, y in zip(places.tolist(), line, strict=True) if y is not None]
    return [x for x, _ in pairs], [y for _, y in pairs]


def name_lines(axes: Any, ends: Sequence[tuple[float, str, str]], gap: float = LINE_GAP) -> None:
    """Names right of the axes, at the ends of their lines, moved apart where these meet."""
    low, high = axes.get_ylim()
    order = sorted(range(len(ends)), key=lambda i: ends[i][0])
    places = [(ends[i][0] - low) / (high - low) for i in order]
    for below, above in pairwise(range(len(places))):
        places[above] = max(places[above], places[below] + gap)
    over = max(places[-1] - 1, 0)
    for i, place in zip(order, places, strict=True):
        _, name, colour = ends[i]
        axes.annotate(
            name,
            (1.02, place - over),
            xycoords="axes fraction",
            color=colour,
            fontsize=9,
            va="center",
            annotation_clip=False,
        )
