"""docs/spec/recovery.md: what ``recover`` writes."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
from pathlib import Path

import forge as f
import numpy as np
import pytest
import strategies
from edited import described
from hypothesis import assume, given
from hypothesis import strategies as st
from judge import samples
from suite import PROGRAMS
from test_walk import damaged

import hapfmt
from hapfmt.edit.recover import Recovery
from hapfmt.errors import FormatError, HapfmtError, ParameterError, UnsupportedError
from hapfmt.format.source import BytesSource
from hapfmt.format.walk import read_chunk
from hapfmt.reading.opening import from_walk
from hapfmt.reading.verifier import verify

LF = f.trak(kind=1, codec=b"KNOT")
HF = f.trak(kind=2, base=0, codec=b"KNOT", first=1)


def recovered(data: bytes, file_id: int = 99) -> tuple[bytes, Recovery]:
    out = io.BytesIO()
    done = hapfmt.recover(data, out, canonical=file_id)
    return out.getvalue(), done


def packets(data: bytes) -> list[tuple[int, int, int, bytes]]:
    with hapfmt.Reader(data, scan=True) as reader:
        everything = dict.fromkeys(reader.catalogue.tracks, (0, 1 << 62))
        return [(p.track, p.start, p.span, p.data) for p in reader.packets(everything)]


def chunks(data: bytes) -> list[tuple[str, bytes]]:
    """(type, payload) of all chunks, in order."""
    catalogue = from_walk(BytesSource(data))
    found = (read_chunk(catalogue.source, ref.offset) for ref in catalogue.chunks)
    return [(chunk.header.type, chunk.payload) for chunk in found if chunk]


def flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


def payload_of(data: bytes, type_: str, number: int = 0) -> int:
    """Offset of a payload."""
    refs = [ref for ref in from_walk(BytesSource(data)).chunks if ref.type == type_]
    return refs[number].offset + f.HEADER


def test_an_intact_file_comes_back_the_same():
    x = np.cumsum(np.arange(200) % 7 - 3)
    channel = hapfmt.Channel(x, 1000, calibration=hapfmt.Calibration(1, 0, 10), label="f")
    recording = hapfmt.Recording(
        (channel,), epoch_ns=5, metadata={"who": "me"}, attachments={"a": ("text/plain", b"b")}
    )
    out = io.BytesIO()
    hapfmt.write(
        recording, out, hapfmt.Settings.of("paper", digest=True, smallest=False), canonical=3
    )
    data, done = recovered(out.getvalue())
    assert (done.exit_code, done.findings, done.lost) == (0, [], [])
    assert (done.packets, done.digests) == (len(packets(data)), 2)
    assert packets(data) == packets(out.getvalue())
    anew = ("HEAD", "iNDX", "fOOT")
    same, _ = recovered(out.getvalue(), 3)
    assert sorted(c for c in chunks(same) if c[0] not in anew) == sorted(
        c for c in chunks(out.getvalue()) if c[0] not in anew
    )
    assert verify(data).verdict == "intact"
    back = hapfmt.read(data)
    assert (back.epoch_ns, back.uuid) == (5, hapfmt.read(out.getvalue()).uuid)
    assert recovered(out.getvalue(), 3)[0] == out.getvalue()


@strategies.idle_settings
@given(
    strategies.recordings(),
    strategies.encoder_settings(),
    st.sampled_from(["full", "lf"]),
    st.data(),
)
def test_any_damage_of_any_file(recording, settings, band, data):
    """
    REC-006: A recovered file MUST contain exactly the packets that a reader delivers through damage and that decode, exact values too. Track id, start, span and bytes stay the same.
    DEC-003: The full band of a channel with an HF track MUST be delivered only for ticks that both tracks cover; the others are gaps. For an LF track whose HF track is not known it is empty. Gaps are not filled with values. Where an output cannot leave them out, it marks them by NaN or a mask.
    """
    out = io.BytesIO()
    hapfmt.write(recording, out, settings, canonical=f.FILE_ID)
    bad = data.draw(damaged(out.getvalue()))
    assume(bad != out.getvalue())
    try:
        good, done = recovered(bad)
    except FormatError:
        assert not samples(bad)
        return
    assert done.exit_code in (0, 3)
    assert verify(good).verdict == "intact"
    assert samples(good, band=band) == samples(bad, band=band)
    if not done.exit_code and "not-closed" not in [finding.code for finding in done.findings]:
        assert samples(good) == samples(out.getvalue())


def test_packets_are_copied_and_no_others():
    """
    REC-006: A recovered file MUST contain exactly the packets that a reader delivers through damage and that decode, exact values too. Track id, start, span and bytes stay the same.
    """
    rows = [(0, 4 * i, 4, f.svarint(i)) for i in range(5)]
    data = f.closed(
        ("HEAD", f.head()), f.TRACK_0, *[("DATA", f.cluster(row)) for row in rows],
        duration_ns=20_000_000,
    )  # fmt: skip
    bad = flipped(data, payload_of(data, "DATA", 2) + 9)
    good, done = recovered(bad)
    assert packets(good) == [row for row in rows if row[1] != 8]
    assert (done.packets, done.samples, done.exit_code) == (4, 16, 3)
    assert done.lost == [(("channel 0",), 0.008, 0.012)]
    assert {tick for _, tick in samples(good)} == set(range(20)) - {8, 9, 10, 11}


def test_a_packet_that_does_not_decode_is_left_out():
    """
    REC-006: A recovered file MUST contain exactly the packets that a reader delivers through damage and that decode, exact values too. Track id, start, span and bytes stay the same.
    """
    late = ("DATA", f.cluster((0, 4, 4, b"\x80")))
    data = f.closed(("HEAD", f.head()), f.TRACK_0, f.DATA_0, late, duration_ns=8_000_000)
    assert verify(data).verdict == "nonconforming"
    good, done = recovered(data)
    assert (done.exit_code, done.lost) == (3, [(("channel 0",), 0.004, 0.008)])
    assert verify(good).verdict == "intact"
    assert samples(good) == samples(f.minimal())


@pytest.mark.parametrize("payload", [f.trak(b""), f.trak(f.tlv(1, b"\2\1"))])
def test_a_track_whose_parameters_are_wrong_is_left_out(payload):
    """
    REC-007: A recovered file MUST describe every track of which an intact description was found. Its bytes stay the same unless the track that it continues is lost. HF tracks whose base is lost and tracks whose codec parameters break a rule are left out. Tracks without packets are added: an HF track for each LF track without one, and tracks with the label `(lost)`. The latter have the missing channel numbers below the highest one, and those that events name.
    """
    second = f.trak(first_channel=1, first=1)
    data = f.closed(
        ("HEAD", f.head()), ("TRAK", payload), ("TRAK", second),
        ("DATA", f.cluster((0, 0, 4, f.KNOT_DATA), (1, 0, 4, f.KNOT_DATA))),
    )  # fmt: skip
    good, done = recovered(data)
    assert done.exit_code == 3
    assert verify(good).verdict == "intact"
    assert {channel for channel, _ in samples(good)} == {1}
    assert any(payload.startswith(second) for payload in described(good))


def test_descriptions_are_copied():
    """
    REC-007: A recovered file MUST describe every track of which an intact description was found. Its bytes stay the same unless the track that it continues is lost. HF tracks whose base is lost and tracks whose codec parameters break a rule are left out. Tracks without packets are added: an HF track for each LF track without one, and tracks with the label `(lost)`. The latter have the missing channel numbers below the highest one, and those that events name.
    """
    tlvs = f.HOLD + f.tlv(2, f.strings("f")) + f.tlv(0x4000, b"unknown, ancillary")
    data = f.closed(("HEAD", f.head()), ("TRAK", f.trak(tlvs)), f.DATA_0)
    good, _ = recovered(data + b"\0")
    assert described(good) == [f.trak(tlvs)]


class TestLostDescriptions:
    """
    REC-007: A recovered file MUST describe every track of which an intact description was found. Its bytes stay the same unless the track that it continues is lost. HF tracks whose base is lost and tracks whose codec parameters break a rule are left out. Tracks without packets are added: an HF track for each LF track without one, and tracks with the label `(lost)`. The latter have the missing channel numbers below the highest one, and those that events name.
    """

    pair = (
        ("HEAD", f.head()),
        ("TRAK", LF),
        ("TRAK", HF),
        ("DATA", f.cluster((0, 0, 4, f.KNOT_DATA), (1, 0, 4, b"\0"))),
    )

    def test_of_the_residual(self):
        data = f.closed(*self.pair)
        good, done = recovered(flipped(data, payload_of(data, "TRAK", 1)))
        assert done.exit_code == 3 and done.empty_tracks == 1
        assert verify(good).verdict == "intact"
        assert samples(good) == {}
        assert samples(good, band="lf") == {(0, t): 5 for t in range(4)}

    def test_of_the_base(self):
        data = f.closed(*self.pair)
        good, done = recovered(flipped(data, payload_of(data, "TRAK", 0)))
        assert done.exit_code == 3
        assert verify(good).verdict == "intact"
        assert (hapfmt.Reader(good).channels, samples(good)) == ([], {})

    @pytest.mark.parametrize(
        "number", [1, 255, 256, 600, pytest.param(65_534, marks=pytest.mark.deep)]
    )
    def test_of_channels(self, number):
        data = f.closed(
            ("HEAD", f.head()), ("TRAK", f.trak(first_channel=number, first=3)),
            ("DATA", f.cluster((3, 0, 4, f.KNOT_DATA))),
        )  # fmt: skip
        good, done = recovered(data)
        assert done.exit_code == 3
        assert verify(good).verdict == "intact"
        with hapfmt.Reader(good) as reader:
            assert [ref.number for ref in reader.channels] == list(range(number + 1))
            assert {ref.label for ref in reader.channels[:-1]} == {"(lost)"}
            found = reader.read(channels=[0, number])
        assert [channel.stored.tolist() for channel in found.channels] == [[], [5] * 4]


def test_digests():
    """
    REC-010: A recoverer MUST copy intact metadata, attachments but [overviews](overview.md), clock chunks, and intact chunks of unknown types that are critical or safe to copy. It copies other unknown chunks only from a file without damage, and digests only of what it kept. It reports all losses, and mentions them in the member `notes` of the metadata.
    """
    x = np.arange(100)
    channels = (hapfmt.Channel(x, 1000, label="a"), hapfmt.Channel(x * x, 1000, label="b"))
    out = io.BytesIO()
    settings = hapfmt.Settings.of("lossless", cluster="0.05", references=False, digest=True)
    hapfmt.write(hapfmt.Recording(channels), out, settings, canonical=1)
    data = out.getvalue()
    (_, before), *_ = [chunk for chunk in chunks(data) if chunk[0] == "dGST"]
    good, done = recovered(flipped(data, payload_of(data, "dGST") - f.HEADER - 1))
    lost = {part.labels for part in done.lost}
    kept = [chunk for chunk in chunks(good) if chunk[0] == "dGST"]
    assert (lost, done.digests) == ({("b",)}, 1)
    assert kept == [("dGST", before[:33])]
    assert verify(good).verdict == "intact"


def test_a_digest_that_differs_is_told():
    data = f.minimal(("dGST", f.digests(bytes(32))))
    good, done = recovered(data)
    assert done.exit_code == 3
    assert [finding.code for finding in done.findings] == ["bad-digest"]
    assert "dGST" not in [type_ for type_, _ in chunks(good)]


class TestOtherChunks:
    """
    REC-010: A recoverer MUST copy intact metadata, attachments but [overviews](overview.md), clock chunks, and intact chunks of unknown types that are critical or safe to copy. It copies other unknown chunks only from a file without damage, and digests only of what it kept. It reports all losses, and mentions them in the member `notes` of the metadata.
    """

    def kept(self, data: bytes) -> list[str]:
        good, _ = recovered(data)
        return [type_ for type_, _ in chunks(good) if type_ not in ("HEAD", "TRAK", "DATA")]

    def test_known(self):
        attached = ("aTTc", f.strings("a", "b") + b"c")
        data = f.minimal(("mETa", b'{"a":1,"notes":["old"]}'), attached)
        assert self.kept(data) == ["mETa", "aTTc", "fOOT"]
        good, _ = recovered(data + b"\0")
        back = hapfmt.read(good)
        assert back.metadata["a"] == 1
        assert back.metadata["notes"][0] == "old" and len(back.metadata["notes"]) == 2
        assert back.attachments == {"a": ("b", b"c")}

    def test_damaged_ones_are_left_out(self):
        data = f.minimal(("mETa", b"{}"), ("aTTc", f.strings("a", "b")))
        assert self.kept(flipped(data, payload_of(data, "aTTc"))) == [
            "mETa",
            "mETa",
            "fOOT",
        ]

    @pytest.mark.parametrize(
        ("type_", "from_intact", "from_damaged"),
        [("abcd", True, True), ("abcD", True, False), ("ABCD", True, True), ("ABCd", True, True)],
    )
    def test_unknown(self, type_, from_intact, from_damaged):
        data = f.minimal((type_, b"what"))
        assert (type_ in self.kept(data)) == from_intact
        assert (type_ in self.kept(data + b"\0")) == from_damaged

    def test_unknown_critical_parts_stay_unsupported(self):
        """
        VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
        """
        data = f.minimal(("ABCD", b"what"))
        good, done = recovered(data)
        assert (done.exit_code, done.kept_unknown) == (4, ["ABCD"])
        assert verify(good).verdict == "unsupported"
        assert recovered(data + b"\0")[1].exit_code == 3


def test_a_track_with_an_unknown_codec_is_copied():
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
    """
    unknown = ("TRAK", f.trak(codec=b"xNEW", first_channel=1, first=1))
    cluster = ("DATA", f.cluster((0, 0, 4, f.KNOT_DATA), (1, 0, 4, b"what")))
    data = f.closed(
        ("HEAD", f.head()), f.TRACK_0, unknown, cluster, ("dGST", f.digests(bytes(32), first=1))
    )
    good, done = recovered(data)
    assert (done.exit_code, done.packets, done.digests) == (4, 2, 1)
    assert packets(good) == packets(data)
    good, done = recovered(data + b"\0")
    assert (done.exit_code, done.packets, done.digests) == (3, 2, 0)
    assert samples(good, channels=[0]) == {(0, t): 5 for t in range(4)}


