"""Many jobs: in this process, in several, or on Dask, with a log that survives a crash.

The log is JSON, one object a line. The first line says that it is a log, and of which work. A job
that is begun or done has a line; so the next run knows what it can skip. Names are relative to the
folder of the log, so both may move together. A line that a crash cut off is ignored.
"""

from __future__ import annotations

import hashlib
import json
import logging
import multiprocessing
import os
import re
import shutil
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
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
WRITTEN, VERIFIED, CATALOGUED = "outputs", "verify", "catalogue"
"""Kinds of logs."""
MARK = b'{"log": "hapfmt archive", "of": "'
"""Every log begins with it."""
WORST = (ERROR, 3, 2, 4, INTACT)
"""Exit codes from the worst to the best: lost data are worse than a broken rule."""
ANSWER_SECONDS, WORKER_SECONDS = 10, 60
"""How long a Dask scheduler may take to answer, and to get its first worker."""
ADDRESS = re.compile(r"((tcp|tls|ucx|wss?)://)?(\[[0-9a-fA-F:.]+\]|[^/:\s]+):\d{1,5}/?")
AHEAD = 4
"""Tasks for each worker that the scheduler has at a time."""
BATCH, BATCH_SIZE = 16, 4 << 20
"""Most files of a task, and the bytes from which it gets no further one."""
ALLOCATOR = {"MALLOC_TRIM_THRESHOLD_": f"{64 << 20}", "MALLOC_MMAP_THRESHOLD_": f"{32 << 20}"}
"""Memory that processes keep. By default they give back each array above 128 kB, and spend a sixth
of their time on getting it again."""
DEATHS = 2
"""Processes that a file may end, before it fails."""
VARYING = re.compile(r"'[^']*'|\"[^\"]*\"|[-+]?\d[\d.,]*(e[-+]?\d+)?")
Advance = Callable[[int, int], None]
Tell = Callable[[str], None]


@dataclass
class RunSummary:
    """All outcomes of a run."""

    outcomes: list[FileOutcome] = field(default_factory=list)
    seconds: float = 0.0
    left_out: list[str] | None = None
    """Names of files of other formats, where the command looked for them."""

    @property
    def exit_code(self) -> int:
        """The worst of all files: 1, then 3, 2 and 4."""
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

    def notes(self) -> list[list[tuple[str, str]]]:
        """Name of the file and note, by kinds of notes: they differ in numbers and names only."""
        found: dict[str, dict[str, str]] = {}
        for each in self.outcomes:
            for text in each.notes:
                found.setdefault(VARYING.sub("#", text), {}).setdefault(each.name, text)
        return [list(one.items()) for one in found.values()]

    def as_json(self) -> dict[str, Any]:
        return {
            "files": [each.as_json() for each in self.outcomes],
            **({} if self.left_out is None else {"left_out": self.left_out}),
            "results": {name: len(found) for name, found in self.counts().items()},
            "read_size": sum(each.read_size for each in self.outcomes),
            "written_size": sum(each.written_size for each in self.outcomes),
            "seconds": round(self.seconds, 6),
            "exit_code": self.exit_code,
        }


class Log(Closing):
    """Reads what earlier runs did, and appends what this one does. One run at a time holds it.
    Raises ParameterError where the file is there and no log of this kind."""

    def __init__(self, path: Path, kind: str = WRITTEN) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self.folder = path.parent.resolve()
        if path.exists() and not path.is_file():
            raise no_log(path)
        self.stream: BinaryIO = path.open("ab+")
        if lock(self.stream.fileno()) is False:
            self.stream.close()
            raise ParameterError(f"another run uses the log {path}", path="")
        self.begun: dict[str, str] = {}
        self.done: dict[str, tuple[str, dict[str, Any]]] = {}
        self.sources: dict[str, str] = {}
        self.stream.seek(0)
        head = MARK + kind.encode() + b'"}\n'
        found = self.stream.read(len(head))
        if not head.startswith(found):
            self.stream.close()
            if found.startswith(MARK):
                raise ParameterError(
                    f"{path} is the log of another command; --log names a file of its own", path=""
                )
            raise no_log(path)
        if found != head:  # a new file, or one that a crash cut off
            self.stream.truncate(0)
            self.stream.write(head)
        whole = True
        for line in self.stream:
            whole = line.endswith(b"\n")
            self.learn(line)
        if not whole:
            self.stream.write(b"\n")

    def name(self, location: str) -> str:
        """A path relative to the log; a URL as it is."""
        if is_url(location):
            return location
        try:
            return Path(os.path.relpath(location, self.folder)).as_posix()
        except ValueError:  # another drive of Windows
            return str(Path(location).absolute())

    def key(self, job: Job) -> str:
        return self.name(job.target or job.place.location)

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
        self.sources[key] = str(entry.get("source"))
        if isinstance(entry.get("done"), dict):
            self.done[key] = stamp, entry["done"]

    def write(self, job: Job, done: Mapping[str, Any] | None = None) -> None:
        entry: dict[str, Any] = {"file": self.key(job), "stamp": stamp_of(job)}
        entry["source"] = self.name(job.place.location)
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


