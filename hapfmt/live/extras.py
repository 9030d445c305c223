"""What stands beside the samples: events and clock observations, in the cluster of their time."""

from __future__ import annotations

from ..container.filewriter import FileWriter


class Extras:
    """Collects them until a cluster is written."""

    def __init__(self, *, maps: bool) -> None:
        self.maps = maps

    def write_observations(self, writer: FileWriter) -> None: ...
    def write_maps(self, writer: FileWriter) -> None: ...
