"""The law of options: one that cannot act on its input is an error, or a note with the remedy.

The tables name every option of the verbs that encode, and every keyword of ``hapfmt.write`` and
``hapfmt.Recorder``. A row is a call in which the option can do nothing, and what is said then; or
the reason why there is no such call.
"""

from __future__ import annotations

import inspect
import io
import json
import re
import warnings
from dataclasses import fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from commands import run as run_verb
from terminal import called

import hapfmt
from hapfmt import Calibration, Channel, Input, ParameterError, Recorder, Recording, Settings
from hapfmt.cli import cli
from hapfmt.errors import DataWarning

ACTS = "acts on every input"
LIMITS = "is a limit or an upper length, which need not be reached"
ALLOWS = "allows, forbids or confirms a thing, which need not be there"
SATISFIED = (ACTS, LIMITS, ALLOWS)

NOT_FELT = "no channel is known to be felt: add --unit N or --felt all"
PERCEPTUAL = "--preset perceptual"

ENCODER_OPTIONS: dict[str, str | tuple[str, str]] = {
    "preset": ACTS,
    "quality": (f"volts.npz OUT {PERCEPTUAL} --quality high", f"--quality would do nothing: {NOT_FELT}"),
    "max_error": (f"force.npz OUT {PERCEPTUAL} --max-error 1%", "--max-error does nothing here: every channel is felt .* channels is --floor"),
    "felt": (f"timed.npz OUT {PERCEPTUAL} --felt frame_index", "--felt does nothing for 'frame_index': it is lossless"),
    "texture": (f"volts.npz OUT {PERCEPTUAL} --no-texture", f"--no-texture would do nothing: {NOT_FELT}"),
    "bitrate": (f"volts.npz OUT {PERCEPTUAL} --bitrate 9", f"--bitrate would do nothing: {NOT_FELT}"),
    "effort": ("force.npz OUT --preset paper --effort best", "--effort requires preset lossless or .*, not paper"),
    "fast": ("force.npz OUT --preset paper --fast", "--effort requires preset lossless or .*, not paper"),
    "force_error": ("force.npz OUT --preset near-lossless --max-error 50% --force-error", "--force-error would do nothing: give a --max-error in a unit or in lsb"),
    "k": (f"volts.npz OUT {PERCEPTUAL} --k 5%", f"--k would do nothing: {NOT_FELT}"),
    "floor": (f"volts.npz OUT {PERCEPTUAL} --floor 1%", f"--floor would do nothing: {NOT_FELT}"),
    "snr": (f"volts.npz OUT {PERCEPTUAL} --snr 15", f"--snr would do nothing: {NOT_FELT}"),
    "st_sim": (f"volts.npz OUT {PERCEPTUAL} --st-sim 0.9", f"--st-sim would do nothing: {NOT_FELT}"),
    "synthetic_texture": (f"still.npz OUT {PERCEPTUAL} --synthetic-texture", "--synthetic-texture would do nothing: no felt channel has a texture. Each is constant"),
    "bits": ("force.npz OUT --bits 5", "--bits requires preset paper, not lossless"),
    "step": ("force.npz OUT --preset paper --bits 0 --step 1", "give the bits or the step"),
    "texture_codec": (f"still.npz OUT {PERCEPTUAL} --texture-codec LPCR", "--texture-codec would do nothing: no felt channel has a texture"),
    "weighting": (f"volts.npz OUT {PERCEPTUAL} --felt all --weighting 0.5", "--weighting would do nothing: no threshold of vibration is known for voltage"),
    "cutoff_hz": (f"force.npz OUT {PERCEPTUAL} --no-texture --cutoff 30", "--no-texture leaves no texture, so give no --cutoff for it"),
    "interpolation": ("force.npz OUT --interpolation hold", "--interpolation requires preset paper"),
    "tolerance": ("counts.hapf OUT --preset near-lossless --tolerance 0.1", "--tolerance would do nothing: no floating point channel may have an error"),
    "references": ("force.npz OUT --preset paper --no-references", "--no-references requires preset lossless"),
    "cluster": LIMITS,
    "digest": ACTS,
    "vectors": ("force.npz OUT --preset near-lossless --vector 0,1", "--vector requires preset perceptual or paper"),
    "rate": ("counts.hapf OUT --rate 500", "--rate is for inputs of other formats than .hapf"),
    "transpose": ("force.csv OUT --transpose", "CSV files do not use transpose; it is for: NumPy"),
    "select": ("force.npz OUT --select other", "other"),
    "clock": ("force.npz OUT --clock log", "do not use clock; it is for: MCAP"),
    "episode": ("force.npz OUT --episode 0", "do not use episode; it is for: XDF"),
    "map": ("force.npz OUT --map map.toml", "do not use map; it is for: HDF5"),
    "keep_stamps": ("force.npz OUT --keep-stamps", "no time stamps to keep"),
    "labels": ("counts.hapf OUT --labels a,b", "--labels and --unit require .npz"),
    "unit": ("counts.hapf OUT --unit N", "--labels and --unit require .npz"),
    "input_format": ALLOWS,
    "canonical": ACTS,
    "overview": ACTS,  # or a note that there is no room for one: tests/test_overview.py
    "verbose": ("force.npz OUT -v --json", "-v does nothing beside --json"),
    "threads": LIMITS,
    "max_memory": LIMITS,
    "force": ALLOWS,
    "as_json": ("force.npz - --json", "--json does nothing with an output on standard output"),
    "help_all": ACTS,
}  # fmt: skip
"""Of encode. Its words are the input, the output and the options."""

