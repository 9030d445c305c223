"""TRAK: tracks of one chunk, texts, calibrations, rates (SPEC 6.2, 6.3, 7, 8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import forge as f
from case import Case
from facts import Packet, Track, case_of
from lpcr import packet as predicted

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")


def fives(start: int = 0, span: int = 4, value: int = 5, cluster: int = 0) -> Packet:
    return Packet(start, [value] * span, f.svarint(value), cluster)


def together(*packets: Sequence[Packet], each: Sequence[dict] = (), **shared: Any) -> list[Track]:
    """The tracks of one TRAK chunk, and the packets of each."""
    width = shared.get("width", 1)
    return [
        Track(
            **({"id": i, "channel": i * width, "joined": i > 0, "packets": rows}
               | shared | (each[i] if each else {}))
        )
        for i, rows in enumerate(packets)
    ]  # fmt: skip


def cases() -> Iterator[Case]:
    yield from listed()
    yield from texts()
    yield from calibrations()
    yield from rates()
    yield from numbers()


def labelled(text: str) -> dict[str, Any]:
    return {"tlvs": f.tlv(2, f.strings(text)), "about": {"label": text}}


def listed() -> Iterator[Case]:
    three = together(
        *([fives(value=v)] for v in (1, 2, 3)), each=[labelled(label) for label in "abc"]
    )  # fmt: skip
    yield valid(
        "tracks-of-a-chunk", "One TRAK chunk describes three tracks with labels of their own.",
        ["TRK-010", "TLV-004"],
        *three,
    )  # fmt: skip
    outer = Track(
        width=2, tlvs=f.tlv(5, b"\2\0"), further=(2,),
        packets=[Packet(0, [(5, -6)] * 4, f.svarint(5) + f.svarint(-6))],
    )  # fmt: skip
    yield valid(
        "tracks-around-others", "A track has the channels 0 and 2, another one channel 1.",
        ["TRK-010", "TLV-004"],
        outer, Track(id=1, channel=1, packets=[fives()]),
    )  # fmt: skip
    backwards = Track(
        width=2, channel=1, tlvs=f.tlv(5, b"\0\0"), further=(0,),
        packets=[Packet(0, [(5, -6)] * 4, f.svarint(5) + f.svarint(-6))],
    )  # fmt: skip
    yield valid(
        "tracks-backwards", "The components of a track have the channels 1 and 0.",
        ["TRK-010", "TLV-004"], backwards,
    )  # fmt: skip
    for kind, name in enumerate(("stored", "fixed", "dynamic")):
        yield valid(
            f"tracks-deflated-{name}",
            f"A DEFLATE stream of one {name} block describes three tracks.",
            ["TRK-020"],
            *three, file={"squeeze": kind},
        )  # fmt: skip
    many = together(
        *([] for _ in range(254)), [fives()], each=[labelled(f"sensor {i}") for i in range(255)]
    )  # fmt: skip
    yield uncommon(
        "tracks-deflated-255", "255 tracks in a DEFLATE stream, the last of which has a packet.",
        ["TRK-002", "TRK-020"],
        *many, tracks=None, file={"squeeze": 2},
    )  # fmt: skip
    yield valid(
        "tracks-of-any-kind",
        "One TRAK chunk describes tracks of several codecs, rates, ranges and formats.",
        ["TRK-002", "DEC-001"],
        *together(
            [Packet(0, [3, -9, 30], predicted([1, -3, 10]).body)],
            [Packet(0, [2, 5, 7], f.svarint(1) + b"\2" + f.svarint(3))],
            [Packet(0, [1, 2**63], b"\0" + b"\1\0" + bytes(12) + b"\0\x80")],
            [predicted([7, 8, -9])],
            each=[
                {"codec": "LPCR", "parameters": f.lpcr_parameters(step=3)},
                {"parameters": f.knot_parameters(1, 2), "low": -4, "high": 7, "rate": (50, 1)},
                {"codec": "RAWB", "parameters": f.raw_parameters(8), "number_format": "int64"},
                {"codec": "LPCR", "parameters": f.lpcr_parameters()},
            ],
        ),
    )  # fmt: skip
    yield valid(
        "tracks-in-another-order", "Channel numbers that do not follow on; components still do.",
        ["TRK-010"],
        *together(
            *([Packet(0, [(v, -v)] * 3, f.svarint(v) + f.svarint(-v))] for v in (1, 2, 3)),
            each=[{"channel": number} for number in (4, 0, 2)], width=2,
        ),
    )  # fmt: skip
    told = [(2, 0, 1), (1, 3, 10), (-1, 0, 1), (1, 0, 7)]
    yield valid(
        "tracks-components", "Lists of two tracks of two components, for each track its own.",
        ["TLV-004"],
        *together(
            *([Packet(0, [(v, v + 1)] * 3, f.svarint(v) + f.svarint(v + 1))] for v in (20, 30)),
            each=[
                {"about": [{"label": label} for label in "abcd"[i : i + 2]],
                 "calibration": told[i : i + 2],
                 "tlvs": f.tlv(2, f.strings(*"abcd"[i : i + 2]))
                 + f.tlv(3, b"".join(f.calibration(*row) for row in told[i : i + 2]))}
                for i in (0, 2)
            ],
            width=2,
        ),
    )  # fmt: skip
    yield from ranges()


def ranges() -> Iterator[Case]:
    for name, level, rows, set_ in (
        ("ranges", 1, [(0, 0), (0, 255), (-1, 0), (-(2**23), 2**23 - 1), (77, 77)], valid),
        ("ranges-level-2", 2, [(0, 2**31 - 1), (-(2**31), 2**31 - 1)], uncommon),
    ):
        far = 2 ** (24 if level == 1 else 32)
        body = f.svarint(far) + b"\2" + f.svarint(-2 * far)
        yield set_(
            name, "Each track has a range of its own, to which its counts are clamped.",
            ["TRK-005", "DEC-001"],
            *together(
                *([Packet(0, [high, high, low], body)] for low, high in rows),
                each=[{"low": low, "high": high} for low, high in rows],
            ),
            level=level, file={"head": f.head(level=level)},
        )  # fmt: skip


TEXTS = {
    2: "label", 4: "unit", 6: "quantity", 8: "axis", 10: "group", 12: "body_site", 14: "device",
}  # fmt: skip


def texts() -> Iterator[Case]:
    words = {2: "force_z", 4: "m/s2", 6: "acceleration", 8: "z", 10: "wrist", 12: "index finger",
             14: "Gerät 2"}  # fmt: skip
    yield valid(
        "texts", "A text of every kind, and provenance.", ["CNV-004"],
        Track(
            tlvs=b"".join(f.tlv(t, f.strings(text)) for t, text in words.items())
            + f.tlv(22, "of a test µ".encode()),
            packets=[fives()], about={TEXTS[t]: text for t, text in words.items()},
        ),
    )  # fmt: skip
    empty = dict.fromkeys(TEXTS.values(), "") | {"unit": "1"}
    yield valid(
        "texts-absent", "Without texts all are empty but the unit, which is 1; no calibration.",
        ["TLV-004"],
        Track(packets=[fives()], about=empty, calibration=(1, 0, 1)),
    )  # fmt: skip
    three = Packet(0, [(1, 2, 3)] * 2, f.svarint(1) + f.svarint(2) + f.svarint(3))
    yield valid(
        "texts-of-all", "A list of one entry speaks for all three components.", ["TLV-004"],
        Track(
            width=3, packets=[three], tlvs=f.tlv(2, f.strings("f")) + f.tlv(4, f.strings("N")),
            about={"label": "f", "unit": "N"},
        ),
    )  # fmt: skip
    yield valid(
        "texts-of-each", "A list with an entry for each component.", ["TLV-004"],
        Track(
            width=3, packets=[three],
            tlvs=f.tlv(4, f.strings("N", "", "mN")) + f.tlv(8, f.strings("x", "y", "z")),
            about=[{"unit": u, "axis": a} for u, a in (("N", "x"), ("", "y"), ("mN", "z"))],
        ),
    )  # fmt: skip
    yield valid(
        "texts-repeated", "The byte 255 repeats the text before it, again and again.",
        ["TLV-004"],
        Track(
            width=3, packets=[three],
            tlvs=f.tlv(2, f.strings("a") + b"\xff\xff") + f.tlv(8, b"\0\xff" + f.strings("z")),
            about=[{"label": "a", "axis": axis} for axis in ("", "", "z")],
        ),
    )  # fmt: skip
    long = "𝄞µ€" * 28 + "ab"
    assert len(long.encode()) == 254
    yield uncommon(
        "texts-longest", "254 bytes of UTF-8 of one to four bytes.", ["CNV-004"],
        Track(
            packets=[fives()], tlvs=f.tlv(2, f.strings(long)) + f.tlv(14, f.strings("\u007f\n")),
            about={"label": long, "device": "\u007f\n"},
        ),
    )  # fmt: skip
    yield valid(
        "texts-same-label", "Two channels with the same label.", ["TRK-010"],
        Track(packets=[fives()], tlvs=f.tlv(2, f.strings("f")), about={"label": "f"}),
        Track(id=1, channel=1, packets=[fives(value=6)], tlvs=f.tlv(2, f.strings("f")),
              about={"label": "f"}),
    )  # fmt: skip
    promise = f.deadband(1, 10, 2, [(20, -3)])
    yield valid(
        "contract", "A guaranteed deadband contract with a floor and a zero of its own.",
        ["DBC-001"],
        Track(packets=[fives()], tlvs=f.tlv(16, promise)),
    )  # fmt: skip
    vector = f.deadband(3, 20, 3, [(4, 0), (4, 1), (4, -1)])
    groups = [f.tlv(10, f.strings(group)) for group in "ab"]
    yield valid(
        "contracts-of-each", "Contracts of two tracks: the vector form, and none.",
        ["DBC-001", "TLV-004"],
        *together(
            *([Packet(0, [(v, v, v)] * 2, f.svarint(v) * 3)] for v in (1, 2)),
            each=[{"tlvs": groups[0] + f.tlv(16, vector), "about": {"group": "a"}},
                  {"tlvs": groups[1], "about": {"group": "b"}}],
            width=3,
        ),
    )  # fmt: skip
    yield valid(
        "deviation", "A declared tolerance, and the largest deviation that was found.",
        ["TLV-005"],
        Track(packets=[fives()], tlvs=f.tlv(18, f.deviation(0.5, 0.25))),
    )  # fmt: skip
    yield uncommon(
        "tlv-unknown-ancillary", "Unknown ancillary TLVs, one of them private, are skipped.",
        ["TLV-003"],
        Track(
            packets=[fives()],
            tlvs=f.tlv(2, f.strings("f")) + f.tlv(24, b"?" * 9) + f.tlv(0x8000, b""),
            about={"label": "f"},
        ),
    )  # fmt: skip


def calibrations() -> Iterator[Case]:
    counts = [-100, -1, 0, 1, 2, 3, 99, 100]
    body = b"\0" + bytes(count % 256 for count in counts)
    for name, about, affine in (
        ("calibration", "Values are (count * A + B) / D.", (3, 5, 7)),
        ("calibration-negative", "A and B below zero.", (-7, -1, 10)),
        ("calibration-decimal", "D = 1000: doubles nearest to decimals.", (1, 0, 1000)),
    ):
        yield valid(
            name, about, ["VAL-003", "VAL-001"],
            raw_of(counts, body, affine),
        )  # fmt: skip
    for number, affine in enumerate(((2**45 - 1, -(2**52) + 1, 2**53 - 1), (1, 2**52 - 1, 3))):
        yield uncommon(
            f"calibration-extreme-{number + 1}", "Products near 2^53, over a large D or a small.",
            ["VAL-001", "VAL-003"],
            raw_of(counts, body, affine),
        )  # fmt: skip


def raw_of(counts: Sequence[int], body: bytes, affine: tuple[int, int, int]) -> Track:
    return Track(
        codec="RAWB", parameters=f.raw_parameters(1), packets=[Packet(0, counts, body)],
        tlvs=f.tlv(3, f.calibration(*affine)), calibration=affine,
    )  # fmt: skip


def rates() -> Iterator[Case]:
    for set_, name, about, rate in (
        (valid, "rate-fraction", "48000 / 1001 ticks a second.", (48000, 1001)),
        (uncommon, "rate-not-reduced", "2000 / 2 ticks a second, as it is stored.", (2000, 2)),
        (uncommon, "rate-slow", "One tick a day.", (1, 86400)),
        (uncommon, "rate-slowest", "One tick in 2^32 - 1 seconds.", (1, 2**32 - 1)),
        (uncommon, "rate-fastest", "2^32 - 1 ticks a second.", (2**32 - 1, 1)),
    ):
        yield set_(
            name, about, ["TRK-002", "FOT-002", "IDX-002"],
            Track(rate=rate, packets=[fives(span=7)]),
        )  # fmt: skip
    yield valid(
        "rates-of-each", "Three tracks at three rates; the duration is that of the longest.",
        ["FOT-002", "TIM-001"],
        Track(rate=(1000, 1), packets=[fives(span=9)]),
        Track(id=1, channel=1, rate=(3, 1), packets=[fives(start=1, span=2)]),
        Track(id=2, channel=2, rate=(44100, 1), packets=[fives(span=44)]),
    )  # fmt: skip


def numbers() -> Iterator[Case]:
    yield valid(
        "track-without-packets", "A track is described, and nothing of it recorded.", ["DEC-003"],
        Track(packets=[fives()]), Track(id=1, channel=1),
    )  # fmt: skip
    yield uncommon(
        "track-ids", "Track ids with holes, up to 65533, described in falling order.",
        ["TRK-003", "DAT-002"],
        Track(id=65533, channel=2, packets=[fives(value=1)]),
        Track(id=300, channel=0, packets=[fives(value=2)]),
        Track(id=5, channel=1, packets=[fives(value=3)]),
    )  # fmt: skip
    yield valid(
        "tracks-deflated-from-300", "DEFLATE streams whose first tracks are 300 and 65532.",
        ["TRK-003", "TRK-020"],
        Track(id=300, packets=[fives(value=1)]),
        Track(id=301, channel=1, joined=True, packets=[fives(value=2)]),
        Track(id=65532, channel=2, packets=[fives(value=3)]),
        Track(id=65533, channel=3, joined=True, packets=[fives(value=4)]),
        file={"squeeze": 2},
    )  # fmt: skip
    yield valid(
        "tracks-from-300", "The same ids in TRAK chunks that are not compressed, one a band.",
        ["TRK-003", "TRK-007"],
        Track(id=300, kind="lf", packets=[fives(value=1)]),
        Track(id=301, kind="hf", base=300, joined=True, packets=[fives(value=2)]),
        Track(id=65532, channel=1, packets=[fives(value=3)]),
        Track(id=65533, channel=1, continues=65532, joined=True,
              packets=[fives(start=4, cluster=1)]),
    )  # fmt: skip
