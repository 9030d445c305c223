"""The command reference: a page for each command of ``hapfmt``, made from its help."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import click

from hapfmt.cli import SECTIONS, VERBS, cli
from hapfmt.cli.screen import Verb

FOLDER = "commands"
WIDTH = 76
CODE_OR_MARK = r"'(hapfmt [^']+)'|(?<![\w-])((?:hapfmt [a-z]+ )?--[a-z][\w-]*)|([\\`*_<>|\[\]])"
HELP = cli.context_settings["help_option_names"]
REPLAY = {"5", "6", "128 + n"}
"""Exit codes of commands that drive a device."""
DRIVE = {"replay", "study"}


def navigation() -> list[Any]:
    sections = [
        {name: [{f"hapfmt {verb}": f"{FOLDER}/{verb}.md"} for verb in verbs]}
        for name, verbs in SECTIONS.items()
    ]
    return [{"All commands": f"{FOLDER}/index.md"}, *sections]


def pages() -> dict[str, str]:
    """{path on the site: Markdown}."""
    root = click.Context(
        cli,
        info_name="hapfmt",
        help_option_names=HELP,
        max_content_width=WIDTH,
        terminal_width=WIDTH,
    )
    found = {f"{FOLDER}/index.md": overview(root)}
    for verb in VERBS:
        command = cli.get_command(root, verb)
        assert command is not None
        found[f"{FOLDER}/{verb}.md"] = "\n\n".join(described(command, root, verb)) + "\n"
    return found


def overview(root: click.Context) -> str:
    """All commands in their sections."""
    parts = ["# Commands", *prose(cli)]
    for name, verbs in SECTIONS.items():
        rows = [f"| [`hapfmt {verb}`]({verb}.md) | {text(what)} |" for verb, what in verbs.items()]
        parts += [f"## {name}", "\n".join(["| command | |", "|---|---|", *rows])]
    parts += ["## Options", *options(cli, root), "## Exit codes", exit_codes(REPLAY)]
    return "\n\n".join(parts) + "\n"


def described(
    command: click.Command, above: click.Context, name: str, level: int = 1
) -> Iterator[str]:
    """Markdown of a command, then of the commands of a group."""
    context = click.Context(command, parent=above, info_name=name, terminal_width=WIDTH)
    mark = "#" * level
    yield f"{mark} {context.command_path}"
    usage = command.get_usage(context).removeprefix("Usage: ")
    yield f"```text\n{usage}\n```"
    yield from prose(command)
    examples = Verb.parts(command)[1]
    if examples:
        yield f"{mark}# Examples" if level == 1 else "Examples:"
        yield "```console\n" + "\n".join(f"$ {line}" for line in examples) + "\n```"
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            found = command.get_command(context, each)
            assert found is not None
            yield from described(found, context, each, level + 1)
    else:
        yield f"{mark}# Options" if level == 1 else "Options:"
        yield from options(command, context)
    if level == 1:
        yield "## Exit codes"
        yield exit_codes(REPLAY if name in DRIVE else set())
        yield "[Options that many commands share](../docs/command-line.md)"


def prose(command: click.Command) -> Iterator[str]:
    """Paragraphs of the help; what follows ``\\b`` is printed line by line."""
    for paragraph in Verb.parts(command)[0]:
        lines = [line.rstrip() for line in paragraph.strip("\n").splitlines()]
        if lines and lines[0].strip() == "\b":
            if not lines[1].strip().startswith("Exit codes:"):
                indent = min(len(line) - len(line.lstrip()) for line in lines[1:])
                yield "```text\n" + "\n".join(line[indent:] for line in lines[1:]) + "\n```"
        else:
            yield text(" ".join(line.strip() for line in lines))


def options(command: click.Command, context: click.Context) -> Iterator[str]:
    """A list for each group of options, as in the help."""
    groups: dict[str, list[str]] = {}
    for group, (names, what) in Verb.records(command, context):
        groups.setdefault(group, []).append(f"`{names}`\n:   {text(what)}")
    for group, entries in groups.items():
        if len(groups) > 1:
            yield f"**{group}**"
        yield from entries


def exit_codes(more: set[str]) -> str:
    rows = exit_rows(more)
    return "\n".join(["| code | |", "|---|---|", *(f"| {code} | {what} |" for code, what in rows)])


def exit_rows(more: set[str]) -> list[tuple[str, str]]:
    """Those in the two columns of the help of ``hapfmt``; of those of replays only ``more``."""
    block = (cli.help or "").partition("Exit codes:\n")[2].partition("\n\n")[0]
    cells = [
        cell for line in block.splitlines() for cell in re.split(r" {3,}", line.strip()) if cell
    ]
    rows = {}
    for cell in cells:
        code, _, what = cell.partition("  ")
        rows[code] = what
    shown = [code for code in sorted(rows) if code not in REPLAY or code in more]
    order = sorted(shown, key=lambda code: int(code.split()[0]))
    return [(code, rows[code]) for code in order]


def text(words: str) -> str:
    """Plain text in Markdown: options and quoted commands become code."""
    return re.sub(CODE_OR_MARK, marked, words)


def marked(found: re.Match[str]) -> str:
    return rf"\{found[3]}" if found[3] else f"`{found[1] or found[2]}`"
