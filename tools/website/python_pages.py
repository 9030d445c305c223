"""The Python reference: pages that name the public objects. mkdocstrings fills in docstrings."""

from __future__ import annotations

from typing import Any

import hapfmt
from hapfmt import edit
from hapfmt.lab import scenes

FOLDER = "reference"
WITHOUT = {"SPEC_VERSION", "__version__", "load"}
"""Two constants, and a deprecated function."""
GROUPS = {
    "Read and write": ["read", "write", "save", "scan_hapf", "plot", "Settings", "Summary"],
    "Recordings": ["Recording", "Channel", "Calibration", "Span", "Event"],
    "Clocks": ["ClockObservation", "ClockMap", "fit_clock"],
    "Check and recover": ["verify", "recover", "recover_in_place"],
    "Large and growing files": ["Reader", "Follower", "Limits"],
    "Record": ["Recorder", "Input", "Status"],
    "Errors": [
        "HapfmtError",
        "ChecksumError",
        "FormatError",
        "LimitError",
        "MissingExtraError",
        "ParameterError",
        "TruncatedError",
        "UnknownChannelError",
        "UnsupportedError",
    ],
}
PACKAGES = {
    "Edit": ("hapfmt.edit", edit.__all__),
    "Scenes": ("hapfmt.lab.scenes", scenes.__all__),
}


def names() -> dict[str, list[str]]:
    """{title of a page: full names}. Raises ValueError if a public name is in no group."""
    grouped = {name for group in GROUPS.values() for name in group}
    if grouped != set(hapfmt.__all__) - WITHOUT:
        raise ValueError(f"public names without a page: {set(hapfmt.__all__) ^ grouped - WITHOUT}")
    found = {title: [f"hapfmt.{name}" for name in group] for title, group in GROUPS.items()}
    for title, (package, public) in PACKAGES.items():
        found[title] = [f"{package}.{name}" for name in public]
    return found


def navigation() -> list[Any]:
    pages = [{title: address(title)} for title in names()]
    return [{"Reference": [f"{FOLDER}/index.md", *pages]}]


def address(title: str) -> str:
    return f"{FOLDER}/{title.lower().replace(' ', '-')}.md"


def pages() -> dict[str, str]:
    """{path on the site: Markdown}."""
    found = {}
    rows = ["| page | names |", "|---|---|"]
    for title, public in names().items():
        blocks = [f"::: {name}" for name in public]
        found[address(title)] = "\n\n".join([f"# {title}", *blocks]) + "\n"
        links = " ".join(f"[`{name}`][{name}]" for name in public)
        page = address(title).removeprefix(f"{FOLDER}/")
        rows.append(f"| [{title}]({page}) | {links} |")
    text = "The public names of the package. The [guide](../docs/python.md) shows how to use them."
    found[f"{FOLDER}/index.md"] = "\n\n".join(["# Python reference", text, "\n".join(rows)]) + "\n"
    return found
