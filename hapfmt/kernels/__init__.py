"""The compiled loops, if they were built. Each loop has a readable Python twin that can replace it.

The twins run if the environment has ``HAPFMT_PURE=1``, or if a C source is newer than the build.
This module declares the types of the C functions. Each .c file has the functions of one codec or
search, and names its twin. Those of codecs/ are lpcr, knots, knots_coded, huffman (QUAN), exact
(LPCX), transform (MDCT), noise (NOIS) and levels (grids). Those of encoder/ are select, tube,
sweep, links, packet, references, ``lattice``, trellis and vectors.
That of split.py is sections.
Shared headers: coder.h, integers.h, coded.h and flags.h implement SPEC 9.4, each on top of the one
before.
lpcr.h implements 9.5, components.h its packets, search.h its predictors, lines.h the counts
between knots. bytes.h takes varints from packets.
"""

from __future__ import annotations

import os
import warnings
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, cast

if TYPE_CHECKING:
    from numpy.typing import NDArray

Buffer: TypeAlias = "bytes | bytearray | NDArray[Any]"


class CompiledLoop(Protocol):
    """(packet, coefficients int32, difference, repeats, base, limit, cross int64 or none,
    indices int64) -> (status, bytes of the packet read or written); the last argument, or for
    encoding the first, is filled.
    """

    def __call__(
        self,
        packet: Buffer,
        coefficients: Buffer,
        difference: int,
        repeats: bool,
        base: int,
        limit: int,
        cross: Buffer,
        indices: Buffer,
        /,
    ) -> tuple[int, int]: ...


class PacketDecode(Protocol):
    """(packet, components, largest index, step, zero, magnitudes of a deadband's grid int64 or
    none, least and largest count, sines int32 [128], counts int32 [components, ticks]) -> 0 where
    it breaks a rule, 1 where all counts lie within the range, 2 where some were moved into it; the
    last argument is filled."""

    def __call__(
        self,
        packet: Buffer,
        components: int,
        limit: int,
        step: int,
        zero: int,
        levels: Buffer,
        low: int,
        high: int,
        sines: Buffer,
        counts: Buffer,
        /,
    ) -> int: ...


class FewestHold(Protocol):
    """(lower, upper, ticks, values: int64 [ticks]) -> number of knots; the last two are filled."""

    def __call__(self, lower: Buffer, upper: Buffer, ticks: Buffer, values: Buffer, /) -> int: ...


