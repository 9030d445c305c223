"""Bags of archives (RFC 8493), with an RO-Crate that is filled from the catalogue."""

from __future__ import annotations

import json
import logging
import os
import re
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from ..errors import MissingExtraError, ParameterError
from ..files import atomic_write
from ..format.source import is_url
from ..limits import Limits
from ..version import __version__
from .jobs import FileOutcome, Job
from .places import place_of
from .runs import FOLDER

DECLARATION = "bagit.txt"
CRATE = "ro-crate-metadata.json"
MISSING, UNKNOWN = "missing", "unknown"
MARK = "Written by hapfmt archive bag"
TAG_FILES = ("bag-info.txt", "manifest-sha256.txt", "tagmanifest-sha256.txt")
AMBIGUOUS = re.compile("[\r\n]|%(0a|0d|25)", re.IGNORECASE)


def bagit() -> Any:
    try:
        module = import_module("bagit")
    except ImportError:
        raise MissingExtraError("bagit", "archive") from None
    logging.getLogger("bagit").setLevel(logging.CRITICAL + 1)  # errors are reported by us
    return module


def is_bag(source: str) -> bool:
    return not is_url(source) and os.path.isfile(f"{source}/{DECLARATION}")  # noqa: PTH113 (never raises)


def bag_work(source: str, limits: Limits) -> tuple[list[Job], list[FileOutcome]]:
    """A job for each file that the bag lists, and what is wrong with the bag without reading its
    files: missing files, unknown files, a broken structure."""
    module = bagit()
    root = Path(source)
    try:
        bag = module.Bag(str(root))
        bag.validate_fetch()
        gone, extra = bag.compare_manifests_with_fs()
        if not (root / "data").is_dir() or not list(bag.manifest_files()):
            raise module.BagError("it has no data folder, or no manifest")
    except (module.BagError, OSError, ValueError) as error:
        return [], [FileOutcome(source, "nonconforming", 2, f"not a valid bag: {error}")]
    work, problems = [], []
    names = bag.normalized_filesystem_names
    for listed, expected in sorted(bag.entries.items()):
        name = names.get(module.normalize_unicode(listed), listed)
        path = root / name
        if listed in gone or not os.path.lexists(path):
            problems.append(FileOutcome(name, MISSING, 3, "the bag lists this file"))
            continue
        place = place_of(path, name)
        work.append(Job("verify", place, options={"expected": expected}, limits=limits))
    problems += [
        FileOutcome(name, UNKNOWN, 2, "the bag does not list this file") for name in sorted(extra)
    ]
    if not any(listed.startswith("data") for listed in bag.entries) and not problems:
        problems.append(FileOutcome(source, "nonconforming", 2, "the bag lists no file"))
    return work, problems


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
                raise ParameterError(f"{name!r} cannot be a line of bag-info.txt")


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
    """Undoes a bag that was interrupted while its checksums were computed."""
    data = root / "data"
    others = [path for path in root.iterdir() if path != data and path.name not in TAG_FILES]
    if is_bag(str(root)) or others or not is_ours(data / CRATE):
        return
    for name in TAG_FILES:
        (root / name).unlink(missing_ok=True)
    moved = root / f".{secrets.token_hex(8)}.tmp"
    data.rename(moved)
    for path in sorted(moved.iterdir()):
        path.rename(root / path.name)
    moved.rmdir()


def is_ours(crate: Path) -> bool:
    try:
        return MARK in crate.read_text("utf-8")
    except (OSError, ValueError):
        return False


def write_bag(root: Path, about: DepositFacts, processes: int) -> dict[str, Any]:
    """Makes the folder a bag of BagIt 1.0 with SHA-256 manifests, and says what it holds."""
    module = bagit()
    info: dict[str, Any] = {
        "Bag-Software-Agent": f"hapfmt {__version__} with bagit.py {module.VERSION}"
    }
    if about.title:
        info["External-Identifier"] = about.title
    if about.description:
        info["External-Description"] = " ".join(about.description.split())
    if about.authors:
        info["Contact-Name"] = list(about.authors)
    info |= dict(about.info)
    try:
        bag = module.make_bag(str(root), info, processes=processes, checksums=["sha256"])
        # The library writes version 0.97, which is older than RFC 8493. For these names the
        # contents of both versions are the same.
        with atomic_write(root / DECLARATION, force=True) as stream:
            stream.write(b"BagIt-Version: 1.0\nTag-File-Character-Encoding: UTF-8\n")
        bag.save()
        module.Bag(str(root)).validate(completeness_only=True)
    except (module.BagError, RuntimeError) as error:
        raise ParameterError(f"the bag could not be made: {error}", path=str(root)) from None
    size, _, count = bag.info["Payload-Oxum"].partition(".")
    return {"payload_size": int(size), "payload_count": int(count)}


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
            "encodingFormat": "application/vnd.hapf",
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
