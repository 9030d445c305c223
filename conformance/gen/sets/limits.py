"""SPEC 12: what a level just allows, what it no longer allows, and few bytes that promise much.

What is large is made on demand. A reader may have lower limits than level 2, and than what makes
little of a file into much (LIM-003).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from typing import Any

import deflate
import forge as f
import page
import page_transform
from broken import (
    DATA_AT,
    EITHER,
    END,
    HEAD,
    TRACK,
    TRACK_AT,
    described,
    lasting,
    needs,
    packed,
    track,
)  # fmt: skip
from case import DAMAGED, INTACT, NONCONFORMING, UNSUPPORTED, Case, numbers
from facts import closed_at

WORDS = {INTACT: "intact", NONCONFORMING: "nonconforming", DAMAGED: "damaged"}
OR_LESS = [INTACT, UNSUPPORTED]
WORK = [DAMAGED, UNSUPPORTED]
OR_REFUSED = [NONCONFORMING, UNSUPPORTED]
TWO = ("HEAD", f.head(level=2))
LOW, HIGH = -(2**31), 2**31 - 1
WIDE = {"level": 2, "count_min": LOW, "count_max": HIGH}
Data = bytes | Callable[[], bytes]


def constant(value: int, count: int) -> dict[str, Any]:
    """A track of one number, which is not held as often in memory."""
    digest, block = hashlib.sha256(), value.to_bytes(8, "little", signed=True) * 4096
    for at in range(0, count, 4096):
        digest.update(block[: 8 * min(4096, count - at)])
    said = {"count": count, "sha256": digest.hexdigest()}
    return {"track": 0, "spans": [[0, count]], "numbers": said}


def both(low: Any, high: Any, **given: Any) -> bytes:
    """Two held knots, of a tick each."""
    return described(packet=f.svarint(low) + b"\1" + f.svarint(high - low), span=2, **given)


SPAN_24 = {"count_min": -(2**23), "count_max": 2**23 - 1}
ENDS_24 = [track([-(2**23), 2**23 - 1])]
ENDS_32 = [track([LOW, HIGH])]


def residual(level: int, bits: int) -> bytes:
    """An LF and an HF track of the widest ranges, at both ends."""
    ends = {"count_min": -(2 ** (bits - 1)), "count_max": 2 ** (bits - 1) - 1}
    low, high = ends["count_min"], ends["count_max"]
    knots = f.svarint(low) + b"\1" + f.svarint(high - low)
    lf = {"count_min": -(2**23), "count_max": 2**23 - 1} if level == 1 else ends
    return f.closed(
        ("HEAD", f.head(level=level)),
        ("TRAK", f.trak(kind=1, **lf)),
        ("TRAK", f.trak(kind=2, base=0, **ends, first=1)),
        ("DATA", f.cluster((0, 0, 2, knots), (1, 0, 2, knots))),
        duration_ns=lasting(2),
    )


def grid(index: int, level: int) -> bytes:
    """An index on the deadband's grid that has the most levels."""
    given = {} if level == 1 else WIDE
    return packed(b"LPCR", f.lpcr_parameters(1, kn=1, kd=1024), b"\x10\0" + f.svarint(index), 1,
                  **(SPAN_24 | {"level": 1} | given))  # fmt: skip


LAST = {level: len(page.grid_levels(1, 1024, 1, bound)) - 1 for level, bound in
        ((1, 2**24), (2, 2**32))}  # fmt: skip
THREE = f.quan_parameters(b"\x22\x22", c=3, step=2**24)
EIGHT = f.quan_parameters(b"\x22\x22", c=3, step=2**31)
"""Levels 0, then of 1, of 2 and 3, of 4 to 7: two bits each."""

COARSEST = page_transform.steps(5, 2**32)
LOUDEST = page_transform.encode([[0] * 31 + [8]], COARSEST)
LOUD = [page.clamp(x, -(2**23), 2**23 - 1)
        for x in page_transform.decode(LOUDEST, 2, 5, COARSEST)]  # fmt: skip

LISTED = (("HEAD", 8, 0, 0), ("TRAK", TRACK_AT, 0, 0), ("DATA", DATA_AT, 0, f.LATE_MS))


