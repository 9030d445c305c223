"""What hapfmt makes of the cases in conformance/components, codec by codec."""

from __future__ import annotations

import hashlib
import struct
from array import array

import numpy as np
from singles import decode_counts, decode_exact

from hapfmt.codecs import predicted as lpcr
from hapfmt.codecs import transform as mdct
from hapfmt.codecs.entropy import Decoder, FlagModel, Lengths, ends_of
from hapfmt.codecs.events import parse_events
from hapfmt.codecs.exact import ExactParameters, ordered, unordered, values_of
from hapfmt.codecs.grids import LpcParameters, deadband_levels
from hapfmt.codecs.knots import (
    KnotParameters,
    decode_indices,
    decode_knots,
    interpolate,
    parse_knots,
)
from hapfmt.codecs.noise import NoiseParameters, decode_within, gain_of, sine_of, step_lattice
from hapfmt.codecs.noise import noise as noise_at
from hapfmt.codecs.predicted import SINES, step_up
from hapfmt.codecs.quantised import (
    Alphabet,
    QuanParameters,
    decode_levels,
    decode_quantised,
    parse_codebook,
)
from hapfmt.codecs.raw import RawParameters, decode_raw
from hapfmt.errors import FormatError
from hapfmt.format.track import Affine
from hapfmt.format.wire import crc32, parse_strings, seed_of
from hapfmt.limits import LEVELS
from hapfmt.numbers import build_svarint, build_varint, clamp, parse_svarint, parse_varint, rdiv

LEVEL = LEVELS[1]


def varint(case, parse=parse_varint, build=build_varint):
    value, stop = parse(bytes.fromhex(case["bytes"]), case["at"])
    assert build(value) == bytes.fromhex(case["bytes"])[case["at"] : stop]
    return {"value": value, "stop": stop}


def svarint(case):
    return varint(case, parse_svarint, build_svarint)


