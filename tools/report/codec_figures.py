"""Pictures of the codecs: error against size and time, and sizes compared with peers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil, log10
from typing import Any

from results import mean

from report.section import COLOURS, INK, MARKERS, PALE, Figure, drawn
from report.trials import PEER_ERROR, PEER_K, Trial

FAMILIES = ("lossless", "near-lossless", "deadband", "perceptual", "paper")
PEERS = ("flac", "pcodec", "sz3", "zstd", "blosc2", "sz2")
TASKS = {
    "lossless": ("lossless", "Without loss"),
    f"within {PEER_ERROR:.2%}": ("near-lossless", f"Every sample within {PEER_ERROR:.1%} of range"),
    f"deadband k={PEER_K:g}": ("deadband", f"Deadband of {PEER_K:.0%}"),
}
LEAST = 0.004
"""% of range: smaller errors are drawn here, no error too."""

COLUMNS = 4


def pictures(found: Sequence[Trial]) -> list[Figure]:
    figures = [
        summary(found, "Error against size", "size relative to lossless", size_of(found),
                "Each mark is one setting: the geometric mean over all recordings and scenes of "
                "the rms error of the median channel. "
                "Lower left is better. The thin line joins the settings that no other one beats in "
                "both size and error. A bar spans the middle half of the recordings. Errors below "
                f"{LEAST} % of the range are drawn at 'none'."),
        summary(found, "Error against encoding time", "CPU µs per sample",
                lambda t: t.microseconds(t.encode),
                "The same settings. Further left is faster to write."),
        summary(found, "Error against decoding time", "CPU µs per sample",
                lambda t: t.microseconds(t.decode),
                "The same settings. Further left is faster to read. Of other coders, only the "
                "settings that the tables list were timed."),
    ]  # fmt: skip
    for task, (family, words) in TASKS.items():
        figure = compared(found, task, family, words)
        if figure:
            figures.append(figure)
    for simulated, words in ((False, "recordings"), (True, "scenes")):
        members = [trial for trial in found if trial.simulated == simulated]
        if members:
            figures.append(multiples(members, words))
    return figures


def size_of(found: Sequence[Trial]) -> Callable[[Trial], float | None]:
    lossless = {t.subject: t.coded_bits for t in found if t.label == "lossless"}

    def relative(trial: Trial) -> float | None:
        own = lossless.get(trial.subject)
        return trial.coded_bits / own if own and trial.coded_bits else None

    return relative


def colour(trial: Trial) -> str:
    return COLOURS[FAMILIES.index(trial.family)] if trial.ours else COLOURS[7]


def marker(trial: Trial) -> str:
    return MARKERS[FAMILIES.index(trial.family)] if trial.ours else "x"


def height(percent: float) -> float:
    return max(percent, LEAST)


def summary(
    found: Sequence[Trial], title: str, label: str, value: Callable[[Trial], float | None],
    caption: str,
) -> Figure:  # fmt: skip
    points = []
    for key in dict.fromkeys((trial.label, trial.task) for trial in found):
        members = [trial for trial in found if (trial.label, trial.task) == key]
        known = sorted(v for t in members if (v := value(t)))
        if known:
            error = mean([height(t.rms_percent) for t in members])
            points.append((mean(known), error, known, members[0]))

    def draw(axes: Any) -> None:
        named: set[str] = set()
        for x, y, known, trial in points:
            name = trial.family if trial.ours else "other coders"
            axes.plot(x, y, marker(trial), color=colour(trial), linestyle="none",
                      label="_" if name in named else name, zorder=3 if trial.ours else 2,
                      markersize=6 if trial.ours else 4)  # fmt: skip
            named.add(name)
            quarter = len(known) // 4
            if quarter:
                axes.plot([known[quarter], known[-1 - quarter]], [y] * 2, "-", marker="",
                          color=colour(trial), alpha=0.3, linewidth=1)  # fmt: skip
        label_points(axes, [(x, y, t.setting or "default") for x, y, _, t in points if t.ours])
        outline(axes, [(x, y) for x, y, _, _ in points])
        scales(axes)
        axes.set_xlabel(label)
        axes.set_ylabel("rms error, % of range (median of channels)")
        axes.figure.legend(loc="outside upper center", ncols=8, handletextpad=0.1,
                           columnspacing=0.8)  # fmt: skip

    return drawn(title, caption, draw, height=4.6)


def label_points(axes: Any, points: Sequence[tuple[float, float, str]]) -> None:
    """Names to the right of the points; to the left, then above, where there is no room."""
    placed: list[tuple[float, float]] = []
    for x, y, word in sorted(points, reverse=True):
        near = sum(abs(log10(y / b)) < 0.13 and abs(log10(x / a)) < 0.35 for a, b in placed)
        offset, side = (((6, -3), "left"), ((-6, -3), "right"), ((0, 6), "center"))[min(near, 2)]
        axes.annotate(word, (x, y), xytext=offset, fontsize=7.5, textcoords="offset points",
                      ha=side)  # fmt: skip
        placed.append((x, y))


def outline(axes: Any, points: Sequence[tuple[float, float]]) -> None:
    """The front, as steps."""
    best: list[tuple[float, float]] = []
    for point in sorted(points):
        if not best or point[1] < best[-1][1]:
            best.append(point)
    axes.plot(*zip(*best, strict=True), "-", marker="", drawstyle="steps-post", color=INK,
              linewidth=0.8, alpha=0.6, zorder=1)  # fmt: skip


def scales(axes: Any) -> None:
    """Both logarithmic; the lowest tick is "none"."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(LEAST / 1.7, 60)
    places = [LEAST, 0.01, 0.1, 1, 10]
    axes.set_yticks(places, ["none", "0.01", "0.1", "1", "10"])
    axes.yaxis.set_minor_locator(axes.yaxis.get_major_locator())
    low, high = axes.get_xlim()
    exponents = range(-6, 5)
    places = [m * 10.0**e for e in exponents for m in (1, 2, 5) if low <= m * 10.0**e <= high]
    if len(places) > 6:
        places = [x for x in places if f"{x:e}".startswith("1")]
    axes.set_xticks(places, [f"{x:g}" for x in places])
    axes.set_xticks([], minor=True)


