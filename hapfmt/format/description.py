"""TRAK payload <-> tracks (SPEC 6.2, 6.3, clauses 8 and 11).

A track with parts that this reader does not understand is still parsed: ``Track.unsupported`` names
these parts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

from ..errors import FormatError, ParameterError
from ..limits import EXACT_LIMIT, LAST_TRACK_ID, Level
from ..numbers import build_varint, parse_varint
from .deflate import deflate, inflate
from .layout import TRACK
from .lists import (
    build_calibration,
    build_contract,
    build_deviation,
    entries_of,
    parse_calibration,
    parse_contract,
    parse_deviation,
)
from .tlv import (
    Tlvs,
    build_strings,
    build_tlvs,
    parse_strings,
    parse_text,
    parse_tlv,
    share,
    spread,
)
from .track import (
    CODECS,
    COMPONENTS,
    IDENTITY,
    KINDS,
    NUMBER_FORMATS,
    Affine,
    Component,
    Contract,
    Track,
)
from .wire import NO_TRACK

PARAMETERS, LABEL, CALIBRATIONS, UNIT, QUANTITY, AXIS, GROUP = 1, 2, 3, 4, 6, 8, 10
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
INHERITED = frozenset(STRINGS) | {CALIBRATIONS, DEVIATIONS}
KNOWN = INHERITED | {PARAMETERS, CONTRACT, PROVENANCE}
CHUNK_SIZE = 1 << 16
"""Bytes of uncompressed tracks per chunk; further tracks go into the next chunk."""

Record = tuple[Track, bytes]
"""A track and its bytes in TRAK."""


def build_description(tracks: Sequence[Track]) -> bytes:
    """The TRAK payload of tracks whose ids follow on."""
    return pack(b"".join(map(build_track, tracks)))


def pack(plain: bytes) -> bytes:
    """The payload uncompressed, or as a DEFLATE stream if that is shorter."""
    packed = build_varint(len(plain)) + deflate(plain)
    return packed if len(packed) <= len(plain) else b"\0" + plain


def chunks_of(records: Iterable[Record]) -> Iterator[tuple[bytes, list[Track]]]:
    """TRAK payloads of tracks, and which they describe: those whose ids follow on together, as far
    as one chunk has room."""
    tracks: list[Track] = []
    plain, components = b"", 0
    for track, record in records:
        components += len(track.components)
        fits = components <= COMPONENTS and len(plain) + len(record) <= CHUNK_SIZE
        if tracks and not (fits and track.id == tracks[-1].id + 1):
            yield pack(plain), tracks
            tracks, plain, components = [], b"", len(track.components)
        tracks.append(track)
        plain += record
    if tracks:
        yield pack(plain), tracks


def build_track(track: Track) -> bytes:
    values = dict(track.unknown)
    if track.parameters:
        values[PARAMETERS] = track.parameters
    if track.base is None:
        values |= build_described(track.components)
    if track.contract:
        values[CONTRACT] = build_contract(track.contract)
    if track.provenance:
        values[PROVENANCE] = track.provenance.encode("utf-8")
    if len(track.components) > COMPONENTS:
        raise ParameterError("a track has at most 255 components")
    linked = track.continues if track.base is None else track.base
    fixed = TRACK.pack(
        tlv_count=len(values),
        component_count=len(track.components),
        kind=KINDS.index(track.kind),
        number_format=NUMBER_FORMATS.index(track.number_format),
        codec=track.codec.encode("latin-1"),
        rate_num=track.rate.numerator,
        rate_den=track.rate.denominator,
        count_min=track.count_min,
        count_max=track.count_max,
        first_channel=track.first_channel,
        linked=NO_TRACK if linked is None else linked,
    )
    return fixed + build_tlvs(values)


def build_described(components: Sequence[Component]) -> dict[int, bytes]:
    """What is listed per component."""
    values = {}
    calibrations = share([component.calibration for component in components])
    if list(calibrations) != [IDENTITY]:
        values[CALIBRATIONS] = b"".join(map(build_calibration, calibrations))
    for type_, name in STRINGS.items():
        items = [getattr(component, name) for component in components]
        if any(item != getattr(Component, name) for item in items):
            values[type_] = build_strings(items)
    deviations = share([component.deviation for component in components])
    if any(deviations):
        values[DEVIATIONS] = b"".join(map(build_deviation, deviations))
    return values


def parse_description(payload: bytes, first_id: int, level: Level, offset: int) -> list[Track]:
    """The tracks of a TRAK payload at ``offset``; its header names ``first_id``."""
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
    size, start = parse_varint(payload, 0, offset)
    if not size:
        return payload[start:], offset + start
    # Uncompressed, it must fit a payload too, after one byte.
    level.check("payload_size", size + 1, "TRK-020", offset)
    return inflate(payload[start:], size, "TRK-020", offset + start), offset


def described_size(payload: bytes) -> int:
    """Bytes that the tracks of a TRAK payload take as they are; the payload was parsed before."""
    return parse_varint(payload, 0)[0] or len(payload)


def split(payload: bytes, level: Level, offset: int) -> list[bytes]:
    """The bytes of each track; the payload was parsed before."""
    plain, base = unpack(payload, level, offset)
    places = [place for _, _, place in parse_records(plain, base)]
    return [plain[a:b] for a, b in zip(places, [*places[1:], len(plain)], strict=True)]


def parse_records(plain: bytes, base: int) -> Iterator[tuple[Any, Tlvs, int]]:
    """The fields and TLVs of each track, and where it starts."""
    position = components = 0
    while position < len(plain) or not components:
        start, tlvs = position, Tlvs()
        raw = TRACK.parse(plain, position, "TLV-001" if components else "TRK-002", base)
        components += raw.component_count
        if min(raw.component_count, raw.rate_num, raw.rate_den) < 1 or components > COMPONENTS:
            raise FormatError(
                "no component, more than 255 in one chunk, or a rate of 0",
                requirement="TRK-002",
                offset=base + start,
            )
        position += TRACK.size
        for _ in range(raw.tlv_count):
            position = parse_tlv(plain, position, base, tlvs)
        yield raw, tlvs, start


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
            check_exact(track, base + start)
        yield track


def parse_track(raw: Any, tlvs: Tlvs, id_: int, at: int, offset: int) -> Track:
    """The track at offset ``at``, from its fields and TLVs."""
    kind = KINDS[raw.kind] if raw.kind < len(KINDS) else f"kind {raw.kind}"
    format_ = (
        NUMBER_FORMATS[raw.number_format]
        if raw.number_format < len(NUMBER_FORMATS)
        else f"format {raw.number_format}"
    )
    size = raw.component_count
    if kind != "events" and raw.first_channel + size > NO_TRACK:
        raise FormatError(
            "channel number above 65534",
            requirement="TRK-010",
            offset=at + TRACK.offsets["first_channel"],
        )
    linked = None if raw.linked == NO_TRACK else raw.linked
    continues = kind in ("full", "lf")
    unsupported = find_unsupported(raw, tlvs)
    described = Described((Component(),) * size)
    try:
        described = parse_described(tlvs, size)
    except FormatError:
        if unsupported is None:
            raise
    return Track(
        id=id_,
        kind=kind,
        codec=raw.codec.decode("latin-1"),
        rate=Fraction(raw.rate_num, raw.rate_den),
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
        unsupported=unsupported,
        unknown=tuple((type_, value) for type_, (_, value) in tlvs.items() if type_ not in KNOWN),
        offset=offset,
    )


def find_unsupported(raw: Any, tlvs: Tlvs) -> str | None:
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
            offset=offset + TRACK.offsets["count_min"],
        )


def check_kind(track: Track, tlvs: Tlvs, level: Level, offset: int) -> None:
    """TRK-005 to TRK-007, TRK-009 and TRK-019, as far as the track tells."""
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


def check_events(track: Track, tlvs: Tlvs, offset: int) -> None:
    """TRK-019."""
    if (track.kind, track.codec) != ("events", "EVNT"):
        raise FormatError(
            f"kind {track.kind} with codec {track.codec}", requirement="TRK-019", offset=offset
        )
    of_counts = track.number_format == "counts" and not (track.count_min or track.count_max)
    alone = track.first_channel == NO_TRACK and track.base is None
    if len(track.components) != 1 or not of_counts or not alone:
        raise FormatError(
            "a layer of events with components, numbers, channels or a linked track",
            requirement="TRK-019",
            offset=offset,
        )
    beside = [type_ for type_ in tlvs if type_ <= PROVENANCE and type_ not in OF_EVENTS]
    if beside:
        raise FormatError(
            f"TLV {beside[0]} in a layer of events", requirement="TRK-019", offset=offset
        )


def check_exact(track: Track, offset: int) -> None:
    """VAL-001."""
    ends = (track.count_min, track.count_max)
    for a, b, _ in {component.calibration for component in track.components}:
        if max(max(abs(end * a), abs(end * a + b)) for end in ends) > EXACT_LIMIT:
            raise FormatError(
                "count * A + B above 2^53 within the declared range",
                requirement="VAL-001",
                offset=offset,
            )


class Described(NamedTuple):
    """What the TLVs say of a track."""

    components: tuple[Component, ...]
    contract: Contract | None = None
    provenance: str = ""


def parse_described(tlvs: Tlvs, size: int) -> Described:
    components = tuple(parse_components(tlvs, size))
    contract_at, contract = tlvs.get(CONTRACT, (0, None))
    text_at, text = tlvs.get(PROVENANCE, (0, b""))
    parsed = None if contract is None else parse_contract(contract, contract_at, size)
    return Described(components, parsed, parse_text(text, text_at))


def parse_components(tlvs: Tlvs, count: int) -> Iterator[Component]:
    calibrations: Sequence[Affine] = [IDENTITY] * count
    if CALIBRATIONS in tlvs:
        offset, value = tlvs[CALIBRATIONS]
        calibrations = spread(list(entries_of(value, offset, parse_calibration)), count, offset)
    deviations: Sequence[tuple[float, float] | None] = [None] * count
    if DEVIATIONS in tlvs:
        offset, value = tlvs[DEVIATIONS]
        deviations = spread(list(entries_of(value, offset, parse_deviation)), count, offset)
    strings = {
        name: parse_strings(tlvs[type_][1], count, tlvs[type_][0]) if type_ in tlvs else None
        for type_, name in STRINGS.items()
    }
    for i in range(count):
        named = {name: items[i] for name, items in strings.items() if items}
        yield Component(calibrations[i], deviation=deviations[i], **named)
