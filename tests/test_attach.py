"""What is added to a file that stands: attachments and metadata (SPEC 6.7, 6.8, 15)."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from edited import assert_intact, assert_same_channel, made, plain, write
from hypothesis import given
from hypothesis import strategies as st
from strategies import metadata
from terminal import called

import hapfmt
from hapfmt import edit
from hapfmt.edit.additions import free_name
from hapfmt.edit.making import same
from hapfmt.format.extras import Attachment
from hapfmt.format.walk import FOOT_SIZE
from hapfmt.writing.start import open_append


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.hapf"
    path.write_bytes(made("paper step"))
    return path


def assert_same_samples(a: hapfmt.Recording, b: hapfmt.Recording) -> None:
    for one, other in zip(a.channels, b.channels, strict=True):
        assert_same_channel(one, other)
    assert a.uuid == b.uuid and a.epoch_ns == b.epoch_ns


@pytest.mark.parametrize("in_place", [True, False])
def test_what_stands_in_the_file_stays(file: Path, in_place: bool) -> None:
    before = file.read_bytes()
    out = None if in_place else file.with_name("b.hapf")
    new = [Attachment("photo.png", "image/png", b"\x89PNG"), Attachment("sheet.txt", "", b"again")]
    assert edit.attach(file, new, out) == [
        "the file already has an attachment 'sheet.txt'; the new one is listed as 'sheet.txt (2)'"
    ]
    after = (out or file).read_bytes()
    assert after.startswith(before) and (in_place or file.read_bytes() == before)
    assert_intact(after, digests=6)
    assert edit.set_metadata(file, {"subject": "S9", "more": [1]}, out, force=True) == []
    back = hapfmt.read(out or file)
    assert back.metadata["subject"] == "S9" and back.metadata["more"] == [1]
    assert back.metadata["n"] == [1, 2.5, None]
    assert_same_samples(back, hapfmt.read(before))
    if in_place:
        assert back.attachments == {
            "sheet.txt": ("text/plain", b"as it was"),
            "photo.png": ("image/png", b"\x89PNG"),
            "sheet.txt (2)": ("", b"again"),
        }


@given(metadata.filter(bool))
def test_any_metadata(members: dict[str, Any]) -> None:
    out = io.BytesIO()
    edit.set_metadata(made("lossless"), members, out)
    found = hapfmt.read(out.getvalue()).metadata
    assert all(same(found[name], value) for name, value in members.items())
    assert_intact(out.getvalue())


def test_a_file_that_was_not_closed_is_gone_on_with(file: Path) -> None:
    file.write_bytes(made("paper step")[: -FOOT_SIZE + 7])
    notes = edit.attach(file, [Attachment("a", "", b"a")])
    [note] = notes
    assert re.fullmatch(r"appending: 7 bytes at \d+ were cut off, no whole chunk", note)
    assert_intact(file.read_bytes())
    cut = made("paper step")[:-1500]
    file.write_bytes(cut)
    notes = edit.attach(file, [Attachment("a", "", b"a")])
    assert len(notes) == 1 and notes[0].startswith("appending: ")
    assert_intact(file.read_bytes())
    assert notes[0] in hapfmt.read(file).metadata["notes"]


def test_two_writers(file: Path) -> None:
    with (
        open_append(file),
        pytest.raises(hapfmt.ParameterError, match="Another program is writing"),
    ):
        edit.attach(file, [Attachment("a", "", b"a")])


def test_too_large_for_the_level(file: Path, tmp_path: Path) -> None:
    before = file.read_bytes()
    large = Attachment("large", "", bytes(1 << 20))
    with pytest.raises(hapfmt.ParameterError, match=r"large: 1048583 .* limit of level 1; subset"):
        edit.attach(file, [Attachment("small", "", b""), large])
    assert file.read_bytes() == before
    with pytest.raises(hapfmt.ParameterError, match="limit of level 1"):
        edit.attach(file, [large], tmp_path / "b.hapf")
    assert not (tmp_path / "b.hapf").exists()
    edit.subset(file, tmp_path / "b.hapf", level=2)
    edit.attach(tmp_path / "b.hapf", [large])
    assert_intact((tmp_path / "b.hapf").read_bytes())
    with pytest.raises(hapfmt.ParameterError, match=r"limit of level 2$"):
        edit.attach(tmp_path / "b.hapf", [Attachment("larger", "", bytes(1 << 24))])


class TestExtract:
    """ATT-002: A reader that stores an attachment MUST NOT use more than the last component of its name, split at `/`, `\\` and `:`. It removes leading dots and control characters; where nothing is left it chooses a name."""

    def test_names_are_no_paths(self, tmp_path: Path) -> None:
        names = ["../../etc/passwd", "C:\\x\\..\\y.txt", "/", "a/.profile", "A/Y.TXT", "\x1b[2J"]
        data = write(replace(plain(0), attachments={name: ("", name.encode()) for name in names}))
        folder = tmp_path / "folder"
        folder.mkdir()
        found = edit.extract(data, folder=folder)
        assert [path.name for path in found] == [
            "passwd", "y.txt", "attachment", "profile", "Y (2).TXT", "[2J",
        ]  # fmt: skip
        assert sorted(tmp_path.rglob("*")) == sorted([folder, *found])
        assert [path.read_bytes().decode() for path in found] == names

    def test_some_and_again(self, tmp_path: Path) -> None:
        data = made("paper step")
        (path,) = edit.extract(data, ["sheet.txt"], tmp_path)
        assert path.read_bytes() == b"as it was"
        with pytest.raises(hapfmt.ParameterError, match="already exists"):
            edit.extract(data, None, tmp_path)
        assert edit.extract(data, None, tmp_path, force=True) == [path]

    @given(st.lists(st.sampled_from(["a", "A", "a (2)", "a.b", "A.b"]), max_size=5))
    def test_alike_names_get_numbers(self, names: list[str]) -> None:
        taken: set[str] = set()
        for name in names:
            free = free_name(name, taken)
            assert free.casefold() not in taken
            taken.add(free.casefold())


def test_a_file_is_read_under_its_own_name(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("hello")
    assert edit.attachment_of(path) == Attachment("notes.txt", "text/plain", b"hello")
    given_ = edit.attachment_of(path, name="x", media_type="a/b")
    assert given_ == Attachment("x", "a/b", b"hello")


def test_a_link_to_nothing_is_not_followed(file: Path) -> None:
    folder, aim = file.parent / "out", file.parent / "aim"
    folder.mkdir()
    (folder / "sheet.txt").symlink_to(aim)
    with pytest.raises(hapfmt.ParameterError, match="is a symbolic link"):
        edit.extract(file, None, folder)
    assert not aim.exists()
    edit.extract(file, None, folder, force=True)
    assert aim.read_bytes() == b"as it was"


def test_info_lists_the_names_that_attach_lists(file: Path) -> None:
    new = [Attachment("sheet.txt", "", b"again"), Attachment("sheet.txt", "", b"third")]
    edit.attach(file, new)
    listed = json.loads(called("attach", file, "--list", "--json").out)["attachments"]
    assert [each["name"] for each in listed][-2:] == ["sheet.txt (2)", "sheet.txt (3)"]
    assert json.loads(called("info", file, "--json").out)["attachments"] == listed
    assert "attachment: sheet.txt (3) (5 bytes)" in called("info", file).out
