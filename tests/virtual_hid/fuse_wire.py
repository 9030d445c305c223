"""The protocol of /dev/fuse as far as one file needs it: include/uapi/linux/fuse.h, 7.38."""

from __future__ import annotations

import os
import struct
import time
from typing import NamedTuple

FORGET, GETATTR, SETATTR, OPEN, READ, WRITE = 2, 3, 4, 14, 15, 16
RELEASE, FSYNC, FLUSH, INIT, ACCESS, INTERRUPT = 18, 20, 25, 26, 34, 36
DESTROY, IOCTL, POLL, BATCH_FORGET = 38, 39, 40, 42
WITHOUT_ANSWER = (FORGET, BATCH_FORGET)

FOPEN_DIRECT_IO, FOPEN_STREAM, FOPEN_PARALLEL_DIRECT_WRITES = 1 << 0, 1 << 4, 1 << 6
NOTIFY_POLL = 1
POLL_SCHEDULE_NOTIFY = 1
BIG_WRITES = 1 << 5
LARGEST = 1 << 17
SIZE = 1 << 30  # of the file: writes that end within it may run side by side

IN = struct.Struct("<IIQQIIIHH")
OUT = struct.Struct("<IiQ")
ATTRIBUTES = struct.Struct("<6Q10I")
WRITE_IN = struct.Struct("<QQIIQII")
READ_IN = struct.Struct("<QQIIQII")
IOCTL_IN = struct.Struct("<QIIQII")
POLL_IN = struct.Struct("<QQII")


class Request(NamedTuple):
    length: int
    opcode: int
    ticket: int
    node: int
    uid: int
    gid: int
    pid: int
    """Of the thread."""
    extra: int
    padding: int


def request(data: bytes) -> tuple[Request, bytes]:
    head = Request(*IN.unpack_from(data))
    return head, data[IN.size : head.length]


def answer(ticket: int, body: bytes = b"", error: int = 0) -> bytes:
    return OUT.pack(OUT.size + len(body), -error, ticket) + body


def woken(poller: int) -> bytes:
    """A notification, of no request: the poller should ask again."""
    return OUT.pack(OUT.size + 8, NOTIFY_POLL, 0) + struct.pack("<Q", poller)


def init() -> bytes:
    return struct.pack(
        "<IIIIHHIIHHI7I", 7, 38, 0, BIG_WRITES, 16, 12, LARGEST, 1, 32, 0, 0, *[0] * 7
    )


def attributes(owner: tuple[int, int]) -> bytes:
    """Of a regular file: FUSE passes ioctl to no device node. Good for an hour."""
    now = int(time.time())
    stat = ATTRIBUTES.pack(1, SIZE, 0, now, now, now, 0, 0, 0, 0o100666, 1, *owner, 0, 4096, 0)
    return struct.pack("<QII", 3600, 0, 0) + stat


def opened(handle: int) -> bytes:
    """No page cache, no position, and writes of several handles side by side, as hidraw has it."""
    flags = FOPEN_DIRECT_IO | FOPEN_STREAM | FOPEN_PARALLEL_DIRECT_WRITES
    return struct.pack("<QII", handle, flags, 0)


class Ioctl(NamedTuple):
    """Of <linux/hidraw.h>: the letter, the number and the size that the code has in it."""

    letter: str
    number: int
    size: int


def ioctl(code: int) -> Ioctl:
    return Ioctl(chr(code >> 8 & 0xFF), code & 0xFF, code >> 16 & 0x3FFF)


def ioctl_result(result: int, data: bytes) -> bytes:
    return struct.pack("<iIII", result, 0, 0, 0) + data


def may_wait(read_flags: int) -> bool:
    return not read_flags & os.O_NONBLOCK
