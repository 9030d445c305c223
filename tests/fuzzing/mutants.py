"""Files that break rules although every checksum in them holds, and what all verbs owe to them.

The bytes within chunks and packets change, then the sizes and checksums around them are made right.
So each change reaches the code behind the checksums. A part of the files is damaged afterwards too.
"""

from __future__ import annotations

import io
import json
import random
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from terminal import Said, called

from hapfmt.edit.recover import recover
from hapfmt.errors import HapfmtError, TruncatedError, UnsupportedError
from hapfmt.limits import Limits
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

from .files import LIMITS, of_file
from .mend import SIZE, Part, build, parts_of, table_at

ROOT = Path(__file__).resolve().parent.parent.parent
VECTORS = ROOT / "conformance" / "vectors"
SETS = ("valid", "uncommon", "recoverable", "invalid", "future", "limits")
LARGEST_SEED = 1 << 12
"""Bytes of a file that mutants are made from."""

EDGES = (0, 1, 2, 3, 4, 5, 7, 8, 16, 127, 128, 255, 256, 65_535, (1 << 24) - 1, 1 << 32, 1 << 47)
NAMES = (b"HEAD", b"TRAK", b"DATA", b"iNDX", b"fOOT", b"mETa", b"aTTc", b"dGST", b"cLOk", b"cMAp")
TIGHT = Limits(
    samples=512, packet_samples=256, work_samples=2048, records=64, components=32, metadata=2048,
    attachments=2048, events=64,
)  # fmt: skip
"""So small that some of the files are above each of them."""


@cache
def seeds() -> tuple[bytes, ...]:
    """Small files: those of the fuzzer, and the conformance vectors."""
    found = [data for data in of_file() if len(data) <= LARGEST_SEED]
    paths = [path for folder in SETS for path in sorted((VECTORS / folder).rglob("*.hapf"))]
    found += [path.read_bytes() for path in paths if path.stat().st_size <= LARGEST_SEED]
    return tuple(dict.fromkeys(found))


FIRST = 12
"""So many of them make half of the mutants: written files, with each kind of chunk."""


def varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


class Row(NamedTuple):
    """A packet of a cluster: track, start, span, bytes."""

    track: int
    start: int
    span: int
    data: bytes


def rows_of(payload: bytes) -> list[Row] | None:
    """The packets of a cluster; None where its table cannot be read."""
    table = table_at(payload)
    if table is None:
        return None
    at, rows = table.stop + 4, []
    for track, size, start, span in table.rows:
        rows.append(Row(track, start, span, payload[at : at + size]))
        at += size
    return rows if at == len(payload) else None


def cluster_of(rows: list[Row]) -> bytes:
    """CRCs are zero: ``build`` makes them right."""
    fields = [(row.track, len(row.data), row.start, row.span) for row in rows]
    least = [min(column) for column in zip(*fields, strict=True)] or [0] * 4
    widths = [
        (max(column) - low).bit_length() + 7 >> 3
        for column, low in zip(zip(*fields, strict=True), least, strict=False)
    ]
    out = varint(len(rows))
    out += sum(width % 16 << 4 * place for place, width in enumerate(widths)).to_bytes(2, "little")
    out += b"".join(map(varint, least))
    for row in fields:
        for value, low, width in zip(row, least, widths, strict=True):
            out += (value - low).to_bytes(width, "little")
        out += bytes(4)
    return out + bytes(4) + b"".join(row.data for row in rows)


def number(rng: random.Random, old: int) -> int:
    """Near the old one, or one of the edges."""
    way = rng.randrange(3)
    if way == 0:
        return rng.choice(EDGES)
    return max(0, old + rng.choice((-2, -1, 1, 2)) * (1 if way == 1 else rng.randrange(1, 30)))


