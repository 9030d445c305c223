"""The command line; one file per verb, imported when that verb is used."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module

import click

from ..errors import HapfmtError
from ..names import similar, unknown
from ..version import SPEC_VERSION, __version__
from . import screen

VERBS = {
    "encode": "Encode a recording into a .hapf file.",
    "decode": "Decode a .hapf file, or a part of it.",
    "info": "What a file holds.",
    "verify": "Check every rule of a file, and its deadband contract.",
    "recover": "All that a damaged file still holds, in a file that is intact.",
    "du": "Where the bytes go, by cause and by track.",
    "dump": "All of a file as canonical JSON.",
    "subset": "Some channels, a stretch of time, one band; nothing is encoded anew.",
    "split": "Parts of some length, or at some times.",
    "concat": "Files one after the other.",
    "merge": "Channels that were recorded apart, on one time line.",
    "attach": "Files inside the file: add, list, extract.",
    "annotate": "Markers and annotations: add, list.",
    "meta": "Show or set the metadata.",
    "clocks": "Other clocks: what was observed, offset, drift, jitter.",
    "convert": "From any format to any other.",
    "plot": "A picture of a recording: signal, texture, knots, spectrum, damage.",
    "compare": "How two recordings differ, channel by channel.",
    "record": "Record samples as they come from another program.",
    "replay": "Play a recording on a haptic device, or show what it would be sent.",
    "devices": "HID devices that are connected, and which profile fits which.",
    "profile": "Device profiles: list them, show one, check one.",
    "rate": "Subjective tests: feel, compare, rate from 0 to 100; and their summary.",
    "scene": "Simulate a scene: textures, a wall, taps, a grasp; needs no device.",
    "demo": "Simulate a stylus on a texture, encode it, show what it costs.",
}
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
    "--channels": {"replay": "--map", "rate": "--map"},
    "--window": {"clocks": "--segment"},
    "--device": {"check": "--path"},
}
"""Options that had another name -> verb ("": any other) -> the name of today."""
ERROR = 1
"""Usage, input or output, internal error (SPEC clause 14)."""


class Verbs(click.Group):
    """Knows the verbs' names without importing them."""

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
            ctx.fail(unknown("verb", args[0], list(VERBS)))
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        with formatter.section("Verbs"):
            formatter.write_dl(list(VERBS.items()))


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, message=f"hapfmt %(version)s, format {SPEC_VERSION}")
def cli() -> None:
    """Recorded touch in files that are small, exact, and survive.

    \b
    hapfmt demo                          try it: needs no file and no device
    hapfmt encode touch.npz touch.hapf   a recording becomes a .hapf file
    hapfmt info touch.hapf               what is in it
    hapfmt decode touch.hapf back.npz    and it comes back

    A name of - is standard input or output. Exit codes: 0 done, nothing lost; 1 usage, input or
    output; 2 not a conforming file; 3 done with loss, losses reported; 4 needs an unknown feature,
    or more than the limits; of a replay 5 stopped since it was late, 6 device lost, 128 + n ended
    by signal n.
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
        code = report(error.line(), error.exit_code, error.more)
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
    """An error that says what was meant: an option by its name of today, a choice by its like."""
    if isinstance(error, click.BadParameter) and isinstance(error.param, click.Option):
        value = re.match("'(.*?)' is not one of", error.message)
        choices = error.param.type.choices if isinstance(error.param.type, click.Choice) else ()
        meant = value and similar(value[1], map(str, choices))
        if meant:
            message = f"{error.format_message()} Did you mean {meant!r}?"
            return click.UsageError(message, error.ctx)
    if not isinstance(error, click.NoSuchOption) or error.ctx is None:
        return error
    names = RENAMED.get(error.option_name, {})
    name = names.get(error.ctx.command.name or "", names.get("", ""))
    known = [each for param in error.ctx.command.params for each in param.opts]
    if name.split(" ")[0] not in known:
        return error
    return click.UsageError(f"{error.option_name} was renamed {name}", error.ctx)


def usage(error: click.ClickException) -> int:
    """An error of whoever typed the command."""
    code = report(error.format_message(), ERROR)
    context = getattr(error, "ctx", None)
    if context is not None:
        with suppress(OSError):
            screen.say(f"Try '{context.command_path} --help'.", err=True)
    return code


def report(message: str, code: int, more: Sequence[str] = ()) -> int:
    """An error for a person, and for a program where --json was given."""
    with suppress(OSError):
        screen.complain(message)
        for line in more:
            screen.say(line, err=True, whole=line.startswith("  hapfmt "))
    if "--json" in sys.argv:
        with suppress(OSError):
            screen.raw(json.dumps({"error": "\n".join([message, *more]), "exit_code": code}) + "\n")
    return code
