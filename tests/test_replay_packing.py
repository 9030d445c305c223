"""Counts -> reports: bytes written by hand from the layouts, and laws for any counts."""

from __future__ import annotations

import time
from functools import lru_cache

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stalls import slowness

from hapfmt.errors import ParameterError
from hapfmt.replay.profile.model import (
    Const,
    Crc32,
    Frame,
    Mapped,
    One,
    Profile,
    ReportLayout,
    Samples,
)
from hapfmt.replay.profile.packing import AMPLITUDE_CEILING, MAPS, Packer, rumble_amplitude
from hapfmt.replay.profile.parse import builtin_names, load_profile, parse_profile

BUILTIN = builtin_names()
profile = lru_cache(load_profile)


def frame(*samples: tuple[int, ...], number: int = 0) -> Frame:
    return Frame(number, 0, samples)


def sum_of(data: bytes) -> bytes:
    """CRC-32 bit by bit (RFC 1952, 8), little-endian."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xEDB88320 * (value & 1)
    return (value ^ 0xFFFFFFFF).to_bytes(4, "little")


def sealed(text: str, length: int) -> bytes:
    """Bytes, zeros, and the CRC of a report of DualSense by Bluetooth."""
    data = bytes.fromhex(text).ljust(length - 4, b"\0")
    return data + sum_of(b"\xa2" + data)


def test_the_crc_of_these_tests():
    """The check value of CRC-32, and what the seed of DualSense comes to (SAxense.c)."""
    assert sum_of(b"123456789") == (0xCBF43926).to_bytes(4, "little")
    assert sum_of(b"\xa2") == (0xEADA2D49).to_bytes(4, "little")


NEUTRAL = "00 01 40 40"
FULL = "00 C9 40 72"  # 320 Hz, HA C8; 160 Hz, LA 0072
GOLDEN = [
    ("glove5", (0, 1000, -1000, 5000, -5000), "01 00 0000 E803 18FC 8813 78EC", 12),
    ("glove22", tuple(range(22)), "02 00 " + " ".join(f"{n:02X} 00" for n in range(22)), 46),
    ("dualsense-usb", (255, 128), "02 03 00 80 FF", 48),
    ("joycon-left", (1000, 1000), f"10 01 {FULL} {NEUTRAL}", 10),
    ("joycon-right", (1000, 1000), f"10 01 {NEUTRAL} {FULL}", 10),
    ("joycon-left", (0, 0), f"10 01 {NEUTRAL} {NEUTRAL}", 10),
    # amplitudes 0.5 and 0.245: 32 log2(8.7 * 0.5) = 68, 32 log2(8.7 * 0.245) = 35
    ("joycon-left", (500, 245), f"10 01 00 89 C0 51 {NEUTRAL}", 10),
    # 0.2: 16 log2(17 * 0.2) = 28; 0.016: index 4 of the table
    ("switch-pro", (200, 16, 16, 200), "10 01 00 39 40 42 00 09 40 4E", 10),
    ("xbox-bluetooth", (100, 50, 1, 2), "03 0F 01 02 64 32 14 00 00", 9),
]


@pytest.mark.parametrize(("name", "counts", "wanted", "length"), GOLDEN)
def test_golden_bytes(name, counts, wanted, length):
    reports = Packer(profile(name)).pack(frame(counts))
    assert [report.path for report in reports] == ["output"]
    assert reports[0].data == bytes.fromhex(wanted).ljust(length, b"\0")


def test_golden_bytes_of_rumble_by_bluetooth():
    packer = Packer(profile("dualsense-bluetooth"))
    first, second = (packer.pack(frame((0x12, 0x34)))[0].data for _ in range(2))
    assert first == sealed("31 00 10 03 00 34 12", 78)
    assert second == sealed("31 10 10 03 00 34 12", 78)


def test_golden_bytes_of_haptics_by_bluetooth():
    packer = Packer(profile("dualsense-bluetooth-haptics"))
    samples = [(n, -n) for n in range(32)]
    body = " ".join(f"{n:02X} {-n & 0xFF:02X}" for n in range(32))
    for number in range(2):
        wanted = sealed(f"32 00 91 07 FE 00 00 00 00 FF {number:02X} 92 40 {body}", 142)
        assert packer.pack(frame(*samples))[0].data == wanted
    assert len(wanted) == 142
    assert float(profile("dualsense-bluetooth-haptics").timing.period) == 32 / 3000


def test_counters_go_round():
    packers = {name: Packer(profile(name)) for name in ("dualsense-bluetooth", "joycon-left")}
    seen = {name: [p.neutral()[0].data[1] for _ in range(17)] for name, p in packers.items()}
    assert seen["dualsense-bluetooth"] == [*range(0, 256, 16), 0]
    assert seen["joycon-left"] == [*range(1, 16), 0, 1]


OWN = """
name = "own"
[timing]
rate = 1000
[[actuator]]
name = "a"
unit = "N"
minimum = -1
maximum = 1
rest = 0.5
slew = 100
step = 0.01
[[actuator]]
name = "b"
unit = "N"
minimum = -300
maximum = 300
rest = 0
slew = 1e5
step = 0.01
"""


def test_feature_reports_two_reports_and_other_orders():
    own = parse_profile(
        OWN
        + """
        [[report]]
        path = "feature"
        id = 9
        length = 14
        fields = [
            { at = 9, counter = "u16be", shared = "both", start = 300 },
            { at = 5, actuator = "b", type = "i32be" },
            { at = 1, actuator = "a", type = "i16be" },
            { at = 3, actuator = "b", type = "i16" },
            { at = 11, const = [1, 2, 3] },
        ]
        [[report]]
        path = "output"
        id = 0
        length = 9
        fields = [
            { at = 1, counter = "u32", shared = "both", mask = 0xFFFF, shift = 8 },
            { at = 5, crc32 = { from = 1, to = 5 } },
        ]
        """
    )
    packer = Packer(own)
    for number in (300, 302):
        one, two = packer.pack(frame((-2, 256)))
        assert one.path == "feature" and two.path == "output"
        wanted = f"09 FFFE 0001 00000100 {number:04X} 010203"
        assert one.data == bytes.fromhex(wanted)
        count = bytes([0, number - 299, 0, 0])
        assert two.data == b"\0" + count + sum_of(count)
    assert packer.neutral()[0].data[1:3] == bytes([0, 50])


def test_the_neutral_frame_of_a_profile_replaces_one_at_rest():
    fields = "\nfields = [ { at = 1, actuator = 'a', type = 'i8' }, { at = 2, actuator = 'b', type = 'i16' } ]"
    report = f"\n[[report]]\npath = 'output'\nid = 1\nlength = 4{fields}"
    stop = "\n[[neutral]]\npath = 'output'\ndata = '02 00'"
    assert [r.data.hex() for r in Packer(parse_profile(OWN + report)).neutral()] == ["01320000"]
    own = parse_profile(OWN + report + stop)
    assert [r.data.hex() for r in Packer(own).neutral()] == ["0200"]
    assert [r.data.hex() for r in Packer(own).at_rest()] == ["01320000"]


@pytest.mark.parametrize("name", BUILTIN)
def test_every_builtin_rests(name):
    """Its neutral frame has the counts of rest, in as many bytes as its frames."""
    one = profile(name)
    rest = tuple(limits.rest for limits in one.count_limits)
    samples = (rest,) * one.timing.frame_samples
    assert Packer(one).neutral() == Packer(one).pack(frame(*samples))


@pytest.mark.parametrize("name", BUILTIN)
def test_counts_beyond_the_limits_are_refused(name):
    one = profile(name)
    packer = Packer(one)
    samples = [
        [limits.rest for limits in one.count_limits] for _ in range(one.timing.frame_samples)
    ]
    for place, limits in enumerate(one.count_limits):
        for wrong in (limits.low - 1, limits.high + 1, 1 << 70):
            samples[-1][place] = wrong
            with pytest.raises(ParameterError, match="beyond"):
                packer.pack(frame(*map(tuple, samples)))
        samples[-1][place] = limits.rest
    with pytest.raises(ParameterError, match="samples"):
        packer.pack(frame())
    with pytest.raises(ParameterError, match="counts"):
        packer.pack(frame(*[()] * one.timing.frame_samples))


def unpacked(one: Profile, layout: ReportLayout, data: bytes) -> dict[tuple[int, str], int]:
    """(sample, actuator) -> count, of the plain fields; checks what never changes and the CRC."""
    found = {}
    assert len(data) == layout.length and data[0] == layout.id
    for field in layout.fields:
        match field:
            case Const():
                assert data[field.at : field.at + len(field.data)] == field.data
            case Crc32():
                seed = b"" if field.seed is None else bytes([field.seed])
                part = seed + data[field.start : field.stop]
                assert data[field.at : field.at + 4] == sum_of(part)
            case Mapped():
                _, high, low, amplitude = data[field.at : field.at + 4]
                assert high & 0xFE <= 0xC8 and (amplitude, low >> 7) <= (0x72, 0)
            case One() | Samples():
                names = (field.actuator,) if isinstance(field, One) else field.actuators
                count = 1 if isinstance(field, One) else one.timing.frame_samples
                at = field.at
                for sample in range(count):
                    for name in names:
                        part = data[at : at + field.type.size]
                        order = "big" if field.type.name.endswith("be") else "little"
                        signed = field.type.name.startswith("i")
                        found[sample, name] = int.from_bytes(part, order, signed=signed)
                        at += field.type.size
    return found


@st.composite
def framed(draw: st.DrawFn, one: Profile) -> Frame:
    ranges = [st.integers(limits.low, limits.high) for limits in one.count_limits]
    sample = st.tuples(*ranges)
    count = one.timing.frame_samples
    return frame(*draw(st.lists(sample, min_size=count, max_size=count)))


@pytest.mark.parametrize("name", BUILTIN)
@given(data=st.data())
def test_any_counts_within_the_limits_come_back(name, data):
    one = profile(name)
    given_frame = data.draw(framed(one))
    reports = Packer(one).pack(given_frame)
    assert len(reports) == len(one.reports)
    for layout, report in zip(one.reports, reports, strict=True):
        assert report.path == layout.path
        for (sample, actuator), count in unpacked(one, layout, report.data).items():
            place = [each.name for each in one.actuators].index(actuator)
            assert given_frame.counts[sample][place] == count


INTEGERS = {
    "u8": 1,
    "i8": 1,
    "u16": 2,
    "i16": 2,
    "u32": 4,
    "i32": 4,
    "u16be": 2,
    "i16be": 2,
    "i32be": 4,
}


@st.composite
def own_profiles(draw: st.DrawFn) -> Profile:
    """Actuators in any types, at any places, in any order of the list."""
    types = draw(st.lists(st.sampled_from(sorted(INTEGERS)), min_size=1, max_size=12))
    at, fields = draw(st.integers(1, 4)), []
    text = "name = 'own'\n[timing]\nrate = 1000\n"
    for n, kind in enumerate(types):
        low = -100 if kind.startswith("i") else 0
        text += f"[[actuator]]\nname = 'a{n}'\nunit = 'N'\nminimum = {low}\nmaximum = 100\nrest = 0\nslew = 1e4\nstep = 1\n"
        fields.append(f"{{ at = {at}, actuator = 'a{n}', type = '{kind}' }}")
        at += INTEGERS[kind] + draw(st.integers(0, 2))
    fields.append(f"{{ at = {at}, crc32 = {{ seed = {draw(st.integers(0, 255))}, to = {at} }} }}")
    listed = ", ".join(draw(st.permutations(fields)))
    text += f"[[report]]\npath = 'feature'\nid = 7\nlength = {at + 4}\nfields = [{listed}]"
    return parse_profile(text)


@given(own_profiles(), st.data())
def test_any_layout_comes_back(one, data):
    given_frame = data.draw(framed(one))
    (report,) = Packer(one).pack(given_frame)
    found = unpacked(one, one.reports[0], report.data)
    assert tuple(found[0, each.name] for each in one.actuators) == given_frame.counts[0]


# rumble_data_table.md: amplitudes of the indices 0 to 100
AMPLITUDES = """
0.000000 0.007843 0.011823 0.014061 0.016720 0.019885 0.023648 0.028123 0.033442 0.039771 0.047296
0.056246 0.066886 0.079542 0.094592 0.112491 0.117471 0.122671 0.128102 0.133774 0.139697 0.145882
0.152341 0.159085 0.166129 0.173484 0.181166 0.189185 0.197561 0.206308 0.215442 0.224982 0.229908
0.234943 0.240087 0.245345 0.250715 0.256206 0.261816 0.267549 0.273407 0.279394 0.285514 0.291765
0.298154 0.304681 0.311353 0.318171 0.325138 0.332258 0.339534 0.346969 0.354566 0.362331 0.370265
0.378372 0.386657 0.395124 0.403777 0.412619 0.421652 0.430885 0.440321 0.449964 0.459817 0.469885
0.480174 0.490689 0.501433 0.512413 0.523633 0.535100 0.546816 0.558790 0.571027 0.583530 0.596307
0.609365 0.622708 0.636344 0.650279 0.664518 0.679069 0.693939 0.709133 0.724662 0.740529 0.756745
0.773316 0.790249 0.807554 0.825237 0.843307 0.861772 0.880643 0.899928 0.919633 0.939771 0.960348
0.981378 1.002867
"""


def test_amplitudes_are_those_of_the_published_table():
    found = [rumble_amplitude(float(text)) for text in AMPLITUDES.split()]
    assert len(found) == 101
    assert [(n, found[n]) for n in range(101) if n != found[n]] == [(32, 31)]  # is below 0.23


@given(st.floats(0, 1e6), st.floats(0, 1e6))
def test_amplitudes_rise_and_never_pass_the_ceiling(one, other):
    low, high = sorted((one, other))
    assert 0 <= rumble_amplitude(low) <= rumble_amplitude(high) <= AMPLITUDE_CEILING


@given(
    st.floats(0, 1e6),
    st.floats(0, 1e6),
    st.floats(81.75177, 1252.572266),
    st.floats(40.875885, 626.286133),
)
def test_hd_rumble_keeps_its_bits(high, low, high_hz, low_hz):
    """High band: amplitude in seven bits of byte 1, at most C8; low band: at most 72 40."""
    pack = MAPS["hd-rumble"].make(((high,), (low,)), {"high_hz": high_hz, "low_hz": low_hz})
    a, b, c, d = pack((0, 0))
    assert a & 3 == 0 and b & 0xFE <= 0xC8
    assert 0 < (a | (b & 1) << 8) <= 0x1FC
    assert 0x40 <= d <= 0x72 and c & 0x7F >= 1
    assert (d, c >> 7) <= (0x72, 0)
    assert (b >> 1, 2 * (d - 0x40) + (c >> 7)) == (rumble_amplitude(high), rumble_amplitude(low))


def test_a_frame_of_22_actuators_is_packed_in_far_less_than_100_us():
    one = profile("glove22")
    packer, given_frame = Packer(one), frame(tuple(range(22)))
    best = min(spent(packer, given_frame) for _ in range(5))
    assert best / 200 < 100e-6 * slowness()


def spent(packer: Packer, given_frame: Frame) -> float:
    start = time.process_time()
    for _ in range(200):
        packer.pack(given_frame)
    return time.process_time() - start


def test_reports_are_new_bytes_each_time():
    packer = Packer(profile("glove5"))
    first = packer.pack(frame((1, 2, 3, 4, 5)))[0].data
    kept = bytes(first)
    packer.neutral()
    assert first == kept
