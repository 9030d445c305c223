"""Texture from a model: the order of the model against size and quality, the trade-off that the
paper names as future work."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import ceil
from typing import Any, NamedTuple

import numpy as np
import texture_rates
from measured import write_rows
from texture_rates import APART_S, SAMPLES, Coded, Texture, nois, slow_track

from hapfmt.metrics import band_energy_error_db, snr_hf_db
from hapfmt.split import low_pass
from report.section import (
    COLOURS,
    MARKERS,
    PALE,
    CannotRunError,
    Figure,
    Options,
    Section,
    Table,
    drawn,
)

ORDERS = (0, 1, 2, 4, 6, 8, 12, 16, 24, 32)
COLUMNS = 3
HEADERS = ["recording", "rate, Hz", "order", "bit/s", "error of band energies, dB",
           "the texture itself 0.5 s later, dB", "order of the encoder"]  # fmt: skip


SHARES = (4.0, 2.0, 1.0, 0.5, 0.25)
"""Steps of the coded textures, as shares of the standard deviation above 20 Hz."""

THRESHOLD = "1%"
"""The threshold of the deadband of the slow part below a model."""

SHOWN = ("paper", "LPCR", "MDCT")

MODEL = "model"
SHOWN_ORDERS = (0, 2, 8, 16, 32)
"""Those of docs/synthetic-textures.md."""

BESIDE = ["recording", "codec", "step / standard deviation", "bit/s", "error of band energies, dB",
          "SNR above 20 Hz, dB"]  # fmt: skip


class Beside(NamedTuple):
    """A codec with one step, slow part included."""

    name: str
    codec: str
    share: float | None
    """None: a model has no step."""

    bits_per_s: float
    error_db: float
    snr_db: float


class Modelled(NamedTuple):
    name: str
    rate_hz: float
    order: int
    bits_per_s: float
    error_db: float
    own_db: float
    """The error of the texture against itself."""

    chosen: bool
    """Whether the encoder takes this order."""


def section(options: Options) -> Section:
    found: list[Modelled] = []
    others: list[Beside] = []
    for texture in textures(options):
        found += modelled(texture)
        others += beside(texture)
        options.progress(f"model: {texture.name}")
    if not found:
        raise CannotRunError("no texture could be measured")
    if options.write:
        write_rows("orders", order_rows(found))
    return Section(
        "Texture from a model",
        text_of(found, others),
        [
            Table("Order of the model, size and quality", HEADERS, [list(row) for row in found]),
            Table("A model and coded textures", BESIDE, [list(row) for row in others]),
        ],
        [picture(found), picture_beside(others)],
        {"orders": [row._asdict() for row in found], "beside": [r._asdict() for r in others]},
    )


def order_rows(found: Sequence[Modelled]) -> list[list[str]]:
    """One row for each texture, for the page."""
    rows = []
    for name in dict.fromkeys(row.name for row in found):
        own = {row.order: row for row in found if row.name == name}
        taken = next(row for row in own.values() if row.chosen)
        errors = [f"{own[order].error_db:.1f}" for order in SHOWN_ORDERS]
        size = [f"{taken.order}", f"{taken.bits_per_s:.0f}"]
        ends = [f"{taken.error_db:.1f}", f"{taken.own_db:.1f}"]
        rows.append([f"{name}, {taken.rate_hz:g} Hz", *errors, *size, *ends])
    return rows


def textures(options: Options) -> Iterator[Texture]:
    if options.quick or options.data is None:
        yield from texture_rates.simulated(4.0)
    else:
        yield from texture_rates.recorded(options.data, SAMPLES)


def modelled(texture: Texture) -> Iterator[Modelled]:
    """The HF track alone, at each order. The slow part is kept as it is."""
    slow = low_pass(texture.x, texture.rate_hz)
    later = ceil(APART_S * texture.rate_hz)
    own = band_energy_error_db(texture.x[:-later], texture.x[later:], texture.rate_hz)
    _, chosen = nois(texture)
    for order in sorted({*ORDERS, chosen}):
        coded, _ = nois(texture, order)
        yield Modelled(
            texture.name,
            texture.rate_hz,
            order,
            coded.bits * texture.rate_hz,
            band_energy_error_db(texture.x, slow + coded.y, texture.rate_hz),
            own,
            order == chosen,
        )


def beside(texture: Texture) -> Iterator[Beside]:
    """The model, and codecs of tools/texture_rates.py with each step, in their smallest way."""
    found: list[tuple[str, float | None, Coded]] = []
    bits, slow = slow_track(texture, THRESHOLD)
    fast, _ = nois(texture)
    found.append((MODEL, None, Coded(bits + fast.bits, slow + fast.y)))
    for codec, share in product(SHOWN, SHARES):
        ways = texture_rates.CODECS[codec]
        each = [way(texture, share * texture.level) for way in ways]
        found.append((codec, share, min(each, key=lambda coded: coded.bits)))
    for codec, share, coded in found:
        error = band_energy_error_db(texture.x, coded.y, texture.rate_hz)
        snr = snr_hf_db(texture.x, coded.y, texture.rate_hz)
        yield Beside(texture.name, codec, share, coded.bits * texture.rate_hz, error, snr)


def text_of(found: Sequence[Modelled], others: Sequence[Beside]) -> str:
    taken = [row for row in found if row.chosen]
    better = sum(row.error_db <= row.own_db for row in taken)
    least, most = (f(row.bits_per_s for row in taken) for f in (min, max))
    first = (
        f"A model of {min(row.order for row in taken)} to {max(row.order for row in taken)} "
        f"coefficients takes {least:.0f} to {most:.0f} bit/s for a texture. Its band energies are "
        f"as near to the recording as those of the recording {APART_S:g} s later, or nearer, on "
        f"{better} of {len(taken)} textures."
    )
    flat = [row for row in found if row.order == 0]
    lines = [
        first,
        "* **Order.** Without a filter the error is "
        f"{np.mean([row.error_db for row in flat]):.1f} dB on the mean of the textures. With 8 "
        f"coefficients it is {mean_at(found, 8):.1f} dB, with 32 {mean_at(found, 32):.1f} dB.",
        "* **What is measured.** The HF track of `--synthetic-texture` alone, above a slow part "
        "that is kept as it is. The noise is another one than that of the recording, so measures "
        "of samples (SNR, ST-SIM) do not apply. `band_energy_error_db` compares the energies of "
        "ten bands in blocks of 128 ms.",
        f"* **Beside coded textures.** {cheapest(others)} A coded texture also keeps the samples, "
        "and a model does not: its SNR is below 0 dB.",
    ]
    return "\n\n".join([lines[0], "\n".join(lines[1:])])


def cheapest(others: Sequence[Beside]) -> str:
    """What coded textures need for band energies as near as those of the model."""
    ratios = []
    for model in (row for row in others if row.codec == MODEL):
        rates = [
            row.bits_per_s for row in others
            if row.name == model.name and row.codec != MODEL and row.error_db <= model.error_db
        ]  # fmt: skip
        if rates:
            ratios.append(min(rates) / model.bits_per_s)
    if not ratios:
        return "No coded texture has band energies as near as those of the model."
    return (
        f"For band energies as near as those of the model, the smallest coded texture takes "
        f"{np.median(ratios):.1f} times the bits (median; {len(ratios)} textures)."
    )


def mean_at(found: Sequence[Modelled], order: int) -> float:
    return float(np.mean([row.error_db for row in found if row.order == order]))


def picture(found: Sequence[Modelled]) -> Figure:
    names = list(dict.fromkeys(row.name for row in found))
    columns = min(COLUMNS, len(names))
    lines = ceil(len(names) / columns)

    def draw(panels: Any) -> None:
        flat = list(panels.flat)
        for axes in flat[len(names) :]:
            axes.set_visible(False)
        for axes, name in zip(flat, names, strict=False):
            rows = [row for row in found if row.name == name]
            axes.axhline(rows[0].own_db, color=PALE, linewidth=1, linestyle="--")
            axes.plot([r.bits_per_s for r in rows], [r.error_db for r in rows], "o-")
            for row in rows:
                if row.order in (0, 2, 8, 16, 32) or row.chosen:
                    axes.annotate(
                        str(row.order), (row.bits_per_s, row.error_db), fontsize=7,
                        xytext=(3, 4), textcoords="offset points",
                        fontweight="bold" if row.chosen else "normal",
                    )  # fmt: skip
            axes.set_title(name, fontsize=8.5)
            axes.set_ylim(0, max(*(r.error_db for r in rows), rows[0].own_db) * 1.15)
            axes.set_xlim(0, max(r.bits_per_s for r in rows) * 1.1)
            axes.tick_params(labelsize=7)
        flat[0].figure.supxlabel("bit/s", fontsize=9)
        flat[0].figure.supylabel("error of band energies, dB", fontsize=9)

    return drawn(
        "Order of the model, size and quality",
        "Each mark is one order; the bold one is what the encoder takes. The dashed line is the "
        "recorded texture against itself half a second later.",
        draw, width=3.6 * columns, height=0.6 + 2.2 * lines, panels=(lines, columns),
        squeeze=False,
    )  # fmt: skip


def picture_beside(others: Sequence[Beside]) -> Figure:
    """Rate against the error of band energies, a panel for each recording."""
    names = list(dict.fromkeys(row.name for row in others))
    codecs = list(dict.fromkeys(row.codec for row in others))
    columns = min(COLUMNS, len(names))
    lines = ceil(len(names) / columns)

    def draw(panels: Any) -> None:
        flat = list(panels.flat)
        for axes in flat[len(names) :]:
            axes.set_visible(False)
        for axes, name in zip(flat, names, strict=False):
            for place, codec in enumerate(codecs):
                rows = [row for row in others if (row.name, row.codec) == (name, codec)]
                axes.plot(
                    [row.bits_per_s / 1000 for row in rows], [row.error_db for row in rows],
                    color=COLOURS[place], marker=MARKERS[place], label=codec,
                )  # fmt: skip
            axes.set_xscale("log")
            low, high = axes.get_xlim()
            ticks = [t for t in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50) if low <= t <= high]
            axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
            axes.set_xticks([], minor=True)
            axes.set_ylim(bottom=0)
            axes.set_title(name, fontsize=8.5)
            axes.tick_params(labelsize=7)
        handles, labels = flat[0].get_legend_handles_labels()
        flat[0].figure.legend(handles, labels, loc="outside upper center", ncols=6)
        flat[0].figure.supxlabel("kbit/s", fontsize=9)
        flat[0].figure.supylabel("error of band energies, dB", fontsize=9)

    return drawn(
        "A model and coded textures",
        f"All with their slow part; its deadband has a threshold of {THRESHOLD} of the range. "
        "A mark of a coded texture is one step of its quantiser.",
        draw, width=3.6 * columns, height=0.9 + 2.2 * lines, panels=(lines, columns),
        squeeze=False,
    )  # fmt: skip
