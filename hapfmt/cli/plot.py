"""hapfmt plot: draws a recording of any format."""

from __future__ import annotations

import shlex
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import click

from ..errors import ParameterError
from ..numbers import counted
from .common import (
    force_option,
    import_options,
    input_format_option,
    matched,
    memory_option,
    open_parts,
    options_by_input,
    output_of,
    output_option,
    progress,
    refuse_format,
    refuse_idle,
    refuse_span,
    start_option,
    stop_option,
    tell_losses,
    tell_suffix,
    tell_written,
)
from .screen import Verb, note, printable

if TYPE_CHECKING:
    from ..lab.parts import Parts
    from ..lab.views import ChannelView
    from ..limits import Limits

LINES = 3
"""Largest number of lines about losses below the picture."""


@click.command(cls=Verb)
@click.argument("file", metavar="FILE")
@output_option("PICTURE", "Write the picture here: .png .svg .pdf; - is a pipe.")
@click.option("--window", is_flag=True, help="Show it in a window instead.")
@click.option("--channels", multiple=True, help="Labels or numbers: fx,fy or 0,3. [all]")
@start_option
@stop_option
@click.option(
    "--against",
    metavar="ORIGINAL",
    help="The recording that FILE was encoded from: draws the errors too.",
)
@input_format_option
@import_options
@click.option(
    "--output-format",
    "kind",
    type=click.Choice(["png", "svg", "pdf"]),
    metavar="FORMAT",
    help="Format of the picture, for a pipe: png, svg, pdf [png].",
)
@memory_option
@force_option
def plot(
    file: str,
    output: str | None,
    window: bool,
    channels: tuple[str, ...],
    start: Fraction | None,
    stop: Fraction | None,
    against: str | None,
    input_format: str | None,
    kind: str | None,
    max_memory: Limits,
    force: bool,
    **given: Any,
) -> int:
    """Draw FILE, of any format. Long recordings are read in parts.

    One channel fills a page: the signal, its deadband and the knots of its slow part, a stretch of
    it sample by sample, the texture, the spectrum. A few have a row each; many are small pictures
    side by side. A PDF has as many pages as needed, and a page for each channel if there are at
    most 12. A PNG or SVG has one page; further pages are files of their own: touch-1.png.
    Gaps are hatched. Damage is crossed and named; the exit code is then 3.

    \b
    hapfmt plot touch.hapf --output touch.png
    hapfmt plot touch.hapf -o part.svg --channels force_z --start 1 --stop 2
    hapfmt plot touch.hapf --output errors.pdf --against original.npz
    hapfmt plot touch.npz --window
    """
    from ..files import refuse
    from ..lab.plotting.panels import KINDS, kind_of, new_figure, save

    if (output is None) != window:
        picture = shlex.quote(f"{'touch' if file == '-' else Path(urlsplit(file).path).stem}.png")
        raise ParameterError(f"Give --output {picture} (or .svg, .pdf), or --window.")
    if output is not None and output != "-":
        if kind and Path(output).suffix.lower() in {f".{each}" for each in KINDS} - {f".{kind}"}:
            tell_suffix(output, f".{kind}")
        kind = kind or kind_of(output)
        refuse(output, force)
    new_figure(1, 1)
    if window:
        refuse_idle("requires --output", output_format=kind, force=force)
        from ..lab.plotting.pages import open_window

        open_window("hapfmt").destroy()
    refuse_span(start, stop)
    refuse_format(input_format, file, against)
    options = options_by_input((file, against), input_format, given)
    whole = start is None and stop is None
    parts = open_parts(file, input_format, max_memory, channels, whole=whole, **options[file])
    original = None
    try:
        if against is not None:
            original = matched(parts, against, input_format, max_memory, **options[against])
        figures = draw(parts, original, file, start, stop, kind == "pdf" or window)
        code = finish(parts, start, stop)
    finally:
        parts.close()
        if original is not None:
            original.close()
    if window:
        from ..lab.plotting.pages import show

        show(figures, f"hapfmt: {file}")
        return code
    assert output is not None
    names = save(figures, output_of(output), kind or "png", force=force)
    if len(names) > 1:
        note(f"{len(names)} pages: {', '.join(names)}")
    elif output != "-":
        tell_written(output, "a picture")
    return code


