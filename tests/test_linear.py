"""Doubles that are linear in others: rule 4 of LPCX, and how the encoder finds it."""

from __future__ import annotations

import io
import struct
from fractions import Fraction

import numpy as np
import page_exact
import pytest
from forge import lpcx_parameters
from hypothesis import given
from hypothesis import strategies as st
from twins import built, changed, same

import hapfmt
from hapfmt.codecs import exact
from hapfmt.codecs.exact import (
    LINEAR,
    ExactParameters,
    LinearTerm,
    decode_exact,
    lacking_of,
    linear_values,
    parse_parameters,
)
from hapfmt.encoder.encode import encode
from hapfmt.encoder.exact import (
    FORMS,
    LOOKED_AT,
    NEAR,
    Relation,
    Weigher,
    find_relations,
    left_after,
    left_by,
    sources_of,
    stretches,
)
from hapfmt.errors import FormatError
from hapfmt.format.track import Affine
from hapfmt.numbers import build_varint
from hapfmt.recording import Channel, Recording, Span

RATE = 1000
CONSTANT = bytes.fromhex("10 00 0A")
"""A component packet of fives."""

AWKWARD = [0.0, -0.0, 1.0, -2.5, 5e-324, 1e308, -1e308, float("inf"), float("nan"), 1e-300]
doubles = st.sampled_from(AWKWARD) | st.floats(width=64)
weights = st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5, 1e270, 5e-324]) | st.floats(
    -1e3, 1e3, allow_nan=False
)


def words(x):
    return [word % 2**64 for word in struct.unpack(f"<{len(x)}q", np.asarray(x, "<f8").tobytes())]


@st.composite
def cases(draw):
    """Parameters of some components, and the doubles of each."""
    count, span = draw(st.integers(1, 4)), draw(st.integers(1, 12))
    order = draw(st.permutations(range(count)))
    linear = sorted(order[draw(st.integers(0, count)) :])
    rules = []
    for place in range(count):
        if place not in linear:
            rules.append(ExactParameters(draw(st.integers(0, 1))))
            continue
        known = [a for a in range(count) if a not in linear or a < place]
        own = st.builds(LinearTerm, st.just(place), st.integers(1, 14), weights)
        other = st.builds(LinearTerm, st.sampled_from(known), st.integers(0, 14), weights)
        terms = draw(st.lists(own | other if known else own, min_size=1, max_size=16))
        rules.append(ExactParameters(LINEAR, 0, (draw(weights),), tuple(terms)))
    columns = [draw(st.lists(doubles, min_size=span, max_size=span)) for _ in range(count)]
    return tuple(rules), [np.array(column) for column in columns]


@given(cases())
def test_doubles_come_back_as_the_page_says(case):
    """EXA-007: The exact values MUST be the numbers of the source, every bit of them."""
    rules, columns = case
    count, span = len(rules), columns[0].size
    fives = np.full((span, count), 5)
    try:
        parts = [
            lacking_of(x, rule, Affine(1, 0, 10), fives[:, 0], columns).build(recall=False)
            for x, rule in zip(columns, rules, strict=True)
        ]
    except ValueError:
        return
    coded = b"".join(build_varint(len(CONSTANT)) for _ in rules[1:]) + CONSTANT * count
    rest = b"".join(build_varint(len(part)) for part in parts[:-1]) + b"".join(parts)
    data = build_varint(len(coded)) + coded + (rest if any(parts) else b"")
    found = decode_exact(data, rules, [Affine(1, 0, 10)] * count, fives, 0)
    assert [words(column) for column in found.T] == [words(column) for column in columns]
    told = [
        page_exact.Component((1, 0, 10), rule.rule, 0, rule.coefficients, rule.terms)
        for rule in rules
    ]
    _, expected = page_exact.decode_components(data, span, told)
    assert expected == [words(column) for column in columns]


