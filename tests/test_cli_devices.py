"""hapfmt devices and hapfmt profile, with a fake of hidapi."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import hid_descriptors as hd
import pytest
from fake_hid import PATH, FakeHid, entry, installed
from spec import ROOT

from hapfmt.cli import main
from hapfmt.replay.profile.matching import differences, parse_descriptor
from hapfmt.replay.profile.parse import builtin_names, load_profile

LINUX = sys.platform.startswith("linux")
TARGETS = {
    "glove5": hd.GLOVE5,
    "glove22": hd.GLOVE22,
    "dualsense-usb": hd.DUALSENSE_USB,
    "dualsense-bluetooth": hd.DUALSENSE_BLUETOOTH,
    "dualsense-bluetooth-haptics": hd.DUALSENSE_BLUETOOTH,
    "joycon-left": hd.JOYCON,
    "joycon-right": hd.JOYCON,
    "switch-pro": hd.JOYCON,
    "xbox-bluetooth": hd.XBOX_BLUETOOTH,
}
"""Built-in profile -> what is public of the descriptor of its device."""


@pytest.fixture
def run(monkeypatch, capsys):
    """Exit code, standard output and standard error of ``hapfmt ...``, in this process."""
    monkeypatch.setenv("COLUMNS", "200")

    def once(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["hapfmt", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, out, err

    return once


@pytest.fixture
def module(monkeypatch):
    """One glove, which one may open."""
    fake = FakeHid("hidraw" if LINUX else "hid", hd.GLOVE5, [entry()])
    monkeypatch.setattr(os, "access", lambda *_: True)
    with installed(**{fake.__name__: fake}):
        yield fake


class TestDevices:
    def test_a_device_and_its_profile(self, run, module):
        code, out, err = run("devices")
        assert (code, err) == (0, "")
        header, _, row, *rest = [line.split() for line in out.splitlines() if line.strip()]
        assert header == ["path", "ids", "bus", "usage", "name", "profile", "missing"]
        assert row == ["/dev/hidraw7", "1209:c0de", "usb", "ff00/0001", "Glove", "glove5", "-"]
        assert not rest
        assert not module.sent

    def test_for_programs(self, run, module):
        code, out, _ = run("devices", "--json")
        assert code == 0
        assert json.loads(out) == {
            "devices": [
                {
                    "path": "/dev/hidraw7", "vendor_id": 0x1209, "product_id": 0xC0DE, "bus": "usb",
                    "name": "Glove", "manufacturer": "HapLab", "serial": "SN1", "interface": 0,
                    "usages": [[0xFF00, 1]], "permitted": True, "missing": [],
                    "profiles": [{"name": "glove5", "fits": True, "differences": []}],
                }
            ],
            "exit_code": 0,
        }  # fmt: skip
        assert not module.sent

    def test_none(self, run, module):
        module.entries.clear()
        assert run("devices") == (0, "no HID device is connected\n", "")
        assert json.loads(run("devices", "--json")[1])["devices"] == []

    def test_each_path_once_with_all_usages(self, run, module):
        module.entries.insert(0, entry(usage_page=1, usage=6))
        (row,) = json.loads(run("devices", "--json")[1])["devices"]
        assert row["usages"] == [[1, 6], [0xFF00, 1]]
        assert [each["name"] for each in row["profiles"]] == ["glove5"]

    def test_a_device_without_a_profile_is_not_opened(self, run, module):
        module.entries[:] = [entry(vendor_id=0x46D, product_id=0xC31C, product_string="Keyboard")]
        _, out, _ = run("devices")
        assert "046d:c31c" in out and "hapfmt profile show glove5" in out
        assert not module.calls
        (row,) = json.loads(run("devices", "--json")[1])["devices"]
        assert row["missing"] == ["profile"]

    def test_a_device_with_other_reports_than_its_profile(self, run, module):
        module.descriptor = hd.device(0xFF00, 1, hd.field(hd.OUTPUT, 5, number=1))
        _, out, _ = run("devices")
        assert "glove5 (no)" in out and "profile that fits its reports" in out
        assert (
            "/dev/hidraw7: glove5: output report 0x01: the profile sends 12 bytes, the device takes 6"
            in out
        )
        (row,) = json.loads(run("devices", "--json")[1])["devices"]
        assert row["profiles"][0]["fits"] is False

    def test_a_device_that_does_not_answer(self, run, module):
        module.descriptor = hd.GLOVE5[:-1]
        _, out, _ = run("devices")
        assert "glove5?" in out and "ends within a collection" in out
        (row,) = json.loads(run("devices", "--json")[1])["devices"]
        assert row["profiles"][0]["fits"] is None
        assert row["missing"] == ["report descriptor"]

    @pytest.mark.skipif(not LINUX, reason="permissions of Linux")
    def test_a_device_that_one_may_not_open(self, run, module, monkeypatch):
        """What is missing, and how a udev rule gives it."""
        monkeypatch.setattr(os, "access", lambda *_: False)
        _, out, _ = run("devices")
        assert "glove5?" in out and "permission" in out
        assert 'SUBSYSTEM=="hidraw", KERNELS=="*:1209:C0DE.*", TAG+="uaccess"' in out
        assert "/etc/udev/rules.d/70-hapfmt.rules" in out and "udevadm control --reload" in out
        assert not module.calls
        (row,) = json.loads(run("devices", "--json")[1])["devices"]
        assert (row["permitted"], row["missing"]) == (False, ["permission"])
        assert row["profiles"] == [{"name": "glove5", "fits": None, "differences": []}]

    def test_paths_that_are_no_files(self, run, module, monkeypatch):
        """Nothing is known of their permissions."""
        monkeypatch.setattr(os, "access", lambda *_: False)
        module.entries[:] = [entry(b"1-2:1.0", usage_page=0, usage=0)]
        (row,) = json.loads(run("devices", "--json")[1])["devices"]
        assert (row["permitted"], row["missing"], row["usages"]) == (True, [], [])

    def test_a_profile_of_ones_own(self, run, module, tmp_path):
        text = (
            load_profile("glove5")
            .text.replace('name = "glove5"', 'name = "mine"')
            .replace("0xC0DE", "0xBEEF")
        )
        (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
        module.entries.append(entry(b"/dev/hidraw8", product_id=0xBEEF))
        found = json.loads(run("devices", "--json", "--profile", tmp_path / "mine.toml")[1])[
            "devices"
        ]
        assert [[each["name"] for each in row["profiles"]] for row in found] == [
            ["glove5"],
            ["mine"],
        ]

    def test_names_cannot_steer_a_terminal(self, run, module):
        module.entries[:] = [entry(product_string="\x1b[2Jboo")]
        assert "\x1b" not in run("devices")[1]

    def test_without_hidapi(self, run):
        with installed():
            code, out, err = run("devices")
        assert (code, out) == (1, "")
        assert "pip install 'hapfmt[replay]'" in err
        with installed():
            code, out, _ = run("devices", "--json")
        assert json.loads(out)["exit_code"] == code == 1


@pytest.mark.parametrize(
    "words", [["devices"], ["profile", "list"], ["profile", "check", "glove5"]]
)
def test_loads_no_numbers(words):
    """And what lists profiles no hidapi."""
    code = f"from hapfmt.cli import cli; cli.main({words!r}, standalone_mode=False)\nimport sys; print(*sys.modules)"
    environment = {**os.environ, "PYTHONPATH": os.fspath(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment
    )
    loaded = set(done.stdout.splitlines()[-1].split()) if done.returncode == 0 else set()
    assert not loaded & {"numpy", "scipy", "jsonschema"}
    if words != ["devices"]:
        assert "hapfmt.replay.profile.parse" in loaded and not loaded & {"hid", "hidraw"}


class TestList:
    def test_every_profile(self, run):
        code, out, _ = run("profile", "list")
        assert code == 0
        assert all(name in out for name in builtin_names())
        listed = json.loads(run("profile", "list", "--json")[1])["profiles"]
        assert [each["name"] for each in listed] == list(builtin_names())
        assert all(each["actuators"] and each["reports"] for each in listed)

    def test_needs_no_hidapi(self, run):
        with installed():
            assert run("profile", "list")[0] == 0
            assert run("profile", "check", "glove5")[0] == 0


class TestShow:
    def test_the_text_as_it_is(self, run, tmp_path):
        code, out, _ = run("profile", "show", "glove5")
        assert (code, out) == (0, load_profile("glove5").text)
        (tmp_path / "mine.toml").write_text(out, encoding="utf-8")
        assert run("profile", "check", tmp_path / "mine.toml")[0] == 0

    def test_an_unknown_name(self, run):
        code, _, err = run("profile", "show", "glove6")
        assert code == 1 and "glove5" in err


class TestCheck:
    def test_what_it_says(self, run):
        code, out, _ = run("profile", "check", "glove5")
        assert code == 0
        lines = out.splitlines()
        assert lines[0].startswith("glove5: glove5, A generic glove")
        assert lines[1] == "for 1209:c0de usage ff00/0001"
        assert lines[2].startswith(
            "1000 frames/s of 1 for each actuator; gain 0.5; stops when 20 ms late; ramps of 50 ms"
        )
        assert "output report 0x01, 12 bytes" in out
        assert "goes to rest by itself 100 ms after the last report" in out
        assert len([line for line in out.splitlines() if " N " in line]) == 5

    def test_for_programs(self, run):
        told = json.loads(run("profile", "check", "glove5", "--json")[1])
        assert told["reports"] == [{"path": "output", "id": 1, "length": 12, "short": False}]
        assert told["actuators"][0]["maximum"] == 5.0
        assert (told["differences"], told["device"], told["exit_code"]) == ([], None, 0)

    def test_no_profile(self, run, tmp_path):
        (tmp_path / "bad.toml").write_text("name = 3", encoding="utf-8")
        code, _, err = run("profile", "check", tmp_path / "bad.toml")
        assert code == 1 and "bad.toml" in err and "name" in err

    @pytest.mark.parametrize("form", ["hex", "commented", "bytes"])
    def test_against_a_descriptor(self, run, tmp_path, form):
        path = tmp_path / "descriptor"
        text = ", ".join(f"0x{each:02X}" for each in hd.GLOVE5) + "  // all of it\n"
        data = {"hex": hd.GLOVE5.hex().encode(), "commented": text.encode(), "bytes": hd.GLOVE5}[
            form
        ]
        path.write_bytes(data)
        code, out, _ = run("profile", "check", "glove5", "--descriptor", path)
        assert code == 0 and "each of its reports is one of" in out

    def test_against_another_descriptor(self, run, tmp_path):
        path = tmp_path / "descriptor.hex"
        path.write_text(hd.DUALSENSE_USB.hex(), encoding="ascii")
        code, _, err = run("profile", "check", "glove5", "--descriptor", path)
        assert code == 1
        assert "output report 0x01: the device has none; there 0x01 is of kind input" in err
        told = json.loads(run("profile", "check", "glove5", "--descriptor", path, "--json")[1])
        assert len(told["differences"]) == 2 and told["exit_code"] == 1
        assert {"path": "output", "id": 2, "length": 48} in told["device"]["reports"]

    @pytest.mark.parametrize(
        ("data", "text"),
        [
            (b"hello", "neither hex bytes nor a report descriptor"),
            (hd.GLOVE5[:-1].hex().encode(), "ends within a collection"),
            (b" " * ((1 << 20) + 1), "longer than any descriptor"),
            (b"\xff" * 5000, "5000 bytes, but 4096 are the most"),
        ],
    )
    def test_no_descriptor(self, run, tmp_path, data, text):
        path = tmp_path / "descriptor"
        path.write_bytes(data)
        code, _, err = run("profile", "check", "glove5", "--descriptor", path)
        assert code == 1 and text in err and str(path) in err

    def test_a_file_that_is_not_there(self, run, tmp_path):
        assert run("profile", "check", "glove5", "--descriptor", tmp_path / "none")[0] == 1

    def test_against_a_device(self, run, module):
        code, out, _ = run("profile", "check", "glove5", "--path", os.fsdecode(PATH))
        assert code == 0 and "each of its reports is one of /dev/hidraw7" in out
        module.descriptor = hd.device(0xFF00, 1, hd.field(hd.FEATURE, 11, number=1))
        code, _, err = run("profile", "check", "glove5", "--path", os.fsdecode(PATH))
        assert code == 1 and "there 0x01 is of kind feature" in err
        assert not module.sent

    @pytest.mark.usefixtures("module")
    def test_against_a_device_of_another_kind(self, run):
        code, _, err = run("profile", "check", "xbox-bluetooth", "--path", os.fsdecode(PATH))
        assert code == 1 and "does not fit /dev/hidraw7" in err
        code, _, err = run("profile", "check", "glove5", "--path", "/dev/hidraw99")
        assert code == 1 and "no HID device has the path" in err

    def test_one_of_both(self, run):
        code, _, err = run("profile", "check", "glove5", "--path", "a", "--descriptor", "b")
        assert code == 1 and "not both" in err


@pytest.mark.parametrize("name", TARGETS)
def test_built_in_profiles_fit_their_devices(name):
    assert differences(load_profile(name), parse_descriptor(TARGETS[name])) == []


def test_the_dualsense_edge_takes_a_shorter_report_than_it_declares():
    found = parse_descriptor(hd.DUALSENSE_EDGE_USB)
    assert found.of_kind("output") == {2: 64}
    assert differences(load_profile("dualsense-usb"), found) == []


def test_every_built_in_profile_is_held_against_its_device():
    assert set(TARGETS) == set(builtin_names())


@pytest.mark.parametrize("name", TARGETS)
def test_built_in_profiles_fit_no_other_device(name):
    """None would be sent to a device that only looks like its own."""
    others = [data for data in set(TARGETS.values()) if data != TARGETS[name]]
    assert all(
        differences(load_profile(name), parse_descriptor(data)) for data in [*others, hd.KEYBOARD]
    )
