"""Files behind URLs: only what is needed is read, and what fails on the way is no damage."""

from __future__ import annotations

import io
import json
import sys
import zipfile
from fractions import Fraction

import forge as f
import numpy as np
import pytest
from click.testing import CliRunner
from server import serving

import hapfmt
from hapfmt.cli import cli
from hapfmt.errors import MissingExtraError, ParameterError
from hapfmt.format.cluster import Packet
from hapfmt.format.source import is_url
from hapfmt.format.track import Component, Track
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify
from hapfmt.writing.filewriter import FileWriter

fsspec = pytest.importorskip("fsspec", reason="URLs need the extra 'remote': fsspec")
pytest.importorskip("aiohttp", reason="http needs the extra 'remote': aiohttp")
remote = pytest.importorskip("hapfmt.format.source")

TRACKS, CLUSTERS, TICKS = 200, 120, 1000


@pytest.fixture(scope="module")
def wide() -> bytes:
    """200 channels at 1 kHz for two minutes: 24 MB, clusters of 200 kB."""
    out = io.BytesIO()
    writer = FileWriter(out, file_id=f.FILE_ID)
    writer.describe([
        Track(i, "full", "RAWB", Fraction(1000), i, (Component(label=f"taxel {i}"),),
              f.raw_parameters(1), count_min=-128, count_max=127)
        for i in range(TRACKS)
    ])  # fmt: skip
    noise = np.random.default_rng(1)
    for c in range(CLUSTERS):
        writer.cluster(
            Packet(i, c * TICKS, TICKS, b"\0" + noise.bytes(TICKS)) for i in range(TRACKS)
        )
    writer.close()
    return out.getvalue()


@pytest.fixture(scope="module")
def server(wide):
    with serving({"wide.hapf": wide, "small.hapf": f.minimal()}) as server:
        yield server


@pytest.fixture(autouse=True)
def fresh(request):
    if "server" in request.fixturenames:
        server = request.getfixturevalue("server")
        server.asked.clear()
        server.status, server.cut, server.heads = None, 0, 0


def size_of(data: bytes, kinds: str) -> int:
    chunks = Reader(data, scan=True).catalogue.chunks
    return sum(ref.size + f.HEADER for ref in chunks if ref.type in kinds.split())


def same(a: hapfmt.Recording, b: hapfmt.Recording) -> bool:
    pairs = zip(a.channels, b.channels, strict=True)
    return all(
        x.start_tick == y.start_tick and np.array_equal(x.stored, y.stored) for x, y in pairs
    )


class TestBytes:
    """What is read of 24 MB, and in how many requests."""

    def test_opening(self, server, wide):
        """The end, the index, the beginning with the descriptions, and their copies at the end."""
        with Reader(server.url("wide.hapf")) as reader:
            assert reader.catalogue.indexed and len(reader.channels) == TRACKS
            assert reader.duration == CLUSTERS
        needed = size_of(wide, "HEAD TRAK iNDX fOOT")
        assert server.sent <= needed + len(server.asked) * 2 * remote.BLOCK
        assert len(server.asked) <= 4

    def test_one_channel_for_one_second(self, server, wide):
        with Reader(server.url("wide.hapf")) as reader:
            opened, requests = server.sent, len(server.asked)
            found = reader.read("taxel 77", start=60, stop=61)
        assert found.channels[0].gaps == ()
        assert len(server.asked) - requests <= 2
        assert server.sent - opened <= 100_000
        expected = Reader(wide).read("taxel 77").channels[0].stored[60_000:61_000]
        assert np.array_equal(found.channels[0].stored, expected)

    def test_what_was_read_is_kept(self, server):
        with Reader(server.url("wide.hapf")) as reader:
            first = reader.read("taxel 7", start=60, stop=61)
            requests = len(server.asked)
            assert same(reader.read("taxel 7", start=60, stop=61), first)
            assert len(server.asked) == requests

    def test_all_of_it(self, server, wide):
        """More and more at once, and each byte once."""
        with Reader(server.url("wide.hapf"), scan=True) as reader:
            assert reader.findings == []
        assert len(server.asked) <= len(wide) / remote.AHEAD + 12
        assert server.sent <= len(wide) + remote.BLOCK

    def test_the_cache_is_bounded(self, server, wide):
        with Reader(server.url("wide.hapf"), scan=True) as reader:
            kept = sum(map(len, reader.source.blocks.values()))
            assert 0 < kept <= remote.CACHE < len(wide) / 4

    @pytest.mark.parametrize(
        "seed", [*range(5), *(pytest.param(seed, marks=pytest.mark.deep) for seed in range(5, 20))]
    )
    def test_any_places(self, server, wide, seed):
        draw = np.random.default_rng(seed)
        with Reader(server.url("wide.hapf")) as reader:
            for _ in range(10):
                at = int(draw.integers(0, len(wide) + 10))
                size = int(draw.integers(0, 2 ** int(draw.integers(1, 19))))
                assert reader.source.read_at(at, size) == wide[at : at + size]


