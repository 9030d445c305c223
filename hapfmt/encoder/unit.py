"""One unit, a channel or the axes of one vector: counts -> tracks and packets.

The encoder decodes its own LF packets and takes the residual against the result (SPEC WRT-003). So
encoder and decoder cannot drift apart.

A QUAN track gets the smallest alphabet and codebook that hold all its levels. The file also decodes
an encoder's packets and compares them with the recorded samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import ceil, inf, isqrt, nextafter

import numpy as np
from numpy.typing import NDArray

from ..codecs.knots import KnotParameters, build_knots
from ..codecs.quantised import (
    ESCAPE_LIMIT,
    RUN_LIMIT,
    SYMBOL_LIMIT,
    Alphabet,
    QuanParameters,
    bit_length,
    code_lengths,
    encode_quantised,
    quantise,
)
from ..codecs.raw import RawParameters, encode_raw
from ..deadband import Deadband
from ..errors import ParameterError
from ..format.cluster import Packet
from ..format.track import Component, Contract, Track
from ..limits import EXACT_LIMIT, FRACTION_LIMIT, LEVELS, ZERO_LIMIT
from ..numbers import clamp
from ..reading.decoder import TrackDecoder
from ..recording import Calibration, Channel, Deviation
from ..split import low_pass
from .knots import Coded, Packing, knot_values, plain_knots, select_knots, smaller_knots
from .plan import Promise
from .predict import logs
from .settings import PAPER_BITS, Settings, counts_of, whole_counts
from .source import InputBlock, declared_range, held_range, make_track

NONE = np.zeros(0, np.int64)
WIDE = 4
"""Levels are sorted, not counted in a table, if their range exceeds this many times their
number."""

DIRECT_LEVELS = (0, 1, 2, 3, 5, 7, 11, 15, 23, 31, 47, 63, 127, 255, 511, 1023)
"""Values of M that are tried: values between them change the size by less than 0.3 %."""


def choose_codebook(pieces: list[NDArray[np.int64]], step: int) -> QuanParameters:
    """One table for all packets of a track: ``pieces`` are the levels [ticks, components] of each.

    Estimates several numbers M of direct levels, and takes the one with the fewest bits, table
    included.
    """
    columns = [piece.T.reshape(-1) for piece in pieces]
    runs = zero_runs(columns)
    run_classes = min(max(int(runs.max(initial=0)).bit_length() - 1, 0), RUN_LIMIT)
    levels, counts = histogram(np.concatenate([NONE, *columns]))
    levels, counts = levels[levels != 0], counts[levels != 0]
    singles, run_counts = run_symbols(runs, run_classes)
    largest = int(np.abs(levels).max(initial=0))
    best: tuple[int, Alphabet, NDArray[np.int64]] | None = None
    for direct in (*(m for m in DIRECT_LEVELS if m < largest), largest):
        escape_classes = max(largest - direct, 0).bit_length()
        alphabet = Alphabet(direct, run_classes, escape_classes)
        if escape_classes > ESCAPE_LIMIT or alphabet.size > SYMBOL_LIMIT:
            continue
        frequencies = np.zeros(alphabet.size, np.int64)
        np.add.at(frequencies, alphabet.level_symbols(levels)[0], counts)
        frequencies[0] += singles
        frequencies[alphabet.first_run : alphabet.first_escape] += run_counts
        total = about_bits(frequencies) + 256 * int((frequencies * alphabet.extra_bits).sum())
        if best is None or total < best[0]:
            best = total, alphabet, frequencies
        elif total > best[0] + best[0] // 8:
            break
    assert best is not None
    _, alphabet, frequencies = best
    if not frequencies.any():
        frequencies[0] = 1
    return QuanParameters(step, alphabet, code_lengths(frequencies))


def about_bits(frequencies: NDArray[np.int64]) -> int:
    """256 times the bits of the symbols, and of half a byte for each in the codebook."""
    some = frequencies[frequencies > 0]
    return int((some * (logs(some.sum(keepdims=True)) - logs(some))).sum()) + 1024 * some.size


def histogram(levels: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The levels that occur, sorted, and how often."""
    low, high = int(levels.min(initial=0)), int(levels.max(initial=0))
    if high - low > WIDE * levels.size:
        found, counts = np.unique(levels, return_counts=True)
        return found, counts.astype(np.int64)
    counts = np.bincount(levels - low, minlength=1).astype(np.int64)
    present = np.flatnonzero(counts)
    return present + low, counts[present]


