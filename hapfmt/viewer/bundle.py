"""The modules of the viewer become one page, without node.

The modules are ES modules of a small subset. ``import { a, b as c } from './x.js';`` and ``export``
of a function, class, const or ``{ list }`` start their lines. All else is refused, with file and
line. Each module becomes a generator in one classic script. It runs in three stages: it gives its
functions, it takes those of others, it runs. So modules may import functions in circles.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import NoReturn

from ..errors import ParameterError
from .uplot import uplot

VIEWER = Path(__file__).parent
PAGE, WORKER = "page/main.js", "data/worker.js"

STATEMENT = re.compile(r"^(?:import|export)\b", re.M)
END = r";[ \t]*(?://.*)?$"
IMPORT = re.compile(rf"import\s*\{{([^{{}}]*)\}}\s*from\s*'(\.\.?/[\w./-]+)'{END}", re.M)
LIST = re.compile(rf"export\s*\{{([^{{}}]*)\}}{END}", re.M)
DECLARATION = re.compile(r"export\s+(?=(?:async\s+)?function\b|class\b|const\b)")
DECLARED = re.compile(
    r"^(?:export\s+)?(?:(?:async\s+)?(function)\b\s*\*?|class|const|let|var)\s*([\w$]+)", re.M
)
NAME = re.compile(r"([\w$]+)(?:\s+as\s+([\w$]+))?")
REFUSED = (
    (re.compile(r"import\("), "import() is not bundled"),
    (re.compile(r"import\.meta\b"), "import.meta is not bundled"),
    (re.compile(r"^[ \t]+(?:import\s*[{*'\"]|export\s+[{*\w])", re.M), "it must start the line"),
    (
        re.compile(r"</?[sS][cC][rR][iI][pP][tT]|<!--|^[ \t]*-->", re.M),
        "it ends or breaks a script in HTML",
    ),
)


@dataclass
class Module:
    """``name``: its path below the root; ``body``: its code without imports and exports."""

    name: str
    text: str
    body: str = ""
    imports: list[tuple[str, str, str, int]] = field(default_factory=list)
    """(module, exported name, local name, position in the text)"""
    exports: dict[str, str] = field(default_factory=dict)
    """exported name -> local name"""
    functions: set[str] = field(default_factory=set)
    """Local names of functions, which exist before the module runs."""

    def refuse(self, position: int, message: str) -> NoReturn:
        line = self.text.count("\n", 0, position) + 1
        raise ParameterError(message, path=f"{self.name}:{line}")


def bundle(entry: str, root: Path = VIEWER) -> str:
    """One classic script that runs the module ``entry``, a path below ``root``, after all that it
    imports. Raises ParameterError, with file and line, for what is not in the subset."""
    modules: dict[str, Module] = {}
    load(entry, root, modules)
    order: list[str] = []
    sort(entry, modules, order, set())
    parts = [written(modules[name], modules, order) for name in order]
    listed = ",\n".join(parts)
    return (
        "(() => {\n'use strict';\n"
        f"const $all = Array.from({{ length: {len(order)} }}, () => ({{}}));\n"
        f"const $runs = [\n{listed}\n].map((module, i) => module($all[i]));\n"
        "for (let stage = 0; stage < 3; stage++) for (const run of $runs) run.next();\n"
        "})();\n"
    )


def load(name: str, root: Path, modules: dict[str, Module]) -> None:
    """Reads a module and all that it needs."""
    text = (root / name).read_text("utf-8")
    module = modules[name] = parsed(name, text)
    for other, _, _, at in module.imports:
        if other not in modules:
            if other.startswith("..") or not (root / other).is_file():
                module.refuse(at, f"no module {other}")
            load(other, root, modules)


def parsed(name: str, text: str) -> Module:
    module = Module(name, text)
    for pattern, why in REFUSED:
        if found := pattern.search(text):
            module.refuse(found.start(), f"{found[0].strip()}: {why}")
    declared = {}
    for found in DECLARED.finditer(text):
        declared[found[2]] = found
        if found[1]:
            module.functions.add(found[2])
    body, done = [], 0
    for statement in STATEMENT.finditer(text):
        at = statement.start()
        if found := IMPORT.match(text, at):
            path = joined(PurePosixPath(name).parent / found[2])
            module.imports += [(path, a, b, at) for a, b in names(module, found[1], at)]
        elif found := LIST.match(text, at):
            for local, exported in names(module, found[1], at):
                export(module, exported, local, at)
        elif found := DECLARATION.match(text, at):
            declaration = DECLARED.match(text, at)
            if declaration is None:
                module.refuse(at, "not a name: export it with export { name }")
            export(module, declaration[2], declaration[2], at)
        else:
            line = text[at:].partition("\n")[0]
            module.refuse(at, f"{line!r} is not in the subset that is bundled")
        body.append(text[done:at])
        done = found.end()
        body.append("\n" * text.count("\n", at, done))
    module.body = "".join([*body, text[done:]])
    known = declared.keys() | {local for _, _, local, _ in module.imports}
    for exported, local in module.exports.items():
        if local not in known:
            module.refuse(text.find(exported), f"exports {local}, which it does not declare")
    return module


def joined(path: PurePosixPath) -> str:
    """Without the ``..`` that a part before it takes back."""
    parts: list[str] = []
    for part in path.parts:
        if part == ".." and parts and parts[-1] != "..":
            parts.pop()
        else:
            parts.append(part)
    return "/".join(parts)


def names(module: Module, listed: str, at: int) -> list[tuple[str, str]]:
    """(name, name after ``as``) of the list in braces."""
    found = []
    for part in filter(None, (each.strip() for each in listed.split(","))):
        match = NAME.fullmatch(part)
        if match is None:
            module.refuse(at, f"{part!r} is not a name")
        found.append((match[1], match[2] or match[1]))
    return found


def export(module: Module, exported: str, local: str, at: int) -> None:
    if exported in module.exports:
        module.refuse(at, f"exports {exported} twice")
    module.exports[exported] = local


def sort(name: str, modules: Mapping[str, Module], order: list[str], seen: set[str]) -> None:
    """Each after those that it imports; in a circle, in the order in which they are imported."""
    seen.add(name)
    for other, *_ in modules[name].imports:
        if other not in seen:
            sort(other, modules, order, seen)
    order.append(name)


def origin(
    module: Module, wanted: tuple[str, str, int], modules: Mapping[str, Module]
) -> tuple[str, str, bool]:
    """Where an imported name comes from, through modules that import and export it: the module,
    its exported name, and whether it is a function."""
    other, exported, at = wanted
    seen = set()
    while True:
        source = modules[other]
        local = source.exports.get(exported)
        if local is None:
            module.refuse(at, f"{other} does not export {exported}")
        through = [(m, name) for m, name, alias, _ in source.imports if alias == local]
        if not through:
            return other, exported, local in source.functions
        if (other, exported) in seen:
            module.refuse(at, f"{exported} is imported in a circle and declared nowhere")
        seen.add((other, exported))
        other, exported = through[0]


def written(module: Module, modules: Mapping[str, Module], order: Sequence[str]) -> str:
    """The generator of a module."""
    place = order.index(module.name)
    early, late = [], []
    for other, exported, local, at in module.imports:
        source, name, is_function = origin(module, (other, exported, at), modules)
        text = f"const {local} = $all[{order.index(source)}].{name};"
        if is_function:
            early.append(text)
        elif order.index(source) >= place:
            module.refuse(at, f"{exported} of {source} is imported in a circle, and no function")
        else:
            late.append(text)
    imported = {local for _, _, local, _ in module.imports}
    own = {name: local for name, local in module.exports.items() if local not in imported}
    first = [f"{name}: {local}" for name, local in own.items() if local in module.functions]
    last = [f"{name}: {local}" for name, local in own.items() if local not in module.functions]
    return (
        f"function* ($own) {{ // {module.name}\n"
        f"Object.assign($own, {{ {', '.join(first)} }}); yield;\n"
        f"{' '.join(early)} yield;\n{' '.join(late)}\n"
        f"{module.body}\nObject.assign($own, {{ {', '.join(last)} }});\n}}"
    )


STYLE_TAG = '<link rel="stylesheet" href="style.css">'
SCRIPT_TAG = '<script type="module" src="main.js"></script>'
CHARSET_TAG = '<meta charset="utf-8">'


@dataclass(frozen=True)
class Page:
    """An HTML page in two parts; between them go the data blocks of an export. ``policy``: its
    Content-Security-Policy, which it also has in a meta element."""

    before: str
    after: str
    policy: str


def page(files: Sequence[Mapping[str, str]], *, connect: bool) -> Page:
    """``files``: {"name": ..., "url": ...} each, or {"name": ..., "inline": id of a data block}.
    ``connect``: whether the page may fetch from the server it came from, else from nowhere."""
    html = (VIEWER / "page/index.html").read_text("utf-8")
    for tag in (STYLE_TAG, SCRIPT_TAG, CHARSET_TAG):
        if html.count(tag) != 1:
            raise ParameterError(f"index.html needs {tag} once")
    library, library_style = uplot()
    styles = [library_style, (VIEWER / "page/style.css").read_text("utf-8")]
    worker = f"globalThis.hapfWorkerCode = {inert(bundle(WORKER))};\n"
    scripts = [library, worker + bundle(PAGE)]
    policy = "; ".join([
        "default-src 'none'",
        f"script-src {' '.join(map(checksum, scripts))}",
        f"style-src {' '.join(map(checksum, styles))}",
        "img-src data: blob:",
        "worker-src blob:",
        "connect-src 'self'" if connect else "connect-src 'none'",
        "base-uri 'none'",
        "form-action 'none'",
    ])  # fmt: skip
    meta = f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
    html = html.replace(CHARSET_TAG, f"{CHARSET_TAG}\n{meta}")
    html = html.replace(STYLE_TAG, "\n".join(f"<style>{text}</style>" for text in styles))
    before, after = html.split(SCRIPT_TAG)
    listed = f'<script type="application/json" id="files">{inert(files)}</script>\n'
    code = "\n".join(f"<script>{text}</script>" for text in scripts)
    return Page(before + listed, code + after, policy)


def inert(value: object) -> str:
    """JSON that HTML and JavaScript take as it is, whatever text it holds."""
    return json.dumps(value).replace("<", "\\u003c")


def checksum(text: str) -> str:
    """As a Content-Security-Policy names an inline script or style."""
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
