"""Runs hapfmt's command line as often as tests like: each run is a process of its own, forked from
one that has imported everything already, since starting Python takes longer than most verbs.

Where there is no fork, each run is a fresh interpreter. What starting itself does (what is imported
when, signals, pipes that close) is tested with fresh interpreters, in other modules.
"""

from __future__ import annotations

import atexit
import gc
import os
import runpy
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import hapfmt

HOME = Path(hapfmt.__file__).parents[1]
"""Of the hapfmt that is tested: that of the clone, or an installed one."""
ENVIRONMENT = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Forks have no threads."""
PYTHON = [sys.executable, "-W", "error"]
Done = subprocess.CompletedProcess[bytes]


FORKS = hasattr(os, "fork") and hasattr(socket, "send_fds")
PROGRAM = "python"
"""The first word where the second is a program of the clone, and the others are for it."""


def run_program(path: Path, *arguments: object, cwd: Path) -> Done:
    """Any program in Python, in a fork that has imported hapfmt already."""
    return run(PROGRAM, path, *arguments, cwd=cwd)


def run(*arguments: object, cwd: Path, stdin: bytes = b"", columns: int = 200) -> Done:
    words = [str(word) for word in arguments]
    if not FORKS:
        what = words[1:] if words[0] == PROGRAM else ["-m", "hapfmt", *words]
        return subprocess.run(
            [*PYTHON, *what], cwd=cwd, input=stdin, capture_output=True,
            check=False, env={**ENVIRONMENT, "COLUMNS": str(columns)},
        )  # fmt: skip
    with (
        tempfile.TemporaryFile() as given,
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as err,
    ):
        given.write(stdin)
        given.seek(0)
        code = forked(words, [given.fileno(), out.fileno(), err.fileno()], cwd, str(columns))
        out.seek(0)
        err.seek(0)
        return subprocess.CompletedProcess(words, code, out.read(), err.read())


def run_in_terminal(*arguments: object, cwd: Path, columns: int = 80) -> Done:
    """In a pseudo-terminal of this width. Everything printed is in ``stdout``."""
    words = [str(word) for word in arguments]
    with pseudo_terminal(columns) as (slave, printed):
        code = forked(words, [slave] * 3, cwd, "")
        os.close(slave)
    return subprocess.CompletedProcess(words, code, b"".join(printed), b"")


def run_to_terminal(*arguments: object, cwd: Path, columns: int = 80) -> Done:
    """Standard output is a pseudo-terminal of this width; the other streams are files."""
    words = [str(word) for word in arguments]
    with tempfile.TemporaryFile() as given, tempfile.TemporaryFile() as err:
        with pseudo_terminal(columns) as (slave, printed):
            code = forked(words, [given.fileno(), slave, err.fileno()], cwd, "")
            os.close(slave)
        err.seek(0)
        return subprocess.CompletedProcess(words, code, b"".join(printed), err.read())


@contextmanager
def pseudo_terminal(columns: int) -> Iterator[tuple[int, list[bytes]]]:
    """The slave's descriptor, to be closed in the block, and a list of what is printed."""
    import fcntl
    import pty
    import struct
    import termios

    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
    printed: list[bytes] = []

    def listen() -> None:
        with suppress(OSError):  # EIO: no process has the slave open any more
            while data := os.read(master, 1 << 16):
                printed.append(data)

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        yield slave, printed
        listener.join()
    finally:
        os.close(master)


def forked(words: list[str], files: list[int], cwd: Path, columns: str) -> int:
    """Runs the words in a fork of the server with these standard streams: its exit code."""
    message = "\0".join([os.fspath(cwd), columns, *words]).encode()
    connection = server()
    connection.sendall(len(message).to_bytes(4, "little"))
    socket.send_fds(connection, [message[:1]], files)
    connection.sendall(message[1:])
    return int.from_bytes(received(connection, 4), "little", signed=True)


@cache
def server() -> socket.socket:
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(
        [*PYTHON, __file__, str(theirs.fileno())], pass_fds=[theirs.fileno()],
        env={**ENVIRONMENT, "PYTHONPATH": f"{HOME}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"},
    )  # fmt: skip
    theirs.close()

    def end() -> None:
        ours.close()
        process.wait()

    atexit.register(end)
    return ours


def received(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = connection.recv(size - len(data))
        if not more:
            raise EOFError("the other end has gone")
        data += more
    return data


def serve(connection: socket.socket) -> None:
    """Until the other end closes: size, words and three files in; the exit code out."""
    while True:
        try:
            size = int.from_bytes(received(connection, 4), "little")
        except EOFError:
            return
        first, files, *_ = socket.recv_fds(connection, 1, 3)
        cwd, columns, *words = (first + received(connection, size - 1)).decode().split("\0")
        pid = os.fork()
        if not pid:
            connection.close()
            one(cwd, columns, words, files)
        for each in files:
            os.close(each)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        connection.sendall(code.to_bytes(4, "little", signed=True))


def one(cwd: str, columns: str, words: list[str], files: list[int]) -> None:
    """What ``python -m hapfmt`` does, or another program, in this process, which then ends."""
    from hapfmt.cli import main

    os.environ["COLUMNS"] = columns
    if not columns:  # a terminal knows its own width
        del os.environ["COLUMNS"]
        os.setsid()
    for place, each in enumerate(files):
        os.dup2(each, place)
    os.chdir(cwd)
    code: object = 0
    try:
        if words[:1] == [PROGRAM]:
            sys.argv[:] = words[1:]
            sys.path[0] = str(Path(words[1]).parent)
            runpy.run_path(words[1], run_name="__main__")
        else:
            sys.argv[:] = ["hapfmt", *words]
            main()
    except SystemExit as ended:
        code = ended.code
    except BaseException:
        sys.excepthook(*sys.exc_info())
        code = 1
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code if isinstance(code, int) else int(bool(code)))


if __name__ == "__main__":
    import importlib
    import pkgutil

    import hapfmt

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # What takes longer than all the rest.
    for name in ("matplotlib.figure", "matplotlib.backends.backend_agg"):
        with suppress(ImportError):
            importlib.import_module(name)
    for module in pkgutil.walk_packages(hapfmt.__path__, "hapfmt."):
        if not module.name.startswith(
            ("hapfmt.__main__", "hapfmt.lab.plotting", "hapfmt.lab.study.outputs")
        ):
            importlib.import_module(module.name)
    gc.collect()
    gc.freeze()  # a fork that looks at everything copies it
    with socket.socket(fileno=int(sys.argv[1])) as ours:
        serve(ours)
