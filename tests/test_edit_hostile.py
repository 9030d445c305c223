"""Files whose checksums hold and whose contents do not: an editor refuses them, or writes a file
that is no better and no worse."""

from __future__ import annotations

import io
from collections.abc import Callable
from fractions import Fraction
from functools import cache

import forge
import pytest
from edited import made
from hypothesis import given
from hypothesis import strategies as st
from test_annotate import SCENE, annotated

import hapfmt
from hapfmt import edit
from hapfmt.format.source import BytesSource
from hapfmt.format.walk import walk

FILES = ["paper step", "perceptual", "lossless doubles", "lossless alike"]


@cache
def chunks(name: str) -> list[forge.Chunk]:
    """(type, payload, rest of the header) of all chunks."""
    data = annotated(made(name), *SCENE)
    return [
        (c.header.type, c.payload, {"file_id": c.header.file_id})
        for c in walk(BytesSource(data), [])
    ]


def subset(file: bytes, out: io.BytesIO) -> None:
    edit.subset(file, out, None, Fraction(1, 2), 2, to_zero=True)


VERBS: list[Callable[[bytes, io.BytesIO], object]] = [
    subset,
    lambda file, out: edit.subset(file, out, [0], band="lf"),
    lambda file, out: edit.concat([file, file], out, gap=1),
    lambda file, out: edit.merge([file, made("lossless")], out, times="same"),
    lambda file, out: edit.annotate(file, SCENE, out),
    lambda file, out: edit.set_metadata(file, {"a": 1}, out),
]


@given(st.sampled_from(FILES), st.data(), st.sampled_from(VERBS))
def test_one_payload_that_lies(name: str, data: st.DataObject, verb: Callable[..., object]) -> None:
    parts = list(chunks(name))
    place = data.draw(st.integers(0, len(parts) - 1))
    kind, payload, header = parts[place]
    changed = bytearray(payload)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(changed) - 1))
        changed[at] = data.draw(st.integers(0, 255) | st.just(changed[at] ^ 1))
    if data.draw(st.booleans()):
        del changed[data.draw(st.integers(0, len(changed) - 1)) :]
    parts[place] = (kind, bytes(changed), header)
    file, out = forge.file(*parts), io.BytesIO()
    try:
        verb(file, out)
    except hapfmt.HapfmtError:
        return
    assert hapfmt.verify(out.getvalue()).exit_code in (0, hapfmt.verify(file).exit_code)


@given(st.sampled_from(FILES), st.binary(max_size=40), st.data())
def test_any_damage_is_refused(name: str, junk: bytes, data: st.DataObject) -> None:
    file = made(name)
    at = data.draw(st.integers(0, len(file) - 1))
    changed = file[:at] + junk + file[at + data.draw(st.integers(0, 40)) :]
    if changed == file:
        return
    out = io.BytesIO()
    try:
        edit.subset(changed, out)
    except hapfmt.HapfmtError:
        assert out.getvalue() == b""
        return
    raise AssertionError("a damaged file was copied")


def test_an_unknown_residual_of_a_channel_that_is_not_there() -> None:
    """Its codec is not known, so nothing checked that its base exists."""
    track = forge.trak(kind=2, codec=b"KN_T", base=9, first_channel=1, first=1)
    data = forge.closed(("HEAD", forge.head()), forge.TRACK_0, ("TRAK", track), forge.DATA_0)
    for verb in (edit.concat, edit.merge):
        with pytest.raises(hapfmt.UnsupportedError, match=r"Track 1 refers to (track 9|channel 1)"):
            verb([data, data], io.BytesIO(), times="same")
