"""What the SPEC allows, and no more; awkward literals stand beside each generator."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import strategies as st

from hapfmt.clocks import ClockMap, ClockObservation
from hapfmt.codecs.events import CodedEvent
from hapfmt.codecs.exact import ExactParameters, encode_exact
from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.knots import KnotParameters, build_knots, encode_knots
from hapfmt.codecs.noise import NoiseParameters
from hapfmt.codecs.noise import decode_within as decode_noise
from hapfmt.codecs.noise import encode_component as encode_noise
from hapfmt.codecs.predicted import (
    DIFFERENCE_LIMIT,
    INDEX_LIMIT,
    Predictor,
    Reference,
    encode_component,
    encode_indices,
    join_components,
)
from hapfmt.codecs.quantised import Alphabet, QuanParameters, code_lengths, encode_quantised
from hapfmt.codecs.raw import DTYPES, RawParameters, encode_raw
from hapfmt.codecs.transform import BLOCKS, TransformParameters, decode_within
from hapfmt.encoder.settings import Settings, Tolerance
from hapfmt.encoder.transform import encode_row
from hapfmt.format.cluster import Packet
from hapfmt.format.track import WORD_SIZES, Affine, Component, Contract, Track
from hapfmt.format.wire import ChunkHeader, Head
from hapfmt.limits import LEVELS
from hapfmt.numbers import build_varint
from hapfmt.recording import Calibration, Channel, Deviation, Event, Recording, Span

u16s = st.sampled_from([0, 1, 255, 256, 65535]) | st.integers(0, 65535)
u32s = st.sampled_from([0, 1, 2**31, 2**32 - 1]) | st.integers(0, 2**32 - 1)
u64s = st.sampled_from([0, 7, 2**32, 2**64 - 1]) | st.integers(0, 2**64 - 1)
i64s = st.sampled_from([0, -1, 2**63 - 1, -(2**63)]) | st.integers(-(2**63), 2**63 - 1)
varints = st.sampled_from(
    [0, 1, 127, 128, 300, 16383, 16384, 2**32, 2**49 - 1, 2**49, 2**53 - 1]
) | st.integers(0, 2**53 - 1)
svarints = st.sampled_from([0, 1, -1, 63, -64, 64, 2**52 - 1, -(2**52)]) | st.integers(
    -(2**52), 2**52 - 1
)
levels = st.sampled_from(list(LEVELS.values()))
rates = st.sampled_from(
    [Fraction(1000), Fraction(44100), Fraction(1), Fraction(1, 3600), Fraction(30000, 1001)]
) | st.builds(Fraction, st.integers(1, 2**32 - 1), st.integers(1, 2**32 - 1))
texts = st.sampled_from(
    ["", "x", "force_z", "Kraft µN", "😀", "a" * 254, "\x1b[2J", "\n"]
) | st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
jsons = st.recursive(
    st.none() | st.booleans() | i64s | st.floats(allow_nan=False, allow_infinity=False) | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)
metadata = st.dictionaries(texts, jsons, max_size=3)
chunk_types = st.sampled_from(["HEAD", "TRAK", "DATA", "iNDX", "fOOT", "mETa"]) | st.text(
    "abyzABYZ", min_size=4, max_size=4
)
chunk_headers = st.builds(ChunkHeader, chunk_types, u64s, u32s, st.integers(0, 2**24), u32s)
uuids = st.none() | st.binary(min_size=16, max_size=16)


@st.composite
def heads(draw):
    known = draw(st.booleans())
    return Head(
        draw(st.sampled_from([1, 2])),
        draw(uuids),
        draw(i64s) if known else None,
        draw(st.integers(0, 2**63 - 1)) if known else 0,
        draw(texts),
        minor=draw(st.integers(0, 255)),
    )


@st.composite
def ranges(draw, bits):
    """Declared ranges that fit so many signed bits."""
    bound = 1 << (bits - 1)
    ends = st.sampled_from([0, -1, -bound, bound - 1, 255, -256]) | st.integers(-bound, bound - 1)
    return tuple(sorted((draw(ends), draw(ends))))


@st.composite
def affines(draw, count_range=(-(2**31), 2**31 - 1)):
    """Calibrations that keep VAL-001 over a range of counts."""
    largest = max(map(abs, count_range))
    a = draw(st.sampled_from([1, -1, 3, 2**21]) | st.integers(1, 2**21))
    a = min(a, (1 << 53) // max(largest, 1))
    room = min((1 << 53) - abs(a) * largest, (1 << 52) - 1)
    b = draw(st.sampled_from([0, 1, room, -room]) | st.integers(-room, room))
    d = draw(st.sampled_from([1, 3, 1000, (1 << 53) - 1]) | st.integers(1, (1 << 53) - 1))
    return Affine(a, b, d)


@st.composite
def deviations(draw):
    """As a file holds them: two binary32."""
    sizes = st.floats(0, exclude_min=True, allow_infinity=False, width=32)
    declared = draw(st.sampled_from([2.0**-149, 2.0**128 - 2.0**104]) | sizes)
    return declared, draw(st.sampled_from([0.0, declared]) | st.floats(0, declared, width=32))


@st.composite
def components(draw, count_range):
    return Component(
        draw(affines(count_range)),
        *draw(st.tuples(texts, texts, texts, texts, texts, texts, texts)),
        deviation=draw(st.none() | deviations()),
    )


@st.composite
def contracts(draw, size):
    counts = st.integers(-(2**31), 2**31 - 1)
    floors = st.sampled_from([1, 2**32 - 1]) | st.integers(1, 2**32 - 1)
    return Contract(
        draw(u16s),
        draw(st.integers(1, 65535)),
        draw(st.booleans()),
        draw(st.booleans()),
        tuple(draw(st.lists(floors, min_size=size, max_size=size))),
        tuple(draw(st.lists(counts, min_size=size, max_size=size))),
    )


@st.composite
def described(draw, level=LEVELS[2]):
    """Tracks that one TRAK chunk describes, alike or each on its own; the codec parameters are
    those of the codec."""
    first, alike = draw(st.integers(0, 60000)), draw(st.booleans())
    tracks = []
    for i in range(draw(st.sampled_from([1, 2, 5]))):
        if not tracks or not alike:
            track = draw(one_track(level))
        numbers = {"id": first + i, "first_channel": draw(st.integers(0, 60000))}
        more = len(track.components) - 1
        others = st.lists(st.integers(60001, 65534), min_size=more, max_size=more, unique=True)
        given = track.kind == "full" and draw(st.booleans())
        tracks.append(replace(track, further=tuple(draw(others)) if given else (), **numbers))
    return tracks


@st.composite
def one_track(draw, level=LEVELS[2]):
    size = draw(st.sampled_from([1, 2, 3]))
    kind = draw(st.sampled_from(["full", "lf", "hf"]))
    words = kind == "full" and draw(st.booleans())
    bits = level.residual_bits if kind == "hf" else level.count_bits
    number_format = draw(st.sampled_from(sorted(WORD_SIZES))) if words else "counts"
    codec, parameters = "RAWB", RawParameters(WORD_SIZES.get(number_format, 1))
    if not words:
        codec, parameters = draw(codec_parameters(level))
    low, high = (0, 0) if words else draw(ranges(bits))
    known = [draw(components((low, high))) for _ in range(size)]
    if kind == "hf":
        known = [Component()] * size
    if words:
        known = [Component(label=each.label, unit=each.unit) for each in known]
    linked = draw(st.integers(0, 65533))
    return Track(
        id=0,
        kind=kind,
        codec=codec,
        rate=draw(rates),
        first_channel=0,
        components=tuple(known),
        parameters=parameters.build(),
        number_format=number_format,
        count_min=low,
        count_max=high,
        base=linked if kind == "hf" else None,
        continues=None if kind == "hf" else draw(st.sampled_from([None, linked])),
        contract=None if words else draw(st.none() | contracts(size)),
        provenance=draw(texts),
        unknown=tuple(sorted(draw(st.dictionaries(st.sampled_from([20, 24, 0x8000]),
                                                  st.binary(max_size=9))).items())),
    )  # fmt: skip


transforms = st.builds(
    TransformParameters,
    st.sampled_from(BLOCKS),
    st.sampled_from([1, 256, 2**32]) | st.integers(1, 2**32),
    st.sampled_from([0, 1, 32]).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
)


@st.composite
def codec_parameters(draw, level=LEVELS[2]):
    """(codec, parameters) of a track of counts."""
    codec = draw(st.sampled_from(["KNOT", "QUAN", "RAWB", "LPCR", "coded knots", "LPCX", "MDCT"]))
    if codec == "MDCT":
        return codec, draw(transforms)
    if codec == "LPCX":
        return codec, ExactParameters(draw(st.integers(0, 1)))
    if codec == "KNOT":
        return codec, draw(knot_parameters(level))
    if codec == "LPCR":
        return codec, draw(lpc_parameters(level))
    if codec == "coded knots":
        return "KNOT", draw(coded_knots(level))
    if codec == "QUAN":
        return codec, draw(quan_parameters(level))
    return codec, RawParameters(draw(st.sampled_from([1, 2, 3, 4])))


@st.composite
def knot_parameters(draw, level=LEVELS[2]):
    return KnotParameters(draw(st.sampled_from(["hold", "linear"])), draw(lpc_parameters(level)))


@st.composite
def knots(draw, parameters, level=LEVELS[2]):
    """(ticks [knots], indices [knots, components], span) of one packet."""
    width = draw(st.sampled_from([1, 1, 2, 3]))
    span = draw(st.sampled_from([1, 2, 3, 17, 1000]) | st.integers(1, 300))
    inner = sorted(draw(st.sets(st.integers(1, max(span - 1, 1)), max_size=12)))
    if parameters.interpolation == "hold":
        ticks = [0] + [tick for tick in inner if tick < span]
    else:
        ticks = [0] + [tick for tick in inner if tick < span - 1]
        ticks += [span - 1] if span > 1 and (len(ticks) > 1 or draw(st.booleans())) else []
    bound = parameters.grid.index_limit(level.count_bound)
    values = st.sampled_from([0, min(1, bound), bound, -bound]) | st.integers(-bound, bound)
    rows = [[draw(values) for _ in range(width)] for _ in ticks]
    return np.array(ticks, np.int64), np.array(rows, np.int64), span


@st.composite
def lpc_parameters(draw, level=LEVELS[2]):
    """Uniform grids, and those of any deadband but the finest, whose levels take long to list."""
    steps = st.sampled_from([1, 2, 20, level.step]) | st.integers(1, level.step)
    zero = draw(st.sampled_from([0, 1, -(2**31), 2**31 - 1]) | st.integers(-1000, 1000))
    if draw(st.booleans()):
        return LpcParameters(draw(steps), zero)
    kn, kd = draw(
        st.sampled_from([(1, 10), (1, 1), (65535, 65534), (65534, 65535), (1, 99), (300, 301)])
    )
    return LpcParameters(draw(st.just(0) | steps), zero, kn, kd)


@st.composite
def coded_knots(draw, level=LEVELS[2]):
    grid = draw(lpc_parameters(level))
    return KnotParameters(draw(st.sampled_from(["hold", "linear"])), grid, coded=True)


@st.composite
def knot_rows(draw, index_limit=INDEX_LIMIT, interpolation=None):
    """(interpolation, ticks [knots], indices [knots, components], span) of one packet of coded knots."""
    interpolation = interpolation or draw(st.sampled_from(["hold", "linear"]))
    ticks, _, span = draw(knots(KnotParameters(interpolation)))
    width = draw(st.sampled_from([1, 1, 2, 3]))
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    reach = min(draw(st.sampled_from([0, 1, 5, 300, 2**32])), index_limit)
    indices = generator.integers(-reach, reach + 1, (ticks.size, width))
    if draw(st.booleans()):
        indices = np.cumsum(indices, axis=0).clip(-index_limit, index_limit)
    return interpolation, ticks, indices, span


@st.composite
def quiet_rows(draw):
    """Indices that mostly repeat, with a few changes of 300 at most."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    size, step = draw(st.integers(2, 300)), draw(st.sampled_from([1, 2, 9, 300]))
    moves = generator.integers(-step, step + 1, size)
    moves *= generator.random(size) < draw(st.sampled_from([0.01, 0.1, 0.4]))
    return np.cumsum(moves).tolist()


