"""The caller's own bounds, from a size of memory."""

from __future__ import annotations

import forge as f
import pytest
from hypothesis import given
from hypothesis import strategies as st
from terminal import called

from hapfmt import Limits, Reader
from hapfmt.errors import LimitError, ParameterError
from hapfmt.limits import ROOM_FOR, parse_size


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("1", 1),
        (7, 7),
        ("500000", 500_000),
        ("256M", 256 << 20),
        (" 2 GiB ", 2 << 30),
        ("3kb", 3072),
    ],
)
def test_sizes(text, size):
    assert parse_size(text) == size
    assert Limits.of_memory(text).memory == size


@pytest.mark.parametrize("text", ["", "0", "-1", "1.5G", "M", "1e9", "5 PB", "9" * 20, "\u0661M"])
def test_no_sizes(text):
    with pytest.raises(ParameterError, match="not a size"):
        Limits.of_memory(text)


@given(st.integers(1, 1 << 40), st.integers(1, 1 << 40))
def test_more_memory_is_never_less_room(a, b):
    small, large = (Limits(memory=size) for size in sorted((a, b)))
    for name in ROOM_FOR:
        assert 1 <= getattr(small, name) <= getattr(large, name) <= getattr(Limits(), name)


def test_a_bound_of_ones_own_stays():
    assert Limits(memory=1 << 30, samples=5).samples == 5
    assert Limits(memory=1 << 12, samples=1 << 20).samples == (1 << 12) // ROOM_FOR["samples"]


def test_what_to_raise_is_said():
    """
    LIM-003: A reader MAY have lower limits of its own, and MUST then report *unsupported*, not damage.
    """
    data = f.minimal()
    with pytest.raises(LimitError, match=r"raise Limits\(samples=...\)"):
        Reader(data, limits=Limits(samples=3)).read()
    with pytest.raises(LimitError, match=r"more than 100 bytes of memory \(max_memory=\)"):
        Reader(data, limits=Limits.of_memory(100)).read()


WRITING = {"decode": "b.npz", "convert": "b.npz", "encode": "b.hapf", "recover": "b.hapf"}


@pytest.mark.parametrize("verb", ["info", "verify", "du", "dump", "clocks", *WRITING])
def test_every_verb_has_the_option(verb, tmp_path):
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
    """
    path, out = tmp_path / "a.hapf", tmp_path / WRITING.get(verb, "none")
    path.write_bytes(f.minimal())
    words = [str(path), str(out)] if verb in WRITING else [str(path)]
    refused = called(verb, *words, "--max-memory", "100")
    assert refused.code == 4
    assert "--max-memory" in refused.err + refused.out
    assert not out.exists()
    assert called(verb, *words, "--max-memory", "1M").code == 0
    assert called(verb, *words, "--max-memory", "lots").code == 1
