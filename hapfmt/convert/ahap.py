"""Reads and writes .ahap, haptic patterns of Apple.

Parameter curves become channels, events and parameters become events with all that they say. What a
device plays from them is not synthesised.
"""

from __future__ import annotations

import json
from fractions import Fraction
from typing import Any

from ..errors import ParameterError
from ..numbers import counted
from ..recording import Channel, Event, Recording
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
    seconds,
    text,
)
from .tables import Import

_RATE = Fraction(1000)
_POINTS = 16
"""Control points of a curve; longer ones are split, since players limit them."""
_CONTINUOUS = "HapticContinuous"
_EVENTS = ("HapticTransient", _CONTINUOUS, "AudioContinuous", "AudioCustom")
_RANGES = {
    "HapticIntensityControl": (0, 1), "HapticSharpnessControl": (-1, 1),
    "HapticAttackTimeControl": (-1, 1), "HapticDecayTimeControl": (-1, 1),
    "HapticReleaseTimeControl": (-1, 1), "AudioVolumeControl": (0, 1), "AudioPanControl": (-1, 1),
    "AudioBrightnessControl": (-1, 1), "AudioPitchControl": (-1, 1),
    "AudioAttackTimeControl": (-1, 1), "AudioDecayTimeControl": (-1, 1),
    "AudioReleaseTimeControl": (-1, 1),
}  # fmt: skip
_KEYS = ("Event", "Parameter", "ParameterCurve")


def read(source: Source, options: ReadOptions) -> Import:
    found = parsed(source, options, "AHAP")
    if "Pattern" not in found:
        raise ParameterError("this is not an AHAP file: Pattern is missing")
    notes: list[str] = []
    events: list[Event] = []
    curves: dict[str, Curve] = {}
    for entry in objects(found["Pattern"], "Pattern"):
        for key, value in entry.items():
            if key not in _KEYS:
                notes.append(f"entries {key[:40]!r} of the pattern are not read")
                continue
            [one] = objects([value], f"{key} in Pattern")
            if key == "Event":
                events.append(_event(one, notes))
            elif key == "Parameter":
                level = number(one.get("ParameterValue"), "a ParameterValue")
                events.append(Event(_time(one), json.dumps(level), layer=_name(one)))
            else:
                _add(one, curves, notes)
    for curve in curves.values():
        curve.pieces = ordered(curve.pieces)
    kept = {"version": found["Version"]} if isinstance(found.get("Version"), (int, float)) else {}
    return import_of([*curves.values()], _RATE, options, events, {"ahap": kept}, notes)


def _time(one: dict[str, Any]) -> Fraction:
    return seconds(one.get("Time", 0), "a Time")


def _name(one: dict[str, Any]) -> str:
    return text(one.get("ParameterID"), "a ParameterID")[:200]


def _event(one: dict[str, Any], notes: list[str]) -> Event:
    kind = text(one.get("EventType"), "an EventType")[:200]
    said: dict[str, Any] = {
        _name(each): number(each.get("ParameterValue"), "a ParameterValue")
        for each in objects(one.get("EventParameters", []), "EventParameters")
    }
    if "EventWaveformPath" in one:
        said["EventWaveformPath"] = text(one["EventWaveformPath"], "an EventWaveformPath")
        notes.append(f"the sound {said['EventWaveformPath'][:80]!r} is not read")
    lasts = seconds(one.get("EventDuration", 0), "an EventDuration")
    return Event(_time(one), json.dumps(said), lasts, layer=kind)


