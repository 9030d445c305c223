"""Terminal output: all text for people is printed through this file.

It removes control characters that come from files or names, and breaks lines between words.
Tables fit the terminal: the label is the first column and stays whole, and cells break at words.
Columns that do not fit are left out and listed in a note. The help of a verb is its description,
examples, and options in groups.
"""

from __future__ import annotations

import errno
import io
import os
import re
import sys
import unicodedata
from collections.abc import Iterator, Sequence
from typing import Any, BinaryIO, NamedTuple

import click
from click.shell_completion import CompletionItem

from ..files import Closing

REPLACEMENT = "\N{REPLACEMENT CHARACTER}"
JOINED = "\N{NO-BREAK SPACE}"
"""Between a number and its unit: lines do not break here. Shown as a space."""
LEAST_WIDTH = 20
"""Columns of a terminal that says it has fewer, or none."""
closed: set[int] = set()
"""Standard streams that were closed before this program began."""


def joined(text: str) -> str:
    """Return the text with each number joined to its unit."""
    return re.sub(r"(?<=\d) (?=\S)", JOINED, text)


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


IN_OPTIONS = {
    **{
        f"{name}{verb}": f"--{name.replace('vectors', 'vector')}{verb}"
        for name in (
            "k", "floor", "felt", "quality", "snr", "bitrate", "weighting", "bits", "step",
            "interpolation", "tolerance", "vectors", "effort",
        )
        for verb in (" requires ", " would do nothing", " does nothing")
    },
    "max_error": "--max-error", "force_error=True": "--force-error", "st_sim": "--st-sim",
    "texture=False": "--no-texture", "synthetic_texture=True": "--synthetic-texture",
    "texture_codec": "--texture-codec", "cutoff_hz": "--cutoff",
    "references=False": "--no-references", "fast=True": "--fast", "effort='": "--effort '",
    "add unit='N' or felt='all'": "add --unit N or --felt all",
    "channels is floor": "channels is --floor",
    "; use force=True to ": "; use --force to ",
    "hapfmt.Reader reads what is intact; hapfmt.recover(file, into) writes an intact copy": (
        "hapfmt decode gives what is intact; hapfmt recover writes an intact copy"
    ),
    "fetch the file first, or let it be copied: Reader(url, spool=True)": "fetch the file first",
    "give one of quality, snr, st_sim, bitrate": (
        "give one of --quality, --snr, --st-sim, --bitrate"
    ),
    "with texture=False and felt='all'": "--no-texture --felt all",
    "read the original with keep_stamps=True": "add --keep-stamps",
    "(max_memory=)": "(--max-memory)",
    "(rate=)": "(--rate)",
    "(select=)": "(--select)",
    "(episode=)": "(--episode)",
    "(map=)": "(--map)",
    "(clock=)": "(--clock)",
    "only the regular times are stored": (
        "only the regular times are stored. To keep the others too, add --keep-stamps"
    ),
    "(transpose=True)": "(--transpose)",
    "(transpose=False)": "(--no-transpose)",
    "(fps=)": "(--fps)",
    "choose those of one rate (sel)": (
        "choose those of one rate with --select (convert) or --channels (decode)"
    ),
    "(clock='frame_index')": "(--clock frame_index)",
    "(clock='timestamp')": "(--clock timestamp)",
    "such as rate=1000": "such as --rate 1000",
    "exact=True cuts": "--exact cuts",
    "exact=True requires start or stop": "--exact requires --start or --stop",
    "on_bad_line='gap'": "--on-bad-line gap",
    "leave out on_bad_line": "leave out --on-bad-line",
    ": add lsb=": ": add --lsb",
    "use transpose=True": "use --transpose",
    "use transpose=False": "use --no-transpose",
    "if not, transpose=False": "if not, --no-transpose",
    'give offsets=, times="epoch" or times="same",': "give --offset, --by-epoch or --same-times,",
    'give times="epoch", times="same" (tick 0 is the same moment in all), or offsets=': (
        "give --by-epoch, --same-times (tick 0 is the same moment in all), or --offset FILE=SECONDS"
    ),
}  # fmt: skip
"""Words of errors for Python -> for the command line."""


