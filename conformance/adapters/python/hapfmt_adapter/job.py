"""The verb encode: a job, a JSON description with raw files next to it -> a file."""

from __future__ import annotations

import json
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

from hapfmt.limits import Limits
from hapfmt.recording import Calibration, Channel, Event, Recording, Span, append_span

from .decode import TEXTS
from .raw import read_numbers

PRESETS: dict[str, dict[str, Any]] = {
    "lossless": {"preset": "lossless"},
    "deadband": {
        "preset": "perceptual",
        "texture": False,
        "felt": "all",
        "smallest": False,
    },
    "split": {"preset": "paper", "smallest": False},
}
UNSUPPORTED = 4


def read_job(path: Path) -> tuple[Recording, dict[str, Any]]:
    """The recording that a job describes, and the job itself."""
    Limits().check("metadata", path.stat().st_size, 0)
    job = json.loads(path.read_text(encoding="utf-8"))
    channels = tuple(channel_of(one, path.parent) for one in job["channels"])
    layers = job.get("events", [])
    events = tuple(event for layer in layers for event in events_of(layer))
    return Recording(channels, metadata=job.get("metadata", {}), events=events), job


def channel_of(one: dict[str, Any], folder: Path) -> Channel:
    spans: list[Span] = []
    for start, stop in one["spans"]:
        append_span(spans, Span(start, stop))
    return Channel(
        stored=read_numbers(folder / one["numbers"], one["format"]),
        rate=Fraction(*one["rate"]),
        coverage=tuple(spans),
        calibration=calibration_of(one),
        **{text: one[text] for text in TEXTS if text in one},
    )


def calibration_of(one: dict[str, Any]) -> Calibration | None:
    if one["format"] != "counts":
        return None
    return Calibration(*(one.get("calibration") or (1, 0, 1)))


def events_of(layer: dict[str, Any]) -> list[Event]:
    rate = Fraction(*layer["rate"])
    return [
        Event(tick / rate, text, duration / rate, channel, layer["label"])
        for tick, duration, channel, text in layer["events"]
    ]


def encode_job(path: str, target: str) -> int:
    from hapfmt.encoder.settings import Settings, Tolerance
    from hapfmt.writing.writer import write

    recording, job = read_job(Path(path))
    preset = PRESETS.get(job["mode"])
    if preset is None:
        print(f"encode: no mode is called {job['mode']!r}", file=sys.stderr)
        return UNSUPPORTED
    given = dict(preset)
    if job["mode"] != "lossless":
        if "k" in job:
            given["k"] = Fraction(*job["k"])
        if "floor" in job:
            given["floor"] = Tolerance(job["floor"], "lsb")
    if job["mode"] == "split":
        # Rounding to this step leaves no sample further off than the floor.
        given["step"] = Tolerance(max(2 * job.get("floor", 0), 1), "lsb")
    if "cluster_s" in job:
        given["cluster"] = Fraction(*job["cluster_s"])
    settings = Settings.of(**given)
    file_id = int(job["file_id"], 0) if "file_id" in job else None
    write(recording, target, settings, canonical=file_id, force=True)
    return 0
