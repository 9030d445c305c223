"""The optional extension; everything else is in pyproject.toml."""

from setuptools import Extension, setup

setup(
    ext_modules=[
        Extension(
            "hapfmt.kernels._kernels",
            [
                f"hapfmt/kernels/{name}.c"
                for name in (
                    "module",
                    "lpcr",
                    "sweep",
                    "tube",
                    "knots",
                    "select",
                    "huffman",
                    "levels",
                    "exact",
                )
            ],
            depends=[
                f"hapfmt/kernels/{name}.h"
                for name in ("kernels", "coder", "lpcr", "search", "tube")
            ],
            extra_compile_args=["-O3", "-std=c99", "-ffp-contract=off"],
            py_limited_api=True,
            optional=True,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
