"""run.py itself: what it says of adapters that do well, and of those that do not; and hapfmt's."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
import xml.etree.ElementTree as Xml
from pathlib import Path

import pytest
from case import numbers
from depth import PROFILE, either
from runner.manifest import load, rules, select
from suite import CONFORMANCE, PROGRAMS, ROOT, called

FAKE = Path(__file__).resolve().parent / "fake_adapter.py"
COUNTS = [5, 6, 7, -8]
CAPABILITIES = {
    "name": "fake", "version": "1", "format": "1.0", "level": 1, "verbs": ["decode", "verify"],
    "codecs": ["KNOT"], "parts": ["tracks", "findings"],
}  # fmt: skip
TRACK = {
    "track": 0, "kind": "full", "codec": "KNOT", "number_format": "counts", "component_count": 1,
    "rate": [1000, 1], "spans": [[0, 3], [9, 10]], "numbers": "a.raw",
}  # fmt: skip
HEAD = {
    "major": 1, "minor": 0, "level": 1, "file_id": "0x0000000000000007",
    "uuid": "00000000000080008700000000000000", "epoch_ns": None, "epoch_uncertainty_ns": None,
}  # fmt: skip
REPORT = {
    "verdict": "intact", "damages": [], "lost": [], "byte_count": 0, "channels": [], "findings": [],
}  # fmt: skip
GOOD = {
    "capabilities": CAPABILITIES,
    "decode": {"head": HEAD, "tracks": [TRACK]},
    "verify": REPORT,
    "raw": {"a.raw": COUNTS},
}
EXPECT = {
    "needs": {"codecs": ["KNOT"], "level": 1},
    "exit": {"decode": 0, "verify": 0},
    "verdict": "intact",
    "decode": {
        "head": {"file_id": "0x0000000000000007"},
        "tracks": [TRACK | {"numbers": numbers(COUNTS)}],
    },
    "verify": {"damages": [], "lost": []},
}


def room_of(folder: Path, cases: dict[str, dict]) -> Path:
    """A folder of cases {set/name: expectation}."""
    rows = []
    for key, expect in cases.items():
        set_, name = key.split("/")
        for part, suffix, data in (("vectors", "hapf", b"any"), ("expected", "json", None)):
            (folder / part / set_).mkdir(parents=True, exist_ok=True)
            path = folder / part / set_ / f"{name}.{suffix}"
            path.write_bytes(data or json.dumps(expect).encode())
        rows.append({"set": set_, "name": name, "about": "One fact.", "requirements": ["KNT-003"]})
    (folder / "manifest.json").write_text(json.dumps({"format": "1.0", "cases": rows}))
    return folder


@pytest.fixture
def room(tmp_path):
    return room_of(tmp_path / "cases", {"valid/one": EXPECT})


def adapter(folder: Path, **changes) -> list[str]:
    """The command of a fake adapter whose answers are GOOD, but for some."""
    folder.mkdir(exist_ok=True)
    (folder / "answers.json").write_text(json.dumps(GOOD | changes))
    return [sys.executable, "-IS", str(FAKE), str(folder)]


def run(room: Path, command: list[str], *options: str, caps=("--timeout", "60")):
    """Exit code, text, and the JSON outcome of run.py."""
    out = room / "out.json"
    out.unlink(missing_ok=True)
    code, text = called(
        "--cases", str(room), "--json", str(out), "--impl", shlex.join(command),
        "--referee", shlex.join(command), "--jobs", "1", *caps, *options,
    )  # fmt: skip
    told = json.loads(out.read_text()) if out.exists() else None
    return code, text, told and told["runs"][0]


def test_an_adapter_that_does_well(room, tmp_path):
    code, text, told = run(room, adapter(tmp_path / "fake"))
    assert code == 0, text
    assert told["counts"]["valid"] == {"cases": 1, "passed": 1}
    assert [(s["verb"], s["status"]) for s in told["cases"][0]["steps"]] == [
        ("decode", "passed"),
        ("verify", "passed"),
    ]
    assert told["cases"][0]["steps"][0]["peak_bytes"] > 1 << 20
    assert told["requirements_not_exercised"] == []
    assert "fake 1: level 1; decode verify; KNOT" in text


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"raw": {"a.raw": [5, 6, 7, 8]}}, "tracks[track 0].numbers, tick 9: expected -8, found 8 (1 of 4 differ)"),
        ({"raw": {"a.raw": [5, 6, 7]}}, "numbers: expected 4 numbers of 8 bytes, found 3 numbers"),
        ({"raw": {}}, "expected a raw file a.raw, found none (FileNotFoundError)"),
        ({"exit": {"decode": 3}}, "exit code: expected 0 (intact), found 3 (damaged)"),
        ({"exit": {"verify": 1}}, "verify: exit code: expected 0 (intact), found 1 (error)"),
        ({"decode": None}, "decode.json: expected a JSON object, found no file"),
        ({"decode": "{"}, "decode.json: expected a JSON object, found what is none"),
        ({"decode": {"head": HEAD, "tracks": []}}, "tracks: expected 1 entries, found 0 entries"),
        ({"decode": {"head": HEAD | {"file_id": "0x0000000000000008"}, "tracks": [TRACK]}}, "head.file_id: expected 0x0000000000000007, found 0x0000000000000008"),
        ({"decode": {"head": HEAD, "tracks": [TRACK | {"rate": [1, 0]}]}}, "decode.json.tracks[0].rate[1]: expected a number from 1 to"),
        ({"decode": {"head": HEAD, "tracks": [TRACK | {"spans": [[0, 4]]}]}}, "spans: expected [[0, 3], [9, 10]], found [[0, 4]]"),
        ({"verify": REPORT | {"verdict": "damaged"}}, "verdict: expected that of exit code 0, intact, found damaged"),
        ({"verify": REPORT | {"damages": [{"code": "garbage", "offset": 9, "size": 2, "message": "", "requirement": "FIL-002", "lost": []}]}}, "damages: expected nothing else, found garbage at 9, 2 bytes"),
        ({"verify": REPORT | {"lost": "all"}}, "report.json.lost: expected JSON of type array, found all"),
        ({"deed": {"decode": "hang"}}, "expected exit code 0, found took longer than 2 s"),
        ({"deed": {"decode": "crash"}}, "expected exit code 0, found was ended by SIGABRT"),
        ({"deed": {"decode": "grow"}}, "found took more than 200 MiB of memory"),
        ({"deed": {"verify": "peak"}}, "MiB of memory"),
        ({"deed": {"decode": "shout"}, "exit": {"decode": 1}}, "it said: what went wrong"),
    ],
)  # fmt: skip
@pytest.mark.realtime
def test_an_adapter_that_does_not(room, tmp_path, changes, said):
    seconds = "2" if "longer than 2 s" in said else "60"
    caps = ("--timeout", seconds, "--memory", "200")
    code, text, told = run(room, adapter(tmp_path / "fake", **changes), caps=caps)
    assert code == 1
    assert said in text
    assert "FAILED valid/one: One fact.\n  rules: KNT-003\n" in text
    assert told["counts"]["all"]["failed"] == 1


def test_memory_of_run_py_is_not_that_of_an_adapter(room, tmp_path):
    bytearray(b"x" * (150 << 20))
    caps = ("--timeout", "60", "--memory", "100")
    code, text, told = run(room, adapter(tmp_path / "fake"), caps=caps)
    assert code == 0, text
    assert 1 << 20 < told["cases"][0]["steps"][0]["peak_bytes"] < 100 << 20


@pytest.mark.realtime
def test_a_server_is_asked_again_and_again_and_started_anew_where_it_ends(tmp_path):
    cases = {f"valid/{name}": EXPECT for name in ("one", "two")}
    room = room_of(tmp_path / "cases", cases)
    served = {"capabilities": CAPABILITIES | {"verbs": ["decode", "verify", "serve"]}}

    def processes(*options, seconds="60", **changes):
        command = adapter(tmp_path / "fake", **served, **changes)
        calls = tmp_path / "fake" / "calls.txt"
        calls.unlink(missing_ok=True)
        code, text, _ = run(room, command, *options, caps=("--timeout", seconds, "--memory", "200"))
        rows = [line.split() for line in calls.read_text().splitlines()]
        return code, len({pid for pid, verb in rows if verb == "decode"}), text

    assert processes()[:2] == (0, 1)
    assert processes("--no-serve")[:2] == (0, 2)
    code, count, text = processes(deed={"decode": "crash"})
    assert (code, count) == (1, 2)
    assert text.count("found the server ended by SIGABRT") == 2
    code, _, text = processes(seconds="2", deed={"decode": "hang"})
    assert text.count("found took longer than 2 s") == 2
    assert "verify" not in text.split("rules:")[1].split("set ")[0]
    assert "MiB of memory" in processes(deed={"verify": "peak"})[2]


def test_what_is_not_claimed_is_not_tested_and_said_so(tmp_path):
    expects = {
        "valid/codec": EXPECT | {"needs": {"codecs": ["LPCR"], "level": 1}},
        "valid/level": EXPECT | {"needs": {"codecs": [], "level": 2}},
        "future/other": EXPECT,
        "valid/verb": EXPECT | {"exit": {"recover": 0}},
        "valid/part": EXPECT | {"decode": {"maps": [{"name": "nobody has it"}]}},
    }
    room = room_of(tmp_path / "cases", expects)
    told = CAPABILITIES | {"sets": ["valid"]}
    code, text, outcome = run(room, adapter(tmp_path / "fake", capabilities=told))
    assert code == 0
    assert outcome["counts"]["all"] == {"cases": 5, "passed": 1, "not tested": 4}
    for reason in ("codec LPCR", "level 2", "set future", "verb recover"):
        assert f"not tested: 1 cases for want of {reason}" in text
    assert "not compared, since not claimed: attachments, bands, channels" in text
    assert outcome["requirements_not_exercised"] == []
    _, text, outcome = run(room, adapter(tmp_path / "fake"), "--case", "codec")
    assert outcome["requirements_not_exercised"] == ["KNT-003"]
    assert "requirements not exercised: 1: KNT-003" in text
    assert set(outcome["rules_without_case"]) == set(rules()) - {"KNT-003"}


def test_files_that_nothing_makes_are_not_tested_and_said_so(tmp_path):
    """Of a copy of the suite without its generators."""
    room = room_of(tmp_path / "cases", {"limits/one": EXPECT, "valid/one": EXPECT})
    manifest = json.loads((room / "manifest.json").read_text())
    manifest["cases"][0]["made_on_demand"] = True
    (room / "manifest.json").write_text(json.dumps(manifest))
    (room / "vectors" / "limits" / "one.hapf").unlink()
    code, text, outcome = run(room, adapter(tmp_path / "fake"))
    assert code == 0, text
    assert outcome["counts"]["all"] == {"cases": 2, "passed": 1, "not tested": 1}
    assert "not tested: 1 cases for want of the generator gen/make.py" in text


def test_known_failures_must_fail(room, tmp_path):
    known = tmp_path / "known.txt"
    known.write_text("# list\n\nvalid/one  counts are halved, issue 5\n")
    options = ("--known-failures", str(known))
    wrong = adapter(tmp_path / "wrong", raw={"a.raw": [1, 1, 1, 1]})
    code, text, told = run(room, wrong, *options)
    assert code == 0
    assert "known failure: valid/one: counts are halved, issue 5" in text
    assert told["counts"]["all"] == {"cases": 1, "known failure": 1}
    code, text, told = run(room, adapter(tmp_path / "right"), *options)
    assert code == 1
    assert "PASSES, ALTHOUGH LISTED AS FAILING valid/one" in text
    for line, fault in (("valid/two it fails", "no case is called"), ("valid/one", "say why")):
        known.write_text(line)
        code, text, told = run(room, wrong, *options)
        assert (code, told) == (2, None)
        assert fault in text


def test_an_unknown_set_is_told_the_known_ones():
    done = subprocess.run(
        [sys.executable, "-S", CONFORMANCE / "run.py", "--set", "nonsense"], capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("no set 'nonsense'; the sets are: valid, ")


def test_junit(tmp_path):
    expects = {"valid/one": EXPECT, "valid/two": EXPECT | {"verdict": "damaged"}, "invalid/three": EXPECT | {"exit": {"encode": 0}}}  # fmt: skip
    room, out = room_of(tmp_path / "cases", expects), tmp_path / "junit.xml"
    run(room, adapter(tmp_path / "fake"), "--junit", str(out))
    (suite,) = Xml.parse(out).getroot()
    assert {k: suite.get(k) for k in ("name", "tests", "failures", "skipped")} == {
        "name": "fake", "tests": "3", "failures": "1", "skipped": "1",
    }  # fmt: skip
    first, second, third = suite
    assert (first.get("classname"), first.get("name"), len(first)) == ("fake.valid", "one", 0)
    assert "verdict: expected damaged, found intact" in second[0].text
    assert third[0].get("message") == "for want of verb encode"


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["./no-such-program"], "No such file"),
        ([sys.executable, "-c", "print(1)"], "no JSON object"),
        ([sys.executable, "-c", "raise SystemExit('not-today')"], "exit code 1, no JSON object: not-today"),
    ],
)  # fmt: skip
def test_what_is_no_adapter(room, command, said):
    code, text, told = run(room, command)
    assert (code, told) == (2, None)
    assert said in text


def test_capabilities_that_are_not_as_they_should_be(room, tmp_path):
    code, text, _ = run(room, adapter(tmp_path / "fake", capabilities=CAPABILITIES | {"level": 3}))
    assert code == 2
    assert "capabilities.level: expected one of [1, 2], found 3" in text


def test_a_case_that_nobody_has(room, tmp_path):
    assert run(room, adapter(tmp_path / "fake"), "--case", "x*")[0] == 2


def test_selection():
    cases = load()
    assert {case.set for case in select(cases, ["valid"], [])} <= {"valid"}
    one = cases[0]
    assert one in select(cases, [], [one.name]) and one in select(cases, [], [one.id])


def own(*options: str, impl: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(CONFORMANCE / "run.py"), "--impl", impl, *options],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


def all_passed(name: str, folder: Path, *options: str) -> dict:
    """The outcome of a run of one of our implementations; what it tested must have passed."""
    if shutil.which(PROGRAMS[name][0]) is None:
        pytest.skip(f"no {PROGRAMS[name][0]} here")
    out = folder / "out.json"
    done = own("--json", str(out), "--jobs", "2", "--timeout", "200", *options, impl=shlex.join(PROGRAMS[name]))  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(out.read_text())["runs"][0]


@either("every", 40, deep=1)
def test_hapfmt_passes_the_valid_cases(tmp_path, every):
    names = [case.name for case in select(load(), ["valid"], [])][::every]
    options = [option for name in names for option in ("--case", name)]
    told = all_passed("hapfmt", tmp_path, "--set", "valid", *options)
    count = len(names)
    assert told["counts"]["all"] == {"cases": count, "passed": count}


@pytest.mark.skipif(
    PROFILE != "nightly",
    reason="takes minutes: a step of its own in .ci/run, and in the profile nightly",
)
@pytest.mark.parametrize("name", PROGRAMS)
def test_our_implementations_pass_every_case(name, tmp_path):
    told = all_passed(name, tmp_path)
    left_out = {case["set"] for case in told["cases"] if case["status"] == "not tested"}
    if name == "hapfmt":
        assert not left_out
        assert told["requirements_not_exercised"] == []
    else:
        assert left_out <= {"encode"}


def test_hapfmt_loads_no_more_than_it_needs(tmp_path):
    code = (
        f"import sys; sys.path.insert(0, {str(CONFORMANCE / 'adapters' / 'python')!r})\n"
        "from hapfmt_adapter.verbs import run\n"
        f"assert run(['decode', {str(CONFORMANCE / 'examples' / 'hold.hapf')!r}, {str(tmp_path)!r}]) == 0\n"
        "print(*{'click', 'rich', 'scipy', 'hapfmt.encoder'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)  # fmt: skip
    assert done.stdout.split() == []


def compiled(folder: Path, source: str) -> Path:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler here")
    path, program = folder / "knot.c", folder / "knot"
    path.write_text(source)
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run([compiler, *flags, "-o", str(program), str(path)], check=True)
    return program


def test_the_adapter_in_c_passes_its_profile_and_a_wrong_one_does_not(tmp_path):
    source = (CONFORMANCE / "adapters" / "c" / "knot.c").read_text(encoding="utf-8")
    outcome = ("--set", "valid", "--json", str(tmp_path / "c.json"))
    done = own(*outcome, impl=str(compiled(tmp_path, source)))
    assert done.returncode == 0, done.stdout
    counts = json.loads((tmp_path / "c.json").read_text())["runs"][0]["counts"]["all"]
    assert counts["passed"] >= 20
    truncating = source.replace("quotient - (top % bottom < 0)", "quotient")
    assert truncating != source
    done = own("--case", "knot-linear-rounding", impl=str(compiled(tmp_path, truncating)))
    assert done.returncode == 1
    assert "FAILED valid/" in done.stdout


def test_run_imports_nothing_from_hapfmt():
    for path in [CONFORMANCE / "run.py", *(CONFORMANCE / "runner").glob("*.py")]:
        text = path.read_text(encoding="utf-8")
        assert "import hapfmt" not in text and "from hapfmt" not in text
        assert len(text.splitlines()) <= 400
