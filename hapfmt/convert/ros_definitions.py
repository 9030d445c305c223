"""Definitions of ROS messages as texts -> types, by rosbags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from ..errors import MissingExtraError, ParameterError
from .common import refusing
from .ros_layout import Types

try:
    from rosbags.typesys import (
        Stores,
        TypesysError,
        get_types_from_idl,
        get_types_from_msg,
        get_typestore,
    )
except ImportError:
    raise MissingExtraError("rosbags", "ros") from None

_DEFINITION_LIMIT = 1 << 18
"""Characters of a definition."""


def default_types(kind: str) -> Types:
    """For files without definitions."""
    types: Types = _common().fielddefs
    if kind not in types:
        raise ParameterError("the file does not define its type; record it as MCAP")
    return types


def parsed(text: str, kind: str, language: str) -> Types:
    """The types of a definition, msg or idl."""
    if len(text) > _DEFINITION_LIMIT:
        raise ParameterError("the definition of its type is too long")
    with refusing("the definition of its type", TypesysError, AssertionError, RuntimeError):
        if language == "idl":
            types: Mapping[str, Any] = get_types_from_idl(text)
        else:
            # rosbags takes long for empty lines and comments.
            lines = [line for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
            types = get_types_from_msg("\n".join(lines), kind)
    if kind not in types:
        raise ParameterError("the file does not define its type")
    return types


@cache
def _common() -> Any:
    return get_typestore(Stores.ROS2_HUMBLE)


def definition(kind: str, fields: Sequence[tuple[str, str]] = ()) -> tuple[Types, str]:
    """The types and the text of a definition of ROS 2: of a common type, or of one with a header
    and these ``fields``, (type, name)."""
    if not fields:
        return _common().fielddefs, _common().generate_msgdef(kind, ros_version=2)[0]
    header: str = _common().generate_msgdef("std_msgs/msg/Header", ros_version=2)[0]
    lines = ["std_msgs/Header header", *(f"{type_} {name}" for type_, name in fields), "=" * 80]
    text = "\n".join([*lines, f"MSG: std_msgs/Header\n{header}"])
    return get_types_from_msg(text, kind), text
