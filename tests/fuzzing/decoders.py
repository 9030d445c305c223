"""Every decoder: counts within their range or one of our errors, the same from the readable loops
and the compiled ones, and the same packet again where its bits are fixed.

An input is one byte for level, components and range, two for the span, one for the size of the
parameters, the parameters, and the packet.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import forge as f
import numpy as np
import singles
from numpy.typing import NDArray

from hapfmt.codecs import exact, knots, noise, predicted, quantised, raw, transform
from hapfmt.codecs.exact import ExactParameters
from hapfmt.codecs.grids import LpcParameters, deadband_levels
from hapfmt.encoder.transform import encode_row
from hapfmt.format.track import Affine
from hapfmt.kernels import compiled
from hapfmt.limits import LEVELS, Level

from .target import Target, outcome, settled

AT = 100
WIDTHS = (1, 2, 3, 5)
SPAN_LIMIT = 1 << 10
"""Ticks: the readable loops are slow, and what is long differs in nothing but its length."""

RANGES = ((-(1 << 31), (1 << 31) - 1), (-100, 100))


@contextmanager
def readable() -> Iterator[None]:
    """The twins run instead of the compiled loops."""
    modules = [
        module
        for name, module in list(sys.modules.items())
        if name.startswith("hapfmt.codecs.") and getattr(module, "compiled", None) is not None
    ]
    deadband_levels.cache_clear()
    for module in modules:
        module.compiled = None  # type: ignore[attr-defined]
    try:
        yield
    finally:
        for module in modules:
            module.compiled = compiled  # type: ignore[attr-defined]
        deadband_levels.cache_clear()


class Asked(NamedTuple):
    """What a packet is decoded with."""

    level: Level
    width: int
    low: int
    high: int
    span: int
    parameters: bytes
    packet: bytes


def asked(data: bytes) -> Asked | None:
    if len(data) < 4:
        return None
    low, high = RANGES[data[0] >> 3 & 1]
    size = 4 + data[3]
    return Asked(
        LEVELS[1 + data[0] % 2],
        WIDTHS[data[0] >> 1 & 3],
        low,
        high,
        1 + int.from_bytes(data[1:3], "little") % SPAN_LIMIT,
        data[4:size],
        data[size:],
    )


def given(
    parameters: bytes, packet: bytes, span: int, width: int = 1, level: int = 1, narrow: int = 0
) -> bytes:
    """An input of a decoder."""
    first = (level - 1) | WIDTHS.index(width) << 1 | narrow << 3
    return bytes([first]) + (span - 1).to_bytes(2, "little") + bytes([len(parameters)]) + parameters + packet  # fmt: skip


def both(call: Callable[[], NDArray[Any]]) -> NDArray[Any] | None:
    """The numbers, which are the same with the extension and without; None for one of our errors,
    which is the same too."""

    def told() -> Any:
        numbers = call()
        return numbers.shape, numbers.dtype, numbers.tobytes()

    fast = outcome(told)
    with readable():
        assert fast == outcome(told)
    return None if isinstance(fast[0], str) else call()


def decode(within: Any, ask: Asked, parameters: Any) -> NDArray[np.int32] | None:
    """By the path of a reader: clamped, and within the range."""
    numbers = both(
        lambda: within(
            ask.packet, parameters, ask.span, ask.width, ask.level, AT, ask.low, ask.high
        )
    )
    if numbers is None:
        return None
    assert numbers.shape == (ask.span, ask.width)
    assert ask.low <= numbers.min() <= numbers.max() <= ask.high
    return numbers


def knot(data: bytes) -> None:
    ask = asked(data)
    parameters = ask and settled(knots.KnotParameters.parse, ask.parameters, ask.level, AT)
    if not ask or not parameters:
        return
    if not parameters.coded:
        if decode(knots.decode_within, ask, parameters) is not None:
            assert knots.build_knots(*knots.parse_knots(ask.packet, ask.width, AT)) == ask.packet
        return
    if decode(knots.decode_coded_within, ask, parameters) is None:
        return
    limit = parameters.grid.index_limit(ask.level.count_bound)
    way = parameters.interpolation
    ticks, rows = knots.decode_indices(ask.packet, way, ask.span, ask.width, limit, AT)
    again = knots.encode_knots(ticks, rows, way)
    back = knots.decode_indices(again, way, ask.span, ask.width, limit, AT)
    assert back[0].tolist() == ticks.tolist() and back[1].tolist() == rows.tolist()


def quan(data: bytes) -> None:
    ask = asked(data)
    parameters = ask and settled(quantised.QuanParameters.parse, ask.parameters, ask.level, AT)
    if ask and parameters:
        decode(quantised.decode_within, ask, parameters)


def rawb(data: bytes) -> None:
    """The bits for the width choose the number format instead."""
    ask = asked(data)
    if ask is None:
        return
    kind = ("counts", "binary64", "binary32", "int64")[WIDTHS.index(ask.width)]
    parameters = settled(raw.RawParameters.parse, ask.parameters, kind, AT)
    if parameters is None:
        return
    for width in (1, 3):
        numbers = settled(raw.decode_raw, ask.packet, parameters, kind, ask.span, width, AT)
        if numbers is not None:
            again = raw.encode_raw(numbers, parameters.word_size)
            back = raw.decode_raw(again, parameters, kind, ask.span, width, AT)
            assert back.dtype == numbers.dtype
            assert back.tobytes() == numbers.tobytes()


def lpcr(data: bytes) -> None:
    ask = asked(data)
    parameters = ask and settled(LpcParameters.parse, ask.parameters, ask.level, AT)
    if not ask or not parameters or decode(predicted.decode_within, ask, parameters) is None:
        return
    if ask.width > 1:
        return
    limit = parameters.index_limit(ask.level.count_bound)
    predictor, constant, _ = predicted.parse_header(ask.packet, AT)
    if not constant:
        indices = predicted.decode_indices(ask.packet, ask.span, limit, AT)
        again = predicted.encode_predicted(indices, replace(predictor, references=()))
        assert (predicted.decode_indices(again, ask.span, limit, AT) == indices).all()


def mdct(data: bytes) -> None:
    ask = asked(data)
    parameters = ask and settled(transform.TransformParameters.parse, ask.parameters, AT)
    if ask and parameters:
        assert parameters.build() == ask.parameters
        decode(transform.decode_within, ask, parameters)


AFFINES = (
    Affine(1, 0, 10),
    Affine(1, 0, 1 << 40),
    Affine(-3, 7, 1000),
    Affine((1 << 22) - 1, -1, 3),
)
"""Calibrations that keep VAL-001 at either level; chosen by the bits for the width."""


def lpcx(data: bytes) -> None:
    ask = asked(data)
    parameters = ask and settled(ExactParameters.parse, ask.parameters, AT)
    if not ask or not parameters:
        return
    counts = both(lambda: singles.decode_counts(ask.packet, ask.span, ask.level, AT))
    if counts is None or max(-int(counts.min()), int(counts.max())) >= 1 << 31:
        return
    affine = AFFINES[WIDTHS.index(ask.width)]
    doubles = both(lambda: singles.decode_exact(ask.packet, parameters, affine, counts, AT))
    if doubles is None:
        return
    for recall in (False, True):
        try:
            rest = exact.encode_exact(doubles, parameters, affine, counts, recall=recall)
        except ValueError:
            continue  # a correction of 2^63 has no code but with z = 63
        coded, _, _ = exact.split_packet(ask.packet, AT)
        again = f.varint(len(coded)) + coded + rest
        back = singles.decode_exact(again, parameters, affine, counts, AT)
        assert back.tobytes() == doubles.tobytes()


def nois(data: bytes) -> None:
    ask = asked(data)
    parameters = ask and settled(noise.NoiseParameters.parse, ask.parameters, AT)
    if not ask or not parameters:
        return
    counts = both(
        lambda: noise.decode_within(
            ask.packet, parameters, ask.span, ask.width, AT, ask.low, ask.high
        )
    )
    if counts is not None:
        assert counts.shape == (ask.span, ask.width)
        assert ask.low <= counts.min() <= counts.max() <= ask.high


def wave(span: int, width: int = 1, scale: float = 60.0) -> NDArray[np.int64]:
    """Counts [span, width] that resemble a recording."""
    rng = np.random.default_rng(span)
    t = np.arange(span)[:, None]
    x = scale * np.sin(t / (5 + np.arange(width))) + rng.normal(0, 2, (span, width))
    return np.round(x).astype(np.int64)


def of_knot() -> Iterable[bytes]:
    for way in (0, 1):
        parameters = f.knot_parameters(way, 3)
        for width in (1, 3):
            ticks = np.array([0, 4, 9, 31])
            packet = knots.build_knots(ticks, wave(4, width))
            yield given(parameters, packet, 32, width)
        yield given(parameters, f.svarint(5), 1000, level=2)
    yield given(f.knot_parameters(1, 1), knots.build_knots(np.array([0, 9]), wave(2)), 10)
    yield from of_coded_knots()


def of_quan() -> Iterable[bytes]:
    for width, span in ((1, 200), (3, 40)):
        levels = wave(span, width, 3.0)
        levels[50:90] = 0
        alphabet = quantised.Alphabet(3, 6, 4)
        symbols, _ = alphabet.tokenise(np.ascontiguousarray(levels.T).reshape(-1))
        lengths = quantised_lengths(symbols, alphabet.size)
        parameters = quantised.QuanParameters(5, alphabet, lengths)
        yield given(parameters.build(), quantised.encode_quantised(levels, parameters), span, width)
    yield given(f.quan_parameters(b"\x01\x10", m=1, r=2), b"", 4)
    yield given(f.quan_parameters(bytes([0x22, 0x22]), m=1, r=1), b"\x1b\x80", 4)


def quantised_lengths(symbols: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    from hapfmt.codecs.quantised import code_lengths

    return code_lengths(np.bincount(symbols, minlength=size))


def of_rawb() -> Iterable[bytes]:
    for size in (1, 2, 3, 4):
        packet = raw.encode_raw(wave(30), size)
        yield given(f.raw_parameters(size), packet, 30)
        yield given(f.raw_parameters(size), raw.encode_raw(np.zeros((900, 1), np.int64), size), 900)
    yield given(f.raw_parameters(8), raw.encode_raw(wave(9).astype(np.float64), 8), 9, 2)
    yield given(f.raw_parameters(8), raw.encode_raw(wave(9, 3).astype(np.float64), 8), 9, 2)
    yield given(f.raw_parameters(4), raw.encode_raw(wave(9).astype(np.float32), 4), 9, 3)


PREDICTORS = (
    predicted.Predictor(),
    predicted.Predictor(2),
    predicted.Predictor(1, (60, -20), 3),
    predicted.Predictor(0, (90, -70, 10), -4, repeats=True),
)


def of_lpcr() -> Iterable[bytes]:
    plain, coarse = f.lpcr_parameters(), f.lpcr_parameters(1, step=20, kn=1, kd=10)
    x = wave(64)[:, 0]
    x[20:30] = x[20]
    for predictor in PREDICTORS:
        packet = predicted.encode_indices(x, predictor)
        yield given(plain, packet, 64)
        yield given(coarse, predicted.encode_indices(x // 8, predictor), 64)
    yield given(plain, b"\x10\0\x0a", 1000, level=2)
    rows = wave(40, 3)
    packets = []
    for place in range(3):
        references = ((place - 1, (3, 50, -7)),) if place else ()
        predictor = predicted.Predictor(0, (70, -30), references=tuple(map(made, references)))
        earlier = [rows[:, i] for i in range(place)]
        packets.append(predicted.encode_component(rows[:, place], predictor, earlier))
    yield given(plain, predicted.join_components(packets), 40, 3)


def of_mdct() -> Iterable[bytes]:
    x = wave(70)[:, 0]
    for m, step, weights in ((5, 256, b""), (6, 9000, b"\x10\x40"), (9, 1 << 32, b"")):
        parameters = transform.TransformParameters(1 << m, step, weights)
        yield given(parameters.build(), encode_row(x.astype(np.float64), parameters), 70)
    plain = transform.TransformParameters(32, 1)
    for classes, start in ((0, 0), (0xE5, 163)):
        levels = np.array([[1 << 30, -1, 0, 5], [0, 0, 0, 0], [-9, 1, 1 << 20, -2]])
        packet = transform.encode_component(-9, levels, classes, start)
        yield given(plain.build(), packet, 90, level=2)
    parts = [transform.encode_component(5, levels[:2, :width], 0, 12) for width in (0, 3)]
    yield given(plain.build(), bytes([len(parts[0])]) + b"".join(parts), 40, 2, narrow=1)


def made(reference: tuple[int, tuple[int, int, int]]) -> Any:
    from hapfmt.codecs.predicted import Reference

    return Reference(*reference)


def of_coded_knots() -> Iterable[bytes]:
    for way, name in enumerate(knots.INTERPOLATIONS):
        for grid in ({}, {"grid": 1, "step": 20, "kn": 1, "kd": 10}):
            parameters = f.coded_knot_parameters(way, **grid)
            for width in (1, 2):
                ticks = np.array([0, 4, 9, 12, 31])
                rows = wave(5, width) // 4
                yield given(parameters, knots.encode_knots(ticks, rows, name), 32, width)
        yield given(f.coded_knot_parameters(way), b"\x09", 7)


def of_lpcx() -> Iterable[bytes]:
    counts = wave(30, scale=20)[:, 0]
    coded = predicted.encode_indices(counts, predicted.Predictor(1))
    rng = np.random.default_rng(1)
    for rule, digits in ((0, 0), (1, 0), (2, 1), (2, 5)):
        parameters = ExactParameters(rule, digits)
        doubles = parameters.values(counts, AFFINES[0])
        moved = doubles + rng.normal(0, 1e-12, 30) * (rng.random(30) < 0.5)
        for recall in (False, True):
            rest = exact.encode_exact(moved, parameters, AFFINES[0], counts, recall=recall)
            packet = f.varint(len(coded)) + coded + rest
            yield given(f.lpcx_parameters(rule, digits), packet, 30)
    bent = (1 / 3, 0.1, -1e-7, 1e-14)
    cubic = ExactParameters(3, 0, bent)
    doubles = np.nextafter(cubic.values(counts, AFFINES[0]), 9)
    rest = exact.encode_exact(doubles, cubic, AFFINES[0], counts, recall=True)
    packet = f.varint(len(coded)) + coded + rest
    yield given(f.lpcx_parameters(3, 0, bytes(2), bent), packet, 30)
    noise = rng.normal(0, 1, 30)
    rest = exact.encode_exact(noise, ExactParameters(), AFFINES[1], counts, recall=False)
    yield given(f.lpcx_parameters(), f.varint(len(coded)) + coded + rest, 30, 2, level=2)


def of_nois() -> Iterable[bytes]:
    parameters = noise.NoiseParameters(3, 8)
    gains = [40, 60, 0, 0, 112, 30, 1, 50] + [0] * 8 + [70] * 8
    for order in (0, 1, 4, 32):
        ks = [100, -80, 30, -5, *[7] * 28][:order]
        blocks = [ks, ks, ks[::-1]]
        part = noise.encode_component(
            gains, blocks, parameters, seed=order, density=50 * (order > 1)
        )
        yield given(parameters.build(), part, 190)
        yield given(parameters.build(), noise.encode_packet([part, b""]), 190, 2, narrow=1)
    yield given(f.nois_parameters(12, 255), noise.encode_component(
        [112], [[127, -127] * 8], noise.NoiseParameters(12, 255), seed=9), 1000, level=2)  # fmt: skip


DECODERS = [
    Target("knot", knot, of_knot),
    Target("quan", quan, of_quan),
    Target("rawb", rawb, of_rawb),
    Target("lpcr", lpcr, of_lpcr),
    Target("mdct", mdct, of_mdct),
    Target("lpcx", lpcx, of_lpcx),
    Target("nois", nois, of_nois),
]
