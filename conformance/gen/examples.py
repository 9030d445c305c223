"""The worked examples, conformance/EXAMPLES.md: whole files, byte by byte, and what they decode to.

python conformance/gen/examples.py          compare with what is committed
python conformance/gen/examples.py --write  write EXAMPLES.md and conformance/examples/
"""

from __future__ import annotations

import hashlib
import json
import struct
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import deflate
import forge
import packet_rows
import page_exact
import page_knots_coded
import page_noise
import page_predicted
import page_quantised
import page_raw
import page_transform
from builder import (
    Field,
    File,
    bits,
    i64,
    joined,
    listing,
    raw,
    svarint,
    u8,
    u16,
    u32,
    u64,
    varint,
)
from page_numbers import varint_bytes
from page_quantised import Escape, Run

ROOM = Path(__file__).resolve().parent.parent
PAGE = ROOM / "EXAMPLES.md"
PACKETS = ROOM / "gen" / "packets.md"
EXAMPLES = ROOM / "examples"

KINDS = ("full band", "LF", "HF", "events")
FORMATS = ("counts", "int64", "uint64", "binary16", "binary32", "binary64")


class Example(NamedTuple):
    """``note``: Markdown. ``expected``: by channel number its spans, and events, clocks, exact
    values. ``broken``: (offset, bytes) that damage put over the listed ones."""

    file: File
    note: str
    expected: dict[str, Any]
    broken: Sequence[tuple[int, bytes]] = ()

    @property
    def data(self) -> bytes:
        out = bytearray(self.file.data)
        for at, new in self.broken:
            out[at : at + len(new)] = new
        return bytes(out)


def track(codec: str, *, low: int = 0, high: int = 255, range_notes: tuple[str, str] | None = None,
          kind: int = 0, number_format: int = 0, components: int = 1,
          rate: tuple[int, int, str] = (1000, 1, "1 Hz"), channel: int = 0, base: int | None = None,
          tlvs: Sequence[tuple[int, str, list[Field]]] = ()) -> list[Field]:  # fmt: skip
    """A description; ``tlvs`` are (type, what it is, value)."""
    counted = "one TLV" if len(tlvs) == 1 else f"{len(tlvs)} TLVs"
    wide = "one component" if components == 1 else f"{components} components"
    what = "base" if kind == 2 else "track that it continues"
    linked = "linked to no track" if base is None else f"1 + {what}: track {base}"
    notes = range_notes or (f"lowest count {low}", f"highest count {high}")
    out = [
        u8(kind | number_format << 4, f"{KINDS[kind]}, {FORMATS[number_format]}"),
        raw(codec.encode(), "codec"),
        u8(components, wide),
        varint(rate[0], f"rate {rate[0]} /"),
        varint(rate[1], rate[2]),
        svarint(low, notes[0]),
        svarint(high, notes[1]),
        varint(channel, "no channel" if kind == 3 else f"channel {channel}"),
        varint(0 if base is None else 1 + base, linked),
        u8(len(tlvs), counted),
    ]
    for type_, about, value in tlvs:
        size = len(joined(value))
        out += [varint(type_, f"TLV {type_}, {about}"), varint(size, f"{size} bytes"), *value]
    return out


def plain(*tracks: list[Field]) -> list[Field]:
    return [
        varint(0, "the first track is track 0"),
        varint(0, "the tracks follow uncompressed"),
        *(field for each in tracks for field in each),
    ]


def knots(interpolation: int = 0, step: int = 1) -> tuple[int, str, list[Field]]:
    """Parameters of KNOT with varints on a uniform grid."""
    return 1, "codec parameters", [
        u8(interpolation, ("hold", "linear")[interpolation]),
        u8(0, "varints"),
        u8(0, "uniform grid"),
        varint(step, f"step {step}"),
        svarint(0, "zero 0"),
    ]  # fmt: skip


def strings(type_: int, what: str, *texts: str | None) -> tuple[int, str, list[Field]]:
    """A string list; None: the same text as before."""
    fields = []
    for text in texts:
        if text is None:
            fields.append(u8(255, "the same text as before"))
        else:
            data = text.encode()
            fields.append(raw(bytes([len(data)]) + data, repr(text)))
    return type_, what, fields


def span(start: int, *rows: Any) -> dict[str, Any]:
    """A covered span: for each tick its count, or the counts of each component."""
    return {"start": start, "counts": [list(r) if isinstance(r, tuple) else [r] for r in rows]}


MS = 1_000_000


