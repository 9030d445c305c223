"""Where the zero of each file lies on the time line of the result, in seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Literal, NamedTuple

from ..format.wire import Head
from ..errors import ParameterError
from ..numbers import exact
from ..reading.seconds import Seconds
from .making import another
from .original import NS, Original, common_period

Times = Literal["same", "epoch"]
"""same: the ticks of all files count from one zero; epoch: the UTC times of their zeros tell."""


class Line(NamedTuple):
    """The common time line: its HEAD, and where the zero of each file lies on it."""

    head: Head
    offsets: list[Fraction]
    notes: list[str]


def one_recording(originals: Sequence[Original]) -> bool:
    """Whether all files are parts of one recording, on its time line."""
    first = originals[0].head
    names = {(original.head.uuid, original.head.epoch_ns) for original in originals}
    return names == {(first.uuid, first.epoch_ns)} and first.uuid is not None


def period_of(originals: Sequence[Original]) -> Fraction:
    return common_period([t.rate for original in originals for t in original.tracks.values()])


def nearest(seconds: Fraction, period: Fraction) -> Fraction:
    return round(seconds / period) * period


def common_line(
    originals: Sequence[Original],
    times: Times | None,
    given: Mapping[int, Seconds],
    canonical: int | None,
) -> Line:
    """For files recorded side by side; ``given``: offsets by the place of the file."""
    if given:
        if times is not None:
            raise ParameterError("offsets, or --by-epoch, or the same times, not two of them")
        offsets = [exact(given.get(i, 0)) for i in range(len(originals))]
        for original, offset in zip(originals, offsets, strict=True):
            check_offset(original, offset)
        return Line(another(originals[0].head, -offsets[0], canonical), offsets, [])
    epochs = [original.head.epoch_ns for original in originals]
    equal = None not in epochs and len(set(epochs)) == 1
    zeros = [Fraction(0)] * len(originals)
    if times is None and one_recording(originals):
        return Line(originals[0].head, zeros, [])
    if times == "same" or (times is None and equal):
        head = originals[0].head
        return Line(
            head if one_recording(originals) else another(head, zeros[0], canonical), zeros, []
        )
    if times is None:
        raise ParameterError(
            "the files do not say how their times belong together; give --by-epoch, --same-times "
            "(tick 0 is the same moment in all), or --offset FILE=SECONDS"
        )
    first = originals[min(range(len(epochs)), key=lambda i: epoch_of(originals[i]))]
    offsets, notes = by_epoch(first, originals, [period_of([original]) for original in originals])
    return Line(another(first.head, zeros[0], canonical), offsets, notes)


def epoch_of(original: Original) -> int:
    if original.head.epoch_ns is None:
        raise ParameterError("the epoch is not known: give the offset", path=original.name)
    return original.head.epoch_ns


def by_epoch(
    first: Original, originals: Sequence[Original], periods: Sequence[Fraction]
) -> tuple[list[Fraction], list[str]]:
    """Offsets to the nearest whole ticks, and what that moved."""
    offsets, notes = [], []
    for original, period in zip(originals, periods, strict=True):
        told = Fraction(epoch_of(original) - epoch_of(first), NS)
        offset = nearest(told, period)
        offsets.append(offset)
        if offset != told:
            moved = float(offset - told)
            notes.append(f"{original.name}: {moved:+.3g} s from its epoch, to whole ticks")
    return offsets, notes


def check_offset(original: Original, offset: Fraction) -> None:
    period = period_of([original])
    if offset < 0:
        raise ParameterError(
            "an offset must not be negative; offset the other files instead", path=original.name
        )
    if offset % period:
        raise ParameterError(
            f"an offset of {offset} s is not a whole number of ticks of every track; the nearest "
            f"one: {nearest(offset, period)} s",
            path=original.name,
        )
