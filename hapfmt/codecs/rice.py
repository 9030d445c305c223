"""Rice codes of prediction errors (SPEC 9.5), a packet's from its first bit to its last.

R. F. Rice, "Some practical universal noiseless coding techniques", JPL Publication 79-22 (1979).
"""

from __future__ import annotations

from ..errors import FormatError
from ..integers import from_signed, to_signed
from .adaptive import OUT_OF_RANGE

BLOCK = 32
"""Samples that share a parameter."""

ZEROS, RAW_BITS = 24, 35
"""A code of so many zeros goes on with raw bits."""

WIDTH_LIMIT = 31
"""Of a block: 0 where all its errors are 0, else 1 more than the low bits of each code."""


class RiceReader:
    """Prediction errors one after the other; ``offset`` is that of the bits in the file."""

    def __init__(self, data: bytes, offset: int) -> None:
        self.data, self.offset = data, offset
        self.taken = self.count = self.width = 0
        """Bits, errors, and the width of the block."""

    @property
    def place(self) -> int:
        """Where the reader stands; at most the end."""
        return self.offset + min(-(-self.taken // 8), len(self.data))

    def bits(self, n: int) -> int:
        """The next ones, most significant first; 0 behind the end."""
        first, last = self.taken // 8, (self.taken + n + 7) // 8
        chunk = self.data[first:last].ljust(last - first, b"\0")
        self.taken += n
        return int.from_bytes(chunk, "big") >> (8 * last - self.taken) & ((1 << n) - 1)

    def code(self, k: int) -> int:
        zeros = 0
        while zeros < ZEROS and not self.bits(1):
            zeros += 1
        u = self.bits(RAW_BITS) if zeros == ZEROS else zeros << k | self.bits(k)
        return to_signed(u)

    def decode(self) -> int:
        if self.count % BLOCK == 0:
            if self.taken > 8 * len(self.data):
                raise self.wrong_end()
            self.width += self.code(0)
            if not 0 <= self.width <= WIDTH_LIMIT:
                raise FormatError(
                    "a block of Rice codes of no width", requirement="LPC-011", offset=self.place
                )
        self.count += 1
        return self.code(self.width - 1) if self.width else 0

    def wrong_end(self) -> FormatError:
        return FormatError(
            "the Rice codes do not end with their packet",
            requirement="LPC-012",
            offset=self.place,
        )

    def finish(self) -> None:
        rest = -self.taken % 8
        if -(-self.taken // 8) != len(self.data) or self.bits(rest):
            raise self.wrong_end()


class RiceWriter:
    """Takes prediction errors one after the other; ``finish`` gives the bytes."""

    def __init__(self) -> None:
        self.codes: list[int] = []
        self.number = self.count = 0
        """The bits as one number, and how many there are."""

    def encode(self, e: int) -> None:
        u = from_signed(e)
        if u >> RAW_BITS:
            raise ValueError(OUT_OF_RANGE)
        self.codes.append(u)

    def bits(self, value: int, n: int) -> None:
        self.number = self.number << n | value
        self.count += n

    def code(self, u: int, k: int) -> None:
        zeros = u >> k
        if zeros >= ZEROS:
            self.bits(0, ZEROS)
            self.bits(u, RAW_BITS)
        else:
            self.bits(1, zeros + 1)
            self.bits(u & ((1 << k) - 1), k)

    def finish(self) -> bytes:
        last = 0
        for start in range(0, len(self.codes), BLOCK):
            block = self.codes[start : start + BLOCK]
            width = width_of(block)
            self.code(from_signed(width - last), 0)
            last = width
            for u in block if width else []:
                self.code(u, width - 1)
        rest = -self.count % 8
        return (self.number << rest).to_bytes((self.count + rest) // 8, "big")


def width_of(block: list[int]) -> int:
    """The better of the two widths about the mean."""
    total = sum(block)
    if not total:
        return 0
    k = min((11 * total // (16 * len(block))).bit_length(), WIDTH_LIMIT - 1)
    if not k:
        return 1
    upper = sum(u >> k for u in block) + len(block)
    return k + 1 if upper < sum(u >> (k - 1) for u in block) else k
