"""Clause 13: verdicts; digests and contracts."""

from __future__ import annotations

import hashlib
import io
from dataclasses import replace
from fractions import Fraction

import forge as f
import numpy as np
import pytest
import strategies
from hypothesis import assume, given
from hypothesis import strategies as st
from judge import rule

import hapfmt
from hapfmt.errors import VERDICTS
from hapfmt.format.source import BytesSource
from hapfmt.limits import LEVELS
from hapfmt.reading.decoder import TrackDecoder, TrackDigest
from hapfmt.reading.dump import dump, measure
from hapfmt.reading.verifier import verify
from hapfmt.recording import Calibration, Channel, Recording

pytestmark = pytest.mark.capped

HEAD = ("HEAD", f.head())
UNKNOWN = ("XXXX", b"")
BROKEN = ("mETa", b"")
DAMAGED = ("mETa", b"{}", {"crc": 0})


@pytest.mark.parametrize(
    ("more", "verdict", "code"),
    [
        ([], "intact", 0),
        ([BROKEN], "nonconforming", 2),
        ([DAMAGED], "damaged", 3),
        ([UNKNOWN], "unsupported", 4),
        ([UNKNOWN, BROKEN], "unsupported", 4),
        ([BROKEN, UNKNOWN], "unsupported", 4),
        ([UNKNOWN, DAMAGED], "damaged", 3),
        ([DAMAGED, BROKEN, UNKNOWN], "damaged", 3),
    ],
)
def test_verdicts(more, verdict, code):
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
    """
    report = verify(f.minimal(*more))
    assert (report.verdict, report.exit_code) == (verdict, code)
    assert VERDICTS[code] == verdict
    assert report.as_json()["verdict"] == verdict


def test_damage_goes_before_a_broken_rule():
    assert verify(f.minimal(BROKEN, DAMAGED)).verdict == "damaged"


def test_a_version_of_the_future_is_not_judged():
    """
    VER-001: A reader MUST read every file of major version 1, whatever its minor version. For all other files it reports the outcome *unsupported*, and checks no other rule, not even HED-002.
    """
    data = f.closed(("HEAD", f.head(major=2)), f.TRACK_0, BROKEN, DAMAGED)
    assert verify(data).verdict == "unsupported"


def test_parts_that_are_understood():
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
    """
    report = verify(f.minimal(UNKNOWN, ("aaaa", b"")))
    assert report.unknown == ["XXXX", "aaaa"]
    assert [entry.get("type") for entry in dump(BytesSource(f.minimal(UNKNOWN)))][3] == "XXXX"


@pytest.mark.parametrize("spans", [[2**22 + 1], [2, 2**22 - 1]])
def test_a_few_bytes_do_not_print_a_flood(spans):
    """Each packet is one byte; at level 2 a cluster may stand for 2^28 numbers."""
    starts = np.cumsum([0, *spans]).tolist()
    packets = [(0, at, span, b"\0") for at, span in zip(starts, spans, strict=False)]
    data = f.file(("HEAD", f.head(level=2)), f.TRACK_0, ("DATA", f.cluster(*packets)))
    assert verify(data).error is None
    entry = list(dump(BytesSource(data), counts=True))[2]
    assert "LIM-003" in entry["error"] and "packets" not in entry


def test_empty_inputs():
    for data in (b"", b"\0", f.SIGNATURE[:7], f.SIGNATURE):
        assert verify(data).verdict == "nonconforming"


@given(st.binary(max_size=200), st.booleans())
def test_any_bytes(data, signed):
    report = verify((f.SIGNATURE if signed else b"") + data)
    assert report.exit_code in (2, 3)


def slow_digest(
    numbers: list[list[int]], size: int, signed: bool, spans: list[tuple[int, int]]
) -> bytes:
    body = b"".join(n.to_bytes(size, "little", signed=signed) for row in numbers for n in row)
    coverage = b"".join(a.to_bytes(8, "little") + n.to_bytes(8, "little") for a, n in spans)
    return hashlib.sha256(hashlib.sha256(body).digest() + coverage).digest()


FIVES = slow_digest([[5]] * 4, 4, True, [(0, 4)])


