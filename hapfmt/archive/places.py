"""Files, folders, patterns and URLs -> the files that are worked on, each with a name.

A name is relative to the folder or pattern that found the file. Links to folders are not followed,
so a loop of links ends nowhere. Links to files outside of the source are not followed either, so
that a folder from anyone shows no other file of the disk. A link that leads outside is reported.
Hidden files are left out.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from glob import glob, has_magic
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

from ..convert.formats import HAPF, formats
from ..errors import HapfmtError, ParameterError
from ..format.source import is_url, network, shown

FILE_URL = "file://"
CATALOGUE = "catalogue.parquet"
"""Name of a catalogue in its folder; it is not a recording."""
LINK = "a link out of its source is not followed; name its target as a SOURCE"
"""``error`` of a place that is such a link."""


@dataclass(frozen=True)
class Place:
    """A file to work on, or the reason why there is none.

    ``name`` is relative to its source, with "/" between folders. ``location`` is its path or URL.
    ``signature`` changes when the file does. ``error`` says why it cannot be worked on. ``source``
    is the folder that the name begins in, as it was given. ``real`` is the path without links.
    """

    name: str
    location: str
    size: int = 0
    signature: str = ""
    error: str = ""
    source: str = ""
    real: str = ""

    @property
    def is_url(self) -> bool:
        return is_url(self.location)

    @property
    def shown(self) -> str:
        """The location without a password."""
        return shown(self.location) if self.is_url else self.location


Wanted = Callable[[str], bool]
"""Whether files of a suffix are wanted, of those that a folder holds."""


def is_hapf(suffix: str) -> bool:
    return suffix == HAPF


def is_foreign(suffix: str) -> bool:
    """Suffixes of the formats that can be encoded."""
    return any(suffix in one.suffixes for one in formats().values() if one.reads)


def is_any(suffix: str) -> bool:
    return is_hapf(suffix) or is_foreign(suffix)


def local_path(location: str) -> str:
    """The path of a file:// URL; any other text as it is."""
    if location.lower().startswith(FILE_URL):
        return unquote(urlsplit(location).path)
    return location


def find_places(
    sources: Iterable[str], wanted: Wanted, left_out: list[Place] | None = None
) -> list[Place]:
    """The files of all sources in order of their names; a file that is found twice counts once.
    ``left_out`` gets those that are not wanted."""
    found: dict[str, Place] = {}
    left: list[Place] = []
    for source in map(local_path, sources):
        listed = remote_places if is_url(source) else local
        for place in listed(source, wanted, left):
            key = place.location if place.is_url else str(Path(place.location).absolute())
            found.setdefault(key, place)
    if left_out is not None:
        left_out += left
    return sorted(found.values(), key=lambda place: (place.name, place.location))


def with_sources(places: Iterable[Place], sources: Sequence[str]) -> list[Place]:
    """Names that begin with their source, where there are several sources."""
    if len(sources) < 2:
        return list(places)
    return [
        replace(one, name=one.shown if one.is_url else str(PurePosixPath(one.source) / one.name))
        for one in places
    ]


def outside(places: Iterable[Place], sources: Iterable[str], target: Path) -> list[Place]:
    """Without the outputs of earlier runs, where the target folder lies within a source."""
    root = target.resolve()
    folders = [Path(each).resolve() for each in map(local_path, sources) if not is_url(each)]
    for source in folders:
        if root in source.parents:
            raise ParameterError(f"{source} lies in the folder TARGET; give a TARGET outside of it")
    if root in folders:
        return list(places)  # outputs get their place next to the inputs
    return [each for each in places if each.is_url or root not in Path(each.location).parents]


def suffix_of(name: str) -> str:
    return PurePosixPath(name).suffix.lower()


def local(source: str, wanted: Wanted, left: list[Place]) -> Iterator[Place]:
    path = Path(source)
    if has_magic(source) and not os.path.lexists(source):
        yield from matches(source, wanted, left)
    elif is_folder(path):
        yield from folder_places(path, "", wanted, left, source)
    else:
        yield replace(place_of(path, path.name), source=str(path.parent))


def pattern_matches(pattern: str) -> list[str]:
    return sorted(glob(pattern, recursive=True))  # noqa: PTH207 (its patterns may begin anywhere)


def matches(pattern: str, wanted: Wanted, left: list[Place]) -> Iterator[Place]:
    """Files that a pattern fits. Their names begin after its first folder without wildcards."""
    parts = Path(pattern).parts
    fixed = next(i for i, part in enumerate(parts) if has_magic(part))
    root = Path(*parts[:fixed])
    chosen = bool(suffix_of(pattern)) and not has_magic(suffix_of(pattern))
    found = pattern_matches(pattern)
    if not found:
        yield Place(pattern, pattern, error="no file fits this pattern")
    for name in found:
        path = Path(name)
        below = path.relative_to(root).as_posix()
        if is_folder(path):
            if path.is_symlink():
                yield from folder_link(root, path, below, str(root))
            else:
                yield from folder_places(path, f"{below}/", wanted, left, str(root))
        elif chosen or (wanted(suffix_of(name)) and path.name != CATALOGUE):
            yield place_within(root, path, below, str(root))
        elif path.name != CATALOGUE:
            left.append(Place(below, str(path)))


