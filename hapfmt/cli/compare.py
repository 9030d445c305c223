"""hapfmt compare: compares the samples of two recordings, of any format."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ParameterError
from ..numbers import counted
from .common import (
    AmountType,
    echo_json,
    force_option,
    import_options,
    input_format_option,
    json_option,
    memory_option,
    open_parts,
    options_by_input,
    output_of,
    progress,
    refuse_format,
    refuse_idle,
    refuse_span,
    start_option,
    stop_option,
)
from .encode import amount
from .plot import damage_of, finish
from .screen import Column, Verb, note, printable, say, table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    from ..encoder.settings import Tolerance
    from ..lab.compare import Comparison
    from ..lab.views import ChannelView
    from ..limits import Limits

DIFFERENT = 3
"""Exit code for differences, as in ``verify --against`` (SPEC clause 13)."""


@click.command(cls=Verb)
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option("--channels", multiple=True, help="Labels or numbers, of both: fx,fy or 0,3. [all]")
@start_option
@stop_option
@click.option(
    "--tolerance",
    type=AmountType(),
    metavar="AMOUNT",
    help="What counts as equal: 1e-3 in the unit, 0.5lsb, or 0.1% of the range of A. [nothing]",
)
@click.option(
    "--metrics",
    "measured",
    is_flag=True,
    help="Print perceptual measures too: weighted SNR, deadbands, ST-SIM, SPQI, band energies.",
)
@click.option("--plot", "picture", metavar="PICTURE", help="Draw both: .png .svg .pdf.")
@input_format_option
@import_options
@memory_option
@force_option
@json_option
def compare(
    a: str,
    b: str,
    channels: tuple[str, ...],
    start: Fraction | None,
    stop: Fraction | None,
    tolerance: Tolerance | None,
    measured: bool,
    picture: str | None,
    input_format: str | None,
    max_memory: Limits,
    force: bool,
    as_json: bool,
    **given: Any,
) -> int:
    """Compare the samples of A and B, of any format, tick by tick. Channels are matched by label;
    if no label matches, by place and unit. Metadata, events, clocks and attachments are not
    compared. An option such as --rate or --keep-stamps counts for each file whose format uses it.

    The exit code is 0 if no difference is larger than --tolerance and no sample is missing on
    either side. It is 3 if the recordings differ, or if samples were lost to damage. An error is 1.

    \b
    hapfmt compare original.npz touch.hapf
    hapfmt compare a.hapf b.hapf --tolerance 0.5lsb --plot both.png
    hapfmt compare original.npz touch.hapf --metrics
    """
    from ..files import refuse
    from ..lab.compare import compare as compare_recordings
    from ..lab.compare import pair_up

    if a == "-" and b == "-":
        raise ParameterError("Only one of A and B can come from standard input")
    if picture is not None:
        from ..lab.plotting.panels import kind_of, new_figure

        kind_of(picture)
        refuse(picture, force)
        new_figure(1, 1)
    else:
        refuse_idle("requires --plot", force=force)
    refuse_span(start, stop)
    refuse_format(input_format, a, b)
    options = options_by_input((a, b), input_format, given)
    opened = partial(open_parts, whole=start is None and stop is None)
    one = opened(a, input_format, max_memory, channels, **options[a])
    try:
        two = opened(b, input_format, max_memory, channels, **options[b])
        try:
            with progress("comparing") as advance:
                found, views = compare_recordings(
                    one, two, pair_up(one, two), start, stop,
                    tolerance=tolerance, views=picture is not None, measured=measured,
                    progress=advance,
                )  # fmt: skip
            code = max(finish(one, start, stop), finish(two, start, stop))
            reports = {"a": one.damage(start, stop), "b": two.damage(start, stop)}
            damage = {name: each and each.as_json() for name, each in reports.items()}
            footnotes = [
                *damage_of(one, start, stop, "A: "),
                *damage_of(two, start, stop, "B: "),
            ]
        finally:
            two.close()
    finally:
        one.close()
    if picture is not None:
        draw(picture, found, views, f"{Path(a).name} (A) and {Path(b).name} (B)", footnotes, force)
    if not all(row.within for row in found):
        code = max(code, DIFFERENT)
    if as_json:
        names = {"a": a, "b": b, "exit_code": code, "damage": damage}
        same = all(row.identical for row in found)
        echo_json({**names, "identical": same, "channels": [row.as_json() for row in found]})
    else:
        show(a, b, found)
        if measured:
            show_measures(found)
    return code


def draw(
    picture: str,
    found: Sequence[Comparison],
    views: Sequence[ChannelView],
    title: str,
    footnotes: Sequence[str],
    force: bool,
) -> None:
    from ..lab.plotting.figures import pages
    from ..lab.plotting.pages import Words
    from ..lab.plotting.panels import kind_of, save
    from ..lab.views import duration, grouped, rates

    if not views:
        raise ParameterError("Nothing to draw: no channel of both has the same rate")
    samples = sum(row.samples for row in found)
    facts = [
        counted(len(found), "channel"),
        rates([view.channel.rate for view in views]),
        duration(views[0].stop - views[0].start),
        f"{grouped(samples)} sample{'s' if samples != 1 else ''} in both",
    ]
    figures = pages(found, views, Words(printable(title), facts, footnotes))
    names = save(figures, output_of(picture), kind_of(picture), force=force)
    if len(names) > 1:
        note(f"{len(names)} pages: {', '.join(names)}")


def show(a: str, b: str, found: Sequence[Comparison]) -> None:
    from ..split import split_text

    rows = [
        [
            row.label or f"channel {row.number}",
            str(row.number),
            row.verdict.removesuffix(" tolerance"),
            amount(row.largest, row.unit) if row.largest else "0",
            str(row.differing),
            str(row.samples),
            str(row.only_a),
            str(row.only_b),
            f"{row.rms:.4g}",
            "-" if row.largest_counts is None else f"{row.largest_counts:.4g}",
            "-" if row.snr_db is None else f"{row.snr_db:.1f}",
            "-" if row.snr_hf_db is None else f"{row.snr_hf_db:.1f}",
        ]
        for row in found
    ]
    headers = [
        Column("label"), Column("#", 9), Column("verdict"), Column("largest"),
        Column("differ", 1), Column("samples", 2),
        Column("A only", 0 if any(row.only_a for row in found) else 6),
        Column("B only", 0 if any(row.only_b for row in found) else 7),
        Column("rms", 4), Column("steps", 8), Column("SNR dB", 3),
        Column("SNR>20Hz dB", 5),
    ]  # fmt: skip
    table(headers, rows)
    if any(row.snr_hf_db is not None for row in found):
        say(f"SNR>20Hz: {split_text()}")
    for row in found:
        for each in row.notes:
            note(f"{row.label}: {each}")
    different = sum(not row.within for row in found)
    near = sum(row.within and not row.identical for row in found)
    same = len(found) - different - near
    parts = [(same, "identical"), (near, "within tolerance"), (different, "different")]
    said = ", ".join(f"{count} {word}" for count, word in parts if count) or "no channels"
    say(f"{a} and {b}: {said}")


def show_measures(found: Sequence[Comparison]) -> None:
    """A table of its own: perceptual measures of the channels that have some."""
    rows, missing, longest = [], dict[str, None](), 0.0
    for row in found:
        each = row.measures
        if each is None:
            continue
        rows.append(
            [
                row.label or f"channel {row.number}",
                shown(each.snr_weighted_db, ".1f"),
                shown(each.largest_deadbands, ".3g"),
                shown(None if each.outside_share is None else 100 * each.outside_share, ".3g"),
                shown(each.st_sim, ".3f"),
                shown(each.spqi, ".3f"),
                shown(each.band_energy_error_db, ".2f"),
            ]
        )
        longest = max(longest, each.seconds)
        if each.missing:
            missing[each.missing] = None
    if not rows:
        note("No channel has samples to measure")
        return
    say()
    headers = [
        Column("label"), Column("weighted SNR dB", 4), Column("largest, deadbands", 2),
        Column("outside %", 3), Column("ST-SIM"), Column("SPQI"), Column("band error dB", 1),
    ]  # fmt: skip
    table(headers, rows)
    say(f"of the first {longest:.3g} s of the longest stretch without a gap")
    for reason in missing:
        note(reason)


def shown(x: float | None, form: str) -> str:
    return "-" if x is None else format(x, form)