class FewestLinear(Protocol):
    """(lower, upper, first, step, count, levels, ticks, values) -> number of knots, 0 where the
    grid has none; its values are ``levels``, int64 [count], or first + step * i where those are
    empty; the others as for held values."""

    def __call__(
        self,
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


class FewestJoined(Protocol):
    """(lower, upper: int64 [axes, ticks], first, step and count: int64 [axes, 3], ticks: int64
    [ticks], places: int64 [ticks, axes]) -> number of knots, more than one being needed; the last
    two are filled from their end."""

    def __call__(
        self, lower: Buffer, upper: Buffer, grids: Buffer, ticks: Buffer, places: Buffer, /
    ) -> int: ...


class KnotsDecode(Protocol):
    """(packet, components, lines, largest index, step, zero, magnitudes of a deadband's grid int64
    or none, least and largest count, int64 [2 * components], int32 [ticks * components]) -> whether
    it keeps the rules of SPEC 9.1; the last argument is filled with counts, the one before is used
    up."""

    def __call__(
        self,
        packet: Buffer,
        components: int,
        lines: bool,
        limit: int,
        step: int,
        zero: int,
        levels: Buffer,
        low: int,
        high: int,
        values: Buffer,
        counts: Buffer,
        /,
    ) -> bool: ...


class CodedKnotsDecode(Protocol):
    """(coded bytes, lines, knots after the first, largest index, step, zero, magnitudes of a
    deadband's grid int64 or none, least and largest count, indices of the first knot int64
    [components], zeros int64 [2 * components], int32 [ticks * components]) -> (status, bytes
    read); the last argument is filled with counts, the two before are used up."""

    def __call__(
        self,
        coded: Buffer,
        lines: bool,
        further: int,
        limit: int,
        step: int,
        zero: int,
        levels: Buffer,
        low: int,
        high: int,
        first: Buffer,
        work: Buffer,
        counts: Buffer,
        /,
    ) -> tuple[int, int]: ...


class CodedKnotsEncode(Protocol):
    """(ticks int64 [knots], indices int64 [knots * components], lines, coded bytes) -> (status,
    size); the last argument is filled."""

    def __call__(
        self, ticks: Buffer, indices: Buffer, lines: bool, coded: Buffer, /
    ) -> tuple[int, int]: ...


class SelectKnots(Protocol):
    """(int64 [ticks, components], zero, floor: int64, kn, kd, vector, by sample, int64 [ticks])
    -> number of knots; the last argument is filled with their ticks."""

    def __call__(
        self,
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


class QuanDecode(Protocol):
    """(packet, code word lengths uint8 [symbols], direct levels, run classes, escape classes, step,
    largest level, least and largest count, int32 [levels]) -> whether it keeps the rules of
    SPEC 9.2; the last argument is filled with counts."""

    def __call__(
        self,
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


class QuanEncode(Protocol):
    """(levels int64, code word lengths uint8 [symbols], direct levels, run classes, escape classes,
    packet) -> bytes of the packet, which is filled as far as it goes; -1: a level has no word."""

    def __call__(
        self,
        levels: Buffer,
        lengths: Buffer,
        direct_levels: int,
        run_classes: int,
        escape_classes: int,
        packet: Buffer,
        /,
    ) -> int: ...


class DeadbandLevels(Protocol):
    """(step, kn, kd, bound, levels, tops) -> how many of the int64 rows were filled; -1: they have
    no room for all."""

    def __call__(
        self, step: int, kn: int, kd: int, bound: int, levels: Buffer, tops: Buffer, /
    ) -> int: ...


class CorrectionLoop(Protocol):
    """(exact values of a packet, ids int32 or none, corrections int64, zeros to work in, int64, two
    for each id, shift) -> (status, bytes read or written); the corrections are filled, or
    for encoding the bytes.
    """

    def __call__(
        self,
        coded: Buffer,
        ids: Buffer,
        corrections: Buffer,
        work: Buffer,
        shift: int,
        /,
    ) -> tuple[int, int]: ...


class TransformDecode(Protocol):
    """(coded bytes, waves float64 [size / 16, size, 16], pairs int16 [size / 16, size / 2, 16, 2],
    window int64 [2, size / 2], steps int64 [coded coefficients], classes, start, base, least and
    largest count, counts int32) -> (status, bytes read); the last argument is filled."""

    def __call__(
        self,
        coded: Buffer,
        waves: Buffer,
        pairs: Buffer,
        window: Buffer,
        steps: Buffer,
        classes: int,
        start: int,
        base: int,
        low: int,
        high: int,
        counts: Buffer,
        /,
    ) -> tuple[int, int]: ...


class TransformEncode(Protocol):
    """(levels int64 [blocks, coded coefficients], coded coefficients, classes, start, coded bytes)
    -> how many these are; the last argument is filled if it has room for them."""

    def __call__(
        self, levels: Buffer, count: int, classes: int, start: int, coded: Buffer, /
    ) -> int: ...


class Trellis(Protocol):
    """(targets int64 [blocks, coefficients], coefficients, classes, start, weight, magnitudes int64
    [blocks, coefficients], counts int64 [2, 36, 16]) -> (squared errors, 256 times the
    bits); the last two are filled, the last one from zeros."""

    def __call__(
        self,
        targets: Buffer,
        count: int,
        classes: int,
        start: int,
        weight: int,
        magnitudes: Buffer,
        counts: Buffer,
        /,
    ) -> tuple[int, int]: ...


class EncodePacket(Protocol):
    """(indices int64, sines int32 [128], limits float64 [127], highest order, parts of which
    one is looked at, sums as bits, whether other orders are tried, packets written) -> the packet.
    ValueError where it cannot be coded. encoder/predict.py says more."""

    def __call__(
        self,
        indices: Buffer,
        sines: Buffer,
        limits: Buffer,
        highest: int,
        stride: int,
        sums: int,
        other_orders: bool,
        written: int,
        /,
    ) -> bytes: ...


class FindLinks(Protocol):
    """(rows int64 [count, samples], torn uint8 [samples], sines int32 [128], limits float64 [127],
    least score, factor, found int64 [count, 9], energies float64 [count, 2], totals int64 [count])
    -> samples used; the last three are filled. encoder/references.py says more."""

    def __call__(
        self,
        rows: Buffer,
        torn: Buffer,
        sines: Buffer,
        limits: Buffer,
        enough: float,
        factor: float,
        found: Buffer,
        energies: Buffer,
        totals: Buffer,
        /,
    ) -> int: ...


class Refer(Protocol):
    """(rows int64 [any, samples], target, sources bytes, sines int32 [128], limits float64 [127],
    reflections int8 [32], weights int8 [sources, 3], cross int64 [samples]) -> (order, 256 times
    the bits without sources, and with them, samples that these are of); the last three are
    filled."""

    def __call__(
        self,
        rows: Buffer,
        target: int,
        sources: bytes,
        sines: Buffer,
        limits: Buffer,
        reflections: Buffer,
        weights: Buffer,
        cross: Buffer,
        /,
    ) -> tuple[int, int, int, int]: ...


class BuildVarints(Protocol):
    """(int64 [numbers], uint8 [8 * numbers]) -> size of the varints that the last one is filled
    with."""

    def __call__(self, numbers: Buffer, out: Buffer, /) -> int: ...


class NoiseDecode(Protocol):
    """(coded bytes, order, density, seed, first gain, class and start of the gains, those of the
    coefficients, states, shift, intervals, least and largest count, sines int32 [128], int32
    [ticks]) -> (status, bytes read); the last argument is filled with counts."""

    def __call__(
        self,
        coded: Buffer,
        order: int,
        density: int,
        seed: int,
        gain: int,
        gain_class: int,
        gain_start: int,
        coefficient_class: int,
        coefficient_start: int,
        states: int,
        shift: int,
        intervals: int,
        low: int,
        high: int,
        sines: Buffer,
        counts: Buffer,
        /,
    ) -> tuple[int, int]: ...


class Kernels(Protocol):
    """What the extension module has."""

    @property
    def lpcr_decode(self) -> CompiledLoop: ...
    @property
    def lpcr_packet(self) -> PacketDecode: ...
    @property
    def lpcr_encode(self) -> CompiledLoop: ...

    def lpcr_errors(
        self,
        coefficients: Buffer,
        difference: int,
        base: int,
        limit: int,
        indices: Buffer,
        errors: Buffer,
        /,
    ) -> None: ...

    @property
    def fewest_hold(self) -> FewestHold: ...
    @property
    def fewest_linear(self) -> FewestLinear: ...
    @property
    def fewest_joined(self) -> FewestJoined: ...
    @property
    def knots_decode(self) -> KnotsDecode: ...
    @property
    def build_varints(self) -> BuildVarints: ...
    @property
    def select_knots(self) -> SelectKnots: ...
    @property
    def quan_decode(self) -> QuanDecode: ...
    @property
    def quan_encode(self) -> QuanEncode: ...
    @property
    def deadband_levels(self) -> DeadbandLevels: ...
    @property
    def exact_decode(self) -> CorrectionLoop: ...
    @property
    def exact_encode(self) -> CorrectionLoop: ...
    def exact_packet(
        self,
        rest: Buffer,
        parameters: Buffer,
        calibrations: Buffer,
        counts: Buffer,
        given: bool,
        values: Buffer,
        /,
    ) -> int: ...

    @property
    def coded_knots_decode(self) -> CodedKnotsDecode: ...
    @property
    def coded_knots_encode(self) -> CodedKnotsEncode: ...
    @property
    def mdct_decode(self) -> TransformDecode: ...
    @property
    def mdct_encode(self) -> TransformEncode: ...
    @property
    def mdct_trellis(self) -> Trellis: ...
    @property
    def encode_packet(self) -> EncodePacket: ...
    @property
    def find_links(self) -> FindLinks: ...
    @property
    def refer(self) -> Refer: ...
    @property
    def noise_decode(self) -> NoiseDecode: ...

    def nearest_within(
        self, a: int, b: int, d: int, allowed: float, x: Buffer, counts: Buffer, /
    ) -> tuple[int, float, bool]: ...

    def common_divisor(
        self, least: Buffer, most: Buffer, floor: float, /
    ) -> tuple[float, float] | None: ...

    def double_facts(self, x: Buffer, /) -> tuple[bool, bool, float, float, float]: ...

    def filter_sections(self, sections: Buffer, state: Buffer, x: Buffer, /) -> None: ...

    def clamp_counts(
        self, numbers: Buffer, step: int, zero: int, low: int, high: int, counts: Buffer, /
    ) -> None: ...

    def find_cuts(
        self, indices: Buffer, sines: Buffer, limits: Buffer, starts: Buffer, /
    ) -> int: ...

    def deflate(self, data: Buffer, /) -> bytes: ...

    def piece_bits(self, numbers: Buffer, pieces: int, /) -> float: ...

    def polynomial_bits(self, indices: Buffer, /) -> float: ...

    def step_up(self, reflections: Buffer, sines: Buffer, coefficients: Buffer, /) -> bool: ...

    def autocorrelate(
        self, indices: Buffer, difference: int, base: int, sums: Buffer, /
    ) -> None: ...

    def levinson(
        self, sums: Buffer, orders: int, limits: Buffer, reflections: Buffer, energies: Buffer, /
    ) -> int: ...


STALE = (
    "The compiled loops of hapfmt are older than their sources and are not used, so everything is "
    "slow. Build them again: python -m pip install -e ."
)


def load() -> Kernels | None:
    if os.environ.get("HAPFMT_PURE"):
        return None
    try:
        found = import_module("._kernels", __name__)
    except ImportError:
        return None
    if found.__file__ and is_stale(Path(found.__file__)):
        # They may code by other rules than Python does now.
        warnings.warn(STALE, RuntimeWarning, stacklevel=2)
        return None
    return cast(Kernels, found)


def is_stale(built: Path) -> bool:
    """Whether a source next to the extension was changed after it was built. Only a clone has
    sources there, and an editable installation uses these."""
    time = built.stat().st_mtime_ns
    with os.scandir(built.parent) as entries:
        return any(
            entry.name.endswith((".c", ".h")) and entry.stat().st_mtime_ns > time
            for entry in entries
        )


compiled = load()
"""The extension module, or None."""
