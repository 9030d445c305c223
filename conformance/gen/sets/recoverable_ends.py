"""How files end: cut, not closed, appended to, zeros behind (SPEC 13 and 14)."""

from __future__ import annotations

from collections.abc import Iterator

import forge as f
import wreck as w
from case import Case
from wreck import HEAD, OPEN, STEADY, THREE, wrecked

DATA = STEADY.data
THIRD = STEADY.of("DATA", 2)
INDEX, FOOT = STEADY.of("iNDX"), STEADY.of("fOOT")
END = len(DATA)

EVERYTHING_AFTER = [(track, 12, None) for track in range(3)]
"""Whatever followed; nobody knows how much."""
THIRD_ON = [(track, 8, None) for track in range(3)]
TWO_CLUSTERS = dict.fromkeys(range(3), ((0, 8),))


def cases() -> Iterator[Case]:
    yield from open_files()
    yield from cuts()
    yield from ends()
    yield from indexes()


def open_files() -> Iterator[Case]:
    yield wrecked(
        "not-closed", "A file without index and footer: all chunks in it are valid.",
        ["FIL-003", "VRD-001"], "crash/not-closed", OPEN.data,
        damages=[("not-closed", len(OPEN.data), 0)], recover=0,
    )  # fmt: skip
    yield wrecked(
        "no-footer", "A file with an index and without a footer.",
        ["FIL-003", "VRD-001"], "crash/not-closed", DATA[: FOOT.at],
        damages=[("not-closed", FOOT.at, 0)], recover=0,
    )  # fmt: skip
    yield wrecked(
        "cut-between", "Cut between two clusters: no reader can know of the third.",
        ["FIL-003", "VRD-001"], "crash/cut-between", DATA[: THIRD.at], kept=TWO_CLUSTERS,
        damages=[("not-closed", THIRD.at, 0)], recover=0,
    )  # fmt: skip
    more = f.chunk("DATA", f.cluster(*w.clusters(12)[0]), 7)
    yield wrecked(
        "stale-footer", "A cluster was appended behind the footer, and the file not closed again.",
        ["FIL-003", "FOT-002", "VRD-001"], "crash/not-closed", DATA + more,
        kept=dict.fromkeys(range(3), ((0, 16),)),
        damages=[("not-closed", END + len(more), 0)], recover=0,
    )  # fmt: skip


def cuts() -> Iterator[Case]:
    zero, one, _ = THIRD.rows
    stop = one.at + 3
    yield wrecked(
        "cut-payload", "Cut within a packet: those before it are kept.",
        ["FIL-003", "REC-002", "REC-003", "REC-012", "VRD-001"], "crash/cut-payload", DATA[:stop],
        kept={0: ((0, 12),), 1: ((0, 8),), 2: ((0, 8),)},
        damages=[
            ("truncated", THIRD.at, stop - THIRD.at),
            ("bad-packet", zero.stop, stop - zero.stop), ("not-closed", stop, 0),
        ], lost=[(0, 12, None), (1, 8, None), (2, 8, None)],
    )  # fmt: skip
    row = THIRD.rows[1]
    yield wrecked(
        "last-cluster-of-an-open-file",
        "The last chunk of a file that was not closed is damaged: what followed is not known.",
        ["REC-003", "REC-012", "VRD-001"], "transmission/bit-flip", w.flip(OPEN.data, row.at),
        kept={0: ((0, 12),), 1: ((0, 8),), 2: ((0, 12),)},
        damages=[
            ("bad-payload", THIRD.at, THIRD.size), ("bad-packet", row.at, row.size),
            ("not-closed", len(OPEN.data), 0),
        ], lost=[(0, 12, None), (1, 8, None), (2, 12, None)],
    )  # fmt: skip
    stop = row.entry_stop
    yield wrecked(
        "cut-table", "Cut within the table of a cluster: no packet is left of it.",
        ["REC-003", "REC-012", "VRD-001"], "crash/cut-payload", DATA[:stop], kept=TWO_CLUSTERS,
        damages=[
            ("truncated", THIRD.at, stop - THIRD.at),
            ("bad-table", THIRD.payload, stop - THIRD.payload), ("not-closed", stop, 0),
        ], lost=THIRD_ON,
    )  # fmt: skip
    stop = THIRD.payload
    yield wrecked(
        "cut-behind-header", "Cut right behind the header of a cluster.",
        ["REC-003", "REC-012", "VRD-001"], "crash/cut-payload", DATA[:stop], kept=TWO_CLUSTERS,
        damages=[
            ("truncated", THIRD.at, w.HEADER), ("bad-table", stop, 0), ("not-closed", stop, 0),
        ],
        lost=THIRD_ON,
    )  # fmt: skip
    stop = THIRD.at + 31
    yield wrecked(
        "cut-header", "Cut within a header: its bytes are no chunk.",
        ["CHK-002", "REC-003", "REC-012", "VRD-001"], "crash/cut-header", DATA[:stop],
        kept=TWO_CLUSTERS, damages=[("garbage", THIRD.at, 31), ("not-closed", stop, 0)],
        lost=THIRD_ON,
    )  # fmt: skip
    for name, place in (("index", INDEX), ("footer", FOOT)):
        stop = place.stop - 5
        yield wrecked(
            f"cut-{name}", f"Cut within the {name}.", ["REC-003", "VRD-001"], "crash/cut-payload",
            DATA[:stop], lost=EVERYTHING_AFTER,
            damages=[("truncated", place.at, stop - place.at), ("not-closed", stop, 0)],
        )  # fmt: skip


