"""The paper, reproduced: its figures 2 and 4, and measures in the place of figure 5.

F. Brandi, R. Chaudhari, E. Steinbach, "Texture compensation for haptic feedback signal
compression", VECIMS 2011, https://doi.org/10.1109/VECIMS.2011.6053837.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import hapfmt
from hapfmt.encoder.settings import Tolerance
from hapfmt.lab.scenes import load_scene, simulate
from hapfmt.metrics import st_sim
from report.felt import GRASPED_DB
from report.paper_figures import PERCENT, fig4, most_textured, picture2
from report.rated import Rated, least_unfelt, picture5, rate, ratings, similarity_of
from report.ratio import (
    BITS,
    RECORDED,
    SECONDS,
    TEXTURES,
    WEBER,
    Point,
    Source,
    grid,
    measure,
    recorded,
    settings,
    simulated,
)
from report.section import Figure, Options, Section, Table
from report.variants import HEADERS, Changed, variants

TITLE = "The paper, reproduced"

SHOWN = "sand"
"""Fig. 2, and the table of choices."""

PICTURED = (SHOWN, "hand-guided, force")

NORMAL_BITS = math.log2(2 * math.pi * math.e) / 2
"""Differential entropy of a normal distribution of rms 1."""

NOTED_POINTS = (3.1, 3.7)
"""What b = 5 adds on sand for k up to 10 %, of the paper (NOTED)."""

SAVED, ADDED_POINTS, TIMES_BETTER = 97, 3.5, 5
"""The abstract: storage is reduced by up to 97 %; 3.5 % more data than the deadband alone make the
rated quality five times as good."""

CLOSE_POINTS, CLOSE_SAVED = 0.6, 2.0
"""Within these points a figure here counts as that of the paper."""

ABSTRACT = "abstract of the paper"
NOTED = "its Fig. 4 as this project noted it down, not checked against the paper again"

READ_BITS = (2, 5)
CALM = ", no touch-downs"
EACH, FIXED = "range of each recording", "one fixed range"


def section(options: Options) -> Section:
    seconds = 2.0 if options.quick else SECONDS
    weber = (1, 10, 50) if options.quick else WEBER
    sources = simulated(seconds)
    others = recorded(options.data, 1 if options.quick else 3)
    options.progress("compression ratios")
    points = {source.name: list(grid(source, weber, BITS)) for source in sources + others}
    rated = [each for source in sources + others for each in rate(source, options)]
    options.progress("both readings of b")
    calm = calm_sources(seconds)
    points |= {source.name: list(grid(source, (PERCENT,), (0, *READ_BITS))) for source in calm}
    read = readings(sources + calm + others, points)
    sand = sources[TEXTURES.index(SHOWN)]
    options.progress("what each choice costs")
    changed = {bits: variants(sand, PERCENT, bits) for bits in (2, 5)}
    peaks = [peak_of(source, points[source.name]) for source in sources + calm + others]
    for source in calm:
        del points[source.name]
    return Section(
        TITLE,
        text_of(points, rated, changed, peaks, read, seconds) + not_found(options),
        [
            Table("The paper's own figures, in both readings of b", *claims(read)),
            Table(f"Both readings of b at k = {PERCENT} %", READING_HEADERS, read),
            Table("Fig. 4: compression ratio against k", *ratios(points)),
            Table("Fig. 5, measured: what of the error could be felt", *ratings(rated)),
            Table("Where the paper says more, or something else", *differences(points)),
            Table(f"What each choice costs: {sand.name}, k = {PERCENT} %", *choices(changed)),
            Table(
                "How peaky the residuals are, and what b = 5 adds",
                PEAK_HEADERS,
                sorted(peaks, key=lambda peak: peak.kurtosis),
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
            "readings": [each._asdict() for each in read],
        },
    )


def not_found(options: Options) -> str:
    """The recordings of this section that the folder does not have."""
    wanted = RECORDED[:1] if options.quick else RECORDED
    folder = options.data
    missing = [each.path for each in wanted if not (folder and (folder / each.path).exists())]
    return f"* **Skipped, not found**: {', '.join(missing)}.\n" if missing else ""


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
    """Percentage points that a residual of ``bits`` bits adds to the compression ratio."""
    with_it, without = at(points, percent, bits), at(points, percent, 0)
    return with_it.payload_percent - without.payload_percent


class Reading(NamedTuple):
    """One recording, coded with one reading of b. similarity: ST-SIM of the most textured channel,
    alone of the deadband alone; None without vibromaf."""

    name: str
    reading: str
    bits: int
    range_: float
    saved_percent: float
    added_points: float
    snr_db: float
    similarity: float | None
    alone: float | None

    @property
    def times_better(self) -> float | None:
        if self.similarity is None or not self.alone:
            return None
        return self.similarity / self.alone


READING_HEADERS = (
    "recording", "reading", "b", "range of the residual, in its unit", "saved, %",
    "b adds, points", "HF SNR, dB", "ST-SIM", "ST-SIM of the deadband alone",
)  # fmt: skip


def calm_sources(seconds: float) -> list[Source]:
    """The simulated textures without touch-downs."""
    return [
        Source(
            f"{name}{CALM}",
            simulate(load_scene(name).without("touches").changed(seconds=seconds))[0],
            "0.01",
        )
        for name in TEXTURES
    ]


def residual_of(source: Source, points: list[Point]) -> NDArray[np.float64]:
    """What the decoded deadband leaves of the most textured channel."""
    f = most_textured(source).recording.channels[0].samples()
    alone = at(points, PERCENT, 0)
    label = most_textured(source).recording.channels[0].label
    return np.asarray(f - hapfmt.read(alone.file).channel(label).samples())


def readings(sources: list[Source], points: dict[str, list[Point]]) -> list[Reading]:
    """Reading 1: 2^b - 1 levels over the range of each recording's residual. Reading 2: over one
    range, the largest residual of all recordings in the same unit."""
    residuals = {source.name: residual_of(source, points[source.name]) for source in sources}
    units = {source.name: source.recording.channels[0].unit for source in sources}
    peaks = {name: float(np.max(np.abs(e))) for name, e in residuals.items()}
    fixed = {u: max(peaks[name] for name in peaks if units[name] == u) for u in units.values()}
    found = []
    for source in sources:
        alone = at(points[source.name], PERCENT, 0)
        base = similarity_of_point(source, alone)
        for bits in READ_BITS:
            range_ = fixed[units[source.name]]
            step = Tolerance(range_ / (2 ** (bits - 1) - 1))
            asked = replace(settings(PERCENT, bits, source.floor), bits=None, step=step)
            for reading, most, point in (
                (EACH, peaks[source.name], at(points[source.name], PERCENT, bits)),
                (FIXED, range_, measure(source, asked)),
            ):
                found.append(
                    Reading(
                        source.name, reading, bits, most, 100 - point.payload_percent,
                        point.payload_percent - alone.payload_percent, point.snr_db,
                        similarity_of_point(source, point), base,
                    )
                )  # fmt: skip
    return found


def similarity_of_point(source: Source, point: Point) -> float | None:
    channel = most_textured(source).recording.channels[0]
    try:
        y = hapfmt.read(point.file).channel(channel.label).samples()
        return st_sim(channel.samples(), y, channel.rate_exact)
    except hapfmt.HapfmtError:
        return None


def claims(read: list[Reading]) -> tuple[Any, list[Any]]:
    """The three figures of the abstract, here in both readings, and whether they agree."""

    def these(reading: str, bits: int, textures: bool) -> list[Reading]:
        return [
            r for r in read
            if (r.reading, r.bits, r.name in TEXTURES) == (reading, bits, textures)
            and not r.name.endswith(CALM)
        ]  # fmt: skip

    def row(what: str, paper: str, bits: int, of: Any, agrees: Any, remark: str) -> tuple[Any, ...]:
        cells, verdicts = [], []
        for reading, textures in product((EACH, FIXED), (True, False)):
            members = these(reading, bits, textures)
            values = [value for each in members if (value := of(each)) is not None]
            cells.append(span(values) if values else "not measured")
            if textures:
                good = sum(map(agrees, values))
                verdicts.append(f"{good} of {len(values)}" if values else "-")
        return (what, paper, *cells, *verdicts, remark)

    rows = [
        row("storage saved, b = 5", f"up to {SAVED} %", 5, lambda r: r.saved_percent,
            lambda v: abs(v - SAVED) <= CLOSE_SAVED,
            "the paper names neither b nor k for its best case"),
        row("storage saved, b = 2", f"up to {SAVED} %", 2, lambda r: r.saved_percent,
            lambda v: abs(v - SAVED) <= CLOSE_SAVED,
            "two bits keep no texture here: see HF SNR"),
        row("b = 5 adds to the deadband alone, points", f"{ADDED_POINTS}", 5,
            lambda r: r.added_points, lambda v: abs(v - ADDED_POINTS) <= CLOSE_POINTS,
            "the peakier a residual, the less b = 5 adds"),
        row("quality against the deadband alone, b = 5", f"{TIMES_BETTER} times (rated by people)",
            5, lambda r: r.times_better, lambda v: v >= TIMES_BETTER,
            "ST-SIM, a measure and no rating; more than five times counts as agreement"),
    ]  # fmt: skip
    headers = (
        "figure", "paper", f"simulated, {EACH}", f"recorded, {EACH}", f"simulated, {FIXED}",
        f"recorded, {FIXED}", f"textures that agree, {EACH}", f"textures that agree, {FIXED}",
        "remark",
    )  # fmt: skip
    return headers, rows


def span(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.1f}" if f"{low:.1f}" == f"{high:.1f}" else f"{low:.1f} to {high:.1f}"


class Peak(NamedTuple):
    """How peaky the residual of a recording's most textured channel is."""

    name: str
    kurtosis: float
    over_rms: float
    points: float
    bits: float
    normal_bits: float


