"""Many jobs: in this process or on Dask, with a log that survives a crash.

The log is JSON, one object a line. A job that is begun or done has a line; so the next run knows
what it can skip. A line that a crash cut off is ignored.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

from ..errors import INTACT, MissingExtraError, ParameterError
from ..files import Closing, lock
from ..format.source import is_url, network, shown
from .jobs import ERROR, FileOutcome, Job
from .places import Place, file_system
from .work import run_job

FOLDER = ".hapfmt-archive"
"""In the target folder: the log, and outputs that are not complete."""
LOG, STAGING = "log.jsonl", "unfinished"
WORST = (ERROR, 2, 3, 4, INTACT)
"""Exit codes from the worst to the best."""
AHEAD = 4
"""Tasks for each worker that the scheduler has at a time."""
BATCH, BATCH_SIZE = 16, 4 << 20
"""Most files of a task, and the bytes from which it gets no further one."""
ALLOCATOR = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 64 << 20,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 32 << 20,
}
"""Memory that processes of Dask keep. By default they give back each array above 128 kB, and spend
a sixth of their time on getting it again."""
Advance = Callable[[int, int], None]


@dataclass
class RunSummary:
    """All outcomes of a run."""

    outcomes: list[FileOutcome] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def exit_code(self) -> int:
        """The worst of all files: 1, then 2, 3 and 4."""
        codes = {each.exit_code for each in self.outcomes}
        return next(code for code in WORST if code in codes or code == INTACT)

    @property
    def problems(self) -> list[FileOutcome]:
        return [each for each in self.outcomes if each.exit_code]

    def counts(self) -> dict[str, list[FileOutcome]]:
        found: dict[str, list[FileOutcome]] = {}
        for each in self.outcomes:
            found.setdefault(each.result, []).append(each)
        return found

    def as_json(self) -> dict[str, Any]:
        return {
            "files": [each.as_json() for each in self.outcomes],
            "results": {name: len(found) for name, found in self.counts().items()},
            "read_size": sum(each.read_size for each in self.outcomes),
            "written_size": sum(each.written_size for each in self.outcomes),
            "seconds": round(self.seconds, 6),
            "exit_code": self.exit_code,
        }


class Log(Closing):
    """Reads what earlier runs did, and appends what this one does. One run at a time holds it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self.stream: BinaryIO = path.open("ab+")
        if lock(self.stream.fileno()) is False:
            self.stream.close()
            raise ParameterError(f"another run uses the log {path}", path="")
        self.begun: dict[str, str] = {}
        self.done: dict[str, tuple[str, dict[str, Any]]] = {}
        self.stream.seek(0)
        whole = True
        for line in self.stream:
            whole = line.endswith(b"\n")
            self.learn(line)
        if not whole:
            self.stream.write(b"\n")

    def learn(self, line: bytes) -> None:
        try:
            entry = json.loads(line)
            if not isinstance(entry, dict):
                return
            key, stamp = entry["file"], entry["stamp"]
        except (ValueError, KeyError, TypeError):
            return
        if not (isinstance(key, str) and isinstance(stamp, str)):
            return
        self.begun[key] = stamp
        if isinstance(entry.get("done"), dict):
            self.done[key] = stamp, entry["done"]

    def write(self, key: str, stamp: str, done: Mapping[str, Any] | None = None) -> None:
        entry: dict[str, Any] = {"file": key, "stamp": stamp}
        if done is not None:
            entry["done"] = done
        line = json.dumps(entry).encode() + b"\n"
        self.stream.write(line)
        self.stream.flush()
        self.learn(line)

    def close(self) -> None:
        self.stream.close()

    def remove(self) -> None:
        """The log is not needed any more."""
        with suppress(OSError):
            self.path.unlink()
        self.close()
        with suppress(OSError):
            self.path.parent.rmdir() if self.path.parent.name == FOLDER else None


def stamp_of(job: Job) -> str:
    """Changes when the file, or what is done to it, changes."""
    options = repr([job.verb, job.target, sorted(job.options.items()), job.limits])
    return f"{job.place.signature} {hashlib.sha256(options.encode()).hexdigest()[:16]}"


