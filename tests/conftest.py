"""Profiles of hypothesis, small files, and a cap on memory.

Tests of hostile bytes carry the mark ``capped``: while one runs, the process may take 256 MiB of
address space more than it had, so that what asks for more ends in a MemoryError, which is none of
our errors. (Linux only; elsewhere the tests run without.) ``capped(False)`` takes a test out of a
module that carries the mark: threads reserve more address space each than they use.
``capped(bytes)`` sets another cap.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import stalls
from depth import DEEP, PROFILE, runs_pure
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

# Each worker, and each program that tests start, would compile the same modules again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

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


def pytest_configure() -> None:
    """Ten thousand tests live until the end: to look for garbage among them takes a fifth of the time."""
    gc.disable()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Two workers that compile the modules in one order compile all of them: the second begins at
    the end, and each finds the other half compiled."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
    if worker == "gw1" and not session.config.getoption("file_or_dir"):
        found = sorted(Path(__file__).parent.glob("test_*.py"), reverse=True)
        for path in found[: len(found) // 2]:
            if not pytest_ignore_collect(path):
                with suppress(Exception, pytest.skip.Exception):  # which collecting will tell
                    import_module(path.stem)


def pytest_collection_finish() -> None:
    gc.enable()
    gc.collect()
    gc.freeze()


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Without the extension: modules that it changes nothing for, unless they are named."""
    from hapfmt.kernels import compiled

    left_out = compiled is None and not DEEP and not runs_pure(collection_path.name)
    return True if left_out else None


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
