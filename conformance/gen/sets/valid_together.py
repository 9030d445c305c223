"""One recording of everything, as a laboratory would make it."""

from __future__ import annotations

from collections.abc import Iterator

import forge as f
from case import Case
from facts import Event, Layer, Track, case_of, digest, double_bits
from lpcr import Coding, walk
from lpcr import packet as predicted
from luck import Luck
from page_knots import LINEAR
from page_numbers import clamp
from page_quantised import Escape

from sets.valid_exact import Source
from sets.valid_knots_coded import packet as knots
from sets.valid_knots_coded import track as knot_track
from sets.valid_layers import clock, told
from sets.valid_quantised import Quantiser
from sets.valid_raw import DEFLATE, words
from sets.valid_raw import packet as stored

CLUSTERS, SPAN = 4, 120


def tactile() -> Track:
    """Three taxels that feel the same, with a gap in the third cluster."""
    packets = []
    for number in range(CLUSTERS):
        first = walk(number, SPAN, 6)
        luck = Luck(100 + number)
        rows = [first, *([each * 3 // 4 + luck.between(-1, 1) for each in first] for _ in range(2))]
        refers = [Coding(1), *(Coding(1, references=((a, 0, 48, 0),)) for a in (0, 1))]
        start = number * SPAN + (30 if number == 2 else 0)
        rows = [row[: SPAN - 30] if number == 2 else row for row in rows]
        packet = predicted(*rows, coding=refers, start=start)
        packets.append(packet._replace(cluster=number))
    labels = [{"label": f"taxel {i}", "group": "", "device": "skin"} for i in range(3)]
    return Track(
        codec="LPCR", parameters=f.lpcr_parameters(), width=3, packets=packets, about=labels,
        tlvs=f.tlv(2, f.strings("taxel 0", "taxel 1", "taxel 2")) + f.tlv(14, f.strings("skin")),
    )  # fmt: skip


def force() -> list[Track]:
    """Knots within a deadband, and their texture."""
    luck = Luck(7)
    slow, fast = [], []
    quantiser = Quantiser([2, 3, 4, 3, 4, 5, 5, 4, 2], m=2, r=2, c=2, step=3)
    for number in range(CLUSTERS):
        ticks = sorted({0, SPAN - 1, *(luck.between(1, SPAN - 2) for _ in range(9))})
        rows = [(tick, luck.between(-90, 90)) for tick in ticks]
        slow.append(knots(rows, SPAN, LINEAR, start=number * SPAN)._replace(cluster=number))
        levels = [clamp(luck.bell(1), -4, 4) for _ in range(SPAN)]
        tokens = [level if abs(level) <= 2 else Escape(level) for level in levels]
        texture = quantiser.packet(tokens, number * SPAN, low=-10, high=10)
        fast.append(texture._replace(cluster=number))
    told_ = {"label": "force_z", "unit": "N", "quantity": "force", "axis": "z"}
    tlvs = f.tlv(2, f.strings("force_z")) + f.tlv(3, f.calibration(1, 0, 100))
    tlvs += f.tlv(4, f.strings("N")) + f.tlv(6, f.strings("force")) + f.tlv(8, f.strings("z"))
    promise = f.tlv(16, f.deadband(1, 10, 0, [(6, 0)]))
    base = knot_track(
        *slow, interpolation=LINEAR, kind="lf", id=1, channel=3, rate=(500, 1), about=told_,
        calibration=(1, 0, 100), tlvs=tlvs + promise,
    )  # fmt: skip
    residual = quantiser.track(
        *fast, kind="hf", id=2, base=1, channel=3, rate=(500, 1), low=-10, high=10, tlvs=promise
    )  # fmt: skip
    return [base, residual]


def cases() -> Iterator[Case]:
    luck = Luck(11)
    temperature = words(
        "binary32", 4,
        *(
            stored([luck.below(2**32) for _ in range(5)], 4, DEFLATE, 5 * number)._replace(
                cluster=number
            )
            for number in range(CLUSTERS)
        ),
        id=3, channel=4, rate=(20, 1), about={"label": "t", "unit": "Cel"},
        tlvs=f.tlv(2, f.strings("t")) + f.tlv(4, f.strings("Cel")),
    )  # fmt: skip
    source = Source((1, 0, 1000))
    counts = walk(5, 60, 40, -5000, 5000)
    logged = [double_bits(count * 0.001) for count in counts]
    position = source.track(
        source.packet(counts, logged, recall=True, g=1), id=4, channel=5, rate=(250, 1)
    )
    tracks = [tactile(), *force(), temperature, position]
    marks = Layer(
        id=5, label="marks",
        packets=[(0, 900_000, [Event(9, 0, None, "begin"), Event(700_000, 90_000, 3, "tap")], 3)],
    )  # fmt: skip
    seen = [(0, 1_700_000_000_000_000_000, 2000), (100, 1_700_000_000_100_004_000, 2000)]
    note = b"by hand\n"
    digests = [(track.id, digest(track)) for track in tracks]
    yield case_of(
        "valid", "together", "Codecs, bands, words, events, clocks and extras in one recording.",
        ["DEC-001", "DEC-003", "DGS-002", "DAT-007", "EVT-004", "HED-001", "TRK-003"],
        *tracks, layers=[marks],
        file={
            "before": [("mETa", b'{"subject": "S1", "task": "stroke"}')],
            "more": [
                clock(seen), ("aTTc", f.strings("notes.txt", "text/plain") + note),
                *(("dGST", f.digests(each, first=id_)) for id_, each in digests),
                ("HEAD", f.head()), *(track.chunk for track in tracks), marks.chunk,
            ],
        },
        clocks=[told(seen)], metadata={"subject": "S1", "task": "stroke"},
    )  # fmt: skip
