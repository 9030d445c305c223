"""What run.py compares, piece by piece; schemas of what adapters write."""

from __future__ import annotations

import json

import pytest
from case import numbers
from runner import compare as c
from runner import schema
from runner.manifest import load
from suite import CONFORMANCE

WORDS = [1 << 63, 3]


class TestCompare:
    def test_numbers(self):
        wanted = {"numbers": numbers(WORDS, words=True), "spans": [[7, 9]], "component_count": 1}
        data = {"w": b"".join(word.to_bytes(8, "little") for word in [WORDS[0], 2])}
        (found,) = c.compare("x", wanted, wanted | {"numbers": "w"}, data.__getitem__, [])
        assert found == c.Difference(
            "x.numbers, tick 8", "0x0000000000000003", "0x0000000000000002 (1 of 2 differ)"
        )

    def test_many_numbers_have_a_digest_alone(self):
        wanted = numbers(range(300))
        assert "numbers" not in wanted
        data = b"".join(i.to_bytes(8, "little") for i in range(300))
        for raw, wrong in ((data, 0), (data[8:] + data[:8], 1), (data[8:], 1)):
            found = list(c.compare_numbers("x", wanted, "r", {}, lambda _, raw=raw: raw))
            assert len(found) == wrong

    def test_place_with_components(self):
        owner = {"component_count": 3, "spans": [[0, 2], [5, 6]]}
        assert c.place_of(7, owner) == "tick 5 component 1"
        assert c.place_of(99, owner) == "number 99"

    def test_json_numbers_and_truth(self):
        assert c.same(1, 1.0) and not c.same(1, True) and not c.same(0, False)
        assert c.same([1, {"a": [None]}], [1, {"a": [None]}]) and not c.same([1], [1, 2])
        assert not c.same({"a": 1}, {"a": 1, "b": 2})

    def test_empty_bands_may_be_left_out(self):
        empty = {"channel": 1, "spans": [], "numbers": numbers([])}
        for wanted, found in (([empty], []), ([], [empty | {"numbers": "e"}])):
            assert not c.decode_differences({"hf": wanted}, {"hf": found}, c.no_raw, ["bands"])
        assert c.decode_differences({"hf": []}, {}, c.no_raw, ["bands"])

    def test_lost_spans_are_joined(self):
        damage = {"lost": [{"track": 0, "start": 5, "stop": 8}]}
        report = {"damages": [damage], "lost": [{"track": 0, "start": 0, "stop": 5}]}
        assert not list(c.lost_differences([[0, 0, 8]], report))
        assert list(c.lost_differences([[0, 0, 9]], report))
        assert list(c.lost_differences([[0, 0, None]], report))
        assert c.union([[1, 4, None], [1, 2, 4], [0, 1, 2]]) == [[0, 1, 2], [1, 2, None]]

    def test_a_rule_among_several(self):
        report = {"findings": [{"requirement": "KNT-003"}], "damages": [{"requirement": "FIL-003"}]}
        assert not list(c.requirement_differences(["CNV-001", "KNT-003"], report))
        assert not list(c.requirement_differences("FIL-003", report))
        (found,) = c.requirement_differences("KNT-002", report)
        assert str(found) == "requirement of a finding: expected KNT-002, found KNT-003, FIL-003"

    def test_one_of_several_exit_codes(self):
        assert not c.exit_differences([0, 2], 2)
        (found,) = c.exit_differences([0, 2], 3)
        assert (
            str(found) == "exit code: expected 0 (intact) or 2 (nonconforming), found 3 (damaged)"
        )


class TestSchemas:
    def test_the_manifest_keeps_its_schema(self):
        manifest = json.loads((CONFORMANCE / "manifest.json").read_text(encoding="utf-8"))
        assert schema.check(manifest, "manifest", "manifest") == []
        manifest["cases"][0]["fault"] = "bad luck"
        assert len(schema.check(manifest, "manifest", "manifest")) == 1

    def test_expectations_keep_theirs(self):
        """What stands there under a name that nobody knows would not be compared."""
        paths = sorted((CONFORMANCE / "expected").rglob("*.json"))
        assert len(paths) == len(load())
        for path in paths:
            expect = json.loads(path.read_text(encoding="utf-8"))
            assert schema.check(expect, "expected", path.stem) == []

    def test_jobs_keep_theirs(self):
        for path in (CONFORMANCE / "vectors").glob("encode/*/job.json"):
            job = json.loads(path.read_text(encoding="utf-8"))
            assert schema.check(job, "job", path.parent.name) == []

    @pytest.mark.parametrize(
        "name", ["capabilities", "decode", "verify", "job", "expected", "manifest"]
    )
    def test_each_uses_what_the_reader_of_schemas_knows(self, name):
        def look(rule):
            assert rule.keys() <= schema.KEYWORDS
            for key in ("properties", "$defs"):
                for inner in rule.get(key, {}).values():
                    look(inner)
            for inner in [*rule.get("anyOf", []), *rule.get("prefixItems", [])]:
                look(inner)
            for key in ("items", "additionalProperties"):
                if isinstance(rule.get(key), dict):
                    look(rule[key])

        look(schema.schema(name))

    @pytest.mark.parametrize(
        ("rule", "right", "wrong"),
        [
            ({"type": "integer"}, [0, 2.0], [True, 1.5, "1", None]),
            ({"type": "number", "minimum": 1, "maximum": 3}, [1, 3.0], [0.5, 4, "2"]),
            ({"type": "string", "pattern": "^a+$", "maxLength": 2}, ["a", "aa"], ["b", "aaa", 1]),
            ({"enum": [1, "x"]}, [1, "x"], [True, "y"]),
            ({"const": True}, [True], [1]),
            ({"anyOf": [{"type": "null"}, {"type": "string"}]}, [None, ""], [1]),
            ({"type": "array", "minItems": 1, "items": {"type": "null"}}, [[None]], [[], [1], {}]),
            ({"prefixItems": [{"type": "null"}]}, [[None, 1], []], [[1]]),
            ({"required": ["a"], "properties": {"a": {"type": "null"}}}, [{"a": None, "b": 1}], [{}, {"a": 1}]),
            ({"additionalProperties": False, "properties": {"a": {}}}, [{}, {"a": 1}], [{"b": 1}]),
        ],
    )  # fmt: skip
    def test_reader_of_schemas(self, rule, right, wrong):
        assert [list(schema.faults(value, rule, "", rule)) for value in right] == [[]] * len(right)
        assert all(list(schema.faults(value, rule, "", rule)) for value in wrong)
