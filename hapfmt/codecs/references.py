"""Components of one LPCR packet that say something of a later one (SPEC 9.5)."""

from __future__ import annotations

from typing import NamedTuple

from ..errors import FormatError, TruncatedError

REFERENCE_LIMIT = 8
REFERENCE_SIZE = 4
TAPS = (-1, 0, 1)
"""Ticks of a reference beside the one that is decoded."""


class Reference(NamedTuple):
    """A component before this one, and 64 times what each of its ``TAPS`` counts for."""

    component: int
    weights: tuple[int, int, int]

    def build(self) -> bytes:
        return bytes([self.component, *(weight & 0xFF for weight in self.weights)])


def build_references(references: tuple[Reference, ...]) -> bytes:
    return bytes([len(references)]) + b"".join(each.build() for each in references)


def parse_references(
    data: bytes, position: int, place: int, offset: int
) -> tuple[tuple[Reference, ...], int]:
    """The references of the component at ``place``, and the position after them."""
    count = data[position] if position < len(data) else 0
    end = position + 1 + REFERENCE_SIZE * count
    if end > len(data):
        raise TruncatedError(
            "the packet ends within its references", requirement="LPC-006", offset=offset + position
        )
    references = []
    for at in range(position + 1, end, REFERENCE_SIZE):
        weights = tuple(byte - 256 if byte > 127 else byte for byte in data[at + 1 : at + 4])
        references.append(Reference(data[at], weights))  # type: ignore[arg-type]
    components = [each.component for each in references]
    rising = all(a < b for a, b in zip(components, [*components[1:], place], strict=False))
    if not 1 <= count <= REFERENCE_LIMIT or not rising:
        raise FormatError(
            "references that are not defined", requirement="LPC-007", offset=offset + position
        )
    return tuple(references), end