def hold() -> Example:
    f = File(0x00000001)
    f.head()
    calibration = [
        svarint(1, "A = 1"), svarint(0, "B = 0"), varint(100, "D = 100: a count is 10 mN"),
    ]  # fmt: skip
    tlvs = [
        knots(step=25),
        strings(2, "label", "force"),
        (3, "calibration", calibration),
        strings(4, "unit", "N"),
    ]
    f.chunk("TRAK", plain(track("KNOT", tlvs=tlvs)))
    body = [
        svarint(4, "first knot, tick 0: index 4, count 100"),
        varint(3, "next knot 3 ticks later"),
        svarint(1, "index 1 more: 5, count 125"),
    ]
    f.cluster([(0, 0, body, 8)], (0, 8 * MS))
    f.close()
    note = """The smallest useful file: codec `KNOT` with varints, a label, a unit and a
calibration. One force channel at 1 kHz; one count is 10 mN. It decodes to the counts 100 100 100
125 125 125 125 125: 1.00 N for 3 ms, then 1.25 N for 5 ms."""
    return Example(f, note, {"0": [span(0, 100, 100, 100, 125, 125, 125, 125, 125)]})


def residual() -> Example:
    f = File(0x00000002, brief=True)
    f.head()
    quantiser = [
        u32(2, "step 2"),
        u16(1, "M = 1: symbols 0, 1, 2 are levels 0, 1, -1"),
        u8(1, "R = 1: symbol 3 is a run of 2 or 3 zeros"),
        u8(0, "C = 0"),
        raw(bytes.fromhex("3231"), "lengths 3 2 3 1: code words 110, 10, 111, 0"),
    ]
    clamped = ("lowest count -2", "highest count 1: level 1 times step 2 is clamped to it")
    half = (500, 1, "1 Hz")
    slow = track("KNOT", kind=1, rate=half, low=-32, high=31, tlvs=[knots(1)])
    fast = track(
        "QUAN", kind=2, rate=half, low=-2, high=1, range_notes=clamped, base=0,
        tlvs=[(1, "codec parameters", quantiser)],
    )  # fmt: skip
    f.chunk("TRAK", plain(slow, fast))
    lines = [
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
        (0, 0, lines, 6),
        (0, 8, later, 2),
        (1, 0, texture, 6),
        (1, 8, silence, 2),
    ]
    f.cluster(rows, (0, 20 * MS))
    f.close()
    note = """LF + HF: one channel at 500 Hz in two tracks, with a gap at ticks 6 and 7. The LF
track decodes to d = 10 8 5 9 13 17, then 17 17. At tick 1 it is `10 + rdiv(-5 * 1, 2) = 10 - 2`,
a tie. The HF track decodes to e^ = 0 1 -2 0 0 0, then 0 0: level 1 at tick 1 would be 2 and is
clamped. The channel is 10 9 3 9 13 17, then 17 17."""
    return Example(f, note, {"0": [span(0, 10, 9, 3, 9, 13, 17), span(8, 17, 17)]})


def marks() -> Example:
    f = File(0x00000003, brief=True)
    f.head()
    still = track("KNOT", high=1, tlvs=[knots()])
    layer = track(
        "EVNT", kind=3, rate=(1_000_000, 1, "1 Hz: ticks of 1 us"), high=0,
        tlvs=[strings(2, "label", "touch")],
    )  # fmt: skip
    f.chunk("TRAK", plain(still, layer))
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
    f.cluster(rows, (0, 4 * MS))
    clock = [
        varint(1, "1 + track 0"),
        u8(2, "2 bytes"),
        raw(b"pc", "the clock 'pc'"),
        varint(2, "2 observations"),
        svarint(0, "tick 0"),
        i64(5_000_000_000, "at 5000000000 ns"),
        varint(1000, "give or take 1000 ns"),
        svarint(4, "4 ticks later"),
        svarint(4_000_160, "4000160 ns later: 40 ppm fast"),
        varint(1000, "give or take 1000 ns"),
    ]
    f.chunk("cLOk", clock)
    f.close()
    found = [[1500, 0, None, "go"], [2000, 1000, 0, "µm"]]
    seen = [[0, 5_000_000_000, 1000], [4, 5_004_000_160, 1000]]
    note = """Events and clocks: a constant channel at 1 kHz, a layer of two events (codec
`EVNT`), and a clock that was observed twice. The events are 'go' at 1.5 ms, and 'µm' of channel
0 from 2 to 3 ms."""
    return Example(f, note, {"0": [span(0, 1, 1, 1, 1)], "events": found, "clock": seen})


def continued() -> Example:
    f = File(0x0000000F, brief=True)
    f.head()
    rest = track("KNOT", tlvs=[knots()])
    one = [u8(1, "one byte per number"), raw(bytes(3), "reserved")]
    busy = track("RAWB", low=-100, high=100, base=0, tlvs=[(1, "codec parameters", one)])
    f.chunk("TRAK", plain(rest, busy))
    words = [u8(0, "stored"), raw(bytes([9, 256 - 7, 5]), "9, -7, 5")]
    rows = [(0, 0, [svarint(8, "a single knot: constant 8")], 4), (1, 4, words, 3)]
    f.cluster(rows, (0, 7 * MS))
    f.close()
    note = """A channel in two tracks, one after the other: at rest in `KNOT`, then in `RAWB` with
another range. Track 1 continues track 0, so it has its channel, rate, calibration and unit. The
channel is 8 8 8 8 9 -7 5, one span."""
    return Example(f, note, {"0": [span(0, 8, 8, 8, 8, 9, -7, 5)]})


