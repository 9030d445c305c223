"""One unit, a channel or the axes of one vector: counts -> tracks and packets.

The encoder is a client of the decoder: the residual is taken against what the decoder makes of the
LF packets (SPEC WRT-003), so the two cannot drift apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, isqrt

import numpy as np
from numpy.typing import NDArray

from ..codecs.knots import KnotParameters, build_knots
from ..codecs.quantised import encode_quantised, quantise
from ..codecs.raw import RawParameters, encode_raw
from ..container.cluster import Packet
from ..container.track import Component, Contract, Track
from ..deadband import Deadband
from ..errors import ParameterError
from ..integers import clamp
from ..limits import EXACT_LIMIT, FRACTION_LIMIT, LEVELS, ZERO_LIMIT
from ..reading.decoder import TrackDecoder
from ..recording import Channel
from .codebook import choose_codebook
from .knots import knot_values, select_knots
from .packed import Coded, Packing, plain_knots, smaller_knots
from .settings import WITHIN, Settings, counts_of, whole_counts
from .source import Source, declared_range, held_range, make_track
from .split import low_pass

ENCODE_LEVEL = LEVELS[2]
"""The bounds that hold for any track while the file's level is not decided yet."""

QUANTUM_SHARE = 4
"""Knot values are multiples of a quarter of the floor: an eighth of the floor away at most."""

COARSER = (4, 16)
"""Floors of the knots that are tried in place of the deadband's own: noise near zero, which no
knot should follow, costs up to 8 bits a sample there."""

STEP_LIMIT = LEVELS[1].step
"""Steps that every level allows; larger tolerances are seldom asked for, and held steps keep
them."""

FLOOR_LIMIT = (1 << 31) - 1

SHORT, SHORTER = 1 << 14, 10_000
"""Terms of a Weber fraction that a varint of two bytes holds; and what that may cost."""

MARGIN = Fraction(101, 100)
"""A range is measured on counts too, each end up to the deviation off: with a floor of at most a
200th of it that is 1 % of the deviation."""


@dataclass
class Unit:
    """The tracks that one unit became, and why."""

    base: Coded
    residual: Coded | None = None
    chosen: str = ""
    reason: str = ""
    exact: bool = False
    """Whether it was stored without loss, and needs no contract (SPEC DBC-004)."""

    left_out: str = ""
    """What of the channel is not in the file, where a preset decides that by itself."""

    parts: tuple[tuple[str, int], ...] = ()
    """Reason and bytes of each channel, where they are no vector."""

    @property
    def size(self) -> int:
        return self.base.size + (self.residual.size if self.residual else 0)


