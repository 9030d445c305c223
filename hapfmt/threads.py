"""Work in threads, with results in order and independent of the number of threads.

Threads save time where the compiled loops run, because these release the interpreter's lock.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from .errors import ParameterError
from .kernels import compiled

if TYPE_CHECKING:
    from concurrent.futures import Future

Item = TypeVar("Item")
Result = TypeVar("Result")

VARIABLE = "HAPFMT_THREADS"
SMALL = 400_000
"""Samples that one thread codes in the time that others take to begin (measured: 200 000 to
400 000)."""

AHEAD = 2
"""Items for each thread that are taken before their results are."""


class Stopped(BaseException):
    """Raised in a thread whose result is no longer wanted."""


class Failure(NamedTuple):
    """In place of an item: what taking it raised."""

    error: BaseException


_here = threading.local()


def thread_count(asked: int | None, samples: int) -> int:
    """``asked``, else as the environment says, else the CPUs there are for the process; 1 where
    work is small or the extension is missing, unless more are asked for."""
    if asked is None:
        text = os.environ.get(VARIABLE, "")
        if text and not text.isdecimal():
            raise ParameterError(f"{VARIABLE} is a number of threads, not {text!r}")
        asked = int(text) if text else None
    if asked is None:
        return 1 if samples < SMALL or compiled is None else cpu_count()
    if asked < 1:
        raise ParameterError("the number of threads must be at least 1")
    return asked


def cpu_count() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_stopped() -> None:
    """Ends the thread that calls it, if its work is not wanted any more."""
    stop: threading.Event | None = getattr(_here, "stop", None)
    if stop is not None and stop.is_set():
        raise Stopped


def in_order(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    threads: int,
    weigh: Callable[[Item], float] = lambda _: 0,
) -> Iterator[Result]:
    """``work`` of each item, in their order.

    Items are taken in the caller's thread, a few ahead, and no more than weigh 1 together, but for
    one alone. An error is raised where a single thread would raise it; what follows is given up.
    """
    if threads <= 1:
        yield from map(work, items)
        return
    from concurrent.futures import ThreadPoolExecutor

    stop = threading.Event()

    def run(item: Item) -> Result:
        _here.stop = stop
        check_stopped()
        return work(item)

    waiting: deque[tuple[Future[Result] | Failure, float]] = deque()
    load = 0.0
    pool = ThreadPoolExecutor(threads, "hapfmt")
    try:
        for item in failing(items):
            weight = 0.0 if isinstance(item, Failure) else weigh(item)
            while waiting and (len(waiting) >= AHEAD * threads or load + weight > 1):
                first, lighter = waiting.popleft()
                yield result_of(first)
                load -= lighter
            future = item if isinstance(item, Failure) else pool.submit(run, item)
            waiting.append((future, weight))
            load += weight
        while waiting:
            yield result_of(waiting.popleft()[0])
    finally:
        stop.set()
        pool.shutdown(cancel_futures=True)


def failing(items: Iterable[Item]) -> Iterator[Item | Failure]:
    """The items, and at their end the error that taking them raised."""
    try:
        yield from items
    except Exception as error:
        yield Failure(error)


def result_of(waiting: Future[Result] | Failure) -> Result:
    if isinstance(waiting, Failure):
        raise waiting.error
    return waiting.result()
