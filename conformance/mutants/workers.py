"""Processes that carry out verbs of hapfmt, right or with a mutant's mistake.

hapfmt is imported once, here, in its readable form; each worker is a fork of that.
"""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import sys
from collections.abc import Collection, Sequence
from contextlib import suppress
from importlib import import_module
from pkgutil import walk_packages
from typing import NoReturn

from .mutant import Mutant, NotApplicableError, watch

SECONDS = 10.0
"""Of one verb."""
MEMORY = 2 << 30
"""Bytes of address space."""
LEFT_OUT = ("hapfmt.cli", "hapfmt.lab.plotting", "hapfmt.__main__")


def prepare() -> None:
    """Import every module that a verb may need, before anything is changed."""
    os.environ["HAPFMT_PURE"] = "1"
    package = import_module("hapfmt")
    for found in walk_packages(package.__path__, "hapfmt."):
        if not found.name.startswith(LEFT_OUT) and "_kernels" not in found.name:
            import_module(found.name)
    kernels = import_module("hapfmt.kernels")
    assert kernels.compiled is None, "hapfmt was imported before"


class Worker:
    """Carries out one verb after the other; a worker that died is forked again. ``called`` grows by
    those of the functions in ``watched`` that a verb called."""

    def __init__(self, mutant: Mutant | None = None, watched: Collection[str] = ()) -> None:
        self.mutant = mutant
        self.watched = watched
        self.called: set[str] = set()
        self.pid = 0
        self.start()

    def start(self) -> None:
        there, out = os.pipe()
        back, answer = os.pipe()
        sys.stdout.flush()
        self.pid = os.fork()
        if not self.pid:
            os.close(out)
            os.close(back)
            serve(self.mutant, self.watched, there, answer)
        os.close(there)
        os.close(answer)
        self.out, self.back = out, os.fdopen(back)
        first = self.back.readline()
        if first != "ready\n":
            self.close()
            raise NotApplicableError(first.strip() or "a worker that does not start")

    def run(self, argv: Sequence[str], seconds: float = SECONDS) -> int | None:
        """The exit code; None where it died or took too long."""
        os.write(self.out, (json.dumps(list(argv)) + "\n").encode())
        ready, _, _ = select.select([self.back], [], [], seconds)
        line = self.back.readline() if ready else ""
        if line:
            code, *called = line.split()
            self.called.update(called)
            return int(code)
        self.close()
        self.start()
        return None

    def close(self) -> None:
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            os.close(self.out)
            self.back.close()
            self.pid = 0

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def serve(mutant: Mutant | None, watched: Collection[str], lines: int, answers: int) -> NoReturn:
    """The child's life."""
    with suppress(BaseException), os.fdopen(answers, "w") as out:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(nowhere, stream)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        called: set[str] = set()
        try:
            if mutant is not None:
                mutant.apply()
            if watched:
                called = watch(watched)
        except Exception as error:
            print(f"{mutant and mutant.name}: {error}".replace("\n", " "), file=out, flush=True)
            os._exit(1)
        print("ready", file=out, flush=True)
        run = import_module("hapfmt_adapter.verbs").run
        with os.fdopen(lines) as source:
            for line in source:
                if watched:
                    forget()
                    called.clear()
                print(run(json.loads(line)), *called, file=out, flush=True)
    os._exit(0)


def forget() -> None:
    """What was remembered of earlier calls would hide which functions a verb needs."""
    for path, module in list(sys.modules.items()):
        for found in vars(module).values() if path.startswith("hapfmt") else ():
            if hasattr(found, "cache_clear"):
                found.cache_clear()