@built
@given(cases(), st.data())
def test_twins(case, data):
    """A whole packet by one call, or what the readable loops say is wrong with it."""
    rules, columns = case
    count, span = len(rules), columns[0].size
    counts = np.array(data.draw(st.lists(st.integers(4, 6), min_size=span, max_size=span)))
    rows = np.repeat(counts[:, None], count, 1)
    affines = [Affine(1, place, 10) for place in range(count)]
    try:
        parts = [
            lacking_of(x, rule, affine, counts, columns).build(recall=data.draw(st.booleans()))
            for x, rule, affine in zip(columns, rules, affines, strict=True)
        ]
    except ValueError:
        return
    rest = bytearray(b"".join(build_varint(len(part)) for part in parts[:-1]) + b"".join(parts))
    for _ in range(data.draw(st.integers(0, 2)) if rest else 0):
        rest[data.draw(st.integers(0, len(rest) - 1))] ^= 1 << data.draw(st.integers(0, 7))

    def found(*given):
        try:
            return [words(column) for column in decode_exact(*given).T]
        except FormatError as error:
            return type(error).__name__, error.requirement, error.offset, error.message

    same(exact, found, b"\0" + rest, rules, affines, rows, 5)


@built
@pytest.mark.parametrize("wrong", [
    {1: bytes(3)}, {1: b"\5\0\0\0"}, {1: b"\4\0\0\0" + bytes(8)}, {1: b"\4\0\1\0" + bytes(18)},
    {1: bytes(5)}, {2: np.array([[1, 0, 0]])}, {2: np.array([[2**53 + 1, 0, 1]])}, {2: b""},
    {2: np.ones((3, 3), np.int64)}, {3: bytes(7)}, {3: b""}, {5: np.zeros(3)},
    {1: b"\2\0\0\0"}, {1: b"\2\x20\0\0"},
], ids=changed)  # fmt: skip
def test_what_are_no_parameters(wrong):
    given = {0: b"", 1: bytes(4), 2: np.array([[1, 2, 1]]), 3: np.ones(2, np.int32),
             4: False, 5: np.zeros(2)}  # fmt: skip
    assert exact.compiled.exact_packet(*given.values())
    assert given[5].tolist() == [3.0, 3.0]
    with pytest.raises(ValueError, match="not the parameters"):
        exact.compiled.exact_packet(*(given | wrong).values())
    with pytest.raises(TypeError):
        exact.compiled.exact_packet(b"")


@given(cases())
def test_parameters_come_back(case):
    """
    EXA-002: `rule` MUST be at most 4. `digits` is 1 to 31 with rule 2, else 0, `terms` 1 to 16 with rule 4, else 0. Coefficients and weights are finite and of a magnitude below 2^900. `a` is a component that is decoded before, or the component itself with a `lag` of at least 1.
    """
    rules, _ = case
    data = b"".join(rule.build() for rule in rules)
    assert data == b"".join(
        lpcx_parameters(rule.rule, 0, bytes(2), rule.coefficients, rule.terms) for rule in rules
    )
    assert parse_parameters(data, len(rules), 0) == rules
    for wrong in (data[:-1], data + b"\0"):
        with pytest.raises(FormatError):
            parse_parameters(wrong, len(rules), 0)
    with pytest.raises(FormatError):
        parse_parameters(data, len(rules) + 1, 0)


def sensor(size=4000, seed=1):
    """A converter of 12 bits, in volts, as doubles."""
    rng = np.random.default_rng(seed)
    t = np.arange(size) / RATE
    return np.rint(600 * np.sin(9 * t) + 40 * rng.normal(size=size)) * (10 / 4096)


def filtered(x, a=0.731, b=0.269):
    y = np.zeros(x.size)
    for t in range(1, x.size):
        y[t] = a * y[t - 1] + b * x[t]
    return y


