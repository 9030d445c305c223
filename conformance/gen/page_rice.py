"""The Rice codes of SPEC 9.5 a second time, read from the page alone."""

from __future__ import annotations

from page_numbers import BrokenRule


class Rice:
    """Rice codes, in place of both the range coder and the integer model."""

    def __init__(self, packet: bytes | None = None, widths=(5,)):
        self.bits = "" if packet is None else "".join(f"{byte:08b}" for byte in packet)
        self.reading, self.widths = packet is not None, widths
        self.at = self.w = 0
        self.errors: list[int] = []

    def read(self, n: int) -> str:
        self.at += n
        return self.bits[self.at - n : self.at].ljust(n, "0")

    def get(self, k: int) -> int:
        n = 0
        while n < 24 and self.read(1) == "0":
            n += 1
        u = n * 2**k + int("0" + self.read(k), 2) if n < 24 else int(self.read(35), 2)
        return u // 2 if u % 2 == 0 else -(u + 1) // 2

    def code(self, _coder, e: int | None = None) -> int:
        if self.reading:
            if len(self.errors) % 32 == 0:
                if self.at > len(self.bits):
                    raise BrokenRule("LPC-012")
                self.w += self.get(0)
                if not 0 <= self.w <= 31:
                    raise BrokenRule("LPC-011")
            e = self.get(self.w - 1) if self.w > 0 else 0
        self.errors.append(e)
        return e

    def put(self, value: int, k: int) -> None:
        u = 2 * value if value >= 0 else -2 * value - 1
        if u >= 2**35:
            raise BrokenRule("a code of 36 bits")
        low = f"{u % 2**k:0{k}b}" if k > 0 else ""
        self.bits += "0" * 24 + f"{u:035b}" if u // 2**k >= 24 else "0" * (u // 2**k) + "1" + low

    def end(self) -> bytes:
        """Blocks get the widths in turn, those that cannot have them 1."""
        for at in range(0, len(self.errors), 32):
            block, w = self.errors[at : at + 32], self.widths[at // 32 % len(self.widths)]
            w = 1 if w == 0 and any(block) else w
            self.put(w - self.w, 0)
            self.w = w
            for e in block if w > 0 else []:
                self.put(e, w - 1)
        bits = self.bits + "0" * (-len(self.bits) % 8)
        return bytes(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))

    def finish(self) -> bytes | None:
        if not self.reading:
            return self.end()
        if not 0 <= len(self.bits) - self.at < 8 or "1" in self.bits[self.at :]:
            raise BrokenRule("LPC-012")
        return None