def change_bytes(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    at = rng.randrange(len(out) + 1)
    way = rng.randrange(8)
    if way < 4 and out:
        at %= len(out)
        out[at] = out[at] ^ 1 << rng.randrange(8) if way < 2 else rng.choice((0, 1, 127, 128, 255))
    elif way == 4:
        out[at:at] = rng.randbytes(rng.randrange(1, 5))
    elif way == 5:
        del out[at : at + rng.randrange(1, 5)]
    elif way == 6:
        del out[at:]
    else:
        other = rng.randrange(len(out) + 1)
        out[at : at + 8] = out[other : other + 8]
    return bytes(out)


def change_rows(rows: list[Row], rng: random.Random) -> list[Row]:
    if not rows:
        return rows
    rows = list(rows)
    at, other = rng.randrange(len(rows)), rng.randrange(len(rows))
    row, way = rows[at], rng.randrange(8)
    if way == 0:
        rows.insert(other, row)
    elif way == 1:
        rows.insert(other, rows.pop(at))
    elif way == 2 and len(rows) > 1:
        rows.pop(at)
    elif way == 3:
        rows[at] = row._replace(start=number(rng, row.start))
    elif way == 4:
        rows[at] = row._replace(span=number(rng, row.span))
    elif way == 5:
        rows[at] = row._replace(track=rng.choice((number(rng, row.track), rows[other].track)))
    elif way == 6:
        rows[at] = row._replace(start=rows[other].start)
    else:
        rows[at] = row._replace(data=change_bytes(row.data, rng))
    return rows


def change_parts(parts: list[Part], rng: random.Random) -> list[Part]:
    at, other = rng.randrange(len(parts)), rng.randrange(len(parts))
    part, way = parts[at], rng.randrange(16)
    if way == 0:
        parts.insert(other, part)
    elif way == 1:
        parts.insert(other, parts.pop(at))
    elif way == 2 and len(parts) > 1:
        parts.pop(at)
    elif way == 3:
        parts[at] = part._replace(type=rng.choice((*NAMES, b"xXXx", b"XXXX", b"xXXX")))
    elif part.type == b"DATA" and way < 13:
        rows = rows_of(part.payload)
        if rows is not None:
            parts[at] = part._replace(payload=cluster_of(change_rows(rows, rng)))
    else:
        parts[at] = part._replace(payload=change_bytes(part.payload, rng))
    return parts


def mutant(seed: int) -> bytes:
    """The same file for the same number."""
    rng = random.Random(seed)
    known = seeds()
    parts = parts_of(known[rng.randrange(len(known) if rng.randrange(2) else FIRST)])
    if rng.randrange(8) == 0:
        # Chunks of another file, with the numbers of this one.
        parts += parts_of(known[rng.randrange(len(known))])[1:]
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if parts:
            parts = change_parts(parts, rng)
    data = build(parts)
    way = rng.randrange(10)
    if way == 0:
        data = change_bytes(data, rng)
    elif way == 1:
        data = data[: rng.randrange(len(data) + 1)]
    return data


ANEW = (
    "IDX",
    "FOT",
    "HED",
    "FIL",
    "TRK-001",
    "TRK-003",
    "TRK-007",
    "TRK-010",
    "TRK-016",
    "DAT-002",
    "DAT-008",
    "CHK",
    "CLK-005",
)
"""Rules of what ``recover`` writes anew or in another order, so that nothing is lost where a file
breaks them."""


def written_anew(data: bytes, error: HapfmtError) -> bool:
    """Whether the broken rule is one of those, or lies in an index or a footer, or in bytes that
    are left over after all packets of a cluster."""
    if (error.requirement or "").startswith(ANEW):
        return True
    if error.requirement == "DAT-005" and not isinstance(error, TruncatedError):
        return True
    at = 8
    for part in parts_of(data):
        stop = at + SIZE + len(part.payload)
        if at <= (error.offset or 0) <= stop and part.type in (b"HEAD", b"iNDX", b"fOOT"):
            return True
        at = stop
    return False


def limits_of(seed: int) -> Limits:
    return TIGHT if seed % 4 == 3 else LIMITS


Delivered = dict[int, list[tuple[int, int, bytes, bytes]]]
"""By track: start, stop, counts and exact values of each packet."""


def delivered(data: bytes, limits: Limits) -> Delivered | None:
    """What a reader delivers of the tracks of channels, none of which it reports as lost; None where
    it refuses the file."""
    found: Delivered = {}
    try:
        with Reader(data, limits=limits, scan=True) as reader:
            known = reader.catalogue.tracks
            tracks = [
                track for track in known.values()
                if track.kind != "events" and not track.unsupported and not track.is_orphan(known)
            ]  # fmt: skip
            for piece in reader.pieces(tracks, exact=True):
                exact = b"" if piece.exact is None else piece.exact.tobytes()
                stop = piece.start + len(piece.numbers)
                row = piece.start, stop, piece.numbers.tobytes(), exact
                found.setdefault(piece.track.id, []).append(row)
            for track, first, last, _ in reader.lost:
                for start, stop, _, _ in found.get(track, []):
                    end = stop if last is None else min(stop, last)
                    assert end <= max(start, first), (reader.lost, track, start, stop)
    except HapfmtError:
        return None
    return found


def check_recovered(data: bytes, limits: Limits) -> str:
    """Whatever ``recover`` writes verifies as intact under the same limits: only a part that is
    kept and not known makes it "unsupported". It has exactly what a reader delivers of the file,
    and that reports none of it as lost. Returns what became of the file."""
    before = verify(data, limits=limits)
    json.dumps(before.as_json(), allow_nan=False)
    out = io.BytesIO()
    try:
        done = recover(data, out, canonical=7, limits=limits)
    except HapfmtError as error:
        assert str(error)
        assert error.exit_code in (2, 4)
        return f"refused, {error.exit_code}"
    json.dumps(done.as_json(), allow_nan=False)
    after = verify(out.getvalue(), limits=limits)
    # What nobody knows is kept, and is no error of the recoverer; limits would be one.
    unknown = isinstance(after.error, UnsupportedError) or bool(after.unknown)
    assert after.verdict == "intact" or (after.verdict == "unsupported" and unknown), (after, done)
    assert not after.findings, (after, done)
    if done.exit_code == 0 and before.error is not None:
        assert written_anew(data, before.error), (before, done)
    if before.verdict == "intact":
        assert done.exit_code == 0
        assert (after.samples, after.events) == (before.samples, before.events)
    read = delivered(data, limits)
    if read is not None and after.verdict == "intact":
        assert delivered(out.getvalue(), limits) == read, done
    # What is intact stays as it is.
    again = io.BytesIO()
    assert recover(out.getvalue(), again, canonical=7, limits=limits).exit_code in (0, 4)
    return f"recovered, {done.exit_code}"


Line = tuple[str, ...]
VERBS: tuple[Line, ...] = (
    ("info", "IN", "--json"),
    ("info", "IN", "--events"),
    ("verify", "IN", "--json"),
    ("verify", "IN", "--max-memory", "100k"),
    ("recover", "IN", "OUT", "--json"),
    ("recover", "IN", "OUT", "--max-memory", "100k"),
    ("recover", "COPY", "--in-place"),
    ("dump", "IN"),
    ("dump", "IN", "--counts", "--max-memory", "1M"),
    ("du", "IN", "--json"),
    ("decode", "IN", "OUT.npz", "--max-memory", "4M", "--json"),
    ("decode", "IN", "OUT.npy", "--max-memory", "4M", "--channels", "0"),
    ("convert", "IN", "OUT.npz", "--max-memory", "4M"),
    ("subset", "IN", "OUT", "--channels", "0", "--max-memory", "4M"),
    ("subset", "IN", "OUT", "--start", "0.001", "--stop", "0.03", "--max-memory", "4M"),
    ("subset", "IN", "OUT", "--band", "lf", "--max-memory", "4M"),
    ("split", "IN", "--at", "0.003,0.01", "-o", "PARTS", "--max-memory", "4M"),
    ("concat", "IN", "IN", "OUT", "--max-memory", "4M"),
    ("merge", "IN", "IN", "OUT", "--same-times", "--max-memory", "4M"),
    ("annotate", "COPY", "here", "--at", "0.001"),
    ("annotate", "IN", "--list", "--json"),
    ("meta", "IN", "--json"),
    ("meta", "COPY", "who=me"),
    ("meta", "IN", "who=me", "-o", "OUT"),
    ("attach", "COPY", "NOTE"),
    ("attach", "IN", "--list"),
    ("attach", "IN", "--extract", "-o", "FOLDER"),
    ("clocks", "IN", "--json"),
    ("clocks", "IN", "--fit"),
)
PER_FILE = 4
"""Verbs that one mutant goes through, beside the law of recover."""
WRITING = ("recover", "split", "decode", "convert")
"""They write what they can, even where a part is not known (code 4)."""
CODES = {0, 1, 2, 3, 4}
PATHS = {
    "IN": "IN.hapf", "COPY": "COPY.hapf", "OUT": "out.hapf", "OUT.npz": "out.npz",
    "OUT.npy": "out.npy", "PARTS": "part-{:03d}.hapf", "NOTE": "note.txt", "FOLDER": "attached",
}  # fmt: skip


def check_verb(line: Line, data: bytes, folder: Path) -> Said:
    """A code of SPEC clause 13, no traceback, and nothing left behind by a verb that failed."""
    for name in ("IN.hapf", "COPY.hapf"):
        (folder / name).write_bytes(data)
    (folder / "note.txt").write_bytes(b"note")
    (folder / "attached").mkdir(exist_ok=True)
    words = [str(folder / PATHS[word]) if word in PATHS else word for word in line]
    told = called(*words)
    assert told.code in CODES, (line, told)
    assert "Traceback" not in told.err, (line, told)
    assert "Usage:" not in told.err and "o such option" not in told.err, (line, told)
    assert told.code == 0 or told.err or told.out, (line, told)
    outs = sorted(path for path in folder.iterdir() if path.name.startswith(("out", "part")))
    if told.code in (1, 2, 4) and line[0] not in WRITING:
        # Parts that are whole stay, and recover writes a file that holds something unknown.
        assert not outs, (line, told, outs)
    # Other verbs copy packets without decoding them: what was wrong stays wrong.
    sound = line[0] == "recover" or (bool(outs) and verify(data).exit_code == 0)
    for path in outs if told.code == 0 and sound else ():
        assert path.suffix != ".hapf" or verify(path.read_bytes()).exit_code in (0, 4), (line, told)
    if line[0] == "recover" and "COPY" in line and told.code in (0, 3):
        assert verify((folder / "COPY.hapf").read_bytes()).exit_code in (0, 4), (line, told)
    left = [path.name for path in folder.iterdir() if path.name.startswith(".")]
    assert not left, (line, left)
    assert (folder / "IN.hapf").read_bytes() == data
    return told


def clear(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir():
            clear(path)
        else:
            path.unlink()


def verbs_of(seed: int) -> Iterator[Line]:
    """Some of them, so that all have their turn."""
    for i in range(PER_FILE):
        yield VERBS[(seed * PER_FILE + i) % len(VERBS)]


def check(seed: int, folder: Path) -> list[str]:
    """One mutant; what became of it by recover and by each verb. AssertionError where a law does
    not hold, and whatever escapes."""
    data = mutant(seed)
    clear(folder)
    outcomes = [f"law: {check_recovered(data, limits_of(seed))}"]
    for line in verbs_of(seed):
        told = check_verb(line, data, folder)
        outcomes.append(f"{line[0]}: {told.code}")
        clear(folder)
    return outcomes
