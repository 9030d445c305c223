"""NOIS: the compiled loop is its readable twin, bit for bit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st
from twins import built, changed, clamped, same

from hapfmt.codecs import noise as codec
from hapfmt.codecs.noise import NoiseParameters, decode_within, encode_component
from hapfmt.codecs.predicted import TABLE
from hapfmt.kernels import compiled

decoded = partial(same, codec, clamped, decode_within)
ranges = st.sampled_from([(-(2**31), 2**31 - 1), (0, 0), (-5, 100), (3, 9), (-9, -3)])
cases = strategies.noise_parameters().flatmap(strategies.noise_models)


@built
class TestTwins:
    @given(cases, ranges)
    def test_decode(self, case, limits):
        arguments, given, span = case
        decoded(encode_component(*arguments, **given), arguments[2], span, 1, 7, *limits)

    @given(cases, ranges, st.data())
    def test_mutated(self, case, limits, data):
        """Counts, or class, rule, offset and words of the error."""
        arguments, given, span = case
        packet = bytearray(encode_component(*arguments, **given))
        for _ in range(data.draw(st.integers(0, 3))):
            at = data.draw(st.integers(0, len(packet)))
            packet[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
        span = data.draw(st.sampled_from([span, 1, 300]))
        decoded(bytes(packet), arguments[2], span, 1, 7, *limits)

    @given(st.binary(max_size=40), strategies.noise_parameters(), st.integers(1, 400), ranges)
    def test_any_bytes(self, data, parameters, span, limits):
        decoded(data, parameters, span, 1, 0, *limits)

    @pytest.mark.parametrize("order", [0, 1, 2, 3, 9, 16, 17, 24, 25, 32])
    def test_widths_of_the_filter(self, order):
        """Loud, quiet, and so near to an oscillator that the state is clamped."""
        parameters = NoiseParameters(3, 8)
        rng = np.random.default_rng(order)
        for width in (20, 127):
            blocks = rng.integers(-width, width + 1, (5, order)).tolist()
            for most in (30, 112):
                gains = rng.integers(most - 20, most + 1, 40).tolist()
                data = encode_component(gains, blocks, parameters, seed=order)
                decoded(data, parameters, 315, 1, 0, -(2**31), 2**31 - 1)

    def test_the_last_tick_of_the_longest_intervals(self):
        parameters = NoiseParameters(12, 1)
        for span in (4095, 4096, 4097):
            gains = [0, 112][: -(-span // 4096)] if span > 4096 else [112]
            data = encode_component(gains, [[9, -9]] * len(gains), parameters, seed=1)
            decoded(data, parameters, span, 1, 0, -(2**31), 2**31 - 1)


DECODE = {
    "coded": b"\0\1\0\0", "order": 0, "density": 0, "seed": 1, "gain": 40, "gain_class": 0,
    "gain_start": 0, "coefficient_class": 0, "coefficient_start": 0, "states": 1, "shift": 3,
    "intervals": 8, "low": -9, "high": 9, "sines": TABLE, "counts": np.zeros(8, np.int32),
}  # fmt: skip
WRONG = [
    {"order": 33}, {"order": -1}, {"density": 256}, {"density": -1}, {"gain": 113}, {"gain": -1},
    {"gain_class": 16}, {"gain_class": -1}, {"gain_start": 164}, {"coefficient_class": 16},
    {"coefficient_start": 164}, {"coefficient_start": -1}, {"states": 2}, {"shift": 2},
    {"shift": 13}, {"intervals": 0}, {"intervals": 256}, {"intervals": 7}, {"low": 10},
    {"low": -(2**31) - 1}, {"high": 2**31}, {"sines": TABLE[:127]},
    {"sines": np.full(128, 32768, np.int32)}, {"sines": np.full(128, -1, np.int32)},
    {"counts": np.zeros(0, np.int32)}, {"counts": bytearray(7)},
    {"counts": memoryview(bytearray(25))[1:]},
]  # fmt: skip


@built
@pytest.mark.parametrize("wrong", WRONG, ids=changed)
def test_arguments_that_would_overflow(wrong):
    assert compiled.noise_decode(*DECODE.values()) == (0, 4)
    with pytest.raises(ValueError, match="not a model of noise"):
        compiled.noise_decode(*(DECODE | wrong).values())
