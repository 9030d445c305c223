"""Bags of archives (RFC 8493), with an RO-Crate that is filled from the catalogue."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import date
from functools import partial
from glob import has_magic
from importlib import import_module
from pathlib import Path
from typing import Any

from ..errors import MissingExtraError, ParameterError
from ..files import sync_directory
from ..format.extras import MEDIA_TYPE
from ..format.source import is_url
from ..limits import Limits
from ..version import __version__
from .jobs import FileOutcome, Job, hashed
from .places import Place, pattern_matches, place_of
from .runs import FOLDER

DECLARATION = "bagit.txt"
CRATE = "ro-crate-metadata.json"
MISSING, UNKNOWN = "missing", "unknown"
MARK = "Written by hapfmt archive bag"
TITLE = "Title"
"""Our own element of bag-info.txt: RFC 8493 reserves none for a title."""
MANIFEST, INFO, TAG_MANIFEST = "manifest-sha256.txt", "bag-info.txt", "tagmanifest-sha256.txt"
UNFINISHED = ".hapfmt-bag"
"""Folder in which a bag is prepared."""
PAYLOAD_MANIFEST = re.compile(r"manifest-\w+\.txt")
TAG_FILE = re.compile(r"bagit\.txt|bag-info\.txt|fetch\.txt|(tag)?manifest-\w+\.txt")
AMBIGUOUS = re.compile("[\r\n]|%(0a|0d|25)", re.IGNORECASE)


def bagit() -> Any:
    try:
        module = import_module("bagit")
    except ImportError:
        raise MissingExtraError("bagit", "archive") from None
    logging.getLogger("bagit").setLevel(logging.CRITICAL + 1)  # errors are reported by us
    return module


def is_bag(source: str) -> bool:
    """Whether a folder is a bag, or what is left of one."""
    if is_url(source):
        return False
    try:
        names = os.listdir(source)  # noqa: PTH208 (a source may be no path)
    except OSError:
        return False
    return (
        DECLARATION in names
        or UNFINISHED in names
        or ("data" in names and any(map(PAYLOAD_MANIFEST.fullmatch, names)))
    )


def bag_around(path: Path) -> Path | None:
    """The bag that a path lies in."""
    parents = Path(os.path.realpath(path)).parents
    return next((each for each in parents if is_bag(str(each))), None)


def refuse_bag(path: str, instead: str) -> None:
    """Raises ParameterError where a new file would make a bag invalid."""
    bag = path if is_bag(path) else bag_around(Path(path))
    if bag:
        raise ParameterError(
            f"{bag} is a bag, and a new file would make it invalid: {instead}", path=""
        )


def bags_of(source: str) -> list[str]:
    """The bags that a folder or a pattern finds, without those within a bag."""
    if is_url(source):
        return []
    found: list[str] = []
    is_pattern = has_magic(source) and not os.path.lexists(source)
    for root in pattern_matches(source) if is_pattern else [source]:
        for folder, folders, _ in os.walk(root):
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            if is_bag(folder):
                found.append(folder)
                folders.clear()
    return list(dict.fromkeys(found))


def not_bagged(places: Iterable[Place], bags: Iterable[str]) -> list[Place]:
    """Without the files of these bags: the bags list them."""
    roots = {os.path.realpath(each) for each in bags}

    def folders(location: str) -> list[str]:
        here = Path(os.path.realpath(Path(location).parent))  # the file itself may be a link
        return [str(here), *map(str, here.parents)]

    return [one for one in places if one.is_url or not roots.intersection(folders(one.location))]


def bag_work(source: str, limits: Limits, prefix: str) -> tuple[list[Job], list[FileOutcome]]:
    """A job for each file that the bag lists, and what is wrong with the bag without reading its
    files: missing files, unknown files, links, a broken structure. ``prefix``: of their names."""
    module = bagit()
    root = Path(source)
    problems: list[FileOutcome] = []

    def problem(name: str, result: str, code: int, text: str) -> None:
        problems.append(FileOutcome(prefix + name, result, code, text))

    class Bag(module.Bag):  # type: ignore[misc,name-defined]
        """A link in the bag is a problem of that file, not of the bag."""

        def _path_is_dangerous(self, path: str) -> bool:
            return Path(path).is_absolute() or path.startswith(("..", "~")) or path == "."

    try:
        if not (root / DECLARATION).is_file():
            if (root / UNFINISHED).exists():
                raise module.BagError("it is not complete; run hapfmt archive bag again")
            raise module.BagError(f"{DECLARATION} is missing")
        bag = Bag(str(root))
        bag.validate_fetch()
        gone, extra = bag.compare_manifests_with_fs()
        if not (root / "data").is_dir() or not list(bag.manifest_files()):
            raise module.BagError("it has no data folder, or no manifest")
    except (module.BagError, OSError, ValueError) as error:
        return [], [FileOutcome(source, "nonconforming", 2, f"not a valid bag: {error}")]
    work = []
    names = bag.normalized_filesystem_names
    for listed, expected in sorted(bag.entries.items()):
        name = names.get(module.normalize_unicode(listed), listed)
        path = root / name
        if has_link(root, name):
            problem(name, "damaged", 3, "a link is in the place of this file")
        elif listed in gone or not os.path.lexists(path):
            problem(name, MISSING, 3, "the bag lists this file")
        else:
            place = place_of(path, prefix + name)
            work.append(Job("verify", place, options={"expected": expected}, limits=limits))
    for name in sorted([*extra, *unlisted(root, set(bag.entries))]):
        problem(name, UNKNOWN, 2, "the bag does not list this file")
    if not any(listed.startswith("data") for listed in bag.entries) and not problems:
        problems.append(FileOutcome(source, "nonconforming", 2, "the bag lists no file"))
    return work, problems


def has_link(root: Path, name: str) -> bool:
    path = root / name
    return any(each.is_symlink() for each in (path, *path.parents) if root in each.parents)


def unlisted(root: Path, listed: set[str]) -> Iterator[str]:
    """Links to folders, and files outside of the payload that no manifest of tag files lists."""
    has_manifest = any(root.glob("tagmanifest-*.txt"))
    for folder, folders, names in os.walk(root):
        here = Path(folder).relative_to(root)
        links = [name for name in folders if (Path(folder) / name).is_symlink()]
        for name in links if here.parts[:1] == ("data",) else [*links, *names]:
            below = (here / name).as_posix()
            is_own = TAG_FILE.fullmatch(below) and (
                not has_manifest or below.startswith("tagmanifest-")
            )
            if below not in listed and not is_own:
                yield below


@dataclass(frozen=True)
class DepositFacts:
    """What people say about a deposit; the rest comes from the catalogue."""

    title: str = ""
    description: str = ""
    license: str = ""
    authors: tuple[str, ...] = ()
    info: tuple[tuple[str, str], ...] = ()
    """Further lines of bag-info.txt."""

    def __post_init__(self) -> None:
        for name, value in (("title", self.title), *self.info):
            if any(sign in name + value for sign in "\r\n") or ":" in name or not name.strip():
                raise ParameterError(
                    f"{name!r} with its text cannot be a line of bag-info.txt "
                    "(--title, --info KEY=VALUE)"
                )


def unbaggable(root: Path) -> list[FileOutcome]:
    """Files that a bag cannot hold, or that other programs could not find in it."""
    found = []
    for folder, folders, names in os.walk(root):
        for name in [*folders, *names]:
            path = Path(folder) / name
            below = path.relative_to(root).as_posix()
            problem = ""
            if path.is_symlink():
                problem = "a bag holds no links; put the file itself here"
            elif name in names and not path.is_file():
                problem = "not a regular file"
            elif not is_text(below):
                problem = "the name is not UTF-8"
            elif AMBIGUOUS.search(below):
                problem = (
                    "programs read line breaks, %0A, %0D and %25 in names of a bag differently"
                )
            elif not os.access(path, os.R_OK):
                problem = "it cannot be read"
            if problem:
                found.append(FileOutcome(below, "failed", 1, problem))
    return sorted(found, key=lambda outcome: outcome.name)


def is_text(name: str) -> bool:
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def unpack_unfinished(root: Path) -> None:
    """Undoes a bag that was interrupted: every step of :func:`write_bag`, in reverse."""
    room = root / UNFINISHED
    if not room.is_dir() or (root / DECLARATION).exists():
        return
    payload = room / "data"
    if (room / DECLARATION).exists():  # the files may have moved
        for name in (MANIFEST, INFO, TAG_MANIFEST):
            (root / name).unlink(missing_ok=True) if not (room / name).exists() else None
        if not payload.exists():
            (root / "data").rename(payload)
        for path in sorted(payload.iterdir()):
            if os.path.lexists(root / path.name):
                raise ParameterError(f"{path} is in the way of an unfinished bag: {room}", path="")
            path.rename(root / path.name)
    shutil.rmtree(room)


def is_ours(crate: Path) -> bool:
    try:
        return MARK in crate.read_text("utf-8")
    except (OSError, ValueError):
        return False


def write_bag(root: Path, about: DepositFacts, processes: int) -> dict[str, Any]:
    """Makes the folder a bag of BagIt 1.0 with SHA-256 manifests, and says what it holds.

    The tag files are complete before a file moves, and ``bagit.txt`` gets its place last. After
    an interruption the folder lacks it, and :func:`unpack_unfinished` undoes every step.
    """
    module = bagit()
    names = sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file())
    entries = list(root.iterdir())
    with ThreadPoolExecutor(processes) as pool:
        sums = list(pool.map(partial(sha256, root), names))
    size = sum((root / name).stat().st_size for name in names)
    tags = {
        DECLARATION: "BagIt-Version: 1.0\nTag-File-Character-Encoding: UTF-8\n",
        INFO: "".join(f"{key}: {value}\n" for key, value in info_of(about, size, len(names))),
        MANIFEST: "".join(
            f"{value}  data/{name}\n" for value, name in zip(sums, names, strict=True)
        ),
    }
    room = root / UNFINISHED
    try:
        (room / "data").mkdir(parents=True)
        (room / "data").chmod(root.stat().st_mode)
        for name in (INFO, MANIFEST):
            write_whole(room / name, tags[name])
        listed = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in tags.items()}
        lines = [f"{listed[name]}  {name}\n" for name in sorted(listed)]
        write_whole(room / TAG_MANIFEST, "".join(lines))
        write_whole(room / DECLARATION, tags[DECLARATION])
        for path in entries:
            path.rename(room / "data" / path.name)
        for name in ("data", MANIFEST, INFO, TAG_MANIFEST, DECLARATION):
            (room / name).rename(root / name)
        room.rmdir()
        sync_directory(root)
    except BaseException:
        unpack_unfinished(root)
        raise
    try:
        module.Bag(str(root)).validate(completeness_only=True)
    except module.BagError as error:
        raise ParameterError(f"the bag is not valid: {error}", path=str(root)) from None
    return {"payload_size": size, "payload_count": len(names)}


def sha256(root: Path, name: str) -> str:
    return hashed(str(root / name), ("sha256",))["sha256"]


def write_whole(path: Path, text: str) -> None:
    with path.open("xb") as stream:
        stream.write(text.encode())
        stream.flush()
        os.fsync(stream.fileno())


def info_of(about: DepositFacts, size: int, count: int) -> Iterator[tuple[str, str]]:
    """The lines of bag-info.txt. A line that was given replaces ours."""
    lines = [
        (TITLE, about.title),
        ("External-Description", " ".join(about.description.split())),
        *(("Contact-Name", " ".join(name.split())) for name in about.authors),
        ("Bagging-Date", date.today().isoformat()),
        ("Bag-Software-Agent", f"hapfmt {__version__}"),
    ]
    given = {name for name, _ in about.info}
    yield from ((name, text) for name, text in lines if text and name not in given)
    yield from (line for line in about.info if line[0] != "Payload-Oxum")
    yield "Payload-Oxum", f"{size}.{count}"


def hidden_files(root: Path) -> list[str]:
    below = (path.relative_to(root) for path in sorted(root.rglob("*")) if path.is_file())
    return [
        path.as_posix()
        for path in below
        if any(part.startswith(".") for part in path.parts)
        and path.parts[0] not in (FOLDER, UNFINISHED)
    ]


def crate_of(
    root: Path, rows: Iterable[Mapping[str, Any]], about: DepositFacts, catalogue: str
) -> bytes:
    """An RO-Crate: every file, its checksum and the channels that it measures."""
    try:
        crates = import_module("rocrate.rocrate")
        entities = import_module("rocrate.model.contextentity")
    except ImportError:
        raise MissingExtraError("rocrate", "archive") from None
    crate = crates.ROCrate(version="1.2")
    crate.metadata["description"] = MARK
    crate.name = about.title or root.resolve().name
    crate.description = about.description or "Recorded touch in hapf files"
    if about.license:
        crate.license = about.license
    people = [
        crate.add(entities.ContextEntity(crate, f"#author-{place}", properties={
            "@type": "Person", "name": name,
        }))
        for place, name in enumerate(about.authors, 1)
    ]  # fmt: skip
    if people:
        crate.root_dataset["author"] = people
    by_file: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_file.setdefault(row["file"], []).append(row)
    variables = variables_of(by_file)
    for number, ((label, unit, quantity), (low, high)) in enumerate(variables.items()):
        limits = {
            "name": label, "unitText": unit, "propertyID": quantity, "minValue": low,
            "maxValue": high,
        }  # fmt: skip
        crate.add(
            entities.ContextEntity(
                crate, f"#channel-{number}",
                properties={"@type": "PropertyValue"}
                | {name: value for name, value in limits.items() if value not in ("", None)},
            )
        )  # fmt: skip
    numbers = {key: f"#channel-{number}" for number, key in enumerate(variables)}
    for name, own in by_file.items():
        first = own[0]
        facts: dict[str, Any] = {
            "name": name,
            "encodingFormat": MEDIA_TYPE,
            "contentSize": str(first["file_size"]),
            "sha256": first["checksum"],
            "dateCreated": iso(min((r["recorded"] for r in own if r.get("recorded")), default="")),
            "variableMeasured": [
                {"@id": numbers[variable(row)]} for row in own if row.get("channel") is not None
            ],
        }
        crate.add_file(None, name, properties={key: value for key, value in facts.items() if value})
    crate.add_file(
        None, catalogue,
        properties={
            "name": "Catalogue: one row for each channel of each file",
            "encodingFormat": "application/vnd.apache.parquet",
        },
    )  # fmt: skip
    listed = {*by_file, catalogue, CRATE}
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if path.is_file() and name not in listed and not name.startswith(f"{FOLDER}/"):
            crate.add_file(None, name, properties={"contentSize": str(path.stat().st_size)})
    return json.dumps(crate.metadata.generate(), indent=1, sort_keys=True).encode() + b"\n"


def iso(value: Any) -> str:
    return value.isoformat() if hasattr(value, "isoformat") else str(value)


def variable(row: Mapping[str, Any]) -> tuple[str, str, str]:
    return row.get("label") or "", row.get("unit") or "", row.get("quantity") or ""


def variables_of(
    by_file: Mapping[str, list[Mapping[str, Any]]],
) -> dict[tuple[str, str, str], tuple[float | None, float | None]]:
    """The channels of all files by label, unit and quantity, with their range."""
    found: dict[tuple[str, str, str], tuple[float | None, float | None]] = {}
    for rows in by_file.values():
        for row in rows:
            if row.get("channel") is None:
                continue
            low, high = found.get(variable(row), (None, None))
            lows = [each for each in (low, row.get("min")) if each is not None]
            highs = [each for each in (high, row.get("max")) if each is not None]
            found[variable(row)] = min(lows, default=None), max(highs, default=None)
    return found
