"""SPEC 11.3 to 11.6 and 9.9: metadata, attachments, digests, clocks, events."""

from __future__ import annotations

from collections.abc import Iterator

import broken
import forge as f
from broken import DATA, EITHER, FIVES, HEAD, TRACK
from case import NONCONFORMING, Case

KEPT = [FIVES]
LAYER = ("TRAK", f.layer(first=1))


def meta(raw: bytes) -> bytes:
    return f.minimal(("mETa", raw))


JSON = [
    ("metadata-of-no-bytes", "The payload is empty.", b""),
    ("metadata-a-list", "A list is no object.", b"[]"),
    ("metadata-two-objects", "A second object follows the first.", b"{}{}"),
    ("metadata-cut-short", "An object is not closed.", b'{"a":1'),
    ("metadata-comment", "JSON has no comments.", b'{} // "a"'),
    ("metadata-single-quotes", "A name is in single quotes.", b"{'a':1}"),
    ("metadata-zero-ahead", "A number begins with a 0 too many.", b'{"a":01}'),
    ("metadata-point-at-the-end", "A number ends with its point.", b'{"a":1.}'),
    ("metadata-nan", "NaN is no number of JSON.", b'{"a":NaN}'),
    ("metadata-infinity", "Infinity is no number of JSON.", b'{"a":-Infinity}'),
    ("metadata-number-too-large", "1e309 is not finite as binary64.", b'{"a":1e309}'),
    ("metadata-integer-too-long", "An integer has 1001 digits.", b'{"a":1' + b"0" * 1000 + b"}"),
    ("metadata-control-character", "A text holds a line break that is not escaped.",
     b'{"a":"\n"}'),
    ("metadata-no-utf-8", "A text is written in Latin-1.", b'{"a":"\xB5m"}'),
    ("metadata-half-a-pair", "A text holds an escaped half of a surrogate pair.",
     b'{"a":"\\ud83d"}'),
    ("metadata-65-deep", "Objects and lists are nested 65 deep.",
     b'{"a":' + b"[" * 64 + b"]" * 64 + b"}"),
    ("metadata-1000-deep-objects", "Objects are nested a thousand deep.",
     b'{"a":' * 1000 + b"1" + b"}" * 1000),
]  # fmt: skip

ATTACHMENTS = [
    ("attachment-of-no-bytes", "ATT-001", "An attachment has no bytes.", b""),
    ("attachment-without-name", "ATT-001", "The name of an attachment is empty.", b"\0\0abc"),
    ("attachment-name-past-the-payload", "ATT-001", "A name is longer than the payload.", b"\2a"),
    ("attachment-without-media-type", "ATT-001", "Nothing follows the name.", b"\1a"),
    ("attachment-media-type-past-the-payload", "ATT-001",
     "A media type is longer than the payload.", b"\1a\4text"[:-1]),
    ("attachment-name-no-utf-8", "CNV-004", "A name holds the byte FF.", b"\1\xFF\0"),
]  # fmt: skip

DIGESTS = [
    ("digest-of-no-bytes", ("DGS-001", "CNV-002"), "A dGST chunk is empty.",
     f.minimal(("dGST", b"")), KEPT),
    ("digest-of-a-track-alone", "DGS-001", "A dGST chunk ends behind its track.",
     f.minimal(("dGST", f.digests())), KEPT),
    ("digest-of-31-bytes", "DGS-001", "A digest lacks a byte.",
     f.minimal(("dGST", f.digests(bytes(31)))), KEPT),
    ("digest-of-33-bytes", "DGS-001", "A byte follows a digest.",
     f.minimal(("dGST", f.digests(bytes(33)))), KEPT),
    ("digest-of-no-track", "DGS-001", "A digest speaks of track 1, which is not described.",
     f.minimal(("dGST", f.digests(bytes(32), first=1))), KEPT),
    ("digest-of-one-track-too-many", "DGS-001", "The second of two digests speaks of track 1.",
     f.minimal(("dGST", f.digests(bytes(64)))), KEPT),
    ("digest-of-track-65534", "DGS-001", "A digest speaks of track 65534.",
     f.minimal(("dGST", f.digests(bytes(32), first=65534))), KEPT),
    ("digest-of-a-track-not-minimal", "CNV-002", "A digest speaks of track 80 00.",
     f.minimal(("dGST", b"\x80\0" + bytes(32))), KEPT),
    ("digest-before-its-track", "DGS-001", "A digest comes before its track is described.",
     f.closed(HEAD, TRACK, DATA, ("dGST", f.digests(bytes(32), first=1)),
              ("TRAK", f.trak(first_channel=1, first=1)))),
    ("digest-of-events", "DGS-001", "A digest speaks of a layer.",
     f.minimal(LAYER, ("dGST", f.digests(bytes(32), first=1))), KEPT),
]  # fmt: skip


def clock(raw: bytes, type_: str = "cLOk") -> bytes:
    return f.minimal((type_, raw))


def mapped(*points: tuple[int, int], count: int | None = None, more: bytes = b"") -> bytes:
    return clock(f.clock_map(points, count=count) + more, type_="cMAp")


