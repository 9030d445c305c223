"""Malformed files of every foreign format, made on disk; imports nothing of hapfmt but ``save``.

Half of the mutants have right checksums, lengths and containers, so that what lies behind them is
reached: members of zip files, records of MCAP, the footer of Parquet, blocks of HDF5, values of
JSON. ``python tests/fuzzing/foreign_files.py [--count N] [FORMAT ...]`` tries many.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import multiprocessing
import random
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).resolve().parents[up]) for up in (1, 2)]

import ros_files
import tdms_files
import xdf_files

from hapfmt.convert import read, save
from hapfmt.errors import DataWarning, HapfmtError, MovedTimesWarning
from hapfmt.recording import Calibration, Channel, Event, Recording

MEMORY = 1 << 22
"""Bytes that a conversion may take."""
ROOM = 512 << 20
"""Bytes of address space that a whole read may take; threads of libraries reserve some."""
SECONDS = 10
FAR = [0, 1, 2, 127, 128, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63]
WORDS = [
    None, True, -1, 0, 1, 2**31, 2**63, 10**400, 1e308, -1e308, float("nan"), float("inf"), "",
    "x", "é\0", "9" * 5000, [], {}, [[]], {"x": 1}, [1] * 50,
]  # fmt: skip

Change = Callable[[bytes, random.Random], bytes]


def change(data: bytes, rng: random.Random) -> bytes:
    """One to three bytes, numbers or parts otherwise than they were."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        at = rng.randrange(len(out) + 1)
        if rng.random() < 0.4:  # most of the structure is at both ends
            at = min(at, rng.randrange(len(out) + 1), rng.randrange(len(out) + 1))
        elif rng.random() < 0.3:
            at = len(out) - min(len(out), rng.randrange(200))
        kind = rng.randrange(8)
        if kind == 0:
            out[at : at + 1] = bytes([rng.randrange(256)])
        elif kind == 1 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif kind in (2, 3):
            size = rng.choice((1, 2, 4, 8))
            number = rng.choice(FAR) + rng.choice((-1, 0, 0, 1)) & (1 << 8 * size) - 1
            out[at : at + size] = number.to_bytes(size, rng.choice(("little", "big")))
        elif kind == 4:
            del out[at : at + rng.choice((1, 2, 4, 8, 64))]
        elif kind == 5:
            out[at:at] = rng.randbytes(rng.choice((1, 2, 4, 8)))
        elif kind == 6:
            start = rng.randrange(len(out) + 1)
            size = rng.choice((4, 8, 16, 64))
            out[at : at + size] = out[start : start + size]
        elif rng.random() < 0.3:
            del out[at:]
    return bytes(out)


# -- containers whose checksums and lengths are made right again


def change_zip(data: bytes, rng: random.Random) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        members = {name: old.read(name) for name in old.namelist()}
        chosen = rng.choice([*members])
        if rng.random() < 0.1:
            members[rng.choice([*members, "t.npy", "x__0.npy"])] = members.pop(chosen)
        else:
            members[chosen] = change(members[chosen], rng)
        for name, member in members.items():
            new.writestr(name, member)
    return out.getvalue()


def change_gzip(data: bytes, rng: random.Random) -> bytes:
    return gzip.compress(change(gzip.decompress(data), rng))


def change_mat(data: bytes, rng: random.Random) -> bytes:
    """The elements of MAT 5, inside their compression."""
    if data[512:516] == b"\x89HDF":
        return change_hdf5(data, rng)
    out, at, elements = data[:128], 128, []
    while at + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, at)
        elements.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    chosen = rng.randrange(len(elements))
    for number, (kind, body) in enumerate(elements):
        if number == chosen:
            inner = change(zlib.decompress(body) if kind == 15 else body, rng)
            elements[number] = (kind, zlib.compress(inner) if kind == 15 else inner)
        out += struct.pack("<II", kind, len(elements[number][1])) + elements[number][1]
    return out


def records_of(data: bytes, at: int, stop: int) -> list[tuple[int, bytes]]:
    records = []
    while at + 9 <= stop:
        size = int.from_bytes(data[at + 1 : at + 9], "little")
        records.append((data[at], data[at + 9 : at + 9 + size]))
        at += 9 + size
    return records


def joined(records: list[tuple[int, bytes]]) -> bytes:
    return b"".join(bytes([kind]) + struct.pack("<Q", len(body)) + body for kind, body in records)


