"""The documentation site: it builds without warnings, names every command, option and public name,
shows what a forge shows, and loads nothing from other hosts."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path

import click
import pytest
from spec import ROOT

pytestmark = [
    pytest.mark.deep,
    pytest.mark.skipif(find_spec("mkdocstrings") is None, reason="needs the extra site"),
]
LOADED = {
    "script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src", "audio": "src",
    "object": "data", "embed": "src", "link": "href", "use": "href",
}  # fmt: skip
"""Elements that load what an attribute names."""
COMPARED = {"p", "ul", "ol", "li", "table", "tr", "td", "h1", "h2", "h3", "h4", "img", "strong"}


class Elements(HTMLParser):
    """The elements of a page: (name, attributes)."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def build(clone: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(clone / "tools" / "website"), *words],
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site") / "built"
    done = build(ROOT, "-o", str(folder))
    assert done.returncode == 0, done.stderr
    assert done.stderr == "" and done.stdout.count("\n") == 1
    return folder


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """The files that the site is made of."""
    folder = tmp_path / "clone"
    left_out = shutil.ignore_patterns("*.so", "*.pyd", "__pycache__", "vectors", "expected")
    for name in ("docs", "tools", "hapfmt", "conformance"):
        shutil.copytree(ROOT / name, folder / name, ignore=left_out)
    for path in (*ROOT.glob("*.md"), ROOT / "pyproject.toml", ROOT / "LICENSE"):
        shutil.copy(path, folder)
    return folder


@pytest.mark.parametrize("link", ["[x](editing.md)", "[x](edit.md#no-such-heading)"])
def test_a_broken_link_ends_the_build(clone: Path, tmp_path: Path, link: str) -> None:
    with (clone / "docs" / "damage.md").open("a") as page:
        page.write(f"\n{link}\n")
    done = build(clone, "-o", str(tmp_path / "built"))
    assert done.returncode != 0
    assert "docs/damage.md" in done.stderr
    assert not (tmp_path / "built").exists()


def test_a_folder_with_other_files_is_kept(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    done = build(ROOT, "-o", str(tmp_path))
    assert done.returncode == 1 and "choose another folder" in done.stderr
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_nothing_is_loaded_from_other_hosts(site: Path) -> None:
    foreign = []
    for path in site.rglob("*.html"):
        for tag, attributes in Elements(path.read_text("utf-8")).found:
            given = attributes.get(LOADED.get(tag, "")) or ""
            if re.match(r"(https?:)?//", given) and attributes.get("rel") != "canonical":
                foreign.append((path.relative_to(site), given))
            # The theme fetches a library for diagrams where a page has one.
            assert "mermaid" not in (attributes.get("class") or "")
    for path in site.rglob("*.css"):
        text = path.read_text("utf-8")
        foreign += [(path, url) for url in re.findall(r"url\([\"']?((?:https?:)?//[^)]*)", text)]
        foreign += [(path, line) for line in re.findall(r"@import[^;]*//[^;]*", text)]
    assert foreign == []


def commands(command: click.Command, context: click.Context) -> Iterator[click.Context]:
    yield context
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            found = command.get_command(context, name)
            assert found is not None
            yield from commands(found, click.Context(found, parent=context, info_name=name))


def test_the_command_reference_names_every_verb_and_every_option(site: Path) -> None:
    from hapfmt.cli import VERBS, cli

    texts = {verb: article(site / "commands" / verb / "index.html") for verb in VERBS}
    count = 0
    for context in commands(cli, click.Context(cli, info_name="hapfmt")):
        words = context.command_path.split()
        if len(words) == 1:
            continue
        page = texts[words[1]]
        assert f"{context.command_path} [OPTIONS]" in page or "list" in words, context.command_path
        _, _, part = page.rpartition(f"{context.command_path} [OPTIONS]")
        part = re.split(r"<h2 id=\"hapfmt-", part)[0] if len(words) == 3 else part
        for parameter in context.command.params:
            if isinstance(parameter, click.Option) and not parameter.hidden:
                for name in (*parameter.opts, *parameter.secondary_opts):
                    assert re.search(rf"<dt><code>[^<]*{name}\b", part), (words, name)
                    count += 1
    assert count > 300


def article(path: Path) -> str:
    found = re.search(r"<article[^>]*>(.*)</article>", path.read_text("utf-8"), re.S)
    assert found is not None
    return found[1]


def test_the_python_reference_has_every_public_name(site: Path) -> None:
    import hapfmt

    text = "".join(path.read_text("utf-8") for path in site.glob("reference/*/index.html"))
    ids = set(re.findall(r'id="(hapfmt\.[^"]+)"', text))
    without = {"SPEC_VERSION", "__version__", "load"}
    assert {f"hapfmt.{name}" for name in hapfmt.__all__ if name not in without} - ids == set()
    for name in ("hapfmt.Recording.to_numpy", "hapfmt.edit.subset", "hapfmt.Reader.read"):
        assert name in ids
    assert ":meth:" not in text and ":func:" not in text


def test_the_site_shows_what_a_forge_shows(site: Path) -> None:
    """Lists, tables and headings are those of CommonMark, by another parser."""
    from markdown_it import MarkdownIt

    forge = MarkdownIt("commonmark").enable("table")
    pages = [*ROOT.glob("docs/**/*.md"), *ROOT.glob("*.md"), ROOT / "conformance" / "README.md"]
    differ = {}
    for page in pages:
        name = page.relative_to(ROOT).as_posix().removeprefix("docs/").removesuffix(".md")
        names = {"README": "", "index": "pages", "conformance/README": "conformance"}
        built = site / names.get(name, name.lower()) / "index.html"
        one, other = (
            Counter(tag for tag, _ in Elements(html).found if tag in COMPARED)
            for html in (forge.render(page.read_text("utf-8")), article(built))
        )
        # In a list, a paragraph may be left out.
        wrong = {tag: (one[tag], other[tag]) for tag in COMPARED - {"p"} if one[tag] != other[tag]}
        if wrong:
            differ[name] = wrong
    assert differ == {}