@st.composite
def predictors(draw, index_limit=INDEX_LIMIT):
    """Of any order, stable or not; LPC-005 is kept."""
    base = draw(st.sampled_from([0, 1, index_limit, -index_limit]) | st.integers(-99, 99))
    base = max(-index_limit, min(index_limit, base))
    width = draw(st.sampled_from([3, 40, 100, 127]))
    ks = st.lists(st.integers(-width, width) | st.just(0), max_size=32)
    reflections = tuple(draw(st.just([]) | ks))
    difference = draw(st.integers(0, 1 if reflections else DIFFERENCE_LIMIT))
    repeats = draw(st.booleans())
    predictor = Predictor(difference, reflections, base, repeats)
    if predictor.coefficients is None:
        predictor = Predictor(difference, reflections[:2], base, repeats)
    return predictor


@st.composite
def references(draw, place):
    """Of the component at ``place``; none for the first."""
    earlier = draw(st.sets(st.integers(0, place - 1), max_size=8)) if place else ()
    weights = st.sampled_from([0, 64, -64, 127, -128]) | st.integers(-128, 127)
    return tuple(
        Reference(a, (draw(weights), draw(weights), draw(weights))) for a in sorted(earlier)
    )


@st.composite
def component_rows(draw, index_limit=INDEX_LIMIT, count=None):
    """(indices, predictor with its references) of each component of a packet."""
    count = count or draw(st.sampled_from([2, 2, 3, 10]))
    first = draw(index_arrays(index_limit))
    rows, seed = [first], draw(st.integers(0, 2**32))
    for place in range(1, count):
        kind = draw(st.sampled_from(["like it", "shifted", "constant", "noise"]))
        noise = np.random.default_rng(seed + place).integers(-3, 4, first.size)
        row = {
            "like it": first * draw(st.sampled_from([1, -1, 2])) + noise,
            "shifted": np.roll(first, draw(st.sampled_from([1, -1]))),
            "constant": np.full(first.size, int(first[0])),
            "noise": noise,
        }[kind]
        rows.append(row.clip(-index_limit, index_limit))
    chosen = [draw(predictors(index_limit)) for _ in rows]
    return [
        (row, replace(p, references=draw(references(place))))
        for place, (row, p) in enumerate(zip(rows, chosen, strict=True))
    ]


