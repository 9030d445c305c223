"""conformance/components: made anew as committed, and hapfmt agrees with every case."""

from __future__ import annotations

import json
import struct
from fractions import Fraction
from pathlib import Path

import make_components
import numpy as np
import pytest
from component_programs import (
    checksum,
    clamped,
    classes,
    codebook,
    coded_knots,
    cosine,
    division,
    entropy_coder,
    evnt,
    exact_values,
    file_checksum,
    grid,
    knot,
    large,
    lattice,
    lengths,
    lpcr_packet,
    lpcx,
    nois,
    noise,
    noise_gains,
    places,
    predictor,
    quan,
    rawb,
    sine,
    strings,
    svarint,
    transform,
    transform_steps,
    transformed,
    varint,
)
from spec import REQUIREMENTS

from hapfmt import ClockMap
from hapfmt.deadband import Deadband
from hapfmt.errors import FormatError
from hapfmt.format.cluster import (
    Packet,
    parse_cluster,
    parse_rows,
    parse_table_head,
    salvage_cluster,
)
from hapfmt.format.extras import parse_clock, parse_map
from hapfmt.format.track import Track, round_up
from hapfmt.format.wire import cluster_seed
from hapfmt.limits import LEVELS
from hapfmt.reading.decoder import TrackDigest
from hapfmt.reading.packets import tick_range

ROOM = Path(make_components.ROOM)
LEVEL = LEVELS[1]
CLUSTER_SEED = cluster_seed(7, 2)


def test_as_made():
    assert make_components.differences(make_components.files()) == []


class AnyTrack(dict):
    def __missing__(self, id_):
        return Track(id_, "full", "KNOT", 1000, 0, (None,))

    def __contains__(self, id_):
        return True


def cluster(case):
    payload = bytes.fromhex(case["payload"])
    packets = parse_cluster(payload, AnyTrack(), LEVEL, 0, CLUSTER_SEED)
    rows = parse_rows(payload, parse_table_head(payload, LEVEL, 0))
    entries = [
        {"track": row.track, "size": row.size, "start": row.start, "span": row.span,
         "crc": row.crc, "offset": packet.offset}
        for row, packet in zip(rows, packets, strict=True)
    ]  # fmt: skip
    return {"entries": entries}


def salvage(case):
    size, following = case["payload_size"], case["next_header"]
    ends = [size]
    if following not in (None, size) and following - size <= 1 << 16:
        ends.append(following)
    payload = bytes.fromhex(case["bytes"])[: max(ends)]
    tracks = {id_: AnyTrack()[id_] for id_ in range(8)}
    found = salvage_cluster(payload, tracks, LEVEL, 0, CLUSTER_SEED, ends)
    rows = [
        [item.offset, item.track, len(item.data), item.start, item.span]
        for item in found
        if isinstance(item, Packet)
    ]
    return {"kept": rows}


def clock_chunk(case):
    payload = bytes.fromhex(case["payload"])
    if case["chunk"] == "cMAp":
        found = parse_map(payload, 0)
        rows = [[large(n) for n in point] for point in found.points]
        return {"clock": found.clock, "points": rows}
    seen = parse_clock(payload, 0)
    rows = [[large(n) for n in row] for row in seen.rows]
    return {"clock": seen.clock, "observations": rows}


def clock_map(case):
    points = tuple((int(tick), int(time)) for tick, time in case["points"])
    clock = ClockMap("pc", None, points)
    there = [[k, large(clock.time_ns(int(k)))] for k, _ in case["times_of_ticks"]]
    back = [[t, large(clock.tick(int(t)))] for t, _ in case["ticks_of_times"]]
    return {"times_of_ticks": there, "ticks_of_times": back}


def times(case):
    rate = Fraction(*case["rate"])
    if "tick" in case:
        seconds = case["tick"] / rate
        return {"seconds": [seconds.numerator, seconds.denominator]}
    start, stop = tick_range(rate, Fraction(case["from"]), Fraction(case["to"]))
    assert start == max(case["start"], 0)
    return {"stop": stop}


def contract(case):
    given = {key: tuple(case[key]) for key in ("floor", "zero")}
    x, y = (np.array([[int(n) for n in row] for row in case[key]], np.int64) for key in "xy")
    parts = [(given["floor"], given["zero"], x, y)]
    if not case["vector"]:
        rows = zip(given["floor"], given["zero"], x, y, strict=True)
        parts = [((f,), (z,), a[None], b[None]) for f, z, a, b in rows]
    outside = []
    for (floor, zero, a, b), worst in zip(parts, case["worst_squared"], strict=True):
        band = Deadband(case["kn"], case["kd"], floor, zero, vector=case["vector"])
        outside.append(np.flatnonzero(band.outside(a.T, b.T)).tolist())
        ratio, exact = band.worst_ratio(a.T, b.T), Fraction(int(worst[0]), int(worst[1]))
        # Lengths of vectors are irrational: hapfmt rounds their ratio up to a multiple of 2^-20.
        below = max(ratio - Fraction(case["vector"], 1 << 20), 0)
        assert below**2 <= exact <= ratio**2
    return {"outside": outside}


def deviation(case):
    (x,) = struct.unpack(">d", bytes.fromhex(case["distance"]))
    return {"stored": struct.pack("<f", round_up(x)).hex()}


SIZES = {"counts": "<i4", "binary16": "<u2", "binary32": "<u4"}


def digest(case):
    found = TrackDigest()
    for packet in case["packets"]:
        rows = [[int(number) for number in row] for row in packet["rows"]]
        found.update(packet["start"], np.array(rows, SIZES.get(case["number_format"], "<u8")))
    spans = [[span.start, span.stop] for span in found.spans]
    return {"spans": spans, "of_numbers": found.numbers.hexdigest(), "digest": found.digest().hex()}


PROGRAMS = {
    "varint": varint, "svarint": svarint, "division": division, "clamp": clamped,
    "crc32": checksum, "file-crc": file_checksum,
    "strings": strings, "classes": classes, "lengths": lengths,
    "entropy-coder": entropy_coder, "knot": knot, "coded-knots": coded_knots,
    "codebook": codebook, "quan": quan, "rawb": rawb, "evnt": evnt, "sine": sine, "predictor": predictor, "grid": grid,
    "noise": noise, "noise-gains": noise_gains, "lattice": lattice, "nois": nois,
    "lpcr": lpcr_packet, "exact-values": exact_values, "places": places, "lpcx": lpcx,
    "cosine": cosine, "mdct-steps": transform_steps, "transform": transform, "mdct": transformed,
    "cluster": cluster, "clock-chunks": clock_chunk, "clock-maps": clock_map, "times": times,
    "digest": digest, "salvage": salvage, "contract": contract, "deviation": deviation,
}  # fmt: skip
FILES = sorted(ROOM.glob("*.json"))


def test_every_file_has_a_program():
    assert {path.stem for path in FILES} == PROGRAMS.keys()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_cases(path):
    component = json.loads(path.read_text(encoding="utf-8"))
    assert component["component"] == path.stem and component["cases"]
    assert set(component["requirements"]) <= REQUIREMENTS.keys()
    wrong = {}
    for case in component["cases"]:
        try:
            found = PROGRAMS[path.stem](case)
        except FormatError as error:
            found = {"error": error.requirement}
        wanted = case.get("error", [])
        if "error" in found or wanted:
            good = found.get("error") in ([wanted] if isinstance(wanted, str) else wanted)
        else:
            good = found.keys() <= case.keys() and all(case[key] == found[key] for key in found)
        if not good:
            wrong[case["name"]] = found
    assert wrong == {}
