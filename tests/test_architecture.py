"""Who may import whom."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import tomllib
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter

import pytest
from spec import ROOT

import hapfmt

PACKAGE = ROOT / "hapfmt"
MODULES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
LAYERS = (
    "kernels",
    """clocks datasets deadband descriptions errors files limits metrics numbers recording split
    spool structs threads times units version""",
    "format",
    "codecs",
    "reading",
    "convert analysis viewer",
    "encoder",
    "writing",
    "edit replay",
    "lab",
    "archive",
    "cli",
    "__main__",
)
"""From the lowest to the highest: each imports itself and what is below. Parts of one layer do not
know each other, but for those of the second, where nothing of the format is known yet."""
HEIGHT = {part: height for height, row in enumerate(LAYERS) for part in row.split()}
BASE = 1
DECODE_SIDE = [name for name in MODULES if HEIGHT.get(name.split(".")[0], 99) <= HEIGHT["reading"]]
REPLAY = [name for name in MODULES if name.split(".")[0] == "replay"]
RECORDS = "replay.sinks.record"
"""Of a replay the only module that encodes."""
PURE = ("replay.schedule",)
IMPURE = """asyncio datetime multiprocessing os pathlib random select signal socket subprocess sys
threading time hapfmt.replay.sinks hapfmt.replay.process hapfmt.replay.render hapfmt.reading"""
BARRED_IN_REPLAY = {
    "profile": "render sinks process schedule",
    "render": "sinks process schedule",
    "sinks": "render process schedule",
    "process.writer": "render",
    "process.watchdog": "render",
}
"""Parts of a replay -> those that they know nothing of. The processes that must be on time decode
nothing."""
ONLY_IN = {
    "construct": ("format.layout",),
    "msgspec": ("convert.mcap_writer",),
    "scipy": ("convert.mat_layout", "lab.study.outputs", "metrics"),
    "matplotlib": tuple(name for name in MODULES if name.startswith("lab.plotting.")),
    "soundfile": ("convert.wav",),
    "h5py": ("convert.hdf5_files",),
    "fsspec": ("format.source",),
    "sounddevice": ("lab.study.outputs",),
    "hid": ("replay.sinks.hid",),
    "hidraw": ("replay.sinks.hid",),
    "pandas": ("recording", "datasets"),
    "xarray": ("recording", "datasets", "analysis.backend"),
    "polars": ("analysis.lazyframes",),
    "rosbags": ("convert.ros_definitions", "convert.rosbag"),
    "ruamel": ("convert.rosbag",),
    "apsw": ("convert.rosbag",),
    "rerun": ("cli.rerun_loader",),
    "mcap": ("convert.mcap", "convert.mcap_writer"),
    "zstandard": ("convert.mcap",),
    "lz4": ("convert.mcap", "convert.rosbag"),
    "nptdms": ("convert.tdms",),
    "pyarrow": (
        "recording",
        "convert.arrowtables",
        "convert.parquet",
        "convert.feather",
        "convert.lerobot",
    ),
}
HEAVY = {
    "numpy",
    "scipy",
    "construct",
    "msgspec",
    "click",
    "rich",
    "matplotlib",
    "soundfile",
    "h5py",
    "sounddevice",
    "hid",
    "hidraw",
    "jsonschema",
    "fsspec",
    "aiohttp",
    "pandas",
    "xarray",
    "rosbags",
    "mcap",
    "rerun",
    "nptdms",
    "pyarrow",
    "polars",
    "dask",
    "distributed",
    "bagit",
    "rocrate",
}


@cache
def tree(name: str) -> ast.Module:
    return ast.parse(MODULES[name].read_text(encoding="utf-8"))


@cache
def imports(name: str) -> set[str]:
    """Modules that a module names in any import; those of the package as in MODULES."""
    here = f"hapfmt.{name}".split(".")[:-1]
    found = set()
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parts = here[: len(here) - node.level + 1] if node.level else []
            base = ".".join([*parts, *filter(None, [node.module])])
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                known = inner.removeprefix("hapfmt.")
                found |= {inner} if {known, f"{known}.__init__"} & MODULES.keys() else {base, inner}
    return found


@cache
def imported(name: str) -> set[str]:
    """Modules of the package; imports within functions and for types count too."""
    return {
        inner
        for found in imports(name)
        if (inner := found.removeprefix("hapfmt.").removesuffix(".__init__")) != found
        and (inner in MODULES or f"{inner}.__init__" in MODULES)
    }


def test_every_part_has_a_layer():
    assert {name.split(".")[0] for name in MODULES} - {"__init__"} == set(HEIGHT)


def test_a_class_name_has_one_meaning():
    """Classes within functions and classes count too."""
    found = [
        node.name
        for name in MODULES
        for node in ast.walk(tree(name))
        if isinstance(node, ast.ClassDef)
    ]
    assert len(found) > 100
    assert [name for name, count in Counter(found).items() if count > 1] == []


def test_imports_point_down():
    """The package itself, hapfmt/__init__.py, is what users import: it names all layers."""
    for name in MODULES.keys() - {"__init__"}:
        part = name.split(".")[0]
        for other in imported(name):
            below = other.split(".")[0]
            beside = below != part and HEIGHT[below] == HEIGHT[part] != BASE
            assert HEIGHT[below] <= HEIGHT[part] and not beside, f"{name} imports {other}"


def test_no_module_imports_itself_through_others():
    def key(name: str) -> str:
        return name if name in MODULES else f"{name}.__init__"

    graph = {name: {key(x) for x in imported(name)} - {name} for name in MODULES}
    assert "format.layout" in TopologicalSorter(graph).static_order()


@pytest.mark.parametrize("name", [name for name in REPLAY if name != RECORDS])
def test_a_replay_encodes_nothing(name):
    barred = ("hapfmt.encoder", "hapfmt.writing", "hapfmt.convert")
    assert not [x for x in imports(name) if x.startswith(barred)]
    assert name == "replay.sinks.__init__" or f"hapfmt.{RECORDS}" not in imports(name)


@pytest.mark.parametrize("name", [name for name in MODULES if name.split(".")[0] == "edit"])
def test_an_editor_encodes_nothing(name):
    barred = (
        "hapfmt.encoder",
        "hapfmt.convert",
        "hapfmt.writing.writer",
        "hapfmt.writing.recorder",
    )
    assert not [x for x in imports(name) if x.startswith(barred)]


@pytest.mark.parametrize("name", PURE)
def test_what_decides_on_frames_is_pure(name):
    barred = tuple(IMPURE.split())
    assert not [
        x for x in imports(name) if x in barred or x.startswith(tuple(f"{b}." for b in barred))
    ]


@pytest.mark.parametrize("part", BARRED_IN_REPLAY)
def test_parts_of_a_replay_that_know_nothing_of_others(part):
    here = [name for name in REPLAY if f"{name}.".startswith(f"replay.{part}.")]
    for name in here:
        barred = tuple(f"hapfmt.replay.{other}" for other in BARRED_IN_REPLAY[part].split())
        assert not [x for x in imports(name) if x.startswith(barred)], name


@pytest.mark.parametrize("package", ONLY_IN)
def test_packages_that_stay_where_they_are(package):
    users = {n for n in MODULES if any(x.split(".")[0] == package for x in imports(n))}
    assert users <= set(ONLY_IN[package])


def modules_after(code: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after ``code``."""
    code += "\nimport json, sys; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


