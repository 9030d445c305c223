"""Bytes of another recording of the same set-up: none of them may pass as this file's (14.1)."""

from __future__ import annotations

from collections.abc import Iterator

import forge as f
import wreck as w
from case import Case
from wreck import ALL, HEAD, STEADY, THREE, wrecked

OTHER_ID = 0x0900000000000009
DATA = STEADY.data
TRAK_PLACE, INDEX, FOOT = STEADY.of("TRAK"), STEADY.of("iNDX"), STEADY.of("fOOT")
SECOND = STEADY.of("DATA", 1)
RULES = ["CHK-003", "CHK-004", "DAT-004", "REC-001", "REC-013"]
GAP = ((0, 4), (8, 12))


def strange(packet: w.Packet) -> w.Packet:
    """The same span of the other recording, in as many bytes."""
    track, start, span, _ = packet
    return track, start, span, w.knots(track + 5, start, span)


def other_of(laid: w.Laid, packets: dict[int, list[w.Packet]]) -> bytes:
    """The other recording, byte for byte of the same shape; ``packets`` by sequence number."""
    out = [f.SIGNATURE]
    for place in laid.places:
        payload = laid.data[place.payload : place.stop]
        if place.type == "DATA":
            rows = map(strange, packets[place.sequence])
            payload = f.cluster(*rows, file_id=OTHER_ID)
        out.append(f.chunk(place.type, payload, place.sequence, file_id=OTHER_ID))
    return b"".join(out)


def steady_packets() -> dict[int, list[w.Packet]]:
    return dict(zip((2, 3, 4), w.clusters(0, 4, 8), strict=True))


OTHER = other_of(STEADY, steady_packets())


def cases() -> Iterator[Case]:
    assert len(OTHER) == len(DATA)
    yield from payloads()
    yield from blocks()
    yield from choices()


def payloads() -> Iterator[Case]:
    inside = w.over(DATA, SECOND.payload, OTHER[SECOND.payload : SECOND.stop])
    yield wrecked(
        "payload-of-another-file",
        "Behind a header is the payload of the same cluster of another file: none of it passes.",
        RULES, "framing/other-file", inside, kept=dict.fromkeys(range(3), GAP),
        damages=[
            ("bad-payload", SECOND.at, SECOND.size),
            ("bad-table", SECOND.payload, SECOND.size - f.HEADER),
        ],
        lost=[(track, 4, 8) for track in range(3)],
    )  # fmt: skip
    row = STEADY.row(1, 4)
    mixed = w.over(DATA, row.entry, OTHER[row.entry : row.entry_stop])
    mixed = w.over(mixed, row.at, OTHER[row.at : row.stop])
    yield wrecked(
        "packet-of-another-file",
        "An entry and its packet come from another file: they fit each other, and are lost.",
        RULES, "framing/other-file", mixed, kept={0: ALL, 1: GAP, 2: ALL}, lost=[(1, 4, 8)],
        damages=[("bad-payload", SECOND.at, SECOND.size), ("bad-packet", row.at, row.size)],
    )  # fmt: skip
    yield wrecked(
        "cluster-of-another-file", "A whole chunk of another file is in place of a cluster.",
        RULES, "framing/other-file", w.over(DATA, SECOND.at, OTHER[SECOND.at : SECOND.stop]),
        kept=dict.fromkeys(range(3), GAP), lost=[(track, 4, 8) for track in range(3)],
        damages=[
            ("garbage", SECOND.at, SECOND.size), ("other-file", SECOND.at, 0),
            ("missing-chunk", SECOND.stop, 0),
        ],
    )  # fmt: skip


def blocks() -> Iterator[Case]:
    twice = w.lay(HEAD, THREE, *w.clusters(0, 4, 8), HEAD, THREE)
    start = twice.of("DATA")
    front = other_of(twice, steady_packets())[: start.at]
    yield wrecked(
        "front-of-another-file",
        "HEAD and TRAK of another file are in front: the copies at the end describe this one.",
        RULES, "framing/other-file", w.over(twice.data, 0, front),
        damages=[
            ("garbage", 8, start.at - 8), ("other-file", 8, 0), ("missing-chunk", start.at, 0),
        ],
    )  # fmt: skip
    yield wrecked(
        "tail-of-another-file", "Index and footer come from another file.",
        RULES, "framing/other-file", w.over(DATA, INDEX.at, OTHER[INDEX.at :]),
        damages=[
            ("garbage", INDEX.at, len(DATA) - INDEX.at), ("other-file", INDEX.at, 0),
            ("not-closed", len(DATA), 0),
        ],
        lost=[(track, 12, None) for track in range(3)],
    )  # fmt: skip


