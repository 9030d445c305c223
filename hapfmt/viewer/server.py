"""Gives one browser on this computer the page and the bytes of its files.

The server listens on the loopback address. The path has a random token, so no other page can read
the files. Requests by another host name are refused, since any site can point its name here (DNS
rebinding).
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import socketserver
import stat
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any, BinaryIO

from ..errors import HapfmtError, ParameterError
from ..files import Closing
from ..format.extras import MEDIA_TYPE
from ..format.source import ByteSource, FileSource, is_url, open_source, source_of
from .bundle import Page, page

HOST = "127.0.0.1"
HOSTS = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?", re.I)
"""Any port: a tunnel may have another one at its other end."""
RANGE = re.compile(r"bytes=(\d{1,19})-(\d{0,19})|bytes=-(\d{1,19})")
PART = 1 << 20
"""Bytes that are read at once."""
TAGGED = 64
"""Bytes at the start of a file that tell it from another: its signature, its file id, its head."""
READ = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
NO_LINK = getattr(os, "O_NOFOLLOW", 0)
IDLE = 60
"""Seconds without a request after which a connection is closed."""


class ServedFile(Closing):
    """A file as it is at each request: longer while it is being recorded, another if it is
    replaced by one. Links are followed only at the start. ``file``: a path, a URL or a binary
    stream. ``name``: as a person knows it."""

    def __init__(self, file: str | BinaryIO, name: str) -> None:
        self.name = name
        self.kept = self.path = None
        if isinstance(file, str) and not is_url(file):
            open_regular(file).close()  # an error is reported before the page is shown
            self.path, self.place = file, os.path.realpath(file)
        else:
            self.kept = open_source(file)

    @contextmanager
    def opened(self) -> Iterator[ByteSource]:
        if self.kept is not None:
            yield self.kept
            return
        assert self.path is not None
        if os.path.realpath(self.place) != self.place:
            raise ParameterError("a link has replaced the file", path=self.path)
        source = source_of(open_regular(self.place, NO_LINK), self.path, owned=True)
        try:
            yield source
        finally:
            source.close()

    def close(self) -> None:
        if self.kept is not None:
            self.kept.close()


def open_regular(path: str, flags: int = 0) -> BinaryIO:
    """Open a regular file. ParameterError for a folder, a device or a pipe, which may never end."""
    descriptor = os.open(path, READ | flags)
    try:
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISDIR(mode):
            raise ParameterError("this is a folder, not a .hapf file", path=path)
        if not stat.S_ISREG(mode):
            raise ParameterError("not a regular file; the name - reads a pipe", path=path)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def tag_of(source: ByteSource) -> str:
    """The ETag. It stays while a file grows, and changes where another file has its name."""
    digest = hashlib.sha256(source.read_at(0, TAGGED))
    if isinstance(source, FileSource):
        found = os.fstat(source.descriptor)
        digest.update(f"{found.st_dev} {found.st_ino}".encode())
    digest.update(repr(getattr(source, "version", ())).encode())
    return f'"{digest.hexdigest()[:24]}"'


class ViewServer(Closing, socketserver.ThreadingMixIn, socketserver.TCPServer):
    """Serves ``files`` at ``url`` from its start until it is closed, in threads of its own."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = os.name != "nt"
    request_queue_size = 64

    def __init__(self, files: Sequence[ServedFile], port: int = 0) -> None:
        self.files = files
        self.page: Page = page(
            [{"name": file.name, "url": f"files/{i}"} for i, file in enumerate(files)], connect=True
        )
        self.root = f"/{secrets.token_urlsafe(24)}/"
        try:
            super().__init__((HOST, port), ViewHandler)
        except OSError as error:
            raise OSError(error.errno, error.strerror, f"port {port}") from None
        self.thread = threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.05})
        self.thread.daemon = True
        self.thread.start()

    @property
    def url(self) -> str:
        return f"http://{HOST}:{self.server_address[1]}{self.root}"

    def wait(self) -> None:
        """Until Ctrl-C, which raises KeyboardInterrupt."""
        while self.thread.is_alive():
            self.thread.join(1)

    def close(self) -> None:
        self.shutdown()
        self.server_close()
        self.thread.join()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes away ends its connection, and so does a file that fails."""
        if not isinstance(sys.exception(), (HapfmtError, OSError)):
            super().handle_error(request, client_address)

    def found(self, path: str) -> ServedFile | Page | None:
        """What a path of a request names, exactly as the page writes it."""
        root, rest = path[: len(self.root)], path[len(self.root) :]
        if not secrets.compare_digest(root.encode("latin-1"), self.root.encode("ascii")):
            return None
        if not rest:
            return self.page
        names = {f"files/{i}": file for i, file in enumerate(self.files)}
        return names.get(rest)


class ViewHandler(BaseHTTPRequestHandler):
    server: ViewServer
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "hapfmt", ""
    timeout = IDLE
    disable_nagle_algorithm = True
    """Headers and content are two packets: waiting for the first took 44 ms a request."""

    def do_GET(self) -> None:
        self.answer(content=True)

    def do_HEAD(self) -> None:
        self.answer(content=False)

    def answer(self, *, content: bool) -> None:
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or not HOSTS.fullmatch(hosts[0].strip()):
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
            return
        found = self.server.found(self.path)
        if found is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        elif isinstance(found, Page):
            self.send_page(found, content)
        else:
            self.send_file(found, content)

    def send_page(self, found: Page, content: bool) -> None:
        data = (found.before + found.after).encode("utf-8")
        policy = f"{found.policy}; frame-ancestors 'none'"
        self.send_head(HTTPStatus.OK, len(data), "text/html; charset=utf-8", policy)
        if content:
            self.wfile.write(data)

    def send_file(self, file: ServedFile, content: bool) -> None:
        with ExitStack() as stack:
            try:
                source = stack.enter_context(file.opened())
                size = source.size
                more = {"ETag": tag_of(source), "Accept-Ranges": "bytes"}
                wanted = span_of(self.headers.get("Range") if content else None, size)
                start, stop = wanted or (0, size)
                data = source.read_at(start, min(PART, stop - start)) if start < stop else b""
            except ParameterError:
                self.send_error(HTTPStatus.GONE)  # another kind of file has its name
                return
            except (HapfmtError, OSError):
                self.send_error(HTTPStatus.BAD_GATEWAY)  # it has gone, or its own server fails
                return
            status = HTTPStatus.OK
            if wanted and start < stop:
                status = HTTPStatus.PARTIAL_CONTENT
                more["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
            elif wanted:
                status = HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE
                more["Content-Range"] = f"bytes */{size}"
                stop = start
            self.send_head(status, stop - start, MEDIA_TYPE, "default-src 'none'", more)
            while content and data:
                self.wfile.write(data)
                start += len(data)
                data = source.read_at(start, min(PART, stop - start))
            if content and start < stop:
                self.close_connection = True  # the file was cut meanwhile

    def send_head(
        self,
        status: HTTPStatus,
        size: int,
        kind: str,
        policy: str,
        more: dict[str, str] | None = None,
    ) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(size),
            "Cache-Control": "no-store",
            "Content-Security-Policy": policy,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
            **(more or {}),
        }
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()

    def send_error(self, code: int, *_: Any, **__: Any) -> None:
        """An empty answer; nothing of the request is repeated."""
        self.close_connection = True
        self.send_head(HTTPStatus(code), 0, "text/plain", "default-src 'none'")

    def log_message(self, *_: object) -> None:
        pass


def span_of(text: str | None, size: int) -> tuple[int, int] | None:
    """First and last byte + 1 that a Range header wants of ``size`` bytes: none where they are not
    there. None: the whole file, since the header is missing, wrong, or wants several parts."""
    found = RANGE.fullmatch(text.strip()) if text else None
    if found is None:
        return None
    if found[3]:
        return max(size - int(found[3]), 0), size
    start = int(found[1])
    if found[2] and int(found[2]) < start:
        return None
    return start, min(int(found[2]) + 1 if found[2] else size, size)
