"""The contents of a picture for each channel, collected in one pass over the recording.

- The knots of an LF track, if there are few of them.
- The signal: the smallest and the largest value of each column.
- The power spectral density, accumulated part by part by Welch's method: P. D. Welch, "The use of
  fast Fourier transform for the estimation of power spectra", IEEE Transactions on Audio and
  Electroacoustics 15, 1967, 10.1109/TAU.1967.1161901.
- The histogram of errors, accumulated part by part.
- The facts of the header: channels, rate, duration, size, preset, error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..codecs.knots import KnotParameters, decode_indices, parse_knots, parse_start
from ..encoder.settings import preset_of
from ..errors import FormatError, ParameterError
from ..format.cluster import Packet
from ..format.track import Track
from ..reading.catalogue import ChannelRef
from ..reading.damage import LostSpan
from ..reading.decoder import intersect
from ..reading.packets import tick_range
from ..reading.reader import Reader
from ..recording import Channel, refuse_past_end
from .parts import ChannelPart, Described, FileParts, Parts

SHOWN = 600
"""Dots of more knots would hide the line."""
PACKETS = 4096
"""More packets than this hold too many knots to show."""
CODED = 5000
"""A packet of as many coded knots is not decoded to show a few of them."""


def knots_within(
    reader: Reader, ref: ChannelRef, start: Fraction, stop: Fraction
) -> NDArray[np.int64] | None:
    """Ticks of the knots in [start, stop), ascending; None where they are too many to show, or the
    channel is not coded in knots, or exactly: its knots leave nothing out."""
    tracks = {
        part.track.id: part.track
        for part in ref.parts
        if part.track.codec == "KNOT" and part.contract is not None
    }
    if not tracks:
        return None
    ranges = {id_: tick_range(track.rate, start, stop) for id_, track in tracks.items()}
    before = reader.lost
    found: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    total = 0
    try:
        for number, packet in enumerate(reader.packets(ranges, start, stop)):
            first, last = ranges[packet.track]
            inside = first <= packet.start and packet.start + packet.span <= last
            most = SHOWN - total if inside else CODED
            ticks = ticks_of(packet, tracks[packet.track], reader, most)
            if ticks is None or number >= PACKETS:
                return None
            ticks = ticks[(ticks >= first) & (ticks < last)]
            total += ticks.size
            if total > SHOWN:
                return None
            found.append(ticks)
    finally:
        reader.lost = before
    return np.unique(np.concatenate(found))


def ticks_of(packet: Packet, track: Track, reader: Reader, most: int) -> NDArray[np.int64] | None:
    """None where a packet of coded knots has more than ``most``."""
    level, components = reader.catalogue.level, len(track.components)
    try:
        parameters = KnotParameters.parse(track.parameters, level, track.offset)
        if not parameters.coded:
            return parse_knots(packet.data, components, packet.offset)[0] + packet.start
        limit = parameters.grid.index_limit(level.count_bound)
        row = packet.data, packet.span, components, limit, packet.offset
        if parse_start(*row)[1] >= most:
            return None
        ticks, _ = decode_indices(row[0], parameters.interpolation, *row[1:])
    except FormatError:
        return np.zeros(0, np.int64)  # reading says what is wrong, or has said so
    return ticks + packet.start


LARGEST = 1e300
"""Larger values are drawn as this, so that margins do not overflow."""
COLUMNS = 2000
"""A page has about two columns for each pixel. Up to twice as many ticks are kept one by one."""


@dataclass
class Outline:
    """Ticks [first, stop) in columns of ``size`` ticks: least and most [columns] (NaN where there
    is nothing finite), and how many samples each holds."""

    first: int
    stop: int
    rate: Fraction
    size: int
    least: NDArray[np.float64]
    most: NDArray[np.float64]
    counts: NDArray[np.int64]

    @classmethod
    def over(cls, first: int, stop: int, rate: Fraction, limit: int = COLUMNS) -> Outline:
        ticks = max(stop - first, 0)
        size = 1 if ticks <= 2 * limit else -(-ticks // limit)
        columns = -(-ticks // size)
        empty = np.full(columns, np.nan)
        return cls(first, stop, rate, size, empty, empty.copy(), np.zeros(columns, np.int64))

    def add(self, start: int, values: NDArray[np.float64]) -> None:
        """Adds values [ticks] from tick ``start`` on; values outside the outline are ignored."""
        a, b = max(start, self.first), min(start + values.size, self.stop)
        if a >= b:
            return
        x = values[a - start : b - start]
        x = np.where(np.isfinite(x), np.clip(x, -LARGEST, LARGEST), np.nan)
        column, within = divmod(a - self.first, self.size)
        starts = np.append(0, np.arange(self.size - within, x.size, self.size))
        place = slice(column, column + starts.size)
        self.least[place] = np.fmin(self.least[place], np.fmin.reduceat(x, starts))
        self.most[place] = np.fmax(self.most[place], np.fmax.reduceat(x, starts))
        self.counts[place] += np.diff(starts, append=x.size)

    def add_channel(self, channel: Channel, values: NDArray[np.float64] | None = None) -> None:
        """All that a channel covers; values [samples]: these instead of its own."""
        x = channel.samples() if values is None else values
        place = 0
        for span in channel.coverage:
            self.add(span.start, x[place : place + span.ticks])
            place += span.ticks

    @property
    def is_whole(self) -> bool:
        """Whether every column is one tick."""
        return self.size == 1

    @property
    def sample_count(self) -> int:
        return int(self.counts.sum())

    def seconds(self) -> NDArray[np.float64]:
        """[columns] the middle of each column."""
        ticks = self.first + self.size * np.arange(self.counts.size, dtype=np.float64)
        return (ticks + (self.size - 1) / 2) / float(self.rate)

    def line(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A line that looks as all samples would; NaN breaks it where there are none."""
        if self.is_whole:
            return self.seconds(), self.most
        return np.repeat(self.seconds(), 2), np.stack([self.least, self.most], axis=1).ravel()

    def missing(self) -> NDArray[np.bool_]:
        """[columns] that lack a sample, between the first and the last that hold one."""
        full = np.full(self.counts.size, self.size, np.int64)
        if full.size:
            full[-1] = self.stop - self.first - self.size * (full.size - 1)
        known = np.flatnonzero(self.counts)
        found = self.counts < full
        if known.size:
            found[: known[0]] = found[known[-1] + 1 :] = False
            if not self.is_whole:
                # A column may hold the first or the last sample, and be full as far as it goes.
                found[known[0]] = found[known[-1]] = False
        else:
            found[:] = False
        return found

    def runs(self, columns: NDArray[np.bool_]) -> list[tuple[float, float]]:
        """Seconds of the runs of True in [columns]; ticks reach half a tick to either side."""
        edges = np.flatnonzero(np.diff(columns.astype(np.int8), prepend=0, append=0))
        seconds = (self.first + self.size * edges - 0.5) / float(self.rate)
        return list(zip(seconds[::2].tolist(), seconds[1::2].tolist(), strict=True))

    def columns_within(self, start: float, stop: float) -> slice:
        """Columns that the seconds [start, stop) touch."""
        places = [(s * float(self.rate) - self.first) / self.size for s in (start, stop)]
        low, high = (float(np.clip(p, 0, self.counts.size)) for p in places)
        return slice(int(low), int(np.ceil(high)))


