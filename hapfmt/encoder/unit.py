"""One unit, a channel or the axes of one vector: counts -> tracks and packets.

The encoder is a client of the decoder: the residual is taken against what the decoder makes of the
LF packets (SPEC WRT-003), so the two cannot drift apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import ceil, isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.knots import KnotParameters, build_knots
from ..codecs.quantised import encode_quantised, quantise
from ..codecs.raw import RawParameters, encode_raw
from ..container.cluster import Packet
from ..container.track import Affine, Component, Contract, Track
from ..deadband import Deadband
from ..decoder import TrackDecoder
from ..limits import LEVELS
from ..recording import Channel, Span
from .codebook import choose_codebook
from .knots import knot_values, select_knots
from .settings import Settings, counts_of, whole_counts
from .split import low_pass

PACKET_SAMPLES = 1 << 16
"""Longer packets are cut: eight bytes each then still fit a payload of level 1."""

ENCODE_LEVEL = LEVELS[2]
"""The bounds that hold for any track while the file's level is not decided yet."""

QUANTUM_SHARE = 4
"""Knot values are multiples of a quarter of the floor: an eighth of the floor away at most."""

COARSER = (4, 16)
"""Floors of the knots that are tried in place of the deadband's own: noise near zero, which no
knot should follow, costs up to 8 bits a sample there."""

STEP_LIMIT = 1 << 24
"""As the level allows (SPEC clause 15, level 1)."""


@dataclass
class Coded:
    """One track, its id still open, and its packets."""

    track: Track
    packets: list[Packet] = field(default_factory=list)

    @property
    def size(self) -> int:
        return len(self.track.parameters) + sum(len(packet.data) for packet in self.packets)


@dataclass
class Unit:
    """The tracks that one unit became, and why."""

    base: Coded
    residual: Coded | None = None
    chosen: str = ""
    reason: str = ""

    @property
    def size(self) -> int:
        return self.base.size + (self.residual.size if self.residual else 0)


@dataclass(frozen=True)
class Source:
    """Channels of one unit side by side: counts [ticks, components], and the spans they are for."""

    channels: tuple[Channel, ...]
    counts: NDArray[np.int64]
    spans: tuple[Span, ...]
    """Coverage, cut into packets."""

    @property
    def rate(self) -> Fraction:
        return self.channels[0].rate

    def pieces(self) -> list[tuple[Span, NDArray[np.int64]]]:
        at = 0
        out = []
        for span in self.spans:
            out.append((span, self.counts[at : at + span.ticks]))
            at += span.ticks
        return out

    def segments(self) -> list[slice]:
        """Rows of ``counts`` that no gap interrupts."""
        out, at = [], 0
        for span in self.channels[0].coverage:
            out.append(slice(at, at + span.ticks))
            at += span.ticks
        return out


