"""Reads and writes .hjif, haptic effects in the JSON of MPEG (ISO/IEC 23090-31).

Curve bands are signals, and vectorial waves have curves of amplitude and frequency: each becomes a
channel. Transients become events. Wavelets are not read, and no vibration is synthesised. A channel
is written as a curve band of straight lines.
"""

from __future__ import annotations

import json
from fractions import Fraction
from math import frexp, lcm
from typing import Any

import numpy as np

from ..errors import LimitError, ParameterError
from ..recording import Channel, Event, Recording
from ..units import split_name, to_ucum
from . import patterns
from .common import not_carried
from .formats import Destination, ReadOptions, Source, WriteOptions
from .patterns import (
    Curve,
    Piece,
    check_frames,
    import_of,
    keyframes,
    number,
    objects,
    ordered,
    parsed,
    rounding,
    text,
    whole,
)
from .tables import Import

_TIMESCALE, _TIMESCALE_LIMIT = 1000, 48_000
_POSITION_LIMIT = (1 << 31) - 1


def read(source: Source, options: ReadOptions) -> Import:
    found = parsed(source, options, "HJIF")
    if "perceptions" not in found:
        raise ParameterError("this is not an HJIF file: perceptions are missing")
    scale = whole(found.get("timescale", _TIMESCALE), "the timescale", 1, 1 << 31)
    notes: list[str] = []
    curves: list[Curve] = []
    events: list[Event] = []
    budget = [patterns.FRAMES_LIMIT]  # effects and keyframes; those of references each time
    for perception in objects(found["perceptions"], "perceptions"):
        group = text(perception.get("description", ""), "the description of a perception")
        library = {
            effect.get("id"): effect
            for effect in objects(perception.get("effect_library", []), "effect_library")
            if isinstance(effect.get("id"), int)
        }
        for channel in objects(
            perception.get("channels", perception.get("tracks", [])), "channels"
        ):
            gain = number(channel.get("gain", 1), "the gain of a channel")
            described = text(channel.get("description", ""), "the description of a channel")
            name, unit = split_name(described)
            name = name or f"channel {channel.get('id', len(curves))}"[:40]
            bands = objects(channel.get("bands", []), "bands")
            for place, band in enumerate(bands):
                label = name if len(bands) == 1 else f"{name}.{place}"
                effects = _effects(band, library, scale, gain, budget, notes, label)
                _band(band, label, to_ucum(unit or ""), group, effects, curves, events, notes)
    kept = {
        key: found[key]
        for key in ("version", "profile", "level", "date", "description")
        if isinstance(found.get(key), (str, int)) and found[key] != ""
    }
    return import_of(curves, Fraction(scale), options, events, {"hjif": kept}, notes)


class Effect:
    """Keyframes of one effect, in seconds; those without an amplitude or a frequency have None."""

    def __init__(self, start: Fraction) -> None:
        self.start = start
        self.times: list[Fraction] = []
        self.amplitudes: list[float | None] = []
        self.frequencies: list[float | None] = []

    def piece(self, values: list[float | None]) -> Piece | None:
        """From the position of the effect on, where its first keyframe counts already."""
        known = [
            (time, value)
            for time, value in zip(self.times, values, strict=True)
            if value is not None
        ]
        if not known:
            return None
        known.sort(key=lambda each: each[0])
        if known[0][0] > self.start:
            known.insert(0, (self.start, known[0][1]))
        return Piece([time for time, _ in known], [value for _, value in known])


def _effects(
    band: dict[str, Any],
    library: dict[Any, dict[str, Any]],
    scale: int,
    gain: float,
    budget: list[int],
    notes: list[str],
    label: str,
) -> list[Effect]:
    found = []
    for given in objects(band.get("effects", []), "effects"):
        kind = given.get("effect_type", "Basis")
        position = whole(given.get("position", 0), "the position of an effect", 0, _POSITION_LIMIT)
        if kind == "Reference":
            known = library.get(given.get("id")) if isinstance(given.get("id"), int) else None
            if known is None or known.get("effect_type", "Basis") != "Basis":
                notes.append(f"a reference of {label!r} to no basis effect is not read")
                continue
        elif kind == "Basis":
            known = given
        else:
            notes.append(f"effects of {label!r} that are neither Basis nor Reference are not read")
            continue
        effect = Effect(Fraction(position, scale))
        frames = objects(known.get("keyframes", []), "keyframes")
        budget[0] -= 1 + len(frames)
        if budget[0] < 0:
            raise LimitError(f"more than {patterns.FRAMES_LIMIT} effects and keyframes")
        if band.get("band_type") == "VectorialWave" and (
            known.get("base_signal", "Sine") != "Sine" or known.get("phase", 0)
        ):
            notes.append(f"the phases and wave shapes of {label!r} are not kept")
        for frame in frames:
            if "relative_position" not in frame:
                continue
            at = whole(frame["relative_position"], "the position of a keyframe", 0, _POSITION_LIMIT)
            effect.times.append(Fraction(position + at, scale))
            level, pitch = frame.get("amplitude_modulation"), frame.get("frequency_modulation")
            effect.amplitudes.append(
                None if level is None else number(level, "an amplitude_modulation") * gain
            )
            effect.frequencies.append(
                None if pitch is None else number(pitch, "a frequency_modulation")
            )
        found.append(effect)
    return found


