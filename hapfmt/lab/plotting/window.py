"""Pages in a window."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ...errors import ParameterError

if TYPE_CHECKING:
    import tkinter

    from matplotlib.figure import Figure

INSTEAD = "use --output picture.png"


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
            f"A window needs tkinter, which this Python lacks; {INSTEAD}"
        ) from None
    try:
        root = tkinter.Tk()
    except tkinter.TclError:
        raise ParameterError(f"No display for a window; {INSTEAD}") from None
    root.title(title)
    return root
