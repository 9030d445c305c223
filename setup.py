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
                    "links",
                    "tube",
                    "knots",
                    "select",
                    "huffman",
                    "levels",
                )
            ],
            depends=[f"hapfmt/kernels/{name}.h" for name in ("kernels", "grid", "tube")],
            extra_compile_args=["-O3", "-std=c99"],
            py_limited_api=True,
            optional=True,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
