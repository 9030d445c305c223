"""Lines of JSON over a socket, between the test and what serves it."""

from __future__ import annotations

import json
import socket
from typing import Any

PIECE = 256  # events of one answer


class Channel:
    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.held = b""

    def fileno(self) -> int:
        return self.connection.fileno()

    def send(self, message: dict[str, Any]) -> None:
        self.connection.sendall(json.dumps(message).encode() + b"\n")

    def receive(self) -> dict[str, Any]:
        """The next message; EOFError when the other end has gone."""
        while b"\n" not in self.held:
            more = self.connection.recv(1 << 16)
            if not more:
                raise EOFError("the other end has gone")
            self.held += more
        line, self.held = self.held.split(b"\n", 1)
        message: dict[str, Any] = json.loads(line)
        return message

    def ask(self, **message: Any) -> dict[str, Any]:
        """Send, and wait for the answer."""
        self.send(message)
        return self.receive()

    def close(self) -> None:
        self.connection.close()