CONVERT_OPTIONS = {
    **{
        name: row if isinstance(row, str) else (row[0].replace("counts.hapf OUT", "counts.hapf OUT.csv"), row[1])
        for name, row in ENCODER_OPTIONS.items()
        if name in ("rate", "transpose", "select", "clock", "episode", "map", "keep_stamps")
        or name in ("labels", "unit", "input_format", "max_memory", "force")
    },
    "as_json": ("force.npz - --json --output-format hapf", "--json does nothing with an output on"),
    "output_format": ACTS,
    "schema": ("force.npz OUT --schema json", ".hapf files do not use schema"),
    "fps": ("force.npz OUT --fps 30", ".hapf files do not use fps"),
}  # fmt: skip

LIVE = f"{PERCEPTUAL} --no-texture --rate 1000 --lsb 0.001"
HEADER = "does nothing here: the header of the stream describes the channels"
RECORD_OPTIONS: dict[str, str | tuple[str, str]] = {
    "source": ACTS,
    "rate": ("OUT -i header.txt --rate 10", f"--rate {HEADER}"),
    "labels": ("OUT -i header.txt --labels a", f"--labels {HEADER}"),
    "unit": ("OUT -i header.txt --unit N", f"--unit {HEADER}"),
    "lsb": ("OUT -i header.txt --lsb 0.1", f"--lsb {HEADER}"),
    "preset": ACTS,
    "fast": ALLOWS,
    "max_error": (f"OUT -i bare.txt {LIVE} --unit N --max-error 0.1", "--max-error does nothing here: every channel is felt"),
    "force_error": (f"OUT -i bare.txt {LIVE} --unit N --force-error", "--force-error would do nothing"),
    "k": (f"OUT -i bare.txt {LIVE} --k 5%", f"--k would do nothing: {NOT_FELT}"),
    "floor": (f"OUT -i bare.txt {LIVE} --floor 2lsb", f"--floor would do nothing: {NOT_FELT}"),
    "felt": (f"OUT -i bare.txt {LIVE} --unit N --felt 0", "--felt does nothing for '1': its unit or quantity says"),
    "texture": ("OUT -i bare.txt --rate 1000 --no-texture", "--no-texture requires preset perceptual"),
    "cluster": LIMITS,
    "fsync": ("- -i bare.txt --rate 1000 --fsync 2", "fsync is for files"),
    "on_full": ALLOWS,
    "append": ACTS,
    "on_bad_line": ALLOWS,
    "at": ("OUT -i bare.txt --rate 1000 --at 3", "at requires append"),
    "clock_maps": ("OUT -i bare.txt --rate 1000 --clock-maps", "no clock was observed"),
    "canonical": ACTS,
    "force": ALLOWS,
    "as_json": ("- -i bare.txt --rate 1000 --json", "--json does nothing with an output on standard output"),
    "help_all": ACTS,
}  # fmt: skip

