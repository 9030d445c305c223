"""TOML -> Profile: what is taken, what is refused and with which words, and the JSON Schema."""

from __future__ import annotations

import json
import re
import tomllib
from copy import deepcopy
from fractions import Fraction
from importlib import resources
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from spec import ROOT

from hapfmt.errors import ParameterError
from hapfmt.replay.profile.model import Actuator, CountLimits, Frame, Match, Profile, Timing
from hapfmt.replay.profile.packing import Packer
from hapfmt.replay.profile.parse import (
    builtin_names,
    check,
    load_profile,
    parse_profile,
    profile_of,
)

PACKAGE = resources.files("hapfmt.replay.profile")
SCHEMA = json.loads((PACKAGE / "schema.json").read_text(encoding="utf-8"))
VALID = Draft202012Validator(SCHEMA)
BUILTIN = builtin_names()
DOCS = (ROOT / "docs" / "profiles.md").read_text(encoding="utf-8")
EXAMPLE = DOCS.split("```toml\n")[1].split("```")[0]

GOOD = """
name = "own"
[[match]]
vendor_id = 1
[timing]
rate = 1000
[[actuator]]
name = "a"
unit = "N"
minimum = -1
maximum = 1
rest = 0
slew = 10
step = 0.01
[[actuator]]
name = "b"
unit = "1"
minimum = 0
maximum = 1
rest = 0
slew = 10
step = 0.01
[[report]]
path = "output"
id = 1
length = 12
fields = [
    { at = 1, counter = "u8" },
    { at = 2, actuator = "a", type = "i8" },
    { at = 3, actuator = "b", type = "u8" },
    { at = 4, map = "hd-rumble", actuators = ["b", "b"] },
    { at = 8, crc32 = { seed = 1 } },
]
[[init]]
path = "feature"
data = "02 03"
"""
BOTH, RULE = True, False
"""Whether the schema refuses it too, or it takes several values at once."""


def values() -> dict[str, Any]:
    return tomllib.loads(GOOD)


def put(path: str, value: Any) -> dict[str, Any]:
    """The good profile with one value changed, added, or (``...``) removed."""
    changed = values()
    *way, last = [int(key) if key.isdigit() else key for key in re.findall(r"\w+", path)]
    at: Any = changed
    for key in way:
        at = at[key]
    if value is ...:
        del at[last]
    elif isinstance(at, list) and last == len(at):
        at.append(value)
    else:
        at[last] = value
    return changed


def refusal(changed: dict[str, Any]) -> str:
    with pytest.raises(ParameterError) as caught:
        profile_of(changed, "")
    return str(caught.value)


def test_the_good_profile_is_good():
    assert VALID.is_valid(values())
    assert profile_of(values(), "").name == "own"