def draw(
    parts: Parts,
    original: Parts | None,
    name: str,
    start: Fraction | None,
    stop: Fraction | None,
    details: bool,
) -> list[Any]:
    """The drawn pages."""
    from ..lab.plotting.pages import ROWS, ZOOM_TICKS, Words, pages
    from ..lab.views import liveliest, survey, within

    first, last = within(parts, start, stop)
    many = len(parts.channels) > ROWS and not (details and original is not None)
    with progress("reading") as advance:
        views = survey(parts, first, last, against=original, spectra=not many, progress=advance)
    zoom: ChannelView | None = None
    near = liveliest(views[0], ZOOM_TICKS) if len(views) == 1 else None
    while near is not None:
        zoom = survey(parts, *near, against=original, spectra=False)[0]
        near = None if zoom.full.is_whole else liveliest(zoom, ZOOM_TICKS)
    title = printable(Path(name).name if name != "-" else "standard input")
    if original is not None:
        title += ", against its original"
    words = Words(
        title,
        header(parts, views, name, start, stop, original is not None),
        footnotes(parts, views, start, stop),
    )
    return pages(
        views, words, zoom=zoom, events=parts.events(first, last), details=details,
    )  # fmt: skip


def header(
    parts: Parts,
    views: list[ChannelView],
    name: str,
    start: Fraction | None,
    stop: Fraction | None,
    compared: bool,
) -> list[str]:
    """The facts of the file."""
    from ..lab.parts import FileParts
    from ..lab.views import facts

    size, whole, damage = None, start is None and stop is None, parts.damage(start, stop)
    if isinstance(parts, FileParts):
        size = parts.reader.source.size
        # The ratio is that of the whole file, so it needs all channels.
        whole = whole and len(views) == len(parts.reader.channels)
    elif Path(name).is_file():
        size = Path(name).stat().st_size
    found = facts(parts, views, size=size, whole=whole, damage=damage.headline() if damage else "")
    return found + largest_error(views) if compared else found


def largest_error(views: list[ChannelView]) -> list[str]:
    """The largest error relative to the range of its channel; among several, the channel too."""
    from ..lab.views import relative_error

    shares = [(relative_error(view), view) for view in views]
    worst, view = max(shares, key=lambda pair: pair[0])
    if not worst:
        return ["no error"]
    of = f" ({view.channel.name})" if len(views) > 1 else ""
    return [f"largest error {100 * worst:.2g} % of range{of}"]


def footnotes(
    parts: Parts, views: list[ChannelView], start: Fraction | None, stop: Fraction | None
) -> list[str]:
    lines = damage_of(parts, start, stop)
    missing = sum(view.only_original for view in views)
    if missing:
        verb = "is" if missing == 1 else "are"
        lines.append(f"{counted(missing, 'sample')} of the original {verb} missing")
    return lines


def damage_of(
    parts: Parts, start: Fraction | None, stop: Fraction | None, name: str = ""
) -> list[str]:
    """Damage of the file, in a few lines."""
    damage = parts.damage(start, stop)
    lines = damage.lines() if damage else []
    more = [f"... and {len(lines) - LINES} more"] if len(lines) > LINES else []
    return [name + line for line in [*lines[:LINES], *more]]


def finish(parts: Parts, start: Fraction | None, stop: Fraction | None) -> int:
    """Reports damage; returns the exit code."""
    from ..lab.parts import FileParts

    if not isinstance(parts, FileParts):
        return 0
    parts.reader.lost = parts.lost_within(start, stop)
    return tell_losses(parts.reader, parts.damage(start, stop))
