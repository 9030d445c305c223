"""The command line. Each verb has its own file, which is imported when that verb runs."""

from __future__ import annotations

import json
import os
import re
import shlex
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any

import click

from ..errors import DataWarning, HapfmtError, MovedTimesWarning, similar
from ..version import SPEC_VERSION, __version__
from . import screen

SECTIONS = {
    "Files": {
        "encode": "Encode a recording into a .hapf file",
        "decode": "Decode a .hapf file, or a part of it",
        "convert": "Convert between formats",
        "info": "Show what a file of any format contains",
        "verify": "Check a file, and its error bounds against the original",
    },
    "Look": {
        "compare": "Compare two recordings, channel by channel",
        "plot": "Draw a recording",
        "view": "Show recordings in the browser",
    },
    "Edit": {
        "subset": "Copy some channels or a stretch of time",
        "split": "Cut a file into parts",
        "concat": "Join files one after the other",
        "merge": "Join channels that were recorded separately",
        "attach": "Add, list or extract attached files",
        "annotate": "Add or list markers and annotations",
        "meta": "Show or set metadata",
        "recover": "Save what a damaged file still contains",
    },
    "Many files": {
        "archive": "Encode, check, search and deposit whole folders",
    },
    "Record and replay": {
        "record": "Record samples from another program",
        "replay": "Play a recording on a haptic device",
        "devices": "List connected haptic devices",
        "profile": "List, show or check device profiles",
    },
    "Research": {
        "demo": "Simulate a stylus, encode it, show the sizes",
        "scene": "Simulate textures, a wall, taps or a grasp",
        "study": "Run a study in which people rate what they feel",
    },
    "Inside a file": {
        "du": "Show where the bytes of a file go",
        "dump": "Print a whole file as JSON",
        "clocks": "Show offset, drift and jitter of other clocks",
    },
}
VERBS = {verb: text for verbs in SECTIONS.values() for verb, text in verbs.items()}
RENAMED = {
    "--from": {
        "annotate": "--table",
        "record": "--input",
        "replay": "--start",
        "": "--input-format",
    },
    "--to": {"attach": "--output", "replay": "--stop", "": "--output-format"},
    "--time": {"": "--start and --stop"},
    "--out": {"": "--output"},
    "--channels": {"replay": "--map", "study": "--map"},
    "--window": {"clocks": "--segment"},
    "--device": {"check": "--path"},
}
"""Options that had another name -> verb ("": any other) -> the name of today."""
OPTION_CUTOFF = 0.7
"""Similarity of a mistyped option, without its dashes, to the one that is meant."""
ERROR = 1
"""Usage, input or output, internal error (SPEC clause 13)."""


class Verbs(click.Group):
    """Knows the verbs' names without importing them. Warnings on data become notes."""

    def invoke(self, ctx: click.Context) -> Any:
        shown: set[str] = set()

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if not issubclass(category, DataWarning):
                others(message, category, *place, **more)
            elif str(message) not in shown:
                shown.add(str(message))
                screen.note(str(message))

        with warnings.catch_warnings():
            others = warnings.showwarning
            warnings.showwarning = show
            warnings.simplefilter("always", DataWarning)
            warnings.simplefilter("ignore", MovedTimesWarning)  # the notes of a recording say it
            return super().invoke(ctx)

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        if cmd_name not in VERBS:
            return None
        command: click.Command = getattr(import_module(f"{__name__}.{cmd_name}"), cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in VERBS:
            ctx.fail(unknown_verb(args[0]))
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        for name, verbs in SECTIONS.items():
            with formatter.section(name):
                formatter.write_dl([(f"{verb:<8}", text) for verb, text in verbs.items()])


def unknown_verb(name: str) -> str:
    """Return the message for an unknown verb, which may be the name of a file."""
    meant = similar(name, VERBS)
    if meant is None and re.search("[./]", name):
        return f"no verb {name!r}; did you mean hapfmt info {shlex.quote(name)}?"
    return f"no verb {name!r}" + (f"; did you mean {meant!r}?" if meant else "")


def print_version(ctx: click.Context, _param: click.Parameter, asked: bool) -> None:
    if not asked or ctx.resilient_parsing:
        return
    from ..kernels import load

    if os.environ.get("HAPFMT_PURE"):
        loops = "compiled loops switched off by HAPFMT_PURE"
    else:
        loops = "compiled loops" if load() else "no compiled loops, so everything is slow"
    screen.say(f"hapfmt {__version__}, format {SPEC_VERSION}, {loops}")
    ctx.exit()


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=print_version,
    help="Show the version, and whether the compiled loops are there.",
)
def cli() -> None:
    """Store recorded touch in small files that lose nothing unless you ask for it.

    \b
    hapfmt demo                          try it; needs no file and no device
    hapfmt encode touch.npz touch.hapf   encode a recording
    hapfmt info touch.hapf               show what the file contains
    hapfmt decode touch.hapf back.npz    decode it again

    A file name of - is standard input or output. 'hapfmt VERB --help' shows the options and
    examples of a verb.

    \b
    Exit codes:
      0  done, nothing lost          4  unknown feature, or over a limit
      1  wrong use, input, output    5  replay stopped because it was late
      2  not a conforming file       6  device lost
      3  done with loss, reported    128 + n  ended by signal n
    """


