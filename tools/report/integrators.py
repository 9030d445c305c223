"""Integrators: error of the force against run time and step, stability limits, energy.

python tools/report --only integrators [--quick]
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import inf, isfinite
from typing import Any

import numpy as np

from hapfmt.lab.scenes.contact import INTEGRATORS
from report import integrator_runs as runs
from report.integrator_runs import Long, Point, Reference
from report.section import COLOURS, PALE, Cell, Options, Section, Spread, Table, drawn

TARGETS = (1e-2, 1e-3, 1e-4)
USELESS = 1.0
"""An error as large as the force itself."""

BLUE, RED, GREEN, PINK, ORANGE, *_, GREY = COLOURS
LOOKS = {
    "explicit-euler": (RED, "v"),
    "semi-implicit": (ORANGE, "^"),
    "implicit": (GREY, "s"),
    "trapezoid": (GREEN, "D"),
    "rk4": (PINK, "P"),
    "exact": (BLUE, "o"),
}


def section(options: Options) -> Section:
    finest, repeats, seconds = (runs.QUICK_FINEST, 2, 6) if options.quick else (runs.FINEST, 5, 60)
    truths: dict[float, Reference] = {}
    points: list[Point] = []
    for stiffness in runs.STIFFNESSES:
        options.progress(f"integrators: taps at {newtons_per_metre(stiffness)}")
        truths[stiffness] = runs.reference(stiffness)
        points += runs.points(stiffness, truths[stiffness].force, finest, repeats)
    bounces = []
    for stiffness, name in product(runs.LONG_STIFFNESSES, runs.DEFAULTS):
        options.progress(
            f"integrators: {seconds} s of bouncing at {newtons_per_metre(stiffness)}, {name}"
        )
        bounces.append(runs.bounce(stiffness, name, seconds))
    options.progress(f"integrators: {seconds} s of taps at 100 kN/m")
    tapped = [runs.tapping(1e5, name, seconds) for name in runs.DEFAULTS]
    tapped += [runs.tapping(1e5, "explicit-euler", seconds, dt) for dt in (1e-3, 50e-6)]
    return Section(
        "Integrators: error against run time",
        text(points, bounces, tapped, truths, seconds, repeats),
        [
            limits_table(),
            targets_table(points),
            energy_table(bounces, seconds),
            tapping_table(tapped, seconds),
            reference_table(truths),
        ],
        [
            drawn(
                "Error against step",
                "The error is the rms error of the contact force, relative to the rms force. A "
                "dotted line marks the largest stable step of the integrator of its colour. An "
                "integrator without one is stable at every step up to 16 ms. In the red part, the "
                "error is as large as the force.",
                lambda axes: error_figure(axes, points),
                width=10,
                height=7.5,
                panels=(2, 2),
            ),
            drawn(
                "Error against run time",
                "The same runs. Lower left is better. The grey line joins the runs that no other "
                "one beats in both error and time. Marks are medians of the repeats; bars are "
                "their quartiles.",
                lambda axes: pareto_figure(axes, points),
                width=10,
                height=7.5,
                panels=(2, 2),
            ),
            drawn(
                "Energy without damping",
                f"A mass bounces on a spring for {seconds} s without damping, so its energy should "
                "stay constant. Left: relative error of the energy over time, at 100 kN/m. Right: "
                "the largest error of each run, at every stiffness.",
                lambda axes: energy_figure(axes, bounces),
                width=10,
                height=4.2,
                panels=(1, 2),
            ),
        ],
        {
            "points": [plain(p) for p in points],
            "bounces": [plain(b) for b in bounces],
            "taps": [plain(t) for t in tapped],
            "references": {
                f"{k:g}": {"halving": r.halving, "changes": r.changes} for k, r in truths.items()
            },
        },
    )


def plain(row: Point | Long) -> dict[str, Any]:
    """For JSON, which knows no infinity: None."""

    def value(x: Any) -> Any:
        if isinstance(x, Spread):
            return x._asdict()
        if isinstance(x, list):
            return [value(each) for each in x]
        return None if isinstance(x, float) and not isfinite(x) else x

    return {key: value(x) for key, x in row._asdict().items()}


def newtons_per_metre(stiffness: float) -> str:
    """100 N/m, 100 kN/m."""
    kilo = stiffness >= 1e4
    return f"{stiffness / 1000 if kilo else stiffness:,.0f} {'k' if kilo else ''}N/m"


def text(
    points: list[Point],
    bounces: list[Long],
    tapped: list[Long],
    truths: dict[float, Reference],
    seconds: int,
    repeats: int,
) -> str:
    """A few sentences that say what one sees."""
    stiff = {name: reached(points, name, 1e5, TARGETS[0]) for name in INTEGRATORS}
    exact = stiff.pop("exact")
    found = {name: point for name, point in stiff.items() if point}
    lines = []
    if exact and found:
        following = min(found, key=lambda name: found[name].cpu.median)
        ratio = found[following].cpu.median / exact.cpu.median
        lines.append(
            f"**At 100 kN/m an error of 1 % takes the exact step {milliseconds(exact.cpu.median)} "
            f"of CPU time per second, with steps of {milliseconds(exact.step_s)}; {following}, "
            f"which comes next, {ratio:.1f} times that, with "
            f"{milliseconds(found[following].step_s)}.**"
        )
    lines.append(
        "A stylus of 60 g taps, led by a hand of 250 N/m and 3 Ns/m, on a textured surface "
        f"({runs.SECONDS:g} s, two taps of 1 N). Every integrator is a loop in Python, and the "
        f"exact step has its matrices to set up; of {repeats} repeats, ratios say more than "
        "milliseconds."
    )
    kept = {
        name: max(abs(x) for b in bounces if b.name == name for x in (b.gain, *b.trace))
        for name in runs.DEFAULTS
    }
    lines.append(
        f"Without damping, over {seconds} s and from 100 N/m to 10,000 kN/m, the energy of the "
        f"exact step is off by at most {kept['exact']:.0e}, of trapezoid by "
        f"{kept['trapezoid']:.0e}, of rk4 by {kept['rk4']:.0e}, of semi-implicit by "
        f"{kept['semi-implicit']:.0e}; implicit loses what it has."
    )
    worst = max(b.peak_m for b in (*bounces, *tapped) if b.name != "explicit-euler")
    lines.append(
        "None of them diverges with its default step: "
        f"the mass is never further than {worst * 1e3:.2f} mm from where the surface rests."
        if isfinite(worst)
        else "**One of them diverged with its default step.**"
    )
    halving = max(truth.halving for truth in truths.values())
    lines.append(
        f"The reference is the exact step of {runs.TICK_S * 2.0**runs.REFERENCE * 1e6:.1f} us; "
        f"half of it changes the force by {halving:.0e} at most. (The tests hold the exact step "
        "against an independent solver.)"
    )
    return "\n\n".join(lines)


def milliseconds(seconds: float) -> str:
    """Three digits, in ms or us."""
    if not isfinite(seconds):
        return "none"
    if seconds == 0:
        return "0"
    return f"{seconds * 1e3:.3g} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.3g} us"


def finite(x: float, digits: int = 3) -> Cell:
    """The number with this many digits, or a word if it is infinite."""
    return float(f"{x:.{digits}g}") if isfinite(x) else "none" if x > 0 else None


def limits_table() -> Table:
    rows: list[Sequence[Cell]] = []
    for name, one in INTEGRATORS.items():
        limits = [
            finite(one.limit_s(runs.STYLUS._replace(contact_n_per_m=k)) * 1e3)
            for k in runs.LONG_STIFFNESSES
        ]
        rows.append([name, one.order, "may" if one.gains else "never", *limits])
    return Table(
        "Largest stable step in ms: by formula, checked against spectral radii and runs",
        ["integrator", "order", "gains at impact", *map(newtons_per_metre, runs.LONG_STIFFNESSES)],
        rows,
    )


def reached(points: list[Point], name: str, stiffness: float, target: float) -> Point | None:
    """The largest step from which on the error stays within the target."""
    best = None
    for point in sorted(p for p in points if (p.name, p.stiffness) == (name, stiffness)):
        if point.error > target:
            break
        best = point
    return best


def targets_table(points: list[Point]) -> Table:
    rows: list[Sequence[Cell]] = []
    for stiffness, name in product(runs.STIFFNESSES, INTEGRATORS):
        row: list[Cell] = [stiffness, name]
        for target in TARGETS:
            one, exact = (reached(points, n, stiffness, target) for n in (name, "exact"))
            if one is None or exact is None:
                row += [None] * 4
                continue
            half = (one.cpu.high - one.cpu.low) / 2 / one.cpu.median
            row += [
                one.step_s * 1e3,
                finite(one.cpu.median * 1e3),
                finite(half * 100, 2),
                finite(one.cpu.median / exact.cpu.median),
            ]
        rows.append(row)
    heads = [
        f"{target * 100:g} %: {head}"
        for target in TARGETS
        for head in ("step ms", "CPU ms/s", "+- %", "of exact")
    ]
    return Table(
        "For an error of 1, 0.1, 0.01 % of the force: largest step, CPU time per simulated second, "
        "half the distance of its quartiles, and ratio to the time of the exact step",
        ["N/m", "integrator", *heads],
        rows,
    )


def energy_table(bounces: list[Long], seconds: int) -> Table:
    return Table(
        f"{seconds} s of bouncing without damping, default steps: energy, relative",
        ["N/m", "integrator", "step us", "highest", "last", "CPU ms/s"],
        [
            [
                b.stiffness,
                b.name,
                finite(b.step_s * 1e6),
                finite(b.gain, 2),
                finite(b.drift, 2),
                finite(b.cpu_s / seconds * 1e3),
            ]
            for b in bounces
        ],
    )


def tapping_table(tapped: list[Long], seconds: int) -> Table:
    return Table(
        f"{seconds} s of taps at 100 kN/m with the hand's damping",
        ["integrator", "step us", "furthest mm", "gained of the highest energy"],
        [
            [
                t.name,
                finite(t.step_s * 1e6),
                finite(t.peak_m * 1e3) if isfinite(t.peak_m) else "diverged",
                finite(t.gain, 2) if isfinite(t.gain) else "diverged",
            ]
            for t in tapped
        ],
    )


def reference_table(truths: dict[float, Reference]) -> Table:
    return Table(
        "The reference: what halving its step changes",
        ["N/m", "changes of contact", "error by halving"],
        [[k, r.changes, finite(r.halving, 2)] for k, r in truths.items()],
    )


def legend(axes: Any) -> None:
    """One for all panels."""
    handles, labels = axes.get_legend_handles_labels()
    axes.figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


def line_of(points: list[Point], name: str, stiffness: float) -> list[Point]:
    """Where the result is of use, and the first where it is not, drawn at the top."""
    line = sorted(p for p in points if (p.name, p.stiffness) == (name, stiffness))
    return [p._replace(error=min(p.error, 3 * USELESS)) for p in line]


def error_axes(axes: Any, xlabel: str) -> None:
    for one, stiffness in zip(axes.flat, runs.STIFFNESSES, strict=True):
        one.set(xscale="log", yscale="log", ylim=(1e-10, 5), xlabel=xlabel)
        one.set_ylabel("relative error of the force")
        one.set_title(newtons_per_metre(stiffness), fontweight="bold")
        one.xaxis.set_major_formatter("{x:g}")
        one.axhspan(USELESS, 5, color=RED, alpha=0.12, linewidth=0, zorder=0)
        one.axhline(1e-2, color=PALE, linewidth=1, linestyle="--", marker="")
        one.text(1, 1e-2, " 1 %", transform=one.get_yaxis_transform(), va="center", fontsize=8)


def error_figure(axes: Any, points: list[Point]) -> None:
    error_axes(axes, "step in ms")
    for one, stiffness in zip(axes.flat, runs.STIFFNESSES, strict=True):
        system = runs.STYLUS._replace(contact_n_per_m=stiffness)
        for name, (colour, mark) in LOOKS.items():
            line = line_of(points, name, stiffness)
            x = [p.step_s * 1e3 for p in line]
            one.plot(x, [p.error for p in line], color=colour, marker=mark, ms=4, label=name)
            limit = INTEGRATORS[name].limit_s(system)
            if isfinite(limit) and limit <= runs.TICK_S * 2.0**runs.COARSEST:
                one.axvline(limit * 1e3, color=colour, linestyle=":", linewidth=1.6, marker="")
                one.plot([limit * 1e3], [3.8], color=colour, marker=mark, ms=7, clip_on=False)
    axes[0, 0].plot([], [], color=PALE, linestyle=":", marker="", label="largest stable step")
    legend(axes[0, 0])


def pareto_figure(axes: Any, points: list[Point]) -> None:
    error_axes(axes, "CPU ms per simulated second")
    for one, stiffness in zip(axes.flat, runs.STIFFNESSES, strict=True):
        front, least = [], inf
        here = (p for p in points if p.stiffness == stiffness)
        for p in sorted(here, key=lambda p: p.cpu.median):
            if p.error < least:
                front.append((p.cpu.median * 1e3, p.error))
                least = p.error
        one.plot(*zip(*front, strict=True), color=PALE, alpha=0.35, linewidth=9, marker="")
        for name, (colour, mark) in LOOKS.items():
            line = line_of(points, name, stiffness)
            cpu = np.array([p.cpu[:3] for p in line]).T * 1e3
            one.errorbar(
                cpu[0],
                [p.error for p in line],
                xerr=[cpu[0] - cpu[1], cpu[2] - cpu[0]],
                color=colour,
                marker=mark,
                ms=4,
                linewidth=1,
                elinewidth=0.8,
                label=name,
            )
    legend(axes[0, 0])


def energy_figure(axes: Any, bounces: list[Long]) -> None:
    left, right = axes
    for name in runs.DEFAULTS:
        colour, mark = LOOKS[name]
        mine = [b for b in bounces if b.name == name]
        wide = 4 if name == "trapezoid" else 1.5
        for b in mine:
            if b.stiffness == 1e5:
                trace = np.maximum(np.abs(b.trace), 1e-16)
                t = 1 + np.arange(trace.size)
                left.plot(t, trace, color=colour, marker="", linewidth=wide, label=name)
        worst = [max(1e-16, b.gain, *map(abs, b.trace)) for b in mine]
        right.plot([b.stiffness for b in mine], worst, color=colour, marker=mark, label=name)
    left.set(yscale="log", xlabel="seconds", ylabel="relative error of the energy", ylim=(1e-16, 5))
    right.set(xscale="log", yscale="log", xlabel="stiffness in N/m", ylim=(1e-16, 5))
    left.set_title("Over time, at 100 kN/m", fontweight="bold")
    right.set_title("Largest error of each run", fontweight="bold")
    legend(left)
