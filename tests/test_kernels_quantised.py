"""QUAN: the compiled loops are their readable twins, bit for bit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st
from twins import built, changed, clamped, packed, same

from hapfmt.codecs import quantised as codec
from hapfmt.codecs.quantised import Alphabet, QuanParameters, decode_within, encode_quantised
from hapfmt.encoder.unit import choose_codebook
from hapfmt.kernels import compiled
from hapfmt.limits import LEVELS

decoded = partial(same, codec, clamped, decode_within)
encoded = partial(same, codec, packed, encode_quantised)
ranges = st.sampled_from([(-(2**31), 2**31 - 1), (0, 0), (-5, 100), (3, 9), (-9, -3)])
steps = st.sampled_from([1, 2, 31, 2**24, 2**31])


@st.composite
def cases(draw):
    """Levels [ticks, components] and a codebook for them."""
    alphabet = draw(strategies.alphabets)
    array = draw(strategies.level_arrays(alphabet))
    book = draw(strategies.books_for(alphabet, array))
    return array, QuanParameters(draw(steps), book.alphabet, book.lengths)


@built
class TestTwins:
    @given(cases(), ranges)
    def test_encode_and_decode(self, case, limits):
        array, parameters = case
        data = encoded(array, parameters)
        decoded(data, parameters, *array.shape, LEVELS[2], 7, *limits)

    @given(cases(), ranges, st.sampled_from([1, 2]), st.data())
    def test_mutated(self, case, limits, number, data):
        """Counts, or class, rule, offset and words of the error."""
        array, parameters = case
        packet = bytearray(encode_quantised(array, parameters))
        for _ in range(data.draw(st.integers(0, 3))):
            at = data.draw(st.integers(0, len(packet)))
            packet[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
        span = data.draw(st.sampled_from([array.shape[0], 1, 300]))
        parameters = QuanParameters(
            min(parameters.step, LEVELS[number].step), *list(vars(parameters).values())[1:3]
        )
        decoded(bytes(packet), parameters, span, array.shape[1], LEVELS[number], 7, *limits)

    @given(st.binary(max_size=30), strategies.quan_parameters(), st.integers(1, 400), ranges)
    def test_any_bytes(self, data, parameters, span, limits):
        decoded(data, parameters, span, 1, LEVELS[2], 0, *limits)

    @given(strategies.quan_parameters(), st.data())
    def test_any_levels(self, parameters, data):
        """With a code word or without, to the largest that 32 bits and a sign make."""
        size = data.draw(st.integers(1, 40))
        level = st.integers(-3, 3) | st.sampled_from([2**31, -(2**32), 2**33, -(2**33) - 1, 2**40])
        rows = data.draw(st.lists(level, min_size=size, max_size=size))
        encoded(np.array(rows, np.int64)[:, None], parameters)

    @pytest.mark.parametrize("spread", [0.3, 3, 40, 1000, 1e8])
    @pytest.mark.parametrize("components", [1, 3])
    def test_long_packets(self, spread, components):
        """Code words of all lengths, long runs, escapes; larger than their first buffer."""
        rng = np.random.default_rng(components)
        levels = np.rint(rng.standard_t(2, (9000, components)) * spread).astype(np.int64)
        levels = np.clip(levels, -(2**31), 2**31)
        levels[2000:7000] = 0
        parameters = choose_codebook([levels], 1)
        data = encoded(levels, parameters)
        limits = -(2**31), 2**31 - 1
        fast = decoded(data, parameters, 9000, components, LEVELS[2], 0, *limits)
        assert fast[1] == np.clip(levels, *limits).astype(np.int32).tobytes()

    def test_a_run_that_is_cut_short(self):
        parameters = QuanParameters(1, Alphabet(0, 24, 0), np.array([0] * 24 + [1]))
        for data in (b"\xff" * 3, b"\0\0\0", b"\0\0\1", b"", b"\0\0\0\0"):
            for span in (1, 2**24 - 1):
                decoded(data, parameters, span, 1, LEVELS[2], 0, -9, 9)


BOOK = np.array([1, 2, 2], np.uint8)
DECODE = {
    "packet": b"\x80", "lengths": BOOK, "direct_levels": 1, "run_classes": 0, "escape_classes": 0,
    "step": 1, "bound": 9, "low": -9, "high": 9, "counts": np.zeros(6, np.int32),
}  # fmt: skip
WRONG_BOOKS = [
    {"lengths": BOOK[:2]}, {"lengths": np.array([1, 2, 3], np.uint8)}, {"direct_levels": 2},
    {"lengths": np.array([1, 1, 1], np.uint8)}, {"lengths": np.array([16, 2, 2], np.uint8)},
    {"lengths": np.zeros(3, np.uint8)}, {"lengths": np.array([2, 0, 0], np.uint8)},
    {"direct_levels": -1, "run_classes": 4}, {"run_classes": -1}, {"escape_classes": -1},
    {"direct_levels": 2**31 - 1}, {"direct_levels": 0, "run_classes": 25, "lengths": bytes(26)},
    {"direct_levels": 0, "escape_classes": 33, "lengths": bytes(34)},
    {"lengths": bytes(4097), "direct_levels": 2048},
]  # fmt: skip


@built
class TestArguments:
    @pytest.mark.parametrize("wrong", WRONG_BOOKS, ids=str)
    def test_no_codebook(self, wrong):
        with pytest.raises(ValueError, match="not a codebook"):
            compiled.quan_decode(*(DECODE | wrong).values())
        given = [np.zeros(3, np.int64), *list((DECODE | wrong).values())[1:5], bytearray(9)]
        with pytest.raises(ValueError, match="not a codebook"):
            compiled.quan_encode(*given)

    @pytest.mark.parametrize(
        "wrong",
        [
            {"step": 0}, {"step": 2**33 + 1, "bound": 0}, {"bound": 2**33 + 1}, {"bound": -1},
            {"step": 2, "bound": 2**32 + 1}, {"low": 10}, {"low": -(2**31) - 1}, {"high": 2**31},
            {"counts": memoryview(bytearray(25))[1:]}, {"counts": bytearray(7)},
        ],
        ids=changed,
    )  # fmt: skip
    def test_limits_that_would_overflow(self, wrong):
        assert compiled.quan_decode(*DECODE.values()) is True
        with pytest.raises(ValueError, match="not a codebook"):
            compiled.quan_decode(*(DECODE | wrong).values())

    def test_no_levels(self):
        assert compiled.quan_encode(b"", BOOK, 1, 0, 0, bytearray(3)) == 0
        with pytest.raises(ValueError, match="64 bits"):
            compiled.quan_encode(bytes(7), BOOK, 1, 0, 0, bytearray(3))
        assert compiled.quan_encode(np.array([2]), BOOK, 1, 0, 0, bytearray(3)) == -1
        assert compiled.quan_encode(np.array([-(2**63)]), BOOK, 1, 0, 0, bytearray(3)) == -1
