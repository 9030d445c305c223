"""Small files that ask for much, under a cap of memory: refused, or read within it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import hostile
import pytest
from depth import PROFILE
from spec import ROOT

from hapfmt.kernels import compiled

CAP = 256 << 20
SLACK = 32 << 20
"""Address space that malloc and libraries reserve and do not use."""

RUN = """
import contextlib, io, json, os, resource, sys
import numpy, hapfmt.writing.writer, hapfmt.reading.verifier, hapfmt.reading.dump, hapfmt.reading.dump, hapfmt.convert.npz
import hapfmt.codecs.exact, hapfmt.reading.decoder, rich.table, rich.console, zipfile
from hapfmt import cli
from hapfmt.cli import info, verify, dump, du, decode

class Nothing(io.RawIOBase):
    def writable(self): return True
    def write(self, data): return len(data)

def size(key):
    lines = open("/proc/self/status").read().splitlines()
    return int([line for line in lines if line.startswith(key)][0].split()[1]) << 10

def run(*words):
    sys.argv = ["hapfmt", *words]
    try:
        cli.main()
    except SystemExit as end:
        return end.code

told = sys.stdout
bare = "--bare" in sys.argv
memory = [] if bare else ["--max-memory", str(CAP)]
files = [word for word in sys.argv[1:] if not word.startswith("--")]
base = size("VmSize")
resource.setrlimit(resource.RLIMIT_AS, (base + CAP + SLACK, resource.RLIM_INFINITY))
out = os.path.join(os.path.dirname(files[0]), "out.npz")
codes = {}
for path in files:
    open("/proc/self/clear_refs", "w").write("5")
    before = size("VmHWM")
    with contextlib.redirect_stdout(io.TextIOWrapper(io.BufferedWriter(Nothing()))):
        found = {
            "info": run("info", path, "--json", *memory),
            "verify": run("verify", path, "--json", "--threads", "1", *memory),
            "dump": run("dump", path, *memory),
            "du": run("du", path, "--json", *memory),
        }
        if not bare:
            found["dump --counts"] = run("dump", path, "--counts", *memory)
            found["decode"] = run("decode", path, out, "-f", "--channels", "0", "--threads", "1", *memory)
    codes[os.path.basename(path)] = {**found, "peak": size("VmHWM") - before}
print(json.dumps(codes), file=told)
"""


def results(folder: Path, size: hostile.Size, names: list[str], *more: str) -> dict:
    paths = []
    for name in names:
        path = folder / name
        path.write_bytes(hostile.FILES[name](size))
        paths.append(str(path))
    code = f"CAP, SLACK = {CAP}, {SLACK}\n{RUN}"
    done = subprocess.run(
        [sys.executable, "-c", code, *paths, *more],
        cwd=ROOT, check=False, capture_output=True, text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert "out of memory" not in done.stderr
    assert "Traceback" not in done.stderr
    return json.loads(done.stdout.splitlines()[-1])


NAMES = list(hostile.FILES)
FITS = ("packets", "bad packets", "index", "chunks in", "chunks of", "attach", "large", "events")
TOO_MUCH = {name for name in NAMES if not name.startswith(FITS)}
"""What a memory of 256 MiB has no room for."""

PART = 8
SHORTENED = {
    "packets",
    "bad packets",
    "chunks in an index",
    "chunks of one number",
    "attachments of nothing",
}
"""What grows with the number of chunks or packets alone: in the profile ci 1/PART of them, and of the memory."""

GROUPS = [NAMES[i::4] for i in range(4)]
NIGHTLY = PROFILE == "nightly"
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")


@linux
@pytest.mark.deep
@pytest.mark.parametrize("group", range(4))
@pytest.mark.parametrize("whole", [True, False], ids=["whole", "fitting"])
def test_memory_is_kept(whole, group, tmp_path):
    """
    LIM-002: A reader MUST check every limit before it takes memory for what the number promises.
    LIM-003: A reader MAY have lower limits of its own, and MUST then report *unsupported*, not damage.
    """
    if not NIGHTLY and not (whole and compiled):
        pytest.skip("what just fits, and the readable loops, are measured in the profile nightly")
    size = hostile.WHOLE if whole else hostile.fitting(CAP)
    names = [name for name in GROUPS[group] if whole or name not in ("packets", "nested headers")]
    shortened = [name for name in names if name in SHORTENED and not NIGHTLY]
    told = results(tmp_path, size, [name for name in names if name not in shortened])
    if shortened:
        told |= results(tmp_path, size._replace(chunks=size.chunks // PART), shortened)
    for name, found in told.items():
        peak = found.pop("peak")
        assert peak <= (CAP // PART if name in shortened else CAP), (name, peak >> 20)
        assert set(found.values()) <= {0, 2, 3, 4}, (name, found)
        if whole and name in TOO_MUCH:
            assert found["verify"] == 4, name
