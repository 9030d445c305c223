"""Keeps a private world: namespaces of its own, in which this is process 1.

Started by the test with a socket for commands, and one for each device. Whatever becomes of the
test, this process gets SIGKILL when it ends (or sees the end of its socket), with it go all
processes of the namespace, and with the last of them all that is mounted.
"""

from __future__ import annotations

import array
import json
import os
import select
import signal
import socket
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any

from . import fuse, linux, sysfs, uhid, umock
from .channel import Channel
from .model import Device, Setup

FOLDER = "shm"  # of /dev: nodes are files on a tmpfs of our own over it
MESSAGE = 1 << 18


class Keeper:
    def __init__(self, control: socket.socket, setup: Setup, channels: list[Channel]) -> None:
        self.apart = True
        """In namespaces of its own."""
        self.control = control
        self.setup = setup
        self.channels = channels

    def build(self) -> None:
        """What is private here."""
        if not self.apart:
            return
        linux.mount("none", "/", None, linux.MS_REC | linux.MS_PRIVATE)
        linux.mount("proc", "/proc", "proc")
        if self.setup.tier == "fuse":
            linux.mount("tmpfs", f"/dev/{FOLDER}", "tmpfs", data="mode=1777")
            system = os.open("/sys/devices/system", os.O_PATH)
            linux.mount("tmpfs", "/sys", "tmpfs", data="mode=755")
            sysfs.build(Path("/sys"), list(self.setup.devices), FOLDER)
            under = Path("/sys/devices/system")  # of processors: numpy and others look there
            under.mkdir(parents=True)
            linux.mount(f"/proc/self/fd/{system}", str(under), None, linux.MS_BIND | linux.MS_REC)
            os.close(system)

    def serve_devices(self) -> None:
        """A process for each."""
        for number, device in enumerate(self.setup.devices):
            parent = os.getpid()
            if os.fork():
                self.channels[number].close()
                continue
            code = 1
            try:
                linux.die_with_parent(parent)
                self.control.close()
                for other in self.channels[number + 1 :]:
                    other.close()
                self.serve_device(number, device)
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)

    def serve_device(self, number: int, device: Device) -> None:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        if self.setup.tier == "uhid":
            uhid.main(self.channels[number], device)
            return
        if self.setup.tier == "umockdev":
            self.become_umockdev(self.channels[number].fileno(), device)
        path = Path(f"/dev/{FOLDER}/hidraw{number}")
        path.touch()
        slow_ms = self.setup.slow_ms[number]
        fuse.main(self.channels[number], device, number, slow_ms, str(path), self.setup.fuse)

    def become_umockdev(self, channel: int, device: Device) -> None:
        """Another Python, since this one may not have the bindings."""
        os.set_inheritable(channel, True)
        slow_ms, folder = self.setup.slow_ms[0], self.setup.folder
        told = [str(channel), json.dumps(device.to_json()), str(slow_ms), folder]
        start = f"import sys; sys.path.insert(0, {sys.path[0]!r}); from virtual_hid.umock import main; main()"
        environment = {**os.environ, **umock.environment()}
        os.execve(self.setup.python, [self.setup.python, "-c", start, *told], environment)

    def serve(self) -> None:
        """Commands, and what becomes of processes, until the test goes."""
        while True:
            ready, _, _ = select.select([self.control, self.wake], [], [])
            if self.wake in ready:
                self.wake.recv(4096)
                self.reap()
            if self.control not in ready:
                continue
            data, files = self.receive()
            if not data:
                return
            self.tell(**self.command(json.loads(data), files))
            for each in files:
                os.close(each)

    def receive(self) -> tuple[bytes, list[int]]:
        data, extra, *_ = self.control.recvmsg(MESSAGE, socket.CMSG_SPACE(3 * 4))
        files = array.array("i")
        for _, kind, content in extra:
            if kind == socket.SCM_RIGHTS:
                files.frombytes(content)
        return data, list(files)

    def tell(self, **message: Any) -> None:
        try:
            self.control.send(json.dumps(message).encode())
        except (BrokenPipeError, ConnectionResetError):
            os._exit(0)

    def command(self, message: dict[str, Any], files: list[int]) -> dict[str, Any]:
        match message["do"]:
            case "start":
                return self.start(message, files)
            case "signal":
                try:
                    os.kill(message["pid"], message["signal"])
                except ProcessLookupError:
                    return {"error": f"no process {message['pid']}"}
                return {}
            case "processes":
                return {"processes": processes(not self.apart)}
            case other:
                return {"error": f"no such command: {other}"}

    def start(self, message: dict[str, Any], files: list[int]) -> dict[str, Any]:
        """A child whose standard files are those given, in a session of its own."""
        words = message["words"]
        pid = os.fork()
        if pid:
            return {"pid": pid}
        try:
            signal.set_wakeup_fd(-1)
            for number in (signal.SIGCHLD, signal.SIGPIPE, signal.SIGINT):
                signal.signal(number, signal.SIG_DFL)
            os.setsid()
            for place, each in enumerate(files):
                os.dup2(each, place)
            os.chdir(message["cwd"])
            os.execvpe(words[0], words, message["env"])
        except BaseException as error:
            os.write(2, f"{words[0]}: {error}\n".encode())
        finally:
            os._exit(127)

    def reap(self) -> None:
        """As process 1: orphans too."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if not pid:
                return
            self.tell(ended=pid, code=os.waitstatus_to_exitcode(status))

    def run(self) -> None:
        self.wake, waker = socket.socketpair()
        waker.setblocking(False)
        self.wake.setblocking(False)
        signal.set_wakeup_fd(waker.fileno())
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        self.build()
        self.serve_devices()
        self.tell(ready=True)
        self.serve()


def processes(only_ours: bool = False) -> list[dict[str, Any]]:
    """All of this world but for this one; without namespaces, those that descend from it."""
    found: dict[int, dict[str, Any]] = {}
    me = os.getpid()
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit() or int(folder.name) == me:
            continue
        try:
            stat = (folder / "stat").read_text(encoding="utf-8", errors="replace")
            words = (folder / "cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue  # it has just ended
        state, parent = stat.rsplit(")", 1)[1].split()[:2]
        if state != "Z":
            one = {"pid": int(folder.name), "parent": int(parent)}
            found[int(folder.name)] = {**one, "words": words.split("\0")[:-1]}

    def ours(one: dict[str, Any]) -> bool:
        return one["parent"] == me or (one["parent"] in found and ours(found[one["parent"]]))

    return [one for one in found.values() if not only_ours or ours(one)]


def setup_of(text: str) -> Setup:
    values = json.loads(text)
    devices = tuple(Device.from_json(x) for x in values.pop("devices"))
    return Setup(devices, **{**values, "slow_ms": tuple(values["slow_ms"])})


def main() -> None:
    """``parent setup fd fd...``: the test's process, what to build, its sockets."""
    parent, text, control, *devices = sys.argv[1:]
    linux.die_with_parent(int(parent))
    connection = socket.socket(fileno=int(control))
    setup = setup_of(text)
    channels = [Channel(socket.socket(fileno=int(each))) for each in devices]
    keeper = Keeper(connection, setup, channels)
    try:
        linux.own_namespaces()
    except OSError as error:
        if setup.tier == "umockdev":
            without(keeper)
        else:
            keeper.tell(error=f"no namespaces of its own: {error.strerror}")
        return
    child = os.fork()
    if child:
        connection.close()
        for each in channels:
            each.close()
        os.waitpid(child, 0)
        return
    linux.check(linux.libc.prctl(linux.PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0), "prctl")
    try:
        # Who is one's parent cannot be asked from within: it has no number here.
        keeper.run()
    except OSError as error:
        keeper.tell(error=str(error))
    except BaseException:
        keeper.tell(error=traceback.format_exc())
    finally:
        os._exit(0)


def without(keeper: Keeper) -> None:
    """No namespaces: what is started here is taken in when its parent dies, and killed at the end.
    If this process is killed too, only those of its own die with it."""
    keeper.apart = False
    linux.check(linux.libc.prctl(linux.PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0), "prctl")
    try:
        keeper.run()
    finally:
        signal.set_wakeup_fd(-1)
        while left := processes(only_ours=True):
            for each in left:
                with suppress(ProcessLookupError):
                    os.kill(each["pid"], signal.SIGKILL)
            keeper.reap()
