"""SPEC 6.3: what TRAK says of tracks."""

from __future__ import annotations

from collections.abc import Iterator

import broken
import deflate
import forge as f
from broken import DATA, FIVES, HEAD, described, series
from case import Case

KEPT = [FIVES]
CUT = ("TLV-001", "CNV-002", "TRK-002")
"""A track that ends too early."""
UNKNOWN_TRACK = ("TRK-001", "DAT-008")


def with_hf(base: bytes = f.trak(kind=1), **fields: object) -> bytes:
    """Track 0, and an HF track 1."""
    return series((base, 0), (f.trak(**({"kind": 2, "base": 0} | fields)), 1))


def words(tlvs: bytes = b"", **fields: object) -> bytes:
    """Four int64 of 0."""
    given = {"codec": b"RAWB", "number_format": 1, "count_min": 0, "count_max": 0} | fields
    return described(f.tlv(1, f.raw_parameters(8)) + tlvs, packet=bytes(33), **given)


DESCRIPTIONS = [
    ("track-after-its-packets", UNKNOWN_TRACK, "TRAK is behind the packets of its track.",
     f.closed(HEAD, DATA, f.TRACK_0)),
    ("no-track", ("TRK-002", "TLV-001"), "TRAK describes no track.",
     series((f.trak(), 0), (f.trak(track_count=0, first_channel=1), 1))),
    ("no-component", "TRK-002", "A track has no component.",
     series((f.trak(), 0), (f.trak(component_count=0, first_channel=1), 1))),
    ("rate-numerator-0", "TRK-002", "A rate is 0 / 1.",
     series((f.trak(), 0), (f.trak(rate_num=0, first_channel=1), 1))),
    ("rate-denominator-0", "TRK-002", "A rate is 1000 / 0.",
     series((f.trak(), 0), (f.trak(rate_den=0, first_channel=1), 1))),
    ("components-256", "TRK-002", "Sixteen tracks have sixteen components each.",
     series((f.trak(), 0), (f.trak(track_count=16, component_count=16, first_channel=1), 1))),
    ("rate-numerator-2-to-32", "TRK-002", "A rate is 2^32 / 1.",
     series((f.trak(), 0), (f.trak(rate_num=2**32, first_channel=1), 1))),
    ("rate-denominator-2-to-32", "TRK-002", "A rate is 1000 / 2^32.",
     series((f.trak(), 0), (f.trak(rate_den=2**32, first_channel=1), 1))),
    *[(f"track-{name}-not-minimal", "CNV-002", f"The number {name} of a track is {told}.",
       series((f.trak(**{field: raw}), 0)))
      for name, field, raw, told in [
          ("rate-num", "rate_num", b"\xe8\x87\0", "E8 87 00"),
          ("rate-den", "rate_den", b"\x81\0", "81 00"),
          ("count-min", "count_min", b"\xc7\x81\0", "C7 81 00"),
          ("count-max", "count_max", b"\xc8\x81\0", "C8 81 00"),
          ("first-channel", "first_channel", b"\x80\0", "80 00"),
          ("linked", "linked", b"\x80\0", "80 00")]],
    ("track-rate-of-nine-bytes", "CNV-002", "The number rate-num of a track has nine bytes.",
     series((f.trak(rate_num=b"\x80" * 8 + b"\1"), 0))),
    ("track-ends-within-a-number", CUT, "A track ends within its range.",
     f.closed(HEAD, ("TRAK", f.trak() + f.track()[:9]), DATA)),
    ("first-track-not-minimal", "CNV-002", "The id of the first track is 80 00.",
     f.closed(HEAD, ("TRAK", b"\x80\0\0" + f.track()), DATA)),
    ("tracks-and-a-byte", CUT, "A byte follows the last track.",
     described(f.HOLD + b"\0", tlv_count=1)),
    ("tlv-that-is-not-there", CUT, "A track has one TLV less than it says.",
     described(tlv_count=2)),
    ("tlv-more-than-told", CUT, "A track has one TLV more than it says.",
     described(tlv_count=0)),
    ("tracks-cut-short", CUT, "The second track ends with its codec.",
     f.closed(HEAD, ("TRAK", f.trak() + f.track()[:5]), DATA)),
    ("track-65534", "TRK-003", "A track has the id 65534.",
     series((f.trak(), 0), (f.trak(first_channel=1), 65534))),
    ("track-65534-of-two", "TRK-003", "The second track of a chunk has the id 65534.",
     series((f.trak(), 0), (f.trak(track_count=2, first_channel=1), 65533))),
    ("track-of-2-to-53", "TRK-003", "A track has the id 2^53 - 1.",
     series((f.trak(), 0), (f.trak(first_channel=1), 2**53 - 1))),
    ("track-described-twice", "TRK-003", "A TRAK chunk is repeated with another range.",
     series((f.trak(), 0), (f.trak(count_max=101), 0)), KEPT),
    ("range-upside-down", "TRK-005", "The lowest count is above the highest.",
     series((f.trak(), 0), (f.trak(count_min=1, count_max=0, first_channel=1), 1))),
    ("range-25-bits-below", "TRK-005", "At level 1 count_min is -2^23 - 1.",
     described(count_min=-(2**23) - 1), KEPT),
    ("range-25-bits-above", "TRK-005", "At level 1 count_max is 2^23.",
     described(count_max=2**23), KEPT),
    ("range-33-bits", "TRK-005", "At level 2 count_max is 2^31.",
     described(count_max=2**31, level=2), KEPT),
    ("range-54-bits", "TRK-005", "At level 2 count_min is -2^52.",
     described(count_min=-(2**52), level=2), KEPT),
    ("range-of-hf-26-bits", "TRK-005", "At level 1 count_max of an HF track is 2^24.",
     with_hf(count_max=2**24)),
    ("words-in-knots", "TRK-006", "A track of int64 has the codec KNOT.",
     described(number_format=1, count_min=0, count_max=0)),
    ("words-with-a-range", "TRK-006", "A track of int64 has the declared range 0 to 1.",
     words(count_max=1)),
    ("words-that-are-lf", "TRK-006", "A track of int64 is of kind LF.",
     series((f.trak(f.tlv(1, f.raw_parameters(8)), codec=b"RAWB", number_format=1, count_min=0,
                    count_max=0, kind=1), 0), (f.trak(kind=2, base=0), 1),
            data=("DATA", f.cluster((0, 0, 4, bytes(33)))))),
    ("words-with-a-calibration", "TRK-006", "A track of int64 has a calibration.",
     words(f.tlv(3, f.calibration(2)))),
    ("words-with-a-deadband", "TRK-006", "A track of int64 has a deadband contract.",
     words(f.tlv(16, f.deadband()))),
    ("hf-without-base", "TRK-007", "An HF track is linked to no track.",
     series((f.trak(), 0), (f.trak(kind=2, first_channel=1), 1))),
    ("hf-base-of-2-to-53", "TRK-007", "The base of an HF track is 2^53 - 2.",
     series((f.trak(), 0), (f.trak(kind=2, base=2**53 - 2, first_channel=1), 1))),
    ("hf-base-unknown", "TRK-007", "The base of an HF track is not described.",
     series((f.trak(), 0), (f.trak(kind=2, base=9, first_channel=1), 1))),
    ("hf-before-its-base", "TRK-007", "An HF track is before its base.",
     series((f.trak(kind=2, base=0), 1), (f.trak(kind=1), 0))),
    ("hf-on-full-band", "TRK-007", "The base of an HF track is of kind full band.",
     with_hf(f.trak())),
    ("hf-on-hf", "TRK-007", "The base of an HF track is of kind HF.",
     series((f.trak(kind=1), 0), (f.trak(kind=2, base=0), 1), (f.trak(kind=2, base=1), 2))),
    ("hf-of-two-components", "TRK-007", "An HF track has more components than its base.",
     with_hf(component_count=2)),
    ("hf-at-another-rate", "TRK-007", "An HF track has twice the rate of its base.",
     with_hf(rate_num=2000)),
    ("hf-of-another-channel", "TRK-007", "An HF track has another first channel than its base.",
     with_hf(first_channel=1)),
    ("hf-twice-on-a-base", "TRK-007", "Two HF tracks have the same base.",
     series((f.trak(kind=1), 0), (f.trak(kind=2, base=0), 1), (f.trak(kind=2, base=0), 2))),
    *[(f"hf-with-{name}", "TRK-009", f"An HF track carries a TLV of type {type_}.",
       with_hf(tlvs=f.HOLD + f.tlv(type_, value)))
      for type_, name, value in [
          (2, "label", f.strings("a")), (3, "calibration", f.calibration(2)),
          (10, "group", f.strings("a")), (18, "deviation", f.deviation(1, 1))]],
    ("channel-65535", "TRK-010", "A component has the channel number 65535.",
     described(first_channel=65535)),
    ("channel-of-2-to-53", "TRK-010", "A component has the channel number 2^53 - 1.",
     described(first_channel=2**53 - 1)),
    ("channel-taken", "TRK-010", "Two tracks have the same channel number.",
     series((f.trak(), 0), (f.trak(), 1))),
    ("channel-given-twice", "TRK-010", "Both components of a track have the channel number 0.",
     described(component_count=2, tlvs=f.HOLD + f.tlv(5, bytes(2)))),
    ("channel-65535-given", "TRK-010", "The second component has the channel number 65535.",
     described(component_count=2, tlvs=f.HOLD + f.tlv(5, b"\xff\xff"))),
    ("channels-too-many", "TLV-004", "Two components have two channel numbers after the first.",
     described(component_count=2, tlvs=f.HOLD + f.tlv(5, b"\1\0\2\0"))),
    ("lf-with-channels", "TRK-009", "An LF track of two components has TLV 5.",
     series((f.trak(f.HOLD + f.tlv(5, b"\1\0"), kind=1, component_count=2), 0),
            (f.trak(kind=2, base=0, component_count=2), 1))),
    ("channels-with-a-hole", "TRK-010", "The only channel of a closed file is number 1.",
     described(first_channel=1)),
    ("lf-alone", "TRK-012", "An LF track of a closed file is the base of none.",
     described(kind=1)),
]  # fmt: skip


