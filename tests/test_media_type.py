"""docs/spec/media-type.md: one media type, wherever one is given."""

from __future__ import annotations

import re
import subprocess

import pytest
from spec import ROOT, TEXT

from hapfmt.edit.additions import attachment_of
from hapfmt.format.extras import MEDIA_TYPE, OVERVIEW

PAGE = (ROOT / "docs" / "spec" / "media-type.md").read_text(encoding="utf-8")
GIVEN = re.compile(r"[a-z]+/(?:vnd\.|x-)?hapf\b(?:\.overview)?(?!/)")
KINDS = ("application/", "haptics/", "model/", "video/", "audio/")
PLACES = ("hapfmt", "docs", "packaging", "conformance", "tools", "SPEC.md", "README.md")
FIELDS = (
    "Type name", "Subtype name", "Required parameters", "Optional parameters",
    "Encoding considerations", "Security considerations", "Interoperability considerations",
    "Published specification", "Applications that use this media type",
    "Fragment identifier considerations", "Deprecated alias names for this type",
    "Magic number(s)", "File extension(s)", "Macintosh file type code(s)",
    "Person & email address to contact for further information", "Intended usage",
    "Restrictions on usage", "Author", "Change controller", "Provisional registration?",
)  # fmt: skip
"""Of RFC 6838, section 5.6."""


def texts():
    """(path, text) of each file of the repository in which a type may be given."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", *PLACES], cwd=ROOT, capture_output=True, check=False
    )
    if listed.returncode:
        pytest.skip("no working tree of git")
    for name in listed.stdout.decode().split("\0"):
        path = ROOT / name
        if name and path.is_file() and path.suffix not in (".hapf", ".png"):
            try:
                yield name, path.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                continue


def test_the_same_type_everywhere():
    found = {}
    for name, text in texts():
        for given in GIVEN.findall(text):
            if given.startswith(KINDS):
                found.setdefault(given, set()).add(name)
    assert found.keys() == {MEDIA_TYPE, f"{MEDIA_TYPE}.overview"}, found
    places = {name.split("/")[0] for name in found[MEDIA_TYPE]}
    assert places >= {"SPEC.md", "hapfmt", "docs", "packaging", "conformance"}


def test_the_spec_and_the_application_name_it():
    assert re.search(r"media type\]?(?:\([^)]*\))? `([^`]+)`", TEXT)[1] == MEDIA_TYPE
    assert ("overview", f"{MEDIA_TYPE}.overview") == OVERVIEW
    rows = dict(re.findall(r"^\| ([^|]+?) \| (.+) \|$", PAGE, re.M))
    assert list(rows)[1:] == list(FIELDS)
    assert f"{rows['Type name']}/{rows['Subtype name']}" == MEDIA_TYPE
    author = re.search(
        r"^authors:\n  - name: (.+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.M
    )
    for field in ("Person & email address to contact for further information", "Author"):
        assert rows[field].startswith(author[1])


def test_the_magic_number_is_that_of_files():
    first = (ROOT / "conformance" / "examples" / "hold.hapf").read_bytes()[:16]
    row = re.search(r"^\| Magic number\(s\) \| (.+) \|$", PAGE, re.M)[1]
    told = [bytes.fromhex(each) for each in re.findall(r"`([0-9A-F ]+)`", row)]
    assert told == [first[:8], first[8:]]


def test_an_attached_recording_has_it(tmp_path):
    for name, expected in (("a.hapf", MEDIA_TYPE), ("a.txt", "text/plain"), ("a.none", "")):
        (tmp_path / name).write_bytes(b"")
        assert attachment_of(tmp_path / name).media_type == expected
