"""The trials of one subject: their order, the questions, and the answer file.

The order is random but reproducible, in every version of Python: trials are sorted by a digest of
their names. The questions do not depend on the user interface.

The answer file holds JSON lines. Each line is on the disk before the next question is asked. The
first line gives the subject, the study, the output and the order. Each other line is one answer; a
later answer to the same question replaces the earlier one. A line without its newline was torn by a
crash: it is reported and ignored.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import product
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from ...descriptions import parse_json, read
from ...errors import ParameterError
from ...files import lock, sync_directory
from ...structs import Meta, Struct
from ...version import __version__
from .description import HIGHEST, Role, Study, open_regular, refuse_special
from .outputs import StudyOutput
from .prepare import Prepared

SUBJECT = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


class Trial(NamedTuple):
    """One question: a condition compared with the reference of its session."""

    session: str
    condition: str
    repeat: int = 0
    training: bool = False


def order(study: Study, subject: str) -> list[Trial]:
    """Training first; then session after session, in each of them repeat after repeat."""
    refuse_subject(subject)

    def drawn(*what: object) -> bytes:
        words = (study.head.seed, subject, *what)
        return hashlib.sha256("\0".join(map(str, words)).encode()).digest()

    sessions = sorted((each.name for each in study.sessions), key=drawn)
    found = [
        Trial(sessions[0], name, training=True)
        for name in sorted(study.head.training, key=lambda name: drawn("training", name))
    ]
    for session in sessions:
        for repeat in range(study.head.repeats):
            names = (each.name for each in study.conditions)
            found += [
                Trial(session, name, repeat)
                for name in sorted(names, key=lambda name: drawn(session, repeat, name))
            ]
    return found


def refuse_subject(subject: str) -> None:
    if not SUBJECT.fullmatch(subject):
        raise ParameterError(
            f"{subject[:80]!r} cannot be a subject: letters without accents, digits, '.', '_' and "
            "'-', at most 64 (a code such as S07; no names, which answers should not hold)"
        )


Made = TypeVar("Made")
VERSION = 1
LARGEST = 64 << 20
"""Bytes."""
Number = Annotated[float, Meta(ge=-1e12, le=1e12)]
"""No number of a study is larger."""


class Judged(Struct, open=True):
    """What the first line says of the study."""

    name: str
    sha256: str
    scale: Annotated[tuple[str, ...], Meta(min_length=1)]
    screen_below: Number
    screen_share: Number


class Rated(Struct, open=True):
    """What the first line says of a condition."""

    name: str
    role: Role
    bits_per_sample: dict[str, Number]
    bits: int | None = None
    k: Number | str | None = None


class AnswersHeading(Struct, open=True):
    """The first line; it may have other keys too."""

    hapfmt_answers: Literal[1]
    study: Judged
    stimuli_sha256: str
    subject: str
    output: dict[str, Any]
    order: tuple[tuple[str, str, int, bool], ...]
    """Session, condition, repeat, training."""
    conditions: tuple[Rated, ...]


class Answer(Struct, open=True):
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
    head, heading = parsed(whole[0], 1, AnswersHeading)
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


def refuse_head(head: AnswersHeading) -> None:
    names = {each.name for each in head.conditions}
    asked = [each[:3] for each in head.order if not each[3]]
    sessions, repeats = {each[0] for each in asked}, {each[2] for each in asked}
    wanted = set(product(sessions, names, repeats))
    known = names.issuperset(each[1] for each in head.order)
    sized = all(each.bits_per_sample.keys() == sessions for each in head.conditions)
    if not sized or not asked or len(asked) != len(wanted) or set(asked) != wanted or not known:
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
        """Creates or resumes the file; refuses a file of another subject, study or output."""
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
            # A file that holds no answer yet may belong to any study.
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
            # The disk may be full: remove the partial line and keep the rest.
            with suppress(OSError):
                os.ftruncate(self.descriptor, self.size)
            raise OSError(error.errno, error.strerror, str(self.path)) from error
        self.size += len(data)


def refuse_others(found: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Refuses answers to another study, of another subject, or through another output."""
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
        ways = " and ".join(json.dumps(each["output"]) for each in (found, wanted))
        raise ParameterError(f"its answers were felt in another way than now: {ways}")


