"""True doubles and near-lattices through a whole file: every bit comes back, at what cost."""

from __future__ import annotations

import io
import json
from fractions import Fraction

import numpy as np
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st
from judge import rule

import hapfmt
from hapfmt.codecs.exact import CUBIC, PRODUCT, QUOTIENT, SIGNIFICANT, ExactParameters
from hapfmt.convert import save
from hapfmt.encoder.settings import Settings
from hapfmt.errors import ParameterError
from hapfmt.format.source import BytesSource
from hapfmt.reading.dump import dump, measure
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify
from hapfmt.recording import Calibration, Channel, Recording, Span

SIZE = 6000
WALK = np.random.default_rng(1).integers(-30, 31, SIZE).cumsum()
NOISE = np.random.default_rng(2).normal(size=SIZE)


def printed(x: np.ndarray, form: str) -> np.ndarray:
    return np.array([float(format(v, form)) for v in x.tolist()])


def converted(counts: np.ndarray, step: float) -> np.ndarray:
    """What the driver of a converter makes of its counts: a polynomial of degree 3 from which a
    line differs by 7e-3 of a step."""
    x, reach = counts.astype(float), float(np.abs(counts).max())
    c0, c1, c2, c3 = -1.7 * step, 1.00137 * step, 7e-3 * step / reach**2, -7e-3 * step / reach**3
    return ((c3 * x + c2) * x + c1) * x + c0


DITHER = np.random.default_rng(3).integers(0, 16, SIZE)
SPEED = np.diff(WALK * 2 * np.pi / 300000, prepend=0.0) * 2000
LOGGERS = {
    "multiplied in another order": (WALK * 2 * np.pi / 300000, {QUOTIENT, PRODUCT}, 9.5),
    "times a decimal": (WALK * 1e-6, {PRODUCT}, 6.5),
    "two factors": (WALK * (1 / 60000) * 1.2566370614359172, {QUOTIENT, PRODUCT}, 9.5),
    "gain and offset": (WALK * 1.2566370614359172e-3 - 1.65, {CUBIC}, 6.6),
    "far offset": (WALK * 0.012566370614359172 + 20.25, {CUBIC}, 6.6),
    "six digits of text": (printed(WALK * 20 / 16384, ".6g"), {SIGNIFICANT}, 6.8),
    "binary32": (
        (WALK * np.float32(0.1)).astype(np.float32).astype(float),
        {QUOTIENT, PRODUCT},
        13.1,
    ),
    "a converter of 12 bits": (converted(WALK, 10 / 2**11), {CUBIC}, 9),
    "a converter of 16 bits": (converted(WALK * 16 + DITHER, 0.2 / 2**15), {CUBIC}, 13),
    "derived from positions": (SPEED, {QUOTIENT, PRODUCT}, 15),
    "true doubles": (NOISE, {QUOTIENT}, 57.5),
    "a decay": (np.sin(np.arange(SIZE)) * np.exp(-np.arange(SIZE) / 400.0), {QUOTIENT}, 57.5),
    "values of binary32": (NOISE.astype(np.float32).astype(float), {QUOTIENT}, 28),
    "held doubles": (np.repeat(NOISE, 7)[:SIZE], {QUOTIENT}, 9.3),
    "far from 0": (NOISE * 1e-5 + 1.1, {QUOTIENT}, 39),
    "-0.0": (np.where(WALK % 3 == 0, -0.0, WALK.astype(float)), {QUOTIENT}, 11),
}
"""Values, the rules that will do, and the bits a sample they may cost."""


def written(recording: Recording, preset: str = "lossless", **given) -> bytes:
    stream = io.BytesIO()
    hapfmt.write(recording, stream, Settings.of(preset, **given), canonical=1)
    return stream.getvalue()


def recorded(x: np.ndarray, *coverage: Span) -> Recording:
    return Recording((Channel(x, Fraction(1000), coverage, label="f", unit="N"),))


def bits(x: np.ndarray) -> list[int]:
    return np.ascontiguousarray(x, np.float64).view(np.int64).tolist()


def codec_of(data: bytes) -> str:
    with Reader(data) as reader:
        return reader.channels[0].track.codec


