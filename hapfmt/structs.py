"""Tables of keys and values, declared once: Structs, and the JSON schemas that follow from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)


@dataclass(frozen=True, eq=False)
class Meta:
    """What a value is beyond its type: its rules, and words for people."""

    gt: float | None = None
    ge: float | None = None
    le: float | None = None
    min_length: int | None = None
    max_length: int | None = None
    pattern: str | None = None
    """As in JSON schemas: found anywhere in the text."""
    description: str = ""
    examples: Sequence[str] = ()
    extra_json_schema: Mapping[str, Any] | None = None
    requirement: str | None = None
    """Id of the sentence that asks for the value."""


def named(name: str, *, default: Any = MISSING) -> Any:
    """A field whose key is ``name``, a word that Python keeps."""
    return field(default=default, metadata={"key": name})


@dataclass_transform(frozen_default=True, field_specifiers=(field, named))
class Struct:
    """A table, frozen: its annotated fields are its keys. Other keys are refused, but not if it is
    ``open``."""

    is_open: ClassVar[bool] = False

    def __init_subclass__(cls, *, kw_only: bool = False, open: bool = False) -> None:
        super().__init_subclass__()
        cls.is_open = open
        dataclass(frozen=True, kw_only=kw_only)(cls)


class OneOf:
    """One of several tables: a key that only one of them has selects it."""

    __slots__ = ()
    kinds: ClassVar[Mapping[str, type[OneOf]]]


class Key(NamedTuple):
    """A key of a Struct."""

    name: str
    """The name that the field has in Python."""
    key: str
    type: Any
    default: Any
    """MISSING: the key is required."""

    @property
    def required(self) -> bool:
        return self.default is MISSING


@cache
def keys_of(table: Any) -> dict[str, Key]:
    """Keys of a Struct -> their fields, in order."""
    types = get_type_hints(table, include_extras=True)

    def default(each: Field[Any]) -> Any:
        return each.default if each.default_factory is MISSING else each.default_factory()

    found = (
        Key(each.name, each.metadata.get("key", each.name), types[each.name], default(each))
        for each in fields(table)
    )
    return {each.key: each for each in found}


class Arm(NamedTuple):
    """One of the types that a value may have."""

    type: Any
    origin: Any
    parts: tuple[Any, ...]
    rules: tuple[Meta, ...]


@cache
def arms(kind: Any) -> tuple[Arm, ...]:
    return tuple(_arms(kind, ()))


def _arms(kind: Any, rules: tuple[Meta, ...]) -> Iterator[Arm]:
    plain, metas = bare(kind)
    if get_origin(plain) in (Union, UnionType):
        for each in get_args(plain):
            yield from _arms(each, rules + metas)
    else:
        yield Arm(plain, get_origin(plain), get_args(plain), rules + metas)


def bare(kind: Any) -> tuple[Any, tuple[Meta, ...]]:
    """The type without what is said of it, and that."""
    if get_origin(kind) is not Annotated:
        return kind, ()
    plain, *metas = get_args(kind)
    return plain, tuple(each for each in metas if isinstance(each, Meta))


def schema_of(kind: Any, title: str) -> dict[str, Any]:
    """The JSON schema of a description."""
    parts: dict[str, Any] = {}
    node = schema_node(kind, parts)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title}
    return head | node | {"$defs": parts}


def schema_node(kind: Any, parts: dict[str, Any] | None = None) -> dict[str, Any]:
    """The schema of one value. Tables go to ``parts``, and the node refers to them."""
    plain, metas = bare(kind)
    if get_origin(plain) in (Union, UnionType):
        node: dict[str, Any] = {"anyOf": [schema_node(each, parts) for each in get_args(plain)]}
    else:
        node = _plain_node(plain, parts)
    head: dict[str, Any] = {}
    for meta in metas:
        head |= {"description": meta.description} if meta.description else {}
        head |= {"examples": [*meta.examples]} if meta.examples else {}
        head |= meta.extra_json_schema or {}
        length = "Items" if node.get("type") == "array" else "Length"
        found = {
            "exclusiveMinimum": meta.gt, "minimum": meta.ge, "maximum": meta.le,
            f"max{length}": meta.max_length, f"min{length}": meta.min_length,
            "pattern": meta.pattern,
        }  # fmt: skip
        node |= {key: value for key, value in found.items() if value is not None}
    return head | node


NAMES = {
    bool: "boolean", int: "integer", float: "number", str: "string", NoneType: "null",
    dict: "object",
}  # fmt: skip
"""Types of Python -> those of JSON."""


def _plain_node(plain: Any, parts: dict[str, Any] | None) -> dict[str, Any]:
    origin, inner = get_origin(plain), get_args(plain)
    if plain is Any:
        return {}
    if origin is Literal:
        return {"enum": sorted(inner)}
    if origin is dict:
        key, value = (schema_node(each, parts) for each in inner)
        names = {"propertyNames": key} if len(key) > 1 else {}
        return {"type": "object"} | names | ({"additionalProperties": value} if value else {})
    if origin is tuple and inner[-1] is Ellipsis:
        return {"type": "array", "items": schema_node(inner[0], parts)}
    if origin is tuple:
        each = [schema_node(part, parts) for part in inner]
        size = {"minItems": len(each), "maxItems": len(each)}
        return {"type": "array"} | size | {"prefixItems": each, "items": False}
    if issubclass(plain, OneOf) and "kinds" in vars(plain):
        if parts is None:
            return {"type": "object"}
        return {"anyOf": [schema_node(each, parts) for each in plain.kinds.values()]}
    if issubclass(plain, Struct):
        if parts is not None and plain.__name__ not in parts:
            parts[plain.__name__] = {}
            parts[plain.__name__] |= _table_node(plain, parts)
        return {"$ref": f"#/$defs/{plain.__name__}"}
    return {"type": NAMES[plain]}


def _table_node(table: Any, parts: dict[str, Any]) -> dict[str, Any]:
    keys = keys_of(table)
    properties = {}
    for key, each in keys.items():
        default = [*each.default] if isinstance(each.default, tuple) else each.default
        given = {} if each.required else {"default": default}
        properties[key] = schema_node(each.type, parts) | given
    node = {
        "title": table.__name__, "description": " ".join((table.__doc__ or "").split()),
        "type": "object", "properties": properties,
        "required": [key for key, each in keys.items() if each.required],
    }  # fmt: skip
    return node if table.is_open else node | {"additionalProperties": False}