def squeezed(size: int | None = None, *, kind: int = 2, cut: int = 0, more: bytes = b"",
             stream: bytes | None = None) -> bytes:  # fmt: skip
    """Track 0 in a DEFLATE stream that is changed so."""
    plain = f.track()
    found = deflate.deflate(plain, kind) if stream is None else stream
    found = found[: len(found) - cut] + more
    payload = b"\0" + f.varint(len(plain) if size is None else size) + found
    return f.closed(HEAD, ("TRAK", payload), DATA)


DEFLATED = [
    ("tracks-no-payload", ("CNV-002", "TLV-001", "TRK-020"), "A TRAK chunk is empty.",
     f.closed(HEAD, ("TRAK", b""), DATA)),
    ("tracks-no-size", ("CNV-002", "TLV-001", "TRK-020"), "A TRAK chunk ends behind first_track.",
     f.closed(HEAD, ("TRAK", b"\0"), DATA)),
    ("tracks-no-stream", "TRK-020", "A DEFLATE stream has no byte.",
     squeezed(stream=b"")),
    ("tracks-more-than-told", "TRK-020", "A DEFLATE stream gives a byte more.",
     squeezed(len(f.track()) - 1)),
    ("tracks-less-than-told", "TRK-020", "A DEFLATE stream gives a byte less.",
     squeezed(len(f.track()) + 1)),
    ("tracks-stream-cut-short", "TRK-020", "A DEFLATE stream lacks its last byte.",
     squeezed(cut=1)),
    ("tracks-stream-and-a-byte", "TRK-020", "A byte follows a DEFLATE stream.",
     squeezed(more=b"\0")),
    ("tracks-stream-block-type-3", "TRK-020", "A DEFLATE stream has a block of type 3.",
     squeezed(stream=b"\7")),
    ("tracks-stream-not-the-last", "TRK-020", "No block of a DEFLATE stream is the last.",
     squeezed(stream=bytes([0]) + deflate.stored(f.track())[1:])),
    ("tracks-stream-too-far-back", "TRK-020", "A DEFLATE stream repeats what is not there.",
     squeezed(stream=deflate.packed(deflate.block([7, (3, 2)], last=True, kind=1)))),
    ("tracks-size-not-minimal", ("CNV-002", "TRK-020"), "The size of the tracks is 80 00.",
     f.closed(HEAD, ("TRAK", b"\0\x80\0" + f.track()), DATA)),
    ("tracks-in-a-stream-broken", "TRK-002", "A track in a DEFLATE stream has no component.",
     f.closed(HEAD, ("TRAK", f.squeezed(f.trak(component_count=0))), DATA)),
]  # fmt: skip