def zero_runs(columns: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Lengths of all runs of level 0; a run ends with its packet."""
    fence = np.ones(1, np.int64)
    joined = np.concatenate([fence, *(part for column in columns for part in (column, fence))])
    edges = np.flatnonzero(np.diff((joined == 0).astype(np.int8)))
    return edges[1::2] - edges[::2]


def run_symbols(runs: NDArray[np.int64], classes: int) -> tuple[int, NDArray[np.int64]]:
    """How many single zeros, and how many symbols of each run class, Alphabet.tokenise makes."""
    longest = (2 << classes) - 1
    whole, rest = runs // longest, runs % longest
    by_class = np.bincount(bit_length(rest[rest > 0]) - 1, minlength=classes + 1)
    by_class[classes] += whole.sum()
    return int(by_class[0]), by_class[1:]


KEPT = 1 << 20
"""Decoded counts that a unit keeps at most."""

ENCODE_LEVEL = LEVELS[2]
"""The bounds for any track, before the file's level is decided."""

STEP_SHARE = 4
"""Knot values are multiples of a quarter of the floor, so at most an eighth of the floor away."""

FINER_BITS, FINER = 8, 32
"""From FINER_BITS bits on, the paper's step is at least FINER counts: a step of 1.5 counts would be
rounded up to 2, and lose 2.5 dB."""

STEP_LIMIT = LEVELS[1].step
"""Steps that every level allows; larger tolerances are seldom asked for, and held steps keep
them."""

FLOOR_LIMIT = (1 << 31) - 1
COUNT_LIMIT = 1 << 31

SHORT, SHORTER = 1 << 14, 10_000
"""Terms of a Weber fraction that a varint of two bytes holds; and what that may cost."""

MARGIN = Fraction(101, 100)
"""Safety factor: the range is measured on rounded counts too, so each end may be off by one
deviation. With a floor of at most a 200th of the range that is 1 % of the deviation."""


ROW, CONTRACT, DEVIATION, DESCRIPTION = 12, 20, 24, 80
"""Bytes in a file, besides the packets: a packet's row, an error bound, the deviation of a grid, a
track of its own."""


@dataclass
class Unit:
    """The tracks that one unit became, and why."""

    base: Coded
    residual: Coded | None = None
    chosen: str = ""
    reason: str = ""
    exact: bool = False
    """Whether it was stored without loss, and needs no contract (SPEC DBC-004)."""

    parts: tuple[tuple[str, int], ...] = ()
    """Reason and bytes of each channel, where they are no vector."""

    channels: tuple[Channel, ...] = ()
    """As they were coded, where that is not as they were prepared."""

    reached: dict[str, float] = field(default_factory=dict)
    """The quality of the texture as decoded, as a decision has it: snr_hf_db, level_db ..."""

    missed: str = ""
    """Why the texture does not have the quality that was asked for; empty: it has."""

    grid: str = ""
    """One line on the grid of ``channels``."""

    least: float = 0.0
    """A lower estimate of the bits of the channels without loss; 0: not known."""

    instead: bool = False
    """Whether it takes the place of a lossy form that is larger."""

    @property
    def size(self) -> int:
        return self.base.size + (self.residual.size if self.residual else 0)

    @property
    def cost(self) -> int:
        """Bytes in a file, about: with the rows of the packets, and the contract."""
        packets = len(self.base.packets) + (len(self.residual.packets) if self.residual else 0)
        deviation = DEVIATION * any(c.deviation for c in self.channels)
        described = DESCRIPTION * (self.residual is not None)
        return self.size + ROW * packets + CONTRACT * (not self.exact) + deviation + described


@dataclass(frozen=True)
class Bound:
    """How far the reconstruction may lie from the source.

    ``band`` is the contract; its floor is at least one count. ``slack`` is the error in counts that
    the floor allows whatever the force, 0 where the floor is finer than one count.
    """

    band: Deadband
    slack: int

    @property
    def step(self) -> int:
        """Counts per level, so that half a step is the slack: for a vector of n axes, whose errors
        add up in squares, over the root of n."""
        return min(max(isqrt(4 * self.slack**2 // len(self.band.zero)), 1), STEP_LIMIT)

    def flat(self, times: int) -> Deadband:
        """A deadband of ``times`` slacks everywhere, without Weber's part."""
        width = min(self.slack * times, FLOOR_LIMIT)
        return replace(self.band, kn=0, kd=1, floor=(width,) * len(self.band.zero))


def bound_of(source: InputBlock, promise: Promise) -> Bound:
    """The deadband of the promise, in counts of this source."""
    assert promise.floor is not None
    calibrations = [c.calibration for c in source.channels if c.calibration]
    extents = source.extents
    floors = [
        counts_of(promise.floor, calibration, extent, channel.unit)
        for channel, calibration, extent in zip(source.channels, calibrations, extents, strict=True)
    ]
    # The axes of a vector share one floor: relative to a range, that of the longest axis.
    floor, k = max(floors), promise.k
    if not promise.paper:
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

    A source that was put on a grid is up to d counts away from its count. The count of the physical
    0 may be half a count from it. That takes the room m = (1 + k) d + k / 2. Below the floor F, F -
    m is left. Weber's part starts at G, the larger of F and one count, at G / k counts from 0:
    there k' = k (G - m) / G is left.
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
    found = np.concatenate([np.zeros((0, components), np.int64), *parts])
    coded.decoded = found if found.size <= KEPT else None
    return found


def code_knots(
    source: InputBlock, slow: NDArray[np.int64], band: Deadband, settings: Settings, track: Track
) -> Coded:
    """Knots of ``slow`` [ticks, components]: the paper's rule, samples joined by lines."""
    hold = settings.interpolation == "hold"
    step = whole_counts(Fraction(min(band.floor), STEP_SHARE), STEP_LIMIT)
    pieces = []
    for span, rows in source.pieces(slow):
        ticks = select_knots(rows, band, keep_last=not hold)
        pieces.append((span, ticks, knot_values(rows, ticks, step)))
    return plain_knots(track, settings.interpolation, step, pieces)


def code_steps(
    source: InputBlock, bound: Bound, track: Track, pack: Packing = smaller_knots
) -> Coded:
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


def code_residual(
    source: InputBlock, residual: NDArray[np.int64], step: int, track: Track
) -> Coded:
    """QUAN packets of ``residual`` [ticks, components]."""
    levels = [(span, quantise(rows, step)) for span, rows in source.pieces(residual)]
    parameters = choose_codebook([piece for _, piece in levels], step)
    coded = Coded(replace(track, codec="QUAN", parameters=parameters.build()))
    for span, piece in levels:
        data = encode_quantised(piece, parameters)
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return coded


def residual_step(
    source: InputBlock, residual: NDArray[np.int64], settings: Settings
) -> int | None:
    """Counts per level; None: no HF track.

    Explicit, or from the residual's range (the paper: 2**b - 1 levels).
    """
    if settings.step is not None:
        channel = source.channels[0]
        assert channel.calibration is not None
        extent = max(source.extents)
        given = counts_of(settings.step, channel.calibration, extent, channel.unit)
        return whole_counts(given, STEP_LIMIT)
    bits = PAPER_BITS if settings.bits is None else settings.bits
    if not bits:
        return None
    largest = int(np.abs(residual).max(initial=0))
    return min(max(-(-largest // ((1 << (bits - 1)) - 1)), 1), STEP_LIMIT)


def slow_part(source: InputBlock, settings: Settings) -> NDArray[np.float64]:
    """The low-passed counts, segment by segment: a gap holds no signal."""
    out = np.zeros(source.counts.shape)
    for rows in source.segments():
        x = source.counts[rows].astype(np.float64)
        out[rows] = low_pass(x, float(source.rate), settings.cutoff_hz)
    return out


def whole(slow: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.floor(slow + 0.5).astype(np.int64)


def whole_range(source: InputBlock, first_channel: int) -> Track:
    """The description of a track that holds the counts of the source."""
    x = source.counts
    low, high = declared_range(x)
    if not covered(source, low, high):
        low, high = int(x.min(initial=0)), int(x.max(initial=0))
        if not covered(source, low, high):
            raise ParameterError("count * A or count * A + B is above 2^53: use a smaller A and D")
    return make_track(source.channels, first_channel, codec="KNOT", count_min=low, count_max=high)


def covered(source: InputBlock, low: int, high: int) -> bool:
    return all(c.calibration.covers(low, high) for c in source.channels if c.calibration)


def is_constant(source: InputBlock) -> bool:
    x = source.counts
    return not len(x) or bool((x == x[0]).all())


def encode_paper(
    source: InputBlock, first_channel: int, promise: Promise, settings: Settings
) -> Unit:
    """Slow part as knots, fast part as quantised residual."""
    slow = slow_part(source, settings)
    source, times = finer(source, whole(slow), settings)
    x = source.counts
    base = whole_range(source, first_channel)
    bound = bound_of(source, promise)
    low, high = held_range(x)
    # The calibration may not reach further than the base says.
    low, high = max(low, base.count_min), min(high, base.count_max)
    base = replace(base, count_min=low, count_max=high)
    lf = code_knots(source, whole(slow * times), bound.band, settings, base)
    d = decode_all(lf, x.shape[1])
    step = residual_step(source, x - d, settings)
    if step is None:
        lf.track = replace(lf.track, contract=contract_of(bound.band, x, d))
        return Unit(lf, None, "knots", "no residual asked for", channels=source.channels)
    unit = with_residual(source, lf, x - d, step, bound)
    if unit is None:
        unit = encode_raw_counts(source, base, "the residual is too wide for a track of its own")
    unit.channels = source.channels
    return unit


def finer(
    source: InputBlock, slow: NDArray[np.int64], settings: Settings
) -> tuple[InputBlock, int]:
    """The same values in finer counts, and how much finer, where the paper's step would be few."""
    bits = PAPER_BITS if settings.bits is None else settings.bits
    if settings.step is not None or bits < FINER_BITS:
        return source, 1
    largest = int(np.abs(source.counts - slow).max(initial=0))
    times = -(-FINER * ((1 << (bits - 1)) - 1) // max(largest, 1))
    while times > 1:
        reach = int(np.abs(source.counts.astype(np.int64)).max(initial=0)) * times
        try:
            channels = tuple(in_finer_counts(channel, times) for channel in source.channels)
        except ParameterError:
            times //= 2
            continue
        low, high = declared_range(np.array([-reach, reach]))
        if reach < COUNT_LIMIT and all(
            c.calibration.covers(low, high) for c in channels if c.calibration
        ):
            counts = source.counts.astype(np.int64) * times
            return InputBlock(channels, counts, source.spans), times
        times //= 2
    return source, 1


def in_finer_counts(channel: Channel, times: int) -> Channel:
    calibration = channel.calibration
    assert calibration is not None
    finer = Calibration(calibration.a, calibration.b * times, calibration.d * times)
    return replace(channel, stored=channel.stored.astype(np.int64) * times, calibration=finer)


def in_coarser_counts(channel: Channel, times: int) -> Channel:
    """The channel in counts ``times`` as wide, with what that moves as its deviation."""
    calibration = channel.calibration
    assert calibration is not None
    given = channel.stored.astype(np.int64)
    counts = (given + times // 2) // times
    moved = float(int(np.abs(given - counts * times).max(initial=0)) * abs(calibration.step))
    before = channel.deviation or Deviation(0.0, 0.0)
    largest = nextafter(moved + before.largest, inf) if moved else before.largest
    return replace(
        channel, stored=counts, calibration=replace(calibration, a=calibration.a * times),
        deviation=Deviation(max(before.declared, largest), largest),
    )  # fmt: skip


def with_residual(
    source: InputBlock,
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


def encode_constant(source: InputBlock, base: Track) -> Unit:
    coded = Coded(replace(base, parameters=KnotParameters("hold").build()))
    for span, rows in source.pieces(source.counts):
        data = build_knots(np.zeros(1, np.int64), rows[:1])
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return Unit(coded, None, "knots", "constant" if source.spans else "no samples", exact=True)


def encode_raw_counts(source: InputBlock, base: Track, reason: str) -> Unit:
    """RAWB with as few bytes a count as the declared range needs."""
    bits = max(base.count_max.bit_length(), (-base.count_min - 1).bit_length()) + 1
    size = -(-bits // 8)
    coded = Coded(replace(base, codec="RAWB", parameters=RawParameters(size).build()))
    for span, rows in source.pieces(source.counts):
        coded.packets.append(Packet(0, span.start, span.ticks, encode_raw(rows, size)))
    return Unit(coded, None, "raw", reason, exact=True)


def decoded_pieces(unit: Unit) -> Iterator[NDArray[np.int64]]:
    """Packet by packet the counts [ticks, components] of the full band."""
    base = TrackDecoder(unit.base.track, ENCODE_LEVEL)
    low, high = unit.base.track.count_min, unit.base.track.count_max
    if unit.residual is None:
        if unit.base.decoded is not None:
            yield unit.base.decoded
            return
        for packet in unit.base.packets:
            yield base.decode(packet).astype(np.int64)
        return
    residual = TrackDecoder(unit.residual.track, ENCODE_LEVEL)
    for slow, fast in zip(unit.base.packets, unit.residual.packets, strict=True):
        counts = base.decode(slow).astype(np.int64) + residual.decode(fast)
        yield np.clip(counts, low, high)


def largest_errors(
    unit: Unit, members: Sequence[Channel], originals: Sequence[Channel]
) -> list[float]:
    """The largest error of a decoded sample in each channel, in the channel's unit.

    Raises AssertionError where a guaranteed contract is broken."""
    if unit.exact:
        # Counts that came as counts came back; of others the grid is all that was lost.
        return [
            0.0 if original.is_counts or member.deviation is None else member.deviation.largest
            for member, original in zip(members, originals, strict=True)
        ]
    calibrations = [
        Calibration(c.calibration.a, c.calibration.b, c.calibration.d)
        for c in unit.base.track.components
    ]
    contract, band = (unit.residual or unit.base).track.contract, None
    if contract and contract.guaranteed:
        band = Deadband(contract.kn, contract.kd, contract.floor, contract.zero, contract.vector)
    errors = [0.0] * len(members)
    at = 0
    for piece in decoded_pieces(unit):
        rows = slice(at, at + len(piece))
        at += len(piece)
        if band is not None:
            counts = np.column_stack([channel.stored[rows] for channel in members])
            if band.outside(counts.astype(np.int64), piece).any():
                raise AssertionError("an encoder that guarantees a bound left it")
        for place, (original, calibration) in enumerate(zip(originals, calibrations, strict=True)):
            away = np.abs(recorded(original, rows) - calibration.physical(piece[:, place]))
            errors[place] = max(errors[place], float(away.max(initial=0.0)))
    return errors


def recorded(channel: Channel, rows: slice) -> NDArray[np.float64]:
    """Some samples of a channel in its unit."""
    if channel.calibration is not None:
        return channel.calibration.physical(channel.stored[rows])
    return np.asarray(channel.stored[rows], np.float64)
