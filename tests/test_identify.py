"""packaging/identify: file(1), desktops, DROID and FIDO know hapf by its first bytes."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from depth import sample
from spec import ROOT, TEXT

import hapfmt
from hapfmt.format.extras import MEDIA_TYPE
from hapfmt.format.wire import HEADER_SIZE, SIGNATURE, SYNC

FOLDER = ROOT / "packaging" / "identify"
EXAMPLE = ROOT / "conformance" / "examples" / "residual.hapf"
VECTORS = sorted((ROOT / "conformance" / "vectors").glob("*/*.hapf"))
HEAD_AT = len(SIGNATURE) + HEADER_SIZE
DROID = "{http://www.nationalarchives.gov.uk/pronom/SignatureFile}"


def known(data: bytes) -> bool:
    return data.startswith(SIGNATURE)


def version(data: bytes) -> tuple[int, ...]:
    """Major, minor and level: those that the file has where it begins with a HEAD (SPEC 6.1)."""
    return tuple(data[HEAD_AT : HEAD_AT + 3]) if data[8:16] == SYNC + b"HEAD" else ()


def inputs(room: Path) -> list[Path]:
    """Vectors, cut files, and files of other formats."""
    found = [value for param in sample([(path,) for path in VECTORS]) for value in param.values]
    data = EXAMPLE.read_bytes()
    for size in (0, 7, 8, 12, 16, HEAD_AT, HEAD_AT + 1, HEAD_AT + 2, HEAD_AT + 3):
        (room / f"cut-{size}.hapf").write_bytes(data[:size])
    (room / "late.hapf").write_bytes(b"\0" + data)
    (room / "text.hapf").write_bytes(b"HAP\r\n")
    recording = hapfmt.read(EXAMPLE)
    for suffix in (".npz", ".csv"):
        hapfmt.save(recording, room / f"other{suffix}")
    shutil.copy(ROOT / "docs" / "picture.png", room)
    return [*found, *sorted(room.iterdir())]


def test_files(tmp_path):
    """file(1) prints version and level as HEAD has them."""
    program = shutil.which("file")
    if program is None:
        pytest.skip("no file(1) here")
    paths = inputs(tmp_path)
    magic = FOLDER / "hapf.magic"
    for option in ("", "--mime-type", "--extension"):
        words = (program, "-m", str(magic), "-b", *filter(None, [option]), *paths)
        done = subprocess.run(words, capture_output=True, text=True, check=True)
        assert not done.stderr
        for path, line in zip(paths, done.stdout.splitlines(), strict=True):
            data = path.read_bytes()
            if not known(data):
                assert "hapf" not in line, path
            elif not option:
                numbers = [int(number) for number in re.findall(r"\d+", line)]
                assert line.startswith("hapf haptic recording"), path
                assert tuple(numbers) == version(data), path
            else:
                assert line == {"--mime-type": MEDIA_TYPE, "--extension": "hapf"}[option], path


def test_desktops(tmp_path):
    """shared-mime-info: update-mime-database takes the entry, and desktops find the type."""
    program = shutil.which("update-mime-database")
    if program is None:
        pytest.skip("no shared-mime-info here")
    packages = tmp_path / "mime" / "packages"
    packages.mkdir(parents=True)
    shutil.copy(FOLDER / "hapf.mime.xml", packages / "hapf.xml")
    environment = {**os.environ, "XDG_DATA_HOME": str(tmp_path)}
    words = [program, tmp_path / "mime"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0 and not done.stderr, done.stderr
    assert f":{MEDIA_TYPE}:*.hapf" in (tmp_path / "mime" / "globs2").read_text("utf-8")
    assert SIGNATURE in (tmp_path / "mime" / "magic").read_bytes()
    pytest.importorskip("xdg")
    ask = """
