"""Recording -> values for a device: channel assignment and resampling (docs/spec/players.md)."""

from .assign import Assignment, Route, assign
from .renderer import Position, Renderer

__all__ = ["Assignment", "Position", "Renderer", "Route", "assign"]