class TestDigests:
    """
    DGS-001: Whole digests MUST follow the track id, one at least, and fill the payload. The tracks are described before it; none is of kind events, since events may be added to a closed file.
    DGS-002: A verifier MUST report a digest that differs from the one it computes. Of several for one track the last one counts. None is compared where the track may lack data, or where a rule is broken in a file without damage.
    """

    def test_true(self):
        report = verify(f.minimal(("dGST", f.digests(FIVES))))
        assert (report.verdict, report.digests) == ("intact", 1)

    @pytest.mark.parametrize(
        "wrong",
        [
            bytes(32),
            slow_digest([[5]] * 4, 4, True, [(1, 4)]),
            slow_digest([[5]] * 5, 4, True, [(0, 4)]),
        ],
    )
    def test_false(self, wrong):
        assert rule(f.minimal(("dGST", f.digests(wrong)))) == ("damaged", "DGS-002")

    def test_the_last_counts(self):
        stale, true = ("dGST", f.digests(bytes(32))), ("dGST", f.digests(FIVES))
        assert rule(f.minimal(stale, true)) == ("intact", None)
        assert rule(f.minimal(true, stale)) == ("damaged", "DGS-002")

    def test_of_the_packets_before_it(self):
        digest = ("dGST", f.digests(FIVES))
        later = ("DATA", f.cluster((0, 4, 1, f.KNOT_DATA)))
        assert rule(f.minimal(digest, later, duration_ns=5_000_000)) == ("intact", None)
        early = f.closed(HEAD, f.TRACK_0, digest, f.DATA_0)
        assert rule(early) == ("damaged", "DGS-002")

    @pytest.mark.parametrize("size", [0, 1, 31, 33])
    def test_of_another_size(self, size):
        data = f.minimal(("dGST", f.digests(bytes(size))))
        assert rule(data) == ("nonconforming", "DGS-001")

    def test_before_its_track(self):
        data = f.closed(HEAD, ("dGST", f.digests(FIVES)), f.TRACK_0, f.DATA_0)
        assert rule(data) == ("nonconforming", "DGS-001")

    @given(strategies.packets())
    def test_as_the_page_says(self, case):
        """
        DGS-003: A digest MUST be that of exactly the packets of its track in chunks before it, by sequence numbers.
        """
        track, packets, _ = case
        decoder, digest = TrackDecoder(track, LEVELS[1]), TrackDigest()
        rows, spans = [], []
        for packet in packets:
            numbers = decoder.decode(packet)
            exact = decoder.decode_exact(packet, numbers)
            numbers = numbers if exact is None else exact
            digest.update(packet.start, numbers)
            size = numbers.dtype.itemsize
            signed = track.number_format == "counts" and exact is None
            rows += numbers.view("<i4" if signed else f"<u{size}").tolist()
            if spans and sum(spans[-1]) == packet.start:
                spans[-1] = (spans[-1][0], spans[-1][1] + packet.span)
            else:
                spans.append((packet.start, packet.span))
        assert digest.digest() == slow_digest(rows, size, signed, spans)


def recorded(x: np.ndarray) -> Recording:
    return Recording((Channel(x, Fraction(1000), calibration=Calibration(), label="f"),))


class TestContracts:
    """
    DBC-002: With flag *guaranteed*, every sample MUST keep the contract: for each component `|x - y| * kd <= max(kn * |x - zero|, floor * kd)`. The vector form is the same with Euclidean norms over the components, compared by their squares, and the floor of the first component. A verifier that is given x checks this with exact arithmetic. It reports the number of samples outside and the worst ratio of the left side to the right.
    DBC-004: A channel without a contract MUST be stored without loss: its full band equals the counts, the raw numbers, or with exact values (9.7) the numbers of the source.
    TLV-006: Every source value MUST be at most `largest` away from the physical value of its count. Without a deviation it is equal to it, or the track has exact values (9.7).
    DBC-002: With flag *guaranteed*, every sample MUST keep the contract: for each component `|x - y| * kd <= max(kn * |x - zero|, floor * kd)`. The vector form is the same with Euclidean norms over the components, compared by their squares, and the floor of the first component. A verifier that is given x checks this with exact arithmetic. It reports the number of samples outside and the worst ratio of the left side to the right.
    """

    @strategies.idle_settings
    @given(strategies.recordings(), strategies.encoder_settings())
    def test_guarantees_hold(self, recording, settings):
        out = io.BytesIO()
        hapfmt.write(recording, out, settings, canonical=1)
        report = verify(out.getvalue(), against=recording)
        assert report.verdict == "intact"
        for check in report.contracts:
            assert (check.missing, check.invented) == (0, 0)
            if check.contract and check.contract.guaranteed:
                assert check.outside == 0
                assert check.worst_ratio <= 1

    @pytest.mark.parametrize("x", [[5, 5, 5, 5], [5, 5, 5, 6]])
    def test_without_a_contract_nothing_may_differ(self, x):
        report = verify(f.minimal(), against=recorded(np.array(x)))
        assert report.contracts[0].outside == sum(v != 5 for v in x)
        assert report.verdict == ("intact" if x == [5] * 4 else "damaged")

    @pytest.mark.parametrize(("stated", "verdict"), [(0.2, "damaged"), (0.25, "intact")])
    def test_the_source_is_no_further_from_its_lattice_than_stated(self, stated, verdict):
        tlvs = f.HOLD + f.tlv(18, f.deviation(0.5, stated))
        data = f.closed(HEAD, ("TRAK", f.trak(tlvs)), f.DATA_0)
        channel = hapfmt.Channel(
            np.array([5.0, 5.25, 5.0, 5.0]), recorded(np.zeros(4, int)).channels[0].rate_exact
        )
        report = verify(data, against=hapfmt.Recording((channel,)))
        assert report.contracts[0].moved == 0.25
        assert report.verdict == verdict

    @pytest.mark.parametrize(
        ("x", "outside", "ratio"),
        [([5, 5, 5, 5], 0, Fraction(0)), ([6, 5, 5, 5], 0, Fraction(1)), ([7, 5, 5, 4], 1, Fraction(2)),
         ([50, 45, 5, 55], 3, Fraction(10))],
    )  # fmt: skip
    def test_by_hand(self, x, outside, ratio):
        """k = 1/10, floor 1: 5 stands for 5 +- 1, and for 50 at 10 deadbands."""
        tlvs = f.HOLD + f.tlv(16, f.deadband(1, 10, flags=2))
        data = f.closed(HEAD, ("TRAK", f.trak(tlvs)), f.DATA_0)
        report = verify(data, against=recorded(np.array(x)))
        (check,) = report.contracts
        slow = [Fraction(abs(v - 5) * 10, max(abs(v), 10)) for v in x]
        assert (check.outside, check.worst_ratio) == (sum(r > 1 for r in slow), max(slow))
        assert check.outside == outside
        assert check.worst_ratio in (ratio, max(slow))
        assert report.verdict == ("damaged" if outside else "intact")

    def test_an_aim_is_no_guarantee(self):
        tlvs = f.HOLD + f.tlv(16, f.deadband(flags=0))
        data = f.closed(HEAD, ("TRAK", f.trak(tlvs)), f.DATA_0)
        report = verify(data, against=recorded(np.array([90] * 4)))
        assert (report.verdict, report.contracts[0].outside) == ("intact", 4)

    def test_samples_that_are_missing_or_invented(self):
        for ticks in (3, 5):
            report = verify(f.minimal(), against=recorded(np.array([5] * ticks)))
            assert report.verdict == "damaged"

    def test_another_recording(self):
        with pytest.raises(hapfmt.ParameterError):
            verify(f.minimal(), against=Recording())
        other = recorded(np.array([5] * 4))
        slow = replace(other.channels[0], rate_exact=Fraction(1))
        with pytest.raises(hapfmt.ParameterError):
            verify(f.minimal(), against=Recording((slow,)))

    def test_the_name_of_a_file(self):
        with pytest.raises(
            hapfmt.ParameterError, match=r"as hapfmt.read gives it, not 'touch.npz'"
        ):
            verify(f.minimal(), against="touch.npz")


