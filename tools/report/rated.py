"""Fig. 5, measured: the paper let people rate each reconstruction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any, NamedTuple

import hapfmt
from hapfmt.lab.scenes import builtin_names, load_scene
from hapfmt.metrics import st_sim
from report.felt import GRASPED_DB, Felt, felt
from report.paper_figures import PERCENT, Curve, fig5, most_textured
from report.ratio import BITS, Source, measure, settings
from report.section import Figure, Options

FIG5_BITS = (0, 2, 3, 4, 5, 6, 7, 8)


class Rated(NamedTuple):
    """One reconstruction of the most textured channel. felt: of a force in newtons only."""

    name: str
    bits: int
    payload_percent: float
    snr_db: float
    felt: Felt | None
    similarity: float | None


def rate(source: Source, options: Options) -> list[Rated]:
    """Every b. A recorded force is felt as if it were that of the scenes' stylus. ST-SIM for the
    paper's own b, since it takes a second each."""
    options.progress(f"felt errors of {source.name}")
    tool = load_scene(source.name if source.name in builtin_names() else "sand").tool
    source = most_textured(source)
    (channel,) = source.recording.channels
    f = channel.samples()
    found = []
    for bits in BITS if options.quick else FIG5_BITS:
        point = measure(source, settings(PERCENT, bits, source.floor))
        y = hapfmt.read(point.file).channels[0].samples()
        alike = st_sim(f, y, channel.rate_exact) if find_spec("vibromaf") and bits in BITS else None
        of_error = felt(f, y, channel.rate, tool) if tool and channel.unit == "N" else None
        found.append(Rated(source.name, bits, point.payload_percent, point.snr_db, of_error, alike))
    return found


def ratings(rated: list[Rated]) -> tuple[Any, list[Any]]:
    """Headers and rows."""
    headers = (
        "recording", "b", "payload, % of doubles", "HF SNR, dB", "texture over threshold, dB",
        "error over threshold, dB", "error felt, % of the time",
        f"the same, threshold {GRASPED_DB:g} dB lower", "ST-SIM",
    )  # fmt: skip

    def cells(felt: Felt | None) -> Sequence[float | None]:
        if felt is None:
            return (None,) * len(Felt._fields)
        return felt.texture_db, felt.error_db, 100 * felt.share, 100 * felt.share_grasped

    rows = [
        (each.name, each.bits or "none", each.payload_percent, each.snr_db, *cells(each.felt),
         each.similarity)
        for each in rated
    ]  # fmt: skip
    return headers, rows


def picture5(rated: list[Rated], what: str) -> Figure:
    bits = sorted({each.bits for each in rated})
    names = list(dict.fromkeys(each.name for each in rated))

    def lines(of: Callable[[Rated], float | None]) -> list[list[float | None]]:
        return [[of(each) for each in rated if each.name == name] for name in names]

    def felt_lines(of: Callable[[Felt], float]) -> list[list[float | None]]:
        return lines(lambda each: of(each.felt) if each.felt else None)

    curves = [Curve("texture against error", "HF SNR in dB", lines(lambda each: each.snr_db))]
    if any(each.felt for each in rated):
        curves += [
            Curve("error over threshold", "dB over vibrotactile threshold",
                  felt_lines(lambda felt: felt.error_db), [(0, "just felt")]),
            Curve("error felt", "% of the time", felt_lines(lambda felt: 100 * felt.share),
                  others=felt_lines(lambda felt: 100 * felt.share_grasped),
                  other=f"dashed: {GRASPED_DB:g} dB\nmore sensitive"),
        ]  # fmt: skip
    if any(each.similarity is not None for each in rated):
        curves.append(Curve("ST-SIM", "similarity", lines(lambda each: each.similarity)))
    return fig5(
        names,
        bits,
        curves,
        f"Fig. 5, measured: {what}, k = {PERCENT} %",
        "These are measures, no ratings: no people took part. An error counts as felt where it is "
        "above the vibrotactile threshold and changes the vibration by at least a fifth (the "
        "smallest Weber fraction reported). Only forces are judged: the motion that a torque "
        "causes depends on its lever.",
    )


def least_unfelt(rated: list[Rated], share: Callable[[Felt], float]) -> str:
    """The least b from which on no error is felt for a hundredth of the time."""
    felt_at = [each.bits for each in rated if each.felt and share(each.felt) >= 0.01]
    more = [each.bits for each in rated if each.bits > max(felt_at, default=-1)]
    return f"b = {min(more)}" if more else "no b that was measured"


def similarity_of(rated: list[Rated], textures: Sequence[str]) -> str:
    """A paragraph on ST-SIM, or nothing where it was not measured."""
    best = [each for each in rated if each.similarity is not None and each.bits == max(BITS)]
    if not best:
        return ""
    of_textures = min(each.similarity or 0 for each in best if each.name in textures)
    worst = min(best, key=lambda each: each.similarity or 0)
    return (
        "* **ST-SIM** (package vibromaf) divides by the energy of the original alone, so a "
        "slightly louder reconstruction exceeds 1. Quiet blocks weigh as much as loud ones. "
        f"With b = {max(BITS)} the textures reach {of_textures:.3f}, {worst.name} "
        f"{worst.similarity:.2f} at an HF SNR of {worst.snr_db:.1f} dB.\n"
    )
