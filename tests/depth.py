"""How much of a law a run tests. The profile (HYPOTHESIS_PROFILE, tests/conftest.py) decides.

Every law has a few cases in any profile. The mark ``deep`` is for more of them, and for tests that
take seconds: these run in the profiles ``ci`` and ``nightly``.
"""

from __future__ import annotations

import os
import random
from collections.abc import Iterable
from fnmatch import fnmatch
from typing import Any

import pytest

PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "dev")
DEEP = PROFILE in ("ci", "nightly")

PURE = (
    # Codecs, and the readable twins of loops.
    "clamps", "codecs_*", "components", "entropy", "huffman", "integers", "kernels*", "lengths",
    "references", "split",
    # The conformance suite, and other bytes that a decoder gets.
    "examples", "exhaustive", "fuzz", "hostile", "vectors*",
    # Each way of encoding once; the verbs of README.md.
    "encoder", "pages", "packaging", "threads",
)  # fmt: skip
"""Modules of tests that also run without the extension, in any profile: their results come from
loops that it replaces. The others run there in the deep profiles alone."""


def runs_pure(name: str) -> bool:
    """Of a file or folder in tests/."""
    word = name.removeprefix("test_").removesuffix(".py")
    return word == name.removesuffix(".py") or any(fnmatch(word, pattern) for pattern in PURE)


def examples(count: int) -> int:
    """Of a property that needs another number than the profile has: a quarter where it is quick."""
    return count if DEEP else max(count // 4, 3)


def deep(values: Iterable[Any]) -> list[Any]:
    """Parameters for where there is time."""
    return [pytest.param(value, marks=pytest.mark.deep) for value in values]


def either(name: str, quick: Any, deep: Any, nightly: Any = None) -> pytest.MarkDecorator:
    """A parameter with one value in any profile, and another where there is time, or a whole night."""
    more = deep if nightly is None or PROFILE != "nightly" else nightly
    return pytest.mark.parametrize(name, [quick, pytest.param(more, marks=pytest.mark.deep)])


def sample(cases: Iterable[Any], share: int = 10, always: Iterable[Any] = ()) -> list[Any]:
    """Parameters of which a random part (the same in each run), and some by name, run always; the
    others are deep: every third in the profile ``ci``, all in ``nightly``. A case may be a parameter
    with an id."""
    cases = [case if isinstance(case, tuple) else (case,) for case in cases]
    always = set(always)
    few = set(random.Random(1).sample(range(len(cases)), -(-len(cases) // share)))
    found = []
    for place, case in enumerate(cases):
        param = case if hasattr(case, "marks") else pytest.param(*case)
        named = {param.id, *(value for value in param.values if isinstance(value, str))}
        marks = () if place in few or named & always else (pytest.mark.deep,)
        if marks and PROFILE == "ci" and place % 3:
            continue
        found.append(pytest.param(*param.values, id=param.id, marks=(*param.marks, *marks)))
    return found