def quantised() -> Example:
    f = File(0x00000004, brief=True)
    f.head()
    m, r, c = 1, 2, 3
    lengths = [2, 3, 3, 3, 3, 0, 0, 2]
    book = page_quantised.codebook(lengths)
    parameters = [
        u32(3, "step 3"),
        u16(m, "M = 1: symbols 0, 1, 2 are levels 0, 1, -1"),
        u8(r, "R = 2: symbol 3 is a run of 2 or 3 zeros, 4 of 4 to 7"),
        u8(c, "C = 3: symbol 5 is magnitude 2, 6 is 3 or 4, 7 is 5 to 8"),
        raw(book, "lengths 2 3 3 3 3, none for 2 symbols, 2; a 0 fills the byte"),
    ]
    words = page_quantised.code_words(lengths)
    f.chunk(
        "TRAK",
        plain(track("QUAN", low=-24, high=24, tlvs=[(1, "codec parameters", parameters)])),
    )
    tokens = [1, Escape(-6), Run(5), -1, Escape(8), 0, Run(2), 1]
    levels = page_quantised.levels_of(tokens)
    body = page_quantised.encode(tokens, m, r, lengths)
    assert page_quantised.decode(body, len(levels), m, r, lengths) == levels
    told = ", ".join(f"{symbol}: {word}" for symbol, word in sorted(words.items()))
    about = "1, escape -6, 5 zeros, -1, escape 8, 0, 2 zeros, 1"
    f.cluster([(0, 0, [raw(body, about)], len(levels))], (0, len(levels) * MS))
    f.close()
    row = []
    for token in tokens:
        symbol, extra = page_quantised.symbol_of(token, m, r)
        row.append(f"`{words[symbol]}`" + (f" + `{extra}`" if extra else ""))
    note = f"""Codec `QUAN` with runs and escapes. The code words, by symbol, are {told}. The
packet holds, one after the other, code words + extra bits: {", ".join(row)}. The levels are
{" ".join(map(str, levels))}; a count is 3 times its level."""
    return Example(f, note, {"0": [span(0, *(3 * level for level in levels))]})


def binary64(x: float) -> int:
    return page_exact.word_at(page_exact.place(page_exact.bits(page_exact.Fraction(x)))) % 2**64


def raws() -> Example:
    f = File(0x00000005, brief=True)
    f.head()
    two = [u8(2, "2 bytes per number"), raw(bytes(3), "reserved")]
    eight = [u8(8, "8 bytes per number"), raw(bytes(3), "reserved")]
    vector = track("RAWB", low=-300, high=300, components=2, tlvs=[(1, "codec parameters", two)])
    doubles = track(
        "RAWB", low=0, high=0, number_format=5, channel=2, tlvs=[(1, "codec parameters", eight)]
    )
    f.chunk("TRAK", plain(vector, doubles))
    counts = [[1, -2, 300], [0, 5, -300]]
    stored = page_raw.encode(counts, 2)
    planes = [
        u8(0, "stored"),
        raw(stored[1:4], "low bytes of 1, -2, 300"),
        raw(stored[4:7], "high bytes of 1, -2, 300"),
        raw(stored[7:10], "low bytes of 0, 5, -300"),
        raw(stored[10:13], "high bytes of 0, 5, -300"),
    ]
    assert stored[13:] == b""
    numbers = [0.1] * 12
    words = [binary64(x) for x in numbers]
    squeezed = page_raw.encode([words], 8, page_raw.DEFLATE, deflate.FIXED)
    body = [u8(1, "DEFLATE"), raw(squeezed[1:], "96 bytes: 12 lowest bytes, ... 12 highest bytes")]
    rows = [(0, 0, planes, 3), (1, 0, body, 12)]
    f.cluster(rows, (0, 12 * MS))
    f.close()
    note = """Codec `RAWB`: two channels of counts in one track, stored, and a channel of
binary64 numbers, compressed. Channel 0 is 1 -2 300, channel 1 is 0 5 -300, channel 2 is 12 times
0.1, `3FB999999999999A`. Each component is stored byte plane by byte plane."""
    a, b = counts
    return Example(f, note, {"0": [span(0, *a)], "1": [span(0, *b)], "2": [span(0, *words)]})


