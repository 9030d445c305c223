"""The command line in this process: its exit code and what it says."""

from __future__ import annotations

import io
import sys
from typing import NamedTuple

import pytest

from hapfmt import cli


class Said(NamedTuple):
    code: int
    out: str
    err: str


def called(*words: object) -> Said:
    """Anything but an exit is raised."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["hapfmt", *map(str, words)])
        patch.setattr(sys, "stdout", out)
        patch.setattr(sys, "stderr", err)
        with pytest.raises(SystemExit) as end:
            cli.main()
    texts = []
    for stream in (out, err):
        stream.flush()
        texts.append(stream.buffer.getvalue().decode())  # type: ignore[attr-defined]
    return Said(int(end.value.code or 0), *texts)