def _band(
    band: dict[str, Any],
    label: str,
    unit: str,
    group: str,
    effects: list[Effect],
    curves: list[Curve],
    events: list[Event],
    notes: list[str],
) -> None:
    kind = text(band.get("band_type", ""), "a band_type")
    if kind == "Transient":
        for effect in effects:
            for time, level, pitch in zip(
                effect.times, effect.amplitudes, effect.frequencies, strict=True
            ):
                said = {"amplitude": level, "frequency": pitch}
                shown = json.dumps({key: value for key, value in said.items() if value is not None})
                events.append(Event(time, shown, layer=label))
    elif kind == "Curve":
        shape = text(band.get("curve_type", ""), "a curve_type")
        if shape not in ("", "Linear"):
            notes.append(
                f"the curve of {label!r} is {shape}; straight lines join its keyframes here"
            )
        curves.append(Curve(label, unit, group, kind, _pieces(effects, "amplitudes")))
    elif kind == "VectorialWave":
        for name, values, own in (
            ("amplitude", "amplitudes", unit),
            ("frequency", "frequencies", "Hz"),
        ):
            if pieces := _pieces(effects, values):
                curves.append(Curve(f"{label}.{name}", own, group, kind, pieces))
    else:
        notes.append(f"the band {label!r} holds {kind[:40]}, which is not read")


def _pieces(effects: list[Effect], values: str) -> list[Piece]:
    found = [effect.piece(getattr(effect, values)) for effect in effects]
    return ordered([piece for piece in found if piece is not None])


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """Each channel is a curve band; each span of it an effect."""
    scale = _timescale(recording)
    notes: list[str] = []
    channels = []
    count = 0
    for place, channel in enumerate(recording.channels):
        channels.append(_channel(place, channel, scale, notes))
        count += sum(1 + len(e["keyframes"]) for e in channels[-1]["bands"][0]["effects"])
        check_frames(count, channel, ".hjif")
        if options.progress:
            options.progress(place + 1, len(recording.channels))
    found = {
        "version": "2023", "profile": "Main", "level": 2, "date": "2023", "description": "",
        "timescale": scale, "avatars": [],
        "perceptions": [{
            "id": 0, "avatar_id": 0, "description": "", "perception_modality": "Other",
            "reference_devices": [], "effect_library": [], "channels": channels,
        }],
        "syncs": [],
    }  # fmt: skip
    for part in json.JSONEncoder(separators=(",", ":")).iterencode(found):
        target.stream.write(part.encode())
    return notes + not_carried(recording, ".hjif", "unit", "label", "calibration")


def _timescale(recording: Recording) -> int:
    rates = {channel.rate_exact for channel in recording.channels}
    scale = lcm(*(rate.numerator for rate in rates)) if rates else _TIMESCALE
    if any(rate.denominator != 1 for rate in rates) or scale > _TIMESCALE_LIMIT:
        raise ParameterError(
            f".hjif holds times in whole ticks of up to {_TIMESCALE_LIMIT} Hz, which the rates of "
            "the channels do not share; use .npz"
        )
    return scale


def _channel(place: int, channel: Channel, scale: int, notes: list[str]) -> dict[str, Any]:
    values, tolerance = rounding(channel, notes)
    peak = float(np.abs(values).max(initial=0.0))
    gain = 2.0 ** frexp(peak)[1] if 1e-300 < peak < 1e300 else 1.0
    named = f" [{channel.unit}]" if channel.unit != "1" or split_name(channel.label)[1] else ""
    step = scale // int(channel.rate_exact)
    effects, at = [], 0
    for span in channel.coverage:
        if span.stop * step > _POSITION_LIMIT:
            raise ParameterError(f"channel {channel.label!r} leaves the times of .hjif; use .npz")
        x = values[at : at + span.ticks]
        at += span.ticks
        frames = [
            {"relative_position": k * step, "amplitude_modulation": float(x[k] / gain)}
            for k in keyframes(x, tolerance)
        ]
        effects.append({
            "effect_type": "Basis", "position": span.start * step, "phase": 0,
            "base_signal": "Sine", "keyframes": frames,
        })  # fmt: skip
    return {
        "id": place, "description": channel.label + named, "gain": gain, "mixing_coefficient": 1,
        "body_part_mask": 0,
        "bands": [{
            "band_type": "Curve", "curve_type": "Linear", "lower_frequency_limit": 0,
            "upper_frequency_limit": min(int(channel.rate_exact) // 2, 1000), "effects": effects,
        }],
    }  # fmt: skip