def change_mcap(data: bytes, rng: random.Random) -> bytes:
    """A record, or one in a chunk; its length is right, and a CRC of 0 means that there is none."""
    records = records_of(data, 8, len(data) - 8)
    chosen = rng.randrange(len(records))
    kind, body = records[chosen]
    if kind == 6 and rng.random() < 0.8:
        head = 28 + 4 + int.from_bytes(body[28:32], "little")
        inner = records_of(body, head + 8, len(body))
        which = rng.randrange(len(inner))
        inner[which] = (inner[which][0], change(inner[which][1], rng))
        packed = joined(inner)
        body = body[:16] + struct.pack("<Q", len(packed)) + bytes(4) + body[28:head]
        body += struct.pack("<Q", len(packed)) + packed
    else:
        body = change(body, rng)
    records[chosen] = (kind, body)
    if rng.random() < 0.5:  # without a summary, whose offsets would be wrong
        records = [*(r for r in records if r[0] not in (2, 8, 10, 11, 13, 14)), (2, bytes(20))]
    return data[:8] + joined(records) + data[-8:]


def change_parquet(data: bytes, rng: random.Random) -> bytes:
    size = int.from_bytes(data[-8:-4], "little")
    pages, footer = data[: -8 - size], data[-8 - size : -8]
    if rng.random() < 0.7:
        footer = change(footer, rng)
    else:
        pages = change(pages, rng)
    return pages + footer + struct.pack("<I", len(footer)) + b"PAR1"


def lookup3(data: bytes) -> int:
    """The checksum of HDF5's metadata (Jenkins' lookup3, hashlittle)."""
    mask = 0xFFFFFFFF

    def rotated(x: int, by: int) -> int:
        return (x << by | x >> 32 - by) & mask

    a = b = c = (0xDEADBEEF + len(data)) & mask
    at, left = 0, len(data)
    while left > 12:
        a, b, c = ((old + int.from_bytes(data[at + 4 * i : at + 4 * i + 4], "little")) & mask
                   for i, old in enumerate((a, b, c)))  # fmt: skip
        for by in (4, 6, 8, 16, 19, 4):
            a = (a - c) & mask ^ rotated(c, by)
            c = (c + b) & mask
            a, b, c = b, c, a
        at, left = at + 12, left - 12
    if left:
        tail = data[at:].ljust(12, b"\0")
        a, b, c = ((old + int.from_bytes(tail[4 * i : 4 * i + 4], "little")) & mask
                   for i, old in enumerate((a, b, c)))  # fmt: skip
        c = ((c ^ b) - rotated(b, 14)) & mask
        a = ((a ^ c) - rotated(c, 11)) & mask
        b = ((b ^ a) - rotated(a, 25)) & mask
        c = ((c ^ b) - rotated(b, 16)) & mask
        a = ((a ^ c) - rotated(c, 4)) & mask
        b = ((b ^ a) - rotated(a, 14)) & mask
        c = ((c ^ b) - rotated(b, 24)) & mask
    return c


BLOCKS: dict[int, list[tuple[int, int]]] = {}


def hdf5_blocks(data: bytes) -> list[tuple[int, int]]:
    """Where the blocks of HDF5's metadata lie that end in a right checksum."""
    key = hash(data)
    if key not in BLOCKS:
        found = []
        for signature in (
            b"\x89HDF",
            b"OHDR",
            b"OCHK",
            b"FRHP",
            b"FHDB",
            b"BTHD",
            b"BTLF",
            b"FSHD",
        ):
            at = data.find(signature)
            while at >= 0:
                stop = next(
                    (s for s in range(at + 8, min(at + 700, len(data) - 3))
                     if lookup3(data[at:s]) == int.from_bytes(data[s : s + 4], "little")),
                    0,
                )  # fmt: skip
                found += [(at, stop)] if stop else []
                at = data.find(signature, at + 4)
        BLOCKS[key] = found
    return BLOCKS[key]


def change_hdf5(data: bytes, rng: random.Random) -> bytes:
    """Old files have no checksums; in new ones a block gets the right one again."""
    blocks = hdf5_blocks(data)
    if not blocks or rng.random() < 0.1:
        return change(data, rng)
    start, stop = rng.choice(blocks)
    block = change(data[start:stop], rng)[: stop - start].ljust(stop - start, b"\0")
    return data[:start] + block + struct.pack("<I", lookup3(block)) + data[stop + 4 :]


def change_riff(data: bytes, rng: random.Random) -> bytes:
    at, chunks = 12, []
    while at + 8 <= len(data):
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        chunks.append([data[at : at + 4], data[at + 8 : at + 8 + size]])
        at += 8 + size + size % 2
    chosen = rng.choice(chunks)
    chosen[1] = change(chosen[1], rng)
    body = b"WAVE" + b"".join(
        name + struct.pack("<I", len(each)) + each + bytes(len(each) % 2) for name, each in chunks
    )
    return b"RIFF" + struct.pack("<I", len(body)) + body


