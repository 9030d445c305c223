"""Shared by the verbs: input and output files, pipes, progress, options, JSON output.

Also the options and reports of the verbs that edit files, and :func:`open_parts`, which opens a
file of any format for plot and compare.
"""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import click

from ..errors import DAMAGED, UNSUPPORTED, HapfmtError, ParameterError, channels_called
from ..files import refuse
from ..format.wire import FILE_ID_LIMIT, id_text
from ..limits import Limits
from ..numbers import counted, exact
from ..units import units_for
from .screen import JOINED, closed, complain, note, raw, say, terminal_text, width_of

if TYPE_CHECKING:
    from ..convert.tables import Import
    from ..edit import Edited, Original
    from ..encoder.settings import Tolerance
    from ..lab.parts import Parts
    from ..reading.damage import DamageReport
    from ..reading.reader import Reader
    from ..recording import Recording

HAPF, CSV = ".hapf", ".csv"
ARRAYS = (".npy", ".npz")
SHOWN_LINES = 20
BITS = frozenset(str(bits) for bits in (0, *range(2, 17)))
LONG_SECONDS = 0.5
"""Work shorter than this shows no progress."""

json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")


def print_schema(ctx: click.Context, _param: click.Parameter, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:
        path = Path(__file__).parent / "schemas" / f"{ctx.command.name}.json"
        raw(path.read_text("utf-8"))
        ctx.exit()


schema_option = click.option(
    "--schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=print_schema,
    help="Print the JSON Schema of the output, without FILE.",
)
verbose_option = click.option(
    "-v", "--verbose", is_flag=True, help="Print each damage with its place and the rule it breaks."
)
threads_option = click.option(
    "--threads",
    type=click.IntRange(1),
    metavar="N",
    help="Number of threads; the output does not depend on it "
    "[HAPFMT_THREADS, else the number of CPUs].",
)


class MemoryType(click.ParamType["Limits"]):
    """Limits of a size in bytes."""

    name = "size"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Limits:
        if isinstance(value, Limits):
            return value
        try:
            return Limits.of_memory(value)
        except ParameterError as error:
            self.fail(error.message, param, ctx)


memory_option = click.option(
    "--max-memory",
    type=MemoryType(),
    default=Limits(),
    metavar="SIZE",
    help="Most memory for the contents of a file, such as 256M. A file that needs more is refused "
    "with exit code 4. [no limit for .hapf; 4G for other formats; 1G for gaps in an output]",
)
"""Gives the verb ``max_memory``, the Limits for everything that it reads."""
input_format_option = click.option(
    "--input-format",
    metavar="FORMAT",
    help="Format of the input, if its name does not say: npz, csv, mcap ... "
    "('hapfmt info --formats' lists all).",
)


def output_format_option(*more: str) -> Callable[[Any], Any]:
    """Formats of other programs, and those of this verb."""
    known = ", ".join(["npz", "csv", *more])
    text = f"Format of the output, if its name does not say: {known} ..."
    return click.option("--output-format", metavar="FORMAT", help=text)


force_option = click.option("-f", "--force", is_flag=True, help="Replace an existing output file.")


def echo_json(value: Any) -> None:
    """One line of JSON; numbers that are not finite become null."""
    try:
        text = json.dumps(value, sort_keys=True, allow_nan=False)
    except ValueError:
        text = json.dumps(finite(value), sort_keys=True, allow_nan=False)
    raw(text.replace("\x7f", "\\u007f") + "\n")


def finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(inner) for inner in value]
    return None if isinstance(value, float) and not isfinite(value) else value


@contextmanager
def progress(label: str) -> Iterator[Callable[[int, int], None]]:
    """A callback (done, all) that draws a bar on standard error, if that is a terminal, once the
    work takes longer than half a second. After the block it draws nothing."""
    import time

    if not sys.stderr.isatty():
        yield lambda _done, _all: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    began = time.monotonic()
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        redirect_stdout=sys.stdout.isatty(),  # a pipe or a file gets what is printed
    )
    task = bar.add_task(label, total=None)

    ended = False

    def advance(done: int, total: int) -> None:
        bar.update(task, completed=done, total=total)
        if not ended and time.monotonic() - began > LONG_SECONDS:
            bar.start()

    try:
        yield advance
    finally:
        ended = True
        bar.stop()


