"""FLAC: files of soundfile are read exactly, ours are read by soundfile, and both ways round."""

from __future__ import annotations

import io
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from formats import damaged, facts, survives, written
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.convert import imported, read
from hapfmt.errors import LimitError, ParameterError
from hapfmt.recording import Calibration, Channel, Recording, Span

SUBTYPES = {"PCM_S8": 8, "PCM_16": 16, "PCM_24": 24}


def foreign(x: Any, rate: int = 8000, subtype: str = "PCM_16", comment: str = "") -> bytes:
    """[frames, channels] counts, as soundfile writes them."""
    import soundfile

    stream = io.BytesIO()
    counts = np.asarray(x, np.int32) << (32 - SUBTYPES[subtype])
    described = {"samplerate": rate, "channels": counts.shape[1], "subtype": subtype}
    with soundfile.SoundFile(stream, "w", format="FLAC", **described) as file:
        if comment:
            file.comment = comment
        file.write(counts)
    return stream.getvalue()


def sound(count: int = 3000, bits: int = 16) -> Any:
    """Noise, so that few bytes of the file are without effect."""
    half = 1 << (bits - 1)
    return np.random.default_rng(2).integers(-half, half, (count, 2))


@pytest.mark.parametrize("subtype", SUBTYPES)
def test_files_of_soundfile(subtype: str) -> None:
    x = sound(bits=SUBTYPES[subtype])
    back = read(foreign(x, 655_350, subtype))
    assert back.labels == ["ch1", "ch2"]
    for channel, column in zip(back, x.T, strict=True):
        assert channel.counts.tolist() == column.tolist()
        assert channel.calibration == Calibration(1, 0, 1 << (SUBTYPES[subtype] - 1))
        assert channel.rate_exact == 655_350
    assert "notes" not in back.metadata


def test_select_and_rate() -> None:
    data = foreign(sound())
    back = read(data, select="ch2", rate="44100/7")
    assert (back.labels, back.rate) == (["ch2"], 6300)
    assert back.metadata["notes"] == ["the rate of the file, 8000 Hz, was overridden by 6300 Hz"]
    with pytest.raises(ParameterError, match="no channel is called 'x'; there are: 'ch1', 'ch2'"):
        read(data, select="x")


def test_blocks_are_bounded() -> None:
    data = foreign(sound(700_000))
    with imported(data) as (_, found):
        sizes = [len(block.values[0]) for block in found.blocks()]
    assert sum(sizes) == 700_000
    assert max(sizes) == 1 << 19


labels = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=6)
calibrations = st.builds(
    Calibration, st.integers(-9, -1) | st.integers(1, 9), st.integers(-50, 50), st.integers(1, 999)
)
rates = st.sampled_from([Fraction(1000), Fraction(44_100, 7), Fraction(1, 3), Fraction(96_000)])


@given(st.data(), rates, st.sampled_from([8, 15, 16, 17, 24]))
def test_counts_scales_labels_units_and_rates_come_back(
    data: st.DataObject, rate: Fraction, bits: int
) -> None:
    half = 1 << (bits - 1)
    size = data.draw(st.integers(1, 9))
    columns = st.lists(st.integers(-half, half - 1), min_size=size, max_size=size)
    described = st.fixed_dictionaries({
        "calibration": calibrations,
        "label": labels,
        "unit": st.sampled_from(["1", "N", "m/s2", "{raw(0-255)}"]),
        "group": labels | st.just(""),
    })  # fmt: skip
    given = [
        Channel(np.array(data.draw(columns), np.int32), rate, **one)
        for one in data.draw(st.lists(described, min_size=1, max_size=8, unique_by=str))
    ]
    out, notes = written(Recording(tuple(given)), "flac")
    back = read(out, rate=None)
    assert [*map(facts, back)] == [*map(facts, given)]
    names = ("calibration", "unit", "group")
    assert [[getattr(c, n) for n in names] for c in back] == [
        [getattr(c, n) for n in names] for c in given
    ]
    if len({c.label for c in given}) == len(given):
        assert back.labels == [c.label for c in given]
    others = "other programs than hapfmt see the rate 1 Hz instead of 1/3 Hz"
    assert notes == ((others,) if rate == Fraction(1, 3) else ())


def test_soundfile_reads_it() -> None:
    import soundfile

    x = sound()
    given = [
        Channel(row.astype(np.int16), 1000, calibration=Calibration(5, 1, 7), label=f"f{i}")
        for i, row in enumerate(x.T)
    ]
    out, notes = written(Recording(tuple(given), epoch_ns=5), "flac")
    assert notes == ("not carried over to .flac: epoch_ns",)
    with soundfile.SoundFile(io.BytesIO(out)) as file:
        assert (file.samplerate, file.channels, file.subtype) == (1000, 2, "PCM_16")
        assert file.read(dtype="int16").tolist() == x.tolist()


