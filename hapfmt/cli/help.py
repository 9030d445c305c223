"""Help of a verb: what it does, examples, and its options in groups."""

from __future__ import annotations

import re
from collections.abc import Iterator

import click

GROUPS = {
    "What is read": (
        *("--channels", "--start", "--stop", "--band", "--layer", "--input", "--input-format"),
        *("--rate", "--labels", "--unit", "--lsb", "--against"),
    ),
    "Quality": (
        *("--preset", "--max-error", "--k", "--floor", "--felt", "--no-texture", "--snr", "--bits"),
        *("--step", "--fast"),
    ),
    "For experts": (
        *("--tolerance", "--cutoff", "--interpolation", "--vector", "--references", "--cluster"),
        *("--digest", "--canonical", "--threads", "--max-memory", "--fsync", "--on-full"),
    ),
    "Output": (
        "--help",
        "--output",
        "--output-format",
        "--force",
        "--json",
        "--verbose",
        "--plot",
        "--csv",
    ),
}
"""Where an option is shown; all others come first."""
OPTIONS = "Options"


class Verb(click.Command):
    """A command whose examples have a heading, and whose options come in groups."""

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        texts, examples = self.parts()
        whole, self.help = self.help, "\n\n".join(texts)
        try:
            super().format_help_text(ctx, formatter)
        finally:
            self.help = whole
        if examples:
            with formatter.section("Examples"):
                for line in examples:
                    formatter.write(f"  {line}\n")

    def parts(self) -> tuple[list[str], list[str]]:
        """Paragraphs of prose, and lines of commands."""
        texts, examples = [], []
        for paragraph in re.split(r"\n\s*\n", self.help or ""):
            lines = [line.strip() for line in paragraph.strip().splitlines()]
            if lines[:1] == ["\b"] and all("hapfmt " in line for line in lines[1:]):
                examples += lines[1:]
            else:
                texts.append(paragraph)
        return texts, examples

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        groups: dict[str, list[tuple[str, str]]] = {OPTIONS: [], **{name: [] for name in GROUPS}}
        for name, record in self.records(ctx):
            groups[name].append(record)
        for name, records in groups.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)

    def records(self, ctx: click.Context) -> Iterator[tuple[str, tuple[str, str]]]:
        """Group of an option, its names, its help."""
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx) if isinstance(param, click.Option) else None
            if record is not None:
                found = (name for name, ours in GROUPS.items() if set(ours) & set(param.opts))
                yield next(found, OPTIONS), record
