"""Doubles near the ends of their range, and channels that are linear in them."""

from __future__ import annotations

import io
import json
import sys

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import hapfmt
from hapfmt.cli import cli
from hapfmt.encoder.settings import PRESETS
from hapfmt.recording import Channel, Recording

LARGEST, TINY = sys.float_info.max, 5e-324
RATE = 1000
SIZES = [1, 2, 20, 100, 900]
"""Relations are looked for from 800 samples on."""


def wide(rng, size):
    """Every exponent, and single values of any kind."""
    x = np.ldexp(rng.uniform(-1, 1, size), rng.integers(-1074, 1025, size))
    places = rng.random(size) < 0.1
    x[places] = rng.choice([LARGEST, -LARGEST, TINY, -TINY, 0.0, -0.0, 1.0], int(places.sum()))
    return x


SHAPES = {
    "noise": lambda rng, size: rng.uniform(-1, 1, size),
    "wave": lambda rng, size: np.sin(np.arange(size) / 50 + rng.uniform(0, 6)),
    "ends": lambda rng, size: rng.choice([-1.0, 1.0, TINY], size),
    "rise": lambda _, size: np.linspace(-1, 1, size),
    "steps": lambda rng, size: rng.integers(-8, 9, size) / 8,
    "wide": wide,
}
SCALES = [1.0, TINY * 9, 1e-310, 1e-300, 2.0**53, 1e60, 1e250, 1.7e308, LARGEST]
WEIGHTS = [1.0, -1.0, 0.5, -0.3, 1e-10, 1e10, 1e-300, 1e300]

shaped = st.tuples(st.sampled_from(list(SHAPES)), st.integers(0, 99), st.sampled_from(SCALES))
linear = st.tuples(st.just("linear"), st.sampled_from(WEIGHTS), st.sampled_from([0.0, 0.5, -1.0]))
"""In the channel before: weights of its sample, and of the sample before that."""

channels = st.builds(
    lambda first, others: [first, *others], shaped, st.lists(shaped | linear | linear, max_size=2)
)


def made(size, recipes):
    columns = []
    for how, a, b in recipes:
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            if how == "linear":
                source = columns[-1]
                x = source * a + np.concatenate(([0.0], source[:-1])) * b
            else:
                x = SHAPES[how](np.random.default_rng(a), size) * b
        columns.append(np.clip(np.nan_to_num(x), -LARGEST, LARGEST))
    return columns


def check(columns, preset, unit="N"):
    recording = Recording(
        tuple(Channel(x, RATE, label=f"c{i}", unit=unit) for i, x in enumerate(columns))
    )
    out = io.BytesIO()
    hapfmt.write(recording, out, preset=preset)
    back = hapfmt.read(out.getvalue())
    assert hapfmt.verify(out.getvalue(), against=recording).verdict == "intact"
    for x, channel in zip(columns, back.channels, strict=True):
        if preset == "lossless" or channel.calibration is None:
            assert channel.samples().tobytes() == x.tobytes()
    return out.getvalue()


ENDS, LARGE = ("ends", 1, LARGEST), ("noise", 1, 1e250)


@given(st.sampled_from(SIZES), channels, st.sampled_from(PRESETS), st.sampled_from(["N", "m", "1"]))
@example(900, [ENDS], "lossless", "N")
@example(900, [ENDS, ("linear", 1.0, 0.0)], "near-lossless", "m")
@example(900, [LARGE, ("linear", 1.0, 0.5), ("noise", 2, 1.0)], "perceptual", "1")
@example(900, [("rise", 1, LARGEST), ("wave", 2, LARGEST)], "perceptual", "m")
@example(900, [("noise", 1, 1.0), ("noise", 1, 1e-310)], "lossless", "N")
@example(900, [("wave", 0, 1e-300), ("noise", 0, TINY * 9)], "lossless", "N")
@example(100, [("noise", 0, 2.0**53)], "paper", "m")
@example(20, [("noise", 0, 2.0**53)], "perceptual", "N")
@pytest.mark.filterwarnings("ignore:no channel is known to be felt")
def test_doubles_of_any_size_come_back(size, recipes, preset, unit):
    """EXA-007: The exact values MUST be the numbers of the source, every bit of them."""
    check(made(size, recipes), preset, unit)


def test_large_words_part_no_others_from_each_other():
    """A track of channels side by side has no place for words; those before it are joined."""
    doubles = np.random.default_rng(3).normal(size=4000)
    large = np.random.default_rng(4).normal(size=4000) * 1e250
    one = len(check([doubles], "lossless"))
    apart = len(check([large], "lossless"))
    assert len(check([doubles, doubles * 2, large, doubles * 3], "lossless")) < 2.8 * one + apart


def test_errors_of_any_size_are_shown(tmp_path, capsys):
    """The range of the first is beyond the largest double, so a share of it says nothing."""
    rng = np.random.default_rng(5)
    for name in ("a", "b"):
        columns = rng.choice([LARGEST, -LARGEST, TINY], 900), rng.uniform(-1, 1, 900) * 1e307
        (tmp_path / f"{name}.hapf").write_bytes(check(columns, "lossless"))
    a, b = str(tmp_path / "a.hapf"), str(tmp_path / "b.hapf")
    assert cli.main(["verify", a, "--against", b, "--json"], standalone_mode=False) == 3
    first, second = json.loads(capsys.readouterr().out)["contracts"]
    assert first["range"] is None and 1.9e307 < second["range"] < 2e307
    assert cli.main(["verify", a, "--against", b], standalone_mode=False) == 3
    first, second = [row.split() for row in capsys.readouterr().out.splitlines()[3:5]]
    assert first[5:9] == ["inf", "N", "-", "-"]
    assert 50 < float(second[8]) <= 100
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    picture = str(tmp_path / "a.png")
    assert cli.main(["plot", a, "--against", b, "-o", picture], standalone_mode=False) == 0
