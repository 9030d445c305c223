"""Streams for `hapfmt record`: docs/streams.md, and what breaks it."""

from __future__ import annotations

import io
import json
import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

import hapfmt
from hapfmt import Calibration, Input, Recorder, Span
from hapfmt.errors import ParameterError
from hapfmt.writing.streams import (
    HEADER,
    LINE_SIZE,
    OBJECT,
    PAYLOAD_SIZE,
    ROWS,
    SAMPLES,
    BareTable,
    InputStream,
    build_frame,
)

PAGE = (ROOT / "docs" / "streams.md").read_text("utf-8")


def examples(kind: str) -> list[bytes]:
    return [body.encode() for body in re.findall(rf"```{kind}\n(.*?)```", PAGE, re.S)]


def recorded(
    data: bytes,
    table: BareTable | None = None,
    pieces: list[int] | None = None,
    on_bad_line: str | None = None,
    **options,
):
    """The recording of a stream that comes in pieces, and the error that ended it."""
    out = io.BytesIO()

    def begin(header):
        given_ = {**header.given, **options}
        return Recorder(out, header.inputs, metadata=header.metadata, canonical=1, **given_)

    stream = InputStream(begin, table, on_bad_line)
    error = None
    try:
        at = 0
        for size in pieces or [len(data)]:
            stream.feed(data[at : at + size])
            at += size
        stream.feed(data[at:])
        stream.finish()
    except ParameterError as found:
        error = found
    if stream.recorder is None:
        return None, error
    stream.close()
    assert hapfmt.verify(out.getvalue()).verdict == "intact"
    return hapfmt.read(out.getvalue()), error


def test_the_header_and_rows_of_the_page():
    back, error = recorded(examples("lines")[0])
    assert error is None
    force, position = back.channels
    assert (force.label, force.rate, force.unit) == ("force", 1000, "N")
    assert force.calibration == Calibration(1, 0, 4000)
    assert force.stored.tolist() == [-3, -1, 8, 9]
    assert force.coverage == (Span(0, 2), Span(1000, 1002))
    assert position.samples().tolist() == [12.25, 12.251, 12.252, 12.5]
    assert position.coverage == (Span(0, 3), Span(1000, 1001))
    assert back.metadata["subject"] == "S7"


def test_the_actions_of_the_page():
    back, error = recorded(examples("lines")[1])
    assert error is None
    force, grip, late = back.channels
    assert force.stored.tolist() == [1, 2, 4, 5]
    assert force.coverage == (Span(0, 2), Span(3, 4), Span(10, 11))
    assert grip.rate_exact == Fraction(44100, 7) and grip.samples().tolist() == [0.5, 0.25]
    assert (late.unit, late.coverage) == ("Cel", (Span(2, 3),))
    assert back.metadata["trial"] == 4


def test_every_action_of_the_table_is_taken():
    for line in re.findall(r"^\| `(\{.*?\})` \|", PAGE, re.M):
        header = {"channels": [{"label": "force", "rate": 1000, "calibration": [1, 0, 1]}]}
        assert recorded(f"{json.dumps(header)}\n{line}\n".encode())[1] is None, line


def test_the_table_of_the_page():
    back, error = recorded(examples("table")[0], BareTable(Fraction(1000)))
    assert error is None
    assert [(c.label, c.unit) for c in back.channels] == [("force", "N"), ("position", "mm")]
    assert back.channels[1].samples().tolist() == [12.25, 12.251]


def test_the_frames_of_the_page():
    names: dict[str, bytes] = {}
    exec(examples("python")[0].decode(), names)
    back, error = recorded(names["stream"])
    assert error is None
    assert back.channels[0].stored.tolist() == [1, 2, 3, 4, 5]
    assert back.channels[1].samples().tolist() == [0.5, 0.25, 0.125, 0.0625]