@given(strategies.recordings(), st.data())
def test_usage_adds_up(recording, data):
    """Bytes by cause add up to the size of the file, whole or not."""
    out = io.BytesIO()
    hapfmt.write(recording, out, canonical=1)
    file = out.getvalue()
    if data.draw(st.booleans()):
        at = data.draw(st.integers(0, len(file) - 1))
        file = file[:at] + data.draw(st.binary(max_size=1)) + file[at + 1 :]
    try:
        usage = measure(BytesSource(file))
    except hapfmt.HapfmtError:
        assume(False)
    assert sum(usage.causes.values()) == len(file)
    assert min(usage.causes.values()) >= 0
    assert usage.payload == sum(track.packets_size for track in usage.tracks.values())


class TestOriginalsThatDoNotFit:
    """What ``--against`` finds where the original holds other numbers than counts can."""

    @pytest.mark.parametrize("odd", [np.inf, -np.inf, 1e300])
    def test_values_near_no_count_are_outside(self, odd):
        channel = Channel(np.array([5.0, odd, 5.0, 5.0]), Fraction(1000))
        (check,) = verify(f.minimal(), against=Recording((channel,))).contracts
        assert (check.outside, check.samples, check.broken) == (1, 4, True)

    @pytest.mark.parametrize("dtype", [np.int64, np.uint64])
    def test_words_are_compared_exactly(self, dtype):
        one, two = (np.array([2**60 + d, 2**62 - 1, 2**62 + 1], dtype) for d in (0, 1))
        words, other = (Channel(x, Fraction(1)) for x in (one, two))
        out = io.BytesIO()
        hapfmt.write(Recording((words,)), out, canonical=1)
        report = verify(out.getvalue(), against=Recording((other,)))
        assert report.contracts[0].outside == 1 and report.verdict == "damaged"
        assert verify(out.getvalue(), against=Recording((words,))).verdict == "intact"


def test_an_lf_track_alone_is_refused_by_readers_too():
    data = f.closed(HEAD, ("TRAK", f.trak(kind=1)), f.DATA_0)
    with pytest.raises(hapfmt.FormatError, match="TRK-012"):
        hapfmt.read(data)


@pytest.mark.parametrize("count", [1, 3])
def test_an_hf_track_whose_base_came_later_is_matched_then(count):
    """The first LF description is damaged; another, with as many components or more, follows."""
    hf = f.trak(f.tlv(1, f.quan_parameters(b"\x10")), kind=2, base=0, codec=b"QUAN", first=1)
    late = f.trak(kind=1, component_count=count)
    data = f.closed(
        HEAD,
        ("TRAK", f.trak(kind=1), {"crc": 0}),
        ("TRAK", hf),
        ("DATA", f.cluster((1, 0, 4, b""))),
        ("TRAK", late),
    )
    with hapfmt.Reader(data) as reader:
        assert (1 in reader.catalogue.tracks) == (count == 1)
        assert len(reader.read()) == count
        assert reader.findings