F = "report[0].fields"
BAD: list[tuple[str, Any, str, bool]] = [
    # path, value, what the error says after the path, whether the schema refuses it
    ("name", ..., "is missing; add a name of letters, digits, '-', '_' and '.', a letter", BOTH),
    ("name", 3, "is a number; write a text such as 'left-hand', between quotes", BOTH),
    ("name", "two words", "'two words' cannot be used; write a text such as 'left-hand': a", BOTH),
    ("name", "1", "cannot be used", BOTH),
    ("nmae", "x", "is not a known key; did you mean name?", BOTH),
    ("xyz", "x", "is not a known key; known: name", BOTH),
    ("source", "x" * 4001, "has 4001 characters", BOTH),
    ("gain", 0, "0 is out of range; write a number above 0 and at most 1", BOTH),
    ("gain", 1.5, "1.5 is out of range", BOTH),
    ("gain", float("nan"), "nan is out of range; write a number above 0 and at most 1", RULE),
    ("gain", "1", "is a text; write a number above 0 and at most 1, without quotes", BOTH),
    ("gain", True, "is true; write a number above 0 and at most 1", BOTH),
    ("match", {}, "is a table of keys and values; write a list of 0 to 64", BOTH),
    ("match[0].vendor_id", ..., "is missing; add a whole number from 0 to 65535", BOTH),
    ("match[0].vendor_id", 65536, "65536 is out of range; write a whole number from 0 to", BOTH),
    ("match[0].product_id", "0x1", "is a text; write a whole number from 0 to 65535,", BOTH),
    ("match[0].bus", "serial", "there is no 'serial'; choose one of bluetooth, usb", BOTH),
    ("match[0].vid", 1, "is not a known key", BOTH),
    ("timing", ..., "is missing; add [timing]", BOTH),
    ("timing", [], "is a list; write a table", BOTH),
    ("timing.rate", ..., "is missing; add the samples", BOTH),
    ("timing.rate", 0, "0 is out of range; write a number from 1 to 1000000 or a text such", BOTH),
    ("timing.rate", 1e8, "100000000.0 is out of range; write a number from 1 to 1000000 or", BOTH),
    ("timing.rate", "1000", "'1000' cannot be used; write a number from 1 to 1000000 or a", BOTH),
    ("timing.rate", "1/0", "'1/0' cannot be used; write a number from 1 to 1000000 or a", BOTH),
    ("timing.rate", "1/999", "0.001001 Hz is out of range", RULE),
    ("timing.rate", 10**400, "the number is out of range", BOTH),
    ("timing.rate", 0.5, "0.5 is out of range; write a number from 1 to 1000000 or a text", BOTH),
    ("timing.frame_samples", 0, "0 is out of range", BOTH),
    ("timing.frame_samples", 1.0, "1.0 cannot be used; write a whole number from 1 to 4096", RULE),
    ("timing.hold_ms", 0, "0 is out of range; write a number above 0 and at most 1000", BOTH),
    ("timing.ramp_ms", -1, "-1 is out of range; write a number above 0 and at most 10000", BOTH),
    ("timing.neutral_count", 0, "0 is out of range; write a whole number from 1 to 100", BOTH),
    ("timing.device_timeout_ms", 1, "the device would rest between two frames, 1 ms apart", RULE),
    ("actuator", ..., "is missing; add [[actuator]] for each one (a list of 1 to 256", BOTH),
    ("actuator", [], "has 0 values; write a list of 1 to 256 tables", BOTH),
    ("actuator", [3], "is a number; write a table", BOTH),
    ("actuator[1].name", "a", "'a' is taken; give each its own", RULE),
    ("actuator[0].name", "a,b", "cannot be used", BOTH),
    ("actuator[0].unit", "newton", "is not a UCUM code; write 'N'", RULE),
    ("actuator[0].unit", "", "is not a UCUM code; write '1'", BOTH),
    ("actuator[0].minimum", ..., "is missing; add the lowest value", BOTH),
    ("actuator[0].maximum", ..., "is missing; add the highest value", BOTH),
    ("actuator[0].rest", ..., "is missing; add the value at rest", BOTH),
    ("actuator[0].slew", ..., "is missing; add the largest change per second", BOTH),
    ("actuator[0].step", ..., "is missing; add the value of one count", BOTH),
    ("actuator[0].maximum", -1, "must be above minimum, -1", RULE),
    ("actuator[0].maximum", float("inf"), "inf is out of range; write a number from", BOTH),
    ("actuator[0].minimum", float("nan"), "nan is out of range; write a number from", RULE),
    ("actuator[0].rest", 1.5, "must lie within minimum and maximum, -1 to 1", RULE),
    ("actuator[0].slew", 9.99, "gives less than one count per sample", RULE),
    ("actuator[0].slew", 0, "0 is out of range; write a number above 0 and at most 1e+12", BOTH),
    ("actuator[0].step", 0, "is out of range", BOTH),
    ("actuator[0].accepts", {}, "is empty, so nothing could be played", BOTH),
    ("actuator[0].accepts", {"N": 0}, "is 0; write its value", BOTH),
    ("actuator[0].accepts", {"newtons": 1}, "is not a UCUM code; write 'N'", RULE),
    ("actuator[0].accepts", {"N": "1"}, "is a text; write a number from -1000000000 to", BOTH),
    ("actuator[0].band", "low", "there is no 'low'; choose one of full, hf, lf", BOTH),
    ("actuator[0].rectify", 1, "is a number; write true or false", BOTH),
    ("actuator[0].max", 1, "is not a known key; did you mean maximum?", BOTH),
    ("report", ..., "is missing; add [[report]] for each one of a frame (a list of 1 to 16", BOTH),
    ("report[0].path", "input", "there is no 'input'; choose one of feature, output", BOTH),
    ("report[0].id", 256, "256 is out of range", BOTH),
    ("report[0].length", 1, "1 is out of range", BOTH),
    ("report[0].length", 11, "ends at byte 12, the report at 11", RULE),
    ("report[0].short", "yes", "is a text; write true or false, without quotes", BOTH),
    (F, [], "has 0 values; write a list of 1 to 1024 tables", BOTH),
    (f"{F}[1]", {"at": 2}, "has none of const, counter", BOTH),
    (f"{F}[1].counter", "u8", "has counter and actuator of const", BOTH),
    (f"{F}[1].at", 0, "0 is out of range", BOTH),
    (f"{F}[1].at", 1, "byte 1 belongs to fields[0] already; move one of them", RULE),
    (f"{F}[1].at", ..., "is missing; add the byte where it begins; byte 0 is the report id", BOTH),
    (f"{F}[1].actuator", "c", "there is no actuator 'c'; use one of a, b", RULE),
    (f"{F}[1].type", "u8", "u8 holds 0 to 255, but 'a' has counts from -100 to 100", RULE),
    (f"{F}[1].type", "f32", "there is no 'f32'; did you mean 'u32'?", BOTH),
    (f"{F}[1].typ", "i8", "is not a known key; did you mean type?", BOTH),
    (f"{F}[0].mask", 256, "256 is out of range", RULE),
    (f"{F}[0].shift", 1, "moves bits of the mask out of u8", RULE),
    (f"{F}[0].counter", "i8", "there is no 'i8'; did you mean 'u8'?", BOTH),
    (f"{F}[3].map", "other", "there is no 'other'; choose one of hd-rumble", BOTH),
    (f"{F}[3].actuators", ["b"], "hd-rumble takes 2: amplitude of the high band, then", RULE),
    (f"{F}[3].actuators", ["b", 1], "is a number; write a text, between quotes", BOTH),
    (f"{F}[3].actuators", ["a", "b"], "hd-rumble takes 0 to 1; lower the limits of 'a'", RULE),
    (f"{F}[3].low_hz", 40, "40 is out of range", BOTH),
    (f"{F}[4].crc32", {"to": 9}, "covers the CRC itself, at 8", RULE),
    (f"{F}[4].crc32", {"from": 5, "to": 5}, "must be above from, 5", RULE),
    (f"{F}[4].crc32", {"seed": -1}, "-1 is out of range", BOTH),
    (f"{F}[4].crc32", {"sed": 1}, "is not a known key; did you mean seed?", BOTH),
    (f"{F}[4].crc32", 3, "is a number; write a table", BOTH),
    (f"{F}[5]", {"at": 12, "const": []}, "has 0 values; write a list of 1 to 4096 values,", BOTH),
    (f"{F}[5]", {"at": 12, "const": [256]}, "256 is out of range", BOTH),
    (f"{F}[5]", {"at": 12, "const": [1]}, "ends at byte 13", RULE),
    ("init[0].data", "1", "'1' cannot be used; write a text such as '01 00 FF': the report", BOTH),
    ("init[0].data", "01", "'01' cannot be used; write a text such as '01 00 FF': the", BOTH),
    ("init[0].data", 12, "is a number; write a text such as '01 00 FF', between quotes", BOTH),
    ("init[0].path", ..., "is missing; add one of feature, output", BOTH),
    ("init[0]", {"path": "output", "data": "01 02"}, "has 2 bytes, but report 1 has 12", RULE),
    ("exit", [{"path": "output", "data": "01 00 05" + "00" * 9}], "moves a from rest", RULE),
]


