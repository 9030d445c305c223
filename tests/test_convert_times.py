"""Time columns: the rate, the start and the gaps that they tell."""

import io
import re
from collections.abc import Callable, Iterable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hapfmt
from hapfmt.convert import read
from hapfmt.convert.timestamps import stamps_of
from hapfmt.errors import ParameterError
from hapfmt.recording import Recording, Span

pytestmark = pytest.mark.filterwarnings("ignore::hapfmt.errors.MovedTimesWarning")


def table(
    times: Iterable[str],
    *,
    head: str = "t [s]",
    rate: float | None = None,
    keep_stamps: bool = False,
) -> Recording:
    rows = "".join(f"{time},{row}\n" for row, time in enumerate(times))
    source = io.BytesIO(f"{head},x [N]\n{rows}".encode())
    return read(source, format="csv", rate=rate, keep_stamps=keep_stamps)


def stamps(
    rate: Fraction | float, ticks: Iterable[int], decimals: int, offset: float = 0
) -> list[str]:
    return [f"{float(tick / Fraction(rate)) + offset:.{decimals}f}" for tick in ticks]


@pytest.mark.parametrize(
    ("rate", "decimals", "rows"),
    [
        (1000, 3, 2),
        (1000, 3, 3),
        (1000, 6, 100),
        (3000, 6, 4),
        (3000, 6, 1000),
        (3000, 4, 1000),
        (44_100, 6, 1000),
        (51_200, 6, 1000),
        (240, 3, 100),
        (700, 3, 100),
        (60, 3, 100),
        (Fraction(17_809, 500), 6, 1000),
        (Fraction(30_000, 1001), 6, 1000),
        (10, 1, 3),
        (1, 0, 5),
        (Fraction(1, 10), 0, 5),
        (Fraction(10, 3), 6, 50),
    ],
)
def test_the_rate_behind_rounded_stamps(rate: Fraction, decimals: int, rows: int) -> None:
    [channel] = table(stamps(rate, range(rows), decimals)).channels
    assert channel.rate_exact == rate
    assert channel.coverage == (Span(0, rows),)


@given(
    rate=st.sampled_from([1000, 3000, 240, 700, Fraction(10, 3), 48_000]),
    start=st.integers(0, 10_000),
    missing=st.sets(st.integers(1, 198), max_size=60),
)
def test_missing_rows_are_gaps(rate: Fraction, start: int, missing: set[int]) -> None:
    ticks = [start + tick for tick in range(200) if tick not in missing]
    recording = table(stamps(rate, ticks, 7))
    [channel] = recording.channels
    assert channel.rate_exact == rate
    assert [tick for span in channel.coverage for tick in range(*span)] == ticks
    assert not recording.metadata


def test_few_missing_rows_of_coarse_stamps() -> None:
    [channel] = table(["0.000", "0.001", "0.002", "0.004", "0.005"]).channels
    assert channel.rate_exact == 1000
    assert channel.coverage == (Span(0, 3), Span(4, 6))


def test_a_gap_of_years_takes_no_memory() -> None:
    [channel] = table(["0", "0.001", "0.002", "50000000", "50000000.001"]).channels
    assert channel.coverage == (Span(0, 3), Span(50_000_000_000, 50_000_000_002))


@pytest.mark.parametrize(
    ("head", "scale"),
    [
        ("t", 1),
        ("time", 1),
        ("Time [s]", 1),
        ("time(s)", 1),
        ("time_s", 1),
        ("t [ms]", 1000),
        ("t_ms", 1000),
        ("Timestamp (us)", 1_000_000),
        ("time [\u00b5s]", 1_000_000),
        ("t [ns]", 1_000_000_000),
    ],
)
def test_names_of_the_time_column(head: str, scale: int) -> None:
    recording = table([f"{row * 0.002 * scale:.6f}" for row in range(10)], head=head)
    assert [channel.label for channel in recording.channels] == ["x"]
    assert recording.channels[0].rate_exact == 500


@pytest.mark.parametrize("head", ["T [Cel]", "time [min]", "t_ref", "torque [N.m]"])
def test_other_first_columns_are_channels(head: str) -> None:
    recording = table(["0", "1"], head=head, rate=10)
    assert len(recording.channels) == 2


