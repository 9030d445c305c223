"""Members of the metadata, set in an existing file (SPEC 6.7)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..format.extras import build_metadata
from ..errors import ParameterError
from .appended import appended
from .making import Output
from .original import Input


def set_metadata(
    file: Input, members: Mapping[str, Any], out: Output | None = None, *, force: bool = False
) -> list[str]:
    """Append members, JSON values, that replace those of their name, to a file, or to a copy of it
    at ``out``; returns notes. The earlier members stay in the file."""
    if not members:
        raise ParameterError("nothing to set")
    payload = build_metadata(dict(members))
    with appended(file, out, force=force) as (writer, _, note):
        writer.chunk("mETa", payload)
    return [note] if note else []