def output_option(metavar: str, text: str) -> Callable[[Any], Any]:
    """The option -o, in every verb without an argument for its output."""
    return click.option("-o", "--output", metavar=metavar, help=text)


def fraction(text: str) -> Fraction:
    """A number as it is written: 0.1 is 1/10, and 44100/7 is allowed."""
    try:
        return exact(text)
    except ParameterError as error:
        raise click.BadParameter(error.message) from None


class PresetType(click.Choice[str]):
    """A preset; old names are taken with a note."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from ..encoder.settings import alias_note

        text = alias_note(str(value))
        if not text:
            return super().convert(value, param, ctx)
        note(text)
        return str(value)


class ShareType(click.ParamType[Fraction]):
    """0.1 or 10%."""

    name = "share"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Fraction:
        from ..encoder.settings import share

        try:
            return share(value)
        except ParameterError as error:
            self.fail(error.message, param, ctx)


class FileIdType(click.ParamType["int | str"]):
    """A number below 2^64; ``content`` too where a whole recording is encoded."""

    name = "file id"

    def __init__(self, *, content: bool = False) -> None:
        self.content = content

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> int | str:
        if value == "content" and self.content:
            return "content"
        try:
            found = value if isinstance(value, int) else int(value, 0)
        except ValueError:
            found = -1
        if not 0 <= found < FILE_ID_LIMIT:
            self.fail(f"{value!r} is not a number between 0 and 2^64 - 1", param, ctx)
        return found


file_id_option = click.option(
    "--file-id",
    type=FileIdType(),
    metavar="ID",
    help="Of a file with parts of others, read the one with this id. [the one most of it has]",
)


class FractionType(click.ParamType[Fraction]):
    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Fraction:
        try:
            return exact(value)
        except ParameterError as error:
            self.fail(error.message, param, ctx)


class BitsType(click.ParamType[int]):
    """0, or 2 to 16."""

    name = "bits"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if str(value) not in BITS:
            self.fail(f"{value!r} is not 0 or 2 to 16", param, ctx)
        return int(value)


class AmountType(click.ParamType["Tolerance"]):
    """1e-6 in the channel's unit, 10mN, 0.5lsb, 0.01% of its range."""

    name = "amount"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Tolerance:
        from ..encoder.settings import Tolerance

        if isinstance(value, Tolerance):
            return value
        try:
            return Tolerance.parse(str(value))
        except ParameterError as error:
            self.fail(error.message, param, ctx)


transpose_option = click.option(
    "--transpose/--no-transpose",
    default=None,
    help="--transpose: arrays in .npy and .npz are [samples, channels]. --no-transpose: they are "
    "[channels, samples]. [an array of more rows than columns is refused]",
)
labels_option = click.option(
    "--labels",
    metavar="A,B,...",
    help="Labels of the channels, in their order: fx,fy,fz. [as the input names them]",
)


def import_options(command: Any) -> Any:
    """Options for what a file of another format leaves open."""
    for option in reversed(_IMPORT_OPTIONS):
        command = option(command)
    return command


_IMPORT_OPTIONS = (
    click.option("--rate", help="Ticks per second of channels without a rate: 1000, 44100/7."),
    transpose_option,
    click.option(
        "--select",
        multiple=True,
        metavar="NAME",
        help="Read only this topic, data set, stream or column, or those that a pattern fits. May "
        "be repeated.",
    ),
    click.option(
        "--clock",
        metavar="NAME",
        help="The stamps that count: header or log for messages, or the name of a time array.",
    ),
    click.option("--episode", metavar="N", help="Number or name of one episode of several."),
    click.option(
        "--map",
        "map",
        metavar="MAP.TOML",
        help="Says where channels, times and units are, for HDF5 and MAT.",
    ),
    click.option(
        "--keep-stamps",
        is_flag=True,
        help="Keep the original time stamps in a channel, one for each topic or table.",
    ),
)
IMPORT_NAMES = ("rate", "transpose", "select", "clock", "episode", "map", "keep_stamps")
fps_option = click.option(
    "--fps",
    metavar="N",
    help="Frames per second of a LeRobot dataset; each frame has a window of samples. [the rate of "
    "the channels]",
)
unit_option = click.option(
    "--unit",
    metavar="UNIT",
    help="Unit of the channels: one for all, or one for each, as in N,N,mm. [as the input says]",
)
start_option = click.option(
    "--start",
    type=FractionType(),
    metavar="S",
    help="Start of the part in seconds, included. [the beginning]",
)
stop_option = click.option(
    "--stop",
    type=FractionType(),
    metavar="S",
    help="End of the part in seconds, not included. [the end]",
)


