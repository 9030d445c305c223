"""Blocks of samples, as they arrive, to packets of tracks that never change (SPEC clause 13).

A track is made of the first block of its channel, and described before its first packet. Where it
would have to change later, another one continues it. Every packet stands alone, so blocks are as
long as what a crash may take: one cluster.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from numpy.typing import NDArray

from ..container.cluster import Packet
from ..container.track import Track
from ..errors import ParameterError
from ..limits import LAST_TRACK_ID, LEVELS, TICK_LIMIT, Level
from ..live.inputs import Input
from .live_counts import GridLane
from .live_exact import choose_exact
from .live_plan import check_settings, plan_input
from .settings import Settings
from .source import PACKET_SAMPLES


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

    def adopt(self, track: Track) -> None: ...

    def code(self, values: NDArray[Any], start: int, /) -> bytes: ...


class LiveEncoder:
    """Packets of many channels, block by block; the same blocks give the same bytes.

    ``first_track``: the first id that is free in the file.
    """

    def __init__(self, settings: Settings | None = None, *, first_track: int = 0) -> None:
        self.settings = settings or Settings("archive")
        check_settings(self.settings)
        self.next_track = first_track
        self.lanes: dict[int, Lane] = {}
        self.adopted: dict[int, Track] = {}

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
        (track, start)."""
        for block in blocks:
            check_block(block)
        tracks = self.begin(blocks)
        packets = []
        for block in blocks:
            lane = self.lanes[block.channel]
            for at in range(0, block.values.size, PACKET_SAMPLES):
                piece, start = block.values[at : at + PACKET_SAMPLES], block.start + at
                data = lane.code(piece, start)
                if lane.track.id < 0:
                    tracks.append(self.number(lane))
                packets.append(Packet(lane.track.id, start, piece.size, data))
        return tracks, sorted(packets, key=lambda packet: (packet.track, packet.start))

    def begin(self, blocks: Sequence[Block]) -> list[Track]:
        """The tracks of channels that are new, those together that can share a chunk."""
        new: dict[int, Lane] = {}
        for block in blocks:
            if block.channel not in self.lanes and block.channel not in new:
                new[block.channel] = self.lane_of(block)
        self.lanes |= new
        alike: dict[tuple[object, ...], list[Lane]] = {}
        for lane in new.values():
            if lane.track.id < 0:
                alike.setdefault(lane.track.shared, []).append(lane)
        return [self.number(lane) for lanes in alike.values() for lane in lanes]

    def number(self, lane: Lane) -> Track:
        if self.next_track > LAST_TRACK_ID:
            raise ParameterError(f"a file has at most {LAST_TRACK_ID + 1} tracks")
        lane.track = replace(lane.track, id=self.next_track)
        self.next_track += 1
        return lane.track

    def lane_of(self, block: Block) -> Lane:
        plan = plan_input(block.input, self.settings)
        adopted = self.adopted.get(block.channel)
        lane: Lane
        if plan.channel.calibration is not None:
            lane = GridLane(plan, block.channel)
        else:
            lane = choose_exact(plan, block.channel, block.values[:PACKET_SAMPLES], adopted)
        if adopted is not None:
            check_continued(lane.track, adopted)
            lane.adopt(adopted)
        return lane


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
