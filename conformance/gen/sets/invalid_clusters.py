"""SPEC 6.4, 8, 11.1 and 11.2: clusters, index and footer, calibrations and contracts."""

from __future__ import annotations

from collections.abc import Iterator

import broken
import forge as f
from broken import DATA, DATA_AT, END, FIVES, HEAD, TRACK, TRACK_AT, described, lasting, series
from case import Case

KEPT = [FIVES]
LATE = f.LATE_MS
RIGHT = (("HEAD", 8, 0, 0), ("TRAK", TRACK_AT, 0, 0), ("DATA", DATA_AT, 0, LATE))


def clusters(*payloads: bytes, span: int = 4, tracks: int = 1) -> bytes:
    """Clusters of ``tracks`` tracks that last ``span`` ticks."""
    described = ("TRAK", f.trak(track_count=tracks))
    listed, at = list(RIGHT[:2]), TRACK_AT + f.HEADER + len(described[1])
    for payload in payloads:
        listed.append(("DATA", at, 0, max(LATE, span)))
        at += f.HEADER + len(payload)
    rows = [("DATA", payload) for payload in payloads]
    ahead = {"entries": listed}
    return f.closed(HEAD, described, *rows, ahead=ahead, duration_ns=lasting(span))


def held(*packets: tuple[int, int, int]) -> bytes:
    """A cluster of constants: (track, start, span)."""
    return f.cluster(*[(*packet, f.KNOT_DATA) for packet in packets])


ONE = (0, 0, 4, f.KNOT_DATA)
CLUSTERS = [
    ("no-packet", "DAT-001", "A cluster has no packet.",
     clusters(held((0, 0, 4)), b"\0"), KEPT),
    ("packets-of-tracks-unordered", "DAT-002", "A packet of track 1 is before one of track 0.",
     clusters(held((1, 0, 4), (0, 0, 4)), tracks=2)),
    ("packets-unordered", "DAT-002", "The later packet of a track is first.",
     clusters(held((0, 4, 4), (0, 0, 4)), span=8)),
    ("packets-at-one-tick", ("DAT-002", "DAT-006"), "Two packets of a track start at one tick.",
     clusters(held((0, 0, 4), (0, 0, 4)))),
    ("packet-of-no-tick", "DAT-003", "A packet has the span 0.",
     clusters(held((0, 0, 4), (0, 4, 0))), KEPT),
    ("packet-past-2-to-48", "DAT-003", "A packet ends at tick 2^48 + 1.",
     clusters(held((0, 0, 4), (0, 2**48 - 3, 4)), span=2**48 + 1)),
    ("packet-crc-differs", "DAT-004", "The CRC of a packet differs, that of its chunk is right.",
     clusters(f.cluster(ONE, crcs={0: 0})), None, 2),
    ("packet-crc-of-the-bytes-alone", "DAT-004", "The CRC of a packet leaves out its row.",
     clusters(f.cluster(ONE, crcs={0: f.cluster_crc(f.KNOT_DATA)})), None, 2),
    ("packet-crc-of-another-count", "DAT-004", "The CRC of a packet is that of one of two.",
     clusters(f.cluster(ONE, crcs={0: f.packet_crc(2, *ONE)})), None, 2),
    ("packet-crc-of-another-chunk", "DAT-004", "The CRC of a packet is that of one in chunk 3.",
     clusters(f.cluster(ONE, crcs={0: f.packet_crc(1, *ONE, sequence=3)})), None, 2),
    ("table-crc-differs", "DAT-011", "The CRC of a table differs, that of its chunk is right.",
     clusters(f.cluster(ONE, crc=0)), None, 2),
    ("table-crc-of-another-chunk", "DAT-011", "The CRC of a table is that of chunk 3.",
     clusters(f.table([(0, 1, 0, 4, f.packet_crc(1, *ONE))], sequence=3) + f.KNOT_DATA), None, 2),
    ("row-fields-of-7-bytes", "DAT-001", "The start ticks of a table have seven bytes.",
     clusters(f.cluster(ONE, widths=(0, 0, 7, 0)))),
    ("packets-and-a-byte", "DAT-005", "A byte follows the last packet.",
     clusters(held((0, 0, 4)) + b"\0"), KEPT),
    ("packet-past-the-payload", "DAT-005", "A packet has a byte more than is left.",
     clusters(f.table([(0, 2, 0, 4, f.packet_crc(1, *ONE))]) + f.KNOT_DATA)),
    ("packet-count-too-large", ("DAT-005", "DAT-011"), "A table of one packet announces two.",
     clusters(f.cluster(ONE, count=2))),
    ("table-cut-short", ("DAT-005", "DAT-011"), "A cluster ends within its table.",
     clusters(bytes(f.cluster(ONE))[:-2])),
    ("cluster-of-no-bytes", ("CNV-002", "DAT-001", "DAT-005"), "A cluster has no bytes.",
     clusters(held((0, 0, 4)), b""), KEPT),
    ("packets-overlap", "DAT-006", "Two packets of a cluster share a tick.",
     clusters(held((0, 0, 4), (0, 3, 4)), span=7)),
    ("clusters-overlap", "DAT-006", "The packet of the next cluster shares a tick.",
     clusters(held((0, 0, 4)), held((0, 3, 4)), span=7)),
    ("clusters-in-reverse", "DAT-006", "The later cluster is first.",
     clusters(held((0, 4, 4)), held((0, 0, 4)), span=8)),
    ("packet-of-an-unknown-track", "DAT-008", "A packet belongs to track 9, which is unknown.",
     clusters(held((0, 0, 4), (9, 0, 4))), KEPT),
    ("packet-of-track-65536", ("DAT-008", "TRK-003"), "A packet belongs to track 65536.",
     clusters(held((0, 0, 4), (65536, 0, 4))), KEPT),
    ("cluster-of-too-many-samples", "DAT-009",
     "At level 1 a packet of two components has 2^22 + 2 samples.",
     described(component_count=2, packet=b"\x0A\x0A", span=2**21 + 1)),
    ("cluster-of-too-many-samples-in-two", "DAT-009",
     "At level 1 two packets have 2^22 + 1 samples together.",
     clusters(held((0, 0, 2**21), (0, 2**21, 2**21 + 1)), span=2**22 + 1)),
]  # fmt: skip


