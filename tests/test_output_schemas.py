"""The JSON that dump, info and verify print keeps the schemas that they print."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from functools import cache
from pathlib import Path
from typing import Any

import commands
import jsonschema
import numpy as np
import pytest
from depth import sample
from spec import ROOT

import hapfmt
from hapfmt.cli.common import finite
from hapfmt.cli.info import described, with_its_events
from hapfmt.errors import HapfmtError
from hapfmt.format.source import open_source
from hapfmt.limits import Limits
from hapfmt.reading.dump import dump
from hapfmt.reading.verifier import verify

VECTORS = sorted((ROOT / "conformance" / "vectors").glob("*/*.hapf"))
VECTORS += sorted((ROOT / "conformance" / "examples").glob("*.hapf"))
FEW = Limits(packet_samples=1 << 16)
"""Of the samples that a dump prints."""
COMMANDS = ("dump", "info", "verify")


@cache
def schema(command: str) -> Any:
    return json.loads((ROOT / "hapfmt" / "cli" / "schemas" / f"{command}.json").read_text("utf-8"))


@cache
def validator(command: str) -> Any:
    jsonschema.Draft202012Validator.check_schema(schema(command))
    return jsonschema.Draft202012Validator(schema(command))


def check(command: str, value: Any) -> None:
    fault = jsonschema.exceptions.best_match(validator(command).iter_errors(value))
    assert fault is None, f"{command}: {fault.json_path}: {fault.message}"


def outputs(path: Path) -> Iterator[tuple[str, Any]]:
    """Of each command, with and without its options. A file that cannot be opened has none."""
    for counts in (False, True):
        with closing(open_source(path)) as source, suppress(HapfmtError):
            yield "dump", list(dump(source, counts=counts, limits=FEW))
    for look in (described, with_its_events):
        with suppress(HapfmtError):
            yield "info", look(str(path), Limits())[1]
    yield "verify", finite(verify(path).as_json())


def foreign_outputs(folder: Path) -> Iterator[Any]:
    """Of info, for other formats: with gaps, units and events, and the list of formats."""
    events = [hapfmt.Event(1, "slip")]
    (folder / "a.csv").write_text("t [s],fx [newton],a\n0,1,2\n1,,2\n2,3,2\n3,3,2\n")
    recording = hapfmt.Recording((hapfmt.Channel(np.zeros(9), 10),), events=events)
    hapfmt.save(recording, folder / "a.mcap")
    for name in ("a.csv", "a.mcap"):
        yield printed("info", folder / name, "--json")
        yield printed("info", folder / name, "--json", "--events")
    yield printed("info", "--formats", "--json")


def printed(*words: object, code: int = 0) -> Any:
    done = commands.run(*words, cwd=Path.cwd())
    assert done.returncode == code, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    "path", sample(VECTORS, 20), ids=lambda path: f"{path.parent.name}-{path.stem}"
)
def test_vectors(path):
    for command, value in outputs(path):
        check(command, json.loads(json.dumps(value)))


@pytest.fixture
def touch(tmp_path) -> Path:
    time = np.arange(1000) / 1000
    signal = np.stack([np.sin(6 * time), np.cos(200 * time) / 50])
    path = tmp_path / "touch.hapf"
    shutil.copy(ROOT / "conformance" / "examples" / "residual.hapf", tmp_path / "other.hapf")
    hapfmt.write(signal, tmp_path / "touch.npz.hapf", rate=1000, labels=["fx", "a"], units="N")
    hapfmt.write(signal, path, rate=1000, labels=["fx", "a"], units="N", preset="perceptual")
    return path


class TestOwnFiles:
    def test_commands_print_what_their_schemas_say(self, touch):
        check("dump", printed("dump", touch, "--counts"))
        check("info", printed("info", touch, "--json"))
        check("info", printed("info", touch, "--json", "--follow"))
        check("verify", printed("verify", touch, "--json"))
        against = printed("verify", touch, "--json", "--against", touch.with_suffix(".npz.hapf"))
        check("verify", against)
        assert len(against["contracts"]) == 2

    def test_info_of_other_formats(self, tmp_path):
        for value in foreign_outputs(tmp_path):
            check("info", value)
            with pytest.raises(AssertionError):
                check("info", {**value, "new": 1})

    def test_failures(self, tmp_path):
        for command in ("info", "verify"):
            check(command, printed(command, tmp_path / "none.hapf", "--json", code=1))

    def test_damage(self, touch, tmp_path):
        """One wrong byte anywhere, and a cut anywhere."""
        data = touch.read_bytes()
        path = tmp_path / "damaged.hapf"
        for place in range(0, len(data), len(data) // 20):
            path.write_bytes(data[:place] + bytes([data[place] ^ 16]) + data[place + 1 :])
            for command, value in outputs(path):
                check(command, json.loads(json.dumps(value)))
            path.write_bytes(data[:place])
            for command, value in outputs(path):
                check(command, json.loads(json.dumps(value)))

    @pytest.mark.parametrize("command", COMMANDS)
    def test_the_schema_is_printed(self, command):
        assert printed(command, "--schema") == schema(command)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_new_key_is_refused(command, touch):
    for name, value in outputs(touch):
        if name == command:
            first = value[0] if isinstance(value, list) else value
            with pytest.raises(AssertionError):
                check(
                    command,
                    [{**first, "new": 1}] if isinstance(value, list) else {**first, "new": 1},
                )


def properties(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        if isinstance(node.get("properties"), dict):
            yield from node["properties"]
        for each in node.values():
            yield from properties(each)
    elif isinstance(node, list):
        for each in node:
            yield from properties(each)


def keys(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        yield from value
        for each in value.values():
            yield from keys(each)
    elif isinstance(value, list):
        for each in value[:100]:
            yield from keys(each)


@pytest.mark.deep
@pytest.mark.parametrize("command", COMMANDS)
def test_no_key_of_a_schema_is_idle(command, touch, tmp_path):
    """Each key is printed for some vector, for a growing file, or against an original."""
    found: Counter[str] = Counter()
    for path in VECTORS:
        for name, value in outputs(path):
            if name == command:
                found.update(keys(value))
    found.update(keys(printed("info", touch, "--json", "--follow")))
    for value in foreign_outputs(tmp_path):
        found.update(keys(value))
    found.update(keys(printed("verify", touch, "--json", "--against", touch)))
    assert set(properties(schema(command))) - set(found) <= {"error"}
