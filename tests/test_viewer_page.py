"""The page in Chromium: served and exported, with files of any kind, it loads nothing else."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import exported, opened, served
from spec import ROOT

import hapfmt
from hapfmt.format.source import ByteSource
from hapfmt.viewer.server import ServedFile, ViewServer

pytestmark = pytest.mark.deep

EXAMPLES = sorted((ROOT / "conformance" / "examples").glob("*.hapf"))
TOUCH = ROOT / "conformance" / "examples" / "residual.hapf"
HOSTILE = "</script><script>alert(1)</script>'\"&<!--.hapf".replace("/", "∕")


def test_served(chromium: Any) -> None:
    with served(chromium, EXAMPLES) as seen:
        assert seen.page.title().endswith("hapfmt view")
        files = [url for url in seen.asked if "/files/" in url]
        assert {url.rpartition("/")[2] for url in files} == {str(i) for i in range(len(EXAMPLES))}


def test_exported(chromium: Any, tmp_path: Path) -> None:
    """From a folder, offline."""
    page = tmp_path / "page #1 100%.html"
    with exported(chromium, EXAMPLES, page, offline=True) as seen:
        seen.page.click("#tab-files")
        seen.page.locator(".files", has_text=TOUCH.name).wait_for()
        assert [url for url in seen.asked if not url.startswith(("blob:", "data:"))] == [
            page.as_uri()
        ]


def test_files_keep_their_order(chromium: Any) -> None:
    with served(chromium, EXAMPLES) as seen:
        names = seen.page.evaluate("window.hapf.recordings.map(({ name }) => name)")
        assert names == [path.name for path in EXAMPLES]


@pytest.mark.parametrize(
    "kind", ["valid", "uncommon", "limits", "recoverable", "invalid", "future"]
)
def test_files_of_the_suite(chromium: Any, kind: str) -> None:
    """Damaged and hostile ones too: each is shown, or refused with a message."""
    found = sorted((ROOT / "conformance" / "vectors" / kind).glob("*.hapf"))
    small = [path for path in found if path.stat().st_size < 200_000]
    files = random.Random(1).sample(small, min(len(small), 12))
    with served(chromium, files) as seen:
        shown = seen.page.evaluate("window.hapf.recordings.length")
        refused = seen.page.evaluate("document.querySelectorAll('#notices p').length")
        assert shown + refused == len(files)


class Growing(ServedFile):
    """Longer at each request, as one that is being recorded."""

    @contextmanager
    def opened(self) -> Iterator[ByteSource]:
        assert self.path is not None
        with Path(self.path).open("ab") as stream:
            stream.write(bytes(100))
        with super().opened() as source:
            yield source


def test_a_file_that_grows(chromium: Any, tmp_path: Path) -> None:
    """It is shown up to where it ended when it was opened."""
    path = tmp_path / "live.hapf"
    values = np.random.default_rng(1).integers(-30_000, 30_000, (1, 200_000))
    hapfmt.write(values, path, rate=1000, labels=["fx"])
    ask = "t => window.hapf.recordings[0].samples(0, t, t + 0.01).then(({ value }) => [...value])"
    with (
        ViewServer([Growing(str(path), path.name)]) as server,
        opened(chromium, server.url) as seen,
    ):
        for start in (5, 50, 100, 190):
            found = seen.page.evaluate(ask, start)
            assert found == values[0, 1000 * start : 1000 * start + 10].tolist()
        assert seen.page.evaluate("window.hapf.stats().then(([{ requests }]) => requests)") > 1


def test_the_worker_runs(chromium: Any, tmp_path: Path) -> None:
    """From its text, under the policy of the page: it fetches parts, or takes bytes."""
    ask = """source => new Promise((done, fail) => {
      const worker = new Worker(URL.createObjectURL(new Blob([globalThis.hapfWorkerCode])));
      worker.onerror = (event) => fail(event.message);
      worker.onmessage = ({ data }) => data.id && done(data.error ?? data.value);
      worker.postMessage({ id: 1, call: 'open', args: [source] });
    })"""
    data = TOUCH.read_bytes()
    with served(chromium, [TOUCH]) as seen:
        url = seen.page.evaluate("new URL('files/0', document.baseURI).href")
        facts = seen.page.evaluate(ask, {"name": "touch.hapf", "url": url})
        assert facts["size"] == len(data) and facts["channels"]
    with exported(chromium, [TOUCH], tmp_path / "page.html") as seen:
        code = ask.replace("[source]", "[{ ...source, bytes: new Uint8Array(source.bytes) }]")
        assert seen.page.evaluate(code, {"name": "touch.hapf", "bytes": list(data)}) == facts


def test_a_hostile_name(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / HOSTILE
    path.write_bytes(TOUCH.read_bytes())
    for opening in (
        served(chromium, [path]),
        exported(chromium, [path], tmp_path / "page.html"),
    ):
        with opening as seen:
            assert HOSTILE in seen.page.evaluate("document.body.innerText")
            assert seen.page.evaluate("document.scripts.length") == seen.page.evaluate(
                "document.querySelectorAll('script:not([type]), #files, [id^=data-]').length"
            )


def test_the_policy_stops_what_the_page_must_not_do(chromium: Any, tmp_path: Path) -> None:
    """It also shows that this module would notice."""
    from urllib.parse import urlsplit

    for opening, code in (
        (served(chromium, [TOUCH]), "fetch('http://127.0.0.1:9/x').catch(() => {})"),
        (served(chromium, [TOUCH]), "(document.body.innerHTML = '<img src=\"http://127.0.0.1:9/x\">', 0)"),
        (exported(chromium, [TOUCH], tmp_path / "a.html"), "fetch('file:///etc/hostname').catch(() => {})"),
    ):  # fmt: skip
        with pytest.raises(AssertionError, match="policy: "), opening as seen:
            seen.page.evaluate(code)
            seen.page.wait_for_timeout(100)
    with served(chromium, [TOUCH]) as seen:
        assert urlsplit(seen.page.url).hostname == "127.0.0.1"


def test_another_page_reads_nothing(chromium: Any) -> None:
    """One from another port, which even knows the address."""
    with (
        ViewServer([ServedFile(str(TOUCH), "touch.hapf")]) as secret,
        opened_blank(chromium) as page,
    ):
        outcome = page.evaluate(
            "url => fetch(url).then(() => 'read', () => 'refused')", f"{secret.url}files/0"
        )
        assert outcome == "refused"
        image = page.evaluate(
            "url => new Promise((done) => { const i = new Image(); i.onload = () => done('read');"
            " i.onerror = () => done('refused'); i.src = url; })",
            f"{secret.url}files/0",
        )
        assert image == "refused"
        framed = page.evaluate(
            "url => new Promise((done) => { const f = document.createElement('iframe');"
            " f.onload = () => { let ours; try { ours = f.contentDocument; } catch { ours = null; }"
            " done(ours ? 'read' : 'refused'); }; f.src = url; document.body.append(f); })",
            secret.url,
        )
        assert framed == "refused"


def opened_blank(chromium: Any) -> Any:
    """A page of another origin."""
    from server import serving

    @contextmanager
    def blank() -> Any:
        context = chromium.new_context()
        try:
            with serving({"page.html": b"<!doctype html><body>"}) as other:
                page = context.new_page()
                page.goto(other.url("page.html"))
                yield page
        finally:
            context.close()

    return blank()


def test_a_page_that_fails_is_noticed(chromium: Any) -> None:
    with (
        pytest.raises(AssertionError, match="oh no"),
        ViewServer([ServedFile(str(TOUCH), "touch.hapf")]) as server,
        opened(chromium, server.url) as seen,
    ):
        seen.page.evaluate("setTimeout(() => { throw new Error('oh no'); })")
        seen.page.wait_for_timeout(100)


def test_a_signal_of_steps_is_one_line(chromium: Any, tmp_path: Path) -> None:
    """Bins of 20 samples, most of them flat: each reaches to the one before it."""
    steps = np.repeat(np.arange(1000) * 7 % 11, 20).astype(np.int32)
    hapfmt.write(steps, tmp_path / "steps.hapf", rate=1000, labels=["fx"], units="N")
    with served(chromium, [tmp_path / "steps.hapf"]) as seen:
        while not seen.page.evaluate("window.hapf.idle"):
            seen.page.wait_for_timeout(50)
        seen.page.wait_for_timeout(200)
        columns = seen.page.evaluate("""() => {
          const canvas = document.querySelector('.uplot canvas');
          const { width, height } = canvas;
          const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);
          const drawn = [];
          for (let x = 80; x < width; x++) { // right of the labels
            for (let at = 4 * x; at < data.length; at += 4 * width) {
              if (data[at + 2] > data[at] + 60) {
                drawn.push(x);
                break;
              }
            }
          }
          return drawn;
        }""")
    assert len(columns) > 800
    assert columns == list(range(columns[0], columns[-1] + 1))