@st.composite
def index_arrays(draw, index_limit=INDEX_LIMIT):
    """Silence, noise, walks, steps and extremes; runs of the same."""
    size = draw(st.sampled_from([1, 2, 3, 70, 200]) | st.integers(1, 60))
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    width = min(draw(st.sampled_from([1, 2, 50, 2**15, 2**32])), index_limit)
    kind = draw(st.sampled_from(["noise", "walk", "ends", "sparse", "listed"]))
    if kind == "walk":
        x = np.cumsum(generator.integers(-width, width + 1, size))
    elif kind == "ends":
        x = np.array([width, -width, 0])[generator.integers(0, 3, size)]
    elif kind == "sparse":
        x = generator.integers(-width, width + 1, size) * (generator.random(size) < 0.1)
    elif kind == "listed":
        x = np.array(draw(st.lists(st.integers(-width, width), min_size=1, max_size=9)))
    else:
        x = generator.integers(-width, width + 1, size)
    if draw(st.booleans()):
        x = np.repeat(x, draw(st.sampled_from([1, 2, 5])))
    return x.clip(-index_limit, index_limit).astype(np.int64)


alphabets = st.sampled_from(
    [Alphabet(0, 0, 1), Alphabet(1, 1, 0), Alphabet(7, 4, 6), Alphabet(0, 24, 32)]
) | st.builds(Alphabet, st.integers(0, 12), st.integers(0, 8), st.integers(1, 20))


