"""The questions of one subject, whatever asks them: the place, what may be done, what is kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime
from math import isfinite
from typing import Any

from ...errors import ParameterError
from ...version import __version__
from .answers import VERSION, AnswerFile
from .description import HIGHEST, Study
from .order import Trial, order
from .outputs import Output
from .prepare import Prepared


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
        output: Output,
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
        """The question before this one, of the same session, once more."""
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
