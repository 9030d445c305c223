"""hapfmt archive: encode, check, recover, convert, catalogue and deposit many files at a time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ParameterError
from ..files import atomic_write
from ..numbers import counted
from .common import (
    HAPF,
    asked_of,
    echo_json,
    force_option,
    import_options,
    input_format_option,
    json_option,
    memory_option,
    output_option,
    progress,
    refuse_idle,
    suffix_of,
)
from .encode import preset_options
from .screen import JOINED, Column, Verb, in_options, note, raw, say, table, width_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..archive.jobs import FileOutcome, Job
    from ..archive.places import Place
    from ..archive.runs import Log, RunSummary
    from ..limits import Limits

SOURCES = "SOURCE..."
TEXT_COLUMNS = ("file", "label", "unit", "quantity", "verdict")

jobs_option = click.option(
    "--jobs",
    type=click.IntRange(1),
    metavar="N",
    help="Work in N processes of this machine. [in this process]",
)
dask_option = click.option(
    "--dask",
    metavar="ADDRESS",
    help="Work on the Dask cluster with this scheduler, such as tcp://10.0.0.1:8786. Its workers "
    "need hapfmt, and see the files under the same names.",
)
log_option = click.option(
    "--log",
    metavar="FILE",
    help="File that remembers what is done, so that an interrupted run can go on.",
)


@click.group()
def archive() -> None:
    """Work on many files: folders, patterns such as 'data/**/*.csv', and URLs.

    One bad file never stops the others. The exit code is the worst of all files: 1, then 3
    (data are lost), then 2 and 4. An interrupted command goes on where it stopped when it is
    given again.

    \b
    hapfmt archive encode recordings/ archive/ --jobs 4
    hapfmt archive catalogue archive/
    hapfmt archive find archive/ --where "quantity = 'force' and rms > 2"
    hapfmt archive bag archive/
    hapfmt archive verify archive/
    """


@dataclass(frozen=True)
class RunChoices:
    """How a command works on its files."""

    jobs: int | None
    dask: str | None
    log: str | None
    limits: Limits
    as_json: bool

    def __post_init__(self) -> None:
        if self.jobs and self.dask is not None:
            raise ParameterError("Give --jobs or --dask, not both")
        if self.dask is not None:
            from ..archive.runs import check_address

            check_address(self.dask)


def run_options(command: Any) -> Any:
    """Options that the command gets as one RunChoices, ``how``."""

    @wraps(command)
    def chosen(
        *args: Any,
        jobs: int | None,
        dask: str | None,
        log: str | None,
        max_memory: Limits,
        as_json: bool,
        **given: Any,
    ) -> Any:
        return command(*args, how=RunChoices(jobs, dask, log, max_memory, as_json), **given)

    for option in (json_option, memory_option, log_option, dask_option, jobs_option):
        chosen = option(chosen)
    return chosen


@archive.command("encode", cls=Verb, short_help="Encode all recordings into a folder.")
@click.argument("sources", metavar=SOURCES, nargs=-1, required=True)
@click.argument("target", metavar="TARGET")
@preset_options
@import_options
@input_format_option
@run_options
@force_option
def encode_all(
    sources: tuple[str, ...],
    target: str,
    preset: str,
    input_format: str | None,
    how: RunChoices,
    force: bool,
    **given: Any,
) -> int:
    """Encode every recording of SOURCE into the folder TARGET, under the same names with .hapf.

    SOURCE is a file, a folder, a pattern or a URL. TARGET is a folder or a URL such as
    s3://bucket/archive. A recording that is done and unchanged is skipped.

    \b
    hapfmt archive encode recordings/ archive/
    hapfmt archive encode 'day?/**/*.mcap' archive/ --jobs 4
    """
    from ..archive.jobs import Job
    from ..archive.places import find_places, is_foreign
    from ..encoder.settings import Settings, renamed

    reading = {name: given.pop(name) for name in READING}
    given["felt"] = given["felt"] or None
    preset, given = renamed(preset, given)
    Settings.of(preset, **given)
    options = {
        "preset": preset,
        "given": given,
        "format": input_format,
        "reading": asked_of(reading),
    }
    left_out: list[Place] = []
    with progress("looking for files"):
        places = find_places(sources, (lambda _: True) if input_format else is_foreign, left_out)
    return write_all(
        lambda place, output, staging: Job(
            "encode", place, output, staging, options, how.limits, force
        ),
        places, left_out, sources, target, HAPF, "encoding", how,
    )  # fmt: skip


READING = ("rate", "transpose", "select", "clock", "episode", "map", "keep_stamps")


@archive.command("convert", cls=Verb, short_help="Convert all recordings into a folder.")
@click.argument("sources", metavar=SOURCES, nargs=-1, required=True)
@click.argument("target", metavar="TARGET")
@click.option(
    "--output-format",
    metavar="FORMAT",
    required=True,
    help="Format of the outputs: hapf, npz, csv, mcap ... ('hapfmt info --formats' lists all).",
)
@import_options
@input_format_option
@run_options
@force_option
def convert_all(
    sources: tuple[str, ...],
    target: str,
    output_format: str,
    input_format: str | None,
    how: RunChoices,
    force: bool,
    **given: Any,
) -> int:
    """Convert every recording of SOURCE to one format, in the folder TARGET.

    SOURCE and TARGET are as for archive encode. A .hapf output is lossless.

    \b
    hapfmt archive convert archive/ tables/ --output-format parquet
    """
    from ..archive.jobs import Job
    from ..archive.places import find_places, is_any
    from ..convert.formats import named

    if output_format.lower().removeprefix(".") == "hapf":
        suffix = HAPF
    else:
        chosen = named(output_format)
        if not chosen.writes:
            raise ParameterError(f"hapfmt does not write {chosen.title} files")
        suffix = "" if chosen.folder else chosen.suffixes[0]
    options = {
        "suffix": suffix,
        "output": output_format,
        "format": input_format,
        "reading": asked_of(given),
    }
    left_out: list[Place] = []
    with progress("looking for files"):
        places = find_places(
            sources,
            lambda found: bool(input_format) or (is_any(found) and (not suffix or found != suffix)),
            left_out,
        )
    return write_all(
        lambda place, output, staging: Job(
            "convert", place, output, staging, options, how.limits, force
        ),
        places, left_out, sources, target, suffix, "converting", how,
    )  # fmt: skip


@archive.command("recover", cls=Verb, short_help="Save what damaged files still contain.")
@click.argument("sources", metavar=SOURCES, nargs=-1, required=True)
@click.argument("target", metavar="TARGET")
@run_options
@force_option
def recover_all(
    sources: tuple[str, ...],
    target: str,
    how: RunChoices,
    force: bool,
) -> int:
    """Check every .hapf file, and write what damaged ones still contain into the folder TARGET.

    Intact files are not copied. The exit code is 0 if nothing was lost.

    \b
    hapfmt archive recover archive/ recovered/
    """
    from ..archive.jobs import Job
    from ..archive.places import find_places, is_hapf

    with progress("looking for files"):
        places = find_places(sources, is_hapf)
    return write_all(
        lambda place, output, staging: Job(
            "recover", place, output, staging, {}, how.limits, force
        ),
        places, [], sources, target, HAPF, "recovering", how,
    )  # fmt: skip


def write_all(
    job_of: Any,
    places: Sequence[Place],
    left_out: Sequence[Place],
    sources: Sequence[str],
    target: str,
    suffix: str,
    title: str,
    how: RunChoices,
) -> int:
    """Runs the jobs that write a file each."""
    from dataclasses import replace

    from ..archive.bags import refuse_bag
    from ..archive.places import local_path, outside, with_sources
    from ..archive.runs import (
        FOLDER,
        LOG,
        STAGING,
        WRITTEN,
        emptied,
        run,
        skip_written,
        targets_of,
    )
    from ..format.source import is_url

    target = local_path(target)
    if is_url(target):
        if target.lower().startswith("http"):
            raise ParameterError("a web server takes no files; give a folder or an s3:// URL")
        if how.log is None:
            raise ParameterError(
                "a remote target needs --log FILE, a local file that remembers what is done"
            )
        staging, own = "", None
    else:
        if Path(target).exists() and not Path(target).is_dir():
            raise ParameterError(f"{target} is a file; TARGET is a folder")
        refuse_bag(target, "give a TARGET outside of it")
        places = outside(places, sources, Path(target))
        left_out = outside(left_out, sources, Path(target))
        Path(target).mkdir(parents=True, exist_ok=True)
        target = str(Path(target).resolve())
        staging, own = str(Path(target) / FOLDER / STAGING), Path(target) / FOLDER / LOG
    places = nothing_found(places)
    targets, _ = targets_of(places, target, suffix)
    named = with_sources(places, sources)
    shared: dict[str, list[Place]] = {}
    for place, output in zip(named, targets, strict=True):
        shared.setdefault(output, []).append(place)
    work = []
    for place, output in zip(named, targets, strict=True):
        others = ", ".join(other.name for other in shared[output] if other != place)
        text = f"{others} would have the same target: {output}" if others else place.error
        work.append(job_of(replace(place, error=text), output, staging))
    outputs = set(targets)
    names = [each.name for each in left_out if each.location not in outputs]
    tell_left_out(names)
    began = time.perf_counter()
    with (
        opened_log(Path(how.log) if how.log else own, WRITTEN) as found,
        emptied(Path(staging) if staging else None),
        progress(title) as advance,
        counting(advance, "the same command goes on") as count,
    ):
        outcomes = run(
            work, workers=how.jobs, address=how.dask, log=found, skip=skip_written,
            progress=count, tell=note,
        )  # fmt: skip
    return report(outcomes, time.perf_counter() - began, how.as_json, left_out=names)


def tell_left_out(names: Sequence[str]) -> None:
    """Name the files that the command does not work on: .hapf files, and all others."""
    from ..archive.places import is_hapf
    from ..archive.places import suffix_of as suffix_of_name

    encoded = [name for name in names if is_hapf(suffix_of_name(name))]
    others = [name for name in names if not is_hapf(suffix_of_name(name))]
    for found, what, remedy in (
        (
            encoded,
            counted(len(encoded), ".hapf file"),
            ". To convert them, use hapfmt archive convert",
        ),
        (others, f"{counted(len(others), 'file')} of other formats", ""),
    ):
        if found:
            more = len(found) - MOST_NOTES
            rest = f" and {more} more (--json lists all)" if more > 0 else ""
            listed = ", ".join(found[:MOST_NOTES])
            note(f"left out: {what}: {listed}{rest}{remedy}")


@contextmanager
def counting(advance: Any, further: str) -> Iterator[Any]:
    """Passes progress on. An interruption is an error that says how far the work is."""
    state = [0, 0]

    def count(done: int, total: int) -> None:
        state[:] = done, total
        advance(done, total)

    try:
        yield count
    except KeyboardInterrupt:
        done, total = state
        how_far = f": {done} of {counted(total, 'file')} done" if total else ""
        raise ParameterError(f"interrupted{how_far}; {further}") from None


@contextmanager
def opened_log(path: Path | None, kind: str) -> Iterator[Log | None]:
    from ..archive.runs import Log

    if path is None:
        yield None
        return
    with Log(path, kind) as log:
        yield log


def nothing_found(places: Sequence[Place]) -> Sequence[Place]:
    if not places:
        note("no file was found that this command works on")
    return places


def report(
    outcomes: Sequence[FileOutcome],
    seconds: float,
    as_json: bool,
    *,
    quiet: bool = False,
    left_out: list[str] | None = None,
) -> int:
    from ..archive.runs import RunSummary

    for each in outcomes:
        each.message = in_options(each.message)
        each.notes = [in_options(text) for text in each.notes]
    summary = RunSummary(list(outcomes), seconds, left_out)
    if as_json:
        echo_json(summary.as_json())
        return summary.exit_code
    show(summary, quiet=quiet and width_of() is None and not summary.notes())
    return summary.exit_code


def show(summary: RunSummary, *, quiet: bool) -> None:
    """Problems, then the numbers of files; ``quiet``: only if there are problems."""
    problems = summary.problems
    if problems:
        table(
            [Column("file"), Column("code", 1), Column("result", 2), Column("problem")],
            [[each.name, str(each.exit_code), each.result, each.message] for each in problems],
        )
        say()
    elif quiet or not summary.outcomes:
        return
    rows = []
    for result, found in sorted(summary.counts().items()):
        written = sum(each.written_size for each in found)
        rows.append(
            [
                result,
                str(len(found)),
                megabytes(sum(each.read_size for each in found)),
                megabytes(written) if written else "-",
            ]
        )
    table(["result", "files", "read", "written"], rows)
    if summary.seconds >= 1:
        say(f"{counted(len(summary.outcomes), 'file')} in {summary.seconds:.1f}{JOINED}s")
    show_notes(summary)


def show_notes(summary: RunSummary) -> None:
    """One line for each kind of note, with one example."""
    kinds = sorted(summary.notes(), key=len, reverse=True)
    for found in kinds[:MOST_NOTES]:
        name, text = found[0]
        many = f"{counted(len(found), 'file')}, such as {name}" if len(found) > 1 else name
        note(f"{many}: {text}")
    if len(kinds) > MOST_NOTES:
        note(f"{counted(len(kinds) - MOST_NOTES, 'more kind')} of notes")
    if kinds:
        note("--json lists the notes by file")


MOST_NOTES = 10


def megabytes(size: int) -> str:
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= scale:
            return f"{size / scale:.3g}{JOINED}{unit}"
    return f"{size}{JOINED}B"


@archive.command("verify", cls=Verb, short_help="Check all files, and the bag around them.")
@click.argument("sources", metavar=SOURCES, nargs=-1, required=True)
@run_options
def verify_all(
    sources: tuple[str, ...],
    how: RunChoices,
) -> int:
    """Check every .hapf file against every rule of the format. Report rot, missing and unknown
    files.

    If SOURCE is a BagIt bag, all of its files are compared with its checksums too. Without a
    terminal, as in cron, nothing is printed while all is good.

    \b
    hapfmt archive verify archive/
    hapfmt archive verify archive/ --jobs 4 --json > report.json
    """
    from ..archive.bags import bag_around, bag_work, bags_of, not_bagged
    from ..archive.jobs import FileOutcome, Job
    from ..archive.places import find_places, is_hapf, local_path, with_sources
    from ..archive.runs import VERIFIED, run
    from ..format.source import is_url

    sources = tuple(map(local_path, sources))
    work: list[Job] = []
    outcomes: list[FileOutcome] = []
    with progress("looking for files"):
        for source in sources:
            bags = bags_of(source)
            for bag in bags:
                prefix = "" if len(sources) == 1 and bag == source else f"{bag}/"
                found, problems = bag_work(bag, how.limits, prefix)
                work += found
                outcomes += problems
            places = not_bagged(find_places([source], is_hapf), bags)
            if not places and not bags:
                outcomes.append(
                    FileOutcome(source, "failed", 1, "no .hapf file and no bag was found here")
                )
            if not is_url(source) and (bag_of := bag_around(Path(source))):
                note(
                    f"{source} lies within a bag; to check the bag, run: "
                    f"hapfmt archive verify {bag_of}"
                )
            work += [
                Job("verify", place, limits=how.limits) for place in with_sources(places, sources)
            ]
    work = list({job.place.location: job for job in reversed(work)}.values())[::-1]
    began = time.perf_counter()
    further = "the same command goes on" if how.log else "with --log FILE a check can go on"
    with (
        opened_log(Path(how.log) if how.log else None, VERIFIED) as known,
        progress("verifying") as advance,
        counting(advance, further) as count,
    ):
        outcomes += run(
            work,
            workers=how.jobs,
            address=how.dask,
            log=known,
            skip=checked_before,
            progress=count,
            tell=note,
        )
        if known:
            known.remove()  # a complete check is not continued by the next one
    return report(outcomes, time.perf_counter() - began, how.as_json, quiet=True)


def checked_before(job: Job, done: dict[str, Any]) -> FileOutcome:
    """What an interrupted run found out about a file that is unchanged since."""
    from ..archive.jobs import FileOutcome

    return FileOutcome(
        job.place.name, done["result"], done["exit_code"], done["message"] or "",
        read_size=job.place.size, rows=done.get("rows", []),
    )  # fmt: skip


@archive.command("catalogue", cls=Verb, short_help="Make a table of all channels.")
@click.argument("sources", metavar=SOURCES, nargs=-1, required=True)
@output_option("OUT.parquet", "Parquet file to write. [catalogue.parquet in the folder SOURCE]")
@run_options
@force_option
def catalogue_all(
    sources: tuple[str, ...],
    output: str | None,
    how: RunChoices,
    force: bool,
) -> int:
    """Write a table with one row for each channel of each .hapf file: label, unit, rate, times,
    range, rms, checksum, verdict.

    DuckDB, Polars and pandas read the table. If OUT is a catalogue already, only files that are
    new or changed are read. --force reads all.

    \b
    hapfmt archive catalogue archive/
    hapfmt archive catalogue s3://bucket/archive -o archive.parquet --jobs 4
    """
    from ..archive.bags import refuse_bag
    from ..archive.catalogue import NAME, known_rows, polars, to_parquet
    from ..archive.places import local_path

    polars()
    folders = [each for each in map(local_path, sources) if Path(each).is_dir()]
    if output is None:
        if len(sources) != 1 or not folders:
            raise ParameterError("Give -o OUT.parquet, or one folder as SOURCE")
        output = str(Path(folders[0]) / NAME)
    if suffix_of(output, None) != ".parquet":
        raise ParameterError(f"a catalogue is a .parquet file, not {output}")
    out = Path(local_path(output))
    if not out.parent.is_dir():
        raise ParameterError(f"{out}: the directory {out.parent} does not exist", path="")
    refuse_bag(str(out.parent), "give -o OUT.parquet outside of it")
    began = time.perf_counter()
    known = known_rows(out)
    outcomes = catalogued_outcomes(sources, out, how, {} if force else known)
    rows = sum(len(each.rows) for each in outcomes)
    if not rows and outcomes:
        note(f"nothing was read, so {out} is not written")
        return report(outcomes, time.perf_counter() - began, how.as_json)
    gone = sorted({*known} - {row["file"] for each in outcomes for row in each.rows})
    if gone:
        removed = counted(sum(len(known[name]) for name in gone), "row")
        files = counted(len(gone), "file")
        note(f"{removed} of {files} removed from {out}: not found any more, such as {gone[0]}")
    data = to_parquet(row for each in outcomes for row in each.rows)
    with atomic_write(out, force=True) as stream:
        stream.write(data)
    code = report(outcomes, time.perf_counter() - began, how.as_json)
    if not how.as_json:
        say(f"{out}: {counted(rows, 'row')}, {megabytes(len(data))}")
    return code


def catalogued_outcomes(
    sources: Sequence[str],
    out: Path,
    how: RunChoices,
    known: dict[str, list[dict[str, Any]]],
) -> list[FileOutcome]:
    """The rows of all files; ``known``: those of an earlier catalogue, for unchanged files."""
    from ..archive.catalogue import catalogue_jobs, catalogued
    from ..archive.places import find_places, is_hapf, with_sources
    from ..archive.runs import CATALOGUED, FOLDER, run

    with progress("looking for files"):
        places = with_sources(nothing_found(find_places(sources, is_hapf)), sources)
    work = catalogue_jobs(places, out, how.limits)
    old = catalogued(work, known)
    fresh = [job for place, job in enumerate(work) if place not in old]
    path = Path(how.log) if how.log else out.parent / FOLDER / f"{out.name}.jsonl"
    with (
        opened_log(path, CATALOGUED) as unfinished,
        progress("reading") as advance,
        counting(advance, "the same command goes on") as count,
    ):
        found = iter(
            run(
                fresh, workers=how.jobs, address=how.dask, log=unfinished, skip=checked_before,
                progress=count, tell=note,
            )
        )  # fmt: skip
        outcomes = [old[place] if place in old else next(found) for place in range(len(work))]
        if unfinished:
            unfinished.remove()
    return outcomes


@archive.command("bag", cls=Verb, short_help="Make a folder a BagIt bag with RO-Crate metadata.")
@click.argument("folder", metavar="FOLDER")
@click.option("--title", metavar="TEXT", default="", help="Name of the deposit. [the folder's]")
@click.option("--description", metavar="TEXT", default="", help="What it holds.")
@click.option("--license", "license_", metavar="URL", default="", help="Its licence.")
@click.option("--author", "authors", metavar="NAME", multiple=True, help="May be repeated.")
@click.option(
    "--info",
    metavar="KEY=VALUE",
    multiple=True,
    help="A line of bag-info.txt, such as Source-Organization=Lab. May be repeated.",
)
@run_options
@click.option(
    "-f",
    "--force",
    is_flag=True,
    help="Also bag files that are not intact, or a folder without .hapf files.",
)
def bag_folder(
    folder: str,
    title: str,
    description: str,
    license_: str,
    authors: tuple[str, ...],
    info: tuple[str, ...],
    how: RunChoices,
    force: bool,
) -> int:
    """Make FOLDER a BagIt bag (RFC 8493). Its files move to FOLDER/data and get checksums.

    The bag holds a catalogue (catalogue.parquet) and an RO-Crate (ro-crate-metadata.json) made from
    it. A folder with a damaged file is refused.

    \b
    hapfmt archive bag archive/ --title "Grasps, 2026" --author "A. Author"
    hapfmt archive verify archive/
    """
    from ..archive.bags import (
        CRATE,
        DepositFacts,
        bag_around,
        bagit,
        crate_of,
        hidden_files,
        is_bag,
        is_ours,
        unbaggable,
        unpack_unfinished,
        write_bag,
    )
    from ..archive.catalogue import NAME, known_rows, polars, to_parquet
    from ..archive.places import local_path
    from ..archive.runs import FOLDER, LOG, emptied

    pairs = []
    for each in info:
        name, equals, value = each.partition("=")
        if not equals:
            raise ParameterError(f"Expected --info KEY=VALUE, got {each!r}")
        pairs.append((name, value))
    about = DepositFacts(title, description, license_, authors, tuple(pairs))
    polars()
    bagit()
    root = Path(local_path(folder))
    if not root.is_dir():
        raise ParameterError(f"{folder} is not a folder; a bag is made of a local folder")
    root = root.resolve()
    unpack_unfinished(root)
    if is_bag(str(root)):
        raise ParameterError(
            f"{folder} is a bag already; to check it, run: hapfmt archive verify {folder}"
        )
    if outer := bag_around(root):
        raise ParameterError(f"{folder} lies within the bag {outer}, whose files must stay")
    began = time.perf_counter()
    if problems := unbaggable(root):
        return report(problems, time.perf_counter() - began, how.as_json)
    if (root / CRATE).exists() and not is_ours(root / CRATE):
        raise ParameterError(f"{root / CRATE} exists already, and hapfmt did not write it")
    outcomes = catalogued_outcomes([str(root)], root / NAME, how, known_rows(root / NAME))
    if not outcomes and not force:
        raise ParameterError(f"{folder} holds no .hapf file; to bag it anyway, give --force")
    if not force and any(each.exit_code for each in outcomes):
        code = report(outcomes, time.perf_counter() - began, how.as_json)
        note("nothing was bagged: recover or remove these files, or give --force")
        return code
    rows = [row for each in outcomes for row in each.rows]
    tell_unfinished(root / FOLDER / LOG)
    if hidden := hidden_files(root):
        note(f"the bag gets {counted(len(hidden), 'hidden file')}, such as {hidden[0]}")
    with emptied(root / FOLDER):
        pass
    for name, data in ((NAME, to_parquet(rows)), (CRATE, crate_of(root, rows, about, NAME))):
        with atomic_write(root / name, force=True) as stream:
            stream.write(data)
    with progress("computing checksums"):
        made = write_bag(root, about, how.jobs or 1)
    if how.as_json:
        echo_json({"bag": str(root), "file_count": len(outcomes), "exit_code": 0, **made})
    else:
        say(
            f"{folder}: a bag of {counted(made['payload_count'], 'file')}, "
            f"{megabytes(made['payload_size'])}"
        )
    return 0


def tell_unfinished(path: Path) -> None:
    """Recordings that an earlier command began to write into the folder, and did not."""
    from ..archive.runs import Log

    if not path.is_file():
        return
    with Log(path) as log:
        lacking = [
            name for name in log.begun if name not in log.done and not (log.folder / name).exists()
        ]
    if lacking:
        note(
            f"{counted(len(lacking), 'output')} of an earlier command into this folder "
            f"{'is' if len(lacking) == 1 else 'are'} not there, such as {lacking[0]}"
        )


@archive.command("find", cls=Verb, short_help="List channels of a catalogue.")
@click.argument("catalogue", metavar="CATALOGUE")
@click.option(
    "--where",
    metavar="SQL",
    help="An SQL expression over the columns: \"quantity = 'force' and rms > 2\". [all rows]",
)
@click.option("--files", is_flag=True, help="Print the names of the files alone, one a line.")
@click.option(
    "-0", "--null", is_flag=True, help="With --files: end each name with a null byte, for xargs -0."
)
@json_option
def find_rows(catalogue: str, where: str | None, files: bool, null: bool, as_json: bool) -> int:
    """List the channels of CATALOGUE, a Parquet file or the folder that holds it.

    The columns are: file, channel, label, unit, quantity, axis, group, device, body_site, rate,
    start, duration, samples, missing, min, max, rms, recorded, uuid, encoder, file_size,
    modified, checksum, verdict, error.

    \b
    hapfmt archive find archive/ --where "quantity = 'force' and rms > 2"
    hapfmt archive find archive/ --where "verdict <> 'intact'" --files
    """
    from ..archive.catalogue import as_json as row_json
    from ..archive.catalogue import find, read

    if null and not files:
        raise ParameterError("--null goes with --files")
    if files:
        refuse_idle("does not go with --files", json=as_json)
    found = find(read(catalogue), where)
    rows = found.to_dicts()
    if as_json:
        echo_json({"rows": [row_json(row) for row in rows], "exit_code": 0})
    elif files:
        for name in dict.fromkeys(row["file"] for row in rows):
            raw(f"{name}\0") if null else say(name, whole=True)
    else:
        show_rows(rows)
    return 0


def show_rows(rows: Sequence[dict[str, Any]]) -> None:
    headers = [
        Column("label"), Column("file"), Column("unit", 1), Column("quantity", 5), Column("Hz", 4),
        Column("seconds", 3), Column("min", 7), Column("max", 6), Column("rms", 2),
        Column("verdict"),
    ]  # fmt: skip
    cells = [
        [
            row["label"] or ("-" if row["channel"] is None else f"channel {row['channel']}"),
            row["file"],
            row["unit"] or "-",
            row["quantity"] or "-",
            *(number(row[name]) for name in ("rate", "duration", "min", "max", "rms")),
            row["verdict"],
        ]
        for row in rows
    ]
    if cells:
        table(headers, cells)
    count = len({row["file"] for row in rows})
    without = len({row["file"] for row in rows if row["channel"] is None})
    more = f", {without} of them without a readable channel" if without else ""
    channels = sum(row["channel"] is not None for row in rows)
    say(f"{counted(channels, 'channel')} in {counted(count, 'file')}{more}")


def number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
