"""The local server: parts of the named files, for those who know the address, and nothing else."""

from __future__ import annotations

import http.client
import os
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from server import serving

from hapfmt.format.layout import SIGNATURE
from hapfmt.viewer.server import PART, ServedFile, ViewServer

DATA = SIGNATURE + bytes(range(256)) * 4


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("served") / "touch.hapf"
    path.write_bytes(DATA)
    return path


@pytest.fixture(scope="module")
def viewer(file: Path) -> Iterator[ViewServer]:
    with ViewServer([ServedFile(str(file), "touch.hapf")]) as found:
        yield found


def ask(
    viewer: ViewServer, path: str, method: str = "GET", **headers: str
) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and content; ``path`` follows the token."""
    return ask_raw(viewer, viewer.root + path, method, headers)


def ask_raw(
    viewer: ViewServer, path: str, method: str = "GET", headers: dict[str, str] | None = None
) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", viewer.server_address[1], timeout=10)
    try:
        connection.request(method, path, headers=headers or {})
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()


def test_only_this_computer_reaches_it(viewer: ViewServer) -> None:
    assert viewer.server_address[0] == "127.0.0.1"
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", viewer.url)


def test_the_page_has_its_policy(viewer: ViewServer) -> None:
    status, headers, content = ask(viewer, "")
    assert status == 200 and headers["Content-Type"] == "text/html; charset=utf-8"
    assert content == (viewer.page.before + viewer.page.after).encode()
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; ") and policy.endswith("frame-ancestors 'none'")
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-store"


def test_a_whole_file(viewer: ViewServer) -> None:
    status, headers, content = ask(viewer, "files/0")
    assert (status, content) == (200, DATA)
    assert headers["Accept-Ranges"] == "bytes" and headers["ETag"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Content-Security-Policy"] == "default-src 'none'"


numbers = st.integers(0, len(DATA) + 40)


@settings(max_examples=examples(200))
@given(
    st.one_of(
        st.tuples(numbers, numbers).map(lambda pair: f"bytes={min(pair)}-{max(pair)}"),
        numbers.map(lambda start: f"bytes={start}-"),
        numbers.map(lambda size: f"bytes=-{size}"),
    )
)
def test_any_range_is_a_slice(viewer: ViewServer, text: str) -> None:
    status, headers, content = ask(viewer, "files/0", Range=text)
    first, last = text.removeprefix("bytes=").split("-")
    if first:
        wanted = DATA[int(first) : int(last) + 1 if last else None]
        start = int(first)
    else:
        wanted = DATA[-int(last) :] if int(last) else b""
        start = len(DATA) - len(wanted)
    assert content == wanted and int(headers["Content-Length"]) == len(wanted)
    if wanted:
        assert status == 206
        assert headers["Content-Range"] == f"bytes {start}-{start + len(wanted) - 1}/{len(DATA)}"
    else:
        assert status == 416 and headers["Content-Range"] == f"bytes */{len(DATA)}"


@settings(max_examples=examples(100))
@given(
    st.one_of(
        st.sampled_from([
            "bytes=0-1,4-5", "bytes=5-4", "bytes=-", "bytes=a-b", "lines=0-4", "bytes 0-4",
            "bytes=0x0-0x4", "bytes=--4", "bytes=1 - 4", f"bytes=0-{'9' * 5000}", "",
        ]),
        st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=30),
    )
)  # fmt: skip
def test_a_range_that_is_none_gives_the_whole_file(viewer: ViewServer, text: str) -> None:
    if re.fullmatch(r"bytes=(\d+-\d*|-\d+)", text) and text != "bytes=5-4" and len(text) < 1000:
        return
    status, _, content = ask(viewer, "files/0", Range=text)
    assert (status, content) == (200, DATA)


@pytest.mark.parametrize("path", ["", "files/0"])
def test_head_has_the_same_headers(viewer: ViewServer, path: str) -> None:
    status, headers, content = ask(viewer, path, "HEAD", Range="bytes=0-3")
    _, whole, _ = ask(viewer, path)
    del headers["Date"], whole["Date"]
    assert (status, headers, content) == (200, whole, b"")


PATHS = (
    "/", "/files/0", "files/0", "*", "//", "/../", "ROOTfiles/1", "ROOTfiles/00", "ROOTfiles/0/",
    "ROOTfiles/-1", "ROOTfiles/", "ROOTfiles/../files/0", "ROOT./files/0", "ROOTfiles%2f0",
    "ROOTfiles/0?x=1", "ROOT/", "ROOTtouch.hapf", "ROOTindex.html", "ROOT../../../etc/passwd",
    "ROOTfiles/..%2f..%2fetc/passwd", "http://127.0.0.1/files/0", "/%00",
)  # fmt: skip


@pytest.mark.parametrize("path", PATHS)
def test_any_other_path_gives_nothing(viewer: ViewServer, path: str) -> None:
    status, _, content = ask_raw(viewer, path.replace("ROOT", viewer.root))
    assert (status, content) == (404, b"")


@settings(max_examples=examples(60))
@given(st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=60))
def test_a_token_cannot_be_guessed_in_part(viewer: ViewServer, text: str) -> None:
    assert ask_raw(viewer, "/" + text)[0] == 404
    assert ask_raw(viewer, viewer.root[:-2] + text + "/files/0")[0] == 404


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "10.0.0.1:80", "", "127.0.0.1:x", "localhost:80:80"])  # fmt: skip
def test_another_host_name_gives_nothing(viewer: ViewServer, host: str) -> None:
    status, _, content = ask(viewer, "files/0", Host=host)
    assert (status, content) == (421, b"")


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:9000", "127.0.0.1:9000", "[::1]:9000"])
def test_the_other_end_of_a_tunnel(viewer: ViewServer, host: str) -> None:
    assert ask(viewer, "files/0", Host=host)[0] == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PATCH", "TRACE", "CONNECT", "X"])  # fmt: skip
def test_other_methods(viewer: ViewServer, method: str) -> None:
    status, _, content = ask(viewer, "files/0", method)
    assert (status, content) == (501, b"")


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (b"GET ROOTfiles/0 HTTP/1.1\r\n\r\n", b"421"),
        (b"GET ROOTfiles/0 HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n", b"421"),
        (b"GET ROOTfiles/0 HTTP/1.0\r\n\r\n", b"421"),
        (b"GET ROOTfiles/0\r\n\r\n", b"421"),
        (b"GET ROOT\xe4\xff HTTP/1.1\r\nHost: localhost\r\n\r\n", b"404"),
        (b"nonsense\r\n\r\n", b"400"),
        (b"\x00\xff\xfe GET / HTTP/1.1\r\n\r\n", b"400"),
        (b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n", b"414"),
        (b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 200 + b"\r\n", b"431"),
    ],
)
def test_requests_that_no_browser_sends(viewer: ViewServer, request_: bytes, status: bytes) -> None:
    with socket.create_connection(viewer.server_address[:2], timeout=10) as connection:  # type: ignore[arg-type]
        connection.sendall(request_.replace(b"ROOT", viewer.root.encode()))
        answer = b""
        while more := connection.recv(1 << 16):
            answer += more
    assert DATA not in answer
    assert re.match(rb"(HTTP/1\.[01] )?" + status, answer) or not answer


def test_a_browser_that_goes_away(viewer: ViewServer, capfd: pytest.CaptureFixture[str]) -> None:
    for _ in range(3):
        with socket.create_connection(viewer.server_address[:2]) as connection:  # type: ignore[arg-type]
            connection.sendall(f"GET {viewer.root}files/0 HTTP/1.1\r\nHost: local".encode())
    assert ask(viewer, "files/0")[2] == DATA
    assert capfd.readouterr().err == ""


def test_several_requests_in_one_connection(viewer: ViewServer) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", viewer.server_address[1], timeout=10)
    for start in (0, 5, 2000, 9):
        connection.request("GET", f"{viewer.root}files/0", headers={"Range": f"bytes={start}-"})
        assert connection.getresponse().read() == DATA[start:]
    connection.close()


class TestChanges:
    """A file grows, is replaced, is cut, or goes."""

    @pytest.fixture
    def own(self, tmp_path: Path) -> Iterator[tuple[Path, ViewServer]]:
        path = tmp_path / "live.hapf"
        path.write_bytes(DATA)
        with ViewServer([ServedFile(str(path), path.name)]) as found:
            yield path, found

    def test_growth(self, own: tuple[Path, ViewServer]) -> None:
        path, viewer = own
        before = ask(viewer, "files/0", "HEAD")[1]
        with path.open("ab") as stream:
            stream.write(b"more")
        status, headers, content = ask(viewer, "files/0", Range=f"bytes={len(DATA)}-")
        assert (status, content) == (206, b"more")
        assert headers["Content-Range"].endswith(f"/{len(DATA) + 4}")
        assert headers["ETag"] == before["ETag"]

    def test_another_file_under_its_name(self, own: tuple[Path, ViewServer]) -> None:
        path, viewer = own
        before = ask(viewer, "files/0", "HEAD")[1]
        other = path.with_name("other")
        other.write_bytes(DATA)
        other.replace(path)
        assert ask(viewer, "files/0", "HEAD")[1]["ETag"] != before["ETag"]
        path.write_bytes(DATA[::-1])
        assert ask(viewer, "files/0")[2] == DATA[::-1]

    @pytest.mark.skipif(os.name == "nt", reason="links and pipes of POSIX")
    def test_a_link_or_a_pipe_under_its_name(self, own: tuple[Path, ViewServer]) -> None:
        """The server reads neither the target of a link nor a pipe without a writer."""
        path, viewer = own
        (path.parent / "secret").write_bytes(b"secret")
        for make in (lambda: path.symlink_to("secret"), lambda: os.mkfifo(path), path.mkdir):
            path.unlink()
            make()
            assert ask(viewer, "files/0")[:3:2] == (410, b"")
        path.rmdir()
        path.write_bytes(DATA)
        assert ask(viewer, "files/0")[2] == DATA
        path.parent.rename(path.parent.with_name("moved"))
        path.parent.symlink_to("moved")
        assert ask(viewer, "files/0")[:3:2] == (410, b"")

    @pytest.mark.skipif(os.name == "nt", reason="links of POSIX")
    def test_a_link_that_was_named(self, own: tuple[Path, ViewServer]) -> None:
        """It is followed once, at the start."""
        path, _ = own
        link = path.with_name("latest.hapf")
        link.symlink_to(path.name)
        with ViewServer([ServedFile(str(link), link.name)]) as viewer:
            link.unlink()
            link.symlink_to("elsewhere")
            assert ask(viewer, "files/0")[2] == DATA

    def test_cut_and_gone(self, own: tuple[Path, ViewServer]) -> None:
        path, viewer = own
        os.truncate(path, 10)
        assert ask(viewer, "files/0")[2] == DATA[:10]
        assert ask(viewer, "files/0", Range="bytes=10-")[0] == 416
        os.truncate(path, 0)
        assert ask(viewer, "files/0", Range="bytes=0-")[0] == 416
        path.unlink()
        assert ask(viewer, "files/0")[:3:2] == (502, b"")

    def test_more_than_one_reading(self, own: tuple[Path, ViewServer]) -> None:
        path, viewer = own
        large = DATA + bytes(3 * PART)
        path.write_bytes(large)
        assert ask(viewer, "files/0")[2] == large
        assert ask(viewer, "files/0", Range=f"bytes=7-{2 * PART}")[2] == large[7 : 2 * PART + 1]


def test_a_url() -> None:
    pytest.importorskip("aiohttp", reason="http needs the extra 'remote'")
    with (
        serving({"far.hapf": DATA}) as far,
        ViewServer([ServedFile(far.url("far.hapf"), "far.hapf")]) as viewer,
    ):
        status, headers, content = ask(viewer, "files/0", Range="bytes=100-199")
        assert (status, content) == (206, DATA[100:200])
        far.files["far.hapf"] = bytes(2 * len(DATA))
        assert ask(viewer, "files/0", "HEAD")[1]["ETag"] == headers["ETag"]


def test_two_viewers_have_two_tokens(viewer: ViewServer, file: Path) -> None:
    with ViewServer([ServedFile(str(file), "b")]) as other:
        assert other.root != viewer.root
        assert ask_raw(other, viewer.root)[0] == 404
    assert urlsplit(viewer.url).path == viewer.root


def test_a_port_that_is_taken(viewer: ViewServer, file: Path) -> None:
    with pytest.raises(OSError) as found:
        ViewServer([ServedFile(str(file), "b")], viewer.server_address[1])
    assert found.value.filename == f"port {viewer.server_address[1]}"


def test_its_thread_ends_with_it(file: Path) -> None:
    """A thread that goes on waits for a socket that is closed, and never rests."""
    with ServedFile(str(file), "touch.hapf") as served, ViewServer([served]) as viewer:
        assert viewer.thread.is_alive()
    assert not viewer.thread.is_alive()
