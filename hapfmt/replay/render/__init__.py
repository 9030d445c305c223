"""Recording -> values for a device: assignment of channels, resampling (docs/spec/players.md)."""

from .assign import Assignment, Route, assign
from .renderer import Position, Renderer

__all__ = ["Assignment", "Position", "Renderer", "Route", "assign"]
