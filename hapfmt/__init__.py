"""hapfmt: the open file format for recorded touch.

    rec = hapfmt.read("touch.hapf")                  # any format, by suffix or content
    newtons, seconds = rec["fx"].to_numpy(), rec["fx"].times()
    part = rec.sel(["fx", "fy"], start=1.0, stop=3.0)
    frame = rec.to_pandas()
    hapfmt.write(array, "out.hapf", rate=1000, labels=["fx", "fy"], units="N")

Nothing heavy is imported until it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .version import SPEC_VERSION, __version__

if TYPE_CHECKING:
    from .analysis.lazyframes import scan_hapf
    from .clocks import ClockMap, ClockObservation
    from .convert import load, read, save
    from .edit.recover import recover, recover_in_place
    from .encoder.live import Input
    from .encoder.settings import Settings
    from .errors import (
        ChecksumError,
        FormatError,
        HapfmtError,
        LimitError,
        MissingExtraError,
        ParameterError,
        TruncatedError,
        UnknownChannelError,
        UnsupportedError,
    )
    from .lab.plotting.pages import plot
    from .limits import Limits
    from .reading.clocks import fit_clock
    from .reading.follow import Follower
    from .reading.reader import Reader
    from .reading.verifier import verify
    from .recording import Calibration, Channel, Event, Recording, Span
    from .writing.recorder import Recorder, Status
    from .writing.writer import Summary, write

_PLACES = {
    "load": "convert",
    "read": "convert",
    "save": "convert",
    "recover": "edit.recover",
    "recover_in_place": "edit.recover",
    "Input": "encoder.live",
    "Settings": "encoder.settings",
    "ChecksumError": "errors",
    "FormatError": "errors",
    "HapfmtError": "errors",
    "LimitError": "errors",
    "MissingExtraError": "errors",
    "ParameterError": "errors",
    "TruncatedError": "errors",
    "UnknownChannelError": "errors",
    "UnsupportedError": "errors",
    "Event": "recording",
    "ClockMap": "clocks",
    "ClockObservation": "clocks",
    "Limits": "limits",
    "plot": "lab.plotting.pages",
    "fit_clock": "reading.clocks",
    "Follower": "reading.follow",
    "Reader": "reading.reader",
    "scan_hapf": "analysis.lazyframes",
    "verify": "reading.verifier",
    "Calibration": "recording",
    "Channel": "recording",
    "Recording": "recording",
    "Span": "recording",
    "Recorder": "writing.recorder",
    "Status": "writing.recorder",
    "Summary": "writing.writer",
    "write": "writing.writer",
}

_PACKAGES = {
    "edit": "edit",
    "errors": "errors",
    "metrics": "metrics",
    "scenes": "lab.scenes",
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
    "Summary",
    "TruncatedError",
    "UnknownChannelError",
    "UnsupportedError",
    "__version__",
    "fit_clock",
    "load",
    "plot",
    "read",
    "recover",
    "recover_in_place",
    "save",
    "scan_hapf",
    "verify",
    "write",
]


def __getattr__(name: str) -> Any:
    if name in _PLACES:
        return getattr(import_module(f".{_PLACES[name]}", __name__), name)
    if name in _PACKAGES:
        return import_module(f".{_PACKAGES[name]}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *_PACKAGES} - {"load"})
