"""The optional extension; everything else is in pyproject.toml."""

from setuptools import Extension, setup

FOLDER = "hapfmt/kernels"
SOURCES = [
    "module",
    "lpcr",
    "sweep",
    "links",
    "tube",
    "knots",
    "select",
    "huffman",
    "levels",
    "exact",
    "rice",
]
HEADERS = ["kernels", "coder", "lpcr", "search", "rice", "grid", "tube"]

setup(
    ext_modules=[
        Extension(
            "hapfmt.kernels._kernels",
            [f"{FOLDER}/{name}.c" for name in SOURCES],
            depends=[f"{FOLDER}/{name}.h" for name in HEADERS],
            extra_compile_args=["-O3", "-std=c99", "-ffp-contract=off"],
            py_limited_api=True,
            optional=True,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
