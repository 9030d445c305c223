"""Events added to a file, and what edits make of them (SPEC 9.9, docs/spec/editing.md)."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from depth import examples
from edited import (
    EPOCH_NS,
    assert_intact,
    assert_same_channel,
    by_label,
    made,
    plain,
    tracks_of,
    write,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import texts
from test_cli import run, run_json
from test_edit import merge, split_up, subset

import hapfmt
from hapfmt import Event, edit

seconds = st.builds(Fraction, st.integers(0, 4000), st.just(1000))
events = st.builds(
    Event, seconds, texts, seconds, st.sampled_from([None, 0, 1, 2, "a", "c", "1"]),
    st.sampled_from(["", "anna", "bob"]),
)  # fmt: skip


def annotated(data: bytes, *new: Event) -> bytes:
    out = io.BytesIO()
    edit.annotate(data, new, out)
    return out.getvalue()


def events_of(data: bytes) -> list[Event]:
    with hapfmt.Reader(data) as reader:
        return reader.events()


def by_number(event: Event) -> Event:
    channel = event.channel
    if isinstance(channel, str):
        channel = "abc".index(channel) if channel in "abc" else int(channel)
    return replace(event, channel=channel)


def key(event: Event) -> tuple[Any, ...]:
    return event.time, event.layer, event.text, event.duration, str(event.channel)


@settings(max_examples=examples(20))
@given(st.lists(events, min_size=1, max_size=8), st.integers(0, 8))
def test_what_was_added_is_read(new: list[Event], cut: int) -> None:
    data = made("lossless")
    first = annotated(data, *new[:cut]) if new[:cut] else data
    both = annotated(first, *new[cut:]) if new[cut:] else first
    assert both.startswith(data)
    assert_intact(both, digests=3)
    found = events_of(both)
    assert [event.time for event in found] == sorted(event.time for event in new)
    assert sorted(map(key, found)) == sorted(key(by_number(event)) for event in new)
    for mine, theirs in zip(hapfmt.read(both).channels, hapfmt.read(data).channels, strict=True):
        assert_same_channel(mine, theirs)
    layers = [t for t in tracks_of(both).values() if t.kind == "events"]
    assert len(layers) == len({event.layer for event in new})


def test_times_between_the_ticks_of_a_layer() -> None:
    data = annotated(made("lossless"), Event(Fraction(1)))
    out = io.BytesIO()
    notes = edit.annotate(data, [Event(Fraction(1, 3), "third"), Event(Fraction(2))], out)
    assert notes == ["1 event of layer '' moved to the nearest of its 1000000 ticks a second"]
    assert [e.time for e in events_of(out.getvalue())] == [Fraction(333333, 10**6), 1, 2]
    third = annotated(made("lossless"), Event(Fraction(1, 3)))
    assert [e.time for e in events_of(third)] == [Fraction(1, 3)]


def test_wrong_events_leave_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "a.hapf"
    path.write_bytes(made("lossless"))
    for wrong, message in [
        ([], "nothing to annotate"),
        ([Event(Fraction(1), channel="d")], "channel 'd', which does not exist"),
        ([Event(Fraction(1)), Event(Fraction(1), channel=3)], "channel 3 of 3"),
        ([Event(Fraction(10**9 * 10**6))], "ends after the last possible tick"),
    ]:
        with pytest.raises(hapfmt.ParameterError, match=message):
            edit.annotate(path, wrong)
        assert path.read_bytes() == made("lossless")


SCENE = [
    Event(Fraction(1, 2), "all"),
    Event(Fraction(1), "of b", Fraction(1, 4), 1),
    Event(Fraction(2), "of c", channel=2, layer="anna"),
]


def test_events_follow_their_channels() -> None:
    data = annotated(made("paper step"), *SCENE)
    whole, edited = subset(data)
    assert events_of(whole) == SCENE and edited.notes == []
    assert by_label(whole) == by_label(data)
    part, edited = subset(data, ["c"])
    assert events_of(part) == [SCENE[0], replace(SCENE[2], channel=0)]
    assert edited.notes == ["1 event left out: of channels that are left out"]
    part, edited = subset(data, ["a", "b"], band="lf")
    assert events_of(part) == SCENE[:2]
    other = annotated(made("paper step", 1, uuid=None), *SCENE)
    both, _ = merge([data, other], offsets={1: 1})
    moved = [
        replace(e, time=e.time + 1, channel=None if e.channel is None else e.channel + 3)
        for e in SCENE
    ]
    assert sorted(map(key, events_of(both))) == sorted(map(key, SCENE + moved))
    for file in (whole, part, both):
        assert_intact(file)


def test_events_in_parts_and_together_again() -> None:
    data = annotated(made("lossless"), *SCENE)
    parts = split_up(data, every=1)
    out = io.BytesIO()
    edit.concat(parts, out)
    assert events_of(out.getvalue()) == SCENE
    assert by_label(out.getvalue()) == by_label(data)
    moved = split_up(data, every=1, to_zero=True)
    # The first two stand in one packet.
    assert [[e.time for e in events_of(part)] for part in moved] == [
        [Fraction(1, 2), 1],
        [],
        [0],
        [],
    ]
    later = annotated(made("lossless", 1, uuid=None, epoch_ns=EPOCH_NS), *SCENE)
    edit.concat([data, later], out := io.BytesIO())
    assert len(events_of(out.getvalue())) == 6
    assert len([t for t in tracks_of(out.getvalue()).values() if t.kind == "events"]) == 2
    assert_intact(out.getvalue())


def test_of_recordings_that_had_events(tmp_path: Path) -> None:
    path = tmp_path / "a.hapf"
    path.write_bytes(write(replace(plain(0), events=tuple(SCENE)), preset="lossless"))
    edit.annotate(path, [Event(Fraction(3, 2), "later", layer="anna")])
    assert [event.text for event in events_of(path.read_bytes())] == [
        "all",
        "of b",
        "later",
        "of c",
    ]
    assert_intact(path.read_bytes())


def test_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "a.hapf").write_bytes(made("lossless"))
    done = run("annotate", "a.hapf", "--at", "1.25", "first contact", cwd=tmp_path)
    assert done.stdout == b"a.hapf: 1 event added\n", done.stderr
    done = run("annotate", "a.hapf", "--at", "2", "--duration", "0.5", "--channel", "b", "--layer",
               "anna", "slip", cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0
    (tmp_path / "e.csv").write_text("Onset;duration;trial_type;channel\n0,5;;x;\n")
    done = run("annotate", "a.hapf", "--table", "e.csv", cwd=tmp_path)
    assert done.returncode == 1 and b"line 2: '0,5' is not a number" in done.stderr
    (tmp_path / "e.csv").write_text("Onset,duration,trial_type,channel\n0.5,,x,\n0.75,1e-1,y,2\n")
    assert run("annotate", "a.hapf", "--table", "e.csv", cwd=tmp_path).returncode == 0
    (tmp_path / "odd.csv").write_text("onset,text,HED,response\n9,odd,a,b\n")
    done = run("annotate", "a.hapf", "--table", "odd.csv", "-o", "odd.hapf", cwd=tmp_path)
    assert b"odd.csv: left out, as events have no such columns: hed, response" in done.stderr
    lines = b'{"time": 3, "text": "z", "layer": "bob"}\n\n{"time": 0.1, "channel": "a"}\n'
    done = run("annotate", "a.hapf", "--table", "-", stdin=lines, cwd=tmp_path)
    assert done.stdout == b"a.hapf: 2 events added\n"
    code, told = run_json("annotate", "a.hapf", "--list", cwd=tmp_path)
    assert code == 0 and [(e["time"], e["text"], e["channel"]) for e in told["events"]] == [
        (0.1, "", 0), (0.5, "x", None), (0.75, "y", 2), (1.25, "first contact", None),
        (2.0, "slip", 1), (3.0, "z", None),
    ]  # fmt: skip
    shown = run("annotate", "a.hapf", "--list", "--layer", "anna", cwd=tmp_path).stdout.decode()
    assert "slip" in shown and "contact" not in shown
    assert_intact((tmp_path / "a.hapf").read_bytes())
    before = (tmp_path / "a.hapf").read_bytes()
    copied = run("annotate", "-", "--at", "0", "zero", "-o", "-", stdin=before, cwd=tmp_path)
    assert copied.stdout.startswith(before) and events_of(copied.stdout)[0].text == "zero"
    (tmp_path / "bad").write_bytes(b"\xff")
    for name, text in [("none", "a,b\n1,2\n"), ("list", "{}\n[]\n"), ("json", "{oops\n")]:
        (tmp_path / name).write_text(text)
    wrong: list[list[str]] = [
        ["--at", "1"], ["text"], [], ["--at", "1", "x", "--table", "e.csv"], ["--table", "bad"],
        ["--table", "none"], ["--table", "list"], ["--table", "json"], ["--table", "missing"],
        ["--at", "-1", "x"], ["--at", "1", "x", "--channel", "q"],
    ]  # fmt: skip
    for arguments in wrong:
        done = run("annotate", "a.hapf", *arguments, cwd=tmp_path)
        assert done.returncode == 1 and b"Traceback" not in done.stderr
    assert (tmp_path / "a.hapf").read_bytes() == before
    assert json.loads(run("annotate", "a.hapf", "--at", "1", "x", "--json", cwd=tmp_path).stdout)


def test_an_event_after_the_end_is_noted(tmp_path: Path) -> None:
    file = tmp_path / "a.hapf"
    file.write_bytes(made("lossless"))
    end = hapfmt.read(file).duration
    assert edit.annotate(file, [Event(end, "at the end")]) == []
    (note,) = edit.annotate(file, [Event(Fraction(0), "begin"), Event(end + 1, "late")])
    assert note == f"1 of 2 events begin after the end of the recording ({float(end):g} s)"
