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
"""Refusals whose input is too large for a table. Those of an overview (OVW) are in test_overview.py."""


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
    CNV-002: A varint MUST be less than 2^53, at most 8 bytes long, and minimal: its last byte is not 0 unless it is its only byte.
    CNV-004: Text MUST be well-formed UTF-8 (RFC 3629) without U+0000.
    TLV-004: A list MUST have one entry, which applies to all components of the track, or one entry for each, and fill its value. A contract fills its value too, and so do channel numbers. The first entry of a string list is not the byte 255.
    """
    assert_reported(fault)


@each("FIL", "CHK")
def test_file_layer(fault):
    """
    FIL-001: A file MUST begin with the signature.
    FIL-002: The first chunk MUST start at offset 8, and each other chunk directly after the payload of the one before it.
    CHK-002: A header MUST have the sync word `F9 48 8B 1C`, a type of four ASCII letters, and the right `header_crc`. A reader uses no field of any other header.
    LIM-001: A file MUST keep the limits of its level, unknown chunks too.
    """
    assert_reported(fault)


@each("HED", "VER")
def test_head(fault):
    """
    HED-001: `HEAD` MUST be the first chunk. A further `HEAD` chunk has the same payload, byte for byte.
    HED-002: `HEAD` MUST contain the fixed layout and then whole TLVs. The value of TLV 2 and of TLV 4 has 16 bytes, the uncertainty is less than 2^63.
    HED-004: `level` MUST be 1 or 2. A reader reports another level as *unsupported*.
    HED-005: Bytes called `reserved` MUST be 0, in every layout.
    """
    assert_reported(fault)


@each("TLV")
def test_tlv(fault):
    """
    TLV-001: TLVs MUST be in strictly increasing order of their types, which are at most 65535. Each lies within its chunk, and no bytes are left over after the last one.
    TLV-004: A list MUST have one entry, which applies to all components of the track, or one entry for each, and fill its value. A contract fills its value too, and so do channel numbers. The first entry of a string list is not the byte 255.
    TLV-005: Both numbers of a deviation MUST be finite and not negative, and `largest` at most `declared`.
    """
    assert_reported(fault)


@each("TRK")
def test_tracks(fault):
    """
    TRK-002: A chunk MUST describe at least one track, and `component_count`, `rate_num`, `rate_den` be at least 1; both numbers of the rate are less than 2^32. All tracks of a chunk together have at most 255 components.
    TRK-003: Track ids MUST be at most 65533, and a track MUST be described once. A further `TRAK` chunk with the same first track has the same payload, byte for byte.
    TRK-005: `count_min` MUST be at most `count_max`, and both MUST fit the width that the level allows for the kind (clause 12).
    TRK-006: A track whose number format is not counts MUST be of kind full band, with codec `RAWB`. Its count_min and count_max are 0, and it has no calibration and no contract.
    TRK-007: `linked` of an HF track MUST name its base track, an LF track described before it. Both have the same component count, rate (as a ratio) and first channel; no two HF tracks have the same base.
    TRK-009: An HF track MUST have no TLV of types 2, 3, 4, 6, 8, 10, 12, 14 and 18: it has those of its base. Only tracks of kind full band have TLV 5.
    TRK-012: In a closed file every track of kind LF MUST be the base of an HF track. An LF part alone is of kind full band.
    TRK-010: Channel numbers MUST be at most 65534, and different for different components; only HF tracks and continued tracks share them. In a closed file they are 0, 1, 2 ... without a hole.
    TRK-016: A track that another continues MUST be of kind full band or LF, described before it under a smaller id, and continued only once. Both have the same component count, channel numbers, rate (as a ratio), number format, and in each component calibration (A, B, D) and unit. All packets of the continued track come before those of the other, in time and within the file. The same order applies to their HF tracks.
    TRK-019: A track of kind events MUST have codec `EVNT`, one component, number format counts, count_min, count_max, `first_channel` and `linked` 0. Of the TLVs of clause 8 it has only 2, 14 and 22. No other kind has that codec.
    """
    assert_reported(fault)


@each("DAT")
def test_clusters(fault):
    """
    DAT-001: `packet_count` MUST be at least 1 and at most what the level allows, and each of the four widths at most 6.
    DAT-002: Rows MUST be in strictly increasing order of (track, start), those of events too.
    DAT-003: `span` MUST be at least 1 and at most what the level allows, and `start + span` at most 2^48.
    DAT-004: `packet_crc` MUST be the cluster CRC of `packet_count`, `track`, `size`, `start` and `span`, each as u64, followed by the bytes of the packet.
    DAT-011: `table_crc` MUST be the cluster CRC of all bytes of the payload before it.
    DAT-005: The packets MUST fill the rest of the payload to its last byte.
    DAT-006: Packets of one track MUST NOT overlap in time and MUST come in order of time within the file. Tracks of kind events are exempt.
    DAT-008: A packet MUST belong to a track that is described.
    DAT-009: Over a `DATA` chunk, `span` times the component count of the track MUST add up to at most what the level allows. A packet of events counts its size in bytes. A decoder checks this before it takes memory.
    """
    assert_reported(fault)


@each("IDX", "FOT")
def test_index_and_footer(fault):
    """
    IDX-002: The entries MUST fill the payload, and list every chunk before the index: from the `iNDX` chunk at `previous` on, or from the first chunk where `previous` is 0. `first_sequence` is the sequence number of the first; the others have the numbers after it. For a `DATA` chunk `start_ms` is at most the start of its earliest packet, and `start_ms + length_ms` at least the end of its latest. Times of 2^53 and more are set to 2^53 - 1.
    IDX-003: A reader MUST check an entry against the header that it points to before it uses it. It reads the file in order where they differ, or where the sequence number of an index is not that after its last entry.
    IDX-002: The entries MUST fill the payload, and list every chunk before the index: from the `iNDX` chunk at `previous` on, or from the first chunk where `previous` is 0. `first_sequence` is the sequence number of the first; the others have the numbers after it. For a `DATA` chunk `start_ms` is at most the start of its earliest packet, and `start_ms + length_ms` at least the end of its latest. Times of 2^53 and more are set to 2^53 - 1.
    FOT-001: The payload MUST be as long as the layout.
    FOT-002: `index_distance` MUST be as the table says. In a `fOOT` that closes the file `duration_ns` is the end of the latest packet of any track, rounded up, at most the largest i64; 0 without packets.
    """
    assert_reported(fault)


@each("MET", "ATT", "DGS")
def test_extras(fault):
    """
    MET-001: The payload MUST be one JSON object (RFC 8259) in UTF-8, nested at most 64 deep. Texts are well-formed; numbers are integers, without `.` and exponent, or finite as binary64, of at most 1000 characters each.
    ATT-001: Name and media type MUST lie within the payload, and the name MUST NOT be empty.
    DGS-001: Whole digests MUST follow the track id, one at least, and fill the payload. The tracks are described before it; none is of kind events, since events may be added to a closed file.
    """
    assert_reported(fault)


@each("VAL", "DBC")
def test_values_and_contracts(fault):
    """
    VAL-001: D MUST be at least 1, A MUST NOT be 0, and `|A|` and `|B|` are less than 2^52. For every count of the declared range of the track `|count * A|` and `|count * A + B|` are at most 2^53; for those of its HF track `|count * A|` is.
    DBC-001: `kn` MUST be less than 2^16, `kd` at least 1 and less than 2^16. Every `floor` is at least 1 and less than 2^32, every `zero` a signed number of 32 bits, and undefined flag bits are 0.
    """
    assert_reported(fault)


@each("KNT")
def test_knots(fault):
    """
    KNT-001: `interpolation` and `coding` MUST be 0 or 1.
    KNT-002: There MUST be at least one knot, and a knot MUST be whole.
    KNT-003: The ticks of knots MUST increase and be less than `span`. If linear with more than one knot, the last tick is `span - 1`.
    """
    assert_reported(fault)


@each("COD", "QNT")
def test_quantised(fault):
    """
    COD-001: A decoder MUST use all bytes of a packet, and report an error where bytes are missing or left over.
    COD-002: The codec parameters (TLV 1) MUST be present and as long as their layout. Those of `QUAN` also contain the codebook; `EVNT` has none.
    QNT-001: `step` MUST be at least 1 and at most what the level of the file allows; `2M + R + C + 1` is at most 4096, R at most 24 and C at most 32.
    QNT-003: The codebook MUST describe at most the symbols above. Its code words are complete: over the symbols that have one, 2^-length adds up to 1. Or exactly one symbol has one, of length 1.
    QNT-004: Runs MUST NOT pass the end of the last component. The packet ends with the byte that contains the last bit, and the bits that fill it are 0.
    QNT-006: The magnitude of level times step MUST be at most twice the count bound (clause 12).
    """
    assert_reported(fault)


@each("RNG", "LPC")
def test_predicted(fault):
    """
    RNG-001: After the last symbol every state MUST be 65536. The first states, the words, and the raw bits, filled to whole bytes with bits 0, MUST take up exactly the coded bytes. A decoder that has taken more than these bytes stops at the latest after the batch, or outside batches after the integer or bit. What it reads beyond them is 0.
    RNG-003: The magnitude u of an integer by class or by bits MUST be less than 2^34. Its k by bits is at most 35.
    RNG-004: What a packet says of how its symbols are coded MUST be whole. Bits without a meaning MUST be 0, no probability 0, and a start byte at most 163. In a table of lengths n is at least 1, and `first` + n at most 64. At least one weight is more than 0. No x has more than 32 probabilities of ranks (9.7).
    LPC-001: The component packets MUST fit the packet: their sizes are together at most what follows them.
    LPC-002: `grid` MUST be 0 or 1, and `step` at most what the level allows; it may be 0 on the deadband grid only. `zero` is a signed number of 32 bits. `kn` and `kd` are at least 1 and less than 2^16, and `kd` at most 1024 * `kn`.
    LPC-003: The base and every index i MUST lie on the grid: uniform, |i| * step at most the count bound (clause 12); deadband, |i| at most N.
    LPC-004: g MUST be at most 4, at most 1 where m > 0; m at most 32; k[i] at least -127; bits 5 and 7 of the flags 0; and of a constant component packet g, m and the other flags 0.
    LPC-005: Every |p[j]| after each n MUST be at most 2^36, and every |c[j]| at most 2^21.
    LPC-006: A component packet MUST contain at least `flags`, `m` and m coefficients, and with flag *references* r and r references.
    LPC-007: With flag *references* r MUST be 1 to 8. Each number a is less than that of the component itself, and greater than the one before.
    """
    assert_reported(fault)


@each("KTE")
def test_coded_knots(fault):
    """
    KTE-004: Every tick MUST be less than `span` minus the number of knots that follow it. Where it is present, f is at least 1 and less than `span`.
    """
    assert_reported(fault)


@each("EXA")
def test_exact(fault):
    """
    EXA-001: A track of codec `LPCX` MUST be of kind full band, without contract and without deviation.
    EXA-002: `rule` MUST be at most 4. `digits` is 1 to 31 with rule 2, else 0, `terms` 1 to 16 with rule 4, else 0. Coefficients and weights are finite and of a magnitude below 2^900. `a` is a component that is decoded before, or the component itself with a `lag` of at least 1.
    EXA-003: The counts MUST end within the packet and lie within the declared range of their track: lossless counts are never clamped. The parts fit the packet: their sizes are together at most what follows them. Undefined flags are 0, and z at most 63.
    """
    assert_reported(fault)


@each("NOI")
def test_noise(fault):
    """
    NOI-001: A track of codec `NOIS` MUST be of kind full band or HF, and have no contract.
    NOI-003: `shift` MUST be 3 to 12, and a frame, `intervals` times 2^shift, have at least 64 ticks.
    LPC-001: The component packets MUST fit the packet: their sizes are together at most what follows them.
    NOI-005: m MUST be at most 32, and a component packet contain all that is before its coded bytes.
    NOI-006: Every gain index MUST be 0 to 112, and every coefficient -127 to 127.
    """
    assert_reported(fault)


@each("CLK")
def test_clocks(fault):
    """
    CLK-001: The name MUST lie within the payload and not be empty. At least one observation, or two points, follow, and fill the payload.
    CLK-003: Each tick MUST have a magnitude below 2^52, and each time fit an i64. From point to point of a map both grow.
    CLK-005: The track MUST be one described before, not of kind events.
    """
    assert_reported(fault)


@each("EVT")
def test_events(fault):
    """
    EVT-001: A packet MUST contain 1 to 65536 events, each whole. The tick of each is less than `start + span`; its end, tick plus duration, is at most 2^48.
    EVT-003: `size` and `channel` MUST be at most 65535. In a closed file `channel` is 0 or that of an existing channel, which only verifiers check.
    """
    assert_reported(fault)


@each("RAW")
def test_raw(fault):
    """
    RAW-001: `word_size` MUST be 1, 2, 3 or 4 for counts, and the size of the number format for raw numbers.
    RAW-003: The method MUST be 0 or 1, with exactly `span * component_count * word_size` bytes. A DEFLATE stream is whole and ends with the packet; a decoder stops inflating at that size.
    RAW-005: Counts MUST lie within the declared range of their track: lossless counts are never clamped.
    """
    assert_reported(fault)


@each("MDC")
def test_transforms(fault):
    """
    MDC-001: m MUST be 5 to 9, and `step` 1 to 2^32. n is 0 or a power of two, at most 128 and at most M.
    MDC-002: |b| MUST be at most the count bound (clause 12), and K at most M.
    MDC-003: In each block the sum of all |X[k]| MUST be at most 2^36.
    """
    assert_reported(fault)


@each("LIM")
def test_limits(fault):
    """
    LIM-001: A file MUST keep the limits of its level, unknown chunks too.
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
    assert {id_ for _, id_, _ in quotes(Path(__file__))} <= {fault.requirement for fault in FAULTS}


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
        and not rule.startswith("OVW")
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
