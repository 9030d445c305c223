"""Pages in a window, where there is a display."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..errors import ParameterError

if TYPE_CHECKING:
    import tkinter

    from matplotlib.figure import Figure

INSTEAD = "write a picture instead: --output picture.png"


def show(figures: Sequence[Figure], title: str) -> None:
    """Show the pages, each in a tab of its own, until the window is closed."""
    root = open_window(title)
    from tkinter import ttk

    tk: Any = import_module("matplotlib.backends.backend_tkagg")
    book = ttk.Notebook(root)
    book.pack(fill="both", expand=True)
    for number, figure in enumerate(figures, 1):
        frame = ttk.Frame(book)
        book.add(frame, text=f"page {number}")
        canvas = tk.FigureCanvasTkAgg(figure, master=frame)
        tk.NavigationToolbar2Tk(canvas, frame).update()
        canvas.get_tk_widget().pack(fill="both", expand=True)
    root.mainloop()


def open_window(title: str) -> tkinter.Tk:
    """An empty window, or ParameterError that says what to do instead."""
    try:
        import tkinter
    except ImportError:
        raise ParameterError(
            f"this Python has no tkinter, so it opens no window; {INSTEAD}"
        ) from None
    try:
        root = tkinter.Tk()
    except tkinter.TclError:
        raise ParameterError(f"there is no display to open a window on; {INSTEAD}") from None
    root.title(title)
    return root
