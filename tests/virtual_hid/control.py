"""What a test may ask of a device that is served by a node of ours."""

from __future__ import annotations

import time
from typing import Any

from .behaviour import Node
from .log import Log
from .model import Fault


def command(node: Node, log: Log, message: dict[str, Any]) -> dict[str, Any]:
    match message.pop("do"):
        case "events":
            return log.since(message["first"])
        case "fault":
            node.befall(Fault(**message["fault"]), time.monotonic_ns())
        case "clear":
            node.faults.clear()
        case "say":
            node.say(bytes.fromhex(message["data"]))
        case other:
            return {"error": f"no such command: {other}"}
    return {}
