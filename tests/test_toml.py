"""TOML of strangers: bounded before it is parsed."""

from __future__ import annotations

import tomllib
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapfmt import descriptions
from hapfmt.descriptions import MOST_DIGITS, MOST_NESTED, MOST_PARTS, MOST_WORDS, parse_toml
from hapfmt.errors import HapfmtError, ParameterError
from hapfmt.lab.scenes.description import load_scene
from hapfmt.lab.study.description import load_study
from hapfmt.replay.profile.parse import load_profile

pytestmark = pytest.mark.capped

DOTTED = ".".join("a" * 20_000)
BOMBS = {
    "key": (f"{DOTTED} = 1", "a key of more than 16 parts (at line 1, column 33)"),
    "spaced": (DOTTED.replace(".", " \t. ") + " = 1", "a key of more than 16 parts"),
    "header": (f"\n\n[{DOTTED}]", "a key of more than 16 parts (at line 3, column 34)"),
    "array of tables": (f"[[{DOTTED}]]", "a key of more than 16 parts"),
    "quoted": (".".join(['"a.b"', "'c'"] * 9999) + " = 1", "a key of more than 16 parts"),
    "inline": (f"x = [{{ {DOTTED} = 1 }}]", "a key of more than 16 parts"),
    "behind a string": (f'x = """\n"""\n{DOTTED} = 1', "a key of more than 16 parts"),
    "behind a comment": (f"# it's\n{DOTTED} = 1", "(at line 2, column 33)"),
    "nested": ("x = " + "[" * 40_000, "nested more than 32 deep (at line 1, column 37)"),
    "braces": ("x = " + "{a=" * 40_000, "nested more than 32 deep"),
    "many": ("".join(f"a{i}.b.c.d.e.f.g = 1\n" for i in range(9000)), "65536 names and values"),
    "headers": ("".join(f"[a{i}.b.c.d.e.f.g]\n" for i in range(10_000)), "65536 names and"),
    "digits": ("x = " + "1" * 5000, "a number of more than 1000 digits"),
    "hex": ("x = 0x" + "f" * 5000, "a number of more than 1000 digits"),
    "fraction": ("x = 1." + "1" * 5000, "a number of more than 1000 digits"),
    "size": ("# " + "x" * (1 << 20), "more than 1048576 characters"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_refused_before_they_are_parsed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def parsed(_: str) -> None:
        pytest.fail("parsed")

    monkeypatch.setattr(tomllib, "loads", parsed)
    text, message = BOMBS[name]
    with pytest.raises(ParameterError) as caught:
        parse_toml(text)
    assert message in str(caught.value)


@pytest.mark.parametrize("load", [load_profile, load_scene, load_study])
def test_files_of_strangers(load: Any, tmp_path: Path) -> None:
    path = tmp_path / "bomb.toml"
    path.write_text(BOMBS["key"][0])
    with pytest.raises(HapfmtError, match="a key of more than 16 parts"):
        load(str(path))


def test_at_the_bounds() -> None:
    key = ".".join("a" * MOST_PARTS)
    assert parse_toml(f"{key} = 1\n[b]\n{key} = 2")
    assert parse_toml("x = " + "[" * MOST_NESTED + "]" * MOST_NESTED)
    assert parse_toml("x = " + "1" * MOST_DIGITS)
    assert len(parse_toml("x = [" + "1," * (MOST_WORDS - 1) + "]")["x"]) == MOST_WORDS - 1


PLAIN = """
# It's "a" comment with [[[ and 'quotes'
title = "a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q [[[ # no comment"
path = 'C:\\a.b'  # 'x
text = \"\"\"
a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s "quoted" ""twice"" \\\""" \"\"\"\"\"
raw = '''[[[[ it''s " '''
when = 1979-05-27T07:32:00.999999-07:00
numbers = [1.5, 2.5, -3e-5, 0xff, 1_000.000_1, .5]
"""


def test_what_strings_and_comments_hold_does_not_count() -> None:
    text = PLAIN.replace(", .5", "")
    assert parse_toml(text) == tomllib.loads(text)
    many = "".join(f'[[actuator]]\nname = "a.{"b." * 30}{i}"\n' for i in range(999))
    assert len(parse_toml(many)["actuator"]) == 999


@given(st.text(alphabet="a1.\"'\\\n\t #=[]{},-+", max_size=60))
def test_any_text_is_scanned_to_where_it_is_parsed(text: str) -> None:
    """What tomllib takes, and is small, is never refused; what it refuses is still an error."""
    try:
        expected = tomllib.loads(text)
    except ValueError:
        expected = None
    try:
        found = parse_toml(text)
    except ParameterError:
        found = None
    small = text.count(".") < MOST_PARTS and text.count("[") + text.count("{") < MOST_NESTED
    assert found == expected or not small


def parts_parsed(text: str) -> int:
    """The longest key that tomllib gets to see."""
    longest = 0
    parse = tomllib._parser.parse_key  # type: ignore[attr-defined]

    def counted(*given: Any) -> Any:
        nonlocal longest
        pos, key = parse(*given)
        longest = max(longest, len(key))
        return pos, key

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tomllib._parser, "parse_key", counted)  # type: ignore[attr-defined]
        with suppress(ParameterError):
            descriptions.parse_toml(text)
    return longest


@given(
    st.lists(
        st.sampled_from(
            ['"', "'", '"""', "'''", "\\", "\n", "#", "=", "[", "]", "{", "}", " ", "x", ","]
            + [f"k={q}" for q in ('"', "'", '"""', "'''")]
            + ["\n" + ".".join("a" * 20) + "=1\n", "[" + ".".join("b" * 20) + "]"]
        ),
        max_size=20,
    )
)
def test_no_long_key_hides_behind_a_string(parts: list[str]) -> None:
    assert parts_parsed("".join(parts)) <= MOST_PARTS