@pytest.mark.parametrize("changes", [{"major": 2}, {"level": 3}])
def test_unknown_versions_are_refused(changes, tmp_path):
    data = f.closed(("HEAD", f.head(**changes)), f.TRACK_0, f.DATA_0)
    with pytest.raises(UnsupportedError):
        hapfmt.recover(data, tmp_path / "out.hapf")
    assert list(tmp_path.iterdir()) == []


def test_what_was_lost_is_noted():
    """
    REC-010: A recoverer MUST copy intact metadata, attachments but [overviews](overview.md), clock chunks, and intact chunks of unknown types that are critical or safe to copy. It copies other unknown chunks only from a file without damage, and digests only of what it kept. It reports all losses, and mentions them in the member `notes` of the metadata.
    """
    data = f.minimal()
    good, done = recovered(flipped(data, payload_of(data, "DATA") + 9))
    assert done.findings and done.lost
    (note,) = hapfmt.Reader(good).metadata["notes"]
    assert "recovered from a damaged file" in note
    assert hapfmt.Reader(recovered(data)[0]).metadata == {}


@pytest.mark.compiled
def test_the_note_names_channels_and_seconds():
    x = np.random.default_rng(1).normal(size=(3, 20_000))
    stream = io.BytesIO()
    hapfmt.write(x, stream, rate=1000, labels=["a", "b", "c"], cluster=1, references=False)
    data = stream.getvalue()
    refs = [ref.offset for ref in hapfmt.Reader(data).catalogue.data]
    few = flipped(data, refs[1] + 4000)
    good, done = recovered(few)
    (note,) = hapfmt.Reader(good).metadata["notes"]
    assert note == "; ".join(
        [f"recovered from a damaged file: {done.packets} packets kept", *done.summary]
    )
    assert "from 1 s to 2 s" in note
    for at in refs[1::2]:
        data = flipped(data, at + 4000)
    good, done = recovered(data)
    (note,) = hapfmt.Reader(good).metadata["notes"]
    assert len(done.summary) > 8 and note.endswith(f"; and {len(done.summary) - 6} more")
    assert hapfmt.verify(good).verdict == "intact"


