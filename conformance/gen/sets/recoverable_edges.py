"""Headers across the edges of buffers: the scan looks at every byte offset (SPEC 14.1)."""

from __future__ import annotations

from collections.abc import Iterator

import forge as f
import wreck as w
from case import Case
from wreck import ALL, HEAD, THREE, wrecked

BAIT = f.SYNC + f.SYNC[:3] + f.SYNC[:2] + f.SYNC[:1]
"""False starts, before the header that is looked for."""


def cases() -> Iterator[Case]:
    for edge, shift in (
        (4096, 1), (4096, 2), (4096, 3), (4096, 4), (4096, 17), (4096, 31),
        (32768, 2), (32768, 31),
    ):  # fmt: skip
        yield across(edge, shift, from_start=False)
    for edge, shift in ((4096, 2), (8192, 3), (32768, 1)):
        yield across(edge, shift, from_start=True)


def across(edge: int, shift: int, *, from_start: bool) -> Case:
    """``shift`` bytes of a header stand before the edge, which is counted from where the scan
    starts or from the start of the file."""
    begin = len(w.lay(HEAD, THREE, *w.clusters(0), close=False).data)
    scan = begin + w.HEADER
    at = (scan if from_start else 0) + edge - shift
    name = f.strings("a", "")
    filler = at - scan - len(name) + 1
    content = (bytes(filler) + BAIT)[-filler:]
    laid = w.lay(HEAD, THREE, *w.clusters(0), ("aTTc", name + content), *w.clusters(4, 8))
    place = laid.of("aTTc")
    data = w.without(laid.data, place.payload + 8)
    assert data[at : at + 8] == f.SYNC + b"DATA"
    where = "scan" if from_start else "file"
    return wrecked(
        f"edge-{where}-{edge}-{shift}",
        f"After a lost byte a header has {shift} of its bytes before offset {edge} of the "
        f"{where}.",
        ["REC-002", "CHK-002"], "transmission/lost-bytes", data,
        decode=w.decoded(dict.fromkeys(range(3), ALL)) | {"attachments": []},
        damages=[("bad-payload", place.at, place.size)],
    )  # fmt: skip
