"""Bytes that break a rule, through every verb: a code of SPEC clause 13, JSON that is whole, and
never a traceback."""

from __future__ import annotations

import json
from pathlib import Path

import fault_table
import forge as f
import pytest
from depth import deep, either
from fuzzing import TARGETS
from spec import ROOT
from terminal import called

pytestmark = pytest.mark.capped

CODES = {0, 2, 3, 4}
READING = (
    ["info", "--json"],
    ["verify", "--json"],
    ["du", "--json"],
    ["dump"],
    ["dump", "--counts"],
)
CORPUS = ROOT / "tests" / "corpus"


UNITS = ("1", "N", "m", "s", "V", "Pa", "Cel", "rad", "m/s2", "{count}")
ANY = f"""
name = "any"
[timing]
rate = 50
[[actuator]]
name = "one"
unit = "1"
accepts = {{ {", ".join(f'"{unit}" = 1' for unit in UNITS)} }}
minimum = -100
maximum = 100
rest = 0
slew = 1e6
step = 0.1
[[report]]
path = "output"
id = 1
length = 3
fields = [{{ at = 1, actuator = "one", type = "i16" }}]
"""
"""A device that takes nearly anything."""


def judge(data: bytes, folder: Path) -> dict[str, int]:
    """Exit codes by verb."""
    path, out = folder / "a.hapf", folder / "b.npz"
    path.write_bytes(data)
    codes = {}
    for verb, *options in READING:
        said = called(verb, path, *options)
        assert said.code in CODES, said
        assert "Traceback" not in said.err
        assert "internal" not in said.err
        if said.out or options == ["--json"]:
            json.loads(said.out)
        codes[" ".join([verb, *options])] = said.code
    said = called("decode", path, out, "--json", "--force", "--max-memory", "1M")
    # 1: more gaps than an array may have, or rates that the format does not hold.
    assert said.code in CODES | {1}, said
    json.loads(said.out)
    codes["decode"] = said.code
    profile = folder / "any.toml"
    profile.write_text(ANY)
    said = called(
        "replay", path, "--device", profile, "--dry-run", "--map", "0=1", "--stop", 1, "--json"
    )
    # 1: nothing that the device takes.
    assert said.code in CODES | {1}, said
    told = [json.loads(line) for line in said.out.splitlines()]
    assert told[-1]["exit_code"] == said.code
    codes["replay"] = said.code
    return codes


@pytest.mark.parametrize("part", [0, *deep([1, 2, 3])])
def test_corpus(part, tmp_path):
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
    """
    paths = sorted((CORPUS / "file").iterdir())
    for path in paths[part::4]:
        codes = judge(path.read_bytes(), tmp_path)
        if codes["verify --json"] == 0:
            assert set(codes.values()) <= {0, 1}


def test_what_is_no_file(tmp_path):
    for path in sorted((CORPUS / "chunks").iterdir()):
        judge(path.read_bytes(), tmp_path)


def files_of_faults() -> dict[str, bytes]:
    """The files among the shortest inputs that break a rule, as the reader gets to see them."""
    found: dict[str, bytes] = {}

    def kept(data: bytes, *_: object, **__: object) -> None:
        found[fault.name] = bytes(data)
        raise StopIteration

    with pytest.MonkeyPatch.context() as patch:
        for name in ("verify", "Reader", "BytesSource"):
            patch.setattr(fault_table, name, kept)
        for fault in fault_table.FAULTS:
            try:
                fault.call()
            except StopIteration:
                continue
            except Exception:
                continue
    return found


FAULTY = files_of_faults()


def test_there_are_files():
    assert len(FAULTY) > 20


@pytest.mark.parametrize("name", FAULTY)
def test_faults(name, tmp_path):
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
    """
    judge(FAULTY[name], tmp_path)


PAYLOADS = {"head": "HEAD", "tracks": "TRAK", "cluster": "DATA", "metadata": "mETa"}


@either("every", 3, deep=1)
@pytest.mark.parametrize("name", PAYLOADS)
def test_payloads_in_a_file(name, every, tmp_path):
    """Every input of a parser where a file has it."""
    for path in sorted((CORPUS / name).iterdir())[::every]:
        data = path.read_bytes()
        payload = data[1:] if name == "tracks" else data
        parts = {"HEAD": f.head(), "TRAK": f.trak(), "DATA": f.DATA_0[1], "mETa": b"{}"}
        parts[PAYLOADS[name]] = payload
        judge(f.file(*parts.items()), tmp_path)


def test_targets_are_those_of_the_corpus():
    assert PAYLOADS.keys() <= TARGETS.keys()
