"""Blocks of samples, as they arrive, to packets of tracks that never change (SPEC clause 15).

Each block is coded as :mod:`encode` codes one packet of one channel. A track is made from the first
block of its channel, and described before its first packet. Where a later block does not fit it, a
track that continues it takes over. A block is at most as long as one cluster, so that a crash loses
no more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from operator import attrgetter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..format.cluster import Packet
from ..format.track import Track
from ..deadband import Deadband
from ..errors import ParameterError
from ..limits import LAST_TRACK_ID, LEVELS, TICK_LIMIT, Level
from .inputs import Input
from ..reading.decoder import TrackDecoder
from ..recording import Span
from .bounded import scalar_ways
from .grids import nearest
from .live_plan import Made, Plan, check_settings, plan_input
from .packed import Coded
from .predict import encode_best
from .quick import encode_quick
from .settings import Settings
from .source import PACKET_SAMPLES, Source
from .unit import ENCODE_LEVEL, Bound

FIRST, LAST = 2, 16
"""After 2 blocks all forms are tried once more; then after twice as many each time, up to 16."""

DESCRIPTION = 150.0
"""About the bytes of the description of a track."""

MUCH = 0.93
"""Another form takes over if its packets are below this part of the size, and save more than a
description takes. Each time twice as much must be saved, so that there are few descriptions."""

SHORT = 128
"""Samples of a cluster: in shorter ones held steps without entropy coding, the first form of
:func:`scalar_ways`, may be the smallest. In longer ones they take over too soon after a rest."""

Way = Callable[[Track, int | None], Coded | None]
"""One form: (track, smallest size so far) -> packets, None where they are not smaller."""

NOTHING = np.zeros(1, np.int32)
"""In place of the first block of a channel without samples."""


@dataclass(frozen=True, eq=False)
class Block:
    """Samples of one channel without a gap, all of one cluster, from tick ``start`` on.

    ``channel``: its number in the file. ``values``: [samples], as the input says.
    """

    channel: int
    input: Input
    start: int
    values: NDArray[Any]


class ChannelEncoder(Protocol):
    """One channel: ``take`` checks and converts the samples of a block, ``code`` makes packets."""

    def take(self, values: NDArray[Any], start: int, /) -> NDArray[Any]: ...

    def code(self, values: NDArray[Any], start: int, /) -> Made: ...


class LiveEncoder:
    """Packets of many channels, block by block; the same blocks give the same bytes.

    ``first_track``: the first id that is free in the file.
    """

    def __init__(self, settings: Settings | None = None, *, first_track: int = 0) -> None:
        self.settings = settings or Settings()
        check_settings(self.settings)
        self.next_track = first_track
        self.encoders: dict[int, ChannelEncoder] = {}
        self.tracks: dict[int, Track] = {}
        """By channel: the last track in the file."""
        self.forms: dict[int, Track] = {}
        """By channel: that track as the channel's encoder made it."""

    def level(self, inputs: Iterable[Input]) -> Level:
        """The level of a file that any samples of these inputs fit; ParameterError where one of
        them cannot be coded with the settings."""
        needed = [plan_input(given, self.settings).level for given in inputs]
        return max(needed, key=lambda level: level.number, default=LEVELS[1])

    def known(self, channel: int, track: Track) -> None:
        """``track`` is the last of the channel in the file: it receives the packets that fit it.
        Before the channel's first block."""
        if channel in self.encoders:
            raise ParameterError(f"channel {channel} is being recorded already")
        if track.kind != "full" or len(track.components) != 1 or track.first_channel != channel:
            raise ParameterError(
                f"channel {channel} cannot be continued: its track {track.id} has two bands, or "
                "other channels in it"
            )
        self.tracks[channel] = track

    def begin(self, inputs: Mapping[int, Input]) -> list[Track]:
        """Tracks of new channels that do not depend on their samples; by channel number."""
        tracks: list[Track] = []
        for channel, given in inputs.items():
            plan = plan_input(given, self.settings)
            if plan.is_one_grid and channel not in self.tracks:
                grid = self.encoders[channel] = GridEncoder(plan, channel)
                tracks.append(self.number(channel, grid.track))
        return tracks

    def silent(self, inputs: Mapping[int, Input]) -> list[Track]:
        """Tracks of channels without a sample, at the end; by channel number."""
        tracks = []
        for channel, given in inputs.items():
            block = Block(channel, given, 0, np.zeros(1, np.int32))
            encoder = self.encoder_of(block)
            tracks.append(
                self.number(channel, encoder.code(encoder.take(block.values, 0), 0).track)
            )
        return tracks

    def encode(self, blocks: Sequence[Block]) -> tuple[list[Track], list[Packet]]:
        """New tracks in order of their ids, to be described first; and the packets, in order of
        (track, start).

        Where a block is refused, nothing was made; the others may be given again.
        """
        for block in blocks:
            check_block(block)
        taken = [self.encoder_of(block).take(block.values, block.start) for block in blocks]
        tracks: list[Track] = []
        packets = []
        for block, values in zip(blocks, taken, strict=True):
            made = self.encoders[block.channel].code(values, block.start)
            track = self.fitting(block.channel, made)
            if track is None:
                track = self.number(block.channel, made.track)
                tracks.append(track)
            packets += [replace(packet, track=track.id) for packet in made.packets]
        return tracks, sorted(packets, key=attrgetter("track", "start"))

    def encoder_of(self, block: Block) -> ChannelEncoder:
        """Of a channel; a new one by its first block."""
        found = self.encoders.get(block.channel)
        if found is None:
            plan = plan_input(block.input, self.settings)
            if plan.channel.calibration is None:
                from .live_exact import choose_exact

                before = self.tracks.get(block.channel)
                found = choose_exact(plan, block.channel, block.values, before)
            elif plan.is_one_grid:
                found = GridEncoder(plan, block.channel)
            else:
                assert plan.bound
                found = BoundedEncoder(plan, plan.bound, block.channel)
            self.encoders[block.channel] = found
        return found

    def fitting(self, channel: int, made: Made) -> Track | None:
        """The channel's last track, where the packets fit it."""
        track = self.tracks.get(channel)
        if track is None or self.forms.get(channel) is made.track:
            return track
        check_continued(made.track, track)
        same = ("codec", "parameters", "contract", "number_format")
        fits = (
            all(getattr(track, name) == getattr(made.track, name) for name in same)
            and track.components[0].deviation == made.track.components[0].deviation
            and track.count_min <= made.low
            and made.high <= track.count_max
        )
        return track if fits else None

    def number(self, channel: int, made: Track) -> Track:
        """A new track, which continues the channel's last one."""
        if self.next_track > LAST_TRACK_ID:
            raise ParameterError(f"a file has at most {LAST_TRACK_ID + 1} tracks")
        before = self.tracks.get(channel)
        track = replace(made, id=self.next_track, continues=before.id if before else None)
        self.next_track += 1
        self.tracks[channel], self.forms[channel] = track, made
        return track