def change_xdf(data: bytes, rng: random.Random) -> bytes:
    at, chunks = 4, []
    while at < len(data):
        wide = data[at]
        size = int.from_bytes(data[at + 1 : at + 1 + wide], "little")
        at += 1 + wide
        chunks.append((int.from_bytes(data[at : at + 2], "little"), data[at + 2 : at + size]))
        at += size
    chosen = rng.randrange(len(chunks))
    chunks[chosen] = (chunks[chosen][0], change(chunks[chosen][1], rng))
    return data[:4] + b"".join(xdf_files.chunk(*each) for each in chunks)


def change_json(data: bytes, rng: random.Random) -> bytes:
    """A value is another one."""
    try:
        root = json.loads(data)
    except ValueError:
        return change(data, rng)
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        items = node.items() if isinstance(node, dict) else enumerate(node)
        for key, value in [*items]:
            places.append((node, key))
            if isinstance(value, (dict, list)):
                walk(value)

    walk(root)
    for node, key in rng.sample(places, min(len(places), rng.choice((1, 1, 2)))):
        if rng.random() < 0.15 and isinstance(node, dict):
            node.pop(key, None)
        else:
            node[key] = rng.choice(WORDS)
    try:
        return json.dumps(root).encode()
    except ValueError:
        return change(data, rng)


def change_text(data: bytes, rng: random.Random) -> bytes:
    """A cell, or a run of digits, is another text."""
    words = [str(w).encode() for w in WORDS if isinstance(w, (int, float, str))]
    cells = data.split(b",")
    cells[rng.randrange(len(cells))] = rng.choice([*words, b'"', b"\n\n", b";", b"\xff", b"1:2:3"])
    return b",".join(cells)