class TestLoggers:
    @pytest.mark.parametrize("name", LOGGERS)
    def test_every_bit_at_the_cost_of_the_rule(self, name):
        x, rules, cost = LOGGERS[name]
        data = written(recorded(x))
        with Reader(data) as reader:
            track = reader.channels[0].track
            (channel,) = reader.read().channels
        assert bits(channel.samples()) == bits(x)
        assert track.codec == "LPCX"
        assert ExactParameters.parse(track.parameters, 0).rule in rules
        assert 8 * measure(BytesSource(data)).payload / SIZE < cost

    def test_rounded_decimals_cost_little_at_effort_fast(self):
        """A scale of a converter, printed with six decimals: about 28 bits a sample otherwise."""
        x = np.round(WALK * 0.0123456789 + 0.00314159, 6)
        data = written(recorded(x), effort="fast")
        assert bits(hapfmt.read(data).channels[0].samples()) == bits(x)
        assert 8 * measure(BytesSource(data)).payload / SIZE < 9

    @pytest.mark.parametrize("name", LOGGERS)
    def test_a_bound_needs_no_tolerance(self, name):
        x, _, _ = LOGGERS[name]
        data = written(recorded(x), "near-lossless", max_error="0.1%")
        (channel,) = hapfmt.read(data).channels
        assert np.abs(channel.samples() - x).max() <= 0.001 * np.ptp(x)
        assert channel.exact is None

    def test_level_1_and_one_description_size(self):
        data = written(recorded(NOISE))
        with Reader(data) as reader:
            assert reader.catalogue.level.number == 1

    def test_counts_are_those_of_the_lattice(self):
        x, _, _ = LOGGERS["six digits of text"]
        (channel,) = hapfmt.read(written(recorded(x)), exact=False).channels
        assert channel.exact is None
        assert channel.stored.tolist() == WALK.tolist()
        assert channel.calibration.step == Fraction(20, 16384)


AWKWARD = [0.0, -0.0, 5e-324, -5e-324, 2.0**53, -(2.0**60), 1e300, -1e308, np.inf, np.nan, 1e-300]


@pytest.mark.filterwarnings("ignore:.* is stored without loss. it has infinite samples")
@given(
    st.lists(st.sampled_from(AWKWARD) | st.floats(width=64) | st.floats(-1, 1), max_size=40),
    st.sampled_from(["lossless", "near-lossless", "perceptual"]),
)
def test_any_doubles(values, preset):
    """EXA-007: The exact values MUST be the numbers of the source, every bit of them."""
    x = np.array(values, np.float64)
    (back,) = hapfmt.read(written(recorded(x), preset)).channels
    if preset == "lossless" or back.exact is not None or back.calibration is None:
        assert bits(back.samples()) == bits(x)


@given(strategies.recordings())
def test_archives_of_any_recording(recording):
    data = written(recording)
    for x, y in zip(recording.channels, hapfmt.read(data).channels, strict=True):
        assert x.coverage == y.coverage
        if x.stored.dtype == np.float64:
            assert bits(x.samples()) == bits(y.samples())
    assert rule(data) == ("intact", None)


class TestChannel:
    CHANNEL = Channel(np.arange(5), Fraction(10), (Span(0, 3), Span(7, 9)), Calibration(1, 0, 10),
                      exact=np.arange(5) * 0.1)  # fmt: skip

    def test_physical_values_are_the_exact_ones(self):
        assert bits(self.CHANNEL.samples()) == bits(np.arange(5) * 0.1)
        assert bits(self.CHANNEL.filled()[7:9]) == bits(np.array([3, 4]) * 0.1)

    @pytest.mark.parametrize(("start", "stop"), [(0, 9), (1, 8), (2, 3), (3, 7), (8, 99)])
    def test_slices_keep_them(self, start, stop):
        ticks = [t for t in (0, 1, 2, 7, 8) if start <= t < stop]
        cut = self.CHANNEL.slice_ticks(start, stop)
        assert cut.exact.size == cut.stored.size == len(ticks)
        assert bits(cut.exact) == bits(cut.stored * 0.1)

    @pytest.mark.parametrize(
        "exact", [np.zeros(4), np.zeros(5, np.float32), np.zeros((5, 1))], ids=["4", "f4", "2d"]
    )
    def test_what_is_not_beside_the_counts_is_refused(self, exact):
        with pytest.raises(ParameterError, match="exact values"):
            Channel(np.arange(5), Fraction(10), calibration=Calibration(), exact=exact)
        with pytest.raises(ParameterError, match="exact values"):
            Channel(np.zeros(5), Fraction(10), exact=np.zeros(5))

    def test_written_again_they_are_the_source(self):
        data = written(recorded(NOISE[:700]))
        again = hapfmt.read(data)
        assert written(again) == data
        assert bits(hapfmt.read(written(again, "lossless")).channels[0].samples()) == bits(
            NOISE[:700]
        )


