"""docs/spec/overview.md: the overview that ``encode --overview`` adds, and what edits make of it."""

from __future__ import annotations

import io
import math
import random
import shutil
import subprocess
import zlib
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from commands import run
from hypothesis import given
from hypothesis import strategies as st
from overviews import check_bounds, found
from spec import ROOT
from strategies import recordings

import hapfmt
from hapfmt import edit
from hapfmt.errors import DataWarning, FormatError
from hapfmt.format.extras import OVERVIEW, OVERVIEW_NAMES, Attachment
from hapfmt.format.layout import OVERVIEW_CHANNEL, OVERVIEW_END, OVERVIEW_PART
from hapfmt.format.source import BytesSource
from hapfmt.reading import overview as reading
from hapfmt.reading.overview import BLOCK, EMPTY, Overview, overview_of
from hapfmt.writing import overview as writing


def written(recording, **options):
    out = io.BytesIO()
    hapfmt.write(recording, out, overview=True, **options)
    return out.getvalue()


def wave(seconds=60, channels=2, rate=1000):
    draw = np.random.default_rng(5)
    t = np.arange(seconds * rate) / rate
    values = 900 * np.sin(t * np.arange(1, channels + 1)[:, None]) + draw.normal(
        0, 3, (channels, t.size)
    )
    return hapfmt.Recording.from_array(values.astype(np.int32), rate)


def content_of(data):
    with hapfmt.Reader(data) as reader:
        (place,) = reading.places_of(reader.catalogue)
        return place, reader.catalogue.file_id


def resealed(data, change, row=None):
    """The content with a changed end or row of the table, and the checksums that belong to it."""
    (start, stop), file_id = content_of(data)
    content = data[start:stop]
    end = OVERVIEW_END.read(content, len(content) - OVERVIEW_END.size)._asdict()
    size = OVERVIEW_CHANNEL.size * end["channel_count"] + OVERVIEW_PART.size * end["part_count"]
    body, table = content[: -size - OVERVIEW_END.size], content[-size - OVERVIEW_END.size :][:size]
    if row is not None:
        layout, at = row
        fields = layout.read(table, at)._asdict()
        table = table[:at] + layout.pack(**{**fields, **change}) + table[at + layout.size :]
        change = {}
    raw = OVERVIEW_END.pack(**{**end, "table_crc": zlib.crc32(table), **change})[:-4]
    made = body + table + raw + zlib.crc32(raw).to_bytes(4, "little")
    return BytesSource(bytes(start) + made), start, start + len(made), file_id


class TestValues:
    """
    OVW-005: Each finite value of a bin MUST lie within the values of its lowest and highest code, or equal one. A bin is empty exactly where it has no finite value.
    """

    @pytest.mark.filterwarnings("ignore:no overview")
    @given(recordings(), st.sampled_from([8, 64]))
    def test_any_recording_lies_within_its_overview(self, recording, base):
        smallest, writing.SMALLEST_BASE = writing.SMALLEST_BASE, base
        try:
            data = written(recording)
        finally:
            writing.SMALLEST_BASE = smallest
        if found(data) is None:
            with hapfmt.Reader(data) as reader:
                ticks = sum(int(r.track.rate * reader.duration) for r in reader.channels)
            assert ticks > reading.LARGEST_BASE  # too long for bins of this size
            return
        check_bounds(data)

    @pytest.mark.parametrize("preset", ["near-lossless", "perceptual", "paper"])
    def test_what_is_lossy_lies_within_as_it_is_decoded(self, preset):
        """Not as it was recorded: a reader sees the decoded values."""
        recording = wave(20)
        force = tuple(replace(channel, unit="N") for channel in recording.channels)
        check_bounds(written(replace(recording, channels=force), preset=preset))

    @pytest.mark.parametrize(
        "values",
        [
            [0.0, 5e-324, -5e-324],
            [1.7976931348623157e308, -1.7976931348623157e308, 1e307],
            [1e9 + 1e-7, 1e9, 1e9 + 3e-7],
            [math.inf, -math.inf, math.nan],
            [math.inf, 3.0, 4.0],
            [2.5],
            [-0.0, 0.0],
        ],
    )
    def test_values_at_the_ends_of_binary64(self, values):
        check_bounds(written(np.repeat(np.array(values), 300)[None, :], rate=1000))

    def test_words_of_64_bits(self):
        ends = [-(2**63), 2**63 - 1, 2**53 + 1, 0]
        x = np.repeat(np.array(ends, np.int64), 400)
        check_bounds(written(hapfmt.Recording.from_array(x[None, :], 1000)))

    def test_rates_and_long_gaps(self):
        t = np.arange(40_000)
        gappy = np.sin(t / 50.0)
        gappy[5_000:33_000] = np.nan
        signals = {"a": gappy, "b": np.cos(t[:400] / 9.0), "c": np.arange(4, dtype=float)}
        data = written(signals, rate={"a": 1000, "b": 10, "c": Fraction(1, 10)})
        check_bounds(data)
        bins = found(data).envelope(0, 0)
        assert np.isnan(bins.low).sum() == 33_000 // 64 - (5_000 + 63) // 64


