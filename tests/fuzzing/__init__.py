"""What a fuzzer tries: one table of targets, replayed by tests/test_fuzz.py over tests/corpus/ and
run by tools/fuzz.py."""

from __future__ import annotations

from .appended import APPENDED
from .decoders import DECODERS
from .devices import DEVICES
from .edited import EDITED
from .files import FILES
from .foreign import FOREIGN
from .parsers import PARSERS
from .recovered import RECOVERED
from .streams import STREAMS
from .target import Target

TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        *PARSERS,
        *DECODERS,
        *FILES,
        *APPENDED,
        *EDITED,
        *RECOVERED,
        *STREAMS,
        *FOREIGN,
        *DEVICES,
    )
}

__all__ = ["TARGETS", "Target"]
