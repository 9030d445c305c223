"""Manual pages from the help texts: python tools/manpages.py FOLDER writes one for each verb.

The date on the pages is today, or that of SOURCE_DATE_EPOCH.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import installed  # noqa: F401

import click

sys.path.insert(0, str(Path(__file__).parent / "website"))
from command_pages import DRIVE, HELP, REPLAY, exit_rows

from hapfmt.cli import SECTIONS, cli
from hapfmt.cli.screen import Verb
from hapfmt.version import __version__


def date() -> str:
    moment = int(os.environ.get("SOURCE_DATE_EPOCH", time.time()))
    return time.strftime("%Y-%m-%d", time.gmtime(moment))


def escaped(text: str) -> str:
    """Text of roff: hyphens that can be copied, and no line that begins with a request."""
    for character, name in {"\\": "\\e", "-": "\\-", "'": "\\(aq", "`": "\\(ga"}.items():
        text = text.replace(character, name)
    return re.sub(r"^\.", r"\\&.", text, flags=re.M)


def as_typed(lines: list[str]) -> str:
    return "\n".join([".EX", *(escaped(line.rstrip()) for line in lines), ".EE"])


def description(text: str) -> str:
    """A help text: lines after \\b are kept as they are."""
    parts = []
    for part in re.split(r"\n\s*\n", text.strip()):
        lines = part.splitlines()
        kept = lines[0].strip() == "\b"
        parts.append(as_typed(lines[1:]) if kept else escaped(" ".join(part.split())))
    return "\n.PP\n".join(parts)


def options(command: click.Command, context: click.Context) -> Iterator[str]:
    for param in command.get_params(context):
        record = param.get_help_record(context) if isinstance(param, click.Option) else None
        if record is not None:
            yield f".TP\n.B {escaped(record[0])}\n{escaped(' '.join(record[1].split()))}"


def verbs(command: click.Group, context: click.Context) -> Iterator[str]:
    """The verbs of a group; those of hapfmt in the sections of its help."""
    for section, texts in SECTIONS.items() if command is cli else [("", {})]:
        if section:
            yield f".SS {section}"
        for name in texts or command.list_commands(context):
            verb = command.get_command(context, name)
            assert verb is not None
            page = f"{context.command_path} {name}".replace(" ", "-")
            text = texts.get(name) or verb.get_short_help_str(200)
            yield f".TP\n.BR {escaped(page)} (1)\n{escaped(text)}"


def page(command: click.Command, context: click.Context) -> str:
    name = context.command_path.replace(" ", "-")
    texts, examples = command.parts() if isinstance(command, Verb) else ([command.help or ""], [])
    lines = [
        f".TH {escaped(name.upper())} 1 {date()} hapfmt\\ {__version__}",
        ".SH NAME",
        f"{escaped(name)} \\- {escaped(command.get_short_help_str(200).rstrip('.'))}",
        ".SH SYNOPSIS",
        f".B {escaped(context.command_path)}",
        escaped(" ".join(command.collect_usage_pieces(context))),
        ".SH DESCRIPTION",
        description("\n\n".join(texts)),
    ]
    if isinstance(command, click.Group):
        lines += [".SH VERBS", *verbs(command, context)]
    lines += [".SH OPTIONS", *options(command, context)]
    if examples:
        lines += [".SH EXAMPLES", as_typed(examples)]
    if context.parent is not None:
        verb = context.command_path.split()[1]
        rows = exit_rows(REPLAY if verb in DRIVE else set())
        lines += [".SH EXIT STATUS", *(f".TP\n.B {code}\n{escaped(what)}" for code, what in rows)]
        above = context.parent.command_path.replace(" ", "-")
        lines += [".SH SEE ALSO", f".BR {escaped(above)} (1)"]
    return "\n".join(lines) + "\n"


def pages(command: click.Command, context: click.Context) -> Iterator[tuple[str, str]]:
    """File names and texts."""
    yield context.command_path.replace(" ", "-") + ".1", page(command, context)
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            verb = command.get_command(context, name)
            assert verb is not None
            yield from pages(verb, click.Context(verb, parent=context, info_name=name))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    found = dict(pages(cli, click.Context(cli, info_name="hapfmt", help_option_names=HELP)))
    for name, text in found.items():
        (folder / name).write_text(text, encoding="utf-8")
    print(f"{len(found)} pages")