def test_info_loads_no_numbers_and_reads_little(server, wide):
    found = CliRunner().invoke(cli, ["info", "--json", server.url("wide.hapf")])
    assert found.exit_code == 0
    assert json.loads(found.stdout)["file_size"] == len(wide)
    assert len(server.asked) <= 2
    assert server.sent <= 100_000 < len(wide) / 30


@pytest.mark.parametrize("verb", ["info", "verify", "du", "dump", "decode"])
def test_verbs_take_urls(server, tmp_path, verb):
    out = [str(tmp_path / "a.csv")] if verb == "decode" else []
    done = CliRunner().invoke(cli, [verb, server.url("small.hapf"), *out])
    assert done.exit_code == 0, done.output


def test_other_kinds_of_url(tmp_path):
    data = f.minimal()
    fsspec.filesystem("memory").pipe("/a.hapf", data)
    packed = tmp_path / "a.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("deep/a.hapf", data)
    (tmp_path / "a.hapf").write_bytes(data)
    for url in ("memory://a.hapf", f"zip://deep/a.hapf::{packed}", f"file://{tmp_path}/a.hapf"):
        assert verify(url).verdict == "intact"
        assert len(hapfmt.read(url, start=0, stop=1).channels) == 1


class TestChanged:
    """A file that changes while it is read is an error, never a mixture."""

    @pytest.mark.parametrize("etags", [True, False])
    def test_by_http(self, wide, etags):
        """Without an ETag or a time, the size tells."""
        other = bytearray(wide)
        other[len(wide) // 2] ^= 1
        with serving({"a.hapf": wide}) as server:
            server.etags = etags
            with Reader(server.url("a.hapf")) as reader:
                expected = reader.read("taxel 3", start=10, stop=11)
                server.files["a.hapf"] = bytes(other) if etags else wide + b"\0"
                assert same(reader.read("taxel 3", start=10, stop=11), expected)
                with pytest.raises(OSError, match=r"changed while it was read.*a.hapf"):
                    reader.read("taxel 3", start=90, stop=91)
                assert reader.findings == []
                server.files["a.hapf"] = wide[: len(wide) // 4]
                with pytest.raises(OSError, match="changed while it was read"):
                    reader.read("taxel 3", start=90, stop=91)
                server.files["a.hapf"] = wide
                reader.read("taxel 3", start=90, stop=91)

    def test_while_it_is_opened(self, wide):
        with serving({"a.hapf": wide}) as server:
            ask = server.asked.append

            def change(asked):
                ask(asked)
                server.files["a.hapf"] = wide[:-1000]

            server.asked = Watched(change)
            with pytest.raises(OSError, match="changed while it was read"):
                Reader(server.url("a.hapf"))

    def test_in_other_file_systems(self, wide):
        files = fsspec.filesystem("memory")
        files.pipe("/changing.hapf", wide)
        with Reader("memory://changing.hapf") as reader:
            reader.read("taxel 3", start=10, stop=11)
            files.pipe("/changing.hapf", wide)
            with pytest.raises(OSError, match="changed while it was read"):
                reader.read("taxel 3", start=90, stop=91)

    def test_a_copy_stays_what_it_was(self, wide):
        """simplecache:: fetches the whole file when it is opened, and nothing after that."""
        with serving({"a.hapf": wide}) as server:
            with Reader("simplecache::" + server.url("a.hapf")) as reader:
                requests = len(server.asked)
                server.files["a.hapf"] = wide[:-1000]
                found = reader.read("taxel 3", start=90, stop=91)
            assert len(server.asked) == requests
        assert same(found, Reader(wide).read("taxel 3", start=90, stop=91))

    def test_between_two_openings(self):
        """Workers open a file again: it has to be the same one."""
        xarray = pytest.importorskip("xarray", reason="needs the extra 'xarray'")
        with serving({"a.hapf": file_of(0)}) as server:
            data = xarray.open_dataset(server.url("a.hapf"))
            data.close()
            server.files["a.hapf"] = file_of(1)
            with pytest.raises(OSError, match="changed after it was opened"):
                data.load()
            data.close()

    @pytest.mark.deep
    def test_in_s3(self, wide, monkeypatch):
        pytest.importorskip("s3fs", reason="s3 needs s3fs")
        moto = pytest.importorskip("moto.server", reason="the server of S3 is moto's")
        server = moto.ThreadedMotoServer(port=0, verbose=False)
        server.start()
        try:
            address, port = server.get_host_and_port()
            for name, value in (
                ("AWS_ENDPOINT_URL", f"http://{address}:{port}"),
                ("AWS_ACCESS_KEY_ID", "me"),
                ("AWS_SECRET_ACCESS_KEY", "me"),
                ("AWS_DEFAULT_REGION", "us-east-1"),
            ):
                monkeypatch.setenv(name, value)
            files = fsspec.filesystem("s3", skip_instance_cache=True)
            files.mkdir("touch")
            files.pipe("touch/a.hapf", wide)
            with Reader("s3://touch/a.hapf") as reader:
                found = reader.read("taxel 3", start=10, stop=11)
                assert same(found, Reader(wide).read("taxel 3", start=10, stop=11))
                other = bytearray(wide)
                other[len(wide) // 2] ^= 1
                files.pipe("touch/a.hapf", bytes(other))
                with pytest.raises(OSError, match="changed while it was read"):
                    reader.read("taxel 3", start=90, stop=91)
                assert reader.findings == []
            with pytest.raises(FileNotFoundError):
                Reader("s3://touch/nothing.hapf")
        finally:
            server.stop()


class Watched(list):
    def __init__(self, change):
        super().__init__()
        self.append = change


def file_of(value: float) -> bytes:
    out = io.BytesIO()
    hapfmt.write(np.full(100, value), out, rate=100)
    return out.getvalue()


def test_an_empty_file():
    with serving({"a.hapf": b""}) as server, pytest.raises(hapfmt.FormatError):
        hapfmt.read(server.url("a.hapf"))


class TestFailures:
    """OSError with the URL; never a verdict on the file."""

    def test_not_there(self, server):
        with pytest.raises(FileNotFoundError, match="nothing"):
            Reader(server.url("nothing.hapf"))

    def test_nobody_answers(self):
        with serving({}) as gone:
            url = gone.url("a.hapf")
        with pytest.raises(OSError, match="127") as error:
            Reader(url)
        assert not isinstance(error.value, FileNotFoundError)

    @pytest.mark.parametrize("status", [403, 500, 503])
    def test_refused(self, server, status):
        server.status = status
        with pytest.raises(OSError, match=rf"{status}.*small.hapf"):
            verify(server.url("small.hapf"))

    def test_in_the_middle(self, server, wide):
        with Reader(server.url("wide.hapf")) as reader:
            server.status = 500
            with pytest.raises(OSError, match=r"500.*wide.hapf"):
                reader.read("taxel 3", start=10, stop=11)
            assert reader.findings == []
            server.status = None
            found = reader.read("taxel 3", start=10, stop=11)
        assert same(found, Reader(wide).read("taxel 3", start=10, stop=11))

    def test_less_than_was_asked_for(self, server):
        with Reader(server.url("wide.hapf")) as reader:
            server.cut = remote.BLOCK - 5
            with pytest.raises(OSError, match=r"came where.*wide.hapf"):
                reader.read("taxel 3", start=10, stop=11)
            assert reader.findings == []

    def test_more_than_was_asked_for(self, server):
        """Bytes of one block are not taken for those of the next."""
        with Reader(server.url("wide.hapf")) as reader:
            server.cut = -5
            with pytest.raises(OSError, match=r"came where.*wide.hapf"):
                reader.source.read_at(8 * remote.BLOCK - 10, 20)

    def test_the_command_line(self, server):
        server.status = 500
        done = CliRunner().invoke(cli, ["info", server.url("small.hapf")])
        assert isinstance(done.exception, OSError)

    def test_unknown_kinds(self):
        with pytest.raises(ParameterError, match="nosuch"):
            Reader("nosuch://a.hapf")

    def test_a_password_is_not_repeated(self):
        with serving({}) as server:
            url = server.url("a.hapf").replace("http://", "http://me:secret@")
            with pytest.raises(OSError, match="not found") as error:
                Reader(url)
        assert "secret" not in str(error.value)


class TestWithoutParts:
    """A server that gives whole files only."""

    def test_is_refused(self, wide):
        with serving({"a.hapf": wide}, parts=False) as server:
            with pytest.raises(OSError, match="write simplecache:: before the URL"):
                Reader(server.url("a.hapf"))
            assert server.sent <= len(wide)

    def test_is_copied_where_asked_for(self, wide):
        with serving({"a.hapf": wide}, parts=False) as server:
            expected = Reader(wide).read("taxel 3", start=10, stop=11)
            with Reader(server.url("a.hapf"), spool=True) as reader:
                assert same(reader.read("taxel 3", start=10, stop=11), expected)
            assert len(server.asked) == 1
            with Reader("simplecache::" + server.url("a.hapf")) as reader:
                assert same(reader.read("taxel 3", start=10, stop=11), expected)


def test_without_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'hapfmt\[remote\]'"):
        Reader("http://127.0.0.1/a.hapf")


@pytest.mark.parametrize(
    ("text", "expected"),
    [("http://a/b.hapf", True), ("s3://a/b", True), ("zip://a::b.zip", True), ("zip::b", True),
     ("a.hapf", False), ("./http:/a", False), ("C:\\a.hapf", False), ("a:b", False)],
)  # fmt: skip
def test_what_a_url_is(text, expected):
    assert is_url(text) == expected
