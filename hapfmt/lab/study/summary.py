"""Results of a study: means with 95 % confidence intervals. They are given with and without the
subjects who did not find the hidden reference.

The unit of analysis is the subject, because the ratings of one person are not independent. Each
subject's ratings of a condition are averaged first. The interval of the mean of these averages uses
Student's t with (subjects - 1) degrees of freedom. With few subjects a percentile bootstrap gives
narrower but worse intervals, since it cannot reach beyond the observed ratings. docs/studies.md has
numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin, sqrt, tan
from typing import Any, NamedTuple

import numpy as np

from ...errors import ParameterError
from .rating import Answers, Trial

LEVEL = 0.95


class Mean(NamedTuple):
    """Mean of n numbers; the interval is None for a single number."""

    n: int
    mean: float
    sd: float | None
    low: float | None
    high: float | None

    @property
    def half(self) -> float | None:
        return None if self.high is None else self.high - self.mean


def mean_of(values: Sequence[float], level: float = LEVEL) -> Mean:
    """Mean, standard deviation (n - 1), and the interval t * sd / sqrt(n) to both sides."""
    n, mean = len(values), float(np.mean(values))
    if n < 2:
        return Mean(n, mean, None, None, None)
    sd = float(np.std(values, ddof=1))
    half = student(n - 1, level) * sd / sqrt(n)
    return Mean(n, mean, sd, mean - half, mean + half)


def student(freedom: int, level: float) -> float:
    """The t that a share of ``level`` lies within, to both sides, at ``freedom`` degrees of
    freedom. M. Abramowitz, I. A. Stegun, Handbook of Mathematical Functions, 1964, 26.7.3 and
    26.7.4 give the share in terms of the angle of tangent t / sqrt(freedom)."""

    def share(angle: float) -> float:
        odd = freedom % 2
        term = total = (cos(angle) if odd else 1.0) if freedom > 1 else 0.0
        for n in range(2 + odd, freedom, 2):
            term *= (n - 1) / n * cos(angle) ** 2
            total += term
        total *= sin(angle)
        return (angle + total) * 2 / pi if odd else total

    low, high = 0.0, pi / 2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if share(middle) < level else (low, middle)
    return sqrt(freedom) * tan((low + high) / 2)


class Subject(NamedTuple):
    name: str
    ratings: dict[tuple[str, str], float]
    """(session, condition) -> the mean over its repeats."""
    open: int
    """Questions without an answer."""
    misses: int
    """Hidden references that were rated too low."""
    items: int
    """Hidden references that were rated."""
    output: str

    def of(self, condition: str, session: str | None) -> float:
        """The mean over the sessions, or in one."""
        found = [
            rating
            for (where, what), rating in self.ratings.items()
            if what == condition and session in (None, where)
        ]
        return float(np.mean(found))


class SummaryRow(NamedTuple):
    """A condition, in one session or (None) over all."""

    condition: str
    role: str
    session: str | None
    rating: Mean
    difference: Mean
    """To the hidden reference, subject by subject."""
    k: Any
    bits: int | None
    bits_per_sample: float | None


class StudySummary(NamedTuple):
    study: dict[str, Any]
    subjects: tuple[Subject, ...]
    """All who answered every question."""
    unfinished: tuple[Subject, ...]
    screened_out: tuple[str, ...]
    rows: tuple[SummaryRow, ...]
    """Rows over all subjects."""
    kept: tuple[SummaryRow, ...]
    """Rows over the subjects who were not screened out; empty if all were."""
    sessions: tuple[str, ...]
    notes: tuple[str, ...]


def summarise(answers: Sequence[Answers]) -> StudySummary:
    """Summary of the answers of one study; each element has the answers of one subject."""
    if not answers:
        raise ParameterError("a summary needs answers")
    first = answers[0]
    for each in answers[1:]:
        refuse_mixed(first, each)
    names = [each.subject for each in answers]
    for n, name in enumerate(names):
        if name in names[:n]:
            raise ParameterError(f"two files hold answers of {name!r}", path=answers[n].path)
    study, conditions = first.head["study"], first.head["conditions"]
    found = [subject_of(each) for each in answers]
    subjects = [each for each in found if not each.open]
    unfinished = [each for each in found if each.open]
    if not subjects:
        left = ", ".join(f"{each.name} has {each.open} left" for each in unfinished)
        raise ParameterError(f"no subject has answered every question: {left}")
    share = float(study.get("screen_share", 1))
    out = [each.name for each in subjects if each.misses > share * each.items]
    sessions = sorted({trial.session for trial in first.trials if not trial.training})
    keep = [each for each in subjects if each.name not in out]
    return StudySummary(
        study,
        tuple(subjects),
        tuple(unfinished),
        tuple(out),
        rows_of(subjects, conditions, sessions),
        rows_of(keep, conditions, sessions) if keep else (),
        tuple(sessions),
        tuple(notes_on(answers, found)),
    )


def refuse_mixed(first: Answers, other: Answers) -> None:
    same = first.head["study"] == other.head["study"] and (
        first.head["conditions"] == other.head["conditions"]
        and first.head["stimuli_sha256"] == other.head["stimuli_sha256"]
        and untrained(first) == untrained(other)
    )
    if not same:
        studies = [
            f"{a.head['study'].get('name', '')!r} ({str(a.head['study'].get('sha256'))[:12]}..., "
            f"files {a.head['stimuli_sha256'][:12]}...)"
            for a in (first, other)
        ]
        raise ParameterError(
            f"answers to {studies[1]} cannot be put together with {first.path}, to {studies[0]}",
            path=other.path,
        )


def untrained(answers: Answers) -> list[Trial]:
    """Trials in sorted order, without training, which depends on the first session."""
    return sorted(trial for trial in answers.trials if not trial.training)


def subject_of(answers: Answers) -> Subject:
    rated = answers.ratings
    references = {c["name"] for c in answers.head["conditions"] if c.get("role") == "reference"}
    below = float(answers.head["study"].get("screen_below", 0))
    cells: dict[tuple[str, str], list[float]] = {}
    missing = misses = items = 0
    for number, trial in enumerate(answers.trials):
        if trial.training:
            continue
        if number not in rated:
            missing += 1
            continue
        cells.setdefault((trial.session, trial.condition), []).append(rated[number])
        if trial.condition in references:
            items += 1
            misses += rated[number] < below
    means = {cell: float(np.mean(ratings)) for cell, ratings in cells.items()}
    output = answers.head["output"]
    words = " ".join(f"{name} {value}" for name, value in output.items() if value is not None)
    return Subject(answers.subject, means, missing, misses, items, words)


def rows_of(
    subjects: Sequence[Subject], conditions: Sequence[dict[str, Any]], sessions: Sequence[str]
) -> tuple[SummaryRow, ...]:
    """All sessions together first, then each by itself."""
    reference = next(each["name"] for each in conditions if each["role"] == "reference")
    rows = []
    for session in (None, *(sessions if len(sessions) > 1 else ())):
        for each in conditions:
            ratings = [subject.of(each["name"], session) for subject in subjects]
            base = [subject.of(reference, session) for subject in subjects]
            rows.append(
                SummaryRow(
                    each["name"],
                    str(each.get("role", "test")),
                    session,
                    mean_of(ratings),
                    mean_of([a - b for a, b in zip(ratings, base, strict=True)]),
                    each.get("k"),
                    each.get("bits"),
                    spent(each, session),
                )
            )
    return tuple(rows)


def spent(condition: dict[str, Any], session: str | None) -> float | None:
    """Bits a sample; the mean over the sessions, or in one."""
    by_session = condition.get("bits_per_sample")
    if not isinstance(by_session, dict) or not by_session:
        return None
    return float(np.mean([x for name, x in by_session.items() if session in (None, name)]))


def notes_on(answers: Sequence[Answers], subjects: Sequence[Subject]) -> list[str]:
    notes = [
        f"{each.path}: the last line was torn ({each.torn} bytes) and is ignored"
        for each in answers
        if each.torn
    ]
    dry = [each.subject for each in answers if each.head["output"].get("kind") == "dry-run"]
    if dry:
        notes.append(f"nothing was felt by {', '.join(dry)}: a dry run")
    outputs = sorted({each.output for each in subjects})
    if len(outputs) > 1:
        notes.append(f"it was not felt in one way by all: {'; '.join(outputs)}")
    return notes


def summary_json(summary: StudySummary) -> dict[str, Any]:
    return {
        "study": summary.study,
        "level": LEVEL,
        "subjects": [
            {
                "subject": each.name,
                "output": each.output,
                "open": each.open,
                "hidden_references_missed": each.misses,
                "hidden_references": each.items,
                "screened_out": each.name in summary.screened_out,
                "ratings": [
                    {"session": session, "condition": condition, "rating": rating}
                    for (session, condition), rating in sorted(each.ratings.items())
                ],
            }
            for each in (*summary.subjects, *summary.unfinished)
        ],
        "all": [row_json(row) for row in summary.rows],
        "screened": [row_json(row) for row in summary.kept],
        "notes": list(summary.notes),
    }


def row_json(row: SummaryRow) -> dict[str, Any]:
    return {
        **row._asdict(),
        "rating": row.rating._asdict(),
        "difference": row.difference._asdict(),
    }


HEADERS = (
    "subjects", "session", "condition", "role", "k", "bits", "bits_per_sample", "n", "mean", "sd",
    "low", "high", "difference", "difference_low", "difference_high",
)  # fmt: skip


def table_rows(summary: StudySummary) -> list[list[Any]]:
    """For CSV, as HEADERS says: of all subjects, then without those screened out."""
    parts = (("all", summary.rows), ("screened", summary.kept))
    return [
        [
            who, row.session or "all", row.condition, row.role, row.k, row.bits,
            row.bits_per_sample, *row.rating, row.difference.mean, row.difference.low,
            row.difference.high,
        ]
        for who, rows in parts
        for row in rows
    ]  # fmt: skip