@dataclass(frozen=True)
class Bound:
    """How far the reconstruction may lie from the source.

    ``band`` is the contract; its floor is at least one count. ``slack`` is the error in counts that
    the floor allows whatever the force, 0 where the floor is finer than one count.
    """

    band: Deadband
    slack: int

    def holds(self, x: NDArray[np.int64], y: NDArray[np.int64]) -> bool:
        """Whether all of y [ticks, components] is within the slack; vectors by their norm."""
        if not self.slack:
            return bool((x == y).all())
        return not self.flat(1).outside(x, y).any()

    def flat(self, times: int) -> Deadband:
        """A deadband of so many slacks everywhere, without Weber's part."""
        width = min(self.slack * times, FLOOR_LIMIT)
        return replace(self.band, kn=0, kd=1, floor=(width,) * len(self.band.zero))

    def wider(self, times: int) -> Deadband:
        """The band with a floor so many times as wide."""
        floor = tuple(min(floor * times, FLOOR_LIMIT) for floor in self.band.floor)
        return replace(self.band, floor=floor)

    @property
    def step(self) -> int:
        """Counts per level, so that half a step is the slack: for a vector of n axes, whose errors
        add up in squares, over the root of n."""
        return min(max(isqrt(4 * self.slack**2 // len(self.band.zero)), 1), STEP_LIMIT)


def bound_of(source: Source, settings: Settings) -> Bound:
    """The deadband that the settings ask for, in counts of this source."""
    calibrations = [c.calibration for c in source.channels if c.calibration]
    extents = source.extents
    floors = [
        counts_of(settings.floor, calibration, extent)
        for calibration, extent in zip(calibrations, extents, strict=True)
    ]
    # The axes of a vector share one floor: relative to a range, that of the longest axis.
    floor, k = max(floors), settings.k
    if settings.preset in WITHIN:
        floor, k = for_the_source(source.channels, floor, k)
    whole = min(int(floor), FLOOR_LIMIT)
    ratio = at_most(k)
    band = Deadband(
        ratio.numerator,
        ratio.denominator,
        (max(whole, 1),) * len(calibrations),
        tuple(clamp(c.zero, -ZERO_LIMIT, ZERO_LIMIT - 1) for c in calibrations),
        len(calibrations) > 1,
    )
    return Bound(band, whole)


def for_the_source(
    channels: Sequence[Channel], floor: Fraction, k: Fraction
) -> tuple[Fraction, Fraction]:
    """Floor in counts, and Weber fraction, that keep the source itself within its deadband.

    A source that was put on a lattice is up to d counts away from its count, and the count of the
    physical 0 may be half a count from it: m = (1 + k) d + k / 2 is the room that takes. Below the
    floor F, F - m leaves it. Weber's part counts from G, the larger of F and one count, on, G / k
    counts from 0: there k' = k (G - m) / G leaves it.
    """
    moved = max(
        (
            Fraction(c.deviation.largest) / abs(c.calibration.step)
            for c in channels
            if c.deviation and c.calibration
        ),
        default=Fraction(0),
    )
    beside = any(c.calibration.b % c.calibration.a for c in channels if c.calibration)
    margin = (1 + k) * moved * MARGIN + (k / 2 if beside else 0)
    if not margin:
        return floor, k
    largest = max(floor, Fraction(1))
    return max(floor - margin, Fraction(0)), k * max(largest - margin, Fraction(0)) / largest


def at_most(k: Fraction) -> Fraction:
    """k as a fraction of 16-bit terms, never larger; one of 14 bits, which is shorter in a file,
    where that costs at most a SHORTER-th."""
    shorter = k.limit_denominator(SHORT - 1)
    if shorter != k:
        shorter = (k * (1 - Fraction(1, SHORTER))).limit_denominator(SHORT - 1)
    if shorter <= k <= shorter * (1 + Fraction(2, SHORTER)) and shorter.numerator < SHORT:
        return shorter
    largest = FRACTION_LIMIT - 1
    ratio = k.limit_denominator(largest)
    if ratio <= k and ratio.numerator <= largest:
        return ratio
    return Fraction(int(k * largest), largest) if k < 1 else Fraction(largest, ceil(largest / k))


def contract_of(band: Deadband, x: NDArray[np.int64], y: NDArray[np.int64]) -> Contract:
    """The contract, called guaranteed where every sample was found to keep it."""
    kept = not band.outside(x, y).any()
    return Contract(band.kn, band.kd, band.vector, kept, band.floor, band.zero)


def decode_all(coded: Coded, components: int) -> NDArray[np.int64]:
    """What the decoder makes of the packets: counts [ticks, components]."""
    decoder = TrackDecoder(coded.track, ENCODE_LEVEL)
    parts = [decoder.decode(packet).astype(np.int64) for packet in coded.packets]
    return np.concatenate([np.zeros((0, components), np.int64), *parts])


def code_knots(
    source: Source, slow: NDArray[np.int64], band: Deadband, settings: Settings, track: Track
) -> Coded:
    """Knots of ``slow`` [ticks, components]: the paper's rule, samples joined by lines."""
    hold = settings.interpolation == "hold"
    quantum = whole_counts(Fraction(min(band.floor), QUANTUM_SHARE), STEP_LIMIT)
    pieces = []
    for span, rows in source.pieces(slow):
        ticks = select_knots(rows, band, keep_last=not hold)
        pieces.append((span, ticks, knot_values(rows, ticks, quantum)))
    pack = plain_knots if settings.preset == "paper" else smaller_knots
    return pack(track, settings.interpolation, quantum, pieces)


def code_steps(source: Source, bound: Bound, track: Track, pack: Packing = smaller_knots) -> Coded:
    """The source itself, held, each sample within the slack of its knot."""
    pieces = []
    for span, rows in source.pieces(source.counts):
        if bound.slack:
            ticks = select_knots(rows, bound.flat(1), reference="sample", keep_last=False)
        else:
            changed = (np.diff(rows, axis=0) != 0).any(axis=1)
            ticks = np.concatenate(([0], np.flatnonzero(changed) + 1))
        pieces.append((span, ticks, rows[ticks]))
    return pack(track, "hold", 1, pieces)


def code_residual(source: Source, residual: NDArray[np.int64], step: int, track: Track) -> Coded:
    """QUAN packets of ``residual`` [ticks, components]."""
    levels = [(span, quantise(rows, step)) for span, rows in source.pieces(residual)]
    parameters = choose_codebook([piece for _, piece in levels], step)
    coded = Coded(replace(track, codec="QUAN", parameters=parameters.build()))
    for span, piece in levels:
        data = encode_quantised(piece, parameters)
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return coded


def residual_step(
    source: Source, residual: NDArray[np.int64], bound: Bound, settings: Settings
) -> int | None:
    """Counts per level; None: no HF track.

    Explicit, or from the residual's range (the paper: 2**b - 1 levels), or as the floor allows.
    """
    if settings.step is not None:
        calibration = source.channels[0].calibration
        assert calibration is not None
        extent = max(source.extents)
        return whole_counts(counts_of(settings.step, calibration, extent), STEP_LIMIT)
    if settings.bits is not None:
        if settings.bits == 0:
            return None
        largest = int(np.abs(residual).max(initial=0))
        return min(max(-(-largest // ((1 << (settings.bits - 1)) - 1)), 1), STEP_LIMIT)
    return bound.step


def slow_part(source: Source, settings: Settings) -> NDArray[np.int64]:
    """The low-passed counts, segment by segment: a gap is no signal, nor is a glitch; the paper
    knows of none."""
    counts = source.counts if settings.preset == "paper" else source.calm
    out = np.zeros(source.counts.shape, np.int64)
    for rows in source.segments():
        x = counts[rows].astype(np.float64)
        slow = low_pass(x, float(source.rate), settings.cutoff_hz)
        out[rows] = np.floor(slow + 0.5).astype(np.int64)
    return out


def encode_counts(source: Source, first_channel: int, settings: Settings) -> Unit:
    """Slow part as knots, fast part as quantised residual; or what is smaller at the same bound."""
    x = source.counts
    low, high = declared_range(x)
    if not all(c.calibration.covers(low, high) for c in source.channels if c.calibration):
        low, high = int(x.min(initial=0)), int(x.max(initial=0))
        if not all(c.calibration.covers(low, high) for c in source.channels if c.calibration):
            raise ParameterError("count * A or count * A + B is above 2^53: use a smaller A and D")
    base = make_track(
        source, first_channel, kind="full", codec="KNOT", count_min=low, count_max=high
    )
    if not len(x) or (x == x[0]).all():
        return encode_constant(source, base)
    if settings.preset in WITHIN:
        from .indexed import encode_within

        return encode_within(source, base, settings)
    bound = bound_of(source, settings)
    chosen_by_size = settings.preset == "default" and settings.step is None and not settings.bits
    if chosen_by_size and (unit := encode_level(source, bound, base)):
        return unit
    low, high = held_range(x)
    base = replace(base, count_min=low, count_max=high)
    slow = slow_part(source, settings)
    lf = code_knots(source, slow, bound.band, settings, base)
    d = decode_all(lf, x.shape[1])
    step = residual_step(source, x - d, bound, settings)
    if step is None or (chosen_by_size and bound.holds(x, d)):
        reason = "no residual asked for" if step is None else "no texture above the floor"
        lf.track = replace(lf.track, contract=contract_of(bound.band, x, d))
        return Unit(lf, None, "knots", reason)
    unit = with_residual(source, lf, x - d, step, bound)
    if unit is None:
        return encode_raw_counts(source, base, "the residual is too wide for a track of its own")
    if chosen_by_size:
        return smallest(source, slow, unit, step, bound, settings, base)
    return unit


def smallest(
    source: Source,
    slow: NDArray[np.int64],
    unit: Unit,
    step: int,
    bound: Bound,
    settings: Settings,
    base: Track,
) -> Unit:
    """The smallest of what keeps every sample within the slack."""
    x = source.counts
    for times in COARSER:
        # With the residual at hand the knots may be coarser: the sum stays where it is.
        lf = code_knots(source, slow, bound.wider(times), settings, base)
        coarse = with_residual(source, lf, x - decode_all(lf, x.shape[1]), step, bound)
        if coarse is None or coarse.size >= unit.size:
            break
        unit = coarse
    # Compared as varints: a slow part and a texture of their own are worth the bytes that coded
    # steps would save (1 to 37 %, measured); who wants those has preset deadband.
    if code_steps(source, bound, base, plain_knots).size < unit.size:
        held = code_steps(source, bound, base)
        contract = contract_of(bound.band, x, decode_all(held, x.shape[1]))
        held.track = replace(held.track, contract=contract)
        return Unit(held, None, "knots", "held steps within the floor are smaller")
    return unit


def with_residual(
    source: Source,
    lf: Coded,
    residual: NDArray[np.int64],
    step: int,
    bound: Bound,
) -> Unit | None:
    """The LF track with its HF track; None where the residual has too many bits."""
    levels = quantise(residual, step) * step
    low, high = declared_range(levels)
    widest = 1 << (ENCODE_LEVEL.residual_bits - 1)
    largest_a = max(abs(c.calibration.a) for c in source.channels if c.calibration)
    if low < -widest or high >= widest or max(-low, high) * largest_a > EXACT_LIMIT:
        return None
    lf.track = replace(lf.track, kind="lf")
    track = replace(
        lf.track,
        kind="hf",
        count_min=low,
        count_max=high,
        base=0,
        components=(Component(),) * len(source.channels),
    )
    hf = code_residual(source, residual, step, track)
    e = decode_all(hf, len(source.channels))
    y = np.clip(source.counts - residual + e, lf.track.count_min, lf.track.count_max)
    hf.track = replace(hf.track, contract=contract_of(bound.band, source.counts, y))
    return Unit(lf, hf, "knots + quantised", f"step {step} counts")


def encode_constant(source: Source, base: Track) -> Unit:
    coded = Coded(replace(base, parameters=KnotParameters("hold").build()))
    for span, rows in source.pieces(source.counts):
        data = build_knots(np.zeros(1, np.int64), rows[:1])
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return Unit(coded, None, "knots", "constant" if source.spans else "no samples", exact=True)


def encode_level(source: Source, bound: Bound, base: Track) -> Unit | None:
    """One value for all samples, where the floor allows it."""
    x = source.counts
    level = (x.min(axis=0).astype(np.int64) + x.max(axis=0)) // 2
    y = np.broadcast_to(level, x.shape)
    if not bound.slack or not bound.holds(x, y):
        return None
    pieces = [(span, np.zeros(1, np.int64), level[None]) for span, _ in source.pieces(x)]
    coded = plain_knots(base, "hold", 1, pieces)
    coded.track = replace(coded.track, contract=contract_of(bound.band, x, y))
    return Unit(coded, None, "knots", "silent: one value is within the floor of all")


def encode_raw_counts(source: Source, base: Track, reason: str) -> Unit:
    """RAWB with as few bytes a count as the declared range needs."""
    bits = max(base.count_max.bit_length(), (-base.count_min - 1).bit_length()) + 1
    size = -(-bits // 8)
    coded = Coded(replace(base, codec="RAWB", parameters=RawParameters(size).build()))
    for span, rows in source.pieces(source.counts):
        coded.packets.append(Packet(0, span.start, span.ticks, encode_raw(rows, size)))
    return Unit(coded, None, "raw", reason, exact=True)
