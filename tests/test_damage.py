"""Every prefix, every flipped bit and every missing byte of a small file: seen, and never a wrong
sample."""

from __future__ import annotations

import io

import forge as f
import pytest
import strategies
from depth import deep
from hypothesis import assume, given
from hypothesis import strategies as st
from judge import samples
from test_walk import damaged

import hapfmt
from hapfmt.errors import HapfmtError
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

pytestmark = pytest.mark.capped

TWO = f.closed(
    ("HEAD", f.head()),
    ("TRAK", f.trak(track_count=2)),
    ("DATA", f.cluster((0, 0, 3, b"\x02\1\x02\1\x02"), (1, 0, 3, b"\x03"))),
    ("DATA", f.cluster((0, 3, 2, b"\x08"), (1, 4, 1, b"\x0b"))),
    duration_ns=5_000_000,
)
"""Two channels, two clusters, a gap: 540 bytes."""

CLEAN = samples(TWO)


def check(data: bytes, clean: dict) -> None:
    """Not called intact; what is delivered is true, and what is not is reported as lost."""
    assert verify(data).verdict != "intact"
    try:
        reader = Reader(data)
        found = reader.read()
    except HapfmtError:
        return
    delivered = {}
    for ref, channel in zip(reader.channels, found.channels, strict=True):
        for start, values in channel.segments():
            for i, value in enumerate(values.tolist()):
                delivered[ref.number, start + i] = value
    assert delivered.items() <= clean.items()
    assert reader.findings
    if {finding.code for finding in reader.findings} == {"not-closed"}:
        # The cut lies between two chunks: nobody knows what followed.
        return
    lost = [key for key in clean if key not in delivered and key[0] < len(reader.channels)]
    for channel, tick in lost:
        (ref,) = [ref for ref in reader.channels if ref.number == channel]
        tracks = {track.id for track in ref.tracks} | {part.track.continues for part in ref.parts}
        assert any(
            (span.track in tracks or span.track not in reader.catalogue.tracks)
            and span.start <= tick
            and (span.stop is None or tick < span.stop)
            for span in reader.lost
        )


@pytest.mark.parametrize("turn", [0, *deep(range(1, 8))])
def test_every_flip(turn):
    """
    REC-001: A reader MUST NOT deliver a sample from a packet whose CRC differs, nor from a chunk whose header CRC or file id differs.
    REC-003: A reader that goes on after damage MUST report every stretch of bytes that was lost, and every span that `lost` names.
    CHK-002: A header MUST have the sync word `F9 48 8B 1C`, a type of four ASCII letters, and the right `header_crc`. A reader uses no field of any other header.
    """
    for at in range(len(TWO)):
        data = bytearray(TWO)
        data[at] ^= 1 << (at + turn) % 8
        check(bytes(data), CLEAN)


def test_every_deletion():
    """
    REC-003: A reader that goes on after damage MUST report every stretch of bytes that was lost, and every span that `lost` names.
    FIL-002: The first chunk MUST start at offset 8, and each other chunk directly after the payload of the one before it.
    """
    for at in range(len(TWO)):
        check(TWO[:at] + TWO[at + 1 :], CLEAN)


def test_every_prefix():
    """
    FIL-003: A closed file MUST end with a `fOOT` chunk.
    VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
    """
    for size in range(len(TWO)):
        check(TWO[:size], CLEAN)


@pytest.mark.parametrize("junk", [b"\0", f.SYNC, TWO[8:44]])
def test_every_insertion(junk):
    for at in range(0, len(TWO), 3):
        check(TWO[:at] + junk + TWO[at:], CLEAN)


@strategies.idle_settings
@given(
    strategies.recordings(), strategies.encoder_settings(), st.sampled_from(["lf", "hf"]), st.data()
)
def test_any_damage_of_any_file(recording, settings, band, data):
    """
    REC-001: A reader MUST NOT deliver a sample from a packet whose CRC differs, nor from a chunk whose header CRC or file id differs.
    """
    out = io.BytesIO()
    hapfmt.write(recording, out, settings, canonical=f.FILE_ID)
    bad = data.draw(damaged(out.getvalue()))
    assume(bad != out.getvalue())
    assert verify(bad).verdict != "intact"
    clean = samples(out.getvalue(), band=band)
    assert (samples(bad, band=band) or {}).items() <= clean.items()


HF_TRACK = range(0xA0, 0xEA)
"""Where the worked example describes its HF track."""


def flips(data: bytes, places: range):
    for at in places:
        bad = bytearray(data)
        bad[at] ^= 0x10
        yield bytes(bad)


@pytest.mark.parametrize("band", ["full", "lf", "hf"])
def test_residuals(residual_file, band):
    clean = samples(residual_file, band=band)
    for at in range(len(residual_file)):
        if band == "full" and at in HF_TRACK:
            continue
        for bad in flips(residual_file, range(at, at + 1)):
            assert (samples(bad, band=band) or {}).items() <= clean.items()


def test_a_lost_description_of_the_residual(residual_file):
    """
    DEC-003: The full band of a channel with an HF track MUST be delivered only for ticks that both tracks cover; the others are gaps. For an LF track whose HF track is not known it is empty. Gaps are not filled with values. Where an output cannot leave them out, it marks them by NaN or a mask.
    """
    clean = samples(residual_file)
    for bad in flips(residual_file, HF_TRACK):
        assert (samples(bad) or {}).items() <= clean.items()


def test_residual_file_flips_are_never_intact(residual_file):
    for bad in flips(residual_file, range(len(residual_file))):
        assert verify(bad).verdict != "intact"