def main() -> None:
    """Entry point: runs one verb and ends with its exit code."""
    screen.hold_streams()
    try:
        code = cli.main(standalone_mode=False)
        sys.stdout.flush()
    except click.ClickException as error:
        code = usage(explained(error))
    except (click.Abort, KeyboardInterrupt):
        code = report("interrupted", ERROR)
    except HapfmtError as error:
        from .common import way_out

        code = report(error.line(), error.exit_code, way_out(error))
    except BrokenPipeError:
        code = ERROR  # the reader of our output has gone
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        code = report(f"{name}{screen.reason(error)}", ERROR)
    except MemoryError:
        code = report("out of memory: read fewer channels or a shorter time range", ERROR)
    screen.drop_output()
    sys.exit(code if isinstance(code, int) else 0)


def explained(error: click.ClickException) -> click.ClickException:
    """Adds a suggestion: the present name of a renamed option, or the closest known name."""
    if isinstance(error, click.BadParameter) and isinstance(error.param, click.Option):
        value = re.match("'(.*?)' is not one of", error.message)
        choices = error.param.type.choices if isinstance(error.param.type, click.Choice) else ()
        meant = value and similar(value[1], map(str, choices))
        if meant:
            message = f"{error.format_message()} Did you mean {meant!r}?"
            return click.UsageError(message, error.ctx)
    if isinstance(error, click.MissingParameter) and isinstance(error.param, click.Option):
        message = f"{error.param.opts[0]} is missing: {error.param.help}"
        return click.UsageError(message, error.ctx)
    if not isinstance(error, click.NoSuchOption) or error.ctx is None:
        return error
    names = RENAMED.get(error.option_name, {})
    name = names.get(error.ctx.command.name or "", names.get("", ""))
    arguments, known = arguments_and_options(error.ctx.command)
    if error.option_name.lstrip("-") in arguments:
        shown = arguments[error.option_name.lstrip("-")]
        message = f"{shown} is an argument: write it without {error.option_name}"
        return click.UsageError(message, error.ctx)
    if name.split(" ")[0] not in known:
        bare = {each.lstrip("-"): each for each in known}
        meant = similar(error.option_name.lstrip("-"), bare, OPTION_CUTOFF)
        text = f"; did you mean {bare[meant]!r}?" if meant else ""
        return click.UsageError(f"no option {error.option_name!r}{text}", error.ctx)
    return click.UsageError(f"{error.option_name} was renamed {name}", error.ctx)


def arguments_and_options(command: click.Command) -> tuple[dict[str, str], list[str]]:
    """{name of an argument: as the help shows it}, and the names of the options."""
    arguments, options = {}, []
    for param in command.params:
        if isinstance(param, click.Argument):
            arguments[param.name or ""] = param.human_readable_name.strip("[].")
        else:
            options += param.opts
    return arguments, options


def usage(error: click.ClickException) -> int:
    """An error in the command line."""
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        screen.document(error.format_message() + "\n")
        return ERROR
    code = report(error.format_message(), ERROR)
    context = getattr(error, "ctx", None)
    if context is not None:
        with suppress(OSError):
            screen.say(f"Try '{context.command_path} --help'.", err=True)
    return code


def report(message: str, code: int, more: Sequence[str] = ()) -> int:
    """An error for a person, and for a program where --json was given."""
    message = screen.in_options(message)
    with suppress(OSError):
        screen.complain(message, more)
    if "--json" in sys.argv:
        with suppress(OSError):
            screen.raw(json.dumps({"error": "\n".join([message, *more]), "exit_code": code}) + "\n")
    return code
