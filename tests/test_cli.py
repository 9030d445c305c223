"""The command line: every verb, pipes, exit codes, refusals, JSON."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from commands import run, run_in_terminal
from terminal import called

import hapfmt
from hapfmt.cli import VERBS, cli
from hapfmt.lab.scenes.stylus import simulate

TABLE = {"intact": 0, "usage": 1, "nonconforming": 2, "damaged": 3, "unsupported": 4}


def run_json(*arguments: object, cwd: Path) -> tuple[int, Any]:
    done = run(*arguments, "--json", cwd=cwd)
    return done.returncode, json.loads(done.stdout)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """one.npz, one.hapf (texture), two.npz (two rates, gaps), flipped.hapf (one bit)."""
    folder = tmp_path_factory.mktemp("cli")
    one = simulate("sand", 1.0)
    hapfmt.save(one, folder / "one.npz")
    hapfmt.write(one, folder / "one.hapf", canonical=1)
    x = np.array([1.0, 2.0, np.nan, 4.0, 4.0, 5.0])
    two = hapfmt.Recording(
        (
            hapfmt.Channel.from_physical(x, 10, label="a", unit="N"),
            hapfmt.Channel.from_physical(np.arange(50.0), 100, label="b", unit="m"),
        )
    )
    hapfmt.save(two, folder / "two.npz")
    data = bytearray((folder / "one.hapf").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "flipped.hapf").write_bytes(data)
    return folder


def test_help_names_every_verb(room: Path) -> None:
    text = run("--help", cwd=room).stdout.decode()
    assert all(verb in text for verb in VERBS)
    for verb in VERBS:
        done = run(verb, "--help", cwd=room)
        assert done.returncode == 0 and b"Usage" in done.stdout


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("encode a b --from npz", "--from was renamed --input-format"),
        ("convert a b --to npz", "--to was renamed --output-format"),
        ("decode a b --time 1:2", "--time was renamed --start and --stop"),
        ("plot a --out b.png", "--out was renamed --output"),
        ("attach a --extract --to b", "--to was renamed --output"),
        ("annotate a --from b.csv", "--from was renamed --table"),
        ("record a --from b", "--from was renamed --input"),
        ("replay a --device b --from 1", "--from was renamed --start"),
        ("replay a --device b --to 1", "--to was renamed --stop"),
        ("replay a --device b --channels 0=1", "--channels was renamed --map"),
        ("clocks a --window 3", "--window was renamed --segment"),
        ("profile check a --device b", "--device was renamed --path"),
        ("encode a b --presett lossless", "did you mean '--preset'"),
        ("du a --from npz", "no option '--from'"),
        ("encode a b --gains 2", "no option '--gains'\n"),
        ("verify a --against b --threat 2", "did you mean '--threads'"),
        ("annotate a --at 1 --text contact", "TEXT is an argument: write it without --text\n"),
    ],
)
def test_options_of_an_earlier_version_name_those_of_today(words: str, name: str) -> None:
    said = called(*words.split())
    assert said.code == 1 and name in said.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("touch.hapf", "no verb 'touch.hapf'; did you mean hapfmt info touch.hapf?\n"),
        ("'my touch.csv' x", "did you mean hapfmt info 'my touch.csv'?\n"),
        ("https://x.org/a", "did you mean hapfmt info https://x.org/a?\n"),
        ("inf", "no verb 'inf'; did you mean 'info'?\n"),
        ("rate", "no verb 'rate'\nTry 'hapfmt --help'.\n"),
        ("replay a.hapf --dry-run", "--device is missing: The profile of the device"),
        ("replay a.hapf --dry-run", "(hapfmt profile list)"),
    ],
)
def test_what_was_meant(words: str, said: str) -> None:
    done = called(*shlex.split(words))
    assert done.code == 1 and said in done.err.replace("python -m pytest.", ""), done.err


def test_a_file_with_kept_stamps_against_an_original_without(tmp_path: Path) -> None:
    original, file = tmp_path / "a.csv", tmp_path / "a.hapf"
    original.write_text("t [s],x\n0,1\n1.001,2\n2,3\n")
    assert called("encode", original, file, "--keep-stamps").code == 0
    said = called("verify", file, "--against", original)
    assert said.code == 1 and "channels of time stamps were kept: add --keep-stamps" in said.err
    assert called("verify", file, "--against", original, "--keep-stamps").code == 0


def test_a_csv_without_a_header_gets_one_proposed(tmp_path: Path) -> None:
    """Each header that the message proposes makes the table readable."""
    path = tmp_path / "a.csv"
    path.write_text("0,2,3\n1,4,3\n2,4,3\n")
    said = called("info", path)
    timed, plain = re.findall("'(.*?)'", said.err)
    assert said.code == 1 and "with a rate (--rate)" in said.err
    for header, more in ((timed, []), (plain, ["--rate", "10"])):
        (tmp_path / "b.csv").write_text(f"{header}\n{path.read_text()}")
        assert called("info", tmp_path / "b.csv", *more).code == 0


def test_a_folder_is_called_one(tmp_path: Path) -> None:
    said = called("info", tmp_path)
    assert said.code == 1 and f"{tmp_path}: this is a folder, and holds none of" in said.err


def test_an_option_name_has_one_kind_of_value() -> None:
    """No verb takes a format, a time or a path where another takes something else."""
    kinds: dict[str, set[str]] = {}
    for verb in VERBS:
        command = cli.get_command(click.Context(cli), verb)
        for each in getattr(command, "commands", {"": command}).values():
            for option in each.params:
                for name in option.opts if isinstance(option, click.Option) else ():
                    kinds.setdefault(name, set()).add(option.type.name)
    assert not {"--from", "--to", "--time", "--out"} & set(kinds)
    for name in ("--input-format", "--start", "--stop", "--output", "--input", "--map", "--path"):
        assert len(kinds[name] - {"path"}) <= 1, name


def test_encode_verify_decode(room: Path, tmp_path: Path) -> None:
    code, told = run_json(
        "encode", room / "one.npz", "o.hapf", "--preset", "near-lossless", "--max-error", "0.2%",
        cwd=tmp_path,
    )  # fmt: skip
    assert code == 0 and told["file_size"] == (tmp_path / "o.hapf").stat().st_size
    assert told["channels"][0]["within"]
    code, report = run_json("verify", "o.hapf", "--against", room / "one.npz", cwd=tmp_path)
    assert code == 0 and report["verdict"] == "intact"
    contract = report["contracts"][0]
    assert contract["outside_count"] == contract["missing_count"] == 0
    assert 0 < contract["worst_ratio"] <= 1
    assert run("decode", "o.hapf", "o.npz", cwd=tmp_path).returncode == 0
    x, y = np.load(room / "one.npz")["x"], np.load(tmp_path / "o.npz")["x"]
    assert 0 < np.abs(x - y).max() <= 0.002 * (x.max() - x.min())


def test_without_a_preset_the_identical_array_comes_back(room: Path, tmp_path: Path) -> None:
    run("encode", room / "one.npz", "o.hapf", cwd=tmp_path)
    run("decode", "o.hapf", "o.npz", cwd=tmp_path)
    x, y = np.load(room / "one.npz")["x"], np.load(tmp_path / "o.npz")["x"]
    assert x.tobytes() == y.tobytes()


def test_pipes(room: Path) -> None:
    coded = run(
        "encode", "-", "-", "--input-format", "npz", cwd=room, stdin=(room / "one.npz").read_bytes()
    )
    assert coded.returncode == 0 and coded.stdout.startswith(b"\x8fHAP")
    for verb in ("info", "verify", "du", "dump"):
        assert run(verb, "-", cwd=room, stdin=coded.stdout).returncode == 0
    text = run("decode", "-", "-", "--output-format", "csv", cwd=room, stdin=coded.stdout)
    assert text.stdout.splitlines()[0] == b"t [s],normal force [N]"
    assert len(text.stdout.splitlines()) == 1001


def test_pipe_without_a_format_is_refused(room: Path) -> None:
    done = run("encode", "-", "out.hapf", cwd=room, stdin=b"")
    assert done.returncode == 1 and b"--input-format" in done.stderr


def test_several_rates_and_gaps_come_back(room: Path, tmp_path: Path) -> None:
    run("encode", room / "two.npz", "o.hapf", cwd=tmp_path)
    run("decode", "o.hapf", "o.npz", cwd=tmp_path)
    before, after = hapfmt.read(room / "two.npz"), hapfmt.read(tmp_path / "o.npz")
    for a, b in zip(before.channels, after.channels, strict=True):
        assert a.coverage == b.coverage and a.rate_exact == b.rate_exact and a.label == b.label
        assert a.samples().tobytes() == b.samples().tobytes()


def test_parts(room: Path, tmp_path: Path) -> None:
    split = tmp_path / "split.hapf"
    run("scene", "sand", "sand.npz", cwd=tmp_path)
    assert run("encode", "sand.npz", split, "--preset", "paper", cwd=tmp_path).returncode == 0
    whole = hapfmt.read(split).channels[0]
    for band in ("full", "lf", "hf"):
        done = run(
            "decode", split, f"{band}.npz", "--start", "0.25", "--stop", "0.5", "--band", band,
            "--channels", "0", cwd=tmp_path,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    part = hapfmt.read(tmp_path / "full.npz").channels[0]
    assert part.start_tick == 250 and part.stored.size == 250
    assert (part.samples() == whole.samples()[250:500]).all()
    assert (
        run("decode", room / "one.hapf", "x.npz", "--channels", "no", cwd=tmp_path).returncode == 1
    )


def test_existing_output_is_refused_without_force(room: Path, tmp_path: Path) -> None:
    for arguments in (
        ("encode", room / "one.npz", "o.hapf"),
        ("decode", room / "one.hapf", "o.npz"),
        ("convert", room / "one.npz", "o.csv"),
        ("demo", "--seconds", "0.5", "--output", "d.hapf"),
    ):
        target = tmp_path / str(arguments[-1])
        target.write_bytes(b"precious")
        done = run(*arguments, cwd=tmp_path)
        assert done.returncode == 1 and b"exists" in done.stderr, arguments
        assert target.read_bytes() == b"precious"
        assert run(*arguments, "--force", cwd=tmp_path).returncode == 0
        assert target.read_bytes() != b"precious"
    assert not list(tmp_path.glob(".*.tmp"))


def test_a_failed_write_leaves_nothing(room: Path, tmp_path: Path) -> None:
    done = run("decode", room / "one.hapf", "o.wav", "--stop", "nonsense", cwd=tmp_path)
    assert done.returncode == 1 and not list(tmp_path.iterdir())


class TestExitCodes:
    """VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood."""

    READERS = ("info", "verify", "du", "dump", "decode")

    def codes(self, path: Path, room: Path) -> dict[str, int]:
        found = {}
        for verb in self.READERS:
            extra = ["-", "--output-format", "csv"] if verb == "decode" else []
            found[verb] = run(verb, path, *extra, cwd=room).returncode
        return found

    def test_intact(self, room: Path) -> None:
        assert set(self.codes(room / "one.hapf", room).values()) == {TABLE["intact"]}

    def test_usage(self, room: Path) -> None:
        assert run("info", "missing.hapf", cwd=room).returncode == TABLE["usage"]
        assert run("info", cwd=room).returncode == TABLE["usage"]
        assert run("nonsense", cwd=room).returncode == TABLE["usage"]
        assert run("encode", "one.npz", "x.hapf", "--k", "x", cwd=room).returncode == TABLE["usage"]

    def test_nonconforming(self, room: Path, tmp_path: Path) -> None:
        path = tmp_path / "text.hapf"
        path.write_bytes(b"this is no recording at all")
        assert set(self.codes(path, room).values()) == {TABLE["nonconforming"]}

    def test_damaged(self, room: Path) -> None:
        codes = self.codes(room / "flipped.hapf", room)
        assert codes["verify"] == codes["decode"] == codes["dump"] == TABLE["damaged"]

    def test_unsupported(self, room: Path, tmp_path: Path) -> None:
        from hapfmt.writing.filewriter import FileWriter

        path = tmp_path / "future.hapf"
        with path.open("wb") as stream:
            writer = FileWriter(stream)
            writer.chunk("STRA", b"what is this?")
            writer.close()
        codes = self.codes(path, room)
        assert codes["decode"] == codes["verify"] == codes["info"] == TABLE["unsupported"]


def test_damage_is_told_and_the_rest_delivered(room: Path, tmp_path: Path) -> None:
    done = run("decode", room / "flipped.hapf", "o.csv", cwd=tmp_path)
    assert done.returncode == 3 and b"damage in 1 place" in done.stderr and b"lost" in done.stderr
    assert (tmp_path / "o.csv").exists()
    code, report = run_json("verify", room / "flipped.hapf", cwd=tmp_path)
    damages = report["damage"]["damages"]
    assert code == 3 and damages[0]["offset"] > 0 and any(damage["lost"] for damage in damages)


def test_errors_as_json(room: Path) -> None:
    done = run("info", "missing.hapf", "--json", cwd=room)
    assert json.loads(done.stdout)["exit_code"] == 1


def test_du_adds_up(room: Path) -> None:
    for name in ("one.hapf", "flipped.hapf"):
        code, usage = run_json("du", room / name, cwd=room)
        assert code == (3 if name == "flipped.hapf" else 0)
        assert sum(usage["causes"].values()) == usage["file"] == (room / name).stat().st_size
        assert usage["payload"] == sum(t["packets_size"] for t in usage["tracks"])
        assert all(size >= 0 for size in usage["causes"].values())


def test_dump_is_canonical_json(room: Path) -> None:
    a, b = (run("dump", "one.hapf", "--counts", cwd=room).stdout for _ in range(2))
    chunks = json.loads(a)
    assert a == b and chunks[-1] == {"findings": [], "exit_code": 0}
    assert chunks[0]["type"] == "HEAD"
    numbers = [p["numbers"] for c in chunks[:-1] for p in c.get("packets", ()) if p["track"] == 0]
    assert sum(map(len, numbers)) == 1000


def test_convert_to_every_format_and_back(room: Path, tmp_path: Path) -> None:
    pytest.importorskip("soundfile")
    before = hapfmt.read(room / "one.npz").channels[0].samples()
    for suffix in ("csv", "wav", "npy", "npz"):
        assert run("convert", room / "one.npz", f"o.{suffix}", cwd=tmp_path).returncode == 0
        rate = 1000 if suffix == "npy" else None
        after = hapfmt.read(tmp_path / f"o.{suffix}", rate=rate).channels[0].samples()
        assert (before == after).all()
    assert run("convert", "o.csv", "o.hapf", cwd=tmp_path).returncode == 0
    assert run("convert", "o.hapf", "p.hapf", cwd=tmp_path).returncode == 1


def test_channels_become_the_axes_of_a_vector(tmp_path: Path) -> None:
    x = np.random.default_rng(1).integers(-900, 900, (4, 500)) / 1000
    np.savez(tmp_path / "v.npz", x=x, rate_hz=1000.0, channel_names=list("abcd"), unit="N")
    felt = ("--preset", "perceptual", "--no-texture")
    done = run("encode", "v.npz", "v.hapf", *felt, "--vector", "b,c,3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    _, found = run_json("info", "v.hapf", cwd=tmp_path)
    assert [c["axis"] for c in found["channels"]] == ["", "x", "y", "z"]
    assert [c["contract"]["vector"] for c in found["channels"]] == [False, True, True, True]
    assert (
        run("encode", "v.npz", "w.hapf", *felt, "--vector", "b,nobody", cwd=tmp_path).returncode
        == 1
    )


def test_channels_that_resemble_each_other(tmp_path: Path) -> None:
    load = np.random.default_rng(1).integers(-40, 41, 900).cumsum()
    x = np.stack([load, load // 2, load // 3]).astype(float)
    np.savez(tmp_path / "s.npz", x=x, rate_hz=1000.0, channel_names=list("abc"))
    _, both = run_json("encode", "s.npz", "s.hapf", "--preset", "lossless", cwd=tmp_path)
    assert [c["reason"] for c in both["channels"]] == [
        "lossless, track of 0-2",
        "lossless, track of 0-2, from 0",
        "lossless, track of 0-2, from 0",
    ]
    options = ("--preset", "lossless", "--no-references")
    _, alone = run_json("encode", "s.npz", "t.hapf", *options, cwd=tmp_path)
    assert {c["reason"] for c in alone["channels"]} == {"lossless"}
    assert both["file_size"] < alone["file_size"]
    done = run("verify", "s.hapf", "--against", "s.npz", cwd=tmp_path)
    assert (done.returncode, "intact" in done.stdout.decode()) == (0, True)


def test_demo(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    code, told = run_json(
        "demo", "--texture", "stone", "--seconds", "2", "--plot", "d.png", "--output", "d.hapf",
        cwd=tmp_path,
    )  # fmt: skip
    assert code == 0
    rows = {row["name"]: row for row in told["settings"]}
    assert list(rows) == [
        "lossless", "near-lossless", "perceptual", "perceptual --no-texture", "paper",
    ]  # fmt: skip
    errors = {name: row["largest_error"] for name, row in rows.items()}
    assert errors["lossless"] == 0 < errors["near-lossless"] < errors["perceptual --no-texture"]
    sizes = {name: row["file_size"] for name, row in rows.items()}
    assert sizes["perceptual --no-texture"] < sizes["near-lossless"] < sizes["lossless"]
    assert (tmp_path / "d.png").read_bytes().startswith(b"\x89PNG")
    assert hapfmt.verify(tmp_path / "d.hapf").verdict == "intact"
    assert (tmp_path / "d.hapf").stat().st_size == sizes["lossless"]


def test_demo_shows_every_column_on_a_terminal_of_80(tmp_path: Path) -> None:
    lines = run_in_terminal("demo", "--seconds", "1", cwd=tmp_path).stdout.decode().splitlines()
    assert not any("not shown" in line for line in lines)
    (header,) = (line for line in lines if line.startswith("preset "))
    assert header.split() == ["preset", "bytes", "smaller", "largest", "error", "texture", "kept"]
    starts = [line.split("  ")[0] for line in lines[lines.index(header) + 2 :]]
    names = ["lossless", "near-lossless", "perceptual", "perceptual --no-texture", "paper", ""]
    assert starts[:6] == names


def test_text_from_a_file_cannot_steer_the_terminal(tmp_path: Path) -> None:
    channel = hapfmt.Channel(np.zeros(3, np.int32), 1, calibration=hapfmt.Calibration(),
                             label="\x1b[2Jevil")  # fmt: skip
    hapfmt.write(hapfmt.Recording((channel,)), tmp_path / "e.hapf")
    for verb in ("info", "du", "verify"):
        assert b"\x1b" not in run(verb, "e.hapf", cwd=tmp_path).stdout


def test_a_broken_pipe_is_quiet(room: Path) -> None:
    script = f'"{sys.executable}" -m hapfmt dump one.hapf --counts | head -c 10 >/dev/null'
    done = subprocess.run(["sh", "-c", script], cwd=room, capture_output=True, check=False)
    assert done.stderr == b""