class GridEncoder:
    """Counts on one grid: of step 1, or of a largest error."""

    def __init__(self, plan: Plan, number: int) -> None:
        self.plan, self.number = plan, number
        self.track = plan.track(
            number, codec="LPCR", parameters=plan.grid.build(), contract=plan.contract
        )
        self.pack = encode_quick if plan.settings.fast else partial(encode_best, thorough=False)

    def take(self, values: NDArray[Any], start: int) -> NDArray[np.int64]:
        return self.plan.counts(values, self.number, start)

    def code(self, x: NDArray[np.int64], start: int) -> Made:
        packet = Packet(0, start, x.size, self.pack(nearest(x, self.plan.grid)))
        return checked(Made(self.track, [packet], int(x.min()), int(x.max())), x)


class BoundedEncoder(GridEncoder):
    """Counts within a deadband: knots or a grid, whichever is smaller (see :mod:`bounded`).

    The first block decides. Another form takes over where it has been much smaller for long.
    """

    def __init__(self, plan: Plan, bound: Bound, number: int) -> None:
        super().__init__(plan, number)
        self.bound = bound
        self.ways = slice(0 if plan.input.rate * (plan.settings.cluster or 1) < SHORT else 1, None)
        self.now = self.left = 0
        self.wait, self.needed = FIRST, DESCRIPTION
        self.saved: list[float] = []

    def code(self, x: NDArray[np.int64], start: int) -> Made:
        span = Span(start, start + x.size)
        source = Source((self.plan.channel,), x[:, None], (span,))
        ways = [code for _, code in scalar_ways(source, self.bound)[self.ways]]
        found: Coded | None = None
        if self.left:
            self.left -= 1
            found = ways[self.now](self.track, None)
        if found is None:
            tried = self.try_all(ways)
            self.choose([size_of(each) if each else inf for each in tried])
            found = tried[self.now]
        assert found
        return checked(Made(found.track, found.packets, int(x.min()), int(x.max())), x)

    def try_all(self, ways: Sequence[Way]) -> list[Coded | None]:
        """The present form, and all that are smaller than those before them."""
        tried: list[Coded | None] = [None] * len(ways)
        smallest: int | None = None
        for place in sorted(range(len(ways)), key=lambda place: place != self.now):
            coded = tried[place] = ways[place](self.track, smallest)
            if coded and (smallest is None or coded.size < smallest):
                smallest = coded.size
        return tried

    def choose(self, sizes: list[float]) -> None:
        """The form of the next blocks, by the sizes of all of one block."""
        if not self.saved or sizes[self.now] == inf:
            self.now = sizes.index(min(sizes))
            self.saved = [0.0] * len(sizes)
        self.left = self.wait
        self.wait = min(2 * self.wait, LAST)
        size = sizes[self.now]
        for place, other in enumerate(sizes):
            more = (size - other) * self.left
            self.saved[place] = (
                self.saved[place] + more if other < MUCH * size else self.saved[place] / 2
            )
        best = self.saved.index(max(self.saved))
        if self.saved[best] > self.needed and sizes[best] < inf:
            self.now = best
            self.needed *= 2
            self.saved = [0.0] * len(sizes)