def cut(coverage: Sequence[Span], rate: Fraction, cluster: Fraction, components: int) -> list[Span]:
    """Coverage cut where clusters begin, and where a packet would grow too long."""
    longest = max(PACKET_SAMPLES // components, 1)
    out = []
    for span in coverage:
        at = span.start
        while at < span.stop:
            number = at / rate // cluster + 1
            stop = min(span.stop, ceil(number * cluster * rate), at + longest)
            out.append(Span(at, stop))
            at = stop
    return out


def component_of(channel: Channel) -> Component:
    """A channel's description as it goes into the file."""
    calibration = channel.calibration
    affine = Affine(calibration.a, calibration.b, calibration.d) if calibration else Affine()
    return Component(
        affine,
        channel.label,
        channel.unit,
        channel.quantity,
        channel.axis,
        channel.group,
        channel.body_site,
        channel.device,
        (channel.deviation.declared, channel.deviation.largest) if channel.deviation else None,
    )


def declared_range(counts: NDArray[np.int64]) -> tuple[int, int]:
    """The smallest range of whole bits that holds all counts, without a sign where none occurs.

    Whole bits, so that channels of a kind share one description.
    """
    low, high = int(counts.min(initial=0)), int(counts.max(initial=0))
    if low >= 0:
        return 0, (1 << high.bit_length()) - 1
    bits = max((-low - 1).bit_length(), high.bit_length())
    return -(1 << bits), (1 << bits) - 1


def make_track(source: Source, first_channel: int, **given: Any) -> Track:
    return Track(
        id=0,
        rate=source.rate,
        first_channel=first_channel,
        components=tuple(component_of(channel) for channel in source.channels),
        **given,
    )


def deadband_of(source: Source, settings: Settings) -> Deadband:
    """The contract in counts; a floor finer than one count becomes one count."""
    vector = len(source.channels) > 1
    extent = [int(np.ptp(source.counts[:, i])) if len(source.counts) else 0
              for i in range(len(source.channels))]  # fmt: skip
    calibrations = [c.calibration for c in source.channels if c.calibration]
    floors = [
        whole_counts(counts_of(settings.floor, calibration, extent[i]), (1 << 31) - 1)
        for i, calibration in enumerate(calibrations)
    ]
    if vector:
        floors = [max(floors)] * len(floors)
    ratio = settings.weber.limit_denominator(65535)
    return Deadband(
        ratio.numerator,
        ratio.denominator,
        tuple(floors),
        tuple(min(max(c.zero, -(1 << 31)), (1 << 31) - 1) for c in calibrations),
        vector,
    )


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
    source: Source,
    slow: NDArray[np.int64],
    band: Deadband,
    settings: Settings,
    track: Track,
    *,
    exact: bool = False,
) -> Coded:
    """KNOT packets of ``slow`` [ticks, components]; ``exact``: held, each sample in the band."""
    hold = exact or settings.interpolation == "hold"
    quantum = 1 if exact else whole_counts(Fraction(min(band.floor), QUANTUM_SHARE), STEP_LIMIT)
    parameters = KnotParameters("hold" if hold else "linear", quantum)
    coded = Coded(replace(track, codec="KNOT", parameters=parameters.build()))
    at = 0
    for span in source.spans:
        rows = slow[at : at + span.ticks]
        ticks = select_knots(
            rows, band, reference="sample" if exact else "last", keep_last=not hold
        )
        values = knot_values(rows, ticks, quantum)
        coded.packets.append(Packet(0, span.start, span.ticks, build_knots(ticks, values)))
        at += span.ticks
    return coded


def code_residual(source: Source, residual: NDArray[np.int64], step: int, track: Track) -> Coded:
    """QUAN packets of ``residual`` [ticks, components]."""
    levels = []
    at = 0
    for span in source.spans:
        levels.append(quantise(residual[at : at + span.ticks], step))
        at += span.ticks
    parameters = choose_codebook(levels, step)
    coded = Coded(replace(track, codec="QUAN", parameters=parameters.build()))
    for span, piece in zip(source.spans, levels, strict=True):
        coded.packets.append(Packet(0, span.start, span.ticks, encode_quantised(piece, parameters)))
    return coded


