"""Opens files of any format in parts, for plot and compare."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..errors import ParameterError
from ..names import channels_called
from .common import ARRAYS, HAPF, input_of, load_recording, parse_channels, suffix_of

if TYPE_CHECKING:
    from ..limits import Limits
    from ..lab.survey.parts import Parts


def open_parts(
    name: str,
    format_: str | None,
    rate: str | None,
    limits: Limits,
    channels: Sequence[str] = (),
    *,
    numbers: Sequence[int] | None = None,
    whole: bool = True,
    transpose: bool | None = None,
) -> Parts:
    """``channels``: labels or numbers as a person gives them; ``numbers``: these;
    ``whole``: all of its time is wanted, so a hapf file is checked from end to end;
    ``transpose``: for a file of arrays, others ignore it."""
    from ..reading.reader import Reader
    from ..lab.survey.parts import FileParts, RecordingParts

    suffix = suffix_of(name, None if name.lower().endswith(HAPF) else format_)
    if suffix == HAPF:
        reader = Reader(input_of(name), limits=limits)
        try:
            labels = [ref.label for ref in reader.channels]
            return FileParts(reader, numbers or parse_channels(channels, labels), whole=whole)
        except BaseException:
            reader.close()
            raise
    transpose = transpose if suffix in ARRAYS else None
    recording, _ = load_recording(name, format_, rate, limits, transpose=transpose)
    labels = [channel.label for channel in recording.channels]
    names: Sequence[str | int] | None = numbers or parse_channels(channels, labels)
    places = None if names is None else channels_called(names, dict(enumerate(labels)))
    return RecordingParts(recording, places)


def matched(
    parts: Parts,
    name: str,
    format_: str | None,
    rate: str | None,
    limits: Limits,
    transpose: bool | None,
) -> Parts:
    """The channels of the file ``name`` that belong to those of ``parts``: of the same places, as
    in ``verify`` (SPEC DBC-003)."""
    numbers = [channel.number for channel in parts.channels]
    try:
        return open_parts(name, format_, rate, limits, numbers=numbers, transpose=transpose)
    except ParameterError as error:
        if not error.message.startswith("no channel"):
            raise
        raise ParameterError(
            f"The original lacks a channel of the file: {error.message}", path=name
        ) from None
