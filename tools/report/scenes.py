"""Scenes: what they look like, and parts that are left out cost nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from scenes import HEADERS, ROWS, Found, Row, cells, measure_all

from hapfmt.lab.scenes import load_scene, simulate
from report.section import Options, Section, Table, drawn

QUICK_ROWS = 4
"""Everything, lossless, without texture, without contact."""

SHOWN = (
    ("stone", "normal force", 1.0, 1.5),
    ("sand", "normal force", 1.0, 1.5),
    ("cork", "normal force", 1.0, 1.5),
    ("wall", "normal force", 0.3, 0.8),
    ("taps", "normal force", 0.0, 2.0),
    ("grasp", "index force", 0.0, 4.0),
    ("grasp", "index PIP flexion", 0.0, 4.0),
    ("free", "velocity y", 0.0, 4.0),
)
"""Scene, channel, and the seconds that are drawn."""


def section(options: Options) -> Section:
    rows, seconds, repeats = (ROWS[:QUICK_ROWS], 2.0, 1) if options.quick else (ROWS, 10.0, 3)
    found = measure_all(rows, seconds, repeats, lambda name: options.progress(f"scenes: {name}"))
    by_name = {row.name: each for row, each in found}
    return Section(
        "Scenes",
        text_of(by_name, seconds),
        [Table(f"{seconds:g} s of each scene", HEADERS, [cells(*each) for each in found])],
        [
            drawn(
                "Simulated recordings",
                "A part of one channel of each scene, as its sensor measures it.",
                signals,
                height=7.0,
                panels=(4, 2),
            ),
            drawn(
                "What each part costs",
                "CPU time of the simulation and size of the file, relative to the first "
                "row, which has everything.",
                lambda axes: bars(axes, found),
                height=0.35 * len(found) + 1.2,
            ),
        ],
        [{"scene": row.name, **each._asdict()} for row, each in found],
    )


def text_of(by_name: dict[str, Found], seconds: float) -> str:
    whole, flat, free = (by_name[name] for name in ("everything", "no texture", "no contact"))
    texture, contact = (whole.simulate_s / each.simulate_s for each in (flat, free))
    return (
        f"**Without its texture the scene is simulated {texture:.1f} times as fast and its file "
        f"is {whole.file_size / flat.file_size:.1f} times smaller; without contact it is "
        f"simulated {contact:.0f} times as fast.** "
        f"Scene `everything`, {seconds:g} s: a stylus on sand with nine channels, and a hand with "
        "27. Counters show what was computed: no heights without a texture, no contact steps "
        "without a contact, no steps for fingers that touch nothing. The verb is a process of its "
        "own, so its time includes imports. SciPy's filters are loaded only to split a signal."
    )


def signals(axes: Any) -> None:
    for panel, (name, label, start, stop) in zip(axes.flat, SHOWN, strict=True):
        recording, _ = simulate(load_scene(name))
        channel = recording.channel(label)
        rows = slice(round(start * channel.rate_exact), round(stop * channel.rate_exact))
        t = np.arange(rows.start, rows.stop) / channel.rate
        panel.plot(t, channel.samples()[rows], linewidth=0.9, marker="")
        panel.set_title(f"{name}: {label}, {channel.unit}")
    for panel in axes[-1]:
        panel.set_xlabel("seconds")


def bars(axes: Any, found: list[tuple[Row, Found]]) -> None:
    first = found[0][1]
    places = np.arange(len(found))
    for shift, label, of in (
        (-0.2, "CPU time of the simulation", lambda each: each.simulate_s / first.simulate_s),
        (0.2, "size of the file", lambda each: each.file_size / first.file_size),
    ):
        axes.barh(places + shift, [of(each) for _, each in found], height=0.38, label=label)
    axes.set_yticks(places, [row.name for row, _ in found])
    axes.invert_yaxis()
    axes.figure.legend(loc="outside upper center", ncols=2)
    axes.set_xlabel("share of the first row")