def refuse_span(start: Fraction | None, stop: Fraction | None) -> None:
    """Refuses an empty time range, which is a mistake on the command line."""
    if stop is not None and (start or 0) >= stop:
        began = 0 if start is None else float(start)
        raise click.BadParameter(
            f"the time range is empty: --start {began:g} is not before --stop {float(stop):g}"
        )


def parse_channels(texts: Sequence[str], labels: Sequence[str]) -> list[str] | None:
    """Labels or numbers, with commas between them unless a label has one itself."""
    if not texts:
        return None
    return [part for text in texts for part in ([text] if text in labels else text.split(","))]


def input_of(name: str) -> str | BinaryIO:
    return standard_input() if name == "-" else name


def standard_input() -> BinaryIO:
    if 0 in closed:
        raise ParameterError("standard input is closed")
    return sys.stdin.buffer


def way_out(error: HapfmtError) -> Sequence[str]:
    """The further lines of an error; for a file of another format, the command that encodes it."""
    path = Path(error.path or "")
    suffix = path.suffix.lower()
    if error.requirement != "FIL-001" or suffix in ("", HAPF) or not path.is_file():
        return error.more
    from ..convert.formats import Source, of_source

    with Source(path) as source:
        found = of_source(source) if source.head else None
    if found is None or not found.reads:
        return error.more
    names = shlex.join([str(path), str(path.with_suffix(HAPF))])
    rate = " --rate HZ" if suffix == ".npy" else ""
    return [
        "if this is a recording in another format, make a hapf file of it:",
        f"  hapfmt encode {names}{rate}",
    ]


def output_of(name: str, *, text: bool = False) -> str | BinaryIO:
    """``text``: what is written is text, which a terminal may show."""
    if name != "-":
        return name
    if 1 in closed:
        raise ParameterError("standard output is closed")
    if width_of() is not None:
        if text:
            return terminal_text()
        raise ParameterError("this format is binary: write it to a file or a pipe")
    return sys.stdout.buffer


def refuse_target(name: str, force: bool) -> None:
    """Refuses a target where no .hapf file may be written, before any work."""
    from ..convert import refuse_foreign

    if name == "-":
        return
    refuse_foreign(name)
    refuse(name, force)


def suffix_of(name: str, format_: str | None, default: str | None = None) -> str:
    if format_:
        return "." + format_.lower().removeprefix(".")
    if name == "-":
        if default:
            return default
        raise ParameterError(
            "a pipe has no suffix: give --input-format or --output-format (npz, csv, hapf ...)"
        )
    return Path(name).suffix.lower()


def refuse_output(name: str, format_: str | None, force: bool) -> None:
    """Refuses a target of another format, before any work."""
    from ..convert.formats import named, with_suffix

    suffix = Path(name).suffix.lower() if format_ else suffix_of(name, None, "")
    chosen = named(format_) if format_ else with_suffix(suffix, written=True)
    known = suffix == HAPF or with_suffix(suffix)
    if chosen and chosen.suffixes and suffix not in chosen.suffixes and known:
        tell_suffix(name, chosen.suffixes[0])
    if name != "-" and not (chosen and chosen.folder):
        refuse(name, force)


def tell_suffix(name: str, usual: str) -> None:
    """Note that a file gets another format than its name says."""
    note(f"{name} will be a {usual[1:]} file; the usual suffix is {usual}")