@pytest.mark.parametrize("type_", ["iNDX", "fOOT"])
def test_what_is_written_anew_is_no_loss(type_):
    data = f.minimal()
    good, done = recovered(flipped(data, payload_of(data, type_)))
    assert (done.exit_code, done.lost) == (0, [])
    assert samples(good) == samples(data)


def test_a_file_that_was_not_closed():
    data = f.file(("HEAD", f.head()), f.TRACK_0, f.DATA_0)
    good, done = recovered(data)
    assert done.exit_code == 0
    assert verify(good).verdict == "intact"
    assert samples(good) == samples(f.minimal())


def test_without_a_head():
    data = f.minimal()
    good, done = recovered(flipped(data, 40))
    assert done.exit_code == 3
    assert verify(good).verdict == "intact"
    assert samples(good) == samples(data)
    assert hapfmt.Reader(good).catalogue.level.number == 2


def test_with_a_head_of_another_time(tmp_path):
    """UUID, epoch, encoder and level stay; a later minor version and TLVs without a meaning here do not."""
    known = f.tlv(2, bytes(range(16))), f.epoch(5, 6), f.tlv(6, b"other 2")
    data = f.closed(
        ("HEAD", f.head(b"".join(known) + f.tlv(98, b"?"), minor=3, level=2)), f.TRACK_0, f.DATA_0
    )
    (tmp_path / "in.hapf").write_bytes(data)
    files = [recovered(data)[0]]
    if shutil.which("node"):
        out = tmp_path / "out.hapf"
        words = ["recover", tmp_path / "in.hapf", out, tmp_path / "report.json"]
        subprocess.run([*PROGRAMS["JavaScript"], *words], check=True)
        files.append(out.read_bytes())
    for file in files:
        assert dict(chunks(file))["HEAD"] == f.head(b"".join(known), level=2)