def no_log(path: Path) -> ParameterError:
    return ParameterError(
        f"{path} is not a log of hapfmt; --log names a file that remembers what is done", path=""
    )


def stamp_of(job: Job) -> str:
    """Changes when the file, or what is done to it, changes."""
    options = repr([job.verb, sorted(job.options.items()), job.limits])
    return f"{job.place.signature} {hashlib.sha256(options.encode()).hexdigest()[:16]}"


def run(
    jobs: Sequence[Job],
    *,
    workers: int | None = None,
    address: str | None = None,
    log: Log | None = None,
    skip: Callable[[Job, dict[str, Any]], FileOutcome | None] | None = None,
    progress: Advance | None = None,
    tell: Tell | None = None,
) -> list[FileOutcome]:
    """The outcomes of all jobs, in their order.

    ``workers``: processes of this machine. ``address``: a running scheduler of Dask. Neither: this
    process. ``skip`` says what a job that the log knows as done becomes; None: it is done again.
    ``tell`` gets what a person has to know meanwhile.
    """
    found: list[FileOutcome | None] = [None] * len(jobs)
    waiting: list[int] = []
    for place, job in enumerate(jobs):
        known = log.done.get(log.key(job)) if log else None
        if known and known[0] == stamp_of(job) and skip and (old := skip(job, known[1])):
            found[place] = old
        elif log and finished_before(log, job):
            found[place] = FileOutcome(job.place.name, "skipped", INTACT, target=job.target)
        elif log and (text := changed_since(log, job)):
            found[place] = FileOutcome(job.place.name, "failed", ERROR, text, target=job.target)
        else:
            waiting.append(place)
    count = len(jobs) - len(waiting)

    def begin(place: int) -> Job:
        job = jobs[place]
        if log and job.target and not job.place.error and (job.force or not target_exists(job)):
            log.write(job)
        return job

    def end(place: int, outcome: FileOutcome) -> None:
        nonlocal count
        found[place] = outcome
        count += 1
        job = jobs[place]
        if log and outcome.exit_code != ERROR and not job.place.error:
            target = log.key(job) if outcome.target else None
            more = {"target": target, "rows": outcome.rows, **mark_of(job)}
            log.write(job, {**outcome.as_json(), **more})
        if progress:
            progress(count, len(jobs))

    if workers:
        in_processes(workers, waiting, begin, end)
    elif address:
        with cluster(address, tell) as client:
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
        log.key(job) not in log.done
        and log.begun.get(log.key(job)) == stamp_of(job)
        and target_exists(job)
    )


def changed_since(log: Log, job: Job) -> str:
    """What makes an output that an earlier run wrote out of date; empty where nothing does."""
    key, stamp = log.key(job), stamp_of(job)
    before = log.begun.get(key, stamp)
    if (
        before == stamp or not job.target or job.force or job.place.error
        or log.sources.get(key) != log.name(job.place.location) or not target_exists(job)
    ):  # fmt: skip
        return ""
    same = before.rpartition(" ")[0] == job.place.signature
    what = "the options have" if same else "the recording has"
    target = shown(job.target) if is_url(job.target) else job.target
    return f"{what} changed since {target} was written; use force=True to overwrite it"


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


def check_address(address: str) -> None:
    if not ADDRESS.fullmatch(address):
        raise ParameterError(
            f"{address!r} is not the address of a Dask scheduler, such as tcp://10.0.0.1:8786"
        )


