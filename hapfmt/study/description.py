"""A study file (TOML): what is felt, under which conditions, and what is asked. docs/studies.md
lists every key."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..errors import ParameterError
from ..scenes.keys import SceneError, check, choice, key, number, read_table, text, whole
from ..toml import parse_toml
from .files import open_regular

Role = Literal["test", "reference", "anchor"]
ROLES = ("test", "reference", "anchor")
PRESETS = (
    "lossless", "near-lossless", "perceptual", "paper",
    # Old names.
    "archive", "deadband", "auto", "default",
)  # fmt: skip
AMOUNTS = ("k", "floor", "step", "max_error")
"""Numbers, or text with a unit: 0.01, "2lsb", "0.2%"."""
CODING = ("preset", *AMOUNTS, "bits", "cutoff_hz", "interpolation")

SCALE = ("Bad", "Poor", "Fair", "Good", "Excellent")
"""Fifths of the scale, lowest first: 0 to 20, 20 to 40 ... (Rec. ITU-R BS.1534-3, 10/2015)."""
HIGHEST = 100
QUESTION = "How close does this feel to the reference?"

SCREEN_BELOW, SCREEN_SHARE = 90.0, 0.15
"""Who rates the hidden reference lower than 90 in more than 15 % of the items is left out by the
post-screening of Rec. ITU-R BS.1534-3."""

MOST_SESSIONS, MOST_CONDITIONS, MOST_REPEATS = 100, 100, 20
LARGEST = 1 << 20
"""Bytes of a study file."""


def amount(what: str) -> Any:
    def read(value: Any, at: str) -> Any:
        if value is None or (isinstance(value, str) and len(value) <= 40):
            return value
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return value
        raise SceneError(at, 'is not an amount; write 0.1, or text such as "2lsb" or "0.2%"')

    return key(what, read, None)


def bits(what: str) -> Any:
    def read(value: Any, at: str) -> Any:
        if value is None or (type(value) is int and value in (0, *range(2, 17))):
            return value
        raise SceneError(at, "is neither 0 nor a whole number from 2 to 16")

    return key(what, read, None)


def texts(what: str, default: Any, count: int | None = None) -> Any:
    """A tuple of different texts, ``count`` of them."""

    def read(value: Any, at: str) -> tuple[str, ...]:
        good = isinstance(value, (list, tuple)) and all(
            isinstance(each, str) and 0 < len(each) <= 80 for each in value
        )
        if not good or len(set(value)) != len(value) or len(value) > MOST_CONDITIONS:
            raise SceneError(at, "is not a list of different texts in brackets")
        if count is not None and len(value) != count:
            raise SceneError(at, f"has {len(value)} texts; write {count}, the lowest first")
        return tuple(value)

    return key(what, read, default)


def paths(what: str) -> Any:
    """Session -> file; empty where the condition is encoded."""

    def read(value: Any, at: str) -> tuple[tuple[str, str], ...]:
        pairs = value.items() if isinstance(value, dict) else value
        if not isinstance(pairs, (tuple, type({}.items()))) or not all(
            isinstance(file, str) and file for _, file in pairs
        ):
            raise SceneError(at, 'is not a table of files; write { session = "file.hapf" }')
        return tuple((str(name), file) for name, file in pairs)

    return key(what, read, ())


def seconds(what: str) -> Any:
    return number(what, None, high=1e6)


@dataclass(frozen=True)
class Head:
    name: str = text("what the study is called", most=80)
    question: str = text("what is asked", QUESTION, most=300)
    seed: int = whole("another number, other orders", 1, low=0, high=1 << 31)
    repeats: int = whole("how often each condition is rated", 1, low=1, high=MOST_REPEATS)
    scale: tuple[str, ...] = texts("words for the fifths of the scale, lowest first", SCALE, 5)
    training: tuple[str, ...] = texts("conditions that are tried first and do not count", ())
    screen_below: float = number("a hidden reference rated lower is a miss", SCREEN_BELOW,
                                 high=HIGHEST)  # fmt: skip
    screen_share: float = number("subjects with a larger share of misses are screened out",
                                 SCREEN_SHARE, high=1)  # fmt: skip

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class Session:
    """One recording, whose conditions are rated side by side."""

    name: str = text("what the session is called", most=80)
    recording: str = text("the file of its reference", "", most=4096)
    from_s: float | None = seconds("where it begins in the recording")
    to_s: float | None = seconds("where it ends")
    channel: str = text("the channel of a sound card's signal", "", most=200)

    def __post_init__(self) -> None:
        check(self)
        if self.from_s is not None and self.to_s is not None and self.from_s >= self.to_s:
            raise SceneError("to_s", "ends before it begins; write more than from_s")


@dataclass(frozen=True)
class Condition:
    """How the reference comes back: encoded with a preset, low-passed, or a file of its own."""

    name: str = text("what the condition is called", most=80)
    role: Role = choice("what it is for", ROLES, "test")
    preset: str | None = choice("as in hapfmt encode", PRESETS, None)
    k: Any = amount("Weber fraction of the deadband")
    floor: Any = amount("absolute floor of the deadband")
    bits: int | None = bits("bits of the residual, 0 or 2 to 16")
    step: Any = amount("step of the residual")
    max_error: Any = amount("largest error of a near-lossless channel")
    cutoff_hz: float | None = number("split between slow and fast", None, above=0, high=1e6)
    interpolation: str | None = choice("how knots are joined", ("linear", "hold"), None)
    low_pass_hz: float | None = number("what is faster is taken away", None, above=0, high=1e6)
    files: tuple[tuple[str, str], ...] = paths("a file for each session, encoded already")

    def __post_init__(self) -> None:
        check(self)
        coded = [name for name in (*CODING, "low_pass_hz") if getattr(self, name) is not None]
        if self.files and coded:
            raise SceneError(coded[0], "does not go with files, which are played as they are")
        if self.role == "reference" and (coded or self.files):
            raise SceneError((coded or ["files"])[0], "does not go with the reference itself")
        if self.role != "reference" and not (coded or self.files):
            raise SceneError("", "says nothing of how it is made; add preset, low_pass_hz or files")

    @property
    def coding(self) -> dict[str, Any]:
        """What departs from a lossless file, for Settings.of."""
        given = {name: getattr(self, name) for name in CODING}
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class Study:
    head: Head
    sessions: tuple[Session, ...]
    conditions: tuple[Condition, ...]
    digest: str
    """SHA-256 of the file, in hexadecimal digits."""
    path: Path

    @property
    def reference(self) -> Condition:
        return next(each for each in self.conditions if each.role == "reference")

    def condition(self, name: str) -> Condition:
        return next(each for each in self.conditions if each.name == name)

    def beside(self, name: str) -> Path:
        """A file that the study names; relative ones lie where the study does."""
        return self.path.parent / name

    def folder(self, what: str) -> Path:
        return self.path.with_name(f"{self.path.stem}-{what}")


def load_study(path: str | Path) -> Study:
    path = Path(path)
    with open_regular(path, LARGEST) as stream:
        data = stream.read(LARGEST + 1)
    try:
        return parse_study(data, path)
    except ParameterError as error:
        error.at(path=str(path))
        raise


def parse_study(data: bytes, path: Path) -> Study:
    if len(data) > LARGEST:
        raise ParameterError(f"a study file has at most {LARGEST} bytes")
    try:
        values = parse_toml(data.decode("utf-8"))
    except UnicodeDecodeError:
        raise ParameterError("not UTF-8, as TOML must be") from None
    tables = {name: values.pop(name, None) for name in ("session", "condition")}
    sessions = tuple(read_all(Session, tables["session"], "session", MOST_SESSIONS))
    conditions = tuple(read_all(Condition, tables["condition"], "condition", MOST_CONDITIONS))
    head = read_table(Head, values)
    study = Study(head, sessions, conditions, hashlib.sha256(data).hexdigest(), path)
    refuse_what_does_not_fit(study)
    return study


def read_all(table: Any, values: Any, name: str, most: int) -> list[Any]:
    if not isinstance(values, list) or not values:
        raise SceneError(name, f"is missing; write [[{name}]] and its keys below, for each one")
    if len(values) > most:
        raise SceneError(name, f"there are {len(values)}; at most {most} are taken")
    found = [read_table(table, each, f"{name}[{n}]") for n, each in enumerate(values)]
    names = [each.name for each in found]
    for n, each in enumerate(names):
        if not each.strip():
            raise SceneError(f"{name}[{n}].name", "is empty; write what it is called")
        if each in names[:n]:
            raise SceneError(f"{name}[{n}].name", f"{each!r} is there twice")
    return found


def refuse_what_does_not_fit(study: Study) -> None:
    references = [each.name for each in study.conditions if each.role == "reference"]
    if len(references) != 1:
        raise SceneError(
            "condition",
            f'{len(references)} have role = "reference"; give it to one, which is felt openly '
            "and, hidden, among the others",
        )
    if len(study.conditions) < 2:
        raise SceneError("condition", "there is nothing to compare the reference with; add some")
    known = [each.name for each in study.conditions]
    for n, name in enumerate(study.head.training):
        if name not in known:
            raise SceneError(f"training[{n}]", f"there is no condition {name!r}")
    for n, session in enumerate(study.sessions):
        if not session.recording:
            raise SceneError(f"session[{n}].recording", "is empty; write the file of its reference")
    names = {each.name for each in study.sessions}
    for n, each in enumerate(study.conditions):
        if each.files and (wrong := names ^ {name for name, _ in each.files}):
            raise SceneError(
                f"condition[{n}].files",
                f"names the sessions otherwise than the study: {', '.join(sorted(wrong))}",
            )


def fifth(rating: float, scale: tuple[str, ...] = SCALE) -> str:
    """The word for a rating."""
    return scale[min(int(rating * len(scale) / HIGHEST), len(scale) - 1)]
