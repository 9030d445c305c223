"""An option that cannot act on the input is refused, or a note names the remedy.

Each option of each verb has a row with an input on which it cannot act, or a reason why it always
acts. The options of the encoder have theirs in test_no_silent_options.py.
"""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import click
import numpy as np
import pytest
from spec import ROOT
from terminal import called

import hapfmt
from hapfmt.cli import cli

ELSEWHERE = ("encode", "record", "archive encode")
ALWAYS = {
    "--json": "prints JSON",
    "--verbose": "prints what there is to print",
    "--max-memory": "is a bound",
    "--threads": "sets how the work is done, not what is done",
    "--jobs": "sets how the work is done, not what is done",
    "--dask": "sets how the work is done, not what is done",
    "--log": "names an output",
    "--output": "names an output",
    "--plot": "names an output",
    "--export": "names an output",
    "--record": "names an output",
    "--output-format": "chooses the format of an output",
    "--input-format": "chooses the reader of an input",
    "--canonical": "is the file id of the output",
    "--force": "allows to replace a file that is there",
    "--against": "names a second input",
    "--list": "prints a list",
    "--dry-run": "keeps a device still",
}
"""Options that act on every input, in every verb that has no row for them -> why."""
ALWAYS_IN = {
    "subset --to-zero": "the output begins at tick 0, moved or not",
    "subset --level": "is a lower bound",
    "subset --exact": "allows a cut within a packet",
    "split --exact": "allows a cut within a packet",
    "study --help-all": "shows the help",
    "split --to-zero": "each part begins at tick 0, moved or not",
    "compare --tolerance": "is a bound",
    "compare --metrics": "prints measures, or a note that no channel has samples",
    "plot --window": "opens a window",
    "recover --in-place": "chooses the file that is mended; an intact one is said to be intact",
    "archive find --where": "chooses rows",
    **dict.fromkeys(
        (f"archive bag --{name}" for name in ("title", "description", "license", "author", "info")),
        "is written into the bag",
    ),
    "devices --profile": "is checked, and tried on each device",
    **dict.fromkeys(
        (f"demo --{name}" for name in ("texture", "seconds", "seed", "k", "bits")),
        "every row of presets is made with it",
    ),
    **dict.fromkeys(
        (f"scene --{name}" for name in ("integrator", "dt")), "as --stiffness, which has a row"
    ),
    "info --schema": "prints the schema",
    "verify --schema": "prints the schema",
    "dump --schema": "prints the schema",
    "dump --counts": "each packet has counts",
    "replay --device": "is required",
    "replay --loop": "is how often",
    "replay --speed": "is a factor",
    "replay --gain": "is a factor",
}

FOREIGN = {
    "--rate": "5", "--transpose": "", "--select": "x", "--clock": "log", "--episode": "0",
    "--map": "m.toml", "--keep-stamps": "",
}  # fmt: skip
"""Options for inputs of other formats, and a value of each."""


OTHERS = "is for inputs of other formats than .hapf"
LISTED = "does not go with --list"
SCENE = "requires NAME and OUT, without --list and --show"
DEVICE = "--device glove5"
DRY = "is for a device, and --dry-run opens none"
STUDY = "study s.toml --subject S1"
REPLAY = "replay a.hapf --device glove5 --dry-run"
ROWS: dict[str, tuple[str, str]] = {}


def row(option: str, command: str, text: str) -> None:
    """``option``: with its verb; ``command``: on which it cannot act; ``text``: what is said."""
    ROWS[option] = (command, text)


for name, value in FOREIGN.items():
    row(f"convert {name}", f"convert a.hapf o.npz {name} {value}", OTHERS)
    row(f"info {name}", f"info a.hapf {name} {value}", OTHERS)
    row(f"verify {name}", f"verify a.hapf {name} {value}", "requires --against")
    row(f"compare {name}", f"compare a.hapf a.hapf {name} {value}", OTHERS)
    row(f"plot {name}", f"plot a.hapf -o o.png {name} {value}", OTHERS)
    row(
        f"archive convert {name}",
        f"archive convert a.hapf tables --output-format npz {name} {value}",
        "for other formats",
    )
