"""The optional extension; everything else is in pyproject.toml."""

from setuptools import Extension, setup

setup(
    ext_modules=[
        Extension(
            "hapfmt.kernels._kernels",
            ["hapfmt/kernels/_kernels.c"],
            depends=["hapfmt/kernels/exact.h"],
            extra_compile_args=["-O3", "-std=c99"],
            py_limited_api=True,
            optional=True,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