@given(st.data())
def test_pieces_of_any_size_are_the_same_stream(data):
    names: dict[str, bytes] = {}
    exec(examples("python")[0].decode(), names)
    stream = data.draw(st.sampled_from([*examples("lines"), names["stream"]]))
    pieces = data.draw(st.lists(st.integers(1, 60), max_size=30))
    whole, cut = recorded(stream)[0], recorded(stream, pieces=pieces)[0]
    for a, b in zip(whole.channels, cut.channels, strict=True):
        assert a.coverage == b.coverage and a.samples().tobytes() == b.samples().tobytes()


@given(
    st.integers(1, 4),
    st.lists(st.lists(st.none() | st.integers(-999, 999), min_size=4, max_size=4), max_size=50),
    st.sampled_from([",", ";", "\t"]),
)
def test_rows_come_back(width, rows, separator):
    text = "".join(
        separator.join("" if x is None else str(x) for x in row[:width]) + "\r\n"
        for row in rows
        if width > 1 or row[0] is not None
    )
    kept = [row[:width] for row in rows if width > 1 or row[0] is not None]
    channels = [
        {"label": str(n), "rate": 10, **({"calibration": [1, 0, 1]} if n % 2 else {})}
        for n in range(width)
    ]
    back, error = recorded(json.dumps({"channels": channels}).encode() + b"\n" + text.encode())
    assert error is None
    for place, channel in enumerate(back.channels):
        dense = channel.filled(0, len(kept))
        wanted = [np.nan if row[place] is None else row[place] for row in kept]
        assert np.array_equal(dense, np.array(wanted, float), equal_nan=True)


HEAD = b'{"channels": [{"label": "a", "rate": 10, "calibration": [1,0,1]}, {"label": "b", "rate": 10}]}\n'


@pytest.mark.parametrize(
    ("lines", "place", "message"),
    [
        (b"1,2\n3\n", 3, "1 values for 2 channels"),
        (b"1,2\n3,4,5\n6,7\n", 3, "3 values for 2"),
        (b"1,2\nx,3\n", 3, "'x' is not a number"),
        (b"1,2\n\n# c\n1.5,3\n", 5, "1.5 is not an integer count"),
        (b"1,2\n8388608,3\n", 3, "need more than its 24 bits"),
        (b"1,2\n1e300,3\n", 3, "beyond 2^53"),
        (b"1,2\n@0 3,4\n", 3, "ticks never go back"),
        (b"1,2\n@x 3,4\n", 3, "followed by a tick"),
        (b"1,2\n@7\n", 3, "followed by a tick"),
        (b"1,2\n{]\n", 3, "not JSON"),
        (b'1,2\n{"a": NaN, "b"\n', 3, "not JSON"),
        (b"1,2\n" + HEAD, 3, "only one header"),
        (b'1,2\n{"what": 1}\n', 3, "has none of values, mark, clock, add, skip, flush, metadata"),
        (b'1,2\n{"values": [1]}\n', 3, "channel: is missing; add a whole number or a text"),
        (b'1,2\n{"values": 1, "channel": 0}\n', 3, "values: is a number; write a list"),
        (b'1,2\n{"values": ["x"], "channel": 0}\n', 3, "values[0]: is a text; write a number"),
        (b'1,2\n{"values": [1], "channel": "c"}\n', 3, "no channel 'c'"),
        (
            b'1,2\n{"values": [1], "channel": 0, "tick": 1.5}\n',
            3,
            "tick: 1.5 cannot be used; write a whole",
        ),
        (
            b'1,2\n{"values": [1], "channel": 0, "x": 1}\n',
            3,
            "x: is not a known key; known: values",
        ),
        (b'1,2\n{"skip": -1, "channel": "a"}\n', 3, "a gap of -1"),
        (b'1,2\n{"add": {"label": "c"}}\n', 3, "add.rate: is missing; add the ticks"),
        (b'1,2\n{"add": {"label": "c", "rate": 0}}\n', 3, "positive"),
        (b'1,2\n{"add": {"label": 3, "rate": 1}}\n', 3, "add.label: is a number; write a text"),
        (b'1,2\n{"add": {"label": "c", "rate": 1, "calibration": [1]}}\n', 3, None),
        (
            b'1,2\n{"add": {"label": "c", "rate": 1, "calibration": 5}}\n',
            3,
            "write a list of 1 to 3",
        ),
        (b'1,2\n{"add": {"label": "c", "rate": 1, "bits": "x"}}\n', 3, "bits"),
        (b'1,2\n{"add": {"label": "c", "rate": 1, "lsb": "x"}}\n', 3, "add.lsb: is a text"),
        (
            b'1,2\n{"add": {"label": "c", "rate": 1, "colour": 1}}\n',
            3,
            "add.colour: is not a known key",
        ),
        (b'1,2\n{"metadata": 4}\n', 3, "metadata: is a number"),
        (b"1,2\n" + b"9" * (LINE_SIZE + 2), 3, "a line of more than"),
    ],
)
def test_a_bad_line_is_named_and_what_came_before_is_kept(lines, place, message):
    back, error = recorded(HEAD + lines)
    if message is None:
        assert error is None
        return
    assert str(error).startswith(f"line {place}: ") and message in str(error)
    assert back.channels[0].stored.tolist() == [1] and back.channels[1].samples().tolist() == [2.0]


