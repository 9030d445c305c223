"""hapfmt: the open file format for recorded touch.

    recording = hapfmt.load("touch.npz")
    hapfmt.write(recording, "touch.hapf")
    back = hapfmt.read("touch.hapf", channels=["force_z"], start=1.0, stop=2.0)

Nothing heavy is imported until it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .version import SPEC_VERSION, __version__

if TYPE_CHECKING:
    from .clocks import fit_clock
    from .container.clocks import ClockMap, ClockObservation
    from .convert import load, save
    from .encoder.settings import Settings
    from .errors import (
        ChecksumError,
        FormatError,
        HapfmtError,
        LimitError,
        MissingExtraError,
        ParameterError,
        TruncatedError,
        UnsupportedError,
    )
    from .events import Event
    from .limits import Limits
    from .live.inputs import Input
    from .live.recorder import Recorder
    from .live.status import Status
    from .reading.follow import Follower
    from .reading.reader import Reader, read
    from .recording import Calibration, Channel, Recording, Span
    from .recovery.inplace import recover_in_place
    from .recovery.recover import recover
    from .verifier import verify
    from .writer import write

_PLACES = {
    "Reader": "reading.reader",
    "read": "reading.reader",
    "Follower": "reading.follow",
    "write": "writer",
    "verify": "verifier",
    "recover": "recovery.recover",
    "recover_in_place": "recovery.inplace",
    "load": "convert",
    "save": "convert",
    "Settings": "encoder.settings",
    "Recorder": "live.recorder",
    "Input": "live.inputs",
    "Status": "live.status",
    "Recording": "recording",
    "Event": "events",
    "ClockObservation": "container.clocks",
    "ClockMap": "container.clocks",
    "fit_clock": "clocks",
    "Channel": "recording",
    "Calibration": "recording",
    "Span": "recording",
    "Limits": "limits",
    "HapfmtError": "errors",
    "FormatError": "errors",
    "TruncatedError": "errors",
    "ChecksumError": "errors",
    "UnsupportedError": "errors",
    "LimitError": "errors",
    "ParameterError": "errors",
    "MissingExtraError": "errors",
}

__all__ = [
    "SPEC_VERSION",
    "Calibration",
    "Channel",
    "ChecksumError",
    "ClockMap",
    "ClockObservation",
    "Event",
    "Follower",
    "FormatError",
    "HapfmtError",
    "Input",
    "LimitError",
    "Limits",
    "MissingExtraError",
    "ParameterError",
    "Reader",
    "Recorder",
    "Recording",
    "Settings",
    "Span",
    "Status",
    "TruncatedError",
    "UnsupportedError",
    "__version__",
    "fit_clock",
    "load",
    "read",
    "recover",
    "recover_in_place",
    "save",
    "verify",
    "write",
]


def __getattr__(name: str) -> Any:
    if name in _PLACES:
        return getattr(import_module(f".{_PLACES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
