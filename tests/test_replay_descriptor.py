"""HID report descriptors: what devices say of their reports, and what hostile bytes do."""

from __future__ import annotations

import random

import hid_descriptors as hd
import pytest
from hid_descriptors import device, field, item, long_item
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.errors import DeviceError
from hapfmt.replay.profile.matching import (
    DEPTH_LIMIT,
    DESCRIPTOR_LIMIT,
    REPORT_LIMIT,
    Descriptor,
    of_hex,
    parse_descriptor,
)

KINDS = {"input": hd.INPUT, "output": hd.OUTPUT, "feature": hd.FEATURE}


class TestDevices:
    """The reports that a profile needs, as public documentation gives them."""

    def test_glove(self):
        assert parse_descriptor(hd.GLOVE5) == Descriptor({("output", 1): 12}, True, ((0xFF00, 1),))

    def test_dualsense_by_usb(self):
        found = parse_descriptor(hd.DUALSENSE_USB)
        assert found.of_kind("output") == {0x02: 48}
        assert found.lengths["feature", 0x05] == 41
        assert found.lengths["input", 1] == 64
        assert found.usages == ((1, 5),)

    def test_dualsense_by_bluetooth(self):
        found = parse_descriptor(hd.DUALSENSE_BLUETOOTH)
        assert found.of_kind("output") == {
            0x31: 78, 0x32: 142, 0x33: 206, 0x34: 270, 0x35: 334, 0x36: 398, 0x37: 462, 0x38: 526, 0x39: 547,
        }  # fmt: skip
        assert found.lengths["input", 0x31] == 78  # an id may stand for a report of each kind

    def test_joycon(self):
        found = parse_descriptor(hd.JOYCON)
        assert found.of_kind("output") == dict.fromkeys((0x01, 0x10, 0x11, 0x12), 49)
        assert found.lengths["input", 0x31] == 362

    def test_xbox_by_bluetooth(self):
        """Two nibbles make a byte; a collection within another is no usage of the device."""
        found = parse_descriptor(hd.XBOX_BLUETOOTH)
        assert found.of_kind("output") == {3: 9}
        assert found.usages == ((1, 5),)

    def test_keyboard(self):
        found = parse_descriptor(hd.KEYBOARD)
        assert found == Descriptor({("input", 0): 9, ("output", 0): 2}, False, ((1, 6),))


class TestItems:
    def test_nothing_is_a_device_without_reports(self):
        assert parse_descriptor(b"") == Descriptor({}, False, ())

    @pytest.mark.parametrize("size", [1, 2, 4])
    def test_values_of_every_size(self, size):
        data = (
            item(hd.SIZE, 8, size)
            + item(hd.COUNT, 3, size)
            + item(hd.ID, 7, size)
            + item(hd.OUTPUT)
        )
        assert parse_descriptor(data).lengths == {("output", 7): 4}

    def test_an_empty_value_is_zero(self):
        data = item(hd.SIZE, 8) + item(hd.COUNT, 0, 0) + item(hd.OUTPUT)
        assert parse_descriptor(data).lengths == {("output", 0): 1}

    def test_globals_begin_at_zero(self):
        data = (
            item(hd.OUTPUT)
            + item(hd.COUNT, 3)
            + item(hd.OUTPUT)
            + item(hd.COUNT, 0)
            + item(hd.SIZE, 8)
            + item(hd.OUTPUT)
        )
        assert parse_descriptor(data).lengths == {("output", 0): 1}
        assert parse_descriptor(item(hd.SIZE, 8) + item(hd.OUTPUT)).lengths == {("output", 0): 1}
        assert parse_descriptor(item(hd.USAGE, 5) + item(hd.COLLECTION) + item(hd.END)).usages == (
            (0, 5),
        )

    def test_globals_hold_until_they_change(self):
        data = (
            item(hd.SIZE, 8)
            + item(hd.COUNT, 2)
            + 3 * item(hd.OUTPUT, 2)
            + item(hd.COUNT, 5)
            + item(hd.INPUT, 2)
        )
        assert parse_descriptor(data).lengths == {("output", 0): 7, ("input", 0): 6}

    def test_reports_may_come_in_pieces(self):
        data = b"".join(field(hd.OUTPUT, 1, number=number) for number in (1, 2, 1, 2, 1))
        assert parse_descriptor(data).lengths == {("output", 1): 4, ("output", 2): 3}

    def test_bits_are_rounded_up_at_the_end_only(self):
        data = item(hd.SIZE, 3) + item(hd.COUNT, 1) + 3 * item(hd.FEATURE, 2)
        assert parse_descriptor(data).lengths == {("feature", 0): 3}

    def test_push_and_pop(self):
        data = (
            item(hd.ID, 1) + item(hd.SIZE, 8) + item(hd.COUNT, 4)
            + item(hd.PUSH) + item(hd.ID, 2) + item(hd.SIZE, 16) + item(hd.PUSH) + item(hd.COUNT, 1) + item(hd.OUTPUT)
            + item(hd.POP) + item(hd.OUTPUT) + item(hd.POP) + item(hd.OUTPUT)
        )  # fmt: skip
        assert parse_descriptor(data).lengths == {("output", 2): 11, ("output", 1): 5}

    def test_long_items_are_passed_over(self):
        """Whatever is in them: here what would be an output report."""
        hidden = field(hd.OUTPUT, 9)
        data = (
            long_item(0xF0, hidden)
            + long_item(0xF1, b"")
            + device(1, 4, field(hd.OUTPUT, 1))
            + long_item(0xFF, b"\xc0")
        )
        assert parse_descriptor(data) == Descriptor({("output", 0): 2}, False, ((1, 4),))

    @pytest.mark.parametrize("prefix", [0x00, 0x70, 0xD0, 0xF0, 0xC4, 0xF4, 0xB8, 0xF8, 0x0C, 0xFC])
    def test_items_without_a_meaning_are_passed_over(self, prefix):
        """Reserved tags of each type, and the reserved type."""
        inside = item(prefix) + item(prefix, 5, 1) + item(prefix, 5, 2) + item(prefix, 5, 4)
        assert parse_descriptor(device(1, 4, inside, field(hd.OUTPUT, 1), inside)).lengths == {
            ("output", 0): 2
        }

    def test_the_ids_of_some_reports_are_ids_for_all(self):
        data = field(hd.INPUT, 1) + field(hd.OUTPUT, 1, number=3)
        assert parse_descriptor(data).uses_ids