def ends() -> Iterator[Case]:
    for name, data, extra, lost in (
        ("zeros-behind", DATA, [], []),
        ("zeros-behind-open", OPEN.data, [("not-closed", len(OPEN.data) + 512, 0)],
         EVERYTHING_AFTER),
    ):  # fmt: skip
        yield wrecked(
            name, "512 zeros follow the last chunk, as after a power failure.",
            ["FIL-002", "REC-003"], "crash/zeros", data + bytes(512),
            damages=[("garbage", len(data), 512), *extra], lost=lost,
        )  # fmt: skip
    data = f.cluster(*w.clusters(12)[0], file_id=9)
    other = f.file(("HEAD", f.head()), ("DATA", data), file_id=9)
    yield wrecked(
        "other-file-behind", "Another file follows this one.",
        ["CHK-004", "FIL-002"], "framing/other-file", DATA + other,
        damages=[("garbage", END, len(other)), ("other-file", END + 8, 0)],
    )  # fmt: skip
    track = STEADY.chunk("TRAK")
    for name, at, where in (
        ("duplicate-behind-index", FOOT.at, "between index and footer"),
        ("duplicate-behind-footer", END, "behind the footer"),
    ):
        yield wrecked(
            name, f"A chunk is repeated {where}: the file is closed, and its index lists all.",
            ["CHK-005", "FIL-003", "REC-003"], "framing/duplicate", w.with_bytes(DATA, at, track),
            damages=[("duplicate-chunk", at, len(track))], recover=[0, 3],
        )  # fmt: skip
    for name, place, damages, lost, recover in (
        ("index-flip", INDEX.payload, [("bad-payload", INDEX.at, INDEX.size)], [], 0),
        ("footer-flip", FOOT.payload,
         [("bad-payload", FOOT.at, FOOT.size), ("not-closed", END, 0)], [], 0),
        ("index-header-flip", INDEX.at + 9,
         [("garbage", INDEX.at, INDEX.size), ("missing-chunk", FOOT.at, 0)], [], 3),
        ("footer-header-flip", FOOT.at + 9,
         [("garbage", FOOT.at, FOOT.size), ("not-closed", END, 0)], EVERYTHING_AFTER, 3),
    ):  # fmt: skip
        what = name.split("-")[0]
        part = "header" if "header" in name else "payload"
        yield wrecked(
            name, f"A bit in the {part} of the {what} is wrong; no sample is lost.",
            ["CHK-002" if part == "header" else "CHK-003", "IDX-003"], "transmission/bit-flip",
            w.flip(DATA, place), damages=damages, lost=lost, recover=recover,
        )  # fmt: skip


