"""The sink over hidapi with a fake of it, and which profile fits which device.

What devices really do is tested with the unmodified wheel in test_replay_device.py.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
import time
from fractions import Fraction

import fake_hid
import hid_descriptors as hd
import pytest
from fake_hid import PATH, FakeHid, entry, installed

from hapfmt.errors import DeviceError, DeviceGoneError, MissingExtraError, ParameterError
from hapfmt.replay.profile.matching import (
    SystemDevice,
    by_path,
    check_fit,
    choose,
    described,
    differences,
    fits,
    match_text,
    parse_descriptor,
    profiles_for,
    wanted_of,
)
from hapfmt.replay.profile.model import (
    Actuator,
    Frame,
    HidReport,
    Match,
    Profile,
    ReportLayout,
    Timing,
)
from hapfmt.replay.sinks import hid
from hapfmt.replay.sinks.hid import HidSink, connected, find, read_descriptor

LINUX = sys.platform.startswith("linux")
GLOVE = Match(0x1209, 0xC0DE, "usb", 0xFF00, 1)


def profile(
    *reports: tuple, name: str = "p", matches: tuple[Match, ...] = (GLOVE,), **others
) -> Profile:
    actuator = Actuator("a", "N", -1.0, 1.0, 10.0, 0.001)
    layouts = tuple(
        ReportLayout(path, number, length, (), *short) for path, number, length, *short in reports
    )
    return Profile(name, "", "", matches, Timing(Fraction(1000)), (actuator,), layouts, **others)


GLOVE_PROFILE = profile(("output", 1, 12))


@pytest.fixture
def module():
    fake = FakeHid("hidraw" if LINUX else "hid", hd.GLOVE5, [entry()])
    with installed(**{fake.__name__: fake}):
        yield fake


def opened(given: Profile | None = None) -> HidSink:
    sink = HidSink(PATH, given)
    sink.open()
    return sink


class TestModule:
    @pytest.mark.skipif(not LINUX, reason="hidraw is Linux'")
    def test_hidraw_comes_first_on_linux(self):
        """libusb would take the device from its driver, and knows neither usages nor reasons."""
        raw, usb = FakeHid("hidraw"), FakeHid("hid")
        with installed(hidraw=raw, hid=usb):
            assert hid.hid_module() is raw
        with installed(hid=usb):
            assert hid.hid_module() is usb

    def test_elsewhere_there_is_only_hid(self, monkeypatch):
        monkeypatch.setattr(sys, "platform", "darwin")
        raw, usb = FakeHid("hidraw"), FakeHid("hid")
        with installed(hidraw=raw, hid=usb):
            assert hid.hid_module() is usb

    def test_missing(self):
        with installed(), pytest.raises(MissingExtraError, match=r"'hidapi'.*hapfmt\[replay\]"):
            hid.hid_module()

    def test_the_other_package_of_that_name(self):
        """It has a class Device, and no device."""
        other = type(sys)("hid")
        other.Device = object
        other.enumerate = list
        with installed(hid=other), pytest.raises(ParameterError, match="pip uninstall hid"):
            hid.hid_module()

    def test_the_other_package_that_finds_no_library(self, tmp_path, monkeypatch):
        text = "raise ImportError('Unable to load any of the following libraries')"
        (tmp_path / "hid.py").write_text(text, encoding="utf-8")
        self.of_a_file(tmp_path, monkeypatch, "Unable to load")

    def test_the_other_package_that_lacks_a_part(self, tmp_path, monkeypatch):
        """Another module is missing, not hidapi."""
        (tmp_path / "hid.py").write_text("import no_such_module_anywhere", encoding="utf-8")
        self.of_a_file(tmp_path, monkeypatch, "no_such_module_anywhere")

    def of_a_file(self, folder, monkeypatch, text):
        monkeypatch.syspath_prepend(str(folder))
        monkeypatch.setattr(sys, "platform", "darwin")
        with installed(hidraw=None, hid=None):
            missing = sys.meta_path.pop(0)
            try:
                with pytest.raises(ParameterError, match=text) as caught:
                    hid.hid_module()
            finally:
                sys.meta_path.insert(0, missing)
        assert "pip uninstall hid" in str(caught.value)
        assert not isinstance(caught.value, MissingExtraError)

    @pytest.mark.skipif(not LINUX, reason="hidraw is Linux'")
    def test_hidraw_that_does_not_load_is_not_replaced_by_libusb(self):
        """Which would take the device from its driver."""
        broken = type(sys)("hidraw")
        usb = FakeHid("hid")
        with (
            installed(hidraw=broken, hid=usb),
            pytest.raises(ParameterError, match="does not load"),
        ):
            hid.hid_module()
        assert not usb.calls

    @pytest.mark.skipif(not LINUX, reason="hidraw is Linux'")
    def test_hidraw_works_though_the_other_package_hides_hid(self):
        raw = FakeHid("hidraw")
        with installed(hidraw=raw, hid=type(sys)("hid")):
            assert hid.hid_module() is raw


class TestConnected:
    def test_what_hidapi_says(self, module):
        module.entries[:] = [entry(), entry(b"/odd \xc3\xa9", bus_type=2, usage_page=1, usage=5)]
        glove, odd = connected()
        assert glove == SystemDevice(
            PATH, 0x1209, 0xC0DE, "usb", 0xFF00, 1, "Glove", "HapLab", "SN1", 0
        )
        assert (odd.bus, odd.usage_page, odd.usage) == ("bluetooth", 1, 5)
        assert (glove.ids, glove.place) == ("1209:c0de", "/dev/hidraw7")
        assert odd.place == os.fsdecode(b"/odd \xc3\xa9")

    def test_what_hidapi_does_not_say(self, module):
        """None where a text is missing; no bus from old versions; 0 for other buses."""
        module.entries[:] = [
            entry(
                product_string=None,
                manufacturer_string=None,
                serial_number=None,
                usage_page=0,
                usage=0,
                bus_type=0,
            )
        ]
        del module.entries[0]["interface_number"]
        (found,) = connected()
        assert found == SystemDevice(PATH, 0x1209, 0xC0DE)

    def test_that_the_system_cannot_say(self, module):
        def broken():
            raise OSError("no udev")

        module.answers["enumerate"] = broken
        with pytest.raises(DeviceError, match="cannot be listed: no udev"):
            connected()


class TestSink:
    def test_reports_go_by_their_paths_in_order(self, module):
        sink = opened(GLOVE_PROFILE)
        reports = (HidReport("output", b"\1" + bytes(11)), HidReport("feature", b"\3abc"))
        sink.send(Frame(0, 0, ((0,),)), reports)
        sink.write(reports[:1])
        sink.close()
        assert module.sent == [
            ("write", b"\1" + bytes(11)),
            ("send_feature_report", b"\3abc"),
            ("write", b"\1" + bytes(11)),
        ]
        assert module.names[0] == "open_path" and module.names[-1] == "close"

    def test_nothing_is_sent_to_a_device_with_other_reports(self, module):
        with pytest.raises(ParameterError, match="sends 13 bytes, the device takes 12") as caught:
            opened(profile(("output", 1, 13)))
        assert "nothing was sent" in str(caught.value) and "/dev/hidraw7" in str(caught.value)
        assert module.names == ["open_path", "get_report_descriptor", "close"]

    def test_a_broken_descriptor(self, module):
        module.descriptor = hd.GLOVE5[:-1]
        with pytest.raises(DeviceError, match=r"/dev/hidraw7:0x[0-9a-f]+: report descriptor"):
            opened(GLOVE_PROFILE)
        assert module.names[-1] == "close"

    def test_a_descriptor_that_cannot_be_read(self, module):
        def unread():
            raise OSError("read error")

        module.answers["get_report_descriptor"] = unread
        with pytest.raises(DeviceError, match="cannot be read: read error"):
            opened(GLOVE_PROFILE)
        assert module.names[-1] == "close"

    @pytest.mark.usefixtures("module")
    def test_an_old_hidapi_reads_no_descriptors(self, monkeypatch):
        monkeypatch.delattr(fake_hid.FakeDevice, "get_report_descriptor")
        with pytest.raises(ParameterError, match=r"hidapi>=0\.14"):
            opened(GLOVE_PROFILE)
        opened().close()  # without a profile nothing is held against it

    def test_read_descriptor(self, module):
        assert read_descriptor(PATH) == parse_descriptor(hd.GLOVE5)
        assert module.names == ["open_path", "get_report_descriptor", "close"]

    @pytest.mark.parametrize("path", ["output", "feature"])
    @pytest.mark.parametrize(
        ("text", "shown"),
        [
            ("No such device", "No such device"),
            ("Success", "hidapi gives no reason"),
            ("", "hidapi gives no reason"),
            (None, "hidapi gives no reason"),
            ("hid_error is not implemented yet", "hidapi gives no reason"),
        ],
    )
    def test_a_write_that_fails(self, module, path, text, shown):
        module.answers |= {
            "write": lambda _: -1,
            "send_feature_report": lambda _: -1,
            "error": lambda: text,
        }
        with pytest.raises(DeviceError, match=shown) as caught:
            opened().write((HidReport(path, b"\1ab"),))
        assert f"/dev/hidraw7: {path} report 0x01 was not taken" in str(caught.value)
        assert caught.value.exit_code == 6

    @pytest.mark.parametrize(
        ("text", "exists", "is_gone"),
        [
            ("No such device", True, True),
            ("WriteFile: (0x0000048F) The device is not connected.", True, True),
            ("IOHIDDeviceSetReport failed: (0xE00002C0) no such device", True, True),
            ("Input/output error", True, False),
            ("Input/output error", False, True),
            ("", True, False),
        ],
    )
    def test_a_device_that_is_gone(self, module, tmp_path, text, exists, is_gone):
        module.answers |= {"write": lambda _: -1, "error": lambda: text}
        node = tmp_path / "hidraw7"
        if exists:
            node.touch()
        sink = HidSink(os.fsencode(node))
        sink.open()
        with pytest.raises(DeviceError) as caught:
            sink.write((HidReport("output", b"\1ab"),))
        assert isinstance(caught.value, DeviceGoneError) is is_gone

    def test_a_reason_that_cannot_be_had(self, module):
        def broken():
            raise OSError("")

        module.answers |= {"write": lambda _: -1, "error": broken}
        with pytest.raises(DeviceError, match="hidapi gives no reason"):
            opened().write((HidReport("output", b"\1ab"),))

    def test_a_call_that_raises(self, module):
        def broken(_):
            raise OSError("gone")

        module.answers["send_feature_report"] = broken
        with pytest.raises(DeviceError, match="feature report 0x01 was not taken: gone"):
            opened().write((HidReport("feature", b"\1ab"),))

    @pytest.mark.parametrize(("times", "calls"), [(1, 2), (2, 2)])
    def test_a_signal_during_a_call_is_no_loss_of_the_device(self, module, times, calls):
        """Once; what is interrupted again and again has another cause."""
        left = [-1] * times
        module.answers |= {
            "send_feature_report": lambda data: left.pop() if left else len(data),
            "error": lambda: os.strerror(errno.EINTR),
        }
        sink = opened()
        if times == 1:
            sink.write((HidReport("feature", b"\1ab"),))
        else:
            with pytest.raises(DeviceError, match=os.strerror(errno.EINTR)):
                sink.write((HidReport("feature", b"\1ab"),))
        assert module.sent == calls * [("send_feature_report", b"\1ab")]

    def test_a_short_write(self, module):
        module.answers["write"] = lambda data: len(data) - 1
        with pytest.raises(DeviceError, match="took 2 of 3 bytes"):
            opened().write((HidReport("output", b"\1ab"),))

    def test_a_device_that_takes_nothing(self, module):
        module.answers["write"] = lambda _: 0
        with pytest.raises(DeviceError, match="took 0 of 3 bytes"):
            opened().write((HidReport("output", b"\1ab"),))

    def test_a_longer_answer_is_none(self, module):
        """Windows counts the bytes that it added."""
        module.answers["write"] = lambda _: 64
        opened().write((HidReport("output", b"\1ab"),))

    def test_nothing_after_a_report_that_failed(self, module):
        module.answers["write"] = lambda data: -1 if data[0] == 2 else len(data)
        sink = opened()
        with pytest.raises(DeviceError):
            sink.write(tuple(HidReport("output", bytes([number, 0])) for number in (1, 2, 3)))
        assert [data[0] for _, data in module.sent] == [1, 2]

    def test_a_device_that_is_not_there(self, module):
        def absent(_):
            raise OSError("open failed")

        module.answers["open_path"] = absent
        with pytest.raises(DeviceError) as caught:
            HidSink(b"/no/such/hidraw0").open()
        wanted = "there is no such device" if LINUX else "cannot be opened: open failed"
        assert wanted in str(caught.value)
        assert "close" not in module.names

    def test_a_path_that_is_no_file(self, module):
        """Of libusb, and elsewhere."""

        def absent(_):
            raise OSError("open failed")

        module.answers["open_path"] = absent
        with pytest.raises(
            DeviceError, match=r"^1-2:1\.0: the device cannot be opened: open failed$"
        ):
            HidSink(b"1-2:1.0").open()

    @pytest.mark.skipif(not LINUX, reason="permissions of Linux")
    def test_a_device_that_one_may_not_open(self, module, monkeypatch, tmp_path):
        def absent(_):
            raise OSError("open failed")

        module.answers["open_path"] = absent
        node = tmp_path / "hidraw0"
        node.touch()
        with pytest.raises(DeviceError, match="cannot be opened: open failed"):
            HidSink(bytes(node)).open()
        module.answers["error"] = lambda: "Failed to open a device: Permission denied"
        with pytest.raises(
            DeviceError, match="cannot be opened: Failed to open a device: Permission denied"
        ):
            HidSink(bytes(node)).open()
        monkeypatch.setattr(hid.os, "access", lambda *_: False)
        with pytest.raises(DeviceError, match="udev"):
            HidSink(bytes(node)).open()

    def test_not_open(self, module):
        sink = HidSink(PATH)
        sink.close()
        for call in (sink.descriptor, lambda: sink.write((HidReport("output", b"\1"),))):
            with pytest.raises(DeviceError, match="not open"):
                call()
        assert not module.calls

    def test_opening_twice_is_once_and_again_is_a_new_object(self, module):
        sink = opened()
        sink.open()
        assert module.objects == 1
        sink.close()
        sink.close()
        sink.open()
        sink.write((HidReport("output", b"\1"),))
        sink.close()
        assert module.objects == 2
        assert module.names == ["open_path", "close", "open_path", "write", "close"]

    def test_close_never_raises(self, module):
        def broken():
            raise OSError("gone")

        module.answers["close"] = broken
        opened().close()


class TestCallsNeverOverlap:
    """The fake asserts it: two calls at a time crash the real library."""

    def test_from_several_threads(self, module):
        module.answers["write"] = lambda data: time.sleep(0.001) or len(data)
        sink = opened()
        threads = [
            threading.Thread(
                target=lambda: [sink.write((HidReport("output", b"\1"),)) for _ in range(20)]
            )
            for _ in range(4)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60)
        assert len(module.sent) == 80

    def test_close_waits_for_a_write(self, module):
        started = threading.Event()

        def slow(data):
            started.set()
            time.sleep(0.2)
            return len(data)

        module.answers["write"] = slow
        sink = opened()
        thread = threading.Thread(target=lambda: sink.write((HidReport("output", b"\1"),)))
        thread.start()
        assert started.wait(60)
        sink.close()
        assert module.names == ["open_path", "write", "close"]
        thread.join(60)

    def test_close_does_not_wait_for_ever(self, module, monkeypatch):
        monkeypatch.setattr(hid, "CLOSE_WAIT_S", 0.05)
        started, go_on = threading.Event(), threading.Event()

        def hung(data):
            started.set()
            go_on.wait(60)
            return len(data)

        module.answers["write"] = hung
        sink = opened()
        thread = threading.Thread(target=lambda: sink.write((HidReport("output", b"\1"),)))
        thread.start()
        assert started.wait(60)
        sink.close()
        assert "close" not in module.names
        go_on.set()
        thread.join(60)

    @pytest.mark.realtime
    def test_nothing_is_written_once_close_was_called(self, module):
        """Though the thread that writes would have more, and gets the lock more easily."""
        started = threading.Event()

        def slow(data):
            started.set()
            time.sleep(0.1)
            return len(data)

        module.answers["write"] = slow
        sink = opened()
        refused = []

        def many():
            with pytest.raises(DeviceError, match="not open") as caught:
                sink.write(tuple(HidReport("output", bytes([number, 0])) for number in range(50)))
            refused.append(caught.value)

        thread = threading.Thread(target=many)
        thread.start()
        assert started.wait(60)
        sink.close()
        thread.join(60)
        assert refused and len(module.sent) == 1

    @pytest.mark.skipif(not hasattr(signal, "raise_signal") or not LINUX, reason="signals")
    def test_a_handler_of_a_signal_may_close(self, module):
        """It runs in the thread that writes, between two reports."""
        sink = opened()
        before = signal.signal(signal.SIGUSR1, lambda *_: sink.close())
        module.answers["write"] = lambda data: signal.raise_signal(signal.SIGUSR1) or len(data)
        # The fake is Python: the handler runs within its call, where the real one cannot be.
        module.under_way = threading.RLock()
        try:
            with pytest.raises(DeviceError, match="not open"):
                sink.write((HidReport("output", b"\1"), HidReport("output", b"\2")))
        finally:
            signal.signal(signal.SIGUSR1, before)
        assert module.sent == [("write", b"\1")]


class TestMatching:
    glove = SystemDevice(PATH, 0x1209, 0xC0DE, "usb", 0xFF00, 1)

    @pytest.mark.parametrize(
        ("match", "expected"),
        [
            (GLOVE, True),
            (Match(0x1209), True),
            (Match(0x1209, 0xC0DE, "usb"), True),
            (Match(0x1209, 0xC0DF), False),
            (Match(0x1208, 0xC0DE), False),
            (Match(0x1209, 0xC0DE, "bluetooth"), False),
            (Match(0x1209, usage_page=0xFF00), True),
            (Match(0x1209, usage_page=0xFF01), False),
            (Match(0x1209, usage_page=0xFF00, usage=2), False),
        ],
    )
    def test_each_part_must_be_that_of_the_device(self, match, expected):
        assert fits(match, self.glove) is expected

    def test_a_usage_that_is_not_told_is_left_to_the_descriptor(self):
        assert fits(GLOVE, self.glove._replace(usage_page=0, usage=0))
        assert not fits(GLOVE, self.glove._replace(bus=""))
        assert not fits(GLOVE, self.glove._replace(usage=0))
        assert not fits(GLOVE, self.glove._replace(usage_page=0))

    def test_the_most_particular_first(self):
        wide = profile(name="wide", matches=(Match(0x1209), Match(1)))
        exact = profile(name="exact")
        also = profile(name="also")
        other = profile(name="other", matches=(Match(0x1209, 1),))
        free = profile(name="free", matches=())
        found = profiles_for(self.glove, [wide, exact, other, free, also])
        assert [each.name for each in found] == ["also", "exact", "wide"]

    def test_one_for_each_path(self):
        second = self.glove._replace(path=b"b")
        mouse = self.glove._replace(usage_page=1, usage=2)
        assert by_path([self.glove, second, mouse]) == [self.glove, second]


class TestChoose:
    glove = SystemDevice(PATH, 0x1209, 0xC0DE, "usb", 0xFF00, 1)
    second = glove._replace(path=b"/dev/hidraw8")
    keyboard = SystemDevice(b"/dev/hidraw0", 0x046D, 0xC31C, "usb", 1, 6)

    def test_the_only_one(self):
        """However many collections it has."""
        extra = self.glove._replace(usage_page=0xFF01)
        assert choose(GLOVE_PROFILE, [self.keyboard, extra, self.glove]) == self.glove

    def test_none(self):
        with pytest.raises(
            ParameterError, match=r"1209:c0de by usb usage ff00/0001\); hapfmt devices"
        ):
            choose(GLOVE_PROFILE, [self.keyboard])

    def test_several(self):
        with pytest.raises(ParameterError, match=r"2 devices: .*hidraw7, /dev/hidraw8"):
            choose(GLOVE_PROFILE, [self.glove, self.second])

    @pytest.mark.parametrize("path", ["/dev/hidraw8", b"/dev/hidraw8"])
    def test_by_its_path(self, path):
        assert choose(GLOVE_PROFILE, [self.glove, self.second], path) == self.second

    def test_a_path_of_no_device(self):
        with pytest.raises(ParameterError, match="no HID device has the path /dev/hidraw9"):
            choose(GLOVE_PROFILE, [self.glove], "/dev/hidraw9")

    def test_a_path_of_another_device(self):
        with pytest.raises(
            ParameterError, match=r"does not fit /dev/hidraw0.* 046d:c31c by usb usage 0001/0006"
        ):
            choose(GLOVE_PROFILE, [self.glove, self.keyboard], "/dev/hidraw0")

    @pytest.mark.parametrize(
        ("match", "text"),
        [
            (Match(1), "0001:*"),
            (Match(1, 2), "0001:0002"),
            (Match(1, usage_page=3), "0001:* usage 0003/*"),
            (Match(1, usage=4), "0001:* usage */0004"),
            (Match(1, 2, "bluetooth", 3, 4), "0001:0002 by bluetooth usage 0003/0004"),
        ],
    )
    def test_what_a_profile_asks_for(self, match, text):
        assert match_text(match) == text

    @pytest.mark.parametrize(
        ("page", "usage", "text"),
        [
            (0, 0, "046d:c31c by usb"),
            (1, 0, "046d:c31c by usb usage 0001/0000"),
            (0, 6, "046d:c31c by usb usage 0000/0006"),
        ],
    )
    def test_what_a_device_is(self, page, usage, text):
        assert described(self.keyboard._replace(usage_page=page, usage=usage)) == text

    def test_a_profile_for_no_device_in_particular(self):
        """It plays only where it is told to."""
        free = profile(("output", 1, 12), matches=())
        assert choose(free, [self.glove], "/dev/hidraw7") == self.glove
        with pytest.raises(ParameterError, match="no device in particular"):
            choose(free, [self.glove])

    @pytest.mark.usefixtures("module")
    def test_of_those_that_are_connected(self):
        assert find(GLOVE_PROFILE).path == PATH


def told(given: Profile, descriptor: bytes) -> str:
    return "; ".join(differences(given, parse_descriptor(descriptor)))


class TestDifferences:
    def test_none(self):
        assert told(GLOVE_PROFILE, hd.GLOVE5) == ""
        check_fit(GLOVE_PROFILE, parse_descriptor(hd.GLOVE5), "here")

    @pytest.mark.parametrize(
        ("reports", "descriptor", "text"),
        [
            ([("output", 1, 13)], hd.GLOVE5, "output report 0x01: the profile sends 13 bytes, the device takes 12"),
            ([("output", 1, 11)], hd.GLOVE5, "output report 0x01: the profile sends 11 bytes, the device takes 12"),
            ([("output", 2, 11)], hd.GLOVE5, "output report 0x02: the device has none; its output reports: 0x01 (12 bytes)"),
            ([("feature", 1, 11)], hd.GLOVE5, "feature report 0x01: the device has none; there 0x01 is of kind output"),
            ([("feature", 9, 11)], hd.GLOVE5, "feature report 0x09: the device has none; nor any feature report"),
            ([("output", 0, 11)], hd.GLOVE5, "output report 0x00: the device has none; it uses report ids"),
            ([("output", 1, 2)], hd.KEYBOARD, "output report 0x01: the device has none; it uses no report ids"),
            ([("output", 0x32, 142)], hd.DUALSENSE_USB, "output report 0x32: the device has none; its output reports: 0x02 (48 bytes)"),
        ],
    )  # fmt: skip
    def test_in_words(self, reports, descriptor, text):
        assert told(profile(*reports, matches=()), descriptor) == text

    def test_reports_without_ids(self):
        assert told(profile(("output", 0, 2), matches=()), hd.KEYBOARD) == ""

    def test_all_of_them_are_said(self):
        given = profile(("output", 1, 13), ("output", 2, 3), matches=())
        with pytest.raises(ParameterError, match=r"0x01: .*; output report 0x02: "):
            check_fit(given, parse_descriptor(hd.GLOVE5), "here")

    def test_shorter_only_where_the_profile_says_so(self):
        def of(length, *short):
            return told(profile(("output", 0x10, length, *short), matches=()), hd.JOYCON)

        assert of(49) == of(10, True) == of(49, True) == ""
        assert "sends 10 bytes, the device takes 49" in of(10)
        assert "sends 50 bytes, the device takes 49" in of(50, True)

    def test_reports_before_and_after_count_too(self):
        given = profile(
            ("output", 1, 12),
            matches=(),
            init=(HidReport("feature", b"\5"),),
            neutral=(HidReport("output", b"\1" + bytes(11)),),
            exit=(HidReport("output", b"\1"), HidReport("output", b"\6\0")),
        )
        text = told(given, hd.GLOVE5)
        assert "feature report 0x05" in text and "output report 0x06" in text
        assert "output report 0x01: the profile sends 1 bytes" in text
        assert [each[:3] for each in wanted_of(given)] == [
            ("output", 1, 12), ("feature", 5, 1), ("output", 1, 1), ("output", 6, 2),
        ]  # fmt: skip

    def test_what_is_short_in_frames_is_short_at_rest(self):
        stop = HidReport("output", b"\x10" + bytes(9))
        assert (
            told(profile(("output", 0x10, 10, True), matches=(), neutral=(stop,)), hd.JOYCON) == ""
        )

    def test_the_usages_of_the_descriptor(self):
        """Where the system did not tell them, this is where they are held against the device."""
        joystick = hd.device(1, 4, hd.field(hd.OUTPUT, 11, number=1))
        text = told(GLOVE_PROFILE, joystick)
        assert (
            text
            == "the profile is for 1209:c0de by usb usage ff00/0001, but the device has the usages 0001/0004"
        )
        assert told(GLOVE_PROFILE, joystick + hd.GLOVE5.replace(b"\x85\1", b"\x85\2")) == ""
        assert told(profile(("output", 1, 12), matches=(Match(0x1209),)), joystick) == ""

    @pytest.mark.parametrize(("page", "usage"), [(0xFF00, 2), (0xFF01, 1)])
    def test_page_and_usage_must_both_be_right(self, page, usage):
        other = hd.device(page, usage, hd.field(hd.OUTPUT, 11, number=1))
        assert f"the device has the usages {page:04x}/{usage:04x}" in told(GLOVE_PROFILE, other)

    def test_a_device_without_usages(self):
        bare = hd.field(hd.OUTPUT, 11, number=1)
        assert "the device has the usages none" in told(GLOVE_PROFILE, bare)
        assert told(profile(("output", 1, 12), matches=(Match(0x1209),)), bare) == ""
