"""All text that a person sees goes out here: no control character from a file or a name reaches
the terminal, and lines break between words."""

from __future__ import annotations

import errno
import io
import os
import sys
import unicodedata
from collections.abc import Sequence
from typing import Any, BinaryIO

import click

from ..closing import Closing

REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
JOINED = "\N{NO-BREAK SPACE}"
"""Between a number and its unit: lines do not break here. Shown as a space."""
LEAST_WIDTH = 20
"""Columns of a terminal that says it has fewer, or none."""
closed: set[int] = set()
"""Standard streams that were closed before this program began."""


def printable(text: str) -> str:
    """Text without what could steer a terminal or forge a line: C0 and C1 controls, DEL, line
    breaks, bidirectional controls, lone surrogates."""
    if text.isprintable():
        return text
    return "".join(
        c
        if c.isprintable() or c == JOINED
        else " "
        if unicodedata.category(c) == "Zs"
        else REPLACEMENT
        for c in text
    )


def say(text: str = "", *, err: bool = False, whole: bool = False) -> None:
    """One line on standard output (``err``: error), in several where a terminal is narrower.
    ``whole``: never broken, for a command that a person may copy."""
    text = printable(text)
    width = None if whole else width_of(err=err)
    lines = [text] if width is None else wrapped(text, width)
    put("\n".join(lines) + "\n", err=err)


def note(text: str) -> None:
    """Something that a person should know, on standard error."""
    say(f"note: {text}", err=True)


def complain(text: str, more: Sequence[str] = ()) -> None:
    """Something that is wrong, on standard error; ``more``: the further lines of an error."""
    say(f"hapfmt: {text}", err=True)
    for line in more:
        say(line, err=True, whole=line.startswith("  hapfmt "))


def status(text: str) -> None:
    """A line of standard error that the next one overwrites; only for a terminal."""
    put("\r\x1b[K" + clipped(printable(text), width_of(err=True)), err=True)


class StatusLine(Closing):
    """Shows one line after the other in the same place, and none at the end."""

    def __init__(self) -> None:
        self.shown = sys.stderr.isatty()

    def show(self, text: str) -> None:
        if self.shown:
            status(text)

    def close(self) -> None:
        self.show("")


def document(text: str) -> None:
    """A whole text, such as a TOML file: as it is in a pipe, printable on a terminal."""
    if width_of() is not None:
        text = "\n".join("\t".join(map(printable, line.split("\t"))) for line in text.split("\n"))
    put(text)


def raw(text: str) -> None:
    """Text that this program made and that needs no care: JSON, keys that a person typed."""
    put(text)


def put(text: str, *, err: bool = False) -> None:
    stream = sys.stderr if err else sys.stdout
    text = text.replace(JOINED, " ")
    encoding = getattr(stream, "encoding", None) or "utf-8"
    if "utf" not in encoding.lower():
        text = text.encode(encoding, "replace").decode(encoding)
    elif not text.isascii():
        text = text.encode("utf-8", "replace").decode("utf-8")
    try:
        click.echo(text, err=err, nl=False)
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            raise
        name = "standard error" if err else "standard output"
        raise OSError(error.errno, reason(error), name) from None


def reason(error: OSError) -> str:
    """In words; a stream that was closed from the start is not a bad descriptor."""
    if closed and error.errno == errno.EBADF:
        return "a standard stream is closed"
    return error.strerror or str(error)


def hold_streams() -> None:
    """Give closed standard streams their descriptors back, so that no file that is opened later
    gets one of them. Whoever reads the input or writes the output then meets an error; messages
    to a closed standard error are lost."""
    ways = (("stdin", os.O_WRONLY, "r"), ("stdout", os.O_RDONLY, "w"), ("stderr", os.O_WRONLY, "w"))
    for descriptor, (name, flags, mode) in enumerate(ways):
        if getattr(sys, name) is None:
            # The lowest free descriptor is the one that is missing.
            setattr(sys, name, os.fdopen(os.open(os.devnull, flags), mode))
            closed.add(descriptor)


def drop_output() -> None:
    """After a failed write: what is still buffered must not fail again while Python ends."""
    for stream, descriptor in ((sys.stdout, 1), (sys.stderr, 2)):
        try:
            stream.flush()
        except (OSError, ValueError):
            sink = os.open(os.devnull, os.O_WRONLY)
            os.dup2(sink, descriptor)
            os.close(sink)


def width_of(*, err: bool = False) -> int | None:
    """Columns of the terminal that text goes to; None where it goes anywhere else."""
    stream = sys.stderr if err else sys.stdout
    try:
        if not stream.isatty():
            return None
        width = os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError, AttributeError):
        return None
    columns = os.environ.get("COLUMNS", "")
    width = width or (int(columns) if columns.isdecimal() else 80)
    return max(width, LEAST_WIDTH)


def cells(text: str) -> int:
    """Columns that a printable text takes on a terminal."""
    if text.isascii():
        return len(text)
    return sum(
        0 if unicodedata.combining(c) else 2 if unicodedata.east_asian_width(c) in "WF" else 1
        for c in text
    )


def wrapped(text: str, width: int, indent: str | None = None) -> list[str]:
    """Lines of at most ``width`` columns, broken between words; a longer word stays whole."""
    if cells(text) <= width:
        return [text]
    lead = text[: len(text) - len(text.lstrip(" "))]
    further = lead + "  " if indent is None else indent
    lines, line, empty = [], lead, True
    for word in filter(None, text.split(" ")):
        if not empty and cells(line) + 1 + cells(word) > width:
            lines.append(line)
            line, empty = further, True
        line += word if empty else f" {word}"
        empty = False
    return [*lines, line]


def clipped(text: str, width: int | None) -> str:
    """The beginning of a text that must stay on one line."""
    if width is None or cells(text) < width:
        return text
    return text[: max(width - 2, 0)] + "…"


def shortened(text: str, width: int) -> str:
    """A text of at most ``width`` columns: its middle is left out."""
    if cells(text) <= width:
        return text
    head: list[str] = list(text)
    tail: list[str] = []
    half = (width - 1) // 2
    while head and cells("".join(tail)) + cells(head[-1]) <= half:
        tail.insert(0, head.pop())
    room = width - 1 - cells("".join(tail))
    while head and cells("".join(head)) > room:
        head.pop()
    return "".join(head) + "…" + "".join(tail)


class TerminalText(io.RawIOBase):
    """A binary stream for a terminal: text that is written to it as UTF-8 is shown printable."""

    def __init__(self) -> None:
        super().__init__()
        self.rest = b""

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.rest += bytes(data)
        *lines, self.rest = self.rest.split(b"\n")
        for line in lines:
            self.show(line + b"\n")
        return len(data)

    def show(self, line: bytes) -> None:
        document(line.decode("utf-8", "replace").replace("\r\n", "\n"))

    def flush(self) -> None:
        if self.rest:
            self.show(self.rest)
            self.rest = b""


def terminal_text() -> BinaryIO:
    stream: Any = TerminalText()
    return stream  # type: ignore[no-any-return]