def change_edf(data: bytes, rng: random.Random) -> bytes:
    """Fields of the header, as texts of their width."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 2))):
        at = 8 * rng.randrange(32 + 16)
        text = str(rng.choice(["-1", "0", "1", "", "1e9", "nan", "99999999", "EDF+D", "0.00001"]))
        out[at : at + 8] = text.encode().ljust(8)
    return bytes(out)


# -- seeds


def recording() -> Recording:
    return Recording(
        (
            Channel(np.arange(60) / 8, 1000, label="x", unit="N"),
            Channel(np.arange(60, dtype=np.int16), 1000, label="y", unit="m/s2",
                    calibration=Calibration(1, 0, 8)),
        ),
        events=(Event(0, "touch"),),
    )  # fmt: skip


def saved(format: str, which: int | None = None) -> bytes:
    """What hapfmt itself writes: of all channels, or of one."""
    chosen = recording() if which is None else Recording((recording()[which],))
    out = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        save(chosen, out, format=format)
    return out.getvalue()


def hdf5(libver: str) -> bytes:
    import h5py

    out = io.BytesIO()
    with h5py.File(out, "w", libver=libver) as file:
        group = file.create_group("arm")
        group["force"] = np.arange(120.0).reshape(60, 2)
        group["time"] = np.arange(60) / 1000
        group.create_dataset("torque", data=np.arange(60, dtype="i2"), chunks=(16,), shuffle=True,
                             compression="gzip")  # fmt: skip
        group["force"].attrs["unit"] = "N"
        group["names"] = np.array([b"a", b"b"])
    return out.getvalue()


def mat(**how: Any) -> bytes:
    from scipy.io import savemat

    out = io.BytesIO()
    tree = {"s": {"force": np.arange(60.0), "unit": "N"}, "time": np.arange(60) / 1000,
            "x": np.arange(120, dtype=np.int16).reshape(60, 2), "c": np.array(["a", 1], object)}  # fmt: skip
    savemat(out, tree, **how)
    return out.getvalue()


def parquet(kind: str) -> bytes:
    import pyarrow as pa
    from pyarrow import feather
    from pyarrow import parquet as pq

    table = pa.table({
        "timestamp": pa.array(np.arange(60) / 1000), "f": pa.array(np.arange(60.0)),
        "w": pa.array([[1.0, 2.0]] * 60, pa.list_(pa.float32(), 2)),
        "i": pa.array(np.arange(60, dtype="i2")).dictionary_encode(),
    })  # fmt: skip
    out = io.BytesIO()
    if kind == "parquet":
        pq.write_table(table, out, compression="none")
    else:
        feather.write_feather(table, out, compression="uncompressed")
    return out.getvalue()


def mcap(**how: Any) -> bytes:
    from mcap.writer import CompressionType

    messages = [("/f", 10**9 + i * 10**6, {"x": i / 8, "v": [i, 1.5]}) for i in range(30)]
    return ros_files.json_mcap(messages, compression=CompressionType.NONE, enable_crcs=False, **how)


def xdf() -> bytes:
    head = xdf_files.header(
        1, "glove", "float32", 2, 1000, xdf_files.channels(("a", "N"), ("b", "V"))
    )
    x = np.arange(60, dtype="f4").reshape(30, 2)
    return b"XDF:" + xdf_files.chunk(1, b'<?xml version="1.0"?><info><version>1.0</version></info>') + (
        head
        + xdf_files.samples(1, "float32", x, [5 + i / 1000 for i in range(30)])
        + xdf_files.offset(1, 5.0, 0.25) + xdf_files.offset(1, 5.02, 0.25)
    )  # fmt: skip


def ahap() -> bytes:
    curve = [{"Time": t / 4, "ParameterValue": t / 8} for t in range(6)]
    parameters = [{"ParameterID": "HapticIntensity", "ParameterValue": 0.5}]
    pattern = [
        {"Event": {"Time": 0.1, "EventType": "HapticContinuous", "EventDuration": 0.5,
                   "EventParameters": parameters}},
        {"Event": {"Time": 0.2, "EventType": "HapticTransient", "EventParameters": parameters}},
        {"ParameterCurve": {"ParameterID": "HapticIntensityControl", "Time": 0,
                            "ParameterCurveControlPoints": curve}},
    ]  # fmt: skip
    return json.dumps({"Version": 1.0, "Pattern": pattern}).encode()


def tdms() -> bytes:
    x = np.arange(60, dtype="i2")
    more = {"wf_increment": 0.001, "unit_string": "N", **tdms_files.linear(0.5, 1)}
    return tdms_files.written([tdms_files.channel("g", "a", x, **more),
                               tdms_files.channel("g", "b", x / 8, wf_increment=0.001)])  # fmt: skip


def folder_files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def bag_files(kind: str) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        path, _ = ros_files.wrenches(Path(folder), kind, rows=25)
        return folder_files(path) if path.is_dir() else {"": path.read_bytes()}


def lerobot_files() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        save(Recording((recording()[0],)), Path(folder) / "set", format="lerobot", fps=10)
        return folder_files(Path(folder) / "set")


Seed = dict[str, bytes]
"""The files of a folder by name; a lone file has the name ""."""
SEEDS: dict[str, list[Callable[[], bytes | Seed]]] = {
    "npz": [lambda: saved("npz")],
    "npy": [lambda: saved("npy")],
    "csv": [lambda: saved("csv"), lambda: b"time [ms];a [N];b\n0;1,5;\n1;nan;-2e3\n2;1;1\n"],
    "wav": [lambda: saved("wav")],
    "flac": [lambda: saved("flac", which=1)],
    "edf": [lambda: saved("edf")],
    "bdf": [lambda: saved("bdf")],
    "hjif": [lambda: saved("hjif")],
    "ahap": [ahap],
    "xdf": [xdf],
    "xdfz": [lambda: gzip.compress(xdf())],
    "tdms": [tdms],
    "mcap": [mcap, lambda: mcap(use_chunking=False), lambda: bag_files("mcap")["a_mcap.mcap"]],
    "bag": [lambda: bag_files("bag")],
    "ros2": [lambda: bag_files("db3")],
    "hdf5": [lambda: hdf5("earliest"), lambda: hdf5("latest")],
    "mat": [mat, lambda: mat(do_compression=True), lambda: saved("mat")],
    "parquet": [lambda: parquet("parquet"), lambda: saved("parquet")],
    "feather": [lambda: parquet("feather"), lambda: saved("feather")],
    "lerobot": [lerobot_files],
}


SUFFIX = {"xdfz": "xdfz", "bag": "bag", "hdf5": "h5", "ros2": "", "lerobot": ""}
MENDED: dict[str, Change] = {
    "npz": change_zip,
    "npy": change,
    "csv": change_text,
    "wav": change_riff,
    "edf": change_edf,
    "bdf": change_edf,
    "hjif": change_json,
    "ahap": change_json,
    "xdf": change_xdf,
    "xdfz": change_gzip,
    "mcap": change_mcap,
    "hdf5": change_hdf5,
    "mat": change_mat,
    "parquet": change_parquet,
    "json": change_json,
}
"""By format, or by the suffix of a file in a folder."""


def seeds(format: str) -> list[Seed]:
    made = [make() for make in SEEDS[format]]
    return [each if isinstance(each, dict) else {"": each} for each in made]


def mutant(format: str, known: list[Seed], number: int) -> Seed:
    """The mutant of this number; odd ones have checksums and lengths right."""
    rng = random.Random(f"{format} {number}")
    seed = dict(rng.choice(known))
    name = rng.choice([*seed])
    mend = MENDED.get(Path(name).suffix[1:] if name else format, change)
    try:
        seed[name] = (mend if number % 2 else change)(seed[name], rng)
    except (struct.error, zipfile.BadZipFile):
        seed[name] = change(seed[name], rng)
    return seed


def put(seed: Seed, folder: Path, format: str) -> Path:
    """Writes the files; returns the path to read."""
    path = folder / f"mutant.{SUFFIX.get(format, format)}".rstrip(".")
    if "" in seed:
        path.write_bytes(seed[""])
        return path
    shutil.rmtree(path, ignore_errors=True)
    for name, data in seed.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(data)
    return path


def judge(path: Path) -> str:
    """ "read", or the name of our error; AssertionError or another exception where a law breaks."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for ours in (DataWarning, MovedTimesWarning):
            warnings.simplefilter("ignore", ours)
        warnings.filterwarnings("ignore", "[0-9]+ channels are called|unit .* is not known")
        try:
            read(path, rate=1000 if path.suffix == ".npy" else None, max_memory=MEMORY)
        except HapfmtError as error:
            assert path.name in str(error), f"no file name: {error}"
            return type(error).__name__
    return "read"