def test_what_is_no_file_is_refused(tmp_path):
    with pytest.raises(HapfmtError):
        hapfmt.recover(b"nothing", tmp_path / "out.hapf")
    assert list(tmp_path.iterdir()) == []


def test_the_file_id_is_new():
    """
    WRT-002: A writer MUST choose the file id at random. In canonical mode the id is an input or follows from the content. No time of day, host, user or random number enters the file: the same input and settings give the same bytes with the same encoder version on the same machine.
    """
    ids = set()
    for _ in range(3):
        out = io.BytesIO()
        hapfmt.recover(f.minimal(), out)
        ids.add(out.getvalue()[16:20])
    assert len(ids) == 3
    assert recovered(f.minimal(), 5)[0] == recovered(f.minimal(), 5)[0]


def test_targets(tmp_path):
    source, into = tmp_path / "in.hapf", tmp_path / "out.hapf"
    source.write_bytes(f.minimal())
    with pytest.raises(ParameterError, match="replace the damaged"):
        hapfmt.recover(source, source, force=True)
    hapfmt.recover(source, into)
    with pytest.raises(ParameterError, match="exists"):
        hapfmt.recover(source, into)
    hapfmt.recover(source, into, force=True)
    with pytest.raises(ParameterError, match="file id"):
        hapfmt.recover(source, into, canonical=-1)
    assert samples(into.read_bytes()) == samples(f.minimal())


