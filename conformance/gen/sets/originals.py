"""SPEC 11 and TLV-006: files beside their originals, which keep what they promise, or do not.

Each is a folder: the file, and the original as the job of an encoder.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import forge as f
from broken import DATA, HEAD, TRACK, described, lasting, needs, packed
from case import DAMAGED, INTACT, Case

WIDE = {"level": 2, "count_min": -(2**31), "count_max": 2**31 - 1}


def source(values: Sequence[Any], format: str = "counts", spans: Any = None, **texts: str) -> dict:
    """A channel of a job, and its numbers as bytes."""
    layout = {"counts": "q", "int64": "q", "binary64": "d"}[format]
    raw = struct.pack(f"<{len(values)}{layout}", *values)
    told = {
        "label": "", "unit": "1", "rate": [1000, 1], "format": format,
        "calibration": [1, 0, 1] if format == "counts" else None, "bits": 24,
        "spans": spans or [[0, len(values)]],
    }  # fmt: skip
    return told | texts | {"raw": raw}


def constants(*counts: int, kn: int = 1, kd: int = 10, floor: int = 1, zero: int = 0,
              flags: int = 2, span: int = 4, **fields: Any) -> bytes:  # fmt: skip
    """A track of ``count`` constants, whose contract is guaranteed but where ``flags`` say else."""
    entries = [(floor, zero)] * len(counts)
    tlvs = f.HOLD + f.tlv(16, f.deadband(kn, kd, flags, entries))
    packet = b"".join(map(f.svarint, counts))
    given = {"component_count": len(counts), "count_min": -2000, "count_max": 2000} | fields
    return described(tlvs, packet=packet, span=span, **given)


def residual(contract: bytes) -> bytes:
    """A constant 100 and, next to it, 3."""
    lf = f.trak(kind=1, count_max=2000)
    hf = f.trak(f.HOLD + contract, kind=2, base=0, count_max=2000, first=1)
    packets = (0, 0, 4, f.svarint(100)), (1, 0, 4, f.svarint(3))
    return f.closed(HEAD, ("TRAK", lf), ("TRAK", hf),
                    ("DATA", f.cluster(*packets)), duration_ns=lasting(4))  # fmt: skip


def moved(declared: float, largest: float) -> bytes:
    return described(f.HOLD + f.tlv(18, f.deviation(declared, largest)))


def doubles(*values: float) -> bytes:
    words = struct.pack(f"<{len(values)}d", *values)
    planes = b"".join(words[i::8] for i in range(8))
    given = {"number_format": 5, "count_min": 0, "count_max": 0}
    return packed(b"RAWB", f.raw_parameters(8), b"\0" + planes, len(values), **given)


EXACT = packed(b"LPCX", f.lpcx_parameters(), b"\3\x10\0\2", tlvs=f.tlv(3, f.calibration(d=10)))
"""A tenth, four times."""

AFTER = 0.1 + 2.0**-56
TIGHT = f.tlv(16, f.deadband(1, 100, 2, ((1, 0),)))
LARGE = {"kn": 65535, "kd": 65535, "flags": 3, **WIDE}
PLAIN = f.closed(HEAD, TRACK, DATA)

# name, rule, about, file, channels of the original, exit code, samples outside of each channel,
# and the worst ratio where binary64 holds it
PROMISES = [
    ("floor-kept", "DBC-002", "Errors of the floor, 4 counts, are inside.",
     constants(100, kd=100, floor=4), [source([96, 104, 100, 98])], 0, [0], 1.0),
    ("floor-broken", "DBC-002", "One error is 6 counts, the floor 4.",
     constants(100, kd=100, floor=4), [source([96, 106, 100, 98])], 3, [1], 1.5),
    ("fraction-of-the-original", "DBC-002", "A tenth is that of the original: 111 is near to 100.",
     constants(100), [source([111, 91, 105, 95])], 0, [0], None),
    ("fraction-broken-above", "DBC-002", "112 is 12 from 100, and its tenth is less.",
     constants(100), [source([112, 100, 100, 100])], 3, [1], None),
    ("fraction-broken-below", "DBC-002", "90 is 10 from 100, and its tenth is less.",
     constants(100), [source([90, 100, 100, 100])], 3, [1], None),
    ("zero-kept", "DBC-002", "The tenth is that of the distance from zero, 1000.",
     constants(1011, zero=1000), [source([1010, 1010, 1012, 1012])], 0, [0], 1.0),
    ("zero-broken", "DBC-002", "1005 is 5 from zero: an error of 6 is too large.",
     constants(1011, zero=1000), [source([1005, 1011, 1011, 1011])], 3, [1], 6.0),
    ("no-fraction", "DBC-002", "With kn 0 the floor holds everywhere.",
     constants(1000, kn=0, floor=2), [source([1001, 1002, 998, 999])], 0, [0], 1.0),
    ("aim-missed", "DBC-002", "A contract that is not guaranteed is an aim.",
     constants(100, flags=0), [source([200, 0, 100, 100])], 0, [2], None),
    ("vector-kept", "DBC-002", "An error along x is small against a vector along y.",
     constants(5, 50, flags=3), [source([0] * 4), source([50] * 4)], 0, [0, 0], 1.0),
    ("vector-broken", "DBC-002", "The square of an error is 26, that of the tenth 25.",
     constants(5, 51, flags=3), [source([0] * 4), source([50] * 4)], 3, [4, 4], None),
    ("scalar-not-vector", "DBC-002", "The same errors as of a vector are too large for x alone.",
     constants(5, 50, flags=2), [source([0] * 4), source([50] * 4)], 3, [4, 0], None),
    ("vector-of-large-numbers-kept", "DBC-002", "Two squares of 2^92 and more are equal.",
     constants(0, 0, span=1, **LARGE), [source([2**30]), source([1])], 0, [0, 0], 1.0),
    ("vector-of-large-numbers-broken", "DBC-002", "Of two squares of 2^92 one is larger by 2^32.",
     constants(0, -1, span=1, **LARGE), [source([2**30]), source([0])], 3, [1, 1], None),
    ("contract-of-the-full-band", "DBC-002", "The contract of an HF track speaks of the sum.",
     residual(TIGHT), [source([103, 104, 102, 103])], 0, [0], None),
    ("contract-of-the-full-band-broken", "DBC-002", "100 is near to the LF part, not to the sum.",
     residual(TIGHT), [source([103, 103, 100, 103])], 3, [1], 3.0),
    ("lossless", "DBC-004", "Without a contract every count is that of the original.",
     PLAIN, [source([5] * 4)], 0, [0], None),
    ("not-lossless", "DBC-004", "Without a contract one count is another.",
     PLAIN, [source([5, 5, 6, 5])], 3, [1], None),
    ("sample-missing", "DBC-004", "The original has a sample more.",
     PLAIN, [source([5] * 5)], 3, None, None),
    ("sample-invented", "WRT-004", "The original has a gap where the file has a sample.",
     PLAIN, [source([5] * 3, spans=[[0, 2], [3, 4]])], 3, None, None),
    ("words-lossless", "DBC-004", "NaN and -0.0 are stored bit for bit.",
     doubles(1.5, -0.0, float("nan")), [source([1.5, -0.0, float("nan")], "binary64")], 0, [0],
     None),
    ("words-not-lossless", "DBC-004", "0.0 is stored where the original has -0.0.",
     doubles(1.5, 0.0), [source([1.5, -0.0], "binary64")], 3, [1], None),
    ("exact-values-lossless", "EXA-007", "The exact values are those of the original.",
     EXACT, [source([0.1] * 4, "binary64")], 0, [0], None),
    ("exact-values-not-lossless", "EXA-007", "One of the original's numbers is the next double.",
     EXACT, [source([0.1, 0.1, AFTER, 0.1], "binary64")], 3, [1], None),
    ("on-the-lattice", "TLV-006", "Without a deviation the original is on its lattice.",
     PLAIN, [source([5.0] * 4, "binary64")], 0, [0], None),
    ("off-the-lattice", "TLV-006", "Without a deviation a number of the original is 5.25.",
     PLAIN, [source([5.0, 5.25, 5.0, 5.0], "binary64")], 3, None, None),
    ("deviation-kept", "TLV-006", "The original is 0.25 from its lattice, as is said.",
     moved(0.5, 0.25), [source([5.25, 4.75, 5.0, 5.0], "binary64")], 0, None, None),
    ("deviation-broken", "TLV-006", "The original is 0.375 from its lattice, 0.25 is said.",
     moved(0.5, 0.25), [source([5.375, 5.0, 5.0, 5.0], "binary64")], 3, None, None),
]  # fmt: skip


def folder(data: bytes, channels: Sequence[dict]) -> dict[str, bytes]:
    out, told = {"file.hapf": data}, []
    for number, channel in enumerate(channels):
        name = f"channel-{number}.raw"
        out[name] = channel["raw"]
        told.append({k: v for k, v in channel.items() if k != "raw"} | {"numbers": name})
    job = {"channels": told, "mode": "lossless"}
    return out | {"job.json": (json.dumps(job, indent=1) + "\n").encode()}


def cases() -> Iterator[Case]:
    for name, rule, about, data, channels, code, outside, worst in PROMISES:
        expect: dict[str, Any] = {
            "needs": needs(data),
            "exit": {"verify": code},
            "verdict": {INTACT: "intact", DAMAGED: "damaged"}[code],
        }
        if outside is not None:
            rows = [{"channel": i, "outside": count} for i, count in enumerate(outside)]
            if worst is not None:
                rows = [row | {"worst": worst} for row in rows]
            expect["verify"] = {"contracts": rows}
        fault = "semantics/promise" if code else None
        rules = list(dict.fromkeys([rule, "DBC-002"]))
        yield Case(
            "encode", f"original-{name}", about, rules, folder(data, channels), expect, fault
        )