def options_by_input(
    inputs: Sequence[str | None], format_: str | None, given: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """The options of ``import_options`` by the inputs that use them. Refuses one that none uses."""
    from ..convert.formats import named, with_suffix

    asked = asked_of(given)
    found: dict[str, dict[str, Any]] = {name: {} for name in inputs if name}
    others = [name for name in found if suffix_of(name, format_, "") != HAPF]
    for option, value in asked.items():
        users = []
        for name in others:
            chosen = named(format_) if format_ else with_suffix(suffix_of(name, None, ""))
            if chosen is None or option in ("rate", "select", *chosen.options):
                users.append(name)
        for name in users or others:  # where none uses it, its reader says so
            found[name][option] = value
        if not others:
            raise ParameterError(f"{option_of(option)} {FOREIGN_ONLY}")
    return found


def refuse_idle(reason: str, **given: Any) -> None:
    """ParameterError for the first of these options that was given: it cannot act, for a reason."""
    for name, value in given.items():
        if value is not None and value is not False and value not in ((), ""):
            raise ParameterError(f"{option_of(name)} {reason}")


FOREIGN_ONLY = "is for inputs of other formats than .hapf"


def refuse_format(input_format: str | None, *names: str | None) -> None:
    """ParameterError for an --input-format where all of these inputs are .hapf files."""
    if all(name is None or name.lower().endswith(HAPF) for name in names):
        refuse_idle(FOREIGN_ONLY, input_format=input_format)


def option_of(name: str) -> str:
    return "--" + name.replace("_", "-")


def load_recording(
    name: str,
    format_: str | None,
    limits: Limits | None = None,
    *,
    labels: str | None = None,
    unit: str | None = None,
    **given: Any,
) -> tuple[Recording, int]:
    """The recording in a file of any format, and the exit code that reading it deserves.

    ``given`` are the values of ``import_options``."""
    from ..convert import read

    limits = limits or Limits()
    if suffix_of(name, format_) != HAPF:
        with progress("reading") as advance:
            recording = read(
                input_of(name), format=format_, limits=limits, progress=advance, **asked_of(given)
            )
        return described(recording, labels, unit), 0
    asked = asked_of(given)
    select = asked.pop("select", ())
    if asked:
        option = option_of(next(iter(asked)))
        raise ParameterError(f"{option} {FOREIGN_ONLY}", path=name)
    if labels is not None or unit is not None:
        raise ParameterError(
            "--labels and --unit require .npz, .npy, .csv or .wav input", path=name
        )
    from ..reading.reader import Reader
    from ..spool import Spool

    with Reader(input_of(name), limits=limits) as reader, progress("decoding") as advance:
        names = parse_channels(select, [ref.label for ref in reader.channels])
        numbers = sorted({ref.number for ref in reader.select(names)})
        recording = reader.read(None if names is None else numbers, progress=advance, store=Spool())
        return recording, tell_losses(reader)


@contextmanager
def opened_input(
    name: str,
    format_: str | None,
    limits: Limits,
    *,
    whole: str,
    labels: str | None = None,
    unit: str | None = None,
    **given: Any,
) -> Iterator[tuple[Recording | Import, int]]:
    """As :func:`load_recording`, but an input of large size is not read: its values come block by
    block. ``whole`` names what needs all of it in memory, if anything does."""
    from ..convert import opened
    from ..convert.tables import Import
    from ..spool import Spool
    from ..writing.importing import read_if_small

    if suffix_of(name, format_) == HAPF:
        yield load_recording(name, format_, limits, labels=labels, unit=unit, **given)
        return
    with ExitStack() as bar:
        advance = bar.enter_context(progress("reading"))
        with opened(
            input_of(name),
            format=format_,
            limits=limits,
            progress=advance,
            store=Spool(),
            **asked_of(given),
        ) as (_, found, options):
            kept = read_if_small(found, options, limits, whole)
            bar.close()
            if isinstance(kept, Import):
                yield relabelled(kept, labels, unit), 0
            else:
                yield described(kept, labels, unit), 0


def asked_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """The options that were given, as ``hapfmt.read`` takes them."""
    found = {name: value for name, value in given.items() if value is not None and value != ()}
    if not found.get("keep_stamps", True):
        del found["keep_stamps"]
    return found


def described(recording: Recording, labels: str | None, unit: str | None) -> Recording:
    """The recording with the given labels and units."""
    from ..convert.common import without_units

    if labels is None and unit is None:
        return recording
    count = len(recording)
    names = recording.labels if labels is None else [each.strip() for each in labels.split(",")]
    if len(names) != count:
        raise ParameterError(
            f"--labels names {counted(len(names), 'channel')}, the input has {count}"
        )
    codes = [c.unit for c in recording] if unit is None else units_for(unit, count)
    if unit is not None:
        replaced = [
            f"{channel.unit} of {channel.label!r}"
            for channel, code in zip(recording, codes, strict=True)
            if channel.unit not in ("1", code)
        ]
        more = f" and {len(replaced) - SHOWN_LINES} more" if len(replaced) > SHOWN_LINES else ""
        said = f"--unit replaces {', '.join(replaced[:SHOWN_LINES])}{more}"
        recording = without_units(recording, recording.labels, *([said] if replaced else []))
    channels = tuple(
        replace(channel, label=name, unit=code)
        for channel, name, code in zip(recording, names, codes, strict=True)
    )
    return replace(recording, channels=channels)


def relabelled(found: Import, labels: str | None, unit: str | None) -> Import:
    """The same of a file that is not read yet."""
    if labels is None and unit is None:
        return found
    recording = described(found.described(), labels, unit)
    columns = iter(recording)
    tables = tuple(
        replace(
            table,
            notes=(),
            columns=tuple(
                replace(column, label=each.label, unit=each.unit)
                for column, each in zip(table.columns, columns, strict=False)
            ),
        )
        for table in found.tables
    )
    return replace(found, tables=tables, notes=tuple(notes_of(recording)))


def save_recording(
    recording: Recording,
    name: str,
    format_: str | None,
    force: bool,
    limits: Limits | None = None,
    **given: Any,
) -> None:
    """``given``: options of the format, as ``hapfmt.save`` takes them."""
    from ..convert import save

    target = output_of(name, text=suffix_of(name, format_) == CSV)
    room = limits.memory if limits else None
    with progress("writing") as advance:
        notes = save(
            recording, target, format=format_, force=force, max_memory=room, progress=advance,
            **given,
        )  # fmt: skip
    for each in notes:
        note(each)
    if name == "-":
        target.flush()  # type: ignore[union-attr]


def tell_no_report(target: str, asked: Mapping[str, bool]) -> None:
    """Note the options of a report that is not printed, since standard output has the file."""
    for option in (option for option, given in asked.items() if given and target == "-"):
        note(f"{option} does nothing with an output on standard output; give OUT a name")


def tell_written(target: str, words: str) -> None:
    """Reports on a terminal that the work is done; a pipe or a program gets nothing."""
    if target != "-" and width_of() is not None:
        path = Path(target)
        files = path.rglob("*") if path.is_dir() else [path]
        size = sum(each.stat().st_size for each in files if each.is_file())
        say(f"{target}: {words}, {size} bytes")


def contents(found: Recording | Import) -> str:
    """Summary of a recording: channels and length."""
    from ..recording import Recording

    if isinstance(found, Recording):
        begun = [c.start_tick / c.rate_exact for c in found.channels if c.stored.size]
    else:
        begun = [table.spans[0].start / table.rate for table in found.tables if table.spans]
    stop, start = float(found.duration), float(min(begun, default=0))
    times = f"{start:.6g} to {stop:.6g}" if start else f"{stop:.6g}"
    return f"{counted(len(found.labels), 'channel')}, {times}{JOINED}s"


def tell_losses(reader: Reader, damage: DamageReport | None = None) -> int:
    """What is wrong with a file that was read, on standard error; the exit code (SPEC 13)."""
    name = reader.source.path or "input"
    lines = [f"{name}: {line}" for line in (damage or reader.damage()).lines()]
    if reader.source.path and reader.exit_code == DAMAGED:
        command = f"hapfmt verify -v {shlex.quote(reader.source.path)}{chosen_id(reader.file_id)}"
        lines.append(f"for details, run: {command}")
    tell_some(lines)
    if reader.exit_code == UNSUPPORTED:
        tell_some(["a part of the file is not known to this version; hapfmt info names it"])
    return reader.exit_code


def chosen_id(file_id: int | None) -> str:
    """The option that chooses the same file among several again."""
    return "" if file_id is None else f" --file-id {id_text(file_id)}"


def tell_some(lines: Sequence[str]) -> None:
    """The first lines on standard error, and how many there are: --json has them all."""
    for line in lines[:SHOWN_LINES]:
        complain(line)
    if len(lines) > SHOWN_LINES:
        complain(f"... and {len(lines) - SHOWN_LINES} more (--json shows all)")


def notes_of(recording: Recording) -> list[str]:
    notes = recording.metadata.get("notes", [])
    return [each for each in notes if isinstance(each, str)] if isinstance(notes, list) else []


def tell_notes(recording: Recording, is_hapf: bool) -> list[str]:
    """Tell the notes on changes while reading the input, and on its gaps; returns the first. The
    notes in a .hapf file are those of an earlier conversion: hapfmt info shows them."""
    notes = [] if is_hapf else notes_of(recording)
    for each in notes:
        note(each)
    units = [channel.unit for channel in recording]
    gaps = [[gap.ticks for gap in channel.gaps] for channel in recording]
    tell_gaps(recording.labels, units, gaps)
    return notes


def tell_import(found: Import) -> None:
    """The same of a file whose values are not read yet; NaN among them are not counted."""
    for each in found.all_notes:
        note(each)
    gaps = [
        [after.start - before.stop for before, after in pairwise(table.spans)]
        for table in found.tables
        for _ in table.columns
    ]
    units = [column.unit for table in found.tables for column in table.columns]
    tell_gaps(found.labels, units, gaps)


STAMPS = re.compile(r"(.* )?stamps?( \(\d+\))?")
"""Labels of channels of kept stamps. They have the gaps of their table."""


def tell_gaps(labels: Sequence[str], units: Sequence[str], found: Sequence[Sequence[int]]) -> None:
    """A note on the gaps of each channel, given as their ticks."""
    kept = [
        place
        for place, label in enumerate(labels)
        if units[place] != "ns" or not STAMPS.fullmatch(label)
    ]
    labels, found = [labels[place] for place in kept], [found[place] for place in kept]
    missing = [sum(gaps) for gaps in found]
    if not any(missing):
        return
    alike = [gaps for gaps in found if gaps]
    most = max(missing)
    if len(alike) > 1 and all(gaps == alike[0] for gaps in alike):
        stay = "it stays a gap" if len(alike[0]) == 1 else "they stay gaps"
        each = f"in each of {len(alike)} channels"
        many = counted(most, "missing sample")
        note(f"{counted(len(alike[0]), 'gap')} with {many} {each}: {stay}")
        return
    gaps = sum(map(len, found))
    where = ""
    if len(missing) > 1:
        name = labels[missing.index(most)] or f"channel {missing.index(most)}"
        where = f", all in {name}" if most == sum(missing) else f", most in {name} ({most})"
    stay = "it stays a gap" if gaps == 1 else "they stay gaps"
    note(f"{counted(gaps, 'gap')} with {counted(sum(missing), 'missing sample')}{where}: {stay}")


canonical_option = click.option(
    "--canonical",
    type=FileIdType(),
    metavar="FILE_ID",
    help="The same input gives the same bytes; FILE_ID replaces the random file id.",
)
exact_option = click.option(
    "--exact",
    is_flag=True,
    help="Cut at the sample: code the packets at the ends again, without loss. Those of textures "
    "and lines stay whole.",
)
to_zero_option = click.option(
    "--to-zero",
    is_flag=True,
    help="Move the first packet to tick 0, or as near as whole ticks of every track allow. The "
    "epoch moves too.",
)
by_epoch_option = click.option(
    "--by-epoch", is_flag=True, help="Place each file by its epoch, to the nearest tick."
)
same_times_option = click.option(
    "--same-times", is_flag=True, help="Tick 0 of all files is the same moment."
)
copy_option = output_option("OUT", "Leave FILE as it is and write a copy with the addition.")


@contextmanager
def originals(names: Sequence[str], limits: Limits) -> Iterator[list[Original]]:
    """The files that are edited, open within the limits."""
    from ..edit import Original

    with ExitStack() as stack:
        yield [stack.enter_context(Original(input_of(name), limits=limits)) for name in names]


def tell(edited: Edited, target: str, as_json: bool) -> None:
    """Reports what an edit wrote and omitted. Prints no report on standard output if the file goes
    there."""
    if target == "-":
        for each in edited.notes:
            note(each)
    elif as_json:
        echo_json(edited.as_json())
    else:
        show(edited)


def show(edited: Edited) -> None:
    say(f"{edited.file or '-'}: {line(edited)}")
    for each in edited.notes:
        note(each)


def line(edited: Edited) -> str:
    span = "no samples"
    if edited.start is not None and edited.stop is not None:
        span = f"{float(edited.start):.6g} s to {float(edited.stop):.6g} s"
    if edited.asked and edited.rounded:
        start, stop = ("" if end is None else f"{float(end):.6g} s" for end in edited.asked)
        span += f" (asked for {start or 'the start'} to {stop or 'the end'})"
    return (
        f"{edited.file_size} bytes, {counted(len(edited.channels), 'channel')}, {span}, "
        f"{counted(edited.packet_count, 'packet')}"
    )


def offsets_of(pairs: tuple[str, ...], files: tuple[str, ...]) -> dict[int, Any]:
    """Offsets in seconds by the place of their file, from texts FILE=SECONDS."""
    found: dict[int, Any] = {}
    for pair in pairs:
        name, equals, text = pair.rpartition("=")
        if not equals or files.count(name) != 1:
            raise ParameterError(
                f"Expected --offset IN=SECONDS with one of the input files, got {pair!r}"
            )
        found[files.index(name)] = exact(text)
    return found


def tell_added(file: str, what: str, notes: Sequence[str], as_json: bool) -> None:
    """Reports an addition to a file. Prints no report on standard output if the file goes
    there."""
    for each in notes:
        note(each)
    if file == "-":
        return
    if as_json:
        echo_json({"file": file, "notes": list(notes)})
    else:
        say(f"{file}: {what}")


def open_parts(
    name: str,
    format_: str | None,
    limits: Limits,
    channels: Sequence[str] = (),
    *,
    numbers: Sequence[int] | None = None,
    whole: bool = True,
    **given: Any,
) -> Parts:
    """``channels``: labels or numbers as a person gives them; ``numbers``: these;
    ``whole``: all of its time is wanted, so a hapf file is checked from end to end;
    ``given``: the options of this input, see :func:`options_by_input`."""
    from ..lab.parts import FileParts, RecordingParts
    from ..reading.reader import Reader

    suffix = suffix_of(name, None if name.lower().endswith(HAPF) else format_)
    if suffix == HAPF:
        reader = Reader(input_of(name), limits=limits)
        try:
            labels = [ref.label for ref in reader.channels]
            return FileParts(reader, numbers or parse_channels(channels, labels), whole=whole)
        except BaseException:
            reader.close()
            raise
    recording, _ = load_recording(name, format_, limits, **given)
    labels = [channel.label for channel in recording.channels]
    names: Sequence[str | int] | None = numbers or parse_channels(channels, labels)
    places = None if names is None else channels_called(names, dict(enumerate(labels)))
    return RecordingParts(recording, places)


def matched(parts: Parts, name: str, format_: str | None, limits: Limits, **given: Any) -> Parts:
    """The channels of the file ``name`` that belong to those of ``parts``: of the same places, as
    in ``verify`` (SPEC DBC-002)."""
    numbers = [channel.number for channel in parts.channels]
    try:
        return open_parts(name, format_, limits, numbers=numbers, **given)
    except ParameterError as error:
        if not error.message.startswith("no channel"):
            raise
        raise ParameterError(
            f"The original lacks a channel of the file: {error.message}", path=name
        ) from None