def continuing(base: bytes = f.trak(), tlvs: bytes = b"", **fields: object) -> bytes:
    """Track 1 continues track 0."""
    return series((base, 0), (f.trak(f.HOLD + tlvs, **({"continues": 0} | fields)), 1))


def split(*clusters: bytes, more: tuple = ()) -> bytes:
    """Tracks 0 and 1, one channel, that end at tick 8."""
    rows = [("DATA", cluster) for cluster in clusters]
    tracks = [("TRAK", f.trak()), ("TRAK", f.trak(continues=0, first=1))]
    return f.closed(HEAD, *(more or tracks), *rows, duration_ns=8_000_000)


def bands() -> list:
    """LF and HF tracks 0 and 1, and 2 and 3, which continue them."""
    return [
        ("TRAK", f.trak(kind=1)),
        ("TRAK", f.trak(kind=2, base=0, first=1)),
        ("TRAK", f.trak(continues=0, kind=1, first=2)),
        ("TRAK", f.trak(kind=2, base=2, first=3)),
    ]


def described_by(*records: bytes) -> bytes:
    return series((f.tracks(*records), 0))


def at(*packets: tuple[int, int, int]) -> bytes:
    """DATA of constants: (track, start, span)."""
    return f.cluster(*[(*packet, f.KNOT_DATA) for packet in packets])


