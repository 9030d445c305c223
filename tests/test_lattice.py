"""Laws of the lattice search: exact means bit for bit, and a tolerance always holds."""

from __future__ import annotations

import time
from fractions import Fraction
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from stalls import slowness

from hapfmt.encoder.lattice import (
    Lattice,
    Tolerance,
    find_lattice,
    snap_to_lattice,
    sparse,
    to_counts,
)
from hapfmt.encoder.rational import simplest_fraction
from hapfmt.errors import ParameterError
from hapfmt.limits import EXACT_LIMIT, SINGLE_MAX
from hapfmt.recording import Calibration, Channel, Deviation

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

Doubles = NDArray[np.float64]

AWKWARD = [0.0, -0.0, 5e-324, 1e-320, 2.0**-53, 0.1, 1 / 3, 1e9, 2.0**53, -(2.0**53), 2.0**53 + 2]
AWKWARD += [1e300, -1.7976931348623157e308, inf, -inf, nan]


def same_bits(a: Doubles, b: Doubles) -> bool:
    return np.array_equal(a.view(np.int64), b.view(np.int64))


def assert_exact(x: Doubles, lattice: Lattice | None, bits: int = 32) -> Lattice:
    assert lattice is not None
    assert lattice.exact
    assert lattice.largest_deviation == 0
    assert lattice.counts.dtype == np.int64
    assert lattice.counts.shape == x.shape
    assert same_bits(lattice.calibration.physical(lattice.counts), x)
    assert not x.size or np.abs(lattice.counts).max() < 1 << (bits - 1)
    return lattice


def assert_within(x: Doubles, lattice: Lattice, allowed: float) -> None:
    """In exact arithmetic, sample by sample."""
    given = lattice.calibration.physical(lattice.counts)
    deviation = [
        abs(Fraction(a) - Fraction(b)) for a, b in zip(x.tolist(), given.tolist(), strict=True)
    ]
    assert max(deviation) <= Fraction(lattice.largest_deviation) <= Fraction(allowed)
    assert np.abs(lattice.counts).max() < 1 << 31


# --- what is found


K = np.arange(-300, 4000)
SPARSE_K = np.array([0, 6, 15, 35, 1006, 1021, 30000])  # no difference is 1