@pytest.mark.parametrize(
    ("data", "table", "message"),
    [
        (b"", None, "ended before any channel"),
        (b"# nothing\n", None, "ended before any channel"),
        (b"1,2\n", None, "line 1: a table needs its rate"),
        (b"1,2\n", BareTable(Fraction(1), ("a",)), "line 1: 1 labels for 2 columns"),
        (b'{"channels": []}\n', None, "line 1: channels: has 0 values"),
        (b'{"channels": [3]}\n', None, "line 1: channels[0]: is a number; write"),
        (
            b'{"channels": [{"label":"a","rate":1}], "x": 1}\n',
            None,
            "line 1: x: is not a known key",
        ),
        (b'{"channels": [{"label":"a","rate":"x"}]}\n', None, "line 1: 'x' is not a number"),
        (b'{"channels": [{"label":"a","rate":1}], "metadata": 1}\n', None, "metadata: is a number"),
        (b'{"mark": "x"}\n', None, "line 1: mark: is not a known key; known: channels"),
        (b"hFr1" + bytes(20), None, "byte 0: this is not JSON"),
        (
            build_frame(SAMPLES, b"ab", number_format=1, count=1),
            None,
            "does not begin with a header",
        ),
    ],
)
def test_a_stream_without_a_good_header_writes_nothing(data, table, message):
    back, error = recorded(data, table)
    assert back is None and message in str(error)


FRAMES = build_frame(OBJECT, HEAD) + build_frame(ROWS, bytes(16), number_format=4, count=1)


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (b"hFr2" + bytes(20), "no frame begins here"),
        (HEADER.pack(b"hFr1", 1, 1, 0, -1, 0, PAYLOAD_SIZE + 1), "a frame of 67108865 bytes"),
        (build_frame(3, b""), "type 3"),
        (build_frame(SAMPLES, b"", number_format=9), "number format 9"),
        (build_frame(SAMPLES, b"", number_format=1, tick=-2), "tick -2"),
        (build_frame(SAMPLES, b"abc", number_format=1, count=1), "3 bytes are not 1 times 1"),
        (build_frame(ROWS, b"abcd", number_format=1, count=2), "4 bytes are not 2 times 2"),
        (build_frame(SAMPLES, b"ab", number_format=1, count=1, channel=7), "no channel 7"),
        (build_frame(OBJECT, b"\xff"), "not JSON"),
        (build_frame(SAMPLES, b"ab", number_format=1, count=1, tick=0), "ticks never go back"),
        (FRAMES[:30], "only one header"),
        (build_frame(SAMPLES, b"ab", number_format=1, count=1)[:-1], "25 bytes into it"),
    ],
)
def test_a_bad_frame_is_named_and_what_came_before_is_kept(frame, message):
    if message == "only one header":
        frame = build_frame(OBJECT, HEAD)
    back, error = recorded(FRAMES + frame)
    assert str(error).startswith(f"byte {len(FRAMES)}: ") and message in str(error)
    assert back.channels[0].stored.tolist() == [0] and back.channels[1].samples().tolist() == [0.0]


