"""NOIS: texture from a model, noise that an all-pole filter shapes (SPEC 9.10).

An interval has a gain, a block of intervals has reflection coefficients. kernels/ has the same in
C.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..format.layout import NOIS_PARAMETERS
from ..kernels import compiled
from ..numbers import clamp, rdiv
from .entropy import START_MOST, Decoder, Encoder, put_integers
from .predicted import FOUR_STATES, ORDER_LIMIT, SINES, STATUS, TABLE, join_components, parts_of

SHIFTS = range(3, 13)
INTERVALS_LIMIT = 255
BLOCK_LEAST = 64
"""Ticks of a block: so its coefficients are at most half as many numbers as its samples."""

GAIN_LIMIT, COEFFICIENT_LIMIT = 112, 127
ROOTS = (4096, 4871, 5793, 6889)
"""4096 * 2**(i / 4): four gain indices are 6 dB."""

GAIN_SHIFT, FRACTION_SHIFT, SINE_SHIFT = 20, 6, 15
NOISE_STD = 256
"""Standard deviation of the noise, within 0.001 %; times the gain of index 1 it is one 64th of a
count."""

STATE_MOST = (1 << 31) - 1
HEAD = 7
"""Bytes of a component packet before its codings."""

FAULTS = {
    **STATUS,
    7: ("NOI-006", "a gain index out of range"),
    8: ("NOI-006", "a coefficient out of range"),
}
"""What the compiled loop returns."""

Counts = NDArray[np.int32]


@dataclass(frozen=True)
class NoiseParameters:
    """An interval has 2**shift ticks, a block this number of intervals."""

    shift: int
    intervals: int

    def build(self) -> bytes:
        return NOIS_PARAMETERS.build(shift=self.shift, intervals=self.intervals)

    @classmethod
    def parse(cls, data: bytes, offset: int) -> NoiseParameters:
        raw = NOIS_PARAMETERS.parse(data, 0, "COD-002", offset)
        if len(data) != NOIS_PARAMETERS.size:
            raise FormatError(
                "bytes left over after the codec parameters",
                requirement="COD-002",
                offset=offset + NOIS_PARAMETERS.size,
            )
        if raw.shift not in SHIFTS or raw.intervals << raw.shift < BLOCK_LEAST:
            raise FormatError(
                "intervals or blocks that are not defined", requirement="NOI-003", offset=offset
            )
        return cls(raw.shift, raw.intervals)

    def interval_count(self, span: int) -> int:
        return -(-span >> self.shift)

    def block_count(self, span: int) -> int:
        return -(-self.interval_count(span) // self.intervals)


@dataclass(frozen=True)
class Model:
    """What a component packet says before its coded bytes; codings are (class, start byte)."""

    order: int
    density: int
    seed: int
    gain: int
    gain_coding: tuple[int, int]
    coefficient_coding: tuple[int, int]
    lanes: int


def parse_model(data: bytes, offset: int) -> tuple[Model, int]:
    """The model, and where the coded bytes begin."""
    order = data[0]
    size = HEAD + (4 if order else 2)
    if order > ORDER_LIMIT:
        raise FormatError(
            "a filter of more than 32 coefficients", requirement="NOI-005", offset=offset
        )
    if len(data) < size:
        raise TruncatedError(
            "the packet ends before its coded bytes", requirement="NOI-005", offset=offset
        )
    if data[6] > GAIN_LIMIT:
        raise FormatError("a gain index out of range", requirement="NOI-006", offset=offset + 6)
    first, second = (data[7], data[8]), (data[9], data[10]) if order else (0, 0)
    unused = first[0] & ~(15 | FOUR_STATES) or second[0] & ~15
    if unused or max(first[1], second[1]) > START_MOST:
        raise FormatError(
            "a coding that is not defined", requirement="RNG-004", offset=offset + HEAD
        )
    model = Model(
        order,
        data[1],
        int.from_bytes(data[2:6], "little"),
        data[6],
        (first[0] & 15, first[1]),
        second,
        4 if first[0] & FOUR_STATES else 1,
    )
    return model, size


def gain_of(index: int) -> int:
    return ROOTS[(index - 1) % 4] << ((index - 1) // 4) if index else 0


def noise(seed: int, tick: int, density: int) -> int:
    """n of SPEC 9.10."""
    w = (seed + tick * 2654435769) & 0xFFFFFFFF
    w = (w ^ w >> 16) * 2246822507 & 0xFFFFFFFF
    w = (w ^ w >> 13) * 3266489909 & 0xFFFFFFFF
    w ^= w >> 16
    if density and w & 255 >= density:
        return 0
    return 2 * ((w >> 8 & 255) + (w >> 16 & 255) + (w >> 24)) - 765


def step_lattice(f: int, ks: Sequence[int], g: list[int]) -> int:
    """The filter's next value for the excitation f; g becomes the state of the next tick."""
    for j in range(len(ks) - 1, -1, -1):
        f += rdiv(ks[j] * g[j], 1 << SINE_SHIFT)
        if j + 1 < len(ks):
            g[j + 1] = within(g[j] - rdiv(ks[j] * f, 1 << SINE_SHIFT))
    f = within(f)
    if ks:
        g[0] = f
    return f


def within(x: int) -> int:
    return clamp(x, -STATE_MOST - 1, STATE_MOST)


def sine_of(k: int) -> int:
    return SINES[k] if k >= 0 else -SINES[-k]


