"""The container a second time, field by field, from SPEC.md: its tables as they are printed there,
what varies by hand. Gives the fields of a file that keeps every rule as plain dictionaries."""

from __future__ import annotations

import re
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "conformance" / "gen"))
import page  # noqa: E402

Plain = dict[str, Any]
ROW = re.compile(r"^\| (\d+) \| (\d+) \| (\S+) \| `(\w+)` \|", re.M)
CODES = {
    "u8": "B",
    "u16": "H",
    "u32": "I",
    "u64": "Q",
    "i32": "i",
    "i64": "q",
    "f32": "f",
    "f64": "d",
}
TEXT = (ROOT / "SPEC.md").read_text(encoding="utf-8")


def table(name: str) -> list[tuple[int, int, str, str]]:
    """(offset, size, type, field) of each row of a table of SPEC.md."""
    found = re.search(rf"<!-- table: {name} -->\n(.+?)<!-- end -->", TEXT, re.S)
    return [(int(a), int(b), kind, field) for a, b, kind, field in ROW.findall(found[1])]


class Cursor:
    def __init__(self, data: bytes):
        self.data, self.at = data, 0

    @property
    def left(self) -> int:
        return len(self.data) - self.at

    def take(self, size: int) -> bytes:
        assert size <= self.left, "bytes are missing"
        self.at += size
        return self.data[self.at - size : self.at]

    def text(self, size: int) -> str:
        return self.take(size).decode()

    def u8(self) -> int:
        return self.take(1)[0]

    def i64(self) -> int:
        return int.from_bytes(self.take(8), "little", signed=True)

    def varint(self) -> int:
        value, self.at = page.varint(self.data, self.at)
        return value

    def svarint(self) -> int:
        u = self.varint()
        return u // 2 if u % 2 == 0 else -(u + 1) // 2

    def fixed(self, name: str) -> Plain:
        out: Plain = {}
        for offset, size, kind, field in table(name):
            assert offset == sum(row[1] for row in table(name) if row[0] < offset), name
            raw = self.take(size)
            out[field] = raw if kind not in CODES else struct.unpack("<" + CODES[kind], raw)[0]
        return out

    def until_end(self, entry: Callable[[Cursor], Any]) -> list[Any]:
        out = []
        while self.left:
            out.append(entry(self))
        return out

    def times(self, count: int, entry: Callable[[Cursor], Any]) -> list[Any]:
        return [entry(self) for _ in range(count)]


def whole(data: bytes, read: Callable[[Cursor], Any]) -> Any:
    cursor = Cursor(data)
    out = read(cursor)
    assert cursor.left == 0, "bytes left over"
    return out


def chunk(c: Cursor) -> Plain:
    header = c.fixed("chunk header")
    header["type"] = header["type"].decode()
    payload = c.take(header["payload_size"])
    read = PAYLOADS.get(header["type"])
    return {"header": header, "payload": whole(payload, read) if read else payload}


def string(c: Cursor) -> Plain:
    size = c.u8()
    return {"size": size, "text": "" if size == 255 else c.text(size)}


def strings(c: Cursor, *_: Any) -> Plain:
    return {"entries": c.until_end(string)}


def tlv(c: Cursor, values: dict[int, Any], track: Plain | None = None) -> Plain:
    out: Plain = {"type": c.varint(), "size": c.varint()}
    value, read = c.take(out["size"]), values.get(out["type"])
    return out | {"value": whole(value, lambda c: read(c, track)) if read else value}


def channel_numbers(c: Cursor, _: Any) -> Plain:
    return {"further": c.until_end(lambda c: int.from_bytes(c.take(2), "little"))}


def epoch(c: Cursor, _: Any) -> Plain:
    return {"epoch_ns": c.i64(), "uncertainty_ns": int.from_bytes(c.take(8), "little")}


def head(c: Cursor) -> Plain:
    return c.fixed("HEAD") | {"tlvs": c.until_end(lambda c: tlv(c, {4: epoch, 6: text}))}


def trak(c: Cursor) -> Plain:
    out: Plain = {"first_track": c.varint(), "plain_size": c.varint()}
    rest = c.take(c.left)
    if out["plain_size"]:
        return out | {"stream": rest}
    return out | {"tracks": whole(rest, lambda c: {"tracks": c.until_end(track)})}


def track(c: Cursor) -> Plain:
    number_format, kind = divmod(c.u8(), 16)
    out: Plain = {"kind": kind, "number_format": number_format, "codec": c.text(4)}
    out |= {"component_count": c.u8(), "rate_num": c.varint(), "rate_den": c.varint()}
    out |= {"count_min": c.svarint(), "count_max": c.svarint()}
    out |= {"first_channel": c.varint(), "linked": c.varint(), "tlv_count": c.u8()}
    return out | {"tlvs": c.times(out["tlv_count"], lambda c: tlv(c, VALUES, out))}


def parameters(c: Cursor, track: Plain) -> Plain:
    read = PARAMETERS.get(track["codec"])
    return {"value": read(c) if read else c.take(c.left)}


def knot(c: Cursor) -> Plain:
    return {"interpolation": c.u8(), "coding": c.u8(), "grid": grid(c)}


def lpcx(c: Cursor) -> Plain:
    return {"components": c.until_end(lpcx_rule)}


def lpcx_rule(c: Cursor) -> Plain:
    out = c.fixed("LPCX parameters")
    if out["rule"] == 3:
        out["coefficients"] = c.times(4, f64)
    if out["rule"] == 4:
        out["constant"] = f64(c)
    out["weights"] = c.times(out["terms"], lpcx_term)
    return out


