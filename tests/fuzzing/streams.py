"""Streams of a recorder: whatever is said, the file is whole, and what is wrong is one of our
errors. The first byte is the size of the pieces that the stream comes in."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable
from fractions import Fraction

import numpy as np

from hapfmt.reading.verifier import verify
from hapfmt.writing.recorder import Recorder
from hapfmt.writing.streams import (
    OBJECT,
    ROWS,
    SAMPLES,
    BareTable,
    Header,
    InputStream,
    build_frame,
)

from .appended import codes_of
from .files import LIMITS
from .target import Target, settled

TABLE = BareTable(Fraction(1000), lsb=0.5)


def stream(data: bytes) -> None:
    out = io.BytesIO()

    def begin(header: Header) -> Recorder:
        given = {"epoch_ns": None, **header.given}
        return Recorder(out, header.inputs, metadata=header.metadata, canonical=1, **given)

    size = 1 + (data[0] if data else 0)
    told = InputStream(begin, TABLE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        for at in range(1, len(data), size):
            if settled(lambda at=at: [told.feed(data[at : at + size])]) is None:
                break
        else:
            settled(told.finish)
        if told.recorder is None:
            return
        closed = settled(lambda: [told.recorder.close()])
    report = verify(out.getvalue(), limits=LIMITS)
    # Values that no lattice holds may be found as late as that.
    assert codes_of(report) <= (set() if closed else {"not-closed"})
    assert report.error is None or report.exit_code == 4, report


HEADER = b'{"channels":[{"label":"a","rate":1000,"lsb":0.5},{"label":"b","rate":"30000/1001"}]}'


def of_stream() -> Iterable[bytes]:
    yield b"\xff" + b"1,2,3\n4,5.5,\n@9 -1,nan,2e3\n"
    yield b"\x07" + b"force [N];x\n0;1\n\n# no\n2;3"
    yield b"\xff" + b"\n".join(
        [
            HEADER,
            b'{"values":[1,null,3],"channel":"a"}',
            b'{"values":[0.1],"channel":1,"tick":9}',
            b'{"mark":"go","time":0.001,"duration":0.5,"channel":"a"}',
            b'{"skip":5,"channel":"a"}',
            b'{"clock":"pc","time_ns":5,"tick":1,"channel":"a","uncertainty_ns":3}',
            b'{"add":{"label":"c","rate":10,"bits":8,"calibration":[1,0,10]}}',
            b'{"metadata":{"x":1}}',
            b'{"flush":true}',
            b"@30 1,2,3",
        ]
    )
    rows = np.arange(6, dtype="<f8").tobytes()
    yield (
        b"\x0f"
        + build_frame(OBJECT, HEADER)
        + build_frame(ROWS, rows, number_format=4, count=3)
        + build_frame(SAMPLES, rows[:8], number_format=4, count=1, channel=1, tick=9)
    )


STREAMS = [Target("stream", stream, of_stream, size=700)]
