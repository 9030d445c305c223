"""The worked examples of SPEC Annex B.

python conformance/gen/examples.py          compare with what is committed
python conformance/gen/examples.py --write  write conformance/examples/ and the listings in SPEC.md
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from builder import (
    File,
    bits,
    i32,
    i64,
    listing,
    raw,
    svarint,
    u8,
    u16,
    u32,
    varint,
)

HERE = Path(__file__).resolve().parent
SPEC = HERE.parent.parent / "SPEC.md"
EXAMPLES = HERE.parent / "examples"


def hold() -> tuple[File, dict[str, object]]:
    """One force channel, 1 kHz, held: 1.00 N for three ticks, then 1.25 N for five."""
    f = File(0x00000001)
    f.head()
    f.chunk(
        "TRAK",
        [
            varint(0, "the tracks as they are"),
            u8(4, "4 TLVs"),
            u8(1, "one component"),
            u8(0, "kind: full band"),
            u8(0, "number format: counts"),
            raw(b"KNOT", "codec"),
            u32(1000, "rate 1000 /"),
            u32(1, "1 Hz"),
            i32(0, "lowest count 0"),
            i32(255, "highest count 255"),
            u16(0, "channel 0"),
            u16(0xFFFF, "linked to no track"),
            u16(1, "TLV 1, codec parameters"),
            u16(5, "5 bytes"),
            u8(0, "hold"),
            u8(0, "varints"),
            u8(0, "uniform grid"),
            varint(25, "step 25"),
            svarint(0, "zero 0"),
            u16(2, "TLV 2, label"),
            u16(6, "6 bytes"),
            raw(b"\x05force", "'force'"),
            u16(3, "TLV 3, calibration"),
            u16(3, "3 bytes"),
            svarint(1, "A = 1"),
            svarint(0, "B = 0"),
            varint(100, "D = 100: a count is 10 mN"),
            u16(4, "TLV 4, unit"),
            u16(2, "2 bytes"),
            raw(b"\x01N", "'N'"),
        ],
        track=0,
    )
    at = f.offset
    body = [
        svarint(4, "first knot, tick 0: index 4, count 100"),
        varint(3, "next knot 3 ticks later"),
        svarint(1, "index 1 more: 5, count 125"),
    ]
    f.cluster([(0, 0, body, 8)])
    f.close([(at, 0, 8_000_000)], [("HEAD", 8), ("TRAK", f.offsets["TRAK"])], 1)
    return f, {"0": [{"start": 0, "counts": [[100]] * 3 + [[125]] * 5}]}


def residual() -> tuple[File, dict[str, object]]:
    """Lines with a texture on them, and a gap of 2 ticks: LF track 0, HF track 1."""
    f = File(0x00000002)
    f.head()
    f.chunk(
        "TRAK",
        [
            varint(0, "the tracks as they are"),
            u8(1, "one TLV"),
            u8(1, "one component"),
            u8(1, "kind: LF"),
            u8(0, "number format: counts"),
            raw(b"KNOT", "codec"),
            u32(500, "rate 500 /"),
            u32(1, "1 Hz"),
            i32(-32, "lowest count -32"),
            i32(31, "highest count 31"),
            u16(0, "channel 0"),
            u16(0xFFFF, "linked to no track"),
            u16(1, "TLV 1, codec parameters"),
            u16(5, "5 bytes"),
            u8(1, "linear"),
            u8(0, "varints"),
            u8(0, "uniform grid"),
            varint(1, "step 1"),
            svarint(0, "zero 0"),
            u8(1, "one TLV"),
            u8(1, "one component"),
            u8(2, "kind: HF"),
            u8(0, "number format: counts"),
            raw(b"QUAN", "codec"),
            u32(500, "rate 500 /"),
            u32(1, "1 Hz"),
            i32(-2, "lowest count -2"),
            i32(1, "highest count 1: level 1 times step 2 is clamped to it"),
            u16(0, "channel 0"),
            u16(0, "base: track 0"),
            u16(1, "TLV 1, codec parameters"),
            u16(10, "10 bytes"),
            u32(2, "step 2"),
            u16(1, "M = 1: symbols 0, 1, 2 are levels 0, 1, -1"),
            u8(1, "R = 1: symbol 3 is a run of 2 or 3 zeros"),
            u8(0, "C = 0"),
            raw(bytes.fromhex("3231"), "lengths 3 2 3 1: code words 110, 10, 111, 0"),
        ],
        track=0,
    )
    at = f.offset
    knots = [
        svarint(10, "first knot, tick 0: index 10"),
        varint(2, "2 ticks later"),
        svarint(-5, "index 5"),
        varint(3, "3 ticks later, tick 5"),
        svarint(12, "index 17"),
    ]
    later = [svarint(17, "a single knot: constant 17")]
    texture = [bits("110 10 111 0 1", "0, 1, -1, a run of 3; 6 bits fill the byte")]
    silence = [bits("0 0", "a run of 2; 6 bits fill the byte")]
    rows = [
        (0, 0, knots, 6),
        (0, 8, later, 2),
        (1, 0, texture, 6),
        (1, 8, silence, 2),
    ]
    f.cluster(rows)
    listed = [("HEAD", 8), ("TRAK", f.offsets["TRAK"])]
    f.close([(at, 0, 20_000_000)], listed, 2)
    full = [[10], [9], [3], [9], [13], [17]]
    return f, {"0": [{"start": 0, "counts": full}, {"start": 8, "counts": [[17], [17]]}]}


def marks() -> tuple[File, dict[str, object]]:
    """A constant channel at 1 kHz, a layer of two events in microseconds, and another clock."""
    f = File(0x00000003)
    f.head()
    f.chunk(
        "TRAK",
        [
            varint(0, "the tracks as they are"),
            u8(1, "one TLV"),
            u8(1, "one component"),
            u8(0, "kind: full band"),
            u8(0, "number format: counts"),
            raw(b"KNOT", "codec"),
            u32(1000, "rate 1000 /"),
            u32(1, "1 Hz"),
            i32(0, "lowest count 0"),
            i32(1, "highest count 1"),
            u16(0, "channel 0"),
            u16(0xFFFF, "linked to no track"),
            u16(1, "TLV 1, codec parameters"),
            u16(5, "5 bytes"),
            u8(0, "hold"),
            u8(0, "varints"),
            u8(0, "uniform grid"),
            varint(1, "step 1"),
            svarint(0, "zero 0"),
            u8(1, "one TLV"),
            u8(1, "one component"),
            u8(3, "kind: events"),
            u8(0, "number format: counts"),
            raw(b"EVNT", "codec"),
            u32(1_000_000, "rate 1000000 /"),
            u32(1, "1 Hz: ticks of 1 us"),
            i32(0, "lowest count 0"),
            i32(0, "highest count 0"),
            u16(0xFFFF, "no channel"),
            u16(0xFFFF, "linked to no track"),
            u16(2, "TLV 2, label"),
            u16(6, "6 bytes"),
            raw(b"\x05touch", "the layer 'touch'"),
        ],
        track=0,
    )
    at = f.offset
    events = [
        varint(0, "at the start of the packet, 1500 us"),
        varint(0, "a moment"),
        varint(0, "of the whole recording"),
        varint(2, "2 bytes"),
        raw(b"go", "'go'"),
        varint(500, "500 us later, 2000 us"),
        varint(1000, "for 1000 us"),
        varint(1, "of channel 0"),
        varint(3, "3 bytes"),
        raw("µm".encode(), "'µm'"),
    ]
    rows = [
        (0, 0, [svarint(1, "a single knot: constant 1")], 4),
        (1, 1500, events, 501),
    ]
    f.cluster(rows)
    clock = f.offset
    f.chunk(
        "cLOk",
        [
            u8(2, "2 bytes"),
            raw(b"pc", "the clock 'pc'"),
            varint(2, "2 observations"),
            svarint(0, "tick 0"),
            i64(5_000_000_000, "at 5000000000 ns"),
            varint(1000, "give or take 1000 ns"),
            svarint(4, "4 ticks later"),
            svarint(4_000_160, "4000160 ns later: 40 ppm fast"),
            varint(1000, "give or take 1000 ns"),
        ],
        track=0,
    )
    listed = [("HEAD", 8), ("TRAK", f.offsets["TRAK"]), ("cLOk", clock)]
    f.close([(at, 0, 4_000_000)], listed, 2)
    told = [[1500, 0, None, "go"], [2000, 1000, 0, "µm"]]
    seen = [[0, 5_000_000_000, 1000], [4, 5_004_000_160, 1000]]
    expected = {"0": [{"start": 0, "counts": [[1]] * 4}], "events": told, "clock": seen}
    return f, expected


NOTES = {
    "hold": """`hold.hapf`: one force channel at 1 kHz, a count is 10 mN. It decodes to the counts
