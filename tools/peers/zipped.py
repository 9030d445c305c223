"""One file of blobs with their names: a plain zip, as an .npz is one, and smaller than HDF5."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from typing import Any

SIDE = 4
"""Bytes of side information that count for each channel: few, for a floor, a step or an offset."""


def coded_size(blobs: Sequence[bytes]) -> int:
    """Coded bytes, and SIDE for each channel; a constant channel has an empty blob."""
    return sum(len(blob) + SIDE for blob in blobs)


def file_size(blobs: Sequence[bytes], labels: Sequence[str], description: dict[str, Any]) -> int:
    """Bytes of the zip: a member for each channel, stored, and one of JSON, deflated."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        text = json.dumps(description, separators=(",", ":"))
        archive.writestr("info.json", text, zipfile.ZIP_DEFLATED)
        for place, (blob, label) in enumerate(zip(blobs, labels, strict=True)):
            if blob:
                archive.writestr(label or str(place), blob, zipfile.ZIP_STORED)
    return len(stream.getvalue())