def choices() -> Iterator[Case]:
    """Which id is that of the file (procedure identify)."""
    long = [w.packet(track, 0, 100) for track in range(3)]
    one = w.lay(HEAD, THREE, long, HEAD, THREE)
    other = other_of(one, {2: long})
    place = one.of("DATA")
    last = one.row(2, 0)
    tail = w.over(one.data, last.at, other[last.at :])
    yield wrecked(
        "cluster-cut-by-another-file",
        "From the last packet of the only cluster on, all is of another file. More of its chunks "
        "are intact, but more bytes of this file hold.",
        RULES, "framing/other-file", tail, kept={0: ((0, 100),), 1: ((0, 100),), 2: ()},
        damages=[
            ("bad-payload", place.at, place.size), ("bad-packet", last.at, last.size),
            ("garbage", place.stop, len(tail) - place.stop), ("other-file", place.stop, 0),
            ("not-closed", len(tail), 0),
        ],
        lost=[(2, 0, None), (0, 100, None), (1, 100, None)],
    )  # fmt: skip
    large = w.lay(HEAD, THREE, [w.packet(0, 0, 1000)], *w.clusters(1000), close=False)
    place, row = large.of("DATA"), large.row(0, 0)
    small = f.chunk("TRAK", THREE[1], 1, file_id=OTHER_ID) + b"".join(
        f.chunk("DATA", f.cluster(w.packet(0, n), file_id=OTHER_ID), n, file_id=OTHER_ID)
        for n in range(2, 24)
    )
    at = row.at + 50
    assert at + len(small) < row.stop
    kept = dict.fromkeys(range(3), ((1000, 1004),))
    gone = [(track, 0, 1000) for track in range(3)]
    open_end = ("not-closed", len(large.data), 0)
    yield wrecked(
        "chunks-of-another-file-within",
        "A packet is overwritten by a TRAK and clusters of another file. They are not counted, "
        "since the next header is where the damaged payload ends.",
        RULES, "framing/other-file", w.over(large.data, at, small), kept=kept, lost=gone,
        damages=[
            ("bad-payload", place.at, place.size), ("other-file", at, 0),
            ("bad-table", place.payload, place.size - f.HEADER), open_end,
        ],
    )  # fmt: skip
    strangers = other_of(large, {2: [w.packet(0, 0, 1000)], 3: w.clusters(1000)[0]})
    strangers = strangers[place.at : place.stop]
    damages = [("garbage", place.at, place.size), ("other-file", place.at, 0),
               ("missing-chunk", place.stop, 0)]  # fmt: skip
    yield wrecked(
        "most-bytes-of-a-file-without-tracks",
        "A file that was not closed; most bytes are of another file, of which no TRAK is there.",
        [*RULES, "REC-013"], "framing/other-file", w.over(large.data, place.at, strangers),
        kept=kept, damages=[*damages, open_end], lost=gone,
    )  # fmt: skip
    copied = w.lay(HEAD, THREE, [w.packet(0, 0, 1000)], THREE, *w.clusters(1000))
    first, stop = copied.of("DATA"), copied.of("DATA", 1).at
    packets = {2: [w.packet(0, 0, 1000)], 4: w.clusters(1000)[0]}
    strangers = other_of(copied, packets)[first.at : stop]
    yield wrecked(
        "most-bytes-of-another-file",
        "Most bytes are of a TRAK and a cluster of another file; HEAD and footer choose the id.",
        [*RULES, "REC-013"], "framing/other-file", w.over(copied.data, first.at, strangers),
        kept=kept, lost=gone,
        damages=[
            ("garbage", first.at, stop - first.at), ("other-file", first.at, 0),
            ("missing-chunk", stop, 0),
        ],
    )  # fmt: skip
