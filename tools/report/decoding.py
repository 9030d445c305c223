"""Decoding with the compiled loops and with the readable ones: same numbers, other times."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from installed import ROOT, environment

from results import mean
from simulated import drift, glove

import hapfmt
from hapfmt.encoder.settings import Tolerance
from hapfmt.kernels import compiled
from hapfmt.lab.scenes import load_scene, simulate
from report.section import COLOURS, PALE, CannotRunError, Options, Section, Table, drawn, timed

SETTINGS: dict[str, dict[str, Any]] = {
    "perceptual": {"preset": "perceptual"},
    "paper": {"preset": "paper", "floor": Tolerance(0.002, "range")},
    "perceptual, no texture": {"preset": "perceptual", "texture": False, "felt": "all"},
    "near-lossless": {"preset": "near-lossless"},
    "lossless": {"preset": "lossless"},
    "lossless fast": {"preset": "lossless", "fast": True},
}
QUICK = ("near-lossless", "lossless", "lossless fast")
SECONDS, QUICK_SECONDS = 4.0, 0.5

BENCH = ROOT / "conformance" / "adapters" / "js" / "bench.js"


class Read(NamedTuple):
    """Reading one file: median CPU seconds, quartiles, and SHA-256 of the decoded values."""

    median: float
    low: float
    high: float
    runs: int
    digest: str


def read_all(paths: Sequence[str], repeats: int) -> list[Read]:
    """Each file read whole, in this process."""
    for path in paths[:1]:
        hapfmt.read(path)  # imports are no part of it
    found = []
    for path in paths:
        recording, spread = timed(lambda path=path: hapfmt.read(path), repeats)
        digest = hashlib.sha256()
        for channel in recording.channels:
            digest.update(channel.samples().tobytes())
        found.append(Read(*spread, digest.hexdigest()))
    return found


def in_javascript(path: Path, seconds: float) -> float | None:
    node = shutil.which("node")
    if node is None:
        return None
    done = subprocess.run(
        [node, str(BENCH), str(path), str(seconds)], capture_output=True, text=True, check=True
    )
    return float(re.findall(r"([0-9.]+) million", done.stdout)[-1])


def readable(paths: Sequence[str], repeats: int) -> list[Read]:
    """The same in a process without the extension."""
    code = "import json, sys; from report.decoding import read_all; "
    code += "print(json.dumps(read_all(sys.argv[2:], int(sys.argv[1]))))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(repeats), *paths],
        env=environment(HAPFMT_PURE="1"),
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise CannotRunError(
            f"with the readable Python loops: {done.stderr.strip().splitlines()[-1]}"
        )
    return [Read(*each) for each in json.loads(done.stdout)]


def recordings(quick: bool) -> dict[str, hapfmt.Recording]:
    seconds = QUICK_SECONDS if quick else SECONDS
    found = {"sand, 1 kHz": simulate(load_scene("sand").changed(seconds=seconds))[0]}
    if not quick:
        found["sand, 8 kHz"] = simulate(load_scene("sand").changed(seconds=2, rate_hz=8000))[0]
        found["grasp"] = simulate(load_scene("grasp").changed(seconds=2))[0]
        found["wall"] = simulate(load_scene("wall").changed(seconds=seconds))[0]
        found["glove"] = glove(2.0)
        found["doubles"] = drift(2.0)
    return found


class Case(NamedTuple):
    """One file, and how it was read. javascript: million samples a second, of packets alone."""

    recording: str
    setting: str
    codecs: str
    samples: int
    seconds: float
    fast: Read
    slow: Read
    javascript: float | None = None

    @property
    def ratio(self) -> float:
        return self.slow.median / self.fast.median

    def rate(self, read: Read) -> float:
        """Million samples a second."""
        return self.samples / read.median / 1e6


def measure(options: Options, folder: Path) -> list[Case]:
    files: list[tuple[str, str, str, int, float, Path]] = []
    for name, recording in recordings(options.quick).items():
        for setting in QUICK if options.quick else SETTINGS:
            options.progress(f"{name}, {setting}")
            path = folder / f"{len(files)}.hapf"
            try:
                asked = hapfmt.Settings.of(**SETTINGS[setting])
                hapfmt.write(recording, path, asked, canonical=1)
            except hapfmt.HapfmtError as error:
                options.progress(f"left out: {error}")
                continue
            with hapfmt.Reader(path) as reader:
                codecs = " ".join(sorted({t.codec for t in reader.catalogue.tracks.values()}))
            seconds = float(recording.duration)
            files.append((name, setting, codecs, recording.sample_count, seconds, path))
    paths = [str(file[-1]) for file in files]
    fast = read_all(paths, 3 if options.quick else 9)
    options.progress("with the readable Python loops")
    slow = readable(paths, 1 if options.quick else 3)
    found = []
    for (*about, path), quickly, slowly in zip(files, fast, slow, strict=True):
        script = None
        if not options.quick:
            options.progress(f"in JavaScript: {about[0]}, {about[1]}")
            script = in_javascript(path, 0.3)
        found.append(Case(*about, quickly, slowly, script))
    return found


HEADERS = ["recording", "setting", "codecs", "samples", "compiled µs/sample", "from", "to",
           "Python µs/sample", "from", "to", "ratio", "compiled Ms/s", "Python Ms/s",
           "Python: times real time", "JavaScript Ms/s, packets", "same numbers"]  # fmt: skip


def section(options: Options) -> Section:
    if compiled is None:
        raise CannotRunError(
            "the compiled loops are not installed, so there is nothing to compare: pip install -e ."
        )
    with tempfile.TemporaryDirectory() as folder:
        cases = measure(options, Path(folder))
    rows: list[list[Any]] = []
    for case in cases:
        both = [
            1e6 * seconds / case.samples
            for read in (case.fast, case.slow)
            for seconds in (read.median, read.low, read.high)
        ]
        rows.append(
            [case.recording, case.setting, case.codecs, case.samples, *both, case.ratio,
             case.rate(case.fast), case.rate(case.slow), case.seconds / case.slow.median,
             case.javascript, case.fast.digest == case.slow.digest]
        )  # fmt: skip
    return Section(
        "Decoding with and without the compiled loops",
        text_of(cases),
        [Table("Reading a file", HEADERS, rows)],
        [picture(cases)],
        [{**case._asdict(), "fast": case.fast._asdict(), "slow": case.slow._asdict(),
          "ratio": case.ratio} for case in cases],
    )  # fmt: skip


def text_of(cases: Sequence[Case]) -> str:
    ratios = [case.ratio for case in cases]
    same = sum(case.fast.digest == case.slow.digest for case in cases)
    real = min(cases, key=lambda case: case.seconds / case.slow.median)
    least, most = min(cases, key=lambda c: c.ratio), max(cases, key=lambda c: c.ratio)
    usual = 1e6 * median(case.slow.median / case.samples for case in cases)
    scripts = [
        case.rate(case.fast) / case.javascript for case in cases if case.javascript is not None
    ]
    script = (
        f"* The second implementation, in JavaScript, decodes packets at "
        f"{1 / mean(scripts):.1f} times the rate at which the compiled loops read files. The two "
        "are not the same work: JavaScript's is wall time of decoding packets, without opening "
        "and checksums."
        if scripts
        else "* The second implementation was not measured (--quick, or node is not installed)."
    )
    return "\n\n".join([
        f"The compiled loops read a file {mean(ratios):.0f} times as fast as the readable ones "
        f"(geometric mean of {len(cases)} files; {least.ratio:.0f} to {most.ratio:.0f}), and "
        f"{'every number is the same' if same == len(cases) else f'{len(cases) - same} differ'}. "
        "The CPU time includes opening the file, checking its checksums and decoding all channels "
        "to physical values. Opening weighs most in the shortest files.",
        f"* Least speedup: {least.recording}, {least.setting} ({least.ratio:.1f}); largest: "
        f"{most.recording}, {most.setting} ({most.ratio:.0f}).\n"
        f"* The readable loops take {usual:.2g} µs per sample at the median. The slowest file, "
        f"{real.recording} with {real.setting}, is still read at "
        f"{real.seconds / real.slow.median:.1f} times real time.\n{script}",
    ])  # fmt: skip


def picture(cases: Sequence[Case]) -> Any:
    def draw(axes: Any) -> None:
        for place, case in enumerate(cases):
            axes.plot([case.rate(case.slow), case.rate(case.fast)], [place, place], "-", marker="",
                      color=PALE, linewidth=0.8, zorder=1)  # fmt: skip
        for read, marker, colour, label in (
            ("slow", "s", COLOURS[1], "readable Python loops"),
            ("fast", "o", COLOURS[0], "compiled loops"),
        ):
            rates = [case.rate(getattr(case, read)) for case in cases]
            axes.plot(rates, range(len(cases)), marker, color=colour, linestyle="none", label=label)
        scripts = [(c.javascript, i) for i, c in enumerate(cases) if c.javascript]
        if scripts:
            axes.plot(*zip(*scripts, strict=True), "x", color=COLOURS[7], linestyle="none",
                      label="JavaScript, packets")  # fmt: skip
        axes.set_xscale("log")
        axes.set_yticks(
            range(len(cases)), [f"{c.recording}: {c.setting}" for c in cases], fontsize=8
        )
        axes.set_ylim(len(cases) - 0.4, -0.6)
        axes.set_xlabel("million samples per second of CPU time")
        axes.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
        axes.figure.legend(loc="outside upper center", ncols=3)

    return drawn("Speed of reading", "Each row is one file. Further right is faster.", draw,
                 height=1.2 + 0.21 * len(cases))  # fmt: skip
