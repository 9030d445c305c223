"""What a scene costs with everything in it, and without each of its parts.

python tools/scenes.py [--seconds 10] [--repeats 3] [--keys]

Each row is two processes of their own. One runs the verb, `hapfmt scene`, from start to end: its
CPU time, its peak memory, the modules it loaded, and the file. The other has imported all before,
and simulates: CPU time, and memory beyond what it held. Times are the best of --repeats. --keys
prints the tables of docs/scenes.md.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from installed import environment

import click
from measured import print_origin, print_table
from rich.console import Console

MIB = 1 << 20
FINE = "relief = 0.02"
"""Relief of a texture too fine to feel: 0.6 mN rms, a count of the sensor."""

BARE = """
import json, sys
from pathlib import Path
from hapfmt.cli import cli
cli.main(sys.argv[1:], standalone_mode=False)
status = Path("/proc/self/status")
status = status.read_text("ascii") if status.exists() else ""
print(json.dumps({"modules": len(sys.modules), "status": status}))
"""


class Row(NamedTuple):
    """A scene, the parts left out of it, the preset of its file, and additions to its TOML."""

    name: str
    scene: str
    without: tuple[str, ...] = ()
    preset: str = "perceptual"
    added: str = ""


ROWS = (
    Row("everything", "everything"),
    Row("everything, lossless", "everything", (), "lossless"),
    Row("no texture", "everything", ("texture",)),
    Row("no contact", "everything", ("contact",)),
    Row("no hand", "everything", ("hand",)),
    Row("no hand, no texture", "everything", ("hand", "texture")),
    Row("no hand, no contact", "everything", ("hand", "contact")),
    Row("no tool", "everything", ("tool",)),
    Row("no tool, no contact, no tremor", "everything", ("tool", "contact", "tremor")),
    Row("one finger, no palm, no wrist", "everything",
        ("tool", "index", "middle", "ring", "little", "palm", "wrist", "abduction")),
    Row("sand", "sand"),
    Row("sand too fine to feel", "sand", (), "perceptual", FINE),
    Row("sand without touch-downs", "sand", ("touches",)),
    Row("sand without texture", "sand", ("texture",)),
    Row("sand without contact", "sand", ("contact",)),
)  # fmt: skip
HEADERS = ["scene", "channels", "heights", "contact steps", "free steps", "simulate ms", "MiB",
           "whole verb: CPU s", "peak MiB", "modules", "file B", "HF tracks"]  # fmt: skip


class Found(NamedTuple):
    """work: the counters. Seconds of CPU, bytes. The first two of simulating alone, then of the
    verb."""

    work: dict[str, int]
    simulate_s: float
    simulate_memory: int
    verb_s: float
    verb_memory: int
    module_count: int
    file_size: int
    hf_track_count: int


def measure(row: Row, seconds: float, repeats: int, folder: Path) -> Found:
    """One row, each part in processes of its own."""
    source = scene_file(row, folder)
    target = folder / "scene.hapf"
    verb = ["scene", source, str(target), "--seconds", str(seconds), "--preset", row.preset,
            "--force", *(word for part in row.without for word in ("--without", part))]  # fmt: skip
    runs = [run([sys.executable, "-c", BARE, *verb]) for _ in range(repeats)]
    told = [json.loads(each.output.splitlines()[-1]) for each in runs]
    asked = json.dumps([source, row.without, seconds, repeats])
    inside = json.loads(run([sys.executable, __file__, "--child", asked]).output)
    import hapfmt

    with hapfmt.Reader(target) as reader:
        hf = sum(each.kind == "hf" for each in reader.catalogue.tracks.values())
    return Found(
        inside["work"],
        inside["simulate_s"],
        inside["memory"],
        min(each.cpu_s for each in runs),
        min(peak_of(each["status"], run.most) for each, run in zip(told, runs, strict=True)),
        told[0]["modules"],
        target.stat().st_size,
        hf,
    )


def scene_file(row: Row, folder: Path) -> str:
    """The name of the scene, or of a file with the additions."""
    if not row.added:
        return row.scene
    from hapfmt.lab.scenes import scene_text

    path = folder / "mine.toml"
    path.write_text(scene_text(row.scene) + row.added + "\n", encoding="utf-8")
    return str(path)


class Run(NamedTuple):
    output: str
    cpu_s: float
    most: int


def run(words: list[str]) -> Run:
    """A process to its end: what it prints, its CPU time, its ru_maxrss."""
    given = environment(OPENBLAS_NUM_THREADS="1")
    with tempfile.TemporaryFile() as out:
        process = subprocess.Popen(words, stdout=out, env=given)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise click.ClickException(f"{' '.join(words)}: exit code {process.returncode}")
        out.seek(0)
        output = out.read().decode()
    return Run(output, usage.ru_utime + usage.ru_stime, usage.ru_maxrss)


def child(source: str, without: list[str], seconds: float, repeats: int) -> dict[str, Any]:
    """Simulating, measured in this process."""
    from hapfmt.lab.scenes import load_scene
    from hapfmt.lab.scenes.build import simulate

    scene = load_scene(source).without(*without).changed(seconds=seconds)
    simulate(scene.changed(seconds=0.01))  # imports are not measured
    before, times = peak(), []
    for _ in range(repeats):
        began = time.process_time()
        _, work = simulate(scene)
        times.append(time.process_time() - began)
    return {"work": work.as_json(), "simulate_s": min(times), "memory": peak() - before}


def peak() -> int:
    """Bytes this process has held at most."""
    status = Path("/proc/self/status")
    text = status.read_text("ascii") if status.exists() else ""
    return peak_of(text, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def peak_of(status: str, most: int) -> int:
    """Bytes, from Linux' own status of a process, since ru_maxrss begins there with what its parent
    held; elsewhere from that."""
    for line in status.splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return most if sys.platform == "darwin" else most * 1024


def measure_all(
    rows: Sequence[Row], seconds: float, repeats: int, announce: Callable[[str], None]
) -> list[tuple[Row, Found]]:
    """What each row measures; ``announce`` gets the name of a row before its measurement."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for row in rows:
            announce(row.name)
            found.append((row, measure(row, seconds, repeats, Path(folder))))
    return found


