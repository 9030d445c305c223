"""What a header says of a recording: channels, rate, duration, size, preset, error."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from ...encoder.settings import preset_of
from .parts import FileParts, Parts
from .views import View


def facts(
    parts: Parts, views: Sequence[View], *, size: int | None = None, whole: bool = True
) -> list[str]:
    """Returns short texts. size: bytes of the file. whole: all channels and times are shown."""
    count = len(views)
    samples = sum(view.full.sample_count for view in views)
    found = [f"{count} channel{'s' if count != 1 else ''}"]
    found.append(rates([view.channel.rate for view in views]))
    if whole:
        found.append(duration(views[0].stop - views[0].start))
    else:
        found.append(f"from {views[0].start:.6g} s to {views[0].stop:.6g} s")
    found.append(f"{grouped(samples)} sample{'s' if samples != 1 else ''}")
    if size is not None:
        found.append(amount(size) + (compression(samples, size) if whole else " in all"))
    if isinstance(parts, FileParts):
        preset = preset_of(parts.reader.metadata.get("encoder"))[:40]
        if preset:
            found.append(f"preset {preset}")
        if not any(view.is_lossy for view in views):
            found.append("every sample lossless")
    return found


def relative_error(view: View) -> float:
    """Largest error as a share of the range of the original; 0 where there is none."""
    original, errors = view.original, view.errors
    if original is None or errors is None or not errors.largest:
        return 0.0
    known = np.isfinite(original.most)
    # In Python: of doubles it may be infinite.
    reach = float(original.most[known].max()) - float(original.least[known].min())
    return errors.largest / reach if reach else float("inf")


def rates(known: Sequence[Fraction]) -> str:
    low, high = float(min(known)), float(max(known))
    return f"{low:.6g} Hz" if low == high else f"{low:.6g} to {high:.6g} Hz"


def duration(seconds: float) -> str:
    for unit, name in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 3 * unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds:.4g} s"


def grouped(count: int) -> str:
    """3 600 000"""
    return f"{count:,}".replace(",", " ")


def amount(size: int) -> str:
    for unit, name in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if size >= unit:
            return f"{size / unit:.3g} {name}"
    return f"{size} bytes"


def compression(samples: int, size: int) -> str:
    """Against 8 bytes for each sample."""
    if not samples or not size:
        return ""
    ratio = 8 * samples / size
    if ratio >= 1:
        return f" ({ratio:.3g} times smaller than float64)"
    return f" ({1 / ratio:.3g} times larger than float64)"
