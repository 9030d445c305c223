"""Descriptions that people write in TOML: scenes, profiles, studies, headers of streams.

A Struct declares once what its keys may hold. Values, errors and JSON schemas follow from it. The
descriptions come with the package or are files of the user.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from types import NoneType
from typing import Any, Literal, TypeVar, cast

from .errors import ParameterError, similar
from .numbers import counted, double
from .structs import Arm, Meta, OneOf, Struct, arms, bare, keys_of, schema_node

Made = TypeVar("Made")

LONGEST = 200
"""Characters of a key path in a message."""


class DescriptionError(ParameterError, ValueError):
    """An error in a description, with its key. A ``__post_init__`` names only its own keys; what
    reads the table puts the path before them."""

    def __init__(self, key: str, text: str, requirement: str | None = None) -> None:
        key = key.encode("utf-8", "backslashreplace").decode()
        super().__init__(f"{key[:LONGEST]}: {text}" if key else text, requirement=requirement)
        self.key, self.text = key, text

    def under(self, at: str) -> DescriptionError:
        """The same error, where the table it was found in is at ``at``."""
        return DescriptionError(joined(at, self.key), self.text, self.requirement)


class Description(Struct):
    """A table whose rules hold for values given in Python too."""

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for each in keys_of(kind).values():
            assign(self, each.name, read(each.type, getattr(self, each.name), each.key))


def assign(table: Struct, name: str, value: Any) -> None:
    """For ``__post_init__`` alone: tables are frozen."""
    object.__setattr__(table, name, value)


def within(low: float, high: float, what: str) -> Meta:
    """A number from ``low`` to ``high``."""
    return Meta(ge=low, le=high, description=what)


def above(low: float, high: float, what: str) -> Meta:
    """A number above ``low`` and at most ``high``."""
    return Meta(gt=low, le=high, description=what)


def what(text: str) -> Meta:
    return Meta(description=text)


def refuse_twice(key: str, values: Sequence[str]) -> None:
    for n, each in enumerate(values):
        if each in values[:n]:
            raise DescriptionError(f"{key}[{n}]", f"{each!r} is there twice; write it once")


def read(kind: type[Made], value: Any, at: str = "") -> Made:
    """The value of a parsed TOML or JSON text as ``kind``; or DescriptionError, with its key below
    ``at``. A number without a fraction may be a float; nothing else changes its type."""
    plain: Any = kind
    for arm in arms(plain):
        found = taken(arm, value, at)
        if found is not UNFIT:
            return cast(Made, found)
    raise DescriptionError(at, advice(value, node_of(plain)))


UNFIT = object()


def taken(arm: Arm, value: Any, at: str) -> Any:
    """The value as this type, or UNFIT. Errors within it are raised."""
    kind, found = arm.type, value
    if kind is Any:
        return value
    if kind is NoneType:
        return None if value is None else UNFIT
    if arm.origin is Literal:
        fits = any(type(value) is type(each) and value == each for each in arm.parts)
        return value if fits else UNFIT
    if arm.origin is tuple:
        found = items_of(arm, value, at) if isinstance(value, (list, tuple)) else UNFIT
    elif arm.origin is dict:
        found = entries_of(arm, value, at) if isinstance(value, dict) else UNFIT
    elif issubclass(kind, (Struct, OneOf)):
        return table_of(kind, value, at)
    elif type(value) is not kind:
        if kind is not float or type(value) is not int:
            return UNFIT
        try:
            found = float(value)
        except OverflowError:
            return UNFIT
    return found if found is not UNFIT and keeps(arm.rules, found) else UNFIT


def items_of(arm: Arm, value: Sequence[Any], at: str) -> Any:
    kinds = arm.parts
    if kinds[-1] is Ellipsis:
        found, plain = set(map(type, value)), plain_types(kinds[0])
        if found <= plain:
            return tuple(value)
        if float in plain and found <= plain | {int}:
            with suppress(OverflowError):
                return tuple(float(each) if type(each) is int else each for each in value)
        kinds = kinds[:1] * len(value)
    if len(kinds) != len(value) or not keeps(arm.rules, value):
        return UNFIT
    return tuple(
        read(kind, each, f"{at}[{n}]")
        for n, (kind, each) in enumerate(zip(kinds, value, strict=True))
    )


@cache
def plain_types(kind: Any) -> frozenset[type]:
    """Types whose values are taken as they are, without a rule: long lists need not be looked
    through one by one."""
    plain = (bool, int, float, str, NoneType)
    return frozenset(arm.type for arm in arms(kind) if arm.type in plain and not any(arm.rules))


def entries_of(arm: Arm, value: dict[Any, Any], at: str) -> dict[Any, Any]:
    kind, inner = arm.parts
    return {
        read(kind, key, joined(at, str(key))): read(inner, each, joined(at, str(key)))
        for key, each in value.items()
    }


def table_of(kind: Any, value: Any, at: str) -> Any:
    if isinstance(value, kind):
        return value
    if not isinstance(value, dict):
        return UNFIT
    if not issubclass(kind, Struct):
        found = [key for key in kind.kinds if key in value]
        if len(found) != 1:
            given = " and ".join(found) or "none"
            raise DescriptionError(
                at, f"has {given} of {', '.join(kind.kinds)}; give exactly one of them"
            )
        kind = kind.kinds[found[0]]
    known = keys_of(kind)
    values = {}
    for key, each in value.items():
        if key in known:
            values[known[key].name] = read(known[key].type, each, joined(at, key))
        elif not kind.is_open:
            near = similar(str(key)[:LONGEST], known)
            hint = f"did you mean {near}?" if near else f"known: {', '.join(known)}"
            raise DescriptionError(joined(at, str(key)), f"is not a known key; {hint}")
    for key, each in known.items():
        if each.required and each.name not in values:
            raise missing(each.type, joined(at, key))
    try:
        return kind(**values)
    except DescriptionError as error:
        raise error.under(at) from None


def missing(kind: Any, at: str) -> DescriptionError:
    node, metas = node_of(kind), bare(kind)[1]
    advised = f"{node['description']} ({words(node)})" if "description" in node else words(node)
    requirement = next((each.requirement for each in metas if each.requirement), None)
    return DescriptionError(at, f"is missing; add {advised}", requirement)


def keeps(rules: Sequence[Meta], value: Any) -> bool:
    """Whether a number, a text or a list is within its rules."""
    for rule in rules:
        if rule.gt is not None and not value > rule.gt:
            return False
        if rule.ge is not None and not value >= rule.ge:
            return False
        if rule.le is not None and not value <= rule.le:
            return False
        if rule.min_length is not None and len(value) < rule.min_length:
            return False
        if rule.max_length is not None and len(value) > rule.max_length:
            return False
        if rule.pattern is not None and not re.search(rule.pattern, value):
            return False
    return True


node_of = cache(schema_node)


def parse_json(text: bytes) -> dict[str, Any]:
    """One object of JSON; raise ParameterError."""
    try:
        found = json.loads(text.decode("utf-8"), parse_float=double)
    except (ValueError, RecursionError):
        raise ParameterError("this is not JSON") from None
    if not isinstance(found, dict):
        raise ParameterError("this is not a JSON object")
    return found


def joined(at: str, key: str) -> str:
    return f"{at}.{key}" if at and key and not key.startswith("[") else at + key


TYPES: dict[str, tuple[tuple[type, ...], str]] = {
    "boolean": ((bool,), "true or false"),
    "integer": ((int, float), "a whole number"),
    "number": ((int, float), "a number"),
    "string": ((str,), "a text"),
    "array": ((list, tuple), "a list"),
    "object": ((dict,), "a table of keys and values"),
}
"""Types of JSON: their Python types, and their names in messages."""


def advice(value: Any, node: dict[str, Any]) -> str:
    """Why the value does not fit the schema, and what to write."""
    choices = [each for each in node.get("anyOf", [node]) if each.get("type") != "null"]
    fitting = [each for each in choices if fits(value, each)]
    if not fitting:
        wanted = {each.get("type") for each in choices}
        end = ""
        if isinstance(value, str) and wanted & {"boolean", "integer", "number"}:
            end = ", without quotes"
        elif wanted == {"string"}:
            end = ", between quotes"
        return f"is {type_text(value)}; write {words(node)}{end}"
    whole, node = words(node), fitting[0]
    if "enum" in node:
        near = similar(value[:LONGEST], node["enum"]) if isinstance(value, str) else None
        hint = f"did you mean {near!r}?" if near else f"choose {whole}"
        return f"there is no {shown(value)}; {hint}"
    limited = {"maxLength", "minLength", "maxItems", "minItems"} & node.keys()
    if isinstance(value, (str, list, tuple)) and limited and not fits_length(value, node):
        unit = "character" if isinstance(value, str) else "value"
        return f"has {counted(len(value), unit)}; write {whole}"
    if isinstance(value, (int, float)) and (node["type"] == "number" or isinstance(value, int)):
        return f"{shown(value)} is out of range; write {whole}"
    meaning = f": {node['description']}" if "pattern" in node and "description" in node else ""
    return f"{shown(value)} cannot be used; write {whole}{meaning}"


def fits(value: Any, node: dict[str, Any]) -> bool:
    """Whether the value has the type; the rest may be wrong."""
    if "enum" in node:
        return isinstance(value, tuple(map(type, node["enum"])))
    kinds = TYPES[node["type"]][0] if "type" in node else (dict,)
    return isinstance(value, kinds) and (not isinstance(value, bool) or kinds == (bool,))


def fits_length(value: Any, node: dict[str, Any]) -> bool:
    low = node.get("minLength", node.get("minItems", 0))
    high = node.get("maxLength", node.get("maxItems"))
    return low <= len(value) and (high is None or len(value) <= high)


def type_text(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return json.dumps(value)
    found = (words for kinds, words in reversed(TYPES.values()) if isinstance(value, kinds))
    return next(found, f"of type {type(value).__name__}")


def shown(value: Any) -> str:
    """Python refuses to print integers of many digits."""
    if isinstance(value, int) and abs(value) >= 10**20:
        return "the number"
    return f"{value!r:.60}"


def words(node: dict[str, Any]) -> str:
    """The values that a schema accepts, in words."""
    if "anyOf" in node:
        return " or ".join(words(each) for each in node["anyOf"] if each.get("type") != "null")
    if "enum" in node:
        return f"one of {', '.join(map(str, node['enum']))}"
    if "$ref" in node:
        return TYPES["object"][1]
    text = TYPES[node["type"]][1]
    if node["type"] in ("integer", "number"):
        low, high, over = (node.get(key) for key in ("minimum", "maximum", "exclusiveMinimum"))
        if over is not None:
            return f"{text} above {plain(over)}" + (f" and at most {plain(high)}" if high else "")
        return text if low is None or high is None else f"{text} from {plain(low)} to {plain(high)}"
    if node.get("examples"):
        return f"{text} such as {node['examples'][0]!r}"
    if "maxLength" in node:
        low = f"{node['minLength']} to" if "minLength" in node else "at most"
        return f"{text} of {low} {node['maxLength']} characters"
    if node["type"] == "array":
        items = node.get("items") or node["prefixItems"][0]
        low, high = node.get("minItems", 0), node.get("maxItems")
        count = f"{low}" if low == high else f"{low} to {high}" if high else f"{low} or more"
        return f"{text} of {count} " + (
            "tables" if words(items) == TYPES["object"][1] else f"values, each {words(items)}"
        )
    return text


def plain(bound: float) -> str:
    return str(bound) if isinstance(bound, int) else f"{bound:.10g}"


MOST_BYTES = 1 << 20
MOST_PARTS = 16
"""Names joined by dots in one key. The time that tomllib takes grows with their square."""
MOST_WORDS = 1 << 16
"""Names and values in all."""
MOST_NESTED = 32
"""Brackets and braces within one another."""
MOST_DIGITS = 1000
"""Characters of a number."""

TOKEN = re.compile(
    r"""
    (?P<string> \"{3} (?: [^"\\] | \\[\s\S] | "{1,2}(?!") )* "{3,5}
              | '{3} (?: [^'] | '{1,2}(?!') )* '{3,5}
              | " (?: [^"\\\n] | \\. )* "
              | ' [^'\n]* ' )
  | (?P<word> [A-Za-z0-9_+-]+ )
  | (?P<comment> \#[^\n]* )
  | (?P<other> [^\ \t] )
    """,
    re.VERBOSE,
)


def parse_toml(text: str) -> dict[str, Any]:
    """Raise ParameterError if the text is not TOML, or larger than a description needs."""
    check_size(text)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ParameterError(f"Invalid TOML: {str(error) or 'nested too deeply'}") from None


def check_size(text: str) -> None:
    """Refuse text that would take much more time or memory than its length; one pass."""
    if len(text) > MOST_BYTES:
        raise ParameterError(f"Invalid TOML: more than {MOST_BYTES} characters")
    words = parts = nested = 0
    joined = False
    for token in TOKEN.finditer(text):
        kind, found = token.lastgroup, token[0]
        if kind in ("string", "word"):
            words += 1
            parts = parts + 1 if joined else 1
            joined = False
            if parts > MOST_PARTS:
                raise too_much(text, token, f"a key of more than {MOST_PARTS} parts")
            if words > MOST_WORDS:
                raise too_much(text, token, f"more than {MOST_WORDS} names and values")
            if len(found) > MOST_DIGITS and found[0] in "0123456789+-":
                raise too_much(text, token, f"a number of more than {MOST_DIGITS} digits")
        elif found == ".":
            joined = True
        else:
            joined, parts = False, 0
            nested += (found in "[{") - (found in "]}")
            if nested > MOST_NESTED:
                raise too_much(text, token, f"nested more than {MOST_NESTED} deep")
            if found in "\"'":
                # The string does not end: tomllib stops here too.
                return


def too_much(text: str, token: re.Match[str], what: str) -> ParameterError:
    line = text.count("\n", 0, token.start()) + 1
    column = token.start() - text.rfind("\n", 0, token.start())
    return ParameterError(f"Invalid TOML: {what} (at line {line}, column {column})")


@dataclass(frozen=True)
class Library:
    """The folder "builtin" of ``package``; ``kind``: what a file of it is called."""

    package: str
    kind: str

    @property
    def folder(self) -> Traversable:
        return resources.files(self.package) / "builtin"

    def names(self) -> tuple[str, ...]:
        """Names of the files in the package, sorted."""
        names = (entry.name for entry in self.folder.iterdir())
        return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))

    def text(self, name_or_path: str) -> str:
        """The TOML of this name, or else of the file."""
        known = self.names()
        if name_or_path in known:
            return (self.folder / f"{name_or_path}.toml").read_text(encoding="utf-8")
        path = Path(name_or_path)
        if not path.is_file():
            meant = similar(name_or_path[:200], known)
            advice = f"did you mean {meant!r}?" if meant else f"there are: {', '.join(known)}"
            raise ParameterError(f"no file and no {self.kind} {name_or_path[:200]!r}; {advice}")
        with path.open("rb") as stream:
            data = stream.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise ParameterError(f"more than 1 MiB; a {self.kind} is shorter", path=name_or_path)
        try:
            return data.decode("utf-8")
        except UnicodeDecodeError:
            raise ParameterError("not UTF-8, as TOML must be", path=name_or_path) from None