def written(*columns, **options):
    recording = Recording(tuple(Channel(x, RATE, label=f"c{i}") for i, x in enumerate(columns)))
    out = io.BytesIO()
    hapfmt.write(recording, out, **options)
    back = hapfmt.read(out.getvalue())
    for x, channel in zip(columns, back.channels, strict=True):
        assert channel.samples().tobytes() == x.astype(np.float64).tobytes()
    assert hapfmt.verify(out.getvalue(), against=recording).verdict == "intact"
    return len(out.getvalue())


NOISE = np.random.default_rng(8).normal(size=4000)


@pytest.mark.parametrize(
    ("source", "made"),
    [
        (sensor(), filtered(sensor())),
        (NOISE, filtered(NOISE)),
        (NOISE, NOISE * 0.3183),
        (NOISE, 0.1 - NOISE / 3),
        (NOISE, np.concatenate(([0.0], np.diff(NOISE))) / 0.0007),
        (NOISE, np.concatenate(([0.0], NOISE[:-1]))),
    ],
    ids=["filtered sensor", "filtered", "scaled", "moved", "differences", "late"],
)
@pytest.mark.parametrize("first", [False, True])
def test_what_follows_from_another_channel_costs_little(source, made, first):
    together = written(made, source) if first else written(source, made)
    # Counts of 12 bits, and little for the doubles.
    assert together - written(source) < 8000 < 0.4 * written(made)


def test_equal_doubles_are_found():
    assert written(NOISE, NOISE) < written(NOISE) + 6000
    assert written(NOISE, -2.5 * NOISE, NOISE) < written(NOISE) + 12000


def test_channels_between_stay_what_they_are():
    states = np.repeat([0.0, 1.0], 2000)
    size = written(NOISE, states, sensor(), filtered(sensor()), NOISE[::-1].copy())
    assert size < 2 * written(NOISE) + written(sensor()) + 7000


def test_channels_of_integers_may_lie_between():
    """As a constant channel of doubles does that was read from a file and is written again."""
    counts = np.zeros(4000, np.int32)
    size = written(NOISE, counts, filtered(NOISE), np.arange(4000, dtype=np.int32))
    assert size < written(NOISE) + 8000


@pytest.mark.parametrize("ends", [(-30, 30), (50, 70), (-500, 500), (900, 1000)])
def test_words_that_others_follow_from(ends):
    """Exponents are uniform, so the channel alone is kept as words, which have no counts."""
    rng = np.random.default_rng(4)
    x = np.ldexp(rng.uniform(0.5, 1, 4000), rng.integers(*ends, 4000))
    alone = encode(Recording((Channel(x, RATE),)))
    assert [track.number_format for track in alone.tracks] == ["binary64"]
    assert written(x, x * 2, x * -0.25) <= 3 * written(x)


def test_parts_of_a_track_with_gaps():
    x = NOISE
    spans = (Span(0, 1700), Span(2000, 4300))
    channels = [Channel(x * w, RATE, coverage=spans, label=str(w)) for w in (1.0, 0.3, -7.7)]
    encoded = encode(Recording(tuple(channels)))
    assert [len(track.components) for track in encoded.tracks] == [3]
    out = io.BytesIO()
    hapfmt.write(Recording(tuple(channels)), out)
    back = hapfmt.read(out.getvalue())
    for channel, again in zip(channels, back.channels, strict=True):
        assert again.coverage == channel.coverage
        assert again.samples().tobytes() == channel.samples().tobytes()
    with hapfmt.Reader(out.getvalue()) as reader:
        part = reader.read(["0.3"], start=3, stop=3.5)
    assert part.channels[0].samples().tobytes() == (x * 0.3)[2700:3200].tobytes()


def test_no_references_keeps_them_apart():
    recording = Recording((Channel(NOISE, RATE), Channel(NOISE * 2, RATE)))
    assert len(encode(recording, hapfmt.Settings(references=False)).tracks) == 2
    assert len(encode(recording).tracks) == 1


