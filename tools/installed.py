"""Which hapfmt is measured: the installed one. Every tool imports this module first.

A clone also holds the package, but without compiled loops unless it was installed in place. So the
folder of the clone leaves the import path when another hapfmt is installed. Without an installed
hapfmt, or without its compiled loops, the tool prints the reason and ends with exit code 1.
HAPFMT_PURE=1 measures the readable Python loops on purpose.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from importlib.metadata import Distribution, distributions
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

ROOT = Path(__file__).resolve().parent.parent
TOOLS = ROOT / "tools"
PURE = "HAPFMT_PURE"


IMPORTS = {"PYTHONPATH": str(TOOLS), "PYTHONSAFEPATH": "1"}
"""For child processes: they import the tools, and the installed hapfmt whatever their folder is."""


def environment(**more: str) -> dict[str, str]:
    """That of this process, with IMPORTS."""
    return {**os.environ, **IMPORTS, **more}


def editable_root(distribution: Distribution) -> Path | None:
    """The folder that an editable installation points at; None for a copy."""
    source = json.loads(distribution.read_text("direct_url.json") or "{}")
    if not source.get("dir_info", {}).get("editable"):
        return None
    return Path(url2pathname(urlsplit(source["url"]).path)).resolve()


def find() -> None:
    """Take the clone from the import path, unless it is what is installed."""
    elsewhere = [entry for entry in sys.path if Path(entry or ".").resolve() != ROOT]
    distribution = next(iter(distributions(name="hapfmt", path=elsewhere)), None)
    if distribution is None:
        sys.exit(
            f"hapfmt is not installed for {sys.executable}; run this in the clone: "
            "python -m pip install -e '.[bench]'"
        )
    if editable_root(distribution) != ROOT:
        sys.path[:] = elsewhere


def require_loops() -> None:
    """End the tool if the loops are not compiled and HAPFMT_PURE is not set."""
    from hapfmt.kernels import compiled

    if compiled is None and not os.environ.get(PURE):
        sys.exit(
            "The installed hapfmt has no compiled loops, so its speed is not worth publishing. "
            "With a C compiler, run this in the clone: python -m pip install --force-reinstall "
            f"--no-deps -e . (or set {PURE}=1 to measure the readable Python loops)"
        )


def describe() -> str:
    """Version, commit, kind of installation, and whether the loops are compiled."""
    import hapfmt
    from hapfmt.kernels import compiled
    from hapfmt.version import __version__

    package = Path(hapfmt.__file__).resolve().parent
    here = package.parent == ROOT
    if (package.parent / ".git").exists() or here:
        kind, known = "installed in place", commit(package.parent)
    elif same_code(package):
        kind, known = "an installed copy of this commit", commit(ROOT)
    else:
        kind, known = "an installed copy with other code than this clone", "unknown"
    loops = "compiled loops" if compiled else "readable Python loops"
    return f"hapfmt {__version__}, commit {known}, {kind}, {loops}"


def commit(folder: Path) -> str:
    """As ``git describe`` names it, with a + where files differ from the commit."""
    git = ["git", "-C", str(folder), "describe", "--always", "--tags", "--dirty=+"]
    try:
        done = subprocess.run(git, capture_output=True, text=True, check=False)
    except OSError:
        return "unknown"
    return done.stdout.strip() or "unknown"


def same_code(package: Path) -> bool:
    """Whether the Python files of an installed copy are those of this clone."""
    own, other = ({str(path.relative_to(at)): path.read_bytes() for path in at.rglob("*.py")}
                  for at in (ROOT / "hapfmt", package))  # fmt: skip
    return own == other


if "hapfmt" not in sys.modules:  # a test that measures has chosen its hapfmt already
    find()
    require_loops()

if __name__ == "__main__":
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    print(describe())