@contextmanager
def cluster(address: str, tell: Tell | None = None) -> Iterator[Any]:
    """A client of Dask."""
    try:
        dask = import_module("dask")
        distributed = import_module("distributed")
    except ImportError:
        raise MissingExtraError("distributed", "dask") from None
    # The client logs a traceback for a lost connection; our error is one line.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL + 1)
    quiet = {"distributed.logging": {"distributed": "critical", "bokeh": "critical"}}
    with dask.config.set(quiet), ExitStack() as stack:
        check_address(address)
        try:
            client = distributed.Client(address, timeout=ANSWER_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ParameterError(f"no Dask scheduler answers at {address}") from error
        stack.enter_context(client)
        try:
            await_worker(client, address, tell)
            yield client
        except (CancelledError, OSError) as error:
            # Errors of files are outcomes, so this one is of the connection.
            raise ParameterError(
                f"the connection to the Dask scheduler at {address} has ended. What the log "
                "holds is done: the same command goes on"
            ) from error


def await_worker(client: Any, address: str, tell: Tell | None) -> None:
    if client.ncores():
        return
    if tell:
        tell(f"waiting for workers of {address}")
    try:
        client.wait_for_workers(1, timeout=WORKER_SECONDS)
    except TimeoutError:
        raise ParameterError(
            f"the Dask scheduler at {address} has no workers; start one with: dask worker {address}"
        ) from None


Batch = list[tuple[int, Job]]


class Batches:
    """Jobs that are handed over together, in order: handing one over takes as long as checking
    100 kB. Jobs in ``alone`` are by themselves."""

    def __init__(self, places: Sequence[int], workers: int, begin: Callable[[int], Job]) -> None:
        self.waiting, self.begin = deque(places), begin
        self.most = max(min(BATCH, len(places) // (AHEAD * workers)), 1)

    def take(self) -> Batch:
        """The next ones; empty at the end."""
        batch: Batch = []
        size = 0
        while self.waiting and len(batch) < self.most and size < BATCH_SIZE:
            place = self.waiting.popleft()
            job = one_thread(self.begin(place))
            if job.target and not is_url(job.target) and not job.force:
                job = replace(job, begun=not target_exists(job))
            batch.append((place, job))
            size += job.place.size
        return batch


def in_processes(
    count: int,
    places: Sequence[int],
    begin: Callable[[int], Job],
    end: Callable[[int, FileOutcome], None],
) -> None:
    """In processes of this machine, which an interruption ends. A process that dies takes no file
    along: those that were under way run again, one at a time, so that only the one to blame fails.
    """
    batches = Batches(places, count, begin)
    running: dict[Future[list[FileOutcome]], Batch] = {}
    suspects: deque[tuple[int, Job]] = deque()
    deaths: dict[int, int] = {}
    others = set(multiprocessing.active_children())
    pool: ProcessPoolExecutor | None = None
    try:
        while True:
            on_trial = bool(suspects)
            while len(running) < (1 if on_trial else AHEAD * count):
                batch = [suspects.popleft()] if on_trial else batches.take()
                if not batch:
                    break
                if pool is None:
                    for name, value in ALLOCATOR.items():  # for the processes that start now
                        os.environ.setdefault(name, value)
                    pool = ProcessPoolExecutor(
                        count, multiprocessing.get_context("spawn"), initializer=ignore_interrupt
                    )
                with held_back(signal.SIGINT):
                    running[pool.submit(run_jobs, [job for _, job in batch])] = batch
            if not running:
                return
            ended, _ = wait(running, return_when=FIRST_COMPLETED)
            if any(isinstance(future.exception(), BrokenProcessPool) for future in ended):
                ended = wait(running).done  # they all end, now that the pool is broken
                pool = None
            for future in ended:
                batch, error = running.pop(future), future.exception()
                if error is None:
                    for (place, _), outcome in zip(batch, future.result(), strict=True):
                        end(place, outcome)
                elif not on_trial:
                    suspects += batch
                else:
                    ((place, job),) = batch
                    deaths[place] = deaths.get(place, 0) + 1
                    if deaths[place] < DEATHS:
                        suspects.appendleft((place, job))
                    else:
                        end(place, broken(job, error))
    except BaseException:
        # Outputs appear whole or not at all, also those of jobs that still run.
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        raise
    finally:
        if pool is not None:
            pool.shutdown(cancel_futures=True)


@contextmanager
def held_back(number: signal.Signals) -> Iterator[None]:
    """Processes that start meanwhile never get the signal: an interruption then ends them in
    order. This process gets it at the end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    # A thread of a library may get the signal in spite of the mask, which is for what starts here.
    handler = signal.signal(number, lambda *_: came.append(number))
    has_masks = hasattr(signal, "pthread_sigmask")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number}) if has_masks else set()
    try:
        yield
    finally:
        if has_masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        signal.signal(number, handler)
    if came:
        signal.raise_signal(number)


def ignore_interrupt() -> None:
    """The process that started this one ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def distributed(
    client: Any,
    places: Sequence[int],
    begin: Callable[[int], Job],
    end: Callable[[int, FileOutcome], None],
) -> None:
    """A few tasks for each worker are on their way at a time, so that the log stays ahead."""
    as_completed = import_module("distributed").as_completed
    workers = max(len(client.ncores()), 1)
    batches = Batches(places, workers, begin)
    alone: deque[tuple[int, Job]] = deque()
    """One of them is to blame for the death of a worker."""
    running: dict[str, Batch] = {}
    done = as_completed(loop=client.loop)

    def submit() -> None:
        if batch := [alone.popleft()] if alone else batches.take():
            # A worker that dies takes no file along: its jobs run elsewhere.
            work = [job for _, job in batch]
            future = client.submit(run_jobs, work, pure=False, retries=2)
            running[future.key] = batch
            done.add(future)

    try:
        for _ in range(AHEAD * workers):
            submit()
        for future in done:
            batch = running.pop(future.key)
            error = future.exception()
            if error is None:
                for (place, _), outcome in zip(batch, future.result(), strict=True):
                    end(place, outcome)
            elif len(batch) > 1:
                alone += batch
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
    died = name in ("KilledWorker", "BrokenProcessPool")
    text = "its worker died again and again" if died else f"{name}: {error}"
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