def listing(*entries: tuple, count: int | None = None, first: int = 0, previous: int = 0,
            more: bytes = b"", cut: int = 0) -> bytes:  # fmt: skip
    """HEAD, TRACK, DATA, an index with these entries, the footer."""
    payload = f.index(entries, count=count, first=first, previous=previous) + more
    payload = payload[: len(payload) - cut]
    body = f.file(HEAD, TRACK, DATA) + f.chunk("iNDX", payload, 3)
    return body + f.chunk("fOOT", f.foot(f.HEADER + len(payload), f.DURATION_NS), 4)


def second_index(*entries: tuple, previous: int = END, first: int = 3) -> bytes:
    """A second index; of the first, the entries are right."""
    body = f.file(HEAD, TRACK, DATA) + f.chunk("iNDX", f.index(RIGHT), 3)
    index = f.chunk("iNDX", f.index(entries, previous=previous, first=first), 4)
    return body + index + f.chunk("fOOT", f.foot(len(index), f.DURATION_NS), 5)


INDEXES = [
    ("index-cut-short", "IDX-002", "An index ends within its layout.",
     listing(count=0, cut=1), KEPT),
    ("index-entries-missing", ("IDX-002", "CNV-002"), "An index of three entries announces four.",
     listing(*RIGHT, count=4), KEPT),
    ("index-entries-more", "IDX-002", "An index of three entries announces two.",
     listing(*RIGHT, count=2), KEPT),
    ("index-and-a-byte", "IDX-002", "A byte follows the last entry.",
     listing(*RIGHT, more=b"\0"), KEPT),
    ("index-without-times", ("CNV-002", "IDX-002"), "The entry of DATA ends without its times.",
     listing(*RIGHT, cut=len(f.varint(LATE)) + 1), KEPT),
    ("index-distance-not-minimal", "CNV-002", "A distance of 8 is stored as 88 00.",
     listing(count=3, more=b"HEAD\x88\0" + f.index(RIGHT)[21:]), KEPT),
    ("index-without-a-chunk", "IDX-002", "TRAK is not listed.",
     listing(RIGHT[0], RIGHT[2])),
    ("index-without-data", "IDX-002", "DATA is not listed.", listing(*RIGHT[:2])),
    ("index-other-type", ("IDX-002", "IDX-003"), "TRAK is listed as mETa.",
     listing(RIGHT[0], ("mETa", TRACK_AT, 0, 0), RIGHT[2]), KEPT, None, "IDX-003"),
    ("index-other-offset", ("IDX-002", "IDX-003"), "TRAK is listed a byte too far on.",
     listing(RIGHT[0], ("TRAK", TRACK_AT + 1, 0, 0), RIGHT[2]), KEPT, None, "IDX-003"),
    ("index-chunk-twice", "IDX-002", "TRAK is listed twice.",
     listing(*RIGHT[:2], *RIGHT[1:]), KEPT),
    ("index-previous-0", "IDX-002", "An index lists a part, and names no index before it.",
     listing(RIGHT[2], first=2), KEPT),
    ("index-previous-is-data", "IDX-002", "The index before is a DATA chunk.",
     second_index(RIGHT[2], ("iNDX", END, 0, 0), previous=DATA_AT, first=2), KEPT),
    ("index-previous-is-itself", "IDX-002", "An index names itself as the one before.",
     second_index(previous=END + f.HEADER + len(f.index(RIGHT))), KEPT),
    ("index-without-the-index-before", "IDX-002", "The index before is not listed.",
     second_index(), KEPT),
    ("index-counts-from-1", "IDX-002", "An index of all chunks counts them from 1 on.",
     listing(*RIGHT, first=1), KEPT),
    ("index-starts-too-late", "IDX-002", "An index says that DATA starts at 1 ms, not at 0.",
     listing(*RIGHT[:2], ("DATA", DATA_AT, 1, LATE)), KEPT),
    ("index-stops-too-early", "IDX-002", "An index says that DATA ends at 3 ms, not at 4.",
     listing(*RIGHT[:2], ("DATA", DATA_AT, 0, 3)), KEPT),
]  # fmt: skip