@pytest.mark.parametrize(("path", "value", "text", "schema"), BAD, ids=lambda x: str(x)[:40])
def test_bad_profiles(path, value, text, schema):
    """The error names the key path and says what to do; the schema agrees where a single value
    is at fault."""
    changed = put(path, value)
    said = refusal(changed)
    key = said.split(": ")[0]
    assert key.startswith(path) or path.startswith(key) or (path, key) in ELSEWHERE
    assert text in said
    assert VALID.is_valid(changed) is not schema


ELSEWHERE = {
    ("report[0].length", f"{F}[4]"),
    (f"{F}[0].mask", f"{F}[0].shift"),
    (f"{F}[3].actuators", f"{F}[3].map"),
    (f"{F}[1].actuator", f"{F}[1]"),
}
"""Changed there, refused here: two values are at odds."""
ALTERNATIVES: list[tuple[str, Any]] = [
    ("match", ...),
    ("match[0].usage_page", 0xFF00),
    ("timing.rate", "3000/32"),
    ("timing.rate", 0.5e3),
    ("timing.device_timeout_ms", 1.01),
    ("actuator[0].accepts", {"N": 1, "kN": -1000, "[lbf_av]": 4.448222}),
    ("actuator[0].rest", -1),
    ("actuator[0].rectify", True),
    ("actuator[0].band", "hf"),
    ("actuator[0].slew", 1e9),
    ("report[0].path", "feature"),
    ("report[0].length", 64),
    ("report[0].short", True),
    (f"{F}[0].shared", "x"),
    (f"{F}[0].start", 255),
    (f"{F}[4].crc32", {"from": 1, "to": 8}),
    ("init", ...),
    ("init[0].data", " 0102\n ff FF"),
    ("neutral", [{"path": "output", "data": "02 FF"}]),
    ("exit", [{"path": "output", "data": "01" + "00" * 11}]),
]