def run(*words: str, data: bytes | None = None):
    import subprocess
    import sys

    return subprocess.run(
        [sys.executable, "-m", "hapfmt", "recover", *words],
        input=data, capture_output=True, check=False, cwd=Path(__file__).parent.parent,
    )  # fmt: skip


def test_verb(tmp_path):
    data = f.minimal()
    source, into = tmp_path / "in.hapf", tmp_path / "out.hapf"
    source.write_bytes(flipped(data, payload_of(data, "DATA") + 9))
    done = run(str(source), str(into), "--json", "--canonical", "4")
    assert done.returncode == 3
    report = json.loads(done.stdout)
    assert (report["packet_count"], report["exit_code"]) == (0, 3)
    assert verify(into.read_bytes()).verdict == "intact"
    again = run(str(source), str(into))
    assert again.returncode == 1 and b"exists" in again.stderr
    piped = run("-", "-", "--canonical", "4", data=source.read_bytes())
    assert (piped.returncode, piped.stdout) == (3, into.read_bytes())
    whole = run("-", str(into), "--force", data=data)
    assert whole.returncode == 0 and b"nothing lost" in whole.stdout


def test_events_and_clocks_come_along():
    x = np.arange(300) % 50
    events = (hapfmt.Event(time=0.25, text="a mark", channel=0), hapfmt.Event(time=0.05, text="b"))
    channel = hapfmt.Channel(x, 1000, calibration=hapfmt.Calibration(1, 0, 10), label="f")
    out = io.BytesIO()
    settings = hapfmt.Settings.of("lossless", cluster="0.1", digest=True)
    hapfmt.write(hapfmt.Recording((channel,), events=events), out, settings, canonical=1)
    data = out.getvalue()
    for bad in (data, data + b"\0", flipped(data, payload_of(data, "DATA", 1) + 20)):
        good, done = recovered(bad)
        assert verify(good).verdict == "intact"
        assert samples(good) == samples(bad)
        assert done.samples == verify(good).samples == len(samples(good))
        with hapfmt.Reader(bad, scan=True) as reader, hapfmt.Reader(good) as again:
            assert again.events() == reader.events()
    assert len(hapfmt.read(good).events) >= 1