class TestFiles:
    X = LOGGERS["derived from positions"][0]
    DATA = written(recorded(X, Span(0, 2500), Span(3000, 6500)), cluster=Fraction(1), digest=True)

    def test_parts_of_it(self):
        whole = hapfmt.read(self.DATA).channels[0]
        for start, stop in ((0, 1), (Fraction(1, 3), 2), (2, Fraction(7, 2))):
            (part,) = hapfmt.read(self.DATA, start=start, stop=stop).channels
            cut = whole.slice_ticks(-(-start * 1000 // 1), -(-stop * 1000 // 1))
            assert part.coverage == cut.coverage
            assert bits(part.samples()) == bits(cut.samples())

    def test_du_books_them_apart(self):
        usage = measure(BytesSource(self.DATA))
        assert sum(usage.causes.values()) == len(self.DATA)
        (track,) = usage.tracks.values()
        assert usage.causes["exact values"] == track.exact_size > 1000
        assert usage.payload == track.packets_size == track.exact_size + usage.causes["packets"]

    def test_dump_shows_them(self):
        rows = [row for entry in dump(BytesSource(self.DATA), counts=True)
                for row in entry.get("packets", ())]  # fmt: skip
        shown = [word for row in rows for (word,) in row["exact"]]
        assert shown == self.X.view(np.uint64).tolist()
        json.dumps(rows)

    def test_arrays_hold_them(self):
        stream = io.BytesIO()
        save(hapfmt.read(self.DATA), stream, format="npz")
        with np.load(io.BytesIO(stream.getvalue())) as arrays:
            x, lsb = arrays["x"][0], arrays["lsb"][0]
        assert bits(x[~np.isnan(x)]) == bits(self.X)
        assert lsb == pytest.approx(2 * np.pi / 150)
        stream = io.BytesIO()
        save(hapfmt.read(written(recorded(NOISE))), stream, format="npz")
        with np.load(io.BytesIO(stream.getvalue())) as arrays:
            assert np.isnan(arrays["lsb"]).all()

    def test_pcm_is_no_place_for_them(self):
        x = np.array([0.25, -0.5, 0.125, 1 / 3])
        channel = Channel(np.rint(x * 2**15).astype(np.int64), Fraction(8000),
                          calibration=Calibration(1, 0, 2**15), exact=x)  # fmt: skip
        stream = io.BytesIO()
        save(Recording((channel,)), stream, format="wav")
        (back,) = hapfmt.read(io.BytesIO(stream.getvalue()), format="wav").channels
        assert bits(back.samples()) == bits(x)

    @pytest.mark.parametrize("change", [np.spacing, lambda v: -2 * v])
    def test_verify_sees_one_bit(self, change):
        recording = recorded(self.X, Span(0, 2500), Span(3000, 6500))
        assert verify(self.DATA, against=recording).verdict == "intact"
        other = self.X.copy()
        other[4321] += change(other[4321])
        (check,) = verify(self.DATA, against=recorded(other, *recording.channels[0].coverage)
                          ).contracts  # fmt: skip
        assert check.broken
        assert check.outside == 1

    def test_damage_leaves_a_gap_and_no_other_number(self):
        whole = dict(zip(range(6000), bits(self.X), strict=True))
        ticks = [*range(2500), *range(3000, 6500)]
        place = dict(zip(ticks, whole.values(), strict=True))
        lost = 0
        generator = np.random.default_rng(3)
        for at in generator.integers(200, len(self.DATA) - 400, 40).tolist():
            broken = bytearray(self.DATA)
            broken[at] ^= 1 << int(generator.integers(0, 8))
            with Reader(bytes(broken)) as reader:
                (channel,) = reader.read().channels
                assert reader.findings
            seen = [t for span in channel.coverage for t in range(span.start, span.stop)]
            assert [place[t] for t in seen] == bits(channel.samples())
            lost += len(ticks) - len(seen)
        assert lost > 0

    def test_the_digest_speaks_of_them(self):
        assert verify(self.DATA).digests == 1
        with Reader(self.DATA) as reader:
            track = reader.channels[0].track
            exact = np.concatenate([p.exact[:, 0] for p in reader.pieces([track], exact=True)])
            assert all(p.exact is None for p in reader.pieces([track]))
        assert bits(exact) == bits(self.X)
