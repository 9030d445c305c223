"""Definitions of ROS messages as texts -> types, by rosbags."""

from __future__ import annotations

from collections.abc import Mapping
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

_DEFINITION_LIMIT = 1 << 20
"""Characters of a definition."""


def default_types(kind: str) -> Types:
    """For files without definitions."""
    types: Types = get_typestore(Stores.ROS2_HUMBLE).fielddefs
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
            types = get_types_from_msg(text, kind)
    if kind not in types:
        raise ParameterError("the file does not define its type")
    return types