class TestUsages:
    def test_each_top_level_collection(self):
        assert parse_descriptor(device(1, 2) + device(0xFF00, 3)).usages == ((1, 2), (0xFF00, 3))

    def test_a_usage_of_four_bytes_brings_its_page(self):
        data = (
            item(hd.PAGE, 1)
            + item(hd.USAGE, 0xFF42_0007, 4)
            + item(hd.COLLECTION, 1)
            + item(hd.END)
        )
        assert parse_descriptor(data).usages == ((0xFF42, 7),)

    def test_the_page_may_come_after_the_usage(self):
        data = item(hd.USAGE, 5) + item(hd.PAGE, 1) + item(hd.COLLECTION, 1) + item(hd.END)
        assert parse_descriptor(data).usages == ((1, 5),)

    def test_several_usages_of_a_collection(self):
        """Linux takes the first, hidapi the last."""
        data = (
            item(hd.PAGE, 1)
            + item(hd.USAGE, 5)
            + item(hd.USAGE, 4)
            + item(hd.COLLECTION, 1)
            + item(hd.END)
        )
        assert parse_descriptor(data).usages == ((1, 5), (1, 4))

    def test_a_range_of_usages_begins_with_its_first(self):
        data = (
            item(hd.PAGE, 1)
            + item(hd.USAGE_MINIMUM, 4)
            + item(hd.USAGE_MAXIMUM, 9)
            + item(hd.COLLECTION, 1)
            + item(hd.END)
        )
        assert parse_descriptor(data).usages == ((1, 4),)

    def test_usages_end_with_their_main_item(self):
        data = (
            item(hd.PAGE, 1)
            + item(hd.USAGE, 5)
            + item(hd.INPUT)
            + item(hd.COLLECTION, 1)
            + item(hd.END)
        )
        assert parse_descriptor(data).usages == ((1, 0),)


