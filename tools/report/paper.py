"""The paper, reproduced: its figures 2 and 4, and measures in the place of figure 5.

F. Brandi, R. Chaudhari, E. Steinbach, "Texture compensation for haptic feedback signal
compression", VECIMS 2011, https://doi.org/10.1109/VECIMS.2011.6053837.
"""

from __future__ import annotations

import math
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from ratio import BITS, SECONDS, TEXTURES, WEBER, Point, Source, grid, recorded, settings, simulated
from ratio import measure as measure_point

import hapfmt
from hapfmt.metrics import st_sim
from hapfmt.scenes import load_scene
from report.felt import GRASPED_DB, Felt, felt
from report.paper_figures import Curve, Stretch, fig2, fig4, fig5
from report.section import Figure, Options, Section, Table
from report.variants import HEADERS, Changed, parts_of, variants

TITLE = "The paper, reproduced"

PERCENT = 10
"""Weber fraction of figures 2 and 5, in %: the paper's value for forces."""

FIG2_TEXTURE, FIG2_BITS = "sand", 5
FIG2_START_S, FIG2_LONG_S, FIG2_ZOOM_S = 0.45, 1.5, 0.2

FIG5_BITS = (0, 2, 3, 4, 5, 6, 7, 8)

NORMAL_BITS = math.log2(2 * math.pi * math.e) / 2
"""Differential entropy of a normal distribution of rms 1."""

NOTED_POINTS = (3.1, 3.7)
"""What b = 5 adds on sand for k up to 10 %, of the paper (NOTED)."""

SIMILAR = """\
* **ST-SIM** (package vibromaf) says the same, but divides by the energy of the original alone: a \
reconstruction that is a little louder passes 1.
"""

ABSTRACT = "abstract of the paper"
NOTED = "its Fig. 4 as this project noted it down, not checked against the paper again"


class Rated(NamedTuple):
    """One reconstruction, measured in place of a rating."""

    texture: str
    bits: int
    payload_percent: float
    snr_db: float
    felt: Felt
    similarity: float | None


