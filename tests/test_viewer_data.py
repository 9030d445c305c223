"""The data layer of the viewer, run by node: its numbers are those of hapfmt.read, whatever it fetches."""

from __future__ import annotations

import base64
import json
import random
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth import either, examples, sample
from fuzzing.mend import mend_file
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from server import serving
from spec import ROOT
from test_index import left_out

import hapfmt
from hapfmt.cli.info import channel_row
from hapfmt.reading.reader import Band
from hapfmt.reading.verifier import verify

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="needs node")

DTYPES = {"Float64Array": np.float64, "Uint8Array": np.uint8}


class ViewerError(Exception):
    """What the data layer says of a file that it cannot read."""


def unpacked(value: Any) -> Any:
    """With arrays in place of their base64."""
    if isinstance(value, dict):
        if value.keys() == {"base64", "type"}:
            return np.frombuffer(base64.b64decode(value["base64"]), DTYPES[value["type"]])
        return {key: unpacked(one) for key, one in value.items()}
    return [unpacked(one) for one in value] if isinstance(value, list) else value


class Viewer:
    """One process of node that answers requests."""

    def __init__(self) -> None:
        assert NODE
        self.process = subprocess.Popen(
            [NODE, str(ROOT / "tests" / "viewer" / "reads.mjs")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, call: str, args: Any = ()) -> Any:
        assert self.process.stdin and self.process.stdout
        self.process.stdin.write(json.dumps({"call": call, "args": args}) + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        if "error" in answer:
            error = answer["error"]
            assert error["kind"] != "internal", error["stack"]
            raise ViewerError(error["message"])
        return unpacked(answer["value"])

    def open(self, place: str | Path, kind: str = "bytes") -> Any:
        return self.ask("open", {"kind": kind, "place": str(place)})


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    one = Viewer()
    with one.process:
        yield one
    assert one.process.returncode == 0


def same(found: NDArray[np.float64], wanted: NDArray[np.float64]) -> None:
    """Bit for bit, any NaN like another."""
    assert found.dtype == wanted.dtype and found.shape == wanted.shape
    both = np.isnan(found) & np.isnan(wanted)
    assert np.array_equal(found.view(np.uint64)[~both], wanted.view(np.uint64)[~both])


BANDS: dict[str, Band] = {"sum": "full", "lf": "lf", "hf": "hf"}
BOUND = 5
"""The column of `hapfmt info` that has the error bound."""
FAR = 1e30
"""Seconds: later than any sample."""
VECTORS = ROOT / "conformance" / "vectors"


def vectors(*folders: str) -> list[tuple[str]]:
    return [
        (str(path.relative_to(VECTORS)),)
        for name in folders
        for path in sorted((VECTORS / name).glob("*.hapf"))
    ]


def seconds_of(channel: Any, first: int, stop: int) -> NDArray[np.float64]:
    rate = Fraction(channel["rateNum"], channel["rateDen"])
    return np.arange(first, stop).astype(np.float64) * rate.denominator / rate.numerator


def expected(path: Path, band: str) -> dict[int, hapfmt.Channel]:
    """The channels of a file by their numbers, as far as they are intact."""
    with hapfmt.Reader(path) as reader:
        known = [ref.number for ref in reader.channels if not ref.track.unsupported]
        recording = reader.read(known, band=BANDS[band])
        return {number: recording[place] for place, number in enumerate(known)}


def gaps_of(channel: Any, wanted: hapfmt.Channel, first: int, stop: int) -> list[list[float]]:
    edges = [first, *(tick for span in wanted.coverage for tick in (span.start, span.stop)), stop]
    pairs = [edges[i : i + 2] for i in range(0, len(edges), 2)]
    return [
        [float(seconds_of(channel, tick, tick + 1)[0]) for tick in (a, b)]
        for a, b in pairs
        if a < b
    ]


def check_samples(viewer: Viewer, path: Path, *, most: int = 1 << 20) -> None:
    """Every band of every channel of the opened file equals what hapfmt reads."""
    wanted = {band: expected(path, band) for band in BANDS}
    found = {}
    for channel in viewer.ask("facts")["channels"]:
        if not channel["unsupported"] and channel["stopTick"] - channel["firstTick"] <= most:
            for band in channel["bands"]:
                key = channel["index"], band
                found[key] = viewer.ask("samples", [channel["index"], 0, FAR, band])
    # Damage that is found on the way may change where a channel begins.
    for channel in viewer.ask("facts")["channels"]:
        first, stop = channel["firstTick"], channel["stopTick"]
        for band in channel["bands"]:
            if (channel["index"], band) in found:
                samples, own = found[channel["index"], band], wanted[band][channel["index"]]
                same(samples["value"], own.filled(first, stop))
                same(samples["time"], seconds_of(channel, first, stop))
                assert samples["gaps"] == gaps_of(channel, own, first, stop)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("viewer")


def waves(ticks: int, rate: float, channels: int) -> NDArray[np.float64]:
    """[channels, ticks]: sines with noise, on a grid of 0.01."""
    t = np.arange(ticks) / rate
    rng = np.random.default_rng(3)
    rows = [np.sin((c + 1) * t) * 900 + rng.normal(0, 4, ticks) for c in range(channels)]
    return np.round(np.stack(rows)) / 100


@pytest.fixture(scope="module")
def plain(folder: Path) -> Path:
    hapfmt.write(waves(30_000, 1000, 4), folder / "plain.hapf", rate=1000, units="N")
    return folder / "plain.hapf"


@pytest.fixture(scope="module")
def clusters(folder: Path) -> Path:
    """Many clusters of a second each, as a recorder writes them."""
    path = folder / "clusters.hapf"
    counts = np.round(waves(120_000, 1000, 8) * 100).astype(np.int32)
    step = hapfmt.Calibration(1, 0, 100)
    inputs = [hapfmt.Input(f"joint {c}", 1000, "deg", calibration=step) for c in range(8)]
    with hapfmt.Recorder(path, inputs, hapfmt.Settings(effort="fast"), cluster=1) as recorder:
        recorder.write_rows(counts.T)
    return path


@pytest.fixture(scope="module")
def mixed(folder: Path) -> Path:
    """Several rates and units, a gap, doubles without a grid, and events."""
    force = waves(8000, 1000, 1)[0]
    force[3000:3500] = np.nan
    doubles = np.random.default_rng(4).normal(0, 1, 500)
    whole = np.arange(900, dtype=np.int16) % 50
    events = [
        hapfmt.Event(Fraction(1, 3), "contact", Fraction(2), channel=0, layer="contacts"),
        hapfmt.Event(Fraction(5), "mark"),
    ]
    hapfmt.write(
        {"force": force, "doubles": doubles, "whole": whole},
        folder / "mixed.hapf",
        rate={"force": 1000, "doubles": "44100/71", "whole": 100},
        units={"force": "N", "doubles": "1", "whole": "V"},
        events=events,
    )
    return folder / "mixed.hapf"


@pytest.fixture(scope="module")
def bands(folder: Path) -> Path:
    """Forces in a slow part of knots and a texture."""
    t = np.arange(6000) / 1000
    slow = np.stack([2 + np.sin(2 * t), 1 + np.cos(3 * t)])
    fast = 0.4 * np.sin(2 * np.pi * 180 * t) * (t % 2 < 1)
    path = folder / "bands.hapf"
    hapfmt.write(slow + fast, path, rate=1000, labels=["fx", "fy"], units="N", preset="paper")
    return path


def each(viewer: Viewer, path: Path, kind: str = "bytes") -> Any:
    facts = viewer.open(path, kind)
    check_samples(viewer, path)
    return facts


@pytest.mark.parametrize("kind", ["bytes", "blob"])
def test_values_and_times_are_those_of_read(viewer: Viewer, plain: Path, kind: str) -> None:
    each(viewer, plain, kind)


def test_many_clusters(viewer: Viewer, clusters: Path) -> None:
    each(viewer, clusters)


def test_rates_gaps_and_doubles(viewer: Viewer, mixed: Path) -> None:
    facts = each(viewer, mixed)
    assert [channel["rateText"] for channel in facts["channels"]] == ["1000", "44100/71", "100"]
    assert facts["channels"][0]["unit"] == "N" and facts["start"] == 0


def test_bands_and_knots(viewer: Viewer, bands: Path) -> None:
    facts = each(viewer, bands)
    channel = facts["channels"][0]
    assert channel["bands"] == ["sum", "lf", "hf"] and channel["hasKnots"]
    knots = viewer.ask("knots", [0, 0, FAR])
    slow = hapfmt.read(bands, band="lf")[0]
    assert 2 <= knots["time"].size < 3000 and np.all(np.diff(knots["time"]) > 0)
    places = np.round(knots["time"] * 1000).astype(int) - slow.start_tick
    same(knots["value"], slow.to_numpy()[places])
    assert channel["deadband"] and channel["deadband"]["floor"] > 0


def test_events_are_those_of_read(viewer: Viewer, mixed: Path) -> None:
    viewer.open(mixed)
    with hapfmt.Reader(mixed) as reader:
        for start, stop in ((0, 100), (1, 2), (3, 4), (4, 6)):
            found = viewer.ask("events", [start, stop])
            assert [
                (event["time"], event["duration"], event["text"], event["channel"], event["kind"])
                for event in found
            ] == [
                (float(event.time), float(event.duration), event.text, event.channel, event.layer)
                for event in reader.events(start, stop)
            ]


@settings(deadline=None, max_examples=examples(100))
@given(data=st.data())
def test_any_window(data: st.DataObject, viewer: Viewer, mixed: Path, bands: Path) -> None:
    path = data.draw(st.sampled_from([mixed, bands]))
    kind = data.draw(st.sampled_from(["bytes", "blob"]))
    facts = viewer.open(path, kind)
    wanted = {band: expected(path, band) for band in BANDS}
    for _ in range(3):
        channel = data.draw(st.sampled_from(facts["channels"]))
        band = data.draw(st.sampled_from(channel["bands"]))
        times = st.floats(0, 12) | st.sampled_from([0.1, 0.3, 1.0, 2.999, 3.0, 3.5])
        start, stop = sorted([data.draw(times), data.draw(times)])
        own = wanted[band][channel["index"]]
        found = viewer.ask("samples", [channel["index"], start, stop, band])
        low = max(tick_at(start, own.rate_exact), channel["firstTick"])
        high = max(min(tick_at(stop, own.rate_exact), channel["stopTick"]), low)
        same(found["value"], own.filled(low, high))
        same(found["time"], seconds_of(channel, low, high))


def tick_at(seconds: float, rate: Fraction) -> int:
    product = Fraction(repr(seconds)) * rate
    return -(-product.numerator // product.denominator)


def brute(found: Any, own: hapfmt.Channel) -> None:
    """The lowest and highest value of each bin, by the samples of its times."""
    rate = own.rate_exact
    width = round((found["time"][1] - found["time"][0]) * float(rate))
    ticks = np.round(found["time"] * float(rate) - (width - 1) / 2).astype(int)
    values = own.filled(0, int(ticks[-1]) + width)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # bins without values
        low = np.array([np.nanmin(values[tick : tick + width]) for tick in ticks])
        high = np.array([np.nanmax(values[tick : tick + width]) for tick in ticks])
    same(found["min"], low)
    same(found["max"], high)


@pytest.mark.parametrize("band", BANDS)
def test_envelopes_of_few_samples(viewer: Viewer, bands: Path, band: str) -> None:
    facts = viewer.open(bands)
    found = viewer.ask("envelope", [[0, 1], facts["start"], facts["stop"], 100, band])
    for index in (0, 1):
        assert found[str(index)]["kind"] == "envelope" and found[str(index)]["complete"]
        brute(found[str(index)], expected(bands, band)[index])


def test_an_envelope_of_single_samples(viewer: Viewer, mixed: Path) -> None:
    viewer.open(mixed)
    found = viewer.ask("envelope", [[0], 2.99, 3.01, 100, "sum"])["0"]
    assert found["kind"] == "samples" and found["gaps"] == [[3.0, 3.01]]
    same(found["min"], expected(mixed, "sum")[0].to_numpy(2.99, 3.01))
    same(found["max"], found["min"])


@pytest.mark.parametrize("negative", [False, True])
def test_envelopes_of_pyramids(viewer: Viewer, folder: Path, negative: bool) -> None:
    path = folder / f"long-{negative}.hapf"
    counts = np.random.default_rng(5).integers(-100, 100, 400_000, dtype=np.int32)
    scale = hapfmt.Calibration(-3 if negative else 3, 5, 7)
    gap = (hapfmt.Span(0, 150_000), hapfmt.Span(150_500, 400_500))
    rows = [hapfmt.Channel(np.roll(counts, c), 1000, gap, scale, label=f"{c}") for c in range(3)]
    hapfmt.write(hapfmt.Recording(tuple(rows)), path, fast=True)
    viewer.open(path, "blob")
    first = viewer.ask("envelope", [[0, 1, 2], 0, 400.5, 300, "sum"])
    assert not first["0"]["complete"]
    found = viewer.ask("settled", [[0, 1, 2], 0, 400.5, 300, "sum"])
    for index, own in expected(path, "sum").items():
        brute(found[str(index)], own)
    assert "overview" in viewer.ask("facts")["changes"]
    decoded = viewer.ask("stats")["samplesDecoded"]
    closer = viewer.ask("envelope", [[1], 149, 153, 400, "sum"])["1"]
    assert closer["complete"] and viewer.ask("stats")["samplesDecoded"] == decoded
    brute(closer, expected(path, "sum")[1])
    assert closer["gaps"] == [[150.0, 150.5]]


def test_a_part_of_a_remote_file_takes_few_requests(viewer: Viewer, clusters: Path) -> None:
    data = clusters.read_bytes()
    with serving({"clusters.hapf": data}) as server:
        facts = viewer.open(server.url("clusters.hapf"), "url")
        assert len(server.asked) <= 3 and len(facts["channels"]) == 8
        opened = server.sent
        found = viewer.ask("samples", [1, 60, 61, "sum"])
        same(found["value"], expected(clusters, "sum")[1].to_numpy(60, 61))
        assert len(server.asked) <= 5 and server.sent - opened <= 1 << 17 < len(data)
        viewer.ask("samples", [1, 60, 61, "sum"])
        assert len(server.asked) <= 5
        stats = viewer.ask("stats")
        assert stats["requests"] == len(server.asked) and stats["bytesFetched"] == server.sent
        each(viewer, clusters, "bytes")


def test_all_of_a_remote_file(viewer: Viewer, mixed: Path, bands: Path) -> None:
    with serving({path.name: path.read_bytes() for path in (mixed, bands)}) as server:
        for path in (mixed, bands):
            viewer.open(server.url(path.name), "url")
            check_samples(viewer, path)
        assert server.sent == sum(path.stat().st_size for path in (mixed, bands))


def test_servers_that_do_not_behave(viewer: Viewer, clusters: Path) -> None:
    data = clusters.read_bytes()
    with serving({"a.hapf": data}, parts=False) as server:
        viewer.open(server.url("a.hapf"), "url")
        check_samples(viewer, clusters)
    with serving({"a.hapf": data}) as server:
        with pytest.raises(ViewerError, match="404"):
            viewer.open(server.url("b.hapf"), "url")
        viewer.open(server.url("a.hapf"), "url")
        server.files["a.hapf"] = data[:-1] + bytes([data[-1] ^ 1])
        with pytest.raises(ViewerError, match="changed"):
            viewer.ask("samples", [1, 30, 90, "sum"])
        server.cut = 1
        with pytest.raises(ViewerError):
            viewer.open(server.url("a.hapf"), "url")
    with pytest.raises(ViewerError, match="cannot be fetched"):
        viewer.open("http://127.0.0.1:1/a.hapf", "url")


def test_an_overview_shows_the_whole_at_once(viewer: Viewer, folder: Path) -> None:
    path = folder / "overview.hapf"
    rows = waves(400_000, 1000, 3)
    rows[1][100_000:180_000] = np.nan
    hapfmt.write(rows, path, rate=1000, fast=True, overview=True)
    with serving({"a.hapf": path.read_bytes()}) as server:
        assert viewer.open(server.url("a.hapf"), "url")["hasOverview"]
        found = viewer.ask("envelope", [[0, 1, 2], 0, 400, 300, "sum"])
        assert viewer.ask("stats")["samplesDecoded"] == 0
    for index, own in expected(path, "sum").items():
        shown, values = found[str(index)], own.filled(0, 400_000)
        step = (np.nanmax(values) - np.nanmin(values)) / 65534 * 1.001
        width = round((shown["time"][1] - shown["time"][0]) * 1000)
        assert shown["complete"]
        for place in range(shown["time"].size):
            part = values[place * width : (place + 1) * width]
            part = part[~np.isnan(part)]
            if not part.size:
                assert np.isnan(shown["min"][place]) and np.isnan(shown["max"][place])
                continue
            assert part.min() - step <= shown["min"][place] <= part.min()
            assert part.max() <= shown["max"][place] <= part.max() + step
    assert len(found["1"]["gaps"]) == 1 and not found["0"]["gaps"]
    # An overview that breaks a rule counts as absent.
    data = path.read_bytes()
    at = data.rindex(b"hOVW")
    path.with_name("broken.hapf").write_bytes(data[: at - 100] + b"?" + data[at - 99 :])
    viewer.open(path.with_name("broken.hapf"))
    check_samples(viewer, path)


def test_verify_and_bytes(viewer: Viewer, plain: Path, clusters: Path, folder: Path) -> None:
    viewer.open(plain, "blob")
    assert viewer.ask("verify", [])["verdict"] == "intact"
    assert viewer.ask("facts")["verdict"] == "intact"
    data = plain.read_bytes()
    assert bytes(viewer.ask("bytes", [10, 40_000])) == data[10:40_000]
    assert bytes(viewer.ask("bytes", [-5, 1e12])) == data
    data = clusters.read_bytes()
    harmed = folder / "harmed.hapf"
    harmed.write_bytes(data[:5000] + bytes([data[5000] ^ 1]) + data[5001:])
    facts = viewer.open(harmed)
    assert facts["verdict"] == "intact so far"
    checked = viewer.ask("verify", [])
    assert checked["verdict"] == "damaged" and checked["findings"]
    assert viewer.ask("damage", [])


def check_report(viewer: Viewer, path: Path) -> int:
    """The verdict, the lost ticks of each channel and the marks on it are those of ``verify``."""
    wanted = verify(path)
    try:
        facts = viewer.open(path)
        found = viewer.ask("verify", [])
    except ViewerError:
        return 0
    assert found["verdict"] == wanted.verdict, path
    if wanted.verdict != "damaged":
        return 0  # a rule that is broken in a file without damage loses nothing
    assert wanted.damage
    ticks = {each["channel"]: each["lost_ticks"] for each in wanted.damage["channels"]}
    assert {each["channel"]: each["lost_ticks"] for each in found["channels"]} == ticks, path
    lost = [span for each in wanted.damage["damages"] for span in each["lost"]]
    blamed = {number for span in [*lost, *wanted.damage["lost"]] for number in span["channels"]}
    marks = [mark for mark in viewer.ask("damage", []) if mark["time0"] is not None]
    assert {number for mark in marks for number in mark["channels"]} == blamed, path
    assert blamed <= {channel["index"] for channel in facts["channels"]}
    return len(blamed)


@pytest.mark.parametrize("name", sample(vectors("recoverable"), 12))
def test_the_losses_of_damaged_vectors(viewer: Viewer, name: str) -> None:
    check_report(viewer, VECTORS / name)


def test_no_intact_channel_is_blamed(viewer: Viewer) -> None:
    """A track is left out since another one has its channel, which is whole."""
    path = VECTORS / "recoverable" / "channel-taken-and-damage.hapf"
    assert check_report(viewer, path) == 0


def test_the_losses_of_damaged_files(
    viewer: Viewer, clusters: Path, mixed: Path, bands: Path, folder: Path
) -> None:
    """A flipped byte, a hole, a cut, blocks that change places, blocks of another file."""
    rng = random.Random(28)
    files = [path.read_bytes() for path in (clusters, mixed, bands)]
    path, blamed = folder / "lost.hapf", 0
    for i in range(examples(40)):
        data, other = rng.sample(files, 2)
        path.write_bytes(spoil(data, other, ("harm", "cut", "swap", "splice")[i % 4], rng))
        blamed += check_report(viewer, path)
    assert blamed > 10


def spoil(data: bytes, other: bytes, way: str, rng: random.Random) -> bytes:
    size = rng.choice([1, 64, 512])
    a, b = (size * rng.randrange(min(len(data), len(other)) // size) for _ in range(2))
    if way == "harm":
        return harm(data, rng)
    if way == "cut":
        return data[: a + 1]
    if way == "splice":
        return data[:a] + other[b : b + 3 * size] + data[a + 3 * size :]
    blocks = [data[at : at + size] for at in range(0, len(data), size)]
    a, b = a // size, b // size
    blocks[a], blocks[b] = blocks[b], blocks[a]
    return b"".join(blocks)


def check_bounds(viewer: Viewer, path: Path) -> set[str]:
    """Each channel has the error bound in the words of ``hapfmt info``."""
    found = {each["index"]: each["bound"] for each in viewer.open(path)["channels"]}
    with hapfmt.Reader(path) as reader:
        told = {ref.number: channel_row(ref)[BOUND] for ref in reader.channels}
    assert found == told, path
    return set(told.values())


@pytest.mark.parametrize("name", sample(vectors("valid", "uncommon", "render"), 12))
def test_the_bounds_of_vectors(viewer: Viewer, name: str) -> None:
    check_bounds(viewer, VECTORS / name)


def test_the_bounds_of_every_preset(viewer: Viewer, folder: Path) -> None:
    values = np.cumsum(np.random.default_rng(4).standard_normal((2, 4000)), 1).round(3) / 20
    path, words = folder / "bounds.hapf", set()
    for i, (unit, options) in enumerate(
        [
            ("N", {"preset": "lossless"}),
            ("{raw}", {"preset": "near-lossless"}),
            ("{count}", {"preset": "near-lossless", "max_error": "1.125e-2"}),
            ("N", {"preset": "perceptual"}),
            ("N", {"preset": "perceptual", "k": 0.1225, "vectors": ((0, 1),)}),
            ("1", {"preset": "paper"}),
            ("m/s2", {"preset": "perceptual", "synthetic_texture": True}),
        ]
    ):
        hapfmt.write(values, path, rate=2000, units=[unit] * 2, force=True, **options)
        words |= check_bounds(viewer, path)
        assert len(words) > i // 2, words
    assert {"lossless", "synthetic"} <= {word for text in words for word in text.split()}, words


def test_damage_is_a_gap_with_its_finding(viewer: Viewer, clusters: Path, folder: Path) -> None:
    data = bytearray(clusters.read_bytes())
    data[len(data) // 2] ^= 1
    harmed = folder / "harmed-cluster.hapf"
    harmed.write_bytes(data)
    assert viewer.open(harmed)["verdict"] == "intact so far"
    check_samples(viewer, harmed)
    facts = viewer.ask("facts")
    assert facts["verdict"] == "damaged" and "damage" in facts["changes"]
    with hapfmt.Reader(harmed) as reader:
        reader.read()
        lost = {(float(span.start / 1000), span.track) for span in reader.lost}
    assert lost
    found = [damage for damage in viewer.ask("damage", []) if damage["time0"] is not None]
    assert {(damage["time0"], damage["channels"][0]) for damage in found} == lost
    assert all(damage["requirement"] and damage["message"] for damage in found)


def test_a_file_that_was_not_closed(viewer: Viewer, clusters: Path, folder: Path) -> None:
    data = clusters.read_bytes()
    path = folder / "cut.hapf"
    path.write_bytes(data[: len(data) * 3 // 4])
    facts = viewer.open(path, "blob")
    assert not facts["closed"] and facts["verdict"] == "damaged"
    check_samples(viewer, path)


def test_an_index_that_leaves_out_a_chunk(viewer: Viewer, folder: Path) -> None:
    path = folder / "left-out.hapf"
    path.write_bytes(left_out())
    viewer.open(path, "blob")
    check_samples(viewer, path)


def test_requests_are_refused(viewer: Viewer, plain: Path) -> None:
    viewer.open(plain)
    for call, args in (
        ("samples", [99, 0, 1, "sum"]),
        ("samples", [0, 0, 1, "other"]),
        ("envelope", [[0], 0, 1, 1e12, "sum"]),
        ("envelope", [[0], 0, 1, 0, "sum"]),
    ):
        with pytest.raises(ViewerError):
            viewer.ask(call, args)
    assert viewer.ask("samples", [0, 5, 4, "sum"])["value"].size == 0
    assert viewer.ask("envelope", [[], 0, 1, 10, "sum"]) == {}


def test_a_dropped_request(viewer: Viewer, plain: Path) -> None:
    viewer.open(plain, "blob")
    assert viewer.ask("dropped", [0, 0, 30, "sum"]) == "AbortError"
    check_samples(viewer, plain)


@pytest.mark.parametrize("name", sample(vectors("valid", "uncommon", "render"), 8))
def test_conforming_files(viewer: Viewer, name: str) -> None:
    each(viewer, VECTORS / name)


@pytest.mark.parametrize("name", sample(vectors("recoverable"), 5))
def test_damaged_files(viewer: Viewer, name: str) -> None:
    """What hapfmt reads through the damage, or one of our errors."""
    check_or_refuse(viewer, VECTORS / name)


@pytest.mark.parametrize("name", sample(vectors("invalid", "limits", "future"), 20))
def test_files_that_break_a_rule(viewer: Viewer, name: str) -> None:
    """Each gives a value or one of our errors; where hapfmt reads all, the same."""
    check_or_refuse(viewer, VECTORS / name)


def check_or_refuse(viewer: Viewer, path: Path) -> None:
    with suppress(ViewerError):
        facts = viewer.open(path)
        viewer.ask("damage", [])
        viewer.ask("events", [0, FAR])
        every = [channel["index"] for channel in facts["channels"]]
        viewer.ask("envelope", [every, 0, facts["stop"], 50, "sum"])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                check_samples(viewer, path)
        except hapfmt.HapfmtError:
            # hapfmt gives nothing of a file that breaks a rule; the viewer what no rule concerns.
            for index in every:
                with suppress(ViewerError):
                    viewer.ask("samples", [index, 0, FAR, "sum"])


def harm(data: bytes, rng: random.Random) -> bytes:
    found = bytearray(data)
    way = rng.randrange(5)
    for _ in range(rng.choice([1, 1, 3])):
        at = rng.randrange(len(found)) if found else 0
        if way == 0:
            found[at] ^= 1 << rng.randrange(8)
        elif way == 1:
            del found[at : at + rng.randrange(1, 200)]
        elif way == 2:
            found[at:at] = rng.randbytes(rng.randrange(1, 60))
        elif way == 3:
            found[at : at + 40] = bytes(len(found[at : at + 40]))
        else:
            del found[at:]
        if not found:
            break
    return bytes(found)


def test_harmed_files_give_no_wrong_sample(
    viewer: Viewer, clusters: Path, mixed: Path, bands: Path, folder: Path
) -> None:
    rng = random.Random(11)
    sources = [clusters, mixed, bands, *(VECTORS / "valid").glob("c*.hapf")]
    path = folder / "any.hapf"
    for _ in range(examples(120)):
        path.write_bytes(harm(rng.choice(sources).read_bytes(), rng))
        check_or_refuse(viewer, path)


def test_wrong_numbers_under_right_checksums(viewer: Viewer, folder: Path) -> None:
    rng = random.Random(12)
    sources = [VECTORS / name for (name,) in vectors("valid", "uncommon", "recoverable")]
    path = folder / "mended.hapf"
    for _ in range(examples(240)):
        data = bytearray(rng.choice(sources).read_bytes()[: 1 << 14])
        for _ in range(rng.choice([1, 1, 3])):
            data[rng.randrange(len(data))] = rng.choice([0, 1, 127, 128, 255, rng.randrange(256)])
        path.write_bytes(mend_file(bytes(data)))
        check_or_refuse(viewer, path)


@either("every", 24, deep=1)
def test_inputs_that_a_fuzzer_found(viewer: Viewer, folder: Path, every: int) -> None:
    path = folder / "found.hapf"
    places = [ROOT / "tests" / "corpus" / name for name in ("file", "recovered", "edited")]
    inputs = sorted(one for place in places for one in place.iterdir())
    for one in inputs[::every]:
        path.write_bytes(mend_file(one.read_bytes()))
        check_or_refuse(viewer, path)


@pytest.mark.deep
def test_the_tool_that_measures_it_runs() -> None:
    words = [sys.executable, "tools/viewer_data.py", "--seconds", "3"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("1 s of all channels") == 3