def size_of(coded: Coded) -> int:
    """Bytes of its packets."""
    return sum(len(packet.data) for packet in coded.packets)


def checked(made: Made, x: NDArray[np.int64]) -> Made:
    """The same, where the decoded counts keep the contract."""
    contract = made.track.contract
    if contract is not None:
        band = Deadband(contract.kn, contract.kd, contract.floor, contract.zero)
        decoder = TrackDecoder(made.track, ENCODE_LEVEL)
        y = np.concatenate([decoder.decode(packet)[:, 0] for packet in made.packets])
        if band.outside(x, y.astype(np.int64)).any():
            raise AssertionError("an encoder that guarantees a bound left it")
    return made


def check_block(block: Block) -> None:
    named = f"channel {block.channel} ({block.input.label!r})"
    if block.values.ndim != 1 or not 1 <= block.values.size <= PACKET_SAMPLES:
        raise ParameterError(f"{named}: a block is a row of 1 to {PACKET_SAMPLES} samples")
    if not 0 <= block.start <= TICK_LIMIT - block.values.size:
        raise ParameterError(f"{named}: ticks lie in [0, 2^48)")


def check_continued(track: Track, before: Track) -> None:
    """What the tracks of one channel have in common (SPEC 6.3)."""
    one, other = track.components[0].calibration, before.components[0].calibration
    for name, same in (
        ("rate", track.rate == before.rate),
        ("number format", track.number_format == before.number_format),
        ("calibration", one == other),
    ):
        if not same:
            raise ParameterError(
                f"channel {before.first_channel} ({before.components[0].label!r}) cannot be "
                f"continued: its {name} is another in the file"
            )