def loaded_by(code: str) -> set[str]:
    """Of these only the top level."""
    return {name.split(".")[0] for name in modules_after(code)}


def test_import_is_light():
    assert not loaded_by("import hapfmt; hapfmt.__version__") & HEAVY


def required() -> set[str]:
    """Modules of the packages that ``pip install hapfmt`` brings."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        given = tomllib.load(file)["project"]["dependencies"]
    return {re.split(r"\W", each)[0] for each in given}


def test_the_core_needs_four_packages():
    assert required() == {"numpy", "construct", "click", "rich"}


def test_other_packages_are_imported_where_they_are_used(tmp_path):
    """All modules but those that are for one package alone, and the common commands."""
    code = f"""
import os, sys

class Barred:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in {(HEAVY | ONLY_IN.keys()) - required()!r}:
            raise ModuleNotFoundError(f"{{name}} is barred", name=name)

sys.meta_path.insert(0, Barred())
os.chdir({str(tmp_path)!r})
from hapfmt.cli import cli

def run(words, code=0):
    try:
        cli.main(words.split(), standalone_mode=False)
    except SystemExit as error:
        assert error.code in (None, code), (words, error.code)

run("demo --seconds 0.5")
run("scene wall touch.npz --seconds 0.5")
for preset in ("lossless", "near-lossless", "perceptual", "paper"):
    run(f"encode touch.npz {{preset}}.hapf --preset {{preset}}")
    run(f"verify {{preset}}.hapf")
    run(f"info {{preset}}.hapf")
    run(f"decode {{preset}}.hapf {{preset}}.csv")