EXACT = {
    "integers": (K * 1.0, Calibration()),
    "torque in steps of 2": (K * 2.0, Calibration(2)),
    "odd numbers": (K * 2.0 + 1, Calibration(2, 1)),
    "one below a multiple of 4": (K * 4.0 + 3, Calibration(4, -1)),
    "milliamperes": (K / 1000, Calibration(1, 0, 1000)),
    "decimals in steps of 5": (K / 200, Calibration(1, 0, 200)),
    "ten places": (SPARSE_K / 1e10, Calibration(1, 0, 10**10)),
    "14-bit ADC": (K * 20 / 16384, Calibration(5, 0, 4096)),
    "16-bit ADC": (K * 20 / 65535, Calibration(4, 0, 13107)),
    "mid-riser": ((K + 0.5) * 20 / 4095, Calibration(4, 2, 819)),
    "few codes": (SPARSE_K * 20 / 65535, Calibration(4, 0, 13107)),
    "third of a degree": (K / 3, Calibration(1, 0, 3)),
    "large denominator": (K * 1234577 / 7654321, Calibration(1234577, 0, 7654321)),
    "float32 of 0.1": (K * float(np.float32(0.1)), Calibration(13421773, 0, 1 << 27)),
    "0.001 far from zero": ((10**12 + K) / 1000, Calibration(1, 10**12, 1000)),
    "offset beyond 24 bits": (K + 2.0**30, Calibration(1, 2**30 // 10**7 * 10**7, 1)),
    "offset without a common step": ((K * 77 + 5) / 65521, Calibration(77, 5, 65521)),
    "two values": (np.array([0.25, 0.1]), Calibration(3, -1, 20)),
    "up to the limit": (np.array([2.0**52 - 2, 2.0**52 - 1]), None),
    "both ends": (np.array([1 - 2.0**52, 0.0, 2.0**52 - 1]), Calibration(2**52 - 1)),
}


@pytest.mark.parametrize("name", EXACT)
def test_exact_lattice(name: str) -> None:
    x, calibration = EXACT[name]
    lattice = assert_exact(x, find_lattice(x))
    if calibration is not None:
        assert lattice.calibration == calibration
    order = np.random.default_rng(1).integers(0, x.size, 3 * x.size)
    assert_exact(x[order], find_lattice(x[order]))


@pytest.mark.parametrize(
    ("value", "calibration", "count"),
    [
        (0.0, Calibration(), 0),
        (5.0, Calibration(), 5),
        (0.1, Calibration(1, 0, 10), 1),
        (-0.6, Calibration(1, 0, 10), -6),
        (9.99985, Calibration(1, 0, 100000), 999985),
        (9.999847409781033, Calibration(1, 0, 13107), 131068),  # 20 * 32767 / 65535 V, railed
        (2.0**53, Calibration(1 << 31), 1 << 22),
        (2.0**-52, Calibration(1, 0, 2**52), 1),
    ],
)
def test_constant(value: float, calibration: Calibration, count: int) -> None:
    x = np.full(7, value)
    lattice = assert_exact(x, find_lattice(x))
    assert lattice.calibration == calibration
    assert lattice.counts[0] == count


@given(st.floats(2.0**-52, 2.0**53) | st.floats(-(2.0**53), -(2.0**-52)))
def test_every_constant_within_reach_is_exact(value: float) -> None:
    assert_exact(np.array([value]), find_lattice(np.array([value])))


@pytest.mark.parametrize(
    "x",
    [
        [1.0, inf],
        [nan],
        [0.0, -0.0],
        [1e300],
        [1e-320, 1.0],
        [2.0**-54],
        [2.0**53 + 2],
        [0.0, 1.0, 2.0**31 + 0.0, 2.0**32],  # 33 bits
        np.random.default_rng(0).normal(size=100).tolist(),
        (K * 2 * np.pi / 300000).tolist(),  # several roundings
    ],
)
def test_no_exact_lattice(x: list[float]) -> None:
    assert find_lattice(np.array(x)) is None


def test_counts_prefer_24_bits_then_fit_what_is_asked() -> None:
    x = np.array([2.0**30, 2.0**30 + 1, 2.0**30 + 2**23])
    lattice = assert_exact(x, find_lattice(x), bits=24)
    assert lattice.calibration.b == 1_080_000_000
    wide = np.array([0.0, 1.0, 2.0**24])
    assert assert_exact(wide, find_lattice(wide)).calibration.b == 0
    narrow = assert_exact(wide[:2], find_lattice(wide[:2], count_bits=2), bits=2)
    assert narrow.calibration == Calibration()
    assert find_lattice(np.arange(-2.0, 3.0), count_bits=2) is None
    assert find_lattice(wide, count_bits=24) is None
    with pytest.raises(ParameterError, match="2 to 32 bits"):
        find_lattice(wide, count_bits=33)


calibrations = st.one_of(
    st.builds(Calibration, st.integers(1, 999), st.integers(-(10**6), 10**6), st.just(1)),
    st.builds(
        Calibration,
        st.integers(1, 999),
        st.integers(-(10**6), 10**6),
        st.integers(0, 9).map(lambda k: 10**k),
    ),
    st.builds(
        Calibration,
        st.integers(1, 999),
        st.integers(-(10**6), 10**6),
        st.integers(0, 30).map(lambda k: 1 << k),
    ),
    st.builds(Calibration, st.integers(1, 999), st.integers(-(10**6), 10**6), st.integers(1, 9999)),
    st.builds(Calibration, st.integers(1, 2**20), st.just(0), st.integers(1, 2**30)),
)
count_lists = st.lists(st.integers(-(2**15), 2**15), min_size=1, max_size=60)


@given(calibrations, count_lists)
def test_a_lattice_is_found_again(calibration: Calibration, counts: list[int]) -> None:
    x = calibration.physical(np.array(counts))
    lattice = assert_exact(x, find_lattice(x))
    assert lattice.calibration.step >= calibration.step or len(set(counts)) == 1


def exists(counts: list[int], x: Doubles) -> bool:
    """Whether some A/D within the limits gives x = count * A / D, by all the exact bounds."""
    low, high, low_in, high_in = Fraction(0), Fraction(EXACT_LIMIT), True, True
    for count, value in zip(counts, np.abs(x).tolist(), strict=True):
        if count:
            below, above = np.nextafter(value, 0), np.nextafter(value, inf)
            closed = int(np.float64(value).view(np.int64)) % 2 == 0
            least = (Fraction(value) + Fraction(float(below))) / 2 / abs(count)
            most = (Fraction(value) + Fraction(float(above))) / 2 / abs(count)
            low, low_in = max((low, not low_in), (least, not closed))
            low_in = not low_in
            high, high_in = min((high, high_in), (most, closed))
    step = simplest_fraction(low, high, low_in, high_in)
    return (
        step is not None
        and step.numerator * max(map(abs, counts)) <= EXACT_LIMIT
        and step.denominator <= EXACT_LIMIT
    )


@given(count_lists, st.floats(1e-8, 1e3))
def test_products_are_found_where_a_lattice_exists(counts: list[int], step: float) -> None:
    """A tie in count * step can leave the step itself as the only one, with too many bits."""
    x = np.array(counts) * step
    lattice = find_lattice(x)
    if lattice is not None or exists(counts, x):
        assert_exact(x, lattice)


any_floats = st.lists(st.floats() | st.sampled_from(AWKWARD), max_size=30)
clustered = st.builds(
    lambda base, steps, scale: [base + k * scale for k in steps],
    st.floats(-1e9, 1e9),
    st.lists(st.integers(-50, 50), min_size=1, max_size=30),
    st.floats(1e-12, 1e6),
)


@given(any_floats | clustered)
def test_any_doubles_give_an_exact_lattice_or_none(values: list[float]) -> None:
    x = np.array(values, dtype=np.float64)
    lattice = find_lattice(x)
    if lattice is not None:
        assert_exact(x, lattice)


# --- within a tolerance


tolerances = st.builds(
    Tolerance,
    st.floats(1e-300, 1e300) | st.floats(1e-6, 10) | st.floats(1e-6, 0.5),
    st.sampled_from(["absolute", "lsb", "range"]),
)


@given(
    any_floats | clustered | st.lists(st.floats(-100, 100), min_size=1, max_size=40),
    tolerances,
    st.none() | st.floats() | st.floats(1e-6, 1),
)
@settings(max_examples=examples(300))
def test_the_tolerance_holds_for_any_doubles(
    values: list[float], tolerance: Tolerance, lsb: float | None
) -> None:
    x = np.array(values, dtype=np.float64)
    if np.isfinite(x).all():
        channel = Channel(x, Fraction(1000), lsb=lsb)
        changed, reason = to_counts(channel, tolerance)
        lattice = snap_to_lattice(x, tolerance, lsb=lsb)
        assert reason
        assert "\n" not in reason
        if lattice is None:
            assert changed is channel
        elif lattice.exact:
            assert_exact(x, lattice)
            assert changed.deviation is None
        else:
            assert changed.deviation is not None
            assert_within(x, lattice, changed.deviation.declared)
            assert changed.deviation.largest == lattice.largest_deviation
            if tolerance.kind == "absolute":
                assert changed.deviation.declared == min(tolerance.value, SINGLE_MAX)
    else:
        assert snap_to_lattice(x, tolerance, lsb=lsb) is None


NOISE = np.random.default_rng(5)
NATURAL = {
    "several roundings": (K * 2 * np.pi / 300000, 2 * np.pi / 300000, "1e-9lsb"),
    "ulps": (np.nextafter(np.nextafter(K * 0.001, 9), 9), 0.001, "1e-9lsb"),
    "six digits of text": (
        np.array([float(f"{k * 20 / 16384:.6g}") for k in K]),
        20 / 16384,
        "0.5lsb",
    ),
    "float32": ((K * 0.001).astype(np.float32).astype(np.float64), 0.001, "1e-3lsb"),
    "noise, several values a count": (
        np.repeat(K, 3) * 0.04 + NOISE.uniform(-1e-9, 1e-9, 3 * K.size),
        0.04,
        "1e-6lsb",
    ),
    "outliers and an offset": (
        np.append(K, [10**6, 10**6 + 777, -(10**6)]) * 0.0227 + 0.0091 + 1e-9 * np.sqrt(2),
        0.0227,
        "1e-5lsb",
    ),
}


@pytest.mark.parametrize("name", NATURAL)
def test_natural_step(name: str) -> None:
    x, step, text = NATURAL[name]
    lattice = snap_to_lattice(x, Tolerance.parse(text))
    assert lattice is not None
    assert not lattice.exact
    assert float(lattice.calibration.step) == pytest.approx(step, rel=1e-5)
    assert_within(x, lattice, Tolerance.parse(text).value * step * (1 + 1e-5))


def test_six_digits_of_text_are_decimals_unless_a_tolerance_admits_the_sensor() -> None:
    x = NATURAL["six digits of text"][0]
    assert assert_exact(x, find_lattice(x)).calibration == Calibration(1, 0, 10**8)
    near = snap_to_lattice(x, Tolerance(1e-5))
    assert near is not None
    assert near.calibration == Calibration(5, 0, 4096)
    close = snap_to_lattice(x, Tolerance(1e-9))
    assert close is not None
    assert close.exact
    changed, reason = to_counts(Channel(x, Fraction(1000)))
    assert changed.deviation is None
    assert "a tolerance of 5e-06" in reason or "a tolerance of 6e-06" in reason


def test_levels_that_a_signal_jitters_about_are_no_lattice() -> None:
    x = np.round(np.repeat(np.arange(12), 20) + NOISE.uniform(-0.05, 0.05, 240), 4)
    lattice = snap_to_lattice(x, Tolerance.parse("0.5lsb"))
    assert lattice is not None
    assert lattice.exact


@pytest.mark.parametrize(
    ("text", "step"),
    [
        ("0.5", Fraction(1)),
        ("0.49", Fraction(1, 2)),
        ("1e-3", Fraction(1, 500)),
        ("0.0024999", Fraction(1, 500)),
        ("300", Fraction(500)),
    ],
)
def test_plain_grid_is_the_coarsest_of_1_2_5(text: str, step: Fraction) -> None:
    x = NOISE.normal(size=2000) * 1000
    lattice = snap_to_lattice(x, Tolerance.parse(text))
    assert lattice is not None
    assert lattice.calibration.step == step
    assert_within(x, lattice, float(text))


def test_plain_grid_takes_a_finer_step_where_rounding_is_in_the_way() -> None:
    x = 1e6 / 3 + np.array([0.0, 1e-10, 1.0, np.pi, 7.123456789, 11.13, 12.7])
    allowed = 1.00001 * float(np.spacing(1e6 / 3))
    lattice = snap_to_lattice(x, Tolerance(allowed))
    assert lattice is None or lattice.largest_deviation <= allowed


def test_declared_step_without_a_lattice() -> None:
    x = NOISE.normal(size=500)
    lattice = snap_to_lattice(x, Tolerance(0.5, "lsb"), lsb=20 / 65535)
    assert lattice is not None
    assert lattice.calibration == Calibration(4, 0, 13107)
    assert snap_to_lattice(x, Tolerance(0.5, "lsb")) is None
    assert snap_to_lattice(x * 0 + 1e-300, Tolerance(0.01, "range")) is None


def test_negative_zero_needs_a_tolerance() -> None:
    channel = Channel(np.array([-0.0, 0.1, 0.2, 0.0]), Fraction(100))
    unchanged, reason = to_counts(channel)
    assert unchanged is channel
    assert "negative zero" in reason
    changed, reason = to_counts(channel, Tolerance(1e-9))
    assert changed.stored.tolist() == [0, 1, 2, 0]
    assert changed.deviation == Deviation(1e-9, 0.0)
    assert "-0.0 became 0" in reason


# --- channels


def test_to_counts() -> None:
    channel = Channel(K / 1000, Fraction(1000), label="current", unit="A")
    changed, reason = to_counts(channel, Tolerance(0.1))
    assert changed.stored.dtype == np.int32
    assert changed.calibration == Calibration(1, 0, 1000)
    assert changed.deviation is None
    assert changed.label == "current"
    assert same_bits(changed.samples(), channel.stored)
    assert "0.001" in reason
    again, reason = to_counts(changed, Tolerance(0.1))
    assert again is changed
    assert reason == "already in counts"


def test_empty_channel_becomes_counts() -> None:
    changed, _ = to_counts(Channel(np.empty(0), Fraction(1)))
    assert changed.is_counts
    changed, _ = to_counts(Channel(np.empty(0), Fraction(1)), Tolerance(1.0))
    assert changed.is_counts


@pytest.mark.parametrize(
    ("values", "word"),
    [
        (np.array([1.0, inf]), "infinities"),
        (np.array([1e300]), "larger unit"),
        (np.array([1, 2**53 + 1]), "float64"),
        (np.array([2**64 - 1], dtype=np.uint64), "float64"),
        (NOISE.normal(size=50), "no common step"),
    ],
)
def test_channels_that_stay(values: NDArray[np.generic], word: str) -> None:
    channel = Channel(values, Fraction(1))
    unchanged, reason = to_counts(channel)
    assert unchanged is channel
    assert word in reason


@pytest.mark.parametrize("dtype", ["int64", "uint64", "float32", "float16", "uint8"])
def test_other_dtypes(dtype: str) -> None:
    channel = Channel(np.arange(0, 50, 2).astype(dtype), Fraction(1))
    changed, _ = to_counts(channel)
    assert changed.calibration == Calibration(2)
    assert np.array_equal(changed.samples(), channel.samples())


def test_the_reason_names_the_tolerance_that_helps() -> None:
    channel = Channel(K * 2 * np.pi / 300000, Fraction(2000))
    _, reason = to_counts(channel)
    text = reason.split("a tolerance of ")[1].split()[0]
    changed, _ = to_counts(channel, Tolerance.parse(text))
    assert changed.is_counts


# --- the simplest fraction


@given(
    st.fractions(0, 10, max_denominator=99),
    st.fractions(0, 10, max_denominator=99),
    st.booleans(),
    st.booleans(),
)
def test_simplest_fraction(a: Fraction, b: Fraction, low_in: bool, high_in: bool) -> None:
    low, high = sorted((a, b))

    def inside(value: Fraction) -> bool:
        return (low < value or (low_in and low == value)) and (
            value < high or (high_in and high == value)
        )

    found = simplest_fraction(low, high, low_in, high_in)
    if found is None:
        assert low == high
        assert not (low_in and high_in)
        return
    assert inside(found)
    for d in range(1, found.denominator):
        first = low.numerator * d // low.denominator
        assert not any(inside(Fraction(n, d)) for n in range(first, first + 3))


# --- cost


@pytest.mark.parametrize(
    "x",
    [
        np.arange(10**6) / 1000 + 5,
        np.arange(10**6) * 20 / 65535,
        np.arange(10**6) * 0.001,
        np.random.default_rng(2).normal(size=10**6),
    ],
    ids=["decimals", "fractions", "products", "doubles"],
)
def test_a_million_distinct_values(x: Doubles) -> None:
    start = time.process_time()
    find_lattice(x)
    assert time.process_time() - start < 5 * slowness()  # measured 0.1 to 0.4 s


# --- recordings


def channels(pattern: str) -> dict[str, Doubles]:
    files = sorted(DATA.glob(pattern))
    if not files:
        pytest.skip(f"the recordings {pattern} are not there")
    with np.load(files[0]) as data:
        names = data["channel_names"].tolist()
        return {name: np.array(x) for name, x in zip(names, data["x"], strict=True)}


@pytest.mark.parametrize(
    "pattern",
    [
        "smartwheel/smartwheel.npz",
        "smartwheel/sample_sw_csvtxt.npz",
        "fabricslide/Denim*.npz",
        "unlicensed/biotac_slide/mat1_*.npz",
    ],
)
def test_recordings_of_integers_and_decimals(pattern: str) -> None:
    for x in channels(pattern).values():
        lattice = assert_exact(x, find_lattice(x))
        assert lattice.calibration in (Calibration(), Calibration(1, 0, 100))


def test_davinci_grip() -> None:
    found = {name: find_lattice(x) for name, x in channels("davinci_grip/*2_00.npz").items()}
    steps = {name: lattice and lattice.calibration.step for name, lattice in found.items()}
    assert steps == {
        "enc_backend_CUI": 1,
        "torque_backend": 2,
        "current": Fraction(1, 1000),
        "enc_frontend_Maxon": 1,
        "torque_frontend": 2,
        "cmd_frontend": Fraction(1, 10),
        "cmd_backend": None,  # holds negative zeros
        "enc_backend_Maxon": 1,
        "target": Fraction(1, 100),
    }


def test_teleop() -> None:
    found = channels("teleop1dof/*rigid.npz")
    for name in ("adc_m_chb", "adc_s_cha", "adc_s_chb"):
        lattice = assert_exact(found[name], find_lattice(found[name]))
        assert lattice.calibration.d == 13107
    for name in ("pos_master", "pos_slave"):
        x = found[name]
        assert find_lattice(x) is None
        lattice_or_none = snap_to_lattice(x, Tolerance.parse("1e-9lsb"))
        assert lattice_or_none is not None
        assert float(lattice_or_none.calibration.step) == pytest.approx(
            2 * np.pi / 300000, rel=1e-11
        )
        assert lattice_or_none.largest_deviation < 1e-15
    for name in ("tau_human", "vel_m_filt"):
        assert find_lattice(found[name]) is None
        assert snap_to_lattice(found[name], Tolerance(0.5, "lsb")) is None


def test_dropbear() -> None:
    for x in channels("dropbear/set0_test0.npz").values():
        assert assert_exact(x, find_lattice(x)).calibration.d in (10**8, 10**5)
        near = snap_to_lattice(x, Tolerance.parse("0.01lsb"))
        assert near is not None
        assert near.calibration == Calibration(5, 0, 4096)
        assert np.abs(near.counts).max() < 1 << 13


def test_shock() -> None:
    for x in channels("shock51k/Test_001.npz").values():
        assert find_lattice(x) is None
        near = snap_to_lattice(x, Tolerance(1e-6))
        assert near is not None
        assert 0.022 < near.calibration.step < 0.024


def test_sparse_counts_may_span_all_32_bits() -> None:
    ends = np.array([-(2**31), 0, 2**31 - 1], np.int32)
    assert sparse(ends)
    assert sparse(ends.astype(np.int64))
    assert not sparse(np.arange(9))
    assert not sparse(np.zeros(0, np.int32))


def test_panda() -> None:
    for name, x in channels("panda_comanip/symbol17_1.npz").items():
        assert find_lattice(x) is None
        natural = snap_to_lattice(x, Tolerance(0.5, "lsb"))
        assert (natural is not None) == (name == "fz")  # six decimals and a rounding


# --- channels of which a thousand values are searched


N = 20_000


def rarely(x: Doubles, value: float) -> Doubles:
    """x with that value at one place that no sample of the search lies at."""
    x = x.copy()
    x[12_345] = value
    return x


def test_one_sample_off_the_grid_joins_the_search() -> None:
    x = np.round(np.random.default_rng(3).normal(size=N), 2) + 0.0
    assert assert_exact(x, find_lattice(x)).calibration.d == 100
    finer = rarely(x, 0.125)
    assert assert_exact(finer, find_lattice(finer)).calibration.d == 200
    assert find_lattice(rarely(x, 0.1 + 2**-55)) is None
    coarse = 2 * np.round(x * 100) + 0.0
    assert assert_exact(coarse, find_lattice(coarse)).calibration.step == 2
    odd = rarely(coarse, 3.0)
    assert assert_exact(odd, find_lattice(odd)).calibration.step == 1


def test_the_tolerance_holds_for_samples_that_are_not_searched() -> None:
    x = np.round(np.random.default_rng(4).normal(size=N), 3) + 0.0
    moved = rarely(x, 0.5004)
    near = snap_to_lattice(moved, Tolerance(1e-5))
    assert near is not None
    assert_within(moved, near, 1e-5)
    on_uniform, _ = to_counts(Channel(moved, 1000), Tolerance(0.01))
    assert on_uniform.calibration is not None
    away = np.abs(on_uniform.calibration.physical(on_uniform.stored) - moved)
    assert away.max() <= 0.01


def test_values_that_leave_the_grid_more_often_than_they_are_looked_at() -> None:
    rng = np.random.default_rng(5)
    x = np.arange(N) / 8
    some = rng.choice(N, 200, replace=False)
    x[some] += rng.integers(1, 1 << 20, 200) / (1 << 20)
    assert_exact(x, find_lattice(x))