@st.composite
def quan_parameters(draw, level=LEVELS[2]):
    """Any complete codebook over any alphabet; a fifth of them have one code word only."""
    alphabet = draw(alphabets)
    size = alphabet.size
    weights = draw(st.lists(st.integers(0, 1 << 20), min_size=size, max_size=size))
    if draw(st.integers(0, 4)) == 0 or not any(weights):
        weights = [0] * size
        weights[draw(st.integers(0, size - 1))] = 1
    step = draw(st.sampled_from([1, 2, level.step]) | st.integers(1, 1000))
    return QuanParameters(step, alphabet, code_lengths(np.array(weights, np.int64)))


@st.composite
def level_arrays(draw, alphabet):
    """Levels [ticks, components] that the alphabet has symbols for."""
    ticks = draw(st.sampled_from([1, 2, 64, 300]) | st.integers(1, 80))
    width = draw(st.sampled_from([1, 1, 2, 3]))
    largest = alphabet.direct_levels + (1 << alphabet.escape_classes) - 1
    values = st.just(0) | st.integers(-largest, largest) | st.sampled_from([largest, -largest])
    rows = draw(st.lists(values, max_size=ticks * width))
    out = np.zeros(ticks * width, np.int64)
    out[: len(rows)] = rows
    if draw(st.booleans()):
        out = np.roll(out, draw(st.integers(0, out.size)))
    return out.reshape(ticks, width)


