"""Blocks of samples, as they arrive, to packets of tracks that never change (SPEC clause 15).

A track is made of the first block of its channel, and described before its first packet. Where it
would have to change later, another one continues it. Every packet stands alone, so blocks are as
long as what a crash may take: one cluster.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..container.cluster import Packet
from ..container.track import Track
from ..errors import ParameterError
from ..limits import LAST_TRACK_ID, LEVELS, TICK_LIMIT, Level
from ..live.inputs import Input
from ..threads import in_order, thread_count
from .live_counts import GridLane, Way, counts_of_block
from .live_many import Job, Made, Missing, Shelf, encode_blocks
from .live_plan import Plan, check_settings, plan_input
from .settings import Settings
from .source import PACKET_SAMPLES

if TYPE_CHECKING:
    from .live_deadband import DeadbandLane

SHARE = 100
"""Jobs that are worth a thread of their own: a few milliseconds of work."""

NATIVE = (np.dtype(np.int16), np.dtype(np.int32), np.dtype(np.int64))
"""What the compiled loop takes as it is."""


@dataclass(frozen=True, eq=False)
class Block:
    """Samples of one channel without a gap, all of one cluster, from tick ``start`` on.

    ``channel``: its number in the file. ``values``: [samples], as the input says.
    """

    channel: int
    input: Input
    start: int
    values: NDArray[Any]


class Lane(Protocol):
    """One channel on its way: the track that the last packet belongs to, and how the next one is
    coded. A track whose id is open is new."""

    track: Track

    @property
    def ways(self) -> Sequence[Way]:
        """What packs the next block together with those of other channels; none where something
        must be found out first."""

    def take(self, packets: Sequence[bytes], /) -> bytes:
        """Which of the packets, one of each way, it is."""

    def code(self, values: NDArray[Any], start: int, /) -> bytes:
        """The packet of a block on its own."""

    def adopt(self, track: Track, /) -> None: ...


class LiveEncoder:
    """Packets of many channels, block by block; the same blocks give the same bytes.

    ``first_track``: the first id that is free in the file. ``threads``: in how many the compiled
    loops run where blocks are many; the packets do not depend on it.
    """

    def __init__(
        self, settings: Settings | None = None, *, first_track: int = 0, threads: int = 1
    ) -> None:
        self.settings = settings or Settings()
        check_settings(self.settings)
        self.next_track, self.threads = first_track, thread_count(threads, 0)
        self.lanes: dict[int, Lane] = {}
        self.adopted: dict[int, Track] = {}
        self.plans: dict[int, Plan] = {}
        self.shelf = Shelf()
        self.undelivered: list[Track] = []

    def level(self, inputs: Iterable[Input]) -> Level:
        """The level of a file that any samples of these inputs fit; ParameterError where one of
        them cannot be coded with the settings."""
        needed = [plan_input(given, self.settings).level for given in inputs]
        return max(needed, key=lambda level: level.number, default=LEVELS[1])

    def known(self, channel: int, track: Track) -> None:
        """``track``, the last of the channel in the file, is gone on with where its parameters
        serve, and continued by another where they do not. Before the channel's first block."""
        if channel in self.lanes:
            raise ParameterError(f"channel {channel} is being recorded already")
        if track.kind != "full" or len(track.components) != 1 or track.first_channel != channel:
            raise ParameterError(
                f"channel {channel} cannot be continued: its track {track.id} has two bands, or "
                "other channels in it"
            )
        self.adopted[channel] = track

    def encode(self, blocks: Sequence[Block]) -> tuple[list[Track], list[Packet]]:
        """New tracks in order of their ids, to be described first; and the packets, in order of
        (track, start).

        Where a block is refused no packet of the call counts; the others may be given again, and
        what was made for them is described then.
        """
        for block in blocks:
            check_block(block)
        tracks = self.undelivered
        tracks += self.begin(blocks)
        pieces = [piece for block in blocks for piece in cut(block)]
        together = self.together(pieces)
        packets = []
        for place, piece in enumerate(pieces):
            lane, made = self.lanes[piece.channel], together.get(place)
            data = lane.take(made) if made else lane.code(piece.values, piece.start)
            if lane.track.id < 0:
                tracks.append(self.number(lane))
            packets.append(Packet(lane.track.id, piece.start, piece.values.size, data))
        self.undelivered = []
        return tracks, sorted(packets, key=attrgetter("track", "start"))

    def together(self, pieces: Sequence[Block]) -> dict[int, list[bytes]]:
        """Packets of those pieces, by their places, that are packed in one call: of each channel
        the first at most, since what follows may depend on it."""
        given: list[tuple[int, Way, NDArray[Any]]] = []
        seen: set[int] = set()
        for place, piece in enumerate(pieces):
            if piece.channel not in seen:
                seen.add(piece.channel)
                ways = self.lanes[piece.channel].ways
                if ways:
                    counts = self.counts(piece)
                    given += [(place, way, counts) for way in ways]
        jobs = [way.job(counts) for _, way, counts in given]
        made = self.call(jobs)
        for (place, _, _), (found, _) in zip(given, made, strict=True):
            if found is Missing.OUTSIDE:
                self.refuse(pieces[place])
        packets = [
            way.take(job, one) for (_, way, _), job, one in zip(given, jobs, made, strict=True)
        ]
        again = [at for at, packet in enumerate(packets) if packet is None]
        jobs = [given[at][1].job(given[at][2], again=True) for at in again]
        for at, job, one in zip(again, jobs, self.call(jobs), strict=True):
            packets[at] = given[at][1].take(job, one)
        packed: dict[int, list[bytes]] = {}
        for (place, _, _), packet in zip(given, packets, strict=True):
            assert packet is not None
            packed.setdefault(place, []).append(packet)
        return packed

    def call(self, jobs: Sequence[Job]) -> list[Made]:
        """All jobs of one length in one call, or in one of each thread."""
        alike: dict[int, list[int]] = {}
        for place, job in enumerate(jobs):
            alike.setdefault(job.block.size, []).append(place)
        parts = [part for places in alike.values() for part in shares(places, self.threads)]

        def work(places: Sequence[int]) -> list[Made]:
            return encode_blocks([jobs[place] for place in places], self.shelf)

        made: dict[int, Made] = {}
        for places, found in zip(parts, in_order(work, parts, self.threads), strict=True):
            made |= zip(places, found, strict=True)
        return [made[place] for place in range(len(jobs))]

    def refuse(self, piece: Block) -> None:
        """Raises what is wrong with its counts."""
        plan = self.plan(piece.channel, piece.input)
        counts_of_block(plan, piece.values, piece.channel, piece.start)

    def counts(self, piece: Block) -> NDArray[Any]:
        """As the compiled loop takes them, which looks at their range."""
        values = piece.values
        if values.dtype in NATIVE and piece.input.takes_counts:
            flags = values.flags
            return values if flags.c_contiguous and flags.aligned else values.copy()
        plan = self.plan(piece.channel, piece.input)
        return counts_of_block(plan, values, piece.channel, piece.start)

    def plan(self, channel: int, given: Input) -> Plan:
        found = self.plans.get(channel)
        if found is None or found.input != given:
            found = self.plans[channel] = plan_input(given, self.settings)
        return found

    def begin(self, blocks: Sequence[Block]) -> list[Track]:
        """The tracks of those channels that are new.

        ``encode`` does so by itself. A channel of counts may be begun before it has samples, by a
        block of one sample, whichever; one that never has any is described so at the end.
        """
        new: dict[int, Lane] = {}
        for block in blocks:
            if block.channel not in self.lanes and block.channel not in new:
                new[block.channel] = self.lane_of(block)
        self.lanes |= new
        return [self.number(lane) for lane in new.values() if lane.track.id < 0]

    def number(self, lane: Lane) -> Track:
        if self.next_track > LAST_TRACK_ID:
            raise ParameterError(f"a file has at most {LAST_TRACK_ID + 1} tracks")
        lane.track = replace(lane.track, id=self.next_track)
        self.next_track += 1
        return lane.track

    def lane_of(self, block: Block) -> Lane:
        plan = self.plan(block.channel, block.input)
        adopted = self.adopted.get(block.channel)
        number, first = block.channel, block.values[:PACKET_SAMPLES]
        lane: Lane
        deadband: DeadbandLane | None = None
        if plan.channel.calibration is None:
            from .live_exact import choose_exact

            lane = choose_exact(plan, number, first, adopted)
        elif plan.settings.preset == "perceptual" and plan.bound is not None:
            from .live_deadband import DeadbandLane

            lane = deadband = DeadbandLane(plan, plan.bound, number, self.shelf)
        else:
            lane = GridLane(plan, number, self.shelf)
        if adopted is not None:
            check_continued(lane.track, adopted)
            lane.adopt(adopted)
        if deadband is not None:
            deadband.begin(first, block.start)
        return lane


def shares(places: Sequence[int], threads: int) -> Iterator[Sequence[int]]:
    """Parts of about the same length, of more than one only where that is many jobs."""
    count = min(threads, len(places) // SHARE) or 1
    size = -(-len(places) // count)
    for at in range(0, len(places), size):
        yield places[at : at + size]


def cut(block: Block) -> Iterator[Block]:
    """Pieces that are not too long for a packet."""
    if block.values.size <= PACKET_SAMPLES:
        yield block
        return
    for at in range(0, block.values.size, PACKET_SAMPLES):
        piece = block.values[at : at + PACKET_SAMPLES]
        yield Block(block.channel, block.input, block.start + at, piece)


def check_block(block: Block) -> None:
    named = f"channel {block.channel} ({block.input.label!r})"
    if block.values.ndim != 1 or not block.values.size:
        raise ParameterError(f"{named}: a block is a row of one sample or more")
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
