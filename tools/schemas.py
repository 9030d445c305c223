"""JSON schemas of descriptions, for editors: python tools/schemas.py writes them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import installed  # noqa: F401

from hapfmt.convert.maps import MapKeys
from hapfmt.lab.scenes.description import Scene
from hapfmt.lab.study.description import StudyKeys
from hapfmt.replay.profile.parse import ProfileKeys
from hapfmt.structs import schema_of

ROOT = Path(__file__).resolve().parents[1] / "hapfmt"
SCHEMAS = {
    ROOT / "convert" / "schema.json": (MapKeys, "Map of arrays for hapfmt"),
    ROOT / "lab" / "scenes" / "schema.json": (Scene, "Scene of hapfmt"),
    ROOT / "replay" / "profile" / "schema.json": (ProfileKeys, "Device profile of hapfmt"),
    ROOT / "lab" / "study" / "schema.json": (StudyKeys, "Study of hapfmt"),
}


def text_of(path: Path) -> str:
    kind, title = SCHEMAS[path]
    return json.dumps(schema_of(kind, title), indent=1) + "\n"


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for path in SCHEMAS:
        path.write_text(text_of(path), encoding="utf-8")
