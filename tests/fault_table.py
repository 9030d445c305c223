"""Each way in which bytes can break a rule: the shortest input, the rule, and where it is reported.

Payloads stand at offset 100, so that an offset counted from the payload shows.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import forge as f
import numpy as np
import page
import page_exact
import page_noise
import page_transform
from singles import decode_counts, decode_exact

from hapfmt.codecs import knots as codec
from hapfmt.codecs.events import parse_events
from hapfmt.codecs.exact import ExactParameters
from hapfmt.codecs.exact import decode_exact as decode_both
from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.knots import KnotParameters, decode_knots, parse_varints
from hapfmt.codecs.noise import NoiseParameters
from hapfmt.codecs.noise import decode_within as decode_noise
from hapfmt.codecs.predicted import decode_indices, decode_predicted
from hapfmt.codecs.quantised import QuanParameters, decode_quantised, parse_codebook
from hapfmt.codecs.raw import RawParameters, decode_raw
from hapfmt.codecs.transform import TransformParameters
from hapfmt.codecs.transform import decode_within as decode_transform
from hapfmt.format.cluster import parse_cluster
from hapfmt.format.extras import (
    IndexEntry,
    check_listing,
    parse_attachment,
    parse_clock,
    parse_foot,
    parse_index,
    parse_map,
    parse_metadata,
)
from hapfmt.format.source import BytesSource
from hapfmt.format.track import Affine, TrackTable, parse_description
from hapfmt.format.wire import cluster_seed, parse_head, parse_header, parse_strings, parse_tlvs
from hapfmt.limits import LEVELS, Limits
from hapfmt.numbers import parse_varint
from hapfmt.reading.catalogue import ChunkRef
from hapfmt.reading.opening import index_entries, open_catalogue
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

AT = 100
ONE, TWO = LEVELS[1], LEVELS[2]


class Fault(NamedTuple):
    requirement: str
    offset: int | None
    name: str
    call: Callable[[], Any]


def header(payload: bytes = b"", **changes: Any) -> bytes:
    return f.chunk(changes.pop("type_", "mETa"), payload, 0, **changes)


def head(*args: Any, **fields: Any) -> Callable[[], Any]:
    return lambda: parse_head(f.head(*args, **fields), AT)


def tracks(*args: Any, first: int = 0, **fields: Any) -> Callable[[], Any]:
    return lambda: parse_description(f.trak(*args, first=first, **fields), ONE, AT)


def payload(data: bytes) -> Callable[[], Any]:
    return lambda: parse_description(data, ONE, AT)


SQUEEZED = f.squeezed(f.trak())


def added(*payloads: bytes) -> Callable[[], Any]:
    def call() -> None:
        table = TrackTable()
        for number, payload in enumerate(payloads):
            numbered = bytes([number % 2]) + payload[1:]
            if table.is_new(numbered, AT):
                table.add(parse_description(numbered, ONE, AT))

    return call


TABLE = TrackTable()
TABLE.add(parse_description(f.trak(), ONE, 0))
TABLE.add(parse_description(f.trak(component_count=200, first_channel=1, first=1), ONE, 0))
TRACKS = TABLE.tracks


def cluster(payload: bytes) -> Callable[[], Any]:
    return lambda: parse_cluster(payload, TRACKS, ONE, AT, cluster_seed(f.FILE_ID, 2))


def knots(data: bytes, span: int = 4, width: int = 1, **given: Any) -> Callable[[], Any]:
    grid = LpcParameters(given.get("step", 1))
    parameters = KnotParameters(given.get("interpolation", "hold"), grid)
    return lambda: decode_knots(data, parameters, span, width, ONE, AT)


def knotted(data: bytes) -> Callable[[], Any]:
    return lambda: KnotParameters.parse(data, ONE, AT)


BITS = f.quan_parameters(bytes([0x22, 0x22]), m=1, r=1)
"""Symbols 0 1 2 3, two bits each: levels 0, 1, -1, a run of 2 or 3."""


def levels(data: bytes, ticks: int, parameters: bytes = BITS) -> Callable[[], Any]:
    def call() -> Any:
        parsed = QuanParameters.parse(parameters, ONE, 0)
        return decode_quantised(data, parsed, ticks, 1, ONE, AT)

    return call


def words(data: bytes, ticks: int = 2) -> Callable[[], Any]:
    return lambda: decode_raw(data, RawParameters(1), "counts", ticks, 1, AT)


def grid(data: bytes) -> Callable[[], Any]:
    return lambda: LpcParameters.parse(data, ONE, AT)


def predicted(data: bytes, span: int = 1) -> Callable[[], Any]:
    return lambda: decode_indices(data, span, ONE.count_bound, AT)


def further(data: bytes, span: int = 2) -> Callable[[], Any]:
    return lambda: codec.decode_indices(data, "hold", span, 1, ONE.count_bound, AT)


def transform(data: bytes) -> Callable[[], Any]:
    return lambda: TransformParameters.parse(data, AT)


def transformed(data: bytes, count: int = 1) -> Callable[[], Any]:
    """One tick of blocks of 32, of step 1."""
    parameters = TransformParameters(32, 256)
    return lambda: decode_transform(data, parameters, 1, count, ONE, AT, -9, 9)


LARGE = page_transform.encode([[2**26, 2**27]], [256] * 32, loud=True)
"""Coefficients of 2^35 and, with the other quantiser, about 2^36."""


def noise(data: bytes, span: int = 24, count: int = 1) -> Callable[[], Any]:
    return lambda: decode_noise(data, NoiseParameters(3, 8), span, count, AT, -9, 9)


def noisy(data: bytes) -> Callable[[], Any]:
    return lambda: NoiseParameters.parse(data, AT)


NOISE = page_noise.encode([40, 44, 36], [[50, -20]], 8)
"""Of 24 ticks, 18 bytes."""


FIVE = b"\3\x10\0\x0a"
"""The counts of a packet of LPCX: all 5."""


def described(data: bytes) -> Callable[[], Any]:
    return lambda: ExactParameters.parse(data, AT)


def counts(data: bytes) -> Callable[[], Any]:
    return lambda: decode_counts(data, 1, ONE, AT)


def beside(rest: bytes) -> Callable[[], Any]:
    """Corrections of one count; the first byte that is theirs stands at 104."""
    five = np.array([5])
    return lambda: decode_exact(FIVE + rest, ExactParameters(), Affine(), five, AT)


FIVES = b"\7\3\x10\0\x0a\x10\0\x0a"
"""The same of two components."""


def decode_parts(data: bytes, offset: int) -> Any:
    rules, five = [ExactParameters()] * 2, np.full((1, 2), 5)
    return decode_both(data, rules, [Affine()] * 2, five, offset)


def corrected(length: int) -> bytes:
    """A correction of so many bits."""
    return page_exact.build_exact([2**length // 2], [5], 0, None, (length, [1]))


def exact_track(**given: Any) -> bytes:
    return f.trak(f.tlv(1, f.lpcx_parameters()) + given.pop("tlvs", b""), codec=b"LPCX", **given)


FIRST = b"\3\x10\0\0"
"""The size of a first component, which is constant, and itself."""


def several(data: bytes, count: int = 2) -> Callable[[], Any]:
    return lambda: decode_predicted(data, LpcParameters(), 1, count, ONE, AT)


def deflated(data: bytes) -> bytes:
    packer = zlib.compressobj(wbits=-15)
    return b"\1" + packer.compress(data) + packer.flush()


def judged(data: bytes, limits: Limits | None = None) -> Callable[[], Any]:
    def call() -> None:
        report = verify(data, limits=limits)
        if report.error:
            raise report.error

    return call


def opened(data: bytes) -> Callable[[], Any]:
    return lambda: open_catalogue(BytesSource(data), scan=True)


HEAD, TRACK, DATA = ("HEAD", f.head()), f.TRACK_0, f.DATA_0
FIRST_INDEX = f.index((("HEAD", 8, 0, 0),))
NESTED = ("iNDX", f.chunk("iNDX", f.index((("HEAD", 43, 0, 0),), previous=43), 1))
TRACK_AT = 8 + f.HEADER + len(f.head())
DATA_AT = TRACK_AT + f.HEADER + len(TRACK[1])
END = DATA_AT + f.HEADER + len(DATA[1])
"""Offset of the chunk after HEAD, TRACK, DATA."""

LONG = [("aTTc", f.strings("a", "") + bytes(2**20 - 3))] * 4
LISTED = [IndexEntry("HEAD", 8), IndexEntry("DATA", 88, 5, 9)]
UP_TO_HF = f.trak(kind=1)
RESIDUAL = f.trak(kind=2, base=0)


CONTINUING = f.trak(continues=0, first=1)
CHAIN_AT = DATA_AT + f.HEADER + len(CONTINUING) + f.HEADER


def chain(*packets: tuple[int, int, int], then: tuple[int, int, int] | None = None) -> bytes:
    """A channel of two tracks; (track, start, span) of one cluster, and of one in the next."""
    clusters = [("DATA", f.cluster(*[(*packet, f.KNOT_DATA) for packet in packets]))]
    clusters += [("DATA", f.cluster((*then, f.KNOT_DATA)))] if then else []
    return f.file(HEAD, TRACK, ("TRAK", CONTINUING), *clusters)


MARKED = f.minimal(("TRAK", f.layer(first=1)), ("DATA", f.cluster((1, 0, 1, f.event(0)))))


DIGESTED = f.minimal(("TRAK", f.layer(first=1)), ("dGST", f.digests(bytes(32), first=1)))


def layer(*args: Any, **fields: Any) -> Callable[[], Any]:
    return lambda: parse_description(f.layer(*args, **fields), ONE, AT)


def clock(data: bytes) -> Callable[[], Any]:
    return lambda: parse_clock(data, AT)


def mapped(data: bytes) -> Callable[[], Any]:
    return lambda: parse_map(data, AT)


def events(data: bytes) -> Callable[[], Any]:
    """Of a packet of ticks 0 to 3."""
    return lambda: parse_events(data, 0, 4, AT)


def at_index(*rows: tuple[Any, ...], cut: int = 0, **given: Any) -> Callable[[], Any]:
    data = f.index(rows, **given)
    return lambda: parse_index(data[: len(data) - cut], 500, AT)


def listed(*rows: tuple[Any, ...], **given: Any) -> Callable[[], Any]:
    index = parse_index(f.index(rows, **given), 500, 0)
    return lambda: check_listing(index, 500, LISTED, AT)


FAULTS = [
    # clause 2
    Fault("CNV-002", 100, "varint cut short", lambda: parse_varint(b"\x80", 0, AT)),
    Fault("CNV-002", 100, "varint of 2^53", lambda: parse_varint(b"\x80" * 7 + b"\x10", 0, AT)),
    Fault("CNV-002", 100, "varint not minimal", lambda: parse_varint(b"\x80\0", 0, AT)),
    Fault("CNV-002", 101, "row cut short", lambda: parse_varints(b"\x80", AT)),
    Fault("CNV-002", 100, "row: nine bytes", lambda: parse_varints(b"\x80" * 8 + b"\1", AT)),
    Fault("CNV-002", 101, "row: 2^53", lambda: parse_varints(b"\0" + b"\x80" * 7 + b"\x10", AT)),
    Fault("CNV-002", 100, "row: not minimal", lambda: parse_varints(b"\x80\0", AT)),
    Fault("CNV-004", 101, "not UTF-8", lambda: parse_strings(b"\1\xff", 1, AT)),
    Fault("CNV-004", 101, "U+0000", lambda: parse_strings(b"\1\0", 1, AT)),
    Fault("TLV-004", 100, "the text before the first", lambda: parse_strings(b"\xff", 1, AT)),
    # clause 5
    Fault("FIL-001", 0, "empty file", judged(b"")),
    Fault("FIL-002", 100, "header cut short", lambda: parse_header(b"", AT)),
    Fault("CHK-002", 100, "no sync word", lambda: parse_header(bytes(32), AT)),
    Fault("CHK-002", 100, "header CRC", lambda: parse_header(header(header_crc=0), AT)),
    Fault("CHK-002", 100, "no letters", lambda: parse_header(header(type_="m3Ta"), AT)),
    Fault("LIM-001", 100, "payload of 2^24 + 1", lambda: parse_header(header(size=2**24 + 1), AT)),
    Fault("CHK-009", 8, "critical chunk", judged(f.file(("XXXX", b"")))),
    Fault("LIM-001", TRACK_AT, "payload above level 1", judged(f.file(HEAD, ("mETa", bytes(2**20 + 1))))),
    # 6.1
    Fault("HED-001", 0, "signature only", judged(f.SIGNATURE)),
    Fault("HED-001", 8, "no HEAD", judged(f.file(("mETa", b"{}")))),
    Fault("HED-001", 8 + f.HEADER, "HEAD second", judged(f.file(("aaaa", b""), HEAD))),
    Fault("HED-002", 100, "HEAD cut short",
          lambda: parse_head(b"", AT)),
    Fault("VER-001", 100, "major version", head(major=2)),
    Fault("HED-004", 102, "level", head(level=3)),
    Fault("HED-002", 105, "a UUID of 15 bytes", head(f.tlv(2, bytes(15)))),
    Fault("HED-002", 105, "an epoch of 17 bytes", head(f.tlv(4, bytes(17)))),
    Fault("HED-002", 105, "an uncertainty of 2^63", head(f.epoch(0, 2**63))),
    Fault("CNV-004", 105, "an encoder that is not UTF-8", head(f.tlv(6, b"\xff"))),
    Fault("TLV-003", 100, "critical TLV in HEAD", head(f.tlv(1, b""))),
    Fault("HED-001", TRACK_AT, "second HEAD", judged(f.file(HEAD, ("HEAD", f.head(minor=1))))),
    # 6.2
    Fault("TLV-001", 102, "same type twice", lambda: parse_tlvs(f.tlv(2, b"") * 2, 0, AT)),
    Fault("CNV-002", 101, "half a TLV", lambda: parse_tlvs(b"\0", 0, AT)),
    Fault("TLV-001", 100, "TLV too long", lambda: parse_tlvs(b"\0\1", 0, AT)),
    Fault("TLV-001", 100, "type 65536", lambda: parse_tlvs(f.tlv(1 << 16, b""), 0, AT)),
    Fault("TLV-004", 100, "string too long", lambda: parse_strings(b"\1", 1, AT)),
    Fault("CNV-002", 121, "half a calibration", tracks(f.tlv(3, b"\2"), codec=b"RAWB")),
    Fault("CNV-002", 100, "TRAK cut short", lambda: parse_description(b"", ONE, AT)),
    Fault("TLV-004", 100, "two for three", lambda: parse_strings(f.strings("", ""), 3, AT)),
    Fault("TLV-005", 120, "deviation", tracks(f.tlv(18, f.deviation(1.0, 2.0)))),
    Fault("TLV-005", 120, "infinite", tracks(f.tlv(18, f.deviation(float("inf"), 1.0)))),
    Fault("TLV-004", 120, "half a deviation", tracks(f.tlv(18, bytes(7)))),
    Fault("TLV-004", 125, "a byte after a contract", tracks(f.tlv(16, f.deadband() + b"\0"))),
    # 6.3
    Fault("TRK-002", 102, "no track", tracks(track_count=0)),
    Fault("TRK-020", 102, "a stream of no byte", payload(b"\0\x10")),
    Fault("TRK-020", 102, "no DEFLATE", payload(b"\0\x10\7")),
    Fault("TRK-020", 102, "a byte too few", payload(b"\0\x18" + SQUEEZED[2:])),
    Fault("TRK-020", 102, "a byte too many", payload(b"\0\x16" + SQUEEZED[2:])),
    Fault("TRK-020", 102, "cut short", payload(SQUEEZED[:-1])),
    Fault("TRK-020", 102, "a byte behind the stream", payload(SQUEEZED + b"\0")),
    Fault("TRK-020", 100, "2^20 bytes", payload(b"\0" + f.varint(1 << 20) + SQUEEZED[2:])),
    Fault("TRK-002", 100, "no component, in a stream",
          payload(f.squeezed(f.trak(component_count=0)))),
    Fault("TLV-001", 125, "a byte after the last track", payload(f.trak() + b"\0")),
    Fault("TLV-001", 125, "a TLV that is not there", tracks(tlv_count=2)),
    Fault("TRK-002", 102, "no component", tracks(component_count=0)),
    Fault("TRK-002", 102, "rate 0", tracks(rate_num=0)),
    Fault("TRK-002", 102, "rate 1/0", tracks(rate_den=0)),
    Fault("TRK-002", 102, "rate 2^32", tracks(rate_num=2**32)),
    Fault("TRK-002", 454, "256 components", tracks(track_count=16, component_count=16)),
    Fault("TRK-003", 100, "track 65534", tracks(first=65534)),
    Fault("TRK-003", 100, "track 65534 second", tracks(first=65533, track_count=2)),
    Fault("TRK-003", 100, "twice", added(f.trak(), f.trak(first_channel=1), f.trak(kind=1))),
    Fault("TRK-005", 102, "range upside down", tracks(count_min=1, count_max=0)),
    Fault("TRK-005", 102, "25 bits below", tracks(count_min=-(2**23) - 1)),
    Fault("TRK-005", 102, "25 bits above", tracks(count_max=2**23)),
    Fault("TRK-006", 102, "words in KNOT", tracks(number_format=1, count_min=0, count_max=0)),
    Fault("TRK-006", 102, "words with a contract",
          tracks(f.tlv(16, f.deadband()), number_format=1, codec=b"RAWB", count_min=0, count_max=0)),
    Fault("TRK-007", 100, "HF without base", added(f.trak(kind=2))),
    Fault("TRK-007", 100, "base unknown", added(RESIDUAL)),
    Fault("TRK-007", 100, "base full band", added(f.trak(), RESIDUAL)),
    Fault("TRK-007", 100, "another rate", added(UP_TO_HF, f.trak(kind=2, base=0, rate_num=1))),
    Fault("TRK-009", 102, "HF with a label", tracks(f.tlv(2, f.strings("")), kind=2, base=0)),
    Fault("TRK-009", 120, "LF with channel numbers", tracks(f.tlv(5, b""), kind=1)),
    Fault("TRK-010", 102, "channel 65535", tracks(first_channel=65535)),
    Fault("TRK-010", 120, "a channel twice", tracks(f.tlv(5, bytes(2)), component_count=2)),
    Fault("TLV-004", 120, "a channel number too many", tracks(f.tlv(5, bytes(2)))),
    Fault("TRK-010", 100, "channel taken", added(f.trak(), f.trak())),
    Fault("TRK-012", TRACK_AT + f.HEADER, "LF alone", judged(
        f.closed(HEAD, ("TRAK", f.trak(kind=1)), DATA))),
    Fault("TRK-010", len(f.minimal()) - 12, "a hole", judged(
        f.closed(HEAD, ("TRAK", f.trak(first_channel=1)), DATA))),
    Fault("TRK-010", 102, "channel 65534 of two", tracks(first_channel=65534, component_count=2)),
    Fault("TRK-010", 100, "twice in a chunk", added(f.tracks(f.track(), f.track()))),
    Fault("TRK-016", 100, "continues nothing", added(CONTINUING)),
    Fault("TRK-016", 100, "continues itself", added(f.trak(continues=0))),
    Fault("TRK-016", 100, "continues a later one", added(f.tracks(f.track(continues=1), f.track()))),
    Fault("TRK-016", 100, "continued twice", added(
          f.tracks(f.track(), f.track(continues=0), f.track(continues=0)))),
    Fault("TRK-016", 100, "another rate, continued",
          added(f.trak(), f.trak(continues=0, rate_num=1))),
    Fault("TRK-016", 100, "other channels", added(f.trak(), f.trak(continues=0, first_channel=1))),
    Fault("TRK-016", 100, "more components",
          added(f.trak(), f.trak(continues=0, component_count=2))),
    Fault("TRK-016", 100, "another unit",
          added(f.trak(), f.trak(f.tlv(4, f.strings("N")), continues=0))),
    Fault("TRK-016", 100, "another calibration",
          added(f.trak(), f.trak(f.tlv(3, f.calibration(2)), continues=0))),
    Fault("TRK-016", CHAIN_AT + 24, "before the end of the other", judged(chain((0, 0, 4), (1, 3, 4)))),
    Fault("TRK-016", CHAIN_AT + f.HEADER + 31, "after the one that continues it",
          judged(chain((1, 0, 4), then=(0, 4, 4)))),
    Fault("TRK-019", 102, "events in KNOT", tracks(kind=3)),
    Fault("TRK-019", 102, "EVNT full band", tracks(codec=b"EVNT")),
    Fault("TRK-019", 102, "events with channels", layer(first_channel=1)),
    Fault("TRK-019", 102, "events with a range", layer(count_max=1)),
    Fault("TRK-019", 102, "events of two components", layer(component_count=2)),
    Fault("TRK-019", 102, "events that are words", layer(number_format=1)),
    Fault("TRK-019", 102, "events with parameters", layer(f.tlv(1, b""))),
    Fault("TRK-019", 102, "events with a unit", layer(f.tlv(4, f.strings("N")))),
    Fault("TRK-019", 102, "events that continue", layer(continues=0)),
    # 6.4
    Fault("DAT-001", 100, "no packet", cluster(b"\0")),
    Fault("DAT-001", 100, "2^14 + 1 packets", cluster(f.varint(2**14 + 1))),
    Fault("DAT-002", 111, "twice at a tick", cluster(f.cluster(*[(0, 0, 1, b"")] * 2))),
    Fault("DAT-003", 107, "no tick", cluster(f.cluster((0, 0, 0, b"")))),
    Fault("DAT-003", 110, "2^24 + 1 ticks", cluster(f.cluster((0, 0, 2**24 + 1, b"")))),
    Fault("DAT-003", 113, "tick 2^48", cluster(f.cluster((0, 2**48, 1, b"")))),
    Fault("DAT-004", 107, "packet CRC", cluster(f.cluster((0, 0, 1, b""), crcs={0: 0}))),
    Fault("DAT-005", 110, "table cut short", cluster(f.cluster((0, 0, 1, b""))[:10])),
    Fault("DAT-005", 107, "packet cut short", cluster(f.table([(0, 1, 0, 1, 0)]))),
    Fault("DAT-005", 101, "head cut short", cluster(b"\1\0")),
    Fault("DAT-001", 101, "seven bytes", cluster(f.cluster((0, 0, 1, b""), widths=(0, 0, 7, 0)))),
    Fault("DAT-011", 111, "table CRC", cluster(f.cluster((0, 0, 1, b""), crc=0))),
    Fault("DAT-005", 115, "a byte too much", cluster(f.cluster((0, 0, 1, b"")) + b"\0")),
    Fault("DAT-006", DATA_AT + f.HEADER + 22, "overlap", judged(
        f.file(HEAD, TRACK, ("DATA", f.cluster((0, 0, 4, b"\0"), (0, 3, 4, b"\0")))))),
    Fault("DAT-008", 107, "unknown track", cluster(f.cluster((9, 0, 1, b"")))),
    Fault("DAT-008", 8 + f.HEADER + len(f.head()) + f.HEADER + 7, "track not described", judged(f.file(HEAD, DATA))),
    Fault("DAT-009", 109, "2^22 + 1 samples", cluster(f.cluster((1, 0, 2**22 // 200 + 1, b"")))),
    # 11.1, 11.2
    Fault("IDX-002", 100, "index cut short", lambda: parse_index(b"", 500, AT)),
    Fault("IDX-002", 100, "entries missing", at_index(count=1)),
    Fault("IDX-002", 127, "an entry missing", at_index(("DATA", 8, 2**20, 2**21), count=2)),
    Fault("IDX-002", 116, "entries too many", at_index(("HEAD", 8, 0, 0), count=0)),
    Fault("CNV-002", 126, "an entry without times", at_index(("aaaa", 8, 0, 0), ("DATA", 44, 0, 0),
                                                             cut=2)),
    Fault("IDX-002", 116, "behind the index", at_index(("HEAD", 500, 0, 0))),
    Fault("IDX-002", 116, "an entry of no type", at_index(("DAT4", 8, 0, 0))),
    Fault("IDX-002", 121, "within the header before",
          at_index(("HEAD", 8, 0, 0), ("TRAK", 39, 0, 0))),
    Fault("IDX-002", 121, "same twice", at_index(("HEAD", 8, 0, 0), ("TRAK", 8, 0, 0))),
    Fault("IDX-002", 112, "16 entries in 500 bytes", at_index(*[("HEAD", 8, 0, 0)] * 16)),
    Fault("IDX-002", 100, "chunk not listed", listed(("HEAD", 8, 0, 0))),
    Fault("IDX-003", 8, "nothing there", lambda: ChunkRef("DATA", 8, limit=99).checked(None)),
    Fault("IDX-002", 100, "previous within the signature", at_index(previous=7)),
    Fault("IDX-002", 100, "previous behind", at_index(previous=501)),
    Fault("IDX-002", 108, "counts from 1", listed(("HEAD", 8, 0, 0), ("DATA", 88, 5, 9), first=1)),
    Fault("IDX-002", 8, "no index there", lambda: index_entries(BytesSource(f.file(HEAD)), 8, 7)),
    Fault("IDX-002", TRACK_AT, "an index that leaves out a chunk",
          lambda: index_entries(BytesSource(f.file(HEAD, ("iNDX", f.index(())))), TRACK_AT, 7)),
    Fault("IDX-002", TRACK_AT + f.HEADER + len(FIRST_INDEX), "not with another first",
          lambda: index_entries(BytesSource(f.file(HEAD, ("iNDX", FIRST_INDEX), ("iNDX", f.index(
              (), previous=TRACK_AT, first=2)))), TRACK_AT + f.HEADER + len(FIRST_INDEX), 7)),
    Fault("IDX-002", TRACK_AT, "an index within another",
          lambda: index_entries(BytesSource(f.file(HEAD, NESTED)), TRACK_AT + f.HEADER, 7)),
    Fault("IDX-005", 8 + f.HEADER + len(f.head()) + 3 * (f.HEADER + 2**20), "no index in 4 MiB",
          judged(f.file(HEAD, *LONG))),
    Fault("IDX-002", 100, "starts too late", listed(("HEAD", 8, 0, 0), ("DATA", 88, 6, 9))),
    Fault("IDX-002", 100, "stops too early", listed(("HEAD", 8, 0, 0), ("DATA", 88, 5, 8))),
    Fault("FOT-001", 100, "footer cut short", lambda: parse_foot(b"", AT)),
    Fault("FOT-001", 100, "a byte too much", lambda: parse_foot(bytes(13), AT)),
    Fault("IDX-002", END + f.HEADER, "previous is no index", judged(f.minimal(
        ahead={"entries": [("DATA", DATA_AT, 0, 10**12)], "first": 2, "previous": DATA_AT}))),
    Fault("FOT-002", END + f.HEADER, "no index at the distance", judged(f.minimal(indexed=False, index_distance=1))),
    Fault("FOT-002", len(f.minimal()) - 12, "another index", judged(f.minimal(index_distance=8))),
    Fault("FOT-002", len(f.minimal()) - 12, "another duration", judged(f.minimal(duration_ns=1))),
    # 11.3 to 11.5
    Fault("MET-001", 100, "no JSON", lambda: parse_metadata(b"", AT)),
    Fault("MET-001", 100, "no object", lambda: parse_metadata(b"[]", AT)),
    Fault("MET-001", 100, "65 deep",
          lambda: parse_metadata(b'{"":' + b"[" * 64 + b"]" * 64 + b"}", AT)),
    Fault("ATT-001", 100, "name cut short", lambda: parse_attachment(b"\1", AT)),
    Fault("ATT-001", 100, "no name", lambda: parse_attachment(b"\0\0", AT)),
    Fault("DGS-001", END + 2 * f.HEADER + len(f.layer(first=1)), "digest of events", judged(DIGESTED)),
    Fault("DGS-001", END + f.HEADER + 1, "no digest", judged(f.minimal(("dGST", f.digests(b""))))),
    Fault("DGS-001", END + f.HEADER, "digest of no track",
          judged(f.minimal(("dGST", f.digests(bytes(32), first=1))))),
    # clauses 8 and 11
    Fault("VAL-001", 120, "A = 0", tracks(f.tlv(3, f.calibration(0)))),
    Fault("VAL-001", 120, "D = 0", tracks(f.tlv(3, f.calibration(d=0)))),
    Fault("CNV-002", 122, "D = 2^53", tracks(f.tlv(3, f.calibration(d=2**53)))),
    Fault("CNV-002", 121, "B = 2^52", tracks(f.tlv(3, f.calibration(b=2**52)))),
    Fault("VAL-001", 120, "A = -2^52", tracks(f.tlv(3, f.calibration(-(2**52))))),
    Fault("VAL-001", 120, "B = -2^52", tracks(f.tlv(3, f.calibration(b=-(2**52))))),
    Fault("VAL-001", 102, "count * A + B", tracks(f.tlv(3, f.calibration(2**52 - 1)))),
    Fault("VAL-001", 100, "count * A of HF",
          added(f.trak(f.tlv(3, f.calibration(2**46)), kind=1),
                f.trak(kind=2, base=0, count_max=129))),
    Fault("CNV-002", 120, "no contract", tracks(f.tlv(16, b""))),
    Fault("TLV-004", 122, "no flags", tracks(f.tlv(16, f.deadband()[:2]))),
    Fault("CNV-002", 123, "no floor", tracks(f.tlv(16, f.deadband(entries=[])))),
    Fault("DBC-001", 120, "kd = 0", tracks(f.tlv(16, f.deadband(kd=0)))),
    Fault("DBC-001", 120, "kd = 2^16", tracks(f.tlv(16, f.deadband(kd=2**16)))),
    Fault("DBC-001", 120, "kn = 2^16", tracks(f.tlv(16, f.deadband(2**16)))),
    Fault("DBC-001", 120, "flag bit 2", tracks(f.tlv(16, f.deadband(flags=4)))),
    Fault("DBC-001", 120, "floor of 0", tracks(f.tlv(16, f.deadband(entries=[(0, 0)])))),
    Fault("DBC-001", 120, "floor of 2^32", tracks(f.tlv(16, f.deadband(entries=[(2**32, 0)])))),
    Fault("DBC-001", 120, "zero of 2^31", tracks(f.tlv(16, f.deadband(entries=[(1, 2**31)])))),
    Fault("DBC-001", 120, "zero below", tracks(f.tlv(16, f.deadband(entries=[(1, -(2**31) - 1)])))),
    # 9.1
    Fault("COD-002", 100, "KNOT cut short", knotted(b"\0")),
    Fault("COD-002", 102, "KNOT too long", knotted(f.knot_parameters() + b"\0")),
    Fault("COD-002", 102, "KNOT without a grid", knotted(b"\0\0")),
    Fault("KNT-001", 100, "interpolation 2", knotted(f.knot_parameters(2))),
    Fault("KNT-001", 100, "coding 2", knotted(f.knot_parameters(coding=2))),
    Fault("LPC-002", 102, "KNOT on grid 2", knotted(f.knot_parameters(grid=2))),
    Fault("LPC-002", 102, "KNOT in steps of 0", knotted(f.knot_parameters(0, 0))),
    Fault("LPC-002", 103, "step above level 1", knotted(f.knot_parameters(0, 2**24 + 1))),
    Fault("KNT-002", 100, "no knot", knots(b"")),
    Fault("KNT-002", 100, "half a knot", knots(b"\0\1")),
    Fault("KNT-003", 100, "same tick", knots(b"\0\0\0")),
    Fault("LPC-003", 100, "knot of index 2^24 + 1", knots(f.svarint(2**24 + 1))),
    Fault("LPC-003", 100, "index times step", knots(f.svarint(2), step=2**23 + 1)),
    Fault("LPC-003", 100, "index 2^51", knots(f.svarint(2**51))),
    Fault("KNT-003", 100, "tick 4 of 4", knots(b"\0\4\0")),
    Fault("KNT-003", 100, "line ends early", knots(b"\0\2\0", interpolation="linear")),
    Fault("KNT-003", 100, "knot too many", knots(b"\0\3\0\1\0", interpolation="linear")),
    # 9.2
    Fault("COD-002", 100, "QUAN cut short", lambda: QuanParameters.parse(b"", ONE, AT)),
    Fault("QNT-001", 100, "step 0",
          lambda: QuanParameters.parse(f.quan_parameters(b"\x10", step=0), ONE, AT)),
    Fault("QNT-001", 100, "step above level 1",
          lambda: QuanParameters.parse(f.quan_parameters(b"\x10", step=2**24 + 1), ONE, AT)),
    Fault("QNT-001", 104, "4097 symbols",
          lambda: QuanParameters.parse(f.quan_parameters(b"", m=2048), ONE, AT)),
    Fault("QNT-001", 104, "R = 25",
          lambda: QuanParameters.parse(f.quan_parameters(b"", r=25), ONE, AT)),
    Fault("QNT-001", 104, "C = 33",
          lambda: QuanParameters.parse(f.quan_parameters(b"", c=33), ONE, AT)),
    Fault("QNT-003", 101, "two words for one symbol", lambda: parse_codebook(b"\x11", 1, AT)),
    Fault("QNT-003", 100, "no word", lambda: parse_codebook(b"", 1, AT)),
    Fault("QNT-003", 100, "one word of two bits", lambda: parse_codebook(b"\x20", 1, AT)),
    Fault("QNT-003", 100, "three words of one bit", lambda: parse_codebook(b"\x11\x10", 3, AT)),
    Fault("QNT-004", 100, "run past the end", levels(b"\xc0", 1)),
    Fault("QNT-004", 101, "a byte too much", levels(b"\0\0", 4)),
    Fault("QNT-004", 100, "filled with ones", levels(b"\x01", 3)),
    Fault("QNT-006", 100, "level times step",
          levels(b"\x60", 1, f.quan_parameters(b"\x33\x33\x33\x33", c=7, step=2**24))),
    Fault("COD-001", 100, "bytes that nothing needs", levels(b"\0", 1, f.quan_parameters(b"\x10"))),
    Fault("COD-001", 101, "levels missing", levels(b"\0", 5)),
    # 9.3
    Fault("COD-002", 100, "RAWB cut short", lambda: RawParameters.parse(b"", "counts", AT)),
    Fault("COD-002", 100, "RAWB too long", lambda: RawParameters.parse(bytes(5), "counts", AT)),
    Fault("RAW-001", 100, "counts of 8 bytes",
          lambda: RawParameters.parse(f.raw_parameters(8), "counts", AT)),
    Fault("RAW-001", 100, "binary32 of 8 bytes",
          lambda: RawParameters.parse(f.raw_parameters(8), "binary32", AT)),
    Fault("HED-005", 101, "RAWB reserved",
          lambda: RawParameters.parse(f.raw_parameters(1, b"\1\0\0"), "counts", AT)),
    Fault("COD-001", 100, "no method", words(b"")),
    Fault("RAW-003", 100, "method 2", words(b"\2")),
    Fault("RAW-003", 100, "stored too short", words(b"\0\0")),
    Fault("RAW-003", 100, "stored too long", words(b"\0\0\0\0")),
    Fault("RAW-003", 101, "inflates too short", words(deflated(b"\0"))),
    Fault("RAW-003", 101, "inflates too long", words(deflated(bytes(3)))),
    Fault("RAW-003", 101, "no DEFLATE", words(b"\1\xff")),
    Fault("RAW-005", DATA_AT - 1 + f.HEADER + 15, "count outside its range", judged(f.file(HEAD, (
        "TRAK", f.trak(f.tlv(1, f.raw_parameters(1)), codec=b"RAWB")),
        ("DATA", f.cluster((0, 0, 1, b"\0\x7f")))))),
    Fault("RAW-003", 101, "bytes after it", words(deflated(bytes(2)) + b"\0")),
    # 9.4 and 9.5
    Fault("RNG-001", 109, "a byte too much", predicted(page.encode([1]) + b"\0")),
    Fault("RNG-003", 109, "2^34", predicted(page.encode([0], forge=[2**34]))),
    Fault("RNG-004", 103, "no coding", predicted(b"\0\0\0")),
    Fault("RNG-004", 103, "a class by bits", predicted(b"\0\0\0\x41\0")),
    Fault("RNG-004", 103, "coding bit 7", predicted(b"\0\0\0\x80\0")),
    Fault("RNG-001", 108, "a byte too much by bits",
          predicted(page.encode([1], number=page.BY_BITS) + b"\0")),
    Fault("RNG-003", 112, "2^34 by bits",
          predicted(page.encode([0], number=page.BY_BITS, forge=[2**34]))),
    Fault("RNG-004", 103, "repeats by bits of probability 0", predicted(b"\x08\0\0\x40\1\1\1\0")),
    Fault("RNG-004", 103, "start 164", predicted(b"\0\0\0\0\xa4")),
    Fault("RNG-004", 103, "repeats of probability 0", predicted(b"\x08\0\0\0\0\1\1\1\0")),
    Fault("RNG-004", 103, "signs cut short", predicted(b"\0\0\0\x20\0\1\1")),
    Fault("COD-002", 100, "LPCR cut short", grid(b"")),
    Fault("COD-002", 100, "LPCR too long", grid(f.lpcr_parameters() + b"\0")),
    Fault("CNV-002", 102, "LPCR without zero", grid(b"\0\1")),
    Fault("LPC-001", 100, "components larger than the packet", several(b"\3\x10\0")),
    Fault("LPC-006", 101, "a component of no bytes", several(b"\0\x10\0\0")),
    Fault("LPC-006", 104, "no second component", several(b"\3\x10\0\0")),
    Fault("CNV-002", 100, "no sizes", several(b"")),
    Fault("LPC-002", 100, "grid 2", grid(f.lpcr_parameters(2))),
    Fault("LPC-002", 100, "step 0", grid(f.lpcr_parameters(step=0))),
    Fault("LPC-002", 100, "zero of 2^31", grid(f.lpcr_parameters(zero=2**31))),
    Fault("LPC-002", 100, "zero below", grid(f.lpcr_parameters(zero=-(2**31) - 1))),
    Fault("LPC-002", 100, "kn = 2^16", grid(f.lpcr_parameters(1, kn=2**16))),
    Fault("LPC-002", 100, "kd = 2^16", grid(f.lpcr_parameters(1, kn=1, kd=2**16))),
    Fault("LPC-002", 100, "kd = 1024 kn + 1", grid(f.lpcr_parameters(1, kn=1, kd=1025))),
    Fault("LPC-002", 100, "kn = 0", grid(f.lpcr_parameters(1))),
    Fault("LPC-002", 100, "kd = 0", grid(f.lpcr_parameters(1, kn=1, kd=0))),
    Fault("LPC-002", 101, "step 2^24 + 1", grid(f.lpcr_parameters(step=2**24 + 1))),
    Fault("LPC-003", 100, "base 2^24 + 1", predicted(b"\0\0" + f.svarint(2**24 + 1))),
    Fault("LPC-003", 109, "index 2^24 + 1", predicted(page.encode([2**24 + 1]))),
    Fault("LPC-004", 100, "difference 5", predicted(b"\5\0\0")),
    Fault("LPC-004", 100, "difference 2, order 1", predicted(b"\2\1\0\0")),
    Fault("LPC-004", 100, "order 33", predicted(b"\0\x21" + bytes(34))),
    Fault("LPC-004", 100, "k = -128", predicted(b"\0\1\x80\0")),
    Fault("LPC-004", 104, "constant with references", several(FIRST + b"\x50\0\1\0\0\0\0\0")),
    Fault("LPC-004", 100, "bit 5", predicted(b"\x20\0\0\x16")),
    Fault("LPC-004", 100, "constant with bit 5", predicted(b"\x30\0\0")),
    Fault("LPC-004", 100, "constant with repeats", predicted(b"\x18\0\0")),
    Fault("LPC-004", 100, "constant with order 1", predicted(b"\x10\1\0\0")),
    Fault("LPC-004", 100, "bit 7", predicted(b"\x80\0\0\x16")),
    Fault("LPC-005", 102, "p above 2^36", predicted(b"\0\x20" + b"\x7f\x81" * 16 + b"\0")),
    Fault("LPC-005", 102, "c above 2^21", predicted(b"\0\x0b" + b"\x81" * 11 + b"\0")),
    Fault("LPC-006", 100, "no flags", predicted(b"")),
    Fault("LPC-006", 100, "coefficients cut short", predicted(b"\0\1")),
    Fault("LPC-007", 102, "a reference to itself", predicted(b"\x40\0\1\0\0\0\0")),
    Fault("LPC-007", 106, "a reference ahead", several(FIRST + b"\x40\0\1\1\0\0\0")),
    Fault("LPC-007", 106, "no references", several(FIRST + b"\x40\0\0")),
    Fault("LPC-007", 106, "the same twice", several(FIRST + b"\x40\0\2" + bytes(8))),
    Fault("LPC-007", 138, "nine references", several(
        b"\3" * 9 + b"\x10\0\0" * 9 + b"\x40\0\x09" + b"".join(
            bytes([a, 0, 0, 0]) for a in range(9)), 10)),
    Fault("LPC-006", 106, "no number of references", several(FIRST + b"\x40\0")),
    Fault("LPC-006", 106, "references cut short", several(FIRST + b"\x40\0\1\0\0\0")),
    # 9.8
    Fault("COD-002", 100, "MDCT without parameters", transform(b"")),
    Fault("CNV-002", 101, "MDCT without a step", transform(b"\5")),
    Fault("COD-002", 100, "MDCT cut short", transform(b"\5\1")),
    Fault("COD-002", 100, "a weight missing", transform(f.mdct_parameters(5, 1, (1, 1))[:-1])),
    Fault("COD-002", 100, "MDCT too long", transform(f.mdct_parameters() + b"\0")),
    Fault("MDC-001", 100, "blocks of 16", transform(f.mdct_parameters(4))),
    Fault("MDC-001", 100, "blocks of 1024", transform(f.mdct_parameters(10))),
    Fault("MDC-001", 100, "blocks of 2^255", transform(b"\xff\1\0")),
    Fault("MDC-001", 100, "MDCT step 0", transform(f.mdct_parameters(step=0))),
    Fault("MDC-001", 100, "MDCT step 2^32 + 1", transform(f.mdct_parameters(step=2**32 + 1))),
    Fault("MDC-001", 100, "three weights", transform(f.mdct_parameters(weights=(1, 1, 1)))),
    Fault("MDC-001", 100, "64 weights of 32", transform(f.mdct_parameters(weights=(1,) * 64))),
    Fault("CNV-002", 100, "MDCT without a base", transformed(b"")),
    Fault("CNV-002", 101, "MDCT without K", transformed(b"\0")),
    Fault("MDC-002", 100, "base above 2^24", transformed(f.svarint(2**24 + 1) + b"\0")),
    Fault("MDC-002", 100, "base below", transformed(f.svarint(-(2**24) - 1) + b"\0")),
    Fault("MDC-002", 100, "33 of 32 coefficients", transformed(b"\0\x21\0\0")),
    Fault("COD-001", 102, "a byte after a base alone", transformed(b"\0\0\0")),
    Fault("RNG-004", 102, "no classes", transformed(b"\0\1")),
    Fault("RNG-004", 102, "no start byte", transformed(b"\0\1\0")),
    Fault("RNG-004", 102, "MDCT start 164", transformed(b"\0\1\0\xa4")),
    Fault("RNG-001", 104, "no coded bytes", transformed(b"\0\1\0\0")),
    Fault("RNG-001", 108, "coded bytes and one",
          transformed(page_transform.encode([[1]], [256]) + b"\0")),
    Fault("RNG-003", 108, "a coefficient of 2^34",
          transformed(page_transform.encode([[2**34]], [1], loud=True))),
    Fault("MDC-003", 110, "a block above 2^36", transformed(LARGE)),
    Fault("LPC-001", 100, "transforms larger than the packet", transformed(b"\3\0\0", 2)),
    # 9.7
    Fault("COD-002", 100, "LPCX cut short", described(b"")),
    Fault("COD-002", 100, "LPCX too long", described(f.lpcx_parameters() + b"\0")),
    Fault("HED-005", 103, "LPCX reserved", described(f.lpcx_parameters(reserved=b"\0\1"))),
    Fault("EXA-001", TRACK_AT + f.HEADER, "LPCX with a contract", judged(f.closed(
        HEAD, ("TRAK", exact_track(tlvs=f.tlv(16, f.deadband()))), DATA))),
    Fault("EXA-001", TRACK_AT + f.HEADER, "LPCX with a deviation", judged(f.closed(
        HEAD, ("TRAK", exact_track(tlvs=f.tlv(18, f.deviation(1, 1)))), DATA))),
    Fault("EXA-002", 100, "rule 5", described(f.lpcx_parameters(5))),
    Fault("EXA-002", 100, "rule 4 without terms", described(
        f.lpcx_parameters(4, 0, bytes(2), [0.0]))),
    Fault("EXA-002", 100, "terms of rule 0", described(
        f.lpcx_parameters(terms=[(0, 1, 1.0)]))),
    Fault("COD-002", 100, "a term is missing", described(
        f.lpcx_parameters(4, 0, b"\1\0", [0.0]))),
    Fault("EXA-002", 104, "a weight of 2^900", described(
        f.lpcx_parameters(4, 0, bytes(2), [0.0], [(0, 1, 2.0**900)]))),
    Fault("EXA-002", 100, "linear in its own tick", described(
        f.lpcx_parameters(4, 0, bytes(2), [0.0], [(0, 0, 1.0)]))),
    Fault("EXA-003", 108, "parts past the packet", lambda: decode_parts(FIVES + b"\2\0", AT)),
    Fault("COD-002", 100, "no coefficients", described(f.lpcx_parameters(3))),
    Fault("EXA-002", 104, "a coefficient of 2^900", described(
        f.lpcx_parameters(3, 0, bytes(2), (0, 1, 0, 2.0**900)))),
    Fault("EXA-002", 104, "a coefficient that is no number", described(
        f.lpcx_parameters(3, 0, bytes(2), (float("nan"), 1, 0, 0)))),
    Fault("EXA-002", 100, "digits of a quotient", described(f.lpcx_parameters(0, 1))),
    Fault("EXA-002", 100, "no significant digit", described(f.lpcx_parameters(2, 0))),
    Fault("EXA-002", 100, "16 decimals", described(f.lpcx_parameters(2, 32))),
    Fault("EXA-003", 100, "counts past the packet", counts(FIVE[:-1])),
    Fault("EXA-003", DATA_AT - 1 + f.HEADER + 15, "an exact count outside its range", judged(f.file(
        HEAD, ("TRAK", exact_track()),
        ("DATA", f.cluster((0, 0, 1, b"\4\x10\0" + f.svarint(101))))))),
    Fault("CNV-002", 100, "no counts", counts(b"")),
    Fault("EXA-003", 104, "flags alone", beside(b"\0")),
    Fault("EXA-003", 104, "flag bit 2 of corrections", beside(b"\4\0\0")),
    Fault("EXA-003", 104, "shift 64", beside(b"\0\x40\0")),
    Fault("RNG-001", 113, "a coded byte too much", beside(corrected(0) + b"\0")),
    Fault("RNG-001", 109, "no corrections", beside(b"\0\0\0\1\1")),
    Fault("RNG-004", 104, "no table of lengths", beside(b"\0\0")),
    Fault("RNG-004", 104, "33 ranks", beside(b"\1\0\x21" + b"\1" * 40)),
    Fault("RNG-001", 113, "raw bits cut short", beside(corrected(60)[:-1])),
    # 9.10
    Fault("COD-002", 100, "NOIS cut short", noisy(b"\3")),
    Fault("COD-002", 102, "NOIS too long", noisy(f.nois_parameters() + b"\0")),
    Fault("NOI-001", TRACK_AT + f.HEADER, "NOIS with a contract", judged(f.closed(
        HEAD, ("TRAK", f.trak(f.tlv(1, f.nois_parameters()) + f.tlv(16, f.deadband()),
                              codec=b"NOIS")),
        ("DATA", f.cluster((0, 0, 4, b"")))))),
    Fault("NOI-003", 100, "intervals of 4 ticks", noisy(b"\2\xff")),
    Fault("NOI-003", 100, "intervals of 8192 ticks", noisy(b"\x0d\1")),
    Fault("NOI-003", 100, "blocks of 56 ticks", noisy(b"\3\7")),
    Fault("LPC-001", 100, "a model larger than the packet", noise(b"\1", count=2)),
    Fault("NOI-005", 100, "a filter of order 33", noise(b"\x21" + NOISE[1:])),
    Fault("NOI-005", 100, "a model cut short", noise(NOISE[:10])),
    Fault("NOI-006", 106, "a first gain of 113", noise(NOISE[:6] + b"\x71" + NOISE[7:])),
    Fault("NOI-006", 113, "a gain of 113", noise(page_noise.encode([112, 113], [], 8), 16)),
    Fault("NOI-006", 113, "a gain of -1", noise(page_noise.encode([0, -1], [], 8), 16)),
    Fault("NOI-006", 115, "a coefficient of 128", noise(page_noise.encode([40], [[128]], 8), 8)),
    Fault("RNG-004", 107, "bit 5 of a coding", noise(NOISE[:7] + b"\x20" + NOISE[8:])),
    Fault("RNG-004", 107, "four states twice", noise(NOISE[:9] + b"\x10" + NOISE[10:])),
    Fault("RNG-004", 107, "a start byte of 164", noise(NOISE[:8] + b"\xa4" + NOISE[9:])),
    Fault("RNG-001", 119, "a byte behind the noise", noise(NOISE + b"\0")),
    Fault("RNG-001", 109, "no coded bytes", noise(page_noise.encode([40], [], 8)[:9], 8)),
    Fault("CNV-002", 102, "no base", predicted(b"\0\0")),
    Fault("COD-001", 103, "bytes after a constant", predicted(b"\x10\0\0\0")),
    # 9.6
    Fault("CNV-002", 100, "no first index", further(b"")),
    Fault("LPC-003", 100, "first index 2^24 + 1", further(f.svarint(2**24 + 1))),
    Fault("KTE-004", 101, "no knot follows", further(b"\0\0")),
    Fault("KTE-004", 101, "as many follow as there are ticks", further(b"\0\2")),
    Fault("RNG-001", 102, "no coded knots", further(b"\0\1")),
    Fault("KTE-004", 106, "a knot at tick 2 of 2",
          further(page.encode_knots([(0, [0]), (2, [1])], False))),
    Fault("LPC-003", 108, "index 2^24 + 1",
          further(page.encode_knots([(0, [0]), (1, [2**24 + 1])], False))),
    Fault("RNG-001", 106, "a byte after the knots",
          further(page.encode_knots([(0, [0]), (1, [1])], False) + b"\0")),
    # 11.6
    Fault("CNV-002", 100, "no track", clock(b"")),
    Fault("CLK-001", 101, "no name", clock(b"\0")),
    Fault("CLK-001", 101, "an empty name", clock(f.clock([(0, 0, 0)], ""))),
    Fault("CLK-001", 101, "a name past its chunk", clock(b"\0\2a")),
    Fault("CLK-001", 106, "a time cut short", clock(f.clock([(0, 0, 0)])[:12])),
    Fault("CLK-001", 115, "a byte after the observations", clock(f.clock([(0, 0, 0)]) + b"\0")),
    Fault("CNV-002", 115, "an observation too few", clock(f.clock([(0, 0, 0)], count=2))),
    Fault("CNV-004", 102, "a name that is not UTF-8", clock(b"\0\1\xff\1")),
    Fault("CLK-001", 104, "no observation", clock(f.clock([]))),
    Fault("CLK-001", 104, "one point", mapped(f.clock_map([(0, 0)]))),
    Fault("CLK-003", 105, "tick -2^52", clock(f.clock([(-(2**52), 0, 0)]))),
    Fault("CLK-003", 115, "time 2^63", clock(f.clock([(0, 2**63 - 1, 0), (1, 2**63, 0)]))),
    Fault("CLK-003", 105, "point at -2^52", mapped(f.clock_map([(-(2**52), 0)], count=2))),
    Fault("CLK-003", 114, "point at 2^63", mapped(f.clock_map([(0, 2**63 - 1), (1, 2**63)]))),
    Fault("CLK-003", 114, "a tick twice", mapped(f.clock_map([(0, 0), (0, 1)]))),
    Fault("CLK-003", 114, "a time twice", mapped(f.clock_map([(0, 0), (1, 0)]))),
    Fault("CLK-001", 116, "a byte after the points",
          mapped(f.clock_map([(0, 0), (1, 1)]) + b"\0")),
    Fault("CLK-005", END, "a clock on no track", judged(
        f.minimal(("cLOk", f.clock([(0, 0, 0)], track=9))))),
    Fault("CLK-005", END + f.HEADER + len(f.layer(first=1)), "a map of events", judged(
        f.minimal(("TRAK", f.layer(first=1)),
                  ("cMAp", f.clock_map([(0, 0), (1, 1)], track=1))))),
    # 9.9
    Fault("EVT-001", 100, "no event", events(b"")),
    Fault("EVT-001", 100 + 4 * 65536, "65537 events", events(f.event(0) * 65537)),
    Fault("EVT-001", 104, "text cut short", events(f.event(0, "a", size=2))),
    Fault("CNV-002", 103, "event cut short", events(f.event(0)[:3])),
    Fault("EVT-001", 100, "tick 4 of 4", events(f.event(4))),
    Fault("EVT-001", 104, "tick 2 + 2 of 4", events(f.event(2) + f.event(2))),
    Fault("EVT-001", 100, "end 2^48 + 1", events(f.event(1, duration=2**48))),
    Fault("EVT-003", 100, "channel 65535", events(f.event(0, channel=65536))),
    Fault("EVT-003", 100, "65536 bytes", events(f.event(0, "a" * 65536))),
    Fault("EVT-003", END + 2 * f.HEADER + len(f.layer(first=1)) + 15, "channel 1 of one", judged(
        f.minimal(("TRAK", f.layer(first=1)),
                  ("DATA", f.cluster((1, 0, 1, f.event(0, channel=2))))))),
    Fault("CNV-004", 104, "an event that is not UTF-8", events(f.event(0, b"\xff"))),
    Fault("CNV-004", 104, "an event with U+0000", events(f.event(0, "\0"))),
    # clauses 14 and 12
    Fault("LIM-003", None, "one sample allowed",
          lambda: Reader(f.minimal(), limits=Limits(samples=1)).read()),
    Fault("LIM-003", None, "no event allowed",
          lambda: Reader(MARKED, limits=Limits(events=0)).events()),
    Fault("LIM-003", None, "one in a packet",
          lambda: Reader(f.minimal(), limits=Limits(packet_samples=1)).read()),
    Fault("LIM-003", None, "one sample of work",
          lambda: Reader(f.minimal(), limits=Limits(work_samples=1)).read()),
    Fault("LIM-003", None, "four chunks", judged(f.minimal(), Limits(records=4))),
    Fault("LIM-003", None, "two entries of an index",
          lambda: Reader(f.minimal(), limits=Limits(records=2))),
    Fault("LIM-003", None, "no component", judged(f.minimal(), Limits(components=0))),
    Fault("LIM-003", END + f.HEADER, "one byte of metadata",
          judged(f.minimal(("mETa", b"{}")), Limits(metadata=1))),
    Fault("LIM-003", END + f.HEADER, "no byte attached", lambda: Reader(
        f.minimal(("aTTc", b"\1a\0b")), limits=Limits(attachments=0)).read()),
    Fault("LIM-003", None, "two findings", judged(
        f.SIGNATURE + f.chunk("HEAD", f.head(), 0) + f.chunk("mETa", b"", 5, crc=1),
        Limits(records=2))),
]  # fmt: skip
