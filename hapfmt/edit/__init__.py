"""Files cut, joined and completed without encoding anything anew (docs/spec/editing.md).

from hapfmt import edit

edit.subset("long.hapf", "part.hapf", channels=["force_z"], start=10, stop=20)
edit.concat(["a.hapf", "b.hapf"], "both.hapf")
"""

from __future__ import annotations

from .annotate import annotate
from .attach import attach, attachment_of, extract
from .concat import concat
from .making import Edited
from .merge import merge
from .meta import set_metadata
from .original import Original
from .split import split
from .subset import subset
from .times import Times

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