def residual_step(
    source: Source, residual: NDArray[np.int64], band: Deadband, settings: Settings
) -> int | None:
    """Counts per level; None: no HF track.

    Default: twice the floor, so that half a step is the floor itself (for a vector of n axes, whose
    errors add up in squares, over the root of n). Paper: from the range, 2**b - 1 levels.
    """
    largest = int(np.abs(residual).max(initial=0))
    if settings.step is not None:
        calibration = source.channels[0].calibration
        assert calibration is not None
        extent = int(np.ptp(source.counts)) if source.counts.size else 0
        return whole_counts(counts_of(settings.step, calibration, extent), STEP_LIMIT)
    if settings.bits is not None:
        if settings.bits == 0:
            return None
        return min(max(-(-largest // ((1 << (settings.bits - 1)) - 1)), 1), STEP_LIMIT)
    step = isqrt(4 * min(band.floor) ** 2 // len(source.channels))
    # A floor below one count was asked for: only every count as it is keeps it.
    finest = min(
        counts_of(settings.floor, c.calibration, int(np.ptp(source.counts[:, i])))
        for i, c in enumerate(source.channels)
        if c.calibration
    ) if source.counts.size else Fraction(1)  # fmt: skip
    return min(step, STEP_LIMIT) if finest >= 1 and step >= 1 else 1


def slow_part(source: Source, settings: Settings) -> NDArray[np.int64]:
    """The low-passed counts, segment by segment: a gap is no signal."""
    out = np.zeros_like(source.counts)
    for rows in source.segments():
        x = source.counts[rows].astype(np.float64)
        slow = low_pass(x, float(source.rate), settings.cutoff_hz)
        out[rows] = np.floor(slow + 0.5).astype(np.int64)
    return out


def encode_counts(source: Source, first_channel: int, settings: Settings) -> Unit:
    """Slow part as knots, fast part as quantised residual; or what is smaller at the same bound."""
    x = source.counts
    components = len(source.channels)
    low, high = declared_range(x)
    if not all(c.calibration.covers(low, high) for c in source.channels if c.calibration):
        low, high = int(x.min(initial=0)), int(x.max(initial=0))
    base = make_track(
        source, first_channel, kind="full", codec="KNOT", count_min=low, count_max=high
    )
    if not len(x) or (x == x[0]).all():
        return encode_constant(source, base)
    band = deadband_of(source, settings)
    slow = slow_part(source, settings)
    lf = code_knots(source, slow, band, settings, base)
    d = decode_all(lf, components)
    step = residual_step(source, x - d, band, settings)
    plain = settings.preset == "default" and settings.step is None and settings.bits is None
    if step is None or (
        plain and not Deadband(0, 1, band.floor, band.zero, band.vector).outside(x, d).any()
    ):
        reason = "no residual asked for" if step is None else "no texture above the floor"
        lf.track = replace(lf.track, contract=contract_of(band, x, d))
        return Unit(lf, None, "knots", reason)
    unit = with_residual(source, lf, x - d, step, band, (low, high))
    if unit is None:
        return encode_raw_counts(source, base, "the residual does not fit 32 bits")
    if plain:
        # With the residual at hand the knots may be coarser: the sum stays where it is.
        for times in COARSER:
            wide = replace(band, floor=tuple(min(f * times, (1 << 31) - 1) for f in band.floor))
            lf = code_knots(source, slow, wide, settings, base)
            coarse = with_residual(
                source, lf, x - decode_all(lf, components), step, band, (low, high)
            )
            if coarse is None or coarse.size >= unit.size:
                break
            unit = coarse
        held = code_knots(source, x, Deadband(0, 1, band.floor, band.zero, band.vector), settings,
                          base, exact=True)  # fmt: skip
        if held.size < unit.size:
            contract = contract_of(band, x, decode_all(held, components))
            held.track = replace(held.track, contract=contract)
            return Unit(held, None, "knots", "held steps within the floor are smaller")
    return unit


def with_residual(
    source: Source,
    lf: Coded,
    residual: NDArray[np.int64],
    step: int,
    band: Deadband,
    declared: tuple[int, int],
) -> Unit | None:
    """The LF track with its HF track; None where the residual has too many bits."""
    levels = quantise(residual, step) * step
    low, high = declared_range(levels)
    bound = 1 << (ENCODE_LEVEL.residual_bits - 1)
    if low < -bound or high >= bound:
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
    y = np.clip(source.counts - residual + e, *declared)
    hf.track = replace(hf.track, contract=contract_of(band, source.counts, y))
    return Unit(lf, hf, "knots + quantised", f"step {step} counts")


def encode_constant(source: Source, base: Track) -> Unit:
    coded = Coded(replace(base, parameters=KnotParameters("hold").build()))
    for span, rows in source.pieces():
        data = build_knots(np.zeros(1, np.int64), rows[:1])
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return Unit(coded, None, "knots", "constant" if source.spans else "no samples")


def encode_raw_counts(source: Source, base: Track, reason: str) -> Unit:
    """RAWB with as few bytes a count as the declared range needs."""
    bits = max(base.count_max.bit_length(), (-base.count_min - 1).bit_length()) + 1
    size = -(-bits // 8)
    coded = Coded(replace(base, codec="RAWB", parameters=RawParameters(size).build()))
    for span, rows in source.pieces():
        coded.packets.append(Packet(0, span.start, span.ticks, encode_raw(rows, size)))
    return Unit(coded, None, "raw", reason)


def encode_words(
    channel: Channel, spans: Sequence[Span], first_channel: int, number_format: str, reason: str
) -> Unit:
    """RAWB words, bit for bit."""
    track = Track(
        id=0,
        kind="full",
        codec="RAWB",
        rate=channel.rate,
        first_channel=first_channel,
        components=(component_of(channel),),
        parameters=RawParameters(channel.values.dtype.itemsize).build(),
        number_format=number_format,
    )
    coded = Coded(track)
    at = 0
    for span in spans:
        rows = channel.values[at : at + span.ticks, None]
        coded.packets.append(
            Packet(0, span.start, span.ticks, encode_raw(rows, channel.values.dtype.itemsize))
        )
        at += span.ticks
    return Unit(coded, None, "raw", reason)
