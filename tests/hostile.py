"""Small files that ask for much: the most that each codec, list and chunk allows for its bytes."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import forge as f
import numpy as np

from hapfmt.codecs.predicted import Predictor, encode_predicted
from hapfmt.limits import Limits

NONE = b""
Build = Callable[[int], bytes]
"""The packet of so many ticks."""


class Size(NamedTuple):
    """What a file asks for: samples of a packet and of all, tracks, chunks that are a finding each,
    bytes of JSON, of an attachment and of all of them."""

    packet: int
    samples: int
    tracks: int
    chunks: int
    json: int
    attachment: int
    attached: int


WHOLE = Size(1 << 24, 1 << 28, 65_534, 1 << 15, 1 << 24, (1 << 24) - 8, 6 << 24)
"""What level 2 allows, in a file of a few megabytes."""


def fitting(memory: int) -> Size:
    """As much as a memory has room for."""
    limits = Limits(memory=memory)
    return Size(
        limits.packet_samples,
        limits.samples,
        limits.components,
        limits.records // 2 - 16,
        limits.metadata,
        min(limits.attachments, WHOLE.attachment),
        limits.attachments,
    )


def head() -> tuple[str, bytes]:
    return "HEAD", f.head(level=2)


def one(
    size: Size,
    codec: bytes,
    parameters: bytes,
    packet: bytes | Build,
    *,
    width: int = 1,
    packets: int | None = None,
    **given: int,
) -> bytes:
    """A track of a codec, and packets of the longest span."""
    span = size.packet // width
    count = size.samples // (span * width) if packets is None else packets
    data = packet if isinstance(packet, bytes) else packet(span)
    fields = {"codec": codec, "component_count": width, "rate_num": 1 << 20} | given
    return f.closed(
        head(),
        ("TRAK", f.trak(f.tlv(1, parameters), **fields)),
        ("DATA", f.cluster(*[(0, span * i, span, data) for i in range(count)])),
        duration_ns=-(-span * count * 10**9 >> 20),
    )


def deflated(data: bytes) -> bytes:
    packer = zlib.compressobj(9, wbits=-15)
    return packer.compress(data) + packer.flush()


def zeros(size: int) -> bytes:
    """A packet of RAWB."""
    packer = zlib.compressobj(9, wbits=-15)
    block = bytes(1 << 20)
    parts = [packer.compress(block[: size - at]) for at in range(0, size, len(block))]
    return b"\1" + b"".join(parts) + packer.flush()


def repeats(span: int) -> bytes:
    """Equal indices that are no constant: each says that it repeats the one before."""
    return encode_predicted(np.full(span, 7, np.int64), Predictor(base=7, repeats=True))


def line(span: int) -> bytes:
    return FIVE + f.varint(span - 1) + b"\2"


def recalled(span: int) -> bytes:
    """Counts, and a correction each that was there before."""
    from hapfmt.codecs.exact import ExactParameters, encode_exact
    from hapfmt.format.track import Affine

    counts = np.full(span, 5, np.int64)
    doubles = np.nextafter(ExactParameters().values(counts, Affine()), 9)
    rest = encode_exact(doubles, ExactParameters(), Affine(), counts, recall=True)
    return b"\3" + CONSTANT + rest


def modelled(span: int) -> bytes:
    """Noise through the longest filter, with coefficients for each 64 ticks."""
    from hapfmt.codecs.noise import NoiseParameters, encode_component

    parameters = NoiseParameters(3, 8)
    gains = [40] * parameters.interval_count(span)
    blocks = [[9] * 32] * parameters.block_count(span)
    return encode_component(gains, blocks, parameters, seed=1)


def many_tracks(size: Size, tlvs: Callable[[int], bytes], packet: bytes, **given: Any) -> bytes:
    """As many as may be, 255 in a chunk, with a packet of one tick each."""

    def payload(numbers: range) -> bytes:
        plain = b"".join(f.track(tlvs(i), first_channel=i, **given) for i in numbers)
        return f.varint(numbers[0]) + f.varint(len(plain)) + deflated(plain)

    runs = [range(i, min(i + 255, size.tracks)) for i in range(0, size.tracks, 255)]
    rows = [(i, 0, 1, packet) for i in range(size.tracks)]
    chunks = [("TRAK", payload(run)) for run in runs]
    return f.closed(head(), *chunks, ("DATA", f.cluster(*rows)), duration_ns=10**6)


def texts(size: Size) -> bytes:
    """Each with every text of 254 bytes."""
    names = b"".join(f.tlv(type_, f.strings("a" * 254)) for type_ in (2, 4, 6, 8, 10, 12, 14))
    return many_tracks(size, lambda _number: f.HOLD + names, FIVE)


def codebooks(size: Size) -> bytes:
    """Each with a codebook of 4096 symbols."""
    parameters = f.quan_parameters(bytes([0xCC]) * 2048, m=2047, r=1)
    return many_tracks(size, lambda _number: f.tlv(1, parameters), b"\0\0", codec=b"QUAN")


def own_codebooks(size: Size) -> bytes:
    """Each with one of its own: two symbols of 4096."""

    def book(number: int) -> bytes:
        skipped = 17 * (number % 240) + 1
        nibbles = [0, 15] * (skipped // 16) + [0, skipped % 16] + [1, 1]
        even = nibbles + [0] * (len(nibbles) % 2)
        return bytes(16 * a + b for a, b in zip(even[::2], even[1::2], strict=True))

    def tlvs(number: int) -> bytes:
        return f.tlv(1, f.quan_parameters(book(number), m=2047, step=1 + number))

    return many_tracks(size, tlvs, b"\0", codec=b"QUAN")


def grids(size: Size) -> bytes:
    """Each with a deadband's grid of its own."""

    def tlvs(number: int) -> bytes:
        return f.tlv(1, f.lpcr_parameters(1, step=number + 1, kn=1, kd=1024))

    return many_tracks(size, tlvs, b"\x10\0\0", codec=b"LPCR")


