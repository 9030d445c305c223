"""SPEC 6.3: series, and what their lists say of each track."""

from __future__ import annotations

from collections.abc import Iterator

import broken
import forge as f
from broken import DATA, FIVES, HEAD, described, series
from case import Case

KEPT = [FIVES]
UNKNOWN_TRACK = ("TRK-001", "DAT-008")


def with_hf(base: bytes = f.trak(kind=1), **fields: object) -> bytes:
    """Track 0, and an HF track 1."""
    return series((base, 0), (f.trak(**({"kind": 2, "base": 0} | fields)), 1))


def words(tlvs: bytes = b"", **fields: object) -> bytes:
    """Four int64 of 0."""
    given = {"codec": b"RAWB", "number_format": 1, "count_min": 0, "count_max": 0} | fields
    return described(f.tlv(1, f.raw_parameters(8)) + tlvs, packet=bytes(33), **given)


SERIES = [
    ("track-after-its-packets", UNKNOWN_TRACK, "TRAK stands behind the packets of its track.",
     f.closed(HEAD, DATA, f.TRACK_0)),
    ("no-track", "TRK-002", "A series has no track.",
     series((f.trak(), 0), (f.trak(track_count=0, first_channel=1), 1))),
    ("no-component", "TRK-002", "A track has no component.",
     series((f.trak(), 0), (f.trak(component_count=0, first_channel=1), 1))),
    ("rate-numerator-0", "TRK-002", "A rate is 0 / 1.",
     series((f.trak(), 0), (f.trak(rate_num=0, first_channel=1), 1))),
    ("rate-denominator-0", "TRK-002", "A rate is 1000 / 0.",
     series((f.trak(), 0), (f.trak(rate_den=0, first_channel=1), 1))),
    ("components-256", "TRK-002", "Sixteen tracks have sixteen components each.",
     series((f.trak(), 0), (f.trak(track_count=16, component_count=16, first_channel=1), 1))),
    ("track-65534", "TRK-003", "A track has the id 65534.",
     series((f.trak(), 0), (f.trak(first_channel=1), 65534))),
    ("track-described-twice", "TRK-003", "A TRAK chunk is repeated with another range.",
     series((f.trak(), 0), (f.trak(count_max=101), 0)), KEPT),
    ("range-upside-down", "TRK-005", "The lowest count is above the highest.",
     series((f.trak(), 0), (f.trak(count_min=1, count_max=0, first_channel=1), 1))),
    ("range-25-bits-below", "TRK-005", "At level 1 count_min is -2^23 - 1.",
     described(count_min=-(2**23) - 1), KEPT),
    ("range-25-bits-above", "TRK-005", "At level 1 count_max is 2^23.",
     described(count_max=2**23), KEPT),
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
    ("hf-without-base", "TRK-007", "An HF track has the base 0xFFFF.",
     series((f.trak(), 0), (f.trak(kind=2, first_channel=1), 1))),
    ("hf-base-unknown", "TRK-007", "The base of an HF track is not described.",
     series((f.trak(), 0), (f.trak(kind=2, base=9, first_channel=1), 1))),
    ("hf-before-its-base", "TRK-007", "An HF track stands before its base.",
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
    ("full-band-with-base", "TRK-008", "A full-band track names a base.",
     series((f.trak(), 0), (f.trak(base=0, first_channel=1), 1))),
    ("events-with-base", "TRK-008", "A layer names a base.",
     series((f.trak(), 0), (f.layer(base=0), 1)), KEPT),
    *[(f"hf-with-{name}", "TRK-009", f"An HF track carries a TLV of type {type_}.",
       with_hf(tlvs=f.HOLD + f.tlv(type_, value)))
      for type_, name, value in [
          (2, "label", f.strings("a")), (3, "calibration", f.calibration(2)),
          (10, "group", f.strings("a")), (18, "deviation", f.deviation(1, 1))]],
    ("channel-65535", "TRK-010", "A component has the channel number 65535.",
     described(first_channel=65535)),
    ("channel-taken", "TRK-010", "Two tracks have the same channel number.",
     series((f.trak(), 0), (f.trak(), 1))),
    ("channels-with-a-hole", "TRK-010", "The only channel of a closed file is number 1.",
     described(first_channel=1)),
    ("lf-alone", "TRK-012", "An LF track of a closed file is the base of none.",
     described(kind=1)),
]  # fmt: skip


def setup(value: bytes, tlvs: bytes = b"", **fields: object) -> bytes:
    return described(tlvs + f.tlv(5, value), **fields)


PLAIN = f.knot_parameters()
LISTS = [
    ("setups-of-no-codec", "TRK-013", "Setups name no codec.", setup(b"\0")),
    ("setups-of-more-codecs-than-tracks", "TRK-013", "Setups of one track name two codecs.",
     setup(f.setups([(b"KNOT", [PLAIN]), (b"LPCR", [f.lpcr_parameters()])], [0]))),
    ("setups-codec-without", "TRK-013", "A codec of the setups has no setup.",
     setup(f.setups([(b"KNOT", [PLAIN]), (b"LPCR", [])], [0, 0]), track_count=2)),
    ("setups-more-than-tracks", "TRK-013", "There are two setups for one track.",
     setup(f.setups([(b"KNOT", [PLAIN, f.knot_parameters(1)])], [0]))),
    ("setups-place-of-none", "TRK-013", "A track has setup 1 of one.",
     setup(f.setups([(b"KNOT", [PLAIN])], [0, 1]), track_count=2)),
    ("setups-other-first-codec", "TRK-013", "The codec of the first setup is not that of TRAK.",
     setup(f.setups([(b"LPCR", [f.lpcr_parameters()])], [0]))),
    ("setups-beside-parameters", "TRK-013", "TLV 1 stands beside setups.",
     setup(f.setups([(b"KNOT", [PLAIN])], [0]), f.HOLD)),
    ("setups-place-missing", ("TRK-013", "CNV-002", "TLV-007"), "Two tracks have one place.",
     setup(f.setups([(b"KNOT", [PLAIN])], [0]), track_count=2)),
    ("setups-and-a-byte", "TLV-007", "A byte follows the setups.",
     setup(f.setups([(b"KNOT", [PLAIN])], [0]) + b"\0")),
    ("setups-codec-cut-short", ("TLV-007", "TLV-002"), "Setups end within the name of a codec.",
     setup(b"\1KNO")),
    ("setups-parameters-cut-short", ("TLV-007", "TLV-002"), "Setups end within parameters.",
     setup(b"\1KNOT\1\2\0")),
    ("ranges-code-32", "TRK-014", "A range has the code 32.",
     described(f.HOLD + f.tlv(7, b"\x20"))),
    ("ranges-code-254", "TRK-014", "A range has the code 254.",
     described(f.HOLD + f.tlv(7, b"\xFE"))),
    ("ranges-narrower", "TRK-014", "TRAK has a higher count_max than all ranges.",
     described(f.HOLD + f.tlv(7, b"\7\6"), track_count=2, count_min=0, count_max=128)),
    ("ranges-wider", "TRK-014", "TRAK has a higher count_min than a range.",
     described(f.HOLD + f.tlv(7, b"\7\x43"), track_count=2, count_min=-7, count_max=127)),
    ("ranges-one-for-two", ("TLV-004", "TRK-014", "TLV-007", "CNV-002"),
     "Two tracks have one range.",
     described(f.HOLD + f.tlv(7, b"\7"), track_count=2, count_min=0, count_max=127)),
    ("ranges-25-bits", "TRK-005", "At level 1 a range listed is 0 to 2^24 - 1.",
     described(f.HOLD + f.tlv(7, b"\x18"), count_min=0, count_max=2**24 - 1)),
    ("ranges-33-bits", ("TRK-005", "TRK-014"), "A range listed spans 2^32 + 1 counts from -1 on.",
     described(f.HOLD + f.tlv(7, b"\xFF" + f.svarint(-1) + f.varint(2**32)), count_min=-1,
               count_max=2**31 - 1, level=2)),
    ("channels-other-first", "TRK-015", "The first channel listed is not that of TRAK.",
     described(f.HOLD + f.tlv(9, b"\1\0"), track_count=2)),
    ("channels-one-for-two", ("TLV-004", "TRK-015", "TLV-007", "CNV-002"),
     "Two tracks list one channel.", described(f.HOLD + f.tlv(9, b"\0"), track_count=2)),
    ("channels-two-for-one", ("TLV-007", "TRK-015", "TLV-004"), "One track lists two channels.",
     described(f.HOLD + f.tlv(9, b"\0\1"))),
    ("channels-listed-twice", "TRK-010", "Two tracks list the same channel.",
     described(f.HOLD + f.tlv(9, b"\0\0"), track_count=2)),
    ("channels-65534-and-65535", "TRK-010", "A track of two components lists channel 65534.",
     described(f.HOLD + f.tlv(9, b"\0" + f.varint(65534)), track_count=2, component_count=2,
               packet=b"\x0A\x0A")),
]  # fmt: skip


def continuing(base: bytes = f.trak(), place: bytes = b"\1", tlvs: bytes = b"",
               **fields: object) -> bytes:  # fmt: skip
    """Track 1 continues track 0."""
    return series((base, 0), (f.trak(f.HOLD + tlvs + f.tlv(11, place), **fields), 1))


def split(*clusters: bytes, more: tuple = ()) -> bytes:
    """Tracks 0 and 1, one channel, that end at tick 8."""
    rows = [("DATA", cluster) for cluster in clusters]
    second = f.trak(f.HOLD + f.tlv(11, b"\1"))
    tracks = [("TRAK", f.trak(), {"track": 0}), ("TRAK", second, {"track": 1})]
    return f.closed(HEAD, *(more or tracks), *rows, duration_ns=8_000_000)


def bands() -> list:
    """LF and HF tracks 0 and 1, and 2 and 3, which continue them."""
    lf = f.trak(f.HOLD + f.tlv(11, b"\1"), kind=1)
    return [
        ("TRAK", f.trak(kind=1), {"track": 0}),
        ("TRAK", f.trak(kind=2, base=0), {"track": 1}),
        ("TRAK", lf, {"track": 2}),
        ("TRAK", f.trak(kind=2, base=2), {"track": 3}),
    ]


def at(*packets: tuple[int, int, int]) -> bytes:
    """DATA of constants: (track, start, span)."""
    return f.cluster(*[(*packet, f.KNOT_DATA) for packet in packets])


CONTINUED = [
    ("continues-an-unknown-track", "TRK-016", "A track continues track 8, which is not described.",
     continuing(place=b"\x09", first_channel=1)),
    ("continues-itself", "TRK-016", "A track continues itself.",
     continuing(place=b"\2", first_channel=1)),
    ("continues-a-later-track", "TRK-016", "A track continues one of a greater id.",
     described(f.HOLD + f.tlv(9, b"\0\0") + f.tlv(11, b"\2\0"), track_count=2)),
    ("continued-twice", "TRK-016", "Two tracks continue the same one.",
     series((f.trak(), 0), (f.trak(f.HOLD + f.tlv(11, b"\1")), 1),
            (f.trak(f.HOLD + f.tlv(11, b"\1")), 2))),
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
            (f.trak(f.HOLD + f.tlv(11, b"\2"), first_channel=1), 2))),
    ("continues-as-hf", "TRK-016", "An HF track continues another.",
     series((f.trak(kind=1), 0), (f.trak(kind=2, base=0), 1),
            (f.trak(f.HOLD + f.tlv(11, b"\2"), kind=2, base=0), 2))),
    ("continued-list-one-for-two", ("TLV-004", "TLV-007", "CNV-002"),
     "Two tracks list one that is continued.",
     described(f.HOLD + f.tlv(11, b"\0"), track_count=2)),
    ("continues-too-early", "TRK-017", "A packet starts within one of the track it continues.",
     split(at((0, 0, 6)), at((1, 5, 3)))),
    ("continues-earlier-in-time", "TRK-017", "The continued track has the later ticks.",
     split(at((0, 4, 4)), at((1, 0, 4)))),
    ("continues-earlier-in-the-file", "TRK-017", "Packets of the continued track stand behind.",
     split(at((1, 4, 4)), at((0, 0, 4)))),
    ("continues-earlier-in-hf", "TRK-017", "Only the HF packets come in the wrong order.",
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
          (1, "parameters", b""), (4, "unit", f.strings("N")), (11, "continued-list", b"\0")]],
]  # fmt: skip


def cases() -> Iterator[Case]:
    yield from broken.cases("structure/layout", [r for r in SERIES if r[1] in LAYOUT])
    yield from broken.cases("semantics/reference", [r for r in SERIES if r[1] not in LAYOUT])
    yield from broken.cases("structure/list", LISTS)
    yield from broken.cases("semantics/reference", CONTINUED)
    yield from broken.cases("semantics/layer", LAYERS)


LAYOUT = {"TRK-002", "TRK-003", "TRK-005", "TRK-006", "TRK-009"}
