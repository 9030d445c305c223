"""Single samples far beyond all others: they are coded, and nothing else changes with them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapfmt import Calibration, Channel, Settings
from hapfmt.encoder import plan
from hapfmt.encoder.encode import encode
from hapfmt.encoder.felt import FeltChannel
from hapfmt.encoder.lattice import Tolerance, snap_to_lattice
from hapfmt.encoder.plan import LEAST, Promise, find_glitches, median3, without_glitches
from hapfmt.encoder.settings import TextureQuality
from hapfmt.encoder.source import InputBlock
from hapfmt.recording import Recording

HUM = np.round(1000 * np.sin(np.arange(3000) / 40)).astype(np.int16)


def with_glitches(*places, size=30_000, x=HUM):
    out = x.copy()
    out[list(places)] = size
    return out


def floor_of(values, **given):
    channel = Channel(values, Fraction(1000), calibration=Calibration(1, 0, 1000), unit="N")
    made = encode(
        Recording((channel,)),
        Settings.of("near-lossless", max_error="0.2%", smallest=False, **given),
    )
    return made.tracks[-1].contract.floor


@given(st.lists(st.integers(-5, 5), min_size=3, max_size=40))
def test_median(values):
    expected = [sorted(values[i : i + 3])[1] for i in range(len(values) - 2)]
    assert median3(np.array(values)).tolist() == expected


@given(
    st.lists(st.sampled_from([-(2**31), -7, 0, 1, 2, 2**31 - 1]), max_size=200),
    st.sampled_from([5, 64, 1 << 18]),
)
def test_as_the_page_says(values, block):
    x = np.array(values, np.int32)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "BLOCK", block)
        found = find_glitches(x).tolist()
    medians = [sorted(values[i : i + 3])[1] for i in range(len(values) - 2)]
    low, high = min(medians, default=0), max(medians, default=0)
    beyond = [i for i, v in enumerate(values) if v > 2 * high - low or v < 2 * low - high]
    few = len(values) >= LEAST and len(beyond) <= max(len(values) // 1000, 1)
    assert found == (beyond if few else [])


def test_only_they_change():
    x = with_glitches(0, 1700, 2999, size=-30_000)
    calm = without_glitches(x)
    changed = np.flatnonzero(calm != x).tolist()
    assert changed == [0, 1700, 2999]
    assert np.abs(calm).max() <= 1000
    assert x[0] == -30_000
    assert without_glitches(HUM) is HUM


def test_what_is_not_rare_is_the_signal():
    for x in (
        with_glitches(*range(10, 3000, 400)),
        with_glitches(10, 11),  # two together are no glitch
        np.tile(np.array([30_000, -30_000], np.int16), 500),
        with_glitches(5)[: LEAST - 1],
        np.array([0, 1e308, -1e308] * 100),
        np.zeros(0),
    ):
        assert not find_glitches(x).size


def test_the_floor_is_of_the_rest():
    assert floor_of(HUM) == floor_of(with_glitches(500)) == (4,)
    assert floor_of(with_glitches(500, 501, 502))[0] > 50


def test_a_tolerance_in_percent_is_of_the_rest():
    x = np.random.default_rng(1).normal(size=4000)
    hit = x.copy()
    hit[77] = 1e6
    calm, found = (snap_to_lattice(y, Tolerance.parse("0.1%")) for y in (x, hit))
    assert calm.calibration.step == found.calibration.step


def test_the_slow_part_is_not_drawn_by_them():
    x = with_glitches(1500)
    channel = Channel(x, Fraction(1000), calibration=Calibration(1, 0, 1000), unit="N")
    source = InputBlock((channel,), x[:, None], channel.coverage)
    promise = Promise(Tolerance(0.002, "range"), Fraction(1, 10), TextureQuality(20.0))
    felt = FeltChannel.of(channel.samples(), source, promise, 20.0)
    assert np.abs(1000 * felt.slow - HUM).max() < 150


@given(st.integers(0, 2**32), st.sampled_from([64, 65, 1000, 70_001]), st.integers(0, 3))
def test_some_medians_tell_as_much_as_all(seed, size, count):
    rng = np.random.default_rng(seed)
    x = np.rint(rng.normal(size=size) * np.where(np.arange(size) % 8, 1000, rng.choice([1, 9000])))
    x[rng.integers(0, size, count)] *= rng.choice([1, 3, 100])
    calm = np.median(np.stack([x[:-2], x[1:-1], x[2:]]), axis=0)
    low, high = calm.min(), calm.max()
    far = np.flatnonzero((x < 2 * low - high) | (x > 2 * high - low))
    assert find_glitches(x).tolist() == (far.tolist() if far.size <= max(size // 1000, 1) else [])