SEEN = (0, 0, 0)
CLOCKS = [
    ("clock-of-no-bytes", ("CLK-001", "CNV-002"), "A cLOk chunk has no bytes.", clock(b"")),
    ("clock-of-a-track-alone", "CLK-001", "A cLOk chunk ends behind its track.",
     clock(f.clock_of(0))),
    ("clock-of-a-track-not-minimal", "CNV-002", "A clock speaks of track 81 00.",
     clock(b"\x81" + f.clock([SEEN]))),
    ("clock-without-name", "CLK-001", "The name of a clock is empty.",
     clock(f.clock([SEEN], ""))),
    ("clock-name-past-the-payload", "CLK-001", "A name is longer than the payload.",
     clock(f.clock_of(0) + b"\2a")),
    ("clock-name-no-utf-8", "CNV-004", "A name holds the byte FF.",
     clock(f.clock_of(0) + b"\1\xFF" + f.clock([SEEN])[4:])),
    ("clock-time-cut-short", ("CLK-001", "CNV-002"), "The first time ends after seven bytes.",
     clock(f.clock([SEEN])[:-2])),
    ("clock-and-a-byte", "CLK-001", "A byte follows the last observation.",
     clock(f.clock([SEEN]) + b"\0")),
    ("clock-observation-missing", ("CNV-002", "CLK-001"), "One observation announces two.",
     clock(f.clock([SEEN], count=2))),
    ("clock-of-no-observation", "CLK-001", "A clock was never observed.", clock(f.clock([]))),
    ("clock-map-of-one-point", "CLK-001", "A map has one point.", mapped((0, 0))),
    ("clock-tick-too-early", "CLK-003", "A tick is -2^52.", clock(f.clock([(-(2**52), 0, 0)]))),
    ("clock-tick-too-late", "CLK-003", "The second tick is 2^52.",
     clock(f.clock([(2**51, 0, 0), (2**52, 0, 0)]))),
    ("clock-time-too-late", "CLK-003", "The second time is 2^63.",
     clock(f.clock([(0, 2**63 - 1, 0), (1, 2**63, 0)]))),
    ("clock-map-tick-too-late", "CLK-003", "The second tick of a map is 2^52.",
     mapped((2**51, 0), (2**52, 1))),
    ("clock-map-time-too-late", "CLK-003", "The second time of a map is 2^63.",
     mapped((0, 2**63 - 1), (1, 2**63))),
    ("clock-map-tick-stands", "CLK-003", "Two points of a map have one tick.",
     mapped((0, 0), (0, 1))),
    ("clock-map-time-stands", "CLK-003", "Two points of a map have one time.",
     mapped((0, 0), (1, 0))),
    ("clock-of-no-track", "CLK-005", "A clock speaks of track 9, which is not described.",
     clock(f.clock([SEEN], track=9))),
    ("clock-of-track-2-to-53", "CLK-005", "A clock speaks of track 2^53 - 2.",
     clock(f.clock([SEEN], track=2**53 - 2))),
    ("clock-of-events", "CLK-005", "A clock speaks of a layer.",
     f.minimal(LAYER, ("cLOk", f.clock([SEEN], track=1)))),
    ("clock-before-its-track", "CLK-005", "A clock comes before its track is described.",
     f.closed(HEAD, TRACK, DATA, ("cLOk", f.clock([SEEN], track=1)),
              ("TRAK", f.trak(first_channel=1, first=1)))),
    ("clock-map-of-events", "CLK-005", "A map speaks of a layer.",
     f.minimal(LAYER, ("cMAp", f.clock_map([(0, 0), (1, 1)], track=1)))),
]  # fmt: skip


def marked(packet: bytes, span: int = 4, start: int = 0, duration_ns: int = 4_000_000) -> bytes:
    """A packet of events at 1 kHz, and the usual samples next to it."""
    cluster = f.cluster((0, 0, 4, f.KNOT_DATA), (1, start, span, packet))
    return f.closed(HEAD, TRACK, LAYER, ("DATA", cluster), duration_ns=duration_ns)


EVENTS = [
    ("events-none", "EVT-001", "A packet holds no event.", marked(b"")),
    ("event-text-cut-short", "EVT-001", "A text is longer than what is left.",
     marked(f.event(0, "a", size=2))),
    ("event-cut-short", ("CNV-002", "EVT-001"), "A packet ends before the size of a text.",
     marked(f.event(0)[:-1])),
    ("event-at-the-end", "EVT-001", "The tick of an event is that of the packet's end.",
     marked(f.event(4))),
    ("event-at-the-end-later", "EVT-001", "An event of a packet from tick 2 on is at its end.",
     marked(f.event(2), 2, 2)),
    ("event-past-2-to-48", "EVT-001", "The end of an event is 2^48 + 1.",
     marked(f.event(1, duration=2**48))),
    ("event-of-channel-65535", "EVT-003", "An event has the channel 65536.",
     marked(f.event(0, channel=65536))),
    ("event-of-no-channel", "EVT-003", "An event speaks of channel 1, and there is none.",
     marked(f.event(0, channel=2))),
    ("event-text-no-utf-8", "CNV-004", "A text holds the byte FF.", marked(f.event(0, b"\xFF"))),
    ("event-number-not-minimal", "CNV-002", "A duration of 0 is stored as 80 00.",
     marked(b"\0\x80\0\0\0")),
]  # fmt: skip


def cases() -> Iterator[Case]:
    either = {"metadata-no-utf-8": ("MET-001", "CNV-004")}
    metadata = [
        (name, either.get(name, "MET-001"), about, meta(raw), KEPT) for name, about, raw in JSON
    ]
    yield from broken.cases("structure/json", metadata)
    attached = [(*row[:3], f.minimal(("aTTc", row[3])), KEPT) for row in ATTACHMENTS]
    yield from broken.cases("structure/list", attached)
    yield from broken.cases("semantics/digest", DIGESTS)
    twice = [*KEPT, broken.track([], 1)]
    kept = {"clock-before-its-track": twice}
    yield from broken.cases("semantics/clock", [(*row, kept.get(row[0], KEPT)) for row in CLOCKS])
    late = {"event-of-no-channel": EITHER}
    rows = [(*row, KEPT, late.get(row[0], NONCONFORMING)) for row in EVENTS]
    yield from broken.cases("entropy/events", rows)