def coded() -> Example:
    f = File(0x00000006, brief=True)
    f.head()
    parameters = [
        u8(1, "linear"), u8(1, "entropy coding"), u8(0, "uniform grid"), varint(10, "step 10"),
        svarint(500, "zero 500"),
    ]  # fmt: skip
    vector = track(
        "KNOT", low=0, high=1000, components=2, tlvs=[(1, "codec parameters", parameters)]
    )
    f.chunk("TRAK", plain(vector))
    given = [(0, [0, 5]), (4, [2, 3]), (6, [-1, 3]), (9, [0, 0])]
    packet = page_knots_coded.encode_knots(given, True)
    assert page_knots_coded.decode_knots(packet, True, 10, 2, 2**24) == given
    body = [
        svarint(0, "first knot: index 0 of component 0"),
        svarint(5, "index 5 of component 1"),
        varint(3, "3 knots after it"),
        raw(packet[3:], "coded bytes: gaps and differences, by bits"),
    ]
    f.cluster([(0, 0, body, 10)], (0, 10 * MS))
    f.close()
    first = [500, 505, 510, 515, 520, 505, 490, 493, 497, 500]
    second = [550, 545, 540, 535, 530, 530, 530, 520, 510, 500]
    note = """Codec `KNOT` with entropy coding: two components share the ticks of their knots.
The indices are 0 and 5 at tick 0, 2 and 3 at tick 4, -1 and 3 at tick 6, 0 and 0 at tick 9; a
count is 500 + 10 * index. Channel 0 is 500 505 510 515 520 505 490 493 497 500, channel 1 is 550
545 540 535 530 530 530 520 510 500."""
    return Example(f, note, {"0": [span(0, *first)], "1": [span(0, *second)]})