row("convert --select", "convert r.csv o.npz --select zz", "zz")  # also chooses from .hapf files
row(
    "archive convert --select", "archive convert r.csv tables --output-format npz --select zz", "zz"
)
row("convert --labels", "convert a.hapf o.npz --labels a,b", "--labels and --unit require")
row("convert --unit", "convert a.hapf o.npz --unit N", "--labels and --unit require")
row("convert --schema", "convert r.csv o.npz --schema json", "do not use schema")
row("convert --fps", "convert r.csv o.npz --fps 9", "do not use fps")
row("decode --channels", "decode a.hapf o.npz --channels zz", "no channel 'zz'")
row("decode --start", "decode a.hapf o.npz --start 100", "the recording ends at 2 s")
row("decode --stop", "decode a.hapf o.npz --stop 0", "the time range is empty")
row("decode --band", "decode a.hapf o.npz --band hf", "no channel here is stored as a slow part")
row("decode --file-id", "decode a.hapf o.npz --file-id 5", "a.hapf")
row("info --formats", "info a.hapf --formats", "--formats takes no FILE")
row("info --events", "info a.hapf --events", "this file has no events")
row("info --follow", "info r.csv --follow", "--follow requires a .hapf file")
row("info --interval", "info a.hapf --interval 3", "--interval requires --follow")
row("verify --input-format", "verify a.hapf --input-format npz", "requires --against")
row("verify --file-id", "verify a.hapf --file-id 5", "a.hapf")
row("compare --channels", "compare a.hapf a.hapf --channels zz", "no channel 'zz'")
row("compare --start", "compare a.hapf a.hapf --start 100", "has samples at 100 s or later")
row("compare --stop", "compare a.hapf a.hapf --stop 0", "the time range is empty")
row("compare --input-format", "compare a.hapf a.hapf --input-format npz", OTHERS)
row("compare --force", "compare a.hapf a.hapf --force", "--force requires --plot")
row("plot --channels", "plot a.hapf -o o.png --channels zz", "no channel 'zz'")
row("plot --start", "plot a.hapf -o o.png --start 100", "the recording ends at 2 s")
row("plot --stop", "plot a.hapf -o o.png --stop 0", "the time range is empty")
row("plot --input-format", "plot a.hapf -o o.png --input-format npz", OTHERS)
row("plot --output-format", "plot a.hapf --window --output-format pdf", "requires --output")
row("plot --force", "plot a.hapf --window --force", "requires --output")
row("view --port", "view a.hapf --export o.html --port 8000", "--export starts none")
row("view --no-browser", "view a.hapf --export o.html --no-browser", "--export starts none")
row("view --force", "view a.hapf --force", "--force requires --export")
row("subset --channels", "subset a.hapf o.hapf --channels zz", "no channel 'zz'")
row("subset --start", "subset a.hapf o.hapf --start 100", "")
row("subset --stop", "subset a.hapf o.hapf --stop 0", "the time range is empty")
row("subset --band", "subset a.hapf o.hapf --band lf", "none of these channels has this band")
row("split --every", "split a.hapf --every 1 --at 1", "give either")
row("split --at", "split a.hapf --every 1 --at 1", "give either")
row("concat --gap", "concat a.hapf o.hapf --gap 1", "requires two files or more")
row("concat --by-epoch", "concat a.hapf o.hapf --by-epoch", "requires two files or more")
row("concat --same-times", "concat a.hapf o.hapf --same-times", "requires two files or more")
row("merge --by-epoch", "merge a.hapf o.hapf --by-epoch", "requires two files or more")
row("merge --same-times", "merge a.hapf o.hapf --same-times", "requires two files or more")
row("merge --offset", "merge a.hapf o.hapf --offset b.hapf=1", "with one of the input files")
row("merge --prefix", "merge a.hapf o.hapf --prefix l --prefix r", "one --prefix for each file")
row("attach --name", "attach a.hapf --list --name x", "--name is for files to attach")
row("attach --media-type", "attach a.hapf --list --media-type a/b", "is for files to attach")
row("attach --list", "attach a.hapf r.csv --list", "--list takes no PATH")
row("attach --extract", "attach a.hapf --list --extract", LISTED)
row("attach --output", "attach a.hapf --list -o x", LISTED)
row("attach --force", "attach a.hapf r.csv --force", "--force requires --output or --extract")
for words in ("--at 1", "--duration 1", "--channel 0", "--table r.csv", "--output o.hapf"):
    row(f"annotate {words.split()[0]}", f"annotate a.hapf --list {words}", LISTED)
