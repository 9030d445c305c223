"""MAT <-> Recording: version 5 (mat5_files.py) and 7.3 (mat73_files.py) are read, version 5 is
written (mat_layout.py).
"""

from __future__ import annotations

from ..errors import ParameterError
from ..recording import Recording
from .formats import Destination, ReadOptions, Source, WriteOptions
from .layouts import import_of_tree
from .maps import mapped
from .mat5_files import tree_of_mat5
from .mat_layout import is_ours, read_ours, write_ours
from .tables import Import

_HDF5 = b"\x89HDF\r\n\x1a\n"


def read(source: Source, options: ReadOptions) -> Import:
    """The tables of a file; their values are read later."""
    version = version_of(source.head)
    if version == 5:
        tree = tree_of_mat5(source, options.max_memory)
        if options.map is None and is_ours(tree):
            return read_ours(tree, options)
    else:
        from .mat73_files import tree_of_mat73

        tree = tree_of_mat73(source)
    return mapped(tree, options) if options.map is not None else import_of_tree(tree, options)


def version_of(head: bytes) -> float:
    """5 or 7.3."""
    if head.startswith(_HDF5):
        return 7.3
    kind = {b"IM": "little", b"MI": "big"}.get(head[126:128])
    if kind is not None:
        number = int.from_bytes(head[124:126], "little" if kind == "little" else "big") >> 8
        if number in (1, 2):
            return 5 if number == 1 else 7.3
    raise ParameterError(
        "this is not a MAT file of version 5 or 7.3; in MATLAB or Octave, load it and "
        "save('new.mat', '-v7') writes one"
    )


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """Our own layout of version 5; returns notes on what is not kept."""
    return write_ours(recording, target, options)