def lpcx_term(c: Cursor) -> Plain:
    return c.fixed("LPCX term")


def mdct(c: Cursor) -> Plain:
    out: Plain = {"m": c.u8(), "step": c.varint(), "weight_count": c.u8()}
    return out | {"weights": c.times(out["weight_count"], Cursor.u8)}


def f64(c: Cursor) -> float:
    value: float = struct.unpack("<d", c.take(8))[0]
    return value


def quan(c: Cursor) -> Plain:
    fields = c.fixed("QUAN parameters")
    nibbles = [nibble for byte in c.take(c.left) for nibble in divmod(byte, 16)]
    return fields | {"codebook": nibbles}


def grid(c: Cursor) -> Plain:
    out: Plain = {"grid": c.u8(), "step": c.varint(), "zero": c.svarint()}
    return out | ({"kn": c.varint(), "kd": c.varint()} if out["grid"] else {})


def calibrations(c: Cursor, _: Plain) -> Plain:
    return {"entries": c.until_end(lambda c: {"a": c.svarint(), "b": c.svarint(), "d": c.varint()})}


def contract(c: Cursor, track: Plain) -> Plain:
    out: Plain = {"kn": c.varint(), "kd": c.varint(), "flags": c.u8()}
    rows = c.times(track["component_count"], lambda c: {"floor": c.varint(), "zero": c.svarint()})
    return out | {"components": rows}


def deviations(c: Cursor, _: Plain) -> Plain:
    return {"entries": c.until_end(lambda c: c.fixed("deviation"))}


def text(c: Cursor, _: Plain) -> Plain:
    return {"text": c.text(c.left)}


def data(c: Cursor) -> Plain:
    fields = ("track", "size", "start", "span")
    count = c.varint()
    widths = int.from_bytes(c.take(2), "little")

    def row(c: Cursor) -> Plain:
        sizes = [widths >> 4 * place & 15 for place in range(4)]
        out: Plain = {
            field: int.from_bytes(c.take(size), "little")
            for field, size in zip((*fields, "packet_crc"), (*sizes, 4), strict=True)
        }
        return out

    out: Plain = {"packet_count": count, "widths": widths}
    out |= {f"least_{field}": c.varint() for field in fields}
    rows = c.times(count, row)
    out |= {"rows": rows, "table_crc": int.from_bytes(c.take(4), "little")}
    return out | {"packets": [c.take(out["least_size"] + each["size"]) for each in rows]}


def index(c: Cursor) -> Plain:
    def entry(c: Cursor) -> Plain:
        out: Plain = {"type": c.text(4), "distance": c.varint()}
        if out["type"] == "DATA":
            out |= {"start_ms": c.varint(), "length_ms": c.varint()}
        return out

    fixed = c.fixed("iNDX")
    return fixed | {"entries": c.times(fixed["entry_count"], entry)}


def named(c: Cursor) -> Plain:
    size = c.u8()
    return {"name_size": size, "name": c.text(size)}


def attachment(c: Cursor) -> Plain:
    out = named(c)
    out["media_type_size"] = c.u8()
    out["media_type"] = c.text(out["media_type_size"])
    return out | {"content": c.take(c.left)}


def clock(c: Cursor) -> Plain:
    out = {"track": c.varint()} | named(c)
    out["observation_count"] = count = c.varint()
    rows = []
    for i in range(count):
        row: Plain = {"tick": c.svarint()}
        row |= {"later_ns": c.svarint()} if i else {"first_time_ns": c.i64()}
        rows.append(row | {"uncertainty_ns": c.varint()})
    return out | {"observations": rows}


def clock_map(c: Cursor) -> Plain:
    out = {"track": c.varint()} | named(c)
    out["point_count"] = count = c.varint()
    first = [{"first_tick": c.svarint(), "first_time_ns": c.i64()}]
    rest = c.times(count - 1, lambda c: {"tick": c.varint(), "later_ns": c.varint()})
    return out | {"points": first + rest}


PAYLOADS = {
    "HEAD": head, "TRAK": trak, "DATA": data, "iNDX": index, "aTTc": attachment, "cLOk": clock,
    "cMAp": clock_map, "fOOT": lambda c: c.fixed("fOOT"),
    "mETa": lambda c: {"json": c.text(c.left)},
    "dGST": lambda c: {"track": c.varint(), "digests": c.until_end(lambda c: c.take(32))},
}  # fmt: skip
VALUES = {
    1: parameters, 3: calibrations, 5: channel_numbers, 16: contract, 18: deviations, 22: text,
    **dict.fromkeys((2, 4, 6, 8, 10, 12, 14), strings),
}  # fmt: skip
PARAMETERS = {
    "KNOT": knot, "QUAN": quan, "RAWB": lambda c: c.fixed("RAWB parameters"), "LPCR": grid,
    "LPCX": lpcx, "MDCT": mdct, "NOIS": lambda c: c.fixed("NOIS parameters"),
}  # fmt: skip


def parse(file: bytes) -> Plain:
    return whole(file, lambda c: {"signature": c.take(8), "chunks": c.until_end(chunk)})


def events(packet: bytes) -> Plain:
    def event(c: Cursor) -> Plain:
        out: Plain = {field: c.varint() for field in ("tick", "duration", "channel", "size")}
        return out | {"text": c.text(out["size"])}

    return {"events": Cursor(packet).until_end(event)}
