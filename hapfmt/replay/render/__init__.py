"""Recording -> values for a device: assignment of channels, streaming, resampling (SPEC 17.1)."""

from .assign import Assignment, Route, assign
from .renderer import Position, Renderer

__all__ = ["Assignment", "Position", "Renderer", "Route", "assign"]
