"""Stability: each stiff or extreme case, the naive way and ours; four of them drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from stability import Row, rows
from stability.filters import butterworth
from stability.playing import STEP_N, scheduled
from stability.ranges import range_derived
from stability.scenes import HAND, run
from stability.signals import RATE, back, contact, force, texture

from hapfmt.kernels import compiled
from hapfmt.lab.scenes.contact import System, default_step_s
from report.section import COLOURS, PALE, Options, Section, Table, drawn

HEADERS = ["row", "case", "naive", "ours", "unit", "what must hold", "holds", "note"]


def section(options: Options) -> Section:
    found = rows(deep=not options.quick, progress=options.progress)
    return Section(
        "Stability",
        text_of(found),
        [Table("Stiff and extreme cases", HEADERS, [cells(row) for row in found])],
        [
            drawn(
                "Four of the cases",
                "Grey: the recorded samples. Dotted: the result of a naive method. Line: the "
                "result of hapfmt. The panels are rows 5, 8, 19 and 20 of the table.",
                draw,
                width=8.5,
                height=6.0,
                panels=(2, 2),
            )
        ],
        [row._asdict() for row in found],
    )


def cells(row: Row) -> list[str | int | float | bool]:
    return [row.number, row.case, row.naive, row.ours, row.unit, row.limits, row.ok, row.note]


def text_of(found: Sequence[Row]) -> str:
    failed = [f"row {row.number} ({row.case})" for row in found if not row.ok]
    held = f"{len(found) - len(failed)} of {len(found)}"
    loops = "the compiled loops" if compiled else "the readable Python loops"
    return (
        f"**{held} stiff and extreme cases hold{', all of them' if not failed else ''}.** "
        + (f"**Not: {', '.join(failed)}.** " if failed else "")
        + f"Both results of each row are computed here, with {loops}. The naive result must be as "
        "bad as the row says, and ours as good. They are tests too (`tests/test_stability.py`), "
        "which run with and without the compiled loops."
    )


def draw(axes: Any) -> None:
    for panel, picture in zip(axes.flat, (touch, glitch, jumps, stiff), strict=True):
        picture(panel)
    axes.flat[0].figure.legend(
        *axes.flat[0].get_legend_handles_labels(), loc="outside upper center", ncols=3
    )


def lines(panel: Any, x: Any, recorded: Any, naive: Any, ours: Any) -> None:
    """Each an array over x, None where there is none."""
    if recorded is not None:
        panel.plot(x, recorded, color=PALE, linewidth=4, alpha=0.45, marker="", label="recorded")
    panel.plot(x, naive, color=COLOURS[1], linestyle=":", marker="", label="naive")
    panel.plot(x, ours, color=COLOURS[0], marker="", label="hapfmt")


def touch(panel: Any) -> None:
    at = 1000
    x = contact(2000, at)
    ms = np.arange(-150, 60)
    shown = slice(at + ms[0], at + ms[-1] + 1)
    slow = back(force(x), band="lf").samples()
    lines(panel, ms, x[shown], butterworth(x, 8)[shown], slow[shown])
    panel.set_ylim(-0.5, 1.2)
    panel.set_title("Slow part before a contact of 3.3 N")
    panel.set_xlabel("ms")
    panel.set_ylabel("N")


def glitch(panel: Any) -> None:
    x = 1 + texture(8000, 0.03)
    x[4000] = 1000
    shown = slice(2000, 2080)
    y = back(force(x)).samples()
    lines(panel, np.arange(80), x[shown], range_derived(x)[shown], y[shown])
    panel.set_title("Texture, 2 s before a glitch of 1 kN")
    panel.set_xlabel("ms")
    panel.set_ylabel("N")


def jumps(panel: Any) -> None:
    x = 1.4 * np.cos(2 * np.pi * 0.4 * np.arange(4000) / RATE)
    sent = scheduled(x) * STEP_N
    naive = np.concatenate([x[:1500], x[2000:3000], np.zeros(sent.size)])[: sent.size]
    lines(panel, np.arange(sent.size) / RATE, None, naive, sent)
    panel.set_title("Start, seek at 1.5 s, stop at 2.5 s")
    panel.set_xlabel("seconds")
    panel.set_ylabel("N")


def stiff(panel: Any) -> None:
    system = System(*HAND, 1e4)
    dt = default_step_s(system)
    stride = round(1e-3 / dt)
    ours = run(system, dt, "exact")[0].force[::stride]
    naive = run(system, 1e-3, "explicit-euler")[0].force
    shown = slice(0, 500)
    lines(panel, np.arange(500), None, naive[shown], ours[shown])
    panel.set_title("60 g on 10 kN/m: steps 1 ms, 50 µs (hapfmt)")
    panel.set_xlabel("ms")
    panel.set_ylabel("N")