PEAK_HEADERS = (
    "recording", "kurtosis of the residual (normal: 3)", "its peak divided by its rms",
    "b = 5 adds, points", "bits per sample", "bits of a normal distribution",
)  # fmt: skip


def peak_of(source: Source, points: list[Point]) -> Peak:
    """At k = PERCENT; the points are those of all channels."""
    e = residual_of(source, points)
    e = e - e.mean()
    peak, more = float(np.max(np.abs(e)) / np.std(e)), added(points, PERCENT, 5)
    kurtosis = float(np.mean(e**4) / np.var(e) ** 2)
    normal = math.log2((2**4 - 1) / peak) + NORMAL_BITS
    return Peak(source.name, kurtosis, peak, more, more * 64 / 100, normal)


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
    """What the paper reports and what came out here."""
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
         "see the first table and the last"),
        ("size beyond k = 20 %, b = 5", "flat or rising", NOTED,
         f"{three(lambda found: change(found, most, 5))} points from 20 to {most:g} %",
         "the step grows with the residual's range, so that fewer bits buy less: "
         f"HF SNR {three(lambda found: at(found, 20, 5).snr_db)} dB at 20 %, "
         f"{three(lambda found: at(found, most, 5).snr_db)} dB at {most:g} %"),
        ("Fig. 5, rating", "0-100 by subjects", "the paper", "none",
         "only people can rate: `hapfmt study`. The report has measures, and no mapping from them "
         "to a rating, since nothing justifies one"),
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
    peaks: list[Peak], read: list[Reading], seconds: float,
) -> str:  # fmt: skip
    sand = points[SHOWN]
    alone, coded, last = at(sand, PERCENT, 0), at(sand, PERCENT, 5), at(sand, 100, 5)
    textures = [each for each in rated if each.name in TEXTURES]
    unfelt = least_unfelt(textures, lambda felt: felt.share)
    grasped = least_unfelt(textures, lambda felt: felt.share_grasped)
    paper, *_, predicted = changed[5]
    tapped = next(each for each in changed[5] if each.name.startswith("one tap"))
    opened = next(each for each in changed[5] if each.name.startswith("open loop"))
    return f"""\
**On simulated sand, k = {PERCENT} % and b = 5 take {coded.payload_percent:.1f} % of the doubles; \
the deadband alone takes {alone.payload_percent:.1f} %. From {unfelt} on the error would not be \
felt.** \
The recordings are a stylus on stone, sand and cork from `hapfmt.lab.scenes`, {seconds:g} s each \
at 1 kHz. The paper's sessions have 11 s. The preset is `paper` with a floor of 10 mN. F. Brandi, \
R. Chaudhari, E. Steinbach, [VECIMS 2011](https://doi.org/10.1109/VECIMS.2011.6053837). All \
numbers are computed here; the paper's numbers stand in two tables, with their source.

{agreement(peaks, read)}
* **Deadband alone**: it is the smallest by far and keeps no texture: its error is larger than the \
texture (HF SNR {alone.snr_db:.1f} dB). b = 2 does not bring the texture back, since only peaks \
reach the outer two of its three levels.
* **Not felt** means: the error exceeds the vibrotactile threshold and the least noticeable \
difference in less than 1 % of the time. With a threshold {GRASPED_DB:g} dB lower, the lowest \
reported for a cylinder in the grasp, this holds from {grasped} on. The threshold is that of a \
stylus of 60 g in a hand. It measures the error; it is no rating.
{similarity_of(rated, TEXTURES)}\
* **The step comes from the range of the residual.** One tap before the same session leaves b = 5 \
with {tapped.snr_db:.1f} dB instead of {paper.snr_db:.1f} dB. A larger k hardly makes files with a \
residual smaller: b = 5 takes {coded.payload_percent:.1f} % at k = {coded.percent:g} % and \
{last.payload_percent:.1f} % at k = {last.percent:g} %, there with {last.snr_db:.1f} dB.
* **Closed loop**: with f - l instead of f - d the residual is smaller, but \
{opened.outside_percent:.1f} % of the samples leave the deadband; here it is \
{paper.outside_percent:.1f} %.
* **This format's own way**: prediction at the same step (`near-lossless`) takes \
{predicted.payload_percent:.1f} % instead of {paper.payload_percent:.1f} %.
"""


