"""Cuts, joins and completes files without encoding anything again (docs/spec/editing.md).

from hapfmt import edit

edit.subset("long.hapf", "part.hapf", channels=["force_z"], start=10, stop=20)
edit.concat(["a.hapf", "b.hapf"], "both.hapf")
"""

from __future__ import annotations

from .additions import annotate, attach, attachment_of, extract, set_metadata
from .joining import Times, concat, merge
from .making import Edited, Original
from .subset import split, subset

__all__ = [
    "Edited",
    "Original",
    "Times",
    "annotate",
    "attach",
    "attachment_of",
    "concat",
    "extract",
    "merge",
    "set_metadata",
    "split",
    "subset",
]
