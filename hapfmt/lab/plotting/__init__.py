"""Pictures. matplotlib is imported here alone, and only when one is drawn, through its object
interface: no window unless one is asked for, no global state."""

from __future__ import annotations

from .figures import Demonstrated, plot_demo

__all__ = ["Demonstrated", "plot_demo"]
