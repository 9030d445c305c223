"""Arguments -> verb -> exit code."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TextIO

from hapfmt.errors import HapfmtError, ParameterError
from hapfmt.format.track import CODECS
from hapfmt.version import SPEC_VERSION, __version__

ERROR = 1
CAPABILITIES: dict[str, Any] = {
    "name": "hapfmt",
    "version": __version__,
    "format": SPEC_VERSION,
    "level": 2,
    "verbs": ["decode", "verify", "recover", "encode", "serve"],
    "codecs": list(CODECS),
    "parts": [
        "tracks", "channels", "exact", "physical", "bands", "layers", "clocks", "maps",
        "metadata", "attachments", "unknown", "findings",
    ],
    "presets": ["lossless", "deadband", "split"],
}  # fmt: skip


def decode(source: str, folder: str) -> int:
    from .decode import decode_into

    return decode_into(source, folder)


def verify(source: str, target: str, *options: str) -> int:
    from .report import verify_into

    if options and options[0] != "--original":
        raise ParameterError(f"verify has no option {options[0]!r}")
    return verify_into(source, target, options[1] if options else None)


def recover(source: str, target: str, report: str) -> int:
    from .report import recover_into

    return recover_into(source, target, report)


def encode(job: str, target: str) -> int:
    from .job import encode_job

    return encode_job(job, target)


VERBS: dict[str, Callable[..., int]] = {
    "decode": decode,
    "verify": verify,
    "recover": recover,
    "encode": encode,
}
ARGUMENTS = {"decode": (2,), "verify": (2, 4), "recover": (3,), "encode": (2,)}


def run(argv: Sequence[str]) -> int:
    """One verb with its arguments; its exit code (SPEC clause 13)."""
    verb, *arguments = argv or [""]
    if verb not in VERBS or len(arguments) not in ARGUMENTS[verb]:
        print(f"usage: capabilities | serve | {' | '.join(VERBS)} ARGUMENTS", file=sys.stderr)
        return ERROR
    try:
        return VERBS[verb](*arguments)
    except HapfmtError as error:
        print(f"{verb}: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        print(f"{verb}: {error}", file=sys.stderr)
        return ERROR
    except Exception:
        # The next file is to be looked at, whatever this one did (verb serve).
        traceback.print_exc()
        return ERROR


def serve(lines: Iterable[str], out: TextIO) -> None:
    """A list of arguments on each line, an exit code for each."""
    for line in lines:
        print(run(json.loads(line)), file=out, flush=True)


def main(argv: Sequence[str]) -> int:
    if list(argv) == ["capabilities"]:
        print(json.dumps(CAPABILITIES))
        return 0
    if list(argv) == ["serve"]:
        serve(sys.stdin, sys.stdout)
        return 0
    return run(argv)