def packets(size: Size) -> bytes:
    """A cluster of as many packets as may be, of nothing but their rows."""
    count = min(4 * size.chunks, 1 << 17)
    rows = [(0, i, 1, FIVE) for i in range(count)]
    return f.closed(head(), f.TRACK_0, ("DATA", f.cluster(*rows)), duration_ns=count * 10**6)


def bad_packets(size: Size) -> bytes:
    """All of them damaged."""
    count = min(2 * size.chunks, 1 << 17)
    payload = f.table([(0, 0, i, 1, i) for i in range(count)])
    return f.closed(head(), f.TRACK_0, ("DATA", payload, {"crc": 1}))


def index_entries(size: Size) -> bytes:
    """An index that lists a chunk at every byte, behind an attachment that makes room for them."""
    count = ((1 << 24) - 28) // 5 if size is WHOLE else size.chunks
    body = f.file(head(), f.TRACK_0, ("aTTc", b"\1a\0" + bytes(count)))
    payload = f.index([], count=count) + b"HEAD\x08" + b"HEAD\1" * (count - 1)
    index = f.chunk("iNDX", payload, 3)
    return body + index + f.chunk("fOOT", f.foot(len(index)), 4)


def chunks(size: Size, closed: bool = False) -> bytes:
    """Nothing but headers, of a type that nobody knows."""
    build = f.closed if closed else f.file
    return build(head(), f.TRACK_0, *[("xXxx", NONE)] * (2 * size.chunks - size.chunks * closed))


def one_number(size: Size) -> bytes:
    """Each chunk has the number of the one before."""
    return f.file(head(), f.TRACK_0, *[("xXxx", NONE, {"sequence": 1})] * size.chunks)


def bad_payloads(size: Size) -> bytes:
    return f.file(head(), f.TRACK_0, *[("xXxx", b"?", {"crc": 1})] * size.chunks)


def nested(_size: Size) -> bytes:
    """Headers that each promise all that follows."""
    count = 1 << 16
    parts = [
        f.chunk("xXxx", NONE, i + 1, size=f.HEADER * (count - i - 1), crc=1) for i in range(count)
    ]
    return f.file(head()) + b"".join(parts)


def wide_json(inner: bytes) -> Callable[[Size], bytes]:
    def build(size: Size) -> bytes:
        count = (size.json - 16) // (len(inner) + 1)
        payload = b'{"a":[' + b",".join([inner] * count) + b"]}"
        return f.closed(head(), f.TRACK_0, ("mETa", payload))

    return build


