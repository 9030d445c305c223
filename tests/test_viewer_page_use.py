"""The page of the viewer in use: what it shows equals what hapfmt reads, by pointer and by keys."""

from __future__ import annotations

import base64
import random
import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import exported, served
from commands import run
from spec import ROOT

import hapfmt
from hapfmt import Calibration, Channel, Event, Recording, Span
from hapfmt.reading.damage import WORDS
from hapfmt.reading.verifier import verify
from hapfmt.viewer.bundle import VIEWER

pytestmark = pytest.mark.deep

VECTORS = ROOT / "conformance" / "vectors"
SETS = ("valid", "uncommon", "future", "invalid", "recoverable", "limits")
SAMPLED = 12
"""Files of each set of vectors that are opened."""

SETTLE = """async () => {
  for (let quiet = 0; quiet < 3;) {
    await new Promise((done) => setTimeout(done, 30));
    quiet = window.hapf.idle ? quiet + 1 : 0;
  }
}"""


def settle(page: Any) -> None:
    """Until nothing is on its way from the worker. The policy of the page forbids wait_for_function."""
    page.evaluate(SETTLE)
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def state(page: Any, *names: str) -> Any:
    found = page.evaluate("names => names.map((name) => window.hapf.state[name])", names)
    return found if len(names) > 1 else found[0]


def lanes(page: Any) -> list[str]:
    return list(page.evaluate("window.hapf.state.lanes.map(({ name }) => name)"))


@contextmanager
def shown(
    chromium: Any, files: Path | list[Path], hash_: str = "", **options: Any
) -> Iterator[Any]:
    paths = files if isinstance(files, list) else [files]
    options.setdefault("viewport", {"width": 1280, "height": 800})
    with served(chromium, paths, hash_, **options) as seen:
        settle(seen.page)
        yield seen.page


def rough(count: int, rate: float, seed: int = 1) -> np.ndarray[Any, Any]:
    noise = np.random.default_rng(seed).standard_normal(count)
    return np.round(1000 * (np.sin(np.arange(count) / rate * 9) + 0.1 * noise)) / 1000


