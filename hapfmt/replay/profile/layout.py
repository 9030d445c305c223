"""The bytes of one report, as a profile describes them; ``at`` counts from the report id."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

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
        """Of the module struct."""
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
    """Bytes that a function makes of counts (maps.py)."""

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
class Layout:
    """One report of a frame. Bytes that no field names are zero."""

    path: Path
    id: int
    length: int
    """With the report id."""
    fields: tuple[Field, ...]
    short: bool = False
    """The device takes it shorter than its report descriptor says."""
