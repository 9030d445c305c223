"""One file -> parts, one after the other; each packet lies in the part in which it begins."""

from __future__ import annotations

import string
from collections.abc import Sequence
from fractions import Fraction

from ..format.cluster import Packet
from ..format.wire import FILE_ID_LIMIT, check_file_id
from ..errors import ParameterError
from ..numbers import exact
from ..reading.seconds import Seconds
from .making import Edited, refuse_output
from .original import Advance, Input, Original, open_original
from .subset import Window, choose, title, write_part

PARTS_LIMIT = 100_000


def split(
    file: Input | Original,
    out: str = "part-{:03d}.hapf",
    *,
    every: Seconds | None = None,
    at: Sequence[Seconds] = (),
    to_zero: bool = False,
    canonical: int | None = None,
    force: bool = False,
    progress: Advance | None = None,
) -> list[Edited]:
    """Cut a file at each multiple of ``every`` seconds, or at the times ``at``.

    A packet is kept whole, in the part in which it begins. Every part has all channels, the
    metadata and the attachments. Ticks, epoch and UUID stay as they are, so that :func:`concat`
    puts the parts together again; ``to_zero`` as for :func:`subset`. Parts without a packet are
    left out. ``out`` is the name of a part with a place for its number, from 0 on. Each part
    appears whole or not at all. ``canonical`` is the file id of the first part, the others follow.

    Raises as :func:`subset` does.
    """
    check_file_id(canonical)
    if (every is None) == (not at):
        raise ParameterError("give either every or at")
    step = None if every is None else exact(every)
    times = [exact(time) for time in at]
    if (step is not None and step <= 0) or times != sorted({t for t in times if t > 0}):
        raise ParameterError("times to split at are above 0 and rising")
    with open_original(file) as original:
        cuts = cuts_of(original, step, times)
        names = names_of(out, len(cuts))
        for name in names:
            refuse_output(name, force)
        notes: list[str] = []
        kept = choose(original, None, "full", notes)
        parts = []
        for number, (name, (start, stop)) in enumerate(zip(names, cuts, strict=True)):
            parts.append(
                write_part(
                    original, name, kept, beginning(original, start, stop),
                    f"part {number} of {title(original)}: {float(start)} s to "
                    f"{'the end' if stop is None else f'{float(stop)} s'}",
                    notes, to_zero=to_zero, force=force,
                    canonical=None if canonical is None else (canonical + number) % FILE_ID_LIMIT,
                )
            )  # fmt: skip
            if progress:
                progress(number + 1, len(names))
        return parts


def cuts_of(
    original: Original, step: Fraction | None, times: Sequence[Fraction]
) -> list[tuple[Fraction, Fraction | None]]:
    """Start and stop, in seconds, of the parts that hold packets; one of everything where there
    are none."""
    found = set()
    for packets in original.clusters():
        for packet in packets:
            at = packet.start / original.tracks[packet.track].rate
            found.add(at // step if step else sum(time <= at for time in times))
            if len(found) > PARTS_LIMIT:
                raise ParameterError(f"more than {PARTS_LIMIT} parts: take longer ones")
    if not found:
        return [(Fraction(0), None)]
    if step:
        return [(number * step, (number + 1) * step) for number in sorted(found)]
    edges = [Fraction(0), *times]
    return [
        (edges[number], edges[number + 1] if number + 1 < len(edges) else None)
        for number in sorted(found)
    ]


def beginning(original: Original, start: Fraction, stop: Fraction | None) -> Window:
    """Packets that begin within these seconds."""

    def pick(packet: Packet) -> bool:
        at = packet.start / original.tracks[packet.track].rate
        return start <= at and (stop is None or at < stop)

    return Window(start, stop, pick)


def names_of(template: str, count: int) -> list[str]:
    names = []
    try:
        fields = [name for _, name, _, _ in string.Formatter().parse(template) if name is not None]
        if fields in ([""], ["0"]):
            names = [template.format(number) for number in range(count)]
    except ValueError:
        pass
    if len(set(names)) != count:
        raise ParameterError(
            "the name of a part has one place for its number, such as part-{:03d}.hapf"
        )
    return names
