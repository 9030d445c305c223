"""A file -> the rows of its channels in the catalogue."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from ..encoder.settings import QUANTITY_OF_UNIT, lossy_preset
from ..errors import HapfmtError
from ..lab.parts import FileParts
from ..reading.catalogue import ChannelRef
from ..reading.reader import Reader
from ..reading.verifier import Report
from ..reading.verifier import verify as verify_file
from ..recording import Channel
from .jobs import FileOutcome, Job, content, few_of, hashed


@dataclass
class ChannelStatistics:
    """Statistics of one channel, in its unit. Values that are not finite are left out."""

    samples: int = 0
    finite: int = 0
    low: float = math.inf
    high: float = -math.inf
    squares: float = 0.0
    first: int | None = None
    last: int = 0

    def add(self, channel: Channel) -> None:
        if not channel.stored.size:
            return
        self.first = channel.start_tick if self.first is None else self.first
        self.last = channel.stop_tick
        self.samples += channel.stored.size
        values = channel.samples()
        values = values[np.isfinite(values)]
        if values.size:
            self.finite += values.size
            self.low = min(self.low, float(values.min()))
            self.high = max(self.high, float(values.max()))
            with np.errstate(over="ignore"):
                self.squares += float(np.square(values).sum())  # np.dot starts threads

    def row(self, rate: float) -> dict[str, Any]:
        if self.first is None:
            return {"samples": 0, "missing": 0}
        span = self.last - self.first
        row: dict[str, Any] = {
            "start": self.first / rate,
            "duration": span / rate,
            "samples": self.samples,
            "missing": span - self.samples,
        }
        if self.finite:
            rms = math.sqrt(self.squares / self.finite)
            row |= {"min": self.low, "max": self.high, "rms": rms}
        return row


def describe(job: Job, outcome: FileOutcome) -> None:
    """The rows of one file. A damaged file has rows for what is readable."""
    file = content(job.place)
    threads = job.options.get("threads")
    report = verify_file(file, limits=job.limits, threads=threads)
    outcome.result, outcome.exit_code = report.verdict, report.exit_code
    if report.exit_code:
        found = [report.error.line()] if report.error else []
        outcome.message = "; ".join([*found, *few_of(report.summary)]) or report.judgement()
    about = {
        "file": job.options["file"],
        "file_size": job.place.size,
        "modified": modified_of(job),
        "signature": job.place.signature,
        "checksum": hashed(file, ("sha256",))["sha256"],
        "verdict": report.verdict,
        "error": outcome.message or None,
    }
    outcome.rows = rows_of(file, job, report, about) or [{**about, "channel": None}]


def modified_of(job: Job) -> str | None:
    """Time of the last change of a local file."""
    if job.place.is_url:
        return None
    nanoseconds = int(job.place.signature.rpartition(" ")[2])
    return moment(nanoseconds).isoformat()


def moment(epoch_ns: int) -> datetime:
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=epoch_ns // 1000)


def rows_of(file: Any, job: Job, report: Report, about: dict[str, Any]) -> list[dict[str, Any]]:
    if report.exit_code and report.damage is None:
        return []  # it could not be opened
    try:
        with Reader(
            file, limits=job.limits, scan=True, threads=job.options.get("threads")
        ) as reader:
            about = {**about, **about_file(reader)}
            return [
                {**about, **about_channel(ref), **statistics.row(float(ref.track.rate))}
                for ref, statistics in measured(reader)
            ]
    except HapfmtError:
        return []


def about_file(reader: Reader) -> dict[str, Any]:
    found: dict[str, Any] = {}
    head = reader.catalogue.head
    if head is not None:
        found["uuid"] = str(reader.catalogue.uuid)
        found["encoder"] = lossy_preset(head.encoder) or None
        if head.epoch_ns is not None:
            with suppress(OverflowError):
                found["recorded"] = moment(head.epoch_ns).isoformat()
    return found


def about_channel(ref: ChannelRef) -> dict[str, Any]:
    """What the file says of a channel. Empty texts are left out, so they are null in the table."""
    part = ref.track.components[ref.index]
    texts = {
        "label": part.label,
        "unit": part.unit,
        "quantity": part.quantity or QUANTITY_OF_UNIT.get(part.unit, ""),
        "axis": part.axis,
        "group": part.group,
        "device": part.device,
        "body_site": part.body_site,
    }
    return {
        "channel": ref.number,
        **{name: text for name, text in texts.items() if text},
        "rate": float(ref.track.rate),
        "rate_exact": str(ref.track.rate),
    }


def measured(reader: Reader) -> list[tuple[ChannelRef, ChannelStatistics]]:
    """Statistics of every channel, part by part, so that memory stays bounded."""
    parts = FileParts(reader)
    refs = [ref for ref in parts.refs if not any(track.unsupported for track in ref.tracks)]
    found = {ref.number: ChannelStatistics() for ref in parts.refs}
    edges = parts.edges(*parts.extent())
    for start, stop in zip(edges, edges[1:], strict=False):
        assembly = reader.assembly(refs, start, stop) if refs else None
        for ref in refs:
            assert assembly is not None
            found[ref.number].add(assembly.channel(ref))
    return [(ref, found[ref.number]) for ref in parts.refs]