@given(st.binary(max_size=300), st.sampled_from([b"", b"hFr1", HEAD, FRAMES, HEAD + b"1,2\n"]))
def test_any_bytes_give_a_recording_or_an_error(data, begin):
    recorded(begin + data, BareTable(Fraction(10)))


JUNK = st.sampled_from(
    [None, True, -1, 0, 10**30, 1.5, float("nan"), "", "a", "\ud800", [], [1], [None, "x"], {}]
)
OBJECTS = [json.loads(line) for text in examples("lines") for line in text.split(b"\n")
           if line.startswith(b"{")]  # fmt: skip


@given(st.sampled_from(OBJECTS), st.data())
def test_any_value_under_any_key_gives_a_recording_or_an_error(given, data):
    key = data.draw(st.sampled_from([*given, "channel", "tick", "x"]))
    changed = {**given, key: data.draw(JUNK)}
    if "channels" in given and data.draw(st.booleans()):
        channel = given["channels"][0]
        key = data.draw(st.sampled_from([*channel, "lsb", "bits", "calibration"]))
        changed = {**given, "channels": [{**channel, key: data.draw(JUNK)}]}
    lines = [json.dumps(changed).encode(), b""]
    recorded(b"\n".join(lines if "channels" in given else [HEAD.strip(), b"1,2", *lines]))


def test_rows_for_channels_of_two_rates_are_refused():
    head = b'{"channels": [{"label": "a", "rate": 10}, {"label": "b", "rate": 20}]}\n'
    assert "channels of one rate" in str(recorded(head + b"1,2\n")[1])


def test_rows_go_on_after_skip_and_counts_have_gaps():
    back, error = recorded(HEAD + b'1,2\n,3\n{"skip": 3}\n4,\n5,6\n')
    assert error is None
    assert back.channels[0].coverage == (Span(0, 1), Span(5, 7))
    assert back.channels[1].coverage == (Span(0, 2), Span(6, 7))


def test_an_input_of_a_table_may_have_a_lattice():
    back, _ = recorded(b"0.1\n0.30000001\n", BareTable(Fraction(10), lsb=0.1, unit="V"))
    assert back.channels[0].calibration == Calibration(1, 0, 10)
    assert (back.channels[0].label, back.channels[0].unit) == ("1", "V")
    assert Input("1", 10, "V", lsb=0.1).lsb == 0.1


HUGE = {
    "row": (b"1,2\n3,1e999\n4,5\n", "line 2: '1e999' is beyond the range of a double", 1),
    "negative": (b"1,2\n-1E400,3\n", "line 2: '-1E400' is beyond the range of a double", 1),
    "first": (b"1e999,2\n", "line 1: '1e999' is beyond the range of a double", None),
    "value": (
        b'{"channels": [{"label": "a", "rate": 10}]}\n1\n{"channel": "a", "values": [2, 1e999]}\n',
        "line 3: '1e999' is beyond the range of a double",
        1,
    ),
}


@pytest.mark.parametrize("name", HUGE)
def test_numbers_beyond_a_double_are_refused(name):
    """As encode does; what was recorded before stays."""
    data, message, kept = HUGE[name]
    back, error = recorded(data, BareTable(Fraction(10)))
    assert str(error).startswith(message)
    assert (back is None) == (kept is None)
    if back is not None:
        assert {channel.stored.size for channel in back.channels} == {kept}


NO_NUMBERS = ["1_000", "1e-400", "-0.00001e-9999", "0x1F", "\u0661\u0662", "1e5_0", "\uff11"]
"""What float() takes, or makes 0, and what other programs write."""


@pytest.mark.parametrize("text", NO_NUMBERS)
def test_only_plain_numbers_are_numbers(text):
    """In any row of a stream, and in a table that encode reads."""
    for rows, line in ((f"{text},2\n3,4\n", 1), (f"1,2\n3,{text}\n5,6\n", 2)):
        _, error = recorded(rows.encode(), BareTable(Fraction(10)))
        assert str(error).startswith(f"line {line}: {text[:40]!r} is ")
        with pytest.raises(ParameterError, match=f"line {line + 1}, .*{text!r} is "):
            hapfmt.read(io.BytesIO(f"a,b\n{rows}".encode()), format=".csv", rate=10)
    _, error = recorded(b"1,2\n0,-0.0e5\n+1.e3,.5E-3\n5e-324,NaN\n", BareTable(Fraction(10)))
    assert error is None