@pytest.fixture(scope="module")
def touch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Gaps, three rates, events, an epoch."""
    path = tmp_path_factory.mktemp("viewer") / "touch.hapf"
    spans = (Span(0, 1000), Span(1500, 4000))
    channels = (
        Channel(stored=rough(3500, 1000), rate=1000, coverage=spans, label="grip", unit="N"),
        Channel(stored=rough(32000, 8000, 2), rate=8000, label="tip", unit="m/s2", device="pen"),
        Channel(stored=rough(400, 100, 3), rate=100, label="skin", unit="Cel"),
    )
    events = (Event(Fraction(1, 2), "contact"), Event(Fraction(3), "slip", Fraction(1, 4), 0))
    recording = Recording(channels, epoch_ns=1_700_000_000_000_000_000, events=events)
    hapfmt.write(recording, path)
    return path


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """LF with knots and a deadband, and HF."""
    path = tmp_path_factory.mktemp("viewer") / "paper.hapf"
    force = Channel(stored=1 + rough(2000, 1000), rate=1000, label="force", unit="N")
    hapfmt.write(Recording((force,)), path, preset="paper")
    return path


def expected(path: Path, label: str, time: float) -> float:
    """The sample nearest to a time."""
    channel = hapfmt.read(path)[label]
    times, values = channel.times(), channel.to_numpy()
    at = int(np.argmin(np.abs(times - time)))
    return float(values[at]) if abs(times[at] - time) * channel.rate <= 0.5 else float("nan")


def samples(channel: Channel) -> dict[float, float]:
    """Value by time, without gaps."""
    pairs = zip(channel.times().tolist(), channel.to_numpy().tolist(), strict=True)
    return {time: value for time, value in pairs if not np.isnan(value)}


def table(page: Any) -> dict[str, list[float | None]]:
    """Numbers of the table of values, by channel: pointer, A, B and B - A."""
    rows = page.locator("#panel-values [data-lane]")
    found = {}
    for row in rows.all():
        name = row.get_by_role("rowheader").inner_text()
        cells = row.get_by_role("cell").all()[1:]
        values = [cell.get_attribute("data-value") for cell in cells]
        found[name] = [None if value is None else float(value) for value in values]
    return found


def test_values_equal_those_of_hapfmt(chromium: Any, touch: Path, paper: Path) -> None:
    chosen = random.Random(5)
    for path, names in ((touch, ("grip", "tip", "skin")), (paper, ("force",))):
        for _ in range(4):
            a, b = (round(chosen.uniform(0, 1.99), 4) + 0.00003 for _ in range(2))
            with shown(chromium, path, f"#a={a}&b={b}") as page:
                found = table(page)
                assert sorted(found) == sorted(names)
                for name, (_, at_a, at_b, difference) in found.items():
                    want = expected(path, name, a), expected(path, name, b)
                    assert np.array_equal([at_a, at_b], want, equal_nan=True), (name, a, b)
                    assert np.array_equal([difference], [want[1] - want[0]], equal_nan=True)


def test_a_gap_has_no_value(chromium: Any, touch: Path) -> None:
    with shown(chromium, touch, "#a=1.25") as page:
        assert np.isnan(table(page)["grip"][1])  # type: ignore[arg-type]
        assert page.locator(".reading").first.inner_text() == "– N"


def test_single_samples(chromium: Any, touch: Path) -> None:
    """All samples in sight, each at its time, with their numbers."""
    with shown(chromium, touch, "#t=0.99,1.005") as page:
        for i, name in enumerate(("grip", "tip", "skin")):
            found = page.evaluate(
                "i => { const { app, state } = window.hapf; const lane = state.lanes[i];"
                " const { kind, time, min, max } = app.signals.get(lane, 'sum');"
                " return { kind, time: [...time], min: [...min], max: [...max] }; }",
                i,
            )
            assert found["kind"] == "samples" and found["min"] == pytest.approx(
                found["max"], nan_ok=True, abs=0
            )
            channel = hapfmt.read(touch)[name]
            known = samples(channel)
            drawn = {
                t: v for t, v in zip(found["time"], found["min"], strict=True) if not np.isnan(v)
            }
            assert drawn.items() <= known.items()
            assert {t for t in known if 0.99 <= t <= 1.005} <= drawn.keys()
        ticks = page.evaluate("window.hapf.app.axis.ticks().map(({ time, text }) => [time, text])")
        assert ticks and all(text.endswith(f"#{round(time * 1000)}") for time, text in ticks)


def test_zooming_in_ends_at_samples(chromium: Any, touch: Path) -> None:
    with shown(chromium, touch) as page:
        for _ in range(80):
            page.keyboard.press("+")
        settle(page)
        t0, t1 = state(page, "t0", "t1")
        assert 0 < t1 - t0 < 1e-6
        page.keyboard.press("0")
        assert state(page, "t0") < 0 and state(page, "t1") > 4


def test_bands(chromium: Any, paper: Path) -> None:
    known = samples(hapfmt.read(paper, band="lf")["force"])
    with shown(chromium, paper, "#t=0.4,0.5&band=lf&knots=1&deadband=1") as page:
        found = page.evaluate(
            "(() => { const { app, state } = window.hapf;"
            " const { time, min } = app.signals.get(state.lanes[0], 'lf');"
            " const knots = app.signals.get(state.lanes[0], 'knots');"
            " return { time: [...time], min: [...min], knots: [...knots.time] }; })()"
        )
        assert dict(zip(found["time"], found["min"], strict=True)).items() <= known.items()
        assert found["knots"] and set(found["knots"]) <= known.keys()
        page.get_by_role("button", name="HF").click()
        page.keyboard.press("2")
        assert state(page, "bands") == ["hf"]
        page.keyboard.press("3")
        assert state(page, "bands") == ["hf"]  # one of them remains


def test_filter(chromium: Any, touch: Path) -> None:
    with shown(chromium, touch) as page:
        page.keyboard.press("/")
        page.keyboard.type("pen m/s")
        assert lanes(page) == ["tip"]
        options = page.get_by_role("listbox", name="Channels").get_by_role("option")
        assert options.count() == 1
        page.keyboard.type("xyz")
        assert page.locator("#empty").inner_text() == "No channel matches the filter."
        page.keyboard.press("Escape")
        page.get_by_role("searchbox").fill("")
        assert lanes(page) == ["grip", "tip", "skin"]
        page.get_by_role("button", name="None").click()
        assert page.locator("#empty").is_visible()
        options.nth(1).locator(".box").click()
        assert lanes(page) == ["tip"]


def test_keyboard(chromium: Any, touch: Path) -> None:
    """Every view and panel by keys alone."""
    with shown(chromium, touch, "#t=1,2") as page:
        page.keyboard.press("ArrowRight")
        assert state(page, "t0", "t1") == pytest.approx([1.1, 2.1])
        page.keyboard.press("Shift+ArrowLeft")
        assert state(page, "t0", "t1") == pytest.approx([0.1, 1.1])
        page.keyboard.press("-")
        assert state(page, "t1") - state(page, "t0") == pytest.approx(1 / 0.7)
        page.keyboard.press("n")
        assert np.mean(state(page, "t0", "t1")) == pytest.approx(3.125)
        page.keyboard.press("p")
        assert np.mean(state(page, "t0", "t1")) == pytest.approx(0.5)
        page.keyboard.press("m")
        assert state(page, "mode") == "overlaid"
        page.keyboard.press("ArrowDown")
        assert state(page, "focus") == "0:1"
        page.keyboard.press("a")
        a = state(page, "a")
        page.keyboard.press(".")
        page.keyboard.press("Shift+.")
        assert state(page, "a") == pytest.approx(a + 11 / 8000, abs=1 / 8000)
        page.keyboard.press("b")
        page.keyboard.press("Shift+,")
        page.keyboard.press("s")
        assert page.evaluate("window.hapf.app.selection.range") == sorted(state(page, "a", "b"))
        page.keyboard.press("z")
        assert state(page, "t1") - state(page, "t0") < 0.1
        page.keyboard.press("x")
        assert state(page, "a", "b") == [None, None]
        page.keyboard.press("?")
        help_ = page.get_by_role("dialog", name="Keys and pointer")
        assert help_.is_visible()
        page.keyboard.press("Escape")
        assert not help_.is_visible()
        page.keyboard.press("i")
        settle(page)
        assert not page.locator("#panel-values").is_visible()


def test_tab_reaches_every_control(chromium: Any, touch: Path) -> None:
    with shown(chromium, touch) as page:
        reached = []
        for _ in range(60):
            page.keyboard.press("Tab")
            name = page.evaluate(
                "document.activeElement.getAttribute('aria-label') ?? document.activeElement.textContent"
            )
            reached.append(name)
        for wanted in ("Stacked", "Open", "?", "Filter channels by text", "Channels", "Values"):
            assert wanted in reached
        nameless = page.evaluate(
            "[...document.querySelectorAll('button, input, [role], [tabindex]')].filter((e) =>"
            " e.tabIndex >= 0 && !e.getAttribute('aria-label') && !e.textContent.trim()).length"
        )
        assert nameless == 0


def area(page: Any) -> tuple[float, float, float, float]:
    """The charts: left, top, width, height of what is drawn."""
    box = page.locator("#panels").bounding_box()
    return box["x"] + 78, box["y"], page.evaluate("window.hapf.app.panels.plotWidth"), box["height"]


def test_pointer(chromium: Any, touch: Path) -> None:
    with shown(chromium, touch) as page:
        left, top, width, height = area(page)
        x, y = left + width / 4, top + height / 2
        page.mouse.move(x, y)
        before = page.evaluate("x => window.hapf.app.panels.timeAt(x)", x)
        page.mouse.wheel(0, -400)
        settle(page)
        after = page.evaluate("x => window.hapf.app.panels.timeAt(x)", x)
        assert after == pytest.approx(before)
        t0, t1 = state(page, "t0", "t1")
        assert t1 - t0 < 3
        page.mouse.down()
        page.mouse.move(x + 100, y, steps=5)
        page.mouse.up()
        assert state(page, "t0") == pytest.approx(t0 - 100 * (t1 - t0) / width)
        settle(page)
        page.keyboard.down("Shift")
        page.mouse.down()
        page.mouse.move(x + 250, y, steps=5)
        page.mouse.up()
        page.keyboard.up("Shift")
        start, stop = page.evaluate("window.hapf.app.selection.range")
        assert stop - start == pytest.approx(150 * (t1 - t0) / width, rel=1e-3)
        page.mouse.dblclick(x, y)
        assert state(page, "moved") is False
        page.mouse.click(x, y)
        page.mouse.click(x + 200, y)
        a, b = state(page, "a", "b")
        settle(page)
        assert table(page)["tip"][1:3] == [expected(touch, "tip", a), expected(touch, "tip", b)]
        assert table(page)["tip"][0] == expected(touch, "tip", state(page, "hover"))


def test_pinch(chromium: Any, touch: Path) -> None:
    """The times under two fingers stay under them."""
    with shown(chromium, touch, has_touch=True) as page:
        left, top, _, height = area(page)
        y = top + height / 2
        device = page.context.new_cdp_session(page)

        def fingers(kind: str, *places: float) -> None:
            points = [{"x": left + x, "y": y, "id": i} for i, x in enumerate(places)]
            device.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        time = "x => window.hapf.app.panels.timeAt(x)"
        held = [page.evaluate(time, left + x) for x in (300, 400)]
        fingers("touchStart", 300, 400)
        for i in range(1, 11):
            fingers("touchMove", 300 - 10 * i, 400 + 10 * i)
        fingers("touchEnd")
        assert [page.evaluate(time, left + x) for x in (200, 500)] == pytest.approx(held, abs=1e-3)
        assert state(page, "a") is None


def test_state_in_the_address(chromium: Any, touch: Path) -> None:
    names = ("mode", "bands", "theme", "fit", "a", "b", "focus", "filter", "tab")
    with shown(chromium, touch) as page:
        page.get_by_role("listbox", name="Channels").locator(".box").nth(2).click()
        for key in ("m", "t", "y", "+", "ArrowRight", "a", "ArrowRight", "b", "s", "ArrowDown"):
            page.keyboard.press(key)
        page.get_by_role("tab", name="Events").click()
        page.get_by_role("searchbox").fill("i")
        page.wait_for_timeout(500)
        before = [state(page, *names), lanes(page)]
        view = state(page, "t0", "t1")
        selected = page.evaluate("window.hapf.app.selection.range")
        page.reload()
        page.evaluate("window.hapf.ready")
        settle(page)
        assert [state(page, *names), lanes(page)] == before
        assert state(page, "t0", "t1") == pytest.approx(view)
        assert page.evaluate("window.hapf.app.selection.range") == selected
        assert page.locator("html").get_attribute("data-theme") == "dark"


@pytest.mark.parametrize(
    "text",
    ["t=1", "t=2,1&a=x", "ch=9-1,,;7&band=&mode=sideways", "t=NaN,Infinity&height=-1&ch=1e9-2e9",
     "t=-1e300,1e300&a=1e308&b=-1e308&sel=0,1e308", "tab=../x&filter=%E2%98%83&theme=<b>"],
)  # fmt: skip
def test_an_odd_address_does_no_harm(chromium: Any, touch: Path, text: str) -> None:
    with shown(chromium, touch, f"#{text}") as page:
        t0, t1 = state(page, "t0", "t1")
        assert t1 > t0
        page.keyboard.press("+")
        settle(page)


def drop(page: Any, files: list[tuple[str, bytes]], zone: int | None = None) -> None:
    """As a browser tells of files dragged over the page and let go there."""
    coded = [(name, base64.b64encode(data).decode("ascii")) for name, data in files]
    page.evaluate(
        """async ([files, zone]) => {
          const dataTransfer = new DataTransfer();
          for (const [name, text] of files) {
            const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
            dataTransfer.items.add(new File([bytes], name));
          }
          const tell = (target, kind) => target.dispatchEvent(
            new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true }));
          tell(document.body, 'dragover');
          tell(zone === null ? document.body : document.querySelectorAll('.zone')[zone], 'drop');
        }""",
        [coded, zone],
    )
    settle(page)


def test_drop(chromium: Any, touch: Path, paper: Path) -> None:
    with shown(chromium, touch) as page:
        drop(page, [("paper.hapf", paper.read_bytes())], 0)
        assert lanes(page) == ["grip", "tip", "skin", "force"]
        assert page.get_by_role("heading", level=1).all_inner_texts() == [
            "touch.hapf", "paper.hapf",
        ]  # fmt: skip
        drop(page, [("other.hapf", paper.read_bytes()), ("touch.hapf", touch.read_bytes())], 1)
        assert lanes(page) == ["force", "grip", "tip", "skin"]
        page.evaluate("window.hapf.state.set({ a: 0.5 })")
        settle(page)
        assert table(page)["touch.hapf: skin"][1] == expected(touch, "skin", 0.5)


def test_files_by_epoch_or_start(chromium: Any, touch: Path, tmp_path: Path) -> None:
    later = tmp_path / "later.hapf"
    channel = Channel(stored=rough(1000, 1000), rate=1000, label="late", unit="N")
    hapfmt.write(Recording((channel,), epoch_ns=1_700_000_002_500_000_000), later)
    with shown(chromium, [touch, later], "#a=2.75") as page:
        assert state(page, "start", "stop") == pytest.approx([0, 4])
        assert table(page)["later.hapf: late"][1] == expected(later, "late", 0.25)
        page.keyboard.press("e")
        settle(page)
        assert np.isnan(table(page)["later.hapf: late"][1])  # type: ignore[arg-type]


def test_events_and_damage(chromium: Any, touch: Path) -> None:
    with shown(chromium, touch) as page:
        flags = page.get_by_role("toolbar", name="Events and damage in sight").get_by_role("button")
        assert flags.all_inner_texts() == ["contact", "slip"]
        flags.nth(1).hover()
        assert "slip" in page.get_by_role("tooltip").inner_text()
        assert "grip" in page.get_by_role("tooltip").inner_text()
        flags.nth(1).click()
        assert np.mean(state(page, "t0", "t1")) == pytest.approx(3.125)
    damaged = VECTORS / "recoverable" / "clusters-swapped-and-damaged.hapf"
    with shown(chromium, damaged, "#tab=damage") as page:
        rows = page.get_by_role("listbox", name="Damage").get_by_role("option")
        texts = rows.all_inner_texts()
        assert any("CHK-003" in text for text in texts)
        packet = next(i for i, text in enumerate(texts) if "damaged packets" in text)
        rows.nth(packet).click()
        t0, t1 = state(page, "t0", "t1")
        assert t0 < 0.008 and t1 > 0.012 and t1 - t0 < 0.009
        assert "DAT-004" in page.locator(".flag.damage").first.get_attribute("aria-label")
        page.get_by_role("button", name="Check whole files").click()
        settle(page)
        assert page.locator(".damage .said").inner_text().startswith(f"{damaged.name}: damaged, ")


def test_each_tab_opens(chromium: Any, touch: Path, paper: Path) -> None:
    """Without an error of the page, which ``served`` reports."""
    with shown(chromium, [touch, paper]) as page:
        tabs = page.get_by_role("tab")
        assert tabs.count() == 9
        for tab in tabs.all():
            tab.click()
            settle(page)
            panel = page.locator(f"#{tab.get_attribute('aria-controls')}")
            assert panel.is_visible() and panel.inner_text()


def flipped(path: Path, folder: Path) -> Path:
    """Two packets of different channels are damaged, in a recording of two packets a channel."""
    data = bytearray(path.read_bytes())
    for share in (0.25, 0.75):
        data[int(share * len(data))] ^= 255
    found = folder / "flipped.hapf"
    found.write_bytes(data)
    return found


def test_a_small_file_is_checked_at_once(chromium: Any, touch: Path, tmp_path: Path) -> None:
    damaged = flipped(touch, tmp_path)
    with shown(chromium, [touch, damaged]) as page:
        badges = page.locator(".badge").all_inner_texts()
        assert badges[0] == "intact" and badges[1].startswith("damaged, ")
        marks = "window.hapf.state.marks.damage.list.map(({ time0, time1 }) => [time0, time1])"
        found = page.evaluate(marks)
        assert found
        for time0, time1 in found:
            page.keyboard.press("]")
            t0, t1 = state(page, "t0", "t1")
            assert t0 <= time0 and t1 >= time1
            assert state(page, "visited")["mark"]["time0"] == time0
        assert state(page, "focus").startswith("1:")


def test_the_strip_has_the_scale_of_the_charts(chromium: Any, touch: Path) -> None:
    with shown(chromium, touch) as page:
        window = page.locator("#strip .window").bounding_box()
        plot = page.evaluate("window.hapf.app.panels.plotWidth")
        assert window["width"] == pytest.approx(plot, abs=1)
        assert page.locator(".strip-name").inner_text() == "grip"


def test_the_button_of_the_theme_says_what_it_does(chromium: Any, touch: Path) -> None:
    with shown(chromium, touch, color_scheme="light") as page:
        for text, name in (("Dark", "dark"), ("Light", "light"), ("Dark", "dark")):
            page.get_by_role("button", name=text, exact=True).click()
            assert page.evaluate("document.documentElement.dataset.theme") == name


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "x.hapf is not a hapf file: it is empty."),
        (b"PK\3\4 of another format", "x.hapf is not a hapf file"),
        (b"\0" * 5000, "x.hapf is not a hapf file"),
        (
            (VECTORS / "future" / "major-2.hapf").read_bytes(),
            "This viewer cannot read x.hapf: major version 2 (VER-001",
        ),
    ],
)
def test_what_is_no_recording(chromium: Any, touch: Path, data: bytes, sentence: str) -> None:
    with shown(chromium, touch) as page:
        drop(page, [("x.hapf", data)], 1)
        assert page.get_by_role("alert").inner_text().startswith(sentence)
        assert page.locator("#empty").inner_text().startswith("Nothing to show.")
        drop(page, [("touch.hapf", touch.read_bytes())])
        assert lanes(page) == ["grip", "tip", "skin"]


def test_vectors_do_not_break_the_page(chromium: Any, touch: Path) -> None:
    """Hostile and damaged files: each is shown or refused in words, in any mode and at any zoom."""
    chosen = random.Random(11)
    files = [
        path
        for name in SETS
        for path in chosen.sample(sorted((VECTORS / name).glob("*.hapf")), SAMPLED)
        if path.stat().st_size < 1 << 20
    ]
    with shown(chromium, touch) as page:
        for path in files:
            drop(page, [(path.name, path.read_bytes())], 1)
            page.evaluate(
                """async () => {
                  const { app } = window.hapf;
                  app.state.set({ deadband: true, knots: true, bands: ['sum', 'lf', 'hf'] });
                  for (const mode of ['overlaid', 'stacked']) {
                    app.state.set({ mode });
                    for (let i = 0; i < 12; i++) {
                      app.zoomBy(0.3);
                      await new Promise((done) => requestAnimationFrame(done));
                    }
                    app.showAll();
                  }
                }"""
            )
            settle(page)
            told = page.get_by_role("alert").inner_text()
            assert (page.evaluate("window.hapf.recordings.length") == 1) == (not told), path.name


def test_thousands_of_channels(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "skin.hapf"
    stored = (1000 * rough(60, 100)).astype(np.int32)
    skin = [Channel(stored=stored, rate=100, label=f"taxel {i}", unit="kPa") for i in range(3000)]
    hapfmt.write(Recording(tuple(skin)), path, fast=True)
    with shown(chromium, path) as page:
        assert page.locator("canvas").count() < 30
        assert page.locator(".row").count() < 100
        page.keyboard.press("ArrowDown")
        page.locator("#panels").evaluate("panels => { panels.scrollTop = 1e9; }")
        settle(page)
        assert page.locator(".panel").last.inner_text().startswith("taxel 2999")
        assert page.locator("canvas").count() < 30
        for _ in ("overlaid", "map"):
            page.keyboard.press("m")
            settle(page)
            assert page.locator("canvas").count() < 20
        assert page.locator(".panel canvas").count() == 1


def glove(count: int, *, shift: float = 0, gain: float = 1) -> Recording:
    """Joints that move one after the other, and forces with a unit of their own."""
    times = np.arange(2000) / 200
    stored = np.round(1000 * gain * np.sin(times[None] + np.arange(count)[:, None]) + shift)
    return Recording(
        tuple(
            Channel(
                stored=values.astype(np.int32), rate=200, label=f"joint {i} of the left hand",
                unit="rad" if i % 2 else "{raw}",
            )
            for i, values in enumerate(stored)
        )
    )  # fmt: skip


def whole(page: Any, selector: str) -> bool:
    """Whether no text of these elements is cut."""
    return bool(
        page.evaluate(
            "selector => [...document.querySelectorAll(selector)].every((e) =>"
            " e.scrollWidth <= e.clientWidth + 1 || getComputedStyle(e).overflowX === 'visible')",
            selector,
        )
    )


def test_22_channels_are_in_sight(chromium: Any, tmp_path: Path) -> None:
    hapfmt.write(glove(22), tmp_path / "glove.hapf")
    with shown(chromium, tmp_path / "glove.hapf") as page:
        boxes = [panel.bounding_box() for panel in page.locator(".panel").all()]
        area = page.locator("#area").bounding_box()
        assert len(boxes) == 22 and min(box["height"] for box in boxes) >= 28
        assert max(box["y"] + box["height"] for box in boxes) <= area["y"] + area["height"]
        names = page.locator(".panel .title bdi").all_inner_texts()
        assert names == [f"joint {i} of the left hand" for i in range(22)]
        assert whole(page, ".title bdi, #side .label")
        assert "{" not in page.evaluate("document.body.innerText")
        assert page.locator(".panel .title .unit").all_inner_texts()[:2] == ["raw", "rad"]


def test_long_labels_are_whole(chromium: Any, tmp_path: Path) -> None:
    label = "normal force at the distal phalanx of the right index finger"
    stored = np.arange(1000, dtype=np.int32)
    channels = (Channel(stored=stored, rate=100, label=label, unit="N"),)
    hapfmt.write(Recording(channels), tmp_path / "a.hapf")
    for width in (1280, 400):
        size = {"width": width, "height": 800}
        with shown(chromium, tmp_path / "a.hapf", "#a=2", viewport=size) as page:
            assert whole(page, "#panel-values [role=rowheader] bdi, .strip-name")
            row = page.locator("#panel-values [role=rowheader]").last
            assert row.inner_text() == label
            assert row.evaluate("e => e.scrollHeight <= e.clientHeight + 1")


def test_values_are_folded_until_there_is_a_cursor(chromium: Any, touch: Path) -> None:
    with shown(chromium, touch) as page:
        values = page.locator("#panel-values")
        assert not values.is_visible()
        page.locator("#panels").click(position={"x": 500, "y": 100})
        settle(page)
        assert values.is_visible()
        page.keyboard.press("i")
        page.keyboard.press("b")
        settle(page)
        assert not values.is_visible()  # who has hidden them does not want them


@pytest.mark.parametrize("tab", ["spectrum", "spectrogram"])
def test_a_spectrum_has_room(chromium: Any, touch: Path, tab: str) -> None:
    with shown(chromium, touch, f"#tab={tab}") as page:
        page.wait_for_timeout(500)
        settle(page)
        assert page.locator("#dock").bounding_box()["height"] == pytest.approx(0.4 * 800, abs=1)
        plots = page.locator(f"#panel-{tab} .plot:visible")
        assert plots.first.bounding_box()["height"] >= 200
        if tab == "spectrum":  # one axis for each unit
            labels = [plot.get_attribute("aria-label") for plot in plots.locator("canvas").all()]
            units = [text.split(" in ")[1].split(" by ")[0] for text in labels]
            assert units == ["N/√Hz", "m/s2/√Hz", "Cel/√Hz"]


def test_numbers_of_a_unit_have_the_same_decimals(chromium: Any, tmp_path: Path) -> None:
    fine = Calibration(1, 0, 1_000_000)
    stored = np.full(500, 105_000_000, np.int32)
    channels = (
        Channel(stored=np.full(500, 134, np.int32), rate=100, label="a", unit="Cel"),
        Channel(stored=stored, calibration=fine, rate=100, label="b", unit="Cel"),
    )
    hapfmt.write(Recording(channels), tmp_path / "a.hapf")
    with shown(chromium, tmp_path / "a.hapf", "#a=1") as page:
        cells = page.locator("#panel-values [data-value]").all_inner_texts()
        assert cells == ["134.000000", "105.000000"]
        assert page.locator(".panel .reading").all_inner_texts() == [f"{x} Cel" for x in cells]


def test_sizes_are_decimal(chromium: Any, tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(-30_000, 30_000, (1, 600_000))
    hapfmt.write(values, tmp_path / "a.hapf", rate=1000, labels=["a"])
    size = (tmp_path / "a.hapf").stat().st_size
    with shown(chromium, tmp_path / "a.hapf", "#tab=files") as page:
        text = page.evaluate("document.body.innerText")
        assert text.count(f"{size / 1e6:.3g} MB") == 2 and "iB" not in text


def test_versions_share_a_chart_with_their_difference(chromium: Any, tmp_path: Path) -> None:
    """Also of files whose starts differ."""
    one, other = tmp_path / "one.hapf", tmp_path / "other.hapf"
    hapfmt.write(glove(3), one)
    hapfmt.write(glove(2, shift=7, gain=1.01), other)
    with shown(chromium, [one, other]) as page:
        titles = page.locator(".panel .title").all_inner_texts()
        assert len(titles) == 5 and "other.hapf − one.hapf" in titles[1]
        page.evaluate("window.hapf.app.state.set({ t0: 1, t1: 1.5 })")
        settle(page)
        found = page.evaluate(
            "(() => { const { app, state } = window.hapf; const lane = state.lanes[3];"
            " const { time, min, max } = app.signals.get(lane, 'difference');"
            " const [one, other] = [state.lanes[0], lane].map((each) => app.panels.open.get('0:0').chart.colorOf({ lane: each, band: 'sum' }));"
            " return { time: [...time], min: [...min], max: [...max], one, other }; })()"
        )
        ticks = np.rint(np.array(found["time"]) * 200).astype(int)
        files = [hapfmt.read(path)[0].to_numpy() for path in (one, other)]
        assert ticks.size > 100 and found["min"] == found["max"]
        assert np.array_equal(found["min"], (files[1] - files[0])[ticks])
        assert found["one"] != found["other"]
        page.get_by_role("button", name="Compare").click()
        settle(page)
        assert page.locator(".panel").count() == 5
        assert not any("−" in text for text in page.locator(".panel .title").all_inner_texts())


def test_bins_of_a_difference_hold_its_extremes(chromium: Any, tmp_path: Path) -> None:
    one, other = tmp_path / "one.hapf", tmp_path / "other.hapf"
    values = np.random.default_rng(2).integers(-500, 500, (2, 1, 40_000))
    hapfmt.write(values[0], one, rate=1000, labels=["a"])
    hapfmt.write(values[1], other, rate=1000, labels=["a"])
    with shown(chromium, [one, other]) as page:
        low, high = page.evaluate(
            "(() => { const { app, state } = window.hapf; const { min, max } ="
            " app.signals.get(state.lanes[1], 'difference');"
            " return [Math.min(...min), Math.max(...max)]; })()"
        )
        difference = values[1] - values[0]
        assert [low, high] == [difference.min(), difference.max()]


@pytest.mark.parametrize("count", [20, 2000])
def test_a_map_of_channels(chromium: Any, tmp_path: Path, count: int) -> None:
    """Each pixel has the colour of the value of its channel at its time."""
    recording = glove(count)
    hapfmt.write(recording, tmp_path / "glove.hapf", fast=True)
    with shown(chromium, tmp_path / "glove.hapf", "#mode=map") as page:
        panels = page.locator(".panel")
        assert panels.count() == 2  # units
        legend = page.locator(".map-legend").first.inner_text()
        assert legend.split()[:2] == [str(count // 2), "channels"] and legend.endswith("raw")
        row, share = count // 4, 0.4
        pixel, wanted, name = page.evaluate(
            "([row, share]) => { const { app, state } = window.hapf;"
            " const { chart, group } = [...app.panels.open.values()][0]; const { picture } = chart;"
            " const column = Math.floor(share * picture.width);"
            " const time = state.t0 + ((column + 0.5) / picture.width) * (state.t1 - state.t0);"
            " const data = picture.getContext('2d').getImageData(column, row, 1, 1).data;"
            " return [[...data].slice(0, 3), time, group.lanes[row].name]; }",
            [row, share],
        )
        channel = recording[name]
        value = channel.to_numpy()[round(wanted * 200)]
        level = (value + 1000) / 2000
        assert pixel == pytest.approx(color_at(level), abs=6)
        box = page.locator(".map").first.bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        settle(page)
        told = page.get_by_role("tooltip").inner_text()
        assert told.startswith("joint ") and told.endswith(" raw")


def color_at(share: float) -> list[float]:
    """As spectrogram.js has it."""
    colors = np.array([[13, 22, 66], [41, 56, 104], [84, 90, 112], [126, 124, 120], [172, 158, 110],
                       [218, 196, 88], [253, 240, 160]])  # fmt: skip
    return [float(np.interp(share * 6, range(7), part)) for part in colors.T]


def test_the_command_that_recovers(chromium: Any, touch: Path, tmp_path: Path) -> None:
    """It runs as it is, and the losses are those that it prints."""
    damaged = flipped(touch, tmp_path)
    damaged = damaged.rename(tmp_path / "my 'touch'.hapf")
    with shown(chromium, damaged, "#tab=damage") as page:
        told = page.locator(".losses p").inner_text()
        command = page.locator(".losses code").inner_text()
    report = verify(damaged)
    assert report.damage
    for each in report.damage["channels"]:
        assert bool(each["lost_ticks"]) == (f"{each['label']} {each['lost_ticks']} samples" in told)
    words = shlex.split(command)
    assert words[0] == "hapfmt"
    done = run(*words[1:], cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    assert verify(tmp_path / words[-1]).verdict == "intact"


def test_the_words_for_damage_are_those_of_verify() -> None:
    text = (VIEWER / "page" / "marks.js").read_text("utf-8")
    listed = text[text.index("WORDS = {") : text.index("};")]
    found = re.findall(r"'?([a-z-]+)'?: '([^']+)'", listed)
    assert dict(found) == WORDS


def luminance(color: str) -> float:
    """WCAG 2.2, relative luminance."""
    parts = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


def contrast(one: str, other: str) -> float:
    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_light_and_dark(chromium: Any, touch: Path, scheme: str) -> None:
    """As the system says, and by the key; text has 4.5:1 against the ground, drawings 3:1 (WCAG)."""
    with shown(chromium, touch, color_scheme=scheme) as page:
        assert page.locator("html").get_attribute("data-theme") == scheme
        found = page.evaluate(
            "names => names.map((name) => getComputedStyle(document.documentElement)"
            ".getPropertyValue(`--${name}`).trim())",
            ["ground", "raised", "ink", "muted", "accent", "damage", "event", "sum", "lf", "hf"],
        )
        ground, raised, *rest = found
        for under in (ground, raised):
            assert all(contrast(color, under) >= 4.5 for color in rest[:4])
            assert all(contrast(color, under) >= 3 for color in rest)
        page.keyboard.press("m")
        settle(page)
        for i in range(8):
            color = page.evaluate(
                "i => { const { app } = window.hapf; const chart = [...app.panels.open.values()][0].chart;"
                " return chart.colorOf({ lane: { color: i } }); }",
                i,
            )
            assert contrast(color, ground) >= 3
        page.keyboard.press("t")
        assert page.locator("html").get_attribute("data-theme") != scheme


@pytest.mark.parametrize("size", [(1280, 800), (800, 600), (360, 640)])
def test_sizes(chromium: Any, touch: Path, size: tuple[int, int]) -> None:
    """Nothing is wider than the page, and a chart has its place; also after a change of the size."""
    with shown(chromium, touch, viewport={"width": size[0], "height": size[1]}) as page:
        for _ in range(2):
            wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
            box = page.locator(".panel canvas").first.bounding_box()
            assert wide <= 0 and box["width"] >= 180 and box["height"] >= 40
            assert box["x"] + box["width"] <= page.viewport_size["width"]
            page.set_viewport_size({"width": size[0] - 40, "height": size[1] - 20})
            settle(page)


def test_exported_page(chromium: Any, touch: Path, tmp_path: Path) -> None:
    with exported(chromium, [touch], tmp_path / "touch.html", offline=True) as seen:
        page = seen.page
        page.keyboard.press("a")
        settle(page)
        assert table(page)["skin"][1] == expected(touch, "skin", state(page, "a"))


def test_each_module_says_what_it_is_for() -> None:
    for path in sorted((VIEWER / "page").glob("*.js")):
        assert path.read_text("utf-8").startswith("// "), path.name
