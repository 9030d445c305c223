"""Destinations of frames. Each kind is imported when it is used."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from ...errors import ParameterError

if TYPE_CHECKING:
    from ..profile.model import FrameSink, Profile


def open_sink(config: dict[str, Any], profile: Profile | None = None) -> FrameSink:
    """An open sink: ``config`` is JSON, its ``kind`` and what that kind takes.

    {"kind": "hid", "path": ...} and {"kind": "loopback", "file": ...}. A ``profile`` is held
    against the device first. Raises DeviceError.
    """
    options = dict(config)
    kind = options.pop("kind", None)
    sink: FrameSink
    if kind == "hid":
        from .hid import HidSink

        sink = HidSink(os.fsencode(options.pop("path")), profile, **options)
    elif kind == "loopback":
        from .dry import LoopbackSink

        sink = LoopbackSink(**options)
    else:
        raise ParameterError(f"no sink for processes: {kind!r}")
    sink.open()
    return sink
