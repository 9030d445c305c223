"""The clock of a replay: steady, fine, and it goes on while the machine sleeps.

A replay over a suspend is then a stall like any other, and not a force that goes on next morning.
"""

from __future__ import annotations

import sys
import time

if sys.platform == "linux":

    def clock() -> int:
        """Nanoseconds."""
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)

elif sys.platform == "darwin":

    def clock() -> int:
        """Nanoseconds; this one counts sleep there, and ``time.monotonic`` does not."""
        return time.clock_gettime_ns(time.CLOCK_MONOTONIC)

else:
    # On Windows time.monotonic has steps of 15.6 ms before Python 3.13.
    clock = time.perf_counter_ns


def seconds() -> float:
    return clock() / 1e9
