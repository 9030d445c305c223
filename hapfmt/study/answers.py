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
from typing import Any

from ..atomic import sync_directory
from ..errors import ParameterError
from ..lock import lock
from .description import HIGHEST, ROLES
from .files import open_regular, refuse_special
from .order import Trial

VERSION = 1
LARGEST = 64 << 20
"""Bytes."""
LIMIT = 1e12
"""No number of a study is as large."""


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
    head = parsed(whole[0], 1)
    refuse_head(head)
    answers = Answers(head, torn=len(rest))
    for number, text in enumerate(whole[1:], 2):
        line = parsed(text, number)
        refuse_line(line, number, head["order"])
        answers.lines.append(line)
    return answers


def parsed(text: bytes, number: int) -> dict[str, Any]:
    try:
        line = json.loads(text)
    except (ValueError, RecursionError):
        line = None
    if not isinstance(line, dict):
        raise ParameterError(f"line {number} is not a JSON object")
    return line


def refuse_head(head: dict[str, Any]) -> None:
    if head.get("hapfmt_answers") != VERSION:
        raise ParameterError(f"line 1 does not begin answers of version {VERSION}")
    shapes: dict[str, type] = {
        "study": dict, "stimuli_sha256": str, "subject": str, "output": dict, "order": list,
        "conditions": list,
    }  # fmt: skip
    for name, kind in shapes.items():
        if not isinstance(head.get(name), kind):
            raise ParameterError(f"line 1 lacks {name!r}")
    types = [str, str, int, bool]
    if not all(
        isinstance(each, list) and [type(part) for part in each] == types for each in head["order"]
    ):
        raise ParameterError(
            "line 1: the order is a list of [session, condition, repeat, training]"
        )
    refuse_study(head["study"])
    for each in head["conditions"]:
        refuse_condition(each)
    names = {each["name"] for each in head["conditions"]}
    asked = [tuple(each[:3]) for each in head["order"] if not each[3]]
    sessions, repeats = ({each[place] for each in asked} for place in (0, 2))
    wanted = set(product(sessions, names, repeats))
    known = names.issuperset(each[1] for each in head["order"])
    told = all(set(each["bits_per_sample"]) == sessions for each in head["conditions"])
    if not told or not asked or len(asked) != len(wanted) or set(asked) != wanted or not known:
        raise ParameterError("line 1: the order is not every condition in every session")
    roles = [each["role"] for each in head["conditions"]]
    if len(names) != len(roles) or roles.count("reference") != 1:
        raise ParameterError("line 1: two conditions of one name, or not one reference")


def refuse_study(study: dict[str, Any]) -> None:
    scale = study.get("scale")
    texts = [study.get("name"), study.get("sha256"), *(scale if isinstance(scale, list) else [])]
    good = isinstance(scale, list) and scale and all(isinstance(each, str) for each in texts)
    if not good or not all(is_number(study.get(f"screen_{name}")) for name in ("below", "share")):
        raise ParameterError("line 1: its study lacks name, sha256, scale or screening")


def refuse_condition(condition: Any) -> None:
    if not isinstance(condition, dict):
        raise ParameterError("line 1: a condition is not a JSON object")
    by_session, bits = condition.get("bits_per_sample"), condition.get("bits")
    good = (
        isinstance(condition.get("name"), str)
        and condition.get("role") in ROLES
        and (bits is None or type(bits) is int)
        and (
            condition.get("k") is None
            or isinstance(condition["k"], str)
            or is_number(condition["k"])
        )
        and isinstance(by_session, dict)
        and all(is_number(each) for each in by_session.values())
    )
    if not good:
        raise ParameterError(f"line 1: condition {condition.get('name')!s:.40} is not understood")


def is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < LIMIT


def refuse_line(line: dict[str, Any], number: int, order: list[list[Any]]) -> None:
    trial, rating = line.get("trial"), line.get("rating")
    if not isinstance(trial, int) or isinstance(trial, bool) or not 0 <= trial < len(order):
        raise ParameterError(f"line {number}: there is no trial {trial!r:.40}")
    if not is_number(rating) or not 0 <= rating <= HIGHEST:  # type: ignore[operator]
        raise ParameterError(f"line {number}: {rating!r:.40} is not a rating from 0 to {HIGHEST}")
    if [line.get(name) for name in Trial._fields] != order[trial]:
        raise ParameterError(f"line {number}: this is not what trial {trial} asked")


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
