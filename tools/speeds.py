"""Encoding and decoding time as multiples of ``flac -8`` on the same counts, in the same run.

tools/bench.py --speed, --searches, --against and --picture call this module.

CPU time of one thread, the shortest of some runs. FLAC runs before and after each of ours, and its
shortest time counts.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from installed import ROOT, environment

import numpy as np
from measured import DATA, print_table, timed, write_rows
from peers.exact import flac_decode, flac_encode, narrow, pcodec_decode, pcodec_encode
from peers.packages import installed as has
from peers.packages import module

import hapfmt
from hapfmt.lab.scenes.stylus import simulate

PRESETS: dict[str, dict[str, Any]] = {
    "lossless": {},
    "fast": {"fast": True},
    "best": {"effort": "best"},
    "near-lossless": {"preset": "near-lossless"},
    "perceptual": {"preset": "perceptual", "felt": "all"},
    "deadband": {"preset": "perceptual", "felt": "all", "texture": False},
    "paper": {"preset": "paper"},
}
DECODED = "decode"
"""The column of decoding; it is that of preset lossless."""

WANTED = {
    "lossless": 2.5, "fast": 1.2, "best": 10, "near-lossless": 5, "perceptual": 20, "deadband": 5,
    "paper": 5, DECODED: 1.3,
}  # fmt: skip
CASES = {
    "teleoperator": "teleop1dof/question1b_rigid",
    "gripper": "davinci_grip/Tool_4_Maryland_L_2_00",
    "glove": "unlicensed/cyberglove/calib_su01",
}
"""Names of recordings in the project's own data."""

SLIDE_SECONDS = 53
PRICED = 6_000
"""Samples a channel of the recordings that searches are measured on."""

WARM = 500
"""Samples a channel that are coded first."""

STEPS = ("encode", "decode")
SHOWN = 0.02
"""Percent of size below which a search has no row."""

GAIN, COST = 1.0, 10.0
"""Percent of size that a search must gain, or percent of time that it may cost."""

Cases = dict[str, hapfmt.Recording]
Times = dict[str, float]
"""By preset: the encoding time, by DECODED the decoding time, as multiples of FLAC's."""


def walks() -> hapfmt.Recording:
    """22 channels of a sine and a random walk."""
    rng = np.random.default_rng(2)
    seconds = np.arange(10_000) / 1000
    rows = (
        np.round(2000 * np.sin(seconds * (1 + i / 9)) + np.cumsum(rng.integers(-2, 3, 10_000)))
        for i in range(22)
    )
    return hapfmt.Recording(tuple(hapfmt.Channel(row.astype(np.int32), 1000) for row in rows))


def bench_day(samples: int = 240_000) -> hapfmt.Recording:
    """Two minutes of a laboratory, 30 channels at 2 kHz: 15 of counts, and the doubles that a
    program makes of counts by gains and offsets."""
    rng = np.random.default_rng(3)
    seconds = np.arange(samples) / 2000
    channels = []
    for i in range(30):
        drift = np.cumsum(rng.normal(0, 3, samples)) + rng.normal(0, 5, samples)
        row = np.clip(np.round(9000 * np.sin(seconds * (1 + i / 9)) + drift), -32768, 32767)
        gain = 20 / 65536 * (1 + i / 7)
        values = row.astype(np.int32) if i % 2 else row * gain + (i % 4) * 0.0123
        channels.append(hapfmt.Channel(values, 2000, lsb=gain))
    return hapfmt.Recording(tuple(channels))


def rows_of(recording: hapfmt.Recording) -> list[np.ndarray]:
    """Counts; those that doubles were made of."""
    return [
        np.rint(c.stored / c.lsb if c.stored.dtype.kind == "f" and c.lsb else c.stored)
        .astype(np.int64)
        for c in recording.channels
    ]  # fmt: skip


class Flac(NamedTuple):
    """Seconds and bytes of ``flac -8``, a file for each channel."""

    encode_s: float
    decode_s: float
    size: int


def run_flac(recording: hapfmt.Recording, repeats: int = 3, level: int = 8) -> Flac:
    """FLAC on all channels. Channels of more than 24 bits count for what 24 bits of them take."""
    rows = [row if np.ptp(row) < 1 << 24 else row >> 8 for row in rows_of(recording)]
    rows = [row if np.abs(row).max(initial=0) < 1 << 23 else row - row[0] for row in rows]
    found, encode_s = timed(lambda: [flac_encode(row, 8000, level) for row in rows], repeats)
    blobs = [blob for blob in found if blob is not None]
    assert len(blobs) == len(rows)
    _, decode_s = timed(lambda: [flac_decode(blob, 0) for blob in blobs], repeats)
    return Flac(encode_s, decode_s, sum(map(len, blobs)))


