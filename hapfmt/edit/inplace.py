"""A damaged file repaired in place: its end, or all of it; then the damaged file is kept too."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, cast

from ..writing.appending import check_tail, open_append
from ..atomic import atomic_write, refusal, sync_directory
from ..format.source import open_source
from ..errors import FormatError, HapfmtError, ParameterError
from ..limits import Limits
from ..writing.file import open_live
from ..reading.catalogue import Catalogue
from ..reading.opening import from_walk
from ..verdict import HARMLESS
from .recover import Copy, Recovery, check_layout, write_checked

Progress = Callable[[int, int], None]
DAMAGED = ".damaged"


class Sink:
    """Takes everything and keeps nothing: what would be lost is found out before a file changes."""

    def write(self, data: bytes) -> int:
        return len(data)


def recover_in_place(
    path: str | os.PathLike[str],
    *,
    canonical: int | None = None,
    file_id: int | None = None,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> Recovery:
    """Make the file at ``path`` intact, with all that can still be read of it.

    Where only its end is damaged, or it was not closed, that is mended in the file itself. Else it
    is written anew and takes the name, and the damaged one is kept under the same name with
    ``.damaged`` behind it. An intact file is left alone. The file is locked meanwhile.

    Raises ParameterError where another program writes the file, or NAME.damaged exists.
    """
    name = os.fspath(path)
    with open_live(name):
        # A file that grows would seem to be damaged.
        catalogue, done, tail = survey(name, file_id, limits or Limits(), progress)
    if not done.findings and done.exit_code in (0, 4) and keeps_rules(name, limits or Limits()):
        return done
    # Appending copies the packets of a cut chunk without decoding them.
    if tail and not catalogue.unsupported and not done.undecodable:
        with open_append(name):
            pass
        if keeps_rules(name, limits or Limits()):
            done.file_size = Path(name).stat().st_size
            done.mended = "end"
            return done
    return rewrite(name, canonical, file_id, limits or Limits(), progress)


def keeps_rules(name: str, limits: Limits) -> bool:
    source = open_source(name)
    try:
        check_layout(source, limits)
    except FormatError:
        return False
    finally:
        source.close()
    return True


def survey(
    name: str, file_id: int | None, limits: Limits, progress: Progress | None
) -> tuple[Catalogue, Recovery, bool]:
    """What a recovery would find, and whether all of it lies at the end."""
    source = open_source(name)
    try:
        catalogue = from_walk(source, limits, tolerant=True, file_id=file_id)
        walked = [found for found in catalogue.findings if found.code not in HARMLESS]
        end = min((found.offset for found in walked), default=source.size)
        done = Copy(catalogue, cast(BinaryIO, Sink()), 0, limits, progress).run()
        tail = not done.empty_tracks and catalogue.head is not None
        tail = tail and all(found.offset >= end for found in done.findings)
        try:
            check_tail(catalogue, walked, end) if walked else None
        except ParameterError:
            tail = False
        return catalogue, done, tail
    except HapfmtError as error:
        raise error.at(path=name) from None
    finally:
        source.close()


def rewrite(
    name: str,
    canonical: int | None,
    file_id: int | None,
    limits: Limits,
    progress: Progress | None,
) -> Recovery:
    target = Path(os.path.realpath(name))
    kept = target.with_name(target.name + DAMAGED)
    if kept.exists():
        raise refusal(f"{kept} already exists; it is the name for the damaged file")
    beside = target.with_name(f".{secrets.token_hex(8)}.tmp")
    linked = False
    locked = open_live(target)
    try:
        with atomic_write(beside) as stream:
            source = open_source(target)
            try:
                catalogue = from_walk(source, limits, tolerant=True, file_id=file_id)
                done = write_checked(catalogue, stream, canonical, limits, progress)
            finally:
                source.close()
        os.link(target, kept)
        linked = True
        if os.name == "nt":
            # Nothing replaces a file there that is open.
            locked.close()
        beside.replace(target)
        linked = False
        sync_directory(target.parent)
    except BaseException:
        for name_ in [beside, kept] if linked else [beside]:
            with suppress(OSError):
                name_.unlink()
        raise
    finally:
        locked.close()
    done.mended, done.kept_as = "file", str(kept)
    return done
