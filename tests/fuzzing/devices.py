"""What comes from devices, and what people write of them: report descriptors and profiles."""

from __future__ import annotations

from collections.abc import Iterable

import hid_descriptors as hd

from hapfmt.errors import DeviceError
from hapfmt.replay.profile.matching import (
    Descriptor,
    differences,
    of_hex,
    parse_descriptor,
    wanted_of,
)
from hapfmt.replay.profile.packing import Packer
from hapfmt.replay.profile.parse import load_profile, parse_profile

from .target import Target, settled

GLOVE = load_profile("glove5")
AWAY = 1 + 3 + 2
"""Bytes of a long item of three bytes."""


def parsed(data: bytes) -> Descriptor | int:
    """The reports, or where the error is."""
    try:
        return parse_descriptor(data)
    except DeviceError as error:
        assert error.offset is not None and 0 <= error.offset <= len(data)
        return error.offset


def descriptor(data: bytes) -> None:
    found = parsed(data)
    moved = parsed(hd.long_item(7, b"abc") + data)
    assert of_hex(data.hex(" ")) == data
    if isinstance(found, int):
        assert moved == found + AWAY
        return
    assert moved == found
    assert all(1 <= size <= 16385 for size in found.lengths.values())
    assert all(0 <= number <= 255 for _, number in found.lengths)
    assert len(found.lengths) + len(found.usages) <= len(data)
    fitting = found.lengths.get(("output", 1)) == 12 and (0xFF00, 1) in found.usages
    assert fitting == (not differences(GLOVE, found))


def profile(data: bytes) -> None:
    """What is taken may be played: it rests within its limits, and its reports have their length."""
    found = settled(lambda: parse_profile(data.decode("utf-8", "replace")))
    if found is None:
        return
    for limits in found.count_limits:
        assert limits.low <= limits.rest <= limits.high
        assert limits.change >= 1
    lengths = {(each.path, each.id, each.length) for each in wanted_of(found)}
    for report in Packer(found).neutral():
        assert (report.path, report.data[0], len(report.data)) in lengths
    assert differences(found, Descriptor({}, False, ()))


def of_descriptor() -> Iterable[bytes]:
    yield from (hd.GLOVE5, hd.DUALSENSE_USB, hd.DUALSENSE_BLUETOOTH, hd.JOYCON, hd.XBOX_BLUETOOTH)
    yield hd.KEYBOARD
    yield hd.long_item(1, b"x") + hd.item(hd.PUSH) + hd.GLOVE5 + hd.item(hd.POP) + hd.GLOVE5


SMALL = b"""name="a"
[[match]]
vendor_id=1
bus="usb"
[timing]
rate=100
frame_samples=2
[[actuator]]
name="x"
unit="N"
accepts={N=1,mN=0.001}
minimum=-1
maximum=1
rest=0
slew=50
step=0.01
[[report]]
path="output"
id=1
length=20
fields=[{at=1,counter="u8"},{at=2,samples=["x"],type="i8"},{at=5,const=[1,2]},{at=16,crc32={seed=162,from=0,to=16}}]
[[exit]]
path="feature"
data="02 00"
"""


def of_profile() -> Iterable[bytes]:
    yield SMALL
    yield SMALL.replace(b'{at=2,samples=["x"],type="i8"}', b'{at=2,actuator="x",type="i16be"}')
    yield SMALL[: SMALL.index(b"[[report]]")]


DEVICES = [
    Target("descriptor", descriptor, of_descriptor, size=1 << 9),
    Target("profile", profile, of_profile),
]