def section(options: Options) -> Section:
    seconds = 2.0 if options.quick else SECONDS
    weber = (1, 10, 50) if options.quick else WEBER
    sources = simulated(seconds)
    others = recorded(options.data, 1 if options.quick else 3)
    options.progress("compression ratios")
    points = {source.name: list(grid(source, weber, BITS)) for source in sources + others}
    rated = [each for source in sources for each in rate(source, options)]
    sand = sources[TEXTURES.index(FIG2_TEXTURE)]
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
        [picture2(sand), *pictures4(points, len(sources)), picture5(rated)],
        {
            "seconds": seconds,
            "fig4": {
                name: [point_data(point) for point in found] for name, found in points.items()
            },
            "fig5": [each._asdict() | {"felt": each.felt._asdict()} for each in rated],
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


def rate(source: Source, options: Options) -> list[Rated]:
    """Every b of one texture. ST-SIM for the paper's own, since it takes a second each."""
    options.progress(f"what is felt of {source.name}")
    tool = load_scene(source.name).tool
    if tool is None:
        raise ValueError(f"scene {source.name} has no tool to be felt through")
    (channel,) = source.recording.channels
    f, rate_hz = channel.physical(), float(channel.rate)
    found = []
    for bits in BITS if options.quick else FIG5_BITS:
        point = measure_point(source, settings(PERCENT, bits, source.floor))
        y = hapfmt.read(point.file).channels[0].physical()
        alike = st_sim(f, y, channel.rate) if find_spec("vibromaf") and bits in BITS else None
        of_error = felt(f, y, rate_hz, tool)
        found.append(Rated(source.name, bits, point.payload_percent, point.snr_db, of_error, alike))
    return found


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
    f = source.recording.channels[0].physical()
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


def ratings(rated: list[Rated]) -> tuple[Any, list[Any]]:
    headers = (
        "texture", "b", "payload, % of doubles", "HF SNR, dB", "texture over threshold, dB",
        "error over threshold, dB", "error felt, % of the time",
        f"the same, threshold {GRASPED_DB:g} dB lower", "ST-SIM",
    )  # fmt: skip
    rows = [
        (
            each.texture, each.bits or "none", each.payload_percent, each.snr_db,
            each.felt.texture_db, each.felt.error_db, 100 * each.felt.share,
            100 * each.felt.share_grasped, each.similarity,
        )
        for each in rated
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


def picture2(source: Source) -> Figure:
    point = measure_point(source, settings(PERCENT, FIG2_BITS, source.floor))
    (channel,) = source.recording.channels
    parts, f, rate = parts_of(point.file), channel.physical(), float(channel.rate)
    half = np.maximum(PERCENT / 100 * np.abs(f), float(source.floor))
    largest = float(np.max(np.abs(parts.whole - f) / half))

    def stretch(start_s: float, seconds: float) -> Stretch:
        rows = slice(round(start_s * rate), round((start_s + seconds) * rate))
        t = np.arange(rows.start, rows.stop) / rate
        knots = parts.knots[(parts.knots >= rows.start) & (parts.knots < rows.stop)] - rows.start
        return Stretch(t, f[rows], parts.slow[rows], parts.whole[rows], knots, half[rows])

    middle = FIG2_START_S + FIG2_LONG_S / 2
    knot = parts.knots[np.argmin(np.abs(parts.knots - middle * rate))] / rate
    return fig2(
        stretch(FIG2_START_S, FIG2_LONG_S),
        stretch(knot - FIG2_ZOOM_S / 2, FIG2_ZOOM_S),
        f"Fig. 2: {source.name}, k = {PERCENT} %, b = {FIG2_BITS}",
        "Original f (wide grey line), the slow part d as decoded from its knots, and the "
        "reconstruction d + e. d alone has lost the texture; with the residual it is back, within "
        f"{100 * largest:.0f} % of the deadband at every sample of the session.",
    )


def pictures4(points: dict[str, list[Point]], count: int) -> list[Figure]:
    caption = (
        "Whole lines: packets only, as the paper counts; dashed: whole files with descriptions and "
        "index. Lower is smaller; 100 minus the value is the reduction."
    )
    names = list(points)
    found = [fig4({name: points[name] for name in names[:count]},
                  "Fig. 4: compression ratio, simulated textures", caption)]  # fmt: skip
    if names[count:]:
        found.append(fig4({name: points[name] for name in names[count:]},
                          "Fig. 4: compression ratio, recordings", caption))  # fmt: skip
    return found


def picture5(rated: list[Rated]) -> Figure:
    bits = sorted({each.bits for each in rated})

    def lines(of: Any) -> list[list[float | None]]:
        return [[of(each) for each in rated if each.texture == name] for name in TEXTURES]

    curves = [
        Curve("texture against error", "HF SNR in dB", lines(lambda each: each.snr_db)),
        Curve("error over threshold", "dB over vibrotactile threshold",
              lines(lambda each: each.felt.error_db),
              [(0, "just felt")]),
        Curve("error felt", "% of the time",
              lines(lambda each: 100 * each.felt.share),
              others=lines(lambda each: 100 * each.felt.share_grasped),
              other=f"dashed: threshold\n{GRASPED_DB:g} dB lower"),
    ]  # fmt: skip
    if any(each.similarity is not None for each in rated):
        curves.append(Curve("ST-SIM", "similarity", lines(lambda each: each.similarity)))
    return fig5(
        TEXTURES,
        bits,
        curves,
        f"In place of Fig. 5: measures against b, k = {PERCENT} %",
        "No ratings: nobody was asked. An error is felt where it is over the vibrotactile "
        "threshold and changes the vibration by a fifth (the least Weber fraction known).",
    )


def text_of(
    points: dict[str, list[Point]], rated: list[Rated], changed: dict[int, list[Changed]],
    peaks: list[Peak], seconds: float,
) -> str:  # fmt: skip
    sand = points[FIG2_TEXTURE]
    alone, coded, last = at(sand, PERCENT, 0), at(sand, PERCENT, 5), at(sand, 100, 5)
    unfelt = least_unfelt(rated, lambda each: each.felt.share)
    grasped = least_unfelt(rated, lambda each: each.felt.share_grasped)
    paper, *_, predicted = changed[5]
    tapped = next(each for each in changed[5] if each.name.startswith("one tap"))
    opened = next(each for each in changed[5] if each.name.startswith("open loop"))
    similar = SIMILAR if any(each.similarity is not None for each in rated) else ""
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
{similar}\
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


def least_unfelt(rated: list[Rated], share: Any) -> str:
    """The least b from which on no texture's error is felt for a hundredth of the time."""
    felt_at = [each.bits for each in rated if share(each) >= 0.01]
    more = [each.bits for each in rated if each.bits > max(felt_at, default=-1)]
    return f"b = {min(more)}" if more else "no b that was measured"
