"""The schemas say what the reader of descriptions takes."""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

from schemas import SCHEMAS, text_of


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.parent.name)
def test_the_schemas_are_up_to_date(path: Path) -> None:
    """python tools/schemas.py writes them."""
    assert path.read_text(encoding="utf-8") == text_of(path)
    Draft202012Validator.check_schema(json.loads(text_of(path)))


def test_built_in_scenes_fit_their_schema() -> None:
    folder = ROOT / "hapfmt" / "scenes"
    valid = Draft202012Validator(json.loads((folder / "schema.json").read_text(encoding="utf-8")))
    scenes = [tomllib.loads(p.read_text("utf-8")) for p in (folder / "builtin").glob("*.toml")]
    assert scenes and all(map(valid.is_valid, scenes))
    assert not valid.is_valid(scenes[0] | {"secnds": 1})
