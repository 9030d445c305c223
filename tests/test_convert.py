"""Other files <-> Recording: what goes out comes back, and what cannot is refused or noted."""

import io
import struct
import sys
import zipfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest
from depth import sample
from hypothesis import example, given, settings
from hypothesis import strategies as st

import hapfmt
from hapfmt.convert import read, save
from hapfmt.convert.formats import OURS, formats
from hapfmt.errors import HapfmtError, LimitError, MissingExtraError, ParameterError
from hapfmt.recording import Calibration, Channel, Recording, Span

pytestmark = pytest.mark.filterwarnings("ignore::hapfmt.errors.MovedTimesWarning")

DATA = Path(__file__).parents[2] / "shared" / "data"
RECORDINGS = sorted(DATA.glob("**/*.npz"))
RATES = [
    Fraction(1000),
    Fraction(44_100, 7),
    Fraction(17_809, 500),
    Fraction(1, 3),
    Fraction(51_200),
    Fraction(123_456_789, 98_765),
]
NAN = float("nan")

doubles = st.one_of(
    st.sampled_from([NAN, -0.0, 5e-324, -5e-324, 2.0**-1022, 1e308, float("inf"), float("-inf")]),
    st.floats(width=64),
)
rates = st.sampled_from(RATES)
labels = st.text(st.characters(exclude_categories=("C", "Z")), max_size=6) | st.sampled_from(
    ["force x", "a [b]", "[N]", 'say "x"', "a,b;c\td", "#1", "  "]
)
units = st.sampled_from(["1", "N", "m/s2", "[g]", "{count}", "{raw(0-255)}", "m[H2O]"])


@st.composite
def channels(draw: st.DrawFn, *, rate: Fraction | None = None, start: int | None = None) -> Channel:
    """With gaps, infinities, -0.0, and at least one number; ``start`` fixes the first tick."""
    x = draw(st.lists(doubles, min_size=1, max_size=8))
    if np.isnan(x[0]) and (start is not None or np.isnan(x).all()):
        x[0] = 0.5
    return Channel.from_physical(
        np.array(x),
        rate if rate is not None else draw(rates),
        start_tick=draw(st.integers(0, 20)) if start is None else start,
        label=draw(labels),
        unit=draw(units),
    )


def own_label(channel: Channel) -> object:
    """Two labels that differ; channels without one may be many."""
    return channel.label.strip() or id(channel)


def there_and_back(recording: Recording, suffix: str, **options: Any) -> Recording:
    stream = io.BytesIO()
    save(recording, stream, format=suffix)
    stream.seek(0)
    return read(stream, format=suffix, **options)


def facts(channel: Channel) -> tuple[Any, ...]:
    bits = channel.samples().view(np.uint64).tolist()
    return channel.coverage, bits, channel.rate_exact, channel.label, channel.unit


def samples(channel: Channel) -> tuple[Any, ...]:
    return facts(channel)[:3]


class TestThereAndBack:
    @given(st.lists(channels(), max_size=4, unique_by=own_label))
    def test_npz_keeps_rates_starts_gaps_order_and_bits(self, given: list[Channel]) -> None:
        recording = Recording(tuple(given), metadata={"source": "somewhere"})
        back = there_and_back(recording, "npz")
        assert [*map(facts, back.channels)] == [*map(facts, given)]
        assert back.metadata == {"source": "somewhere"}

    @given(
        rates.flatmap(
            lambda rate: st.lists(channels(rate=rate), min_size=1, max_size=3, unique_by=own_label)
        )
    )
    def test_csv_keeps_one_rate_starts_gaps_and_bits(self, given: list[Channel]) -> None:
        back = there_and_back(Recording(tuple(given)), "csv", rate=given[0].rate_exact)
        assert [*map(samples, back.channels)] == [*map(samples, given)]
        names = [(channel.label, channel.unit) for channel in back.channels]
        assert names == [(channel.label.strip(), channel.unit) for channel in given]

    @given(rates, st.integers(0, 20), st.integers(2, 50))
    @example(Fraction(6300), 18, 2)
    def test_csv_tells_the_rate_by_its_times(self, rate: Fraction, start: int, count: int) -> None:
        given = Channel(np.arange(float(count)), rate, (Span(start, start + count),))
        stream = io.BytesIO()
        notes = save(Recording((given,)), stream, format="csv")
        [back] = read(io.BytesIO(stream.getvalue()), format="csv").channels
        assert (back.rate_exact, back.coverage) == (rate, given.coverage) or "do not tell" in notes[
            0
        ]
        assert rate == RATES[-1] or not notes

    @given(rates.flatmap(lambda r: st.lists(channels(rate=r, start=0), min_size=1, max_size=3)))
    def test_npy_keeps_one_start_gaps_and_bits(self, given: list[Channel]) -> None:
        back = there_and_back(
            Recording(tuple(given)), "npy", rate=given[0].rate_exact, transpose=False
        )
        assert [*map(samples, back.channels)] == [*map(samples, given)]

    @given(st.lists(channels(rate=Fraction(48_000)), min_size=1, max_size=3))
    def test_wav_keeps_doubles_bit_for_bit(self, given: list[Channel]) -> None:
        start = min((c.start_tick for c in given if c.coverage), default=0)
        back = there_and_back(Recording(tuple(given)), "wav")
        moved = [
            tuple(Span(s.start - start, s.stop - start) for s in channel.coverage)
            for channel in given
        ]
        assert [channel.coverage for channel in back.channels] == moved
        assert [samples(c)[1:] for c in back.channels] == [samples(c)[1:] for c in given]

    @given(st.sampled_from([8, 16, 24, 32]), st.data())
    def test_wav_keeps_counts_bit_for_bit(self, bits: int, data: st.DataObject) -> None:
        count = st.integers(-(1 << (bits - 1)), (1 << (bits - 1)) - 1)
        size = data.draw(st.integers(1, 5))
        columns = st.lists(count, min_size=size, max_size=size)
        given = [
            Channel(
                np.array(data.draw(columns), np.int64),
                Fraction(8000),
                calibration=Calibration(1, 0, 1 << (bits - 1)),
                label=f"ch{number}",
            )
            for number in (1, 2)
        ]
        stream = io.BytesIO()
        assert save(Recording(tuple(given)), stream, format="wav") == ()
        back = read(io.BytesIO(stream.getvalue()), format="wav").channels
        assert [*map(facts, back)] == [*map(facts, given)]
        assert [c.calibration for c in back] == [c.calibration for c in given]
        assert stream.getvalue()[34:36] == struct.pack("<H", bits)

    def test_counts_go_out_as_physical_values_with_their_step(self) -> None:
        given = Channel(
            np.array([1, 2, 5], np.int16), Fraction(10), calibration=Calibration(-1, 1, 4)
        )
        [back] = there_and_back(Recording((given,)), "npz").channels
        assert back.stored.tolist() == [0.0, -0.25, -1.0]
        assert back.lsb == 0.25

    def test_a_recording_without_channels(self) -> None:
        assert there_and_back(Recording(), "npz").channels == ()


