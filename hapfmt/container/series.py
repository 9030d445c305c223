"""TRAK payload <-> tracks (SPEC 6.2, 6.3, clauses 8 and 11).

What this reader does not understand of a track does not stop it: ``Track.unsupported`` says what.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

from ..errors import FormatError, ParameterError
from ..limits import EXACT_LIMIT, LAST_TRACK_ID, Level
from .layout import TRAK
from .lists import (
    Range,
    Setup,
    build_calibration,
    build_channels,
    build_continued,
    build_contracts,
    build_deviation,
    build_range,
    build_setups,
    entries_of,
    parse_calibration,
    parse_channels,
    parse_continued,
    parse_contract,
    parse_deviation,
    parse_ranges,
    parse_setups,
)
from .tlv import build_strings, build_tlvs, parse_strings, parse_text, parse_tlvs, share, spread
from .track import (
    CODECS,
    IDENTITY,
    KINDS,
    NUMBER_FORMATS,
    SERIES_SIZE,
    Affine,
    Component,
    Contract,
    Track,
)
from .wire import NO_TRACK, build_fields, parse_fixed

PARAMETERS, LABEL, CALIBRATIONS, UNIT, SETUPS, QUANTITY, RANGES = 1, 2, 3, 4, 5, 6, 7
AXIS, CHANNELS, GROUP, CONTINUED, BODY_SITE, DEVICE, CONTRACT = 8, 9, 10, 11, 12, 14, 16
DEVIATIONS, WEIGHTS, PROVENANCE = 18, 20, 22
OF_EVENTS = (LABEL, DEVICE, PROVENANCE)
CRITICAL = (PARAMETERS, CALIBRATIONS, SETUPS, RANGES, CHANNELS, CONTINUED)
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
RANGE_OFFSET, CHANNEL_OFFSET = 16, 24
"""Of count_min and first_channel in the layout."""

Tlvs = dict[int, tuple[int, bytes]]


def build_series(series: Sequence[Track]) -> bytes:
    """The TRAK payload of tracks that ``series_of`` put together."""
    first = series[0]
    components = [component for track in series for component in track.components]
    if len(components) > SERIES_SIZE:
        raise ParameterError("a track has at most 255 components")
    values = build_what_differs(series)
    if first.base is None:
        values |= build_described(components)
    if any(track.contract for track in series):
        values[CONTRACT] = build_contracts([track.contract for track in series])
    if first.provenance:
        values[PROVENANCE] = first.provenance.encode("utf-8")
    fixed = build_fields(
        TRAK,
        {
            "track_count": len(series),
            "component_count": len(first.components),
            "kind": KINDS.index(first.kind),
            "number_format": NUMBER_FORMATS.index(first.number_format),
            "codec": first.codec.encode("latin-1"),
            "rate_num": first.rate.numerator,
            "rate_den": first.rate.denominator,
            "count_min": min(track.count_min for track in series),
            "count_max": max(track.count_max for track in series),
            "first_channel": first.first_channel,
            "base": NO_TRACK if first.base is None else first.base,
        },
    )
    return fixed + build_tlvs(values)


def build_what_differs(series: Sequence[Track]) -> dict[int, bytes]:
    """Codec parameters, and what a track may have of its own: TLVs 1, 5, 7, 9 and 11."""
    first, values = series[0], {}
    if len({(track.codec, track.parameters) for track in series}) > 1:
        values[SETUPS] = build_setups(series)
    elif first.parameters:
        values[PARAMETERS] = first.parameters
    if len({(track.count_min, track.count_max) for track in series}) > 1:
        values[RANGES] = b"".join(build_range(t.count_min, t.count_max) for t in series)
    firsts = [track.first_channel for track in series]
    in_order = follow_on(firsts[0], len(first.components), len(series))
    if firsts != in_order and first.kind != "events":
        values[CHANNELS] = build_channels(firsts)
    if any(track.continues is not None for track in series):
        values[CONTINUED] = build_continued([track.continues for track in series])
    return values


def follow_on(first: int, step: int, count: int) -> list[int]:
    return [first + step * i for i in range(count)]


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


def parse_series(payload: bytes, first_id: int, level: Level, offset: int) -> list[Track]:
    """The tracks of a TRAK payload that stands at ``offset``; its header names ``first_id``."""
    raw = parse_fixed(TRAK, payload, 0, "TLV-002", offset)
    if min(raw.track_count, raw.component_count, raw.rate_num, raw.rate_den) < 1:
        raise FormatError("a count or a rate of 0", requirement="TRK-002", offset=offset)
    count, size = raw.track_count, raw.component_count
    if count * size > SERIES_SIZE:
        raise FormatError(
            f"{count * size} components in one series", requirement="TRK-002", offset=offset
        )
    if first_id + count - 1 > LAST_TRACK_ID:
        raise FormatError("track id above 65533", requirement="TRK-003", offset=offset)
    tlvs = parse_tlvs(payload, TRAK.sizeof(), offset)
    setups = setups_of(raw, tlvs)
    ranges = ranges_of(raw, tlvs, offset)
    firsts = channels_of(raw, tlvs, offset)
    unknown = find_unsupported(raw, tlvs)
    kind = KINDS[raw.kind] if raw.kind < len(KINDS) else f"kind {raw.kind}"
    format_ = (
        NUMBER_FORMATS[raw.number_format]
        if raw.number_format < len(NUMBER_FORMATS)
        else f"format {raw.number_format}"
    )
    base = None if raw.base == NO_TRACK else raw.base
    components = tuple(parse_components(tlvs, count * size))
    contracts = contracts_of(tlvs, count, size)
    at, value = tlvs.get(CONTINUED, (0, bytes(count)))
    continued = parse_continued(value, at, count)
    text_offset, text = tlvs.get(PROVENANCE, (0, b""))
    tracks = [
        Track(
            id=first_id + i,
            kind=kind,
            codec=setups[i][0].decode("latin-1"),
            rate=Fraction(raw.rate_num, raw.rate_den),
            first_channel=firsts[i],
            components=components[i * size : (i + 1) * size],
            parameters=setups[i][1],
            number_format=format_,
            count_min=ranges[i][0],
            count_max=ranges[i][1],
            base=None if base is None else base + i,
            continues=continued[i],
            contract=contracts[i],
            provenance=parse_text(text, text_offset),
            unsupported=unknown or unknown_codec(setups[i][0]),
            offset=offset,
        )
        for i in range(count)
    ]
    for track in tracks:
        if track.unsupported is None:
            check_kind(track, tlvs, level, offset)
            check_exact(track, offset)
    return tracks


def setups_of(raw: Any, tlvs: Tlvs) -> list[Setup]:
    """TRK-013."""
    if SETUPS not in tlvs:
        return [(raw.codec, tlvs.get(PARAMETERS, (0, b""))[1])] * int(raw.track_count)
    offset, value = tlvs[SETUPS]
    setups = parse_setups(value, offset, raw.track_count)
    if PARAMETERS in tlvs or setups[0][0] != raw.codec:
        raise FormatError(
            "setups together with other codec parameters, or another first codec",
            requirement="TRK-013",
            offset=offset,
        )
    return setups


def ranges_of(raw: Any, tlvs: Tlvs, offset: int) -> list[Range]:
    """TRK-014."""
    hull = raw.count_min, raw.count_max
    if RANGES not in tlvs:
        return [hull] * int(raw.track_count)
    at, value = tlvs[RANGES]
    ranges = parse_ranges(value, at, raw.track_count)
    if hull != (min(low for low, _ in ranges), max(high for _, high in ranges)):
        raise FormatError(
            "count_min and count_max are not the ends of all ranges",
            requirement="TRK-014",
            offset=offset + RANGE_OFFSET,
        )
    return ranges


def channels_of(raw: Any, tlvs: Tlvs, offset: int) -> list[int]:
    """The first channel number of each track (TRK-010, TRK-015)."""
    count, size = raw.track_count, raw.component_count
    if raw.kind == KINDS.index("events"):
        return [int(raw.first_channel)] * int(count)
    if CHANNELS in tlvs:
        at, value = tlvs[CHANNELS]
        firsts = parse_channels(value, at, count)
        if firsts[0] != raw.first_channel:
            raise FormatError(
                "first_channel and the list of channels differ", requirement="TRK-015", offset=at
            )
    else:
        at, firsts = offset + CHANNEL_OFFSET, follow_on(raw.first_channel, size, count)
    if max(firsts) + size > NO_TRACK:
        raise FormatError("channel number above 65534", requirement="TRK-010", offset=at)
    return firsts


def contracts_of(tlvs: Tlvs, count: int, size: int) -> Sequence[Contract | None]:
    if CONTRACT not in tlvs:
        return [None] * count
    offset, value = tlvs[CONTRACT]
    found = list(entries_of(value, offset, lambda cursor: parse_contract(cursor, size)))
    return spread(found, count, offset)


def find_unsupported(raw: Any, tlvs: Tlvs) -> str | None:
    """What of all tracks this reader does not know (TRK-004, TLV-003)."""
    if raw.kind >= len(KINDS):
        return f"kind {raw.kind} [TRK-004]"
    if raw.number_format >= len(NUMBER_FORMATS):
        return f"number format {raw.number_format} [TRK-004]"
    critical = [type_ for type_ in tlvs if type_ % 2 and type_ not in CRITICAL]
    return f"critical TLV {critical[0]} [TLV-003]" if critical else None


def unknown_codec(codec: bytes) -> str | None:
    """TRK-011."""
    if codec in [name.encode() for name in CODECS]:
        return None
    return f"codec {codec.decode('latin-1')!r} [TRK-011]"


def check_range(track: Track, level: Level, offset: int) -> None:
    """TRK-005."""
    low, high, hf = track.count_min, track.count_max, track.kind == "hf"
    bound = 1 << ((level.residual_bits if hf else level.count_bits) - 1)
    if low > high or low < -bound or high >= bound:
        raise FormatError(
            f"declared range {low} to {high} does not fit level {level.number}",
            requirement="TRK-005",
            offset=offset + RANGE_OFFSET,
        )


def check_kind(track: Track, tlvs: Tlvs, level: Level, offset: int) -> None:
    """TRK-005 to TRK-009 and TRK-019, as far as one chunk tells."""
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
    if hf and track.base is None:
        raise FormatError(
            "HF track without a base track", requirement="TRK-007", offset=offset + 26
        )
    if not hf and track.base is not None:
        raise FormatError(
            "base track named by a track that is not HF", requirement="TRK-008", offset=offset + 26
        )
    if hf and track.continues is not None:
        raise FormatError(
            "an HF track that continues another", requirement="TRK-016", offset=offset
        )
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
    if len(track.components) != 1 or not of_counts or track.first_channel != NO_TRACK:
        raise FormatError(
            "a layer of events with components, numbers or channels",
            requirement="TRK-019",
            offset=offset,
        )
    beside = [type_ for type_ in tlvs if type_ <= PROVENANCE and type_ not in OF_EVENTS]
    if beside:
        raise FormatError(
            f"TLV {beside[0]} in a layer of events", requirement="TRK-019", offset=offset
        )


def check_exact(track: Track, offset: int) -> None:
    """VAL-002."""
    ends = (track.count_min, track.count_max)
    for a, b, _ in {component.calibration for component in track.components}:
        if max(max(abs(end * a), abs(end * a + b)) for end in ends) > EXACT_LIMIT:
            raise FormatError(
                "count * A + B above 2^53 within the declared range",
                requirement="VAL-002",
                offset=offset,
            )


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