def division(case):
    n, d = int(case["n"]), int(case["d"])
    return {"floor": n // d, "rdiv": rdiv(n, d)}


def clamped(case):
    if "x" in case:
        return {"result": clamp(case["x"], case["low"], case["high"])}
    low, high = case["lf_range"]
    return {
        "sum": clamp(clamp(case["lf"], low, high) + clamp(case["hf"], *case["hf_range"]), low, high)
    }


def checksum(case):
    return {"crc": crc32(bytes.fromhex(case["bytes"]))}


def file_checksum(case):
    seed = seed_of(int(case["file_id"], 0))
    return {"crc": crc32(bytes.fromhex(case["bytes"]), seed)}


def strings(case):
    return {"texts": list(parse_strings(bytes.fromhex(case["bytes"]), case["components"], 0))}


def classes(case):
    if "class" in case:
        return {"ends": [list(ends_of(case["class"], c)) for c in range(36)]}
    rows = (ends_of(number, c) for number in range(16) for c in range(36))
    return {"sha256": hashlib.sha256(np.array([*rows], "<u2").tobytes()).hexdigest()}


def lengths(case):
    return {"ends": list(Lengths(0, bytes(case["weights"])).ends)}


def models(case):
    if "bits" in case:
        model, p = FlagModel(), []
        for bit in case["bits"]:
            model.learn(bit, case["limit"])
            p.append(model.p)
        return {"p": p}
    after, values = [], []
    for count in range(len(case["values"]) + 1):
        coder = Decoder(bytes.fromhex(case["coded"]), 0, 1)
        values = list(coder.by_bits(count, signs=case["signs"]))
        after.append([*coder.states, coder.front, coder.raw_bits])
    coder.finish()
    return {"values": values, "after": after}


def entropy_coder(case):
    coder, after, found = Decoder(bytes.fromhex(case["coded"]), 0, case["states"]), [], []
    for section in case["sections"]:
        found.append({**section, "values": section_of(coder, section)})
        after.append([*coder.states, coder.front, coder.raw_bits])
    coder.finish()
    return {"sections": found, "after": after}


def section_of(coder, section):
    kind, values = section["kind"], section["values"]
    if kind == "bits":
        return list(coder.bits(len(values), bytes(section["p"])))
    if kind == "signs":
        coder.section()
        return list(coder.signed(array("q", map(abs, values)), bytes(section["p"])))
    if kind == "lengths":
        coder.section()
        table = Lengths(section["first"], bytes(section["weights"]))
        return [coder.by_length(table) for _ in values]
    if kind.startswith("by bits"):
        return list(coder.by_bits(len(values), signs=kind == "by bits"))
    signs = kind == "class"
    return list(coder.integers(len(values), section["class"], section["start"], signs=signs))


def knot(case):
    parameters = KnotParameters(case["interpolation"], LpcParameters(case["step"]))
    data, count = bytes.fromhex(case["packet"]), case["components"]
    counts = decode_knots(data, parameters, case["span"], count, LEVEL, 0)
    ticks, rows = parse_knots(data, count, 0)
    return {"knots": knots(ticks, rows * case["step"]), "counts": counts.T.tolist()}


def knots(ticks, rows):
    return [[t, row] for t, row in zip(ticks.tolist(), rows.tolist(), strict=True)]


def coded_knots(case):
    ticks, rows = decode_indices(
        bytes.fromhex(case["packet"]), case["interpolation"], case["span"], case["components"],
        case["last"], 0,
    )  # fmt: skip
    out = {"knots": knots(ticks, rows)}
    if "counts" in case:
        out["counts"] = interpolate(ticks, rows, case["span"], case["interpolation"]).T.tolist()
    return out


def alphabet(case):
    return Alphabet(case["direct_levels"], case["run_classes"], case["escape_classes"])


def codebook(case):
    symbols = alphabet(case)
    lengths = parse_codebook(bytes.fromhex(case["codebook"]), symbols.size, 0)
    book = QuanParameters(1, symbols, lengths).book
    words = {
        str(s): f"{book.codes[s]:0{book.widths[s]}b}" if book.widths[s] else ""
        for s in np.flatnonzero(lengths).tolist()
    }
    return {"lengths": lengths.tolist(), "words": words}


def quan(case):
    symbols = alphabet(case)
    book = parse_codebook(bytes.fromhex(case["codebook"]), symbols.size, 0)
    parameters = QuanParameters(case["step"], symbols, book)
    data, total = bytes.fromhex(case["packet"]), case["total"]
    counts = decode_quantised(data, parameters, total, 1, LEVEL, 0)
    levels = decode_levels(data, parameters, total, 0)
    return {"levels": levels.tolist(), "counts": counts[:, 0].tolist()}


def rawb(case):
    signed, size = case["signed"], case["word_size"]
    kind = "counts" if signed else {2: "binary16", 8: "uint64"}[size]
    data = bytes.fromhex(case["packet"])
    numbers = decode_raw(data, RawParameters(size), kind, case["span"], case["components"], 0)
    if not signed:
        numbers = numbers.view(f"<u{size}")
    return {"numbers": [[large(n) for n in row] for row in numbers.T.tolist()]}


def large(n):
    return n if abs(n) <= 2**53 else str(n)


def evnt(case):
    data = bytes.fromhex(case["packet"])
    if "then" in case:
        byte, count = case["then"]
        data += count * bytes.fromhex(byte)
    found = parse_events(data, case["start"], case["span"], 0)
    if "then" in case:
        return {"count": len(found), "text_size": len(found[0].text)}
    return {"events": [list(event) for event in found]}


def sine(case):
    if "entries" in case:
        digest = hashlib.sha256(struct.pack("<128H", *SINES)).hexdigest()
        return {"entries": list(SINES), "sha256": digest}
    return {"pairs": [[k, SINES[k] if k >= 0 else -SINES[-k]] for k, _ in case["pairs"]]}


def predictor(case):
    c = step_up(case["k"])
    if c is None:
        raise FormatError("too large", requirement="LPC-005", offset=0)
    return {"c": c}


def grid(case):
    parameters = LpcParameters(case["step"], case["zero"], case.get("kn", 0), case.get("kd", 1))
    if "bound" in case:
        y, tops = deadband_levels(parameters, case["bound"])
        return {"levels": y.tolist(), "tops": [min(top, case["bound"]) for top in tops.tolist()]}
    bound = LEVEL.count_bound
    indices = np.array(case["indices"], np.int64)
    out = {
        "last": parameters.index_limit(bound),
        "counts": parameters.counts(indices, bound).tolist(),
    }
    if case["grid"]:
        y = deadband_levels(parameters, bound)[0]
        out["first_levels"] = y[:24].tolist()
        out["sha256"] = hashlib.sha256(y.astype("<i8").tobytes()).hexdigest()
    return out


def lpcr_packet(case):
    data, span = bytes.fromhex(case["packet"]), case["span"]
    rows = lpcr.decode_components(data, span, case["components"], case["last"], 0)
    return {"indices": [row.tolist() for row in rows]}


def noise(case):
    ticks = range(case["first"], case["first"] + len(case["n"]))
    return {"n": [noise_at(case["seed"], tick, case["density"]) for tick in ticks]}


def noise_gains(case):
    values = [gain_of(index) for index in range(len(case["values"]))]
    digest = hashlib.sha256(struct.pack(f"<{len(values)}q", *values)).hexdigest()
    return {"values": values, "sha256": digest}


def lattice(case):
    ks, g = [sine_of(k) for k in case["k"]], [0] * len(case["k"])
    counts, states = [], []
    for e in case["e"]:
        counts.append(rdiv(step_lattice(e, ks, g), 64))
        states.append(list(g))
    return {"counts": counts, "g": states[:4] + states[-1:]}


def nois(case):
    parameters = NoiseParameters(case["shift"], case["intervals"])
    data, widest = bytes.fromhex(case["packet"]), 2**31
    given = case["span"], case["components"], 0, -widest, widest - 1
    return {"counts": decode_within(data, parameters, *given).T.tolist()}


def hexed(doubles):
    return [f"{word:016x}" for word in np.ascontiguousarray(doubles, "<f8").view("<u8").tolist()]


def exact_values(case):
    counts, affine = np.array(case["counts"], np.int64), Affine(*case["calibration"])
    words = np.array([int(word, 16) for word in case.get("coefficients", ())], "<u8")
    given = affine, case["rule"], case["digits"], words.view("<f8").tolist()
    return {"values": hexed(values_of(counts, *given))}


def places(case):
    double = np.array([int(case["bits"], 16)], "<u8").view("<f8")
    if "place" in case:
        return {"place": str(ordered(double)[0])}
    with np.errstate(over="ignore"):
        return {"exact": hexed(unordered(ordered(double) + int(case["correction"])))[0]}


def lpcx(case):
    data, parameters = bytes.fromhex(case["packet"]), ExactParameters(case["rule"], case["digits"])
    counts = decode_counts(data, case["span"], LEVEL, 0)
    if "error" in case:
        assert counts.tolist() == case["counts"]
    exact = decode_exact(data, parameters, Affine(*case["calibration"]), counts, 0)
    return {"counts": counts.tolist(), "exact": hexed(exact)}


def cosine(case):
    table = mdct.cosines()
    if "entries" in case:
        quarter = table[:1025]
        digest = hashlib.sha256(quarter.astype("<u2").tobytes()).hexdigest()
        return {"entries": quarter.tolist(), "sha256": digest}
    return {"pairs": [[i, int(table[i % table.size])] for i, _ in case["pairs"]]}


def transform_of(case):
    data = bytes([case["m"]]) + build_varint(case["step"])
    weights = bytes(case["weights"])
    return mdct.TransformParameters.parse(data + bytes([len(weights)]) + weights, 0)


def transform_steps(case):
    return {"steps": transform_of(case).steps.tolist()}


def transform(case):
    rows = np.zeros((len(case["coefficients"]), 1 << case["m"]))
    for row, given in zip(rows, case["coefficients"], strict=True):
        row[: len(given)] = given
    return {"x": mdct.inverse(rows).tolist()}


def transformed(case):
    data, parameters = bytes.fromhex(case["packet"]), transform_of(case)
    span, count = case["span"], case["components"]
    rows = mdct.decode_within(data, parameters, span, count, LEVEL, 0, -(2**31), 2**31 - 1)
    out = {"counts": rows.T.tolist()}
    if "blocks" in case:
        header, at = mdct.parse_header(data, parameters.size, LEVEL, 0)
        blocks = np.zeros((-(-span // parameters.size), header.kept))
        steps = parameters.steps[: header.kept].tolist()
        mdct.decode_coefficients(data[at:], steps, header.classes, header.start, blocks, at)
        out["blocks"] = blocks.astype(np.int64).tolist()
    return out
