"""Subset, split and merge: laws of files that presets make (docs/spec/editing.md)."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
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
    write,
)
from hypothesis import assume, given
from hypothesis import strategies as st

import hapfmt
from hapfmt import edit
from hapfmt.edit.making import common_period

names = st.sampled_from(sorted(PRESETS))
times = st.fractions(0, 4, max_denominator=50)
EVENTS = (
    hapfmt.Event(Fraction(1, 10), "long", Fraction(1)),
    hapfmt.Event(Fraction(2, 10), "short", Fraction(1, 100)),
    hapfmt.Event(Fraction(1, 2), "half", channel=0),
    hapfmt.Event(Fraction(3, 2), "late"),
)


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
    """EDT-002: An editor MUST copy packets bit for bit, each as a whole, except the channel numbers in events. It may cut a packet at a sample on request: the new packet decodes to the same values, under the same description. To all times that it takes from a file it adds one number of seconds, whole ticks of every track. Where ticks move, it moves a known epoch by the same time, and drops the UUID, which names one recording on one time line."""
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


def test_an_exact_subset_between_two_ticks_of_a_slow_channel_has_none_of_its_samples() -> None:
    file = made("lossless doubles")
    part, _ = subset(file, ["slow"], Fraction(1, 3), Fraction(53, 150), exact=True)
    assert_intact(part)
    assert not hapfmt.read(part)["slow"].stored.size


UNCUT = "packets are kept whole, since they cannot be cut without a loss"


@given(names, st.data(), times, times, st.booleans())
def test_an_exact_subset_is_the_slice(
    name: str, data: st.DataObject, a: Fraction, b: Fraction, to_zero: bool
) -> None:
    """Its samples are those of the whole from start to stop, no more. What cannot be cut is named
    and stays whole. All other packets are copied."""
    file = made(name)
    start, stop = min(a, b), max(a, b) + Fraction(1, 50)
    with hapfmt.Reader(file) as reader:
        assume(start < reader.duration)
        known = [ref.label for ref in reader.channels]
    chosen = data.draw(st.lists(st.sampled_from(known), min_size=1, unique=True))
    part, edited = subset(file, chosen, start, stop, exact=True, to_zero=to_zero)
    assert_intact(part)
    whole = [note for note in edited.notes if UNCUT in note]
    assert not whole or not name.startswith("lossless")
    kept = [channel.label for channel in hapfmt.read(part).channels]
    if not to_zero:
        expected = hapfmt.read(file, kept, start, stop)
        found = hapfmt.read(part, kept, start, stop)
        for mine, theirs in zip(found.channels, expected.channels, strict=True):
            assert_same_channel(mine, theirs)
    for channel in hapfmt.read(part).channels:
        shift = 0 if not to_zero else edited.made[0] - edited.start if edited.made else 0
        first, last = (-((shift - time) * channel.rate_exact // 1) for time in (start, stop))
        outside = channel.stored.size and (channel.start_tick < first or channel.stop_tick > last)
        assert not outside or repr(channel.label) in whole[0]
    assert edited.asked == (start, stop) and edited.rounded == bool(edited.rounded and whole)
    before = {packet.data for packet in packets_of(file)}
    new = [packet for packet in packets_of(part) if packet.data not in before]
    assert len(new) <= 2 * len(tracks_of(part))


@given(names, st.data())
def test_exact_parts_are_the_whole_again(name: str, data: st.DataObject) -> None:
    file = made(name, events=EVENTS)
    cuts = data.draw(st.lists(times.filter(bool), min_size=1, max_size=5, unique=True).map(sorted))
    with TemporaryDirectory() as room:
        parts = edit.split(file, f"{room}/{{}}.hapf", at=cuts, exact=True)
        files = [Path(part.file).read_bytes() for part in parts]
    for part, content in zip(parts, files, strict=True):
        assert_intact(content)
        assert part.rounded == (part.rounded and any(UNCUT in note for note in part.notes))
    out = io.BytesIO()
    edit.concat(files, out)
    assert_intact(out.getvalue())
    assert_same(hapfmt.read(out.getvalue()), hapfmt.read(file))
    assert hapfmt.read(out.getvalue()).events == hapfmt.read(file).events


def test_what_an_exact_cut_can_take() -> None:
    """Each codec of a lossless file, with linear rules and states, at every sample of a packet."""
    g = np.random.default_rng(3)
    x = np.cumsum(g.normal(size=(2, 60)), axis=1)
    channels = [
        *(hapfmt.Channel(row, 100, label=f"x{n}") for n, row in enumerate([*x, 2 * x[0] + x[1]])),
        hapfmt.Channel(np.full(60, 7), 100, label="constant", calibration=hapfmt.Calibration()),
        hapfmt.Channel(g.integers(0, 99, 60), 100, label="n", calibration=hapfmt.Calibration()),
        hapfmt.Channel(g.integers(0, 1 << 63, 60).astype(np.uint64), 100, label="words"),
    ]
    file = write(hapfmt.Recording(channels), preset="lossless")
    whole = hapfmt.read(file)
    for start in range(60):
        for stop in {start + 1, (start + 61) // 2, 60} - {start}:
            part, edited = subset(file, None, Fraction(start, 100), Fraction(stop, 100), exact=True)
            assert_intact(part)
            assert not edited.rounded and [note[:7] for note in edited.notes] == ["digests"]
            assert edited.made == (Fraction(start, 100), Fraction(stop, 100))
            for mine, theirs in zip(hapfmt.read(part).channels, whole.channels, strict=True):
                assert_same_channel(mine, theirs.slice_ticks(start, stop))


def test_events_at_an_exact_cut() -> None:
    """They belong where they begin."""
    file = made("lossless", events=EVENTS)
    part, _ = subset(file, None, Fraction(1, 2), 1, exact=True)
    assert [event.text for event in hapfmt.read(part).events] == ["half"]


def test_what_was_asked_for_what_was_made_and_what_is_missing() -> None:
    """On the time line of the original, as fields and as notes."""
    file = made("lossless")
    for to_zero in (False, True):
        part, edited = subset(file, None, Fraction(6, 5), 2, to_zero=to_zero)
        assert edited.asked == (Fraction(6, 5), 2) and edited.made == (1, 2)
        assert (
            edited.rounded
            and "packets are kept whole; exact=True cuts at the sample" in edited.notes
        )
        zero = to_zero * 1
        assert edited.missing == [(("a", "b", "c"), Fraction(3, 2) - zero, Fraction(77, 50) - zero)]
        told = edited.as_json()
        assert (told["asked"], told["made"]) == ([1.2, 2.0], [1.0, 2.0])
        assert told["missing"] == [
            {"channels": ["a", "b", "c"], "start": 1.5 - zero, "stop": 1.54 - zero}
        ]
        assert hapfmt.read(part).channels[0].gaps != ()
    _, edited = subset(file, None, 3, 9)
    assert edited.missing[-1][1:] == (Fraction(76, 25), 9)
    _, edited = subset(file, "b", 1, Fraction(3, 2))
    assert (
        not edited.rounded
        and edited.missing == []
        and edited.notes == ["digests of 1 track left out: they are of other packets, or times"]
    )
    with pytest.raises(hapfmt.ParameterError, match="exact=True requires start or stop"):
        subset(file, exact=True)


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


def test_a_new_file_has_an_id_of_its_own(tmp_path: Path) -> None:
    """So copies can be appended to: samples of one never pass in the other. What is added in place
    keeps the id, which every chunk before it carries (WRT-006)."""
    file = tmp_path / "a.hapf"
    file.write_bytes(made("lossless"))
    recovered = tmp_path / "r.hapf"
    hapfmt.recover(file, recovered)
    parts = edit.split(file, f"{tmp_path}/part-{{}}.hapf", at=[1])
    copies = [subset(file)[0], subset(file)[0], merge([file])[0], recovered.read_bytes()]
    copies += [Path(part.file).read_bytes() for part in parts]
    out = io.BytesIO()
    edit.concat([file], out)
    copies.append(out.getvalue())
    ids = [hapfmt.Reader(data).catalogue.file_id for data in [file.read_bytes(), *copies]]
    assert len(set(ids)) == len(ids)
    edit.set_metadata(file, {"subject": "S2"})
    assert hapfmt.Reader(file.read_bytes()).catalogue.file_id == ids[0]
