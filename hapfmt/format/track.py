"""Tracks: the descriptions of coded streams, their bytes, and the rules between tracks.

SPEC 6.2, 6.3, clauses 8 and 11. A track with parts that this reader does not understand is still
parsed: ``Track.unsupported`` names these parts.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple, TypeVar

from ..errors import FormatError, ParameterError, TruncatedError, UnsupportedError
from ..limits import (
    AFFINE_LIMIT,
    EXACT_LIMIT,
    FRACTION_LIMIT,
    LAST_CHANNEL,
    LAST_TRACK_ID,
    LEVELS,
    SINGLE_MAX,
    ZERO_LIMIT,
    Level,
)
from ..numbers import build_svarint, build_varint, parse_svarint, parse_varint
from .deflate import deflate, inflate
from .layout import DEVIATION
from .wire import (
    Tlvs,
    build_strings,
    build_tlvs,
    parse_strings,
    parse_text,
    parse_tlv,
    share,
    spread,
)

KINDS = ("full", "lf", "hf", "events")
NUMBER_FORMATS = ("counts", "int64", "uint64", "binary16", "binary32", "binary64")
WORD_SIZES = {"int64": 8, "uint64": 8, "binary16": 2, "binary32": 4, "binary64": 8}
CODECS = ("KNOT", "QUAN", "RAWB", "LPCR", "LPCX", "MDCT", "EVNT", "NOIS")
SYNTHETIC = "NOIS"
"""Its counts come from a model of the texture (SPEC 9.10)."""

COMPONENTS = 255
"""Most components of a track, and of all tracks of a TRAK chunk (TRK-002)."""


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
    further: tuple[int, ...] = ()
    """Channel numbers of the components after the first; (): the next ones."""
    unsupported: str | None = None
    unknown: tuple[tuple[int, bytes], ...] = ()
    """TLVs that this reader does not know, by type."""
    offset: int = 0
    """Offset of the TRAK payload in the file."""

    def numbered(self, id_: int, base: int | None) -> Track:
        """The same with this id, and that of its base: dataclasses.replace() takes longer."""
        track = object.__new__(Track)
        vars(track).update(vars(self), id=id_, base=base)
        return track

    @property
    def channels(self) -> Sequence[int]:
        if self.kind == "events":
            return range(0)
        if self.further:
            return self.first_channel, *self.further
        return range(self.first_channel, self.first_channel + len(self.components))

    @property
    def synthetic(self) -> bool:
        """Whether the counts come from a model of the texture."""
        return self.codec == SYNTHETIC

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
            and self.rate == before.rate
            and [*self.channels] == [*before.channels]
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
        self.bases: set[int] = set()
        self.changes = 0
        """How often tracks were added."""
        self.forget()

    def forget(self) -> None:
        """Forget whose the channel numbers are."""
        self.owned: set[int] = set()
        self.supported: set[int] = set()
        self.last: dict[int, Track] = {}
        """The last supported track of each first channel."""

    def is_new(self, payload: bytes, offset: int) -> bool:
        """False for an exact copy of a TRAK payload that is known already."""
        first_id = first_of(payload, offset)
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
            if track.kind == "hf" and track.base is not None:
                self.bases.add(track.base)
            self.tracks[track.id] = track
        self.changes += 1

    def check(self, track: Track) -> None:
        """TRK-007, 010 and 016: what must hold between a new track and those before it."""
        if track.unsupported is not None:
            # An unknown part comes before a broken rule (clause 13).
            if track.kind != "hf":
                self.owned.update(track.channels)
        elif track.kind == "hf":
            base = self.tracks.get(-1 if track.base is None else track.base)
            if base is None or base.unsupported is None:
                self.check_base(track)
        elif track.continues is not None and track.continues not in self.tracks:
            raise unlike(track)
        elif track.kind != "events":
            self.place(track)

    def chains(self) -> list[list[Track]]:
        """Tracks of channels but for HF, those that continue one another together, by their ids;
        unsupported ones come last.

        They share their channel numbers, and nothing else does: so a lost one breaks no chain. One
        that does not fit can only be an unsupported one, of which nothing was checked.
        """
        chains = []
        for alike in self.of_one_channel():
            if len(alike) == 1:
                chains.append(alike)
                continue
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
        (SPEC 14.2)."""
        dropped: list[FormatError] = []
        self.forget()
        self.bases.clear()
        tracks = [self.tracks[id_] for id_ in sorted(self.tracks)]
        for track in [track for track in tracks if track.kind not in ("hf", "events")]:
            try:
                self.place(track)
            except FormatError as error:
                del self.tracks[track.id]
                dropped.append(error)
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

    def place(self, track: Track) -> None:
        """Give a track of another kind than HF and events its channels, where it fits the tracks
        before it: the last supported one with its first channel, and the owners of the others."""
        before, known = self.last.get(track.first_channel), self.knows(track.continues)
        numbers = self.owned if track.continues is None else self.supported
        if track.unsupported is not None:
            if track.continues is None and not numbers.isdisjoint(track.channels):
                raise taken(track)
        elif before is not None and track.continues is not None:
            if (known and track.continues != before.id) or not track.fits(before):
                raise unlike(track)
        elif known:
            raise unlike(track)
        elif not numbers.isdisjoint(track.channels):
            raise taken(track)
        self.owned.update(track.channels)
        if track.unsupported is None:
            self.supported.update(track.channels)
            self.last[track.first_channel] = track

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


