"""Descriptions in TOML: those that come with the package, and those in files."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from .errors import ParameterError

MOST_BYTES = 1 << 20


def parse_toml(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a number of 5000 digits is a plain ValueError
        raise ParameterError(f"no TOML: {str(error) or 'nested too deeply'}") from None


@dataclass(frozen=True)
class Library:
    """The folder "builtin" of ``package``; ``kind``: what a file of it is called."""

    package: str
    kind: str

    @property
    def folder(self) -> Traversable:
        return resources.files(self.package) / "builtin"

    def names(self) -> tuple[str, ...]:
        """What comes with the package, sorted."""
        names = (entry.name for entry in self.folder.iterdir())
        return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))

    def text(self, name_or_path: str) -> str:
        """The TOML of this name, or else of the file."""
        known = self.names()
        if name_or_path in known:
            return (self.folder / f"{name_or_path}.toml").read_text(encoding="utf-8")
        path = Path(name_or_path)
        if not path.is_file():
            raise ParameterError(
                f"no {self.kind} {name_or_path[:200]!r}: neither a file nor one of "
                f"{', '.join(known)}"
            )
        with path.open("rb") as stream:
            data = stream.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise ParameterError(f"more than 1 MiB; a {self.kind} is shorter", path=name_or_path)
        try:
            return data.decode("utf-8")
        except UnicodeDecodeError:
            raise ParameterError("not UTF-8, as TOML must be", path=name_or_path) from None
