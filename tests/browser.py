"""The page in Chromium, without a network: what it says on the console and what it asks for.

A test fails where the page logs an error, breaks its Content-Security-Policy, or asks for anything
but what the local server gives.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from hapfmt.viewer.export import export
from hapfmt.viewer.server import ServedFile, ViewServer

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
ARGUMENTS = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
SLOW_MS = 60_000


@dataclass
class Seen:
    """What a page did; ``page`` is that of Playwright."""

    page: Any
    allowed: str
    """The beginning of every address that it may ask for."""
    errors: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def check(self) -> None:
        allowed = (self.allowed, "data:", "blob:")
        odd = [f"it asked for {url}" for url in self.asked if not url.startswith(allowed)]
        assert not [*self.errors, *odd], "\n".join([*self.errors, *odd])


@contextmanager
def launched() -> Iterator[Any]:
    """A browser, or a skip with the reason. It is the fixture ``chromium``."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium here")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@contextmanager
def opened(chromium: Any, url: str, allowed: str = "", **options: Any) -> Iterator[Seen]:
    """The page at an address, once all its files are there; it is checked at the end.
    ``options``: those of a context of Playwright, such as ``viewport`` or ``color_scheme``."""
    context = chromium.new_context(**options)
    context.set_default_timeout(SLOW_MS)
    try:
        page = context.new_page()
        seen = Seen(page, allowed or url)
        page.on("request", lambda request: seen.asked.append(request.url))
        page.on("pageerror", lambda error: seen.errors.append(str(error)))
        page.on(
            "console",
            lambda message: seen.errors.append(message.text) if message.type == "error" else None,
        )
        page.add_init_script(
            "addEventListener('securitypolicyviolation', (event) => "
            "console.error(`policy: ${event.violatedDirective} ${event.blockedURI}`));"
        )
        page.goto(url)
        page.evaluate("window.hapf.ready")
        yield seen
        seen.check()
    finally:
        context.close()


@contextmanager
def served(chromium: Any, files: Sequence[Path], hash_: str = "", **options: Any) -> Iterator[Seen]:
    """The page of a server of these files. ``hash_``: the state in the address, such as "#t=1"."""
    with ExitStack() as stack:
        kept = [stack.enter_context(ServedFile(str(path), path.name)) for path in files]
        server = stack.enter_context(ViewServer(kept))
        yield stack.enter_context(opened(chromium, server.url + hash_, server.url, **options))


@contextmanager
def exported(chromium: Any, files: Sequence[Path], page: Path, **options: Any) -> Iterator[Seen]:
    """The page with these files inside, written to ``page`` and opened from there, offline."""
    with ExitStack() as stack:
        kept = [stack.enter_context(ServedFile(str(path), path.name)) for path in files]
        export(kept, page)
    with opened(chromium, page.as_uri(), **options) as seen:
        yield seen