T = TypeVar("T")
FLOOR_LIMIT = 1 << 32
VECTOR, GUARANTEED = 1, 2


def build_contract(contract: Contract) -> bytes:
    flags = contract.vector * VECTOR | contract.guaranteed * GUARANTEED
    out = build_varint(contract.kn) + build_varint(contract.kd) + bytes([flags])
    for floor, zero in zip(contract.floor, contract.zero, strict=True):
        out += build_varint(floor) + build_svarint(zero)
    return out


def parse_contract(value: bytes, offset: int, size: int) -> Contract:
    """The error bounds of a track with ``size`` components."""
    kn, position = parse_varint(value, 0, offset)
    kd, position = parse_varint(value, position, offset)
    if position == len(value):
        raise TruncatedError(
            "a list ends within an entry", requirement="TLV-004", offset=offset + position
        )
    flags, position = value[position], position + 1
    pairs: list[tuple[int, int]] = []
    for _ in range(size):
        floor, position = parse_varint(value, position, offset)
        zero, position = parse_svarint(value, position, offset)
        pairs.append((floor, zero))
    if position < len(value):
        raise FormatError(
            "bytes left over after a list", requirement="TLV-004", offset=offset + position
        )
    fits = kd and max(kn, kd) < FRACTION_LIMIT and flags <= VECTOR | GUARANTEED
    fits = fits and all(1 <= floor < FLOOR_LIMIT for floor, _ in pairs)
    if not fits or any(not -ZERO_LIMIT <= zero < ZERO_LIMIT for _, zero in pairs):
        raise FormatError(
            "a deadband that is out of its bounds", requirement="DBC-001", offset=offset
        )
    return Contract(
        kn,
        kd,
        bool(flags & VECTOR),
        bool(flags & GUARANTEED),
        tuple(floor for floor, _ in pairs),
        tuple(zero for _, zero in pairs),
    )


def round_up(x: float) -> float:
    """The smallest binary32 that is at least x."""
    if not 0 <= x <= SINGLE_MAX:
        raise ParameterError(f"a deviation lies between 0 and {SINGLE_MAX:.4g}, unlike {x}")
    bits = struct.pack("<f", x)
    if struct.unpack("<f", bits)[0] < x:
        bits = (int.from_bytes(bits, "little") + 1).to_bytes(4, "little")
    found: float = struct.unpack("<f", bits)[0]
    return found


def build_deviation(deviation: tuple[float, float] | None) -> bytes:
    declared, largest = deviation or (0.0, 0.0)
    return DEVIATION.build(declared=round_up(declared), largest=round_up(largest))


def parse_calibrations(value: bytes, offset: int) -> list[Affine]:
    """TLV 3."""
    found: list[Affine] = []
    position = 0
    while position < len(value):
        at = offset + position
        a, position = parse_svarint(value, position, offset)
        b, position = parse_svarint(value, position, offset)
        d, position = parse_varint(value, position, offset)
        if not d or not a or max(abs(a), abs(b)) >= AFFINE_LIMIT:
            raise FormatError("calibration out of its bounds", requirement="VAL-001", offset=at)
        found.append(Affine(a, b, d))
    return found