TABLES = {
    "encode": ENCODER_OPTIONS,
    "convert": CONVERT_OPTIONS,
    "record": RECORD_OPTIONS,
    "archive encode": {**ENCODER_OPTIONS, "jobs": LIMITS, "dask": ACTS, "log": ACTS},
}


def signal(count: int = 3000) -> np.ndarray:
    noise = np.random.default_rng(3).normal(0, 0.05, count)
    return np.round(2 + np.sin(0.01 * np.arange(count)) + noise, 3)


def channel(unit: str, label: str = "x", x: np.ndarray | None = None) -> Channel:
    return Channel.from_physical(signal() if x is None else x, 1000, label=label, unit=unit)


FORCE, VOLTS = channel("N"), channel("V")
STILL = channel("N", x=np.full(3000, 2.0))
CLOCK = channel("1", "frame_index", np.arange(3000.0))
COUNTS = Channel(
    np.rint(1000 * signal()).astype(np.int32), 1000, calibration=Calibration(1, 0, 1000), label="x"
)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    for name, *channels in (
        ("force", FORCE), ("volts", VOLTS), ("still", STILL), ("timed", FORCE, CLOCK),
    ):  # fmt: skip
        hapfmt.save(Recording(tuple(channels)), folder / f"{name}.npz")
    hapfmt.save(Recording((FORCE,)), folder / "force.csv")
    hapfmt.write(Recording((COUNTS,)), folder / "counts.hapf")
    rows = "\n".join(map(str, signal(200)))
    (folder / "bare.txt").write_text(rows)
    head = json.dumps({"channels": [{"label": "f", "rate": 1000}]})
    (folder / "header.txt").write_text(f"{head}\n{rows}\n")
    return folder


def command_of(verb: str) -> click.Command:
    first, *rest = verb.split()
    found = cli.get_command(click.Context(cli), first)
    for name in rest:
        found = found.commands[name]  # type: ignore[union-attr]
    assert found is not None
    return found


@pytest.mark.parametrize("verb", TABLES)
def test_every_option_has_a_row(verb: str) -> None:
    options = {p.name for p in command_of(verb).params if isinstance(p, click.Option)}
    assert options <= set(TABLES[verb]), options - set(TABLES[verb])
    if verb != "archive encode":
        assert set(TABLES[verb]) <= options


CASES = [
    pytest.param(verb, *row, id=f"{verb} {name}")
    for verb, table in TABLES.items()
    if verb != "archive encode"
    for name, row in table.items()
    if row not in SATISFIED
]


