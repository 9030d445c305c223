"""hapfmt info --follow: a line for each look at a file that grows."""

from __future__ import annotations

import sys
import time
from typing import Any

from ..errors import ParameterError
from ..numbers import counted
from ..reading.follow import Follower
from .common import echo_json, tell_some
from .screen import clipped, raw, say, width_of


def follow_file(file: str, interval: float, as_json: bool) -> int:
    """Until the file is closed, or until Ctrl-C, which is no failure."""
    if file == "-":
        raise ParameterError("--follow requires a file name, not a pipe")
    with Follower(file, interval=interval) as follower:
        size, moment = 0, 0.0
        try:
            while True:
                for _ in follower.poll():
                    pass
                now = time.monotonic()
                rate = (follower.source.size - size) / (now - moment) if moment else None
                size, moment = follower.source.size, now
                show(describe(follower, rate), as_json)
                if follower.closed:
                    break
                follower.stopped.wait(interval)
        except KeyboardInterrupt:
            pass
        if sys.stdout.isatty() and not as_json:
            say()
        findings = follower.catalogue.findings
        if not as_json:
            tell_some([f"{file}: {finding}" for finding in findings])
        return follower.catalogue.exit_code


def describe(follower: Follower, rate: float | None) -> dict[str, Any]:
    """What --json prints; the rate in bytes a second since the line before."""
    return {
        "duration_s": float(follower.duration),
        "cluster_count": follower.cluster_count,
        "track_count": len(follower.catalogue.tracks),
        "file_size": follower.source.size,
        "bytes_per_s": rate,
        "last_cluster_age_s": max(time.time() - follower.cluster_at, 0.0),
        "closed": follower.closed,
        "restarts": follower.restarts,
        "finding_count": len(follower.catalogue.findings),
        "exit_code": follower.catalogue.exit_code,
    }


def show(found: dict[str, Any], as_json: bool) -> None:
    if as_json:
        echo_json(found)
        sys.stdout.flush()
        return
    rate = "-" if found["bytes_per_s"] is None else f"{found['bytes_per_s']:.0f}"
    state = "closed" if found["closed"] else f"last {found['last_cluster_age_s']:.1f} s ago"
    text = (
        f"{found['duration_s']:.3f} s, {counted(found['cluster_count'], 'cluster')}, "
        f"{found['file_size']} bytes, {rate} bytes/s, {state}"
    )
    width = width_of()
    if width is None:
        say(text)
    else:
        # On a terminal one line is written again and again.
        raw("\r\x1b[K" + clipped(text, width))
    sys.stdout.flush()
