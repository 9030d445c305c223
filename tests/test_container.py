"""Clauses 5, 6.1, 6.2, 11.3, 11.4: signature, chunk headers, HEAD, TLVs, metadata, attachments."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import os
import re
import subprocess
import sys
import unicodedata
import uuid
from concurrent.futures import ThreadPoolExecutor

import forge as f
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st
from judge import rule
from spec import ROOT, TEXT

from hapfmt.errors import FormatError, HapfmtError, ParameterError, UnsupportedError
from hapfmt.format.extras import (
    Attachment,
    build_attachment,
    build_metadata,
    parse_attachment,
    parse_metadata,
)
from hapfmt.format.layout import OVERVIEW_TABLES, TABLES
from hapfmt.format.source import BytesSource, StreamSource, open_source
from hapfmt.format.wire import (
    SIGNATURE,
    build_chunk,
    build_strings,
    build_tlvs,
    crc32,
    parse_head,
    parse_header,
    parse_strings,
    parse_tlvs,
    seed_of,
)
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

pytestmark = pytest.mark.capped

HEAD = ("HEAD", f.head())


class TestSignature:
    """
    FIL-001: A file MUST begin with the signature.
    """

    def test_value(self):
        assert f.SIGNATURE == SIGNATURE == b"\x8fHAP\r\n\x1a\n"

    def test_text_conversion_shows(self):
        good = f.minimal()
        for old, new in [(b"\r\n", b"\n"), (b"\n", b"\r\n"), (b"\x8f", b"?")]:
            assert rule(new.join(good.split(old)))[0] in ("damaged", "nonconforming")


class TestChunkHeader:
    def test_layout(self):
        built = build_chunk("mETa", b"{}", file_id=7, sequence=3)
        assert built == f.chunk("mETa", b"{}", 3)

    @given(strategies.chunk_headers)
    def test_comes_back(self, header):
        assert parse_header(header.build(), 0) == header

    @given(strategies.chunk_headers, st.integers(0, 255))
    def test_any_flip_shows(self, header, bit):
        """
        CHK-002: A header MUST have the sync word `F9 48 8B 1C`, a type of four ASCII letters, and the right `header_crc`. A reader uses no field of any other header.
        """
        data = bytearray(header.build())
        data[bit // 8] ^= 1 << bit % 8
        with pytest.raises(FormatError):
            parse_header(bytes(data), 0)

    @given(st.binary(max_size=40))
    def test_any_bytes(self, data):
        with pytest.raises(FormatError):
            parse_header(data, 0)

    def test_crc_is_that_of_zlib(self):
        assert (crc32(b"123456789"), crc32(b"")) == (0xCBF43926, 0)
        assert crc32(b"789", crc32(b"123456")) == 0xCBF43926

    def test_file_crc(self):
        """The example of clause 2."""
        found = crc32(b"123456789", seed_of(7))
        assert f"is 0x{found:08X}." in TEXT
        assert found == f.file_crc(b"123456789", 7)

    @given(st.binary(max_size=40), strategies.u64s, strategies.u64s)
    def test_bytes_have_one_file_crc_in_each_file(self, data, one, other):
        """From two start values the CRC of the same bytes differs, whatever they are."""
        same = seed_of(one) == seed_of(other)
        assert (crc32(data, seed_of(one)) == crc32(data, seed_of(other))) == same

    def test_sync_word_overlaps_no_shifted_copy(self):
        assert not any(f.SYNC[i:] == f.SYNC[:-i] for i in (1, 2, 3))

    def test_payload_crc(self):
        """
        CHK-003: `payload_crc` MUST be the file CRC of the payload.
        """
        assert rule(f.minimal(("mETa", b"{}"))) == ("intact", None)
        assert rule(f.minimal(("mETa", b"{}", {"crc": 0}))) == ("damaged", "CHK-003")
        crc = f.file_crc(b"{}")
        assert rule(f.minimal(("mETa", b"{}", {"crc": crc}))) == ("intact", None)

    def test_one_file_id(self):
        """
        CHK-004: All chunks of a file MUST have the same `file_id`.
        """
        assert rule(f.minimal(("mETa", b"{}", {"file_id": 8})))[0] == "damaged"

    @pytest.mark.parametrize("sequence", [0, 2, 4, 2**32 - 1])
    def test_sequence(self, sequence):
        """
        CHK-005: `sequence` MUST be 0 in the first chunk and greater by one in each next chunk.
        """
        assert rule(f.minimal(("mETa", b"{}", {"sequence": sequence}))) == ("damaged", "CHK-005")

    def test_four_letters(self):
        """
        CHK-002: A header MUST have the sync word `F9 48 8B 1C`, a type of four ASCII letters, and the right `header_crc`. A reader uses no field of any other header.
        """
        assert rule(f.minimal(("m3Ta", b"{}"))) == ("damaged", "FIL-002")

    def test_payload_size_of_the_level(self):
        """
        LIM-001: A file MUST keep the limits of its level, unknown chunks too.
        """
        text = b'{"a":"' + b"x" * 2**20 + b'"}'
        assert rule(f.minimal(("mETa", text))) == ("nonconforming", "LIM-001")
        wide = f.closed(("HEAD", f.head(level=2)), f.TRACK_0, f.DATA_0, ("mETa", text))
        assert rule(wide) == ("intact", None)


class TestUnknownChunks:
    """
    CHK-009: A reader that finds an unknown critical chunk MUST report the outcome *unsupported* (clause 13) and give no samples. A verifier then decodes no packet. This applies to a damaged chunk too, but not to a duplicate.
    CHK-010: A reader MUST skip unknown ancillary chunks, and list them on request.
    """

    @pytest.mark.parametrize("type_", ["xxxx", "xXXX", "xxXx", "aBcD"])
    def test_ancillary(self, type_):
        data = f.minimal((type_, b"anything"))
        report = verify(data)
        assert (report.verdict, report.unknown) == ("intact", [type_])
        assert Reader(data).read().channels[0].stored.tolist() == [5] * 4

    @pytest.mark.parametrize("type_", ["Xxxx", "XXXX", "Data"])
    def test_critical(self, type_):
        data = f.minimal((type_, b"anything"))
        assert verify(data).verdict == "unsupported"
        for start in (None, 0):
            with pytest.raises(UnsupportedError):
                Reader(data).read(start=start)


class TestHead:
    @given(strategies.heads())
    def test_comes_back(self, head):
        assert parse_head(head.build(), 0) == head

    def test_layout(self):
        tlvs = f.tlv(2, bytes(range(16))) + f.epoch(-1, 5) + f.tlv(6, b"own 1.0")
        for payload in (f.head(), f.head(tlvs, minor=3, level=2)):
            assert parse_head(payload, 0).build() == payload

    @pytest.mark.parametrize(
        "tlvs",
        [f.tlv(2, bytes(15)), f.tlv(4, bytes(17)), f.epoch(0, 2**63)],
        ids=["a UUID", "an epoch", "an uncertainty"],
    )
    def test_values(self, tlvs):
        """
        HED-002: `HEAD` MUST contain the fixed layout and then whole TLVs. The value of TLV 2 and of TLV 4 has 16 bytes, the uncertainty is less than 2^63.
        """
        assert rule(f.closed(("HEAD", f.head(tlvs)))) == ("nonconforming", "HED-002")

    def test_a_uuid_that_follows_from_the_file_id(self):
        """The pattern of the page."""
        data = f.closed(HEAD, file_id=0xFEDCBA9876543210)
        digits = dict(zip("abcdefghijklmnop", "fedcba9876543210", strict=True))
        (pattern,) = re.findall(r"the UUID is `([a-p0-9-]+)`", TEXT)
        expected = "".join(digits.get(letter, letter) for letter in pattern)
        assert str(Reader(data).read().uuid) == expected
        assert uuid.UUID(expected).version == 8

    def test_a_uuid_of_its_own(self):
        data = f.closed(("HEAD", f.head(f.tlv(2, bytes(range(16))))))
        assert Reader(data).read().uuid == uuid.UUID(bytes=bytes(range(16)))

    def test_an_encoder(self):
        data = f.closed(("HEAD", f.head(f.tlv(6, "µ 1".encode()))), ("mETa", b'{"a":1}'))
        assert Reader(data).metadata == {"encoder": "µ 1", "a": 1}
        assert rule(f.closed(("HEAD", f.head(f.tlv(6, b"\0"))))) == ("nonconforming", "CNV-004")

    @given(st.binary(max_size=60))
    def test_any_bytes(self, data):
        with contextlib.suppress(HapfmtError):
            assert parse_head(data, 0).level in (1, 2)

    def test_later_versions_are_read(self):
        """
        VER-001: A reader MUST read every file of major version 1, whatever its minor version. For all other files it reports the outcome *unsupported*, and checks no other rule, not even HED-002.
        """
        data = f.closed(("HEAD", f.head(f.tlv(8, b"new"), minor=9)), f.TRACK_0, f.DATA_0)
        assert rule(data) == ("intact", None)
        assert Reader(data).read().channels[0].stored.tolist() == [5] * 4

    @pytest.mark.parametrize("fields", [{"major": 2}, {"major": 0}])
    def test_unknown_versions_are_refused(self, fields):
        """
        VER-001: A reader MUST read every file of major version 1, whatever its minor version. For all other files it reports the outcome *unsupported*, and checks no other rule, not even HED-002.
        """
        data = f.closed(("HEAD", f.head(**fields)), f.TRACK_0, f.DATA_0)
        assert rule(data) == ("unsupported", "VER-001")

    def test_copies(self):
        """
        HED-001: `HEAD` MUST be the first chunk. A further `HEAD` chunk has the same payload, byte for byte.
        """
        assert rule(f.minimal(HEAD)) == ("intact", None)
        assert rule(f.minimal(("HEAD", f.head(minor=1)))) == ("nonconforming", "HED-001")

    @pytest.mark.parametrize(
        "payload", [f.head(f.tlv(8, b"")), f.head(f.epoch(1, 0))], ids=["a TLV", "a time"]
    )
    def test_copies_are_equal_in_every_byte(self, payload):
        assert rule(f.minimal(("HEAD", payload))) == ("nonconforming", "HED-001")


tlv_values = st.dictionaries(strategies.u16s, st.binary(max_size=9), max_size=4)


class TestTlv:
    @given(tlv_values, st.integers(0, 9))
    def test_comes_back(self, values, position):
        data = bytes(position) + build_tlvs(values)
        found = parse_tlvs(data, position, 100)
        assert {type_: value for type_, (_, value) in found.items()} == values
        assert all(data[at - 100 :].startswith(value) for at, value in found.values())

    @given(st.binary(max_size=20))
    def test_any_bytes(self, data):
        try:
            found = parse_tlvs(data, 0, 0)
        except FormatError:
            return
        assert build_tlvs({type_: value for type_, (_, value) in found.items()}) == data

    @given(st.lists(strategies.texts, min_size=1, max_size=4))
    def test_string_lists(self, items):
        """
        TLV-004: A list MUST have one entry, which applies to all components of the track, or one entry for each, and fill its value. A contract fills its value too, and so do channel numbers. The first entry of a string list is not the byte 255.
        CNV-004: Text MUST be well-formed UTF-8 (RFC 3629) without U+0000.
        """
        assert parse_strings(f.strings(*items), len(items), 0) == tuple(items)
        assert parse_strings(build_strings(items), len(items), 0) == tuple(items)
        assert parse_strings(f.strings(items[0]), 7, 0) == (items[0],) * 7

    def test_a_text_that_comes_again(self):
        items = ("N", "N", "N.m", "", "", "N")
        raw = f.strings("N") + b"\xff" + f.strings("N.m", "", "", "N")
        assert build_strings(items) == raw and parse_strings(raw, 6, 0) == items

    @pytest.mark.parametrize("text", ["a" * 255, "a\0b", "µ" * 128])
    def test_texts_that_do_not_fit(self, text):
        with pytest.raises(ParameterError):
            build_strings([text])

    @pytest.mark.parametrize("raw", [b"\xff", b"\xc0\x80", b"\xed\xa0\x80", b"\xf4\x90\x80\x80"])
    def test_ill_formed_text(self, raw):
        with pytest.raises(FormatError, match="UTF-8"):
            parse_strings(bytes([len(raw)]) + raw, 1, 0)

    def test_unknown_types(self):
        """
        TLV-003: A reader MUST treat a track with an unknown critical TLV as *unsupported*, and a file with one in `HEAD` too. It skips unknown ancillary TLVs.
        """
        even = ("TRAK", f.trak(f.HOLD + f.tlv(0x8000, b"private")))
        odd = ("TRAK", f.trak(f.HOLD + f.tlv(0x8001, b"private")))
        assert rule(f.closed(HEAD, even, f.DATA_0)) == ("intact", None)
        assert verify(f.closed(HEAD, odd, f.DATA_0)).verdict == "unsupported"

    @pytest.mark.parametrize("broken", [b"\xff\xff", f.tlv(6, b""), f.tlv(8, b"")[:1]])
    def test_an_unknown_type_in_head_comes_before_what_breaks_a_rule(self, broken):
        """
        TLV-003: A reader MUST treat a track with an unknown critical TLV as *unsupported*, and a file with one in `HEAD` too. It skips unknown ancillary TLVs.
        """
        head = ("HEAD", f.head(f.tlv(7, b"") + broken))
        assert rule(f.closed(head, f.TRACK_0, f.DATA_0)) == ("unsupported", "TLV-003")


class TestMetadata:
    @given(strategies.metadata)
    def test_comes_back(self, metadata):
        """
        MET-001: The payload MUST be one JSON object (RFC 8259) in UTF-8, nested at most 64 deep. Texts are well-formed; numbers are integers, without `.` and exponent, or finite as binary64, of at most 1000 characters each.
        """
        assert parse_metadata(build_metadata(metadata), 0) == metadata

    @given(st.binary(max_size=30) | strategies.jsons.map(lambda x: json.dumps(x).encode()))
    def test_any_bytes(self, data):
        with contextlib.suppress(FormatError):
            assert isinstance(parse_metadata(data, 0), dict)

    @pytest.mark.parametrize(
        "text", ["[]", "1", "NaN", '{"a":NaN}', '{"a":Infinity}', "{}x", "{'a':1}", "\ufeff{}"]
    )
    def test_no_json_object(self, text):
        with pytest.raises(FormatError):
            parse_metadata(text.encode(), 0)

    def test_depth(self):
        deep = b'{"":' * 64 + b"1" + b"}" * 64
        assert parse_metadata(deep, 0)
        for bad in (b'{"":' + deep + b"}", b"[" * 200_000, b'{"":' * 200_000):
            with pytest.raises(FormatError):
                parse_metadata(bad, 0)

    @pytest.mark.parametrize("number", [b"1" * 1000, b"1e308", b"-0.5"])
    def test_numbers(self, number):
        assert parse_metadata(b'{"":' + number + b"}", 0)

    @pytest.mark.parametrize("number", [b"1" * 1001, b"1e309", b"1." + b"0" * 1000, b"NaN"])
    def test_numbers_beyond_the_bounds(self, number):
        with pytest.raises(FormatError, match="MET-001"):
            parse_metadata(b'{"":' + number + b"}", 0)

    def test_texts_are_well_formed(self):
        with pytest.raises(FormatError, match="MET-001"):
            parse_metadata(rb'{"a":"\ud800"}', 0)

    def test_later_members_replace_earlier_ones(self):
        data = f.minimal(("mETa", b'{"a":1,"b":1}'), ("mETa", b'{"a":2}'))
        assert Reader(data).metadata == {"a": 2, "b": 1}

    def test_samples_need_none(self):
        damaged = f.minimal(("mETa", b'{"a":1}', {"crc": 0}))
        assert Reader(damaged).read().channels[0].stored.tolist() == [5] * 4


class TestAttachments:
    @given(st.text(min_size=1, max_size=5), st.text(max_size=5), st.binary(max_size=9))
    def test_comes_back(self, name, media_type, content):
        """
        ATT-001: Name and media type MUST lie within the payload, and the name MUST NOT be empty.
        """
        if "\0" in name + media_type:
            return
        attachment = Attachment(name, media_type, content)
        assert build_attachment(attachment) == f.strings(name, media_type) + content
        assert parse_attachment(build_attachment(attachment), 0) == attachment

    @given(st.binary(max_size=20))
    def test_any_bytes(self, data):
        with contextlib.suppress(FormatError):
            assert build_attachment(parse_attachment(data, 0)) == data

    @given(st.text(st.sampled_from("./\\:ab\x1b\x7f\x85"), min_size=1))
    def test_names_are_no_paths(self, name):
        r"""
        ATT-002: A reader that stores an attachment MUST NOT use more than the last component of its name, split at `/`, `\` and `:`. It removes leading dots and control characters; where nothing is left it chooses a name.
        """
        safe = Attachment(name, "", b"").safe_name
        last = re.split(r"[/\\:]", name)[-1]
        kept = "".join(c for c in last if unicodedata.category(c) != "Cc").lstrip(".")
        assert safe == (kept or "attachment")

    def test_of_a_file(self):
        data = f.minimal(("aTTc", f.strings("../b.txt", "text/plain") + b"hello"))
        (attachment,) = Reader(data).attachments.values()
        assert (attachment.safe_name, attachment.content) == ("b.txt", b"hello")

    def test_of_one_name_are_both_kept(self):
        payload = f.strings("a", "")
        data = f.minimal(("aTTc", payload + b"1"), ("aTTc", payload + b"2"))
        kept = {name: found.content for name, found in Reader(data).attachments.items()}
        assert kept == {"a": b"1", "a (2)": b"2"}


class TestSources:
    def test_all_kinds(self, tmp_path):
        data = f.minimal()
        path = tmp_path / "a.hapf"
        path.write_bytes(data)
        with path.open("rb") as stream:
            for file in (path, str(path), data, memoryview(data), stream, io.BytesIO(data)):
                source = open_source(file)
                assert source.read_at(3, 9) == data[3:12]
                assert source.read_at(len(data) - 2, 9) == data[-2:]
                assert source.size == len(data)
                source.close()

    @pytest.mark.parametrize("data", [b"", f.minimal()])
    def test_mapped(self, tmp_path, data):
        path = tmp_path / "a.hapf"
        path.write_bytes(data)
        source = open_source(path, mapped=True)
        assert (source.size, source.path) == (len(data), str(path))
        for at, size in [(0, 8), (3, 9), (len(data) - 2, 9), (2**63, 1), (len(data), 1)]:
            assert source.read_at(max(at, 0), size) == data[max(at, 0) :][:size]
        source.close()

    def test_only_a_file_is_mapped(self):
        for file in (f.minimal(), io.BytesIO(), "http://127.0.0.1/a.hapf"):
            with pytest.raises(ParameterError, match="mapped"):
                open_source(file, mapped=True)

    @pytest.mark.capped(False)
    def test_threads_share_a_file(self, tmp_path):
        """No reading moves the place of another."""
        path = tmp_path / "a"
        data = bytes(range(256)) * 1000
        path.write_bytes(data)
        source = open_source(path)
        places = range(0, len(data), 999)
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(lambda at: source.read_at(at, 999), places))
        source.close()
        assert b"".join(found) == data

    def test_a_stream_that_is_more_than_its_descriptor(self, tmp_path):
        path = tmp_path / "a.gz"
        with gzip.open(path, "wb") as packed:
            packed.write(f.minimal())
        with gzip.open(path) as stream:
            assert open_source(stream).read_at(0, 8) == SIGNATURE

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
    def test_a_named_pipe(self, tmp_path):
        path = tmp_path / "pipe"
        os.mkfifo(path)
        with ThreadPoolExecutor(1) as pool:
            pool.submit(path.write_bytes, f.minimal())
            source = open_source(path)
        assert source.read_at(0, len(f.minimal())) == f.minimal()
        source.close()

    def test_a_pipe(self):
        class Pipe(io.BytesIO):
            def seekable(self) -> bool:
                return False

        source = open_source(Pipe(f.minimal()))
        assert isinstance(source, StreamSource)
        assert source.read_at(0, 8) == SIGNATURE
        source.close()

    @pytest.mark.parametrize("offset", [3, 2**63 - 1, 2**63, 2**64 - 1])
    def test_beyond_the_end(self, tmp_path, offset):
        """A footer or an index may name any of 64 bits; no system seeks that far."""
        path = tmp_path / "abc"
        path.write_bytes(b"abc")
        for source in (open_source(path), BytesSource(b"abc")):
            assert source.read_at(offset, 5) == b""
            source.close()

    def test_bytes(self):
        assert BytesSource(b"abc").read_at(2, 5) == b"c"


@given(st.sampled_from([*TABLES.values(), *OVERVIEW_TABLES.values()]), st.data())
def test_layouts_by_struct_are_those_by_construct(layout, data):
    row = data.draw(st.binary(min_size=layout.size, max_size=layout.size))
    declared, fields = layout.construct.parse(row), layout.read(b"\0" + row, 1)
    assert layout.construct.sizeof() == layout.size
    assert repr([declared[name] for name in layout.offsets]) == repr(list(fields))
    assert layout.build(**fields._asdict()) == layout.pack(**fields._asdict())


def test_layout_tables_are_those_of_the_code():
    sys.path.insert(0, str(ROOT / "tools"))
    import spec_tables

    pages = [page.read_text("utf-8") for page in spec_tables.PAGES]
    assert [spec_tables.render(page) for page in pages] == pages
    assert set(spec_tables.MARKED.findall("".join(pages))) == set(spec_tables.LAYOUTS)


def test_the_tool_prints_every_table():
    done = subprocess.run(
        [sys.executable, "tools/spec_tables.py"], cwd=ROOT, env={"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    rows = [line for line in done.stdout.splitlines() if line.startswith("| ")]
    page = (ROOT / "docs/spec/overview.md").read_text("utf-8")
    assert rows and all(row in TEXT + page for row in rows)
