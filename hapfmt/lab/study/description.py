"""A study file (TOML): recordings, conditions and questions. docs/studies.md lists every key.

This file also writes a study file to edit: the paper's grid of k and bits, a hidden reference and
an anchor. Files that a study names must be regular and of bounded size, so that reading them ends.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BufferedReader
from pathlib import Path
from typing import Annotated, Any, Literal

from ...descriptions import (
    Description,
    DescriptionError,
    above,
    parse_toml,
    read,
    refuse_twice,
    what,
    within,
)
from ...errors import ParameterError
from ...structs import Meta

LARGEST_FILE = 1 << 32
"""Bytes of a recording. All of it is read into memory."""


def open_regular(path: str | Path, largest: int = LARGEST_FILE) -> BufferedReader:
    """Open for reading. A device, a pipe or a folder is refused; nothing waits for a pipe."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
    descriptor = os.open(path, flags | getattr(os, "O_BINARY", 0))
    try:
        refuse_special(descriptor, path, largest)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def refuse_special(descriptor: int, path: str | Path, largest: int) -> None:
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode):
        raise ParameterError("is not a regular file", path=str(path))
    if found.st_size > largest:
        raise ParameterError(
            f"has {found.st_size} bytes; at most {largest} are read", path=str(path)
        )


Role = Literal["test", "reference", "anchor"]
Preset = Literal[
    "lossless", "near-lossless", "perceptual", "paper",
    # Old names.
    "archive", "deadband", "auto", "default",
]  # fmt: skip
Interpolation = Literal["linear", "hold"]
Quality = Literal["low", "medium", "high"]
TextureCodec = Literal["LPCR", "MDCT"]
Bits = Literal[0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]
Amount = float | Annotated[str, Meta(max_length=40, examples=["2lsb", "0.2%"])]
"""A number, or text with a unit."""
CODING = (
    "preset", "k", "floor", "step", "max_error", "bits", "cutoff_hz", "interpolation",
    "quality", "snr", "st_sim", "bitrate", "texture_codec", "weighting",
    "synthetic_texture",
)  # fmt: skip
Word = Annotated[str, Meta(min_length=1, max_length=80)]
Scale = tuple[Word, Word, Word, Word, Word]

SCALE: Scale = ("Bad", "Poor", "Fair", "Good", "Excellent")
"""Fifths of the scale, lowest first: 0 to 20, 20 to 40 ... (Rec. ITU-R BS.1534-3, 10/2015)."""
HIGHEST = 100
QUESTION = "How close does this feel to the reference?"

SCREEN_BELOW, SCREEN_SHARE = 90.0, 0.15
"""Who rates the hidden reference lower than 90 in more than 15 % of the items is left out by the
post-screening of Rec. ITU-R BS.1534-3."""

Trained = Meta(max_length=100, description="conditions that are tried first and do not count")
LARGEST = 1 << 20
"""Bytes of a study file."""


def many(what: str) -> Meta:
    return Meta(min_length=1, max_length=100, description=what)


class StudySession(Description):
    """One recording, whose conditions are rated side by side."""

    name: Annotated[Word, what("what the session is called")]
    recording: Annotated[
        str, Meta(min_length=1, max_length=4096, description="the file of its reference")
    ]
    from_s: Annotated[float, within(0, 1e6, "where it begins in the recording")] | None = None
    to_s: Annotated[float, within(0, 1e6, "where it ends")] | None = None
    channel: Annotated[
        str, Meta(max_length=200, description="the channel of a sound card's signal")
    ] = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.from_s is not None and self.to_s is not None and self.from_s >= self.to_s:
            raise DescriptionError("to_s", "ends before it begins; write more than from_s")


