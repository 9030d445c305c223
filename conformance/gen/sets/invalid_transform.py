"""SPEC 9.8: parameters and packets of MDCT."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import broken
import forge as f
from broken import packed
from case import Case
from mdct import Shape, component, some

PLAIN = Shape()
COARSE = Shape(5, 2**32)


def described(raw: bytes) -> bytes:
    return packed(b"MDCT", raw, component([], base=5))


def given(*parameters: Any, **more: Any) -> bytes:
    return described(f.mdct_parameters(*parameters, **more))


def transformed(packet: bytes, span: int = 32, shape: Shape = PLAIN, **more: Any) -> bytes:
    return packed(b"MDCT", shape.parameters, packet, span, **more)


ONE = component([[3, -1]])
CODED = ONE[4:]
CONSTANT = b"\0\0"


def another_end(packet: bytes) -> bytes:
    """The packet whose state begins 4096 higher: the same symbols, and another state at the end."""
    state = int.from_bytes(packet[4:8], "big") + 4096
    return packet[:4] + state.to_bytes(4, "big") + packet[8:]


def loud(*integers: int, shape: Shape = COARSE) -> bytes:
    return component([list(integers)], shape, loud=True)


PARAMETERS = [
    ("transform-parameters-cut-short", "COD-002", "The parameters of MDCT end behind the step.",
     described(b"\5\1")),
    ("transform-weights-cut-short", "COD-002", "Of four weights three are there.",
     given(5, 256, (32, 32, 32), 4)),
    ("transform-parameters-and-a-byte", "COD-002", "A byte follows the weights of MDCT.",
     given(5, 256, (32, 32, 32), 2)),
    ("transform-step-cut-short", ("COD-002", "CNV-002"), "The parameters end within the step.",
     described(b"\5\x80")),
    ("transform-blocks-of-16", "MDC-001", "A block has 16 coefficients.", given(4)),
    ("transform-blocks-of-1024", "MDC-001", "A block has 1024 coefficients.", given(10)),
    ("transform-blocks-of-2-to-255", "MDC-001", "A block has 2^255 coefficients.", given(255)),
    ("transform-step-0", "MDC-001", "The step is 0.", given(5, 0)),
    ("transform-step-above-2-to-32", "MDC-001", "The step is 2^32 + 1.", given(5, 2**32 + 1)),
    ("transform-three-weights", "MDC-001", "There are three weights.", given(5, 256, (32,) * 3)),
    ("transform-64-weights-of-32", "MDC-001", "There are 64 weights for 32 coefficients.",
     given(5, 256, (32,) * 64)),
    ("transform-255-weights", "MDC-001", "There are 255 weights.", given(9, 256, (32,) * 255)),
]  # fmt: skip

PACKETS = [
    ("transformed-of-no-bytes", "CNV-002", "A packet of MDCT is empty.", transformed(b""), None, 2),
    ("transformed-without-kept", "CNV-002", "A component packet ends before K.", transformed(b"\0"),
     None, 2),
    ("transformed-base-too-high", "MDC-002", "The base is 2^24 + 1.",
     transformed(component([], base=2**24 + 1))),
    ("transformed-base-too-low", "MDC-002", "The base is -2^24 - 1.",
     transformed(component([], base=-(2**24) - 1))),
    ("transformed-33-coefficients", "MDC-002", "33 of 32 coefficients are coded.",
     transformed(b"\0\x21" + ONE[2:])),
    ("transformed-2-to-53-coefficients", "MDC-002", "2^53 - 1 coefficients are coded.",
     transformed(b"\0" + f.varint(2**53 - 1) + ONE[2:])),
    ("transformed-constant-and-a-byte", "COD-001", "K is 0, and a byte follows.",
     transformed(b"\0\0\0")),
    ("transformed-sum-too-large", "MDC-003", "The coefficients of a block add up to 2^36 + 2^32.",
     transformed(loud(4, -4, 0, 1, 1), shape=COARSE)),
    ("transformed-coefficient-too-large", "MDC-003", "A coefficient is 10 * 2^33.",
     transformed(loud(10), shape=COARSE)),
    ("transformed-second-block-too-large", "MDC-003", "The second block is too large.",
     transformed(component([[1], [9]], COARSE, loud=True), 33, COARSE)),
    ("transformed-coefficient-of-2-to-67", "MDC-003", "A coefficient is 2^67, the step 2^32.",
     transformed(loud(2**34 - 1), shape=COARSE)),
    ("transformed-integer-of-2-to-34", "RNG-003", "An integer is 2^34.",
     transformed(loud(2**34, shape=Shape(5, 1)), shape=Shape(5, 1))),
    ("transformed-coding-missing", "RNG-004", "A component packet ends behind K.",
     transformed(b"\0\2")),
    ("transformed-without-start", "RNG-004", "The start byte is missing.",
     transformed(ONE[:3])),
    ("transformed-start-164", "RNG-004", "The start byte is 164.",
     transformed(ONE[:3] + b"\xa4" + CODED)),
    ("transformed-coded-none", "RNG-001", "No byte is coded for two coefficients.",
     transformed(ONE[:4])),
    ("transformed-coded-and-a-byte", "RNG-001", "A byte follows the coded bytes.",
     transformed(ONE + b"\0")),
    ("transformed-byte-between", "RNG-001", "A byte of zeros is between front and back.",
     transformed(ONE[:-1] + b"\0" + ONE[-1:])),
    ("transformed-byte-missing", "RNG-001", "The last coded byte is missing.",
     transformed(component(some(4, 9, 1, 2, 50))[:-1])),
    ("transformed-ends-with-another-state", "RNG-001", "The last state is not 65536.",
     transformed(another_end(ONE))),
    ("transformed-filled-with-a-one", "RNG-001", "A 1 follows the last raw bit.",
     transformed(ONE[:-1] + bytes([ONE[-1] | 128]))),
    ("transformed-block-too-few", ("RNG-001", "RNG-003", "MDC-003"),
     "The coded bytes of one block, for two.", transformed(ONE, 33)),
    ("transformed-block-too-many", "RNG-001", "The coded bytes of two blocks, for one.",
     transformed(component([[3, -1], [2, 2]]), 32)),
    ("transformed-components-past-the-packet", "LPC-001",
     "The first component is larger than the packet.",
     transformed(b"\5" + CONSTANT * 2, component_count=2)),
    ("transformed-component-missing", "CNV-002", "No byte is left for the second component.",
     transformed(b"\2" + CONSTANT, component_count=2), None, 2),
    ("transformed-component-in-the-middle", "MDC-002", "The second of three components is wrong.",
     transformed(b"\2\2" + CONSTANT + b"\0\x21" + CONSTANT, component_count=3)),
]  # fmt: skip


def cases() -> Iterator[Case]:
    yield from broken.cases("structure/parameters", PARAMETERS)
    yield from broken.cases("entropy/transformed", PACKETS)