@st.composite
def books_for(draw, alphabet, array, step=1):
    """Parameters whose codebook has a word for each symbol of ``array``."""
    symbols, _ = alphabet.tokenise(array.T.reshape(-1))
    frequencies = np.bincount(symbols, minlength=alphabet.size)
    if draw(st.booleans()):
        frequencies = frequencies + draw(st.integers(0, 3))
    return QuanParameters(step, alphabet, code_lengths(frequencies))


FLOATS = [0.0, -0.0, np.inf, -np.inf, np.nan, 5e-324, 1.0, 65504.0]


@st.composite
def raw_arrays(draw):
    """(number format, word size, array [ticks, components]); every bit pattern may occur."""
    kind = draw(st.sampled_from(["counts", *DTYPES]))
    size = draw(st.sampled_from([1, 2, 3, 4])) if kind == "counts" else WORD_SIZES[kind]
    ticks = draw(st.sampled_from([1, 2, 200]) | st.integers(1, 40))
    width = draw(st.sampled_from([1, 2, 3]))
    if kind == "counts":
        bound = 1 << (8 * size - 1)
        values = st.sampled_from([0, -1, bound - 1, -bound]) | st.integers(-bound, bound - 1)
        dtype = np.dtype(np.int64)
    else:
        dtype = DTYPES[kind]
        values = st.integers(0, (1 << (8 * size)) - 1)
    used = draw(st.lists(values, min_size=1, max_size=ticks * width))
    flat = [used[i % len(used)] for i in range(ticks * width)]
    array = np.array(flat, np.int64 if kind == "counts" else f"<u{size}").view(dtype)
    if dtype.kind == "f" and draw(st.booleans()):
        with np.errstate(over="ignore", under="ignore"):
            array[0] = draw(st.sampled_from(FLOATS))
    return kind, size, array.reshape(ticks, width)


def component_packet(rows):
    """A packet of (indices, predictor); without references where an error is too large for them."""
    made, earlier = [], []
    for indices, predictor in rows:
        try:
            made.append(encode_component(indices, predictor, earlier))
        except ValueError:
            made.append(encode_component(indices, Predictor(), earlier))
        earlier.append(indices)
    return join_components(made)


@st.composite
def noise_parameters(draw):
    shift = draw(st.sampled_from([3, 3, 4, 6, 12]))
    return NoiseParameters(shift, draw(st.integers(max(1, 64 >> shift), 255 if shift > 3 else 9)))


@st.composite
def noise_models(draw, parameters):
    """(arguments of encode_component, span): gains with silence between them, any filter."""
    span = draw(st.sampled_from([1, 8, 64, 65]) | st.integers(1, 400))
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    most = draw(st.sampled_from([40, 70, 112]))
    gains = generator.integers(0, most + 1, parameters.interval_count(span))
    gains[generator.random(gains.size) < draw(st.sampled_from([0, 0.3, 0.9]))] = 0
    width = draw(st.sampled_from([3, 60, 127]))
    order = draw(st.sampled_from([0, 1, 2, 5, 17, 32]))
    blocks = generator.integers(-width, width + 1, (parameters.block_count(span), order))
    given = {"seed": draw(u32s), "density": draw(st.sampled_from([0, 0, 1, 100, 255]))}
    return (gains.tolist(), blocks.tolist(), parameters), given, span