class TestLevels:
    """
    OVW-001: An overview MUST be an attachment (SPEC 11.4) with the name `overview` and the media type `haptics/vnd.hapf.overview`. Its content consists of parts, a table and an end, and keeps the rules of this page.
    OVW-003: Channel numbers MUST grow from row to row and be those of channels of the file. `first_tick + tick_count` is at most 2^48. `low` and `high` are finite, and `low` is at most `high`. The table has one row for each part that follows from the channels. The sizes of the parts are at least 1 and add up to the bytes before the table. A part inflates to exactly the bytes of its bins. The lowest code of a bin is at most its highest, and only an empty bin has the code -32768.
    """

    def test_a_long_channel_has_levels_and_blocks(self, monkeypatch):
        monkeypatch.setattr(writing, "SMALLEST_BASE", 4)
        monkeypatch.setattr(writing, "SMALL", 1 << 20)
        data = written(wave(130, 1))
        check_bounds(data)
        seen = found(data)
        count = 130_000 // 4
        assert seen.base == 4
        assert seen.levels(0) == 3  # 32500, 4063 and 508 bins
        blocks = -(-count // BLOCK)
        assert len(seen.parts) == blocks + 1 + 1
        order = sorted(seen.parts.values(), key=lambda part: part.offset)
        expected = [(0, block) for block in range(blocks)] + [(1, 0), (2, 0)]
        assert [(part.level, part.block) for part in order] == expected
        whole, part = seen.envelope(0, 0), seen.envelope(0, 0, 2, 3)
        assert part.first_bin == 2 * BLOCK
        assert np.array_equal(part.low, whole.low[2 * BLOCK : 3 * BLOCK])

    def test_it_is_small_and_near_the_index(self):
        data = written(wave(300, 4))
        (start, stop), _ = content_of(data)
        assert stop - start <= len(data) / 25
        assert data[start - len(OVERVIEW_NAMES) : start] == OVERVIEW_NAMES
        with hapfmt.Reader(data) as reader:
            types = [ref.type for ref in reader.catalogue.chunks]
        behind = types[types.index("aTTc") + 1 :]
        assert set(behind) <= {"HEAD", "TRAK", "iNDX", "fOOT"}
        assert len(data) - stop < 4096

    def test_it_is_made_in_several_passes_over_a_long_file(self, monkeypatch):
        once = written(wave(90), canonical=7)
        monkeypatch.setattr(writing, "AT_ONCE", 10_000)
        assert written(wave(90), canonical=7) == once

    def test_without_room_the_bins_grow(self, monkeypatch):
        monkeypatch.setattr(writing, "SMALL", 1000)
        monkeypatch.setattr(writing, "SHARE", 10**9)
        data = written(wave(300))
        (start, stop), _ = content_of(data)
        assert stop - start <= 1000
        assert found(data).base > writing.SMALLEST_BASE
        check_bounds(data)

    def test_without_any_room_there_is_none(self, monkeypatch):
        monkeypatch.setattr(writing, "SMALL", 100)
        monkeypatch.setattr(writing, "SHARE", 10**9)
        with pytest.warns(DataWarning, match="no overview: it would take too much of the file"):
            assert found(written(wave(5))) is None

    def test_no_channel(self):
        assert found(written(hapfmt.Recording(()))).channels == ()

    def test_a_stream_that_is_only_written(self, tmp_path):
        path = tmp_path / "touch.hapf"
        with path.open("wb") as stream:
            hapfmt.write(wave(), stream, overview=True, canonical=3)
        assert path.read_bytes() == written(wave(), canonical=3)
        assert found(written(wave(), canonical=3)) is not None

    def test_a_file_is_as_without_it_but_for_the_attachment(self):
        recording = wave()
        with_one, without = written(recording, canonical=3), io.BytesIO()
        hapfmt.write(recording, without, canonical=3)
        one, other = hapfmt.read(with_one), hapfmt.read(without.getvalue())
        assert np.array_equal(one.to_numpy(), other.to_numpy())
        assert one.metadata == other.metadata
        assert hapfmt.verify(with_one).exit_code == 0


class TestOtherFiles:
    """
    OVW-002: A reader MUST use an overview only for the values of chunks before `covered`, in a file with its `file_id`. Within the times that the index gives to a later `DATA` chunk, it takes the packets.
    OVW-009: An editor or a recoverer MUST NOT copy an overview into its new file. A program that appends to a file keeps it.
    """

    def test_parts_and_joined_files_have_none(self, tmp_path):
        data = written(wave())
        part, other, whole = (tmp_path / f"{name}.hapf" for name in "abc")
        notes = edit.subset(data, part, stop=30)
        edit.subset(data, other, start=30)
        edit.concat([part, other], whole)
        for path in (part, other, whole):
            with hapfmt.Reader(path) as reader:
                assert reader.attachments == {}
        assert any("overview" in note for note in notes.notes)

    def test_a_recovered_file_has_none(self, tmp_path):
        data = bytearray(written(wave()))
        data[5000] ^= 1
        hapfmt.recover(bytes(data), tmp_path / "whole.hapf")
        with hapfmt.Reader(tmp_path / "whole.hapf") as reader:
            assert reader.attachments == {}

    @pytest.mark.skipif(not shutil.which("node"), reason="node is not installed")
    def test_one_that_javascript_recovers_has_none(self, tmp_path):
        data = tmp_path / "touch.hapf"
        data.write_bytes(written(wave()))
        module = (ROOT / "hapfmt/viewer/decoder/recover.js").as_uri()
        program = (
            "import { readFileSync, writeFileSync } from 'node:fs';"
            f"import {{ recoverFile }} from '{module}';"
            "const { bytes } = recoverFile(new Uint8Array(readFileSync(process.argv[1])));"
            "writeFileSync(process.argv[2], bytes);"
        )
        out = tmp_path / "out.hapf"
        subprocess.run(
            ["node", "--input-type=module", "-e", program, str(data), str(out)], check=True
        )
        with hapfmt.Reader(out) as reader:
            assert reader.attachments == {}
            assert np.array_equal(reader.read().to_numpy(), hapfmt.read(data).to_numpy())

    def test_one_that_another_program_copied_is_not_used(self):
        source = written(wave(20), canonical=1)
        with hapfmt.Reader(source) as reader:
            copied = reader.attachments["overview"]
        assert found(source) is not None
        assert (copied.name, copied.media_type) == OVERVIEW
        other = replace(wave(30), attachments={copied.name: (copied.media_type, copied.content)})
        out = io.BytesIO()
        hapfmt.write(other, out, canonical=2)
        assert found(out.getvalue()) is None

    def test_what_is_appended_is_not_covered(self, tmp_path):
        path = tmp_path / "touch.hapf"
        path.write_bytes(written(wave()))
        before = found(path.read_bytes())
        edit.annotate(path, [hapfmt.Event(1, "touch")])
        edit.attach(path, [Attachment("a.txt", "", b"x")])
        after = found(path.read_bytes())
        assert after.covered == before.covered < path.stat().st_size
        assert after.channels == before.channels
        with hapfmt.Reader(path) as reader:
            later = [ref for ref in reader.catalogue.data if ref.offset >= after.covered]
        assert len(later) == 1

    def test_a_recording_does_not_carry_it_along(self):
        recording = hapfmt.read(written(replace(wave(), attachments={"a": ("", b"x")})))
        assert list(recording.attachments) == ["a"]


class TestHostile:
    """
    OVW-003: Channel numbers MUST grow from row to row and be those of channels of the file. `first_tick + tick_count` is at most 2^48. `low` and `high` are finite, and `low` is at most `high`. The table has one row for each part that follows from the channels. The sizes of the parts are at least 1 and add up to the bytes before the table. A part inflates to exactly the bytes of its bins. The lowest code of a bin is at most its highest, and only an empty bin has the code -32768.
    OVW-007: A reader MUST check the CRC of end, table and part, and each rule above but OVW-005, before it uses them. Before it takes memory it compares counts with bytes that are there. It treats an overview that breaks a rule as absent, and decodes packets instead. The file is not damaged by that.
    """

    DATA = written(wave(20), canonical=9)

    def test_an_unchanged_one_opens(self):
        source, *place = resealed(self.DATA, {})
        assert len(Overview(source, *place).channels) == 2

    @pytest.mark.parametrize(
        ("change", "rule"),
        [
            ({"magic": b"hOVX"}, "OVW-007"),
            ({"file_id": 8}, "OVW-002"),
            ({"covered": 2**63}, "OVW-002"),
            ({"base": 0}, "OVW-001"),
            ({"base": 65}, "OVW-001"),
            ({"base": 2**25}, "OVW-001"),
            ({"base": 1}, "OVW-003"),
            ({"channel_count": 2**32 - 1}, "OVW-003"),
            ({"part_count": 2**32 - 1}, "OVW-003"),
            ({"table_crc": 5}, "OVW-007"),
        ],
    )
    def test_an_end(self, change, rule):
        source, *place = resealed(self.DATA, change)
        with pytest.raises(FormatError) as error:
            Overview(source, *place)
        assert error.value.requirement == rule

    @pytest.mark.parametrize(
        ("change", "rule"),
        [
            ({"channel": 1}, "OVW-003"),
            ({"first_tick": 2**48}, "OVW-003"),
            ({"first_tick": 2**64 - 1, "tick_count": 2**64 - 1}, "OVW-003"),
            ({"tick_count": 2**48}, "OVW-003"),
            ({"tick_count": 0}, "OVW-003"),
            ({"low": math.nan}, "OVW-003"),
            ({"high": math.inf}, "OVW-003"),
            ({"low": 1.0, "high": 0.0}, "OVW-003"),
        ],
    )
    def test_a_channel(self, change, rule):
        source, *place = resealed(self.DATA, change, (OVERVIEW_CHANNEL, 0))
        with pytest.raises(FormatError) as error:
            Overview(source, *place)
        assert error.value.requirement == rule

    @pytest.mark.parametrize("change", [{"size": 0}, {"size": 2**32 - 1}])
    def test_a_part_of_another_size(self, change):
        row = OVERVIEW_PART, 2 * OVERVIEW_CHANNEL.size
        source, *place = resealed(self.DATA, change, row)
        with pytest.raises(FormatError, match="part") as error:
            Overview(source, *place)
        assert error.value.requirement == "OVW-003"

    def test_a_checksum_of_a_part(self):
        row = OVERVIEW_PART, 2 * OVERVIEW_CHANNEL.size
        source, *place = resealed(self.DATA, {"crc": 1}, row)
        with pytest.raises(FormatError) as error:
            Overview(source, *place).envelope(0, 0)
        assert error.value.requirement == "OVW-007"

    @given(st.integers(1, 50), st.randoms(use_true_random=False))
    def test_the_codes_of_a_part(self, count, draw):
        raw = np.array([draw.randrange(EMPTY, -EMPTY) for _ in range(2 * count)], np.int16)
        low, high = raw.reshape(2, count)
        good = np.all(low <= high) and np.all((low == EMPTY) == (high == EMPTY))
        data = reading.build_part(low, high)
        for bins in (count - 1, count + 1):
            with pytest.raises(FormatError):
                reading.parse_part(data, bins, 0)
        if good:
            assert [x.tolist() for x in reading.parse_part(data, count, 0)] == raw.reshape(
                2, count
            ).tolist()
        else:
            with pytest.raises(FormatError) as error:
                reading.parse_part(data, count, 0)
            assert error.value.requirement == "OVW-003"

    def test_any_bytes(self):
        """Changed bytes give an overview, none, or one of our errors."""
        draw = random.Random(4)
        (start, stop), _ = content_of(self.DATA)
        count = 0
        for _ in range(400):
            data = bytearray(self.DATA)
            for _ in range(draw.randrange(1, 4)):
                data[draw.randrange(start - 40, stop)] = draw.randrange(256)
            with hapfmt.Reader(bytes(data)) as reader:
                seen = overview_of(reader.catalogue)
            if seen is None:
                continue
            try:
                for row in seen.channels:
                    for level in range(seen.levels(row.channel)):
                        seen.envelope(row.channel, level)
            except FormatError:
                count += 1
        assert count > 0


def test_the_command(tmp_path):
    np.save(tmp_path / "f.npy", np.sin(np.arange(9000) / 30.0))
    words = ["encode", "f.npy", "f.hapf", "--rate", "1000", "--overview"]
    assert run(*words, cwd=tmp_path).returncode == 0
    check_bounds((tmp_path / "f.hapf").read_bytes())
    assert b"attachment: overview" in run("info", "f.hapf", cwd=tmp_path).stdout