def late(start: int, span: int, rate_den: int = 1) -> bytes:
    """A packet at the end of all ticks, and its index and footer."""
    cluster = ("DATA", f.cluster((0, start, span, f.KNOT_DATA)))
    chunks = [HEAD, ("TRAK", f.trak(rate_den=rate_den)), cluster]
    return closed_at(chunks, [(0, 2**53 - 1)], 2**63 - 1)


ALLOWED = [
    ("range-of-24-bits", "At level 1 a range has 24 bits.",
     both(-(2**24), 2**24, **SPAN_24), ENDS_24),
    ("range-of-25-bits-for-hf", "At level 1 the range of an HF track has 25 bits.",
     residual(1, 25), [*ENDS_24, track([-(2**24), 2**24 - 1], 1)]),
    ("range-of-32-bits", "At level 2 a range has 32 bits.", both(-(2**32), 2**32, **WIDE), ENDS_32),
    ("range-of-32-bits-for-hf", "At level 2 the range of an HF track has 32 bits.",
     residual(2, 32), [*ENDS_32, track([LOW, HIGH], 1)]),
    ("knot-step-of-2-to-24", "At level 1 the step of knots is 2^24.",
     both(-1, 1, tlvs=f.tlv(1, f.knot_parameters(0, 2**24)), **SPAN_24), ENDS_24),
    ("knot-step-of-2-to-31", "At level 2 the step of knots is 2^31.",
     both(-2, 2, tlvs=f.tlv(1, f.knot_parameters(0, 2**31)), **WIDE), ENDS_32),
    ("levels-of-2-to-25", "At level 1 levels times the step are -2^25 and 2^25.",
     packed(b"QUAN", THREE, b"\x98", 2, **SPAN_24), ENDS_24),
    ("levels-of-2-to-33", "At level 2 a level times the step is -2^33.",
     packed(b"QUAN", EIGHT, b"\xC8", 1, **WIDE), [track([LOW])]),
    ("index-of-2-to-24", "At level 1 the index 1 times the step is 2^24.",
     packed(b"LPCR", f.lpcr_parameters(step=2**24, zero=LOW), b"\x10\0\2", 4, **SPAN_24),
     [track([-(2**23)] * 4)]),
    ("coefficients-of-2-to-36", "The coefficients of a block add up to 2^36.",
     packed(b"MDCT", f.mdct_parameters(5, 2**32), LOUDEST, 2, **SPAN_24), [track(LOUD)]),
    ("index-of-2-to-32", "At level 2 the index -2^32 is on the grid of step 1.",
     packed(b"LPCR", f.lpcr_parameters(zero=HIGH), b"\x10\0" + f.svarint(-(2**32)), 4, **WIDE),
     [track([LOW] * 4)]),
    ("deadband-of-most-levels", "At level 1 an index is the last on the largest grid.",
     grid(LAST[1], 1), [track([2**23 - 1])]),
    ("deadband-of-most-levels-at-level-2", "At level 2 an index is the last on the largest grid.",
     grid(-LAST[2], 2), [track([LOW])]),
    ("track-65533", "A track has the highest id.",
     described(first=65533), [track([5] * 4, 65533)]),
    ("tick-2-to-48", "A packet ends at tick 2^48, and the footer at the largest i64.",
     late(2**48 - 4, 4), [track([5] * 4, 0, 2**48 - 4)]),
    ("tick-2-to-48-of-years", "A packet ends at tick 2^48 of 50 days each.",
     late(2**48 - 4, 4, 2**32 - 1), [track([5] * 4, 0, 2**48 - 4)]),
    ("samples-of-2-to-22", "At level 1 a cluster has 2^22 samples.",
     described(span=2**22), [constant(5, 2**22)]),
    ("noise-silent-for-2-to-22-ticks", "A packet of NOIS without a byte has 2^22 ticks.",
     packed(b"NOIS", f.nois_parameters(), b"", 2**22), [constant(0, 2**22)]),
    ("metadata-64-deep", "Metadata are nested 64 deep.",
     f.minimal(("mETa", b'{"a":' + b"[" * 63 + b"]" * 63 + b"}")), [track([5] * 4)]),
    ("metadata-of-1000-digits", "An integer of the metadata has 1000 digits.",
     f.minimal(("mETa", b'{"a":' + b"1" * 1000 + b"}")), [track([5] * 4)]),
]  # fmt: skip