def file_of(recording: hapfmt.Recording, given: dict[str, Any]) -> bytes:
    stream = io.BytesIO()
    settings = hapfmt.Settings.of(**given)
    hapfmt.write(recording, stream, settings, canonical=1, threads=1)
    return stream.getvalue()


def times_of(recording: hapfmt.Recording, repeats: int) -> Times:
    file_of(shortened(recording, WARM), {})  # imports and first calls are no part of it
    out: Times = {}
    for name, given in PRESETS.items():
        with suppress(TypeError):  # an older commit has no efforts
            before = run_flac(recording, repeats)
            data, encode_s = timed(lambda g=given: file_of(recording, g), repeats)
            _, decode_s = timed(lambda d=data: hapfmt.read(d, threads=1), repeats)
            after = run_flac(recording, repeats)
            out[name] = encode_s / min(before.encode_s, after.encode_s)
            if name == "lossless":
                out[DECODED] = decode_s / min(before.decode_s, after.decode_s)
    return out


def print_times(cases: Cases, repeats: int, *, as_json: bool = False, write: bool = False) -> None:
    """The table of all presets, and the peaks of memory."""
    found = {name: times_of(recording, repeats) for name, recording in cases.items()}
    if as_json:
        print(json.dumps(found))
        return
    print("CPU time of one thread; flac -8 of the same counts is 1\n")
    columns = [*PRESETS, DECODED]
    rows: list[list[object]] = [
        [f"{name}, {cases[name].sample_count // 1000} k", *(f"{each[c]:.1f}" for c in columns)]
        for name, each in found.items()
    ]
    rows.append(["wanted", *(WANTED[c] for c in columns)])
    print_table(["recording", *columns], rows)
    if write:
        write_rows("speed", rows)
    print("most memory of a process, in MiB; of one that imports hapfmt alone\n")
    with tempfile.TemporaryDirectory() as folder:
        memory = [[name, *peaks(recording, Path(folder))] for name, recording in cases.items()]
    print_table(["recording", "import", *STEPS], memory)


PEAK = """
import sys
from pathlib import Path
import hapfmt
step, path = sys.argv[1:]
if step == "encode":
    hapfmt.write(hapfmt.read(path, threads=1), path + ".out", threads=1, force=True)
if step == "decode":
    hapfmt.read(path, threads=1)
lines = Path("/proc/self/status").read_text().splitlines()
print(next(line for line in lines if line.startswith("VmHWM")).split()[1])
"""
"""Kilobytes that a process has held at most. What getrusage says includes the parent's."""


def peaks(recording: hapfmt.Recording, folder: Path) -> Iterator[int]:
    """The most MiB of a process that only imports, and of one for each step."""
    path = folder / "one.hapf"
    path.write_bytes(file_of(recording, {"fast": True}))
    for step in ("", *STEPS):
        command = [sys.executable, "-c", PEAK, step, str(path)]
        done = subprocess.run(
            command, env=environment(), check=True, capture_output=True, text=True
        )
        yield int(done.stdout) // 1024