def predicted() -> Example:
    f = File(0x00000007, brief=True)
    f.head()
    lossless = [u8(0, "uniform grid"), varint(1, "step 1"), svarint(0, "zero 0")]
    weber = [
        u8(1, "deadband grid"), varint(20, "floor 20"), svarint(0, "zero 0"), varint(1, "kn = 1"),
        varint(10, "kd = 10"),
    ]  # fmt: skip
    pair = track("LPCR", low=-100, high=100, components=2, tlvs=[(1, "codec parameters", lossless)])
    rough = track("LPCR", low=-500, high=500, channel=2, tlvs=[(1, "codec parameters", weber)])
    f.chunk("TRAK", plain(pair, rough))
    squares = [0, 1, 4, 9, 16, 25, 36, 49]
    twin = [(x + 1) // 2 for x in squares]
    one = page_predicted.encode(squares, g=2)
    reference = (0, 0, 32, 0)
    two = page_predicted.encode(twin, references=[reference], components=[squares])
    both = varint_bytes(len(one)) + one + two
    assert page_predicted.decode_packet(both, 8, 2**24, 2) == [squares, twin]
    first = [
        varint(len(one), f"component packet 0: {len(one)} bytes"),
        u8(2, "flags: second differences"),
        u8(0, "no predictor"),
        svarint(0, "base 0"),
        raw(one[3:5], "class 0, one state, raw signs; averages begin at 32"),
        raw(one[5:], "coded bytes"),
        u8(0x40, "component packet 1, flags: references"),
        u8(0, "no predictor"),
        u8(1, "one reference"),
        u8(0, "component 0"),
        raw(two[4:7], "weights 0, 32, 0: half of what component 0 does at this tick"),
        svarint(0, "base 0"),
        raw(two[8:10], "class 0, one state, raw signs; averages begin at 32"),
        raw(two[10:], "coded bytes"),
    ]
    assert joined(first) == both
    constant = [
        varint(3, "component packet 0: 3 bytes"),
        u8(0x10, "flags: constant"), u8(0, "no predictor"), svarint(5, "base 5"),
        u8(0x10, "component packet 1, flags: constant"), u8(0, "no predictor"),
        svarint(-5, "base -5"),
    ]  # fmt: skip
    indices = [0, 1, 2, 2, -1]
    coarse = page_predicted.encode(indices)
    levels = page_predicted.grid_levels(1, 10, 20, 2**24)
    grid = [
        u8(0, "flags"), u8(0, "no predictor"), svarint(0, "base 0"),
        raw(coarse[3:5], "class 0, one state, raw signs; averages begin at 32"),
        raw(coarse[5:], "coded bytes"),
    ]  # fmt: skip
    rows = [
        (0, 0, first, 8),
        (0, 8, constant, 3),
        (1, 0, grid, 5),
    ]
    f.cluster(rows, (0, 11 * MS))
    f.close()
    rough_counts = [levels[abs(i)] * (-1 if i < 0 else 1) for i in indices]
    note = f"""Codec `LPCR`. Track 0 is lossless and has two components: second differences, and
a reference of weight 1/2. Channel 0 is {" ".join(map(str, squares))}, then 5 5 5; channel 1 is
{" ".join(map(str, twin))}, then -5 -5 -5. Track 1 is on a deadband grid: the indices
{" ".join(map(str, indices))} are the counts {" ".join(map(str, rough_counts))}."""
    expected = {
        "0": [span(0, *squares, 5, 5, 5)],
        "1": [span(0, *twin, -5, -5, -5)],
        "2": [span(0, *rough_counts)],
    }
    return Example(f, note, expected)


def transformed() -> Example:
    f = File(0x0000000E, brief=True)
    f.head()
    parameters = [
        u8(5, "blocks of 32 coefficients"), varint(256, "step 256/256: one count"),
        u8(0, "no weights"),
    ]  # fmt: skip
    f.chunk(
        "TRAK",
        plain(track("MDCT", low=0, high=200, tlvs=[(1, "codec parameters", parameters)])),
    )
    steps = page_transform.steps(5, 256)
    packet = page_transform.encode([[12, 0], [0, 10]], steps, 100, classes=(0, 4))
    counts = page_transform.decode(packet, 48, 5, steps)
    body = [
        svarint(100, "base 100"),
        varint(2, "two coefficients of each block"),
        u8(0x40, "classes: 0 of quantiser 0, 4 of quantiser 1"),
        u8(12, "averages begin at 32"),
        raw(packet[5:], "coded bytes: 12, 0, then 0, 10"),
    ]
    assert joined(body) == packet
    f.cluster([(0, 0, body, 48), (0, 48, [svarint(100, "base 100"), varint(0, "none")], 4)],
              (0, 52 * MS))  # fmt: skip
    f.close()
    note = f"""Codec `MDCT`: 48 ticks in two blocks, then a packet without coefficients. All
integers are even: the state is 0 throughout, and a coefficient is twice its integer. Block 0 is 24
times a quarter of a cosine, block 1 is 20 times three quarters. From tick 16 to 47 they are mixed.
The counts are {" ".join(map(str, counts))}, then 100 100 100 100."""
    return Example(f, note, {"0": [span(0, *counts, 100, 100, 100, 100)]})


def exact() -> Example:
    f = File(0x00000008, brief=True)
    f.head()
    rule0 = [u8(0, "rule 0: quotient"), u8(0, "no digits"), raw(bytes(2), "reserved")]
    tenths = [svarint(1, "A = 1"), svarint(0, "B = 0"), varint(10, "D = 10")]
    tlvs = [(1, "codec parameters", rule0), (3, "calibration", tenths)]
    f.chunk("TRAK", plain(track("LPCX", low=0, high=10, tlvs=tlvs)))
    counts = [1, 2, 3, 3, 7, 3]
    numbers = [0.1, 0.2, 0.30000000000000004, 0.30000000000000004, 0.7000000000000001,
               0.30000000000000004]  # fmt: skip
    indices = page_predicted.encode(counts)
    words = [page_exact.bits(page_exact.Fraction(x)) for x in numbers]
    rest = page_exact.encode_exact(words, counts, (1, 0, 10), 0, 0, p=page_exact.EVEN)
    data = varint_bytes(len(indices)) + indices + rest
    affine = (1, 0, 10)
    assert page_exact.decode(data, 6, affine, 0, 0) == (counts, words)
    body = [
        varint(len(indices), f"{len(indices)} bytes of LPCR: the counts"),
        raw(indices, "1, 2, 3, 3, 7, 3"),
        u8(1, "flags: recall"),
        u8(0, "corrections in steps of 2^0"),
        raw(rest[2:8], "three times one probability of ranks, 128"),
        u8(0, "lengths from 0 on"),
        u8(2, "two lengths"),
        raw(rest[10:12], "equal weights"),
        raw(rest[12:], "coded bytes: corrections 0, 0, 1, 1, 1, 1"),
    ]
    f.cluster([(0, 0, body, 6)], (0, 6 * MS))
    f.close()
    told = " ".join(repr(x) for x in numbers)
    note = f"""Codec `LPCX`, exact doubles: a logger computed `count * 0.1`, and the file stores
`count / 10` with the correction that is left. The counts are {" ".join(map(str, counts))}; the
exact values are {told}. Where the quotient is not the source's number, the next binary64 number
is."""
    values = [{"start": 0, "exact": [f"{word % 2**64:016x}" for word in words]}]
    return Example(f, note, {"0": [span(0, *counts)], "exact": values})


def linear() -> Example:
    f = File(0x0000000C, brief=True)
    f.head()
    rules = [
        u8(0, "component 0, rule 0: quotient"), u8(0, "no digits"), raw(bytes(2), "reserved"),
        u8(4, "component 1, rule 4: linear"), u8(0, "no digits"), u8(2, "2 terms"),
        u8(0, "reserved"), raw(struct.pack("<d", 0), "c0 = 0"),
        u8(0, "component 0"), u8(0, "lag 0"), raw(struct.pack("<d", 0.3), "weight 0.3"),
        u8(1, "component 1 itself"), u8(1, "lag 1"), raw(struct.pack("<d", 0.7), "weight 0.7"),
    ]  # fmt: skip
    tenths = [svarint(1, "A = 1"), svarint(0, "B = 0"), varint(10, "D = 10, for both components")]
    tlvs = [(1, "codec parameters", rules), (3, "calibration", tenths)]
    f.chunk("TRAK", plain(track("LPCX", components=2, low=0, high=10, tlvs=tlvs)))
    forces = [6, 6, 10, 2, 5, 8]
    x = [count / 10 for count in forces]
    y = [x[0]]
    for now in x[1:]:
        y.append(y[-1] + 0.3 * (now - y[-1]))
    counts = [forces, [round(10 * each) for each in y]]
    words = [[page_exact.bits(page_exact.Fraction(each)) for each in row] for row in (x, y)]
    quotient = page_exact.Component((1, 0, 10))
    smooth = quotient._replace(rule=4, c=(0.0,), terms=((0, 0, 0.3), (1, 1, 0.7)))
    data = page_exact.encode_components(words, counts, [quotient, smooth])
    assert page_exact.decode_components(data, 6, [quotient, smooth]) == (counts, words)
    values = [page_exact.linear(t, c, smooth, words) for t, c in enumerate(counts[1])]
    away = [
        page_exact.place(word) - page_exact.place(page_exact.bits(v))
        for word, v in zip(words[1], values, strict=True)
    ]
    size, first = data[0], data[1]
    part = data[1 + size + 1 :]
    body = [
        varint(size, f"{size} bytes of LPCR: the counts"),
        varint(first, f"{first} bytes of component 0"),
        raw(data[2 : 2 + first], shown(counts[0])),
        raw(data[2 + first : 1 + size], shown(counts[1])),
        varint(data[1 + size], "0 bytes of component 0: every correction is 0"),
        u8(part[0], "component 1: no recall, one state"),
        u8(part[1], "corrections in steps of 2^0"),
        u8(part[2], f"lengths from {part[2]} on"),
        u8(part[3], f"{part[3]} lengths"),
        raw(part[4 : 4 + part[3]], "equal weights"),
        raw(part[4 + part[3] :], f"coded bytes: corrections {shown(away)}"),
    ]
    f.cluster([(0, 0, body, 6)], (0, 6 * MS))
    f.close()
    note = f"""Rule 4 of `LPCX`. Channel 1 is channel 0 after a filter: a logger computed
`y + 0.3 * (x - y)`. The file stores `0.3 * x + 0.7 * y`, y being the exact value a tick before,
and corrections. At tick 0 the lag of 1 reaches before the packet, so v is the quotient. The exact
values of channel 1 are {" ".join(map(repr, y))}; their corrections are {shown(away)}."""
    exact = [[f"{word % 2**64:016x}" for word in row] for row in words]
    expected = {str(number): [span(0, *row)] for number, row in enumerate(counts)}
    return Example(f, note, expected | {"exact": [{"start": 0, "exact": row} for row in exact]})


def synthetic() -> Example:
    f = File(0x0000000D, brief=True)
    f.head()
    model = [u8(3, "intervals of 2^3 ticks"), u8(8, "8 intervals in a frame")]
    slow = track("KNOT", kind=1, low=-100, high=100, tlvs=[knots()])
    fast = track("NOIS", kind=2, low=-100, high=100, base=0, tlvs=[(1, "codec parameters", model)])
    f.chunk("TRAK", plain(slow, fast))
    gains, ks = [30, 34, 0], [100, -80]
    data = page_noise.encode(gains, [ks], 8, seed=2024)
    e = page_noise.decode(data, 3, 8, 20)
    assert max(map(abs, e)) <= 100
    texture = [
        u8(2, "two coefficients"),
        u8(0, "noise at every tick"),
        u32(2024, "seed"),
        u8(30, "gain index of interval 0"),
        raw(data[7:9], "gains: class 0, one state; averages begin at 32"),
        raw(data[9:11], "coefficients: class 0; averages begin at 32"),
        raw(data[11:], "coded bytes: gain differences 4, -34; coefficients 100, -80"),
    ]
    f.cluster([(0, 0, [svarint(7, "a single knot: constant 7")], 20), (1, 0, texture, 20)],
              (0, 20 * MS))  # fmt: skip
    f.close()
    note = f"""Codec `NOIS`: a constant force with a synthetic texture above it. The first 8 ticks
have the gain G(30) = {page_noise.gain_of(30)}. It rises to G(34) = {page_noise.gain_of(34)} over
the next 8, and falls to 0 over the last interval, of which the packet has 4 ticks. The HF track
decodes to {shown(e)}; the channel is 7 more."""
    return Example(f, note, {"0": [span(0, *(7 + each for each in e))]})


def shown(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))


