"""One device of a world, as the test sees it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from .channel import Channel
from .model import Device, Event, Fault

SECONDS = 60.0


class Virtual:
    def __init__(self, device: Device, channel: Channel) -> None:
        self.device, self.channel = device, channel
        self.seen: list[Event] = []
        self.path = ""
        """Of its node, within the world."""
        self.env: dict[str, str] = {}
        """For programs that are to see it."""
        self.refused = ""
        """Which real-time settings its server did not get."""

    def begin(self) -> str:
        """Why it is not there; empty where it is."""
        try:
            got = self.channel.receive()
        except EOFError:
            return "the server of the device ended at once"
        self.path, self.refused = got.get("path", ""), got.get("refused", "")
        self.env = got.get("env", {})
        return str(got.get("error", ""))

    @property
    def events(self) -> list[Event]:
        """All until now."""
        while True:
            got = self.ask(do="events", first=len(self.seen))
            self.seen += [Event.from_json(x) for x in got["events"]]
            if not got["more"]:
                return list(self.seen)

    @property
    def reports(self) -> list[Event]:
        """Those that the device has, in the order it took them."""
        return [x for x in self.events if x.taken]

    def befall(self, fault: Fault) -> None:
        self.ask(do="fault", fault=fault.to_json())

    def unplug(self) -> None:
        """Now, and no longer to be found."""
        self.befall(Fault("unplug"))

    def clear(self) -> None:
        """No more faults from now on; what is unplugged stays so."""
        self.ask(do="clear")

    def say(self, data: bytes) -> None:
        """An input report."""
        self.ask(do="say", data=data.hex())

    def ask(self, **message: Any) -> dict[str, Any]:
        answer = self.channel.ask(**message)
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer

    def wait_for(
        self, found: Callable[[list[Event]], object], seconds: float = SECONDS
    ) -> list[Event]:
        """The events, as soon as ``found`` is true of them."""
        end = time.monotonic() + seconds
        while not found(events := self.events):
            if time.monotonic() > end:
                raise TimeoutError(f"not seen in {seconds} s; last of {len(events)}: {events[-5:]}")
            time.sleep(0.002)
        return events
