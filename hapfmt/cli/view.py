"""hapfmt view: shows recordings in a browser, from a local server or in one exported page."""

from __future__ import annotations

import os
import shlex
import sys
import threading
import webbrowser
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import click

from ..errors import ParameterError
from ..files import refuse
from ..format.source import is_url
from .common import HAPF, force_option, input_of, output_of, progress, tell_written
from .screen import Verb, note, say, width_of

if TYPE_CHECKING:
    from ..viewer.server import ServedFile

LARGE = 100_000_000
"""Bytes of a page that a browser opens slowly."""
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
"""Environment variables of which one is set where a browser has a place to open."""


@click.command(cls=Verb)
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option(
    "--port",
    type=click.IntRange(1, 65535),
    metavar="PORT",
    help="Port of the local server. [a free one]",
)
@click.option("--no-browser", is_flag=True, help="Print the address only.")
@click.option(
    "--export",
    "page",
    metavar="PAGE.html",
    help="Write one page with the files inside, and serve nothing; - is a pipe.",
)
@force_option
def view(
    files: tuple[str, ...], port: int | None, no_browser: bool, page: str | None, force: bool
) -> int:
    """Show .hapf files in the browser: all channels, pan and zoom, spectra, damage, events.

    A server on this computer gives the page and the parts of the files that it shows. No other
    computer can reach it, and the page loads nothing else. FILE may be a URL. Ctrl-C ends
    the server.

    \b
    hapfmt view touch.hapf
    hapfmt view left.hapf right.hapf --no-browser
    hapfmt view touch.hapf --export touch.html
    """
    if page is not None:
        refuse_options(page, port, no_browser, force)
    elif force:
        raise ParameterError("--force requires --export")
    from ..viewer.server import ServedFile

    with ExitStack() as stack:
        served = [
            stack.enter_context(ServedFile(input_of(file), name))
            for file, name in zip(files, names_of(files), strict=True)
        ]
        for file, each in zip(files, served, strict=True):
            refuse_other_format(file)
            refuse_alien(file, each)
        if page is not None:
            write(served, page, force)
        else:
            serve(served, port, no_browser)
    return 0


def refuse_options(page: str, port: int | None, no_browser: bool, force: bool) -> None:
    if port is not None or no_browser:
        name = "--no-browser" if port is None else "--port"
        raise ParameterError(f"{name} is for the server, and --export starts none")
    if page != "-":
        if Path(page).suffix.lower() not in (".html", ".htm"):
            raise ParameterError("the name of a page ends in .html", path=page)
        refuse(page, force)


def refuse_other_format(file: str) -> None:
    """ParameterError for a file of another format that hapfmt reads, by its content or name."""
    from ..convert.formats import Source, of_source
    from ..format.layout import SIGNATURE

    if file == "-" or is_url(file):
        return
    with Source(file) as source:
        if source.head.startswith(SIGNATURE):
            return
        found = of_source(source)
    if found is None and Path(file).suffix.lower() != HAPF:  # such a file may be damaged
        raise ParameterError("this is not a .hapf file", path=file)
    if found is not None:
        name = Path(file).stem + ".hapf"
        raise ParameterError(
            f"the page shows .hapf files, and this is {found.title}; encode it first:",
            path=file,
            more=[f"  hapfmt encode {shlex.quote(file)} {shlex.quote(name)}"],
        )


def refuse_alien(name: str, file: ServedFile) -> None:
    """The FormatError of ``hapfmt info`` for a file without any chunk, which no page can show."""
    from ..format.walk import find_header
    from ..reading.opening import no_chunk

    with file.opened() as source:
        if find_header(source, 0, None) is None:
            raise no_chunk(source).at(path=name)


def names_of(files: Sequence[str]) -> list[str]:
    """As the page shows them: without folders, unless two would be the same."""
    short = [
        "standard input"
        if file == "-"
        else PurePosixPath(urlsplit(file).path).name
        if is_url(file)
        else Path(file).name
        for file in files
    ]
    count = Counter(short)
    return [
        file if count[name] > 1 and not is_url(file) else name
        for file, name in zip(files, short, strict=True)
    ]


def write(served: Sequence[ServedFile], page: str, force: bool) -> None:
    from ..viewer.export import export

    if page == "-" and width_of() is not None:
        raise ParameterError("a page is too long for a terminal: write it to a file or a pipe")
    with progress("writing") as advance:
        size = export(served, output_of(page), force=force, progress=advance)
    if size > LARGE:
        note(
            f"{size // 1_000_000} MB are slow to open in a browser; hapfmt view FILE reads in parts"
        )
    tell_written(page, "a page with its data")


def serve(served: Sequence[ServedFile], port: int | None, no_browser: bool) -> None:
    """Until Ctrl-C."""
    from ..viewer.server import ViewServer

    with ViewServer(served, port or 0) as server:
        say(server.url, whole=True)
        sys.stdout.flush()
        note("Ctrl-C ends the server")
        try:
            if not no_browser:
                open_browser(server.url)
            server.wait()
        except KeyboardInterrupt:
            pass


def open_browser(url: str) -> threading.Thread:
    """In a thread: some browsers return only when their window is closed."""

    def start() -> None:
        if sys.platform.startswith("linux") and not any(map(os.environ.get, DISPLAYS)):
            note("no display here: open the address in a browser yourself")
        elif not webbrowser.open(url):
            note("no browser was found: open the address yourself")

    thread = threading.Thread(target=start, daemon=True)
    thread.start()
    return thread
