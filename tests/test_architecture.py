"""Who may import whom."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter

import pytest
from spec import ROOT

PACKAGE = ROOT / "hapfmt"
MODULES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
LAYERS = (
    "kernels",
    """clocks datasets deadband descriptions errors files limits metrics numbers recording split
    threads times units version""",
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
    "msgspec": (
        "convert.mcap_writer",
        "descriptions",
        "convert.maps",
        "writing.streams",
        "replay.profile.parse",
        "lab.scenes.description",
        "lab.scenes.stylus",
        "lab.study.description",
        "lab.study.rating",
    ),
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
def imports(name: str) -> set[str]:
    """Modules that a module names in any import; those of the package as in MODULES."""
    here = f"hapfmt.{name}".split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(MODULES[name].read_text(encoding="utf-8"))):
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
        for path in MODULES.values()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    assert len(found) > 100
    assert [name for name, count in Counter(found).items() if count > 1] == []


@pytest.mark.parametrize("part", HEIGHT)
def test_imports_point_down(part):
    """The package itself, hapfmt/__init__.py, is what users import: it names all layers."""
    for name in MODULES:
        for other in imported(name) if name.split(".")[0] == part else ():
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


def test_only_a_split_loads_scipy():
    """Importing its filters takes longer than most encoding; where nothing is split, nothing is
    filtered."""
    code = """
import io, sys, hapfmt
from hapfmt.lab.scenes import load_scene, simulate
recording, _ = simulate(load_scene("everything").changed(seconds=0.05))
for preset in ("lossless", "near-lossless", "perceptual", "paper"):
    hapfmt.write(recording, io.BytesIO(), hapfmt.Settings.of(preset))
    assert ("scipy" in sys.modules) is (preset == "paper"), preset
"""
    assert "scipy" in loaded_by(code)


def test_info_loads_no_numbers():
    """The reader of descriptions needs no arrays, no plots, and no construct."""
    path = ROOT / "conformance" / "examples" / "hold.hapf"
    code = f"from hapfmt.cli import cli; cli.main(['info', {str(path)!r}], standalone_mode=False)"
    assert not loaded_by(code) & {"numpy", "scipy", "matplotlib", "construct"}


@pytest.mark.parametrize("record", ["", "sent.csv", "sent.hapf"])
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
    # msgspec reads the profile, 20 ms before the device is opened.
    assert not {name.split(".")[0] for name in found} & (HEAVY - {"numpy", "msgspec"})
