"""Which channel drives which actuator: by words that name one alone, or as the user says."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rendering import file_of, profile_of
from spec import ROOT

from hapfmt import Calibration, Channel, Recording
from hapfmt.errors import ParameterError
from hapfmt.reading.reader import Reader
from hapfmt.replay.profile.parse import load_profile
from hapfmt.replay.render import Renderer, assign
from hapfmt.replay.render.assign import APART, NEUTRAL, words_of

FINGERS = profile_of(3, names=["thumb", "index", "middle"])
BUILTIN = [path.stem for path in (ROOT / "hapfmt/replay/profile/builtin").glob("*.toml")]
GLOVE5, GLOVE22 = load_profile("glove5"), load_profile("glove22")


def channel(label="", unit="N", **described):
    return Channel(
        np.zeros(3, np.int32), Fraction(1000), calibration=Calibration(1, 0, 1000),
        label=label, unit=unit, **described,
    )  # fmt: skip


def found_for(channels, profile, given_=(), **asked):
    """The assignment, and {channel: actuator} of it."""
    named = [each if isinstance(each, Channel) else channel(each) for each in channels]
    with Reader(file_of(Recording(tuple(named)))) as reader:
        found = assign(reader, profile, given_, **asked)
    return found, {r.channel: profile.actuators[r.actuator].name for r in found.routes}


def mapping(channels, profile, given_=(), **asked):
    return found_for(channels, profile, given_, **asked)[1]


def refused(channels, profile, given_=(), **asked):
    with pytest.raises(ParameterError) as error:
        found_for(channels, profile, given_, **asked)
    return str(error.value)


def with_sites(names, sites):
    profile = profile_of(len(names), names=names)
    actuators = tuple(
        replace(each, body_site=site) for each, site in zip(profile.actuators, sites, strict=True)
    )
    return replace(profile, actuators=actuators)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("thumb", ("thumb",)),
        ("Index Finger", ("index", "finger")),
        ("thumb-tip_force", ("thumb", "tip", "force")),
        ("thumbTipForce", ("thumb", "tip", "force")),
        ("IMUThumb", ("imu", "thumb")),
        ("Fx", ("fx",)),
        ("finger2", ("finger", "2")),
        ("STRASSE Straße", ("strasse", "strasse")),
        (" -=/ ", ()),
    ],
)
def test_words(text, words):
    assert words_of(text) == words


class TestWords:
    """
    PLY-012: A channel MUST NOT drive an actuator unless the user assigned it, or its label, body site or axis names that actuator. Then the channel names no other actuator, and no other played channel names this one. No text is taken for the name of an actuator if one of its words is not known. Words are known that are in the actuator's name or body site, those that name hands, fingers and axes, and a few neutral ones.
    """

    @pytest.mark.parametrize(
        ("channels", "profile", "expected"),
        [
            (["little", "thumb"], GLOVE5, {0: "little", 1: "thumb"}),
            (["THUMB", "index finger", "middleForce"], GLOVE5, {0: "thumb", 1: "index", 2: "middle"}),
            (["force on the ring finger"], GLOVE5, {0: "ring"}),
            (["thumb tip", "thumb-base"], GLOVE22, {0: "thumb-tip", 1: "thumb-base"}),
            (["middle-middle", "index-middle"], GLOVE22, {0: "middle-middle", 1: "index-middle"}),
            ([channel("force", body_site="Index Finger")], GLOVE5, {0: "index"}),
            ([channel("f", body_site="right index finger")], GLOVE5, {0: "index"}),
            ([channel("f", axis="y")], profile_of(3, names=["x", "y", "z"]), {0: "y"}),
            ([channel("thumb", "mN")], GLOVE5, {0: "thumb"}),
        ],
    )  # fmt: skip
    def test_that_name_one(self, channels, profile, expected):
        assert mapping(channels, profile) == expected

    @pytest.mark.parametrize(
        ("channels", "profile", "what"),
        [
            (["index", "middle", "ring", "little"], GLOVE22, "4 of 4 channels have no actuator"),
            (["Fx", "Fy", "Fz"], GLOVE5, "3 of 3 channels have no actuator"),
            (["palm force"], GLOVE5, "1 of 1 channels have no actuator"),
            (["wrist"], GLOVE22, "its words name 2 actuators: wrist-bend, wrist-turn"),
            (["normal force"], GLOVE5, "its words name no actuator"),
            ([""], profile_of(), "its words name no actuator"),
            (["thumb", "thumb"], GLOVE5, "named by another channel too: 1 'thumb'"),
            (["thumb force", "force of the thumb"], GLOVE5, "2 of 2 channels"),
            (["thumb", "thumb force"], GLOVE5, "1 of 2 channels"),
            ([channel("thumb", "V")], GLOVE5, "its unit is V, the actuator takes N"),
            ([channel("f", axis="x")], profile_of(2, names=["thumb x", "index x"]), "2 actuators"),
            ([channel("thumb", body_site="index finger")], GLOVE5, "its words name no actuator"),
            ([channel("left", body_site="right hand")],
             with_sites(["left", "right"], ["left hand", "right hand"]), "names? no actuator"),
            (["left thumb"], with_sites(["thumb"], ["right thumb"]), "its words name no actuator"),
            (["2"], profile_of(3), "its words name no actuator"),
            (["thumb", "index", "middle", "ring"], FINGERS, "1 of 4 channels have no actuator"),
        ],
    )  # fmt: skip
    def test_that_do_not(self, channels, profile, what):
        said = refused(channels, profile)
        assert re.search(what, said)
        assert "replay does not guess" in said

    @pytest.mark.parametrize(
        ("label", "name", "word"),
        [
            ("middle of the palm", "middle", "of, palm"),
            ("middle palm", "middle", "palm"),
            ("not thumb", "thumb", "not"),
            ("thumb temperature", "thumb", "temperature"),
            ("ring buffer", "ring", "buffer"),
            ("sample index", "index", "sample"),
            ("index of refraction", "index", "of, refraction"),
            ("thumb 2", "thumb", "2"),
        ],
    )
    def test_next_to_others_that_are_not_known(self, label, name, word):
        said = refused([label], GLOVE5, command="play it")
        assert f"it names '{name}', and has words that are not known: {word}\n" in said
        assert f"  play it --map '{label}={name}'\n" in said
        assert mapping([channel(label, body_site=f"right {name} finger")], GLOVE5) == {0: name}

    def test_advice_names_no_actuator_elsewhere(self):
        assert "--map " not in refused(["palm", "thumb", "index", "ring", "little"], GLOVE5)
        assert "--map knob=thumb" in refused(["knob"], GLOVE5)

    def test_without_a_unit(self):
        """A channel without a unit drives only actuators that accept "1", and a note says so."""
        for name in BUILTIN:
            profile = load_profile(name)
            for actuator in profile.actuators:
                here = [channel(actuator.name, "1")]
                if "1" in actuator.accepts:
                    found, routes = found_for(here, profile)
                    assert routes == {0: actuator.name}
                    assert any(
                        "it has no unit, so its values are fractions" in n for n in found.notes
                    )
                else:
                    assert "its unit is 1, the actuator takes" in refused(here, profile)

    def test_names_on_the_other_hand(self):
        """The recording of a left hand on a device of the right."""
        profile = with_sites(["thumb", "index"], ["right thumb", "right index finger"])
        sites = ["left thumb", "left index finger"]
        channels = [channel(f"f{i}", body_site=site) for i, site in enumerate(sites)]
        assert "2 of 2 channels have no actuator" in refused(channels, profile)


LISTED = {*NEUTRAL, *(word for group in APART for word in group)}
ODD = ["not", "no", "temperature", "buffer", "sample", "of", "refraction", "7", "indexes"]
WORDS = ["thumb", "index", "middle", "ring", "left", "right", "tip", "base", "x", "y", "force", "2"]
texts = st.lists(st.sampled_from(WORDS), max_size=3).map(" ".join)
described = st.builds(channel, texts, body_site=texts, axis=st.sampled_from(["", "x", "y"]))
profiles = st.lists(st.tuples(texts, texts), min_size=1, max_size=4, unique_by=lambda each: each[0])


def spoken(each: Channel) -> set[str]:
    return {word for text in (each.label, each.body_site, each.axis) for word in words_of(text)}


class TestLaws:
    @given(
        st.lists(st.sampled_from([*WORDS, "hand", "on"]), max_size=3),
        st.text("abcdefghijklmnopqrstuvwxyzäß", min_size=1, max_size=9) | st.sampled_from(ODD),
        st.integers(0, 3),
        profiles,
    )
    def test_a_label_with_an_unknown_word_drives_nothing(self, words, odd, at, actuators):
        """
        PLY-012: A channel MUST NOT drive an actuator unless the user assigned it, or its label, body site or axis names that actuator. Then the channel names no other actuator, and no other played channel names this one. No text is taken for the name of an actuator if one of its words is not known. Words are known that are in the actuator's name or body site, those that name hands, fingers and axes, and a few neutral ones.
        """
        profile = with_sites(*zip(*actuators, strict=True))
        if {odd} & {*WORDS, *LISTED}:
            return
        with pytest.raises(ParameterError):
            mapping([" ".join([*words[:at], odd, *words[at:]])], profile)

    @given(st.lists(described, min_size=1, max_size=4), profiles)
    def test_of_words(self, channels, actuators):
        """No channel drives an actuator without a word in common, none drives two, none is left
        over in silence."""
        profile = with_sites(*zip(*actuators, strict=True))
        try:
            found = mapping(channels, profile)
        except ParameterError:
            return
        assert found.keys() == set(range(len(channels)))
        assert len(set(found.values())) == len(found)
        sites = dict(actuators)
        for number, name in found.items():
            assert spoken(channels[number]) & {*words_of(name), *words_of(sites[name])}

    @given(st.lists(described, min_size=1, max_size=4), profiles, st.randoms())
    def test_the_order_of_channels_and_actuators_says_nothing(self, channels, actuators, random):
        def outcome(order, actuators):
            profile = with_sites(*zip(*actuators, strict=True))
            try:
                found = mapping([channels[i] for i in order], profile)
            except ParameterError:
                return None
            return {order[number]: name for number, name in found.items()}

        order = list(range(len(channels)))
        first = outcome(order, actuators)
        random.shuffle(order)
        random.shuffle(actuators)
        assert outcome(order, actuators) == first

    @given(profiles, st.integers(0, 3), described)
    def test_a_second_that_says_the_same_is_refused(self, actuators, at, each):
        """Two channels of the same words never both play, and neither is preferred."""
        profile = with_sites(*zip(*actuators, strict=True))
        channels = [each, each]
        channels[at % 2] = replace(each)
        with pytest.raises(ParameterError):
            mapping(channels, profile)

    @given(profiles, st.data())
    def test_more_words_that_name_another_actuator_are_refused(self, actuators, data):
        """A label that holds the names of two actuators drives neither."""
        names = [name for name, _ in actuators if set(words_of(name)) - {"2"}]
        if len(names) < 2:
            return
        pair = data.draw(st.lists(st.sampled_from(names), min_size=2, max_size=2, unique=True))
        label = " ".join(pair)
        if any(words_of(name) == words_of(label) for name, _ in actuators):
            return
        profile = with_sites([name for name, _ in actuators], [""] * len(actuators))
        with pytest.raises(ParameterError):
            mapping([label], profile)


class TestOptions:
    @pytest.mark.parametrize("text", ["b=2", "1=index", "1=2", "b=index", " b = index "])
    def test_as_given(self, text):
        found, routes = found_for(["a", "b"], FINGERS, [text])
        assert routes == {1: "index"}
        assert found.left_out == ("channel 0 'a': not chosen",)

    def test_one_channel_on_two_actuators_and_labels_with_a_sign(self):
        found, _ = found_for(["a=b"], FINGERS, ["a=b=1", "a=b=middle"])
        assert [(route.channel, route.actuator) for route in found.routes] == [(0, 0), (0, 2)]

    def test_by_order(self):
        channels = ["middle", channel("b", "mN"), "c"]
        found, routes = found_for(channels, FINGERS, by_order=True)
        assert routes == {0: "thumb", 1: "index", 2: "middle"}
        assert found.routes[1].factor == Fraction(1, 1000)

    def test_by_order_leaves_none_over_in_silence(self):
        said = refused(["a", channel("b", "V"), "c", "d", "e"], FINGERS, by_order=True)
        assert "2 of 5 channels have no actuator" in said
        assert "its unit is V" in said and "no actuator is free" in said

    def test_ignored(self):
        channels = ["thumb", "palm force", channel("battery", "V")]
        found, routes = found_for(channels, FINGERS, ignore=["palm force", "2"])
        assert routes == {0: "thumb"}
        assert found.left_out == ("channel 1 'palm force': ignored", "channel 2 'battery': ignored")

    def test_what_is_ignored_names_nothing(self):
        assert mapping(["thumb", "thumb"], FINGERS, ignore=["0"]) == {1: "thumb"}

    def test_all_ignored(self):
        assert "nothing to play" in refused(["thumb"], FINGERS, ignore=["thumb"])

    @pytest.mark.parametrize(
        ("given_", "what"),
        [
            (["a"], "expected CHANNEL=ACTUATOR, got 'a'"),
            (["=1"], "expected CHANNEL=ACTUATOR"),
            (["a="], "expected CHANNEL=ACTUATOR"),
            (["q=1"], "no channel 'q'"),
            (["a=0"], "no actuator '0'"),
            (["a=4"], "no actuator '4'"),
            (["a=" + "9" * 5000], "no actuator"),
            (["a=ring"], "1=thumb, 2=index, 3=middle"),
            (["a=thum"], "did you mean 'thumb'?"),
            (["v=1"], "its unit is V, the actuator takes N"),
            (["a=1", "b=thumb"], "two channels for the actuator 'thumb'"),
            (["c=1"], "2 channels have the label 'c'; use their numbers: 3, 4"),
        ],
    )
    def test_wishes_that_cannot_be(self, given_, what):
        channels = ["a", "b", channel("v", "V"), "c", "c"]
        assert what in refused(channels, FINGERS, given_)

    @pytest.mark.parametrize("more", [{"by_order": True}, {"ignore": ["b"]}])
    def test_a_map_goes_with_nothing_else(self, more):
        assert "--map names every channel to play" in refused(["a", "b"], FINGERS, ["a=1"], **more)

    def test_ignoring_one_of_two_of_a_label_takes_its_number(self):
        said = refused(["c", "c"], FINGERS, ignore=["c"])
        assert "2 channels have the label 'c'; use their numbers: 0, 1" in said


def options_in(said: str) -> list[list[str]]:
    """The command lines of a refusal, in words, after the command."""
    lines = [line for line in said.splitlines() if line.startswith("  play it ")]
    return [shlex.split(line)[2:] for line in lines]


def asked_by(words: list[str]) -> tuple[list[str], dict]:
    given_, more = [], {}
    at = iter(words)
    for word in at:
        if word == "--map":
            given_ = next(at).split(",")
        elif word == "--ignore":
            more["ignore"] = next(at).split(",")
        else:
            assert word == "--map-by-order"
            more["by_order"] = True
    return given_, more


class TestAdvice:
    @given(
        st.lists(
            st.builds(
                channel,
                texts | st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=5),
                st.sampled_from(["N", "V"]),
                body_site=texts,
            ),
            min_size=1,
            max_size=5,
        ),
        st.sets(st.integers(0, 4), max_size=2),
        st.booleans(),
        st.sampled_from([GLOVE5, GLOVE22, FINGERS]),
    )
    def test_the_command_lines_play(self, channels, ignored, by_order, profile):
        """Each command line of a refusal plays, and there is one where anything can play."""
        ignore = [str(number) for number in ignored if number < len(channels)]
        if {each.label for each in channels} & {*map(str, range(5))}:
            return  # a number that is another channel's label
        try:
            mapping(channels, profile, by_order=by_order, ignore=ignore, command="play it")
        except ParameterError as error:
            lines = options_in(str(error))
            for given_, more in map(asked_by, lines):
                if not any(text.endswith("=ACTUATOR") for text in given_):
                    assert mapping(channels, profile, given_, **more)
            if any(each.unit == "N" for i, each in enumerate(channels) if str(i) not in ignore):
                assert lines

    def test_it_names_what_comes_near(self):
        said = refused(["indx force", "thumb"], GLOVE5, command="play it")
        assert "  play it --map 'indx force=index,thumb=thumb'" in said
        assert "  play it --ignore 'indx force'" in said
        assert "by unit and order, indx force to thumb, thumb to index:\n" in said
        assert "actuators of glove5: 1=thumb, 2=index" in said

    def test_no_guess_for_one_channel_and_one_actuator(self):
        said = refused(["force"], profile_of(), command="play it")
        name = profile_of().actuators[0].name
        assert f"for example:\n  play it --map force={name}" in said and "--ignore" not in said

    def test_many_channels_are_refused_in_few_words(self):
        labels = [f"c{i}" for i in range(300)]
        said = refused(labels, GLOVE5, command="play it")
        assert "300 of 300" in said and "and 288 more" in said and len(said) < 2000
        assert [mapping(labels, GLOVE5, pairs) for pairs, _ in map(asked_by, options_in(said))]


class TestPlan:
    """
    PLY-013: A player MUST refuse to play while a channel has no actuator and the user has not left it out; before anything moves it MUST print which channel drives which actuator, why, and which actuators rest.
    """

    def test_each_route_has_its_reason(self):
        channels = ["thumb", "force on the ring finger", channel("f", body_site="index finger")]
        with Reader(file_of(Recording(tuple(
            each if isinstance(each, Channel) else channel(each) for each in channels
        )))) as reader:  # fmt: skip
            plan = Renderer(reader, GLOVE5, assign(reader, GLOVE5)).plan
        limits = ": -5 to 5 N, at most 500 N/s"
        assert plan == [
            f"thumb <- 0 'thumb', by its label{limits}",
            f"index <- 2 'f', by the words of its body site, 'index finger'{limits}",
            "ring <- 1 'force on the ring finger', by the words of its label, "
            f"'force on the ring finger'{limits}",
            "at rest: middle, little",
        ]

    @pytest.mark.parametrize(
        ("asked", "reason"),
        [({"given": ["0=thumb"]}, "as --map says"), ({"by_order": True}, "by unit and order")],
    )
    def test_the_reasons_of_options(self, asked, reason):
        with Reader(file_of(Recording((channel("f"),)))) as reader:
            (line, rest) = Renderer(reader, FINGERS, assign(reader, FINGERS, **asked)).plan
        assert f", {reason}: " in line and rest == "at rest: index, middle"
