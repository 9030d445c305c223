"""The paper, reproduced: its figures 2 and 4, and measures in the place of figure 5.

F. Brandi, R. Chaudhari, E. Steinbach, "Texture compensation for haptic feedback signal
compression", VECIMS 2011, https://doi.org/10.1109/VECIMS.2011.6053837.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ratio import BITS, SECONDS, TEXTURES, WEBER, Point, Source, grid, recorded, simulated

from report.felt import GRASPED_DB
from report.paper_figures import PERCENT, fig4, picture2
from report.rated import Rated, least_unfelt, picture5, rate, ratings, similarity_of
from report.section import Figure, Options, Section, Table
from report.variants import HEADERS, Changed, parts_of, variants

TITLE = "The paper, reproduced"

SHOWN = "sand"
"""Fig. 2, and the table of choices."""

PICTURED = (SHOWN, "hand-guided, force")

NORMAL_BITS = math.log2(2 * math.pi * math.e) / 2
"""Differential entropy of a normal distribution of rms 1."""

NOTED_POINTS = (3.1, 3.7)
"""What b = 5 adds on sand for k up to 10 %, of the paper (NOTED)."""

ABSTRACT = "abstract of the paper"
NOTED = "its Fig. 4 as this project noted it down, not checked against the paper again"


def section(options: Options) -> Section:
    seconds = 2.0 if options.quick else SECONDS
    weber = (1, 10, 50) if options.quick else WEBER
    sources = simulated(seconds)
    others = recorded(options.data, 1 if options.quick else 3)
    options.progress("compression ratios")
    points = {source.name: list(grid(source, weber, BITS)) for source in sources + others}
    rated = [each for source in sources + others for each in rate(source, options)]
    sand = sources[TEXTURES.index(SHOWN)]
    options.progress("what each choice costs")
    changed = {bits: variants(sand, PERCENT, bits) for bits in (2, 5)}
    peaks = [peak_of(source, points[source.name]) for source in sources + others]
    return Section(
        TITLE,
        text_of(points, rated, changed, peaks, seconds),
        [
            Table("Fig. 4: compression ratio against k", *ratios(points)),
            Table("In place of Fig. 5: what of the error could be felt", *ratings(rated)),
            Table("Where the paper says more, or other", *differences(points)),
            Table(f"What each choice costs: {sand.name}, k = {PERCENT} %", *choices(changed)),
            Table(
                "Bits of a residual follow from its peaks",
                PEAK_HEADERS,
                sorted(peaks, key=lambda row: row[1]),
            ),
        ],
        [
            *(picture2(source) for source in [sand, *others] if source.name in PICTURED),
            *pictures4(points, len(sources)),
            *pictures5(rated),
        ],
        {
            "seconds": seconds,
            "fig4": {
                name: [point_data(point) for point in found] for name, found in points.items()
            },
            "fig5": [each._asdict() for each in rated],
            "choices": {bits: [each._asdict() for each in rows] for bits, rows in changed.items()},
            "peaks": [dict(zip(PEAK_HEADERS, row, strict=True)) for row in peaks],
        },
    )


def point_data(point: Point) -> dict[str, Any]:
    """Without the file."""
    return {
        "k_percent": point.percent,
        "bits": point.bits,
        "samples": point.sample_count,
        "payload_bytes": point.payload_size,
        "file_bytes": point.file_size,
        "payload_percent": point.payload_percent,
        "file_percent": point.file_percent,
        "hf_snr_db": point.snr_db,
    }


def at(points: list[Point], percent: float, bits: int) -> Point:
    """The setting, or of those measured the one with the nearest k."""
    return min(
        (point for point in points if point.bits == bits),
        key=lambda point: abs(point.percent - percent),
    )


def added(points: list[Point], percent: float, bits: int) -> float:
    """Points of the compression ratio that a residual of so many bits adds."""
    with_it, without = at(points, percent, bits), at(points, percent, 0)
    return with_it.payload_percent - without.payload_percent


Peak = tuple[str, float, float, float, float]
PEAK_HEADERS = (
    "recording", "peak of the residual over its rms", "b = 5 adds, points", "bits a sample",
    "bits of a normal distribution",
)  # fmt: skip


def peak_of(source: Source, points: list[Point]) -> Peak:
    """At k = PERCENT, of the recording's first channel the peak, of all channels the points."""
    f = source.recording.channels[0].samples()
    e = f - parts_of(at(points, PERCENT, 0).file).slow
    peak, more = float(np.max(np.abs(e)) / np.std(e)), added(points, PERCENT, 5)
    return source.name, peak, more, more * 64 / 100, math.log2((2**4 - 1) / peak) + NORMAL_BITS