def cells(row: Row, found: Found) -> list[str | float]:
    work = found.work
    return [
        row.name,
        work["channel_count"],
        work["height_count"],
        work["contact_step_count"],
        work["step_count"] - work["contact_step_count"],
        round(1000 * found.simulate_s, 1),
        round(found.simulate_memory / MIB, 1),
        round(found.verb_s, 2),
        round(found.verb_memory / MIB),
        found.module_count,
        found.file_size,
        found.hf_track_count,
    ]


def print_keys() -> None:
    """The tables of docs/scenes.md."""
    from hapfmt.lab.scenes.description import Scene
    from hapfmt.structs import schema_of

    schema = schema_of(Scene, "Scene")
    tables = [("", schema["$ref"])]
    while tables:
        at, ref = tables.pop(0)
        table = schema["$defs"][ref.rpartition("/")[2]]
        print(f"### {f'`[{at}]`' if at else 'At the top'}\n")
        print(f"{' '.join(table['description'].split())}\n")
        print("| key | meaning | default |\n|---|---|---|")
        for key, rule in table["properties"].items():
            inner = rule["anyOf"][0] if "anyOf" in rule else rule
            if "$ref" in inner:
                tables.append((".".join(filter(None, (at, key))), inner["$ref"]))
            told = rule.get("description") or inner["description"]
            print(f"| `{key}` | {told} | {default_of(rule, inner)} |")
        print()


def default_of(rule: dict[str, Any], inner: dict[str, Any]) -> str:
    """The default of a key."""
    if "default" not in rule:
        return "required"
    if rule["default"] is None:
        return "none" if "$ref" in inner else "in brackets"
    return f"`{json.dumps(rule['default'])}`"


@click.command(help=__doc__)
@click.option("--seconds", default=10.0, help="Length of each scene.")
@click.option("--repeats", default=3, help="Each time is the best of this many runs.")
@click.option("--keys", is_flag=True, help="Print the tables of docs/scenes.md.")
@click.option("--child", "asked", hidden=True)
def main(seconds: float, repeats: int, keys: bool, asked: str | None) -> None:
    if keys:
        print_keys()
        return
    if asked:
        print(json.dumps(child(*json.loads(asked))))
        return
    console = Console(stderr=True)
    with console.status("scenes") as status:
        rows = [cells(*each) for each in measure_all(ROWS, seconds, repeats, status.update)]
    print_origin()
    print(f"{seconds:g} s of each scene; CPU time, best of {repeats}\n")
    print_table(HEADERS, rows)


if __name__ == "__main__":
    main()
