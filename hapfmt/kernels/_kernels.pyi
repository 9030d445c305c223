from typing import Any

from numpy.typing import NDArray

Buffer = bytes | bytearray | NDArray[Any]

def lpcr_decode(
    data: Buffer,
    coefficients: Buffer,
    difference: int,
    repeats: bool,
    base: int,
    limit: int,
    indices: Buffer,
    /,
) -> tuple[int, int]: ...
def lpcr_encode(
    out: Buffer,
    coefficients: Buffer,
    difference: int,
    repeats: bool,
    base: int,
    limit: int,
    indices: Buffer,
    /,
) -> tuple[int, int]: ...
def exact_decode(
    coded: Buffer,
    bits: Buffer,
    ids: Buffer,
    widths: Buffer,
    corrections: Buffer,
    work: Buffer,
    shift: int,
    /,
) -> tuple[int, int, int]: ...
def exact_encode(
    coded: Buffer,
    bits: Buffer,
    ids: Buffer,
    widths: Buffer,
    corrections: Buffer,
    work: Buffer,
    shift: int,
    /,
) -> tuple[int, int, int]: ...