def folder_places(
    folder: Path, prefix: str, wanted: Wanted, left: list[Place], source: str
) -> Iterator[Place]:
    """What lies in a folder and below it, without recursion: folders may be deep."""
    waiting = [(folder, prefix)]
    markers = [one.folder for one in formats().values() if one.reads and one.folder]
    while waiting:
        here, before = waiting.pop()
        try:
            with os.scandir(here) as listed:
                entries = sorted(listed, key=lambda entry: entry.name)
        except OSError as error:
            name = before.rstrip("/")
            yield Place(name or str(here), str(here), error=reason(error), source=name and source)
            continue
        for entry in entries:
            name = before + entry.name
            if entry.name.startswith(".") or entry.name == CATALOGUE:
                continue
            if entry.is_dir(follow_symlinks=False):
                inner = Path(entry.path)
                # Some formats are folders: ROS 2 bags and sets of LeRobot.
                if wanted(".npz") and any(is_there(inner / marker) for marker in markers):
                    yield folder_place(folder, inner, name, source)
                else:
                    waiting.append((inner, f"{name}/"))
            elif is_folder(entry):
                yield from folder_link(folder, Path(entry.path), name, source)
            elif wanted(suffix_of(entry.name)):
                yield place_within(folder, Path(entry.path), name, source)
            else:
                left.append(Place(name, entry.path))


def is_folder(entry: os.DirEntry[str] | Path) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # such as a folder around it that may not be read
        return False


def is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        return False


def folder_link(root: Path, path: Path, name: str, source: str) -> Iterator[Place]:
    """A place with an error where a link leads to a folder that is not below ``root``."""
    if leads_out(root, path) and not root.samefile(path):
        yield Place(name, str(path.absolute()), error=LINK, source=source)


def place_within(root: Path, path: Path, name: str, source: str) -> Place:
    """A file below ``root``, or an error where it is a link to one that is not."""
    if leads_out(root, path):
        return Place(name, str(path.absolute()), error=LINK, source=source)
    return replace(place_of(path, name), source=source)


def leads_out(root: Path, path: Path) -> bool:
    return Path(os.path.realpath(root)) not in Path(os.path.realpath(path)).parents


def place_of(path: Path, name: str) -> Place:
    path = path.absolute()  # workers have folders of their own
    try:
        info = path.stat()
    except OSError as error:
        return Place(name, str(path), error=reason(error))
    if not stat.S_ISREG(info.st_mode):
        return Place(name, str(path), error="not a regular file")
    signature = f"{info.st_size} {info.st_mtime_ns}"
    return Place(name, str(path), info.st_size, signature, real=os.path.realpath(path))


def folder_place(root: Path, folder: Path, name: str, source: str) -> Place:
    """A recording that is a folder: its size and its latest change count."""
    folder = folder.absolute()
    size, latest = 0, 0
    for path in sorted(folder.rglob("*")):
        try:
            info = path.lstat()
        except OSError as error:
            return Place(name, str(folder), error=reason(error), source=source)
        if stat.S_ISLNK(info.st_mode) and leads_out(root, path):
            return Place(name, str(folder), error=LINK, source=source)
        size += info.st_size if stat.S_ISREG(info.st_mode) else 0
        latest = max(latest, info.st_mtime_ns)
    real = os.path.realpath(folder)
    return Place(name, str(folder), size, f"{size} {latest}", source=source, real=real)


def reason(error: OSError) -> str:
    return error.strerror or str(error)


def file_system(url: str) -> tuple[Any, str]:
    """The file system of fsspec for a URL, and the path within it."""
    try:
        core = import_module("fsspec.core")
        files, path = core.url_to_fs(url)
    except ValueError as error:
        raise ParameterError(f"{shown(url)}: {error}") from None
    return files, path


def remote_places(url: str, wanted: Wanted, left: list[Place]) -> Iterator[Place]:
    try:
        with network(shown(url)):
            listed = remote_list(url)
    except (HapfmtError, OSError) as error:
        text = reason(error) if isinstance(error, OSError) else error.message
        yield Place(shown(url), url, error=text)
        return
    chosen = len(listed) == 1 and listed[0][0] == PurePosixPath(urlsplit(url).path).name
    for name, location, info in listed:
        is_catalogue = PurePosixPath(name).name == CATALOGUE
        if chosen or (wanted(suffix_of(name)) and not is_catalogue):
            size = int(info.get("size") or 0)
            yield Place(name, location, size, f"{size} {stamp_of(info)}")
        elif not is_catalogue:
            left.append(Place(name, location))


def remote_list(url: str) -> list[tuple[str, str, dict[str, Any]]]:
    """Name, URL and facts of each file."""
    files, path = file_system(url)
    is_http = url.lower().startswith("http")
    if has_magic(path):
        root = re.split(r"[^/]*[*?\[]", path)[0]
        found = files.glob(path, detail=True)
    elif (is_http and not path.endswith("/")) or (not is_http and files.isfile(path)):
        root, found = path.rpartition("/")[0], {path: files.info(path)}
    else:
        root = path
        found = files.find(path, detail=True)
        if not found and not is_http and not files.exists(path):
            raise FileNotFoundError(2, "not found", shown(url))
    listed = []
    for name, info in sorted(found.items()):
        if info.get("type") == "directory":
            continue
        below = name[len(root) :].lstrip("/") if name.startswith(root) else name
        if not any(part.startswith(".") for part in below.split("/")):
            listed.append((below, files.unstrip_protocol(name), info))
    return listed


def stamp_of(info: dict[str, Any]) -> str:
    """What changes with the content of a remote file, as far as its server says."""
    for key in ("ETag", "etag", "LastModified", "mtime", "created"):
        if info.get(key):
            return str(info[key])
    return ""