def ratios(points: dict[str, list[Point]]) -> tuple[Any, list[Any]]:
    headers = (
        "recording", "k, %", "b", "payload, % of doubles", "file, % of doubles",
        "reduction by payload, %", "doubles / file", "HF SNR, dB",
    )  # fmt: skip
    rows = [
        (
            name, point.percent, point.bits or "none", point.payload_percent, point.file_percent,
            100 - point.payload_percent, 100 / point.file_percent, point.snr_db,
        )
        for name, found in points.items()
        for point in found
    ]  # fmt: skip
    return headers, rows


def choices(changed: dict[int, list[Changed]]) -> tuple[Any, list[Any]]:
    rows = [(bits, *each) for bits, found in changed.items() for each in found]
    return ("b", *HEADERS), rows


def differences(points: dict[str, list[Point]]) -> tuple[Any, list[Any]]:
    """What the paper reports beside what came out here."""
    textures = [points[name] for name in TEXTURES]

    def three(of: Any, digits: int = 1) -> str:
        return ", ".join(f"{of(found):.{digits}f}" for found in textures)

    def less(percent: float, bits: int) -> Any:
        return lambda found: 100 - at(found, percent, bits).payload_percent

    most = max(point.percent for point in textures[0])
    rows = [
        ("storage saved with texture kept", "up to 97 %", ABSTRACT,
         f"{three(less(PERCENT, 5))} % at b = 5; {three(less(PERCENT, 2))} % at b = 2",
         "the abstract names no b and no k; b = 2 keeps no texture here"),
        ("b = 2, k = 10 %, saved", "97 %", NOTED, f"{three(less(PERCENT, 2))} %",
         "runs of zeros have their own symbols here: most of such a residual is 0, and a word "
         "for each sample costs 1.6 points at least"),
        ("deadband alone, saved", "up to 99.7 %", NOTED,
         f"{three(less(PERCENT, 0))} % at k = 10 %, {three(less(most, 0), 2)} % at {most:g} %",
         "the paper's sessions, k and floor are not known to us"),
        ("b = 5 adds, k to 10 %, sand", f"{NOTED_POINTS[0]}-{NOTED_POINTS[1]} points", NOTED,
         f"{three(lambda found: added(found, PERCENT, 5))} points",
         "ours peaks little over its rms and uses all levels: last table"),
        ("size beyond k = 20 %, b = 5", "flat or rising", NOTED,
         f"{three(lambda found: change(found, most, 5))} points from 20 to {most:g} %",
         "the step grows with the residual's range, so that fewer bits buy less: "
         f"HF SNR {three(lambda found: at(found, 20, 5).snr_db)} dB at 20 %, "
         f"{three(lambda found: at(found, most, 5).snr_db)} dB at {most:g} %"),
        ("Fig. 5, rating", "0-100 by subjects", "the paper", "none",
         "people rate: `hapfmt rate`. Here stand measures, and no mapping from them to a rating, "
         "since nothing at hand justifies one"),
    ]  # fmt: skip
    return ("what", "paper", "source", "here: stone, sand, cork", "why, or what is not known"), rows


def change(found: list[Point], percent: float, bits: int) -> float:
    return at(found, percent, bits).payload_percent - at(found, 20, bits).payload_percent