CONTINUED = [
    ("continues-an-unknown-track", "TRK-016", "A track continues track 8, which is not described.",
     continuing(continues=8, first_channel=1)),
    ("continues-track-2-to-53", "TRK-016", "A track continues track 2^53 - 2.",
     continuing(continues=2**53 - 2, first_channel=1)),
    ("continues-itself", "TRK-016", "A track continues itself.",
     continuing(continues=1, first_channel=1)),
    ("continues-a-later-track", "TRK-016", "A track continues one of a greater id.",
     described_by(f.track(continues=1), f.track())),
    ("continued-twice", "TRK-016", "Two tracks continue the same one.",
     series((f.trak(), 0), (f.trak(continues=0), 1),
            (f.trak(continues=0), 2))),
    ("continues-at-another-rate", "TRK-016", "A track continues one of another rate.",
     continuing(rate_num=1)),
    ("continues-another-channel", "TRK-016", "A track continues that of another channel.",
     continuing(first_channel=1)),
    ("continues-fewer-components", "TRK-016", "A track continues one of fewer components.",
     continuing(component_count=2)),
    ("continues-another-unit", "TRK-016", "A track in N continues one without a unit.",
     continuing(tlvs=f.tlv(4, f.strings("N")))),
    ("continues-another-calibration", "TRK-016", "A track continues one of another calibration.",
     continuing(tlvs=f.tlv(3, f.calibration(2)))),
    ("continues-words", "TRK-016", "Counts continue words.",
     series((f.trak(), 0),
            (f.trak(f.tlv(1, f.raw_parameters(8)), codec=b"RAWB", number_format=1, count_min=0,
                    count_max=0, first_channel=1), 1),
            (f.trak(continues=1, first_channel=1), 2))),
    ("continues-a-layer", "TRK-016", "A track continues a layer of events.",
     series((f.layer(), 0), (f.trak(continues=0), 1),
            data=("DATA", f.cluster((1, 0, 4, f.KNOT_DATA))))),
    ("continues-too-early", "TRK-016", "A packet starts within one of the track it continues.",
     split(at((0, 0, 6)), at((1, 5, 3)))),
    ("continues-earlier-in-time", "TRK-016", "The continued track has the later ticks.",
     split(at((0, 4, 4)), at((1, 0, 4)))),
    ("continues-earlier-in-the-file", "TRK-016", "Packets of the continued track come later.",
     split(at((1, 4, 4)), at((0, 0, 4)))),
    ("continues-earlier-in-hf", "TRK-016", "Only the HF packets come in the wrong order.",
     split(at((0, 0, 4), (2, 4, 4), (3, 4, 4)), at((1, 0, 4)), more=tuple(bands()))),
]  # fmt: skip

LAYERS = [
    ("events-in-knots", "TRK-019", "A track of kind events has the codec KNOT.",
     series((f.trak(), 0), (f.layer(f.HOLD, codec=b"KNOT"), 1)), KEPT),
    ("events-full-band", "TRK-019", "A full-band track has the codec EVNT.",
     series((f.trak(), 0), (f.trak(b"", codec=b"EVNT", first_channel=1), 1))),
    ("events-with-channel", "TRK-019", "A layer has the first channel 1.",
     series((f.trak(), 0), (f.layer(first_channel=1), 1)), KEPT),
    ("events-with-a-range", "TRK-019", "A layer has the declared range 0 to 1.",
     series((f.trak(), 0), (f.layer(count_max=1), 1)), KEPT),
    ("events-that-are-words", "TRK-019", "A layer has the number format int64.",
     series((f.trak(), 0), (f.layer(number_format=1), 1)), KEPT),
    *[(f"events-with-{name}", "TRK-019", f"A layer carries a TLV of type {type_}.",
       series((f.trak(), 0), (f.layer(f.tlv(type_, value)), 1)), KEPT)
      for type_, name, value in [
          (1, "parameters", b""), (4, "unit", f.strings("N"))]],
    ("events-that-are-linked", "TRK-019", "A layer is linked to track 0.",
     series((f.trak(), 0), (f.layer(base=0), 1)), KEPT),
]  # fmt: skip


def cases() -> Iterator[Case]:
    layout = [row for row in DESCRIPTIONS if LAYOUT & rules(row)]
    yield from broken.cases("structure/layout", layout)
    yield from broken.cases(
        "semantics/reference", [row for row in DESCRIPTIONS if row not in layout]
    )
    yield from broken.cases("structure/layout", DEFLATED)
    yield from broken.cases("semantics/reference", CONTINUED)
    yield from broken.cases("semantics/layer", LAYERS)


LAYOUT = {"TLV-001", "TRK-002", "TRK-003", "TRK-005", "TRK-006", "TRK-009"}


def rules(row: tuple) -> set[str]:
    return {row[1]} if isinstance(row[1], str) else set(row[1])