def parse_deviations(value: bytes, offset: int) -> list[tuple[float, float] | None]:
    """TLV 18."""
    found: list[tuple[float, float] | None] = []
    for position in range(0, len(value), DEVIATION.size):
        at = offset + position
        if position + DEVIATION.size > len(value):
            raise TruncatedError("a list ends within an entry", requirement="TLV-004", offset=at)
        raw = DEVIATION.read(value, position)
        if not (math.isfinite(raw.declared) and 0 <= raw.largest <= raw.declared):
            raise FormatError("deviation above the declared one", requirement="TLV-005", offset=at)
        found.append((raw.declared, raw.largest) if raw.declared else None)
    return found


PARAMETERS, LABEL, CALIBRATIONS, UNIT, CHANNELS, QUANTITY, AXIS, GROUP = 1, 2, 3, 4, 5, 6, 8, 10
BODY_SITE, DEVICE, CONTRACT, DEVIATIONS, WEIGHTS, PROVENANCE = 12, 14, 16, 18, 20, 22
OF_EVENTS = (LABEL, DEVICE, PROVENANCE)
STRINGS = {
    LABEL: "label",
    UNIT: "unit",
    QUANTITY: "quantity",
    AXIS: "axis",
    GROUP: "group",
    BODY_SITE: "body_site",
    DEVICE: "device",
}
UNDESCRIBED = {name: getattr(Component, name) for name in STRINGS.values()}
INHERITED = frozenset(STRINGS) | {CALIBRATIONS, DEVIATIONS}
KNOWN = INHERITED | {PARAMETERS, CHANNELS, CONTRACT, PROVENANCE}
CHUNK_SIZE = 1 << 16
"""Bytes of uncompressed tracks per chunk; further tracks go into the next chunk."""

Record = tuple[Track, bytes]
"""A track and its bytes in TRAK."""


class TrackFields(NamedTuple):
    """A track's fields before its TLVs (SPEC 6.3); ``linked`` 0: no other track."""

    kind: int
    number_format: int
    codec: bytes
    component_count: int
    rate_num: int
    rate_den: int
    count_min: int
    count_max: int
    first_channel: int
    linked: int
    tlv_count: int


RATE_LIMIT = 1 << 32
CODEC_STOP = 6
"""Bytes of a track up to its component count."""


def build_description(tracks: Sequence[Track]) -> bytes:
    """The TRAK payload of tracks whose ids follow on."""
    return pack(tracks[0].id, b"".join(map(build_track, tracks)))


def pack(first_id: int, plain: bytes) -> bytes:
    """The payload uncompressed, or as a DEFLATE stream if that is shorter, and TRK-020 allows it at
    any level."""
    packed = build_varint(len(plain)) + deflate(plain)
    fits = len(plain) < LEVELS[1].payload_size
    least = packed if fits and len(packed) <= len(plain) else b"\0" + plain
    return build_varint(first_id) + least


def chunks_of(records: Iterable[Record]) -> Iterator[tuple[bytes, list[Track]]]:
    """TRAK payloads of tracks, and which they describe: those whose ids follow on together, as far
    as one chunk has room."""
    tracks: list[Track] = []
    plain, components = b"", 0
    for track, record in records:
        components += len(track.components)
        fits = components <= COMPONENTS and len(plain) + len(record) <= CHUNK_SIZE
        if tracks and not (fits and track.id == tracks[-1].id + 1):
            yield pack(tracks[0].id, plain), tracks
            tracks, plain, components = [], b"", len(track.components)
        tracks.append(track)
        plain += record
    if tracks:
        yield pack(tracks[0].id, plain), tracks


def build_track(track: Track) -> bytes:
    values = dict(track.unknown)
    if track.parameters:
        values[PARAMETERS] = track.parameters
    if track.base is None:
        calibrations = share([component.calibration for component in track.components])
        if list(calibrations) != [IDENTITY]:
            values[CALIBRATIONS] = b"".join(
                build_svarint(a) + build_svarint(b) + build_varint(d) for a, b, d in calibrations
            )
        described = [vars(component) for component in track.components]
        for type_, name in STRINGS.items():
            items = [each[name] for each in described]
            if items.count(UNDESCRIBED[name]) < len(items):
                values[type_] = build_strings(items)
        deviations = share([component.deviation for component in track.components])
        if any(deviations):
            values[DEVIATIONS] = b"".join(map(build_deviation, deviations))
    if track.further:
        values[CHANNELS] = b"".join(number.to_bytes(2, "little") for number in track.further)
    if track.contract:
        values[CONTRACT] = build_contract(track.contract)
    if track.provenance:
        values[PROVENANCE] = track.provenance.encode("utf-8")
    if len(track.components) > COMPONENTS:
        raise ParameterError("a track has at most 255 components")
    linked = track.continues if track.base is None else track.base
    return (
        bytes([KINDS.index(track.kind) | NUMBER_FORMATS.index(track.number_format) << 4])
        + track.codec.encode("latin-1")
        + bytes([len(track.components)])
        + build_varint(track.rate.numerator)
        + build_varint(track.rate.denominator)
        + build_svarint(track.count_min)
        + build_svarint(track.count_max)
        + build_varint(track.first_channel)
        + build_varint(0 if linked is None else linked + 1)
        + bytes([len(values)])
        + build_tlvs(values)
    )


