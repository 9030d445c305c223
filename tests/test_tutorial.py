"""The pictures of docs/getting-started.md are those that its commands draw."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pages import blocks, commands_of
from spec import ROOT
from test_tools import run

PAGE = ROOT / "docs" / "getting-started.md"
FOLDER = PAGE.parent / "pictures"
LARGEST = 80_000
SHOWN = re.findall(r"^!\[[^\]]{20,}\]\(pictures/([\w-]+\.png)\)$", PAGE.read_text("utf-8"), re.M)


def test_every_picture_follows_the_command_that_draws_it() -> None:
    assert 3 <= len(SHOWN) == len(set(SHOWN))
    lines = [
        command.line
        for block in blocks(PAGE)
        if block.kind == "console"
        for command in commands_of(block)
    ]
    drawn = [
        found[1] for line in lines if (found := re.search(r"^hapfmt plot .*-o ([\w.]+)", line))
    ]
    assert drawn == SHOWN
    assert {path.name for path in FOLDER.iterdir()} == set(SHOWN)
    assert all((FOLDER / name).stat().st_size <= LARGEST for name in SHOWN)


@pytest.mark.deep
def test_the_tool_draws_the_same_pictures(tmp_path: Path) -> None:
    """Another version of the drawing library may move a line by a pixel."""
    pytest.importorskip("matplotlib")
    image = pytest.importorskip("PIL.Image")
    done = run(str(ROOT / "tools" / "tutorial.py"), "-o", str(tmp_path), cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in tmp_path.iterdir()} == set(SHOWN)
    for name in SHOWN:
        assert f"{name}: {(tmp_path / name).stat().st_size} bytes" in done.stdout
        with image.open(tmp_path / name) as new, image.open(FOLDER / name) as old:
            assert new.size == old.size, f"run tools/tutorial.py: {name}"
            one, other = (np.asarray(each.convert("L"), np.int16) for each in (new, old))
        assert np.mean(np.abs(one - other) > 64) < 0.01, f"run tools/tutorial.py: {name}"