bad_lines = st.binary(min_size=1, max_size=12).filter(
    lambda line: b"\n" not in line and not line.startswith((b"{", b"#", b"@")) and line.strip()
)
good_lines = st.tuples(st.integers(-9, 9), st.floats(-9, 9))


@given(st.lists(good_lines | bad_lines, min_size=1, max_size=30), st.integers(1, 9))
def test_a_bad_line_is_a_gap_of_one_row_and_the_others_keep_their_place(lines, size):
    """Whatever it holds, and however the bytes arrive; lines that happen to be rows may be used."""
    table = BareTable(Fraction(10), ("a", "b"))
    data = b"0,0\n" + b"".join(
        (b"%d,%r\n" % line if isinstance(line, tuple) else line + b"\n") for line in lines
    )
    back, error = recorded(data, table, [size] * (len(data) // size), "gap", epoch_ns=None)
    assert error is None
    a, b = (channel.filled(0, len(lines) + 1) for channel in back.channels)
    assert (a[0], b[0]) == (0, 0)
    for place, line in enumerate(lines, 1):
        if isinstance(line, tuple):
            assert (a[place], b[place]) == line
        elif line.count(b",") != 1 or not set(line) & set(b"0123456789aA"):
            assert np.isnan(a[place]) and np.isnan(b[place])


@pytest.mark.parametrize(
    ("lines", "left_out", "kept"),
    [
        (b"3\n", 1, [(0, 1), (2, 3)]),
        (b"1,2,3\n4\n", 2, [(0, 1), (3, 4)]),
        (b"1.5,3\n", 1, [(0, 1), (2, 3)]),
        (b"8388608,3\n", 1, [(0, 1), (2, 3)]),
        (b"4,1e300\n", 1, [(0, 1), (2, 3)]),
        (b"4,5\n,1e300\n1e300,5\n", 2, [(0, 2), (4, 5)]),
        (b"@0 3,4\n@x 3,4\n@9\n", 3, [(0, 2)]),
        (b'{]\n{"what": 1}\n{"mark": 3}\n', 3, [(0, 2)]),
    ],
)
def test_what_a_gap_is(lines, left_out, kept):
    head = HEAD.replace(b'"rate": 10}]', b'"rate": 10, "lsb": 0.5}]')
    assert head != HEAD
    out = io.BytesIO()
    stream = InputStream(lambda header: Recorder(out, header.inputs, canonical=1), None, "gap")
    stream.feed(head + b"1,2\n" + lines + b"7,8\n")
    stream.finish()
    stream.close()
    back = hapfmt.read(out.getvalue())
    assert stream.bad_lines[0] == left_out and stream.bad_lines[1].startswith("line ")
    assert [(s.start, s.stop) for s in back.channels[1].coverage] == kept
    assert back.channels[0].stored.tolist()[-1] == 7


def test_what_comes_before_the_first_whole_line_is_left_out():
    """A program that is joined amid a line sends its rest first."""
    table = BareTable(Fraction(10), ("a", "b", "c"))
    for first in (b"25,3\n", b".5,x2,7\n", b"1,1e999,2\n", b"\x00\xff\n"):
        out = io.BytesIO()
        stream = InputStream(
            lambda header, out=out: Recorder(out, header.inputs, canonical=1), table, "gap"
        )
        stream.feed(first + b"1,2,3\n4,5,6\n")
        stream.finish()
        stream.close()
        assert stream.bad_lines[0] == 1
        assert hapfmt.read(out.getvalue()).channels[2].samples().tolist() == [3, 6]


def test_infinity_is_a_value():
    back, error = recorded(b"1,inf\n-Infinity,3\n", BareTable(Fraction(10)))
    assert error is None
    assert [channel.samples().tolist() for channel in back.channels] == [
        [1, -np.inf],
        [np.inf, 3],
    ]
