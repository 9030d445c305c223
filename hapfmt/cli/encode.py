"""hapfmt encode: encodes a recording and prints one line for each channel.

A line gives the channel's mode and error bound in its unit. A summary gives what the choice of
preset cost or saved.
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from io import BytesIO
from itertools import groupby
from typing import TYPE_CHECKING, Any, Literal

import click

from ..errors import DataWarning, ParameterError, channels_called
from ..numbers import counted
from ..units import unit_text
from .common import (
    HAPF,
    IMPORT_NAMES,
    AmountType,
    BitsType,
    FileIdType,
    FractionType,
    PresetType,
    ShareType,
    echo_json,
    force_option,
    import_options,
    input_format_option,
    json_option,
    labels_option,
    memory_option,
    opened_input,
    output_of,
    progress,
    refuse_target,
    suffix_of,
    tell_import,
    tell_no_report,
    tell_notes,
    tell_suffix,
    threads_option,
    unit_option,
)
from .screen import JOINED, Column, Verb, joined, note, say, table

if TYPE_CHECKING:
    from ..encoder.encode import Decision
    from ..encoder.settings import Settings
    from ..limits import Limits
    from ..recording import Channel, Recording
    from ..writing.writer import Summary


def amount(value: float, unit: str, digits: int = 3) -> str:
    """A number with its unit, if it has one."""
    return f"{value:.{digits}g}{JOINED}{unit_text(unit)}".rstrip()


MISSED_DB = 3.0
"""A band of a synthetic texture that is further off is named."""
NAMED = 3
"""Channels that a line names."""
GROUPED = 16
"""Above this number of channels, neighbours that were kept alike share a line."""
TRIED_SAMPLES, TRIED_PIECES, LEAST_TRIED = 1 << 17, 8, 1 << 11
"""Samples of all channels for the estimate of another preset, the pieces that each channel gives,
and the least of each channel."""
FLOATING = ("stored as float", "kept as doubles")
MAX_ERROR = "0.1%"


@dataclass(frozen=True)
class ChannelRow:
    """One channel, or neighbours that were kept alike."""

    label: str
    kept_as: str
    unit: str
    sample_count: int
    size: int
    largest_error: float
    relative_error: float
    snr_hf_db: float | None
    st_sim: float | None
    level_db: float | None
    missed: str

    @property
    def texture(self) -> str:
        """The quality that was reached; of neighbours the lowest."""
        from ..encoder.settings import EXACT_DB, NO_TEXTURE

        if self.level_db is not None:
            return f"level{JOINED}{self.level_db:+.1f}{JOINED}dB"
        if self.st_sim is not None:
            return f"ST-SIM{JOINED}{self.st_sim:.3f}"
        if self.snr_hf_db is None:
            return "none" if self.missed == NO_TEXTURE else ""
        return "exact" if self.snr_hf_db > EXACT_DB else f"{self.snr_hf_db:.1f}{JOINED}dB"

    @property
    def percent(self) -> str:
        """The largest error in percent of the range; "-" where there is no range."""
        if self.largest_error and not self.relative_error:
            return "-"
        return f"{100 * self.relative_error:.3g}"

    def cells(self) -> list[str]:
        error = amount(self.largest_error, self.unit) if self.largest_error else "0"
        return [
            self.label,
            joined(self.kept_as),
            f"{8 * self.size / self.sample_count:.2f}" if self.sample_count else "-",
            str(self.size),
            error,
            self.percent,
            self.texture,
        ]


def show(
    summary: Summary,
    target: str,
    seconds: float,
    recording: Recording,
    settings: Settings,
    *,
    verbose: bool,
) -> None:
    from ..split import split_text

    rows = [row_of(each) for each in summary.decisions]
    if len(rows) > GROUPED and not verbose:
        rows = list(grouped(rows))
    headers = [
        Column("label"), Column("kept as"), Column("bits/sample"), Column("bytes", 2),
        Column("largest error", 1), Column("% of range", 1), Column("texture"),
    ]  # fmt: skip
    shown = len(headers) - (not any(row.texture for row in rows))
    table(headers[:shown], [row.cells()[:shown] for row in rows])
    if len(rows) < len(summary.decisions):
        say("(neighbours that were kept alike share a line; -v or --json shows each channel)")
    if verbose:
        for each in summary.decisions:
            axes = f", {each.axis_count} axes" if each.axis_count > 1 else ""
            db = "" if each.snr_db is None else f"; {each.snr_db:.1f} dB over all frequencies"
            say(f"{name_of(each)}: {each.chosen}{axes}: {each.reason}; {each.lattice}{db}")
    if any(each.snr_hf_db is not None for each in summary.decisions):
        say(f"texture: {split_text(settings.cutoff_hz)}")
    for line in (*missed_targets(summary, recording, settings), *missed_bands(summary)):
        say(line)
    took = f", in {seconds:.1f}{JOINED}s" if seconds >= 1 else ""
    rate = ""
    if settings.bitrate is not None and recording.duration:
        rate = f", {kbit_per_second(summary, recording.duration):.4g}{JOINED}kbit/s"
    say(f"{target}: {summary.file_size} bytes{rate}, {compared(summary)}{took}")
    if summary.overview_size:
        say(f"the overview takes {summary.overview_size} bytes of it")
    hint = advice(summary, recording)
    if hint:
        say(hint)


def row_of(each: Decision) -> ChannelRow:
    return ChannelRow(
        name_of(each),
        each.kept_as,
        each.unit,
        each.sample_count,
        each.size,
        each.largest_error,
        each.relative_error,
        each.snr_hf_db,
        each.st_sim,
        each.level_db,
        each.missed,
    )


def missed_targets(summary: Summary, recording: Recording, settings: Settings) -> Iterable[str]:
    """Which textures have another quality than the one that was asked for, and why."""
    from ..encoder.settings import CLOSE

    if settings.bitrate is not None and recording.duration:
        rate = kbit_per_second(summary, recording.duration)
        if not (1 - CLOSE) * settings.bitrate <= rate <= settings.bitrate:
            why = "textures have no more to gain"
            if rate > settings.bitrate:
                why = "the rest of the file takes as much"
            yield f"{rate:.4g} kbit/s, not {settings.bitrate:.4g}: {why}"
        return
    if not any((settings.quality, settings.snr, settings.st_sim)):
        return
    reasons: dict[str, list[str]] = {}
    for each in summary.decisions:
        if each.missed:
            reasons.setdefault(each.missed, []).append(name_of(each))
    for why, names in reasons.items():
        more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
        yield f"another quality than asked for: {', '.join(names[:NAMED])}{more}: {why}"


def missed_bands(summary: Summary) -> Iterable[str]:
    """Which synthetic textures have a band of frequencies that is far too loud or too quiet."""
    for each in summary.decisions:
        if each.band_db is not None and abs(each.band_db) > MISSED_DB:
            how = f"{abs(each.band_db):.1f}{JOINED}dB {'louder' if each.band_db > 0 else 'quieter'}"
            where = f"at {each.band_low_hz:.0f} to {each.band_high_hz:.0f}{JOINED}Hz"
            yield f"{name_of(each)}: the synthetic texture is {how} {where}"


def name_of(each: Decision) -> str:
    return each.label or f"channel {each.channel}"


NUMBER = re.compile(r"(?<= )\d[^ ,]*")


def merged(texts: list[str]) -> str:
    """Texts that differ by their numbers, as one: within 1 to 2 N."""
    numbers = iter(zip(*map(NUMBER.findall, texts), strict=True))

    def ends(_: re.Match[str]) -> str:
        found = sorted(set(next(numbers)), key=float)
        return found[0] if len(found) == 1 else f"{found[0]} to {found[-1]}"

    return NUMBER.sub(ends, texts[0])


def grouped(rows: Sequence[ChannelRow]) -> Iterable[ChannelRow]:
    for _, run in groupby(rows, lambda row: (NUMBER.sub("", row.kept_as), row.unit)):
        members = list(run)
        if len(members) < 3:
            yield from members
            continue
        yield replace(
            members[0],
            label=f"{members[0].label} and {len(members) - 1} more",
            kept_as=merged([row.kept_as for row in members]),
            sample_count=sum(row.sample_count for row in members),
            size=sum(row.size for row in members),
            largest_error=max(row.largest_error for row in members),
            relative_error=max(row.relative_error for row in members),
            snr_hf_db=least(row.snr_hf_db for row in members),
            st_sim=least(row.st_sim for row in members),
            level_db=least(row.level_db for row in members),
        )


def least(values: Iterable[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)


def compared(summary: Summary) -> str:
    """Return the size against float64 with the largest error of a lossy file."""
    if not summary.sample_count or not summary.file_size:
        return counted(summary.sample_count, "sample")
    bits = 8 * summary.file_size / summary.sample_count
    ratio = 64 / bits
    words = f"{ratio:.1f} times smaller" if ratio >= 1 else f"{1 / ratio:.1f} times LARGER"
    return f"{words} than float64 ({bits:.2f}{JOINED}bits/sample){worst(summary)}"


def worst(summary: Summary) -> str:
    """Return the largest error in percent of a range, and whose it is; "" where nothing is lost."""
    each = max(summary.decisions, key=lambda each: each.relative_error)
    if not each.relative_error:
        return ""
    where = f" of {name_of(each)}" if len(summary.decisions) > 1 else ""
    return f", largest error {100 * each.relative_error:.3g}{JOINED}% of range{where}"


def advice(summary: Summary, recording: Recording) -> str:
    """What another preset would make of floating-point channels that were kept to the last bit."""
    every = summary.decisions
    floating = [each for each in every if each.exact and each.lattice.startswith(FLOATING)]
    if not floating or 2 * sum(each.size for each in floating) < sum(each.size for each in every):
        return ""
    ratio = 8 * summary.sample_count / near_lossless_size(recording, summary)
    if ratio <= 1.5 * 8 * summary.sample_count / summary.file_size:
        return ""
    those = counted(len(every), "channel") + (" is" if len(floating) == 1 else " are")
    now = 8 * summary.sample_count / summary.file_size
    instead = f", not {now:.1f} times" if now >= 1 else ""
    return (
        f"{len(floating)} of {those} floating point. With --preset near-lossless "
        f"--max-error {MAX_ERROR} this file would be about {about(ratio)} times smaller than "
        f"float64{instead}."
    )


def about(ratio: float) -> str:
    """Return a ratio with two digits, and never as a power of ten."""
    return f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}"


def near_lossless_size(recording: Recording, summary: Summary) -> float:
    """Return the estimated bytes of a near-lossless file; ``summary`` is of the lossless one."""
    from ..encoder.settings import Settings
    from ..writing.writer import write

    count = max(TRIED_SAMPLES // len(recording), LEAST_TRIED)
    parts = tuple(sample_of(channel, count) for channel in recording)
    settings = Settings.of("near-lossless", max_error=MAX_ERROR)
    with warnings.catch_warnings():  # the first write gave them
        warnings.simplefilter("ignore", DataWarning)
        tried = write(replace(recording, channels=parts), BytesIO(), settings, threads=1)
    shares = [
        each.stored.size / max(part.stored.size, 1)
        for each, part in zip(recording, parts, strict=True)
    ]
    packets = sum(share * each.size for share, each in zip(shares, tried.decisions, strict=True))
    fixed = tried.file_size - sum(each.size for each in tried.decisions)
    return packets + fixed + summary.overview_size


def sample_of(channel: Channel, count: int) -> Channel:
    """Return a channel of about ``count`` samples: pieces of the given one without the gaps between
    them, and its least and largest value, which keep the range."""
    import numpy as np

    from ..encoder.plan import without_glitches
    from ..recording import Span
    from ..spool import release

    size = channel.stored.size
    if size <= count:
        return channel
    piece = count // TRIED_PIECES
    starts = np.linspace(0, size - piece, TRIED_PIECES).astype(int)
    x = channel.samples()
    x[~np.isfinite(x)] = x[0]
    calm = without_glitches(x)
    ends = np.repeat([calm.argmin(), calm.argmax()], 3)  # one sample alone would be a glitch
    release()
    places = np.concatenate([*(np.arange(start, start + piece) for start in starts), ends])
    return replace(
        channel,
        stored=channel.stored[places],
        exact=None if channel.exact is None else channel.exact[places],
        coverage=(Span(0, places.size),),
    )


AXES = ("x", "y", "z", "rx", "ry", "rz")


_PRESET_OPTIONS = (
    click.option(
        "--preset",
        type=PresetType(["lossless", "near-lossless", "perceptual", "paper"]),
        default="lossless",
        show_default=True,
        help="lossless: every bit as it was recorded. "
        "near-lossless: no sample is further off than --max-error. "
        "perceptual: leaves out what cannot be felt. Forces, torques, pressures, accelerations and "
        "velocities keep Weber's deadband in the slow part, and their texture to --quality; all "
        "other channels are near-lossless; clocks, counters and states are lossless. "
        "paper: the method of Brandi, Chaudhari and Steinbach. Their online deadband of the whole "
        "signal is: --bits 0 --interpolation hold, with a --cutoff above half the rate.",
    ),
    click.option(
        "--quality",
        type=click.Choice(["low", "medium", "high"]),
        help="perceptual: quality of the texture: 10, 20 or 30 dB; for low and medium, errors "
        "below --floor are enough [medium].",
    ),
    click.option(
        "--max-error",
        type=AmountType(),
        metavar="AMOUNT",
        help="near-lossless, perceptual: largest error in all: 0.1% of the channel's range, 0.01 "
        "in its unit, 10mN, 2lsb [0.1%].",
    ),
    click.option(
        "--felt",
        multiple=True,
        metavar="CHANNEL|all",
        help="perceptual: a channel that is felt too, by label or number; or all. May be repeated.",
    ),
    click.option(
        "--no-texture",
        "texture",
        flag_value=False,
        default=None,
        help="perceptual: keep the deadband alone.",
    ),
    click.option(
        "--bitrate",
        type=float,
        metavar="KBPS",
        help="perceptual, in place of --quality: kbit/s of the whole file; all textures get the "
        "same signal-to-noise ratio.",
    ),
    click.option(
        "--effort",
        type=click.Choice(("fast", "default", "best")),
        help="How much is searched for the smallest file [default].",
    ),
    click.option("--fast", is_flag=True, default=None, help="--effort fast, in one word."),
    click.option(
        "--force-error",
        is_flag=True,
        default=None,
        help="near-lossless, perceptual: allow a --max-error in units or steps above 10 % of a "
        "channel's range.",
    ),
    click.option(
        "--k",
        "k",
        type=ShareType(),
        help="perceptual, paper: Weber fraction of the deadband [10%].",
    ),
    click.option(
        "--floor",
        type=AmountType(),
        metavar="AMOUNT",
        help="perceptual, paper: absolute threshold of the deadband [0.2% of the range; paper: "
        "10mN for forces].",
    ),
    click.option(
        "--snr",
        type=float,
        metavar="DB",
        help="perceptual, in place of --quality: power of each texture over that of the error, "
        "also where errors are below --floor.",
    ),
    click.option(
        "--st-sim",
        type=float,
        metavar="X",
        help="perceptual, in place of --quality: spectral-temporal similarity of each texture, "
        "such as 0.95.",
    ),
    click.option(
        "--synthetic-texture",
        is_flag=True,
        default=None,
        help="perceptual, in place of --quality: store a model of each texture, about 100 bit/s. "
        "What is decoded has its spectrum and loudness, and other samples.",
    ),
    click.option(
        "--bits",
        type=BitsType(),
        help="paper: bits of the residual's quantiser, 2 to 16, step from its range; 0: no "
        "residual [5].",
    ),
    click.option(
        "--step", type=AmountType(), metavar="AMOUNT", help="paper: step of the residual."
    ),
    click.option(
        "--texture-codec",
        type=click.Choice(["LPCR", "MDCT"], case_sensitive=False),
        help="perceptual: the only codec of textures, to compare both [the smaller].",
    ),
    click.option(
        "--weighting",
        type=float,
        metavar="GAMMA",
        help="perceptual: let the steps of MDCT grow with this power of the threshold of "
        "vibration, such as 0.25 [0].",
    ),
    click.option(
        "--cutoff",
        "cutoff_hz",
        type=float,
        help="perceptual, paper: split between slow part and texture, Hz [20].",
    ),
    click.option(
        "--interpolation",
        type=click.Choice(["linear", "hold"]),
        help="paper: how knots are joined [linear].",
    ),
    click.option(
        "--tolerance",
        type=AmountType(),
        metavar="AMOUNT",
        help="For experts: how far the grid of floating point channels may be from the values, "
        "within the error that the preset allows.",
    ),
    click.option(
        "--references/--no-references",
        default=None,
        help="All but paper: channels that resemble each other may share a track and be predicted "
        "from each other; a lost packet then takes all of them along [on].",
    ),
    click.option(
        "--cluster",
        type=FractionType(),
        help="Length of clusters and packets in seconds [at most 10, or 120 at slow rates].",
    ),
    click.option("--digest", is_flag=True, help="Store the SHA-256 of every decoded track."),
)


def preset_options(command: Any) -> Any:
    """Options that choose the encoding, but for those of one recording alone."""
    for option in reversed(_PRESET_OPTIONS):
        command = option(command)
    return command


@click.command(cls=Verb)
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@preset_options
@click.option(
    "--vector",
    "vectors",
    multiple=True,
    metavar="X,Y[,Z]",
    help="perceptual --no-texture, paper: channels that are the axes of one vector, by label or "
    "number: one deadband on their norm. May be given several times.",
)
@import_options
@labels_option
@unit_option
@input_format_option
@click.option(
    "--canonical",
    type=FileIdType(content=True),
    metavar="ID",
    help="The same input gives the same bytes. ID replaces the random file id: a number, or "
    '"content" to take it from what is encoded.',
)
@click.option(
    "--overview",
    is_flag=True,
    help="Attach the lowest and highest values of each channel, bin by bin, so that a viewer shows "
    "a long recording at once. They take at most 4 % of the file or 16 KiB, "
    "whichever is larger.",
)
@click.option("-v", "--verbose", is_flag=True, help="Say how each channel was coded, and why.")
@threads_option
@memory_option
@force_option
@json_option
def encode(
    source: str,
    target: str,
    preset: str,
    labels: str | None,
    unit: str | None,
    input_format: str | None,
    canonical: int | Literal["content"] | None,
    overview: bool,
    force: bool,
    as_json: bool,
    threads: int | None,
    max_memory: Limits,
    verbose: bool,
    vectors: tuple[str, ...],
    **given: Any,
) -> int:
    """Encode the recording IN into OUT. IN is .npz, .npy, .csv, .wav or .hapf, or a file of ROS,
    MCAP, HDF5, MAT, Parquet, TDMS, EDF and others: hapfmt info --formats lists all.

    \b
    hapfmt encode touch.npz touch.hapf
    hapfmt encode lab.bag lab.hapf
    hapfmt encode touch.csv touch.hapf --preset paper --k 0.1 --bits 5
    hapfmt encode f.npy f.hapf --rate 1000 --preset near-lossless --max-error 1%
    cat touch.npz | hapfmt encode - - --input-format npz > touch.hapf
    """
    from ..convert.tables import Import
    from ..encoder.settings import Settings, renamed
    from ..writing.importing import why_whole, write_import
    from ..writing.writer import write

    refuse_target(target, force)
    tell_no_report(target, {"--json": as_json, "-v": verbose})
    if as_json and verbose:
        note("-v does nothing beside --json, which describes every channel anyway")
    if target != "-" and suffix_of(target, None) != HAPF:
        tell_suffix(target, HAPF)
    given["vectors"] = "required" if vectors else None
    given["felt"] = given["felt"] or None
    importing = {name: given.pop(name) for name in IMPORT_NAMES}
    preset, given = renamed(preset, given)
    settings = Settings.of(preset, **given)
    with opened_input(
        source, input_format, max_memory, whole=why_whole(settings, canonical), labels=labels,
        unit=unit, **importing,
    ) as (found, code):  # fmt: skip
        if isinstance(found, Import):
            recording = found.described()
            tell_import(found)
            tell_lossy(recording)
            began = time.perf_counter()
            with progress("encoding") as advance:
                summary = write_import(
                    found,
                    output_of(target),
                    settings,
                    canonical=None if canonical == "content" else canonical,
                    force=force,
                    overview=overview,
                    progress=advance,
                    threads=threads,
                )
            duration = found.duration
        else:
            recording = found
            tell_notes(recording, suffix_of(source, input_format) == HAPF)
            tell_lossy(recording)
            for place, names in enumerate(vectors):
                recording = with_vector(recording, names.split(","), f"vector {place + 1}")
            began = time.perf_counter()
            with progress("encoding") as advance:
                summary = write(
                    recording,
                    output_of(target),
                    settings,
                    canonical=canonical,
                    force=force,
                    overview=overview,
                    progress=advance,
                    threads=threads,
                )
            duration = recording.duration
    seconds = time.perf_counter() - began
    if as_json and target != "-":
        echo_json(summary_json(summary, duration, seconds))
    elif target != "-":
        show(summary, target, seconds, recording, settings, verbose=verbose)
    return code


def tell_lossy(recording: Recording) -> None:
    from ..encoder.settings import lossy_preset

    if earlier := lossy_preset(recording.metadata.get("encoder")):
        note(f"the input is already lossy ({earlier}); error bounds count from it")


def with_vector(recording: Recording, names: list[str], group: str) -> Recording:
    """The recording with these channels as the axes x, y, z ... of one group."""
    channels = list(recording.channels)
    labels = [channel.label for channel in channels]
    places = channels_called(names, dict(enumerate(labels)))
    if not 2 <= len(places) <= len(AXES):
        raise ParameterError(f"a vector has 2 to {len(AXES)} axes: {','.join(names)}")
    if places != list(range(places[0], places[0] + len(places))):
        raise ParameterError(
            f"the axes of a vector must be neighbours in the recording, in order: "
            f"{','.join(names)} are channels {places}"
        )
    for place, axis in zip(places, AXES, strict=False):
        channels[place] = replace(channels[place], group=group, axis=axis)
    return replace(recording, channels=tuple(channels))


def kbit_per_second(summary: Summary, duration: Fraction) -> float:
    """The rate of the whole file."""
    return float(8 * summary.file_size / duration / 1000)


def summary_json(summary: Summary, duration: Fraction, seconds: float) -> dict[str, Any]:
    return {
        "file_size": summary.file_size,
        "payload_size": summary.payload_size,
        "overview_size": summary.overview_size,
        "sample_count": summary.sample_count,
        "duration_s": float(duration),
        "kbit_per_s": kbit_per_second(summary, duration) if duration else None,
        "encode_s": seconds,
        "channels": [decision.as_json() for decision in summary.decisions],
    }
