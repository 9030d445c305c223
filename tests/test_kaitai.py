"""conformance/kaitai: the container as hapf.ksy describes it."""

from __future__ import annotations

import importlib.util
import re
import sys

import pytest
from spec import ROOT

ROOM = ROOT / "conformance" / "kaitai"
TEXT = (ROOM / "hapf.ksy").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def check():
    spec = importlib.util.spec_from_file_location("kaitai_check", ROOM / "check.py")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(ROOM))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(ROOM))
    return module


TYPES = {
    "chunk header": "chunk_header", "HEAD": "head", "deviation": "deviation", "iNDX": "indx", "fOOT": "foot", "QUAN parameters": "quan_parameters",
    "RAWB parameters": "rawb_parameters", "LPCX parameters": "lpcx_parameters",
    "LPCX term": "lpcx_term", "NOIS parameters": "nois_parameters",
}  # fmt: skip


def fields(name):
    """(id, the lines that belong to it) of a type."""
    block = re.search(rf"^  {name}:\n((?:   .*\n)+)", TEXT, re.M)[1]
    parts = re.split(r"^      - id: ", block.split("    seq:\n")[1], flags=re.M)[1:]
    return [part.split("\n", 1) for part in parts]


@pytest.mark.parametrize("name", TYPES)
def test_tables_of_the_spec(check, name):
    """The same fields in the same order, of the same types."""
    rows = check.plain.table(name)
    found = fields(TYPES[name])[: len(rows)]
    assert [id_ for id_, _ in found] == [field for *_, field in rows]
    for (id_, lines), (_, size, kind, _) in zip(found, rows, strict=True):
        if kind in check.plain.CODES:
            letter = {"u": "u", "i": "s", "f": "f"}[kind[0]]
            assert f"type: {letter}{size}\n" in lines, id_
        else:
            assert f"size: {size}\n" in lines or "contents: [" in lines, id_


def test_every_field_is_explained():
    ids = re.split(r"^ +- id: ", TEXT, flags=re.M)[1:]
    assert len(ids) > 130
    assert [part.split("\n")[0] for part in ids if "doc: " not in part] == []


def test_files(check):
    """Each field of every file that keeps the rules."""
    try:
        module = check.compiled()
    except check.Missing as what:
        pytest.skip(f"not installed: {what}")
    paths = check.files()
    assert len(paths) >= 3
    wrong = {path.name: check.check(module, path.read_bytes()) for path in paths}
    assert {name: lines for name, lines in wrong.items() if lines} == {}


def test_a_difference_is_seen(check):
    file = check.files()[0].read_bytes()
    one, other = check.plain.parse(file), check.plain.parse(file)
    assert list(check.differences(one, other)) == []
    track = other["chunks"][1]["payload"]["tracks"]["tracks"][0]
    track["rate_num"] += 1
    track["tlvs"][0].pop("size")
    assert len(list(check.differences(one, other))) == 2