def jittered(share: float) -> list[str]:
    rng = np.random.default_rng(1)
    ticks = np.arange(300) + rng.uniform(-share, share, 300)
    return [repr(float(time)) for time in np.sort(ticks - ticks[0]) * 0.01]


def test_jitter_within_half_a_tick_is_noted() -> None:
    recording = table(jittered(0.3))
    [channel] = recording.channels
    assert channel.rate_exact == 100
    assert channel.coverage == (Span(0, 300),)
    [note] = recording.metadata["notes"]
    assert "differ from a regular 100 Hz by up to 3" in note
    assert note.endswith("ms; only the regular times are stored")


def test_worse_jitter_is_refused_unless_a_rate_is_given() -> None:
    with pytest.raises(ParameterError, match=r"deviate by up to 0\.008\d+ s .*rate="):
        table(jittered(0.8))
    recording = table(jittered(0.8), rate=100)
    assert recording.channels[0].coverage == (Span(0, 300),)
    assert "less than a tick apart" in recording.metadata["notes"][0]
    assert "differ from a regular 100 Hz by up to " in recording.metadata["notes"][1]


def drifting(gap: int) -> list[str]:
    """1 kHz whose error adds up, and ``gap`` rows that are missing."""
    steps = 0.001 * np.random.default_rng(3).normal(1, 0.01, 20_000)
    times = np.delete(np.cumsum(steps), slice(12_000, 12_000 + gap))
    return [f"{time:.6f}" for time in times]


def test_a_given_rate_keeps_the_gaps_of_times_that_drift() -> None:
    [channel] = table(drifting(100), rate=1000).channels
    [gap] = [gap for gap in channel.gaps if gap.ticks > 2]
    assert abs(gap.ticks - 100) <= 3 and abs(gap.start - 12_000) <= 3
    assert abs(channel.stop_tick - 20_000) <= 5


