"""Files attached to a recording, and taken out again (SPEC 6.8)."""

from __future__ import annotations

import mimetypes
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ..atomic import atomic_write, refuse
from ..format.extras import Attachment, build_attachment
from ..errors import ParameterError
from ..names import unknown
from .appended import appended
from .making import Output
from .original import Input, Original, open_original


def attach(
    file: Input,
    attachments: Sequence[Attachment],
    out: Output | None = None,
    *,
    force: bool = False,
) -> list[str]:
    """Append attachments to a file, or to a copy of it at ``out``; returns notes.

    The file's other contents do not change. Raises ParameterError where an attachment is too large
    for the file's level (then all are refused), and where another program writes the file.
    """
    payloads = [build_attachment(attachment) for attachment in attachments]
    if not payloads:
        raise ParameterError("nothing to attach")
    with appended(file, out, force=force) as (writer, catalogue, note):
        limit = writer.level.payload_size
        for attachment, payload in zip(attachments, payloads, strict=True):
            if len(payload) > limit:
                raise ParameterError(
                    f"{attachment.name}: {len(payload)} bytes with its name are above {limit}, the "
                    f"limit of level {writer.level.number}"
                    + ("; subset with level 2 writes a file with more room" * (limit < 1 << 24))
                )
        notes = [note] if note else []
        taken = Counter(each.name for each in catalogue.attachments.values())
        for attachment in attachments:
            writer.attach(attachment)
            taken[attachment.name] += 1
            number = taken[attachment.name]
            if number > 1:
                notes.append(
                    f"the file already has an attachment {attachment.name!r}; the new one is "
                    f"listed as '{attachment.name} ({number})'"
                )
    return notes


def attachment_of(
    path: str | os.PathLike[str], *, name: str | None = None, media_type: str | None = None
) -> Attachment:
    """The file at ``path``, under its own name; the media type is guessed from that."""
    known = Path(path).name if name is None else name
    guessed = mimetypes.guess_type(known)[0] or ""
    return Attachment(known, guessed if media_type is None else media_type, Path(path).read_bytes())


def extract(
    file: Input | Original,
    names: Sequence[str] | None = None,
    folder: str | os.PathLike[str] = ".",
    *,
    force: bool = False,
) -> list[Path]:
    """Write attachments, all or those of some names, into a folder; returns their paths.

    A name from a file is never a path (SPEC ATT-002): only its last part is used, and a number
    where two are alike.
    """
    with open_original(file, scan=False) as original:
        known = original.attachments
        for name in names or ():
            if name not in known:
                raise ParameterError(unknown("attachment", name, known.keys()))
        chosen = [known[name] for name in (known if names is None else dict.fromkeys(names))]
    taken: set[str] = set()
    paths = []
    for attachment in chosen:
        path = Path(folder) / free_name(attachment.safe_name, taken)
        taken.add(path.name.casefold())
        refuse(os.fspath(path), force)
        paths.append(path)
    for path, attachment in zip(paths, chosen, strict=True):
        with atomic_write(path, force=force) as stream:
            stream.write(attachment.content)
    return paths


def free_name(name: str, taken: set[str]) -> str:
    """With a number before its suffix where it is taken, whatever the case of its letters."""
    candidate, number = name, 1
    while candidate.casefold() in taken:
        number += 1
        candidate = f"{Path(name).stem} ({number}){Path(name).suffix}"
    return candidate