class Condition(Description):
    """How the reference comes back: encoded with a preset, low-passed, or a file of its own."""

    name: Annotated[Word, what("what the condition is called")]
    role: Annotated[Role, what("what it is for")] = "test"
    preset: Annotated[Preset, what("as in hapfmt encode")] | None = None
    k: Annotated[Amount | None, what("Weber fraction of the deadband")] = None
    floor: Annotated[Amount | None, what("absolute floor of the deadband")] = None
    bits: Annotated[Bits, what("bits of the residual")] | None = None
    step: Annotated[Amount | None, what("step of the residual")] = None
    max_error: Annotated[Amount | None, what("largest error of a near-lossless channel")] = None
    cutoff_hz: Annotated[float, above(0, 1e6, "split between slow and fast")] | None = None
    interpolation: Annotated[Interpolation, what("how knots are joined")] | None = None
    quality: Annotated[Quality, what("quality of the texture")] | None = None
    snr: Annotated[float, above(0, 1000, "signal-to-noise ratio of the texture in dB")] | None = (
        None
    )
    st_sim: Annotated[float, above(0, 1, "similarity ST-SIM of the texture")] | None = None
    bitrate: Annotated[float, above(0, 1e6, "kbit/s of the file")] | None = None
    texture_codec: Annotated[TextureCodec, what("the only codec of textures")] | None = None
    weighting: Annotated[float, within(0, 1, "power of the threshold of vibration")] | None = None
    synthetic_texture: (
        Annotated[Literal[True], what("a model of the texture, not its samples")] | None
    ) = None
    low_pass_hz: Annotated[float, above(0, 1e6, "what is faster is taken away")] | None = None
    files: Annotated[
        dict[str, Annotated[str, Meta(min_length=1)]],
        what("a file for each session, encoded already"),
    ] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        coded = [name for name in (*CODING, "low_pass_hz") if getattr(self, name) is not None]
        if self.files and coded:
            raise DescriptionError(coded[0], "does not go with files, which are played as they are")
        if self.role == "reference" and (coded or self.files):
            raise DescriptionError((coded or ["files"])[0], "does not go with the reference itself")
        if self.role != "reference" and not (coded or self.files):
            raise DescriptionError(
                "", "says nothing of how it is made; add preset, low_pass_hz or files"
            )

    @property
    def coding(self) -> dict[str, Any]:
        """What departs from a lossless file, for Settings.of."""
        given = {name: getattr(self, name) for name in CODING}
        return {name: value for name, value in given.items() if value is not None}


class StudyKeys(Description, kw_only=True):
    """The keys of a study."""

    name: Annotated[str, Meta(max_length=80, description="what the study is called")] = ""
    question: Annotated[str, Meta(max_length=300, description="what is asked")] = QUESTION
    seed: Annotated[int, within(0, 1 << 31, "another number, other orders")] = 1
    repeats: Annotated[int, within(1, 20, "how often each condition is rated")] = 1
    scale: Annotated[Scale, what("words for the fifths of the scale, lowest first")] = SCALE
    training: Annotated[tuple[Word, ...], Trained] = ()
    screen_below: Annotated[
        float, within(0, HIGHEST, "a hidden reference rated lower is a miss")
    ] = SCREEN_BELOW
    screen_share: Annotated[
        float, within(0, 1, "subjects with a larger share of misses are screened out")
    ] = SCREEN_SHARE
    session: Annotated[tuple[StudySession, ...], many("[[session]] and its keys for each one")]
    condition: Annotated[tuple[Condition, ...], many("[[condition]] and its keys for each one")]

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_twice("scale", self.scale)
        refuse_twice("training", self.training)
        refuse_names("session", self.session)
        known = refuse_names("condition", self.condition)
        references = [each.name for each in self.condition if each.role == "reference"]
        if len(references) != 1:
            raise DescriptionError(
                "condition",
                f'{len(references)} have role = "reference"; give it to one, which is felt openly '
                "and, hidden, among the others",
            )
        if len(known) < 2:
            raise DescriptionError(
                "condition", "there is nothing to compare the reference with; add some"
            )
        for n, name in enumerate(self.training):
            if name not in known:
                raise DescriptionError(f"training[{n}]", f"there is no condition {name!r}")
        sessions = {each.name for each in self.session}
        for n, each in enumerate(self.condition):
            if each.files and (wrong := sessions ^ each.files.keys()):
                raise DescriptionError(
                    f"condition[{n}].files",
                    f"names the sessions otherwise than the study: {', '.join(sorted(wrong))}",
                )


