"""What a person meets who uses hapfmt for the first time: warnings, messages and printed objects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run

import hapfmt
from hapfmt import Channel, ParameterError, Recording
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


def damaged(tmp_path: Path) -> tuple[Path, bytes]:
    """A file of which one packet is broken, and its bytes before."""
    path = tmp_path / "bad.hapf"
    x = np.random.default_rng(1).normal(size=(3, 20_000))
    hapfmt.write(
        x, path, rate=1000, labels=["a", "b", "c"], cluster=5, references=False, canonical=7
    )
    data = path.read_bytes()
    with hapfmt.Reader(data) as reader:
        at = reader.catalogue.data[1].offset + 40_000
    path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    return path, data


class TestReports:
    def test_they_print_what_the_command_line_prints(self, tmp_path: Path) -> None:
        path, _ = damaged(tmp_path)
        report = hapfmt.verify(path)
        done = hapfmt.recover(path, tmp_path / "good.hapf")
        for each, verb, out in ((report, "verify", ()), (done, "recover", ("again.hapf",))):
            assert each.summary and repr(each).splitlines()[1:] == [f"  {s}" for s in each.summary]
            assert max(map(len, repr(each).splitlines())) < 120
            shown = run(verb, "bad.hapf", *out, cwd=tmp_path)
            for sentence in each.summary:
                assert sentence in (shown.stdout + shown.stderr).decode()
            assert each.headline() in shown.stdout.decode()

    def test_against(self, tmp_path: Path) -> None:
        hapfmt.write(SINE, tmp_path / "x.hapf", rate=1000)
        report = hapfmt.verify(tmp_path / "x.hapf", against=hapfmt.read(tmp_path / "x.hapf"))
        assert repr(report).splitlines() == [
            "Report: intact; 1 packet, 2000 samples",
            "  every sample equals the original; none is missing, none was added",
        ]

    def test_losses_have_labels_and_seconds(self, tmp_path: Path) -> None:
        path, _ = damaged(tmp_path)
        done = hapfmt.recover(path, tmp_path / "good.hapf")
        assert [(p.labels, p.start, p.stop) for p in done.lost] == [(("b",), 5.0, 10.0)]
        assert hapfmt.verify(path).lost == done.lost

    def test_damage_is_as_large_as_the_packet_that_is_lost(self, tmp_path: Path) -> None:
        path, data = damaged(tmp_path)
        first, *_ = hapfmt.verify(path).summary
        size = int(first.split(", ")[1].split(" bytes")[0])
        assert first.startswith("damage in 1 place, ") and 30_000 < size < 45_000 < len(data) / 9
        with hapfmt.Reader(path) as reader:
            reader.read()
            assert "1 damaged place, 1 lost part" in repr(reader)

    @pytest.mark.parametrize("call", [hapfmt.verify, hapfmt.Reader, hapfmt.edit.Original])
    def test_a_recording_is_no_file(self, call: Callable[[Any], Any], tmp_path: Path) -> None:
        rec = Recording.from_array(SINE, 1000)
        message = "a file is a path, a URL, bytes or a binary stream, not a Recording"
        with pytest.raises(ParameterError, match=message):
            call(rec)
        with pytest.raises(ParameterError, match=message):
            hapfmt.recover(rec, tmp_path / "x.hapf")  # type: ignore[arg-type]

    def test_read_names_recover(self, tmp_path: Path) -> None:
        path, _ = damaged(tmp_path)
        with pytest.raises(hapfmt.FormatError, match=r"hapfmt\.recover\(file, into\) writes"):
            hapfmt.read(path)