def many_json(size: Size) -> bytes:
    """Members of names of their own in many chunks."""
    rows = []
    for i in range(16):
        members: dict[str, Any] = {f"{i}.{j}": {} for j in range(size.json // 16 // 14)}
        rows.append(("mETa", json.dumps(members, separators=(",", ":")).encode()))
    return f.closed(head(), f.TRACK_0, *rows)


def attachments(size: Size) -> bytes:
    """Of nothing, all of one name."""
    return f.closed(head(), f.TRACK_0, *[("aTTc", b"\1a\0")] * size.chunks)


def large_attachments(size: Size) -> bytes:
    content = b"\1a\0" + bytes(size.attachment)
    return f.closed(head(), f.TRACK_0, *[("aTTc", content)] * (size.attached // size.attachment))


def events(size: Size) -> bytes:
    """Packets of nothing but events without a text."""
    events = f.event(0) * min(size.chunks, 1 << 16)
    layers = [(1 + i, 0, 1, events) for i in range(size.chunks >> 13)]
    return f.closed(
        head(),
        f.TRACK_0,
        ("TRAK", f.layer(track_count=len(layers), first=1)),
        ("DATA", f.cluster(*layers)),
        duration_ns=10**6,
    )


def clocks(size: Size) -> bytes:
    """Observations of a clock that does not advance."""
    count = (size.json - 32) // 3
    observed = f.clock([(0, 0, 0)], count=count, track=0) + bytes(3 * (count - 1))
    return f.closed(head(), f.TRACK_0, ("cLOk", observed))


FIVE = f.svarint(5)
CONSTANT = b"\x10\0" + FIVE
LPCR, DEADBAND = f.lpcr_parameters(), f.lpcr_parameters(1, step=1, kn=1, kd=1024)
WORDS = {"number_format": 5, "count_min": 0, "count_max": 0}

FILES: dict[str, Callable[[Size], bytes]] = {
    "KNOT held": lambda s: one(s, b"KNOT", f.knot_parameters(), FIVE),
    "KNOT line": lambda s: one(s, b"KNOT", f.knot_parameters(1), line, packets=1),
    "KNOT of 16 components": lambda s: one(s, b"KNOT", f.knot_parameters(), FIVE * 16, width=16),
    "QUAN": lambda s: one(s, b"QUAN", f.quan_parameters(b"\x10"), NONE),
    "RAWB": lambda s: one(
        s, b"RAWB", f.raw_parameters(4), lambda n: zeros(4 * n), packets=2
    ),
    "RAWB of one byte": lambda s: one(s, b"RAWB", f.raw_parameters(1), zeros),
    "RAWB of words": lambda s: one(
        s, b"RAWB", f.raw_parameters(8), lambda n: zeros(8 * n), **WORDS
    ),
    "LPCR": lambda s: one(s, b"LPCR", LPCR, CONSTANT),
    "LPCR of 16 components": lambda s: one(
        s, b"LPCR", LPCR, b"\3" * 15 + CONSTANT * 16, width=16
    ),
    "LPCR repeated": lambda s: one(s, b"LPCR", LPCR, repeats, packets=2),
    "LPCR on a deadband's grid": lambda s: one(s, b"LPCR", DEADBAND, CONSTANT),
    "coded knots": lambda s: one(s, b"KNOT", f.coded_knot_parameters(), FIVE),
    "LPCX": lambda s: one(s, b"LPCX", f.lpcx_parameters(), b"\3" + CONSTANT),
    "LPCX of digits": lambda s: one(
        s, b"LPCX", f.lpcx_parameters(2, 2), b"\3" + CONSTANT, packets=2
    ),
    "LPCX recalled": lambda s: one(s, b"LPCX", f.lpcx_parameters(), recalled, packets=2),
    "NOIS silent": lambda s: one(s, b"NOIS", f.nois_parameters(), NONE),
    "NOIS": lambda s: one(s, b"NOIS", f.nois_parameters(), modelled, packets=2),
    "texts": texts,
    "codebooks": codebooks,
    "own codebooks": own_codebooks,
    "grids": grids,
    "packets": packets,
    "bad packets": bad_packets,
    "index entries": index_entries,
    "chunks": chunks,
    "chunks in an index": lambda s: chunks(s, closed=True),
    "chunks of one number": one_number,
    "bad payloads": bad_payloads,
    "nested headers": nested,
    "JSON of lists": wide_json(b"[]"),
    "JSON of objects": wide_json(b'{"":0}'),
    "JSON of numbers": wide_json(b"-1e5"),
    "JSON of texts": wide_json(b'"ab"'),
    "JSON in many chunks": many_json,
    "events": events,
    "clocks": clocks,
    "attachments of nothing": attachments,
    "large attachments": large_attachments,
}  # fmt: skip
