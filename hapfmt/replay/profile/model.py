"""A device profile: its actuators, reports and safety limits (docs/spec/players.md).

Also the byte layout of one report; ``at`` counts from the report id. And the frames that renderer,
schedule and sinks exchange.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from math import ceil, floor
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Path = Literal["output", "feature"]

_SIZES = {"8": 1, "16": 2, "32": 4}
_CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i"}


@dataclass(frozen=True)
class Integer:
    """An integer type by name."""

    name: str

    @property
    def size(self) -> int:
        return _SIZES[self.name[1:].removesuffix("be")]

    @property
    def order(self) -> Literal["<", ">"]:
        return ">" if self.name.endswith("be") else "<"

    @property
    def code(self) -> str:
        """Format character of the module struct."""
        return _CODES[self.name.removesuffix("be")]

    @property
    def low(self) -> int:
        return -(1 << 8 * self.size - 1) if self.name.startswith("i") else 0

    @property
    def high(self) -> int:
        return (1 << 8 * self.size - self.name.startswith("i")) - 1


@dataclass(frozen=True)
class Const:
    at: int
    data: bytes


@dataclass(frozen=True)
class Counter:
    """``(start + n & mask) << shift``, n being the reports sent so far: of this report, or, where
    ``shared`` is a name, of all whose counter shares it."""

    at: int
    type: Integer
    mask: int
    shift: int = 0
    start: int = 0
    shared: str = ""


@dataclass(frozen=True)
class One:
    """The count of one actuator."""

    at: int
    actuator: str
    type: Integer


@dataclass(frozen=True)
class Samples:
    """All samples of a frame: the first of each actuator, then the second of each, and so on."""

    at: int
    actuators: tuple[str, ...]
    type: Integer


@dataclass(frozen=True)
class Mapped:
    """Bytes that a function makes of counts (packing.py)."""

    at: int
    function: str
    actuators: tuple[str, ...]
    options: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Crc32:
    """CRC-32 (RFC 1952), little-endian, of the byte ``seed``, where there is one, and the bytes
    ``start`` up to ``stop``."""

    at: int
    seed: int | None
    start: int
    stop: int


Field = Const | Counter | One | Samples | Mapped | Crc32


@dataclass(frozen=True)
class ReportLayout:
    """One report of a frame. Bytes that no field names are zero."""

    path: Path
    id: int
    length: int
    """With the report id."""
    fields: tuple[Field, ...]
    short: bool = False
    """The device takes it shorter than its report descriptor says."""


__all__ = ["Actuator", "CountLimits", "HidReport", "Match", "Path", "Profile", "Timing", "exact"]


def exact(value: float) -> Fraction:
    """The decimal that a person wrote: 0.3 / 0.1 is 3, where floats make it 2.9999999999999996."""
    return Fraction(str(value))


@dataclass(frozen=True)
class Match:
    """What a device must be for the profile to fit; None: anything."""

    vendor_id: int
    product_id: int | None = None
    bus: Literal["usb", "bluetooth"] | None = None
    usage_page: int | None = None
    usage: int | None = None


@dataclass(frozen=True)
class Actuator:
    """One channel of a device. Values are numbers in ``unit``; what is sent is a whole number of
    ``step``, the count."""

    name: str
    unit: str
    minimum: float
    maximum: float
    slew: float
    """Largest change, in ``unit`` per second."""
    step: float
    rest: float = 0.0
    band: Literal["full", "lf", "hf"] = "full"
    """What of a channel it can render."""
    accepts: dict[str, float] = field(default_factory=dict)
    """Recorded unit (UCUM) -> ``unit`` per recorded unit; channels in other units are refused."""
    gain: float = 1.0
    offset: float = 0.0
    """Calibration of this actuator: what it is given is ``gain * value + offset``."""
    rectify: bool = False
    """It renders magnitudes: a negative value counts as its absolute value."""
    quantity: str = ""
    body_site: str = ""


class CountLimits(NamedTuple):
    """The limits of an actuator in counts, rounded inwards."""

    low: int
    high: int
    rest: int
    change: int
    """From one sample to the next."""


class HidReport(NamedTuple):
    """Bytes for the device; the first is the report id."""

    path: Path
    data: bytes


@dataclass(frozen=True)
class Timing:
    rate: Fraction
    """Samples of an actuator per second."""
    frame_samples: int = 1
    """Samples of each actuator in a frame."""
    hold_s: float = 0.020
    """So late a frame may be; after that the player ramps to rest and stops."""
    ramp_s: float = 0.050
    neutral_count: int = 5
    """Times that the neutral frame is sent at the end."""
    device_timeout_s: float | None = None
    """Time after which the device goes to rest by itself; None: it does not, or that is unknown."""

    @property
    def period(self) -> Fraction:
        """Seconds from one frame to the next."""
        return self.frame_samples / self.rate


@dataclass(frozen=True)
class Profile:
    name: str
    description: str
    source: str
    """Where the layout of its reports is documented."""
    matches: tuple[Match, ...]
    timing: Timing
    actuators: tuple[Actuator, ...]
    reports: tuple[ReportLayout, ...] = ()
    """Reports of one frame, in the order they are sent."""
    neutral: tuple[HidReport, ...] = ()
    """Instead of a frame at rest, where the device has a report for it."""
    init: tuple[HidReport, ...] = ()
    exit: tuple[HidReport, ...] = ()
    gain: float = 0.5
    """Gain of all actuators, unless the caller gives another."""
    text: str = ""
    """The TOML that it was parsed from."""

    def places(self, names: tuple[str, ...]) -> tuple[int, ...]:
        """Indices of the actuators with these names."""
        index = {actuator.name: n for n, actuator in enumerate(self.actuators)}
        return tuple(index[name] for name in names)

    @cached_property
    def count_limits(self) -> tuple[CountLimits, ...]:
        """The limits of each actuator in counts."""
        return tuple(map(self.limits, self.actuators))

    def limits(self, actuator: Actuator) -> CountLimits:
        step = exact(actuator.step)
        return CountLimits(
            ceil(exact(actuator.minimum) / step),
            floor(exact(actuator.maximum) / step),
            floor(exact(actuator.rest) / step + Fraction(1, 2)),
            floor(exact(actuator.slew) / self.timing.rate / step),
        )


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
