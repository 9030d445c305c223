"""The xarray backend ``hapf``: a file becomes a dataset whose values are read on demand.

    dataset = xarray.open_dataset("touch.hapf")              # a variable for each channel
    dataset = xarray.open_dataset("touch.hapf", chunks={})   # arrays of Dask
    tree = xarray.open_datatree("touch.hapf")                # a group for each rate, and events

The arrays keep a path and not an open file, so that processes and other machines can read them. A
file that was changed or replaced since is an error at each reading.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from xarray.backends import BackendArray, BackendEntrypoint, CachingFileManager
from xarray.core import indexing

from ..datasets import (
    About,
    DatasetVariable,
    clock_maps,
    dataset_of,
    events_of,
    rate_names,
    time_names,
)
from ..errors import LimitError, ParameterError, unknown
from ..format.source import is_url
from ..format.wire import SIGNATURE
from ..reading.catalogue import FalseIndexError
from ..recording import variable_names
from .files import (
    PartReader,
    check_channels,
    chunks_of,
    described,
    extents_of,
    open_reader,
    read_ticks,
    unchanged,
    version_of,
)

EVENTS = "events"
"""The group of events."""


class ChannelArray(BackendArray):
    """float64 [ticks]: a channel from the first tick of its rate to the last, NaN in gaps."""

    def __init__(
        self, files: Any, version: Any, number: int, rate: Fraction, first: int, last: int
    ) -> None:
        self.files = files
        self.version = version
        self.number = number
        self.rate = rate
        self.first = first
        self.shape = (last - first,)
        self.dtype = np.dtype(np.float64)

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.BASIC, self._values
        )

    def _values(self, key: tuple[Any, ...]) -> Any:
        (chosen,) = key
        if not isinstance(chosen, slice):
            return self.read(int(chosen), int(chosen) + 1)[0]
        places = range(self.shape[0])[chosen]
        if not len(places):
            return np.empty(0)
        low, high = min(places[0], places[-1]), max(places[0], places[-1])
        x = self.read(low, high + 1)
        return x[:: places.step]

    def read(self, start: int, stop: int) -> NDArray[np.float64]:
        """The values of the places [start, stop)."""
        first, last = self.first + start, self.first + stop
        try:
            with unchanged(self.files.acquire(), self.version) as reader:
                (channel,) = read_ticks(reader, [reader.by_number()[self.number]], first, last)
            return channel.filled(first, last)
        except LimitError as error:
            # Its advice is for other calls.
            fact = error.message.partition(": raise ")[0].partition("; take ")[0]
            raise LimitError(
                f"{fact}; take a part of the time, or open the file with chunks={{}}",
                requirement=error.requirement,
                offset=error.offset,
                path=error.path,
            ) from None


class HapfFile:
    """What the groups of one file have in common."""

    def __init__(self, path: str, *, drop: Iterable[str], clocks: bool, is_tree: bool) -> None:
        self.is_tree = is_tree
        self.files = CachingFileManager(open_reader, path, mode="r")
        self.reader: PartReader = self.files.acquire()
        try:
            self.learn({*drop}, clocks=clocks)
        except FalseIndexError:
            self.reader.scan()
            self.learn({*drop}, clocks=clocks)
        except BaseException:
            self.files.close()
            raise

    def named(self, label: str) -> str:
        """A tree has no variables with a slash in their names."""
        return label.replace("/", "_") if self.is_tree else label

    def learn(self, drop: set[str], *, clocks: bool) -> None:
        reader = self.reader
        self.version = version_of(reader)
        self.refs = reader.channels
        self.rate_of = {ref.number: ref.track.rate for ref in self.refs}
        self.rates = rate_names(self.rate_of.values())
        labels = [self.named(ref.label) for ref in self.refs]
        self.names = variable_names(labels, time_names(self.rates))
        self.kept = [
            (name, ref) for name, ref in zip(self.names, self.refs, strict=True) if name not in drop
        ]
        check_channels(reader, [ref for _, ref in self.kept])
        self.extents = extents_of(reader.catalogue, [ref for _, ref in self.kept])
        maps = clock_maps(reader.clocks, reader.clock_maps) if clocks else []
        self.maps = [
            one if one.clock == name else replace(one, clock=name)
            for one, name in zip(maps, [self.named(one.clock) for one in maps], strict=True)
        ]
        reader.refuse_damage()
        head = reader.catalogue.head
        self.about = About(
            reader.catalogue.uuid,
            head.epoch_ns if head else None,
            head.epoch_uncertainty_ns if head else 0,
            reader.metadata,
        )

    def dataset(self, rates: Sequence[Fraction]) -> xarray.Dataset:
        chunks = {
            rate: chunks_of(self.reader.catalogue, rate, *self.extents[rate])
            for rate in rates
            if rate in self.extents
        }
        alone = len({ref.track.rate for _, ref in self.kept if ref.track.rate in rates}) == 1
        names = rate_names(ref.track.rate for _, ref in self.kept if ref.track.rate in rates)
        signals = []
        for name, ref in self.kept:
            rate = ref.track.rate
            if rate in rates:
                lazy = indexing.LazilyIndexedArray(
                    ChannelArray(self.files, self.version, ref.number, rate, *self.extents[rate])
                )
                time = "time" if alone else f"time_{names[rate]}"
                encoding = {"preferred_chunks": {time: chunks[rate]}}
                signals.append(DatasetVariable(name, ref.number, described(ref), lazy, encoding))
        return dataset_of(signals, self.extents, self.about, self.maps, rate_of=self.rate_of)

    def events(self) -> xarray.Dataset:
        reader = copy.copy(self.reader)
        numbers = {ref.number: name for ref, name in zip(self.refs, self.names, strict=True)}
        events = reader.events()
        reader.refuse_damage()
        return events_of(events, numbers, self.about)

    def group(self, group: str | None) -> xarray.Dataset:
        name = (group or "").strip("/")
        if not name:
            return self.dataset([*self.rates])
        if name == EVENTS:
            return self.events()
        for rate, own in self.rates.items():
            if own == name:
                return self.dataset([rate])
        raise ParameterError(unknown("group", name, [*self.rates.values(), EVENTS]))

    def groups(self) -> dict[str, xarray.Dataset]:
        found = {"/": xarray.Dataset(attrs=self.about.attributes())}
        kept = {ref.track.rate for _, ref in self.kept}
        found |= {f"/{n}": self.dataset([r]) for r, n in self.rates.items() if r in kept}
        if self.reader.catalogue.layers:
            found[f"/{EVENTS}"] = self.events()
        return found


WITHOUT_MEANING = (
    "mask_and_scale",
    "decode_times",
    "decode_timedelta",
    "use_cftime",
    "concat_characters",
    "decode_coords",
)
"""Keywords of xarray for files whose values are decoded after they are read."""


class HapfBackend(BackendEntrypoint):
    """Opens recordings in the hapf format for xarray."""

    description = "Open hapf recordings (.hapf) with hapfmt"
    open_dataset_parameters = (
        *("filename_or_obj", "drop_variables", "group", "clocks"),
        *WITHOUT_MEANING,
    )
    supports_groups = True

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        if not isinstance(filename_or_obj, (str, os.PathLike)):
            return False
        name = os.fspath(filename_or_obj)
        if isinstance(filename_or_obj, str) and is_url(name):
            return any(part.split("?")[0].endswith(".hapf") for part in name.split("::"))
        if name.endswith(".hapf"):
            return True
        try:
            with Path(name).open("rb") as file:
                return file.read(len(SIGNATURE)) == SIGNATURE
        except OSError:
            return False

    def open_dataset(
        self,
        filename_or_obj: Any,
        *,
        drop_variables: str | Iterable[str] | None = None,
        group: str | None = None,
        clocks: bool = True,
        **others: Any,
    ) -> xarray.Dataset:
        """A variable for each channel; ``group``: those of one rate, such as "1000Hz", or "events".

        ``clocks=False`` leaves the coordinates of other clocks out. That saves requests, and 6 us
        for each observation. The other keywords of xarray change nothing: values are in their
        units, and times in seconds.
        """
        refuse_others(others)
        file = opened(filename_or_obj, drop_variables, clocks=clocks)
        made: xarray.Dataset = closing(file, partial(file.group, group))
        made.set_close(file.files.close)
        return made

    def open_groups_as_dict(
        self,
        filename_or_obj: Any,
        *,
        drop_variables: str | Iterable[str] | None = None,
        group: str | None = None,
        clocks: bool = True,
        **others: Any,
    ) -> dict[str, xarray.Dataset]:
        """The groups: one for each rate, such as "/1000Hz", and "/events" where there are any.

        A slash in a label becomes "_": a tree has no variables with slashes in their names.
        """
        refuse_others(others)
        file = opened(filename_or_obj, drop_variables, clocks=clocks, is_tree=True)
        if group is not None and group.strip("/"):
            made: dict[str, xarray.Dataset] = {"/": closing(file, partial(file.group, group))}
        else:
            made = closing(file, file.groups)
        for one in made.values():
            one.set_close(file.files.close)
        return made

    def open_datatree(
        self,
        filename_or_obj: Any,
        *,
        drop_variables: str | Iterable[str] | None = None,
        group: str | None = None,
        clocks: bool = True,
        **others: Any,
    ) -> xarray.DataTree:
        """As :meth:`open_groups_as_dict`, as a tree."""
        found = self.open_groups_as_dict(
            filename_or_obj, drop_variables=drop_variables, group=group, clocks=clocks, **others
        )
        tree = xarray.DataTree.from_dict(found)
        for name, one in found.items():
            tree[name].set_close(one._close)
        return tree


def refuse_others(keywords: Iterable[str]) -> None:
    for name in keywords:
        if name not in WITHOUT_MEANING:
            raise ParameterError(unknown("keyword", name, HapfBackend.open_dataset_parameters[1:]))


def opened(
    file: Any, drop: str | Iterable[str] | None, *, clocks: bool, is_tree: bool = False
) -> HapfFile:
    if not isinstance(file, (str, os.PathLike)):
        raise ParameterError(
            f"xarray opens hapf files by path or URL, not a {type(file).__name__}; "
            "hapfmt.read(file).to_xarray() takes bytes and streams"
        )
    dropped = [drop] if isinstance(drop, str) else drop or ()
    path = os.fspath(file)
    # Workers have folders of their own, and this process may go to another one.
    path = path if isinstance(file, str) and is_url(path) else str(Path(path).absolute())
    return HapfFile(path, drop=dropped, clocks=clocks, is_tree=is_tree)


def closing(file: HapfFile, make: Any) -> Any:
    """The file is closed where ``make`` fails."""
    try:
        with unchanged(file.reader, file.version):
            return make()
    except BaseException:
        file.files.close()
        raise


__all__ = ["HapfBackend"]
