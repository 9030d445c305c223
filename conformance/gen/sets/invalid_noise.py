"""SPEC 9.10: packets of NOIS."""

from __future__ import annotations

from collections.abc import Iterator

import broken
import forge as f
import page_noise as page
from broken import packed
from case import Case


def noise(packet: bytes, span: int = 24, width: int = 1, **given: int) -> bytes:
    return packed(b"NOIS", f.nois_parameters(**given), packet, span, component_count=width)


def described(raw: bytes) -> bytes:
    return packed(b"NOIS", raw, b"")


GOOD = page.encode([40, 44, 36], [[50, -20]], 8)
PLAIN = page.encode([40, 44, 36], [], 8)


def changed(at: int, byte: int) -> bytes:
    return GOOD[:at] + bytes([byte]) + GOOD[at + 1 :]


LF = broken.series(
    (f.trak(f.tlv(1, f.nois_parameters()), codec=b"NOIS", kind=1), 0),
    (f.trak(kind=2, base=0), 1),
    data=("DATA", f.cluster((0, 0, 4, b""), (1, 0, 4, f.KNOT_DATA))),
)
PARAMETERS = [
    ("noise-parameters-cut-short", "COD-002", "The parameters of NOIS have one byte.",
     described(b"\3")),
    ("noise-parameters-and-a-byte", "COD-002", "A byte follows the parameters of NOIS.",
     described(f.nois_parameters() + b"\0")),
    ("noise-lf", "NOI-001", "A track of NOIS is of kind LF.", LF, None, [0, 2]),
    ("noise-with-deadband", "NOI-001", "A track of NOIS has a deadband contract.",
     packed(b"NOIS", f.nois_parameters(), b"", tlvs=f.tlv(16, f.deadband())), None, [0, 2]),
    ("noise-shift-2", "NOI-003", "An interval has four ticks.",
     described(f.nois_parameters(2, 255))),
    ("noise-shift-13", "NOI-003", "An interval has 8192 ticks.",
     described(f.nois_parameters(13, 1))),
    ("noise-block-of-no-interval", "NOI-003", "A block has no interval.",
     described(f.nois_parameters(12, 0))),
    ("noise-block-of-56-ticks", "NOI-003", "A block has 56 ticks.",
     described(f.nois_parameters(3, 7))),
]  # fmt: skip

PACKETS = [
    ("noise-past-the-packet", "LPC-001", "The first component is larger than the packet.",
     noise(b"\1", width=2)),
    ("noise-size-missing", ("CNV-002", "LPC-001"), "The size of the first component is missing.",
     noise(b"", width=2), None, 2),
    ("noise-order-33", "NOI-005", "The prediction order is 33.", noise(changed(0, 33))),
    ("noise-head-cut-short", "NOI-005", "A component packet ends within its codings.",
     noise(GOOD[:10])),
    ("noise-head-of-one-byte", "NOI-005", "A component packet has one byte.", noise(b"\0")),
    ("noise-first-gain-113", "NOI-006", "The first gain index is 113.", noise(changed(6, 113))),
    ("noise-gain-113", "NOI-006", "A gain index is 113.",
     noise(page.encode([112, 113], [], 8), 16)),
    ("noise-gain-below-0", "NOI-006", "A gain index is -1.",
     noise(page.encode([0, -1, 0], [], 8))),
    ("noise-gain-far-below-0", "NOI-006", "A gain index is -2^33.",
     noise(page.encode([0, -(2**33), 0], [], 8))),
    ("noise-coefficient-128", "NOI-006", "A coefficient is 128.",
     noise(page.encode([40], [[5, 128]], 8), 8)),
    ("noise-coefficient-too-low", "NOI-006", "A coefficient is -128.",
     noise(page.encode([40], [[5, -128]], 8), 8)),
    ("noise-coefficient-in-between", "NOI-006", "The second of three blocks has 128.",
     noise(page.encode([40] * 24, [[5], [128], [5]], 8), 192)),
    ("noise-coding-bit-5", "RNG-004", "Bit 5 of the coding of gains is 1.",
     noise(changed(7, 0x20))),
    ("noise-coding-of-coefficients-bit-4", "RNG-004", "Bit 4 of the second coding is 1.",
     noise(changed(9, 0x10))),
    ("noise-start-164", "RNG-004", "The start byte of the gains is 164.",
     noise(changed(8, 164))),
    ("noise-start-164-of-coefficients", "RNG-004", "The second start byte is 164.",
     noise(changed(10, 164))),
    ("noise-and-a-byte", "RNG-001", "A byte follows the coded bytes.", noise(GOOD + b"\0")),
    ("noise-byte-missing", "RNG-001", "The last coded byte is missing.", noise(GOOD[:-1])),
    ("noise-coded-empty", "RNG-001", "No byte is coded.", noise(PLAIN[:9])),
    ("noise-difference-of-2-to-34", ("RNG-003", "NOI-006"), "A difference is 2^34.",
     noise(page.encode([0, 2**34], [], 8), 16)),
]  # fmt: skip


def cases() -> Iterator[Case]:
    yield from broken.cases("structure/parameters", PARAMETERS)
    yield from broken.cases("entropy/noise", PACKETS)