def key_of(job: Job) -> str:
    place = job.place
    return place.location if place.is_url else str(Path(place.location).absolute())


def run(
    jobs: Sequence[Job],
    *,
    workers: int | None = None,
    address: str | None = None,
    log: Log | None = None,
    skip: Callable[[Job, dict[str, Any]], FileOutcome | None] | None = None,
    progress: Advance | None = None,
) -> list[FileOutcome]:
    """The outcomes of all jobs, in their order.

    ``workers``: processes of a local Dask cluster. ``address``: a running scheduler. Neither: this
    process. ``skip`` says what a job that the log knows as done becomes; None: it is done again.
    """
    found: list[FileOutcome | None] = [None] * len(jobs)
    waiting: list[int] = []
    for place, job in enumerate(jobs):
        known = log.done.get(key_of(job)) if log else None
        if known and known[0] == stamp_of(job) and skip and (old := skip(job, known[1])):
            found[place] = old
        elif log and finished_before(log, job):
            found[place] = FileOutcome(job.place.name, "skipped", INTACT, target=job.target)
        else:
            waiting.append(place)
    count = len(jobs) - len(waiting)

    def begin(place: int) -> Job:
        job = jobs[place]
        if log and job.target and not job.place.error and (job.force or not target_exists(job)):
            log.write(key_of(job), stamp_of(job))
        return job

    def end(place: int, outcome: FileOutcome) -> None:
        nonlocal count
        found[place] = outcome
        count += 1
        if log and outcome.exit_code != ERROR and not jobs[place].place.error:
            log.write(
                key_of(jobs[place]), stamp_of(jobs[place]),
                {**outcome.as_json(), "rows": outcome.rows, **mark_of(jobs[place])},
            )  # fmt: skip
        if progress:
            progress(count, len(jobs))

    if workers or address:
        with cluster(workers, address) as client:
            distributed(client, waiting, begin, end)
    else:
        for place in waiting:
            end(place, run_job(begin(place)))
    return [each for each in found if each is not None]


def finished_before(log: Log, job: Job) -> bool:
    """Whether a run that was killed had completed this output: it has a line in the log that says
    that the job was begun when its target was not there."""
    if not job.target or job.force or job.place.error:
        return False
    return (
        key_of(job) not in log.done
        and log.begun.get(key_of(job)) == stamp_of(job)
        and target_exists(job)
    )


def target_exists(job: Job) -> bool:
    if not is_url(job.target):
        return os.path.lexists(job.target)
    with network(shown(job.target)):
        files, path = file_system(job.target)
        return bool(files.exists(path))


def mark_of(job: Job) -> dict[str, Any]:
    """What a target is known by later: its size and time."""
    if not job.target or is_url(job.target):
        return {}
    try:
        info = Path(job.target).stat()
    except OSError:
        return {}
    return {"mark": [info.st_size, info.st_mtime_ns]}


def skip_written(job: Job, done: Mapping[str, Any]) -> FileOutcome | None:
    """An output that an earlier run wrote, unchanged since."""
    if done.get("target") and (
        not target_exists(job) or done.get("mark", []) != mark_of(job).get("mark", [])
    ):
        return None
    code = done.get("exit_code", INTACT)
    message = str(done.get("message") or "")
    return FileOutcome(job.place.name, "skipped", code, message, target=job.target)


@contextmanager
def cluster(workers: int | None, address: str | None) -> Iterator[Any]:
    """A client of Dask."""
    try:
        dask = import_module("dask")
        distributed = import_module("distributed")
    except ImportError:
        raise MissingExtraError("distributed", "dask") from None
    quiet = {
        "distributed.logging": {"distributed": "critical", "bokeh": "critical"},
        "distributed.worker.daemon": True,
        "distributed.admin.tick.limit": "1h",
        **ALLOCATOR,
    }
    with dask.config.set(quiet):
        if address:
            try:
                client = distributed.Client(address, timeout=30, set_as_default=False)
            except (OSError, ValueError) as error:
                raise ParameterError(f"no Dask scheduler answers at {address}") from error
            with client:
                yield client
            return
        # Workers inherit the ignored signal: an interruption then ends them in order.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            local = distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0",
                silence_logs=50,
            )  # fmt: skip
        finally:
            signal.signal(signal.SIGINT, before)
        with local, distributed.Client(local, set_as_default=False) as client:
            yield client


