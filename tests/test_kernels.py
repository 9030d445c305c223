"""The compiled loops are their readable twins, bit for bit, and refuse what they were not made for."""

from __future__ import annotations

import fnmatch
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import page
import pytest
import strategies
from depth import PURE, either, runs_pure
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT
from twins import built, changed

import hapfmt
from hapfmt.codecs import predicted
from hapfmt.codecs.predicted import INDEX_LIMIT, Predictor, decode_indices, encode_indices
from hapfmt.encoder import lengths, predict
from hapfmt.encoder.effort import EFFORTS
from hapfmt.errors import FormatError
from hapfmt.format import deflate as deflating
from hapfmt.format.deflate import deflate
from hapfmt.kernels import compiled

rows = strategies.index_arrays() | strategies.quiet_rows().map(np.array)
cases = st.tuples(rows, strategies.predictors())


def decoded(data, span, limit):
    """Indices, or all that an error tells."""
    try:
        return decode_indices(data, span, limit, 1000).tolist()
    except FormatError as error:
        return error.requirement, error.offset, error.message


def encoded(indices, predictor):
    try:
        return encode_indices(indices, predictor)
    except ValueError as error:
        return str(error)


def both(call, *arguments):
    """(what the extension does, what the readable loop does)"""
    fast = call(*arguments)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(predicted, "compiled", None)
        patch.setattr(predict, "compiled", None)
        patch.setattr(predict, "compiled", None)
        return fast, call(*arguments)


def assert_same(call, *arguments):
    fast, slow = both(call, *arguments)
    assert fast == slow
    return fast