@dataclass(frozen=True)
class Study:
    head: StudyKeys
    digest: str
    """SHA-256 of the file, in hexadecimal digits."""
    path: Path

    @property
    def sessions(self) -> tuple[StudySession, ...]:
        return self.head.session

    @property
    def conditions(self) -> tuple[Condition, ...]:
        return self.head.condition

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
    return Study(read(StudyKeys, values), hashlib.sha256(data).hexdigest(), path)


def refuse_names(table: str, given: tuple[StudySession | Condition, ...]) -> list[str]:
    """The names, where no two are alike and none is empty."""
    names = [each.name for each in given]
    for n, name in enumerate(names):
        if not name.strip() or name in names[:n]:
            why = "is there twice; give each its own" if name.strip() else "is empty"
            raise DescriptionError(f"{table}[{n}].name", f"{name!r} {why}")
    return names


def fifth(rating: float, scale: tuple[str, ...] = SCALE) -> str:
    """The word for a rating."""
    return scale[min(int(rating * len(scale) / HIGHEST), len(scale) - 1)]


WEBER = (0.05, 0.1, 0.2)
BITS = (2, 5, 8)
"""Bits of the residual, as in the paper's Fig. 4; 0 is the anchor."""

HEAD = """\
# A study: how near do these come to the reference? Edit it before the first answer; every key is
# explained in docs/studies.md. hapfmt study {file} --prepare makes the files and shows their sizes.
name = {name}
question = "How close does this feel to the reference?"
seed = 1
repeats = 1
scale = ["Bad", "Poor", "Fair", "Good", "Excellent"]  # fifths of 0 to 100, lowest first
training = ["reference", {trained}, "anchor"]  # tried first; these ratings do not count
screen_below = 90   # who rates the hidden reference lower than this ...
screen_share = 0.15 # ... in more than this share of the sessions is reported apart
"""
CODED = """
[[condition]]
name = {name}
preset = "paper"
k = {k}
bits = {bits}
"""
REFERENCE = """
[[condition]]
name = "reference"
role = "reference"
"""
ANCHOR = """
[[condition]]
name = "anchor"       # the slow part alone: without texture
role = "anchor"
preset = "paper"
k = 0.1
bits = 0
"""


def quoted(text: str) -> str:
    """A basic string of TOML: that of JSON, whose DEL alone TOML does not take."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def new_study(path: Path, recordings: Sequence[str]) -> str:
    """The text of a study of these recordings, to lie at ``path``."""
    if not recordings:
        raise ParameterError("give the recordings that are to be felt, one for each session")
    names: list[str] = []
    parts = []
    for each in recordings:
        file = Path(each)
        if not file.is_file():
            raise ParameterError("there is no such file", path=each)
        name = unused(file.stem, names)
        names.append(name)
        if any("\ud800" <= c <= "\udfff" for c in each):
            raise ParameterError("a name in a study must be a text", path=ascii(each))
        place = os.path.relpath(file, path.parent or ".")
        parts.append(
            f"\n[[session]]\nname = {quoted(name)}\nrecording = {quoted(Path(place).as_posix())}\n"
        )
    coded = [(coded_name(k, bits), k, bits) for bits in BITS for k in WEBER]
    head = HEAD.format(file=path.name, name=quoted(path.stem), trained=quoted(coded[0][0]))
    conditions = [CODED.format(name=quoted(name), k=k, bits=bits) for name, k, bits in coded]
    return "".join([head, *parts, REFERENCE, *conditions, ANCHOR])


def coded_name(k: float, bits: int) -> str:
    return f"k {100 * k:g} %, {bits} bits"


def unused(stem: str, names: Sequence[str]) -> str:
    base = stem[:70].strip() or "session"
    name, number = base, 1
    while name in names:
        number += 1
        name = f"{base} {number}"
    return name