def pictures4(points: dict[str, list[Point]], count: int) -> list[Figure]:
    caption = (
        "Solid lines count the packets alone, as the paper does. Dashed lines count whole files, "
        "with descriptions and index. Lower is smaller: 5 % of the samples means 95 % saved."
    )
    names = list(points)
    found = [fig4({name: points[name] for name in names[:count]},
                  "Fig. 4: compression ratio, simulated textures", caption)]  # fmt: skip
    if names[count:]:
        found.append(fig4({name: points[name] for name in names[count:]},
                          "Fig. 4: compression ratio, recordings", caption))  # fmt: skip
    return found


def pictures5(rated: list[Rated]) -> list[Figure]:
    simulated = [each for each in rated if each.name in TEXTURES]
    others = [each for each in rated if each.name not in TEXTURES]
    found = [picture5(simulated, "simulated textures")]
    return [*found, picture5(others, "recordings")] if others else found


def text_of(
    points: dict[str, list[Point]], rated: list[Rated], changed: dict[int, list[Changed]],
    peaks: list[Peak], seconds: float,
) -> str:  # fmt: skip
    sand = points[SHOWN]
    alone, coded, last = at(sand, PERCENT, 0), at(sand, PERCENT, 5), at(sand, 100, 5)
    textures = [each for each in rated if each.name in TEXTURES]
    unfelt = least_unfelt(textures, lambda felt: felt.share)
    grasped = least_unfelt(textures, lambda felt: felt.share_grasped)
    paper, *_, predicted = changed[5]
    tapped = next(each for each in changed[5] if each.name.startswith("one tap"))
    opened = next(each for each in changed[5] if each.name.startswith("open loop"))
    names = [row[0] for row in sorted(peaks, key=lambda row: row[1])]
    by_name = {row[0]: row for row in peaks}
    flat, peaky = by_name[names[0]], by_name[names[-1]]
    return f"""\
**On simulated sand the paper's method takes {coded.payload_percent:.1f} % of the doubles at \
k = {PERCENT} % and b = 5, of which the deadband's part is {alone.payload_percent:.1f} %; from \
{unfelt} on the error would not be felt.** \
Stylus on stone, sand and cork of `hapfmt.scenes`, {seconds:g} s each at 1 kHz (the paper's \
sessions have 11 s), preset `paper`, floor 10 mN. F. Brandi, R. Chaudhari, E. Steinbach, \
[VECIMS 2011](https://doi.org/10.1109/VECIMS.2011.6053837). All numbers are computed here; those \
of the paper stand in one table, each with where it is from.

* **Deadband alone**: smallest by far, and no texture: its error is larger than the texture \
(HF SNR {alone.snr_db:.1f} dB). b = 2 does not bring it back: the outer two of its three levels \
are reached by peaks only.
* **Not felt** means: in less than 1 % of the time over the vibrotactile threshold and over the \
least difference that is noticed. With a threshold {GRASPED_DB:g} dB lower, the least reported \
for a cylinder in the grasp, it holds from {grasped} on. The threshold is taken for a stylus of \
60 g in a hand. It measures the error; it is no rating.
{similarity_of(rated, TEXTURES)}\
* **The step comes from the residual's range.** One tap ahead of the same session leaves b = 5 \
with {tapped.snr_db:.1f} dB in place of {paper.snr_db:.1f} dB. And larger k makes files with a \
residual hardly smaller: with b = 5 {coded.payload_percent:.1f} % at k = {coded.percent:g} %, \
{last.payload_percent:.1f} % at k = {last.percent:g} %, and that at {last.snr_db:.1f} dB.
* **b = 5 costs more here** than the paper's {NOTED_POINTS[0]}-{NOTED_POINTS[1]} points. The more \
a residual peaks over its rms, the fewer of its levels are used: {flat[0]} peaks at \
{flat[1]:.1f} times its rms and takes {flat[2]:.1f} points, {peaky[0]} at {peaky[1]:.1f} times, \
and takes {peaky[2]:.1f} (last table). How the paper's sessions peak is not known.
* **Closed loop**: with f - l in place of f - d the residual is smaller, and \
{opened.outside_percent:.1f} % of the samples leave the deadband; here \
{paper.outside_percent:.1f} %.
* **This format's own way**: prediction at the same step (`near-lossless`) takes \
{predicted.payload_percent:.1f} % in place of {paper.payload_percent:.1f} %.
"""
