"""Recording -> blocks of values for a device, rendered ahead of time."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from math import ceil
from typing import NamedTuple

import numpy as np

from ...errors import ParameterError
from ...format.extras import NS_LIMIT
from ...format.track import Track
from ...limits import TICK_LIMIT
from ...numbers import exact
from ...reading.catalogue import Catalogue, ChannelRef
from ...reading.damage import DamageReport, LostSpan
from ...reading.packets import Seconds
from ...reading.reader import Reader
from ...recording import Calibration
from ..profile.model import FrameBlock, Profile
from .assign import Assignment, Route, name_of
from .feed import (
    Band,
    ChannelResampler,
    DeviceGrid,
    Kernel,
    Meaning,
    PacketQueue,
    PacketSource,
    Shape,
    kernel,
    samples_in,
)

BLOCK_S = Fraction(1, 20)
BLOCK_TICKS = 1 << 18
"""Most ticks of a channel in one block, where it is much faster than the device."""
SHAPES: dict[Band, Shape] = {"full": "bounded", "lf": "linear", "hf": "band-limited"}
WIDEST_SINC, WIDEST = 1 << 14, 1 << 20
"""Ticks of a channel for one sample of the device: above the first a sinc would take 2^19 ticks,
and the mean under a triangle is sent instead; above the second the channel is refused."""
LATE_S = 1
"""Silence at the start is reported from this number of seconds on."""
SIDE_BY_SIDE_S = 2
"""Channels whose kernels look farther ahead than that are read in a pass of their own."""


class RoutedChannel(NamedTuple):
    """A route on its way: what feeds it, and where the samples lie on its ticks."""

    route: Route
    feed: ChannelResampler
    grid: DeviceGrid


class Position(NamedTuple):
    """Where a device sample is in the recording: the repeat, from 0, and the seconds; None between
    two repeats."""

    loop: int
    seconds: Fraction | None


class Renderer:
    """``start``, ``stop``: seconds of the recording; ``loops``: how often, 0: without end.

    Sample n of the device is what the channel was at start + n * speed / rate. Between two times
    lie two ramps without signal. The reader is the renderer's as long as blocks are made.
    """

    def __init__(
        self,
        reader: Reader,
        profile: Profile,
        assignment: Assignment,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        speed: Seconds = 1,
        loops: int = 1,
    ) -> None:
        reader.refuse_unknown()
        self.reader = reader
        self.profile = profile
        self.loops = loops
        self.rate = profile.timing.rate
        self.speed = exact(speed)
        if self.speed <= 0:
            raise ParameterError("the speed is above 0")
        if loops < 0:
            raise ParameterError("a recording is played once, more often, or for ever (0)")
        self.step = self.speed / self.rate
        """Seconds of the recording from one sample of the device to the next."""
        self.left_out = list(assignment.left_out)
        self.notes = list(assignment.notes)
        self.routes = list(assignment.routes)
        self.refuse_too_fast()
        self.start = Fraction(0) if start is None else max(exact(start), Fraction(0))
        self.stop = self.end if stop is None else min(exact(stop), self.end)
        self.join = 2 * ceil(exact(profile.timing.ramp_s) * self.rate)
        """Samples without signal between two times."""
        self.block_samples = self.samples_of_a_block()
        self.source: PacketSource | None = None
        self.past: dict[LostSpan, None] = {}
        whole = [r for r in self.routes if profile.actuators[r.actuator].band == "full"]
        refs = self.refs
        self.past |= dict.fromkeys(reader.lost_parts([refs[r.channel] for r in whole], "full"))
        self.apart: set[tuple[int, ...]] = set()
        """Tracks that needed a pass of their own, when they were read before."""
        self.begun = (0, self.start, 0)
        """The first sample of the present generation, where it lies, and in which loop."""
        self.made: dict[tuple[Shape, Fraction], Kernel] = {}
        """Channels of one rate share a kernel and its tables."""
        self.kernels = self.names_of_kernels()
        self.note_late_start()
        self.notes += [
            f"channel {refs[number].label or number} has a synthetic texture"
            for number in sorted({route.channel for route in self.routes})
            if refs[number].synthetic
        ]

    @property
    def refs(self) -> dict[int, ChannelRef]:
        return {ref.number: ref for ref in self.reader.channels}

    @property
    def resting(self) -> list[str]:
        """Names of the actuators that no channel drives."""
        driven = {route.actuator for route in self.routes}
        return [each.name for i, each in enumerate(self.profile.actuators) if i not in driven]

    @property
    def plan(self) -> list[str]:
        """For the user: what drives each actuator and why, the limits, and what rests."""
        actuators, refs = self.profile.actuators, self.refs
        lines = []
        for route in self.routes:
            each = actuators[route.actuator]
            lines.append(
                f"{each.name} <- {name_of(refs[route.channel])}, {route.reason}: "
                f"{each.minimum:g} to {each.maximum:g} {each.unit}, "
                f"at most {each.slew:g} {each.unit}/s"
            )
        return [*lines, f"at rest: {', '.join(self.resting) or 'no actuator'}"]

    def refuse_too_fast(self) -> None:
        for route in self.routes:
            ref = self.refs[route.channel]
            if self.ratio(ref) > WIDEST:
                raise ParameterError(
                    f"channel {name_of(ref)} cannot be played: more than {WIDEST} of its samples "
                    "fall on one sample of the device"
                )

    def ratio(self, ref: ChannelRef) -> Fraction:
        """Ticks of the channel from one sample of the device to the next."""
        return ref.track.rate * self.step

    def kernel_of(self, route: Route) -> Kernel:
        ref = self.refs[route.channel]
        ratio = self.ratio(ref)
        shape = SHAPES[self.profile.actuators[route.actuator].band]
        shape = shape if ratio <= WIDEST_SINC else "linear"
        if (shape, ratio) not in self.made:
            self.made[shape, ratio] = kernel(shape, ratio)
        return self.made[shape, ratio]

    def note_late_start(self) -> None:
        """Notes a long silence before the recording begins."""
        starts = [ref.start_ns for ref in self.reader.catalogue.data if ref.start_ns is not None]
        first = Fraction(min(starts, default=0), 10**9)
        if first > self.start + LATE_S:
            self.notes.append(f"the recording has nothing before {float(first):.6g} s")

    def names_of_kernels(self) -> dict[str, str]:
        """By actuator."""
        actuators = self.profile.actuators
        return {actuators[r.actuator].name: self.kernel_of(r).name for r in self.routes}

    @property
    def end(self) -> Fraction:
        """The recording ends with the last tick of its longest channel; the index knows that time
        to the nanosecond above, but none above 584 years."""
        seconds = self.reader.duration
        rates = {ref.track.rate for ref in self.reader.channels}
        if seconds >= Fraction(NS_LIMIT, 10**9):
            return max((TICK_LIMIT / rate for rate in rates), default=Fraction(0))
        return max((seconds * rate // 1 / rate for rate in rates), default=Fraction(0))

    def samples_of_a_block(self) -> int:
        """Whole frames of about 50 ms, less where that is too much of a channel."""
        refs = self.refs
        frame = self.profile.timing.frame_samples
        widest = max(
            (self.ratio(refs[route.channel]) for route in self.routes), default=Fraction(1)
        )
        most = max(int(BLOCK_TICKS / widest), 1)
        wanted = -(-ceil(BLOCK_S * self.rate) // frame) * frame
        return wanted if wanted <= most else most

    def blocks(
        self, first: int = 0, generation: int = 0, at: Seconds | None = None, loop: int = 0
    ) -> Iterator[FrameBlock]:
        """From sample ``first`` on, which lies at second ``at`` of the recording (None: at the
        start), in the given time through it; to the end of the last."""
        begin = self.start if at is None else max(exact(at), self.start)
        self.begun = first, begin, loop
        return self.all_from(first, generation, begin, loop)

    def all_from(
        self, first: int, generation: int, begin: Fraction, loop: int
    ) -> Iterator[FrameBlock]:
        while True:
            count = samples_in(self.stop - begin, self.step)
            final = loop + 1 == self.loops or samples_in(self.stop - self.start, self.step) == 0
            for values in self.once(begin, count):
                last = final and values.first + len(values.values) == count
                yield values._replace(first=first + values.first, generation=generation, last=last)
            first += count
            if final:
                return
            yield self.silence(first, self.join)._replace(generation=generation)
            first, begin, loop = first + self.join, self.start, loop + 1

    def position(self, sample: int) -> Position:
        """Where a sample of the present generation lies."""
        first, begin, loop = self.begun
        place, count = sample - first, samples_in(self.stop - begin, self.step)
        if place >= count and loop + 1 != self.loops:
            whole = samples_in(self.stop - self.start, self.step)
            place -= count + self.join
            if place < 0:
                return Position(loop, None)
            times, place = divmod(place, whole + self.join)
            loop, begin, count = loop + 1 + times, self.start, whole
        return Position(loop, begin + place * self.step if 0 <= place < count else None)

    def silence(self, first: int, count: int) -> FrameBlock:
        rest = [actuator.rest for actuator in self.profile.actuators]
        values = np.tile(np.array(rest, np.float64), (count, 1))
        return FrameBlock(first, values, np.zeros(values.shape, np.bool_))

    def once(self, begin: Fraction, count: int) -> Iterator[FrameBlock]:
        """``count`` samples, of which number 0 lies at ``begin``; one empty block of none."""
        if not count:
            yield self.silence(0, 0)
            return
        lanes = self.lanes(begin, count)
        groups = self.groups([lane.feed for lane in lanes])
        self.source = source = PacketSource(
            self.reader, groups, lambda catalogue: self.rebind(lanes, catalogue)
        )
        try:
            for number in range(0, count, self.block_samples):
                yield self.block(lanes, source, number, min(self.block_samples, count - number))
        finally:
            self.past |= dict.fromkeys(source.lost)
            source.close()
            alone = [group[0] for group in source.groups if len(group) == 1]
            self.apart = {tuple(queue.tracks) for queue in alone}

    def block(
        self, lanes: list[RoutedChannel], source: PacketSource, number: int, count: int
    ) -> FrameBlock:
        block = self.silence(number, count)
        for route, feed, grid in lanes:
            places = grid.places(number, count)
            needed = int(places.ticks[-1]) + feed.kernel.half + 1
            for queue in feed.queues:
                source.fill(queue, needed)
            feed.take(needed)
            actuator = self.profile.actuators[route.actuator]
            values, known = feed.render(places, actuator.rest)
            block.values[:, route.actuator] = values
            block.known[:, route.actuator] = known & np.isfinite(values)
            feed.drop(grid.tick(number + count) - feed.kernel.half + 1)
        return block

    def lanes(self, begin: Fraction, count: int) -> list[RoutedChannel]:
        refs, found = self.refs, []
        for route in self.routes:
            ref, shape = refs[route.channel], self.kernel_of(route)
            grid = DeviceGrid(begin, self.step, ref.track.rate)
            first = max(grid.tick(0) - shape.half + 1, 0)
            stop = grid.tick(count - 1) + shape.half + 1
            actuator = self.profile.actuators[route.actuator]
            base, residual = tracks_for(ref, actuator.band)
            a, b, d = ref.track.components[ref.index].calibration
            meaning = Meaning(
                ref.index,
                Calibration(a, 0 if actuator.band == "hf" else b, d),
                float(route.factor * exact(actuator.gain)),
                actuator.offset,
            )
            low, high = (
                PacketQueue(tracks, ref.track.rate, stop, first) if tracks else None
                for tracks in (base, residual)
            )
            found.append(
                RoutedChannel(
                    route, ChannelResampler(low, high, actuator.band, meaning, shape), grid
                )
            )
        return found

    def groups(self, feeds: list[ChannelResampler]) -> list[list[PacketQueue]]:
        """Queues that share a pass over the file; the first group is the large one."""
        together: list[PacketQueue] = []
        alone: list[list[PacketQueue]] = []
        for feed in feeds:
            for queue in feed.queues:
                far = feed.kernel.half > SIDE_BY_SIDE_S * queue.rate
                if far or tuple(queue.tracks) in self.apart:
                    alone.append([queue])
                else:
                    together.append(queue)
        return [together, *alone]

    def rebind(self, lanes: list[RoutedChannel], catalogue: Catalogue) -> None:
        """The index was false: the tracks of each channel may differ."""
        refs = {ref.number: ref for ref in catalogue.channels}
        for route, feed, _ in lanes:
            ref = refs.get(route.channel)
            base, residual = tracks_for(ref, feed.band) if ref else ({}, {})
            for queue, tracks in ((feed.base, base), (feed.residual, residual)):
                if queue is not None:
                    same = all(track.rate == queue.rate for track in tracks.values())
                    queue.tracks = tracks if same else {}

    @property
    def lost(self) -> list[str]:
        """Spans lost to damage so far, in words."""
        return DamageReport(self.reader.catalogue, self.lost_spans).losses()

    @property
    def lost_spans(self) -> list[LostSpan]:
        """Spans lost to damage in the tracks read so far."""
        now = self.source.lost if self.source else []
        return list(dict.fromkeys([*self.past, *now]))


def tracks_for(ref: ChannelRef, band: Band) -> tuple[dict[int, Track], dict[int, Track]]:
    """What a band needs of a channel: the tracks of LF or full band, and those of HF."""
    base = {} if band == "hf" else {part.track.id: part.track for part in ref.parts}
    residuals = [part.residual for part in ref.parts if part.residual is not None]
    return base, {} if band == "lf" else {track.id: track for track in residuals}
