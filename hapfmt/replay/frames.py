"""The data types that renderer, schedule and sinks exchange."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

from .profile.model import HidReport

if TYPE_CHECKING:  # a watchdog starts without arrays
    import numpy as np
    from numpy.typing import NDArray


class FrameBlock(NamedTuple):
    """Values for the device, rendered ahead of their time.

    ``values`` [samples, actuators], in the actuator's unit, calibrated; ``known`` [samples,
    actuators]: False where there is nothing to play (a gap, an actuator that nothing is assigned
    to, the end), whatever the value says. ``first``: number of the first sample since the start of
    the replay at the device's rate. ``generation``: 0, and one more after each seek; ``last``:
    nothing comes after it.
    """

    first: int
    values: NDArray[np.float64]
    known: NDArray[np.bool_]
    generation: int = 0
    last: bool = False


class Frame(NamedTuple):
    """What is due: ``counts`` [frame_samples][actuators], within every limit of the profile."""

    number: int
    due_ns: int
    """Since the start of the replay."""
    counts: tuple[tuple[int, ...], ...]


class FrameSink(Protocol):
    """Where frames go. ``open`` and ``send`` raise DeviceError; ``close`` never does."""

    def open(self) -> None: ...

    def send(self, frame: Frame, reports: tuple[HidReport, ...]) -> None: ...

    def close(self) -> None: ...