def test_noise_is_related_to_nothing():
    rng = np.random.default_rng(3)
    assert not find_relations(rng.normal(size=(4, 4000)), [True] * 4)
    assert not find_relations(np.ones((3, 4000)), [True] * 3)
    assert not find_relations([NOISE[:100], NOISE[:100] * 2], [True] * 2)


def test_stretches_hold_their_relations():
    def relation(target, source):
        return Relation(target, source, 0.0, (), 0.0)

    assert stretches([]) == []
    assert stretches([relation(3, 1), relation(2, 5), relation(8, 7)]) == [(1, 6), (7, 9)]
    assert stretches([relation(0, 1), relation(2, 3)]) == [(0, 2), (2, 4)]
    assert stretches([relation(0, 9), relation(2, 3)]) == [(0, 10)]


@pytest.mark.capped(16 << 20)
def test_its_own_past_takes_bytes_a_sample():
    """Few bytes may ask for many samples: no object is kept of each."""
    span = 1 << 18
    columns = [np.ones(span), np.empty(span)]
    terms = [LinearTerm(1, 1, 0.5), LinearTerm(0, 0, 0.5)]
    moves = np.ones(span, np.int64)
    found = linear_values(np.ones(span), 0.0, terms, columns, moves, 1)
    assert found[0] == np.nextafter(1, 2)
    assert (found[1:] == np.nextafter(0.5 * found[:-1] + 0.5, 2)).all()


def test_weights_of_rows_that_depend_on_each_other():
    rng = np.random.default_rng(5)
    rows = np.cumsum(rng.normal(size=(5, 2044)), axis=1)
    weights = np.array([1.5, -2.0, 0.25, 3.0, -1.0])
    assert np.allclose(Weigher(rows)(weights @ rows), weights, rtol=1e-12)
    more = np.vstack((rows, rows[0] + rows[1], np.zeros(2044)))
    found = Weigher(more)(weights @ rows)
    assert np.allclose(found[:5], weights, rtol=1e-10)
    assert not found[5:].any()


@pytest.mark.parametrize("size", [1e-300, 1.0, 1e300])
def test_weights_of_values_of_any_size(size):
    rows = np.random.default_rng(6).normal(size=(3, 400)) * size
    assert np.allclose(Weigher(rows)(rows[0] * 0.5 - rows[2]), [0.5, 0, -1], atol=1e-12)


def test_what_weights_leave_is_known_to_twice_the_digits():
    """So it is on machines without wider floats too."""
    rng = np.random.default_rng(8)
    rows, weights = rng.normal(size=(4, 50)), rng.normal(size=4)
    finer = weights * rng.uniform(-1, 1, 4) * 2.0**-54
    y = weights @ rows
    exactly = [
        Fraction(value)
        - sum(
            (Fraction(w) + Fraction(f)) * Fraction(x)
            for w, f, x in zip(weights.tolist(), finer.tolist(), column, strict=True)
        )
        for value, column in zip(y.tolist(), rows.T.tolist(), strict=True)
    ]
    found = left_after(y, rows, weights, finer)
    assert np.abs(found).max() > 0
    assert np.abs(found - np.array(exactly, float)).max() < 2.0**-100


@pytest.mark.parametrize("noise", [0, 1e-16, 1e-12, 1e-11, 1e-10, 1e-6])
def test_a_few_samples_rule_out_no_source(noise):
    rng = np.random.default_rng(7)
    x = np.cumsum(rng.normal(size=(4, LOOKED_AT)), axis=1)
    y = x[0] * 0.75
    for t in range(1, LOOKED_AT):
        y[t] += 0.25 * y[t - 1]
    y += noise * np.abs(y).max() * rng.uniform(-1, 1, y.size)
    limit = NEAR * np.abs(y).max()
    expected = [k + 1 for k in range(4) if left_by(FORMS[-1], y, x[k]) < limit]
    assert sources_of(0, [y, *x]) == expected
    assert (1 in expected) == (noise <= 1e-11)
