"""What the decoder makes of an encoder's packets, beside what was recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..deadband import Deadband
from ..reading.decoder import TrackDecoder
from ..recording import Calibration, Channel
from .unit import ENCODE_LEVEL, Unit


def decoded_pieces(unit: Unit) -> Iterator[NDArray[np.int64]]:
    """Packet by packet the counts [ticks, components] of the full band."""
    base = TrackDecoder(unit.base.track, ENCODE_LEVEL)
    low, high = unit.base.track.count_min, unit.base.track.count_max
    if unit.residual is None:
        for packet in unit.base.packets:
            yield base.decode(packet).astype(np.int64)
        return
    residual = TrackDecoder(unit.residual.track, ENCODE_LEVEL)
    for slow, fast in zip(unit.base.packets, unit.residual.packets, strict=True):
        counts = base.decode(slow).astype(np.int64) + residual.decode(fast)
        yield np.clip(counts, low, high)


def largest_errors(
    unit: Unit, members: Sequence[Channel], originals: Sequence[Channel]
) -> list[float]:
    """Of each channel the largest distance of a decoded sample from the recorded one, in its
    unit. AssertionError where a guaranteed contract is broken."""
    if unit.exact:
        # Counts that came as counts came back; of others the grid is all that was lost.
        return [
            0.0 if original.is_counts or member.deviation is None else member.deviation.largest
            for member, original in zip(members, originals, strict=True)
        ]
    calibrations = [
        Calibration(c.calibration.a, c.calibration.b, c.calibration.d)
        for c in unit.base.track.components
    ]
    contract, band = (unit.residual or unit.base).track.contract, None
    if contract and contract.guaranteed:
        band = Deadband(contract.kn, contract.kd, contract.floor, contract.zero, contract.vector)
    errors = [0.0] * len(members)
    at = 0
    for piece in decoded_pieces(unit):
        rows = slice(at, at + len(piece))
        at += len(piece)
        if band is not None:
            counts = np.column_stack([channel.stored[rows] for channel in members])
            if band.outside(counts.astype(np.int64), piece).any():
                raise AssertionError("an encoder that guarantees a bound left it")
        for place, (original, calibration) in enumerate(zip(originals, calibrations, strict=True)):
            away = np.abs(recorded(original, rows) - calibration.physical(piece[:, place]))
            errors[place] = max(errors[place], float(away.max(initial=0.0)))
    return errors


def recorded(channel: Channel, rows: slice) -> NDArray[np.float64]:
    """Some samples of a channel in its unit."""
    if channel.calibration is not None:
        return channel.calibration.physical(channel.stored[rows])
    return np.asarray(channel.stored[rows], np.float64)