def indexes() -> Iterator[Case]:
    """What indexes say of clusters that are lost."""
    sparse = w.lay(HEAD, THREE, *w.clusters(0, 40, 80))
    place = sparse.of("DATA", 1)
    kept = dict.fromkeys(range(3), ((0, 4), (80, 84)))
    yield wrecked(
        "index-tells-when", "A gap next to a lost cluster is no loss: the index tells its times.",
        ["REC-003", "REC-012", "IDX-002"], "transmission/bit-flip",
        w.flip(sparse.data, place.at), kept=kept, lost=[(track, 40, 44) for track in range(3)],
        damages=[
            ("garbage", place.at, place.size), ("missing-chunk", sparse.of("DATA", 2).at, 0),
        ],
    )  # fmt: skip
    row = sparse.row(1, 40)
    yield wrecked(
        "index-tells-of-neighbours",
        "A lost entry may have been one of the tracks next to it, within the times of the index.",
        ["REC-003", "REC-012"], "transmission/bit-flip", w.flip(sparse.data, row.at),
        kept=dict.fromkeys((0, 2), ((0, 4), (40, 44), (80, 84))) | {1: ((0, 4), (80, 84))},
        lost=[(1, 40, 44)],
        damages=[("bad-payload", place.at, place.size), ("bad-packet", row.at, row.size)],
    )  # fmt: skip
    bare = w.lay(HEAD, THREE, *w.clusters(0, 40, 80), close=False)
    yield wrecked(
        "no-index-tells-of-neighbours",
        "Without an index a lost entry may have been one of a neighbour, in the gaps next to it.",
        ["REC-003", "REC-012"], "transmission/bit-flip", w.flip(bare.data, row.at),
        kept=dict.fromkeys((0, 2), ((0, 4), (40, 44), (80, 84))) | {1: ((0, 4), (80, 84))},
        lost=[(0, 44, 80), (1, 4, 80), (2, 4, 40)],
        damages=[
            ("bad-payload", place.at, place.size), ("bad-packet", row.at, row.size),
            ("not-closed", len(bare.data), 0),
        ],
    )  # fmt: skip
    yield from closed_without()
    live = w.lay(HEAD, THREE, *w.clusters(0, 40), ("iNDX", b""), *w.clusters(80), close=False)
    place = live.of("DATA", 1)
    yield wrecked(
        "index-of-an-open-file", "The index of a file that was not closed tells of what is before.",
        ["REC-003", "REC-012"], "transmission/bit-flip", w.flip(live.data, place.at + 20),
        kept=kept, lost=[(track, 40, 44) for track in range(3)],
        damages=[
            ("garbage", place.at, place.size), ("missing-chunk", live.of("iNDX").at, 0),
            ("not-closed", len(live.data), 0),
        ],
    )  # fmt: skip
    late = live.of("DATA", 2)
    yield wrecked(
        "behind-the-last-index", "No index tells of what stood behind the last one.",
        ["REC-003", "REC-012"], "crash/cut-payload", live.data[: late.at + 7],
        kept=dict.fromkeys(range(3), ((0, 4), (40, 44))),
        lost=[(track, 44, None) for track in range(3)],
        damages=[("garbage", late.at, 7), ("not-closed", late.at + 7, 0)],
    )  # fmt: skip
    yield chain()