def pattern_of(keyword: str) -> str:
    """Return a pattern of a keyword in Python, which its translation does not fit."""
    start = r"(?<![\w-])" if keyword[0].isalnum() else ""
    _, same, added = IN_OPTIONS[keyword].partition(keyword)
    return start + re.escape(keyword) + (f"(?!{re.escape(added)})" if same and added else "")


_KEYWORDS = re.compile("|".join(map(pattern_of, sorted(IN_OPTIONS, key=len, reverse=True))))


def in_options(text: str) -> str:
    """Return a message of the package with options in place of keywords."""
    return _KEYWORDS.sub(lambda match: IN_OPTIONS[match[0]], text)


BAD = frozenset({"damaged", "nonconforming", "unsupported", "broken", "differs", "failed"})
"""Verdicts that are red on a terminal with colours."""


def colored(text: str, word: str) -> str:
    """Return a text whose last ``word`` is red if it is a bad verdict and colours are wanted."""
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    if word not in BAD or word not in text or plain:
        return text
    head, found, tail = text.rpartition(word)
    return head + click.style(found, fg="red") + tail  # put leaves colours out of pipes


def say(text: str = "", *, err: bool = False, whole: bool = False, verdict: str = "") -> None:
    """One line on standard output (``err``: error), in several where a terminal is narrower.
    ``whole``: never broken, for a command that a person may copy. ``verdict``: a word of it."""
    text = printable(text)
    width = None if whole else width_of(err=err)
    lines = [text] if width is None else wrapped(text, width)
    put(colored("\n".join(lines), verdict) + "\n", err=err)


def note(text: str) -> None:
    """Prints a note on standard error."""
    say(f"note: {in_options(text)}", err=True)


def complain(text: str, more: Sequence[str] = ()) -> None:
    """Prints an error on standard error; ``more``: its further lines."""
    say(f"hapfmt: {in_options(text)}", err=True)
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
    """The text of an OSError; a stream closed from the start gets a text of its own."""
    if closed and error.errno == errno.EBADF:
        return "a standard stream is closed"
    if error.errno == errno.EISDIR:
        return "this is a folder, not a file"
    return error.strerror or str(error)


