"""HDF5 <-> Recording, through h5py: our own layout (hdf5_layout.py), and those of others
(layouts.py, maps.py).
"""

from __future__ import annotations

from ..recording import Recording
from .formats import Destination, ReadOptions, Source, WriteOptions
from .hdf5_files import Texts, opened, refusing_hdf5, tree_of
from .hdf5_layout import is_ours, read_ours, write_ours
from .layouts import import_of_tree
from .maps import mapped
from .tables import Import


def read(source: Source, options: ReadOptions) -> Import:
    """The tables of a file; their values are read later."""
    file = opened(source)
    texts = Texts(source.stream)
    with refusing_hdf5("this HDF5 file cannot be read"):
        if options.map is None and is_ours(file, texts):
            return read_ours(file, texts, options)
    tree = tree_of(file, texts)
    return mapped(tree, options) if options.map is not None else import_of_tree(tree, options)


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """Our own layout; returns notes on what is not kept."""
    return write_ours(recording, target, options)
