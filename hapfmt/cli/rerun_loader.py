"""rerun-loader-hapf: shows .hapf files in Rerun, which calls it for each file that it opens.

It prints the recording as an .rrd stream on standard output. Exit code 66 tells Rerun that a file
is not for this program.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import HapfmtError, MissingExtraError, ParameterError
from . import ERROR, screen

if TYPE_CHECKING:
    from ..reading.reader import Reader
    from ..recording import Channel

NOT_OURS = 66
"""Exit code of Rerun's protocol."""
TIME, UTC = "recording_time", "utc"
_NS = 10**9
_TIME_LIMIT = 1 << 63


@click.command(
    context_settings={
        "ignore_unknown_options": True,
        "allow_extra_args": True,
        "help_option_names": ["-h", "--help"],
    }
)
@click.argument("file", metavar="FILE")
@click.option("--application-id", metavar="ID", help="Name of the application in Rerun.")
@click.option("--recording-id", metavar="ID", help="The recording in Rerun that gets the data.")
@click.option("--entity-path-prefix", metavar="PATH", help="Goes in front of all entity paths.")
def main(
    file: str, application_id: str | None, recording_id: str | None, entity_path_prefix: str | None
) -> None:
    """Print a .hapf FILE as a stream for Rerun. Rerun runs this program by itself."""
    if Path(file).suffix.lower() != ".hapf" or not Path(file).is_file():
        sys.exit(NOT_OURS)
    try:
        show(file, application_id or Path(file).stem, recording_id, entity_path_prefix)
    except (HapfmtError, OSError) as error:
        screen.say(f"rerun-loader-hapf: {error}", err=True)
        sys.exit(ERROR)


def show(file: str, application: str, recording: str | None, prefix: str | None) -> None:
    try:
        import rerun as rr
    except ImportError:
        raise MissingExtraError("rerun-sdk", "rerun") from None
    from ..reading.reader import Reader

    with Reader(file, strict=True, scan=True) as reader:
        stream = rr.RecordingStream(application, recording_id=recording)
        stream.stdout()
        _Shown(rr, stream, reader, prefix).send()
        stream.flush()
        stream.disconnect()


class _Shown:
    """A file on its way to Rerun."""

    def __init__(self, rr: Any, stream: Any, reader: Reader, prefix: str | None) -> None:
        self.rr = rr
        self.stream = stream
        self.reader = reader
        self.prefix = [part for part in (prefix or "").split("/") if part]
        end_ns = int(reader.duration * _NS)
        if end_ns >= _TIME_LIMIT:
            raise ParameterError("Rerun holds times up to 292 years, and the recording is longer")
        head = reader.catalogue.head
        epoch_ns = head.epoch_ns if head else None
        is_held = epoch_ns is not None and epoch_ns + end_ns < _TIME_LIMIT
        self.epoch_ns = epoch_ns if is_held else None

    def send(self) -> None:
        self.events()
        paths: list[str] = []
        ends: dict[int, int] = {}
        for start, stop in windows(self.reader):
            part = self.reader.read(start=start, stop=stop)
            if not paths:
                paths = self.describe(part.channels)
            for number, channel in enumerate(part.channels):
                self.samples(paths[number], channel, ends.get(number))
                ends[number] = channel.stop_tick if channel.coverage else ends.get(number, 0)
            self.stream.flush()  # else the stream would queue the whole file

    def describe(self, channels: Sequence[Channel]) -> list[str]:
        from ..recording import unique

        labels = [channel.label.strip() or f"channel {n}" for n, channel in enumerate(channels)]
        paths = []
        for label, channel in zip(unique(labels, []), channels, strict=True):
            path = self.rr.new_entity_path([*self.prefix, label])
            name = label if channel.unit == "1" else f"{label} [{channel.unit}]"
            lines = self.rr.SeriesLines(names=name)
            self.rr.log(path, lines, static=True, recording=self.stream)
            paths.append(path)
        return paths

    def samples(self, path: str, channel: Channel, end: int | None) -> None:
        """Sends the samples; a line breaks where ``Clear`` is. ``end``: the last tick before."""
        import numpy as np

        if not channel.coverage:
            return
        spans = channel.coverage
        stops = ([end] if end else []) + [span.stop for span in spans]
        starts = [span.start for span in spans][0 if end else 1 :]
        gaps = [a for a, b in zip(stops, starts, strict=False) if a < b]
        ticks = np.concatenate([np.arange(span.start, span.stop) for span in spans])
        scalars = self.rr.Scalars.columns(scalars=channel.samples())
        self.columns(path, _times(ticks, channel.rate_exact), scalars)
        if gaps:
            clear = self.rr.Clear.columns(is_recursive=[False] * len(gaps))
            self.columns(path, _times(np.array(gaps), channel.rate_exact), clear)

    def events(self) -> None:
        import numpy as np

        layers: dict[str, list[tuple[int, str]]] = {}
        for event in self.reader.events():
            row = (int(event.time * _NS), event.text)
            layers.setdefault(event.layer, []).append(row)
        for layer, rows in layers.items():
            path = self.rr.new_entity_path([*self.prefix, "events", *([layer] if layer else [])])
            times = np.array([time for time, _ in rows])
            self.columns(path, times, self.rr.TextLog.columns(text=[text for _, text in rows]))

    def columns(self, path: str, times_ns: Any, columns: Any) -> None:
        time = self.rr.TimeColumn(TIME, duration=times_ns.astype("timedelta64[ns]"))
        indexes = [time]
        if self.epoch_ns is not None:
            utc = (times_ns + self.epoch_ns).astype("datetime64[ns]")
            indexes.append(self.rr.TimeColumn(UTC, timestamp=utc))
        self.rr.send_columns(path, indexes, columns, recording=self.stream)


def _times(ticks: Any, rate: Fraction) -> Any:
    """In ns from the zero of the recording."""
    import numpy as np

    from ..convert.timestamps import stamps_of

    return stamps_of(np.zeros(len(ticks), np.int64), ticks, rate, 0)


def windows(reader: Reader) -> Iterator[tuple[Fraction, Fraction]]:
    """Seconds of about a cluster each, that together hold every sample."""
    starts = sorted({chunk.start_ns for chunk in reader.catalogue.data if chunk.start_ns})
    first = Fraction(0)
    for start in starts:
        edge = Fraction(start, _NS)
        if edge - first >= 1:
            yield first, edge
            first = edge
    yield first, max(reader.duration, first) + 1
