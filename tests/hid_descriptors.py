"""Report descriptors for tests, item by item: the reports, ids and lengths of real devices.

What is public of those descriptors, and what these keep: the top-level usage and every output
report, with a few of the input and feature reports. Where the facts come from:

* DualSense: https://github.com/nondebug/dualsense (descriptors by USB and Bluetooth); its Edge:
  https://github.com/ShadowBlip/InputPlumber, src/drivers/dualsense/report_descriptor.rs.
* Joy-Con: https://switchbrew.org/wiki/Joy-Con ("HID Input Report Descriptor").
* Xbox One S and Series X|S by Bluetooth: https://github.com/atar-axis/xpadneo, docs/descriptors.
"""

from __future__ import annotations

INPUT, OUTPUT, FEATURE, COLLECTION, END = 0x80, 0x90, 0xB0, 0xA0, 0xC0
PAGE, SIZE, ID, COUNT, PUSH, POP = 0x04, 0x74, 0x84, 0x94, 0xA4, 0xB4
USAGE, USAGE_MINIMUM, USAGE_MAXIMUM = 0x08, 0x18, 0x28
APPLICATION, LOGICAL = 1, 2
VARIABLE, CONSTANT = 2, 3


def item(tag: int, value: int = 0, size: int | None = None) -> bytes:
    """A short item; its value in the fewest bytes, or in ``size``."""
    if size is None:
        size = next(each for each in (0, 1, 2, 4) if value < 1 << 8 * each)
    return bytes([tag | (0, 1, 2, 4).index(size)]) + value.to_bytes(size, "little")


def long_item(tag: int, data: bytes) -> bytes:
    return bytes([0xFE, len(data), tag]) + data


def field(
    kind: int, count: int, *, number: int | None = None, size: int = 8, usage: int = 1
) -> bytes:
    """A run of fields, in the report of that id."""
    about = b"" if number is None else item(ID, number)
    return (
        about + item(USAGE, usage, 1) + item(SIZE, size) + item(COUNT, count) + item(kind, VARIABLE)
    )


def device(page: int, usage: int, *fields: bytes) -> bytes:
    """One top-level collection."""
    return (
        item(PAGE, page)
        + item(USAGE, usage)
        + item(COLLECTION, APPLICATION)
        + b"".join(fields)
        + item(END)
    )


GLOVE5 = device(0xFF00, 1, field(OUTPUT, 11, number=1))
GLOVE22 = device(0xFF00, 2, field(OUTPUT, 45, number=2))

DUALSENSE_USB = device(
    1, 5,
    field(INPUT, 63, number=1),
    item(PAGE, 0xFF00),
    field(OUTPUT, 47, number=0x02, usage=0x23),
    field(FEATURE, 40, number=0x05, usage=0x33),
    field(FEATURE, 63, number=0x20, usage=0x26),
)  # fmt: skip

DUALSENSE_EDGE_USB = device(
    1, 5,
    field(INPUT, 63, number=1),
    item(PAGE, 0xFF00),
    field(OUTPUT, 63, number=0x02, usage=0x23),
)  # fmt: skip

DUALSENSE_BLUETOOTH_PAYLOADS = {
    0x31: 77, 0x32: 141, 0x33: 205, 0x34: 269, 0x35: 333, 0x36: 397, 0x37: 461, 0x38: 525, 0x39: 546,
}  # fmt: skip
DUALSENSE_BLUETOOTH = device(
    1, 5,
    field(INPUT, 9, number=1),
    item(PAGE, 0xFF00),
    *(field(OUTPUT, size, number=each, usage=each) for each, size in DUALSENSE_BLUETOOTH_PAYLOADS.items()),
    field(INPUT, 77, number=0x31, usage=0x3B),
    item(PAGE, 0xFF80),
    field(FEATURE, 40, number=0x05, usage=0x33),
) + b"\0"  # fmt: skip
"""With the byte after the end that the device has too: an item without a meaning."""

JOYCON = device(
    1, 5,
    item(PAGE, 0xFF01),
    field(INPUT, 48, number=0x21, usage=0x21),
    field(INPUT, 361, number=0x31, usage=0x31),
    *(field(OUTPUT, 48, number=each, usage=each) for each in (0x01, 0x10, 0x11, 0x12)),
)  # fmt: skip

XBOX_BLUETOOTH = device(
    1, 5,
    field(INPUT, 15, number=1),
    item(PAGE, 0x0F) + item(USAGE, 0x21) + item(ID, 3) + item(COLLECTION, LOGICAL),
    field(OUTPUT, 1, size=4, usage=0x97),
    item(SIZE, 4) + item(COUNT, 1) + item(OUTPUT, CONSTANT),
    field(OUTPUT, 4, usage=0x70),
    field(OUTPUT, 1, usage=0x50),
    field(OUTPUT, 1, usage=0xA7),
    field(OUTPUT, 1, usage=0x7C),
    item(END),
    field(INPUT, 1, number=4, usage=0x20),
) + b"\0"  # fmt: skip

KEYBOARD = (
    item(PAGE, 1) + item(USAGE, 6) + item(COLLECTION, APPLICATION)
    + item(PAGE, 7) + item(USAGE_MINIMUM, 0xE0) + item(USAGE_MAXIMUM, 0xE7)
    + item(SIZE, 1) + item(COUNT, 8) + item(INPUT, VARIABLE)
    + item(SIZE, 8) + item(COUNT, 1) + item(INPUT, CONSTANT)
    + item(PAGE, 8) + item(SIZE, 1) + item(COUNT, 5) + item(OUTPUT, VARIABLE)
    + item(SIZE, 3) + item(COUNT, 1) + item(OUTPUT, CONSTANT)
    + item(PAGE, 7) + item(SIZE, 8) + item(COUNT, 6) + item(INPUT, 0)
    + item(END)
)  # fmt: skip
"""A boot keyboard (HID 1.11, Appendix B.1): no report ids."""