def closed_without() -> Iterator[Case]:
    """A closed file without an index: the packets next to a hole tell how far it may go."""
    laid = w.lay(HEAD, THREE, *w.clusters(0, 40, 80), indexed=False)
    place, last, foot = laid.of("DATA", 1), laid.of("DATA", 2), laid.of("fOOT")
    row, end = laid.row(1, 40), len(laid.data)
    kept = dict.fromkeys(range(3), ((0, 4), (80, 84)))
    yield wrecked(
        "no-index-packet-flip", "A packet of a closed file without an index is damaged.",
        ["REC-003", "REC-012", "FOT-002"], "transmission/bit-flip", w.flip(laid.data, row.at),
        kept=dict.fromkeys((0, 2), ((0, 4), (40, 44), (80, 84))) | {1: ((0, 4), (80, 84))},
        lost=[(0, 44, 80), (1, 4, 80), (2, 4, 40)],
        damages=[("bad-payload", place.at, place.size), ("bad-packet", row.at, row.size)],
    )  # fmt: skip
    yield wrecked(
        "no-index-header-flip",
        "A header in a closed file without an index is damaged: the packets around tell what was "
        "there.",
        ["REC-003", "REC-012", "CHK-002"], "transmission/bit-flip", w.flip(laid.data, place.at),
        kept=kept, lost=[(track, 4, 80) for track in range(3)],
        damages=[("garbage", place.at, place.size), ("missing-chunk", last.at, 0)],
    )  # fmt: skip
    yield wrecked(
        "no-index-cluster-lost", "A cluster of a closed file without an index is missing.",
        ["REC-003", "REC-012", "CHK-005"], "framing/missing",
        w.without(laid.data, place.at, place.stop),
        kept=kept, lost=[(track, 4, 80) for track in range(3)],
        damages=[("missing-chunk", place.at, 0)],
    )  # fmt: skip
    yield wrecked(
        "no-index-last-cluster-lost",
        "The last cluster of a closed file without an index is missing: the duration tells where "
        "it ended.",
        ["REC-003", "REC-012", "FOT-002"], "framing/missing",
        w.without(laid.data, last.at, last.stop),
        kept=dict.fromkeys(range(3), ((0, 4), (40, 44))),
        lost=[(track, 44, 84) for track in range(3)], damages=[("missing-chunk", last.at, 0)],
    )  # fmt: skip
    few = w.lay(HEAD, THREE, *w.clusters(0), close=False)
    for name, about, duration, stop in (
        ("within-a-tick", "which is within a tick", 43_999_999, 43),
        ("unknown", "but the largest i64 is no end", 2**63 - 1, None),
    ):  # fmt: skip
        foot_of = f.chunk("fOOT", f.foot(0, duration), 5)
        yield wrecked(
            f"no-index-duration-{name}",
            f"Clusters are missing at the end; the duration tells how far, {about}.",
            ["REC-003", "REC-012"], "framing/missing", few.data + foot_of,
            kept=dict.fromkeys(range(3), ((0, 4),)),
            lost=[(track, 4, stop) for track in range(3)],
            damages=[("missing-chunk", len(few.data), 0)],
        )  # fmt: skip
    for name, at, damages, lost in (
        ("payload", foot.payload, [("bad-payload", foot.at, foot.size), ("not-closed", end, 0)],
         []),
        ("header", foot.at + 9, [("garbage", foot.at, foot.size), ("not-closed", end, 0)],
         [(track, 84, None) for track in range(3)]),
    ):  # fmt: skip
        yield wrecked(
            f"no-index-footer-{name}-flip",
            f"A bit in the {name} of the footer is wrong, and there is no index.",
            ["FIL-003", "REC-003"], "transmission/bit-flip", w.flip(laid.data, at),
            kept=dict.fromkeys(range(3), ((0, 4), (40, 44), (80, 84))), damages=damages, lost=lost,
            recover=3 if lost else 0,
        )  # fmt: skip
    stop = last.rows[1].at + 3
    zero = last.rows[0]
    yield wrecked(
        "no-index-cut", "A file without an index is cut within its last cluster.",
        ["FIL-003", "REC-003", "REC-012"], "crash/cut-payload", laid.data[:stop],
        kept={0: ((0, 4), (40, 44), (80, 84)), 1: ((0, 4), (40, 44)), 2: ((0, 4), (40, 44))},
        damages=[
            ("truncated", last.at, stop - last.at), ("bad-packet", zero.stop, stop - zero.stop),
            ("not-closed", stop, 0),
        ], lost=[(0, 84, None), (1, 44, None), (2, 44, None)],
    )  # fmt: skip
    yield wrecked(
        "no-index-head-flip", "HEAD of a closed file without an index is damaged.",
        ["CHK-003", "HED-001"], "transmission/bit-flip", w.flip(laid.data, 8 + w.HEADER),
        kept=dict.fromkeys(range(3), ((0, 4), (40, 44), (80, 84))),
        damages=[("bad-payload", 8, laid.of("HEAD").size), ("missing-head", 8, 0)],
    )  # fmt: skip


def chain() -> Case:
    """Two indexes, the second of which continues where the first one ends."""
    chunks: list[w.Chunk] = [HEAD, THREE, *w.clusters(0, 40), ("iNDX", b""), *w.clusters(80, 120)]
    begun = w.lay(*chunks, close=False)
    first, third, fourth = begun.of("iNDX"), begun.of("DATA", 2), begun.of("DATA", 3)
    rows = [("DATA", third.at, 80, 84), ("DATA", fourth.at, 120, 124)]
    rows = [("iNDX", first.at, 0, 0), *rows]
    index = f.index(rows, previous=first.at, first=first.sequence)
    laid = w.lay(*chunks, ("iNDX", index), close=False)
    second = laid.of("DATA", 1)
    return wrecked(
        "index-chain", "Two indexes in a chain tell of a cluster each that is lost.",
        ["IDX-002", "REC-003", "REC-012"], "transmission/bit-flip",
        w.flip(w.flip(laid.data, second.at + 30), fourth.at + 30),
        kept=dict.fromkeys(range(3), ((0, 4), (80, 84))),
        lost=[(track, start, start + 4) for track in range(3) for start in (40, 120)],
        damages=[
            ("garbage", second.at, second.size), ("missing-chunk", first.at, 0),
            ("garbage", fourth.at, fourth.size), ("missing-chunk", laid.of("iNDX", 1).at, 0),
            ("not-closed", len(laid.data), 0),
        ],
    )  # fmt: skip