def hold_streams() -> None:
    """Give closed standard streams their descriptors back, so that no file that is opened later
    gets one of them. Reading the input or writing the output then fails; messages
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


GAP = "  "
NARROW = 12
"""Columns of text wrap down to this width before a column is left out."""


class Column(NamedTuple):
    header: str
    drop: int = 0
    """On a narrow terminal the column with the largest number goes first; 0 always stays."""


def table(
    headers: Sequence[str | Column],
    rows: Sequence[Sequence[str]],
    *,
    err: bool = False,
    elsewhere: str = "--json",
) -> None:
    """A table on standard output (``err``: error). The first column is the label and always stays;
    of plain headers the last goes first. ``elsewhere``: how else a person gets all columns."""
    columns = [
        each if isinstance(each, Column) else Column(each, place)
        for place, each in enumerate(headers)
    ]
    texts = [[printable(cell) for cell in row] for row in rows]
    lines, left_out, needed = laid_out(columns, texts, width_of(err=err))
    for line in lines:
        put(line + "\n", err=err)
    if left_out:
        names = ", ".join(column.header for column in left_out)
        also = f" or {elsewhere}" if elsewhere else ""
        say(f"(not shown: {names}; a terminal of {needed} columns{also} shows them)", err=err)


def laid_out(
    columns: Sequence[Column], rows: Sequence[Sequence[str]], width: int | None
) -> tuple[list[str], list[Column], int]:
    """The lines, the columns left out, and the width that would show all of them."""
    numeric = [all(is_number(row[c]) for row in rows) and bool(rows) for c in range(len(columns))]
    shown = list(range(len(columns)))
    natural = [
        max([cells(column.header), *(cells(row[c]) for row in rows)])
        for c, column in enumerate(columns)
    ]
    least = [
        max(
            [longest_word(column.header)]
            + [cells(row[c]) if c == 0 or numeric[c] else longest_word(row[c]) for row in rows]
        )
        for c, column in enumerate(columns)
    ]
    least = [max(n, min(full, NARROW)) for n, full in zip(least, natural, strict=True)]
    for c, column in enumerate(columns):
        if numeric[c]:
            # Headers of numbers wrap: they are often wider than the numbers.
            least[c] = max([longest_word(column.header), *(cells(row[c]) for row in rows)])
    if width is not None:
        while needed(shown, least) > width:
            droppable = [c for c in shown if columns[c].drop and c]
            if not droppable:
                break
            shown.remove(max(droppable, key=lambda c: (columns[c].drop, c)))
        widths = shares(shown, natural, least, width)
    else:
        widths = natural
    header = [column.header for column in columns]
    lines = line_of(header, shown, widths, numeric)
    lines.append("─" * needed(shown, widths))
    for row in rows:
        lines += line_of(row, shown, widths, numeric)
    left_out = [column for c, column in enumerate(columns) if c not in shown]
    return lines, left_out, needed(range(len(columns)), least)


def needed(shown: Sequence[int], widths: Sequence[int]) -> int:
    return sum(widths[c] for c in shown) + len(GAP) * (len(shown) - 1)


def shares(
    shown: Sequence[int], natural: Sequence[int], least: Sequence[int], width: int
) -> list[int]:
    """Widths of the columns: spare width goes to the columns that lack least."""
    widths = list(least)
    spare = width - needed(shown, widths)
    for c in sorted(shown, key=lambda c: natural[c] - least[c]):
        more = max(0, min(natural[c] - widths[c], spare))
        widths[c] += more
        spare -= more
    while spare < 0:
        # Nothing is left to leave out: the widest texts lose their middle.
        widest = max(shown, key=lambda c: widths[c])
        if widths[widest] <= 1:
            break
        widths[widest] -= 1
        spare += 1
    return widths


def line_of(
    row: Sequence[str], shown: Sequence[int], widths: Sequence[int], numeric: Sequence[bool]
) -> list[str]:
    """One row, of as many lines as its highest cell."""
    parts = []
    for c in shown:
        words = " ".join(shortened(word, widths[c]) for word in row[c].split(" "))
        cell = shortened(row[c], widths[c]) if c == 0 and row[c] else words
        parts.append(wrapped(cell, widths[c], ""))
    lines = []
    for k in range(max(map(len, parts))):
        line = []
        for c, part in zip(shown, parts, strict=True):
            text = part[k] if k < len(part) else ""
            blank = " " * (widths[c] - cells(text))
            shown_text = colored(text, row[c]) if c else text
            line.append(blank + shown_text if numeric[c] else shown_text + blank)
        lines.append(GAP.join(line).rstrip())
    return lines


def longest_word(text: str) -> int:
    return max((cells(word) for word in text.split(" ")), default=0)


def is_number(text: str) -> bool:
    """A number, a number with its unit, or a dash."""
    first, _, unit = text.replace(JOINED, " ").partition(" ")
    return first.strip("-+%x.0123456789eE") in ("", "inf", "nan") and " " not in unit


OTHER = "Options"
"""The group of options that are in no other one."""

GROUPS = {
    "Quality": (
        *("--preset", "--quality", "--max-error", "--force-error", "--k", "--floor", "--felt"),
        *("--no-texture", "--snr", "--st-sim", "--bitrate", "--synthetic-texture", "--bits"),
        *("--step", "--effort", "--fast"),
    ),
    OTHER: (),
    "What is read": (
        *("--channels", "--start", "--stop", "--band", "--layer", "--input", "--input-format"),
        *("--rate", "--labels", "--unit", "--lsb", "--against", "--transpose", "--select"),
        *("--clock", "--episode", "--map", "--keep-stamps"),
    ),
    "Output": (
        *("--help", "--help-all", "--output", "--output-format", "--force", "--json", "--schema"),
        *("--verbose", "--overview", "--plot", "--csv", "--export"),
    ),
    "For experts": (
        *("--tolerance", "--cutoff", "--interpolation", "--texture-codec", "--weighting"),
        *("--vector", "--references", "--cluster", "--digest", "--canonical", "--threads"),
        *("--max-memory", "--fsync", "--on-full"),
    ),
}
"""Where an option is shown, in the order of the help."""

SHOWN = 20
"""Most options in a help. A verb with more leaves out what experts use, and has --help-all."""

RARE = {
    *GROUPS["For experts"],
    *("--force-error", "--k", "--floor", "--snr", "--st-sim", "--synthetic-texture", "--bits"),
    *("--step", "--fast", "--clock", "--episode", "--map"),
}
"""Options that only experts use."""


class Text(click.types.StringParamType):
    """A shell completes names of files, as it does for programs that it does not know."""

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002
        param: click.Parameter,  # noqa: ARG002
        incomplete: str,
    ) -> list[CompletionItem]:
        return [CompletionItem(incomplete, type="file")]


AS_TYPED = "hapfmt.as_typed"
"""Key of a click context: the words behind the verb."""


class Verb(click.Command):
    """A command whose examples have a heading, and whose options come in groups."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.meta[AS_TYPED] = list(args)
        return super().parse_args(ctx, args)

    def __init__(self, *names: Any, **given: Any) -> None:
        super().__init__(*names, **given)
        for param in self.params:
            if param.type is click.STRING:
                param.type = Text()
        rare = [param for param in self.params if RARE & set(param.opts)]
        self.leaves_out = len(self.params) > SHOWN and bool(rare)
        if self.leaves_out:
            text = f"Show this message with {len(rare)} more options, for experts."
            self.params.append(
                click.Option(
                    ["--help-all"], is_flag=True, is_eager=True, expose_value=False, help=text,
                    callback=help_all,
                )
            )  # fmt: skip

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        texts, examples = self.parts()
        whole, self.help = self.help, "\n\n".join(texts)
        try:
            super().format_help_text(ctx, formatter)
        finally:
            self.help = whole
        if examples:
            with formatter.section("Examples"):
                for line in examples:
                    formatter.write(f"  {line}\n")

    def parts(self) -> tuple[list[str], list[str]]:
        """Paragraphs of prose, and lines of commands."""
        texts, examples = [], []
        for paragraph in re.split(r"\n\s*\n", self.help or ""):
            lines = [line.strip() for line in paragraph.strip().splitlines()]
            if lines[:1] == ["\b"] and all("hapfmt " in line for line in lines[1:]):
                examples += lines[1:]
            else:
                texts.append(paragraph)
        return texts, examples

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        groups: dict[str, list[tuple[str, str]]] = {name: [] for name in GROUPS}
        for name, record in self.records(ctx, whole=not self.leaves_out or HELP_ALL in ctx.meta):
            groups[name].append(record)
        for name, records in groups.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)

    def records(
        self, ctx: click.Context, *, whole: bool = True
    ) -> Iterator[tuple[str, tuple[str, str]]]:
        """Yield the group of an option, its names, its help. ``whole``: also of rare options."""
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx) if isinstance(param, click.Option) else None
            if record is not None and (whole or not RARE & set(param.opts)):
                found = (name for name, ours in GROUPS.items() if set(ours) & set(param.opts))
                yield next(found, OTHER), record


HELP_ALL = f"{__name__}.help_all"


def help_all(ctx: click.Context, _param: click.Parameter, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:
        ctx.meta[HELP_ALL] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()
