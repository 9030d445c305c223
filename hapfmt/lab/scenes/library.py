"""TOML -> Scene: loads the scenes of the package and scene files."""

from __future__ import annotations

from ...descriptions import Library, parse_toml, read
from ...errors import HapfmtError
from .description import Scene

LIBRARY = Library(__package__, "scene")


def builtin_names() -> tuple[str, ...]:
    """Names of the scenes that come with the package, sorted."""
    return LIBRARY.names()


def scene_text(name_or_path: str) -> str:
    """The TOML of the built-in scene of this name, or else of the file."""
    return LIBRARY.text(name_or_path)


def load_scene(name_or_path: str) -> Scene:
    """The built-in scene of this name, or else the one in this TOML file."""
    return parse_scene(scene_text(name_or_path), path=name_or_path)


def parse_scene(text: str, path: str | None = None) -> Scene:
    """TOML -> Scene; ``path`` is named in errors."""
    try:
        return read(Scene, parse_toml(text))
    except HapfmtError as error:
        raise error.at(path=path) from None
