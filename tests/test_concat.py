"""Concatenation: of parts, of strangers, of what does not go together (docs/spec/editing.md)."""

from __future__ import annotations

import io
import struct
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from edited import (
    EPOCH_NS,
    PRESETS,
    UUID,
    assert_intact,
    assert_same,
    by_label,
    chunks_of,
    counts,
    made,
    plain,
    recording,
    tracks_of,
    waves,
    write,
)
from hypothesis import given
from hypothesis import strategies as st
from test_edit import names, split_up, times

import hapfmt
from hapfmt import edit
from hapfmt.format.source import BytesSource
from hapfmt.reading.opening import open_catalogue
from hapfmt.writing.filewriter import FileWriter

OTHER = {"uuid": None, "epoch_ns": EPOCH_NS + 10 * 10**9}


def concat(files: list[bytes], **options: object) -> tuple[bytes, edit.Edited]:
    out = io.BytesIO()
    edited = edit.concat(files, out, **options)
    return out.getvalue(), edited


@given(names, st.sets(times.filter(bool), min_size=1, max_size=3))
def test_parts_together_are_the_whole(name: str, cuts: set[Fraction]) -> None:
    """EDT-004: A track MUST keep its description except where its position in the new file requires a change; one description may serve tracks of several files only where no decoded number, contract or text differs by it."""
    file = made(name)
    whole, edited = concat(split_up(file, at=sorted(cuts)))
    assert_intact(whole)
    assert_same(hapfmt.read(whole), hapfmt.read(file))
    assert hapfmt.read(whole).uuid == UUID
    assert by_label(whole) == by_label(file)
    assert tracks_of(whole).keys() == tracks_of(file).keys()
    assert set(edited.offsets) == {0}


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("gap", [None, Fraction(1, 3)])
def test_strangers_one_after_the_other(name: str, gap: Fraction | None) -> None:
    files = [made(name, 0), made(name, 1, **OTHER), made(name, 2, **OTHER)]
    try:
        joined, edited = concat(files, gap=gap)
    except hapfmt.ParameterError as error:
        # References are for the encoder to choose, recording by recording.
        assert name == "lossless alike" and "references=False" in str(error)
        return
    assert_intact(joined)
    back, offset = hapfmt.read(joined), Fraction(0)
    assert back.epoch_ns == EPOCH_NS and back.uuid not in (UUID, None)
    parts = [hapfmt.read(file) for file in files]
    for part, told in zip(parts, edited.offsets, strict=True):
        assert told - (gap or 0) * (told > 0) - offset < Fraction(1, 10)
        assert told >= offset + (gap or 0) * (told > 0)
        offset = told + part.duration
    for place, channel in enumerate(back.channels):
        values = np.concatenate([part.channels[place].stored for part in parts])
        assert channel.stored.tobytes() == values.astype(channel.stored.dtype).tobytes()
        ticks = [
            tick + int(told * channel.rate_exact)
            for part, told in zip(parts, edited.offsets, strict=True)
            for span in part.channels[place].coverage
            for tick in range(span.start, span.stop)
        ]
        assert ticks == [t for span in channel.coverage for t in range(span.start, span.stop)]
        if parts[0].channels[place].exact is not None:
            exact = np.concatenate([part.channels[place].exact for part in parts])
            assert channel.exact is not None and channel.exact.tobytes() == exact.tobytes()
    assert packet_count(by_label(joined)) == sum(
        len(x) for f in files for x in by_label(f).values()
    )
    assert back.attachments == parts[0].attachments


def packet_count(rows: dict) -> int:
    return sum(map(len, rows.values()))


def test_lossless_tracks_share_one_description() -> None:
    """Words, and doubles with exact values, whatever their declared ranges."""
    files = [made("lossless doubles", 0), made("lossless doubles", 1, **OTHER)]
    ranges = [[(t.count_min, t.count_max) for t in tracks_of(file).values()] for file in files]
    joined, _ = concat(files)
    tracks = list(tracks_of(joined).values())
    lpcx = [t for t in tracks if t.codec == "LPCX"]
    assert [(t.count_min, t.count_max) for t in lpcx[:2]] == [
        (min(a[0], b[0]), max(a[1], b[1])) for a, b in zip(*ranges, strict=True)
    ][:2]
    assert len([t for t in tracks if t.codec == "RAWB"]) == 1


