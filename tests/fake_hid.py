"""A module like hidapi's, for what a real device does seldom: it writes down every call."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from contextlib import contextmanager
from types import ModuleType
from typing import Any

PATH = b"/dev/hidraw7"


class FakeHid(ModuleType):
    """``answers``: name of a call -> what it does instead of succeeding: a function of its
    arguments."""

    def __init__(
        self,
        name: str = "hidraw",
        descriptor: bytes = b"",
        entries: list[dict[str, Any]] | None = None,
    ):
        super().__init__(name)
        self.descriptor = descriptor
        self.entries = [] if entries is None else entries
        self.calls: list[tuple[Any, ...]] = []
        self.answers: dict[str, Callable[..., Any]] = {}
        self.objects = 0
        self.under_way = threading.Lock()

        class Device(FakeDevice):
            module = self

        self.device = Device

    def enumerate(self, *_: int) -> list[dict[str, Any]]:
        if "enumerate" in self.answers:
            return self.answers["enumerate"]()
        return self.entries

    @property
    def sent(self) -> list[tuple[str, bytes]]:
        return [
            (call[0], call[1]) for call in self.calls if call[0] in ("write", "send_feature_report")
        ]

    @property
    def names(self) -> list[str]:
        return [call[0] for call in self.calls]


class FakeDevice:
    """As the wheel's: opened once, and never two calls at a time."""

    module: FakeHid

    def __init__(self) -> None:
        self.module.objects += 1
        self.state = "new"

    def call(self, name: str, *arguments: Any, done: Any = None) -> Any:
        assert self.module.under_way.acquire(blocking=False), f"{name} during another call"
        try:
            self.module.calls.append((name, *arguments))
            answer = self.module.answers.get(name)
            return done if answer is None else answer(*arguments)
        finally:
            self.module.under_way.release()

    def open_path(self, path: bytes) -> None:
        assert isinstance(path, bytes)
        assert self.state == "new", "an object cannot be opened again"
        self.call("open_path", path)
        self.state = "open"

    def write(self, data: bytes) -> int:
        assert self.state == "open"
        return self.call("write", bytes(data), done=len(data))

    def send_feature_report(self, data: bytes) -> int:
        assert self.state == "open"
        return self.call("send_feature_report", bytes(data), done=len(data))

    def get_report_descriptor(self) -> list[int]:
        assert self.state == "open"
        return self.call("get_report_descriptor", done=list(self.module.descriptor))

    def error(self) -> str:
        return self.call("error", done="Success")

    def close(self) -> None:
        self.call("close")
        self.state = "closed"


def entry(path: bytes = PATH, **others: Any) -> dict[str, Any]:
    """As ``enumerate`` gives them: a glove, but for what is said."""
    found: dict[str, Any] = {
        "path": path, "vendor_id": 0x1209, "product_id": 0xC0DE, "serial_number": "SN1",
        "release_number": 0x100, "manufacturer_string": "HapLab", "product_string": "Glove",
        "usage_page": 0xFF00, "usage": 1, "interface_number": 0, "bus_type": 1,
    }  # fmt: skip
    return found | others


@contextmanager
def installed(**modules: ModuleType | None):
    """``hid`` and ``hidraw`` as they are said to be; None: not there."""
    names = ("hid", "hidraw")
    before = {name: sys.modules.get(name) for name in names}
    missing = Missing({name for name in names if modules.get(name) is None})
    for name in names:
        sys.modules.pop(name, None)
        if modules.get(name) is not None:
            sys.modules[name] = modules[name]
    sys.meta_path.insert(0, missing)
    try:
        yield
    finally:
        sys.meta_path.remove(missing)
        for name, module in before.items():
            sys.modules.pop(name, None)
            if module is not None:
                sys.modules[name] = module


class Missing:
    """Finds these modules nowhere, whatever is installed."""

    def __init__(self, names: set[str]):
        self.names = names

    def find_spec(self, name: str, *_: object) -> None:
        if name in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
