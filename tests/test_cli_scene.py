"""hapfmt scene: names, files, formats, what is refused before any work."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commands import run

import hapfmt
from hapfmt.encoder.settings import preset_of


def told(done) -> dict:
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_list(tmp_path):
    plain, asked = run("scene", cwd=tmp_path), run("scene", "--list", "--json", cwd=tmp_path)
    names = [row["name"] for row in told(asked)["scenes"]]
    assert names == ["cork", "everything", "free", "grasp", "sand", "stone", "taps", "wall"]
    assert all(name in plain.stdout.decode() for name in names)


def test_show_is_a_description(tmp_path):
    text = run("scene", "taps", "--show", cwd=tmp_path).stdout
    assert text.startswith(b"# Taps on wood")
    (tmp_path / "mine.toml").write_bytes(text.replace(b'"taps"', b'"mine"'))
    done = run("scene", "mine.toml", "a.npz", "--seconds", 0.2, "--json", cwd=tmp_path)
    assert told(done)["name"] == "mine"


@pytest.mark.parametrize("suffix", ["hapf", "npz", "csv", "npy"])
def test_every_format(suffix, tmp_path):
    name = f"a.{suffix}"
    done = run("scene", "sand", name, "--seconds", 0.5, "--seed", 3, "--json", cwd=tmp_path)
    got = told(done)
    assert got["channels"] == ["normal force"] and got["seconds"] == 0.5 and got["seed"] == 3
    assert got["work"]["height_count"] == got["work"]["contact_step_count"] == 10_000
    assert got["work"]["finger_count"] == 0
    path = str(tmp_path / name)
    back = hapfmt.read(path, rate=1000) if suffix == "npy" else hapfmt.read(path)
    assert back.channels[0].stored.size == 500 and back.sample_count == 500


def test_hapf_says_what_was_computed(tmp_path):
    done = run("scene", "wall", "w.hapf", "--seconds", 1, "--stiffness", "1e4", cwd=tmp_path)
    assert done.returncode == 0 and b"steps of contact in" in done.stdout
    assert b"heights" not in done.stdout and b"fingers" not in done.stdout
    scene = hapfmt.read(tmp_path / "w.hapf").metadata["scene"]
    assert scene["contact_n_per_m"] == 1e4 and scene["integrator"] == "exact"
    assert scene["work"].keys() == {
        "step_count", "contact_step_count", "channel_count", "sample_count"
    }  # fmt: skip


def test_the_preset_of_a_file(tmp_path):
    for given, preset in (((), "lossless"), (("--preset", "perceptual"), "perceptual")):
        name = f"{preset}.hapf"
        got = told(run("scene", "sand", name, "--seconds", 1, *given, "--json", cwd=tmp_path))
        assert got["preset"] == preset
        text = hapfmt.read(tmp_path / name).metadata["encoder"]
        assert preset_of(text) == preset and ("(texture 2" in text) is bool(given)


def test_the_same_again(tmp_path):
    for name in ("a.npz", "b.npz"):
        assert run("scene", "cork", name, "--seconds", 0.3, cwd=tmp_path).returncode == 0
    a, b = (np.load(tmp_path / name) for name in ("a.npz", "b.npz"))
    assert np.array_equal(a["x"], b["x"])


def test_options_reach_the_scene(tmp_path):
    done = run(
        "scene", "wall", "a.npz", "--seconds", 0.5, "--rate", 500, "--integrator", "implicit",
        "--dt", "1e-4", "--json", cwd=tmp_path,
    )  # fmt: skip
    got = told(done)
    assert got["integrator"] == "implicit" and got["step_hz"] == 10_000 and got["rate_hz"] == 500
    got = told(run("scene", "grasp", "g.npz", "--seconds", 0.2, "--without", "thumb",
                   "--without", "contact", "--json", cwd=tmp_path))  # fmt: skip
    assert got["work"]["step_count"] == 0 and got["work"]["finger_count"] == 4


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["velvet", "a.hapf"], "no scene 'velvet'; there are: cork"),
        (["sand"], "Give OUT, such as"),
        (["sand", "a.xyz"], "the suffix '.xyz' is not one of: .hapf .npz"),
        (["sand", "none/a.npz"], "does not exist"),
        (["sand", "there.npz"], "already exists; use --force to overwrite it"),
        (["sand", "a.npz", "--preset", "paper"], "--preset requires a .hapf output"),
        (["sand", "a.npz", "--seconds", "-1"], "seconds: -1.0 is out of range"),
        (["sand", "a.npz", "--seconds", "nan"], "seconds: nan is out of range"),
        (["sand", "a.npz", "--seed", "-1"], "seed: -1 is out of range"),
        (["sand", "a.npz", "--rate", "0"], "rate_hz: 0 is out of range"),
        (["sand", "a.npz", "--stiffness", "1e99"], "n_per_m: 1e+99 is out of range"),
        (["sand", "a.npz", "--dt", "1"], "tool.contact.dt_s: is longer than a tick"),
        (["free", "a.npz", "--stiffness", "10"], "'free' touches nothing"),
        (["sand", "a.npz", "--without", "toe"], "no part is called 'toe'"),
        (["sand", "a.npz", "--without", "tool"], "a scene of nothing"),
        (["wrong.toml", "a.npz"], "wrong.toml: tool.mass_kg: is a text; write a number"),
        (["sand", "a.npz", "--list"], "--list takes no argument"),
        (["--show"], "--show requires the name"),
        (
            [
                "wall",
                "a.npz",
                "--integrator",
                "explicit-euler",
                "--dt",
                "1e-3",
                "--stiffness",
                "1e6",
            ],
            "diverged after",
        ),
        (["everything", "a.npz", "--seconds", "36000"], "take a shorter time"),
    ],
)
def test_refused(words, message, tmp_path):
    (tmp_path / "there.npz").write_bytes(b"mine")
    (tmp_path / "wrong.toml").write_text("[tool]\nmass_kg = 'heavy'\n[tool.reach]\n")
    done = run("scene", *words, "--json", cwd=tmp_path)
    assert done.returncode in (1, 4) and message in done.stderr.decode()
    assert json.loads(done.stdout)["exit_code"] == done.returncode
    assert (tmp_path / "there.npz").read_bytes() == b"mine"
    assert not (tmp_path / "a.npz").exists()


def test_force_and_a_pipe(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"mine")
    done = run("scene", "taps", "a.npz", "--seconds", 0.2, "--force", cwd=tmp_path)
    assert done.returncode == 0 and len(np.load(tmp_path / "a.npz")["x"][0]) == 200
    done = run("scene", "taps", "-", "--seconds", 0.2, cwd=tmp_path)
    assert len(hapfmt.Reader(done.stdout).read().channels[0].stored) == 200


def test_saturation_is_told(tmp_path):
    done = run("scene", "taps", "a.npz", "--seconds", 1, "--stiffness", "1e7", cwd=tmp_path)
    assert done.returncode == 0 and b"at the end of their sensor's range" in done.stderr