row("annotate --list", "annotate a.hapf slip --list", "--list takes no TEXT")
row(
    "annotate --layer",
    "annotate a.hapf --layer eva --table events.csv",
    "--layer is for rows without",
)
row("annotate --force", "annotate a.hapf slip --at 1 --force", "--force requires --output")
row("meta --output", "meta a.hapf -o o.hapf", "--output requires KEY=VALUE")
row("meta --force", "meta a.hapf a=1 --force", "--force requires --output")
row("recover --file-id", "recover a.hapf o.hapf --file-id 5", "a.hapf")
row("recover --force", "recover a.hapf --in-place --force", "--force requires OUT")
row("recover --in-place", "recover a.hapf o.hapf --in-place", "not both")
row("archive find --files", "archive find . --files --json", "--json does not go with --files")
row("archive find --null", "archive find . --null", "--null goes with --files")
row("profile check --path", "profile check glove5 --path /dev/none", "no HID device has the path")
row("profile check --descriptor", "profile check glove5 --descriptor x --path y", "not both")
row("demo --force", "demo --force", "--force requires --output or --plot")
for words in ("--seconds 1", "--seed 2", "--rate 5", "--preset paper", "--force"):
    row(f"scene {words.split()[0]}", f"scene --list {words}", SCENE)
row("scene --stiffness", "scene free o.npz --stiffness 5", "scene 'free' touches nothing")
row("scene --without", "scene cork o.npz --without ring", "scene 'cork' has no part 'ring'")
row("scene --preset", "scene cork o.npz --preset paper", "--preset requires a .hapf output")
row("scene --list", "scene cork --list", "--list takes no argument")
row("scene --show", "scene cork o.npz --show", "--show takes no OUT")
for words in (
    "--device glove5",
    "--sound 1",
    "--wav o",
    "--dry-run",
    "--answers o",
    "--subject S1",
):
    row(
        f"study {words.split()[0]}", f"study s.toml --prepare {words}", "does not go with --prepare"
    )
for words in ("--gain 1", "--map a=1", "--ignore a", "--map-by-order", "--path x", "--no-watchdog"):
    row(f"study {words.split()[0]}", f"{STUDY} --dry-run {words}", "requires --device")
row("study --folder", "study --new s.toml a.hapf --folder o", "--folder does not go with --new")
row("study --new", "study s.toml --new --prepare", "choose one of --new and --prepare")
row("study --prepare", "study s.toml --prepare --summary", "choose one of")
row("study --summary", "study s.toml --prepare --summary", "choose one of")
row("study --plot", "study s.toml --prepare --plot o.png", "--plot requires --summary")
row("study --csv", "study s.toml --prepare --csv", "--csv requires --summary")
row("study --force", "study s.toml --prepare --force", "--force requires --new or --plot")
row("study --json", f"{STUDY} --dry-run --json", "--json requires --new, --prepare or --summary")
row("clocks --fit", "clocks a.hapf --fit", "--fit has nothing to fit")
row("clocks --delays", "clocks a.hapf --delays late", "--delays requires --fit")
row("clocks --segment", "clocks a.hapf --segment 1", "--segment requires --fit")
row("replay --path", f"{REPLAY} --path /dev/none", DRY)
row("replay --no-watchdog", f"{REPLAY} --no-watchdog", DRY)
row("replay --start", f"{REPLAY} --map fx=index --start 100", "the recording ends at 2 s")
row("replay --stop", f"{REPLAY} --map fx=index --start 1 --stop 0.5", "no samples between")
row("replay --map", f"{REPLAY} --map zz=index", "zz")
row("replay --ignore", f"{REPLAY} --map fx=index --ignore fy", "do not add --ignore")
row("replay --map-by-order", f"{REPLAY} --map fx=index --map-by-order", "do not add --map-by-order")
row("replay --force", f"{REPLAY} --force", "--force requires --record")
"""Verb and option -> a command on which it cannot act, and what is said about it."""


def walk(command: click.Command, name: str = "") -> Iterator[tuple[str, click.Command]]:
    if isinstance(command, click.Group):
        context = click.Context(command)
        for each in command.list_commands(context):
            found = command.get_command(context, each)
            assert found is not None
            yield from walk(found, f"{name} {each}".strip())
    else:
        yield name, command


@cache
def options() -> list[str]:
    """Of every verb, with its name: "decode --band"."""
    return [
        f"{verb} {max(param.opts, key=len)}"
        for verb, command in walk(cli)
        if verb not in ELSEWHERE
        for param in command.params
        if isinstance(param, click.Option) and not param.hidden
    ]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("silent")
    time = np.arange(2000) / 1000
    signal = np.stack([np.sin(6 * time), np.cos(6 * time)])
    hapfmt.write(signal, folder / "a.hapf", rate=1000, labels=["fx", "fy"], units="N")
    hapfmt.write(signal, folder / "b.hapf", rate=1000, labels=["fx", "fy"], units="N")
    (folder / "r.csv").write_text("t [s],fx [N]\n0,1\n0.5,2\n1,3\n1.5,4\n")
    (folder / "events.csv").write_text("time,text,layer\n1,slip,ben\n")
    (folder / "m.toml").write_text("")
    np.savez(folder / "x.npz", fx=signal[0], rate=1000.0)
    np.savez(folder / "wide.npz", fx=signal[0], fy=signal[1], rate=1000.0)
    hapfmt.save(hapfmt.read(folder / "a.hapf"), folder / "ours.h5")
    assert called("study", "--new", folder / "s.toml", folder / "a.hapf").code == 0
    return folder


