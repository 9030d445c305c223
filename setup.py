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
                )
            ],
            depends=["hapfmt/kernels/kernels.h", "hapfmt/kernels/tube.h"],
            extra_compile_args=["-O3", "-std=c99"],
            py_limited_api=True,
            optional=True,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
