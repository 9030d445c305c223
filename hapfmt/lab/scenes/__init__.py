"""Simulated recordings. A scene computes only the parts that its description names.

    from hapfmt.lab.scenes import load_scene, simulate

    recording, work = simulate(load_scene("sand").changed(seconds=10, seed=3))

description.py  the frozen Structs of a Scene; library.py loads them from TOML and builtin/.
build.py        Scene -> Recording and Work; imports only the named parts.
tool.py         a held mass: motion.py moves it, surface.py gives the height under its tip.
grasp.py        fingers that close on an object, and their joints.
contact.py      the contact system and its exact solver; integrators.py has the other solvers.
stylus.py       the stylus of `hapfmt demo`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .build import simulate
    from .description import Contact, Hand, Object, Press, Reach, Scene, Stroke, Texture, Tool
    from .library import builtin_names, load_scene, parse_scene, scene_text
    from .work import Work

_PLACES = {
    "builtin_names": "library",
    "load_scene": "library",
    "parse_scene": "library",
    "scene_text": "library",
    "simulate": "build",
    "Contact": "description",
    "Hand": "description",
    "Object": "description",
    "Press": "description",
    "Reach": "description",
    "Scene": "description",
    "Stroke": "description",
    "Texture": "description",
    "Tool": "description",
    "Work": "work",
}

__all__ = [
    "Contact",
    "Hand",
    "Object",
    "Press",
    "Reach",
    "Scene",
    "Stroke",
    "Texture",
    "Tool",
    "Work",
    "builtin_names",
    "load_scene",
    "parse_scene",
    "scene_text",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name in _PLACES:
        return getattr(import_module(f".{_PLACES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