class NotYetError(ParameterError):
    """What the subject asked for cannot be done now; nothing has changed."""


def heading(
    study: Study, prepared: Prepared, subject: str, output: dict[str, Any]
) -> dict[str, Any]:
    """The first line of a file of answers: enough to make a summary of it alone."""
    head = study.head
    return {
        "hapfmt_answers": VERSION,
        "study": {
            "name": head.name,
            "sha256": study.digest,
            "question": head.question,
            "scale": list(head.scale),
            "screen_below": head.screen_below,
            "screen_share": head.screen_share,
        },
        "conditions": [
            {
                "name": each.name,
                "role": each.role,
                **each.coding,
                "bits_per_sample": prepared.bits_per_sample(each.name),
            }
            for each in study.conditions
        ],
        "stimuli_sha256": prepared.digest,
        "subject": subject,
        "output": output,
        "order": [list(each) for each in order(study, subject)],
        "hapfmt": __version__,
        "at": now(),
    }


def now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


class Rating:
    """Asks trial after trial; ``file`` keeps the answers, ``output`` is where it is felt."""

    def __init__(
        self,
        study: Study,
        prepared: Prepared,
        file: AnswerFile,
        output: StudyOutput,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.study, self.prepared, self.file, self.output = study, prepared, file, output
        self.clock = clock
        self.trials = file.answers.trials
        self.number = 0
        self.last = ""
        self.begin(self.first_open())

    @property
    def trial(self) -> Trial | None:
        """The question; None: all are answered."""
        return self.trials[self.number] if self.number < len(self.trials) else None

    @property
    def done(self) -> int:
        return len(self.file.answers.ratings)

    def first_open(self) -> int:
        rated = self.file.answers.ratings
        return next((n for n in range(len(self.trials)) if n not in rated), len(self.trials))

    def begin(self, number: int) -> None:
        self.number = number
        self.plays = {"this": 0, "reference": 0}
        self.skipped = 0
        self.began = self.clock()
        self.last = "this"

    def play(self, which: str) -> str:
        """This one or the reference; what kept it from being felt whole, or nothing."""
        assert self.trial is not None
        name = self.trial.condition if which == "this" else self.study.reference.name
        label = "reference" if which == "reference" else f"trial {self.number + 1}"
        felt = self.output.play(self.prepared.file(self.trial.session, name), label)
        self.last = which
        self.skipped += felt.skipped
        if not felt.fault:
            self.plays[which] += 1
        return felt.fault

    def again(self) -> str:
        return self.play(self.last)

    def rate(self, rating: float) -> None:
        """Kept, and on to the next."""
        assert self.trial is not None
        if not (isfinite(rating) and 0 <= rating <= HIGHEST):
            raise NotYetError(f"a rating lies between 0 and {HIGHEST}")
        if not self.plays["this"]:
            raise NotYetError("play this one first")
        self.file.add(
            {
                "trial": self.number,
                **self.trial._asdict(),
                "rating": rating,
                "plays": dict(self.plays),
                "skipped_frames": self.skipped,
                "answer_s": round(self.clock() - self.began, 3),
                "at": now(),
            }
        )
        self.begin(self.first_open())

    def back(self) -> None:
        """Asks the previous question of the same session again."""
        if self.number == 0 or self.trial is None:
            raise NotYetError("there is no question before this one")
        before = self.trials[self.number - 1]
        if (before.session, before.training) != (self.trial.session, self.trial.training):
            raise NotYetError("the previous condition belongs to another session")
        self.begin(self.number - 1)

    @property
    def place(self) -> tuple[int, int, int, int]:
        """Session, sessions, question of the session, its questions; from 1. Training is apart."""
        assert self.trial is not None
        session, training = self.trial.session, self.trial.training
        parts = list(dict.fromkeys(each.session for each in self.trials if not each.training))
        mine = [
            n
            for n, each in enumerate(self.trials)
            if (each.session, each.training) == (session, training)
        ]
        return parts.index(session) + 1, len(parts), mine.index(self.number) + 1, len(mine)