def described() -> Example:
    f = File(0x00000009, brief=True)
    uuid = bytes.fromhex("6BA7B810 9DAD 11D1 80B4 00C04FD430C8")
    f.head(tlvs=[
        varint(2, "TLV 2, UUID"), varint(16, "16 bytes"),
        raw(uuid, "6ba7b810-9dad-11d1-80b4-00c04fd430c8"),
        varint(4, "TLV 4, epoch"), varint(16, "16 bytes"),
        i64(1_700_000_000 * 10**9, "tick 0 is at 1700000000 s UTC"),
        u64(1_000_000, "give or take 1 ms"),
        varint(6, "TLV 6, encoder"), varint(9, "9 bytes"), raw(b"bench 2.1", "'bench 2.1'"),
    ])  # fmt: skip
    calibrations = [
        svarint(1, "A = 1"), svarint(0, "B = 0"), varint(1000, "D = 1000"),
        svarint(1, "A = 1"), svarint(-500, "B = -500"), varint(1000, "D = 1000"),
    ]  # fmt: skip
    contract = [
        varint(1, "kn = 1"), varint(10, "kd = 10"), u8(2, "guaranteed, each component alone"),
        varint(5, "floor 5"), svarint(0, "zero 0"), varint(8, "floor 8"), svarint(500, "zero 500"),
    ]  # fmt: skip
    deviation = [
        raw(forge.deviation(2**-9, 2**-10), "declared 2^-9 N, largest 2^-10 N"),
        raw(forge.deviation(0, 0), "none of component 1"),
    ]
    tlvs = [
        knots(),
        strings(2, "label", "fx", "fy"),
        (3, "calibration", calibrations),
        strings(4, "unit", "N"),
        strings(6, "quantity", "force", None),
        strings(8, "axis", "x", "y"),
        strings(10, "group", "tip", None),
        strings(12, "body site", "index finger"),
        strings(14, "device", "stylus"),
        (16, "deadband contract", contract),
        (18, "deviation", deviation),
        (22, "provenance", [raw(b"bench 2", "'bench 2'")]),
    ]
    f.chunk("TRAK", plain(track("KNOT", components=2, high=1000, tlvs=tlvs)))
    second = track("KNOT", channel=2, tlvs=[knots()])
    inside = joined(second)
    squeezed = deflate.deflate(inside, deflate.FIXED)
    f.chunk(
        "TRAK",
        [
            varint(1, "the first track is track 1"),
            varint(len(inside), f"{len(inside)} bytes once inflated"),
            raw(squeezed, "DEFLATE: a track of channel 2"),
        ],
    )
    both = [svarint(100, "component 0: index 100"), svarint(600, "component 1: index 600")]
    rows = [
        (0, 0, both, 4),
        (1, 0, [svarint(7, "a single knot: constant 7")], 4),
    ]
    f.cluster(rows, (0, 4 * MS))
    f.close()
    note = """Every TLV of `HEAD` and of `TRAK`, and a description as a DEFLATE stream. Channel 0
is 0.1 N, channel 1 is (600 - 500) / 1000 = 0.1 N, channel 2 is 7. The byte 255 repeats the text
before it; a list of one entry applies to all components."""
    return Example(
        f, note, {"0": [span(0, *[100] * 4)], "1": [span(0, *[600] * 4)], "2": [span(0, *[7] * 4)]}
    )


