"""The optional extension; everything else is in pyproject.toml."""

import os
from pathlib import Path

from setuptools import Extension, setup

FOLDER = Path("hapfmt/kernels")

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
)