def footer(payload: bytes) -> bytes:
    """The usual file with another footer."""
    whole = f.minimal()
    return whole[: -f.FOOT] + f.chunk("fOOT", payload, 4)


AHEAD = {"entries": [("iNDX", END, 0, 0)], "previous": END, "first": 3}
SECOND = f.index(**AHEAD)
INDEX = f.HEADER + len(f.index(RIGHT))
"""Bytes of the index of the usual file."""
FOOT = f.foot(INDEX, f.DURATION_NS)
FOOTERS = [
    ("footer-11-bytes", "FOT-001", "The footer lacks a byte.", footer(FOOT[:-1]), KEPT),
    ("footer-13-bytes", "FOT-001", "A byte follows the layout of the footer.",
     footer(FOOT + b"\0"), KEPT),
    ("footer-of-no-bytes", "FOT-001", "The footer has no bytes.", footer(b""), KEPT),
    ("footer-a-byte-before-the-index", "FOT-002", "The distance of the index is a byte too far.",
     f.minimal(index_distance=INDEX + 1), KEPT),
    ("footer-of-head", "FOT-002", "The footer names HEAD as the index.",
     f.minimal(index_distance=END - 8 + INDEX), KEPT),
    ("footer-before-the-file", "FOT-002", "The footer names an index before the file.",
     f.minimal(index_distance=2**32 - 1), KEPT),
    ("footer-of-the-first-index", "FOT-002", "The footer names the first of two indexes.",
     f.closed(HEAD, TRACK, DATA, ("iNDX", f.index(RIGHT)),
              index_distance=INDEX + f.HEADER + len(SECOND), ahead=AHEAD), KEPT),
    ("footer-of-no-index", "FOT-002", "The footer says that there is no index, and there is one.",
     f.minimal(index_distance=0), KEPT),
    ("footer-without-index", "FOT-002", "The footer names an index, and there is none.",
     f.minimal(indexed=False, index_distance=END - DATA_AT), KEPT),
    ("footer-without-index-other-duration", "FOT-002",
     "In a file without an index the footer says a nanosecond less.",
     f.minimal(indexed=False, duration_ns=f.DURATION_NS - 1), KEPT),
    ("footer-duration-2-to-63", "FOT-002", "The footer says that the file lasts 2^63 ns.",
     f.minimal(duration_ns=2**63), KEPT),
    ("footer-other-duration", "FOT-002", "The footer says a nanosecond less.",
     f.minimal(duration_ns=f.DURATION_NS - 1), KEPT),
    ("footer-duration-rounded-down", "FOT-002", "The footer rounds 4 ticks of 3 Hz down.",
     described(rate_num=3)[:-f.FOOT] + f.chunk("fOOT", f.foot(INDEX, 1_333_333_333), 4),
     KEPT),
]  # fmt: skip