def digests() -> Example:
    f = File(0x0000000A, brief=True)
    f.head()
    f.chunk("TRAK", plain(track("KNOT", tlvs=[knots()])))
    f.chunk("mETa", [raw(b'{"subject": 7}', '{"subject": 7}')])
    rows = [(0, 0, [svarint(5, "a single knot: constant 5")], 2)]
    f.cluster(rows, (0, 2 * MS))
    f.index()
    rows = [(0, 4, [svarint(6, "a single knot: constant 6")], 1)]
    f.cluster(rows, (4 * MS, 5 * MS))
    numbers = hashlib.sha256(struct.pack("<3i", 5, 5, 6)).digest()
    coverage = struct.pack("<4Q", 0, 2, 4, 1)
    digest = hashlib.sha256(numbers + coverage).digest()
    f.chunk("dGST", [varint(0, "track 0"), raw(digest, "SHA-256 of what it decodes to")])
    points = [
        varint(1, "1 + track 0"),
        u8(3, "3 bytes"), raw(b"UTC", "the clock 'UTC'"), varint(2, "2 points"),
        svarint(0, "tick 0"), i64(1_700_000_000 * 10**9, "at 1700000000 s"),
        varint(1000, "1000 ticks later"), varint(1_000_040_000, "1000040000 ns later"),
    ]  # fmt: skip
    f.chunk("cMAp", points)
    attachment = [
        u8(5, "5 bytes"), raw(b"a.txt", "the name 'a.txt'"), u8(10, "10 bytes"),
        raw(b"text/plain", "the media type"), raw(b"hello", "the content"),
    ]  # fmt: skip
    f.chunk("aTTc", attachment)
    f.close(indexed=True)
    note = f"""Two indexes, metadata, a digest, a map of a clock and an attachment. The channel
is 5 5, a gap at ticks 2 and 3, then 6. The digest is the SHA-256 of 64 bytes: first the SHA-256
of the counts `05 00 00 00 05 00 00 00 06 00 00 00`, which is `{numbers.hex()}`; then the
coverage, the u64 numbers 0, 2, 4, 1. Tick 500 is 500 020 000 ns after 1 700 000 000 s UTC."""
    return Example(f, note, {"0": [span(0, 5, 5), span(4, 6)]})


