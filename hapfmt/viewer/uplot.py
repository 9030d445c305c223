"""uPlot, which draws the lines of the page: found in the package youplot, never imported.

Only the published release 1.6.31 is used: any other bytes are refused by their SHA-256.
"""

from __future__ import annotations

import hashlib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from ..errors import MissingExtraError, ParameterError

VERSION = "1.6.31"
SCRIPT, STYLE = "youplot/vendor/uplot.iife.min.js", "youplot/vendor/uplot.min.css"
SHA256 = {
    SCRIPT: "2d27e8ad3d228164525ce213f9dc716f39b4e3aee0cc773fb3491c96cf4921a2",
    STYLE: "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
}

COPYRIGHT = "uPlot, https://github.com/leeoniya/uPlot: Copyright (c) 2022 Leon Sorokin"
PERMISSION = "Permission is hereby granted"
"""Where the text begins that every MIT License shares; that of the package is the same."""


def uplot() -> tuple[str, str]:
    """Its script, which defines ``uPlot``, and its style sheet.

    Raises MissingExtraError without the package, ParameterError where it holds another release.
    """
    try:
        package = distribution("youplot")
    except PackageNotFoundError:
        raise MissingExtraError("youplot", "view") from None
    script, style = (
        text_of(Path(str(package.locate_file(name))), SHA256[name]) for name in (SCRIPT, STYLE)
    )
    license_ = package.read_text("licenses/LICENSE") or package.read_text("LICENSE") or ""
    if PERMISSION not in license_:
        raise ParameterError("the package youplot comes without the MIT License of uPlot")
    notice = f"/* {COPYRIGHT}\n   MIT License\n\n{license_[license_.index(PERMISSION) :]}*/\n"
    return notice + script, notice + style


def text_of(path: Path, sha256: str) -> str:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        data = b""
    if hashlib.sha256(data).hexdigest() != sha256:
        raise ParameterError(
            f"{path.name} of the package youplot is not that of uPlot {VERSION}; install it again "
            "with: pip install --force-reinstall 'hapfmt[view]'"
        )
    return data.decode("utf-8")
