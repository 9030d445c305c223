"""The optional extension and the project's addresses; everything else is in pyproject.toml."""

import os
from pathlib import Path

from setuptools import Extension, setup

FOLDER = Path("hapfmt/kernels")
PAGES = {
    "Homepage": "",
    "Source": "",
    "Documentation": "/blob/main/docs/index.md",
    "Format": "/blob/main/SPEC.md",
    "Changes": "/blob/main/CHANGELOG.md",
    "Issues": "/issues",
}


def addresses() -> dict[str, str]:
    """Pages of the repository that publishes: its address is known only where that happens."""
    found = os.environ.get("HAPFMT_REPOSITORY", "").rstrip("/")
    if found:
        return {name: found + page for name, page in PAGES.items()}
    before = Path("PKG-INFO")  # of the sdist that this wheel is made from
    lines = before.read_text("utf-8").split("\n\n")[0].splitlines() if before.exists() else []
    rows = [line.removeprefix("Project-URL: ") for line in lines if line.startswith("Project-URL")]
    return dict(row.split(", ", 1) for row in rows)


setup(
    ext_modules=[
        Extension(
            "hapfmt.kernels._kernels",
            sorted(path.as_posix() for path in FOLDER.glob("*.c")),
            depends=sorted(path.as_posix() for path in FOLDER.glob("*.h")),
            libraries=["m"] if os.name == "posix" else [],
            extra_compile_args=["-O3", "-std=c99", "-ffp-contract=off", "-g0"],
            py_limited_api=True,
            optional=True,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
    project_urls=addresses(),
)