@pytest.mark.parametrize(("path", "value"), ALTERNATIVES, ids=lambda x: str(x)[:40])
def test_good_profiles(path, value):
    changed = put(path, value)
    if path == "exit":  # the map at rest is not zero
        changed["report"][0]["fields"].pop(3)
    assert isinstance(profile_of(changed, ""), Profile)
    assert VALID.is_valid(changed)


@pytest.mark.parametrize("key", ["minimum", "maximum", "rest", "slew", "rate"])
def test_limits_are_required(key):
    """PLY-001: A player MUST refuse to play without limits: for each actuator the lowest, highest and resting value and the largest change per second; for the device the rate of its frames."""
    changed = put("timing.rate" if key == "rate" else f"actuator[1].{key}", ...)
    said = refusal(changed)
    assert re.match(rf"(timing|actuator\[1\])\.{key}: is missing; add .*\[PLY-001\]$", said)


@pytest.mark.parametrize("key", ["minimum", "maximum", "rest", "slew", "step"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_limits_of_profiles_made_in_code(key, value):
    """PLY-001: A player MUST refuse to play without limits: for each actuator the lowest, highest and resting value and the largest change per second; for the device the rate of its frames."""
    limits = {"minimum": 0.0, "maximum": 1.0, "rest": 0.0, "slew": 100.0, "step": 0.1, key: value}
    one = Profile("x", "", "", (), Timing(Fraction(1)), (Actuator("a", "N", **limits),))
    with pytest.raises(ParameterError, match=rf"^actuator\[0\]\.{key}: .*PLY-001"):
        check(one)


@pytest.mark.parametrize(
    ("timing", "gain", "key"),
    [
        ({}, 0.0, "gain"),
        ({}, float("nan"), "gain"),
        ({"hold_s": float("inf")}, 1.0, "timing"),
        ({"ramp_s": 0.0}, 1.0, "timing"),
        ({"neutral_count": 0}, 1.0, "timing"),
        ({"frame_samples": 0}, 1.0, "timing"),
    ],
)
def test_timing_and_gain_of_profiles_made_in_code(timing, gain, key):
    actuator = Actuator("a", "N", 0, 1, 100, 0.1)
    one = Profile("x", "", "", (), Timing(Fraction(10), **timing), (actuator,), gain=gain)
    with pytest.raises(ParameterError, match=f"^{key}: "):
        check(one)


def test_a_profile_without_actuators():
    with pytest.raises(ParameterError, match="PLY-001"):
        check(Profile("x", "", "", (), Timing(Fraction(1)), ()))
    with pytest.raises(ParameterError, match=r"timing\.rate.*PLY-001"):
        check(Profile("x", "", "", (), Timing(Fraction(0)), ()))


def test_an_actuator_that_no_report_sends():
    changed = put(f"{F}[1]", {"at": 2, "const": [0]})
    assert refusal(changed) == "actuator[0]: 'a' is in no report; add a field, or remove it"


def test_a_rest_that_counts_miss():
    changed = put("actuator[0].step", 0.9)
    changed["actuator"][0] |= {"rest": 1, "minimum": 0.95, "slew": 1000}
    assert "actuator[0].rest: the nearest count, 1, lies outside" in refusal(changed)


def test_frames_of_several_samples_need_samples():
    changed = put("timing.frame_samples", 2)
    assert f"{F}[1]: holds one of the 2 samples of a frame; use samples" in refusal(changed)


def test_a_frame_comes_at_least_once_a_second():
    changed = put("timing", {"rate": 10, "frame_samples": 11})
    assert "timing.rate: makes a frame each 1.1 s" in refusal(changed)


def test_a_sum_over_a_later_sum():
    changed = put(f"{F}[5]", {"at": 12, "crc32": {}})
    changed["report"][0]["length"] = 16
    assert profile_of(changed, "")
    changed["report"][0]["fields"][4:] = reversed(changed["report"][0]["fields"][4:])
    assert "covers a CRC that comes later in fields" in refusal(changed)


def test_maps_take_so_many_counts():
    changed = put("actuator[1].step", 1e-6)
    changed["report"][0]["fields"][2] = {"at": 3, "const": [0]}
    assert "takes at most 65536 counts of an actuator" in refusal(changed)


class TestText:
    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("name = ", "Invalid TOML: Invalid value"),
            ("a = " + "[" * 5000, "Invalid TOML"),
            ("a = " + "9" * 5000, "Invalid TOML"),
            ("", "name: is missing"),
        ],
    )
    def test_that_is_no_profile(self, text, said):
        with pytest.raises(ParameterError) as caught:
            parse_profile(text, "my.toml")
        assert str(caught.value).startswith(f"my.toml: {said}")

    @given(st.text())
    def test_any(self, text):
        with pytest.raises(ParameterError):
            parse_profile(text)

    @given(st.data())
    def test_any_cut_or_change(self, data):
        text = data.draw(st.sampled_from([GOOD, EXAMPLE]))
        start = data.draw(st.integers(0, len(text)))
        stop = data.draw(st.integers(start, min(start + 40, len(text))))
        changed = text[:start] + data.draw(st.text("01[]{}=\"'.#-e\nab", max_size=4)) + text[stop:]
        try:
            one = parse_profile(changed)
        except ParameterError:
            return
        assert VALID.is_valid(tomllib.loads(changed))
        assert Packer(one).neutral()


ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
    | st.sampled_from(["u8", "a", "b", 1, 2, 3, 0.5, "output", "N", [], {}]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=4,
)  # fmt: skip


