"""What a person meets who uses hapfmt for the first time: warnings, messages and printed objects."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run, run_in_terminal

import hapfmt
from hapfmt import Channel, ParameterError, Recording
from hapfmt.errors import DataWarning, MovedTimesWarning

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

    @pytest.mark.filterwarnings("error")
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
            "Report: intact; 2 packets, 2000 samples",
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


class TestPrinting:
    def test_twenty_channels_in_columns(self) -> None:
        rec = Recording.from_array(np.zeros((20, 50)), 1000)
        assert len(repr(rec).splitlines()) == 21 and "more" not in repr(rec)
        rec = Recording.from_array(np.zeros((21, 50)), 1000)
        *_, ninth, tenth, last = [*repr(rec).splitlines()[:11], repr(rec).splitlines()[-1]]
        assert ninth.index("50 samples") == tenth.index("50 samples")
        assert last == "  ... and 1 more channel (rec.labels lists all)"

    def test_a_part_shows_where_it_begins(self) -> None:
        rec = Recording.from_array(SINE, 1000)
        assert repr(rec).startswith("Recording: 1 channel, 2000 samples, 2 s\n")
        assert repr(rec.sel(start=1, stop=1.5)).startswith(
            "Recording: 1 channel, 500 samples, 1 to 1.5 s\n"
        )

    def test_summary(self, tmp_path: Path) -> None:
        rec = Recording.from_array(np.zeros((21, 50)), 1000, labels=[f"<{i}>" for i in range(21)])
        summary = hapfmt.write(rec, tmp_path / "x.hapf")
        assert len(repr(summary).splitlines()) == 22
        assert "... and 1 more channel (" in repr(summary)
        assert summary._repr_html_().count("<tr>") == 22 and "&lt;20&gt;" in summary._repr_html_()

    def test_event(self) -> None:
        assert repr(hapfmt.Event(3, "contact")) == "Event 3 s 'contact'"
        event = hapfmt.Event(0.5, "x", 2, "fx", layer="notes")
        assert repr(event) == "Event 0.5 s 'x', 2 s long, channel 'fx', layer 'notes'"

    def test_recorder_and_status(self, tmp_path: Path) -> None:
        path = tmp_path / "x.hapf"
        with hapfmt.Recorder(path, [hapfmt.Input("a", 1000, "N")]) as recorder:
            recorder.write("a", SINE[:1500])
            recorder.flush()
            status, shown = recorder.status(), repr(recorder)
        size = status.file_size
        assert shown == f"Recorder {str(path)!r}: 1 channel, 1.5 s, {size} bytes"
        assert repr(status).startswith(
            "Status: 1.5 s, 1500 samples taken, 0 missing, 0 dropped, 1500 written; "
            f"2 clusters, {size} bytes in the file, 1.5 s survive a crash, encoded "
        ) and repr(status).endswith(" times as fast as recorded")
        assert repr(recorder).endswith("bytes, closed")


class TestWriting:
    def test_a_rate_for_each_label(self, tmp_path: Path) -> None:
        data = {"fx [N]": SINE, "pos": SINE[:500]}
        for rate in ({"fx": 1000, "pos": 250}, {"fx [N]": 1000, "pos": 250}):
            hapfmt.write(data, tmp_path / "x.hapf", rate=rate, force=True)
            back = hapfmt.read(tmp_path / "x.hapf")
            assert [c.rate for c in back] == [1000, 250] and back["fx"].unit == "N"
            assert back.duration == 2
        with pytest.raises(hapfmt.UnknownChannelError, match="'fy'; did you mean 'fx'"):
            Recording.from_array(data, {"fy": 1000, "pos": 250})
        with pytest.raises(ParameterError, match="rate has no entry for channel 'pos'"):
            Recording.from_array(data, {"fx": 1000})

    @pytest.mark.parametrize("rate", [[1000, 250], {"a": 1000, "b": 250}])
    def test_other_ways_to_give_rates_name_the_one_that_works(self, rate: Any) -> None:
        with pytest.raises(ParameterError, match=r"rate=.label: samples per second.*from_physical"):
            Recording.from_array(np.zeros((2, 50)), rate)
        with pytest.raises(ParameterError, match=r"rate=.label: samples per second"):
            Recording.from_array([SINE, SINE[:500]], 1000)

    def test_lengths_that_differ_at_one_rate(self, tmp_path: Path) -> None:
        data = {"fx": SINE, "pos": SINE[:500]}
        words = r"different lengths \(fx: 2000, pos: 500\) and one rate, 1000 Hz"
        with pytest.warns(DataWarning, match=words) as caught:
            hapfmt.write(data, tmp_path / "x.hapf", rate=1000)
        assert caught[0].filename == __file__

    def test_events(self, tmp_path: Path) -> None:
        event = hapfmt.Event(1, "contact", channel="ch1")
        hapfmt.write(SINE, tmp_path / "x.hapf", rate=1000, events=[event])
        assert [e.text for e in hapfmt.read(tmp_path / "x.hapf").events] == ["contact"]
        rec = Recording.from_array(SINE, 1000, events=[event])
        hapfmt.write(rec, tmp_path / "y.hapf", events=[hapfmt.Event(0.5, "more")])
        assert [e.text for e in hapfmt.read(tmp_path / "y.hapf").events] == ["more", "contact"]
        with pytest.raises(ParameterError, match=r"list of hapfmt\.Event"):
            Recording.from_array(SINE, 1000, events=["contact"])  # type: ignore[list-item]

    def test_a_label_twice(self, tmp_path: Path) -> None:
        with pytest.warns(DataWarning, match="2 channels are called 'fx'"):
            hapfmt.write([SINE, SINE], tmp_path / "x.hapf", rate=1000, labels=["fx", "fx"])

    def test_a_preset_that_is_mistyped(self, tmp_path: Path) -> None:
        with pytest.raises(ParameterError, match="did you mean 'near-lossless'"):
            hapfmt.write(SINE, tmp_path / "x.hapf", rate=1000, preset="nearlossless")


class TestReading:
    def test_empty_time_ranges(self, tmp_path: Path) -> None:
        path = tmp_path / "x.hapf"
        hapfmt.write(SINE, path, rate=1000)
        swapped = "time range: 5 to 2 s; start is after stop"
        for call in (partial(hapfmt.read, path), hapfmt.read(path).sel):
            with pytest.raises(ParameterError, match=swapped):
                call(start=5, stop=2)
            with pytest.raises(
                ParameterError, match="No samples at 50 s or later: the recording ends at 2 s"
            ):
                assert call(start=50).sample_count == 0

    def test_jittered_times_warn_as_tables_do(self, tmp_path: Path) -> None:
        times = np.arange(200) / 100 + np.random.default_rng(1).uniform(-2e-3, 2e-3, 200)
        table = tmp_path / "x.csv"
        rows = "".join(f"{t:.6f},{t}\n" for t in times)
        table.write_text("t [s],x [N]\n" + rows, encoding="utf-8")
        with pytest.warns(MovedTimesWarning) as caught:
            rec = hapfmt.read(table)
        assert str(caught[0].message) in rec.metadata["notes"] and caught[0].filename == __file__
        np.savez(tmp_path / "x.npz", x=SINE[:200], t=times)
        with pytest.warns(MovedTimesWarning) as caught:
            hapfmt.read(tmp_path / "x.npz")
        assert caught[0].filename == __file__
        done = run("encode", "x.csv", "x.hapf", cwd=tmp_path)
        assert done.returncode == 0 and done.stderr.count(b"the sample times differ") == 1

    @pytest.mark.parametrize("header", ["", "fx fy\n"])
    def test_cells_between_spaces(self, tmp_path: Path, header: str) -> None:
        np.savetxt(tmp_path / "x.txt", np.zeros((3, 2)), header=header.strip(), comments="")
        with pytest.raises(ParameterError, match=r"separated by spaces; .*numpy\.loadtxt"):
            hapfmt.read(tmp_path / "x.txt", rate=1000)

    @pytest.mark.parametrize(("suffix", "way"), [(".xlsx", "pandas.read_excel")])
    def test_formats_of_other_libraries(self, tmp_path: Path, suffix: str, way: str) -> None:
        path = tmp_path / f"x{suffix}"
        path.write_bytes(b"\x00\x01" * 300)
        with pytest.raises(ParameterError, match=f"{way}.*then call hapfmt.write"):
            hapfmt.read(path)


class TestWords:
    """Errors name keywords in Python, and options on the command line."""

    def test_python(self, tmp_path: Path) -> None:
        path = tmp_path / "x.hapf"
        hapfmt.write(SINE, path, rate=1000)
        for words, call in {
            "; use force=True to overwrite": lambda: hapfmt.write(SINE, path, rate=1000),
            "^max_error requires preset": lambda: hapfmt.Settings.of(max_error="1%"),
            "^texture=False requires": lambda: hapfmt.Settings.of("paper", texture=False),
            r"^rate is above 0 samples per second, not 0$": lambda: Channel(SINE, 0),
        }.items():
            with pytest.raises(ParameterError, match=words) as caught:
                call()
            assert "--" not in str(caught.value)

    def test_command_line(self, tmp_path: Path) -> None:
        np.save(tmp_path / "x.npy", np.zeros((50, 3)))
        np.save(tmp_path / "y.npy", SINE)
        (tmp_path / "z.hapf").touch()
        for words, arguments in {
            b"use --force to overwrite": ["y.npy", "z.hapf", "--rate", 1000],
            b"hapfmt: --max-error requires preset": ["y.npy", "o.hapf", "--max-error", "1%"],
            b"give one (--rate)": ["y.npy", "o.hapf"],
            b"use --transpose; if not, --no-transpose": ["x.npy", "o.hapf", "--rate", 1000],
        }.items():
            done = run("encode", *arguments, cwd=tmp_path)
            assert done.returncode == 1 and words in done.stderr, done.stderr

    def test_no_option_in_a_message_for_python(self) -> None:
        package = Path(hapfmt.__file__).parent
        found = [
            f"{path.name}: {text}"
            for part in ("convert", "encoder", "reading", "edit", "format", "codecs")
            for path in (package / part).glob("*.py")
            for text in re.findall(r"""(?:Error|refuse)\([^()]*--[a-z][^()]*""", path.read_text())
        ]
        assert found == []


class TestGuesses:
    def test_seconds_of_a_channel(self) -> None:
        rec = Recording.from_array({"fx": SINE, "fy": SINE}, 1000)
        part = rec["fx"].sel(start=1, stop=1.5)
        assert np.array_equal(part.to_numpy(), SINE[1000:1500]) and part.times()[0] == 1
        with pytest.raises(ParameterError, match="5 to 2 s; start is after stop"):
            rec["fx"].sel(5, 2)
        with pytest.raises(ParameterError, match=r"sel\(start=1, stop=2\).*to_numpy\(1, 2\)"):
            rec["fx"][1.0:2.0]
        with pytest.raises(ParameterError, match=r"rec\.sel\(start=1, stop=2\)"):
            rec[1.0:2.0]  # type: ignore[index]
        with pytest.raises(hapfmt.UnknownChannelError, match=r"rec\.sel\('f\*'\) selects them"):
            rec["f*"]

    def test_rate_and_array(self) -> None:
        rec = Recording.from_array({"fx": SINE, "fy": SINE}, 1000)
        assert rec.rate == 1000 and np.asarray(rec).shape == (2, 2000)
        two = Recording.from_array({"fx": SINE, "x": SINE[:500]}, {"fx": 1000, "x": 250})
        with pytest.raises(ParameterError, match=r"2 rates \(250 Hz, 1000 Hz\); rec\['label'\]"):
            two.rate  # noqa: B018
        for call in (np.asarray, Recording.to_pandas):
            pytest.importorskip("pandas")
            with pytest.raises(ParameterError, match=r"sel\(\['fx'\]\), or use rec\.to_xarray"):
                call(two)

    def test_plot(self) -> None:
        pytest.importorskip("matplotlib")
        rec = Recording.from_array({"fx": SINE, "fy": SINE}, 1000)
        assert len(hapfmt.plot(rec).axes) >= 2
        assert hapfmt.plot(rec.sel("fx"), start=1).axes

    def test_xarray_there_and_back(self, tmp_path: Path) -> None:
        pytest.importorskip("xarray")
        two = Recording.from_array(
            {"x": SINE[:500], "fx": SINE, "y": SINE[:500]}, {"fx": 1000, "x": 250, "y": 250}
        )
        two = replace(two, metadata={"subject": "S7"}, epoch_ns=1_700_000_000 * 10**9)
        dataset = two.to_xarray()
        assert set(dataset.dims) == {"time_250Hz", "time_1000Hz"}
        assert dataset.attrs["source"].startswith("hapfmt ")
        hapfmt.write(dataset, tmp_path / "x.hapf")
        back = hapfmt.read(tmp_path / "x.hapf")
        assert back.labels == two.labels and back.epoch_ns == two.epoch_ns
        assert [c.rate for c in back] == [c.rate for c in two]
        assert all(map(np.array_equal, map(np.asarray, back), map(np.asarray, two)))
        assert back.metadata["subject"] == "S7"


class TestRecorder:
    @pytest.mark.parametrize("arguments", [([1, 2, 3],), ({"a": [1.0]},), ([1, 2], [3, 4])])
    def test_write_without_a_label(self, arguments: Any, tmp_path: Path) -> None:
        with hapfmt.Recorder(tmp_path / "x.hapf", [hapfmt.Input("a", 1000)]) as recorder:
            with pytest.raises(ParameterError, match=r"write_all takes .*, write_rows an array"):
                recorder.write(*arguments)
            recorder.write("a", [1.0])
            assert not {"put", "drop"} & set(dir(recorder))
        assert hapfmt.read(tmp_path / "x.hapf").sample_count == 1

    def test_a_file_that_was_not_closed(self, tmp_path: Path) -> None:
        with hapfmt.Recorder(tmp_path / "x.hapf", [hapfmt.Input("a", 1000)]) as recorder:
            recorder.write("a", SINE)
            recorder.flush()
            data = (tmp_path / "x.hapf").read_bytes()
        report = hapfmt.verify(data)
        assert report.verdict == "damaged" and report.exit_code == 3
        assert report.headline().startswith("damaged, not closed; ")
        assert hapfmt.verify(tmp_path / "x.hapf").headline().startswith("intact; ")


class TestNarrowTerminal:
    def test_not_closed_stays_together(self, tmp_path: Path) -> None:
        with hapfmt.Recorder(tmp_path / "x.hapf", [hapfmt.Input("a", 1000)]) as recorder:
            recorder.write("a", SINE)
            recorder.flush()
            for columns in range(50, 100, 3):
                done = run_in_terminal("info", "x.hapf", cwd=tmp_path, columns=columns)
                assert b"NOT CLOSED" in done.stdout


def test_options_stand_for_whole_words_alone():
    from hapfmt.cli.screen import IN_OPTIONS, in_options

    for keyword, option in IN_OPTIONS.items():
        assert in_options(keyword) == option == in_options(option)

    assert in_options("k requires preset 'paper'") == "--k requires preset 'paper'"
    assert (
        in_options("disk requires room; k requires more") == "disk requires room; --k requires more"
    )
