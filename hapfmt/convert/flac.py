""".flac <-> Recording, through soundfile: counts of 8, 16 or 24 bits.

A file that we write has a comment in JSON: the rate, and the label, the unit and the scale of each
channel. Other programs play it as sound.
"""

from __future__ import annotations

import json
from fractions import Fraction
from typing import Any

from ..errors import LimitError, ParameterError
from ..recording import Calibration, Channel, Recording
from ..units import to_ucum
from .common import extent, not_carried, one_rate, rate_from
from .formats import Destination, ReadOptions, Source, WriteOptions
from .tables import Import, ImportColumn
from .wav import PCM, check_pcm, pcm_frames, sound_of, write_sound

_OURS = "hapfmt "
_COMMENT_LIMIT = 1 << 16
_CHANNELS_LIMIT = 8
_ANY_RATE = 65_535
_RATE_LIMIT = 655_350
_BITS = {"PCM_S8": 8, "PCM_16": 16, "PCM_24": 24}
_TEXTS = ("label", "unit", "quantity", "axis", "group", "body_site", "device")


def read(source: Source, options: ReadOptions) -> Import:
    """Counts as in .wav; in a file of ours with their scale, label and unit."""
    if not source.head.startswith((b"fLaC", b"ID3")):
        raise ParameterError("this is not a FLAC file: it does not begin with fLaC")
    return sound_of(source.stream, ".flac", options, _described)


def _described(comment: str, count: int) -> tuple[Fraction, list[ImportColumn]] | None:
    """What our comment says; None where there is none, or another program changed it."""
    if not comment.startswith(_OURS) or len(comment) > _COMMENT_LIMIT:
        return None
    try:
        found = json.loads(comment.removeprefix(_OURS))
        columns = [_column(each) for each in found["channels"]]
        rate = rate_from(found["rate"])
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError, ParameterError):
        return None
    return (rate, columns) if len(columns) == count else None


def _column(found: dict[str, Any]) -> ImportColumn:
    texts = {name: found[name] for name in _TEXTS if name in found}
    if not all(isinstance(text, str) for text in texts.values()):
        raise ValueError
    "".join(texts.values()).encode()  # raises for half of a surrogate
    a, b, d = found["scale"]
    texts["unit"] = to_ucum(texts.get("unit", ""))
    return ImportColumn(**texts, calibration=Calibration(a, b, d))


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """Counts of up to 24 bits, bit for bit."""
    rate = one_rate(recording, ".flac")
    played = max(round(rate), 1)
    if played > _RATE_LIMIT or (played > _ANY_RATE and played % 10):
        raise ParameterError(
            f".flac holds rates up to {_ANY_RATE} Hz, and whole tens up to {_RATE_LIMIT} Hz, not "
            f"{rate} Hz; use .wav or .npz"
        )
    channels = recording.channels
    if len(channels) > _CHANNELS_LIMIT:
        raise ParameterError(
            f".flac holds at most {_CHANNELS_LIMIT} channels, not {len(channels)}; use .wav or .npz"
        )
    for channel in channels:
        if channel.calibration is None or channel.exact is not None:
            raise ParameterError(
                f"channel {channel.label!r} holds floating point, and .flac holds integers; use "
                ".wav or .npz"
            )
    subtype = _subtype(channels)
    check_pcm(channels, subtype)
    comment = _OURS + json.dumps({"rate": str(rate), "channels": [_json(c) for c in channels]})
    if len(comment) > _COMMENT_LIMIT:
        raise LimitError(f"the labels and units take more than {_COMMENT_LIMIT} bytes")
    size = PCM[subtype][1].itemsize * recording.sample_count
    write_sound(
        target.stream,
        pcm_frames(channels, subtype),
        size,
        options.max_memory,
        ".flac",
        comment,
        samplerate=played,
        channels=len(channels),
        format="FLAC",
        subtype=subtype,
    )
    notes = []
    if played != rate:
        notes.append(f"other programs than hapfmt see the rate {played} Hz instead of {rate} Hz")
    start, _ = extent(channels)
    if start:
        notes.append(f"the start, tick {start}, is not carried over to .flac")
    return notes + not_carried(recording, ".flac", "calibration", *_TEXTS)


def _subtype(channels: tuple[Channel, ...]) -> str:
    """The bits whose full scale is 1 in all channels. Otherwise 16 or 24 bits, as the counts
    need."""
    scales = {channel.calibration for channel in channels}
    for subtype, bits in _BITS.items():
        if scales == {Calibration(1, 0, 1 << (bits - 1))}:
            return subtype
    low = min((int(c.stored.min()) for c in channels if c.stored.size), default=0)
    high = max((int(c.stored.max()) for c in channels if c.stored.size), default=0)
    return "PCM_16" if low >= -(1 << 15) and high < 1 << 15 else "PCM_24"


def _json(channel: Channel) -> dict[str, Any]:
    scale = channel.calibration or Calibration()
    texts = {name: getattr(channel, name) for name in _TEXTS if getattr(channel, name)}
    return {**texts, "scale": [scale.a, scale.b, scale.d]}
