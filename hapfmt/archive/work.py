"""The work on one file. Every error becomes an outcome, so that no file stops the others."""

from __future__ import annotations

import errno
import os
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

from ..errors import INTACT, DataWarning, HapfmtError
from ..format.source import is_url, shown
from ..recording import Recording
from .jobs import ERROR, FileOutcome, Job, content, few_of, hashed, published
from .places import LINK, reason
from .rows import describe


def run_job(job: Job) -> FileOutcome:
    """The outcome of a job. Only an interruption is raised."""
    began = time.perf_counter()
    shown_target = shown(job.target) if is_url(job.target) else job.target
    outcome = FileOutcome(job.place.name, "failed", ERROR, read_size=job.place.size)
    outcome.target = shown_target
    try:
        if job.place.error == LINK:
            outcome.result, outcome.exit_code, outcome.target = "not followed", INTACT, ""
            outcome.notes.append(LINK)
            return outcome
        if job.place.real and os.path.realpath(job.place.location) != job.place.real:
            raise OSError(errno.ESTALE, "a link has taken the place of this file")
        if job.place.error:
            raise OSError(errno.EIO, job.place.error)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            if job.begun and os.path.lexists(job.target):
                finished(job, outcome)
            else:
                WORK[job.verb](job, outcome)
        outcome.notes += [str(each.message) for each in caught if our_warning(each.category)]
    except HapfmtError as error:
        error.path = None
        outcome.exit_code, outcome.message = error.exit_code, error.line()
    except OSError as error:
        outcome.message = reason(error)
    except MemoryError:
        outcome.message = "out of memory"
    except Exception as error:  # a fault of ours or of a library must not stop the others
        outcome.message = f"internal error: {type(error).__name__}: {error}"
    if outcome.exit_code:
        outcome.message = outcome.message or "unknown"
    outcome.seconds = time.perf_counter() - began
    return outcome


def finished(job: Job, outcome: FileOutcome) -> None:
    """A worker completed the output, and died before it could tell."""
    outcome.result = {"encode": "encoded", "convert": "converted", "recover": "recovered"}[job.verb]
    outcome.exit_code = INTACT
    outcome.written_size = Path(job.target).stat().st_size
    outcome.notes.append("finished by a process that ended before it reported")


def our_warning(category: type[Warning]) -> bool:

    return issubclass(category, DataWarning)


def verify(job: Job, outcome: FileOutcome) -> None:
    """Integrity of the file itself, and of its checksums in a bag's manifests."""
    from ..reading.verifier import verify as verify_file
    from .places import is_hapf, suffix_of

    file = content(job.place)
    expected: Mapping[str, str] = job.options.get("expected", {})
    found = hashed(file, tuple(expected)) if expected else {}
    wrong = [name for name, value in expected.items() if found[name] != value.lower()]
    outcome.result, outcome.exit_code = "intact", INTACT
    parts = []
    if is_hapf(suffix_of(job.place.name)) or not expected:
        report = verify_file(file, limits=job.limits, threads=job.options.get("threads"))
        outcome.result, outcome.exit_code = report.verdict, report.exit_code
        if report.exit_code:
            if report.error is not None:
                parts.append(report.error.line())
            parts += few_of(report.summary)
            parts = parts or [report.judgement()]
    if wrong:
        outcome.result, outcome.exit_code = "damaged", outcome.exit_code or 3
        parts.insert(0, f"not the file that was bagged: the {wrong[0]} checksum differs")
    outcome.message = "; ".join(parts)


def encode(job: Job, outcome: FileOutcome) -> None:
    from ..convert import opened
    from ..convert.tables import Import
    from ..encoder.settings import Settings
    from ..writing.importing import read_if_small, why_whole, write_import
    from ..writing.writer import write

    given = dict(job.options["given"])
    settings = Settings.of(job.options["preset"], **given)
    threads = job.options.get("threads")
    with (
        opened(
            job.place.location, format=job.options.get("format"), limits=job.limits,
            **job.options["reading"],
        ) as (_, found, options),
        published(job, ".hapf") as staged,
    ):  # fmt: skip
        kept = read_if_small(found, options, job.limits, why_whole(settings))
        if isinstance(kept, Import):
            notes = kept.all_notes
            summary = write_import(kept, staged, settings, threads=threads)
        else:
            notes = kept.metadata.get("notes") or []
            summary = write(kept, staged, settings, threads=threads)
        outcome.written_size = summary.file_size
    outcome.notes += [each for each in notes if isinstance(each, str)]
    outcome.result, outcome.exit_code = "encoded", INTACT


def recover(job: Job, outcome: FileOutcome) -> None:
    """Intact files are left where they are."""
    from ..edit.recover import recover as recover_file
    from ..reading.verifier import verify as verify_file

    file = content(job.place)
    report = verify_file(file, limits=job.limits, threads=job.options.get("threads"))
    if not report.exit_code:
        outcome.result, outcome.exit_code, outcome.target = "intact", INTACT, ""
        return
    with published(job, ".hapf") as staged:
        done = recover_file(file, staged, limits=job.limits)
        outcome.written_size = staged.stat().st_size
    outcome.result, outcome.exit_code = "recovered", done.exit_code
    parts = few_of(done.summary) if done.exit_code else []
    if not done.packets:
        parts = ["nothing was recovered: the file has no intact packet", *parts]
    outcome.message = "; ".join(parts)


def convert(job: Job, outcome: FileOutcome) -> None:
    from ..convert import read, save
    from ..convert.formats import named
    from ..writing.writer import write
    from .places import is_hapf, suffix_of

    reading = dict(job.options["reading"])
    recording = read(
        job.place.location, format=job.options.get("format"), limits=job.limits, **reading
    )
    if not is_hapf(suffix_of(job.place.name)):  # else they are those of an earlier conversion
        outcome.notes += notes_of(recording)
    with published(job, job.options["suffix"]) as staged:
        if job.options["suffix"] == ".hapf":
            write(recording, staged, threads=job.options.get("threads"))
        else:
            chosen = named(job.options["output"]).name
            room = job.limits.memory
            outcome.notes += save(recording, staged, format=chosen, max_memory=room)
        if not staged.is_dir():
            outcome.written_size = staged.stat().st_size
    outcome.result, outcome.exit_code = "converted", INTACT


def notes_of(recording: Recording) -> list[str]:
    notes = recording.metadata.get("notes", [])
    return [each for each in notes if isinstance(each, str)] if isinstance(notes, list) else []


WORK: dict[str, Callable[[Job, FileOutcome], None]] = {
    "verify": verify,
    "encode": encode,
    "recover": recover,
    "convert": convert,
    "catalogue": describe,
}