SEGMENT_S = 2.0
"""Half a hertz between lines: the LF part below 20 Hz is resolved."""
SHORTEST, LONGEST = 16, 1 << 14
"""Samples of a segment."""
SAMPLES = 1 << 20
"""Samples per channel, spread over the recording; more do not improve the estimate."""


class Spectrum:
    """Spectrum of runs of [samples]: Hann window, half-overlapping segments without their means."""

    def __init__(self, rate_hz: float, sample_count: int) -> None:
        """sample_count: how many will come, about."""
        self.rate_hz = rate_hz
        size = 1 << max(round(np.log2(max(SEGMENT_S * rate_hz, 1))), 0)
        size = min(size, 1 << max(sample_count // 4, 1).bit_length() - 1)
        self.size = int(min(max(size, SHORTEST), LONGEST))
        self.share = min(1.0, SAMPLES / max(sample_count, 1))
        self.power: NDArray[np.float64] = np.zeros(self.size // 2 + 1)
        self.segments = 0

    def add(self, run: NDArray[np.float64]) -> None:
        """A run without a gap; one that is shorter than a segment says nothing."""
        take = max(self.size, int(run.size * self.share))
        x = run[:take]
        if x.size < self.size or not np.isfinite(x).all():
            return
        segments = np.lib.stride_tricks.sliding_window_view(x, self.size)[:: self.size // 2]
        window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(self.size) / self.size)
        with np.errstate(all="ignore"):
            lines = np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * window)
            power = (lines.real**2 + lines.imag**2).sum(axis=0)
            power[1:-1] *= 2  # negative frequencies
            self.power += power / (self.rate_hz * np.sum(window**2))
        self.segments += len(segments)

    def density(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Hertz [lines] above 0, and unit^2 / Hz [lines]; None where nothing was long enough."""
        if not self.segments:
            return None
        hertz = np.arange(1, self.power.size, dtype=np.float64) * (self.rate_hz / self.size)
        return hertz, self.power[1:] / self.segments


BINS = 3**7
"""Odd, so that a bin is centred on zero, and a power of three, so that three neighbours become one
where the range must grow."""


class Histogram:
    """counts [BINS]; bin i is centred on (i - BINS // 2) * width. Zeros are counted from the start,
    the width follows from the first value that is not zero, or is that of a count."""

    def __init__(self, width: float = 0.0) -> None:
        self.width = width
        self.counts = np.zeros(BINS, np.int64)
        self.largest = 0.0
        self.beyond = 0
        """Values that are not finite."""

    @property
    def total(self) -> int:
        return int(self.counts.sum())

    def add(self, errors: NDArray[np.float64]) -> None:
        """errors, any shape."""
        finite = np.clip(errors[np.isfinite(errors)], -LARGEST, LARGEST)
        self.beyond += int(errors.size - finite.size)
        largest = float(np.max(np.abs(finite), initial=0.0))
        self.largest = max(self.largest, largest)
        if largest == 0:
            self.counts[BINS // 2] += finite.size
            return
        if not self.width:
            self.width = max(largest / (BINS // 4), np.finfo(np.float64).tiny)
        while largest > self.width * (BINS // 2 - 1):
            self.widen()
        places = np.rint(finite / self.width).astype(np.int64) + BINS // 2
        self.counts += np.bincount(places.ravel(), minlength=BINS)

    def widen(self) -> None:
        third = self.counts.reshape(-1, 3).sum(axis=1)
        self.counts = np.zeros(BINS, np.int64)
        start = (BINS - third.size) // 2
        self.counts[start : start + third.size] = third
        self.width *= 3

    def bars(self, most: int = 81) -> tuple[NDArray[np.float64], NDArray[np.int64], float]:
        """Centres [bars], counts [bars], width: at most ``most`` bars that hold all."""
        counts, width = self.counts, self.width
        while True:
            found = np.flatnonzero(counts)
            middle = counts.size // 2
            reach = int(np.abs(found - middle).max(initial=0))
            if 2 * reach + 1 <= most or counts.size < 3:
                break
            counts, width = counts.reshape(-1, 3).sum(axis=1), width * 3
        centres = np.arange(-reach, reach + 1, dtype=np.float64) * width
        return centres, counts[middle - reach : middle + reach + 1], width


FEWEST = 5
"""Fewest columns of a part that is examined again: one column may hold a single peak."""


@dataclass
class Knots:
    """seconds and values [knots] of the LF track, in the channel's unit."""

    ticks: NDArray[np.int64]
    seconds: NDArray[np.float64]
    values: NDArray[np.float64]


@dataclass
class Loss:
    """Seconds lost to damage; ``what``: LF, HF, or all of the channel."""

    start: float
    stop: float
    what: str


@dataclass
class ChannelView:
    """One channel within the seconds [start, stop). A part that does not exist is None or empty.

    residual: full minus LF; low and high: the deadband, around the original where there is one,
    else around what is decoded; error: decoded minus original; relative: the same in deadbands.
    """

    channel: Described
    start: float
    stop: float
    full: Outline
    lf: Outline | None = None
    residual: Outline | None = None
    low: Outline | None = None
    high: Outline | None = None
    original: Outline | None = None
    error: Outline | None = None
    errors: Histogram | None = None
    relative: Histogram | None = None
    knots: Knots | None = None
    losses: list[Loss] = field(default_factory=list)
    spectra: dict[str, Spectrum] = field(default_factory=dict)
    only_original: int = 0
    """Samples of the original that the file lacks."""

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Seconds without samples, other than those lost to damage."""
        missing = self.full.missing()
        for loss in self.losses:
            missing[self.full.columns_within(loss.start, loss.stop)] = False
        return self.full.runs(missing)

    @property
    def is_lossy(self) -> bool:
        """True if the drawn signal may differ from the recorded one."""
        return self.channel.is_lossy

    @property
    def bound(self) -> float | None:
        """Error bound in the channel's unit; None if it depends on the signal or there is none."""
        return self.channel.error_bound or None


class Builder:
    """Takes the parts of one channel as they come."""

    def __init__(self, channel: Described, view: ChannelView, spectra: bool) -> None:
        self.channel = channel
        self.view = view
        self.spectra = spectra

    def like(self) -> Outline:
        full = self.view.full
        return Outline.over(full.first, full.stop, full.rate, COLUMNS)

    def add(self, block: ChannelPart, original: Channel | None) -> None:
        view = self.view
        y = block.full.samples()
        view.full.add_channel(block.full, y)
        self.see("full", block.full, y)
        if block.lf is not None:
            self.add_lf(block.full, y, block.lf)
        else:
            self.see_knots(block.full, y)
        if original is not None:
            self.add_original(block.full, y, original)
        elif block.half is not None:
            self.add_deadband(block.full, y, block.half)

    def add_pair(self, full: Channel, original: Channel) -> None:
        """Adds the same seconds of two recordings."""
        y = full.samples()
        self.view.full.add_channel(full, y)
        self.add_original(full, y, original)

    def add_lf(self, full: Channel, y: NDArray[np.float64], lf: Channel) -> None:
        view, d = self.view, lf.samples()
        view.lf = view.lf or self.like()
        view.lf.add_channel(lf, d)
        self.see("LF", lf, d)
        self.see_knots(lf, d)
        if self.channel.has_lf:
            view.residual = view.residual or self.like()
            for (i, j), span in intersect(full.coverage, lf.coverage):
                e = y[i : i + span.ticks] - d[j : j + span.ticks]
                view.residual.add(span.start, e)
                self.see_run("HF", e)

    def see_knots(self, channel: Channel, values: NDArray[np.float64]) -> None:
        """values [samples] of the track that has the knots."""
        knots = self.view.knots
        if knots is None:
            return
        place = 0
        for span in channel.coverage:
            inside = (knots.ticks >= span.start) & (knots.ticks < span.stop)
            knots.values[inside] = values[place + knots.ticks[inside] - span.start]
            place += span.ticks

    def add_deadband(
        self, channel: Channel, x: NDArray[np.float64], half: NDArray[np.float64]
    ) -> None:
        view = self.view
        view.low, view.high = view.low or self.like(), view.high or self.like()
        view.low.add_channel(channel, x - half)
        view.high.add_channel(channel, x + half)

    def add_original(self, full: Channel, y: NDArray[np.float64], original: Channel) -> None:
        view, x = self.view, original.samples()
        view.original = view.original or self.like()
        view.error = view.error or self.like()
        lattice = self.channel.lsb if original.calibration is not None else None
        view.errors = view.errors or Histogram(lattice or 0.0)
        view.original.add_channel(original, x)
        if self.channel.has_deadband and not self.channel.is_vector:
            self.add_deadband(original, x, self.channel.half_width(x))
            view.relative = view.relative or Histogram()
        view.only_original += original.stored.size
        for (i, j), span in intersect(original.coverage, full.coverage):
            f = x[i : i + span.ticks]
            with np.errstate(invalid="ignore", over="ignore"):
                error = y[j : j + span.ticks] - f
            view.error.add(span.start, error)
            view.errors.add(error)
            view.only_original -= span.ticks
            if view.relative is not None:
                view.relative.add(error / self.channel.half_width(f))

    def see(self, name: str, channel: Channel, values: NDArray[np.float64]) -> None:
        place = 0
        for span in channel.coverage:
            self.see_run(name, values[place : place + span.ticks])
            place += span.ticks

    def see_run(self, name: str, run: NDArray[np.float64]) -> None:
        if not self.spectra:
            return
        if name not in self.view.spectra:
            ticks = self.view.full.stop - self.view.full.first
            self.view.spectra[name] = Spectrum(float(self.channel.rate), ticks)
        self.view.spectra[name].add(run)


def survey(
    parts: Parts,
    start: Fraction | None = None,
    stop: Fraction | None = None,
    *,
    against: Parts | None = None,
    spectra: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> list[ChannelView]:
    """A view of each channel of ``parts`` within the seconds [start, stop); None: all there is.

    against: the channels of the original, in the same order and of the same rates.
    """
    a, b = within(parts, start, stop)
    if against is not None:
        for mine, other in zip(parts.channels, against.channels, strict=True):
            if mine.rate != other.rate:
                raise ParameterError(
                    f"{mine.name} has rate {mine.rate} Hz, the original {other.rate} Hz"
                )
    builders = [Builder(c, empty_view(c, a, b), spectra) for c in parts.channels]
    if isinstance(parts, FileParts):
        parts.find_lost()
        for builder, ref in zip(builders, parts.refs, strict=True):
            ticks = knots_within(parts.reader, ref, a, b)
            if ticks is not None:
                seconds = ticks / float(builder.channel.rate)
                builder.view.knots = Knots(ticks, seconds, np.full(ticks.size, np.nan))
    edges = parts.edges(a, b)
    for done, (first, last) in enumerate(zip(edges, edges[1:], strict=False), 1):
        originals: Sequence[ChannelPart | None] = [None] * len(builders)
        if against is not None:
            originals = against.part(first, last)
        for builder, block, original in zip(
            builders, parts.part(first, last), originals, strict=True
        ):
            builder.add(block, None if original is None else original.full)
        if progress:
            progress(done, len(edges) - 1)
    if isinstance(parts, FileParts):
        kinds = {track.id: track for ref in parts.refs for track in ref.tracks}
        for builder, ref in zip(builders, parts.refs, strict=True):
            own = {track.id for track in ref.tracks}
            spans = [span for span in parts.lost if span.track in own]
            builder.view.losses = losses_of(spans, kinds, float(a), float(b))
    return [builder.view for builder in builders]


def within(
    parts: Parts, start: Fraction | None, stop: Fraction | None
) -> tuple[Fraction, Fraction]:
    """The requested seconds, limited to those of the recording."""
    first, last = parts.extent()
    a = first if start is None else max(start, Fraction(0))
    b = last if stop is None else stop
    if start is not None:
        refuse_past_end(start, last)
    if not parts.channels or a >= b:
        raise ParameterError("No samples in this time range")
    return a, b


def empty_view(channel: Described, start: Fraction, stop: Fraction) -> ChannelView:
    first, last = tick_range(channel.rate, start, stop)
    return ChannelView(channel, float(start), float(stop), Outline.over(first, last, channel.rate))


def losses_of(
    spans: Sequence[LostSpan], tracks: dict[int, Track], start: float, stop: float
) -> list[Loss]:
    """Lost spans of one channel's tracks, those of LF and HF at the same time as one."""
    by_kind: dict[str, list[tuple[int, int]]] = {"lf": [], "hf": [], "full": []}
    rate = 1.0
    for span in spans:
        track = tracks[span.track]
        rate = float(track.rate)
        last = int(stop * rate) + 1 if span.stop is None else span.stop
        by_kind.setdefault(track.kind, []).append((span.start, max(last, span.start)))
    found = []
    names = {"lf": "LF", "hf": "HF", "full": "all"}
    edges = sorted({edge for rows in by_kind.values() for row in rows for edge in row})
    runs: list[tuple[int, int, str]] = []
    for a, b in zip(edges, edges[1:], strict=False):
        kinds = {
            kind for kind, rows in by_kind.items() if any(r[0] <= a and b <= r[1] for r in rows)
        }
        if not kinds:
            continue
        what = "all" if len(kinds) > 1 else names[kinds.pop()]
        if runs and runs[-1][1:] == (a, what):
            runs[-1] = (runs[-1][0], b, what)
        else:
            runs.append((a, b, what))
    for a, b, what in runs:
        low, high = max((a - 0.5) / rate, start), min((b - 0.5) / rate, stop)
        if low < high:
            found.append(Loss(low, high, what))
    return found


def liveliest(view: ChannelView, ticks: int) -> tuple[Fraction, Fraction] | None:
    """Seconds of ``ticks`` ticks in which the signal moves most; None where that is all of the
    view, or the signal is constant.

    The sum of the signal's steps counts, so that silence before an impact adds nothing. Where a
    column holds more ticks than wanted, the stretch is longer: look at it again."""
    full = view.full
    if full.stop - full.first < 4 * ticks:
        return None
    low, high = full.least, full.most
    steps = np.abs(np.diff(high, prepend=np.nan)) if full.is_whole else high - low
    steps = np.where(np.isfinite(steps), steps, 0.0)
    if not steps.any():
        return None
    width = max(-(-ticks // full.size), 1 if full.is_whole else FEWEST)
    width = min(width, steps.size)
    # The scale keeps sums of huge values finite.
    sums = np.cumsum(np.append(0.0, steps / steps.max()))
    sums = sums[width:] - sums[:-width]
    most = np.flatnonzero(sums >= sums.max() * (1 - 1e-9))
    column = int(most[most.size // 2])
    length = width * full.size
    first = min(full.first + column * full.size, full.stop - length)
    return first / full.rate, (first + length) / full.rate


def facts(
    parts: Parts,
    views: Sequence[ChannelView],
    *,
    size: int | None = None,
    whole: bool = True,
    damage: str = "",
) -> list[str]:
    """Returns short texts. size: bytes of the file. whole: all channels and times are shown.
    damage: the headline of the report."""
    count = len(views)
    samples = sum(view.full.sample_count for view in views)
    found = [f"{count} channel{'s' if count != 1 else ''}"]
    found.append(rates([view.channel.rate for view in views]))
    if whole:
        found.append(duration(views[0].stop - views[0].start))
    else:
        found.append(f"from {views[0].start:.6g} s to {views[0].stop:.6g} s")
    found.append(f"{grouped(samples)} sample{'s' if samples != 1 else ''}")
    if size is not None:
        found.append(amount(size) + (compression(samples, size) if whole else " in all"))
    if isinstance(parts, FileParts):
        preset = preset_of(parts.reader.metadata.get("encoder"))[:40]
        if preset:
            found.append(f"preset {preset}")
        if damage:
            found.append(damage)
        elif not any(view.is_lossy for view in views):
            found.append("every sample lossless")
    return found


def relative_error(view: ChannelView) -> float:
    """Largest error as a share of the range of the original; 0 where there is none."""
    original, errors = view.original, view.errors
    if original is None or errors is None or not errors.largest:
        return 0.0
    known = np.isfinite(original.most)
    # In Python: of doubles it may be infinite.
    reach = float(original.most[known].max()) - float(original.least[known].min())
    return errors.largest / reach if reach else float("inf")


def rates(known: Sequence[Fraction]) -> str:
    low, high = float(min(known)), float(max(known))
    return f"{low:.6g} Hz" if low == high else f"{low:.6g} to {high:.6g} Hz"


def duration(seconds: float) -> str:
    for unit, name in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 3 * unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds:.4g} s"


def grouped(count: int) -> str:
    """3 600 000"""
    return f"{count:,}".replace(",", " ")


def amount(size: int) -> str:
    for unit, name in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if size >= unit:
            return f"{size / unit:.3g} {name}"
    return f"{size} bytes"


def compression(samples: int, size: int) -> str:
    """Against 8 bytes for each sample."""
    if not samples or not size:
        return ""
    ratio = 8 * samples / size
    if ratio >= 1:
        return f" ({ratio:.3g} times smaller than float64)"
    return f" ({1 / ratio:.3g} times larger than float64)"