run("compare touch.npz lossless.hapf")
run("subset paper.hapf part.hapf --channels 0")
run("profile check glove22")
run("replay lossless.hapf --device glove5 --dry-run --map 0=thumb --stop 0.05")
run("record live.hapf --rate 1000")
run("verify live.hapf")
"""
    rows = "".join(f"{n % 7},{n % 5}\n" for n in range(500))
    done = subprocess.run(
        [sys.executable, "-c", code],
        check=False,
        cwd=ROOT,
        input=rows,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    for preset in ("lossless", "near-lossless", "perceptual", "paper"):
        assert hapfmt.read(tmp_path / f"{preset}.hapf").channels
    assert hapfmt.read(tmp_path / "live.hapf").channels[1].stored.tolist() == [
        n % 5 for n in range(500)
    ]


def test_a_filter_needs_no_scipy():
    code = "import numpy, hapfmt.split as s; s.low_pass(numpy.arange(999.0), 1000)"
    assert "numpy" in loaded_by(code) and "scipy" not in loaded_by(code)


def test_info_loads_no_numbers():
    """The reader of descriptions needs no arrays, no plots, and no construct."""
    path = ROOT / "conformance" / "examples" / "hold.hapf"
    code = f"from hapfmt.cli import cli; cli.main(['info', {str(path)!r}], standalone_mode=False)"
    assert not loaded_by(code) & {"numpy", "scipy", "matplotlib", "construct"}


@pytest.mark.parametrize("record", ["sent.csv", "sent.hapf"])
def test_a_dry_run_loads_the_encoder_for_a_hapf_record_alone(record, tmp_path):
    file = ROOT / "conformance" / "examples" / "hold.hapf"
    words = ["replay", str(file), "--device", "glove5", "--map", "0=thumb", "--dry-run"]
    words += ["--record", str(tmp_path / record)] if record else []
    code = f"from hapfmt.cli import cli; assert not cli.main({words!r}, standalone_mode=False)"
    found = modules_after(code)
    assert "hapfmt.replay.render.renderer" in found
    encoders = {name for name in found if name.startswith(("hapfmt.encoder", "hapfmt.writing"))}
    assert bool(encoders) is (record == "sent.hapf")
    others = [
        "encoder.encode",
        "encoder.references",
        "encoder.texture",
        "writing.streams",
        "writing.writer",
    ]
    assert MODULES.keys() >= set(others)
    assert not encoders & {f"hapfmt.{name}" for name in others}
    assert not record or (tmp_path / record).stat().st_size


def test_the_watchdog_starts_light():
    assert not loaded_by("import hapfmt.replay.process.watchdog") & HEAVY


def test_the_writer_loads_nothing_that_reads_files():
    found = modules_after("import hapfmt.replay.process.loop, hapfmt.replay.profile.parse")
    assert not {name for name in found if name.startswith(("hapfmt.reading", "hapfmt.codecs"))}
    assert not {name.split(".")[0] for name in found} & (HEAVY - {"numpy"})
