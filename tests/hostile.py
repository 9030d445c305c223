"""Small files that ask for much: the most that each codec, list and chunk allows for its bytes."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable

import forge as f

SPAN = 1 << 24
"""Ticks of a packet at any level."""

ROOM = 1 << 24
"""Bytes of a payload at level 2."""

TRACKS = 65_534
NONE = b""


def one(codec: bytes, parameters: bytes, packet: bytes, *, packets: int = 1, width: int = 1,
        **given: int) -> bytes:  # fmt: skip
    """A track of a codec, and packets of the longest span; at level 2."""
    fields = {"codec": codec, "component_count": width} | given
    rows = [(0, SPAN * i, SPAN, packet) for i in range(packets)]
    return f.closed(
        ("HEAD", f.head(level=2)),
        ("TRAK", f.trak(f.tlv(1, parameters), **fields), {"track": 0}),
        ("DATA", f.cluster(*rows)),
        duration_ns=SPAN * packets * 10**6,
    )


def deflated(size: int) -> bytes:
    packer = zlib.compressobj(9, wbits=-15)
    block = bytes(1 << 20)
    parts = [packer.compress(block) for _ in range(size >> 20)]
    return b"\1" + b"".join(parts) + packer.flush()


def coded_repeats() -> bytes:
    """2^24 equal indices that are not a constant: each says that it repeats the one before."""
    import numpy as np

    from hapfmt.codecs.predicted import Predictor, encode_predicted

    return encode_predicted(np.full(SPAN, 7, np.int64), Predictor(base=7, repeats=True))


def many_tracks() -> bytes:
    """As many tracks as there are numbers, each with every text of 254 bytes, said once."""
    long = "a" * 254
    names = b"".join(f.tlv(type_, f.strings(long)) for type_ in (2, 4, 6, 8, 10, 12, 14))
    chunks: list[tuple[str, bytes, dict[str, int]]] = []
    for first in range(0, TRACKS, 255):
        count = min(255, TRACKS - first)
        tlvs = f.HOLD + names
        chunks.append(
            ("TRAK", f.trak(tlvs, track_count=count, first_channel=first), {"track": first})
        )
    return f.closed(("HEAD", f.head(level=2)), *chunks, track_count=TRACKS, duration_ns=0)


def many_codebooks() -> bytes:
    """As many tracks with a codebook of 4096 symbols; nothing of a channel beside."""
    book = bytes([0xCC]) * 2048
    parameters = f.quan_parameters(book, m=2047, r=1)
    chunks: list[tuple[str, bytes, dict[str, int]]] = []
    for first in range(0, TRACKS, 255):
        count = min(255, TRACKS - first)
        payload = f.trak(
            f.tlv(1, parameters), codec=b"QUAN", track_count=count, first_channel=first
        )
        chunks.append(("TRAK", payload, {"track": first}))
    chunks.append(("DATA", f.cluster(*[(i, 0, 1, b"\0\0") for i in range(TRACKS)]), {}))
    return f.closed(("HEAD", f.head(level=2)), *chunks, track_count=TRACKS, duration_ns=10**6)


def many_grids() -> bytes:
    """As many tracks, each with a deadband's grid of its own."""
    chunks: list[tuple[str, bytes, dict[str, int]]] = []
    for first in range(0, TRACKS, 255):
        count = min(255, TRACKS - first)
        setups = [
            f.lpcr_parameters(1, step=1 + (first + i) % 9999, kn=1, kd=1024) for i in range(count)
        ]
        tlvs = f.tlv(5, f.setups([(b"LPCR", setups)], range(count)))
        payload = f.trak(tlvs, codec=b"LPCR", track_count=count, first_channel=first)
        chunks.append(("TRAK", payload, {"track": first}))
    rows = [(i, 0, 1, b"\x10\0\0") for i in range(TRACKS)]
    return f.closed(
        ("HEAD", f.head(level=2)), *chunks, ("DATA", f.cluster(*rows)),
        track_count=TRACKS, duration_ns=10**6,
    )  # fmt: skip


def packets() -> bytes:
    """A cluster of as many packets as may be, of nothing but their rows."""
    rows = [(0, i, 1, f.KNOT_DATA) for i in range(1 << 17)]
    return f.closed(
        ("HEAD", f.head(level=2)), f.TRACK_0, ("DATA", f.cluster(*rows)), duration_ns=10**6 << 17
    )


def index_entries() -> bytes:
    """An index that lists a chunk at every byte, behind an attachment that makes room for them."""
    count = (ROOM - 28) // 5
    rows = b"HEAD\0" + b"HEAD\1" * (count - 1)
    body = f.file(("HEAD", f.head(level=2)), f.TRACK_0, ("aTTc", b"\1a\0" + bytes(count)))
    at = len(body)
    payload = f.index([], count=count) + rows
    body += f.chunk("iNDX", payload, 3)
    return body + f.chunk("fOOT", f.foot(at, len(body) + 64, 0, 1), 4)


