"""Tracks: the descriptions of coded streams (SPEC 6.3), and the rules between tracks."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

from ..errors import FormatError, UnsupportedError
from ..limits import EXACT_LIMIT, Level

KINDS = ("full", "lf", "hf", "events")
NUMBER_FORMATS = ("counts", "int64", "uint64", "binary16", "binary32", "binary64")
WORD_SIZES = {"int64": 8, "uint64": 8, "binary16": 2, "binary32": 4, "binary64": 8}
CODECS = ("KNOT", "QUAN", "RAWB", "LPCR", "LPCX", "EVNT")
COMPONENTS = 255
"""Of a track, and of all tracks of a TRAK chunk, at most (TRK-002)."""


class Affine(NamedTuple):
    """A, B, D of clause 8."""

    a: int = 1
    b: int = 0
    d: int = 1


IDENTITY = Affine()


class Contract(NamedTuple):
    """Error bound of clause 11; ``floor`` and ``zero`` in counts, one per component."""

    kn: int
    kd: int
    vector: bool
    guaranteed: bool
    floor: tuple[int, ...]
    zero: tuple[int, ...]


@dataclass(frozen=True)
class Component:
    """The description of one scalar of a track."""

    calibration: Affine = IDENTITY
    label: str = ""
    unit: str = "1"
    quantity: str = ""
    axis: str = ""
    group: str = ""
    body_site: str = ""
    device: str = ""
    deviation: tuple[float, float] | None = None


@dataclass(frozen=True)
class Track:
    """One coded stream of one band."""

    id: int
    kind: str
    codec: str
    rate: Fraction
    first_channel: int
    components: tuple[Component, ...]
    parameters: bytes = b""
    number_format: str = "counts"
    count_min: int = 0
    count_max: int = 0
    base: int | None = None
    continues: int | None = None
    """Id of the track whose channels this one goes on coding."""
    contract: Contract | None = None
    provenance: str = ""
    unsupported: str | None = None
    unknown: tuple[tuple[int, bytes], ...] = ()
    """TLVs that this reader does not know, by type."""
    offset: int = 0
    """Offset of the TRAK payload in the file."""

    @property
    def channels(self) -> range:
        if self.kind == "events":
            return range(0)
        return range(self.first_channel, self.first_channel + len(self.components))

    def weight(self, span: int, size: int) -> int:
        """Weight of a packet in a cluster, by its ticks and bytes (DAT-009)."""
        return size if self.kind == "events" else span * len(self.components)

    def in_range_of(self, level: Level) -> bool:
        """Whether the declared range has the width that the level allows (TRK-005)."""
        bound = 1 << ((level.residual_bits if self.kind == "hf" else level.count_bits) - 1)
        return -bound <= self.count_min <= self.count_max < bound

    def is_orphan(self, tracks: Container[int]) -> bool:
        """Whether this is an HF track whose base is not among the tracks."""
        return self.kind == "hf" and self.unsupported is None and self.base not in tracks

    def fits(self, before: Track) -> bool:
        """Whether this track can continue another one (TRK-016)."""
        return (
            {self.kind, before.kind} <= {"full", "lf"}
            and self.id > before.id
            and (self.channels, self.rate) == (before.channels, before.rate)
            and self.number_format == before.number_format
            and [(c.calibration, c.unit) for c in self.components]
            == [(c.calibration, c.unit) for c in before.components]
        )


def complete(tracks: Iterable[Track]) -> bool:
    """Whether these may be the tracks of a closed file (TRK-010, TRK-012)."""
    tracks = list(tracks)
    return paired(tracks) and not missing_channels(tracks)


def paired(tracks: Sequence[Track]) -> bool:
    """Whether every LF track has its HF track (TRK-012)."""
    bases = {track.base for track in tracks}
    return all(track.kind != "lf" or track.id in bases for track in tracks)


def missing_channels(tracks: Iterable[Track]) -> list[int]:
    """Numbers below the highest that no track has (TRK-010)."""
    # A track of a kind that is not known here has its numbers too.
    owners = (track for track in tracks if track.kind not in ("hf", "events"))
    numbers = {n for track in owners for n in track.channels}
    return [n for n in range(max(numbers, default=-1) + 1) if n not in numbers]


def silent_tracks(tracks: Sequence[Track]) -> list[Track]:
    """Empty tracks for channel numbers that were left out: in a closed file there is no hole."""
    free = max((track.id for track in tracks), default=-1) + 1
    component = Component(label="(never recorded)")
    return [
        Track(free + place, "full", "KNOT", Fraction(1), number, (component,), b"\0\0\0\1\0")
        for place, number in enumerate(missing_channels(tracks))
    ]


def lone_lf(track: Track) -> FormatError:
    return FormatError(
        f"LF track {track.id} without an HF track", requirement="TRK-012", offset=track.offset
    )


def unsupported_track(track: Track, path: str | None = None) -> UnsupportedError:
    """The error for a track with an unknown part; it names the part and the rule."""
    what, rule = (track.unsupported or "nothing []")[:-1].rsplit(" [", 1)
    return UnsupportedError(
        f"track {track.id} needs {what}", requirement=rule, offset=track.offset, path=path
    )


def taken(track: Track) -> FormatError:
    return FormatError(
        f"channel number of track {track.id} is taken", requirement="TRK-010", offset=track.offset
    )


def unlike(track: Track) -> FormatError:
    return FormatError(
        f"track {track.id} cannot continue track {track.continues}",
        requirement="TRK-016",
        offset=track.offset,
    )


class TrackTable:
    """The tracks described so far, and what must hold between them (TRK-003, 007, 010 and 016)."""

    def __init__(self) -> None:
        self.tracks: dict[int, Track] = {}
        self.payloads: dict[int, bytes] = {}
        self.channels: set[int] = set()
        self.bases: set[int] = set()
        self.continued: set[int] = set()

    def is_new(self, first_id: int, payload: bytes, offset: int) -> bool:
        """False for an exact copy of a TRAK payload that is known already."""
        if self.payloads.setdefault(first_id, payload) is payload:
            return True
        if self.payloads[first_id] != payload:
            raise self.twice(first_id, offset)
        return False

    def twice(self, id_: int, offset: int) -> FormatError:
        return FormatError(
            f"track {id_} described twice, differently", requirement="TRK-003", offset=offset
        )

    def add(self, tracks: Sequence[Track], *, damaged: bool = False) -> None:
        """``damaged``: tracks may be lost, so what must hold between them is checked at the end, by
        ``drop_strangers``."""
        for track in tracks:
            if track.id in self.tracks:
                raise self.twice(track.id, track.offset)
        for track in tracks:
            if not damaged:
                self.check(track)
            if track.continues is not None:
                if track.unsupported is None:
                    self.continued.add(track.continues)
            else:
                self.channels.update(track.channels)
            if track.kind == "hf" and track.base is not None:
                self.bases.add(track.base)
            self.tracks[track.id] = track

    def check(self, track: Track) -> None:
        """TRK-007, 010 and 016: what must hold between a new track and those before it."""
        id_ = track.base if track.continues is None else track.continues
        linked = None if id_ is None else self.tracks.get(id_)
        if track.unsupported is not None:
            # An unknown part comes before a broken rule (clause 13).
            return
        alone = linked is not None and linked.unsupported is not None
        if track.kind == "hf":
            if not alone:
                self.check_base(track)
        elif track.continues is not None:
            if not alone:
                self.check_continued(track)
        elif not self.channels.isdisjoint(track.channels):
            raise taken(track)

    def chains(self) -> list[list[Track]]:
        """Tracks of channels but for HF, those that continue one another together, by their ids;
        unsupported ones come last.

        They share their channel numbers, and nothing else does: so a lost one breaks no chain. One
        that does not fit can only be an unsupported one, of which nothing was checked.
        """
        chains = []
        for alike in self.of_one_channel():
            first, *others = sorted(alike, key=lambda track: track.unsupported is not None)
            chain = [first]
            chain += [track for track in others if track.fits(first) or first.fits(track)]
            chains.append(chain)
        return chains

    def of_one_channel(self) -> list[list[Track]]:
        found: dict[int, list[Track]] = {}
        for id_ in sorted(self.tracks):
            track = self.tracks[id_]
            if track.kind not in ("hf", "events"):
                found.setdefault(track.first_channel, []).append(track)
        return list(found.values())

    def drop_strangers(self) -> list[FormatError]:
        """In a damaged file: drops tracks that do not fit those that are left with smaller ids
        (SPEC 14.1)."""
        dropped: list[FormatError] = []
        last: dict[int, Track] = {}
        owned: set[int] = set()
        supported: set[int] = set()
        self.bases.clear()
        tracks = [self.tracks[id_] for id_ in sorted(self.tracks)]
        for track in [track for track in tracks if track.kind not in ("hf", "events")]:
            error = self.stranger(track, last.get(track.first_channel), owned, supported)
            if error is not None:
                del self.tracks[track.id]
                dropped.append(error)
                continue
            owned.update(track.channels)
            if track.unsupported is None:
                supported.update(track.channels)
                last[track.first_channel] = track
        for track in [track for track in tracks if track.kind == "hf"]:
            try:
                if track.unsupported is None and self.knows(track.base):
                    self.check_base(track)
            except FormatError as error:
                del self.tracks[track.id]
                dropped.append(error)
                continue
            if track.unsupported is None and track.base is not None:
                self.bases.add(track.base)
        return dropped

    def knows(self, id_: int | None) -> bool:
        """Whether the track is there and supported: to others, one that is not is like a lost
        one."""
        track = self.tracks.get(-1 if id_ is None else id_)
        return track is not None and track.unsupported is None

    def stranger(
        self, track: Track, before: Track | None, owned: set[int], supported: set[int]
    ) -> FormatError | None:
        """Why a track does not fit ``before``, the last supported one with its first channel."""
        if track.unsupported is not None:
            free = track.continues is not None or owned.isdisjoint(track.channels)
            return None if free else taken(track)
        if before is not None and track.continues is not None:
            other = self.knows(track.continues) and track.continues != before.id
            return unlike(track) if other or not track.fits(before) else None
        if self.knows(track.continues):
            return unlike(track)
        numbers = owned if track.continues is None else supported
        return None if numbers.isdisjoint(track.channels) else taken(track)

    def check_continued(self, track: Track) -> None:
        before = self.tracks.get(-1 if track.continues is None else track.continues)
        if before is None or track.continues in self.continued or not track.fits(before):
            raise unlike(track)

    def check_base(self, track: Track) -> None:
        base = self.tracks.get(-1 if track.base is None else track.base)
        alike = base is not None and (
            base.kind == "lf"
            and base.rate == track.rate
            and base.first_channel == track.first_channel
            and len(base.components) == len(track.components)
        )
        if not alike or track.base in self.bases:
            raise FormatError(
                f"HF track {track.id} does not match its base track {track.base}",
                requirement="TRK-007",
                offset=track.offset,
            )
        reach = max(abs(track.count_min), abs(track.count_max))
        if base and reach * max(abs(c.calibration.a) for c in base.components) > EXACT_LIMIT:
            raise FormatError(
                "count * A above 2^53 within the declared range of an HF track",
                requirement="VAL-001",
                offset=track.offset,
            )
