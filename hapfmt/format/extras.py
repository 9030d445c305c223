"""mETa and aTTc payloads (SPEC 6.7, 6.8): metadata and attachments, never needed to decode."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any, NoReturn

from ..errors import FormatError, ParameterError
from .tlv import encode_text, parse_text

DEPTH_LIMIT = 64
DIGIT_LIMIT = 1000
"""Characters of a number: more are refused, since reading them takes the square of their number."""


def build_metadata(metadata: dict[str, Any]) -> bytes:
    """Canonical JSON: sorted keys, no spaces."""
    if not isinstance(metadata, dict):
        raise ParameterError("metadata must be a JSON object, a dict in Python")
    try:
        payload = json.dumps(
            metadata, ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False
        ).encode("utf-8")
        parse_metadata(payload, 0)
    except (TypeError, ValueError, RecursionError, FormatError) as error:
        raise ParameterError(f"metadata cannot be written as JSON: {error}") from None
    return payload


def parse_metadata(payload: bytes, offset: int) -> dict[str, Any]:
    """SPEC MET-001."""

    def refuse(name: str) -> NoReturn:
        raise ValueError(name)

    def integer(text: str) -> int:
        return int(text) if len(text) <= DIGIT_LIMIT else refuse(text)

    def real(text: str) -> float:
        value = float(text)
        return value if math.isfinite(value) and len(text) <= DIGIT_LIMIT else refuse(text)

    try:
        text = parse_text(payload, offset)
        value = json.loads(text, parse_constant=refuse, parse_int=integer, parse_float=real)
        if "\\u" in text:
            # Only an escape can stand for half of a surrogate pair.
            check_texts(value)
    except (ValueError, RecursionError):
        raise FormatError(
            "metadata is not JSON within the bounds", requirement="MET-001", offset=offset
        ) from None
    if not isinstance(value, dict):
        raise FormatError("metadata is not a JSON object", requirement="MET-001", offset=offset)
    level: list[Any] = [value]
    for _ in range(DEPTH_LIMIT):
        level = [
            inner
            for item in level
            for inner in (item.values() if isinstance(item, dict) else item)
            if isinstance(inner, (dict, list))
        ]
        if not level:
            return value
    raise FormatError("metadata nested more than 64 deep", requirement="MET-001", offset=offset)


def check_texts(value: Any) -> None:
    """ValueError where a text within has no UTF-8."""
    waiting = [value]
    while waiting:
        item = waiting.pop()
        if isinstance(item, str):
            item.encode("utf-8")
        elif isinstance(item, dict):
            waiting.extend(item)
            waiting.extend(item.values())
        elif isinstance(item, list):
            waiting.extend(item)


@dataclass(frozen=True)
class Attachment:
    """A named file inside the recording."""

    name: str
    media_type: str
    content: bytes

    @property
    def safe_name(self) -> str:
        """The name without any path: last component, no leading dots (SPEC ATT-002)."""
        last = self.name.replace("\\", "/").replace(":", "/").rsplit("/", 1)[-1]
        return "".join(c for c in last if c.isprintable()).lstrip(".") or "attachment"


def build_attachment(attachment: Attachment) -> bytes:
    out = b""
    for text in (attachment.name, attachment.media_type):
        raw = encode_text(text)
        out += bytes([len(raw)]) + raw
    if not attachment.name:
        raise ParameterError("an attachment has a name")
    return out + attachment.content


def parse_attachment(payload: bytes, offset: int) -> Attachment:
    """SPEC ATT-001."""
    texts = []
    position = 0
    for _ in range(2):
        stop = position + 1 + (payload[position] if position < len(payload) else 0)
        if stop > len(payload):
            raise FormatError(
                "attachment ends within its name", requirement="ATT-001", offset=offset + position
            )
        texts.append(parse_text(payload[position + 1 : stop], offset + position + 1))
        position = stop
    if not texts[0]:
        raise FormatError("attachment without a name", requirement="ATT-001", offset=offset)
    return Attachment(texts[0], texts[1], payload[position:])
