"""What a person meets who uses hapfmt for the first time: warnings, messages and printed objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import run

import hapfmt
from hapfmt import Channel, Recording
from hapfmt.errors import DataWarning

SINE = np.sin(np.arange(2000) / 50)
TYPO = "unit 'Newtno' is not known; did you mean 'N' \\(newton\\)\\? It is stored as the free text"


class TestUnits:
    def test_a_mistyped_unit_is_a_warning(self, tmp_path: Path) -> None:
        with pytest.warns(DataWarning, match=f"{TYPO} {{Newtno}}") as caught:
            hapfmt.write([SINE, SINE], tmp_path / "x.hapf", rate=1000, units="Newtno")
        assert len(caught) == 1 and caught[0].filename == __file__
        assert hapfmt.read(tmp_path / "x.hapf")[0].unit == "{Newtno}"

    def test_a_channel_shows_the_unit_that_is_stored(self, tmp_path: Path) -> None:
        with pytest.warns(DataWarning, match=TYPO) as caught:
            channel = Channel.from_physical(SINE, 1000, label="fx", unit="Newtno")
        assert caught[0].filename == __file__
        torque = Channel.from_physical(SINE, 1000, label="t", unit="Nm")
        hapfmt.write([channel, torque], tmp_path / "x.hapf")  # warns no more
        back = hapfmt.read(tmp_path / "x.hapf")
        assert [c.unit for c in back] == [channel.unit, torque.unit] == ["{Newtno}", "N.m"]

    def test_a_channel_with_an_unknown_unit_warns_when_it_is_written(self, tmp_path: Path) -> None:
        with pytest.warns(DataWarning, match=f"{TYPO} Newtno"):
            hapfmt.write(Channel(SINE, 1000, unit="Newtno"), tmp_path / "x.hapf")
        assert hapfmt.read(tmp_path / "x.hapf")[0].unit == "Newtno"

    @pytest.mark.parametrize("unit", ["{raw}", "{Newtno}", "count", "N", "newtons", "", "m/s^2"])
    def test_known_units_and_texts_in_braces_are_silent(self, unit: str) -> None:
        assert Recording.from_array(SINE, 1000, units=unit)[0].unit
        assert hapfmt.Input("x", 1000, unit).unit == unit

    def test_a_unit_that_resembles_nothing(self) -> None:
        with pytest.warns(DataWarning, match="'raw' is not known. It is stored as the free text"):
            Recording.from_array(SINE, 1000, units="raw")

    def test_inputs_and_columns(self, tmp_path: Path) -> None:
        with pytest.warns(DataWarning, match=TYPO):
            hapfmt.Input("x", 1000, "Newtno")
        table = tmp_path / "x.csv"
        table.write_text("t [s],x [Newtno],y [raw]\n0,1,2\n1,2,3\n", encoding="utf-8")
        with pytest.warns(DataWarning, match=TYPO) as caught:
            hapfmt.read(table)
        assert len(caught) == 1

    def test_command_line(self, tmp_path: Path) -> None:
        np.save(tmp_path / "x.npy", SINE)
        done = run("encode", "x.npy", "x.hapf", "--rate", 1000, "--unit", "Newtno", cwd=tmp_path)
        note = b"note: unit 'Newtno' is not known; did you mean 'N' (newton)?"
        assert done.returncode == 0 and done.stderr.count(note) == 1
        done = run(
            "record", "y.hapf", "--rate", 1000, "--unit", "Newtno", cwd=tmp_path, stdin=b"1\n2\n"
        )
        assert done.returncode == 0 and done.stderr.count(note) == 1
        done = run("encode", "x.npy", "z.hapf", "--rate", 1000, "--unit", "{raw}", cwd=tmp_path)
        assert done.returncode == 0 and b"not known" not in done.stderr