def agreement(peaks: list[Peak], read: list[Reading]) -> str:
    """Where the figures here are those of the paper, and where they are not; from the data."""
    by_name = {peak.name: peak for peak in peaks}
    textures = [by_name[name] for name in TEXTURES]
    calm = [peak for peak in peaks if peak.name.endswith(CALM)]
    recorded_ = [peak for peak in peaks if peak not in textures and peak not in calm]

    def of(reading: str, bits: int, value: Any, suffix: str = "") -> str:
        names = [f"{name}{suffix}" for name in TEXTURES]
        found = [
            value(r) for r in read if (r.reading, r.bits) == (reading, bits) and r.name in names
        ]
        known = [each for each in found if each is not None]
        return span(known) if known else "not measured"

    near = sum(abs(p.points - ADDED_POINTS) <= CLOSE_POINTS for p in textures)
    lines = [
        f"* **Peaks.** The paper calls the residual peaky. With touch-downs the kurtosis of the "
        f"simulated residuals is {span([p.kurtosis for p in textures])}; without them it is "
        f"{span([p.kurtosis for p in calm])} (a normal distribution has 3)."
        + (
            " Recorded: " + ", ".join(f"{p.name} {p.kurtosis:.1f}" for p in recorded_) + "."
            if recorded_
            else ""
        ),
        f"* **Where we {'agree' if near == len(textures) else 'partly agree'}: what b = 5 adds.** "
        f"The paper says {ADDED_POINTS} points. With the range of each recording it is "
        f"{of(EACH, 5, lambda r: r.added_points)} points here, and with one fixed range "
        f"{of(FIXED, 5, lambda r: r.added_points)}. Without touch-downs it is "
        f"{span([p.points for p in calm])} points."
        + (
            " On recordings it is "
            + ", ".join(f"{p.points:.1f} ({p.name})" for p in recorded_)
            + "."
            if recorded_
            else ""
        ),
        f"* **Storage saved.** The paper says up to {SAVED} %. At b = 5 it is "
        f"{of(EACH, 5, lambda r: r.saved_percent)} % (range of each recording) and "
        f"{of(FIXED, 5, lambda r: r.saved_percent)} % (one fixed range); at b = 2 "
        f"{of(EACH, 2, lambda r: r.saved_percent)} %, without texture. The paper's best case "
        "names neither b nor k, so the figures agree in size and cannot be matched exactly.",
        f"* **Where we cannot tell: quality.** The paper's {TIMES_BETTER}-fold quality is a rating "
        "by people. ST-SIM, a measure, grows by a factor of "
        f"{of(EACH, 5, lambda r: r.times_better)} from the deadband alone to b = 5 with the range "
        f"of each recording, and of {of(FIXED, 5, lambda r: r.times_better)} with one fixed range. "
        "Silence between strokes counts as alike, so the deadband alone scores high; without "
        f"touch-downs the factor is {of(EACH, 5, lambda r: r.times_better, CALM)}.",
        "* **Which reading the paper has is not known.** One fixed range is the largest residual "
        "of all recordings in the same unit. It makes files smaller and loses the texture of "
        "recordings with a small residual.",
    ]
    return "\n".join(lines)