@st.composite
def packets(draw, track_id=0):
    """(track, packets in order of time, the counts or words of each) at level 1."""
    level = LEVELS[1]
    names = ["KNOT", "QUAN", "RAWB", "LPCR", "coded knots", "LPCX", "MDCT", "NOIS"]
    kind = draw(st.sampled_from(names))
    start, made, numbers = draw(st.sampled_from([0, 0, 7, 2**40])), [], []
    if kind == "RAWB":
        number_format, size, array = draw(raw_arrays())
        if number_format == "counts":
            array = array.clip(-(1 << 23), (1 << 23) - 1)
        parameters, data = RawParameters(size), encode_raw(array, size)
        arrays = [(data, len(array), array)]
    elif kind == "KNOT":
        number_format, parameters = "counts", draw(knot_parameters(level))
        ticks, values, span = draw(knots(parameters, level))
        counts = parameters.grid.counts(values, level.count_bound)
        arrays = [(build_knots(ticks, values), span, counts)]
    elif kind == "coded knots":
        number_format, parameters = "counts", draw(coded_knots(level))
        limit = parameters.grid.index_limit(level.count_bound)
        _, ticks, rows, span = draw(knot_rows(limit, parameters.interpolation))
        data = encode_knots(ticks, rows, parameters.interpolation)
        arrays = [(data, span, parameters.grid.counts(rows, level.count_bound))]
    elif kind == "LPCR":
        number_format, parameters = "counts", draw(lpc_parameters(level))
        limit = parameters.index_limit(level.count_bound)
        rows = draw(component_rows(limit, draw(st.sampled_from([1, 1, 2]))))
        columns = [parameters.counts(row, level.count_bound) for row, _ in rows]
        arrays = [(component_packet(rows), len(columns[0]), np.stack(columns, axis=1))]
    elif kind == "LPCX":
        number_format, parameters = "counts", ExactParameters(draw(st.integers(0, 1)))
        counts = draw(index_arrays((1 << 23) - 1))
        x = counts + np.random.default_rng(counts.size).normal(size=counts.size) / 4
        coded = encode_indices(counts, Predictor())
        beside = encode_exact(x, parameters, Affine(), counts, recall=True)
        arrays = [(build_varint(len(coded)) + coded + beside, len(counts), counts[:, None])]
    elif kind == "MDCT":
        number_format, parameters, count = "counts", draw(transforms), draw(st.integers(1, 2))
        span = draw(st.integers(1, 200))
        x = np.random.default_rng(span).integers(-(2**12), 2**12, (span, count))
        parts = [encode_row(column, parameters) for column in x.T.astype(np.float64)]
        data = join_components(parts)
        widest = -(1 << 23), (1 << 23) - 1
        arrays = [(data, span, decode_within(data, parameters, span, count, level, 0, *widest))]
    elif kind == "NOIS":
        number_format, parameters = "counts", draw(noise_parameters())
        arguments, given, span = draw(noise_models(parameters))
        data, most = encode_noise(*arguments, **given), 1 << 23
        arrays = [(data, span, decode_noise(data, parameters, span, 1, 0, -most, most - 1))]
    else:
        number_format, alphabet = "counts", Alphabet(3, 3, 8)
        array = draw(level_arrays(alphabet))
        parameters = draw(books_for(alphabet, array))
        arrays = [(encode_quantised(array, parameters), len(array), array)]
    for _ in range(draw(st.integers(1, 2))):
        data, span, array = arrays[0]
        made.append(Packet(track_id, start, span, data))
        numbers.append(array)
        start += span + draw(st.sampled_from([0, 0, 1, 1000]))
    counts = number_format == "counts"
    track = Track(
        id=track_id,
        kind="full",
        codec="KNOT" if kind == "coded knots" else kind,
        rate=Fraction(1000),
        first_channel=0,
        components=(Component(),) * numbers[0].shape[1],
        parameters=parameters.build(),
        number_format=number_format,
        count_min=-(1 << 23) if counts else 0,
        count_max=(1 << 23) - 1 if counts else 0,
    )
    return track, made, numbers


@st.composite
def coverages(draw, ticks):
    """Sorted spans, never adjacent, that hold so many ticks together."""
    at = draw(st.sampled_from([0, 0, 1, 1000, 2**40]))
    spans, left = [], ticks
    while left:
        size = draw(st.sampled_from([left, 1]) | st.integers(1, left))
        spans.append(Span(at, at + size))
        left -= size
        at += size + draw(st.sampled_from([1, 2, 5000]))
    return tuple(spans)


