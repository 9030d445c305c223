"""Jobs for encoders: what is to be stored, as JSON and raw numbers (conformance/README.md)."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from case import Case
from luck import Luck

SPAN = [[0, 400]]
AXES = "xyz"


def doubles(values: Sequence[float]) -> list[int]:
    return list(struct.unpack(f"<{len(values)}Q", struct.pack(f"<{len(values)}d", *values)))


def luck_of(seed: str) -> Luck:
    return Luck(zlib.crc32(seed.encode()))


def wander(seed: str, count: int, most: int, low: int, high: int) -> list[int]:
    """A random walk that is turned back at its bounds."""
    luck, at, out = luck_of(seed), (low + high) // 2, []
    for _ in range(count):
        at = max(low, min(high, at + luck.between(-most, most)))
        out.append(at)
    return out


def anything(seed: str, count: int, low: int, high: int) -> list[int]:
    luck = luck_of(seed)
    return [luck.between(low, high) for _ in range(count)]


def triangle(count: int, period: int, height: int) -> list[int]:
    """Slow, from -height to height and back."""
    half = period // 2
    return [
        (height * (4 * abs(tick % period - half) - period)) // period for tick in range(count)
    ]  # fmt: skip


def channel(
    values: Sequence[int],
    *,
    spans: Sequence[Sequence[int]] | None = None,
    format: str = "counts",
    rate: tuple[int, int] = (1000, 1),
    calibration: tuple[int, int, int] | None = None,
    bits: int = 24,
    **texts: str,
) -> dict[str, Any]:
    whole = [[0, len(values)]] if values else []
    spans = whole if spans is None else [list(span) for span in spans]
    assert sum(stop - start for start, stop in spans) == len(values)
    if format == "counts":
        assert all(-(1 << (bits - 1)) <= value < 1 << (bits - 1) for value in values)
        calibration = calibration or (1, 0, 1)
    return {
        "label": "", "unit": "1", **texts, "rate": list(rate), "format": format,
        "calibration": list(calibration) if calibration else None,
        "bits": bits, "spans": spans, "values": list(values),
    }  # fmt: skip


def job(
    name: str, about: str, channels: Sequence[dict[str, Any]], *, mode: str = "lossless",
    requirements: Sequence[str] = (), level: int = 1, **more: Any,
) -> Case:  # fmt: skip
    files: dict[str, bytes] = {}
    listed = []
    for number, each in enumerate(channels):
        values, raw = each["values"], f"{number}.raw"
        signed = each["format"] in ("counts", "int64")
        files[raw] = struct.pack(f"<{len(values)}{'q' if signed else 'Q'}", *values)
        listed.append({n: v for n, v in each.items() if n != "values"} | {"numbers": raw})
    told = {"channels": listed, "mode": mode} | more | {"file_id": f"0x{7:016x}"}
    data = {"job.json": (json.dumps(told, indent=1, ensure_ascii=False) + "\n").encode()} | files
    rules = {"lossless": ["DBC-004"], "deadband": ["DBC-002"], "split": ["DBC-002", "WRT-003"]}
    expect = {
        "needs": {"codecs": [], "level": level, "presets": [mode]}, "exit": {"encode": 0},
    }  # fmt: skip
    rules_ = [*rules[mode], "IDX-002", "WRT-002", *requirements]
    return Case("encode", name, about, rules_, data, expect)


def cases() -> Iterator[Case]:
    yield from counts()
    yield from shapes()
    yield from words()
    yield from deadbands()
    yield from splits()
    yield from besides()


def counts() -> Iterator[Case]:
    walk = wander("walk", 400, 9, -2000, 2000)
    yield job(
        "counts", "A channel of counts with a calibration and texts.",
        [channel(walk, calibration=(1, -5, 100), label="force", unit="N", quantity="force",
                 device="bench")],
    )  # fmt: skip
    yield job("noise", "Counts without any order.", [channel(anything("noise", 300, -4000, 4000))])
    yield job("constant", "One count, 400 times.", [channel([-77] * 400)])
    edges = [-(1 << 23), (1 << 23) - 1]
    yield job(
        "edges-of-24-bits", "The lowest and the highest count of level 1, in turn and in runs.",
        [channel((edges * 20 + edges[:1] * 30 + edges[1:] * 30) * 2)], requirements=["TRK-005"],
    )  # fmt: skip
    edges = [-(1 << 31), (1 << 31) - 1]
    yield job(
        "edges-of-32-bits", "The lowest and the highest count of level 2, in turn and in runs.",
        [channel((edges * 20 + edges[:1] * 30 + edges[1:] * 30) * 2, bits=32)], level=2,
        requirements=["TRK-005"],
    )  # fmt: skip
    yield job(
        "negative-slope", "A calibration with a negative A and a large D.",
        [channel(walk, calibration=(-3, 1000, 1_000_003), unit="rad")], requirements=["VAL-001"],
    )  # fmt: skip


def shapes() -> Iterator[Case]:
    """Spans, rates, numbers of channels and of clusters."""
    walk = wander("shapes", 400, 5, -500, 500)
    yield job("one-sample", "A recording of one sample.", [channel([42])])
    yield job("no-sample", "A channel with samples and one without.",
              [channel([]), channel(walk)])  # fmt: skip
    yield job("no-sample-at-all", "A channel without samples, and no other.", [channel([])])
    spans = [[3, 50], [60, 61], [200, 553]]
    holes = wander("holes", 401, 5, -500, 500)
    yield job(
        "gaps", "Gaps stay gaps; what is before the first sample is one.",
        [channel(holes, spans=spans), channel(walk)], requirements=["WRT-004"],
    )  # fmt: skip
    yield job(
        "late", "The first sample is an hour after the zero of the recording.",
        [channel(walk, spans=[[3_600_000, 3_600_400]])],
    )  # fmt: skip
    yield job(
        "rates", "Channels with rates of their own, one of them no whole number.",
        [channel(walk), channel(walk[:40], rate=(100, 1)), channel(walk[:133], rate=(1000, 3)),
         channel(walk, rate=(44_100, 1)), channel(walk[:3], rate=(1, 60))],
    )  # fmt: skip
    yield job(
        "many-clusters", "Clusters of a fiftieth of a second: too many chunks for no index.",
        [channel(walk), channel(walk[::-1])], cluster_s=[1, 50],
    )  # fmt: skip
    fine = wander("fine", 3000, 5, -500, 500)
    yield job(
        "between-milliseconds", "1024 ticks a second: clusters begin and end between milliseconds.",
        [channel(fine, rate=(1024, 1), spans=[[1, 3001]])], cluster_s=[1, 9],
        requirements=["IDX-002", "FOT-002"],
    )  # fmt: skip
    many = [
        channel(wander(f"many {n}", 60, 3, -90, 90), label=f"taxel {n}", calibration=(1, n, 10))
        for n in range(24)
    ]  # fmt: skip
    yield job("many-channels", "24 channels, alike and not.", many)
    base = wander("alike", 300, 20, -5000, 5000)
    alike = [channel([n * value // 3 + n for value in base], label=f"{n}") for n in (3, 4, -5)]
    yield job("alike", "Channels that are nearly multiples of one another.", alike)


def words() -> Iterator[Case]:
    tenths = [tick * 0.1 for tick in wander("tenths", 300, 4, -300, 300)]
    yield job(
        "doubles-of-a-lattice", "Doubles that are tenths of integers, rounded twice.",
        [channel(doubles(tenths), format="binary64", unit="N")], requirements=["EXA-007"],
    )  # fmt: skip
    ticks = wander("near tenths", 300, 4, -300, 300)
    lacking = [
        n * 0.1 * (1 + k / 2**52) for n, k in zip(ticks, anything("low", 300, -9, 9), strict=True)
    ]
    yield job(
        "doubles-near-a-lattice", "Doubles a few of their last bits from tenths of integers.",
        [channel(doubles(lacking), format="binary64", unit="N")], requirements=["EXA-007"],
    )  # fmt: skip
    full = [n / 2**53 for n in anything("doubles", 200, -(2**53), 2**53)]
    yield job(
        "doubles", "Doubles of full precision.",
        [channel(doubles(full), format="binary64")],
        requirements=["EXA-007"],
    )  # fmt: skip
    special = [0.0, -0.0, 5e-324, -5e-324, 1.7976931348623157e308, 2.0**-1022, 1.0, -1.0]
    yield job(
        "doubles-at-the-edges", "Both zeros, subnormal numbers, the largest one.",
        [channel(doubles(special * 5), format="binary64")], requirements=["EXA-007"],
    )  # fmt: skip
    patterns = [0x7FF0 << 48, 0xFFF0 << 48, 0x7FF8 << 48, 0x7FF0000000000001, 0xFFFFFFFFFFFFFFFF]
    yield job(
        "doubles-that-are-none", "Infinities, and NaN with several patterns: values, not marks.",
        [channel(doubles([1.5] * 20) + patterns + doubles([2.5] * 20), format="binary64")],
        requirements=["EXA-007", "WRT-004"],
    )  # fmt: skip
    edges = [-(1 << 63), (1 << 63) - 1, 0, -1, 1, 1 << 53, -(1 << 53) - 1]
    yield job("int64", "Integers of 64 bits.",
              [channel(edges + anything("int64", 93, -(1 << 62), 1 << 62), format="int64")],
              requirements=["TRK-006"])  # fmt: skip
    edges = [0, (1 << 64) - 1, 1 << 63, (1 << 53) + 1]
    yield job("uint64", "Unsigned integers of 64 bits.",
              [channel(edges + anything("uint64", 96, 0, (1 << 64) - 1), format="uint64")],
              requirements=["TRK-006"])  # fmt: skip
    for name, size in (("binary16", 16), ("binary32", 32)):
        top = (1 << size) - 1
        values = [0, 1, 1 << (size - 1), top >> 1, top, *anything(name, 95, 0, top)]
        yield job(name, f"Words of {name}, any pattern.", [channel(values, format=name)],
                  requirements=["TRK-006"])  # fmt: skip


def pressed(count: int, seed: str, height: int = 3000) -> list[int]:
    """Slow, with noise of a few counts."""
    noise = anything(seed, count, -6, 6)
    return [a + b for a, b in zip(triangle(count, 300, height), noise, strict=True)]


def deadbands() -> Iterator[Case]:
    force = {"unit": "N", "quantity": "force", "calibration": (1, 0, 1000)}

    def made(name: str, about: str, channels: Sequence[Any], k: Sequence[int], floor: int,
             **more: Any) -> Case:  # fmt: skip
        return job(name, about, channels, mode="deadband", k=k, floor=floor,
                   guaranteed=True, **more)  # fmt: skip

    slow = pressed(600, "deadband")
    yield made("deadband", "Every sample within a tenth of itself, or five counts.",
               [channel(slow, **force)], [1, 10], 5)  # fmt: skip
    yield made("deadband-floor", "With k = 0 the floor alone: every sample within three counts.",
               [channel(slow, **force)], [0, 1], 3)  # fmt: skip
    jumps = [value for value in anything("jumps", 30, -9000, 9000) for _ in range(9)]
    yield made("deadband-jumps", "A signal of jumps: a line that continues would leave the bound.",
               [channel(jumps, **force)], [1, 20], 4)  # fmt: skip
    stairs = [level * step for step in (5, 6, 10, 11) for level in range(-9, 10) for _ in range(4)]
    yield made("deadband-stairs", "Steps of the floor, of twice the floor, and one count more.",
               [channel(stairs, **force)], [0, 1], 5)  # fmt: skip
    offset = (1, -5000, 1000)
    raised = [value + 5000 for value in slow]
    yield made("deadband-zero", "The physical value 0 is count 5000: the deadband is narrow there.",
               [channel(raised, **(force | {"calibration": offset}))], [1, 10], 5)  # fmt: skip
    noisy = anything("deadband noise", 300, -2000, 2000)
    yield made("deadband-noise", "Noise far wider than its deadband.",
               [channel(noisy, **force)], [1, 50], 2)  # fmt: skip
    vector = [
        channel(pressed(500, f"vector {axis}", 1000 * n), **force, group="tool", axis=axis,
                label=f"F{axis}")
        for n, axis in enumerate(AXES, 1)
    ]  # fmt: skip
    yield made("deadband-vector", "Three axes of one group, which may share a deadband.",
               vector, [1, 10], 8)  # fmt: skip
    spans = [[0, 100], [150, 151], [400, 899]]
    yield made("deadband-gaps", "A deadband with gaps, in clusters of a tenth of a second.",
               [channel(slow, **force, spans=spans)], [1, 10], 5, cluster_s=[1, 10])  # fmt: skip
    yield made("deadband-one-sample", "A deadband of one sample.", [channel([700], **force)],
               [1, 10], 5)  # fmt: skip


def splits() -> Iterator[Case]:
    force = {"unit": "N", "quantity": "force", "calibration": (1, 0, 1000)}

    def texture(at: Callable[[int], int], seed: str) -> list[int]:
        slow, fine = pressed(1500, seed), triangle(1500, 14, 120)
        return [a + at(t) * b // 4 for t, (a, b) in enumerate(zip(slow, fine, strict=True))]

    whole = texture(lambda tick: 3 + tick % 2, "split")
    yield job("split", "A slow part and a fast, small one.", [channel(whole, **force)],
              mode="split", k=[1, 10], floor=10, guaranteed=True)  # fmt: skip
    parts = texture(lambda tick: 4 if tick // 300 % 2 else 0, "touch")
    yield job("split-clusters", "Texture that comes and goes, in clusters of a fifth of a second.",
              [channel(parts, **force), channel(whole, **force)], mode="split", k=[1, 20],
              floor=6, guaranteed=True, cluster_s=[1, 5])  # fmt: skip
    yield job("split-gaps", "Both bands have the gaps of the source.",
              [channel(whole, **force, spans=[[10, 700], [900, 1710]])], mode="split", k=[1, 10],
              floor=10, guaranteed=True, requirements=["DEC-003", "WRT-004"])  # fmt: skip


def besides() -> Iterator[Case]:
    walk = wander("besides", 200, 5, -500, 500)
    marks = [
        {"label": "marks", "rate": [1_000_000, 1], "events": [
            [0, 0, None, "start"], [50_000, 20_000, 1, "touch"], [50_000, 0, 0, "zweimal: äöü"],
            [150_000, 0, None, ""],
        ]},
        {"label": "observer 2", "rate": [1000, 1], "events": [[7, 3, None, "cough"]]},
    ]  # fmt: skip
    yield job("events", "Two layers of events, some of them about a channel.",
              [channel(walk), channel(walk)], events=marks, requirements=["EVT-004"])  # fmt: skip
    told = {
        "title": "Metall, gebürstet", "subjects": [1, 2.5, None, True], "nested": {"a": {"b": []}},
        "notes": ["first"],
    }  # fmt: skip
    yield job("metadata", "Metadata of every kind of value.", [channel(walk)], metadata=told,
              requirements=["MET-001"])  # fmt: skip
    yield job(
        "texts", "Every text of a channel, some of them beyond ASCII.",
        [channel(walk, label="Kraft ↑", unit="m/s2", quantity="acceleration", axis="z",
                 group="wrist", body_site="left index finger", device="ADXL"),
         channel(walk, label="Kraft ↑", unit="{raw(0-255)}")],
        requirements=["CNV-004"],
    )  # fmt: skip