FORBIDDEN = [
    ("knot-step-above-level-2", ("LPC-002", "LIM-001"), "At level 2 the step of knots is 2^31 + 1.",
     both(0, 0, tlvs=f.tlv(1, f.knot_parameters(0, 2**31 + 1)), **WIDE)),
    ("knot-above-level-2", "LPC-003", "At level 2 a knot's index is 2^32 + 1.",
     both(0, 2**32 + 1, **WIDE)),
    ("step-above-level-2", ("LPC-002", "LIM-001"), "At level 2 the step is 2^31 + 1.",
     packed(b"LPCR", f.lpcr_parameters(step=2**31 + 1), b"\x10\0\0", **WIDE)),
    ("levels-step-above-level-2", ("QNT-001", "LIM-001"), "At level 2 a step is 2^31 + 1.",
     packed(b"QUAN", f.quan_parameters(b"\x10", step=2**31 + 1), b"", **WIDE)),
    ("levels-above-level-2", "QNT-006", "At level 2 a level times the step is 5 * 2^31.",
     packed(b"QUAN", EIGHT, b"\xD0", 1, **WIDE)),
    ("index-above-level-2", "LPC-003", "At level 2 an index is 2^32 + 1.",
     packed(b"LPCR", f.lpcr_parameters(), b"\x10\0" + f.svarint(2**32 + 1), **WIDE)),
    ("deadband-past-the-last-level", "LPC-003", "At level 1 an index is past the largest grid.",
     grid(LAST[1] + 1, 1)),
    ("deadband-past-the-last-level-at-level-2", "LPC-003",
     "At level 2 an index is one past the largest grid.", grid(-LAST[2] - 1, 2)),
    ("samples-above-level-2", "DAT-009", "At level 2 a cluster has 17 * 2^24 samples.",
     f.closed(TWO, TRACK, ("DATA", f.cluster(*[(0, 2**24 * i, 2**24, b"\x0A") for i in range(17)])),
              duration_ns=lasting(17 * 2**24)), OR_REFUSED),
    ("span-above-level-2", ("DAT-003", "LIM-001"), "At level 2 a packet has 2^24 + 1 ticks.",
     described(span=2**24 + 1, level=2), OR_REFUSED),
]  # fmt: skip

