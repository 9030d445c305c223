"""A slow part, or a residual, that becomes a channel of its own (SPEC TRK-012, EDT-006)."""

from __future__ import annotations

from dataclasses import replace

from ..format.track import Affine, Contract, Track

FLOOR_LIMIT = (1 << 32) - 1


def reach_of(track: Track) -> int:
    return max(abs(track.count_min), abs(track.count_max), 1)


def slow_alone(track: Track, residual: Track) -> Track:
    """The LF track in full band, its contract an aim: as far from the recording as the channel was,
    and as its residual reaches."""
    size = len(track.components)
    known = residual.contract or Contract(0, 1, False, False, (0,) * size, (0,) * size)
    floor = tuple(min(floor + reach_of(residual), FLOOR_LIMIT) for floor in known.floor)
    return replace(
        track, kind="full", unknown=(), contract=known._replace(guaranteed=False, floor=floor)
    )


def residual_alone(track: Track, residual: Track) -> Track:
    """The HF track in full band, described as its base is; B of the calibration is 0 (DEC-005).

    Nobody recorded it by itself: its contract is an aim.
    """
    components = tuple(
        replace(c, calibration=Affine(c.calibration.a, 0, c.calibration.d))
        for c in track.components
    )
    size = len(components)
    floor = residual.contract.floor if residual.contract else (1,) * size
    contract = Contract(0, 1, False, False, floor, (0,) * size)
    return replace(
        residual, kind="full", base=None, unknown=(), components=components, contract=contract
    )
