"""The contents of a picture for each channel, collected in one pass over the recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ...format.track import Track
from ...errors import ParameterError
from ...reading.losses import LostSpan
from ...reading.reconstruct import intersect
from ...reading.seconds import tick_range
from ...recording import Channel
from .histogram import Histogram
from .knots import knots_within
from .outline import COLUMNS, Outline
from .parts import Block, Described, FileParts, Parts
from .spectrum import Spectrum

FEWEST = 5
"""A part that is examined again has at least so many columns: one alone may hold a single peak."""


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
class View:
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

    def __init__(self, channel: Described, view: View, spectra: bool) -> None:
        self.channel = channel
        self.view = view
        self.spectra = spectra

    def like(self) -> Outline:
        full = self.view.full
        return Outline.over(full.first, full.stop, full.rate, COLUMNS)

    def add(self, block: Block, original: Channel | None) -> None:
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
) -> list[View]:
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
        originals: Sequence[Block | None] = [None] * len(builders)
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
    if start is not None and start >= last:
        raise ParameterError(
            f"No samples at {float(start):g} s or later: the recording ends at {float(last):g} s"
        )
    if not parts.channels or a >= b:
        raise ParameterError("No samples in this time range")
    return a, b


def empty_view(channel: Described, start: Fraction, stop: Fraction) -> View:
    first, last = tick_range(channel.rate, start, stop)
    return View(channel, float(start), float(stop), Outline.over(first, last, channel.rate))


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


def liveliest(view: View, ticks: int) -> tuple[Fraction, Fraction] | None:
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
