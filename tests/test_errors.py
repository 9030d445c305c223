"""Every refusal says what, where and which rule; no two faults share a message."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest
from fault_table import FAULTS, Fault
from spec import REQUIREMENTS, quotes
from test_architecture import DECODE_SIDE, MODULES

from hapfmt.errors import FormatError, HapfmtError

pytestmark = pytest.mark.capped

ELSEWHERE = {"REC-005", "LIM-003"}
"""Refusals whose input is too large for a table."""


def caught(fault: Fault) -> HapfmtError:
    with pytest.raises(HapfmtError) as error:
        fault.call()
    return error.value


def each(*areas: str) -> pytest.MarkDecorator:
    """The faults whose rule belongs to one of the areas."""
    chosen = [fault for fault in FAULTS if fault.requirement[:3] in areas]
    return pytest.mark.parametrize(
        "fault", chosen, ids=lambda fault: f"{fault.requirement} {fault.name}"
    )


def assert_reported(fault: Fault) -> None:
    error = caught(fault)
    assert (error.requirement, error.offset) == (fault.requirement, fault.offset)


@each("CNV")
def test_conventions(fault):
    """
    CNV-002: A varint MUST be at most 8 bytes long and less than 2^53.
    CNV-003: A varint MUST be minimal: its last byte is not 0 unless it is its only byte.
    CNV-004: Text MUST be well-formed UTF-8 (RFC 3629) without U+0000.
    CNV-005: The first entry of a string list MUST NOT be the byte 255.
    """
    assert_reported(fault)


@each("FIL", "CHK")
def test_file_layer(fault):
    """
    FIL-001: A file MUST begin with the signature.
    FIL-002: The first chunk MUST start at offset 8, and each other chunk directly after the payload of the one before it.
    CHK-001: The sync word MUST be `F9 48 8B 1C`.
    CHK-002: `header_crc` MUST be the CRC-32 of bytes 0 to 31 of the header, and a reader MUST use no field of a header whose CRC differs.
    CHK-006: The type MUST be four ASCII letters; a header with another type is no header.
    CHK-008: The payload MUST NOT be longer than the level allows (clause 15).
    """
    assert_reported(fault)


@each("HED", "VER")
def test_head(fault):
    """
    HED-001: `HEAD` MUST be the first chunk.
    HED-002: `HEAD` MUST hold the fixed layout and then whole TLVs.
    HED-004: `level` MUST be 1 or 2; a reader reports another level as *unsupported*.
    HED-005: Bytes called `reserved`, here and in every other layout, MUST be 0.
    """
    assert_reported(fault)


@each("TLV")
def test_tlv(fault):
    """
    TLV-001: TLVs MUST stand in strictly increasing order of their type.
    TLV-002: A TLV MUST end within its chunk, and no byte may be left over after the last one.
    TLV-004: A list MUST have one entry, which speaks for all components of the track, or one entry for each.
    TLV-005: Both numbers of a deviation MUST be finite and not negative, and `largest` at most `declared`.
    TLV-007: A value that is a list MUST end with the last byte of its last entry.
    """
    assert_reported(fault)


@each("TRK")
def test_tracks(fault):
    """
    TRK-002: There MUST be at least one track, and `component_count`, `rate_num`, `rate_den` be at least 1; all tracks of a chunk together have at most 255 components.
    TRK-003: Track ids MUST be at most 65533, and a track MUST be described once; a repeated `TRAK` chunk is equal to the first in every byte of its payload.
    TRK-005: `count_min` MUST be at most `count_max`, and both MUST fit the width that the level allows for the kind (clause 15).
    TRK-006: A track whose number format is not counts MUST be of kind full band, with codec `RAWB`, count_min and count_max 0, no calibration and no deadband contract.
    TRK-007: `linked` of an HF track MUST name its base track, which is described before it, is of kind LF, and has the same component count, rate (as a ratio) and first channel; no two HF tracks have the same base.
    TRK-009: An HF track MUST carry no TLV of types 2, 3, 4, 6, 8, 10, 12, 14 and 18: it has those of its base.
    TRK-012: In a closed file every track of kind LF MUST be the base of an HF track; an LF part that stands alone is of kind full band.
    TRK-010: Channel numbers MUST be different for different components, but for those of tracks that continue one another, and those of all tracks that are not HF together are 0, 1, 2 ... without a hole once the file is closed; the highest is 65534, and tracks of kind events have none.
    TRK-016: A continued track MUST be of kind full band or LF, described before under a smaller id, and have the same component count, channel numbers, rate (as a ratio), number format, calibrations and units as the track that continues it; no two tracks continue the same one.
    TRK-017: The packets of a track that continues another MUST come after all packets of that other one, in time and within the file, and those of its HF track after all packets of the other one's HF track.
    TRK-019: A track of kind events MUST have codec `EVNT`, one component, number format counts, count_min and count_max 0, `first_channel` and `linked` 0xFFFF, and of the TLVs of 6.2 no others than 2, 14 and 22; no track of another kind has that codec.
    """
    assert_reported(fault)


@each("DAT")
def test_clusters(fault):
    """
    DAT-001: `packet_count` MUST be at least 1 and at most what the level allows.
    DAT-002: Entries MUST stand in increasing order of (track, start).
    DAT-003: `span` MUST be at least 1 and at most what the level allows, and `start + span` at most 2^48.
    DAT-004: `packet_crc` MUST be the file CRC of the four varints of its entry followed by the bytes of the packet.
    DAT-005: The packets MUST fill the rest of the payload to its last byte.
    DAT-006: Packets of one track MUST NOT overlap in time and MUST come in order of time within the file, but for tracks of kind events.
    DAT-008: A packet MUST belong to a track that is described.
    DAT-009: Over all packets of a cluster, `span` times the component count of the track, for a packet of events its size in bytes, MUST add up to at most what the level allows; a decoder checks it before it takes memory.
    """
    assert_reported(fault)


@each("IDX", "FOT")
def test_index_and_footer(fault):
    """
    IDX-001: The payload MUST end with the last byte of the last of its `entry_count` entries.
    IDX-002: The entries MUST list every chunk but `iNDX` and `fOOT` whose offset is at least `covers_from` and less than that of the index itself, in order of their offsets.
    IDX-003: A reader MUST check an entry against the header that it points to before it uses it, and read the file in order where they differ.
    IDX-004: `covers_from` MUST be at least 8; unless it is 8, `previous` MUST point to an `iNDX` chunk that stands between `covers_from` and the index itself.
    IDX-006: For a `DATA` chunk `start_ms` MUST NOT be later than the start of its earliest packet and `start_ms + length_ms` not earlier than the end of its latest; times of 2^53 and more are set to 2^53 - 1.
    FOT-001: The payload MUST be as long as the layout, and `stop_offset` the offset of its own end.
    FOT-002: `index_offset` MUST be the offset of the last `iNDX` chunk before it.
    FOT-003: In the last `fOOT`, `data_count` and `track_count` MUST be the numbers of `DATA` chunks and of described tracks in the file, and `duration_ns` the end of the latest packet of any track, rounded up, at most the largest i64, 0 without packets.
    """
    assert_reported(fault)


@each("MET", "ATT", "DGS")
def test_extras(fault):
    """
    MET-001: The payload MUST be one JSON object (RFC 8259) in UTF-8, nested at most 64 deep, whose texts are well-formed and whose numbers are finite as binary64 or integers, of at most 1000 characters.
    ATT-001: Name and media type MUST lie within the payload, and the name MUST NOT be empty.
    DGS-001: The payload MUST be a positive multiple of 32 bytes, and the tracks MUST be described before it.
    DGS-004: There MUST be no digest of a track of kind events: events may be added to a file that is closed.
    """
    assert_reported(fault)


@each("VAL", "DBC")
def test_values_and_contracts(fault):
    """
    VAL-001: D MUST be at least 1, A MUST NOT be 0, and `|A|` and `|B|` are less than 2^52.
    VAL-002: `|count * A|` and `|count * A + B|` MUST be at most 2^53 for every count of the declared range of the track, and `|count * A|` also for that of its HF track.
    DBC-001: `kn` MUST be less than 2^16, `kd` at least 1 and less than 2^16, every `floor` at least 1 and less than 2^32, every `zero` a signed number of 32 bits, and undefined flag bits 0.
    """
    assert_reported(fault)


@each("KNT")
def test_knots(fault):
    """
    KNT-001: `interpolation` and `coding` MUST be 0 or 1.
    KNT-002: There MUST be at least one knot, and a knot MUST be whole.
    KNT-003: The difference of ticks MUST be at least 1.
    KNT-005: The tick of every knot MUST be less than `span`.
    KNT-006: Linear with more than one knot: the last knot's tick MUST be `span - 1`.
    """
    assert_reported(fault)


@each("COD", "QNT")
def test_quantised(fault):
    """
    COD-001: A decoder MUST use up all bytes of a packet, and report an error where bytes are missing or left over.
    COD-002: The codec parameters (TLV 1, or a setup) MUST be present and as long as their layout; those of `QUAN` may be longer by the codebook, and `EVNT` has none.
    QNT-001: `step` MUST be at least 1 and at most what the level allows, and `2M + R + C + 1` at most 4096, R at most 24 and C at most 32.
    QNT-002: The codebook MUST NOT describe more symbols than there are.
    QNT-003: The code words MUST be complete: over the symbols that have one, 2^-length adds up to 1; or exactly one symbol has one, and its length is 1.
    QNT-004: Runs MUST NOT pass the end of the last component.
    QNT-005: The packet MUST end with the byte that holds the last bit, and the bits that fill it MUST be 0.
    QNT-006: The magnitude of level times step MUST be at most twice the level's count bound (clause 15).
    """
    assert_reported(fault)


@each("RNG", "LPC")
def test_predicted(fault):
    """
    RNG-001: After the last symbol every state MUST be 65536. The words and the raw bits MUST take up all coded bytes, and the bits left over in the byte that both share the end of MUST be 0. What lies before the first or behind the last coded byte is 0; a decoder stops at the latest with the block, or outside blocks with the number, that takes more than there is.
    RNG-003: The magnitude u MUST be less than 2^34.
    RNG-004: What a packet says of how its symbols are coded MUST be whole. Bits without a meaning MUST be 0, no probability 0, and a start byte at most 163. In a table of lengths n MUST be at least 1, `first` + n at most 64, in knots at most 35, and one weight more than 0.
    LPC-001: The component packets MUST fit the packet: their sizes are together at most what follows them.
    LPC-002: `grid` MUST be 0 or 1; `step` at most what the level allows, and on the uniform grid at least 1; `zero` a signed number of 32 bits; `kn` and `kd` at least 1 and less than 2^16, and `kd` at most 1024 * `kn`.
    LPC-003: The base and every index i MUST lie on the grid: uniform, |i| * step at most the level's count bound (clause 15); deadband, |i| at most N.
    LPC-004: g MUST be at most 4, at most 1 where m > 0; m at most 32; k[i] at least -127; bits 5 and 7 of the flags 0; and of a constant component packet g, m and the other flags 0.
    LPC-005: Every |p[j]| after each n MUST be at most 2^36, and every |c[j]| at most 2^21.
    LPC-006: A component packet MUST hold at least `flags`, `m` and m coefficients.
    LPC-007: With flag *references* r MUST be 1 to 8, and the numbers a less than that of the component itself, each greater than the one before.
    LPC-008: With flag *references* a component packet MUST hold r and r references.
    """
    assert_reported(fault)


@each("KTE")
def test_coded_knots(fault):
    """
    KTE-002: Where it is present, f MUST be at least 1 and less than `span`.
    KTE-004: Every tick MUST be less than `span` minus the number of knots that follow it.
    """
    assert_reported(fault)


@each("EXA")
def test_exact(fault):
    """
    EXA-001: A track of codec `LPCX` MUST be of kind full band, with one component, without deadband contract and without deviation.
    EXA-002: `rule` MUST be at most 3, and `digits` 1 to 15 with rule 2, else 0.
    EXA-003: The counts MUST end within the packet and lie within the declared range of their track: what is lossless is never clamped.
    EXA-004: Undefined flags MUST be 0, and z at most 63.
    EXA-008: With rule 3 each coefficient MUST be finite and of a magnitude below 2^900.
    """
    assert_reported(fault)


@each("CLK")
def test_clocks(fault):
    """
    CLK-001: The name MUST lie within the payload and not be empty, and the payload end with the last of its observations or points.
    CLK-002: There MUST be at least one observation, and at least two points.
    CLK-003: Each tick MUST have a magnitude below 2^52, and each time fit an i64.
    CLK-004: From point to point the ticks and the times MUST grow.
    CLK-005: The track id MUST be that of a track described before, not of kind events, or 0xFFFF.
    """
    assert_reported(fault)


@each("EVT")
def test_events(fault):
    """
    EVT-001: A packet MUST hold at least one event and at most 65536, and each MUST be whole.
    EVT-002: The tick of every event MUST be less than `start + span`, and its end, tick plus duration, at most 2^48.
    EVT-003: `size` MUST be at most 65535, and `channel` at most 65535 and in a closed file 0 or the number of a channel that there is.
    """
    assert_reported(fault)


@each("RAW")
def test_raw(fault):
    """
    RAW-001: `word_size` MUST be 1, 2, 3 or 4 for counts, and the size of the number format for words.
    RAW-002: The method MUST be 0 or 1.
    RAW-003: The bytes MUST be exactly `span * component_count * word_size`; a decoder stops inflating there.
    RAW-004: The DEFLATE stream MUST be whole and end with the packet.
    RAW-005: Counts MUST lie within the declared range of their track: what is lossless is never clamped.
    """
    assert_reported(fault)


@each("LIM")
def test_limits(fault):
    """
    LIM-001: A file MUST keep the limits of its level.
    LIM-003: A reader MAY have lower limits of its own, and MUST then report *unsupported*, not damage.
    """
    assert_reported(fault)


def test_no_area_is_left_out():
    areas = set()
    for name, test in globals().items():
        if name.startswith("test_"):
            for mark in getattr(test, "pytestmark", []):
                areas |= {fault.requirement for fault in mark.args[1]}
    assert areas == {fault.requirement for fault in FAULTS}


def test_each_rule_quoted_here_has_a_fault():
    source = Path(__file__).read_text(encoding="utf-8")
    assert {id_ for _, id_, _ in quotes(source)} <= {fault.requirement for fault in FAULTS}


def raise_sites() -> list[tuple[str, str, str]]:
    """(module, rule, pattern of the message) of every error that names a rule."""
    return [
        (name, keyword.value.value, pattern_of(node.args[0]))
        for name in DECODE_SIDE
        for node in ast.walk(ast.parse(MODULES[name].read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and node.args
        for keyword in node.keywords
        if keyword.arg == "requirement" and isinstance(keyword.value, ast.Constant)
    ]


def pattern_of(node: ast.expr) -> str:
    if isinstance(node, ast.JoinedStr):
        parts = (re.escape(p.value) if isinstance(p, ast.Constant) else ".*" for p in node.values)
        return "".join(parts)
    return re.escape(node.value) if isinstance(node, ast.Constant) else ".*"


def test_every_refusal_is_in_the_table():
    seen = [(error.requirement, error.message) for error in map(caught, FAULTS)]
    sites = raise_sites()
    assert len(sites) > 80
    missing = [
        (module, rule, pattern)
        for module, rule, pattern in sites
        if rule not in ELSEWHERE
        and not any(rule == id_ and re.fullmatch(pattern, text, re.S) for id_, text in seen)
    ]
    assert missing == []


def test_a_message_belongs_to_one_rule():
    rules = defaultdict(set)
    for _, rule, pattern in raise_sites():
        rules[pattern].add(rule)
    assert [pattern for pattern, ids in rules.items() if len(ids) > 1] == []


def test_rules_are_in_the_spec():
    assert {fault.requirement for fault in FAULTS} <= REQUIREMENTS.keys()


def test_an_error_names_file_place_and_rule():
    error = FormatError("knot ticks not increasing", requirement="KNT-003", offset=0x1F3)
    assert str(error.at(path="a.hapf")) == "a.hapf:0x1f3: knot ticks not increasing [KNT-003]"
    assert error.at(offset=5, path="b").offset == 0x1F3


def test_exit_codes():
    assert [kind.exit_code for kind in (HapfmtError, FormatError)] == [1, 2]
