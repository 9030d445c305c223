"""What an editor refuses, keeps and leaves out, in files made byte by byte (docs/spec/editing.md)."""

from __future__ import annotations

import io
import struct
from dataclasses import replace
from fractions import Fraction
from typing import Any

import forge
import numpy as np
import pytest
from depth import deep, either
from edited import (
    EPOCH_NS,
    UUID,
    assert_intact,
    assert_same,
    chunks_of,
    counts,
    described,
    made,
    packets_of,
    plain,
    recording,
    tracks_of,
    waves,
    write,
)
from hypothesis import given
from hypothesis import strategies as st
from strategies import jsons, metadata
from test_concat import concat
from test_edit import merge, split_up, subset
from test_recover import recovered

import hapfmt
from hapfmt import edit
from hapfmt.edit.joining import nearest
from hapfmt.edit.making import Original, combined, common_period
from hapfmt.format.source import BytesSource
from hapfmt.limits import LEVELS
from hapfmt.reading.catalogue import Catalogue
from hapfmt.reading.opening import open_catalogue
from hapfmt.writing.start import open_append

DAMAGED, UNSUPPORTED = 3, 4


def catalogue_of(data: bytes) -> Catalogue:
    return open_catalogue(BytesSource(data), scan=True)


def types_of(data: bytes) -> list[str]:
    return [ref.type for ref in catalogue_of(data).chunks]