def salvaged() -> Example:
    f = File(0x0000000B, brief=True)
    f.head()
    f.chunk("TRAK", plain(track("KNOT", tlvs=[knots()])))
    bodies = [
        (0, [svarint(1, "packet of ticks 0 to 3: constant 1")]),
        (4, [svarint(2, "packet of ticks 4 to 7: constant 2")]),
        (8, [svarint(3, "packet of ticks 8 to 11: constant 3")]),
    ]
    rows = [(0, start, body, 4) for start, body in bodies]
    f.cluster(rows, (0, 12 * MS))
    end = f.offset
    f.close()
    at = end - 2
    note = f"""A damaged `DATA` payload. The listing is the file as it was written. In
`salvaged.hapf` the byte at offset 0x{at:X}, the packet of ticks 4 to 7, is `05`: a reader that
did not check would deliver -3. The payload CRC of the chunk differs, so the reader salvages
packets: the CRC of the first and of the third packet matches, that of the second does not. The
channel is 1 1 1 1, a gap at ticks 4 to 7, then 3 3 3 3. The damage report names ticks 4 to 7 of
track 0, and the exit code is 3."""
    expected = {"0": [span(0, 1, 1, 1, 1), span(8, 3, 3, 3, 3)]}
    return Example(f, note, expected, [(at, b"\x05")])


def table() -> Example:
    f = File(0x0000000D, brief=True)
    f.head()
    f.chunk("TRAK", plain(track("KNOT", tlvs=[knots()])))
    bodies = [
        (0, [svarint(1, "packet of ticks 0 to 3: constant 1")]),
        (4, [svarint(100, "packet of ticks 4 to 7: constant 100")]),
        (8, [svarint(3, "packet of ticks 8 to 11: constant 3")]),
    ]
    f.cluster([(0, at, body, 4) for at, body in bodies], (0, 12 * MS))
    size = [about for _, about in f.fields].index("2 bytes")
    offset, end = len(joined(f.fields[:size])), f.offset
    f.close()
    note = f"""A damaged table. The listing is the file as it was written. In `table.hapf` the byte
at offset 0x{offset:X} is `03`: it says that the second packet has 4 bytes, not 2. `forwards` finds
a place for the first row only, since the second row moves the third one. `backwards` begins at the
end of the payload, 0x{end:X}, and finds a place for the third. The second row has none, and the
report has a *bad-packet* of the 2 bytes between. The channel is 1 1 1 1, a gap at ticks 4 to 7,
then 3 3 3 3."""
    expected = {"0": [span(0, 1, 1, 1, 1), span(8, 3, 3, 3, 3)]}
    return Example(f, note, expected, [(offset, b"\x03")])


MAKERS: dict[str, Callable[[], Example]] = {
    "hold": hold,
    "residual": residual,
    "marks": marks,
    "continued": continued,
    "quantised": quantised,
    "raw": raws,
    "coded": coded,
    "predicted": predicted,
    "exact": exact,
    "linear": linear,
    "transformed": transformed,
    "synthetic": synthetic,
    "described": described,
    "digests": digests,
    "salvaged": salvaged,
    "table": table,
}

HEADER = """# Worked examples

Each listing is a file of `conformance/examples/`: offset, bytes, meaning. After the first example a
chunk header is one field of 32 bytes, and signature, `HEAD` and the last `fOOT` are left out. The
`.json` of the same name has what the file decodes to. `conformance/gen/examples.py` makes this page
and the files, and `tests/test_examples.py` compares them with a reader.
"""


BEGINNING, FOOTER = 43, 44
"""Bytes of signature and HEAD, and of fOOT."""


def ends_of(file: File) -> tuple[int, int]:
    """Where a listing begins and ends."""
    if not file.brief:
        return 0, file.offset
    return BEGINNING * (file.offsets["TRAK"] == BEGINNING), file.offset - FOOTER


def text() -> str:
    parts = [HEADER]
    for name, make in MAKERS.items():
        example = make()
        parts += [
            f"## {name}",
            "",
            textwrap.fill(example.note, 110, break_long_words=False, break_on_hyphens=False),
            "",
            "```",
            listing(example.file.fields, *ends_of(example.file)),
            "```",
            "",
        ]
    return "\n".join([*parts, PACKETS.read_text("utf-8")]) + packet_rows.text()


def outputs() -> dict[Path, bytes]:
    """Every file that this script makes."""
    found: dict[Path, bytes] = {PAGE: text().encode()}
    for name, make in MAKERS.items():
        example = make()
        found[EXAMPLES / f"{name}.hapf"] = example.data
        expected = json.dumps(example.expected, sort_keys=True, indent=1)
        found[EXAMPLES / f"{name}.json"] = (expected + "\n").encode()
    return found


def main() -> int:
    if sys.argv[1:] == ["--write"]:
        for path, data in outputs().items():
            path.write_bytes(data)
        return 0
    made = outputs()
    wrong = [
        path.name for path, data in made.items() if not path.exists() or path.read_bytes() != data
    ]
    print(f"differ: {', '.join(wrong)}" if wrong else "all as committed")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
