"""Descriptions of scenes: whatever is wrong is named by its key, with what to do about it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

from hapfmt.descriptions import DescriptionError, read
from hapfmt.errors import ParameterError
from hapfmt.lab.scenes import Scene, builtin_names, load_scene, parse_scene, scene_text
from hapfmt.lab.scenes.description import (
    CHANNELS,
    FINGERS,
    PARTS,
    Contact,
    Hand,
    Press,
    Reach,
    Sensor,
    Stroke,
    Texture,
    Tool,
)
from hapfmt.structs import keys_of, schema_of

TOOL = "[tool]\n[tool.stroke]\n"
HUGE = "9" * 5000

WRONG = [
    ("", "a scene of nothing; add [tool] or [hand]"),
    ("seconds = 1", "a scene of nothing; add [tool] or [hand]"),
    ("[", "Invalid TOML: "),
    ("x = " + "[" * 5000, "Invalid TOML: "),
    ("a = 1\na = 2\n" + TOOL, "Invalid TOML: "),
    ("secnds = 1\n" + TOOL, "secnds: is not a known key; did you mean seconds?"),
    ("q = 1\n" + TOOL, "q: is not a known key; known: name, description, seconds, seed,"),
    ("tool = 3", "tool: is a number; write a table"),
    ("[tool]", "tool: has none of stroke, press, reach; give one of them"),
    (TOOL + "[tool.reach]", "tool: has stroke and reach of stroke, press, reach; give one"),
    (
        "[tool.press]",
        "tool.press.press_n: is missing; add force of the hand in N (a number above 0 and at most 100)",
    ),
    (
        "seconds = '4'\n" + TOOL,
        "seconds: is a text; write a number above 0 and at most 36000, without quotes",
    ),
    ("seconds = true\n" + TOOL, "seconds: is true; write a number above 0 and at most 36000"),
    (
        "seconds = 0\n" + TOOL,
        "seconds: 0 is out of range; write a number above 0 and at most 36000",
    ),
    (
        "seconds = nan\n" + TOOL,
        "seconds: nan is out of range; write a number above 0 and at most 36000",
    ),
    (
        "seconds = inf\n" + TOOL,
        "seconds: inf is out of range; write a number above 0 and at most 36000",
    ),
    (
        "seconds = 1e9\n" + TOOL,
        "seconds: 1000000000.0 is out of range; write a number above 0 and at most 36000",
    ),
    (f"seconds = {HUGE[:900]}\n" + TOOL, "seconds: the number is out of range"),
    (
        "seed = -1\n" + TOOL,
        "seed: -1 is out of range; write a whole number from 0 to 9223372036854775807",
    ),
    (
        "seed = 1.5\n" + TOOL,
        "seed: 1.5 cannot be used; write a whole number from 0 to 9223372036854775807",
    ),
    ("rate_hz = 0\n" + TOOL, "rate_hz: 0 is out of range; write a whole number from 1 to 1000000"),
    (
        "name = 3\n" + TOOL,
        "name: is a number; write a text of at most 100 characters, between quotes",
    ),
    (
        f"name = '{'n' * 101}'\n" + TOOL,
        "name: has 101 characters; write a text of at most 100 characters",
    ),
    (
        TOOL + "speed_m_per_s = 3",
        "tool.stroke.speed_m_per_s: is a number; write a list of 2 values, each a number from 0.001 to 1",
    ),
    (
        TOOL + "speed_m_per_s = [1]",
        "tool.stroke.speed_m_per_s: has 1 value; write a list of 2 values, each a number from 0.001 to 1",
    ),
    (TOOL + "speed_m_per_s = [0, 1]", "tool.stroke.speed_m_per_s[0]: 0 is out of range"),
    (TOOL + "speed_m_per_s = [0.2, 0.1]", "tool.stroke.speed_m_per_s: begins with the larger"),
    (
        TOOL + "[tool.contact]",
        "tool.contact.n_per_m: is missing; add stiffness in N/m (a number above 0 and at most 10000000)",
    ),
    (TOOL + "[tool.contact]\nn_per_m = 1e8", "tool.contact.n_per_m: 100000000.0 is out of range"),
    (
        TOOL + "[tool.contact]\nn_per_m = 0",
        "tool.contact.n_per_m: 0 is out of range; write a number above 0 and at most 10000000",
    ),
    (
        TOOL + "[tool.contact]\nn_per_m = 1\nintegrator = 'exakt'",
        "tool.contact.integrator: there is no 'exakt'; did you mean 'exact'?",
    ),
    (
        TOOL + "[tool.contact]\nn_per_m = 1\nintegrator = 'x'",
        "tool.contact.integrator: there is no 'x'; choose one of exact, explicit-euler, implicit, rk4, s",
    ),
    (TOOL + "[tool.contact]\nn_per_m = 1\ndt_s = 0.01", "tool.contact.dt_s: is longer than a tick"),
    (
        TOOL + "[tool.contact]\nn_per_m = 1\ndt_s = 0",
        "tool.contact.dt_s: 0 is out of range; write a number from 1e-07 to 1",
    ),
    (TOOL + "[tool.texture]\nsurface = 'sand'", "tool.texture: is not felt without [tool.contact]"),
    (
        "[tool.press]\npress_n = 1\n[tool.contact]\nn_per_m = 1\n[tool.texture]\nsurface = 'sand'",
        "tool.texture: is not felt without [tool.stroke]; add it",
    ),
    (
        TOOL + "[tool.texture]",
        "tool.texture.surface: is missing; add name of the surface (one of cork, sand, stone)",
    ),
    (
        TOOL + "[tool.texture]\nsurface = 'velvet'",
        "tool.texture.surface: there is no 'velvet'; choose one of cork, sand, stone",
    ),
    (TOOL + "[tool.sensor]", "tool.sensor: has no force to read; add [tool.contact]"),
    ("[tool.reach]\n[tool.contact]\nn_per_m = 1", "tool.contact: is never met by reach; take one"),
    (
        "[tool]\nchannels = ['normal force']\n[tool.stroke]",
        "tool.channels: 'normal force' needs [tool.contact]; add it",
    ),
    (
        "[tool]\nchannels = ['position x']\n[tool.press]\npress_n = 1",
        "tool.channels: 'position x': a press moves along z alone; leave it out",
    ),
    (
        "[tool]\nchannels = []\n[tool.stroke]",
        "tool.channels: has 0 values; write a list of 1 or more values, each one of normal force, positi",
    ),
    (
        "[tool]\nchannels = [3]\n[tool.stroke]",
        "tool.channels[0]: is a number; write one of normal force, position x, position y, position z, t",
    ),
    ("[tool]\nchannels = ['force']\n[tool.stroke]", "tool.channels[0]: there is no 'force'; "),
    (
        "[tool]\nchannels = ['position x', 'position x']\n[tool.stroke]",
        "tool.channels[1]: 'position x' is there twice; write it once",
    ),
    ("[tool.press]\npress_n = 1\nevery_s = 1", "tool.press.every_s: is over before the hand is up"),
    (
        TOOL + "[tool.stroke.touches]\nevery_s = 0.2",
        "tool.stroke.touches.every_s: is too short; write at least 2 x travel_s + away_s",
    ),
    ("[tool.reach]\nevery_s = 0.1", "tool.reach.travel_s: is longer than every_s; write at most"),
    (
        TOOL + "[tool.contact]\nn_per_m = 1\n[tool.sensor]\nstep_n = 1\nrange_n = 0.5",
        "tool.sensor.range_n: takes less than 1 or more than 2^30 steps; mend step_n",
    ),
    (
        "[hand]\nfingers = ['toe']",
        "hand.fingers[0]: there is no 'toe'; choose one of index, little, middle, ring, thumb",
    ),
    (
        "[hand]\nfingers = []",
        "hand.fingers: has 0 values; write a list of 1 or more values, each one of index, little, middle",
    ),
    ("[hand]\nwrist = 1", "hand.wrist: is a number; write true or false"),
    ("[hand]\nevery_s = 1", "hand.every_s: is too short to close, hold and open"),
    (
        "[hand.object]\nwidth_m = 0.05",
        "hand.object.n_per_m: is missing; add stiffness in N/m (a number above 0 and at most 10000000)",
    ),
    ("[hand.object]\nn_per_m = 1\nwidth_m = 1", "hand.object.width_m: 1 is out of range"),
    (
        "[hand.tremor]\nhz = [8]",
        "hand.tremor.hz: has 1 value; write a list of 2 values, each a number from 0.1 to 50",
    ),
    ("[hand]\nmiddle = true", "hand.middle: is not a known key; "),
]


@pytest.mark.parametrize(("text", "message"), WRONG, ids=range(len(WRONG)))
def test_what_is_wrong_is_named(text, message):
    with pytest.raises(ParameterError) as caught:
        parse_scene(text, "mine.toml")
    assert str(caught.value).startswith("mine.toml: ") and message in str(caught.value)
    assert len(str(caught.value)) < 600


def test_no_two_are_told_alike():
    said = set()
    for text, _ in WRONG:
        with pytest.raises(ParameterError) as caught:
            parse_scene(text)
        said.add(caught.value.message)
    assert len(said) > len(WRONG) - 6


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                [*(f.name for t in (Scene, Tool, Hand, Contact) for f in keys_of(t).values()), "x"]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=5,
)


@given(
    st.dictionaries(st.sampled_from([f.name for f in keys_of(Scene).values()]), values, max_size=5)
)
def test_any_values_give_a_scene_or_an_error_of_ours(given):
    try:
        scene = read(Scene, given)
    except DescriptionError as error:
        assert error.message
    else:
        assert scene.tool or scene.hand


@given(st.text())
def test_any_text(text):
    try:
        parse_scene(text)
    except ParameterError as error:
        assert str(error)


class TestFiles:
    def test_names_that_are_none(self, tmp_path):
        with pytest.raises(ParameterError, match="there are: cork, everything"):
            load_scene("velvet")
        with pytest.raises(ParameterError, match="no file and no scene"):
            load_scene(str(tmp_path))

    def test_not_utf8_and_too_long(self, tmp_path):
        path = tmp_path / "a.toml"
        path.write_bytes(b"\xff\xfe")
        with pytest.raises(ParameterError, match="not UTF-8"):
            load_scene(str(path))
        path.write_bytes(b"#" * ((1 << 20) + 1))
        with pytest.raises(ParameterError, match="more than 1 MiB"):
            load_scene(str(path))

    @pytest.mark.parametrize("name", builtin_names())
    def test_built_in_ones_are_what_they_say(self, name, tmp_path):
        scene = load_scene(name)
        assert scene.name == name and 20 < len(scene.description) < 100
        path = tmp_path / "copy.toml"
        path.write_text(scene_text(name), encoding="utf-8")
        assert load_scene(str(path)) == scene


class TestInPython:
    def test_the_same_rules(self):
        for make, message in (
            (lambda: Tool(stroke=Stroke(), press=Press(1)), "give one of them"),
            (lambda: Tool(stroke="fast"), "stroke: is a text; write a table"),
            (lambda: Contact(-1.0), "n_per_m: -1.0 is out of range"),
            (lambda: Contact(1, integrator="euler"), "integrator: there is no 'euler'"),
            (Scene, "a scene of nothing"),
            (lambda: Texture("velvet"), "surface: there is no 'velvet'"),
            (lambda: Sensor(step_n=1e-6, range_n=1e4), "range_n: takes"),
            (lambda: Hand(fingers=()), "fingers: has 0 values"),
        ):
            with pytest.raises(DescriptionError) as caught:
                make()
            assert message in caught.value.message

    def test_whole_numbers_become_floats_and_lists_tuples(self):
        tool = Tool(channels=["position y", "position x"], reach=Reach(extent_m=1))
        assert tool.channels == ("position x", "position y")
        assert type(tool.reach.extent_m) is float

    def test_changed(self):
        scene = load_scene("grasp").changed(n_per_m=50, seed=7, seconds=None)
        assert scene.hand.object.n_per_m == 50 and scene.seed == 7 and scene.seconds == 4
        assert scene.hand.object.grip_n == 6
        with pytest.raises(
            DescriptionError, match="'free' touches nothing, so it has no such part"
        ):
            load_scene("free").changed(n_per_m=1e3)
        with pytest.raises(DescriptionError, match="seed: -1 is out of range"):
            load_scene("free").changed(seed=-1)

    @pytest.mark.parametrize("part", PARTS)
    def test_without(self, part):
        scene = load_scene("sand" if part == "touches" else "everything").without(part)
        text = repr(scene)
        if part == "contact":
            assert not scene.contacts and "Texture" not in text
            assert not [name for name in scene.tool.recorded if "force" in name]
        elif part in FINGERS:
            assert scene.hand.fingers == tuple(f for f in FINGERS if f != part)
        elif part in ("abduction", "palm", "wrist"):
            assert f"{part}=False" in text
        else:
            assert f"{part}=None" in text

    def test_all_of_it_taken_out(self):
        with pytest.raises(DescriptionError, match="a scene of nothing"):
            load_scene("everything").without("tool", "hand")
        with pytest.raises(DescriptionError, match="no part is called 'toe'; there are: texture"):
            load_scene("everything").without("toe")
        with pytest.raises(DescriptionError, match="fingers: has 0 values"):
            load_scene("grasp").without(*FINGERS)

    def test_recorded(self):
        assert Tool(press=Press(1)).recorded == ("position z", "velocity z")
        assert Tool(press=Press(1), contact=Contact(1)).recorded == ("normal force",)
        assert Tool(reach=Reach()).recorded == CHANNELS[3:]


def test_every_key_is_described():
    """docs/scenes.md has a row for each, with what belongs there."""
    page = (ROOT / "docs" / "scenes.md").read_text("utf-8")
    tables = schema_of(Scene, "Scene")["$defs"]
    assert len(tables) == 12
    for table, each in tables.items():
        for key, rule in each["properties"].items():
            told = rule.get("description") or rule["anyOf"][0]["description"]
            assert f"| `{key}` | {told}" in page, f"{table}.{key}"
