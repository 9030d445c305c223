"""Tracks that continue one another (SPEC 6.3)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import forge as f
from case import Case
from facts import Packet, Track, case_of, double_bits
from lpcr import Coding
from lpcr import packet as predicted

from sets.valid_bands import FAST, SLOW, hf, lf, raw, stored

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")


def cases() -> Iterator[Case]:
    knots = Track(packets=[Packet(0, [5] * 4, f.svarint(5))])
    coded = predicted([7, 9, -4, 3], coding=Coding(1), clamped=(-9, 8))
    after = Track(
        id=1, codec="LPCR", parameters=f.lpcr_parameters(), continues=0, low=-9, high=8,
        packets=[coded._replace(start=4, cluster=1)],
    )  # fmt: skip
    yield valid(
        "continued", "A channel continues in a track of another codec and another range.",
        ["TRK-016", "TRK-018"],
        knots, after,
    )  # fmt: skip
    gap = Track(
        id=1, continues=0, packets=[Packet(9, [6] * 2, f.svarint(6), 1)], low=-6, high=6
    )  # fmt: skip
    last = raw(
        stored(11, [1, 2, 3], cluster=1), stored(20, [4], cluster=2), id=2, continues=1
    )  # fmt: skip
    yield valid(
        "continued-chain", "A channel in three tracks, with gaps between and within them.",
        ["TRK-016", "TRK-018", "DEC-003"],
        knots, gap, last,
    )  # fmt: skip
    first = lf(stored(0, SLOW), low=-100, high=70), hf(stored(0, FAST))
    then = (
        lf(stored(6, [80, 81, -90], cluster=1), id=2, continues=0, low=-91, high=82),
        hf(stored(7, [5, -5], cluster=1), id=3, base=2),
    )
    yield valid(
        "continued-bands",
        "A channel of two bands continues in two others, clamped to another range.",
        ["TRK-016", "DEC-001", "DEC-003"],
        *first, *then,
    )  # fmt: skip
    whole = raw(stored(0, [1, 2, 3]))
    yield valid(
        "continued-full-then-bands",
        "A full-band track is continued by two bands: asked for LF both give something.",
        ["TRK-016", "DEC-005"],
        whole,
        lf(stored(3, [10, 20, 30], cluster=1), id=1, continues=0),
        hf(stored(3, [1, -1, 1], cluster=1), id=2, base=1),
    )  # fmt: skip
    yield uncommon(
        "continued-bands-then-full", "Two bands are continued by a full-band track.",
        ["TRK-016", "DEC-005"],
        lf(stored(0, [10, 20, 30])), hf(stored(0, [1, -1, 1])),
        raw(stored(3, [1, 2, 3], cluster=1), id=2, continues=0),
    )  # fmt: skip
    planes = b"\0" + b"\1\0" + bytes(12) + b"\0\x80"
    words = Track(
        codec="RAWB", parameters=f.raw_parameters(8), number_format="binary64",
        packets=[Packet(0, [1, 2**63], planes)],
    )  # fmt: skip
    more = Track(
        id=1, codec="RAWB", parameters=f.raw_parameters(8), number_format="binary64",
        continues=0, packets=[Packet(2, [1, 2**63], planes, 1)],
    )  # fmt: skip
    yield uncommon(
        "continued-words", "A channel of words continues in another track.", ["TRK-016"],
        words, more,
    )  # fmt: skip
    tenths = f.tlv(3, f.calibration(1, 0, 10))
    exact = bytes.fromhex(
        "0C 00 00 00 0D 1E 00 01 A3 57 66 5B 00 01 00 01 80 01 FF 01 FF 01 01 FF 00 10 1B 20 00"
    )
    far = [0.1, 0.2, 0.30000000000000004, 0.30000000000000004, 0.7000000000000001]
    far.append(0.30000000000000004)
    yield uncommon(
        "continued-exact", "Exact values, and in the track that continues it the quotients.",
        ["TRK-018", "VAL-003"],
        Track(
            codec="LPCX", parameters=f.lpcx_parameters(), tlvs=tenths, calibration=(1, 0, 10),
            packets=[
                Packet(0, [1, 2, 3, 3, 7, 3], exact, exact=[double_bits(each) for each in far])
            ],
        ),
        Track(
            id=1, tlvs=tenths, continues=0, calibration=(1, 0, 10),
            packets=[Packet(6, [3] * 2, f.svarint(3), 1)],
        ),
    )  # fmt: skip
    pair = {"width": 2, "calibration": (1, 0, 10), "about": {"unit": "N"}}
    yield uncommon(
        "continued-lists-of-one-and-of-each",
        "Calibration and unit are one for all components, then one for each: they are the same.",
        ["TRK-016", "TLV-004"],
        Track(
            tlvs=tenths + f.tlv(4, f.strings("N")), **pair,
            packets=[Packet(0, [(5, 6)] * 4, f.svarint(5) + f.svarint(6))],
        ),
        Track(
            id=1, continues=0, **pair,
            tlvs=f.tlv(3, f.calibration(1, 0, 10) * 2) + f.tlv(4, f.strings("N", "N")),
            packets=[Packet(4, [(7, 8)] * 4, f.svarint(7) + f.svarint(8), 1)],
        ),
    )  # fmt: skip
    named = Track(
        packets=[Packet(0, [5] * 4, f.svarint(5))], about={"label": "first", "device": "a"},
        tlvs=f.tlv(2, f.strings("first")) + f.tlv(14, f.strings("a")),
    )  # fmt: skip
    renamed = Track(
        id=1, packets=[Packet(4, [5] * 4, f.svarint(5), 1)],
        tlvs=f.tlv(2, f.strings("second")), continues=0,
    )  # fmt: skip
    yield uncommon(
        "continued-described-by-first", "The first track describes the channel, not a later one.",
        ["TRK-018"],
        named, renamed,
    )  # fmt: skip
    yield uncommon(
        "continued-in-a-chunk", "One chunk describes two tracks: one continues another, one none.",
        ["TRK-016"],
        knots,
        Track(id=1, channel=1, packets=[Packet(0, [8] * 2, f.svarint(8))]),
        Track(id=2, continues=0, joined=True, packets=[Packet(4, [9] * 3, f.svarint(9), 1)]),
    )  # fmt: skip
