"""A study file to edit: the paper's grid of k and bits, the hidden reference, an anchor."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from ...errors import ParameterError

WEBER = (0.05, 0.1, 0.2)
BITS = (2, 5, 8)
"""Of the residual, as in the paper's Fig. 4; 0 is the anchor."""

HEAD = """\
# A study: how near do these come to the reference? Edit it before the first answer; every key is
# explained in docs/studies.md. hapfmt rate {file} --prepare makes the files and shows their sizes.
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