import sys
from xdg import Mime
print(*[Mime.get_type2(name) for name in sys.argv[1:]], sep="\\n")
"""
    room = tmp_path / "files"
    room.mkdir()
    contents = {"a.hapf": EXAMPLE.read_bytes(), "unnamed": EXAMPLE.read_bytes(), "b.txt": b"text"}
    for name, data in contents.items():
        (room / name).write_bytes(data)
    words = (sys.executable, "-c", ask, *(str(room / name) for name in contents))
    said = subprocess.run(words, capture_output=True, text=True, check=True, env=environment).stdout
    assert said.split() == [MEDIA_TYPE, MEDIA_TYPE, "text/plain"]


def pronom_pattern(signature: ET.Element) -> str:
    """In PRONOM's notation, with the gaps before the fragments."""
    (part,) = signature.iter(f"{DROID}SubSequence")
    found = part.findtext(f"{DROID}Sequence")
    for fragment in part.iter(f"{DROID}RightFragment"):
        assert fragment.get("MinOffset") == fragment.get("MaxOffset")
        found += f"{{{fragment.get('MinOffset')}}}{fragment.text}"
    return found


def test_droid():
    """The shifts of a byte count from the end of the sequence; FIDO's file has the same patterns."""
    tree = ET.parse(FOLDER / "hapf.droid.xml")
    signatures = {s.get("ID"): s for s in tree.iter(f"{DROID}InternalSignature")}
    for signature in signatures.values():
        (sequence,) = signature.iter(f"{DROID}Sequence")
        data = bytes.fromhex(sequence.text)
        assert data.startswith(SIGNATURE)
        assert EXAMPLE.read_bytes().startswith(data)
        shifts = {
            bytes.fromhex(s.get("Byte"))[0]: int(s.text) for s in signature.iter(f"{DROID}Shift")
        }
        assert shifts == {byte: len(data) - data.rindex(byte) for byte in data}
        assert int(signature.findtext(f".//{DROID}DefaultShift")) == len(data) + 1
    rows = []
    for kind in tree.iter(f"{DROID}FileFormat"):
        signature = signatures.pop(kind.findtext(f"{DROID}InternalSignatureID"))
        rows.append(
            (kind.get("PUID"), kind.get("Version"), kind.get("MIMEType"), pronom_pattern(signature))
        )
        assert kind.findtext(f"{DROID}Extension") == "hapf"
    assert not signatures
    fido = ET.parse(FOLDER / "hapf.fido.xml")
    assert rows == [
        (
            kind.findtext("puid"),
            kind.findtext("version"),
            kind.findtext("mime"),
            kind.findtext(".//pronom_pattern"),
        )
        for kind in fido.iter("format")
    ]
    newest = re.search(r"^Version (\d+)\.(\d+) of", TEXT, re.M)
    versions = [f"{newest[1]}.{minor}" for minor in range(int(newest[2]) + 1)]
    assert [row[1] for row in rows] == [None, *versions]
    assert all(row[2] == MEDIA_TYPE for row in rows)


@pytest.mark.deep
def test_fido(tmp_path):
    """Each version has an identifier of its own; other formats keep their own identification."""
    prepare = pytest.importorskip("fido.prepare")
    for pattern in ET.parse(FOLDER / "hapf.fido.xml").iter("pattern"):
        made = prepare.convert_to_regex(pattern.findtext("pronom_pattern"))
        assert made == pattern.findtext("regex")
    paths = [path for path in inputs(tmp_path) if path.stat().st_size]
    form = "%(info.filename)s|%(info.puid)s|%(info.matchtype)s\\n"
    words = ("-q", "-loadformats", FOLDER / "hapf.fido.xml", "-matchprintf", form)
    done = subprocess.run(
        [sys.executable, "-m", "fido.fido", *words, "-nomatchprintf", "", *paths],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found: dict[str, set[str]] = {}
    for line in done.stdout.splitlines():
        name, puid, matched = line.split("|")
        if matched == "signature":
            found.setdefault(name, set()).add(puid)
    for path in paths:
        data = path.read_bytes()
        puids = {puid for puid in found.get(str(path), set()) if puid.startswith("x-hapf/")}
        expected = "x-hapf/2" if version(data)[:2] == (1, 0) else "x-hapf/1"
        assert puids == ({expected} if known(data) else set()), path
    assert found[str(tmp_path / "picture.png")] & {"fmt/11", "fmt/12", "fmt/13"}