def test_by_their_epochs() -> None:
    files = [made("lossless"), made("lossless", 1, **OTHER)]
    joined, edited = concat(files, times="epoch")
    assert edited.offsets == [0, 10] and edited.notes == [
        "digests of 3 tracks left out: they are of other packets, or times",
        "missing: 1.5 s to 1.54 s of all channels; 3.04 s to 10 s of all channels; "
        "11.5 s to 11.54 s of all channels",
    ]
    assert edited.missing[1][1:] == (Fraction(76, 25), 10)
    assert_intact(joined)
    assert hapfmt.read(joined).channels[0].gaps[1] == hapfmt.Span(1520, 5000)
    late = made("lossless", 1, epoch_ns=EPOCH_NS + 10 * 10**9 + 300_000)
    _, edited = concat([files[0], late], times="epoch")
    assert edited.offsets == [0, 10]
    assert edited.notes[0].endswith("-0.0003 s from its epoch, to whole ticks")
    with pytest.raises(hapfmt.ParameterError, match="out of the ticks"):
        concat(files[::-1], times="epoch")
    with pytest.raises(hapfmt.ParameterError, match="the epoch is not known: give the offset"):
        concat([files[0], made("lossless", 1, epoch_ns=None)], times="epoch")


def test_a_channel_that_one_file_lacks_is_a_gap_there() -> None:
    a, b, c = waves(3, 1)
    one = write(recording(counts("a", a), counts("b", b)), preset="lossless")
    other = write(replace(recording(counts("c", c), counts("b", a)), **OTHER), preset="lossless")
    joined, edited = concat([one, other])
    assert_intact(joined)
    back = hapfmt.read(joined)
    assert [channel.label for channel in back.channels] == ["a", "b", "c"]
    assert [channel.stored.size for channel in back.channels] == [1500, 3000, 1500]
    assert back.channels[2].start_tick == 1520
    assert edited.notes[0] == "channel c is new in the input"


def test_what_does_not_go_together_is_refused_with_what_to_do() -> None:
    a, b, _ = waves(3, 1)
    base = recording(counts("a", a), counts("b", b))

    def against(*channels: hapfmt.Channel) -> None:
        concat([write(base), write(replace(recording(*channels), **OTHER))])

    words = counts("a", a, unit="N")
    fails = {
        "a: rate 250 Hz, and 500 Hz in the files before; leave": counts("a", a, 250),
        "a: unit mN, and N in the files before": counts("a", a, unit="mN"),
        r"a: calibration \(2 \* count \+ 0\) / 1000, and": replace(
            words, calibration=hapfmt.Calibration(2, 0, 1000)
        ),
        "a: number format int64, and counts": replace(
            words, stored=np.random.default_rng(1).integers(0, 1 << 63, a.size), calibration=None
        ),
    }
    for message, channel in fails.items():
        with pytest.raises(hapfmt.ParameterError, match=message):
            against(channel, counts("b", b))
    with pytest.raises(hapfmt.ParameterError, match="channel 1 is 'c', and 'b' before"):
        against(counts("", a), counts("c", b))
    with pytest.raises(
        hapfmt.ParameterError, match="channels 1, 2, 3 are coded together with others than"
    ):
        concat([made("lossless"), made("lossless alike", uuid=None)])
    with pytest.raises(hapfmt.ParameterError, match="two packets overlap at 0 s"):
        concat([write(base), write(base)])
    with pytest.raises(hapfmt.ParameterError, match="nothing to concatenate"):
        concat([])
    with pytest.raises(hapfmt.ParameterError, match="a gap must not be negative"):
        concat([write(base)], gap=-1)


