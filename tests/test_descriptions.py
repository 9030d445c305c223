"""Descriptions: errors name the key and say what to write; schemas say what is taken."""

from __future__ import annotations

import json
import sys
import tomllib
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from spec import ROOT

from hapfmt.descriptions import Description, DescriptionError, read
from hapfmt.lab.study.description import new_study
from hapfmt.structs import Meta, Struct, schema_of

sys.path.insert(0, str(ROOT / "tools"))

from schemas import SCHEMAS, text_of


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.parent.name)
def test_the_schemas_are_up_to_date(path: Path) -> None:
    """python tools/schemas.py writes them."""
    assert path.read_text(encoding="utf-8") == text_of(path)
    Draft202012Validator.check_schema(json.loads(text_of(path)))


def valid(name: str) -> Draft202012Validator:
    path = ROOT / "hapfmt" / "lab" / name / "schema.json"
    return Draft202012Validator(json.loads(path.read_text(encoding="utf-8")))


def test_built_in_scenes_fit_their_schema() -> None:
    folder = ROOT / "hapfmt" / "lab" / "scenes" / "builtin"
    scenes = [tomllib.loads(path.read_text("utf-8")) for path in folder.glob("*.toml")]
    assert scenes and all(map(valid("scenes").is_valid, scenes))
    assert not valid("scenes").is_valid(scenes[0] | {"secnds": 1})


def test_a_new_study_fits_its_schema(tmp_path: Path) -> None:
    (tmp_path / "a.hapf").touch()
    study = tomllib.loads(new_study(tmp_path / "s.toml", [str(tmp_path / "a.hapf")]))
    assert valid("study").is_valid(study)
    assert not valid("study").is_valid(study | {"session": []})


class Part(Struct):
    size: Annotated[float, Meta(gt=0, le=9, description="how large it is")]
    names: dict[Annotated[str, Meta(max_length=3)], int] = field(default_factory=dict)


class Whole(Description):
    parts: tuple[Part, ...] = ()
    code: Annotated[str, Meta(pattern="^[a-z]+$", examples=["abc"])] = "x"
    either: Annotated[int, Meta(ge=0, le=3)] | Annotated[str, Meta(max_length=3)] = 0


SAID: list[tuple[Any, str]] = [
    ({"parts": [{"size": 1}, {"size": 0}]}, "parts[1].size: 0 is out of range; write a number"),
    (
        {"parts": [{}]},
        "parts[0].size: is missing; add how large it is (a number above 0 and at most 9)",
    ),
    ({"parts": [{"sise": 1}]}, "parts[0].sise: is not a known key; did you mean size?"),
    ({"parts": [{"size": 1, "names": {"a": 1, "b": "c"}}]}, "parts[0].names.b: is a text; write"),
    ({"parts": [{"size": 1, "names": {"abcd": 1}}]}, "parts[0].names.abcd: has 4 characters;"),
    ({"parts": {"size": 1}}, "parts: is a table of keys and values; write a list of 0 or"),
    ({"parts": [3]}, "parts[0]: is a number; write a table"),
    ({"code": "A"}, "code: 'A' cannot be used; write a text such as 'abc'"),
    ({"code": "A - at `$.parts[0]`"}, "code: 'A - at `$.parts[0]`' cannot be used"),
    ({"x - at `$.code": 1}, "x - at `$.code: is not a known key; known: parts, code, either"),
    ({"either": 1.5}, "either: 1.5 cannot be used; write a whole number from 0 to 3"),
    ({"either": 4}, "either: 4 is out of range; write a whole number from 0 to 3"),
    ({"either": "four"}, "either: has 4 characters; write a whole number from 0 to 3 or a text of"),
    ({"either": None}, "either: is null; write a whole number from 0 to 3 or a text of at most 3"),
    ({"either": 10**400}, "either: the number is out of range"),
    ([], "is a list; write a table"),
    (None, "is null; write a table"),
]


@pytest.mark.parametrize(("values", "message"), SAID, ids=range(len(SAID)))
def test_errors_name_the_key_and_say_what_to_write(values: Any, message: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        read(Whole, values)
    assert str(caught.value).startswith(message)


LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
KEYS = st.sampled_from(["parts", "size", "names", "code", "either"]) | st.text(max_size=4)
VALUES = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4)
)


@given(VALUES)
def test_any_values_give_a_description_or_an_error_of_ours(values: Any) -> None:
    """What is taken fits the schema."""
    try:
        read(Whole, values)
    except DescriptionError as error:
        assert len(str(error)) < 600
        return
    assert Draft202012Validator(schema_of(Whole, "Whole")).is_valid(values)
