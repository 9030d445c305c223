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
    indices: Buffer,
    /,
) -> tuple[int, int]: ...
def fewest_hold(lower: Buffer, upper: Buffer, ticks: Buffer, values: Buffer, /) -> int: ...
def fewest_linear(
    lower: Buffer,
    upper: Buffer,
    first: int,
    step: int,
    count: int,
    levels: Buffer,
    ticks: Buffer,
    values: Buffer,
    /,
) -> int: ...
def knots_decode(
    packet: Buffer,
    quantum: int,
    components: int,
    lines: bool,
    tick_limit: int,
    bound: int,
    low: int,
    high: int,
    values: Buffer,
    counts: Buffer,
    /,
) -> bool: ...
def select_knots(
    table: Buffer,
    zero: Buffer,
    floor: Buffer,
    kn: int,
    kd: int,
    vector: bool,
    by_sample: bool,
    ticks: Buffer,
    /,
) -> int: ...
def quan_decode(
    packet: Buffer,
    lengths: Buffer,
    direct_levels: int,
    run_classes: int,
    escape_classes: int,
    step: int,
    bound: int,
    low: int,
    high: int,
    counts: Buffer,
    /,
) -> bool: ...
def quan_encode(
    levels: Buffer,
    lengths: Buffer,
    direct_levels: int,
    run_classes: int,
    escape_classes: int,
    packet: Buffer,
    /,
) -> int: ...
def deadband_levels(
    step: int, kn: int, kd: int, bound: int, levels: Buffer, tops: Buffer, /
) -> int: ...
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
def build_varints(numbers: Buffer, out: Buffer, /) -> int: ...
def rice_decode(
    packet: Buffer,
    coefficients: Buffer,
    difference: int,
    base: int,
    limit: int,
    indices: Buffer,
    /,
) -> tuple[int, int]: ...
def rice_encode(
    packet: Buffer,
    coefficients: Buffer,
    difference: int,
    base: int,
    limit: int,
    indices: Buffer,
    /,
) -> tuple[int, int]: ...
def quick_predictor(
    indices: Buffer,
    sines: Buffer,
    limits: Buffer,
    costs: Buffer,
    reflections: Buffer,
    coefficients: Buffer,
    /,
) -> tuple[int, int]: ...
def clamp_counts(
    numbers: Buffer, step: int, zero: int, low: int, high: int, counts: Buffer, /
) -> None: ...
