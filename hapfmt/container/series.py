"""TRAK payload <-> tracks (SPEC 6.2, 6.3, clauses 8 and 11).

What this reader does not understand of a track does not stop it: ``Track.unsupported`` says what.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

from construct import Struct

from ..errors import FormatError, ParameterError
from ..limits import EXACT_LIMIT, LAST_TRACK_ID, Level
from .layout import CALIBRATION, DEADBAND, DEADBAND_ENTRY, DEVIATION, TRAK
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
from .wire import NO_TRACK, parse_fixed, read_fields, size_of

PARAMETERS, LABEL, CALIBRATIONS, UNIT, QUANTITY, AXIS, GROUP = 1, 2, 3, 4, 6, 8, 10
BODY_SITE, DEVICE, CONTRACT, DEVIATIONS, WEIGHTS, PROVENANCE = 12, 14, 16, 18, 20, 22
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

Tlvs = dict[int, tuple[int, bytes]]


def build_series(series: Sequence[Track]) -> bytes:
    """The TRAK payload of tracks that ``series_of`` put together."""
    first = series[0]
    components = [component for track in series for component in track.components]
    if len(components) > SERIES_SIZE:
        raise ParameterError("a track has at most 255 components")
    values = {PARAMETERS: first.parameters} if first.parameters else {}
    if first.base is None:
        calibrations = share([component.calibration for component in components])
        if list(calibrations) != [IDENTITY]:
            values[CALIBRATIONS] = b"".join(CALIBRATION.build(c._asdict()) for c in calibrations)
        for type_, name in STRINGS.items():
            items = [getattr(component, name) for component in components]
            if any(item != getattr(Component, name) for item in items):
                values[type_] = build_strings(items)
        deviations = share([component.deviation or (0.0, 0.0) for component in components])
        if any(component.deviation for component in components):
            values[DEVIATIONS] = b"".join(
                DEVIATION.build({"declared": d, "largest": x}) for d, x in deviations
            )
    if first.contract:
        values[CONTRACT] = build_contract([t.contract for t in series if t.contract])
    if first.provenance:
        values[PROVENANCE] = first.provenance.encode("utf-8")
    fixed = TRAK.build(
        {
            "track_count": len(series),
            "component_count": len(first.components),
            "kind": KINDS.index(first.kind),
            "number_format": NUMBER_FORMATS.index(first.number_format),
            "codec": first.codec.encode("ascii"),
            "rate_num": first.rate.numerator,
            "rate_den": first.rate.denominator,
            "count_min": first.count_min,
            "count_max": first.count_max,
            "first_channel": first.first_channel,
            "base": NO_TRACK if first.base is None else first.base,
        }
    )
    return bytes(fixed) + build_tlvs(values)


def build_contract(contracts: Sequence[Contract]) -> bytes:
    first = contracts[0]
    entries = share([pair for c in contracts for pair in zip(c.floor, c.zero, strict=True)])
    flags = first.vector | first.guaranteed << 1
    return bytes(DEADBAND.build({"kn": first.kn, "kd": first.kd, "flags": flags})) + b"".join(
        DEADBAND_ENTRY.build({"floor": floor, "zero": zero}) for floor, zero in entries
    )


def parse_series(payload: bytes, first_id: int, level: Level, offset: int) -> list[Track]:
    """The tracks of a TRAK payload that stands at ``offset``; its header names ``first_id``."""
    raw = parse_fixed(TRAK, payload, 0, "TLV-002", offset)
    if min(raw.track_count, raw.component_count, raw.rate_num, raw.rate_den) < 1:
        raise FormatError("a count or a rate of 0", requirement="TRK-002", offset=offset)
    total = raw.track_count * raw.component_count
    if total > SERIES_SIZE:
        raise FormatError(f"{total} components in one series", requirement="TRK-002", offset=offset)
    if first_id + raw.track_count - 1 > LAST_TRACK_ID:
        raise FormatError("track id above 65533", requirement="TRK-003", offset=offset)
    if raw.first_channel + total > NO_TRACK:
        raise FormatError("channel number above 65534", requirement="TRK-010", offset=offset + 24)
    tlvs = parse_tlvs(payload, size_of(TRAK), offset)
    unsupported = find_unsupported(raw, tlvs)
    kind = KINDS[raw.kind] if raw.kind < len(KINDS) else f"kind {raw.kind}"
    format_ = (
        NUMBER_FORMATS[raw.number_format]
        if raw.number_format < len(NUMBER_FORMATS)
        else f"format {raw.number_format}"
    )
    base = None if raw.base == NO_TRACK else raw.base
    components = tuple(parse_components(tlvs, total))
    contract = parse_contract(tlvs, total)
    if unsupported is None:
        check_kind(raw, tlvs, level, offset)
        if contract is not None and format_ != "counts":
            raise FormatError("a deadband contract on words", requirement="TRK-006", offset=offset)
        check_range(raw, components, offset)
    size = raw.component_count
    text_offset, text = tlvs.get(PROVENANCE, (0, b""))
    return [
        Track(
            id=first_id + i,
            kind=kind,
            codec=raw.codec.decode("latin-1"),
            rate=Fraction(raw.rate_num, raw.rate_den),
            first_channel=raw.first_channel + i * size,
            components=components[i * size : (i + 1) * size],
            parameters=tlvs.get(PARAMETERS, (0, b""))[1],
            number_format=format_,
            count_min=raw.count_min,
            count_max=raw.count_max,
            base=None if base is None else base + i,
            contract=contract and cut_contract(contract, i * size, size),
            provenance=parse_text(text, text_offset),
            unsupported=unsupported,
            offset=offset,
        )
        for i in range(raw.track_count)
    ]


def find_unsupported(raw: Any, tlvs: Tlvs) -> str | None:
    """What of a track this reader does not know (TRK-004, TRK-011, TLV-003)."""
    kind, format_, codec = raw.kind, raw.number_format, raw.codec
    if kind >= len(KINDS):
        return f"kind {kind} [TRK-004]"
    if format_ >= len(NUMBER_FORMATS):
        return f"number format {format_} [TRK-004]"
    if codec not in [name.encode() for name in CODECS]:
        return f"codec {codec.decode('latin-1')!r} [TRK-011]"
    critical = [type_ for type_ in tlvs if type_ % 2 and type_ not in (PARAMETERS, CALIBRATIONS)]
    return f"critical TLV {critical[0]} [TLV-003]" if critical else None


def check_kind(
    raw: Any,
    tlvs: Tlvs,
    level: Level,
    offset: int,
) -> None:
    """TRK-005 to TRK-009, as far as one chunk tells."""
    low, high, base = raw.count_min, raw.count_max, raw.base
    kind, counts = KINDS[raw.kind], raw.number_format == 0
    bound = 1 << ((level.residual_bits if kind == "hf" else level.count_bits) - 1)
    if low > high or low < -bound or high >= bound:
        raise FormatError(
            f"declared range {low} to {high} does not fit level {level.number}",
            requirement="TRK-005",
            offset=offset + 16,
        )
    if not counts and (
        kind != "full" or raw.codec != b"RAWB" or low or high or CALIBRATIONS in tlvs
    ):
        raise FormatError(
            "words need kind full band, codec RAWB, range 0, no calibration",
            requirement="TRK-006",
            offset=offset,
        )
    if kind == "hf" and base == NO_TRACK:
        raise FormatError(
            "HF track without a base track", requirement="TRK-007", offset=offset + 26
        )
    if kind != "hf" and base != NO_TRACK:
        raise FormatError(
            "base track named by a track that is not HF", requirement="TRK-008", offset=offset + 26
        )
    if kind == "hf" and INHERITED & tlvs.keys():
        raise FormatError(
            "HF track describes what it has from its base", requirement="TRK-009", offset=offset
        )


def check_range(raw: Any, components: Sequence[Component], offset: int) -> None:
    """VAL-002."""
    ends = (raw.count_min, raw.count_max)
    for a, b, _ in {component.calibration for component in components}:
        if max(max(abs(end * a), abs(end * a + b)) for end in ends) > EXACT_LIMIT:
            raise FormatError(
                "count * A + B above 2^53 within the declared range",
                requirement="VAL-002",
                offset=offset,
            )


def parse_components(tlvs: Tlvs, count: int) -> Iterator[Component]:
    calibrations = parse_calibrations(tlvs, count)
    deviations = parse_deviations(tlvs, count)
    strings = {
        name: parse_strings(tlvs[type_][1], count, tlvs[type_][0]) if type_ in tlvs else None
        for type_, name in STRINGS.items()
    }
    for i in range(count):
        named = {name: items[i] for name, items in strings.items() if items}
        yield Component(calibrations[i], deviation=deviations[i], **named)


def parse_calibrations(tlvs: Tlvs, count: int) -> Sequence[Affine]:
    if CALIBRATIONS not in tlvs:
        return [IDENTITY] * count
    offset, value = tlvs[CALIBRATIONS]
    entries = []
    for raw, at in entries_of(CALIBRATION, value, 0, offset):
        if not 1 <= raw.d <= EXACT_LIMIT or raw.a == 0 or max(abs(raw.a), abs(raw.b)) > EXACT_LIMIT:
            raise FormatError("calibration out of its bounds", requirement="VAL-001", offset=at)
        entries.append(Affine(raw.a, raw.b, raw.d))
    return spread(entries, count, offset)


def parse_deviations(tlvs: Tlvs, count: int) -> Sequence[tuple[float, float] | None]:
    if DEVIATIONS not in tlvs:
        return [None] * count
    offset, value = tlvs[DEVIATIONS]
    entries: list[tuple[float, float] | None] = []
    for raw, at in entries_of(DEVIATION, value, 0, offset):
        finite = math.isfinite(raw.declared) and math.isfinite(raw.largest)
        if not (finite and 0 <= raw.largest <= raw.declared):
            raise FormatError("deviation above what was declared", requirement="TLV-005", offset=at)
        entries.append((raw.declared, raw.largest) if raw.declared else None)
    return spread(entries, count, offset)


def parse_contract(tlvs: Tlvs, count: int) -> Contract | None:
    if CONTRACT not in tlvs:
        return None
    offset, value = tlvs[CONTRACT]
    raw = parse_fixed(DEADBAND, value, 0, "DBC-001", offset)
    if raw.kd < 1 or raw.flags & ~3:
        raise FormatError("kd of 0 or an undefined flag", requirement="DBC-001", offset=offset)
    entries = []
    for entry, at in entries_of(DEADBAND_ENTRY, value, size_of(DEADBAND), offset):
        if entry.floor < 1:
            raise FormatError("a deadband floor of 0", requirement="DBC-001", offset=at)
        entries.append((entry.floor, entry.zero))
    pairs = spread(entries, count, offset)
    return Contract(
        raw.kn,
        raw.kd,
        bool(raw.flags & 1),
        bool(raw.flags & 2),
        tuple(floor for floor, _ in pairs),
        tuple(zero for _, zero in pairs),
    )


def cut_contract(contract: Contract, start: int, size: int) -> Contract:
    """The part of a series' contract that speaks of one of its tracks."""
    stop = start + size
    return contract._replace(floor=contract.floor[start:stop], zero=contract.zero[start:stop])


def entries_of(layout: Struct, value: bytes, position: int, base: int) -> Iterator[tuple[Any, int]]:
    """Each whole layout from ``position`` on with its file offset."""
    size = size_of(layout)
    if (len(value) - position) % size:
        raise FormatError(
            "a list ends within an entry", requirement="TLV-002", offset=base + position
        )
    for at in range(position, len(value), size):
        yield read_fields(layout, value, at), base + at