LARGE = 2**53 - 1
PROMISES = [
    ("index-of-2-to-32-entries", "IDX-002",
     "An index of none promises 2^32 - 1 entries.",
     f.closed(HEAD, TRACK, ahead={"entries": (), "count": 2**32 - 1})),
    ("cluster-of-2-to-53-packets", "DAT-001", "A cluster promises 2^53 - 1 packets.",
     f.closed(HEAD, TRACK, ("DATA", f.varint(LARGE) + bytes(9)))),
    ("packet-of-2-to-53-bytes", "DAT-005", "A packet promises 2^53 - 1 bytes.",
     f.closed(HEAD, TRACK, ("DATA", f.table([(0, LARGE, 0, 4, 0)])))),
    ("tracks-of-2-to-53-bytes", "TRK-020", "A DEFLATE stream of TRAK promises 2^53 - 1 bytes.",
     f.closed(HEAD, ("TRAK", b"\0" + f.varint(LARGE) + f.squeezed(f.trak())[2:]))),
    ("tracks-of-2-to-20-bytes", "TRK-020", "A DEFLATE stream promises 2^20 - 1 bytes, and has few.",
     f.closed(HEAD, ("TRAK", b"\0" + f.varint(2**20 - 1) + f.squeezed(f.trak())[2:]))),
    ("tracks-above-level-1", "TRK-020", "A DEFLATE stream promises 2^20 bytes at level 1.",
     f.closed(HEAD, ("TRAK", b"\0" + f.varint(2**20) + f.squeezed(f.trak())[2:]))),
    ("clock-of-2-to-53-observations", ("CLK-001", "CNV-002"),
     "A clock promises 2^53 - 1 observations.",
     f.minimal(("cLOk", f.clock([(0, 0, 0)], count=LARGE, track=0)))),
    ("map-of-2-to-53-points", ("CLK-001", "CNV-002"), "A map promises 2^53 - 1 points.",
     f.minimal(("cMAp", f.clock_map([(0, 0), (1, 1)], count=LARGE, track=0)))),
    ("components-of-2-to-64-bytes", "LPC-001", "254 components promise 2^60 bytes and some.",
     packed(b"LPCR", f.lpcr_parameters(), f.varint(LARGE) * 254 + b"\x10\0\0", 1,
            component_count=255)),
    ("knots-of-2-to-22-ticks", ("RNG-001", "KTE-004", "LPC-003", "RNG-003"),
     "A packet of four coded bytes promises a knot for each of 2^22 ticks.",
     packed(b"KNOT", f.coded_knot_parameters(),
            b"\0" + f.varint(2**22 - 1) + bytes(4), 2**22)),
    ("repeats-of-2-to-22-ticks", ("RNG-001", "LPC-003", "RNG-003"),
     "A packet of four coded bytes gives 2^22 ticks that repeat.",
     packed(b"LPCR", f.lpcr_parameters(),
            b"\x08\0\0\0\x0c" + b"\xff" * 8, 2**22)),
    ("by-bits-of-2-to-22-ticks", ("RNG-001", "LPC-003", "RNG-003"),
     "A packet of eight coded bytes gives 2^22 ticks by bits.",
     packed(b"LPCR", f.lpcr_parameters(), b"\0\0\0\x40" + b"\xff" * 8, 2**22)),
    ("coefficients-of-2-to-22-ticks", ("RNG-001", "RNG-003", "MDC-003"),
     "A packet of eight coded bytes promises 512 coefficients in each of 2^13 blocks.",
     packed(b"MDCT", f.mdct_parameters(9), b"\0\x80\4\x44\x0c" + b"\xff" * 8, 2**22)),
    ("noise-of-2-to-22-ticks", ("RNG-001", "NOI-006", "RNG-003"),
     "A packet of four coded bytes gives 2^22 ticks of noise.",
     packed(b"NOIS", f.nois_parameters(), b"\x20\0\1\0\0\0\x28\0\0\0\0" + b"\xff" * 4, 2**22)),
    ("noise-components-of-2-to-64-bytes", "LPC-001", "254 components promise 2^60 bytes and some.",
     packed(b"NOIS", f.nois_parameters(), f.varint(LARGE) * 254, 1, component_count=255)),
    ("exact-of-2-to-53-bytes", "EXA-003", "The counts of LPCX promise 2^53 - 1 bytes.",
     packed(b"LPCX", f.lpcx_parameters(), f.varint(LARGE) + b"\x10\0\x0A")),
    ("levels-of-2-to-22-zeros", "COD-001", "A packet of one byte promises 2^22 levels.",
     packed(b"QUAN", f.quan_parameters(b"\x11", m=0, r=1), b"\0", 2**22)),
]  # fmt: skip


def zeros(count: int) -> bytes:
    """A DEFLATE stream of 258 * count + 1 zeros: a literal, then matches at distance 1, all of
    fixed codes; a byte for 159."""
    bits = "110" + "00110000" + "1100010100000" * count + "0000000"
    bits += "0" * (-len(bits) % 8)
    return bytes(int(bits[i : i + 8][::-1], 2) for i in range(0, len(bits), 8))


def one_payload(size: int, level: int) -> Callable[[], bytes]:
    """An attachment so large that an index comes before it (IDX-005)."""
    before = f.index(LISTED)
    entries = [("iNDX", END, 0, 0), ("aTTc", END + f.HEADER + len(before), 0, 0)]
    return lambda: f.closed(
        ("HEAD", f.head(level=level)), TRACK, f.DATA_0, ("iNDX", before),
        ("aTTc", f.strings("a", "") + bytes(size - 3)),
        ahead={"entries": entries, "previous": END, "first": 3},
    )  # fmt: skip


