"""Subset, split and merge: laws of files that presets make (docs/spec/editing.md)."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path

import pytest
from edited import (
    EPOCH_NS,
    PRESETS,
    UUID,
    assert_intact,
    assert_same,
    assert_same_channel,
    by_label,
    chunks_of,
    made,
    packets_of,
    tracks_of,
)
from hypothesis import assume, given
from hypothesis import strategies as st

import hapfmt
from hapfmt import edit
from hapfmt.edit.making import common_period

names = st.sampled_from(sorted(PRESETS))
times = st.fractions(0, 4, max_denominator=50)


def subset(data: bytes, *arguments: object, **options: object) -> tuple[bytes, edit.Edited]:
    out = io.BytesIO()
    edited = edit.subset(data, out, *arguments, **options)
    return out.getvalue(), edited


def merge(files: list[bytes], **options: object) -> tuple[bytes, edit.Edited]:
    out = io.BytesIO()
    edited = edit.merge(files, out, **options)
    return out.getvalue(), edited


@pytest.mark.parametrize("name", PRESETS)
def test_a_subset_of_everything_is_the_same_file(name: str) -> None:
    data = made(name)
    part, edited = subset(data, canonical=1)
    assert_same(hapfmt.read(part), hapfmt.read(data))
    assert hapfmt.read(part).uuid == UUID
    assert packets_of(part)[0].data == packets_of(data)[0].data
    assert by_label(part) == by_label(data)
    assert chunks_of(part, "TRAK") == chunks_of(data, "TRAK")
    assert chunks_of(part, "dGST") == chunks_of(data, "dGST")
    assert_intact(part, digests=hapfmt.verify(data).digests)
    assert edited.file_size == len(part) and edited.notes == []
    assert edited.digest_count == len(tracks_of(data))


@given(names, st.data(), times, times)
def test_a_subset_reads_as_the_whole_does(
    name: str, data: st.DataObject, a: Fraction, b: Fraction
) -> None:
    """EDT-002: An editor MUST copy packets bit for bit, each as a whole, except the channel numbers in events. To all times that it takes from a file it adds one number of seconds, whole ticks of every track."""
    file = made(name)
    start, stop = min(a, b), max(a, b) + Fraction(1, 50)
    with hapfmt.Reader(file) as reader:
        assume(start < reader.duration)
        known = [ref.label for ref in reader.channels]
    chosen = data.draw(st.lists(st.sampled_from(known), min_size=1, unique=True))
    part, edited = subset(file, chosen, start, stop)
    assert_intact(part)
    whole = by_label(file)
    for key, rows in by_label(part).items():
        assert [row for row in whole[key] if row in rows] == rows
    kept = [channel.label for channel in hapfmt.read(part).channels]
    assert set(chosen) <= set(kept) and kept == [label for label in known if label in kept]
    inside, expected = (hapfmt.read(x, kept, start, stop) for x in (part, file))
    for mine, theirs in zip(inside.channels, expected.channels, strict=True):
        assert_same_channel(mine, theirs)
    everything = hapfmt.read(file, kept)
    for mine, theirs in zip(hapfmt.read(part).channels, everything.channels, strict=True):
        assert_same_channel(mine, restricted(theirs, mine))
    if edited.start is not None and edited.stop is not None:
        assert edited.start < stop and edited.stop > start


def restricted(channel: hapfmt.Channel, to: hapfmt.Channel) -> hapfmt.Channel:
    """The channel where another is covered."""
    first, last = to.start_tick, to.stop_tick
    return channel.slice_ticks(first, last)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("band", ["lf", "hf"])
def test_a_band_becomes_channels_of_its_own(name: str, band: str) -> None:
    """EDT-006: An LF or HF track without its partner MUST become a track of kind full band, whose contract is not guaranteed. A former HF track gets the components of its base, with B = 0."""
    data = made(name)
    with hapfmt.Reader(data) as reader:
        split = [ref.label for ref in reader.channels if ref.residual]
        labels = split if band == "hf" else [ref.label for ref in reader.channels]
        expected = reader.read(labels, band=band)
    if not split:
        with pytest.raises(hapfmt.ParameterError, match="none of these channels has this band"):
            subset(data, band=band)
        return
    part, _ = subset(data, band=band)
    assert_intact(part)
    assert_same(hapfmt.read(part), expected)
    for track in tracks_of(part).values():
        assert track.kind == "full"
        if track.components[0].label in split:
            assert track.contract is not None
    report = hapfmt.verify(part, against=PRESETS[name][0](0) if band == "lf" else None)
    assert report.exit_code == 0
    assert all(not check.contract.guaranteed for check in report.contracts if check.label in split)
    if name == "paper 1lsb":
        assert [check.outside for check in report.contracts] == [0] * len(report.contracts)


@given(names, times, times, st.booleans())
def test_moving_the_start_to_zero_moves_the_epoch(
    name: str, a: Fraction, b: Fraction, known: bool
) -> None:
    data = made(name, epoch_ns=EPOCH_NS if known else None)
    start, stop = min(a, b), max(a, b) + Fraction(1, 50)
    assume(start < hapfmt.read(data).duration)
    moved, edited = subset(data, None, start, stop, to_zero=True)
    kept, before = subset(data, None, start, stop)
    assert_intact(moved)
    if before.start is None:
        assert edited.start is None
        return
    period = common_period([track.rate for track in tracks_of(data).values()])
    shift = before.start - edited.start
    assert 0 <= edited.start < period and shift % period == 0
    one, other = hapfmt.read(moved), hapfmt.read(kept)
    for mine, theirs in zip(one.channels, other.channels, strict=True):
        ticks = int(shift * mine.rate_exact)
        assert mine.stored.tobytes() == theirs.stored.tobytes()
        assert [s.start + ticks for s in mine.coverage] == [s.start for s in theirs.coverage]
    assert one.epoch_ns == (EPOCH_NS + int(shift * 10**9) if known else None)
    assert one.uuid != other.uuid == UUID


@given(names, st.data())
def test_parts_hold_every_packet_once(name: str, data: st.DataObject) -> None:
    file = made(name)
    cuts = sorted(data.draw(st.sets(times.filter(bool), min_size=1, max_size=4)))
    parts = split_up(file, at=cuts)
    rows = by_label(file)
    for part in parts:
        assert_intact(part)
        assert packets_of(part)
        for key, row in by_label(part).items():
            assert row == rows[key][: len(row)]
            rows[key] = rows[key][len(row) :]
    assert not any(rows.values())


def split_up(file: bytes, **options: object) -> list[bytes]:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        made_ = edit.split(file, f"{folder}/{{:04d}}.hapf", **options)
        assert [Path(part.file).name for part in made_] == [
            f"{i:04d}.hapf" for i in range(len(made_))
        ]
        return [Path(part.file).read_bytes() for part in made_]


@pytest.mark.parametrize("name", PRESETS)
def test_every_second_a_part(name: str) -> None:
    file = made(name)
    parts = split_up(file, every=1)
    rates = {track.id: track.rate for track in tracks_of(file).values()}
    assert len(parts) == len({p.start // rates[p.track] for p in packets_of(file)})
    with hapfmt.Reader(file) as reader:
        labels = [ref.label for ref in reader.channels]
    for number, part in enumerate(parts):
        recording = hapfmt.read(part)
        assert [c.label for c in recording.channels] == labels and recording.uuid == UUID
        starts = [c.start_tick / c.rate_exact for c in recording.channels if c.stored.size]
        assert min(starts) >= number


@given(names, st.data())
def test_channels_apart_and_together_again(name: str, data: st.DataObject) -> None:
    """EDT-003: The channels that an editor writes MUST be numbered from 0 on in the order of their old numbers, file by file; events name the same channels as before, and events of channels that are left out are left out."""
    file = made(name)
    labels = [channel.label for channel in hapfmt.read(file).channels]
    first = data.draw(st.sets(st.sampled_from(labels), min_size=1, max_size=len(labels) - 1))
    one, _ = subset(file, sorted(first))
    others = [x for x in labels if x not in {c.label for c in hapfmt.read(one).channels}]
    if not others:
        return
    other, _ = subset(file, others)
    both, edited = merge([one, other])
    assert edited.notes == []
    assert_intact(both, digests=len(tracks_of(file)))
    back, whole = hapfmt.read(both), hapfmt.read(file)
    assert back.uuid == UUID
    order = [channel.label for part in (one, other) for channel in hapfmt.read(part).channels]
    assert [channel.label for channel in back.channels] == order
    assert_same(hapfmt.read(both, labels), whole)
    assert by_label(both) == by_label(file)
