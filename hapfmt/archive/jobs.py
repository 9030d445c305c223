"""A job and its outcome; the bytes of its file; outputs that appear whole.

Outputs are written completely in a folder of their own, and then take their name in one step.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

from ..errors import INTACT, ParameterError
from ..files import refusal, sync_directory
from ..format.source import is_url, network, shown, spooled_url
from ..limits import Limits
from .places import Place, file_system

ERROR = 1
WHOLE = 64 << 20
"""Files up to this size are read once into memory, to be hashed and decoded."""
CHUNK = 1 << 20
ATOMIC = ("s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "memory")
"""Kinds of storage where an object appears when all of it has arrived."""


@dataclass(frozen=True)
class Job:
    """What one file needs. ``options`` are those of the verb; ``staging`` is the folder of
    unfinished outputs."""

    verb: str
    place: Place
    target: str = ""
    staging: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    limits: Limits = field(default_factory=Limits)
    force: bool = False
    begun: bool = False
    """This run began it when its target was not there, so a target that is there now is its own."""


def few_of(summary: Sequence[str]) -> list[str]:
    """The first lines on damage and losses, and how many more there are."""
    more = len(summary) - FEW
    rest = [f"and {more} more: hapfmt verify FILE lists all"] if more > 0 else []
    return [*summary[:FEW], *rest]


FEW = 3


@dataclass
class FileOutcome:
    """What became of one file: ``result`` in one word, an exit code of SPEC clause 13, and a
    message where something is wrong."""

    name: str
    result: str
    exit_code: int = INTACT
    message: str = ""
    notes: list[str] = field(default_factory=list)
    target: str = ""
    read_size: int = 0
    written_size: int = 0
    seconds: float = 0.0
    rows: list[dict[str, Any]] = field(default_factory=list)
    """Rows of the catalogue: one for each channel."""

    def as_json(self) -> dict[str, Any]:
        return {
            "file": self.name,
            "result": self.result,
            "exit_code": self.exit_code,
            "message": self.message or None,
            "notes": self.notes,
            "target": self.target or None,
            "read_size": self.read_size,
            "written_size": self.written_size,
            "seconds": round(self.seconds, 6),
        }


@contextmanager
def published(job: Job, suffix: str) -> Iterator[Path]:
    """A path for an unfinished output, which takes the name ``job.target`` at the end."""
    remote = is_url(job.target)
    if not remote and not job.force and os.path.lexists(job.target):
        raise exists(job.target)  # before the work
    if remote:
        folder = Path(tempfile.mkdtemp(prefix="hapfmt-"))
    else:
        folder = Path(job.staging)
        folder.mkdir(parents=True, exist_ok=True)
    staged = folder / f"{secrets.token_hex(8)}{suffix}"
    try:
        yield staged
        if remote:
            upload(staged, job.target, force=job.force)
        else:
            move(staged, Path(job.target), force=job.force)
    finally:
        if staged.is_dir():
            shutil.rmtree(staged, ignore_errors=True)
        with suppress(OSError):
            staged.unlink()
        if remote:
            shutil.rmtree(folder, ignore_errors=True)


def move(staged: Path, target: Path, *, force: bool) -> None:
    """In one step, and never onto a file that is there, unless with ``force``."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if staged.is_dir():
        if target.exists():
            if not force:
                raise exists(target)
            old = staged.with_suffix(".old")
            target.rename(old)
            staged.rename(target)
            shutil.rmtree(old)
        else:
            staged.rename(target)
    elif force:
        if target.is_dir():
            raise refusal("the target is a directory")
        staged.replace(target)
    else:
        try:
            os.link(staged, target)  # fails where the name is taken, which rename does not
        except FileExistsError:
            raise exists(target) from None
        except OSError:
            # Some file systems have no links.
            if target.exists():
                raise exists(target) from None
            staged.rename(target)
    sync_directory(target.parent)


def exists(target: Path | str) -> ParameterError:
    return refusal(f"{target} already exists; use force=True to overwrite it")


def upload(staged: Path, target: str, *, force: bool) -> None:
    if staged.is_dir():
        raise ParameterError("this format is a folder, and needs a local target")
    with network(shown(target)):
        files, path = file_system(target)
        if not force and files.exists(path):
            raise exists(shown(target))
        if target.partition(":")[0].lower() in ATOMIC:
            files.put_file(str(staged), path)
            return
        part = f"{path}.{secrets.token_hex(4)}.part"
        files.makedirs(path.rpartition("/")[0], exist_ok=True)
        try:
            files.put_file(str(staged), part)
            files.mv(part, path)
        except BaseException:
            with suppress(Exception):
                files.rm(part)
            raise


def content(place: Place) -> bytes | Any:
    """The bytes of a small file; of a large one its path, or a spooled copy of a URL."""
    if place.is_url:
        stream = spooled_url(place.location)
        if place.size > WHOLE:
            return stream
        with stream:
            stream.seek(0)
            return stream.read()
    if place.size <= WHOLE:
        return Path(place.location).read_bytes()
    return place.location


def hashed(file: Any, algorithms: tuple[str, ...]) -> dict[str, str]:
    """Checksums of what :func:`content` returns."""
    sums = {name: hashlib.new(name) for name in algorithms}
    with (
        BytesIO(file)
        if isinstance(file, bytes)
        else Path(file).open("rb")
        if isinstance(file, str)
        else nullcontext(file)
    ) as stream:
        stream.seek(0)
        while data := stream.read(CHUNK):
            for each in sums.values():
                each.update(data)
    return {name: each.hexdigest() for name, each in sums.items()}
