"""What our writers put into files of other formats, so that our readers take it back exactly: the
members of a recording as JSON, and the counts behind physical values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockMap, ClockObservation
from ..errors import ParameterError
from ..recording import Calibration, Event, Recording, index_of_channel
from .common import refusing
from .tables import Import


def own_json(text: str | None, what: str) -> dict[str, Any]:
    """What our writer put under the key ``hapfmt``; {} where nothing is."""
    if text is None:
        return {}
    with refusing(what, RecursionError):
        found = json.loads(text)
    if not isinstance(found, dict):
        raise ParameterError(f"{what}: not a JSON object")
    return found


def restored_counts(
    x: NDArray[Any], calibration: Calibration, dtype: np.dtype[Any]
) -> NDArray[Any] | None:
    """The counts of physical values; None where these are not what the counts give, bit for bit."""
    if not x.size:
        return np.empty(0, dtype)
    with np.errstate(all="ignore"):
        found = np.rint((x.astype(np.float64) * calibration.d - calibration.b) / calibration.a)
        if not (np.abs(found) < 2.0**53).all():
            return None
        whole = found.astype(np.int64)
        counts: NDArray[Any] = whole.astype(dtype)
        if not np.array_equal(counts.astype(np.int64), whole):
            return None
        if not calibration.covers(int(whole.min()), int(whole.max())):
            return None
        given = calibration.physical(counts).astype(x.dtype)
    return counts if np.array_equal(given, x) and not np.signbit(x[x == 0]).any() else None


def own_members(recording: Recording) -> dict[str, Any]:
    """The members of a recording as JSON, where it has them."""
    labels = recording.labels
    events = [
        {**vars(e), "time": str(e.time), "duration": str(e.duration),
         "channel": index_of_channel(e, labels)}
        for e in recording.events
    ]  # fmt: skip
    metadata = {key: value for key, value in recording.metadata.items() if key != "notes"}
    found = {
        "epoch_ns": recording.epoch_ns,
        "epoch_uncertainty_ns": recording.epoch_uncertainty_ns or None,
        "metadata": metadata or None,
        "events": events or None,
        "clocks": [asdict(seen) for seen in recording.clocks] or None,
        "clock_maps": [asdict(one) for one in recording.clock_maps] or None,
    }
    return {key: value for key, value in found.items() if value is not None}


CARRIED = (
    "epoch_ns", "epoch_uncertainty_ns", "events", "calibration", "label", "unit", "quantity",
    "axis", "group", "body_site", "device", "lsb", "clocks", "clock_maps",
)  # fmt: skip


def with_own(made: Import, own: Mapping[str, Any]) -> Import:
    """The import with the members that :func:`own_members` wrote."""
    if not own:
        return made
    with refusing("the metadata of the file", RecursionError, AttributeError):
        events = tuple(Event(**row) for row in own.get("events", []))
        clocks = tuple(ClockObservation(**row) for row in own.get("clocks", []))
        maps = tuple(ClockMap(**row) for row in own.get("clock_maps", []))
        metadata = dict(own.get("metadata", {}))
        uncertainty = int(own.get("epoch_uncertainty_ns", 0))
        epoch_ns = own.get("epoch_ns")
        if epoch_ns is not None:
            epoch_ns = int(epoch_ns)
    return replace(
        made, epoch_ns=epoch_ns, epoch_uncertainty_ns=uncertainty, metadata=metadata,
        events=events, clocks=clocks, clock_maps=maps,
    )  # fmt: skip