def _add(one: dict[str, Any], curves: dict[str, Curve], notes: list[str]) -> None:
    name, start = _name(one), _time(one)
    points = sorted(
        (start + _time(each), number(each.get("ParameterValue"), "a ParameterValue"))
        for each in objects(one.get("ParameterCurveControlPoints", []), "control points")
    )
    if not points:
        notes.append(f"a curve of {name!r} without points is not read")
        return
    if any((time * _RATE).denominator != 1 for time, _ in points):
        notes.append(f"points of {name!r} lie between two ticks of {_RATE} Hz")
    piece = Piece([time for time, _ in points], [value for _, value in points])
    curves.setdefault(name, Curve(name, kind="ParameterCurve")).pieces.append(piece)


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """Channels that are called after a parameter are curves."""
    notes: list[str] = []
    entries: list[tuple[Fraction, dict[str, Any]]] = []
    lost = 0
    for event in recording.events:
        one = _entry(event)
        lost += one is None
        if one is not None:
            entries.append((event.time, one))
    if lost:
        are = "is" if lost == 1 else "are"
        notes.append(
            f"{counted(lost, 'event')} that {are} not of Apple's kinds {are} not carried over"
        )
    count = 0
    for place, channel in enumerate(recording.channels):
        for start, points in _points(channel, notes):
            count += len(points)
            check_frames(count, channel, ".ahap")
            for first in range(0, max(len(points) - 1, 1), _POINTS - 1):
                part = points[first : first + _POINTS]
                entries.append((start + part[0][0], _curve(channel.label, start, part)))
        if options.progress:
            options.progress(place + 1, len(recording.channels))
    if recording.channels and not any(event.layer == _CONTINUOUS for event in recording.events):
        notes.append(f"the pattern has no {_CONTINUOUS} event, so a device plays nothing")
    entries.sort(key=lambda each: each[0])
    found = {"Version": 1.0, "Pattern": [one for _, one in entries]}
    for text_part in json.JSONEncoder(separators=(",", ":")).iterencode(found):
        target.stream.write(text_part.encode())
    return notes + not_carried(recording, ".ahap", "label", "calibration", "events")


def _entry(event: Event) -> dict[str, Any] | None:
    """None for an event that Apple has no kind for."""
    try:
        said = json.loads(event.text)
    except (ValueError, RecursionError):
        return None
    time = {"Time": float(event.time)}
    if event.layer in _RANGES and isinstance(said, float) and not event.duration:
        return {"Parameter": {"ParameterID": event.layer, "ParameterValue": said, **time}}
    if event.layer not in _EVENTS or not isinstance(said, dict):
        return None
    waveform = said.pop("EventWaveformPath", None)
    if not all(isinstance(value, float) for value in said.values()):
        return None
    one: dict[str, Any] = {**time, "EventType": event.layer}
    if event.duration:
        one["EventDuration"] = float(event.duration)
    if isinstance(waveform, str):
        one["EventWaveformPath"] = waveform
    one["EventParameters"] = [
        {"ParameterID": name, "ParameterValue": value} for name, value in said.items()
    ]
    return {"Event": one}


def _points(
    channel: Channel, notes: list[str]
) -> list[tuple[Fraction, list[tuple[Fraction, float]]]]:
    """The start of each span, and its control points."""
    if channel.label not in _RANGES:
        raise ParameterError(
            f"channel {channel.label!r} is not called after a parameter of .ahap, such as "
            "HapticIntensityControl; give it such a label, or use .hjif"
        )
    if channel.rate_exact != _RATE:
        notes.append(
            f"the rate of channel {channel.label!r} is not kept; hapfmt reads {_RATE} Hz, unless "
            "you give a rate"
        )
    values, tolerance = rounding(channel, notes)
    low, high = _RANGES[channel.label]
    if values.size and not (low <= values.min() and values.max() <= high):
        raise ParameterError(
            f"channel {channel.label!r} holds values from {values.min():g} to {values.max():g}, "
            f"not from {low} to {high}"
        )
    found, at = [], 0
    for span in channel.coverage:
        x = values[at : at + span.ticks]
        at += span.ticks
        frames = [(Fraction(k) / channel.rate_exact, float(x[k])) for k in keyframes(x, tolerance)]
        found.append((Fraction(span.start) / channel.rate_exact, frames))
    return found


def _curve(name: str, start: Fraction, points: list[tuple[Fraction, float]]) -> dict[str, Any]:
    first = points[0][0]
    return {
        "ParameterCurve": {
            "ParameterID": name,
            "Time": float(start + first),
            "ParameterCurveControlPoints": [
                {"Time": float(time - first), "ParameterValue": value} for time, value in points
            ],
        }
    }
