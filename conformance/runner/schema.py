"""As much of JSON Schema as the schemas of this folder use."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

from .compare import Difference, same, shown
from .manifest import ROOM

KEYWORDS = {
    "$schema", "$defs", "$ref", "title", "type", "enum", "const", "pattern", "minLength",
    "maxLength", "minimum", "maximum", "minItems", "maxItems", "items", "prefixItems", "required",
    "properties", "additionalProperties", "anyOf",
}  # fmt: skip
TYPES: dict[str, Any] = {
    "object": dict, "array": list, "string": str, "null": type(None), "boolean": bool,
}  # fmt: skip
SIZES = (("minLength", "maxLength"), ("minItems", "maxItems"))


@cache
def schema(name: str) -> dict[str, Any]:
    """``capabilities``, ``decode``, ``verify``, ``job``, ``expected`` or ``manifest``."""
    folder = ROOM if name == "manifest" else ROOM / "schemas"
    return json.loads((folder / f"{name}.schema.json").read_text(encoding="utf-8"))


def is_type(value: Any, name: str) -> bool:
    if name in ("integer", "number"):
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return False
        return name == "number" or value == int(value)
    return isinstance(value, TYPES[name])


def faults(
    value: Any, rule: dict[str, Any], where: str, root: dict[str, Any]
) -> Iterator[Difference]:
    """Where ``value`` is not as the schema says."""
    if not rule.keys() <= KEYWORDS:
        raise ValueError(f"this reader of schemas does not know {rule.keys() - KEYWORDS}")
    if "$ref" in rule:
        yield from faults(value, root["$defs"][rule["$ref"].removeprefix("#/$defs/")], where, root)
    if "type" in rule and not is_type(value, rule["type"]):
        yield Difference(where, f"JSON of type {rule['type']}", shown(value))
        return
    if "const" in rule and not same(rule["const"], value):
        yield Difference(where, shown(rule["const"]), shown(value))
    if "enum" in rule and not any(same(each, value) for each in rule["enum"]):
        yield Difference(where, f"one of {rule['enum']}", shown(value))
    if "anyOf" in rule:
        tried = [list(faults(value, each, where, root)) for each in rule["anyOf"]]
        if all(tried):
            yield min(tried, key=len)[0]
    if isinstance(value, str) and not re.search(rule.get("pattern", ""), value):
        yield Difference(where, f"a text like {rule['pattern']}", shown(value))
    if is_type(value, "number") and not (
        rule.get("minimum", value) <= value <= rule.get("maximum", value)
    ):
        bounds = f"{rule.get('minimum', '')} to {rule.get('maximum', '')}"
        yield Difference(where, f"a number from {bounds}", shown(value))
    if isinstance(value, (str, list)):
        least, most = SIZES[isinstance(value, list)]
        if not rule.get(least, 0) <= len(value) <= rule.get(most, len(value)):
            bounds = f"{rule.get(least, 0)} to {rule.get(most, '')}"
            yield Difference(where, f"a size from {bounds}", str(len(value)))
    if isinstance(value, list):
        first = rule.get("prefixItems", [])
        for place, each in enumerate(value):
            inner = first[place] if place < len(first) else rule.get("items", {})
            yield from faults(each, inner, f"{where}[{place}]", root)
    if isinstance(value, dict):
        yield from object_faults(value, rule, where, root)


def object_faults(
    value: dict[str, Any], rule: dict[str, Any], where: str, root: dict[str, Any]
) -> Iterator[Difference]:
    known, other = rule.get("properties", {}), rule.get("additionalProperties", {})
    for name in rule.get("required", []):
        if name not in value:
            yield Difference(f"{where}.{name}", "a value", "nothing")
    for name, each in value.items():
        inner = known.get(name, other)
        if inner is False:
            yield Difference(f"{where}.{name}", "nothing", shown(each))
        else:
            yield from faults(each, inner, f"{where}.{name}", root)


def check(value: Any, name: str, where: str) -> list[Difference]:
    """Against the schema called ``name``."""
    return list(faults(value, schema(name), where, schema(name)))
