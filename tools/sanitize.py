"""Run the tests of the compiled loops under the sanitizers for addresses and undefined behaviour.

python tools/sanitize.py [arguments of pytest]

Builds hapfmt/kernels/*.c with -fsanitize=address,undefined into a copy of the package in a
temporary folder. Says why where it cannot: no compiler, or one without sanitizers.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
TESTS = [
    *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "tests").glob("test_kernels*.py")),
    "tests/test_codecs_predicted.py",
    "tests/test_entropy.py",
    "tests/test_codecs_exact.py",
    "tests/test_codecs_knots.py",
    "tests/test_codecs_knots_coded.py",
    "tests/test_codecs_quantised.py",
    "tests/test_codecs_transform.py",
    "tests/test_tube.py",
    "tests/test_codecs_components.py",
    "tests/test_fuzz.py",
]
PLAIN_TESTS = [
    "tests/test_kernels.py",
    "tests/test_codecs_predicted.py",
    "tests/test_codecs_components.py",
    "tests/test_codecs_transform.py",
]
"""What runs through loops that have a vector form."""

FLAGS = [
    "-std=c99",
    "-ffp-contract=off",
    "-g",
    "-O1",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-shared",
    "-fPIC",
]
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
CHECK = "from hapfmt.kernels import compiled; print(compiled.__file__)"


def compiler() -> list[str]:
    return shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")


def asked(command: list[str], **given: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, check=False, capture_output=True, text=True, **given)


def lacking(folder: Path) -> str | None:
    """Why nothing at all can be built with sanitizers here; None where it can."""
    (folder / "empty.c").write_text("int unused;\n", encoding="utf-8")
    return build(folder / "empty.so", [], [str(folder / "empty.c")])


def build(target: Path, more: list[str], sources: list[str]) -> str | None:
    """None, or why not."""
    include = sysconfig.get_path("include")
    command = [*compiler(), *FLAGS, *more, *SANITIZERS, f"-I{include}", *sources]
    command += ["-lm", "-o", str(target)]
    try:
        done = asked(command)
    except OSError as error:
        return str(error)
    return done.stderr.strip() or "the compiler failed" if done.returncode else None


def runtimes() -> str:
    """The libraries that must be loaded before Python itself."""
    names = ("libasan.so", "libubsan.so")
    found = [asked([*compiler(), f"-print-file-name={name}"]) for name in names]
    return " ".join(path for each in found if os.sep in (path := each.stdout.strip()))


def main() -> int:
    """Once as it is built, once with the loops that every processor has."""
    if sys.argv[1:] in (["--help"], ["-h"]):
        print(__doc__)
        return 0
    return run([], TESTS) or run(["-DHAPFMT_PLAIN"], PLAIN_TESTS)


def run(more: list[str], tests: list[str]) -> int:
    with tempfile.TemporaryDirectory() as folder:
        for name in ("hapfmt", "tests", "conformance"):
            built = shutil.ignore_patterns("*.so", "*.pyd", "__pycache__")
            shutil.copytree(ROOT / name, Path(folder) / name, ignore=built)
        for name in ("SPEC.md", "README.md", "pyproject.toml"):
            shutil.copy(ROOT / name, folder)
        shutil.copytree(ROOT / "docs" / "spec", Path(folder) / "docs" / "spec")
        if why := lacking(Path(folder)):
            print(f"not run: {why}")
            return 0
        sources = [str(path) for path in sorted((ROOT / "hapfmt" / "kernels").glob("*.c"))]
        target = Path(folder) / "hapfmt" / "kernels" / "_kernels.abi3.so"
        if why := build(target, more, sources):
            print(f"the loops do not compile without warnings:\n{why}")
            return 1
        environment = os.environ | {
            "LD_PRELOAD": runtimes(),
            "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=1",
            "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1",
            "PYTHONPATH": folder,
            "PYTHONMALLOC": "malloc",
            # Here it is the memory that is tested, and everything takes ten times as long.
            "HYPOTHESIS_PROFILE": "dev",
        }
        environment.pop("HAPFMT_PURE", None)
        told = asked([sys.executable, "-c", CHECK], cwd=folder, env=environment)
        if not told.stdout.startswith(folder):
            print(f"not run: {(told.stderr or told.stdout).strip()}")
            return 0
        command = [sys.executable, "-m", "pytest", "--capture=sys", *(sys.argv[1:] or tests)]
        return subprocess.run(command, check=False, cwd=folder, env=environment).returncode


if __name__ == "__main__":
    sys.exit(main())
