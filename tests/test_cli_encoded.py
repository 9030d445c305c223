"""What hapfmt encode prints of its choices."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from terminal import called

import hapfmt


def saved(folder: Path, x: np.ndarray, unit: str = "N", name: str = "in.npz") -> Path:
    labels = [f"f{i}" for i in range(len(x))]
    np.savez(folder / name, x=x, rate_hz=1000.0, channel_names=labels, unit=[unit] * len(x))
    return folder / name


def counts(channels: int, samples: int = 3000) -> np.ndarray:
    steps = np.random.default_rng(1).integers(-9, 10, (channels, samples))
    return steps.cumsum(axis=1) / 1000.0


def lines_of(*words: object) -> list[str]:
    said = called("encode", *words)
    assert said.code == 0, said.err
    return said.out.splitlines()


def test_a_line_for_each_channel_with_its_error_in_its_unit(tmp_path: Path) -> None:
    source = saved(tmp_path, counts(3))
    words = (source, tmp_path / "o.hapf", "--preset", "near-lossless", "--max-error", "0.004")
    lines = lines_of(*words)
    assert re.split(r"  +", lines[0]) == [
        "label", "kept as", "bits/sample", "bytes", "largest error", "% of range"
    ]  # fmt: skip
    back = hapfmt.read(tmp_path / "o.hapf")
    for place, line in enumerate(lines[2:5]):
        label, _, bits, size, error, share = re.split(r"  +", line)
        worst = np.abs(back[label].to_numpy() - counts(3)[place]).max()
        assert float(share) == pytest.approx(100 * worst / np.ptp(counts(3)[place]), rel=0.01)
        assert error == f"{worst:.3g} N" and worst <= 0.004 * (1 + 1e-12)
        assert float(bits) == pytest.approx(8 * int(size) / 3000, abs=0.005)
    told = json.loads(called("encode", *words, "-f", "--json").out)["channels"]
    assert all({"unit", "kept_as", "largest_error"} <= set(each) for each in told)
    found = json.loads(called("info", tmp_path / "o.hapf", "--json").out)["channels"]
    assert [each["kept_as"] for each in told] == [each["kept_as"] for each in found]


def test_reasons_come_with_verbose_alone(tmp_path: Path) -> None:
    source = saved(tmp_path, counts(2))
    short = lines_of(source, tmp_path / "a.hapf")
    long = lines_of(source, tmp_path / "b.hapf", "-v")
    assert len(short) == 5 and len(long) == 7
    assert long[4].startswith("f0: ") and "step 0.001" in long[4]
    assert "step" not in " ".join(short)


def test_equal_neighbours_of_many_channels_share_a_line(tmp_path: Path) -> None:
    source = saved(tmp_path, counts(20, 400))
    grouped = lines_of(source, tmp_path / "a.hapf")
    assert len(grouped) == 5 and "-v or --json shows each channel" in grouped[3]
    assert grouped[2].startswith("f0 and 19 more  lossless")
    size = int(re.split(r"  +", grouped[2])[3])
    told = json.loads(called("encode", source, tmp_path / "b.hapf", "--json").out)
    assert size == sum(each["size"] for each in told["channels"])
    assert len(lines_of(source, tmp_path / "c.hapf", "-v")) == 2 + 20 + 20 + 1


def test_neighbours_whose_bounds_differ_share_a_line_too(tmp_path: Path) -> None:
    x = np.random.default_rng(3).normal(size=(20, 400)) * np.arange(1, 21)[:, None]
    words = (saved(tmp_path, x), tmp_path / "a.hapf", "--preset", "near-lossless")
    line = lines_of(*words)[2]
    told = json.loads(called("encode", *words, "-f", "--json").out)["channels"]
    bounds = sorted((each["kept_as"].split()[1] for each in told), key=float)
    assert line.startswith(f"f0 and 19 more  within {bounds[0]} to {bounds[-1]} N  ")


def test_larger_is_called_larger(tmp_path: Path) -> None:
    last = lines_of(saved(tmp_path, counts(1, 3)), tmp_path / "o.hapf")[-1]
    size = (tmp_path / "o.hapf").stat().st_size
    assert f"{size / 24:.1f} times LARGER than float64" in last and "smaller" not in last


def test_the_error_stands_beside_the_size_that_it_bought(tmp_path: Path) -> None:
    source = saved(tmp_path, counts(3))
    last = lines_of(source, tmp_path / "a.hapf", "--preset", "near-lossless", "--max-error", "2%")[
        -1
    ]
    assert re.search(
        r"times smaller than float64 \(.*\), largest error [12]\.?\d* % of range of f\d$", last
    )
    assert "largest error" not in lines_of(source, tmp_path / "b.hapf")[-1]


RNG = np.random.default_rng(2)
FLOATING = {
    "walks": RNG.normal(size=(3, 20000)).cumsum(axis=1),
    "short": RNG.normal(size=(2, 700)).cumsum(axis=1),
    "a burst": np.where(abs(np.arange(200_000) - 9000) < 3000, 30, 1) * RNG.normal(size=200_000),
    "many": RNG.normal(size=(20, 9000)).cumsum(axis=1),
    "a glitch": np.append(RNG.normal(size=200_000), 1e6),
}


@pytest.mark.compiled
@pytest.mark.parametrize("name", FLOATING)
def test_what_another_preset_would_save_is_about_right(tmp_path: Path, name: str) -> None:
    noise = np.atleast_2d(FLOATING[name])
    source = saved(tmp_path, noise)
    hint = lines_of(source, tmp_path / "a.hapf")[-1]
    found = re.fullmatch(
        r"\d+ of \d+ channels? (?:are|is) floating point\. With (--preset near-lossless --max-error 0\.1%) "
        r"this file would be about ([\d.]+) times smaller than float64, not \d\.\d times\.",
        hint,
    )
    assert found is not None, hint
    last = lines_of(source, tmp_path / "b.hapf", *found[1].split())[-1]
    ratio = 8 * noise.size / (tmp_path / "b.hapf").stat().st_size
    assert float(found[2]) == pytest.approx(ratio, rel=0.05) and "floating point" not in last
    assert "floating point" not in " ".join(lines_of(saved(tmp_path, counts(1), name="c.npz"),
                                                     tmp_path / "c.hapf"))  # fmt: skip


class TestLossyInput:
    """The largest error counts from the input: the file and the terminal tell what that was."""

    def test_every_lossy_preset_stays_in_the_metadata(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        x = np.random.default_rng(4).normal(size=2000).cumsum()
        hapfmt.write(x, tmp_path / "a.hapf", rate=1000, units="N")
        first = hapfmt.read(tmp_path / "a.hapf").metadata["encoder"]
        near = ["--preset", "near-lossless", "--max-error", "0.1%"]
        said = called("encode", "a.hapf", "b.hapf", *near)
        assert "already lossy" not in said.err and first == f"hapfmt {hapfmt.__version__}"
        second = hapfmt.read(tmp_path / "b.hapf").metadata["encoder"]
        preset = "near-lossless --max-error 0.1%"
        assert second == f"{first}: {preset}"
        said = called("encode", "b.hapf", "c.hapf", "--preset", "perceptual")
        note = f"note: the input is already lossy ({preset}); error bounds count from it"
        assert note in " ".join(said.err.split())
        third = hapfmt.read(tmp_path / "c.hapf").metadata["encoder"]
        made_by, _, earlier = third.partition("; input: ")
        assert re.sub(r" \(texture [0-9.]+ dB\)$", "", made_by) == f"{first}: perceptual"
        assert earlier == second
        hapfmt.write(hapfmt.read(tmp_path / "c.hapf"), tmp_path / "d.hapf")
        fourth = hapfmt.read(tmp_path / "d.hapf").metadata["encoder"]
        assert fourth == f"{first}; input: {third}"
        said = called("encode", "d.hapf", "e.hapf")
        assert "already lossy (perceptual)" in " ".join(said.err.split())

    @pytest.mark.parametrize("encoder", [3, "", "lossy", "other 1.0: perceptual", "hapfmt 1: x"])
    def test_other_texts_are_replaced(self, tmp_path, encoder):
        channel = hapfmt.Channel(np.zeros(9), 10)
        recording = hapfmt.Recording((channel,), metadata={"encoder": encoder})
        hapfmt.write(recording, tmp_path / "a.hapf")
        assert "input" not in hapfmt.read(tmp_path / "a.hapf").metadata["encoder"]

    def test_a_long_text_is_cut(self, tmp_path):
        long = "hapfmt 1: perceptual --felt " + "x" * 100_000
        recording = hapfmt.Recording((hapfmt.Channel(np.zeros(9), 10),), metadata={"encoder": long})
        hapfmt.write(recording, tmp_path / "a.hapf")
        assert len(hapfmt.read(tmp_path / "a.hapf").metadata["encoder"]) < 400


def test_one_is_not_said_in_the_plural(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    said = called("scene", "cork", path, "--seconds", "0.001")
    assert ", 1 channel, 1 sample; computed" in said.out
    hapfmt.write(np.zeros(1), tmp_path / "a.hapf", rate=10)
    said = called("info", tmp_path / "a.hapf", "--follow")
    assert "1 cluster, " in said.out
    said = called("recover", tmp_path / "a.hapf", tmp_path / "b.hapf")
    assert ": 1 packet, 1 sample; nothing lost" in said.out


def test_a_layer_has_no_name_in_du_as_in_info(tmp_path: Path) -> None:
    events = (hapfmt.Event(0, "touch"),)
    channel = hapfmt.Channel(np.zeros(9), 10)
    hapfmt.write(hapfmt.Recording((channel,), events=events), tmp_path / "a.hapf")
    rows = called("du", tmp_path / "a.hapf").out.splitlines()
    assert [row.split("  ")[0].strip() for row in rows if " events " in row] == ["without a name"]
    assert any(row.startswith("?") for row in rows)


@pytest.mark.parametrize("verb", ["encode", "convert"])
@pytest.mark.parametrize(
    ("gaps", "said"),
    [
        ([[2]], "1 gap with 1 missing sample: it stays a gap"),
        ([[2, 3, 6]], "2 gaps with 3 missing samples: they stay gaps"),
        ([[2, 3], []], "1 gap with 2 missing samples, all in ch1: it stays a gap"),
        ([[4], [1, 2, 6]], "3 gaps with 4 missing samples, most in ch2 (3): they stay gaps"),
        ([[2], [2]], "1 gap with 1 missing sample in each of 2 channels: it stays a gap"),
        ([[1, 3], [1, 3]], "2 gaps with 2 missing samples in each of 2 channels: they stay gaps"),
        ([[], []], ""),
        ([[0, 8]], ""),
    ],
)
def test_gaps_of_the_input_are_told(tmp_path: Path, verb: str, gaps: list, said: str) -> None:
    x = np.ones((len(gaps), 9))
    for row, places in zip(x, gaps, strict=True):
        row[places] = np.nan
    np.save(tmp_path / "a.npy", x)
    done = called(verb, tmp_path / "a.npy", tmp_path / "a.hapf", "--rate", 10)
    notes = [line for line in done.err.splitlines() if " gap" in line]
    assert (done.code, notes) == (0, [f"note: {said}"] if said else [])


def test_kept_stamps_have_no_gaps_of_their_own(tmp_path: Path) -> None:
    times = [0.01 * place for place in range(50) if not 20 <= place < 30]
    rows = "".join(f"{t:.4f},{t}\n" for t in times)
    (tmp_path / "a.csv").write_text("time,fx [N]\n" + rows)
    words = (tmp_path / "a.csv", tmp_path / "a.hapf", "--keep-stamps", "--rate", 100)
    done = called("encode", *words)
    assert done.code == 0 and hapfmt.read(tmp_path / "a.hapf").labels == ["fx", "stamp"]
    assert "note: 1 gap with 10 missing samples: it stays a gap\n" in done.err


def test_sizes_of_counts_are_told_against_float64(tmp_path: Path) -> None:
    walk = np.random.default_rng(1).integers(-9, 9, (2, 4000)).cumsum(axis=1).astype(np.int16)
    channels = (hapfmt.Channel(row, 1000, calibration=hapfmt.Calibration()) for row in walk)
    hapfmt.write(hapfmt.Recording(tuple(channels)), tmp_path / "a.hapf")
    last = lines_of(tmp_path / "a.hapf", tmp_path / "o.hapf")[-1]
    size = (tmp_path / "o.hapf").stat().st_size
    assert f", {64000 / size:.1f} times smaller than float64 (" in last


@pytest.mark.parametrize("verb", ["encode", "convert"])
def test_select_chooses_channels_of_a_hapf_file(tmp_path: Path, verb: str) -> None:
    labels = ("hip.pos", "knee.pos", "hip.f", "fx")
    channels = [
        hapfmt.Channel(np.arange(9.0), 500 if label == "fx" else 100, label=label)
        for label in labels
    ]
    hapfmt.write(hapfmt.Recording(tuple(channels)), tmp_path / "a.hapf")
    select = ("--select", "*.pos", "--select", "hip*")
    target = tmp_path / ("b.hapf" if verb == "encode" else "b.csv")
    assert called(verb, tmp_path / "a.hapf", target, *select).code == 0
    assert hapfmt.read(target).labels == ["hip.pos", "knee.pos", "hip.f"]
    unknown = called(verb, tmp_path / "a.hapf", target, "--force", "--select", "toe")
    assert unknown.code == 1 and "no channel 'toe'; there are: " in unknown.err


def test_several_rates_in_a_table_have_two_ways_out(tmp_path: Path) -> None:
    channels = (hapfmt.Channel(np.zeros(9), 500), hapfmt.Channel(np.zeros(9), 100))
    hapfmt.write(hapfmt.Recording(channels), tmp_path / "a.hapf")
    for verb in ("convert", "decode"):
        said = called(verb, tmp_path / "a.hapf", tmp_path / "a.csv").err
        assert "choose those of one rate with --select (convert) or --channels (decode)" in said


def test_a_unit_text_of_the_source_is_shown_once(tmp_path: Path) -> None:
    labels = [f"t{place}" for place in range(5)]
    channels = tuple(hapfmt.Channel(np.zeros(9), 10, label=label) for label in labels)
    metadata = {"source_units": dict.fromkeys(labels, "raw counts")}
    hapfmt.write(hapfmt.Recording(channels, metadata=metadata), tmp_path / "a.hapf")
    lines = called("info", tmp_path / "a.hapf").out.splitlines()
    assert "source unit 'raw counts': t0, t1, t2 and 2 more" in lines
    assert not any("source_units" in line for line in lines)


def test_inspect_shows_units_as_info_does(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        skin = file.create_dataset("skin", data=np.zeros((3, 50), np.int16))
        skin.attrs["fs"] = 100.0
        skin.attrs["units"] = "Newton"
        file.create_dataset("state", data=np.zeros(50)).attrs["fs"] = 100.0
    lines = called("info", tmp_path / "a.h5").out.splitlines()
    units = [line.split("  ")[1:] for line in lines if line.startswith(("skin", "state"))]
    shown = [next(cell for cell in row if cell).strip() for row in units]
    assert shown == ["N (from 'Newton')", "N", "N", "-"]


class TestOverview:
    def test_its_bytes_are_told(self, tmp_path: Path) -> None:
        x = np.cumsum(np.random.default_rng(1).normal(size=1 << 16))
        np.save(tmp_path / "x.npy", x)
        sizes = []
        for name, more in {"a.hapf": [], "b.hapf": ["--overview"]}.items():
            out = called("encode", tmp_path / "x.npy", tmp_path / name, "--rate", "1000", *more).out
            sizes.append((tmp_path / name).stat().st_size)
        found = re.search(r"the overview takes (\d+) bytes of it", out)
        assert found is not None
        assert 0 <= sizes[1] - sizes[0] - int(found[1]) < 100  # the index lists it


class TestOtherFiles:
    """A file of another format, or an empty one, is refused with the way out."""

    @pytest.mark.parametrize(
        "verb",
        [
            *(["verify"], ["du"], ["dump"], ["clocks"], ["meta"], ["attach", "--list"]),
            ["annotate", "--list"],
        ],
        ids=" ".join,
    )
    def test_in_every_verb(self, tmp_path: Path, verb: list) -> None:
        path = tmp_path / "my force.csv"
        path.write_text("t,x\n0,1\n1,2\n")
        said = called(verb[0], path, *verb[1:])
        text = said.out + said.err
        assert said.code == 2 and "no signature [FIL-001]" in text
        assert "if this is a recording in another format, make a hapf file of it:" in text
        (command,) = [line for line in text.splitlines() if line.startswith("  hapfmt ")]
        assert called(*shlex.split(command)[1:]).code == 0
        assert len(hapfmt.read(tmp_path / "my force.hapf")) == 1

    @pytest.mark.parametrize("verb", ["info", "verify"])
    def test_empty(self, tmp_path: Path, verb: str) -> None:
        path = tmp_path / "a.hapf"
        path.touch()
        said = called(verb, path)
        assert said.code == 2
        assert "not a hapf file: the file is empty [FIL-001]" in said.out + said.err

    def test_other_suffixes(self, tmp_path: Path) -> None:
        path = tmp_path / "a.txt"
        path.write_text("no")
        assert f"hapfmt encode {path} {path.with_suffix('.hapf')}" in called("verify", path).err

    @pytest.mark.parametrize("verb", ["du", "verify"])
    @pytest.mark.parametrize("name", ["pic.png", "pic", "noise.txt"])
    def test_no_advice_for_what_no_reader_takes(self, tmp_path: Path, verb: str, name: str) -> None:
        (tmp_path / name).write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
        said = called(verb, tmp_path / name)
        assert said.code == 2 and "no signature [FIL-001]" in said.out + said.err
        assert "encode" not in said.out + said.err


class TestInfo:
    """One verb shows what a file contains, whatever its format."""

    def test_the_content_decides_and_then_the_suffix(self, tmp_path: Path) -> None:
        hapfmt.write(np.zeros(9), tmp_path / "a.hapf", rate=10)
        (tmp_path / "a.csv").write_bytes((tmp_path / "a.hapf").read_bytes())
        (tmp_path / "b.csv").write_text("t,x\n0,1\n1,2\n")
        assert " hapf 1.0 " in called("info", tmp_path / "a.csv").out
        assert called("info", tmp_path / "b.csv").out.startswith("CSV: 1 channel\n")
        said = called("info", tmp_path / "b.csv", "--input-format", "hapf")
        assert said.code == 2 and "no signature [FIL-001]" in said.err

    def test_a_suffix_that_no_reader_takes(self, tmp_path: Path) -> None:
        (tmp_path / "pic.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
        said = called("info", tmp_path / "pic.png")
        assert said.code == 1 and "the suffix '.png' is not one of: .hapf" in said.err

    def test_events_of_another_format(self, tmp_path: Path) -> None:
        channel = hapfmt.Channel(np.zeros(9), 10, label="a")
        events = [hapfmt.Event(0.5, "slip")]
        hapfmt.save(hapfmt.Recording((channel,), events=events), tmp_path / "a.mcap")
        said = called("info", tmp_path / "a.mcap", "--events").out
        assert "1 event" in said and re.search("^ *0.5  slip", said, re.M)


class TestLabelsAndUnits:
    """encode and convert take labels and units for inputs that have none, or others."""

    @pytest.mark.parametrize("verb", ["encode", "convert"])
    @pytest.mark.parametrize("suffix", ["npy", "npz", "csv", "wav"])
    def test_of_every_format(self, tmp_path: Path, verb: str, suffix: str) -> None:
        if suffix == "wav":
            pytest.importorskip("soundfile")
        x = np.arange(20.0).reshape(2, 10)
        path, out = tmp_path / f"a.{suffix}", tmp_path / "a.hapf"
        hapfmt.save(x, path, rate=10, labels=["one", "two"])
        given = ["--rate", 10] if suffix == "npy" else []

        def described(*more: str) -> list[tuple[str, str]]:
            said = called(verb, path, out, "--force", *given, *more)
            assert said.code == 0, said.err
            back = hapfmt.read(out)
            assert np.array_equal(back.to_numpy(), x)
            return [(channel.label, channel.unit) for channel in back]

        assert described("--labels", "ax, ay", "--unit", "m/s^2") == [
            ("ax", "m/s2"),
            ("ay", "m/s2"),
        ]
        names = [label for label, _ in described()]
        assert described("--unit", "N,Nmm") == list(zip(names, ["N", "N.mm"], strict=True))
        said = called(verb, path, tmp_path / "b.hapf", *given, "--labels", "a,b,c")
        assert said.code == 1 and "--labels names 3 channels, the input has 2" in said.err
        said = called(verb, path, tmp_path / "b.hapf", *given, "--unit", "N,N,N")
        assert said.code == 1 and "3 units for 2 channels" in said.err

    @pytest.mark.parametrize(
        ("given", "told"),
        [
            ([], ["the unit of channel 'acc' is read as [g], since its name says acceleration"]),
            (["--unit", "N,g,Cel"], ["--unit replaces [g] of 'acc'"]),
            (["--unit", "N"], ["--unit replaces [g] of 'acc', Cel of 'temp'"]),
            (["--unit", "N,[g],Cel"], []),
            (["--select", "F"], []),
        ],
    )
    def test_notes_are_on_the_units_that_are_used(self, tmp_path: Path, given, told):
        path, out = tmp_path / "a.csv", tmp_path / "a.hapf"
        path.write_text("t,F [N],acc [g],temp [Cel]\n0,1,2,3\n1,2,3,4\n2,1,0,3\n")
        said = called("encode", path, out, *given)
        assert [f"note: {each}" for each in told] == [
            line for line in said.err.splitlines() if "unit" in line
        ]
        assert hapfmt.read(out).metadata.get("notes", []) == told

    @pytest.mark.parametrize(
        ("out", "kind", "usual"),
        [
            ("b.npz", "csv", "csv"),
            ("b.hapf", "npz", "npz"),
            ("b.csv", "csv", None),
            ("b", "csv", None),
        ],
    )
    def test_a_suffix_of_another_format_is_noted(self, tmp_path: Path, out, kind, usual):
        hapfmt.write(np.arange(20.0), tmp_path / "a.hapf", rate=10, labels=["x"])
        target = tmp_path / out
        said = called("decode", tmp_path / "a.hapf", target, "--output-format", kind)
        told = f"note: {target} will be a {usual} file; the usual suffix is .{usual}"
        assert said.code == 0
        assert (told in said.err) if usual else ("usual suffix" not in said.err)

    def test_the_advice_is_not_the_option_that_was_given(self, tmp_path: Path):
        np.savez(tmp_path / "a.npz", x=np.zeros((2, 9)), channel_names=["a", "b"], fs=10.0)
        for given, advice in (["--transpose"], "use --no-transpose"), ([], None):
            said = called("encode", tmp_path / "a.npz", tmp_path / "a.hapf", *given)
            assert said.code == bool(advice) and (advice or "") in said.err

    @pytest.mark.parametrize("key", ["Time", "time_ms"])
    def test_an_array_of_times_that_becomes_a_channel_is_noted(self, tmp_path: Path, key: str):
        np.savez(tmp_path / "a.npz", **{key: np.arange(9) * 2.0, "f": np.ones(9)})
        said = called("encode", tmp_path / "a.npz", tmp_path / "a.hapf", "--rate", 500)
        assert f"note: key {key!r} is read as a channel; times in seconds" in said.err

    def test_a_hapf_file_has_its_own(self, tmp_path: Path) -> None:
        hapfmt.write(np.zeros(9), tmp_path / "a.hapf", rate=10)
        for verb, out in (("encode", "b.hapf"), ("convert", "b.npz")):
            said = called(verb, tmp_path / "a.hapf", tmp_path / out, "--labels", "a")
            assert said.code == 1 and "--labels and --unit require .npz" in said.err
