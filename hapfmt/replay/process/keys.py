"""Reads keys of the terminal during playback: space, arrows, q."""

from __future__ import annotations

import atexit
import os
import sys
from contextlib import suppress
from typing import Any, Literal

Key = Literal["pause", "back", "forward", "stop"]
BYTES: dict[bytes, Key] = {
    b" ": "pause",
    b"q": "stop",
    b"Q": "stop",
    b"\x1b[D": "back",
    b"\x1b[C": "forward",
    b"\x1bOD": "back",
    b"\x1bOC": "forward",
}
WINDOWS: dict[str, Key] = {
    " ": "pause",
    "q": "stop",
    "Q": "stop",
    "\xe0K": "back",
    "\xe0M": "forward",
    "\0K": "back",
    "\0M": "forward",
}
LONGEST = max(map(len, BYTES))


class TerminalKeys:
    """In a ``with`` block the terminal gives each key at once and shows none; after it, and at any
    exit of the interpreter, it is as before. Where there is no terminal, no key comes."""

    def __init__(self, descriptor: int | None = None) -> None:
        self.descriptor = descriptor
        self.before: Any = None
        self.waiting = b""

    def __enter__(self) -> TerminalKeys:
        if self.descriptor is None:
            with suppress(OSError, ValueError, AttributeError):
                self.descriptor = sys.stdin.fileno()
        if self.descriptor is None or not os.isatty(self.descriptor):
            self.descriptor = None
        elif sys.platform != "win32":
            self.begin(self.descriptor)
        return self

    def __exit__(self, *_: object) -> None:
        self.restore()

    if sys.platform != "win32":

        def begin(self, descriptor: int) -> None:
            import termios

            try:
                self.before = termios.tcgetattr(descriptor)
                changed = termios.tcgetattr(descriptor)
                changed[3] &= ~(termios.ICANON | termios.ECHO)
                off = os.fpathconf(descriptor, "PC_VDISABLE")
                # Ctrl-Z would stop the player and not the device; Ctrl-\\ leave the terminal so.
                for place in (termios.VSUSP, termios.VQUIT):
                    changed[6][place] = bytes([off & 0xFF])
                changed[6][termios.VMIN], changed[6][termios.VTIME] = 0, 0
                termios.tcsetattr(descriptor, termios.TCSADRAIN, changed)
            except (termios.error, OSError):
                self.restore()
                self.descriptor = None
            else:
                atexit.register(self.restore)

        def restore(self) -> None:
            import termios

            if self.before is not None and self.descriptor is not None:
                with suppress(termios.error, OSError):  # the terminal may have gone
                    termios.tcsetattr(self.descriptor, termios.TCSANOW, self.before)
            self.before = None
            atexit.unregister(self.restore)

        def pressed(self) -> list[Key]:
            """Keys since the last call; unknown keys are dropped."""
            if self.descriptor is None:
                return []
            try:
                self.waiting += os.read(self.descriptor, 1 << 10)
            except BlockingIOError:
                pass
            except OSError:
                self.descriptor = None
            found, self.waiting = split(self.waiting)
            return found

    else:

        def restore(self) -> None:
            """Nothing was changed."""

        def pressed(self) -> list[Key]:
            import msvcrt

            found: list[Key] = []
            while self.descriptor is not None and msvcrt.kbhit():
                key = msvcrt.getwch()
                if key in "\0\xe0":
                    key += msvcrt.getwch()
                if key in WINDOWS:
                    found.append(WINDOWS[key])
            return found


def split(data: bytes) -> tuple[list[Key], bytes]:
    """Keys, and what may be the beginning of one."""
    found: list[Key] = []
    while data:
        for size in range(1, LONGEST + 1):
            if data[:size] in BYTES:
                found.append(BYTES[data[:size]])
                data = data[size:]
                break
        else:
            if len(data) < LONGEST and any(name.startswith(data) for name in BYTES):
                return found, data
            data = data[1:]
    return found, b""