def test_metadata_of_all_files_is_kept() -> None:
    one = made("lossless")
    attachments = {"sheet.txt": ("text/plain", b"another"), "x": ("", b"x")}
    metadata = {"subject": "S2", "n": [1, 2.5, None]}
    changed = replace(plain(1), uuid=None, metadata=metadata, attachments=attachments)
    other = write(changed, preset="lossless")
    joined, _ = concat([one, other])
    back = hapfmt.read(joined)
    assert back.metadata["subject"] == "S1" and back.metadata["subject (2)"] == "S2"
    assert "n (2)" not in back.metadata
    assert back.metadata["notes"][0] == "recorded on a Monday"
    assert back.attachments == {
        "sheet.txt": ("text/plain", b"as it was"),
        "sheet.txt (2)": ("text/plain", b"another"),
        "x": ("", b"x"),
    }
    assert len(chunks_of(joined, "mETa")) == 1


def clocked(seed: int, name: bytes, **changes: object) -> bytes:
    """With an observation and a map of a clock, for track 0."""
    out = io.BytesIO(data := made("lossless", seed, **changes))
    out.seek(len(data))
    writer = FileWriter.resume(out, open_catalogue(BytesSource(data), scan=True))
    for type_ in ("cLOk", "cMAp"):
        count, rest = (1, b"\x05") if type_ == "cLOk" else (2, b"\x07\x07")
        head = bytes([1, len(name)]) + name + bytes([count, 6]) + struct.pack("<q", 7)
        writer.chunk(type_, head + rest)
    writer.close()
    return out.getvalue()


def test_maps_of_clocks_hold_for_their_own_file_only() -> None:
    one = clocked(0, b"ptp")
    assert_intact(one)
    whole, edited = concat(split_up(one, every=1))
    assert len(chunks_of(whole, "cMAp")) == len(chunks_of(whole, "cLOk")) == 1
    joined, edited = concat([one, clocked(1, b"ptp", **OTHER)])
    assert_intact(joined)
    assert chunks_of(joined, "cMAp") == [] and len(chunks_of(joined, "cLOk")) == 2
    assert "cMAp chunk left out: packets of other files come to its track" in edited.notes
    first, second = split_up(one, at=[1])
    other = split_up(clocked(0, b"ntp"), at=[1])[1]
    mixed, edited = concat([first, other])
    assert chunks_of(mixed, "cMAp") == [] and len(chunks_of(mixed, "cLOk")) == 2
    assert_intact(mixed)
    alone, _ = concat([second])
    assert len(chunks_of(alone, "cMAp")) == 1


def test_the_note_names_each_recording_once() -> None:
    parts, other = split_up(made("paper vectors"), at=[1]), made("paper vectors", 1, uuid=None)
    for files, told in [(parts, f"2 files of {UUID}"), ([parts[0], other], f"{UUID}")]:
        whole, _ = concat(files)
        assert hapfmt.read(whole).metadata["notes"][-1].startswith(f"concatenated from {told} (")


def test_a_concatenation_can_be_cut_and_concatenated_again() -> None:
    files = [made("paper step", 0), made("paper step", 1, **OTHER)]
    joined, _ = concat(files)
    assert any(track.continues is not None for track in tracks_of(joined).values())
    again, _ = concat(split_up(joined, every=Fraction(7, 5)))
    assert_same(hapfmt.read(again), hapfmt.read(joined))
    assert by_label(again) == by_label(joined)
    out = io.BytesIO()
    edit.subset(joined, out, ["b"], band="lf")
    assert_intact(out.getvalue())
    assert_same(hapfmt.read(out.getvalue()), hapfmt.read(joined, ["b"], band="lf"))
    for band in ("hf", "full"):
        out = io.BytesIO()
        edit.subset(joined, out, ["c", "b"], 2, 5, band=band)
        assert_intact(out.getvalue())
        mine = hapfmt.read(out.getvalue(), None, 2, 5)
        assert_same(mine, hapfmt.read(joined, ["b", "c"], 2, 5, band=band))