100 100 100 125
125 125 125 125: 1.00 N for 3 ms, then 1.25 N for 5 ms.""",
    "residual": """`residual.hapf`: one channel at 500 Hz of two tracks, a gap at ticks 6 and 7.
d is 10 8 5 9 13 17,
then 17 17: at tick 1 `10 + rdiv(-5 * 1, 2) = 10 - 2`, a tie. e^ is 0 1 -2 0 0 0, then 0 0: the
level 1 at
tick 1 would be 2 and is clamped. The channel is 10 9 3 9 13 17, then 17 17.""",
    "marks": """`marks.hapf`: a constant channel at 1 kHz, a layer of two events, and a clock that
was observed twice. The events are 'go' at 1.5 ms, and 'µm' of channel 0 from 2 to 3 ms.""",
}
MAKERS = {"hold": hold, "residual": residual, "marks": marks}


def annex() -> str:
    """Annex B between its markers."""
    parts = ["<!-- examples -->"]
    for name, make in MAKERS.items():
        parts += [f"\n{NOTES[name]}\n", "```", listing(make()[0].fields), "```"]
    return "\n".join([*parts, "<!-- end -->"])


def outputs() -> dict[Path, bytes]:
    """Every file that this script makes."""
    found: dict[Path, bytes] = {}
    for name, make in MAKERS.items():
        file, expected = make()
        found[EXAMPLES / f"{name}.hapf"] = file.data
        text = json.dumps(expected, sort_keys=True, indent=1)
        found[EXAMPLES / f"{name}.json"] = (text + "\n").encode()
    text = SPEC.read_text(encoding="utf-8")
    marked = re.compile(r"<!-- examples -->.*?<!-- end -->", re.S)
    found[SPEC] = marked.sub(lambda _: annex(), text).encode()
    return found


def main() -> int:
    if sys.argv[1:] == ["--write"]:
        for path, data in outputs().items():
            path.write_bytes(data)
        return 0
    wrong = [path.name for path, data in outputs().items() if path.read_bytes() != data]
    print(f"differ: {', '.join(wrong)}" if wrong else "all as committed")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