FAULTS = {
    "an item without its value": (item(hd.SIZE, 8)[:1], 0, "ends within an item"),
    "a value of four bytes cut": (item(hd.PAGE, 1) + item(hd.COUNT, 9, 4)[:4], 2, "ends within an item"),
    "a long item without a size": (b"\xfe", 0, "ends within an item"),
    "a long item without a tag": (b"\xfe\x00", 0, "ends within an item"),
    "a long item cut": (long_item(1, b"abc")[:-1], 0, "ends within an item"),
    "report id 0": (item(hd.ID, 0, 1), 0, "report id 0 is not 1 to 255"),
    "report id 256": (item(hd.ID, 256), 0, "report id 256 is not 1 to 255"),
    "a pop too many": (item(hd.PUSH) + 2 * item(hd.POP), 2, "a pop without a push"),
    "an end too many": (device(1, 1) + item(hd.END), 7, "ends that did not begin"),
    "no end": (device(1, 1)[:-1], 6, "ends within a collection"),
    "pushed too often": ((DEPTH_LIMIT + 1) * item(hd.PUSH), DEPTH_LIMIT, "pushed states"),
    "collections too deep": ((DEPTH_LIMIT + 1) * item(hd.COLLECTION), DEPTH_LIMIT, "collections within"),
    "a report too long": (
        item(hd.SIZE, 8) + item(hd.COUNT, REPORT_LIMIT) + item(hd.OUTPUT) + item(hd.COUNT, 1) + item(hd.OUTPUT),
        8,
        f"output report 0x00 has more than {REPORT_LIMIT} bytes",
    ),
    "the largest numbers": (
        item(hd.SIZE, 0xFFFF_FFFF) + item(hd.COUNT, 0xFFFF_FFFF) + item(hd.FEATURE),
        10,
        "feature report 0x00 has more than",
    ),
    "too long": (bytes(DESCRIPTOR_LIMIT + 1), 0, f"{DESCRIPTOR_LIMIT + 1} bytes"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_faults_tell_what_and_where(name):
    data, offset, text = FAULTS[name]
    with pytest.raises(DeviceError, match="report descriptor: ") as caught:
        parse_descriptor(data)
    assert text in str(caught.value)
    assert caught.value.offset == offset


def test_the_longest_descriptor_and_report_are_taken():
    assert parse_descriptor(bytes(DESCRIPTOR_LIMIT)).lengths == {}
    data = item(hd.SIZE, 8) + item(hd.COUNT, REPORT_LIMIT) + item(hd.OUTPUT)
    assert parse_descriptor(data).lengths == {("output", 0): REPORT_LIMIT + 1}


FIELDS = st.tuples(
    st.sampled_from(sorted(KINDS)), st.integers(1, 255), st.integers(0, 64), st.integers(0, 40)
)
NOISE = st.one_of(
    st.builds(long_item, st.integers(0, 255), st.binary(max_size=20)),
    st.builds(item, st.sampled_from([0x14, 0x24, 0x34, 0x44, 0x54, 0x64, 0x38, 0x78, 0xD0]), st.integers(0, 2**32 - 1)),
    st.just(item(hd.PUSH) + item(hd.SIZE, 77) + item(hd.ID, 99) + item(hd.POP)),
)  # fmt: skip


@given(st.lists(st.tuples(FIELDS, NOISE), max_size=30))
def test_what_was_built_is_found(built):
    """Lengths by kind and id, whatever stands between the fields."""
    data, bits = b"", {}
    for (kind, number, size, count), noise in built:
        data += field(KINDS[kind], count, number=number, size=size) + noise
        bits[kind, number] = bits.get((kind, number), 0) + size * count
    found = parse_descriptor(device(1, 5, data))
    assert found.lengths == {key: 1 + (size + 7) // 8 for key, size in bits.items()}
    assert found.usages == ((1, 5),)


@pytest.mark.capped
@given(
    st.one_of(
        st.binary(max_size=200),
        st.lists(
            st.sampled_from(
                [
                    b"\xa4",
                    b"\xb4",
                    b"\xa1\x01",
                    b"\xc0",
                    b"\x91\x02",
                    b"\x75\xff",
                    b"\x97\xff\xff\xff\x7f",
                    b"\x85\x01",
                    b"\xfe\x02",
                ]
            ),
            max_size=60,
        ).map(b"".join),
    )
)
def test_any_bytes_give_a_value_or_our_error(data):
    judge(data)


@pytest.mark.capped
def test_real_descriptors_with_changed_bytes():
    """Every prefix, every byte changed, and a few thousand with several changes."""
    chance = random.Random(6)
    for whole in (hd.DUALSENSE_BLUETOOTH, hd.JOYCON, hd.XBOX_BLUETOOTH, hd.KEYBOARD):
        for place in range(len(whole)):
            judge(whole[:place])
            for value in (0, 0xFE, 0xFF, whole[place] ^ 1, whole[place] ^ 0x80):
                judge(whole[:place] + bytes([value]) + whole[place + 1 :])
        for _ in range(500):
            data = bytearray(whole)
            for _ in range(chance.randint(2, 8)):
                data[chance.randrange(len(data))] = chance.randrange(256)
            judge(bytes(data))


def judge(data: bytes) -> None:
    try:
        found = parse_descriptor(data)
    except DeviceError as error:
        assert error.offset is not None and 0 <= error.offset <= len(data)
        return
    assert all(1 <= size <= REPORT_LIMIT + 1 for size in found.lengths.values())
    assert all(0 <= number <= 255 for _, number in found.lengths)
    assert all(0 <= page <= 0xFFFF and 0 <= usage <= 0xFFFF for page, usage in found.usages)
    assert len(found.lengths) + len(found.usages) <= len(data)


class TestHex:
    @pytest.mark.parametrize(
        "text",
        [
            "0501a100",
            "05 01\nA1 00\n",
            "0x05, 0x01, 0xA1, 0x00",
            "05 01 // page\na1 00  # none",
            "0x05,0x01,0xa1,0x00,",
        ],
    )
    def test_as_people_write_it(self, text):
        assert of_hex(text) == b"\x05\x01\xa1\x00"

    @pytest.mark.parametrize("text", ["0x5", "hello", "05 0", "05 01 é"])
    def test_what_is_no_hex(self, text):
        with pytest.raises(ValueError, match="hex"):
            of_hex(text)


def test_of_kind_is_in_order():
    found = Descriptor({("output", 3): 1, ("input", 2): 4, ("output", 1): 2}, True, ())
    assert list(found.of_kind("output").items()) == [(1, 2), (3, 1)]