def empty_chunks(count: int = 1 << 18) -> bytes:
    """Chunks of nothing but a header, of a type that nobody knows."""
    return f.file(("HEAD", f.head(level=2)), f.TRACK_0, *[("xXxx", NONE)] * count)


def same_sequence(count: int = 1 << 18) -> bytes:
    """Each chunk has the number of the one before: a finding each."""
    return f.file(("HEAD", f.head(level=2)), f.TRACK_0, *[("xXxx", NONE, {"sequence": 1})] * count)


def bad_payloads(count: int = 1 << 18) -> bytes:
    return f.file(("HEAD", f.head(level=2)), f.TRACK_0, *[("xXxx", b"?", {"crc": 1})] * count)


def nested(count: int = 1 << 16) -> bytes:
    """Headers that each promise all that follows."""
    out = f.file(("HEAD", f.head(level=2)))
    for i in range(count):
        out += f.chunk("xXxx", NONE, i + 1, size=32 * (count - i - 1), crc=1)
    return out


def wide_json(inner: bytes) -> Callable[[], bytes]:
    def build() -> bytes:
        count = (ROOM - 16) // (len(inner) + 1)
        payload = b'{"a":[' + b",".join([inner] * count) + b"]}"
        return f.closed(("HEAD", f.head(level=2)), f.TRACK_0, ("mETa", payload))

    return build


def many_json() -> bytes:
    """Members of names of their own in many chunks."""
    rows = []
    for i in range(16):
        members = {f"{i}.{j}": [] for j in range(1 << 15)}
        rows.append(("mETa", json.dumps(members, separators=(",", ":")).encode()))
    return f.closed(("HEAD", f.head(level=2)), f.TRACK_0, *rows)


def attachments(count: int = 1 << 16) -> bytes:
    """Attachments of nothing, all of one name."""
    return f.closed(("HEAD", f.head(level=2)), f.TRACK_0, *[("aTTc", b"\1a\0")] * count)


def large_attachments() -> bytes:
    return f.closed(
        ("HEAD", f.head(level=2)), f.TRACK_0, *[("aTTc", b"\1a\0" + bytes(ROOM - 3))] * 6
    )


FIVE = f.svarint(5)
CONSTANT = b"\x10\0" + FIVE
FILES: dict[str, Callable[[], bytes]] = {
    "KNOT held": lambda: one(b"KNOT", f.knot_parameters(), FIVE),
    "KNOT line": lambda: one(b"KNOT", f.knot_parameters(1), FIVE + f.varint(SPAN - 1) + b"\2"),
    "KNOT of 16 packets": lambda: one(b"KNOT", f.knot_parameters(), FIVE, packets=16),
    "KNOT of 16 components": lambda: one(b"KNOT", f.knot_parameters(), FIVE * 16, width=16),
    "QUAN of one symbol": lambda: one(b"QUAN", f.quan_parameters(b"\x10"), NONE),
    "QUAN of runs": lambda: one(
        b"QUAN", f.quan_parameters(b"\x01\x11"[:0] + b"\x10\x0f\x06\x10"[:0] + b"\x10", r=0), NONE
    ),
    "RAWB inflated": lambda: one(b"RAWB", f.raw_parameters(4), deflated(SPAN * 4)),
    "RAWB of 8 bytes": lambda: one(
        b"RAWB", f.raw_parameters(8), deflated(SPAN * 8), number_format=5, count_min=0, count_max=0
    ),
    "LPCR constant": lambda: one(b"LPCR", f.lpcr_parameters(), CONSTANT),
    "LPCR of 16 constants": lambda: one(
        b"LPCR", f.lpcr_parameters(), b"\3" * 15 + CONSTANT * 16, width=16
    ),
    "LPCR repeated": lambda: one(b"LPCR", f.lpcr_parameters(), coded_repeats()),
    "LPCR on a deadband's grid": lambda: one(
        b"LPCR", f.lpcr_parameters(1, step=1, kn=1, kd=1024), CONSTANT
    ),
    "KNTE of one knot": lambda: one(b"KNTE", f.knte_parameters(), FIVE),
    "LPCX constant": lambda: one(b"LPCX", f.lpcx_parameters(), b"\3" + CONSTANT),
    "LPCX of decimals": lambda: one(b"LPCX", f.lpcx_parameters(3, 2), b"\3" + CONSTANT),
    "tracks": many_tracks,
    "codebooks": many_codebooks,
    "grids": many_grids,
    "packets": packets,
    "index entries": index_entries,
    "empty chunks": empty_chunks,
    "one sequence number": same_sequence,
    "bad payloads": bad_payloads,
    "nested headers": nested,
    "JSON of lists": wide_json(b"[]"),
    "JSON of objects": wide_json(b"{}"),
    "JSON of numbers": wide_json(b"-1e5"),
    "JSON of texts": wide_json(b'"ab"'),
    "JSON in many chunks": many_json,
    "attachments of nothing": attachments,
    "large attachments": large_attachments,
}  # fmt: skip