def unlisted(size: int) -> Callable[[], bytes]:
    """Chunks of ``size`` bytes before the index, those of the usual file among them."""
    left = size - (END - 8)
    sizes = [2**20 + f.HEADER] * 3 + [left - 3 * (2**20 + f.HEADER)]
    contents = [f.strings("a", "") + bytes(n - f.HEADER - 3) for n in sizes]
    return lambda: f.minimal(*[("aTTc", content) for content in contents])


def rows(count: int, level: int) -> Callable[[], bytes]:
    """A cluster of ``count`` packets of one tick."""
    return lambda: f.closed(
        ("HEAD", f.head(level=level)), TRACK,
        ("DATA", f.cluster(*[(0, i, 1, f.KNOT_DATA) for i in range(count)])),
        duration_ns=lasting(count),
    )  # fmt: skip


def marks(packet: bytes) -> bytes:
    return f.minimal(("TRAK", f.layer(first=1)), ("DATA", f.cluster((1, 0, 1, packet))))


def repeating(count: int, tlvs: bytes, channel: int, first: int) -> bytes:
    """The payload of tracks that differ in their channels alone, in a DEFLATE stream of tokens that
    say so: to look for them takes long."""
    one = f.track(tlvs, first_channel=channel)
    rest = 2 + len(tlvs)
    ahead = len(one) - rest - len(f.varint(channel))
    tokens: list[Any] = list(one)
    size = last = len(one)
    for number in range(channel + 1, channel + count):
        own = f.varint(number)
        length = ahead + len(own) + rest
        behind = last + len(own) - (last - ahead - rest)
        tokens += [(ahead, last), *own, *[(258, behind)] * (rest // 258), (rest % 258, behind)]
        size, last = size + length, length
    stream = deflate.packed(deflate.block(tokens, last=True, kind=deflate.DYNAMIC))
    return f.varint(first) + f.varint(size) + stream


def many(width: int, count: int, tlvs: bytes = f.HOLD, *, squeeze: bool = False) -> bytes:
    """TRAK chunks of 255 channels each, and what is left."""
    chunks: list[Any] = [HEAD]
    track_id = 0
    for first in range(0, count, 255):
        channels = min(255, count - first)
        tracks = channels if width == 1 else 1
        given = {"track_count": tracks, "component_count": channels // tracks}
        payload = f.trak(tlvs, first=track_id, first_channel=first, **given)
        if squeeze:
            payload = repeating(tracks, tlvs, first, track_id)
        chunks.append(("TRAK", payload))
        track_id += tracks
    return f.closed(*chunks)


def nested(count: int) -> bytes:
    """Headers that each promise all that follows."""
    sizes = [f.HEADER * (count - i - 1) for i in range(count)]
    body = [f.chunk("xXxx", b"", i + 1, size=size, crc=1) for i, size in enumerate(sizes)]
    return f.file(HEAD) + b"".join(body)


def zero_coefficients(count: int) -> bytes:
    """A component packet of ``count`` zeros, which all have context 0 and state 0."""
    x, words = 2**16, []
    width = page.class_ends(10, 0)[0]
    for _ in range(count):
        if x // width * 4096 >= 2**32:
            words.append(x % 2**16)
            x //= 2**16
        x = x // width * 4096 + x % width
    coded = b"".join(word.to_bytes(2, "big") for word in reversed(words))
    return b"\x0a\x80\4\x0a\0" + x.to_bytes(4, "big") + coded


def all_zero() -> bytes:
    steps = page_transform.steps(9, 256)
    few = page_transform.encode([[0] * 512] * 8, steps, 5, classes=(10, 0), start=0)
    assert zero_coefficients(8 * 512) == few
    return packed(b"MDCT", f.mdct_parameters(9), zero_coefficients(2**22), 2**22)


def line() -> tuple[bytes, list[int]]:
    """A line of 2^20 ticks over 2^33 counts, whose products need 54 bits."""
    last, low, rise = 2**20, -(2**32) + 1, 2**33 - 3
    packet = f.svarint(low) + f.varint(last) + f.svarint(rise)
    given = WIDE | {"span": last + 1, "packet": packet}
    counts = (low + (2 * rise * t + last) // (2 * last) for t in range(last + 1))
    data = described(f.tlv(1, f.knot_parameters(1)), **given)
    return data, [min(max(count, LOW), HIGH) for count in counts]


FIVES = [track([5] * 4)]
TEXTS = f.HOLD + b"".join(f.tlv(type_, f.strings("a" * 254)) for type_ in (2, 6, 8, 10, 12, 14))
DEMANDED = [
    ("payload-of-2-to-20", "LIM-001", "At level 1 a payload has 2^20 bytes.",
     one_payload(2**20, 1), FIVES, 0),
    ("payload-above-level-1", "LIM-001", "At level 1 a payload has 2^20 + 1 bytes.",
     one_payload(2**20 + 1, 1), FIVES, 2),
    ("payload-of-2-to-24", "LIM-001", "At level 2 a payload has 2^24 bytes.",
     one_payload(2**24, 2), FIVES, OR_LESS),
    ("payload-above-level-2", "LIM-001", "A header says 2^24 + 1 bytes, and is none.",
     one_payload(2**24 + 1, 2), FIVES, 3),
    ("index-after-4-mib", "IDX-005", "Chunks of 4 MiB come before the first index.",
     unlisted(2**22), FIVES, 0),
    ("index-after-more-than-4-mib", "IDX-005", "A byte more than 4 MiB comes before an index.",
     unlisted(2**22 + 1), FIVES, 2),
    ("packets-of-2-to-14", "DAT-001", "At level 1 a cluster has 2^14 packets.",
     rows(2**14, 1), [constant(5, 2**14)], 0),
    ("packets-above-level-1", ("DAT-001", "LIM-001"), "At level 1 a cluster has 2^14 + 1 packets.",
     rows(2**14 + 1, 1), None, 2),
    ("packets-of-2-to-17", "DAT-001", "At level 2 a cluster has 2^17 packets.",
     rows(2**17, 2), [constant(5, 2**17)], OR_LESS),
    ("packets-above-level-2", ("DAT-001", "LIM-001"), "At level 2 a cluster has 2^17 + 1 packets.",
     rows(2**17 + 1, 2), None, OR_REFUSED),
    ("packets-of-2-to-64-bytes", "DAT-005", "2049 packets promise 2^64 bytes and some.",
     lambda: f.closed(HEAD, TRACK, ("DATA", f.table(
         [(0, LARGE, 4 * i, 4, 0) for i in range(2049)])), duration_ns=lasting(8196)),
     None, 2),
    ("span-of-2-to-24", "DAT-003", "At level 2 a packet has 2^24 ticks.",
     lambda: described(span=2**24, level=2), None, OR_LESS),
    ("line-of-2-to-20-ticks", "LIM-001", "At level 2 a line goes over 2^33 counts in 2^20 ticks.",
     lambda: line()[0], line, 0),
    ("events-of-2-to-16", "EVT-001", "A packet has 65536 events.",
     lambda: marks(f.event(0) * 65536), FIVES, 0),
    ("events-above-2-to-16", "EVT-001", "A packet has 65537 events.",
     lambda: marks(f.event(0) * 65537), FIVES, 2),
    ("event-of-65535-bytes", "EVT-003", "The text of an event has 65535 bytes.",
     lambda: marks(f.event(0, "a" * 65535)), FIVES, 0),
    ("event-of-65536-bytes", "EVT-003", "The text of an event has 65536 bytes.",
     lambda: marks(f.event(0, "a" * 65536)), FIVES, 2),
    ("tracks-65534", "TRK-003", "A file describes 65534 tracks.",
     lambda: many(1, 65534), None, OR_LESS),
    ("channels-65535", "TRK-010", "A file describes 65535 channels.",
     lambda: many(255, 65535), None, OR_LESS),
    ("texts-of-65534-tracks", "LIM-002", "65534 tracks have six texts of 254 bytes each.",
     lambda: many(1, 65534, TEXTS, squeeze=True), None, OR_LESS),
    ("zeros-of-2-to-22-coefficients", "MDC-002", "Few bytes are 2^22 coefficients, all 0.",
     all_zero, [constant(5, 2**22)], OR_LESS),
    ("inflates-to-2-to-22", "RAW-003", "6 kB of DEFLATE are 2^22 samples.",
     lambda: packed(b"RAWB", f.raw_parameters(1), b"\1" + zeros(16256), 258 * 16256 + 1),
     [constant(0, 258 * 16256 + 1)], OR_LESS),
    ("inflates-to-16-mib", "RAW-003", "100 kB of DEFLATE are 16 MiB of zeros for 4 samples.",
     lambda: packed(b"RAWB", f.raw_parameters(1), b"\1" + zeros(2**16)), None, 2),
    ("metadata-100000-deep", "MET-001", "Metadata are nested 100 000 deep.",
     lambda: f.minimal(("mETa", b'{"a":' + b"[" * 100_000 + b"]" * 100_000 + b"}")), FIVES, 2),
    ("metadata-of-many-lists", "LIM-002", "Metadata hold 2^18 empty lists.",
     lambda: f.minimal(("mETa", b'{"a":[' + b"[]," * (2**18 - 1) + b"[]]}")), FIVES, OR_LESS),
    ("chunks-of-no-bytes", "LIM-002", "20 000 unknown chunks have no bytes.",
     lambda: f.minimal(*[("xXxx", b"")] * 20_000), FIVES, OR_LESS),
    ("headers-within-headers", "REC-005", "2^14 headers each promise all that follows.",
     lambda: nested(2**14), None, WORK),
]  # fmt: skip


LEVEL_2 = {"payload-of-2-to-24", "payload-above-level-2", "packets-of-2-to-17",
           "packets-above-level-2", "span-of-2-to-24", "line-of-2-to-20-ticks"}  # fmt: skip
CODECS = {"events": ["EVNT", "KNOT"], "event-": ["EVNT", "KNOT"], "inflat": ["RAWB"],
          "zeros-": ["MDCT"]}  # fmt: skip


def told(name: str) -> dict[str, Any]:
    """What a file needs that is not made yet."""
    return {"codecs": CODECS.get(name[:6], ["KNOT"]), "level": 1 + (name in LEVEL_2)}


def case(name: str, rule: Any, about: str, data: Data, tracks: Any, codes: Any,
         fault: str = "") -> Case:  # fmt: skip
    rules = [rule] if isinstance(rule, str) else list(rule)
    first = codes if isinstance(codes, int) else codes[0]
    overlooked = first == NONCONFORMING and (tracks or rules[0][:3] in ("IDX", "CLK"))
    decode = EITHER if overlooked else [INTACT, DAMAGED] if codes == DAMAGED else codes
    expect: dict[str, Any] = {
        "needs": needs(data) if isinstance(data, bytes) else told(name),
        "exit": {"decode": decode, "verify": codes},
    }
    if tracks is None and first == INTACT:
        del expect["exit"]["decode"]
    if isinstance(codes, int):
        expect["verdict"] = WORDS[codes]
    if tracks is line:
        counts = line()[1]
        tracks = [{"track": 0, "spans": [[0, len(counts)]], "numbers": numbers(counts)}]
    if tracks is not None:
        expect["decode"] = {"tracks": tracks}
    if codes == NONCONFORMING:
        expect["verify"] = {"requirement": rules}
    if not fault and codes != INTACT:
        fault = "limits/amplification" if codes in (OR_LESS, WORK) else "limits/passed"
    less = ["LIM-003"] if isinstance(codes, list) else []
    first_read = ["LIM-002"] if fault == "limits/promise" else []
    touched = list(dict.fromkeys([rules[0], "LIM-001", *first_read, *less]))
    return Case("limits", name, about, touched, data, expect, fault or None)


def cases() -> Iterator[Case]:
    for name, about, data, tracks in ALLOWED:
        yield case(name, "LIM-001", about, data, tracks, INTACT)
    for name, rule, about, data, *codes in FORBIDDEN:
        yield case(name, rule, about, data, None, *(codes or [NONCONFORMING]))
    for name, rule, about, data in PROMISES:
        yield case(name, rule, about, data, None, NONCONFORMING, "limits/promise")
    for name, rule, about, data, tracks, codes in DEMANDED:
        yield case(name, rule, about, data, tracks, codes)