def test_rows_that_come_in_bursts_keep_their_order_and_their_gap() -> None:
    arrived = [10 * (row // 10 + 1) + 0.01 * (row % 10) for row in range(1000)]
    late = [time + 500 * (time > 505) for time in arrived]
    [channel] = table([f"{time / 1000:.5f}" for time in late], rate=1000).channels
    assert [gap.ticks for gap in channel.gaps] == [500]


@pytest.mark.parametrize("rate", [500, 900])
def test_a_rate_below_that_of_the_times_is_refused(rate: int) -> None:
    times = [f"{row / 1000}" for row in range(20_000)]
    with pytest.raises(ParameterError, match=r"they come at about 1000 Hz\. Give that rate"):
        table(times, rate=rate)


def test_a_rate_above_that_of_the_times_is_noted() -> None:
    recording = table([f"{row / 1000}" for row in range(100)], rate=2000)
    assert len(recording.channels[0].gaps) == 99
    [note] = recording.metadata["notes"]
    assert note == "the rows come at about 1000 Hz, so most ticks of 2000 Hz are gaps"


def test_random_times_are_refused() -> None:
    times = np.cumsum(np.random.default_rng(2).exponential(1, 300))
    with pytest.raises(ParameterError, match="not regular"):
        table([repr(float(time)) for time in times])


def irregular(rows: int) -> list[str]:
    return [f"{time:.6f}" for time in np.random.default_rng(2).exponential(0.01, rows).cumsum()]


@pytest.mark.parametrize("rows", [100, 400, 5000])
@pytest.mark.parametrize("rate", [95, 100])
def test_a_rate_that_moves_irregular_rows_far_is_refused(rows: int, rate: int) -> None:
    with pytest.raises(ParameterError, match=rf"do not fit a rate of {rate} Hz: rows would move"):
        table(irregular(rows), rate=rate)


@pytest.mark.parametrize("rate", [None, 100])
def test_the_advice_for_irregular_times_holds(rate: int | None) -> None:
    with pytest.raises(ParameterError) as refused:
        table(irregular(400), rate=rate)
    found = re.search(
        r"give a high rate \(rate=\): at (\d+) Hz, no row moves by more than (.+) ms$",
        str(refused.value),
    )
    assert found is not None
    recording = table(irregular(400), rate=int(found[1]), keep_stamps=True)
    assert np.abs(recording["stamp"].samples()).max() <= 1.01e6 * float(found[2]) <= 5e6


def test_a_given_rate_keeps_the_gaps_of_the_times() -> None:
    [channel] = table(["1.0", "1.1", "1.3"], rate=10).channels
    assert channel.coverage == (Span(10, 12), Span(13, 14))


def test_sums_of_a_period_are_regular() -> None:
    recording = table([repr(float(time)) for time in np.cumsum(np.full(1000, 0.001))])
    assert recording.channels[0].rate_exact == 1000
    assert recording.channels[0].coverage == (Span(1, 1001),)
    assert not recording.metadata


@pytest.mark.parametrize(
    ("offset", "start", "note"),
    [
        (5, 5000, None),
        (-5, 0, "begin at -5.0 s, which became tick 0"),
        (1_700_000_000, 0, "the first time, 2023-11-14T22:13:20Z, became the epoch"),
        (1e12, 0, "begin at 1000000000000.0 s, which became tick 0"),
        (0.0004, 0, "begin between two ticks of 1000 Hz, so all rows moved by 0.4 ms"),
    ],
)
def test_where_the_times_begin(offset: float, start: int, note: str | None) -> None:
    recording = table(stamps(1000, range(20), 4, offset))
    assert recording.channels[0].coverage == (Span(start, start + 20),)
    assert recording.epoch_ns == (1_700_000_000 * 10**9 if offset == 1_700_000_000 else None)
    assert note is None or note in recording.metadata["notes"][0]
    assert (note is None) == (not recording.metadata)


@pytest.mark.parametrize("rate", [None, 500])
def test_the_epoch_of_dates_that_jitter_is_exact_to_their_jitter(rate: int | None) -> None:
    rng = np.random.default_rng(4)
    ns = (
        1_760_000_000_123_456_000 + 2_000_000 * np.arange(500) + rng.integers(-200, 200, 500) * 1000
    )
    dates = [str(np.datetime64(int(each), "ns"))[:26] for each in ns]
    recording = table(dates, head="timestamp", rate=rate)
    [channel] = recording.channels
    assert (channel.rate_exact, channel.coverage) == (500, (Span(0, 500),))
    assert recording.epoch_ns is not None
    moved = recording.epoch_ns + 2_000_000 * np.arange(500) - ns
    assert np.abs(moved).max() <= (400_000 if rate else 250_000)
    assert not any("beside" in note for note in recording.metadata["notes"])


def test_the_epoch_of_exact_dates_is_the_first_one() -> None:
    dates = [
        str(np.datetime64(1_760_000_000_123_456_789 + 1_000_000 * row, "ns")) for row in range(9)
    ]
    assert table(dates, head="timestamp").epoch_ns == 1_760_000_000_123_456_789


REFUSED: dict[str, Callable[[], Recording]] = {
    r"fewer than two times give no rate": lambda: table(["0"]),
    r"line 3, column 1 \('t \[s\]'\): '0' is not later than the time before": lambda: table("00"),
    r"line 2, column 1 .*'12:30' is not a time": lambda: table(["12:30"]),
    r"line 2, column 1 .*'' is not a time": lambda: table([""]),
    r"line 2, column 1 .*'1_0' is not a time": lambda: table(["1_0"]),
    r"line 2, column 1 .*'nan' is not a usable time": lambda: table(["nan"]),
    r"line 2, column 1 .*'inf' is not a usable time": lambda: table(["inf"]),
    r"'1e99999999999999999999' is not a usable": lambda: table(["1e99999999999999999999"]),
    r"'0e-9999' is not a usable time": lambda: table(["0e-9999"]),
    r"a rate is a fraction of two integers": lambda: table(["0", "1e-30"]),
}


@pytest.mark.parametrize("message", REFUSED)
def test_refused(message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        REFUSED[message]()


@given(st.lists(st.floats(allow_nan=False), max_size=12), st.sampled_from([None, 1000.0]))
def test_any_times_give_a_recording_or_our_error(times: list[float], rate: float | None) -> None:
    try:
        [channel] = table(map(repr, times), rate=rate).channels
    except ParameterError:
        return
    assert channel.stored.size == len(times)


def kept_ns(recording: Recording, label: str = "stamp") -> list[int]:
    """The stamps that a channel of a recording keeps."""
    channel = recording[label]
    assert channel.unit == "ns"
    spans = [np.arange(span.start, span.stop) for span in channel.coverage]
    ticks = np.concatenate(spans)
    found = stamps_of(
        channel.samples().astype(np.int64), ticks, channel.rate_exact, recording.epoch_ns or 0
    )
    return found.tolist()


def stored(recording: Recording) -> Recording:
    stream = io.BytesIO()
    hapfmt.write(recording, stream)
    return hapfmt.read(stream.getvalue())


def archive(**arrays: object) -> io.BytesIO:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return io.BytesIO(stream.getvalue())


class TestKeptStamps:
    @given(
        jitter=st.lists(st.integers(-400_000, 400_000), min_size=2, max_size=50),
        start=st.sampled_from([0, -(10**15), 5 * 10**9, 1_700_000_000 * 10**9 + 1]),
        lost=st.sets(st.integers(1, 60), max_size=2),
        rate=st.sampled_from([None, 999]),
    )
    def test_a_table(self, jitter, start, lost, rate) -> None:
        """All stamps come back, through a file as well."""
        ticks = [tick for tick in range(80) if tick not in lost][: len(jitter)]
        ns = [start + 1_000_000 * tick + late for tick, late in zip(ticks, jitter, strict=True)]
        rows = "".join(f"{time}e-3,{time % 7}\n" for time in ns)
        data = f"t [us],x [N]\n{rows}".encode()
        try:
            plain = read(io.BytesIO(data), format="csv", rate=rate)
        except ParameterError:
            return
        recording = read(io.BytesIO(data), format="csv", rate=rate, keep_stamps=True)
        assert recording.labels == ["x", "stamp"]
        assert recording["x"].coverage == plain["x"].coverage
        assert kept_ns(recording) == kept_ns(stored(recording)) == ns
        notes = " ".join(recording.metadata.get("notes", []))
        assert "only the regular times are stored" not in notes

    def test_a_table_with_gaps_and_such_a_column(self) -> None:
        data = "Zeit [ms],stamp [N]\n0,1\n10.2,\n19.9,3\n"
        recording = read(io.BytesIO(data.encode()), format="csv", rate=100, keep_stamps=True)
        [note] = [n for n in recording.metadata["notes"] if "a channel keeps the others" in n]
        assert note.endswith(
            "differ from a regular 100 Hz by up to 0.2 ms; a channel keeps the others"
        )
        assert recording[0].coverage == (Span(0, 1), Span(2, 3))
        assert kept_ns(recording, recording.labels[1]) == [0, 10_200_000, 19_900_000]

    def test_dates(self) -> None:
        times = [f"2026-11-22T17:05:00.{n:03d}000007Z" for n in (0, 100, 201, 300)]
        data = "".join(f"{time},1\n" for time in times)
        recording = read(
            io.BytesIO(f"time,x\n{data}".encode()), format="csv", rate=10, keep_stamps=True
        )
        first = 1_795_367_100 * 10**9 + 7
        assert kept_ns(recording) == [first + n * 10**6 for n in (0, 100, 201, 300)]

    @pytest.mark.parametrize("known", [{}, {"rate_hz": 1000}])
    def test_an_archive(self, known) -> None:
        late = np.random.default_rng(3).integers(-300_000, 300_000, 500)
        ns = 10**6 * np.arange(500) + late + 10**6
        recording = read(
            archive(x=np.ones(500), t=ns / 1e9, **known), format="npz", keep_stamps=True
        )
        assert recording.labels == ["ch1", "stamp"] and recording[1].rate == 1000
        assert kept_ns(recording) == kept_ns(stored(recording)) == ns.tolist()
        [deviation] = [note for note in recording.metadata["notes"] if "differ" in note]
        assert deviation.endswith("a channel keeps the others")

    def test_an_archive_of_two_rates(self) -> None:
        arrays = {
            "x__0": np.ones((1, 3)), "rate_hz__0": 10, "t__0": [0.1, 0.2, 0.31], "index__0": [1],
            "x__1": np.ones((1, 2)), "rate_hz__1": 1, "t__1": [1, 2.5], "index__1": [0],
            "start_tick__1": 1,
        }  # fmt: skip
        recording = read(archive(**arrays), format="npz", keep_stamps=True)
        assert [channel.rate for channel in recording] == [1, 10, 10, 1]
        assert kept_ns(recording, recording.labels[2]) == [100_000_000, 200_000_000, 310_000_000]
        assert kept_ns(recording, recording.labels[3]) == [10**9, 25 * 10**8]

    def test_there_must_be_stamps(self) -> None:
        for data, format_, message in (
            (b"x\n1\n2\n", "csv", "no first column 't .s.', so there are no time stamps to keep"),
            (b"t [s],x\n1e10,1\n2e10,2\n", "csv", "line 2.*too far to be kept in ns"),
            (archive(x=[1.0, 2]).read(), "npz", "no key 't', so there are no time stamps to keep"),
            (
                archive(x=[1.0, 2], t=[1.0], fs=10).read(),
                "npz",
                "cannot be kept: there are 1, perhaps",
            ),
            (archive(x=[1.0, 2], t=[1, np.inf], fs=10).read(), "npz", "cannot be kept.*not finite"),
            (archive(x=[1.0, 2], t=[1, 1e300], fs=10).read(), "npz", "cannot be kept.*too far"),
        ):
            with pytest.raises(ParameterError, match=message):
                read(io.BytesIO(data), format=format_, rate=10, keep_stamps=True)

    def test_slow_ticks_are_beyond_64_bits(self) -> None:
        data = archive(x=[1.0, 2], t=[0.0, 1.0], rate="1/1000", start_tick=2**40)
        with pytest.raises(ParameterError, match="the time stamps cannot be kept"):
            read(data, format="npz", keep_stamps=True)


@pytest.mark.parametrize(
    ("unit", "first", "step"),
    [
        ("ms", 1_760_000_000_123, 2),
        ("us", 1_760_000_000_123_457, 2000),
        ("ns", 1_760_000_000_123_456_789, 2_000_000),
        ("us", 17, 2000),
        ("ns", 17, 2_000_000),
    ],
)
@pytest.mark.parametrize("rated", [False, True])
def test_integer_times_of_an_archive(unit: str, first: int, step: int, rated: bool) -> None:
    """Key "stamps" is a channel, whose integers no doubles are equal to."""
    scale = {"ms": 10**6, "us": 1000, "ns": 1}[unit]
    times = first + step * np.arange(1000)
    stamps = 1_760_000_000_123_456_789 + 2_000_000 * np.arange(1000)
    keys = {"fs": 500} if rated else {}
    found = read(
        archive(time=times, force=np.arange(1000.0), stamps=stamps, **keys),
        format="npz",
        keep_stamps=True,
    )
    assert found.labels == ["force", "stamps", "stamp"]
    assert all(channel.rate_exact == 500 for channel in found)
    assert found["stamps"].stored.tolist() == stamps.tolist()
    assert found.epoch_ns == (None if rated or first == 17 else first * scale)
    kept = stamps_of(found["stamp"].stored, np.arange(1000), Fraction(500), found.epoch_ns or 0)
    assert kept.tolist() == (times * scale).tolist()
    assert (
        f"key 'time' holds integers, which are read as times in {unit}" in found.metadata["notes"]
    )


def test_small_integers_of_an_archive_are_seconds() -> None:
    found = read(archive(t=np.arange(5) * 2, x=np.arange(5.0)), format="npz")
    assert found[0].rate_exact == Fraction(1, 2) and not found.metadata


def test_a_first_column_of_another_name_that_may_hold_times() -> None:
    rows = [f"{row / 500:.3f};{row % 7}\n" for row in range(100)]
    source = ("Zeit;Kraft\n" + "".join(rows)).encode()
    with pytest.raises(
        ParameterError, match=r"If 'Zeit' holds times, call it 't', .* as 'Zeit \[ms\]'"
    ):
        read(io.BytesIO(source), format="csv")
    found = read(io.BytesIO(source), format="csv", rate=500)
    assert found.labels == ["Zeit", "Kraft"]
    assert found.metadata["notes"][0].startswith("column 'Zeit' looks like time, but was read")
    for first in (b"7;", b"0.01;"):
        other = source.replace(b"0.100;", first)
        assert not read(io.BytesIO(other), format="csv", rate=500).metadata
    named = read(io.BytesIO(source.replace(b"Zeit", b"Zeit [s]")), format="csv")
    assert named.labels == ["Kraft"] and named[0].rate_exact == 500
