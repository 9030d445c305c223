"""Reads .ahap, haptic patterns of Apple.

Parameter curves become channels, events and parameters become events with all that they say. What a
device plays from them is not synthesised.
"""

from __future__ import annotations

import json
from fractions import Fraction
from typing import Any

from ..errors import ParameterError
from ..recording import Event
from .formats import ReadOptions, Source
from .patterns import (
    Curve,
    Piece,
    import_of,
    number,
    objects,
    ordered,
    parsed,
    seconds,
    text,
)
from .tables import Import

_RATE = Fraction(1000)
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
