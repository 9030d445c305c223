"""What a device saw, kept where it is served and given out in pieces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .channel import PIECE
from .model import Event


class Log:
    def __init__(self) -> None:
        self.events: list[Event] = []

    def add(self, event: Event) -> None:
        self.events.append(event)

    def since(self, first: int) -> dict[str, Any]:
        part = self.events[first : first + PIECE]
        return {"events": [x.to_json() for x in part], "more": first + PIECE < len(self.events)}


class Processes:
    """Threads -> processes, as the kernel names the thread that calls."""

    def __init__(self) -> None:
        self.known: dict[int, int] = {}

    def of(self, thread: int) -> int:
        if thread not in self.known:
            self.known[thread] = self.look(thread)
        return self.known[thread]

    @staticmethod
    def look(thread: int) -> int:
        try:
            status = Path(f"/proc/{thread}/status").read_text(encoding="utf-8")
        except OSError:
            return thread
        return next(int(x.split()[1]) for x in status.splitlines() if x.startswith("Tgid:"))

    @staticmethod
    def program(process: int) -> str:
        """Its command line."""
        try:
            words = Path(f"/proc/{process}/cmdline").read_bytes()
        except OSError:
            return ""
        return words.decode(errors="replace").replace("\0", " ").strip()