class Pipe(io.RawIOBase):
    """Goes one way, a few bytes at a time."""

    def __init__(self, data: bytes = b"") -> None:
        self._left = memoryview(data)
        self.taken = bytearray()

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        size = min(len(buffer), len(self._left), 7)
        buffer[:size], self._left = self._left[:size], self._left[size:]
        return size

    def write(self, data: Any) -> int:
        self.taken += data
        return len(data)


def example(count: int = 30) -> Recording:
    x = np.linspace(-1, 1, 2 * count).reshape(2, count)
    return Recording(
        tuple(Channel.from_physical(row, 100, label=f"c{i}", unit="N") for i, row in enumerate(x))
    )


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".csv", ".wav"])
class TestEveryFormat:
    def test_streams_that_cannot_seek(self, suffix: str) -> None:
        sink = Pipe()
        save(example(), sink, format=suffix)  # type: ignore[arg-type]
        source: BinaryIO = io.BufferedReader(Pipe(bytes(sink.taken)))  # type: ignore[assignment]
        back = read(source, format=suffix, rate=100)
        assert [*map(samples, back.channels)] == [*map(samples, example().channels)]
        assert not source.closed

    def test_files(self, suffix: str, tmp_path: Path) -> None:
        path = tmp_path / f"a{suffix.upper()}"
        save(example(), path)
        with pytest.raises(ParameterError, match=f"{path} already exists"):
            save(example(), path)
        save(example(5), path, force=True)
        back = read(str(path), rate="100/1")
        assert [*map(samples, back.channels)] == [*map(samples, example(5).channels)]
        assert [p.name for p in tmp_path.iterdir()] == [path.name]

    def test_a_failure_leaves_no_file(self, suffix: str, tmp_path: Path) -> None:
        wrong = Channel(np.array([2**53 + 1]), Fraction(10), label="far")
        with pytest.raises(ParameterError, match=r"a\.\w+: channel 'far' holds 9007199254740993"):
            save(Recording((wrong,)), tmp_path / f"a{suffix}")
        assert not list(tmp_path.iterdir())

    def test_any_damage_gives_a_recording_or_our_error(self, suffix: str) -> None:
        stream = io.BytesIO()
        save(example(), stream, format=suffix)
        whole = stream.getvalue()
        rng = np.random.default_rng(3)
        damaged = [whole[:size] for size in range(0, len(whole), max(1, len(whole) // 150))]
        for _ in range(400):
            at = int(rng.integers(len(whole)))
            changed = bytes(rng.integers(0, 256, int(rng.integers(0, 3)), dtype=np.uint8))
            damaged.append(whole[:at] + changed + whole[at + 1 :])
        for data in damaged:
            try:
                read(io.BytesIO(data), format=suffix, rate=100, max_memory=1 << 22)
            except (HapfmtError, OSError) as error:
                assert str(error)

    @given(data=st.binary(max_size=60))
    @settings(max_examples=50)
    def test_any_bytes_give_a_recording_or_our_error(self, suffix: str, data: bytes) -> None:
        try:
            read(io.BytesIO(data), format=suffix, rate=100, max_memory=1 << 22)
        except (HapfmtError, OSError) as error:
            assert str(error)

    def test_memory_is_bounded(self, suffix: str) -> None:
        stream = io.BytesIO()
        save(example(1000), stream, format=suffix)
        with pytest.raises(LimitError, match=r"1000 (bytes )?allowed|than 1000 bytes.*max_mem"):
            read(io.BytesIO(stream.getvalue()), format=suffix, rate=100, max_memory=1000)
        far = Channel(np.zeros(2), Fraction(10), (Span(0, 1), Span(1 << 40, (1 << 40) + 1)))
        if suffix == ".csv":
            # Its time column tells of the gap.
            notes = save(Recording((far,)), stream := io.BytesIO(), format=suffix)
            assert "rows without any sample were left out" in notes[0]
            back = read(stream.getvalue(), format=suffix, rate=10)
            assert back[0].coverage == far.coverage
            return
        with pytest.raises(LimitError, match=r"gaps take .* more than .*max_memory="):
            save(Recording((far,)), io.BytesIO(), format=suffix)


def npy(array: Any, **options: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, **options)
    return stream.getvalue()


def npy_header(text: str, data: bytes = b"", version: int = 1) -> bytes:
    return b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<H", len(text)) + text.encode() + data


def npz(compression: int = zipfile.ZIP_DEFLATED, **members: Any) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        for key, value in members.items():
            archive.writestr(f"{key}.npy", value if isinstance(value, bytes) else npy(value))
    return stream.getvalue()


def wav(subtype: str, **options: Any) -> bytes:
    soundfile = pytest.importorskip("soundfile")
    stream = io.BytesIO()
    soundfile.write(stream, np.zeros((4, 1)), 8000, subtype=subtype, **{"format": "WAV", **options})
    return stream.getvalue()


X = np.zeros((2, 3))
BAD_NPY: dict[str, Callable[[], bytes]] = {
    "is not a NumPy array: EOF": lambda: b"",
    "is not a NumPy array: the magic string": lambda: b"abcdefgh",
    r"array format \(3, 0\)": lambda: npy_header("", version=3),
    r"is not a NumPy array: (?!EOF:)": lambda: npy_header("{"),
    "Header does not contain the correct keys": lambda: npy_header("{}"),
    "the array has the dtype object": lambda: npy(np.array([None]), allow_pickle=True),
    "the array holds 0x110000, which is not a Unicode": lambda: npy_header(
        "{'descr':'<U1','fortran_order':False,'shape':()}", struct.pack("<I", 0x110000)
    ),
    "the array has the dtype complex128": lambda: npy(np.zeros(2, complex)),
    r"the array has the dtype datetime64": lambda: npy(np.zeros(2, "M8[s]")),
    r"the array holds <U1 values, not real numbers": lambda: npy(np.array(["a"])),
    r"the array has the shape \(1, 1, 1\)": lambda: npy(np.zeros((1, 1, 1))),
    r"the array has the shape \(-1,\)": lambda: npy_header(
        "{'descr':'<f8','fortran_order':False,'shape':(-1,)}"
    ),
    r"the array has the shape \(0, 1\d+\)": lambda: npy_header(
        "{'descr':'<f8','fortran_order':False,'shape':(0,1" + "0" * 30 + ")}"
    ),
    r"the array has the shape \(True, 10\), not one of integers": lambda: npy_header(
        "{'descr':'<f8','fortran_order':False,'shape':(True,10)}"
    ),
    "the array is 70000 x 1, read as 70000 channels.*transpose=True": lambda: npy(
        np.zeros((70_000, 1))
    ),
    "the array is a single number": lambda: npy(np.zeros(())),
    "the array ends after 23 of 24 bytes": lambda: npy(np.zeros(3))[:-1],
    "the array is followed by further bytes": lambda: npy(np.zeros(3)) + b"x",
    "the array holds inf, which no double": lambda: npy(np.array([np.longdouble(2) ** 2000])),
    "holds 9007199254740993, which no double": lambda: npy(np.array([1, 2**53 + 1])),
    "holds 18446744073709551615, which no double": lambda: npy(np.array([2**64 - 1], np.uint64)),
}
BAD_NPZ: dict[str, Callable[[], bytes]] = {
    "this is not an .npz archive: File is not a zip": lambda: b"",
    r"no key 'x' .*; there are: 'y' \(one value\)$": lambda: npz(y=np.zeros(())),
    r"no key 'x' .*; there are: 'y' \(2 x 3\), 'z' \(2 x 3\)": lambda: npz(y=X, z=X),
    r"no arrays of one dimension and one length; there are: 'p' \(3\), 'q' \(2\)": lambda: npz(
        p=X[0], q=X[0][:2]
    ),
    r"key 'x' has the shape \(True, 10\)": lambda: npz(
        x=npy_header("{'descr':'<f8','fortran_order':False,'shape':(True,10)}")
    ),
    "key 'x' is 1000 x 3, read as 1000 channels.*transpose=True": lambda: npz(
        x=np.zeros((1000, 3))
    ),
    r"there are: 'k0' .*'k7' \(2 x 3\) and 2 more$": lambda: npz(**{f"k{i}": X for i in range(10)}),
    "keys x and x__0 together": lambda: npz(x=X, x__0=X),
    "key 'x' is compressed by a method": lambda: npz(zipfile.ZIP_BZIP2, x=X),
    "key 'x' has the dtype object": lambda: npz(x=npy(np.array([None]), allow_pickle=True)),
    "key 'x': Bad CRC-32": lambda: npz(zipfile.ZIP_STORED, x=X).replace(b"\0" * 48, b"\1" * 48),
    "key 'x' is not a NumPy array": lambda: npz(x=b""),
    "the file holds no rate": lambda: npz(x=X),
    "key 'rate_hz' has 2 entries, more than 1": lambda: npz(x=X, rate_hz=[1, 2]),
    "'nan' is not a rate": lambda: npz(x=X, rate_hz=NAN),
    "'-1' is not a rate": lambda: npz(x=X, rate_hz=-1),
    "a rate is a fraction of two integers": lambda: npz(x=X, rate_hz=0),
    "'1/0' is not a rate": lambda: npz(x=X, rate="1/0"),
    "key 'rate' holds bool values": lambda: npz(x=X, rate=True),
    "rate is 7 Hz and rate_hz 8 Hz": lambda: npz(x=X, rate="7", rate_hz=8),
    "key 'channel_names' holds int64 values, not text": lambda: npz(x=X, channel_names=[1, 2]),
    "channel_names has 1 entries for 2": lambda: npz(x=X, rate_hz=1, channel_names=["a"]),
    "x looks transposed": lambda: npz(x=X, rate_hz=1, channel_names=["a", "b", "c"]),
    "key 'unit' has 32767 entries, more than 32766": lambda: npz(x=X, unit=np.zeros(32_767, "U")),
    "unit has 3 entries for 2": lambda: npz(x=X, rate_hz=1, unit=["N"] * 3),
    "lsb has 3 entries for 2": lambda: npz(x=X, rate_hz=1, lsb=[1.0] * 3),
    "negative or infinite": lambda: npz(x=X, rate_hz=1, lsb=-1),
    r"start_tick is not one tick in \[0": lambda: npz(x=X, rate_hz=1, start_tick=-1),
    "start_tick is not one tick": lambda: npz(x=X, rate_hz=1, start_tick=2**48),
    "key 'start_tick' holds float64": lambda: npz(x=X, rate_hz=1, start_tick=1.0),
    "index has 1 entries for 2": lambda: npz(x=X, rate_hz=1, index=[0]),
    "do not give each channel a position": lambda: npz(x=X, rate_hz=1, index=[0, 0]),
    "key 'source' holds no text": lambda: npz(x=X, rate_hz=1, source=np.array(b"\xff")),
}
BAD_CSV: dict[str, bytes] = {
    "no header row": b"",
    "no header row 'name": b"\xef\xbb\xbf# only a comment\n\n",
    "line 1: the first row holds numbers": b"0,1\n",
    "no first column 't .s.' and no rate": b"x\n1\n",
    "a time column but no channel": b"t\n1\n",
    r"line 4, column 2 \('x'\): 'abc' is not a number$": b"t,x\n0,1\n#\n1,abc\n",
    "'1_0' is not a number": b"t,x\n0,1_0\n",
    "'0x1' is not a number": b"t,x\n0,0x1\n",
    "'\u0661' is not a number": "t,x\n0,\u0661\n".encode(),
    "'1,5,2' is not a number": b"t;x\n0;1,5,2\n",
    "'1,5' is not a number; write 1.5, or 1,5 in the whole table": b"t;x\n0;1.5\n1;1,5\n",
    "'2.5' has a point where the table has decimal commas": b"t;x\n0;1,5\n1;2.5\n",
    "a row of 4 cells, where the header has 2; if commas are decimal": b"t,x\n0,5,1,5\n",
    r"column 2 \(''\): the header gives this column no name": b"t,,x\n0,1,2\n",
    "a value in a column that the header gives no name": b"t,x,\n0,1,2\n",
    "'soon' is not a time; write seconds, or 2026": b"time,x\nsoon,1\n",
    "'2026-13-01 00:00:00' is not a time": b"time,x\n2026-13-01 00:00:00,1\n",
    "'7' is not a date": b"time,x\n2026-11-22T17:00:00Z,1\n7,1\n",
    "'2026-11-22 17:00:00' is a date, and the column has a unit": (
        b"time [ms],x\n2026-11-22 17:00:00,1\n"
    ),
    r"begin at 1763830800000, which are no seconds since 1970; name the unit.*\[ms\]": (
        b"time,x\n1763830800000,1\n1763830800001,2\n"
    ),
    "'1111.*' is not a number": b"x\n" + b"1" * 100_000 + b"x\n",  # in linear time
    "'1e999' is beyond the range of a double": b"t,x\n0,1e999\n",
    "line 2: a row of 3 cells, where the header has 2": b"t,x\n0,1,2\n",
    "line 2: a row of 1 cells, where the header has 2": b"t,x\n0\n",
    "line 1: unexpected end of data": b't,"x\n0,1\n',
    "line 2: ',' expected after '\"'": b't,x\n"0"1,2\n',
    r"after line \d{4}: not UTF-8 text": b"x\n" + b"1\n" * 5000 + b"\xff\n",
    r"not UTF-8 text; save the table as UTF-8 \(iconv -f latin1 -t utf-8 IN > OUT\)$": b"t,\xb5\n0,1\n",
    r"line 2: this looks like a row of units; .*'time \[s\]'$": b"time,Fx\ns,N\n0,1\n",
    r"line 3: this looks like a row of units; .*'Fx \[N\]'$": b"n,Fx\n#\n-,(N)\n0,1\n",
    r"'\(none\)' is not a number": b"a,b\n(none),-\n",
    r"no name; for tables of pandas: to_csv\(index=False\), or index_label": b",x\n0,1\n",
}
BAD_WAV: dict[str, Callable[[], bytes]] = {
    "this is not a .wav file: it does not begin with RIFF": lambda: b"",
    "it does not begin with RIFF and WAVE": lambda: wav("PCM_16", format="FLAC"),
    "this is no .wav file: Error opening": lambda: wav("PCM_16")[:12],
    "ULAW samples are not read": lambda: wav("ULAW"),
    "never closed: the header counts no samples, 8 bytes follow": lambda: (
        b"RIFF\0\0\0\0" + wav("PCM_16")[8:].replace(b"data\x08", b"data\0")
    ),
    "truncated: 3 of 8 bytes of samples are missing": lambda: wav("PCM_16")[:-3],
}


def refused(suffix: str, data: bytes, message: str) -> None:
    stream = io.BytesIO(data)
    stream.name = "dir/given"  # type: ignore[attr-defined]
    with pytest.raises(ParameterError, match=rf"^dir/given: .*{message}"):
        read(stream, format=suffix)


class TestRefused:
    @pytest.mark.parametrize("message", BAD_NPY)
    def test_npy(self, message: str) -> None:
        refused("npy", BAD_NPY[message](), message)

    @pytest.mark.parametrize("message", BAD_NPZ)
    def test_npz(self, message: str) -> None:
        refused("npz", BAD_NPZ[message](), message)

    @pytest.mark.parametrize("message", BAD_CSV)
    def test_csv(self, message: str) -> None:
        refused("csv", BAD_CSV[message], message)

    @pytest.mark.parametrize("message", BAD_WAV)
    def test_wav(self, message: str) -> None:
        refused("wav", BAD_WAV[message](), message)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"format": "mp3"}, "no format is called 'mp3'"),
            ({"format": "csv", "rate": "fast"}, "'fast' is not a rate in Hz"),
            ({"format": "csv", "rate": "1kHz"}, "'1kHz' is not a rate in Hz"),
            ({"format": "csv", "rate": 0}, "a rate is a fraction"),
            ({"format": "csv", "rate": float("inf")}, "'inf' is not a rate"),
            ({"format": "csv", "rate": "1e999999999"}, "'1e999999999' is not a rate"),
        ],
    )
    def test_arguments(self, arguments: dict[str, Any], message: str) -> None:
        with pytest.raises(ParameterError, match=message):
            read(io.BytesIO(b"x\n1\n"), **arguments)

    def test_names(self, tmp_path: Path) -> None:
        (tmp_path / "a.mp3").write_bytes(b"ID3\0")
        with pytest.raises(ParameterError, match=r"a\.mp3: the suffix '.mp3' is not one of"):
            read(tmp_path / "a.mp3")
        with pytest.raises(ParameterError, match=r"a stream has no suffix; give its format: .npz"):
            save(example(), io.BytesIO())
        with pytest.raises(FileNotFoundError):
            read(tmp_path / "a.csv")
        with pytest.raises(ParameterError, match="is a directory"):
            save(example(), tmp_path, format="csv")

    def test_one_rate_for_several_groups(self) -> None:
        data = npz(x__0=X, x__1=X, rate_hz__0=1, rate_hz__1=2)
        with pytest.raises(ParameterError, match="several rates"):
            read(io.BytesIO(data), format="npz", rate=1)

    def test_wav_without_soundfile(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "soundfile", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[audio\]"):
            read(io.BytesIO(b"RIFF\0\0\0\0WAVE"), format="wav")

    @pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
    def test_an_error_of_the_stream_below_wav(self, error: BaseException) -> None:
        class Broken(io.BytesIO):
            def write(self, _: Any) -> int:
                raise error

        with pytest.raises(type(error)):
            save(example(), Broken(), format="wav")


def channel(x: Any, rate: Fraction | int = 10, **described: Any) -> Channel:
    return Channel(np.asarray(x), Fraction(rate), **described)


PCM = Calibration(1, 0, 1 << 15)
NOT_WRITTEN: dict[str, tuple[str, list[Channel]]] = {
    "a recording without channels cannot be written as .csv": ("csv", []),
    r".csv holds one rate, the channels have 1 Hz, 2 Hz; .* \(sel\), or use .npz": (
        "csv", [channel([1.0], 1), channel([1.0], 2)],
    ),
    ".npy holds one rate": ("npy", [channel([1.0], 1), channel([1.0], 2)]),
    ".npy holds one start": ("npy", [channel([1.0]), channel([1.0], coverage=(Span(1, 2),))]),
    ".wav holds whole rates": ("wav", [channel([1.0], Fraction(1, 2))]),
    r"channel 'g' has gaps": (
        "wav", [channel([1, 2], coverage=(Span(0, 1), Span(2, 3)), calibration=PCM, label="g")],
    ),
    r"channel 'e' has gaps": (
        "wav", [channel([1, 2], calibration=PCM), channel([1], calibration=PCM, label="e")],
    ),
    r"channel 'h' has counts beyond 16 bits": (
        "wav", [channel([1 << 15], calibration=PCM, label="h")],
    ),
    "this cannot be written as .wav": ("wav", [channel([1.0])] * 1025),
    "has a line break": ("csv", [channel([1.0], label="a\nb")]),
    "cannot be written as UTF-8": ("csv", [channel([1.0], label="\ud800")]),
    "ends in NUL": ("npz", [channel([1.0], label="a\0")]),
    "a rate is a fraction of two integers": ("npz", [channel([1.0], 1 << 64)]),
    "channel 'i' holds 18446744073709551615": (
        "npz", [channel([2**64 - 1], label="i")],
    ),
}  # fmt: skip


@pytest.mark.parametrize("message", NOT_WRITTEN)
def test_not_written(message: str) -> None:
    suffix, listed = NOT_WRITTEN[message]
    with pytest.raises(ParameterError, match=message):
        save(Recording(tuple(listed)), io.BytesIO(), format=suffix)


class TestNpz:
    @pytest.mark.parametrize(
        "x",
        [
            np.array([True, False]),
            np.array([-(2**63), 2**62 + 2**10, 0]),
            np.array([2**63, 2**53 - 1], np.uint64),
            np.array([1.5, NAN, -0.0], np.float16),
            np.array([0.1, 1e-45], np.float32),
            np.array([0.1, NAN, -np.inf], np.longdouble),
            np.array([1, 2], ">i2"),
            np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        ],
        ids=lambda x: str(x.dtype),
    )
    def test_every_real_dtype(self, x: Any) -> None:
        back = read(io.BytesIO(npz(x=x, rate_hz=10)), format="npz")
        for row, found in zip(np.atleast_2d(x), back.channels, strict=True):
            assert np.array_equal(found.filled(0, row.size), row.astype(float), equal_nan=True)

    def test_what_is_absent(self) -> None:
        [one, two] = read(io.BytesIO(npz(x=X, rate_hz=1)), format="npz").channels
        assert (one.label, two.label, one.unit, one.lsb, one.start_tick) == (
            "ch1",
            "ch2",
            "1",
            None,
            0,
        )

    def test_one_unit_and_one_step_for_all(self) -> None:
        data = npz(x=X, rate_hz=1, unit=np.array(b"Nm"), lsb=0.5)
        found = read(io.BytesIO(data), format="npz").channels
        assert [(c.unit, c.lsb) for c in found] == [("N.m", 0.5)] * 2

    @pytest.mark.parametrize(
        ("rate", "exact"),
        [
            (35.618, Fraction(17_809, 500)),
            (np.float32(35.618), Fraction(17_809, 500)),
            (np.int16(240), Fraction(240)),
            (1e-3, Fraction(1, 1000)),
            (np.array([[1e5]]), Fraction(100_000)),
        ],
    )
    def test_rate_is_the_shortest_decimal(self, rate: Any, exact: Fraction) -> None:
        assert (
            read(io.BytesIO(npz(x=X, rate_hz=rate)), format="npz").channels[0].rate_exact == exact
        )

    def test_what_is_not_carried_over_is_noted(self) -> None:
        data = npz(x=X, rate_hz=10, t=[5.0, 5.1, 5.25], set="a", unit="\u65e5")
        notes = read(io.BytesIO(data), format="npz", rate=20).metadata["notes"]
        assert notes == [
            "the rate of the file, 10 Hz, was overridden by 20 Hz",
            "the sample times (key 't') differ from a regular 20 Hz by up to 150 ms; only the "
            "regular times are stored",
            "the times begin at 5.0 s, which became tick 0",
            "the unit '\u65e5' of channel 'ch1' is kept as 1",
            "the unit '\u65e5' of channel 'ch2' is kept as 1",
            "keys not carried over: 'set'",
        ]

    @pytest.mark.parametrize("start", [0, 7])
    def test_regular_times_need_no_note(self, start: int) -> None:
        data = npz(x=X, rate_hz=10, start_tick=start, t=(start + np.arange(3)) / 10)
        assert "notes" not in read(io.BytesIO(data), format="npz").metadata

    def test_irregular_times_come_back_as_a_channel_of_their_own(self) -> None:
        t = np.arange(500) / 35.6 + np.random.default_rng(1).uniform(-1e-3, 1e-3, 500)
        given = npz(x=[np.sin(t), t], rate_hz=35.6, channel_names=["f", "time"], unit=["N", "s"])
        stream = io.BytesIO()
        hapfmt.write(read(io.BytesIO(given), format="npz"), stream)
        assert hapfmt.read(stream.getvalue())["time"].to_numpy().tobytes() == t.tobytes()

    @pytest.mark.parametrize("times", [[0.0, NAN, 1.0], [0.0]])
    def test_unusable_times_are_noted(self, times: list[float]) -> None:
        [note] = read(io.BytesIO(npz(x=X, rate_hz=1, t=times)), format="npz").metadata["notes"]
        assert f"there are {len(times)}, perhaps not finite, for 3 samples" in note

    def test_the_same_recording_gives_the_same_bytes(self) -> None:
        first, second = io.BytesIO(), io.BytesIO()
        save(example(), first, format="npz")
        save(example(), second, format="npz")
        assert first.getvalue() == second.getvalue()


class TestCsv:
    @pytest.mark.parametrize(
        "text",
        [
            "t [s],x [N],y\n0,1.5,2\n0.5,,3\n1.0,nan,4\n",
            "\ufefft [s],x [N],y\r\n0,1.5,2\r\n0.5,,3\r\n1.0,NaN,4\r\n",
            '"t [s]";"x [N]";y\n0;1.5;2\n0.5;;3\n1.0;nan;4\n\n',
            "t [s]\tx [N]\ty\n0\t1.5\t2\n0.5\t\t3\n1.0\tnan\t4",
            " t [s] , x[N] , y \n\n 0, 1.5 , 2\n 0.5 , , 3\n1.0, nan, 4\n,,\n",
            "# made by hand\nt [s],x [N],y\n# first\n0,1.5,2\n0.5,,3\n1.0,nan,4\n",
            "time_ms,x [N],y\r0,+1.5e0,2.\r500,,3\r1000,-nan,4\r",
        ],
    )
    def test_dialects(self, text: str) -> None:
        recording = read(io.BytesIO(text.encode()), format="csv")
        x, y = recording.channels
        assert (x.label, x.unit, x.coverage, x.stored.tolist()) == ("x", "N", (Span(0, 1),), [1.5])
        assert (y.label, y.unit, y.coverage, y.stored.tolist()) == (
            "y",
            "1",
            (Span(0, 3),),
            [2, 3, 4],
        )
        assert x.rate_exact == y.rate_exact == 2
        comments = text.count("#")
        assert recording.metadata == (
            {"notes": [f"comment lines not carried over: {comments}"]} if comments else {}
        )

    def test_a_column_of_text_that_is_not_selected(self) -> None:
        data = b"t [s],x,phase,y\n0,1,rest,3\n0.5,2,1e,4\n1,,go,5\n"
        for select in ("y", ["y", "x"], "[xy]", ["0", "2"]):
            found = read(io.BytesIO(data), format="csv", select=select)
            assert "phase" not in [channel.label for channel in found]
            assert found["y"].stored.tolist() == [3, 4, 5]
        for select in (None, "phase", ["x", "1"]):
            with pytest.raises(ParameterError, match=r"line 2, column 3 .*'rest' is not a") as said:
                read(io.BytesIO(data), format="csv", select=select)
            assert ("leave the column out" in str(said.value)) == (select is None)

    def test_without_a_time_column(self) -> None:
        x, y = read(io.BytesIO(b"x,y\n1,2\n,\n\ninf,-0\n"), format="csv", rate="7/2").channels
        assert (x.rate_exact, x.coverage, y.coverage) == (
            Fraction(7, 2),
            (Span(0, 1), Span(2, 3)),
            (Span(0, 1), Span(2, 3)),
        )
        assert repr(y.stored.tolist()) == "[2.0, -0.0]"

    def test_an_empty_line_of_a_single_column_is_a_gap(self) -> None:
        [x] = read(io.BytesIO(b"x\n1\n\n2\n"), format="csv", rate=1).channels
        assert x.coverage == (Span(0, 1), Span(2, 3))

    def test_bytes(self) -> None:
        given = [
            Channel.from_physical(np.array([0.1, NAN, -0.0]), 1000, label="a,b", unit="Nm"),
            Channel.from_physical(np.array([1e300]), 1000, start_tick=12, label="y"),
        ]
        stream = io.BytesIO()
        save(Recording(tuple(given)), stream, format="csv")
        assert stream.getvalue() == (
            b't [s],"a,b [N.m]",y [1]\n0.000,0.1,\n0.001,,\n0.002,-0.0,\n'
            + b"".join(b"0.%03d,,\n" % tick for tick in range(3, 12))
            + b"0.012,,1e+300\n"
        )


class TestWav:
    def test_a_file_that_was_written_to_a_pipe(self) -> None:
        data = wav("PCM_16").replace(b"data\x08\0\0\0", b"data\xff\xff\xff\xff")
        [found] = read(io.BytesIO(data), format="wav").channels
        assert found.stored.tolist() == [0] * 4

    def test_a_given_rate_is_noted(self) -> None:
        recording = read(io.BytesIO(wav("PCM_24")), format="wav", rate=7999.5)
        assert recording.channels[0].rate_exact == Fraction(15_999, 2)
        [note] = recording.metadata["notes"]
        assert note == "the rate of the file, 8000 Hz, was overridden by 15999/2 Hz"


class TestNotes:
    def test_what_a_format_cannot_hold(self) -> None:
        given = Channel.from_physical(
            np.array([1.0]), 10, start_tick=3, label=" a ", unit="N", axis="x", lsb=0.1
        )
        recording = Recording((given,), epoch_ns=0, metadata={"notes": [], "source": "s", "a": 1})
        told = "epoch_ns, metadata 'source', metadata 'a'"
        expected = {
            "npz": ["not carried over to .npz: epoch_ns, metadata 'a', axis"],
            "npy": [
                "the rate, 10 Hz, is not carried over to .npy",
                "the start, tick 3, is not carried over to .npy",
                f"not carried over to .npy: {told}, label, unit, axis, lsb",
            ],
            "csv": [
                "the times are too few or too coarse to give the rate, 10 Hz, and the start, tick 3",
                "spaces around labels are not carried over to .csv",
                f"not carried over to .csv: {told}, axis, lsb",
            ],
            "wav": [
                "the start, tick 3, is not carried over to .wav",
                f"not carried over to .wav: {told}, label, unit, axis, lsb",
            ],
        }
        for suffix, notes in expected.items():
            assert list(save(recording, io.BytesIO(), format=suffix)) == notes


@pytest.mark.skipif(not RECORDINGS, reason="no recordings in ../shared/data")
class TestRealRecordings:
    @pytest.mark.parametrize(
        "path", sample(RECORDINGS, 4), ids=lambda path: f"{path.parent.name}-{path.stem}"
    )
    def test_every_npz(self, path: Path) -> None:
        recording = read(path)
        with np.load(path) as arrays:
            assert len(recording) == len(arrays["x"])
            for row, found in zip(arrays["x"], recording.channels, strict=True):
                assert np.array_equal(found.filled(0, row.size), row, equal_nan=True)
            assert [c.label for c in recording.channels] == arrays["channel_names"].tolist()
            assert float(recording.channels[0].rate_exact) == arrays["rate_hz"]
            steps = [NAN if c.lsb is None else c.lsb for c in recording.channels]
            assert np.array_equal(steps, arrays["lsb"], equal_nan=True)
            assert recording.metadata["source"] == arrays["source"]
            notes = "\n".join(recording.metadata.get("notes", []))
            assert "t" in arrays.files or "sample times" not in notes
        back = there_and_back(recording, "npz")
        assert [*map(facts, back.channels)] == [*map(facts, recording.channels)]

    @pytest.mark.parametrize("kind", ["fabricslide", "teleop1dof", "shock51k"])
    def test_through_csv(self, kind: str) -> None:
        recording = read(next(path for path in RECORDINGS if path.parent.name == kind))
        short = Recording(tuple(c.slice_ticks(0, 2000) for c in recording.channels))
        back = there_and_back(short, "csv")
        assert [*map(facts, back.channels)] == [*map(facts, short.channels)]


def test_formats() -> None:
    assert list(formats().values()) == list(OURS)
    assert issubclass(MissingExtraError, HapfmtError)


@pytest.mark.parametrize(
    ("name", "times", "cell"),
    [
        ("Zeit (s)", ["0,000", "0,001", "0,002"], "1,5"),
        ("Zeit [s]", ["0.5", "0.501", "0.502"], "1.5"),
        ("elapsed [ms]", ["0", "1", "2"], "1.5"),
        ("Takt (us)", ["0", "1000", "2000"], "1.5"),
        ("clock [ns]", ["0", "1000000", "2000000"], "1.5"),
    ],
)
def test_a_first_column_in_seconds_that_rises_is_the_time(tmp_path, name, times, cell):
    path = tmp_path / "a.csv"
    path.write_text(f"{name};fx [N]\n" + "".join(f"{t};{cell}\n" for t in times))
    found = read(path)
    assert [channel.label for channel in found.channels] == ["fx"]
    assert (
        found.channels[0].rate_exact == 1000 and found.channels[0].samples().tolist() == [1.5] * 3
    )
    assert any("taken for the time" in note for note in found.metadata["notes"])


def test_a_first_column_in_seconds_that_does_not_rise_is_a_channel(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("delay [s],fx [N]\n0.1,1\n0.2,2\n0.2,3\n")
    found = read(path, rate=1000)
    assert [channel.label for channel in found.channels] == ["delay", "fx"]
    assert found.channels[0].samples().tolist() == [0.1, 0.2, 0.2]
    with pytest.raises(ParameterError, match="no rate"):
        read(path)


def test_text_that_is_not_utf_8_names_the_cure(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes("t [s],Kraft für x [N]\n0,1\n".encode("latin-1"))
    with pytest.raises(ParameterError, match="save the table as UTF-8"):
        read(path)
