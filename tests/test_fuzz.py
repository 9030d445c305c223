"""The corpus of the fuzzer, and what it found, through every target again."""

from __future__ import annotations

import hashlib

import pytest
from depth import either
from fuzzing import TARGETS
from fuzzing.mend import SYNC, mend_cluster, mend_file
from spec import ROOT

pytestmark = pytest.mark.capped

CORPUS = ROOT / "tests" / "corpus"
SIZE_LIMIT = 200 << 10
"""Bytes of the corpus."""

FOUND = {
    "stream-tick-of-5000-digits": ("stream", "a tick of so many digits ended in a ValueError"),
    "recovered-unknown-kind-has-a-channel": (
        "recovered",
        "the number of a track of unknown kind was given to an empty one too",
    ),
    "recovered-continues-another-channel": (
        "recovered",
        "a track that continues one of another channel number was kept",
    ),
    "recovered-level-told-late": (
        "recovered",
        "a description before HEAD was held to the limits of level 2 only",
    ),
    "recovered-order-broken-before-the-first-damage": (
        "recovered",
        "a reader left out chunks in a wrong order, if the damage came later, and recover did not",
    ),
    "edited-base-of-what-is-not-understood": (
        "edited",
        "a track of unknown kind with a base that is not there ended in a KeyError",
    ),
    "edited-codec-beyond-ascii": ("edited", "letters of a codec beyond ASCII were not encoded"),
    "index-type-not-ascii": ("index", "an entry whose type was no letters was taken"),
}
"""Inputs that broke something, in corpus/found: the target, and what was wrong."""


@either("every", 3, deep=1)
@pytest.mark.parametrize("name", TARGETS)
def test_corpus(name, every):
    """
    LIM-002: A reader MUST check every limit before it takes memory for what the number promises.
    """
    target = TARGETS[name]
    inputs = [*sorted((CORPUS / name).iterdir())]
    assert inputs
    for path in inputs[::every]:
        target.run(path.read_bytes())
    for seed in target.seeds():
        assert len(seed) <= target.size
        target.run(seed)


@pytest.mark.parametrize("name", FOUND)
def test_what_was_found(name):
    TARGETS[FOUND[name][0]].run((CORPUS / "found" / name).read_bytes())


def test_names_are_digests():
    for path in CORPUS.glob("*/*"):
        if path.parent.name != "found":
            assert path.name == hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def test_nothing_is_left_over():
    folders = {path.name for path in CORPUS.iterdir()}
    assert folders == TARGETS.keys() | {"found"}
    assert {path.name for path in (CORPUS / "found").iterdir()} == FOUND.keys()
    assert sum(path.stat().st_size for path in CORPUS.glob("*/*")) <= SIZE_LIMIT


def test_mending_leaves_what_is_right():
    """Else the fuzzer would never see a file as a writer makes it."""
    for seed in list(TARGETS["file"].seeds())[2:]:
        assert mend_file(seed) == seed
    for seed in TARGETS["cluster"].seeds():
        assert mend_cluster(seed) == seed


def test_mending_mends(residual_file):
    """A changed packet has a right CRC again, and all around it."""
    at = residual_file.index(SYNC, residual_file.index(b"DATA")) - 1
    data = bytearray(residual_file)
    data[at] ^= 1
    mended = mend_file(bytes(data))
    assert len(mended) == len(data)
    assert mend_file(mended) == mended
    assert mended != residual_file
