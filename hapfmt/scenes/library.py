"""TOML -> Scene: the scenes that come with the package, and those in files."""

from __future__ import annotations

import tomllib
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from ..errors import HapfmtError, ParameterError
from .description import Scene
from .keys import read_table

MOST_BYTES = 1 << 20


def builtin_names() -> tuple[str, ...]:
    """Names of the scenes that come with the package, sorted."""
    names = (entry.name for entry in _builtin().iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def scene_text(name_or_path: str) -> str:
    """The TOML of the built-in scene of this name, or else of the file."""
    if name_or_path in builtin_names():
        return (_builtin() / f"{name_or_path}.toml").read_text(encoding="utf-8")
    path = Path(name_or_path)
    if not path.is_file():
        known = ", ".join(builtin_names())
        raise ParameterError(f"no scene {name_or_path[:200]!r}: neither a file nor one of {known}")
    with path.open("rb") as stream:
        data = stream.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise ParameterError("more than 1 MiB; a scene is shorter", path=name_or_path)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise ParameterError("not UTF-8, as TOML must be", path=name_or_path) from None


def load_scene(name_or_path: str) -> Scene:
    """The built-in scene of this name, or else the one in this TOML file."""
    return parse_scene(scene_text(name_or_path), path=name_or_path)


def parse_scene(text: str, path: str | None = None) -> Scene:
    """TOML -> Scene; ``path`` is named in errors."""
    try:
        try:
            values = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            problem = str(error) or "nested too deeply"
            raise ParameterError(f"no TOML: {problem}") from None
        return read_table(Scene, values)
    except HapfmtError as error:
        raise error.at(path=path) from None


def _builtin() -> Traversable:
    return resources.files(__package__) / "builtin"
