"""The answers of one subject: a file of JSON lines, of which every one is on the disk before the
next question is asked.

The first line says whose answers these are, to which study, felt how and in which order; each other
line is one answer, and of two answers to one question the later counts. A line without its newline
was torn by a crash: it is told, and counts for nothing.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from msgspec import Meta, Struct

from ...atomic import sync_directory
from ...descriptions import parse_json, read
from ...errors import ParameterError
from ...lock import lock
from .description import HIGHEST, Role
from .files import open_regular, refuse_special
from .order import Trial

Made = TypeVar("Made")
VERSION = 1
LARGEST = 64 << 20
"""Bytes."""
Number = Annotated[float, Meta(ge=-1e12, le=1e12)]
"""No number of a study is larger."""


class Judged(Struct):
    """What the first line says of the study."""

    name: str
    sha256: str
    scale: Annotated[tuple[str, ...], Meta(min_length=1)]
    screen_below: Number
    screen_share: Number


class Rated(Struct):
    """What the first line says of a condition."""

    name: str
    role: Role
    bits_per_sample: dict[str, Number]
    bits: int | None = None
    k: Number | str | None = None


class Heading(Struct):
    """The first line; it may have other keys too."""

    hapfmt_answers: Literal[1]
    study: Judged
    stimuli_sha256: str
    subject: str
    output: dict[str, Any]
    order: tuple[tuple[str, str, int, bool], ...]
    """Session, condition, repeat, training."""
    conditions: tuple[Rated, ...]


class Answer(Struct):
    """Any other line; it may have other keys too."""

    trial: Annotated[int, Meta(ge=0)]
    rating: Annotated[float, Meta(ge=0, le=HIGHEST)]


@dataclass
class Answers:
    """What a file of answers holds."""

    head: dict[str, Any]
    lines: list[dict[str, Any]] = field(default_factory=list)
    torn: int = 0
    """Bytes after the last whole line."""
    path: str = ""

    @property
    def trials(self) -> list[Trial]:
        return [Trial(*each) for each in self.head["order"]]

    @property
    def ratings(self) -> dict[int, float]:
        """Number of a trial -> the last answer to it."""
        return {line["trial"]: line["rating"] for line in self.lines}

    @property
    def subject(self) -> str:
        return str(self.head["subject"])


def load_answers(path: str | Path) -> Answers:
    with open_regular(path, LARGEST) as stream:
        data = stream.read(LARGEST + 1)
    try:
        found = parse_answers(data)
    except ParameterError as error:
        error.at(path=str(path))
        raise
    if found is None:
        raise ParameterError("holds no answers, not even their first line", path=str(path))
    found.path = str(path)
    return found


def parse_answers(data: bytes) -> Answers | None:
    """None: not even the first line is whole."""
    if len(data) > LARGEST:
        raise ParameterError(f"more than {LARGEST} bytes are no answers")
    *whole, rest = data.split(b"\n")
    if not whole:
        return None
    head, heading = parsed(whole[0], 1, Heading)
    refuse_head(heading)
    answers = Answers(head, torn=len(rest))
    for number, text in enumerate(whole[1:], 2):
        line, answer = parsed(text, number, Answer)
        refuse_line(line, answer, number, head["order"])
        answers.lines.append(line)
    return answers


def parsed(text: bytes, number: int, kind: type[Made]) -> tuple[dict[str, Any], Made]:
    try:
        line = parse_json(text)
        return line, read(kind, line)
    except ParameterError as error:
        raise ParameterError(f"line {number}: {error.message}") from None


def refuse_head(head: Heading) -> None:
    names = {each.name for each in head.conditions}
    asked = [each[:3] for each in head.order if not each[3]]
    sessions, repeats = {each[0] for each in asked}, {each[2] for each in asked}
    wanted = set(product(sessions, names, repeats))
    known = names.issuperset(each[1] for each in head.order)
    told = all(each.bits_per_sample.keys() == sessions for each in head.conditions)
    if not told or not asked or len(asked) != len(wanted) or set(asked) != wanted or not known:
        raise ParameterError("line 1: the order is not every condition in every session")
    roles = [each.role for each in head.conditions]
    if len(names) != len(roles) or roles.count("reference") != 1:
        raise ParameterError("line 1: two conditions of one name, or not one reference")


def refuse_line(line: dict[str, Any], answer: Answer, number: int, order: list[list[Any]]) -> None:
    if answer.trial >= len(order):
        raise ParameterError(f"line {number}: there is no trial {answer.trial!r:.40}")
    if [line.get(name) for name in Trial._fields] != order[answer.trial]:
        raise ParameterError(f"line {number}: this is not what trial {answer.trial} asked")


class AnswerFile:
    """Open for more answers, by one program at a time."""

    def __init__(self, path: Path, head: dict[str, Any], tell: Callable[[str], None]) -> None:
        """New, or gone on with; refused where what is there belongs to something else."""
        self.path = path
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
        self.descriptor = os.open(path, flags, 0o666)
        try:
            refuse_special(self.descriptor, path, LARGEST)
            if lock(self.descriptor) is False:
                raise ParameterError("is being written by another program", path=str(path))
            data = b""
            while len(data) <= LARGEST and (more := os.read(self.descriptor, 1 << 20)):
                data += more
            try:
                found = parse_answers(data)
                if found is not None and found.lines:
                    refuse_others(found.head, head)
            except ParameterError as error:
                error.at(path=str(path))
                raise
            torn = len(data) if found is None else found.torn
            if torn:
                tell(f"{path}: the last line was torn ({torn} bytes) and is ignored")
            begun = found is not None and bool(found.lines)
            self.answers = found if found is not None and begun else Answers(head)
            # A first line without an answer binds nobody.
            self.size = len(data) - torn if begun else 0
            os.ftruncate(self.descriptor, self.size)
            if not begun:
                self.append(head)
                sync_directory(path.parent)
        except BaseException:
            os.close(self.descriptor)
            raise

    def __enter__(self) -> AnswerFile:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self.descriptor)

    def add(self, line: dict[str, Any]) -> None:
        """On the disk when this returns."""
        self.append(line)
        self.answers.lines.append(line)

    def append(self, line: dict[str, Any]) -> None:
        data = json.dumps(line, allow_nan=False).encode() + b"\n"
        os.lseek(self.descriptor, self.size, os.SEEK_SET)
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self.descriptor, rest) :]
            os.fsync(self.descriptor)
        except OSError as error:
            # Half a line on a full disk: what was there stays as it was.
            with suppress(OSError):
                os.ftruncate(self.descriptor, self.size)
            raise OSError(error.errno, error.strerror, str(self.path)) from error
        self.size += len(data)


def refuse_others(found: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Answers that were given to something else, or by somebody else, or felt in another way."""
    if found["subject"] != wanted["subject"]:
        raise ParameterError(
            f"holds the answers of {found['subject']!r}, not of {wanted['subject']!r}: one file "
            "for each subject"
        )
    before, now = (str(each["study"].get("sha256")) for each in (found, wanted))
    if before != now:
        raise ParameterError(
            f"its answers are to another study, or to this one before it was changed (SHA-256 "
            f"{before[:12]}..., now {now[:12]}...); give a new --answers"
        )
    if found["stimuli_sha256"] != wanted["stimuli_sha256"]:
        raise ParameterError(
            "its answers are to other files: a recording has changed, or the program that encoded "
            "them; give a new --answers"
        )
    if found["output"] != wanted["output"]:
        told = " and ".join(json.dumps(each["output"]) for each in (found, wanted))
        raise ParameterError(f"its answers were felt in another way than now: {told}")