@pytest.mark.parametrize("lost", [0, 1])
def test_a_channel_of_several_tracks_of_which_one_is_lost(lost):
    second = f.trak(continues=0, first=1)
    data = f.closed(
        ("HEAD", f.head()), f.TRACK_0, ("TRAK", second), f.DATA_0,
        ("DATA", f.cluster((1, 4, 4, f.KNOT_DATA))), duration_ns=8_000_000,
    )  # fmt: skip
    assert verify(data).verdict == "intact"
    bad = flipped(data, payload_of(data, "TRAK", lost))
    good, done = recovered(bad)
    assert done.exit_code == 3
    assert verify(good).verdict == "intact", verify(good).error
    kept = range(4, 8) if lost == 0 else range(4)
    assert samples(good) == {(0, tick): 5 for tick in kept}


def test_a_digest_that_packets_were_appended_to_is_no_damage():
    x = np.arange(40)
    out = io.BytesIO()
    settings = hapfmt.Settings.of("lossless", digest=True)
    channel = hapfmt.Channel(x, 1000, calibration=hapfmt.Calibration(1, 0, 10), label="f")
    hapfmt.write(hapfmt.Recording((channel,)), out, settings, canonical=f.FILE_ID)
    whole = out.getvalue()
    data = whole[: payload_of(whole, "fOOT") - f.HEADER]
    with hapfmt.Reader(whole) as reader:
        sequence = len(reader.catalogue.chunks) - 1
    again = dict(zip(("track", "start", "span", "data"), packets(whole)[0], strict=True))
    late = (again["track"], again["start"] + 40, again["span"], again["data"])
    data += f.chunk("DATA", f.cluster(late), sequence)
    good, done = recovered(data)
    assert (done.exit_code, done.digests) == (0, 0)
    assert verify(good).verdict == "intact"
    assert len(samples(good)) == 80


def test_order_is_nothing_in_a_damaged_file():
    """Wherever the damage stands: a reader gives what is recovered (SPEC 14.1)."""
    chunks = [f.TRACK_0, ("HEAD", f.head()), f.DATA_0]
    with pytest.raises(FormatError):
        hapfmt.read(f.file(*chunks))
    for data in (f.file(*chunks) + b"?", f.SIGNATURE + b"?" + f.file(*chunks)[8:]):
        wanted = {(0, tick): 5 for tick in range(4)}
        assert samples(data) == samples(recovered(data)[0]) == wanted
        assert [each["code"] for each in verify(data).findings] == ["garbage", "not-closed"]


def test_only_hf_tracks_stand_on_a_base():
    """The base that a track of unknown kind names is none: its LF track has lost its HF track."""
    strange = ("TRAK", f.trak(kind=9, base=0, first_channel=1, first=1))
    data = f.file(("HEAD", f.head()), ("TRAK", LF), strange, ("mETa", b"{")) + b"?"
    out, _ = recovered(data)
    tracks = hapfmt.Reader(out).catalogue.tracks.values()
    assert [track.base for track in tracks if track.kind == "hf"] == [0]