# -- many


def attempts(format: str, first: int, count: int, folder: Path) -> Iterator[tuple[int, str]]:
    known = seeds(format)
    for one in known:
        assert judge(put(one, folder, format)) == "read", f"{format}: a seed is not read"
    for number in range(first, first + count):
        path = put(mutant(format, known, number), folder, format)
        (folder / "number").write_text(str(number))
        started = time.monotonic()
        signal.alarm(SECONDS)
        try:
            outcome = judge(path)
        except Exception as error:
            last = error.__traceback__
            while last is not None and last.tb_next is not None:
                last = last.tb_next
            where = (
                f"{Path(last.tb_frame.f_code.co_filename).name}:{last.tb_lineno}" if last else ""
            )
            outcome = f"BROKEN {type(error).__name__} {where} {str(error)[:90]}"
        signal.alarm(0)
        if time.monotonic() - started > SECONDS / 4:
            outcome = f"SLOW {time.monotonic() - started:.1f} s {outcome}"
        yield number, outcome


def work(format: str, first: int, count: int, folder: str, results: Any) -> None:
    def late(*_: Any) -> None:
        raise RuntimeError("too slow")

    signal.signal(signal.SIGALRM, late)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    room = 4 * ROOM if format in ("parquet", "feather", "lerobot") else ROOM  # threads of pyarrow
    cap = pages * resource.getpagesize() + room
    resource.setrlimit(resource.RLIMIT_AS, (cap, cap))
    for found in attempts(format, first, count, Path(folder)):
        results.put(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", default=[*SEEDS])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    for format in asked.formats or [*SEEDS]:
        tally: Counter[str] = Counter()
        broken: dict[str, list[int]] = {}
        at, stop = asked.first, asked.first + asked.count
        began = time.monotonic()
        while at < stop:
            with tempfile.TemporaryDirectory() as folder:
                results = multiprocessing.SimpleQueue()
                process = multiprocessing.Process(
                    target=work, args=(format, at, stop - at, folder, results)
                )
                process.start()
                while process.is_alive() or not results.empty():
                    if results.empty():
                        process.join(0.02)
                        continue
                    number, outcome = results.get()
                    at = number + 1
                    key = outcome.split()[0]
                    tally[key] += 1
                    if key in ("BROKEN", "SLOW"):
                        text = re.sub("0x[0-9a-f]+|[0-9]{3,}", "N", outcome)
                        broken.setdefault(text[:150], []).append(number)
                if process.exitcode:
                    place = Path(folder) / "number"
                    number = int(place.read_text()) if place.exists() else stop
                    broken.setdefault(f"process ended: {process.exitcode}", []).append(number)
                    tally["DIED"] += 1
                    at = number + 1
                elif at < stop:
                    at = stop
        print(f"{format}: {dict(tally)} in {time.monotonic() - began:.0f} s", flush=True)
        for text, numbers in sorted(broken.items(), key=lambda item: -len(item[1])):
            print(f"    {len(numbers)} x {text} {numbers[:4]}", flush=True)


if __name__ == "__main__":
    main()
