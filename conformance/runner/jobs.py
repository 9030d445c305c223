"""A job of the verb encode, and whether what was decoded keeps it: in integers, exactly."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from .compare import Difference, place_of, same, shown

TEXTS = ("label", "unit", "quantity", "axis", "group", "body_site", "device")
AXES = ("x", "y", "z")
FLOATS = {"binary16": ("H", "e"), "binary32": ("I", "f"), "binary64": ("Q", "d")}


def read_raw(path: Path, *, signed: bool) -> tuple[int, ...]:
    data = path.read_bytes()
    return struct.unpack(f"<{len(data) // 8}{'q' if signed else 'Q'}", data)


@dataclass
class Channel:
    """One of a job: ``numbers`` are counts and int64 as integers, other words as bits."""

    told: dict[str, Any]
    numbers: tuple[int, ...]

    @property
    def format(self) -> str:
        return str(self.told["format"])

    @property
    def calibration(self) -> tuple[int, int, int]:
        a, b, d = self.told.get("calibration") or (1, 0, 1)
        return a, b, d

    @property
    def zero(self) -> int:
        """The count of the physical value 0, to the nearest, half upwards."""
        a, b, _ = self.calibration
        n, d = (-b, a) if a > 0 else (b, -a)
        return (2 * n + d) // (2 * d)

    @property
    def spans(self) -> list[list[int]]:
        """Maximal ones."""
        out: list[list[int]] = []
        for start, stop in sorted(self.told["spans"]):
            if out and out[-1][1] == start:
                out[-1][1] = stop
            elif start < stop:
                out.append([start, stop])
        return out

    def value(self, number: int) -> Fraction | None:
        """The number of a word; None for one that is not finite."""
        if self.format in ("counts", "int64", "uint64"):
            return Fraction(number)
        whole, real = FLOATS[self.format]
        (found,) = struct.unpack(f"<{real}", struct.pack(f"<{whole}", number))
        try:
            return Fraction(found)
        except (ValueError, OverflowError):
            return None


@dataclass
class Job:
    told: dict[str, Any]
    channels: list[Channel]

    @property
    def lossless(self) -> bool:
        return self.told["mode"] == "lossless"


def read_job(path: Path) -> Job:
    told = json.loads(path.read_text(encoding="utf-8"))
    channels = [
        Channel(
            one,
            read_raw(path.parent / one["numbers"], signed=one["format"] in ("counts", "int64")),
        )
        for one in told["channels"]
    ]
    return Job(told, channels)


def description_differences(job: Job, decoded: dict[str, Any]) -> Iterator[Difference]:
    """Channels, their descriptions and spans; metadata; events."""
    found = decoded.get("channels", [])
    if len(found) != len(job.channels):
        yield Difference("channels", str(len(job.channels)), str(len(found)))
        return
    for place, (channel, got) in enumerate(zip(job.channels, found, strict=True)):
        where = f"channels[{place}]"
        wanted = {name: channel.told[name] for name in TEXTS if name in channel.told}
        if channel.format == "counts":
            wanted["calibration"] = list(channel.calibration)
        wanted |= {"channel": place, "spans": channel.spans}
        for name, value in wanted.items():
            if not same(value, got.get(name)):
                yield Difference(f"{where}.{name}", shown(value), shown(got.get(name)))
        if Fraction(*got.get("rate", (0, 1))) != Fraction(*channel.told["rate"]):
            rates = (shown(channel.told["rate"]), shown(got.get("rate")))
            yield Difference(f"{where}.rate", *rates)
    metadata = decoded.get("metadata") or {}
    for name, value in job.told.get("metadata", {}).items():
        if not same(value, metadata.get(name)):
            yield Difference(f"metadata.{name}", shown(value), shown(metadata.get(name)))
    wanted_events, found_events = events(job.told.get("events", [])), events(decoded["layers"])
    if wanted_events != found_events:
        yield Difference("events", shown(wanted_events), shown(found_events))


def events(layers: Sequence[dict[str, Any]]) -> list[tuple[Any, ...]]:
    """With exact seconds, since a layer may get another rate."""
    return sorted(
        (
            (layer["label"], tick / Fraction(*layer["rate"]), duration / Fraction(*layer["rate"]),
             -1 if channel is None else channel, text)
            for layer in layers
            for tick, duration, channel, text in layer["events"]
        )
    )  # fmt: skip


def sample_differences(job: Job, decoded: dict[str, Any], folder: Path) -> Iterator[Difference]:
    """Of a lossless job the numbers; of others whether each keeps the deadband."""
    found = decoded["channels"]
    if job.lossless:
        for place, (channel, got) in enumerate(zip(job.channels, found, strict=True)):
            yield from lossless_differences(channel, got, folder, f"channels[{place}]")
        return
    for group in groups(job.channels):
        rows = [read_raw(folder / Path(found[i]["numbers"]).name, signed=True) for i in group]
        yield from bound_differences(job, group, rows)


def lossless_differences(
    channel: Channel, got: dict[str, Any], folder: Path, where: str
) -> Iterator[Difference]:
    words = channel.format not in ("counts", "int64")
    if channel.format != "counts" and "exact" in got:
        name, counts, words = got["exact"], False, True
    else:
        name, counts = got["numbers"], "physical" in got
    signed = counts or not words
    numbers = read_raw(folder / Path(name).name, signed=signed)
    if len(numbers) != len(channel.numbers):
        yield Difference(where, f"{len(channel.numbers)} numbers", str(len(numbers)))
        return
    a, b, d = got.get("calibration", (1, 0, 1))
    as_counts = counts and channel.format != "counts"
    for i, (x, y) in enumerate(zip(channel.numbers, numbers, strict=True)):
        if as_counts:
            right = channel.value(x)
            equal = right is not None and right * d == y * a + b
        else:
            equal = x == y
        if not equal:
            yield Difference(f"{where}, {place_of(i, {'spans': channel.spans})}", str(x), str(y))
            return


def groups(channels: Sequence[Channel]) -> list[list[int]]:
    """Places of channels that may be one vector together."""
    out: list[list[int]] = []
    for place, channel in enumerate(channels):
        if out and may_be_vector(channels[out[-1][-1]], channel):
            out[-1].append(place)
        else:
            out.append([place])
    return out


def may_be_vector(before: Channel, channel: Channel) -> bool:
    one, other = before.told, channel.told
    return (
        bool(one.get("group"))
        and one.get("group") == other.get("group")
        and {one.get("axis"), other.get("axis")} <= set(AXES)
        and one.get("axis") != other.get("axis")
        and Fraction(*one["rate"]) == Fraction(*other["rate"])
        and before.spans == channel.spans
    )


def bound_differences(
    job: Job, group: Sequence[int], rows: Sequence[Sequence[int]]
) -> Iterator[Difference]:
    """DBC-002, each channel alone, or all of a group as a vector."""
    kn, kd = job.told.get("k", (0, 1))
    floor = job.told["floor"]
    channels = [job.channels[i] for i in group]
    for i, row in zip(group, rows, strict=True):
        if len(row) != len(job.channels[i].numbers):
            wanted = f"{len(job.channels[i].numbers)} numbers"
            yield Difference(f"channels[{i}]", wanted, str(len(row)))
            return
    for tick in range(len(rows[0]) if rows else 0):
        xs = [channel.numbers[tick] for channel in channels]
        ys = [row[tick] for row in rows]
        zs = [channel.zero for channel in channels]
        away = [abs(x - y) * kd for x, y in zip(xs, ys, strict=True)]
        room = [max(kn * abs(x - z), floor * kd) for x, z in zip(xs, zs, strict=True)]
        apart = all(a <= r for a, r in zip(away, room, strict=True))
        norm = kn * kn * sum((x - z) ** 2 for x, z in zip(xs, zs, strict=True))
        if not apart and sum(a * a for a in away) > max(norm, (floor * kd) ** 2):
            where = f"channels {list(group)}, {place_of(tick, {'spans': channels[0].spans})}"
            yield Difference(where, f"{xs} within {kn}/{kd}, at least {floor}", shown(ys))
            return