@st.composite
def value_arrays(draw, ticks):
    """(values [ticks], whether they are counts): noise, a slope, a constant, doubles of any kind."""
    shape = draw(st.sampled_from(["noise", "slope", "constant", "extreme", "doubles", "words"]))
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    if shape == "doubles":
        x = generator.normal(size=ticks)
        x[: min(ticks, 4)] = draw(st.permutations(FLOATS))[: min(ticks, 4)]
        return x[~np.isnan(x)] if np.isnan(x).any() else x, False
    if shape == "words":
        dtype = draw(st.sampled_from([np.int64, np.uint64, np.float16, np.float32]))
        x = generator.integers(0, 100, ticks).astype(dtype)
        return x, False
    if shape == "constant":
        return np.full(ticks, draw(st.sampled_from([0, -5, 2**23 - 1])), np.int32), True
    if shape == "slope":
        return (np.arange(ticks) * 7 - 100).astype(np.int32), True
    if shape == "extreme":
        ends = [-(2**31), 2**31 - 1, 0]
        return np.array([ends[i % 3] for i in range(ticks)], np.int64), True
    return generator.integers(-(2**15), 2**15, ticks).astype(np.int32), True


@st.composite
def channels(draw, group=""):
    ticks = draw(st.sampled_from([0, 1, 2, 50, 300]))
    values, counts = draw(value_arrays(ticks))
    calibration = Calibration(*draw(affines())) if counts else None
    deviation = Deviation(*draw(deviations())) if counts and draw(st.booleans()) else None
    return Channel(
        stored=values,
        rate=draw(st.sampled_from([Fraction(1000), Fraction(50), Fraction(44100, 7)])),
        coverage=draw(coverages(values.size)),
        calibration=calibration,
        label=draw(texts),
        unit=draw(st.sampled_from(["N", "1", "m/s2", "{raw(0-255)}"])),
        quantity=draw(st.sampled_from(["", "force"])),
        group=group,
        body_site=draw(texts),
        device=draw(texts),
        deviation=deviation,
    )


@st.composite
def vectors(draw):
    """Three channels that are the axes of one vector: one rate, one coverage, one unit."""
    ticks = draw(st.sampled_from([1, 50]))
    coverage = draw(coverages(ticks))
    seed = np.random.default_rng(draw(st.integers(0, 2**32)))
    return [
        Channel(
            stored=seed.integers(-1000, 1000, ticks).astype(np.int32),
            rate=Fraction(1000),
            coverage=coverage,
            calibration=Calibration(1, 0, 1000),
            label=f"f{axis}",
            unit="N",
            axis=axis,
            group="f",
        )
        for axis in "xyz"
    ]


@st.composite
def recordings(draw):
    """Of no channel, one, or a few; each with a rate, gaps and numbers of its own."""
    made = draw(st.lists(channels(), max_size=3))
    if draw(st.booleans()):
        made += draw(vectors())
    known = draw(st.booleans())
    attachments = st.dictionaries(
        st.sampled_from(["a.txt", "../b", "c"]),
        st.tuples(st.sampled_from(["", "text/plain"]), st.binary(max_size=20)),
        max_size=2,
    )
    return Recording(
        tuple(made),
        uuid=draw(st.none() | st.uuids()),
        epoch_ns=draw(i64s) if known else None,
        epoch_uncertainty_ns=draw(st.integers(0, 2**63 - 1)) if known else 0,
        metadata=draw(metadata),
        attachments=draw(attachments),
        events=draw(st.just(()) | events(len(made))),
    )


clock_names = texts.filter(bool)
ticks = st.sampled_from([0, 1, -1, 2**52 - 1, 1 - 2**52]) | st.integers(1 - 2**52, 2**52 - 1)
observations = st.builds(
    ClockObservation, st.just("pc"), st.none(), ticks, i64s, st.integers(0, 2**53 - 1)
)