@built
class TestTwins:
    @given(cases)
    def test_encode_and_decode(self, case):
        indices, predictor = case
        data = assert_same(encoded, indices, predictor)
        if isinstance(data, bytes):
            assert assert_same(decoded, data, indices.size, INDEX_LIMIT) == indices.tolist()

    @given(cases, st.sampled_from([0, 1, 2**24, 2**32]), st.data())
    def test_mutated(self, case, limit, data):
        """Indices, or rule, offset and words of the error."""
        indices, predictor = case
        whole = encoded(indices, predictor)
        packet = bytearray(whole if isinstance(whole, bytes) else b"\0\0\0")
        for _ in range(data.draw(st.integers(1, 3))):
            at = data.draw(st.integers(0, len(packet)))
            packet[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
        span = data.draw(st.sampled_from([indices.size, 1, 300]))
        assert_same(decoded, bytes(packet), span, limit)

    @given(
        st.sampled_from(
            [
                b"\0\0\0",
                b"\0\0\0\0\x0c",
                b"\0\0\0\x1f\x80",
                b"\4\0\0\x33\0\1\xff\x80",
                b"\x08\0\1\5\x40\x80\x80\x80\x80",
                b"\x08\0\1\x35\x40\1\xff\x80\x10\xff\1\x80",
                b"\1\2\x60\xa0\0\7\x20",
                b"\0\3\x7f\x81\x7f\0\x10\xa3",
            ]
        ),
        st.binary(max_size=60),
        st.integers(1, 200),
        st.sampled_from([0, 5, 2**32]),
    )
    def test_any_coded_bytes(self, header, coded, span, limit):
        assert_same(decoded, header + coded, span, limit)

    @given(
        st.sampled_from([0, 64, 127]), st.sampled_from([0, 1, 2, 4]), st.integers(38, 46), st.data()
    )
    def test_what_is_too_large_for_64_bits(self, k, g, bits, data):
        """Magnitudes beyond every bound, behind numbers that bring the model to its widest scale."""
        far = data.draw(st.sampled_from([2**32, 2**32 - 1, 2**31]))
        ks = [k] * (k > 0)
        g = min(g, 1) if ks else g
        row = [far, -far] * data.draw(st.sampled_from([0, 20]))
        row.append(2**bits + data.draw(st.integers(-(2**36), 2**36)))
        packet = page.encode(row, g, ks, forge=row, start=data.draw(st.integers(0, 163)))
        assert isinstance(assert_same(decoded, packet, len(row), INDEX_LIMIT), tuple)

    @pytest.mark.parametrize("size", [1023, 1024, 1025, 1057, 9000])
    def test_long_packets_of_the_highest_order(self, size):
        """The history of the compiled loop is moved every 1024 samples."""
        x = np.random.default_rng(size).integers(-300, 300, size).cumsum()
        predictor = Predictor(1, tuple(range(-16, 16)), 5)
        data = assert_same(encoded, x, predictor)
        assert assert_same(decoded, data, size, INDEX_LIMIT) == x.tolist()

    def test_a_packet_larger_than_its_first_buffer(self):
        x = np.random.default_rng(1).integers(-INDEX_LIMIT, INDEX_LIMIT, 500)
        data = assert_same(encoded, x, Predictor())
        assert len(data) > 2 * x.size + 64

    def test_messages_are_those_of_the_twin(self):
        source = "".join(
            (ROOT / "hapfmt" / "codecs" / name).read_text(encoding="utf-8")
            for name in ("entropy.py", "predicted.py")
        )
        for requirement, message in predicted.STATUS.values():
            assert source.count(f'"{message}"') == 2
            assert source.count(f'"{requirement}"') >= 2


@built
class TestSearch:
    """What the encoder asks before it writes a packet: the same numbers, so the same bytes."""

    @given(rows, st.sampled_from(sorted(EFFORTS)))
    def test_packets(self, indices, effort):
        data = assert_same(predict.encode_best, indices, EFFORTS[effort])
        assert decoded(data, indices.size, INDEX_LIMIT) == indices.tolist()
        assert_same(predict.quick_estimate, indices)

    @given(
        strategies.index_arrays(), st.sampled_from([0, 1]), st.sampled_from([0, 5, -INDEX_LIMIT])
    )
    def test_recursions(self, indices, order, base):
        sums = assert_same(predict.autocorrelations, indices, order, base)
        assert sums[0] == max(sums)
        orders = min(32, indices.size - 1)
        reflections, energies = assert_same(predict.levinson, sums, indices.size, orders)
        assert len(reflections) == len(energies) <= 32
        assert all(-127 <= k <= 127 for k in reflections)

    @pytest.mark.parametrize("effort", sorted(EFFORTS))
    @pytest.mark.parametrize("width", [3, 10**6])
    def test_long_packets(self, effort, width):
        """Loud and quiet parts, repeats, a sine that is nearly singular, and errors too large."""
        x = np.random.default_rng(width).integers(-width, width, 3000).cumsum()
        far = np.arange(3000) // 64 % 3 == 1
        for row in (
            np.where(np.arange(x.size) < 1500, x, x[1500] + x // width),
            np.repeat(x, 3)[: x.size],
            np.rint(1e3 * width * np.sin(np.arange(x.size) * 1e-3)).astype(np.int64),
            np.where(far & (x % 7 == 0), np.sign(x) * INDEX_LIMIT, x % 5),
        ):
            data = assert_same(predict.encode_best, row, EFFORTS[effort])
            assert decode_indices(data, row.size, INDEX_LIMIT, 0).tolist() == row.tolist()

    @given(st.integers(0, 9), st.sampled_from([1, 300, 10**7]))
    def test_cuts(self, seed, width):
        rng = np.random.default_rng(seed)
        x = rng.integers(-width, width + 1, 20_000 + seed)
        x[: 9000 + seed] = x[: 9000 + seed].cumsum()
        assert_same(predict.best_cuts, x % 2**30)

    @given(st.lists(st.integers(-(2**40), 2**40), min_size=1, max_size=300))
    def test_bits_of_pieces(self, numbers):
        looked = np.array([numbers, numbers[::-1]], np.float64)
        with pytest.MonkeyPatch.context() as patch:
            fast = lengths.bits_of(looked)
            patch.setattr(lengths, "compiled", None)
            assert lengths.bits_of(looked) == fast

    @given(st.lists(st.integers(-127, 127), max_size=32).map(tuple))
    def test_step_up(self, ks):
        assert_same(lambda: Predictor(reflections=ks).coefficients)

    def test_wrong_arguments(self):
        def given(count, dtype=np.int64):
            return np.zeros(count, dtype)

        for reflections, sines, out in (
            (33 * b"\1", given(128, np.int32), given(33, np.int32)),
            (b"\x80", given(128, np.int32), given(1, np.int32)),
            (b"\1", given(127, np.int32), given(1, np.int32)),
            (b"\1", given(128, np.int32) - 1, given(1, np.int32)),
            (b"\1", given(128, np.int32), given(2, np.int32)),
        ):
            with pytest.raises(ValueError, match="not reflection"):
                compiled.step_up(reflections, sines, out)
        for indices, order, base, sums in (
            (given(3), 5, 0, given(33)),
            (given(3), 0, 2**33, given(33)),
            (given(3), 0, 0, given(32)),
            (given(3) + 2**33, 0, 0, given(33)),
            (np.full(3, -(2**63)), 0, 0, given(33)),
        ):
            with pytest.raises(ValueError, match="not indices"):
                compiled.autocorrelate(indices, order, base, sums)
        with pytest.raises(ValueError, match="order 32"):
            compiled.levinson(given(33), 33, given(127), given(32, np.int8), given(32))
        for change in (
            {0: given(0)}, {0: given(3) + 2**33}, {0: bytes(7)}, {1: given(127, np.int32)},
            {1: given(128, np.int32) - 1}, {2: given(126, np.float64)}, {3: 33}, {3: -1},
            {4: 0}, {5: 16}, {7: 0},
        ):  # fmt: skip
            row = [given(3), given(128, np.int32), given(127, np.float64), 32, 3, 7, False, 1]
            for at, value in change.items():
                row[at] = value
            with pytest.raises(ValueError, match="not indices"):
                compiled.encode_packet(*row)
        for numbers, pieces in ((given(0), 1), (given(3), 0), (given(3), 2), (bytes(9), 1)):
            with pytest.raises(ValueError, match="not pieces"):
                compiled.piece_bits(numbers, pieces)
        with pytest.raises(ValueError, match="not indices"):
            compiled.find_cuts(given(3), given(128, np.int32), given(127, np.float64), given(15))
        for indices in (given(0), given(3) + 2**33):
            with pytest.raises(ValueError, match="not indices"):
                compiled.polynomial_bits(indices)


@built
@given(st.binary(max_size=400), st.integers(0, 400), st.sampled_from([1, 3, 60]))
def test_deflate(data, gap, times):
    plain = (data + bytes(gap)) * times
    with pytest.MonkeyPatch.context() as patch:
        fast = deflate(plain)
        patch.setattr(deflating, "compiled", None)
        assert deflate(plain) == fast


ARGUMENTS = {
    "data": bytes(8),
    "coefficients": np.array([8192], np.int32),
    "difference": 1,
    "repeats": False,
    "base": 0,
    "limit": 9,
    "cross": b"",
    "indices": np.zeros(4, np.int64),
}


@built
class TestArguments:
    @pytest.mark.parametrize(
        "wrong",
        [
            {"coefficients": bytes(3)},
            {"coefficients": np.zeros(33, np.int32)},
            {"coefficients": np.array([2**21 + 1], np.int32)},
            {"coefficients": np.array([-(2**31)], np.int32)},
            {"coefficients": memoryview(bytes(9))[1:]},
            {"difference": 2},
            {"difference": -1},
            {"difference": 5, "coefficients": b""},
            {"base": 10},
            {"base": -10},
            {"limit": -1},
            {"limit": 2**32 + 1},
            {"indices": bytearray(7)},
            {"indices": np.zeros(0, np.int64)},
            {"indices": memoryview(bytearray(9))[1:]},
        ],
        ids=changed,
    )
    def test_what_would_overflow_is_refused(self, wrong):
        given = ARGUMENTS | wrong
        with pytest.raises(ValueError, match="not a predictor"):
            compiled.lpcr_decode(*given.values())
        given["data"] = bytearray(8)
        with pytest.raises(ValueError, match="not a predictor"):
            compiled.lpcr_encode(*given.values())

    @pytest.mark.parametrize(
        "wrong",
        [{"data": "text"}, {"indices": bytes(8)}, {"base": 2**64}, {"difference": 2**40},
         {"coefficients": np.zeros((4, 2), np.int32)[:, 0]}],
        ids=changed,
    )  # fmt: skip
    def test_wrong_types(self, wrong):
        with pytest.raises((TypeError, OverflowError, BufferError, ValueError)):
            compiled.lpcr_decode(*(ARGUMENTS | wrong).values())
        with pytest.raises(TypeError):
            compiled.lpcr_decode(b"")

    def test_indices_that_no_packet_holds(self):
        for index in (10, -10, 2**63 - 1, -(2**63)):
            given = ARGUMENTS | {"data": bytearray(8), "indices": np.array([0, index])}
            assert compiled.lpcr_encode(*given.values())[0] == 3


@built
@pytest.mark.parametrize(
    ("sections", "columns", "size"), [(0, 1, 8), (9, 1, 8), (2, 0, 8), (2, 3, 8), (2, 1, 9)]
)
def test_sections_that_do_not_fit_are_refused(sections, columns, size):
    compiled.filter_sections(np.ones((2, 6)), np.ones((2, 2, 2)), np.zeros((2, 4)))
    compiled.filter_sections(np.ones((2, 6)), np.ones((2, 2, 2)), np.zeros((2, 0)))
    with pytest.raises(ValueError, match="not sections"):
        compiled.filter_sections(
            np.ones((sections, 6)), np.ones((columns, sections, 2)), bytearray(4 * size)
        )


READ_AND_WRITE = """
import io, sys, numpy, hapfmt
from hapfmt.kernels import compiled
x = numpy.random.default_rng(1).integers(-40, 40, 300).cumsum().astype(numpy.int32)
scale = hapfmt.Calibration(1, 0, 1000)
channels = tuple(hapfmt.Channel(y, 1000, calibration=scale) for y in (x, x // 2))
stream = io.BytesIO()
summary = hapfmt.write(
    hapfmt.Recording(channels), stream, hapfmt.Settings.of("lossless"), canonical=1
)
assert "from 0" in summary.decisions[1].reason
back = hapfmt.read(stream.getvalue()).channels
same = all((a.stored == b.stored).all() for a, b in zip(back, channels, strict=True))
print(compiled is None, same, stream.getvalue().hex())

rng, t = numpy.random.default_rng(2), numpy.arange(700) / 1000
vibration = 0.05 * numpy.sin(2 * numpy.pi * 170 * t) + rng.normal(0, 0.03, t.size)
texture = 1 + 0.5 * numpy.sin(3 * t) + vibration
stroke = texture - vibration * (abs(t - 0.4) > 0.3)
signals = {
    "lattice": {"x": texture.round(3)}, "doubles": {"x": texture}, "stroke": {"x": stroke},
    "three": {"x": stroke.round(2), "y": texture.round(2), "z": texture.round(2) * 2},
    "gap": {"x": numpy.where(abs(t - 0.5) < 0.1, numpy.nan, texture.round(4))},
}
ways = [
    {"preset": "lossless"}, {"preset": "lossless", "fast": True}, {"preset": "near-lossless"},
    {"preset": "perceptual"}, {"preset": "perceptual", "snr": 20},
    {"preset": "perceptual", "texture": False}, {"preset": "perceptual", "weighting": 0.25},
    {"preset": "perceptual", "synthetic_texture": True},
    {"preset": "paper"},
]
for name, fields in signals.items():
    for options in ways if name == "stroke" else ways[:int(sys.argv[1])]:
        stream = io.BytesIO()
        hapfmt.write(fields, stream, rate=1000, units="N", canonical=1, **options)
        print(f"{name}{options}".replace(" ", ""), stream.getvalue().hex())
"""


@either("count", 1, deep=5)
def test_without_the_extension(count):
    """The same bytes, by the readable loops: of every preset, and of the options that search."""

    def told(pure):
        environment = {k: v for k, v in os.environ.items() if k != "HAPFMT_PURE"} | pure
        done = subprocess.run([sys.executable, "-c", READ_AND_WRITE, str(count)], cwd=ROOT, env=environment,
                              capture_output=True, text=True, check=True)  # fmt: skip
        return done.stdout.split()

    pure, other = told({"HAPFMT_PURE": "1"}), told({})
    assert pure[:2] == ["True", "True"]
    assert pure[1:] == other[1:]


def test_the_twins_are_tested_without_the_extension():
    """Some module that runs there imports each module with twins."""
    modules = {path.stem: path.read_text("utf-8") for path in (ROOT / "tests").glob("test_*.py")}
    assert [each for each in PURE if not fnmatch.filter(modules, f"test_{each}")] == []
    text = "".join(text for name, text in modules.items() if runs_pure(f"{name}.py"))
    twins = [
        path.relative_to(ROOT / "hapfmt").with_suffix("").parts
        for path in (ROOT / "hapfmt").rglob("*.py")
        if re.search(r"^from \.+kernels import .*\bcompiled\b", path.read_text("utf-8"), re.M)
    ]
    assert len(twins) > 10
    for *folders, name in twins:
        package = ".".join(["hapfmt", *folders])
        assert re.search(rf"from {package}(\.{name} import|.* import .*\b{name}\b)", text), name


@built
def test_loops_older_than_their_sources_are_left_out(tmp_path):
    package = Path(hapfmt.__file__).parent
    shutil.copytree(package, tmp_path / "hapfmt", ignore=shutil.ignore_patterns("__pycache__"))
    folder = tmp_path / "hapfmt" / "kernels"
    (extension,) = (path for path in folder.glob("_kernels.*") if path.suffix in (".so", ".pyd"))
    source = folder / "coder.h"
    environment = {k: v for k, v in os.environ.items() if k != "HAPFMT_PURE"}

    def told(*words):
        done = subprocess.run([sys.executable, *words], cwd=tmp_path, env=environment,
                              capture_output=True, text=True, check=True)  # fmt: skip
        return done.stdout.strip(), done.stderr

    asked = ("-c", "from hapfmt.kernels import compiled; print(compiled is not None)")
    assert told(*asked) == ("True", "")
    shutil.copy(ROOT / "hapfmt" / "kernels" / "coder.h", source)  # a wheel has none
    time = extension.stat().st_mtime_ns
    os.utime(source, ns=(time, time + 10**9))
    used, said = told(*asked)
    assert used == "False"
    assert "older than their sources" in said and "python -m pip install -e ." in said
    used, said = told("-m", "hapfmt", "--version")
    assert "no compiled loops" in used and "python -m pip install -e ." in said
    # A wheel has no sources.
    for path in folder.glob("*.[ch]"):
        path.unlink()
    assert told(*asked) == ("True", "")
