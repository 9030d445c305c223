"""Simulated recordings. A scene computes only the parts that its description names.

    from hapfmt.lab.scenes import load_scene, simulate

    recording, work = simulate(load_scene("sand").changed(seconds=10, seed=3))

description.py  the frozen Structs of a Scene, from TOML and builtin/; counters of work.
build.py        Scene -> Recording and Work; imports only the named parts.
tool.py         a held mass in the air; motion.py moves it.
touch.py        the mass in contact; surface.py gives the height under its tip.
linear.py       exact steps of linear systems.
grasp.py        fingers that close on an object, and their joints.
contact.py      the contact system and six solvers.
sensors.py      noise, counts and the end of the range.
stylus.py       the stylus of `hapfmt demo`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .build import simulate
    from .description import (
        Contact,
        Hand,
        Object,
        Press,
        Reach,
        Scene,
        Stroke,
        Texture,
        Tool,
        Work,
        builtin_names,
        load_scene,
        parse_scene,
        scene_text,
    )

_PLACES = {
    "builtin_names": "description",
    "load_scene": "description",
    "parse_scene": "description",
    "scene_text": "description",
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
    "Work": "description",
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
