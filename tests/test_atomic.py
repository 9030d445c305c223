"""Files that appear whole or not at all."""

import re
from pathlib import Path

import pytest

from hapfmt.errors import ParameterError
from hapfmt.files import atomic_write


def test_the_file_appears_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "a.hapf"
    with atomic_write(path) as stream:
        stream.write(b"abc")
        stream.seek(1)
        assert stream.read(1) == b"b"
        stream.write(b"d")
        assert not path.exists()
    assert path.read_bytes() == b"abd"
    assert [p.name for p in tmp_path.iterdir()] == ["a.hapf"]


def test_permissions_are_those_of_a_new_file(tmp_path: Path) -> None:
    (tmp_path / "plain").write_bytes(b"")
    with atomic_write(tmp_path / "a") as stream:
        stream.write(b"x")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize("before", [None, b"old"])
def test_a_failure_leaves_everything_as_it_was(
    tmp_path: Path, error: type[BaseException], before: bytes | None
) -> None:
    path = tmp_path / "a"
    if before is not None:
        path.write_bytes(before)
    with pytest.raises(error), atomic_write(path, force=True) as stream:
        stream.write(b"new")
        raise error
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == ({"a": before} if before else {})


def test_an_existing_file_needs_force(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"old")
    with pytest.raises(ParameterError, match=f"{path} already exists"), atomic_write(path):
        pytest.fail("entered")
    with atomic_write(path, force=True) as stream:
        stream.write(b"new")
    assert path.read_bytes() == b"new"


def test_a_file_that_appeared_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with pytest.raises(ParameterError, match="already exists"), atomic_write(path) as stream:
        stream.write(b"new")
        path.write_bytes(b"of someone else")
    assert path.read_bytes() == b"of someone else"
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_bytes(b"old")
    link.symlink_to(target)
    with atomic_write(link, force=True) as stream:
        stream.write(b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "not a file name"),
        (".", "not a file name"),
        ("{tmp}", "is a directory"),
        ("{tmp}/sub/", "the directory .*sub/ does not exist"),
        ("{tmp}/there.hapf/", "there.hapf is a file, not a directory"),
        ("{tmp}/missing/a", "does not exist"),
        ("/dev/null", "not a regular file"),
    ],
)
@pytest.mark.parametrize("force", [False, True])
def test_refusals(tmp_path: Path, name: str, message: str, force: bool) -> None:
    (tmp_path / "there.hapf").touch()
    with (
        pytest.raises(ParameterError, match=message),
        atomic_write(name.format(tmp=tmp_path), force=force),
    ):
        pytest.fail("entered")


def test_an_error_of_the_system_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "file" / "a"
    path.parent.write_bytes(b"")
    with pytest.raises(OSError, match=re.escape(str(path))), atomic_write(path):
        pytest.fail("entered")


@pytest.mark.parametrize("appears_late", [False, True])
def test_a_link_to_nothing_needs_force(tmp_path: Path, appears_late: bool) -> None:
    """Who may put a link into a folder would else choose which file is made, and where."""
    aim, link = tmp_path / "elsewhere", tmp_path / "link"
    if not appears_late:
        link.symlink_to(aim)
    with (
        pytest.raises(ParameterError, match=f"{link} is a symbolic link"),
        atomic_write(link) as stream,
    ):
        stream.write(b"new")
        link.symlink_to(aim)
    assert [p.name for p in tmp_path.iterdir()] == ["link"]
    with atomic_write(link, force=True) as stream:
        stream.write(b"new")
    assert aim.read_bytes() == b"new" and link.is_symlink()
