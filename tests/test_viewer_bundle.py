"""Modules of the viewer become one script that runs as they do."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from hapfmt.errors import MissingExtraError, ParameterError
from hapfmt.viewer import uplot as uplot_module
from hapfmt.viewer.bundle import PAGE, VIEWER, WORKER, Module, bundle, load, page
from hapfmt.viewer.uplot import uplot

Run = Callable[[dict[str, str]], object]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Runs a.js bundled, and as a module: both print the same, which is what this gives."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node here")

    def call(files: dict[str, str]) -> object:
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, "utf-8")
        (tmp_path / "package.json").write_text('{"type": "module"}', "utf-8")
        (tmp_path / "bundled.cjs").write_text(bundle("a.js", tmp_path), "utf-8")
        texts = [
            subprocess.run(
                [node, name], cwd=tmp_path, capture_output=True, text=True, check=True
            ).stdout
            for name in ("a.js", "bundled.cjs")
        ]
        assert texts[0] == texts[1]
        return json.loads(texts[1])

    return call


def say(what: str) -> str:
    return f"console.log(JSON.stringify({what}));\n"


def test_names_aliases_and_lists(run: Run) -> None:
    files = {
        "a.js": "import { one, two as zwei, Three, four, make, later } from './d/b.js';\n"
        "import {\n  five as one5,\n} from './c.js';\n"
        + say("[one, zwei(), new Three().value, four, [...make()], typeof later, one5]"),
        "d/b.js": "import { five } from '../c.js';\n"
        "export const one = 1;\nexport function two() { return local + five; }\n"
        "export class Three { value = 3; }\nexport function* make() { yield 7; }\n"
        "export async function later() {}\nconst local = 2;\nconst inner = 4;\n"
        "export { inner as four };\n",
        "c.js": "export const five = 5;\nexport {};\n",
    }  # fmt: skip
    assert run(files) == [1, 7, 3, 4, [7], "function", 5]


def test_an_imported_name_is_exported_again(run: Run) -> None:
    files = {
        "a.js": "import { b, K } from './b.js';\n" + say("[b(), K]"),
        "b.js": "import { c as b, K } from './c.js';\nexport { b, K };\n",
        "c.js": "export function c() { return K; }\nexport const K = 3;\n",
    }
    assert run(files) == [3, 3]


def test_circles_of_functions(run: Run) -> None:
    files = {
        "a.js": "import { isOdd, seen } from './b.js';\n"
        "export function isEven(n) { return n === 0 || isOdd(n - 1); }\n" + say("[isEven(10), isOdd(4), seen]"),
        "b.js": "import { isEven } from './a.js';\n"
        "export function isOdd(n) { return n !== 0 && isEven(n - 1); }\n"
        "export const seen = isEven(6);\n",
    }  # fmt: skip
    assert run(files) == [True, False, True]


def test_equal_names_in_two_modules(run: Run) -> None:
    files = {
        "a.js": "import { get } from './b.js';\nconst x = 1;\nfunction helper() { return x; }\n"
        + say("[get(), helper()]"),
        "b.js": "const x = 2;\nfunction helper() { return x; }\nexport function get() { return helper(); }\n",
    }  # fmt: skip
    assert run(files) == [2, 1]


def test_each_module_runs_once_and_in_strict_mode(run: Run) -> None:
    files = {
        "a.js": "import { list } from './log.js';\nimport { b } from './b.js';\nimport { c } from './c.js';\n"
        + say("[list, b, c, this === undefined, (function () { return this === undefined; })()]"),
        "log.js": "export const list = ['log'];\n",
        "b.js": "import { c } from './c.js';\nimport { list } from './log.js';\nlist.push('b');\nexport const b = c + 1;\n",
        "c.js": "import { list } from './log.js';\nlist.push('c');\nexport const c = 1;\n",
    }  # fmt: skip
    assert run(files) == [["log", "c", "b"], 2, 1, True, True]


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("\nimport { gone } from './b.js';\n", 2, "b.js does not export gone"),
        ("import { b } from './none.js';\n", 1, "no module none.js"),
        ("import { b } from '../b.js';\n", 1, "no module ../b.js"),
        ("import { b } from 'b';\n", 1, "not in the subset"),
        ("import b from './b.js';\n", 1, "not in the subset"),
        ("import * as b from './b.js';\n", 1, "not in the subset"),
        ("import './b.js';\n", 1, "not in the subset"),
        ("import { b } from \"./b.js\";\n", 1, "not in the subset"),
        ("import { b } from './b.js'\n", 1, "not in the subset"),
        ("import { b-c } from './b.js';\n", 1, "'b-c' is not a name"),
        ("const x = 1;\nexport default x;\n", 2, "not in the subset"),
        ("\n\nexport * from './b.js';\n", 3, "not in the subset"),
        ("export { b } from './b.js';\n", 1, "not in the subset"),
        ("export let x = 1;\n", 1, "not in the subset"),
        ("export const { x } = {};\n", 1, "not a name"),
        ("export { x };\n", 1, "exports x, which it does not declare"),
        ("export const x = 1;\nexport { x };\n", 2, "exports x twice"),
        ("const x = () => import('./b.js');\n", 1, "import() is not bundled"),
        ("const x = import.meta.url;\n", 1, "import.meta is not bundled"),
        ("if (1) {\n  import { b } from './b.js';\n}\n", 2, "it must start the line"),
        ("const x = '</script>';\n", 1, "it ends or breaks a script in HTML"),
        ("const x = 1;\nconst y = '<!--';\n", 2, "it ends or breaks a script in HTML"),
        ("const x = '<SCRIPT';\n", 1, "it ends or breaks a script in HTML"),
        ("import { k } from './circle.js';\nexport const j = 1;\n", 1, "no function"),
    ],
)  # fmt: skip
def test_what_is_not_in_the_subset(text: str, line: int, what: str, tmp_path: Path) -> None:
    (tmp_path / "a.js").write_text(text, "utf-8")
    (tmp_path / "b.js").write_text("export const b = 1;\n", "utf-8")
    (tmp_path / "circle.js").write_text(
        "import { j } from './a.js';\nexport const k = j;\n", "utf-8"
    )
    with pytest.raises(ParameterError, match=re.escape(what)) as found:
        bundle("a.js", tmp_path)
    assert found.value.path == ("circle.js:1" if "circle" in text else f"a.js:{line}")


def test_names_that_are_only_handed_around(tmp_path: Path) -> None:
    (tmp_path / "a.js").write_text("import { x } from './b.js';\nexport { x };\n", "utf-8")
    (tmp_path / "b.js").write_text("import { x } from './a.js';\nexport { x };\n", "utf-8")
    with pytest.raises(ParameterError, match="declared nowhere"):
        bundle("a.js", tmp_path)


@pytest.mark.parametrize("entry", [PAGE, WORKER])
def test_the_viewer_is_in_the_subset(entry: str, tmp_path: Path) -> None:
    """What comes out is JavaScript."""
    script = tmp_path / "bundled.cjs"
    script.write_text(bundle(entry), "utf-8")
    node = shutil.which("node")
    if node:
        subprocess.run([node, "--check", script], check=True)


def test_modules_that_nothing_imports_are_in_the_subset_too() -> None:
    modules: dict[str, Module] = {}
    for path in sorted(VIEWER.glob("*/*.js")):
        name = path.relative_to(VIEWER).as_posix()
        if name not in modules:
            load(name, VIEWER, modules)
    assert len(modules) > 40


def test_the_page_names_what_it_runs() -> None:
    """The policy allows the scripts and styles that are there, and nothing else."""
    found = page([{"name": "</script><!--'\"", "url": "files/0"}], connect=True)
    html = found.before + found.after
    for kind in ("script", "style"):
        texts = re.findall(rf"<{kind}>(.*?)</{kind}>", html, re.S)
        allowed = re.search(rf"{kind}-src ([^;]*)", found.policy)
        assert allowed is not None and len(allowed[1].split()) == len(texts) == 2
    listed = re.search(r'<script type="application/json" id="files">(.*?)</script>', html, re.S)
    assert listed is not None
    assert json.loads(listed[1]) == [{"name": "</script><!--'\"", "url": "files/0"}]
    assert f'content="{found.policy}"' in found.before
    assert not re.search(r"""(?:src|href)=["'](?!data:,)""", re.sub(r"<(script|style)\b.*?</\1>", "", html, flags=re.S))  # fmt: skip
    assert "connect-src 'self'" in found.policy
    assert "connect-src 'none'" in page([], connect=False).policy


class TestUPlot:
    def test_is_the_published_release(self) -> None:
        script, style = uplot()
        assert (
            "v1.6.31" in script and "Permission is hereby granted" in script and ".uplot" in style
        )

    def test_without_the_package(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def missing(name: str) -> None:
            raise PackageNotFoundError(name)

        monkeypatch.setattr(uplot_module, "distribution", missing)
        with pytest.raises(MissingExtraError, match=r"pip install 'hapfmt\[view\]'"):
            uplot()

    @pytest.mark.parametrize("data", [b"alert(1)", None])
    def test_other_bytes(
        self, data: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        if data is not None:
            path = tmp_path / uplot_module.SCRIPT
            path.parent.mkdir(parents=True)
            path.write_bytes(data)

        class Package:
            def locate_file(self, name: str) -> Path:
                return tmp_path / name

        monkeypatch.setattr(uplot_module, "distribution", lambda _: Package())
        with pytest.raises(ParameterError, match=r"uplot\.iife\.min\.js .* is not that of uPlot"):
            uplot()