@st.composite
def clock_maps(draw):
    size = draw(st.sampled_from([2, 3, 9]))
    steps = st.sampled_from([1, 2, 1000]) | st.integers(1, 10**12)
    tick, time = draw(st.integers(-(2**51), 2**40)), draw(st.integers(-(2**62), 2**62))
    points = [(tick, time)]
    for _ in range(size - 1):
        points.append((points[-1][0] + draw(steps), points[-1][1] + draw(steps)))
    return ClockMap(draw(clock_names), None, tuple(points))


@st.composite
def clocked(draw, recording):
    """The recording with observations and maps of a few clocks."""
    places = st.sampled_from([None, *range(len(recording))])
    names = st.sampled_from(["pc", "\N{OHM SIGN}" * 85])
    seen = st.builds(ClockObservation, names, places, ticks, i64s, st.integers(0, 2**53 - 1))
    maps = st.builds(replace, clock_maps(), clock=names, channel=places)
    return replace(
        recording,
        clocks=draw(st.lists(seen, max_size=8)),
        clock_maps=draw(st.lists(maps, max_size=3, unique_by=lambda m: (m.clock, m.channel))),
    )


event_texts = texts | st.sampled_from(["x" * 65535, "\N{OHM SIGN}" * 20000])
seconds = st.sampled_from(
    [Fraction(0), Fraction(1, 3), Fraction(17), Fraction(10**6), Fraction(1, 7919)]
) | st.builds(Fraction, st.integers(0, 10**7), st.sampled_from([1, 1000, 10**6]))


@st.composite
def events(draw, channel_count=0):
    """Of few layers; some at one time, some far from each other."""
    places = st.none() | (st.integers(0, channel_count - 1) if channel_count else st.none())
    one = st.builds(Event, seconds, event_texts, seconds, places, st.sampled_from(["", "a", "b"]))
    return tuple(draw(st.lists(one, max_size=6)))


@st.composite
def coded_events(draw):
    """(start, span, events of one packet)"""
    start = draw(st.sampled_from([0, 5, 2**48 - 2**24]) | st.integers(0, 2**40))
    span = draw(st.sampled_from([1, 2, 2**24]) | st.integers(1, 300))
    ticks = st.sampled_from([0, span - 1]) | st.integers(0, span - 1)
    made = []
    for tick in sorted(draw(st.lists(ticks, min_size=1, max_size=9))):
        left = 2**48 - start - tick
        duration = draw(st.sampled_from([0, left]) | st.integers(0, left))
        channel = draw(st.sampled_from([None, 0, 65534]) | st.integers(0, 65534))
        made.append(CodedEvent(start + tick, duration, channel, draw(event_texts)))
    return start, span, made


def idle_settings(test):
    """Let a law meet settings that do nothing for its recording, which a DataWarning says."""
    for text in (
        "no channel is known to be felt",
        ".* does nothing for .*. no step is known",
        ".* is stored without loss. it has infinite samples",
    ):
        test = pytest.mark.filterwarnings(f"ignore:{text}")(test)
    return test


@st.composite
def encoder_settings(draw):
    """Presets, bits or step, hold or linear, clusters short and long, with and without digests."""
    quantiser = draw(
        st.sampled_from(
            [{"bits": 0}, {"bits": 5}, {"step": Tolerance(1, "lsb")}, {"preset": "lossless"},
             {"preset": "perceptual"}, {"preset": "perceptual", "felt": "all"},
             {"preset": "perceptual", "texture": False, "felt": "all"},
             {"preset": "near-lossless", "max_error": Tolerance(7, "lsb"), "force_error": True},
             {"preset": "near-lossless"}]
        )
    )  # fmt: skip
    preset = quantiser.setdefault("preset", "paper")
    floors = st.sampled_from(
        [Tolerance(0.5, "lsb"), Tolerance(10, "lsb"), Tolerance(0.01, "range")]
    )
    given = {}
    if preset == "paper" or "felt" in quantiser:
        given["k"] = draw(st.sampled_from([Fraction(0), Fraction(1, 10), Fraction(1)]))
        given["floor"] = draw(floors)
    if preset == "paper":
        given["interpolation"] = draw(st.sampled_from(["hold", "linear"]))
    if preset != "lossless":
        given["smallest"] = draw(st.booleans())
    return Settings.of(
        cluster=draw(st.sampled_from([Fraction(1, 10), Fraction(10)])),
        digest=draw(st.booleans()),
        **quantiser,
        **given,
    )