def compared(found: Sequence[Trial], task: str, family: str, words: str) -> Figure | None:
    """Sizes of peers divided by ours, one line for each recording."""
    ours = {
        t.subject: t for t in found
        if (t.task, t.family) == (task, family) and t.coded_bits and not t.label.endswith("fast")
    }  # fmt: skip
    rows: list[tuple[str, dict[str, float]]] = []
    for name, own in ours.items():
        sizes: dict[str, float] = {}
        for t in found:
            if (t.subject, t.task, t.ours, t.outside) == (name, task, False, 0):
                kind = next((peer for peer in PEERS if peer in t.setting), "other")
                ratio = t.coded_bits / own.coded_bits
                sizes[kind] = min(ratio, sizes.get(kind, ratio))
        if sizes:
            rows.append((name, sizes))
    if not rows:
        return None

    def draw(axes: Any) -> None:
        axes.axvline(1, color=INK, linewidth=1.2)
        axes.axvspan(0.01, 1, color=COLOURS[1], alpha=0.08, linewidth=0)
        for place, kind in enumerate(PEERS):
            known = [(sizes[kind], row) for row, (_, sizes) in enumerate(rows) if kind in sizes]
            if known:
                axes.plot(*zip(*known, strict=True), MARKERS[place], color=COLOURS[place],
                          linestyle="none", label=kind)  # fmt: skip
        for row, (_, sizes) in enumerate(rows):
            axes.plot([min(*sizes.values(), 1), max(sizes.values())], [row, row], "-", marker="",
                      color=PALE, linewidth=0.5, zorder=0)  # fmt: skip
        most = max(value for _, sizes in rows for value in sizes.values())
        least = min(value for _, sizes in rows for value in sizes.values())
        axes.set_xscale("log")
        axes.set_xlim(min(0.8, least / 1.1), min(most * 1.2, 40))
        ticks = [t for t in (0.5, 0.7, 1, 1.5, 2, 3, 5, 10, 20) if least / 1.1 <= t <= most * 1.2]
        axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axes.set_xticks([], minor=True)
        axes.set_yticks(range(len(rows)), [short(name) for name, _ in rows])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_xlabel(f"size relative to {family}")
        axes.figure.legend(loc="outside upper center", ncols=6, handletextpad=0.1,
                           columnspacing=0.8)  # fmt: skip

    return drawn(
        f"{words}: other coders against {family}",
        f"Each mark is one recording, written by another coder. Right of the line its file is "
        f"larger than that of {family}; in the shaded part it is smaller. Of a coder with several "
        "settings, the smallest file counts. Settings that broke the error bound are left out.",
        draw,
        height=1.2 + 0.24 * len(rows),
    )


def short(name: str) -> str:
    """The last folder and the file of a path, and the text after a comma."""
    stem, comma, rest = name.partition(",")
    *folders, last = stem.split("/")
    text = f"{folders[-1][:12]}/{last[-14:]}" if folders else last
    return f"{text}{comma}{rest}"


def multiples(found: Sequence[Trial], words: str) -> Figure:
    """Error against size, a panel each."""
    names = list(dict.fromkeys(trial.subject for trial in found))
    lines = ceil(len(names) / COLUMNS)

    def draw(panels: Any) -> None:
        flat = list(panels.flat)
        for axes in flat[len(names) :]:
            axes.set_visible(False)
        for axes, name in zip(flat, names, strict=False):
            members = [t for t in found if t.subject == name and t.coded_bits]
            for family in ("peer", *FAMILIES):
                own = sorted((t.coded_bits, height(t.rms_percent)) for t in members
                             if t.family == family)  # fmt: skip
                if own:
                    first = next(t for t in members if t.family == family)
                    axes.plot(*zip(*own, strict=True), marker(first), color=colour(first),
                              linestyle="-" if first.ours else "none", linewidth=0.7, markersize=4,
                              label=family)  # fmt: skip
            outline(axes, [(t.coded_bits, height(t.rms_percent)) for t in members])
            scales(axes)
            axes.set_title(short(name), fontsize=8.5)
            axes.tick_params(labelsize=7)
        handles, labels = flat[0].get_legend_handles_labels()
        flat[0].figure.legend(handles, labels, loc="outside upper center", ncols=8)
        flat[0].figure.supxlabel("bits per sample", fontsize=9)
        flat[0].figure.supylabel("rms error, % of range (median of channels)", fontsize=9)

    return drawn(
        f"Error against size: {words}",
        "One panel for each. Each mark is one setting; a line joins the settings of a preset. "
        "Lower left is better. The thin line joins the settings that no other one beats in both "
        "size and error.",
        draw, width=11.5, height=0.6 + 2.1 * lines, panels=(lines, COLUMNS), squeeze=False,
    )  # fmt: skip