def first_of(payload: bytes, offset: int = 0) -> int:
    """The id of the first track of a TRAK payload at ``offset``."""
    first_id, _ = parse_varint(payload, 0, offset)
    if first_id > LAST_TRACK_ID:
        raise FormatError("track id above 65533", requirement="TRK-003", offset=offset)
    return first_id


def parse_description(payload: bytes, level: Level, offset: int) -> list[Track]:
    """The tracks of a TRAK payload at ``offset``."""
    first_id = first_of(payload, offset)
    plain, base = unpack(payload, level, offset)
    try:
        return list(parse_tracks(plain, first_id, level, base, offset))
    except FormatError as error:
        if base == offset:
            # Inflated bytes have no offset in the file: name that of the payload.
            error.offset = offset
        raise


def unpack(payload: bytes, level: Level, offset: int) -> tuple[bytes, int]:
    """The uncompressed tracks and their offset; that of the payload if it is DEFLATE (TRK-020)."""
    _, start = parse_varint(payload, 0, offset)
    size, start = parse_varint(payload, start, offset)
    if not size:
        return payload[start:], offset + start
    # Uncompressed, it must fit a payload too, after one byte.
    level.check("payload_size", size + 1, "TRK-020", offset)
    return inflate(payload[start:], size, "TRK-020", offset + start), offset


def described_size(payload: bytes) -> int:
    """Bytes that the tracks of a TRAK payload take as they are; the payload was parsed before."""
    _, start = parse_varint(payload, 0)
    return parse_varint(payload, start)[0] or len(payload)


def split(payload: bytes, level: Level, offset: int) -> list[bytes]:
    """The bytes of each track; the payload was parsed before."""
    plain, base = unpack(payload, level, offset)
    places = [place for _, _, place in parse_records(plain, base)]
    return [plain[a:b] for a, b in zip(places, [*places[1:], len(plain)], strict=True)]


def parse_records(plain: bytes, base: int) -> Iterator[tuple[TrackFields, Tlvs, int]]:
    """The fields and TLVs of each track, and where it starts."""
    position = components = 0
    while position < len(plain) or not components:
        start, tlvs = position, Tlvs()
        if not plain:
            raise FormatError("no track", requirement="TRK-002", offset=base)
        fields, position = parse_fields(plain, position, base)
        components += fields.component_count
        rate = fields.rate_num, fields.rate_den
        if min(fields.component_count, *rate) < 1 or max(rate) >= RATE_LIMIT:
            raise FormatError(
                "no component, or a rate that is not below 2^32 and above 0",
                requirement="TRK-002",
                offset=base + start,
            )
        if components > COMPONENTS:
            raise FormatError(
                "more than 255 components in one chunk", requirement="TRK-002", offset=base + start
            )
        for _ in range(fields.tlv_count):
            position = parse_tlv(plain, position, base, tlvs)
        yield fields, tlvs, start


def parse_fields(plain: bytes, position: int, base: int) -> tuple[TrackFields, int]:
    """The fields of a track and where they end."""
    if position + CODEC_STOP > len(plain):
        raise TruncatedError(
            "the bytes end within a track", requirement="TLV-001", offset=base + position
        )
    codec_at = position + 1
    head = plain[position : position + CODEC_STOP]
    rate_num, position = parse_varint(plain, position + CODEC_STOP, base)
    rate_den, position = parse_varint(plain, position, base)
    count_min, position = parse_svarint(plain, position, base)
    count_max, position = parse_svarint(plain, position, base)
    first_channel, position = parse_varint(plain, position, base)
    linked, position = parse_varint(plain, position, base)
    if position >= len(plain):
        raise TruncatedError(
            "the bytes end within a track", requirement="TLV-001", offset=base + position
        )
    fields = TrackFields(
        head[0] & 15, head[0] >> 4, plain[codec_at : codec_at + 4], head[5], rate_num, rate_den,
        count_min, count_max, first_channel, linked, plain[position],
    )  # fmt: skip
    return fields, position + 1


