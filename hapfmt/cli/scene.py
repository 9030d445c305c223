"""hapfmt scene: simulates a scene and writes the recording."""

from __future__ import annotations

import time
from collections import Counter
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from ..errors import ParameterError
from ..numbers import counted
from .common import (
    HAPF,
    PresetType,
    echo_json,
    force_option,
    json_option,
    output_of,
    progress,
    refuse_idle,
    save_recording,
    suffix_of,
)
from .screen import Verb, document, note, say, table

if TYPE_CHECKING:
    from ..lab.scenes.description import Scene, Work
    from ..recording import Recording

INTEGRATORS = ("explicit-euler", "semi-implicit", "implicit", "trapezoid", "rk4", "exact")


def scenes_or_files(
    _ctx: click.Context, _param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """For the shell: the scenes that begin so, else names of files."""
    from ..lab.scenes.description import builtin_names

    names = [name for name in builtin_names() if name.startswith(incomplete)]
    return [CompletionItem(name) for name in names] or [CompletionItem(incomplete, type="file")]


@click.command(cls=Verb)
@click.argument("name", metavar="NAME|FILE.toml", required=False, shell_complete=scenes_or_files)
@click.argument("target", metavar="OUT", required=False)
@click.option("--seconds", type=float, metavar="S", help="Duration in seconds [4].")
@click.option(
    "--stiffness", "n_per_m", type=float, metavar="N/M", help="Stiffness of contacts, up to 1e7."
)
@click.option("--seed", type=int, metavar="N", help="Seed of the random numbers [1].")
@click.option(
    "--rate", "rate_hz", type=int, metavar="HZ", help="Samples per second of every sensor [1000]."
)
@click.option(
    "--integrator",
    type=click.Choice(INTEGRATORS),
    help="Integrator of contacts [exact].",
)
@click.option(
    "--dt",
    "dt_s",
    type=float,
    metavar="S",
    help="Time step of a contact in seconds [from its stiffness].",
)
@click.option(
    "--without",
    multiple=True,
    metavar="PART",
    help="Leave out texture, touches, contact, tool, hand, tremor, abduction, palm, wrist, or a "
    "finger; repeatable.",
)
@click.option(
    "--preset",
    type=PresetType(["lossless", "near-lossless", "perceptual", "paper"]),
    help="Of a .hapf file, as in encode [lossless].",
)
@click.option("--list", "as_list", is_flag=True, help="List the scenes.")
@click.option("--show", is_flag=True, help="Print the TOML of NAME, as a start for your own.")
@force_option
@json_option
def scene(
    name: str | None,
    target: str | None,
    without: tuple[str, ...],
    preset: str | None,
    as_list: bool,
    show: bool,
    force: bool,
    as_json: bool,
    **given: Any,
) -> int:
    """Simulate the scene NAME, or the one described in FILE.toml, and write it to OUT (.hapf .npz
    .csv .npy .wav). Only what the description names is built and computed.

    \b
    hapfmt scene                                    which there are
    hapfmt scene sand sand.hapf --seconds 10
    hapfmt scene wall wall.npz --stiffness 1e5
    hapfmt scene grasp hand.hapf --without ring --without little
    hapfmt scene sand --show > mine.toml
    """
    from ..lab.scenes.description import load_scene, scene_text

    if as_list or name is None or show:
        made = {"without": without, "preset": preset, "force": force, **given}
        refuse_idle("requires NAME and OUT, without --list and --show", **made)
    if as_list or name is None:
        if show or name is not None:
            raise ParameterError("--list takes no argument; --show requires the name of a scene")
        list_scenes(as_json)
        return 0
    if show:
        refuse_idle("does not go with --show", json=as_json)
        if target is not None:
            raise ParameterError("--show takes no OUT: it prints")
        document(scene_text(name))
        return 0
    if target is None:
        raise ParameterError("Give OUT, such as scene.hapf, scene.npz or scene.csv")
    kind = refuse_early(target, force, preset)
    asked = load_scene(name).without(*without).changed(**given)
    return write_scene(asked, target, kind, preset, force, as_json)


def refuse_early(target: str, force: bool, preset: str | None) -> str:
    """The format of the target; refuses a wrong target before the simulation."""
    from ..convert.formats import written_suffixes
    from ..files import refuse

    kind = suffix_of(target, None, HAPF)
    if kind != HAPF and kind not in written_suffixes():
        known = " ".join((HAPF, *written_suffixes()))
        raise ParameterError(f"the suffix {kind!r} is not one of: {known}", path=target)
    if preset and kind != HAPF:
        raise ParameterError(f"--preset requires a .hapf output, not {kind}")
    if target != "-":
        refuse(target, force)
    return kind


def write_scene(
    asked: Scene, target: str, kind: str, preset: str | None, force: bool, as_json: bool
) -> int:
    from ..lab.scenes.build import simulate

    began = time.perf_counter()
    with progress("simulating") as advance:
        recording, work = simulate(asked, progress=advance)
    simulated = time.perf_counter() - began
    result: dict[str, Any] = {
        **recording.metadata["scene"],
        "seconds": float(recording.duration),
        "channels": [channel.label for channel in recording.channels],
        "work": work.as_json(),
        "simulate_s": simulated,
    }
    if kind == HAPF:
        result |= encode_to(recording, target, preset or "lossless", force)
    else:
        save_recording(recording, target, kind, force)
    if as_json and target != "-":
        echo_json(result)
    elif target != "-":
        say(
            f"{target}: {asked.name or 'scene'}, "
            f"{float(recording.duration):g} s, {counted(len(recording), 'channel')}, "
            f"{counted(recording.sample_count, 'sample')}; "
            f"computed {in_words(work)} in {simulated:.2f} s"
        )
    if work.unstable_count:
        note(
            "the integrator is not stable at this step, so the forces may be wrong; "
            "use a smaller --dt or --integrator exact"
        )
    if work.saturated_count:
        note(
            f"{work.saturated_count} samples are at the end of their sensor's range "
            "(range_n of [tool.sensor])"
        )
    return 0


def encode_to(recording: Recording, target: str, preset: str, force: bool) -> dict[str, Any]:
    """Writes the file; its size, and its tracks by their kind."""
    from ..encoder.settings import Settings, renamed
    from ..writing.writer import write

    preset, implied = renamed(preset, {})
    settings = Settings.of(preset, **implied)
    with progress("encoding") as advance:
        summary = write(recording, output_of(target), settings, force=force, progress=advance)
    kinds = Counter("lf + hf" if "quantised" in d.chosen else "full" for d in summary.decisions)
    return {
        "preset": preset,
        "file_size": summary.file_size,
        "payload_size": summary.payload_size,
        "hf_channel_count": kinds["lf + hf"],
    }


def in_words(work: Work) -> str:
    """Lists the work that was done; counts of 0 are omitted."""
    said = [
        (work.height_count, "heights"),
        (work.contact_step_count, "steps of contact"),
        (work.step_count - work.contact_step_count, "free steps"),
        (work.finger_count, "fingers"),
    ]
    return ", ".join(f"{count} {what}" for count, what in said if count) or "angles alone"


def list_scenes(as_json: bool) -> None:
    from ..lab.scenes.description import builtin_names, load_scene

    found = [load_scene(each) for each in builtin_names()]
    if as_json:
        rows = [{"name": each.name, "description": each.description} for each in found]
        echo_json({"scenes": rows})
        return
    table(["scene", "what it is"], [[each.name, each.description] for each in found])
    say("Write one with: hapfmt scene NAME OUT.hapf")
