"""Profiles of hypothesis, small files, and a cap on memory.

Tests of hostile bytes carry the mark ``capped``: while one runs, the process may take 256 MiB of
address space more than it had, so that what asks for more ends in a MemoryError, which is none of
our errors. (Linux only; elsewhere the tests run without.) ``capped(False)`` takes a test out of a
module that carries the mark: threads reserve more address space each than they use.
``capped(bytes)`` sets another cap.
"""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import stalls
from depth import DEEP, PROFILE
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "conformance" / part) for part in ("gen", "adapters/python", "")]

COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("dev", max_examples=10, derandomize=True, **COMMON)
settings.register_profile("brief", max_examples=20, derandomize=True, **COMMON)
settings.register_profile("ci", max_examples=25, derandomize=True, print_blob=True, **COMMON)
settings.register_profile("nightly", max_examples=3000, **COMMON)
settings.load_profile(PROFILE)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # As in the background of a shell: the programs that tests interrupt would inherit it.
    signal.signal(signal.SIGINT, signal.default_int_handler)

if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    # The programs that tests start would compile hapfmt again each time.
    compiled_here = tempfile.mkdtemp(prefix="hapfmt-tests-")
    os.environ["PYTHONPYCACHEPREFIX"] = compiled_here
    atexit.register(shutil.rmtree, compiled_here, ignore_errors=True)


CAP = 256 << 20


@contextmanager
def memory_cap(cap: int = CAP) -> Iterator[None]:
    """Of what is taken within; threads that begin there count with their stacks."""
    status = Path("/proc/self/statm")
    sanitized = "libasan" in os.environ.get("LD_PRELOAD", "")  # which takes address space itself
    if sanitized or not status.exists():
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(status.read_text(encoding="ascii").split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + cap, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deep tests need a deep profile. Without the extension, tests of large inputs do too."""
    from hapfmt.kernels import compiled

    if DEEP:
        return
    later = {"deep"} if compiled else {"deep", "compiled"}
    left_out = [item for item in items if later & {mark.name for mark in item.iter_markers()}]
    config.hook.pytest_deselected(items=left_out)
    gone = set(left_out)
    items[:] = [item for item in items if item not in gone]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    if item.get_closest_marker("realtime") is None:
        return None
    stalls.run(item, nextitem)
    return True


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    mark = item.get_closest_marker("capped")
    if mark is None or mark.args == (False,):
        return (yield)
    with memory_cap(*mark.args):
        return (yield)


@pytest.fixture(scope="session")
def residual_file() -> bytes:
    """LF and HF with a gap: the worked example `residual`."""
    return (ROOT / "conformance" / "examples" / "residual.hapf").read_bytes()


@pytest.fixture(scope="module")  # its event loop runs meanwhile, so other modules must not see it
def chromium() -> Iterator[Any]:
    from browser import launched

    with launched() as browser:
        yield browser


@pytest.fixture
def hidapi() -> None:
    """Skips where the real library is not there."""
    module = pytest.importorskip("hidraw", reason="hidapi is not installed, or not for Linux")
    if not hasattr(module, "device"):
        pytest.skip("the module hidraw is not that of hidapi")