def parse_tracks(
    plain: bytes, first_id: int, level: Level, base: int, offset: int
) -> Iterator[Track]:
    """The tracks of a payload at ``offset``, parsed and checked."""
    for id_, (raw, tlvs, start) in enumerate(parse_records(plain, base), first_id):
        if id_ > LAST_TRACK_ID:
            raise FormatError("track id above 65533", requirement="TRK-003", offset=offset)
        track = parse_track(raw, tlvs, id_, base + start, offset)
        if track.unsupported is None:
            check_kind(track, tlvs, level, base + start)
        yield track


@lru_cache(maxsize=64)
def fraction(numerator: int, denominator: int) -> Fraction:
    return Fraction(numerator, denominator)


def parse_track(raw: TrackFields, tlvs: Tlvs, id_: int, at: int, offset: int) -> Track:
    """The track at offset ``at``, from its fields and TLVs."""
    kind = KINDS[raw.kind] if raw.kind < len(KINDS) else f"kind {raw.kind}"
    format_ = (
        NUMBER_FORMATS[raw.number_format]
        if raw.number_format < len(NUMBER_FORMATS)
        else f"format {raw.number_format}"
    )
    size = raw.component_count
    linked = raw.linked - 1 if raw.linked else None
    continues = kind in ("full", "lf")
    unsupported = find_unsupported(raw, tlvs)
    described = TrackTlvs((Component(),) * size)
    try:
        described = parse_described(tlvs, size)
    except FormatError:
        if unsupported is None:
            raise
    # Each attribute of a frozen dataclass costs a call where its constructor sets it.
    track = object.__new__(Track)
    track.__dict__.update(
        id=id_,
        kind=kind,
        codec=raw.codec.decode("latin-1"),
        rate=fraction(raw.rate_num, raw.rate_den),
        first_channel=raw.first_channel,
        components=described.components,
        parameters=tlvs.get(PARAMETERS, (0, b""))[1],
        number_format=format_,
        count_min=raw.count_min,
        count_max=raw.count_max,
        base=None if continues else linked,
        continues=linked if continues else None,
        contract=described.contract,
        provenance=described.provenance,
        further=further_of(raw, tlvs, kind, at, supported=unsupported is None),
        unsupported=unsupported,
        unknown=tuple([(type_, value) for type_, (_, value) in tlvs.items() if type_ not in KNOWN]),
        offset=offset,
    )
    return track


def further_of(
    raw: TrackFields, tlvs: Tlvs, kind: str, at: int, *, supported: bool
) -> tuple[int, ...]:
    """TRK-010: the channel numbers of the components after the first, where they are given. What
    gives them for an unsupported track may be anything."""
    found: tuple[int, ...] = ()
    offset, value = tlvs.get(CHANNELS, (0, None))
    if kind == "events":
        return found
    if value is not None:
        if len(value) == 2 * (raw.component_count - 1):
            found = tuple(value[k] + 256 * value[k + 1] for k in range(0, len(value), 2))
        elif supported:
            raise FormatError(
                "channel numbers for another number of components",
                requirement="TLV-004",
                offset=offset,
            )
    numbers = (raw.first_channel, *found)
    last = raw.first_channel + raw.component_count - 1
    if max(*numbers, 0 if found else last) > LAST_CHANNEL:
        raise FormatError(
            "channel number above 65534",
            requirement="TRK-010",
            offset=offset if found else at,
        )
    if len(set(numbers)) < len(numbers):
        raise FormatError(
            "two components with one channel number", requirement="TRK-010", offset=offset
        )
    return found


def find_unsupported(raw: TrackFields, tlvs: Tlvs) -> str | None:
    """The parts of a track that this reader does not know (TRK-011, TLV-003)."""
    if raw.kind >= len(KINDS):
        return f"kind {raw.kind} [TRK-011]"
    if raw.number_format >= len(NUMBER_FORMATS):
        return f"number format {raw.number_format} [TRK-011]"
    critical = [type_ for type_ in tlvs if type_ % 2 and type_ not in KNOWN]
    if critical:
        return f"critical TLV {critical[0]} [TLV-003]"
    codec = raw.codec.decode("latin-1")
    return None if codec in CODECS else f"codec {codec!r} [TRK-011]"


