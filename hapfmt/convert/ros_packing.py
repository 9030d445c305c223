"""Numbers -> messages of ROS 2 (CDR), many at a time, by NumPy.

All messages of a topic have one layout. A template holds what is the same in all of them; the
numbers are put into copies of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .ros_layout import ARRAY, BASE, DURATION, NAME, NUMBERS, TIME, Types

Content = Mapping[str, Any]
"""By path: a text, a list of texts, the count of numbers of an array, or a number."""


class MessageTemplate:
    """Messages of a type. ``content`` is what is the same in all of them; paths that it does not
    have are 0 or empty."""

    def __init__(self, types: Types, kind: str, content: Content) -> None:
        self.types = types
        self.content = content
        self.data = bytearray(b"\0\1\0\0")
        self.places: dict[str, tuple[int, np.dtype[Any]]] = {}
        """Offset and type of each number, by path."""
        self._structure(kind, "")

    def packed(self, values: Mapping[str, NDArray[Any]]) -> list[bytes]:
        """The messages. ``values``: [messages] of each path that differs."""
        count = len(next(iter(values.values())))
        size = len(self.data)
        rows = np.empty((count, size), np.uint8)
        rows[:] = np.frombuffer(self.data, np.uint8)
        for path, x in values.items():
            at, dtype = self.places[path]
            raw = np.ascontiguousarray(x, dtype).view(np.uint8).reshape(count, dtype.itemsize)
            rows[:, at : at + dtype.itemsize] = raw
        data = rows.tobytes()
        return [data[first : first + size] for first in range(0, count * size, size)]

    def _structure(self, kind: str, path: str) -> None:
        for name, description in self.types[kind][1]:
            self._field(description, f"{path}.{name}" if path else name)

    def _field(self, description: tuple[Any, Any], path: str) -> None:
        what, about = int(description[0].value), description[1]
        if what == BASE and about[0] == "string":
            self._text(str(self.content.get(path, "")))
        elif what == BASE:
            self._number(about[0], path)
        elif what == NAME and about in (TIME, DURATION):
            self._number("int32", f"{path}.sec")
            self._number("uint32", f"{path}.nanosec")
        elif what == NAME:
            self._structure(about, path)
        elif what == ARRAY:
            for place in range(int(about[1])):
                self._field(about[0], f"{path}[{place}]")
        else:
            self._sequence(about[0], path)

    def _sequence(self, member: tuple[Any, Any], path: str) -> None:
        held: int | Sequence[str] = self.content.get(path, 0)
        count = held if isinstance(held, int) else len(held)
        self._number("uint32", f"{path}.length", count)
        if not isinstance(held, int):
            for text in held:
                self._text(text)
        else:
            for place in range(count):
                self._field(member, f"{path}[{place}]")

    def _text(self, text: str) -> None:
        raw = text.encode("utf-8", "replace") + b"\0"
        self._number("uint32", "", len(raw))
        self.data += raw

    def _number(self, kind: str, path: str, value: float = 0) -> None:
        dtype = np.dtype("<" + NUMBERS[kind])
        self.data += bytes(-(len(self.data) - 4) % dtype.itemsize)
        self.places[path] = (len(self.data), dtype)
        self.data += np.array(self.content.get(path, value), dtype).tobytes()