def distributed(
    client: Any,
    places: Sequence[int],
    begin: Callable[[int], Job],
    end: Callable[[int, FileOutcome], None],
) -> None:
    """A few tasks for each worker are on their way at a time, so that the log stays ahead. Small
    files share a task: handing one over takes as long as checking 100 kB."""
    as_completed = import_module("distributed").as_completed
    workers = max(len(client.ncores()), 1)
    most = max(min(BATCH, len(places) // (AHEAD * workers)), 1)
    waiting = deque(places)
    alone: set[int] = set()
    batches: dict[str, list[tuple[int, Job]]] = {}
    done = as_completed(loop=client.loop)

    def submit() -> None:
        batch: list[tuple[int, Job]] = []
        size = 0
        while waiting and len(batch) < most and size < BATCH_SIZE:
            if batch and (waiting[0] in alone or batch[0][0] in alone):
                break
            place = waiting.popleft()
            job = one_thread(begin(place))
            if job.target and not is_url(job.target) and not job.force:
                job = replace(job, begun=not target_exists(job))
            batch.append((place, job))
            size += batch[-1][1].place.size
        if batch:
            # A worker that dies takes no file along: its jobs run elsewhere.
            work = [job for _, job in batch]
            future = client.submit(run_jobs, work, pure=False, retries=2)
            batches[future.key] = batch
            done.add(future)

    try:
        for _ in range(AHEAD * workers):
            submit()
        for future in done:
            batch = batches.pop(future.key)
            error = future.exception()
            if error is None:
                for (place, _), outcome in zip(batch, future.result(), strict=True):
                    end(place, outcome)
            elif len(batch) > 1:  # one of them is to blame
                alone.update(place for place, _ in batch)
                waiting.extend(place for place, _ in batch)
            else:
                place, job = batch[0]
                end(place, broken(job, error))
            submit()
    except KeyboardInterrupt:
        # Outputs appear whole or not at all, also those of jobs that still run.
        client.cancel(list(done.futures), force=True)
        raise


def run_jobs(jobs: Sequence[Job]) -> list[FileOutcome]:
    return [run_job(job) for job in jobs]


def one_thread(job: Job) -> Job:
    """Each worker has one core."""
    return replace(job, options={**job.options, "threads": 1})


def broken(job: Job, error: BaseException) -> FileOutcome:
    name = type(error).__name__
    text = "its worker died again and again" if name == "KilledWorker" else f"{name}: {error}"
    return FileOutcome(job.place.name, "failed", ERROR, text, read_size=job.place.size)


def targets_of(
    places: Sequence[Place], target: str, suffix: str
) -> tuple[list[str], dict[str, list[Place]]]:
    """The target of each place, and the targets that several places share."""
    shared: dict[str, list[Place]] = {}
    targets = []
    for place in places:
        below = str(PurePosixPath(place.name).with_suffix(suffix))
        # A name never leads out of the target folder.
        parts = [part for part in PurePosixPath(below).parts if part not in ("..", "/")]
        below = "/".join(parts)
        full = f"{target.rstrip('/')}/{below}" if is_url(target) else str(Path(target) / below)
        targets.append(full)
        shared.setdefault(full, []).append(place)
    return targets, {name: found for name, found in shared.items() if len(found) > 1}


@contextmanager
def emptied(staging: Path | None) -> Iterator[None]:
    """The folder of unfinished outputs, empty before and after: a run that was killed left some."""
    if staging is None:
        yield
        return
    shutil.rmtree(staging, ignore_errors=True)
    try:
        yield
    finally:
        shutil.rmtree(staging, ignore_errors=True)