def print_against(commit: str, arguments: Sequence[str], cases: Cases, repeats: int) -> None:
    """The same table at another commit, installed in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), commit], check=True)
        try:
            subprocess.run([sys.executable, "-m", "venv", str(tree / ".venv")], check=True)
            python = str(tree / ".venv/bin/python")
            install = [python, "-m", "pip", "install", "--quiet", "-e", f"{tree}[bench]"]
            subprocess.run(install, check=True, stderr=subprocess.DEVNULL)
            command = ["--speed", "--json", "--repeats", str(repeats), *arguments]
            tool = str(ROOT / "tools/bench.py")
            done = subprocess.run(
                [python, tool, *command],
                check=True,
                capture_output=True,
                text=True,
                env=environment(),
            )
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)
    then: dict[str, Times] = json.loads(done.stdout.splitlines()[-1])
    print(f"CPU time of one thread; flac -8 of the same counts is 1; {commit} -> now\n")
    columns = [*PRESETS, DECODED]
    rows = []
    for name, recording in cases.items():
        now, before = times_of(recording, repeats), then[name]
        rows.append(
            [name, *(f"{before[c]:.1f} -> {now[c]:.1f}" if c in before else f"{now[c]:.1f}"
                     for c in columns)]
        )  # fmt: skip
    print_table(["recording", *columns], rows)


def kind_of(name: str) -> str:
    """The folder that a recording is from."""
    return name.rpartition("/")[0] or name


def print_searches(
    recordings: Sequence[tuple[str, hapfmt.Recording]], repeats: int, *, write: bool = False
) -> None:
    """What each search of the encoder gains in size and costs in time, preset by preset: where it
    gains most, where it costs most, and in the mean over all kinds of recordings."""
    recordings = [(name, shortened(each, PRICED)) for name, each in recordings]
    from hapfmt.encoder.effort import SEARCHES  # an older commit has none

    rows = []
    kinds = sorted({kind_of(name) for name, _ in recordings})
    for preset, given in PRESETS.items():
        searches = hapfmt.Settings.of(**given).searches
        for search in (name for name in SEARCHES if getattr(searches, name)):
            found: dict[str, tuple[float, float]] = {}
            for kind in kinds:
                members = [each for name, each in recordings if kind_of(name) == kind]
                found[kind] = price(*compared(members, given, search, repeats))
            failed = [k for k in kinds if found[k][0] < GAIN and found[k][1] > COST]
            if not failed and all(abs(size) < SHOWN for size, _ in found.values()):
                continue
            most = max(kinds, key=lambda kind: found[kind][0])
            dear = max(kinds, key=lambda kind: found[kind][1] * (found[kind][0] < GAIN))
            gain, cost = (sum(each[i] for each in found.values()) / len(found) for i in (0, 1))
            rows.append(
                [preset, search.replace("_", " "), f"{gain:.2f}", f"{cost:.0f}",
                 f"{most}: {found[most][0]:.1f} / {found[most][1]:.0f}",
                 f"{dear}: {found[dear][0]:.1f} / {found[dear][1]:.0f}", len(failed)]
            )  # fmt: skip
    print(f"percent of size that a search gains, percent of encoding time that it costs; at most "
          f"{PRICED} samples a channel\n")  # fmt: skip
    headers = ["preset", "search", "gain", "cost", "gains most (gain / cost)",
               "costs most for less than 1 %", "kinds too dear"]  # fmt: skip
    print_table(headers, rows)
    if write:
        write_rows("searches", rows)


def compared(
    recordings: Sequence[hapfmt.Recording], given: dict[str, Any], search: str, repeats: int
) -> tuple[list[tuple[int, float]], list[tuple[int, float]]]:
    """Bytes and seconds with a search, and without it, in turns."""
    from hapfmt.encoder.effort import without

    whole, other = [], []
    for recording in recordings:
        sizes, times = [0, 0], [inf, inf]
        for _ in range(repeats + 1):  # the first run is cold
            for place in (0, 1):
                with without(search) if place else nullcontext():
                    data, seconds = timed(lambda r=recording: file_of(r, given))
                sizes[place], times[place] = len(data), min(times[place], seconds)
        whole.append((sizes[0], times[0]))
        other.append((sizes[1], times[1]))
    return whole, other


def price(whole: list[tuple[int, float]], without: list[tuple[int, float]]) -> tuple[float, float]:
    """Percent of size gained, and of time spent."""
    size, seconds = (sum(each[i] for each in whole) for i in (0, 1))
    other, shorter = (sum(each[i] for each in without) for i in (0, 1))
    return 100 * (other / size - 1), 100 * (1 - shorter / seconds)


def shortened(recording: hapfmt.Recording, samples: int) -> hapfmt.Recording:
    """The first samples of each channel."""
    channels = (c.sel(stop=c.start_tick / c.rate_exact + samples / c.rate_exact)
                for c in recording.channels)  # fmt: skip
    return replace(recording, channels=tuple(channels))


class Point(NamedTuple):
    """One coder on one recording."""

    family: str
    name: str
    bits: float
    encode_ns: float
    decode_ns: float


def points_of(recording: hapfmt.Recording, repeats: int) -> Iterator[Point]:
    """Ours and the peers, in bits and nanoseconds a sample."""
    count, rows = recording.sample_count, rows_of(recording)

    def point(
        family: str, name: str, encode: Callable[[], Any], decode: Callable[[Any], object],
        size: Callable[[Any], int],
    ) -> Point:  # fmt: skip
        data, encode_s = timed(encode, repeats)
        _, decode_s = timed(lambda: decode(data), repeats)
        return Point(family, name, 8 * size(data) / count, encode_s / count * 1e9,
                     decode_s / count * 1e9)  # fmt: skip

    for name in ("fast", "lossless", "best", "near-lossless", "perceptual", "deadband", "paper"):
        given = PRESETS[name]
        lossless = "preset" not in given
        yield point(
            "hapfmt, lossless" if lossless else "hapfmt, lossy",
            "default" if name == "lossless" else name,
            lambda g=given: file_of(recording, g), lambda d: hapfmt.read(d, threads=1), len,
        )  # fmt: skip

    def all_of(code: Callable[[Any], Any]) -> Callable[[Any], list[Any]]:
        return lambda items: [code(item) for item in items]

    def total(items: list[bytes]) -> int:
        return sum(map(len, items))

    if has("soundfile"):
        for level in range(9):
            yield point(
                "FLAC", f"-{level}",
                lambda n=level: [flac_encode(row, 8000, n) for row in rows],
                all_of(lambda blob: flac_decode(blob, 0)), total,
            )  # fmt: skip
    if has("pcodec"):
        for level in (2, 4, 8, 12):
            yield point(
                "pcodec", f"-{level}",
                lambda n=level: [pcodec_encode(narrow(row, 2, 4), n) for row in rows],
                all_of(lambda blob: pcodec_decode(blob, 0)), total,
            )  # fmt: skip
    if has("zstandard"):
        zstd = module("zstandard")
        for level in (1, 3, 9, 19):
            yield point(
                "zstd of differences", f"-{level}",
                lambda n=level: [
                    zstd.ZstdCompressor(level=n).compress(np.diff(row, prepend=row[:1]).tobytes())
                    for row in (narrow(row, 2, 4) for row in rows)
                ],
                all_of(zstd.ZstdDecompressor().decompress), total,
            )  # fmt: skip
    if has("pysz"):
        yield sz3_point(rows, count, repeats)


def sz3_point(rows: list[np.ndarray], count: int, repeats: int) -> Point:
    """SZ3 with the largest error of preset near-lossless."""
    from peers.relative import sz3_decode, sz3_encode

    floats = [row.astype(np.float64) for row in rows]
    bounds = [max(0.001 * float(np.ptp(row)), 0.5) for row in floats]
    blobs, encode_s = timed(lambda: list(map(sz3_encode, floats, bounds)), repeats)
    _, decode_s = timed(
        lambda: [sz3_decode(blob, row.size) for blob, row in zip(blobs, rows, strict=True)],
        repeats,
    )
    return Point("SZ3, near-lossless", "", 8 * sum(map(len, blobs)) / count,
                 encode_s / count * 1e9, decode_s / count * 1e9)  # fmt: skip


def draw(cases: Cases, path: Path, repeats: int) -> None:
    """Size against encoding and decoding time, a row for each recording."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogFormatter

    figure = Figure(figsize=(9, 2.6 * len(cases)), layout="constrained", dpi=80)
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(cases), 2, squeeze=False, sharey="row")
    for row, (name, recording) in zip(axes, cases.items(), strict=True):
        found = list(points_of(recording, repeats))
        families = dict.fromkeys(point.family for point in found)
        for axis, which in zip(row, ("encode_ns", "decode_ns"), strict=True):
            for place, family in enumerate(families):
                members = [point for point in found if point.family == family]
                x = [getattr(point, which) for point in members]
                ours = family.startswith("hapfmt")
                axis.plot(x, [point.bits for point in members], "os^vDP"[place] + "-" * (not ours),
                          color=f"C{place}", label=family, markersize=6 if ours else 4)  # fmt: skip
                for number, point in enumerate(members) if ours else ():
                    # Names of neighbours lie above and below.
                    axis.annotate(point.name, (getattr(point, which), point.bits), fontsize=7,
                                  xytext=(4, (3, -9, 11, -17)[number % 4]),
                                  textcoords="offset points")  # fmt: skip
            axis.set_xscale("log")
            for ticks in (axis.xaxis.set_major_formatter, axis.xaxis.set_minor_formatter):
                ticks(LogFormatter(minor_thresholds=(1.5, 0.4)))
            axis.tick_params(which="both", axis="x", labelsize=8)
            axis.grid(alpha=0.3)
        row[0].set_ylabel(f"{name}\nbits a sample")
    axes[-1][0].set_xlabel("encoding, ns of CPU time a sample")
    axes[-1][1].set_xlabel("decoding, ns of CPU time a sample")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8)
    figure.savefig(path)


def cases_of(known: Sequence[tuple[str, hapfmt.Recording]], data: Path) -> Cases:
    """A stylus on a simulated texture, three recordings, walks, and counts with doubles; or all
    that are given."""
    named = dict(known)
    if data != DATA or not all(path in named for path in CASES.values()):
        return named
    slide = simulate("sand", SLIDE_SECONDS, 1, 8000)
    recorded = {name: named[path] for name, path in CASES.items()}
    return {"slide": slide, **recorded, "22 x 10 s": walks(), "counts, doubles": bench_day()}