def test_the_page_states_the_rule() -> None:
    rule = (__doc__ or "").split("\n")[0]
    assert rule in (ROOT / "docs" / "command-line.md").read_text("utf-8")


def test_every_option_has_a_row_or_a_reason() -> None:
    reasons = {each for each in options() if each.rsplit(" ", 1)[1] in ALWAYS} | {*ALWAYS_IN}
    assert {*options()} - {*ROWS} == reasons - {*ROWS}
    assert {*ROWS} | {*ALWAYS_IN} <= {*options()}, "a row without an option"
    assert {each.rsplit(" ", 1)[1] for each in options()} >= {*ALWAYS}


@pytest.mark.parametrize("option", ROWS)
def test_an_option_that_cannot_act_says_so(
    option: str, room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(room)
    command, text = ROWS[option]
    assert option.rsplit(" ", 1)[1] in command or "-o " in command
    said = called(*shlex.split(command))
    assert said.code or "note: " in said.err, said
    assert text in said.out + said.err, said


READ_ALWAYS = {
    "file": "is required",
    "others": "is refused, and the keyword that was meant is named",
    "format": "chooses the reader",
    "threads": "sets how the work is done, not what is done",
    "limits": "is a bound",
    "progress": "is called",
}
READ_ROWS = {
    "channels": ("a.hapf", {"channels": "zz"}, "no channel 'zz'"),
    "start": ("r.csv", {"start": 100}, "the recording ends at 2 s"),
    "stop": ("r.csv", {"stop": 0}, "No samples in this time range"),
    "rate": ("a.hapf", {"rate": 5}, "for other formats"),
    "transpose": ("x.npz", {"transpose": True}, "has nothing to transpose"),
    "select": ("a.hapf", {"select": "fx"}, "for other formats"),
    "clock": ("r.csv", {"clock": "log"}, "CSV files do not use clock"),
    "episode": ("r.csv", {"episode": 1}, "CSV files do not use episode"),
    "map": ("r.csv", {"map": "m.toml"}, "CSV files do not use map"),
    "keep_stamps": ("x.npz", {"keep_stamps": True}, "there are no time stamps to keep"),
    "band": ("a.hapf", {"band": "lf"}, "band 'lf' is all of it"),
    "exact": ("r.csv", {"exact": False}, "CSV has no corrections"),
    "max_memory": ("r.csv", {"max_memory": 9, "limits": hapfmt.Limits()}, "not both"),
}
"""Keyword of hapfmt.read -> a file on which it cannot act, the keywords, and what is said."""
MORE_ROWS = [
    ("ours.h5", {"keep_stamps": True}, "keep_stamps is not for a recording that hapfmt wrote"),
    ("wide.npz", {"transpose": True}, "has nothing to transpose"),
    ("r.csv", {"band": "hf"}, "a CSV file has no bands"),
    ("a.hapf", {"band": "hf"}, "would be empty"),
]


def test_every_keyword_of_read_has_a_row_or_a_reason() -> None:
    keywords = set(inspect.signature(hapfmt.read).parameters)
    assert keywords == {*READ_ALWAYS} | {*READ_ROWS} and not {*READ_ALWAYS} & {*READ_ROWS}


@pytest.mark.parametrize(("name", "given", "text"), [*READ_ROWS.values(), *MORE_ROWS])
def test_a_keyword_that_cannot_act_says_so(
    name: str, given: dict[str, object], text: str, room: Path
) -> None:
    with pytest.raises((hapfmt.HapfmtError, hapfmt.errors.DataWarning)) as caught:
        hapfmt.read(room / name, **given)  # type: ignore[arg-type]
    assert text in str(caught.value)


def test_transpose_of_arrays_whose_times_decide_is_noted(room: Path) -> None:
    import h5py

    with h5py.File(room / "times.h5", "w") as file:
        file["time"] = np.arange(50) / 10
        file["x"] = np.zeros((50, 3))
    found = {t: hapfmt.read(room / "times.h5", transpose=t) for t in (None, True, False)}
    assert len({len(each) for each in found.values()}) == 1
    for transpose, recording in found.items():
        said = any("transpose changes nothing" in n for n in recording.metadata.get("notes", []))
        assert said == (transpose is not None)