def synthesise(
    model: Model,
    gains: Sequence[int],
    blocks: Sequence[Sequence[int]],
    parameters: NoiseParameters,
    span: int,
) -> array[int]:
    """The readable loop; kernels/ has the same in C."""
    counts, before = array("q"), gains[0]
    g = [0] * model.order
    for interval, gain in enumerate(gains):
        start = interval << parameters.shift
        size = min(1 << parameters.shift, span - start)
        low, high = gain_of(before), gain_of(gain)
        before = gain
        if not low and not high:
            g = [0] * model.order
            counts.extend([0] * size)
            continue
        ks = [sine_of(k) for k in blocks[interval // parameters.intervals]]
        for i in range(size):
            now = low + ((high - low) * i >> parameters.shift)
            e = rdiv(now * noise(model.seed, start + i, model.density), 1 << GAIN_SHIFT)
            counts.append(rdiv(step_lattice(e, ks, g), 1 << FRACTION_SHIFT))
    return counts


def silent_blocks(gains: Sequence[int], parameters: NoiseParameters) -> list[bool]:
    """Which blocks have no gain at all, and so no coefficients of their own."""
    size = parameters.intervals
    return [not any(gains[at : at + size]) for at in range(0, len(gains), size)]


def read_gains(coder: Decoder, model: Model, count: int) -> list[int]:
    gains = [model.gain]
    for difference in coder.integers(count - 1, *model.gain_coding, signs=True):
        gains.append(gains[-1] + difference)
    if not 0 <= min(gains) <= max(gains) <= GAIN_LIMIT:
        raise FormatError("a gain index out of range", requirement="NOI-006", offset=coder.place)
    return gains


def read_blocks(
    coder: Decoder, model: Model, gains: Sequence[int], parameters: NoiseParameters
) -> list[list[int]]:
    silent = silent_blocks(gains, parameters)
    before = [0] * model.order
    if not model.order:
        return [before] * len(silent)
    written = model.order * silent.count(False)
    differences = iter(coder.integers(written, *model.coefficient_coding, signs=True))
    blocks = []
    for quiet in silent:
        if not quiet:
            before = [k + next(differences) for k in before]
            if max(map(abs, before)) > COEFFICIENT_LIMIT:
                raise FormatError(
                    "a coefficient out of range", requirement="NOI-006", offset=coder.place
                )
        blocks.append(before)
    return blocks


def decode_component(
    data: bytes, parameters: NoiseParameters, offset: int, low: int, high: int, out: Counts
) -> None:
    """Fills ``out`` [span] with the counts of a component packet, clamped to low ... high."""
    if not data:
        out.fill(clamp(0, low, high))
        return
    model, start = parse_model(data, offset)
    coded, at = data[start:], offset + start
    if compiled is not None:
        status, taken = compiled.noise_decode(
            coded, model.order, model.density, model.seed, model.gain, *model.gain_coding,
            *model.coefficient_coding, model.lanes, parameters.shift, parameters.intervals,
            low, high, TABLE, out,
        )  # fmt: skip
        if status:
            requirement, message = FAULTS[status]
            place = at + min(taken, len(coded))
            raise FormatError(message, requirement=requirement, offset=place)
        return
    coder = Decoder(coded, at, model.lanes)
    gains = read_gains(coder, model, parameters.interval_count(out.size))
    blocks = read_blocks(coder, model, gains, parameters)
    coder.finish()
    counts = np.frombuffer(synthesise(model, gains, blocks, parameters, out.size), np.int64)
    out[:] = np.clip(counts, low, high)


def decode_within(
    data: bytes,
    parameters: NoiseParameters,
    span: int,
    count: int,
    offset: int,
    low: int,
    high: int,
) -> Counts:
    """The packet ``data`` at ``offset`` as counts [span, components], clamped (DEC-001)."""
    places = parts_of(data, count, offset)
    if places is None:
        raise FormatError("models larger than their packet", requirement="LPC-001", offset=offset)
    out = np.empty((count, span), np.int32)
    for row, (start, end) in zip(out, places, strict=True):
        decode_component(data[start:end], parameters, offset + start, low, high, row)
    return out.T


def encode_component(
    gains: Sequence[int],
    blocks: Sequence[Sequence[int]],
    parameters: NoiseParameters,
    *,
    seed: int,
    density: int = 0,
) -> bytes:
    """The component packet of gain indices, one for each interval, and coefficients, for each
    block. It is empty where all gains are 0. The coefficients of silent blocks are left out."""
    if not any(gains):
        return b""
    order = len(blocks[0])
    coder = Encoder()
    codings = [put_integers(coder, np.diff(gains).tolist(), signs=True)]
    if order:
        differences: list[int] = []
        before: Sequence[int] = [0] * order
        for block, quiet in zip(blocks, silent_blocks(gains, parameters), strict=True):
            if not quiet:
                differences += [k - old for k, old in zip(block, before, strict=True)]
                before = block
        codings.append(put_integers(coder, differences, signs=True))
    (number, start), *second = codings
    head = bytes([order, density]) + seed.to_bytes(4, "little") + bytes([gains[0]])
    head += bytes([number | coder.many * FOUR_STATES, start])
    return head + b"".join(map(bytes, second)) + coder.finish()


def encode_packet(parts: Sequence[bytes]) -> bytes:
    return join_components(parts)
