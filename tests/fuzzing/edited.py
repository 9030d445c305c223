"""Any file edited: refused or done; of an intact file an intact one, with packets of the original."""

from __future__ import annotations

import io
from fractions import Fraction
from typing import Any

from hapfmt import edit
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

from .files import LIMITS, of_file
from .mend import mend_file
from .target import Target, settled

WAYS: tuple[dict[str, Any], ...] = (
    {},
    {"channels": 0, "to_zero": True},
    {"start": Fraction(1, 1000), "stop": Fraction(3, 100)},
    {"band": "lf", "level": 2},
)


def packets(data: bytes) -> list[bytes]:
    """Those of samples; events are coded anew where their ticks change."""
    reader = settled(Reader, data, limits=LIMITS, scan=True)
    if reader is None:
        return []
    tracks = [track.id for track in reader.catalogue.tracks.values() if track.kind != "events"]
    found = settled(lambda: list(reader.packets(dict.fromkeys(tracks, (0, 1 << 62)))))
    return [packet.data for packet in found or ()]


def edited(data: bytes) -> None:
    before = verify(data, limits=LIMITS)
    calls = [(edit.subset, data, way) for way in WAYS]
    calls += [(edit.concat, [data, data], {}), (edit.merge, [data, data], {"times": "same"})]
    own = set(packets(data))
    for call, source, way in calls:
        out = io.BytesIO()
        done = settled(call, source, out, canonical=7, **way)
        if done is None:
            continue
        after = verify(out.getvalue(), limits=LIMITS)
        if before.verdict == "intact":
            assert after.verdict == "intact", (call, way, after)
            assert set(packets(out.getvalue())) <= own


EDITED = [Target("edited", edited, of_file, mend_file, 1 << 12)]
