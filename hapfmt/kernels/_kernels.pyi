from typing import Any

from numpy.typing import NDArray

Buffer = bytes | bytearray | NDArray[Any]

def lpcr_decode(
    data: Buffer,
    coefficients: Buffer,
    difference: int,
    repeats: bool,
    raw_signs: bool,
    base: int,
    limit: int,
    cross: Buffer,
    indices: Buffer,
    /,
) -> tuple[int, int]: ...
def lpcr_encode(
    out: Buffer,
    coefficients: Buffer,
    difference: int,
    repeats: bool,
    raw_signs: bool,
    base: int,
    limit: int,
    cross: Buffer,
    indices: Buffer,
    /,
) -> tuple[int, int]: ...
def lpcr_errors(
    coefficients: Buffer,
    difference: int,
    base: int,
    limit: int,
    indices: Buffer,
    errors: Buffer,
    /,
) -> None: ...
def step_up(reflections: Buffer, sines: Buffer, coefficients: Buffer, /) -> bool: ...
def autocorrelate(indices: Buffer, difference: int, base: int, sums: Buffer, /) -> None: ...
def levinson(
    sums: Buffer, orders: int, limits: Buffer, reflections: Buffer, energies: Buffer, /
) -> int: ...
def estimate(
    coefficients: Buffer,
    difference: int,
    repeats: bool,
    counted: bool,
    stride: int,
    base: int,
    limit: int,
    indices: Buffer,
    counts: Buffer,
    /,
) -> int: ...