class TestRefusals:
    """EDT-001: An editor MUST refuse a file with damage, one that was not closed, and one with an unknown critical chunk. It reports what else it leaves out."""

    @pytest.mark.parametrize("verb", ["subset", "split", "concat", "merge", "attach", "meta"])
    @pytest.mark.parametrize("fault", ["flipped", "cut", "open", "critical"])
    def test_by_every_verb(self, verb: str, fault: str, tmp_path: Any) -> None:
        data = bytearray(made("lossless"))
        if fault == "flipped":
            data[len(data) // 2] ^= 1
        elif fault == "cut":
            data = data[: len(data) // 2]
        elif fault == "open":
            data = data[: -forge.FOOT]
        else:
            data = bytearray(forge.minimal(("XXXx", b"")))
        out = tmp_path / "out.hapf"
        file = bytes(data)
        given: Any = {
            "subset": lambda: edit.subset(file, out),
            "split": lambda: edit.split(file, f"{tmp_path}/{{}}.hapf", every=1),
            "concat": lambda: edit.concat([made("lossless"), file], out),
            "merge": lambda: edit.merge([made("lossless"), file], out),
            "attach": lambda: edit.attach(file, [edit.attachment_of(__file__)], out),
            "meta": lambda: edit.set_metadata(file, {"a": 1}, out),
        }
        with pytest.raises(hapfmt.HapfmtError) as caught:
            given[verb]()
        assert caught.value.exit_code == (UNSUPPORTED if fault == "critical" else DAMAGED)
        if fault != "critical":
            assert "nothing was written: run hapfmt recover first" in str(caught.value)
        assert list(tmp_path.iterdir()) == []

    def test_damage_that_only_the_copying_meets(self) -> None:
        """By its index a file opens whatever is wrong with its clusters."""
        long = replace(plain(0), attachments={"a": ("", bytes(1 << 16))})
        data = bytearray(write(long, cluster=Fraction(1, 2)))
        refs = catalogue_of(bytes(data)).data
        data[refs[2].offset + 40] ^= 1
        whole, _ = subset(bytes(data), None, 0, Fraction(1, 4))
        assert_intact(whole)
        with pytest.raises(
            hapfmt.ChecksumError, match="checksum error in the payload of a DATA chunk; no"
        ):
            subset(bytes(data), None, 0, 3)

    def test_packets_that_overlap(self) -> None:
        again = ("DATA", forge.cluster((0, 2, 4, forge.KNOT_DATA)))
        data = forge.minimal(again, duration_ns=6_000_000)
        with pytest.raises(hapfmt.FormatError, match="packets of track 0 overlap"):
            subset(data)

    def test_an_lf_track_alone(self) -> None:
        data = forge.closed(("HEAD", forge.head()), ("TRAK", forge.trak(kind=1)))
        with pytest.raises(hapfmt.FormatError, match="LF track 0 without an HF track"):
            subset(data)

    def test_tracks_whose_description_nobody_knows(self) -> None:
        strange = (
            "TRAK",
            forge.trak(first_channel=1, tlvs=forge.HOLD + forge.tlv(101, b""), first=1),
        )
        data = forge.closed(("HEAD", forge.head()), forge.TRACK_0, strange, forge.DATA_0)
        with pytest.raises(
            hapfmt.UnsupportedError, match=r"critical TLV 101 .* leave its channels out"
        ):
            subset(data)
        part, _ = subset(data, [0])
        assert_intact(part)

    @pytest.mark.parametrize("what", ["kind", "number_format"])
    def test_an_unknown_codec_beside_something_else_unknown(self, what: str) -> None:
        strange = forge.trak(first_channel=1, codec=b"WHAT", first=1, **{what: 15})
        data = forge.closed(("HEAD", forge.head()), forge.TRACK_0, ("TRAK", strange), forge.DATA_0)
        with pytest.raises(hapfmt.UnsupportedError, match=r"15 .* leave its channels out"):
            subset(data, [1])

    def test_channels_by_pattern_and_from_the_end(self) -> None:
        data = made("lossless")
        for channels in ("[ab]", [0, -2], ["b", "a"]):
            part, _ = subset(data, channels)
            assert hapfmt.read(part).labels == ["a", "b"]

    def test_wrong_use(self, tmp_path: Any) -> None:
        data = made("lossless")
        wrong = [
            (lambda: subset(data, ["x"]), "no channel 'x'; there are: 0='a', 1='b', 2='c'"),
            (lambda: subset(data, band="mid"), "band is one of"),
            (lambda: subset(data, level=3), "level must be 1 or 2"),
            (lambda: subset(data, canonical=-1), "the file id must be between"),
            (lambda: subset(data, band="hf"), "none of these channels has this band"),
            (lambda: split_up(data), "give either every or at"),
            (lambda: split_up(data, every=-1), "above 0 and rising"),
            (lambda: split_up(data, at=[2, 1]), "above 0 and rising"),
            (lambda: edit.split(data, "part.hapf", every=1), "one place for its number"),
            (lambda: edit.split(data, "{}{}.hapf", every=1), "one place for its number"),
            (lambda: edit.split(data, "{0.real}.hapf", every=1), "one place for its number"),
            (lambda: edit.split(data, "{.hapf", every=1), "one place for its number"),
            (lambda: merge([]), "nothing to merge"),
            (lambda: merge([data], prefixes=["a", "b"]), "one prefix for each file"),
            (lambda: edit.attach(data, [], tmp_path / "x"), "nothing to attach"),
            (lambda: edit.set_metadata(data, {}, tmp_path / "x"), "nothing to set"),
            (lambda: edit.set_metadata(data, {"a": 1}), "a pipe cannot be changed in place"),
            (lambda: edit.extract(data, ["x"]), "no attachment 'x'; there are: 'sheet.txt'"),
        ]
        for call, message in wrong:
            with pytest.raises(hapfmt.ParameterError) as caught:
                call()
            assert message in str(caught.value)

    def test_an_output_that_exists(self, tmp_path: Any) -> None:
        path = tmp_path / "a.hapf"
        path.write_bytes(made("lossless"))
        with pytest.raises(hapfmt.ParameterError, match="already exists"):
            edit.subset(path, path)
        edit.subset(path, path, ["a"], force=True)
        assert [c.label for c in hapfmt.read(path).channels] == ["a"]
        with pytest.raises(hapfmt.ParameterError, match="already exists"):
            edit.attach(path, [edit.attachment_of(__file__)], path)


class TestChunks:
    """EDT-005: Under the new track ids, an editor MUST keep attachments but [overviews](overview.md), clock chunks, and chunks of unknown types that are safe to copy. The ticks of clock chunks move with their tracks. It leaves out other chunks of unknown types, and clock chunks of a track that it leaves out. It loses no member of the metadata: where files differ in one, the later ones get other names. It keeps a digest only if the new file contains every packet of its track, and no others, at the same ticks."""

    def test_unknown_ones_by_their_letters(self) -> None:
        data = two_tracks(
            ("xySz", b"safe"),
            ("xyZZ", b"unsafe"),
        )
        part, edited = subset(data, [1])
        assert_intact(part)
        assert chunks_of(part, "xySz") == [b"safe"]
        assert [header.type for header in catalogue_of(part).unknown] == ["xySz"]
        assert edited.notes == [
            "xySz chunk copied: unknown, but safe to copy",
            "xyZZ chunk left out: unknown, and unsafe to copy",
        ]

    def test_channels_of_one_track(self) -> None:
        _, edited = subset(made("paper vectors"), ["fy"])
        assert edited.notes[0] == "also copied, as tracks are kept whole: fx, fz"

    def test_before_and_behind_the_packets(self) -> None:
        data = forge.closed(
            ("HEAD", forge.head()), forge.TRACK_0, ("aaaa", b"1"), forge.DATA_0, ("bbbb", b"2")
        )
        part, _ = subset(data)
        kinds = [x for x in types_of(part) if x in ("aaaa", "DATA", "bbbb")]
        assert kinds == ["aaaa", "DATA", "bbbb"]

    def test_attachments_stay_whatever_they_speak_of(self) -> None:
        attached = bytes([1]) + b"a" + bytes([0]) + b"content"
        part, _ = subset(two_tracks(("aTTc", attached)), [1])
        assert chunks_of(part, "aTTc") == [attached]
        assert_intact(part)

    def test_clocks_move_along(self) -> None:
        def clock(tick: int, track: int | None = None) -> bytes:
            head = (
                forge.clock_of(track) + forge.strings("ptp") + forge.varint(1) + forge.svarint(tick)
            )
            return head + struct.pack("<q", 10**18) + forge.varint(5)

        second = ("TRAK", forge.trak(first_channel=1, rate_num=3, first=1))
        data = forge.closed(
            ("HEAD", forge.head()), forge.TRACK_0, second, ("cLOk", clock(7, track=0)),
            ("cLOk", clock(10**9)), ("cMAp", clock(-2, track=1)),
            ("DATA", forge.cluster((0, 5000, 4, forge.KNOT_DATA))), duration_ns=5_004_000_000,
        )  # fmt: skip
        same, _ = subset(data)
        assert chunks_of(same, "cLOk") == chunks_of(data, "cLOk")
        moved, edited = subset(data, to_zero=True)
        assert edited.notes == []
        assert chunks_of(moved, "cLOk") == [clock(7 - 5000, 0), clock(10**9 - 5 * 10**9)]
        assert chunks_of(moved, "cMAp") == [clock(-2 - 15, 1)]
        part, edited = subset(data, [1])
        assert chunks_of(part, "cLOk") == [clock(10**9)] and chunks_of(part, "cMAp") == [
            clock(-2, 0)
        ]
        assert edited.notes == ["cLOk chunk left out: it refers to track 0"]
        third, edited = merge([data], offsets={0: Fraction(1)})
        assert chunks_of(third, "cLOk")[0] == clock(1007, 0)
        only = forge.closed(("HEAD", forge.head()), ("TRAK", second[1]), ("cLOk", clock(1)))
        gone, edited = merge([only], offsets={0: Fraction(1, 3)})
        assert chunks_of(gone, "cLOk") == []
        assert edited.notes == ["cLOk chunk left out: its ticks cannot move so"]

    def test_twice_in_one_file_stays_twice(self) -> None:
        part, _ = subset(two_tracks(("xySz", b"safe"), ("xySz", b"safe")))
        assert chunks_of(part, "xySz") == [b"safe"] * 2

    def test_each_once_where_parts_repeat_them(self) -> None:
        data = two_tracks(("xySz", b"safe"))
        both, _ = merge([data, data], times="same")
        assert chunks_of(both, "xySz") == [b"safe"]


def two_tracks(*more: Any) -> bytes:
    """Two channels, each with four samples."""
    second = ("TRAK", forge.trak(first_channel=1, first=1))
    data = ("DATA", forge.cluster((0, 0, 4, forge.KNOT_DATA), (1, 0, 4, forge.KNOT_DATA)))
    return forge.closed(("HEAD", forge.head()), forge.TRACK_0, second, data, *more)


class TestDescriptions:
    def test_unknown_tlvs_stay(self) -> None:
        tlvs = forge.HOLD + forge.tlv(20, b"weights") + forge.tlv(98, b"?")
        both = forge.trak(tlvs, track_count=2)
        data = forge.closed(("HEAD", forge.head()), ("TRAK", both), forge.DATA_0)
        whole, edited = subset(data)
        assert described(whole) == [both] and edited.notes == []
        second, edited = subset(data, [1])
        assert described(second) == [forge.trak(tlvs)] and edited.notes == []
        moved, edited = merge([made("lossless"), data], times="same")
        assert described(moved)[1] == forge.trak(tlvs, track_count=2, first_channel=3, first=3)
        for file in (whole, second, moved):
            assert_intact(file)

    def test_unknown_tlvs_of_a_track_whose_kind_changes(self) -> None:
        hf = forge.tracks(
            forge.track(forge.HOLD + forge.tlv(98, b"?"), kind=1), forge.track(kind=2, base=0)
        )
        data = forge.closed(("HEAD", forge.head()), ("TRAK", hf), forge.DATA_0)
        slow, edited = subset(data, band="lf")
        assert tracks_of(slow)[0].unknown == ()
        assert "TLVs 98 of track 0 left out: not known here" in edited.notes
        assert_intact(slow)

    def test_unknown_tlvs_of_head(self) -> None:
        data = forge.closed(("HEAD", forge.head(forge.tlv(98, b"?"))), forge.TRACK_0, forge.DATA_0)
        part, edited = subset(data)
        assert edited.notes == ["TLVs of HEAD left out: not known here"]
        assert_intact(part)

    def test_channels_in_any_order(self) -> None:
        three = forge.tracks(*(forge.track(first_channel=number) for number in (2, 0, 1)))
        data = forge.closed(("HEAD", forge.head()), ("TRAK", three), forge.DATA_0)
        whole, _ = subset(data)
        assert described(whole) == [three]
        part, _ = subset(data, [0, 2])
        assert [t.first_channel for t in tracks_of(part).values()] == [1, 0]
        for file in (whole, part, merge([data, data], times="same")[0]):
            assert_intact(file)

    @pytest.mark.parametrize("level", [1, *deep([2])])
    def test_long_texts(self, level: int) -> None:
        """No rule limits them but that of payloads."""
        size = LEVELS[level].payload_size - 100
        encoder, provenance = forge.tlv(6, b"e" * size), forge.tlv(22, b"p" * size)
        tracks = ("TRAK", forge.trak(forge.HOLD + provenance))
        data = forge.closed(("HEAD", forge.head(encoder, level=level)), tracks, forge.DATA_0)
        for copy in (subset(data)[0], merge([data])[0], recovered(data)[0]):
            assert_intact(copy)
            catalogue = catalogue_of(copy)
            assert catalogue.head is not None and catalogue.head.encoder == "e" * size
            assert catalogue.tracks[0].provenance == "p" * size

    @pytest.mark.parametrize("labels", ["", "abc"])
    def test_components_in_another_order(self, labels: str) -> None:
        """EDT-004: A track MUST keep its description except where its position in the new file requires a change; one description may serve tracks of several files only where no decoded number, contract or text differs by it."""
        packet = b"".join(map(forge.svarint, (5, 6, 7)))

        def file(*order: int) -> bytes:
            names = forge.strings(*(labels[number] for number in order)) if labels else b"\0"
            tlvs = forge.HOLD + forge.tlv(2, names)
            tlvs += forge.tlv(5, struct.pack("<2H", *order[1:]))
            track = forge.trak(tlvs, component_count=3, first_channel=order[0])
            data = ("DATA", forge.cluster((0, 0, 4, packet)))
            return forge.closed(("HEAD", forge.head()), ("TRAK", track), data)

        joined, _ = concat([file(2, 0, 1), file(2, 0, 1)], gap=0)
        assert [list(channel.counts) for channel in hapfmt.read(joined)] == [
            [6] * 8, [7] * 8, [5] * 8,
        ]  # fmt: skip
        with pytest.raises(hapfmt.ParameterError, match="channels 2, 1, 0 are coded together"):
            concat([file(2, 0, 1), file(2, 1, 0)], gap=0)

    def test_a_codec_of_another_time_is_copied(self) -> None:
        track = forge.trak(codec=b"xNEW", tlvs=forge.tlv(1, b"who knows"))
        data = forge.closed(
            ("HEAD", forge.head()), ("TRAK", track),
            ("DATA", forge.cluster((0, 0, 4, b"coded"))),
        )  # fmt: skip
        part, _ = subset(data)
        assert described(part) == [track]
        assert packets_of(part)[0].data == b"coded"
        assert hapfmt.verify(part).exit_code == UNSUPPORTED

    def test_prefixes(self) -> None:
        one, two = made("paper vectors"), made("paper vectors", 1, uuid=None)
        both, edited = merge([one, two], prefixes=["l/", ""])
        assert edited.notes == []
        back = hapfmt.read(both)
        assert [c.label for c in back.channels][:5] == ["l/fx", "l/fy", "l/fz", "l/alone", "fx"]
        assert [c.group for c in back.channels][:5] == ["l/f", "l/f", "l/f", "", "f"]
        assert_intact(both)
        _, edited = merge([one, two])
        assert edited.notes[0].startswith("labels that more than one file has: alone, fx, fy, fz;")


class TestTimes:
    """EDT-002: An editor MUST copy packets bit for bit, each as a whole, except the channel numbers in events. It may cut a packet at a sample on request: the new packet decodes to the same values, under the same description. To all times that it takes from a file it adds one number of seconds, whole ticks of every track. Where ticks move, it moves a known epoch by the same time, and drops the UUID, which names one recording on one time line."""

    def test_offsets(self) -> None:
        one, two = made("lossless"), made("lossless", 1, uuid=None)
        both, edited = merge([one, two], offsets={0: Fraction(1, 2), 1: 2})
        assert_intact(both)
        back = hapfmt.read(both)
        assert back.epoch_ns == EPOCH_NS - 5 * 10**8 and back.uuid not in (UUID, None)
        assert [c.start_tick for c in back.channels] == [250] * 3 + [1000] * 3
        assert edited.offsets == [Fraction(1, 2), 2]
        with pytest.raises(hapfmt.ParameterError, match="the nearest one: 1/250 s"):
            merge([one, two], offsets={1: Fraction(41, 10000)})
        with pytest.raises(hapfmt.ParameterError, match="an offset must not be negative"):
            merge([one, two], offsets={1: -1})
        with pytest.raises(hapfmt.ParameterError, match="not two of them"):
            merge([one, two], offsets={1: 1}, times="same")

    def test_by_epoch(self) -> None:
        one = made("lossless", epoch_ns=EPOCH_NS + 2_000_300_000)
        two = made("lossless doubles", 1)
        both, edited = merge([one, two], times="epoch")
        assert edited.offsets == [2, 0]
        assert edited.notes[0] == "the input: -0.0003 s from its epoch, to whole ticks"
        assert hapfmt.read(both).epoch_ns == EPOCH_NS
        assert_intact(both)
        with pytest.raises(hapfmt.ParameterError, match="the epoch is not known: give the offset"):
            merge([one, made("lossless", 1, epoch_ns=None)], times="epoch")

    def test_files_that_do_not_say(self) -> None:
        one, two = made("lossless"), made("lossless", 1, epoch_ns=EPOCH_NS + 5, uuid=None)
        with pytest.raises(hapfmt.ParameterError, match="the files do not say how their times"):
            merge([one, two])
        alike, _ = merge([one, made("lossless", 1, uuid=None)])
        assert hapfmt.read(alike).uuid not in (UUID, None)
        assert len(chunks_of(alike, "dGST")) == 2
        assert_intact(alike, digests=6)

    def test_a_canonical_result_has_the_uuid_of_its_id(self) -> None:
        one = made("lossless")
        twice = [merge([one, one], offsets={1: 1}, canonical=5)[0] for _ in range(2)]
        assert twice[0] == twice[1]
        assert str(hapfmt.read(twice[0]).uuid) == "00000000-0000-8000-8500-000000000000"

    def test_an_epoch_between_two_nanoseconds(self) -> None:
        values = np.arange(3000, dtype=np.int32)
        one = hapfmt.Recording(
            (hapfmt.Channel(values[1500:], Fraction(3), (hapfmt.Span(1, 1501),), calibration=hapfmt.Calibration()),),
            epoch_ns=10, epoch_uncertainty_ns=4,
        )  # fmt: skip
        part, _ = subset(write(one), to_zero=True)
        back = hapfmt.read(part)
        assert (back.epoch_ns, back.epoch_uncertainty_ns) == (333333343, 5)
        far = replace(one, epoch_ns=(1 << 63) - 1)
        assert hapfmt.read(subset(write(far), to_zero=True)[0]).epoch_ns is None

    @given(
        st.lists(
            st.builds(Fraction, st.integers(1, 99), st.integers(1, 99)), min_size=1, max_size=4
        )
    )
    def test_the_common_period(self, rates: list[Fraction]) -> None:
        period = common_period(rates)
        assert all((period * rate).denominator == 1 for rate in rates)
        for parts in range(2, 8):
            assert any((period / parts * rate).denominator != 1 for rate in rates)

    @given(st.fractions(0, 100), st.fractions(Fraction(1, 100), 10))
    def test_the_nearest_offset(self, seconds: Fraction, period: Fraction) -> None:
        found = nearest(seconds, period)
        assert found % period == 0 and abs(found - seconds) <= period / 2


class TestDigests:
    """EDT-005: Under the new track ids, an editor MUST keep attachments but [overviews](overview.md), clock chunks, and chunks of unknown types that are safe to copy. The ticks of clock chunks move with their tracks. It leaves out other chunks of unknown types, and clock chunks of a track that it leaves out. It loses no member of the metadata: where files differ in one, the later ones get other names. It keeps a digest only if the new file contains every packet of its track, and no others, at the same ticks."""

    def test_of_what_is_kept_as_a_whole(self) -> None:
        data = made("paper step")
        count = hapfmt.verify(data).digests
        assert count == 6
        cases = [
            (subset(data)[0], 6),
            (subset(data, ["b"])[0], 2),
            (subset(data, band="lf")[0], 3),
            (subset(data, band="hf")[0], 3),
            (subset(data, None, 0, 100)[0], 0),
            (subset(data, None, 1, 2)[0], 0),
            (merge([data, data], offsets={1: 1}, prefixes="ab")[0], 6),
        ]
        for file, digests in cases:
            assert_intact(file, digests=digests)

    def test_of_a_file_that_was_appended_to(self, tmp_path: Any) -> None:
        path = tmp_path / "a.hapf"
        path.write_bytes(made("lossless"))
        first = packets_of(path.read_bytes())[0]
        with open_append(path) as (_, writer, _):
            writer.cluster([replace(first, start=5000)])
        assert_intact(path.read_bytes(), digests=3)
        part, edited = subset(path.read_bytes())
        assert_intact(part, digests=2)
        assert edited.notes == ["digests of 1 track left out: they are of other packets, or times"]

    def test_a_part_that_holds_all_of_a_track(self) -> None:
        a, b, _ = waves(3, 1)
        early = replace(counts("early", a[:100]), coverage=(hapfmt.Span(0, 100),))
        data = write(recording(early, counts("late", b)), preset="lossless", cluster=Fraction(1, 2))
        first, second = split_up(data, at=[1])
        assert_intact(first)
        assert_intact(second)


class TestMetadata:
    """EDT-005: Under the new track ids, an editor MUST keep attachments but [overviews](overview.md), clock chunks, and chunks of unknown types that are safe to copy. The ticks of clock chunks move with their tracks. It leaves out other chunks of unknown types, and clock chunks of a track that it leaves out. It loses no member of the metadata: where files differ in one, the later ones get other names. It keeps a digest only if the new file contains every packet of its track, and no others, at the same ticks."""

    @given(st.lists(metadata, max_size=4))
    def test_of_several_files(self, parts: list[dict[str, Any]]) -> None:
        found = combined(parts)
        for part in parts:
            for name, value in part.items():
                if name == "notes":
                    listed = value if isinstance(value, list) else [value]
                    assert all(note in found["notes"] for note in listed)
                    continue
                names = [x for x in found if x == name or x.startswith(f"{name} (")]
                assert any(repr(found[x]) == repr(value) for x in names)

    @given(jsons)
    def test_of_one_file(self, value: Any) -> None:
        assert combined([{"a": value}, {"a": value}]) == {"a": value}

    def test_what_happened_is_noted(self) -> None:
        data = made("lossless")
        notes = hapfmt.read(subset(data, ["a", "b"], 1, Fraction(5, 2))[0]).metadata["notes"]
        assert notes == ["recorded on a Monday", f"subset of {UUID}: channels 0, 1; 1:2.5 s"]
        notes = hapfmt.read(
            merge([data, made("lossless", epoch_ns=None)], times="same")[0]
        ).metadata
        assert notes["notes"][-1] == f"merged from {UUID}, {UUID}"


class TestLevels:
    def test_kept_or_raised(self) -> None:
        one = made("lossless")
        big = counts("big", np.array([1 << 24, -5, 7], np.int32), coverage=(hapfmt.Span(0, 3),))
        two = write(replace(recording(big), uuid=None), preset="lossless")
        assert catalogue_of(one).level.number == 1 and catalogue_of(two).level.number == 2
        both, edited = merge([one, two])
        assert catalogue_of(both).level.number == edited.level == 2
        assert_intact(both)
        assert_same(hapfmt.read(subset(both, [0, 1, 2])[0]), hapfmt.read(both, [0, 1, 2]))
        raised, edited = subset(one, level=2)
        assert edited.level == 2 and catalogue_of(raised).level.number == 2
        assert subset(two, level=1)[1].level == 2

    def test_a_residual_that_is_wider_than_a_channel_may_be(self) -> None:
        """An HF track of level 1 has 25 bits, a full band 24."""
        lf = ("TRAK", forge.trak(kind=1))
        hf = ("TRAK", forge.trak(kind=2, base=0, count_max=1 << 23, first=1))
        data = ("DATA", forge.cluster((0, 0, 4, forge.KNOT_DATA), (1, 0, 4, forge.KNOT_DATA)))
        part, edited = subset(forge.closed(("HEAD", forge.head()), lf, hf, data), band="hf")
        assert edited.level == 2
        assert_intact(part)


@either("count", 650_000, deep=2_600_000)
def test_nothing_but_one_cluster_is_in_memory(tmp_path: Any, count: int) -> None:
    """A file of 5 or 20 MB, in clusters of 100 KB."""
    import tracemalloc

    generator = np.random.default_rng(1)
    words = generator.integers(0, 1 << 63, count, dtype=np.uint64)
    channel = hapfmt.Channel(words, Fraction(10_000), label="noise")
    path, out = tmp_path / "a.hapf", tmp_path / "b.hapf"
    settings = hapfmt.Settings.of("lossless", cluster=Fraction(1))
    hapfmt.write(hapfmt.Recording((channel,)), path, settings, canonical=1)
    del words, channel
    edit.subset(path, out, canonical=1)
    tracemalloc.start()
    edit.subset(path, out, canonical=1, force=True)
    edit.concat([path, path], out, gap=0, force=True)
    edit.split(path, f"{tmp_path}/part-{{}}.hapf", every=100)
    edit.merge([path, path], out, times="same", prefixes=["a", "b"], force=True)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 3_000_000


def test_clusters_stay_as_they_were() -> None:
    data = made("lossless", cluster=Fraction(1, 4))
    assert len(catalogue_of(subset(data)[0]).data) == len(catalogue_of(data).data) > 10
    both, _ = merge([data, made("lossless", 1, uuid=None)])
    times = [ref.start_ns for ref in catalogue_of(both).data]
    assert times == sorted(times)


def test_an_index_that_points_elsewhere() -> None:
    """IDX-003: A reader MUST check an entry against the header that it points to before it uses it. It reads the file in order where they differ, or where the sequence number of an index is not that after its last entry."""
    payload = struct.pack("<QQI", 8, 0, 3) + b"HEAD\x00TRAK\x23DATA\x30\x00\x04"
    chunks = [("HEAD", forge.head()), forge.TRACK_0, forge.DATA_0]
    body = forge.file(*chunks, ("iNDX", payload))
    distance = len(body) - len(forge.file(*chunks))
    data = body + forge.chunk("fOOT", forge.foot(distance, 4_000_000), 4)
    whole, _ = subset(data, None, 0, 1)
    assert len(packets_of(whole)) == 1


def test_original_by_name_and_pipe(tmp_path: Any) -> None:
    path = tmp_path / "x.hapf"
    path.write_bytes(made("lossless"))
    with Original(path) as original:
        assert original.name == str(path)
        assert edit.subset(original, io.BytesIO()).packet_count == 21
        assert edit.subset(original, io.BytesIO(), ["a"]).packet_count == 7
    with path.open("rb") as stream:
        assert edit.subset(stream, io.BytesIO()).packet_count == 21


def test_recordings_without_samples_or_channels() -> None:
    for whole in (
        hapfmt.Recording(),
        replace(plain(0), channels=(counts("x", np.zeros(0, np.int32), coverage=()),)),
    ):
        data = write(whole)
        for file in (
            subset(data)[0],
            merge([data, data], times="same")[0],
            split_up(data, every=1)[0],
        ):
            assert_intact(file)
        out = io.BytesIO()
        edited = edit.concat([data, data], out)
        assert_intact(out.getvalue())
        assert edited.start is None and edited.as_json()["start"] is None


def test_a_time_range_behind_the_end_is_refused(tmp_path: Any) -> None:
    out = tmp_path / "out.hapf"
    with pytest.raises(
        hapfmt.ParameterError, match=r"^No samples in this time range; .* ends at \d"
    ):
        edit.subset(made("lossless"), out, start=1000)
    assert not out.exists()