def test_full_scale_of_1_needs_no_comment_to_come_back() -> None:
    for subtype, bits in SUBTYPES.items():
        given = Channel(np.array([1, -5]), 1000, calibration=Calibration(1, 0, 1 << (bits - 1)))
        out, _ = written(Recording((given,)), "flac")
        found = read(out.replace(b"hapfmt {", b"others {"))[0]
        assert (found.calibration, found.counts.tolist()) == (given.calibration, [1, -5]), subtype


COMMENTS = [
    "hapfmt",
    "hapfmt {",
    "hapfmt []",
    "hapfmt " + "[" * 50_000,
    "hapfmt " + "9" * 5000,
    *(
        "hapfmt " + json.dumps({"rate": rate, "channels": [{"scale": scale, "label": label}] * n})
        for rate, scale, label, n in [
            ("1000", [1, 0, 1], "fx", 1),
            ("0", [1, 0, 1], "fx", 2),
            ("1e999999", [1, 0, 1], "fx", 2),
            ("1000", [0, 0, 1], "fx", 2),
            ("1000", [1 << 80, 0, 1], "fx", 2),
            ("1000", [1, 0], "fx", 2),
            ("1000", ["a", 0, 1], "fx", 2),
            ("1000", None, "fx", 2),
            ("1000", [1, 0, 1], 5, 2),
            ("1000", [1, 0, 1], "\ud800", 2),
        ]
    ),
]


@pytest.mark.parametrize("comment", COMMENTS, ids=lambda text: text[:60])
def test_a_comment_that_we_did_not_write_is_ignored(comment: str) -> None:
    back = read(foreign(sound(5), comment=comment))
    assert (back.labels, back.rate) == (["ch1", "ch2"], 8000)


def test_damage() -> None:
    data = foreign(sound(300))
    for each in damaged(data):
        survives(each, "flac")
    with pytest.raises(ParameterError):
        read(data[: len(data) // 2])
    with pytest.raises(ParameterError, match=r"this is no \.flac file"):
        read(b"fLaC" + bytes(50))


def test_a_header_that_counts_much() -> None:
    """36 bits of frames; and 0, which means unknown."""
    data = bytearray(foreign(sound(300)))
    data[21:26] = bytes([data[21] | 15, 255, 255, 255, 255])
    with pytest.raises(LimitError, match="the values take 274877906940 bytes"):
        read(bytes(data))
    data[21:26] = bytes([data[21] & 240, 0, 0, 0, 0])
    with pytest.raises(ParameterError, match="the header counts no samples"):
        read(bytes(data))


def counts(**described: Any) -> Channel:
    known = {"rate": 1000, "calibration": Calibration(), "label": "a", **described}
    return Channel(known.pop("stored", np.arange(4)), **known)


REFUSED = {
    r"rates up to 65535 Hz, and whole tens up to 655350 Hz, not 65536": [counts(rate=65_536)],
    r"not 655360 Hz; use .wav or .npz": [counts(rate=655_360)],
    "at most 8 channels, not 9": [counts()] * 9,
    r"channel 'a' holds floating point, and .flac holds integers; use .wav": [
        Channel(np.zeros(3), 1000, label="a")
    ],
    "channel 'a' has counts beyond 24 bits": [counts(stored=np.array([1 << 23]))],
    "channel 'a' has gaps, which PCM cannot hold": [
        counts(coverage=(Span(0, 2), Span(3, 5))),
    ],
    "holds one rate, the channels have 1000 Hz, 1001 Hz": [counts(), counts(rate=1001)],
    "labels and units take more than": [counts(label="x" * 70_000)],
}


@pytest.mark.parametrize("message", REFUSED)
def test_refused(message: str) -> None:
    with pytest.raises((ParameterError, LimitError), match=message):
        written(Recording(tuple(REFUSED[message])), "flac")


def test_a_start_is_noted() -> None:
    _, notes = written(Recording((counts(coverage=(Span(5, 9),)),)), "flac")
    assert notes == ("the start, tick 5, is not carried over to .flac",)


def test_command_line(tmp_path: Path) -> None:
    (tmp_path / "a.flac").write_bytes(foreign(sound()))
    assert b"FLAC: 2 channels" in run("info", "a.flac", cwd=tmp_path).stdout
    for words in (["encode", "a.flac", "a.hapf"], ["convert", "a.hapf", "b.flac"]):
        assert run(*words, cwd=tmp_path).returncode == 0
    assert b"2 identical" in run("compare", "a.flac", "b.flac", cwd=tmp_path).stdout