@pytest.mark.parametrize(("verb", "words", "said"), CASES)
def test_an_option_that_cannot_act_speaks(
    verb: str, words: str, said: str, room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "--st-sim" in words and not find_spec("vibromaf"):
        pytest.skip("needs vibromaf")
    monkeypatch.chdir(room)
    given = [word.replace("OUT", str(tmp_path / "out.hapf")) for word in words.split()]
    if "-" in given or verb == "record":
        done = run_verb(verb, *given, cwd=room)
        code, err = done.returncode, done.stderr.decode()
    else:
        code, _, err = called(verb, *given)
    err = re.sub(r"\s+", " ", err)
    assert re.search(said, err), err
    assert code or "note: " in err


PYTHON_NOT_FELT = "no channel is known to be felt: add unit='N' or felt='all'"
SETTINGS: dict[str, str | tuple[Channel, dict[str, Any], str]] = {
    "preset": ACTS,
    "k": (VOLTS, {"k": 0.05}, f"k would do nothing: {PYTHON_NOT_FELT}"),
    "floor": (VOLTS, {"floor": "1%"}, f"floor would do nothing: {PYTHON_NOT_FELT}"),
    "bits": (FORCE, {"bits": 5}, "bits requires preset paper"),
    "step": (FORCE, {"step": 1}, "step requires preset paper"),
    "cutoff_hz": (VOLTS, {"cutoff_hz": 30}, f"cutoff_hz would do nothing: {PYTHON_NOT_FELT}"),
    "cluster": LIMITS,
    "tolerance": (COUNTS, {"preset": "near-lossless", "tolerance": 0.1}, "tolerance would do nothing"),
    "interpolation": (FORCE, {"interpolation": "hold"}, "interpolation requires preset paper"),
    "digest": ACTS,
    "max_error": (FORCE, {"max_error": "1%"}, "max_error does nothing here: every channel is felt"),
    "force_error": (FORCE, {"force_error": True}, "force_error=True would do nothing: give a max_error"),
    "vectors": (FORCE, {"texture": False, "vectors": "required"}, "vectors would do nothing: no neighbours share a group"),
    "references": ALLOWS,
    "effort": (FORCE, {"preset": "paper", "effort": "fast"}, "effort requires preset lossless or"),
    "felt": (FORCE, {"felt": "x"}, "felt does nothing for 'x': its unit or quantity says that it is felt"),
    "texture": (VOLTS, {"texture": False}, f"texture=False would do nothing: {PYTHON_NOT_FELT}"),
    "smallest": ALLOWS,
    "quality": (STILL, {"quality": "high"}, "quality would do nothing: no felt channel has a texture"),
    "snr": (STILL, {"snr": 9}, "snr would do nothing: no felt channel has a texture"),
    "st_sim": (FORCE, {"preset": "lossless", "st_sim": 0.9}, "st_sim requires preset perceptual"),
    "bitrate": (STILL, {"bitrate": 9}, "bitrate would do nothing: no felt channel has a texture"),
    "synthetic_texture": (STILL, {"synthetic_texture": True}, "synthetic_texture=True would do nothing"),
    "texture_codec": (STILL, {"texture_codec": "MDCT"}, "texture_codec would do nothing"),
    "weighting": (channel("Pa"), {"weighting": 0.5}, "weighting would do nothing: no threshold of vibration is known for pressure"),
}  # fmt: skip
"""Fields of Settings, of preset perceptual unless a row says another."""

ARRAY = signal()
WRITE: dict[str, str | tuple[Any, dict[str, Any], str]] = {
    "settings": (ARRAY, {"rate": 1, "settings": Settings(), "fast": True}, "not both"),
    "rate": (FORCE, {"rate": 100}, "rate is for arrays; channels have their own"),
    "labels": (FORCE, {"labels": ["a"]}, "labels is for arrays"),
    "units": (FORCE, {"units": "N"}, "units is for arrays"),
    "transpose": ({"x": ARRAY}, {"rate": 1, "transpose": True}, "transpose is for arrays; a dict"),
    "events": ACTS,
    "preset": (ARRAY, {"rate": 1, "settings": Settings(), "preset": "lossless"}, "not both"),
    "canonical": ACTS,
    "force": ALLOWS,
    "overview": ACTS,
    "progress": ACTS,
    "threads": LIMITS,
    "options": (ARRAY, {"rate": 1, "speed": 3}, "no option 'speed'"),
}  # fmt: skip

ONE = Input("x", 1000, "V", lsb=0.001)
RECORDER: dict[str, str | tuple[dict[str, Any], str]] = {
    "settings": ({"settings": Settings.of("perceptual", texture=False, k=0.2)}, f"k would do nothing: {PYTHON_NOT_FELT}"),
    "cluster": ({"cluster": 2, "settings": Settings(cluster=3)}, "give the cluster or the settings its length"),
    "patience": LIMITS,
    "hold": LIMITS,
    "fsync": ({"fsync": 2.0}, "fsync is for files"),
    "queue_size": LIMITS,
    "on_full": ALLOWS,
    "append": ({"append": True}, "a stream that is only written cannot be appended to"),
    "at": ({"at": 3}, "at requires append"),
    "force": ALLOWS,
    "metadata": ACTS,
    "epoch_ns": ({"append": True, "epoch_ns": 5}, "epoch_ns is for a new file"),
    "epoch_uncertainty_ns": ({"epoch_ns": None, "epoch_uncertainty_ns": 5}, "epoch_uncertainty_ns requires epoch_ns"),
    "clock_maps": ({"clock_maps": True}, "clock_maps does nothing here: no clock was observed"),
    "canonical": ACTS,
}  # fmt: skip


def test_every_keyword_has_a_row() -> None:
    assert set(SETTINGS) == {field.name for field in fields(Settings)}
    assert set(WRITE) == set(inspect.signature(hapfmt.write).parameters) - {"recording", "file"}
    assert set(RECORDER) == set(inspect.signature(Recorder).parameters) - {"file", "inputs"}


def spoken(work: Any) -> str:
    """What an error or warnings of ours say."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            work()
        except ParameterError as error:
            return str(error)
    return "\n".join(str(one.message) for one in caught if one.category is DataWarning)


@pytest.mark.parametrize("name", [name for name, row in SETTINGS.items() if row not in SATISFIED])
def test_a_setting_that_cannot_act_speaks(name: str) -> None:
    channel, given, said = SETTINGS[name]
    given = {"preset": "perceptual", **given}
    if given == {"preset": "perceptual", name: given[name]} and name in ("bits", "step"):
        given["preset"] = "lossless"
    assert said in spoken(lambda: hapfmt.write(channel, io.BytesIO(), **given))


@pytest.mark.parametrize("name", [name for name, row in WRITE.items() if row not in SATISFIED])
def test_a_keyword_of_write_that_cannot_act_speaks(name: str) -> None:
    data, given, said = WRITE[name]
    assert said in spoken(lambda: hapfmt.write(data, io.BytesIO(), **given))


@pytest.mark.parametrize("name", [name for name, row in RECORDER.items() if row not in SATISFIED])
def test_a_keyword_of_the_recorder_that_cannot_act_speaks(name: str) -> None:
    given, said = RECORDER[name]

    def record() -> None:
        with Recorder(io.BytesIO(), [ONE], **given) as recorder:
            recorder.write("x", ARRAY[:200])

    assert said in spoken(record)


class TestMore:
    """Cases that a row alone does not show."""

    def test_no_felt_channel_is_a_note_where_no_option_was_given(self) -> None:
        said = spoken(lambda: hapfmt.write(VOLTS, io.BytesIO(), preset="perceptual"))
        assert said == f"{PYTHON_NOT_FELT}; until then channels are kept within 0.1 % of range"

    @pytest.mark.parametrize("channel", [STILL, CLOCK, FORCE])
    def test_nothing_is_said_where_the_preset_does_what_it_says(self, channel: Channel) -> None:
        assert not spoken(lambda: hapfmt.write(channel, io.BytesIO(), preset="perceptual"))

    def test_one_still_or_silent_channel_fails_nothing(self) -> None:
        both = [FORCE, replace(STILL, label="still")]
        given = {"preset": "perceptual", "quality": "high", "k": 0.2}
        assert not spoken(lambda: hapfmt.write(both, io.BytesIO(), **given))

    def test_steps_that_are_not_known(self) -> None:
        x = channel("N", x=np.random.default_rng(1).normal(size=500))
        given = {"preset": "near-lossless", "max_error": "2lsb"}
        said = spoken(lambda: hapfmt.write(x, io.BytesIO(), **given))
        assert said.startswith("max_error does nothing for 'x': no step is known")

    def test_references_that_fast_does_not_look_for(self) -> None:
        with pytest.raises(ParameterError, match="effort='fast' looks for no references"):
            Settings.of("lossless", fast=True, references=True)
