"""What MkDocs asks while it builds: the files of the site, their order, their Markdown.

Pages keep their paths in the repository, so one relative link works on a forge and on the site.
docs/index.md gives the order. Command and Python references are made here, and nowhere stored.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import command_pages
import python_pages
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
MORE = ["README.md", "SPEC.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE", "conformance/*.md"]
"""Pages outside docs/."""
LINK = re.compile(r"\[([^\]]+)\]\(([^)#]+\.md)\)")
TABS = {"docs/glossary.md": "Glossary", "docs/safety.md": "Safety"}
"""Pages with a tab of their own."""


def on_startup(command: str, **_: Any) -> None:
    # With --quiet, MkDocs would not count warnings either.
    if command == "build":
        logging.getLogger("mkdocs").setLevel(logging.WARNING)


def on_config(config: Any) -> Any:
    config.nav = navigation()
    config.mdx_configs["toc"]["slugify"] = slug
    return config


def slug(title: str, separator: str = "-") -> str:
    """The anchor of a heading, as forges make it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", separator)


def navigation() -> list[Any]:
    """The headings of docs/index.md are tabs, or parts of the tab with the tasks."""
    sections: dict[str, list[Any]] = {}
    for part in re.split(r"^## ", (ROOT / "docs" / "index.md").read_text("utf-8"), flags=re.M)[1:]:
        name, _, text = part.partition("\n")
        sections[name] = [
            {title: path}
            for title, link in LINK.findall(text)
            if (path := in_repository(link)) not in TABS
        ]
    tabs = ["Start", "Commands", "Python", "Format", "Background"]
    start, commands, python, form, background = (sections.pop(name) for name in tabs)
    return [
        {"Start": ["README.md", {"All pages": "docs/index.md"}, *start]},
        {"Tasks": [{name: pages} for name, pages in sections.items()]},
        {"Commands": commands + command_pages.navigation()},
        {"Python": python + python_pages.navigation()},
        {"Format": form},
        *({title: path} for path, title in TABS.items()),
        {"Background": background},
    ]


def in_repository(link: str) -> str:
    """The path of a page that docs/index.md links to."""
    return (ROOT / "docs" / link).resolve().relative_to(ROOT).as_posix()


def on_files(files: Files, *, config: Any) -> Files:
    for file in list(files):
        if file.src_dir == config.docs_dir:
            files.remove(file)
    sources = [
        path for path in (ROOT / "docs").rglob("*") if path.suffix in {".md", ".png", ".svg"}
    ]
    sources += [path for pattern in MORE for path in ROOT.glob(pattern)]
    for path in sorted(sources):
        uri = path.relative_to(ROOT).as_posix()
        files.append(File(uri, str(ROOT), config.site_dir, True, dest_uri=address(uri)))
    style = File("extra.css", str(HERE), config.site_dir, True)
    files.append(style)
    for uri, text in {**command_pages.pages(), **python_pages.pages()}.items():
        files.append(File.generated(config, uri, content=text))
    return files


def address(uri: str) -> str | None:
    """The README is the first page; addresses do not begin with docs/."""
    if uri == "README.md":
        return "index.html"
    if uri == "docs/index.md":
        return "pages/index.html"
    path = uri.removeprefix("docs/")
    if path.endswith(".md"):
        name = re.sub(r"/README$", "", path.removesuffix(".md"))
        return f"{name.lower() if '/' not in path else name}/index.html"
    return path


def on_page_markdown(markdown: str, **_: Any) -> str:
    # The second word of a block names the module that it needs; superfences wants an option.
    return re.sub(r"^( *)```(\w+) (\w+)$", r'\1```\2 title="needs \3"', markdown, flags=re.M)
