"""A HID report descriptor: bytes -> which reports a device has, and how long they are.

Format: USB Device Class Definition for Human Interface Devices 1.11, clauses 5.3 to 6.2.2. Items
stand one after the other: a byte of size, type and tag, then 0, 1, 2 or 4 bytes of data. *Global*
items (size of a field, number of fields, report id ...) hold until they are changed, *local* ones
(usages) until the next *main* item, which is a run of fields or the border of a collection.

The bytes come from a device, and nothing about them is trusted: whatever they are gives a value or
a DeviceError with its place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, NoReturn

from ...errors import DeviceError

Kind = Literal["input", "output", "feature"]

DESCRIPTOR_LIMIT = 4096
"""Bytes; as in Linux (HID_MAX_DESCRIPTOR_SIZE)."""
REPORT_LIMIT = 16384
"""Bytes of a report; as in Linux (HID_MAX_BUFFER_SIZE)."""
DEPTH_LIMIT = 64
"""Of collections within collections, and of pushed states."""

DATA_SIZES = (0, 1, 2, 4)
LONG_ITEM = 0xFE
MAIN, GLOBAL, LOCAL = 0, 1, 2
FIELDS: dict[int, Kind] = {0x8: "input", 0x9: "output", 0xB: "feature"}
COLLECTION, END_COLLECTION = 0xA, 0xC
USAGE_PAGE, REPORT_SIZE, REPORT_ID, REPORT_COUNT, PUSH, POP = 0x0, 0x7, 0x8, 0x9, 0xA, 0xB
USAGE, USAGE_MINIMUM = 0x0, 0x1


class Item(NamedTuple):
    offset: int
    type: int
    tag: int
    value: int
    size: int
    """Of the value, in bytes."""


class Globals(NamedTuple):
    usage_page: int = 0
    report_size: int = 0
    report_count: int = 0
    report_id: int = 0


@dataclass(frozen=True)
class Descriptor:
    """``lengths`` in bytes by kind and report id, as hidapi takes and gives them: with a first
    byte for the id, which is 0 where the device uses none. ``usages``: page and usage of each
    top-level collection, in their order; a collection may have several."""

    lengths: dict[tuple[Kind, int], int]
    uses_ids: bool
    usages: tuple[tuple[int, int], ...]

    def of_kind(self, kind: Kind) -> dict[int, int]:
        """Report id -> length."""
        found = {number: size for (each, number), size in self.lengths.items() if each == kind}
        return dict(sorted(found.items()))


def fail(message: str, offset: int) -> NoReturn:
    raise DeviceError(f"report descriptor: {message}", offset=offset)


def items_of(data: bytes) -> list[Item]:
    """The items; long ones, which no standard gives a meaning to, are left out."""
    if len(data) > DESCRIPTOR_LIMIT:
        fail(f"{len(data)} bytes, but {DESCRIPTOR_LIMIT} are the most", 0)
    found = []
    at = 0
    while at < len(data):
        prefix = data[at]
        if prefix == LONG_ITEM:
            if at + 1 == len(data):
                fail("it ends within an item", at)
            size, data_at = data[at + 1], at + 3
        else:
            size, data_at = DATA_SIZES[prefix & 3], at + 1
        stop = data_at + size
        if stop > len(data):
            fail("it ends within an item", at)
        if prefix != LONG_ITEM:
            value = int.from_bytes(data[data_at:stop], "little")
            found.append(Item(at, prefix >> 2 & 3, prefix >> 4, value, size))
        at = stop
    return found


def parse_descriptor(data: bytes) -> Descriptor:
    """DeviceError where an item is cut off, a collection or a pushed state is not closed or was
    not open, a report id is none, or a report is longer than any that can be sent."""
    state = Globals()
    pushed: list[Globals] = []
    local: list[Item] = []
    depth = 0
    bits: dict[tuple[Kind, int], int] = {}
    uses_ids = False
    usages: list[tuple[int, int]] = []
    for item in items_of(data):
        if item.type == MAIN:
            if kind := FIELDS.get(item.tag):
                add_fields(bits, kind, state, item.offset)
            elif item.tag == COLLECTION:
                if depth == DEPTH_LIMIT:
                    fail(f"more than {DEPTH_LIMIT} collections within one another", item.offset)
                if not depth:
                    page = state.usage_page
                    usages += [full_usage(page, each) for each in local] or [(page, 0)]
                depth += 1
            elif item.tag == END_COLLECTION:
                if not depth:
                    fail("a collection ends that did not begin", item.offset)
                depth -= 1
            local.clear()
        elif item.type == GLOBAL:
            if item.tag == PUSH:
                if len(pushed) == DEPTH_LIMIT:
                    fail(f"more than {DEPTH_LIMIT} pushed states", item.offset)
                pushed.append(state)
            elif item.tag == POP:
                if not pushed:
                    fail("a pop without a push", item.offset)
                state = pushed.pop()
            else:
                state = changed(state, item)
                uses_ids = uses_ids or item.tag == REPORT_ID
        elif item.type == LOCAL and item.tag in (USAGE, USAGE_MINIMUM):
            # Of several before a collection Linux takes the first and hidapi the last: all count.
            local.append(item)
    if depth:
        fail("it ends within a collection", len(data))
    lengths = {key: 1 + -(-size // 8) for key, size in bits.items()}
    return Descriptor(lengths, uses_ids, tuple(usages))


def changed(state: Globals, item: Item) -> Globals:
    """The state after a global item other than push and pop."""
    if item.tag == USAGE_PAGE:
        return state._replace(usage_page=item.value & 0xFFFF)
    if item.tag == REPORT_SIZE:
        return state._replace(report_size=item.value)
    if item.tag == REPORT_COUNT:
        return state._replace(report_count=item.value)
    if item.tag == REPORT_ID:
        if not 1 <= item.value <= 255:
            fail(f"report id {item.value} is not 1 to 255", item.offset)
        return state._replace(report_id=item.value)
    return state  # ranges and units: nothing that bears on lengths


def add_fields(bits: dict[tuple[Kind, int], int], kind: Kind, state: Globals, offset: int) -> None:
    key = (kind, state.report_id)
    size = bits.get(key, 0) + state.report_size * state.report_count
    if size > 8 * REPORT_LIMIT:
        fail(f"{kind} report 0x{state.report_id:02x} has more than {REPORT_LIMIT} bytes", offset)
    bits[key] = size


def full_usage(page: int, usage: Item) -> tuple[int, int]:
    """A usage of four bytes brings its own page in the upper two."""
    if usage.size == 4:
        return usage.value >> 16, usage.value & 0xFFFF
    return page, usage.value


def of_hex(text: str) -> bytes:
    """Bytes as people write them: ``05 01``, ``0x05, 0x01``, one run, ``//`` and ``#`` comments."""
    lines = [line.split("//")[0].split("#")[0] for line in text.splitlines()]
    words = " ".join(lines).replace(",", " ").replace(";", " ").split()
    return bytes.fromhex("".join(word.lower().removeprefix("0x") for word in words))
