"""Frames -> a recording of the sent values, .hapf or .csv."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from fractions import Fraction
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from ...convert.csv import column_name, tick_times
from ...errors import ParameterError
from ...files import atomic_write, refuse
from ...recording import Calibration
from ..profile.model import Actuator, Frame, HidReport, Profile

ROWS_AT_ONCE = 1 << 12
DENOMINATORS = (10**3, 10**6, 10**9, 10**12, 10**15)
"""The first that tells the step: 0.001 is 1/1000, and 5 / 32767 of a double is those two."""


class RecordSink:
    """Records the sent values, in each actuator's unit, as counts of its step. There is one
    channel per actuator, and a gap where nothing was sent.

    A context manager: OUT appears complete when the block ends. It holds all values sent until
    then, also after an error. ``metadata`` describes the recording played, and its settings.
    """

    def __init__(
        self,
        path: str,
        profile: Profile,
        *,
        metadata: Mapping[str, Any] | None = None,
        force: bool = False,
        canonical: int | None = None,
    ) -> None:
        """``canonical``: file id of a .hapf, derived only from the recording played."""
        kinds: dict[str, Callable[..., RowWriter]] = {".hapf": HapfRows, ".csv": CsvRows}
        if Path(path).suffix.lower() not in kinds:
            raise ParameterError("what is sent is recorded as .hapf or .csv", path=path)
        refuse(path, force)
        self.path, self.force = path, force
        self.size = profile.timing.frame_samples
        header = {"profile": profile.name, **(metadata or {})}
        calibrations = [calibration_of(actuator, profile) for actuator in profile.actuators]
        kind = kinds[Path(path).suffix.lower()]
        self.make = partial(
            kind,
            profile=profile,
            calibrations=calibrations,
            header=header,
            canonical=canonical,
        )
        self.waiting: list[tuple[int, ...]] = []
        self.first = 0
        """Number of the first sample that waits."""
        self.next = 0
        """Number of the sample after the last."""

    def __enter__(self) -> RecordSink:
        self.stack = ExitStack()
        with ExitStack() as stack:
            stream = stack.enter_context(atomic_write(self.path, force=self.force))
            self.rows: RowWriter = self.make(stream)
            self.stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            with self.stack:
                try:
                    self.flush()
                finally:
                    self.rows.close()
        except Exception as second:
            if error is None:
                raise
            if second is not error:
                error.add_note(f"and what was sent was not recorded: {second}")

    def open(self) -> None:
        """It is open while the block runs."""

    def send(self, frame: Frame, reports: tuple[HidReport, ...]) -> None:  # noqa: ARG002
        """A ``frame`` without counts (at the beginning or end) adds no sample."""
        if not frame.counts:
            return
        first = frame.number * self.size
        if first != self.next or len(self.waiting) >= ROWS_AT_ONCE:
            self.flush()
            self.first = first
        self.waiting.extend(frame.counts)
        self.next = first + len(frame.counts)

    def close(self) -> None:
        """The block ends it."""

    def flush(self) -> None:
        if self.waiting:
            self.rows.write(self.first, np.array(self.waiting, np.int64))
            self.waiting.clear()
        self.first = self.next


class RowWriter(Protocol):
    """Where rows [samples, actuators] of counts go."""

    def write(self, first: int, counts: NDArray[np.int64]) -> None: ...
    def close(self) -> None: ...


class HapfRows:
    def __init__(
        self,
        stream: BinaryIO,
        profile: Profile,
        calibrations: list[Calibration],
        header: dict[str, Any],
        canonical: int | None,
    ) -> None:
        from ...writing.recorder import Input, Recorder

        inputs = [
            Input(
                actuator.name,
                profile.timing.rate,
                actuator.unit,
                actuator.quantity,
                body_site=actuator.body_site,
                device=profile.name,
                calibration=calibration,
                bits=bits_of(actuator, profile),
            )
            for actuator, calibration in zip(profile.actuators, calibrations, strict=True)
        ]
        self.recorder = Recorder(stream, inputs, metadata={"replay": header}, canonical=canonical)

    def write(self, first: int, counts: NDArray[np.int64]) -> None:
        self.recorder.write_rows(counts, first)

    def close(self) -> None:
        self.recorder.close()


class CsvRows:
    """A comment with the metadata, a header, a row for each sample; no row is a gap."""

    def __init__(
        self,
        stream: BinaryIO,
        profile: Profile,
        calibrations: list[Calibration],
        header: dict[str, Any],
        canonical: int | None,  # noqa: ARG002
    ) -> None:
        self.stream, self.calibrations = stream, calibrations
        self.rate = profile.timing.rate
        names = [column_name(actuator.name, actuator.unit) for actuator in profile.actuators]
        self.put(f"# replay: {json.dumps(header, sort_keys=True)}\n{','.join(['t [s]', *names])}\n")

    def put(self, text: str) -> None:
        self.stream.write(text.encode("utf-8"))

    def write(self, first: int, counts: NDArray[np.int64]) -> None:
        columns = [
            calibration.physical(column).tolist()
            for calibration, column in zip(self.calibrations, counts.T, strict=True)
        ]
        times = tick_times(first, first + len(counts), self.rate)
        self.put("".join(f"{time},{','.join(map(repr, row))}\n"
                         for time, *row in zip(times, *columns, strict=True)))  # fmt: skip

    def close(self) -> None:
        """The stream is the caller's."""


def calibration_of(actuator: Actuator, profile: Profile) -> Calibration:
    """Its step as the simplest fraction that is the same double."""
    for limit in DENOMINATORS:
        step = Fraction(actuator.step).limit_denominator(limit)
        if float(step) == actuator.step:
            low, high = profile.limits(actuator)[:2]
            calibration = Calibration(step.numerator, 0, step.denominator)
            if calibration.covers(low, high):
                return calibration
    raise ParameterError(
        f"counts of the step of {actuator.name!r}, {actuator.step:g}, cannot be recorded exactly"
    )


def bits_of(actuator: Actuator, profile: Profile) -> int:
    """That its counts need, signed."""
    low, high = profile.limits(actuator)[:2]
    return max(max(high, -low - 1, 0).bit_length() + 1, 2)
