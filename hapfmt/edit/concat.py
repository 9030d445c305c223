"""Recordings one after the other -> one file, on one time line; packets are copied."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from fractions import Fraction

from ..errors import ParameterError
from ..format.extras import build_metadata
from ..format.wire import check_file_id
from ..numbers import exact
from ..reading.packets import Seconds
from .joining import Joining, Times, by_epoch, one_recording, period_of
from .making import (
    Edited,
    Everything,
    Making,
    Output,
    another,
    combined,
    differing_maps,
    level_for,
    name_of,
    opened,
    refuse_output,
    with_note,
)
from .original import Advance, Input, Original, open_original
from .subset import title


def concat(
    files: Sequence[Input | Original],
    out: Output,
    *,
    times: Times | None = None,
    gap: Seconds | None = None,
    canonical: int | None = None,
    force: bool = False,
    progress: Advance | None = None,
) -> Edited:
    """Put files one after the other into ``out``.

    Channels are matched by label where every channel has one of its own, else by number. They need
    the same rate, number format, calibration and unit. Channels that are coded in one track must be
    so in all files. A channel that a file lacks has a gap there.

    Parts of one recording (the same UUID) keep their times. Else the zero of each file lies at the
    end of the one before, or ``gap`` seconds after it. It is rounded up to a whole number of ticks
    of every track. ``times``: "same" keeps the ticks of all files, "epoch" places them as their
    epochs say, to the nearest whole tick. The epoch is that of the first file.

    Raises as :func:`subset` does, ParameterError also where channels do not go together, or packets
    of one channel overlap.
    """
    check_file_id(canonical)
    refuse_output(out, force)
    if not files:
        raise ParameterError("nothing to concatenate")
    wait = None if gap is None else exact(gap)
    if wait is not None and (wait < 0 or times is not None):
        raise ParameterError(
            "a gap must not be negative, and is not allowed if the times are known"
        )
    with ExitStack() as stack:
        originals = [stack.enter_context(open_original(file)) for file in files]
        joining = Joining()
        for original in originals:
            original.check_known(list(original.tracks.values()))
            joining.add(original)
        if times is None and wait is None and one_recording(originals):
            times = "same"
        known, notes = known_offsets(originals, times)
        head = originals[0].head
        if times != "same" or not one_recording(originals):
            head = another(head, Fraction(0), canonical)
        text = f"concatenated from {', '.join(map(dated, originals))}"
        metadata = with_note(combined([o.catalogue.metadata for o in originals]), text)
        level = level_for(
            list(joining.tracks.values()),
            *(original.head.limits for original in originals),
            largest=len(build_metadata(metadata)),
        )
        with opened(out, force) as stream:
            making = Making(stream, head, level=level, canonical=canonical, name=name_of(out))
            if len(originals) > 1:
                same = times == "same"
                making.maps_to_drop = differing_maps(originals) if same else Everything()
            for note in [*joining.notes, *notes]:
                making.note(note)
            for number, original in enumerate(originals):
                making.describe(original, joining.plan(number, only_new=True))
            making.metadata(metadata)
            copy_all(making, originals, joining, known, wait or Fraction(0), progress)
            return making.close()


def known_offsets(
    originals: Sequence[Original], times: Times | None
) -> tuple[list[Fraction] | None, list[str]]:
    """Where the zeros lie; None: each at the end of the file before."""
    if times == "same":
        return [Fraction(0)] * len(originals), []
    if times == "epoch":
        return by_epoch(originals[0], originals, [period_of(originals)] * len(originals))
    return None, []


def copy_all(
    making: Making,
    originals: Sequence[Original],
    joining: Joining,
    known: list[Fraction] | None,
    gap: Fraction,
    progress: Advance | None,
) -> None:
    period = period_of(originals)
    plans = []
    for number, original in enumerate(originals):
        if known is not None:
            offset = known[number]
        else:
            end = making.span[1] + gap if making.span else Fraction(0)
            offset = -(-end // period) * period
        making.edited.offsets.append(offset)
        plans.append(joining.plan(number, offset))
        making.others(original, plans[-1], behind=False)
        advance = part_of(progress, number, len(originals))
        for packets in making.clusters(original, plans[-1], progress=advance):
            making.put(packets)
        making.others(original, plans[-1], behind=True)
    shared = Counter(place.track.id for plan in plans for place in plan.places.values())
    for original, plan in zip(originals, plans, strict=True):
        together = {old for old, place in plan.places.items() if shared[place.track.id] > 1}
        making.partial.setdefault(original, set()).update(together)
        making.digests(original, plan)


def dated(original: Original) -> str:
    """Its title, and when it was recorded, since only the first epoch is kept."""
    epoch = original.head.epoch_ns
    if epoch is None:
        return title(original)
    try:
        moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=epoch // 1000)
    except OverflowError:
        return title(original)
    return f"{title(original)} ({moment.isoformat()})"


def part_of(progress: Advance | None, number: int, count: int) -> Advance | None:
    """The progress of all files, each of which counts the same."""
    if progress is None:
        return None
    return lambda done, total: progress(number * 1000 + done * 1000 // total, count * 1000)