def calibrated(a: int = 1, b: int = 0, d: int = 1, **fields: int) -> bytes:
    return described(f.HOLD + f.tlv(3, f.calibration(a, b, d)), **fields)


def contract(kn: int = 1, kd: int = 10, **given: object) -> bytes:
    return described(f.HOLD + f.tlv(16, f.deadband(kn, kd, **given)))


VALUES = [
    ("calibration-a-0", "VAL-001", "A is 0.", calibrated(0), KEPT),
    ("calibration-d-0", "VAL-001", "D is 0.", calibrated(d=0), KEPT),
    ("calibration-a-too-low", "VAL-001", "A is -2^52.",
     calibrated(-(2**52), count_min=0, count_max=1), KEPT),
    ("calibration-b-too-low", "VAL-001", "B is -2^52.",
     calibrated(b=-(2**52), count_min=0, count_max=1), KEPT),
    ("calibration-d-too-high", ("CNV-002", "VAL-001"), "D is 2^53.", calibrated(d=2**53), KEPT),
    ("calibration-products-too-large", "VAL-001", "100 * A is above 2^53.",
     calibrated(2**53 // 100 + 1), KEPT),
    ("calibration-products-too-low", "VAL-001", "-100 * A is below -2^53.",
     calibrated(2**53 // 100 + 1, count_max=99), KEPT),
    ("calibration-sums-too-large", "VAL-001", "2 * A + B is 2^53 + 1.",
     calibrated(2**52 - 1, 3, count_min=0, count_max=2), KEPT),
    ("calibration-products-of-hf", "VAL-001", "For an HF track count * A is above 2^53.",
     series((f.trak(f.HOLD + f.tlv(3, f.calibration(2**46)), kind=1), 0),
            (f.trak(kind=2, base=0, count_max=129), 1))),
    ("deadband-kd-2-to-16", "DBC-001", "The Weber fraction has kd = 2^16.",
     contract(kd=2**16), KEPT),
    ("deadband-kn-2-to-16", "DBC-001", "The Weber fraction has kn = 2^16.",
     contract(2**16, 2**16 - 1), KEPT),
    ("deadband-flag", "DBC-001", "An undefined flag of a contract is set.",
     contract(flags=4), KEPT),
    ("deadband-floor-0", "DBC-001", "A floor is 0.", contract(entries=((0, 0),)), KEPT),
    ("deadband-floor-2-to-32", "DBC-001", "A floor is 2^32.",
     contract(entries=((2**32, 0),)), KEPT),
    ("deadband-zero-too-high", "DBC-001", "The zero of a contract is 2^31.",
     contract(entries=((1, 2**31),)), KEPT),
    ("deadband-cut-short", ("TLV-004", "CNV-002"), "A contract ends before its flags.",
     described(f.HOLD + f.tlv(16, f.deadband()[:2])), KEPT),
    ("deadband-without-floor", ("CNV-002", "TLV-004"), "A contract ends before its floor.",
     described(f.HOLD + f.tlv(16, f.deadband(entries=()))), KEPT),
    ("deadband-of-one-component-for-two", ("CNV-002", "TLV-004"),
     "The contract of two components has one floor.",
     described(f.HOLD + f.tlv(16, f.deadband()), component_count=2, packet=b"\x0A\x0A")),
]  # fmt: skip


def cases() -> Iterator[Case]:
    yield from broken.cases("structure/cluster", CLUSTERS)
    yield from broken.cases("framing/index", INDEXES)
    yield from broken.cases("framing/footer", FOOTERS)
    yield from broken.cases("semantics/value", VALUES)