def check_range(track: Track, level: Level, offset: int) -> None:
    """TRK-005."""
    if not track.in_range_of(level):
        raise FormatError(
            f"declared range {track.count_min} to {track.count_max} does not fit "
            f"level {level.number}",
            requirement="TRK-005",
            offset=offset,
        )


def check_kind(track: Track, tlvs: Tlvs, level: Level, offset: int) -> None:
    """TRK-005 to TRK-007, TRK-009, TRK-019 and VAL-001, as far as the track tells."""
    check_range(track, level, offset)
    low, high, hf = track.count_min, track.count_max, track.kind == "hf"
    if track.kind == "events" or track.codec == "EVNT":
        check_events(track, tlvs, offset)
    words = track.number_format != "counts"
    if words and (
        (track.kind, track.codec) != ("full", "RAWB") or low or high or CALIBRATIONS in tlvs
    ):
        raise FormatError(
            "words need kind full band, codec RAWB, range 0, no calibration",
            requirement="TRK-006",
            offset=offset,
        )
    if words and track.contract is not None:
        raise FormatError("an error bound on words", requirement="TRK-006", offset=offset)
    if hf and INHERITED & tlvs.keys():
        raise FormatError(
            "HF track describes what it has from its base", requirement="TRK-009", offset=offset
        )
    if CHANNELS in tlvs and track.kind != "full":
        raise FormatError(
            "channel numbers of a track that is not of kind full band",
            requirement="TRK-009",
            offset=tlvs[CHANNELS][0],
        )
    for a, b, _ in {component.calibration for component in track.components}:
        if max(max(abs(end * a), abs(end * a + b)) for end in (low, high)) > EXACT_LIMIT:
            raise FormatError(
                "count * A + B above 2^53 within the declared range",
                requirement="VAL-001",
                offset=offset,
            )


def check_events(track: Track, tlvs: Tlvs, offset: int) -> None:
    """TRK-019."""
    if (track.kind, track.codec) != ("events", "EVNT"):
        raise FormatError(
            f"kind {track.kind} with codec {track.codec}", requirement="TRK-019", offset=offset
        )
    of_counts = track.number_format == "counts" and not (track.count_min or track.count_max)
    alone = not track.first_channel and track.base is None
    if len(track.components) != 1 or not of_counts or not alone:
        raise FormatError(
            "a layer of events with components, numbers, channels or a linked track",
            requirement="TRK-019",
            offset=offset,
        )
    beside = [type_ for type_ in tlvs if type_ in KNOWN | {WEIGHTS} and type_ not in OF_EVENTS]
    if beside:
        raise FormatError(
            f"TLV {beside[0]} in a layer of events", requirement="TRK-019", offset=offset
        )


class TrackTlvs(NamedTuple):
    """What the TLVs say of a track."""

    components: tuple[Component, ...]
    contract: Contract | None = None
    provenance: str = ""


def parse_described(tlvs: Tlvs, size: int) -> TrackTlvs:
    components = tuple(parse_components(tlvs, size))
    contract_at, contract = tlvs.get(CONTRACT, (0, None))
    text_at, text = tlvs.get(PROVENANCE, (0, b""))
    parsed = None if contract is None else parse_contract(contract, contract_at, size)
    return TrackTlvs(components, parsed, parse_text(text, text_at))


def parse_components(tlvs: Tlvs, count: int) -> Iterator[Component]:
    calibrations: Sequence[Affine] = [IDENTITY] * count
    if CALIBRATIONS in tlvs:
        offset, value = tlvs[CALIBRATIONS]
        calibrations = spread(parse_calibrations(value, offset), count, offset)
    deviations: Sequence[tuple[float, float] | None] = [None] * count
    if DEVIATIONS in tlvs:
        offset, value = tlvs[DEVIATIONS]
        deviations = spread(parse_deviations(value, offset), count, offset)
    strings = {
        name: parse_strings(tlvs[type_][1], count, tlvs[type_][0])
        for type_, name in STRINGS.items()
        if type_ in tlvs
    }
    for i in range(count):
        named = {name: items[i] for name, items in strings.items()}
        yield Component(calibrations[i], deviation=deviations[i], **named)