def places(at: Any, way: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Of every value in a tree."""
    keys = at if isinstance(at, dict) else range(len(at)) if isinstance(at, list) else ()
    return [place for key in keys for place in ((*way, key), *places(at[key], (*way, key)))]


@given(st.sampled_from(sorted(BUILTIN)), st.data())
def test_the_parser_takes_nothing_that_the_schema_refuses(name, data):
    """Whatever stands in whatever place: an error of ours, or a profile that can be packed."""
    changed = tomllib.loads((PACKAGE / "builtin" / f"{name}.toml").read_text(encoding="utf-8"))
    *way, last = data.draw(st.sampled_from(places(changed)))
    at: Any = changed
    for key in way:
        at = at[key]
    at[last] = data.draw(ANY)
    if data.draw(st.booleans()) and isinstance(at, dict):
        at[data.draw(st.sampled_from(["short", "type", "xyz", "gain"]))] = data.draw(ANY)
    try:
        one = profile_of(deepcopy(changed), "")
    except ParameterError as error:
        assert error.message
        return
    assert VALID.is_valid(changed)
    rest = tuple(limits.rest for limits in one.count_limits)
    assert Packer(one).pack(Frame(0, 0, (rest,) * one.timing.frame_samples))


class TestLimits:
    """In counts, rounded inwards, as the decimals that were written."""

    @pytest.mark.parametrize(
        ("numbers", "wanted"),
        [
            ((0.0, 0.3, 0.0, 100.0, 0.1), CountLimits(0, 3, 0, 1)),
            ((-1.0, 1.0, 0.05, 250.0, 0.1), CountLimits(-10, 10, 1, 2)),
            ((-0.35, 0.35, -0.05, 199.0, 0.1), CountLimits(-3, 3, 0, 1)),
            ((0.0, 1.0, 0.0, 1000.0, 0.00392156862745098), CountLimits(0, 255, 0, 255)),
        ],
    )
    def test_counts(self, numbers, wanted):
        actuator = Actuator("a", "1", numbers[0], numbers[1], numbers[3], numbers[4], numbers[2])
        one = Profile("x", "", "", (), Timing(Fraction(1000)), (actuator,))
        assert one.limits(actuator) == wanted
        assert one.count_limits == (wanted,)

    @given(st.data())
    def test_no_count_passes_a_limit(self, data):
        number = st.decimals(-100, 100, places=3).map(float)
        low, high = sorted(data.draw(st.tuples(number, number)))
        step = data.draw(st.decimals("0.001", 10, places=3).map(float))
        actuator = Actuator("a", "1", low, high, 1e6, step, low)
        limits = Profile("x", "", "", (), Timing(Fraction(1)), (actuator,)).limits(actuator)
        exact = [Fraction(str(x)) for x in (low, high, step)]
        assert exact[0] <= limits.low * exact[2] < exact[0] + exact[2]
        assert exact[1] - exact[2] < limits.high * exact[2] <= exact[1]


class TestBuiltin:
    def test_names(self):
        assert {"glove5", "dualsense-usb", "dualsense-bluetooth", "joycon-left"} < set(BUILTIN)
        assert list(BUILTIN) == sorted(BUILTIN)

    @pytest.mark.parametrize("name", BUILTIN)
    def test_is_whole(self, name):
        """It fits the schema, says where it comes from, and moves all from rest to limit in time."""
        one = load_profile(name)
        assert VALID.is_valid(tomllib.loads(one.text))
        assert one.name == name and one.description and len(one.source) > 100
        assert one.gain <= 0.5 and one.matches and one.timing.neutral_count >= 5
        assert parse_profile(one.text) == one
        for actuator, limits in zip(one.actuators, one.count_limits, strict=True):
            assert actuator.body_site and actuator.quantity and actuator.accepts
            assert (limits.high - limits.rest) / limits.change * one.timing.period <= Fraction(
                2, 10
            )
            assert limits.change < limits.high - limits.low

    def test_no_two_fit_the_same_device_but_for_dualsense(self):
        seen: dict[Match, str] = {}
        twice = set()
        for name in BUILTIN:
            for match in load_profile(name).matches:
                twice |= {(seen[match], name)} if match in seen else set()
                seen[match] = name
        assert twice == {("dualsense-bluetooth", "dualsense-bluetooth-haptics")}

    def test_each_stands_in_the_page(self):
        table = DOCS.split("## Built-in profiles")[1]
        assert [name for name in BUILTIN if f"`{name}`" not in table] == []


class TestLoad:
    def test_a_file(self, tmp_path):
        path = tmp_path / "own.toml"
        path.write_text(GOOD, encoding="utf-8")
        assert load_profile(str(path)).text == GOOD

    def test_errors_name_the_file(self, tmp_path):
        path = tmp_path / "own.toml"
        path.write_text("name = 3", encoding="utf-8")
        with pytest.raises(ParameterError, match=f"^{re.escape(str(path))}: name: is a number"):
            load_profile(str(path))

    def test_no_such(self):
        with pytest.raises(ParameterError, match=r"no file and no profile .*glove5"):
            load_profile("glove6")

    @pytest.mark.parametrize(
        ("data", "said"), [(b"\xff", "not UTF-8"), (b"#" * (1 << 20) + b"\n", "more than 1 MiB")]
    )
    def test_no_text(self, tmp_path, data, said):
        path = tmp_path / "own.toml"
        path.write_bytes(data)
        with pytest.raises(ParameterError, match=said):
            load_profile(str(path))


class TestPage:
    """docs/profiles.md"""

    def test_the_example(self):
        one = parse_profile(EXAMPLE)
        packer = Packer(one)
        frames = [packer.pack(Frame(0, 0, (counts,)))[0].data for counts in ((0, 0), (1000, -1000))]
        for data in frames:
            assert f"`{data.hex(' ').upper()}`" in DOCS
        assert VALID.is_valid(tomllib.loads(EXAMPLE))

    def test_every_key(self):
        """As a word between backticks."""
        told = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`\n]+)`", DOCS))))
        keys = {key for each in SCHEMA["$defs"].values() for key in each["properties"]}
        assert keys - told == set()


def test_the_schema_is_one():
    Draft202012Validator.check_schema(SCHEMA)
