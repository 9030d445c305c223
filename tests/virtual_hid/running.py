"""A command that runs in a world."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from .world import World

SECONDS = 60.0


class Running:
    """What it prints goes to files, so that it never waits for the test."""

    def __init__(self, world: World, words: Sequence[str], stdin: IO[bytes] | None) -> None:
        self.world = world
        self.words = list(words)
        self.stdin = stdin
        self.given = stdin or file()
        self.out, self.err = file(), file()
        self.pid = 0

    def files(self) -> list[int]:
        return [self.given.fileno(), self.out.fileno(), self.err.fileno()]

    def wait(self, seconds: float = SECONDS) -> subprocess.CompletedProcess[str]:
        """Its code and output; TimeoutError, and it is killed, where it does not end in time."""
        try:
            code = self.world.code(self.pid, seconds)
        except TimeoutError:
            left = self.world.processes()
            self.signal(signal.SIGKILL)
            raise TimeoutError(
                f"{self.words} did not end in {seconds} s\n{self.stdout}{self.stderr}{left}"
            ) from None
        done = subprocess.CompletedProcess(self.words, code, self.stdout, self.stderr)
        self.close()
        return done

    @property
    def stdout(self) -> str:
        return text(self.out)

    @property
    def stderr(self) -> str:
        return text(self.err)

    def signal(self, number: int) -> None:
        self.world.signal(self.pid, number)

    def close(self) -> None:
        for each in (self.given, self.out, self.err):
            if each is not self.stdin:
                each.close()


def file() -> IO[bytes]:
    return tempfile.TemporaryFile()


def text(file: IO[bytes]) -> str:
    """All of it, wherever the process that writes it stands."""
    size = os.fstat(file.fileno()).st_size
    return os.pread(file.fileno(), size, 0).decode(errors="replace")
