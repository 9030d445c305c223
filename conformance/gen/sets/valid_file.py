"""Whole small files: the worked examples, and what clauses 5 and 6 allow."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from functools import partial
from math import cos, pi
from typing import Any

import examples
import forge as f
from case import Case
from facts import Event, Layer, Packet, Track, case_of, closed_at, digest, nanoseconds
from tracks import double_bits

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

FIVES = Track(packets=[Packet(0, [5, 5, 5, 5], f.KNOT_DATA)])
HEAD = ("HEAD", f.head())


def cases() -> Iterator[Case]:
    yield from worked_examples()
    yield from heads()
    yield from clusters()
    yield from repeated()
    yield from indexes()
    yield from newer()


def worked_examples() -> Iterator[Case]:
    """The facts are those of the text next to the listings."""
    hold = Track(
        low=0, high=255, about={"label": "force", "unit": "N"}, calibration=(1, 0, 100),
        packets=[Packet(0, [100] * 3 + [125] * 5, b"")],
    )  # fmt: skip
    slow = Track(
        kind="lf", rate=(500, 1), low=-32, high=31,
        packets=[Packet(0, [10, 8, 5, 9, 13, 17], b""), Packet(8, [17, 17], b"")],
    )  # fmt: skip
    fast = Track(
        id=1, base=0, kind="hf", codec="QUAN", rate=(500, 1), low=-2, high=1,
        packets=[Packet(0, [0, 1, -2, 0, 0, 0], b""), Packet(8, [0, 0], b"")],
    )  # fmt: skip
    still = Track(low=0, high=1, packets=[Packet(0, [1] * 4, b"")])
    touch = Layer(
        label="touch",
        packets=[(1500, 501, [Event(1500, 0, None, "go"), Event(2000, 1000, 0, "µm")])],
    )
    seen = [[0, "5000000000", "1000"], [4, "5004000160", "1000"]]
    clocks = [{"track": 0, "name": "pc", "observations": seen}]
    rest = Track(low=0, high=255, packets=[Packet(0, [8] * 4, b"")])
    busy = Track(
        id=1, codec="RAWB", low=-100, high=100, continues=0, packets=[Packet(4, [9, -7, 5], b"")]
    )
    squares, halves = [0, 1, 4, 9, 16, 25, 36, 49], [0, 1, 2, 5, 8, 13, 18, 25]
    levels = [1, -6, 0, 0, 0, 0, 0, -1, 8, 0, 0, 0, 1]
    coarse = Track(
        codec="QUAN", low=-24, high=24, packets=[Packet(0, [3 * level for level in levels], b"")]
    )
    vector = Track(
        codec="RAWB", low=-300, high=300, width=2,
        packets=[Packet(0, [(1, 0), (-2, 5), (300, -300)], b"")],
    )  # fmt: skip
    doubles = Track(
        id=1, codec="RAWB", number_format="binary64", channel=2, joined=True,
        packets=[Packet(0, [0x3FB999999999999A] * 12, b"")],
    )  # fmt: skip
    one = [500, 505, 510, 515, 520, 505, 490, 493, 497, 500]
    two = [550, 545, 540, 535, 530, 530, 530, 520, 510, 500]
    lines = Track(
        low=0, high=1000, width=2, packets=[Packet(0, list(zip(one, two, strict=True)), b"")]
    )
    pair = Track(
        codec="LPCR", width=2, packets=[
            Packet(0, list(zip(squares, halves, strict=True)), b""), Packet(8, [(5, -5)] * 3, b""),
        ],
    )  # fmt: skip
    rough = Track(
        id=1, codec="LPCR", low=-500, high=500, channel=2,
        packets=[Packet(0, [0, 41, 82, 82, -41], b"")],
    )  # fmt: skip
    exact = [0.1, 0.2, 0.1 * 3, 0.1 * 3, 0.1 * 7, 0.1 * 3]
    tenths = Track(
        codec="LPCX", low=0, high=10, calibration=(1, 0, 10),
        packets=[Packet(0, [1, 2, 3, 3, 7, 3], b"", exact=[double_bits(x) for x in exact])],
    )  # fmt: skip
    x = [0.6, 0.6, 1.0, 0.2, 0.5, 0.8]
    y = x[:1]
    for now in x[1:]:
        y.append(y[-1] + 0.3 * (now - y[-1]))
    filtered = Track(
        codec="LPCX", low=0, high=10, width=2, calibration=((1, 0, 10),) * 2,
        packets=[Packet(
            0, [(round(10 * a), round(10 * b)) for a, b in zip(x, y, strict=True)], b"",
            exact=[(double_bits(a), double_bits(b)) for a, b in zip(x, y, strict=True)],
        )],
    )  # fmt: skip
    mixed = Track(
        codec="MDCT", low=0, high=200,
        packets=[Packet(0, mixed_blocks(), b""), Packet(48, [100] * 4, b"")],
    )  # fmt: skip
    noise = [2, 4, 4, 5, 8, 12, 13, 10, 5, -2, -5, -11, -21, -30, -38, -40, -36, -33, -30, -28]
    calm = Track(kind="lf", packets=[Packet(0, [7] * 20, b"")])
    model = Track(id=1, codec="NOIS", kind="hf", base=0, packets=[Packet(0, noise, b"")])
    axes = [
        {"label": f"f{axis}", "unit": "N", "quantity": "force", "axis": axis, "group": "tip",
         "body_site": "index finger", "device": "stylus"}
        for axis in "xy"
    ]  # fmt: skip
    forces = Track(
        low=0, high=1000, width=2, about=axes, calibration=((1, 0, 1000), (1, -500, 1000)),
        packets=[Packet(0, [(100, 600)] * 4, b"")],
    )  # fmt: skip
    sevens = Track(id=1, high=255, low=0, channel=2, packets=[Packet(0, [7] * 4, b"")])
    gap = Track(low=0, high=255, packets=[Packet(0, [5, 5], b""), Packet(4, [6], b"")])
    points = [[0, str(1_700_000_000 * 10**9)], [1000, str(1_700_000_000 * 10**9 + 1_000_040_000)]]
    facts: dict[str, tuple[str, list[str], list[Track], dict[str, Any]]] = {
        "hold": ("Held knots, calibrated.", ["FIL-001", "DAT-004", "CNV-001"], [hold], {}),
        "residual": (
            "Lines, texture, a gap.", ["DEC-001", "CNV-001"], [slow, fast], {},
        ),
        "marks": (
            "Events and another clock.", ["EVT-004", "CLK-001"], [still],
            {"layers": [touch], "clocks": clocks},
        ),
        "continued": ("A channel in two tracks.", ["TRK-016", "TRK-018"], [rest, busy], {}),
        "quantised": ("Runs and escapes of QUAN.", ["QNT-001", "QNT-003"], [coarse], {}),
        "raw": ("Counts as they are, doubles in DEFLATE.", ["RAW-001"], [vector, doubles], {}),
        "coded": ("Knots of two components, coded.", ["KNT-001"], [lines], {}),
        "predicted": ("Differences, a reference, a grid.", ["LPC-002"], [pair, rough], {}),
        "exact": ("Doubles with their counts.", ["EXA-007"], [tenths], {}),
        "linear": ("A channel filtered from another.", ["EXA-002"], [filtered], {}),
        "transformed": ("Two blocks, and where they meet.", ["MDC-001", "MDC-002"], [mixed], {}),
        "synthetic": ("A texture from a model.", ["NOI-001"], [calm, model], {}),
        "described": (
            "Every TLV of HEAD and of TRAK.", ["HED-002", "TLV-004", "TRK-020"], [forces, sevens],
            {"head": {"uuid": "6ba7b8109dad11d180b400c04fd430c8", "epoch_ns": points[0][1],
                      "epoch_uncertainty_ns": "1000000"}},
        ),
        "digests": (
            "Two indexes, a digest, a map and an attachment.", ["DGS-001", "IDX-002"], [gap],
            {
                "metadata": {"subject": 7},
                "maps": [{"track": 0, "name": "UTC", "points": points}],
                "attachments": [attached("a.txt", "text/plain", b"hello")],
            },
        ),
    }  # fmt: skip
    for name, (about_, ids, tracks, more) in facts.items():
        data = examples.MAKERS[name]().data
        yield valid(f"example-{name}", about_, ids, *tracks, data=data, **more)


def mixed_blocks() -> list[int]:
    """24 and 20 times cosines, with a window where they meet: with real numbers, rounded once."""
    part = pi / 128
    one = [24 * cos((2 * j + 1) * part) for j in range(32)]
    two = [20 * cos(3 * (2 * j + 1) * part) for j in range(32)]
    x = [*one, *two]
    for i in range(16):
        w, z = cos((31 - 2 * i) * part), cos((33 + 2 * i) * part)
        x[32 + i] = w * two[i] - z * one[31 - i]
        x[31 - i] = w * one[31 - i] + z * two[i]
    return [100 + round(each) for each in x[:48]]


def attached(name: str, media_type: str, content: bytes) -> dict[str, Any]:
    return {
        "name": name, "media_type": media_type, "size": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
    }  # fmt: skip


def identity(file_id: int) -> str:
    return f"0x{file_id:016x}"


def uuid_of(file_id: int) -> str:
    """That of a file without one, without hyphens."""
    digits = f"{file_id:016x}"
    return digits[:12] + "8" + digits[12:15] + "8" + digits[15] + "0" * 14


def known(file_id: int = 7, **members: Any) -> dict[str, Any]:
    """The member ``head``."""
    return {
        "major": 1, "minor": 0, "level": 1, "file_id": identity(file_id),
        "uuid": uuid_of(file_id), "epoch_ns": None, "epoch_uncertainty_ns": None,
    } | members  # fmt: skip


def heads() -> Iterator[Case]:
    yield valid(
        "minimal", "A head, one track, one constant packet, an index and a footer.",
        ["FIL-001", "FIL-002", "FIL-003", "CHK-002", "CHK-003", "CHK-005", "DAT-004"],
        FIVES, head=known(),
    )  # fmt: skip
    uuid = bytes(range(16, 32))
    yield valid(
        "head-uuid-and-epoch", "A UUID in network order, and an epoch known to 1 ms.", ["HED-002"],
        FIVES,
        file={"head": f.head(f.tlv(2, uuid) + f.epoch(1_700_000_000_000_000_001, 10**6))},
        head=known(uuid=uuid.hex(), epoch_ns="1700000000000000001", epoch_uncertainty_ns="1000000"),
    )  # fmt: skip
    yield uncommon(
        "head-epoch-before-1970", "An epoch below zero, known exactly.", ["HED-002"],
        FIVES, file={"head": f.head(f.epoch(-(2**63), 0))},
        head=known(epoch_ns=str(-(2**63)), epoch_uncertainty_ns="0"),
    )  # fmt: skip
    yield uncommon(
        "head-epoch-uncertain", "An epoch whose uncertainty is 2^63 - 1 ns.", ["HED-002"],
        FIVES, file={"head": f.head(f.epoch(2**63 - 1, 2**63 - 1))},
        head=known(epoch_ns=str(2**63 - 1), epoch_uncertainty_ns=str(2**63 - 1)),
    )  # fmt: skip
    yield valid(
        "head-uuid", "A UUID, and no epoch.", ["HED-002"],
        FIVES, file={"head": f.head(f.tlv(2, uuid))}, head=known(uuid=uuid.hex()),
    )  # fmt: skip
    yield uncommon(
        "head-uuid-of-zeros", "A UUID of zeros is a UUID, and not that of the file id.",
        ["HED-002"],
        FIVES, file={"head": f.head(f.tlv(2, bytes(16)))}, head=known(uuid="0" * 32),
    )  # fmt: skip
    yield valid(
        "head-epoch", "An epoch, and the UUID of the file id.", ["HED-002"],
        FIVES, file={"head": f.head(f.epoch(1, 2))},
        head=known(epoch_ns="1", epoch_uncertainty_ns="2"),
    )  # fmt: skip
    yield valid(
        "head-encoder", "The program that encoded the recording, and its version.", ["CNV-004"],
        FIVES, file={"head": f.head(f.tlv(6, "tast µ 1.0".encode()))}, head=known(),
    )  # fmt: skip
    yield uncommon(
        "head-all-tlvs", "UUID, epoch, program and unknown ancillary TLVs in one HEAD.",
        ["HED-002", "TLV-001", "TLV-003"],
        FIVES,
        file={"head": f.head(f.tlv(0, b"?") + f.tlv(2, uuid) + f.epoch(-1, 0) + f.tlv(6, b"")
                             + f.tlv(8, b"") + f.tlv(65534, bytes(300)))},
        head=known(uuid=uuid.hex(), epoch_ns="-1", epoch_uncertainty_ns="0"),
    )  # fmt: skip
    yield valid(
        "head-level-2", "A file of level 2 that level 1 would do for.", ["HED-004", "LIM-001"],
        FIVES, level=2, head=known(level=2),
    )  # fmt: skip
    for name, file_id in (
        ("zero", 0), ("all-ones", 2**64 - 1), ("of-33-bits", 2**32 + 7),
        ("of-16-digits", 0x0123456789ABCDEF),
    ):  # fmt: skip
        yield uncommon(
            f"file-id-{name}", "A file id like any other, and the UUID that follows from it.",
            ["CHK-003", "CHK-004", "DAT-004"],
            FIVES, data=with_id(file_id), head=known(file_id),
        )  # fmt: skip
    yield uncommon(
        "no-tracks", "A head, an index and a footer.", ["FIL-003", "FOT-002"],
        head=known(),
    )  # fmt: skip
    for set_, name, about, more in (
        (valid, "no-index", "A closed file without an index.", {}),
        (uncommon, "no-index-and-metadata", "A closed file without an index, with metadata.",
         {"more": [("mETa", b'{"a":1}')]}),
        (uncommon, "no-index-two-tracks", "A closed file without an index whose TRAK is late.",
         {"late": [1]}),
    ):  # fmt: skip
        rows = [FIVES, Track(id=1, channel=1, packets=[piece(0, 3, cluster=1)])]
        metadata = {"a": 1} if "more" in more else None
        yield set_(
            name, about, ["FOT-002", "FIL-003"], *rows[: 1 + ("late" in more)],
            file={"indexed": False} | more, metadata=metadata,
        )  # fmt: skip
    yield uncommon(
        "no-index-no-tracks", "A head and a footer.", ["FIL-003", "FOT-002"],
        data=f.closed(HEAD, indexed=False), head=known(),
    )  # fmt: skip


def with_id(file_id: int) -> bytes:
    """The minimal file under another file id."""
    data = f.cluster((0, 0, 4, f.KNOT_DATA), file_id=file_id)
    return f.closed(HEAD, f.TRACK_0, ("DATA", data), file_id=file_id)


def piece(start: int, value: int, span: int = 4, cluster: int = 0) -> Packet:
    return Packet(start, [value] * span, f.svarint(value), cluster)


def clusters() -> Iterator[Case]:
    yield valid(
        "clusters", "Three clusters of two tracks; packets that touch are one span.",
        ["DAT-002", "DAT-005", "DAT-006"],
        Track(packets=[piece(0, 1), piece(4, 2, 3, 1), piece(7, 3, 1, 2)]),
        Track(id=1, channel=1, packets=[piece(0, 4), piece(4, 5, 2, 1), piece(6, 6, 2, 2)]),
    )  # fmt: skip
    yield valid(
        "packets-in-one-cluster", "Several packets of each track in one cluster, by track, start.",
        ["DAT-002", "DAT-005"],
        Track(packets=[piece(0, 1, 2), piece(2, 2, 1), piece(9, 3, 4)]),
        Track(id=1, channel=1, packets=[piece(3, 4, 1), piece(4, 5, 2)]),
    )  # fmt: skip
    yield valid(
        "cluster-in-two-chunks", "One stretch of time in two DATA chunks, a track in each.",
        ["DAT-006"],
        Track(packets=[piece(0, 1)]), Track(id=1, channel=1, packets=[piece(0, 2, cluster=1)]),
    )  # fmt: skip
    yield valid(
        "gaps", "Gaps before the first packet, between packets and between clusters.",
        ["DEC-003"],
        Track(packets=[piece(3, 1), piece(8, 2, 1), piece(20, 3, 2, 1)]),
    )  # fmt: skip
    yield uncommon(
        "clusters-out-of-time", "A later cluster of another track lies earlier in time.",
        ["DAT-006", "IDX-002"],
        Track(packets=[piece(100, 1)]), Track(id=1, channel=1, packets=[piece(0, 2, cluster=1)]),
    )  # fmt: skip
    yield uncommon(
        "last-tick", "A packet that ends at tick 2^48; the duration is the largest i64.",
        ["DAT-003", "FOT-002", "IDX-002"],
        Track(packets=[piece(2**48 - 4, 5)]),
        Track(id=1, channel=1, rate=(1, 86400), packets=[piece(2**48 - 1, 6, 1)]),
    )  # fmt: skip
    yield valid(
        "track-described-late", "A track is described after the first cluster, before its packets.",
        ["TRK-001"],
        Track(packets=[piece(0, 1), piece(4, 2, cluster=1)]),
        Track(id=1, channel=1, packets=[piece(4, 3, cluster=1)]),
        file={"late": [1]},
    )  # fmt: skip


def repeated() -> Iterator[Case]:
    two = Track(id=1, channel=1, packets=[piece(0, -7)])
    yield valid(
        "descriptions-repeated", "HEAD and all TRAK chunks are repeated before the end.",
        ["HED-001", "TRK-003"],
        FIVES, two, file={"more": [HEAD, FIVES.chunk, two.chunk]},
    )  # fmt: skip


def entry(chunk: Sequence[Any], at: int, times: tuple[int, int]) -> tuple[str, int, int, int]:
    return (chunk[0], at, *(times if chunk[0] == "DATA" else (0, 0)))


class Growing:
    """A file chunk by chunk, with indexes and footers of any kind."""

    def __init__(self, *chunks: tuple[Any, ...]) -> None:
        self.data, self.sequence = f.SIGNATURE, 0
        self.rows: list[tuple[str, int, int, int]] = []
        self.indexes: list[int] = []
        for chunk in chunks:
            self.add(*chunk)

    def add(self, *chunk: Any, times: tuple[int, int] = (0, 0)) -> None:
        self.rows.append(entry(chunk, len(self.data), times))
        self.data += f.chunk(*chunk, self.sequence)
        self.sequence += 1

    def packet(self, packet: Packet) -> None:
        self.add(*data(packet), times=(packet.start, packet.stop))

    def index(self, previous: int = 0) -> None:
        """Of all chunks from there on."""
        rows = [row for row in self.rows if row[1] >= previous]
        self.indexes.append(len(self.data))
        first = len(self.rows) - len(rows)
        self.add("iNDX", f.index(rows, previous=previous, first=first))

    def foot(self, duration_ns: int) -> None:
        distance = len(self.data) - self.indexes[-1] if self.indexes else 0
        self.add("fOOT", f.foot(distance, duration_ns))


def data(packet: Packet) -> tuple[str, bytes]:
    return "DATA", f.cluster((0, packet.start, packet.span, packet.body))


def indexes() -> Iterator[Case]:
    packets = [piece(0, 1), piece(4, 2), piece(8, 3)]
    track = Track(packets=packets)
    chain = Growing(HEAD, track.chunk)
    for packet in packets:
        chain.packet(packet)
        chain.index(*chain.indexes[-1:])
    chain.foot(nanoseconds(12, (1000, 1)))
    yield valid(
        "index-chain", "Three indexes, each of what came since the one before.",
        ["IDX-002", "FOT-002"],
        track, data=chain.data,
    )  # fmt: skip
    again = Growing(HEAD, track.chunk)
    for packet in packets:
        again.packet(packet)
        again.index()
    again.foot(nanoseconds(12, (1000, 1)))
    yield uncommon(
        "index-of-all-again", "Three indexes, each of all chunks before it.",
        ["IDX-002"],
        track, data=again.data,
    )  # fmt: skip
    grown = Growing(HEAD, track.chunk)
    for packet in packets:
        grown.packet(packet)
        grown.add("dGST", f.digests(digest(track, packets[: packets.index(packet) + 1])))
        grown.index(*grown.indexes[-1:])
        grown.foot(nanoseconds(packet.stop, (1000, 1)))
    yield valid(
        "appended", "Three times closed: the last footer counts, and the last digest.",
        ["FOT-002", "DGS-002", "DGS-003", "FIL-003"],
        track, data=grown.data,
    )  # fmt: skip
    bare = Growing(HEAD, track.chunk)
    for packet in packets:
        bare.packet(packet)
        bare.foot(nanoseconds(packet.stop, (1000, 1)))
    yield uncommon(
        "appended-without-index", "Three times closed, each time without an index.",
        ["FOT-002", "FIL-003"],
        track, data=bare.data,
    )  # fmt: skip
    later = Growing(HEAD, track.chunk)
    for packet in packets:
        later.packet(packet)
        if packet is packets[1]:
            later.index()
        later.foot(nanoseconds(packet.stop, (1000, 1)))
    yield uncommon(
        "appended-behind-an-index",
        "Closed without an index, with one, and with what no index lists before the footer.",
        ["FOT-002", "FIL-003"],
        track, data=later.data,
    )  # fmt: skip
    more = Track(id=1, channel=1, packets=[piece(0, -4, 6)])
    joined = Growing(HEAD)
    for each in (track, more):
        joined.add(*each.chunk)
        rows = [(each.id, p.start, p.span, p.body) for p in each.packets]
        joined.add("DATA", f.cluster(*rows), times=(0, each.packets[-1].stop))
        joined.index(*joined.indexes[-1:])
        joined.foot(nanoseconds(12, (1000, 1)))
    yield uncommon(
        "appended-track", "A track that was described and filled after the file had been closed.",
        ["FOT-002", "TRK-010", "TRK-001"],
        track, more, data=joined.data,
    )  # fmt: skip
    chunks = [HEAD, track.chunk, *map(data, packets)]
    loose = [(0, 10**9), (0, 2**53 - 1), (7, 10**6)]
    yield uncommon(
        "index-loose-times", "An index whose times are wider than its clusters.", ["IDX-002"],
        track, data=closed_at(chunks, loose, nanoseconds(12, (1000, 1))),
    )  # fmt: skip


def newer() -> Iterator[Case]:
    yield valid(
        "minor-9", "A later minor version is read all the same.", ["VER-001"],
        FIVES, file={"head": f.head(minor=9)}, head=known(minor=9),
    )  # fmt: skip
    yield uncommon(
        "head-tlv", "Unknown ancillary TLVs in HEAD are skipped.", ["HED-002", "TLV-003"],
        FIVES, file={"head": f.head(f.tlv(8, b"x") + f.tlv(0x8002, b""))}, head=known(),
    )  # fmt: skip
