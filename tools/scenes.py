"""What a scene costs, and what it costs without each of its parts; the scene "everything".

python tools/scenes.py [--seconds 10] [--name everything] [--keys] [--rows wall,free ...]

Each row is made in a process of its own: CPU time of simulating and of writing (best of --repeats),
the memory that both take beyond what the interpreter holds with everything imported, the modules
that `hapfmt scene` loads, and the bytes that it writes. --keys prints the tables of docs/scenes.md.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

import click
from measured import ROOT, print_origin, print_table
from rich.console import Console
from rich.progress import track

MIB = 1 << 20
NO_HF = "texture too fine to feel"
FINE = 0.02
"""Of the relief: 0.6 mN rms, a count of the sensor."""

VARIANTS: dict[str, tuple[str, ...]] = {
    "everything": (),
    NO_HF: (),
    "no texture": ("texture",),
    "no contact": ("contact",),
    "no hand": ("hand",),
    "no tool": ("tool",),
    "no hand, no texture": ("hand", "texture"),
    "no hand, no contact": ("hand", "contact"),
    "no tool, no contact, no tremor": ("tool", "contact", "tremor"),
    "one finger": ("tool", "index", "middle", "ring", "little", "palm", "wrist", "abduction"),
}
HEADERS = ["scene", "channels", "heights", "contact steps", "free steps", "simulate ms", "write ms",
           "memory MiB", "modules", "of ours", "file B", "HF tracks"]  # fmt: skip


def scene_of(name: str, variant: str, seconds: float) -> Any:
    from hapfmt.scenes import load_scene

    scene = load_scene(name).without(*VARIANTS[variant]).changed(seconds=seconds)
    if variant == NO_HF and scene.tool and scene.tool.texture:
        fine = replace(scene.tool.texture, relief=FINE)
        scene = replace(scene, tool=replace(scene.tool, texture=fine))
    return scene


def child(name: str, variant: str, seconds: float, preset: str, repeats: int) -> dict[str, Any]:
    """One row, measured in this process."""
    from hapfmt.scenes.build import simulate

    scene = scene_of(name, variant, seconds)
    # Once, short: what is imported is no part of the time, and no more than the scene needs.
    simulate(scene.changed(seconds=0.01))
    simulating = sorted(sys.modules)
    import hapfmt
    from hapfmt.writer import write

    path = Path(tempfile.mkdtemp()) / "scene.hapf"
    write(simulate(scene.changed(seconds=0.5))[0], path, hapfmt.Settings.of(preset))
    before, times = peak(), []
    for _ in range(repeats):
        began = time.process_time()
        recording, work = simulate(scene)
        simulated = time.process_time()
        write(recording, path, hapfmt.Settings.of(preset), canonical=1, force=True, threads=1)
        times.append((simulated - began, time.process_time() - simulated))
    memory = peak() - before
    with hapfmt.Reader(path) as reader:
        hf = sum(each.kind == "hf" for each in reader.catalogue.tracks.values())
    size = path.stat().st_size
    path.unlink()
    path.parent.rmdir()
    return {
        **work.as_json(),
        "simulate_s": min(each[0] for each in times),
        "write_s": min(each[1] for each in times),
        "memory": memory,
        "modules": len(simulating),
        "ours": sum(module.startswith("hapfmt.scenes.") for module in simulating),
        "file_size": size,
        "hf_track_count": hf,
    }


def peak() -> int:
    """Bytes this process has held at most."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


def measure(name: str, variant: str, seconds: float, preset: str, repeats: int) -> dict[str, Any]:
    """One row, measured in a process of its own."""
    arguments = [name, variant, str(seconds), preset, str(repeats)]
    done = subprocess.run(
        [sys.executable, __file__, "--child", json.dumps(arguments)],
        check=True, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    return dict(json.loads(done.stdout))


def row_of(variant: str, found: dict[str, Any]) -> list[str]:
    return [
        variant,
        str(found["channel_count"]),
        str(found["height_count"]),
        str(found["contact_step_count"]),
        str(found["step_count"] - found["contact_step_count"]),
        f"{1000 * found['simulate_s']:.0f}",
        f"{1000 * found['write_s']:.0f}",
        f"{found['memory'] / MIB:.1f}",
        str(found["modules"]),
        str(found["ours"]),
        str(found["file_size"]),
        str(found["hf_track_count"]),
    ]


def print_keys() -> None:
    """The tables of docs/scenes.md."""
    from hapfmt.scenes.description import Scene

    tables: list[tuple[str, Any]] = [("", Scene)]
    while tables:
        at, table = tables.pop(0)
        print(f"### {f'`[{at}]`' if at else 'At the top'}\n\n{' '.join(table.__doc__.split())}\n")
        print("| key | what | without it |\n|---|---|---|")
        for each in fields(table):
            rule = each.metadata["key"]
            inner = ".".join(filter(None, (at, each.name)))
            if rule.table:
                tables.append((inner, rule.table))
            print(f"| `{each.name}` | {rule.what} | {without(each)} |")
        print()


def without(each: Any) -> str:
    """What a key that is not given stands for."""
    if each.default is MISSING:
        return "must be given"
    if each.metadata["key"].table:
        return "none"
    value = list(each.default) if isinstance(each.default, tuple) else each.default
    return "as said" if value is None else f"`{json.dumps(value)}`"


@click.command(help=__doc__)
@click.option("--seconds", default=10.0, help="Length of the scene.")
@click.option("--name", default="everything", help="The scene.")
@click.option("--preset", default="default", help="Of the file.")
@click.option("--repeats", default=3, help="Times are the best of so many.")
@click.option("--keys", is_flag=True, help="Print the tables of docs/scenes.md.")
@click.option("--child", "arguments", hidden=True)
def main(
    seconds: float, name: str, preset: str, repeats: int, keys: bool, arguments: str | None
) -> None:
    if keys:
        print_keys()
        return
    if arguments:
        scene, variant, length, chosen, times = json.loads(arguments)
        print(json.dumps(child(scene, variant, float(length), chosen, int(times))))
        return
    console = Console(stderr=True)
    rows = [
        row_of(variant, measure(name, variant, seconds, preset, repeats))
        for variant in track(VARIANTS, "scenes", console=console, transient=True)
    ]
    print_origin()
    print(f"scene {name}, {seconds:g} s, preset {preset}; CPU time, best of {repeats}\n")
    print_table(HEADERS, rows)


if __name__ == "__main__":
    main()
