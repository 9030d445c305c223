"""A web server on this machine, for one folder of bytes in memory; counts what is asked of it."""

from __future__ import annotations

import re
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, files: dict[str, bytes], *, parts: bool = True) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.files = files
        self.parts = parts
        """Whether it gives parts of files."""
        self.status: int | None = None
        """What it answers instead of content."""
        self.cut = 0
        """Bytes left out at the end of an answer."""
        self.asked: list[tuple[int, int]] = []
        """(first byte, bytes sent) of every content."""
        self.heads = 0
        """Requests for headers alone."""
        self.etags = True
        """Whether answers have an ETag."""

    @property
    def sent(self) -> int:
        return sum(size for _, size in self.asked)

    def url(self, name: str) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/{name}"


class Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"

    def do_HEAD(self) -> None:
        self.server.heads += 1
        self.answer(body=False)

    def do_GET(self) -> None:
        self.answer(body=True)

    def answer(self, *, body: bool) -> None:
        data = self.server.files.get(self.path.lstrip("/"))
        status = 404 if data is None else self.server.status if body else None
        if status:
            self.send_response(status)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        assert data is not None
        start, stop = 0, len(data)
        wanted = re.fullmatch(r"bytes=(\d*)-(\d*)", self.headers.get("Range", ""))
        if wanted and self.server.parts and not data:
            self.send_response(416)
            self.send_header("Content-Range", "bytes */0")
        elif wanted and self.server.parts:
            if wanted[1]:
                start, stop = int(wanted[1]), min(int(wanted[2] or len(data)) + 1, len(data))
            else:
                start = max(len(data) - int(wanted[2]), 0)
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{stop - 1}/{len(data)}")
        else:
            self.send_response(200)
        part = data[start : stop - self.server.cut] if body else data[start:stop]
        self.send_header("Content-Length", str(len(part)))
        if self.server.etags:
            self.send_header("ETag", f'"{zlib.crc32(data):08x}"')
        self.end_headers()
        if body:
            self.server.asked.append((start, len(part)))
            with suppress(BrokenPipeError, ConnectionResetError):  # a client that needs no more
                self.wfile.write(part)

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def serving(files: dict[str, bytes], *, parts: bool = True) -> Iterator[Server]:
    server = Server(files, parts=parts)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
