"""Build the documentation site, or serve it while you edit.

    .venv/bin/python tools/website                # into build/website
    .venv/bin/python tools/website -o FOLDER
    .venv/bin/python tools/website --serve

Any warning of MkDocs ends the build: a broken link, an anchor or a page that is not listed.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
import installed  # noqa: E402

CONFIG = HERE / "mkdocs.yml"
OUTPUT = installed.ROOT / "build" / "website"
BUILT = "search/search_index.json"
"""A folder with this file is an earlier site, which a build replaces."""


def run(*words: str) -> int:
    """``mkdocs`` with these words; its exit code."""
    # A notice of Material for its sponsors, on every build.
    os.environ.setdefault("NO_MKDOCS_2_WARNING", "1")
    try:
        from mkdocs.__main__ import cli
    except ImportError:
        sys.exit("the site needs MkDocs: python -m pip install -e '.[site]'")
    try:
        code = cli.main([*words, "--config-file", str(CONFIG)], standalone_mode=False)
    except SystemExit as ended:  # a build with warnings
        code = ended.code
    return code if isinstance(code, int) else 0


def build(folder: Path) -> int:
    """Builds into a new folder, which then takes the place of an earlier site."""
    if folder.exists() and any(folder.iterdir()) and not (folder / BUILT).is_file():
        sys.exit(f"{folder} holds something else than this site; choose another folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as room:
        new, old = Path(room, "new"), Path(room, "old")
        code = run("build", "--strict", "--site-dir", str(new))
        if code == 0:
            if folder.exists():
                folder.rename(old)
            shutil.move(new, folder)
            print(f"{folder}: {len(list(folder.rglob('*.html')))} pages")
    return code


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python tools/website", description=__doc__.split("\n")[0]
    )
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument("-o", "--output", type=Path, default=OUTPUT, metavar="FOLDER")
    choice.add_argument("--serve", action="store_true", help="on http://127.0.0.1:8000")
    given = parser.parse_args()
    if given.serve:
        return run("serve", "--strict")
    return build(given.output.resolve())


if __name__ == "__main__":
    sys.exit(main())
